//! Ambient occlusion around the things: how much of the upper hemisphere nearby surfaces hide.
//!
//! Depth maps from directions spread evenly over the hemisphere tell for every cell of a grid
//! near a surface which directions are blocked, `O_d`. A cell keeps `o0 = mean O_d` and
//! `o1 = mean O_d d`; in first-order spherical harmonics the cosine-weighted blocked share of a
//! surface with normal `n` is `o0 / 2 + n · o1`, and the blocked share along a direction `d`
//! is `o0 / 2 + 3/2 d · o1`.

use fuse_camera::simd::{F32x8, I32x8};
use glam::{DMat3, DVec3, UVec3, Vec3, Vec3A, Vec4};
use rayon::prelude::*;

use super::geometry::Geometry;
use super::lanes::{V3, clamp, lerp};
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
    /// `o0`, `o1` in [0, 1] and [-½, ½], as bytes, `o0` the lowest. Rows begin and end with a copy of
    /// their first and last cell, so that neighbours are read in one.
    pub cells: Vec<u32>,
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
        let cells = near_surface
            .into_par_iter()
            .with_min_len(4096)
            .enumerate()
            .map(|(i, near)| if near { grid.blocked(&maps, grid.cell_center(i)) } else { OPEN })
            .collect();
        let cells = grid.blurred(cells);
        grid.cells = cells
            .chunks(size.x as usize)
            .flat_map(|row| row.first().into_iter().chain(row).chain(row.last()))
            .map(|cell| u32::from_le_bytes(*cell))
            .collect();
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
    fn blurred(&self, mut cells: Vec<[u8; 4]>) -> Vec<[u8; 4]> {
        let (nx, ny) = (self.size.x as usize, self.size.y as usize);
        for (step, length) in [(1, nx), (nx, ny)] {
            let source = cells.clone();
            cells.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, cell)| {
                let k = i / step % length;
                let before = if k > 0 { source[i - step] } else { *cell };
                let after = if k + 1 < length { source[i + step] } else { *cell };
                let here = *cell;
                *cell = std::array::from_fn(|c| {
                    ((u16::from(before[c]) + 2 * u16::from(here[c]) + u16::from(after[c]) + 2) / 4) as u8
                });
            });
        }
        cells
    }

    /// Blocked shares `(of the cosine hemisphere around the normal, along `direction`)`.
    #[inline(always)]
    pub(super) fn at<V: F32x8>(&self, position: V3<V>, normal: V3<V>, direction: V3<V>) -> (V, V) {
        let p = position + normal.scale(V::splat(self.cell));
        let (low, high) = (p - V3::splat(self.low), V3::splat(self.high) - p);
        let border = low.x.min(low.y).min(low.z).min(high.x.min(high.y).min(high.z));
        let inside = border.gt(V::zero());
        if inside.mask_bits() == 0 {
            return (V::zero(), V::zero());
        }
        let half = V3::all(V::splat(0.5));
        let [o0, x, y, z] = self.trilinear(low.scale(V::splat(1.0 / self.cell)) - half);
        let o1 = V3 { x, y, z };
        let fade = (border * V::splat(1.0 / FADE)).min(V::splat(1.0));
        let half = o0 * V::splat(0.5);
        let (sky, mirror) = (half + normal.dot(o1), half + V::splat(1.5) * direction.dot(o1));
        let gain = V::splat(GAIN);
        let (sky, mirror) = (clamp(gain * sky, 0.0, 1.0), clamp(gain * mirror, 0.0, 1.0));
        ((sky * fade).and(inside), (mirror * fade).and(inside))
    }

    /// `o0` and `o1` at places in units of cells, the first cell's centre being 0.
    #[inline(always)]
    fn trilinear<V: F32x8>(&self, at: V3<V>) -> [V; 4] {
        let up = (at.x + V::splat(1.0)).max(V::zero());
        let x = up.to_int().min(V::Int::splat(self.size.x as i32));
        let fx = up - x.to_float();
        let (y0, y1, fy) = neighbours(at.y, self.size.y);
        let (z0, z1, fz) = neighbours(at.z, self.size.z);
        let (stride, ny) = (V::Int::splat(self.size.x as i32 + 2), V::Int::splat(self.size.y as i32));
        let (top, bottom) = (z0 * ny, z1 * ny);
        let low = mix(self.row((top + y0) * stride + x, fx), self.row((top + y1) * stride + x, fx), fy);
        let high = mix(self.row((bottom + y0) * stride + x, fx), self.row((bottom + y1) * stride + x, fx), fy);
        let mut out = mix(low, high, fz);
        for (c, value) in out.iter_mut().enumerate() {
            let offset = if c == 0 { 0.0 } else { 128.0 };
            *value = (*value - V::splat(offset)) * V::splat(1.0 / 255.0);
        }
        out
    }

    /// Between two cells of a row.
    #[inline(always)]
    fn row<V: F32x8>(&self, first: V::Int, t: V) -> [V; 4] {
        let (a, b) = first.gather_pairs(&self.cells);
        mix(bytes(a), bytes(b), t)
    }
}

/// The two of `count` cells around `v` in units of cells, and the weight of the second.
#[inline(always)]
fn neighbours<V: F32x8>(v: V, count: u32) -> (V::Int, V::Int, V) {
    // Places are above -1: adding 1 makes rounding towards zero a floor.
    let up = (v + V::splat(1.0)).max(V::zero());
    let whole = up.to_int();
    let last = V::Int::splat(count as i32 - 1);
    let low = (whole - V::Int::splat(1)).max(V::Int::splat(0)).min(last);
    (low, whole.min(last), up - whole.to_float())
}

#[inline(always)]
fn mix<V: F32x8>(a: [V; 4], b: [V; 4], t: V) -> [V; 4] {
    [lerp(a[0], b[0], t), lerp(a[1], b[1], t), lerp(a[2], b[2], t), lerp(a[3], b[3], t)]
}

/// The bytes of a cell, the first lowest.
#[inline(always)]
fn bytes<V: F32x8>(cell: V::Int) -> [V; 4] {
    let byte = V::Int::splat(255);
    [
        cell.and(byte).to_float(),
        cell.shift_right::<8>().and(byte).to_float(),
        cell.shift_right::<16>().and(byte).to_float(),
        cell.shift_right::<24>().to_float(),
    ]
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
