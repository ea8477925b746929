//! Whether second texture coordinates from the file can serve as lightmap coordinates.

use std::fmt;

use glam::DVec2;
use rayon::prelude::*;

use super::{
    Unwrap,
    group::{Class, cross},
    overlap::overlap,
};
use crate::{error::Finding, scene::model::Scene};

/// Part of a shape's area whose triangles may be flat in texture space.
const FLAT: f64 = 1e-3;

/// Part of the texture area that may be covered twice: unwrappers leave slivers at seams that
/// cover each other by up to 0.8 % in maps that engines show without a visible fault.
const TWICE: f64 = 1e-2;

/// How far outside [0, 1] rounding may carry a coordinate.
const OUTSIDE: f64 = 1e-3;

/// Valid texture coordinates of a class, or why there are none.
pub(super) type Validity = Result<Kept, Fault>;

/// Measures of valid texture coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kept {
    /// Whole numbers to subtract so that the coordinates lie in [0, 1].
    pub(super) shift: DVec2,
    /// Smallest coordinates after the shift.
    pub(super) lo: DVec2,
    /// Largest coordinates after the shift.
    pub(super) hi: DVec2,
    /// Units of [`Class::positions`] per unit of u and of v, in the mean over the area, such that
    /// their product gives the shape its true area.
    pub(super) stretch: DVec2,
}

/// Why texture coordinates cannot be kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Fault {
    /// Nobody asked for them.
    Ignored,
    Missing,
    NotFinite(usize),
    OutOfRange(DVec2, DVec2),
    Flat(f64),
    Overlap,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ignored => f.write_str("TEXCOORD_1 is not looked at"),
            Self::Missing => f.write_str("TEXCOORD_1 is missing"),
            Self::NotFinite(v) => write!(f, "TEXCOORD_1 of vertex {v} is not finite"),
            Self::OutOfRange(lo, hi) => write!(
                f,
                "TEXCOORD_1 spans {:.4} to {:.4} in u and {:.4} to {:.4} in v: expected one unit square",
                lo.x, hi.x, lo.y, hi.y
            ),
            Self::Flat(part) => write!(
                f,
                "TEXCOORD_1 has no area on triangles that make up {:.2} % of the surface",
                part * 100.0
            ),
            Self::Overlap => f.write_str("charts of TEXCOORD_1 overlap"),
        }
    }
}

/// Looks at the second texture coordinates of every class, in class order.
pub(super) fn examine(scene: &Scene, classes: &[Class], unwrap: Unwrap) -> Vec<Validity> {
    if unwrap == Unwrap::Always {
        return vec![Err(Fault::Ignored); classes.len()];
    }
    // Only `stretch` depends on the class; the rest is cheap beside the overlap test, which is
    // done once a mesh.
    let mut meshes: Vec<usize> = classes.iter().map(|c| c.mesh).collect();
    meshes.sort_unstable();
    meshes.dedup();
    let overlaps: Vec<bool> = meshes
        .par_iter()
        .map(|&m| {
            let all = corners(scene, m);
            all.iter().flatten().all(|c| c.is_finite()) && overlap(&all, TWICE)
        })
        .collect();
    classes
        .par_iter()
        .map(|c| {
            let kept = measure(scene, c)?;
            match meshes.binary_search(&c.mesh) {
                Ok(i) if overlaps[i] => Err(Fault::Overlap),
                _ => Ok(kept),
            }
        })
        .collect()
}

/// Findings about surfaces whose texture coordinates cannot be kept.
pub(super) fn refusals(scene: &Scene, classes: &[Class], validity: &[Validity]) -> Vec<Finding> {
    let mut out = Vec::new();
    for (class, v) in classes.iter().zip(validity) {
        let Err(fault) = v else { continue };
        for member in &class.members {
            out.push((
                member.surface,
                Finding::error(
                    &scene.surfaces[member.surface].path,
                    format!("{}: {fault}", scene.meshes[class.mesh].name),
                    "bake with `--unwrap auto`, or give the mesh a second texture coordinate set \
                     without overlaps inside [0, 1]",
                ),
            ));
        }
    }
    out.sort_by_key(|(surface, _)| *surface);
    out.into_iter().map(|(_, f)| f).collect()
}

/// Second texture coordinates of the corners of each triangle; empty where the mesh has none.
pub(super) fn corners(scene: &Scene, mesh: usize) -> Vec<[DVec2; 3]> {
    let mesh = &scene.meshes[mesh];
    match mesh.uvs.get(1) {
        Some(uv) if uv.len() == mesh.positions.len() => {
            mesh.triangles.iter().map(|t| t.map(|v| uv[v as usize].as_dvec2())).collect()
        }
        _ => Vec::new(),
    }
}

fn measure(scene: &Scene, class: &Class) -> Validity {
    let mesh = &scene.meshes[class.mesh];
    let all = corners(scene, class.mesh);
    if all.is_empty() {
        return Err(Fault::Missing);
    }
    let bad = mesh.triangles.iter().flatten().find(|&&v| !mesh.uvs[1][v as usize].is_finite());
    if let Some(&v) = bad {
        return Err(Fault::NotFinite(v as usize));
    }
    let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for &c in all.iter().flatten() {
        (lo, hi) = (lo.min(c), hi.max(c));
    }
    let shift = (lo + OUTSIDE).floor();
    if !(hi - shift).cmple(DVec2::splat(1.0 + OUTSIDE)).all() {
        return Err(Fault::OutOfRange(lo, hi));
    }
    let (mut flat, mut uv_area, mut along) = (0.0, 0.0, DVec2::ZERO);
    for (&t, uv) in mesh.triangles.iter().zip(&all) {
        let area = class.triangle_area(t);
        let det = cross(*uv);
        if det == 0.0 {
            flat += area;
            continue;
        }
        uv_area += det.abs() * 0.5;
        let [a, b, c] = class.corners(t);
        let (e1, e2, d1, d2) = (b - a, c - a, uv[1] - uv[0], uv[2] - uv[0]);
        let per_u = (e1 * d2.y - e2 * d1.y) / det;
        let per_v = (e2 * d1.x - e1 * d2.x) / det;
        // Weighted by texture area, where slivers count for nothing.
        let s = DVec2::new(per_u.length_squared(), per_v.length_squared());
        if s.is_finite() {
            along += s * det.abs();
        }
    }
    if FLAT * class.area < flat || uv_area == 0.0 {
        return Err(Fault::Flat(flat / class.area));
    }
    let mut aspect = (along.x / along.y).sqrt().sqrt();
    if !aspect.is_finite() || aspect == 0.0 || (aspect - 1.0).abs() < 0.01 {
        aspect = 1.0;
    }
    let mean = ((class.area - flat) / uv_area).sqrt();
    Ok(Kept { shift, lo: lo - shift, hi: hi - shift, stretch: DVec2::new(mean * aspect, mean / aspect) })
}
