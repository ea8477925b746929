//! Choosing an index with given probabilities.

/// Cumulative distribution over indices, sampled by bisection so that stratified numbers stay stratified.
#[derive(Clone, Debug, Default)]
pub struct Cdf {
    /// Normalised running sums, the last one is 1.
    cumulative: Vec<f32>,
    /// Probability of each index.
    pdf: Vec<f32>,
}

impl Cdf {
    /// Probabilities in proportion to `weights`; `None` if no weight is positive and finite.
    ///
    /// Weights that are not finite and positive count as 0.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "sums are made in f64 and stored in f32")]
    pub fn new(weights: impl IntoIterator<Item = f64>) -> Option<Self> {
        let clean: Vec<f64> =
            weights.into_iter().map(|w| if w.is_finite() { w.max(0.0) } else { 0.0 }).collect();
        let total: f64 = clean.iter().sum();
        if !(0.0 < total && total.is_finite()) {
            return None;
        }
        let mut sum = 0.0;
        let cumulative = clean
            .iter()
            .map(|w| {
                sum += w;
                (sum / total) as f32
            })
            .collect();
        Some(Self { cumulative, pdf: clean.iter().map(|w| (w / total) as f32).collect() })
    }

    /// Number of indices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pdf.len()
    }

    /// Whether there is no index.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pdf.is_empty()
    }

    /// Probability of index `i`.
    #[must_use]
    pub fn pdf(&self, i: usize) -> f32 {
        self.pdf[i]
    }

    /// The index that `u` in [0, 1) falls on, and `u` rescaled to [0, 1) within it.
    #[must_use]
    pub fn sample(&self, u: f32) -> (usize, f32) {
        // An index of probability 0 has an empty interval and is never the first above u; rounding
        // at the end can still point behind the last one with weight.
        let mut i = self.cumulative.partition_point(|&c| c <= u).min(self.pdf.len() - 1);
        while self.pdf[i] == 0.0 && 0 < i {
            i -= 1;
        }
        let low = if i == 0 { 0.0 } else { self.cumulative[i - 1] };
        let width = self.cumulative[i] - low;
        let rest = if 0.0 < width { ((u - low) / width).clamp(0.0, ONE_MINUS_EPSILON) } else { 0.5 };
        (i, rest)
    }
}

/// Largest f32 below 1.
pub const ONE_MINUS_EPSILON: f32 = 1.0 - f32::EPSILON / 2.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequencies_follow_weights_and_zeros_never_come() {
        let weights = [0.0, 3.0, 1.0, 0.0, 4.0, 0.0];
        let cdf = Cdf::new(weights).expect("weights");
        let mut counts = [0u32; 6];
        for i in 0..8000u16 {
            let (k, rest) = cdf.sample((f32::from(i) + 0.5) / 8000.0);
            assert!((0.0..1.0).contains(&rest));
            counts[k] += 1;
        }
        assert_eq!(counts, [0, 3000, 1000, 0, 4000, 0]);
        assert_eq!(cdf.sample(0.0).0, 1);
        assert_eq!(cdf.sample(ONE_MINUS_EPSILON).0, 4);
    }

    #[test]
    fn nothing_to_choose_from() {
        assert!(Cdf::new([]).is_none());
        assert!(Cdf::new([0.0, 0.0]).is_none());
        assert!(Cdf::new([f64::NAN, f64::INFINITY]).is_none());
    }
}
