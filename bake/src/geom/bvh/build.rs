//! Makes the eight-wide tree out of the binary one of `obvhs`.

use super::node::{Block, Child, Node, WIDTH};
use super::traverse::STACK;
use super::{Bvh, Opacity};
use crate::error::Error;
use crate::geom::world::World;
use glam::Vec3A;
use obvhs::Boundable;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// Cost of testing the triangles of a block; testing the boxes of a node costs 1.
const BLOCK_COST: f32 = 0.8;

/// Share of the nodes that `obvhs` tries to put in a better place.
const REINSERTED: f32 = 0.1;

struct Boxed(Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

/// The box of a triangle, and a little more than rounding may move its points by when the triangle
/// test shears it.
fn bounds(corners: &[glam::Vec3; 3]) -> Aabb {
    let tight = Aabb::from_points(&corners.map(Vec3A::from));
    let more = Vec3A::splat((tight.max - tight.min).max_element() * (4.0 * f32::EPSILON));
    Aabb { min: tight.min - more, max: tight.max + more }
}

#[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^32 triangles")]
pub(super) fn build(world: &World, take: impl Fn(u32) -> Option<Opacity>) -> Result<Bvh, Error> {
    let mut bvh = Bvh { blocks: vec![Block::empty()], asking: vec![0], ..Bvh::default() };
    let mut triangles = Vec::with_capacity(world.len());
    for (i, v) in world.triangles().enumerate() {
        let i = i as u32;
        if let Some(opacity) = take(i)
            && v.iter().all(|p| p.is_finite())
            && world.geometric_normal(i) != Vec3A::ZERO
        {
            triangles.push((i, opacity == Opacity::Ask));
        }
    }
    if triangles.is_empty() {
        return Ok(bvh);
    }
    let boxed = || triangles.iter().map(|t| Boxed(bounds(&world.corners(t.0)))).collect::<Vec<_>>();
    let mut tree = binary(&boxed());
    let areas: Vec<f32> = triangles.iter().map(|t| world.area(t.0)).collect();
    // About what will be needed: growing would copy them.
    bvh.blocks.reserve(triangles.len() / 4);
    bvh.asking.reserve(triangles.len() / 4);
    bvh.nodes.reserve(triangles.len() / 24);
    for last in [false, true] {
        let plan = Plan::new(&tree, &areas);
        let need = Emit { world, triangles: &triangles, plan: &plan, bvh: &mut bvh }.run();
        if need <= STACK {
            break;
        }
        if last {
            return Err(Error::Usage(format!("the ray tree needs {need} stack entries, more than {STACK}")));
        }
        tree = balanced(&tree, &boxed());
        bvh.nodes.clear();
        bvh.blocks.truncate(1);
        bvh.asking.truncate(1);
    }
    bvh.nodes.shrink_to_fit();
    bvh.blocks.shrink_to_fit();
    bvh.asking.shrink_to_fit();
    Ok(bvh)
}

#[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^32 triangles")]
fn binary(boxes: &[Boxed]) -> Bvh2 {
    let indices = (0..boxes.len() as u32).collect();
    let mut tree = PlocBuilder::with_capacity(boxes.len()).build(
        PlocSearchDistance::Medium,
        boxes,
        indices,
        SortPrecision::U64,
        2,
    );
    ReinsertionOptimizer::default().run(&mut tree, REINSERTED, None);
    tree
}

/// A tree of the least height over the same triangles in the same order, for those that a great many
/// copies of one triangle make high.
#[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^32 triangles")]
fn balanced(tree: &Bvh2, boxes: &[Boxed]) -> Bvh2 {
    let mut leaves = Vec::with_capacity(boxes.len());
    let mut work = vec![0];
    while let Some(i) = work.pop() {
        let node = &tree.nodes[i];
        let first = node.first_index as usize;
        if node.prim_count == 0 {
            work.extend([first + 1, first]);
        } else {
            leaves.push(tree.primitive_indices[first]);
        }
    }
    let mut nodes = vec![Bvh2Node::default()];
    let mut work = vec![(0, 0, leaves.len())];
    while let Some((i, from, to)) = work.pop() {
        if to - from == 1 {
            nodes[i] = Bvh2Node::new(boxes[leaves[from] as usize].0, 1, from as u32);
        } else {
            let (first, middle) = (nodes.len(), from.midpoint(to));
            nodes[i].first_index = first as u32;
            nodes.extend([Bvh2Node::default(); 2]);
            work.extend([(first, from, middle), (first + 1, middle, to)]);
        }
    }
    // Children come after their parents.
    for i in (0..nodes.len()).rev() {
        if nodes[i].prim_count == 0 {
            let first = nodes[i].first_index as usize;
            nodes[i].aabb = nodes[first].aabb.union(&nodes[first + 1].aabb);
        }
    }
    Bvh2 { nodes, primitive_indices: leaves, ..Bvh2::default() }
}

/// What to make of a subtree of the binary tree.
#[derive(Clone, Copy, Default)]
struct Choice {
    /// Lowest cost of the subtree as at most `i + 1` children of one node.
    cost: [f32; WIDTH - 1],
    /// How many of `i + 1` children the left half gets in that; 0 where the subtree is one child. Of
    /// a subtree that is one child: how many of [`WIDTH`] its left half gets, 0 where it is a block.
    left: [u8; WIDTH - 1],
    /// Triangles, at most 255.
    count: u8,
    /// Area of the triangles, square metres.
    surface: f32,
}

/// The cheapest tree of wide nodes that keeps the order of the binary one, found from the leaves up,
/// after \[YKL17\] Ylitie, Karras & Laine, "Efficient Incoherent Ray Traversal on GPUs Through
/// Compressed Wide BVHs", HPG 2017: the cost of a node or a block is the area of its
/// box, which rays meet in proportion to it.
struct Plan<'a> {
    tree: &'a Bvh2,
    /// Area of each triangle, square metres.
    areas: &'a [f32],
    /// By half the index of the left child.
    choices: Vec<Choice>,
}

impl<'a> Plan<'a> {
    #[expect(clippy::cast_possible_truncation, reason = "numbers up to 8")]
    fn new(tree: &'a Bvh2, areas: &'a [f32]) -> Self {
        let mut order = Vec::with_capacity(tree.nodes.len() / 2);
        let mut work = vec![0];
        while let Some(i) = work.pop() {
            let node = &tree.nodes[i];
            if node.prim_count == 0 {
                order.push(i as u32);
                work.extend([node.first_index as usize, node.first_index as usize + 1]);
            }
        }
        let mut plan = Self { tree, areas, choices: vec![Choice::default(); tree.nodes.len() / 2 + 1] };
        for &i in order.iter().rev() {
            let node = &tree.nodes[i as usize];
            let [l, r] = [0, 1].map(|side| plan.of(node.first_index as usize + side));
            // Always some split, also where areas are beyond the largest number.
            let split = |n: usize| {
                let cost = |k: usize| (l.cost[k - 1] + r.cost[n - k - 1], k as u8);
                (2..n).map(cost).fold(cost(1), |best, x| if x.0 < best.0 { x } else { best })
            };
            let mut choice = Choice {
                count: l.count.saturating_add(r.count),
                surface: l.surface + r.surface,
                ..Choice::default()
            };
            let area = node.aabb.half_area();
            let (inner, left) = split(WIDTH);
            let (inner, as_block) = (inner + area, BLOCK_COST * area);
            let is_block = usize::from(choice.count) <= WIDTH && (as_block <= inner || !inner.is_finite());
            (choice.cost[0], choice.left[0]) = if is_block { (as_block, 0) } else { (inner, left) };
            for n in 2..WIDTH {
                let (cost, left) = split(n);
                (choice.cost[n - 1], choice.left[n - 1]) =
                    if cost < choice.cost[0] { (cost, left) } else { (choice.cost[0], 0) };
            }
            plan.choices[node.first_index as usize / 2] = choice;
        }
        plan
    }

    fn of(&self, i: usize) -> Choice {
        let node = &self.tree.nodes[i];
        if node.prim_count == 0 {
            return self.choices[node.first_index as usize / 2];
        }
        Choice {
            cost: [BLOCK_COST * node.aabb.half_area(); WIDTH - 1],
            left: [0; WIDTH - 1],
            count: 1,
            surface: self.areas[self.tree.primitive_indices[node.first_index as usize] as usize],
        }
    }
}

/// Writes nodes and blocks.
struct Emit<'a> {
    world: &'a World,
    triangles: &'a [(u32, bool)],
    plan: &'a Plan<'a>,
    bvh: &'a mut Bvh,
}

impl Emit<'_> {
    /// Entries that a stack needs.
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^31 nodes")]
    fn run(&mut self) -> usize {
        if self.plan.of(0).left[0] == 0 {
            self.bvh.root = self.block(0);
            return 1;
        }
        self.bvh.nodes.push(Node::empty());
        self.bvh.root = Child(0);
        let mut work = vec![(0, 0, 0)];
        let mut most = 0;
        while let Some((source, here, waiting)) = work.pop() {
            let children = self.children(source);
            let waiting = waiting + children.len();
            most = most.max(waiting);
            let mut node = Node::empty();
            for (lane, &i) in children.iter().enumerate() {
                let child = if self.plan.of(i).left[0] == 0 {
                    self.block(i)
                } else {
                    let index = self.bvh.nodes.len();
                    self.bvh.nodes.push(Node::empty());
                    work.push((i, index, waiting));
                    Child(index as u32)
                };
                let b = self.plan.tree.nodes[i].aabb;
                node.set(lane, b.min, b.max, child);
            }
            self.bvh.nodes[here] = node;
        }
        most
    }

    /// The children of the node for `source`. A stack gives the last one first; where any hit will do,
    /// that is the one with the best chance of a hit for its cost. Lines through a box hit something
    /// in it in proportion to the area inside, were there no overlap.
    fn children(&self, source: usize) -> Vec<usize> {
        let tree = self.plan.tree;
        let first = tree.nodes[source].first_index as usize;
        let left = usize::from(self.plan.of(source).left[0]);
        let mut out = Vec::with_capacity(WIDTH);
        let mut work = vec![(first, left), (first + 1, WIDTH - left)];
        while let Some((i, n)) = work.pop() {
            let left = if n == 1 { 0 } else { usize::from(self.plan.of(i).left[n - 1]) };
            if left == 0 {
                out.push(i);
            } else {
                let first = tree.nodes[i].first_index as usize;
                work.extend([(first, left), (first + 1, n - left)]);
            }
        }
        let score = |i: usize| {
            let (c, area) = (self.plan.of(i), tree.nodes[i].aabb.half_area());
            (1.0 - (-c.surface / area).exp()) * area / c.cost[0]
        };
        out.sort_by(|&a, &b| score(a).total_cmp(&score(b)).then(a.cmp(&b)));
        out
    }

    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^31 blocks")]
    fn block(&mut self, source: usize) -> Child {
        let mut triangles = Vec::with_capacity(WIDTH);
        let mut work = vec![source];
        while let Some(i) = work.pop() {
            let node = &self.plan.tree.nodes[i];
            let first = node.first_index as usize;
            if node.prim_count == 0 {
                work.extend([first, first + 1]);
            } else {
                triangles.push(self.triangles[self.plan.tree.primitive_indices[first] as usize]);
            }
        }
        triangles.sort_unstable();
        let (mut block, mut asking) = (Block::empty(), 0);
        for (lane, &(triangle, asks)) in triangles.iter().enumerate() {
            block.set(lane, &self.world.corners(triangle), triangle);
            asking |= u8::from(asks) << lane;
        }
        self.bvh.blocks.push(block);
        self.bvh.asking.push(asking);
        Child::leaf(self.bvh.blocks.len() as u32 - 1)
    }
}
