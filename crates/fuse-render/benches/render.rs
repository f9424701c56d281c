//! Stages of the renderer on a tabletop of twelve things and about 130,000 triangles, 640×480.
//! `RAYON_NUM_THREADS=1 cargo bench -p fuse-render` measures one thread.

#[path = "../tests/common/mod.rs"]
mod common;

use criterion::{Criterion, criterion_group, criterion_main};
use fuse_render::{RenderOptions, Renderer};

fn benches(c: &mut Criterion) {
    let scene = common::tabletop(12, 156);
    let triangles: usize = scene.instances.iter().map(|i| i.model.triangle_count()).sum();
    let full = RenderOptions::default();
    let plain = RenderOptions { shadows: false, ambient_occlusion: false, ..full.clone() };
    let (eye, target) = ([-0.2, -0.85, 1.4], [0.0, 0.0, 0.75]);
    let (large, small) = (common::camera(640, 480, eye, target), common::camera(320, 240, eye, target));
    let mut group = c.benchmark_group(format!("render/{}k triangles", triangles / 1000));
    group.sample_size(20);
    group.bench_function("prepare", |b| b.iter(|| Renderer::new(scene.clone(), &full).unwrap()));
    group.bench_function("prepare without shadow and occlusion", |b| {
        b.iter(|| Renderer::new(scene.clone(), &plain).unwrap());
    });
    let renderer = Renderer::new(scene.clone(), &full).unwrap();
    let unlit = Renderer::new(scene.clone(), &plain).unwrap();
    group.bench_function("colour, depth, ids 640x480", |b| b.iter(|| renderer.render(&large)));
    group.bench_function("the same without shadow and occlusion", |b| b.iter(|| unlit.render(&large)));
    group.bench_function("depth, ids 640x480", |b| b.iter(|| renderer.depth_ids(&large)));
    group.bench_function("amodal 320x240", |b| b.iter(|| renderer.amodal_all(&small)));
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
