//! Light stays where it belongs.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use glam::{DVec3, Vec2, Vec3};
use serde_json::json;
use suite::{
    baked::Baked,
    gltf::{Glb, Material, Node},
    scenes::{closed, open},
    shape::Shape,
    tool,
};

/// Every texel of the dark room, at three densities; where the middle of the scene is not in the wall, walls pass through the cells of the irradiance cache.
#[test]
fn nothing_passes_a_wall() {
    for (thickness, density, speck) in [
        (0.0f32, "9", None),
        (0.001, "9", None),
        (0.02, "9", None),
        (0.1, "9", None),
        (0.3, "9", None),
        (0.0, "3", Some(3.1)),
        (0.1, "3", Some(3.1)),
        (0.0, "5", Some(2.7)),
        (0.02, "5", Some(2.7)),
        (0.3, "5", Some(2.7)),
        (0.0, "16", Some(2.9)),
    ] {
        let scene = match speck {
            None => closed::two_rooms(thickness),
            Some(x) => closed::rooms_beside(thickness, Vec3::new(x, 0.7, -1.7)),
        };
        let baked = tool::baked(&scene, &["--samples", "64", "--texels-per-metre", density]);
        let lit = baked.node_means()["lit room"][0].max_element();
        assert!(1.0 < lit, "wall of {thickness} m: the lit room has only {lit} nits");
        let dark = f64::from(baked.node_max("dark room"));
        println!("wall of {thickness} m, {density} texels/m: {:.2e} of the light in the dark", dark / lit);
        assert!(dark <= 1e-3 * lit, "wall of {thickness} m: {dark} nits in the dark, {lit} in the light");
    }
}

/// Cells of the irradiance cache are ten times as wide as the gap, and both sides of its edge see each other.
#[test]
fn light_in_a_gap_stays_there() {
    let light = |cache: &str| {
        let args = ["--samples", "128", "--texels-per-metre", "10", "--irradiance-cache", cache];
        tool::baked(&closed::gap_below_the_ceiling(), &args).node_means()["room"][0].max_element()
    };
    let [without, with] = ["off", "on"].map(light);
    println!("room with a gap: {:+.2} % by the cache", 100.0 * (with / without - 1.0));
    assert!((with / without - 1.0).abs() < 0.02, "{with} nits with the cache, {without} without");
}

/// Strips that stick out of a block by parts of a texel: whether a texel counts as in the open, and lights its chart, is no matter of the seed.
#[test]
fn slivers_in_the_open_are_found_whatever_the_seed() {
    let mut glb = Glb::new();
    let mut block = Shape::default();
    block.cuboid([-1.0, 0.0, -4.0], [1.0, 1.0, 4.0], suite::shape::ALL);
    let grey = glb.material(&Material::matte("grey", [0.5; 3]));
    let mesh = glb.mesh("block", &[(&block, grey)]);
    glb.node(Node::new("block").mesh(mesh));
    for i in 0..100_u16 {
        let z = -3.9 + 0.078 * f32::from(i);
        let out = 1.0 + 0.0002 * f32::from(i + 1);
        let mut strip = Shape::default();
        strip.quad(
            [[0.15, z + 0.03], [out, z + 0.03], [out, z], [0.15, z]].map(|[x, z]| Vec3::new(x, 0.5, z)),
        );
        let mesh = glb.mesh("strip", &[(&strip, grey)]);
        glb.node(Node::new("strip").mesh(mesh));
    }
    glb.scene_extra("sky", json!([1, 1, 1]));
    let scene = glb.finish();
    let counts: Vec<[u64; 2]> = ["1", "2", "3", "4", "5", "6"]
        .iter()
        .map(|seed| {
            let args = ["--samples", "8", "--texels-per-metre", "10", "--probes", "off", "--seed", seed];
            let counts = tool::baked(&scene, &args).manifest.counts;
            [counts.filled_texels, counts.black_charts]
        })
        .collect();
    println!("filled texels and black charts by seed: {counts:?}");
    // The shortest stick out by a 500th of a texel.
    assert!(0 < counts[0][0] && counts[0][1] <= 2, "{counts:?}");
    assert!(counts.iter().all(|c| *c == counts[0]), "{counts:?}");
}

/// Floor below a white body with a hole that one ray in some thousands finds: few rays say that it is dark, but it is not, and the bright floor
/// around must not flow in there. Without the hole it is dark.
#[test]
fn a_dim_crevice_keeps_its_own_light() {
    let filled = |hole: f32| {
        let mut glb = Glb::new();
        let mut floor = Shape::default();
        floor.quad([[-2.0, 2.0], [2.0, 2.0], [2.0, -2.0], [-2.0, -2.0]].map(|[x, z]| Vec3::new(x, 0.0, z)));
        let mut body = Shape::default();
        body.cuboid([-0.51, -0.1, -0.51], [0.51, 1.0, 0.51], suite::shape::NO_TOP);
        let lid: [[[f32; 2]; 2]; 4] = [
            [[-0.51, hole], [0.51, 0.51]],
            [[-0.51, -0.51], [0.51, -hole]],
            [[-0.51, -hole], [-hole, hole]],
            [[hole, -hole], [0.51, hole]],
        ];
        for [[x0, z0], [x1, z1]] in lid {
            body.quad([[x0, z1], [x1, z1], [x1, z0], [x0, z0]].map(|[x, z]| Vec3::new(x, 1.0, z)));
        }
        let white = glb.material(&Material::matte("white", [1.0; 3]));
        let sheet = glb.material(&Material::matte("sheet", [1.0; 3]).double_sided());
        let mesh = glb.mesh("floor", &[(&floor, white)]);
        glb.node(Node::new("floor").mesh(mesh));
        let mesh = glb.mesh("body", &[(&body, sheet)]);
        glb.node(Node::new("body").mesh(mesh).extras(json!({"lightmap": "off"})));
        glb.scene_extra("sky", json!([1, 1, 1]));
        let args = ["--samples", "8", "--texels-per-metre", "8", "--probes", "off"];
        tool::baked(&glb.finish(), &args).manifest.counts.filled_texels
    };
    let (dim, dark) = (filled(0.02), filled(0.0));
    println!("filled texels: {dim} of a dim floor, {dark} of a dark one");
    assert!(40 <= dark && dim * 4 <= dark, "{dim}, {dark}");
}

/// A hollow panel is seen from outside, whichever way it is wound.
#[test]
fn a_panel_wound_inwards_shows_its_outside() {
    let light = |inward: bool| {
        let args = ["--samples", "64", "--texels-per-metre", "16"];
        tool::baked(&closed::panel(inward), &args).node_means()["panel"][0]
    };
    let (outward, inward) = (light(false), light(true));
    let off = (inward - outward).abs().max_element();
    assert!(off <= 0.03 * outward.max_element(), "{outward} nits wound outwards, {inward} inwards");
}

#[test]
fn behind_an_opaque_wall_it_is_exactly_black() {
    let baked = tool::baked(&closed::lamp_in_a_box(), &["--samples", "16", "--texels-per-metre", "5"]);
    assert!(baked.triangles.iter().any(|t| t.node == "floor"));
    for c in ["R", "G", "B"] {
        assert!(baked.pages[0].channels[c].iter().all(|&v| v == 0.0), "channel {c}");
    }
}

/// Texture coordinates of a point of the floor.
fn floor_uv(baked: &Baked, at: Vec3) -> Option<Vec2> {
    baked.triangles.iter().filter(|t| t.node == "floor").find_map(|t| {
        let [a, b, c] = t.positions;
        let area = (b - a).cross(c - a);
        let part = |p: Vec3, q: Vec3| (q - p).cross(at - p).dot(area) / area.length_squared();
        let w = Vec3::new(part(b, c), part(c, a), part(a, b));
        (-1e-5 <= w.min_element()).then(|| t.uvs[0] * w.x + t.uvs[1] * w.y + t.uvs[2] * w.z)
    })
}

#[test]
fn a_box_on_the_floor_has_no_dark_rim() {
    let baked = tool::baked(&open::box_on_floor(), &["--samples", "256", "--texels-per-metre", "11"]);
    let turn = glam::Quat::from_rotation_y(0.3);
    // What stands on a plane hides at most half of the sky, and sends back a part of what it hides.
    let least = 0.5;
    let outside = |p: DVec3| {
        let local = turn.inverse() * p.as_vec3();
        0.5 < local.x.abs().max(local.z.abs())
    };
    let clear = baked
        .cases(|piece| piece.node == "floor" && piece.points.iter().all(|p| outside(p.0)), |_, _| DVec3::ONE);
    assert!(3 * 1000 < clear.len());
    for c in &clear {
        assert!(least - 5.0 * c.std_err <= c.got && c.got <= 1.02 + 5.0 * c.std_err, "{c:?}");
    }
    // A millimetre beside the box the interpolated picture must not show what lies under it.
    for i in 0..400u16 {
        let along = f32::from(i % 100) / 99.0 - 0.5;
        let side = glam::Quat::from_rotation_y(std::f32::consts::FRAC_PI_2 * f32::from(i / 100));
        let at = turn * (side * Vec3::new(0.501, 0.0, along));
        let uv = floor_uv(&baked, at).unwrap_or_else(|| panic!("{at} is not on the floor"));
        let value = baked.bilinear(uv);
        assert!(least - 0.08 <= f64::from(value.min_element()), "{value} at {at}");
    }
}
