//! Which part of the image an action is expected to reveal, and what that part is worth.
//!
//! `Ω(a)`: a ring motion to the right stands for the right half of the image, to the left for the
//! left half; a pitch further down for the lower half, less far down for the upper half; staying
//! for the whole image. For odd sizes the middle column belongs to the right half and the middle
//! row to the lower one, so that two halves always make the image.

use fuse_camera::{ACTION_COUNT, Action};

use crate::error::{EvidenceError, finite};
use crate::view::View;

/// How an action that moves along the ring and in pitch combines its two halves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coupled {
    /// `Ω` is the union of the two halves.
    #[default]
    Union,
    /// `Ω` is their intersection, a quadrant.
    Quadrant,
    /// The mean of the scores of the two halves.
    Mean,
}

/// Which ring motion wins when one and two nodes, having one region, tie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stride {
    /// Prefers actions that move by at most one node.
    #[default]
    One,
    /// Prefers actions that move by two nodes.
    Two,
}

/// A set of image quadrants.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Quadrants {
    /// `[upper or lower][left or right]`.
    members: [[bool; 2]; 2],
}

impl Quadrants {
    fn from_fn(f: impl Fn(bool, bool) -> bool) -> Self {
        Self { members: [false, true].map(|lower| [false, true].map(|right| f(lower, right))) }
    }

    /// The half (or whole) for the ring part of an action.
    fn of_ring(action: Action) -> Self {
        Self::from_fn(|_, right| action.ring == 0 || (action.ring > 0) == right)
    }

    /// The half (or whole) for the pitch part of an action.
    fn of_pitch(action: Action) -> Self {
        Self::from_fn(|lower, _| action.pitch == 0 || (action.pitch > 0) == lower)
    }

    fn and(self, other: Self) -> Self {
        Self::from_fn(|l, r| self.contains(l, r) && other.contains(l, r))
    }

    fn or(self, other: Self) -> Self {
        Self::from_fn(|l, r| self.contains(l, r) || other.contains(l, r))
    }

    fn contains(self, lower: bool, right: bool) -> bool {
        self.members[usize::from(lower)][usize::from(right)]
    }
}

/// The regions whose means are averaged for an action: one, or two under [`Coupled::Mean`].
fn parts(action: Action, coupled: Coupled) -> (Quadrants, Option<Quadrants>) {
    let (ring, pitch) = (Quadrants::of_ring(action), Quadrants::of_pitch(action));
    if action.ring == 0 || action.pitch == 0 {
        return (ring.and(pitch), None);
    }
    match coupled {
        Coupled::Union => (ring.or(pitch), None),
        Coupled::Quadrant => (ring.and(pitch), None),
        Coupled::Mean => (ring, Some(pitch)),
    }
}

/// `Ω(action)` as a row-major mask of a `width`×`height` image, for drawing. Under
/// [`Coupled::Mean`] a coupled action has two regions; their union is drawn.
///
/// # Errors
/// An image smaller than 2×2: a half of it would be empty.
pub fn region(width: u32, height: u32, action: Action, coupled: Coupled) -> Result<Vec<bool>, EvidenceError> {
    at_least_2x2("image", width, height)?;
    let quadrants = match parts(action, coupled) {
        (one, None) => one,
        (one, Some(other)) => one.or(other),
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (y >= height / 2, x >= width / 2)));
    Ok(pixels.map(|(lower, right)| quadrants.contains(lower, right)).collect())
}

/// `Q(a) = mean of E over Ω(a)` for every action, by action index (paper, explicit exploration).
///
/// # Errors
/// An image smaller than 2×2, or a value that is not finite.
pub fn action_scores(evidence: View<'_, f32>, coupled: Coupled) -> Result<[f32; ACTION_COUNT], EvidenceError> {
    at_least_2x2("evidence", evidence.width(), evidence.height())?;
    finite("evidence", evidence.as_slice())?;
    let sums = quadrant_sums(evidence);
    let (w, h) = (evidence.width() as usize, evidence.height() as usize);
    let (widths, heights) = ([w / 2, w - w / 2], [h / 2, h - h / 2]);
    let mean = |q: Quadrants| {
        let (mut sum, mut count) = (0.0f64, 0usize);
        for l in 0..2 {
            for r in 0..2 {
                if q.members[l][r] {
                    sum += sums[l][r];
                    count += heights[l] * widths[r];
                }
            }
        }
        sum / count as f64
    };
    let mut scores = [0.0; ACTION_COUNT];
    for action in Action::all() {
        scores[action.index()] = match parts(action, coupled) {
            (one, None) => mean(one) as f32,
            (one, Some(other)) => (0.5 * (mean(one) + mean(other))) as f32,
        };
    }
    Ok(scores)
}

/// The best feasible action. Equal scores go to the preferred stride, then to the lowest index.
///
/// `allow_noop`: whether staying may be chosen (not in the paper's explicit search).
///
/// # Errors
/// Nothing feasible, or NaN or an infinity among the feasible scores.
pub fn choose(
    scores: &[f32; ACTION_COUNT],
    feasible: &[bool; ACTION_COUNT],
    stride: Stride,
    allow_noop: bool,
) -> Result<Action, EvidenceError> {
    let preferred = |a: Action| match stride {
        Stride::One => a.ring.abs() <= 1,
        Stride::Two => a.ring.abs() == 2,
    };
    let mut best: Option<Action> = None;
    for action in Action::all().filter(|a| feasible[a.index()] && (allow_noop || *a != Action::NOOP)) {
        let value = scores[action.index()];
        if !value.is_finite() {
            return Err(EvidenceError::NotFinite { argument: "scores", index: action.index(), value });
        }
        let better = best.is_none_or(|b| {
            let held = scores[b.index()];
            value > held || (value == held && preferred(action) && !preferred(b))
        });
        if better {
            best = Some(action);
        }
    }
    best.ok_or(EvidenceError::NoFeasibleAction { actions: ACTION_COUNT })
}

fn at_least_2x2(argument: &'static str, width: u32, height: u32) -> Result<(), EvidenceError> {
    if width < 2 || height < 2 {
        return Err(EvidenceError::TooSmall { argument, width, height, minimum: 2 });
    }
    Ok(())
}

/// Sum of each quadrant, `[upper or lower][left or right]`, in f64 and a fixed order.
fn quadrant_sums(evidence: View<'_, f32>) -> [[f64; 2]; 2] {
    let (half_w, half_h) = (evidence.width() as usize / 2, evidence.height() as usize / 2);
    let mut sums = [[0.0; 2]; 2];
    for y in 0..evidence.height() as usize {
        let (left, right) = evidence.row(y).split_at(half_w);
        let of_row = &mut sums[usize::from(y >= half_h)];
        of_row[0] += sum(left);
        of_row[1] += sum(right);
    }
    sums
}

/// Eight interleaved partial sums, so that the loop vectorises.
fn sum(values: &[f32]) -> f64 {
    let (chunks, rest) = values.as_chunks::<8>();
    let mut lanes = [0.0f64; 8];
    for chunk in chunks {
        for (lane, &v) in lanes.iter_mut().zip(chunk) {
            *lane += f64::from(v);
        }
    }
    lanes.iter().sum::<f64>() + rest.iter().map(|&v| f64::from(v)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scores of an image that is 1 in one quadrant.
    fn scores(lower: bool, right: bool, coupled: Coupled) -> [f32; ACTION_COUNT] {
        let image: Vec<f32> =
            (0..4 * 6).map(|i| f32::from(u8::from((i / 6 >= 2) == lower && (i % 6 >= 3) == right))).collect();
        action_scores(View::new("evidence", 6, 4, &image).unwrap(), coupled).unwrap()
    }

    fn at(scores: &[f32; ACTION_COUNT], ring: i8, pitch: i8) -> f32 {
        scores[Action { ring, pitch }.index()]
    }

    #[test]
    fn evidence_lower_right_speaks_for_right_and_down() {
        let s = scores(true, true, Coupled::Union);
        for stride in [1, 2] {
            assert_eq!(at(&s, stride, 0), 0.5);
            assert_eq!(at(&s, -stride, 0), 0.0);
            assert_eq!(at(&s, stride, 1), 1.0 / 3.0);
            assert_eq!(at(&s, stride, -1), 1.0 / 3.0);
            assert_eq!(at(&s, -stride, -1), 0.0);
        }
        assert_eq!((at(&s, 0, 1), at(&s, 0, -1), at(&s, 0, 0)), (0.5, 0.0, 0.25));
    }

    #[test]
    fn evidence_upper_left_speaks_for_left_and_up() {
        let s = scores(false, false, Coupled::Quadrant);
        assert_eq!((at(&s, -1, -1), at(&s, 1, 1), at(&s, -1, 1), at(&s, -2, 0)), (1.0, 0.0, 0.0, 0.5));
        let s = scores(false, false, Coupled::Mean);
        assert_eq!((at(&s, -1, -1), at(&s, 1, 1), at(&s, -1, 1)), (0.5, 0.0, 0.25));
    }

    #[test]
    fn scores_are_means_over_the_drawn_regions_also_for_odd_sizes() {
        let (w, h) = (7u32, 5u32);
        let image: Vec<f32> = (0..w * h).map(|i| (i * i % 31) as f32).collect();
        for coupled in [Coupled::Union, Coupled::Quadrant] {
            let s = action_scores(View::new("evidence", w, h, &image).unwrap(), coupled).unwrap();
            for a in Action::all() {
                let mask = region(w, h, a, coupled).unwrap();
                let inside: Vec<f32> = image.iter().zip(&mask).filter(|(_, m)| **m).map(|(v, _)| *v).collect();
                let mean = inside.iter().sum::<f32>() / inside.len() as f32;
                assert!((mean - s[a.index()]).abs() < 1e-5, "{a:?}");
            }
        }
    }

    #[test]
    fn ties_go_to_the_stride_then_to_the_lowest_index() {
        let all = [true; ACTION_COUNT];
        let s = scores(false, true, Coupled::Union);
        // Right and up tie at 0.5: index 2 is (0, -1).
        assert_eq!(choose(&s, &all, Stride::One, false), Ok(Action { ring: 0, pitch: -1 }));
        // Under "two", only (2, 0) among the tied moves two nodes.
        assert_eq!(choose(&s, &all, Stride::Two, false), Ok(Action { ring: 2, pitch: 0 }));
        let level = Action::all().map(|a| a.pitch == 0).collect::<Vec<_>>().try_into().unwrap();
        assert_eq!(choose(&s, &level, Stride::One, false), Ok(Action { ring: 1, pitch: 0 }));
    }

    #[test]
    fn staying_is_chosen_only_when_allowed() {
        let mut s = [0.0; ACTION_COUNT];
        s[Action::NOOP.index()] = 1.0;
        let all = [true; ACTION_COUNT];
        assert_eq!(choose(&s, &all, Stride::One, true), Ok(Action::NOOP));
        assert_ne!(choose(&s, &all, Stride::One, false), Ok(Action::NOOP));
        let mut only = [false; ACTION_COUNT];
        only[Action::NOOP.index()] = true;
        assert_eq!(
            choose(&s, &only, Stride::One, false),
            Err(EvidenceError::NoFeasibleAction { actions: ACTION_COUNT })
        );
    }

    #[test]
    fn refuses_nan_and_images_without_halves() {
        let text = |w, h, v: &[f32]| {
            action_scores(View::new("evidence", w, h, v).unwrap(), Coupled::Union).unwrap_err().to_string()
        };
        assert_eq!(text(2, 2, &[0.0, 0.0, f32::NAN, 0.0]), "evidence must be finite, found NaN at flat index 2");
        assert_eq!(text(1, 2, &[0.0; 2]), "evidence must be at least 2x2 pixels, found 1x2");
        let mut s = [0.0; ACTION_COUNT];
        s[3] = f32::NAN;
        let mut feasible = [true; ACTION_COUNT];
        assert!(choose(&s, &feasible, Stride::One, false).is_err());
        feasible[3] = false;
        assert!(choose(&s, &feasible, Stride::One, false).is_ok());
    }
}
