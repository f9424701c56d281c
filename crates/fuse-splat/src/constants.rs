//! Constants of the method, once, with their reasons.

/// Floats of one Gaussian.
pub const PARAMETERS: usize = 59;
/// First row of the position (3 rows), metres.
pub const POSITION: usize = 0;
/// First row of the natural logarithm of the scale (3 rows).
pub const SCALE: usize = 3;
/// First row of the rotation quaternion w, x, y, z (4 rows, any length).
pub const ROTATION: usize = 6;
/// Row of the opacity's logit.
pub const OPACITY: usize = 10;
/// First row of the constant harmonic (3 rows: red, green, blue).
pub const DC: usize = 11;
/// First row of the other harmonics (45 rows: 15 of red, 15 of green, 15 of blue, as in the PLY).
pub const REST: usize = 14;
/// Harmonics beyond the constant one, per channel.
pub const REST_PER_CHANNEL: usize = 15;
/// Highest degree of the spherical harmonics.
pub const MAX_DEGREE: u32 = 3;

/// Nearer Gaussians are not drawn, metres (the original's frustum test).
pub const NEAR: f32 = 0.2;
/// Added to both variances of a projected Gaussian, square pixels: none is thinner than a pixel.
pub const LOW_PASS: f32 = 0.3;
/// The projection's Jacobian is evaluated at most this many times the half field of view from the
/// axis; beyond, splats at the side grow without bound.
pub const FOV_MARGIN: f32 = 1.3;
/// Opacity of one Gaussian at one pixel is at most this.
pub const ALPHA_MAX: f32 = 0.99;
/// log2 0.99, less a margin for rounding: a splat that is less opaque is clamped nowhere.
pub(crate) const LOG2_ALPHA_MAX: f32 = -0.0155;
/// Contributions below one grey level are skipped.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// log2 of [`ALPHA_MIN`].
pub const LOG2_ALPHA_MIN: f32 = -7.994_353_4;
/// A pixel is finished once less than this is left to see through.
pub const TRANSMITTANCE_MIN: f32 = 1e-4;

/// Tile width, pixels.
pub const TILE_WIDTH: usize = 32;
/// Tile height, pixels.
pub const TILE_HEIGHT: usize = 16;
/// Width of a block of eight pixels, one vector.
pub const BLOCK_WIDTH: usize = 4;
/// Height of a block.
pub const BLOCK_HEIGHT: usize = 2;
/// Blocks of a tile: one bit each in a 64-bit mask, row by row.
pub const TILE_BLOCKS: usize = (TILE_WIDTH / BLOCK_WIDTH) * (TILE_HEIGHT / BLOCK_HEIGHT);

/// Side of the SSIM window, pixels.
pub const SSIM_WINDOW: usize = 11;
/// Standard deviation of the SSIM window, pixels.
pub const SSIM_SIGMA: f64 = 1.5;
/// SSIM's C1 = (0.01)².
pub const SSIM_C1: f32 = 0.01 * 0.01;
/// SSIM's C2 = (0.03)².
pub const SSIM_C2: f32 = 0.03 * 0.03;

/// Adam's decay of the first moment.
pub const BETA1: f32 = 0.9;
/// Adam's decay of the second moment.
pub const BETA2: f32 = 0.999;
/// Adam's epsilon, the original's.
pub const ADAM_EPSILON: f32 = 1e-15;

/// The constant spherical harmonic, ½ √(1/π).
pub const SH_C0: f32 = 0.282_094_79;
