//! Pens, pencils, erasers.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::Workshop;
use super::finish::{bright_steel, material, plastic, rubber_of, steel, wood};
use super::parts::{about_x, add_steel, dark_plastic, disc, plain, vivid_plastic, vivid_rubber};
use super::shape::{Ends, Surface};
use super::sweep::{Tip, along, revolve, rounded_box, spline, tube};
use super::texture::{Canvas, Noise};

/// A ballpoint or fountain pen lying along x, tip towards +x.
pub fn pen(w: &mut Workshop) {
    let shape = w.shape();
    let length = w.dice.range(0.128, 0.146);
    let r = w.dice.range(0.0042, 0.0056);
    let metal = w.material(steel);
    let sleek = shape == "metal" || shape == "fountain";
    let barrel = if sleek && w.dice.chance(0.4) {
        metal
    } else if w.dice.chance(0.3) {
        dark_plastic(w)
    } else {
        vivid_plastic(w)
    };
    let nose = w.dice.range(0.018, 0.026);
    let front = length - nose;
    let sides = if shape == "hexagonal" { 6 } else { 20 };
    let crease = if sides == 6 { 20.0 } else { 45.0 };
    let belly = if shape == "grip" { 1.18 } else { 1.0 };
    let mut body = vec![Vec2::ZERO];
    body.extend((0..=24).map(|i| {
        let t = i as f32 / 24.0;
        Vec2::new(r * along(&[(0.0, 0.86), (0.03, 0.97), (0.5, 1.0), (0.85, belly), (1.0, 0.88)], t), front * t)
    }));
    body.push(Vec2::new(0.0, front));
    w.add(about_x(&body, sides).uv_box(Vec2::splat(0.05)), barrel, crease);
    let cone = [
        Vec2::new(0.0, front - 0.001),
        Vec2::new(r * 0.84, front - 0.001),
        Vec2::new(r * 0.66, front + nose * 0.45),
        Vec2::new(r * 0.34, front + nose * 0.80),
        Vec2::new(r * 0.20, front + nose * 0.82),
        Vec2::new(r * 0.13, front + nose),
        Vec2::new(0.0, front + nose),
    ];
    if shape == "fountain" {
        // A nib: a pointed leaf, split along its middle.
        let rings: Vec<Vec<Vec3>> = (0..=14)
            .map(|i| {
                let t = i as f32 / 14.0;
                let wide = r * along(&[(0.0, 0.75), (0.3, 0.95), (0.6, 0.7), (1.0, 0.06)], t);
                let x = front + nose * (t - 0.1);
                (0..10)
                    .map(|k| {
                        let (s, c) = (TAU * k as f32 / 10.0).sin_cos();
                        Vec3::new(x, wide * c, 0.0007 * s + 0.0012 * (1.0 - (c * wide / r).powi(2)))
                    })
                    .collect()
            })
            .collect();
        w.add(Surface::loft(&rings, Ends::Capped).uv_box(Vec2::splat(0.06)), metal, 50.0);
        let feed = about_x(
            &[
                Vec2::new(0.0, front - 0.001),
                Vec2::new(r * 0.6, front - 0.001),
                Vec2::new(r * 0.2, front + nose * 0.55),
                Vec2::new(0.0, front + nose * 0.55),
            ],
            14,
        );
        let dark = dark_plastic(w);
        w.add(feed, dark, 40.0);
    } else {
        let tip = if sleek || w.dice.chance(0.6) { metal } else { dark_plastic(w) };
        w.add(about_x(&cone, 20).uv_box(Vec2::splat(0.06)), tip, 40.0);
    }
    for at in [0.0, w.dice.range(0.46, 0.60)] {
        let ring = about_x(&disc(r * 1.06, front * at, front * at + 0.0030, 0.0004), 24);
        w.add(ring.uv_box(Vec2::splat(0.06)), metal, 30.0);
    }
    if shape == "grip" || shape == "click" {
        let mut sleeve = vec![Vec2::new(0.0, front * 0.70)];
        sleeve.extend((0..=16).map(|i| {
            let t = i as f32 / 16.0;
            Vec2::new(r * belly * (1.05 + 0.03 * (t * 8.0 * TAU).cos()), front * (0.70 + 0.27 * t))
        }));
        sleeve.push(Vec2::new(0.0, front * 0.97));
        let soft = if w.dice.chance(0.5) { vivid_rubber(w) } else { plain(w, "rubber", Vec3::splat(0.14), 0.8) };
        w.add(about_x(&sleeve, 20).uv_box(Vec2::splat(0.04)), soft, 50.0);
    }
    let long = w.dice.range(0.032, 0.042);
    let high = r + 0.0016;
    let clip = tube(
        &spline(
            &[
                Vec3::new(0.002, 0.0, r * 0.7),
                Vec3::new(0.003, 0.0, high + 0.0006),
                Vec3::new(long * 0.6, 0.0, high),
                Vec3::new(long, 0.0, r + 0.0006),
            ],
            4,
        ),
        Vec3::Y,
        8,
        [Tip::Flat, Tip::Round],
        |_| (0.0006, 0.0017),
    );
    w.add(clip.uv_box(Vec2::splat(0.06)), metal, 50.0);
    if shape == "click" || shape == "metal" || shape == "grip" {
        let button = about_x(&disc(r * 0.46, -0.010, 0.002, 0.0008), 16);
        let stuff = if w.dice.chance(0.5) { metal } else { barrel };
        w.add(button.uv_box(Vec2::splat(0.06)), stuff, 40.0);
    } else {
        let plug = about_x(&disc(r * 0.86, -0.004, 0.001, 0.0012), 20);
        w.add(plug.uv_box(Vec2::splat(0.05)), barrel, 40.0);
    }
    w.settle();
}

/// A sharpened pencil with a ferrule and a rubber at its end, lying along x.
pub fn pencil(w: &mut Workshop) {
    let shape = w.shape();
    let length = w.dice.range(0.135, 0.185) * if shape == "stub" { 0.78 } else { 1.0 };
    let r = w.dice.range(0.0036, 0.0042) * if matches!(shape, "jumbo" | "carpenter") { 1.2 } else { 1.0 };
    let cone = r * w.dice.range(4.6, 6.2);
    let sides = match shape {
        "round" | "stub" => 24,
        _ => 6,
    };
    let flat = if shape == "carpenter" { 1.25 } else { 1.0 };
    // The section: a polygon with corners a little round.
    let section = |k: f32| -> Vec<Vec2> {
        (0..24)
            .map(|i| {
                let angle = TAU * i as f32 / 24.0;
                let step = TAU / sides as f32;
                let off = (angle.rem_euclid(step) - step / 2.0).abs();
                let polygon = (step / 2.0).cos() / off.cos();
                Vec2::from_angle(angle) * r * k * (1.0 - (1.0 - polygon) * 0.85)
            })
            .map(|p| Vec2::new(p.x * flat, p.y))
            .collect()
    };
    let ring = |x: f32, k: f32| -> Vec<Vec3> { section(k).iter().map(|p| Vec3::new(x, p.x, p.y)).collect() };
    let round = |x: f32, k: f32| -> Vec<Vec3> {
        (0..24)
            .map(|i| Vec2::from_angle(TAU * i as f32 / 24.0) * r * k)
            .map(|p| Vec3::new(x, p.x * flat.sqrt(), p.y))
            .collect()
    };
    let classic = w.dice.chance(0.45);
    let coat = if classic {
        let tone = w.dice.tint(Vec3::new(0.95, 0.71, 0.12), 0.08);
        w.material(|d| plastic(d, tone))
    } else {
        vivid_plastic(w)
    };
    let body =
        Surface::loft(&(0..=8).map(|i| ring((length - cone) * i as f32 / 8.0, 1.0)).collect::<Vec<_>>(), Ends::Capped);
    w.add(body.uv_box(Vec2::splat(0.05)), coat, if sides == 24 { 60.0 } else { 25.0 });
    let bare = w.material(wood);
    let from = length - cone;
    let shaved = Surface::loft(
        &[ring(from - 0.0004, 0.985), round(from + cone * 0.12, 0.84), round(from + cone * 0.72, 0.27)],
        Ends::Capped,
    );
    w.add(shaved.uv_box(Vec2::new(0.02, 0.06)), bare, 50.0);
    let lead =
        if shape == "carpenter" || w.dice.chance(0.65) { plain(w, "graphite", Vec3::splat(0.13), 0.45) } else { coat };
    let point = Surface::loft(
        &[round(from + cone * 0.70, 0.29), round(from + cone * 0.95, 0.07), vec![Vec3::X * length]],
        Ends::Capped,
    );
    w.add(point, lead, 60.0);
    let (ferrule, stub) = (w.dice.range(0.011, 0.014), w.dice.range(0.006, 0.010));
    let mut metal = vec![Vec2::new(0.0, -ferrule)];
    metal.extend((0..=16).map(|i| {
        let t = i as f32 / 16.0;
        Vec2::new(r * (0.99 + 0.04 * (t * 5.0 * TAU).cos()), -ferrule + (ferrule + 0.003) * t)
    }));
    metal.push(Vec2::new(0.0, 0.003));
    let bright = w.material(bright_steel);
    w.add(about_x(&metal, 20), bright, 50.0);
    let pink = w.dice.tint(Vec3::new(0.92, 0.47, 0.47), 0.12);
    let soft = w.material(|d| rubber_of(d, pink));
    let tip = [
        Vec2::new(0.0, -ferrule - stub),
        Vec2::new(r * 0.6, -ferrule - stub),
        Vec2::new(r * 0.9, -ferrule - stub + 0.001),
        Vec2::new(r * 0.95, -ferrule - stub + 0.0025),
        Vec2::new(r * 0.95, -ferrule + 0.001),
        Vec2::new(0.0, -ferrule + 0.001),
    ];
    w.add(about_x(&tip, 20).uv_box(Vec2::splat(0.04)), soft, 50.0);
    w.settle();
}

/// A rubber eraser: a white block in a printed sleeve, a pink wedge, or two-coloured.
pub fn eraser(w: &mut Workshop) {
    let shape = w.shape();
    let long = w.dice.range(0.048, 0.064) * if shape == "domino" { 1.2 } else { 1.0 };
    let (wide, thick) = (w.dice.range(0.019, 0.025), w.dice.range(0.0105, 0.0140));
    let size = Vec3::new(long, wide, thick);
    let corner = if shape == "capsule" { wide * 0.48 } else { 0.0024 };
    let slant = if matches!(shape, "wedge" | "two_tone") { w.dice.range(0.35, 0.7) } else { 0.0 };
    let block = rounded_box(size, corner, 0.0022).map(|p| Vec3::new(p.x + p.z * slant, p.y, p.z));
    let pink = matches!(shape, "wedge" | "two_tone" | "domino");
    let tone = if pink { Vec3::new(0.90, 0.48, 0.46) } else { Vec3::new(0.94, 0.93, 0.90) };
    let tone = w.dice.tint(tone, 0.06);
    let soft = w.material(|d| rubber_of(d, tone));
    if shape == "two_tone" {
        let cut = long * w.dice.range(0.10, 0.22);
        let second = w.dice.tint(Vec3::new(0.27, 0.42, 0.66), 0.12);
        let hard = w.material(|d| rubber_of(d, second));
        let (front, rest) = block.split(|c, _| c.x - c.z * slant > cut);
        // Cells of a box's sides are as long as the box: the harder end is a cap of its own.
        let end = rounded_box(Vec3::new(long * 0.5 - cut, wide + 0.0003, thick + 0.0003), corner, 0.0022)
            .map(|p| Vec3::new(p.x + (long * 0.5 + cut) * 0.5 + 0.0002 + p.z * slant, p.y, p.z));
        let mut whole = rest;
        whole.faces.extend(front.faces);
        w.add(whole.uv_box(Vec2::splat(0.04)), soft, 45.0);
        w.add(end.uv_box(Vec2::splat(0.04)), hard, 45.0);
    } else {
        w.add(block.uv_box(Vec2::splat(0.04)), soft, 45.0);
    }
    let ink = w.dice.vivid() * 0.75;
    let pale = w.dice.color((0.0, 0.1), (0.88, 0.97));
    let noise = Noise(w.dice.seed());
    if matches!(shape, "sleeved" | "capsule" | "barrel") {
        let share = w.dice.range(0.55, 0.72);
        let mut canvas = Canvas::new(64, 32, ink).each(|uv, c| match (uv.x * 3.0) as u32 {
            0 => pale,
            1 => c,
            _ => c * 0.45,
        });
        canvas.text(Vec2::new(0.38, 0.30), Vec2::new(0.66, 0.74), 1, pale, noise);
        let paper = w.material(|_| material("paper", &canvas, 0.0, 0.6));
        let reach = long * share;
        let sleeve = rounded_box(Vec3::new(reach, wide + 0.0009, thick + 0.0009), 0.0022, 0.0012)
            .moved(Vec3::X * (-long * 0.5 + reach * 0.5 + long * 0.04))
            .map_uv(|p, _| Vec2::new((p.x + long * 0.46) / reach, p.y / wide + 0.5));
        w.add(sleeve, paper, 40.0);
    } else {
        // A printed mark on the top.
        let mut canvas = Canvas::new(64, 32, tone * 0.96);
        canvas.text(Vec2::new(0.1, 0.2), Vec2::new(0.95, 0.55), 1, ink * 0.6, noise);
        canvas.text(Vec2::new(0.2, 0.62), Vec2::new(0.85, 0.82), 1, ink * 0.6, noise);
        let print = w.material(|_| material("rubber", &canvas, 0.0, 0.8));
        let mark = rounded_box(Vec3::new(long * 0.46, wide * 0.7, 0.0006), 0.001, 0.0002)
            .map(|p| Vec3::new(p.x + slant * thick * 0.5 - long * 0.20, p.y, p.z + thick * 0.5))
            .map_uv(|p, _| Vec2::new((p.x + long * 0.45) / (long * 0.5), 0.5 - p.y / wide));
        w.add(mark, print, 40.0);
        if shape == "domino" {
            let bead = revolve(&disc(0.0016, 0.0, 0.0006, 0.0002), 12);
            add_steel(w, bead.moved(Vec3::new(long * 0.40, 0.0, thick * 0.5 - 0.0002)), 40.0);
        }
    }
    w.settle();
}
