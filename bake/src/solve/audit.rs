//! Whether stated errors hold: a sample of texels gathered once more, without what may be wrong.
//!
//! The spread of a texel's samples says too much about its error where stratification works, too little where light comes
//! by rare bright paths, and nothing about the irradiance cache. So some texels of each page are gathered
//! again, by paths that use no cache and with other random numbers, and the page's errors are scaled by
//! the factors with which the intervals of 95 % hold there: one factor for each of a few classes of texels from
//! smooth to noisy, because the three faults are not equally common in them.
//!
//! The root mean square over all texels is decided by the few noisiest, which such a sample misses. Where sampling ends by it,
//! texels are drawn once more with chances in proportion to the square that each is stated to add.

use crate::error::Error;
use crate::geom::texel::{TexelMap, TexelSampler};
use crate::geom::world::luminance;
use crate::sample::sequence::mix64;
use crate::solve::Monitor;
use crate::solve::lightmap::{self, Texel};
use crate::solve::visible::Validity;
use crate::transport::Kernel;
use rayon::prelude::*;
use tables::num::moments::Moments;

/// Classes of texels, by the part of them that is noisier than the class: half of a page is its smoothest class.
///
/// The noisiest fortieth, the edges of shadows and the fireflies, is not audited: what is seen there in so few texels is
/// chance, and the mean square of the stated errors, which the map's error consists of, is right as it stands.
const CLASSES: [f64; 3] = [0.5, 0.15, 0.025];

/// Texels of a class that are gathered again at most: their percentile is known to about 10 %.
const TEXELS: usize = 128;

/// At least this many texels stand behind each of them, so that an audit costs little.
const ONE_IN: usize = 32;

/// Audits of fewer texels say too little.
const FEWEST: usize = 32;

/// Part of the mean luminance below which errors are not weighed by the texel's own luminance.
const DIM: f64 = 1e-3;

/// Each of the two times that a texel is gathered again takes this many times its samples.
const TIMES: u32 = 2;

/// How often a texel is gathered again: twice tells how good the audit itself is.
const AGAIN: usize = 2;

/// Percentile that decides: one more than the interval is meant to hold, because the factor is itself uncertain.
const PERCENT: usize = 96;

/// Half the width of a 95 % interval in standard errors, for normal deviates.
const WIDTH: f64 = 1.96;

/// Range of the factor. Further off, a handful of texels would decide.
const RANGE: [f64; 2] = [0.25, 4.0];

/// Texels whose squared errors are measured: with two gatherings of a texel the deviation of a square is about 2.2 of it for normal
/// deviates, so that the root of the mean of so many is known to 8 %.
const SQUARES: usize = 192;

/// Part of them that is drawn evenly: a texel that is stated to be without noise may have some.
const EVENLY: f64 = 0.1;

/// Result of an audit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Audit {
    /// From the smoothest to the noisiest.
    pub classes: Vec<Class>,
    /// Luminance that is added to a texel's when its error is weighed, nits.
    dim: f64,
    /// Mean luminance of the map minus that of the audit, nits: what the cache does to the mean.
    pub bias: f64,
    /// Standard error of `bias`, nits.
    pub bias_std_err: f64,
    /// Mean square of the errors that were found, the cache's among them, as a part of what the texels' errors say when they are
    /// multiplied by their factors.
    pub squares: Option<f64>,
}

/// Texels that are about equally noisy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Class {
    /// Greatest stated error, as a part of the texel's luminance.
    pub up_to: f64,
    /// Texels gathered again.
    pub audited: usize,
    /// By what errors are multiplied.
    pub factor: f64,
}

impl Audit {
    /// By what the error of a texel is multiplied.
    #[must_use]
    pub fn factor(&self, texel: &Texel) -> f64 {
        let noise = noise(texel, self.dim);
        self.classes.iter().find(|c| noise <= c.up_to).map_or(1.0, |c| c.factor)
    }
}

/// A texel's stated error as a part of its luminance.
fn noise(texel: &Texel, dim: f64) -> f64 {
    let value = f64::from(luminance(texel.value())) + dim;
    if 0.0 < value { f64::from(luminance(texel.std_err())) / value } else { 0.0 }
}

/// Audits a page. `unbiased` is the kernel without its cache; `None` where there are too few lit texels.
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn audit(
    unbiased: &Kernel<'_>,
    map: &TexelMap,
    page: usize,
    seed: u64,
    texels: &[Texel],
    monitor: &Monitor,
) -> Result<Option<Audit>, Error> {
    let valid: Vec<usize> = (0..texels.len()).filter(|&i| texels[i].validity == Validity::Valid).collect();
    let mean = valid.iter().map(|&i| f64::from(luminance(texels[i].value()))).sum::<f64>()
        / valid.len().max(1) as f64;
    let dim = DIM * mean;
    let mut ranked: Vec<(f64, usize)> = valid.iter().map(|&i| (noise(&texels[i], dim), i)).collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let few = ranked.len() < 4 * ONE_IN * FEWEST;
    let mut audit = Audit { dim, ..Audit::default() };
    let mut variance = 0.0;
    let mut from = 0;
    for &behind in if few { &[0.0][..] } else { &CLASSES[..] } {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a length")]
        let to = ranked.len() - (behind * ranked.len() as f64) as usize;
        let class = &ranked[from..to];
        let n = TEXELS.min(class.len() / ONE_IN);
        let asked: Vec<[Texel; 1 + AGAIN]> = (0..n)
            .into_par_iter()
            .with_max_len(1)
            .filter(|_| !monitor.stopped())
            .map(|k| {
                // One from each of as many runs, but not always the same place in the run.
                let (from, to) = (k * class.len() / n, (k + 1) * class.len() / n);
                #[expect(clippy::cast_possible_truncation, reason = "smaller than a length")]
                let (_, index) = class[from + (mix64(seed ^ k as u64) % (to - from) as u64) as usize];
                let sampler = TexelSampler::new(map, index);
                let again = |turn: u64| {
                    let id = (page, map.texels[index], mix64(seed ^ turn));
                    let (again, rays) = lightmap::again(unbiased, &sampler, id, &texels[index], TIMES);
                    monitor.add(0, rays);
                    again
                };
                [texels[index], again(1), again(2)]
            })
            .collect();
        if monitor.stopped() {
            return Err(Error::Interrupted);
        }
        let (factor, difference) = judge(&asked);
        let up_to = class.last().map_or(0.0, |c| c.0);
        audit.classes.extend(factor.map(|factor| Class { up_to, audited: n, factor }));
        let part = class.len() as f64 / ranked.len().max(1) as f64;
        audit.bias += part * difference.mean;
        variance += (part * difference.std_err()).powi(2);
        from = to;
    }
    audit.bias_std_err = variance.sqrt();
    Ok((!audit.classes.is_empty()).then_some(audit))
}

/// The mean squared error of the page as a part of what is stated: [`Audit::squares`]. The product of a texel's distances from two
/// gatherings, whose errors are independent, has its squared error as mean, whatever theirs are. `turn` numbers the
/// calls, each of which gathers anew. `None` where nothing is stated.
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn squares(
    unbiased: &Kernel<'_>,
    map: &TexelMap,
    (page, seed, turn): (usize, u64, u64),
    (texels, audit): (&[Texel], Option<&Audit>),
    monitor: &Monitor,
) -> Result<Option<f64>, Error> {
    let valid: Vec<usize> = (0..texels.len()).filter(|&i| texels[i].validity == Validity::Valid).collect();
    let stated = |i: &usize| {
        let factor = audit.map_or(1.0, |a| a.factor(&texels[*i]));
        (factor * f64::from(luminance(texels[*i].std_err()))).powi(2)
    };
    let all: f64 = valid.iter().map(stated).sum();
    if all <= 0.0 {
        return Ok(None);
    }
    let even = EVENLY / valid.len() as f64;
    let chance = |i: &usize| (1.0 - EVENLY) * stated(i) / all + even;
    let n = SQUARES.min(valid.len());
    // One from each of as many parts of equal chance.
    let start = (mix64(seed ^ turn) >> 11) as f64 * 2.0_f64.powi(-53);
    let (mut drawn, mut sum) = (Vec::with_capacity(n), 0.0);
    for i in &valid {
        sum += n as f64 * chance(i);
        while drawn.len() < n && drawn.len() as f64 + start < sum {
            drawn.push(*i);
        }
    }
    let value = |t: &Texel| f64::from(luminance(t.value()));
    let found: Vec<f64> = drawn
        .into_par_iter()
        .enumerate()
        .with_max_len(1)
        .filter(|_| !monitor.stopped())
        .map(|(k, index)| {
            let sampler = TexelSampler::new(map, index);
            let again = |which: u64| {
                // A texel that is drawn twice brings two squares.
                let seed = mix64(mix64(seed ^ k as u64) ^ (2 + 2 * turn + which));
                let id = (page, map.texels[index], seed);
                let (again, rays) = lightmap::again(unbiased, &sampler, id, &texels[index], 1);
                monitor.add(0, rays);
                value(&texels[index]) - value(&again)
            };
            again(1) * again(2) / chance(&index)
        })
        .collect();
    if monitor.stopped() {
        return Err(Error::Interrupted);
    }
    let mean = found.iter().sum::<f64>() / n as f64;
    Ok(Some((mean / all).clamp(RANGE[0].powi(2), RANGE[1].powi(2))))
}

/// About how much an audit costs, as a part of all samples of a page with so many texels.
#[must_use]
pub fn share(texels: usize) -> f64 {
    let again = (CLASSES.len() * TEXELS).min(texels / ONE_IN) as f64;
    UNCACHED * f64::from(TIMES) * AGAIN as f64 * again / texels.max(1) as f64
}

/// Cost of a path without the cache; measured 1.3 to 2 times that of one with it.
const UNCACHED: f64 = 1.7;

/// What texels and their audits say: the factor, unless there are too few, and the differences in nits.
///
/// The factor `f` is such that for 95 % of the texels the difference lies within 1.96 of the joint error of the texel,
/// scaled by `f`, and of its audit, scaled by what the audit's two halves say of themselves.
fn judge(asked: &[[Texel; 1 + AGAIN]]) -> (Option<f64>, Moments) {
    let value = |t: &Texel| f64::from(luminance(t.value()));
    let square = |t: &Texel| f64::from(luminance(t.std_err())).powi(2);
    let mut difference = Moments::default();
    let mut halves = Vec::with_capacity(asked.len());
    let mut seen = Vec::with_capacity(asked.len());
    for [known, a, b] in asked {
        let d = value(known) - 0.5 * (value(a) + value(b));
        difference.push(d);
        // What is black each time says nothing.
        let (own, again) = (square(known), 0.25 * (square(a) + square(b)));
        if d != 0.0 || own + again != 0.0 {
            halves.push(ratio((value(a) - value(b)).powi(2), square(a) + square(b)));
            seen.push((d * d, own, again));
        }
    }
    if seen.len() < FEWEST {
        return (None, difference);
    }
    let audit = percentile(halves) / (WIDTH * WIDTH);
    let audit = audit.clamp(RANGE[0].powi(2), RANGE[1].powi(2));
    let needed =
        seen.iter().map(|(d2, own, again)| ratio(d2 / (WIDTH * WIDTH) - audit * again, *own)).collect();
    (Some(percentile(needed).max(0.0).sqrt().clamp(RANGE[0], RANGE[1])), difference)
}

/// A quotient that is large where only the denominator is 0, and 0 where the numerator is not positive.
fn ratio(a: f64, b: f64) -> f64 {
    match (0.0 < a, 0.0 < b) {
        (false, _) => 0.0,
        (true, false) => f64::INFINITY,
        (true, true) => a / b,
    }
}

fn percentile(mut list: Vec<f64>) -> f64 {
    list.sort_by(f64::total_cmp);
    list[list.len() * PERCENT / 100]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Sequence, sequence::key};
    use crate::solve::lightmap::Gathered;
    use glam::Vec3;

    /// Normal deviates, stated with an error of 1: the texel's of the given size, its audit's half as large as stated.
    fn asked(n: u32, size: f32) -> Vec<[Texel; 3]> {
        let texel = |i: u32, side: u64, size: f32| {
            let u: f32 = (0..3).flat_map(|k| Sequence::new(key(k, side, u64::from(i)), 0).next4()).sum();
            let mut t = Texel::default();
            t.paths = Gathered {
                mean: Vec3::splat(100.0 + size * (u - 6.0)),
                std_err: Vec3::ONE,
                samples: 16,
                ..Gathered::default()
            };
            t
        };
        (0..n).map(|i| [texel(i, 0, size), texel(i, 1, 0.5), texel(i, 2, 0.5)]).collect()
    }

    #[test]
    fn the_factor_is_how_far_off_the_errors_are() {
        for size in [0.5, 1.0, 2.5] {
            let (factor, bias) = judge(&asked(4000, size));
            // 2.05 of 1.96: the 96th percentile of normal deviates.
            let want = f64::from(size) * 2.054 / WIDTH;
            assert!((factor.expect("enough") / want - 1.0).abs() < 0.07, "{size}: {factor:?}");
            assert!(bias.mean.abs() < 4.0 * bias.std_err(), "{bias:?}");
        }
    }

    /// A texel takes the factor of the first class that is as noisy; beyond the last one errors stay.
    #[test]
    fn classes_are_told_apart_by_noise() {
        let class = |up_to, factor| Class { up_to, audited: 100, factor };
        let audit = Audit { classes: vec![class(0.01, 0.5), class(0.2, 1.5)], ..Audit::default() };
        let factor = |std_err: f32| {
            let mut t = Texel::default();
            t.paths = Gathered {
                mean: Vec3::ONE,
                std_err: Vec3::splat(std_err),
                samples: 16,
                ..Gathered::default()
            };
            audit.factor(&t)
        };
        assert_eq!([0.0, 0.005, 0.1, 0.5].map(factor), [0.5, 0.5, 1.5, 1.0]);
    }

    #[test]
    fn few_texels_and_black_ones_say_nothing() {
        assert!(judge(&asked(10, 1.0)).0.is_none());
        assert!(judge(&vec![[Texel::default(); 3]; 1000]).0.is_none());
    }
}
