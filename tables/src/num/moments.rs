//! Mergeable mean and variance.
//!
//! \[CGL79\] Chan, Golub & LeVeque, "Updating formulae and a pairwise algorithm for computing sample
//! variances", 1979, eq. 2.1.

/// Count, mean and sum of squared deviations of a stream of numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// Number of values.
    pub n: f64,
    /// Their mean.
    pub mean: f64,
    /// Sum of squared deviations from the mean.
    pub m2: f64,
}

impl Moments {
    /// Adds one value.
    pub fn push(&mut self, x: f64) {
        self.n += 1.0;
        let d = x - self.mean;
        self.mean += d / self.n;
        self.m2 += d * (x - self.mean);
    }

    /// The moments of both streams together.
    #[must_use]
    pub fn merge(self, o: Self) -> Self {
        let n = self.n + o.n;
        if n == 0.0 {
            return self;
        }
        let d = o.mean - self.mean;
        Self { n, mean: self.mean + d * o.n / n, m2: self.m2 + o.m2 + d * d * self.n * o.n / n }
    }

    /// Unbiased sample variance; 0 below two values.
    #[must_use]
    pub fn variance(&self) -> f64 {
        if self.n < 2.0 { 0.0 } else { self.m2 / (self.n - 1.0) }
    }

    /// Standard error of the mean; 0 below two values.
    #[must_use]
    pub fn std_err(&self) -> f64 {
        if self.n < 2.0 { 0.0 } else { (self.variance() / self.n).sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn merge_equals_pushing_all() {
        let xs: Vec<f64> = (0..101).map(|i| f64::from(i * i % 37) + 1e6).collect();
        for split in [0, 1, 50, 100, 101] {
            let (mut a, mut b, mut all) = (Moments::default(), Moments::default(), Moments::default());
            for (i, &x) in xs.iter().enumerate() {
                if i < split {
                    a.push(x)
                } else {
                    b.push(x)
                }
                all.push(x);
            }
            let m = a.merge(b);
            assert_eq!(m.n, all.n);
            assert!((m.mean - all.mean).abs() < 1e-9, "{} {}", m.mean, all.mean);
            assert!((m.variance() / all.variance() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn known_variance() {
        let mut m = Moments::default();
        for x in [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0] {
            m.push(x);
        }
        assert_eq!(m.mean, 5.0);
        assert!((m.variance() - 32.0 / 7.0).abs() < 1e-12);
    }
}
