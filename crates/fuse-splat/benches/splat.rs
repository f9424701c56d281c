//! The stages of one iteration at 640×480, for 5,000, 10,000 and 20,000 Gaussians on a synthetic
//! tabletop. `cargo bench -p fuse-splat`.

mod tabletop;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use fuse_splat::{Trainer, render};
use tabletop::{add_views, camera, config, stages, tabletop};

fn iteration(c: &mut Criterion) {
    let mut group = c.benchmark_group("splat");
    group.sample_size(20);
    for count in [5_000, 10_000, 20_000] {
        let gaussians = tabletop(count);
        let mut trainer = Trainer::new(gaussians.clone(), config()).expect("valid configuration");
        add_views(&mut trainer, &gaussians);
        // One line a stage, the fastest of 40 iterations: what criterion cannot see from outside.
        trainer.refine(3).expect("views are there");
        println!("{count} Gaussians, milliseconds: {}", stages(&mut trainer, 40));

        group.bench_with_input(BenchmarkId::new("iteration", count), &count, |b, _| {
            b.iter(|| trainer.refine(1).expect("views are there"));
        });
        let view = camera(0.3);
        group.bench_with_input(BenchmarkId::new("render", count), &count, |b, _| {
            b.iter(|| black_box(render(&gaussians, &view, [0.0; 3])));
        });
    }
    group.finish();
}

criterion_group!(benches, iteration);
criterion_main!(benches);
