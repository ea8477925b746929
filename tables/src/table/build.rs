//! Making tables.

use super::file::{Axis, Content, Emitter, Form, Part};
use crate::harmonics::{BANDS, Zh64};
use crate::response::interpolation::LogAxis;
use crate::response::patch::{HALF, Response};
use crate::response::quadrature::tanh_sinh;
use crate::response::{directional, moments, patch, point};
use rayon::prelude::*;

/// What a file is built over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preset {
    /// Its name.
    pub name: &'static str,
    /// Distances of points and suns.
    pub distance: Axis,
    /// g of what was scattered once, and of all orders from a point unless light that was scattered more often is isotropic.
    pub g: Axis,
    /// Whether orders from 2 on of a point have an axis of g; else they are for isotropic scattering, to be used by similarity.
    pub g_of_orders: bool,
    /// g of all orders at once from a point.
    pub g_of_rest: Axis,
    /// Distances of all orders at once; none: only single orders.
    pub far: Option<Axis>,
    /// Albedos of all orders at once, point emitter.
    pub albedos: usize,
    /// The same for directional light and patches.
    pub few_albedos: usize,
    /// Distances of what a patch sends that was scattered once.
    pub patch_distance: Axis,
    /// Its angles.
    pub angle: Axis,
    /// Its g.
    pub patch_g: Axis,
    /// What a patch's entries hold.
    pub form: Form,
    /// Distances of a patch's orders from 2 on.
    pub few_distance: Axis,
    /// Distances of all of them at once.
    pub few_far: Axis,
    /// Angles of a patch's orders from 2 on.
    pub few_angle: Axis,
    /// Angles of all of them at once, which are smoother.
    pub far_angle: Axis,
}

/// Single orders are followed to this distance, where exp(-distance) is far below the least f32.
const LAST: f64 = 120.0;

/// Nearest distance: what is tabulated is the response times distance, which changes less than 1e-5 from here to 0.
const FIRST: f64 = 1e-6;

const fn distances(last: f64, n: usize) -> Axis {
    Axis::Distance { first: FIRST, last, n, neighbours: 6 }
}

/// The file that comes with the program.
pub const DEFAULT: Preset = Preset {
    name: "default",
    distance: distances(LAST, 60),
    g: Axis::G { to: 0.9, n: 16 },
    g_of_orders: true,
    g_of_rest: Axis::G { to: 0.9, n: 16 },
    far: Some(distances(1e3, 58)),
    albedos: 26,
    few_albedos: 14,
    patch_distance: distances(LAST, 33),
    angle: Axis::Angle { per_side: 15 },
    patch_g: Axis::G { to: 0.9, n: 13 },
    form: Form::Full,
    few_distance: distances(LAST, 24),
    few_far: distances(1e3, 30),
    few_angle: Axis::Angle { per_side: 10 },
    far_angle: Axis::Angle { per_side: 8 },
};

/// The configuration of \[IR19\] section 5.1: 256 distances, 8 angles, g in {-0.5, 0, 0.5} for light that was scattered once, isotropic
/// scattering from the second time on, orders to 10, everything linear between its bins.
pub const PAPER: Preset = {
    let distance = Axis::Distance { first: 1e-4, last: 50.0, n: 256, neighbours: 2 };
    let g = Axis::Columns { to: 0.5, n: 3 };
    Preset {
        name: "paper",
        distance,
        g,
        g_of_orders: false,
        g_of_rest: g,
        far: None,
        albedos: 0,
        few_albedos: 0,
        patch_distance: distance,
        angle: Axis::Bins { n: 8 },
        patch_g: g,
        form: Form::Lobe,
        few_distance: distance,
        few_far: distance,
        few_angle: Axis::Bins { n: 8 },
        far_angle: Axis::Bins { n: 8 },
    }
};

/// About half as many nodes along every axis as the default has: what the others bring.
pub const HALVED: Preset = Preset {
    name: "half",
    distance: distances(LAST, 30),
    g: Axis::G { to: 0.9, n: 10 },
    g_of_orders: true,
    g_of_rest: Axis::G { to: 0.9, n: 10 },
    far: Some(distances(1e3, 30)),
    albedos: 14,
    few_albedos: 8,
    patch_distance: distances(LAST, 17),
    angle: Axis::Angle { per_side: 8 },
    patch_g: Axis::G { to: 0.9, n: 8 },
    form: Form::Full,
    few_distance: distances(LAST, 13),
    few_far: distances(1e3, 16),
    few_angle: Axis::Angle { per_side: 6 },
    far_angle: Axis::Angle { per_side: 5 },
};

/// About a quarter as many.
pub const QUARTERED: Preset = Preset {
    name: "quarter",
    distance: distances(LAST, 15),
    g: Axis::G { to: 0.9, n: 6 },
    g_of_orders: true,
    g_of_rest: Axis::G { to: 0.9, n: 6 },
    far: Some(distances(1e3, 15)),
    albedos: 8,
    few_albedos: 5,
    patch_distance: distances(LAST, 9),
    angle: Axis::Angle { per_side: 5 },
    patch_g: Axis::G { to: 0.9, n: 5 },
    form: Form::Full,
    few_distance: distances(LAST, 8),
    few_far: distances(1e3, 9),
    few_angle: Axis::Angle { per_side: 4 },
    far_angle: Axis::Angle { per_side: 4 },
};

/// As the default with the three columns of \[IR19\] for g, linear between them and at their end beyond: what the whole axis brings.
pub const COLUMNS: Preset = {
    let g = Axis::Columns { to: 0.5, n: 3 };
    Preset { name: "columns", g, g_of_rest: g, patch_g: g, ..DEFAULT }
};

/// Presets by name.
pub const PRESETS: [Preset; 5] = [DEFAULT, HALVED, QUARTERED, COLUMNS, PAPER];

/// Builds all tables; `report` is told what comes next.
#[must_use]
pub fn build(preset: &Preset, report: &dyn Fn(&str)) -> Vec<Content> {
    report("light of a point, scattered once and more often");
    let mut contents = points(preset);
    report("light of a sun");
    contents.extend(suns(preset));
    report("light of a patch, scattered once");
    contents.push(patches(preset));
    report("light of a patch, scattered more often");
    contents.extend(patch_orders(preset));
    contents
}

fn zonal(emitter: Emitter, part: Part, axes: Vec<Axis>, entries: &[Zh64]) -> Content {
    let entries = entries.iter().map(half).collect();
    Content { emitter, part, axes, form: Form::Zonal, entries, logs: Vec::new(), shifts: Vec::new() }
}

/// Zonal coefficients among those with m >= 0.
fn half(zh: &Zh64) -> Response {
    let mut out = [0.0; HALF];
    for l in 0..BANDS {
        out[l * (l + 1) / 2] = zh[l];
    }
    out
}

#[expect(clippy::cast_possible_truncation, reason = "orders are few")]
fn order(i: usize) -> Part {
    Part::Order(i as u32)
}

/// All pairs, the second running fastest.
fn pairs(a: Axis, b: Axis) -> Vec<(f64, f64)> {
    let b = b.nodes();
    a.nodes().into_iter().flat_map(|x| b.iter().map(move |&y| (x, y))).collect()
}

fn points(preset: &Preset) -> Vec<Content> {
    let rule = tanh_sinh(96);
    let Preset { distance, g, .. } = *preset;
    let once: Vec<Zh64> =
        pairs(distance, g).into_par_iter().map(|(d, g)| point::single_scaled(&rule, d, g)).collect();
    let mut out = vec![zonal(Emitter::Point, Part::Order(1), vec![distance, g], &once)];
    let (axes, jobs) = if preset.g_of_orders {
        (vec![distance, g], pairs(distance, g))
    } else {
        (vec![distance], distance.nodes().into_iter().map(|d| (d, 0.0)).collect())
    };
    let orders: Vec<moments::Orders> =
        jobs.into_par_iter().map(|(d, g)| moments::orders_scaled(d, g)).collect();
    for n in 2..=moments::ORDERS {
        let entries: Vec<Zh64> = orders.iter().map(|o| o[n - 2]).collect();
        out.push(zonal(Emitter::Point, order(n), axes.clone(), &entries));
    }
    if let Some(far) = preset.far {
        let root = Axis::RootOfAbsorption { from: 0.0, to: 1.0, n: preset.albedos };
        let albedos: Vec<f64> = root.nodes().iter().map(|r| 1.0 - r * r).collect();
        let g = preset.g_of_rest;
        let rest: Vec<Vec<Zh64>> =
            pairs(far, g).into_par_iter().map(|(d, g)| moments::rest_scaled(d, g, &albedos)).collect();
        let mut content = zonal(Emitter::Point, Part::Rest, vec![far, g, root], &rest.concat());
        let change: Vec<f64> = pairs(g, root)
            .into_par_iter()
            .map(|(g, r)| {
                let alpha = 1.0 - r * r;
                moments::similar_decay(alpha, g) - moments::decay(alpha, g)
            })
            .collect();
        content.logs = far.nodes().into_iter().flat_map(|d| change.iter().map(move |c| c * d)).collect();
        out.push(content);
    }
    out
}

/// An axis with the nodes of another and so many more between them that orders can be followed on it, and every which of its
/// nodes is one of the other's.
fn finer(axis: Axis) -> (LogAxis, usize) {
    let nodes = axis.nodes();
    let stride = (FOLLOWED - 1).div_ceil(nodes.len() - 1);
    let axis = LogAxis { first: nodes[0], last: nodes[nodes.len() - 1], n: (nodes.len() - 1) * stride + 1 };
    (axis, stride)
}

/// Nodes on which orders from 2 on are followed, at least.
const FOLLOWED: usize = 80;

fn suns(preset: &Preset) -> Vec<Content> {
    let rule = tanh_sinh(96);
    let Preset { distance, g, .. } = *preset;
    let single: Vec<Zh64> =
        pairs(distance, g).into_par_iter().map(|(d, g)| directional::single_scaled(&rule, d, g)).collect();
    let mut out = vec![zonal(Emitter::Directional, Part::Order(1), vec![distance, g], &single)];
    let thin = |light: Vec<Zh64>, stride: usize| -> Vec<Zh64> { light.into_iter().step_by(stride).collect() };
    let (axis, stride) = finer(distance);
    let orders = directional::HalfSpace::new(axis, 1.0).orders(moments::ORDERS - 1);
    for (i, entries) in orders.into_iter().enumerate() {
        out.push(zonal(Emitter::Directional, order(i + 2), vec![distance], &thin(entries, stride)));
    }
    if let Some(far) = preset.far {
        let from = (1.0 - super::query::MOST_UNDER_A_SUN).sqrt();
        let root = Axis::RootOfAbsorption { from, to: 1.0, n: preset.few_albedos };
        let (axis, stride) = finer(far);
        let mut entries = Vec::new();
        for r in root.nodes() {
            let alpha = 1.0 - r * r;
            let space = directional::HalfSpace::new(axis, moments::decay(alpha, 0.0));
            entries.extend(thin(space.rest(alpha), stride));
        }
        out.push(zonal(Emitter::Directional, Part::Rest, vec![root, far], &entries));
    }
    out
}

/// A patch's block.
fn fitted(part: Part, axes: Vec<Axis>, form: Form, light: &[Response]) -> Content {
    let fits: Vec<patch::Fit> = light.par_iter().map(patch::Fit::new).collect();
    let entries = match form {
        Form::Full => light.to_vec(),
        Form::Lobe | Form::Zonal => fits.iter().map(|f| half(&f.zh)).collect(),
    };
    Content {
        emitter: Emitter::Area,
        part,
        axes,
        form,
        entries,
        logs: Vec::new(),
        shifts: fits.iter().map(|f| f.shift).collect(),
    }
}

fn patches(preset: &Preset) -> Content {
    let rule = tanh_sinh(56);
    let (distance, angle) = (preset.patch_distance, preset.angle);
    let gs = preset.patch_g.nodes();
    let light: Vec<Response> = pairs(distance, angle)
        .into_par_iter()
        .flat_map_iter(|(d, a)| patch::single_scaled(&rule, d, a, &gs))
        .collect();
    fitted(Part::Order(1), vec![distance, angle, preset.patch_g], preset.form, &light)
}

fn patch_orders(preset: &Preset) -> Vec<Content> {
    let angle = preset.few_angle;
    let angles = angle.nodes();
    let thin = |light: Vec<Vec<Response>>, stride: usize| -> Vec<Response> {
        light.into_iter().step_by(stride).flatten().collect()
    };
    let mut out = Vec::new();
    let (axis, stride) = finer(preset.few_distance);
    let orders = patch::Orders::new(axis, 1.0, &patch::Orders::once(axis));
    for (i, light) in orders.orders(moments::ORDERS - 1, &angles).into_iter().enumerate() {
        let axes = vec![preset.few_distance, angle];
        out.push(fitted(order(i + 2), axes, preset.form, &thin(light, stride)));
    }
    if preset.far.is_some() {
        let root = Axis::RootOfAbsorption { from: 0.0, to: 1.0, n: preset.few_albedos };
        let (axis, stride) = finer(preset.few_far);
        let angles = preset.far_angle.nodes();
        let once = patch::Orders::once(axis);
        let mut rest = Vec::new();
        for r in root.nodes() {
            let alpha = 1.0 - r * r;
            let orders = patch::Orders::new(axis, moments::decay(alpha, 0.0), &once);
            rest.extend(thin(orders.rest(alpha, &angles), stride));
        }
        out.push(fitted(Part::Rest, vec![root, preset.few_far, preset.far_angle], preset.form, &rest));
    }
    out
}
