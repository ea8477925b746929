//! Moves probes out of walls and off surfaces.

use super::VALID;
use crate::solve::light_grid::directions;
use crate::solve::monitor::Monitor;
use crate::transport::Kernel;
use glam::Vec3A;
use std::sync::LazyLock;

/// Rays that look around from each probe.
const LOOKS: u32 = 32;

static DIRECTIONS: LazyLock<Vec<Vec3A>> = LazyLock::new(|| directions(LOOKS));

/// How far off surfaces probes keep, parts of a cell.
const CLEAR: f32 = 0.05;

/// How far a probe may be moved, parts of a cell.
const FAR: f32 = 1.0;

/// Rays start so far behind the place, parts of a cell.
const BACK: f32 = 1e-3;

/// Ways out of a wall that are tried.
const TRIES: usize = 6;

/// Walls that a probe is moved out of one after the other: those of a corner, and one more for ways that lead nowhere.
const WALLS: u32 = 4;

/// Where a probe came to lie.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settled {
    /// Metres relative to the world's origin.
    pub(super) place: Vec3A,
    /// See [`tables::probes::Probe::validity`].
    pub(super) validity: f32,
    pub(super) moved: bool,
}

/// What a place sees.
struct Around {
    validity: f32,
    /// Nearest surface that shows its front or both sides: direction and distance.
    nearest: Option<(Vec3A, f32)>,
    /// Places before the backs that were met, from the nearest on.
    ways_out: Vec<(f32, Vec3A)>,
}

fn look(kernel: &Kernel<'_>, p: Vec3A, reach: f32) -> Around {
    let mut around = Around { validity: 1.0, nearest: None, ways_out: Vec::new() };
    let mut backs = 0;
    // From a little behind, so that a surface that the place lies on is met on both sides.
    let back = BACK * reach;
    for d in DIRECTIONS.iter() {
        let Some(mut met) = kernel.meets(p - *d * back, *d) else { continue };
        met.distance = (met.distance - back).max(0.0);
        if met.front || met.double_sided {
            if around.nearest.is_none_or(|(_, t)| met.distance < t) {
                around.nearest = Some((*d, met.distance));
            }
        } else {
            backs += 1;
            if met.distance < FAR * reach {
                let out = p + *d * met.distance + met.normal * (CLEAR * reach);
                around.ways_out.push((met.distance, out));
            }
        }
    }
    around.ways_out.sort_by(|a, b| a.0.total_cmp(&b.0));
    around.validity = 1.0 - backs as f32 / LOOKS as f32;
    around
}

/// Whether a place, in metres relative to the world's origin, sees so many backs that it is in a wall or inside of a body. `reach`, metres, is about how far surfaces are.
#[must_use]
pub fn is_in_wall(kernel: &Kernel<'_>, p: Vec3A, reach: f32) -> bool {
    look(kernel, p, reach).validity < VALID
}

/// The place of a probe that the lattice wants at `p`, among cells `reach` metres wide.
pub(super) fn settle(kernel: &Kernel<'_>, p: Vec3A, reach: f32, monitor: &Monitor) -> Settled {
    let here = look(kernel, p, reach);
    let mut looks = 1;
    let mut settled = Settled { place: p, validity: here.validity, moved: false };
    if VALID <= here.validity {
        if let Some((d, t)) = here.nearest.filter(|(_, t)| *t < CLEAR * reach) {
            let off = p - d * (CLEAR * reach - t);
            looks += 1;
            let there = look(kernel, off, reach);
            let clearer = there.nearest.is_none_or(|(_, u)| t < u);
            if VALID <= there.validity && clearer && kernel.sees(p, off) {
                settled = Settled { place: off, validity: there.validity, moved: true };
            }
        }
    } else {
        // Out of an edge the way leads through one wall after the other.
        let mut from = here;
        for _ in 0..WALLS {
            let mut best: Option<(Vec3A, Around)> = None;
            for (_, out) in from.ways_out.iter().take(TRIES) {
                looks += 1;
                let there = look(kernel, *out, reach);
                if best.as_ref().is_none_or(|(_, b)| b.validity < there.validity) {
                    best = Some((*out, there));
                }
                if best.as_ref().is_some_and(|(_, b)| VALID <= b.validity) {
                    break;
                }
            }
            let Some((out, there)) = best.filter(|(out, _)| (*out - p).length() <= FAR * reach) else {
                break;
            };
            if VALID <= there.validity {
                settled = Settled { place: out, validity: there.validity, moved: true };
                break;
            }
            from = there;
        }
    }
    monitor.add(0, u64::from(looks * LOOKS));
    settled
}
