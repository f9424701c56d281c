//! Ambient occlusion around the things: how much of the upper hemisphere nearby surfaces hide.
//!
//! Depth maps from directions spread evenly over the hemisphere tell for every cell of a grid
//! near a surface which directions are blocked, `O_d`. A cell keeps `o0 = mean O_d` and
//! `o1 = mean O_d d`; in first-order spherical harmonics the cosine-weighted blocked share of a
//! surface with normal `n` is `o0 / 2 + n · o1`, and the blocked share along a direction `d`
//! is `o0 / 2 + 3/2 d · o1`.

use glam::{DMat3, DVec3, UVec3, Vec3, Vec3A, Vec4};
use rayon::prelude::*;

use super::geometry::Geometry;
use super::shadow::inverse_depths;
use super::transform::View;

/// Directions over the hemisphere.
const DIRECTIONS: usize = 24;
/// Side of a direction's depth map, texels.
const MAP_SIDE: u32 = 256;
/// Smallest cell side, metres, and most cells along an axis.
const CELL: f32 = 0.008;
const MAX_CELLS: f32 = 160.0;
/// The maps are drawn from this many radii away: nearly parallel.
const DISTANCE: f32 = 8.0;
/// Blockers farther away than this do not count, metres; nearer ones count the more, the nearer.
const REACH: f32 = 0.35;
/// Makes up for the light that `REACH` lets through.
pub(crate) const GAIN: f32 = 1.35;
/// The effect fades over this distance at the border of the grid, metres.
pub(crate) const FADE: f32 = 0.06;

/// A cell that nothing blocks.
const OPEN: [u8; 4] = [0, 128, 128, 128];

/// The grid.
pub(crate) struct Occlusion {
    pub low: Vec3A,
    pub high: Vec3A,
    pub cell: f32,
    pub size: UVec3,
    /// `o0`, `o1` in [0, 1] and [-½, ½], as bytes.
    pub cells: Vec<[u8; 4]>,
}

/// One direction's depth map.
struct DirectionMap {
    direction: Vec3,
    matrix: glam::Mat3,
    offset: Vec3,
    inverse_depth: Vec<f32>,
}

impl Occlusion {
    /// `None` when the scene has nothing but the room.
    pub fn new(geometry: &Geometry) -> Option<Self> {
        let (low, high) = geometry.bounds(|p| p.id != 0)?;
        let (low, high) = (low - Vec3::new(0.15, 0.15, 0.03), high + Vec3::new(0.15, 0.15, 0.06));
        let cell = ((high - low).max_element() / MAX_CELLS).max(CELL);
        let size = ((high - low) / cell).ceil().as_uvec3().max(UVec3::splat(2));
        let mut grid = Self { low: low.into(), high: high.into(), cell, size, cells: Vec::new() };
        let near_surface = grid.near_surface(geometry);
        let maps = grid.maps(geometry);
        grid.cells = near_surface
            .into_par_iter()
            .with_min_len(4096)
            .enumerate()
            .map(|(i, near)| if near { grid.blocked(&maps, grid.cell_center(i)) } else { OPEN })
            .collect();
        grid.blur();
        Some(grid)
    }

    fn cell_center(&self, index: usize) -> Vec3 {
        let (nx, ny) = (self.size.x as usize, self.size.y as usize);
        let k = [index % nx, index / nx % ny, index / (nx * ny)].map(|k| k as f32 + 0.5);
        Vec3::from(self.low) + Vec3::from_array(k) * self.cell
    }

    /// Cells within two of a triangle's bounds.
    fn near_surface(&self, geometry: &Geometry) -> Vec<bool> {
        let mut near = vec![false; (self.size.x * self.size.y * self.size.z) as usize];
        let last = self.size.as_ivec3() - 1;
        for t in &geometry.triangles {
            let p = t.map(|v| (Vec3A::from(geometry.positions[v as usize]) - self.low) / self.cell);
            let lo = (p[0].min(p[1]).min(p[2]).floor() - 2.0).as_ivec3();
            let hi = (p[0].max(p[1]).max(p[2]).floor() + 2.0).as_ivec3();
            if hi.min_element() < 0 || (lo - last).max_element() > 0 {
                continue;
            }
            let (lo, hi) = (lo.max(glam::IVec3::ZERO), hi.min(last));
            for z in lo.z..=hi.z {
                for y in lo.y..=hi.y {
                    let row = ((z as u32 * self.size.y + y as u32) * self.size.x) as usize;
                    near[row + lo.x as usize..=row + hi.x as usize].fill(true);
                }
            }
        }
        near
    }

    fn maps(&self, geometry: &Geometry) -> Vec<DirectionMap> {
        let center = Vec3::from(self.low + self.high) * 0.5;
        let radius = (self.high - self.low).length() * 0.5;
        (0..DIRECTIONS).into_par_iter().map(|k| DirectionMap::new(geometry, center, radius, direction(k))).collect()
    }

    fn blocked(&self, maps: &[DirectionMap], p: Vec3) -> [u8; 4] {
        let mut sum = Vec4::ZERO;
        for map in maps {
            sum += map.direction.extend(1.0) * map.blocks(p, self.cell * 0.5);
        }
        let o = sum / DIRECTIONS as f32;
        let byte = |v: f32| (v * 255.0 + 0.5).clamp(0.0, 255.0) as u8;
        [byte(o.w), byte(o.x + 128.0 / 255.0), byte(o.y + 128.0 / 255.0), byte(o.z + 128.0 / 255.0)]
    }

    /// Binomial blur along x and y, against the steps that few directions leave.
    fn blur(&mut self) {
        let (nx, ny) = (self.size.x as usize, self.size.y as usize);
        for (step, length) in [(1, nx), (nx, ny)] {
            let source = self.cells.clone();
            self.cells.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, cell)| {
                let k = i / step % length;
                let before = if k > 0 { source[i - step] } else { *cell };
                let after = if k + 1 < length { source[i + step] } else { *cell };
                let here = *cell;
                *cell = std::array::from_fn(|c| {
                    ((u16::from(before[c]) + 2 * u16::from(here[c]) + u16::from(after[c]) + 2) / 4) as u8
                });
            });
        }
    }

    /// Blocked shares `(of the cosine hemisphere around the normal, along `direction`)`.
    pub fn at(&self, position: Vec3A, normal: Vec3A, direction: Vec3A) -> (f32, f32) {
        let p = position + normal * self.cell;
        let border = (p - self.low).min(self.high - p).min_element();
        if border <= 0.0 {
            return (0.0, 0.0);
        }
        let o = self.trilinear((p - self.low) / self.cell - 0.5);
        let (o0, o1) = (o.x, Vec3A::new(o.y, o.z, o.w));
        let fade = (border / FADE).min(1.0);
        let share = |v: f32| (GAIN * v).clamp(0.0, 1.0) * fade;
        (share(0.5 * o0 + normal.dot(o1)), share(0.5 * o0 + 1.5 * direction.dot(o1)))
    }

    fn trilinear(&self, at: Vec3A) -> Vec4 {
        let top = self.size - 1;
        let base = at.floor();
        let f = at - base;
        let low = base.as_ivec3();
        let index = |k: i32, last: u32| k.clamp(0, last as i32) as usize;
        let (nx, ny) = (self.size.x as usize, self.size.y as usize);
        let (x0, x1) = (index(low.x, top.x), index(low.x + 1, top.x));
        let row = |dy: i32, dz: i32| -> Vec4 {
            let start = (index(low.z + dz, top.z) * ny + index(low.y + dy, top.y)) * nx;
            let value = |x: usize| {
                let [a, b, c, d] = self.cells[start + x];
                Vec4::new(f32::from(a), f32::from(b), f32::from(c), f32::from(d))
            };
            value(x0).lerp(value(x1), f.x)
        };
        let plane = |dz: i32| row(0, dz).lerp(row(1, dz), f.y);
        (plane(0).lerp(plane(1), f.z) - Vec4::new(0.0, 128.0, 128.0, 128.0)) * (1.0 / 255.0)
    }
}

/// Evenly spread over the upper hemisphere (golden-angle spiral, equal steps of height).
fn direction(k: usize) -> Vec3 {
    let z = (k as f32 + 0.5) / DIRECTIONS as f32;
    let (sin, cos) = (k as f32 * 2.399_963_2).sin_cos();
    let r = (1.0 - z * z).sqrt();
    Vec3::new(r * cos, r * sin, z)
}

impl DirectionMap {
    fn new(geometry: &Geometry, center: Vec3, radius: f32, direction: Vec3) -> Self {
        let eye = (center + direction * (DISTANCE * radius)).as_dvec3();
        let forward = -direction.as_dvec3();
        let right = forward.cross(DVec3::Z).try_normalize().unwrap_or(DVec3::X);
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let side = f64::from(MAP_SIDE);
        let focal = side * 0.5 * f64::from(DISTANCE - 1.0);
        let k = DMat3::from_cols(
            DVec3::new(focal, 0.0, 0.0),
            DVec3::new(0.0, focal, 0.0),
            DVec3::new(side * 0.5, side * 0.5, 1.0),
        );
        let matrix = k * rotation;
        let offset = -(matrix * eye);
        // The near plane drops walls and ceilings beyond the sphere around the grid.
        let near = f64::from((DISTANCE - 1.0) * radius);
        let view = View { matrix, offset, width: MAP_SIDE, height: MAP_SIDE, near };
        let inverse_depth = inverse_depths(geometry, &view);
        Self { direction, matrix: matrix.as_mat3(), offset: offset.as_vec3(), inverse_depth }
    }

    /// Weight of what lies between `p` and the sky in this direction, in [0, 1].
    fn blocks(&self, p: Vec3, tolerance: f32) -> f32 {
        let q = self.matrix * p + self.offset;
        let (x, y) = (q.x / q.z, q.y / q.z);
        let side = MAP_SIDE as f32;
        if !(x >= 0.0 && x < side && y >= 0.0 && y < side) {
            return 0.0;
        }
        let w = self.inverse_depth[y as usize * MAP_SIDE as usize + x as usize];
        if w * (q.z - tolerance) <= 1.0 {
            return 0.0;
        }
        let nearness = (1.0 - (q.z - 1.0 / w) / REACH).max(0.0);
        nearness.sqrt()
    }
}
