//! The GPU twin beside the CPU in the same run, on the scene of `render.rs`.
//! `cargo bench -p fuse-render --features gpu --bench gpu`.
//!
//! Takes a real GPU where there is one, else (as the tests do) an emulated one: that says nothing
//! about GPUs.

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::Instant;

use fuse_camera::gpu::{Gpu, Software};
use fuse_render::gpu::{Device, GpuRenderer};
use fuse_render::{RenderOptions, Renderer};

/// Milliseconds that one of `runs` calls takes.
fn mean(runs: u32, mut call: impl FnMut()) -> f64 {
    call();
    let start = Instant::now();
    (0..runs).for_each(|_| call());
    start.elapsed().as_secs_f64() * 1e3 / f64::from(runs)
}

fn main() {
    let gpu = Gpu::open(Software::Allowed).expect("a Vulkan, Metal or Direct3D 12 adapter");
    let runs = if gpu.is_software() { 10 } else { 200 };
    println!("{}", gpu.name());
    let device = Device::new(gpu).expect("the stages compile");
    let scene = common::tabletop(15, 88);
    let triangles: usize = scene.instances.iter().map(|i| i.model.triangle_count()).sum();
    let camera = common::camera(640, 480, [-0.2, -0.85, 1.4], [0.0, 0.0, 0.75]);
    println!("{}k triangles, 640x480, milliseconds", triangles / 1000);
    let full = RenderOptions::default();
    let plain = RenderOptions { shadows: false, ambient_occlusion: false, ..full.clone() };
    for (what, options) in [("with shadow and occlusion", full), ("without", plain)] {
        let cpu = Renderer::new(scene.clone(), &options).expect("a sound scene");
        let gpu = GpuRenderer::new(scene.clone(), &options, &device).expect("a sound scene");
        let on_gpu = mean(runs, || {
            black_box(gpu.render(&camera)).expect("a frame");
        });
        let on_cpu = mean(runs, || {
            black_box(cpu.render(&camera));
        });
        println!("  colour, depth, ids {what}: gpu {on_gpu:.1}, cpu {on_cpu:.1}");
        let on_gpu = mean(runs, || {
            black_box(gpu.depth_ids(&camera)).expect("depth and ids");
        });
        let on_cpu = mean(runs, || {
            black_box(cpu.depth_ids(&camera));
        });
        println!("  depth, ids {what}: gpu {on_gpu:.1}, cpu {on_cpu:.1}");
    }
}
