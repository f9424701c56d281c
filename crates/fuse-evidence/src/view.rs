//! A borrowed row-major image.

use fuse_camera::Buffer;

use crate::error::EvidenceError;

/// A row-major image that someone else owns; element `(x, y)` is at `y * width + x`.
#[derive(Debug)]
pub struct View<'a, T> {
    width: u32,
    height: u32,
    data: &'a [T],
}

// Not derived: a view can be copied whatever it points to.
impl<T> Clone for View<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for View<'_, T> {}

impl<'a, T> View<'a, T> {
    /// Looks at `data` as an image.
    ///
    /// # Errors
    /// [`EvidenceError::TooSmall`] for an empty image, [`EvidenceError::Length`] unless there are
    /// `width * height` elements; both name `argument`.
    pub fn new(argument: &'static str, width: u32, height: u32, data: &'a [T]) -> Result<Self, EvidenceError> {
        if width == 0 || height == 0 {
            return Err(EvidenceError::TooSmall { argument, width, height, minimum: 1 });
        }
        let expected = width as usize * height as usize;
        if data.len() != expected {
            return Err(EvidenceError::Length { argument, found: data.len(), expected });
        }
        Ok(Self { width, height, data })
    }

    /// Width in pixels, at least 1.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels, at least 1.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All elements, row by row.
    pub fn as_slice(&self) -> &'a [T] {
        self.data
    }

    /// One row.
    pub fn row(&self, y: usize) -> &'a [T] {
        let w = self.width as usize;
        &self.data[y * w..(y + 1) * w]
    }

    /// Refuses another size than that of `reference`.
    pub(crate) fn same_size<U>(
        &self,
        argument: &'static str,
        other: &View<'_, U>,
        reference: &'static str,
    ) -> Result<(), EvidenceError> {
        if (self.width, self.height) == (other.width, other.height) {
            return Ok(());
        }
        Err(EvidenceError::Size {
            argument,
            reference,
            width: self.width,
            height: self.height,
            expected_width: other.width,
            expected_height: other.height,
        })
    }
}

impl<'a, T> From<&'a Buffer<T>> for View<'a, T> {
    fn from(buffer: &'a Buffer<T>) -> Self {
        Self { width: buffer.width(), height: buffer.height(), data: buffer.as_slice() }
    }
}
