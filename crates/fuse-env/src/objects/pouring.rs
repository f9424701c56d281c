//! Pitchers, teapots, bottles.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::Workshop;
use super::dice::Dice;
use super::finish::{ceramic, glaze, material, plastic, rubber, steel};
use super::sweep::{Tip, hollow, revolve, spline, tube};
use super::table::{Stuff, finishes};
use super::texture::{Canvas, Noise};
use super::vessels::{Roots, around, handle, profile_radius};

/// A jug with a pouring lip opposite its handle.
pub fn pitcher(w: &mut Workshop) {
    let shape = w.shape();
    let height = w.dice.range(0.170, 0.235);
    let r = height * w.dice.range(0.26, 0.32);
    let (foot, belly, at, neck, rim) = match shape {
        "bellied" => (0.70, w.dice.range(1.04, 1.14), 0.32, w.dice.range(0.60, 0.72), 0.82),
        "conic" => (1.0, 0.97, 0.3, w.dice.range(0.66, 0.76), 0.72),
        "jug" => (0.80, 1.02, 0.38, 0.80, 0.86),
        "straight" => (0.85, 0.86, 0.4, 0.85, 0.88),
        "urn" => (0.52, 1.12, 0.45, 0.58, 0.80),
        _ => (0.95, 0.90, 0.35, 0.74, 0.84),
    };
    let outer = spline(
        &[
            Vec2::new(r * foot * 0.95, 0.0),
            Vec2::new(r * foot, height * 0.015),
            Vec2::new(r * (0.35 * foot + 0.65 * belly), height * at * 0.5),
            Vec2::new(r * belly, height * at),
            Vec2::new(r * (0.5 * belly + 0.5 * neck), height * (at + 0.80) * 0.5),
            Vec2::new(r * neck, height * 0.82),
            Vec2::new(r * rim, height),
        ],
        4,
    );
    let wall = w.dice.range(0.0034, 0.0050);
    let pull = w.dice.range(0.28, 0.48) * r;
    let width = w.dice.any(0.30, 0.42);
    // The lip points to -x: near the rim the wall is drawn out and slightly up.
    let lip = |p: Vec3| {
        let near = ((p.z / height - 0.80) / 0.20).clamp(0.0, 1.1).powi(2);
        let angle = p.y.atan2(-p.x);
        let f = near * (-(angle / width).powi(2)).exp();
        let out = Vec3::new(p.x, p.y, 0.0).normalize_or_zero();
        p + out * pull * f + Vec3::Z * (pull * 0.30 * f)
    };
    let body = around(revolve(&hollow(&outer, wall, wall * 1.6), 44), height);
    let (inside, outside) = body.split(|c, n| {
        let out = Vec3::new(c.x, c.y, 0.0).normalize_or_zero();
        n.dot(out) < -0.2 || n.z > 0.75 || (n.z > 0.3 && c.z < height * 0.3)
    });
    let kind = w.dice.unit();
    let skin = if kind < 0.74 {
        w.material(ceramic)
    } else if kind < 0.86 {
        w.material(steel)
    } else {
        let tone = w.dice.color((0.2, 0.7), (0.6, 0.95));
        w.material(|d| plastic(d, tone))
    };
    let lining = if kind < 0.74 {
        let tone = w.dice.color((0.0, 0.15), (0.8, 0.95));
        w.material(|_| glaze(tone))
    } else {
        skin
    };
    // Moved apart after the split; both keep the same points, so they still meet.
    let bend =
        |s: super::shape::Surface| super::shape::Surface { points: s.points.iter().map(|&p| lip(p)).collect(), ..s };
    w.add(bend(outside), skin, 50.0);
    w.add(bend(inside), lining, 50.0);
    let z = (height * w.dice.range(0.86, 0.95), height * w.dice.range(0.22, 0.38));
    let ear = handle(
        &Roots { outer: &outer, into: wall * 0.5, z, height },
        w.dice.range(0.036, 0.052),
        w.dice.range(0.0, 0.8),
        w.dice.range(0.0050, 0.0068),
        w.dice.range(0.0080, 0.0115),
    );
    w.add(ear, skin, 60.0);
    w.settle();
}

/// A teapot: body, lid with knob, spout, handle.
pub fn teapot(w: &mut Workshop) {
    let shape = w.shape();
    let r = w.dice.range(0.060, 0.076);
    let height = r * match shape {
        "squat" => w.dice.range(1.15, 1.35),
        "pear" | "conic" => w.dice.range(1.65, 1.85),
        "cylinder" => w.dice.range(1.5, 1.65),
        _ => w.dice.range(1.45, 1.65),
    };
    let mouth = w.dice.range(0.44, 0.56);
    let mids: [(f32, f32); 4] = match shape {
        "pear" => [(0.15, 0.92), (0.36, 1.0), (0.62, 0.84), (0.86, 0.62)],
        "conic" => [(0.05, 1.0), (0.32, 0.93), (0.65, 0.80), (0.92, 0.66)],
        "cylinder" => [(0.06, 0.97), (0.4, 1.0), (0.80, 0.98), (0.94, 0.86)],
        "angular" => [(0.22, 0.86), (0.46, 1.02), (0.56, 1.0), (0.84, 0.70)],
        _ => [(0.16, 0.84), (0.42, 1.0), (0.66, 0.95), (0.88, 0.70)],
    };
    let foot = if shape == "conic" { 0.96 } else { w.dice.range(0.50, 0.64) };
    let mut controls = vec![Vec2::new(r * foot, 0.0)];
    controls.extend(mids.iter().map(|&(z, k)| Vec2::new(r * k, height * z)));
    controls.push(Vec2::new(r * mouth, height));
    let outer = spline(&controls, 5);
    let mut profile = vec![Vec2::new(0.0, 0.0)];
    profile.extend_from_slice(&outer);
    profile.push(Vec2::new(0.0, height));
    let skin = if w.dice.chance(0.86) { w.material(ceramic) } else { w.material(steel) };
    w.add(around(revolve(&profile, 40), height), skin, 45.0);
    teapot_lid(w, r * mouth, height, skin);
    let low = height * w.dice.range(0.28, 0.42);
    let root = profile_radius(&outer, low) * 0.86;
    let reach = r * w.dice.range(0.78, 0.98);
    let top = height * w.dice.range(0.92, 1.06);
    let spout = spline(
        &[
            Vec3::new(-root, 0.0, low),
            Vec3::new(-root - reach * 0.42, 0.0, low + (top - low) * 0.16),
            Vec3::new(-root - reach * 0.72, 0.0, low + (top - low) * 0.62),
            Vec3::new(-root - reach * 1.12, 0.0, top),
        ],
        5,
    );
    let (wide, narrow) = (r * w.dice.range(0.26, 0.33), r * w.dice.range(0.115, 0.155));
    let pipe = tube(&spout, Vec3::Y, 16, [Tip::Flat, Tip::Mouth(0.0022, 0.012)], |t| {
        let s = wide + (narrow - wide) * t.powf(0.6);
        (s, s * 0.92)
    });
    let (bore, shell) = pipe.split(|c, n| (c.x < -root - reach * 0.95) && n.dot(Vec3::new(-0.5, 0.0, 0.85)) > 0.55);
    w.add(shell.map_uv(|_, uv| Vec2::new(uv.x, 0.2 + 0.5 * uv.y)), skin, 50.0);
    let dark = w.material(|_| glaze(Vec3::splat(0.10)));
    w.add(bore, dark, 50.0);
    let z = (height * w.dice.range(0.74, 0.84), height * w.dice.range(0.20, 0.32));
    let ear = handle(
        &Roots { outer: &outer, into: 0.004, z, height },
        r * w.dice.range(0.55, 0.75),
        w.dice.range(0.0, 0.7),
        w.dice.range(0.0046, 0.0060),
        w.dice.range(0.0065, 0.0090),
    );
    w.add(ear, skin, 60.0);
    w.settle();
}

fn teapot_lid(w: &mut Workshop, mouth: f32, height: f32, skin: usize) {
    let rise = mouth * w.dice.range(0.28, 0.55);
    let brim = mouth * 1.10;
    let knob = mouth * w.dice.range(0.26, 0.36);
    let z = height + 0.0005;
    let mut lid = vec![
        Vec2::new(0.0, z),
        Vec2::new(brim * 0.97, z),
        Vec2::new(brim, z + 0.0015),
        Vec2::new(brim * 0.97, z + 0.0035),
    ];
    for k in 1..=5 {
        let (s, c) = (std::f32::consts::FRAC_PI_2 * k as f32 / 6.0).sin_cos();
        lid.push(Vec2::new(brim * 0.93 * c, z + 0.0035 + rise * s));
    }
    lid.push(Vec2::new(0.0, z + 0.0035 + rise));
    let stuff = if w.dice.chance(0.7) {
        skin
    } else {
        let tone = w.dice.color((0.1, 0.7), (0.3, 0.9));
        w.material(|_| glaze(tone))
    };
    w.add(revolve(&lid, 32).map_uv(|_, uv| Vec2::new(uv.x, 0.03 + 0.2 * uv.y)), stuff, 40.0);
    let base = z + 0.0025 + rise * 0.98;
    let mut ball = vec![
        Vec2::new(0.0, base - 0.002),
        Vec2::new(knob * 0.55, base - 0.002),
        Vec2::new(knob * 0.5, base + knob * 0.35),
    ];
    for k in 1..6 {
        let (s, c) = (std::f32::consts::PI * (k as f32 / 6.0 - 0.42)).sin_cos();
        ball.push(Vec2::new(knob * c.max(0.05), base + knob * (1.15 + 0.8 * s)));
    }
    ball.push(Vec2::new(0.0, base + knob * 1.97));
    w.add(revolve(&ball, 18).map_uv(|_, uv| Vec2::new(uv.x, 0.1)), stuff, 60.0);
}

/// A label painted around a body: v from 0 (top) to 1; `low`..`high` is the label's band.
pub fn labelled(dice: &mut Dice, body: Vec3, low: f32, high: f32) -> Canvas {
    let family = dice.family(&finishes(Stuff::Label));
    let noise = Noise(dice.seed());
    let ground = if dice.chance(0.5) { dice.color((0.0, 0.15), (0.88, 0.98)) } else { dice.vivid() };
    let ink = if ground.min_element() > 0.7 { dice.vivid() * 0.8 } else { Vec3::splat(0.95) };
    let second = dice.vivid();
    let mut canvas = Canvas::new(128, 128, body).each(|uv, c| {
        if uv.y < low || uv.y > high {
            return c;
        }
        let v = (uv.y - low) / (high - low);
        match family {
            "wave" if (v - 0.6 - 0.12 * (TAU * uv.x * 2.0).sin()) > 0.0 => second,
            "bands" if !(0.12..0.88).contains(&v) => second,
            "diagonal" if ((uv.x * 8.0 + v * 2.0).fract()) < 0.4 => second,
            "drops" if noise.spots(uv, (12, 12)) < 0.25 => second,
            "chevron" if ((uv.x * 6.0).fract() - 0.5).abs() * 0.5 + 0.35 > v => second,
            _ => ground,
        }
    });
    for side in [0.08, 0.58] {
        let span = high - low;
        canvas.text(Vec2::new(side, low + span * 0.28), Vec2::new(side + 0.34, low + span * 0.52), 1, ink, noise);
        canvas.text(Vec2::new(side, low + span * 0.58), Vec2::new(side + 0.30, low + span * 0.86), 3, ink, noise);
    }
    canvas
}

/// A bottle with a cap and a label.
pub fn water_bottle(w: &mut Workshop) {
    let shape = w.shape();
    let height = match shape {
        "tall" => w.dice.range(0.24, 0.27),
        "wide" => w.dice.range(0.18, 0.20),
        _ => w.dice.range(0.190, 0.245),
    };
    let r = if shape == "wide" { 0.043 } else { w.dice.range(0.030, 0.038) };
    let neck = r * if shape == "wide" { 0.72 } else { w.dice.range(0.40, 0.56) };
    let shoulder = w.dice.range(0.66, 0.76);
    let outer = spline(
        &[
            Vec2::new(r * 0.86, 0.0),
            Vec2::new(r * 0.99, height * 0.03),
            Vec2::new(r, height * 0.09),
            Vec2::new(r, height * 0.35),
            Vec2::new(r, height * (shoulder - 0.06)),
            Vec2::new(r * 0.94, height * shoulder),
            Vec2::new((r + neck) * 0.55, height * (shoulder + 0.08)),
            Vec2::new(neck, height * 0.89),
            Vec2::new(neck, height * 0.93),
        ],
        4,
    );
    let ribbed = shape == "ribbed";
    let (from, to) = (1.0 - (shoulder - 0.08), w.dice.any(0.68, 0.84));
    let square = shape == "square";
    let mut profile = vec![Vec2::ZERO];
    profile.extend(outer.iter().map(|p| {
        let v = 1.0 - p.y / height;
        let groove =
            if ribbed && !(from..to).contains(&v) && p.x > r * 0.9 { 0.94 + 0.06 * (p.y * 420.0).sin() } else { 1.0 };
        Vec2::new(p.x * groove, p.y)
    }));
    profile.push(Vec2::new(0.0, height * 0.93));
    let body = revolve(&profile, 32).map(|p| {
        if !square {
            return p;
        }
        let (x, y) = (p.x / r, p.y / r);
        let boxy = (x.abs().powi(4) + y.abs().powi(4)).powf(0.25).max(1e-4);
        let pull = 1.0 + 0.75 * ((x * x + y * y).sqrt() / boxy - 1.0);
        Vec3::new(p.x * pull * 0.92, p.y * pull * 0.92, p.z)
    });
    let metal = shape == "flask" && w.dice.chance(0.5);
    let tone = if metal {
        Vec3::splat(w.dice.any(0.68, 0.8))
    } else if w.dice.chance(0.35) {
        w.dice.color((0.05, 0.3), (0.75, 0.95))
    } else {
        w.dice.vivid()
    };
    let canvas = labelled(&mut w.dice, tone, from, to);
    let skin = w.material(|_| {
        if metal { material("plastic", &canvas, 0.5, 0.35) } else { material("plastic", &canvas, 0.0, 0.3) }
    });
    w.add(around(body, height), skin, 45.0);
    bottle_cap(w, neck, height, shape);
    w.settle();
}

fn bottle_cap(w: &mut Workshop, neck: f32, height: f32, shape: &str) {
    let r = neck * w.dice.range(1.12, 1.35);
    let (low, high) = (height * 0.885, height);
    let profile = [
        Vec2::new(0.0, low),
        Vec2::new(r, low),
        Vec2::new(r, high - 0.003),
        Vec2::new(r * 0.9, high),
        Vec2::new(0.0, high),
    ];
    let cap = revolve(&profile, 36).map(|p| {
        let ridge = 1.0 + 0.03 * (18.0 * p.y.atan2(p.x)).cos();
        Vec3::new(p.x * ridge, p.y * ridge, p.z)
    });
    let stuff = if w.dice.chance(0.3) {
        w.material(rubber)
    } else {
        let tone = if w.dice.chance(0.3) { w.dice.color((0.0, 0.1), (0.85, 0.97)) } else { w.dice.vivid() };
        w.material(|d| plastic(d, tone))
    };
    w.add(cap, stuff, 30.0);
    if shape == "sport" {
        let n = neck * 0.55;
        let nozzle = [
            Vec2::new(0.0, high - 0.002),
            Vec2::new(n, high - 0.002),
            Vec2::new(n * 0.75, high + 0.008),
            Vec2::new(n * 0.95, high + 0.012),
            Vec2::new(n * 0.85, high + 0.019),
            Vec2::new(0.0, high + 0.019),
        ];
        let tone = w.dice.color((0.0, 0.1), (0.85, 0.97));
        let pale = w.material(|d| plastic(d, tone));
        w.add(revolve(&nozzle, 20), pale, 40.0);
    } else if shape == "flask" || shape == "tall" {
        // A carrying loop over the cap.
        let span = r * 0.8;
        let path = spline(
            &[
                Vec3::new(-span, 0.0, high - 0.004),
                Vec3::new(-span * 0.9, 0.0, high + 0.012),
                Vec3::new(0.0, 0.0, high + 0.020),
                Vec3::new(span * 0.9, 0.0, high + 0.012),
                Vec3::new(span, 0.0, high - 0.004),
            ],
            4,
        );
        w.add(tube(&path, Vec3::Y, 10, [Tip::Flat, Tip::Flat], |_| (0.0022, 0.006)), stuff, 50.0);
    }
}
