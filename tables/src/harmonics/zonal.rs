//! Lobes that are symmetric about an axis.

#![allow(clippy::needless_range_loop, reason = "formulas name the index")]

use super::{BANDS, Zh, Zh64};
use std::f64::consts::PI;

/// Numbers that the kernels are written for: f32 for baking, f64 for building tables.
pub trait Real:
    Copy
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::AddAssign
    + PartialOrd
    + Default
{
    /// Rounds to this precision.
    fn of(x: f64) -> Self;
}

impl Real for f64 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        x
    }
}

impl Real for f32 {
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "rounding is what is asked for")]
    fn of(x: f64) -> Self {
        x as f32
    }
}

/// Legendre recurrence, (l + 1) P_(l+1) = (2 l + 1) x P_l - l P_(l-1), as P_(l+1) = A_l x P_l - B_l P_(l-1).
const RECURRENCE: [[f64; 2]; BANDS] = {
    let mut table = [[0.0; 2]; BANDS];
    let mut l = 0;
    while l < BANDS {
        let d = (l + 1) as f64;
        table[l] = [(2 * l + 1) as f64 / d, l as f64 / d];
        l += 1;
    }
    table
};

/// Legendre polynomials P_0 to P_10 at `x` in [-1, 1], by the three-term recurrence, which is stable there.
#[must_use]
#[inline]
pub fn legendre<T: Real>(x: T) -> [T; BANDS] {
    let mut p = [T::of(1.0); BANDS];
    p[1] = x;
    for l in 1..BANDS - 1 {
        let [a, b] = RECURRENCE[l];
        p[l + 1] = T::of(a) * x * p[l] - T::of(b) * p[l - 1];
    }
    p
}

/// Factor between y_l0 and P_l: sqrt((2 l + 1) / (4 pi)).
#[must_use]
pub fn norm(l: usize) -> f64 {
    ((2 * l + 1) as f64 / (4.0 * PI)).sqrt()
}

/// Zonal basis functions y_l0 at the cosine `x`.
#[must_use]
pub fn basis(x: f64) -> Zh64 {
    let p = legendre(x);
    std::array::from_fn(|l| norm(l) * p[l])
}

/// Value of a lobe at the cosine `x` from its axis.
#[must_use]
pub fn evaluate(zh: &Zh64, x: f64) -> f64 {
    zh.iter().zip(basis(x)).map(|(a, b)| a * b).sum()
}

/// Coefficients of any function of the cosine. `kinks` are places, ascending within (-1, 1), where it is not smooth.
#[must_use]
pub fn project(f: impl Fn(f64) -> f64, kinks: &[f64]) -> Zh64 {
    let ends: Vec<f64> = [-1.0].iter().chain(kinks).chain(&[1.0]).copied().collect();
    let rule = crate::response::quadrature::tanh_sinh(96);
    let mut zh = [0.0; BANDS];
    for w in ends.windows(2) {
        for node in &rule {
            let x = w[0] + (w[1] - w[0]) * node.x;
            let value = 2.0 * PI * (w[1] - w[0]) * node.w * f(x);
            for (z, b) in zh.iter_mut().zip(basis(x)) {
                *z += value * b;
            }
        }
    }
    zh
}

/// Integral over the sphere of the product of two lobes whose axes have the cosine `x` between them: sum g_l h_l P_l(x)
/// (\[IR19\] appendix A). O(bands).
#[must_use]
#[inline]
pub fn double_product<T: Real>(g: &[T; BANDS], h: &[T; BANDS], x: T) -> T {
    let p = legendre(x);
    let mut sum = T::default();
    for l in 0..BANDS {
        sum += g[l] * h[l] * p[l];
    }
    sum
}

/// Zonal coefficients of max(0, cos): \[RH01\] Ramamoorthi and Hanrahan, "An Efficient Representation for Irradiance Environment Maps",
/// eq. 8, times the norm of y_l0. With it [`double_product`] turns radiance into irradiance.
pub const CLAMPED_COSINE: Zh64 = {
    // sqrt(2 l + 1), since roots cannot be taken here.
    const ROOT: Zh64 = [
        1.0,
        1.732_050_807_568_877_2,
        2.236_067_977_499_79,
        2.645_751_311_064_590_7,
        3.0,
        3.316_624_790_355_4,
        3.605_551_275_463_989,
        3.872_983_346_207_417,
        4.123_105_625_617_661,
        4.358_898_943_540_674,
        4.582_575_694_955_84,
    ];
    // 1 / sqrt(4 pi)
    const FIRST: f64 = 0.282_094_791_773_878_14;
    let mut zh = [0.0; BANDS];
    zh[0] = PI * FIRST;
    zh[1] = 2.0 * PI / 3.0 * FIRST * ROOT[1];
    let mut l = 2;
    // A_l = 2 pi (-1)^(l/2 - 1) / ((l + 2) (l - 1)) * l! / (2^l (l/2)!^2), even l; the last factor by its own recurrence.
    let mut binomial = 0.5;
    let mut sign = 1.0;
    while l < BANDS {
        zh[l] = 2.0 * PI * sign / ((l + 2) * (l - 1)) as f64 * binomial * FIRST * ROOT[l];
        l += 2;
        binomial *= (l - 1) as f64 / l as f64;
        sign = -sign;
    }
    zh
};

/// [`CLAMPED_COSINE`] for baking.
pub const CLAMPED_COSINE_F32: Zh = {
    let mut zh = [0.0f32; BANDS];
    let mut l = 0;
    while l < BANDS {
        #[expect(clippy::cast_possible_truncation, reason = "rounding is what is asked for")]
        {
            zh[l] = CLAMPED_COSINE[l] as f32;
        }
        l += 1;
    }
    zh
};

/// Irradiance on a plane whose normal has the cosine `x` to the axis of a radiance lobe. What a truncated expansion makes
/// negative is 0.
#[must_use]
#[inline]
pub fn irradiance(zh: &Zh, x: f32) -> f32 {
    double_product(zh, &CLAMPED_COSINE_F32, x).max(0.0)
}

/// Zonal coefficients of max(0, cos)^`power`, a Phong lobe that is not normalised. Closed form for any power >= 0: the moments of
/// odd and even polynomials over the half sphere obey a two-step recurrence.
#[must_use]
pub fn phong(power: f64) -> Zh64 {
    // I_l = integral over 0..1 of x^s P_l = (s - l + 2) / (s + l + 1) I_(l-2).
    let s = power;
    let mut integral = [0.0; BANDS];
    integral[0] = 1.0 / (s + 1.0);
    integral[1] = 1.0 / (s + 2.0);
    for l in 2..BANDS {
        integral[l] = integral[l - 2] * (s - l as f64 + 2.0) / (s + l as f64 + 1.0);
    }
    std::array::from_fn(|l| 2.0 * PI * norm(l) * integral[l])
}

/// Henyey-Greenstein phase function times 4 pi, 1 in the mean over the sphere. `x` is the cosine between the directions of travel
/// before and after.
#[must_use]
pub fn henyey_greenstein(g: f64, x: f64) -> f64 {
    // (1 - g)^2 + 2 g (1 - x) keeps its precision for g and x near 1, and near -1 if both are turned around.
    let (g, x) = if g < 0.0 { (-g, -x) } else { (g, x) };
    let d = (1.0 - g) * (1.0 - g) + 2.0 * g * (1.0 - x);
    ((1.0 - g) * (1.0 + g)) / (d * d.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: &Zh64, b: &Zh64, tolerance: f64) {
        for l in 0..BANDS {
            assert!((a[l] - b[l]).abs() < tolerance, "l = {l}: {} against {}", a[l], b[l]);
        }
    }

    #[test]
    fn legendre_at_the_ends_and_orthogonal() {
        for (l, (a, b)) in legendre(1.0f64).into_iter().zip(legendre(-1.0f64)).enumerate() {
            let want = if l % 2 == 0 { 1.0 } else { -1.0 };
            assert!((a - 1.0).abs() < 1e-15 && (b - want).abs() < 1e-15, "{l} {a} {b}");
        }
        for l in 0..BANDS {
            let mut want = [0.0; BANDS];
            want[l] = 1.0;
            close(&project(|x| basis(x)[l], &[]), &want, 1e-12);
        }
    }

    #[test]
    fn closed_forms_are_the_projections() {
        close(&CLAMPED_COSINE, &project(|x| x.max(0.0), &[0.0]), 1e-12);
        for s in [0.0, 0.5, 1.0, 7.0, 64.0] {
            close(&phong(s), &project(|x| if x < 0.0 { 0.0 } else { x.powf(s) }, &[0.0]), 1e-9);
        }
        close(&phong(1.0), &CLAMPED_COSINE, 1e-14);
        for g in [-0.9, -0.3, 0.0, 0.5, 0.9f64] {
            #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "small")]
            let want = std::array::from_fn(|l| 4.0 * PI * norm(l) * g.powi(l as i32));
            close(&project(|x| henyey_greenstein(g, x), &[]), &want, 1e-9);
        }
    }

    /// The O(N) sum against the integral over the sphere in full.
    #[test]
    fn double_products_are_integrals_over_the_sphere() {
        let g = phong(7.0);
        let n = 200;
        for x in [-1.0, -0.4, 0.0, 0.3, 1.0f64] {
            let s = (1.0 - x * x).sqrt();
            let mut sum = 0.0;
            for i in 0..n {
                // Gauss-Chebyshev would do as well; both factors are polynomials, so the midpoint rule in phi is exact.
                let node = -1.0 + (2 * i + 1) as f64 / n as f64;
                for j in 0..n {
                    let phi = 2.0 * PI * (j as f64 + 0.5) / n as f64;
                    let z = x * node + s * (1.0 - node * node).sqrt() * phi.cos();
                    sum += evaluate(&g, z) * evaluate(&CLAMPED_COSINE, node);
                }
            }
            sum *= 4.0 * PI / (n * n) as f64;
            let fast = double_product(&g, &CLAMPED_COSINE, x);
            assert!((fast - sum).abs() < 2e-3 * g[0], "{x}: {fast} {sum}");
            #[expect(clippy::cast_possible_truncation, reason = "f32 is what is tested")]
            let single = double_product(&g.map(|v| v as f32), &CLAMPED_COSINE_F32, x as f32);
            assert!((f64::from(single) - fast).abs() < 1e-6, "{x}: {single} {fast}");
        }
    }
}
