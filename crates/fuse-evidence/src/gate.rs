//! How sure a planner is of its next action.

use crate::error::{EvidenceError, in_range};

/// `H = −(1 / log |A|) Σ p log p` with `p = softmax(values / temperature)` over the feasible
/// actions `A`: 0 when one action stands out, 1 when all are alike (supplement, "Confidence Gate";
/// the paper's temperature is 0.1). One feasible action: 0.
///
/// `feasible` is one flag an action, `None` for all. Values of infeasible actions are not looked
/// at.
///
/// # Errors
/// No feasible action; NaN or an infinity among feasible values; a temperature that is not
/// positive and finite; a mask of another length.
pub fn action_entropy(values: &[f32], temperature: f32, feasible: Option<&[bool]>) -> Result<f32, EvidenceError> {
    in_range("temperature", temperature, temperature.is_finite() && temperature > 0.0, "positive and finite")?;
    let chosen = feasible_values(values, feasible)?;
    if chosen.len() == 1 {
        return Ok(0.0);
    }
    let largest = chosen.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let logits: Vec<f64> = chosen.iter().map(|v| (v - largest) / f64::from(temperature)).collect();
    let total: f64 = logits.iter().map(|l| l.exp()).sum();
    // −Σ p log p = log Σ eˡ − Σ p l: no log of a p that underflows.
    let mean_logit: f64 = logits.iter().map(|l| if l.exp() > 0.0 { l.exp() * l } else { 0.0 }).sum::<f64>() / total;
    let entropy = (total.ln() - mean_logit) / (chosen.len() as f64).ln();
    Ok(entropy.clamp(0.0, 1.0) as f32)
}

/// The values of feasible actions, at least one, all finite.
fn feasible_values(values: &[f32], feasible: Option<&[bool]>) -> Result<Vec<f64>, EvidenceError> {
    if let Some(mask) = feasible
        && mask.len() != values.len()
    {
        return Err(EvidenceError::Length { argument: "mask", found: mask.len(), expected: values.len() });
    }
    let mut chosen = Vec::with_capacity(values.len());
    for (index, &value) in values.iter().enumerate() {
        if feasible.is_none_or(|mask| mask[index]) {
            if !value.is_finite() {
                return Err(EvidenceError::NotFinite { argument: "values", index, value });
            }
            chosen.push(f64::from(value));
        }
    }
    if chosen.is_empty() { Err(EvidenceError::NoFeasibleAction { actions: values.len() }) } else { Ok(chosen) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_values_by_hand() {
        // p = 1 / (1 + e⁻¹); with two actions H is in bits.
        let p = 1.0 / (1.0 + (-1.0f64).exp());
        let expected = -(p * p.log2() + (1.0 - p) * (1.0 - p).log2());
        let h = action_entropy(&[0.6, 0.5], 0.1, None).unwrap();
        assert!((f64::from(h) - expected).abs() < 1e-6, "{h} {expected}");
    }

    #[test]
    fn alike_is_one_and_clear_is_zero() {
        assert_eq!(action_entropy(&[0.3; 15], 0.1, None).unwrap(), 1.0);
        let mut values = [0.0; 15];
        values[4] = 1e30;
        assert_eq!(action_entropy(&values, 0.1, None).unwrap(), 0.0);
    }

    #[test]
    fn only_feasible_actions_count() {
        let values = [0.1, f32::NAN, 0.1, f32::NEG_INFINITY];
        assert_eq!(action_entropy(&values, 0.1, Some(&[true, false, true, false])).unwrap(), 1.0);
        assert_eq!(action_entropy(&values, 0.1, Some(&[true, false, false, false])).unwrap(), 0.0);
        let text = |mask: &[bool]| action_entropy(&values, 0.1, Some(mask)).unwrap_err().to_string();
        assert_eq!(text(&[false; 4]), "no action is feasible: mask has no true element among 4");
        assert_eq!(text(&[true; 4]), "values must be finite, found NaN at flat index 1");
        assert_eq!(text(&[true; 3]), "mask must have 4 elements, found 3");
    }

    #[test]
    fn no_action_at_all_and_bad_temperature_are_errors() {
        assert_eq!(action_entropy(&[], 0.1, None), Err(EvidenceError::NoFeasibleAction { actions: 0 }));
        for t in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(matches!(action_entropy(&[1.0, 2.0], t, None), Err(EvidenceError::OutOfRange { .. })));
        }
    }

    #[test]
    fn unit_temperature_cannot_fall_below_the_documented_floor() {
        // Targets are clipped to [-1, 1]; entropy is smallest with each of 15 values at one end.
        let entropy = |high: usize| {
            let values: Vec<f32> = (0..15).map(|i| if i < high { 1.0 } else { -1.0 }).collect();
            action_entropy(&values, 1.0, None).unwrap()
        };
        let floor = (1..15).map(entropy).fold(1.0, f32::min);
        assert!((floor - 0.825).abs() < 1e-3, "{floor}");
    }
}
