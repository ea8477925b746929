//! Light of a sun that enters a half space through a plane it meets at a right angle.

use super::interpolation::LogAxis;
use super::quadrature::{Node, tanh_sinh};
use crate::harmonics::zonal::basis;
use crate::harmonics::{BANDS, Zh64};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::PI;

/// exp(depth) times the light that was scattered once, at a depth below the plane, for 1 lux on the plane and albedo 1.
///
/// Along a ray with the cosine c to the light the integral is closed: 1 / (4 pi (1 - c)) downwards, and upwards to the plane
/// (1 - exp(-depth (1 - c) / c)) / (4 pi (1 - c)).
#[must_use]
pub fn single_scaled(rule: &[Node], depth: f64, g: f64) -> Zh64 {
    let mut zh = [0.0; BANDS];
    let mut add = |c: f64, towards: f64, w: f64, radiance: f64| {
        let weight = w * radiance * 0.5 * phase(g, towards);
        for (z, b) in zh.iter_mut().zip(basis(c)) {
            *z += weight * b;
        }
    };
    for n in rule {
        // Rays that go down or level: c in (-1, 0).
        add(-n.x, 1.0 + n.x, n.w, 1.0 / (1.0 + n.x));
        // Rays that leave through the plane: c = x, 1 - c = y.
        let path = depth * n.y / n.x;
        let radiance = if path < 1e-300 { depth / n.x } else { -(-path).exp_m1() / n.y };
        add(n.x, n.y, n.w, radiance);
    }
    zh
}

/// Phase function times 4 pi by 1 - cosine.
fn phase(g: f64, towards: f64) -> f64 {
    let d = (1.0 - g) * (1.0 - g) + 2.0 * g * towards;
    (1.0 - g * g) / (d * d.sqrt())
}

/// Light that was scattered once.
#[must_use]
pub fn single(rule: &[Node], depth: f64, g: f64) -> Zh64 {
    single_scaled(rule, depth, g).map(|v| v * (-depth).exp())
}

/// How the light of one order of scattering follows from the one before, in a half space with isotropic scattering.
///
/// The fluence at the nodes of an axis of depths, times exp(scale depth), gives each band of the light one order on, scaled
/// alike: L(depth, c) = integral over t of exp(-t) fluence(depth - t c) / (4 pi).
#[derive(Clone, Debug)]
pub struct HalfSpace {
    axis: LogAxis,
    scale: f64,
    /// One matrix for each band: a row for each depth.
    gather: Vec<DMatrix<f64>>,
}

impl HalfSpace {
    /// Prepares for depths on `axis`; fluences are smooth there after multiplication by exp(`scale` depth).
    #[must_use]
    pub fn new(axis: LogAxis, scale: f64) -> Self {
        let rule = tanh_sinh(80);
        let rows: Vec<[Vec<f64>; BANDS]> = (0..axis.n)
            .into_par_iter()
            .map(|i| {
                let depth = axis.node(i);
                let mut row: [Vec<f64>; BANDS] = std::array::from_fn(|_| vec![0.0; axis.n]);
                let mut add = |c: f64, weight: f64, from: f64| {
                    let cubic = axis.at(from);
                    for (row, b) in row.iter_mut().zip(basis(c)) {
                        for (k, w) in cubic.weights.iter().enumerate() {
                            row[cubic.first + k] += weight * w * b;
                        }
                    }
                };
                for direction in &rule {
                    // Down or level: the light weakens by exp(-t (1 + scale |c|)).
                    let c = direction.x;
                    let end = 45.0 / (1.0 + scale * c);
                    for n in &rule {
                        let t = end * n.x;
                        let w = 0.5 * direction.w * end * n.w * (-t * (1.0 + scale * c)).exp();
                        add(-c, w, depth + t * c);
                    }
                    // Up to the plane: by exp(-t (1 - scale c)).
                    let end = depth / c;
                    let slowness = (1.0 - scale) + scale * direction.y;
                    for n in &rule {
                        let t = end * n.x;
                        let w = 0.5 * direction.w * end * n.w * (-t * slowness).exp();
                        if 0.0 < w {
                            add(c, w, depth * n.y);
                        }
                    }
                }
                row
            })
            .collect();
        let gather = (0..BANDS).map(|l| DMatrix::from_fn(axis.n, axis.n, |i, j| rows[i][l][j])).collect();
        Self { axis, scale, gather }
    }

    /// Unscattered fluence under 1 lux, scaled.
    fn unscattered(&self) -> DVector<f64> {
        DVector::from_iterator(self.axis.n, self.axis.nodes().map(|d| (-(1.0 - self.scale) * d).exp()))
    }

    fn light(&self, fluence: &DVector<f64>) -> Vec<Zh64> {
        let bands: Vec<DVector<f64>> = self.gather.iter().map(|g| g * fluence).collect();
        (0..self.axis.n).map(|i| std::array::from_fn(|l| bands[l][i])).collect()
    }

    fn next(&self, fluence: &DVector<f64>) -> DVector<f64> {
        &self.gather[0] * fluence * (4.0 * PI).sqrt()
    }

    /// The light of each of `n` orders from 2 on at each depth, for albedo 1, times exp(scale depth).
    #[must_use]
    pub fn orders(&self, n: usize) -> Vec<Vec<Zh64>> {
        let mut fluence = self.unscattered();
        (0..n)
            .map(|_| {
                fluence = self.next(&fluence);
                self.light(&fluence)
            })
            .collect()
    }

    /// The light of all orders from 2 on divided by the square of the albedo, at each depth, times exp(scale depth).
    #[must_use]
    pub fn rest(&self, alpha: f64) -> Vec<Zh64> {
        let first = self.next(&self.unscattered());
        let n = self.axis.n;
        let matrix = DMatrix::identity(n, n) - &self.gather[0] * ((4.0 * PI).sqrt() * alpha);
        let fluence = matrix.lu().solve(&first).unwrap_or(first);
        self.light(&fluence)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::zonal::henyey_greenstein;

    #[test]
    fn the_phase_function_is_the_usual_one() {
        for g in [-0.9, 0.0, 0.7] {
            for c in [-1.0, -0.2, 0.9] {
                let (a, b) = (phase(g, 1.0 - c), henyey_greenstein(g, c));
                assert!((a / b - 1.0).abs() < 1e-12, "{g} {c} {a} {b}");
            }
        }
    }
}
