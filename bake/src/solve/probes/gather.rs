//! Follows a probe's paths.

use crate::geom::world::luminance;
use crate::sample::Sequence;
use crate::scene::model::Rgb;
use crate::solve::accumulate::{Gate, Kind, Rejected};
use crate::solve::monitor::Monitor;
use crate::transport::Kernel;
use crate::transport::around::{Finds, Place};
use glam::{Vec3, Vec3A};
use tables::harmonics::real;
use tables::num::moments::Moments;
use tables::probes::MOST_COEFFICIENTS;

/// Blocks of samples whose spread states the error.
const BLOCKS: u32 = 16;

/// Samples, about, that light straight from suns and lamps is part of: from a single place it has less noise than paths have.
const STRAIGHT: u32 = 64;

/// Irradiance over pi to radiance, band by band; irradiance has no third band.
const FROM_IRRADIANCE: [f32; 4] = [1.0, 1.5, 4.0, 0.0];

/// Lamps within so many cells are beside a probe.
const BESIDE: f32 = 1.0;

/// Samples that do not start at the probe itself keep so far off lamps, parts of a cell, and nearer lamps shine as from there.
const OFF: f32 = 0.5;

/// Places that are tried for that.
const TRIES: usize = 8;

/// The nearest lamps, from which samples keep off; beside more of them one does not stand out.
pub(super) const MOST_LAMPS: usize = 16;

/// How far away they may be, cells: a cell and as far as samples keep off.
pub(super) const FARTHEST: f32 = BESIDE + OFF;

/// Where a probe gathers.
#[derive(Clone, Debug)]
pub(super) struct Region {
    /// Metres relative to the world's origin.
    pub(super) place: Vec3A,
    /// Width of the cells that the probe is a corner of, metres.
    pub(super) cell: f32,
    /// Lamps and small emissive surfaces in these cells and beside them.
    pub(super) lamps: Vec<Vec3A>,
}

impl Region {
    /// Where a sample starts: the place itself unless a lamp is so near that the light there, and on what the lamp hangs from, may be hundreds of times
    /// what is a step away. Then it is a place of a ball as wide as the cells that is seen from there and lies off lamps.
    fn start(&self, kernel: &Kernel<'_>, sequence: &mut Sequence, rays: &mut u32) -> Vec3A {
        let mut place = self.place;
        if self.is_single() {
            return place;
        }
        for _ in 0..TRIES {
            let [a, b, c, _] = sequence.next4();
            place = kernel.nearby(self.place, self.cell, [a, b, c], rays);
            if self.is_off_lamps(place, OFF) {
                break;
            }
        }
        place
    }

    /// Whether all samples start at the place itself.
    fn is_single(&self) -> bool {
        self.is_off_lamps(self.place, BESIDE)
    }

    /// Whether no lamp is within so many cells of a place.
    fn is_off_lamps(&self, p: Vec3A, cells: f32) -> bool {
        let far = cells * self.cell;
        self.lamps.iter().all(|lamp| far * far <= (*lamp - p).length_squared())
    }
}

/// What a probe found.
#[derive(Clone, Debug)]
pub(super) struct Gathered {
    /// Radiance by coefficients of bands 0 to 3, nits.
    pub(super) light: [[f32; 3]; MOST_COEFFICIENTS],
    /// Of the mean luminance over all directions, nits.
    pub(super) std_err: f32,
    /// Samples that were not finite.
    pub(super) gate: Gate,
}

/// Samples of each block where so many are asked for in all.
fn per_block(samples: u32) -> u32 {
    samples.div_ceil(BLOCKS).max(1)
}

/// Visits what sample `i` of so many finds in a region.
pub(super) fn sample(
    kernel: &Kernel<'_>,
    region: &Region,
    (i, samples): (u32, u32),
    key: u64,
    rays: &mut u32,
    visit: &mut dyn FnMut(Vec3A, Rgb),
) {
    let per_block = per_block(samples);
    let n = per_block * BLOCKS;
    // Every so many samples, as many in each block; from places of a ball each time.
    let most = if region.is_single() { per_block } else { 1 };
    let step =
        (1..=most).rev().find(|s| per_block.is_multiple_of(*s) && n / s >= STRAIGHT.min(n)).unwrap_or(1);
    let mut sequence = Sequence::new(key, i);
    let [a, b, _, _] = sequence.next4();
    let straight = (i % step == 0).then_some(step as f32);
    let position = region.start(kernel, &mut sequence, rays);
    let from = Place { position, before: None, least: OFF * region.cell };
    kernel.sample_around(from, [a, b], straight, &mut sequence, rays, visit);
}

/// Gathers `samples` paths, rounded up to a multiple of 16, in a region. `of` are the numbers of the volume and the probe.
pub(super) fn gather(
    kernel: &Kernel<'_>,
    region: &Region,
    samples: u32,
    (key, of): (u64, (usize, u32)),
    monitor: &Monitor,
) -> Gathered {
    let per_block = per_block(samples);
    let n = per_block * BLOCKS;
    let bands = match kernel.finds_around() {
        Finds::Radiance => [1.0; 4],
        Finds::Irradiance => FROM_IRRADIANCE,
    };
    let mut sums = [[0.0f64; 3]; MOST_COEFFICIENTS];
    let mut means = Moments::default();
    let mut gate = Gate::default();
    let mut rays = 0;
    for block in 0..BLOCKS {
        let mut brightness = 0.0f64;
        for i in block * per_block..(block + 1) * per_block {
            let at = Rejected { page: of.0, texel: of.1, kind: Kind::Probe, sample: i };
            sample(kernel, region, (i, samples), key, &mut rays, &mut |wi: Vec3A, light: Rgb| {
                let light = gate.admit(light, at);
                if light == Vec3::ZERO {
                    return;
                }
                brightness += f64::from(luminance(light));
                let y: [f32; MOST_COEFFICIENTS] = real::first(wi.to_array());
                for (k, (sum, y)) in sums.iter_mut().zip(y).enumerate() {
                    let y = y * bands[k.isqrt()];
                    for (s, l) in sum.iter_mut().zip(light.to_array()) {
                        *s += f64::from(l * y);
                    }
                }
            });
        }
        means.push(brightness / f64::from(per_block) / (4.0 * std::f64::consts::PI));
    }
    monitor.report(&gate);
    monitor.add(u64::from(n), u64::from(rays));
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    Gathered {
        light: sums.map(|sum| sum.map(|s| (s / f64::from(n)) as f32)),
        std_err: means.std_err() as f32,
        gate,
    }
}
