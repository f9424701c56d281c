//! Scissors: two crossed blades, two loops.

use std::f32::consts::TAU;

use glam::{Mat3, Vec2, Vec3};

use super::Workshop;
use super::finish::{bright_steel, plastic, rubber, steel};
use super::sweep::{Tip, extrude, loop_tube, revolve, spline, tube};

/// Measures of one half, metres; the pivot is the origin, blades point to +x.
struct Half {
    blade: f32,
    wide: f32,
    tip: f32,
    thick: f32,
    shank: f32,
    loop_long: f32,
    loop_wide: f32,
    tube: f32,
    offset: f32,
}

/// A pair of scissors lying open on one side.
pub fn scissors(w: &mut Workshop) {
    let shape = w.shape();
    let blade = match shape {
        "narrow" => w.dice.range(0.085, 0.105),
        "tailor" => w.dice.range(0.11, 0.13),
        "round" => w.dice.range(0.065, 0.080),
        _ => w.dice.range(0.075, 0.105),
    };
    let wide = match shape {
        "narrow" => w.dice.range(0.0085, 0.0105),
        "wide" => w.dice.range(0.0145, 0.0165),
        _ => w.dice.range(0.0105, 0.0140),
    };
    let tip = if shape == "round" { 0.75 } else { w.dice.range(0.10, 0.35) };
    let half = Half {
        blade,
        wide,
        tip,
        thick: 0.0018,
        shank: w.dice.range(0.022, 0.038),
        loop_long: w.dice.range(0.024, 0.032),
        loop_wide: w.dice.range(0.0165, 0.0215),
        tube: w.dice.range(0.0036, 0.0054),
        offset: w.dice.range(0.016, 0.021),
    };
    let open = w.dice.range(0.12, 0.42);
    let metal = w.material(steel);
    let bright = w.material(bright_steel);
    let grip = if w.dice.chance(0.15) {
        metal
    } else if w.dice.chance(0.3) {
        w.material(rubber)
    } else {
        let tone = w.dice.vivid();
        w.material(|d| plastic(d, tone))
    };
    let second = match shape {
        "uneven" => w.dice.range(1.25, 1.5),
        "tailor" => w.dice.range(1.45, 1.65),
        _ => 1.0,
    };
    for (side, grow) in [(1.0f32, 1.0f32), (-1.0, second)] {
        make_half(w, &half, side, grow, open, [metal, bright, grip]);
    }
    let r = w.dice.any(0.0032, 0.0046);
    let h = half.thick * 2.0 + 0.0012;
    let screw = revolve(
        &[Vec2::new(0.0, -h), Vec2::new(r, -h), Vec2::new(r, h - 0.0006), Vec2::new(r * 0.8, h), Vec2::new(0.0, h)],
        14,
    );
    w.add(screw, bright, 30.0);
    w.settle();
}

fn make_half(w: &mut Workshop, m: &Half, side: f32, grow: f32, open: f32, [metal, bright, grip]: [usize; 3]) {
    let turn = Mat3::from_rotation_z(side * open / 2.0);
    let z = side * m.thick * 0.55;
    let place = |p: Vec3| {
        let p = turn * Vec3::new(p.x, p.y * side, p.z);
        p + Vec3::Z * z
    };
    // The cutting edge is straight along y = -0.001, the back tapers to the tip.
    let mut outline = vec![Vec2::new(-0.012, -m.wide * 0.35), Vec2::new(0.0, -m.wide * 0.42), Vec2::new(0.014, -0.002)];
    outline.push(Vec2::new(m.blade * 0.985, -0.001));
    let back: Vec<Vec2> = (0..=8)
        .map(|k| {
            let t = 1.0 - k as f32 / 8.0;
            let round = (1.0 - t.powf(if m.tip > 0.5 { 14.0 } else { 2.2 }) * (1.0 - 0.12)).max(0.08);
            Vec2::new(
                m.blade * t,
                m.wide * (m.tip + (1.0 - m.tip) * (1.0 - t)).mul_add(0.5, 0.5 * round * (1.0 - t * (1.0 - m.tip))),
            )
        })
        .map(|p| Vec2::new(p.x, p.y.max(0.0008)))
        .collect();
    outline.extend(back);
    outline.push(Vec2::new(-0.012, m.wide * 0.6));
    let plate = extrude(&outline, -m.thick / 2.0, m.thick / 2.0, 0.0002).map(place);
    let (ground, flat) = plate.split(|c, n| {
        let local = turn.transpose() * c;
        n.z.abs() > 0.7 && local.y * side < 0.0022 && local.x > 0.016
    });
    w.add(flat.map_uv(|p, _| Vec2::new(p.x / 0.06, p.y / 0.06)), metal, 25.0);
    w.add(ground, bright, 25.0);
    // Behind the pivot the half crosses over to the other side: its loop lies at -side.
    let (long, broad) = (m.loop_long * grow, m.loop_wide * (0.5 + 0.5 * grow));
    let centre = Vec3::new(-m.shank - long, -m.offset - (broad - m.loop_wide) * 0.6, 0.0);
    let lean = 0.22f32;
    let ring: Vec<Vec3> = (0..28)
        .map(|k| {
            let (s, c) = (TAU * k as f32 / 28.0).sin_cos();
            // Egg shaped: narrower towards the pivot.
            let p = Vec3::new(long * c, broad * s * (1.0 - 0.22 * c), 0.0);
            centre + Mat3::from_rotation_z(lean) * p
        })
        .collect();
    let fat = m.tube;
    let bow = loop_tube(&ring, Vec3::Z, 10, |_| (fat * 0.85, fat)).map(place);
    w.add(bow.uv_box(Vec2::splat(0.05)), grip, 60.0);
    let join = centre + Mat3::from_rotation_z(lean) * Vec3::new(long, 0.0, 0.0);
    let path = spline(
        &[Vec3::new(-0.004, 0.001, 0.0), Vec3::new(-0.4 * m.shank, -0.004, 0.0), join + Vec3::new(0.001, 0.0, 0.0)],
        5,
    );
    let shank = tube(&path, Vec3::Z, 10, [Tip::Round, Tip::Flat], |t| {
        (m.wide * (0.42 - 0.10 * t), m.thick * 0.5 + (fat * 0.95 - m.thick * 0.5) * t.powf(0.7))
    })
    .map(place);
    w.add(shank.uv_box(Vec2::splat(0.05)), grip, 50.0);
}
