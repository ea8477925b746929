//! The light tree of lightcuts: built from the leaves by joining what is most alike.
//!
//! Alike is what has a small `I (alpha^2 + c^2 (1 - cos beta)^2)`, of summed intensity, diagonal of the box, half angle of the cone of normals and half
//! the diagonal of the scene (\[WFA05\] Walter et al., "Lightcuts: A Scalable Approach to Illumination", 2005, section 3.1). Looking at all pairs takes
//! O(n^2); here every cluster looks at [`REACH`] neighbours to each side along a space-filling curve, and those that choose each other are
//! joined, round by round (\[MB18\] Meister & Bittner, "Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy Construction", 2018): O(n log n), parallel,
//! and the same tree every time.

use super::TreeLight;
use super::build::{BinaryTree, Node};
use glam::Vec3A;
use rayon::prelude::*;
use std::f32::consts::PI;

/// Neighbours to each side among which a cluster looks for its like.
pub const REACH: usize = 32;

/// Builds the tree.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^31 lights")]
pub fn build(lights: &[TreeLight]) -> BinaryTree {
    let (mut min, mut max) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    for l in lights.iter().filter(|l| l.shines()) {
        (min, max) = (min.min(l.min), max.max(l.max));
    }
    let mut keys: Vec<(u64, u32)> = lights
        .par_iter()
        .enumerate()
        .filter(|(_, l)| l.shines())
        .map(|(i, l)| (morton((l.centre() - min) / (max - min)), i as u32))
        .collect();
    keys.par_sort_unstable();
    if keys.is_empty() {
        return BinaryTree::default();
    }
    let c2 = 0.25 * (max - min).length_squared();
    // Joined nodes in the order in which they were made; `second` and `light` are the children until the end.
    let mut made: Vec<Node> = keys.iter().map(|&(_, i)| Node::leaf(&lights[i as usize], i)).collect();
    let mut clusters: Vec<u32> = (0..made.len() as u32).collect();
    let mut children: Vec<[u32; 2]> = vec![[u32::MAX; 2]; made.len()];
    while 1 < clusters.len() {
        let n = clusters.len();
        let nearest: Vec<usize> = (0..n)
            .into_par_iter()
            .map(|i| {
                let near = i.saturating_sub(REACH)..(i + REACH + 1).min(n);
                // In one order, so that rounding is the same from both ends.
                let unlike = |j: &usize| {
                    let [first, second] = [i.min(*j), i.max(*j)].map(|k| &made[clusters[k] as usize]);
                    unlike(first, second, c2)
                };
                // Equal ones are decided by place, alike from both ends, and so that coincident lights pair off.
                let of = |j: &usize| (i ^ *j, i.min(*j));
                near.filter(|j| *j != i)
                    .min_by(|j, k| unlike(j).total_cmp(&unlike(k)).then(of(j).cmp(&of(k))))
                    .unwrap_or(i)
            })
            .collect();
        let mut next = Vec::with_capacity(n);
        for (i, &j) in nearest.iter().enumerate() {
            if nearest[j] != i {
                next.push(clusters[i]);
            } else if i < j {
                let pair = [clusters[i], clusters[j]];
                made.push(Node::parent(&made[pair[0] as usize], &made[pair[1] as usize], u32::MAX));
                children.push(pair);
                next.push(made.len() as u32 - 1);
            }
        }
        clusters = next;
    }
    BinaryTree { nodes: in_order(&made, &children, clusters[0]) }
}

/// Puts children behind their parents, the first one next to it.
#[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 nodes")]
fn in_order(made: &[Node], children: &[[u32; 2]], root: u32) -> Vec<Node> {
    let mut nodes: Vec<Node> = Vec::with_capacity(made.len());
    // Nodes to come, and of which node each is the second child.
    let mut stack = vec![(root, None)];
    while let Some((k, parent)) = stack.pop() {
        let at = nodes.len();
        if let Some(parent) = parent {
            nodes[parent as usize].second = at as u32;
        }
        nodes.push(made[k as usize]);
        if !made[k as usize].is_leaf() {
            let [a, b] = children[k as usize];
            stack.push((b, Some(at as u32)));
            stack.push((a, None));
        }
    }
    nodes
}

/// How unlike two nodes are.
fn unlike(a: &Node, b: &Node, c2: f32) -> f32 {
    let size2 = (a.max.max(b.max) - a.min.min(b.min)).length_squared();
    // Lights without an axis are alike; lights with and without one are as unlike as opposite ones.
    let oriented = a.cone.normals < PI || b.cone.normals < PI;
    let turn = if oriented { 1.0 - a.cone.union(b.cone).normals.cos() } else { 0.0 };
    (a.intensity + b.intensity) * (size2 + c2 * turn * turn)
}

/// Place along a Morton curve of a point in the unit cube.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 21 bits")]
fn morton(p: Vec3A) -> u64 {
    let spread = |x: f32| {
        let x = if x.is_finite() { (x * 2_097_152.0).clamp(0.0, 2_097_151.0) as u64 } else { 0 };
        (0..21).fold(0u64, |m, k| m | (x >> k & 1) << (3 * k))
    };
    spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2
}
