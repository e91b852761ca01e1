//! Median, least and spread of repeated measurements.

use serde::Serialize;

/// What is told of a sample, in its own unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    pub median: f64,
    pub min: f64,
    /// From the first to the third quartile.
    pub spread: f64,
}

impl Summary {
    /// Of a sample; zeros of an empty one.
    pub fn of(values: &[f64]) -> Self {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let position = share * sorted.len().saturating_sub(1) as f64;
            let (low, high) = (position.floor() as usize, position.ceil() as usize);
            match (sorted.get(low), sorted.get(high)) {
                (Some(low), Some(high)) => low + (high - low) * position.fract(),
                _ => 0.0,
            }
        };
        Self { median: at(0.5), min: at(0.0), spread: at(0.75) - at(0.25) }
    }

    /// The same in another unit.
    pub fn times(self, factor: f64) -> Self {
        Self { median: self.median * factor, min: self.min * factor, spread: self.spread * factor }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_odd_even_and_empty_samples() {
        assert_eq!(Summary::of(&[3.0, 1.0, 2.0, 5.0, 4.0]), Summary { median: 3.0, min: 1.0, spread: 2.0 });
        assert_eq!(Summary::of(&[2.0, 1.0]), Summary { median: 1.5, min: 1.0, spread: 0.5 });
        assert_eq!(Summary::of(&[]), Summary::default());
    }
}
