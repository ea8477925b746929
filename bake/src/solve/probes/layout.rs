//! Bricks of cells over a scene.

use super::number;
use crate::geom::World;
use crate::geom::voxels::touched;
use crate::plan::memory::MOST_PROBES;
use crate::solve::light_grid::around;
use glam::{UVec3, Vec3, Vec3A};
use std::collections::HashMap;
use tables::probes::{Brick, CELLS, NONE};

/// Sizes of bricks where places are found by themselves: the largest cells are four times as wide as the smallest.
const LEVELS: u32 = 3;

/// Cells of a brick.
#[expect(clippy::cast_possible_truncation, reason = "four")]
const SIDE: u32 = CELLS as u32;

/// Where probes are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Where {
    /// Over the whole scene, about so many, nearer to one another where surfaces are.
    Scene {
        /// Probes.
        about: u32,
    },
    /// Over the whole scene, so far apart where surfaces are, metres.
    Spaced(f32),
    /// Evenly in a box, metres in the scene's axes, so far apart, in whole bricks from its first corner on.
    Box {
        /// Corner with the smallest coordinates.
        min: Vec3,
        /// Corner with the greatest.
        max: Vec3,
        /// Metres.
        spacing: f32,
    },
}

/// A corner of cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Node {
    /// In smallest cells from the lattice's first corner.
    pub(super) at: UVec3,
    /// Side of the smallest cell around it, metres.
    pub(super) reach: f32,
}

/// A node between the probes of a coarser brick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hanging {
    pub(super) node: u32,
    /// Probes around it, and their parts of its light.
    pub(super) of: [(u32, f32); 8],
}

impl Hanging {
    /// `None` if the brick has a probe there.
    fn on(brick: &Brick, node: u32, at: UVec3) -> Option<Self> {
        let wide = 1 << brick.level;
        let from = at - UVec3::from(brick.corner);
        if from % wide == UVec3::ZERO {
            return None;
        }
        let cell = (from / wide).min(UVec3::splat(SIDE - 1));
        let part = (from - cell * wide).as_vec3() / wide as f32;
        let of = std::array::from_fn(|k| {
            let k = number(k);
            let far = UVec3::new(k & 1, k >> 1 & 1, k >> 2);
            let c = cell + far;
            let n = SIDE + 1;
            let weight = Vec3::select(far.cmpeq(UVec3::ONE), part, 1.0 - part).element_product();
            (brick.probes[((c.z * n + c.y) * n + c.x) as usize], weight)
        });
        Some(Self { node, of })
    }
}

/// Bricks, and the probes on their corners.
#[derive(Debug)]
pub struct Layout {
    /// Metres, relative to the world's origin.
    pub(super) origin: Vec3A,
    pub(super) spacing: f32,
    /// Smallest bricks along each axis.
    pub(super) size: UVec3,
    pub(super) levels: u32,
    pub(super) index: Vec<u32>,
    pub(super) bricks: Vec<Brick>,
    pub(super) nodes: Vec<Node>,
    /// For each brick the triangles that may touch it.
    pub(super) triangles: Vec<Vec<u32>>,
}

/// The greatest lattice that is made, in smallest bricks.
const MOST_BRICKS: f64 = 16e6;

/// Probes of a lattice, at most.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a power of two")]
const MOST_NODES: usize = MOST_PROBES as usize;

impl Layout {
    /// `None` for an empty box or scene, and for more probes than there may be.
    #[must_use]
    pub fn new(world: &World, place: Where) -> Option<Self> {
        match place {
            Where::Box { min, max, spacing } => {
                let frame = Frame::within((min - world.origin, max - world.origin), spacing)?;
                Self::fill(world, frame, MOST_NODES)
            }
            Where::Spaced(spacing) => {
                let frame = Frame::around(around(world, None)?, spacing, LEVELS)?;
                Self::fill(world, frame, MOST_NODES)
            }
            Where::Scene { about } => {
                let bounds = around(world, None)?;
                let longest = (bounds.1 - bounds.0).max_element();
                // Halving finds the finest lattice that has not more probes than wanted; bricks of a corner each are the coarsest.
                let (mut fine, mut coarse) = (0.0f32, 0.25f32);
                let mut best = None;
                for _ in 0..12 {
                    let middle = if fine == 0.0 { coarse * 0.5 } else { 0.5 * (fine + coarse) };
                    let frame = Frame::around(bounds, longest * middle, LEVELS);
                    match frame.and_then(|f| Self::fill(world, f, about as usize)) {
                        Some(l) => (coarse, best) = (middle, Some(l)),
                        None => fine = middle,
                    }
                }
                best.or_else(|| {
                    Self::fill(world, Frame::around(bounds, longest * coarse, LEVELS)?, MOST_NODES)
                })
            }
        }
    }

    /// Nodes that lie on the face of a coarser brick and are none of its own, those of the coarsest bricks first. They take its light, or it would
    /// jump where one goes from brick to brick.
    pub(super) fn hanging(&self) -> Vec<Hanging> {
        let mut list: Vec<(u32, Hanging)> = Vec::new();
        for (node, n) in (0..).zip(&self.nodes) {
            let around = (0..8u32).filter_map(|k| {
                // The smallest bricks that touch the node.
                let b = UVec3::new(k & 1, k >> 1 & 1, k >> 2);
                let b = (n.at + b).checked_sub(UVec3::ONE)? / SIDE;
                let flat = (b.z * self.size.y + b.y) * self.size.x + b.x;
                let brick = b.cmplt(self.size).all().then(|| self.index[flat as usize])?;
                self.bricks.get(brick as usize)
            });
            if let Some(brick) = around.max_by_key(|b| b.level)
                && let Some(hanging) = Hanging::on(brick, node, n.at)
            {
                list.push((brick.level, hanging));
            }
        }
        list.sort_by_key(|(level, _)| std::cmp::Reverse(*level));
        list.into_iter().map(|(_, h)| h).collect()
    }

    /// Metres relative to the world's origin.
    pub(super) fn place(&self, at: UVec3) -> Vec3A {
        self.origin + at.as_vec3a() * self.spacing
    }

    /// `None` if there are more than `most` probes.
    fn fill(world: &World, Frame { origin, spacing, size, levels }: Frame, most: usize) -> Option<Self> {
        let flat = |b: UVec3| ((b.z * size.y + b.y) * size.x + b.x) as usize;
        let side = spacing * SIDE as f32;
        let in_bricks = |t: [Vec3; 3]| t.map(|c| (Vec3A::from(c) - origin) / side);
        let mut occupied = vec![false; size.element_product() as usize];
        for t in world.triangles() {
            touched(in_bricks(t), size, |b| occupied[flat(b)] = true);
        }
        let mut out = Self {
            origin,
            spacing,
            size,
            levels,
            index: vec![NONE; occupied.len()],
            bricks: Vec::new(),
            nodes: Vec::new(),
            triangles: Vec::new(),
        };
        let top = 1 << (levels - 1);
        let mut numbers = HashMap::new();
        for z in (0..size.z).step_by(top) {
            for y in (0..size.y).step_by(top) {
                for x in (0..size.x).step_by(top) {
                    out.part(UVec3::new(x, y, z), levels - 1, &occupied, &mut numbers);
                    if most < out.nodes.len() {
                        return None;
                    }
                }
            }
        }
        out.triangles = vec![Vec::new(); out.bricks.len()];
        for (t, corners) in (0..).zip(world.triangles()) {
            touched(in_bricks(corners), size, |b| {
                let list = &mut out.triangles[out.index[flat(b)] as usize];
                // The same brick may come again, but not behind another triangle.
                if list.last() != Some(&t) {
                    list.push(t);
                }
            });
        }
        Some(out)
    }

    /// A brick whose first smallest brick is `first`, or the eight that it is parted into.
    fn part(&mut self, first: UVec3, level: u32, occupied: &[bool], numbers: &mut HashMap<UVec3, u32>) {
        let wide = 1u32 << level;
        if self.size.cmple(first).any() {
            return;
        }
        let flat = |b: UVec3| ((b.z * self.size.y + b.y) * self.size.x + b.x) as usize;
        let all: Vec<usize> = (0..wide.pow(3))
            .map(|i| first + UVec3::new(i % wide, i / wide % wide, i / (wide * wide)))
            .filter(|b| b.cmplt(self.size).all())
            .map(flat)
            .collect();
        // What lies beyond the bounds for the most part is not worth a large brick.
        let beyond = self.size.cmplt(first + wide / 2).any();
        if 0 < level && (beyond || all.iter().any(|b| occupied[*b])) {
            let half = wide / 2;
            for k in 0..8u32 {
                let next = first + UVec3::new(k & 1, k >> 1 & 1, k >> 2) * half;
                self.part(next, level - 1, occupied, numbers);
            }
            return;
        }
        let brick = number(self.bricks.len());
        for b in all {
            self.index[b] = brick;
        }
        let corner = first * SIDE;
        let reach = self.spacing * wide as f32;
        let n = SIDE + 1;
        let probes = std::array::from_fn(|i| {
            let i = number(i);
            let at = corner + UVec3::new(i % n, i / n % n, i / (n * n)) * wide;
            let nodes = &mut self.nodes;
            let k = *numbers.entry(at).or_insert_with(|| {
                nodes.push(Node { at, reach });
                number(nodes.len() - 1)
            });
            let node = &mut nodes[k as usize];
            node.reach = node.reach.min(reach);
            k
        });
        let cells = [NONE; CELLS * CELLS * CELLS];
        self.bricks.push(Brick { corner: corner.to_array(), level, probes, cells });
    }
}

/// A lattice without anything in it.
#[derive(Clone, Copy)]
struct Frame {
    origin: Vec3A,
    spacing: f32,
    size: UVec3,
    levels: u32,
}

impl Frame {
    /// Bricks around a box, the lattice's planes lying where walls seldom do.
    fn around((min, max): (Vec3, Vec3), spacing: f32, levels: u32) -> Option<Self> {
        let wide = spacing * SIDE as f32;
        let size = ((max - min) / wide + OVER).ceil().max(Vec3::ONE);
        let beyond = size * wide - (max - min);
        let origin = Vec3A::from(min - beyond * Vec3::from(UNEVEN));
        let few = size.as_dvec3().element_product() <= MOST_BRICKS;
        let ok = size.is_finite() && few && 0.0 < spacing && origin.is_finite();
        ok.then(|| Self { origin, spacing, size: size.as_uvec3(), levels })
    }

    /// Bricks of one size that fill a box from its first corner on.
    fn within((min, max): (Vec3, Vec3), spacing: f32) -> Option<Self> {
        let size = ((max - min) / (spacing * SIDE as f32) * (1.0 - 1e-5)).ceil().max(Vec3::ONE);
        let ok = size.is_finite() && size.as_dvec3().element_product() <= MOST_BRICKS && 0.0 < spacing;
        ok.then(|| Self { origin: min.into(), spacing, size: size.as_uvec3(), levels: 1 })
    }
}

/// How far bricks reach over the box at least, parts of the smallest.
const OVER: f32 = 0.05;

/// Which part of what they reach over lies before the box.
const UNEVEN: [f32; 3] = [0.43, 0.47, 0.41];
