//! From packed rectangles to the finished [`Atlas`].

use std::collections::BTreeMap;

use glam::{DVec2, Vec2};
use uvunwrap::OutputMesh;

use super::{
    Atlas, AtlasOptions, Layout, NO_CHART, Page, Placement,
    group::{Class, cross},
    kept,
    pack::{Packed, Rect, Shape, Source},
};
use crate::{error::Finding, scene::model::Scene};

/// Pages come in multiples of this many texels, the block size of GPU texture compression.
const BLOCK: u32 = 4;

/// Texels by which rounding may carry a rectangle over a whole number.
const ROUNDING: f64 = 2e-3;

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
                for axis in 0..2 {
                    let end = p.min[axis] + p.size[axis] + options.padding;
                    used[r.page][axis] = end.max(used[r.page][axis]);
                }
            }
        }
    }
    let crop = |n: u32| n.max(1).next_multiple_of(BLOCK).min(options.max_size.max(n));
    atlas.pages =
        used.iter().map(|[w, h]| Page { width: crop(packed.width.max(*w)), height: crop(*h) }).collect();
    kept::report_gaps(scene, &atlas, findings);
    measure(&mut atlas);
    atlas
}

/// Adds the source's layouts, one for each different size, and its placements.
fn place(
    scene: &Scene,
    class: &Class,
    shape: &Shape,
    source: &Source,
    mesh: &OutputMesh,
    rects: &[Rect],
    atlas: &mut Atlas,
) {
    let mut known: BTreeMap<[u64; 2], usize> = BTreeMap::new();
    for (rect, &m) in rects.iter().zip(&source.members) {
        let size = rect.size.map(round_up);
        // Texture coordinates are stretched back so that texels stay as large as asked; what is
        // smaller than a texel fills it.
        let fill = DVec2::new(
            (rect.size[0].max(1.0) / f64::from(size[0])).min(1.0),
            (rect.size[1].max(1.0) / f64::from(size[1])).min(1.0),
        );
        let key = [fill.x.to_bits(), fill.y.to_bits()];
        let layout = *known.entry(key).or_insert_with(|| {
            atlas.layouts.push(match &shape.kept {
                Some(k) => kept::layout(scene, class.mesh, k, mesh, fill),
                None => unwrapped(scene, class.mesh, shape, mesh, fill),
            });
            atlas.layouts.len() - 1
        });
        atlas.placements[class.members[m].surface] = Some(Placement {
            layout,
            page: rect.page,
            min: rect.min,
            size,
            texels_per_metre: narrow(rect.density),
        });
    }
}

fn unwrapped(scene: &Scene, index: usize, shape: &Shape, mesh: &OutputMesh, fill: DVec2) -> Layout {
    let source = |v: u32| shape.origin.as_ref().map_or(v, |o| o[v as usize]);
    let uvs: Vec<Vec2> =
        mesh.vertices.iter().map(|v| (DVec2::from(v.uv.map(f64::from)) * fill).as_vec2()).collect();
    let triangles: Vec<[u32; 3]> = mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    let first = mesh.vertices.iter().filter_map(|v| v.chart).min().unwrap_or(0);
    let charts = triangles
        .iter()
        .map(|t| {
            let flat = cross(t.map(|v| uvs[v as usize].as_dvec2())) == 0.0;
            match mesh.vertices[t[0] as usize].chart {
                Some(c) if !flat => c - first,
                _ => NO_CHART,
            }
        })
        .collect();
    debug_assert_eq!(triangles.len(), scene.meshes[index].triangles.len());
    Layout {
        mesh: index,
        vertices: mesh.vertices.iter().map(|v| source(v.xref)).collect(),
        uvs,
        triangles,
        charts,
        kept: false,
    }
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

fn round_up(x: f64) -> u32 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "sizes on a page of at most 2^15 texels"
    )]
    let n = (x - ROUNDING).ceil().max(1.0) as u32;
    n
}

pub(super) fn narrow(x: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "densities and fractions within f32's range")]
    let y = x as f32;
    y
}
