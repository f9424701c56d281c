//! Observations of a tabletop scene: colour, exact metric depth and instance ids, on the CPU,
//! bit-identical for any number of threads.

mod model;

pub use model::{Material, Mesh, Model, ModelError, Texture};
