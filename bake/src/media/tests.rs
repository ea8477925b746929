use super::*;
use glam::vec3;

fn body(sigma_s: f32, sigma_a: f32, g: f32, region: Region) -> Medium {
    Medium {
        path: String::new(),
        sigma_s: Vec3::splat(sigma_s),
        sigma_a: Vec3::splat(sigma_a),
        emission: Vec3::ZERO,
        density: Density::Constant,
        g,
        region,
    }
}

fn cube(min: f32, max: f32) -> Region {
    Region::Box { min: Vec3::splat(min), max: Vec3::splat(max) }
}

fn media(bodies: Vec<Medium>) -> Media {
    Media::new(&Scene { media: bodies, ..Scene::default() }, Vec3::ZERO).expect("media")
}

fn depth(m: &Media, origin: [f32; 3], direction: [f32; 3], t_max: f32) -> f32 {
    m.optical_depth(origin.into(), direction.into(), t_max).x
}

#[test]
fn depths_are_lengths_times_coefficients() {
    let m = media(vec![body(0.5, 0.25, 0.0, cube(0.0, 2.0)), body(0.25, 0.0, 0.5, cube(1.0, 5.0))]);
    assert_eq!(depth(&m, [-1.0, 1.5, 1.5], [1.0, 0.0, 0.0], f32::INFINITY), 0.75 * 2.0 + 0.25 * 4.0);
    assert_eq!(depth(&m, [1.5, 1.5, 1.5], [1.0, 0.0, 0.0], 1.0), 0.75 * 0.5 + 0.25);
    assert_eq!(depth(&m, [6.0, 1.5, 1.5], [1.0, 0.0, 0.0], f32::INFINITY), 0.0, "behind");
    assert_eq!(depth(&m, [0.5, 0.5, 0.5], [0.0, 1.0, 0.0], 0.0), 0.0, "no length");
    let (o, d) = (Vec3A::new(-1.0, 1.5, 1.5), Vec3A::X);
    let mut s = Vec::new();
    m.segments(o, d, 100.0, &mut s);
    let of: Vec<(f32, f32, f32)> =
        s.iter().map(|s| (s.from, s.to, m.coefficients(*s, o, d, 0.5 * (s.from + s.to)).sigma_t.x)).collect();
    assert_eq!(of, [(1.0, 2.0, 0.75), (2.0, 3.0, 1.0), (3.0, 6.0, 0.25)]);
    assert!((m.coefficients(s[1], o, d, 2.5).g - 0.125 / 0.75).abs() < 1e-7);
    assert_eq!(m.depth_within(s[1], o, d, 2.5).x, 0.5);
}

/// Against sums over small steps, upwards, downwards, level and nearly so; and without end.
#[test]
fn height_fog_is_integrated() {
    let mut fog = body(0.3, 0.0, 0.0, Region::Everywhere);
    fog.density = Density::Height { base: 1.0, falloff: 2.5 };
    let m = Media::new(&Scene { media: vec![fog], ..Scene::default() }, vec3(0.0, 4.0, 0.0)).expect("media");
    for y in [-0.8f32, -1e-6, 0.0, 1e-4, 0.6, 1.0] {
        let direction = Vec3A::new((1.0 - y * y).sqrt(), y, 0.0);
        let origin = Vec3A::new(3.0, -2.0, 7.0);
        let n = 100_000;
        let step = 12.0 / f64::from(n);
        let want: f64 = (0..n)
            .map(|i| {
                let height = 2.0 + f64::from(y) * (f64::from(i) + 0.5) * step;
                0.3 * (-(height - 1.0) / 2.5).exp() * step
            })
            .sum();
        let got = f64::from(m.optical_depth(origin, direction, 12.0).x);
        assert!((got / want - 1.0).abs() < 2e-5, "{y}: {got} {want}");
    }
    let up = m.optical_depth(Vec3A::new(0.0, -2.0, 0.0), Vec3A::Y, f32::INFINITY).x;
    assert!((up / (0.3 * 2.5 * (-1.0f32 / 2.5).exp()) - 1.0).abs() < 1e-5);
    for direction in [Vec3A::X, Vec3A::NEG_Y] {
        assert_eq!(m.transmittance(Vec3A::ZERO, direction, f32::INFINITY), Vec3::ZERO);
    }
    // From far above, where the density is less than any number, down to where it is not.
    let down = m.optical_depth(Vec3A::new(0.0, 997.0, 0.0), Vec3A::NEG_Y, 1000.0).x;
    assert!((down / (0.3 * 2.5) - 1.0).abs() < 1e-3, "{down}");
}

/// Rays in a face, along an edge, from a corner; nothing is counted twice where boxes touch.
#[test]
fn grazing_rays_are_inside_once_or_not_at_all() {
    let right = Region::Box { min: vec3(2.0, 0.0, 0.0), max: vec3(4.0, 2.0, 2.0) };
    let m = media(vec![body(1.0, 0.0, 0.0, cube(0.0, 2.0)), body(1.0, 0.0, 0.0, right)]);
    // In the plane x = 2 between both: of one of them.
    assert_eq!(depth(&m, [2.0, -1.0, 1.0], [0.0, 1.0, 0.0], f32::INFINITY), 2.0);
    assert_eq!(depth(&m, [-1.0, 1.0, 1.0], [1.0, 0.0, 0.0], f32::INFINITY), 4.0);
    for origin in [[0.0, 0.0, 0.0], [2.0, 2.0, 2.0], [0.0, 2.0, 1.0]] {
        for direction in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.8, 0.0], [-0.6, 0.0, 0.8]] {
            let d = depth(&m, origin, direction, f32::INFINITY);
            assert!((0.0..=5.0).contains(&d), "{origin:?} {direction:?}: {d}");
        }
    }
}

#[test]
fn turned_boxes_are_where_they_are() {
    // The cube [0, 1]^3, twice as long along x, turned by 90 degrees about z, and moved.
    let world_from_unit = Affine3A::from_translation(vec3(5.0, 0.0, 0.0))
        * Affine3A::from_rotation_z(std::f32::consts::FRAC_PI_2)
        * Affine3A::from_scale(vec3(2.0, 1.0, 1.0));
    let region = Region::Turned { unit_from_world: world_from_unit.inverse() };
    let scene = Scene { media: vec![body(1.0, 0.0, 0.0, region)], ..Scene::default() };
    let origin = vec3(0.25, 0.5, -8.0);
    let m = Media::new(&scene, origin).expect("media");
    let at = |p: [f32; 3]| Vec3A::from(Vec3::from(p) - origin);
    let depth = |p, d: [f32; 3]| m.optical_depth(at(p), d.into(), f32::INFINITY).x;
    assert!((depth([4.5, -3.0, 0.5], [0.0, 1.0, 0.0]) - 2.0).abs() < 1e-5);
    assert!((depth([0.0, 1.0, 0.5], [1.0, 0.0, 0.0]) - 1.0).abs() < 1e-5);
    assert_eq!(depth([5.5, -3.0, 0.5], [0.0, 1.0, 0.0]), 0.0);
    let d = vec3(0.0, 0.6, 0.8);
    assert!((depth([4.5, 1.0, 0.0], d.to_array()) - 1.25).abs() < 1e-5, "from inside, through a side");
}

#[test]
fn endless_media_swallow_everything_or_nothing() {
    let mut fog = body(0.0, 0.0, 0.0, Region::Everywhere);
    fog.sigma_a = vec3(0.0, 1e-9, 1e6);
    let m = media(vec![fog]);
    let t = m.transmittance(Vec3A::ZERO, Vec3A::X, f32::INFINITY);
    assert_eq!(t, vec3(1.0, 0.0, 0.0));
    let t = m.transmittance(Vec3A::ZERO, Vec3A::X, 1.0);
    assert!(t.x == 1.0 && t.y == 1.0 && t.z == 0.0);
    assert!(Media::new(&Scene::default(), Vec3::ZERO).is_none());
    let clear = Scene { media: vec![body(0.0, 0.0, 0.0, Region::Everywhere)], ..Scene::default() };
    assert!(Media::new(&clear, Vec3::ZERO).is_none(), "what does nothing costs nothing");
}

/// Lengths by 2^k and coefficients by 2^-k give the same depth to the bit.
#[test]
fn scaling_is_exact() {
    let at = |k: f32| {
        let m = media(vec![
            body(0.3 / k, 0.07 / k, 0.0, cube(-0.7 * k, 1.3 * k)),
            body(0.011 / k, 0.0, 0.0, Region::Everywhere),
        ]);
        m.optical_depth(Vec3A::new(-3.1, 0.2, 0.1) * k, Vec3A::new(0.96, 0.0, 0.28), 17.3 * k)
    };
    assert_eq!(at(1.0), at(1024.0));
    assert_eq!(at(1.0), at(1.0 / 4096.0));
}

/// The corners and sides of a box from 0 to `size`.
fn shell(size: Vec3, closed: bool) -> Region {
    let positions = (0..8u8).map(|i| vec3(f32::from(i & 1), f32::from(i >> 1 & 1), f32::from(i >> 2)) * size);
    let sides: [[u32; 4]; 6] =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let n = if closed { 6 } else { 5 };
    let triangles = sides[..n].iter().flat_map(|s| [[s[0], s[1], s[2]], [s[0], s[2], s[3]]]).collect();
    Region::Mesh(Arc::new(Shell { positions: positions.collect(), triangles }))
}

fn grid(size: [u32; 3], values: &[f32], side: f32) -> Density {
    let values = Voxels::dense(size.into(), values, 1 << 20).expect("a grid");
    Density::Voxels {
        values: Arc::new(values),
        voxels_from_world: Affine3A::from_scale(Vec3::splat(1.0 / side)),
    }
}

/// Meshes and grids that say the same as a box give the same depths and segments, wherever the world's origin is.
#[test]
fn a_box_is_a_box_as_mesh_and_grid() {
    let of = |region: Region, density: Density| {
        let medium = Medium { density, ..body(0.4, 0.1, 0.2, region) };
        let scene = Scene { media: vec![medium], ..Scene::default() };
        Media::new(&scene, vec3(0.5, -1.0, 0.25)).expect("media")
    };
    let size = vec3(2.0, 1.0, 3.0);
    let cuboid = Region::Box { min: Vec3::ZERO, max: size };
    let all = [
        of(cuboid.clone(), Density::Constant),
        of(shell(size, true), Density::Constant),
        of(Region::Everywhere, grid([4, 2, 6], &[1.0; 48], 0.5)),
        of(shell(size, true), grid([4, 2, 6], &[1.0; 48], 0.5)),
    ];
    let mut met = 0;
    for i in 0..2000u32 {
        let u = |d| sobol_burley::sample(i, d, 3) - 0.5;
        let origin = Vec3A::new(6.0 * u(0), 6.0 * u(1), 6.0 * u(2));
        let direction = Vec3A::new(u(3), u(4), u(5)).normalize();
        let depth = |m: &Media| m.crossing(origin, direction, 4.0);
        let want = depth(&all[0]);
        met += u32::from(want.optical_depth != Vec3::ZERO);
        for m in &all[1..] {
            let got = depth(m);
            assert!((got.optical_depth - want.optical_depth).abs().max_element() < 2e-6, "{got:?} {want:?}");
            assert!((got.forward - want.forward).abs() < 2e-6);
            let mut segments = Vec::new();
            m.segments(origin, direction, 4.0, &mut segments);
            let sum: Vec3 = segments.iter().map(|s| m.depth_within(*s, origin, direction, s.to)).sum();
            assert!((sum - want.optical_depth).abs().max_element() < 4e-6);
        }
    }
    assert!(100 < met, "{met}");
}

/// Bounds hold everywhere, cover the segment, and the place that is found is the one that was wanted.
#[test]
fn bounds_hold_and_places_are_found() {
    let values: Vec<f32> =
        (0..16 * 12 * 20u16).map(|i| f32::from(i.wrapping_mul(7919) % 64) / 64.0).collect();
    let clouds = Medium {
        density: grid([16, 12, 20], &values, 0.25),
        ..body(0.4, 0.1, 0.2, Region::Box { min: Vec3::ZERO, max: vec3(4.0, 3.0, 5.0) })
    };
    let mut haze = body(0.2, 0.0, 0.0, cube(-1.0, 3.0));
    haze.density = Density::Height { base: 0.0, falloff: 1.5 };
    let m = media(vec![clouds, haze]);
    let (mut segments, mut parts) = (Vec::new(), Vec::new());
    let (mut mixed, mut alone) = (0, 0);
    for i in 0..300u32 {
        let u = |d| sobol_burley::sample(i, d, 5);
        let origin = Vec3A::new(8.0 * u(0) - 2.0, 8.0 * u(1) - 2.0, 8.0 * u(2) - 2.0);
        let direction = (Vec3A::new(2.0, 1.5, 2.5) * 1.2 * u(3) - origin).normalize();
        m.segments(origin, direction, 20.0, &mut segments);
        for &s in &segments {
            m.majorants(s, origin, direction, 0, &mut parts);
            assert_eq!((parts[0].0, parts[parts.len() - 1].1), (s.from, s.to));
            assert!(parts.windows(2).all(|p| p[0].1 == p[1].0));
            // What is as short as the rounding of places may belong to a neighbour.
            for (k, &(from, to, most)) in (0..).zip(&parts).filter(|(_, p)| 1e-4 < p.1 - p.0) {
                let t = from + (to - from) * sobol_burley::sample(k, 4, i);
                assert!(m.coefficients(s, origin, direction, t).sigma_t.x <= most * 1.000_01);
            }
            mixed += usize::from(m.is_mixed(s));
            let depth = m.depth_within(s, origin, direction, s.to).x;
            if let Some(t) = m.place_in_grid(s, origin, direction, 0, 0.4 * depth).filter(|_| 1e-3 < depth) {
                alone += 1;
                let got = m.depth_within(s, origin, direction, t).x;
                assert!((got / (0.4 * depth) - 1.0).abs() < 1e-3, "{got} {depth}");
            }
        }
    }
    assert!(30 < mixed && 30 < alone, "{mixed} {alone}");
}

#[test]
fn open_meshes_are_named() {
    let scene = |closed| Scene {
        media: vec![Medium { path: "cloud".into(), ..body(1.0, 0.0, 0.0, shell(Vec3::ONE, closed)) }],
        ..Scene::default()
    };
    assert_eq!(findings(&scene(true)), []);
    let found = findings(&scene(false));
    assert!(found.len() == 1 && found[0].path == "cloud" && found[0].what.contains("4 edges"), "{found:?}");
}

/// What light has lost per metre of each band, sigma_t - sigma_s times the band, is the same for what delta-M makes of media; the phase function has these bands.
#[test]
fn smoothed_media_lose_the_same_of_each_band() {
    for g in [-0.5f32, 0.0, 0.3, 0.8, 0.95] {
        let m = media(vec![body(2.0, 0.5, g, cube(0.0, 1.0))]);
        let smooth = m.smoothed();
        let at = |m: &Media| m.plain(Vec3A::splat(0.5), Vec3A::X, 0.1).expect("one medium").2;
        let (a, b) = (at(&m), at(&smooth));
        let (of, to) = (m.bands(a.g), smooth.bands(b.g));
        assert!((a.sigma_t - a.sigma_s - (b.sigma_t - b.sigma_s)).abs().max_element() < 1e-6, "absorption");
        for (of, to) in of.into_iter().zip(to) {
            let (lost, kept) = (a.sigma_t.x - a.sigma_s.x * of, b.sigma_t.x - b.sigma_s.x * to);
            assert!((lost / kept - 1.0).abs() < 1e-4, "g {g}: {lost} {kept}");
        }
        // Bands of the phase function by quadrature.
        let n = 20_000;
        let mut moments = [0.0f32; 3];
        for i in 0..n {
            let x = (i as f32 + 0.5) / n as f32 * 2.0 - 1.0;
            let p = smooth.phase(b.g, x) * 4.0 * std::f32::consts::PI / n as f32;
            for (m, l) in moments.iter_mut().zip([1.0, x, 1.5 * x * x - 0.5]) {
                *m += p * l;
            }
        }
        for (m, want) in moments.iter().zip([1.0, to[0], to[1]]) {
            assert!((m - want).abs() < 2e-4, "g {g}: {moments:?} {to:?}");
        }
    }
}
