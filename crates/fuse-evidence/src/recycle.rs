//! Memory of maps that is used again.
//!
//! A map of 640×480 takes less time to compute than the system takes to hand out, clear and map
//! its 1.2 MB page by page. Whoever is done with a map may [`give`] its memory back; the next map
//! is written into it.

use std::sync::{Mutex, PoisonError};

/// So many are kept; of more, the oldest is freed.
const KEPT: usize = 4;

static SPARE: Mutex<Vec<Vec<f32>>> = Mutex::new(Vec::new());

/// An empty vector with room for `len` elements.
pub fn take(len: usize) -> Vec<f32> {
    let mut spare = SPARE.lock().unwrap_or_else(PoisonError::into_inner);
    // A vector of more than twice the room would hold memory that nobody needs.
    let fits = |v: &Vec<f32>| (len..=2 * len).contains(&v.capacity());
    match spare.iter().rposition(fits) {
        Some(i) => spare.remove(i),
        None => Vec::with_capacity(len),
    }
}

/// Memory that is no longer needed. What is in it is forgotten.
pub fn give(mut data: Vec<f32>) {
    data.clear();
    let mut spare = SPARE.lock().unwrap_or_else(PoisonError::into_inner);
    if spare.len() == KEPT {
        spare.remove(0);
    }
    spare.push(data);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gives_out_what_fits_and_nothing_much_larger() {
        // A size that no other test of this process uses.
        let data = Vec::with_capacity(1_234_567);
        let place = data.as_ptr();
        give(data);
        let (larger, smaller) = (take(1_234_568), take(600_000));
        assert!(larger.as_ptr() != place && smaller.as_ptr() != place);
        let again = take(1_234_000);
        assert_eq!((again.as_ptr(), again.len()), (place, 0));
        let fresh = take(1_234_000);
        assert_ne!(fresh.as_ptr(), place);
    }
}
