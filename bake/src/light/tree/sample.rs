//! Choosing lights for a place.

use super::wide::{Groups, LANES, LightTree, Weights};
use super::{FallOff, Receiver};
use arrayvec::ArrayVec;

/// Most nodes that a cut opens.
const MOST_OPEN: usize = 128;

/// No light is deeper: what building from the top can reach with 2^31 lights.
const DEEPEST: usize = 96;

/// A light that was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick {
    /// Its number.
    pub light: u32,
    /// How often it is chosen on average, at most 1: what it brings has to be divided by this.
    pub chance: f32,
}

/// How far nodes are opened for a cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Nodes whose squared half diagonal is more than this part of the squared distance of their middle are opened.
    pub near: f32,
    /// So are those with more than this part of all weights.
    pub share: f32,
    /// At most so many are, 1 to 128; the roots of the groups are in any case.
    pub open: usize,
}

impl Effort {
    /// For a single light.
    pub const ONE: Self = Self { near: 0.25, share: 0.25, open: 16 };

    /// For `n` lights.
    #[must_use]
    pub fn many(n: usize) -> Self {
        Self { near: 0.25, share: 1.0 / n as f32, open: (16 + n).min(MOST_OPEN) }
    }
}

/// Nodes opened for a place, and what they bring by the weights of the nodes and lights in which that ends.
#[derive(Clone, Debug)]
pub struct Cut<'a> {
    tree: &'a LightTree,
    at: Receiver,
    fall_off: FallOff,
    open: Opened,
    /// Weights of the roots of the groups that are asked.
    roots: [f32; LANES],
    total: f32,
}

/// Open nodes, parents before their children.
type Opened = ArrayVec<Open, MOST_OPEN>;

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
    /// Opens nodes around a place, for the groups whose bits are set.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "at most 128 are open")]
    pub fn cut(&self, at: Receiver, groups: Groups, fall_off: FallOff, effort: Effort) -> Cut<'_> {
        let mut open = Opened::new();
        let most = effort.open.clamp(1, MOST_OPEN);
        let weigh = |node: u32, parent: Option<u8>, lane: u8| {
            let Weights { weight, nearness } = self.nodes[node as usize].weigh(&at, fall_off);
            (Open { node, parent, lane, child: [0; LANES], weight, total: weight.iter().sum() }, nearness)
        };
        let mut nearness: ArrayVec<[f32; LANES], MOST_OPEN> = ArrayVec::new();
        for (g, root) in self.roots.iter().enumerate().take(LANES) {
            if let Some(root) = root.filter(|_| groups >> g & 1 == 1) {
                let (o, near) = weigh(root, None, g as u8);
                open.push(o);
                nearness.push(near);
            }
        }
        // What is near first, then what is bright.
        for bright in [false, true] {
            let all: f32 = if bright {
                let open_children = open.iter().flat_map(|o| (0..LANES).filter(|k| 0 < o.child[*k]).map(|k| o.weight[k]));
                let opened: f32 = open_children.sum();
                open.iter().map(|o| o.total).sum::<f32>() - opened
            } else {
                0.0
            };
            let least = effort.share * all;
            let mut next = 0;
            while next < open.len() && open.len() < most {
                let Open { node, child, weight, .. } = open[next];
                let children = &self.nodes[node as usize].child;
                for lane in 0..LANES {
                    let wanted = if bright { least < weight[lane] } else { effort.near < nearness[next][lane] };
                    if wanted
                        && 0.0 < weight[lane]
                        && child[lane] == 0
                        && children[lane].light().is_none()
                        && open.len() < most
                    {
                        let (o, near) = weigh(children[lane].node() as u32, Some(next as u8), lane as u8);
                        open[next].child[lane] = open.len() as u8;
                        open.push(o);
                        nearness.push(near);
                    }
                }
                next += 1;
            }
        }
        let mut roots = [0.0; LANES];
        let total = sum_up(&mut open, &mut roots);
        Cut { tree: self, at, fall_off, open, roots, total }
    }
}

/// Adds up what open nodes hold, from the last one to the roots, and gives the sum of all.
fn sum_up(open: &mut Opened, roots: &mut [f32; LANES]) -> f32 {
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

impl Cut<'_> {
    /// Sum of all weights; 0 if nothing can reach the place.
    #[must_use]
    pub fn total(&self) -> f32 {
        self.total
    }

    /// One light, chosen by `u` in [0, 1); `None` if that ends where nothing shines: the null light.
    #[must_use]
    pub fn one(&self, u: f64) -> Option<Pick> {
        if !(0.0 < self.total && self.total.is_finite()) {
            return None;
        }
        let mut rest = u;
        let group = step(&self.roots, self.total, &mut rest)?;
        let mut chance = self.roots[group] / self.total;
        let root = self.tree.roots.get(group).copied().flatten()?;
        let mut node = root as usize;
        let mut open = self.find_open(root);
        loop {
            let (weights, total) = match open {
                Some(k) => (self.open[k].weight, self.open[k].total),
                None => self.weigh(node),
            };
            let lane = step(&weights, total, &mut rest)?;
            chance *= weights[lane] / total;
            let child = self.tree.nodes[node].child[lane];
            if let Some(light) = child.light() {
                return Some(Pick { light, chance });
            }
            open = open.and_then(|k| Some(self.open[k].child[lane] as usize).filter(|&k| 0 < k));
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
        let mut way = [(0u32, 0u8); DEEPEST];
        let mut n = 0;
        let (mut node, mut lane) = (node, lane);
        loop {
            way[n] = (node, lane);
            n += 1;
            let parent = self.tree.parent[node as usize];
            if parent.0 == node {
                break;
            }
            (node, lane) = parent;
        }
        let Some(group) = self.tree.roots.iter().position(|r| *r == Some(node)) else { return 0.0 };
        let mut chance = self.roots[group] / self.total;
        let mut open = if 0.0 < chance { self.find_open(node) } else { None };
        for &(node, lane) in way[..n].iter().rev() {
            let (weights, total) = match open {
                Some(k) => (self.open[k].weight, self.open[k].total),
                None => self.weigh(node as usize),
            };
            let weight = weights[lane as usize];
            if !(0.0 < weight && total.is_finite()) {
                return 0.0;
            }
            chance *= weight / total;
            open = open.and_then(|k| Some(self.open[k].child[lane as usize] as usize).filter(|&k| 0 < k));
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
                        visit(Pick { light, chance: 1.0 });
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
        if !(0.0 < total) {
            return;
        }
        // What is too little to be seen in the sum has its chance all the same.
        left = left.max(n as f32 * (total / self.total));
        let walk = Walk { cut: self, open: &open, u };
        walk.share(&roots, total, 0.0, f64::from(left), &mut |group, from, to| {
            if let Some(root) = self.tree.roots.get(group).copied().flatten() {
                walk.descend(root as usize, self.find_open(root), from, to, &mut visit);
            }
        });
    }

    fn find_open(&self, root: u32) -> Option<usize> {
        // Roots are opened first.
        self.open.iter().take(LANES).position(|o| o.node == root)
    }

    fn weigh(&self, node: usize) -> ([f32; LANES], f32) {
        let w = self.tree.nodes[node].weigh(&self.at, self.fall_off).weight;
        (w, w.iter().sum())
    }
}

/// Systematic sampling: a place in the tree that has weight for `to - from` samples gets those of the points `k + u` that lie between.
struct Walk<'a> {
    cut: &'a Cut<'a>,
    open: &'a Opened,
    u: f64,
}

impl Walk<'_> {
    /// Whether a point lies in a part.
    fn hits(&self, from: f64, to: f64) -> bool {
        (from - self.u).ceil() < to - self.u
    }

    /// Divides a part by weights and visits what is hit.
    fn share(
        &self,
        weights: &[f32; LANES],
        total: f32,
        from: f64,
        to: f64,
        visit: &mut dyn FnMut(usize, f64, f64),
    ) {
        let each = (to - from) / f64::from(total);
        let last = (0..LANES).rev().find(|&k| 0.0 < weights[k]);
        let mut start = from;
        for (lane, &w) in weights.iter().enumerate().filter(|w| 0.0 < *w.1) {
            let end = if Some(lane) == last { to } else { (start + f64::from(w) * each).min(to) };
            if self.hits(start, end) {
                visit(lane, start, end);
            }
            start = end;
        }
    }

    fn descend(
        &self,
        node: usize,
        open: Option<usize>,
        from: f64,
        to: f64,
        visit: &mut dyn FnMut(Pick),
    ) {
        let (weights, total) = match open {
            Some(k) => (self.open[k].weight, self.open[k].total),
            None => self.cut.weigh(node),
        };
        if !(0.0 < total && total.is_finite()) {
            return;
        }
        self.share(&weights, total, from, to, &mut |lane, from, to| {
            let child = self.cut.tree.nodes[node].child[lane];
            if let Some(light) = child.light() {
                #[expect(clippy::cast_possible_truncation, reason = "at most 1")]
                let chance = (to - from).min(1.0) as f32;
                if 0.0 < chance {
                    visit(Pick { light, chance });
                }
                return;
            }
            let open = open.and_then(|k| Some(self.open[k].child[lane] as usize).filter(|&k| 0 < k));
            self.descend(child.node(), open, from, to, visit);
        });
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
