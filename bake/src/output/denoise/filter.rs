//! Weighted means of texels whose weights go both ways.

use super::places::Places;
use glam::Vec3;

/// Layers that one part of the light has: its value and the share of it that is split off. More layers, such as the light's
/// directions, are filtered with the same weights when they are added here.
pub(super) const LAYERS: usize = 2;

/// Which texels are alike.
///
/// The squared difference of two values, as a part of the variance that noise gives it, channel by channel: 1 on
/// average where only noise parts them, and far beyond where an edge does.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alike<'a> {
    /// Values, any unit.
    pub(super) value: &'a [Vec3],
    /// Their variances.
    pub(super) variance: &'a [Vec3],
    /// Standard deviations at which two texels are taken for different.
    pub(super) limit: f32,
}

impl Alike<'_> {
    /// 0 for equal values, 1 where they differ by `limit` standard deviations. What has no noise differs if it differs at all.
    #[inline]
    fn difference(&self, i: usize, j: usize) -> f32 {
        let apart = self.value[i] - self.value[j];
        let variance = self.variance[i] + self.variance[j];
        let mut sum = 0.0;
        for (d, v) in apart.to_array().into_iter().zip(variance.to_array()) {
            let d = d * d;
            if 0.0 < d {
                sum += d / v;
            }
        }
        sum / (3.0 * self.limit * self.limit)
    }
}

/// How much one texel counts for another: the same both ways.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernel<'a> {
    /// The texels.
    pub(super) places: &'a Places<'a>,
    /// All have to find two texels alike.
    pub(super) alike: &'a [Alike<'a>],
    /// How far each texel may look, texels; of two texels the lesser counts.
    pub(super) radius: &'a [f32],
}

impl Kernel<'_> {
    /// `f(other, weight)` for every other place that counts for place `i`.
    #[inline]
    fn each(&self, i: usize, near: &super::places::Near<'_>, mut f: impl FnMut(usize, f32)) {
        if self.radius[i] <= 0.0 {
            return;
        }
        near.each(i, self.radius[i], |j, squared, surface| {
            let radius = self.radius[i].min(self.radius[j]);
            let space = 1.0 - squared / (radius * radius);
            // With a radius of 0 it is negative or not a number.
            if 0.0 < space {
                let x: f32 = self.alike.iter().map(|a| a.difference(i, j)).sum();
                if x < 1.0 {
                    f(j, space * surface * (1.0 - x) * (1.0 - x));
                }
            }
        });
    }

    /// Scales weights by a factor for each of both texels so that those of every texel add up to nearly 1, itself with a
    /// weight of 1 included.
    ///
    /// \[SK67\] Sinkhorn and Knopp, "Concerning nonnegative matrices and doubly stochastic matrices", 1967, in its symmetric form.
    fn balance(&self, steps: u32) -> Balance {
        let mut factor = vec![1.0_f32; self.places.len()];
        for step in 0.. {
            let sum = self.places.map(|i, near| {
                let mut sum = factor[i];
                self.each(i, near, |j, w| sum += w * factor[j]);
                sum * factor[i]
            });
            if step == steps {
                return Balance { factor, sum };
            }
            factor.iter_mut().zip(&sum).for_each(|(f, s)| *f /= s.sqrt());
        }
        unreachable!("the last step returns")
    }

    /// Filters the layers of texels with the given variances.
    ///
    /// What one texel takes from another, the other takes from it with the same weight: the sum over all texels stays as
    /// it was, whatever the weights are and whatever they depend on. The weights of no texel add up to more
    /// than 1, and what is missing stays with its own value: nothing becomes negative.
    pub(super) fn apply(&self, steps: u32, layers: &[[Vec3; LAYERS]], variance: &[Vec3]) -> Vec<Filtered> {
        let Balance { factor, sum } = self.balance(steps);
        self.places.map(|i, near| {
            let own = layers[i];
            let mut change = [Vec3::ZERO; LAYERS];
            let (mut spread, mut rest) = (Vec3::ZERO, 1.0_f32);
            self.each(i, near, |j, w| {
                let w = w * (factor[i] * factor[j]) / sum[i].max(sum[j]).max(1.0);
                rest -= w;
                spread += w * w * variance[j];
                for (change, (other, own)) in change.iter_mut().zip(layers[j].iter().zip(&own)) {
                    *change += w * (other - own);
                }
            });
            let rest = rest.max(0.0);
            Filtered {
                layers: std::array::from_fn(|l| (own[l] + change[l]).max(Vec3::ZERO)),
                variance: spread + rest * rest * variance[i],
                own: rest,
            }
        })
    }
}

/// See [`Kernel::balance`].
struct Balance {
    factor: Vec<f32>,
    /// What the weights of each texel add up to with the factors.
    sum: Vec<f32>,
}

/// A texel after filtering.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Filtered {
    /// Its light.
    pub(super) layers: [Vec3; LAYERS],
    /// Variance of the first layer.
    pub(super) variance: Vec3,
    /// Weight of its own value.
    pub(super) own: f32,
}
