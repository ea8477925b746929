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

/// The polynomial through `points` neighbours of `n` equidistant nodes, at a place counted in nodes: the first of them, and their
/// weights.
#[must_use]
pub fn lagrange(place: f64, n: usize, points: usize) -> (usize, Vec<f64>) {
    // NaN becomes the first node.
    let place = place.max(0.0).min((n - 1) as f64);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped above")]
    let first = (place as usize + 1).saturating_sub(points / 2).min(n - points);
    let t = place - first as f64;
    let weights = (0..points)
        .map(|i| (0..points).filter(|&j| j != i).map(|j| (t - j as f64) / (i as f64 - j as f64)).product())
        .collect();
    (first, weights)
}

/// Nodes for g in [-`to`, `to`]. Responses are analytic in g within the unit circle; artanh(g) makes a strip of it, and the inverse sine
/// spreads Chebyshev nodes evenly along the strip (\[KTE93\] Kosloff and Tal-Ezer, "A Modified Chebyshev Pseudospectral Method",
/// eq. 2.2). 16 nodes are as good here as 20 without the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScatteringAxis {
    /// Greatest |g|.
    pub to: f64,
    /// Number of nodes.
    pub n: usize,
}

/// Even spread against convergence, measured: 0.8 to 0.9 are alike, 0.95 is six times worse.
const SPREAD: f64 = 0.85;

impl ScatteringAxis {
    fn unit(&self) -> ChebyshevAxis {
        ChebyshevAxis { from: -1.0, to: 1.0, n: self.n }
    }

    /// All nodes, ascending.
    pub fn nodes(&self) -> impl Iterator<Item = f64> + use<> {
        let end = self.to.atanh();
        self.unit().nodes().map(move |x| (end * (SPREAD * x).asin() / SPREAD.asin()).tanh())
    }

    /// Weights of the nodes at `g`, which is clamped.
    #[must_use]
    pub fn at(&self, g: f64) -> Vec<f64> {
        let part = g.max(-self.to).min(self.to).atanh() / self.to.atanh();
        self.unit().at((part * SPREAD.asin()).sin() / SPREAD)
    }
}

/// Nodes for the angle of a patch, [0, pi], crowded at pi / 2: there its own horizon passes the way to the receiver, and the response
/// goes like x^2 ln x. Chebyshev nodes on either side, in the square root of the distance from pi / 2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HorizonAxis {
    /// Number of nodes on each side.
    pub per_side: usize,
}

impl HorizonAxis {
    fn side(&self) -> ChebyshevAxis {
        ChebyshevAxis { from: 0.0, to: 1.0, n: self.per_side }
    }

    /// All nodes, ascending.
    pub fn nodes(&self) -> impl Iterator<Item = f64> + use<> {
        let (n, side) = (self.per_side, self.side());
        (0..2 * n).map(move |i| {
            let s = if i < n { -side.node(n - 1 - i) } else { side.node(i - n) };
            std::f64::consts::FRAC_PI_2 * (1.0 + s * s.abs())
        })
    }

    /// Nodes that count at an angle, and their weights.
    #[must_use]
    pub fn at(&self, angle: f64) -> Vec<(usize, f64)> {
        let n = self.per_side;
        let from_level = angle / std::f64::consts::FRAC_PI_2 - 1.0;
        let weights = self.side().at(from_level.abs().sqrt());
        let index = |i: usize| if from_level < 0.0 { n - 1 - i } else { n + i };
        weights.into_iter().enumerate().map(|(i, w)| (index(i), w)).collect()
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
    fn polynomials_through_neighbours() {
        let f = |x: f64| 2.0 - x + 0.3 * x.powi(3) - 0.01 * x.powi(5);
        for place in [-1.0, 0.0, 0.4, 3.5, 7.0, 8.9, 9.0, 20.0f64] {
            let (first, weights) = lagrange(place, 10, 6);
            let got: f64 = weights.iter().enumerate().map(|(i, w)| w * f((first + i) as f64)).sum();
            let want = f(place.clamp(0.0, 9.0));
            assert!((got - want).abs() < 1e-10 * (1.0 + want.abs()), "{place}: {got} {want}");
        }
        assert_eq!(lagrange(2.25, 4, 2), (2, vec![0.75, 0.25]));
    }

    #[test]
    fn axes_meet_their_nodes_and_converge_between_them() {
        let g = ScatteringAxis { to: 0.9, n: 16 };
        let nodes: Vec<f64> = g.nodes().collect();
        assert!(nodes.is_sorted() && -0.9 < nodes[0] && nodes[15] < 0.9);
        let f = |g: f64| (1.0 - g * g) / (1.0 + g * g - 1.6 * g).powf(1.5);
        for at in [-0.9, -0.4, 0.0, 0.77, 0.9, nodes[3]] {
            // By logarithms, as tables do.
            let got = g.at(at).iter().zip(&nodes).map(|(w, &n)| w * f(n).ln()).sum::<f64>().exp();
            assert!((got / f(at) - 1.0).abs() < 1e-3, "{at}: {got} {}", f(at));
        }
        let angle = HorizonAxis { per_side: 14 };
        let nodes: Vec<f64> = angle.nodes().collect();
        assert!(nodes.is_sorted() && nodes.len() == 28);
        let f = |a: f64| {
            let x = a - std::f64::consts::FRAC_PI_2;
            1.0 + 0.3 * x + if x < 0.0 { x * x * (1e-300 - x).ln() } else { (2.0 * x).cos() - 1.0 }
        };
        for at in [0.0, 0.3, 1.5, 1.57, 1.571, 1.6, 2.8, std::f64::consts::PI, nodes[13], nodes[14]] {
            let got: f64 = angle.at(at).iter().map(|&(i, w)| w * f(nodes[i])).sum();
            assert!((got - f(at)).abs() < 2e-5, "{at}: {got} {}", f(at));
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
