//! Patterns and colours drawn anew on things of any category, so that a pattern says nothing about what wears
//! it: the holes of a colander and the dots of a plate are told apart by shape.
//!
//! Stripes, checks, scattered spots, blotches, a dipped edge and plain paint in any hue. What stood on the
//! material before (grain, marks of a ruler) stays as light and dark. No development or
//! evaluation finish is drawn as it is, but some are like in kind (dots, check, gradient, pinstripe), and any hue is
//! drawn: what stays apart between the splits are shapes and proportions, not colours and not the kinds of pattern.

use std::f32::consts::TAU;
use std::sync::Arc;

use fuse_render::{Material, Model, Texture};
use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::objects::dice::hsv;
use crate::objects::texture::{Canvas, Noise};

/// Share of the things that are painted.
pub const SHARE: f64 = 0.4;
/// Share of a painted thing's materials that get paint.
const MATERIALS: f64 = 0.75;
/// Texels of a painted texture, at least.
const TEXELS: u32 = 128;

#[derive(Clone, Copy)]
enum Pattern {
    Plain,
    /// Waves a tile along u and v; share of a wave that is painted.
    Stripes(Vec2, f32),
    Checks(Vec2, f32),
    /// Cells a tile, radius in cells, at least and at most.
    Spots((u32, u32), f32, f32),
    /// Cells a tile, level.
    Blotches((u32, u32), f32),
    /// Below this v.
    Dipped(f32),
    Shaded,
}

/// The model with some of its materials painted.
pub fn painted(mut model: Model, rng: &mut ChaCha8Rng) -> Model {
    let base = color(rng);
    for material in &mut model.materials {
        if rng.random::<f64>() >= MATERIALS || material.base_color[3] < 1.0 {
            continue;
        }
        let base = if rng.random::<f32>() < 0.6 { base } else { color(rng) };
        let texture = paint(material, pattern(rng), base, color(rng), Noise(rng.random()));
        material.base_color_texture = Some(texture);
        material.base_color = [1.0; 4];
        // Enamel on metal shines no more like metal.
        if rng.random::<f32>() < 0.6 {
            material.metallic = 0.0;
            material.roughness = rng.random_range(0.2..0.9);
        }
    }
    model
}

/// Any hue; as often pale, grey or dark as lively.
fn color(rng: &mut ChaCha8Rng) -> Vec3 {
    let saturation = if rng.random::<f32>() < 0.5 { rng.random_range(0.0..0.2) } else { rng.random_range(0.3..0.95) };
    hsv(rng.random(), saturation, rng.random_range(0.12..0.97))
}

fn pattern(rng: &mut ChaCha8Rng) -> Pattern {
    let cells = |rng: &mut ChaCha8Rng| (rng.random_range(3..=16), rng.random_range(3..=12));
    let waves = |rng: &mut ChaCha8Rng| {
        // Whole numbers close at the seam; one of them is often none: along or across.
        let (along, across) = (rng.random_range(2..=14), rng.random_range(2..=14));
        let oblique = rng.random_range(0..3);
        Vec2::new(if oblique == 1 { 0.0 } else { along as f32 }, if oblique == 2 { 0.0 } else { across as f32 })
    };
    match rng.random_range(0..10) {
        0 => Pattern::Plain,
        1 => Pattern::Shaded,
        2 => Pattern::Dipped(rng.random_range(0.2..0.8)),
        3 | 4 => Pattern::Stripes(waves(rng), rng.random_range(0.15..0.6)),
        5 => Pattern::Checks(waves(rng).max(Vec2::ONE), rng.random_range(0.3..0.6)),
        6 => Pattern::Blotches((rng.random_range(2..=7), rng.random_range(2..=7)), rng.random_range(0.4..0.6)),
        _ => {
            let low = rng.random_range(0.1..0.32);
            Pattern::Spots(cells(rng), low, low + rng.random_range(0.0..0.2))
        }
    }
}

fn paint(material: &Material, pattern: Pattern, base: Vec3, accent: Vec3, noise: Noise) -> Arc<Texture> {
    let before = material.base_color_texture.as_deref();
    let size = |texels: fn(&Texture) -> u32| before.map_or(TEXELS, texels).max(TEXELS);
    let relief = Relief::of(before);
    Canvas::new(size(|t| t.width), size(|t| t.height), base)
        .each(|uv, _| {
            let wave = |n: Vec2| (uv * n).element_sum().rem_euclid(1.0);
            let share = match pattern {
                Pattern::Plain => 0.0,
                Pattern::Stripes(n, width) => f32::from(wave(n) < width),
                Pattern::Checks(n, width) => {
                    f32::from((wave(Vec2::new(n.x, 0.0)) < width) != (wave(Vec2::new(0.0, n.y)) < width))
                }
                Pattern::Spots(cells, low, high) => {
                    f32::from(noise.spots(uv, cells) < low + (high - low) * noise.smooth(uv, (5, 5)))
                }
                Pattern::Blotches(cells, level) => f32::from(noise.cloud(uv, cells) > level),
                Pattern::Dipped(edge) => f32::from(uv.y > edge),
                Pattern::Shaded => 0.5 - 0.5 * (TAU * uv.y).cos(),
            };
            base.lerp(accent, share) * relief.at(uv)
        })
        .texture()
}

/// How light a texture is at a place, over its mean.
struct Relief<'a> {
    texture: Option<&'a Texture>,
    mean: f32,
}

impl<'a> Relief<'a> {
    fn of(texture: Option<&'a Texture>) -> Self {
        let mean = texture.map_or(1.0, |t| {
            t.texels.iter().map(|texel| lightness(*texel)).sum::<f32>() / t.texels.len().max(1) as f32
        });
        Self { texture, mean: mean.max(1.0) }
    }

    fn at(&self, uv: Vec2) -> f32 {
        let Some(t) = self.texture else { return 1.0 };
        let along = |at: f32, texels: u32| ((at * texels as f32) as u32).min(texels - 1);
        let texel = t.texels[(along(uv.y, t.height) * t.width + along(uv.x, t.width)) as usize];
        (lightness(texel) / self.mean).clamp(0.4, 1.6)
    }
}

fn lightness([r, g, b, _]: [u8; 4]) -> f32 {
    0.30 * f32::from(r) + 0.59 * f32::from(g) + 0.11 * f32::from(b)
}
