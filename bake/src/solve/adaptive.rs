//! Where the next paths go.
//!
//! The error figure of a map is the root of the mean squared standard error. For a given number of paths
//! it is least when each texel gets paths in proportion to the standard deviation of one path there
//! (\[Coc77\] Cochran, "Sampling Techniques", 3rd edition, section 5.5: Neyman's allocation with equal
//! costs). A texel takes the deviation of its neighbours, not its own: if the paths that a texel has decided
//! how many more it gets, those that were bright by luck would be outweighed by more new paths than those
//! that were dark by luck, and the mean would come out too dark (0.35 % on the hall, three seeds).

use crate::geom::texel::TexelMap;
use crate::geom::world::luminance;
use crate::solve::lightmap::{Gathered, More, Solution, Texel};
use crate::solve::visible::Validity;

/// Paths that a texel gets in one round are multiples of this.
const UNIT: u32 = 4;

/// A texel gets at least one sample of suns and lamps for so many paths: where neither it nor its neighbours has seen the
/// edge of a shadow yet, it would get none for ever.
const LEAST_SMALL: u32 = 4;

/// On the way to an error a texel gets at least this part of the mean paths so far, and as many samples of suns and lamps:
/// where the first paths and those of the neighbours found nothing, because what is bright is rare, nothing would ever ask for more.
const LEAST_SHARE: f64 = 0.25;

/// Most paths of a texel.
const MOST: f32 = 65_536.0;

/// Steps of the bisection for the proportion between deviation and paths, far finer than a path.
const BISECTIONS: u32 = 40;

/// What a round wants to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// This many paths per covered texel on average, earlier rounds included.
    Mean(f64),
    /// This error, in nits.
    Error(f64),
}

/// A round as it was planned.
#[derive(Clone, Debug, PartialEq)]
pub struct Round {
    /// New samples of each texel.
    pub more: Vec<More>,
    /// What they cost, in paths with their share of suns and lamps.
    pub total: f64,
}

/// Plans a round for the texels of a page.
///
/// A kind of sample that costs less gets more of them, by the root of the ratio (\[Coc77\] eq. 5.23).
#[must_use]
pub fn plan(map: &TexelMap, solution: &Solution, goal: Goal) -> Round {
    let texels = &solution.texels;
    let cost = solution.cost;
    let small = smoothed(map, texels, |t| &t.small);
    let paths = smoothed(map, texels, |t| &t.paths);
    let new = |scale: f64, sigma: f32, cost: f64, has: u32| {
        #[expect(clippy::cast_possible_truncation, reason = "samples are few")]
        let wanted = (scale * f64::from(sigma) / cost.sqrt()).min(f64::from(MOST)) as f32;
        let unit = UNIT as f32;
        let more = ((wanted - has as f32) / unit).round() * unit;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most MOST")]
        let more = if wanted.is_finite() { more.max(0.0) as u32 } else { 0 };
        more
    };
    let n = texels.len() as f64;
    // Only towards an error: means are planned with an even share from the start.
    let share = if matches!(goal, Goal::Error(_)) { LEAST_SHARE } else { 0.0 };
    let mean = texels.iter().map(|t| f64::from(t.paths.samples)).sum::<f64>() / n.max(1.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of paths")]
    let floor = (share * mean) as u32;
    let more = |scale: f64, k: usize| {
        let t = &texels[k];
        let lit = if t.validity != Validity::Hidden { floor } else { 0 };
        let more = new(scale, paths[k], cost.path_at(t), t.paths.samples)
            .max(lit.saturating_sub(t.paths.samples).next_multiple_of(UNIT));
        let least = ((t.paths.samples + more) / LEAST_SMALL).max(lit).saturating_sub(t.small.samples);
        let least = least.next_multiple_of(UNIT);
        let wanted = new(scale, small[k], cost.small, t.small.samples);
        More { small: if 0.0 < cost.small { wanted.max(least) } else { 0 }, paths: more }
    };
    let valid = texels.iter().filter(|t| t.validity != Validity::Hidden).count() as f64;
    let square = |sigma: f32, samples: u32| f64::from(sigma).powi(2) / f64::from(samples.max(1));
    // Both grow with the scale: the cost, and how far the error is below the goal.
    let enough = |scale: f64| match goal {
        Goal::Mean(mean) => {
            let total: f64 = (0..texels.len())
                .map(|k| {
                    let (t, m) = (&texels[k], more(scale, k));
                    cost.of(t, t.small.samples + m.small, t.paths.samples + m.paths)
                })
                .sum();
            mean * n <= total
        }
        Goal::Error(error) => {
            let squares: f64 = (0..texels.len())
                .map(|k| {
                    let (t, m) = (&texels[k], more(scale, k));
                    square(small[k], t.small.samples + m.small) + square(paths[k], t.paths.samples + m.paths)
                })
                .sum();
            squares <= error * error * valid
        }
    };
    let strongest = small.iter().chain(&paths).copied().fold(f32::MIN_POSITIVE, f32::max);
    let strongest = f64::from(strongest);
    // At this scale the strongest texel gets about one path. A million times the greatest number serves the weak ones.
    let (mut lo, mut hi) = (0.0, strongest.recip());
    while !enough(hi) && hi * strongest < 2.0 * f64::from(MOST) * 1e6 {
        (lo, hi) = (hi, hi * 2.0);
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (lo + hi);
        if enough(middle) { hi = middle } else { lo = middle }
    }
    let more: Vec<More> = (0..texels.len()).map(|k| more(hi, k)).collect();
    let total = texels.iter().zip(&more).map(|(t, m)| cost.of(t, m.small, m.paths)).sum();
    Round { more, total }
}

/// What [`Goal::Error`] takes the error for at present, nits: that of the neighbours' deviations. It differs a
/// little from [`error`], which is what the texels themselves say.
#[must_use]
pub fn predicted(map: &TexelMap, texels: &[Texel]) -> f64 {
    let valid = texels.iter().filter(|t| t.validity != Validity::Hidden).count() as f64;
    let kinds: [fn(&Texel) -> &Gathered; 2] = [|t| &t.small, |t| &t.paths];
    let squares: f64 = kinds
        .into_iter()
        .map(|kind| {
            let sigma = smoothed(map, texels, kind);
            sigma
                .iter()
                .zip(texels)
                .map(|(&s, t)| f64::from(s).powi(2) / f64::from(kind(t).samples.max(1)))
                .sum::<f64>()
        })
        .sum();
    (squares / valid.max(1.0)).sqrt()
}

/// Root mean squared standard error of the texels that are not hidden, scaled by the audit if there was one, and their mean
/// luminance, nits.
#[must_use]
pub fn error(solution: &Solution) -> (f64, f64) {
    scaled_error(solution, |t| solution.factor(t))
}

/// The same as the samples say it, nits, whatever an audit makes of it.
#[must_use]
pub fn own_error(solution: &Solution) -> f64 {
    scaled_error(solution, |_| 1.0).0
}

fn scaled_error(solution: &Solution, factor: impl Fn(&Texel) -> f64) -> (f64, f64) {
    let valid = || solution.texels.iter().filter(|t| t.validity != Validity::Hidden);
    let n = (valid().count() as f64).max(1.0);
    let mut sums = (0.0, 0.0);
    for t in valid() {
        sums.0 += (factor(t) * f64::from(luminance(t.std_err()))).powi(2);
        sums.1 += f64::from(luminance(t.value()));
    }
    ((sums.0 / n).sqrt(), sums.1 / n)
}

/// Standard deviation of one sample's luminance at each texel, nits: the root of the mean variance of its
/// eight neighbours on the page, or its own where it has none.
fn smoothed(map: &TexelMap, texels: &[Texel], kind: impl Fn(&Texel) -> &Gathered) -> Vec<f32> {
    let (w, h) = (map.width as usize, map.height as usize);
    let mut page = vec![f32::NAN; w * h];
    for (t, &at) in texels.iter().zip(&map.texels) {
        // What lies behind a one-sided surface is filled from its chart: no path there is of use. What seems enclosed may be kept.
        if t.validity != Validity::Hidden {
            let g = kind(t);
            page[at as usize] = luminance(g.std_err) * (g.samples as f32).sqrt();
        }
    }
    map.texels
        .iter()
        .map(|&at| {
            let (x, y) = (at as usize % w, at as usize / w);
            if page[at as usize].is_nan() {
                return 0.0;
            }
            let (mut sum, mut n) = (0.0f64, 0.0);
            for v in y.saturating_sub(1)..(y + 2).min(h) {
                for u in x.saturating_sub(1)..(x + 2).min(w) {
                    // Squares may be beyond f32.
                    let sigma = f64::from(page[v * w + u]);
                    if !sigma.is_nan() && (u, v) != (x, y) {
                        sum += sigma * sigma;
                        n += 1.0;
                    }
                }
            }
            #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
            let mean = (sum / n).sqrt() as f32;
            if n == 0.0 { page[at as usize] } else { mean }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::lightmap::Cost;
    use glam::Vec3;

    /// A row of texels with the given standard errors after 16 paths.
    fn row(errors: &[f32]) -> (TexelMap, Solution) {
        #[expect(clippy::cast_possible_truncation, reason = "a few texels")]
        let n = errors.len() as u32;
        // Two columns apart: no texel is its neighbour's neighbour.
        let mut map = TexelMap::default();
        (map.width, map.height) = (2 * n, 1);
        map.texels = (0..n).map(|i| 2 * i).collect();
        let texel = |&e: &f32| {
            let mut texel = Texel::default();
            texel.paths =
                Gathered { mean: Vec3::ONE, std_err: Vec3::splat(e), samples: 16, ..Gathered::default() };
            texel
        };
        (map, Solution { texels: errors.iter().map(texel).collect(), ..Solution::default() })
    }

    #[test]
    fn paths_go_where_the_deviation_is() {
        let (map, texels) = row(&[0.0, 1.0, 2.0, 4.0]);
        let round = plan(&map, &texels, Goal::Mean(200.0));
        assert_eq!(round.more[0].paths, 0, "what is known exactly needs nothing more");
        let all: Vec<f64> = round.more.iter().map(|m| f64::from(m.paths) + 16.0).collect();
        assert!((all[2] / all[1] - 2.0).abs() < 0.1 && (all[3] / all[2] - 2.0).abs() < 0.1, "{all:?}");
        assert!((all.iter().sum::<f64>() / 4.0 - 200.0).abs() < 4.0, "{all:?}");
    }

    #[test]
    fn an_error_is_reached_and_not_overshot() {
        let (map, texels) = row(&[0.5, 1.0, 2.0, 4.0, 0.1]);
        for goal in [0.1, 0.5, 1.5] {
            let round = plan(&map, &texels, Goal::Error(goal));
            let squares: f64 = texels
                .texels
                .iter()
                .zip(&round.more)
                .map(|(t, m)| f64::from(t.std_err().x).powi(2) * 16.0 / (16.0 + f64::from(m.paths)))
                .sum();
            let reached = (squares / 5.0).sqrt();
            assert!((reached / goal - 1.0).abs() < 0.1, "{goal}: {reached}");
        }
        // What is reached already asks for nothing.
        assert_eq!(plan(&map, &texels, Goal::Error(100.0)).total, 0.0);
        assert_eq!(plan(&map, &texels, Goal::Mean(10.0)).total, 0.0);
    }

    /// Two kinds of samples with the same deviation: the cheap one gets more, by the root of the ratio of costs.
    #[test]
    fn cheap_samples_are_taken_more_often() {
        let (map, mut solution) = row(&[1.0, 1.0]);
        solution.cost = Cost { small: 0.2, path: 0.8, open_path: 0.8 };
        solution.texels[0].small = solution.texels[0].paths;
        let round = plan(&map, &solution, Goal::Mean(400.0));
        let [both, one] = [round.more[0], round.more[1]];
        assert!((f64::from(both.small + 16) / f64::from(both.paths + 16) - 2.0).abs() < 0.05, "{both:?}");
        assert_eq!((one.small, one.paths), ((one.paths + 16).div_ceil(16) * 4, both.paths));
    }

    /// Poison: nothing lit, no texels, and goals that cannot be reached end all the same.
    #[test]
    fn hopeless_goals_end() {
        let (map, texels) = row(&[0.0, 0.0]);
        assert_eq!(plan(&map, &texels, Goal::Mean(1e6)).total, 0.0);
        assert_eq!(plan(&map, &texels, Goal::Error(0.0)).total, 0.0);
        let (map, texels) = row(&[]);
        assert_eq!(plan(&map, &texels, Goal::Mean(64.0)).total, 0.0);
        let (map, texels) = row(&[1.0]);
        assert_eq!(plan(&map, &texels, Goal::Error(0.0)).total, f64::from(65_536 - 16));
    }
}
