//! The tree that bakes use: eight children a node, whose weights are computed together.

use super::build::{BinaryTree, Node};
use super::{FallOff, Receiver, TreeLight};
use glam::Vec3A;
use std::f32::consts::PI;

/// Children of a node.
pub(super) const LANES: usize = 8;

/// Marks a child that is a light.
const LIGHT: u32 = 1 << 31;

/// One number for each child.
type Lanes = [f32; LANES];

/// Mean of the inverse squared distance to lights in a box is about that to its middle, with this part of its squared half diagonal
/// added to the square: as in a ball, 3 / radius^2 in the middle, 1 / distance^2 from afar.
const SOFT: f32 = 1.0 / 6.0;

/// A light with a size, such as half of a neon tube, is no nearer than the nearest point of its box, and inside of it about as near as these parts of the squared half
/// sides: the shorter two, and the longest, along which its places are few.
const INSIDE: [f32; 2] = [0.044, 1e-4];

/// A weight is no smaller than this part of what a light would bring that shines straight at the place: where the cosines of the middle say that nothing
/// arrives, something may still.
const LEAST: f32 = 0.02;

/// Rounding of a direction's cosines.
const ROUNDING: f32 = 1e-5;

/// Where and how the lights of eight children shine, one array for each number.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Wide {
    /// Middles of the boxes, metres.
    middle: [Lanes; 3],
    /// Half their sides, metres.
    half: [Lanes; 3],
    /// Half their diagonals, metres.
    radius: Lanes,
    /// Added to the squares of the distances of the nearest and of the farthest place, square metres.
    near2: Lanes,
    far2: Lanes,
    /// How large lights are beside their box: 1 for a light, the distance of which is that of its box, 0 for points far apart, the distance of
    /// which is that of their middle.
    solid: Lanes,
    /// Axes of the cones of normals.
    axis: [Lanes; 3],
    /// Cosines of the angles from them beyond which nothing shines, a little less; -2 where everything may.
    shine: Lanes,
    /// Means of the patches' normals by intensity: the shorter, the more they differ.
    facing: [Lanes; 3],
    /// A quarter of what they lack to 1.
    spread: Lanes,
    /// Candela of what does not fall with a cosine; 0 where there is no child.
    flat: Lanes,
    /// Candela of what does.
    patches: Lanes,
    /// Whether there is a child that does not shine everywhere.
    directed: bool,
    /// What stands there.
    pub(super) child: [Child; LANES],
}

/// A child of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Child(u32);

impl Child {
    const NONE: Self = Self(u32::MAX);

    /// The light that it is.
    pub(super) fn light(self) -> Option<u32> {
        (self.0 & LIGHT != 0 && self != Self::NONE).then_some(self.0 & !LIGHT)
    }

    /// The node that it is, if it is no light.
    pub(super) fn node(self) -> u32 {
        self.0
    }
}

/// A set of lights that are asked together, a bit for each group.
pub type Groups = u32;

/// Trees over groups of lights.
#[derive(Clone, Debug, Default)]
pub struct LightTree {
    pub(super) nodes: Vec<Wide>,
    /// The first node of each group.
    pub(super) roots: Vec<Option<u32>>,
    /// For each light the node that holds it, and where in it; `u32::MAX` if it does not shine.
    pub(super) place: Vec<(u32, u8)>,
    /// For each node its parent and where in it; that of a root is itself.
    pub(super) parent: Vec<(u32, u8)>,
    /// Whether the processor takes eight numbers at once; that makes no difference to what comes out.
    avx2: bool,
}

/// Weights of eight children.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weights {
    /// What they may bring, only ratios count.
    pub(super) weight: Lanes,
    /// Whether they are large beside their distance: squared half diagonal over squared distance of the middle.
    pub(super) nearness: Lanes,
}

impl LightTree {
    /// A tree over groups of lights, one behind the other: `groups` says how many there are of each.
    ///
    /// # Panics
    ///
    /// If the groups hold other than all lights.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^31 lights")]
    pub fn new(lights: &[TreeLight], groups: &[usize]) -> Self {
        assert_eq!(groups.iter().sum::<usize>(), lights.len(), "every light is in a group");
        #[cfg(target_arch = "x86_64")]
        let avx2 = is_x86_feature_detected!("avx2");
        #[cfg(not(target_arch = "x86_64"))]
        let avx2 = false;
        let mut tree = Self { place: vec![(u32::MAX, 0); lights.len()], avx2, ..Self::default() };
        let mut first = 0;
        for &n in groups {
            let binary = BinaryTree::new(&lights[first..first + n]);
            let root = (!binary.nodes.is_empty()).then_some(tree.nodes.len() as u32);
            if let Some(root) = root {
                tree.collapse(&binary, first as u32, root);
            }
            tree.roots.push(root);
            first += n;
        }
        tree
    }

    /// The same without using what the processor offers.
    #[cfg(test)]
    pub(super) fn without_lanes(self) -> Self {
        Self { avx2: false, ..self }
    }

    /// What the children of a node may bring to a place.
    #[inline]
    pub(super) fn weigh(&self, node: u32, at: &Receiver, fall_off: FallOff) -> Weights {
        let node = &self.nodes[node as usize];
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            #[expect(unsafe_code, reason = "needs the processor's features")]
            // SAFETY: the processor was asked.
            return unsafe { node.weigh_avx2(at, fall_off) };
        }
        node.weigh(at, fall_off)
    }

    /// Number of lights that shine.
    #[must_use]
    pub fn len(&self) -> usize {
        self.place.iter().filter(|p| p.0 != u32::MAX).count()
    }

    /// Whether nothing shines.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The way to the middle of the nearest light of the groups whose bits are set, metres.
    #[must_use]
    pub fn nearest(&self, p: Vec3A, groups: Groups) -> Option<Vec3A> {
        let mut best = (f32::INFINITY, None);
        let mut stack: Vec<(f32, u32)> = Vec::with_capacity(32);
        let asked = |g: usize| groups >> g & 1 == 1;
        stack.extend(
            self.roots.iter().enumerate().filter(|(g, _)| asked(*g)).filter_map(|(_, r)| Some((0.0, (*r)?))),
        );
        while let Some((least, node)) = stack.pop() {
            if best.0 <= least {
                continue;
            }
            let w = &self.nodes[node as usize];
            let first = stack.len();
            for k in 0..LANES {
                if w.child[k] == Child::NONE {
                    continue;
                }
                let d = Vec3A::new(w.middle[0][k], w.middle[1][k], w.middle[2][k]) - p;
                let half = Vec3A::new(w.half[0][k], w.half[1][k], w.half[2][k]);
                if w.child[k].light().is_some() {
                    if d.length_squared() < best.0 {
                        best = (d.length_squared(), Some(d));
                    }
                } else {
                    let least = (d.abs() - half).max(Vec3A::ZERO).length_squared();
                    stack.push((least, w.child[k].0));
                }
            }
            // The nearest one is looked into first.
            stack[first..].sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        }
        best.1
    }

    /// Bytes that it takes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Wide>() + (self.place.len() + self.parent.len()) * size_of::<(u32, u8)>()
    }

    /// Gathers binary nodes, the lights of which start at `first`, into wide ones.
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^31 nodes")]
    fn collapse(&mut self, binary: &BinaryTree, first: u32, root: u32) {
        // Binary nodes whose children become a wide node, in the order of the wide nodes.
        let mut queue = vec![0u32];
        self.parent.push((root, 0));
        let mut next = 0;
        while next < queue.len() {
            let at = root + next as u32;
            let mut wide = Wide::EMPTY;
            for (lane, k) in children(binary, queue[next]).into_iter().enumerate() {
                let node = &binary.nodes[k as usize];
                wide.set(lane, node);
                if node.is_leaf() {
                    let light = first + node.light;
                    wide.child[lane] = Child(light | LIGHT);
                    self.place[light as usize] = (at, lane as u8);
                } else {
                    wide.child[lane] = Child(root + queue.len() as u32);
                    self.parent.push((at, lane as u8));
                    queue.push(k);
                }
            }
            self.nodes.push(wide);
            next += 1;
        }
    }
}

/// Up to eight nodes that together are the node `k`: what is large and bright is opened first.
fn children(binary: &BinaryTree, k: u32) -> Vec<u32> {
    let mut all = vec![k];
    while all.len() < LANES {
        let rank = |k: u32| {
            let n = &binary.nodes[k as usize];
            (n.intensity * n.size2(), n.lights)
        };
        let open =
            all.iter().enumerate().filter(|(_, k)| !binary.nodes[**k as usize].is_leaf()).max_by(|a, b| {
                let (a, b) = (rank(*a.1), rank(*b.1));
                a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
            });
        let Some((at, &open)) = open else { break };
        all[at] = open + 1;
        all.insert(at + 1, binary.nodes[open as usize].second);
    }
    all
}

impl Wide {
    const EMPTY: Self = Self {
        middle: [[0.0; LANES]; 3],
        half: [[0.0; LANES]; 3],
        radius: [0.0; LANES],
        near2: [0.0; LANES],
        far2: [0.0; LANES],
        solid: [0.0; LANES],
        axis: [[0.0; LANES]; 3],
        shine: [-2.0; LANES],
        facing: [[0.0; LANES]; 3],
        spread: [0.0; LANES],
        flat: [0.0; LANES],
        patches: [0.0; LANES],
        directed: false,
        child: [Child::NONE; LANES],
    };

    fn set(&mut self, lane: usize, n: &Node) {
        let middle = 0.5 * (n.min + n.max);
        // Rounding must not put a light above its box.
        let half = (0.5 * (n.max - n.min)) + 2.0 * f32::EPSILON * n.min.abs().max(n.max.abs());
        let half = if n.is_leaf() && n.min == n.max { 0.0 * half } else { half };
        let beyond = n.cone.normals + n.cone.shine;
        let facing = if 0.0 < n.patches { n.facing / n.patches } else { n.facing * 0.0 };
        for axis in 0..3 {
            self.middle[axis][lane] = middle[axis];
            self.half[axis][lane] = half[axis];
            self.axis[axis][lane] = n.cone.axis[axis];
            self.facing[axis][lane] = facing[axis];
        }
        self.radius[lane] = half.length();
        let (r2, longest2) = (half.length_squared(), half.max_element() * half.max_element());
        let diagonal = n.size2().sqrt();
        let solid = if diagonal <= 0.0 { 1.0 } else { (n.sizes / (n.intensity * diagonal)).min(1.0) };
        let solid = if solid.is_finite() { solid } else { 0.0 };
        let near2 = INSIDE[0] * (r2 - longest2).max(0.0) + INSIDE[1] * longest2;
        self.solid[lane] = solid;
        self.near2[lane] = solid * near2 + (1.0 - solid) * SOFT * r2;
        self.far2[lane] = solid * r2 + (1.0 - solid) * SOFT * r2;
        self.spread[lane] = 0.25 * (1.0 - facing.length()).max(0.0);
        self.directed |= beyond < PI;
        self.shine[lane] = if beyond < PI { beyond.cos() - ROUNDING } else { -2.0 };
        self.flat[lane] = (n.intensity - n.patches).max(0.0);
        self.patches[lane] = n.patches;
    }

    /// What the children may bring to a place.
    ///
    /// The mean over a child's box of `I cos cos / d^2`, roughly, and exactly 0 only where no light in it can reach the place: where all
    /// of the box is below the receiver's plane or, for what comes straight, the place is outside of the cone of directions in which its lights shine.
    #[inline(always)]
    fn weigh(&self, at: &Receiver, fall_off: FallOff) -> Weights {
        if at.normal == Vec3A::ZERO {
            match fall_off {
                FallOff::Square => self.weigh_as::<false, false>(at),
                FallOff::Linear => self.weigh_as::<false, true>(at),
            }
        } else {
            match fall_off {
                FallOff::Square => self.weigh_as::<true, false>(at),
                FallOff::Linear => self.weigh_as::<true, true>(at),
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn weigh_avx2(&self, at: &Receiver, fall_off: FallOff) -> Weights {
        self.weigh(at, fall_off)
    }

    /// Written so that compilers turn each step into one on all lanes.
    #[inline(always)]
    fn weigh_as<const SURFACE: bool, const LINEAR: bool>(&self, at: &Receiver) -> Weights {
        let (p, n, below) = (at.position, at.normal, at.below);
        let (ax, ay, az) = (n.x.abs(), n.y.abs(), n.z.abs());
        let mut weight = [0.0; LANES];
        let mut nearness = [0.0; LANES];
        let [mut x, mut y, mut z, mut d2, mut near] = [[0.0; LANES]; 5];
        for k in 0..LANES {
            x[k] = self.middle[0][k] - p.x;
            y[k] = self.middle[1][k] - p.y;
            z[k] = self.middle[2][k] - p.z;
            d2[k] = x[k] * x[k] + y[k] * y[k] + z[k] * z[k];
            let r2 = self.radius[k] * self.radius[k];
            let ex = greater(x[k].abs() - self.solid[k] * self.half[0][k], 0.0);
            let ey = greater(y[k].abs() - self.solid[k] * self.half[1][k], 0.0);
            let ez = greater(z[k].abs() - self.solid[k] * self.half[2][k], 0.0);
            // Where distances between the nearest and the farthest place are uniform, as along a tube, the mean of the inverse square is that of their product.
            near[k] = (ex * ex + ey * ey + ez * ez + self.near2[k]).sqrt();
            let far = (d2[k] + self.far2[k]).sqrt();
            weight[k] = if LINEAR { 1.0 / far } else { 1.0 / (near[k] * far) };
            nearness[k] = r2 / d2[k];
        }
        for k in 0..LANES {
            let facing = -(self.facing[0][k] * x[k] + self.facing[1][k] * y[k] + self.facing[2][k] * z[k]);
            // As the nearest place sees it, which matters most.
            let patch = less(greater(facing, 0.0) / near[k], 1.0) + self.spread[k];
            // What is scattered on the way may have left in any direction.
            let patch = if LINEAR { 0.25 } else { greater(patch, LEAST) };
            weight[k] *= self.flat[k] + self.patches[k] * patch;
        }
        if SURFACE {
            for k in 0..LANES {
                // Height over the receiver's plane, of the middle and of the highest corner.
                let height = n.x * x[k] + n.y * y[k] + n.z * z[k];
                let reach = ax * self.half[0][k] + ay * self.half[1][k] + az * self.half[2][k];
                let top = height + reach;
                // Mean of what is positive, were heights in the box uniform.
                let positive = if reach <= height { height } else { 0.25 * top * top / reach };
                let alive = below < top + 1e-6 * (d2[k].sqrt() + reach);
                let w = weight[k] * greater(less(positive / near[k], 1.0), LEAST);
                weight[k] = if alive { w } else { 0.0 };
            }
        }
        if self.directed && !LINEAR {
            for k in 0..LANES {
                let inverse = 1.0 / d2[k].sqrt();
                // Cosine at the lights between their axis and the way to the place.
                let towards =
                    -(self.axis[0][k] * x[k] + self.axis[1][k] * y[k] + self.axis[2][k] * z[k]) * inverse;
                let sin_box = self.radius[k] * inverse;
                let cos_box = greater(1.0 - sin_box * sin_box, 0.0).sqrt();
                let sin = greater(1.0 - towards * towards, 0.0).sqrt();
                // That of the smallest angle that any part of the box sees.
                let least = towards * cos_box + sin * sin_box;
                let outside = sin_box < 1.0 && towards < cos_box && least <= self.shine[k];
                weight[k] = if outside { 0.0 } else { weight[k] };
            }
        }
        for w in &mut weight {
            *w = if *w < f32::INFINITY { *w } else { 0.0 };
        }
        Weights { weight, nearness }
    }
}

/// As [`f32::min`], likewise.
#[inline(always)]
fn less(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// As [`f32::max`], but in one instruction; `b` if one is not a number.
#[inline(always)]
fn greater(a: f32, b: f32) -> f32 {
    if b < a { a } else { b }
}
