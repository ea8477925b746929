use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{Affine3A, Quat, Vec2, Vec3};

use super::{testing::*, *};
use crate::{geom::texel::coverage, scene::model::Mesh};

fn run(scene: &Scene, options: &AtlasOptions) -> (Atlas, Vec<Finding>) {
    let (atlas, findings) = build(scene, options, &|_, _| true).expect("the scene has an atlas");
    assert_well_formed(scene, &atlas);
    (atlas, findings)
}

fn fixed(density: f32) -> AtlasOptions {
    AtlasOptions { density: Density::Fixed(density), unwrap: Unwrap::Always, ..Default::default() }
}

fn fit(page_size: u32) -> AtlasOptions {
    AtlasOptions { density: Density::Fit { page_size }, unwrap: Unwrap::Always, ..Default::default() }
}

fn assert_well_formed(scene: &Scene, atlas: &Atlas) {
    assert_eq!(atlas.placements.len(), scene.surfaces.len());
    for (p, s) in atlas.placements.iter().zip(&scene.surfaces) {
        let Some(p) = p else { continue };
        let (layout, page) = (&atlas.layouts[p.layout], atlas.pages[p.page]);
        assert_eq!(layout.mesh, s.mesh);
        assert!(p.min[0] + p.size[0] <= page.width && p.min[1] + p.size[1] <= page.height);
        assert!(p.texels_per_metre.is_finite() && 0.0 < p.texels_per_metre);
    }
    for l in &atlas.layouts {
        let mesh = &scene.meshes[l.mesh];
        assert_eq!(l.triangles.len(), mesh.triangles.len());
        assert_eq!(l.charts.len(), mesh.triangles.len());
        assert_eq!(l.vertices.len(), l.uvs.len());
        assert!(l.uvs.iter().all(|uv| uv.cmpge(Vec2::ZERO).all() && uv.cmple(Vec2::ONE).all()));
        for (t, source) in l.triangles.iter().zip(&mesh.triangles) {
            assert_eq!(t.map(|v| l.vertices[v as usize]), *source);
        }
    }
}

/// Chart of every texel of a page, and the least number of texels from a texel to one of another
/// chart, looking up to `reach` away.
fn nearest_charts(atlas: &Atlas, page: usize, reach: u32) -> u32 {
    let size = atlas.pages[page];
    let (w, h) = (size.width, size.height);
    let mut grid = vec![0_u32; (w * h) as usize];
    let (mut chart_base, mut least) = (1, reach + 1);
    for p in atlas.placements.iter().flatten().filter(|p| p.page == page) {
        let layout = &atlas.layouts[p.layout];
        for (t, &chart) in layout.triangles.iter().zip(&layout.charts) {
            let corners = t.map(|v| atlas.texel_position(p, v).as_dvec2());
            coverage(&corners, w, h, |x, y| {
                let cell = &mut grid[(y * w + x) as usize];
                if *cell != 0 && *cell != chart_base + chart {
                    least = 0;
                }
                *cell = chart_base + chart;
            });
        }
        chart_base += 100_000;
    }
    for y in 0..h {
        for x in 0..w {
            let own = grid[(y * w + x) as usize];
            if own == 0 {
                continue;
            }
            for j in y..(y + reach + 1).min(h) {
                for i in x.saturating_sub(reach)..(x + reach + 1).min(w) {
                    let other = grid[(j * w + i) as usize];
                    if other != 0 && other != own {
                        least = least.min(x.abs_diff(i).max(y.abs_diff(j)));
                    }
                }
            }
        }
    }
    least
}

#[test]
fn charts_lie_twice_the_padding_apart() {
    let scene = mixed();
    for (padding, options) in [(2, fit(256)), (2, fixed(11.3)), (3, fixed(20.0)), (1, fixed(7.0))] {
        let options = AtlasOptions { padding, ..options };
        let (atlas, _) = run(&scene, &options);
        for page in 0..atlas.pages.len() {
            let near = nearest_charts(&atlas, page, 2 * padding);
            assert!(2 * padding < near, "{options:?}: {near} texels on page {page}");
        }
    }
}

#[test]
fn small_pages_are_filled_one_after_another() {
    let scene = mixed();
    let (atlas, _) = run(&scene, &AtlasOptions { max_size: 128, ..fixed(16.0) });
    assert!(1 < atlas.pages.len(), "{} pages", atlas.pages.len());
    assert!(atlas.pages.iter().all(|p| p.width <= 128 && p.height <= 128));
    for page in 0..atlas.pages.len() {
        assert!(4 < nearest_charts(&atlas, page, 4), "page {page}");
    }
}

#[test]
fn flat_charts_have_the_density_asked_for() {
    let tilt = Affine3A::from_quat(Quat::from_rotation_x(1.0));
    let grow = Affine3A::from_scale(Vec3::splat(2.5)) * tilt;
    let stretch = Affine3A::from_scale(Vec3::new(3.0, 1.0, 0.5));
    let scene = scene(vec![(bare(quad(1.3, 2.0)), vec![tilt, grow, stretch]), (cube(), vec![tilt])]);
    for density in [40.0, 63.7, 100.0] {
        let (atlas, findings) = run(&scene, &fixed(density));
        assert!(findings.is_empty(), "{findings:?}");
        for (p, s) in atlas.placements.iter().zip(&scene.surfaces) {
            let p = p.expect("every surface has texels");
            let layout = &atlas.layouts[p.layout];
            let mesh = &scene.meshes[s.mesh];
            for t in &layout.triangles {
                let at = t.map(|v| atlas.texel_position(&p, v));
                let world = t.map(|v| {
                    let source = layout.vertices[v as usize] as usize;
                    s.world_from_mesh.transform_point3(mesh.positions[source])
                });
                for i in 0..3 {
                    let j = (i + 1) % 3;
                    let found = at[i].distance(at[j]) / world[i].distance(world[j]);
                    assert!((found / density - 1.0).abs() < 0.02, "{found} for {density} at {}", s.path);
                }
            }
            assert!((p.texels_per_metre / density - 1.0).abs() < 1e-3);
        }
        assert!((atlas.texels_per_metre / density - 1.0).abs() < 1e-6);
    }
}

#[test]
fn overrides_hold_with_fixed_and_fitted_density() {
    let mut scene = scene(vec![(bare(quad(1.0, 1.0)), vec![Affine3A::IDENTITY; 3])]);
    scene.surfaces[1].texels_per_metre = Some(30.0);
    for options in [fixed(60.0), fit(256)] {
        let (atlas, _) = run(&scene, &options);
        assert_eq!(atlas.pages.len(), 1);
        let d: Vec<f32> = atlas.placements.iter().flatten().map(|p| p.texels_per_metre).collect();
        assert!((d[1] / 30.0 - 1.0).abs() < 1e-3, "{d:?}");
        assert!(45.0 < d[0] && d[0] == d[2], "{d:?}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_atlas() {
    let scene = mixed();
    let with = |threads: usize, options: &AtlasOptions| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| run(&scene, options))
    };
    for options in [fit(128), fixed(10.0)] {
        assert_eq!(with(1, &options), with(3, &options));
    }
}

#[test]
fn scaling_lengths_by_a_power_of_two_changes_nothing() {
    let mut scene = mixed();
    scene.surfaces[1].texels_per_metre = Some(4.0);
    let (reference, _) = run(&scene, &fixed(10.0));
    for k in [-20, 3, 30] {
        let factor = 2.0_f32.powi(k);
        let mut scaled = scene.clone();
        for s in &mut scaled.surfaces {
            s.texels_per_metre = s.texels_per_metre.map(|d| d / factor);
            s.world_from_mesh = Affine3A::from_scale(Vec3::splat(factor)) * s.world_from_mesh;
        }
        let (atlas, _) = run(&scaled, &fixed(10.0 / factor));
        assert_eq!(atlas.layouts, reference.layouts);
        for (a, b) in atlas.placements.iter().zip(&reference.placements) {
            let b = b.map(|b| Placement { texels_per_metre: b.texels_per_metre / factor, ..b });
            assert_eq!(*a, b);
        }
        let mut meshes = scene.clone();
        for m in &mut meshes.meshes {
            m.positions.iter_mut().for_each(|p| *p *= factor);
        }
        meshes.surfaces.iter_mut().for_each(|s| {
            s.texels_per_metre = s.texels_per_metre.map(|d| d / factor);
            s.world_from_mesh.translation *= factor;
        });
        let (atlas, _) = run(&meshes, &fixed(10.0 / factor));
        assert_eq!(atlas.layouts, reference.layouts);
    }
}

#[test]
fn what_is_larger_than_a_page_gets_fewer_texels_and_a_finding() {
    let ribbon = bare(quad(400.0, 0.5));
    let scene = scene(vec![
        (bare(quad(10.0, 10.0)), vec![Affine3A::IDENTITY]),
        (ribbon, vec![Affine3A::IDENTITY]),
        (cube(), vec![Affine3A::IDENTITY]),
    ]);
    let (atlas, findings) = run(&scene, &AtlasOptions { max_size: 256, ..fixed(40.0) });
    assert_eq!(findings.len(), 2, "{findings:?}");
    assert!(findings[0].what.contains("40.000 texels per metre"), "{}", findings[0].what);
    let d: Vec<f32> = atlas.placements.iter().flatten().map(|p| p.texels_per_metre).collect();
    assert!(20.0 < d[0] && d[0] < 26.0, "{d:?}");
    assert!(0.4 < d[1] && d[1] < 0.7, "{d:?}");
    assert!((d[2] / 40.0 - 1.0).abs() < 1e-3, "{d:?}");
}

#[test]
fn small_and_degenerate_surfaces() {
    let mut odd = quad(1.0, 1.0);
    odd.triangles.extend([[0, 0, 1], [1, 1, 1], [0, 1, 0]]);
    let tiny = Affine3A::from_scale(Vec3::splat(1e-4));
    let flat = Affine3A::from_scale(Vec3::new(0.0, 0.0, 0.0));
    let nan = Affine3A::from_scale(Vec3::new(f32::NAN, 1.0, 1.0));
    let side = Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0));
    let edge = Affine3A::from_scale(Vec3::new(1.0, 1.0, 0.0));
    let scene = scene(vec![
        (bare(odd), vec![Affine3A::IDENTITY, tiny, flat, nan, side, edge]),
        (Mesh::default(), vec![Affine3A::IDENTITY]),
    ]);
    let (atlas, findings) = run(&scene, &fixed(10.0));
    let placed: Vec<bool> = atlas.placements.iter().map(Option::is_some).collect();
    assert_eq!(placed, [true, true, false, false, true, false, false]);
    assert_eq!(findings.len(), 3, "{findings:?}");
    let p = atlas.placements[1].expect("checked above");
    assert_eq!(p.size, [1, 1]);
    let layout = &atlas.layouts[p.layout];
    assert_eq!(layout.charts[2..], [NO_CHART; 3]);
    let area: f64 = layout
        .triangles
        .iter()
        .map(|t| cross(t.map(|v| layout.uvs[v as usize].as_dvec2())).abs() * 0.5)
        .sum();
    assert!((area - 1.0).abs() < 0.01, "the texel is filled: {area}");
}

/// Found by fuzzing: a scene of nothing but slivers has no chart, and the packer met an empty page.
#[test]
fn slivers_alone_get_no_texels() {
    for height in [0.0, 1e-9, 1e-7, 1e-6] {
        let mesh = quad(1.0, height);
        for options in [fixed(10.0), fit(64)] {
            let (atlas, findings) =
                run(&scene(vec![(bare(mesh.clone()), vec![Affine3A::IDENTITY])]), &options);
            assert_eq!((atlas.placements[0].is_some(), findings.len()), (false, 1), "{height}: {findings:?}");
        }
    }
}

#[test]
fn a_scene_without_lit_surfaces_has_no_pages() {
    let mut scene = scene(vec![(cube(), vec![Affine3A::IDENTITY; 2])]);
    scene.surfaces[0].lightmap = LightmapMode::Probes;
    scene.materials[0].unlit = true;
    let (atlas, findings) = run(&scene, &fit(64));
    assert_eq!((atlas.pages.len(), atlas.charts, findings.len()), (0, 0, 0));
    assert_eq!(atlas.placements, [None, None]);
}

#[test]
fn progress_grows_and_can_stop_the_work() {
    let scene = mixed();
    let last = AtomicUsize::new(0);
    let heard = |done: usize, total: usize| {
        assert!(done <= total && last.swap(done, Ordering::Relaxed) <= done);
        true
    };
    build(&scene, &fixed(8.0), &heard).expect("the scene has an atlas");
    assert_eq!(last.into_inner(), 100);
    for stop in [0, 5, 40, 80, 99] {
        let result = build(&scene, &fixed(8.0), &|done, _| done < stop);
        assert!(matches!(result, Err(Error::Interrupted)), "stop at {stop}: {result:?}");
    }
}

#[test]
fn options_out_of_range_are_refused() {
    let scene = mixed();
    for options in [
        fixed(0.0),
        fixed(f32::NAN),
        fixed(-1.0),
        fit(0),
        AtlasOptions { max_size: 7, ..fit(64) },
        AtlasOptions { max_size: 1 << 20, ..fit(64) },
    ] {
        let result = build(&scene, &options, &|_, _| true);
        assert!(matches!(result, Err(Error::Usage(_))), "{options:?}: {result:?}");
    }
}

fn keeping(unwrap: Unwrap, scene: &Scene) -> Result<(Atlas, Vec<Finding>), Error> {
    build(scene, &AtlasOptions { unwrap, ..fixed(32.0) }, &|_, _| true)
}

#[test]
fn valid_coordinates_are_kept_in_proportion() {
    // Twice as wide in the world as in texture space, off the unit square by whole numbers.
    let mut floor = sheet(4, 4, |u, v| Vec3::new(u * 4.0, 0.0, v * 2.0));
    floor.uvs[1].iter_mut().for_each(|uv| *uv = *uv * 0.5 + Vec2::new(3.25, -2.0));
    let scene = scene(vec![(floor, vec![Affine3A::IDENTITY; 2])]);
    for unwrap in [Unwrap::Keep, Unwrap::Auto] {
        let (atlas, findings) = keeping(unwrap, &scene).expect("valid coordinates");
        assert_well_formed(&scene, &atlas);
        assert!(findings.is_empty(), "{findings:?}");
        let p = atlas.placements[1].expect("it has texels");
        let mut size = p.size;
        size.sort_unstable();
        assert_eq!(size, [64, 128]);
        let layout = &atlas.layouts[p.layout];
        assert!(layout.kept && layout.charts.iter().all(|c| *c == 0));
        assert_eq!(atlas.charts, 2);
        assert!(4 < nearest_charts(&atlas, 0, 4));
    }
    let (atlas, _) = keeping(Unwrap::Always, &scene).expect("an atlas");
    assert!(!atlas.layouts[0].kept);
}

#[test]
fn invalid_coordinates_are_refused_or_replaced() {
    let mut outside = quad(1.0, 1.0);
    outside.uvs[1].iter_mut().for_each(|uv| *uv *= 1.5);
    let mut broken = quad(1.0, 1.0);
    broken.uvs[1][3].x = f32::NAN;
    let mut flat = quad(1.0, 1.0);
    flat.uvs[1].iter_mut().for_each(|uv| uv.y = 0.5);
    let cases = [
        (cube(), "overlap"),
        (outside, "0.0000 to 1.5000"),
        (broken, "vertex 3 is not finite"),
        (flat, "no area on triangles that make up 100.00 %"),
        (bare(quad(1.0, 1.0)), "missing"),
    ];
    for (mesh, why) in cases {
        let scene = scene(vec![(quad(1.0, 1.0), vec![Affine3A::IDENTITY]), (mesh, vec![Affine3A::IDENTITY])]);
        let Err(Error::Input(findings)) = keeping(Unwrap::Keep, &scene) else {
            panic!("{why}: not refused");
        };
        assert_eq!(findings.len(), 1);
        assert_eq!(findings[0].path, "node 1");
        assert!(findings[0].what.contains(why), "{}", findings[0].what);
        let (atlas, _) = keeping(Unwrap::Auto, &scene).expect("an atlas");
        assert_well_formed(&scene, &atlas);
        assert_eq!(atlas.layouts.iter().map(|l| l.kept).collect::<Vec<_>>(), [true, false]);
    }
}

#[test]
fn narrow_gaps_in_kept_charts_are_reported() {
    // Two halves of a sheet, 1/64 apart in texture space on 32 texels.
    let mut pair = sheet(2, 1, |u, v| Vec3::new(u, 0.0, v));
    pair.triangles.clear();
    pair.positions = [0.0, 0.5, 0.5, 1.0].map(|x| Vec3::new(x, 0.0, 0.0)).to_vec();
    pair.positions.extend([0.0, 0.5, 0.5, 1.0].map(|x| Vec3::new(x, 0.0, 1.0)));
    pair.triangles.extend([[0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6]]);
    let us = [0.0, 0.49, 0.51, 1.0];
    pair.uvs[1] = us.map(|u| Vec2::new(u, 0.0)).to_vec();
    pair.uvs[1].extend(us.map(|u| Vec2::new(u, 1.0)));
    let scene = scene(vec![(pair, vec![Affine3A::IDENTITY; 2])]);
    let (atlas, findings) = keeping(Unwrap::Auto, &scene).expect("an atlas");
    assert_eq!(atlas.charts, 4);
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert!(findings[0].what.contains("closer than 2 texels"), "{}", findings[0].what);
    let sparse = AtlasOptions { density: Density::Fixed(300.0), unwrap: Unwrap::Auto, ..fit(64) };
    let (_, findings) = run(&scene, &sparse);
    assert!(findings.is_empty(), "{findings:?}");
}

#[test]
fn a_shared_atlas_survives_being_kept() {
    let scene = mixed();
    for options in [fit(256), fixed(9.0)] {
        let (first, _) = run(&scene, &options);
        assert_eq!(first.pages.len(), 1);
        // What a bake writes: a mesh of its own for each surface, with page coordinates.
        let mut written = scene.clone();
        written.meshes.clear();
        for (surface, p) in written.surfaces.iter_mut().zip(&first.placements) {
            let p = p.expect("every surface has texels");
            let (layout, source) = (&first.layouts[p.layout], &scene.meshes[surface.mesh]);
            let each = || layout.vertices.iter().map(|v| *v as usize);
            surface.mesh = written.meshes.len();
            written.meshes.push(Mesh {
                positions: each().map(|v| source.positions[v]).collect(),
                uvs: vec![Vec::new(), (0..).zip(each()).map(|(v, _)| first.page_uv(&p, v)).collect()],
                triangles: layout.triangles.clone(),
                ..Mesh::default()
            });
        }
        let options = AtlasOptions { unwrap: Unwrap::Keep, ..options };
        let (second, findings) = run(&written, &options);
        assert!(findings.is_empty(), "{findings:?}");
        assert_eq!(second.pages, first.pages);
        for (surface, p) in written.surfaces.iter().zip(&second.placements) {
            let p = p.expect("every surface has texels");
            let uvs = &written.meshes[surface.mesh].uvs[1];
            for (v, uv) in (0..).zip(uvs) {
                assert!(second.page_uv(&p, v).abs_diff_eq(*uv, 1e-7));
            }
        }
        assert!((second.utilisation / first.utilisation - 1.0).abs() < 1e-3);
    }
}

#[test]
fn a_single_surface_uses_the_page_itself() {
    let scene = scene(vec![(torus(16), vec![Affine3A::from_scale(Vec3::splat(3.0))])]);
    for options in [fit(256), fixed(12.0), AtlasOptions { max_size: 64, ..fixed(12.0) }] {
        let (atlas, findings) = run(&scene, &options);
        assert_eq!(atlas.pages.len(), 1);
        assert_eq!(findings.is_empty(), options.max_size != 64, "{findings:?}");
        assert!(4 < nearest_charts(&atlas, 0, 4));
        let p = atlas.placements[0].expect("it has texels");
        let end = [0, 1].map(|i| p.min[i] + p.size[i] + 2);
        assert!(end[0] <= atlas.pages[0].width && end[1] <= atlas.pages[0].height, "{p:?}");
    }
}

/// Forty-nine tiles of one mesh, whose space between alone is more than a small page.
#[test]
fn charts_without_room_on_a_page_ask_for_a_larger_one() {
    let mut tiles = Mesh { name: "tiles".into(), ..Mesh::default() };
    for i in 0..49 {
        let first = 4 * i;
        let at = Vec3::new(2.0 * (i % 7) as f32, 0.1 * (i % 3) as f32, 2.0 * (i / 7) as f32);
        tiles.positions.extend([Vec3::ZERO, Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::X].map(|p| at + p));
        tiles.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    let one = || vec![Affine3A::IDENTITY];
    let scene = scene(vec![(tiles, one()), (bare(quad(30.0, 30.0)), one())]);
    let (atlas, _) = run(&scene, &fit(64));
    assert_eq!(atlas.pages.len(), 1);
    let error = build(&scene, &fit(32), &|_, _| true).expect_err("too small").to_string();
    assert!(error.contains("raise --max-size") && !error.contains("per metre"), "{error}");
}
