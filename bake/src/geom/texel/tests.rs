use glam::Affine3A;

use super::*;
use crate::geom::atlas::{self, AtlasOptions, Density, Unwrap, cross, testing};

fn built(scene: &Scene, unwrap: Unwrap, density: f32) -> Atlas {
    let options = AtlasOptions { density: Density::Fixed(density), unwrap, ..Default::default() };
    atlas::build(scene, &options, &|_, _| true).expect("the scene has an atlas").0
}

fn areas(map: &TexelMap) -> f64 {
    let mut s = TexelSampler::default();
    (0..map.texels.len())
        .map(|i| {
            s.set(map, i);
            f64::from(s.coverage())
        })
        .sum()
}

#[test]
fn every_triangle_with_area_is_covered_and_coverage_sums_to_its_area() {
    let scene = testing::mixed();
    for density in [0.7, 6.0, 30.0] {
        let atlas = built(&scene, Unwrap::Always, density);
        let map = TexelMap::build(&scene, &atlas, 0);
        let total: usize = scene.surfaces.iter().map(|s| scene.meshes[s.mesh].triangles.len()).sum();
        let mut seen = vec![false; total];
        map.triangles.iter().for_each(|t| seen[*t as usize] = true);
        let (mut world, mut uv_area) = (0, 0.0);
        for (p, s) in atlas.placements.iter().zip(&scene.surfaces) {
            let p = p.expect("every surface has texels");
            for t in &atlas.layouts[p.layout].triangles {
                let area = cross(t.map(|v| atlas.texel_position(&p, v).as_dvec2())).abs() * 0.5;
                assert!(seen[world] == (0.0 < area), "triangle {world} of {}: area {area}", s.path);
                uv_area += area;
                world += 1;
            }
        }
        let covered = areas(&map);
        assert!((covered / uv_area - 1.0).abs() < 1e-4, "{covered} of {uv_area} at {density}");
        let page = f64::from(map.width * map.height);
        assert!((covered / page - f64::from(atlas.utilisation)).abs() < 1e-4);
    }
}

#[test]
fn texels_and_triangles_are_listed_once_and_in_order() {
    let scene = testing::mixed();
    let atlas = built(&scene, Unwrap::Always, 9.0);
    let map = TexelMap::build(&scene, &atlas, 0);
    assert_eq!(map.offsets.len(), map.texels.len() + 1);
    assert_eq!(map.offsets.last().copied(), Some(map.triangles.len() as u32));
    let tiles: Vec<[u32; 4]> = (0..map.texels.len())
        .map(|i| {
            let [x, y] = map.position(i);
            [y / TILE, x / TILE, y % TILE, x % TILE]
        })
        .collect();
    assert!(tiles.is_sorted_by(|a, b| a < b));
    for i in 0..map.texels.len() {
        assert!(!map.triangles_of(i).is_empty());
        assert!(map.triangles_of(i).is_sorted_by(|a, b| a < b));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().expect("a pool");
    let other = pool.install(|| TexelMap::build(&scene, &atlas, 0));
    assert_eq!((other.texels, other.offsets, other.triangles), (map.texels, map.offsets, map.triangles));
    assert!(TexelMap::build(&scene, &atlas, 7).texels.is_empty());
}

#[test]
fn coverage_agrees_with_clipping_every_cell() {
    let mut state = 1_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f64::from((state >> 40) as u32) / f64::from(1_u32 << 24)
    };
    for _ in 0..300 {
        let thin = if random() < 0.5 { 1.0 } else { 1e-3 };
        let t = [0; 3].map(|_| {
            let d = random() * 14.0 - 1.0;
            DVec2::new(d, d * (1.0 - thin) + thin * (random() * 14.0 - 1.0))
        });
        let mut found = vec![false; 144];
        coverage(&t, 12, 12, |x, y| found[(y * 12 + x) as usize] = true);
        for (i, found) in (0_u32..).zip(found) {
            let cell = DVec2::new(f64::from(i % 12), f64::from(i / 12));
            let area = clip::unit_square(&t.map(|c| c - cell)).area().abs();
            assert!(found || area < 1e-12, "{t:?} covers {area} of cell {cell}");
            assert!(!found || 0.0 < area || touches(&t, cell), "{t:?} does not cover cell {cell}");
        }
    }
}

/// Whether the cell comes within rounding of the triangle's bounds.
fn touches(t: &[DVec2; 3], cell: DVec2) -> bool {
    let near = t.map(|c| (c - cell - 0.5).abs() - 0.5);
    near.iter().any(|d| d.max_element() < 1e-9) || {
        let grown = t.map(|c| (c - cell - 0.5) * (1.0 - 1e-9) + 0.5);
        clip::unit_square(&grown).area() != 0.0
    }
}

/// A map of one page of 4 x 4 texels with these triangles.
fn map_of(triangles: &[[Vec2; 3]]) -> TexelMap {
    let positions: Vec<Vec2> = triangles.as_flattened().to_vec();
    let mesh = crate::scene::model::Mesh {
        positions: positions.iter().map(|p| p.extend(0.0)).collect(),
        uvs: vec![Vec::new(), positions.iter().map(|p| *p / 4.0).collect()],
        triangles: (0..triangles.len() as u32).map(|i| [0, 1, 2].map(|c| 3 * i + c)).collect(),
        ..Default::default()
    };
    let scene = testing::scene(vec![(mesh, vec![Affine3A::IDENTITY])]);
    let layout = atlas::Layout {
        mesh: 0,
        vertices: (0..positions.len() as u32).collect(),
        uvs: scene.meshes[0].uvs[1].clone(),
        triangles: scene.meshes[0].triangles.clone(),
        charts: vec![0; triangles.len()],
        kept: true,
    };
    let placement = atlas::Placement { layout: 0, page: 0, min: [0, 0], size: [4, 4], texels_per_metre: 1.0 };
    let atlas = Atlas {
        pages: vec![atlas::Page { width: 4, height: 4 }],
        layouts: vec![layout],
        placements: vec![Some(placement)],
        ..Atlas::default()
    };
    TexelMap::build(&scene, &atlas, 0)
}

/// Every cell of a grid over the texel must receive the share of a stratified point set that its
/// covered area is of the whole.
fn check_uniform(map: &TexelMap, texel: usize) {
    const N: usize = 8;
    const FINE: u32 = 512;
    let sampler = TexelSampler::new(map, texel);
    let corners: Vec<_> = map.triangles_of(texel).iter().map(|&t| map.local(t, map.texels[texel])).collect();
    let mut expected = [0.0; N * N];
    for (i, e) in expected.iter_mut().enumerate() {
        let (x, y) = ((i % N) as f64, (i / N) as f64);
        for t in &corners {
            let cell = t.map(|c| c * N as f64 - DVec2::new(x, y));
            *e += clip::unit_square(&cell).area().abs();
        }
    }
    let total: f64 = expected.iter().sum();
    let mut found = [0.0; N * N];
    for i in 0..FINE * FINE {
        let u = [(i % FINE) as f32 + 0.5, (i / FINE) as f32 + 0.5].map(|x| x / FINE as f32);
        let s = sampler.sample(u);
        let [w0, w1, w2] = s.bary;
        assert!(s.bary.iter().all(|w| (0.0..=1.0).contains(w)) && (w0 + w1 + w2 - 1.0).abs() < 1e-6);
        let t = map.local(s.triangle, map.texels[texel]);
        let at = t[0] * f64::from(w0) + t[1] * f64::from(w1) + t[2] * f64::from(w2);
        assert!(at.distance(s.uv.as_dvec2()) < 1e-5, "{at} is not {}", s.uv);
        let cell = |x: f32| ((x * N as f32) as usize).min(N - 1);
        found[cell(s.uv.y) * N + cell(s.uv.x)] += 1.0;
    }
    let samples = f64::from(FINE * FINE);
    for (f, e) in found.iter().zip(expected) {
        // The columns of strata that the left and the right border of a cell cut can go wholly to
        // either side: at most half a column each, and a little for the rows.
        assert!(
            (f / samples - e / total).abs() < 1.25 / f64::from(FINE),
            "{} for {}",
            f / samples,
            e / total
        );
    }
}

#[test]
fn samples_are_uniform_by_area_and_stay_stratified() {
    let v = Vec2::new;
    let cases = [
        vec![[v(0.2, 0.1), v(0.9, 0.3), v(0.4, 0.8)]],
        vec![[v(-1.0, -1.0), v(3.0, -1.0), v(-1.0, 3.0)]],
        vec![[v(0.0, 0.0), v(4.0, 0.0), v(0.0, 4.0)], [v(4.0, 0.0), v(4.0, 4.0), v(0.0, 4.0)]],
        vec![[v(0.0, 0.0), v(0.6, 1.0), v(0.0, 1.0)], [v(0.6, 1.0), v(1.0, 0.0), v(1.0, 1.0)]],
        vec![[v(0.1, 0.0), v(0.10001, 1.0), v(0.1, 1.0)], [v(0.5, 0.2), v(0.9, 0.2), v(0.5, 0.200_01)]],
    ];
    for triangles in &cases {
        let map = map_of(triangles);
        check_uniform(&map, 0);
    }
}

#[test]
fn independent_samples_are_uniform() {
    // Chi-squared of 16 similar parts of equal area, 65,536 samples, seed 7; at alpha = 0.001 and
    // 15 degrees of freedom the critical value is 37.70.
    let map = map_of(&[[Vec2::new(0.1, 0.05), Vec2::new(0.95, 0.4), Vec2::new(0.3, 0.9)]]);
    let sampler = TexelSampler::new(&map, 0);
    let mut state = 7_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1_u32 << 24) as f32
    };
    let mut counts = [0.0_f64; 16];
    for _ in 0..65_536 {
        let s = sampler.sample([random(), random()]);
        let [a, b, _] = s.bary.map(|w| w * 4.0);
        let (row, along) = ((a as usize).min(3), b as usize);
        let upper = usize::from(1.0 <= a.fract() + b.fract());
        counts[(row * (8 - row) + 2 * along + upper).min(15)] += 1.0;
    }
    let chi: f64 = counts.iter().map(|c| (c - 4096.0) * (c - 4096.0) / 4096.0).sum();
    assert!(chi < 37.70, "chi-squared {chi}, critical 37.70, seed 7: {counts:?}");
}

#[test]
fn a_fully_covered_texel_maps_points_to_themselves() {
    let v = Vec2::new;
    let map = map_of(&[[v(-5.0, 0.0), v(4.0, 0.0), v(0.0, 4.0)], [v(4.0, 0.0), v(4.0, 4.0), v(0.0, 4.0)]]);
    for i in 0..map.texels.len() {
        let s = TexelSampler::new(&map, i);
        if s.coverage() < 1.0 {
            continue;
        }
        for u in [[0.0, 0.0], [0.3, 0.9], [0.999_999, 0.5], [0.5, 0.25]] {
            let got = s.sample(u).uv;
            assert!(got.abs_diff_eq(Vec2::from(u), 1e-5), "{got} for {u:?}");
        }
    }
}

#[test]
fn kept_charts_that_share_a_texel_leave_it_to_the_larger() {
    let mut pair = testing::quad(1.0, 1.0);
    pair.positions.extend(testing::quad(1.0, 1.0).positions);
    pair.triangles.extend([[4, 5, 7], [4, 7, 6]]);
    let at = |lo: f32, hi: f32| [(lo, 0.0), (hi, 0.0), (lo, 1.0), (hi, 1.0)].map(|(x, y)| Vec2::new(x, y));
    // Ten texels: the texel from 0.4 to 0.5 holds 30 % of one and 60 % of the other.
    pair.uvs[1] = [at(0.0, 0.43), at(0.44, 1.0)].concat();
    pair.positions.iter_mut().skip(4).for_each(|p| p.x += 3.0);
    let scene = testing::scene(vec![(pair, vec![Affine3A::IDENTITY])]);
    let options = AtlasOptions {
        density: Density::Fit { page_size: 12 },
        max_size: 12,
        unwrap: Unwrap::Keep,
        padding: 1,
        ..Default::default()
    };
    let (atlas, _) = atlas::build(&scene, &options, &|_, _| true).expect("the scene has an atlas");
    let map = TexelMap::build(&scene, &atlas, 0);
    let column = (0.435 * map.width as f32) as u32;
    for i in 0..map.texels.len() {
        let mut charts: Vec<u32> = map.triangles_of(i).iter().map(|t| t / 2).collect();
        charts.dedup();
        assert_eq!(charts.len(), 1, "texel {:?}", map.position(i));
        if map.position(i)[0] == column {
            assert_eq!(charts, [1]);
        }
    }
    assert_eq!(map.texels.len(), (map.width * map.height) as usize);
}
