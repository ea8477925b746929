//! Choosing lights for a place.

use super::wide::{Groups, LANES, LightTree, Weights};
use super::{FallOff, Receiver};
use arrayvec::ArrayVec;

/// No light is deeper: what building from the top can reach with 2^31 lights.
const DEEPEST: usize = 96;

/// A light that was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick {
    /// Its number.
    pub light: u32,
    /// How often it is chosen on average, at most 1: what it brings has to be divided by this.
    pub chance: f32,
    /// With which probability it is chosen where only one light is.
    pub alone: f32,
}

/// How far nodes are opened for a cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Nodes whose squared half diagonal is more than this part of the squared distance of their middle are opened.
    pub near: f32,
    /// So are those with more than this part of all weights.
    pub share: f32,
}

/// Most nodes that a cut for a single light opens: what is near costs that much and brings less noise. Measured on a hall with 5,000 lamps and 50,000 emissive triangles:
/// 8 gave 10 % more noise in the same time, 40 the same noise in 10 % more time.
pub const FEW: usize = 16;

/// Most nodes that a cut for many lights opens.
pub const MOST: usize = 128;

impl Effort {
    /// For a single light.
    pub const ONE: Self = Self { near: 0.5, share: 1.0 };

    /// For `n` lights: no node is left closed that deserves more than one of them.
    #[must_use]
    pub fn many(n: usize) -> Self {
        Self { near: 0.25, share: 1.0 / n as f32 }
    }
}

/// Up to `N` nodes opened for a place, and what they bring by the weights of the nodes and lights in which that ends.
#[derive(Clone, Debug)]
pub struct Cut<'a, const N: usize> {
    tree: &'a LightTree,
    at: Receiver,
    fall_off: FallOff,
    open: Opened<N>,
    /// Weights of the roots of the groups that are asked.
    roots: [f32; LANES],
    total: f32,
}

/// Open nodes, parents before their children.
type Opened<const N: usize> = ArrayVec<Open, N>;

/// A node that was opened.
#[derive(Clone, Copy, Debug)]
struct Open {
    node: u32,
    /// Which open node it is a child of, and as which one; the group for roots.
    parent: Option<u8>,
    lane: u8,
    /// Which of the open nodes a child is, 0 for none.
    child: [u8; LANES],
    /// Weights of the children; of those that are open themselves that of what they hold.
    weight: [f32; LANES],
    total: f32,
}

impl LightTree {
    /// Opens up to `N` nodes around a place, at most 128, for the groups whose bits are set.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "at most 128 are open")]
    pub fn cut<const N: usize>(
        &self,
        at: Receiver,
        groups: Groups,
        fall_off: FallOff,
        effort: Effort,
    ) -> Cut<'_, N> {
        const { assert!(LANES <= N && N <= MOST, "roots fit, and numbers of open nodes fit in a byte") };
        let (open, roots) = (Opened::new(), [0.0; LANES]);
        let mut cut = Cut { tree: self, at, fall_off, open, roots, total: 0.0 };
        let mut nearness: ArrayVec<[f32; LANES], N> = ArrayVec::new();
        for (g, root) in self.roots.iter().enumerate().take(LANES) {
            if let Some(root) = root.filter(|_| groups >> g & 1 == 1) {
                nearness.push(cut.push(root, None, g as u8));
            }
        }
        // What is near first, then what is bright.
        for bright in [false, true] {
            if bright && 1.0 <= effort.share {
                break;
            }
            let least = if bright { effort.share * cut.sum() } else { 0.0 };
            let mut next = 0;
            while next < cut.open.len() && !cut.open.is_full() {
                let Open { node, child, weight, .. } = cut.open[next];
                let children = &self.nodes[node as usize].child;
                for lane in 0..LANES {
                    let wanted =
                        if bright { least < weight[lane] } else { effort.near < nearness[next][lane] };
                    if wanted
                        && 0.0 < weight[lane]
                        && child[lane] == 0
                        && children[lane].light().is_none()
                        && !cut.open.is_full()
                    {
                        cut.open[next].child[lane] = cut.open.len() as u8;
                        nearness.push(cut.push(children[lane].node(), Some(next as u8), lane as u8));
                    }
                }
                next += 1;
            }
        }
        cut.total = sum_up(&mut cut.open, &mut cut.roots);
        cut
    }
}

/// Adds up what open nodes hold, from the last one to the roots, and gives the sum of all.
fn sum_up<const N: usize>(open: &mut Opened<N>, roots: &mut [f32; LANES]) -> f32 {
    for k in (0..open.len()).rev() {
        let total: f32 = open[k].weight.iter().sum();
        open[k].total = total;
        let lane = open[k].lane as usize;
        match open[k].parent {
            Some(p) => open[p as usize].weight[lane] = total,
            None => roots[lane] = total,
        }
    }
    roots.iter().sum()
}

impl<const N: usize> Cut<'_, N> {
    /// Opens a node, and says how near its children are.
    fn push(&mut self, node: u32, parent: Option<u8>, lane: u8) -> [f32; LANES] {
        let Weights { weight, nearness } = self.tree.weigh(node, &self.at, self.fall_off);
        self.open.push(Open { node, parent, lane, child: [0; LANES], weight, total: 0.0 });
        nearness
    }

    /// Sum of all weights before they are added up.
    fn sum(&self) -> f32 {
        let closed = |o: &Open| (0..LANES).filter(|k| o.child[*k] == 0).map(|k| o.weight[k]).sum::<f32>();
        self.open.iter().map(closed).sum()
    }

    /// Sum of all weights; 0 if nothing can reach the place.
    #[must_use]
    pub fn total(&self) -> f32 {
        self.total
    }

    /// One light, chosen by `u` in [0, 1); `None` if that ends where nothing shines: the null light.
    #[must_use]
    pub fn one(&self, u: f64) -> Option<Pick> {
        let mut rest = u;
        let group = step(&self.roots, self.total, &mut rest)?;
        let mut chance = self.roots[group] / self.total;
        let root = self.tree.roots.get(group).copied().flatten()?;
        let (mut node, mut open) = (root, self.find_open(root));
        loop {
            let (weights, total) = self.weights(node, open);
            let lane = step(&weights, total, &mut rest)?;
            chance *= weights[lane] / total;
            let child = self.tree.nodes[node as usize].child[lane];
            if let Some(light) = child.light() {
                return Some(Pick { light, chance, alone: chance });
            }
            open = self.open_child(open, lane);
            node = child.node();
        }
    }

    /// With which probability [`Cut::one`] chooses a light.
    #[must_use]
    pub fn probability(&self, light: u32) -> f32 {
        let Some(&(node, lane)) = self.tree.place.get(light as usize) else { return 0.0 };
        if node == u32::MAX || !(0.0 < self.total && self.total.is_finite()) {
            return 0.0;
        }
        // The way up, which is then gone down as the choice goes.
        let mut way = ArrayVec::<(u32, u8), DEEPEST>::new();
        let (mut node, mut lane) = (node, lane);
        loop {
            way.push((node, lane));
            let parent = self.tree.parent[node as usize];
            if parent.0 == node {
                break;
            }
            (node, lane) = parent;
        }
        let Some(group) = self.tree.roots.iter().position(|r| *r == Some(node)) else { return 0.0 };
        let mut chance = self.roots[group] / self.total;
        let mut open = if 0.0 < chance { self.find_open(node) } else { return 0.0 };
        for &(node, lane) in way.iter().rev() {
            let lane = lane as usize;
            let (weights, total) = self.weights(node, open);
            if !(0.0 < weights[lane] && total.is_finite()) {
                return 0.0;
            }
            chance *= weights[lane] / total;
            open = self.open_child(open, lane);
        }
        chance
    }

    /// About `n` lights, each at most once. `u` in [0, 1) decides which.
    pub fn many(&self, n: usize, u: f64, mut visit: impl FnMut(Pick)) {
        if n == 0 || !(0.0 < self.total && self.total.is_finite()) {
            return;
        }
        let mut open = self.open.clone();
        let mut roots = self.roots;
        let (mut total, mut left) = (self.total, n as f32);
        // Lights whose share is a whole sample or more are certain, which leaves the others more samples for their weight.
        loop {
            let mut certain = 0;
            for o in &mut open {
                let children = &self.tree.nodes[o.node as usize].child;
                for (weight, child) in o.weight.iter_mut().zip(children) {
                    if 0.0 < *weight
                        && total <= *weight * left
                        && let Some(light) = child.light()
                    {
                        visit(Pick { light, chance: 1.0, alone: *weight / self.total });
                        *weight = 0.0;
                        certain += 1;
                    }
                }
            }
            if certain == 0 {
                break;
            }
            left -= certain as f32;
            total = sum_up(&mut open, &mut roots);
        }
        if total.is_nan() || total <= 0.0 {
            return;
        }
        // What is too little to be seen in the sum has its chance all the same.
        left = left.max(n as f32 * (total / self.total));
        let mut walk = Walk { cut: self, open: &open, u, visit: &mut visit };
        let mut parts = [(0, 0.0, 0.0); LANES];
        let hit = walk.share(&roots, total, 0.0, f64::from(left), &mut parts);
        for &(group, from, to) in &parts[..hit] {
            if let Some(root) = self.tree.roots.get(group).copied().flatten() {
                let alone = self.roots[group] / self.total;
                walk.descend(root, self.find_open(root), (from, to), alone);
            }
        }
    }

    /// Weights of a node's children and their sum.
    #[inline]
    fn weights(&self, node: u32, open: Option<usize>) -> ([f32; LANES], f32) {
        match open {
            Some(k) => (self.open[k].weight, self.open[k].total),
            None => {
                let w = self.tree.weigh(node, &self.at, self.fall_off).weight;
                (w, w.iter().sum())
            }
        }
    }

    fn open_child(&self, open: Option<usize>, lane: usize) -> Option<usize> {
        open.map(|k| self.open[k].child[lane] as usize).filter(|&k| 0 < k)
    }

    fn find_open(&self, root: u32) -> Option<usize> {
        // Roots are opened first.
        self.open.iter().take(LANES).position(|o| o.node == root)
    }
}

/// Systematic sampling: a place in the tree that has weight for `to - from` samples gets those of the points `k + u` that lie between.
struct Walk<'a, V, const N: usize> {
    cut: &'a Cut<'a, N>,
    /// As in the cut, without what is certain.
    open: &'a Opened<N>,
    u: f64,
    visit: &'a mut V,
}

impl<V: FnMut(Pick), const N: usize> Walk<'_, V, N> {
    /// How many points lie below `x`.
    #[inline]
    fn below(&self, x: f64) -> u64 {
        let x = x - self.u;
        if x <= 0.0 {
            return 0;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a small positive number"
        )]
        let whole = x as u64;
        whole + u64::from((whole as f64) < x)
    }

    /// Divides a part by weights, and gives the number of parts that are hit: which child, from and to.
    #[inline]
    fn share(
        &self,
        weights: &[f32; LANES],
        total: f32,
        from: f64,
        to: f64,
        parts: &mut [(usize, f64, f64); LANES],
    ) -> usize {
        let each = (to - from) / f64::from(total);
        let last = (0..LANES).rev().find(|&k| 0.0 < weights[k]);
        let (mut start, mut before, mut hit) = (from, self.below(from), 0);
        for (lane, &w) in weights.iter().enumerate().filter(|w| 0.0 < *w.1) {
            let end = if Some(lane) == last { to } else { (start + f64::from(w) * each).min(to) };
            let upto = self.below(end);
            if before < upto {
                parts[hit] = (lane, start, end);
                hit += 1;
            }
            (start, before) = (end, upto);
        }
        hit
    }

    fn descend(&mut self, node: u32, open: Option<usize>, (from, to): (f64, f64), alone: f32) {
        let (weights, total) = match open {
            Some(k) => (self.open[k].weight, self.open[k].total),
            None => self.cut.weights(node, None),
        };
        if !(0.0 < total && total.is_finite()) {
            return;
        }
        let mut parts = [(0, 0.0, 0.0); LANES];
        let hit = self.share(&weights, total, from, to, &mut parts);
        for &(lane, from, to) in &parts[..hit] {
            let alone = alone
                * match open {
                    Some(k) => self.cut.open[k].weight[lane] / self.cut.open[k].total,
                    None => weights[lane] / total,
                };
            let child = self.cut.tree.nodes[node as usize].child[lane];
            let Some(light) = child.light() else {
                self.descend(child.node(), self.cut.open_child(open, lane), (from, to), alone);
                continue;
            };
            #[expect(clippy::cast_possible_truncation, reason = "at most 1")]
            let chance = (to - from).min(1.0) as f32;
            if 0.0 < chance {
                (self.visit)(Pick { light, chance, alone });
            }
        }
    }
}

/// The child that `rest` in [0, 1) falls on, and `rest` within it.
#[inline]
fn step(weights: &[f32; LANES], total: f32, rest: &mut f64) -> Option<usize> {
    if !(0.0 < total && total.is_finite()) {
        return None;
    }
    let mut left = *rest * f64::from(total);
    let mut chosen = None;
    for (lane, &w) in weights.iter().enumerate() {
        if 0.0 < w {
            chosen = Some((lane, left, w));
            if left < f64::from(w) {
                break;
            }
            left -= f64::from(w);
        }
    }
    let (lane, left, w) = chosen?;
    *rest = (left / f64::from(w)).clamp(0.0, 1.0 - f64::EPSILON);
    Some(lane)
}
