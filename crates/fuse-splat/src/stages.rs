//! What the stages hand to one another. See `cpu.rs` for their order.

use fuse_camera::Camera;

use crate::SplatError;
use crate::constants::{LOW_PASS, TILE_HEIGHT, TILE_WIDTH};

/// A camera as the kernels want it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    pub width: usize,
    pub height: usize,
    pub fx: f32,
    pub fy: f32,
    pub cx: f32,
    pub cy: f32,
    /// Camera-from-world, rows.
    pub rotation: [[f32; 3]; 3],
    pub translation: [f32; 3],
    /// Camera centre in the world.
    pub center: [f32; 3],
    /// Added to the projected covariance's diagonal, square pixels.
    pub low_pass: f32,
}

impl View {
    /// # Errors
    /// If the image is larger than 4096 pixels a side.
    pub fn new(camera: &Camera) -> Result<Self, SplatError> {
        let k = &camera.intrinsics;
        if k.width > 4096 || k.height > 4096 {
            return Err(SplatError::Input(format!(
                "an image of at most 4096 pixels a side is rendered, found {}x{}",
                k.width, k.height
            )));
        }
        let r = camera.pose.rotation.to_rotation_matrix();
        let center = camera.pose.center();
        Ok(Self {
            width: k.width as usize,
            height: k.height as usize,
            fx: k.fx as f32,
            fy: k.fy as f32,
            cx: k.cx as f32,
            cy: k.cy as f32,
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)] as f32)),
            translation: std::array::from_fn(|i| camera.pose.translation[i] as f32),
            center: std::array::from_fn(|i| center[i] as f32),
            low_pass: LOW_PASS,
        })
    }

    /// The same camera with pixels twice as wide and high. `matched`: with the low-pass of the means
    /// of two by two pixels, which is their own and the variance of two neighbours, a quarter. (A
    /// wider splat would also be less opaque; opacity is left as it is.)
    pub fn halved(&self, matched: bool) -> Self {
        Self {
            width: self.width / 2,
            height: self.height / 2,
            fx: 0.5 * self.fx,
            fy: 0.5 * self.fy,
            cx: 0.5 * self.cx,
            cy: 0.5 * self.cy,
            low_pass: if matched { (self.low_pass + 0.25) / 4.0 } else { self.low_pass },
            ..*self
        }
    }

    pub fn tiles_x(&self) -> usize {
        self.width.div_ceil(TILE_WIDTH)
    }

    pub fn tiles_y(&self) -> usize {
        self.height.div_ceil(TILE_HEIGHT)
    }

    pub fn pixels(&self) -> usize {
        self.width * self.height
    }
}

/// A Gaussian on the image plane; 64 bytes, one cache line.
///
/// At offset (dx, dy) from its mean, α = 2^p, p = log2_opacity + a dx² + b dx dy + c dy².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Splat {
    pub mean: [f32; 2],
    pub a: f32,
    pub b: f32,
    pub c: f32,
    pub log2_opacity: f32,
    pub color: [f32; 3],
    /// Along the optical axis, metres; 0 for a Gaussian that is not visible.
    pub depth: f32,
    /// Half sides of the box around α ≥ 1/255, pixels.
    pub extent: [f32; 2],
    /// Three standard deviations along the longer axis, pixels.
    pub radius: f32,
}

/// One Gaussian on one tile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Entry {
    pub tile: u32,
    /// Where the pair lies in [`Pairs`].
    pub slot: u32,
    /// Blocks that the ellipse α ≥ 1/255 touches.
    pub mask: u64,
}

/// Gaussians by tile, nearest first.
#[derive(Debug, Default)]
pub(crate) struct Pairs {
    /// First pair of each tile, and one past the last.
    pub offsets: Vec<u32>,
    pub gaussian: Vec<u32>,
    /// After the forward pass: the blocks that it drew.
    pub mask: Vec<u64>,
}

/// Derivatives of the loss with respect to one Gaussian, summed over one tile:
/// red, green, blue, then with g = α dL/dα: Σ g, Σ g dx, Σ g dy, Σ g dx², Σ g dx dy, Σ g dy².
pub(crate) type PairGradient = [f32; 9];

/// Three planes, row-major, one after the other.
pub(crate) type Planes = Vec<f32>;

/// Bookkeeping for densification; one value a Gaussian.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Density {
    /// Sum of the lengths of the gradient of the projected position, normalised device units.
    pub gradient: Vec<f32>,
    /// Iterations in which the Gaussian was visible.
    pub count: Vec<f32>,
    /// Largest radius on an image, pixels.
    pub radius: Vec<f32>,
}

impl Density {
    pub fn zeros(len: usize) -> Self {
        Self { gradient: vec![0.0; len], count: vec![0.0; len], radius: vec![0.0; len] }
    }
}
