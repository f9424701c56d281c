//! 3D Gaussian splatting on the CPU: the official model and training, tiled, parallel, in SIMD.
//!
//! [`Gaussians`] is the model, [`render()`] draws it, [`Trainer`] fits it to views that arrive one
//! by one. `cpu.rs` lists the stages of an iteration in their order; `reference.rs` is the slow,
//! obvious renderer in double precision that judges them in the tests.
//!
//! Quantities: metres, world right-handed with z up; camera x right, y down, z forward; colours
//! in [0, 1].

#![allow(clippy::needless_range_loop, reason = "kernels index fixed axes, to be read beside their formulas")]

mod bytes;
mod checkpoint;
mod config;
pub mod constants;
mod cpu;
pub mod data;
mod densify;
mod error;
mod files;
mod gaussians;
pub mod gpu;
mod nearest;
mod order;
mod ply;
mod quality;
#[doc(hidden)]
pub mod reference;
mod render;
mod schedule;
mod sh;
mod shot;
mod spz;
mod stages;
mod surgery;
mod table;
mod trainer;

pub use config::TrainerConfig;
pub use cpu::StageSeconds;
pub use densify::Changes;
pub use error::SplatError;
pub use gaussians::Gaussians;
pub use quality::{Quality, quality, ssim};
pub use render::{Rendering, loss_gradient, psnr, render, render_at};
pub use table::{Block, LANES, Table};
pub use trainer::{RefineStats, Trainer};
