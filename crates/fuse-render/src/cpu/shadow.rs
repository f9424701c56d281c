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

use glam::{DMat3, DVec3, Vec2, Vec3, Vec3A};
use rayon::prelude::*;

use super::Binned;
use super::geometry::Geometry;
use super::raster::{TILE_HEIGHT, TILE_WIDTH, Tile};
use super::transform::{Sampling, View};
use crate::Light;

/// Gap below which nothing is thought to block, metres: hides the facets of curved things.
pub(crate) const BIAS: f32 = 0.0012;
/// Widest view of the map: tangent of the angle off the vertical.
const MAX_TANGENT: f32 = 2.5;
/// Widest disc that is summed at one level, texels.
pub(crate) const MAX_DISC: f32 = 4.0;

/// Extreme inverse depths of a 2^level block of texels.
pub(crate) struct Level {
    pub side: usize,
    /// `[nearest to the lamp, farthest]`.
    pub extremes: Vec<[f32; 2]>,
}

impl Level {
    #[inline(always)]
    fn at(&self, x: i32, y: i32) -> [f32; 2] {
        let last = self.side as i32 - 1;
        self.extremes[y.clamp(0, last) as usize * self.side + x.clamp(0, last) as usize]
    }

    fn half(&self) -> Self {
        let side = self.side.div_ceil(2);
        let mut extremes = Vec::with_capacity(side * side);
        for y in 0..side as i32 {
            for x in 0..side as i32 {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| self.at(2 * x + dx, 2 * y + dy));
                extremes.push(
                    four.into_iter()
                        .fold([f32::NEG_INFINITY, f32::INFINITY], |[hi, lo], [a, b]| [hi.max(a), lo.min(b)]),
                );
            }
        }
        Self { side, extremes }
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

    /// Share of the lamp that `position` on a surface with this normal sees, in [0, 1].
    pub fn visibility(&self, position: Vec3A, normal: Vec3A) -> f32 {
        self.maps.iter().find_map(|m| m.visibility(position, normal)).unwrap_or(1.0)
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
        let mut map = Self { position: light.position, focal, center, radius: light.radius, levels: Vec::new() };
        map.levels.push(map.draw(geometry, resolution));
        while let Some(next) = map.levels.last().filter(|l| l.side > 1).map(Level::half) {
            map.levels.push(next);
        }
        Some(map)
    }

    fn draw(&self, geometry: &Geometry, resolution: u32) -> Level {
        let (f, c) = (f64::from(self.focal), self.center.as_dvec2());
        // Camera x = world x, camera y = -world y, looking down.
        let rotation = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let k = DMat3::from_cols(DVec3::new(f, 0.0, 0.0), DVec3::new(0.0, f, 0.0), DVec3::new(c.x, c.y, 1.0));
        let matrix = k * rotation;
        let offset = -(matrix * self.position.as_dvec3());
        let near = f64::from(self.radius).max(0.01);
        let view = View { matrix, offset, width: resolution, height: resolution, near };
        let inverse_depth = inverse_depths(geometry, &view);
        Level { side: resolution as usize, extremes: inverse_depth.into_iter().map(|w| [w, w]).collect() }
    }

    /// `None` outside the map.
    fn visibility(&self, position: Vec3A, normal: Vec3A) -> Option<f32> {
        let d = position - Vec3A::from(self.position);
        let z = -d.z;
        if z <= 0.02 {
            return None;
        }
        let w = 1.0 / z;
        let at = Vec2::new(d.x, -d.y) * (w * self.focal) + self.center;
        let side = self.levels[0].side as f32;
        if at.min_element() < 0.0 || at.max_element() >= side {
            return None;
        }
        // Plane of the receiver: 1/z is linear over the map. Camera frame of the map.
        let n = Vec3A::new(normal.x, -normal.y, -normal.z);
        let distance = n.x * d.x - n.y * d.y + n.z * z;
        let slope = Vec2::new(n.x, n.y) / (distance.min(-1e-3) * self.focal);
        // Steeper planes than this see the lamp at a grazing angle.
        let slope = slope.clamp_length_max(24.0 * w / self.focal);
        let receiver = Receiver { w: w + BIAS * w * w, at, slope };
        Some(self.share(&receiver))
    }

    /// Reach of blockers at inverse depth `blocker`, texels.
    fn reach(&self, blocker: f32, w: f32) -> f32 {
        self.focal * self.radius * (blocker - w).max(0.0)
    }

    fn share(&self, r: &Receiver) -> f32 {
        let top = self.levels[self.levels.len() - 1].at(0, 0)[0];
        let mut reach = self.reach(top, r.w);
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

    /// Sums over the texels of a disc, at the level where it is at most [`MAX_DISC`] wide.
    fn disc(&self, r: &Receiver, radius: f32) -> Disc {
        let mut level = 0;
        let mut scale = 1.0;
        while radius * scale > MAX_DISC && level + 1 < self.levels.len() {
            level += 1;
            scale *= 0.5;
        }
        let (radius, at, slope) = (radius * scale + 0.5, r.at * scale - 0.5, r.slope / scale);
        let (x0, x1) = ((at.x - radius).ceil() as i32, (at.x + radius).floor() as i32);
        let (y0, y1) = ((at.y - radius).ceil() as i32, (at.y + radius).floor() as i32);
        // Half of the change of the receiver's own depth over a block, which must not block it.
        let tilt = 0.5 * (slope.x.abs() + slope.y.abs()) * (1.0 - scale);
        let mut disc = Disc::default();
        for y in y0..=y1 {
            let dy = y as f32 - at.y;
            for x in x0..=x1 {
                let dx = x as f32 - at.x;
                let weight = (radius - (dx * dx + dy * dy).sqrt()).clamp(0.0, 1.0);
                let [near, far] = self.levels[level].at(x, y);
                let plane = r.w + slope.x * dx + slope.y * dy + tilt;
                // A block of texels that is blocked in part counts half.
                let blocked = weight * 0.5 * (f32::from(near > plane) + f32::from(far > plane));
                disc.weight += weight;
                disc.blocked += blocked;
                disc.depth += blocked * near;
            }
        }
        disc
    }

    /// Extremes over a square that holds the disc.
    fn extremes(&self, at: Vec2, reach: f32) -> [f32; 2] {
        let mut level = 0;
        while level + 1 < self.levels.len() && (1u32 << level) as f32 <= 2.0 * reach {
            level += 1;
        }
        let scale = 1.0 / (1u32 << level) as f32;
        let (x0, x1) = (((at.x - reach) * scale).floor() as i32, ((at.x + reach) * scale).floor() as i32);
        let (y0, y1) = (((at.y - reach) * scale).floor() as i32, ((at.y + reach) * scale).floor() as i32);
        let mut out = [f32::NEG_INFINITY, f32::INFINITY];
        for y in y0..=y1 {
            for x in x0..=x1 {
                let [hi, lo] = self.levels[level].at(x, y);
                out = [out[0].max(hi), out[1].min(lo)];
            }
        }
        out
    }
}

/// Sums over a disc of the map.
#[derive(Default)]
struct Disc {
    weight: f32,
    /// Weight of blockers.
    blocked: f32,
    /// Their inverse depth times weight.
    depth: f32,
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
    let vertices = view.vertices(geometry);
    let binned = Binned::new(view, view.setups(geometry, &vertices, Sampling::Center));
    let w = view.width as usize;
    let mut out = vec![0.0f32; w * view.height as usize];
    out.par_chunks_mut(TILE_HEIGHT * w).enumerate().for_each_init(
        || Tile::new(view, 1),
        |tile, (ty, rows)| {
            for tx in 0..binned.tiles_x {
                let list = binned.tile(tx, ty);
                if list.is_empty() {
                    continue;
                }
                tile.reset(tx * TILE_WIDTH, ty * TILE_HEIGHT);
                for &s in list {
                    tile.draw_centers(&binned.setups[s as usize], s + 1);
                }
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
