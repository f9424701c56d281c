//! Shares of the lamp at the surfaces that it shines on, made once.
//!
//! What the lamp's centre sees through a texel of the map, and what it would see behind that, are
//! the two surfaces that nearly all lit and shaded points lie on. Their share of the lamp is kept
//! with their inverse depth; a point that lies on neither is left to the search over the map.

use fuse_camera::simd::{F32x8, I32x8};
use glam::{Vec2, Vec3A};
use rayon::prelude::*;

use super::super::binned::Binned;
use super::super::geometry::Geometry;
use super::super::lanes::less;
use super::super::raster::{TILE_HEIGHT, TILE_WIDTH, Tile};
use super::super::transform::{Sampling, View};
use super::{BIAS, Map, Plane};

/// Side of the blocks that are looked at as a whole, texels.
const BLOCK: usize = 8;
/// A surface nearer than this behind another one is not a layer of its own, metres.
const APART: f32 = 0.003;
/// Distance from a layer's surface within which a point is thought to lie on it, metres.
pub(crate) const ON: f32 = 0.004;
/// Largest fixed-point inverse depth.
pub(crate) const STEPS: f32 = 16_777_215.0;
/// Least weight of texels that a point must lie on.
pub(crate) const ENOUGH: f32 = 0.2;

/// The layers, each texel `inverse depth << 8 | share`, both as fractions of their largest value.
/// Rows begin and end with an empty texel, so that neighbours are read in one.
#[derive(Default)]
pub(crate) struct Baked {
    pub layers: [Vec<u32>; 2],
    /// Texels along a side: half of the map's, about a millimetre on a table.
    pub side: usize,
    /// Inverse depth that the largest fixed-point value stands for.
    pub nearest: f32,
    /// Layer texels for each texel of the map.
    pub scale: f32,
}

impl Baked {
    /// The layers of a map whose levels are made.
    pub fn new(map: &Map, geometry: &Geometry) -> Self {
        let resolution = map.levels[0].side;
        let side = (resolution / 2).next_multiple_of(BLOCK);
        let view = map.view(side as u32, resolution as u32);
        let binned = Binned::new(&view, geometry, Sampling::Center);
        let mut baked =
            Self { layers: [Vec::new(), Vec::new()], side, nearest: 0.0, scale: side as f32 / resolution as f32 };
        let first = Surfaces::new(&view, &binned, None);
        let second = Surfaces::new(&view, &binned, Some(&first));
        baked.nearest = first.inverse_depth.iter().fold(1e-6, |a, b| a.max(*b));
        baked.layers = [first, second].map(|s| baked.layer(map, geometry, &binned, &s));
        baked
    }

    fn layer(&self, map: &Map, geometry: &Geometry, binned: &Binned, surfaces: &Surfaces) -> Vec<u32> {
        let (side, stride) = (self.side, self.side + 2);
        let mut out = vec![0u32; stride * side];
        out.par_chunks_mut(stride * BLOCK).enumerate().for_each(|(band, rows)| {
            for left in (0..side).step_by(BLOCK) {
                let whole = self.block(map, surfaces, (left, band * BLOCK));
                for row in 0..BLOCK {
                    for x in left..left + BLOCK {
                        let at = (band * BLOCK + row) * side + x;
                        let w = surfaces.inverse_depth[at];
                        if w > 0.0 {
                            let setup = || binned.setup(surfaces.nearest[at] - 1);
                            let share = whole.unwrap_or_else(|| {
                                let facet = geometry.facets[setup().triangle as usize];
                                self.texel(map, facet, (x, band * BLOCK + row), w)
                            });
                            rows[row * stride + x + 1] = fixed(w / self.nearest, STEPS) << 8 | fixed(share, 255.0);
                        }
                    }
                }
            }
        });
        out
    }

    /// The share at all texels of a block, where one look tells: nothing at all is above it, or
    /// nothing else.
    fn block(&self, map: &Map, surfaces: &Surfaces, (x, y): (usize, usize)) -> Option<f32> {
        let (mut low, mut high) = (f32::MAX, 0.0f32);
        for row in y..y + BLOCK {
            for w in &surfaces.inverse_depth[row * self.side + x..][..BLOCK] {
                if *w > 0.0 {
                    (low, high) = (low.min(*w), high.max(*w));
                }
            }
        }
        if high <= 0.0 {
            return Some(1.0);
        }
        let half = 0.5 * BLOCK as f32;
        let center = Vec2::new(x as f32 + half, y as f32 + half) / self.scale;
        let reach = map.reach(map.nearest(), low) + half / self.scale + 1.0;
        let [near, far] = map.extremes(center, reach);
        if near <= low + BIAS * low * low {
            Some(1.0)
        } else if far > high + BIAS * high * high {
            Some(0.0)
        } else {
            None
        }
    }

    fn texel(&self, map: &Map, facet: Vec3A, (x, y): (usize, usize), w: f32) -> f32 {
        let place = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / self.scale;
        let ray = (place - map.center) / map.focal;
        let offset = Vec3A::new(ray.x, -ray.y, -1.0) / w;
        map.share_at(offset, if facet.dot(offset) > 0.0 { -facet } else { facet }, place)
    }

    /// Shares of the lamp at points in the map, and which of them lie on a layer.
    ///
    /// `plane` in texels of the map.
    #[inline(always)]
    pub(super) fn share<V: F32x8>(&self, plane: &Plane<V>) -> (V, V) {
        let scale = V::splat(self.scale);
        let half = V::splat(0.5);
        let one = V::splat(1.0);
        // Places are above -½: adding 1 makes rounding towards zero a floor.
        let (x, y) = (plane.x * scale + half, plane.y * scale + half);
        let (cx, cy) = (x.to_int(), y.to_int());
        let (fx, fy) = (x - cx.to_float(), y - cy.to_float());
        let last = V::Int::splat(self.side as i32 - 1);
        let (before, zero) = (V::Int::splat(1), V::Int::splat(0));
        let x = cx.min(V::Int::splat(self.side as i32));
        let ys = [(cy - before).max(zero), cy.min(last)];
        let (sx, sy) = (plane.slope_x * (one / scale), plane.slope_y * (one / scale));
        let (ax, ay) = (sx.max(sx.neg()), sy.max(sy.neg()));
        let on = V::splat(ON) * plane.w * plane.w + half * (ax + ay);
        let (mut sum, mut weights) = (V::zero(), V::zero());
        for layer in &self.layers {
            for (j, wy) in [one - fy, fy].into_iter().enumerate() {
                let dy = if j == 0 { fy.neg() } else { one - fy };
                let (a, b) = (ys[j] * V::Int::splat(self.side as i32 + 2) + x).gather_pairs(layer);
                for (i, wx) in [one - fx, fx].into_iter().enumerate() {
                    let dx = if i == 0 { fx.neg() } else { one - fx };
                    let texel = if i == 0 { a } else { b };
                    let w = texel.shift_right::<8>().to_float() * V::splat(self.nearest / STEPS);
                    let share = texel.and(V::Int::splat(255)).to_float();
                    let off = w - (plane.w + sx * dx + sy * dy);
                    let weight = (wx * wy).and(on.ge(off.max(off.neg())));
                    weights = weights + weight;
                    sum = sum + weight * share;
                }
            }
            if less(weights, V::splat(0.999)).mask_bits() == 0 {
                break;
            }
        }
        let known = weights.ge(V::splat(ENOUGH));
        (sum * V::splat(1.0 / 255.0) / weights.max(V::splat(1e-6)), known)
    }
}

fn fixed(v: f32, largest: f32) -> u32 {
    (v.clamp(0.0, 1.0) * largest + 0.5) as u32
}

/// What is nearest at the centres of a view's pixels.
struct Surfaces {
    inverse_depth: Vec<f32>,
    /// Index into the setups plus one; 0 where there is nothing.
    nearest: Vec<u32>,
}

impl Surfaces {
    /// The nearest surfaces, or the nearest ones behind `front`.
    fn new(view: &View, binned: &Binned, front: Option<&Self>) -> Self {
        let w = view.width as usize;
        let mut out =
            Self { inverse_depth: vec![0.0; w * view.height as usize], nearest: vec![0; w * view.height as usize] };
        let band = TILE_HEIGHT * w;
        let behind = |at: usize| {
            let front = front.map_or(f32::MAX, |f| f.inverse_depth[at]);
            front / (1.0 + APART * front)
        };
        out.inverse_depth.par_chunks_mut(band).zip(out.nearest.par_chunks_mut(band)).enumerate().for_each_init(
            || Tile::new(view, 1),
            |tile, (ty, (depths, nearest))| {
                for tx in 0..binned.tiles_x {
                    if binned.is_empty(tx, ty) {
                        continue;
                    }
                    let columns = tx * TILE_WIDTH..((tx + 1) * TILE_WIDTH).min(w);
                    tile.reset(tx * TILE_WIDTH, ty * TILE_HEIGHT);
                    if front.is_some() {
                        tile.limit(|x, y| if x < w { behind(y * w + x) } else { 0.0 });
                    }
                    tile.draw_centers(binned);
                    for row in 0..depths.len() / w {
                        let n = columns.len();
                        let to = row * w + columns.start..row * w + columns.end;
                        depths[to.clone()].copy_from_slice(&tile.center_depths(row)[..n]);
                        nearest[to].copy_from_slice(&tile.center_keys(row)[..n]);
                    }
                }
            },
        );
        out
    }
}
