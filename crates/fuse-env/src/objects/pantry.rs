//! Food cans, candles.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::Workshop;
use super::finish::{material, plastic, steel};
use super::parts::{add_steel, disc, plain, torus};
use super::pouring::labelled;
use super::sweep::{Tip, along, hollow, revolve, spline, tube};
use super::texture::{Canvas, Noise};
use super::vessels::around;

/// A food can with a printed label; ends recessed, most with a ring pull.
pub fn can(w: &mut Workshop) {
    let shape = w.shape();
    let (r, height) = match shape {
        "flat" => (w.dice.range(0.040, 0.044), w.dice.range(0.058, 0.066)),
        "large" => (w.dice.range(0.046, 0.050), w.dice.range(0.115, 0.122)),
        _ => (w.dice.range(0.032, 0.039), w.dice.range(0.090, 0.118)),
    };
    let ribs = if shape == "ribbed" { 0.0009 } else { 0.0 };
    let rim = 0.0022;
    let mut side: Vec<Vec2> = vec![Vec2::ZERO, Vec2::new(r - rim, 0.0)];
    side.extend((0..=32).map(|i| {
        let z = 0.005 + (height - 0.010) * i as f32 / 32.0;
        let wave = ribs * (TAU * z / 0.009).cos();
        Vec2::new(r - 0.0006 + wave, z)
    }));
    side.push(Vec2::new(r - rim, height - 0.003));
    side.push(Vec2::new(0.0, height - 0.003));
    let body = Vec3::splat(w.dice.any(0.70, 0.80));
    let canvas = labelled(&mut w.dice, body, 0.06, 0.94);
    let paper = w.material(|_| material("can", &canvas, 0.1, 0.45));
    w.add(around(revolve(&side, 36), height), paper, 45.0);
    let metal = w.material(steel);
    for z in [0.0035, height - 0.0035] {
        w.add(torus(r - 0.0008, 0.0018, 0.0034, 2.5, 36).moved(Vec3::Z * z).uv_box(Vec2::splat(0.06)), metal, 60.0);
    }
    let lid = revolve(&disc(r - 0.0015, height - 0.0045, height - 0.0025, 0.0005), 36);
    w.add(lid.uv_box(Vec2::splat(0.06)), metal, 35.0);
    w.add(torus(r * 0.74, 0.0012, 0.0010, 2.0, 32).moved(Vec3::Z * (height - 0.0025)), metal, 60.0);
    if shape != "large" {
        let pull = torus(r * 0.22, r * 0.06, 0.0008, 3.0, 20).map(|p| Vec3::new(p.x * 1.35, p.y, p.z));
        w.add(pull.moved(Vec3::new(r * 0.22, 0.0, height - 0.0014)), metal, 60.0);
        let tab = revolve(&disc(r * 0.13, height - 0.003, height - 0.0006, 0.0004), 16);
        w.add(tab.moved(Vec3::X * r * 0.52), metal, 35.0);
    }
    w.settle();
}

/// A candle with a wick, most often alight; on a dish, in a jar, or by itself.
pub fn candle(w: &mut Workshop) {
    let shape = w.shape();
    let r = w.dice.range(0.026, 0.036);
    let height = w.dice.range(0.072, 0.115);
    let tone = if w.dice.chance(0.6) { w.dice.color((0.04, 0.2), (0.86, 0.96)) } else { w.dice.vivid() };
    let noise = Noise(w.dice.seed());
    let wax_paint = Canvas::new(64, 64, tone).each(|uv, c| {
        let glow = (0.25 - uv.y).max(0.0);
        (c * (0.92 + 0.12 * noise.cloud(uv, (6, 6)))).lerp(Vec3::new(1.0, 0.86, 0.55), glow)
    });
    let wax = w.material(|_| material("wax", &wax_paint, 0.0, 0.5));
    let base = if shape == "chamberstick" { 0.004 } else { 0.0 };
    let lobes = match shape {
        "spiral" => 0.10,
        "dripping" => 0.03,
        _ => 0.0,
    };
    let mut profile = vec![Vec2::new(0.0, base)];
    profile.extend((0..=24).map(|i| {
        let t = i as f32 / 24.0;
        Vec2::new(r * along(&[(0.0, 0.97), (0.03, 1.0), (0.96, 1.0), (1.0, 0.93)], t), base + height * t)
    }));
    profile.push(Vec2::new(r * 0.72, base + height - 0.004));
    profile.push(Vec2::new(r * 0.3, base + height - 0.006));
    profile.push(Vec2::new(0.0, base + height - 0.006));
    let body = revolve(&profile, 36).map(|p| {
        let angle = p.y.atan2(p.x);
        let twist = if shape == "spiral" { p.z / height * 5.0 } else { 0.0 };
        let k = 1.0 + lobes * (6.0 * (angle + twist)).cos();
        if shape == "square" {
            let q = p.truncate() / r;
            let boxy = (q.x.powi(8) + q.y.powi(8)).powf(0.125).max(1e-5);
            return (p.truncate() * (q.length() / boxy) * 0.9).extend(p.z);
        }
        Vec3::new(p.x * k, p.y * k, p.z)
    });
    w.add(around(body, height), wax, 45.0);
    let top = base + height;
    let wick_paint = plain(w, "paper", Vec3::splat(0.10), 0.9);
    let wick = [Vec3::Z * (top - 0.008), Vec3::new(0.0004, 0.0, top + 0.003), Vec3::new(0.0016, 0.0, top + 0.010)];
    w.add(tube(&wick, Vec3::Y, 8, [Tip::Flat, Tip::Round], |_| (0.0011, 0.0011)), wick_paint, 60.0);
    if w.dice.chance(0.75) {
        let tall = w.dice.range(0.020, 0.027);
        let mut flame = vec![Vec2::ZERO];
        flame.extend((1..10).map(|i| {
            let t = i as f32 / 10.0;
            Vec2::new(0.0068 * (PI * t.powf(0.62)).sin(), tall * t)
        }));
        flame.push(Vec2::new(0.0, tall));
        let fire = Canvas::new(4, 16, Vec3::ZERO)
            .each(|uv, _| Vec3::new(1.0, 0.66, 0.12).lerp(Vec3::new(1.0, 0.95, 0.62), (1.0 - uv.y) * 0.9));
        let light = w.material(|_| material("air", &fire, 0.0, 1.0));
        w.add(revolve(&flame, 16).moved(Vec3::new(0.001, 0.0, top + 0.004)), light, 60.0);
    }
    if shape == "dripping" || w.dice.chance(0.3) {
        for k in 0..5 {
            let out = Vec2::from_angle(k as f32 * 1.26 + w.dice.any(0.0, 0.8));
            let long = height * w.dice.any(0.12, 0.45);
            let at = |z: f32| (out * r * 0.99).extend(z);
            let drip = tube(
                &[at(top - 0.004), at(top - long * 0.5), at(top - long)],
                Vec3::X,
                8,
                [Tip::Round, Tip::Round],
                |t| (0.0022 + 0.0012 * t, 0.0022 + 0.0012 * t),
            );
            w.add(drip.map_uv(|_, uv| Vec2::new(uv.x, 0.3)), wax, 60.0);
        }
    }
    match shape {
        "chamberstick" => {
            let dish = spline(&[Vec2::new(r * 1.2, 0.0), Vec2::new(r * 1.45, 0.004), Vec2::new(r * 1.62, 0.014)], 4);
            add_steel(w, revolve(&hollow(&dish, 0.0018, 0.004), 36), 45.0);
            let ring = torus(0.013, 0.0022, 0.0030, 2.5, 20).map(|p| Vec3::new(p.x, p.z, p.y));
            add_steel(w, ring.moved(Vec3::new(r * 1.62 + 0.011, 0.0, 0.012)), 60.0);
        }
        "jar" => {
            let glass =
                spline(&[Vec2::new(r * 1.06, -0.005), Vec2::new(r * 1.14, 0.0), Vec2::new(r * 1.14, height * 0.85)], 5);
            let tint = w.dice.color((0.25, 0.5), (0.45, 0.75));
            let stuff = w.material(|d| plastic(d, tint));
            w.add(revolve(&hollow(&glass, 0.0022, 0.006), 36), stuff, 45.0);
        }
        _ => {}
    }
    w.settle();
}
