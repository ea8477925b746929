//! Other ways to choose lights, to compare with; and ways that are wrong, to show that tests find them.
//!
//! Compiled with the feature `comparison` only: no bake uses them.

use super::build::{BinaryTree, Node};
use super::published::{self, Choose, Found, Lightcuts, Ways, bound, geometry, walk_down};
use super::{Pick, Receiver, TreeLight};
use crate::sample::discrete::Cdf;
use crate::sample::sequence::mix64;

/// Lights by intensity alone: traditional importance sampling, (\[SWZ96\] Shirley, Wang & Zimmerman, "Monte Carlo Techniques for Direct
/// Lighting Calculations", 1996, section 3.4).
#[derive(Clone, Debug, Default)]
pub struct Intensity(Option<Cdf>);

impl Intensity {
    /// Of lights that shine.
    #[must_use]
    pub fn new(lights: &[TreeLight]) -> Self {
        Self(Cdf::new(lights.iter().map(|l| if l.shines() { f64::from(l.intensity) } else { 0.0 })))
    }

    /// One light.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 lights")]
    pub fn one(&self, u: f32) -> Option<Pick> {
        let cdf = self.0.as_ref()?;
        let (k, _) = cdf.sample(u);
        Some(Pick { light: k as u32, chance: cdf.pdf(k), alone: cdf.pdf(k) })
    }

    /// With which probability [`Intensity::one`] chooses a light.
    #[must_use]
    pub fn probability(&self, light: u32) -> f32 {
        self.0.as_ref().map_or(0.0, |cdf| cdf.pdf(light as usize))
    }
}

/// Adaptive tree splitting, \[CK18\]: weights by the distance to the middle of a node, and splitting of nodes whose estimate varies most.
#[derive(Clone, Debug, Default)]
pub struct Splitting {
    tree: BinaryTree,
    ways: Ways,
    /// Variance of the intensities below each node, candela squared.
    variance: Vec<f32>,
}

impl Splitting {
    /// Over the tree that is built from the top.
    #[must_use]
    pub fn new(lights: &[TreeLight]) -> Self {
        let tree = BinaryTree::new(lights);
        let mut squares = vec![0.0f64; tree.nodes.len()];
        for k in (0..tree.nodes.len()).rev() {
            let n = &tree.nodes[k];
            squares[k] = if n.is_leaf() {
                f64::from(n.intensity).powi(2)
            } else {
                squares[k + 1] + squares[n.second as usize]
            };
        }
        #[expect(clippy::cast_possible_truncation, reason = "sums are made in f64 and stored in f32")]
        let variance = tree
            .nodes
            .iter()
            .zip(&squares)
            .map(|(n, s)| {
                let mean = f64::from(n.intensity) / f64::from(n.lights);
                (s / f64::from(n.lights) - mean * mean).max(0.0) as f32
            })
            .collect();
        Self { ways: Ways::new(&tree, lights.len()), tree, variance }
    }

    /// One light; `None` is the null light.
    #[must_use]
    pub fn one(&self, at: &Receiver, u: f64) -> Option<Pick> {
        published::one(self, at, u)
    }

    /// With which probability [`Splitting::one`] chooses a light.
    #[must_use]
    pub fn probability(&self, at: &Receiver, light: u32) -> f32 {
        self.ways.probability(self, at, light)
    }

    fn importance(&self, at: &Receiver, node: &Node) -> f32 {
        let d2 = (0.5 * (node.min + node.max) - at.position).length_squared();
        let w = node.intensity * geometry(node, at) / d2;
        if w < f32::INFINITY { w } else { f32::MAX }
    }
}

impl Choose for Splitting {
    fn tree(&self) -> &BinaryTree {
        &self.tree
    }

    fn choose(&self, at: &Receiver, node: u32, u: f64) -> Found {
        walk_down(self, at, node, u)
    }

    fn first(&self, at: &Receiver, node: u32) -> f32 {
        let n = &self.tree.nodes;
        let a = self.importance(at, &n[node as usize + 1]);
        let b = self.importance(at, &n[n[node as usize].second as usize]);
        // Halves, because two of the greatest numbers have no sum.
        0.5 * a / (0.5 * a + 0.5 * b)
    }

    /// \[CK18\] section 5.4: variance of the intensities and of the inverse square of the distance together.
    fn bound(&self, at: &Receiver, node: u32) -> f32 {
        let n = &self.tree.nodes[node as usize];
        if geometry(n, at) <= 0.0 {
            return 0.0;
        }
        let radius = 0.5 * n.size2().sqrt();
        let distance = (0.5 * (n.min + n.max) - at.position).length();
        let (a, b) = (distance - radius, distance + radius);
        if a <= 0.0 {
            return f32::INFINITY;
        }
        let mean_g = 1.0 / (a * b);
        let variance_g = if n.is_leaf() {
            0.0
        } else {
            ((b * b + a * b + a * a) / (3.0 * (a * b).powi(3)) - mean_g * mean_g).max(0.0)
        };
        let lights = n.lights as f32;
        let (mean_e, variance_e) = (n.intensity / lights, self.variance[node as usize]);
        (variance_e * variance_g + variance_e * mean_g * mean_g + mean_e * mean_e * variance_g)
            * lights
            * lights
    }
}

/// Lightcuts: every node has lights that stand for it, one (\[WFA05\]) or 32 (\[WABG06\] Walter et al., "Multidimensional Lightcuts", 2006).
#[derive(Clone, Debug, Default)]
pub struct Representatives {
    tree: BinaryTree,
    /// Leaves that stand for each node, `each` after the other.
    standing: Vec<u32>,
    each: usize,
}

impl Representatives {
    /// `each` lights for a node. With a seed one of the children's is taken by chance, in proportion to intensity; without one that of the brighter child.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 nodes")]
    pub fn new(lights: &[TreeLight], each: usize, seed: Option<u64>) -> Self {
        let tree = super::agglomerative::build(lights);
        let mut standing = vec![0; tree.nodes.len() * each];
        for k in (0..tree.nodes.len()).rev() {
            let n = &tree.nodes[k];
            for j in 0..each {
                standing[k * each + j] = if n.is_leaf() {
                    k as u32
                } else {
                    let (a, b) = (k + 1, n.second as usize);
                    let first = tree.nodes[a].intensity / (tree.nodes[a].intensity + tree.nodes[b].intensity);
                    let child = match seed {
                        Some(seed) => {
                            let h = mix64(seed ^ mix64((k * each + j) as u64));
                            if ((h >> 40) as f32) < first * 16_777_216.0 { a } else { b }
                        }
                        None => {
                            if 0.5 <= first {
                                a
                            } else {
                                b
                            }
                        }
                    };
                    standing[child * each + j]
                };
            }
        }
        Self { tree, standing, each }
    }
}

impl Choose for Representatives {
    fn tree(&self) -> &BinaryTree {
        &self.tree
    }

    fn choose(&self, _: &Receiver, node: u32, u: f64) -> Found {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
        let j = ((u * self.each as f64) as usize).min(self.each - 1);
        let leaf = self.standing[node as usize * self.each + j];
        let n = &self.tree.nodes;
        Found { node: leaf, chance: n[leaf as usize].intensity / n[node as usize].intensity }
    }

    fn first(&self, _: &Receiver, node: u32) -> f32 {
        let n = &self.tree.nodes;
        n[node as usize + 1].intensity / n[node as usize].intensity
    }

    fn bound(&self, at: &Receiver, node: u32) -> f32 {
        bound(&self.tree.nodes[node as usize], at)
    }
}

/// Stochastic lightcuts that turn back where they end in a dead node: the first version of \[SLC20\] section 3.2.2, which is biased.
#[derive(Clone, Debug)]
pub struct BackTracking(pub Lightcuts);

impl BackTracking {
    fn down(&self, at: &Receiver, node: u32, u: f64) -> Option<Found> {
        let nodes = &self.0.tree().nodes;
        if nodes[node as usize].is_leaf() {
            return Some(Found { node, chance: 1.0 });
        }
        let first = self.0.first(at, node);
        if first.is_nan() {
            return None;
        }
        let children = [node + 1, nodes[node as usize].second];
        let p = f64::from(first);
        let second = usize::from(p <= u);
        let (q, u) = if second == 0 { (first, u / p) } else { (1.0 - first, (u - p) / (1.0 - p)) };
        match self.down(at, children[second], u) {
            Some(f) => Some(Found { chance: f.chance * q, ..f }),
            // The probability of what is dead becomes 0, that of the other child 1.
            None => self.down(at, children[1 - second], u),
        }
    }
}

impl Choose for BackTracking {
    fn tree(&self) -> &BinaryTree {
        self.0.tree()
    }

    fn choose(&self, at: &Receiver, node: u32, u: f64) -> Found {
        self.down(at, node, u).unwrap_or(Found { node, chance: 1.0 })
    }

    fn first(&self, at: &Receiver, node: u32) -> f32 {
        self.0.first(at, node)
    }

    fn bound(&self, at: &Receiver, node: u32) -> f32 {
        self.0.bound(at, node)
    }
}
