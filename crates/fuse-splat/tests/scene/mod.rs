//! Scenes that the tests share.
#![allow(dead_code, reason = "each test binary uses its own part")]

#[cfg(feature = "gpu")]
pub mod gpu;

use fuse_camera::{Camera, Pinhole, Pose, RgbBuffer};
use fuse_splat::Gaussians;
use nalgebra::Point3;

/// A repeatable stream of numbers in [0, 1).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.next()
    }
}

/// A camera at `angle` on a ring of radius 1.1 m, 0.7 m up, that looks at the origin.
pub fn camera(width: u32, height: u32, angle: f64) -> Camera {
    let eye = Point3::new(1.1 * angle.cos(), 1.1 * angle.sin(), 0.7);
    Camera {
        intrinsics: Pinhole::from_horizontal_fov(width, height, 60f64.to_radians()).unwrap(),
        pose: Pose::look_at(eye, Point3::new(0.02, -0.01, 0.0)),
    }
}

/// Random Gaussians around the origin, within `spread` metres; scales in metres.
pub fn cloud(count: usize, seed: u64, spread: f32, scales: [f32; 2], logits: [f32; 2]) -> Gaussians {
    let mut r = Random::new(seed);
    let vectors: Vec<[f32; 59]> = (0..count)
        .map(|_| {
            let mut v = [0.0; 59];
            for x in &mut v[..3] {
                *x = r.between(-spread, spread);
            }
            v[2] *= 0.5;
            for s in &mut v[3..6] {
                *s = r.between(scales[0].ln(), scales[1].ln());
            }
            for q in &mut v[6..10] {
                *q = r.between(-1.0, 1.0);
            }
            v[10] = r.between(logits[0], logits[1]);
            for c in &mut v[11..14] {
                *c = r.between(-1.0, 1.5);
            }
            for c in &mut v[14..] {
                *c = r.between(-0.12, 0.12);
            }
            v
        })
        .collect();
    Gaussians::from_vectors(&vectors)
}

/// The rendering of `gaussians`, in 8 bits.
pub fn picture(gaussians: &Gaussians, camera: &Camera) -> RgbBuffer {
    let r = fuse_splat::render(gaussians, camera, [0.0; 3]).unwrap();
    let bytes = r.color.as_slice().iter().map(|p| p.map(|v| (v * 255.0).round() as u8)).collect();
    RgbBuffer::from_vec(camera.intrinsics.width, camera.intrinsics.height, bytes).unwrap()
}
