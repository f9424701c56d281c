//! The arrays that the stages hand to one another; lengths in words.

use fuse_camera::gpu::Gpu;

use super::memory::Array;
use crate::SplatError;
use crate::constants::{PARAMETERS, TILE_BLOCKS};
use crate::stages::View;
use crate::table::LANES;

/// Words of a splat.
pub(super) const SPLAT: usize = 16;
/// Words of a pair.
pub(super) const PAIR: usize = 4;
/// Sums of a pair.
pub(super) const SUMS: usize = 9;
/// Keys of a workgroup of the sort.
pub(super) const SORT_BLOCK: usize = 1024;
/// Values of a digit of the sort.
const RADIX: usize = 16;
/// Side of a workgroup of the loss, pixels.
pub(super) const LOSS_SIDE: usize = 16;

macro_rules! arrays {
    ($($(#[$doc:meta])* $name:ident),* $(,)?) => {
        /// One field an array; `keys` and the like are two, from which to which sorting goes.
        #[derive(Debug)]
        pub(crate) struct Arrays {
            $($(#[$doc])* pub $name: Array,)*
            /// Keys and values of the sort by depth; the values end up as the order in `[0]`.
            pub depths: [[Array; 2]; 2],
            /// Keys and values of the sort by tile.
            pub tiles: [[Array; 2]; 2],
        }

        impl Arrays {
            pub fn new(gpu: &Gpu) -> Self {
                let sorted = |keys, values| [[Array::new(gpu, keys), Array::new(gpu, values)], [Array::new(gpu, keys), Array::new(gpu, values)]];
                Self {
                    $($name: Array::new(gpu, stringify!($name)),)*
                    depths: sorted("depths", "order"),
                    tiles: sorted("tiles", "pairs by tile"),
                }
            }
        }
    };
}
arrays! {
    /// Parameters, in blocks of eight, and Adam's moments.
    table,
    first,
    second,
    /// Derivatives of the parameters.
    gradient,
    /// Adam's rates and correction.
    rates,
    /// Statistics of densification.
    density,
    splats,
    /// Tiles of each rank, then places of its pairs.
    places,
    /// Pairs of each Gaussian.
    spans,
    /// Of a pass of the sort.
    histogram,
    pairs,
    /// Sorted pairs of each tile.
    offsets,
    pair_gradients,
    /// Image planes.
    color,
    transmittance,
    depth,
    image_gradient,
    /// Pairs that each block drew.
    drawn,
    /// Of SSIM.
    slopes,
    partials,
    losses,
}

/// Words of a table of `n` Gaussians.
pub(super) fn table_words(n: usize) -> usize {
    n.div_ceil(LANES) * LANES * PARAMETERS
}

impl Arrays {
    /// Room for `n` Gaussians. Parameters, moments and statistics are written by the caller.
    pub fn fit_gaussians(&mut self, gpu: &Gpu, n: usize) -> Result<(), SplatError> {
        // No binding may be empty.
        let n = n.max(1);
        self.gradient.resize(gpu, table_words(n))?;
        self.splats.resize(gpu, n * SPLAT)?;
        self.places.resize(gpu, n + 1)?;
        self.spans.resize(gpu, n * 2)?;
        for array in self.depths.as_flattened_mut() {
            array.resize(gpu, n)?;
        }
        Ok(())
    }

    pub fn fit_view(&mut self, gpu: &Gpu, view: &View) -> Result<(), SplatError> {
        let (n, tiles) = (view.pixels(), view.tiles_x() * view.tiles_y());
        let groups = view.width.div_ceil(LOSS_SIDE) * view.height.div_ceil(LOSS_SIDE) * 3;
        self.offsets.resize(gpu, tiles + 1)?;
        self.drawn.resize(gpu, tiles * TILE_BLOCKS)?;
        self.color.resize(gpu, 3 * n)?;
        self.transmittance.resize(gpu, n)?;
        self.depth.resize(gpu, n)?;
        self.image_gradient.resize(gpu, 3 * n)?;
        self.slopes.resize(gpu, 9 * n)?;
        self.partials.resize(gpu, 2 * groups)
    }

    pub fn fit_pairs(&mut self, gpu: &Gpu, pairs: usize) -> Result<(), SplatError> {
        let pairs = pairs.max(1);
        for array in self.tiles.as_flattened_mut() {
            array.resize(gpu, pairs)?;
        }
        self.pairs.resize(gpu, pairs * PAIR)?;
        self.pair_gradients.resize(gpu, pairs * SUMS)
    }

    /// For a sort of `keys` keys: counts of every block, and their total.
    pub fn fit_sort(&mut self, gpu: &Gpu, keys: usize) -> Result<(), SplatError> {
        self.histogram.resize(gpu, RADIX * keys.div_ceil(SORT_BLOCK) + 1)
    }
}
