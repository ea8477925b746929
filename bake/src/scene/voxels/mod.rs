//! Density on a grid: constant within each voxel, in bricks of which those without variation take no room.
//!
//! Voxel space has a voxel at every whole step: voxel (i, j, k) is the box from (i, j, k) to (i + 1, j + 1, k + 1), lower
//! faces included, so that whatever lies in a face is in one voxel. Rays through grids are in `media::march`.

pub mod ktx;
pub mod noise;
pub mod raw;
mod sparse;
#[cfg(test)]
mod tests;
pub mod vdb;

use glam::{Affine3A, USizeVec3, UVec3, Vec3A, uvec3};
use rayon::prelude::*;
use std::{collections::BTreeMap, fmt};

pub use sparse::Sparse;

/// Side of a brick, voxels.
pub const SIDE: u32 = 8;

/// Voxels of a brick.
pub const BRICK: usize = 512;

/// Most voxels along an axis: further ones have no `f32` of their own.
pub const MOST_ALONG: u32 = 1 << 24;

/// A density that is constant within each voxel; 0 outside.
#[derive(Clone, PartialEq)]
pub struct Voxels {
    size: UVec3,
    /// Voxels of the first bricks that come before the box.
    margin: UVec3,
    /// Bricks along each axis.
    along: UVec3,
    /// Which entry of `bounds` is where, x fastest, then y, then z.
    index: Vec<u32>,
    /// Least and greatest density: first of the bricks that vary, then of those that do not.
    bounds: Vec<[f32; 2]>,
    /// Voxels of the bricks that vary, each x fastest, then y, then z.
    values: Vec<f32>,
    most: f32,
    place: Option<Affine3A>,
}

/// Why a grid cannot be used, and what the author can do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}")]
pub struct Unusable {
    /// What is wrong, with the offending value.
    pub what: String,
    /// What helps.
    pub fix: String,
}

impl Unusable {
    pub(crate) fn new(what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { what: what.into(), fix: fix.into() }
    }

    /// A grid without any density.
    pub(super) fn empty() -> Self {
        Self::new(
            "the grid is empty: every density in it is 0",
            "remove the medium, or export the grid again",
        )
    }

    /// A grid that takes more memory than it may; sizes in bytes.
    pub(super) fn large(need: f64, most: usize) -> Self {
        let gib = |n: f64| n / f64::from(1 << 30);
        Self::new(
            format!(
                "the grid needs about {:.2} GiB of memory and may take {:.2} GiB",
                gib(need),
                gib(most as f64)
            ),
            "use a coarser or smaller grid, or allow more memory",
        )
    }

    /// A density that is none.
    pub(super) fn density(voxel: impl fmt::Display, value: f32) -> Self {
        Self::new(
            format!("voxel {voxel} has the density {value}"),
            "export densities that are finite and not negative",
        )
    }
}

/// What is in a brick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Brick<'a> {
    /// The same everywhere.
    Constant(f32),
    /// Its voxels, x fastest, then y, then z; what is beyond the box repeats what is at its border.
    Varying(&'a [f32; BRICK]),
}

/// A brick on the way into a grid.
enum Packed {
    Constant(f32),
    Varying(Box<[f32; BRICK]>, [f32; 2]),
}

impl Voxels {
    /// A grid of `size` voxels with the densities that `value` gives them, on all threads. It is asked for each voxel once,
    /// and for some at the border again.
    ///
    /// # Errors
    /// Where a side is 0 or above [`MOST_ALONG`], a density is negative or not finite, all are 0, or the grid takes more than
    /// `most_bytes` of memory.
    pub fn from_fn(
        size: UVec3,
        most_bytes: usize,
        value: impl Fn(UVec3) -> f32 + Sync,
    ) -> Result<Self, Unusable> {
        check_size(size)?;
        let along = size.map(|n| n.div_ceil(SIDE));
        let cells = along.as_u64vec3().element_product();
        if most_bytes as u64 / 4 < cells {
            return Err(Unusable::large(cells as f64 * 4.0, most_bytes));
        }
        let mut grid = Self::unfilled(size, UVec3::ZERO, along, None);
        let mut constants = Vec::new();
        let layer = along.x as usize * along.y as usize;
        for z in 0..along.z {
            let packed: Vec<Result<Packed, Unusable>> = (0..layer)
                .into_par_iter()
                .map(|i| {
                    let i = u32::try_from(i).expect("at most one brick for each voxel along two axes");
                    pack(uvec3(i % along.x, i / along.x, z) * SIDE, size, &value)
                })
                .collect();
            for (i, packed) in packed.into_iter().enumerate() {
                match packed? {
                    Packed::Constant(v) => constants.push((z as usize * layer + i, v)),
                    Packed::Varying(values, bounds) => {
                        grid.index[z as usize * layer + i] = id(grid.bounds.len());
                        grid.bounds.push(bounds);
                        grid.values.extend_from_slice(&values[..]);
                    }
                }
            }
            if most_bytes < grid.memory() {
                let so_far = f64::from(along.z) / f64::from(z + 1);
                return Err(Unusable::large(grid.memory() as f64 * so_far, most_bytes));
            }
        }
        let mut known = BTreeMap::new();
        for (cell, v) in constants {
            grid.index[cell] = grid.constant(&mut known, v);
        }
        grid.finish(&mut known)
    }

    /// A grid of `size` voxels with these densities, x fastest, then y, then z.
    ///
    /// # Errors
    /// As [`Self::from_fn`], and where there are not as many values as voxels.
    pub fn dense(size: UVec3, values: &[f32], most_bytes: usize) -> Result<Self, Unusable> {
        let voxels = size.as_u64vec3().element_product();
        if voxels != values.len() as u64 {
            return Err(Unusable::new(
                format!("there are {} densities for {voxels} voxels", values.len()),
                "give as many densities as voxels",
            ));
        }
        Self::from_fn(size, most_bytes, |v| values[linear(v, size)])
    }

    /// The same voxels with other densities, which those of each brick follow from one by one.
    ///
    /// # Errors
    /// As [`Self::from_fn`].
    pub fn map(&self, of: impl Fn(f32) -> f32 + Sync) -> Result<Self, Unusable> {
        let mut grid = self.clone();
        grid.values.par_iter_mut().for_each(|v| *v = of(*v));
        let varying = grid.values.len() / BRICK;
        let (first, last) = grid.bounds.split_at_mut(varying);
        for (bounds, values) in first.iter_mut().zip(grid.values.chunks(BRICK)) {
            *bounds = values.iter().fold([f32::INFINITY, 0.0], |[a, b], v| [a.min(*v), b.max(*v)]);
        }
        last.iter_mut().for_each(|b| *b = [of(b[0]); 2]);
        if let Some(bad) = grid.bounds.iter().flatten().find(|v| !is_density(**v)) {
            return Err(Unusable::density("of a brick", *bad));
        }
        grid.most = grid.bounds.iter().fold(0.0, |m, b| m.max(b[1]));
        if grid.most == 0.0 { Err(Unusable::empty()) } else { Ok(grid) }
    }

    /// A grid without its bricks.
    fn unfilled(size: UVec3, margin: UVec3, along: UVec3, place: Option<Affine3A>) -> Self {
        let cells = along.as_usizevec3().element_product();
        let (bounds, values) = (Vec::new(), Vec::new());
        Self { size, margin, along, index: vec![UNSET; cells], bounds, values, most: 0.0, place }
    }

    /// The entry of `bounds` for bricks that do not vary, after all that do. `known` has those so far.
    fn constant(&mut self, known: &mut BTreeMap<u32, u32>, value: f32) -> u32 {
        *known.entry(value.to_bits()).or_insert_with(|| {
            self.bounds.push([value; 2]);
            id(self.bounds.len() - 1)
        })
    }

    /// What no brick is in is 0.
    fn finish(mut self, known: &mut BTreeMap<u32, u32>) -> Result<Self, Unusable> {
        if self.index.contains(&UNSET) {
            let empty = self.constant(known, 0.0);
            self.index.iter_mut().filter(|i| **i == UNSET).for_each(|i| *i = empty);
        }
        self.most = self.bounds.iter().fold(0.0, |m, b| m.max(b[1]));
        self.values.shrink_to_fit();
        self.bounds.shrink_to_fit();
        if self.most == 0.0 { Err(Unusable::empty()) } else { Ok(self) }
    }

    /// Voxels along each axis: the grid fills the box from 0 to this in voxel space.
    #[must_use]
    pub const fn size(&self) -> UVec3 {
        self.size
    }

    /// The file's own transform from voxel space to its world; `None` where the file has none.
    #[must_use]
    pub const fn place(&self) -> Option<Affine3A> {
        self.place
    }

    /// Greatest density.
    #[must_use]
    pub const fn most(&self) -> f32 {
        self.most
    }

    /// Bytes that the grid takes.
    #[must_use]
    pub const fn memory(&self) -> usize {
        size_of::<Self>() + 4 * self.index.len() + 8 * self.bounds.len() + 4 * self.values.len()
    }

    /// Density at a place in voxel space; 0 outside.
    #[must_use]
    pub fn at(&self, voxel: Vec3A) -> f32 {
        if !(voxel.cmpge(Vec3A::ZERO).all() && voxel.cmplt(self.size.as_vec3a()).all()) {
            return 0.0;
        }
        self.of(voxel.as_uvec3())
    }

    /// Density of a voxel in the box.
    fn of(&self, voxel: UVec3) -> f32 {
        let v = voxel + self.margin;
        match self.brick(self.cell(v / SIDE)) {
            Brick::Constant(value) => value,
            Brick::Varying(values) => values[within(v % SIDE)],
        }
    }

    /// Bricks along each axis.
    pub(crate) const fn along(&self) -> UVec3 {
        self.along
    }

    /// Voxels of the first bricks that come before the box.
    pub(crate) const fn margin(&self) -> UVec3 {
        self.margin
    }

    /// Number of a brick.
    pub(crate) fn cell(&self, brick: UVec3) -> usize {
        linear(brick, self.along)
    }

    /// What is in a brick.
    #[inline]
    pub(crate) fn brick(&self, cell: usize) -> Brick<'_> {
        let id = self.index[cell] as usize;
        match self.values.get(id * BRICK..(id + 1) * BRICK).and_then(|v| v.first_chunk()) {
            Some(values) => Brick::Varying(values),
            None => Brick::Constant(self.bounds[id][0]),
        }
    }

    /// Least and greatest density in a brick, of its voxels in the box.
    #[inline]
    pub(crate) fn bounds(&self, cell: usize) -> [f32; 2] {
        self.bounds[self.index[cell] as usize]
    }
}

impl fmt::Debug for Voxels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Voxels")
            .field("size", &self.size)
            .field("most", &self.most)
            .field("memory", &self.memory())
            .field("place", &self.place)
            .finish_non_exhaustive()
    }
}

/// Entry of an index that no brick has yet.
const UNSET: u32 = u32::MAX;

/// Entry of an index for the brick with this number.
fn id(brick: usize) -> u32 {
    // 2^32 bricks take 8 TiB.
    u32::try_from(brick).ok().filter(|i| *i != UNSET).expect("memory ends first")
}

/// Number of a voxel, or a brick, in a box of them: x fastest, then y, then z.
fn linear(v: UVec3, size: UVec3) -> usize {
    let (v, size): (USizeVec3, USizeVec3) = (v.as_usizevec3(), size.as_usizevec3());
    v.x + size.x * (v.y + size.y * v.z)
}

/// Number of a voxel in its brick.
fn within(v: UVec3) -> usize {
    (v.x + SIDE * (v.y + SIDE * v.z)) as usize
}

/// A voxel of a brick by its number.
fn nth(i: u32) -> UVec3 {
    uvec3(i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE))
}

fn is_density(v: f32) -> bool {
    (0.0..f32::INFINITY).contains(&v)
}

fn check_size(size: UVec3) -> Result<(), Unusable> {
    if size.min_element() == 0 || MOST_ALONG < size.max_element() {
        return Err(Unusable::new(
            format!("the grid has {} x {} x {} voxels", size.x, size.y, size.z),
            format!("use a grid of 1 to {MOST_ALONG} voxels along each axis"),
        ));
    }
    Ok(())
}

/// Collects the voxels of the brick at `corner`.
fn pack(corner: UVec3, size: UVec3, value: &impl Fn(UVec3) -> f32) -> Result<Packed, Unusable> {
    let mut values = Box::new([0.0; BRICK]);
    for (i, out) in (0..).zip(values.iter_mut()) {
        let voxel = (corner + nth(i)).min(size - 1);
        let v = value(voxel);
        if !is_density(v) {
            return Err(Unusable::density(voxel, v));
        }
        // Turns -0 into 0.
        *out = v + 0.0;
    }
    let bounds = extremes(&values[..]);
    Ok(if bounds[0] == bounds[1] { Packed::Constant(bounds[0]) } else { Packed::Varying(values, bounds) })
}

/// Least and greatest of densities.
fn extremes(values: &[f32]) -> [f32; 2] {
    values.iter().fold([f32::INFINITY, 0.0], |[a, b], v| [a.min(*v), b.max(*v)])
}
