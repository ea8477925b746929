//! The texels of one page.

use crate::error::Error;
use crate::geom::atlas::Atlas;
use crate::geom::texel::{TexelMap, TexelSampler};
use crate::geom::world::luminance;
use crate::sample::{Sequence, sequence};
use crate::scene::model::Rgb;
use crate::solve::accumulate::{Gate, Rejected, mean_and_error};
use crate::solve::monitor::{ErrorSums, Monitor};
use crate::transport::path::First;
use crate::transport::{Kernel, Vertex};
use glam::{Vec3, Vec3A};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::ops::Range;

/// Texels that one task does: enough to make scheduling free, few enough to share the work evenly
/// and to stop quickly.
const CHUNK: usize = 32;

/// Most such tasks that a thread takes in one piece. A piece that was begun cannot be shared, and
/// left to itself the scheduler begins pieces of up to a quarter of a page, so that at the end one thread
/// works while the others wait.
const CHUNKS: usize = 16;

/// Random numbers of lightmaps belong to this domain and the page; see [`sequence::key`].
const DOMAIN: u64 = 0x4c4d;

/// Those of the rays that look around from a texel.
const PROBE: u64 = 0x4c50;

/// What one texel received.
#[derive(Clone, Copy, Debug, Default)]
pub struct Texel {
    /// `E / pi` straight from lights, nits.
    pub direct: Rgb,
    /// `E / pi` after at least one reflection, nits.
    pub indirect: Rgb,
    /// Standard error of their sum, nits.
    pub std_err: Rgb,
    /// Part of the texel's square that its chart covers.
    pub coverage: f32,
    /// Whether the texel can be seen.
    pub validity: Validity,
    /// Which parts of the texel are gathered.
    cells: Cells,
    /// Which side is gathered.
    side: Side,
    /// Paths gathered.
    pub paths: u32,
}

/// Whether a texel lies in the open or inside other geometry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Validity {
    /// In the open, at least in part; hidden parts are left out of the mean.
    #[default]
    Valid,
    /// Wholly behind the back of a one-sided surface.
    Hidden,
    /// Black, and nothing but backs of double-sided surfaces around it: probably the inside of a body.
    Enclosed,
}

/// How much is gathered, and how.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Paths per texel.
    pub samples: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Side of a typical texel, metres.
    pub texel_size: f32,
}

/// Cavities narrower than this many texels are cracks between parts of one body.
const CRACK: f32 = 2.0;

/// What [`bake_page`] found.
#[derive(Clone, Debug, Default)]
pub struct Solution {
    /// One entry for each covered texel, in the order of [`TexelMap::texels`].
    pub texels: Vec<Texel>,
    /// Samples that were not finite.
    pub gate: Gate,
    /// Mean paths per covered texel after each round, where rounds were planned by them.
    pub rounds: Vec<f32>,
}

impl Solution {
    /// Paths of all texels together, fewest and most.
    #[must_use]
    pub fn paths(&self) -> (u64, u64, u64) {
        let each = || self.texels.iter().map(|t| u64::from(t.paths));
        (each().sum(), each().min().unwrap_or(0), each().max().unwrap_or(0))
    }
}

/// Gathers paths in each covered texel of a page. The charts in `turned` show their backs; see
/// [`crate::solve::facing`].
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn bake_page(
    kernel: &Kernel<'_>,
    atlas: &Atlas,
    map: &TexelMap,
    page: usize,
    Effort { samples, seed, texel_size }: Effort,
    turned: &BTreeSet<u32>,
    monitor: &Monitor,
) -> Result<Solution, Error> {
    let crack = CRACK * texel_size;
    let n = map.texels.len();
    let mut texels = vec![Texel::default(); n];
    let gates: Vec<Gate> = texels
        .par_chunks_mut(CHUNK)
        .enumerate()
        .with_max_len(CHUNKS)
        .map_init(
            || (Vec::with_capacity(samples as usize), None),
            |(scratch, sampler), (chunk, out)| {
                let mut gate = Gate::default();
                let mut rays = 0;
                for (k, out) in out.iter_mut().enumerate() {
                    if monitor.stopped() {
                        return gate;
                    }
                    let index = chunk * CHUNK + k;
                    let sampler = match sampler {
                        Some(s) => {
                            TexelSampler::set(s, map, index);
                            s
                        }
                        None => sampler.insert(TexelSampler::new(map, index)),
                    };
                    let id = Id { page, texel: map.texels[index], seed, crack };
                    let chart = map.chart(atlas, map.triangles_of(index)[0]);
                    let side = if turned.contains(&chart) { Side::BackOfDoubleSided } else { Side::Front };
                    *out = texel(kernel, sampler, id, side, samples, scratch, &mut gate, &mut rays);
                }
                monitor.add_error(error_sums(out));
                monitor.add(out.len() as u64 * u64::from(samples), rays);
                gate
            },
        )
        .collect();
    if monitor.stopped() {
        return Err(Error::Interrupted);
    }
    let gate = gates.into_iter().fold(Gate::default(), Gate::merge);
    Ok(Solution { texels, gate, rounds: Vec::new() })
}

/// What the progress display wants to know of finished texels.
fn error_sums(texels: &[Texel]) -> ErrorSums {
    let mut sums = ErrorSums::default();
    for t in texels {
        let e = f64::from(luminance(t.std_err));
        sums.squared_error += e * e;
        sums.luminance += f64::from(luminance(t.direct + t.indirect));
        sums.n += 1.0;
    }
    sums
}

/// Which texel, for random numbers and messages.
#[derive(Clone, Copy)]
struct Id {
    page: usize,
    texel: u32,
    seed: u64,
    /// Metres; see [`Sample::crack`].
    crack: f32,
}

/// One path's result.
struct Sample {
    direct: Rgb,
    indirect: Rgb,
}

#[expect(clippy::too_many_arguments, reason = "one step of the loop over texels")]
fn texel(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    id: Id,
    mut side: Side,
    n: u32,
    scratch: &mut Vec<Sample>,
    gate: &mut Gate,
    rays: &mut u64,
) -> Texel {
    let coverage = sampler.coverage();
    let mut visible = probe(kernel, sampler, id, side, rays);
    gather(kernel, sampler, id, 0..n, side, visible.cells, scratch, gate, rays);
    let dark = |scratch: &mut Vec<Sample>, gate: &mut Gate, rays: &mut u64| {
        // Few paths that bring nothing prove little, so some more are asked before a texel is dark.
        let mut more = Vec::new();
        !scratch.is_empty() && scratch.iter().all(is_dark) && {
            gather(kernel, sampler, id, n..n.max(DARK), Side::Front, visible.cells, &mut more, gate, rays);
            more.iter().all(is_dark)
        }
    };
    if side == Side::Front && dark(scratch, gate, rays) {
        // A sheet that shows its back to the room, as many files have them: where it is double-sided and
        // no light reaches its front, the light of its back is what anybody will see.
        let back = probe(kernel, sampler, id, Side::BackOfDoubleSided, rays);
        let front = std::mem::take(scratch);
        gather(kernel, sampler, id, 0..n, Side::BackOfDoubleSided, back.cells, scratch, gate, rays);
        if scratch.iter().all(is_dark) {
            *scratch = front;
        } else {
            (visible, side) = (back, Side::BackOfDoubleSided);
        }
    }
    if scratch.is_empty() {
        // The triangle has no area in the world: there is nothing to light.
        return Texel { coverage, validity: Validity::Hidden, ..Texel::default() };
    }
    let validity = match visible.validity {
        // Only what is dark can be the inside of a body: light finds its way under a tent.
        Validity::Valid if visible.inside && scratch.iter().all(is_dark) => Validity::Enclosed,
        Validity::Enclosed if !scratch.iter().all(is_dark) => Validity::Valid,
        validity => validity,
    };
    let (mean, std_err) = mean_and_error(scratch.iter().map(|s| s.direct + s.indirect));
    let (direct, _) = mean_and_error(scratch.iter().map(|s| s.direct));
    Texel {
        direct,
        indirect: (mean - direct).max(Vec3::ZERO),
        std_err,
        coverage,
        validity,
        cells: visible.cells,
        side,
        paths: n,
    }
}

/// Gathers `new[k]` more paths in texel `k`; the texels are those of [`bake_page`] with the same arguments.
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn refine_page(
    kernel: &Kernel<'_>,
    map: &TexelMap,
    page: usize,
    effort: Effort,
    new: &[u32],
    solution: &mut Solution,
    monitor: &Monitor,
) -> Result<(), Error> {
    let gates: Vec<Gate> = solution
        .texels
        .par_chunks_mut(CHUNK)
        .zip(new.par_chunks(CHUNK))
        .enumerate()
        .with_max_len(1)
        .map_init(
            || (Vec::new(), None),
            |(scratch, sampler), (chunk, (texels, new))| {
                let mut gate = Gate::default();
                let (mut rays, mut paths) = (0, 0);
                for (k, (t, &n)) in texels.iter_mut().zip(new).enumerate() {
                    if n == 0 || monitor.stopped() {
                        continue;
                    }
                    let index = chunk * CHUNK + k;
                    let sampler = match sampler {
                        Some(s) => {
                            TexelSampler::set(s, map, index);
                            s
                        }
                        None => sampler.insert(TexelSampler::new(map, index)),
                    };
                    let id = Id { page, texel: map.texels[index], seed: effort.seed, crack: 0.0 };
                    refine(kernel, sampler, id, n, t, scratch, &mut gate, &mut rays);
                    paths += u64::from(n);
                }
                monitor.add(paths, rays);
                gate
            },
        )
        .collect();
    if monitor.stopped() {
        return Err(Error::Interrupted);
    }
    solution.gate = gates.into_iter().fold(solution.gate, Gate::merge);
    Ok(())
}

/// Adds `n` paths to a texel. Both parts are weighed by their numbers of paths, not by their variances: few
/// paths that missed what is rare would count for too much.
#[expect(clippy::too_many_arguments, reason = "one step of the loop over texels")]
fn refine(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    id: Id,
    n: u32,
    texel: &mut Texel,
    scratch: &mut Vec<Sample>,
    gate: &mut Gate,
    rays: &mut u64,
) {
    let numbers = texel.paths..texel.paths + n;
    gather(kernel, sampler, id, numbers, texel.side, texel.cells, scratch, gate, rays);
    if scratch.is_empty() {
        return;
    }
    let (mean, std_err) = mean_and_error(scratch.iter().map(|s| s.direct + s.indirect));
    let (direct, _) = mean_and_error(scratch.iter().map(|s| s.direct));
    let indirect = (mean - direct).max(Vec3::ZERO);
    let new = n as f32 / (texel.paths + n) as f32;
    texel.direct = texel.direct.lerp(direct, new);
    texel.indirect = texel.indirect.lerp(indirect, new);
    let (old, new) = (texel.std_err * (1.0 - new), std_err * new);
    texel.std_err = (old * old + new * new).map(f32::sqrt);
    texel.paths += n;
}

fn is_dark(s: &Sample) -> bool {
    s.direct + s.indirect == Vec3::ZERO
}

/// Paths that have to bring nothing before a texel counts as dark.
const DARK: u32 = 64;

/// Which side of a surface is gathered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Side {
    #[default]
    Front,
    BackOfDoubleSided,
}

#[expect(clippy::too_many_arguments, reason = "one inner step of `texel`, split off because it runs twice")]
fn gather(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    id: Id,
    numbers: Range<u32>,
    side: Side,
    cells: Cells,
    scratch: &mut Vec<Sample>,
    gate: &mut Gate,
    rays: &mut u64,
) {
    scratch.clear();
    let key = sequence::key(id.seed, DOMAIN + id.page as u64, u64::from(id.texel));
    for i in numbers {
        let mut sequence = Sequence::new(key, i);
        let [a, b, c, d] = sequence.next4();
        let on = sampler.sample([a, b]);
        if !cells[cell_index(on.uv.to_array())] {
            continue;
        }
        let Some(vertex) = receiver(kernel, on.triangle, on.bary, side) else { continue };
        let e = kernel.estimate(&vertex, [c, d], &mut sequence);
        *rays += u64::from(e.rays);
        let at = Rejected { page: id.page, texel: id.texel, sample: i };
        scratch.push(Sample { direct: gate.admit(e.direct, at), indirect: gate.admit(e.indirect, at) });
    }
}

/// The point on a side of a surface from which rays start; `None` where it has no area, or where the
/// back is asked for and the surface has none.
pub(super) fn receiver(kernel: &Kernel<'_>, triangle: u32, bary: [f32; 3], side: Side) -> Option<Vertex> {
    let at = kernel.world.point(kernel.scene, triangle, bary);
    if at.geometric_normal == Vec3A::ZERO {
        return None;
    }
    let front = Vertex::front(&at);
    match side {
        Side::Front => {
            Some(Vertex { position: kernel.world.lifted(kernel.scene, triangle, bary, &at), ..front })
        }
        Side::BackOfDoubleSided => {
            kernel.world.material(kernel.scene, triangle).double_sided.then(|| front.turned())
        }
    }
}

/// Rays that look around from each texel before it is gathered. If one of them meets a back, the
/// second number of rays tells which parts of the texel are hidden.
const LOOKS: [u32; 2] = [16, 64];

/// Cells along a texel's side among which hidden parts are told apart: 16 rays to each.
const SIDE: usize = 2;

/// Which cells lie in the open.
type Cells = [bool; SIDE * SIDE];

/// Which parts of a texel lie in the open.
struct Visible {
    cells: Cells,
    validity: Validity,
    /// Every ray met a back, nothing, or a front across a crack, and some did not meet nothing: there
    /// is a body around.
    inside: bool,
}

/// Looks around from a texel, to find parts that lie inside other geometry. The rays are the same
/// whatever the seed and the number of samples, so that these do not decide which texels count.
///
/// A cell is hidden if more than half of its rays meet the back of a one-sided surface, or if all of
/// them meet backs. Backs here and there are ordinary: one-sided surfaces are black from behind and
/// stay in the mean. If every cell is hidden, all stay and the texel says so.
fn probe(kernel: &Kernel<'_>, sampler: &TexelSampler, id: Id, side: Side, rays: &mut u64) -> Visible {
    let key = sequence::key(0, PROBE + id.page as u64, u64::from(id.texel));
    let mut cells = [Cell::default(); SIDE * SIDE];
    let mut void = true;
    let mut near = false;
    let mut backs = 0;
    let mut from = 0;
    for until in LOOKS {
        for i in from..until {
            let [a, b, c, d] = Sequence::new(key, i).next4();
            let on = sampler.sample([a, b]);
            let Some(vertex) = receiver(kernel, on.triangle, on.bary, side) else { continue };
            *rays += 1;
            let (first, distance) = kernel.look(&vertex, [c, d]);
            let cell = &mut cells[cell_index(on.uv.to_array())];
            cell.all += 1;
            cell.one_sided += u32::from(first == First::Back);
            let back = matches!(first, First::Back | First::DoubleSidedBack);
            cell.back += u32::from(back);
            backs += u32::from(back);
            let crack = first == First::Front && distance < id.crack;
            void &= first != First::Front || crack;
            near |= back || crack;
        }
        from = until;
        if backs == 0 {
            break;
        }
    }
    Visible::new(&cells, void, near)
}

impl Visible {
    fn new(cells: &[Cell; SIDE * SIDE], void: bool, near: bool) -> Self {
        let states = cells.map(|c| c.validity());
        let any = |v| cells.iter().zip(states).any(|(c, s)| 0 < c.all && s == v);
        let validity = if any(Validity::Valid) {
            Validity::Valid
        } else if any(Validity::Enclosed) {
            Validity::Enclosed
        } else {
            Validity::Hidden
        };
        let all = validity != Validity::Valid;
        Self { cells: states.map(|s| all || s == Validity::Valid), validity, inside: void && near }
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the grid")]
fn cell_index(place: [f32; 2]) -> usize {
    let k = |x: f32| ((x * SIDE as f32).max(0.0) as usize).min(SIDE - 1);
    k(place[1]) * SIDE + k(place[0])
}

/// What the rays from one part of a texel met.
#[derive(Clone, Copy, Default)]
struct Cell {
    all: u32,
    one_sided: u32,
    back: u32,
}

impl Cell {
    fn validity(&self) -> Validity {
        if self.all < 2 * self.one_sided {
            Validity::Hidden
        } else if self.back == self.all && 0 < self.all {
            Validity::Enclosed
        } else {
            Validity::Valid
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(all: u32, one_sided: u32, double_sided: u32) -> Cell {
        Cell { all, one_sided, back: one_sided + double_sided }
    }

    #[test]
    fn the_part_under_another_body_is_left_out() {
        for hidden in [cell(16, 16, 0), cell(16, 9, 0), cell(16, 0, 16)] {
            let v = Visible::new(&[hidden, cell(16, 0, 0), hidden, cell(16, 3, 0)], false, true);
            assert_eq!(v.validity, Validity::Valid);
            assert_eq!(v.cells, [false, true, false, true]);
            assert_eq!([cell_index([0.2, 0.2]), cell_index([0.9, 0.2])], [0, 1]);
        }
    }

    /// The plan states memory without knowing this module.
    #[test]
    fn the_plan_knows_the_size_of_a_texel() {
        assert_eq!(size_of::<Texel>() as u64, crate::plan::memory::PER_SOLVED);
    }

    #[test]
    fn wholly_hidden_texels_say_so() {
        let all = |c| Visible::new(&[c, c, c, Cell::default()], true, true);
        assert_eq!(all(cell(16, 16, 0)).validity, Validity::Hidden);
        assert_eq!(all(cell(16, 0, 16)).validity, Validity::Enclosed);
        assert!(all(cell(16, 16, 0)).cells.iter().all(|c| *c), "all stay where none is better");
    }
}
