//! Things with many holes: colanders, sieves, graters.

use std::f32::consts::{FRAC_PI_4, TAU};

use glam::{Vec2, Vec3};

use super::Workshop;
use super::finish::{material, steel, wood};
use super::parts::{add_steel, dark_plastic, disc, grip_stuff, plain, shell, staggered, torus, vivid_plastic};
use super::sweep::{Tip, revolve, rounded_box, spline, tube};
use super::texture::{Canvas, Noise};

/// A bowl-shaped shell: `v` from the pole to the rim maps to `(radius, height)`, both fractions.
fn bowl_profile(shape: &str, v: f32) -> Vec2 {
    match shape {
        // A flat floor, then a steep wall.
        "pan" | "pot" => {
            let floor = 0.40;
            if v < floor {
                Vec2::new(0.74 * v / floor, 0.02 * v)
            } else {
                let t = (v - floor) / (1.0 - floor);
                Vec2::new(0.74 + 0.26 * t.sqrt(), 0.008 + 0.992 * t)
            }
        }
        "cone" => Vec2::new(v, v.powf(1.35)),
        "deep" => Vec2::new((v * 1.5).sin() / 1.5f32.sin(), (1.0 - (v * 1.5).cos()) / (1.0 - 1.5f32.cos())),
        _ => Vec2::new((v * 1.35).sin() / 1.35f32.sin(), (1.0 - (v * 1.35).cos()) / (1.0 - 1.35f32.cos())),
    }
}

/// A deep bowl full of holes, on a foot, with two ears.
pub fn colander(w: &mut Workshop) {
    let shape = w.shape();
    let radius = w.dice.range(0.098, 0.125);
    let height = radius * w.dice.range(0.80, 1.0) * if shape == "deep" { 1.15 } else { 1.0 };
    let wall = w.dice.range(0.0016, 0.0026);
    let rows = 14;
    let (first, last) = (w.dice.pick(&[3, 4]), rows - w.dice.pick(&[2, 3]));
    let body = shell(
        rows,
        40,
        |v, u| {
            let at = bowl_profile(shape, v);
            let out = Vec2::from_angle(u * TAU);
            let place = |r: f32, z: f32| (out * r).extend(z);
            let inside = (at.x * radius - wall * v).max(0.0);
            (place(at.x * radius, at.y * height), place(inside, at.y * height + wall * (1.3 - v)))
        },
        |r, c| staggered(r, c, first, last),
    );
    let metal = w.dice.chance(0.5);
    let skin = if metal { w.material(steel) } else { vivid_plastic(w) };
    w.add(if metal { body.uv_box(Vec2::splat(0.06)) } else { body }, skin, 40.0);
    let bead = torus(radius + 0.001, 0.0034, 0.0026, 2.5, 44).moved(Vec3::Z * height);
    w.add(bead, skin, 60.0);
    let foot = radius * w.dice.range(0.42, 0.52);
    let rise = bowl_profile(shape, 0.5).y.min(0.12) * height;
    let ring = revolve(
        &[
            Vec2::new(foot, -0.012),
            Vec2::new(foot + 0.003, -0.012),
            Vec2::new(foot + 0.002, rise),
            Vec2::new(foot - 0.001, rise),
        ],
        32,
    );
    // A tube wall, not a disc: joined end to end.
    let ring = super::shape::Surface::loft(&rings(&ring.points, 32), super::shape::Ends::Joined);
    w.add(ring, skin, 40.0);
    let (reach, span) = (w.dice.range(0.022, 0.034), w.dice.range(0.030, 0.042));
    let second = if w.dice.chance(0.6) { skin } else { dark_plastic(w) };
    for side in [-1.0f32, 1.0] {
        let path = spline(
            &[
                Vec3::new(radius * 0.975, -span, height - 0.004),
                Vec3::new(radius + reach * 0.7, -span * 0.9, height - 0.001),
                Vec3::new(radius + reach, 0.0, height),
                Vec3::new(radius + reach * 0.7, span * 0.9, height - 0.001),
                Vec3::new(radius * 0.975, span, height - 0.004),
            ],
            5,
        );
        let ear = tube(&path, Vec3::Z, 10, [Tip::Flat, Tip::Flat], |_| (0.0052, 0.0032));
        w.add(ear.map(|p| Vec3::new(p.x * side, p.y, p.z)), second, 60.0);
    }
    w.settle();
}

/// The first `4 n` points of a surface of revolution as four rings.
fn rings(points: &[Vec3], n: usize) -> Vec<Vec<Vec3>> {
    points[..4 * n].chunks(n).map(<[Vec3]>::to_vec).collect()
}

/// A kitchen sieve: a mesh bowl in a wire ring, a long handle and a rest across from it.
pub fn sieve(w: &mut Workshop) {
    let shape = w.shape();
    let radius = w.dice.range(0.062, 0.085);
    let height = radius
        * match shape {
            "cone" => 1.15,
            "shallow" => 0.62,
            _ => w.dice.range(0.74, 0.92),
        };
    let rows = 13;
    let mesh = shell(
        rows,
        36,
        |v, u| {
            let at = bowl_profile(shape, v);
            let out = Vec2::from_angle(u * TAU);
            let place = |r: f32, z: f32| (out * r).extend(z);
            let inside = (at.x * radius - 0.0009 * v).max(0.0);
            (place(at.x * radius, at.y * height), place(inside, at.y * height + 0.0009 * (1.2 - v)))
        },
        |r, c| r % 2 == 1 && r + 1 < rows && c % 2 == 0,
    );
    let noise = Noise(w.dice.seed());
    let tone = w.dice.tint(Vec3::splat(0.70), 0.12);
    let canvas = Canvas::new(32, 32, tone).each(|uv, c| {
        let thread = |x: f32| (x * 8.0).fract() < 0.45;
        if thread(uv.x) || thread(uv.y) { c * (0.95 + 0.1 * noise.smooth(uv, (8, 8))) } else { c * 0.45 }
    });
    let wires = w.material(|_| material("steel", &canvas, 0.4, 0.45));
    w.add(mesh.uv_box(Vec2::splat(0.016)), wires, 60.0);
    let plastic_frame = w.dice.chance(0.3);
    let frame = if plastic_frame { vivid_plastic(w) } else { w.material(steel) };
    let thick = w.dice.range(0.0022, 0.0036);
    w.add(torus(radius + 0.0008, thick * 0.8, thick * 1.2, 3.0, 40).moved(Vec3::Z * height), frame, 60.0);
    let length = w.dice.range(0.135, 0.18);
    let slope = w.dice.range(0.05, 0.22);
    let along = |x: f32| Vec3::new(-radius - x, 0.0, height + x * slope);
    let stem: Vec<Vec3> = (0..=6).map(|i| along(length * 0.5 * i as f32 / 6.0)).collect();
    if w.dice.chance(0.5) {
        // Two wires that meet in the grip.
        for side in [-1.0f32, 1.0] {
            let path: Vec<Vec3> = stem
                .iter()
                .enumerate()
                .map(|(i, p)| *p + Vec3::Y * side * (0.010 - 0.0008 * i as f32) + Vec3::X * 0.001)
                .collect();
            w.add(tube(&path, Vec3::Z, 8, [Tip::Flat, Tip::Flat], |_| (0.0018, 0.0018)), frame, 60.0);
        }
    } else {
        w.add(tube(&stem, Vec3::Z, 10, [Tip::Flat, Tip::Flat], |_| (0.0058, 0.0024)), frame, 50.0);
    }
    let wide = w.dice.range(0.0082, 0.0115);
    let line: Vec<Vec3> = (0..=12).map(|i| along(length * (0.42 + 0.58 * i as f32 / 12.0))).collect();
    let grip = tube(&line, Vec3::Z, 14, [Tip::Round, Tip::Round], |t| {
        let s = 0.86 + 0.25 * (t * 2.6).sin();
        (wide * s, wide * 0.7 * s)
    });
    let stuff = grip_stuff(w, 0.35, 0.3);
    w.add(grip.uv_box(Vec2::new(0.05, 0.14)), stuff, 50.0);
    let rest = [(-1.0f32, 0.016f32), (-0.5, 0.022), (0.5, 0.022), (1.0, 0.016)];
    let mut hook: Vec<Vec3> = rest.iter().map(|&(y, x)| Vec3::new(radius + x, y * 0.014, height - 0.002)).collect();
    hook.insert(0, Vec3::new(radius * 0.975, -0.016, height));
    hook.push(Vec3::new(radius * 0.975, 0.016, height));
    w.add(tube(&spline(&hook, 3), Vec3::Z, 8, [Tip::Flat, Tip::Flat], |_| (0.0018, 0.0018)), frame, 60.0);
    w.settle();
}

/// A point on a square of half-sizes `hx`, `hy` with rounded corners, `u` in [0, 1) around it.
fn on_square(u: f32, hx: f32, hy: f32) -> Vec2 {
    let (s, c) = ((u - 0.125) * TAU).sin_cos();
    let boxy = (s.abs().powi(10) + c.abs().powi(10)).powf(0.1);
    // Even steps along the sides.
    let even = |v: f32| ((v / boxy).atan() / FRAC_PI_4).clamp(-1.0, 1.0);
    Vec2::new(hx * even(c), hy * even(s))
}

/// A box grater: four leaning sides full of holes, a plate and a handle on top.
pub fn grater(w: &mut Workshop) {
    let shape = w.shape();
    let height = w.dice.range(0.165, 0.215);
    let (hx, hy) = match shape {
        "flat_box" => (w.dice.range(0.052, 0.060), w.dice.range(0.026, 0.032)),
        "square" => (w.dice.range(0.046, 0.052), w.dice.range(0.046, 0.052)),
        _ => (w.dice.range(0.047, 0.057), w.dice.range(0.036, 0.044)),
    };
    let narrow = match shape {
        "tower" => 0.52,
        _ => w.dice.range(0.66, 0.80),
    };
    let wall = 0.0014;
    let rows = 18;
    let columns = 40;
    let coarse = w.dice.pick(&[1, 3]);
    let body = shell(
        rows,
        columns,
        |v, u| {
            let cap = 2.0 / rows as f32;
            let (size, z) = if v < cap {
                (narrow * v / cap, height)
            } else {
                let t = (v - cap) / (1.0 - cap);
                (narrow + (1.0 - narrow) * t, height * (1.0 - t))
            };
            let top = if v < cap { height - wall } else { (z - wall * (1.0 - v)).max(0.0) };
            let shrink = if v < 1e-6 { 0.0 } else { 1.0 };
            let inner = on_square(u, (hx * size - wall * shrink).max(0.0), (hy * size - wall * shrink).max(0.0));
            (on_square(u, hx * size, hy * size).extend(z), inner.extend(top))
        },
        |r, c| {
            let (side, at) = (c / 10, c % 10);
            // One side has slots, the others rows of teeth.
            let slots = side == coarse && r % 4 == 0 && (2..8).contains(&at);
            let teeth = side != coarse && staggered(r, at, 4, rows - 2) && (1..9).contains(&at);
            (4..rows - 2).contains(&r) && (slots || teeth)
        },
    );
    let metal = w.material(steel);
    w.add(body.uv_box(Vec2::splat(0.06)), metal, 40.0);
    let stuff = match w.dice.pick(&[0, 1, 1, 2]) {
        0 => metal,
        1 => grip_stuff(w, 0.15, 0.45),
        _ => w.material(wood),
    };
    let (tx, ty) = (hx * narrow, hy * narrow);
    let lid = rounded_box(Vec3::new(tx * 2.0 + 0.006, ty * 2.0 + 0.006, 0.007), 0.006, 0.002);
    w.add(lid.moved(Vec3::Z * (height + 0.002)).uv_box(Vec2::splat(0.06)), stuff, 40.0);
    let (rise, span) = (w.dice.range(0.026, 0.036), tx * w.dice.range(0.72, 0.92));
    let z = height + 0.003;
    let square = w.dice.range(0.0, 0.8);
    let path = spline(
        &[
            Vec3::new(-span, 0.0, z),
            Vec3::new(-span * (0.9 + 0.1 * square), 0.0, z + rise * (0.6 + 0.3 * square)),
            Vec3::new(0.0, 0.0, z + rise),
            Vec3::new(span * (0.9 + 0.1 * square), 0.0, z + rise * (0.6 + 0.3 * square)),
            Vec3::new(span, 0.0, z),
        ],
        5,
    );
    let (thick, wide) = (w.dice.range(0.0036, 0.0055), w.dice.range(0.0075, 0.0105));
    let arch = tube(&path, Vec3::Y, 12, [Tip::Flat, Tip::Flat], |_| (thick, wide));
    w.add(arch.uv_box(Vec2::new(0.05, 0.12)), stuff, 50.0);
    if shape == "footed" || w.dice.chance(0.4) {
        let rubber = plain(w, "rubber", Vec3::splat(0.12), 0.8);
        for (x, y) in [(-1.0f32, -1.0f32), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let foot = revolve(&disc(0.0055, -0.003, 0.010, 0.001), 14);
            w.add(foot.moved(Vec3::new(x * hx * 0.90, y * hy * 0.88, 0.0)), rubber, 40.0);
        }
    } else {
        let hem = rounded_box(Vec3::new(hx * 2.0, 0.004, 0.005), 0.001, 0.001);
        for y in [-hy, hy] {
            add_steel(w, hem.clone().moved(Vec3::new(0.0, y, 0.002)), 40.0);
        }
    }
    w.settle();
}
