//! Makes both sides of every seam look the same: least squares over the texels that a filter reads there.
//!
//! Noise and the position of texels differ on both sides of a seam, so that a renderer shows a step. Following the
//! idea of \[Iwa13\] (Iwanicki, "Lighting Technology of The Last of Us", SIGGRAPH 2013 talks), every seam is visited
//! at two places a texel or more; what the GPU's filters read on both sides should be equal, while texels should stay
//! what they are, in the sense of least squares over all of them at once. What we add:
//!
//! - The filters are the bilinear and the bicubic one, because engines use both. Both read beyond the chart's border:
//!   gutter texels within reach are unknowns like the others, started from what [`super::dilate`] gave them.
//! - A texel moves in proportion to the variance of its chart there, so that exact charts stay and noisy ones come to
//!   them. Bright texels have more variance, so that their own would let the bright side of a step always come to the
//!   dark one, and light would be lost: variance is taken for the same brightness on both sides. One part in a
//!   hundred of the local light counts as uncertain too: a seam between texels of different places is not exact to
//!   the last bit even without noise. A gutter texel is `GUTTER` times as free as the chart beside it.
//! - The weight of a step is one over `TIGHT` squared of the same variance: where texels cannot follow light that
//!   changes sharply along a seam, a small step is better than light smeared along the whole of it.
//! - Seams count only where somebody sees them: not where something stands on them ([`Seam::is_open`]), and not where
//!   the texels lie inside of other geometry.
//!
//! All layers of light are solved with the same matrix, so that direct and indirect light still add up to the whole
//! (where nothing is cut off at zero). Standard errors stay: they are those of the light that was gathered.
//!
//! Texels that no seam joins are separate problems, which run in parallel; the order of sums within one is fixed. Sponza
//! at draft quality (40,267 places, 213,959 texels) takes 1.2 processor seconds.

mod bits;
mod filter;
mod solve;

use rayon::prelude::*;
use tables::format::manifest;

use crate::geom::seams::Seam;
use crate::output::page::{Page, luminance};
use crate::plan::Plan;
pub use bits::Bits;
use filter::{SIDE, Window};
use solve::{Island, Row};

/// Step that weighs as much as a texel moved by its uncertainty, as a part of that.
const TIGHT: f64 = 0.1;

/// Uncertainty of a texel beside its noise, as a part of the light around.
const UNCERTAIN: f64 = 0.01;

/// The same as a part of the step there: steps that noise does not explain are closed from both sides.
const STEP: f64 = 0.3;

/// Most that the variance of a dark side is raised by, to compare it with that of a bright one.
const BRIGHTEST: f64 = 4.0;

/// How much freer a gutter texel is than the chart beside it: only filters see it.
const GUTTER: f64 = 2.0;

/// Least part of what the bilinear filter reads of a chart that has been gathered where somebody could see it.
const SEEN: f64 = 0.5;

/// A page that is ready but for its seams.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    /// The page, gutter included.
    pub page: Page,
    /// Texels whose light was gathered and not filled in.
    pub gathered: Bits,
    /// Texels that show the backs of their surfaces.
    pub backs: Bits,
}

/// What was stitched; sums, so that pages can be joined.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    pairs: u64,
    length: f64,
    places: u64,
    texels: u64,
    before: [Steps; 2],
    after: [Steps; 2],
    /// Sum of luminance over the covered texels of the pages, and of how it changed.
    light: f64,
    change: f64,
}

/// Steps across seams, by weight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Steps {
    weight: f64,
    relative: f64,
    most_relative: f64,
    noisy_weight: f64,
    noise: f64,
    most_noise: f64,
}

impl Steps {
    /// Counts a step of luminance; `noise` is that around it and `value` the mean of both sides.
    fn add(&mut self, weight: f64, step: f64, noise: f64, value: f64) {
        self.weight += weight;
        if 0.0 < value {
            let part = step / value;
            self.relative += weight * part * part;
            self.most_relative = self.most_relative.max(part);
        }
        if 0.0 < noise {
            let part = step / noise;
            self.noisy_weight += weight;
            self.noise += weight * part * part;
            self.most_noise = self.most_noise.max(part);
        }
    }

    fn merge(self, o: Self) -> Self {
        Self {
            weight: self.weight + o.weight,
            relative: self.relative + o.relative,
            most_relative: self.most_relative.max(o.most_relative),
            noisy_weight: self.noisy_weight + o.noisy_weight,
            noise: self.noise + o.noise,
            most_noise: self.most_noise.max(o.most_noise),
        }
    }

    fn manifest(&self) -> manifest::SeamSteps {
        let root = |sum: f64, weight: f64| if 0.0 < weight { (sum / weight).sqrt() } else { 0.0 };
        manifest::SeamSteps {
            rms_noise: root(self.noise, self.noisy_weight),
            max_noise: self.most_noise,
            rms_relative: root(self.relative, self.weight),
            max_relative: self.most_relative,
        }
    }
}

impl Figures {
    /// The figures of both; in page order.
    #[must_use]
    pub fn merge(self, o: Self) -> Self {
        let both = |a: [Steps; 2], b: [Steps; 2]| [a[0].merge(b[0]), a[1].merge(b[1])];
        Self {
            pairs: self.pairs + o.pairs,
            length: self.length + o.length,
            places: self.places + o.places,
            texels: self.texels + o.texels,
            before: both(self.before, o.before),
            after: both(self.after, o.after),
            light: self.light + o.light,
            change: self.change + o.change,
        }
    }

    /// As the manifest has them.
    #[must_use]
    pub fn manifest(&self) -> manifest::Seams {
        let filters =
            |s: &[Steps; 2]| manifest::SeamFilters { bilinear: s[0].manifest(), bicubic: s[1].manifest() };
        manifest::Seams {
            pairs: self.pairs,
            length: self.length,
            places: self.places,
            texels: self.texels,
            before: filters(&self.before),
            after: filters(&self.after),
            mean_change: if 0.0 < self.light { self.change / self.light } else { 0.0 },
        }
    }
}

/// A place on a seam.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Sheets of both sides.
    sheets: [usize; 2],
    windows: [Window; 2],
    /// Length that it stands for, texels.
    weight: f32,
}

/// Stitches the seams between the given pages, of which the first is number `first` of the plan's. Seams that
/// lead to other pages are left.
#[must_use]
pub fn stitch(plan: &Plan, first: usize, sheets: &mut [Sheet]) -> Figures {
    let (places, pairs, length) = places(plan, first, sheets);
    let figures = join(&places, sheets);
    Figures { pairs, length, ..figures }
}

/// Finds the places that somebody sees, how many seams they are on, and how long those are, metres.
fn places(plan: &Plan, first: usize, sheets: &[Sheet]) -> (Vec<Place>, u64, f64) {
    let found: Vec<(f64, Vec<Place>)> =
        plan.seams().list.par_iter().map(|seam| on_seam(plan, seam, first, sheets)).collect();
    let (mut places, mut pairs, mut length) = (Vec::new(), 0, 0.0);
    for (metres, list) in found {
        if !list.is_empty() {
            (pairs, length) = (pairs + 1, length + metres);
            places.extend(list);
        }
    }
    (places, pairs, length)
}

/// The places of one seam, and the length in metres for which they stand.
fn on_seam(plan: &Plan, seam: &Seam, first: usize, sheets: &[Sheet]) -> (f64, Vec<Place>) {
    let (world, bvh, atlas) = (&plan.tracing().world, &plan.tracing().bvh, plan.atlas());
    let sheet = |side| seam.page(world, atlas, side).checked_sub(first).filter(|&s| s < sheets.len());
    let (Some(a), Some(b)) = (sheet(0), sheet(1)) else { return (0.0, Vec::new()) };
    let [texels_a, texels_b] = seam.texels(world, atlas);
    let texels = texels_a.max(texels_b);
    let n = seam.n_places(world, atlas);
    let list: Vec<Place> = (0..n)
        .filter_map(|k| {
            let t = (f32::from(k) + 0.5) / f32::from(n);
            let window = |side: usize, sheet: usize| {
                let page = &sheets[sheet].page;
                Window::around(seam.place(world, atlas, side, t).at, page.width, page.height)
            };
            let windows = [window(0, a)?, window(1, b)?];
            let place = Place { sheets: [a, b], windows, weight: texels / f32::from(n) };
            let seen = [0, 1].iter().all(|&side| place.is_seen(sheets, side));
            let turned = [0, 1].map(|side| place.is_turned(sheets, side));
            let goes_on = (turned[0] == turned[1]) == seam.aligned;
            (seen && goes_on && seam.is_open(world, atlas, bvh, t, turned)).then_some(place)
        })
        .collect();
    let part = list.len() as f64 / f64::from(n);
    (part * f64::from(seam.length(world)), list)
}

impl Place {
    /// Calls `f(texel, weight)` for what a filter reads on one side.
    fn read(&self, sheets: &[Sheet], side: usize, weights: [[f64; SIDE]; 2], f: impl FnMut(usize, f64)) {
        self.windows[side].read(weights, sheets[self.sheets[side]].page.width, f);
    }

    /// Whether enough of what is read on one side was gathered.
    fn is_seen(&self, sheets: &[Sheet], side: usize) -> bool {
        let sheet = &sheets[self.sheets[side]];
        let (mut covered, mut gathered) = (0.0, 0.0);
        self.read(sheets, side, self.windows[side].bilinear(), |i, w| {
            if 0.0 < sheet.page.coverage[i] {
                covered += w;
                gathered += if sheet.gathered.contains(i) { w } else { 0.0 };
            }
        });
        0.0 < covered && SEEN * covered <= gathered
    }

    /// Whether most of what is read on one side shows the back of its surface.
    fn is_turned(&self, sheets: &[Sheet], side: usize) -> bool {
        let sheet = &sheets[self.sheets[side]];
        let mut backs = 0.0;
        self.read(sheets, side, self.windows[side].bilinear(), |i, w| {
            if 0.0 < sheet.page.coverage[i] {
                backs += if sheet.backs.contains(i) { w } else { -w };
            }
        });
        0.0 < backs
    }

    /// Mean squared standard error of luminance of the chart's texels in the window on one side.
    fn variance(&self, sheets: &[Sheet], side: usize) -> f64 {
        let page = &sheets[self.sheets[side]].page;
        let (mut sum, mut covered) = (0.0, 0.0);
        self.read(sheets, side, [[1.0; SIDE]; 2], |i, _| {
            if 0.0 < page.coverage[i] {
                let error = luminance(page.std_err[i]);
                sum += error * error;
                covered += 1.0;
            }
        });
        if 0.0 < covered { sum / covered } else { 0.0 }
    }

    /// Luminance that the filters read on one side, bilinear and bicubic.
    fn luminance(&self, sheets: &[Sheet], side: usize) -> [f64; 2] {
        let page = &sheets[self.sheets[side]].page;
        [self.windows[side].bilinear(), self.windows[side].bicubic()].map(|weights| {
            let mut sum = 0.0;
            self.read(sheets, side, weights, |i, w| sum += w * luminance(page.radiance[i]));
            sum
        })
    }
}

/// What is around a place.
#[derive(Clone, Copy, Debug)]
struct Around {
    /// Variance of luminance on both sides.
    variance: [f64; 2],
    /// Luminance on both sides.
    values: [f64; 2],
    /// Mean of them.
    value: f64,
    /// Step of luminance.
    step: f64,
}

impl Around {
    /// Squared uncertainty that texels on both sides share, whatever their noise.
    fn uncertain(&self) -> f64 {
        let (light, step) = (UNCERTAIN * self.value, STEP * self.step);
        light * light + step * step
    }

    /// Variance of one side as if it were as bright as both in the mean: that of light that some paths find and
    /// others do not goes with its brightness.
    fn even_variance(&self, side: usize) -> f64 {
        let factor = if 0.0 < self.values[side] { self.value / self.values[side] } else { 1.0 };
        self.variance[side] * factor.min(BRIGHTEST)
    }

    fn noise(&self) -> f64 {
        (0.5 * (self.variance[0] + self.variance[1])).sqrt()
    }
}

/// Solves for the texels at the places and enters them.
fn join(places: &[Place], sheets: &mut [Sheet]) -> Figures {
    let around: Vec<Around> = places
        .par_iter()
        .map(|place| {
            let side = |s| (place.variance(sheets, s), place.luminance(sheets, s)[0]);
            let (a, b) = (side(0), side(1));
            Around {
                variance: [a.0, b.0],
                values: [a.1, b.1],
                value: 0.5 * (a.1 + b.1),
                step: (a.1 - b.1).abs(),
            }
        })
        .collect();
    let mut figures = Figures { places: places.len() as u64, ..Figures::default() };
    figures.before = steps(places, &around, sheets);
    let before = light(sheets);
    let islands = islands(places, &around, sheets);
    figures.texels = islands.iter().map(|island| island.texels.len() as u64).sum();
    let starts = starts(sheets);
    let n_layers = sheets.iter().map(|s| s.page.light_layers().count()).min().unwrap_or(0);
    for layer in 0..n_layers {
        let get = |texel: usize| {
            let sheet = starts.partition_point(|&s| s <= texel) - 1;
            let mut layers = sheets[sheet].page.light_layers();
            layers.nth(layer).map_or([0.0; 3], |(_, values)| values[texel - starts[sheet]])
        };
        let solved: Vec<Vec<[f32; 3]>> = islands
            .par_iter()
            .map(|island| island.solve(&island.texels.iter().map(|&t| get(t)).collect::<Vec<_>>()))
            .collect();
        for (island, values) in islands.iter().zip(solved) {
            for (&texel, value) in island.texels.iter().zip(values) {
                let sheet = starts.partition_point(|&s| s <= texel) - 1;
                if let Some((signed, values)) = sheets[sheet].page.light_layers_mut().nth(layer) {
                    let least = if signed { f32::NEG_INFINITY } else { 0.0 };
                    values[texel - starts[sheet]] = value.map(|v| v.max(least));
                }
            }
        }
    }
    sheets.iter_mut().for_each(|sheet| sheet.page.limit_directions());
    figures.after = steps(places, &around, sheets);
    figures.light = before;
    figures.change = light(sheets) - before;
    figures
}

/// First texel of each sheet where all are counted one after the other.
fn starts(sheets: &[Sheet]) -> Vec<usize> {
    let mut next = 0;
    let first = |s: &Sheet| {
        let first = next;
        next += s.page.n_texels();
        first
    };
    sheets.iter().map(first).collect()
}

/// Sum of luminance over covered texels, in their order.
fn light(sheets: &[Sheet]) -> f64 {
    let texels = sheets.iter().flat_map(|s| s.page.radiance.iter().zip(&s.page.coverage));
    texels.filter(|(_, c)| 0.0 < **c).map(|(v, _)| luminance(*v)).sum()
}

/// Steps of luminance by the bilinear and the bicubic filter.
fn steps(places: &[Place], around: &[Around], sheets: &[Sheet]) -> [Steps; 2] {
    let all: Vec<[[f64; 2]; 2]> =
        places.par_iter().map(|place| [0, 1].map(|side| place.luminance(sheets, side))).collect();
    let mut steps = [Steps::default(); 2];
    for ((place, around), [a, b]) in places.iter().zip(around).zip(all) {
        for ((sum, a), b) in steps.iter_mut().zip(a).zip(b) {
            sum.add(f64::from(place.weight), (a - b).abs(), around.noise(), 0.5 * (a + b));
        }
    }
    steps
}

/// Sets of texels that hang together by places, with all that solving for them needs.
fn islands(places: &[Place], around: &[Around], sheets: &[Sheet]) -> Vec<Island> {
    let starts = starts(sheets);
    let n: usize = sheets.iter().map(|s| s.page.n_texels()).sum();
    let rows = |place: &Place| {
        [0, 1].map(|side| {
            let sheet = place.sheets[side];
            place.windows[side].rows(sheets[sheet].page.width).map(|t| t + starts[sheet])
        })
    };
    let mut texels = Bits::new(n);
    for row in places.iter().flat_map(rows).flatten() {
        (0..SIDE).for_each(|i| texels.insert(row + i));
    }
    let count = texels.count();
    // Unknowns of one row of a window follow each other.
    let unknowns = |place: &Place| rows(place).map(|side| side.map(|texel| texels.rank(texel)));
    let mut sets = Sets::new(count);
    for place in places {
        let first = texels.rank(rows(place)[0][0]);
        for row in unknowns(place).into_iter().flatten() {
            (0..4).for_each(|i| sets.join(first, row + i));
        }
    }
    let (island_of, local, sizes) = sets.number();
    let mut islands: Vec<Island> =
        sizes.iter().map(|&n| Island { texels: Vec::with_capacity(n), ..Island::default() }).collect();
    for (texel, &island) in texels.members().zip(&island_of) {
        islands[island as usize].texels.push(texel);
    }
    let island = |place: &Place| island_of[texels.rank(rows(place)[0][0]) as usize] as usize;
    let mut n_places = vec![0; islands.len()];
    places.iter().for_each(|place| n_places[island(place)] += 1);
    let mut members: Vec<Vec<u32>> = n_places.iter().map(|&n| Vec::with_capacity(n)).collect();
    islands.iter_mut().zip(&n_places).for_each(|(island, &n)| island.rows.reserve_exact(n));
    for (place, i) in places.iter().zip(0..) {
        let unknowns = unknowns(place).map(|side| side.map(|u| local[u as usize]));
        let island = island(place);
        islands[island].rows.push(Row {
            texels: unknowns,
            windows: place.windows,
            weight: f64::from(place.weight),
        });
        members[island].push(i);
    }
    islands.par_iter_mut().zip(members).for_each(|(island, members)| {
        let around: Vec<Around> = members.iter().map(|&i| around[i as usize]).collect();
        island.free = freedom(island, &around, sheets, &starts);
        for (row, around) in island.rows.iter_mut().zip(&around) {
            let variance = around.noise() * around.noise() + around.uncertain();
            row.weight = if 0.0 < variance { row.weight / (TIGHT * TIGHT * variance) } else { 0.0 };
        }
    });
    islands
}

/// How far each texel of an island may move, nits.
fn freedom(island: &Island, around: &[Around], sheets: &[Sheet], starts: &[usize]) -> Vec<f64> {
    // Places that read a texel, their variance on its side, and what else is uncertain there.
    let mut sums = vec![[0.0; 3]; island.texels.len()];
    for (row, around) in island.rows.iter().zip(around) {
        for (rows, side) in row.texels.iter().zip([0, 1]) {
            let variance = around.even_variance(side);
            for i in rows.iter().flat_map(|&first| (0..SIDE).map(move |i| first as usize + i)) {
                let [n, v, u] = &mut sums[i];
                (*n, *v, *u) = (*n + 1.0, *v + variance, *u + around.uncertain());
            }
        }
    }
    let free = |(&texel, [n, variance, uncertain]): (&usize, &[f64; 3])| {
        let sheet = starts.partition_point(|&s| s <= texel) - 1;
        let page = &sheets[sheet].page;
        let at = texel - starts[sheet];
        let free = ((variance + uncertain) / n).sqrt();
        if 0.0 < page.coverage[at] { free } else { GUTTER * free }
    };
    island.texels.iter().zip(&sums).map(free).collect()
}

/// Disjoint sets of numbers.
struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    fn new(n: usize) -> Self {
        Self { parent: (0..).take(n).collect() }
    }

    fn root(&mut self, mut i: u32) -> u32 {
        while self.parent[i as usize] != i {
            let above = self.parent[self.parent[i as usize] as usize];
            self.parent[i as usize] = above;
            i = above;
        }
        i
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// The set of each number, its place in there, and the sizes of the sets; sets in the order of their first.
    fn number(&mut self) -> (Vec<u32>, Vec<u32>, Vec<usize>) {
        let (mut set, mut place, mut sizes) = (Vec::new(), Vec::new(), Vec::<usize>::new());
        for i in (0..).take(self.parent.len()) {
            let root = self.root(i);
            if root == i {
                set.push(u32::try_from(sizes.len()).unwrap_or(u32::MAX));
                sizes.push(0);
            } else {
                set.push(set[root as usize]);
            }
            let size = &mut sizes[set[i as usize] as usize];
            place.push(u32::try_from(*size).unwrap_or(u32::MAX));
            *size += 1;
        }
        (set, place, sizes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    /// A page of 12 x 16 texels of one value, of which the first six columns are covered.
    fn sheet(value: f32, std_err: f32) -> Sheet {
        let mut page = Page::new(12, 16);
        for i in (0..page.n_texels()).filter(|i| i % 12 < 8) {
            page.radiance[i] = [value; 3];
        }
        for i in (0..page.n_texels()).filter(|i| i % 12 < 6) {
            (page.coverage[i], page.std_err[i]) = (1.0, [std_err; 3]);
        }
        let gathered = Bits::of(page.n_texels(), |i| i % 12 < 6);
        let backs = Bits::new(page.n_texels());
        Sheet { page, gathered, backs }
    }

    /// Places along the borders of two such pages; rows of the second are a quarter of a texel off.
    fn border() -> Vec<Place> {
        let at = |y: f32| Window::around(Vec2::new(6.0, y), 12, 16).expect("large enough");
        let place = |k: u8| {
            let y = 4.0 + 0.5 * f32::from(k);
            Place { sheets: [0, 1], windows: [at(y), at(y + 0.25)], weight: 0.5 }
        };
        (0..16).map(place).collect()
    }

    #[test]
    fn a_step_in_noise_of_light_is_closed_from_both_sides() {
        // Variance goes with brightness.
        let mut sheets = [sheet(1.0, 0.2), sheet(4.0, 0.4)];
        let figures = join(&border(), &mut sheets);
        let [before, after] = [figures.before, figures.after].map(|s| s.map(|s| s.manifest().max_relative));
        for filter in [0, 1] {
            assert!(1.1 < before[filter] && after[filter] < 0.1, "{before:?} {after:?}");
        }
        assert!(figures.change.abs() < 1e-3 * figures.light, "{figures:?}");
        assert_eq!(figures.places, 16);
        // Five texels away nothing has happened.
        assert_eq!(sheets[0].page.radiance[8 * 12], [1.0; 3]);
        assert_ne!(sheets[0].page.radiance[8 * 12 + 5], [1.0; 3]);
    }

    #[test]
    fn noisy_sides_come_to_exact_ones() {
        let mut sheets = [sheet(1.0, 0.2), sheet(1.2, 0.0)];
        let _ = join(&border(), &mut sheets);
        let moved = [0, 1].map(|s| (sheets[s].page.radiance[8 * 12 + 5][0] - [1.0, 1.2][s]).abs());
        assert!(0.02 < moved[0] && 5.0 * moved[1] < moved[0], "{moved:?}");
    }

    #[test]
    fn black_sides_stay_light() {
        let mut sheets = [sheet(0.0, 0.0), sheet(1.0, 0.5)];
        for layers in sheets.iter_mut().map(|s| &mut s.page) {
            layers.direct = Some(layers.radiance.clone());
            layers.indirect = Some(vec![[0.0; 3]; layers.n_texels()]);
        }
        let _ = join(&border(), &mut sheets);
        for page in sheets.iter().map(|s| &s.page) {
            assert!(page.radiance.iter().flatten().all(|v| v.is_finite() && 0.0 <= *v));
            assert_eq!(page.direct.as_ref(), Some(&page.radiance));
            assert!(page.indirect.iter().flatten().flatten().all(|v| *v == 0.0));
        }
        let mut dark = [sheet(0.0, 0.0), sheet(0.0, 0.0)];
        let figures = join(&border(), &mut dark);
        assert_eq!(dark[0].page, sheet(0.0, 0.0).page);
        assert_eq!(figures.after[0].manifest(), manifest::SeamSteps::default());
    }

    #[test]
    fn what_nobody_gathered_is_not_seen() {
        let mut hidden = sheet(1.0, 0.1);
        let place = border()[3];
        assert!(place.is_seen(&[hidden.clone(), sheet(1.0, 0.1)], 0));
        hidden.gathered = Bits::of(192, |i| i % 12 < 5);
        assert!(!place.is_seen(&[hidden, sheet(1.0, 0.1)], 0));
    }
}
