//! What the sensor adds to a frame of 640×480, by stage. `RAYON_NUM_THREADS=1` measures one thread.

#[path = "../tests/common/mod.rs"]
mod common;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use fuse_render::{RenderOptions, Renderer, Sensor};

fn benches(c: &mut Criterion) {
    let renderer = Renderer::new(common::tabletop(12, 24), &RenderOptions::default()).unwrap();
    let frame = renderer.render(&common::camera(640, 480, [-0.2, -0.85, 1.4], [0.0, 0.0, 0.75]));
    let color = Sensor { shot_noise: 0.01, read_noise: 0.002, ..Sensor::default() };
    let depth = Sensor {
        depth_noise_m: 0.001,
        depth_noise_per_m: 0.002,
        depth_edge_dropout: 0.5,
        depth_step_per_m: 0.00285,
        ..Sensor::default()
    };
    let blur = Sensor { defocus_px: 4.0, motion_px: 6.0, motion_deg: 20.0, ..Sensor::default() };
    let all = Sensor { defocus_px: 4.0, motion_px: 6.0, motion_deg: 20.0, ..color.clone() };
    let all = Sensor { depth_noise_m: 0.001, depth_step_per_m: 0.00285, ..all };
    let both = Sensor { shot_noise: 0.01, read_noise: 0.002, ..depth.clone() };
    let mut group = c.benchmark_group("sensor/640x480");
    group.sample_size(20);
    let stages = [("off", Sensor::default()), ("colour noise", color), ("depth noise", depth), ("both noises", both)];
    for (name, sensor) in stages.into_iter().chain([("defocus 4, motion 6", blur), ("everything", all)]) {
        group.bench_function(name, |b| {
            b.iter_batched_ref(|| frame.clone(), |frame| sensor.expose(frame, 1), BatchSize::LargeInput);
        });
    }
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
