//! A closed mesh as the region of a medium: which parts of a ray are inside.
//!
//! A place is inside where the winding number is not 0: the triangles that a line crosses from there on, those that
//! it leaves by counted as 1 and those that it enters by as -1. So it does not matter which way a mesh faces; shells
//! that overlap or lie in each other unite, and a shell that faces the other way than the one around it is a hole.
//!
//! What a line crosses is decided in its projection along itself, one corner at a time and in f64, by the sign of
//! exact products of that. Every edge counts for the triangle on one side what it takes from the one on the other
//! side, whatever was rounded before, so that all crossings of a closed mesh by a line add up to 0. Lines through
//! edges and corners, and those within a face, count as if moved by less than any number towards larger coordinates on
//! the two axes that are not the direction's largest: a face between two regions belongs to the one on its upper
//! side, as it does for boxes. Distances decide nothing but the order.
//!
//! On lines that cross an open mesh more often in one direction than in the other, a crossing is missing. It is
//! taken to be where the line enters or leaves the bounds: inside is, within them, what the crossings before a
//! place or those after it put inside, a mesh of positive volume facing outwards. All other lines are as if the mesh
//! were closed.

#[cfg(test)]
mod tests;

use super::slabs;
use glam::{DVec3, Vec3, Vec3A, Vec4};
use obvhs::Boundable;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use std::cmp::Ordering;

/// Boxes of a node.
const WIDTH: usize = 4;

/// Most triangles of a leaf.
const LEAF: u32 = 2;

/// Nodes that wait for a line, before it goes deeper on the stack of the thread: hardly ever, but in tests.
const STACK: usize = if cfg!(test) { 2 } else { 48 };

/// What stands for the end of faces where there is a node.
const INNER: u32 = u32::MAX;

/// Share of the nodes that `obvhs` tries to put in a better place.
const REINSERTED: f32 = 0.1;

/// A mesh around a region.
#[derive(Clone, Debug)]
pub struct Boundary {
    /// Leaf by leaf.
    faces: Vec<Face>,
    /// The first is the root.
    nodes: Vec<Node>,
    /// Lower and upper corner.
    bounds: (Vec3, Vec3),
    open: Option<(usize, Vec3)>,
    /// 1, or -1 if the mesh faces inwards.
    outward: i32,
}

/// A triangle with its corners in an order that depends on nothing but where they are, so that it is met at
/// the same place from both sides.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Face {
    corners: [Vec3; 3],
    /// How many triangles here face the way that the order of the corners says, less those that face the other way.
    sign: i32,
}

/// Boxes around the parts of a mesh, component by component.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Node {
    centre: [Vec4; 3],
    /// Half of the extent.
    half: [Vec4; 3],
    /// The first face of each, or the node.
    first: [u32; WIDTH],
    /// Where its faces end, or [`INNER`].
    end: [u32; WIDTH],
}

/// A line, prepared for boxes and faces.
struct Line {
    origin: Vec3A,
    /// The direction's largest axis.
    axis: usize,
    /// The two axes after that: direction over that along the largest axis.
    shear: [f32; 2],
    /// More than rounding moves what is compared with boxes.
    slack: f32,
    /// Least and most coordinate on the largest axis that matters, relative to the origin.
    from: f32,
    to: f32,
    /// Origin, and direction in the order of `shear`, turned towards larger coordinates on the largest axis: a line
    /// and its opposite cross the same faces.
    exact_origin: [f64; 3],
    lean: [f64; 2],
    rise: f64,
    /// 1, or -1 if it was turned.
    sign: i32,
}

/// Which part of a line to look for crossings in.
#[derive(Clone, Copy, PartialEq)]
enum Part {
    /// From the origin on.
    Ahead,
    /// Up to a length.
    Behind,
    Whole,
}

impl Boundary {
    /// A mesh of triangles that index `positions`, metres in world space. Those with corners that are equal or not
    /// finite are left out.
    #[must_use]
    #[expect(clippy::needless_pass_by_value, reason = "what is not needed any more is freed")]
    pub fn new(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Self {
        Self::of(triangles.iter().filter_map(|t| Face::new(t.map(|i| positions[i as usize]), 1)).collect())
    }

    fn of(mut faces: Vec<Face>) -> Self {
        faces.sort_unstable_by(|f, g| f.order(g));
        // Copies become one, and those that face each other none.
        faces.dedup_by(|f, kept| {
            let same = f.corners == kept.corners;
            kept.sign += if same { f.sign } else { 0 };
            same
        });
        faces.retain(|f| f.sign != 0);
        let corners = || faces.iter().flat_map(|f| f.corners);
        let (mut min, mut max) =
            corners().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |b, v| (b.0.min(v), b.1.max(v)));
        if faces.is_empty() {
            (min, max) = (Vec3::ZERO, Vec3::ZERO);
        }
        let open = open_edges(&faces);
        let outward = outward(&faces, 0.5 * min.as_dvec3() + 0.5 * max.as_dvec3());
        let (nodes, faces) = tree(&faces);
        Self { faces, nodes, bounds: (min, max), open, outward }
    }

    /// How many edges have more triangles on one side than on the other, and the middle of one of them; `None` if
    /// the mesh is closed. Corners at the same place are the same corner.
    #[must_use]
    pub fn open_edges(&self) -> Option<(usize, Vec3)> {
        self.open
    }

    /// The mesh relative to `origin`.
    #[must_use]
    pub fn moved(&self, origin: Vec3) -> Self {
        Self::of(self.faces.iter().filter_map(|f| Face::new(f.corners.map(|v| v - origin), f.sign)).collect())
    }

    /// Lower and upper corner, both 0 if there are no triangles.
    #[must_use]
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.bounds
    }

    /// Appends the parts of a ray up to `t_max` that are inside, in order, as from where to where in units of the
    /// direction's length. None is empty, and no two touch.
    ///
    /// Crossings are looked for either from the origin to infinity or from there to `t_max` the other way round,
    /// whichever is less of the mesh: for a closed one the result is the same to the bit.
    #[expect(clippy::cast_possible_truncation, reason = "whole numbers")]
    pub fn inside(&self, origin: Vec3A, direction: Vec3A, t_max: f32, out: &mut Vec<(f32, f32)>) {
        let Some((line, part)) = self.line(origin, direction, t_max).filter(|_| 0.0 < t_max) else { return };
        let begin = out.len();
        let (mut before, mut after) = (0, 0);
        // What is appended holds crossings first: where, and how often.
        self.cross(&line, |t, turn| match t {
            _ if t <= 0.0 => before += turn,
            _ if t < t_max => out.push((t, turn as f32)),
            _ => after += turn,
        });
        out[begin..].sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let turn = |c: &(f32, f32)| c.1 as i32;
        after += out[begin..].iter().map(turn).sum::<i32>();
        let count = Count::new(part, before, after, self.outward);
        let (low, high) = if count.missing == 0 {
            (0.0, t_max)
        } else {
            slabs(self.bounds.0.into(), self.bounds.1.into(), origin, direction, t_max)
        };

        let mut turns = count.start;
        let mut since = count.is_inside(turns).then_some(low);
        let (mut read, mut written) = (begin, begin);
        while let Some(&(t, _)) = out.get(read) {
            while let Some(c) = out.get(read).filter(|c| c.0 == t) {
                turns += turn(c);
                read += 1;
            }
            if !count.is_inside(turns) {
                if let Some(from) = since.take()
                    && from < t.min(high)
                {
                    out[written] = (from, t.min(high));
                    written += 1;
                }
            } else if since.is_none() {
                since = Some(t.max(low));
            }
        }
        out.truncate(written);
        if let Some(from) = since
            && from < high
        {
            out.push((from, high));
        }
    }

    /// Whether a place is inside. Of the boundary that is so where a little further up all axes is.
    #[must_use]
    pub fn contains(&self, p: Vec3A) -> bool {
        let Some((line, part)) = self.line(p, Vec3A::Z, 0.0) else { return false };
        let (mut before, mut after) = (0, 0);
        self.cross(&line, |t, turn| if t <= 0.0 { before += turn } else { after += turn });
        let count = Count::new(part, before, after, self.outward);
        let (min, max) = (Vec3A::from(self.bounds.0), Vec3A::from(self.bounds.1));
        count.is_inside(count.start) && (count.missing == 0 || (min.cmple(p) & p.cmplt(max)).all())
    }

    /// A line and the part of it that tells what is inside up to `t_max`; `None` if there is nothing to cross.
    fn line(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Option<(Line, Part)> {
        let some = !self.faces.is_empty() && direction != Vec3A::ZERO;
        if !some || !origin.is_finite() || !direction.is_finite() {
            return None;
        }
        let axis = direction.abs().max_position();
        let (rise, turned) = (direction[axis].abs(), direction[axis] < 0.0);
        let others = [(axis + 1) % 3, (axis + 2) % 3].map(|i| direction[i]);
        let [min, max] = [self.bounds.0, self.bounds.1].map(|v| Vec3A::from(v) - origin);
        let slack = min.abs().max(max.abs()).max_element() * (8.0 * f32::EPSILON);

        // The mesh begins and ends here on the way, and the ray ends there.
        let (near, far) = if turned { (-max[axis], -min[axis]) } else { (min[axis], max[axis]) };
        let end = t_max * rise;
        let part = match self.open {
            Some(_) => Part::Whole,
            None if end - near < far => Part::Behind,
            None => Part::Ahead,
        };
        let (from, to) = match part {
            Part::Ahead => (-slack, f32::INFINITY),
            Part::Behind => (f32::NEG_INFINITY, end + slack),
            Part::Whole => (f32::NEG_INFINITY, f32::INFINITY),
        };
        let line = Line {
            origin,
            axis,
            shear: others.map(|d| d / direction[axis]),
            slack,
            from: if turned { -to } else { from },
            to: if turned { -from } else { to },
            exact_origin: origin.to_array().map(f64::from),
            lean: others.map(|d| f64::from(if turned { -d } else { d })),
            rise: f64::from(rise),
            sign: if turned { -1 } else { 1 },
        };
        Some((line, part))
    }

    /// Calls `crossing` with where a line enters, and 1, and where it leaves, and -1, or as often as triangles lie
    /// there. Crossings outside the part that matters may be left out; the order says nothing.
    fn cross(&self, line: &Line, mut crossing: impl FnMut(f32, i32)) {
        match line.axis {
            0 => self.cross_below::<0>(0, line, &mut crossing),
            1 => self.cross_below::<1>(0, line, &mut crossing),
            _ => self.cross_below::<2>(0, line, &mut crossing),
        }
    }

    fn cross_below<const Z: usize>(&self, root: u32, line: &Line, crossing: &mut impl FnMut(f32, i32)) {
        let (mut stack, mut waiting, mut current) = ([0; STACK], 0, root);
        loop {
            let node = &self.nodes[current as usize];
            let mut mask = line.boxes::<Z>(node);
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize % WIDTH;
                mask &= mask - 1;
                let (first, end) = (node.first[lane], node.end[lane]);
                if end != INNER {
                    for face in &self.faces[first as usize..end as usize] {
                        if let Some((t, turn)) = line.crossing::<Z>(face) {
                            crossing(t, turn);
                        }
                    }
                } else if waiting < STACK {
                    stack[waiting] = first;
                    waiting += 1;
                } else {
                    self.cross_below::<Z>(first, line, crossing);
                }
            }
            if waiting == 0 {
                return;
            }
            waiting -= 1;
            current = stack[waiting];
        }
    }
}

/// Whether the triangles are the same, in whatever order.
impl PartialEq for Boundary {
    fn eq(&self, other: &Self) -> bool {
        let [left, right] = [self, other].map(|b| {
            let mut faces = b.faces.clone();
            faces.sort_unstable_by(Face::order);
            faces
        });
        left == right
    }
}

/// What is known of a line's crossings.
struct Count {
    /// The winding number at the ray's origin, seen from behind.
    start: i32,
    /// By how many times more the line enters than it leaves: 0 for a closed mesh.
    missing: i32,
    outward: i32,
}

impl Count {
    fn new(part: Part, before: i32, after: i32, outward: i32) -> Self {
        match part {
            Part::Ahead => Self { start: -after, missing: 0, outward },
            Part::Behind => Self { start: before, missing: 0, outward },
            Part::Whole => Self { start: before, missing: before + after, outward },
        }
    }

    fn is_inside(&self, turns: i32) -> bool {
        if self.missing == 0 {
            return turns != 0;
        }
        0 < (turns * self.outward).max((turns - self.missing) * self.outward)
    }
}

impl Line {
    /// Which boxes the line does not pass by, seen along the line: no projected corner rounds to another place.
    #[inline(always)]
    fn boxes<const Z: usize>(&self, node: &Node) -> u32 {
        let [x, y] = [(Z + 1) % 3, (Z + 2) % 3];
        let to = |i: usize| node.centre[i] - self.origin[i];
        let (z, depth) = (to(Z), node.half[Z]);
        let aside = |i: usize, shear: f32| {
            (node.half[i] + shear.abs() * depth + self.slack).cmplt((to(i) - shear * z).abs())
        };
        let out = (z + depth).cmplt(Vec4::splat(self.from)) | (z - depth).cmpgt(Vec4::splat(self.to));
        // So that NaN (from coordinates near the largest f32) passes by nothing.
        !(aside(x, self.shear[0]) | aside(y, self.shear[1]) | out).bitmask() & ((1 << WIDTH) - 1)
    }

    /// Where the line crosses a face, and 1 if it enters or -1 if it leaves.
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "rounds what f64 decided")]
    fn crossing<const Z: usize>(&self, face: &Face) -> Option<(f32, i32)> {
        let [x, y] = [(Z + 1) % 3, (Z + 2) % 3];
        let corners = face.corners.map(|v| {
            let to = |i: usize| f64::from(v[i]) - self.exact_origin[i];
            let z = to(Z);
            [to(x) * self.rise - z * self.lean[0], to(y) * self.rise - z * self.lean[1], z]
        });
        let [a, b, c] = corners;
        let below = corners.map(|v| v[1] <= 0.0);
        if below[0] == below[1] && below[1] == below[2] {
            return None;
        }
        let weights = [side(b, c), side(c, a), side(a, b)];
        // How often the edges run around the line, counted where they cross the half line towards larger x.
        let turn = |i: usize| {
            let (from, to) = (below[(i + 1) % 3], below[(i + 2) % 3]);
            i32::from(from & !to & (0.0 < weights[i])) - i32::from(!from & to & (weights[i] < 0.0))
        };
        let turn = turn(0) + turn(1) + turn(2);
        if turn == 0 {
            return None;
        }
        // No weight has another sign than any other: this is between the corners.
        let sum = weights[0] + weights[1] + weights[2];
        let z = (weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2]) / sum;
        let turned = f64::from(self.sign) * self.rise;
        Some(((z / turned) as f32, -turn * face.sign * self.sign))
    }
}

/// On which side of the edge from `a` to `b` the line is: positive on the left. The sign is exact, and that of the
/// edge from `b` to `a` its opposite.
#[inline(always)]
fn side(a: [f64; 3], b: [f64; 3]) -> f64 {
    let (p, q) = (a[0] * b[1], a[1] * b[0]);
    if p != q || p == 0.0 { p - q } else { rounded_away(a, b, p) }
}

/// What is left of the difference of products that round to the same number.
#[cold]
#[inline(never)]
fn rounded_away(a: [f64; 3], b: [f64; 3], product: f64) -> f64 {
    a[0].mul_add(b[1], -product) - a[1].mul_add(b[0], -product)
}

impl Face {
    fn new(corners: [Vec3; 3], mut sign: i32) -> Option<Self> {
        // One zero only, so that equal coordinates have equal bits.
        let mut corners = corners.map(|v| v + Vec3::ZERO);
        for (i, j) in [(0, 1), (1, 2), (0, 1)] {
            if order(corners[i], corners[j]) == Ordering::Greater {
                corners.swap(i, j);
                sign = -sign;
            }
        }
        let finite = corners.iter().all(|v| v.is_finite());
        (finite && corners[0] != corners[1] && corners[1] != corners[2]).then_some(Self { corners, sign })
    }

    fn order(&self, other: &Self) -> Ordering {
        let [[a, b, c], [d, e, f]] = [self.corners, other.corners];
        order(a, d).then_with(|| order(b, e)).then_with(|| order(c, f))
    }
}

fn order(a: Vec3, b: Vec3) -> Ordering {
    a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z))
}

/// See [`Boundary::open_edges`].
fn open_edges(faces: &[Face]) -> Option<(usize, Vec3)> {
    let mut edges: Vec<(Vec3, Vec3, i32)> = faces
        .iter()
        .flat_map(|f| {
            let [a, b, c] = f.corners;
            [(a, b, f.sign), (b, c, f.sign), (a, c, -f.sign)]
        })
        .collect();
    edges.sort_unstable_by(|s, t| order(s.0, t.0).then(order(s.1, t.1)));
    let mut open = edges
        .chunk_by(|s, t| s.0 == t.0 && s.1 == t.1)
        .filter(|same| same.iter().map(|e| e.2).sum::<i32>() != 0)
        .map(|same| 0.5 * same[0].0 + 0.5 * same[0].1);
    let example = open.next()?;
    Some((1 + open.count(), example))
}

/// -1 if the volume is negative, or 1; about the centre of the bounds, where a missing face matters least.
fn outward(faces: &[Face], centre: DVec3) -> i32 {
    let volume: f64 = faces
        .iter()
        .map(|f| {
            let [a, b, c] = f.corners.map(|v| v.as_dvec3() - centre);
            f64::from(f.sign) * a.dot(b.cross(c))
        })
        .sum();
    if volume < 0.0 { -1 } else { 1 }
}

struct Boxed(Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

/// A tree over faces, and the faces in the order of its leaves.
#[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^32 triangles")]
fn tree(faces: &[Face]) -> (Vec<Node>, Vec<Face>) {
    let (mut nodes, mut ordered) = (vec![Node::EMPTY], Vec::with_capacity(faces.len()));
    if faces.is_empty() {
        return (nodes, ordered);
    }
    let binary = binary(faces);
    let children = |i: usize| {
        let node = &binary.nodes[i];
        let first = node.first_index as usize;
        (node.prim_count == 0).then_some([first, first + 1])
    };
    let mut order = vec![0];
    let mut next = 0;
    while let Some(&i) = order.get(next) {
        order.extend(children(i).into_iter().flatten());
        next += 1;
    }
    // Faces below each node, and 1 for a leaf.
    let mut counts = vec![1; binary.nodes.len()];
    for &i in order.iter().rev() {
        if let Some([left, right]) = children(i) {
            counts[i] = counts[left] + counts[right];
        }
    }
    let is_leaf = |i: usize| counts[i] <= LEAF;
    let mut work = vec![(0, 0)];
    while let Some((source, here)) = work.pop() {
        let mut below = vec![source];
        // The largest is opened, until there is no more room.
        while below.len() < WIDTH {
            let area = |i: usize| binary.nodes[i].aabb.half_area();
            let largest = (0..below.len()).filter(|&n| !is_leaf(below[n]));
            let Some(largest) = largest.max_by(|&m, &n| area(below[m]).total_cmp(&area(below[n]))) else {
                break;
            };
            let [left, right] = children(below[largest]).unwrap_or_default();
            below[largest] = left;
            below.push(right);
        }
        let mut node = Node::EMPTY;
        for (lane, &i) in below.iter().enumerate() {
            node.set(lane, &binary.nodes[i].aabb);
            if is_leaf(i) {
                node.first[lane] = ordered.len() as u32;
                let mut inner = vec![i];
                while let Some(i) = inner.pop() {
                    inner.extend(children(i).into_iter().flatten());
                    let first = binary.nodes[i].first_index as usize;
                    if children(i).is_none() {
                        ordered.push(faces[binary.primitive_indices[first] as usize]);
                    }
                }
                node.end[lane] = ordered.len() as u32;
            } else {
                (node.first[lane], node.end[lane]) = (nodes.len() as u32, INNER);
                work.push((i, nodes.len()));
                nodes.push(Node::EMPTY);
            }
        }
        nodes[here] = node;
    }
    (nodes, ordered)
}

#[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^32 triangles")]
fn binary(faces: &[Face]) -> Bvh2 {
    let boxes: Vec<Boxed> =
        faces.iter().map(|f| Boxed(Aabb::from_points(&f.corners.map(Vec3A::from)))).collect();
    let indices = (0..boxes.len() as u32).collect();
    let mut tree = PlocBuilder::with_capacity(boxes.len()).build(
        PlocSearchDistance::Medium,
        &boxes,
        indices,
        SortPrecision::U64,
        2,
    );
    ReinsertionOptimizer::default().run(&mut tree, REINSERTED, None);
    tree
}

impl Node {
    /// No boxes: lanes without one have no faces either.
    const EMPTY: Self =
        Self { centre: [Vec4::ZERO; 3], half: [Vec4::MIN; 3], first: [0; WIDTH], end: [0; WIDTH] };

    /// Around all of a box.
    #[expect(clippy::cast_possible_truncation, reason = "rounded up")]
    fn set(&mut self, lane: usize, to: &Aabb) {
        let centre = 0.5 * to.min + 0.5 * to.max;
        for i in 0..3 {
            let middle = f64::from(centre[i]);
            let half = (f64::from(to.max[i]) - middle).max(middle - f64::from(to.min[i]));
            let rounded = half as f32;
            self.centre[i][lane] = centre[i];
            self.half[i][lane] = if f64::from(rounded) < half { rounded.next_up() } else { rounded };
        }
    }
}
