//! Coverage of a thing as if it stood alone.

use fuse_camera::simd::{self, F32x8, Kernel};

use super::raster::{BLOCK, LANES, Planes, columns, inside};
use super::transform::{Setup, View};

/// Which pixel centres of an image a set of triangles covers: one bit a pixel.
pub(super) struct Mask {
    bytes_per_row: usize,
    bits: Vec<u8>,
    max_inverse_depth: f32,
}

impl Mask {
    pub fn new(view: &View) -> Self {
        let bytes_per_row = (view.width as usize).div_ceil(LANES);
        Self {
            bytes_per_row,
            bits: vec![0; bytes_per_row * view.height as usize],
            max_inverse_depth: (1.0 / view.near) as f32,
        }
    }

    /// Draws triangles.
    pub fn draw<'a>(&mut self, setups: impl Iterator<Item = &'a Setup>) {
        simd::dispatch(simd::level(), Cover { mask: self, setups });
    }

    /// Number of covered pixels.
    pub fn count(&self) -> u32 {
        self.bits.iter().map(|b| b.count_ones()).sum()
    }
}

struct Cover<'a, I> {
    mask: &'a mut Mask,
    setups: I,
}

impl<'s, I: Iterator<Item = &'s Setup>> Kernel for Cover<'_, I> {
    type Output = ();

    #[inline(always)]
    fn run<V: F32x8>(self) {
        for setup in self.setups {
            mask::<V>(self.mask, setup);
        }
    }
}

#[inline(always)]
fn mask<V: F32x8>(mask: &mut Mask, setup: &Setup) {
    let limit = V::splat(mask.max_inverse_depth);
    let (x0, x1) = (setup.x0 as usize, setup.x1 as usize + 1);
    let (y0, y1) = (setup.y0 as usize, setup.y1 as usize + 1);
    for by in (y0 & !(BLOCK - 1)..y1).step_by(BLOCK) {
        for bx in (x0 & !(BLOCK - 1)..x1).step_by(BLOCK) {
            let Some(planes) = Planes::at(setup, bx, by) else { continue };
            // The bounds keep the bits beyond the image's right edge clear.
            let valid = columns(bx, x0, x1);
            for y in by.max(y0)..(by + BLOCK).min(y1) {
                let e = planes.centers::<V>(y - by);
                let shows = inside(&e).and(e[3].gt(V::zero())).and(limit.ge(e[3]));
                mask.bits[y * mask.bytes_per_row + bx / LANES] |= shows.mask_bits() & valid;
            }
        }
    }
}
