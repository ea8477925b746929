//! Choosing an index with given probabilities.

/// Cumulative distribution over indices, sampled by inversion so that stratified numbers stay stratified.
///
/// A guide table (\[CA74\] Chen & Asau, 1974) says where the search starts, so that it takes a few steps whatever
/// the number of indices.
#[derive(Clone, Debug, Default)]
pub struct Cdf {
    /// For each of as many equal parts of [0, 1) as there are indices the first index whose sum lies above its lower end.
    guide: Vec<u32>,
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
        let cumulative: Vec<f32> = clean
            .iter()
            .map(|w| {
                sum += w;
                (sum / total) as f32
            })
            .collect();
        let n = cumulative.len();
        let mut first = 0;
        let guide = (0..n)
            .map(|part| {
                // One ulp lower than the quotient, because a number's part is found by a rounded product.
                let low = (part as f32 / n as f32).next_down();
                while first + 1 < n && cumulative[first] <= low {
                    first += 1;
                }
                first as u32
            })
            .collect();
        Some(Self { guide, cumulative, pdf: clean.iter().map(|w| (w / total) as f32).collect() })
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
        let n = self.pdf.len();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the table")]
        let part = ((u * n as f32).max(0.0) as usize).min(n - 1);
        let mut i = self.guide[part] as usize;
        while i + 1 < n && self.cumulative[i] <= u {
            i += 1;
        }
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

    /// The guide table finds what bisection finds, between and at the steps.
    #[test]
    fn the_guide_changes_nothing() {
        for n in [1, 2, 7, 1152, 16_384] {
            let weight = |i: u32| if i.is_multiple_of(3) { 0.0 } else { f64::from(i % 11).powi(4) + 1e-4 };
            let cdf = Cdf::new((0..n).map(|i| weight(i + 1))).expect("weights");
            let steps = cdf.cumulative.iter().flat_map(|&c| [c, c.next_down(), c.next_up()]);
            let between = (0..4096u16).map(|i| f32::from(i) / 4096.0);
            for u in steps.chain(between).filter(|u| (0.0..1.0).contains(u)) {
                let mut want = cdf.cumulative.partition_point(|&c| c <= u).min(cdf.len() - 1);
                while cdf.pdf[want] == 0.0 && 0 < want {
                    want -= 1;
                }
                assert_eq!(cdf.sample(u).0, want, "{u} of {n}");
            }
        }
    }

    #[test]
    fn nothing_to_choose_from() {
        assert!(Cdf::new([]).is_none());
        assert!(Cdf::new([0.0, 0.0]).is_none());
        assert!(Cdf::new([f64::NAN, f64::INFINITY]).is_none());
    }
}
