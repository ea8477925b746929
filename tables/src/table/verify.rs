//! Tables against the numbers they stand for, computed again at a higher resolution.

use super::file::{Block, Emitter, Part, Tables};
use super::query::{MOST_UNDER_A_SUN, Orders, Query};
use crate::harmonics::Zh64;
use crate::response::interpolation::LogAxis;
use crate::response::patch::{self, HALF, Response};
use crate::response::quadrature::{Node, tanh_sinh};
use crate::response::{directional, moments, point};
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::PI;

/// Range of distances that are asked for, mean free paths.
pub const DEPTHS: (f64, f64) = (1e-4, 50.0);

/// Greatest |g| that is asked for.
pub const MOST_G: f64 = 0.9;

/// What was found for one kind of question.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Emitter and orders.
    pub what: String,
    /// Number of questions.
    pub queries: usize,
    /// Mean error: the largest difference among coefficients as a part of the first one.
    pub mean: f64,
    /// Error that 99 of 100 questions stay below.
    pub most: f64,
    /// Largest error.
    pub worst: f64,
    /// Where it is.
    pub place: String,
    /// What is allowed.
    pub bound: f64,
}

/// What it costs to stand for a patch's light by a lobe.
#[derive(Clone, Debug, Serialize)]
pub struct FitCost {
    /// Orders.
    pub what: String,
    /// Number of responses.
    pub queries: usize,
    /// Mean error of irradiance over receiver normals and responses, as a part of the greatest irradiance over normals.
    pub mean: f64,
    /// Largest such error.
    pub worst: f64,
    /// Where it is.
    pub place: String,
}

/// All that was found.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Entries where they lie: rounding and resolution of the builder.
    pub entries: Vec<Row>,
    /// Random look-ups.
    pub lookups: Vec<Row>,
    /// Lobes for patches.
    pub fits: Vec<FitCost>,
}

impl Report {
    /// Whether everything is within its bound.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.entries.iter().chain(&self.lookups).all(|r| r.worst <= r.bound)
    }
}

/// A question that was asked, its table's answer and the truth.
struct Asked {
    what: (Emitter, Part),
    place: String,
    error: f64,
    /// Mean and worst error of the lobe.
    fit: Option<(f64, f64)>,
}

/// Largest difference as a part of the first coefficient.
fn error(got: &Response, want: &Response) -> f64 {
    let off = got.iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let e = off / want[0].abs();
    // Both are nothing.
    if want[0] == 0.0 && off == 0.0 { 0.0 } else { e }
}

fn half(zh: &Zh64, factor: f64) -> Response {
    let mut out = [0.0; HALF];
    for (l, z) in zh.iter().enumerate() {
        out[l * (l + 1) / 2] = z * factor;
    }
    out
}

/// Asks about `queries` random look-ups, and about entries; `report` is told what comes next.
#[must_use]
pub fn verify(tables: &Tables, queries: u32, seed: u64, report: &dyn Fn(&str)) -> Report {
    #[expect(clippy::cast_possible_truncation, reason = "either half will do")]
    let draw = Draw { seed: (seed ^ (seed >> 32)) as u32 };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a small number")]
    let part = |share: f64| (f64::from(queries) * share).ceil() as u32;
    report("entries");
    let entries = entries(tables, &draw);
    report("light of a point");
    let mut asked = points(tables, &draw, part(0.055));
    report("light of a sun");
    asked.extend(suns(tables, &draw, part(0.1)));
    report("light of a patch, scattered once");
    asked.extend(patches(tables, &draw, part(0.1)));
    report("light of a patch, scattered more often");
    asked.extend(patch_orders(tables, &draw, part(0.02)));
    Report { entries: rows(&entries, entry_bound), lookups: rows(&asked, bound), fits: fits(&asked) }
}

/// Random numbers that cover the space of questions evenly.
struct Draw {
    seed: u32,
}

impl Draw {
    fn unit(&self, i: u32, dimension: u32) -> f64 {
        f64::from(sobol_burley::sample(i, dimension, self.seed))
    }

    fn depth(&self, i: u32) -> f64 {
        DEPTHS.0 * (DEPTHS.1 / DEPTHS.0).powf(self.unit(i, 0))
    }

    fn g(&self, i: u32, dimension: u32) -> f64 {
        MOST_G * (2.0 * self.unit(i, dimension) - 1.0)
    }
}

/// What look-ups may be off.
fn bound((emitter, part): (Emitter, Part)) -> f64 {
    if emitter == Emitter::Point || part == Part::Order(1) { 1e-3 } else { 5e-3 }
}

/// What entries may be off: half a step of the numbers in the file is 7e-5 of the first coefficient.
fn entry_bound(_: (Emitter, Part)) -> f64 {
    1e-4
}

fn rows(asked: &[Asked], bound: fn((Emitter, Part)) -> f64) -> Vec<Row> {
    kinds(asked)
        .into_iter()
        .map(|kind| {
            let mut of: Vec<&Asked> = asked.iter().filter(|a| a.what == kind).collect();
            of.sort_by(|a, b| a.error.total_cmp(&b.error));
            let n = of.len();
            let worst = of[n - 1];
            Row {
                what: format!("{} {}", kind.0, kind.1),
                queries: n,
                mean: of.iter().map(|a| a.error).sum::<f64>() / n as f64,
                most: of[(n - 1) * 99 / 100].error,
                worst: worst.error,
                place: worst.place.clone(),
                bound: bound(kind),
            }
        })
        .collect()
}

fn kinds(asked: &[Asked]) -> Vec<(Emitter, Part)> {
    let mut kinds: Vec<(Emitter, Part)> = Vec::new();
    for a in asked {
        if !kinds.contains(&a.what) {
            kinds.push(a.what);
        }
    }
    kinds
}

fn fits(asked: &[Asked]) -> Vec<FitCost> {
    kinds(asked)
        .into_iter()
        .filter_map(|kind| {
            let of: Vec<(&Asked, (f64, f64))> =
                asked.iter().filter(|a| a.what == kind).filter_map(|a| Some((a, a.fit?))).collect();
            let (worst, (_, most)) = of.iter().max_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
            Some(FitCost {
                what: format!("{} {}", kind.0, kind.1),
                queries: of.len(),
                mean: of.iter().map(|a| a.1.0).sum::<f64>() / of.len() as f64,
                worst: *most,
                place: worst.place.clone(),
            })
        })
        .collect()
}

fn ask(tables: &Tables, what: (Emitter, Part), mut q: Query, want: &Response) -> Asked {
    q.orders = match what.1 {
        Part::Order(n) => Orders::Span(n, n),
        Part::Rest => Orders::Rest,
    };
    let area = q.emitter == Emitter::Area;
    let mut place = format!("D {:.4e}, g {:.3}", q.depth, q.g);
    if area {
        place += &format!(", theta {:.2}", q.theta.to_degrees());
    }
    if q.albedo != 1.0 {
        place += &format!(", albedo {:.4}", q.albedo);
    }
    let Ok(answer) = tables.query(&q) else {
        return Asked { what, place, error: f64::INFINITY, fit: None };
    };
    let fit = area.then(|| fit_cost(want, &answer.zh, answer.axis));
    Asked { what, place, error: error(&answer.light, want), fit }
}

/// Mean and largest error of a lobe's irradiance over 128 normals, as parts of the greatest irradiance.
fn fit_cost(light: &Response, zh: &Zh64, axis: [f64; 3]) -> (f64, f64) {
    const NORMALS: u32 = 128;
    let lobe = patch::lobe(zh, axis);
    let (mut sum, mut worst, mut peak) = (0.0, 0.0f64, 0.0f64);
    for k in 0..NORMALS {
        // A spiral by the golden angle.
        let c = 1.0 - (2.0 * f64::from(k) + 1.0) / f64::from(NORMALS);
        let (s, phi) = ((1.0 - c * c).sqrt(), PI * (3.0 - 5f64.sqrt()) * f64::from(k));
        let n = [s * phi.cos(), s * phi.sin(), c];
        let full = patch::irradiance(light, n);
        let off = (full - patch::irradiance(&lobe, n)).abs();
        sum += off;
        worst = worst.max(off);
        peak = peak.max(full);
    }
    (sum / f64::from(NORMALS) / peak, worst / peak)
}

fn single(emitter: Emitter, g: f64, depth: f64, theta: f64) -> Query {
    Query { emitter, depth, theta, g, albedo: 1.0, orders: Orders::All }
}

/// Orders from 2 on of an emitter that a file has.
fn orders_of(tables: &Tables, emitter: Emitter) -> Vec<u32> {
    #[expect(clippy::cast_possible_truncation, reason = "orders are few")]
    (2..=moments::ORDERS as u32).filter(|&n| tables.block(emitter, Part::Order(n)).is_some()).collect()
}

/// Anisotropic throughout, whatever the tables assume.
fn points(tables: &Tables, draw: &Draw, n: u32) -> Vec<Asked> {
    let rule = tanh_sinh(144);
    let orders = orders_of(tables, Emitter::Point);
    (0..n)
        .into_par_iter()
        .flat_map_iter(|i| {
            let (d, g) = (draw.depth(i), draw.g(i, 1));
            let q = single(Emitter::Point, g, d, 0.0);
            let mut out = Vec::new();
            let once = (Emitter::Point, Part::Order(1));
            if tables.block(once.0, once.1).is_some() {
                out.push(ask(tables, once, q, &half(&point::single(&rule, d, g), 1.0)));
            }
            if !orders.is_empty() {
                let truth = moments::orders_in_detail(d, g, 2);
                for &k in &orders {
                    let want = half(&truth[k as usize - 2], (-d).exp() / d);
                    out.push(ask(tables, (Emitter::Point, Part::Order(k)), q, &want));
                }
            }
            let rest = (Emitter::Point, Part::Rest);
            if tables.block(rest.0, rest.1).is_some() {
                for dimension in [2, 3] {
                    let albedo = draw.unit(i, dimension).clamp(1e-3, 1.0 - 1e-9);
                    let factor = albedo * albedo * (-moments::decay(albedo, g) * d).exp() / d;
                    let want = half(&moments::rest_in_detail(d, g, &[albedo], 2)[0], factor);
                    out.push(ask(tables, rest, Query { albedo, ..q }, &want));
                }
            }
            out
        })
        .collect()
}

/// Distances at which orders are followed again: many more than the builder's, and not the same.
const FOLLOWED: LogAxis = LogAxis { first: 1e-6, last: 1e3, n: 161 };

/// Some of those distances that are asked for.
fn followed(draw: &Draw, i: u32, dimension: u32) -> usize {
    let nodes: Vec<usize> =
        (0..FOLLOWED.n).filter(|&k| (DEPTHS.0..=DEPTHS.1).contains(&FOLLOWED.node(k))).collect();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of their number")]
    let k = (draw.unit(i, dimension) * nodes.len() as f64) as usize;
    nodes[k.min(nodes.len() - 1)]
}

/// Orders from 2 on for isotropic scattering; what similarity makes of it is a matter of its own.
fn suns(tables: &Tables, draw: &Draw, n: u32) -> Vec<Asked> {
    let rule = tanh_sinh(144);
    let mut out = Vec::new();
    let once = (Emitter::Directional, Part::Order(1));
    if tables.block(once.0, once.1).is_some() {
        out.par_extend((0..n).into_par_iter().map(|i| {
            let (d, g) = (draw.depth(i), draw.g(i, 1));
            let want = half(&directional::single(&rule, d, g), 1.0);
            ask(tables, once, single(Emitter::Directional, g, d, 0.0), &want)
        }));
    }
    let orders = orders_of(tables, Emitter::Directional);
    if !orders.is_empty() {
        let truth = directional::HalfSpace::new(FOLLOWED, 1.0).orders(moments::ORDERS - 1);
        for i in 0..n / 2 {
            let at = followed(draw, i, 0);
            let d = FOLLOWED.node(at);
            let k = orders[i as usize % orders.len()];
            let want = half(&truth[k as usize - 2][at], (-d).exp());
            let q = single(Emitter::Directional, 0.0, d, 0.0);
            out.push(ask(tables, (Emitter::Directional, Part::Order(k)), q, &want));
        }
    }
    let rest = (Emitter::Directional, Part::Rest);
    if tables.block(rest.0, rest.1).is_some() {
        for a in 0..16 {
            let albedo = draw.unit(a, 2).clamp(1e-3, MOST_UNDER_A_SUN);
            let nu = moments::decay(albedo, 0.0);
            let truth = directional::HalfSpace::new(FOLLOWED, nu).rest(albedo);
            for i in 0..(n / 32).max(1) {
                let at = followed(draw, i, 1);
                let d = FOLLOWED.node(at);
                let want = half(&truth[at], albedo * albedo * (-nu * d).exp());
                let q = Query { albedo, ..single(Emitter::Directional, 0.0, d, 0.0) };
                out.push(ask(tables, rest, q, &want));
            }
        }
    }
    out
}

fn patches(tables: &Tables, draw: &Draw, n: u32) -> Vec<Asked> {
    let once = (Emitter::Area, Part::Order(1));
    if tables.block(once.0, once.1).is_none() {
        return Vec::new();
    }
    let rule = tanh_sinh(80);
    (0..n)
        .into_par_iter()
        .flat_map_iter(|i| {
            let (d, theta) = (draw.depth(i), PI * draw.unit(i, 2));
            let gs = [draw.g(i, 1), draw.g(i, 3)];
            let truth = patch::single_scaled(&rule, d, theta, &gs);
            gs.into_iter().zip(truth).map(move |(g, light)| {
                let want = light.map(|v| v * (-d).exp() / d);
                ask(tables, once, single(Emitter::Area, g, d, theta), &want)
            })
        })
        .collect()
}

/// Isotropic scattering, as with [`suns`].
fn patch_orders(tables: &Tables, draw: &Draw, n: u32) -> Vec<Asked> {
    let mut out = Vec::new();
    let orders = orders_of(tables, Emitter::Area);
    let rest = (Emitter::Area, Part::Rest);
    let with_rest = tables.block(rest.0, rest.1).is_some();
    if orders.is_empty() && !with_rest {
        return out;
    }
    let angles: Vec<f64> = (0..24).map(|i| PI * draw.unit(i, 2)).collect();
    let once = patch::Orders::once(FOLLOWED);
    let place = |i: u32| (followed(draw, i, 0), i as usize % angles.len());
    if !orders.is_empty() {
        let truth = patch::Orders::new(FOLLOWED, 1.0, &once).orders(moments::ORDERS - 1, &angles);
        for i in 0..n * 2 {
            let (at, angle) = place(i);
            let d = FOLLOWED.node(at);
            let k = orders[(i as usize / angles.len()) % orders.len()];
            let want = truth[k as usize - 2][at][angle].map(|v| v * (-d).exp() / d);
            let q = single(Emitter::Area, 0.0, d, angles[angle]);
            out.push(ask(tables, (Emitter::Area, Part::Order(k)), q, &want));
        }
    }
    if with_rest {
        for a in 0..8 {
            let albedo = draw.unit(a, 3).clamp(1e-3, 1.0 - 1e-9);
            let nu = moments::decay(albedo, 0.0);
            let truth = patch::Orders::new(FOLLOWED, nu, &once).rest(albedo, &angles);
            for i in 0..(n / 4).max(1) {
                let (at, angle) = place(i + n * a);
                let d = FOLLOWED.node(at);
                let want = truth[at][angle].map(|v| v * albedo * albedo * (-nu * d).exp() / d);
                let q = Query { albedo, ..single(Emitter::Area, 0.0, d, angles[angle]) };
                out.push(ask(tables, rest, q, &want));
            }
        }
    }
    out
}

/// Entries that are computed again, of every block of light that was scattered once and of points.
const ENTRIES: u32 = 48;

fn entries(tables: &Tables, draw: &Draw) -> Vec<Asked> {
    let (fine, coarse) = (tanh_sinh(144), tanh_sinh(80));
    let jobs: Vec<(&Block, u32)> = tables
        .header()
        .blocks
        .iter()
        .filter(|b| b.emitter == Emitter::Point || b.part == Part::Order(1))
        .flat_map(|b| (0..ENTRIES).map(move |i| (b, i)))
        .collect();
    jobs.into_par_iter()
        .filter_map(|(block, i)| entry(tables, block, draw.unit(i, 0), &fine, &coarse))
        .collect()
}

/// One entry against the truth there, both scaled as they are stored.
fn entry(tables: &Tables, block: &Block, unit: f64, fine: &[Node], coarse: &[Node]) -> Option<Asked> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of their number")]
    let i = ((unit * block.entries() as f64) as usize).min(block.entries() - 1);
    let at = block.place(i);
    let d = at[0];
    let stored = tables.entry(block, i);
    let mut log = stored.log;
    let want = match (block.emitter, block.part) {
        (Emitter::Point, Part::Order(1)) => half(&point::single_scaled(fine, d, at[1]), 1.0),
        (Emitter::Point, Part::Order(k)) => {
            let g = at.get(1).copied().unwrap_or(0.0);
            half(&moments::orders_in_detail(d, g, 2)[k as usize - 2], 1.0)
        }
        (Emitter::Point, Part::Rest) => {
            let alpha = 1.0 - at[2] * at[2];
            log -= d * (moments::similar_decay(alpha, at[1]) - moments::decay(alpha, at[1]));
            half(&moments::rest_in_detail(d, at[1], &[alpha], 2)[0], 1.0)
        }
        (Emitter::Directional, Part::Order(1)) => half(&directional::single_scaled(fine, d, at[1]), 1.0),
        (Emitter::Area, Part::Order(1)) => {
            let light = patch::single_scaled(coarse, d, at[1], &[at[2]])[0];
            if block.form == super::file::Form::Lobe {
                let zh = patch::about(&light, patch::axis(stored.shift));
                half(&zh, 1.0)
            } else {
                light
            }
        }
        _ => return None,
    };
    let place = format!("entry {i}: {at:.4?}");
    Some(Asked {
        what: (block.emitter, block.part),
        place,
        error: error(&stored.ratios.map(|r| r * log.exp()), &want),
        fit: None,
    })
}
