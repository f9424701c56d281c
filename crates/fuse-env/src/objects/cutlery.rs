//! Knives, spoons, ladles.

use glam::{Mat3, Vec2, Vec3};

use super::Workshop;
use super::finish::{bright_steel, plastic, rubber, steel, wood};
use super::shape::{Ends, Surface};
use super::sweep::{Tip, along, hollow, loop_tube, revolve, spline, superellipse, sweep, tube};

/// A flat blade along x: `edge(t)` and `spine(t)` give y, `half(t)` half the thickness of the
/// spine, at `t` in [0, 1] from heel (`x0`) to tip (`x1`).
fn blade(
    x: (f32, f32),
    edge: impl Fn(f32) -> f32,
    spine: impl Fn(f32) -> f32,
    half: impl Fn(f32) -> f32,
    ground: f32,
) -> Surface {
    let steps = 36;
    let rings: Vec<Vec<Vec3>> = (0..=steps)
        .map(|i| {
            // Denser towards the tip, where the outline turns fastest.
            let t = 1.0 - (1.0 - i as f32 / steps as f32).powf(1.5);
            let (at, e, s, h) = (x.0 + (x.1 - x.0) * t, edge(t), spine(t), half(t));
            let m = e + (s - e) * ground;
            [(e, 0.15), (m, 0.75), (s, 1.0), (s, -1.0), (m, -0.75), (e, -0.15)]
                .iter()
                .map(|&(y, f)| Vec3::new(at, y, f * h))
                .collect()
        })
        .collect();
    Surface::loft(&rings, Ends::Capped)
}

/// A kitchen knife: wide pointed steel blade, riveted handle.
pub fn knife(w: &mut Workshop) {
    let shape = w.shape();
    let (length, width) = match shape {
        "santoku" => (w.dice.range(0.145, 0.19), w.dice.range(0.040, 0.050)),
        "utility" => (w.dice.range(0.130, 0.18), w.dice.range(0.026, 0.036)),
        "petty" => (w.dice.range(0.13, 0.17), w.dice.range(0.027, 0.034)),
        "carving" => (w.dice.range(0.19, 0.23), w.dice.range(0.030, 0.037)),
        _ => (w.dice.range(0.165, 0.22), w.dice.range(0.040, 0.053)),
    };
    let (belly, drop) = match shape {
        "santoku" => (w.dice.range(0.15, 0.3), 0.95),
        "chef" | "gyuto" => (w.dice.range(0.5, 0.75), 0.22),
        _ => (w.dice.range(0.35, 0.6), 0.35),
    };
    let half = w.dice.range(0.0010, 0.0016);
    let top = width * 0.42;
    let bottom = top - width;
    // The tip lies where the belly has risen by `belly` of the width and the spine fallen.
    let tip = top - width * if shape == "santoku" { 0.80 } else { 0.42 - 0.25 * (belly - 0.5) };
    let rise = if shape == "santoku" { 5.0 } else { 2.6 };
    let edge = move |t: f32| bottom + (tip - bottom - 0.0004) * t.powf(rise);
    let spine = move |t: f32| {
        let s = if drop > 0.9 { ((t - 0.72) / 0.28).clamp(0.0, 1.0).powi(2) } else { t.powf(2.0 + 3.0 * drop) };
        top + (tip - top + 0.0004) * s
    };
    let ground = w.dice.any(0.16, 0.26);
    let body = blade((0.0, length), edge, spine, move |t| half * (1.0 - 0.6 * t), ground);
    // The ground strip is lit differently.
    let (lit, flat) = body.split(|c, n| {
        let t = (c.x / length).clamp(0.0, 1.0);
        n.x.abs() < 0.9 && c.y < edge(t) + (spine(t) - edge(t)) * ground * 0.9
    });
    let metal = w.material(steel);
    w.add(flat.map_uv(|p, _| Vec2::new(p.x / 0.06, p.y / 0.06)), metal, 25.0);
    let bright = w.material(bright_steel);
    w.add(lit, bright, 25.0);
    knife_handle(w, top, width, metal);
    w.settle();
}

/// Two scales around a tang with rivets and a bolster, moulded, or round and wooden.
fn knife_handle(w: &mut Workshop, top: f32, width: f32, metal: usize) {
    let length = w.dice.range(0.10, 0.135);
    let deep = w.dice.range(0.0105, 0.0140);
    let thick = w.dice.range(0.0080, 0.0105);
    let middle = top - deep * 0.95;
    let round = w.dice.chance(0.2);
    let sag = w.dice.any(0.001, 0.006);
    let pommel = w.dice.any(0.0, 0.35);
    let profile = [(0.0, 0.95), (0.25, 1.0), (0.55, 0.86), (0.85, 1.0 + pommel), (1.0, 0.9 + pommel)];
    let path: Vec<Vec3> = (0..=18)
        .map(|i| {
            let t = i as f32 / 18.0;
            Vec3::new(-t * length, middle - sag * (t * 3.0).sin() * 0.6 - sag * t * t, 0.0)
        })
        .collect();
    let boxy = if round { 2.0 } else { w.dice.any(2.6, 4.5) };
    let grip = sweep(&path, Vec3::Z, Ends::Capped, |_, t| {
        let scale = along(&profile, t) * (1.0 - (t * 1.02).powi(14) * 0.4);
        superellipse(deep * scale, thick * if round { scale } else { 1.0 - (t * 1.02).powi(14) * 0.4 }, boxy, 16)
    });
    let dark = w.dice.chance(0.6);
    let stuff = if dark {
        let tone = w.dice.tint(Vec3::new(0.12, 0.11, 0.11), 0.35);
        w.material(|d| plastic(d, tone))
    } else if w.dice.chance(0.75) {
        w.material(wood)
    } else {
        let tone = w.dice.vivid() * 0.7;
        w.material(|d| plastic(d, tone))
    };
    w.add(grip.uv_box(Vec2::new(0.08, 0.16)), stuff, 35.0);
    if !round {
        let plate = sweep(&path, Vec3::Z, Ends::Capped, |_, t| {
            let scale = along(&profile, t) * (1.0 - (t * 1.02).powi(14) * 0.4);
            superellipse(deep * scale + 0.0006, 0.0016, 6.0, 12)
        });
        w.add(plate.uv_box(Vec2::splat(0.06)), metal, 35.0);
    }
    if !round && w.dice.chance(0.85) {
        let count = if w.dice.chance(0.8) { 3 } else { 2 };
        let radius = w.dice.any(0.0028, 0.0040);
        for i in 0..count {
            let t = 0.18 + 0.6 * i as f32 / (count - 1) as f32;
            let at = path[(t * 18.0) as usize];
            let h = thick + 0.0004;
            let rivet =
                revolve(&[Vec2::new(0.0, -h), Vec2::new(radius, -h), Vec2::new(radius, h), Vec2::new(0.0, h)], 12);
            let bright = w.material(bright_steel);
            w.add(rivet.moved(at), bright, 30.0);
        }
    }
    if w.dice.chance(0.7) || round {
        let reach = w.dice.any(0.008, 0.014);
        let neck = [Vec3::new(-0.003, middle, 0.0), Vec3::new(reach * 0.5, middle, 0.0), Vec3::new(reach, middle, 0.0)];
        let down = (width * 0.40).min(deep * 1.1);
        let bolster = sweep(&neck, Vec3::Z, Ends::Capped, |i, _| {
            superellipse(if round { deep } else { down }, [thick * 1.03, thick * 0.8, 0.0022][i], 3.0, 16)
        });
        w.add(bolster.uv_box(Vec2::splat(0.06)), metal, 35.0);
    }
}

/// A flat bar of flatware along x: `width(t)`, `thick(t)` half-sizes, `lift(t)` height.
pub fn bar(
    x: (f32, f32),
    steps: usize,
    width: impl Fn(f32) -> f32,
    thick: impl Fn(f32) -> f32,
    lift: impl Fn(f32) -> f32,
) -> Surface {
    let rings: Vec<Vec<Vec3>> = (0..=steps)
        .map(|i| {
            let t = i as f32 / steps as f32;
            // Ends are dense so that they can be round.
            let t = t * t * (3.0 - 2.0 * t);
            superellipse(width(t), thick(t), 2.8, 12)
                .iter()
                .map(|s| Vec3::new(x.0 + (x.1 - x.0) * t, s.x, lift(t) + s.y))
                .collect()
        })
        .collect();
    Surface::loft(&rings, Ends::Capped)
}

/// Rounds off both ends of a width table.
pub fn round_ends(t: f32, first: f32, last: f32) -> f32 {
    let ease = |d: f32, over: f32| {
        let s = (d / over.max(1e-4)).clamp(0.0, 1.0);
        (1.0 - (1.0 - s) * (1.0 - s)).max(0.0).sqrt()
    };
    (ease(t, first) * ease(1.0 - t, last)).max(0.06)
}

/// A table knife with a slim handle and a rounded blunt blade.
pub fn butter_knife(w: &mut Workshop) {
    let shape = w.shape();
    let length = if shape == "spreader" { w.dice.range(0.16, 0.18) } else { w.dice.range(0.185, 0.225) };
    let share = w.dice.range(0.42, 0.52);
    let grip = w.dice.range(0.0052, 0.0085);
    let broad = match shape {
        "spreader" | "spatulate" | "leaf" => w.dice.range(0.0125, 0.0145),
        _ => w.dice.range(0.0085, 0.0125),
    };
    let neck = w.dice.range(0.0032, 0.0045);
    let start = 1.0 - share;
    let bend = match shape {
        "hump" => 0.35,
        "straight" => 0.0,
        _ => 0.15,
    };
    let widest = if shape == "leaf" { 0.5 } else { 0.72 };
    let table = [
        (0.0, grip),
        (start * 0.25, grip * 0.95),
        (start * 0.92, neck),
        (start + share * 0.12, broad * 0.72),
        (start + share * widest, broad),
        (1.0, broad * if shape == "leaf" { 0.5 } else { 0.85 }),
    ];
    let thick = w.dice.range(0.0016, 0.0024);
    let metal_handle = w.dice.chance(0.55);
    let flat =
        move |t: f32| along(&[(0.0, thick), (start * 0.9, thick * 1.1), (start + 0.06, 0.0011), (1.0, 0.0008)], t);
    let surface = bar(
        (-length / 2.0, length / 2.0),
        56,
        |t| along(&table, t) * round_ends(t, 0.035, broad * 1.1 / length),
        |t| flat(t) * round_ends(t, 0.012, 0.01),
        |_| 0.0,
    )
    .map(|p| {
        let t = (p.x / length + 0.5 - start) / share;
        Vec3::new(p.x, p.y + bend * broad * (t.clamp(0.0, 1.0) * std::f32::consts::PI).sin(), p.z)
    });
    let metal = w.material(steel);
    w.add(surface.map_uv(|p, _| Vec2::new(p.y / 0.06, p.x / 0.06)), metal, 40.0);
    if !metal_handle {
        let (from, to) = (-length / 2.0 - 0.003, -length / 2.0 + length * start * 0.86);
        let stuff = if w.dice.chance(0.5) {
            w.material(wood)
        } else {
            let tone = w.dice.color((0.1, 0.8), (0.3, 0.95));
            w.material(|d| plastic(d, tone))
        };
        let bulge = grip * w.dice.any(1.0, 1.25);
        let sleeve = bar(
            (from, to),
            24,
            |t| along(&[(0.0, bulge), (0.4, bulge * 0.95), (1.0, bulge * 0.72)], t) * round_ends(t, 0.09, 0.05),
            |t| bulge * 0.62 * round_ends(t, 0.08, 0.06),
            |_| 0.0,
        );
        w.add(sleeve.uv_box(Vec2::new(0.08, 0.16)), stuff, 40.0);
    }
    w.settle();
}

/// A bowl that opens upwards: outline half-axes `a` (along x) and `b`, `depth`, `wall`; `egg`
/// narrows it towards +x.
fn scoop_bowl(a: f32, b: f32, depth: f32, wall: f32, egg: f32, boxy: f32) -> Surface {
    let mut profile = vec![Vec2::new(0.0, -depth)];
    let arc = |r: f32| -depth * (1.0 - r.powf(boxy)).max(0.0);
    for k in 1..=9 {
        let r = k as f32 / 9.0;
        profile.push(Vec2::new(r, arc(r)));
    }
    for k in (0..9).rev() {
        let r = k as f32 / 9.0;
        profile.push(Vec2::new(r * 0.97, (arc(r * 0.97) + wall).max(-depth + wall)));
    }
    // The inner rim must not stand above the outer by more than the wall.
    revolve(&profile, 28).map(|p| {
        let narrow = 1.0 - egg * p.x;
        Vec3::new(p.x * a, p.y * b * narrow, p.z)
    })
}

/// Table and serving spoons.
pub fn spoon(w: &mut Workshop) {
    let shape = w.shape();
    let length = match shape {
        "long" => w.dice.range(0.20, 0.24),
        _ => w.dice.range(0.155, 0.215),
    };
    let a = length * w.dice.range(0.145, 0.18);
    let ratio = match shape {
        "round" => w.dice.range(0.84, 0.98),
        "broad" => w.dice.range(0.76, 0.85),
        _ => w.dice.range(0.60, 0.72),
    };
    let egg = match shape {
        "egg" => w.dice.range(0.10, 0.2),
        "pointed" => 0.28,
        _ => w.dice.range(0.0, 0.08),
    };
    let b = a * ratio;
    let depth = b * w.dice.range(0.42, 0.58);
    let wooden = w.dice.chance(0.22);
    let wall = if wooden { 0.003 } else { 0.0014 };
    let stuff = if wooden {
        w.material(wood)
    } else if w.dice.chance(0.85) {
        w.material(steel)
    } else {
        let tone = w.dice.vivid();
        w.material(|d| plastic(d, tone))
    };
    let bowl = scoop_bowl(a, b, depth, wall, egg, 2.2);
    w.add(bowl.map_uv(|p, _| Vec2::new(p.y / 0.06, p.x / 0.06)), stuff, 50.0);
    let stem = length - 2.0 * a;
    let (neck, end) = (w.dice.range(0.0028, 0.0042), w.dice.range(0.0065, 0.0115));
    let thick = if wooden { 0.0045 } else { w.dice.range(0.0014, 0.0022) };
    let (rise, droop) = (w.dice.range(0.010, 0.020), w.dice.range(0.008, 0.016));
    let from = -a + 0.004;
    let handle = bar(
        (from, -a - stem),
        30,
        |t| {
            let wide = if wooden { 0.0055 } else { along(&[(0.0, neck * 1.5), (0.2, neck), (1.0, end)], t) };
            wide * round_ends(t, 0.02, end / stem)
        },
        |t| thick * along(&[(0.0, 1.0), (0.25, 1.2), (1.0, 0.8)], t) * round_ends(t, 0.02, 0.02),
        |t| -0.001 + rise * (t * 2.4).sin().max(0.0).powf(0.9) - droop * t * t,
    );
    w.add(handle.map_uv(|p, _| Vec2::new(p.y / 0.06, p.x / 0.06)), stuff, 50.0);
    w.settle();
}

/// A deep round bowl at the end of a long rising handle.
pub fn ladle(w: &mut Workshop) {
    let shape = w.shape();
    let radius = w.dice.range(0.036, 0.050);
    let depth = radius * w.dice.range(0.72, 0.95);
    let wall = 0.0018;
    let outer: Vec<Vec2> = (1..=9)
        .map(|k| {
            let angle = std::f32::consts::FRAC_PI_2 * k as f32 / 9.0;
            Vec2::new(radius * angle.sin().powf(0.85), -depth * angle.cos())
        })
        .collect();
    let lip = if shape == "lipped" { 0.3 } else { 0.0 };
    let bowl = revolve(&hollow(&outer, wall, wall), 32).map(|p| {
        let pull = lip * (1.0 + p.z / depth).clamp(0.0, 1.0).powi(2) * (p.y / radius).clamp(0.0, 1.0).powi(6);
        Vec3::new(p.x, p.y + radius * pull, p.z)
    });
    let dark = w.dice.chance(0.3);
    let metal = if dark {
        let tone = if w.dice.chance(0.5) { w.dice.tint(Vec3::splat(0.12), 0.3) } else { w.dice.vivid() };
        w.material(|d| plastic(d, tone))
    } else {
        w.material(steel)
    };
    w.add(bowl.map_uv(|p, _| Vec2::new(p.x / 0.06, p.y / 0.06)), metal, 40.0);
    let length = w.dice.range(0.19, 0.26);
    let slope = if shape == "tilted" { w.dice.range(0.7, 0.85) } else { w.dice.range(0.35, 0.6) };
    let direction = Vec3::new(-slope.cos(), 0.0, slope.sin());
    let root = Vec3::new(-radius + wall * 0.5, 0.0, -0.012);
    let mut controls = vec![
        root,
        root + Vec3::new(-0.004, 0.0, 0.014),
        root + direction * 0.05 + Vec3::Z * 0.012,
        root + direction * length * 0.6 + Vec3::Z * 0.012,
        root + direction * length + Vec3::Z * 0.006,
    ];
    let tail = *controls.last().unwrap_or(&root);
    if shape == "hook" || shape == "lipped" {
        controls.push(tail + direction * 0.016 + Vec3::new(-0.004, 0.0, -0.008));
        controls.push(tail + direction * 0.012 + Vec3::new(0.0, 0.0, -0.026));
    }
    let path = spline(&controls, 6);
    let (wide, thick) = (w.dice.range(0.0055, 0.0085), w.dice.range(0.0014, 0.0024));
    let stem = tube(&path, Vec3::Y, 10, [Tip::Flat, Tip::Round], |_| (thick, wide));
    w.add(stem.uv_box(Vec2::splat(0.06)), metal, 40.0);
    if w.dice.chance(0.45) || shape == "loop" {
        let (from, to) = (root + direction * length * 0.5 + Vec3::Z * 0.012, tail);
        let grip =
            tube(&[from, from.lerp(to, 0.3), from.lerp(to, 0.7), to], Vec3::Y, 12, [Tip::Round, Tip::Round], |t| {
                (thick * 2.6, wide * along(&[(0.0, 1.1), (0.5, 1.5), (1.0, 1.6)], t))
            });
        let stuff = if w.dice.chance(0.5) { w.material(rubber) } else { w.material(wood) };
        w.add(grip.uv_box(Vec2::new(0.08, 0.16)), stuff, 40.0);
    }
    if shape == "loop" {
        let ring: Vec<Vec3> = (0..16)
            .map(|k| {
                let (s, c) = (std::f32::consts::TAU * k as f32 / 16.0).sin_cos();
                Mat3::from_rotation_y(slope) * Vec3::new(0.010 * c, 0.010 * s, 0.0)
            })
            .collect();
        let up = Mat3::from_rotation_y(slope) * Vec3::Z;
        let eye = loop_tube(&ring, up, 8, |_| (0.002, 0.002)).moved(tail + direction * 0.012);
        w.add(eye, metal, 60.0);
    }
    w.settle();
}
