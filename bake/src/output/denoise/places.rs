//! Where texels are in the world, and which others lie near one.

use super::walls::Walls;
use crate::geom::World;
use crate::geom::texel::{TexelMap, TexelSampler};
use crate::plan::Plan;
use crate::solve::Monitor;
use crate::solve::lightmap::{Solution, Texel};
use crate::solve::visible::Validity;
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;

/// Cosine between normals from which on texels do not see the same light any more: 26 degrees.
const LEAST_COSINE: f32 = 0.9;

/// Cells hold all texels within this many texels of one another in about one cell along each axis: most sums reach as far.
const CELL: f32 = 4.0;

/// Surfaces further apart than this part of a texel along their normals do not continue one another.
const MOST_GAP: f32 = 0.5;

/// Texels of a cell from which on they are parted into layers that do not know of one another. A surface has 32 in a cell; many more are
/// copies in the same place, or charts smaller than texels, and looking at every pair of them would take forever.
const CROWD: usize = 512;

/// Texels that count, sorted by where they are.
///
/// Only texels of about the same size are near one another: sizes within a factor of the root of two from a power of two
/// times the page's own form a class. Where something opaque stands between two texels, as a wall does on a floor that runs through below it,
/// they are not near one another.
#[derive(Debug, Default)]
pub(super) struct Places<'a> {
    /// Number of each texel in [`Solution::texels`].
    pub(super) texels: Vec<u32>,
    spots: Vec<Spot>,
    cells: Vec<Cell>,
    /// How many cells away a texel may look.
    most: u16,
    /// What stands between them.
    pub(super) walls: Walls,
    /// Who may stop the work.
    monitor: Option<&'a Monitor>,
}

/// One texel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// A point of its surface near its middle, metres.
    pub(super) position: Vec3,
    /// Unit normal of the side that is lit.
    pub(super) normal: Vec3,
    /// Texels per metre there.
    pub(super) density: f32,
    /// Counted over the page.
    chart: u32,
}

/// Texels within one cube.
#[derive(Clone, Copy, Debug)]
struct Cell {
    key: Key,
    first: u32,
}

/// Class of size, then z, y and x in sides of a cube.
type Key = [i32; 4];

impl<'a> Places<'a> {
    /// The valid texels of a page. Those that lie `reach` texels apart are near.
    pub(super) fn find(
        plan: &Plan,
        map: &TexelMap,
        solution: &Solution,
        reach: f32,
        monitor: &'a Monitor,
    ) -> Self {
        let (world, bvh) = (&plan.tracing().world, &plan.tracing().bvh);
        let nominal = plan.atlas().texels_per_metre;
        let spots: Vec<Option<(Key, Spot)>> = (0..solution.texels.len())
            .into_par_iter()
            .map_init(TexelSampler::default, |sampler, i| {
                let texel = &solution.texels[i];
                if texel.validity != Validity::Valid {
                    return None;
                }
                sampler.set(map, i);
                let chart = map.chart(plan.atlas(), map.triangles_of(i)[0]);
                let spot = Spot::new(world, map, sampler, texel, (nominal, chart))?;
                Some((spot.key(nominal), spot))
            })
            .collect();
        let mut places = Self { monitor: Some(monitor), ..Self::sorted(&spots, reach) };
        drop(spots);
        places.walls = Walls::find(&places, bvh, reach, world.radius);
        places
    }

    /// Places at the given points with the given normals, one texel a metre.
    #[cfg(test)]
    pub(super) fn at(spots: &[(Vec3, Vec3)], reach: f32) -> Self {
        let spots: Vec<Option<(Key, Spot)>> = spots
            .iter()
            .map(|&(position, normal)| {
                let spot = Spot { position, normal, density: 1.0, chart: 0 };
                Some((spot.key(1.0), spot))
            })
            .collect();
        Self::sorted(&spots, reach)
    }

    fn sorted(spots: &[Option<(Key, Spot)>], reach: f32) -> Self {
        let mut order: Vec<(Key, u32)> =
            (0u32..).zip(spots).filter_map(|(i, s)| s.as_ref().map(|(key, _)| (*key, i))).collect();
        order.par_sort_unstable();
        for crowd in order.chunk_by_mut(|a, b| a.0 == b.0).filter(|same| CROWD < same.len()) {
            let layers = (crowd.len() / CROWD + 1).next_power_of_two();
            for (key, i) in crowd {
                let chart = spots[*i as usize].map_or(0, |s| s.1.chart);
                key[0] = layer(key[0], layers, chart);
            }
        }
        order.par_sort_unstable();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few cells")]
        let most = (reach / CELL).ceil() as u16;
        let mut places = Self { most, ..Self::default() };
        for (n, &(key, i)) in (0u32..).zip(&order) {
            if places.cells.last().is_none_or(|c| c.key != key) {
                places.cells.push(Cell { key, first: n });
            }
            places.texels.push(i);
        }
        places.spots = order.iter().filter_map(|&(_, i)| spots[i as usize].map(|s| s.1)).collect();
        places
    }

    /// All of them.
    pub(super) fn spots(&self) -> &[Spot] {
        &self.spots
    }

    /// Whether somebody asks to stop.
    pub(super) fn stopped(&self) -> bool {
        self.monitor.is_some_and(Monitor::stopped)
    }

    /// Whether both are of one chart.
    pub(super) fn share_chart(&self, i: usize, j: usize) -> bool {
        self.spots[i].chart == self.spots[j].chart
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.spots.len()
    }

    /// Calls `f(place, what is near it)` for every place; the results are in the order of places.
    pub(super) fn map<T: Clone + Default + Send>(&self, f: impl Fn(usize, &Near<'_>) -> T + Sync) -> Vec<T> {
        let mut out = vec![T::default(); self.len()];
        let mut rest = out.as_mut_slice();
        let mut parts = Vec::with_capacity(self.cells.len());
        for c in 0..self.cells.len() {
            let (part, more) = rest.split_at_mut(self.range(c, c + 1).len());
            parts.push(part);
            rest = more;
        }
        parts.into_par_iter().enumerate().for_each(|(c, part)| {
            if self.stopped() {
                return;
            }
            let key = self.cells[c].key;
            let near = Near { places: self, rows: (1..=self.most).map(|n| self.rows(key, n)).collect() };
            for (i, out) in self.range(c, c + 1).zip(part) {
                *out = f(i, &near);
            }
        });
        out
    }

    /// Places of the cells from number `from` to before `to`.
    fn range(&self, from: usize, to: usize) -> Range<usize> {
        let first = |c: usize| self.cells.get(c).map_or(self.len(), |c| c.first as usize);
        first(from)..first(to)
    }

    /// The cell and those at most `away` cells from it, row by row: neighbours along x follow one another.
    fn rows(&self, [class, z, y, x]: Key, away: u16) -> Vec<Range<usize>> {
        let away = i32::from(away);
        let span = |c: i32| c.saturating_sub(away)..=c.saturating_add(away);
        let mut rows = Vec::new();
        for z in span(z) {
            for y in span(y) {
                let from = self.cells.partition_point(|c| c.key < [class, z, y, *span(x).start()]);
                let to = self.cells.partition_point(|c| c.key <= [class, z, y, *span(x).end()]);
                if from < to {
                    rows.push(self.range(from, to));
                }
            }
        }
        rows
    }
}

/// What lies around the places of one cell.
#[derive(Debug)]
pub(super) struct Near<'a> {
    places: &'a Places<'a>,
    /// Those at most one cell away, at most two, and so on.
    rows: Vec<Vec<Range<usize>>>,
}

impl Near<'_> {
    /// Calls `f(other, squared distance, weight)` for every other place within `radius` texels of place `i` whose surface
    /// continues that of `i`, always in the same order. The squared distance is in texels; the weight
    /// falls from 1 to 0 as the normals part. Both are the same to the bit seen from either place.
    #[inline]
    pub(super) fn each(&self, i: usize, radius: f32, mut f: impl FnMut(usize, f32, f32)) {
        let spots = &self.places.spots;
        let walls = &self.places.walls;
        let a = spots[i];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few cells")]
        let away = (radius / CELL).ceil() as usize;
        for row in self.rows.get(away.saturating_sub(1)).into_iter().flatten() {
            for (j, b) in row.clone().zip(&spots[row.clone()]) {
                let v = b.position - a.position;
                let scale = a.density * b.density;
                let squared = v.length_squared() * scale;
                if radius * radius <= squared || i == j {
                    continue;
                }
                let weight = (a.normal.dot(b.normal) - LEAST_COSINE) / (1.0 - LEAST_COSINE);
                // On a plane, and on an arc as well, the way to the other is at right angles to the sum of the normals.
                let gap = 0.5 * v.dot(a.normal + b.normal);
                let continues = 0.0 < weight && gap * gap * scale < MOST_GAP * MOST_GAP;
                if continues && !walls.part((i, &a), (j, b)) {
                    f(j, squared, weight.min(1.0));
                }
            }
        }
    }
}

impl Spot {
    /// `None` for a triangle without area, which gets no light.
    fn new(
        world: &World,
        map: &TexelMap,
        sampler: &TexelSampler,
        texel: &Texel,
        (nominal, chart): (f32, u32),
    ) -> Option<Self> {
        let on = sampler.sample([0.5; 2]);
        let at = world.point(on.triangle, on.bary);
        let normal = Vec3::from(at.shading_normal);
        let [a, b, c] = map.corners(on.triangle);
        let texels = 0.5 * (b - a).perp_dot(c - a).abs();
        let density = (texels / world.area(on.triangle)).sqrt();
        let density = if density.is_normal() { density } else { nominal };
        let fine = at.position.is_finite() && normal != Vec3::ZERO;
        fine.then_some(Self {
            position: at.position.into(),
            normal: if texel.turned() { -normal } else { normal },
            density,
            chart,
        })
    }

    fn key(&self, nominal: f32) -> Key {
        // Classes are an octave wide with the page's own density in the middle.
        let class = ((self.density / nominal).log2().round()).clamp(-60.0, 60.0);
        // The coarsest texel of the class decides.
        let side = CELL * std::f32::consts::SQRT_2 / (nominal * class.exp2());
        #[expect(clippy::cast_possible_truncation, reason = "a class is small, and cells far away saturate")]
        let key = [
            class as i32,
            cell(self.position.z / side),
            cell(self.position.y / side),
            cell(self.position.x / side),
        ];
        key
    }
}

/// The class of a texel in a cell of a crowd: charts stay together in one of so many layers.
fn layer(class: i32, layers: usize, chart: u32) -> i32 {
    let log = layers.ilog2().min(16);
    let layer = chart.wrapping_mul(0x9e37_79b9) >> 16 & ((1 << log) - 1);
    let low = (class + 64).cast_unsigned() & 0x7f;
    (1 << 30 | log << 24 | layer << 7 | low).cast_signed()
}

#[expect(clippy::cast_possible_truncation, reason = "cells far away saturate")]
fn cell(x: f32) -> i32 {
    x.floor() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is near each place, by number of texel.
    fn near(places: &Places, radius: f32) -> Vec<(u32, Vec<u32>)> {
        let lists = places.map(|i, near| {
            let mut list = Vec::new();
            near.each(i, radius, |j, _, _| list.push(places.texels[j]));
            list.sort_unstable();
            list
        });
        let mut all: Vec<(u32, Vec<u32>)> = places.texels.iter().copied().zip(lists).collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn every_pair_within_reach_is_found_and_no_other() {
        for reach in [4.0, 8.0] {
            pairs_are_found(reach);
        }
    }

    fn pairs_are_found(reach: f32) {
        let at = |i: u64| {
            let u = crate::sample::Sequence::new(crate::sample::sequence::key(3, 1, i), 0).next4();
            Vec3::new(u[0], 0.0, u[1]) * 30.0 - 15.0
        };
        let points: Vec<Vec3> = (0..500).map(at).collect();
        let spots: Vec<(Vec3, Vec3)> = points.iter().map(|&p| (p, Vec3::Y)).collect();
        for (i, list) in near(&Places::at(&spots, reach), reach) {
            let close =
                |&j: &u32| j != i && points[i as usize].distance_squared(points[j as usize]) < reach * reach;
            let want: Vec<u32> = (0..500).filter(close).collect();
            assert_eq!(list, want, "of {i}");
        }
    }

    /// Ten thousand copies of a patch of four texels: each knows all of its own chart, and of others no more than a few thousand.
    #[test]
    fn crowds_are_parted_by_charts() {
        let spots: Vec<Option<(Key, Spot)>> = (0..40_000u32)
            .map(|i| {
                let position = Vec3::new((i % 2) as f32, 0.0, (i / 2 % 2) as f32) + 1.0;
                let spot = Spot { position, normal: Vec3::Y, density: 1.0, chart: i / 4 };
                Some((spot.key(1.0), spot))
            })
            .collect();
        let places = Places::sorted(&spots, 4.0);
        let counts = places.map(|i, near| {
            let (mut own, mut others) = (0, 0);
            near.each(i, 4.0, |j, _, _| if places.share_chart(i, j) { own += 1 } else { others += 1 });
            (own, others)
        });
        assert!(
            counts.iter().all(|(own, others)| *own == 3 && *others < 3 * CROWD),
            "{:?}",
            counts.iter().max()
        );
    }

    #[test]
    fn surfaces_that_do_not_continue_one_another_are_not_near() {
        let (o, x) = (Vec3::ZERO, Vec3::X);
        let spots = [
            (o, Vec3::Y),
            // Its back, the floor below, the wall beside, and what continues it.
            (x, -Vec3::Y),
            (x - 0.6 * Vec3::Y, Vec3::Y),
            (x, -x),
            (x, Vec3::Y),
        ];
        assert_eq!(near(&Places::at(&spots, 4.0), 4.0)[0].1, [4]);
    }

    /// Texels on a cylinder of 12 texels radius: three of them lie 0.4 texels below the plane of the first.
    #[test]
    fn a_curve_continues() {
        let on = |k: f32| {
            let (s, c) = (k / 12.0).sin_cos();
            (12.0 * Vec3::new(s, c, 0.0), Vec3::new(s, c, 0.0))
        };
        let spots: Vec<_> = (0u8..8).map(|k| on(f32::from(k))).collect();
        assert_eq!(near(&Places::at(&spots, 8.0), 8.0)[0].1, [1, 2, 3, 4, 5]);
    }
}
