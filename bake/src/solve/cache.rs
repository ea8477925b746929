//! Fills the irradiance cache ([`crate::transport::cache`]).
//!
//! Cells are found by rays from the receivers, so they lie where paths will ask, and each keeps a few
//! of the points that were hit. Points of a cell that see one another share a value: those on two sides of a
//! thin wall do not. The first pass gathers whole paths there; each later pass gathers paths that
//! end at the pass before, which is unbiased but for the cells' size and averages the noise of many
//! cells. A place that has no cell is reached by a path that goes on.

use crate::error::Error;
use crate::geom::cells::POINTS;
use crate::geom::world::luminance;
use crate::geom::{Ray, cells};
use crate::sample::warp::{Frame, square_to_cos_hemisphere};
use crate::sample::{Sequence, sequence};
use crate::scene::model::Rgb;
use crate::solve::Monitor;
use crate::solve::accumulate::{Gate, Kind, Rejected};
use crate::solve::replay::Replayed;
use crate::transport::cache::{ABOVE, IrradianceCache, Record};
use crate::transport::encounter::Onward;
use crate::transport::{Estimate, Kernel, Vertex};
use glam::{DVec3, Vec3, Vec3A};
use rayon::prelude::*;

/// Random numbers of the cache belong to this domain; see [`sequence::key`].
const DOMAIN: u64 = 0x4943;

/// Paths from each cell in each pass, as parts of a texel's number of paths.
const PASSES: [f32; 3] = [0.25, 0.5, 1.0];

/// Fewest and most paths of a pass.
const PATHS: [f32; 2] = [16.0, 1024.0];

/// A point that a ray hit.
#[derive(Clone, Copy, Debug)]
struct Point {
    cell: u64,
    triangle: u32,
    bary: [f32; 2],
    front: bool,
    /// The first point of the same cell that sees this one, directly or by way of others.
    group: u8,
    /// Whether surfaces part the cell.
    parted: bool,
    /// How far from here its value holds, metres.
    reach: f32,
}

/// Places of a cache that is not filled yet.
#[derive(Clone, Debug)]
pub struct Cells {
    /// Side, metres.
    side: f32,
    /// Sorted by cell.
    points: Vec<Point>,
    samples: u32,
    seed: u64,
}

impl Cells {
    /// Finds cells for `receivers`; `texel_size` in metres, `samples` the paths of a texel.
    #[must_use]
    pub fn find(kernel: &Kernel<'_>, receivers: &[Vertex], texel_size: f32, samples: u32, seed: u64) -> Self {
        let side = cells::side(kernel.world, texel_size);
        let mut cells = Self { side, points: Vec::new(), samples, seed };
        if !receivers.is_empty() && 0.0 < side && side.is_finite() {
            cells.points = points(kernel, receivers, side, cells::search(kernel.world, texel_size), seed);
        }
        cells
    }

    /// The same places for texels of another number of paths.
    #[must_use]
    pub fn with_samples(self, samples: u32) -> Self {
        Self { samples, ..self }
    }

    fn list(&self) -> Vec<&[Point]> {
        self.points.chunk_by(|a, b| a.cell == b.cell).collect()
    }

    /// Paths of one pass from each cell.
    fn pass(&self, part: f32) -> u32 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let n = (part * self.samples as f32).clamp(PATHS[0], PATHS[1]) as u32;
        n
    }

    /// Paths that filling will take.
    #[must_use]
    pub fn paths(&self) -> u64 {
        let each: u32 = PASSES.iter().map(|&p| self.pass(p)).sum();
        self.list().len() as u64 * u64::from(each)
    }

    /// Fills the cells, and says which paths were not finite.
    ///
    /// # Errors
    ///
    /// [`Error::Interrupted`] when the monitor asks to stop.
    pub fn fill(&self, kernel: &Kernel<'_>, monitor: &Monitor) -> Result<(IrradianceCache, Gate), Error> {
        self.fill_by(PASSES.len(), kernel, monitor)
    }

    /// One path of a cell as a pass of [`Cells::fill`] takes it, which the passes before have to be filled for; `None` where there is none.
    ///
    /// # Errors
    ///
    /// As [`Cells::fill`].
    pub fn replay(
        &self,
        kernel: &Kernel<'_>,
        (pass, cell, sample): (usize, u32, u32),
        monitor: &Monitor,
    ) -> Result<Option<Replayed>, Error> {
        let cells = self.list();
        let Some(points) = cells.get(cell as usize) else { return Ok(None) };
        if PASSES.get(pass).is_none_or(|part| self.pass(*part) <= sample) {
            return Ok(None);
        }
        let (cache, _) = self.fill_by(pass, kernel, monitor)?;
        let kernel = Kernel { cache: (0 < pass).then_some(&cache), ..*kernel };
        let from = vertex(&kernel, &points[sample as usize % points.len()]);
        let e = path(&kernel, &from, self.key(pass, points), sample);
        Ok(Some(Replayed::at(kernel.world, from.position, from.geometric_normal).with(e)))
    }

    /// What the random numbers of a cell are drawn from.
    fn key(&self, pass: usize, cell: &[Point]) -> u64 {
        sequence::key(self.seed, DOMAIN + pass as u64, cell[0].cell)
    }

    /// The first passes of [`Cells::fill`].
    fn fill_by(
        &self,
        passes: usize,
        kernel: &Kernel<'_>,
        monitor: &Monitor,
    ) -> Result<(IrradianceCache, Gate), Error> {
        let cells = self.list();
        let records = self.points.iter().map(|p| Record {
            position: vertex(kernel, p).position.into(),
            reach: p.reach,
            value: Vec3::ZERO,
        });
        #[expect(clippy::cast_possible_truncation, reason = "a few points")]
        let sizes = cells.iter().map(|c| (c[0].cell, c.len() as u32, c[0].parted));
        let mut cache = IrradianceCache::new(self.side, sizes, records.collect());
        let mut gate = Gate::default();
        for (pass, part) in PASSES[..passes].iter().enumerate() {
            let n = self.pass(*part);
            let kernel = Kernel { cache: (0 < pass).then_some(&cache), ..*kernel };
            let mut values = vec![Vec3::ZERO; self.points.len()];
            let mut rest = values.as_mut_slice();
            let work: Vec<(&[Point], &mut [Rgb])> = cells
                .iter()
                .map(|cell| (*cell, rest.split_off_mut(..cell.len()).unwrap_or_default()))
                .collect();
            let gates: Vec<Gate> = work
                .into_par_iter()
                .enumerate()
                .map(|(number, (cell, values))| {
                    if monitor.stopped() {
                        return Gate::default();
                    }
                    #[expect(clippy::cast_possible_truncation, reason = "memory holds fewer cells")]
                    let at = Rejected { page: pass, texel: number as u32, kind: Kind::Cell, sample: 0 };
                    let (gate, rays) = gather(&kernel, cell, n, (self.key(pass, cell), at), values);
                    monitor.report(&gate);
                    monitor.add(u64::from(n), rays);
                    gate
                })
                .collect();
            gate = gates.into_iter().fold(gate, Gate::merge);
            cache.replace(&values);
        }
        if monitor.stopped() { Err(Error::Interrupted) } else { Ok((cache, gate)) }
    }
}

/// Where rays from the receivers land, sorted by cell; [`POINTS`] of each cell at most.
fn points(kernel: &Kernel<'_>, receivers: &[Vertex], cell: f32, rays: u64, seed: u64) -> Vec<Point> {
    #[expect(clippy::cast_possible_truncation, reason = "at most a million")]
    let each = rays.div_ceil(receivers.len() as u64) as u32;
    let mut points: Vec<Point> = receivers
        .par_iter()
        .enumerate()
        .flat_map_iter(|(i, from)| {
            let key = sequence::key(seed, DOMAIN ^ 0xffff, i as u64);
            (0..each).filter_map(move |k| land(kernel, from, &mut Sequence::new(key, k), cell))
        })
        .collect();
    // Stable: the points of a cell stay in the order of receivers and rays.
    points.sort_by_key(|p| p.cell);
    let mut here = 0;
    let mut last = None;
    points.retain(|p| {
        here = if last == Some(p.cell) { here + 1 } else { 0 };
        last = Some(p.cell);
        here < POINTS
    });
    points.shrink_to_fit();
    let cells: Vec<&mut [Point]> = points.chunk_by_mut(|a, b| a.cell == b.cell).collect();
    cells.into_par_iter().for_each(|points| group(kernel, points, cell, seed));
    points
}

/// Rays that look how near other surfaces are.
const LOOKS: u32 = 16;

/// How far from a point its irradiance is taken to hold, as a part of the harmonic mean of the distances of what it sees: its gradient
/// grows with the inverse of these (\[WRC88\], the split sphere).
const REACH: f32 = 0.5;

/// How far the value of a point holds, metres.
fn reach(kernel: &Kernel<'_>, p: &Point, seed: u64) -> f32 {
    let from = vertex(kernel, p);
    let frame = Frame::new(from.geometric_normal);
    let near: f32 = (0..LOOKS)
        .map(|k| {
            let [a, b, _, _] = Sequence::new(seed, k).next4();
            let wi = frame.to_world(square_to_cos_hemisphere([a, b]));
            kernel
                .closest(&from.ray(wi, f32::INFINITY))
                .map_or(0.0, |hit| hit.t.max(f32::MIN_POSITIVE).recip())
        })
        .sum();
    REACH * LOOKS as f32 / near
}

/// Finds which points of a cell see one another, and how far their values hold.
fn group(kernel: &Kernel<'_>, points: &mut [Point], cell: f32, seed: u64) {
    for (k, p) in points.iter_mut().enumerate() {
        p.reach = reach(kernel, p, sequence::key(seed, DOMAIN ^ 0xfffe, p.cell ^ k as u64));
    }
    let above: Vec<Vec3A> = points
        .iter()
        .map(|p| vertex(kernel, p))
        .map(|v| {
            let open = kernel.closest(&v.ray(v.geometric_normal, ABOVE * cell)).is_none();
            let height = if open { v.offset.max(ABOVE * cell) } else { v.offset };
            v.position + v.geometric_normal * height
        })
        .collect();
    for k in 0..points.len() {
        #[expect(clippy::cast_possible_truncation, reason = "a few points")]
        let own = k as u8;
        points[k].group = own;
        for j in 0..k {
            let (joined, d) = (points[j].group, above[j] - above[k]);
            let ray = Ray { origin: above[k], direction: d.normalize_or_zero(), t_max: d.length() };
            let far = points[k].reach.min(points[j].reach) < ray.t_max;
            if points[k].group == joined || far || kernel.blocked(&ray) {
                continue;
            }
            let (keep, drop) = (joined.min(points[k].group), joined.max(points[k].group));
            points[..=k].iter_mut().filter(|p| p.group == drop).for_each(|p| p.group = keep);
        }
    }
    // Other parts of the cell may hold none of its points.
    let parted = points.iter().any(|p| p.group != points[0].group)
        || points.iter().zip(&above).any(|(p, from)| {
            let frame = Frame::new(vertex(kernel, p).geometric_normal);
            [frame.x, -frame.x, frame.y, -frame.y]
                .into_iter()
                .any(|d| kernel.blocked(&Ray { origin: *from, direction: d, t_max: DIAGONAL * cell }))
        });
    points.iter_mut().for_each(|p| p.parted = parted);
}

/// No two places of a cell are further apart, sides.
const DIAGONAL: f32 = 1.732_050_8;

/// Where one ray is reflected.
fn land(kernel: &Kernel<'_>, from: &Vertex, sequence: &mut Sequence, cell: f32) -> Option<Point> {
    let [a, b, _, _] = sequence.next4();
    let wi = Frame::new(from.shading_normal).to_world(square_to_cos_hemisphere([a, b]));
    let hit = kernel.closest(&from.ray(wi, f32::INFINITY))?;
    let Onward::Reflected { vertex, reflectance } = kernel.encounter(&hit, wi).onward(sequence) else {
        return None;
    };
    let front = 0.0 < vertex.geometric_normal.dot(kernel.world.geometric_normal(hit.triangle));
    (luminance(reflectance) != 0.0).then(|| Point {
        cell: IrradianceCache::key(cell, vertex.position, vertex.geometric_normal),
        triangle: hit.triangle,
        bary: [hit.bary[0], hit.bary[1]],
        front,
        group: 0,
        parted: false,
        reach: 0.0,
    })
}

/// One path from a point of a cell.
fn path(kernel: &Kernel<'_>, from: &Vertex, key: u64, sample: u32) -> Estimate {
    let mut sequence = Sequence::new(key, sample);
    let [a, b, _, _] = sequence.next4();
    let mut few = 0;
    let lamps = kernel.lamps_now_and_then(from, &mut sequence, &mut few);
    let e = kernel.arriving(from, [a, b], &mut sequence);
    Estimate { indirect: e.indirect + lamps, rays: e.rays + few, ..e }
}

/// For each of the points of a cell the mean over paths from its group; the points share `n` paths, of which `at` is the first. Returns what was left out
/// and the number of rays.
fn gather(
    kernel: &Kernel<'_>,
    points: &[Point],
    n: u32,
    (key, at): (u64, Rejected),
    values: &mut [Rgb],
) -> (Gate, u64) {
    let vertices: Vec<Vertex> = points.iter().map(|p| vertex(kernel, p)).collect();
    let mut sums = [(DVec3::ZERO, 0.0); POINTS];
    let (mut gate, mut rays) = (Gate::default(), 0);
    for i in 0..n {
        let k = i as usize % points.len();
        let e = path(kernel, &vertices[k], key, i);
        rays += u64::from(e.rays);
        let x = gate.admit(e.direct + e.indirect, Rejected { sample: i, ..at });
        let group = &mut sums[usize::from(points[k].group)];
        group.0 += x.as_dvec3();
        group.1 += 1.0;
    }
    let mean = |(sum, n): (DVec3, f64)| (sum / n.max(1.0)).as_vec3();
    for (value, p) in values.iter_mut().zip(points) {
        *value = mean(sums[usize::from(p.group)]);
    }
    (gate, rays)
}

fn vertex(kernel: &Kernel<'_>, p: &Point) -> Vertex {
    let bary = [p.bary[0], p.bary[1], 1.0 - p.bary[0] - p.bary[1]];
    let at = kernel.world.point(p.triangle, bary);
    let front = Vertex::front(&at);
    debug_assert!(at.geometric_normal != Vec3A::ZERO, "rays do not hit triangles without area");
    if p.front { front } else { front.turned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The plan states memory without knowing this module.
    #[test]
    fn the_plan_knows_the_size_of_a_point() {
        assert_eq!(size_of::<Point>() as u64, crate::plan::memory::PER_CACHE_POINT);
    }
}
