//! Analytic gradients of the fast path against central differences of the f64 reference.
//!
//! The reference applies the same cut-offs; steps are so small that no pixel crosses one, and both
//! sides differentiate the same smooth branch.

mod scene;

use fuse_camera::RgbBuffer;
use fuse_camera::simd::{Level, best};
use fuse_splat::{loss_gradient, reference};

const GROUPS: [(&str, std::ops::Range<usize>); 6] = [
    ("position", 0..3),
    ("scale", 3..6),
    ("rotation", 6..10),
    ("opacity", 10..11),
    ("f_dc", 11..14),
    ("f_rest", 14..59),
];
const LAMBDA: f64 = 0.2;
const STEP: f64 = 1e-7;

/// A target that nowhere equals the rendering, where L1 has a kink.
fn target(width: u32, height: u32) -> RgbBuffer {
    let pixels = (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            [200 + ((x * 7 + y * 3) % 40) as u8, 210 + ((x * 5 + y * 11) % 30) as u8, 190 + ((x * y) % 50) as u8]
        })
        .collect();
    RgbBuffer::from_vec(width, height, pixels).unwrap()
}

#[test]
fn every_parameter_group_agrees_with_finite_differences() {
    // Odd sizes: the last tile, block and vector are partial.
    let camera = scene::camera(37, 29, 0.4);
    let gaussians = scene::cloud(9, 5, 0.3, [0.03, 0.16], [-1.2, 0.6]);
    let image = target(37, 29);
    let vectors: Vec<[f64; 59]> = (0..gaussians.len()).map(|i| gaussians.vector(i).map(f64::from)).collect();
    let loss = |v: &[[f64; 59]]| reference::loss(&reference::render(v, &camera, 3, [0.0; 3]).color, &image, LAMBDA);

    let mut numeric = vec![[0.0; 59]; vectors.len()];
    for i in 0..vectors.len() {
        for row in 0..59 {
            let mut moved = vectors.clone();
            let side = |moved: &mut Vec<[f64; 59]>, step: f64| {
                moved[i][row] = vectors[i][row] + step;
                loss(moved)
            };
            numeric[i][row] = (side(&mut moved, STEP) - side(&mut moved, -STEP)) / (2.0 * STEP);
        }
    }
    for level in [Level::Portable, Level::Avx2Fma, best()] {
        let (fast, table) = loss_gradient(level, &gaussians, &camera, &image, 3, LAMBDA as f32).unwrap();
        assert!((fast - loss(&vectors)).abs() < 1e-5, "loss {fast} against {}", loss(&vectors));
        for (name, rows) in GROUPS {
            let (mut difference, mut size) = (0.0, 0.0);
            for (i, numeric) in numeric.iter().enumerate() {
                for row in rows.clone() {
                    let analytic = f64::from(table.get(i, row));
                    difference += (analytic - numeric[row]).powi(2);
                    size += numeric[row].powi(2);
                }
            }
            let relative = (difference / size).sqrt();
            println!("{:8} {name:8} relative error {relative:.1e}, norm {:.1e}", level.name(), size.sqrt());
            assert!(size.sqrt() > 1e-7, "{name}: the scene does not exercise it");
            assert!(relative < 2e-3, "{name} at level {}: relative error {relative:.2e}", level.name());
        }
    }
}
