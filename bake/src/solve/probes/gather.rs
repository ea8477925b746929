//! Follows a probe's paths.

use crate::geom::world::luminance;
use crate::sample::Sequence;
use crate::scene::model::Rgb;
use crate::solve::accumulate::{Gate, Rejected};
use crate::solve::monitor::Monitor;
use crate::transport::Kernel;
use crate::transport::around::Finds;
use glam::{Vec3, Vec3A};
use tables::harmonics::real;
use tables::num::moments::Moments;
use tables::probes::MOST_COEFFICIENTS;

/// Blocks of samples whose spread states the error.
const BLOCKS: u32 = 16;

/// Samples, about, that light straight from suns and lamps is part of: it has less noise than paths have.
const STRAIGHT: u32 = 64;

/// Irradiance over pi to radiance, band by band; irradiance has no third band.
const FROM_IRRADIANCE: [f32; 4] = [1.0, 1.5, 4.0, 0.0];

/// What a probe found.
#[derive(Clone, Debug)]
pub(super) struct Gathered {
    /// Radiance by coefficients of bands 0 to 3, nits.
    pub(super) light: [[f32; 3]; MOST_COEFFICIENTS],
    /// Of the mean luminance over all directions, nits.
    pub(super) std_err: f32,
    /// Samples that were not finite.
    pub(super) rejected: u64,
}

/// Gathers `samples` paths, rounded up to a multiple of 16, at a place in metres relative to the world's origin.
pub(super) fn gather(kernel: &Kernel<'_>, p: Vec3A, samples: u32, key: u64, monitor: &Monitor) -> Gathered {
    let per_block = samples.div_ceil(BLOCKS).max(1);
    let n = per_block * BLOCKS;
    // Every so many samples, as many in each block.
    let step =
        (1..=per_block).rev().find(|s| per_block.is_multiple_of(*s) && n / s >= STRAIGHT.min(n)).unwrap_or(1);
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
            let mut sequence = Sequence::new(key, i);
            let [a, b, _, _] = sequence.next4();
            let straight = (i % step == 0).then_some(step as f32);
            let at = Rejected { page: 0, texel: 0, sample: i };
            kernel.sample_around(
                (p, None),
                [a, b],
                straight,
                &mut sequence,
                &mut rays,
                &mut |wi: Vec3A, light: Rgb| {
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
                },
            );
        }
        means.push(brightness / f64::from(per_block) / (4.0 * std::f64::consts::PI));
    }
    monitor.add(u64::from(n), u64::from(rays));
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    Gathered {
        light: sums.map(|sum| sum.map(|s| (s / f64::from(n)) as f32)),
        std_err: means.std_err() as f32,
        rejected: gate.rejected,
    }
}
