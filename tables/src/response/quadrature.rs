//! Quadrature for integrands with layers at the ends of the interval.

use std::f64::consts::PI;

/// A node of a rule on the unit interval.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// Distance from 0, to full relative precision.
    pub x: f64,
    /// Distance from 1, to full relative precision.
    pub y: f64,
    /// Weight.
    pub w: f64,
}

/// The tanh-sinh rule (\[TM74\] Takahasi and Mori, "Double exponential formulas for numerical integration") with `n` nodes:
/// they crowd towards both ends doubly exponentially, so layers there need no care.
#[must_use]
pub fn tanh_sinh(n: usize) -> Vec<Node> {
    // Beyond this the weights are below 1e-19 of the largest.
    const END: f64 = 3.3;
    let h = 2.0 * END / (n - 1) as f64;
    (0..n)
        .map(|i| {
            let t = -END + h * i as f64;
            let q = (-PI * t.sinh()).exp();
            Node { x: 1.0 / (1.0 + q), y: q / (1.0 + q), w: h * PI * t.cosh() * q / ((1.0 + q) * (1.0 + q)) }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_with_poles_are_integrated() {
        let rule = tanh_sinh(64);
        let sum = |f: &dyn Fn(&Node) -> f64| rule.iter().map(|n| n.w * f(n)).sum::<f64>();
        assert!((sum(&|_| 1.0) - 1.0).abs() < 1e-14);
        assert!((sum(&|n| n.x.sqrt().recip()) - 2.0).abs() < 1e-7);
        assert!((sum(&|n| n.y.ln()) + 1.0).abs() < 1e-13);
        // A layer of width 1e-3 at one end.
        let layer = sum(&|n| 1e3 * (-1e3 * n.y).exp());
        assert!((layer - 1.0).abs() < 1e-4, "{layer}");
    }
}
