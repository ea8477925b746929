//! What the tree is made of: nodes of eight boxes, blocks of eight triangles.

use glam::{Vec3, Vec3A};

/// Children of a node, and triangles of a block.
pub(super) const WIDTH: usize = 8;

/// Eight numbers, one for each child or triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub(super) struct Lanes(pub(super) [f32; WIDTH]);

/// Names a child: the index of a node, or with [`Child::LEAF`] that of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub(super) struct Child(pub(super) u32);

impl Child {
    const LEAF: u32 = 1 << 31;

    /// The block without triangles, which fills lanes that have no child.
    pub(super) const NOTHING: Self = Self(Self::LEAF);

    pub(super) fn leaf(block: u32) -> Self {
        Self(Self::LEAF | block)
    }

    pub(super) fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    pub(super) fn index(self) -> usize {
        (self.0 & !Self::LEAF) as usize
    }
}

/// An inner node with the boxes of its children.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(super) struct Node {
    /// Lowest and highest x, lowest and highest y, lowest and highest z, metres.
    pub(super) rows: [Lanes; 6],
    pub(super) child: [Child; WIDTH],
}

impl Node {
    /// A node without children: no ray is between an infinite low and a minus infinite high end.
    pub(super) fn empty() -> Self {
        let [lo, hi] = [Lanes([f32::INFINITY; WIDTH]), Lanes([f32::NEG_INFINITY; WIDTH])];
        Self { rows: [lo, hi, lo, hi, lo, hi], child: [Child::NOTHING; WIDTH] }
    }

    pub(super) fn set(&mut self, lane: usize, lo: Vec3A, hi: Vec3A, child: Child) {
        for axis in 0..3 {
            self.rows[2 * axis].0[lane] = lo[axis];
            self.rows[2 * axis + 1].0[lane] = hi[axis];
        }
        self.child[lane] = child;
    }
}

/// Up to eight triangles.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Block {
    /// x, y and z of the first corners, then of the second and the third, metres; NaN where there is
    /// no triangle, which no ray meets.
    pub(super) rows: [Lanes; 9],
    /// World indices.
    pub(super) triangle: [u32; WIDTH],
}

impl Block {
    pub(super) fn empty() -> Self {
        Self { rows: [Lanes([f32::NAN; WIDTH]); 9], triangle: [u32::MAX; WIDTH] }
    }

    pub(super) fn set(&mut self, lane: usize, corners: &[Vec3; 3], triangle: u32) {
        for (corner, p) in corners.iter().enumerate() {
            for axis in 0..3 {
                self.rows[3 * corner + axis].0[lane] = p[axis];
            }
        }
        self.triangle[lane] = triangle;
    }

    pub(super) fn corners(&self, lane: usize) -> [Vec3; 3] {
        [0, 3, 6].map(|row| Vec3::from_array([0, 1, 2].map(|axis| self.rows[row + axis].0[lane])))
    }
}

/// Hits of one ray in a block, valid in the lanes of a mask.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Hits {
    /// Distances, metres.
    pub(super) t: Lanes,
    /// Barycentric weights.
    pub(super) bary: [Lanes; 3],
}
