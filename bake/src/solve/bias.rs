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

/// Samples of a texel, of each kind, that tell how many it needs; it gets at least as many.
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

/// Samples that reach [`GOAL`] where [`FIRST`] gave this value and standard error.
fn enough((value, std_err): (f32, f32)) -> u32 {
    let wanted = (std_err / (GOAL * value)).powi(2) * FIRST as f32;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the range")]
    let samples = wanted.clamp(FIRST as f32, MOST as f32) as u32;
    // Of a black texel nothing is known: NaN became 0.
    if 0.0 < value { samples } else { MOST }
}

/// Luminances of a texel, nits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pair {
    /// Texels of the map that it stands for.
    pub weight: f64,
    /// Of the map.
    pub map: f64,
    /// Its standard error, as its samples say it.
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
    /// The same with two standard errors of its square on top.
    pub rms_at_most: f64,
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
                if monitor.stopped() {
                    return None;
                }
                let look = |turn: u64, samples: u32| {
                    let id = (page, map.texels[index], mix64(seed ^ SEED ^ turn));
                    let (texel, rays) = lightmap::with_samples(unbiased, &sampler, id, known, [samples; 2]);
                    monitor.add(0, rays);
                    (luminance(texel.value()), luminance(texel.std_err()))
                };
                // Samples that decide how many there are must not count: those that missed what is rare would end too soon.
                let samples = enough(look(0, FIRST));
                let (value, std_err) = look(1, samples);
                Some(Pair {
                    weight: valid.len() as f64 / n as f64,
                    map: f64::from(luminance(known.value())),
                    map_std_err: f64::from(luminance(known.std_err())),
                    truth: f64::from(value),
                    truth_std_err: f64::from(std_err),
                })
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
        let all = self.pairs.iter().map(|p| p.weight).sum::<f64>();
        let mean = self.pairs.iter().map(|p| p.weight * p.truth).sum::<f64>() / all;
        let n = self.pairs.len();
        let known = 2 <= n && 0.0 < mean;
        if !known {
            return None;
        }
        // Weighted mean and its standard error.
        let of = |f: &dyn Fn(&Pair) -> f64| {
            let m = self.pairs.iter().map(|p| p.weight * f(p)).sum::<f64>() / all;
            let square = self.pairs.iter().map(|p| (p.weight * (f(p) - m)).powi(2)).sum::<f64>();
            (m, (square * n as f64 / (n - 1) as f64).sqrt() / all)
        };
        let variance = |p: &Pair| p.map_std_err.powi(2) + p.truth_std_err.powi(2);
        let (bias, bias_std_err) = of(&|p| p.map - p.truth);
        let (square, square_std_err) = of(&|p| (p.map - p.truth).powi(2) - variance(p));
        let (noise, _) = of(&variance);
        let root = |square: f64| square.max(0.0).sqrt() / mean;
        Some(Figures {
            texels: n,
            mean: bias / mean,
            mean_std_err: bias_std_err / mean,
            rms: root(square),
            rms_at_most: root(square.max(0.0) + 2.0 * square_std_err),
            noise: root(noise),
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
            weight: 1.0,
            map: 10.5 + normal(i, 0),
            map_std_err: 1.0,
            truth: 10.0 + 0.2 * normal(i, 1),
            truth_std_err: 0.2,
        };
        let f = Bias { pairs: (0..2000).map(pair).collect() }.figures().expect("figures");
        assert!((f.mean - 0.05).abs() < 4.0 * f.mean_std_err && f.mean_std_err < 0.003, "{f:?}");
        assert!((f.rms - 0.05).abs() < 0.02 && 0.05 < f.rms_at_most && f.rms_at_most < 0.07, "{f:?}");
        assert!((f.noise - 0.102).abs() < 0.002, "{f:?}");
    }

    /// Pages with few texels count for few.
    #[test]
    fn texels_count_as_many_as_they_stand_for() {
        let pair = |weight, map| Pair { weight, map, truth: 1.0, ..Pair::default() };
        let f = Bias { pairs: vec![pair(9.0, 1.0), pair(1.0, 2.0)] }.figures().expect("figures");
        assert!((f.mean - 0.1).abs() < 1e-12, "{f:?}");
    }

    #[test]
    fn samples_are_as_many_as_the_goal_needs() {
        assert_eq!(enough((1.0, 0.001)), FIRST);
        assert_eq!(enough((1.0, 0.02)), 4 * FIRST);
        assert_eq!([enough((1.0, 0.09)), enough((1.0, 5.0)), enough((0.0, 0.0))], [81 * FIRST, MOST, MOST]);
    }

    #[test]
    fn noise_alone_is_no_bias() {
        let pair = |i| Pair {
            weight: 2.0,
            map: 10.0 + normal(i, 0),
            map_std_err: 1.0,
            truth: 10.0,
            truth_std_err: 0.0,
        };
        let f = Bias { pairs: (0..400).map(pair).collect() }.figures().expect("figures");
        assert!(f.mean.abs() < 4.0 * f.mean_std_err && f.rms < 0.06 && f.rms_at_most < 0.07, "{f:?}");
        assert_eq!(Bias::default().figures(), None);
        assert_eq!(Bias { pairs: vec![Pair::default(); 9] }.figures(), None);
    }
}
