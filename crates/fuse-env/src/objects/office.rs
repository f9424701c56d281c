//! Staplers, binder clips, tape dispensers, tape measures.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::Workshop;
use super::finish::{bright_steel, material, plastic, steel};
use super::parts::{about_y, add_steel, dark_plastic, disc, on_edge, plain, rounded, vivid_plastic};
use super::sweep::{Tip, extrude, rounded_box, spline, tube};
use super::texture::{Canvas, Noise};

/// A desk stapler seen from the side: base, magazine, arm; mouth towards +x.
pub fn stapler(w: &mut Workshop) {
    let shape = w.shape();
    let long = w.dice.range(0.122, 0.150) * if shape == "mini" { 0.72 } else { 1.0 };
    let wide = w.dice.range(0.030, 0.038);
    let open = w.dice.range(0.10, 0.20);
    let tall = w.dice.range(0.020, 0.027) * if matches!(shape, "upright" | "heavy") { 1.3 } else { 1.0 };
    let shell = if w.dice.chance(0.3) { dark_plastic(w) } else { vivid_plastic(w) };
    let base = if w.dice.chance(0.5) { dark_plastic(w) } else { shell };
    let hinge = Vec2::new(-long * 0.5 + 0.014, 0.018);
    let foot = [
        Vec2::new(-long * 0.5, 0.0),
        Vec2::new(long * 0.5, 0.0),
        Vec2::new(long * 0.5, 0.006),
        Vec2::new(-long * 0.22, 0.0085),
        Vec2::new(-long * 0.30, 0.021),
        Vec2::new(-long * 0.5, 0.021),
    ];
    w.add(on_edge(&rounded(&foot, 0.004, 3), wide, 0.0015).uv_box(Vec2::splat(0.05)), base, 35.0);
    let anvil = rounded_box(Vec3::new(0.018, wide * 0.62, 0.002), 0.002, 0.0006);
    add_steel(w, anvil.moved(Vec3::new(long * 0.5 - 0.015, 0.0, 0.0066)), 35.0);
    // Magazine and arm turn about the hinge.
    let turn = |angle: f32| {
        move |p: Vec3| {
            let q = Vec2::from_angle(angle).rotate(Vec2::new(p.x, p.z));
            Vec3::new(q.x + hinge.x, p.y, q.y + hinge.y)
        }
    };
    let reach = long * 0.5 - hinge.x - 0.002;
    let rail = [Vec2::new(-0.006, -0.005), Vec2::new(reach, -0.005), Vec2::new(reach, 0.007), Vec2::new(-0.006, 0.007)];
    let rail = on_edge(&rounded(&rail, 0.0015, 2), wide * 0.55, 0.0006).map(turn(open * 0.75));
    add_steel(w, rail, 35.0);
    let nose = match shape {
        "rounded" | "mini" => 0.75,
        "upright" => 0.55,
        _ => 0.42,
    };
    let arm = [
        Vec2::new(-0.010, 0.004),
        Vec2::new(reach + 0.001, 0.006),
        Vec2::new(reach + 0.003, 0.006 + tall * nose),
        Vec2::new(reach * 0.72, 0.006 + tall * 0.92),
        Vec2::new(reach * 0.22, 0.006 + tall),
        Vec2::new(-0.012, 0.006 + tall * 0.62),
    ];
    let arm = on_edge(&rounded(&arm, 0.016, 5), wide * 0.82, 0.0035).map(turn(open));
    w.add(arm.uv_box(Vec2::splat(0.05)), shell, 40.0);
    let pad = [
        Vec2::new(reach * 0.34, 0.004 + tall),
        Vec2::new(reach * 0.80, 0.002 + tall * 0.90),
        Vec2::new(reach * 0.80, 0.008 + tall * 0.90),
        Vec2::new(reach * 0.34, 0.009 + tall),
    ];
    let rubber = plain(w, "rubber", Vec3::splat(0.10), 0.8);
    let pad = on_edge(&rounded(&pad, 0.002, 3), wide * 0.60, 0.001).map(turn(open));
    w.add(pad.uv_box(Vec2::splat(0.04)), rubber, 40.0);
    let pin = about_y(&disc(0.0042, -wide * 0.5 - 0.001, wide * 0.5 + 0.001, 0.0008), 18);
    add_steel(w, pin.moved(Vec3::new(hinge.x, 0.0, hinge.y - 0.004)), 40.0);
    let lip = rounded_box(Vec3::new(0.0022, wide * 0.58, 0.016), 0.0008, 0.0006);
    add_steel(w, lip.moved(Vec3::new(reach + 0.001, 0.0, 0.0025)).map(turn(open * 0.85)), 35.0);
    w.settle();
}

/// A binder clip: a sprung wedge of sheet steel with two wire handles.
pub fn binder_clip(w: &mut Workshop) {
    let shape = w.shape();
    let wide = w.dice.range(0.030, 0.046) * if shape == "wide" { 1.15 } else { 1.0 };
    let height = wide * w.dice.range(0.52, 0.64);
    let half = height * w.dice.range(0.40, 0.52);
    let sheet = 0.0013;
    // The section of the sheet: mouth, side, base, side, mouth; out and back again.
    let outside = rounded(
        &[Vec2::new(-0.0008, height), Vec2::new(-half, 0.0), Vec2::new(half, 0.0), Vec2::new(0.0008, height)],
        half * 0.35,
        4,
    );
    let middle = Vec2::new(0.0, height * 0.34);
    let mut section: Vec<Vec2> = outside.clone();
    section.extend(outside.iter().rev().map(|p| {
        let inward = (middle - *p).normalize_or_zero();
        let near_mouth = ((p.y / height - 0.8) / 0.2).clamp(0.0, 1.0);
        Vec2::new((p.x + inward.x * sheet) * (1.0 - near_mouth) + p.x * 0.3 * near_mouth, p.y + inward.y * sheet)
    }));
    let section: Vec<Vec2> = section.into_iter().rev().collect();
    let coat = match w.dice.pick(&[0, 0, 0, 1, 2]) {
        0 => {
            let tone = w.dice.tint(Vec3::splat(0.11), 0.25);
            w.material(|d| plastic(d, tone))
        }
        1 => vivid_plastic(w),
        _ => w.material(steel),
    };
    w.add(on_edge(&section, wide, 0.0).uv_box(Vec2::splat(0.05)), coat, 45.0);
    let bright = w.material(bright_steel);
    let (reach, waist) = (w.dice.range(0.85, 1.15) * height * 1.25, w.dice.range(0.10, 0.16));
    let wire = w.dice.range(0.0011, 0.0016);
    let loop_half = wide * w.dice.range(0.24, 0.32);
    for side in [-1.0f32, 1.0] {
        let spread = match shape {
            "folded" => 2.75,
            _ => w.dice.range(0.20, 0.50),
        };
        let direction = Vec3::new(side * f32::sin(spread), 0.0, f32::cos(spread));
        let root = Vec3::new(side * 0.0012, 0.0, height - 0.001);
        let out = |y: f32, t: f32| {
            let clear = if shape == "folded" { Vec3::X * side * (0.003 + t * 0.0015) } else { Vec3::ZERO };
            root + Vec3::Y * y + direction * reach * t + clear
        };
        let plan = [
            (wide * 0.40, 0.0),
            (wide * (0.30 - waist * 0.5), 0.10),
            (wide * (0.26 - waist), 0.40),
            (loop_half * 0.92, 0.72),
            (loop_half * 0.80, 0.93),
            (loop_half * 0.3, 1.0),
        ];
        let mut line: Vec<Vec3> = plan.iter().map(|&(y, t)| out(y, t)).collect();
        line.extend(plan.iter().rev().map(|&(y, t)| out(-y, t)));
        let path = spline(&line, 3);
        let up = direction.cross(Vec3::Y);
        w.add(tube(&path, up, 8, [Tip::Flat, Tip::Flat], |_| (wire, wire)), bright, 70.0);
        // The sheet is rolled around the wire at the mouth.
        let curl = about_y(&disc(wire * 1.9, -wide * 0.30, wide * 0.30, 0.0004), 14);
        let (left, rest) = (curl.clone(), curl);
        let shift = |s: super::shape::Surface, y: f32| {
            s.map(|p| Vec3::new(p.x + side * wire, p.y * 0.5 + y, p.z + height - wire))
        };
        w.add(shift(left, -wide * 0.34), coat, 50.0);
        w.add(shift(rest, wide * 0.34), coat, 50.0);
    }
    w.settle();
}

/// A desk dispenser with a roll of tape and a toothed cutter towards +x.
pub fn tape_dispenser(w: &mut Workshop) {
    let shape = w.shape();
    let long = w.dice.range(0.118, 0.148) * if shape == "compact" { 0.85 } else { 1.0 };
    let wide = w.dice.range(0.040, 0.054);
    let roll = w.dice.range(0.029, 0.036);
    let low = w.dice.range(0.016, 0.024);
    let hub = Vec2::new(-long * 0.18, low + roll * 0.92);
    let cheek = match shape {
        "swan" | "compact" => 0.62,
        "block" => 0.95,
        _ => 0.78,
    };
    // Two cheeks beside the roll on a heavy base.
    let base = [
        Vec2::new(-long * 0.5, 0.0),
        Vec2::new(long * 0.5, 0.0),
        Vec2::new(long * 0.5, low * 0.8),
        Vec2::new(long * 0.36, low),
        Vec2::new(-long * 0.5, low),
    ];
    let body = if w.dice.chance(0.35) { dark_plastic(w) } else { vivid_plastic(w) };
    w.add(on_edge(&rounded(&base, 0.008, 4), wide, 0.002).uv_box(Vec2::splat(0.05)), body, 35.0);
    let side = [
        Vec2::new(-long * 0.5, low * 0.5),
        Vec2::new(long * 0.30, low * 0.5),
        Vec2::new(hub.x + roll * 0.72, hub.y + roll * 0.2),
        Vec2::new(hub.x + roll * 0.35, hub.y + roll * (cheek - 0.45)),
        Vec2::new(hub.x - roll * 0.5, hub.y + roll * (cheek - 0.45)),
        Vec2::new(-long * 0.5, hub.y - roll * 0.2),
    ];
    let cheek_wide = (wide - 0.026) / 2.0;
    for y in [-1.0f32, 1.0] {
        let plate = on_edge(&rounded(&side, 0.014, 5), cheek_wide, 0.0015);
        w.add(plate.moved(Vec3::Y * y * (0.013 + cheek_wide / 2.0)).uv_box(Vec2::splat(0.05)), body, 35.0);
    }
    let neck = [
        Vec2::new(long * 0.22, low * 0.6),
        Vec2::new(long * 0.5 - 0.002, low * 0.6),
        Vec2::new(long * 0.5, low + 0.018),
        Vec2::new(long * 0.5 - 0.010, low + 0.022),
        Vec2::new(long * 0.34, low + 0.006),
    ];
    w.add(on_edge(&rounded(&neck, 0.004, 3), 0.028, 0.001).uv_box(Vec2::splat(0.05)), body, 35.0);
    // The cutter: a strip of teeth.
    let teeth = 9;
    let mut saw = vec![Vec2::new(0.014, 0.0), Vec2::new(-0.014, 0.0)];
    for k in 0..=teeth * 2 {
        let y = -0.014 + 0.028 * k as f32 / (teeth * 2) as f32;
        saw.push(Vec2::new(y, if k % 2 == 0 { -0.004 } else { -0.007 }));
    }
    let cutter = extrude(&saw.iter().rev().map(|p| Vec2::new(p.x, -p.y)).collect::<Vec<_>>(), 0.0, 0.0012, 0.0)
        .map(|p| Vec3::new(long * 0.5 - 0.007 + p.y * 0.9, p.x, low + 0.0205 + p.y * 0.5 + p.z));
    add_steel(w, cutter, 30.0);
    let amber = match w.dice.pick(&[0, 0, 1]) {
        0 => w.dice.tint(Vec3::new(0.88, 0.80, 0.55), 0.08),
        _ => w.dice.color((0.02, 0.10), (0.82, 0.94)),
    };
    let noise = Noise(w.dice.seed());
    let layers = Canvas::new(32, 32, amber).each(|uv, c| c * (0.86 + 0.16 * noise.smooth(uv, (1, 24))));
    let tape = w.material(|_| material("plastic", &layers, 0.0, 0.25));
    let thick = roll * w.dice.range(0.34, 0.46);
    // The roll is a thick-walled tube; its core and the hub fill it.
    let ring = super::parts::torus(roll - thick / 2.0, thick / 2.0, 0.0095, 9.0, 40).map(|p| Vec3::new(p.x, p.z, p.y));
    let at = Vec3::new(hub.x, 0.0, hub.y);
    w.add(ring.moved(at).uv_box(Vec2::splat(0.04)), tape, 40.0);
    let core = about_y(&disc(roll - thick * 0.98, -0.0092, 0.0092, 0.001), 32);
    let pale = w.dice.color((0.0, 0.12), (0.80, 0.95));
    let card = w.material(|d| plastic(d, pale));
    w.add(core.moved(at).uv_box(Vec2::splat(0.05)), card, 40.0);
    let axle = about_y(&disc(roll * 0.30, -0.0128, 0.0128, 0.001), 24);
    let dark = dark_plastic(w);
    w.add(axle.moved(at), dark, 40.0);
    let end = Vec3::new(long * 0.5 - 0.003, 0.0, low + 0.024);
    let from = Vec3::new(hub.x + roll * 0.55, 0.0, hub.y + roll * 0.80);
    let strip: Vec<Vec3> = (0..=4).map(|i| from.lerp(end, i as f32 / 4.0)).collect();
    w.add(tube(&strip, Vec3::Y, 8, [Tip::Flat, Tip::Flat], |_| (0.0004, 0.0090)), tape, 40.0);
    w.settle();
}

/// A steel tape measure in a case, a little of the tape drawn out towards +x.
pub fn tape_measure(w: &mut Workshop) {
    let shape = w.shape();
    let size = w.dice.range(0.060, 0.078);
    let wide = w.dice.range(0.030, 0.038);
    let corner = match shape {
        "round" => 0.46,
        "square" => 0.10,
        _ => w.dice.range(0.22, 0.36),
    };
    let h = size / 2.0;
    // D-shaped: flat below, round above and behind.
    let outline: Vec<Vec2> = (0..48)
        .map(|k| {
            let (s, c) = (TAU * k as f32 / 48.0).sin_cos();
            let power = if s < 0.0 || c > 0.0 { 2.0 / (2.0 + 5.0 * (1.0 - corner * 2.0).max(0.05)) } else { 0.9 };
            Vec2::new(h * c.signum() * c.abs().powf(power), h * 0.92 * (1.0 + s.signum() * s.abs().powf(power)))
        })
        .collect();
    let case = if w.dice.chance(0.4) {
        let tone = w.dice.tint(Vec3::new(0.95, 0.76, 0.08), 0.06);
        w.material(|d| plastic(d, tone))
    } else if w.dice.chance(0.2) {
        w.material(steel)
    } else {
        vivid_plastic(w)
    };
    w.add(on_edge(&outline, wide, 0.004).uv_box(Vec2::splat(0.05)), case, 40.0);
    let dark = dark_plastic(w);
    let band = on_edge(
        &outline.iter().map(|p| Vec2::new(p.x * 1.03, (p.y - h * 0.92) * 1.03 + h * 0.92)).collect::<Vec<_>>(),
        wide * 0.45,
        0.002,
    );
    if shape != "plain" {
        w.add(band.uv_box(Vec2::splat(0.05)), dark, 40.0);
    }
    let badge = w.dice.color((0.0, 0.1), (0.85, 0.97));
    let ink = w.dice.vivid() * 0.7;
    let mut face = Canvas::new(64, 64, badge).each(|uv, c| if (uv - 0.5).length() > 0.40 { ink } else { c });
    face.digit(w.dice.pick(&[3, 5, 8]), 22, 18, 6, ink);
    let label = w.material(|_| material("plastic", &face, 0.0, 0.4));
    let r = h * w.dice.range(0.52, 0.64);
    for y in [-1.0f32, 1.0] {
        let plate = about_y(&disc(r, -0.0012, 0.0012, 0.0006), 32)
            .map_uv(|p, _| Vec2::new(0.5 + y * p.x / (2.0 * r), 0.5 - p.z / (2.0 * r)))
            .moved(Vec3::new(0.0, y * wide / 2.0, h * 0.92));
        w.add(plate, label, 35.0);
    }
    let out = w.dice.range(0.022, 0.050);
    let yellow = w.dice.tint(Vec3::new(0.97, 0.86, 0.18), 0.05);
    let scale = Canvas::new(128, 32, yellow).each(|uv, c| {
        let mm = uv.x * 50.0;
        let long = if (mm / 10.0).fract() < 0.06 {
            0.75
        } else if (mm / 5.0).fract() < 0.10 {
            0.5
        } else {
            0.3
        };
        let tick = mm.fract() < 0.34 && (mm / 2.0).fract() < 0.5;
        if (tick && uv.y < long) || (mm / 10.0).fract() < 0.05 { Vec3::splat(0.08) } else { c }
    });
    let tape = w.material(|_| material("steel", &scale, 0.0, 0.4));
    let z = 0.007;
    let blade = rounded_box(Vec3::new(out + 0.010, wide * 0.60, 0.0008), 0.0008, 0.0002)
        .map(|p| Vec3::new(p.x + h + (out - 0.010) / 2.0, p.y, p.z + z - 0.0030 * (1.0 - (p.y / (wide * 0.3)).powi(2))))
        .map_uv(|p, _| Vec2::new((p.x - h) / 0.05, p.y / (wide * 0.6) + 0.5));
    w.add(blade, tape, 40.0);
    let hook = rounded_box(Vec3::new(0.0012, wide * 0.56, 0.010), 0.0005, 0.0004);
    add_steel(w, hook.moved(Vec3::new(h + out, 0.0, z - 0.004)), 35.0);
    let mouth = rounded_box(Vec3::new(0.006, wide * 0.72, 0.010), 0.001, 0.001);
    w.add(mouth.moved(Vec3::new(h - 0.001, 0.0, z)), dark, 40.0);
    let lock = rounded_box(Vec3::new(0.012, wide * 0.4, 0.008), 0.002, 0.002);
    let angle = PI * 0.22;
    w.add(lock.moved(Vec3::new(h * 0.98 * angle.cos(), 0.0, h * (0.92 + 0.9 * angle.sin()))), dark, 40.0);
    w.settle();
}
