//! What can be wrong with an input.

/// An input that cannot be worked with; the message names it and says what was expected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EvidenceError {
    /// Two images that must have one size do not.
    #[error("{argument} must be {expected_width}x{expected_height} pixels like {reference}, found {width}x{height}")]
    Size {
        /// The image that differs.
        argument: &'static str,
        /// The image that sets the size.
        reference: &'static str,
        /// Size found.
        width: u32,
        /// Size found.
        height: u32,
        /// Size of `reference`.
        expected_width: u32,
        /// Size of `reference`.
        expected_height: u32,
    },
    /// A list or buffer of the wrong length.
    #[error("{argument} must have {expected} elements, found {found}")]
    Length {
        /// The argument.
        argument: &'static str,
        /// Its length.
        found: usize,
        /// The length that it must have.
        expected: usize,
    },
    /// An image without enough pixels.
    #[error("{argument} must be at least {minimum}x{minimum} pixels, found {width}x{height}")]
    TooSmall {
        /// The argument.
        argument: &'static str,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
        /// The smallest width and height.
        minimum: u32,
    },
    /// NaN or an infinity.
    #[error("{argument} must be finite, found {value} at flat index {index}")]
    NotFinite {
        /// The argument.
        argument: &'static str,
        /// Position in memory order.
        index: usize,
        /// What was there.
        value: f32,
    },
    /// A number outside of its range (NaN included).
    #[error("{argument} must be {expected}, found {value}")]
    OutOfRange {
        /// The argument.
        argument: &'static str,
        /// Its value.
        value: f64,
        /// The range in words.
        expected: &'static str,
    },
    /// The action mask leaves nothing to choose from.
    #[error("no action is feasible: mask has no true element among {actions}")]
    NoFeasibleAction {
        /// Number of actions.
        actions: usize,
    },
}

/// Refuses NaN and infinities.
pub(crate) fn finite(argument: &'static str, values: &[f32]) -> Result<(), EvidenceError> {
    // 0 · v is 0 for finite v and NaN otherwise; a sum in eight lanes is far faster than a search.
    let (chunks, rest) = values.as_chunks::<8>();
    let mut lanes = [0.0f32; 8];
    for chunk in chunks {
        for (lane, v) in lanes.iter_mut().zip(chunk) {
            *lane += v * 0.0;
        }
    }
    if lanes.iter().chain(rest).all(|v| v.is_finite()) {
        return Ok(());
    }
    match values.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(EvidenceError::NotFinite { argument, index, value: values[index] }),
        None => Ok(()),
    }
}

/// Refuses a number for which `ok` is false.
pub(crate) fn in_range(
    argument: &'static str,
    value: f32,
    ok: bool,
    expected: &'static str,
) -> Result<(), EvidenceError> {
    if ok { Ok(()) } else { Err(EvidenceError::OutOfRange { argument, value: f64::from(value), expected }) }
}
