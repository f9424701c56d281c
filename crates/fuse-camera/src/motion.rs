//! The discrete sensing actions (supplement, "Viewpoints and actions").
//!
//! An action is a joint displacement `(Δp, Δr)`: `Δp ∈ {-2..2}` nodes along the ring,
//! `Δr ∈ {-1, 0, 1}` pitch levels. The ring runs counter-clockwise seen from above and the camera
//! faces its centre, so `Δp > 0` moves towards the camera's own right. Levels are ordered by
//! downward tilt, so `Δr > 0` looks further down.

/// Number of actions.
pub const ACTION_COUNT: usize = 15;

/// One sensing action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Action {
    /// Ring nodes to move; positive is to the camera's right.
    pub ring: i8,
    /// Pitch levels to move; positive looks further down.
    pub pitch: i8,
}

impl Action {
    /// Staying where one is.
    pub const NOOP: Self = Self { ring: 0, pitch: 0 };

    /// The action at `index = 5 (Δr + 1) + (Δp + 2)`; `None` from [`ACTION_COUNT`] on.
    pub fn from_index(index: usize) -> Option<Self> {
        (index < ACTION_COUNT).then(|| Self { ring: (index % 5) as i8 - 2, pitch: (index / 5) as i8 - 1 })
    }

    /// Position in the list of all actions: `5 (Δr + 1) + (Δp + 2)`.
    pub fn index(self) -> usize {
        (5 * (self.pitch + 1) + self.ring + 2) as usize
    }

    /// All actions, by index.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..ACTION_COUNT).filter_map(Self::from_index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn index_and_action_are_inverse() {
        for (i, a) in Action::all().enumerate() {
            assert_eq!(a.index(), i);
        }
        assert_eq!(Action::NOOP.index(), 7);
        assert_eq!(Action::from_index(ACTION_COUNT), None);
    }
}
