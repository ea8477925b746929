//! Named guards for operations that rounding can push outside their domain.

/// `sqrt` of a number that may be slightly negative from rounding.
///
/// ```
/// assert_eq!(tables::num::guards::safe_sqrt(-1e-7), 0.0);
/// assert_eq!(tables::num::guards::safe_sqrt(4.0), 2.0);
/// ```
#[must_use]
pub fn safe_sqrt(x: f32) -> f32 {
    debug_assert!(-1e-3 <= x, "safe_sqrt({x}): too negative to be a rounding error");
    x.max(0.0).sqrt()
}

/// `a / b`, or 0 where `b` is 0: for weights whose numerator vanishes with the denominator.
#[must_use]
pub fn safe_div(a: f32, b: f32) -> f32 {
    if b == 0.0 { 0.0 } else { a / b }
}

/// `a*b - c*d` without cancellation: f32 products are exact in f64, so only the difference rounds.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
pub fn difference_of_products(a: f32, b: f32, c: f32, d: f32) -> f32 {
    (f64::from(a) * f64::from(b) - f64::from(c) * f64::from(d)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn difference_of_products_survives_cancellation() {
        // (1 + e)^2 - (1 + 2e) = e^2, far below one unit in the last place of either product.
        let e = f32::EPSILON;
        let exact = e * e;
        assert_eq!(difference_of_products(1.0 + e, 1.0 + e, 1.0, 1.0 + 2.0 * e), exact);
    }

    #[test]
    fn safe_div_by_zero_is_zero() {
        assert_eq!(safe_div(0.0, 0.0), 0.0);
        assert_eq!(safe_div(1.0, 4.0), 0.25);
    }
}
