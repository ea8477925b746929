//! Light of a point emitter that was scattered twice and more often, for any g.
//!
//! In Fourier space the Legendre moments f_l(k) of the transport equation obey a three-term recurrence, whose decaying solution is a
//! continued fraction. An order of scattering is a coefficient of their power series in the albedo, so the fraction is evaluated in
//! truncated power series. The way back is
//! L_l(D) = norm_l 2 / pi * integral over k of k^2 j_l(k D) f_l(k),
//! with the orders 0 and 1 taken out, because they decay too slowly and are known. Where it oscillates, the path of integration is
//! turned into the upper half plane, where the Bessel function decays instead: at small distances from k D = 10 on, at large ones
//! from the start, along a hyperbola that passes just below the nearest singularity. So nothing cancels, and what falls like
//! exp(-D) keeps its relative precision.

#![allow(clippy::needless_range_loop, reason = "formulas name the index")]

use crate::harmonics::zonal::norm;
use crate::harmonics::{BANDS, Zh64};
use num_complex::Complex;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

type C = Complex<f64>;

/// Highest order of scattering that is told apart from the others.
pub const ORDERS: usize = 10;

/// Orders from 2 on, one after the other.
pub type Orders = [Zh64; ORDERS - 1];

/// Greatest |g| for which the number of terms stays small.
pub const MAX_G: f64 = 0.95;

/// A power series in the albedo, to [`ORDERS`].
type Series = [C; ORDERS + 1];

fn inverse(a: &Series) -> Series {
    let first = a[0].inv();
    let mut out = [first; ORDERS + 1];
    for n in 1..=ORDERS {
        let sum: C = (1..=n).map(|i| a[i] * out[n - i]).sum();
        out[n] = -first * sum;
    }
    out
}

fn product(a: &Series, b: &Series) -> Series {
    std::array::from_fn(|n| (0..=n).map(|i| a[i] * b[n - i]).sum())
}

/// Distances beyond this take the hyperbola.
const FAR: f64 = 8.0;

/// Moduli of k beyond this start the continued fraction by forward recurrence: backward would need too many terms.
const LARGE: f64 = 50.0;

/// Moduli of k beyond which the orders from 11 on are too weak to count: each is about pi / (2 (1 - |g|)) / k of the one before.
const FEW_ORDERS: f64 = 1000.0;

/// Where the continued fraction of one k and g begins: from there on scattering no longer counts.
struct Tail {
    k: C,
    powers: Vec<f64>,
    /// Ratio of the moment behind the last power to the last one.
    ratio: C,
}

impl Tail {
    fn new(k: C, g: f64) -> Self {
        let mut powers: Vec<f64> = vec![1.0];
        while powers.len() <= BANDS || 1e-17 < powers[powers.len() - 1].abs() {
            powers.push(powers[powers.len() - 1] * g);
        }
        let last = powers.len() - 1;
        let ratio = if LARGE < k.norm() {
            // Moments without any scattering, forwards: the other solution grows by less than 1e5 on the way.
            let (mut a, mut b) = (k.atan() / k, C::ONE);
            b = (b - a) / k;
            for l in 1..=last {
                let l = l as f64;
                (a, b) = (b, (a * l - b * (2.0 * l + 1.0) / k) / (l + 1.0));
            }
            b / a
        } else {
            let limit = ((k * k + 1.0).sqrt() - 1.0) / k;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of terms")]
            let more = (20.0 / -limit.norm().ln()).clamp(8.0, 1e5) as usize;
            let mut r = limit;
            for l in (last + 1..=last + more).rev() {
                let l = l as f64;
                r = k * l / (r * k * (l + 1.0) + (2.0 * l + 1.0));
            }
            r
        };
        Self { k, powers, ratio }
    }

    /// The moments at an albedo.
    fn moments(&self, alpha: C) -> [C; BANDS] {
        let k = self.k;
        let mut ratios = [C::ZERO; BANDS];
        let mut r = self.ratio;
        for l in (1..self.powers.len()).rev() {
            let (lf, n) = (l as f64, (2 * l + 1) as f64);
            r = k * lf / ((C::ONE - alpha * self.powers[l]) * n + k * r * (lf + 1.0));
            if l < BANDS {
                ratios[l] = r;
            }
        }
        let mut f = [C::ONE / (C::ONE - alpha + k * ratios[1]); BANDS];
        for l in 1..BANDS {
            f[l] = f[l - 1] * ratios[l];
        }
        f
    }

    /// Moments of each order of scattering from 0 on: the same fraction in power series. Each order keeps its own relative
    /// precision, however weak it is; differences of moments at several albedos would not.
    fn orders(&self) -> [[C; BANDS]; ORDERS + 1] {
        let k = self.k;
        let mut ratios = [[C::ZERO; ORDERS + 1]; BANDS];
        let mut r = [C::ZERO; ORDERS + 1];
        r[0] = self.ratio;
        for l in (1..self.powers.len()).rev() {
            let (lf, n) = (l as f64, (2 * l + 1) as f64);
            let mut below = r.map(|c| c * k * (lf + 1.0));
            below[0] += n;
            below[1] -= n * self.powers[l];
            r = inverse(&below).map(|c| c * k * lf);
            if l < BANDS {
                ratios[l] = r;
            }
        }
        let mut below = ratios[1].map(|c| c * k);
        below[0] += 1.0;
        below[1] -= 1.0;
        let mut f = inverse(&below);
        let mut out = [[C::ZERO; BANDS]; ORDERS + 1];
        for l in 0..BANDS {
            if 0 < l {
                f = product(&f, &ratios[l]);
            }
            for n in 0..=ORDERS {
                out[n][l] = f[n];
            }
        }
        out
    }

    /// Moments of all orders from 2 on, divided by the square of the albedo.
    fn rest(&self, orders: &[[C; BANDS]; ORDERS + 1], alpha: f64) -> [C; BANDS] {
        if FEW_ORDERS < self.k.norm() {
            // The rest would be a small difference; but orders weaken so fast here that some are all.
            return std::array::from_fn(|l| {
                orders[2..].iter().rev().fold(C::ZERO, |sum, order| sum * alpha + order[l])
            });
        }
        let f = self.moments(alpha.into());
        std::array::from_fn(|l| (f[l] - orders[0][l] - orders[1][l] * alpha) / (alpha * alpha))
    }
}

/// Decay of the slowest part of the light with distance, in (0, 1]: exp(-nu D) / D. The least nu in (0, 1) at which the moments have a
/// solution without a source, nu = alpha artanh(nu) for g = 0; 1 where there is none and 0 for an albedo of 1.
///
/// On the imaginary axis the equations are a symmetric tridiagonal matrix with (2 l + 1) (1 - alpha g^l) on its diagonal and
/// nu (l + 1) beside it, which is positive definite below the least nu: all pivots are positive.
#[must_use]
pub fn decay(alpha: f64, g: f64) -> f64 {
    if 1.0 <= alpha {
        return 0.0;
    }
    // A power is slow, and without g most of what is asked.
    let power = |l: i32| if g == 0.0 { f64::from(u8::from(l == 0)) } else { g.powi(l) };
    let below = |nu: f64| {
        let root = (1.0 - nu * nu).sqrt();
        let more = (20.0 / -(nu / (1.0 + root)).ln()).clamp(8.0, 1e4).ceil();
        // From here on scattering no longer counts, and the pivots are known.
        #[expect(clippy::cast_possible_truncation, reason = "a number of terms")]
        let top = (more + (40.0 / -g.abs().max(1e-9).ln()).clamp(1.0, 1e4)) as i32;
        let mut pivot = (f64::from(top) + 1.5) * (1.0 + root);
        (0..=top).rev().all(|l| {
            let n = f64::from(l);
            pivot = (2.0 * n + 1.0) * (1.0 - alpha * power(l)) - nu * nu * (n + 1.0) * (n + 1.0) / pivot;
            0.0 < pivot
        })
    };
    let (mut lo, mut hi) = (0.0, 1.0 - 1e-9);
    if below(hi) {
        return 1.0;
    }
    // In ratios, because nu falls like the root of 1 - alpha.
    for _ in 0..80 {
        let middle = if lo == 0.0 { 0.1 * hi } else { (lo * hi).sqrt() };
        if below(middle) { lo = middle } else { hi = middle }
    }
    lo
}

/// Decay that tables are scaled by: that of isotropic scattering by (1 - g) of the medium, close to [`decay`] and analytic in g, which
/// [`decay`] is not where it reaches 1.
#[must_use]
pub fn similar_decay(alpha: f64, g: f64) -> f64 {
    let stretch = 1.0 - alpha * g;
    stretch * decay(alpha * (1.0 - g) / stretch, 0.0)
}

/// A step along the path of integration.
struct Step {
    k: C,
    /// Of k^2 times the Bessel function: weights of the bands.
    weights: [C; BANDS],
}

/// The path for a distance, in a medium where nothing decays slower than exp(-slowest D). The result is that times exp(scale D).
/// A `detail` of 1 is enough; others show that it is.
fn path(distance: f64, slowest: f64, scale: f64, detail: usize) -> Vec<Step> {
    let fine = detail as f64;
    let mut steps = Vec::new();
    let mut push = |k: C, dk: C, bessel: fn(C, f64) -> [C; BANDS]| {
        let b = bessel(k * distance, scale * distance);
        let factor = k * k * dk * (2.0 / PI);
        steps.push(Step { k, weights: std::array::from_fn(|l| factor * b[l] * norm(l)) });
    };
    if distance <= FAR {
        // Along the real axis, in panels of equal ratio from where k^3 no longer counts.
        let turn = 10.0 / distance;
        let start = (1e-5 * slowest.max(1e-3)).min(1e-3 * turn);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of panels")]
        let panels = (fine * (turn / start).ln() / 0.5).ceil() as usize;
        let width = (turn / start).ln() / panels as f64;
        for p in 0..panels {
            for (x, w) in GAUSS {
                let k = start * (width * (p as f64 + 0.5 + 0.5 * x)).exp();
                push(k.into(), (0.5 * w * width * k).into(), regular);
            }
        }
        // Then up, k = turn + s exp(i pi / 4): the Bessel function falls like exp(-s D / sqrt 2).
        let (direction, n) = (C::from_polar(1.0, FRAC_PI_4), 96 * detail);
        for node in super::quadrature::tanh_sinh(n) {
            let s = 60.0 / distance * node.x;
            push(direction * s + turn, direction * (60.0 / distance * node.w), outgoing);
        }
    } else {
        let pass = slowest * f64::max(0.5, 1.0 - 4.0 / (slowest * distance));
        let amplitude = pass / FRAC_PI_4.sin();
        let to_singularity = (slowest / amplitude).min(1.0).asin().min(FRAC_PI_2) - FRAC_PI_4;
        let step = TAU * to_singularity.min(FRAC_PI_4) / (36.0 * fine);
        let end = (1.0 + 45.0 / (pass * distance)).acosh();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of steps")]
        let n = (end / step).ceil() as usize;
        for i in 0..=n {
            let u = C::new(step * i as f64, FRAC_PI_4);
            let weight = if i == 0 { 0.5 * step } else { step };
            push(u.sinh() * amplitude, u.cosh() * (amplitude * weight), outgoing);
        }
    }
    steps
}

/// Spherical Bessel functions of the first kind at a real argument, times exp(`scale`).
fn regular(z: C, scale: f64) -> [C; BANDS] {
    let x = z.re;
    let factor = scale.exp();
    // Backwards, normalised by the sum of (2 l + 1) j_l^2 = 1; forwards would lose the high bands.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of terms")]
    let top = BANDS + 20 + x.ceil() as usize;
    let (mut above, mut here, mut sum) = (0.0, 1e-100, 0.0);
    let mut out = [0.0; BANDS];
    for l in (0..=top).rev() {
        if l < BANDS {
            out[l] = here;
        }
        sum += (2 * l + 1) as f64 * here * here;
        let below = (2 * l + 1) as f64 / x * here - above;
        (above, here) = (here, below);
        if 1e100 < here.abs() {
            // Bands that were noted already are far smaller than what follows.
            let shrink = 1e-100;
            above *= shrink;
            here *= shrink;
            sum *= shrink * shrink;
            out.iter_mut().for_each(|v| *v *= shrink);
        }
    }
    // The sign is that of sin(x) / x or, at its zeros, of the next function.
    let root = sum.sqrt();
    let truth = if x < 1e-4 { 1.0 } else { x.sin() / x };
    let second = if x < 1e-4 { x / 3.0 } else { (x.sin() / x - x.cos()) / x };
    let sign = if out[1].abs() < out[0].abs() { truth * out[0] } else { second * out[1] };
    out.map(|v| C::from(v / root * factor.copysign(sign)))
}

/// Spherical Hankel functions of the first kind, times exp(`scale`): upwards, which they are stable in.
fn outgoing(z: C, scale: f64) -> [C; BANDS] {
    let mut h = [C::ZERO; BANDS];
    h[0] = -C::I * (C::I * z + scale).exp() / z;
    h[1] = h[0] * (z.inv() - C::I);
    for l in 1..BANDS - 1 {
        h[l + 1] = h[l] * ((2 * l + 1) as f64) / z - h[l - 1];
    }
    h
}

/// Gauss-Legendre rule of 8 nodes on [-1, 1].
const GAUSS: [(f64, f64); 8] = [
    (-0.960_289_856_497_536_3, 0.101_228_536_290_376_26),
    (-0.796_666_477_413_626_7, 0.222_381_034_453_374_48),
    (-0.525_532_409_916_329, 0.313_706_645_877_887_27),
    (-0.183_434_642_495_649_8, 0.362_683_783_378_361_96),
    (0.183_434_642_495_649_8, 0.362_683_783_378_361_96),
    (0.525_532_409_916_329, 0.313_706_645_877_887_27),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_48),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_26),
];

/// Distance times exp(distance) times each order of scattering from 2 to [`ORDERS`], for albedo 1.
#[must_use]
pub fn orders_scaled(distance: f64, g: f64) -> Orders {
    orders_in_detail(distance, g, 1)
}

/// The same with `detail` times the resolution everywhere.
#[must_use]
pub fn orders_in_detail(distance: f64, g: f64, detail: usize) -> Orders {
    let mut out = [[0.0; BANDS]; ORDERS - 1];
    for step in path(distance, 1.0, 1.0, detail) {
        let f = Tail::new(step.k, g).orders();
        for (out, f) in out.iter_mut().zip(&f[2..]) {
            for l in 0..BANDS {
                out[l] += distance * (step.weights[l] * f[l]).re;
            }
        }
    }
    out
}

/// Distance times exp(decay distance) times the sum of all orders from 2 on, divided by the square of the albedo, for each of
/// the given albedos in (0, 1).
#[must_use]
pub fn rest_scaled(distance: f64, g: f64, alphas: &[f64]) -> Vec<Zh64> {
    rest_in_detail(distance, g, alphas, 1)
}

/// The same with `detail` times the resolution everywhere.
#[must_use]
pub fn rest_in_detail(distance: f64, g: f64, alphas: &[f64], detail: usize) -> Vec<Zh64> {
    let slow: Vec<f64> = alphas.iter().map(|&a| decay(a, g)).collect();
    let mut out = vec![[0.0; BANDS]; alphas.len()];
    if distance <= FAR {
        // One path for all; they differ by the scale alone.
        for step in path(distance, slow.iter().copied().fold(1.0, f64::min), 0.0, detail) {
            let tail = Tail::new(step.k, g);
            let low = tail.orders();
            for ((out, &alpha), nu) in out.iter_mut().zip(alphas).zip(&slow) {
                let f = tail.rest(&low, alpha);
                let factor = distance * (nu * distance).exp();
                for l in 0..BANDS {
                    out[l] += factor * (step.weights[l] * f[l]).re;
                }
            }
        }
        return out;
    }
    for ((out, &alpha), &nu) in out.iter_mut().zip(alphas).zip(&slow) {
        for step in path(distance, nu, nu, detail) {
            let tail = Tail::new(step.k, g);
            let f = tail.rest(&tail.orders(), alpha);
            for l in 0..BANDS {
                out[l] += distance * (step.weights[l] * f[l]).re;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bessel_functions_are_the_known_ones() {
        for x in [1e-6, 0.01, 0.5, 3.1, 4.493_409_457_909_064, 9.9] {
            let j = regular(x.into(), 0.0);
            let j1 = if x < 1e-3 { x / 3.0 } else { (x.sin() / x - x.cos()) / x };
            assert!((j[0].re - x.sin() / x).abs() < 1e-14, "{x}: {}", j[0]);
            assert!((j[1].re - j1).abs() < 1e-13, "{x}: {}", j[1]);
            // The real part of the outgoing ones.
            let h = outgoing(x.into(), 0.0);
            if 1.0 < x {
                for l in 0..BANDS {
                    assert!((j[l].re - h[l].re).abs() < 1e-9, "{x} {l}: {} {}", j[l], h[l]);
                }
            }
        }
        // j_10 at 1e-6 is x^10 / 21!!
        let j = regular(1e-6.into(), 0.0)[10].re;
        assert!((j / (1e-60 / 13_749_310_575.0) - 1.0).abs() < 1e-9, "{j:e}");
    }

    /// nu = alpha artanh(nu) for isotropic scattering.
    #[test]
    fn decay_is_the_root_of_the_known_equation() {
        for alpha in [0.3, 0.5, 0.9, 0.999_f64] {
            let nu = decay(alpha, 0.0);
            assert!((alpha * nu.atanh() / nu - 1.0).abs() < 1e-7, "{alpha} {nu}");
        }
        assert_eq!(decay(1.0, 0.3), 0.0);
    }

    /// Weak light of a high order close to the emitter keeps its precision: halving the distance changes it smoothly.
    #[test]
    fn high_orders_are_smooth_close_by() {
        let at = |d: f64| orders_scaled(d, 0.88)[8][0] / d;
        let [a, b, c] = [at(2e-4), at(2.1e-4), at(2.2e-4)];
        assert!((a - 2.0 * b + c).abs() < 2e-3 * b, "{a} {b} {c}");
    }

    /// Both paths meet where they change.
    #[test]
    fn near_and_far_agree() {
        for g in [-0.8, 0.0, 0.5] {
            let [a, b] =
                [FAR, FAR * (1.0 + 1e-9)].map(|d| (orders_scaled(d, g), rest_scaled(d, g, &[0.5, 0.99])));
            let close = |a: &Zh64, b: &Zh64| {
                for l in 0..BANDS {
                    assert!((a[l] - b[l]).abs() < 1e-6 * a[0], "g {g} l {l}: {} {}", a[l], b[l]);
                }
            };
            a.0.iter().zip(&b.0).for_each(|(a, b)| close(a, b));
            a.1.iter().zip(&b.1).for_each(|(a, b)| close(a, b));
        }
    }
}
