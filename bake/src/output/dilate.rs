//! Gives every texel that a filter may touch a value.
//!
//! Two steps, in this order: [`fill_invalid`] replaces texels that lie inside other geometry by
//! their chart's valid ones; [`fill_gutter`] continues each chart outwards. Both grow ring by ring:
//! a ring is computed from the rings before it alone, so the result depends on neither the order
//! of texels nor the number of threads.

use rayon::prelude::*;

use super::page::{Page, luminance};
use super::stitch::Bits;

/// Chart id of a texel that no chart covers.
pub const NO_CHART: u32 = u32::MAX;

/// What [`fill_invalid`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Filled {
    /// Invalid texels that got a value.
    pub filled: u64,
    /// Invalid texels that no valid texel of their chart reaches through its covered ones; they are black.
    pub unreached: u64,
    /// Charts without any valid texel.
    pub black_charts: u64,
}

/// Fills covered texels that are not `valid` from valid ones of the same chart.
///
/// `charts` holds a chart id per texel, [`NO_CHART`] where none covers it; `valid` tells which
/// texels were gathered well. A filled texel is the mean of its filled neighbours (of eight) of the
/// same chart, standard error included: neighbours' errors may agree, so it is not lowered.
/// Coverage stays. Texels out of reach become black with a standard error of 0. The page keeps which were filled.
///
/// # Panics
/// If a slice's length is not the page's number of texels.
pub fn fill_invalid(page: &mut Page, charts: &[u32], valid: &[bool]) -> Filled {
    let n = page.n_texels();
    assert!(charts.len() == n && valid.len() == n, "{n} texels, {} ids, {} flags", charts.len(), valid.len());
    let grid = Grid { width: page.width, height: page.height };
    let mut source: Vec<bool> = (0..n).map(|i| charts[i] != NO_CHART && valid[i]).collect();
    let n_invalid = (0..n).filter(|&i| charts[i] != NO_CHART && !valid[i]).count();
    if n_invalid == 0 {
        return Filled::default();
    }
    let mut black: Vec<u32> = charts.iter().copied().filter(|&c| c != NO_CHART).collect();
    black.sort_unstable();
    black.dedup();
    let n_charts = black.len();
    let mut bright: Vec<u32> = (0..n).filter(|&i| source[i]).map(|i| charts[i]).collect();
    bright.sort_unstable();
    bright.dedup();

    let mut filled = 0;
    let mut which = Bits::new(n);
    // Only texels beside one that is to be filled can fill it.
    let beside = |i: usize| grid.neighbours(i).any(|j| !source[j] && charts[j] == charts[i]);
    let mut front: Vec<usize> = (0..n).filter(|&i| source[i] && beside(i)).collect();
    while !front.is_empty() {
        let wanted = |i: usize, from: usize| !source[i] && charts[i] == charts[from];
        let ring = next_ring(grid, &front, wanted);
        let values: Vec<Texel> = ring
            .par_iter()
            .map(|&i| {
                mean(page, grid.neighbours(i).filter(|&j| source[j] && charts[j] == charts[i]), Errors::Keep)
            })
            .collect();
        for (&i, value) in ring.iter().zip(&values) {
            value.store(page, i);
            source[i] = true;
            which.insert(i);
        }
        filled += ring.len();
        front = ring;
    }
    for i in (0..n).filter(|&i| charts[i] != NO_CHART && !source[i]) {
        Texel::default().store(page, i);
    }
    page.filled = (0 < filled).then_some(which);
    Filled {
        filled: filled as u64,
        unreached: (n_invalid - filled) as u64,
        black_charts: (n_charts - bright.len()) as u64,
    }
}

/// Continues every chart outwards by `padding` rings of texels, so that filters, mip levels and block
/// compression see the chart's own light across its border.
///
/// A gutter texel belongs to the chart whose covered texel is nearest (the first in row order
/// among equals). It is the mean of its filled neighbours (of eight) that belong to that chart, and goes on
/// with the slope of the light there: a plane through the chart's texels within `REACH`, as far as the slope
/// exceeds its own noise. Its coverage and standard error are 0.
///
/// A filter at the chart's border reads half a texel beyond it. Where light rises by `g` a texel, a gutter without
/// slope makes bilinear fetches at the border wrong by `0.50 g` and bicubic ones by `0.52 g`, whatever the number of
/// rings. Root of the mean square error there without slope, and with it, in units of `g`, by noise of a texel
/// (as the test `filters_see_the_slope_go_on` measures it):
///
/// | noise | bilinear | bicubic |
/// |---|---|---|
/// | 0 | 0.50, 0.02 | 0.52, 0.03 |
/// | 0.3 g | 0.58, 0.24 | 0.56, 0.20 |
/// | 1 g | 1.14, 0.81 | 0.87, 0.69 |
/// | 5 g | 5.18, 3.87 | 3.60, 3.22 |
///
/// # Panics
/// If `charts`' length is not the page's number of texels.
pub fn fill_gutter(page: &mut Page, charts: &[u32], padding: u32) {
    let n = page.n_texels();
    assert!(charts.len() == n, "{n} texels, {} ids", charts.len());
    let grid = Grid { width: page.width, height: page.height };
    // For every filled texel, the covered texel it descends from.
    const NONE: u32 = u32::MAX;
    let id = |i: usize| u32::try_from(i).unwrap_or(NONE);
    let mut origin: Vec<u32> = (0..n).map(|i| if charts[i] == NO_CHART { NONE } else { id(i) }).collect();
    // Only texels beside an uncovered one are continued.
    let beside = |i: usize| grid.neighbours(i).any(|j| charts[j] == NO_CHART);
    let mut front: Vec<usize> = (0..n).filter(|&i| charts[i] != NO_CHART && beside(i)).collect();
    for _ in 0..padding {
        let ring = next_ring(grid, &front, |i, _| origin[i] == NONE);
        if ring.is_empty() {
            break;
        }
        let values: Vec<(u32, Texel)> = ring
            .par_iter()
            .map(|&i| {
                let near = grid
                    .neighbours(i)
                    .map(|j| origin[j])
                    .filter(|&o| o != NONE)
                    .min_by_key(|&o| (grid.squared_distance(i, o as usize), o))
                    .unwrap_or(id(i));
                let same =
                    |&j: &usize| origin[j] != NONE && charts[origin[j] as usize] == charts[near as usize];
                let from = || grid.neighbours(i).filter(same);
                let mut texel = mean(page, from(), Errors::Drop);
                texel.go_on(page, &Slope::new(grid, charts, near as usize, i, from()));
                (near, texel)
            })
            .collect();
        for (&i, (near, value)) in ring.iter().zip(&values) {
            value.store(page, i);
            origin[i] = *near;
        }
        front = ring;
    }
}

/// Neighbours of `front` that are `wanted(texel, from)`, each once, in row order.
fn next_ring(grid: Grid, front: &[usize], wanted: impl Fn(usize, usize) -> bool + Sync) -> Vec<usize> {
    let mut ring: Vec<usize> = front
        .par_iter()
        .flat_map_iter(|&from| grid.neighbours(from).map(move |i| (i, from)))
        .filter(|&(i, from)| wanted(i, from))
        .map(|(i, _)| i)
        .collect();
    ring.par_sort_unstable();
    ring.dedup();
    ring
}

#[derive(Clone, Copy)]
struct Grid {
    width: usize,
    height: usize,
}

impl Grid {
    /// The up to eight neighbours within the page, in row order.
    fn neighbours(self, i: usize) -> impl Iterator<Item = usize> {
        let (x, y) = (i % self.width, i / self.width);
        let xs = x.saturating_sub(1)..(x + 2).min(self.width);
        (y.saturating_sub(1)..(y + 2).min(self.height))
            .flat_map(move |v| xs.clone().map(move |u| v * self.width + u))
            .filter(move |&j| j != i)
    }

    /// Column and row.
    fn position(self, i: usize) -> [f64; 2] {
        [(i % self.width) as f64, (i / self.width) as f64]
    }

    /// Texels at most `reach` columns and rows away, and `i` itself, in row order.
    fn around(self, i: usize, reach: usize) -> impl Iterator<Item = usize> {
        let (x, y) = (i % self.width, i / self.width);
        let xs = x.saturating_sub(reach)..(x + reach + 1).min(self.width);
        (y.saturating_sub(reach)..(y + reach + 1).min(self.height))
            .flat_map(move |v| xs.clone().map(move |u| v * self.width + u))
    }

    fn squared_distance(self, i: usize, j: usize) -> usize {
        let dx = (i % self.width).abs_diff(j % self.width);
        let dy = (i / self.width).abs_diff(j / self.width);
        dx * dx + dy * dy
    }
}

/// Whether a mean carries the standard errors of what it is made of.
#[derive(Clone, Copy, PartialEq)]
enum Errors {
    Keep,
    Drop,
}

/// Layers of light that a page has at most: radiance, its two parts, and three of direction.
const LAYERS: usize = 6;

/// All layers of one texel.
#[derive(Clone, Copy, Default)]
struct Texel {
    light: [[f32; 3]; LAYERS],
    std_err: [f32; 3],
    noisy: [f32; 3],
    rmse: [f32; 3],
}

impl Texel {
    fn store(&self, page: &mut Page, i: usize) {
        page.std_err[i] = self.std_err;
        for (layer, value) in [(&mut page.noisy, self.noisy), (&mut page.rmse, self.rmse)] {
            if let Some(layer) = layer {
                layer[i] = value;
            }
        }
        for ((_, layer), light) in page.light_layers_mut().zip(self.light) {
            layer[i] = light;
        }
    }
}

/// Columns and rows within which the slope of light at a border is measured.
const REACH: usize = 2;

/// Least spread of texels that gives a slope its whole weight, squared texels: along a row of single texels there is none
/// across it.
const SPREAD: f64 = 0.5;

/// Greatest step from one ring to the next, as a part of the light there.
const STEEPEST: f64 = 0.5;

/// How light goes on at a border: a step away from there is a weighted sum of texels.
struct Slope {
    /// Texel from which differences are taken.
    near: usize,
    weights: Vec<(usize, f64)>,
}

impl Slope {
    /// From the middle of the texels `from` to texel `to`, by the plane through the texels of its chart around `near`.
    fn new(grid: Grid, charts: &[u32], near: usize, to: usize, from: impl Iterator<Item = usize>) -> Self {
        let middle = |texels: &mut dyn Iterator<Item = usize>| {
            let (mut sum, mut n) = ([0.0; 2], 0.0_f64);
            for p in texels.map(|i| grid.position(i)) {
                (sum[0], sum[1], n) = (sum[0] + p[0], sum[1] + p[1], n + 1.0);
            }
            sum.map(|s| s / n.max(1.0))
        };
        let mut from = from;
        let (end, start) = (grid.position(to), middle(&mut from));
        let step = [end[0] - start[0], end[1] - start[1]];
        let chart = || grid.around(near, REACH).filter(|&j| charts[j] == charts[near]);
        let centre = middle(&mut chart());
        let offset = |j: usize| {
            let p = grid.position(j);
            [p[0] - centre[0], p[1] - centre[1]]
        };
        let (mut xx, mut xy, mut yy) = (SPREAD, 0.0, SPREAD);
        for [x, y] in chart().map(offset) {
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        }
        let determinant = xx * yy - xy * xy;
        let along =
            [(yy * step[0] - xy * step[1]) / determinant, (xx * step[1] - xy * step[0]) / determinant];
        let weights = chart().map(|j| {
            let [x, y] = offset(j);
            (j, along[0] * x + along[1] * y)
        });
        Self { near, weights: weights.collect() }
    }

    /// The step of one layer.
    fn of(&self, layer: &[[f32; 3]]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for &(j, w) in &self.weights {
            for c in 0..3 {
                sum[c] += w * (f64::from(layer[j][c]) - f64::from(layer[self.near][c]));
            }
        }
        sum
    }

    /// The part of the step by which it exceeds its noise: what is left of its square without its variance.
    fn certain(&self, page: &Page) -> f64 {
        let step = self.of(&page.radiance);
        let step = 0.2126 * step[0] + 0.7152 * step[1] + 0.0722 * step[2];
        let variance: f64 = self.weights.iter().map(|&(j, w)| (w * luminance(page.std_err[j])).powi(2)).sum();
        let square = step * step;
        if square <= variance { 0.0 } else { 1.0 - variance / square }
    }
}

impl Texel {
    /// Adds the step of a slope to light: the same part of it in all layers, so that direct and indirect light add up
    /// to the whole, and no more than leaves light in all of them.
    fn go_on(&mut self, page: &Page, slope: &Slope) {
        let mut part = slope.certain(page);
        if part <= 0.0 {
            return;
        }
        let step = slope.of(&page.radiance);
        let length = (0.2126 * step[0] + 0.7152 * step[1] + 0.0722 * step[2]).abs();
        let most = STEEPEST * luminance(self.light[0]);
        if most < part * length {
            part = most / length;
        }
        let signed = |name: &str| name.starts_with("sh1");
        let steps: Vec<([f64; 3], bool)> =
            page.light_layers().map(|(name, layer)| (slope.of(layer), signed(name))).collect();
        for (value, (step, _)) in self.light.iter().zip(&steps).filter(|(_, (_, signed))| !signed) {
            for (v, s) in value.iter().zip(step) {
                let left = f64::from(*v) + part * s;
                if left < 0.0 {
                    part = f64::from(*v) / -s;
                }
            }
        }
        for (value, (step, signed)) in self.light.iter_mut().zip(steps) {
            let least = if signed { f64::NEG_INFINITY } else { 0.0 };
            for (v, s) in value.iter_mut().zip(step) {
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
                let sum = (f64::from(*v) + part * s).max(least) as f32;
                *v = sum;
            }
        }
    }
}

/// Mean of the given texels in the given order; black where there are none.
fn mean(page: &Page, texels: impl Iterator<Item = usize>, errors: Errors) -> Texel {
    let mut sum = Texel::default();
    let mut n = 0.0_f32;
    let add = |to: &mut [f32; 3], from: [f32; 3]| to.iter_mut().zip(from).for_each(|(t, f)| *t += f);
    for i in texels {
        n += 1.0;
        if errors == Errors::Keep {
            add(&mut sum.std_err, page.std_err[i]);
            if let Some(rmse) = &page.rmse {
                add(&mut sum.rmse, rmse[i]);
            }
        }
        if let Some(noisy) = &page.noisy {
            add(&mut sum.noisy, noisy[i]);
        }
        for (to, (_, layer)) in sum.light.iter_mut().zip(page.light_layers()) {
            add(to, layer[i]);
        }
    }
    if 0.0 < n {
        let divide = |layer: &mut [f32; 3]| layer.iter_mut().for_each(|c| *c /= n);
        sum.light.iter_mut().chain([&mut sum.std_err, &mut sum.noisy, &mut sum.rmse]).for_each(divide);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    const O: u32 = NO_CHART;

    /// A page whose charts are given row by row and whose covered texels hold `value(chart)`.
    fn page(width: usize, charts: &[u32], value: impl Fn(u32) -> f32) -> Page {
        let mut page = Page::new(width, charts.len() / width);
        page.direct = Some(vec![[0.0; 3]; charts.len()]);
        for (i, &chart) in charts.iter().enumerate().filter(|(_, chart)| **chart != O) {
            page.radiance[i] = [value(chart); 3];
            page.direct.as_mut().expect("just set")[i] = [value(chart) / 2.0; 3];
            page.coverage[i] = 1.0;
            page.std_err[i] = [0.5; 3];
        }
        page
    }

    fn reds(page: &Page) -> Vec<f32> {
        page.radiance.iter().map(|c| c[0]).collect()
    }

    #[test]
    fn invalid_texels_take_from_their_own_chart() {
        #[rustfmt::skip]
        let charts = [
            1, 1, 1, 2, 2,
            1, 1, 1, 2, 2,
            3, 3, 3, 2, 2,
        ];
        let mut page = page(5, &charts, |chart| f32::from(u8::try_from(chart).expect("small")));
        let mut valid = [true; 15];
        for i in [1, 2, 6, 7, 10, 11, 12] {
            valid[i] = false;
            page.radiance[i] = [f32::NAN; 3];
            page.std_err[i] = [f32::NAN; 3];
        }
        let report = fill_invalid(&mut page, &charts, &valid);
        assert_eq!(report, Filled { filled: 4, unreached: 3, black_charts: 1 });
        #[rustfmt::skip]
        let expected = [
            1.0, 1.0, 1.0, 2.0, 2.0,
            1.0, 1.0, 1.0, 2.0, 2.0,
            0.0, 0.0, 0.0, 2.0, 2.0,
        ];
        assert_eq!(reds(&page), expected);
        assert_eq!(page.std_err[7], [0.5; 3]);
        assert_eq!(page.direct.as_ref().expect("set")[7], [0.5; 3]);
        assert!(page.coverage.iter().all(|&c| c == 1.0));
    }

    #[test]
    fn filling_does_not_jump_over_a_gap() {
        let charts = [1, O, 1];
        let mut page = page(3, &charts, |_| 4.0);
        let report = fill_invalid(&mut page, &charts, &[true, false, false]);
        assert_eq!(report, Filled { filled: 0, unreached: 1, black_charts: 0 });
        assert_eq!(reds(&page), [4.0, 0.0, 0.0]);
    }

    #[test]
    fn gutter_grows_by_exactly_the_padding() {
        let mut charts = [O; 49];
        charts[24] = 7;
        for (padding, side) in [(0, 1), (1, 3), (2, 5), (3, 7), (9, 7)] {
            let mut page = page(7, &charts, |_| 2.0);
            fill_gutter(&mut page, &charts, padding);
            assert_eq!(reds(&page).iter().filter(|&&v| v == 2.0).count(), side * side);
            assert_eq!(page.coverage.iter().filter(|&&c| 0.0 < c).count(), 1);
            assert_eq!(page.std_err.iter().filter(|e| 0.0 < e[0]).count(), 1);
        }
    }

    #[test]
    fn gutters_meet_half_way_and_do_not_mix() {
        let mut charts = [O; 9 * 3];
        for row in 0..3 {
            charts[row * 9] = 1;
            charts[row * 9 + 7] = 2;
            charts[row * 9 + 8] = 2;
        }
        let mut page = page(9, &charts, |chart| if chart == 1 { 1.0 } else { 100.0 });
        fill_gutter(&mut page, &charts, 8);
        let row = [1.0, 1.0, 1.0, 1.0, 100.0, 100.0, 100.0, 100.0, 100.0];
        for y in 0..3 {
            assert_eq!(reds(&page)[y * 9..][..9], row, "row {y}");
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let (width, n) = (64, 64 * 48);
        let charts: Vec<u32> = (0..n)
            .map(|i| {
                let cell = u32::try_from(i % width / 16 + i / width / 12 * 4).expect("small");
                if i % 7 < 2 || i % 16 < 5 { O } else { cell }
            })
            .collect();
        let valid: Vec<bool> = (0..n).map(|i| i * i % 11 < 4).collect();
        let bake = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| {
                let mut page = page(width, &charts, |chart| 0.1 + 0.3 * chart as f32);
                for i in 0..n {
                    page.radiance[i][1] *= 1.0 + 0.01 * (i % 13) as f32;
                }
                let report = fill_invalid(&mut page, &charts, &valid);
                fill_gutter(&mut page, &charts, 4);
                (page, report)
            })
        };
        let one = bake(1);
        assert!(0 < one.1.filled);
        assert_eq!(one, bake(3));
    }

    /// What filters read at a straight border, over a slope of light, with and without the gutter's own slope: root of
    /// the mean square error in units of what light rises by from texel to texel.
    fn errors_at_a_border(noise: f32, sloping: bool) -> [f64; 2] {
        let (width, height, inside) = (64, 256, 32);
        let charts: Vec<u32> = (0..width * height).map(|i| if i % width < inside { 1 } else { O }).collect();
        let light = |x: f64, y: f64| 100.0 + x + 0.3 * y;
        let mut page = Page::new(width, height);
        for i in (0..width * height).filter(|i| charts[*i] != O) {
            let exact = 100.0 + (i % width) as f32 + 0.5 + 0.3 * ((i / width) as f32 + 0.5);
            let mut sequence = crate::sample::Sequence::new(crate::sample::sequence::key(5, 1, i as u64), 0);
            // The sum of twelve uniform numbers has a variance of one.
            let normal: f32 = (0..3).flat_map(|_| sequence.next4()).sum::<f32>() - 6.0;
            page.radiance[i] = [exact + noise * normal; 3];
            page.std_err[i] = [noise; 3];
            page.coverage[i] = 1.0;
        }
        if sloping {
            fill_gutter(&mut page, &charts, 2);
        } else {
            for y in 0..height {
                for x in inside..inside + 2 {
                    page.radiance[y * width + x] = page.radiance[y * width + inside - 1];
                }
            }
        }
        let read = |x: usize, y: usize| f64::from(page.radiance[y * width + x][0]);
        // At the border, half-way between the rows' centres and along them.
        let filters = [
            ([0.0, 0.5, 0.5, 0.0], [0.0, 1.0, 0.0, 0.0]),
            ([1.0 / 48.0, 23.0 / 48.0, 23.0 / 48.0, 1.0 / 48.0], [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0, 0.0]),
        ];
        filters.map(|(wx, wy)| {
            let mut sum = 0.0;
            let rows = 4..height - 4;
            let n = rows.len() as f64;
            for y in rows {
                let mut value = 0.0;
                for (j, wy) in wy.iter().enumerate() {
                    for (i, wx) in wx.iter().enumerate() {
                        value += wy * wx * read(inside - 2 + i, y + j - 1);
                    }
                }
                sum += (value - light(inside as f64, y as f64 + 0.5)).powi(2);
            }
            (sum / n).sqrt()
        })
    }

    #[test]
    fn filters_see_the_slope_go_on() {
        for (noise, least_gain) in [(0.0, 20.0), (0.3, 1.3), (1.0, 1.0), (5.0, 0.97)] {
            let (flat, sloping) = (errors_at_a_border(noise, false), errors_at_a_border(noise, true));
            let text = format!("noise {noise}: bilinear and bicubic {flat:.3?} flat, {sloping:.3?} sloping");
            for filter in 0..2 {
                assert!(least_gain * sloping[filter] <= flat[filter], "{text}");
            }
        }
    }

    #[test]
    fn empty_pages_are_fine() {
        let mut page = Page::new(0, 0);
        assert_eq!(fill_invalid(&mut page, &[], &[]), Filled::default());
        fill_gutter(&mut page, &[], 4);
    }
}
