//! Surfaces of the evaluation scenes: terrazzo, bamboo, slate, checkered cloth.

use glam::{IVec2, Vec2};

use super::{Tone, below, cellular, cloth, fractal, hash, unit};

/// Chips of three sizes; about a third of them has the second colour.
pub(super) fn terrazzo(p: Vec2, seed: u64) -> Tone {
    let mut tone = Tone::new(0.0, 0.10 * fractal(p * 120.0, seed ^ 0x3, 2) + 0.08 * fractal(p * 7.0, seed ^ 0x5, 4));
    for (i, size) in [0.007f32, 0.016, 0.036].into_iter().enumerate() {
        let bent = p + 0.25 * size * Vec2::new(fractal(p / size, seed ^ 0x7, 2), fractal(p / size, seed ^ 0x9, 2));
        let (d, h) = cellular(bent / size, seed ^ (0x100 + i as u64));
        let chip = below(d, 0.2 + 0.22 * unit(h, 2), 0.05) * f32::from(unit(h, 3) < 0.75);
        tone.accent += (chip * f32::from(unit(h, 1) < 0.4) - tone.accent * chip) * chip;
        tone.light += chip * (0.9 * (unit(h, 0) - 0.6) - tone.light);
    }
    Tone::new(tone.accent.clamp(0.0, 1.0), tone.light)
}

/// Strips 22 mm wide with nodes every 30 cm or so and fine fibres.
pub(super) fn bamboo(p: Vec2, seed: u64) -> Tone {
    let strip = (p.y / 0.022).floor();
    let f = p.y / 0.022 - strip;
    let h = hash(IVec2::new(strip as i32, 3), seed);
    let along = p.x / (0.24 + 0.12 * unit(h, 0)) + unit(h, 1) * 7.0;
    let node = along - along.floor() - 0.5 + 0.004 * fractal(Vec2::new(p.y * 300.0, along), seed ^ 0x5, 2);
    let ring = below(node.abs(), 0.008, 0.010);
    let fibre = fractal(Vec2::new(p.x * 14.0, p.y * 900.0), seed ^ 0x7, 3);
    let mottle = fractal(Vec2::new(p.x * 9.0, p.y * 50.0 + unit(h, 2) * 40.0), seed ^ 0x9, 4);
    let seam = below(f.min(1.0 - f), 0.02, 0.03);
    Tone::new(
        (0.8 * ring + 0.35 * mottle + 0.3 * unit(h, 3) + 0.25 * fibre).clamp(0.0, 1.0),
        0.2 * fibre + 0.3 * (unit(h, 2) - 0.5) - 0.45 * seam - 0.25 * ring,
    )
}

/// Slabs of 40 by 20 cm, split unevenly: ledges, pits and rusty clouds.
pub(super) fn slate(p: Vec2, seed: u64) -> Tone {
    let row = (p.y / 0.2).floor();
    let q = Vec2::new(p.x / 0.4 + 0.37 * row, p.y / 0.2);
    let cell = q.floor();
    let f = q - cell;
    let h = hash(cell.as_ivec2(), seed);
    let local = p + Vec2::new(unit(h, 0), unit(h, 1)) * 30.0;
    let relief = fractal(local * Vec2::new(9.0, 16.0), seed ^ 0x3, 6);
    // Where the relief crosses a level, a sheet has broken off.
    let ledge = below((relief * 5.0 - (relief * 5.0).round()).abs(), 0.03, 0.06);
    let rust = below(-fractal(local * 5.0, seed ^ 0x5, 4), -0.18, 0.25);
    let grain = fractal(p * 160.0, seed ^ 0x7, 2);
    let joint = below((f.x.min(1.0 - f.x) * 2.0).min(f.y.min(1.0 - f.y)), 0.012, 0.012);
    Tone::new(
        (0.7 * rust + 0.25 * relief).clamp(0.0, 1.0),
        0.5 * (relief * 5.0).round() / 5.0 - 0.3 * ledge + 0.12 * grain + 0.25 * (unit(h, 2) - 0.5) - 0.5 * joint,
    )
}

/// Squares of 35 mm woven in two colours, half-toned where warp and weft differ.
pub(super) fn checkered(p: Vec2, seed: u64) -> Tone {
    let side = |v: f32| (v / 0.035).floor().rem_euclid(2.0);
    let weave = cloth(p, seed);
    let (warp, weft) = (side(p.x), side(p.y));
    let twill = ((p.x + p.y) * 1400.0).sin() * 0.06;
    Tone::new(
        (0.5 * (warp + weft) * (0.88 + 0.24 * weave.accent) + 0.12 * weave.accent + twill * (warp - weft).abs())
            .clamp(0.0, 1.0),
        0.8 * weave.light + twill,
    )
}
