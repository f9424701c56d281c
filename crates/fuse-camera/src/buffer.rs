//! Row-major images.

/// Why a buffer could not be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a {width}x{height} image needs {expected} elements, found {found}")]
pub struct BufferError {
    width: u32,
    height: u32,
    expected: usize,
    found: usize,
}

/// A row-major image; element `(x, y)` is at `y * width + x`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Buffer<T> {
    width: u32,
    height: u32,
    data: Vec<T>,
}

/// 8-bit sRGB colour.
pub type RgbBuffer = Buffer<[u8; 3]>;
/// Planar depth in metres along the optical axis; 0 where nothing was hit.
pub type DepthBuffer = Buffer<f32>;
/// Instance ids; 0 is the room and the table.
pub type IdBuffer = Buffer<u32>;

impl<T: Clone> Buffer<T> {
    /// An image filled with one value.
    pub fn filled(width: u32, height: u32, value: T) -> Self {
        Self { width, height, data: vec![value; width as usize * height as usize] }
    }
}

impl<T> Buffer<T> {
    /// Takes over `data` (row-major, `width * height` elements).
    pub fn from_vec(width: u32, height: u32, data: Vec<T>) -> Result<Self, BufferError> {
        let expected = width as usize * height as usize;
        if data.len() != expected {
            return Err(BufferError { width, height, expected, found: data.len() });
        }
        Ok(Self { width, height, data })
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All elements, row by row.
    pub fn as_slice(&self) -> &[T] {
        &self.data
    }

    /// All elements, row by row.
    pub fn as_mut_slice(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// The elements, row by row.
    pub fn into_vec(self) -> Vec<T> {
        self.data
    }

    /// The element in column `x`, row `y`.
    ///
    /// # Panics
    /// If the position is outside the image.
    pub fn get(&self, x: u32, y: u32) -> &T {
        assert!(x < self.width, "column {x} of a {} wide image", self.width);
        &self.data[y as usize * self.width as usize + x as usize]
    }

    /// One row.
    pub fn row(&self, y: u32) -> &[T] {
        let w = self.width as usize;
        &self.data[y as usize * w..(y as usize + 1) * w]
    }
}
