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
use crate::solve::lightmap::{Texel, Validity};

/// Paths that a texel gets in one round are multiples of this.
const UNIT: f32 = 4.0;

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
    /// New paths of each texel.
    pub paths: Vec<u32>,
    /// Their sum.
    pub total: u64,
}

/// Plans a round for the texels of a page.
#[must_use]
pub fn plan(map: &TexelMap, texels: &[Texel], goal: Goal) -> Round {
    let sigma = smoothed(map, texels);
    let new = |scale: f64, k: usize| {
        #[expect(clippy::cast_possible_truncation, reason = "paths are few")]
        let wanted = (scale * f64::from(sigma[k])).min(f64::from(MOST)) as f32;
        let more = ((wanted - texels[k].paths as f32) / UNIT).round() * UNIT;
        more.max(0.0)
    };
    let n = texels.len() as f64;
    let valid = texels.iter().filter(|t| t.validity == Validity::Valid).count() as f64;
    // Both grow with the scale: the paths, and how far the error is below the goal.
    let enough = |scale: f64| match goal {
        Goal::Mean(mean) => {
            let total: f64 =
                (0..texels.len()).map(|k| f64::from(texels[k].paths) + f64::from(new(scale, k))).sum();
            mean * n <= total
        }
        Goal::Error(error) => {
            let squares: f64 = (0..texels.len())
                .filter(|&k| 0.0 < sigma[k])
                .map(|k| {
                    let paths = f64::from(texels[k].paths) + f64::from(new(scale, k));
                    f64::from(sigma[k]).powi(2) / paths.max(1.0)
                })
                .sum();
            squares <= error * error * valid
        }
    };
    let strongest = f64::from(sigma.iter().copied().fold(f32::MIN_POSITIVE, f32::max));
    // At this scale the strongest texel gets one path. A million times the greatest number serves the weak ones.
    let (mut lo, mut hi) = (0.0, strongest.recip());
    while !enough(hi) && hi * strongest < 2.0 * f64::from(MOST) * 1e6 {
        (lo, hi) = (hi, hi * 2.0);
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (lo + hi);
        if enough(middle) { hi = middle } else { lo = middle }
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most MOST")]
    let paths: Vec<u32> = (0..texels.len()).map(|k| new(hi, k) as u32).collect();
    let total = paths.iter().map(|&n| u64::from(n)).sum();
    Round { paths, total }
}

/// What [`Goal::Error`] takes the error for at present, nits: that of the neighbours' deviations. It differs a
/// little from [`error`], which is what the texels themselves say.
#[must_use]
pub fn predicted(map: &TexelMap, texels: &[Texel]) -> f64 {
    let valid = texels.iter().filter(|t| t.validity == Validity::Valid).count() as f64;
    let squares: f64 = smoothed(map, texels)
        .iter()
        .zip(texels)
        .map(|(&s, t)| f64::from(s).powi(2) / f64::from(t.paths).max(1.0))
        .sum();
    (squares / valid.max(1.0)).sqrt()
}

/// Root mean squared standard error of the valid texels, and their mean luminance, nits.
#[must_use]
pub fn error(texels: &[Texel]) -> (f64, f64) {
    let valid = || texels.iter().filter(|t| t.validity == Validity::Valid);
    let n = (valid().count() as f64).max(1.0);
    let mut sums = (0.0, 0.0);
    for t in valid() {
        sums.0 += f64::from(luminance(t.std_err)).powi(2);
        sums.1 += f64::from(luminance(t.direct + t.indirect));
    }
    ((sums.0 / n).sqrt(), sums.1 / n)
}

/// Standard deviation of one path's luminance at each texel, nits: the root of the mean variance of its
/// eight neighbours on the page, or its own where it has none.
fn smoothed(map: &TexelMap, texels: &[Texel]) -> Vec<f32> {
    let (w, h) = (map.width as usize, map.height as usize);
    let mut page = vec![f32::NAN; w * h];
    for (t, &at) in texels.iter().zip(&map.texels) {
        // What lies inside a body is filled from its chart: no path there is of use.
        if t.validity == Validity::Valid {
            page[at as usize] = luminance(t.std_err).powi(2) * t.paths as f32;
        }
    }
    map.texels
        .iter()
        .map(|&at| {
            let (x, y) = (at as usize % w, at as usize / w);
            if page[at as usize].is_nan() {
                return 0.0;
            }
            let (mut sum, mut n) = (0.0, 0.0);
            for v in y.saturating_sub(1)..(y + 2).min(h) {
                for u in x.saturating_sub(1)..(x + 2).min(w) {
                    let variance = page[v * w + u];
                    if !variance.is_nan() && (u, v) != (x, y) {
                        sum += variance;
                        n += 1.0;
                    }
                }
            }
            if n == 0.0 { page[at as usize].sqrt() } else { (sum / n).sqrt() }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    /// A row of texels with the given standard errors after 16 paths.
    fn row(errors: &[f32]) -> (TexelMap, Vec<Texel>) {
        #[expect(clippy::cast_possible_truncation, reason = "a few texels")]
        let n = errors.len() as u32;
        // Two columns apart: no texel is its neighbour's neighbour.
        let mut map = TexelMap::default();
        (map.width, map.height) = (2 * n, 1);
        map.texels = (0..n).map(|i| 2 * i).collect();
        let texel = |&e: &f32| {
            let mut texel = Texel::default();
            (texel.std_err, texel.direct, texel.paths) = (Vec3::splat(e), Vec3::ONE, 16);
            texel
        };
        (map, errors.iter().map(texel).collect())
    }

    #[test]
    fn paths_go_where_the_deviation_is() {
        let (map, texels) = row(&[0.0, 1.0, 2.0, 4.0]);
        let round = plan(&map, &texels, Goal::Mean(200.0));
        assert_eq!(round.paths[0], 0, "what is known exactly needs nothing more");
        let all: Vec<f64> = round.paths.iter().map(|&p| f64::from(p) + 16.0).collect();
        assert!((all[2] / all[1] - 2.0).abs() < 0.1 && (all[3] / all[2] - 2.0).abs() < 0.1, "{all:?}");
        assert!((all.iter().sum::<f64>() / 4.0 - 200.0).abs() < 4.0, "{all:?}");
    }

    #[test]
    fn an_error_is_reached_and_not_overshot() {
        let (map, texels) = row(&[0.5, 1.0, 2.0, 4.0, 0.1]);
        for goal in [0.1, 0.5, 1.5] {
            let round = plan(&map, &texels, Goal::Error(goal));
            let squares: f64 = texels
                .iter()
                .zip(&round.paths)
                .map(|(t, &n)| f64::from(t.std_err.x).powi(2) * 16.0 / (16.0 + f64::from(n)))
                .sum();
            let reached = (squares / 5.0).sqrt();
            assert!((reached / goal - 1.0).abs() < 0.1, "{goal}: {reached}");
        }
        // What is reached already asks for nothing.
        assert_eq!(plan(&map, &texels, Goal::Error(100.0)).total, 0);
        assert_eq!(plan(&map, &texels, Goal::Mean(10.0)).total, 0);
    }

    /// Poison: nothing lit, no texels, and goals that cannot be reached end all the same.
    #[test]
    fn hopeless_goals_end() {
        let (map, texels) = row(&[0.0, 0.0]);
        assert_eq!(plan(&map, &texels, Goal::Mean(1e6)).total, 0);
        assert_eq!(plan(&map, &texels, Goal::Error(0.0)).total, 0);
        let (map, texels) = row(&[]);
        assert_eq!(plan(&map, &texels, Goal::Mean(64.0)).total, 0);
        let (map, texels) = row(&[1.0]);
        assert_eq!(plan(&map, &texels, Goal::Error(0.0)).total, 65_536 - 16);
    }
}
