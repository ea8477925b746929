//! Integrals in double precision that share no code with the product.

use std::f64::consts::FRAC_PI_2;

/// Nodes x, 1 - x and weights over (0, 1): the double exponential rule, whose ends are as good as its middle.
pub(crate) fn nodes(n: i32) -> Vec<[f64; 3]> {
    let h = 6.4 / f64::from(n);
    (-n / 2..=n / 2)
        .map(|k| {
            let t = f64::from(k) * h;
            let s = FRAC_PI_2 * t.sinh();
            let (x, y) = (1.0 / (1.0 + (-2.0 * s).exp()), 1.0 / (1.0 + (2.0 * s).exp()));
            [x, y, h * std::f64::consts::PI * t.cosh() * x * y]
        })
        .filter(|n| 0.0 < n[2])
        .collect()
}

/// Henyey-Greenstein times 4 pi by 1 - cosine; `g` above 0.
fn forward(g: f64, towards: f64) -> f64 {
    let d = (1.0 - g) * (1.0 - g) + 2.0 * g * towards;
    (1.0 - g) * (1.0 + g) / (d * d.sqrt())
}

/// Henyey-Greenstein times 4 pi from 1 - cosine and 1 + cosine.
pub(crate) fn phase(g: f64, towards: f64, back: f64) -> f64 {
    if g < 0.0 { forward(-g, back) } else { forward(g, towards) }
}

/// D exp(D) times the fluence of light of a point of 1 candela that was scattered once, in bipolar coordinates: with the sum u and difference v of
/// both ways as u = D coth S and v = u tanh s it is the integral over S of exp(-D (coth S - 1)) / (sinh S cosh S) times that of the phase function over
/// s in (-S, S), where 1 - cosine = 2 cosh^2 s / cosh^2 S.
pub(crate) fn point_fluence(depth: f64, g: f64) -> f64 {
    let rule = nodes(240);
    let mut sum = 0.0;
    for [x, y, w] in &rule {
        // S = -ln y, so that dS = dx / y; where y vanishes, so does the integrand.
        let big = if *x < 0.5 { -(-x).ln_1p() } else { -y.ln() };
        if 300.0 < big {
            continue;
        }
        let excess = 2.0 * depth / (2.0 * big).exp_m1();
        let cosh = big.cosh();
        let outer = (-excess).exp() / (big.sinh() * cosh) / y;
        // Both halves of (-S, S) are alike.
        let inner: f64 = rule
            .iter()
            .map(|[a, b, v]| {
                let s = big * a;
                let towards = 2.0 * (s.cosh() / cosh).powi(2);
                // cosh^2 S - cosh^2 s = sinh(S + s) sinh(S - s).
                let back = 2.0 * (big + s).sinh() * (big * b).sinh() / (cosh * cosh);
                v * phase(g, towards, back)
            })
            .sum();
        sum += w * outer * 2.0 * big * inner;
    }
    sum
}

/// exp(d) times the fluence at depth d under a sun of 1 lux, scattered once: the integral over the cosine c of
/// L(c) = (1 - exp(-d (1 - c) / c)) / (4 pi (1 - c)), and 1 / (4 pi (1 - c)) below the horizon, times 2 pi and the phase function.
pub(crate) fn sun_fluence(depth: f64, g: f64) -> f64 {
    let mut sum = 0.0;
    for [x, y, w] in nodes(400) {
        // The cosine c = x, and then c = -x.
        let lit = -(-depth * y / x).exp_m1() / y;
        let lit = if y < 1e-290 { depth / x } else { lit };
        sum += 0.5 * w * (lit * phase(g, y, 1.0 + x) + phase(g, 1.0 + x, y) / (1.0 + x));
    }
    sum
}
