//! Soft shadow of the key light.
//!
//! A map looks straight down from the lamp's centre, so that table and floor have constant depth
//! in it, and keeps `w = 1 / z`. With focal length `f` (texels), lamp radius `R`, receiver `w_r`
//! and blocker `w_b`, the blocker hides part of the lamp when its texel is within
//! `f R (w_b - w_r)` of the receiver's: linear in `w`. Over that disc the blocked share is
//! summed (percentage-closer soft shadows, Fernando 2005, with the receiver's plane as the
//! comparison depth). A pyramid of extreme values answers "fully lit" and "fully dark" at once
//! and serves wide discs at coarse levels. No random numbers: shadows stay put when the camera
//! moves.

pub(crate) mod baked;
mod disc;

use fuse_camera::simd::{self, F32x8};
use glam::{DMat3, DVec3, Vec2, Vec3, Vec3A};
use rayon::prelude::*;

use super::binned::Binned;
use super::geometry::Geometry;
use super::lanes::{V3, less};
use super::raster::{TILE_HEIGHT, TILE_WIDTH, Tile};
use super::transform::{Sampling, View};
use crate::Light;
use baked::Baked;
use disc::{Disc, DiscSum};

/// Gap below which nothing is thought to block, metres: hides the facets of curved things.
pub(crate) const BIAS: f32 = 0.0012;
/// Depths below this are not looked up, metres.
pub(crate) const NEAREST: f32 = 0.02;
/// Steepest slope of a receiver: tangent of its angle to the map's plane.
pub(crate) const STEEPEST: f32 = 24.0;
/// Widest view of the map: tangent of the angle off the vertical.
const MAX_TANGENT: f32 = 2.5;
/// Widest disc that is summed at one level, texels.
pub(crate) const MAX_DISC: f32 = 4.0;

/// Extreme inverse depths of 2^level blocks of texels, row by row.
pub(crate) struct Level {
    pub side: usize,
    /// Of what is nearest to the lamp.
    pub near: Vec<f32>,
    pub far: Vec<f32>,
}

impl Level {
    #[inline(always)]
    fn place(&self, x: i32, y: i32) -> usize {
        let last = self.side as i32 - 1;
        y.clamp(0, last) as usize * self.side + x.clamp(0, last) as usize
    }

    fn half(&self) -> Self {
        let side = self.side.div_ceil(2);
        let (mut near, mut far) = (vec![0.0; side * side], vec![0.0; side * side]);
        near.par_chunks_mut(side).zip(far.par_chunks_mut(side)).enumerate().for_each(|(y, (near, far))| {
            for (x, (near, far)) in near.iter_mut().zip(far).enumerate() {
                let (x, y) = (2 * x as i32, 2 * y as i32);
                let [a, b, c, d] = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].map(|(x, y)| self.place(x, y));
                *near = self.near[a].max(self.near[b]).max(self.near[c]).max(self.near[d]);
                *far = self.far[a].min(self.far[b]).min(self.far[c]).min(self.far[d]);
            }
        });
        Self { side, near, far }
    }
}

/// What the lamp sees of one box.
pub(crate) struct Map {
    /// Lamp's centre.
    pub position: Vec3,
    pub focal: f32,
    /// Texel of the point straight below the lamp.
    pub center: Vec2,
    pub radius: f32,
    pub levels: Vec<Level>,
    pub baked: Baked,
}

/// Eight points in a map.
struct Plane<V> {
    /// Inverse depth.
    w: V,
    /// Texels.
    x: V,
    y: V,
    /// Change of `w` along the surface, per texel.
    slope_x: V,
    slope_y: V,
}

/// Shadow maps: a fine one around the things, a coarse one for the room.
pub(crate) struct Shadow {
    pub maps: Vec<Map>,
}

impl Shadow {
    pub fn new(geometry: &Geometry, light: &Light, resolution: u32) -> Self {
        let margin = Vec3::splat(0.12);
        let things = geometry.bounds(|p| p.id != 0).map(|(lo, hi)| (lo - margin, hi + margin));
        let all = geometry.bounds(|_| true);
        let fine = things.and_then(|b| Map::new(geometry, light, b, resolution));
        let coarse = all.and_then(|b| Map::new(geometry, light, b, (resolution / 2).max(64)));
        Self { maps: fine.into_iter().chain(coarse).collect() }
    }

    /// Share of the lamp that points on surfaces with these unit normals see, in [0, 1], where
    /// `asked` is set.
    #[inline(always)]
    pub(super) fn visibility<V: F32x8>(&self, position: V3<V>, normal: V3<V>, asked: V) -> V {
        let mut out = V::splat(1.0);
        let mut left = asked;
        for map in &self.maps {
            let (plane, inside) = map.plane(position, normal);
            let here = left.and(inside);
            if here.mask_bits() == 0 {
                continue;
            }
            let (share, known) = map.baked.share(&plane);
            out = share.select(here.and(known), out);
            let unknown = here.mask_bits() & !known.mask_bits();
            if unknown != 0 {
                out = map.search(&plane, unknown, out);
            }
            left = V::zero().select(inside, left);
        }
        out
    }
}

impl Map {
    /// `None` when the box is not below the lamp.
    fn new(geometry: &Geometry, light: &Light, (lo, hi): (Vec3, Vec3), resolution: u32) -> Option<Self> {
        // The tangents of the box are widest at its top; close to the lamp they are cut off.
        let depth = (light.position.z - hi.z).max(0.05);
        if light.position.z - lo.z <= 0.05 {
            return None;
        }
        let low = depth.min(light.position.z - lo.z);
        let corners = [lo, hi].map(|c| {
            let d = (c - light.position).truncate();
            // y of the map runs against y of the world, as image rows do.
            Vec2::new(d.x, -d.y)
        });
        let tangent = |v: f32| (v / low).clamp(-MAX_TANGENT, MAX_TANGENT);
        let (x0, x1) = (tangent(corners[0].x), tangent(corners[1].x));
        let (y0, y1) = (tangent(corners[1].y), tangent(corners[0].y));
        let extent = (x1 - x0).max(y1 - y0);
        if extent < 1e-4 {
            return None;
        }
        let focal = resolution as f32 / extent;
        let center = Vec2::new(-x0, -y0) * focal;
        let mut map = Self {
            position: light.position,
            focal,
            center,
            radius: light.radius,
            levels: Vec::new(),
            baked: Baked::default(),
        };
        map.levels.push(map.draw(geometry, resolution));
        while let Some(next) = map.levels.last().filter(|l| l.side > 1).map(Level::half) {
            map.levels.push(next);
        }
        map.baked = Baked::new(&map, geometry);
        Some(map)
    }

    fn draw(&self, geometry: &Geometry, resolution: u32) -> Level {
        let view = self.view(resolution, resolution);
        let inverse_depth = inverse_depths(geometry, &view);
        Level { side: resolution as usize, far: inverse_depth.clone(), near: inverse_depth }
    }

    /// The view of the map's extent at another number of texels.
    fn view(&self, side: u32, resolution: u32) -> View {
        let scale = f64::from(side) / f64::from(resolution);
        let (f, c) = (f64::from(self.focal) * scale, self.center.as_dvec2() * scale);
        // Camera x = world x, camera y = -world y, looking down.
        let rotation = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let k = DMat3::from_cols(DVec3::new(f, 0.0, 0.0), DVec3::new(0.0, f, 0.0), DVec3::new(c.x, c.y, 1.0));
        let matrix = k * rotation;
        let offset = -(matrix * self.position.as_dvec3());
        View { matrix, offset, width: side, height: side, near: f64::from(self.radius).max(0.01) }
    }

    /// Where points are in the map and how their surfaces lie in it, and which are inside.
    #[inline(always)]
    fn plane<V: F32x8>(&self, position: V3<V>, normal: V3<V>) -> (Plane<V>, V) {
        let d = position - V3::splat(self.position.into());
        let z = d.z.neg();
        let below = z.gt(V::splat(NEAREST));
        let w = V::splat(1.0) / z.max(V::splat(NEAREST));
        let focal = V::splat(self.focal);
        let (x, y) = (d.x * w * focal + V::splat(self.center.x), V::splat(self.center.y) - d.y * w * focal);
        let side = V::splat(self.levels[0].side as f32);
        let (low, high) = (x.min(y), x.max(y));
        let inside = below.and(low.ge(V::zero())).and(less(high, side));
        // Plane of the receiver: 1/z is linear over the map. Camera frame of the map.
        let distance = normal.dot(d).min(V::splat(-1e-3)) * focal;
        let (sx, sy) = (normal.x / distance, normal.y.neg() / distance);
        // Steeper planes than this see the lamp at a grazing angle.
        let length = (sx * sx + sy * sy).max(V::splat(1e-30)).sqrt();
        let shorten = (V::splat(STEEPEST / self.focal) * w / length).min(V::splat(1.0));
        (Plane { w, x, y, slope_x: sx * shorten, slope_y: sy * shorten }, inside)
    }

    /// Share of the lamp at a point in the map, `offset` from the lamp.
    fn share_at(&self, offset: Vec3A, normal: Vec3A, at: Vec2) -> f32 {
        let w = -1.0 / offset.z;
        let slope = Vec2::new(normal.x, -normal.y) / (normal.dot(offset).min(-1e-3) * self.focal);
        let slope = slope.clamp_length_max(STEEPEST * w / self.focal);
        self.share(&Receiver { w: w + BIAS * w * w, at, slope })
    }

    /// Replaces the lanes of `out` whose bits are set by a search of their own.
    #[inline(always)]
    fn search<V: F32x8>(&self, plane: &Plane<V>, lanes: u8, out: V) -> V {
        let (w, x, y) = (plane.w.to_array(), plane.x.to_array(), plane.y.to_array());
        let (sx, sy) = (plane.slope_x.to_array(), plane.slope_y.to_array());
        let mut out = out.to_array();
        for i in 0..8 {
            if lanes >> i & 1 != 0 {
                let slope = Vec2::new(sx[i], sy[i]);
                out[i] = self.share(&Receiver { w: w[i] + BIAS * w[i] * w[i], at: Vec2::new(x[i], y[i]), slope });
            }
        }
        V::load(&out)
    }

    /// Reach of blockers at inverse depth `blocker`, texels.
    fn reach(&self, blocker: f32, w: f32) -> f32 {
        self.focal * self.radius * (blocker - w).max(0.0)
    }

    fn share(&self, r: &Receiver) -> f32 {
        let mut reach = self.reach(self.nearest(), r.w);
        // Twice: a smaller region has a farther nearest blocker, hence a smaller reach.
        for _ in 0..2 {
            let [near, far] = self.extremes(r.at, reach + 1.0);
            let tilt = r.slope.length() * (reach + 1.0);
            if near <= r.w - tilt {
                return 1.0;
            }
            if far > r.w + tilt {
                return 0.0;
            }
            reach = reach.min(self.reach(near, r.w));
        }
        let reach = reach.max(1.0);
        let search = self.disc(r, reach);
        if search.blocked <= 0.0 {
            return 1.0;
        }
        let penumbra = self.reach(search.depth / search.blocked, r.w).clamp(1.0, reach);
        let disc = self.disc(r, penumbra);
        1.0 - disc.blocked / disc.weight
    }

    /// Largest inverse depth of the map.
    fn nearest(&self) -> f32 {
        self.levels.last().map_or(0.0, |top| top.near[0])
    }

    /// Sums over the texels of a disc, at the level where it is at most [`MAX_DISC`] wide.
    fn disc(&self, r: &Receiver, radius: f32) -> Disc {
        let mut level = 0;
        let mut scale = 1.0;
        while radius * scale > MAX_DISC && level + 1 < self.levels.len() {
            level += 1;
            scale *= 0.5;
        }
        let slope = r.slope / scale;
        // Half of the change of the receiver's own depth over a block, which must not block it.
        let tilt = 0.5 * (slope.x.abs() + slope.y.abs()) * (1.0 - scale);
        let sum = DiscSum {
            level: &self.levels[level],
            radius: radius * scale + 0.5,
            at: r.at * scale - 0.5,
            slope,
            w: r.w + tilt,
        };
        simd::dispatch(simd::level(), sum)
    }

    /// Extremes over a square that holds the disc.
    fn extremes(&self, at: Vec2, reach: f32) -> [f32; 2] {
        let mut level = 0;
        while level + 1 < self.levels.len() && (1u32 << level) as f32 <= 2.0 * reach {
            level += 1;
        }
        let scale = 1.0 / (1u32 << level) as f32;
        let (x0, x1) = (floor((at.x - reach) * scale), floor((at.x + reach) * scale));
        let (y0, y1) = (floor((at.y - reach) * scale), floor((at.y + reach) * scale));
        let level = &self.levels[level];
        let (mut near, mut far) = (f32::NEG_INFINITY, f32::INFINITY);
        for y in y0..=y1 {
            for x in x0..=x1 {
                let at = level.place(x, y);
                (near, far) = (near.max(level.near[at]), far.min(level.far[at]));
            }
        }
        [near, far]
    }
}

/// Rounded down, for numbers above -65536.
fn floor(v: f32) -> i32 {
    // No library call.
    (f64::from(v) + 65536.0) as i32 - 65536
}

/// A point that asks for its light.
struct Receiver {
    /// Inverse depth, bias included.
    w: f32,
    at: Vec2,
    /// Change of `w` along the surface, per texel.
    slope: Vec2,
}

/// Inverse depth seen at every pixel centre of a view; 0 where there is nothing.
pub(super) fn inverse_depths(geometry: &Geometry, view: &View) -> Vec<f32> {
    let binned = Binned::new(view, geometry, Sampling::Center);
    let w = view.width as usize;
    let mut out = vec![0.0f32; w * view.height as usize];
    out.par_chunks_mut(TILE_HEIGHT * w).enumerate().for_each_init(
        || Tile::new(view, 1),
        |tile, (ty, rows)| {
            for tx in 0..binned.tiles_x {
                if binned.is_empty(tx, ty) {
                    continue;
                }
                tile.reset(tx * TILE_WIDTH, ty * TILE_HEIGHT);
                tile.draw_centers(&binned);
                for (row, out) in rows.chunks_mut(w).enumerate() {
                    let columns = tx * TILE_WIDTH..((tx + 1) * TILE_WIDTH).min(w);
                    let n = columns.len();
                    out[columns].copy_from_slice(&tile.center_depths(row)[..n]);
                }
            }
        },
    );
    out
}
