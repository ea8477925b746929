//! Builds grids from bricks in any order.

use super::{BRICK, SIDE, UNSET, Unusable, Voxels, check_size, extremes, id, is_density, nth, within};
use glam::{Affine3A, I64Vec3, IVec3, UVec3};
use std::collections::BTreeMap;

/// A grid that is built from bricks and larger blocks of constant density, anywhere in a space of indices.
#[derive(Debug)]
pub struct Sparse {
    most_bytes: usize,
    /// The box of all that is held: first and last voxel.
    held: Option<(I64Vec3, I64Vec3)>,
    /// Bricks that vary, in units of bricks, each with its voxels in `values`.
    bricks: Vec<IVec3>,
    values: Vec<f32>,
    /// Cubes of constant density: corner and side in units of bricks.
    cubes: Vec<(IVec3, u32, f32)>,
}

impl Sparse {
    /// A grid that may take this much memory.
    #[must_use]
    pub const fn new(most_bytes: usize) -> Self {
        Self { most_bytes, held: None, bricks: Vec::new(), values: Vec::new(), cubes: Vec::new() }
    }

    /// Makes room for at most this many bricks.
    ///
    /// # Errors
    /// Where they take more memory than the grid may.
    pub fn expect(&mut self, bricks: usize) -> Result<(), Unusable> {
        self.check(0, self.bricks.len() + bricks)?;
        self.values.reserve_exact(bricks * BRICK);
        self.bricks.reserve_exact(bricks);
        Ok(())
    }

    /// Takes voxels into the box: first and last.
    pub fn hold(&mut self, first: IVec3, last: IVec3) {
        self.hold_far(first.as_i64vec3(), last.as_i64vec3());
    }

    fn hold_far(&mut self, first: I64Vec3, last: I64Vec3) {
        let (a, b) = self.held.unwrap_or((first, last));
        self.held = Some((a.min(first), b.max(last)));
    }

    /// Adds the brick whose first voxel has the index `brick * 8`; voxels x fastest, then y, then z. The box grows by those
    /// that are not 0.
    ///
    /// # Errors
    /// Where a density is negative or not finite, or there is no memory left.
    pub fn brick(&mut self, brick: IVec3, values: &[f32; BRICK]) -> Result<(), Unusable> {
        let corner = brick.as_i64vec3() * i64::from(SIDE);
        let index = |i: u32| corner + nth(i).as_i64vec3();
        if let Some((i, v)) = (0..).zip(values).find(|(_, v)| !is_density(**v)) {
            return Err(Unusable::density(index(i), *v));
        }
        let [least, most] = extremes(values);
        if most == 0.0 {
            return Ok(());
        }
        if least == most {
            return self.cube(brick, 1, least);
        }
        let held = (0..).zip(values).filter(|(_, v)| **v != 0.0).map(|(i, _)| nth(i));
        let (first, last) = held.fold((UVec3::splat(SIDE), UVec3::ZERO), |(a, b), v| (a.min(v), b.max(v)));
        self.hold_far(corner + first.as_i64vec3(), corner + last.as_i64vec3());
        self.check(0, self.bricks.len() + 1)?;
        self.bricks.push(brick);
        // Turns -0 into 0.
        self.values.extend(values.iter().map(|v| v + 0.0));
        Ok(())
    }

    /// Adds a cube of constant density, `side` bricks along each axis.
    ///
    /// # Errors
    /// Where the density is negative or not finite, or there is no memory left.
    pub fn cube(&mut self, brick: IVec3, side: u32, value: f32) -> Result<(), Unusable> {
        let corner = brick.as_i64vec3() * i64::from(SIDE);
        if !is_density(value) {
            return Err(Unusable::density(corner, value));
        }
        if value == 0.0 {
            return Ok(());
        }
        self.hold_far(corner, corner + i64::from(side * SIDE) - 1);
        self.cubes.push((brick, side, value));
        Ok(())
    }

    fn check(&self, cells: u64, bricks: usize) -> Result<(), Unusable> {
        let need = cells as f64 * 4.0 + bricks as f64 * (4 * BRICK + 8) as f64;
        if (self.most_bytes as f64) < need { Err(Unusable::large(need, self.most_bytes)) } else { Ok(()) }
    }

    /// The grid. `place` is told the index of its first voxel and gives what leads from voxel space to the file's world.
    ///
    /// # Errors
    /// Where bricks overlap, nothing is held, all is 0, the box is wider than
    /// [`MOST_ALONG`](super::MOST_ALONG), or there is not enough memory.
    pub fn finish(mut self, place: impl FnOnce(I64Vec3) -> Option<Affine3A>) -> Result<Voxels, Unusable> {
        let (first, last) = self.held.ok_or_else(Unusable::empty)?;
        let size = (last - first + 1).as_u64vec3();
        let narrow = |n: u64| u32::try_from(n).unwrap_or(u32::MAX);
        let size = UVec3::new(narrow(size.x), narrow(size.y), narrow(size.z));
        check_size(size)?;
        let (from, to) = (first.map(|i| i.div_euclid(8)), last.map(|i| i.div_euclid(8)));
        let along = (to - from + 1).as_uvec3();
        self.check(along.as_u64vec3().element_product(), self.bricks.len())?;
        let margin = (first - from * i64::from(SIDE)).as_uvec3();
        let mut grid = Voxels::unfilled(size, margin, along, place(first));
        grid.values = std::mem::take(&mut self.values);
        for (i, brick) in self.bricks.iter().enumerate() {
            let here = (brick.as_i64vec3() - from).as_uvec3();
            let cell = grid.cell(here);
            if grid.index[cell] != UNSET {
                return Err(overlap(*brick));
            }
            grid.index[cell] = id(i);
            let values = &mut grid.values[i * BRICK..(i + 1) * BRICK];
            if here.cmpeq(UVec3::ZERO).any() || (here + 1).cmpeq(along).any() {
                repeat_border(values, here * SIDE, margin, size);
            }
            grid.bounds.push(extremes(values));
        }
        let mut known = BTreeMap::new();
        for (brick, side, value) in &self.cubes {
            let id = grid.constant(&mut known, *value);
            let corner = (brick.as_i64vec3() - from).as_uvec3();
            for z in corner.z..corner.z + side {
                for y in corner.y..corner.y + side {
                    let row = grid.cell(UVec3::new(corner.x, y, z));
                    let row = &mut grid.index[row..row + *side as usize];
                    if row.iter().any(|i| *i != UNSET) {
                        return Err(overlap(*brick));
                    }
                    row.fill(id);
                }
            }
        }
        grid.finish(&mut known)
    }
}

fn overlap(brick: IVec3) -> Unusable {
    Unusable::new(
        format!("two parts of the grid are at the index {}", brick.as_i64vec3() * i64::from(SIDE)),
        "export the grid again",
    )
}

/// Gives voxels beyond the box the density of those at its border, so that bounds are those of the box.
fn repeat_border(values: &mut [f32], corner: UVec3, margin: UVec3, size: UVec3) {
    let old: Vec<f32> = values.to_vec();
    for (i, out) in (0..).zip(values) {
        let v = (corner + nth(i)).clamp(margin, margin + size - 1);
        *out = old[within(v - corner)];
    }
}
