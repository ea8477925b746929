//! The texels of one page.

use crate::error::Error;
use crate::geom::atlas::Atlas;
use crate::geom::texel::{TexelMap, TexelSample, TexelSampler};
use crate::geom::world::luminance;
use crate::sample::{Sequence, sequence};
use crate::scene::model::Rgb;
use crate::solve::accumulate::{Gate, Kind, Rejected, halves, mean_and_error};
use crate::solve::audit::Audit;
use crate::solve::facing::Facing;
use crate::solve::monitor::{ErrorSums, Monitor};
use crate::solve::visible::{Cells, Side, Validity, Visible, cell_index, is_beside, receiver};
use crate::transport::{Estimate, Kernel, Vertex};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;
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

/// Those of the paths that tell whether a texel is dark.
const DARKNESS: u64 = 0x444b;

/// Those of suns and lamps, which are gathered apart.
///
/// Pages are added to domains, so these lie further apart than there are pages.
const SMALL: u64 = 0x5355;

/// Added to the seed of texels that are gathered again.
const AUDIT: u64 = 0x4155;

/// What one texel received.
///
/// Light straight from suns and lamps is gathered apart from paths, because it takes one ray where a path takes several,
/// and each gets its own number of samples: at the edge of a shadow many shadow rays, in a
/// dim corner many paths.
#[derive(Clone, Copy, Debug, Default)]
pub struct Texel {
    /// Straight from suns and lamps, and from lamps by way of the media in front of the texel.
    pub small: Gathered,
    /// Everything else.
    pub paths: Gathered,
    /// The part of `small` that media scattered on its way, `E / pi`, nits.
    pub scattered: Rgb,
    /// The part of `paths` that was not reflected on its way, `E / pi`, nits.
    pub unreflected: Rgb,
    /// Part of the texel's square that its chart covers.
    pub coverage: f32,
    /// Whether the texel can be seen.
    pub validity: Validity,
    /// Which parts of the texel are gathered.
    cells: Cells,
    /// Which side is gathered.
    side: Side,
    /// See [`Vertex::open`].
    pub open: bool,
}

/// Mean of samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gathered {
    /// `E / pi`, nits.
    pub mean: Rgb,
    /// Its standard error, nits.
    pub std_err: Rgb,
    /// Luminance of one half of the samples against the other, nits: a number whose mean square is the variance of
    /// `mean`. See [`halves`].
    pub halves: f32,
    /// Number of samples.
    pub samples: u32,
}

impl Gathered {
    fn of(samples: &[Sample]) -> Self {
        let all = || samples.iter().map(|s| s.direct + s.indirect);
        let (mean, std_err) = mean_and_error(all());
        let halves = halves(all().map(luminance));
        #[expect(clippy::cast_possible_truncation, reason = "as many as were asked for")]
        let samples = samples.len() as u32;
        Self { mean, std_err, halves, samples }
    }

    /// Both together, weighed by their numbers of samples and not by their variances: few samples that missed
    /// what is rare would count for too much.
    fn merge(self, o: Self) -> Self {
        let samples = self.samples + o.samples;
        let part = o.samples as f32 / samples.max(1) as f32;
        let (old, new) = (self.std_err * (1.0 - part), o.std_err * part);
        Self {
            mean: self.mean.lerp(o.mean, part),
            std_err: joint(old, new),
            // Both rounds have halves of their own, which are independent.
            halves: self.halves * (1.0 - part) + o.halves * part,
            samples,
        }
    }
}

/// Standard error of a sum, of those of its parts. Their squares may be beyond f32 where the values are not.
pub(crate) fn joint(a: Rgb, b: Rgb) -> Rgb {
    let (a, b) = (a.as_dvec3(), b.as_dvec3());
    (a * a + b * b).map(f64::sqrt).as_vec3()
}

impl Texel {
    /// `E / pi` in all, nits.
    #[must_use]
    pub fn value(&self) -> Rgb {
        self.direct() + self.indirect()
    }

    /// `E / pi` straight from lights, nits.
    #[must_use]
    pub fn direct(&self) -> Rgb {
        (self.small.mean - self.scattered).max(Vec3::ZERO) + self.unreflected
    }

    /// `E / pi` after it was reflected or scattered at least once, nits.
    #[must_use]
    pub fn indirect(&self) -> Rgb {
        (self.paths.mean - self.unreflected).max(Vec3::ZERO) + self.scattered
    }

    /// Whether the light is that of the surface's back.
    #[must_use]
    pub fn turned(&self) -> bool {
        self.side == Side::BackOfDoubleSided
    }

    /// Standard error of [`Texel::value`], nits.
    #[must_use]
    pub fn std_err(&self) -> Rgb {
        joint(self.small.std_err, self.paths.std_err)
    }
}

/// How much is gathered, and how.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Paths per texel.
    pub samples: u32,
    /// Samples of suns and lamps per texel, where there are any.
    pub small: u32,
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
    /// What samples cost.
    pub cost: Cost,
    /// Whether it was gathered without the irradiance cache that there is, whose error was beyond what was asked for.
    pub uncached: bool,
    /// What an audit said of the stated errors.
    pub audit: Option<Audit>,
    /// After each round what had been spent, and the error then as the samples say it, nits: see [`Solution::spent`].
    pub curve: Vec<(f64, f64)>,
}

/// What samples cost, by rays: parts of what a path with its share of suns and lamps costs on average.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// One sample of suns and lamps; 0 where there are none.
    pub small: f64,
    /// One path.
    pub path: f64,
    /// One path in the open, where fewer rays are needed.
    pub open_path: f64,
}

impl Default for Cost {
    fn default() -> Self {
        Self { small: 0.0, path: 1.0, open_path: 1.0 }
    }
}

impl Cost {
    /// From rays and samples of each kind. Choosing the place where a sample starts counts as [`START`] rays.
    fn new(counted: [Counted; KINDS]) -> Self {
        let each = |c: Counted| if c.samples == 0 { 0.0 } else { START + c.rays as f64 / c.samples as f64 };
        let all = |c: Counted| each(c) * c.samples as f64;
        let [small, path, open] = counted;
        let both = (all(small) + all(path) + all(open)) / (path.samples + open.samples).max(1) as f64;
        if both <= 0.0 {
            return Self::default();
        }
        let [small, path, open_path] = counted.map(|c| each(c) / both);
        // A kind that did not occur costs something all the same.
        let or = |cost: f64, other: f64| if 0.0 < cost { cost } else { other };
        Self { small, path: or(path, open_path), open_path: or(open_path, path) }
    }

    /// One path at a texel.
    #[must_use]
    pub fn path_at(&self, texel: &Texel) -> f64 {
        if texel.open { self.open_path } else { self.path }
    }

    /// What samples of a texel cost.
    #[must_use]
    pub fn of(&self, texel: &Texel, small: u32, paths: u32) -> f64 {
        self.small * f64::from(small) + self.path_at(texel) * f64::from(paths)
    }
}

/// Kinds of samples that cost differently: suns and lamps, paths, paths in the open.
const KINDS: usize = 3;

/// See [`Cost::new`].
const START: f64 = 0.5;

/// Samples of one kind and their rays.
#[derive(Clone, Copy, Debug, Default)]
struct Counted {
    samples: u64,
    rays: u64,
}

impl Solution {
    /// Paths of all texels together, fewest and most.
    #[must_use]
    pub fn paths(&self) -> (u64, u64, u64) {
        let each = || self.texels.iter().map(|t| u64::from(t.paths.samples));
        (each().sum(), each().min().unwrap_or(0), each().max().unwrap_or(0))
    }

    /// By what the stated error of a texel has to be multiplied.
    #[must_use]
    pub fn factor(&self, texel: &Texel) -> f64 {
        self.audit.as_ref().map_or(1.0, |a| a.factor(texel))
    }

    /// By what the mean of squared errors has to be multiplied on top.
    #[must_use]
    pub fn squares(&self) -> f64 {
        self.audit.as_ref().and_then(|a| a.squares).unwrap_or(1.0)
    }

    /// What all texels cost, in paths with their share of suns and lamps.
    #[must_use]
    pub fn spent(&self) -> f64 {
        self.texels.iter().map(|t| self.cost.of(t, t.small.samples, t.paths.samples)).sum()
    }
}

/// Gathers paths in each covered texel of a page. `facing` says which side of a
/// chart counts.
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn bake_page(
    kernel: &Kernel<'_>,
    atlas: &Atlas,
    map: &TexelMap,
    page: usize,
    Effort { samples, small, seed, texel_size }: Effort,
    facing: &Facing,
    monitor: &Monitor,
) -> Result<Solution, Error> {
    let crack = CRACK * texel_size;
    let n = map.texels.len();
    let mut texels = vec![Texel::default(); n];
    let tallies: Vec<Tally> = texels
        .par_chunks_mut(CHUNK)
        .enumerate()
        .with_max_len(CHUNKS)
        .map_init(
            || (Vec::with_capacity(samples as usize), TexelSampler::default()),
            |(scratch, sampler), (chunk, out)| {
                let mut tally = Tally::default();
                for (k, out) in out.iter_mut().enumerate() {
                    if monitor.stopped() {
                        return tally;
                    }
                    let index = chunk * CHUNK + k;
                    sampler.set(map, index);
                    let chart = map.chart(atlas, map.triangles_of(index)[0]);
                    let (side, may_turn) = facing.of(chart);
                    let id = Id { page, texel: map.texels[index], seed };
                    let at = Place { may_turn, ..Place::new(kernel, sampler, id, side) };
                    *out = texel(at, crack, [small, samples], scratch, &mut tally);
                    monitor.report(&tally.gate);
                }
                monitor.add_error(error_sums(out));
                monitor.add(out.len() as u64 * u64::from(samples), tally.rays());
                tally
            },
        )
        .collect();
    if monitor.stopped() {
        return Err(Error::Interrupted);
    }
    doubt_enclosed(kernel, atlas, map, page, &mut texels, monitor)?;
    let tally = tallies.into_iter().fold(Tally::default(), Tally::merge);
    let cost = Cost::new(tally.counted);
    Ok(Solution { texels, gate: tally.gate, cost, ..Solution::default() })
}

/// Asks texels that seem to be enclosed again, with as many rays as it takes, where it matters: beside texels in the open,
/// from which they would be filled. A crevice that hardly any ray leaves is dim, but
/// it is not dark.
fn doubt_enclosed(
    kernel: &Kernel<'_>,
    atlas: &Atlas,
    map: &TexelMap,
    page: usize,
    texels: &mut [Texel],
    monitor: &Monitor,
) -> Result<(), Error> {
    let chart = |k: usize| map.chart(atlas, map.triangles_of(k)[0]);
    let enclosed = |texels: &[Texel], k: usize| texels[k].validity == Validity::Enclosed;
    let mut left: Vec<usize> = (0..texels.len()).filter(|&k| enclosed(texels, k)).collect();
    if left.is_empty() {
        return Ok(());
    }
    // Texels come tile by tile.
    let mut rows: Vec<usize> = (0..texels.len()).collect();
    rows.sort_unstable_by_key(|&k| map.texels[k]);
    let find =
        |at: usize| rows.binary_search_by_key(&at, |&k| map.texels[k] as usize).ok().map(|row| rows[row]);
    let page_size = [map.width as usize, map.height as usize];
    let mut side = None;
    loop {
        // One that turns out to be in the open has neighbours of its own.
        let (beside, others): (Vec<usize>, Vec<usize>) = left.into_iter().partition(|&k| {
            let counts = |j: usize| texels[j].validity == Validity::Valid && chart(j) == chart(k);
            is_beside(page_size, map.texels[k] as usize, |at| find(at).is_some_and(counts))
        });
        let side = *side.get_or_insert(if beside.len() <= ALONE { 1 } else { GROUP });
        let mut groups: BTreeMap<(u32, [u32; 2]), Vec<usize>> = BTreeMap::new();
        for k in beside {
            groups.entry((chart(k), map.position(k).map(|c| c / side))).or_default().push(k);
        }
        let lit: Vec<usize> = groups
            .into_par_iter()
            .filter(|_| !monitor.stopped())
            .map_init(TexelSampler::default, |sampler, (_, group)| {
                let mut tally = Tally::default();
                let mut is_lit = |k: usize, paths: u32| {
                    sampler.set(map, k);
                    let id = Id { page, texel: map.texels[k], seed: 0 };
                    let at = Place::again(kernel, sampler, id, &texels[k]);
                    // A square can take seconds.
                    !monitor.stopped() && !is_dark(&at, [paths, u32::MAX], &mut tally)
                };
                // Together they ask as much as one that is alone; only where that finds light does each ask for itself.
                let each = DARK.div_ceil(u32::try_from(group.len()).unwrap_or(DARK));
                let found = if group.iter().any(|&k| is_lit(k, each)) {
                    group.into_iter().filter(|&k| is_lit(k, DARK)).collect()
                } else {
                    Vec::new()
                };
                monitor.add(0, tally.looks);
                found
            })
            .flatten()
            .collect();
        if monitor.stopped() {
            return Err(Error::Interrupted);
        }
        if lit.is_empty() {
            return Ok(());
        }
        for k in lit {
            texels[k].validity = Validity::Valid;
        }
        left = others;
    }
}

/// What happened in some texels.
#[derive(Clone, Copy, Default)]
struct Tally {
    gate: Gate,
    counted: [Counted; KINDS],
    /// Rays that looked around.
    looks: u64,
}

impl Tally {
    fn rays(&self) -> u64 {
        self.looks + self.counted.iter().map(|c| c.rays).sum::<u64>()
    }

    /// Both together; `self` came first.
    fn merge(self, o: Self) -> Self {
        let counted = std::array::from_fn(|k| {
            let (a, b) = (self.counted[k], o.counted[k]);
            Counted { samples: a.samples + b.samples, rays: a.rays + b.rays }
        });
        Self { gate: self.gate.merge(o.gate), counted, looks: self.looks + o.looks }
    }
}

/// What the progress display wants to know of finished texels.
fn error_sums(texels: &[Texel]) -> ErrorSums {
    let mut sums = ErrorSums::default();
    for t in texels {
        let e = f64::from(luminance(t.std_err()));
        sums.squared_error += e * e;
        sums.luminance += f64::from(luminance(t.value()));
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
}

/// One sample's result.
struct Sample {
    direct: Rgb,
    indirect: Rgb,
}

/// A texel to gather.
#[derive(Clone, Copy)]
struct Place<'a> {
    kernel: &'a Kernel<'a>,
    sampler: &'a TexelSampler,
    id: Id,
    side: Side,
    /// Whether a texel that is dark on this side may show the other.
    may_turn: bool,
    cells: Cells,
    open: bool,
}

fn texel(at: Place<'_>, crack: f32, n: [u32; 2], scratch: &mut Vec<Sample>, tally: &mut Tally) -> Texel {
    let coverage = at.sampler.coverage();
    let (at, validity) = settle(at, crack, tally);
    let texel = all(&at, n, scratch, tally);
    if texel.paths.samples == 0 {
        // The triangle has no area in the world: there is nothing to light.
        return Texel { coverage, validity: Validity::Hidden, ..Texel::default() };
    }
    Texel { coverage, validity, cells: at.cells, side: at.side, open: at.open, ..texel }
}

/// Decides which side of a texel and which parts of it are gathered, and whether it can be seen.
fn settle<'a>(mut at: Place<'a>, crack: f32, tally: &mut Tally) -> (Place<'a>, Validity) {
    let mut visible = look_around(&mut at, crack, tally);
    let mut dark = (visible.inside || at.can_turn()) && is_dark(&at, [DARK, DARK_RAYS], tally);
    if dark && at.can_turn() {
        // A sheet that shows its back to the room, as many files have them: where it is double-sided and
        // no light reaches its front, the light of its back is what anybody will see.
        let mut back = Place { side: Side::BackOfDoubleSided, may_turn: false, ..at };
        let seen = look_around(&mut back, crack, tally);
        if !is_dark(&back, [DARK, DARK_RAYS], tally) {
            (visible, at, dark) = (seen, back, false);
        }
    }
    let validity = match visible.validity {
        // Only what is dark can be the inside of a body: light finds its way under a tent.
        Validity::Valid if visible.inside && dark => Validity::Enclosed,
        Validity::Enclosed if !dark => Validity::Valid,
        validity => validity,
    };
    (at, validity)
}

/// Finds out which parts of a texel are hidden, and enters it.
fn look_around(at: &mut Place<'_>, crack: f32, tally: &mut Tally) -> Visible {
    let visible = Visible::find(at.kernel, at.sampler, at.side, (at.id.page, at.id.texel), crack);
    (at.cells, at.open) = (visible.cells, visible.open);
    tally.looks += visible.rays;
    visible
}

/// Whether none of so many paths finds light, or of as many of them as so many rays are enough for: where nothing is absorbed, one path looks
/// around as much as fifty elsewhere. They are the same whatever the seed and the number of samples, so that
/// these do not decide which side of a surface counts; where there is light, the first of them mostly finds it.
fn is_dark(at: &Place<'_>, [paths, enough]: [u32; 2], tally: &mut Tally) -> bool {
    // Nor does what becomes of media.
    let kernel = at.kernel.plain().in_clear_air();
    let key = sequence::key(0, DARKNESS + at.id.page as u64, u64::from(at.id.texel));
    let mut rays = 0;
    (0..paths).all(|i| {
        if enough < rays {
            return true;
        }
        let mut sequence = Sequence::new(key, i);
        let [a, b, c, d] = sequence.next4();
        let Some(vertex) = at.vertex([a, b]) else { return true };
        let e = kernel.estimate(&vertex, [c, d], &mut sequence);
        rays += e.rays;
        tally.looks += u64::from(e.rays);
        e.direct + e.indirect == Vec3::ZERO
    })
}

/// Paths that have to bring nothing before a texel counts as dark.
const DARK: u32 = 64;

/// Most texels of a page that ask by themselves whether they are enclosed, which takes up to 20,000 rays each where nothing is
/// absorbed. With more, squares of [`GROUP`] texels ask together.
const ALONE: usize = 1024;

/// See [`ALONE`]; texels.
const GROUP: u32 = 16;

/// Rays after which a texel counts as dark; see [`doubt_enclosed`].
const DARK_RAYS: u32 = 512;

/// The light of a texel from so many samples of suns and lamps and so many paths.
fn all(at: &Place<'_>, [small, paths]: [u32; 2], scratch: &mut Vec<Sample>, tally: &mut Tally) -> Texel {
    let mut texel = Texel::default();
    if at.kernel.has_small() {
        add(at, Kind::Small, small, &mut texel, scratch, tally);
    }
    add(at, Kind::Path, paths, &mut texel, scratch, tally);
    texel
}

/// Adds `n` samples to what a texel has.
fn add(at: &Place<'_>, kind: Kind, n: u32, texel: &mut Texel, scratch: &mut Vec<Sample>, tally: &mut Tally) {
    let gathered = if kind == Kind::Small { &mut texel.small } else { &mut texel.paths };
    let numbers = gathered.samples..gathered.samples + n;
    scratch.clear();
    scratch.extend(at.gather(kind, numbers, tally));
    if scratch.is_empty() {
        return;
    }
    // Samples that find no part of the texel in the open count as asked for, so that no number is used twice.
    let new = Gathered { samples: n, ..Gathered::of(scratch) };
    *gathered = gathered.merge(new);
    let part = n as f32 / gathered.samples as f32;
    if kind == Kind::Path {
        let (unreflected, _) = mean_and_error(scratch.iter().map(|s| s.direct));
        texel.unreflected = texel.unreflected.lerp(unreflected, part);
    } else if at.kernel.has_lamps_in_air() {
        let (scattered, _) = mean_and_error(scratch.iter().map(|s| s.indirect));
        texel.scattered = texel.scattered.lerp(scattered, part);
    }
}

impl<'a> Place<'a> {
    fn new(kernel: &'a Kernel<'a>, sampler: &'a TexelSampler, id: Id, side: Side) -> Self {
        Self { kernel, sampler, id, side, may_turn: false, cells: Cells::default(), open: false }
    }

    /// What is known of a texel that was begun.
    fn again(kernel: &'a Kernel<'a>, sampler: &'a TexelSampler, id: Id, known: &Texel) -> Self {
        Self { cells: known.cells, open: known.open, ..Self::new(kernel, sampler, id, known.side) }
    }

    /// The point of the texel that `u` chooses, in the open; `None` where none is found or where it has no area.
    fn vertex(&self, u: [f32; 2]) -> Option<Vertex> {
        point(self.kernel, self.sampler, (self.cells, self.side), u)
    }

    /// Whether the texel may show its back instead of its front.
    fn can_turn(&self) -> bool {
        let on = self.sampler.sample([0.5; 2]);
        self.may_turn && self.kernel.world.material(self.kernel.scene, on.triangle).double_sided
    }

    /// Samples of the given numbers; those that find no part of the texel in the open are left out.
    fn gather(&self, kind: Kind, numbers: Range<u32>, tally: &mut Tally) -> impl Iterator<Item = Sample> {
        let Id { page, texel, seed } = self.id;
        let key = key(kind, page, texel, seed);
        let kind_of_cost = if kind == Kind::Small { 0 } else { 1 + usize::from(self.open) };
        let counted = &mut tally.counted[kind_of_cost];
        let gate = &mut tally.gate;
        numbers.filter_map(move |i| {
            let (_, e) = self.sample(kind, &mut Sequence::new(key, i))?;
            counted.samples += 1;
            counted.rays += u64::from(e.rays);
            let at = Rejected { page, texel, kind, sample: i };
            Some(Sample { direct: gate.admit(e.direct, at), indirect: gate.admit(e.indirect, at) })
        })
    }

    /// One sample as it comes, and where it starts; `None` if no part in the open was found.
    fn sample(&self, kind: Kind, sequence: &mut Sequence) -> Option<(Vertex, Estimate)> {
        let [a, b, c, d] = sequence.next4();
        let vertex = self.vertex([a, b])?;
        if kind == Kind::Small {
            return Some((vertex, self.kernel.small(&vertex, sequence)));
        }
        let vertex = Vertex { open: self.open, ..vertex };
        Some((vertex, self.kernel.arriving(&vertex, [c, d], sequence)))
    }
}

/// What the random numbers of a texel's samples are drawn from.
pub(super) fn key(kind: Kind, page: usize, texel: u32, seed: u64) -> u64 {
    let domain = if kind == Kind::Small { SMALL } else { DOMAIN };
    sequence::key(seed, domain + page as u64, u64::from(texel))
}

fn point(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    (cells, side): (Cells, Side),
    u: [f32; 2],
) -> Option<Vertex> {
    let is_open = |on: &TexelSample| cells[cell_index(on.uv.to_array())];
    let mut on = sampler.sample(u);
    if !is_open(&on) {
        // The part in the open may be a corner that one number of a hundred finds: with a few paths it would seem not to be there, or it would,
        // as the seed has it.
        let [first, second] = u.map(|x| u64::from(x.to_bits()));
        let key = sequence::key(first, second, 0);
        let other = |k| {
            let [x, y, ..] = Sequence::hashed(key, k).next4();
            sampler.sample([x, y])
        };
        on = (0..AGAIN).map(other).find(is_open)?;
    }
    receiver(kernel, on.triangle, on.bary, side)
}

/// How often another point of a texel is chosen where one is hidden: all but surely found are parts of a twentieth.
const AGAIN: u32 = 64;

/// A point of a solved texel, in the open and on the side that it shows; `None` where none is found or where it has no area.
pub(super) fn vertex_of(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    texel: &Texel,
    u: [f32; 2],
) -> Option<Vertex> {
    point(kernel, sampler, (texel.cells, texel.side), u)
}

/// A texel as [`bake_page`] begins it, without light: which side of it and which parts count.
pub(super) fn begun(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    (page, texel): (usize, u32),
    (side, may_turn): (Side, bool),
    texel_size: f32,
) -> Texel {
    let id = Id { page, texel, seed: 0 };
    let at = Place { may_turn, ..Place::new(kernel, sampler, id, side) };
    let (at, validity) = settle(at, CRACK * texel_size, &mut Tally::default());
    Texel { validity, cells: at.cells, side: at.side, open: at.open, ..Texel::default() }
}

/// One sample of suns and lamps or one path of such a texel, as it comes, and where it starts; `None` if no part in the open was found.
pub(super) fn sample_of(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    (page, texel, seed): (usize, u32, u64),
    begun: &Texel,
    (kind, sample): (Kind, u32),
) -> Option<(Vertex, Estimate)> {
    let id = Id { page, texel, seed };
    let at = Place::again(kernel, sampler, id, begun);
    at.sample(kind, &mut Sequence::new(key(kind, page, texel, seed), sample))
}

/// The same texel from `times` as many samples with other random numbers, and the rays that took.
pub(super) fn again(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    (page, texel, seed): (usize, u32, u64),
    known: &Texel,
    times: u32,
) -> (Texel, u64) {
    let samples = [known.small.samples * times, known.paths.samples * times];
    with_samples(kernel, sampler, (page, texel, seed), known, samples)
}

/// The same texel from so many samples of suns and lamps and so many paths with other random numbers, and the rays that took.
pub(super) fn with_samples(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    (page, texel, seed): (usize, u32, u64),
    known: &Texel,
    samples: [u32; 2],
) -> (Texel, u64) {
    let id = Id { page, texel, seed: sequence::mix64(seed ^ AUDIT) };
    let at = Place::again(kernel, sampler, id, known);
    let mut tally = Tally::default();
    let again = all(&at, samples, &mut Vec::new(), &mut tally);
    (again, tally.rays())
}

/// More samples of a texel: of suns and lamps, and paths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct More {
    /// Of suns and lamps.
    pub small: u32,
    /// Paths.
    pub paths: u32,
}

/// Gathers `new[k]` more in texel `k`; the texels are those of [`bake_page`] with the same arguments.
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn refine_page(
    kernel: &Kernel<'_>,
    map: &TexelMap,
    page: usize,
    seed: u64,
    new: &[More],
    solution: &mut Solution,
    monitor: &Monitor,
) -> Result<(), Error> {
    let cost = solution.cost;
    let tallies: Vec<Tally> = solution
        .texels
        .par_chunks_mut(CHUNK)
        .zip(new.par_chunks(CHUNK))
        .enumerate()
        .with_max_len(1)
        .map_init(
            || (Vec::new(), TexelSampler::default()),
            |(scratch, sampler), (chunk, (texels, new))| {
                let mut tally = Tally::default();
                let mut spent = 0.0;
                for (k, (t, more)) in texels.iter_mut().zip(new).enumerate() {
                    if *more == More::default() || monitor.stopped() {
                        continue;
                    }
                    let index = chunk * CHUNK + k;
                    sampler.set(map, index);
                    let id = Id { page, texel: map.texels[index], seed };
                    let at = Place::again(kernel, sampler, id, t);
                    add(&at, Kind::Small, more.small, t, scratch, &mut tally);
                    add(&at, Kind::Path, more.paths, t, scratch, &mut tally);
                    monitor.report(&tally.gate);
                    spent += cost.of(t, more.small, more.paths);
                }
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a number of paths"
                )]
                monitor.add(spent as u64, tally.rays());
                tally
            },
        )
        .collect();
    if monitor.stopped() {
        return Err(Error::Interrupted);
    }
    solution.gate = tallies.into_iter().fold(solution.gate, |gate, t| gate.merge(t.gate));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The plan states memory without knowing this module.
    #[test]
    fn the_plan_knows_the_size_of_a_texel() {
        assert_eq!(size_of::<Texel>() as u64, crate::plan::memory::PER_SOLVED);
    }
}
