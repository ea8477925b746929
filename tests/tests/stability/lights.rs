//! Lights that break careless code.

use crate::Group;
use crate::whole::{all_are, bake, mean, off, points, sanity};
use glam::{DVec3, Vec3, dvec3};
use serde_json::json;
use std::f32::consts::{FRAC_PI_2, PI};
use suite::gltf::{Glb, Kind, Material, Node, looking};
use suite::scenes::open;
use suite::shape::{ALL, Shape};

const UP: [f64; 3] = [0.0, 1.0, 0.0];

const ALONE: [&str; 4] = ["--samples", "16", "--bounces", "0"];

/// A floor of 4 m and point lamps.
fn lamps(all: &[(Vec3, f32)]) -> Vec<u8> {
    let mut glb = Glb::new();
    let grey = glb.material(&Material::matte("grey", [0.5; 3]));
    let mut s = Shape::default();
    s.grid(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0, 1, 1);
    let mesh = glb.mesh("floor", &[(&s, grey)]);
    glb.node(Node::new("floor").mesh(mesh));
    let mut of = std::collections::BTreeMap::new();
    for (k, (at, candela)) in all.iter().enumerate() {
        let light = *of
            .entry(candela.to_bits())
            .or_insert_with(|| glb.light("lamp", Kind::Point, [1.0; 3], *candela));
        let mut node = Node::new(&format!("lamp {k}")).at(*at);
        node.light = Some(light);
        glb.node(node);
    }
    glb.finish()
}

/// Irradiance of lamps on a plane that faces up, closed form.
fn exact(all: &[(Vec3, f32)], p: DVec3) -> f64 {
    let one = |(at, candela): &(Vec3, f32)| {
        let d = at.as_dvec3() - p;
        f64::from(*candela) * d.y.max(0.0) / d.length().powi(3)
    };
    all.iter().map(one).sum()
}

/// Numbers in (0, 1) that are the same every time.
fn halton(i: usize, base: usize) -> f32 {
    let (mut i, mut f, mut out) = (i + 1, 1.0, 0.0);
    while 0 < i {
        f /= base as f32;
        out += f * (i % base) as f32;
        i /= base;
    }
    out
}

fn spread(n: usize, low: Vec3, high: Vec3, candela: f32) -> Vec<(Vec3, f32)> {
    let at = |i| low + (high - low) * Vec3::new(halton(i, 2), halton(i, 3), halton(i, 5));
    (0..n).map(|i| (at(i), candela)).collect()
}

pub(crate) fn group() -> Group {
    let mut group = Group::new("lights");
    near(&mut group);
    many(&mut group);
    shapes(&mut group);
    group
}

fn near(group: &mut Group) {
    group.add("a receiver in the very place of a lamp has none of its light", 0.0, || {
        let got = points(&lamps(&[(Vec3::Y, 1.0)]), &[[[0.0, 1.0, 0.0], UP]], &ALONE);
        if got[0][0].is_finite() { got[0][0].abs().max_element() } else { f64::INFINITY }
    });
    for height in [1e-3f32, 1e-4] {
        group.add(format!("a lamp {height:e} m over the plane of receivers"), 1e-5, move || {
            let all = [(Vec3::new(0.0, height, 0.0), 1.0)];
            let at = [[0.1, 0.0, 0.0], [0.5, 0.0, 0.5]];
            let got = points(&lamps(&all), &at.map(|p| [p, UP]), &ALONE);
            got.iter().zip(at).map(|(g, p)| off(g[0].x, exact(&all, p.into()))).fold(0.0, f64::max)
        });
    }
    for height in [1e-6f32, 1e-12, 1e-19] {
        group.add(format!("a lamp {height:e} m straight above a point in the air"), 1e-3, move || {
            let up = f64::from(height);
            // Away from the floor, around the world's middle, where coordinates are finest.
            let all = [(Vec3::new(0.0, height, 0.0), height * height)];
            let got = points(&lamps(&all), &[[[0.0, 0.0, 0.0], UP]], &ALONE);
            let e = got[0][0].x;
            // Rays start off the floor: nearer than that there is no answer but a finite one.
            if up < 1e-5 { if e.is_finite() && 0.0 <= e { 0.0 } else { f64::INFINITY } } else { off(e, 1.0) }
        });
    }
    group.add("a lamp on a floor, in its plane and an ulp above and below", 0.0, || {
        let heights = [0.0, 1e-45, -1e-45, 1e-7, -1e-7];
        let worst = heights.map(|h| {
            let scene = lamps(&[(Vec3::new(0.3, h, 0.2), 1.0)]);
            sanity(&bake(&scene, &["--samples", "4", "--texels-per-metre", "4"]))
        });
        worst.into_iter().fold(0.0, f64::max)
    });
    group.add("a lamp on a vertex of the floor", 0.0, || {
        sanity(&bake(
            &lamps(&[(Vec3::new(2.0, 0.0, 2.0), 1.0)]),
            &["--samples", "4", "--texels-per-metre", "4"],
        ))
    });
    group.add("a lamp in a closed box shines on nothing outside", 0.0, || {
        let mut glb = Glb::new();
        let grey = glb.material(&Material::matte("grey", [0.5; 3]));
        let mut s = Shape::default();
        s.cuboid([-0.5; 3], [0.5; 3], ALL);
        let mesh = glb.mesh("box", &[(&s, grey)]);
        glb.node(Node::new("box").mesh(mesh));
        let mut node = Node::new("lamp");
        node.light = Some(glb.light("lamp", Kind::Point, [1.0; 3], 1e6));
        glb.node(node);
        let towards = |p: [f64; 3]| [p, (-DVec3::from(p)).normalize().to_array()];
        // In front of faces, edges and corners of the box.
        let at = [[2.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0.6, 0.6, 0.6], [0.51, 0.0, 0.0]]
            .map(towards);
        points(&glb.finish(), &at, &ALONE).iter().map(|p| p[0].abs().max_element()).sum::<f64>()
    });
    group.add("a lamp in the plane of a wall lights both sides or neither", 1e-5, || {
        let mut glb = Glb::new();
        let grey = glb.material(&Material::matte("grey", [0.0; 3]).double_sided());
        let mut s = Shape::default();
        s.quad([Vec3::ZERO, Vec3::Z, Vec3::new(0.0, 2.0, 1.0), Vec3::Y * 2.0].map(|v| v - Vec3::Z * 0.5));
        let mesh = glb.mesh("wall", &[(&s, grey)]);
        glb.node(Node::new("wall").mesh(mesh));
        let mut node = Node::new("lamp").at([0.0, 1.0, 0.25]);
        node.light = Some(glb.light("lamp", Kind::Point, [1.0; 3], 1.0));
        glb.node(node);
        let all = [(Vec3::new(0.0, 1.0, 0.25), 1.0)];
        let at = [[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.1, 0.5, 0.0], [-0.1, 0.5, 0.0]];
        let got = points(&glb.finish(), &at.map(|p| [p, UP]), &ALONE);
        let one = |(g, p): (&[DVec3; 2], [f64; 3])| off(g[0].x, exact(&all, p.into())).min(off(g[0].x, 0.0));
        got.iter().zip(at).map(one).fold(0.0, f64::max)
    });
}

fn many(group: &mut Group) {
    for mode in ["auto", "grid"] {
        group.add(format!("100000 lamps in one place are one, {mode}"), 1e-5, move || {
            let all = vec![(Vec3::new(0.2, 1.0, 0.3), 1.0 / 1e5); 100_000];
            let at = [[0.0, 0.0, 0.0], [1.0, 0.0, -1.0]];
            let got = points(&lamps(&all), &at.map(|p| [p, UP]), &[&ALONE[..], &["--direct", mode]].concat());
            let one = [(Vec3::new(0.2, 1.0, 0.3), 1.0)];
            got.iter().zip(at).map(|(g, p)| off(g[0].x, exact(&one, p.into()))).fold(0.0, f64::max)
        });
    }
    // A hierarchy is not exact, but the dim ones must not take from the bright one, nor it from them.
    group.add("1e12 between the brightest and the dimmest lamp, grid", 1e-2, || {
        let mut all = spread(200, Vec3::new(-2.0, 0.5, -2.0), Vec3::new(2.0, 2.0, 2.0), 1e-6);
        all.push((Vec3::new(0.5, 1.5, 0.0), 1e6));
        let at = [[0.0, 0.0, 0.0], [1.0, 0.0, -1.0]];
        let got = points(&lamps(&all), &at.map(|p| [p, UP]), &[&ALONE[..], &["--direct", "grid"]].concat());
        got.iter().zip(at).map(|(g, p)| off(g[0].x, exact(&all, p.into()))).fold(0.0, f64::max)
    });
    group.add("a lamp a tenth of a millimetre above a floor, among 200 others, grid", 1e-2, || {
        let mut all = spread(200, Vec3::new(-2.0, 0.5, -2.0), Vec3::new(2.0, 2.0, 2.0), 1.0);
        all.push((Vec3::new(0.0, 1e-4, 0.0), 1.0));
        let at = [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [1.0, 0.0, -1.0]];
        let got = points(&lamps(&all), &at.map(|p| [p, UP]), &[&ALONE[..], &["--direct", "grid"]].concat());
        got.iter().zip(at).map(|(g, p)| off(g[0].x, exact(&all, p.into()))).fold(0.0, f64::max)
    });
    for mode in ["lightcuts", "published", "all"] {
        group.add(format!("1e12 between the brightest and the dimmest lamp, {mode}"), 1e-6, move || {
            let mut all = spread(200, Vec3::new(-2.0, 0.5, -2.0), Vec3::new(2.0, 2.0, 2.0), 1e-6);
            all.push((Vec3::new(0.5, 1.5, 0.0), 1e6));
            let at = [[0.0, 0.0, 0.0], [1.0, 0.0, -1.0]];
            let got = points(&lamps(&all), &at.map(|p| [p, UP]), &[&ALONE[..], &["--direct", mode]].concat());
            got.iter().zip(at).map(|(g, p)| off(g[0].x, exact(&all, p.into()))).fold(0.0, f64::max)
        });
        group.add(
            format!("a receiver within the box of every node of lamps, {mode}, standard errors"),
            5.0,
            move || {
                let all = spread(500, Vec3::new(-1.0, -1.0, -1.0), Vec3::ONE, 1.0);
                // Without a floor between them: a speck far off.
                let mut glb = Glb::new();
                let black = glb.material(&Material::matte("black", [0.0; 3]));
                let mut s = Shape::default();
                s.polygon(&[Vec3::ZERO, Vec3::X * 0.01, Vec3::Y * 0.01]);
                let mesh = glb.mesh("speck", &[(&s, black)]);
                glb.node(Node::new("speck").mesh(mesh).at([5.0, 0.0, 0.0]));
                let light = glb.light("lamp", Kind::Point, [1.0; 3], 1.0);
                for (k, (at, _)) in all.iter().enumerate() {
                    let mut node = Node::new(&format!("lamp {k}")).at(*at);
                    node.light = Some(light);
                    glb.node(node);
                }
                let at = [0.01, 0.02, 0.03];
                let args = ["--samples", "8192", "--bounces", "0", "--direct", mode];
                let [got, error] = points(&glb.finish(), &[[at, UP]], &args)[0];
                let want = exact(&all, at.into());
                // Exhaustive sampling has no error but rounding.
                (got.x - want).abs() / (error.x + 1e-5 * want)
            },
        );
    }
    group.add("three lamps of which a wall hides the one that is 1e12 as bright", 1e-5, || {
        let mut glb = Glb::new();
        let grey = glb.material(&Material::matte("grey", [0.0; 3]).double_sided());
        let mut s = Shape::default();
        s.grid(Vec3::new(-0.5, 2.0, 0.5), Vec3::X, Vec3::NEG_Z, 1, 1);
        let mesh = glb.mesh("wall", &[(&s, grey)]);
        glb.node(Node::new("wall").mesh(mesh));
        let all = [(Vec3::new(0.5, 1.0, 0.0), 1e-6), (Vec3::new(-0.5, 1.0, 0.2), 2e-6), (Vec3::Y * 2.1, 1e6)];
        for (k, (at, candela)) in all.iter().enumerate() {
            let mut node = Node::new(&format!("lamp {k}")).at(*at);
            node.light = Some(glb.light("lamp", Kind::Point, [1.0; 3], *candela));
            glb.node(node);
        }
        let got = points(&glb.finish(), &[[[0.0; 3], UP]], &ALONE);
        off(got[0][0].x, exact(&all[..2], DVec3::ZERO))
    });
    for mode in ["auto", "lightcuts", "published", "grid"] {
        group.add(format!("one lamp among 99 black ones, {mode}"), 1e-5, move || {
            let mut all = spread(99, Vec3::new(-2.0, 0.5, -2.0), Vec3::new(2.0, 2.0, 2.0), 0.0);
            all.push((Vec3::new(0.5, 1.5, 0.0), 3.0));
            let got = points(&lamps(&all), &[[[0.0; 3], UP]], &[&ALONE[..], &["--direct", mode]].concat());
            off(got[0][0].x, exact(&all, DVec3::ZERO))
        });
    }
    group.add("nothing but black lamps", 0.0, || {
        let all = spread(20, Vec3::new(-2.0, 0.5, -2.0), Vec3::new(2.0, 2.0, 2.0), 0.0);
        let got = points(&lamps(&all), &[[[0.0; 3], UP]], &ALONE);
        let e = got[0][0];
        // Black, or the sky of 1 nit that scenes without any light have, with the noise of 16 paths.
        let sky = DVec3::splat(std::f64::consts::PI);
        if e == DVec3::ZERO || (e / sky - 1.0).abs().max_element() < 0.1 { 0.0 } else { f64::INFINITY }
    });
    for candela in [1e-30f32, 1e30] {
        group.add(format!("a lamp of {candela:e} cd"), 1e-5, move || {
            let all = [(Vec3::Y, candela)];
            let got = points(&lamps(&all), &[[[0.5, 0.0, 0.0], UP]], &ALONE);
            off(got[0][0].x, exact(&all, dvec3(0.5, 0.0, 0.0)))
        });
    }
}

fn shapes(group: &mut Group) {
    let ulp = 0.5f32.next_up();
    for (name, inner, outer) in [
        ("equal cones", 0.5, 0.5),
        ("cones an ulp apart", 0.5, ulp),
        ("cones an ulp the wrong way round", ulp, 0.5),
        ("cones of 0 and 90 degrees", 0.0, FRAC_PI_2),
        ("cones an ulp below 90 degrees", FRAC_PI_2.next_down().next_down(), FRAC_PI_2.next_down()),
    ] {
        group.add(format!("a spot with {name}, on its axis, and behind it"), 1e-5, move || {
            let scene = open::under_spot(1.0, 2.0, inner, outer);
            let at = [[[0.0; 3], UP], [[0.0, 1.5, 0.0], [0.0, -1.0, 0.0]], [[1.9, 0.0, 0.0], UP]];
            let got = points(&scene, &at, &ALONE);
            let beyond = if outer < 1.0 { got[2][0].x.abs() } else { 0.0 };
            off(got[0][0].x, 2.0).max(got[1][0].x.abs()).max(beyond)
        });
    }
    // A hemisphere of even radiance has half of the irradiance of a beam of the same lux.
    for (diameter, part, tolerance) in [(0.0f32, 1.0, 1e-6), (1e-30, 1.0, 1e-6), (180.0, 0.5, 2e-3)] {
        group.add(format!("a sun {diameter:e} degrees wide"), tolerance, move || {
            let scene = open::under_sun(PI, Vec3::NEG_Y, diameter);
            let got = points(&scene, &[[[0.0; 3], UP]], &["--samples", "4096", "--bounces", "0"]);
            off(got[0][0].x, std::f64::consts::PI * part)
        });
    }
    group.add("a sun along the floor, an ulp above and below", 1e-6, || {
        let slopes = [0.0, f32::EPSILON, -f32::EPSILON, -1e-38];
        let worst = slopes.map(|y| {
            let got = points(&open::under_sun(1.0, Vec3::new(1.0, y, 0.0), 0.0), &[[[0.0; 3], UP]], &ALONE);
            let e = got[0][0].x;
            if e.is_finite() && 0.0 <= e { e } else { f64::INFINITY }
        });
        worst.into_iter().fold(0.0, f64::max)
    });
    group.add("an emitter that lies in the plane of its receiver", 1e-6, || {
        let mut glb = Glb::new();
        let grey = glb.material(&Material::matte("grey", [0.5; 3]));
        let glow = glb.material(&Material::matte("glow", [0.0; 3]).emitting([1.0; 3]));
        let mut s = Shape::default();
        s.grid(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z, 1, 1);
        let floor = glb.mesh("floor", &[(&s, grey)]);
        let lamp = glb.mesh("lamp", &[(&s, glow)]);
        glb.node(Node::new("floor").mesh(floor));
        glb.node(Node::new("lamp").mesh(lamp).at([1.0, 0.0, 0.0]));
        let baked = bake(&glb.finish(), &["--samples", "8", "--texels-per-metre", "8"]);
        baked.node_means()["floor"][0].max_element().max(sanity(&baked))
    });
    group.add("an emitter that touches its receiver at a right angle", 0.0, || {
        let mut glb = Glb::new();
        let grey = glb.material(&Material::matte("grey", [0.0; 3]));
        let glow = glb.material(&Material::matte("glow", [0.0; 3]).emitting([1.0; 3]));
        let mut s = Shape::default();
        s.grid(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z, 1, 1);
        let floor = glb.mesh("floor", &[(&s, grey)]);
        let lamp = glb.mesh("lamp", &[(&s, glow)]);
        glb.node(Node::new("floor").mesh(floor));
        glb.node(Node::new("lamp").mesh(lamp).at([0.0, 0.5, -0.5]).turned(looking(Vec3::NEG_Y)));
        let baked = bake(&glb.finish(), &["--samples", "32", "--texels-per-metre", "16"]);
        // No texel has more than half of the hemisphere.
        let most = f64::from(baked.node_max("floor"));
        if mean(&baked) <= 0.5 && most <= 0.55 { sanity(&baked) } else { most }
    });
    for (name, scale) in [("1e-12", 1e-12f32), ("1e12", 1e12)] {
        group.add(format!("a sky of {name} nits"), 1e-5, move || {
            let mut glb = Glb::new();
            let grey = glb.material(&Material::matte("grey", [0.5; 3]));
            let mut s = Shape::default();
            s.grid(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z, 1, 1);
            let mesh = glb.mesh("floor", &[(&s, grey)]);
            glb.node(Node::new("floor").mesh(mesh));
            glb.scene_extra("sky", json!([scale, scale, scale]));
            all_are(&bake(&glb.finish(), &["--samples", "4", "--texels-per-metre", "4"]), f64::from(scale))
        });
    }
}
