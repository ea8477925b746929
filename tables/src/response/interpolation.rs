//! Axes of tables and how values between their nodes follow.

/// Nodes at equal ratios, cubic between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogAxis {
    /// First node.
    pub first: f64,
    /// Last node.
    pub last: f64,
    /// Number of nodes, at least 4.
    pub n: usize,
}

/// Four neighbouring nodes and their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cubic {
    /// The first of them.
    pub first: usize,
    /// Lagrange weights, sum 1.
    pub weights: [f64; 4],
}

impl LogAxis {
    /// Value of a node.
    #[must_use]
    pub fn node(&self, i: usize) -> f64 {
        let part = i as f64 / (self.n - 1) as f64;
        (self.first.ln() * (1.0 - part) + self.last.ln() * part).exp()
    }

    /// All nodes.
    pub fn nodes(&self) -> impl Iterator<Item = f64> + use<> {
        let axis = *self;
        (0..axis.n).map(move |i| axis.node(i))
    }

    /// How a value at `x` follows from the nodes; beyond the ends it stays what it is there.
    #[must_use]
    pub fn at(&self, x: f64) -> Cubic {
        let step = (self.last / self.first).ln() / (self.n - 1) as f64;
        Cubic::at((x / self.first).ln() / step, self.n)
    }
}

impl Cubic {
    /// At a place counted in nodes, of `n`.
    #[must_use]
    pub fn at(place: f64, n: usize) -> Self {
        // NaN becomes the first node.
        let place = place.max(0.0).min((n - 1) as f64);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped above")]
        let first = (place as usize).saturating_sub(1).min(n - 4);
        let t = place - first as f64;
        let (a, b, c, d) = (t, t - 1.0, t - 2.0, t - 3.0);
        Self { first, weights: [-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0] }
    }
}

/// Chebyshev nodes on an interval; functions that are analytic around it are interpolated with an error that falls
/// exponentially in their number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChebyshevAxis {
    /// Lower end.
    pub from: f64,
    /// Upper end.
    pub to: f64,
    /// Number of nodes, none of them at an end.
    pub n: usize,
}

impl ChebyshevAxis {
    fn angle(&self, i: usize) -> f64 {
        std::f64::consts::PI * (i as f64 + 0.5) / self.n as f64
    }

    /// Value of a node, ascending.
    #[must_use]
    pub fn node(&self, i: usize) -> f64 {
        0.5 * (self.from + self.to) - 0.5 * (self.to - self.from) * self.angle(i).cos()
    }

    /// All nodes.
    pub fn nodes(&self) -> impl Iterator<Item = f64> + use<> {
        let axis = *self;
        (0..axis.n).map(move |i| axis.node(i))
    }

    /// Weights of the nodes at `x`, which is clamped to the interval: the barycentric formula (\[BT04\] Berrut and Trefethen,
    /// "Barycentric Lagrange Interpolation", eq. 5.4).
    #[must_use]
    pub fn at(&self, x: f64) -> Vec<f64> {
        let x = x.max(self.from).min(self.to);
        let mut weights = vec![0.0; self.n];
        let mut sum = 0.0;
        for (i, w) in weights.iter_mut().enumerate() {
            let distance = x - self.node(i);
            if distance == 0.0 {
                let mut only = vec![0.0; self.n];
                only[i] = 1.0;
                return only;
            }
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            *w = sign * self.angle(i).sin() / distance;
            sum += *w;
        }
        weights.iter_mut().for_each(|w| *w /= sum);
        weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubics_are_exact_for_cubics_of_the_logarithm() {
        let axis = LogAxis { first: 1e-3, last: 1e2, n: 17 };
        let f = |x: f64| 1.0 + x.ln() - 0.3 * x.ln().powi(2) + 0.1 * x.ln().powi(3);
        for x in [1e-3, 2.3e-3, 0.5, 7.0, 99.0, 1e2] {
            let c = axis.at(x);
            let got: f64 = (0..4).map(|i| c.weights[i] * f(axis.node(c.first + i))).sum();
            assert!((got - f(x)).abs() < 1e-9 * f(x).abs().max(1.0), "{x}: {got} {}", f(x));
        }
        for (x, first, weight) in [(1e-9, 0, 0), (1e9, 13, 3), (f64::NAN, 0, 0)] {
            let c = axis.at(x);
            assert_eq!(c.first, first);
            assert!((c.weights[weight] - 1.0).abs() < 1e-12, "{c:?}");
        }
    }

    #[test]
    fn chebyshev_interpolation_converges_and_meets_its_nodes() {
        let axis = ChebyshevAxis { from: -0.9, to: 0.9, n: 20 };
        let f = |x: f64| (1.05 - x).recip();
        for x in [-0.9, -0.33, 0.0, 0.71, 0.9, axis.node(3)] {
            let got: f64 = axis.at(x).iter().zip(axis.nodes()).map(|(w, n)| w * f(n)).sum();
            assert!((got / f(x) - 1.0).abs() < 1e-4, "{x}: {got}");
        }
        assert_eq!(axis.at(5.0), axis.at(0.9));
    }
}
