//! Exponentials and logarithms as exact as half precision, which is what shadows are kept in: those of the system's library take half of a lookup.
//!
//! Both are polynomials on an octave that meet at its ends, fitted to the least greatest error.

/// `x` to the power of `p`, for normal `x` above 0; right to 5e-5 where the result is not below 1e-4.
#[inline]
pub(super) fn power(x: f32, p: f32) -> f32 {
    exp2(p * log2(x))
}

/// `e` to the power of `-x`, right to 1e-5 of itself down to 1e-30.
#[inline]
pub(super) fn decay(x: f32) -> f32 {
    exp2(-std::f32::consts::LOG2_E * x)
}

/// Right to 2e-5, for normal numbers above 0.
#[inline]
fn log2(x: f32) -> f32 {
    let bits = x.to_bits();
    let t = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000) - 1.0;
    let fit = 0.441_917 + t * (-0.267_179 + t * (0.148_427 - t * 0.045_149));
    let octave = (bits >> 23) as f32 - 127.0;
    octave + t + t * (1.0 - t) * fit
}

/// Right to 6e-6 of itself; what is below -126 gives no less than that.
#[inline]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "limited to what exponents hold")]
fn exp2(x: f32) -> f32 {
    let x = x.clamp(-126.0, 126.0) + 127.0;
    // Rounds down, as numbers are above 0.
    let octave = x as u32;
    let t = x - octave as f32;
    let fit = -0.306_995 - t * (0.065_455_5 + t * 0.013_689_5);
    f32::from_bits(octave << 23) * (1.0 + t + t * (1.0 - t) * fit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_as_exact_as_they_say() {
        let (mut logarithm, mut exponential) = (0.0f64, 0.0f64);
        for i in 0..400_000u32 {
            let x = 1e-30f32 * 1.000_35f32.powf(i as f32);
            if x < 1e6 {
                let want = f64::from(x).log2();
                logarithm = logarithm.max((f64::from(log2(x)) - want).abs() / want.abs().max(10.0) * 10.0);
            }
            let y = i as f32 * (140.0 / 400_000.0) - 100.0;
            exponential = exponential.max((f64::from(exp2(y)) / f64::from(y).exp2() - 1.0).abs());
        }
        assert!(logarithm < 2e-5 && exponential < 1.2e-5, "{logarithm}, {exponential}");
        for (x, p) in [(1.0, 0.3), (0.5, 1.0), (0.37, 0.0), (1e-3, 0.71)] {
            assert!((power(x, p) / x.powf(p) - 1.0).abs() < 5e-5, "{x} to {p}");
        }
        assert!((decay(3.0) / (-3f32).exp() - 1.0).abs() < 1e-5 && decay(1e9) < 1e-37 && decay(0.0) == 1.0);
    }
}
