//! Markers, rulers, books.

use glam::{Mat3, Quat, Vec2, Vec3};

use super::Workshop;
use super::dice::Dice;
use super::finish::{material, plastic, wood};
use super::shape::{Ends, Surface};
use super::sweep::{along, extrude, revolve, rounded_box, rounded_rectangle};
use super::table::{Stuff, finishes};
use super::texture::{Canvas, Noise};

/// A solid of revolution about x; u along x (0 at the left end), v around.
fn lathe_x(profile: &[Vec2], n: usize, square: bool) -> Surface {
    let (low, high) = (profile[0].y, profile[profile.len() - 1].y);
    revolve(profile, n)
        .map(|p| {
            if !square {
                return p;
            }
            let round = p.truncate().length();
            let boxy = (p.x.powi(4) + p.y.powi(4)).powf(0.25).max(1e-5);
            Vec3::new(p.x * round / boxy * 0.95, p.y * round / boxy * 0.95, p.z)
        })
        .map_uv(move |p, uv| Vec2::new((p.z - low) / (high - low), uv.x))
        .turned(Mat3::from_quat(Quat::from_rotation_arc(Vec3::Z, Vec3::X)))
}

/// Barrel paint of a marker: ground, a printed label and a ring in the ink's colour.
fn barrel_paint(dice: &mut Dice, ground: Vec3, ink: Vec3) -> Canvas {
    let family = dice.family(&finishes(Stuff::Label));
    let noise = Noise(dice.seed());
    let (from, to) = (dice.any(0.10, 0.2), dice.any(0.62, 0.8));
    let print = if ground.min_element() > 0.6 { Vec3::splat(0.12) } else { Vec3::splat(0.95) };
    let mut canvas = Canvas::new(128, 64, ground).each(|uv, c| match family {
        "block" if (from..to).contains(&uv.x) && (uv.y * 2.0).fract() < 0.55 => ink,
        "wave" if (from..to).contains(&uv.x) && (uv.y * 2.0).fract() < 0.35 + 0.15 * (uv.x * 22.0).sin() => ink,
        "bands" if (uv.x - from).abs() < 0.03 || (uv.x - to).abs() < 0.03 => ink,
        "diagonal" if (from..to).contains(&uv.x) && (uv.x * 9.0 + uv.y * 2.0).fract() < 0.45 => ink,
        "drops" if (from..to).contains(&uv.x) && noise.spots(uv, (14, 6)) < 0.28 => ink,
        "chevron" if uv.x > to && ((uv.y * 3.0).fract() - 0.5).abs() + to < uv.x + 0.1 => ink,
        _ => c,
    });
    let on_block = family == "block";
    let print = if on_block && ink.min_element() < 0.6 { Vec3::splat(0.95) } else { print };
    for side in [0.08, 0.58] {
        canvas.text(Vec2::new(from + 0.06, side), Vec2::new(to - 0.04, side + 0.2), 2, print, noise);
    }
    canvas
}

/// A chunky marker with its cap on, or posted with the tip bare; it lies along x.
pub fn marker(w: &mut Workshop) {
    let shape = w.shape();
    let length = w.dice.range(0.122, 0.148);
    let r = if shape == "jumbo" { w.dice.range(0.0103, 0.0110) } else { w.dice.range(0.0082, 0.0106) };
    let cap = length * w.dice.range(0.30, 0.40);
    let square = shape == "square";
    let n = if square { 32 } else { 24 };
    let ink = if w.dice.chance(0.25) { w.dice.tint(Vec3::splat(0.10), 0.3) } else { w.dice.vivid() };
    let ground = match w.dice.pick(&[0, 0, 1, 2]) {
        0 => w.dice.tint(Vec3::splat(0.90), 0.05),
        1 => w.dice.tint(Vec3::splat(0.16), 0.3),
        _ => ink,
    };
    let bare = shape == "posted";
    let (start, end) = (-length / 2.0, length / 2.0);
    let joint = if bare { end - 0.024 } else { end - cap };
    let taper = if shape == "tapered" { 0.72 } else { 0.97 };
    let k = (joint - start) / 12.0;
    let mut profile =
        vec![Vec2::new(0.0, start), Vec2::new(r * taper * 0.86, start), Vec2::new(r * taper, start + 0.002)];
    profile.extend((1..12).map(|i| {
        Vec2::new(r * along(&[(0.0, taper), (0.6, 0.97), (1.0, 0.97)], i as f32 / 11.0), start + k * i as f32)
    }));
    profile.push(Vec2::new(r * 0.97, joint));
    profile.push(Vec2::new(0.0, joint));
    let canvas = barrel_paint(&mut w.dice, ground, ink);
    let paint = w.material(|_| material("plastic", &canvas, 0.0, 0.35));
    w.add(lathe_x(&profile, n, square), paint, 40.0);
    let colored = w.material(|d| plastic(d, ink));
    let cap_at = if bare { start - cap * 0.45 } else { end - cap };
    let flip = if bare { -1.0 } else { 1.0 };
    let dome = if shape == "bullet" || shape == "jumbo" { 0.55 } else { 0.92 };
    let front = [
        Vec2::new(0.0, 0.0),
        Vec2::new(r, 0.0),
        Vec2::new(r, cap * 0.75),
        Vec2::new(r * (0.5 + 0.5 * dome), cap * 0.93),
        Vec2::new(r * dome * 0.9, cap),
        Vec2::new(0.0, cap),
    ];
    let shell =
        lathe_x(&front, n, square).map(|p| Vec3::new(if bare { cap_at + cap - p.x } else { cap_at + p.x }, p.y, p.z));
    w.add(shell.uv_box(Vec2::splat(0.05)), colored, 40.0);
    if w.dice.chance(0.75) {
        let clip = rounded_box(Vec3::new(cap * 0.78, r * 0.5, 0.0022), 0.001, 0.0008);
        let middle = if bare { cap_at + cap * 0.45 } else { cap_at + cap * 0.48 };
        w.add(clip.moved(Vec3::new(middle + flip * cap * 0.06, r * 0.55, r * 0.92)), colored, 45.0);
    }
    let plug =
        revolve(&[Vec2::new(0.0, 0.0), Vec2::new(r * 0.8, 0.0), Vec2::new(r * 0.7, 0.004), Vec2::new(0.0, 0.004)], n)
            .turned(Mat3::from_quat(Quat::from_rotation_arc(Vec3::Z, Vec3::NEG_X)));
    if bare {
        marker_tip(w, joint, r, ink);
    } else {
        w.add(plug.moved(Vec3::X * (start + 0.001)), colored, 40.0);
    }
    w.settle();
}

/// The collar and the felt tip of a marker without its cap.
fn marker_tip(w: &mut Workshop, joint: f32, r: f32, ink: Vec3) {
    let collar = [
        Vec2::new(0.0, joint - 0.001),
        Vec2::new(r * 0.85, joint - 0.001),
        Vec2::new(r * 0.80, joint + 0.006),
        Vec2::new(r * 0.50, joint + 0.013),
        Vec2::new(0.0, joint + 0.013),
    ];
    let pale = w.material(|_| material("plastic", &Canvas::new(4, 4, Vec3::splat(0.82)), 0.0, 0.5));
    w.add(lathe_x(&collar, 20, false).uv_box(Vec2::splat(0.05)), pale, 40.0);
    let felt = [
        Vec2::new(0.0, joint + 0.012),
        Vec2::new(r * 0.36, joint + 0.012),
        Vec2::new(r * 0.34, joint + 0.019),
        Vec2::new(r * 0.12, joint + 0.024),
        Vec2::new(0.0, joint + 0.024),
    ];
    let dark = w.material(|_| material("foam", &Canvas::new(4, 4, ink * 0.6), 0.0, 0.9));
    w.add(lathe_x(&felt, 14, false).uv_box(Vec2::splat(0.05)), dark, 40.0);
}

/// Tick marks every millimetre along the top edge, longer at 5 and 10, with numbers.
fn scale_paint(dice: &mut Dice, base: Canvas, centimetres: u32, ink: Vec3) -> Canvas {
    let (width, height) = (512i64, 64i64);
    let margin = 9.0;
    let step = (width as f32 - 2.0 * margin) / (centimetres * 10) as f32;
    let mut canvas = base;
    let both = dice.chance(0.5);
    for mm in 0..=centimetres * 10 {
        let long = match mm % 10 {
            0 => 24,
            5 => 17,
            _ if mm % 2 == 0 => 11,
            _ => continue,
        };
        let x = (margin + step * mm as f32).round() as i64;
        for y in 0..long {
            canvas.dot(x, y, ink);
            if mm % 10 == 0 {
                canvas.dot(x + 1, y, ink);
            }
            if both && mm % 5 == 0 {
                canvas.dot(x, height - 1 - y * 2 / 3, ink);
            }
        }
        if mm % 10 == 0 && mm > 0 {
            let n = mm / 10;
            if n >= 10 {
                canvas.digit(n / 10, x - 7, 28, 2, ink);
            }
            canvas.digit(n, x + 1, 28, 2, ink);
        }
    }
    canvas
}

/// A flat ruler along x with a printed scale.
pub fn ruler(w: &mut Workshop) {
    let shape = w.shape();
    let centimetres = if w.dice.chance(0.75) { 30 } else { 20 };
    let length = centimetres as f32 * 0.01 + 0.011;
    let wide = if shape == "wide" { w.dice.range(0.041, 0.046) } else { w.dice.range(0.029, 0.039) };
    let thick = w.dice.range(0.0022, 0.0040);
    let kind = w.dice.unit();
    let (ground, ink, metallic) = if kind < 0.35 {
        (Vec3::ZERO, Vec3::new(0.12, 0.09, 0.07), 0.0)
    } else if kind < 0.55 {
        (w.dice.tint(Vec3::splat(0.74), 0.05), Vec3::splat(0.08), 0.5)
    } else if kind < 0.75 {
        (w.dice.color((0.02, 0.2), (0.86, 0.97)), Vec3::splat(0.08), 0.0)
    } else {
        let tone = w.dice.vivid();
        let dark = tone.dot(Vec3::new(0.3, 0.6, 0.1)) < 0.45;
        (tone, if dark { Vec3::splat(0.95) } else { Vec3::splat(0.06) }, 0.0)
    };
    let base = if kind < 0.35 {
        let timber = wood(&mut w.dice);
        let grain = timber.base_color_texture;
        Canvas::new(512, 64, Vec3::ZERO).each(|uv, _| {
            grain.as_ref().map_or(Vec3::splat(0.7), |t| {
                let (x, y) = ((uv.y * 30.0) as u32 % t.width, (uv.x * 2.0 * t.height as f32) as u32 % t.height);
                let p = t.texels[(y * t.width + x) as usize];
                Vec3::new(f32::from(p[0]), f32::from(p[1]), f32::from(p[2])) / 255.0 * 0.6 + Vec3::new(0.36, 0.30, 0.21)
            })
        })
    } else {
        Canvas::new(512, 64, ground)
    };
    let canvas = scale_paint(&mut w.dice, base, centimetres, ink);
    let name = if metallic > 0.0 {
        "steel"
    } else if kind < 0.35 {
        "wood"
    } else {
        "plastic"
    };
    let paint = w.material(|_| material(name, &canvas, metallic, 0.45));
    let outline = rounded_rectangle(length / 2.0, wide / 2.0, if shape == "grip" { 0.008 } else { 0.002 }, 16);
    let bevel = if shape == "beveled" || shape == "grip" { thick * 0.45 } else { 0.0003 };
    let body = extrude(&outline, 0.0, thick, bevel).map_uv(|p, _| Vec2::new(p.x / length + 0.5, 0.5 - p.y / wide));
    w.add(body, paint, 30.0);
    if shape == "holed" {
        let hole = revolve(
            &[
                Vec2::new(0.0, thick - 0.0004),
                Vec2::new(0.0042, thick - 0.0004),
                Vec2::new(0.0042, thick + 0.0003),
                Vec2::new(0.0, thick + 0.0003),
            ],
            16,
        );
        let dark = w.material(|_| material(name, &Canvas::new(4, 4, Vec3::splat(0.08)), 0.0, 0.9));
        w.add(hole.moved(Vec3::new(length / 2.0 - 0.009, -wide * 0.18, 0.0)), dark, 30.0);
    }
    if shape == "edged" || shape == "grip" {
        let strip = rounded_box(Vec3::new(length * 0.96, wide * 0.14, 0.0016), 0.0008, 0.0006);
        let tone = w.dice.vivid();
        let edge = w.material(|d| plastic(d, tone));
        w.add(strip.moved(Vec3::new(0.0, -wide * 0.30, thick)), edge, 40.0);
    }
    w.settle();
}

/// Front cover in the left part of the canvas, spine in the rightmost sixth.
fn cover_paint(dice: &mut Dice) -> Canvas {
    let family = dice.family(&finishes(Stuff::Cover));
    let noise = Noise(dice.seed());
    let pale = dice.chance(0.35);
    let ground = if pale { dice.color((0.04, 0.25), (0.8, 0.95)) } else { dice.color((0.45, 0.9), (0.25, 0.75)) };
    let second = if pale { dice.vivid() } else { dice.color((0.1, 0.7), (0.75, 0.97)) };
    let third = dice.vivid();
    let ink = if pale { Vec3::splat(0.12) } else { Vec3::new(0.95, 0.92, 0.82) };
    let split = 5.0 / 6.0;
    let at = dice.any(0.5, 0.68);
    let mut canvas = Canvas::new(160, 160, ground).each(|uv, c| {
        let c = c * (0.96 + 0.08 * noise.smooth(uv, (40, 40)));
        if uv.x > split {
            return if (uv.y - 0.12).abs() < 0.02 || (uv.y - 0.88).abs() < 0.02 { second } else { c };
        }
        let p = Vec2::new(uv.x / split, uv.y);
        match family {
            "banded" if (at - 0.18..at).contains(&p.y) || p.y > 0.93 => second,
            "blocks" if p.y > at - 0.1 => {
                let cell = (p * Vec2::new(5.0, 6.0)).floor();
                [second, third, ground, second * 0.7][(noise.at(cell.x as u32, cell.y as u32) * 4.0) as usize % 4]
            }
            "framed" if (p - 0.5).abs().max_element() > 0.42 && (p - 0.5).abs().max_element() < 0.455 => second,
            "landscape" if p.y > 0.45 => {
                let hill = 0.62 + 0.10 * (p.x * 7.0).sin() + 0.06 * (p.x * 17.0).sin();
                if p.y > hill + 0.14 {
                    third * 0.6
                } else if p.y > hill {
                    third
                } else {
                    second
                }
            }
            "discs" if (p - Vec2::new(0.5, 0.68)).length() < 0.22 => {
                if (p - Vec2::new(0.42, 0.62)).length() < 0.1 {
                    third
                } else {
                    second
                }
            }
            "title" if (p - Vec2::new(0.5, at + 0.14)).abs().cmplt(Vec2::new(0.30, 0.12)).all() => second,
            _ => c,
        }
    });
    canvas.text(Vec2::new(0.12, 0.12), Vec2::new(0.74, 0.34), 2, ink, noise);
    canvas.text(Vec2::new(0.12, 0.38), Vec2::new(0.5, 0.44), 1, ink, Noise(noise.0 ^ 5));
    canvas.rectangle(Vec2::new(split + 0.055, 0.24), Vec2::new(split + 0.105, 0.66), ink);
    canvas
}

/// A closed book lying on its back cover, spine towards -x.
pub fn book(w: &mut Workshop) {
    let shape = w.shape();
    let (long, wide, thick) = match shape {
        "thick" | "tome" => (w.dice.range(0.20, 0.24), w.dice.range(0.145, 0.17), w.dice.range(0.036, 0.048)),
        "square" => (w.dice.range(0.19, 0.21), w.dice.range(0.185, 0.20), w.dice.range(0.018, 0.026)),
        "pocket" => (w.dice.range(0.155, 0.175), w.dice.range(0.10, 0.115), w.dice.range(0.016, 0.026)),
        _ => (w.dice.range(0.185, 0.235), w.dice.range(0.13, 0.165), w.dice.range(0.018, 0.034)),
    };
    let soft = matches!(shape, "paperback" | "pocket");
    let (board, over) = if soft { (0.0008, 0.0) } else { (0.0028, 0.0035) };
    let canvas = cover_paint(&mut w.dice);
    let paint = w.material(|_| material("paper", &canvas, 0.0, if soft { 0.35 } else { 0.6 }));
    let hollow = if soft { 0.0 } else { w.dice.any(0.002, 0.006) };
    let round = if soft { 0.0008 } else { w.dice.range(0.001, 0.006) };
    for (z, flip) in [(0.0, true), (thick - board, false)] {
        let plate =
            extrude(&rounded_rectangle(wide / 2.0, long / 2.0, 0.0015, 4), 0.0, board, board * 0.2).moved(Vec3::Z * z);
        let plate = plate.map_uv(|p, _| {
            let u = if flip { 0.5 - p.x / wide } else { 0.5 + p.x / wide };
            Vec2::new(u * 5.0 / 6.0 * 0.98 + 0.005, 0.5 - p.y / long)
        });
        w.add(plate, paint, 35.0);
    }
    let arc: Vec<Vec2> = (0..=16)
        .map(|k| {
            let t = k as f32 / 16.0;
            Vec2::new(-wide / 2.0 - round * (std::f32::consts::PI * t).sin(), thick * t)
        })
        .collect();
    let mut section: Vec<Vec2> = arc.iter().rev().copied().collect();
    section.extend(arc.iter().map(|p| Vec2::new(p.x + board.max(0.001) + 0.0004, p.y)));
    let ring = |y: f32| section.iter().map(|p| Vec3::new(p.x, y, p.y)).collect::<Vec<_>>();
    let spine = Surface::loft(&[ring(-long / 2.0), ring(long / 2.0)], Ends::Capped)
        .map_uv(|p, _| Vec2::new(5.0 / 6.0 + p.z / thick / 6.0 * 0.98 + 0.001, 0.5 - p.y / long));
    w.add(spine, paint, 50.0);
    let tone = w.dice.tint(Vec3::new(0.94, 0.91, 0.83), 0.05);
    let noise = Noise(w.dice.seed());
    let leaves = Canvas::new(32, 128, tone).each(|uv, c| c * (0.72 + 0.28 * noise.smooth(uv, (2, 64))));
    let paper = w.material(|_| material("paper", &leaves, 0.0, 0.9));
    let inner = thick - 2.0 * board;
    let block = extrude(&rounded_rectangle((wide - over) / 2.0, long / 2.0 - over, 0.0006, 4), 0.0, inner, 0.0)
        .map(|p| {
            Vec3::new(
                p.x - over / 2.0 - if p.x > 0.0 { hollow * (1.0 - (2.0 * p.z / inner - 1.0).powi(2)) } else { 0.0 },
                p.y,
                p.z + board,
            )
        })
        .map_uv(|p, _| Vec2::new((p.x + p.y) * 4.0, (p.z - board) / inner));
    w.add(block, paper, 35.0);
    w.settle();
}
