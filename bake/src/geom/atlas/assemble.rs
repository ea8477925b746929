//! From packed rectangles to the finished [`Atlas`].

use std::collections::BTreeMap;

use glam::{DVec2, Vec2};
use uvunwrap::{OutputMesh, OutputVertex};

use super::{
    Atlas, AtlasOptions, Layout, NO_CHART, Page, Placement,
    group::{Class, cross},
    kept,
    pack::{Packed, Rect, Shape, Source},
};
use crate::{error::Finding, scene::model::Scene};

/// Pages come in multiples of this many texels, the block size of GPU texture compression.
pub(super) const BLOCK: u32 = 4;

/// Texels that charts stay clear of the next texel: more than the spacing of f32 at 8192 texels.
pub(super) const CLEAR: f64 = 1.0 / 512.0;

/// Makes layouts, placements and pages.
pub(super) fn assemble(
    scene: &Scene,
    classes: &[Class],
    shapes: &[Shape],
    packed: Packed,
    options: &AtlasOptions,
    findings: &mut Vec<Finding>,
) -> Atlas {
    let mut atlas = Atlas {
        placements: vec![None; scene.surfaces.len()],
        texels_per_metre: narrow(packed.density),
        ..Atlas::default()
    };
    let mut used = vec![[0, 0]; packed.pages];
    for ((source, mesh), rects) in packed.sources.iter().zip(&packed.meshes).zip(&packed.rects) {
        let class = &classes[source.class];
        let shape = &shapes[source.class];
        place(scene, class, shape, source, mesh, rects, &mut atlas);
        for (r, &m) in rects.iter().zip(&source.members) {
            if let Some(p) = atlas.placements[class.members[m].surface] {
                let end = |axis: usize| p.min[axis] + p.size[axis] + options.padding;
                let [w, h] = used[r.page];
                used[r.page] = [end(0).max(w), end(1).max(h)];
            }
        }
    }
    let crop = |n: u32| n.max(1).next_multiple_of(BLOCK);
    atlas.pages =
        used.iter().map(|[w, h]| Page { width: crop(packed.width.max(*w)), height: crop(*h) }).collect();
    kept::report_gaps(scene, &atlas, findings);
    measure(&mut atlas);
    atlas
}

/// Adds the source's layout and its placements.
fn place(
    scene: &Scene,
    class: &Class,
    shape: &Shape,
    source: &Source,
    mesh: &OutputMesh,
    rects: &[Rect],
    atlas: &mut Atlas,
) {
    let Some(size) = rects.first().map(|r| r.size) else {
        return;
    };
    for (rect, &m) in rects.iter().zip(&source.members) {
        atlas.placements[class.members[m].surface] = Some(Placement {
            layout: atlas.layouts.len(),
            page: rect.page,
            min: rect.min,
            size,
            texels_per_metre: narrow(rect.density),
        });
    }
    atlas.layouts.push(match &shape.kept {
        Some(k) => kept::layout(scene, class.mesh, k, mesh, size),
        None => unwrapped(class.mesh, shape, mesh, size),
    });
}

fn unwrapped(mesh: usize, shape: &Shape, out: &OutputMesh, size: [u32; 2]) -> Layout {
    let source = |v: u32| shape.origin.as_ref().map_or(v, |o| o[v as usize]);
    let uvs = settle(out, DVec2::new(f64::from(size[0]), f64::from(size[1])));
    let triangles: Vec<[u32; 3]> = out.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    let first = out.vertices.iter().filter_map(|v| v.chart).min().unwrap_or(0);
    let charts = triangles
        .iter()
        .map(|t| {
            let flat = cross(t.map(|v| uvs[v as usize].as_dvec2())) == 0.0;
            match out.vertices[t[0] as usize].chart {
                Some(c) if !flat => c - first,
                _ => NO_CHART,
            }
        })
        .collect();
    let vertices = out.vertices.iter().map(|v| source(v.xref)).collect();
    Layout { mesh, vertices, uvs, triangles, charts, kept: false }
}

/// The coordinates, with each chart moved a little inside the whole texels it has to itself, so that
/// rounding never carries an edge into the next texel. Charts narrower than a texel are stretched
/// to fill it: rounding would lose them altogether otherwise.
fn settle(out: &OutputMesh, size: DVec2) -> Vec<Vec2> {
    let at = |v: &OutputVertex| DVec2::from(v.uv.map(f64::from)) * size;
    let mut bounds: BTreeMap<u32, (DVec2, DVec2)> = BTreeMap::new();
    for v in &out.vertices {
        if let Some(chart) = v.chart {
            let p = at(v);
            let b = bounds.entry(chart).or_insert((p, p));
            *b = (b.0.min(p), b.1.max(p));
        }
    }
    out.vertices
        .iter()
        .map(|v| {
            let mut p = at(v);
            if let Some((lo, hi)) = v.chart.and_then(|c| bounds.get(&c)) {
                for axis in 0..2 {
                    p[axis] = inside(p[axis], lo[axis], hi[axis]);
                }
            }
            (p / size).clamp(DVec2::ZERO, DVec2::ONE).as_vec2()
        })
        .collect()
}

/// Moves `x` as the interval from `lo` to `hi` has to move to stay clear of the ends of its texels.
fn inside(x: f64, lo: f64, hi: f64) -> f64 {
    let length = hi - lo;
    if length <= 0.0 {
        return x;
    }
    let (from, to) = if length < 1.0 {
        let cell = ((lo + hi) * 0.5).floor();
        (cell + CLEAR, cell + 1.0 - CLEAR)
    } else {
        let (first, end) = ((lo + CLEAR).floor(), (hi - CLEAR).ceil());
        (lo.max(first + CLEAR), hi.min(end - CLEAR))
    };
    from + (x - lo) / length * (to - from)
}

/// Fills in the number of charts and the utilisation.
pub(super) fn measure(atlas: &mut Atlas) {
    let of_layout: Vec<(usize, f64)> = atlas
        .layouts
        .iter()
        .map(|l| {
            let area = l.triangles.iter().map(|t| cross(t.map(|v| l.uvs[v as usize].as_dvec2())).abs());
            let charts = l.charts.iter().filter(|c| **c != NO_CHART).max();
            (charts.map_or(0, |c| *c as usize + 1), area.sum::<f64>() * 0.5)
        })
        .collect();
    let total: f64 = atlas.pages.iter().map(|p| f64::from(p.width) * f64::from(p.height)).sum();
    let mut covered = 0.0;
    for p in atlas.placements.iter().flatten() {
        let (charts, area) = of_layout[p.layout];
        atlas.charts += charts;
        covered += area * f64::from(p.size[0]) * f64::from(p.size[1]);
    }
    if 0.0 < total {
        atlas.utilisation = narrow(covered / total).clamp(0.0, 1.0);
    }
}

pub(super) fn narrow(x: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "densities and fractions within f32's range")]
    let y = x as f32;
    y
}
