#![expect(clippy::cast_possible_truncation, reason = "small meshes")]

use super::*;
use crate::sample::{Sequence, sequence::key};
use glam::{Affine3A, DMat3, Mat3, vec3};
use std::collections::HashMap;
use std::f32::consts::TAU;

type Triangles = Vec<[Vec3; 3]>;

fn mesh(triangles: Triangles) -> Boundary {
    let n = triangles.len() as u32;
    let indices = (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Boundary::new(triangles.into_iter().flatten().collect(), indices)
}

/// Two triangles a side, facing outwards; the sides are -x, x, -y, y, -z, z.
fn cube(min: f32, max: f32) -> Triangles {
    let corner = |i: usize| Vec3::from([0, 1, 2].map(|axis| if i >> axis & 1 == 0 { min } else { max }));
    let sides = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    sides.iter().flat_map(|s| [[s[0], s[1], s[2]], [s[0], s[2], s[3]]]).map(|t| t.map(corner)).collect()
}

fn inverted(mut triangles: Triangles) -> Triangles {
    triangles.iter_mut().for_each(|t| t.swap(1, 2));
    triangles
}

fn mapped(mut triangles: Triangles, mut by: impl FnMut(Vec3) -> Vec3) -> Triangles {
    triangles.iter_mut().flatten().for_each(|v| *v = by(*v));
    triangles
}

/// A sphere of radius 1 out of an icosahedron.
fn sphere(levels: u32) -> Triangles {
    let long = 0.5 + 1.25f32.sqrt();
    let corners: Vec<Vec3> = (0..12)
        .map(|i| {
            let (a, b) = (if i & 1 == 0 { -1.0 } else { 1.0 }, if i & 2 == 0 { -long } else { long });
            [vec3(0.0, a, b), vec3(a, b, 0.0), vec3(b, 0.0, a)][i / 4].normalize()
        })
        .collect();
    let mut triangles = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                let t = [i, j, k].map(|i| corners[i]);
                // Neighbours are 63 degrees apart, others 117 and more.
                if 0.0 < t[0].dot(t[1]).min(t[1].dot(t[2])).min(t[2].dot(t[0])) {
                    let out = 0.0 < t[0].dot(t[1].cross(t[2]));
                    triangles.push(if out { t } else { [t[0], t[2], t[1]] });
                }
            }
        }
    }
    assert_eq!(triangles.len(), 20);
    for _ in 0..levels {
        let middle = |a: Vec3, b: Vec3| (a + b).normalize();
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    triangles
}

fn random(stream: u64, i: u32) -> [f32; 8] {
    let mut s = Sequence::new(key(77, stream, u64::from(i)), 0);
    let (a, b) = (s.next4(), s.next4());
    [a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]]
}

/// Rays around and in [-1, 1]^3: through places on its surface and inside, and every other of them through places
/// and along directions of a coarse grid.
fn rays(stream: u64, n: u32) -> impl Iterator<Item = (Vec3A, Vec3A)> {
    (0..n).filter_map(move |i| {
        let r = random(stream, i);
        let (mut origin, mut target) =
            (Vec3A::new(r[0], r[1], r[2]) * 6.0 - 3.0, Vec3A::new(r[3], r[4], r[5]) * 2.2 - 1.1);
        if i % 2 == 0 {
            (origin, target) = (origin.round(), target.round());
        }
        if i % 8 == 1 {
            let axis = (r[6] * 3.0) as usize;
            target[axis] = target[axis].signum();
        }
        let direction = target - origin;
        (direction != Vec3A::ZERO).then_some((origin, direction))
    })
}

fn parts(b: &Boundary, origin: Vec3A, direction: Vec3A, t_max: f32) -> Vec<(f32, f32)> {
    let mut out = vec![(-7.0, -7.0)];
    b.inside(origin, direction, t_max, &mut out);
    assert_eq!(out.remove(0), (-7.0, -7.0), "what was there stays");
    let mut last = f32::NEG_INFINITY;
    for &(from, to) in &out {
        assert!(0.0 <= from && last < from && from < to && to <= t_max && to.is_finite(), "{out:?}");
        last = to;
    }
    out
}

fn length(parts: &[(f32, f32)]) -> f32 {
    parts.iter().map(|p| p.1 - p.0).sum()
}

/// All crossings of a whole line, without the tree if `scan`.
fn crossings(b: &Boundary, origin: Vec3A, direction: Vec3A, scan: bool) -> Vec<(f32, i32)> {
    let (mut line, _) = b.line(origin, direction, f32::INFINITY).expect("a line");
    (line.from, line.to) = (f32::NEG_INFINITY, f32::INFINITY);
    let mut out = Vec::new();
    if scan {
        out.extend(b.faces.iter().filter_map(|f| match line.axis {
            0 => line.crossing::<0>(f),
            1 => line.crossing::<1>(f),
            _ => line.crossing::<2>(f),
        }));
    } else {
        b.cross(&line, |t, turn| out.push((t, turn)));
    }
    out.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    out
}

/// Where a ray is in [min, max]^3, in f64, with the rule of boxes for rays in a face.
fn in_cube(min: f64, max: f64, origin: [f64; 3], direction: [f64; 3], t_max: f64) -> Option<(f64, f64)> {
    let (mut from, mut to) = (0.0f64, t_max);
    for (o, d) in origin.into_iter().zip(direction) {
        if d == 0.0 {
            if o < min || max <= o {
                return None;
            }
            continue;
        }
        let (a, b) = ((min - o) / d, (max - o) / d);
        from = from.max(a.min(b));
        to = to.min(a.max(b));
    }
    (from < to).then_some((from, to))
}

/// Within the rounding of the ends, and 1e-5 of the length.
fn assert_near(got: &[(f32, f32)], want: Option<(f64, f64)>, what: &str) {
    let (from, to) = want.unwrap_or_default();
    let (got, want) = (f64::from(length(got)), to - from);
    assert!((got - want).abs() <= 1e-5 * want + 4.0 * f64::from(f32::EPSILON) * to, "{what}: {got} {want}");
}

#[test]
fn cubes_are_slabs() {
    let b = mesh(cube(-1.0, 1.0));
    assert_eq!(b.open_edges(), None);
    let mut inside = 0;
    for (i, (origin, direction)) in rays(1, 100_000).enumerate() {
        let crossed = crossings(&b, origin, direction, false);
        assert!(matches!(crossed.len(), 0 | 2), "{origin} {direction}: {crossed:?}");
        assert_eq!(crossed.iter().map(|c| c.1).sum::<i32>(), 0);
        let t_max = [f32::INFINITY, 1.0, 0.5][i % 3];
        let [o, d] = [origin, direction].map(|v| v.to_array().map(f64::from));
        let want = in_cube(-1.0, 1.0, o, d, t_max.into());
        inside += u32::from(want.is_some());
        assert_near(&parts(&b, origin, direction, t_max), want, &format!("{origin} {direction} {t_max}"));
    }
    assert!(30_000 < inside, "{inside}");
}

/// Rays along the axes in faces and along edges, and places on them: as boxes have it.
#[test]
fn faces_belong_to_their_upper_side() {
    let b = mesh(cube(-1.0, 1.0));
    let at = |i: u32| [-1.5, -1.0, 0.0, 1.0, 1.5][i as usize % 5];
    for i in 0..125 {
        let p = Vec3A::new(at(i), at(i / 5), at(i / 25));
        assert_eq!(b.contains(p), p.to_array().iter().all(|x| (-1.0..1.0).contains(x)), "{p}");
        for d in [Vec3A::X, Vec3A::NEG_X, Vec3A::Y, Vec3A::NEG_Y, Vec3A::Z, Vec3A::NEG_Z] {
            let (from, to) = slabs(Vec3A::NEG_ONE, Vec3A::ONE, p, d, 8.0);
            let want = if from < to { vec![(from, to)] } else { vec![] };
            assert_eq!(parts(&b, p, d, 8.0), want, "{p} {d}");
        }
    }
}

/// Halves of a cube, cut aslant, are together the cube: nothing twice and nothing not at all, to the bit.
#[test]
fn touching_regions_share_nothing() {
    let corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[x, y]| vec3(x as f32, y as f32, 0.0) * 2.0 - 1.0);
    let prism = |[a, b, c]: [Vec3; 3]| {
        let up = Vec3::Z * 2.0;
        let mut t = vec![[a, c, b], [a + up, b + up, c + up]];
        for (p, q) in [(a, b), (b, c), (c, a)] {
            t.extend([[p, q, q + up], [p, q + up, p + up]]);
        }
        mesh(t)
    };
    let [a, b, c, d] = corners;
    let (low, high, all) = (prism([a, b, c]), prism([a, c, d]), mesh(cube(-1.0, 1.0)));
    assert!(low.open_edges().is_none() && high.open_edges().is_none());
    for (origin, direction) in rays(2, 40_000) {
        let mut both = [parts(&low, origin, direction, 9.0), parts(&high, origin, direction, 9.0)].concat();
        both.sort_by(|a, b| a.0.total_cmp(&b.0));
        both.windows(2).for_each(|w| assert_eq!(w[0].1, w[1].0, "{origin} {direction}"));
        let outer = both.first().map(|f| (f.0, both[both.len() - 1].1));
        assert_eq!(outer, parts(&all, origin, direction, 9.0).first().copied(), "{origin} {direction}");
        let twice = u32::from(low.contains(origin)) + u32::from(high.contains(origin));
        assert_eq!(twice, u32::from(all.contains(origin)), "{origin}");
    }
}

/// A chord lies between those of the spheres around the corners and within the faces; their sum is the volume.
#[test]
fn spheres_are_round() {
    let triangles = sphere(5);
    let b = mesh(triangles.clone());
    assert_eq!(b.open_edges(), None);
    let plane = |t: &[Vec3; 3]| {
        let [a, b, c] = t.map(Vec3::as_dvec3);
        (b - a).cross(c - a).normalize().dot(a)
    };
    let inner = triangles.iter().map(plane).fold(1.0, f64::min);
    assert!(0.999 < inner);
    let chord = |radius: f64, distance: f64| 2.0 * (radius * radius - distance * distance).max(0.0).sqrt();
    for i in 0..50_000 {
        let r = random(3, i);
        let origin = Vec3A::new(r[0], r[1], r[2]) * 8.0 - 4.0;
        let corner = Vec3A::from(triangles[i as usize % triangles.len()][0]);
        let target = if i % 4 == 0 { corner } else { Vec3A::new(r[3], r[4], r[5]) * 2.0 - 1.0 };
        let direction = (target - origin).normalize();
        let got = f64::from(length(&parts(&b, origin - direction * 16.0, direction, f32::INFINITY)));
        let (o, d) = (origin.as_dvec3(), direction.as_dvec3());
        let distance = o.cross(d).length() / d.length();
        let (least, most) = (chord(inner, distance), chord(1.0 + 1e-7, distance));
        assert!(least - 1e-5 <= got && got <= most + 1e-5, "{origin} {direction}: {least} {got} {most}");
        let crossed = crossings(&b, origin, direction, false);
        assert_eq!(crossed.iter().map(|c| c.1).sum::<i32>(), 0);
    }
    let n = 400;
    let mut sum = 0.0;
    for i in 0..n * n {
        let at = |i: u32| (i as f32 + 0.5) / n as f32 * 2.0 - 1.0;
        let origin = Vec3A::new(at(i % n), 5.0, at(i / n));
        sum += f64::from(length(&parts(&b, origin, Vec3A::NEG_Y, f32::INFINITY)));
    }
    let volume = triangles.iter().map(|t| DMat3::from_cols_array_2d(&t.map(|v| v.as_dvec3().to_array())));
    let volume = volume.map(|m| m.determinant()).sum::<f64>() / 6.0;
    assert!((volume / (2.0 / 3.0 * f64::from(TAU)) - 1.0).abs() < 2e-3);
    let got = sum * 4.0 / f64::from(n * n);
    assert!((got / volume - 1.0).abs() < 1e-4, "{got} {volume}");
}

#[test]
fn shells_unite_and_holes_are_empty() {
    let along = |t: Triangles| {
        let b = mesh(t);
        assert_eq!(b.open_edges(), None);
        parts(&b, Vec3A::new(-8.0, 0.25, 0.125), Vec3A::X, f32::INFINITY)
    };
    let right = || mapped(cube(-1.0, 1.0), |v| v + Vec3::X);
    let far = || mapped(cube(-1.0, 1.0), |v| v + Vec3::X * 4.0);
    let touching = || mapped(cube(-1.0, 1.0), |v| v + Vec3::X * 2.0);
    let outer = || cube(-1.0, 1.0);
    let inner = || cube(-0.5, 0.5);
    assert_eq!(along([outer(), inner()].concat()), [(7.0, 9.0)], "nested");
    assert_eq!(along([outer(), inverted(inner())].concat()), [(7.0, 7.5), (8.5, 9.0)], "a hole");
    assert_eq!(along([inverted(outer()), inner()].concat()), [(7.0, 7.5), (8.5, 9.0)], "and inside out");
    assert_eq!(along([outer(), right()].concat()), [(7.0, 10.0)], "overlapping");
    assert_eq!(along([outer(), far()].concat()), [(7.0, 9.0), (11.0, 13.0)], "apart");
    assert_eq!(along([outer(), inverted(far())].concat()), [(7.0, 9.0), (11.0, 13.0)], "one inside out");
    assert_eq!(along([outer(), touching()].concat()), [(7.0, 11.0)], "touching");
    assert_eq!(along(inverted(outer())), [(7.0, 9.0)], "inside out");
    assert_eq!(along([outer(), outer()].concat()), [(7.0, 9.0)], "twice");
    assert_eq!(along([outer(), inverted(outer())].concat()), [], "nothing between");
    let b = mesh([outer(), inverted(inner())].concat());
    assert!(!b.contains(Vec3A::ZERO) && b.contains(Vec3A::splat(0.75)) && !b.contains(Vec3A::splat(1.25)));
    assert_eq!(parts(&b, Vec3A::ZERO, Vec3A::Y, 0.75), [(0.5, 0.75)], "from in the hole");
}

/// Turned, sheared and mirrored by matrices that round nothing.
#[test]
fn transforms_keep_parameters() {
    let turned = Mat3::from_cols(vec3(3.0, 4.0, 0.0), vec3(-4.0, 3.0, 0.0), vec3(0.0, 0.0, 5.0));
    let sheared = Mat3::from_cols(vec3(1.0, 0.0, 0.0), vec3(0.5, 1.0, -0.25), vec3(0.0, 0.75, 1.0));
    let mirrored = Mat3::from_diagonal(vec3(-1.0, 1.0, 2.0));
    let tilted = Mat3::from_cols(vec3(5.0, 0.0, 0.0), vec3(0.0, 3.0, 4.0), vec3(0.0, -4.0, 3.0));
    for m in [turned, sheared, mirrored, turned * tilted, turned * mirrored, sheared * mirrored * tilted] {
        let b = mesh(mapped(cube(-1.0, 1.0), |v| m * v));
        let back = m.as_dmat3().inverse();
        for (origin, direction) in rays(4, 20_000) {
            let (origin, direction) = (Vec3A::from(m * Vec3::from(origin)), m * Vec3::from(direction));
            let direction = Vec3A::from(direction);
            let [o, d] = [origin, direction].map(|v| (back * v.as_dvec3()).to_array());
            let got = parts(&b, origin, direction, f32::INFINITY);
            // Rounding may put a ray on either side of a face that it runs in.
            let [wide, narrow] = [1.0, -1.0].map(|side| 1.0 + side * 1e-6);
            let [wide, narrow] = [wide, narrow].map(|s| in_cube(-s, s, o, d, f64::INFINITY));
            let [wide, narrow] = [wide, narrow].map(|s| s.map_or(0.0, |s| s.1 - s.0));
            let got = f64::from(length(&got));
            assert!(
                narrow * (1.0 - 1e-5) - 1e-5 <= got && got <= wide * (1.0 + 1e-5) + 1e-5,
                "{m} {o:?} {d:?}"
            );
        }
    }
}

#[test]
fn distance_from_the_origin_is_moved_away() {
    let far = vec3(1e5, -1e5, 99_999.0);
    let b = mesh(mapped(cube(-1.0, 1.0), |v| v + far));
    let near = b.moved(far);
    assert_eq!(near, mesh(cube(-1.0, 1.0)));
    assert_eq!(near.bounds(), (Vec3::NEG_ONE, Vec3::ONE));
    assert_eq!(b.bounds(), (far - 1.0, far + 1.0));
    // Multiples of 1/128 are what f32 can tell there.
    let coarse = |v: Vec3A| (v * 128.0).round() / 128.0;
    for (origin, direction) in rays(5, 20_000) {
        let origin = coarse(origin);
        let got = parts(&b, origin + Vec3A::from(far), direction, 2.0);
        assert_eq!(got, parts(&near, origin, direction, 2.0), "{origin} {direction}");
        let [o, d] = [origin, direction].map(|v| v.to_array().map(f64::from));
        assert_near(&got, in_cube(-1.0, 1.0, o, d, 2.0), "far");
        assert_eq!(b.contains(origin + Vec3A::from(far)), near.contains(origin));
    }
}

/// From a place of the boundary, and from the next numbers on both sides of it.
#[test]
fn beginning_on_the_boundary_is_continuous() {
    let b = mesh(mapped(cube(-1.0, 1.0), |v| v * 1.3));
    let s = mesh(sphere(3));
    for i in 0..20_000 {
        let r = random(6, i);
        let direction = (Vec3A::new(r[0], r[1], r[2]) - 0.5).normalize();
        let mut origin = (Vec3A::new(r[3], r[4], r[5]) * 2.0 - 1.0) * 1.3;
        let axis = i as usize % 3;
        origin[axis] = if r[6] < 0.5 { 1.3 } else { -1.3 };
        let face = s.faces[i as usize % s.faces.len()];
        let between = face.corners[0].lerp(face.corners[1], r[6]).lerp(face.corners[2], r[7]);
        for (b, origin) in [(&b, origin), (&s, between.into()), (&s, face.corners[0].into())] {
            let steps = [f32::next_down, |x: f32| x, f32::next_up].map(|step| {
                let mut o = origin;
                o[axis] = step(o[axis]);
                length(&parts(b, o, direction, f32::INFINITY))
            });
            let longest = steps[0].max(steps[1]).max(steps[2]);
            // Along the ray, a step aside moves planes by more the flatter it meets them.
            let ends = [origin, origin + direction * longest].map(Vec3::from);
            let cosines = b.faces.iter().filter_map(|f| {
                let [u, v, w] = f.corners;
                let normal = (v - u).cross(w - u).normalize();
                let near = ends.iter().any(|&end| normal.dot(end - u).abs() < 1e-5);
                near.then_some(normal.dot(direction.into()).abs())
            });
            let most = 1e-6 / cosines.fold(1.0, f32::min);
            let spread = longest - steps[0].min(steps[1]).min(steps[2]);
            assert!(spread < most, "{origin} {direction}: {steps:?}");
        }
    }
}

/// Rays through the missing side count as if it were there, because it is one of the bounds'.
#[test]
fn open_meshes_end_at_their_bounds() {
    for side in 0..6 {
        for turn in [|t| t, inverted] {
            let mut triangles = turn(cube(-1.0, 1.0));
            triangles.drain(2 * side..2 * side + 2);
            let b = mesh(triangles);
            let (count, example) = b.open_edges().expect("open");
            assert_eq!(count, 4);
            let axis = side / 2;
            assert_eq!(example[axis], if side % 2 == 0 { -1.0 } else { 1.0 });
            for (origin, direction) in rays(7, 10_000) {
                let [o, d] = [origin, direction].map(|v| v.to_array().map(f64::from));
                let want = in_cube(-1.0, 1.0, o, d, f64::INFINITY);
                assert_near(&parts(&b, origin, direction, f32::INFINITY), want, "open");
                assert_eq!(b.contains(origin), mesh(cube(-1.0, 1.0)).contains(origin), "{origin}");
            }
        }
    }
}

/// Triangles that all fill the same box make a tree high.
#[test]
fn high_trees_are_crossed() {
    let corner = |i| Vec3::from_slice(&random(17, i)[..3]);
    let b = mesh((0..3000).map(|i| [Vec3::ZERO, Vec3::ONE, corner(i)]).collect());
    let mut met = 0;
    for (origin, direction) in rays(18, 400) {
        let got = crossings(&b, origin, direction, false);
        assert_eq!(got, crossings(&b, origin, direction, true), "{origin} {direction}");
        met += got.len();
    }
    assert!(10_000 < met, "{met}");
}

/// Random triangles: `parts` checks order and bounds, here that they are within those of the mesh.
#[test]
fn nonsense_stays_finite() {
    for n in [1, 2, 5, 300] {
        let corner = |i: u32| {
            let r = random(8, i);
            vec3(r[0], r[1], r[2]) * 2.0 - 1.0
        };
        let mut triangles: Triangles = (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2].map(corner)).collect();
        triangles.push([Vec3::NAN, Vec3::X, Vec3::Y]);
        triangles.push([Vec3::X, Vec3::INFINITY, Vec3::Y]);
        triangles.push([Vec3::X, Vec3::Y, Vec3::X]);
        let b = mesh(triangles);
        assert_eq!(b.faces.len(), n as usize);
        assert!(b.open_edges().is_some());
        for (origin, direction) in rays(9, 4000) {
            let got = parts(&b, origin, direction, f32::INFINITY);
            let (min, max) = b.bounds();
            for t in got.iter().flat_map(|p| [p.0, p.1]).filter(|t| *t != 0.0) {
                let p = Vec3::from(origin + direction * t);
                assert!((min - 1e-5).cmple(p).all() && p.cmple(max + 1e-5).all(), "{p}");
            }
            assert_eq!(crossings(&b, origin, direction, false), crossings(&b, origin, direction, true));
        }
    }
    let none = mesh(Vec::new());
    assert_eq!((none.open_edges(), none.bounds()), (None, (Vec3::ZERO, Vec3::ZERO)));
    assert!(parts(&none, Vec3A::ZERO, Vec3A::X, 1.0).is_empty() && !none.contains(Vec3A::ZERO));
    let b = mesh(cube(-1.0, 1.0));
    for (origin, direction, t_max) in [
        (Vec3A::NAN, Vec3A::X, 1.0),
        (Vec3A::ZERO, Vec3A::NAN, 1.0),
        (Vec3A::ZERO, Vec3A::ZERO, 1.0),
        (Vec3A::ZERO, Vec3A::INFINITY, 1.0),
        (Vec3A::ZERO, Vec3A::X, 0.0),
        (Vec3A::ZERO, Vec3A::X, -1.0),
        (Vec3A::ZERO, Vec3A::X, f32::NAN),
        (Vec3A::splat(3e38), Vec3A::X, f32::INFINITY),
    ] {
        assert!(parts(&b, origin, direction, t_max).is_empty(), "{origin} {direction} {t_max}");
    }
}

/// Triangles without area, in pairs that face each other, and corners within an edge of a neighbour.
#[test]
fn degenerate_triangles_change_nothing() {
    let plain = mesh(cube(-1.0, 1.0));
    let mut triangles = cube(-1.0, 1.0);
    let [a, c, d] = triangles.remove(1);
    // A corner in the middle of the diagonal, for this side of it only; the gap without area is closed.
    let middle = 0.5 * (a + c);
    triangles.extend([[a, middle, d], [middle, c, d], [a, c, middle]]);
    triangles.extend([[a, a, d], [c, c, c]]);
    let slanted = [vec3(-0.3, 0.2, 0.1), vec3(0.6, 0.5, 0.7), vec3(0.1, -0.9, 0.4)];
    triangles.extend([slanted, [slanted[1], slanted[0], slanted[2]]]);
    let b = mesh(triangles);
    assert_eq!(b.open_edges(), None);
    for (origin, direction) in rays(10, 20_000) {
        let [got, want] = [&b, &plain].map(|b| parts(b, origin, direction, 5.0));
        assert_eq!(got.len(), want.len(), "{origin} {direction}: {got:?} {want:?}");
        for (g, w) in got.iter().zip(&want) {
            assert!((g.0 - w.0).abs() <= 1e-6 * w.1 && (g.1 - w.1).abs() <= 1e-6 * w.1, "{got:?} {want:?}");
        }
    }
}

/// A second shell a few of the last places away from the first.
#[test]
fn shells_that_nearly_coincide_unite() {
    let triangles = sphere(3);
    let mut moved: HashMap<[u32; 3], Vec3> = HashMap::new();
    let second = mapped(triangles.clone(), |v| {
        let n = moved.len() as u32;
        *moved.entry(v.to_array().map(f32::to_bits)).or_insert_with(|| {
            let r = random(11, n);
            v + v * (vec3(r[0], r[1], r[2]) - 0.5) * (8.0 * f32::EPSILON)
        })
    });
    let one = mesh(triangles.clone());
    for (other, hole) in [(second.clone(), false), (inverted(second), true)] {
        let b = mesh([triangles.clone(), other].concat());
        assert_eq!(b.open_edges(), None);
        for (origin, direction) in rays(12, 10_000) {
            let crossed = crossings(&b, origin, direction, false);
            assert_eq!(crossed.iter().map(|c| c.1).sum::<i32>(), 0);
            assert_eq!(crossed, crossings(&b, origin, direction, true));
            let [got, want] = [&b, &one].map(|b| length(&parts(b, origin, direction, f32::INFINITY)));
            let want = if hole { 0.0 } else { want };
            assert!((got - want).abs() < 2e-3, "{origin} {direction}: {got} {want}");
        }
    }
}

/// The end of a ray cuts what is inside of a longer one, to the bit, although a shorter one may be followed from
/// its end; from a place on the way on, to rounding. Against the direction all is the same.
#[test]
fn rays_can_be_split() {
    let s = mesh([sphere(3), inverted(mapped(sphere(2), |v| v * 0.5 + 0.25)), cube(-0.75, 1.25)].concat());
    assert_eq!(s.open_edges(), None);
    for (i, (origin, direction)) in rays(13, 20_000).enumerate() {
        let whole = parts(&s, origin, direction, f32::INFINITY);
        let middle = random(14, i as u32)[0] * 2.0;
        let first = parts(&s, origin, direction, middle);
        let cut: Vec<_> = whole.iter().filter(|p| p.0 < middle).map(|p| (p.0, p.1.min(middle))).collect();
        assert_eq!(first, cut, "{origin} {direction} {middle}");
        if i % 2 == 1 {
            let second = length(&parts(&s, origin + direction * middle, direction, f32::INFINITY));
            assert!((length(&first) + second - length(&whole)).abs() < 1e-3, "{origin} {direction} {middle}");
        } else {
            // Nothing rounds in these rays.
            let back = parts(&s, origin + direction * 4.0, -direction, 4.0);
            let there = length(&parts(&s, origin, direction, 4.0));
            assert!((length(&back) - there).abs() < 2e-6, "{origin} {direction}");
        }
    }
}

#[test]
fn scaling_is_exact() {
    let triangles = [sphere(3), inverted(cube(-0.3, 0.4))].concat();
    let open = triangles[1..].to_vec();
    for triangles in [triangles, open] {
        let one = mesh(triangles.clone());
        for k in [1024.0, 1.0 / 4096.0] {
            let scaled = mesh(mapped(triangles.clone(), |v| v * k));
            for (origin, direction) in rays(15, 5000) {
                let got = parts(&scaled, origin * k, direction, 2.0 * k);
                let want: Vec<_> =
                    parts(&one, origin, direction, 2.0).iter().map(|p| (p.0 * k, p.1 * k)).collect();
                assert_eq!(got, want, "{origin} {direction} {k}");
                // Lengths are in units of the direction's.
                assert_eq!(
                    parts(&one, origin, direction * k, 2.0 / k),
                    want.iter().map(|p| (p.0 / k / k, p.1 / k / k)).collect::<Vec<_>>()
                );
                assert_eq!(scaled.contains(origin * k), one.contains(origin));
            }
        }
    }
}

/// Places are inside where a ray from them begins inside.
#[test]
fn places_and_rays_agree() {
    let triangles = [sphere(4), inverted(mapped(sphere(2), |v| v * 0.4 + 0.2))].concat();
    let turned = Affine3A::from_rotation_x(0.4) * Affine3A::from_rotation_y(1.1);
    let b = mesh(mapped(triangles, |v| turned.transform_point3(v)));
    let mut inside = 0;
    for (i, (p, direction)) in rays(16, 20_000).enumerate() {
        let p = if i % 2 == 0 { p } else { p * 0.4 };
        let first = parts(&b, p, direction, f32::INFINITY).first().is_some_and(|s| s.0 == 0.0);
        assert_eq!(b.contains(p), first, "{p} {direction}");
        inside += u32::from(first);
    }
    assert!(2000 < inside);
}
