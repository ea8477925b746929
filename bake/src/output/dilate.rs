//! Gives every texel that a filter may touch a value.
//!
//! Two steps, in this order: [`fill_invalid`] replaces texels that lie inside other geometry by
//! their chart's valid ones; [`fill_gutter`] continues each chart outwards. Both grow ring by ring:
//! a ring is computed from the rings before it alone, so the result depends on neither the order
//! of texels nor the number of threads.

use rayon::prelude::*;

use super::page::Page;

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
/// Coverage stays. Texels out of reach become black with a standard error of 0.
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
        }
        filled += ring.len();
        front = ring;
    }
    for i in (0..n).filter(|&i| charts[i] != NO_CHART && !source[i]) {
        Texel::default().store(page, i);
    }
    Filled {
        filled: filled as u64,
        unreached: (n_invalid - filled) as u64,
        black_charts: (n_charts - bright.len()) as u64,
    }
}

/// Continues every chart outwards by `padding` rings of texels, so that bilinear filters, mip
/// levels and block compression see the chart's own light across its border.
///
/// A gutter texel belongs to the chart whose covered texel is nearest (the first in row order
/// among equals) and is the mean of its filled neighbours (of eight) that belong to that chart.
/// Its coverage and standard error are 0.
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
                (near, mean(page, grid.neighbours(i).filter(same), Errors::Drop))
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

/// Layers of light that a page has at most: radiance, its two parts, what it was before denoising, and three of direction.
const LAYERS: usize = 7;

/// All layers of one texel.
#[derive(Clone, Copy, Default)]
struct Texel {
    light: [[f32; 3]; LAYERS],
    std_err: [f32; 3],
    rmse: [f32; 3],
}

impl Texel {
    fn store(&self, page: &mut Page, i: usize) {
        page.std_err[i] = self.std_err;
        if let Some(rmse) = &mut page.rmse {
            rmse[i] = self.rmse;
        }
        for (layer, light) in page.light_layers_mut().zip(self.light) {
            layer[i] = light;
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
        for (to, (_, layer)) in sum.light.iter_mut().zip(page.light_layers()) {
            add(to, layer[i]);
        }
    }
    if 0.0 < n {
        let divide = |layer: &mut [f32; 3]| layer.iter_mut().for_each(|c| *c /= n);
        sum.light.iter_mut().chain([&mut sum.std_err, &mut sum.rmse]).for_each(divide);
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

    #[test]
    fn empty_pages_are_fine() {
        let mut page = Page::new(0, 0);
        assert_eq!(fill_invalid(&mut page, &[], &[]), Filled::default());
        fill_gutter(&mut page, &[], 4);
    }
}
