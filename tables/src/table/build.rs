//! Making tables.

use super::file::{Axis, Content, Emitter, Part};
use crate::harmonics::Zh64;
use crate::response::interpolation::LogAxis;
use crate::response::quadrature::tanh_sinh;
use crate::response::{directional, moments, patch, point};
use rayon::prelude::*;

/// Sizes of the axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Distances from 1e-6 to 1e3 mean free paths.
    pub distances: usize,
    /// Values of g from -0.9 to 0.9.
    pub gs: usize,
    /// Albedos of the sum over all orders, point emitter.
    pub albedos: usize,
    /// The same for directional light and patches.
    pub few_albedos: usize,
    /// Angles of a patch.
    pub angles: usize,
    /// Distances of a patch's orders from 2 on.
    pub few_distances: usize,
    /// Angles of a patch's orders from 2 on.
    pub few_angles: usize,
}

/// The default file.
pub const DEFAULT: Sizes = Sizes {
    distances: 96,
    gs: 20,
    albedos: 20,
    few_albedos: 12,
    angles: 19,
    few_distances: 64,
    few_angles: 13,
};

/// Single orders are followed to this distance, where exp(-distance) is below the least f32; behind it they stay.
const LAST: f64 = 120.0;

/// Builds all tables.
#[must_use]
pub fn build(sizes: Sizes) -> Vec<Content> {
    let distance = Axis::Distance { first: 1e-6, last: 1e3, n: sizes.distances };
    let few = LogAxis { first: 1e-6, last: 1e3, n: sizes.few_distances };
    let g = Axis::G { from: -0.9, to: 0.9, n: sizes.gs };
    let root = Axis::RootOfAbsorption { from: 0.0, to: 1.0, n: sizes.albedos };
    let mut contents = points(distance, g, root);
    contents.extend(suns(distance, g, sizes.few_albedos));
    // Where light is scattered backwards, the vector irradiance close to a patch vanishes and turns around, and the axis of the
    // fitted lobe jumps: nothing there could be interpolated.
    let forward = Axis::G { from: 0.0, to: 0.9, n: sizes.gs.div_ceil(2).max(4) };
    contents.push(patches(distance, Axis::Angle { n: sizes.angles }, forward));
    contents.extend(patch_orders(few, sizes.few_angles, sizes.few_albedos));
    contents
}

fn content(emitter: Emitter, part: Part, axes: Vec<Axis>, entries: Vec<Zh64>) -> Content {
    Content { emitter, part, axes, entries, shifts: Vec::new() }
}

#[expect(clippy::cast_possible_truncation, reason = "orders are few")]
fn order(i: usize) -> Part {
    Part::Order(i as u32)
}

fn points(distance: Axis, g: Axis, root: Axis) -> Vec<Content> {
    let rule = tanh_sinh(96);
    let albedos: Vec<f64> = root.nodes().iter().map(|r| 1.0 - r * r).collect();
    let jobs: Vec<(f64, f64)> =
        distance.nodes().into_iter().flat_map(|d| g.nodes().into_iter().map(move |g| (d, g))).collect();
    // Distance outermost, g inside; of the rest the albedo innermost.
    let rows: Vec<(Zh64, moments::Orders, Vec<Zh64>)> = jobs
        .into_par_iter()
        .map(|(d, g)| {
            let near = d.min(LAST);
            let single = point::single_scaled(&rule, near, g);
            (single, moments::orders_scaled(near, g), moments::rest_scaled(d, g, &albedos))
        })
        .collect();
    let axes = vec![distance, g];
    let mut out =
        vec![content(Emitter::Point, Part::Order(1), axes.clone(), rows.iter().map(|r| r.0).collect())];
    for n in 2..=moments::ORDERS {
        let entries = rows.iter().map(|r| r.1[n - 2]).collect();
        out.push(content(Emitter::Point, order(n), axes.clone(), entries));
    }
    let entries = rows.iter().flat_map(|r| r.2.iter().copied()).collect();
    out.push(content(Emitter::Point, Part::Rest, vec![distance, g, root], entries));
    out
}

/// An axis with the nodes of another and so many more between them that orders can be followed on it, and every which of its
/// nodes is one of the other's.
fn finer(axis: LogAxis) -> (LogAxis, usize) {
    let stride = (FOLLOWED - 1).div_ceil(axis.n - 1);
    (LogAxis { n: (axis.n - 1) * stride + 1, ..axis }, stride)
}

/// Nodes on which orders from 2 on are followed, at least.
const FOLLOWED: usize = 64;

fn suns(distance: Axis, g: Axis, albedos: usize) -> Vec<Content> {
    let rule = tanh_sinh(96);
    let depths = distance.nodes();
    let single: Vec<Zh64> = depths
        .par_iter()
        .flat_map_iter(|&d| g.nodes().into_iter().map(move |g| (d, g)))
        .map(|(d, g)| directional::single_scaled(&rule, d, g))
        .collect();
    let mut out = vec![content(Emitter::Directional, Part::Order(1), vec![distance, g], single)];
    let (axis, stride) = finer(LogAxis { first: depths[0], last: depths[depths.len() - 1], n: depths.len() });
    let thin = |light: Vec<Zh64>| -> Vec<Zh64> { light.into_iter().step_by(stride).collect() };
    let orders = directional::HalfSpace::new(axis, 1.0).orders(moments::ORDERS - 1);
    for (i, entries) in orders.into_iter().map(thin).enumerate() {
        out.push(content(Emitter::Directional, order(i + 2), vec![distance], entries));
    }
    let root =
        Axis::RootOfAbsorption { from: (1.0 - super::query::MOST_UNDER_A_SUN).sqrt(), to: 1.0, n: albedos };
    let rest: Vec<Vec<Zh64>> = root
        .nodes()
        .iter()
        .map(|r| {
            let alpha = 1.0 - r * r;
            thin(directional::HalfSpace::new(axis, moments::decay(alpha, 0.0)).rest(alpha))
        })
        .collect();
    let entries = rest.into_iter().flatten().collect();
    out.push(content(Emitter::Directional, Part::Rest, vec![root, distance], entries));
    out
}

fn patches(distance: Axis, angle: Axis, g: Axis) -> Content {
    let rule = tanh_sinh(48);
    let gs = g.nodes();
    let jobs: Vec<(f64, f64)> =
        distance.nodes().into_iter().flat_map(|d| angle.nodes().into_iter().map(move |a| (d, a))).collect();
    let fits: Vec<patch::Fit> = jobs
        .into_par_iter()
        .flat_map_iter(|(d, a)| patch::single_scaled(&rule, d.min(LAST), a, &gs))
        .map(|r| patch::Fit::new(&r))
        .collect();
    fitted(Part::Order(1), vec![distance, angle, g], &fits)
}

fn fitted(part: Part, axes: Vec<Axis>, fits: &[patch::Fit]) -> Content {
    Content {
        emitter: Emitter::Area,
        part,
        axes,
        entries: fits.iter().map(|f| f.zh).collect(),
        shifts: fits.iter().map(|f| f.shift).collect(),
    }
}

fn patch_orders(axis: LogAxis, angles: usize, albedos: usize) -> Vec<Content> {
    let distance = Axis::Distance { first: axis.first, last: axis.last, n: axis.n };
    let (axis, stride) = finer(axis);
    let once = patch::Orders::once(axis);
    let angle = Axis::Angle { n: angles };
    let angles = angle.nodes();
    let fit = |light: Vec<Vec<patch::Response>>| -> Vec<patch::Fit> {
        light.iter().step_by(stride).flatten().map(patch::Fit::new).collect()
    };
    let mut out = Vec::new();
    for (i, light) in
        patch::Orders::new(axis, 1.0, &once).orders(moments::ORDERS - 1, &angles).into_iter().enumerate()
    {
        out.push(fitted(order(i + 2), vec![distance, angle], &fit(light)));
    }
    let root = Axis::RootOfAbsorption { from: 0.0, to: 1.0, n: albedos };
    let rest: Vec<patch::Fit> = root
        .nodes()
        .iter()
        .flat_map(|r| {
            let alpha = 1.0 - r * r;
            fit(patch::Orders::new(axis, moments::decay(alpha, 0.0), &once).rest(alpha, &angles))
        })
        .collect();
    out.push(fitted(Part::Rest, vec![root, distance, angle], &rest));
    out
}
