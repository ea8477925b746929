//! Full expansions: evaluation, and lobes about any axis.

#![allow(clippy::needless_range_loop, reason = "formulas name the index")]

use super::BANDS;
use super::zonal::{Real, norm};
use std::f64::consts::SQRT_2;
use std::sync::LazyLock;

/// Number of coefficients of a full expansion.
pub const COEFFICIENTS: usize = BANDS * BANDS;

/// Factors of the recurrence in l for each m: P_(l+1) = a z P_l - b P_(l-1), all normalised.
static RECURRENCE: LazyLock<[[[f64; 2]; BANDS]; BANDS]> = LazyLock::new(|| {
    let mut table = [[[0.0; 2]; BANDS]; BANDS];
    for m in 0..BANDS {
        for l in m..BANDS {
            let (above, here, k) = ((l + 1) as f64, l as f64, m as f64);
            let a = ((4.0 * above * above - 1.0) / (above * above - k * k)).sqrt();
            let b = if l == m { 0.0 } else { ((here * here - k * k) / (4.0 * here * here - 1.0)).sqrt() };
            table[m][l] = [a, a * b];
        }
    }
    table
});

/// Real spherical harmonics of a unit vector, all of them.
///
/// cos(m phi) sin^m(theta) and its twin come from (x + i y)^m, the rest of the associated Legendre functions from the recurrence in
/// l, normalised all along (\[Slo13\] Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2(2)): nothing is divided by the sine, so
/// poles are places like any other.
#[must_use]
pub fn basis<T: Real>(direction: [T; 3]) -> [T; COEFFICIENTS] {
    first(direction)
}

/// The first `N` of them, those of whole bands: 1, 4, 9, 16 and so on, up to [`COEFFICIENTS`].
#[must_use]
pub fn first<T: Real, const N: usize>([x, y, z]: [T; 3]) -> [T; N] {
    let bands = const {
        let bands = N.isqrt();
        assert!(bands * bands == N && 0 < N && N <= COEFFICIENTS, "whole bands");
        bands
    };
    let mut out = [T::default(); N];
    let recurrence = &*RECURRENCE;
    let (mut c, mut s) = (T::of(1.0), T::default());
    // Normalised P_m^m without its sine.
    let mut diagonal = norm(0);
    for m in 0..bands {
        if 0 < m {
            let k = m as f64;
            diagonal *= ((2.0 * k + 1.0) / (2.0 * k)).sqrt();
            (c, s) = (x * c - y * s, x * s + y * c);
        }
        let factor = if m == 0 { 1.0 } else { SQRT_2 };
        let (mut before, mut p) = (T::default(), T::of(diagonal));
        for l in m..bands {
            let base = l * (l + 1);
            out[base + m] = T::of(factor) * p * c;
            if 0 < m {
                out[base - m] = T::of(factor) * p * s;
            }
            let [a, b] = recurrence[m][l];
            let next = T::of(a) * z * p - T::of(b) * before;
            (before, p) = (p, next);
        }
    }
    out
}

/// Full coefficients of a lobe about the unit vector `axis`: f_lm = sqrt(4 pi / (2 l + 1)) f_l y_lm(axis).
#[must_use]
pub fn rotate<T: Real>(zh: &[T; BANDS], axis: [T; 3]) -> [T; COEFFICIENTS] {
    let mut out = basis(axis);
    for l in 0..BANDS {
        let f = zh[l] * T::of(norm(l).recip());
        for c in &mut out[l * l..(l + 1) * (l + 1)] {
            *c = *c * f;
        }
    }
    out
}

/// Zonal coefficients about `axis` of what is symmetric about it in a full expansion: the best lobe with that axis.
#[must_use]
pub fn lobe<T: Real>(sh: &[T; COEFFICIENTS], axis: [T; 3]) -> [T; BANDS] {
    let y = basis(axis);
    std::array::from_fn(|l| {
        let mut sum = T::default();
        for i in l * l..(l + 1) * (l + 1) {
            sum += sh[i] * y[i];
        }
        sum * T::of(norm(l).recip())
    })
}

/// Value of a full expansion in a direction.
#[must_use]
pub fn evaluate<T: Real>(sh: &[T; COEFFICIENTS], direction: [T; 3]) -> T {
    let y = basis(direction);
    let mut sum = T::default();
    for (a, b) in sh.iter().zip(y) {
        sum += *a * b;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::zonal;

    const DIRECTIONS: [[f64; 3]; 5] = [
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
        [1.0, 0.0, 0.0],
        [0.6, -0.48, 0.64],
        [-2.0 / 3.0, 1.0 / 3.0, -2.0 / 3.0],
    ];

    #[test]
    fn the_first_bands_are_the_known_ones() {
        let [x, y, z] = DIRECTIONS[3];
        let b = basis([x, y, z]);
        let want = [
            0.282_094_791_773_878_14,
            0.488_602_511_902_919_9 * y,
            0.488_602_511_902_919_9 * z,
            0.488_602_511_902_919_9 * x,
            1.092_548_430_592_079 * x * y,
            1.092_548_430_592_079 * y * z,
            0.315_391_565_252_520_05 * (3.0 * z * z - 1.0),
            1.092_548_430_592_079 * x * z,
            0.546_274_215_296_039_5 * (x * x - y * y),
        ];
        for (i, w) in want.into_iter().enumerate() {
            assert!((b[i] - w).abs() < 1e-14, "{i}: {} {w}", b[i]);
        }
    }

    #[test]
    fn fewer_bands_are_the_first_of_all() {
        for d in DIRECTIONS {
            let all = basis(d);
            assert_eq!(first::<f64, 16>(d)[..], all[..16]);
            assert_eq!(first::<f64, 9>(d)[..], all[..9]);
            assert_eq!(first::<f64, 1>(d)[..], all[..1]);
        }
    }

    /// Addition theorem: sum over m of y_lm(a) y_lm(b) = (2 l + 1) / (4 pi) P_l(a . b), in both precisions.
    #[test]
    fn addition_theorem() {
        for a in DIRECTIONS {
            for b in DIRECTIONS {
                let dot = a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
                let p = zonal::legendre(dot);
                let (ya, yb) = (basis(a), basis(b));
                #[expect(clippy::cast_possible_truncation, reason = "f32 is what is tested")]
                let (sa, sb) = (basis(a.map(|v| v as f32)), basis(b.map(|v| v as f32)));
                for l in 0..BANDS {
                    let want = norm(l).powi(2) * p[l];
                    let sum: f64 = (l * l..(l + 1) * (l + 1)).map(|i| ya[i] * yb[i]).sum();
                    assert!((sum - want).abs() < 1e-12, "{l} {sum} {want}");
                    let sum: f32 = (l * l..(l + 1) * (l + 1)).map(|i| sa[i] * sb[i]).sum();
                    assert!((f64::from(sum) - want).abs() < 1e-5, "{l} {sum} {want}");
                }
            }
        }
    }

    #[test]
    fn lobes_turn_and_come_back() {
        let zh = zonal::phong(5.0);
        for axis in DIRECTIONS {
            let sh = rotate(&zh, axis);
            for d in DIRECTIONS {
                let dot = d.iter().zip(axis).map(|(x, y)| x * y).sum::<f64>();
                assert!((evaluate(&sh, d) - zonal::evaluate(&zh, dot)).abs() < 1e-12);
            }
            for (a, b) in lobe(&sh, axis).into_iter().zip(zh) {
                assert!((a - b).abs() < 1e-13);
            }
        }
    }
}
