//! Irradiance at given points and normals, to a wanted error.

use crate::error::Error;
use crate::geom::Ray;
use crate::geom::ray::offset_distance;
use crate::sample::{Sequence, sequence};
use crate::scene::model::Rgb;
use crate::solve::accumulate::{Gate, Kind, Rejected};
use crate::solve::monitor::Monitor;
use crate::solve::replay::Replayed;
use crate::transport::{Estimate, Kernel, Vertex};
use glam::{DVec3, Vec3, Vec3A};
use rayon::prelude::*;
use std::f32::consts::PI;
use tables::num::moments::Moments;

/// Random numbers of points belong to this domain; see [`sequence::key`].
const DOMAIN: u64 = 0x5054;

/// Paths in one batch. Every batch has its own scramble, so batch means are independent and their
/// spread states the error without bias.
const BATCH: u32 = 256;

/// Batches before the error is judged for the first time: with fewer the judgement itself is noise.
const FIRST_BATCHES: u32 = 32;

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// Exactly this many paths per point, rounded up to whole batches of at most 256.
    Samples(u32),
    /// Until the standard error of every channel is below this part of the point's value, or
    /// `most` paths.
    Error {
        /// Relative standard error.
        relative: f32,
        /// Paths per point at most.
        most: u32,
    },
}

impl Until {
    /// Batches before the error is judged, and paths in each.
    fn batches(self) -> (u32, u32) {
        match self {
            Self::Samples(n) => {
                // At least two batches, so that there is an error to state.
                let batches = n.div_ceil(BATCH).max(n.min(16)).max(1);
                (batches, n.div_ceil(batches))
            }
            Self::Error { .. } => (FIRST_BATCHES, BATCH),
        }
    }
}

/// Irradiance at a point.
#[derive(Clone, Copy, Debug, Default)]
pub struct PointResult {
    /// `E`, lux.
    pub irradiance: Rgb,
    /// Its standard error, lux.
    pub std_err: Rgb,
    /// Paths spent.
    pub paths: u64,
    /// Whether the wanted error was reached.
    pub reached: bool,
}

/// Gathers at each (position, unit normal), in metres of the file.
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn gather(
    kernel: &Kernel<'_>,
    points: &[(Vec3, Vec3)],
    until: Until,
    seed: u64,
    monitor: &Monitor,
) -> Result<(Vec<PointResult>, Gate), Error> {
    let mut results = Vec::with_capacity(points.len());
    let mut gate = Gate::default();
    for (index, &(position, normal)) in points.iter().enumerate() {
        let vertex = place(kernel, position, normal);
        let (result, g) = point(kernel, &vertex, index, until, seed, monitor)?;
        results.push(result);
        gate = gate.merge(g);
    }
    Ok((results, gate))
}

/// Finds how far rays have to start off the surface that the point lies on.
///
/// The point itself is used as given. What its surface's rounding amounts to is a matter of that
/// surface's size, which a short ray backwards finds; in free air the point's own coordinates count.
#[must_use]
pub fn place(kernel: &Kernel<'_>, position: Vec3, normal: Vec3) -> Vertex {
    let p = Vec3A::from(position - kernel.world.origin);
    let n = Vec3A::from(normal);
    let reach = kernel.world.radius * (1.0 / 1024.0);
    let back = Ray { origin: p + n * reach, direction: -n, t_max: 1.5 * reach };
    let own = offset_distance(p.abs().max_element());
    let on_surface = kernel.closest(&back).and_then(|hit| {
        let at = kernel.world.point(hit.triangle, hit.bary);
        ((hit.t - reach).abs() <= 2.0 * (at.offset + own)).then_some(at.offset)
    });
    Vertex {
        position: p,
        geometric_normal: n,
        shading_normal: n,
        offset: on_surface.map_or(own, |offset| offset.max(own)),
        open: false,
        detached: on_surface.is_none(),
    }
}

fn point(
    kernel: &Kernel<'_>,
    vertex: &Vertex,
    index: usize,
    until: Until,
    seed: u64,
    monitor: &Monitor,
) -> Result<(PointResult, Gate), Error> {
    let (first, size) = until.batches();
    let (most, relative) = match until {
        Until::Samples(_) => (first, 0.0),
        Until::Error { relative, most } => (most.div_ceil(BATCH).max(FIRST_BATCHES), relative),
    };
    let mut channels = [Moments::default(); 3];
    let mut gate = Gate::default();
    let mut done = 0;
    let mut target = first;
    loop {
        let batches: Vec<(DVec3, Gate)> = (done..target)
            .into_par_iter()
            .map(|b| batch(kernel, vertex, index, b, size, seed, monitor))
            .collect();
        if monitor.stopped() {
            return Err(Error::Interrupted);
        }
        for (mean, g) in batches {
            for (c, m) in channels.iter_mut().zip(mean.to_array()) {
                c.push(m);
            }
            gate = gate.merge(g);
        }
        done = target;
        let reached = channels.iter().all(|c| c.std_err() <= f64::from(relative) * c.mean.abs());
        if reached || most <= done {
            let vector = |f: fn(&Moments) -> f64| DVec3::from(channels.each_ref().map(f)).as_vec3() * PI;
            let result = PointResult {
                irradiance: vector(|c| c.mean),
                std_err: vector(Moments::std_err),
                paths: u64::from(done) * u64::from(size),
                reached: reached || relative == 0.0,
            };
            return Ok((result, gate));
        }
        target = (done + done / 2).min(most);
    }
}

fn batch(
    kernel: &Kernel<'_>,
    vertex: &Vertex,
    index: usize,
    batch: u32,
    size: u32,
    seed: u64,
    monitor: &Monitor,
) -> (DVec3, Gate) {
    let mut gate = Gate::default();
    let mut sum = DVec3::ZERO;
    if monitor.stopped() {
        return (sum, gate);
    }
    let mut rays = 0;
    for i in 0..size {
        let e = sample(kernel, vertex, (index, batch, i), seed);
        rays += u64::from(e.rays);
        #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 points fit into memory")]
        let at = Rejected { page: 0, texel: index as u32, kind: Kind::Point, sample: batch * size + i };
        sum += gate.admit(e.direct + e.indirect, at).as_dvec3();
    }
    monitor.add(u64::from(size), rays);
    (sum / f64::from(size), gate)
}

/// Sample `i` of a batch of a point.
fn sample(kernel: &Kernel<'_>, vertex: &Vertex, (index, batch, i): (usize, u32, u32), seed: u64) -> Estimate {
    let key = sequence::key(sequence::key(seed, DOMAIN, index as u64), DOMAIN, u64::from(batch));
    let mut sequence = Sequence::new(key, i);
    let [_, _, c, d] = sequence.next4();
    kernel.estimate(vertex, [c, d], &mut sequence)
}

/// One sample of point number `index` as [`gather`] takes it.
#[must_use]
pub fn replay(
    kernel: &Kernel<'_>,
    (position, normal): (Vec3, Vec3),
    index: usize,
    until: Until,
    seed: u64,
    number: u32,
) -> Replayed {
    let vertex = place(kernel, position, normal);
    let (_, size) = until.batches();
    let e = sample(kernel, &vertex, (index, number / size, number % size), seed);
    Replayed::at(kernel.world, vertex.position, vertex.geometric_normal).with(e)
}
