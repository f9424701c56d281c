//! Box cutters, wrenches, pliers, flashlights.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::Workshop;
use super::finish::{bright_steel, material, plastic, rubber, steel};
use super::parts::{about_x, add_steel, bar, dark_plastic, disc, plain, rounded, torus, vivid_plastic, vivid_rubber};
use super::shape::Surface;
use super::sweep::{Tip, along, extrude, revolve, rounded_box, spline, superellipse, sweep, tube};
use super::texture::Canvas;

/// A utility knife lying flat: coloured body, slider, segmented blade towards +x.
pub fn box_cutter(w: &mut Workshop) {
    let shape = w.shape();
    let long = w.dice.range(0.128, 0.158);
    let half = w.dice.range(0.0095, 0.0135) * if shape == "heavy" { 1.2 } else { 1.0 };
    let thick = w.dice.range(0.010, 0.014);
    let (front, back) = (long * 0.45, -long * 0.55);
    let belly = match shape {
        "curved" | "heavy" => 0.35,
        "dolphin" => 0.55,
        _ => 0.0,
    };
    let top: Vec<Vec2> = (0..=14)
        .map(|i| {
            let t = i as f32 / 14.0;
            Vec2::new(front + (back - front) * t, half * along(&[(0.0, 0.72), (0.2, 1.0), (1.0, 1.0)], t))
        })
        .collect();
    let low = top.iter().rev().map(|p| {
        let t = (p.x - back) / (front - back);
        Vec2::new(p.x, -p.y - half * belly * ((t * 2.0 * PI).cos() * 0.35 - 0.1) * (PI * t).sin())
    });
    let outline: Vec<Vec2> = top.iter().copied().chain(low).collect();
    let body = if w.dice.chance(0.2) { dark_plastic(w) } else { vivid_plastic(w) };
    let shell = extrude(&rounded(&outline, 0.003, 1), -thick / 2.0, thick / 2.0, 0.0022);
    w.add(shell.uv_box(Vec2::splat(0.05)), body, 40.0);
    // A channel in the upper face for the slider.
    let dark = dark_plastic(w);
    let slot = rounded_box(Vec3::new(long * 0.56, half * 0.62, 0.0012), half * 0.2, 0.0003);
    w.add(slot.moved(Vec3::new(long * 0.06, 0.0, thick / 2.0 + 0.0001)), dark, 40.0);
    let slide_at = w.dice.range(0.05, 0.26);
    let knob_color = if w.dice.chance(0.5) { dark } else { vivid_plastic(w) };
    let slider = rounded_box(Vec3::new(0.022, half * 0.95, 0.0050), 0.003, 0.0012);
    w.add(
        slider.moved(Vec3::new(long * slide_at, 0.0, thick / 2.0 + 0.0018)).uv_box(Vec2::splat(0.04)),
        knob_color,
        40.0,
    );
    for k in 0..4 {
        let rib = bar(Vec3::new(0.0016, half * 0.86, 0.0016));
        w.add(
            rib.moved(Vec3::new(long * slide_at - 0.006 + 0.004 * k as f32, 0.0, thick / 2.0 + 0.0045)),
            knob_color,
            40.0,
        );
    }
    let metal = w.material(steel);
    let collar = [
        Vec2::new(front - 0.014, -half * 0.80),
        Vec2::new(front + 0.012, -half * 0.60),
        Vec2::new(front + 0.005, half * 0.64),
        Vec2::new(front - 0.014, half * 0.86),
    ];
    let jaw = extrude(&rounded(&collar, 0.001, 1), -thick * 0.36, thick * 0.36, 0.0006);
    w.add(jaw.uv_box(Vec2::splat(0.06)), metal, 30.0);
    let reach = w.dice.range(0.022, 0.042);
    let edge = half * 0.58;
    let trapezoid = shape == "trapeze" || shape == "heavy";
    let blade = [
        Vec2::new(front - 0.010, -edge),
        Vec2::new(front + reach + if trapezoid { 0.002 } else { edge * 1.0 }, -edge),
        Vec2::new(front + reach - if trapezoid { edge * 1.4 } else { edge * 0.6 }, edge),
        Vec2::new(front - 0.010, edge),
    ];
    let bright = w.material(bright_steel);
    w.add(extrude(&blade, -0.0005, 0.0005, 0.0), bright, 30.0);
    if !trapezoid {
        // Snap-off lines.
        let line = plain(w, "steel", Vec3::splat(0.35), 0.5);
        for k in 0..4 {
            let x = front + reach * (0.15 + 0.27 * k as f32);
            let score = bar(Vec3::new(0.0006, edge * 2.0, 0.0012)).map(|p| Vec3::new(p.x + x - p.y * 0.55, p.y, p.z));
            w.add(score, line, 30.0);
        }
    }
    if w.dice.chance(0.7) {
        let cap = rounded_box(Vec3::new(0.012, half * 1.7, thick * 0.86), 0.004, 0.002);
        w.add(cap.moved(Vec3::X * (back - 0.003)).uv_box(Vec2::splat(0.05)), knob_color, 40.0);
    }
    w.settle();
}

/// The head of an open-ended spanner at the origin: a disc with a slot that opens towards +x.
fn open_jaw(radius: f32, gap: f32, thick: f32) -> Surface {
    let start = (gap / radius).asin();
    let mut outline: Vec<Vec2> = (0..=32)
        .map(|k| {
            let angle = start + (TAU - 2.0 * start) * k as f32 / 32.0;
            let (s, c) = angle.sin_cos();
            Vec2::new(radius * c * if c > 0.0 { 1.12 } else { 0.95 }, radius * s)
        })
        .collect();
    let floor = -radius * 0.22;
    outline.push(Vec2::new(floor * 0.2, -gap));
    outline.push(Vec2::new(floor - gap * 0.35, 0.0));
    outline.push(Vec2::new(floor * 0.2, gap));
    extrude(&outline, -thick / 2.0, thick / 2.0, thick * 0.14)
}

/// A spanner lying flat: an open jaw at one end, a ring or another jaw at the other.
pub fn wrench(w: &mut Workshop) {
    let shape = w.shape();
    let length = w.dice.range(0.175, 0.235) * if shape == "stubby" { 0.75 } else { 1.0 };
    let head = w.dice.range(0.0165, 0.0225);
    let gap = head * w.dice.range(0.50, 0.60);
    let thick = w.dice.range(0.0068, 0.0095);
    let dark = w.dice.tint(Vec3::splat(0.30), 0.2);
    let metal = if w.dice.chance(0.2) { plain(w, "steel", dark, 0.5) } else { w.material(steel) };
    let skin = |s: Surface| s.uv_box(Vec2::splat(0.06));
    let (x0, x1) = (-length / 2.0 + head, length / 2.0 - head);
    let lean = if shape == "straight" { 0.0 } else { w.dice.range(0.18, 0.30) };
    let turn = move |by: f32| move |p: Vec3| Vec2::from_angle(by).rotate(p.truncate()).extend(p.z);
    w.add(skin(open_jaw(head, gap, thick).map(turn(lean)).moved(Vec3::X * x1)), metal, 30.0);
    if matches!(shape, "double" | "straight") {
        let small = 0.86;
        let other = open_jaw(head * small, gap * small, thick * 0.92).map(turn(PI + lean)).moved(Vec3::X * x0);
        w.add(skin(other), metal, 30.0);
    } else {
        let (bore, wall) = (head * 0.62, head * 0.30);
        let ring = torus(bore + wall / 2.0, wall / 2.0 + 0.0006, thick * 0.58, 6.0, 36).map(|p| {
            // Twelve points inside, as in a real ring spanner.
            let r = p.truncate().length();
            let tooth = if r < bore + wall * 0.2 { 1.0 + 0.06 * (12.0 * p.y.atan2(p.x)).cos() } else { 1.0 };
            Vec3::new(p.x * tooth, p.y * tooth, p.z)
        });
        w.add(skin(ring.moved(Vec3::X * (x0 + head * 0.05))), metal, 35.0);
    }
    let wide = head * w.dice.range(0.40, 0.50);
    let end = if matches!(shape, "double" | "straight") { x0 + head * 0.55 } else { x0 + head * 0.78 };
    let path: Vec<Vec3> = (0..=12).map(|i| Vec3::X * (end + (x1 - head * 0.55 - end) * i as f32 / 12.0)).collect();
    let shank = sweep(&path, Vec3::Z, super::shape::Ends::Capped, |_, t| {
        let s = along(&[(0.0, 1.15), (0.15, 0.85), (0.5, 0.80), (0.85, 0.95), (1.0, 1.35)], t);
        superellipse(wide * s, thick * 0.42, 5.0, 16)
    });
    w.add(skin(shank), metal, 40.0);
    if shape == "grip" || shape == "stubby" {
        let soft = vivid_rubber(w);
        let line: Vec<Vec3> = path[2..=10].to_vec();
        let sleeve = sweep(&line, Vec3::Z, super::shape::Ends::Capped, |_, t| {
            let s = 1.0 - 0.25 * (2.0 * t - 1.0).abs().powi(8);
            superellipse(wide * 1.02 * s, thick * 0.62 * s, 4.0, 16)
        });
        w.add(sleeve.uv_box(Vec2::splat(0.04)), soft, 40.0);
    } else {
        // The size stamped into a recess.
        let panel = rounded_box(Vec3::new((x1 - end) * 0.5, wide * 0.9, thick * 0.88), 0.002, 0.0006);
        let stamp = plain(w, "steel", dark * 1.8, 0.5);
        w.add(panel.moved(Vec3::X * (x1 + end) / 2.0), stamp, 40.0);
    }
    w.settle();
}

/// Pliers lying on one side, jaws towards +x, handles a little open.
pub fn pliers(w: &mut Workshop) {
    let shape = w.shape();
    let jaw = match shape {
        "needle" | "long_nose" => w.dice.range(0.060, 0.075),
        "bent" => w.dice.range(0.055, 0.062),
        _ => w.dice.range(0.034, 0.046),
    };
    let grip = w.dice.range(0.105, 0.135);
    let thick = w.dice.range(0.0048, 0.0062);
    let joint = w.dice.range(0.0115, 0.0150);
    let fine = if matches!(shape, "needle" | "long_nose" | "bent") { 0.32 } else { 0.62 };
    let open = w.dice.range(0.06, 0.15);
    let hook = if shape == "bent" { 0.30 } else { 0.0 };
    let metal = w.material(steel);
    let dark_head = w.dice.chance(0.35);
    let head = if dark_head { plain(w, "steel", Vec3::splat(0.22), 0.45) } else { metal };
    let soft = match w.dice.pick(&[0, 1, 1]) {
        0 => w.material(rubber),
        _ => vivid_rubber(w),
    };
    let spread = w.dice.range(0.022, 0.030);
    for side in [-1.0f32, 1.0] {
        let swing = move |p: Vec3| Vec2::from_angle(side * open).rotate(p.truncate()).extend(p.z);
        // Jaw: the inner side is straight, the outer one tapers.
        let top = joint * 0.86;
        let outline = [
            Vec2::new(-joint * 0.2, 0.0005),
            Vec2::new(jaw, 0.0005 + hook * jaw * 0.0),
            Vec2::new(jaw, top * fine * 0.75),
            Vec2::new(jaw * 0.45, top * (0.5 + 0.5 * fine)),
            Vec2::new(joint * 0.2, top),
        ];
        let half = extrude(&rounded(&outline, 0.002, 2), -thick, thick, 0.0010).map(|p| {
            let bend = hook * p.x.max(0.0).powi(2) / jaw;
            Vec3::new(p.x, side * p.y + bend, p.z * (1.0 - 0.35 * (p.x / jaw).clamp(0.0, 1.0)))
        });
        w.add(half.map(swing).uv_box(Vec2::splat(0.06)), head, 35.0);
        let path = spline(
            &[
                Vec3::new(joint * 0.4, side * joint * 0.4, 0.0),
                Vec3::new(-joint * 0.9, -side * joint * 0.55, 0.0),
                Vec3::new(-joint * 0.9 - grip * 0.30, -side * spread * 0.95, 0.0),
                Vec3::new(-joint * 0.9 - grip * 0.65, -side * spread, 0.0),
                Vec3::new(-joint * 0.9 - grip, -side * spread * 0.82, 0.0),
            ],
            6,
        );
        let arm = sweep(&path, Vec3::Z, super::shape::Ends::Capped, |_, t| {
            superellipse(joint * along(&[(0.0, 0.42), (0.3, 0.40), (1.0, 0.28)], t), thick * 0.85, 4.0, 12)
        });
        w.add(arm.map(swing).uv_box(Vec2::splat(0.06)), head, 40.0);
        let heavy = if matches!(shape, "heavy" | "snub") { 1.2 } else { 1.0 };
        let sleeve = tube(&path[8..], Vec3::Z, 14, [Tip::Flat, Tip::Round], |t| {
            let s = along(&[(0.0, 1.1), (0.08, 0.92), (0.5, 1.05), (1.0, 0.85)], t) * heavy;
            (0.0062 * s, thick * 1.35 * s)
        });
        w.add(sleeve.map(swing).uv_box(Vec2::splat(0.04)), soft, 45.0);
    }
    let hub = revolve(&disc(joint, -thick * 1.12, thick * 1.12, 0.0012), 28);
    w.add(hub.uv_box(Vec2::splat(0.06)), head, 35.0);
    let bright = w.material(bright_steel);
    w.add(revolve(&disc(joint * 0.42, -thick * 1.3, thick * 1.3, 0.0010), 20), bright, 35.0);
    w.settle();
}

/// A torch lying along x, lens towards +x.
pub fn flashlight(w: &mut Workshop) {
    let shape = w.shape();
    let length = w.dice.range(0.118, 0.165) * if shape == "long" { 1.25 } else { 1.0 };
    let r = w.dice.range(0.0115, 0.0155);
    let wide = match shape {
        "straight" => 1.12,
        "lantern" => 2.1,
        _ => w.dice.range(1.35, 1.75),
    };
    let head = length * w.dice.range(0.24, 0.32);
    let from = length - head;
    let skin = match w.dice.pick(&[0, 1, 2, 2]) {
        0 => {
            let tone = w.dice.tint(Vec3::splat(0.14), 0.25);
            w.material(|d| plastic(d, tone))
        }
        1 => w.material(steel),
        _ => vivid_plastic(w),
    };
    let mut body = vec![Vec2::ZERO, Vec2::new(r * 0.9, 0.0), Vec2::new(r * 1.03, 0.002), Vec2::new(r * 1.03, 0.012)];
    body.extend((0..=30).map(|i| {
        let t = i as f32 / 30.0;
        // Rings for grip along the middle of the body.
        let on = along(&[(0.0, 0.0), (0.12, 0.0), (0.16, 1.0), (0.66, 1.0), (0.70, 0.0), (1.0, 0.0)], t);
        Vec2::new(r * (0.94 + 0.035 * on * if i % 2 == 0 { 1.0 } else { -0.6 }), 0.014 + (from - 0.016) * t)
    }));
    body.push(Vec2::new(0.0, from - 0.002));
    w.add(about_x(&body, 24).uv_box(Vec2::splat(0.05)), skin, 40.0);
    let big = r * wide;
    let bell = [
        Vec2::new(0.0, from - 0.004),
        Vec2::new(r * 1.02, from - 0.004),
        Vec2::new(r * 1.04, from + head * 0.12),
        Vec2::new(big * 0.93, from + head * 0.52),
        Vec2::new(big, from + head * 0.62),
        Vec2::new(big, length - 0.001),
        Vec2::new(big * 0.96, length),
        // The reflector behind the lens.
        Vec2::new(big * 0.84, length),
        Vec2::new(big * 0.80, length - 0.002),
        Vec2::new(0.0, length - 0.002),
    ];
    let crown = if shape == "tactical" { 6.0 } else { 0.0 };
    let bell = about_x(&bell, 36).map(|p| {
        let notch =
            if crown > 0.0 && p.x > length - 0.0015 && (crown * p.z.atan2(p.y)).cos() > 0.4 { 0.0022 } else { 0.0 };
        Vec3::new(p.x - notch, p.y, p.z)
    });
    let front = if w.dice.chance(0.6) { skin } else { dark_plastic(w) };
    w.add(bell.uv_box(Vec2::splat(0.05)), front, 30.0);
    let warm = w.dice.tint(Vec3::new(1.0, 0.95, 0.72), 0.06);
    let beam = Canvas::new(32, 32, warm).each(|uv, c| {
        let d = (uv - 0.5).length() * 2.0;
        if d < 0.30 {
            Vec3::ONE
        } else {
            c * (1.0 - 0.35 * ((d - 0.3) * 14.0).sin().abs() * f32::from(u8::from(d > 0.5)))
        }
    });
    let lens = w.material(|_| material("glass", &beam, 0.0, 0.1));
    let reach = big * 0.83;
    let disc = about_x(
        &[
            Vec2::new(0.0, length - 0.004),
            Vec2::new(reach, length - 0.004),
            Vec2::new(reach, length - 0.0008),
            Vec2::new(reach * 0.6, length - 0.0002),
            Vec2::new(0.0, length),
        ],
        32,
    );
    w.add(disc.map_uv(|p, _| Vec2::new(p.y / reach / 2.0 + 0.5, p.z / reach / 2.0 + 0.5)), lens, 50.0);
    let button = rounded_box(Vec3::new(0.013, 0.0085, 0.005), 0.003, 0.0015);
    let press = vivid_rubber(w);
    w.add(button.moved(Vec3::new(from - 0.014, 0.0, r * 1.02)).uv_box(Vec2::splat(0.04)), press, 40.0);
    if w.dice.chance(0.5) {
        add_steel(w, about_x(&super::parts::disc(big * 1.03, length - 0.010, length - 0.005, 0.0008), 36), 35.0);
    }
    w.settle();
}
