//! When to stop looking: after `K` observations in a row that bring nothing better.

use crate::error::EvidenceError;

/// Counts observations that do not improve on the best score (Algorithm 1: `r_best`, `k_fail`).
#[derive(Clone, Debug, PartialEq)]
pub struct Patience {
    limit: u32,
    failures: u32,
    best: Option<f64>,
}

impl Patience {
    /// Stops after `limit` (`K`, the paper's 5) observations without improvement.
    ///
    /// # Errors
    /// A limit of zero: it would stop before the first observation.
    pub fn new(limit: u32) -> Result<Self, EvidenceError> {
        if limit == 0 {
            return Err(EvidenceError::OutOfRange { argument: "k", value: 0.0, expected: "at least 1" });
        }
        Ok(Self { limit, failures: 0, best: None })
    }

    /// Takes in the score of the next observation, `None` when nothing in it could be scored.
    /// Returns whether it is strictly better than all before; an equal score is not, and counts
    /// against patience like a missing one.
    ///
    /// # Errors
    /// A score that is not finite; nothing is counted then.
    pub fn observe(&mut self, score: Option<f64>) -> Result<bool, EvidenceError> {
        if let Some(s) = score
            && !s.is_finite()
        {
            return Err(EvidenceError::OutOfRange { argument: "score", value: s, expected: "finite" });
        }
        let improved = match (score, self.best) {
            (Some(s), Some(best)) => s > best,
            (Some(_), None) => true,
            (None, _) => false,
        };
        if improved {
            self.best = score;
            self.failures = 0;
        } else {
            self.failures = self.failures.saturating_add(1);
        }
        Ok(improved)
    }

    /// Whether `K` observations in a row brought nothing better.
    pub fn exhausted(&self) -> bool {
        self.failures >= self.limit
    }

    /// The best score so far.
    pub fn best(&self) -> Option<f64> {
        self.best
    }

    /// Observations since the best one (`k_fail`).
    pub fn failures(&self) -> u32 {
        self.failures
    }

    /// `K`.
    pub fn limit(&self) -> u32 {
        self.limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stops_after_k_without_strict_improvement() {
        let mut p = Patience::new(3).unwrap();
        let improved: Vec<bool> = [Some(0.2), Some(0.1), Some(0.3), Some(0.3), None, Some(0.29)]
            .into_iter()
            .map(|s| {
                assert!(!p.exhausted());
                p.observe(s).unwrap()
            })
            .collect();
        assert_eq!(improved, [true, false, true, false, false, false]);
        assert!(p.exhausted());
        assert_eq!((p.best(), p.failures()), (Some(0.3), 3));
    }

    #[test]
    fn nothing_ever_scored_also_stops() {
        let mut p = Patience::new(2).unwrap();
        p.observe(None).unwrap();
        assert!(!p.exhausted());
        p.observe(None).unwrap();
        assert!(p.exhausted());
        assert_eq!(p.best(), None);
    }

    #[test]
    fn a_zero_score_is_better_than_none() {
        let mut p = Patience::new(1).unwrap();
        assert!(p.observe(Some(0.0)).unwrap());
    }

    #[test]
    fn nan_is_refused_and_not_counted() {
        let mut p = Patience::new(1).unwrap();
        assert_eq!(p.observe(Some(f64::NAN)).unwrap_err().to_string(), "score must be finite, found NaN");
        assert!(!p.exhausted());
        assert!(Patience::new(0).is_err());
    }
}
