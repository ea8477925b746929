//! Test that two noisy images have the same expectation.
//!
//! Each side gives a mean and its standard error per texel and channel (Welch's statistic; for
//! images: \[JHD20\] Jung, Hanika, Dachsbacher, "Detecting bias in Monte Carlo renderers using Welch's
//! t-test", JCGT 9(2), 2020). Three questions are asked at a third of alpha each:
//!
//! 1. Is the largest |z| of all too large? Sidak's correction for their number.
//! 2. Are there too many |z| beyond 1.96? Binomial, counted in texels because a texel's channels
//!    share their paths. A fifth more than expected is allowed, since standard errors are
//!    estimates and light is not normally distributed.
//! 3. Is a channel's mean off? This finds a small bias everywhere.
//!
//! Texels are taken as independent, which holds as long as no light is cached between them. Where
//! the number of samples is known the largest |z| follows Student's distribution with one less
//! than the smaller number of samples, which is on the safe side; otherwise the normal one.

use std::fmt;

use serde::Serialize;
use statrs::{
    distribution::{Binomial, ContinuousCDF, DiscreteCDF, StudentsT},
    function::erf::erfc,
};

use super::{
    figures::{Place, compared},
    input::Layers,
};

/// Outcome of the test; the two are equal where no reason is given against it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Equality {
    /// Whether nothing speaks against equal expectations.
    pub equal: bool,
    /// Probability of a false alarm.
    pub alpha: f64,
    /// Texels tested: those with a standard error on a side, or a difference.
    pub texels: u64,
    /// Degrees of freedom of a texel's standard error, where known.
    pub degrees_of_freedom: Option<u64>,
    /// Largest |z|.
    pub max_z: f64,
    /// Where it is.
    pub max_z_at: Option<Place>,
    /// Probability of a largest |z| like this by chance.
    pub p_max: f64,
    /// Part of all z with |z| above 1.96.
    pub share_above_1_96: f64,
    /// What is expected of it by chance.
    pub expected_above_1_96: f64,
    /// Part of all z with |z| above 3.
    pub share_above_3: f64,
    /// What is expected of it by chance.
    pub expected_above_3: f64,
    /// Probability of a share above 1.96 like this by chance, allowance included.
    pub p_share: f64,
    /// z of the mean of red, green and blue.
    pub bias_z: [f64; 3],
    /// Probability of a bias like this by chance.
    pub p_bias: f64,
}

impl Equality {
    /// What speaks against equality.
    pub(super) fn reasons(&self) -> Vec<String> {
        let level = self.alpha / 3.0;
        let mut reasons = Vec::new();
        if self.p_max < level {
            let place = self.max_z_at.map(|at| format!(" at {at}")).unwrap_or_default();
            reasons.push(format!("largest |z| is {:.2} (p {:.1e}){place}", self.max_z, self.p_max));
        }
        if self.p_share < level {
            let (share, expected) = (100.0 * self.share_above_1_96, 100.0 * self.expected_above_1_96);
            reasons.push(format!(
                "{share:.2} % of |z| are above 1.96, expected {expected:.2} % (p {:.1e})",
                self.p_share
            ));
        }
        if self.p_bias < level {
            let [r, g, b] = self.bias_z;
            reasons.push(format!("the means differ by z = {r:.2}, {g:.2}, {b:.2} (p {:.1e})", self.p_bias));
        }
        reasons
    }
}

impl fmt::Display for Equality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "|z|: largest {:.2} (p {:.2}), {:.2} % above 1.96 (expected {:.2} %), {:.3} % above 3 (expected {:.3} %), \
             bias p {:.2}; alpha {}",
            self.max_z,
            self.p_max,
            100.0 * self.share_above_1_96,
            100.0 * self.expected_above_1_96,
            100.0 * self.share_above_3,
            100.0 * self.expected_above_3,
            self.p_bias,
            self.alpha
        )
    }
}

/// z of texel `i` in one channel: `(a - b) / sqrt(sa^2 + sb^2)`; `None` without standard errors on
/// both sides.
///
/// The variance includes rounding, relative to the values, so that equal computations in another
/// order do not differ where both standard errors are 0.
pub(super) fn z(a: &Layers, b: &Layers, i: usize, channel: usize) -> Option<f64> {
    let variance = variance(a, b, i, channel)?;
    let difference = f64::from(a.light[channel][i]) - f64::from(b.light[channel][i]);
    Some(if difference == 0.0 { 0.0 } else { difference / variance.sqrt() })
}

fn variance(a: &Layers, b: &Layers, i: usize, channel: usize) -> Option<f64> {
    let one = |side: &Layers| {
        let error = f64::from(side.std_err.as_ref()?[channel][i]);
        let rounding = side.rounding * f64::from(side.light[channel][i]);
        Some(error * error + rounding * rounding)
    };
    Some(one(a)? + one(b)?)
}

/// Collects z over pages.
pub(super) struct Tester {
    alpha: f64,
    degrees_of_freedom: Option<u64>,
    texels: u64,
    above_1_96: u64,
    above_3: u64,
    max: f64,
    max_at: Option<Place>,
    bias: [Bias; 3],
}

#[derive(Clone, Copy, Default)]
struct Bias {
    difference: f64,
    variance: f64,
    /// Rounding may go the same way everywhere, so its parts add without squares.
    rounding: f64,
}

impl Tester {
    /// `samples`: the fewest in a texel of either side, where both are known.
    pub(super) fn new(alpha: f64, samples: Option<u64>) -> Self {
        Self {
            alpha,
            degrees_of_freedom: samples.filter(|n| 1 < *n).map(|n| n - 1),
            texels: 0,
            above_1_96: 0,
            above_3: 0,
            max: 0.0,
            max_at: None,
            bias: [Bias::default(); 3],
        }
    }

    /// Adds a page; whether both sides have standard errors.
    pub(super) fn add(&mut self, a: &Layers, b: &Layers, page: usize) -> bool {
        if a.std_err.is_none() || b.std_err.is_none() {
            return false;
        }
        for i in (0..a.width * a.height).filter(|&i| compared(a, b, i)) {
            let mut counts = false;
            for channel in 0..3 {
                let (Some(z), Some(variance)) = (z(a, b, i, channel), variance(a, b, i, channel)) else {
                    continue;
                };
                // A standard error that is no number makes a z that is none; it must not pass for 0.
                let size = if z.is_nan() { f64::INFINITY } else { z.abs() };
                counts |= 0.0 < variance || size != 0.0;
                self.above_1_96 += u64::from(1.96 < size);
                self.above_3 += u64::from(3.0 < size);
                if self.max < size {
                    self.max = size;
                    self.max_at = Some(Place::new(page, i, channel, a, b));
                }
                let (x, y) = (f64::from(a.light[channel][i]), f64::from(b.light[channel][i]));
                let bias = &mut self.bias[channel];
                bias.difference += x - y;
                bias.variance += variance;
                bias.rounding += a.rounding * x.abs() + b.rounding * y.abs();
            }
            self.texels += u64::from(counts);
        }
        true
    }

    /// The outcome; `None` where there is nothing to test.
    pub(super) fn finish(self) -> Option<Equality> {
        if self.texels == 0 {
            return None;
        }
        let student = self.degrees_of_freedom.and_then(|n| StudentsT::new(0.0, 1.0, float(n)).ok());
        let two_sided = |z: f64| match &student {
            _ if z.is_infinite() => 0.0,
            Some(student) => 2.0 * student.sf(z.abs()),
            None => normal_two_sided(z),
        };
        let n_z = 3 * self.texels;
        let (expected_above_1_96, expected_above_3) = (two_sided(1.96), two_sided(3.0));
        let share = |n: u64| float(n) / float(n_z);
        // 1 - (1 - p)^n without losing small p.
        let p_max = -(float(n_z) * (-two_sided(self.max)).ln_1p()).exp_m1();
        // Texels beyond 1.96, had every texel one z.
        let beyond = self.above_1_96.div_ceil(3);
        let p_share = match Binomial::new((1.2 * expected_above_1_96).min(1.0), self.texels) {
            Ok(binomial) if 0 < beyond => binomial.sf(beyond - 1),
            _ => 1.0,
        };
        let bias_z = self.bias.map(|b| {
            if b.difference == 0.0 {
                0.0
            } else {
                b.difference / (b.variance + b.rounding * b.rounding).sqrt()
            }
        });
        let p_bias = bias_z.into_iter().map(normal_two_sided).fold(1.0, f64::min).mul_add(3.0, 0.0).min(1.0);
        let level = self.alpha / 3.0;
        Some(Equality {
            equal: level <= p_max && level <= p_share && level <= p_bias,
            alpha: self.alpha,
            texels: self.texels,
            degrees_of_freedom: self.degrees_of_freedom,
            max_z: self.max,
            max_z_at: self.max_at,
            p_max,
            share_above_1_96: share(self.above_1_96),
            expected_above_1_96,
            share_above_3: share(self.above_3),
            expected_above_3,
            p_share,
            bias_z,
            p_bias,
        })
    }
}

/// Probability of a normal |z| at least this large. NaN counts as impossible.
fn normal_two_sided(z: f64) -> f64 {
    if z.is_nan() { 0.0 } else { erfc(z.abs() / std::f64::consts::SQRT_2) }
}

#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn float(n: u64) -> f64 {
    n as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_agree_with_tables() {
        // Two-sided 5 % and 1e-6 points of the normal and of Student's t.
        let cases = [
            (1.959_964, None, 0.05),
            (4.891_638, None, 1e-6),
            (2.306_004, Some(8), 0.05),
            (15.7, Some(7), 1.02e-6),
        ];
        for (z, degrees, expected) in cases {
            let p = match degrees {
                None => normal_two_sided(z),
                Some(n) => 2.0 * StudentsT::new(0.0, 1.0, float(n)).expect("valid").sf(z),
            };
            assert!((p / expected - 1.0).abs() < 0.05, "z {z}: {p} for {expected}");
        }
    }
}
