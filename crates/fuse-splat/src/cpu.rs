//! The CPU backend: stages in the order in which an iteration runs them.
//!
//! | stage | makes |
//! | --- | --- |
//! | `project` | splats: Gaussians on the image plane |
//! | `sort` | visible splats by depth |
//! | `intersect` | pairs of splat and tile, with masks of blocks |
//! | `rasterize` | the image |
//! | `loss` | the loss and its gradient with respect to the image |
//! | `rasterize_backward` | nine sums a pair |
//! | `project_backward`, `adam` | the gradient of the parameters, and the step, fused |
//!
//! Every stage is bit-identical for any number of threads at one SIMD level: tasks are cut by
//! fixed sizes, own what they write, and sums are taken in a fixed order.

pub(crate) mod adam;
pub(crate) mod intersect;
pub(crate) mod loss;
pub(crate) mod project;
pub(crate) mod project_backward;
pub(crate) mod rasterize;
pub(crate) mod rasterize_backward;
pub(crate) mod sort;

use std::time::Instant;

use fuse_camera::simd::Level;

use crate::stages::{PairGradient, Pairs, Splat, View};
use crate::table::Table;
use intersect::Chunk;
use loss::Target;
use project_backward::Gathered;
use rasterize::Image;
use sort::DepthSort;

/// Seconds spent in each stage, summed over iterations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageSeconds {
    /// Projection and harmonics.
    pub project: f64,
    /// Depth sort.
    pub sort: f64,
    /// Lists of tiles.
    pub intersect: f64,
    /// Blending.
    pub rasterize: f64,
    /// Loss and its gradient.
    pub loss: f64,
    /// Gradient of the blending.
    pub rasterize_backward: f64,
    /// Gradient of the projection, with Adam.
    pub project_backward: f64,
    /// Densification and resets.
    pub densify: f64,
}

/// Buffers of all stages, kept between iterations.
#[derive(Debug, Default)]
pub(crate) struct Pipeline {
    pub level: Level,
    pub splats: Vec<Splat>,
    pub order: Vec<u32>,
    sort: DepthSort,
    pub chunks: Vec<Chunk>,
    pub pairs: Pairs,
    pub image: Image,
    pub image_gradient: Vec<f32>,
    pub pair_gradients: Vec<PairGradient>,
    pub seconds: StageSeconds,
}

/// Adds the time since `from` to `to` and starts anew.
pub(crate) fn lap(from: &mut Instant, to: &mut f64) {
    let now = Instant::now();
    *to += (now - *from).as_secs_f64();
    *from = now;
}

impl Pipeline {
    pub fn new(level: Level) -> Self {
        Self { level, ..Self::default() }
    }

    /// Draws the image.
    pub fn forward(&mut self, view: &View, degree: u32, background: [f32; 3], table: &Table, with_depth: bool) {
        let mut clock = Instant::now();
        project::project(self.level, view, degree, table, &mut self.splats);
        lap(&mut clock, &mut self.seconds.project);
        self.sort.sort(&self.splats, &mut self.order);
        lap(&mut clock, &mut self.seconds.sort);
        intersect::intersect(self.level, view, &self.splats, &self.order, &mut self.chunks, &mut self.pairs);
        lap(&mut clock, &mut self.seconds.intersect);
        rasterize::rasterize(self.level, view, background, &self.splats, &mut self.pairs, with_depth, &mut self.image);
        lap(&mut clock, &mut self.seconds.rasterize);
    }

    /// The loss of the drawn image; fills the gradient of the image and of the pairs.
    pub fn backward(&mut self, view: &View, target: &Target, lambda: f32) -> f64 {
        let mut clock = Instant::now();
        let loss = loss::loss(self.level, &self.image.color, target, lambda, &mut self.image_gradient);
        lap(&mut clock, &mut self.seconds.loss);
        rasterize_backward::rasterize_backward(
            self.level,
            view,
            &self.splats,
            &self.pairs,
            &self.image.color,
            &self.image_gradient,
            &mut self.pair_gradients,
        );
        lap(&mut clock, &mut self.seconds.rasterize_backward);
        loss
    }

    /// What the projection's backward pass gathers from.
    pub fn gathered<'a>(&'a self, view: &'a View, degree: u32) -> Gathered<'a> {
        Gathered { view, degree, splats: &self.splats, chunks: &self.chunks, gradients: &self.pair_gradients }
    }
}
