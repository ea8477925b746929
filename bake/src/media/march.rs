//! Rays through grids of voxels, in closed form: densities are constant within each voxel.
//!
//! A ray steps from brick to brick, and from voxel to voxel in those that vary (Amanatides and Woo,
//! "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987). Planes are whole
//! numbers and distances `f64`, so what a ray crosses far from its origin is as exact as what it crosses near it.

use crate::scene::voxels::{BRICK, Brick, SIDE, Voxels};
use glam::Vec3A;

#[cfg(test)]
mod tests;

/// A ray through a grid.
#[derive(Clone, Debug)]
pub struct March<'a> {
    voxels: &'a Voxels,
    /// Where the ray begins, voxels from the corner of the first brick.
    origin: [f64; 3],
    direction: [f64; 3],
    inverse: [f64; 3],
    /// Which way it goes along each axis: 1, -1, or 0 for neither.
    sign: [i32; 3],
    /// Distance between planes of voxels; 0 along axes that it never meets.
    step: [f64; 3],
    /// Where the ray is in the box; the first is not below the second if it never is.
    inside: (f64, f64),
}

impl<'a> March<'a> {
    /// A ray in voxel space. The direction need not have length 1: distances are in units of it, metres if it is what a
    /// metre along the ray is in voxel space.
    ///
    /// A ray in a face is in the voxel above it. One that is not finite is nowhere.
    #[must_use]
    pub fn new(voxels: &'a Voxels, origin: Vec3A, direction: Vec3A) -> Self {
        let margin = voxels.margin().as_dvec3();
        let inside = inside(voxels, origin, direction);
        let d = direction.as_dvec3();
        let inverse = d.recip().to_array();
        let sign = d.to_array().map(|d| i32::from(0.0 < d) - i32::from(d < 0.0));
        Self {
            voxels,
            origin: (origin.as_dvec3() + margin).to_array(),
            direction: d.to_array(),
            inverse,
            sign,
            step: each(|axis| if sign[axis] == 0 { 0.0 } else { inverse[axis].abs() }),
            inside,
        }
    }

    /// The integral of the density from one distance to another.
    #[must_use]
    pub fn integral(&self, from: f32, to: f32) -> f32 {
        let mut sum = 0.0;
        self.pieces(from, to, |t0, t1, density| {
            sum += density * (t1 - t0);
            true
        });
        narrow(sum)
    }

    /// Where the integral from a distance reaches an amount above 0, if it does before `to`.
    #[must_use]
    pub fn reach(&self, from: f32, to: f32, amount: f32) -> Option<f32> {
        let mut left = f64::from(amount);
        let mut at = None;
        self.pieces(from, to, |t0, t1, density| {
            let here = density * (t1 - t0);
            if left <= here && 0.0 < density {
                at = Some(narrow((t0 + left / density).min(t1)).clamp(from, to));
                return false;
            }
            left -= here;
            true
        });
        at
    }

    /// Calls `visit` with begin and end of each stretch in bricks of the same bounds, and these: the least and the greatest
    /// density. In order and without gaps; outside the box there are none.
    ///
    /// A place on such a stretch that is found in `f32` may round into the next one.
    pub fn bricks(&self, from: f32, to: f32, mut visit: impl FnMut(f32, f32, f32, f32)) {
        let mut stretch: Option<(f32, f32, [f32; 2])> = None;
        let mut give = |(from, to, [least, most]): (f32, f32, [f32; 2])| {
            if from < to {
                visit(from, to, least, most);
            }
        };
        self.walk(from, to, |cell, _, t0, t1| {
            let (bounds, t1) = (self.voxels.bounds(cell), narrow(t1));
            stretch = Some(match stretch {
                Some((begin, _, of)) if of == bounds => (begin, t1, of),
                Some(before) => {
                    give(before);
                    (before.1, t1, bounds)
                }
                None => (narrow(t0), t1, bounds),
            });
            true
        });
        stretch.map(give);
    }

    /// Calls `visit` with begin, end and density of each piece of constant density, until it says no.
    pub(crate) fn pieces(&self, from: f32, to: f32, mut visit: impl FnMut(f64, f64, f64) -> bool) {
        self.walk(from, to, |cell, corner, t0, t1| match self.voxels.brick(cell) {
            Brick::Constant(0.0) => true,
            Brick::Constant(density) => visit(t0, t1, f64::from(density)),
            Brick::Varying(values) => self.voxels(values, corner, t0, t1, &mut visit),
        });
    }

    /// Calls `visit` with number, first voxel, begin and end of each brick on the way, until it says no.
    #[inline(always)]
    fn walk(&self, from: f32, to: f32, mut visit: impl FnMut(usize, [i32; 3], f64, f64) -> bool) {
        let (mut t, end) = (f64::from(from).max(self.inside.0), f64::from(to).min(self.inside.1));
        if end <= t {
            return;
        }
        let along = self.voxels.along().as_ivec3().to_array();
        let side = f64::from(SIDE);
        let mut at = each(|axis| whole(self.place(axis, t) / side, along[axis] - 1));
        let mut next = each(|axis| self.leaves(axis, 8 * at[axis], 8));
        let step = each(|axis| self.step[axis] * side);
        loop {
            let nearest = lesser(lesser(next[0], next[1]), next[2]);
            // Rounding may put a brick behind the ray by less than it can see.
            let leave = lesser(greater(nearest, t), end);
            let cell =
                at[0] as usize + along[0] as usize * (at[1] as usize + along[1] as usize * at[2] as usize);
            if !visit(cell, [8 * at[0], 8 * at[1], 8 * at[2]], t, leave) || end <= leave {
                return;
            }
            let mut outside = false;
            for axis in 0..3 {
                // Through an edge along two axes at once.
                let go = next[axis] <= nearest;
                at[axis] += if go { self.sign[axis] } else { 0 };
                next[axis] += if go { step[axis] } else { 0.0 };
                outside |= at[axis] < 0 || along[axis] <= at[axis];
            }
            if outside {
                return;
            }
            t = leave;
        }
    }

    /// Calls `visit` for the voxels of a brick, as [`Self::pieces`] does.
    #[inline(always)]
    fn voxels(
        &self,
        values: &[f32; BRICK],
        corner: [i32; 3],
        from: f64,
        to: f64,
        visit: &mut impl FnMut(f64, f64, f64) -> bool,
    ) -> bool {
        // Four bits for each axis, of which the highest says that the brick is left.
        const LEFT: u32 = 0x888;
        let local = each(|axis| whole(self.place(axis, from) - f64::from(corner[axis]), 7));
        let mut next = each(|axis| self.leaves(axis, corner[axis] + local[axis], 1));
        let mut at = (local[0] | local[1] << 4 | local[2] << 8) as u32;
        let stride = each(|axis| (self.sign[axis] << (4 * axis)) as u32);
        let mut t = from;
        loop {
            let nearest = lesser(lesser(next[0], next[1]), next[2]);
            let leave = lesser(greater(nearest, t), to);
            let number = at & 7 | at >> 1 & 0o70 | at >> 2 & 0o700;
            let density = f64::from(values[number as usize]);
            if !visit(t, leave, density) {
                return false;
            }
            if to <= nearest {
                return true;
            }
            for axis in 0..3 {
                let go = next[axis] <= nearest;
                at = at.wrapping_add(if go { stride[axis] } else { 0 });
                next[axis] += if go { self.step[axis] } else { 0.0 };
            }
            // Where rounding has the brick end before `to`, what is missing is nothing.
            if at & LEFT != 0 {
                return true;
            }
            t = leave;
        }
    }

    /// Where the ray leaves the cube that begins at this voxel.
    #[inline(always)]
    fn leaves(&self, axis: usize, first: i32, side: i32) -> f64 {
        match self.sign[axis] {
            0 => f64::INFINITY,
            1 => (f64::from(first + side) - self.origin[axis]) * self.inverse[axis],
            _ => (f64::from(first) - self.origin[axis]) * self.inverse[axis],
        }
    }

    /// Coordinate of a place on the ray.
    #[inline(always)]
    fn place(&self, axis: usize, t: f64) -> f64 {
        // At an infinite distance, too.
        if self.sign[axis] == 0 { self.origin[axis] } else { self.origin[axis] + self.direction[axis] * t }
    }
}

/// Where a ray is in the box of a grid whose origin and direction are in voxel space.
fn inside(voxels: &Voxels, origin: Vec3A, direction: Vec3A) -> (f64, f64) {
    let nowhere = (0.0, 0.0);
    if !origin.is_finite() || !direction.is_finite() {
        return nowhere;
    }
    let size = voxels.size().as_dvec3();
    // Finite, so that what stands still for ever in a density of 0 meets nothing.
    let (mut from, mut to) = (-1e300f64, 1e300f64);
    for axis in 0..3 {
        let (o, d) = (f64::from(origin[axis]), f64::from(direction[axis]));
        if d == 0.0 {
            if o < 0.0 || size[axis] <= o {
                return nowhere;
            }
            continue;
        }
        let (a, b) = (-o / d, (size[axis] - o) / d);
        from = from.max(a.min(b));
        to = to.min(a.max(b));
    }
    (from, to)
}

/// Something for each axis; `array::map` is a call here.
#[inline(always)]
fn each<T>(mut of: impl FnMut(usize) -> T) -> [T; 3] {
    [of(0), of(1), of(2)]
}

/// `f64::min` for numbers alone, which is a single instruction.
#[inline(always)]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// `f64::max` likewise.
#[inline(always)]
fn greater(a: f64, b: f64) -> f64 {
    if b < a { a } else { b }
}

/// The whole part of a coordinate, from 0 to `last`.
#[expect(clippy::cast_possible_truncation, reason = "clamped")]
#[inline(always)]
fn whole(v: f64, last: i32) -> i32 {
    // Conversion rounds towards 0 and gives 0 for what is below.
    (v as i32).clamp(0, last)
}

#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
fn narrow(v: f64) -> f32 {
    v as f32
}
