//! The scene and the settings that the benches share.

use fuse_camera::{Camera, Pinhole, Pose, RgbBuffer};
use fuse_splat::{Gaussians, StageSeconds, Trainer, TrainerConfig, render};
use nalgebra::Point3;

/// A repeatable stream of numbers in [0, 1).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// A table top with things on it, seen from 1.1 m: flat Gaussians that cover the picture.
pub fn tabletop(count: usize) -> Gaussians {
    let mut r = Random(1);
    let spacing = (2.4 * 2.4 / count as f32).sqrt();
    let vectors: Vec<[f32; 59]> = (0..count)
        .map(|i| {
            let mut v = [0.0; 59];
            let on_object = i % 4 == 0;
            v[0] = (r.next() - 0.5) * if on_object { 0.8 } else { 2.4 };
            v[1] = (r.next() - 0.5) * if on_object { 0.8 } else { 2.4 };
            v[2] = if on_object { r.next() * 0.25 } else { 0.0 };
            for k in 0..3 {
                v[3 + k] = (spacing * (0.35 + 0.6 * r.next())).ln();
                v[6 + k] = r.next() - 0.5;
                v[11 + k] = (r.next() - 0.5) * 2.0;
            }
            v[5] -= 1.5;
            v[6] = 1.0;
            v[10] = r.next() * 5.0 - 1.0;
            v[14..].iter_mut().for_each(|c| *c = (r.next() - 0.5) * 0.1);
            v
        })
        .collect();
    Gaussians::from_vectors(&vectors)
}

pub fn camera(angle: f64) -> Camera {
    Camera {
        intrinsics: Pinhole::from_horizontal_fov(640, 480, 60f64.to_radians()).expect("valid intrinsics"),
        pose: Pose::look_at(Point3::new(0.85 * angle.cos(), 0.85 * angle.sin(), 0.7), Point3::origin()),
    }
}

/// Neither densifies nor resets, so that every iteration is alike.
pub fn config() -> TrainerConfig {
    TrainerConfig {
        densify_start: u32::MAX,
        opacity_reset_interval: u32::MAX,
        degree_interval: 1,
        ..Default::default()
    }
}

/// Four views to train on.
pub fn add_views(trainer: &mut Trainer, gaussians: &Gaussians) {
    for k in 0..4 {
        let camera = camera(f64::from(k) * 0.17);
        let image = render(gaussians, &camera, [0.0; 3]).expect("a small image");
        let bytes = image.color.as_slice().iter().map(|p| p.map(|v| (v * 200.0) as u8 + 20)).collect();
        let image = RgbBuffer::from_vec(640, 480, bytes).expect("640×480 pixels");
        trainer.add_view(&image, &camera).expect("image and camera agree");
    }
}

/// One line: the milliseconds of each stage, the fastest of `runs` iterations.
pub fn stages(trainer: &mut Trainer, runs: usize) -> String {
    let mut best = [f64::INFINITY; 7];
    for _ in 0..runs {
        let s: StageSeconds = trainer.refine(1).expect("views are there").stages;
        let now = [s.project, s.sort, s.intersect, s.rasterize, s.loss, s.rasterize_backward, s.project_backward];
        best.iter_mut().zip(now).for_each(|(b, n)| *b = b.min(n));
    }
    let names = ["project", "sort", "intersect", "rasterize", "loss", "rasterize_backward", "project_backward"];
    let stages: Vec<String> = names.iter().zip(best).map(|(n, s)| format!("{n} {:.2}", s * 1e3)).collect();
    stages.join(", ")
}
