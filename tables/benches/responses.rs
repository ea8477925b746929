//! Time of a look-up and double product, by order of the harmonics, against full harmonics: `cargo bench -p tables`.

#![expect(clippy::print_stdout, reason = "the result")]
#![allow(clippy::cast_possible_truncation, reason = "numbers of a bench are small")]

use std::hint::black_box;
use std::time::Instant;
use tables::harmonics::zonal::CLAMPED_COSINE_F32;
use tables::harmonics::{BANDS, Zh, real};
use tables::table::file::Emitter;
use tables::table::{Combined, CombinedPatch, Orders, Range, Tables};

/// Look-ups of a run.
const N: usize = 200_000;

/// Distances and cosines, mixed.
fn questions() -> Vec<(f32, f32, f32)> {
    (0..N)
        .map(|i| {
            let u = i as f32 * 0.618_034 % 1.0;
            let v = i as f32 * 0.754_877_7 % 1.0;
            (1e-3 * (3e4f32).powf(u), 2.0 * v - 1.0, 0.9 - 1.8 * u * v)
        })
        .collect()
}

/// Nanoseconds each, least of some runs.
fn time(name: &str, questions: &[(f32, f32, f32)], f: impl Fn(f32, f32, f32) -> f32) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..15 {
        let start = Instant::now();
        let mut sum = 0.0;
        for &(d, x, g) in questions {
            sum += f(d, x, g);
        }
        black_box(sum);
        best = best.min(start.elapsed().as_secs_f64() * 1e9 / questions.len() as f64);
    }
    println!("{name:52} {best:7.1} ns");
    best
}

/// Double product of the first `ORDER` bands.
fn product<const ORDER: usize>(zh: &Zh, x: f32) -> f32 {
    let (mut before, mut p, mut sum) = (1.0, x, zh[0] * CLAMPED_COSINE_F32[0]);
    for l in 1..ORDER {
        sum += zh[l] * CLAMPED_COSINE_F32[l] * p;
        let k = l as f32;
        (before, p) = (p, ((2.0 * k + 1.0) * x * p - k * before) / (k + 1.0));
    }
    sum
}

fn main() {
    // `cargo test` runs benches too, to see that they start.
    if !std::env::args().any(|a| a == "--bench") {
        return;
    }
    let tables = Tables::embedded().expect("the embedded file");
    let one = Combined::new(&tables, Emitter::Point, Orders::All, 0.3.into(), 0.9.into()).expect("a table");
    let any_g = Range { from: -0.9, to: 0.9 };
    let gs = Combined::new(&tables, Emitter::Point, Orders::All, any_g, 0.9.into()).expect("a table");
    let sun =
        Combined::new(&tables, Emitter::Directional, Orders::All, 0.3.into(), 0.9.into()).expect("a table");
    let patch = CombinedPatch::new(&tables, Orders::All, 0.3.into(), 0.9.into()).expect("a table");
    let q = questions();
    let full = time("point: look-up, full harmonics, sum of 121", &q, |d, x, _| {
        let sh = real::rotate(&one.look_up(d, 0.3, 0.9), [0.0, 0.0, 1.0]);
        let cosine = real::rotate(&CLAMPED_COSINE_F32, [(1.0 - x * x).max(0.0).sqrt(), 0.0, x]);
        sh.iter().zip(cosine).map(|(a, b)| a * b).sum()
    });
    let ours =
        time("point: look-up and double product, order 11", &q, |d, x, _| one.irradiance(d, 0.3, 0.9, x));
    println!("{:52} {:7.1} times", "  full harmonics take", full / ours);
    macro_rules! sweep {
        ($($order:literal)*) => {$(
            time(concat!("  order ", $order), &q, |d, x, _| {
                product::<$order>(&one.look_up(d, 0.3, 0.9), x)
            });
        )*};
    }
    sweep!(1 2 3 4 6 8 11);
    time("  look-up alone", &q, |d, _, _| one.look_up(d, 0.3, 0.9)[0]);
    time("point: any g", &q, |d, x, g| gs.irradiance(d, g, 0.9, x));
    time("sun", &q, |d, x, _| sun.irradiance(d, 0.3, 0.9, x));
    time("patch: irradiance of full harmonics", &q, |d, x, _| {
        patch.irradiance(d, 0.3, 0.9, x, [(1.0 - x * x).max(0.0).sqrt(), 0.0, -x])
    });
    assert_eq!(BANDS, 11);
}
