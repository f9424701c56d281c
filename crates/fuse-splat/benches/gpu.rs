//! The stages of one iteration at 640×480 on the GPU, beside the CPU in the same run, on the scene
//! of `splat.rs`. `cargo bench -p fuse-splat --features gpu --bench gpu`.
//!
//! Takes a real GPU where there is one, else (as the tests do) an emulated one: that tells how the
//! stages compare with one another and nothing about GPUs.

mod tabletop;

use std::hint::black_box;
use std::time::Instant;

use fuse_camera::gpu::{Gpu, Software};
use fuse_splat::gpu::{self, Device};
use fuse_splat::{Gaussians, Trainer, render};
use tabletop::{add_views, camera, config, stages, tabletop};

/// Milliseconds that one of `runs` calls takes.
fn mean(runs: u32, mut call: impl FnMut(u32)) -> f64 {
    let start = Instant::now();
    call(runs);
    start.elapsed().as_secs_f64() * 1e3 / f64::from(runs)
}

fn line(what: &str, mut trainer: Trainer, gaussians: &Gaussians, runs: u32) -> Trainer {
    add_views(&mut trainer, gaussians);
    trainer.refine(2).expect("views are there");
    println!("  {what}, milliseconds: {}", stages(&mut trainer, runs as usize));
    trainer
}

fn main() {
    let gpu = Gpu::open(Software::Allowed).expect("a Vulkan, Metal or Direct3D 12 adapter");
    let (sizes, runs): (&[usize], u32) =
        if gpu.is_software() { (&[5_000, 20_000], 3) } else { (&[5_000, 20_000, 100_000], 100) };
    println!("{}", gpu.name());
    let device = Device::new(gpu).expect("the stages compile");
    for &count in sizes {
        println!("{count} Gaussians");
        let gaussians = tabletop(count);
        let new = |device: &Device| Trainer::with_device(device, gaussians.clone(), config()).expect("valid");
        line("gpu", new(&device.clone().timed()), &gaussians, runs);
        let cpu = Trainer::new(gaussians.clone(), config()).expect("valid configuration");
        let mut cpu = line("cpu", cpu, &gaussians, runs);
        let mut fast = new(&device);
        add_views(&mut fast, &gaussians);
        fast.refine(2).expect("views are there");
        let iterate = |trainer: &mut Trainer| {
            mean(runs, |n| {
                trainer.refine(n).expect("views are there");
            })
        };
        println!("  iteration, milliseconds: gpu {:.2}, cpu {:.2}", iterate(&mut fast), iterate(&mut cpu));
        let view = camera(0.3);
        let on_gpu = mean(runs, |n| {
            for _ in 0..n {
                black_box(gpu::render(&device, &gaussians, &view, [0.0; 3])).expect("a small image");
            }
        });
        let on_cpu = mean(runs, |n| {
            for _ in 0..n {
                black_box(render(&gaussians, &view, [0.0; 3])).expect("a small image");
            }
        });
        println!("  render, milliseconds: gpu {on_gpu:.2}, cpu {on_cpu:.2}");
    }
}
