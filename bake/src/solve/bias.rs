//! What of a map's error more samples would not help against: some of its texels gathered by unbiased paths.
//!
//! Standard errors know noise. A rung of media that leaves something out, the light grid, the irradiance cache and a limit of
//! reflections are off by the same whatever the seed. A handful of texels spread evenly over all pages is gathered by paths that scatter in
//! media, end nowhere but at the last reflection, and have random numbers of their own; their difference from the map is
//! bias and the noise of both, of which the noise is known.

use crate::error::Error;
use crate::geom::texel::{TexelMap, TexelSampler};
use crate::geom::world::luminance;
use crate::sample::sequence::mix64;
use crate::solve::Monitor;
use crate::solve::lightmap::{self, Solution};
use crate::solve::visible::Validity;
use crate::transport::Kernel;
use rayon::prelude::*;

/// Samples of a texel at first, of each kind; as many again follow until [`GOAL`] is reached.
const FIRST: u32 = 256;

/// Samples of a texel at most.
const MOST: u32 = 1 << 15;

/// Standard error at which a texel is known well enough, as a part of its value.
const GOAL: f32 = 0.01;

/// Random numbers of these paths are those of this seed.
const SEED: u64 = 0x4249_4153;

/// Texels beside what unbiased paths say of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bias {
    /// The texels, page by page.
    pub pairs: Vec<Pair>,
}

/// Luminances of a texel, nits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pair {
    /// Of the map.
    pub map: f64,
    /// Its standard error.
    pub map_std_err: f64,
    /// By unbiased paths.
    pub truth: f64,
    /// Its standard error.
    pub truth_std_err: f64,
}

/// Bias of a map as a part of the mean of the texels that were looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Texels that were looked at.
    pub texels: usize,
    /// Of the mean.
    pub mean: f64,
    /// Its standard error, from the spread over the texels.
    pub mean_std_err: f64,
    /// Root mean square over texels, without noise; 0 where all is noise.
    pub rms: f64,
    /// Standard error of the square of `rms`, over twice the larger of `rms` and that error's root: how far `rms` can be trusted.
    pub rms_std_err: f64,
    /// What noise alone would make of it, root mean square.
    pub noise: f64,
}

impl Bias {
    /// Gathers `n` of a page's texels again. `unbiased` is a kernel that approximates nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Interrupted`] when the monitor asks to stop.
    pub fn of_page(
        unbiased: &Kernel<'_>,
        map: &TexelMap,
        page: usize,
        (n, seed): (usize, u64),
        solution: &Solution,
        monitor: &Monitor,
    ) -> Result<Self, Error> {
        let texels = &solution.texels;
        let valid: Vec<usize> =
            (0..texels.len()).filter(|&i| texels[i].validity == Validity::Valid).collect();
        let n = n.min(valid.len());
        let pairs: Vec<Option<Pair>> = (0..n)
            .into_par_iter()
            .with_max_len(1)
            .map(|k| {
                // One from each of as many runs of texels that lie beside one another, at any place in the run.
                let (from, to) = (k * valid.len() / n, (k + 1) * valid.len() / n);
                let run = (to - from) as u64;
                #[expect(clippy::cast_possible_truncation, reason = "smaller than a length")]
                let index = valid[from + (mix64(seed ^ SEED ^ k as u64) % run) as usize];
                let sampler = TexelSampler::new(map, index);
                let known = &texels[index];
                let id = (page, map.texels[index], mix64(seed ^ SEED));
                let mut samples = FIRST;
                loop {
                    if monitor.stopped() {
                        return None;
                    }
                    let (again, rays) = lightmap::with_samples(unbiased, &sampler, id, known, [samples; 2]);
                    monitor.add(0, rays);
                    let (value, std_err) = (luminance(again.value()), luminance(again.std_err()));
                    if std_err <= GOAL * value || MOST <= samples {
                        return Some(Pair {
                            map: f64::from(luminance(known.value())),
                            map_std_err: solution.factor(known) * f64::from(luminance(known.std_err())),
                            truth: f64::from(value),
                            truth_std_err: f64::from(std_err),
                        });
                    }
                    // Noise falls with the root; a little more, because the next look costs all of it again.
                    let wanted = (std_err / (GOAL * value)).powi(2) * 1.2 * samples as f32;
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "saturates, and is limited"
                    )]
                    let wanted = wanted.min(MOST as f32) as u32;
                    samples = wanted.clamp(2 * samples, MOST);
                }
            })
            .collect();
        if monitor.stopped() {
            return Err(Error::Interrupted);
        }
        Ok(Self { pairs: pairs.into_iter().flatten().collect() })
    }

    /// Both together.
    #[must_use]
    pub fn merge(mut self, o: Self) -> Self {
        self.pairs.extend(o.pairs);
        self
    }

    /// What they say; `None` of fewer than two texels, or where all of them are black.
    #[must_use]
    pub fn figures(&self) -> Option<Figures> {
        let n = self.pairs.len() as f64;
        let mean = self.pairs.iter().map(|p| p.truth).sum::<f64>() / n;
        if n < 2.0 || mean <= 0.0 {
            return None;
        }
        let of = |f: &dyn Fn(&Pair) -> f64| {
            let m = self.pairs.iter().map(f).sum::<f64>() / n;
            let square = self.pairs.iter().map(|p| (f(p) - m).powi(2)).sum::<f64>() / (n - 1.0);
            (m, (square / n).sqrt())
        };
        let variance = |p: &Pair| p.map_std_err.powi(2) + p.truth_std_err.powi(2);
        let (bias, bias_std_err) = of(&|p| p.map - p.truth);
        let (square, square_std_err) = of(&|p| (p.map - p.truth).powi(2) - variance(p));
        let (noise, _) = of(&variance);
        let rms = square.max(0.0).sqrt();
        Some(Figures {
            texels: self.pairs.len(),
            mean: bias / mean,
            mean_std_err: bias_std_err / mean,
            rms: rms / mean,
            rms_std_err: 0.5 * square_std_err / rms.max(square_std_err.sqrt()).max(f64::MIN_POSITIVE) / mean,
            noise: noise.sqrt() / mean,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Sequence, sequence::key};

    fn normal(i: u64, side: u64) -> f64 {
        let u: f32 = (0..3).flat_map(|k| Sequence::new(key(k, side, i), 0).next4()).sum();
        f64::from(u) - 6.0
    }

    /// A map that is 5 % too bright everywhere, with noise of 10 %: the noise does not count.
    #[test]
    fn bias_is_told_from_noise() {
        let pair = |i| Pair {
            map: 10.5 + normal(i, 0),
            map_std_err: 1.0,
            truth: 10.0 + 0.2 * normal(i, 1),
            truth_std_err: 0.2,
        };
        let f = Bias { pairs: (0..2000).map(pair).collect() }.figures().expect("figures");
        assert!((f.mean - 0.05).abs() < 4.0 * f.mean_std_err && f.mean_std_err < 0.003, "{f:?}");
        assert!((f.rms - 0.05).abs() < 4.0 * f.rms_std_err && f.rms_std_err < 0.01, "{f:?}");
        assert!((f.noise - 0.102).abs() < 0.002, "{f:?}");
    }

    #[test]
    fn noise_alone_is_no_bias() {
        let pair = |i| Pair { map: 10.0 + normal(i, 0), map_std_err: 1.0, truth: 10.0, truth_std_err: 0.0 };
        let f = Bias { pairs: (0..400).map(pair).collect() }.figures().expect("figures");
        assert!(f.mean.abs() < 4.0 * f.mean_std_err && f.rms <= 4.0 * f.rms_std_err, "{f:?}");
        assert_eq!(Bias::default().figures(), None);
        assert_eq!(Bias { pairs: vec![Pair::default(); 9] }.figures(), None);
    }
}
