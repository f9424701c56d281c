//! Shapes and a small tabletop for tests.
#![allow(dead_code)]

pub mod backends;
#[cfg(feature = "gpu")]
pub mod gpu;

use std::f32::consts::{PI, TAU};
use std::sync::Arc;

use fuse_camera::{Camera, Pinhole, Pose};
use fuse_render::{Instance, Light, Material, Mesh, Model, Scene, Texture};
use glam::{Affine3A, Vec2, Vec3};
use nalgebra::Point3;

pub fn material(rgb: [f32; 3], metallic: f32, roughness: f32) -> Material {
    Material { base_color: [rgb[0], rgb[1], rgb[2], 1.0], metallic, roughness, ..Material::default() }
}

pub fn textured(texture: Texture, roughness: f32) -> Material {
    Material { base_color_texture: Some(Arc::new(texture)), roughness, ..Material::default() }
}

pub fn model(mesh: Mesh, material: Material) -> Model {
    Model { meshes: vec![mesh], materials: vec![material] }
}

/// Rectangle spanned by `u` and `v` around the origin's `corner`; faces `u × v`.
pub fn quad(corner: Vec3, u: Vec3, v: Vec3, repeat: f32) -> Mesh {
    let n = u.cross(v).normalize();
    let (ru, rv) = (repeat * u.length(), repeat * v.length());
    Mesh {
        positions: vec![corner, corner + u, corner + u + v, corner + v],
        normals: vec![n; 4],
        uvs: vec![Vec2::ZERO, Vec2::new(ru, 0.0), Vec2::new(ru, rv), Vec2::new(0.0, rv)],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material: 0,
    }
}

pub fn merge(parts: impl IntoIterator<Item = Mesh>) -> Mesh {
    let mut out = Mesh::default();
    for part in parts {
        let n = out.positions.len() as u32;
        out.positions.extend(part.positions);
        out.normals.extend(part.normals);
        out.uvs.extend(part.uvs);
        out.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i + n)));
    }
    out
}

pub fn cuboid(half: Vec3) -> Mesh {
    let axes = [Vec3::X, Vec3::Y, Vec3::Z];
    merge((0..6).map(|f| {
        let (n, u, v) = (axes[f / 2], axes[(f / 2 + 1) % 3], axes[(f / 2 + 2) % 3]);
        let (n, u) = if f % 2 == 0 { (n, u) } else { (-n, -u) };
        quad((n - u - v) * half, 2.0 * u * half, 2.0 * v * half, 4.0)
    }))
}

/// Surface of revolution of the outline `(radius, height)`, bottom to top, outside facing out.
pub fn lathe(outline: &[[f32; 2]], segments: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let rows = outline.len() as u32;
    for s in 0..=segments {
        let (sin, cos) = (TAU * s as f32 / segments as f32).sin_cos();
        for (r, p) in outline.iter().enumerate() {
            let a = outline[r.saturating_sub(1)];
            let b = outline[(r + 1).min(outline.len() - 1)];
            let n = Vec3::new((b[1] - a[1]) * cos, (b[1] - a[1]) * sin, a[0] - b[0]);
            mesh.positions.push(Vec3::new(p[0] * cos, p[0] * sin, p[1]));
            mesh.normals.push(n.normalize_or(Vec3::Z));
            mesh.uvs.push(Vec2::new(s as f32 / segments as f32, r as f32 / (rows - 1) as f32));
        }
    }
    for s in 0..segments {
        for r in 0..rows - 1 {
            let (a, b) = (s * rows + r, (s + 1) * rows + r);
            mesh.triangles.extend([[a, b, b + 1], [a, b + 1, a + 1]]);
        }
    }
    mesh
}

pub fn sphere(radius: f32, rings: u32) -> Mesh {
    let outline: Vec<[f32; 2]> = (0..=rings)
        .map(|i| {
            let (sin, cos) = (PI * i as f32 / rings as f32).sin_cos();
            [radius * sin, -radius * cos]
        })
        .collect();
    let mut mesh = lathe(&outline, 2 * rings);
    mesh.normals = mesh.positions.iter().map(|p| *p / radius).collect();
    mesh
}

fn noise(x: u32, y: u32, seed: u32) -> f32 {
    let mut h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ seed.wrapping_mul(0xc2b2_ae3d);
    h ^= h >> 15;
    h = h.wrapping_mul(0x2c1b_3c6d);
    h ^= h >> 12;
    h = h.wrapping_mul(0x297a_2d39);
    h ^= h >> 15;
    h as f32 / u32::MAX as f32
}

/// Bilinear value noise with period `cells`.
fn smooth(u: f32, v: f32, cells: [u32; 2], seed: u32) -> f32 {
    let (x, y) = (u * cells[0] as f32, v * cells[1] as f32);
    let (fx, fy) = (x - x.floor(), y - y.floor());
    let at = |dx: u32, dy: u32| noise((x as u32 + dx) % cells[0], (y as u32 + dy) % cells[1], seed);
    let top = at(0, 0) + (at(1, 0) - at(0, 0)) * fx;
    let bottom = at(0, 1) + (at(1, 1) - at(0, 1)) * fx;
    top + (bottom - top) * fy
}

/// A texture from a function of texture coordinates to sRGB in [0, 1].
pub fn texture(size: u32, f: impl Fn(f32, f32) -> [f32; 3]) -> Texture {
    let texel = |i: u32| {
        let c = f(((i % size) as f32 + 0.5) / size as f32, ((i / size) as f32 + 0.5) / size as f32);
        let [r, g, b] = c.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8);
        [r, g, b, 255]
    };
    Texture { width: size, height: size, texels: (0..size * size).map(texel).collect() }
}

pub fn wood() -> Texture {
    texture(512, |u, v| {
        let grain =
            smooth(u, v, [4, 96], 1) * 0.5 + smooth(u, v, [8, 256], 2) * 0.3 + smooth(u, v, [256, 256], 3) * 0.2;
        let plank = ((v * 4.0).fract() > 0.012) as u32 as f32;
        let tone = (0.55 + 0.35 * grain + 0.08 * noise((v * 4.0) as u32, 0, 9)) * (0.5 + 0.5 * plank);
        [0.85 * tone, 0.62 * tone, 0.42 * tone]
    })
}

pub fn plaster() -> Texture {
    texture(256, |u, v| {
        let t = 0.75 + 0.12 * smooth(u, v, [16, 16], 4) + 0.1 * smooth(u, v, [128, 128], 5);
        [t, 0.97 * t, 0.9 * t]
    })
}

pub fn checker(n: f32) -> Texture {
    texture(
        256,
        |u, v| if ((u * n) as u32 + (v * n) as u32).is_multiple_of(2) { [0.85, 0.2, 0.15] } else { [0.95, 0.9, 0.8] },
    )
}

pub fn place(model: Model, at: Vec3, yaw: f32, id: u32) -> Instance {
    let transform = Affine3A::from_rotation_z(yaw);
    Instance { model: Arc::new(model), transform: Affine3A::from_translation(at) * transform, id }
}

/// Room and table, id 0; table top at 0.75.
pub fn room() -> Vec<Instance> {
    let (w, h) = (5.0, 2.8);
    let floor = quad(Vec3::new(-w / 2., -w / 2., 0.), Vec3::X * w, Vec3::Y * w, 0.7);
    let walls = (0..4).map(|k| {
        let (sin, cos) = (PI / 2.0 * k as f32).sin_cos();
        let (d, along) = (Vec3::new(cos, sin, 0.0), Vec3::new(-sin, cos, 0.0));
        quad(d * w / 2. + along * w / 2., -along * w, Vec3::Z * h, 0.8)
    });
    let leg = |x: f32, y: f32| {
        let mut m = cuboid(Vec3::new(0.025, 0.025, 0.36));
        m.positions.iter_mut().for_each(|p| *p += Vec3::new(x, y, 0.36));
        m
    };
    let mut top = cuboid(Vec3::new(0.6, 0.4, 0.015));
    top.positions.iter_mut().for_each(|p| p.z += 0.735);
    top.uvs.iter_mut().for_each(|uv| *uv *= 0.3);
    let legs = [(-0.55, -0.35), (0.55, -0.35), (0.55, 0.35), (-0.55, 0.35)].map(|(x, y)| leg(x, y));
    let table = merge(std::iter::once(top).chain(legs));
    vec![
        place(model(floor, textured(wood(), 0.6)), Vec3::ZERO, 0.0, 0),
        place(model(merge(walls), textured(plaster(), 0.9)), Vec3::ZERO, 0.0, 0),
        place(model(table, textured(wood(), 0.45)), Vec3::ZERO, 0.0, 0),
    ]
}

pub fn mug_outline() -> Vec<[f32; 2]> {
    vec![
        [0.0, 0.0],
        [0.036, 0.0],
        [0.04, 0.004],
        [0.04, 0.09],
        [0.039, 0.092],
        [0.037, 0.09],
        [0.037, 0.006],
        [0.0, 0.005],
    ]
}

/// The room with `n` assorted things on the table.
pub fn tabletop(n: u32, detail: u32) -> Scene {
    let mut instances = room();
    for k in 0..n {
        let a = k as f32 * 2.399_963;
        let r = 0.07 + 0.27 * (k as f32 / n as f32).sqrt();
        let at = Vec3::new(1.35 * r * a.cos(), r * a.sin(), 0.75);
        let (m, lift) = match k % 5 {
            0 => (model(lathe(&mug_outline(), detail), material([0.75, 0.12, 0.1], 0.0, 0.25)), 0.0),
            1 => (model(sphere(0.04, detail / 2), material([0.9, 0.87, 0.82], 1.0, 0.15)), 0.04),
            2 => (model(cuboid(Vec3::new(0.07, 0.045, 0.02)), textured(checker(8.0), 0.5)), 0.02),
            3 => (model(lathe(&mug_outline(), detail), material([0.95, 0.76, 0.4], 1.0, 0.35)), 0.0),
            _ => (model(sphere(0.035, detail / 2), material([0.1, 0.35, 0.6], 0.0, 0.6)), 0.035),
        };
        instances.push(place(m, at + Vec3::Z * lift, a, k + 1));
    }
    Scene { instances, light: Light::default(), background: Vec3::splat(0.1) }
}

pub fn camera(width: u32, height: u32, eye: [f64; 3], target: [f64; 3]) -> Camera {
    let intrinsics = Pinhole::from_horizontal_fov(width, height, 60f64.to_radians()).unwrap();
    Camera { intrinsics, pose: Pose::look_at(Point3::from(eye), Point3::from(target)) }
}
