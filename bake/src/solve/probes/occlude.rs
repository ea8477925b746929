//! Which probes see which part of the cells that surfaces pass through.
//!
//! Places all over a cell, and on both sides of the surfaces in it, are asked which of the eight probes around they see. Of the planes of these
//! surfaces those are kept, up to four, that explain the answers best: each in turn is the one that leaves the least variance within the regions
//! that all chosen ones make. A wall that parts a cell so becomes one plane whose sides see different probes, at any thickness and
//! without the soft edge that mean distances have (\[MMNL17\] McGuire, Mara, Nowrouzezahrai & Luebke, "Real-Time Global Illumination using Precomputed Light
//! Field Probes", I3D 2017, whose moments of distance by direction leak most where walls are seen at a slant).

use super::settle::Settled;
use super::{Layout, VALID};
use crate::error::Error;
use crate::geom::voxels::{clip_to_cube, touched};
use crate::sample::sequence::{Sequence, key};
use crate::solve::light_grid::directions;
use crate::solve::monitor::Monitor;
use crate::transport::Kernel;
use glam::{UVec3, Vec3A};
use rayon::prelude::*;
use std::sync::LazyLock;
use tables::probes::{Brick, CELLS, CORNERS, NODES, NONE, Occlusion, PLANES, REGIONS};

/// Places along a cell's side that are asked.
const GRID: u32 = 3;

/// How far before and behind surfaces places are asked, parts of a cell.
const NEAR: f32 = 0.01;

/// How far off a place may be along a plane to be in it, parts of a cell; and how much normals may differ.
const SAME: f32 = 0.004;

/// See [`SAME`].
const SAME_NORMAL: f32 = 0.9995;

/// Planes of a cell that may be chosen, those with most area.
const CANDIDATES: usize = 16;

/// Polygons of each, those with most area, beside which places are asked.
const POLYGONS: usize = 2;

/// Rays that tell whether a place is in a wall.
const LOOKS: u32 = 8;

static DIRECTIONS: LazyLock<Vec<Vec3A>> = LazyLock::new(|| directions(LOOKS));

/// A plane has to explain at least as much as one answer.
const LEAST_GAIN: f32 = 0.5;

/// Cells of one brick.
pub(super) struct Cells {
    /// Their numbers and what is known of them.
    pub(super) list: Vec<(usize, Cell)>,
}

/// One cell.
pub(super) struct Cell {
    /// Without numbers of own probes.
    pub(super) occlusion: Occlusion,
    /// Places of own probes, metres relative to the world's origin.
    pub(super) own: [Option<Vec3A>; REGIONS],
}

/// Asks in all cells that need it, brick by brick.
pub(super) fn occlude(
    kernel: &Kernel<'_>,
    layout: &Layout,
    settled: &[Settled],
    monitor: &Monitor,
) -> Result<Vec<Cells>, Error> {
    let all = layout
        .bricks
        .par_iter()
        .zip(&layout.triangles)
        .map(|(brick, triangles)| {
            if monitor.stopped() {
                return Cells { list: Vec::new() };
            }
            let mut within: Vec<Vec<u32>> = vec![Vec::new(); CELLS * CELLS * CELLS];
            let side = layout.spacing * (1u32 << brick.level) as f32;
            let first = layout.place(brick.corner.into());
            for t in triangles {
                let corners = kernel.world.corners(*t).map(|c| (Vec3A::from(c) - first) / side);
                #[expect(clippy::cast_possible_truncation, reason = "four")]
                touched(corners, UVec3::splat(CELLS as u32), |c| within[flat(c, CELLS)].push(*t));
            }
            let mut list = Vec::new();
            for (slot, triangles) in within.iter().enumerate() {
                let at = unflat(slot);
                let corners: [Settled; CORNERS] = std::array::from_fn(|k| {
                    let far = UVec3::new(bit(k, 0), bit(k, 1), bit(k, 2));
                    settled[brick.probes[flat(at + far, NODES)] as usize]
                });
                let plain = triangles.is_empty() && corners.iter().all(|c| !c.moved && VALID <= c.validity);
                if plain {
                    continue;
                }
                let min = first + at.as_vec3a() * side;
                let asked = Asked { kernel, layout, min, side, corners: &corners, triangles };
                list.extend(asked.cell(brick, slot, monitor).map(|cell| (slot, cell)));
            }
            Cells { list }
        })
        .collect();
    if monitor.stopped() { Err(Error::Interrupted) } else { Ok(all) }
}

fn bit(k: usize, axis: u32) -> u32 {
    u32::from(k >> axis & 1 == 1)
}

fn flat(c: UVec3, n: usize) -> usize {
    (c.z as usize * n + c.y as usize) * n + c.x as usize
}

#[expect(clippy::cast_possible_truncation, reason = "below 64")]
fn unflat(slot: usize) -> UVec3 {
    let n = CELLS;
    UVec3::new((slot % n) as u32, (slot / n % n) as u32, (slot / n / n) as u32)
}

/// A plane, and the largest polygons of surfaces that lie in it.
struct Plane {
    normal: Vec3A,
    /// n . p, relative to the world's origin.
    distance: f32,
    area: f32,
    polygons: Vec<(f32, Vec<Vec3A>)>,
}

/// A place that was asked.
struct Answer {
    place: Vec3A,
    sees: [bool; CORNERS],
    /// Distance of the nearest surface that was met.
    clear: f32,
}

struct Asked<'a> {
    kernel: &'a Kernel<'a>,
    layout: &'a Layout,
    min: Vec3A,
    side: f32,
    corners: &'a [Settled; CORNERS],
    triangles: &'a [u32],
}

impl Asked<'_> {
    /// `None` if all of it sees all probes.
    fn cell(&self, brick: &Brick, slot: usize, monitor: &Monitor) -> Option<Cell> {
        let planes = self.planes();
        let answers = self.answers(&planes, brick, slot);
        let asked = answers.iter().flatten().count() as u64;
        monitor.add(0, answers.len() as u64 * u64::from(LOOKS) + asked * CORNERS as u64);
        let answers: Vec<Answer> = answers.into_iter().flatten().collect();
        if !answers.is_empty() && answers.iter().all(|a| a.sees == [true; CORNERS]) {
            return None;
        }
        let mut chosen: Vec<&Plane> = Vec::new();
        let mut regions: Vec<usize> = vec![0; answers.len()];
        let mut spread = variance(&answers, &regions);
        while chosen.len() < PLANES && LEAST_GAIN < spread {
            let with = |plane: &Plane| -> Vec<usize> {
                let side = |a: &Answer| usize::from(plane.distance < plane.normal.dot(a.place));
                answers.iter().zip(&regions).map(|(a, r)| r | side(a) << chosen.len()).collect()
            };
            let best = planes
                .iter()
                .map(|p| (p, with(p)))
                .map(|(p, r)| (variance(&answers, &r), p, r))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((left, plane, parted)) = best.filter(|b| b.0 + LEAST_GAIN <= spread) else { break };
            chosen.push(plane);
            (spread, regions) = (left, parted);
        }
        Some(self.weigh(&chosen, &answers, &regions))
    }

    /// Planes of the surfaces in the cell, those with most area first.
    fn planes(&self) -> Vec<Plane> {
        let mut planes: Vec<Plane> = Vec::new();
        for t in self.triangles {
            let polygon = clip_to_cube(self.kernel.world.corners(*t).map(Vec3A::from), self.min, self.side);
            let normal = self.kernel.world.geometric_normal(*t);
            let area: f32 = (1..polygon.len().max(2) - 1)
                .map(|i| (polygon[i] - polygon[0]).cross(polygon[i + 1] - polygon[0]).length())
                .sum();
            if area <= 0.0 || normal == Vec3A::ZERO {
                continue;
            }
            let distance = normal.dot(polygon[0]);
            let same = planes.iter_mut().find(|p| {
                let cos = p.normal.dot(normal);
                SAME_NORMAL < cos.abs()
                    && polygon.iter().all(|v| (p.normal.dot(*v) - p.distance).abs() < SAME * self.side)
            });
            match same {
                Some(p) => {
                    p.area += area;
                    p.polygons.push((area, polygon));
                }
                None => planes.push(Plane { normal, distance, area, polygons: vec![(area, polygon)] }),
            }
        }
        planes.sort_by(|a, b| b.area.total_cmp(&a.area));
        planes.truncate(CANDIDATES);
        for p in &mut planes {
            p.polygons.sort_by(|a, b| b.0.total_cmp(&a.0));
            p.polygons.truncate(POLYGONS);
        }
        planes
    }

    /// Asks places all over the cell and beside its surfaces; `None` for those in walls.
    fn answers(&self, planes: &[Plane], brick: &Brick, slot: usize) -> Vec<Option<Answer>> {
        let mut places = Vec::new();
        let cell = key(u64::from(brick.level), u64::from(brick.corner[0]), slot as u64);
        let cell = key(cell, u64::from(brick.corner[1]), u64::from(brick.corner[2]));
        for i in 0..GRID.pow(3) {
            let [a, b, c, _] = Sequence::hashed(cell, i).next4();
            let at = UVec3::new(i % GRID, i / GRID % GRID, i / (GRID * GRID)).as_vec3a();
            places.push(self.min + (at + Vec3A::new(a, b, c)) * (self.side / GRID as f32));
        }
        let end = self.min + self.side;
        for p in planes {
            let off = p.normal * (NEAR * self.side);
            for (_, polygon) in &p.polygons {
                let centre = polygon.iter().copied().sum::<Vec3A>() / polygon.len() as f32;
                let towards = polygon.iter().map(|v| centre.lerp(*v, 0.85));
                for on in std::iter::once(centre).chain(towards) {
                    places.extend([on + off, on - off].map(|p| p.clamp(self.min, end)));
                }
            }
        }
        places.into_iter().map(|place| self.answer(place)).collect()
    }

    fn answer(&self, place: Vec3A) -> Option<Answer> {
        let (mut backs, mut clear) = (0, f32::INFINITY);
        for d in DIRECTIONS.iter() {
            let Some(met) = self.kernel.meets(place, *d) else { continue };
            clear = clear.min(met.distance);
            backs += u32::from(!met.front && !met.double_sided);
        }
        if 1.0 - backs as f32 / (LOOKS as f32) < VALID {
            return None;
        }
        // A little beyond, so that a probe on a surface is seen from neither side.
        let beyond = |to: Vec3A| to + (to - place).normalize_or_zero() * (NEAR * self.side);
        let sees = |c: &Settled| VALID <= c.validity && self.kernel.sees(place, beyond(c.place));
        Some(Answer { place, sees: self.corners.each_ref().map(sees), clear })
    }

    /// What the regions see.
    fn weigh(&self, chosen: &[&Plane], answers: &[Answer], regions: &[usize]) -> Cell {
        let mut planes = [[0.0; 4]; PLANES];
        for (to, p) in planes.iter_mut().zip(chosen) {
            let [x, y, z] = p.normal.to_array();
            *to = [x, y, z, p.distance - p.normal.dot(self.layout.origin)];
        }
        let n = 1 << chosen.len();
        let mut weights: [Option<[u8; CORNERS]>; REGIONS] = [None; REGIONS];
        let mut own = [None; REGIONS];
        for (region, weight) in weights.iter_mut().enumerate().take(n) {
            let here: Vec<&Answer> =
                answers.iter().zip(regions).filter(|(_, r)| **r == region).map(|(a, _)| a).collect();
            if here.is_empty() {
                continue;
            }
            let seen = std::array::from_fn(|k| {
                let part = here.iter().filter(|a| a.sees[k]).count() as f32 / here.len() as f32;
                // What little of a region sees counts for less, so that it brings less to where it is not seen.
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 255")]
                let weight = (255.0 * part * part).round() as u8;
                weight
            });
            *weight = Some(seen);
            if seen == [0; CORNERS] {
                let best = here.iter().max_by(|a, b| a.clear.total_cmp(&b.clear));
                own[region] = best.map(|a| a.place);
            }
        }
        let known = weights;
        let known_own = own;
        // What no place answered for sees no more than the regions beside it do.
        for (region, weight) in weights.iter_mut().enumerate().take(n) {
            if weight.is_some() {
                continue;
            }
            let beside: Vec<usize> =
                (0..chosen.len()).map(|k| region ^ 1 << k).filter(|r| known[*r].is_some()).collect();
            let least = beside
                .iter()
                .filter_map(|r| known[*r])
                .reduce(|a, b| std::array::from_fn(|k| a[k].min(b[k])))
                .filter(|w| *w != [0; CORNERS]);
            if least.is_none() {
                // They agree on nothing: planes are in the order of what they part, so the last of them matters least.
                own[region] = beside.iter().rev().find_map(|r| known_own[*r]);
            }
            // The region that is on the same side of as many of the first planes as any.
            let nearest = || {
                let seen = |r: &usize| known[*r].is_some_and(|w| w != [0; CORNERS]);
                let r = (0..n).filter(seen).max_by_key(|r| (r ^ region).trailing_zeros())?;
                known[r]
            };
            *weight = least.or_else(nearest);
        }
        // Nothing but walls: whatever there is.
        let valid = self.corners.map(|c| if VALID <= c.validity { 255 } else { 0 });
        let any = if valid == [0; CORNERS] { [255; CORNERS] } else { valid };
        let weights = std::array::from_fn(|r| weights[r & (n - 1)].unwrap_or(any));
        Cell { occlusion: Occlusion { planes, weights, own: [NONE; REGIONS] }, own }
    }
}

/// Sum over regions and probes of n p (1 - p), p being the part of the region's places that see the probe.
fn variance(answers: &[Answer], regions: &[usize]) -> f32 {
    let mut seen = [[0u32; CORNERS]; REGIONS];
    let mut n = [0u32; REGIONS];
    for (a, r) in answers.iter().zip(regions) {
        n[*r] += 1;
        for (s, sees) in seen[*r].iter_mut().zip(a.sees) {
            *s += u32::from(sees);
        }
    }
    let of = |s: u32, n: u32| if n == 0 { 0.0 } else { s as f32 * (1.0 - s as f32 / n as f32) };
    seen.iter().zip(n).flat_map(|(s, n)| s.iter().map(move |s| of(*s, n))).sum()
}
