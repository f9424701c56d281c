//! Every stage as it is recorded for the GPU: kernels, bindings by number, workgroups.

use fuse_camera::gpu::GpuError;
use wgpu::{BindingResource, ComputePipeline};

use super::arrays::{LOSS_SIDE, SORT_BLOCK};
use super::memory::Array;
use super::pipeline::Pipeline;
use crate::SplatError;
use crate::constants::PARAMETERS;

/// Threads of a workgroup, one a Gaussian or a pair.
const THREADS: usize = 256;
/// Workgroups along one axis, WebGPU's limit.
const GROUPS_MAX: usize = 65_535;
/// Bits that a pass of the sort takes, and passes over the 32 bits of a depth.
pub(super) const SORT_BITS: u32 = 4;
pub(super) const DEPTH_PASSES: u32 = 32 / SORT_BITS;

type Groups = [usize; 3];

impl Pipeline {
    fn run(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        kernel: &ComputePipeline,
        bindings: &[(u32, BindingResource<'_>)],
        groups: Groups,
    ) {
        let entries: Vec<_> = bindings
            .iter()
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding: *binding, resource: resource.clone() })
            .collect();
        let group = self.device.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &kernel.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(kernel);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(groups[0] as u32, groups[1] as u32, groups[2] as u32);
    }

    fn frame(&self) -> BindingResource<'_> {
        self.frame_buffer.as_entire_binding()
    }

    pub fn project(&self, encoder: &mut wgpu::CommandEncoder) {
        let a = &self.arrays;
        let bindings = [(0, self.frame()), (1, a.table.binding()), (2, a.splats.binding())];
        self.run(encoder, &self.device.kernels.project, &bindings, each(self.gaussians()));
    }

    fn scan(&self, encoder: &mut wgpu::CommandEncoder, numbers: &Array) {
        self.run(encoder, &self.device.kernels.scan, &[(0, numbers.binding())], [1, 1, 1]);
    }

    /// One sort of (keys, values) by the lowest `passes` digits; the result is in
    /// `lists[passes % 2]`.
    fn radix(&self, encoder: &mut wgpu::CommandEncoder, lists: &[[Array; 2]; 2], length: usize, passes: u32) {
        let kernels = &self.device.kernels;
        let groups = [length.div_ceil(SORT_BLOCK), 1, 1];
        let histogram = &self.arrays.histogram;
        for (pass, shift) in self.shifts.iter().take(passes as usize).enumerate() {
            let [[keys, values], [keys_out, values_out]] =
                if pass % 2 == 0 { [&lists[0], &lists[1]] } else { [&lists[1], &lists[0]] };
            let shift = (2, shift.as_entire_binding());
            let keys = (3, keys.binding());
            let histogram_binding = (5, histogram.binding());
            self.run(encoder, &kernels.sort_count, &[shift.clone(), keys.clone(), histogram_binding.clone()], groups);
            self.scan(encoder, histogram);
            let outputs = [(6, keys_out.binding()), (7, values_out.binding())];
            let [six, seven] = outputs;
            let bindings = [shift, keys, (4, values.binding()), histogram_binding, six, seven];
            self.run(encoder, &kernels.sort_scatter, &bindings, groups);
        }
    }

    /// Gaussians by depth, into `depths[0]`.
    pub fn sort(&mut self, encoder: &mut wgpu::CommandEncoder) -> Result<(), SplatError> {
        self.arrays.fit_sort(&self.device.gpu, self.gaussians())?;
        let a = &self.arrays;
        let [keys, values] = &a.depths[0];
        let bindings = [(0, self.frame()), (1, a.splats.binding()), (3, keys.binding()), (4, values.binding())];
        self.run(encoder, &self.device.kernels.depth_keys, &bindings, each(self.gaussians()));
        self.radix(encoder, &a.depths, self.gaussians(), DEPTH_PASSES);
        Ok(())
    }

    /// What `count` and `emit` share; `count` names the lists of pairs but does not write to them.
    fn intersect_bindings(&self) -> Vec<(u32, BindingResource<'_>)> {
        let a = &self.arrays;
        let [_, order] = &a.depths[0];
        let [tiles, indices] = &a.tiles[0];
        vec![
            (0, self.frame()),
            (1, a.splats.binding()),
            (2, order.binding()),
            (3, a.places.binding()),
            (4, tiles.binding()),
            (5, indices.binding()),
            (6, a.pairs.binding()),
        ]
    }

    /// First pair of each rank.
    pub fn count_tiles(&self, encoder: &mut wgpu::CommandEncoder) {
        let kernel = &self.device.kernels.intersect_count;
        self.run(encoder, kernel, &self.intersect_bindings(), each(self.gaussians()));
        self.scan(encoder, &self.arrays.places);
    }

    /// Waits for the number of pairs.
    pub fn total_pairs(&mut self, encoder: wgpu::CommandEncoder) -> Result<usize, SplatError> {
        let n = self.gaussians();
        let total: Vec<u32> = self.arrays.places.read(&self.device.gpu, encoder, n..n + 1, &mut self.landing)?;
        Ok(total.first().map_or(0, |&t| t as usize))
    }

    pub fn set_pairs(&mut self, pairs: usize) -> Result<(), SplatError> {
        if pairs > THREADS * GROUPS_MAX {
            let (needed, allowed) = (4 * pairs as u64, 4 * (THREADS * GROUPS_MAX) as u64);
            return Err(GpuError::TooLarge { what: "the list of tiles".into(), needed, allowed }.into());
        }
        self.arrays.fit_pairs(&self.device.gpu, pairs)?;
        self.frame.pairs = pairs as u32;
        self.write_frame();
        Ok(())
    }

    /// Passes of the sort by tile.
    fn tile_passes(&self) -> u32 {
        let last = self.frame.tiles[0] * self.frame.tiles[1] - 1;
        (u32::BITS - last.leading_zeros()).div_ceil(SORT_BITS)
    }

    /// Which of `arrays.tiles` is sorted.
    pub fn sorted_index(&self) -> usize {
        self.tile_passes() as usize % 2
    }

    /// Pairs by tile, their indices in the unsorted list.
    fn sorted(&self) -> BindingResource<'_> {
        self.arrays.tiles[self.sorted_index()][1].binding()
    }

    /// Writes the pairs and sorts them by tile.
    pub fn sort_tiles(&mut self, encoder: &mut wgpu::CommandEncoder) -> Result<(), SplatError> {
        let pairs = self.frame.pairs as usize;
        if pairs == 0 {
            self.arrays.offsets.clear(encoder);
            self.arrays.spans.clear(encoder);
            return Ok(());
        }
        self.arrays.fit_sort(&self.device.gpu, pairs)?;
        let a = &self.arrays;
        let mut bindings = self.intersect_bindings();
        bindings.push((7, a.spans.binding()));
        self.run(encoder, &self.device.kernels.intersect_emit, &bindings, each(self.gaussians()));
        let passes = self.tile_passes();
        self.radix(encoder, &a.tiles, pairs, passes);
        let [tiles, _] = &a.tiles[self.sorted_index()];
        let bindings = [(0, self.frame()), (4, tiles.binding()), (8, a.offsets.binding())];
        self.run(encoder, &self.device.kernels.intersect_ranges, &bindings, each(pairs));
        Ok(())
    }

    fn tile_grid(&self) -> Groups {
        [self.frame.tiles[0] as usize, self.frame.tiles[1] as usize, 1]
    }

    pub fn rasterize(&self, encoder: &mut wgpu::CommandEncoder) {
        let a = &self.arrays;
        let bindings = [
            (0, self.frame()),
            (1, a.splats.binding()),
            (2, self.sorted()),
            (3, a.pairs.binding()),
            (4, a.offsets.binding()),
            (5, a.color.binding()),
            (6, a.transmittance.binding()),
            (7, a.depth.binding()),
            (8, a.drawn.binding()),
        ];
        self.run(encoder, &self.device.kernels.rasterize, &bindings, self.tile_grid());
    }

    pub fn loss(&self, encoder: &mut wgpu::CommandEncoder, truth: &Array) {
        let (a, kernels) = (&self.arrays, &self.device.kernels);
        let [width, height] = self.frame.size.map(|s| (s as usize).div_ceil(LOSS_SIDE));
        let frame = (0, self.frame());
        let (image, truth) = ((1, a.color.binding()), (2, truth.binding()));
        let (slopes, partials) = ((3, a.slopes.binding()), (5, a.partials.binding()));
        let bindings = [frame.clone(), image.clone(), truth.clone(), slopes.clone(), partials.clone()];
        self.run(encoder, &kernels.loss_slopes, &bindings, [width, height, 3]);
        let bindings = [frame.clone(), image, truth, slopes, (4, a.image_gradient.binding()), partials.clone()];
        self.run(encoder, &kernels.loss_gradient, &bindings, [width, height, 3]);
        self.run(encoder, &kernels.loss_total, &[frame, partials, (6, a.losses.binding())], [1, 1, 1]);
    }

    pub fn rasterize_backward(&self, encoder: &mut wgpu::CommandEncoder) {
        let a = &self.arrays;
        let bindings = [
            (0, self.frame()),
            (1, a.splats.binding()),
            (2, self.sorted()),
            (3, a.pairs.binding()),
            (4, a.offsets.binding()),
            (5, a.drawn.binding()),
            (6, a.color.binding()),
            (7, a.image_gradient.binding()),
            (8, a.pair_gradients.binding()),
        ];
        self.run(encoder, &self.device.kernels.rasterize_backward, &bindings, self.tile_grid());
    }

    pub fn project_backward(&self, encoder: &mut wgpu::CommandEncoder) {
        let a = &self.arrays;
        let bindings = [
            (0, self.frame()),
            (1, a.table.binding()),
            (2, a.splats.binding()),
            (3, a.spans.binding()),
            (4, a.pair_gradients.binding()),
            (5, a.gradient.binding()),
            (6, a.density.binding()),
        ];
        self.run(encoder, &self.device.kernels.project_backward, &bindings, each(self.gaussians()));
    }

    pub fn adam(&self, encoder: &mut wgpu::CommandEncoder) {
        let a = &self.arrays;
        let bindings = [
            (0, self.frame()),
            (1, a.gradient.binding()),
            (2, a.table.binding()),
            (3, a.first.binding()),
            (4, a.second.binding()),
            (5, a.rates.binding()),
        ];
        let [groups, ..] = each(self.gaussians());
        self.run(encoder, &self.device.kernels.adam, &bindings, [groups, PARAMETERS, 1]);
    }
}

/// A thread for each of `n`.
fn each(n: usize) -> Groups {
    [n.div_ceil(THREADS), 1, 1]
}
