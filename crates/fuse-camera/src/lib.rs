//! What every other FUSE crate shares, and nothing more: a pinhole camera, its pose, image
//! buffers, the sensing actions and the SIMD level of the machine.
//!
//! Frames: the world is right-handed, z up, in metres. The camera is that of COLMAP and
//! OpenCV: x right, y down, z forward. Pixel `(i, j)` (column, row) covers
//! `[i, i + 1) × [j, j + 1)`, its centre is at `(i + 0.5, j + 0.5)`, as in COLMAP.

mod buffer;
#[cfg(feature = "gpu")]
pub mod gpu;
mod motion;
mod pinhole;
mod pose;
pub mod simd;

pub use buffer::{Buffer, BufferError, DepthBuffer, IdBuffer, RgbBuffer};
pub use motion::{ACTION_COUNT, Action};
pub use pinhole::{Pinhole, PinholeError};
pub use pose::Pose;

/// A camera: intrinsics and where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Focal lengths, principal point and image size, in pixels.
    pub intrinsics: Pinhole,
    /// Camera-from-world transform.
    pub pose: Pose,
}

impl Camera {
    /// Continuous image coordinates and depth (metres along the optical axis) of a world point;
    /// `None` when the point is not in front of the camera.
    pub fn project(&self, world: &nalgebra::Point3<f64>) -> Option<(f64, f64, f64)> {
        let p = self.pose.to_camera(world);
        self.intrinsics.project(&p).map(|(u, v)| (u, v, p.z))
    }

    /// World point seen at continuous image coordinates `(u, v)` at planar depth `z` (metres).
    pub fn unproject(&self, u: f64, v: f64, z: f64) -> nalgebra::Point3<f64> {
        self.pose.to_world(&self.intrinsics.unproject(u, v, z))
    }
}
