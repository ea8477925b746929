//! Responses of media: look-ups and direct integrals where depth, g, albedo and angles are extreme.

use crate::oracle::{self, nodes, point_fluence, sun_fluence};
use crate::{Group, Seen};
use bake::media::Media;
use bake::scene::model::{Density, Medium, Region, Scene};
use glam::Vec3;
use serde_json::Value;
use std::f64::consts::PI;
use std::sync::LazyLock;
use tables::harmonics::zonal::{double_product, henyey_greenstein, irradiance, legendre};
use tables::harmonics::{Zh, Zh64};
use tables::response::quadrature::{Node, tanh_sinh};
use tables::response::{directional, moments, patch, point};
use tables::table::combined::{Combined, CombinedPatch, Way};
use tables::table::file::Emitter;
use tables::table::{Orders, Query, Tables};

static RULE: LazyLock<Vec<Node>> = LazyLock::new(|| tanh_sinh(96));
static TABLES: LazyLock<Tables> = LazyLock::new(|| Tables::embedded().expect("embedded tables"));

/// Fluence of a lobe.
fn fluence(zh: &Zh64) -> f64 {
    (4.0 * PI).sqrt() * zh[0]
}

/// How far apart two numbers are, as a part of the second; infinite if the first is no number.
fn off(got: f64, want: f64) -> f64 {
    if got.is_finite() { ((got - want) / want).abs() } else { f64::INFINITY }
}

fn query(emitter: Emitter, depth: f64, g: f64, albedo: f64, orders: Orders) -> Zh64 {
    let q = Query { emitter, depth, theta: 0.0, g, albedo, orders };
    TABLES.query(&q).expect("an answer").zh
}

pub(crate) fn group() -> Group {
    let mut group = Group::new("responses");
    integrals(&mut group);
    patches(&mut group);
    look_ups(&mut group);
    limits(&mut group);
    phases(&mut group);
    group
}

/// Direct integrals against others.
fn integrals(group: &mut Group) {
    for depth in [1e-6, 1e-2, 1.0, 50.0, 1e3] {
        for g in [0.0, 0.9, -0.9, 0.99, -0.99] {
            let tolerance = if 0.9 < f64::abs(g) { 1e-7 } else { 1e-9 };
            group.add(format!("point scattered once, D {depth}, g {g}"), tolerance, move || {
                off(fluence(&point::single_scaled(&RULE, depth, g)), point_fluence(depth, g))
            });
        }
    }
    for depth in [1e-6, 1.0, 1e3] {
        for g in [0.0, 0.99, -0.99] {
            group.add(format!("sun scattered once, D {depth}, g {g}"), 1e-9, move || {
                off(fluence(&directional::single_scaled(&RULE, depth, g)), sun_fluence(depth, g))
            });
        }
    }
    group.add("sun scattered once at the plane itself", 1e-12, || {
        // Nothing comes from above: half of ln 2.
        off(fluence(&directional::single(&RULE, 0.0, 0.0)), 0.5 * 2f64.ln())
    });
    // Far from a point the sum of all orders without absorption is 3 (1 - g) / D: diffusion, whose other terms fall like exp(-D).
    for g in [0.0, 0.5, -0.9] {
        group.add(format!("all orders without absorption, D 30, g {g}"), 1e-4, move || {
            let zh = query(Emitter::Point, 30.0, g, 1.0, Orders::All);
            off(fluence(&zh), 3.0 * (1.0 - g) / 30.0)
        });
    }
    group.add("orders from 2 on next to the lamp, albedo 1", 1e-4, || {
        let (d, g) = (1e-3, 0.9);
        let scaled = moments::rest_scaled(d, g, &[1.0])[0];
        off(query(Emitter::Point, d, g, 1.0, Orders::Rest)[0], scaled[0] / d)
    });
}

fn area_rows() -> Option<Vec<Value>> {
    let folder = suite::shared("area emitters")?;
    let text = std::fs::read_to_string(folder.join("oracles/area_single.json")).ok()?;
    serde_json::from_str::<Value>(&text).ok()?["rows"].as_array().cloned()
}

fn patches(group: &mut Group) {
    // Patches of all normals together are a point that shines with a quarter of their area.
    for (depth, g) in [(1e-4, 0.0), (1.0, 0.0), (50.0, 0.0), (1e3, 0.0), (1.0, 0.99), (1.0, -0.99)] {
        group.add(format!("patches of all normals are a point, D {depth}, g {g}"), 1e-4, move || {
            let rule = tanh_sinh(40);
            let mean: f64 = nodes(32)
                .into_iter()
                .map(|[x, y, w]| {
                    // What faces the receiver, and what turns away: there is an edge between them.
                    let theta = 0.5 * PI * x;
                    let one = |theta: f64, sine: f64| {
                        let light = patch::single_scaled(&rule, depth, theta, &[g])[0];
                        0.25 * PI * w * sine * patch::fluence(&light)
                    };
                    one(theta, theta.sin()) + one(PI - 0.5 * PI * y, (0.5 * PI * y).sin())
                })
                .sum();
            off(mean, 0.25 * point_fluence(depth, g))
        });
    }
    for angle in [0.0, 90.0, 180.0f64] {
        group.add(format!("patch at {angle} degrees against reference integrals"), 2e-5, move || {
            let Some(rows) = area_rows() else { return Seen::Skipped };
            let rule = tanh_sinh(48);
            let number = |row: &Value, key: &str| row[key].as_f64().expect("a number");
            let rows = rows.iter().filter(|r| number(r, "theta_e") == angle);
            let worst = rows.map(|r| {
                let response = patch::single(&rule, number(r, "D"), angle.to_radians(), 0.0);
                (off(patch::fluence(&response), number(r, "fluence")) - 2.0 * number(r, "rel_err")).max(0.0)
            });
            Seen::Worst(worst.reduce(f64::max).expect("rows"))
        });
        group.add(format!("a few ulps around a patch at {angle} degrees"), 1e-4, move || {
            let theta = angle.to_radians();
            let at = |theta: f64| {
                let q = Query {
                    emitter: Emitter::Area,
                    depth: 1.0,
                    theta: theta.clamp(0.0, PI),
                    g: 0.5,
                    albedo: 0.9,
                    orders: Orders::All,
                };
                TABLES.query(&q).expect("an answer").light[0]
            };
            let all = [theta.next_down(), theta.next_up(), theta.next_up().next_up()].map(at);
            all.into_iter().map(|v| off(v, at(theta))).fold(0.0, f64::max)
        });
    }
}

fn look_ups(group: &mut Group) {
    for depth in [1e-6, 1e-4, 1.0, 50.0, 300.0] {
        group.add(format!("look-up of a point at D {depth}"), 2e-5, move || {
            // Scaled, because what arrives from far away is less than any number.
            let q = Query {
                emitter: Emitter::Point,
                depth,
                theta: 0.0,
                g: 0.3,
                albedo: 1.0,
                orders: Orders::Span(1, 1),
            };
            let got = TABLES.query_log(&q, depth + depth.ln()).expect("an answer");
            let want = point::single_scaled(&RULE, depth, 0.3);
            // Beyond its end the table says that it goes on as it ends.
            let known = depth <= 50.0;
            let wrong = known && !got.clamped.is_empty() && 1e-5 <= depth;
            let finite = got.zh.iter().all(|v| v.is_finite()) && 0.0 < got.zh[0];
            match (finite && !wrong, known) {
                (false, _) => f64::INFINITY,
                (true, false) => 0.0,
                (true, true) => off(got.zh[0], want[0]),
            }
        });
    }
    for (name, emitter) in
        [("point", Emitter::Point), ("sun", Emitter::Directional), ("patch", Emitter::Area)]
    {
        group.add(format!("albedo 0 under a {name} is black"), 0.0, move || {
            let all = [1e-6, 1.0, 1e3].map(|d| query(emitter, d, 0.5, 0.0, Orders::All));
            all.iter()
                .flatten()
                .map(|v| v.abs())
                .fold(0.0, |a, b| if b.is_nan() { b } else { f64::max(a, b) })
        });
        group.add(format!("an ulp below albedo 1 under a {name} is albedo 1"), 1e-6, move || {
            let of = |albedo: f64| query(emitter, 1.0, 0.5, albedo, Orders::All)[0];
            off(of(1f64.next_down()), of(1.0))
        });
        group.add(format!("D 1000 under a {name} is a number and not negative"), 0.0, move || {
            let all = [0.5, 1.0].map(|a| query(emitter, 1e3, -0.9, a, Orders::All));
            if all.iter().flatten().all(|v| v.is_finite()) {
                all.map(|z| (-z[0]).max(0.0))[0]
            } else {
                f64::NAN
            }
        });
        group.add(format!("g 0.99 and beyond under a {name} is that of the table's end"), 0.0, move || {
            let mut worst = 0.0f64;
            for g in [0.99, 1f64.next_down(), -0.99, (-1f64).next_up()] {
                let (got, end) = (
                    query(emitter, 1.0, g, 0.9, Orders::Span(1, 1)),
                    query(emitter, 1.0, 0.9f64.copysign(g), 0.9, Orders::Span(1, 1)),
                );
                worst = worst.max(off(got[0], end[0]));
            }
            worst
        });
    }
    group.add("g a few ulps around 0 is g 0", 1e-12, || {
        let of = |g: f64| query(Emitter::Point, 1.0, g, 0.9, Orders::All);
        let around = [5e-324, -5e-324, f64::EPSILON, -f64::EPSILON, -0.0].map(|g| of(g)[0]);
        around.into_iter().map(|v| off(v, of(0.0)[0])).fold(0.0, f64::max)
    });
    group.add("combined look-ups are those of the file", 1e-3, || {
        let combined = Combined::new(&TABLES, Emitter::Point, Orders::All, 0.9.into(), 1.0.into());
        let combined = combined.expect("tables");
        let at = [1e-3f32, 0.1, 1.0, 10.0];
        let one = |d: f32| {
            let want = query(Emitter::Point, f64::from(d), 0.9, 1.0, Orders::All)[0];
            off(f64::from(combined.look_up(d, 0.9, 1.0)[0]), want)
        };
        at.map(one).into_iter().fold(0.0, f64::max)
    });
    group.add("combined look-ups from 1e-30 to 1e30 are finite", 0.0, || {
        let of =
            |emitter| Combined::new(&TABLES, emitter, Orders::All, 0.5.into(), 0.9.into()).expect("tables");
        let all = [of(Emitter::Point), of(Emitter::Directional)];
        let mut bad = 0;
        for c in &all {
            for d in [1e-30f32, 1e-10, 1e-6, 1e3, 1e10, 1e30] {
                bad += c.look_up(d, 0.5, 0.9).iter().filter(|v| !v.is_finite()).count();
                bad += [-1.0, 1.0].into_iter().filter(|x| !c.irradiance(d, 0.5, 0.9, *x).is_finite()).count();
            }
        }
        bad as f64
    });
    group.add("a patch's look-up behind, beside and before it is finite", 0.0, || {
        let patches = CombinedPatch::new(&TABLES, Orders::All, 0.5.into(), 0.9.into()).expect("tables");
        let mut bad = 0;
        for d in [1e-10f32, 1e-6, 1.0, 1e3, 1e10] {
            for cosine in [-1.0f32, -1e-38, 0.0, f32::MIN_POSITIVE, 1f32.next_down(), 1.0] {
                for normal in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]] {
                    bad += usize::from(!patches.irradiance(d, 0.5, 0.9, cosine, normal).is_finite());
                }
            }
        }
        bad as f64
    });
    group.add("a way through nothing has no albedo and no g", 0.0, || {
        let mut way = Way::default();
        way.add(0.0, 1e6, 0.0, 0.9);
        way.add(1e-30, 0.0, 0.0, 0.0);
        let [a, b, c] = [way.albedo(), way.g(), way.sigma_t()].map(|v| f64::from(v.abs()));
        a + b + c
    });
}

/// Irradiance of lobes where the receiver faces the light, lies along it, and turns away.
fn limits(group: &mut Group) {
    group.add("double product at cos gamma +1 and -1", 1e-12, || {
        let g: Zh64 = point::single(&RULE, 0.1, 0.9);
        let want = |sign: f64| {
            let mut sum = 0.0;
            for (l, g) in g.iter().enumerate() {
                sum += g * g * if l % 2 == 0 { 1.0 } else { sign };
            }
            sum
        };
        [1.0, -1.0].map(|x| off(double_product(&g, &g, x), want(x))).into_iter().fold(0.0, f64::max)
    });
    group.add("Legendre polynomials an ulp inside +1 and -1", 1e-12, || {
        let mut worst = 0.0f64;
        for x in [1f64.next_down(), (-1f64).next_up()] {
            for (l, p) in legendre(x).into_iter().enumerate() {
                let want: f64 = if x < 0.0 && l % 2 == 1 { -1.0 } else { 1.0 };
                worst = worst.max((p - want).abs());
            }
        }
        worst
    });
    group.add("irradiance of a receiver that turns away is never negative", 0.0, || {
        let mut worst = 0.0f64;
        for g in [-0.99, -0.5, 0.0, 0.9, 0.99] {
            for d in [1e-6, 1e-2, 1.0, 50.0] {
                let zh: Zh = point::single_scaled(&RULE, d, g).map(single);
                // The truncated cosine swings around 0 where it turns away; an ulp inside of both ends as well.
                let ends = [-1.0f32, (-1f32).next_up(), -0.0, 1f32.next_down(), 1.0];
                for x in ends.into_iter().chain((-64i8..64).map(|i| f32::from(i) / 64.0)) {
                    let e = f64::from(irradiance(&zh, x));
                    worst = worst.max(if e.is_finite() { -e } else { f64::INFINITY });
                }
            }
        }
        worst.max(0.0)
    });
}

#[expect(clippy::cast_possible_truncation, reason = "single precision is what is tested")]
pub(crate) fn single(x: f64) -> f32 {
    x as f32
}

/// The phase function at its peaks, for g a few ulps around 0 and 1.
fn phases(group: &mut Group) {
    for g in [0.99f32, 1f32.next_down(), -0.99, (-1f32).next_up(), f32::MIN_POSITIVE, -f32::MIN_POSITIVE] {
        group.add(format!("phase function of g {g:?} at both ends"), 1e-6, move || {
            let medium = Medium {
                path: String::new(),
                sigma_s: Vec3::ONE,
                sigma_a: Vec3::ZERO,
                emission: Vec3::ZERO,
                density: Density::Constant,
                g,
                region: Region::Everywhere,
            };
            let scene = Scene { media: vec![medium], ..Scene::default() };
            let media = Media::new(&scene, Vec3::ZERO).expect("a medium");
            let ends = [(1.0f32, 0.0, 2.0), (-1.0, 2.0, 0.0), (0.0, 1.0, 1.0)];
            let one = |(x, towards, back): (f32, f64, f64)| {
                let want = oracle::phase(f64::from(g), towards, back);
                let wide = henyey_greenstein(f64::from(g), f64::from(x));
                off(4.0 * PI * f64::from(media.phase(g, x)), want).max(off(wide, want))
            };
            ends.map(one).into_iter().fold(0.0, f64::max)
        });
    }
}
