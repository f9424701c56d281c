//! FUSE for Rust users: one name for the crates that do the work.
//!
//! | module | holds |
//! | --- | --- |
//! | [`camera`] | pinhole camera, pose, image buffers, SIMD level |
//! | [`render`] | glTF/OBJ loading and the tabletop observation renderer |
//! | [`splat`] | 3D Gaussian model, rasteriser, incremental trainer |
//! | [`evidence`] | SSNR, semantic map, action scores, gate, stopping rule |
//! | [`env`] | objects, scenes, placement, viewpoints, episodes |

pub use fuse_camera as camera;
pub use fuse_env as env;
pub use fuse_evidence as evidence;
pub use fuse_render as render;
pub use fuse_splat as splat;
