//! A lattice of probes in bricks, and its look-up.

use super::light::{Basis, Light};

/// No brick, probe or occlusion.
pub const NONE: u32 = u32::MAX;

/// Cells along the side of a brick.
pub const CELLS: usize = 4;

/// Probes along the side of a brick; those on its faces are shared with its neighbours of the same size.
pub const NODES: usize = CELLS + 1;

/// Planes that part a cell, at most.
pub const PLANES: usize = 4;

/// Regions that they part it into.
pub const REGIONS: usize = 1 << PLANES;

/// Probes around a cell. Corner k lies at the far end along x, y, z where bit 0, 1, 2 of k is set.
pub const CORNERS: usize = 8;

/// Where the lattice lies.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lattice {
    /// First corner, metres in the scene's axes.
    pub origin: [f32; 3],
    /// Side of the smallest cell, metres.
    pub spacing: f32,
    /// Smallest bricks along each axis.
    pub size: [u32; 3],
    /// Sizes of bricks: cells of level l are `spacing << l` wide.
    pub levels: u32,
}

impl Lattice {
    /// Smallest bricks in all.
    #[must_use]
    pub fn len(&self) -> usize {
        self.size.iter().map(|n| *n as usize).product()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A place in smallest cells from the first corner.
    #[must_use]
    pub fn cells(&self, p: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|a| (p[a] - self.origin[a]) / self.spacing)
    }
}

/// A cube of cells.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Brick {
    /// First corner, in smallest cells from that of the lattice.
    pub corner: [u32; 3],
    /// Cells are 2 to this power as wide as the smallest.
    pub level: u32,
    /// Numbers of its probes, x fastest, then y, then z.
    pub probes: [u32; NODES * NODES * NODES],
    /// Number of each cell's [`Occlusion`], x fastest; [`NONE`] where all eight probes see all of it.
    pub cells: [u32; CELLS * CELLS * CELLS],
}

/// Which probes see which part of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Occlusion {
    /// Unit normals and distances in metres, the lattice's first corner being the origin: bit k of a place's region is set where
    /// n . p > d. All 0 where there are fewer.
    pub planes: [[f32; 4]; PLANES],
    /// For each region how much of it each corner's probe sees, 0 to 255.
    pub weights: [[u8; CORNERS]; REGIONS],
    /// A probe of its own for regions that no corner sees; [`NONE`] elsewhere.
    pub own: [u32; REGIONS],
}

/// What is known at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe {
    /// Where light was gathered, metres in the scene's axes: its corner of the lattice, or next to it where that is in a wall.
    pub position: [f32; 3],
    /// Light, with its window.
    pub light: Light,
    /// Standard error of the mean luminance over all directions, nits.
    pub std_err: f32,
    /// Part of the directions in which no back of a one-sided surface was seen; below 0.75 the probe is in a wall and holds its neighbours' light.
    pub validity: f32,
    /// Window against ringing, 0 for most; [`super::least_window`].
    pub window: f32,
}

/// Probes of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProbeVolume {
    /// What each probe holds.
    pub basis: Basis,
    /// Where the bricks are.
    pub lattice: Lattice,
    /// Number of the brick at each of the lattice's smallest bricks, x fastest; large ones are there more than once, and [`NONE`] where there is none.
    pub index: Vec<u32>,
    /// Cubes of cells.
    pub bricks: Vec<Brick>,
    /// Occlusions of the cells that have one.
    pub occlusions: Vec<Occlusion>,
    /// Probes of the lattice, and those of single regions behind them.
    pub probes: Vec<Probe>,
}

/// Up to eight probes and their weights, which sum to one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Weights {
    /// Numbers of probes.
    pub probes: [u32; CORNERS],
    /// Their weights, 0 for those that do not count.
    pub weights: [f32; CORNERS],
}

impl ProbeVolume {
    /// Which probes count at a place, and how much: trilinear interpolation among those that see it. Places outside the lattice are moved
    /// onto its faces; `None` where no probe is.
    #[must_use]
    pub fn weights(&self, p: [f32; 3]) -> Option<Weights> {
        let l = &self.lattice;
        let end = l.size.map(|n| (n as usize * CELLS) as f32);
        let cells = l.cells(p);
        if cells.iter().any(|c| c.is_nan()) || l.is_empty() {
            return None;
        }
        let at: [f32; 3] = std::array::from_fn(|a| cells[a].clamp(0.0, end[a]));
        let brick = {
            let b: [usize; 3] =
                std::array::from_fn(|a| whole(at[a] / CELLS as f32).min(l.size[a] as usize - 1));
            let [nx, ny, _] = l.size.map(|n| n as usize);
            *self.index.get((b[2] * ny + b[1]) * nx + b[0])?
        };
        let brick = self.bricks.get(brick as usize)?;
        let scale = (1u32 << brick.level) as f32;
        let local: [f32; 3] = std::array::from_fn(|a| (at[a] - brick.corner[a] as f32) / scale);
        let cell = local.map(|x| whole(x).min(CELLS - 1));
        let part: [f32; 3] = std::array::from_fn(|a| (local[a] - cell[a] as f32).clamp(0.0, 1.0));
        let corner = |k: usize| [0, 1, 2].map(|a| cell[a] + (k >> a & 1));
        let mut out = Weights::default();
        for k in 0..CORNERS {
            let [x, y, z] = corner(k);
            out.probes[k] = brick.probes[(z * NODES + y) * NODES + x];
            out.weights[k] = (0..3).map(|a| if k >> a & 1 == 1 { part[a] } else { 1.0 - part[a] }).product();
        }
        let occlusion = brick.cells[(cell[2] * CELLS + cell[1]) * CELLS + cell[0]];
        if occlusion == NONE {
            return Some(out);
        }
        let occlusion = self.occlusions.get(occlusion as usize)?;
        let region = occlusion.region(std::array::from_fn(|a| p[a] - l.origin[a]));
        if occlusion.own[region] != NONE {
            let mut own = Weights::default();
            (own.probes[0], own.weights[0]) = (occlusion.own[region], 1.0);
            return Some(own);
        }
        // Where a place lies on a probe that does not see it, those that do still count.
        let seen = occlusion.weights[region].map(|s| f32::from(s) * (1.0 / 255.0));
        for (w, s) in out.weights.iter_mut().zip(seen) {
            *w = w.max(LEAST) * s;
        }
        let sum: f32 = out.weights.iter().sum();
        if sum <= 0.0 {
            return None;
        }
        out.weights.iter_mut().for_each(|w| *w /= sum);
        Some(out)
    }

    /// Light at a place; `None` where no probe is. Mixtures of [`Basis::Zh3`] turn about the axis of the mixture, so that their irradiance may be a
    /// little below 0 where that of every probe is not.
    #[must_use]
    pub fn light(&self, p: [f32; 3]) -> Option<Light> {
        let w = self.weights(p)?;
        let mut light = Light::black(self.basis);
        for (probe, weight) in w.probes.iter().zip(w.weights).filter(|(_, weight)| 0.0 < *weight) {
            light.add(&self.probes.get(*probe as usize)?.light, weight);
        }
        Some(light)
    }
}

/// Least trilinear weight of a corner in cells that have an [`Occlusion`].
const LEAST: f32 = 1e-4;

impl Occlusion {
    /// The region of a place, metres from the lattice's first corner.
    #[must_use]
    pub fn region(&self, p: [f32; 3]) -> usize {
        let side = |plane: &[f32; 4]| plane[3] < plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2];
        self.planes.iter().enumerate().map(|(k, plane)| usize::from(side(plane)) << k).sum()
    }
}

/// The cell that a place is in; not negative.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the lattice before")]
fn whole(x: f32) -> usize {
    x.max(0.0) as usize
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// One brick over [0, 8]^3 whose probes hold their x; a wall at x = 1 parts the first cell.
    pub(crate) fn example(basis: Basis) -> ProbeVolume {
        let mut probes = Vec::new();
        for i in 0..NODES * NODES * NODES {
            let x = (i % NODES) as f32;
            let position = [2.0 * x, 2.0 * (i / NODES % NODES) as f32, 2.0 * (i / NODES / NODES) as f32];
            let light = Light::new(basis, &[[x, 1.0, 0.0]]);
            probes.push(Probe { position, light, std_err: 0.25, validity: 1.0, window: 0.0 });
        }
        let mut cells = [NONE; CELLS * CELLS * CELLS];
        cells[0] = 0;
        let mut occlusion = Occlusion {
            planes: [[1.0, 0.0, 0.0, 1.0], [0.0; 4], [0.0; 4], [0.0; 4]],
            weights: [[255; 8]; REGIONS],
            own: [NONE; REGIONS],
        };
        occlusion.weights[0] = [255, 0, 255, 0, 255, 0, 255, 0];
        occlusion.weights[1] = [0, 255, 0, 255, 0, 255, 0, 255];
        let number = |i: usize| u32::try_from(i).expect("small");
        ProbeVolume {
            basis,
            lattice: Lattice { origin: [0.0; 3], spacing: 1.0, size: [2; 3], levels: 2 },
            index: vec![0; 8],
            bricks: vec![Brick { corner: [0; 3], level: 1, probes: std::array::from_fn(number), cells }],
            occlusions: vec![occlusion],
            probes,
        }
    }

    #[test]
    fn free_cells_interpolate() {
        let v = example(Basis::L1);
        for (p, want) in [([3.0, 1.0, 1.0], 1.5), ([8.0, 8.0, 8.0], 4.0), ([5.5, 0.0, 7.9], 2.75)] {
            let light = v.light(p).expect("inside");
            assert!((light.coefficients()[0][0] - want).abs() < 1e-5, "{p:?}: {light:?}");
            assert!((light.coefficients()[0][1] - 1.0).abs() < 1e-6);
        }
        assert_eq!(v.light([-5.0, 9.0, 90.0]), v.light([0.0, 8.0, 8.0]));
        assert_eq!(v.light([f32::NAN, 0.0, 0.0]), None);
        assert_eq!(ProbeVolume::default().light([0.0; 3]), None);
    }

    #[test]
    fn nothing_passes_a_wall() {
        let v = example(Basis::L2);
        for x in [0.0, 0.5, 0.999] {
            assert_eq!(v.light([x, 0.3, 1.7]).expect("inside").coefficients()[0][0], 0.0, "{x}");
        }
        for x in [1.001, 1.5, 1.999] {
            let there = v.light([x, 0.3, 1.7]).expect("inside").coefficients()[0][0];
            assert!((there - 1.0).abs() < 1e-6, "{x}: {there}");
        }
    }

    #[test]
    fn a_region_may_have_a_probe_of_its_own() {
        let mut v = example(Basis::L1);
        v.occlusions[0].weights[0] = [0; 8];
        assert_eq!(v.light([0.5; 3]), None);
        v.occlusions[0].own[0] = 4;
        assert_eq!(v.light([0.5; 3]).expect("its own").coefficients()[0][0], 4.0);
    }
}
