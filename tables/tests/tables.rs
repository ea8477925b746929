//! Small tables, built, written, read and asked.

use tables::response::quadrature::tanh_sinh;
use tables::response::{directional, moments, point};
use tables::table::build::{Sizes, build};
use tables::table::file::{Axis, Emitter, Part, write};
use tables::table::{Orders, Query, Tables};

const SMALL: Sizes =
    Sizes { distances: 20, gs: 5, albedos: 5, few_albedos: 4, angles: 5, few_distances: 12, few_angles: 4 };

fn small() -> Tables {
    Tables::from_bytes(write("small", &build(SMALL))).expect("what was written is read")
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
    let close = |got: &[f64], want: &[f64]| {
        for (a, b) in got.iter().zip(want) {
            assert!((a - b).abs() < 2e-4 * want[0], "{got:?} {want:?}");
        }
    };
    for &d in &nodes[0][6..16] {
        for &g in &nodes[1] {
            let point = |albedo, orders| {
                tables.query(&ask(Emitter::Point, d, g, albedo, orders)).expect("an answer").zh
            };
            close(&point(1.0, Orders::One(1)), &point::single(&rule, d, g));
            let alpha: f64 = 0.5;
            let sixth = moments::orders_scaled(d, g)[4].map(|v| v * alpha.powi(6) * (-d).exp() / d);
            close(&point(alpha, Orders::One(6)), &sixth);
            let root = nodes[2][2];
            let alpha = 1.0 - root * root;
            let factor = alpha * alpha * (-moments::decay(alpha, g) * d).exp() / d;
            close(&point(alpha, Orders::Rest), &moments::rest_scaled(d, g, &[alpha])[0].map(|v| v * factor));
            let sun =
                tables.query(&ask(Emitter::Directional, d, g, 1.0, Orders::One(1))).expect("an answer").zh;
            close(&sun, &directional::single(&rule, d, g));
        }
    }
    for emitter in [Emitter::Point, Emitter::Directional, Emitter::Area] {
        for depth in [1e-9, 1e-6, 0.03, 2.0, 700.0, 1e3, 1e6] {
            for g in [-0.99, -0.2, 0.99] {
                for albedo in [0.0, 0.3, 1.0] {
                    for orders in [Orders::One(1), Orders::One(10), Orders::Rest, Orders::All] {
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
    let missing = tables.query(&ask(Emitter::Point, 1.0, 0.0, 1.0, Orders::One(11)));
    assert!(missing.expect_err("ten orders").to_string().contains("tables build"));
}
