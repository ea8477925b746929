//! A small Lambertian patch: every lit surface, and area lights far away.
//!
//! Frame: receiver at the origin, patch at +z, its normal n = (sin, 0, -cos) of the angle `theta_e` between the normal and the
//! direction to the receiver. The response has no symmetry but the mirror y -> -y, so its coefficients have no m < 0.

#![allow(clippy::needless_range_loop, reason = "formulas name the index")]

use super::interpolation::LogAxis;
use super::point::cos;
use super::quadrature::{Node, tanh_sinh};
use crate::harmonics::real::COEFFICIENTS;
use crate::harmonics::zonal::{CLAMPED_COSINE, henyey_greenstein, norm};
use crate::harmonics::{BANDS, Zh64, real};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI, SQRT_2};

/// Coefficients with m >= 0: (l, m) at l (l + 1) / 2 + m.
pub const HALF: usize = BANDS * (BANDS + 1) / 2;

/// A response by its coefficients with m >= 0.
pub type Response = [f64; HALF];

/// Basis functions y_lm at phi = 0: what goes with cos(m phi) at a polar angle.
fn associated(z: f64, sine: f64) -> Response {
    let y = real::basis([sine, 0.0, z]);
    let mut out = [0.0; HALF];
    for l in 0..BANDS {
        for m in 0..=l {
            out[l * (l + 1) / 2 + m] = y[l * (l + 1) + m];
        }
    }
    out
}

/// Integrals over phi of max(0, a + b cos(phi)) cos(m phi), for b >= 0.
fn azimuth(a: f64, b: f64) -> [f64; BANDS] {
    let mut out = [0.0; BANDS];
    let edge = if b <= a {
        PI
    } else if a <= -b {
        return out;
    } else {
        (-a / b).acos()
    };
    out[0] = 2.0 * (a * edge + b * edge.sin());
    out[1] = 2.0 * a * edge.sin() + b * (edge + edge.sin() * edge.cos());
    for (m, v) in out.iter_mut().enumerate().skip(2) {
        let k = m as f64;
        *v = 2.0 * a * (k * edge).sin() / k
            + b * (((k - 1.0) * edge).sin() / (k - 1.0) + ((k + 1.0) * edge).sin() / (k + 1.0));
    }
    out
}

/// Distance times exp(distance) times the light that was scattered once, for each of the given `g`. The same integral as
/// [`super::point::single_scaled`] with the azimuth in closed form; it is taken in pieces, because the patch's own horizon
/// makes kinks in eta.
#[must_use]
pub fn single_scaled(rule: &[Node], distance: f64, theta_e: f64, gs: &[f64]) -> Vec<Response> {
    let mut out = vec![[0.0; HALF]; gs.len()];
    let mut sums = vec![[0.0; BANDS]; gs.len()];
    let horizon = (FRAC_PI_2 - theta_e).abs();
    let (across, along) = theta_e.sin_cos();
    for (theta, rest, outer) in pieces(rule, horizon, PI) {
        let half = (0.5 * theta).sin();
        sums.fill([0.0; BANDS]);
        for (eta, eps, inner) in pieces(rule, horizon, rest) {
            let excess = 2.0 * distance * (0.5 * eta).sin() * half / (0.5 * eps).sin();
            let weight = inner * (-excess).exp();
            if weight == 0.0 {
                continue;
            }
            let turned = -cos(eps, theta + eta);
            let (sine, cosine) = eta.sin_cos();
            let lit = azimuth(along * cosine, across * sine);
            for (sum, &g) in sums.iter_mut().zip(gs) {
                let p = weight * henyey_greenstein(g, turned);
                for (s, a) in sum.iter_mut().zip(lit) {
                    *s += p * a;
                }
            }
        }
        let y = associated(cos(theta, rest), if theta < rest { theta.sin() } else { rest.sin() });
        for (out, sum) in out.iter_mut().zip(&sums) {
            for l in 0..BANDS {
                for m in 0..=l {
                    let i = l * (l + 1) / 2 + m;
                    out[i] += 0.25 / PI * outer * y[i] * sum[m];
                }
            }
        }
    }
    out
}

/// Nodes over (0, end), in pieces between the patch's horizon and its opposite: place, distance to the end, and weight.
fn pieces(rule: &[Node], horizon: f64, end: f64) -> impl Iterator<Item = (f64, f64, f64)> {
    let mut from = 0.0;
    [horizon, PI - horizon, end].into_iter().flat_map(move |until| {
        let (start, until) = (from, until.min(end));
        let width = (until - start).max(0.0);
        from = until.max(start);
        let rule = if 0.0 < width { rule } else { &[] };
        rule.iter().map(move |n| (start + width * n.x, (end - until) + width * n.y, width * n.w))
    })
}

/// Light that was scattered once, for a patch of unit area and radiance.
#[must_use]
pub fn single(rule: &[Node], distance: f64, theta_e: f64, g: f64) -> Response {
    let scaled = single_scaled(rule, distance, theta_e, &[g])[0];
    scaled.map(|v| v * (-distance).exp() / distance)
}

/// Fluence, the integral over all directions.
#[must_use]
pub fn fluence(response: &Response) -> f64 {
    (4.0 * PI).sqrt() * response[0]
}

/// Vector irradiance: integral of radiance times direction, (x, 0, z).
#[must_use]
pub fn vector(response: &Response) -> [f64; 3] {
    let factor = (4.0 * PI / 3.0).sqrt();
    [factor * response[2], 0.0, factor * response[1]]
}

/// All coefficients.
#[must_use]
pub fn expand(response: &Response) -> [f64; COEFFICIENTS] {
    let mut sh = [0.0; COEFFICIENTS];
    for l in 0..BANDS {
        for m in 0..=l {
            sh[l * (l + 1) + m] = response[l * (l + 1) / 2 + m];
        }
    }
    sh
}

/// The lobe that comes nearest to a response, and how much that costs.
#[derive(Clone, Copy, Debug)]
pub struct Fit {
    /// Angle from +z to the axis, towards +x, radians: the shift of \[IR19\] section 4.2.
    pub shift: f64,
    /// Coefficients about the axis.
    pub zh: Zh64,
}

impl Fit {
    /// Fits the irradiance, which is what lobes are for: the axis makes the mean square over all receiver normals of the
    /// error of irradiance least. It lies between the light and the linear direction; \[IR19\] searches there for the least error of
    /// radiance, which jumps where a second peak takes over.
    #[must_use]
    pub fn new(response: &Response) -> Self {
        let [x, _, z] = vector(response);
        let end = x.atan2(z).clamp(0.0, PI);
        // What a lobe about this axis keeps of the mean square.
        let kept = |angle: f64| {
            about(response, axis(angle))
                .iter()
                .enumerate()
                .map(|(l, f)| (CLAMPED_COSINE[l] / norm(l) * f).powi(2))
                .sum::<f64>()
        };
        // A coarse search finds the right hill, golden sections its top.
        const COARSE: usize = 16;
        let at = |i: usize| end * i as f64 / COARSE as f64;
        let best = (0..=COARSE).max_by(|&a, &b| kept(at(a)).total_cmp(&kept(at(b)))).unwrap_or(0);
        let (mut lo, mut hi) = (at(best.saturating_sub(1)), at((best + 1).min(COARSE)));
        let section = 0.5 * (5f64.sqrt() - 1.0);
        for _ in 0..48 {
            let (a, b) = (hi - section * (hi - lo), lo + section * (hi - lo));
            if kept(a) < kept(b) { lo = a } else { hi = b }
        }
        let angle = 0.5 * (lo + hi);
        Self { shift: angle, zh: about(response, axis(angle)) }
    }

    /// Unit vector of the axis.
    #[must_use]
    pub fn axis(&self) -> [f64; 3] {
        axis(self.shift)
    }
}

/// Unit vector of the axis with a shift.
#[must_use]
pub fn axis(shift: f64) -> [f64; 3] {
    let (x, z) = shift.sin_cos();
    [x, 0.0, z]
}

/// The response that is a lobe about an axis in the xz-plane.
#[must_use]
pub fn lobe(zh: &Zh64, [x, _, z]: [f64; 3]) -> Response {
    let mut out = associated(z, x);
    for l in 0..BANDS {
        for v in &mut out[l * (l + 1) / 2..(l + 1) * (l + 2) / 2] {
            *v *= zh[l] / norm(l);
        }
    }
    out
}

/// Irradiance on a plane with the given unit normal, of all 11 bands.
#[must_use]
pub fn irradiance(response: &Response, normal: [f64; 3]) -> f64 {
    let y = real::basis(normal);
    let mut sum = 0.0;
    for l in 0..BANDS {
        let f = CLAMPED_COSINE[l] / norm(l);
        for m in 0..=l {
            sum += f * response[l * (l + 1) / 2 + m] * y[l * (l + 1) + m];
        }
    }
    sum
}

/// Coefficients about an axis in the xz-plane of the lobe that comes nearest to a response.
#[must_use]
pub fn about(response: &Response, [x, _, z]: [f64; 3]) -> Zh64 {
    let y = associated(z, x);
    std::array::from_fn(|l| {
        let sum: f64 = (0..=l).map(|m| response[l * (l + 1) / 2 + m] * y[l * (l + 1) / 2 + m]).sum();
        sum / norm(l)
    })
}

/// Bands in which the fluence around a patch is followed from order to order. The fluence bends at the patch's horizon and is weak
/// behind it, so more are needed than of light at a place.
const AROUND: usize = 21;

/// Of those, bands from here on are weighed less and less: a sum that ends gently does not ring behind the patch.
const GENTLE: usize = 12;

/// Weight of a band of the fluence.
fn gentle(big: usize) -> f64 {
    if big < GENTLE {
        return 1.0;
    }
    let x = (big + 1 - GENTLE) as f64 / (AROUND + 1 - GENTLE) as f64;
    (0.5 * PI * x).cos().powi(2)
}

/// Pairs (L, m) of the fluence, m below [`BANDS`].
const PAIRS: usize = AROUND * BANDS - BANDS * (BANDS - 1) / 2;

/// Index of a pair.
const fn pair(big: usize, m: usize) -> usize {
    m * AROUND - m * (m + 1) / 2 + big
}

/// All pairs.
fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..BANDS).flat_map(|m| (m..AROUND).map(move |big| (big, m)))
}

/// Like [`associated`], for the bands of the fluence.
fn associated_around(z: f64, sine: f64) -> [f64; PAIRS] {
    let mut out = [0.0; PAIRS];
    let mut diagonal = norm(0);
    for m in 0..BANDS {
        if 0 < m {
            let k = m as f64;
            diagonal *= sine * ((2.0 * k + 1.0) / (2.0 * k)).sqrt() * if m == 1 { SQRT_2 } else { 1.0 };
        }
        let (mut before, mut p, mut last) = (0.0, diagonal, 0.0);
        for big in m..AROUND {
            out[pair(big, m)] = p;
            let (l, k) = ((big + 1) as f64, m as f64);
            let a = ((4.0 * l * l - 1.0) / (l * l - k * k)).sqrt();
            let next = a * (z * p - last * before);
            (before, p) = (p, next);
            last = a.recip();
        }
    }
    out
}

/// Legendre polynomials of those bands.
fn legendre_around(x: f64) -> [f64; AROUND] {
    let mut p = [1.0; AROUND];
    p[1] = x;
    for l in 1..AROUND - 1 {
        let k = l as f64;
        p[l + 1] = ((2.0 * k + 1.0) * x * p[l] - k * p[l - 1]) / (k + 1.0);
    }
    p
}

/// How the light of one order of scattering follows from the one before, around a patch in an infinite medium with isotropic
/// scattering.
///
/// The fluence around the patch is symmetric about its normal: a sum of Legendre polynomials of the angle to it, which scattering
/// does not mix. Each is known at the nodes of an axis of distances, times distance and an exponential of it.
#[derive(Clone, Debug)]
pub struct Orders {
    axis: LogAxis,
    /// For each distance and each (L, m) of the fluence, a row for every band l of the light: weights of the nodes.
    gather: Vec<Vec<Vec<Vec<f64>>>>,
    /// Fluence of the light that was scattered once, by L.
    first: Vec<DVector<f64>>,
}

impl Orders {
    /// Prepares for distances on `axis`, where what is known times exp(`scale` distance) is smooth; `once` is what [`Orders::once`] gave for the same axis.
    #[must_use]
    pub fn new(axis: LogAxis, scale: f64, once: &[DVector<f64>]) -> Self {
        let rule = tanh_sinh(112);
        let gather = (0..axis.n).into_par_iter().map(|i| gather(&rule, axis, scale, axis.node(i))).collect();
        let rescale = |v: &DVector<f64>| {
            DVector::from_iterator(
                axis.n,
                axis.nodes().zip(v.iter()).map(|(d, v)| v * (-(1.0 - scale) * d).exp()),
            )
        };
        Self { axis, gather, first: once.iter().map(rescale).collect() }
    }

    /// Fluence of the light that was scattered once, by L, times distance and exp(distance).
    #[must_use]
    pub fn once(axis: LogAxis) -> Vec<DVector<f64>> {
        let rule = tanh_sinh(48);
        // Gauss-Legendre would need a table; the same rule serves, for both halves of the cosine.
        let angles: Vec<(f64, f64)> = tanh_sinh(48).iter().flat_map(|n| [(n.x, n.w), (-n.x, n.w)]).collect();
        let rows: Vec<Vec<f64>> = (0..axis.n)
            .into_par_iter()
            .map(|i| {
                let mut row = vec![0.0; AROUND];
                for &(c, w) in &angles {
                    let f = fluence(&single_scaled(&rule, axis.node(i), c.acos(), &[0.0])[0]);
                    for (l, (r, p)) in row.iter_mut().zip(legendre_around(c)).enumerate() {
                        *r += (l as f64 + 0.5) * w * f * p;
                    }
                }
                row
            })
            .collect();
        (0..AROUND).map(|l| DVector::from_iterator(axis.n, rows.iter().map(|r| r[l]))).collect()
    }

    fn scatter(&self, l: usize) -> DMatrix<f64> {
        let n = self.axis.n;
        // Fluence is sqrt(4 pi) times the first coefficient, and P_L of the angle to the normal is y_L0 / norm.
        let factor = (4.0 * PI).sqrt() * norm(l) * 4.0 * PI / (2 * l + 1) as f64;
        DMatrix::from_fn(n, n, |i, j| factor * self.gather[i][pair(l, 0)][0][j])
    }

    /// Light at a distance and angle from the fluence by L.
    fn light(&self, fluence: &[DVector<f64>], angles: &[f64]) -> Vec<Vec<Response>> {
        (0..self.axis.n)
            .map(|i| {
                let sums: Vec<Vec<f64>> = pairs()
                    .map(|(big, m)| {
                        let rows = &self.gather[i][pair(big, m)];
                        rows.iter()
                            .map(|row| row.iter().zip(fluence[big].iter()).map(|(a, b)| a * b).sum())
                            .collect()
                    })
                    .collect();
                angles
                    .iter()
                    .map(|angle| {
                        let a = associated_around(angle.cos(), angle.sin());
                        let mut out = [0.0; HALF];
                        for (big, m) in pairs() {
                            let factor = gentle(big) * 4.0 * PI / (2 * big + 1) as f64 * a[pair(big, m)];
                            for (k, sum) in sums[pair(big, m)].iter().enumerate() {
                                let l = k + m;
                                out[l * (l + 1) / 2 + m] += factor * sum;
                            }
                        }
                        out
                    })
                    .collect()
            })
            .collect()
    }

    /// Light of each of `n` orders from 2 on, at each distance and angle, for albedo 1, times distance and exp(scale distance).
    #[must_use]
    pub fn orders(&self, n: usize, angles: &[f64]) -> Vec<Vec<Vec<Response>>> {
        let scatter: Vec<DMatrix<f64>> = (0..AROUND).map(|l| self.scatter(l)).collect();
        let mut fluence = self.first.clone();
        (0..n)
            .map(|_| {
                let light = self.light(&fluence, angles);
                fluence = scatter.iter().zip(&fluence).map(|(k, f)| k * f).collect();
                light
            })
            .collect()
    }

    /// Light of all orders from 2 on divided by the square of the albedo, scaled alike.
    #[must_use]
    pub fn rest(&self, alpha: f64, angles: &[f64]) -> Vec<Vec<Response>> {
        let n = self.axis.n;
        let fluence: Vec<DVector<f64>> = (0..AROUND)
            .map(|l| {
                let matrix = DMatrix::identity(n, n) - self.scatter(l) * alpha;
                matrix.lu().solve(&self.first[l]).unwrap_or_else(|| self.first[l].clone())
            })
            .collect();
        self.light(&fluence, angles)
    }
}

/// See [`Orders::gather`].
fn gather(rule: &[Node], axis: LogAxis, scale: f64, distance: f64) -> Vec<Vec<Vec<f64>>> {
    let mut out: Vec<Vec<Vec<f64>>> = pairs().map(|(_, m)| vec![vec![0.0; axis.n]; BANDS - m]).collect();
    let mut inner = vec![vec![0.0; axis.n]; PAIRS];
    for outer in rule {
        let (theta, rest) = (PI * outer.x, PI * outer.y);
        let half = (0.5 * theta).sin();
        let sine = if theta < rest { theta.sin() } else { rest.sin() };
        inner.iter_mut().for_each(|v| v.fill(0.0));
        for n in rule {
            let (eps, eta) = (rest * n.x, rest * n.y);
            let sharp = if eps < FRAC_PI_2 { eps.sin() } else { (theta + eta).sin() };
            let excess = 2.0 * distance * (0.5 * eta).sin() * half / (0.5 * eps).sin();
            let (r, t) = (distance * sine / sharp, distance * eta.sin() / sharp);
            let weight = n.w * r * (-(1.0 - scale) * t - scale * excess).exp();
            if !(0.0 < weight && weight.is_finite()) {
                continue;
            }
            let cubic = axis.at(r);
            let a = associated_around(eta.cos(), eta.sin());
            for (inner, a) in inner.iter_mut().zip(a) {
                for (k, w) in cubic.weights.iter().enumerate() {
                    inner[cubic.first + k] += weight * a * w;
                }
            }
        }
        let y = associated(cos(theta, rest), sine);
        for (big, m) in pairs() {
            let lm = pair(big, m);
            let weight = PI * outer.w * rest * if m == 0 { 2.0 * PI } else { PI } / (4.0 * PI);
            for (k, row) in out[lm].iter_mut().enumerate() {
                let l = k + m;
                let factor = weight * y[l * (l + 1) / 2 + m];
                for (r, v) in row.iter_mut().zip(&inner[lm]) {
                    *r += factor * v;
                }
            }
        }
    }
    out
}
