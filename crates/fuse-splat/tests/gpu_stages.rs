//! Every stage on the GPU against its CPU twin, from the same inputs.

mod scene;

use fuse_camera::RgbBuffer;
use fuse_camera::simd::best;
use fuse_splat::gpu::twins::{Iteration, Twins, iteration};
use fuse_splat::{Gaussians, Table};

const GROUPS: [(&str, std::ops::Range<usize>); 6] = [
    ("position", 0..3),
    ("scale", 3..6),
    ("rotation", 6..10),
    ("opacity", 10..11),
    ("f_dc", 11..14),
    ("f_rest", 14..59),
];

fn target(width: u32, height: u32) -> RgbBuffer {
    let pixels = (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            [(x * 7 + y * 3) as u8, 40 + ((x * 5 + y * 11) % 130) as u8, ((x * y) % 250) as u8]
        })
        .collect();
    RgbBuffer::from_vec(width, height, pixels).unwrap()
}

/// Learning rates; any will do.
fn rates() -> [f32; 59] {
    std::array::from_fn(|row| 1e-3 * (1 + row % 5) as f32)
}

/// ‖a − b‖ / ‖a‖.
fn relative(a: impl Iterator<Item = f32>, b: impl Iterator<Item = f32>) -> f64 {
    let (mut difference, mut size) = (0.0, 0.0);
    for (a, b) in a.zip(b) {
        difference += (f64::from(a) - f64::from(b)).powi(2);
        size += f64::from(a).powi(2);
    }
    assert!(size > 0.0, "nothing to compare");
    (difference / size).sqrt()
}

fn lists(twins: &Twins<Vec<f32>>) -> f64 {
    assert_eq!(twins.cpu.len(), twins.gpu.len());
    relative(twins.cpu.iter().copied(), twins.gpu.iter().copied())
}

/// `from` is taken off both sides first, so that a small step is not hidden by what it starts from.
fn assert_tables(what: &str, cpu: &Table, gpu: &Table, from: Option<&Table>) {
    assert_eq!(cpu.len(), gpu.len(), "{what}");
    for (name, rows) in GROUPS {
        let list = |t: &Table| -> Vec<f32> {
            let at = |(i, row)| t.get(i, row) - from.map_or(0.0, |from| from.get(i, row));
            (0..t.len()).flat_map(|i| rows.clone().map(move |row| (i, row))).map(at).collect()
        };
        let error = relative(list(cpu).into_iter(), list(gpu).into_iter());
        println!("  {what} {name:8} {error:.1e}");
        assert!(error < 1e-3, "{what}, {name}: relative error {error:.1e}");
    }
}

/// Pixels (all their channels) further apart than 2/255 are at most one in a thousand.
fn assert_planes(what: &str, twins: &Twins<Vec<f32>>, pixels: usize) {
    assert_eq!(twins.cpu.len(), twins.gpu.len(), "{what}");
    let far = |i: usize| {
        (i..twins.cpu.len()).step_by(pixels).any(|at| {
            let difference = (twins.cpu[at] - twins.gpu[at]).abs();
            difference.is_nan() || difference > 2.0 / 255.0
        })
    };
    let wrong = (0..pixels).filter(|&i| far(i)).count();
    println!("  {what}: {wrong} of {pixels} pixels differ, relative {:.1e}", lists(twins));
    assert!(wrong * 1000 <= pixels, "{what}: {wrong} of {pixels} pixels differ by more than 2/255");
}

fn check(before: &Table, result: &Iteration, pixels: usize) {
    for k in 0..13 {
        let visible = |t: &'_ [[f32; 16]]| -> Vec<f32> {
            let both = result.splats.cpu.iter().zip(&result.splats.gpu).zip(t);
            both.filter(|((a, b), _)| a[9] > 0.0 && b[9] > 0.0).map(|(_, t)| t[k]).collect()
        };
        let error = relative(visible(&result.splats.cpu).into_iter(), visible(&result.splats.gpu).into_iter());
        assert!(error < 1e-4, "project, number {k}: relative error {error:.1e}");
    }
    let seen = result.splats.cpu.iter().zip(&result.splats.gpu);
    let flips = seen.filter(|(a, b)| (a[9] > 0.0) != (b[9] > 0.0)).count();
    assert!(flips * 1000 <= result.splats.cpu.len(), "project: {flips} Gaussians are visible on one side only");

    assert_eq!(result.order.cpu, result.order.gpu, "sort");

    let (mut apart, mut pairs) = (0, 0);
    for (tile, (cpu, gpu)) in result.tiles.cpu.iter().zip(&result.tiles.gpu).enumerate() {
        pairs += cpu.len();
        // A span that ends at the border of a block may be rounded to either side.
        let both = |list: &[(u32, u64)], other: &[(u32, u64)]| -> Vec<u32> {
            list.iter().map(|p| p.0).filter(|g| other.iter().any(|o| o.0 == *g)).collect()
        };
        assert_eq!(both(cpu, gpu), both(gpu, cpu), "intersect: order in tile {tile}");
        apart += cpu.iter().filter(|p| !gpu.contains(p)).count() + gpu.iter().filter(|p| !cpu.contains(p)).count();
    }
    assert_eq!(result.tiles.cpu.len(), result.tiles.gpu.len());
    println!("  intersect: {apart} of {pairs} pairs differ");
    assert!(pairs > 0 && apart * 1000 <= pairs, "intersect: {apart} of {pairs} pairs differ");

    assert_planes("rasterize, colour", &result.color, pixels);
    assert_planes("rasterize, transmittance", &result.transmittance, pixels);
    assert_planes("rasterize, depth", &result.depth, pixels);

    let loss = &result.loss;
    assert!((loss.cpu - loss.gpu).abs() < 1e-5 * loss.cpu, "loss {} against {}", loss.gpu, loss.cpu);
    let error = lists(&result.image_gradient);
    println!("  loss: relative error of the gradient {error:.1e}");
    assert!(error < 1e-3, "loss: relative error of the gradient {error:.1e}");

    assert_eq!(result.pair_gradients.cpu.len(), result.pair_gradients.gpu.len());
    for k in 0..9 {
        let column = |list: &[[f32; 9]]| -> Vec<f32> { list.iter().map(|sums| sums[k]).collect() };
        let (cpu, gpu) = (column(&result.pair_gradients.cpu), column(&result.pair_gradients.gpu));
        let error = relative(cpu.into_iter(), gpu.into_iter());
        println!("  rasterize_backward, sum {k}: {error:.1e}");
        assert!(error < 1e-3, "rasterize_backward, sum {k}: relative error {error:.1e}");
    }

    assert_tables("project_backward", &result.gradient.cpu, &result.gradient.gpu, None);
    for (k, name) in ["gradient", "count", "radius"].into_iter().enumerate() {
        let density = &result.density;
        let error = relative(density.cpu[k].iter().copied(), density.gpu[k].iter().copied());
        assert!(error < 1e-3, "density, {name}: relative error {error:.1e}");
    }
    for (k, name) in ["parameters", "first moment", "second moment"].into_iter().enumerate() {
        let from = (k == 0).then_some(before);
        assert_tables(&format!("adam, {name}"), &result.stepped.cpu[k], &result.stepped.gpu[k], from);
    }
}

fn run(gaussians: &Gaussians, width: u32, height: u32, angle: f64) {
    let Some(device) = scene::gpu::device() else { return };
    println!("{} Gaussians, {width}x{height}", gaussians.len());
    let camera = scene::camera(width, height, angle);
    let image = target(width, height);
    let result = iteration(&device, best(), gaussians, &camera, &image, ([0.2, 0.5, 0.9], 0.2), &rates()).unwrap();
    check(gaussians.table(), &result, (width * height) as usize);
}

#[test]
fn a_few_large_ones() {
    run(&scene::cloud(300, 5, 0.35, [0.02, 0.12], [-2.0, 4.0]), 97, 61, 0.4);
}

/// Thin, fat, faint, opaque, behind the camera, at the image's border; several blocks of the sort.
#[test]
fn a_crowd() {
    run(&scene::cloud(2500, 3, 1.4, [0.002, 0.12], [-4.0, 5.0]), 159, 119, 2.0);
}

/// Blocks are finished long before the lists end.
#[test]
fn a_wall_of_opaque_ones() {
    run(&scene::cloud(1200, 9, 0.3, [0.05, 0.2], [3.0, 7.0]), 65, 33, 1.0);
}

/// Twice the same, so that depths are equal; more than one step of the scan takes.
#[test]
fn many_with_equal_depths() {
    let once = scene::cloud(3000, 7, 0.5, [0.003, 0.02], [-1.0, 4.0]);
    let vectors: Vec<[f32; 59]> = (0..6000).map(|i| once.vector(i % 3000)).collect();
    run(&Gaussians::from_vectors(&vectors), 111, 77, 3.0);
}

/// The list of tiles needs no sorting.
#[test]
fn a_single_tile() {
    run(&scene::cloud(200, 13, 0.3, [0.02, 0.1], [-1.0, 4.0]), 19, 11, 0.1);
}
