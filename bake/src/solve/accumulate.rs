//! Mean and standard error of stratified samples, and the gate that keeps out what is not a number.

use crate::scene::model::Rgb;
use glam::{DVec3, Vec3};
use std::fmt;
use std::str::FromStr;

/// Blocks into which samples are grouped for the standard error.
///
/// Consecutive runs of a scrambled Sobol sequence are stratified, so the samples inside a run are
/// not independent and their plain variance overstates the error. The spread of the means of 16
/// runs is nearer to it, and still an upper estimate: the runs are stratified against one another
/// as well.
const BLOCKS: usize = 16;

/// Mean of `samples` and its standard error, per channel.
///
/// With fewer than two samples nothing is known about the error: it is stated as large as the mean.
#[must_use]
pub fn mean_and_error(samples: impl ExactSizeIterator<Item = Rgb> + Clone) -> (Rgb, Rgb) {
    let n = samples.len();
    if n == 0 {
        return (Vec3::ZERO, Vec3::ZERO);
    }
    let total: DVec3 = samples.clone().map(|x| x.as_dvec3()).sum();
    let mean = total / n as f64;
    if n < 2 {
        return (mean.as_vec3(), mean.abs().as_vec3());
    }
    let blocks = n.min(BLOCKS);
    let mut squares = DVec3::ZERO;
    let mut rest = samples;
    for b in 0..blocks {
        // Blocks differ by one sample at most; their weight is their share of the samples.
        let size = (b + 1) * n / blocks - b * n / blocks;
        let sum: DVec3 = rest.by_ref().take(size).map(|x| x.as_dvec3()).sum();
        let deviation = sum - mean * size as f64;
        squares += deviation * deviation;
    }
    let b = blocks as f64;
    let error = (squares * (b / (b - 1.0))).map(f64::sqrt) / n as f64;
    (mean.as_vec3(), error.as_vec3())
}

/// The mean of the first half of `samples` less that of the second, scaled so that its mean square is the variance of the
/// mean of all.
///
/// Each half of a scrambled Sobol sequence is as well stratified as the whole, so over many texels this is much nearer to
/// the true variance than the spread of `BLOCKS` short runs is: where the error falls like the power -3/4 of the number, as at
/// an edge, it overstates the standard error by a fifth where the runs double it. Of one texel it says nothing: it has one degree of freedom.
#[must_use]
pub fn halves(samples: impl ExactSizeIterator<Item = f32> + Clone) -> f32 {
    let n = samples.len();
    let first = n / 2;
    let mean = |from: usize, n: usize| {
        let sum: f64 = samples.clone().skip(from).take(n).map(f64::from).sum();
        sum / n.max(1) as f64
    };
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
    match first {
        0 => mean(0, n) as f32,
        _ => {
            let scale = ((first * (n - first)) as f64).sqrt() / n as f64;
            ((mean(0, first) - mean(first, n - first)) * scale) as f32
        }
    }
}

/// What a sample gathers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Light of a texel straight from suns and lamps.
    Small,
    /// All other light of a texel.
    Path,
    /// Where the light of a texel comes from.
    Direction,
    /// What arrives at a node of the light grid of media.
    Node,
    /// What arrives at a cell of the irradiance cache.
    Cell,
    /// What arrives at a light probe.
    Probe,
    /// What arrives at a point.
    Point,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 7] =
        [Self::Small, Self::Path, Self::Direction, Self::Node, Self::Cell, Self::Probe, Self::Point];

    /// The word for it in [`Rejected`]'s text.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Small => "small",
            Self::Path => "path",
            Self::Direction => "direction",
            Self::Node => "node",
            Self::Cell => "cell",
            Self::Probe => "probe",
            Self::Point => "point",
        }
    }
}

/// Which sample; in the order of pages, texels, kinds and numbers.
///
/// Its text is `PAGE:TEXEL:KIND:SAMPLE`, such as `0:17:small:3`, and can be parsed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rejected {
    /// Page; for probes the volume, for cells the pass; 0 for nodes and points.
    pub page: usize,
    /// Texel index within the page, or number of the node, cell, probe or point.
    pub texel: u32,
    /// What it gathers.
    pub kind: Kind,
    /// Number of the sample.
    pub sample: u32,
}

impl fmt::Display for Rejected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}:{}", self.page, self.texel, self.kind.name(), self.sample)
    }
}

impl FromStr for Rejected {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let words: Vec<&str> = text.split(':').collect();
        let parsed = match words[..] {
            [page, texel, kind, sample] => {
                page.parse().ok().zip(texel.parse().ok()).and_then(|(page, texel)| {
                    let kind = Kind::ALL.into_iter().find(|k| k.name() == kind)?;
                    Some(Self { page, texel, kind, sample: sample.parse().ok()? })
                })
            }
            _ => None,
        };
        parsed.ok_or_else(|| {
            let kinds = Kind::ALL.map(Kind::name).join(", ");
            format!("PAGE:TEXEL:KIND:SAMPLE is wanted, such as 0:17:path:3; KIND is one of {kinds}")
        })
    }
}

/// Counts samples that are not finite or absurdly bright, which are left out, and remembers the first one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gate {
    /// How many were rejected.
    pub rejected: u64,
    /// The first in the order of texels and samples.
    pub first: Option<Rejected>,
}

/// Samples beyond this, nits, would make sums of layers or their squares overflow; a sun's disc has 2e9.
const BRIGHTEST: f32 = 1e35;

/// Whether a sample may count: finite, and no brighter than 1e35 nits.
#[must_use]
pub fn is_admissible(colour: Rgb) -> bool {
    colour.abs().max_element() <= BRIGHTEST && !colour.is_nan()
}

impl Gate {
    /// Lets a finite colour up to 1e35 nits through and turns anything else into black, counted.
    #[must_use]
    pub fn admit(&mut self, colour: Rgb, at: Rejected) -> Rgb {
        if is_admissible(colour) {
            return colour;
        }
        self.rejected += 1;
        self.first.get_or_insert(at);
        Vec3::ZERO
    }

    /// Both together; `self` came first.
    #[must_use]
    pub fn merge(self, o: Self) -> Self {
        Self { rejected: self.rejected + o.rejected, first: self.first.or(o.first) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Sequence, sequence::key};

    /// For independent samples the stated error is the true one: chi-square over 400 repetitions
    /// of 64 uniform samples; the ratio of mean squares lies within 15 % (three sigma of 400 x 15
    /// degrees of freedom is 8 %).
    #[test]
    fn error_of_independent_samples_is_honest() {
        let (mut stated, mut true_error) = (0.0f64, 0.0f64);
        for r in 0..400u64 {
            let xs: Vec<Vec3> =
                (0..64).map(|i| Vec3::splat(Sequence::new(key(r, 0, i), 0).next4()[0])).collect();
            let (mean, error) = mean_and_error(xs.iter().copied());
            stated += f64::from(error.x).powi(2);
            true_error += (f64::from(mean.x) - 0.5).powi(2);
        }
        let want = 400.0 / 12.0 / 64.0;
        assert!((stated / want - 1.0).abs() < 0.15, "{stated} {want}");
        assert!((true_error / want - 1.0).abs() < 0.25, "{true_error} {want}");
    }

    /// The mean square of the halves is the variance of the mean, for even and odd numbers of independent samples.
    #[test]
    fn halves_tell_the_variance() {
        for n in [2, 3, 9, 64] {
            let squares: f64 = (0..2000u64)
                .map(|r| {
                    let xs: Vec<f32> = (0..n).map(|i| Sequence::new(key(r, n, i), 0).next4()[0]).collect();
                    f64::from(halves(xs.into_iter())).powi(2)
                })
                .sum();
            let want = 2000.0 / 12.0 / n as f64;
            // Three sigma of 2000 squares of normal deviates is 9 %.
            assert!((squares / want - 1.0).abs() < 0.12, "{n}: {squares} {want}");
        }
        assert_eq!(halves([3.0].into_iter()), 3.0);
        assert_eq!(halves([].into_iter()), 0.0);
    }

    #[test]
    fn odd_counts_and_few_samples() {
        for n in [1, 2, 3, 15, 17, 100] {
            let xs: Vec<Vec3> = (0..n).map(|i| Vec3::splat(i as f32)).collect();
            let (mean, error) = mean_and_error(xs.iter().copied());
            assert_eq!(mean.x, (n - 1) as f32 / 2.0);
            assert!(error.is_finite() && (n == 1 || 0.0 < error.x));
        }
        assert_eq!(
            mean_and_error(std::iter::empty::<Vec3>().take(0).collect::<Vec<_>>().into_iter()).0,
            Vec3::ZERO
        );
    }

    #[test]
    fn the_gate_counts_and_names() {
        let mut g = Gate::default();
        let at = |sample| Rejected { page: 1, texel: 7, kind: Kind::Path, sample };
        assert_eq!(g.admit(Vec3::ONE, at(0)), Vec3::ONE);
        assert_eq!(g.admit(Vec3::new(1.0, f32::NAN, 0.0), at(1)), Vec3::ZERO);
        assert_eq!(g.admit(Vec3::splat(f32::INFINITY), at(2)), Vec3::ZERO);
        assert_eq!(g.admit(Vec3::new(0.0, 0.0, 3e38), at(3)), Vec3::ZERO);
        assert_eq!(g, Gate { rejected: 3, first: Some(at(1)) });
    }

    /// What is printed is what is read, and nothing else is.
    #[test]
    fn names_of_samples_are_read_again() {
        for kind in Kind::ALL {
            let at = Rejected { page: 2, texel: u32::MAX, kind, sample: 7 };
            assert_eq!(at.to_string().parse(), Ok(at));
        }
        for bad in
            ["", "0:1:path", "0:1:path:2:3", "0:1:walk:2", "-1:1:path:2", "0:1:path:4294967296", "a:1:path:2"]
        {
            let e = bad.parse::<Rejected>().expect_err(bad);
            assert!(e.contains("PAGE:TEXEL:KIND:SAMPLE"), "{e}");
        }
    }
}
