//! SSNR at 640×480 on one and on two threads.

use criterion::{Criterion, criterion_group, criterion_main};
use fuse_evidence::View;
use fuse_evidence::ssnr::{Rendered, geometric_uncertainty};

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

/// A picture with structure at many scales, shifted by `shift` pixels.
fn picture(shift: u32) -> Vec<[u8; 3]> {
    let pixel = |x: u32, y: u32| {
        let (u, v) = ((x + shift) as f32, y as f32);
        let wave = (u * 0.05).sin() * (v * 0.03).cos() + 0.3 * (u * 0.7 + v * 0.9).sin();
        let level = (127.0 + 90.0 * wave) as u8;
        [level, level ^ 21, 255 - level]
    };
    (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| pixel(x, y))).collect()
}

fn bench(c: &mut Criterion) {
    let (observed, rendered) = (picture(0), picture(1));
    let floats: Vec<[f32; 3]> = rendered.iter().map(|p| p.map(|v| f32::from(v) / 255.0)).collect();
    let view = View::new("observed", WIDTH, HEIGHT, &observed).expect("sizes fit");
    let bytes = Rendered::U8(View::new("rendered", WIDTH, HEIGHT, &rendered).expect("sizes fit"));
    let quantized = Rendered::Quantized(View::new("rendered", WIDTH, HEIGHT, &floats).expect("sizes fit"));
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        let mut group = c.benchmark_group(format!("geometric_uncertainty/{threads}_threads"));
        for (name, rendered) in [("u8", bytes), ("f32_quantized", quantized)] {
            group.bench_function(name, |b| {
                pool.install(|| b.iter(|| geometric_uncertainty(view, Some(rendered), &Default::default())));
            });
        }
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(30).measurement_time(std::time::Duration::from_secs(2));
    targets = bench
}
criterion_main!(benches);
