//! Hammers, mallets, screwdrivers.

use glam::{Mat3, Quat, Vec2, Vec3};

use super::Workshop;
use super::finish::{bright_steel, material, plastic, rubber, rubber_of, steel, wood};
use super::shape::{Ends, Surface};
use super::sweep::{Tip, along, revolve, rounded_box, spline, superellipse, sweep, tube};
use super::texture::Canvas;

/// A solid of revolution about the y axis from a profile `(radius, y)`.
fn about_y(profile: &[Vec2], n: usize) -> Surface {
    revolve(profile, n).turned(Mat3::from_quat(Quat::from_rotation_arc(Vec3::Z, Vec3::Y)))
}

/// A solid of revolution about the x axis from a profile `(radius, x)`.
fn about_x(profile: &[Vec2], n: usize) -> Surface {
    revolve(profile, n).turned(Mat3::from_quat(Quat::from_rotation_arc(Vec3::Z, Vec3::X)))
}

/// A claw hammer lying on its side: handle along -x, face towards +y, claw towards -y.
pub fn hammer(w: &mut Workshop) {
    let shape = w.shape();
    let length = if shape == "framing" { w.dice.range(0.33, 0.37) } else { w.dice.range(0.255, 0.325) };
    let face = w.dice.range(0.0125, 0.0160);
    let reach = w.dice.range(0.042, 0.055);
    let cheek = face * w.dice.range(0.85, 1.0);
    let metal = w.material(steel);
    let sides = if shape == "octagonal" { 8 } else { 20 };
    let poll = [
        Vec2::new(0.0, 0.0),
        Vec2::new(cheek, 0.0),
        Vec2::new(cheek, cheek * 0.9),
        Vec2::new(face * 0.72, cheek * 1.3),
        Vec2::new(face * 0.72, reach * 0.62),
        Vec2::new(face, reach * 0.72),
        Vec2::new(face, reach * 0.97),
        Vec2::new(face * 0.92, reach),
        Vec2::new(0.0, reach),
    ];
    w.add(about_y(&poll, sides).uv_box(Vec2::splat(0.06)), metal, 30.0);
    let eye = rounded_box(Vec3::new(cheek * 2.1, cheek * 2.3, cheek * 1.9), 0.004, 0.003);
    w.add(eye.uv_box(Vec2::splat(0.06)), metal, 35.0);
    claw(w, shape, cheek, metal);
    hammer_handle(w, shape, length, cheek, metal);
    w.settle();
}

/// Two prongs that part and bend back towards the handle.
fn claw(w: &mut Workshop, shape: &str, cheek: f32, metal: usize) {
    let reach = w.dice.range(0.055, 0.072);
    let bend =
        if shape == "straight" || shape == "framing" { w.dice.any(0.004, 0.010) } else { w.dice.range(0.020, 0.032) };
    let gap = w.dice.any(0.0055, 0.0085);
    for side in [-1.0f32, 1.0] {
        let path = spline(
            &[
                Vec3::new(0.0, -cheek * 0.4, side * cheek * 0.42),
                Vec3::new(0.001, -cheek - reach * 0.15, side * cheek * 0.46),
                Vec3::new(-bend * 0.35, -cheek - reach * 0.50, side * (cheek * 0.42 + gap * 0.35)),
                Vec3::new(-bend, -cheek - reach * 0.86, side * (cheek * 0.36 + gap)),
            ],
            5,
        );
        let prong = sweep(&path, Vec3::Z, Ends::Capped, |_, t| {
            superellipse(
                cheek * along(&[(0.0, 0.92), (0.45, 0.62), (1.0, 0.12)], t),
                cheek * along(&[(0.0, 0.56), (0.5, 0.40), (1.0, 0.24)], t),
                4.0,
                12,
            )
        });
        w.add(prong.uv_box(Vec2::splat(0.06)), metal, 35.0);
    }
}

fn hammer_handle(w: &mut Workshop, shape: &str, length: f32, cheek: f32, metal: usize) {
    let wide = w.dice.range(0.0125, 0.0160);
    let thick = wide * w.dice.range(0.68, 0.85);
    let wooden = !(shape == "rubber_grip" || shape == "steel" || shape == "framing");
    let profile = if wooden {
        [(0.0, 0.80), (0.3, 0.78), (0.55, 0.95), (0.8, 1.02), (1.0, 1.12)]
    } else {
        [(0.0, 0.72), (0.3, 0.68), (0.5, 0.66), (0.8, 0.66), (1.0, 0.66)]
    };
    let path: Vec<Vec3> =
        (0..=22).map(|i| Vec3::new(cheek * 1.12 - (length - cheek) * i as f32 / 22.0, 0.0, 0.0)).collect();
    let stick = tube(&path, Vec3::Z, 14, [Tip::Flat, Tip::Round], |t| {
        let s = along(&profile, t);
        (wide * s, thick * s)
    });
    let stuff = if wooden {
        w.material(wood)
    } else if shape == "steel" || w.dice.chance(0.4) {
        metal
    } else {
        let tone = w.dice.vivid();
        w.material(|d| plastic(d, tone))
    };
    w.add(stick.uv_box(Vec2::new(0.06, 0.16)), stuff, 50.0);
    if wooden {
        return;
    }
    let share = w.dice.range(0.42, 0.55);
    let end = path[22].x - 0.006;
    let grip: Vec<Vec3> =
        (0..=20).map(|i| Vec3::new(end + length * share * (1.0 - i as f32 / 20.0), 0.0, 0.0)).collect();
    let ridges = w.dice.chance(0.5);
    let sleeve = tube(&grip, Vec3::Z, 16, [Tip::Flat, Tip::Round], |t| {
        let wave = if ridges { 1.0 + 0.05 * (t * 60.0).sin() } else { 1.0 };
        let s = along(&[(0.0, 0.86), (0.3, 1.0), (0.6, 0.94), (0.9, 1.14), (1.0, 1.1)], t) * wave;
        (wide * s, thick * s * 1.05)
    });
    let dark = if w.dice.chance(0.6) {
        w.material(rubber)
    } else {
        let tone = w.dice.vivid() * 0.85;
        w.material(|d| rubber_of(d, tone))
    };
    w.add(sleeve.uv_box(Vec2::splat(0.04)), dark, 45.0);
}

/// A mallet with a large wooden or rubber head across its handle.
pub fn mallet(w: &mut Workshop) {
    let shape = w.shape();
    let length = w.dice.range(0.255, 0.335);
    let span = w.dice.range(0.095, 0.135);
    let r = span * w.dice.range(0.25, 0.32);
    let head_wood = matches!(shape, "block" | "wedge" | "barrel") || (shape == "drum" && w.dice.chance(0.4));
    let stuff = if head_wood {
        w.material(wood)
    } else if shape == "dead_blow" || w.dice.chance(0.3) {
        let tone = if w.dice.chance(0.4) { w.dice.tint(Vec3::splat(0.85), 0.06) } else { w.dice.vivid() };
        w.material(|d| rubber_of(d, tone))
    } else {
        w.material(rubber)
    };
    let h = span / 2.0;
    let head = match shape {
        "block" | "wedge" => {
            let taper = if shape == "wedge" { 0.22 } else { w.dice.range(0.0, 0.16) };
            rounded_box(Vec3::new(r * 2.3, span, r * 1.75), 0.004, 0.004)
                .map(|p| Vec3::new(p.x, p.y * (1.0 + taper * p.x / (r * 1.15)), p.z))
        }
        _ => {
            let belly = if shape == "barrel" { 1.18 } else { 1.0 };
            let b = w.dice.any(0.003, 0.007);
            about_y(
                &[
                    Vec2::new(0.0, -h),
                    Vec2::new(r - b, -h),
                    Vec2::new(r, -h + b),
                    Vec2::new(r * (1.0 + (belly - 1.0) * 0.7), -h * 0.5),
                    Vec2::new(r * belly, 0.0),
                    Vec2::new(r * (1.0 + (belly - 1.0) * 0.7), h * 0.5),
                    Vec2::new(r, h - b),
                    Vec2::new(r - b, h),
                    Vec2::new(0.0, h),
                ],
                28,
            )
        }
    };
    // Grain of the head runs along y: swap the axes that the projection sees.
    let grain = Vec2::new(0.07, 0.14);
    let head = head.map(|p| Vec3::new(p.y, p.x, -p.z)).uv_box(grain).map(|p| Vec3::new(p.y, p.x, -p.z));
    if shape == "two_faced" {
        let cut = h * w.dice.range(0.40, 0.55);
        let (far, rest) = (head.clone(), head);
        let tone = w.dice.vivid();
        let second = w.material(|d| rubber_of(d, tone));
        w.add(rest.map(|p| Vec3::new(p.x * 0.9, p.y * cut / h, p.z * 0.9)), stuff, 35.0);
        for side in [-1.0f32, 1.0] {
            let puck = far.clone().map(|p| Vec3::new(p.x, (p.y / h + 1.0) / 2.0 * (h - cut * 0.96), p.z));
            let puck = puck.map(|p| Vec3::new(p.x, side * (cut * 0.96 + p.y), p.z));
            w.add(puck, if side > 0.0 { second } else { stuff }, 35.0);
        }
    } else {
        w.add(head, stuff, 35.0);
    }
    let wide = w.dice.range(0.0115, 0.0150);
    let top = r * 1.25;
    let path: Vec<Vec3> = (0..=16).map(|i| Vec3::new(top - (length - top * 0.2) * i as f32 / 16.0, 0.0, 0.0)).collect();
    let swell = w.dice.range(0.9, 1.2);
    let stick = tube(&path, Vec3::Z, 14, [Tip::Flat, Tip::Round], |t| {
        let s = along(&[(0.0, 0.9), (0.4, 0.85), (0.75, swell), (1.0, swell * 1.05)], t);
        (wide * s, wide * 0.85 * s)
    });
    let wooden = head_wood || w.dice.chance(0.7);
    let grip = if wooden {
        w.material(wood)
    } else {
        let tone = w.dice.vivid();
        w.material(|d| plastic(d, tone))
    };
    w.add(stick.uv_box(Vec2::new(0.06, 0.16)), grip, 50.0);
    w.settle();
}

/// A screwdriver: plastic handle with flutes, steel shaft, flat or cross tip towards +x.
pub fn screwdriver(w: &mut Workshop) {
    let shape = w.shape();
    let (grip, shaft) = match shape {
        "stubby" => (w.dice.range(0.075, 0.085), w.dice.range(0.055, 0.065)),
        "slim" => (w.dice.range(0.095, 0.105), w.dice.range(0.12, 0.14)),
        _ => (w.dice.range(0.088, 0.118), w.dice.range(0.085, 0.135)),
    };
    let r = if shape == "slim" { 0.0115 } else { w.dice.range(0.0130, 0.0175) };
    let table: &[(f32, f32)] = match shape {
        "bulb" => &[(0.0, 0.75), (0.12, 1.0), (0.45, 1.08), (0.72, 0.62), (0.84, 0.60), (0.93, 0.78), (1.0, 0.6)],
        "cushion" => &[(0.0, 0.86), (0.08, 1.0), (0.5, 0.86), (0.74, 1.0), (0.86, 0.64), (0.95, 0.72), (1.0, 0.6)],
        _ => &[(0.0, 0.85), (0.06, 1.0), (0.7, 0.98), (0.80, 0.68), (0.92, 0.66), (1.0, 0.5)],
    };
    let mut profile = vec![Vec2::new(0.0, 0.0)];
    profile.extend((0..=26).map(|i| {
        let t = i as f32 / 26.0;
        Vec2::new(r * along(table, t), grip * t)
    }));
    profile.push(Vec2::new(0.0, grip));
    let (flutes, depth) = match shape {
        "hexagonal" => (6.0, 0.10),
        "bulb" => (3.0, w.dice.any(0.03, 0.07)),
        _ => (w.dice.pick(&[6.0, 8.0]), w.dice.any(0.06, 0.12)),
    };
    let body = about_x(&profile, 48).map(|p| {
        let t = p.x / grip;
        let on = along(&[(0.0, 0.0), (0.1, 1.0), (0.62, 1.0), (0.78, 0.0), (1.0, 0.0)], t);
        let k = 1.0 - depth * on * (0.5 + 0.5 * (flutes * p.z.atan2(p.y)).cos()).powi(2);
        Vec3::new(p.x, p.y * k, p.z * k)
    });
    let tone = w.dice.vivid();
    let second = if w.dice.chance(0.6) { w.dice.tint(Vec3::splat(0.12), 0.3) } else { w.dice.vivid() };
    let main = w.material(|d| plastic(d, tone));
    let zone = w.dice.pick(&[(0.0, 0.0), (0.0, 0.12), (0.74, 1.1), (0.2, 0.66)]);
    let (other, rest) = body.split(|c, _| zone.0 * grip <= c.x && c.x < zone.1 * grip);
    w.add(rest.uv_box(Vec2::splat(0.05)), main, 45.0);
    if !other.faces.is_empty() {
        let dark = w.material(|d| {
            if d.chance(0.5) { rubber_of(d, second) } else { material("plastic", &Canvas::new(4, 4, second), 0.0, 0.4) }
        });
        w.add(other.uv_box(Vec2::splat(0.05)), dark, 45.0);
    }
    let thin = r * w.dice.range(0.20, 0.29);
    let metal = w.material(steel);
    let cross = w.dice.chance(0.5);
    let end = grip + shaft;
    let rings: Vec<Vec3> =
        [grip - 0.008, grip + 0.02, end - 0.022, end - 0.014, end - 0.007, end].map(|x| Vec3::new(x, 0.0, 0.0)).into();
    let rod = sweep(&rings, Vec3::Z, Ends::Capped, |i, _| {
        let (a, b) = match (i, cross) {
            (3, false) => (1.25, 0.75),
            (4, false) => (1.45, 0.40),
            (5, false) => (1.35, 0.20),
            (4, true) => (0.9, 0.9),
            (5, true) => (0.25, 0.25),
            _ => (1.0, 1.0),
        };
        superellipse(thin * a, thin * b, 2.2, 14)
    });
    let dark_tip = w.dice.chance(0.4);
    let (tip, rest) = rod.split(|c, _| c.x > end - 0.02);
    w.add(rest.uv_box(Vec2::splat(0.06)), metal, 40.0);
    let ink = if dark_tip {
        w.material(|_| material("steel", &Canvas::new(4, 4, Vec3::splat(0.15)), 0.3, 0.6))
    } else {
        w.material(bright_steel)
    };
    w.add(tip.uv_box(Vec2::splat(0.06)), ink, 40.0);
    w.settle();
}
