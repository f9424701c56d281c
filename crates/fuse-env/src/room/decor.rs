//! What stands and hangs along the walls: windows, pictures, cupboards, shelves, skirting.

use fuse_render::Model;
use glam::{Vec2, Vec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::shapes::Builder;
use super::{Wall, material, painted, walls};
use crate::configuration::{SceneConfiguration, Surface, SurfaceKind};
use crate::surfaces;

/// Width of wall that one thing takes, metres.
const SLOT: f32 = 1.15;
/// How far the texture of furniture runs before it repeats, metres.
const REPEAT: f32 = 1.2;

/// Materials that every piece shares.
struct Palette {
    wood: usize,
    dark: usize,
    sky: usize,
    plain: Vec<usize>,
}

fn palette(b: &mut Builder, wood: &Surface) -> Palette {
    let dark = Surface { base: wood.base.map(|v| v / 2), accent: wood.accent.map(|v| v / 3), ..wood.clone() };
    let sky = Surface {
        kind: SurfaceKind::Plaster,
        base: [178, 206, 232],
        accent: [246, 248, 250],
        contrast: 1.4,
        wear: 0.0,
        scale: 0.5,
        texels: 256,
        ..wood.clone()
    };
    let plain = [[166, 62, 52], [58, 96, 140], [214, 176, 80], [86, 122, 84]].map(|base| {
        let surface = Surface {
            kind: SurfaceKind::Cloth,
            base,
            accent: base.map(|v| v / 2),
            wear: 0.4,
            texels: 128,
            ..wood.clone()
        };
        b.material(painted("painted", &surface, Vec2::splat(0.4)))
    });
    Palette {
        wood: b.material(painted("furniture", wood, Vec2::splat(REPEAT))),
        dark: b.material(painted("frame", &dark, Vec2::splat(REPEAT))),
        sky: b.material(painted("sky", &sky, Vec2::splat(1.0))),
        plain: plain.to_vec(),
    }
}

/// A box in a wall's axes: `u`, depth into the room, height; each `[low, high]`.
fn block(b: &mut Builder, wall: &Wall, m: usize, u: [f32; 2], d: [f32; 2], z: [f32; 2]) {
    let (p, q) = (wall.at(u[0], d[0], z[0]), wall.at(u[1], d[1], z[1]));
    b.cuboid(m, p.min(q), p.max(q), REPEAT);
}

/// Four bars around a rectangle on the wall.
fn frame(b: &mut Builder, wall: &Wall, m: usize, u: [f32; 2], z: [f32; 2], bar: f32, depth: f32) {
    let d = [0.0, depth];
    block(b, wall, m, [u[0] - bar, u[0]], d, [z[0] - bar, z[1] + bar]);
    block(b, wall, m, [u[1], u[1] + bar], d, [z[0] - bar, z[1] + bar]);
    block(b, wall, m, u, d, [z[0] - bar, z[0]]);
    block(b, wall, m, u, d, [z[1], z[1] + bar]);
}

fn pane(b: &mut Builder, wall: &Wall, m: usize, u: [f32; 2], z: [f32; 2], d: f32) {
    b.quad(m, [wall.at(u[0], d, z[0]), wall.at(u[1], d, z[0]), wall.at(u[1], d, z[1]), wall.at(u[0], d, z[1])]);
}

fn window(b: &mut Builder, wall: &Wall, p: &Palette, u: f32, rng: &mut ChaCha8Rng) {
    let half = rng.random_range(0.32..0.46);
    let (low, high) = (rng.random_range(0.95..1.1), rng.random_range(1.85..2.05));
    pane(b, wall, p.sky, [u - half, u + half], [low, high], 0.01);
    frame(b, wall, p.wood, [u - half, u + half], [low, high], 0.06, 0.06);
    block(b, wall, p.wood, [u - 0.015, u + 0.015], [0.0, 0.04], [low, high]);
    let cross = low + 0.6 * (high - low);
    block(b, wall, p.wood, [u - half, u + half], [0.0, 0.04], [cross - 0.015, cross + 0.015]);
    block(b, wall, p.wood, [u - half - 0.1, u + half + 0.1], [0.0, 0.14], [low - 0.1, low - 0.06]);
}

fn pictures(b: &mut Builder, wall: &Wall, p: &Palette, u: f32, rng: &mut ChaCha8Rng) {
    for side in [-1.0, 1.0] {
        let center = u + side * rng.random_range(0.24..0.3);
        let (w, h) = (rng.random_range(0.13..0.2), rng.random_range(0.15..0.26));
        let z = rng.random_range(1.2..1.6);
        let art = b.material(material("picture", surfaces::picture(rng.random(), 192), 0.8));
        pane(b, wall, art, [center - w, center + w], [z - h, z + h], 0.01);
        frame(b, wall, p.dark, [center - w, center + w], [z - h, z + h], 0.025, 0.03);
    }
}

fn cupboard(b: &mut Builder, wall: &Wall, p: &Palette, u: f32, rng: &mut ChaCha8Rng) {
    let (half, depth) = (rng.random_range(0.4..0.52), rng.random_range(0.3..0.42));
    let top = rng.random_range(0.85..1.5);
    block(b, wall, p.wood, [u - half, u + half], [0.0, depth], [0.08, top]);
    block(b, wall, p.dark, [u - half + 0.03, u + half - 0.03], [0.0, depth - 0.05], [0.0, 0.08]);
    block(b, wall, p.dark, [u - half - 0.02, u + half + 0.02], [0.0, depth + 0.02], [top, top + 0.025]);
    for side in [-1.0, 1.0] {
        let (a, c) = (u + side * 0.02, u + side * (half - 0.03));
        let door = if side < 0.0 { [c, a] } else { [a, c] };
        block(b, wall, p.wood, door, [depth, depth + 0.015], [0.13, top - 0.04]);
        let knob = u + side * 0.06;
        block(b, wall, p.dark, [knob - 0.01, knob + 0.01], [depth, depth + 0.04], [top * 0.6, top * 0.6 + 0.1]);
    }
    row_of_things(b, wall, p, [u - half + 0.05, u + half - 0.05], top + 0.025, depth * 0.5, rng);
}

fn shelf(b: &mut Builder, wall: &Wall, p: &Palette, u: f32, rng: &mut ChaCha8Rng) {
    let half = rng.random_range(0.38..0.5);
    for z in [rng.random_range(0.75..0.9), rng.random_range(1.2..1.3), rng.random_range(1.6..1.7)] {
        block(b, wall, p.wood, [u - half, u + half], [0.0, 0.24], [z, z + 0.022]);
        row_of_things(b, wall, p, [u - half + 0.02, u + half - 0.02], z + 0.022, 0.12, rng);
    }
}

/// Book- and box-like things in a row on something at height `z`.
fn row_of_things(b: &mut Builder, wall: &Wall, p: &Palette, u: [f32; 2], z: f32, middle: f32, rng: &mut ChaCha8Rng) {
    let mut at = u[0];
    loop {
        let width = rng.random_range(0.025..0.12);
        if at + width > u[1] {
            return;
        }
        if rng.random_bool(0.75) {
            let (depth, height) = (rng.random_range(0.05..0.1), rng.random_range(0.08..0.26));
            let m = p.plain[rng.random_range(0..p.plain.len())];
            block(b, wall, m, [at, at + width - 0.004], [middle - depth, middle + depth], [z, z + height]);
        }
        at += width;
    }
}

/// The room's furniture, one thing a slot of wall, by the configuration's decor seed.
pub fn along_walls(scene: &SceneConfiguration) -> Model {
    let mut rng = ChaCha8Rng::seed_from_u64(scene.room.decor_seed);
    let mut b = Builder::default();
    let p = palette(&mut b, &scene.room.wood);
    let size = Vec3::from_array(scene.room.size_m);
    for wall in walls(size) {
        let half = wall.length / 2.0;
        block(&mut b, &wall, p.dark, [-half, half], [0.0, 0.015], [0.0, 0.09]);
        let slots = ((wall.length - 0.5) / SLOT).floor().max(1.0);
        for i in 0..slots as usize {
            let u = (i as f32 + 0.5 - slots / 2.0) * SLOT;
            let kind = rng.random_range(0..5);
            if !rng.random_bool(f64::from(scene.room.decor_density)) {
                continue;
            }
            match kind {
                0 => window(&mut b, &wall, &p, u, &mut rng),
                1 => pictures(&mut b, &wall, &p, u, &mut rng),
                2 => shelf(&mut b, &wall, &p, u, &mut rng),
                3 => {
                    pictures(&mut b, &wall, &p, u, &mut rng);
                    block(&mut b, &wall, p.wood, [u - 0.4, u + 0.4], [0.05, 0.4], [0.38, 0.46]);
                    block(&mut b, &wall, p.dark, [u - 0.38, u - 0.32], [0.1, 0.35], [0.0, 0.38]);
                    block(&mut b, &wall, p.dark, [u + 0.32, u + 0.38], [0.1, 0.35], [0.0, 0.38]);
                }
                _ => cupboard(&mut b, &wall, &p, u, &mut rng),
            }
        }
    }
    b.finish()
}
