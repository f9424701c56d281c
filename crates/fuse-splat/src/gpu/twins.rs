//! Runs every stage on the GPU from what the CPU made of the stage before it, for the tests.

use fuse_camera::simd::Level;
use fuse_camera::{Camera, RgbBuffer};

use super::arrays::{SPLAT, SUMS, table_words};
use super::device::Device;
use super::engine::{step, table, truth};
use super::pipeline::Settings;
use super::render::load;
use crate::constants::{MAX_DEGREE, PARAMETERS};
use crate::cpu::adam::Step;
use crate::cpu::{Pipeline, project_backward};
use crate::render;
use crate::stages::{Splat, View};
use crate::surgery::Patient;
use crate::table::Table;
use crate::{Gaussians, SplatError};

/// What one stage left, on the CPU and on the GPU.
#[derive(Debug)]
pub struct Twins<T> {
    /// On the CPU.
    pub cpu: T,
    /// On the GPU.
    pub gpu: T,
}

/// All stages of one iteration.
#[derive(Debug)]
pub struct Iteration {
    /// Sixteen numbers a Gaussian.
    pub splats: Twins<Vec<[f32; SPLAT]>>,
    /// Visible Gaussians by depth.
    pub order: Twins<Vec<u32>>,
    /// (Gaussian, mask) of each tile, nearest first.
    pub tiles: Twins<Vec<Vec<(u32, u64)>>>,
    /// Planes.
    pub color: Twins<Vec<f32>>,
    /// A plane.
    pub transmittance: Twins<Vec<f32>>,
    /// A plane.
    pub depth: Twins<Vec<f32>>,
    /// The loss.
    pub loss: Twins<f64>,
    /// Planes.
    pub image_gradient: Twins<Vec<f32>>,
    /// Nine sums a pair, by tile, nearest first.
    pub pair_gradients: Twins<Vec<[f32; SUMS]>>,
    /// Derivatives of the parameters.
    pub gradient: Twins<Table>,
    /// Gradient sums, counts and radii.
    pub density: Twins<[Vec<f32>; 3]>,
    /// Parameters and moments after one step.
    pub stepped: Twins<[Table; 3]>,
}

/// Which step of Adam is taken.
const STEP: u32 = 7;

/// Some moments, as if steps had been taken before.
fn past(table: &Table) -> [Table; 2] {
    let moment = |of: fn(f32) -> f32| {
        let mut moment = Table::zeros(table.len());
        for (i, row) in (0..table.len()).flat_map(|i| (0..PARAMETERS).map(move |row| (i, row))) {
            moment.set(i, row, of(table.get(i, row)));
        }
        moment
    };
    [moment(|x| 1e-4 * x), moment(|x| 1e-7 * x * x + 1e-9)]
}

fn numbers(s: &Splat) -> [f32; SPLAT] {
    let [x, y] = s.mean;
    let [red, green, blue] = s.color;
    let [width, height] = s.extent;
    [x, y, s.a, s.b, s.c, s.log2_opacity, red, green, blue, s.depth, width, height, s.radius, 0.0, 0.0, 0.0]
}

/// Runs one iteration both ways.
///
/// # Errors
/// If image and camera differ in size, or the GPU fails.
pub fn iteration(
    device: &Device,
    level: Level,
    gaussians: &Gaussians,
    camera: &Camera,
    image: &RgbBuffer,
    settings: ([f32; 3], f32),
    rates: &[f32; PARAMETERS],
) -> Result<Iteration, SplatError> {
    let view = View::new(camera)?;
    let (background, lambda) = settings;
    let n = gaussians.len();

    // The CPU, all of it.
    let target = render::target(level, image, &view)?;
    let mut cpu = Pipeline::new(level);
    cpu.forward(&view, MAX_DEGREE, background, &gaussians.table, true);
    let loss = cpu.backward(&view, &target, lambda);
    let gradient = project_backward::gradient(level, cpu.gathered(&view, MAX_DEGREE), &gaussians.table);
    let mut patient = Patient::new(gaussians.table.clone());
    patient.moments = past(&gaussians.table);
    let Patient { parameters, moments, density } = &mut patient;
    let gathered = cpu.gathered(&view, MAX_DEGREE);
    project_backward::step(level, gathered, &Step::new(rates, STEP, MAX_DEGREE), parameters, moments, density);
    let cpu_splats: Vec<_> = cpu.splats.iter().map(numbers).collect();
    let cpu_tiles = tiles_of_cpu(&cpu, &view);

    // The GPU, a stage at a time.
    let gpu = &device.gpu;
    let settings = Settings { degree: MAX_DEGREE, background, lambda, slot: 0 };
    let mut p = load(device, gaussians, &view, &settings)?;
    let [first, second] = past(&gaussians.table);
    p.arrays.first.write(gpu, first.numbers())?;
    p.arrays.second.write(gpu, second.numbers())?;
    p.arrays.rates.write(gpu, &step(rates, STEP))?;
    let truth = truth(device, image)?;

    let mut encoder = p.encoder();
    p.project(&mut encoder);
    let splats: Vec<f32> = p.read(encoder, |a| &a.splats, n * SPLAT)?;

    p.arrays.splats.write(gpu, &cpu_splats)?;
    let mut encoder = p.encoder();
    p.sort(&mut encoder)?;
    let mut order: Vec<u32> = p.read(encoder, |a| &a.depths[0][1], n)?;
    // The invisible come last.
    order.truncate(cpu.order.len());

    let mut encoder = p.encoder();
    p.count_tiles(&mut encoder);
    let pairs = p.total_pairs(encoder)?;
    p.set_pairs(pairs)?;
    let mut encoder = p.encoder();
    p.sort_tiles(&mut encoder)?;
    p.submit(encoder);
    let (gpu_tiles, sorted) = tiles_of_gpu(&mut p, &view, pairs)?;

    let mut encoder = p.encoder();
    p.rasterize(&mut encoder);
    let pixels = view.pixels();
    let color: Vec<f32> = p.read(encoder, |a| &a.color, 3 * pixels)?;
    let transmittance: Vec<f32> = p.read(p.encoder(), |a| &a.transmittance, pixels)?;
    let depth: Vec<f32> = p.read(p.encoder(), |a| &a.depth, pixels)?;

    p.arrays.color.write(gpu, &cpu.image.color)?;
    p.arrays.losses.resize(gpu, 1)?;
    let mut encoder = p.encoder();
    p.loss(&mut encoder, &truth);
    let image_gradient: Vec<f32> = p.read(encoder, |a| &a.image_gradient, 3 * pixels)?;
    let gpu_loss: Vec<f32> = p.read(p.encoder(), |a| &a.losses, 1)?;

    p.arrays.image_gradient.write(gpu, &cpu.image_gradient)?;
    let mut encoder = p.encoder();
    p.rasterize_backward(&mut encoder);
    let unsorted: Vec<f32> = p.read(encoder, |a| &a.pair_gradients, pairs * SUMS)?;
    let unsorted = unsorted.as_chunks::<SUMS>().0;
    let pair_gradients = sorted.iter().map(|&i| unsorted[i as usize]).collect();

    if sorted.len() == cpu.pair_gradients.len() {
        let mut place = vec![[0.0; SUMS]; pairs];
        for (&i, sums) in sorted.iter().zip(&cpu.pair_gradients) {
            place[i as usize] = *sums;
        }
        p.arrays.pair_gradients.write(gpu, &place)?;
    }
    let mut encoder = p.encoder();
    p.project_backward(&mut encoder);
    let gpu_gradient: Vec<f32> = p.read(encoder, |a| &a.gradient, table_words(n))?;
    let gpu_density: Vec<f32> = p.read(p.encoder(), |a| &a.density, 3 * n)?;

    p.arrays.gradient.write(gpu, gradient.numbers())?;
    let mut encoder = p.encoder();
    p.adam(&mut encoder);
    let stepped: Vec<f32> = p.read(encoder, |a| &a.table, table_words(n))?;
    let first: Vec<f32> = p.read(p.encoder(), |a| &a.first, table_words(n))?;
    let second: Vec<f32> = p.read(p.encoder(), |a| &a.second, table_words(n))?;

    let Patient { parameters, moments: [m, v], density } = patient;
    let three = |words: &[f32]| [0, 1, 2].map(|k| words[k * n..(k + 1) * n].to_vec());
    Ok(Iteration {
        splats: Twins { cpu: cpu_splats, gpu: splats.as_chunks().0.to_vec() },
        order: Twins { cpu: cpu.order, gpu: order },
        tiles: Twins { cpu: cpu_tiles, gpu: gpu_tiles },
        color: Twins { cpu: cpu.image.color, gpu: color },
        transmittance: Twins { cpu: cpu.image.transmittance, gpu: transmittance },
        depth: Twins { cpu: cpu.image.depth, gpu: depth },
        loss: Twins { cpu: loss, gpu: f64::from(gpu_loss[0]) },
        image_gradient: Twins { cpu: cpu.image_gradient, gpu: image_gradient },
        pair_gradients: Twins { cpu: cpu.pair_gradients, gpu: pair_gradients },
        gradient: Twins { cpu: gradient, gpu: table(&gpu_gradient, n) },
        density: Twins { cpu: [density.gradient, density.count, density.radius], gpu: three(&gpu_density) },
        stepped: Twins { cpu: [parameters, m, v], gpu: [table(&stepped, n), table(&first, n), table(&second, n)] },
    })
}

/// The pairs with the masks that `intersect` made; `rasterize` has cut those in `pairs` since.
fn tiles_of_cpu(cpu: &Pipeline, view: &View) -> Vec<Vec<(u32, u64)>> {
    let mut masks = vec![0; cpu.pairs.gaussian.len()];
    for entry in cpu.chunks.iter().flat_map(|c| &c.entries) {
        masks[entry.slot as usize] = entry.mask;
    }
    let offsets = &cpu.pairs.offsets[..=view.tiles_x() * view.tiles_y()];
    let list =
        |range: &[u32]| (range[0] as usize..range[1] as usize).map(|i| (cpu.pairs.gaussian[i], masks[i])).collect();
    offsets.windows(2).map(list).collect()
}

type Lists = Vec<Vec<(u32, u64)>>;

/// The pairs by tile, and the sorted list of their places in the unsorted one.
fn tiles_of_gpu(p: &mut super::pipeline::Pipeline, view: &View, pairs: usize) -> Result<(Lists, Vec<u32>), SplatError> {
    let tiles = view.tiles_x() * view.tiles_y();
    let offsets: Vec<u32> = p.read(p.encoder(), |a| &a.offsets, tiles + 1)?;
    let which = p.sorted_index();
    let sorted: Vec<u32> = p.read(p.encoder(), |a| &a.tiles[which][1], pairs)?;
    let lists: Vec<[u32; 4]> = {
        let words: Vec<u32> = p.read(p.encoder(), |a| &a.pairs, pairs * 4)?;
        words.as_chunks().0.to_vec()
    };
    let pair = |i: usize| {
        let [gaussian, low, high, _] = lists[sorted[i] as usize];
        (gaussian, u64::from(low) | u64::from(high) << 32)
    };
    let out = offsets.windows(2).map(|o| (o[0] as usize..o[1] as usize).map(pair).collect()).collect();
    Ok((out, sorted))
}
