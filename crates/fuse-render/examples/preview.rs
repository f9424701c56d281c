//! Renders a small tabletop to a PNG: `cargo run --release -p fuse-render --example preview -- out.png [FRAMES]`;
//! the fastest of FRAMES renderings is timed.

#[path = "../tests/common/mod.rs"]
mod common;

use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).unwrap_or_else(|| "preview.png".into());
    let start = Instant::now();
    let renderer = fuse_render::Renderer::new(common::tabletop(15, 88), &fuse_render::RenderOptions::default())?;
    println!("prepared in {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    let camera = common::camera(640, 480, [-0.2, -0.85, 1.4], [0.0, 0.0, 0.75]);
    let mut best = f64::INFINITY;
    let frames: usize = std::env::args().nth(2).map_or(Ok(8), |n| n.parse())?;
    for _ in 0..frames {
        let start = Instant::now();
        std::hint::black_box(renderer.render(&camera));
        best = best.min(start.elapsed().as_secs_f64() * 1e3);
    }
    let frame = renderer.render(&camera);
    println!("rendered in {best:.1} ms");
    let bytes = frame.rgb.as_slice().as_flattened().to_vec();
    image::RgbImage::from_raw(640, 480, bytes).ok_or("size")?.save(path)?;
    Ok(())
}
