//! Binary trees over lights, built from the top.
//!
//! A node is split where intensity times squared size of the two parts is least: that is what the error of a weight that
//! stands for all of a node grows with. Parts whose lights face different ways count as larger. Candidates are the borders of
//! `BINS` bins along each axis (\[Wal07\] Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", 2007), so building takes
//! O(n log n). Nothing depends on the number of threads.

use super::{Cone, Shine, TreeLight};
use glam::Vec3A;

/// Candidates for splits are the borders of so many bins.
const BINS: usize = 16;

/// Parts with at least so many lights are built by threads of their own.
const PARALLEL: usize = 4096;

/// Levels after which nodes are split in the middle, however bad that is: coincident and exponentially spaced lights would make chains.
const DEPTH: u32 = 48;

/// A node of a binary tree.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// Least corner, metres.
    pub min: Vec3A,
    /// Greatest corner, metres.
    pub max: Vec3A,
    /// Sum of intensities, candela.
    pub intensity: f32,
    /// The part of it that falls with the cosine.
    pub patches: f32,
    /// Sum of intensity times normal over these.
    pub facing: Vec3A,
    /// Sum of intensity times diagonal of its lights, candela metres.
    pub sizes: f32,
    /// Bounds of directions.
    pub cone: Cone,
    /// Lights below.
    pub lights: u32,
    /// The second child; the first one is the next node. 0 for leaves.
    pub second: u32,
    /// The light of a leaf.
    pub light: u32,
}

/// A binary tree; children stand behind their parents.
#[derive(Clone, Debug, Default)]
pub struct BinaryTree {
    /// The root first; empty if no light shines.
    pub nodes: Vec<Node>,
}

impl Node {
    /// A leaf.
    #[must_use]
    pub fn leaf(light: &TreeLight, index: u32) -> Self {
        let (patches, facing) = match light.shine {
            Shine::Cosine { normal } => (light.intensity, light.intensity * normal),
            _ => (0.0, Vec3A::ZERO),
        };
        Self {
            min: light.min,
            max: light.max,
            intensity: light.intensity,
            patches,
            facing,
            sizes: light.intensity * (light.max - light.min).length(),
            cone: Cone::of(light.shine),
            lights: 1,
            second: 0,
            light: index,
        }
    }

    /// The parent of two nodes; `second` says where the second one stands.
    #[must_use]
    pub fn parent(a: &Self, b: &Self, second: u32) -> Self {
        Self {
            min: a.min.min(b.min),
            max: a.max.max(b.max),
            intensity: a.intensity + b.intensity,
            patches: a.patches + b.patches,
            facing: a.facing + b.facing,
            sizes: a.sizes + b.sizes,
            cone: a.cone.union(b.cone),
            lights: a.lights + b.lights,
            second,
            light: u32::MAX,
        }
    }

    /// Whether it is one light.
    #[must_use]
    pub fn is_leaf(&self) -> bool {
        self.second == 0
    }

    /// Squared length of the diagonal, square metres.
    #[must_use]
    pub fn size2(&self) -> f32 {
        (self.max - self.min).length_squared()
    }
}

impl BinaryTree {
    /// A tree over those of the lights that shine.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^31 lights")]
    pub fn new(lights: &[TreeLight]) -> Self {
        let mut items: Vec<Item> = lights
            .iter()
            .enumerate()
            .filter(|(_, l)| l.shines())
            .map(|(i, l)| Item { light: *l, centre: l.centre(), index: i as u32 })
            .collect();
        if items.is_empty() {
            return Self::default();
        }
        let nothing = Node::leaf(&items[0].light, 0);
        let mut nodes = vec![nothing; 2 * items.len() - 1];
        build(&mut items, &mut nodes, 0, 0);
        Self { nodes }
    }

    /// Where each of `n` lights has its leaf; `u32::MAX` for those that do not shine.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 nodes")]
    pub fn leaves(&self, n: usize) -> Vec<u32> {
        let mut leaves = vec![u32::MAX; n];
        for (i, node) in self.nodes.iter().enumerate().filter(|(_, n)| n.is_leaf()) {
            leaves[node.light as usize] = i as u32;
        }
        leaves
    }

    /// The parent of each node; that of the root is itself.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 nodes")]
    pub fn parents(&self) -> Vec<u32> {
        let mut parents = vec![0; self.nodes.len()];
        for (i, node) in self.nodes.iter().enumerate().filter(|(_, n)| !n.is_leaf()) {
            parents[i + 1] = i as u32;
            parents[node.second as usize] = i as u32;
        }
        parents
    }
}

/// A light that is being sorted.
#[derive(Clone, Copy, Debug)]
struct Item {
    light: TreeLight,
    centre: Vec3A,
    index: u32,
}

/// Builds the tree over `items` in `nodes`, the first of which has the number `first`.
#[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 nodes")]
fn build(items: &mut [Item], nodes: &mut [Node], first: u32, depth: u32) {
    if let [item] = items {
        nodes[0] = Node::leaf(&item.light, item.index);
        return;
    }
    let middle = split(items, depth);
    let (left, right) = items.split_at_mut(middle);
    let (root, rest) = nodes.split_at_mut(1);
    let (a, b) = rest.split_at_mut(2 * middle - 1);
    let second = first + 2 * middle as u32;
    let parallel = PARALLEL <= left.len().max(right.len());
    let mut halves = (|| build(left, a, first + 1, depth + 1), || build(right, b, second, depth + 1));
    if parallel {
        rayon::join(&mut halves.0, &mut halves.1);
    } else {
        (halves.0)();
        (halves.1)();
    }
    root[0] = Node::parent(&a[0], &b[0], second);
}

/// Sorts the items into two parts and says where the second one starts.
fn split(items: &mut [Item], depth: u32) -> usize {
    let half = items.len() / 2;
    let (mut min, mut max) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    for i in &*items {
        (min, max) = (min.min(i.centre), max.max(i.centre));
    }
    let extent = max - min;
    // Equal places, or so near to each other that bins cannot tell them apart.
    let scale = Vec3A::splat(BINS as f32) / extent;
    if DEPTH <= depth || extent.max_element() <= 0.0 || !scale.min_element().is_finite() {
        items.select_nth_unstable_by(half, |a, b| {
            let axis = longest(extent);
            a.centre[axis].total_cmp(&b.centre[axis]).then(a.index.cmp(&b.index))
        });
        return half;
    }
    let bin = |c: Vec3A, axis: usize| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let k = ((c[axis] - min[axis]) * scale[axis]).max(0.0) as usize;
        k.min(BINS - 1)
    };
    let mut bins = [[Part::default(); BINS]; 3];
    for i in &*items {
        for (axis, bins) in bins.iter_mut().enumerate() {
            bins[bin(i.centre, axis)].add(&i.light);
        }
    }
    let mut best = (f32::INFINITY, 0, 0);
    for (axis, bins) in bins.iter().enumerate() {
        let mut behind = [Part::default(); BINS];
        let mut sum = Part::default();
        for k in (1..BINS).rev() {
            sum = sum.with(&bins[k]);
            behind[k] = sum;
        }
        let mut before = Part::default();
        for k in 1..BINS {
            before = before.with(&bins[k - 1]);
            if 0 < before.count && 0 < behind[k].count {
                let cost = before.cost() + behind[k].cost();
                if cost < best.0 {
                    best = (cost, axis, k);
                }
            }
        }
    }
    let (cost, axis, border) = best;
    if !cost.is_finite() {
        items.select_nth_unstable_by(half, |a, b| a.index.cmp(&b.index));
        return half;
    }
    let mut middle = 0;
    for k in 0..items.len() {
        if bin(items[k].centre, axis) < border {
            items.swap(middle, k);
            middle += 1;
        }
    }
    middle
}

fn longest(extent: Vec3A) -> usize {
    let m = extent.max_element();
    (0..3).find(|&k| extent[k] == m).unwrap_or(0)
}

/// Lights that may become a node.
#[derive(Clone, Copy, Debug)]
struct Part {
    min: Vec3A,
    max: Vec3A,
    intensity: f32,
    facing: Vec3A,
    count: u32,
}

impl Default for Part {
    fn default() -> Self {
        let (min, max) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        Self { min, max, intensity: 0.0, facing: Vec3A::ZERO, count: 0 }
    }
}

impl Part {
    fn add(&mut self, light: &TreeLight) {
        let facing = match light.shine {
            Shine::Everywhere => Vec3A::ZERO,
            Shine::Cone { axis, .. } => light.intensity * axis,
            Shine::Cosine { normal } => light.intensity * normal,
        };
        self.min = self.min.min(light.min);
        self.max = self.max.max(light.max);
        self.intensity += light.intensity;
        self.facing += facing;
        self.count += 1;
    }

    fn with(mut self, o: &Self) -> Self {
        self.min = self.min.min(o.min);
        self.max = self.max.max(o.max);
        self.intensity += o.intensity;
        self.facing += o.facing;
        self.count += o.count;
        self
    }

    fn cost(&self) -> f32 {
        if self.count == 0 {
            return 0.0;
        }
        let spread = 1.0 - (self.facing.length() / self.intensity).min(1.0);
        self.intensity * (self.max - self.min).length_squared() * (1.0 + spread)
    }
}
