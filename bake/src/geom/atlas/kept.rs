//! Texture coordinates kept from the file.

use std::collections::BTreeMap;

use glam::{DVec2, Vec2};
use rayon::prelude::*;
use uvunwrap::OutputMesh;

use super::{
    Atlas, AtlasOptions, Density, Layout, NO_CHART, Page, Placement,
    assemble::{CLEAR, measure, narrow},
    group::{Class, cross},
    overlap::overlap,
    valid::{self, Kept, Validity},
};
use crate::{
    error::Finding,
    geom::texel::coverage,
    scene::model::{Mesh, Scene},
};

/// Texels that two charts should lie apart at least.
const GAP: u32 = 2;

/// The file's coordinates moved into the rectangle that the packer gave to a stand-in: `packed`
/// is that stand-in, a rectangle with corners (0, 0), (1, 0), (1, 1), (0, 1), perhaps turned.
pub(super) fn layout(scene: &Scene, mesh: usize, kept: &Kept, packed: &OutputMesh, size: [u32; 2]) -> Layout {
    let corner = |n: u32| {
        packed.vertices.iter().find(|v| v.xref == n).map_or(DVec2::ZERO, |v| DVec2::from(v.uv.map(f64::from)))
    };
    let (o, u, v) = (corner(0), corner(1) - corner(0), corner(3) - corner(0));
    let extent = kept.hi - kept.lo;
    whole(scene, mesh, |p| {
        let q = ((p - kept.shift - kept.lo) / extent).clamp(DVec2::ZERO, DVec2::ONE);
        let margin = DVec2::new(CLEAR / f64::from(size[0]), CLEAR / f64::from(size[1]));
        (o + u * q.x + v * q.y).clamp(margin, DVec2::ONE - margin).clamp(DVec2::ZERO, DVec2::ONE).as_vec2()
    })
}

/// A layout with the mesh's own vertices.
fn whole(scene: &Scene, index: usize, map: impl Fn(DVec2) -> Vec2) -> Layout {
    let mesh = &scene.meshes[index];
    // Vertices that no triangle uses may hold anything.
    let place = |uv: &Vec2| if uv.is_finite() { map(uv.as_dvec2()) } else { Vec2::ZERO };
    let uvs: Vec<Vec2> = mesh.uvs.get(1).map_or_else(Vec::new, |uv| uv.iter().map(place).collect());
    let charts = islands(mesh, &uvs);
    Layout {
        mesh: index,
        vertices: (0..).take(uvs.len()).collect(),
        uvs,
        triangles: mesh.triangles.clone(),
        charts,
        kept: true,
    }
}

/// Chart of each triangle: triangles hang together where they share position and coordinate.
fn islands(mesh: &Mesh, uvs: &[Vec2]) -> Vec<u32> {
    let mut same: BTreeMap<[u32; 5], usize> = BTreeMap::new();
    let point: Vec<usize> = mesh
        .positions
        .iter()
        .zip(uvs)
        .map(|(p, uv)| {
            // Adding zero makes both zeros the same.
            let key = [p.x, p.y, p.z, uv.x, uv.y].map(|c| (c + 0.0).to_bits());
            let next = same.len();
            *same.entry(key).or_insert(next)
        })
        .collect();
    let mut parent: Vec<usize> = (0..same.len()).collect();
    let solid = |t: &[u32; 3]| cross(t.map(|v| uvs[v as usize].as_dvec2())) != 0.0;
    for t in mesh.triangles.iter().filter(|t| solid(t)) {
        let mut a = root(&mut parent, point[t[0] as usize]);
        for v in &t[1..] {
            let b = root(&mut parent, point[*v as usize]);
            parent[a.max(b)] = a.min(b);
            a = a.min(b);
        }
    }
    let mut ids: BTreeMap<usize, u32> = BTreeMap::new();
    let mut next = 0;
    mesh.triangles
        .iter()
        .map(|t| {
            if !solid(t) {
                return NO_CHART;
            }
            *ids.entry(root(&mut parent, point[t[0] as usize])).or_insert_with(|| {
                next += 1;
                next - 1
            })
        })
        .collect()
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

/// The atlas that the file already is, if the second texture coordinates of all surfaces share one
/// unit square without overlaps: one page and unchanged coordinates.
///
/// The page is square, or has the proportions at which texels come out square.
pub(super) fn shared(
    scene: &Scene,
    options: &AtlasOptions,
    classes: &[Class],
    validity: &[Validity],
) -> Option<Atlas> {
    let mut all = Vec::new();
    // Square metres, square units of texture, and squared metres per unit of u and v.
    let (mut metres, mut units, mut along) = (0.0, 0.0, DVec2::ZERO);
    for (class, v) in classes.iter().zip(validity) {
        let kept = v.as_ref().ok()?;
        let [member] = class.members.as_slice() else { return None };
        if kept.shift != DVec2::ZERO {
            return None;
        }
        let corners = valid::corners(scene, class.mesh);
        let area: f64 = corners.iter().map(|t| cross(*t).abs() * 0.5).sum();
        let scale = member.metres * member.metres;
        metres += class.area * scale;
        units += area;
        along += kept.stretch * kept.stretch * area * scale;
        all.extend(corners);
    }
    if all.is_empty() || overlap(&all, 1e-3) {
        return None;
    }
    let aspect = (along.x / along.y).sqrt();
    let aspect = if aspect.is_finite() && 0.02 < (aspect - 1.0).abs() { aspect } else { 1.0 };
    // Units of texture to metres on a page with these proportions.
    let mean = (metres / units).sqrt();
    let limit = f64::from(options.max_size);
    let (width, height) = match options.density {
        Density::Fit { page_size } => {
            let side = f64::from(page_size).min(limit);
            if aspect < 1.0 { (side * aspect, side) } else { (side, side / aspect) }
        }
        Density::Fixed(d) => {
            let (w, h) = (mean * aspect.sqrt() * f64::from(d), mean / aspect.sqrt() * f64::from(d));
            let shrink = (limit / w.max(h)).min(1.0);
            (w * shrink, h * shrink)
        }
    };
    let page = Page { width: blocks(width, options.max_size), height: blocks(height, options.max_size) };
    let density = (f64::from(page.width) * f64::from(page.height) * units / metres).sqrt();
    let mut atlas = Atlas {
        pages: vec![page],
        placements: vec![None; scene.surfaces.len()],
        texels_per_metre: narrow(density),
        ..Atlas::default()
    };
    for class in classes {
        for member in &class.members {
            atlas.placements[member.surface] = Some(Placement {
                layout: atlas.layouts.len(),
                page: 0,
                min: [0, 0],
                size: [page.width, page.height],
                texels_per_metre: narrow(density),
            });
        }
        let unit = |p: DVec2| p.clamp(DVec2::ZERO, DVec2::ONE).as_vec2();
        atlas.layouts.push(whole(scene, class.mesh, unit));
    }
    measure(&mut atlas);
    Some(atlas)
}

/// The nearest multiple of four texels, at least four and at most `most`.
fn blocks(x: f64, most: u32) -> u32 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the cast saturates and the result is limited"
    )]
    let n = (x * 0.25).round() as u32;
    n.max(1).saturating_mul(4).min(most)
}

/// Says where kept charts lie closer than bilinear sampling allows.
pub(super) fn report_gaps(scene: &Scene, atlas: &Atlas, findings: &mut Vec<Finding>) {
    // Surfaces that share layout and size have the same gaps; the first one speaks for them.
    let mut seen: BTreeMap<(usize, [u32; 2]), usize> = BTreeMap::new();
    for (surface, p) in atlas.placements.iter().enumerate() {
        if let Some(p) = p.filter(|p| atlas.layouts[p.layout].kept) {
            seen.entry((p.layout, p.size)).or_insert(surface);
        }
    }
    let mut cases: Vec<(usize, usize, [u32; 2])> =
        seen.into_iter().map(|((layout, size), surface)| (surface, layout, size)).collect();
    cases.sort_unstable();
    let found: Vec<Option<Finding>> = cases
        .into_par_iter()
        .map(|(surface, layout, size)| {
            let close = close_texels(&atlas.layouts[layout], size);
            (0 < close).then(|| {
                Finding::warning(
                    &scene.surfaces[surface].path,
                    format!(
                        "charts of TEXCOORD_1 come closer than {GAP} texels to each other at {close} \
                         texels of {} x {}: light may bleed between them",
                        size[0], size[1]
                    ),
                    "raise the density, put more space between the charts, or bake with --unwrap always",
                )
            })
        })
        .collect();
    findings.extend(found.into_iter().flatten());
}

/// Number of covered texels with another chart less than two empty texels away to the right or
/// below.
fn close_texels(layout: &Layout, [width, height]: [u32; 2]) -> usize {
    let (w, h) = (width as usize, height as usize);
    let mut grid = vec![NO_CHART; w * h];
    let mut shared = 0;
    for (t, &chart) in layout.triangles.iter().zip(&layout.charts) {
        let scale = DVec2::new(f64::from(width), f64::from(height));
        let corners = t.map(|v| layout.uvs[v as usize].as_dvec2() * scale);
        coverage(&corners, width, height, |x, y| {
            let cell = &mut grid[y as usize * w + x as usize];
            if *cell == NO_CHART {
                *cell = chart;
            } else if *cell != chart {
                shared += 1;
            }
        });
    }
    let reach = GAP as usize;
    let mut close = shared;
    for y in 0..h {
        for x in 0..w {
            let own = grid[y * w + x];
            if own == NO_CHART {
                continue;
            }
            let rows = y..(y + reach + 1).min(h);
            let near = rows.flat_map(|j| {
                let from = if j == y { x } else { x.saturating_sub(reach) };
                (from..(x + reach + 1).min(w)).map(move |i| (i, j))
            });
            let other = |(i, j): (usize, usize)| {
                let c = grid[j * w + i];
                c != NO_CHART && c != own
            };
            if near.into_iter().any(other) {
                close += 1;
            }
        }
    }
    close
}
