//! Tables, built, written, read and asked.

#![expect(clippy::print_stdout, reason = "what was measured belongs in the log")]
#![allow(clippy::cast_possible_truncation, reason = "single precision is tested")]

use std::f64::consts::PI;
use tables::response::quadrature::tanh_sinh;
use tables::response::{directional, moments, patch, point};
use tables::table::build::{DEFAULT, Preset, build};
use tables::table::file::{Axis, Emitter, Form, Part, write};
use tables::table::{Combined, CombinedPatch, Orders, Query, Range, Tables};

const SMALL: Preset = {
    let distance = Axis::Distance { first: 1e-6, last: 1e3, n: 20, neighbours: 6 };
    let g = Axis::G { to: 0.9, n: 5 };
    Preset {
        name: "small",
        distance,
        g,
        g_of_orders: true,
        g_of_rest: g,
        far: Some(distance),
        albedos: 5,
        few_albedos: 4,
        patch_distance: distance,
        angle: Axis::Angle { per_side: 3 },
        patch_g: g,
        form: Form::Full,
        few_distance: Axis::Distance { first: 1e-6, last: 120.0, n: 12, neighbours: 4 },
        few_far: Axis::Distance { first: 1e-6, last: 1e3, n: 12, neighbours: 4 },
        few_angle: Axis::Angle { per_side: 2 },
        far_angle: Axis::Angle { per_side: 2 },
    }
};

fn small() -> Tables {
    Tables::from_bytes(write("small", &build(&SMALL, &|_| ()))).expect("what was written is read")
}

fn ask(emitter: Emitter, depth: f64, g: f64, albedo: f64, orders: Orders) -> Query {
    Query { emitter, depth, theta: 1.0, g, albedo, orders }
}

/// At its nodes a table says what it was built of, to the precision of its numbers, powers of the albedo included; and every
/// answer between them and far outside is finite and has light.
#[test]
fn tables_say_what_they_were_built_of() {
    let tables = small();
    let block = tables.block(Emitter::Point, Part::Rest).expect("a table of all orders");
    let nodes: Vec<Vec<f64>> = block.axes.iter().map(Axis::nodes).collect();
    let rule = tanh_sinh(96);
    let close = |got: &[f64], want: &[f64], what: &str| {
        for (a, b) in got.iter().zip(want) {
            assert!((a - b).abs() < 2e-4 * want[0], "{what} {got:?} {want:?}");
        }
    };
    for &d in &nodes[0][6..16] {
        for &g in &nodes[1] {
            let point = |albedo, orders| {
                tables.query(&ask(Emitter::Point, d, g, albedo, orders)).expect("an answer").zh
            };
            let at = format!("D {d} g {g}");
            close(&point(1.0, Orders::Span(1, 1)), &point::single(&rule, d, g), &at);
            let alpha: f64 = 0.5;
            let sixth = moments::orders_scaled(d, g)[4].map(|v| v * alpha.powi(6) * (-d).exp() / d);
            close(&point(alpha, Orders::Span(6, 6)), &sixth, &at);
            let root = nodes[2][2];
            let alpha = 1.0 - root * root;
            let factor = alpha * alpha * (-moments::decay(alpha, g) * d).exp() / d;
            close(
                &point(alpha, Orders::Rest),
                &moments::rest_scaled(d, g, &[alpha])[0].map(|v| v * factor),
                &at,
            );
            let sun = tables
                .query(&ask(Emitter::Directional, d, g, 1.0, Orders::Span(1, 1)))
                .expect("an answer")
                .zh;
            close(&sun, &directional::single(&rule, d, g), &at);
        }
    }
    for emitter in [Emitter::Point, Emitter::Directional, Emitter::Area] {
        for depth in [1e-9, 1e-6, 0.03, 2.0, 700.0, 1e3, 1e6] {
            for g in [-0.99, -0.2, 0.99] {
                for albedo in [0.0, 0.3, 1.0] {
                    for orders in [Orders::Span(1, 1), Orders::Span(10, 10), Orders::Rest, Orders::All] {
                        let answer =
                            tables.query(&ask(emitter, depth, g, albedo, orders)).expect("an answer");
                        let ok = answer.zh.iter().chain(&answer.axis).all(|v| v.is_finite());
                        assert!(
                            ok && 0.0 <= answer.zh[0],
                            "{emitter:?} {depth} {g} {albedo} {orders:?}: {answer:?}"
                        );
                        assert!(albedo != 0.0 || answer.zh[0] == 0.0, "no scattering, no light");
                    }
                }
            }
        }
    }
    let far_g = tables.query(&ask(Emitter::Point, 1.0, 0.99, 1.0, Orders::All)).expect("an answer");
    assert!(far_g.clamped.contains(&"g"), "what is clamped says so");
    for (depth, g, albedo) in [(-1.0, 0.0, 0.5), (f64::NAN, 0.0, 0.5), (1.0, 1.0, 0.5), (1.0, 0.0, 1.5)] {
        let q = ask(Emitter::Point, depth, g, albedo, Orders::All);
        assert!(tables.query(&q).is_err(), "{q:?}");
    }
    let missing = tables.query(&ask(Emitter::Point, 1.0, 0.0, 1.0, Orders::Span(11, 11)));
    assert!(missing.expect_err("ten orders").to_string().contains("tables build"));
}

/// What bakes ask is what the tables say, for any g, albedo and angle in range.
#[test]
fn combined_answers_are_those_of_the_file() {
    let tables = Tables::embedded().expect("the embedded file");
    let any_g = Range { from: -0.8, to: 0.85 };
    let any_albedo = Range { from: 0.0, to: 1.0 };
    let unit = |i: u32, d: u32| f64::from(sobol_burley::sample(i, d, 7));
    let cases: [(Emitter, Orders, Range, Range, f64); 9] = [
        (Emitter::Point, Orders::All, 0.3.into(), 0.9.into(), 1e-3),
        (Emitter::Point, Orders::Span(1, 10), any_g, 1.0.into(), 2e-3),
        (Emitter::Point, Orders::All, (-0.4).into(), any_albedo, 2e-3),
        (Emitter::Directional, Orders::All, any_g, 0.5.into(), 2e-3),
        (Emitter::Directional, Orders::Span(1, 1), 0.0.into(), any_albedo, 1e-3),
        (Emitter::Area, Orders::Rest, 0.0.into(), 0.8.into(), 5e-3),
        (Emitter::Area, Orders::All, 0.5.into(), 1.0.into(), 3e-2),
        (Emitter::Area, Orders::All, 0.8.into(), 1.0.into(), 6e-2),
        (Emitter::Area, Orders::All, (-0.5).into(), 1.0.into(), 3e-2),
    ];
    for (emitter, orders, g, albedo, tolerance) in cases {
        let one = (emitter != Emitter::Area)
            .then(|| Combined::new(&tables, emitter, orders, g, albedo).expect("tables"));
        let patch = (emitter == Emitter::Area)
            .then(|| CombinedPatch::new(&tables, orders, g, albedo).expect("tables"));
        let (mut worst, mut place) = (0.0f64, String::new());
        for i in 0..400 {
            let q = Query {
                emitter,
                depth: 1e-4 * 5e5f64.powf(unit(i, 0)),
                theta: 0.5 * PI * unit(i, 1),
                g: g.from + (g.to - g.from) * unit(i, 2),
                albedo: albedo.from + (albedo.to - albedo.from) * unit(i, 3),
                orders,
            };
            let want = tables.query(&q).expect("an answer");
            let (depth, g, albedo) = (q.depth as f32, q.g as f32, q.albedo as f32);
            let mut off = 0.0f64;
            if let Some(one) = &one {
                for (a, b) in one.look_up(depth, g, albedo).into_iter().zip(want.zh) {
                    off = off.max((f64::from(a) - b).abs() / want.zh[0]);
                }
            }
            if let Some(patch) = &patch {
                for normal in [[0.0f32, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [-0.64, 0.6, 0.48]] {
                    let got = patch.irradiance(depth, g, albedo, q.theta.cos() as f32, normal);
                    let full = patch::irradiance(&want.light, normal.map(f64::from));
                    off = off.max((f64::from(got) - full).abs() / (PI.sqrt() * want.light[0]));
                }
            }
            assert!(off.is_finite() || want.zh[0] < 1e-30, "{q:?}");
            // Fainter light matters to nobody.
            if worst < off && 1e-15 < want.zh[0] {
                (worst, place) = (off, format!("{q:?}"));
            }
        }
        println!("{emitter} {orders:?}: {worst:.1e} at {place}");
        assert!(worst < tolerance, "{emitter} {orders:?}: {worst:e} at {place}");
    }
}

/// The hard cases: nearest and farthest distances, strongest forward and backward scattering, no and full albedo, every angle.
#[test]
fn hard_cases() {
    let tables = Tables::embedded().expect("the embedded file");
    let rule = tanh_sinh(160);
    let single = |emitter, depth, g| {
        tables.query(&ask(emitter, depth, g, 1.0, Orders::Span(1, 1))).expect("an answer")
    };
    for g in [-0.9, -0.5, 0.0, 0.7, 0.9] {
        for depth in [1e-6, 1e-5, 1e-3, 1.0, 30.0, 100.0] {
            let close =
                |got: f64, want: f64| assert!((got / want - 1.0).abs() < 1e-3, "{g} {depth} {got} {want}");
            close(single(Emitter::Point, depth, g).zh[0], point::single(&rule, depth, g)[0]);
            close(single(Emitter::Directional, depth, g).zh[0], directional::single(&rule, depth, g)[0]);
            for theta in [0.0, 0.5 * PI, PI] {
                let q = Query { theta, ..ask(Emitter::Area, depth, g, 1.0, Orders::Span(1, 1)) };
                let got = tables.query(&q).expect("an answer").light[0];
                close(got, patch::single(&tanh_sinh(72), depth, theta, g)[0]);
            }
            for n in [2, 5, 10] {
                let q = ask(Emitter::Point, depth, g, 1.0, Orders::Span(n, n));
                let want = moments::orders_in_detail(depth, g, 2)[n as usize - 2][0] * (-depth).exp() / depth;
                close(tables.query(&q).expect("an answer").zh[0], want);
            }
        }
        // Far away light is less than any number, and nothing else.
        for emitter in [Emitter::Point, Emitter::Directional, Emitter::Area] {
            for orders in [Orders::Span(1, 1), Orders::Span(1, 10), Orders::All] {
                for depth in [200.0, 1e3] {
                    let albedo = 0.5;
                    let answer = tables.query(&ask(emitter, depth, g, albedo, orders)).expect("an answer");
                    assert!(
                        answer.zh.iter().all(|v| v.is_finite() && v.abs() < 1e-30),
                        "{emitter} {answer:?}"
                    );
                }
                let none = tables.query(&ask(emitter, 1.0, g, 0.0, orders)).expect("an answer");
                assert_eq!(none.zh, [0.0; 11], "{emitter} {orders:?}");
                for albedo in [1e-9, 1.0 - 1e-12, 1.0] {
                    let answer = tables.query(&ask(emitter, 1.0, g, albedo, orders)).expect("an answer");
                    assert!(
                        answer.zh.iter().all(|v| v.is_finite()) && 0.0 < answer.zh[0],
                        "{emitter} {answer:?}"
                    );
                }
            }
        }
    }
    // Beyond the tables it is said that they end.
    for (depth, g, what) in [(1.0, 0.99, "g"), (1.0, -0.99, "g"), (1e4, 0.0, "depth"), (1e-12, 0.0, "depth")]
    {
        assert!(single(Emitter::Point, depth, g).clamped.contains(&what), "{depth} {g}");
    }
    // All light of an albedo of 1 far away: diffusion.
    let all = tables.query(&ask(Emitter::Point, 900.0, 0.0, 1.0, Orders::All)).expect("an answer");
    let fluence = (4.0 * PI).sqrt() * all.zh[0];
    assert!((fluence * 900.0 / 3.0 - 1.0).abs() < 5e-3, "{fluence}");
}

/// The published configuration can be built and asked, and its three columns of g say something else.
#[test]
fn three_columns_differ() {
    let paper = Preset {
        distance: Axis::Distance { first: 1e-4, last: 50.0, n: 24, neighbours: 2 },
        patch_distance: Axis::Distance { first: 1e-2, last: 20.0, n: 6, neighbours: 2 },
        few_distance: Axis::Distance { first: 1e-2, last: 20.0, n: 6, neighbours: 2 },
        ..tables::table::build::PAPER
    };
    let columns = Tables::from_bytes(write("columns", &build(&paper, &|_| ()))).expect("a file");
    let ours = Tables::embedded().expect("the embedded file");
    let off = |g: f64| {
        let q = ask(Emitter::Point, 0.5, g, 1.0, Orders::Span(1, 1));
        let (a, b) = (columns.query(&q).expect("an answer").zh, ours.query(&q).expect("an answer").zh);
        (0..a.len()).map(|l| ((a[l] - b[l]) / b[0]).abs()).fold(0.0, f64::max)
    };
    assert!(off(0.5) < 0.03 && off(0.0) < 0.03, "{} {}", off(0.5), off(0.0));
    assert!(0.05 < off(0.25), "{}", off(0.25));
    let e = columns.query(&ask(Emitter::Point, 0.5, 0.0, 1.0, Orders::Rest)).expect_err("ten orders");
    assert!(e.to_string().contains("orders 2.."), "{e}");
    let area = columns.query(&ask(Emitter::Area, 0.5, 0.2, 0.9, Orders::Span(1, 10))).expect("an answer");
    assert!(area.axis.iter().all(|v| v.is_finite()) && 0.0 < area.zh[0]);
}

/// The embedded file is what the program builds. Two minutes: `SLOW_TESTS=1`.
#[test]
fn embedded_file_is_what_is_built() {
    let old = Tables::embedded().expect("the embedded file");
    assert!(old.bytes() <= 4 << 20, "{}", old.bytes());
    if std::env::var_os("SLOW_TESTS").is_none() {
        println!("skipped: SLOW_TESTS is not set");
        return;
    }
    let new = Tables::from_bytes(write(DEFAULT.name, &build(&DEFAULT, &|what| println!("{what}"))))
        .expect("a file");
    assert_eq!(old.header(), new.header());
    for block in &old.header().blocks {
        for i in 0..block.entries() {
            let (a, b) = (old.entry(block, i), new.entry(block, i));
            // Machines round differently: a step of the numbers, no more.
            let off = a.ratios.iter().zip(b.ratios).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(
                (a.log - b.log).abs() < 1e-5 * a.log.abs().max(1.0) && off < 3e-4,
                "{block:?} {i}: {off}"
            );
        }
    }
}
