//! Procedural surfaces: wood, stone, tiles, brick, plaster, wallpaper, concrete, cloth, laminate.
//!
//! Every pattern is a function of the position in metres, so features have real sizes, and is made
//! of several scales (centimetres to a millimetre) that never repeat: feature matchers need both.

mod patterns;

use std::sync::Arc;

use fuse_render::Texture;
use glam::{IVec2, Vec2, Vec3};
use rayon::prelude::*;

use crate::configuration::{Surface, SurfaceKind};

/// A reproducible integer hash of a lattice point (finaliser of SplitMix64).
pub fn hash(cell: IVec2, seed: u64) -> u64 {
    let packed = (cell.x as u32 as u64) | ((cell.y as u32 as u64) << 32);
    let mut z = packed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ seed.wrapping_mul(0xD1B5_4A32_D192_ED03);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// A number in [0, 1) from 16 bits of a hash; `lane` in 0..4.
fn unit(hash: u64, lane: u32) -> f32 {
    ((hash >> (16 * lane)) & 0xFFFF) as f32 / 65536.0
}

/// Value noise in [-1, 1] with unit lattice.
fn noise(p: Vec2, seed: u64) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let s = f * f * (Vec2::splat(3.0) - 2.0 * f);
    let c = cell.as_ivec2();
    let at = |dx, dy| unit(hash(c + IVec2::new(dx, dy), seed), 0);
    let top = at(0, 0) + (at(1, 0) - at(0, 0)) * s.x;
    let bottom = at(0, 1) + (at(1, 1) - at(0, 1)) * s.x;
    2.0 * (top + (bottom - top) * s.y) - 1.0
}

/// `Σ noise(2^i p) / 2^i` over `octaves`, normalised to about [-1, 1].
fn fractal(mut p: Vec2, seed: u64, octaves: u32) -> f32 {
    let (mut sum, mut amplitude, mut total) = (0.0, 1.0, 0.0);
    for i in 0..octaves {
        sum += amplitude * noise(p, seed.wrapping_add(u64::from(i) * 7919));
        total += amplitude;
        amplitude *= 0.55;
        p = Vec2::new(p.x * 1.9 - p.y * 0.7, p.x * 0.7 + p.y * 1.9);
    }
    sum / total
}

/// Nearest of one jittered point a cell: `(distance in cells, hash of that point)`.
fn cellular(p: Vec2, seed: u64) -> (f32, u64) {
    let base = p.floor().as_ivec2();
    let mut best = (f32::MAX, 0);
    for dy in -1..=1 {
        for dx in -1..=1 {
            let cell = base + IVec2::new(dx, dy);
            let h = hash(cell, seed);
            let point = cell.as_vec2() + Vec2::new(unit(h, 0), unit(h, 1));
            let d = point.distance_squared(p);
            if d < best.0 {
                best = (d, h);
            }
        }
    }
    (best.0.sqrt(), best.1)
}

/// 1 inside `edge`, 0 beyond `edge + soft`.
fn below(value: f32, edge: f32, soft: f32) -> f32 {
    (1.0 - (value - edge) / soft).clamp(0.0, 1.0)
}

/// How a point deviates from the main colour: a mix towards the accent and a brightness change.
#[derive(Clone, Copy, Default)]
struct Tone {
    accent: f32,
    light: f32,
}

impl Tone {
    fn new(accent: f32, light: f32) -> Self {
        Self { accent, light }
    }
}

fn wood(p: Vec2, seed: u64) -> Tone {
    let plank = (p.y / 0.115).floor();
    let h = hash(IVec2::new(plank as i32, 0), seed);
    // Boards of one row butt against each other at irregular places.
    let along = p.x + unit(h, 0) * 3.0;
    let board = (along / 0.9).floor();
    let hb = hash(IVec2::new(plank as i32, board as i32), seed ^ 0x51);
    let q = Vec2::new(along, p.y + unit(hb, 0) * 40.0);
    let (knot, hk) = cellular(q / Vec2::new(0.34, 0.1), seed ^ 0x77);
    let knotted = unit(hk, 2) < 0.45;
    let radius = if knotted { 0.05 + 0.10 * unit(hk, 3) } else { 0.0 };
    let around = if knotted { (-knot * 5.0).exp() } else { 0.0 };
    let warp = 0.35 * fractal(q * Vec2::new(4.0, 14.0), seed ^ 0x13, 3) + 2.2 * around;
    let rings = ((q.y * 95.0 + warp * 6.0 + unit(hb, 1) * 9.0).sin() * 0.5 + 0.5).powf(2.2);
    let fibre = fractal(q * Vec2::new(26.0, 620.0), seed ^ 0x29, 3);
    let blotch = fractal(q * Vec2::new(5.0, 16.0), seed ^ 0x31, 4);
    let core = below(knot, radius, 0.03) * f32::from(knotted);
    let seam = below((p.y / 0.115 - plank).min(1.0 - (p.y / 0.115 - plank)), 0.006, 0.01).max(below(
        (along / 0.9 - board).min(1.0 - (along / 0.9 - board)),
        0.0009,
        0.0012,
    ));
    Tone::new(
        (0.42 * rings + 0.22 * blotch + 0.95 * core).clamp(0.0, 1.0),
        0.16 * fibre + 0.22 * (unit(hb, 2) - 0.5) + 0.16 * blotch - 0.5 * seam - 0.25 * core,
    )
}

fn stone(p: Vec2, seed: u64) -> Tone {
    let (small, hs) = cellular(p / 0.0045, seed ^ 0x3);
    let (large, hl) = cellular(p / 0.017, seed ^ 0x5);
    let cloud = fractal(p * 9.0, seed ^ 0x7, 5);
    let warp = Vec2::new(fractal(p * 5.0, seed ^ 0xB, 3), fractal(p * 5.0, seed ^ 0xD, 3));
    let vein = below(fractal(p * 4.0 + warp * 1.6, seed ^ 0x11, 4).abs(), 0.012, 0.045);
    let crystal = below(large, 0.22 + 0.2 * unit(hl, 2), 0.06) * f32::from(unit(hl, 3) < 0.5);
    let grain = (unit(hs, 2) - 0.5) * below(small, 0.45, 0.2);
    Tone::new(
        (0.35 * cloud + 0.55 * vein + 0.6 * crystal * unit(hl, 1)).clamp(0.0, 1.0),
        0.55 * grain + 0.22 * cloud + 0.35 * crystal * (unit(hl, 0) - 0.55),
    )
}

fn tiles(p: Vec2, seed: u64) -> Tone {
    let q = p / 0.3;
    let cell = q.floor();
    let f = q - cell;
    let h = hash(cell.as_ivec2(), seed);
    let local = p + Vec2::new(unit(h, 0), unit(h, 1)) * 50.0;
    let cloud = fractal(local * 14.0, seed ^ 0x3, 5);
    let vein = below(fractal(local * 9.0, seed ^ 0x9, 4).abs(), 0.015, 0.05);
    let edge = f.min(Vec2::ONE - f).min_element();
    let grout = below(edge, 0.012, 0.008);
    // A worn ornament in the middle of each tile, at its own angle and size.
    let angle = unit(h, 2) * std::f32::consts::TAU;
    let d = Vec2::from_angle(angle).rotate(f - 0.5);
    let petal = (0.17 + 0.12 * unit(h, 3)) * (0.65 + 0.35 * (4.0 * d.y.atan2(d.x)).cos());
    let motif = below((d.length() - petal).abs(), 0.012, 0.012) * (0.6 + 0.4 * cloud);
    Tone::new(
        (0.75 * grout + 0.35 * vein + 0.55 * motif + 0.25 * cloud).clamp(0.0, 1.0),
        0.2 * cloud + 0.22 * (unit(h, 1) - 0.5) - 0.25 * grout,
    )
}

fn brick(p: Vec2, seed: u64) -> Tone {
    let row = (p.y / 0.078).floor();
    let shift = 0.5 * row.rem_euclid(2.0) + 0.06 * unit(hash(IVec2::new(row as i32, 1), seed), 0);
    let q = Vec2::new(p.x / 0.23 + shift, p.y / 0.078);
    let cell = q.floor();
    let f = q - cell;
    let h = hash(cell.as_ivec2(), seed ^ 0x21);
    let rough = fractal(p * 70.0, seed ^ 0x5, 4);
    let edge = (f.x.min(1.0 - f.x) * 2.9).min(f.y.min(1.0 - f.y)) + 0.05 * rough;
    let mortar = below(edge, 0.06, 0.05);
    let stain = fractal(p * 3.0, seed ^ 0x9, 4);
    Tone::new(
        (0.9 * mortar + 0.2 * stain).clamp(0.0, 1.0),
        (1.0 - mortar) * (0.55 * (unit(h, 0) - 0.5) + 0.2 * rough) + 0.15 * stain,
    )
}

fn plaster(p: Vec2, seed: u64) -> Tone {
    let cloud = fractal(p * 1.8, seed, 6);
    let stipple = fractal(p * 90.0, seed ^ 0x3, 2);
    let crack = below(fractal(p * 2.4, seed ^ 0x5, 6).abs(), 0.002, 0.006) * below(-cloud, -0.05, 0.1);
    Tone::new((0.45 * cloud + 0.8 * crack).clamp(0.0, 1.0), 0.16 * stipple + 0.18 * cloud - 0.2 * crack)
}

fn wallpaper(p: Vec2, seed: u64) -> Tone {
    let q = p / 0.14;
    let stagger = Vec2::new(0.5 * q.y.floor().rem_euclid(2.0), 0.0);
    let cell = (q + stagger).floor();
    let f = q + stagger - cell - 0.5;
    let h = hash(cell.as_ivec2(), seed);
    let d = Vec2::from_angle((unit(h, 0) - 0.5) * 1.4).rotate(f + 0.12 * Vec2::new(unit(h, 1) - 0.5, unit(h, 2) - 0.5));
    let diamond = below(d.x.abs() + d.y.abs(), 0.12 + 0.16 * unit(h, 3), 0.03);
    let leaves =
        below((d.length() - 0.3).abs(), 0.015, 0.02) * f32::from((5.0 * d.y.atan2(d.x) + unit(h, 1) * 6.0).sin() > 0.1);
    let stripe = 0.12 * (p.x * 45.0).sin();
    let paper = fractal(p * 60.0, seed ^ 0x3, 3);
    Tone::new((0.8 * diamond + 0.7 * leaves + stripe).clamp(0.0, 1.0), 0.1 * paper + 0.3 * (unit(h, 2) - 0.5) * diamond)
}

fn concrete(p: Vec2, seed: u64) -> Tone {
    let cloud = fractal(p * 2.2, seed, 6);
    let sand = fractal(p * 150.0, seed ^ 0x3, 2);
    let (pit, h) = cellular(p / 0.03, seed ^ 0x5);
    let hole = below(pit, 0.10 + 0.22 * unit(h, 2), 0.05) * f32::from(unit(h, 3) < 0.35);
    let spill = below(fractal(p * 1.6, seed ^ 0x9, 5), -0.25, 0.05);
    let joint = below((p / 1.3 - (p / 1.3).floor()).min_element(), 0.004, 0.003);
    Tone::new(
        (0.4 * cloud + 0.7 * hole + 0.35 * spill + 0.8 * joint).clamp(0.0, 1.0),
        0.14 * sand + 0.25 * cloud - 0.3 * hole - 0.12 * spill,
    )
}

fn cloth(p: Vec2, seed: u64) -> Tone {
    let thread = (p.x * 900.0).sin() * (p.y * 900.0).sin();
    let stripe = (unit(hash(IVec2::new((p.x / 0.021).floor() as i32, 0), seed), 0)
        + unit(hash(IVec2::new(0, (p.y / 0.021).floor() as i32), seed), 1))
        * 0.5;
    let slub = fractal(p * Vec2::new(30.0, 400.0), seed ^ 0x3, 2) + fractal(p * Vec2::new(400.0, 30.0), seed ^ 0x5, 2);
    let blotch = fractal(p * 6.0, seed ^ 0x7, 4);
    Tone::new((stripe - 0.25 + 0.2 * blotch).clamp(0.0, 1.0), 0.06 * thread + 0.14 * slub + 0.12 * blotch)
}

fn laminate(p: Vec2, seed: u64) -> Tone {
    Tone::new(0.3 * fractal(p * 3.0, seed, 3).max(0.0), 0.06 * fractal(p * 120.0, seed ^ 0x3, 2))
}

/// Scratches, speckle and stains of use, at three sizes.
fn wear(p: Vec2, seed: u64) -> f32 {
    let mut light = 0.0;
    for (i, size) in [0.011f32, 0.037, 0.12].into_iter().enumerate() {
        let (d, h) = cellular(p / size, seed ^ (0x1000 + i as u64));
        if unit(h, 2) < 0.5 {
            let radius = 0.06 + 0.16 * unit(h, 3);
            light += (unit(h, 1) - 0.55) * below(d, radius, 0.06) * 0.9;
        }
    }
    // A scratch is a thin line through a cell at its own angle.
    let cell = (p / 0.09).floor();
    let h = hash(cell.as_ivec2(), seed ^ 0x2000);
    if unit(h, 0) < 0.7 {
        let d = Vec2::from_angle(unit(h, 1) * std::f32::consts::PI).rotate(p / 0.09 - cell - 0.5);
        let bend = 0.06 * (d.x * 5.0 + unit(h, 2) * 6.0).sin();
        let ends = below(d.x.abs(), 0.15 + 0.25 * unit(h, 3), 0.1);
        light += (unit(h, 2) - 0.6) * 0.7 * below((d.y - bend).abs(), 0.008, 0.012) * ends;
    }
    light
}

fn to_linear(c: [u8; 3]) -> Vec3 {
    Vec3::from_array(c.map(|v| (f32::from(v) / 255.0).powf(2.2)))
}

/// sRGB colour of `surface` at `p` metres from its corner.
fn color(surface: &Surface, base: Vec3, accent: Vec3, p: Vec2) -> [u8; 4] {
    let q = p / surface.scale;
    let seed = surface.seed;
    let tone = match surface.kind {
        SurfaceKind::Wood => wood(q, seed),
        SurfaceKind::Stone => stone(q, seed),
        SurfaceKind::Tiles => tiles(q, seed),
        SurfaceKind::Brick => brick(q, seed),
        SurfaceKind::Plaster => plaster(q, seed),
        SurfaceKind::Wallpaper => wallpaper(q, seed),
        SurfaceKind::Concrete => concrete(q, seed),
        SurfaceKind::Cloth => cloth(q, seed),
        SurfaceKind::Laminate => laminate(q, seed),
        SurfaceKind::Terrazzo => patterns::terrazzo(q, seed),
        SurfaceKind::Bamboo => patterns::bamboo(q, seed),
        SurfaceKind::Slate => patterns::slate(q, seed),
        SurfaceKind::Checkered => patterns::checkered(q, seed),
    };
    let worn = if surface.wear > 0.0 { surface.wear * wear(p, seed) } else { 0.0 };
    let mixed = base.lerp(accent, (tone.accent * surface.contrast).clamp(0.0, 1.0));
    // Brightness changes are perceptual: a factor of two for each 0.5.
    let linear = mixed * (2.0 * (tone.light * surface.contrast + worn)).exp2();
    let srgb = linear.clamp(Vec3::ZERO, Vec3::ONE).powf(1.0 / 2.2) * 255.0;
    [srgb.x.round() as u8, srgb.y.round() as u8, srgb.z.round() as u8, 255]
}

/// Paints `surface` over `size` metres; the longer side has `surface.texels` texels. Texel `(0, 0)`
/// is at `(0, 0)` metres.
pub fn paint(surface: &Surface, size: Vec2) -> Arc<Texture> {
    let per_metre = surface.texels as f32 / size.max_element().max(1e-3);
    let width = ((size.x * per_metre).round() as u32).max(1);
    let height = ((size.y * per_metre).round() as u32).max(1);
    let (base, accent) = (to_linear(surface.base), to_linear(surface.accent));
    let mut texels = vec![[0; 4]; width as usize * height as usize];
    texels.par_chunks_mut(width as usize).enumerate().for_each(|(y, row)| {
        for (x, texel) in row.iter_mut().enumerate() {
            let p = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / per_metre;
            *texel = color(surface, base, accent, p);
        }
    });
    Arc::new(Texture { width, height, texels })
}

/// An abstract picture for a frame: a few bold shapes over a ground, `texels` a side.
pub fn picture(seed: u64, texels: u32) -> Arc<Texture> {
    let tint = |i: i32| {
        let h = hash(IVec2::new(i, 5), seed);
        Vec3::new(unit(h, 0), unit(h, 1), unit(h, 2)) * 0.8 + 0.1
    };
    let mut data = vec![[0; 4]; (texels * texels) as usize];
    data.par_chunks_mut(texels as usize).enumerate().for_each(|(y, row)| {
        for (x, texel) in row.iter_mut().enumerate() {
            let p = Vec2::new(x as f32, y as f32) / texels as f32;
            let mut c = tint(0) * (0.8 + 0.3 * fractal(p * 12.0, seed, 4));
            for i in 1..7 {
                let h = hash(IVec2::new(i, 9), seed);
                let d = Vec2::from_angle(unit(h, 3) * 6.3).rotate(p - Vec2::new(unit(h, 0), unit(h, 1)));
                let r = 0.08 + 0.22 * unit(h, 2);
                let inside = if i % 2 == 0 { d.length() < r } else { d.x.abs() < r && d.y.abs() < 0.4 * r };
                if inside {
                    c = tint(i) * (0.85 + 0.3 * noise(p * 60.0, seed ^ i as u64));
                }
            }
            let c = c.clamp(Vec3::ZERO, Vec3::ONE) * 255.0;
            *texel = [c.x as u8, c.y as u8, c.z as u8, 255];
        }
    });
    Arc::new(Texture { width: texels, height: texels, texels: data })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface(kind: SurfaceKind) -> Surface {
        Surface {
            kind,
            base: [150, 120, 90],
            accent: [70, 60, 50],
            contrast: 1.0,
            wear: 0.6,
            scale: 1.0,
            roughness: 0.6,
            texels: 256,
            seed: 3,
        }
    }

    const STRONG: [SurfaceKind; 8] = [
        SurfaceKind::Wood,
        SurfaceKind::Stone,
        SurfaceKind::Tiles,
        SurfaceKind::Cloth,
        SurfaceKind::Terrazzo,
        SurfaceKind::Bamboo,
        SurfaceKind::Slate,
        SurfaceKind::Checkered,
    ];

    /// Root mean square of horizontal differences after averaging over `block` texels.
    fn detail(t: &Texture, block: u32) -> f64 {
        let mean = |bx: u32, by: u32| {
            let sum: u32 = (0..block * block)
                .map(|i| u32::from(t.texels[((by * block + i / block) * t.width + bx * block + i % block) as usize][1]))
                .sum();
            f64::from(sum) / f64::from(block * block)
        };
        let (nx, ny) = (t.width / block, t.height / block);
        let total: f64 = (0..ny)
            .flat_map(|y| (1..nx).map(move |x| (x, y)))
            .map(|(x, y)| (mean(x, y) - mean(x - 1, y)).powi(2))
            .sum();
        (total / f64::from((nx - 1) * ny)).sqrt()
    }

    #[test]
    fn strong_surfaces_have_detail_at_every_scale_and_laminate_has_little() {
        for kind in STRONG {
            let t = paint(&surface(kind), Vec2::splat(0.4));
            for block in [1, 4, 16] {
                assert!(detail(&t, block) > 2.0, "{kind:?} at {block}: {}", detail(&t, block));
            }
        }
        let weak = Surface { contrast: 0.25, wear: 0.1, ..surface(SurfaceKind::Laminate) };
        assert!(detail(&paint(&weak, Vec2::splat(0.4)), 4) < 1.5);
    }

    #[test]
    fn patterns_depend_on_position_and_seed_only() {
        let s = surface(SurfaceKind::Stone);
        assert_eq!(paint(&s, Vec2::new(0.3, 0.2)), paint(&s, Vec2::new(0.3, 0.2)));
        assert_ne!(paint(&s, Vec2::new(0.3, 0.2)), paint(&Surface { seed: 4, ..s }, Vec2::new(0.3, 0.2)));
    }
}
