//! Plates, trays, glasses, measuring cups.

use glam::{Vec2, Vec3};

use super::Workshop;
use super::finish::{ceramic, glaze, material, steel, wood};
use super::parts::{disc, plain, vivid_plastic, weigh_alike};
use super::shape::{Ends, Surface};
use super::sweep::{Tip, extrude, hollow, revolve, rounded_rectangle, spline, superellipse, tube};
use super::texture::{Canvas, Noise};
use super::vessels::{Roots, around, handle};

/// A dinner plate on a foot ring; its decoration runs from the rim inwards.
pub fn plate(w: &mut Workshop) {
    let shape = w.shape();
    let radius = w.dice.range(0.098, 0.132);
    let height = radius
        * match shape {
            "coupe" => w.dice.range(0.15, 0.19),
            "soup" => w.dice.range(0.24, 0.28),
            _ => w.dice.range(0.13, 0.17),
        };
    let well = match shape {
        "coupe" => 0.80,
        "wide_rim" => 0.56,
        _ => w.dice.range(0.62, 0.72),
    };
    let wall = w.dice.range(0.0035, 0.0052);
    let foot = well * 0.86;
    let bend = if shape == "coupe" { 0.35 } else { 0.62 };
    // The upper face; the lower one lies `wall` below it.
    let face = [(0.0, 0.0), (well * 0.9, 0.0), (well, 0.10), (well + (1.0 - well) * 0.25, bend), (1.0, 1.0)];
    let upper: Vec<Vec2> = spline(&face.map(|(r, z)| Vec2::new(r * radius, z * (height - wall) + wall + 0.002)), 4);
    let mut profile = vec![
        Vec2::new(0.0, 0.002),
        Vec2::new(radius * foot - 0.004, 0.002),
        Vec2::new(radius * foot - 0.003, 0.0),
        Vec2::new(radius * foot, 0.0),
        Vec2::new(radius * (foot + 0.02), 0.003),
    ];
    profile.extend(upper.iter().filter(|p| p.x > radius * (well - 0.02)).map(|p| {
        let thin = 1.0 - 0.3 * p.x / radius;
        Vec2::new(p.x + 0.001, p.y - wall * thin)
    }));
    profile.push(Vec2::new(radius + 0.0018, height + 0.0005));
    profile.extend(upper.iter().rev().filter(|p| p.x > 1e-5));
    profile.push(Vec2::new(0.0, upper[0].y));
    let lobes = if shape == "scalloped" { 0.035 } else { 0.0 };
    let body = revolve(&profile, 48)
        .map(|p| {
            let k = 1.0 + lobes * (p.truncate().length() / radius).powi(4) * (12.0 * p.y.atan2(p.x)).cos();
            if shape == "squarish" {
                let q = p.truncate() / radius;
                let boxy = (q.x.powi(6) + q.y.powi(6)).powf(1.0 / 6.0).max(1e-5);
                let pull = 1.0 + (q.length() / boxy - 1.0) * q.length().min(1.0);
                return (p.truncate() * pull * 0.92).extend(p.z);
            }
            Vec3::new(p.x * k, p.y * k, p.z)
        })
        .map_uv(|p, uv| Vec2::new(uv.x, 1.0 - p.truncate().length() / radius));
    let skin = w.material(ceramic);
    w.add(body, skin, 45.0);
    w.settle();
}

/// A serving tray with a raised rim and a handle at either end.
pub fn tray(w: &mut Workshop) {
    let shape = w.shape();
    let (hx, hy) = match shape {
        "round" => {
            let r = w.dice.range(0.155, 0.175);
            (r, r)
        }
        "oval" => (w.dice.range(0.185, 0.21), w.dice.range(0.125, 0.14)),
        _ => (w.dice.range(0.165, 0.21), w.dice.range(0.11, 0.14)),
    };
    let height = w.dice.range(0.022, 0.036) * if shape == "deep" { 1.3 } else { 1.0 };
    let wall = w.dice.range(0.003, 0.006);
    let flare = w.dice.range(0.002, 0.012);
    let corner = if shape == "square_corners" { 0.006 } else { w.dice.range(0.018, 0.04) };
    let outline = |grow: f32| -> Vec<Vec2> {
        match shape {
            "round" | "oval" => superellipse(hx + grow, hy + grow, 2.0, 44),
            _ => rounded_rectangle(hx + grow, hy + grow, corner + grow.max(-0.004), 6),
        }
    };
    let ring = |grow: f32, z: f32| -> Vec<Vec3> { outline(grow).iter().map(|p| p.extend(z)).collect() };
    let floor = wall * 0.8;
    let body = Surface::loft(
        &[
            ring(-flare - 0.001, 0.0),
            ring(-flare, 0.001),
            ring(0.0, height - 0.001),
            ring(-wall * 0.3, height),
            ring(-wall * 0.8, height),
            ring(-wall, height - 0.001),
            ring(-flare - wall, floor + 0.002),
            ring(-flare - wall - 0.003, floor),
        ],
        Ends::Capped,
    );
    let kind = w.dice.unit();
    let skin = if kind < 0.5 || shape == "square_corners" {
        w.material(wood)
    } else if kind < 0.7 {
        w.material(steel)
    } else {
        vivid_plastic(w)
    };
    w.add(body.uv_box(Vec2::new(0.10, 0.22)), skin, 40.0);
    if w.dice.chance(0.35) {
        // A mat on the floor.
        let mat = vivid_plastic(w);
        let sheet = extrude(&outline(-flare - wall - 0.004), floor - 0.0004, floor + 0.0006, 0.0);
        w.add(sheet.uv_box(Vec2::splat(0.08)), mat, 40.0);
    }
    let (span, rise) = (hy * w.dice.range(0.32, 0.42), w.dice.range(0.020, 0.032));
    let stuff = if w.dice.chance(0.5) { skin } else { w.material(steel) };
    let thick = w.dice.range(0.0032, 0.0050);
    let out = w.dice.range(0.006, 0.020);
    for side in [-1.0f32, 1.0] {
        let edge = if matches!(shape, "round" | "oval") { hx * (1.0 - (span / hy).powi(2)).sqrt() } else { hx };
        let path = spline(
            &[
                Vec3::new(edge - wall * 0.5, -span, height - 0.008),
                Vec3::new(edge + out * 0.4, -span * 0.98, height + rise * 0.75),
                Vec3::new(hx + out, 0.0, height + rise),
                Vec3::new(edge + out * 0.4, span * 0.98, height + rise * 0.75),
                Vec3::new(edge - wall * 0.5, span, height - 0.008),
            ],
            6,
        );
        let grip = tube(&path, Vec3::X, 10, [Tip::Flat, Tip::Flat], |_| (thick, thick * 1.2));
        w.add(grip.map(|p| Vec3::new(p.x * side, p.y, p.z)).uv_box(Vec2::splat(0.06)), stuff, 50.0);
    }
    w.settle();
}

/// A stemmed glass, most often with some wine in it. Glass is drawn opaque, pale and glossy.
pub fn wine_glass(w: &mut Workshop) {
    let shape = w.shape();
    let stem = w.dice.range(0.072, 0.095);
    let (bowl, r) = match shape {
        "flute" => (w.dice.range(0.125, 0.14), w.dice.range(0.026, 0.030)),
        "goblet" => (w.dice.range(0.085, 0.10), w.dice.range(0.041, 0.047)),
        "burgundy" => (w.dice.range(0.10, 0.115), w.dice.range(0.045, 0.050)),
        _ => (w.dice.range(0.095, 0.118), w.dice.range(0.034, 0.043)),
    };
    let rim = match shape {
        "tulip" | "burgundy" => 0.72,
        "white" => 0.86,
        "goblet" => 1.0,
        _ => 0.80,
    };
    let thin = w.dice.range(0.0034, 0.0048);
    let foot = r * w.dice.range(0.82, 0.98);
    let widest = if shape == "flute" { 0.5 } else { w.dice.range(0.36, 0.48) };
    let outer = spline(
        &[
            Vec2::new(foot, 0.0),
            Vec2::new(foot * 0.98, 0.0022),
            Vec2::new(foot * 0.45, 0.0058),
            Vec2::new(thin, 0.014),
            Vec2::new(thin * 0.9, stem * 0.6),
            Vec2::new(thin * 1.3, stem * 0.94),
            Vec2::new(r * 0.55, stem + bowl * 0.07),
            Vec2::new(r * 0.93, stem + bowl * widest * 0.62),
            Vec2::new(r, stem + bowl * widest),
            Vec2::new(r * (0.45 + 0.55 * rim), stem + bowl * 0.80),
            Vec2::new(r * rim, stem + bowl),
        ],
        4,
    );
    let wall = 0.0014;
    let inside: Vec<Vec2> = outer
        .iter()
        .filter(|p| p.y > stem + bowl * 0.06)
        .map(|p| Vec2::new((p.x - wall).max(0.001), p.y + wall * (1.0 - (p.y - stem) / bowl)))
        .collect();
    let mut profile = vec![Vec2::ZERO];
    profile.extend_from_slice(&outer);
    profile.push(Vec2::new(r * rim - wall * 0.5, stem + bowl + wall * 0.5));
    profile.extend(inside.iter().rev());
    profile.push(Vec2::new(0.0, inside[0].y));
    let tone = w.dice.color((0.02, 0.10), (0.80, 0.93));
    let noise = Noise(w.dice.seed());
    let sheen = Canvas::new(32, 32, tone).each(|uv, c| {
        let streak = (1.0 - ((uv.x - 0.3).abs() * 14.0)).max(0.0) + (1.0 - ((uv.x - 0.8).abs() * 20.0)).max(0.0);
        (c * (0.96 + 0.06 * noise.smooth(uv, (8, 4)))).lerp(Vec3::ONE, 0.7 * streak.min(1.0))
    });
    let glass = w.material(|_| material("glass", &sheen, 0.0, 0.12));
    let body = revolve(&profile, 36);
    let filled = w.dice.chance(0.75);
    let level = stem + bowl * w.dice.range(0.30, 0.52);
    if !filled {
        w.add(body, glass, 60.0);
        w.settle();
        return;
    }
    // Seen through the wall, wine colours the glass up to its level.
    let red = w.dice.chance(0.6);
    let base = if red { Vec3::new(0.36, 0.03, 0.08) } else { Vec3::new(0.88, 0.77, 0.40) };
    let wine_tone = w.dice.tint(base, 0.15);
    let wine = plain(w, "water", wine_tone, 0.15);
    let stained = w.material(|_| material("glass", &Canvas::new(4, 4, wine_tone.lerp(tone, 0.22)), 0.0, 0.12));
    let (full, clear) =
        body.split(|c, _| c.z > stem + bowl * 0.03 && c.z < level && c.truncate().length() > thin * 1.6);
    w.add(clear, glass, 60.0);
    w.add(full, stained, 60.0);
    let at = inside.windows(2).find(|p| p[1].y >= level).map_or(r * 0.8, |p| p[0].x.min(p[1].x));
    let top = revolve(&disc(at + wall * 0.4, level - 0.004, level, 0.0004), 32);
    w.add(top, wine, 30.0);
    w.settle();
}

/// A measuring jug: pale, with a lip, a handle and a printed volume scale.
pub fn measuring_cup(w: &mut Workshop) {
    let shape = w.shape();
    let height = w.dice.range(0.092, 0.125) * if shape == "tall" { 1.15 } else { 1.0 };
    let r = w.dice.range(0.041, 0.052);
    let (foot, belly) = match shape {
        "straight" | "tall" => (0.94, 0.97),
        "bell" => (0.74, 0.80),
        _ => (w.dice.range(0.78, 0.86), 0.91),
    };
    let outer = spline(
        &[
            Vec2::new(r * foot * 0.93, 0.0),
            Vec2::new(r * foot, height * 0.04),
            Vec2::new(r * (foot + belly) * 0.5, height * 0.3),
            Vec2::new(r * belly, height * 0.6),
            Vec2::new(r, height),
        ],
        5,
    );
    let wall = w.dice.range(0.0024, 0.0036);
    let pull = r * w.dice.range(0.20, 0.32);
    let lip = |p: Vec3| {
        let near = ((p.z / height - 0.78) / 0.22).clamp(0.0, 1.1).powi(2);
        let f = near * (-(p.y.atan2(-p.x) / 0.34).powi(2)).exp();
        p + Vec3::new(p.x, p.y, 0.0).normalize_or_zero() * pull * f + Vec3::Z * (pull * 0.25 * f)
    };
    let ground = w.dice.color((0.01, 0.10), (0.86, 0.96));
    let ink = if w.dice.chance(0.5) { w.dice.tint(Vec3::new(0.80, 0.08, 0.08), 0.15) } else { w.dice.vivid() * 0.7 };
    let body = around(revolve(&hollow(&outer, wall, wall * 1.5), 44), height);
    let (inside, outside) = body.split(|c, n| {
        let out = Vec3::new(c.x, c.y, 0.0).normalize_or_zero();
        n.dot(out) < -0.2 || n.z > 0.7
    });
    let steps = w.dice.pick(&[4, 5]);
    let mut canvas = Canvas::new(256, 128, ground);
    // One scale on either flank, between lip and handle.
    for middle in [0.25f32, 0.75] {
        for k in 0..=steps * 2 {
            let v = 0.88 - 0.70 * k as f32 / (steps * 2) as f32;
            let long = if k % 2 == 0 { 0.060 } else { 0.030 };
            canvas.rectangle(Vec2::new(middle - 0.06, v - 0.008), Vec2::new(middle - 0.06 + long, v + 0.008), ink);
            if k % 2 == 0 && k > 0 {
                let (x, y) = (((middle + 0.010) * 256.0) as i64, (v * 128.0) as i64 - 5);
                canvas.digit(k as u32 / 2, x, y, 2, ink);
                canvas.digit(0, x + 8, y, 2, ink);
                canvas.digit(0, x + 16, y, 2, ink);
            }
        }
        canvas.rectangle(Vec2::new(middle - 0.066, 0.17), Vec2::new(middle - 0.058, 0.89), ink);
    }
    let skin = w.material(|_| material("glass", &canvas, 0.0, 0.2));
    let bend = |s: Surface| Surface { points: s.points.iter().map(|&p| lip(p)).collect(), ..s };
    w.add(bend(outside), skin, 50.0);
    let lining = w.material(|_| glaze(ground * 0.97));
    weigh_alike(w, lining, skin);
    w.add(bend(inside), lining, 50.0);
    let ear = handle(
        &Roots { outer: &outer, into: wall * 0.5, z: (height * w.dice.range(0.88, 0.95), height * 0.16), height },
        w.dice.range(0.026, 0.034),
        w.dice.range(0.5, 1.0),
        w.dice.range(0.0038, 0.0050),
        w.dice.range(0.0065, 0.0085),
    );
    let grip = if w.dice.chance(0.6) { lining } else { vivid_plastic(w) };
    w.add(ear, grip, 60.0);
    w.settle();
}
