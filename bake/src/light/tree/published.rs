//! Stochastic lightcuts as published, \[SLC20\], but for what is biased there.
//!
//! A binary tree built by joining what is alike; lights chosen by walking down with the weights of eq. 2 and 3; several of them by a cut: the
//! node with the greatest bound is split, its sample goes to the child that contains it and the other child draws one.
//!
//! Two things differ. A node whose sample is null stays in the heap like any other and hands it on to the child in which it was found: dropping the
//! node, as section 3.3 says, loses what its other lights bring. And nodes are split in the order of their bounds alone, up to a number of samples
//! or down to a part of the sum of bounds: the published threshold, 2 % of the running estimate, depends on the samples that it is applied to.
//! Directional lights are not in the tree, so eq. 4 has no use: it adds candela to lux.

use super::build::{BinaryTree, Node};
use super::{Cone, Pick, Receiver, TreeLight, agglomerative};
use glam::Vec3A;
use std::collections::BinaryHeap;
use std::f32::consts::PI;

/// Distances count where they exceed the diagonals of both nodes times this: \[SLC20\] eq. 3.
pub const ALPHA: f32 = 1.0;

/// A light found below a node, or the dead node in which the way down ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Leaf or dead node.
    pub node: u32,
    /// Probability of ending there.
    pub chance: f32,
}

/// How lights are chosen within nodes of a binary tree, and which nodes are split first.
pub trait Choose {
    /// The tree.
    fn tree(&self) -> &BinaryTree;

    /// Something below a node, chosen by `u` in [0, 1).
    fn choose(&self, at: &Receiver, node: u32, u: f64) -> Found;

    /// The probability with which [`Choose::choose`] takes the first child of an inner node.
    fn first(&self, at: &Receiver, node: u32) -> f32;

    /// Nodes with the greatest bound are split first; those with 0 bring nothing.
    fn bound(&self, at: &Receiver, node: u32) -> f32;
}

/// When splitting ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Until {
    /// With so many samples, null lights included.
    pub samples: usize,
    /// When no node's bound is more than this part of the sum of all; infinite bounds do not count in it.
    pub part: f32,
}

/// Breaking the rules of an unbiased cut, to show what comes of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rule {
    /// Unbiased.
    #[default]
    Right,
    /// Nodes whose sample is null are dropped (\[SLC20\] section 3.3).
    #[cfg(feature = "comparison")]
    DropNull,
    /// Splitting ends when no bound exceeds 2 % of the estimate so far (section 3.1).
    #[cfg(feature = "comparison")]
    RunningEstimate,
}

impl Rule {
    /// Whether a node with this sample is dropped.
    fn drops(self, light: Option<u32>) -> bool {
        match self {
            #[cfg(feature = "comparison")]
            Self::DropNull => light.is_none(),
            _ => {
                let _ = light;
                false
            }
        }
    }

    /// Whether a node with this bound is left whole, and with it all others.
    fn stops(self, bound: f32, least: f32, estimate: f32) -> bool {
        match self {
            #[cfg(feature = "comparison")]
            Self::RunningEstimate => bound <= 0.02 * estimate,
            _ => {
                let _ = estimate;
                bound < least
            }
        }
    }
}

/// A node of a cut.
#[derive(Clone, Copy, Debug)]
struct Entry {
    bound: f32,
    intensity: f32,
    node: u32,
    found: Found,
    value: f32,
}

impl PartialEq for Entry {
    fn eq(&self, o: &Self) -> bool {
        self.cmp(o).is_eq()
    }
}

impl Eq for Entry {}

impl PartialOrd for Entry {
    fn partial_cmp(&self, o: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(o))
    }
}

impl Ord for Entry {
    fn cmp(&self, o: &Self) -> std::cmp::Ordering {
        let key = self.bound.total_cmp(&o.bound).then(self.intensity.total_cmp(&o.intensity));
        key.then(o.node.cmp(&self.node))
    }
}

/// Chooses lights by a cut. `numbers` gives numbers in [0, 1), `value` what a light brings if it is the only one (used by
/// [`Rule::RunningEstimate`] alone), `visit` gets the lights. Returns the number of samples, null lights included.
pub fn cut(
    lights: &impl Choose,
    at: &Receiver,
    until: Until,
    rule: Rule,
    numbers: &mut dyn FnMut() -> f64,
    value: &mut dyn FnMut(u32) -> f32,
    visit: &mut dyn FnMut(Pick),
) -> usize {
    let tree = lights.tree();
    let light_of = |f: Found| Some(tree.nodes[f.node as usize]).filter(Node::is_leaf).map(|n| n.light);
    let running = !matches!(rule, Rule::Right);
    let entry = |node: u32, found: Found, bound: f32, value: &mut dyn FnMut(u32) -> f32| {
        let value = match light_of(found) {
            Some(light) if running => value(light) / found.chance,
            _ => 0.0,
        };
        Entry { bound, intensity: tree.nodes[node as usize].intensity, node, found, value }
    };
    if tree.nodes.is_empty() {
        return 0;
    }
    let bound = lights.bound(at, 0);
    if bound.is_nan() || bound <= 0.0 || until.samples == 0 {
        return 0;
    }
    let found = lights.choose(at, 0, numbers());
    if rule.drops(light_of(found)) {
        return 1;
    }
    let mut heap = BinaryHeap::new();
    heap.push(entry(0, found, bound, value));
    // Entries that are not split any more.
    let mut done: Vec<Entry> = Vec::new();
    let mut samples = 1;
    let finite = |b: f32| if b.is_finite() { b } else { 0.0 };
    let mut sum = finite(bound);
    let mut estimate = heap.peek().map_or(0.0, |e| e.value);
    while samples < until.samples
        && let Some(e) = heap.pop()
    {
        if rule.stops(e.bound, until.part * sum, estimate) {
            done.push(e);
            break;
        }
        let node = &tree.nodes[e.node as usize];
        // A leaf, or dead.
        if e.found.node == e.node {
            done.push(e);
            continue;
        }
        let first = lights.first(at, e.node);
        let (a, b) = (e.node + 1, node.second);
        let in_second = b <= e.found.node;
        let (kept, other) = if in_second { (b, a) } else { (a, b) };
        let part = if in_second { 1.0 - first } else { first };
        sum -= finite(e.bound);
        estimate -= e.value;
        for (child, found) in [
            (kept, Some(Found { chance: e.found.chance / part, ..e.found })),
            (other, (part < 1.0).then(|| lights.choose(at, other, numbers()))),
        ] {
            let Some(found) = found else { continue };
            samples += usize::from(child == other);
            if rule.drops(light_of(found)) {
                continue;
            }
            let e = entry(child, found, lights.bound(at, child), value);
            sum += finite(e.bound);
            estimate += e.value;
            heap.push(e);
        }
    }
    for e in heap.into_iter().chain(done) {
        if let Some(light) = light_of(e.found) {
            visit(Pick { light, chance: e.found.chance, alone: e.found.chance });
        }
    }
    samples
}

/// Walks down from a node, each step by chance: \[SLC20\] algorithm 1. Ends in a node of which neither child can light the place.
pub(super) fn walk_down(lights: &impl Choose, at: &Receiver, node: u32, u: f64) -> Found {
    let nodes = &lights.tree().nodes;
    let (mut node, mut u, mut chance) = (node, u, 1.0);
    while !nodes[node as usize].is_leaf() {
        let first = lights.first(at, node);
        if first.is_nan() {
            break;
        }
        let p = f64::from(first);
        if u < p {
            (node, u, chance) = (node + 1, u / p, chance * first);
        } else {
            (u, chance) = ((u - p) / (1.0 - p), chance * (1.0 - first));
            node = nodes[node as usize].second;
        }
        u = u.min(1.0 - f64::EPSILON);
    }
    Found { node, chance }
}

/// The ways up from the lights of a binary tree.
#[derive(Clone, Debug, Default)]
pub(super) struct Ways {
    leaves: Vec<u32>,
    parents: Vec<u32>,
}

impl Ways {
    /// Of a tree of `n` lights.
    pub(super) fn new(tree: &BinaryTree, n: usize) -> Self {
        Self { leaves: tree.leaves(n), parents: tree.parents() }
    }

    /// With which probability [`Choose::choose`] ends at a light from the root.
    pub(super) fn probability(&self, lights: &impl Choose, at: &Receiver, light: u32) -> f32 {
        let Some(&leaf) = self.leaves.get(light as usize).filter(|l| **l != u32::MAX) else { return 0.0 };
        if lights.bound(at, 0) <= 0.0 {
            return 0.0;
        }
        let mut way = vec![leaf];
        let mut node = leaf;
        while node != 0 {
            node = self.parents[node as usize];
            way.push(node);
        }
        let mut chance = 1.0;
        for pair in way.windows(2).rev() {
            let (child, parent) = (pair[0], pair[1]);
            let first = lights.first(at, parent);
            if first.is_nan() {
                return 0.0;
            }
            chance *= if child == parent + 1 { first } else { 1.0 - first };
        }
        chance
    }
}

/// One light below the root; `None` is the null light.
pub(super) fn one(lights: &impl Choose, at: &Receiver, u: f64) -> Option<Pick> {
    let nodes = &lights.tree().nodes;
    if nodes.is_empty() || lights.bound(at, 0) <= 0.0 {
        return None;
    }
    let found = lights.choose(at, 0, u);
    let node = &nodes[found.node as usize];
    node.is_leaf().then_some(Pick { light: node.light, chance: found.chance, alone: found.chance })
}

/// Stochastic lightcuts.
#[derive(Clone, Debug, Default)]
pub struct Lightcuts {
    tree: BinaryTree,
    ways: Ways,
}

impl Lightcuts {
    /// Over the tree that is published.
    #[must_use]
    pub fn new(lights: &[TreeLight]) -> Self {
        Self::over(agglomerative::build(lights), lights.len())
    }

    /// Over any tree of `n` lights.
    #[must_use]
    pub fn over(tree: BinaryTree, n: usize) -> Self {
        Self { ways: Ways::new(&tree, n), tree }
    }

    /// One light; `None` is the null light.
    #[must_use]
    pub fn one(&self, at: &Receiver, u: f64) -> Option<Pick> {
        one(self, at, u)
    }

    /// With which probability [`Lightcuts::one`] chooses a light.
    #[must_use]
    pub fn probability(&self, at: &Receiver, light: u32) -> f32 {
        self.ways.probability(self, at, light)
    }
}

impl Choose for Lightcuts {
    fn tree(&self) -> &BinaryTree {
        &self.tree
    }

    fn choose(&self, at: &Receiver, node: u32, u: f64) -> Found {
        walk_down(self, at, node, u)
    }

    /// \[SLC20\] eq. 2 and 3; NaN where the node is dead.
    fn first(&self, at: &Receiver, node: u32) -> f32 {
        let n = &self.tree.nodes;
        let (a, b) = (&n[node as usize + 1], &n[n[node as usize].second as usize]);
        let far = |n: &Node| ALPHA * ALPHA * n.size2() < least_distance2(n, at.position);
        let far = far(a) && far(b);
        let (a, b) = (weight(a, at, far), weight(b, at, far));
        a / (a + b)
    }

    fn bound(&self, at: &Receiver, node: u32) -> f32 {
        bound(&self.tree.nodes[node as usize], at)
    }
}

/// Most that a node may bring, shadows aside: \[SLC20\] eq. 1. Infinite where the place is in its box.
pub(super) fn bound(node: &Node, at: &Receiver) -> f32 {
    let w = weight(node, at, false);
    if w <= 0.0 { 0.0 } else { w / least_distance2(node, at.position) }
}

/// \[SLC20\] eq. 2.
fn weight(node: &Node, at: &Receiver, far: bool) -> f32 {
    let w = geometry(node, at) * node.intensity;
    if far { w / least_distance2(node, at.position) } else { w }
}

/// Squared distance to the nearest place in the box, square metres.
pub(super) fn least_distance2(node: &Node, p: Vec3A) -> f32 {
    (node.min - p).max(p - node.max).max(Vec3A::ZERO).length_squared()
}

/// Most that the cosines at both ends can be, by the ball around the box (\[CK18\] section 4.1). What is below the receiver's plane has 0.
pub(super) fn geometry(node: &Node, at: &Receiver) -> f32 {
    let middle = 0.5 * (node.min + node.max);
    let half = 0.5 * (node.max - node.min);
    let d = middle - at.position;
    let (d2, r2) = (d.length_squared(), half.length_squared());
    let inside = d2 <= r2;
    let inverse = 1.0 / d2.sqrt();
    let sin_box = (r2.sqrt() * inverse).min(1.0);
    let cos_box = (1.0 - sin_box * sin_box).sqrt();
    let receiver = if at.normal == Vec3A::ZERO {
        1.0
    } else {
        let top = at.normal.dot(d) + at.normal.abs().dot(half);
        if top <= at.below {
            return 0.0;
        }
        let cos = at.normal.dot(d) * inverse;
        let most = if inside { 1.0 } else { nearer(cos, cos_box, sin_box) };
        // By way of media light that comes in the receiver's plane or from behind counts as well.
        if at.below < 0.0 { most.max(0.1) } else { most.max(0.0) }
    };
    let Cone { axis, normals, shine } = node.cone;
    if PI <= normals || inside {
        return receiver;
    }
    // The smallest angle between a normal and the way to the place.
    let angle = (-axis.dot(d) * inverse).clamp(-1.0, 1.0).acos() - normals - sin_box.asin();
    if shine < angle {
        return 0.0;
    }
    let cosine = node.intensity == node.patches;
    receiver * if cosine { angle.max(0.0).cos().max(0.0) } else { 1.0 }
}

/// Cosine of an angle after taking another one from it, 1 if nothing is left.
fn nearer(cos: f32, cos_less: f32, sin_less: f32) -> f32 {
    if cos_less <= cos { 1.0 } else { cos * cos_less + (1.0 - cos * cos).max(0.0).sqrt() * sin_less }
}
