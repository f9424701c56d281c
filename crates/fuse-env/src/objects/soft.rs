//! Sponges and towels.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::Workshop;
use super::finish::{cloth, foam, scourer};
use super::shape::{Ends, Surface};
use super::sweep::rounded_rectangle;
use super::texture::Noise;

/// A kitchen sponge, most often with a scouring layer.
pub fn sponge(w: &mut Workshop) {
    let shape = w.shape();
    let size = Vec3::new(
        w.dice.range(0.090, 0.120),
        w.dice.range(0.058, 0.076),
        if shape == "thick" { w.dice.range(0.040, 0.048) } else { w.dice.range(0.024, 0.036) },
    );
    let corner = match shape {
        "oval" => size.y * 0.47,
        "rounded" => size.y * w.dice.range(0.22, 0.36),
        _ => w.dice.range(0.003, 0.009),
    };
    let waist = if shape == "waisted" { w.dice.range(0.08, 0.2) } else { 0.0 };
    let wave = if shape == "wavy" { 0.06 } else { 0.0 };
    let form = move |p: Vec3| {
        let t = p.x / size.x * 2.0;
        let pinch = 1.0 - waist * (1.0 - t * t).max(0.0) + wave * (t * 9.0).sin();
        Vec3::new(p.x, p.y * pinch, p.z)
    };
    let layered = w.dice.chance(0.85);
    let scour = if layered { size.z * w.dice.range(0.18, 0.30) } else { 0.0 };
    let body = size.z - scour;
    let tone = match w.dice.pick(&[0, 0, 0, 1, 2]) {
        0 => w.dice.tint(Vec3::new(0.95, 0.80, 0.28), 0.08),
        1 => w.dice.color((0.35, 0.7), (0.75, 0.95)),
        _ => w.dice.color((0.55, 0.85), (0.7, 0.95)),
    };
    let soft = w.material(|d| foam(d, tone));
    let top = w.dice.chance(0.6);
    let noise = Noise(w.dice.seed());
    let low = if top || !layered { 0.0 } else { scour };
    let bumps = |p: Vec3| {
        let k = noise.cloud(Vec2::new(p.x * 7.0 + p.z * 3.0, p.y * 7.0 - p.z * 2.0), (5, 5)) - 0.5;
        p + Vec3::new(0.002 * k, 0.002 * k, 0.0)
    };
    let block = slab(Vec3::new(size.x, size.y, body), corner).map(form).map(bumps).moved(Vec3::Z * (low + body / 2.0));
    w.add(block.uv_box(Vec2::splat(0.05)), soft, 40.0);
    if layered {
        let tone = match w.dice.pick(&[0, 0, 1]) {
            0 => w.dice.tint(Vec3::new(0.16, 0.42, 0.22), 0.2),
            _ => w.dice.color((0.5, 0.85), (0.25, 0.55)),
        };
        let rough = w.material(|d| scourer(d, tone));
        let z = if top { body + scour / 2.0 } else { scour / 2.0 };
        let pad = slab(Vec3::new(size.x * 1.004, size.y * 1.004, scour), corner).map(form).moved(Vec3::Z * z);
        w.add(pad.uv_box(Vec2::splat(0.05)), rough, 40.0);
    }
    w.settle();
}

/// A rounded slab cut into slices along x, so that it can be bent.
fn slab(size: Vec3, corner: f32) -> Surface {
    let half = size / 2.0;
    let steps = 26;
    let rings: Vec<Vec<Vec3>> = (0..=steps)
        .map(|i| {
            let t = 2.0 * i as f32 / steps as f32 - 1.0;
            // Denser at the ends, where the corners are.
            let x = half.x * (PI / 2.0 * t).sin();
            let into = (corner - (half.x - x.abs())).max(0.0);
            let y = (half.y - corner) + (corner * corner - into * into).max(0.0).sqrt();
            let e = 0.0022f32.min(half.z * 0.6);
            // Upper and lower edges are rounded too, also over the two ends.
            let end = (1.0 - ((x.abs() - (half.x - e)) / e).clamp(0.0, 1.0).powi(2)).sqrt().max(0.4);
            let z = half.z - e * (1.0 - end);
            rounded_rectangle(y.max(e * 1.1), z, e, 3).iter().map(|p| Vec3::new(x, p.x, p.y)).collect()
        })
        .collect();
    Surface::loft(&rings, Ends::Capped)
}

/// The middle line of a towel's folded section in x and z, lying on z = `t / 2`.
fn fold_path(shape: &str, width: f32, t: f32, layers: usize) -> Vec<Vec2> {
    let mut path = vec![];
    if shape == "rolled" {
        let turns = 3.2;
        let (inner, steps) = (t * 0.9, 56);
        for i in 0..=steps {
            let a = TAU * turns * i as f32 / steps as f32;
            let r = inner + t * 1.06 * a / TAU;
            path.push(Vec2::new(r * a.cos(), r * a.sin()));
        }
        return path;
    }
    let pitch = t * 1.06;
    for layer in 0..layers {
        let z = t / 2.0 + pitch * layer as f32;
        // The free edges and upper folds draw back a little.
        let inset = 0.004 * layer as f32;
        let (a, b) = (-width / 2.0 + inset, width / 2.0 - inset);
        let (from, to) = if layer % 2 == 0 { (a, b) } else { (b, a) };
        for i in 0..=9 {
            path.push(Vec2::new(from + (to - from) * i as f32 / 9.0, z));
        }
        if layer + 1 < layers {
            for k in 1..4 {
                let (s, c) = (PI * k as f32 / 4.0 - PI / 2.0).sin_cos();
                path.push(Vec2::new(to + (to - from).signum() * c * pitch / 2.0, z + pitch / 2.0 + s * pitch / 2.0));
            }
        }
    }
    path
}

/// A folded (or rolled) towel: one ribbon of cloth, swept along y.
pub fn towel(w: &mut Workshop) {
    let shape = w.shape();
    let (width, depth, layers) = match shape {
        "half" => (w.dice.range(0.17, 0.23), w.dice.range(0.15, 0.20), 2),
        "thirds" => (w.dice.range(0.15, 0.20), w.dice.range(0.18, 0.24), 3),
        "wide" => (w.dice.range(0.22, 0.25), w.dice.range(0.13, 0.15), 3),
        "rolled" => (0.0, w.dice.range(0.19, 0.23), 1),
        "tall" => (w.dice.range(0.16, 0.18), w.dice.range(0.19, 0.21), 5),
        "runner" => (w.dice.range(0.105, 0.115), w.dice.range(0.24, 0.27), 3),
        _ => (w.dice.range(0.16, 0.22), w.dice.range(0.16, 0.21), 4),
    };
    let t = w.dice.range(0.0062, 0.0100);
    let path = fold_path(shape, width, t, layers);
    let total: f32 = path.windows(2).map(|p| p[0].distance(p[1])).sum();
    let tall = path.iter().map(|p| p.y).fold(0.0, f32::max) + t / 2.0;
    let noise = Noise(w.dice.seed());
    let ripple = w.dice.range(0.0008, 0.0024);
    let skew = w.dice.range(0.0, 0.006);
    let steps = if shape == "rolled" { 10 } else { 18 };
    let rings: Vec<Vec<Vec3>> = (0..=steps)
        .map(|j| {
            let y = depth * (j as f32 / steps as f32 - 0.5);
            let edge = if j == 0 || j == steps { 0.55 } else { 1.0 };
            ribbon(&path, t / 2.0 * edge)
                .iter()
                .map(|p| {
                    let uv = Vec2::new(p.x * 2.3 + 0.5, y * 2.3 + 0.5 + p.y * 3.0);
                    let sag = ripple * (noise.cloud(uv, (4, 4)) - 0.5) * 2.0 * (p.y / tall).clamp(0.0, 1.0);
                    let drift = skew * p.y / tall * (noise.0 % 3) as f32 * 0.5;
                    Vec3::new(
                        p.x + ripple * 1.5 * (noise.smooth(Vec2::new(y * 3.0, p.y * 40.0), (3, 3)) - 0.5),
                        y * (1.0 + 0.3 * drift) + drift,
                        p.y + sag,
                    )
                })
                .collect()
        })
        .collect();
    let half = path.len();
    let body = cloth_surface(&rings, half, total, depth);
    let stuff = w.material(cloth);
    w.add(body, stuff, 75.0);
    w.settle();
}

/// The outline of a ribbon of half thickness `half` around a path: there on the right, back on
/// the left; both have as many points as the path.
fn ribbon(path: &[Vec2], half: f32) -> Vec<Vec2> {
    let last = path.len() - 1;
    let side = |i: usize, sign: f32| {
        let direction = (path[(i + 1).min(last)] - path[i.saturating_sub(1)]).normalize_or_zero();
        let pinch = if i == 0 || i == last { 0.6 } else { 1.0 };
        path[i] + direction.perp() * (-sign * half * pinch)
    };
    let mut ring: Vec<Vec2> = (0..=last).map(|i| side(i, 1.0)).collect();
    ring.extend((0..=last).rev().map(|i| side(i, -1.0)));
    ring
}

/// Joins ribbon outlines; the two ends are closed by a strip between the outline's sides.
fn cloth_surface(rings: &[Vec<Vec3>], half: usize, total: f32, depth: f32) -> Surface {
    let n = rings[0].len();
    let mut faces = vec![];
    let at = |j: usize, k: usize| (j * n + k % n) as u32;
    // Position along the ribbon, the same on both of its sides; one texture tile per 35 cm.
    let along = |k: usize| {
        let k = k % n;
        let i = if k < half { k } else { 2 * half - 1 - k };
        i as f32 / (half - 1) as f32 * total / 0.35
    };
    let across = |j: usize| j as f32 / (rings.len() - 1) as f32 * depth / depth;
    let mut quad = |c: [(u32, Vec2); 4]| {
        for [a, b, d] in [[c[0], c[1], c[2]], [c[0], c[2], c[3]]] {
            faces.push(super::shape::Face { at: [a.0, b.0, d.0], uv: [a.1, b.1, d.1] });
        }
    };
    for j in 0..rings.len() - 1 {
        for k in 0..n {
            let corner = |j: usize, k: usize| (at(j, k), Vec2::new(along(k), across(j)));
            quad([corner(j, k), corner(j, k + 1), corner(j + 1, k + 1), corner(j + 1, k)]);
        }
    }
    for (j, flip) in [(0, true), (rings.len() - 1, false)] {
        for i in 0..half - 1 {
            let corner = |k: usize| (at(j, k), Vec2::new(along(k), across(j)));
            let c = [corner(i), corner(i + 1), corner(n - 2 - i), corner(n - 1 - i)];
            quad(if flip { [c[3], c[2], c[1], c[0]] } else { c });
        }
    }
    Surface { points: rings.concat(), faces }.map(|p| p)
}
