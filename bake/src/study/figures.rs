//! Errors of bakes against a converged reference, and which of them are worth their time.
//!
//! Two references with other random numbers, `a` and `b`, tell errors without their own noise: of a bake `x` with the truth `t`
//! the mean of `(x - a)(x - b)` over texels is that of `(x - t)^2`, because what the references are off by is independent. Bakes
//! of several seeds tell noise from bias the same way.

use crate::study::shots::{Cost, Values};

/// Part of the texels that is left out of [`Errors::error`]: next to a lamp the noise of unbiased paths has no bound, and few
/// texels would decide. Which ones the references' stated errors say, so that no bake under study has a hand in it.
const WORST: f64 = 0.01;

/// Runs of texels from whose spread the uncertainty of an error follows.
const GROUPS: usize = 32;

/// What bakes are compared with.
#[derive(Clone, Debug)]
pub struct Reference {
    a: Vec<f64>,
    b: Vec<f64>,
    /// Whether a texel counts for [`Errors::error`].
    kept: Vec<bool>,
    /// How much its error weighs.
    weight: Vec<f64>,
    mean: f64,
}

/// Errors of one setting, as parts of the reference's mean.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// Root of the mean squared error, without the worst hundredth of the texels.
    pub error: f64,
    /// Its standard error.
    pub uncertainty: f64,
    /// The part that another seed changes.
    pub noise: f64,
    /// The part that it does not; with few texels noise alone makes some of it, which [`Errors::is_biased`] knows.
    pub bias: f64,
    /// Standard error of the square of `bias`.
    pub bias_square_std_err: f64,
    /// As `error`, of all texels.
    pub all: f64,
}

impl Errors {
    /// Whether there is a bias beyond two standard errors.
    #[must_use]
    pub fn is_biased(&self) -> bool {
        2.0 * self.bias_square_std_err < self.bias * self.bias
    }
}

impl Reference {
    /// From two long bakes of other seeds.
    #[must_use]
    pub fn new(first: Values, second: Values) -> Self {
        let square = |i: usize| first.std_err[i].powi(2) + second.std_err[i].powi(2);
        let n = first.luminance.len().min(second.luminance.len());
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|&i, &j| square(i).total_cmp(&square(j)));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a length")]
        let good = n - (WORST * n as f64) as usize;
        let mut kept = vec![false; n];
        order[..good].iter().for_each(|&i| kept[i] = true);
        let mean =
            (0..n).map(|i| 0.5 * (first.luminance[i] + second.luminance[i])).sum::<f64>() / n.max(1) as f64;
        Self { a: first.luminance, b: second.luminance, kept, weight: vec![1.0; n], mean }
    }

    /// The same with errors as parts of the place's own light and the mean together: light grows without bound towards lamps, and few places
    /// beside them would decide.
    #[must_use]
    pub fn in_proportion(self) -> Self {
        let own = |i: usize| (0.5 * (self.a[i] + self.b[i])).max(0.0);
        let weight =
            (0..self.len()).map(|i| if 0.0 < self.mean { self.mean / (own(i) + self.mean) } else { 1.0 });
        Self { weight: weight.collect(), ..self }
    }

    /// The same with only those texels or points for which `counts` holds.
    #[must_use]
    pub fn only(&self, counts: impl Fn(usize) -> bool) -> Self {
        let kept = (0..self.len()).map(|i| self.kept[i] && counts(i)).collect();
        Self { kept, ..self.clone() }
    }

    /// Number of texels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.a.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.a.is_empty()
    }

    /// Mean luminance, nits.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.mean
    }

    /// What the references themselves are off by, as a part of the mean.
    #[must_use]
    pub fn noise(&self) -> f64 {
        let square = |i: usize| 0.25 * (self.weight[i] * (self.a[i] - self.b[i])).powi(2);
        self.root(self.average(|i| self.kept[i], square))
    }

    /// Errors of bakes of one setting with other seeds; every list has [`Reference::len`] values.
    #[must_use]
    pub fn errors(&self, seeds: &[&[f64]]) -> Errors {
        let k = seeds.len().max(1) as f64;
        let pairs: Vec<(usize, usize)> = (0..seeds.len()).flat_map(|s| (0..s).map(move |t| (s, t))).collect();
        let square = |i: usize| {
            let sum = seeds.iter().map(|x| (x[i] - self.a[i]) * (x[i] - self.b[i])).sum::<f64>();
            self.weight[i].powi(2) * sum / k
        };
        let variance = |i: usize| {
            let sum = pairs.iter().map(|&(s, t)| 0.5 * (seeds[s][i] - seeds[t][i]).powi(2)).sum::<f64>();
            self.weight[i].powi(2) * sum / pairs.len().max(1) as f64
        };
        let kept = |i: usize| self.kept[i];
        let mse = self.average(kept, square);
        let noise = self.average(kept, variance);
        let spread = |of: &dyn Fn(usize) -> f64| self.spread(of);
        let (mse_std_err, bias_std_err) = (spread(&square), spread(&|i| square(i) - variance(i)));
        let mean2 = self.mean * self.mean;
        let error = self.root(mse);
        Errors {
            error,
            uncertainty: if 0.0 < error { 0.5 * mse_std_err / (error * mean2) } else { 0.0 },
            noise: self.root(noise),
            bias: self.root(mse - noise),
            bias_square_std_err: if 0.0 < mean2 { bias_std_err / mean2 } else { 0.0 },
            all: self.root(self.average(|_| true, square)),
        }
    }

    /// Standard error of the mean over texels that count, from runs of them: what is wrong is often wrong over many texels.
    fn spread(&self, of: &dyn Fn(usize) -> f64) -> f64 {
        let n = self.len();
        let runs = GROUPS.min(n);
        let means: Vec<f64> = (0..runs)
            .map(|g| (g * n / runs, (g + 1) * n / runs))
            .filter(|&(from, to)| (from..to).any(|i| self.kept[i]))
            .map(|(from, to)| self.average(|i| from <= i && i < to && self.kept[i], of))
            .collect();
        let n = means.len() as f64;
        if n < 2.0 {
            return f64::INFINITY;
        }
        let mean = means.iter().sum::<f64>() / n;
        (means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt()
    }

    fn average(&self, counts: impl Fn(usize) -> bool, of: impl Fn(usize) -> f64) -> f64 {
        let (mut sum, mut n) = (0.0, 0.0f64);
        for i in (0..self.len()).filter(|&i| counts(i)) {
            sum += of(i);
            n += 1.0;
        }
        sum / n.max(1.0)
    }

    fn root(&self, square: f64) -> f64 {
        if 0.0 < self.mean { square.max(0.0).sqrt() / self.mean } else { 0.0 }
    }
}

/// One setting of one knob, measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the knob.
    pub knob: String,
    /// The preset on which the knob is turned, or another kind of bake that the knob needs.
    pub base: String,
    /// The setting.
    pub setting: String,
    /// The same as options of `bake run`.
    pub args: String,
    /// Whether the base has this setting anyway.
    pub usual: bool,
    /// What it takes.
    pub cost: Cost,
    /// What it is off by.
    pub errors: Errors,
    /// Error that the bakes state.
    pub stated: Option<f64>,
    /// Whether its bakes are denoised.
    pub denoised: bool,
    /// Whether it competes with every other bake of the scene, as texels of the study's density do.
    pub competes: bool,
    /// Whether nothing that competes is both faster and better.
    pub front: bool,
}

/// Farthest that the number of samples is changed in thought to compare two bakes at the same error: with few samples errors fall faster than the
/// root of their number, so what was measured with more of them would look too good with fewer.
const STRETCH: f64 = 1.5;

impl Row {
    /// Processor seconds with as many samples as give `error`, if noise falls with their root; `None` where bias forbids it, or
    /// where that is more than one and a half times as many as were measured, or fewer by the same factor.
    #[must_use]
    pub fn seconds_at(&self, error: f64) -> Option<f64> {
        if self.denoised {
            // What a denoiser blurs depends on the noise, so nothing is known of other numbers of samples.
            return (self.errors.error <= error).then(|| self.cost.seconds());
        }
        let bias2 = (self.errors.error.powi(2) - self.errors.noise.powi(2)).max(0.0);
        let left = error * error - bias2;
        if left <= 0.0 {
            return None;
        }
        let more = self.errors.noise.powi(2) / left;
        ((1.0 / STRETCH)..=STRETCH).contains(&more).then_some(self.cost.fixed + self.cost.sampling * more)
    }
}

/// Marks the rows that nothing else beats in both time and error.
pub fn mark_front(rows: &mut [Row]) {
    // What the references cannot tell from none at all is no error to be proud of.
    let counts = |r: &&Row| r.competes && 0.0 < r.errors.error;
    let competes: Vec<(f64, f64)> =
        rows.iter().filter(counts).map(|r| (r.cost.seconds(), r.errors.error)).collect();
    for row in rows.iter_mut().filter(|r| r.competes && 0.0 < r.errors.error) {
        let (seconds, error) = (row.cost.seconds(), row.errors.error);
        row.front = !competes.iter().any(|&(s, e)| s <= seconds && e <= error && (s < seconds || e < error));
    }
}

/// How a preset stands against all else that was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Standing {
    /// Name of the preset.
    pub preset: String,
    /// Its error.
    pub error: f64,
    /// Its processor seconds.
    pub seconds: f64,
    /// Least seconds to the same error among all that competes, over the preset's own; at most 1.
    pub ratio: f64,
    /// Standard error of `ratio`, from those of both errors.
    pub ratio_std_err: f64,
    /// What takes least, where that is something else.
    pub rival: Option<String>,
}

/// Least part of a preset's time that anything else may take to the same error.
pub const WITHIN: f64 = 0.9;

impl Standing {
    /// Whether the preset is on the front, to within a tenth of its time and two standard errors.
    #[must_use]
    pub fn holds(&self) -> bool {
        WITHIN <= self.ratio + 2.0 * self.ratio_std_err
    }

    /// Of the row of a preset among `rows`.
    #[must_use]
    pub fn of(preset: &Row, rows: &[Row]) -> Self {
        let seconds = preset.cost.seconds();
        let mut best = (seconds, 0.0, None);
        let unsure = |e: &Errors| if 0.0 < e.error { e.uncertainty / e.error } else { f64::INFINITY };
        for row in rows.iter().filter(|r| r.competes && 0.0 < r.errors.error) {
            if let Some(s) = row.seconds_at(preset.errors.error).filter(|s| *s < best.0) {
                // Time goes with the square of the error.
                let unsure = 2.0 * unsure(&preset.errors).hypot(unsure(&row.errors)) * s / seconds;
                best = (s, unsure, Some(format!("{} {} at {}", row.knob, row.setting, row.base)));
            }
        }
        Self {
            preset: preset.base.clone(),
            error: preset.errors.error,
            seconds,
            ratio: best.0 / seconds.max(f64::MIN_POSITIVE),
            ratio_std_err: best.1,
            rival: best.2,
        }
    }
}

/// Slope of ln(error) over ln(seconds) by least squares; `None` of fewer than two different times.
#[must_use]
pub fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> =
        points.iter().filter(|(s, e)| 0.0 < *s && 0.0 < *e).map(|(s, e)| (s.ln(), e.ln())).collect();
    let n = logs.len() as f64;
    let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    let across = logs.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>();
    (1e-12 < across).then(|| logs.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>() / across)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Sequence, sequence::key};

    fn noise(seed: u64, size: f64) -> Vec<f64> {
        (0..4000)
            .map(|i| {
                let u: f32 = (0..3).flat_map(|k| Sequence::new(key(k, seed, i), 0).next4()).sum();
                size * (f64::from(u) - 6.0)
            })
            .collect()
    }

    fn shot(values: &[f64], std_err: f64) -> Values {
        Values { luminance: values.to_vec(), std_err: vec![std_err; values.len()] }
    }

    fn plus(base: f64, noise: &[f64]) -> Vec<f64> {
        noise.iter().map(|n| base + n).collect()
    }

    /// Beside a lamp an error counts as a part of what is there.
    #[test]
    fn errors_in_proportion_are_parts_of_the_places_own_light() {
        let mut truth = vec![1.0; 4000];
        truth[..100].fill(1000.0);
        let at = || shot(&truth, 1.0);
        let x: Vec<f64> = truth.iter().map(|t| 1.1 * t).collect();
        let e = Reference::new(at(), at()).in_proportion().errors(&[&x, &x]);
        let mean = truth.iter().sum::<f64>() / 4000.0;
        let part = |t: f64| (0.1 * t / (t + mean)).powi(2);
        let want = ((100.0 * part(1000.0) + 3900.0 * part(1.0)) / 4000.0).sqrt();
        assert!((e.all / want - 1.0).abs() < 1e-9, "{e:?} {want}");
    }

    /// Noise and bias of known sizes are found beneath references that are as noisy as the bakes.
    #[test]
    fn the_references_own_noise_does_not_count() {
        let reference =
            Reference::new(shot(&plus(10.0, &noise(1, 0.5)), 1.0), shot(&plus(10.0, &noise(2, 0.5)), 1.0));
        let (x, y) = (plus(10.3, &noise(3, 0.4)), plus(10.3, &noise(4, 0.4)));
        let e = reference.errors(&[&x, &y]);
        assert!((e.noise - 0.04).abs() < 0.002, "{e:?}");
        assert!((e.bias - 0.03).abs() < 0.003, "{e:?}");
        assert!((e.error - 0.05).abs() < 4.0 * e.uncertainty && e.uncertainty < 0.002, "{e:?}");
        assert!((reference.noise() - 0.05 / 2.0f64.sqrt()).abs() < 0.002);
        assert!(e.is_biased());
        // The same without bias: it is found in few of many cases.
        let found = (0..40u64).filter(|s| {
            let (x, y) = (plus(10.0, &noise(10 + 2 * s, 0.4)), plus(10.0, &noise(11 + 2 * s, 0.4)));
            reference.errors(&[&x, &y]).is_biased()
        });
        let found = found.count();
        assert!(found < 6, "{found} of 40");
    }

    #[test]
    fn the_worst_hundredth_is_the_references_choice() {
        let mut first = shot(&[1.0; 200], 0.1);
        first.std_err[7] = 9.0;
        first.std_err[8] = 8.0;
        let second = shot(&[1.0; 200], 0.1);
        let reference = Reference::new(first, second);
        let mut x = vec![1.0; 200];
        x[7] = 100.0;
        let e = reference.errors(&[&x, &x]);
        assert_eq!((e.error, e.noise), (0.0, 0.0));
        assert!((e.all - 99.0 / 200.0f64.sqrt()).abs() < 1e-9);
        x[9] = 2.0;
        assert!(0.0 < reference.errors(&[&x, &x]).bias);
    }

    fn row(fixed: f64, sampling: f64, noise: f64, bias: f64) -> Row {
        let errors = Errors { error: noise.hypot(bias), noise, bias, ..Errors::default() };
        let cost = Cost { fixed, sampling, ..Cost::default() };
        Row {
            knob: "k".into(),
            base: "medium".into(),
            setting: format!("{noise}"),
            args: String::new(),
            usual: false,
            cost,
            errors,
            stated: None,
            denoised: false,
            competes: true,
            front: false,
        }
    }

    #[test]
    fn equal_error_takes_the_square_of_samples() {
        let r = row(1.0, 2.0, 0.02, 0.0);
        assert_eq!(r.seconds_at(0.02), Some(3.0));
        let fewer = r.seconds_at(0.024).expect("near what was measured");
        assert!((fewer - (1.0 + 2.0 / 1.44)).abs() < 1e-9, "{fewer}");
        assert_eq!(r.seconds_at(0.016), None, "too far from what was measured");
        let biased = row(1.0, 2.0, 0.03, 0.04);
        assert_eq!(biased.seconds_at(0.04), None);
        assert!((biased.seconds_at(0.05).expect("reachable") - 3.0).abs() < 1e-9);
    }

    #[test]
    fn a_preset_that_is_beaten_says_by_what() {
        let mut rows = vec![row(0.0, 4.0, 0.02, 0.0), row(0.0, 1.0, 0.02, 0.0), row(0.0, 8.0, 0.03, 0.0)];
        mark_front(&mut rows);
        assert_eq!(rows.iter().map(|r| r.front).collect::<Vec<_>>(), [false, true, false]);
        let beaten = Standing::of(&rows[0], &rows);
        assert!(!beaten.holds() && beaten.rival.is_some() && (beaten.ratio - 0.25).abs() < 1e-12);
        let best = Standing::of(&rows[1], &rows);
        assert!(best.holds() && best.rival.is_none());
    }

    #[test]
    fn slopes_are_those_of_powers() {
        let points: Vec<(f64, f64)> =
            [1.0, 2.0, 7.0].iter().map(|s: &f64| (*s, 3.0 * s.powf(-0.5))).collect();
        assert!((slope(&points).expect("three points") + 0.5).abs() < 1e-12);
        assert_eq!(slope(&points[..1]), None);
    }
}
