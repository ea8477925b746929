//! The texels of one page.

use crate::error::Error;
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

/// Texels that one task does: enough to make scheduling free, few enough to share the work evenly
/// and to stop quickly.
const CHUNK: usize = 32;

/// Most such tasks that a thread takes in one piece. A piece that was begun cannot be shared, and
/// left to itself the scheduler begins pieces of up to a quarter of a page, so that at the end one thread
/// works while the others wait.
const CHUNKS: usize = 16;

/// Random numbers of lightmaps belong to this domain and the page; see [`sequence::key`].
const DOMAIN: u64 = 0x4c4d;

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
}

/// Gathers paths in each covered texel of a page.
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn bake_page(
    kernel: &Kernel<'_>,
    map: &TexelMap,
    page: usize,
    Effort { samples, seed, texel_size }: Effort,
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
                if monitor.stopped() {
                    return gate;
                }
                let mut rays = 0;
                for (k, out) in out.iter_mut().enumerate() {
                    let index = chunk * CHUNK + k;
                    let sampler = match sampler {
                        Some(s) => {
                            TexelSampler::set(s, map, index);
                            s
                        }
                        None => sampler.insert(TexelSampler::new(map, index)),
                    };
                    let id = Id { page, texel: map.texels[index], seed, crack };
                    *out = texel(kernel, sampler, id, samples, scratch, &mut gate, &mut rays);
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
    Ok(Solution { texels, gate: gates.into_iter().fold(Gate::default(), Gate::merge) })
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

/// One path's result and where in the texel it started.
struct Sample {
    direct: Rgb,
    indirect: Rgb,
    first: First,
    /// Whether the first ray met a front side nearby: nearer than a texel's neighbourhood, so that
    /// what lies between is a crack and no room.
    crack: bool,
    place: [f32; 2],
}

fn texel(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    id: Id,
    n: u32,
    scratch: &mut Vec<Sample>,
    gate: &mut Gate,
    rays: &mut u64,
) -> Texel {
    gather(kernel, sampler, id, n, Side::Front, scratch, gate, rays);
    if !scratch.is_empty() && scratch.iter().all(sees_nothing) {
        // A sheet that shows its back to the room, as many files have them: if it is double-sided and
        // its front faces the void, the back is what anybody will see.
        let front = std::mem::take(scratch);
        gather(kernel, sampler, id, n, Side::BackOfDoubleSided, scratch, gate, rays);
        if scratch.iter().all(sees_nothing) {
            *scratch = front;
        }
    }
    let coverage = sampler.coverage();
    if scratch.is_empty() {
        // The triangle has no area in the world: there is nothing to light.
        return Texel { coverage, validity: Validity::Hidden, ..Texel::default() };
    }
    let validity = keep_visible(scratch);
    let (mean, std_err) = mean_and_error(scratch.iter().map(|s| s.direct + s.indirect));
    let (direct, _) = mean_and_error(scratch.iter().map(|s| s.direct));
    Texel { direct, indirect: (mean - direct).max(Vec3::ZERO), std_err, coverage, validity }
}

/// No light, and no front side of anything in view but across a crack.
fn sees_nothing(s: &Sample) -> bool {
    (s.first != First::Front || s.crack) && s.direct + s.indirect == Vec3::ZERO
}

/// Which side of a surface is gathered.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    Front,
    BackOfDoubleSided,
}

#[expect(clippy::too_many_arguments, reason = "one inner step of `texel`, split off because it runs twice")]
fn gather(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    id: Id,
    n: u32,
    side: Side,
    scratch: &mut Vec<Sample>,
    gate: &mut Gate,
    rays: &mut u64,
) {
    scratch.clear();
    let key = sequence::key(id.seed, DOMAIN + id.page as u64, u64::from(id.texel));
    for i in 0..n {
        let mut sequence = Sequence::new(key, i);
        let [a, b, c, d] = sequence.next4();
        let on = sampler.sample([a, b]);
        let Some(vertex) = receiver(kernel, on.triangle, on.bary, side) else { continue };
        let e = kernel.estimate(&vertex, [c, d], &mut sequence);
        *rays += u64::from(e.rays);
        let at = Rejected { page: id.page, texel: id.texel, sample: i };
        scratch.push(Sample {
            direct: gate.admit(e.direct, at),
            indirect: gate.admit(e.indirect, at),
            first: e.first,
            crack: e.first_distance < id.crack,
            place: on.uv.to_array(),
        });
    }
}

/// The point on a side of a surface from which rays start; `None` where it has no area, or where the
/// back is asked for and the surface has none.
fn receiver(kernel: &Kernel<'_>, triangle: u32, bary: [f32; 3], side: Side) -> Option<Vertex> {
    let at = kernel.world.point(kernel.scene, triangle, bary);
    if at.geometric_normal == Vec3A::ZERO {
        return None;
    }
    let front = Vertex {
        position: at.position,
        geometric_normal: at.geometric_normal,
        shading_normal: at.shading_normal,
        offset: at.offset,
    };
    match side {
        Side::Front => {
            Some(Vertex { position: kernel.world.lifted(kernel.scene, triangle, bary, &at), ..front })
        }
        Side::BackOfDoubleSided => {
            kernel.world.material(kernel.scene, triangle).double_sided.then(|| front.turned())
        }
    }
}

/// Drops the samples of those parts of the texel that lie inside other geometry.
///
/// The texel is divided into as many cells as the samples can tell apart (at least eight to a
/// cell). A cell is hidden if more than half of its first rays meet the back of a one-sided surface,
/// or if all of them meet backs and not one brings light. Rays that meet a back here and there are
/// ordinary: one-sided surfaces are black from behind and stay in the mean. If every cell is
/// hidden, all samples stay and the texel says so.
fn keep_visible(samples: &mut Vec<Sample>) -> Validity {
    let backs = samples.iter().filter(|s| is_back(s)).count();
    if backs * 20 < samples.len() {
        return Validity::Valid;
    }
    let side = match samples.len() {
        0..32 => 1,
        32..128 => 2,
        _ => 4,
    };
    let mut cells = [Cell::default(); 16];
    let cell = |s: &Sample| cell_index(s.place, side);
    for s in samples.iter() {
        let c = &mut cells[cell(s)];
        c.all += 1;
        c.back += u32::from(s.first == First::Back);
        c.any_back += u32::from(is_back(s));
        c.lit |= s.direct + s.indirect != Vec3::ZERO;
    }
    if cells.iter().any(|c| 0 < c.all && c.validity() == Validity::Valid) {
        samples.retain(|s| cells[cell(s)].validity() == Validity::Valid);
        return Validity::Valid;
    }
    if cells.iter().any(|c| 0 < c.all && c.validity() == Validity::Enclosed) {
        Validity::Enclosed
    } else {
        Validity::Hidden
    }
}

fn is_back(s: &Sample) -> bool {
    matches!(s.first, First::Back | First::DoubleSidedBack)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the grid")]
fn cell_index(place: [f32; 2], side: usize) -> usize {
    let k = |x: f32| ((x * side as f32).max(0.0) as usize).min(side - 1);
    k(place[1]) * side + k(place[0])
}

#[derive(Clone, Copy, Default)]
struct Cell {
    all: u32,
    back: u32,
    any_back: u32,
    lit: bool,
}

impl Cell {
    fn validity(&self) -> Validity {
        if self.all < 2 * self.back {
            Validity::Hidden
        } else if self.any_back == self.all && !self.lit {
            Validity::Enclosed
        } else {
            Validity::Valid
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(n: u16, back: impl Fn(f32) -> First) -> Vec<Sample> {
        (0..n)
            .map(|i| {
                let place = [(f32::from(i) + 0.5) / f32::from(n), f32::from(i % 16) / 16.0];
                let first = back(place[0]);
                let light = if first == First::Front { Vec3::ONE } else { Vec3::ZERO };
                Sample { direct: light, indirect: Vec3::ZERO, first, crack: false, place }
            })
            .collect()
    }

    #[test]
    fn the_part_under_another_body_is_left_out() {
        for back in [First::Back, First::DoubleSidedBack] {
            let mut s = samples(256, |x| if x < 0.5 { back } else { First::Front });
            assert_eq!(keep_visible(&mut s), Validity::Valid);
            assert_eq!(s.len(), 128);
            assert!(s.iter().all(|s| 0.5 <= s.place[0]));
        }
    }

    #[test]
    fn a_few_backs_are_ordinary_and_stay() {
        let mut s = samples(100, |x| if x < 0.04 { First::Back } else { First::Front });
        assert_eq!(keep_visible(&mut s), Validity::Valid);
        assert_eq!(s.len(), 100);
    }

    #[test]
    fn wholly_hidden_texels_say_so() {
        assert_eq!(keep_visible(&mut samples(64, |_| First::Back)), Validity::Hidden);
        assert_eq!(keep_visible(&mut samples(64, |_| First::DoubleSidedBack)), Validity::Enclosed);
    }
}
