//! Forks, chopsticks, whisks, spatulas, tongs, rolling pins.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::Workshop;
use super::cutlery::{bar, round_ends};
use super::finish::{plastic, rubber, steel, wood};
use super::parts::{about_x, add_steel, disc, grip_stuff, torus, vivid_plastic, vivid_rubber, weigh_alike};
use super::shape::{Ends, Surface};
use super::sweep::{Tip, along, revolve, rounded_box, spline, superellipse, sweep, tube};

/// A table fork: handle, shoulder, three or four tines.
pub fn fork(w: &mut Workshop) {
    let shape = w.shape();
    let tines = if shape == "three_tined" { 3 } else { 4 };
    let stem = w.dice.range(0.112, 0.135) * if shape == "dessert" { 0.85 } else { 1.0 };
    let (root, tine) = (w.dice.range(0.020, 0.026), w.dice.range(0.042, 0.054));
    let half = w.dice.range(0.0108, 0.0138) * if shape == "serving" { 1.25 } else { 1.0 };
    let thick = w.dice.range(0.0010, 0.0015);
    let dip = w.dice.range(0.006, 0.011);
    let lift = move |x: f32| {
        let u = (x / (root + tine)).clamp(0.0, 1.0);
        -dip * (PI * u.powf(0.8)).sin() + 0.004 * u
    };
    let metal = w.material(steel);
    let flat = |s: Surface| s.map_uv(|p, _| Vec2::new(p.y / 0.06, p.x / 0.06));
    let neck = w.dice.range(0.0030, 0.0042);
    let shoulder = bar(
        (-0.012, root),
        22,
        |t| along(&[(0.0, neck), (0.25, neck * 1.05), (0.75, half * 0.94), (1.0, half)], t),
        |_| thick * 1.15,
        move |t| lift(-0.012 + (root + 0.012) * t),
    );
    w.add(flat(shoulder), metal, 50.0);
    let wide = half * 2.0 / (tines as f32 * 1.62 - 0.62);
    for k in 0..tines {
        let y = -half + wide / 2.0 + (half * 2.0 - wide) * k as f32 / (tines - 1) as f32;
        let path: Vec<Vec3> = (0..=9)
            .map(|i| {
                let x = root - 0.003 + (tine + 0.003) * i as f32 / 9.0;
                Vec3::new(x, y, lift(x))
            })
            .collect();
        let prong = tube(&path, Vec3::Z, 8, [Tip::Flat, Tip::Round], |t| {
            (wide / 2.0 * along(&[(0.0, 1.0), (0.6, 0.86), (1.0, 0.35)], t), thick * (1.1 - 0.4 * t))
        });
        w.add(flat(prong), metal, 50.0);
    }
    let (end, rise, droop) = (w.dice.range(0.0065, 0.0105), w.dice.range(0.008, 0.016), w.dice.range(0.008, 0.014));
    let stuff = if w.dice.chance(0.25) { grip_stuff(w, 0.6, 0.2) } else { metal };
    let round = if stuff == metal { 1.0 } else { 2.6 };
    let handle = bar(
        (-0.010, -0.010 - stem),
        28,
        |t| along(&[(0.0, neck), (0.25, neck), (1.0, end)], t) * round_ends(t, 0.01, end / stem),
        |t| thick * round * along(&[(0.0, 1.0), (0.3, 1.3), (1.0, 0.9)], t) * round_ends(t, 0.02, 0.02),
        |t| rise * (t * 2.4).sin().max(0.0) - droop * t * t,
    );
    w.add(flat(handle), stuff, 50.0);
    w.settle();
}

/// A pair of chopsticks, side by side, a little apart at one end.
pub fn chopsticks(w: &mut Workshop) {
    let shape = w.shape();
    let length = w.dice.range(0.215, 0.25) * if shape == "long" { 1.12 } else { 1.0 };
    let (thick, tip) = (w.dice.range(0.0036, 0.0048), w.dice.range(0.0014, 0.0022));
    let boxy = match shape {
        "round" | "long" => 2.0,
        "faceted" => 2.8,
        _ => 6.0,
    };
    let turns = if shape == "twisted" { 1.5 } else { 0.0 };
    let low = if shape == "flat" { 0.6 } else { 1.0 };
    let stuff = if w.dice.chance(0.5) { w.material(wood) } else { vivid_plastic(w) };
    let second = if w.dice.chance(0.6) { vivid_plastic(w) } else { stuff };
    weigh_alike(w, second, stuff);
    let band = w.dice.range(0.55, 0.85);
    let spread = w.dice.range(0.03, 0.07);
    for side in [-1.0f32, 1.0] {
        let path: Vec<Vec3> = (0..=24).map(|i| Vec3::X * (length * (i as f32 / 24.0 - 0.5))).collect();
        let stick = sweep(&path, Vec3::Z, Ends::Capped, |_, t| {
            let r = thick + (tip - thick) * t * t.sqrt();
            let angle = turns * TAU * (0.4 - t).max(0.0);
            superellipse(r, r * low, boxy, 16).iter().map(|p| Vec2::from_angle(angle).rotate(*p)).collect()
        });
        let slant = side * spread / 2.0;
        let place = |s: Surface| {
            s.map(|p| {
                let y = p.y + side * (tip + 0.0012) + slant * (length / 2.0 - p.x);
                Vec3::new(p.x, y, p.z)
            })
        };
        let (front, back) = stick.split(|c, _| c.x > length * (0.5 - band));
        w.add(place(front).uv_box(Vec2::new(0.02, 0.10)), stuff, 45.0);
        w.add(place(back).uv_box(Vec2::new(0.02, 0.05)), second, 45.0);
    }
    w.settle();
}

/// A balloon whisk: a handle and loops of wire around its axis.
pub fn whisk(w: &mut Workshop) {
    let shape = w.shape();
    let grip = w.dice.range(0.105, 0.135);
    let cage = w.dice.range(0.125, 0.165);
    let belly = w.dice.range(0.027, 0.036) * if shape == "slim" { 0.8 } else { 1.0 };
    let peak = match shape {
        "french" | "slim" => 0.60,
        "ball" => 0.74,
        _ => 0.68,
    };
    let squash = if shape == "flat" { 0.35 } else { 1.0 };
    let loops = if shape == "french" { 6 } else { 5 };
    let metal = w.material(steel);
    let wire = w.dice.range(0.0009, 0.0014);
    for k in 0..loops {
        let (s, c) = (PI * k as f32 / loops as f32).sin_cos();
        let inset = 1.0 - 0.04 * k as f32;
        let half = [
            (0.0, 0.22),
            (0.2, 0.36),
            (peak * 0.7, 0.84),
            (peak, 1.0),
            (peak + (1.0 - peak) * 0.55, 0.83),
            (0.97, 0.35),
        ];
        let mut plane: Vec<Vec2> = half.iter().map(|&(x, r)| Vec2::new(cage * x * inset, belly * r)).collect();
        plane.push(Vec2::new(cage * inset, 0.0));
        plane.extend(half.iter().rev().map(|&(x, r)| Vec2::new(cage * x * inset, -belly * r)));
        let path: Vec<Vec3> = spline(&plane, 3).iter().map(|p| Vec3::new(p.x, p.y * c, p.y * s * squash)).collect();
        let up = Vec3::new(0.0, -s * squash, c);
        let bow = tube(&path, up.normalize(), 6, [Tip::Flat, Tip::Flat], |_| (wire, wire));
        w.add(bow.uv_box(Vec2::splat(0.06)), metal, 70.0);
    }
    let r = w.dice.range(0.0088, 0.0125);
    let cone = [
        Vec2::new(0.0, -0.012),
        Vec2::new(r * 0.9, -0.012),
        Vec2::new(belly * 0.30, 0.006),
        Vec2::new(belly * 0.28, 0.012),
        Vec2::new(0.0, 0.012),
    ];
    w.add(about_x(&cone, 20).uv_box(Vec2::splat(0.06)), metal, 40.0);
    let stuff = if w.dice.chance(0.4) { metal } else { grip_stuff(w, 0.45, 0.25) };
    let handle: Vec<Vec2> = std::iter::once(Vec2::new(0.0, -0.008 - grip))
        .chain((0..=18).map(|i| {
            let t = i as f32 / 18.0;
            let s = along(&[(0.0, 0.55), (0.06, 0.95), (0.2, 1.05), (0.6, 1.15), (1.0, 0.9)], t);
            Vec2::new(r * s, -0.008 - grip * (1.0 - t))
        }))
        .chain(std::iter::once(Vec2::new(0.0, -0.008)))
        .collect();
    w.add(about_x(&handle, 20).uv_box(Vec2::new(0.06, 0.14)), stuff, 50.0);
    let eye = torus(0.008, 0.0014, 0.0014, 2.0, 16).moved(Vec3::X * (-grip - 0.014));
    w.add(eye, metal, 60.0);
    w.settle();
}

/// A kitchen turner: a broad flat head, often slotted, on a long raised handle.
pub fn spatula(w: &mut Workshop) {
    let shape = w.shape();
    let (long, wide) = match shape {
        "fish" => (w.dice.range(0.115, 0.13), w.dice.range(0.066, 0.074)),
        "square" => (w.dice.range(0.080, 0.092), w.dice.range(0.080, 0.092)),
        _ => (w.dice.range(0.088, 0.108), w.dice.range(0.070, 0.088)),
    };
    let slots = match shape {
        "solid" => 0,
        "fish" => 5,
        "square" => 3,
        _ => w.dice.pick(&[3, 4]),
    };
    let taper = w.dice.range(0.08, 0.22);
    let thick = w.dice.range(0.0018, 0.0030);
    let metal_head = w.dice.chance(0.45);
    let head = if metal_head { w.material(steel) } else { grip_stuff(w, 0.25, 0.4) };
    let place = |s: Surface| {
        s.map(|p| Vec3::new(p.x, p.y * (1.0 + taper * (p.x / long - 0.5)), p.z + 0.004 * (1.0 - p.x / long).powi(2)))
    };
    // Strips around the slots, or one plate.
    let mut strips = vec![];
    if slots == 0 {
        strips.push((0.0, long, -wide / 2.0, wide / 2.0));
    } else {
        let (front, back) = (long * 0.16, long * 0.24);
        strips.push((long - front, long, -wide / 2.0, wide / 2.0));
        strips.push((0.0, back, -wide / 2.0, wide / 2.0));
        let gap = wide * 0.40 / slots as f32;
        let rib = (wide - gap * slots as f32) / (slots + 1) as f32;
        for k in 0..=slots {
            let y = -wide / 2.0 + k as f32 * (rib + gap);
            strips.push((back - 0.006, long - front + 0.006, y, y + rib));
        }
    }
    for (x0, x1, y0, y1) in strips {
        let corner = if y1 - y0 > wide * 0.9 { 0.010 } else { 0.0008 };
        let plate = rounded_box(Vec3::new(x1 - x0, y1 - y0, thick), corner, 0.0006).moved(Vec3::new(
            (x0 + x1) / 2.0,
            (y0 + y1) / 2.0,
            0.0,
        ));
        w.add(place(plate).uv_box(Vec2::new(0.06, 0.10)), head, 40.0);
    }
    let length = w.dice.range(0.20, 0.245);
    let rise = w.dice.range(0.030, 0.050);
    let path = spline(
        &[
            Vec3::new(0.020, 0.0, 0.004),
            Vec3::new(-0.004, 0.0, 0.006),
            Vec3::new(-0.030, 0.0, rise * 0.55),
            Vec3::new(-0.075, 0.0, rise * 0.92),
            Vec3::new(-length, 0.0, rise * 1.25),
        ],
        6,
    );
    let neck = w.dice.range(0.0050, 0.0075);
    let stem = tube(&path, Vec3::Y, 12, [Tip::Flat, Tip::Round], |t| {
        (thick * 0.5 + 0.0012, neck * along(&[(0.0, 1.5), (0.3, 0.9), (1.0, 0.9)], t))
    });
    w.add(stem.uv_box(Vec2::splat(0.06)), head, 45.0);
    let (from, to) = (path[18], path[24]);
    let stuff = if metal_head {
        grip_stuff(w, 0.4, 0.4)
    } else if w.dice.chance(0.5) {
        head
    } else {
        vivid_rubber(w)
    };
    let line: Vec<Vec3> = (0..=14).map(|i| from.lerp(to, i as f32 / 14.0)).collect();
    let grip = tube(&line, Vec3::Y, 14, [Tip::Round, Tip::Round], |t| {
        let s = along(&[(0.0, 0.7), (0.2, 0.95), (0.6, 1.0), (1.0, 1.1)], t);
        (0.0062 * s, neck * 1.6 * s)
    });
    w.add(grip.uv_box(Vec2::new(0.05, 0.14)), stuff, 45.0);
    w.settle();
}

/// Sprung kitchen tongs lying on their side, tips towards +x.
pub fn tongs(w: &mut Workshop) {
    let shape = w.shape();
    let length = w.dice.range(0.225, 0.29);
    let gap = w.dice.range(0.030, 0.052);
    let back = w.dice.range(0.008, 0.014);
    let thick = w.dice.range(0.0009, 0.0014);
    let wide = w.dice.range(0.0075, 0.0105);
    let arm = [
        Vec2::new(length, gap * 0.34),
        Vec2::new(length * 0.86, gap * 0.50),
        Vec2::new(length * 0.45, gap * 0.44),
        Vec2::new(length * 0.12, back * 1.15),
        Vec2::new(0.012, back * 0.95),
    ];
    let mut line = arm.to_vec();
    line.push(Vec2::ZERO);
    line.extend(arm.iter().rev().map(|p| Vec2::new(p.x, -p.y)));
    let path: Vec<Vec3> = spline(&line, 5).iter().map(|p| p.extend(0.0)).collect();
    let spring = sweep(&path, Vec3::Z, Ends::Capped, |_, t| {
        let s = along(&[(0.0, 0.75), (0.25, 1.0), (0.5, 0.9), (0.75, 1.0), (1.0, 0.75)], t);
        superellipse(thick, wide * s, 4.0, 10)
    });
    let metal = add_steel(w, spring, 50.0);
    let tip = if matches!(shape, "silicone" | "pasta") || w.dice.chance(0.3) { vivid_rubber(w) } else { metal };
    let (long, tall) = (w.dice.range(0.020, 0.028), wide * w.dice.range(1.3, 1.7));
    for side in [-1.0f32, 1.0] {
        // A shallow scallop with a toothed rim, hollow side inwards.
        let teeth = if shape == "scalloped" || shape == "grill" { 0.10 } else { 0.0 };
        let cup = revolve(
            &[
                Vec2::new(0.0, -0.0045),
                Vec2::new(0.6, -0.0036),
                Vec2::new(0.9, -0.0012),
                Vec2::new(1.0, 0.001),
                Vec2::new(0.92, 0.001),
                Vec2::new(0.55, -0.0016),
                Vec2::new(0.0, -0.0024),
            ],
            28,
        )
        .map(|p| {
            let k = 1.0 + teeth * (10.0 * p.y.atan2(p.x)).cos() * p.truncate().length();
            Vec3::new(p.x * long * k, side * (gap * 0.33 - p.z * 1.4), p.y * tall * k)
        });
        w.add(cup.moved(Vec3::X * (length + long * 0.55)).uv_box(Vec2::splat(0.06)), tip, 45.0);
    }
    if shape == "grill" || shape == "locking" || w.dice.chance(0.5) {
        let stuff = if w.dice.chance(0.5) { w.material(rubber) } else { vivid_rubber(w) };
        for side in [-1.0f32, 1.0] {
            let middle = if side > 0.0 { 12 } else { path.len() - 13 };
            let near: Vec<Vec3> = path[middle - 4..=middle + 4].to_vec();
            let sleeve = sweep(&near, Vec3::Z, Ends::Capped, |_, t| {
                let s = 1.0 - (2.0 * t - 1.0).abs().powi(6) * 0.3;
                superellipse(thick * 3.0 * s, wide * 1.18 * s, 3.0, 12)
            });
            w.add(sleeve.uv_box(Vec2::splat(0.04)), stuff, 45.0);
        }
    }
    let ring = torus(0.0075, 0.0013, 0.0013, 2.0, 18).moved(Vec3::X * -0.007);
    w.add(ring, metal, 60.0);
    w.settle();
}

/// A rolling pin lying along x.
pub fn rolling_pin(w: &mut Workshop) {
    let shape = w.shape();
    let barrel = w.dice.range(0.23, 0.27);
    let r = w.dice.range(0.023, 0.031) * if shape == "french" { 0.85 } else { 1.0 };
    let body = if shape == "marble" {
        let tone = w.dice.tint(Vec3::splat(0.86), 0.06);
        w.material(|d| plastic(d, tone))
    } else {
        w.material(wood)
    };
    let half = barrel / 2.0;
    let (round, slope) = (w.dice.any(0.003, 0.008), if shape == "french" { 0.42 } else { 0.0 });
    let half = if shape == "french" { half * 1.6 } else { half };
    let mut profile = vec![Vec2::new(0.0, -half)];
    profile.extend((0..=20).map(|i| {
        let t = i as f32 / 10.0 - 1.0;
        let edge = if i == 0 || i == 20 { round } else { 0.0 };
        Vec2::new(r * (1.0 - slope * t.abs().powi(3)) - edge, (half - 0.0001 * edge) * t)
    }));
    profile.push(Vec2::new(0.0, half));
    w.add(about_x(&profile, 32).uv_box(Vec2::new(0.07, 0.16)), body, 40.0);
    if shape != "french" {
        let grip = if w.dice.chance(0.45) { body } else { grip_stuff(w, 0.35, 0.25) };
        let (long, thin) = (w.dice.range(0.075, 0.095), r * w.dice.range(0.42, 0.55));
        let knob = if shape == "knobbed" { 1.35 } else { 1.05 };
        for side in [-1.0f32, 1.0] {
            let mut outline = vec![Vec2::new(0.0, half - 0.002)];
            outline.extend((0..=16).map(|i| {
                let t = i as f32 / 16.0;
                let s = along(
                    &[(0.0, 0.5), (0.12, 0.55), (0.3, 0.95), (0.6, 0.9), (0.88, knob), (0.97, knob * 0.7), (1.0, 0.4)],
                    t,
                );
                Vec2::new(thin * s, half - 0.002 + long * t)
            }));
            outline.push(Vec2::new(0.0, half - 0.002 + long));
            let handle = about_x(&outline, 20).map(|p| Vec3::new(p.x * side, p.y, p.z));
            w.add(handle.uv_box(Vec2::new(0.05, 0.12)), grip, 50.0);
            if shape == "marble" || shape == "bearing" {
                let collar = about_x(&disc(r * 0.62, half - 0.001, half + 0.005, 0.001), 24);
                add_steel(w, collar.map(|p| Vec3::new(p.x * side, p.y, p.z)), 35.0);
            }
        }
    }
    w.settle();
}
