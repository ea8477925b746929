//! Light in media: what arrives at the nodes of a lattice.
//!
//! Nodes hold radiance from all directions, as spherical harmonics of bands 0 to 2, of everything but what suns, lamps and emitters that are not wide bring
//! straight away: that has no bound near a lamp and is gathered along each ray instead, by [`Kernel::airlight`](super::Kernel). What the cells
//! between nodes know of these lights is whether all of their nodes see one, none, or some.

use crate::geom::World;
use crate::geom::voxels::touched;
use crate::geom::world::luminance;
use crate::media::{Media, henyey_greenstein};
use crate::scene::model::Rgb;
use glam::{UVec3, Vec3, Vec3A};
use std::f32::consts::FRAC_1_PI;

/// Coefficients of bands 0 to 2.
pub const COEFFICIENTS: usize = 9;

/// Lights of higher numbers are looked at from each place anew.
const KNOWN: usize = 256;

/// How far the first and the last nodes lie inside the bounds, cells; not alike, so that none lies in the middle, where walls often stand.
const INSET: [f32; 2] = [0.02, 0.05];

/// What a cell knows of a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Seen {
    /// From none of its nodes.
    Nowhere,
    /// From all of them.
    Everywhere,
    /// From some, or there are surfaces in the cell.
    Perhaps,
}

/// Light at the nodes of a lattice.
#[derive(Clone, Debug)]
pub struct LightGrid {
    /// Place of the first node, metres relative to [`World::origin`].
    origin: Vec3A,
    /// Sides of a cell, metres.
    cell: Vec3A,
    /// Their inverses.
    per_metre: Vec3A,
    /// Nodes along each axis, at least two.
    size: UVec3,
    /// Whether a part of a surface may be in a cell.
    occupied: Vec<bool>,
    /// Lights that cells know of.
    known: usize,
    /// What they know, cell by cell.
    seen: Vec<Seen>,
    /// What mean cosines were multiplied with so that the light of all orders has a limit; 1 unless paths were too few.
    pub forward: f32,
    /// The media in which nodes' light was scattered and lamps' light comes to them: [`Media::smoothed`].
    media: Media,
    /// Radiance at each node, x fastest, then y, then z.
    pub(crate) light: Vec<[Rgb; COEFFICIENTS]>,
    /// What each cell knows of the light in it; empty until [`LightGrid::summarise`].
    summaries: Vec<Summary>,
    /// Direction of the sun that [`Summary::sun`] is about.
    sun: Vec3A,
}

/// Mean of the light in a cell in which nothing stands.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(32))]
struct Summary {
    /// Mean radiance over all directions, nits.
    even: Rgb,
    /// Illuminance of the strongest sun, lux.
    sun: Rgb,
}

/// A place in the lattice.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inside {
    /// Which cell.
    pub(crate) cell: usize,
    /// Its first node.
    first: usize,
    /// Where in the cell, 0 to 1 along each axis.
    pub(crate) part: Vec3A,
}

impl LightGrid {
    /// A dark lattice over the box from `min` to `max` of about `nodes` nodes, for smoothed media.
    #[must_use]
    pub fn new(world: &World, media: Media, (min, max): (Vec3, Vec3), nodes: u32) -> Self {
        let extent = (max - min).max(Vec3::splat(1e-3 * (max - min).max_element()));
        let along = |cell: f32| (extent / cell).ceil().clamp(Vec3::ONE, Vec3::splat(1024.0)).as_uvec3() + 1;
        let count = |cell: f32| along(cell).as_dvec3().element_product();
        // Halving finds the finest lattice that is not larger than wanted.
        let (mut fine, mut coarse) = (0.0, extent.max_element());
        for _ in 0..40 {
            let middle = 0.5 * (fine + coarse);
            if count(middle) <= f64::from(nodes) { coarse = middle } else { fine = middle }
        }
        let size = along(coarse);
        // Walls often stand where media end, and a node in a wall would see half of what it should.
        let cell = Vec3A::from(extent) / ((size - 1).as_vec3a() + INSET[0] + INSET[1]);
        let origin = Vec3A::from(0.5 * (min + max) - 0.5 * extent) + INSET[0] * cell;
        let cells = (size - 1).element_product() as usize;
        let n = size.element_product() as usize;
        let mut grid = Self {
            origin,
            cell,
            per_metre: cell.recip(),
            size,
            occupied: vec![false; cells],
            known: 0,
            seen: Vec::new(),
            forward: 1.0,
            media,
            light: vec![[Vec3::ZERO; COEFFICIENTS]; n],
            summaries: Vec::new(),
            sun: Vec3A::Z,
        };
        world.triangles().for_each(|t| grid.occupy(t));
        grid
    }

    /// Marks the cells that a triangle may touch.
    fn occupy(&mut self, corners: [Vec3; 3]) {
        let corners = corners.map(|c| (Vec3A::from(c) - self.origin) / self.cell);
        touched(corners, self.size - 1, |c| {
            let cell = self.cell_index(c);
            self.occupied[cell] = true;
        });
    }

    fn cell_index(&self, c: UVec3) -> usize {
        ((c.z * (self.size.y - 1) + c.y) * (self.size.x - 1) + c.x) as usize
    }

    fn node_index(&self, n: UVec3) -> usize {
        ((n.z * self.size.y + n.y) * self.size.x + n.x) as usize
    }

    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.light.len()
    }

    /// Whether there are no nodes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.light.is_empty()
    }

    /// Nodes along each axis.
    #[must_use]
    pub fn size(&self) -> UVec3 {
        self.size
    }

    /// Sides of a cell, metres.
    #[must_use]
    pub fn cell(&self) -> Vec3A {
        self.cell
    }

    /// Where a node is, metres relative to [`World::origin`].
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "fewer nodes than 2^32")]
    pub fn node(&self, index: usize) -> Vec3A {
        let (i, s) = (index as u32, self.size);
        self.origin + UVec3::new(i % s.x, i / s.x % s.y, i / (s.x * s.y)).as_vec3a() * self.cell
    }

    /// The media in which nodes' light was scattered, and in which light comes from suns, lamps and emitters to where it is scattered first.
    pub(crate) fn media(&self) -> &Media {
        &self.media
    }

    /// A place no farther from a node than half a cell along each axis, and in the lattice.
    pub(crate) fn near(&self, node: usize, u: [f32; 3]) -> Vec3A {
        let end = self.origin + (self.size - 1).as_vec3a() * self.cell;
        (self.node(node) + (Vec3A::from_array(u) - 0.5) * self.cell).clamp(self.origin, end)
    }

    /// Radiance at a node.
    #[must_use]
    pub fn light(&self, node: usize) -> &[Rgb; COEFFICIENTS] {
        &self.light[node]
    }

    /// The place of a point; beside the lattice that of the nearest point in it.
    pub(crate) fn inside(&self, p: Vec3A) -> Inside {
        let x = ((p - self.origin) / self.cell).clamp(Vec3A::ZERO, (self.size - 1).as_vec3a());
        let c = x.floor().min((self.size - 2).as_vec3a());
        let corner = c.as_uvec3();
        Inside { cell: self.cell_index(corner), first: self.node_index(corner), part: x - c }
    }

    /// The node at a corner of a cell: bit k of `corner` says which end of axis k.
    pub(crate) fn corner(&self, at: Inside, corner: usize) -> usize {
        let (x, y) = (self.size.x as usize, self.size.y as usize);
        at.first + (corner & 1) + (corner >> 1 & 1) * x + (corner >> 2) * x * y
    }

    /// Whether there may be surfaces in a cell.
    pub(crate) fn is_occupied(&self, cell: usize) -> bool {
        self.occupied[cell]
    }

    /// Phase function between the sun that cells know apart and rays with the direction `d`, where media have the mean cosine `g`.
    #[inline]
    pub(crate) fn phase_of_sun(&self, d: Vec3A, g: f32) -> f32 {
        if g == 0.0 { 0.25 * FRAC_1_PI } else { henyey_greenstein(g, self.sun.dot(d)) }
    }

    /// What a place in a cell scatters into a ray, as far as the cell knows it, per unit of sigma_s; `phase` is [`LightGrid::phase_of_sun`].
    #[inline]
    pub(crate) fn known(&self, cell: usize, phase: f32) -> Rgb {
        self.summaries.get(cell).map_or(Vec3::ZERO, |s| s.even + s.sun * phase)
    }

    /// The same at places one after the other, each times its weight, in all.
    #[inline]
    pub(crate) fn known_along<const N: usize>(
        &self,
        phase: f32,
        first: Vec3A,
        step: Vec3A,
        weights: &[Rgb; N],
    ) -> Rgb {
        let (x, dx) = ((first - self.origin) * self.per_metre, step * self.per_metre);
        let last = (self.size - 2).as_vec3a();
        let row = self.size - 1;
        let mut sum = Vec3::ZERO;
        for (k, weight) in weights.iter().enumerate() {
            let c = (x + dx * k as f32).clamp(Vec3A::ZERO, last).as_uvec3();
            sum += *weight * self.known(((c.z * row.y + c.y) * row.x + c.x) as usize, phase);
        }
        sum
    }

    /// Tells the cells what they know from the nodes' light and from suns: each the number among the lights that cells know of, direction and illuminance, lux.
    pub(crate) fn summarise(&mut self, suns: &[(usize, Vec3A, Rgb)]) {
        let strongest = suns.iter().max_by(|a, b| luminance(a.2).total_cmp(&luminance(b.2)));
        self.sun = strongest.map_or(Vec3A::Z, |s| s.1);
        let last = self.size - 1;
        let mut all = Vec::with_capacity(self.occupied.len());
        for (z, y, x) in
            (0..last.z).flat_map(|z| (0..last.y).flat_map(move |y| (0..last.x).map(move |x| (z, y, x))))
        {
            let corner = UVec3::new(x, y, z);
            let cell = self.cell_index(corner);
            let at = Inside { cell, first: self.node_index(corner), part: Vec3A::ZERO };
            let nodes: [&[Rgb; COEFFICIENTS]; 8] = std::array::from_fn(|k| &self.light[self.corner(at, k)]);
            let mut s = Summary::default();
            // Where something stands it may be dark on one side, and what is dark has to stay so exactly.
            if !self.occupied[cell] {
                s.even = harmonics(Vec3A::Z)[0] * nodes.iter().map(|n| n[0]).sum::<Vec3>() / 8.0;
                let middle = self.node(at.first) + 0.5 * self.cell;
                for &(light, wi, illuminance) in
                    suns.iter().filter(|s| self.seen(cell, s.0) == Seen::Everywhere)
                {
                    let arrives = illuminance * self.media.transmittance(middle, wi, f32::INFINITY);
                    if Some(light) == strongest.map(|s| s.0) {
                        s.sun = arrives;
                    } else {
                        s.even += arrives * (0.25 * FRAC_1_PI);
                    }
                }
            }
            all.push(s);
        }
        self.summaries = all;
    }

    /// What a cell knows of a light.
    pub(crate) fn seen(&self, cell: usize, light: usize) -> Seen {
        if light < self.known { self.seen[cell * self.known + light] } else { Seen::Perhaps }
    }

    /// Number of the lights, `lights` in all, that nodes have to look at.
    pub(crate) fn looks_at(lights: usize) -> usize {
        lights.min(KNOWN)
    }

    /// Tells the cells what each node sees of the first `known` lights: node by node.
    pub(crate) fn look(&mut self, known: usize, nodes: &[Seen]) {
        (self.known, self.seen) = (known, Vec::with_capacity(known * self.occupied.len()));
        let last = self.size - 1;
        for (z, y, x) in
            (0..last.z).flat_map(|z| (0..last.y).flat_map(move |y| (0..last.x).map(move |x| (z, y, x))))
        {
            let corner = UVec3::new(x, y, z);
            let at = Inside { cell: 0, first: self.node_index(corner), part: Vec3A::ZERO };
            let occupied = self.occupied[self.cell_index(corner)];
            for light in 0..known {
                let of = |k: usize| nodes[self.corner(at, k) * known + light];
                let alike = (1..8).all(|k| of(k) == of(0));
                self.seen.push(if alike && !occupied { of(0) } else { Seen::Perhaps });
            }
        }
    }
}

/// Real spherical harmonics of bands 0 to 2 in a direction, in the order and with the signs of [`tables::harmonics`].
#[inline]
pub(crate) fn harmonics(d: Vec3A) -> [f32; COEFFICIENTS] {
    const A: f32 = 0.282_094_8;
    const B: f32 = 0.488_602_52;
    const C: f32 = 1.092_548_4;
    let (x, y, z) = (d.x, d.y, d.z);
    [
        A,
        B * y,
        B * z,
        B * x,
        C * x * y,
        C * y * z,
        0.315_391_57 * (3.0 * z * z - 1.0),
        C * x * z,
        0.546_274_2 * (x * x - y * y),
    ]
}

/// The harmonics that light is multiplied with for what is scattered into a ray with the direction `d`: those of \[Slo13\] with bands 1 and 2
/// of the phase function, [`Media::bands`].
#[inline]
pub(crate) fn scattering(d: Vec3A, bands: [f32; 2]) -> [f32; COEFFICIENTS] {
    let mut y = harmonics(d);
    for (k, v) in y.iter_mut().enumerate().skip(1) {
        *v *= bands[usize::from(3 < k)];
    }
    y
}

/// What a medium that scatters alike in all directions sends on, per unit of sigma_s: to the bit what [`dot`] gives with [`scattering`] of no bands.
#[inline]
pub(crate) fn even(light: &[Rgb; COEFFICIENTS]) -> Rgb {
    light[0] * harmonics(Vec3A::Z)[0]
}

/// The sum over all coefficients.
#[inline]
pub(crate) fn dot(light: &[Rgb; COEFFICIENTS], y: &[f32; COEFFICIENTS]) -> Rgb {
    light.iter().zip(y).map(|(l, y)| *l * *y).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_are_those_of_the_tables() {
        for d in [Vec3A::X, Vec3A::new(0.36, -0.48, 0.8), Vec3A::new(-0.6, 0.0, -0.8)] {
            let all = tables::harmonics::real::basis(d.to_array());
            for (a, b) in harmonics(d).iter().zip(all) {
                assert!((a - b).abs() < 1e-6, "{d}: {a} {b}");
            }
        }
    }

    fn room() -> World {
        World::default()
    }

    #[test]
    fn lattices_have_the_size_that_is_asked_for() {
        for (extent, nodes) in
            [(Vec3::ONE, 1000), (Vec3::new(30.0, 3.0, 12.0), 20_000), (Vec3::new(1.0, 0.0, 2.0), 64)]
        {
            let grid = LightGrid::new(&room(), Media::default(), (-extent, extent), nodes);
            let n = grid.len();
            assert!(n <= nodes as usize && nodes as usize / 3 < n, "{extent}: {n} of {nodes}");
            for axis in (0..3).filter(|a| 0.0 < extent[*a]) {
                let ends = [grid.node(0)[axis] + extent[axis], extent[axis] - grid.node(n - 1)[axis]];
                let inset = ends.map(|e| e / grid.cell()[axis]);
                assert!(inset.iter().all(|i| 0.01 < *i && *i < 0.06), "{extent}: {inset:?}");
            }
        }
    }

    /// The corners of a point's cell, weighed trilinearly, give the point; beside the lattice the nearest one in it.
    #[test]
    fn places_lie_between_their_corners() {
        let grid = LightGrid::new(
            &room(),
            Media::default(),
            (Vec3::new(-1.0, 0.0, 2.0), Vec3::new(3.0, 1.0, 4.0)),
            300,
        );
        for p in [[-1.0, 0.0, 2.0], [0.1, 0.2, 2.3], [2.9, 0.99, 3.9], [3.0, 1.0, 4.0], [9.0, 0.5, -7.0]] {
            let p = Vec3A::from_array(p);
            let at = grid.inside(p);
            let mut sum = Vec3A::ZERO;
            for k in 0..8usize {
                let end = |axis: usize| if k >> axis & 1 == 1 { at.part[axis] } else { 1.0 - at.part[axis] };
                sum += grid.node(grid.corner(at, k)) * (end(0) * end(1) * end(2));
            }
            let nearest = p.clamp(grid.node(0), grid.node(grid.len() - 1));
            assert!((sum - nearest).length() < 1e-4, "{p}: {sum} {nearest}");
        }
    }
}
