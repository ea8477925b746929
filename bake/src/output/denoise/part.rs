//! Filters one part of the light of all texels.

use super::filter::{Alike, Filtered, Kernel, LAYERS};
use super::places::Places;
use crate::geom::world::luminance;
use glam::Vec3;

/// How one part is filtered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Method {
    /// Radii that a texel may choose from, texels, ascending.
    pub(super) radii: &'static [f32],
    /// Whether texels are compared after a first filter instead of as they are.
    pub(super) guided: bool,
    /// Steps of [`Kernel::apply`].
    steps: u32,
}

/// One small neighbourhood, or none.
pub(super) const DRAFT: Method = Method { radii: &[GUIDE_RADIUS], guided: false, steps: 1 };

/// A large neighbourhood, a small one, or none, by what a first filter has found.
pub(super) const FINAL: Method = Method { radii: &[3.0, 8.0], guided: true, steps: 1 };

/// Radius of the first filter, texels.
const GUIDE_RADIUS: f32 = 3.0;

/// Standard deviations at which texels are different as they are. Fewer would mostly choose texels whose noise
/// is alike, which does not take it out.
const NOISY_LIMIT: f32 = 6.0;

/// The same where no second filter follows that is more careful.
const DRAFT_LIMIT: f32 = 4.0;

/// Standard deviations at which texels are different after a first filter, together with [`NOISY_LIMIT`], which keeps the
/// first filter's blur from reaching over what is plainly an edge.
const GUIDED_LIMIT: f32 = 3.0;

/// Radius within which errors and variances are averaged, texels.
pub(super) const POOL: f32 = 4.0;

/// Radius within which a texel's variance is at least the mean, texels: its eight neighbours.
const SMOOTH: f32 = 1.6;

/// Texels' worth of the page's own ratio of variances beside that of the neighbourhood.
const PRIOR: f32 = 8.0;

/// Range of the ratio between the variance that halves and blocks of samples tell.
const RATIO: [f32; 2] = [0.02, 2.0];

/// A larger radius is chosen even where it seems to be worse than the best one by this part of the variance: estimates of errors are
/// noisy themselves, and texels that choose at random take little from one another.
const TOLERANCE: f32 = 0.2;

/// One part of the light as it was gathered, in the order of places, relative to a power of two.
#[derive(Debug)]
pub(super) struct Part {
    /// Its layers; the first one is the value that decides.
    pub(super) layers: Vec<[Vec3; LAYERS]>,
    /// Variance of the value as blocks of samples tell it.
    pub(super) variance: Vec<Vec3>,
    /// See [`crate::solve::lightmap::Gathered::halves`].
    pub(super) halves: Vec<f32>,
    /// A texel stays as it is unless filtering leaves less than this part of its variance.
    pub(super) worth: f32,
}

/// One texel's part after denoising.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Clean {
    /// Its layers.
    pub(super) layers: [Vec3; LAYERS],
    /// Estimated mean squared error of the value's luminance.
    pub(super) error: f32,
}

impl Part {
    /// Filters it.
    pub(super) fn denoise(mut self, places: &Places<'_>, method: Method) -> Vec<Clean> {
        if self.variance.iter().all(|v| *v == Vec3::ZERO) {
            return self.layers.into_iter().map(|layers| Clean { layers, error: 0.0 }).collect();
        }
        self.calibrate(places);
        let value: Vec<Vec3> = self.layers.iter().map(|l| l[0]).collect();
        let smooth = smoothed(places, &self.variance);
        let as_is = Alike { value: &value, variance: &smooth, limit: NOISY_LIMIT };
        // What no path has found any light in stays black, however near the light is.
        let black: Vec<bool> =
            smooth.iter().zip(&value).map(|(v, x)| *v == Vec3::ZERO && *x == Vec3::ZERO).collect();
        if !method.guided {
            let as_is = Alike { limit: DRAFT_LIMIT, ..as_is };
            return self.best(places, method, &black, &[as_is]);
        }
        let radius = radii(&black, GUIDE_RADIUS);
        let first = Kernel { places, alike: &[as_is], radius: &radius };
        // The variance that goes with the guide is that of the smoothed variances: a texel that is certain by luck is not.
        let (guide, certainty): (Vec<Vec3>, Vec<Vec3>) =
            first.apply(0, &self.layers, &smooth).into_iter().map(|f| (f.layers[0], f.variance)).unzip();
        drop(radius);
        let guided = Alike { value: &guide, variance: &certainty, limit: GUIDED_LIMIT };
        self.best(places, method, &black, &[guided, as_is])
    }

    /// Scales variances so that on average over a neighbourhood they are those that the halves of the samples tell.
    fn calibrate(&mut self, places: &Places) {
        let blocks: Vec<f32> = self.variance.iter().map(|v| squared_error(*v)).collect();
        let halves: Vec<f32> = self.halves.iter().map(|h| h * h).collect();
        let sum = |x: &[f32]| x.iter().map(|x| f64::from(*x)).sum::<f64>();
        #[expect(clippy::cast_possible_truncation, reason = "a ratio within limits")]
        let overall = ratio(sum(&halves), sum(&blocks)) as f32;
        let factors = places.map(|i, near| {
            let (mut b, mut h, mut n) = (blocks[i], halves[i], 1.0);
            near.each(i, POOL, |j, squared, surface| {
                let w = surface * (1.0 - squared / (POOL * POOL));
                (b, h, n) = (b + w * blocks[j], h + w * halves[j], n + w);
            });
            let here = if 0.0 < b { h / b } else { overall };
            ((n * here + PRIOR * overall) / (n + PRIOR)).clamp(RATIO[0], RATIO[1])
        });
        self.variance.iter_mut().zip(factors).for_each(|(v, f)| *v *= f);
    }

    /// Filters with the radius that seems best for each texel.
    fn best(&self, places: &Places<'_>, method: Method, black: &[bool], alike: &[Alike<'_>]) -> Vec<Clean> {
        let noise: Vec<f32> = self.variance.iter().map(|v| squared_error(*v)).collect();
        let left = pooled(places, &noise);
        let errors: Vec<Vec<f32>> = method
            .radii
            .iter()
            .map(|&r| {
                let radius = radii(black, r);
                let kernel = Kernel { places, alike, radius: &radius };
                // Fewer steps than below: the choice does not need the last percent.
                self.errors(places, &noise, &kernel.apply(0, &self.layers, &self.variance))
            })
            .collect();
        let radius: Vec<f32> = (0..places.len())
            .map(|i| {
                let least = errors.iter().map(|e| e[i]).fold(left[i], f32::min);
                let good = |e: &f32| *e < self.worth * left[i] && *e <= least + TOLERANCE * left[i];
                let chosen = errors.iter().zip(method.radii).rev().find(|(e, _)| good(&e[i]));
                chosen.filter(|_| !black[i]).map_or(0.0, |(_, r)| *r)
            })
            .collect();
        drop(errors);
        let kernel = Kernel { places, alike, radius: &radius };
        let filtered = kernel.apply(method.steps, &self.layers, &self.variance);
        let errors = self.errors(places, &noise, &filtered);
        let clean =
            |(f, e): (Filtered, f32)| Clean { layers: f.layers, error: e.max(squared_error(f.variance)) };
        filtered.into_iter().zip(errors).map(clean).collect()
    }

    /// Estimated mean squared error of every texel after filtering, blur included.
    ///
    /// \[Ste81\] Stein, "Estimation of the mean of a multivariate normal distribution", 1981: the squared change, less the noise, plus
    /// twice the noise that is left of a texel in itself, is right on average. One texel says little, so it is averaged around each.
    fn errors(&self, places: &Places<'_>, noise: &[f32], filtered: &[Filtered]) -> Vec<f32> {
        let each = |(i, f): (usize, &Filtered)| {
            let change = luminance(f.layers[0] - self.layers[i][0]);
            change * change + (2.0 * f.own - 1.0) * noise[i]
        };
        let each: Vec<f32> = filtered.iter().enumerate().map(each).collect();
        pooled(places, &each)
    }
}

/// The same radius for all but those that are black.
fn radii(black: &[bool], radius: f32) -> Vec<f32> {
    black.iter().map(|black| if *black { 0.0 } else { radius }).collect()
}

/// Squared standard error of luminance: the channels of a texel err alike.
fn squared_error(variance: Vec3) -> f32 {
    let e = luminance(variance.map(f32::sqrt));
    e * e
}

fn ratio(a: f64, b: f64) -> f64 {
    if 0.0 < b { a / b } else { 1.0 }
}

/// Mean over the neighbourhood of every texel.
fn pooled(places: &Places<'_>, x: &[f32]) -> Vec<f32> {
    places.map(|i, near| {
        let (mut sum, mut n) = (x[i], 1.0);
        near.each(i, POOL, |j, squared, surface| {
            let w = surface * (1.0 - squared / (POOL * POOL));
            (sum, n) = (sum + w * x[j], n + w);
        });
        sum / n
    })
}

/// The variance of each texel or that of its neighbours, whichever is greater: a texel whose few samples happened to agree knows less
/// than it says. Neighbours are those of the same chart: what is black behind a wall knows it whatever is before the wall.
fn smoothed(places: &Places<'_>, variance: &[Vec3]) -> Vec<Vec3> {
    places.map(|i, near| {
        let (mut sum, mut n) = (variance[i], 1.0);
        near.each(i, SMOOTH, |j, _, _| {
            if places.share_chart(i, j) {
                (sum, n) = (sum + variance[j], n + 1.0);
            }
        });
        variance[i].max(sum / n)
    })
}
