//! Light probes: where they are, which places see them, and what they hold.
//!
//! In this order: `layout` lays bricks of cells over the scene, small ones near surfaces; `settle` moves probes out of walls;
//! Probes of small bricks on the faces of larger ones take the light that these have there. `occlude` finds which probes see which part of the cells that surfaces pass through; `gather` follows the paths; [`Probing::finish`]
//! gives probes in walls the light of their neighbours and takes ringing away.

mod dilate;
mod gather;
mod layout;
mod occlude;
mod settle;

use crate::error::Error;
use crate::geom::world::luminance;
use crate::light::punctual::Punctual;
use crate::solve::accumulate::Gate;
use crate::solve::monitor::Monitor;
use crate::solve::replay::Replayed;
use crate::transport::Kernel;
use gather::{FARTHEST, Gathered, MOST_LAMPS, Region};
use glam::{Vec3, Vec3A};
use layout::Hanging;
pub use layout::{Layout, Where};
use rayon::prelude::*;
pub use settle::is_in_wall;
use tables::probes::{Basis, Brick, Lattice, Light, NONE, Occlusion, Probe, ProbeVolume, least_window};

/// Random numbers of probes belong to this domain and those behind it, one for each volume; see [`crate::sample::sequence::key`].
const DOMAIN: u64 = 0x5052_0000;

/// A probe that sees fewer fronts than this part of what it sees is in a wall.
pub const VALID: f32 = 0.75;

/// What is wanted of a volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Where it is.
    pub place: Where,
    /// What is kept of the light.
    pub basis: Basis,
    /// Paths from each probe.
    pub samples: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Which of the volumes, for random numbers.
    pub number: u64,
}

/// A volume whose places are known and whose light is not.
#[derive(Debug)]
pub struct Probing {
    wanted: Wanted,
    lattice: Lattice,
    index: Vec<u32>,
    bricks: Vec<Brick>,
    occlusions: Vec<Occlusion>,
    /// Metres, relative to the world's origin, and validity.
    places: Vec<(Vec3A, f32)>,
    /// Width of the cells that each place is a corner of, the smallest of them, metres.
    cells: Vec<f32>,
    /// Probes of the lattice; those of single regions are behind them.
    on_lattice: usize,
    hanging: Vec<Hanging>,
    /// Whether light is gathered at each place.
    wanted_at: Vec<bool>,
    moved: usize,
}

/// What is said of a volume.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Probes in walls.
    pub invalid: u64,
    /// Probes that were moved out of walls or off surfaces.
    pub moved: u64,
    /// Probes of single regions of cells.
    pub own: u64,
    /// Probes on the faces of coarser bricks, which hold the light that these have there.
    pub hanging: u64,
    /// Probes that needed a window against ringing.
    pub windowed: u64,
    /// Samples that were not finite.
    pub gate: Gate,
    /// Mean luminance over all directions and valid probes, nits.
    pub mean_luminance: f64,
    /// Root of the mean squared standard error of that, nits.
    pub rms_std_err: f64,
    /// Greatest of them, nits.
    pub max_std_err: f64,
}

impl Probing {
    /// Lays out a volume and finds what its probes see; `None` if it would be too large. Rays are counted by `monitor`.
    ///
    /// # Errors
    ///
    /// [`Error::Interrupted`] when the monitor asks to stop.
    pub fn new(kernel: &Kernel<'_>, wanted: Wanted, monitor: &Monitor) -> Result<Option<Self>, Error> {
        let Some(layout) = Layout::new(kernel.world, wanted.place) else { return Ok(None) };
        let settled: Vec<settle::Settled> = layout
            .nodes
            .par_iter()
            .with_min_len(16)
            .map(|n| settle::settle(kernel, layout.place(n.at), n.reach, monitor))
            .collect();
        if monitor.stopped() {
            return Err(Error::Interrupted);
        }
        let moved = settled.iter().filter(|s| s.moved).count();
        let mut places: Vec<(Vec3A, f32)> = settled.iter().map(|s| (s.place, s.validity)).collect();
        let mut widths: Vec<f32> = layout.nodes.iter().map(|n| n.reach).collect();
        let on_lattice = places.len();
        let cells = occlude::occlude(kernel, &layout, &settled, monitor)?;
        let hanging = layout.hanging();
        let mut bricks = layout.bricks;
        let mut occlusions = Vec::new();
        for (brick, cells) in bricks.iter_mut().zip(cells) {
            for (slot, cell) in cells.list {
                brick.cells[slot] = number(occlusions.len());
                let mut occlusion = cell.occlusion;
                for (k, place) in cell.own.iter().enumerate() {
                    let Some(place) = place else { continue };
                    // Regions beside one another may share a probe.
                    occlusion.own[k] = match cell.own[..k].iter().position(|p| p.as_ref() == Some(place)) {
                        Some(same) => occlusion.own[same],
                        None => {
                            places.push((*place, 1.0));
                            widths.push(layout.spacing * (1u32 << brick.level) as f32);
                            number(places.len() - 1)
                        }
                    };
                }
                occlusions.push(occlusion);
            }
        }
        let origin = (Vec3::from(layout.origin) + kernel.world.origin).to_array();
        let lattice =
            Lattice { origin, spacing: layout.spacing, size: layout.size.to_array(), levels: layout.levels };
        let mut wanted_at: Vec<bool> = places.iter().map(|p| VALID <= p.1).collect();
        hanging.iter().for_each(|h| wanted_at[h.node as usize] = false);
        let index = layout.index;
        Ok(Some(Self {
            wanted,
            lattice,
            index,
            bricks,
            occlusions,
            places,
            cells: widths,
            on_lattice,
            hanging,
            wanted_at,
            moved,
        }))
    }

    /// Paths that gathering will take.
    #[must_use]
    pub fn paths(&self) -> u64 {
        self.wanted_at.iter().filter(|w| **w).count() as u64 * u64::from(self.wanted.samples)
    }

    /// Where a probe gathers.
    fn region(&self, kernel: &Kernel<'_>, probe: usize) -> Region {
        let (place, cell) = (self.places[probe].0, self.cells[probe]);
        let lights = kernel.lights;
        let groups = lights.emitters.groups().iter().filter(|g| g.radius < 0.5 * cell);
        let all = lights.punctual.iter().map(Punctual::position).chain(groups.map(|g| g.centre));
        let far = |p: &Vec3A| (*p - place).length_squared();
        let mut lamps: Vec<Vec3A> = all.filter(|p| far(p) < (FARTHEST * cell).powi(2)).collect();
        lamps.sort_by(|a, b| far(a).total_cmp(&far(b)));
        lamps.truncate(MOST_LAMPS);
        Region { place, cell, lamps }
    }

    /// What the random numbers of a probe are drawn from, and the numbers of its volume and its own.
    fn random(&self, probe: usize) -> (u64, (usize, u32)) {
        let Wanted { seed, number: volume, .. } = self.wanted;
        #[expect(clippy::cast_possible_truncation, reason = "a few volumes")]
        let of = (volume as usize, number(probe));
        (crate::sample::sequence::key(seed, DOMAIN + volume, probe as u64), of)
    }

    /// What one sample of a probe finds, as [`Probing::finish`] would; `None` where no light is gathered.
    #[must_use]
    pub fn replay(&self, kernel: &Kernel<'_>, probe: u32, sample: u32) -> Option<Replayed> {
        let probe = probe as usize;
        if !*self.wanted_at.get(probe)? {
            return None;
        }
        let place = self.places[probe].0;
        let mut out = Replayed::at(kernel.world, place, Vec3A::ZERO);
        let (key, _) = self.random(probe);
        let Replayed { rays, around, .. } = &mut out;
        gather::sample(
            kernel,
            &self.region(kernel, probe),
            (sample, self.wanted.samples),
            key,
            rays,
            &mut |wi, light| {
                around.push((wi.into(), light));
            },
        );
        Some(out)
    }

    /// Gathers the light.
    ///
    /// # Errors
    ///
    /// [`Error::Interrupted`] when the monitor asks to stop.
    pub fn finish(self, kernel: &Kernel<'_>, monitor: &Monitor) -> Result<(ProbeVolume, Figures), Error> {
        let Wanted { basis, samples, .. } = self.wanted;
        let gathered: Vec<Option<Gathered>> = self
            .wanted_at
            .par_iter()
            .enumerate()
            .with_max_len(16)
            .map(|(i, wanted)| {
                (*wanted && !monitor.stopped()).then(|| {
                    gather::gather(kernel, &self.region(kernel, i), samples, self.random(i), monitor)
                })
            })
            .collect();
        if monitor.stopped() {
            return Err(Error::Interrupted);
        }
        let mut figures = Figures {
            invalid: self.places.iter().filter(|p| p.1 < VALID).count() as u64,
            hanging: self.hanging.len() as u64,
            moved: self.moved as u64,
            own: (self.places.len() - self.on_lattice) as u64,
            gate: gathered.iter().flatten().map(|g| g.gate).fold(Gate::default(), Gate::merge),
            ..Figures::default()
        };
        let mut light: Vec<Option<Light>> =
            gathered.iter().map(|g| g.as_ref().map(|g| Light::project(basis, &g.light))).collect();
        dilate::dilate(&self.bricks, &mut light);
        let origin = kernel.world.origin;
        let mut squares = 0.0;
        let mut probes = Vec::with_capacity(light.len());
        for (((place, validity), light), gathered) in self.places.iter().zip(light).zip(&gathered) {
            let (window, light) = least_window(&light.unwrap_or(Light::black(basis)));
            let std_err = gathered.as_ref().map_or(0.0, |g| g.std_err);
            if gathered.is_some() {
                figures.windowed += u64::from(0.0 < window);
                figures.mean_luminance += f64::from(mean_luminance(&light));
                squares += f64::from(std_err).powi(2);
                figures.max_std_err = figures.max_std_err.max(f64::from(std_err));
            }
            let position = (Vec3::from(*place) + origin).to_array();
            probes.push(Probe { position, light, std_err, validity: *validity, window });
        }
        for Hanging { node, of } in &self.hanging {
            let (mut light, mut std_err) = (Light::black(basis), 0.0);
            for (probe, weight) in of.iter().filter(|(_, weight)| 0.0 < *weight) {
                let probe: &Probe = &probes[*probe as usize];
                light.add(&probe.light, *weight);
                std_err += weight * probe.std_err;
            }
            let probe = &mut probes[*node as usize];
            (probe.light, probe.std_err, probe.window) = (light, std_err, 0.0);
        }
        let n = gathered.iter().flatten().count().max(1) as f64;
        figures.mean_luminance /= n;
        figures.rms_std_err = (squares / n).sqrt();
        let Self { lattice, index, bricks, occlusions, .. } = self;
        Ok((ProbeVolume { basis, lattice, index, bricks, occlusions, probes }, figures))
    }
}

/// Mean luminance over all directions, nits.
fn mean_luminance(light: &Light) -> f32 {
    // The first basis function is 1 / sqrt(4 pi).
    luminance(Vec3::from(light.coefficients()[0])) * 0.282_094_8
}

/// Numbers of probes and bricks, of which there are fewer than 2^32.
#[expect(clippy::cast_possible_truncation, reason = "memory holds fewer")]
fn number(n: usize) -> u32 {
    debug_assert!(n < NONE as usize);
    n as u32
}
