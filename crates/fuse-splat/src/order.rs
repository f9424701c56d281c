//! Which view an iteration looks at.

use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Views in shuffled rounds, as in the original: each comes once before any comes again. For a while
/// after new ones came, every second iteration looks at these, in turn; the rounds go on in between,
/// so that old views are not forgotten.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Order {
    /// Views still to come before all are shuffled anew, the next one last.
    queue: Vec<usize>,
    /// The first of the newest views: those that came together, without a step in between.
    newest: usize,
    /// Steps since they came.
    steps: u32,
}

impl Order {
    /// View `index` has come. All views, this one among them, are due from now on.
    pub fn add(&mut self, index: usize) {
        self.queue.clear();
        if self.steps > 0 {
            (self.newest, self.steps) = (index, 0);
        }
    }

    /// The next of `views` views; new ones are favoured in their first `favour` steps. The views
    /// that came before any step were never new to a map, and are not.
    pub fn next(&mut self, views: usize, favour: u32, rng: &mut ChaCha8Rng) -> usize {
        let step = self.steps;
        self.steps = step.saturating_add(1);
        if self.newest > 0 && step < favour && step.is_multiple_of(2) {
            return self.newest + step as usize / 2 % (views - self.newest);
        }
        if self.queue.is_empty() {
            self.queue = (0..views).collect();
            self.queue.shuffle(rng);
        }
        self.queue.pop().unwrap_or(0)
    }

    /// Whether it can be the order of so many views.
    pub fn fits(&self, views: usize) -> bool {
        self.newest < views.max(1) && self.queue.iter().all(|&i| i < views)
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::rand_core::SeedableRng as _;

    use super::*;

    fn take(order: &mut Order, count: usize, views: usize, favour: u32) -> Vec<usize> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        (0..count).map(|_| order.next(views, favour, &mut rng)).collect()
    }

    #[test]
    fn every_view_comes_once_a_round() {
        let mut order = Order::default();
        (0..4).for_each(|i| order.add(i));
        let taken = take(&mut order, 8, 4, 100);
        for round in taken.chunks(4) {
            let mut round = round.to_vec();
            round.sort_unstable();
            assert_eq!(round, [0, 1, 2, 3]);
        }
    }

    #[test]
    fn new_views_take_turns_in_every_second_step_until_they_are_old() {
        let mut order = Order::default();
        (0..4).for_each(|i| order.add(i));
        take(&mut order, 3, 4, 8);
        order.add(4);
        order.add(5);
        let taken = take(&mut order, 20, 6, 8);
        assert_eq!([0, 2, 4, 6].map(|i| taken[i]), [4, 5, 4, 5]);
        let mut rounds: Vec<usize> =
            [1, 3, 5, 7].map(|i| taken[i]).into_iter().chain(taken[8..].iter().copied()).collect();
        assert_eq!(rounds.len(), 16);
        rounds.truncate(12);
        for round in rounds.chunks_mut(6) {
            round.sort_unstable();
            assert_eq!(round, [0, 1, 2, 3, 4, 5], "a round goes on between the new views: {taken:?}");
        }
        order.add(6);
        assert_eq!(take(&mut order, 3, 7, 8)[2], 6);
        assert!(order.fits(7) && !order.fits(6));
    }
}
