//! De-ringing: the least window with which no irradiance is negative.
//!
//! A short expansion of a strong light undershoots on the far side. A window multiplies band l by 1 / (1 + w l^2 (l + 1)^2), which
//! smoothes by the least squared Laplacian (\[Slo08\] Sloan, "Stupid Spherical Harmonics (SH) Tricks", 2008, appendix A7); w is solved for, light by light, so
//! that the least `E` over all normals is 0 where it was negative, and 0 where it was not. Irradiance of bands 0 to 2 is a quadratic function of the normal, so its least value on
//! the sphere is an eigenvalue problem and exact.

use super::light::Light;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// Factors of `E / pi`, and those of the basis functions.
const BAND: [f64; 3] = [1.0, 2.0 / 3.0, 0.25];

/// A little more window than needed, so that rounding to f32 does not undo it.
const MARGIN: f64 = 1e-5;

/// Steps of bisection: a window to 1 part in 2^40.
const STEPS: u32 = 40;

/// The window w that a light needs, 0 for most, and the light with it.
#[must_use]
pub fn least_window(light: &Light) -> (f32, Light) {
    if rings(light) <= 0.0 {
        return (0.0, *light);
    }
    // Grows until it is enough; band 0 alone is never negative unless the light is.
    let mut high = 1.0 / 64.0;
    while 0.0 < rings(&windowed(light, high)) && high < 1e12 {
        high *= 2.0;
    }
    let mut low = 0.0;
    for _ in 0..STEPS {
        let middle = 0.5 * (low + high);
        if 0.0 < rings(&windowed(light, middle)) { low = middle } else { high = middle }
    }
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let w = high as f32;
    (w, windowed(light, high))
}

fn windowed(light: &Light, w: f64) -> Light {
    let mut out = *light;
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    out.scale_bands([0.0, 1.0, 2.0, 3.0].map(|l: f64| (1.0 / (1.0 + w * (l * (l + 1.0)).powi(2))) as f32));
    out
}

/// How far below 0 the least irradiance of any channel is, as a part of its mean; not above 0 where it is nowhere negative.
fn rings(light: &Light) -> f64 {
    let full = light.expand();
    (0..3)
        .map(|c| {
            let v: [f64; 9] = std::array::from_fn(|i| f64::from(full[i][c]) * BAND[i.isqrt()]);
            let mean = v[0].abs() * 0.282_094_791_773_878_14;
            if v.iter().all(|v| *v == 0.0) || v[0] <= 0.0 {
                // Nothing is left that a window could mend.
                return f64::NEG_INFINITY;
            }
            MARGIN - least(&v.map(|v| v / mean))
        })
        .fold(f64::NEG_INFINITY, f64::max)
}

/// Least value over the sphere of an expansion of bands 0 to 2.
fn least(c: &[f64; 9]) -> f64 {
    let (k0, k1, k2, k3, k4) = (
        0.282_094_791_773_878_14,
        0.488_602_511_902_919_9,
        1.092_548_430_592_079,
        0.315_391_565_252_520_05,
        0.546_274_215_296_039_5,
    );
    let b = Vector3::new(c[3], c[1], c[2]) * k1;
    let (xy, yz, xz) = (0.5 * k2 * c[4], 0.5 * k2 * c[5], 0.5 * k2 * c[7]);
    let (zz, xx) = (3.0 * k3 * c[6], k4 * c[8]);
    let q = Matrix3::new(xx, xy, xz, xy, -xx, yz, xz, yz, zz);
    k0 * c[0] - k3 * c[6] + least_quadratic(q, b)
}

/// Least n'Qn + b'n over unit vectors n: with a multiplier m below all eigenvalues of Q, (Q - m) n = -b / 2 and |n| = 1.
fn least_quadratic(q: Matrix3<f64>, b: Vector3<f64>) -> f64 {
    let eigen = SymmetricEigen::new(q);

    let values = eigen.eigenvalues;
    let parts = eigen.eigenvectors.transpose() * b * -0.5;
    let lowest = values.min();
    let half = parts.norm();
    if half == 0.0 {
        return lowest;
    }
    // |n(m)| falls from m = lowest downwards; at lowest - half it is 1 at most.
    let length = |m: f64| (0..3).map(|i| (parts[i] / (values[i] - m)).powi(2)).sum::<f64>();
    let (mut low, mut high) = (lowest - half, lowest);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if length(middle) < 1.0 { low = middle } else { high = middle }
    }
    let m = low;
    let mut n = Vector3::from_fn(|i, _| parts[i] / (values[i] - m));
    // Where b has next to nothing along the lowest eigenvector, that one fills up the length.
    let k = values.imin();
    let filled = n[k] * n[k] + 1.0 - n.norm_squared();
    n[k] = filled.max(0.0).sqrt().copysign(n[k]);
    let n = n.normalize();
    (0..3).map(|i| values[i] * n[i] * n[i] - 2.0 * parts[i] * n[i]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::real;
    use crate::probes::light::{Basis, MOST_COEFFICIENTS};

    fn directions() -> impl Iterator<Item = [f32; 3]> {
        (0..4000).map(|i| {
            let z = 1.0 - (2.0 * i as f32 + 1.0) / 4000.0;
            let (s, c) = (i as f32 * 2.399_963_2).sin_cos();
            let r = (1.0 - z * z).sqrt();
            [r * c, r * s, z]
        })
    }

    fn least_seen(light: &Light) -> f32 {
        directions().flat_map(|n| light.irradiance(n)).fold(f32::INFINITY, f32::min)
    }

    /// Beams from a few directions with weights, and even light.
    fn light(basis: Basis, beams: &[([f32; 3], f32)], even: f32) -> Light {
        let mut full = [[0.0; 3]; MOST_COEFFICIENTS];
        for (d, strength) in beams {
            let y: [f32; MOST_COEFFICIENTS] = real::first(*d);
            for (f, y) in full.iter_mut().zip(y) {
                f.iter_mut().zip([1.0, 0.5, 2.0]).for_each(|(f, c)| *f += y * strength * c);
            }
        }
        full[0] = full[0].map(|f| f + even);
        Light::project(basis, &full)
    }

    #[test]
    fn no_irradiance_is_negative_and_no_more_is_taken_than_needed() {
        let s = 0.577_350_26;
        for basis in Basis::ALL {
            for beams in [
                vec![([0.0, 0.0, 1.0], 1.0)],
                vec![([s, s, s], 1e6), ([0.8, -0.6, 0.0], 3e5)],
                vec![([1.0, 0.0, 0.0], 1e-6), ([-1.0, 0.0, 0.0], 1e-6)],
            ] {
                let rough = light(basis, &beams, 0.0);
                let before = least_seen(&rough);
                let (w, smooth) = least_window(&rough);
                let after = least_seen(&smooth);
                let mean = rough.coefficients()[0][1] * 0.282;
                assert_eq!(0.0 < w, before < -1e-4 * mean, "{basis:?} {before}");
                assert!(-1e-7 * mean <= after, "{basis:?}: {after} of {mean}");
                if 0.0 < w {
                    let worst = smooth.irradiance([0.0, 0.0, -1.0]);
                    assert!(after < 2e-3 * mean, "{basis:?}: {after} of {mean}, {worst:?}");
                }
                assert_eq!(smooth.coefficients()[0], rough.coefficients()[0], "energy stays");
            }
        }
    }

    /// Eigenvalues that are equal, or nearly.
    #[test]
    fn beams_from_everywhere_ring_alike() {
        let w = |d| least_window(&light(Basis::L2, &[(d, 12.5)], 0.0)).0;
        let want = w([0.0, 0.0, 1.0]);
        assert!(0.0 < want);
        let s = std::f32::consts::FRAC_1_SQRT_2;
        for d in [
            [-s, s, -3e-9],
            [s, 0.0, s],
            [1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.6, 0.0, -0.8],
            [0.48, 0.64, 0.6],
        ] {
            assert!((w(d) / want - 1.0).abs() < 0.01, "{d:?}: {} {want}", w(d));
        }
    }

    /// A lamp as paths found it.
    #[test]
    fn nearly_equal_eigenvalues() {
        let c = [
            3.5261855,
            4.3186774,
            -1.0055206e-8,
            -4.3186774,
            -6.828428,
            -1.5898674e-8,
            -3.9423957,
            1.5898674e-8,
            0.0,
        ];
        let lamp = Light::new(Basis::L2, &c.map(|c| [c; 3]));
        assert!(least_seen(&lamp) < -0.1);
        assert!(0.0 < least_window(&lamp).0);
    }

    #[test]
    fn light_that_does_not_ring_stays_as_it_is() {
        for basis in Basis::ALL {
            let calm = light(basis, &[([0.0, 1.0, 0.0], 1.0)], 3.0);
            assert_eq!(least_window(&calm), (0.0, calm));
            let black = Light::black(basis);
            assert_eq!(least_window(&black), (0.0, black));
        }
    }

    #[test]
    fn least_of_quadratics_where_the_gradient_misses_the_lowest_axis() {
        let q = Matrix3::from_diagonal(&Vector3::new(-1.0, 2.0, 3.0));
        // Along y alone: n = (x, y, 0), -x^2 + 2 y^2 + y with x^2 = 1 - y^2 has its least at y = -1/6.
        let least = least_quadratic(q, Vector3::new(0.0, 1.0, 0.0));
        assert!((least - (-1.0 - 1.0 / 12.0)).abs() < 1e-9, "{least}");
        assert!((least_quadratic(q, Vector3::zeros()) + 1.0).abs() < 1e-12);
    }
}
