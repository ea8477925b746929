//! Geometry that breaks careless code.

use crate::Group;
use crate::whole::{all_are, bake, mean_is, off, points, sanity};
use glam::Vec3;
use serde_json::json;
use std::sync::LazyLock;
use suite::baked::Baked;
use suite::gltf::{Glb, Kind, Material, Node};
use suite::scenes::{closed, hard, open};
use suite::shape::Shape;

/// A floor of 1 m and what `more` adds, under a sky of 1 nit: nothing shadows the floor, so all of it has 1.
fn under_sky(more: impl Fn(&mut Glb, usize)) -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.5; 3]));
    let mesh = glb.mesh("floor", &[(&floor(), white)]);
    glb.node(Node::new("floor").mesh(mesh));
    more(&mut glb, white);
    glb.scene_extra("sky", json!([1, 1, 1]));
    glb.finish()
}

fn floor() -> Shape {
    let mut s = Shape::default();
    s.grid(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z, 1, 1);
    s
}

const FEW: [&str; 4] = ["--samples", "4", "--texels-per-metre", "8"];

pub(crate) fn group() -> Group {
    let mut group = Group::new("geometry");
    triangles(&mut group);
    sizes(&mut group);
    walls(&mut group);
    matrices(&mut group);
    edges(&mut group);
    group
}

fn with(shape: impl Fn() -> Shape + Send + Sync + 'static) -> impl Fn() -> f64 {
    move || {
        let shape = shape();
        let scene = under_sky(|glb, white| {
            let mesh = glb.mesh("more", &[(&shape, white)]);
            glb.node(Node::new("more").mesh(mesh));
        });
        all_are(&bake(&scene, &FEW), 1.0)
    }
}

fn triangles(group: &mut Group) {
    group.add(
        "triangles without area beside a floor",
        1e-5,
        with(|| {
            let mut s = floor();
            s.triangles.extend([[0, 0, 0], [0, 1, 1], [0, 3, 0], [2, 2, 2]]);
            // Collinear, and needles whose width is below what coordinates tell apart.
            s.positions.extend([Vec3::ZERO, Vec3::X * 0.25, Vec3::X * 0.5, Vec3::new(0.25, 0.0, 1e-30)]);
            s.normals.extend([Vec3::Y; 4]);
            s.triangles.extend([[4, 5, 6], [4, 6, 7], [7, 5, 4]]);
            s
        }),
    );
    group.add(
        "a triangle whose sides are 1e-30 m",
        1e-5,
        with(|| {
            let mut s = floor();
            s.positions.extend([Vec3::ZERO, Vec3::X * 1e-30, Vec3::NEG_Z * 1e-30]);
            s.normals.extend([Vec3::Y; 3]);
            s.triangles.push([4, 5, 6]);
            s
        }),
    );
    group.add("the same floor 33 times in one place", 1e-5, || {
        let scene = under_sky(|glb, white| {
            let mesh = glb.mesh("copy", &[(&floor(), white)]);
            for k in 0..32 {
                glb.node(Node::new(&format!("copy {k}")).mesh(mesh));
            }
        });
        all_are(&bake(&scene, &["--samples", "2", "--texels-per-metre", "4"]), 1.0)
    });
    for (name, normal) in [
        ("turned to the back", Vec3::NEG_Y),
        ("in the plane", Vec3::X),
        ("an ulp off the plane", Vec3::new(1.0, f32::EPSILON, 0.0)),
        ("an ulp behind the plane", Vec3::new(1.0, -f32::EPSILON, 0.0)),
    ] {
        group.add(
            format!("vertex normals {name}"),
            1e-4,
            with(move || {
                let mut s = floor();
                s.normals.fill(normal);
                s
            }),
        );
    }
    group.add("triangles wound the other way round", 1e-5, || {
        let mut s = floor();
        s.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        let scene = under_sky(|glb, white| {
            let mesh = glb.mesh("back", &[(&s, white)]);
            glb.node(Node::new("back").mesh(mesh).at([2.0, 0.0, 0.0]));
        });
        all_are(&bake(&scene, &FEW), 1.0)
    });
}

static ONE: LazyLock<Baked> = LazyLock::new(|| sized(1.0, Vec3::ZERO));

fn sized(size: f32, offset: Vec3) -> Baked {
    let density = (12.0 / size).to_string();
    bake(&hard::sized(size, offset), &["--samples", "64", "--texels-per-metre", &density])
}

fn sizes(group: &mut Group) {
    // Not a power of two from one another, so that other texels and other rounding are met.
    for (size, far) in [(1e-6, 0.0), (1e-3, 0.0), (1e5, 0.0), (1e7, 0.0), (16.0, 1e5), (1e3, -1e7)] {
        group.add(
            format!("a scene of {size:e} m, {far:e} m from the origin, against one of 1 m"),
            2e-3,
            move || {
                let other = sized(size, Vec3::new(far, 0.0, -far));
                let (a, b) = (ONE.node_means(), other.node_means());
                let worst = a.iter().map(|(node, [mean, _])| (b[node][0] / *mean - 1.0).abs().max_element());
                worst.fold(sanity(&other), f64::max)
            },
        );
    }
    group.add("a floor of 1 m with a speck 1e6 m away", 1e-5, || {
        let scene = under_sky(|glb, white| {
            let mut s = Shape::default();
            s.polygon(&[Vec3::ZERO, Vec3::X, Vec3::Y]);
            let mesh = glb.mesh("speck", &[(&s, white)]);
            let node = Node::new("speck").mesh(mesh).at([1e6, 0.0, 0.0]).extras(json!({"lightmap": "off"}));
            glb.node(node);
        });
        all_are(&bake(&scene, &FEW), 1.0)
    });
}

fn walls(group: &mut Group) {
    for thickness in [0.0f32, 1e-6, 1e-4] {
        group.add(
            format!("light through a wall {thickness:e} m thick, over that before it"),
            1e-4,
            move || {
                let baked =
                    bake(&closed::two_rooms(thickness), &["--samples", "16", "--texels-per-metre", "4"]);
                let lit = baked.node_means()["lit room"][0].max_element();
                (f64::from(baked.node_max("dark room")) / lit).max(sanity(&baked))
            },
        );
    }
    for (name, back) in [("front", false), ("back", true)] {
        group.add(format!("a one-sided sheet whose {name} is lit shadows"), 0.0, move || {
            let mut glb = Glb::new();
            let white = glb.material(&Material::matte("white", [0.5; 3]));
            let mut s = Shape::default();
            s.grid(Vec3::new(-1.0, 0.5, 1.0), Vec3::X * 2.0, Vec3::NEG_Z * 2.0, 1, 1);
            if back {
                s = s.inside_out();
            }
            let mesh = glb.mesh("sheet", &[(&s, white)]);
            glb.node(Node::new("sheet").mesh(mesh));
            let mut node = Node::new("lamp").at([0.0, 1.0, 0.0]);
            node.light = Some(glb.light("lamp", Kind::Point, [1.0; 3], 1.0));
            glb.node(node);
            // Without bounces: light that the sheet reflects has no way down either.
            let at = [[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0.3, 0.499, 0.2], [0.0, 1.0, 0.0]]];
            points(&glb.finish(), &at, &["--samples", "16"])
                .into_iter()
                .map(|p| p[0].abs().max_element())
                .sum::<f64>()
        });
    }
}

fn matrices(group: &mut Group) {
    let scales = [
        [-1.0, 1.0, 1.0],
        [1.0, -1.0, 1.0],
        [-1.0, -1.0, -1.0],
        [1.0, 1.0, 0.0],
        [0.0, 0.0, 0.0],
        [1e-30, 1e-30, 1e-30],
        [1.0, 1e30, 1.0],
    ];
    for scale in scales {
        group.add(format!("a node scaled by {scale:?}"), 1e-5, move || {
            let scene = under_sky(|glb, white| {
                let mesh = glb.mesh("scaled", &[(&floor(), white)]);
                glb.node(Node::new("scaled").mesh(mesh).at([2.0, 0.0, 0.0]).scaled(scale));
            });
            let baked = bake(&scene, &FEW);
            // What has no area in the world may stay black; the floor has all of the sky.
            let floor = baked.node_means()["floor"][0];
            (floor - 1.0).abs().max_element().max(sanity(&baked))
        });
    }
}

fn edges(group: &mut Group) {
    for density in [4.0f32, 4f32.next_up(), 4f32.next_down()] {
        group.add(
            format!("edges of triangles on corners of texels, {density:?} texels a metre"),
            1e-5,
            move || {
                let text = density.to_string();
                let baked = bake(
                    &open::under_sky(4.0, 16, [1.0; 3]),
                    &["--samples", "2", "--texels-per-metre", &text],
                );
                let page = &baked.pages[0];
                let outside = page.channels["A"].iter().any(|a| !(0.0..=1.0).contains(a));
                if outside { f64::INFINITY } else { all_are(&baked, 1.0) }
            },
        );
    }
    group.add("points a few ulps above and below a floor", 1e-5, || {
        let scene = open::under_point(1.0, [1.0; 3]);
        let heights = [0.0, 1e-20, -1e-20, 1e-7, -1e-7];
        let at: Vec<_> = heights.iter().map(|y| [[0.25, *y, 0.0], [0.0, 1.0, 0.0]]).collect();
        let got = points(&scene, &at, &["--samples", "1", "--bounces", "0"]);
        let want = (1.0f64 + 0.0625).powf(-1.5);
        got.iter().map(|p| off(p[0].x, want)).fold(0.0, f64::max)
    });
    group.add("points on the edges and corners of a floor", 1e-5, || {
        let scene = open::under_point(1.0, [1.0; 3]);
        let places = [
            [2.0, 2.0],
            [-2.0, 2.0],
            [2.0, 0.0],
            [f64::from(2f32.next_down()), 0.0],
            [f64::from(2f32.next_up()), 0.0],
        ];
        let at: Vec<_> = places.iter().map(|[x, z]| [[*x, 0.0, *z], [0.0, 1.0, 0.0]]).collect();
        let got = points(&scene, &at, &["--samples", "1", "--bounces", "0"]);
        let want = |[x, z]: [f64; 2]| (1.0 + x * x + z * z).powf(-1.5);
        got.iter().zip(places).map(|(p, at)| off(p[0].x, want(at))).fold(0.0, f64::max)
    });
    group.add("a point's normal in the plane, an ulp above and below it", 1e-5, || {
        let scene = open::under_point(1.0, [1.0; 3]);
        let tiny = f64::from(f32::EPSILON);
        let at = [0.0, tiny, -tiny].map(|y| [[0.0, 0.0, 0.0], [1.0, y, 0.0]]);
        let got = points(&scene, &at, &["--samples", "1", "--bounces", "0"]);
        let fault = got.iter().any(|p| !p[0].is_finite() || p[0].min_element() < 0.0);
        if fault { f64::INFINITY } else { got.iter().map(|p| p[0].x).fold(0.0, f64::max) }
    });
    group.add("texels that reach round the corners of a closed cube", 2e-3, || {
        mean_is(&bake(&closed::furnace(0.5, 1.0), &["--samples", "64", "--texels-per-metre", "31"]), 2.0)
    });
    group.add("a point among nothing but triangles without area", 1e-5, || {
        let mut glb = Glb::new();
        let white = glb.material(&Material::matte("white", [0.5; 3]));
        let mut s = floor();
        s.positions.fill(Vec3::ONE);
        let mesh = glb.mesh("nothing", &[(&s, white)]);
        glb.node(Node::new("nothing").mesh(mesh));
        let at = [[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]];
        let got = points(&glb.finish(), &at, &["--samples", "16", "--sky", "1"]);
        off(got[0][0].x, std::f64::consts::PI)
    });
}
