//! What rays cross in media, in closed form.

use crate::Group;
use crate::responses::single;
use bake::media::Media;
use bake::scene::model::{Density, Medium, Region, Scene, Shell};
use bake::scene::voxels::Voxels;
use glam::{Affine3A, UVec3, Vec3, Vec3A, vec3};
use std::sync::Arc;
use suite::shape::{ALL, Shape};

fn body(sigma_s: f32, sigma_a: f32, region: Region) -> Medium {
    Medium {
        path: String::new(),
        sigma_s: Vec3::splat(sigma_s),
        sigma_a: Vec3::splat(sigma_a),
        emission: Vec3::ZERO,
        density: Density::Constant,
        g: 0.0,
        region,
    }
}

fn cube(min: f32, max: f32) -> Region {
    Region::Box { min: Vec3::splat(min), max: Vec3::splat(max) }
}

/// The same box as a closed mesh.
fn meshed(min: Vec3, max: Vec3) -> Shell {
    let mut s = Shape::default();
    s.cuboid(min, max, ALL);
    Shell { positions: s.positions, triangles: s.triangles }
}

fn media(bodies: Vec<Medium>) -> Media {
    Media::new(&Scene { media: bodies, ..Scene::default() }, Vec3::ZERO).expect("media")
}

fn depth(m: &Media, origin: Vec3, direction: Vec3, t_max: f32) -> f64 {
    let depth = m.optical_depth(origin.into(), direction.into(), t_max);
    let crossing = m.crossing(origin.into(), direction.into(), t_max).optical_depth;
    // Both ways to ask have to agree.
    let same =
        (depth - crossing).abs().max_element() <= 1e-5 * depth.abs().max_element() || depth == crossing;
    if same { f64::from(depth.x) } else { f64::NAN }
}

/// Relative, or absolute where nothing is wanted.
fn off(got: f64, want: f64) -> f64 {
    if want == 0.0 { got.abs() } else { ((got - want) / want).abs() }
}

/// A number and those a few ulps above and below.
fn ulps(x: f32) -> [f32; 5] {
    [x.next_down().next_down(), x.next_down(), x, x.next_up(), x.next_up().next_up()]
}

fn worst(of: impl IntoIterator<Item = f64>) -> f64 {
    // Not `max`, which passes over what is not a number.
    of.into_iter().fold(0.0, |a, b| if b.is_nan() || a < b { b } else { a })
}

pub(crate) fn group() -> Group {
    let mut group = Group::new("segments");
    coefficients(&mut group);
    boundaries(&mut group);
    meshes(&mut group);
    densities(&mut group);
    group
}

fn coefficients(group: &mut Group) {
    for (sigma, length) in [(1e-9f32, 1e9f32), (1e6, 1e-6), (1e6, 1e3), (1e-9, 1e-9)] {
        group.add(format!("sigma {sigma:e} over {length:e} m"), 1e-6, move || {
            let m = media(vec![body(sigma, 0.0, Region::Everywhere)]);
            let want = f64::from(sigma) * f64::from(length);
            let left = f64::from(m.transmittance(Vec3A::ZERO, Vec3A::X, length).x);
            // 1 - exp of a small depth is beyond f32; what is asked is that nothing is added.
            let lost = (left - (-want).exp()).abs();
            worst([off(depth(&m, Vec3::ZERO, Vec3::X, length), want), lost])
        });
    }
    group.add("nothing that scatters or absorbs is no medium", 0.0, || {
        let none = Media::new(
            &Scene { media: vec![body(0.0, 0.0, Region::Everywhere)], ..Scene::default() },
            Vec3::ZERO,
        );
        f64::from(u8::from(none.is_some()))
    });
    group.add("a channel without sigma goes on for ever", 0.0, || {
        let mut fog = body(0.0, 0.0, Region::Everywhere);
        fog.sigma_a = vec3(0.0, 1e-9, 1e6);
        let left = media(vec![fog]).transmittance(Vec3A::ZERO, Vec3A::Y, f32::INFINITY);
        worst((left - Vec3::X).abs().to_array().map(f64::from))
    });
    group.add("no length crosses nothing", 0.0, || {
        let m = media(vec![body(1e6, 1e6, Region::Everywhere), body(1.0, 0.0, cube(-1.0, 1.0))]);
        let mut parts = Vec::new();
        m.segments(Vec3A::ZERO, Vec3A::X, 0.0, &mut parts);
        depth(&m, Vec3::ZERO, Vec3::X, 0.0) + parts.len() as f64
    });
    group.add("the least length there is", 1e-6, || {
        let m = media(vec![body(1e6, 0.0, Region::Everywhere)]);
        off(depth(&m, Vec3::ZERO, Vec3::X, 1e-36), 1e-30)
    });
    group.add("1 beside 1e-9, and 1e6 beside both", 1e-6, || {
        let m = media(vec![
            body(1.0, 0.0, cube(0.0, 1.0)),
            body(1e-9, 0.0, Region::Everywhere),
            body(0.0, 1e6, Region::Box { min: vec3(2.0, 0.0, 0.0), max: vec3(2.0 + 1e-6, 1.0, 1.0) }),
        ]);
        let x = f64::from(2.0f32 + 1e-6) - 2.0;
        off(depth(&m, vec3(-1.0, 0.5, 0.5), Vec3::X, 10.0), 1.0 + 1e-8 + 1e6 * x)
    });
}

fn boundaries(group: &mut Group) {
    let ray = |o: Vec3, d: Vec3| move |m: &Media| depth(m, o, d, f32::INFINITY);
    group.add("rays within an ulp of a face are inside or outside, not both", 0.0, move || {
        let m = media(vec![body(1.0, 0.0, cube(0.0, 1.0))]);
        let mut bad = 0;
        for edge in [0.0f32, 1.0] {
            for at in ulps(edge) {
                let d = ray(vec3(-1.0, at, 0.5), Vec3::X)(&m);
                let inside = 0.0 < at && at < 1.0;
                let outside = !(0.0..=1.0).contains(&at);
                bad += usize::from(if inside {
                    d != 1.0
                } else if outside {
                    d != 0.0
                } else {
                    d != 0.0 && d != 1.0
                });
            }
        }
        bad as f64
    });
    group.add("boxes that touch count once within an ulp of their common face", 0.0, move || {
        let mut bad = 0.0f64;
        // Faces across each axis, along each of the two others, both ways.
        for (across, along) in [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)] {
            let step = Vec3::AXES[across];
            let right = Region::Box { min: step, max: Vec3::ONE + step };
            let m = media(vec![body(1.0, 0.0, cube(0.0, 1.0)), body(1.0, 0.0, right)]);
            for (start, way) in [(-1.0, 1.0), (2.0, -1.0)] {
                for x in ulps(1.0) {
                    let mut from = Vec3::splat(0.5);
                    (from[across], from[along]) = (x, start);
                    bad = worst([bad, (ray(from, way * Vec3::AXES[along])(&m) - 1.0).abs()]);
                }
            }
        }
        bad
    });
    group.add("along an edge and through a corner", 1e-6, move || {
        let m = media(vec![body(1.0, 0.0, cube(0.0, 1.0))]);
        let diagonal = ray(Vec3::splat(-1.0), Vec3::ONE.normalize())(&m);
        let edge = ray(vec3(-1.0, 0.0, 0.0), Vec3::X)(&m);
        // The edge belongs to the box or it does not.
        worst([off(diagonal, 3f64.sqrt()), edge.min((edge - 1.0).abs())])
    });
    group.add("directions with parts below any normal number", 0.0, move || {
        let m = media(vec![body(1.0, 0.0, cube(0.0, 1.0))]);
        let mut bad = 0;
        for tiny in [1e-45f32, 1e-40, f32::MIN_POSITIVE, 1e-30] {
            for (y, want) in [(0.5, 1.0), (-0.5, 0.0), (1.5, 0.0)] {
                for sign in [1.0, -1.0] {
                    let d = ray(vec3(-1.0, y, 0.5), vec3(1.0, sign * tiny, -sign * tiny))(&m);
                    bad += usize::from(d != want);
                }
            }
        }
        bad as f64
    });
    group.add("starts an ulp off a face, inwards and outwards", 1e-6, move || {
        let m = media(vec![body(1.0, 0.0, cube(0.0, 1.0))]);
        worst(ulps(1.0).map(|x| {
            let (out, into) = (ray(vec3(x, 0.5, 0.5), Vec3::X)(&m), ray(vec3(x, 0.5, 0.5), Vec3::NEG_X)(&m));
            worst([out, off(into, 1.0)])
        }))
    });
    group.add("eight boxes one within another", 1e-6, move || {
        let boxes: Vec<Medium> =
            (1..=8u8).map(|k| body(1.0, 0.0, cube(-f32::from(k), f32::from(k)))).collect();
        let m = media(boxes);
        let through = ray(vec3(-20.0, 0.1, 0.2), Vec3::X)(&m);
        let from_within = ray(vec3(0.0, 0.1, 0.2), Vec3::X)(&m);
        worst([off(through, 72.0), off(from_within, 36.0)])
    });
    group.add("overlapping media add, and g is weighed by scattering", 1e-6, || {
        let mut a = body(3.0, 1.0, cube(0.0, 2.0));
        let mut b = body(1.0, 5.0, cube(1.0, 3.0));
        (a.g, b.g) = (0.99, -0.99);
        let m = media(vec![a, b]);
        let (o, d) = (Vec3A::new(-1.0, 1.5, 1.5), Vec3A::X);
        let mut parts = Vec::new();
        m.segments(o, d, 10.0, &mut parts);
        let sums: Vec<f64> = parts
            .iter()
            .map(|s| f64::from(m.coefficients(*s, o, d, 0.5 * (s.from + s.to)).sigma_t.x * (s.to - s.from)))
            .collect();
        let g = f64::from(m.coefficients(parts[1], o, d, 2.5).g);
        worst([
            off(g, 0.495),
            off(sums[0], 4.0),
            off(sums[1], 10.0),
            off(sums[2], 6.0),
            (parts.len() as f64 - 3.0).abs(),
        ])
    });
    group.add("the same box 64 times", 1e-6, move || {
        let m = media((0..64).map(|_| body(0.25, 0.25, cube(0.0, 1.0))).collect());
        off(ray(vec3(-1.0, 0.5, 0.5), Vec3::X)(&m), 32.0)
    });
    group.add("a box of no thickness", 0.0, move || {
        let flat = Region::Box { min: vec3(0.0, 0.0, 0.0), max: vec3(0.0, 1.0, 1.0) };
        let m = media(vec![body(1e6, 0.0, flat)]);
        worst([ray(vec3(-1.0, 0.5, 0.5), Vec3::X)(&m), ray(vec3(0.0, -1.0, 0.5), Vec3::Y)(&m)])
    });
    group.add("a box 1e5 m off whose size is a millimetre", 2e-3, move || {
        // Coordinates there are 1/128 m apart, so a box of that size is what can be said.
        let at = 1e5f32;
        let size = at.next_up() - at;
        let there = Region::Box { min: vec3(at, 0.0, 0.0), max: vec3(at + size, 1.0, 1.0) };
        let m =
            Media::new(&Scene { media: vec![body(1.0, 0.0, there)], ..Scene::default() }, vec3(at, 0.0, 0.0));
        off(ray(vec3(-1.0, 0.5, 0.5), Vec3::X)(&m.expect("media")), f64::from(size))
    });
}

fn meshes(group: &mut Group) {
    let shell = |min: Vec3, max: Vec3| Region::Mesh(Arc::new(meshed(min, max)));
    group.add("a mesh is its box, through edges, corners and faces", 1e-5, move || {
        let mesh = media(vec![body(1.0, 0.0, shell(Vec3::ZERO, Vec3::ONE))]);
        let plain = media(vec![body(1.0, 0.0, cube(0.0, 1.0))]);
        let mut bad = 0.0f64;
        // Aimed at the middle of faces (where the diagonals run), at corners, and at edges.
        for target in [vec3(0.5, 0.5, 0.5), vec3(0.25, 0.75, 0.5), vec3(0.0, 0.0, 0.5), vec3(0.5, 0.5, 0.0)] {
            for from in
                [vec3(-2.0, -2.0, -2.0), vec3(-2.0, 0.5, 0.5), vec3(3.0, 3.0, 0.5), vec3(0.5, -2.0, -2.0)]
            {
                let d = (target - from).normalize_or_zero();
                if d == Vec3::ZERO {
                    continue;
                }
                let [a, b] = [&mesh, &plain].map(|m| depth(m, from, d, f32::INFINITY));
                // A ray that lies in a face or touches an edge may count as inside or not.
                let grazes = [d.x, d.y, d.z].contains(&0.0) || b < 1e-3 || a < 1e-3;
                let allowed = if grazes { (a - b).abs().min(a).min((a - 1.0).abs()) } else { (a - b).abs() };
                bad = worst([bad, allowed]);
            }
        }
        bad
    });
    group.add("meshes that share a face count once", 1e-5, move || {
        let m = media(vec![
            body(1.0, 0.0, shell(Vec3::ZERO, Vec3::ONE)),
            body(1.0, 0.0, shell(vec3(1.0, 0.0, 0.0), vec3(2.0, 1.0, 1.0))),
        ]);
        let rays = [(0.3, 0.4), (0.5, 0.5), (0.25, 0.25)];
        worst(rays.map(|(y, z)| off(depth(&m, vec3(-1.0, y, z), Vec3::X, f32::INFINITY), 2.0)))
    });
    group.add("starts on the face of a mesh, and an ulp off it", 1e-5, move || {
        let m = media(vec![body(1.0, 0.0, shell(Vec3::ZERO, Vec3::ONE))]);
        worst(ulps(1.0).map(|x| {
            let into = depth(&m, vec3(x, 0.3, 0.4), Vec3::NEG_X, f32::INFINITY);
            let out = depth(&m, vec3(x, 0.3, 0.4), Vec3::X, f32::INFINITY);
            worst([off(into, 1.0), out])
        }))
    });
    group.add("a mesh without its lid ends at its bounds", 1e-5, move || {
        let mut open = meshed(Vec3::ZERO, Vec3::ONE);
        // The last two triangles are the side at z = 1.
        open.triangles.truncate(10);
        let m = media(vec![body(1.0, 0.0, Region::Mesh(Arc::new(open)))]);
        // In by a wall and out by the hole, and the other way round.
        let out = depth(&m, vec3(0.3, 0.4, -1.0), Vec3::Z, f32::INFINITY);
        let into = depth(&m, vec3(0.3, 0.4, 2.0), Vec3::NEG_Z, f32::INFINITY);
        worst([off(out, 1.0), off(into, 1.0)])
    });
    group.add("degenerate triangles of a mesh change nothing", 1e-6, move || {
        let mut mesh = meshed(Vec3::ZERO, Vec3::ONE);
        let n = u32::try_from(mesh.positions.len()).expect("few");
        mesh.positions.extend([Vec3::splat(0.5), Vec3::splat(0.5), Vec3::splat(0.5)]);
        mesh.triangles.extend([[0, 0, 1], [n, n + 1, n + 2], [3, 3, 3]]);
        let m = media(vec![body(1.0, 0.0, Region::Mesh(Arc::new(mesh)))]);
        worst([0.5, 0.3].map(|y| off(depth(&m, vec3(-1.0, y, 0.5), Vec3::X, f32::INFINITY), 1.0)))
    });
    group.add("a turned box that is a ten-thousandth of its distance thick", 1e-3, || {
        let world = Affine3A::from_scale(vec3(1e-4, 1.0, 1.0));
        let region = Region::Turned { unit_from_world: world.inverse() };
        let m = media(vec![body(1e4, 0.0, region)]);
        off(depth(&m, vec3(-1.0, 0.5, 0.5), Vec3::X, f32::INFINITY), 1.0)
    });
}

fn densities(group: &mut Group) {
    let height = |base: f32, falloff: f32| {
        let mut fog = body(0.0, 0.5, Region::Everywhere);
        fog.density = Density::Height { base, falloff };
        media(vec![fog])
    };
    // The integral of exp(-(y0 + d t) / f) over t is (exp(-y0 / f) - exp(-(y0 + d t) / f)) f / d.
    let exact = |y0: f64, d: f64, f: f64, t: f64| {
        let k = d * t / f;
        0.5 * (-y0 / f).exp() * t * if k == 0.0 { 1.0 } else { -(-k).exp_m1() / k }
    };
    for slope in [1e-45f32, 1e-38, 1e-20, 1e-8, 1e-3] {
        group.add(format!("fog that falls with height, along a slope of {slope:e}"), 1e-6, move || {
            let m = height(0.0, 2.0);
            worst([slope, -slope].map(|d| {
                let got = depth(&m, vec3(0.0, 0.5, 0.0), vec3(1.0, d, 0.0), 10.0);
                off(got, exact(0.5, f64::from(d), 2.0, 10.0))
            }))
        });
    }
    for falloff in [1e-3f32, 1.0, 1e6] {
        group.add(format!("fog that falls over {falloff:e} m, up and down"), 2e-5, move || {
            let m = height(0.0, falloff);
            worst([1.0f32, -1.0].map(|d| {
                let f = f64::from(falloff);
                let start = if d < 0.0 { single(2.0 * f) } else { 0.0 };
                let t = 2.0 * falloff;
                let got = depth(&m, vec3(0.0, start, 0.0), vec3(0.0, d, 0.0), t);
                off(got, exact(f64::from(start), f64::from(d), f, f64::from(t)))
            }))
        });
    }
    group.add("fog so dense below that no number holds it is opaque", 0.0, move || {
        let m = height(0.0, 1e-3);
        let left = m.transmittance(Vec3A::new(0.0, -1e3, 0.0), Vec3A::X, 1.0);
        let aslant = m.transmittance(Vec3A::new(0.0, -1e3, 0.0), Vec3A::Y, f32::INFINITY);
        f64::from(left.max(aslant).max_element())
    });
    group.add("fog so thin above that nothing is left of it", 0.0, move || {
        let m = height(0.0, 1e-3);
        f64::from((m.transmittance(Vec3A::new(0.0, 1e3, 0.0), Vec3A::X, 1e3) - 1.0).abs().max_element())
    });
    let voxels = |values: &[f32], size: UVec3| {
        let mut smoke = body(0.0, 1e-4, cube(0.0, 1.0));
        let grid = Voxels::dense(size, values, 1 << 20).expect("voxels");
        let voxels_from_world = Affine3A::from_scale(size.as_vec3());
        smoke.density = Density::Voxels { values: Arc::new(grid), voxels_from_world };
        media(vec![smoke])
    };
    group.add("a jump of 1e4 between voxels", 1e-5, move || {
        let m = voxels(&[1.0, 1e4], UVec3::new(2, 1, 1));
        let along = depth(&m, vec3(-1.0, 0.5, 0.5), Vec3::X, f32::INFINITY);
        let back = depth(&m, vec3(2.0, 0.5, 0.5), Vec3::NEG_X, f32::INFINITY);
        let want = 0.5e-4 * (1.0 + 1e4);
        worst([off(along, want), off(back, want)])
    });
    group.add("within an ulp of the face between such voxels", 1e-5, move || {
        let m = voxels(&[1.0, 1e4], UVec3::new(2, 1, 1));
        worst(ulps(0.5).map(|x| {
            let d = depth(&m, vec3(x, -1.0, 0.5), Vec3::Y, f32::INFINITY);
            // One voxel or the other.
            off(d, 1e-4).min(off(d, 1.0))
        }))
    });
    group.add("along edges and corners of voxels", 1e-5, move || {
        let m = voxels(&[1.0; 64], UVec3::splat(4));
        let diagonal = depth(&m, Vec3::splat(-1.0), Vec3::ONE.normalize(), f32::INFINITY);
        let edge = depth(&m, vec3(-1.0, 0.5, 0.5), Vec3::X, f32::INFINITY);
        worst([off(diagonal, 1e-4 * 3f64.sqrt()), off(edge, 1e-4)])
    });
    group.add("the place in a grid where a depth is reached is that place", 1e-5, move || {
        let m = voxels(&[1.0, 1e4, 0.0, 1e4], UVec3::new(4, 1, 1));
        let (o, d) = (Vec3A::new(-1.0, 0.5, 0.5), Vec3A::X);
        let mut parts = Vec::new();
        m.segments(o, d, 10.0, &mut parts);
        let segment = parts[0];
        worst([1e-5f32, 0.1, 0.25, 0.3, 0.5].map(|wanted| {
            let at = m.place_in_grid(segment, o, d, 0, wanted).expect("a grid");
            off(f64::from(m.depth_within(segment, o, d, at).x), f64::from(wanted))
        }))
    });
}
