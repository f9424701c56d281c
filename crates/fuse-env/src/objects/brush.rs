//! Scrub brushes.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::Workshop;
use super::finish::material;
use super::parts::{grip_stuff, torus};
use super::shape::Ends;
use super::sweep::{Tip, along, spline, superellipse, sweep, tube};
use super::texture::Canvas;

/// A scrubbing brush standing on its bristles.
pub fn scrub_brush(w: &mut Workshop) {
    let shape = w.shape();
    let long = match shape {
        "block" | "oval" => w.dice.range(0.135, 0.165),
        _ => w.dice.range(0.185, 0.235),
    };
    let paddle = matches!(shape, "paddle" | "round_head" | "dish");
    let wide = w.dice.range(0.044, 0.056);
    let thick = w.dice.range(0.014, 0.020);
    let bristle = w.dice.range(0.016, 0.024);
    let (x0, x1) = if paddle { (long * 0.10, long * 0.5) } else { (-long * 0.5, long * 0.5) };
    let head = x1 - x0;
    // Half the width of the wood at x.
    let half = |x: f32| -> f32 {
        let inside = ((x - (x0 + x1) / 2.0) / (head / 2.0)).clamp(-1.0, 1.0);
        let power = if matches!(shape, "oval" | "round_head") { 2.0 } else { 4.5 };
        let disc = wide / 2.0 * (1.0 - inside.abs().powf(power)).max(0.0).powf(1.0 / power);
        if paddle && x < x0 + head * 0.35 {
            disc.max(
                wide * along(
                    &[(0.0, 0.14), (0.25, 0.19), (0.7, 0.15), (1.0, 0.20)],
                    (x + long * 0.5) / (x0 + long * 0.5),
                ),
            )
        } else {
            disc
        }
    };
    let steps = 40;
    let path: Vec<Vec3> = (0..=steps)
        .map(|i| {
            let t = (1.0 - (PI * i as f32 / steps as f32).cos()) / 2.0;
            Vec3::X * (-long * 0.5 + long * t)
        })
        .collect();
    let arch = if shape == "arched" { 0.018 } else { 0.0 };
    let body = sweep(&path, Vec3::Z, Ends::Capped, |i, _| {
        let x = path[i].x;
        let ends = (1.0 - (2.0 * x / long).abs().powi(16)).max(0.0).sqrt().max(0.25);
        superellipse(half(x).max(0.004), thick / 2.0 * ends, 3.5, 18)
    })
    .map(|p| Vec3::new(p.x, p.y, p.z + arch * (1.0 - (2.0 * p.x / long).powi(2)) * if p.z > 0.0 { 1.0 } else { 0.0 }));
    let stuff = grip_stuff(w, 0.55, 0.05);
    w.add(body.moved(Vec3::Z * (bristle + thick / 2.0 - 0.001)).uv_box(Vec2::new(0.06, 0.14)), stuff, 45.0);
    let pale = match w.dice.pick(&[0, 0, 1]) {
        0 => w.dice.tint(Vec3::new(0.88, 0.80, 0.62), 0.10),
        _ => w.dice.color((0.3, 0.7), (0.6, 0.95)),
    };
    let hair = Canvas::new(32, 16, pale).each(|uv, c| c * (0.72 + 0.4 * ((uv.x * 16.0 * TAU).sin() * 0.5 + 0.5)));
    let hairs = w.material(|_| material("foam", &hair, 0.0, 0.9));
    let columns = (head / 0.0112) as usize;
    let rows = 4;
    let splay = w.dice.range(0.05, 0.22);
    for i in 0..columns {
        let x = x0 + head * (i as f32 + 0.5) / columns as f32;
        let reach = half(x) - 0.0045;
        if reach < 0.004 {
            continue;
        }
        for j in 0..rows {
            let y = reach * (2.0 * j as f32 / (rows - 1) as f32 - 1.0);
            let lean = Vec2::new(0.5 * (x - (x0 + x1) / 2.0) / head, y / wide) * splay * bristle * 2.0;
            let long = bristle * w.dice.any(0.95, 1.0);
            let from = Vec3::new(x, y, bristle + 0.002);
            let to = Vec3::new(x + lean.x, y + lean.y, bristle - long);
            let tuft =
                tube(&[from, to], Vec3::X, 5, [Tip::Flat, Tip::Flat], |t| (0.0029 + 0.0014 * t, 0.0029 + 0.0014 * t));
            w.add(tuft, hairs, 35.0);
        }
    }
    if shape == "handle" {
        let arch = spline(
            &[
                Vec3::new(-long * 0.38, 0.0, bristle + thick * 0.6),
                Vec3::new(-long * 0.30, 0.0, bristle + thick + 0.024),
                Vec3::new(long * 0.10, 0.0, bristle + thick + 0.030),
                Vec3::new(long * 0.38, 0.0, bristle + thick * 0.6),
            ],
            7,
        );
        let grip = tube(&arch, Vec3::Y, 12, [Tip::Flat, Tip::Flat], |t| {
            let s = 1.0 + 0.25 * (2.0 * t - 1.0).abs().powi(4);
            (0.0062 * s, 0.0110 * s)
        });
        w.add(grip.uv_box(Vec2::new(0.05, 0.12)), stuff, 50.0);
    } else if paddle {
        let eye = torus(0.006, 0.0018, 0.0018, 2.0, 16).map(|p| Vec3::new(p.x, p.z, p.y));
        w.add(eye.moved(Vec3::new(-long * 0.5 - 0.003, 0.0, bristle + thick / 2.0)), stuff, 60.0);
    }
    w.settle();
}
