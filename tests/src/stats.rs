//! Comparing many noisy numbers with exact ones.

use std::collections::BTreeMap;

/// Per-test level that keeps `n` independent tests at `alpha` overall.
#[must_use]
pub fn sidak(alpha: f64, n: usize) -> f64 {
    // 1 - (1 - alpha)^(1/n) without cancellation.
    -((-alpha).ln_1p() / (n.max(1) as f64)).exp_m1()
}

/// Probability that a standard normal number is at least `z` (0 <= z).
#[must_use]
pub fn upper_tail(z: f64) -> f64 {
    // Simpson's rule; beyond 12 more nothing is left.
    let n = 4000;
    let h = 12.0 / f64::from(n);
    let sum: f64 = (0..=n)
        .map(|i| {
            let x = z + h * f64::from(i);
            let weight = if i == 0 || i == n { 1.0 } else { f64::from(2 + 2 * (i % 2)) };
            weight * (-0.5 * x * x).exp()
        })
        .sum();
    sum * h / 3.0 / std::f64::consts::TAU.sqrt()
}

/// The z that a standard normal number exceeds in absolute value with probability `p`.
#[must_use]
pub fn two_sided_z(p: f64) -> f64 {
    let (mut lo, mut hi) = (0.0, 30.0);
    for _ in 0..60 {
        let mid = 0.5 * (lo + hi);
        if p < 2.0 * upper_tail(mid) { lo = mid } else { hi = mid }
    }
    0.5 * (lo + hi)
}

/// The t that a number with Student's distribution of `freedom` degrees exceeds in absolute value with probability `p`.
#[must_use]
pub fn two_sided_t(p: f64, freedom: u32) -> f64 {
    // t = sqrt(freedom) tan(a) makes the density cos(a)^(freedom - 1), which ends at a quarter turn: Simpson's rule.
    let quarter = std::f64::consts::FRAC_PI_2;
    let beyond = |a: f64| {
        let n = 400;
        let h = (quarter - a) / f64::from(n);
        let sum: f64 = (0..=n)
            .map(|i| {
                let weight = if i == 0 || i == n { 1.0 } else { f64::from(2 + 2 * (i % 2)) };
                weight * (a + h * f64::from(i)).cos().max(0.0).powf(f64::from(freedom.max(1) - 1))
            })
            .sum();
        sum * h / 3.0
    };
    let all = beyond(0.0);
    let (mut lo, mut hi) = (0.0, quarter);
    for _ in 0..60 {
        let mid = 0.5 * (lo + hi);
        if p * all < beyond(mid) { lo = mid } else { hi = mid }
    }
    f64::from(freedom).sqrt() * (0.5 * (lo + hi)).tan()
}

/// One comparison.
#[derive(Clone, Debug)]
pub struct Case {
    /// For the message.
    pub what: String,
    /// Cases of one group share their random numbers, such as the channels of a texel.
    pub group: usize,
    /// Measured value.
    pub got: f64,
    /// Its standard error.
    pub std_err: f64,
    /// Exact value.
    pub want: f64,
}

/// Compares all cases with a bias of `relative` allowed on top of noise. None may be further off than Sidak's bound for a
/// false alarm once in 1000 runs allows; beyond three standard errors there may be only as many groups as chance
/// explains; and the mean over all may be off by four of its own standard errors.
///
/// # Errors
/// One line per kind of failure, with the worst case.
pub fn judge(cases: &[Case], relative: f64) -> Result<(), String> {
    if cases.is_empty() {
        return Err("nothing to compare".into());
    }
    if let Some(c) = cases.iter().find(|c| !c.got.is_finite() || !c.std_err.is_finite()) {
        return Err(format!("not finite: {c:?}"));
    }
    let mut faults = Vec::new();
    let bound = two_sided_z(sidak(1e-3, cases.len()));
    // Rounding of the 32-bit file is allowed for, and what nobody sees beside the brightest value: where light falls on
    // the last corner of a texel, a few samples know neither its mean nor their own error.
    let brightest = cases.iter().map(|c| c.want.abs()).fold(0.0, f64::max);
    let slack = |want: f64| (relative + 1e-6) * want.abs() + 1e-7 * brightest;
    let excess = |c: &Case| {
        let off = (c.got - c.want).abs() - slack(c.want);
        if off <= 0.0 { 0.0 } else { off / c.std_err }
    };
    if let Some(c) = cases.iter().max_by(|a, b| excess(a).total_cmp(&excess(b)))
        && bound < excess(c)
    {
        let n = cases.len();
        faults.push(format!("{:.2} standard errors off, {bound:.2} allowed for {n} cases: {c:?}", excess(c)));
    }
    let mut groups: BTreeMap<usize, Vec<&Case>> = BTreeMap::new();
    for c in cases {
        groups.entry(c.group).or_default().push(c);
    }
    let n = groups.len() as f64;
    // Each channel of a texel has its own chance to be off; together at most the sum.
    let channels = cases.len() as f64 / n;
    let beyond = groups.values().filter(|g| g.iter().any(|c| 3.0 < excess(c))).count();
    let expected = 0.0027 * n * channels.min(3.0);
    let allowed = expected + 4.0 * expected.sqrt() + 1.0;
    if allowed < beyond as f64 {
        faults.push(format!("{beyond} of {n} groups are beyond three standard errors, {allowed:.1} allowed"));
    }
    let mean = |f: &dyn Fn(&Case) -> f64| cases.iter().map(f).sum::<f64>() / cases.len() as f64;
    let worst = |g: &Vec<&Case>| g.iter().map(|c| c.std_err).fold(0.0, f64::max);
    let error = groups.values().map(|g| worst(g).powi(2)).sum::<f64>().sqrt() / n;
    let (off, most) = (mean(&|c| c.got - c.want), slack(mean(&|c| c.want.abs())) + 4.0 * error);
    if most < off.abs() {
        faults.push(format!("the mean is off by {off:.3e}, {most:.3e} allowed"));
    }
    if faults.is_empty() { Ok(()) } else { Err(faults.join("\n")) }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    #[test]
    fn known_quantiles() {
        assert!((2.0 * upper_tail(1.959_964) - 0.05).abs() < 1e-7);
        assert!((two_sided_z(0.0027) - 3.0).abs() < 1e-3);
        for (p, freedom, t) in [(0.05, 1, 12.706_205), (0.001, 7, 5.407_883), (0.01, 30, 2.749_996)] {
            assert!((two_sided_t(p, freedom) / t - 1.0).abs() < 1e-5, "{p} {freedom}");
        }
        assert!((sidak(0.05, 1) - 0.05).abs() < 1e-15);
        assert!((sidak(1e-3, 1_000_000) / 1.0005e-9 - 1.0).abs() < 1e-4);
    }

    #[test]
    fn judge_finds_an_outlier_a_bias_and_nan() {
        let case =
            |group: usize, got: f64| Case { what: String::new(), group, got, std_err: 0.01, want: 1.0 };
        let good: Vec<Case> =
            (0..1000u16).map(|i| case(i.into(), 1.0 + 0.009 * (f64::from(i % 5) - 2.0))).collect();
        assert_eq!(judge(&good, 1e-3), Ok(()));
        let mut outlier = good.clone();
        outlier[7] = case(7, 1.1);
        assert!(judge(&outlier, 1e-3).unwrap_err().contains("standard errors off"));
        let biased = |by: f64| good.iter().map(|c| case(c.group, c.got + by)).collect::<Vec<_>>();
        assert!(judge(&biased(0.02), 1e-3).unwrap_err().contains("beyond three"));
        let slightly = judge(&biased(0.003), 1e-3).unwrap_err();
        assert!(slightly.starts_with("the mean is off"), "{slightly}");
        let mut nan = good;
        nan[0].got = f64::NAN;
        assert!(judge(&nan, 1e-3).unwrap_err().contains("not finite"));
        assert!(judge(&[], 1e-3).is_err());
    }
}
