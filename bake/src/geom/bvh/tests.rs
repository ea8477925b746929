#![expect(clippy::cast_possible_truncation, reason = "small meshes")]

use super::*;
use crate::geom::ray::WatertightRay;
use crate::sample::{Sequence, sequence::key};
use glam::{Vec3, Vec3A};

fn random_rays(n: u32) -> impl Iterator<Item = Ray> {
    (0..n).map(|i| {
        let mut s = Sequence::new(key(1, 2, u64::from(i)), 0);
        let (a, b) = (s.next4(), s.next4());
        Ray {
            origin: Vec3A::new(a[0], a[1], a[2]) * 3.0 - 1.5,
            direction: (Vec3A::new(b[0], b[1], b[2]) - 0.5).normalize_or(Vec3A::X),
            t_max: f32::INFINITY,
        }
    })
}

fn soup(n: u32, size: f32) -> Vec<[Vec3; 3]> {
    (0..n)
        .map(|i| {
            let mut s = Sequence::new(key(3, 4, u64::from(i)), 0);
            let (a, b, c) = (s.next4(), s.next4(), s.next4());
            let p = Vec3::new(a[0], a[1], a[2]) * 2.0 - 1.0;
            [p, p + Vec3::new(b[0], b[1], b[2]) * size, p + Vec3::new(c[0], c[1], c[2]) * size]
        })
        .collect()
}

/// The tree gives what a scan over all triangles gives, for 0, 1, 2 and many triangles.
#[test]
fn tree_equals_linear_scan() {
    for n in [0, 1, 2, 3, 700] {
        let w = World::of_triangles(soup(n, 0.4));
        let bvh = Bvh::build(&w, |_| Some(Opacity::Opaque)).expect("builds");
        let mut hits = 0;
        for ray in random_rays(2000) {
            let exact = WatertightRay::new(&ray);
            let mut want: Option<Hit> = None;
            for (i, v) in w.triangles().enumerate() {
                if let Some((t, bary)) = exact.intersect(&v, ray.t_max)
                    && want.is_none_or(|h| t < h.t)
                {
                    want = Some(Hit { t, triangle: i as u32, bary });
                }
            }
            let got = bvh.closest(&ray, |_| true);
            assert_eq!(got, want, "{ray:?}");
            assert_eq!(bvh.occluded(&ray, |_| true), want.is_some());
            hits += u32::from(want.is_some());
        }
        assert!(n < 100 || 200 < hits);
    }
}

/// A sphere out of a subdivided cube.
fn sphere(n: u32) -> Vec<[Vec3; 3]> {
    // A power of two, so that both sides of the cube compute the same corners to the bit.
    assert!(n.is_power_of_two());
    let point = |face: usize, i: u32, j: u32| {
        let (a, b) = (i as f32 / n as f32 * 2.0 - 1.0, j as f32 / n as f32 * 2.0 - 1.0);
        let p = [Vec3::new(a, b, 1.0), Vec3::new(a, 1.0, b), Vec3::new(1.0, a, b)][face % 3];
        (if face < 3 { p } else { -p }).normalize() * 1.3
    };
    let mut tris = Vec::new();
    for face in 0..6 {
        for i in 0..n {
            for j in 0..n {
                let q = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| point(face, i, j));
                tris.push([q[0], q[1], q[2]]);
                tris.push([q[0], q[2], q[3]]);
            }
        }
    }
    tris
}

/// Nothing leaves a closed, finely subdivided mesh, also where rays are aimed at its edges and corners.
#[test]
fn closed_mesh_is_watertight() {
    let slow = std::env::var_os("BAKE_SLOW_TESTS").is_some_and(|v| v == "1");
    let rays: u32 = if slow { 10_000_000 } else { 1_000_000 };
    let tris = sphere(16);
    let corners: Vec<Vec3> = tris.iter().flatten().copied().collect();
    let w = World::of_triangles(tris);
    let bvh = Bvh::build(&w, |_| Some(Opacity::Opaque)).expect("builds");
    let mut escaped = 0;
    for i in 0..rays {
        let mut s = Sequence::new(key(8, 9, u64::from(i)), 0);
        let a = s.next4();
        let origin = (Vec3A::new(a[0], a[1], a[2]) - 0.5) * 0.8;
        let first = i as usize % corners.len();
        let (c, e) = (corners[first], corners[first / 3 * 3 + (first + 1) % 3]);
        let target = Vec3A::from(if i % 2 == 0 { c } else { c + (e - c) * a[3] }) - Vec3A::from(w.origin);
        let ray = Ray { origin, direction: (target - origin).normalize(), t_max: f32::INFINITY };
        escaped += u32::from(bvh.closest(&ray, |_| true).is_none());
        escaped += u32::from(!bvh.occluded(&ray, |_| true));
    }
    assert_eq!(escaped, 0, "of {rays} rays");
}

/// Poison: boxes without volume, points, and coordinates at the end of the range.
#[test]
fn poisoned_input_neither_hangs_nor_hits() {
    let mut tris = soup(50, 0.3);
    tris.push([Vec3::ZERO; 3]);
    tris.push([Vec3::X, Vec3::X, Vec3::Y]);
    tris.push([Vec3::splat(1e30), Vec3::new(1e30, -1e30, 0.0), Vec3::NEG_ONE * 1e30]);
    let mut w = World::of_triangles(tris);
    w.corners_mut(3)[0].x = f32::NAN;
    w.corners_mut(4)[1].y = f32::INFINITY;
    let bvh = Bvh::build(&w, |_| Some(Opacity::Opaque)).expect("builds");
    for ray in random_rays(500) {
        if let Some(hit) = bvh.closest(&ray, |_| true) {
            assert!(hit.t.is_finite() && ![3, 4, 50, 51].contains(&hit.triangle));
        }
    }
    let nan = Ray { origin: Vec3A::NAN, direction: Vec3A::X, t_max: 1.0 };
    assert!(bvh.closest(&nan, |_| true).is_none());
}

/// Of two coincident triangles the lower index wins, whatever the tree looks like.
#[test]
fn ties_go_to_the_lower_index() {
    let mut tris = soup(300, 0.4);
    let copy = tris.clone();
    tris.extend(copy);
    let w = World::of_triangles(tris);
    let bvh = Bvh::build(&w, |_| Some(Opacity::Opaque)).expect("builds");
    let hits: Vec<Hit> = random_rays(1000).filter_map(|r| bvh.closest(&r, |_| true)).collect();
    assert!(100 < hits.len() && hits.iter().all(|h| h.triangle < 300));
}

/// Every answer to the bit: with opaque triangles, with some to ask about, and with a wall that rays
/// meet at its edges.
#[test]
#[cfg(target_arch = "x86_64")]
#[expect(clippy::print_stdout, reason = "says that nothing was tested")]
fn avx2_equals_plain_loops() {
    if super::avx2::Available::detect().is_none() {
        println!("skipped: no AVX2");
        return;
    }
    let flat = |n: u8| {
        let p = |i: u8, j: u8| Vec3::new(f32::from(i) * 0.25 - 1.0, f32::from(j) * 0.25 - 1.0, 0.5);
        let quads = (0..n).flat_map(move |i| (0..n).map(move |j| (i, j)));
        let halves =
            |(i, j)| [[p(i, j), p(i + 1, j), p(i, j + 1)], [p(i + 1, j + 1), p(i, j + 1), p(i + 1, j)]];
        quads.flat_map(halves).collect::<Vec<_>>()
    };
    for tris in [soup(1, 0.9), soup(40, 0.9), soup(3000, 0.2), sphere(16), flat(8)] {
        let w = World::of_triangles(tris);
        let fast = Bvh::build(&w, |i| {
            (i % 11 != 5).then_some(if i % 3 == 0 { Opacity::Ask } else { Opacity::Opaque })
        });
        let fast = fast.expect("builds");
        let plain = Bvh { avx2: None, ..fast.clone() };
        let mut hits = 0;
        for (i, mut ray) in random_rays(20_000).enumerate() {
            if i % 4 == 0 {
                // Along axes and through corners: zero components and edge functions.
                ray.origin = (ray.origin * 4.0).round() * 0.25;
                ray.direction = [Vec3A::X, Vec3A::NEG_Y, Vec3A::Z, Vec3A::new(0.6, 0.0, 0.8)][i / 4 % 4];
            }
            if i % 3 == 0 {
                ray.t_max = 1.0;
            }
            let accept = |h: &Hit| 0.4 < h.bary[1];
            let (a, b) = (fast.closest(&ray, accept), plain.closest(&ray, accept));
            let bits = |h: Option<Hit>| h.map(|h| (h.t.to_bits(), h.triangle, h.bary.map(f32::to_bits)));
            assert_eq!(bits(a), bits(b), "{ray:?}");
            hits += u32::from(a.is_some());
            let asked = |bvh: &Bvh| {
                let mut seen = Vec::new();
                let blocked = bvh.occluded(&ray, |h| {
                    seen.push(bits(Some(*h)));
                    0.9 < h.bary[1]
                });
                (blocked, seen)
            };
            assert_eq!(asked(&fast), asked(&plain), "{ray:?}");
        }
        assert!(20 < hits, "{hits}");
    }
}

/// A ray along which nothing blocks has asked about every triangle it meets, once.
#[test]
fn occlusion_asks_about_each_hit_once() {
    let w = World::of_triangles(soup(500, 0.5));
    let bvh = Bvh::build(&w, |_| Some(Opacity::Ask)).expect("builds");
    let mut most = 0;
    for ray in random_rays(2000) {
        let exact = WatertightRay::new(&ray);
        let meets = |i: &u32| exact.intersect(&w.corners(*i), ray.t_max).is_some();
        let want: Vec<u32> = (0..500).filter(meets).collect();
        let mut got = Vec::new();
        assert!(!bvh.occluded(&ray, |h| {
            got.push(h.triangle);
            false
        }));
        got.sort_unstable();
        assert_eq!(got, want);
        most = most.max(got.len());
    }
    assert!(3 < most);
}

/// Five thousand copies of one triangle cannot be separated; the tree stays low and the first copy wins.
#[test]
fn copies_make_no_deep_tree() {
    let w = World::of_triangles(vec![[Vec3::ZERO, Vec3::X, Vec3::Y]; 5000]);
    let bvh = Bvh::build(&w, |_| Some(Opacity::Opaque)).expect("builds");
    let [a, b, c] = w.corners(0).map(Vec3A::from);
    let origin = (a + b + c) / 3.0 + Vec3A::Z;
    let ray = Ray { origin, direction: Vec3A::NEG_Z, t_max: f32::INFINITY };
    assert_eq!(bvh.closest(&ray, |_| true).map(|h| h.triangle), Some(0));
}
