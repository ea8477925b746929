//! The runtime sample shows what was baked, from the folder alone: light on surfaces, probes and fog against what the files say and
//! what closed forms say.

#![expect(clippy::unwrap_used, reason = "a test may panic")]
#![expect(clippy::print_stdout, reason = "figures that are reported")]

use std::{f64::consts::PI, path::Path};

use glam::{DVec3, Vec2, Vec3};
use serde_json::json;
use suite::{
    baked::{Baked, Page, Triangle},
    gltf::{Glb, Id, Kind, Material, Node},
    graphics,
    shape::{ALL, Shape},
    tool,
};
use tables::format::manifest::LightMode;

/// Pixels of the pictures.
const SIZE: [usize; 2] = [320, 180];

/// Where a picture is taken from.
#[derive(Clone, Copy)]
struct Eye {
    at: Vec3,
    to: Vec3,
    yfov: f32,
}

impl Eye {
    fn add(self, glb: &mut Glb) {
        glb.camera("eye", self.at, self.to, self.yfov);
    }

    /// The direction of the middle of a pixel, 1 m ahead.
    fn ray(self, x: usize, y: usize) -> Vec3 {
        let ahead = (self.to - self.at).normalize();
        let right = ahead.cross(Vec3::Y).normalize();
        let up = right.cross(ahead);
        let half = (0.5 * self.yfov).tan();
        let part = |i: usize, n: usize| (i as f32 + 0.5) / n as f32 * 2.0 - 1.0;
        let wide = half * SIZE[0] as f32 / SIZE[1] as f32;
        ahead + right * (part(x, SIZE[0]) * wide) - up * (part(y, SIZE[1]) * half)
    }
}

/// A scene that was baked into `out` of a folder.
struct Shown {
    dir: tempfile::TempDir,
    baked: Baked,
}

fn bake(scene: &[u8], args: &[&str]) -> Shown {
    let dir = tool::folder_with(scene);
    let first = ["run", "scene.glb", "-o", "out", "--progress", "none"];
    let _ = tool::bake(&[&first[..], args].concat(), dir.path()).expect(0);
    let baked = Baked::read(&dir.path().join("out")).unwrap();
    Shown { dir, baked }
}

impl Shown {
    /// Radiance that reaches the eye, nits.
    fn picture(&self, args: &[&str]) -> Page {
        picture(self.dir.path(), "out", args)
    }
}

fn picture(dir: &Path, bake: &str, args: &[&str]) -> Page {
    let first = [bake, "--screenshot", "view.exr", "--size", "320x180"];
    let mut all = [&first[..], args].concat();
    for (name, value) in [("--pages", "exr"), ("--antialias", "1")] {
        if !args.contains(&name) {
            all.extend([name, value]);
        }
    }
    let _ = graphics::show(&all, dir).expect(0);
    let page = Page::read(&dir.join("view.exr")).unwrap();
    assert_eq!([page.width, page.height], SIZE);
    page
}

/// Distance and corner weights of the first triangle on a ray.
fn meet(t: &Triangle, from: Vec3, d: Vec3) -> Option<(f32, Vec3)> {
    let [a, b, c] = t.positions;
    let (u, v) = (b - a, c - a);
    let p = d.cross(v);
    let det = u.dot(p);
    let q = (from - a).cross(u);
    let (x, y) = ((from - a).dot(p) / det, d.dot(q) / det);
    let inside = 0.0 < det && 0.0 <= x && 0.0 <= y && x + y <= 1.0;
    let distance = v.dot(q) / det;
    (inside && 0.0 < distance).then_some((distance, Vec3::new(1.0 - x - y, x, y)))
}

/// The place of a pixel on the first triangle, and where it is on the page.
fn seen(baked: &Baked, eye: Eye, x: usize, y: usize) -> Option<(Vec3, Vec2)> {
    let d = eye.ray(x, y);
    let hits = baked.triangles.iter().filter_map(|t| meet(t, eye.at, d).map(|(r, w)| (r, w, t)));
    let (r, w, t) = hits.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some((eye.at + d * r, t.uvs[0] * w.x + t.uvs[1] * w.y + t.uvs[2] * w.z))
}

fn lamp(glb: &mut Glb, kind: Kind, color: [f32; 3], strength: f32, node: Node) -> Id {
    let light = glb.light("lamp", kind, color, strength);
    glb.node(Node { light: Some(light), ..node })
}

/// A white wall by a lamp: each pixel has the luminance that the lightmap has there, to the precision of interpolation on the card.
#[test]
fn a_white_wall_has_the_luminance_of_its_lightmap() {
    if !graphics::available("a_white_wall_has_the_luminance_of_its_lightmap") {
        return;
    }
    let eye = Eye { at: Vec3::new(0.4, 1.2, 3.0), to: Vec3::new(0.2, 1.0, 0.0), yfov: 0.9 };
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [1.0; 3]));
    let mut wall = Shape::default();
    wall.grid(Vec3::new(-4.0, -1.0, 0.0), Vec3::X * 8.0, Vec3::Y * 4.0, 2, 2);
    let mesh = glb.mesh("wall", &[(&wall, white)]);
    glb.node(Node::new("wall").mesh(mesh));
    lamp(&mut glb, Kind::Point, [1.0, 0.6, 0.3], 300.0, Node::new("lamp").at([0.5, 1.5, 1.0]));
    eye.add(&mut glb);
    let shown = bake(&glb.finish(), &["--samples", "16", "--texels-per-metre", "8", "--texture", "rgba16f"]);
    for (source, bound) in [("exr", 2e-4), ("ktx2", 1e-3)] {
        let got = shown.picture(&["--no-balls", "--pages", source]);
        let (mut worst, mut n) = (0.0f32, 0);
        for y in 0..SIZE[1] {
            for x in 0..SIZE[0] {
                let Some((_, uv)) = seen(&shown.baked, eye, x, y) else { continue };
                let want = shown.baked.bilinear(uv);
                worst = worst.max(((got.rgb("", x, y) - want) / want).abs().max_element());
                n += 1;
            }
        }
        println!("{n} pixels of {source}: at most {worst:.1e} beside the lightmap");
        assert!(SIZE[0] * SIZE[1] / 2 < n && worst < bound, "{worst} of {source}");
    }
}

/// A cube whose walls reflect and emit: all that is in it looks alike.
fn furnace(fog: Option<serde_json::Value>) -> Vec<u8> {
    let mut glb = Glb::new();
    let wall = glb.material(&Material::matte("wall", [0.5; 3]).emitting([1.0; 3]));
    let mut cube = Shape::default();
    cube.cuboid([-0.5; 3], [0.5; 3], ALL);
    let mesh = glb.mesh("furnace", &[(&cube.inside_out(), wall)]);
    glb.node(Node::new("furnace").mesh(mesh));
    Eye { at: Vec3::new(0.3, 0.2, 0.45), to: Vec3::new(-0.1, -0.05, -0.3), yfov: 1.2 }.add(&mut glb);
    if let Some(fog) = fog {
        glb.scene_extra("media", json!([fog]));
    }
    glb.finish()
}

/// A white sphere disappears in a furnace, and fog that only scatters does as well.
#[test]
fn a_white_sphere_disappears_in_a_furnace() {
    if !graphics::available("a_white_sphere_disappears_in_a_furnace") {
        return;
    }
    let fogs = [
        ("no fog", None),
        (
            "even fog",
            Some(
                json!({ "sigma_s": 1.5, "g": 0.5, "box": { "min": [-0.5, -0.5, -0.5], "max": [0.5, 0.5, 0.5] } }),
            ),
        ),
        ("endless fog", Some(json!({ "sigma_s": [0.5, 1.0, 2.0], "g": -0.3 }))),
        (
            "fog by height",
            Some(json!({ "sigma_s": 2.0, "density": { "height": { "base": -0.2, "falloff": 0.4 } } })),
        ),
    ];
    for (what, fog) in fogs {
        let shown =
            bake(&furnace(fog), &["--samples", "256", "--texels-per-metre", "16", "--media", "bounded"]);
        // Two places on its way.
        let got = shown.picture(&["--ball", "-0.05,0,-0.1,0.15", "--ball", "0.22,-0.2,-0.3,0.1"]);
        let bare = shown.picture(&["--no-balls"]);
        let covered = |x: usize, y: usize| got.rgb("", x, y) != bare.rgb("", x, y);
        let mut sums = [(DVec3::ZERO, 0u32); 2];
        let mut worst = 0.0f32;
        for y in 0..SIZE[1] {
            for x in 0..SIZE[0] {
                let v = got.rgb("", x, y);
                worst = worst.max((v / 2.0 - 1.0).abs().max_element());
                let (sum, n) = &mut sums[usize::from(covered(x, y))];
                (*sum, *n) = (*sum + v.as_dvec3(), *n + 1);
            }
        }
        let [wall, ball] = sums.map(|(sum, n)| sum / f64::from(n));
        println!(
            "{what}: walls {wall:.4}, sphere {ball:.4} of {} pixels, at most {:.2} % off",
            sums[1].1,
            100.0 * worst
        );
        assert!(1200 < sums[1].1, "the sphere covers {} pixels", sums[1].1);
        for v in wall.to_array().into_iter().chain(ball.to_array()) {
            assert!((v / 2.0 - 1.0).abs() < 6e-3, "{what}: {wall} and {ball}");
        }
        assert!(worst < 0.05, "{what}: {worst}");
    }
}

/// Black walls around thin fog: what reaches the eye is light that fog scattered once, which an integral knows.
#[test]
fn fog_is_lit_by_lamps_as_integrals_say() {
    if !graphics::available("fog_is_lit_by_lamps_as_integrals_say") {
        return;
    }
    let (sigma_s, sigma_a, g) = (0.004f64, 0.01f64, 0.4f64);
    let eye = Eye { at: Vec3::new(-1.6, 1.1, 1.7), to: Vec3::new(0.6, 0.9, -1.2), yfov: 1.0 };
    let at = Vec3::new(0.4, 1.3, -0.3);
    let down = Vec3::new(0.3, -1.0, -0.2).normalize();
    for kind in ["sun", "overlapping", "point", "spot"] {
        let mut glb = Glb::new();
        let black = glb.material(&Material::matte("black", [0.0; 3]));
        let mut room = Shape::default();
        room.cuboid([-2.0, 0.0, -2.0], [2.0, 2.5, 2.0], ALL);
        // The sun comes in where there is no ceiling.
        let open = Shape::default();
        let mut floor = open.clone();
        floor.grid(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0, 1, 1);
        let sun = kind == "sun" || kind == "overlapping";
        let walls = if sun { floor } else { room.inside_out() };
        let mesh = glb.mesh("room", &[(&walls, black)]);
        glb.node(Node::new("room").mesh(mesh));
        let turned = suite::gltf::looking(down);
        let _ = match kind {
            "point" => lamp(&mut glb, Kind::Point, [1.0; 3], 100.0, Node::new("lamp").at(at)),
            "spot" => {
                let cone = Kind::Spot { inner: 0.3, outer: 0.9 };
                lamp(&mut glb, cone, [1.0; 3], 100.0, Node::new("lamp").at(at).turned(turned))
            }
            _ => lamp(&mut glb, Kind::Directional, [1.0; 3], 100.0, Node::new("sun").turned(turned)),
        };
        let fog = |sigma_s: [f64; 3], sigma_a: f64, g: f64| json!({ "sigma_s": sigma_s, "sigma_a": sigma_a, "g": g, "box": { "min": [-2, 0, -2], "max": [2, 2.5, 2] } });
        // Media of two colours that scatter against each other scatter evenly together.
        let (media, g) = if kind == "overlapping" {
            (vec![fog([sigma_s, 0.0, 0.0], sigma_a, 0.8), fog([0.0, sigma_s, 0.0], 0.0, -0.8)], 0.0)
        } else {
            (vec![fog([sigma_s; 3], sigma_a, g)], g)
        };
        glb.scene_extra("media", json!(media));
        eye.add(&mut glb);
        let shown =
            bake(&glb.finish(), &["--samples", "16", "--texels-per-metre", "4", "--media", "bounded"]);
        let got = shown.picture(&["--no-balls", "--antialias", "16"]);
        let sigma_t = sigma_s + sigma_a;
        let phase = |x: f64| (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * x).powf(1.5));
        let (min, max) = (DVec3::new(-2.0, 0.0, -2.0), DVec3::new(2.0, 2.5, 2.0));
        // How far a ray goes until it leaves the box.
        let leaves = |p: DVec3, d: DVec3| {
            let far = DVec3::select(d.cmplt(DVec3::ZERO), min - p, max - p) / d;
            far.min_element().max(0.0)
        };
        let want = |x: usize, y: usize| {
            let d = eye.ray(x, y).as_dvec3().normalize();
            let from = eye.at.as_dvec3();
            let end = leaves(from, d);
            let n = 4000;
            let step = end / f64::from(n);
            let scattered = |i: i32| {
                let t = (f64::from(i) + 0.5) * step;
                let p = from + d * t;
                let (light, travels, way) = if sun {
                    let travels = down.as_dvec3();
                    (100.0, travels, leaves(p, -travels))
                } else {
                    let way = p - at.as_dvec3();
                    let r = way.length();
                    let cone = if kind == "spot" {
                        let a = (way.dot(down.as_dvec3()) / r - 0.9f64.cos()) / (0.3f64.cos() - 0.9f64.cos());
                        a.clamp(0.0, 1.0).powi(2)
                    } else {
                        1.0
                    };
                    (100.0 * cone / (r * r), way / r, r)
                };
                sigma_s * light * phase(-travels.dot(d)) * (-sigma_t * (way + t)).exp() * step
            };
            (0..n).map(scattered).sum::<f64>()
        };
        let mut pairs = Vec::new();
        for y in (4..SIZE[1]).step_by(8) {
            for x in (4..SIZE[0]).step_by(8) {
                pairs.push((f64::from(got.rgb("", x, y).y), want(x, y)));
            }
        }
        let [sum, all] = [0, 1].map(|i| pairs.iter().map(|p| [p.0, p.1][i]).sum::<f64>());
        // As a part of the mean where hardly anything is lit: there froxels of some pixels mix.
        let mean = all / pairs.len() as f64;
        let off = |p: &(f64, f64)| (p.0 - p.1).abs() / p.1.max(mean);
        let mut sorted: Vec<f64> = pairs.iter().map(off).collect();
        sorted.sort_by(f64::total_cmp);
        let worst = sorted[sorted.len() - 1];
        println!(
            "{kind}: {:.2} % in all, half of the pixels within {:.2} %, 95 % within {:.1} %, at most {:.1} %",
            100.0 * (sum / all - 1.0),
            100.0 * sorted[sorted.len() / 2],
            100.0 * sorted[sorted.len() * 19 / 20],
            100.0 * worst
        );
        // The tip of a cone and where it meets the floor are narrower than froxels (3.5 % in all, 95 % within 10.4 %, was measured);
        // 95 % of the others were within 0.8 (point), 1.4 (sun) and 2.1 % (overlapping).
        let [sums, most] = match kind {
            "spot" => [0.05, 0.12],
            "overlapping" => [0.01, 0.025],
            _ => [0.01, 0.02],
        };
        assert!((sum / all - 1.0).abs() < sums, "{kind}: {sum} of {all}");
        assert!(sorted[sorted.len() / 2] < 0.012 && sorted[sorted.len() * 19 / 20] < most, "{kind}");
    }
}

/// A room with a table and all kinds of lamps, whose direct light is baked, or left to the game; lengths times `size`.
fn room(mode: &str, size: f32, offset: Vec3) -> Vec<u8> {
    let at = |x: f32, y: f32, z: f32| offset + size * Vec3::new(x, y, z);
    let eye = Eye { at: at(-1.7, 1.9, 1.6), to: at(0.3, 0.4, -0.4), yfov: 1.1 };
    let mut glb = Glb::new();
    let grey = glb.material(&Material::matte("grey", [0.6, 0.5, 0.4]));
    let mut add = |name: &str, shape: &Shape| {
        let mesh = glb.mesh(name, &[(shape, grey)]);
        glb.node(Node::new(name).mesh(mesh).at(offset).scaled([size; 3]));
    };
    let mut walls = Shape::default();
    walls.grid(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0, 1, 1);
    walls.grid(Vec3::new(-2.0, 0.0, -2.0), Vec3::X * 4.0, Vec3::Y * 2.5, 1, 1);
    walls.grid(Vec3::new(2.0, 0.0, -2.0), Vec3::Z * 4.0, Vec3::Y * 2.5, 1, 1);
    add("walls", &walls);
    let mut table = Shape::default();
    table.cuboid([-0.5, 0.0, -0.9], [0.7, 0.8, 0.1], ALL);
    add("table", &table);
    let node = |name: &str| Node::new(name).extras(json!({ "mode": mode }));
    lamp(&mut glb, Kind::Point, [1.0, 0.8, 0.6], 40.0 * size * size, node("bulb").at(at(-0.9, 1.6, -0.8)));
    let turned = |d: Vec3| suite::gltf::looking(d.normalize());
    let cone = Kind::Spot { inner: 0.2, outer: 0.6 };
    let spot = node("spot").at(at(1.2, 2.3, 0.8)).turned(turned(Vec3::new(-0.4, -1.0, -0.5)));
    lamp(&mut glb, cone, [0.5, 0.8, 1.0], 90.0 * size * size, spot);
    let sun = node("sun").turned(turned(Vec3::new(0.6, -1.0, -0.35)));
    lamp(&mut glb, Kind::Directional, [1.0; 3], 6.0, sun);
    glb.scene_extra("sky", json!(0.3));
    eye.add(&mut glb);
    glb.finish()
}

/// What the game adds of lamps that are not baked is what was baked of them, shadows included.
#[test]
fn lamps_of_the_game_light_as_baked_ones() {
    if !graphics::available("lamps_of_the_game_light_as_baked_ones") {
        return;
    }
    // Walls that lie along the axes and at round numbers are easy for shadow maps, others are not.
    for (size, offset) in
        [(1.0, Vec3::ZERO), (0.873, Vec3::new(0.123, 4.57, -9.1)), (13.1, Vec3::new(-3.3, 0.7, 0.1))]
    {
        let pictures = ["baked", "mixed"].map(|mode| {
            let density = (24.0 / size).to_string();
            let shown =
                bake(&room(mode, size, offset), &["--samples", "128", "--texels-per-metre", &density]);
            let lights = &shown.baked.manifest.lights;
            assert!(lights.iter().all(|l| (l.mode == LightMode::Mixed) == (mode == "mixed")));
            shown.picture(&["--no-balls", "--antialias", "4"])
        });
        let mut off: Vec<f32> = Vec::new();
        for y in 0..SIZE[1] {
            for x in 0..SIZE[0] {
                let [a, b] = [0, 1].map(|i| pictures[i].rgb("", x, y).y);
                off.push((b / a - 1.0).abs());
            }
        }
        off.sort_by(f32::total_cmp);
        let (median, most) = (off[off.len() / 2], off[off.len() * 19 / 20]);
        println!(
            "size {size}: half of all pixels differ by at most {:.2} %, 95 % by at most {:.1} %",
            100.0 * median,
            100.0 * most
        );
        assert!(median < 0.01 && most < 0.1, "{size}: {median} and {most}");
    }
}

/// Walls along the axes shadow nothing by themselves, wherever and however large the room is: depths of shadow maps and of what is asked for are
/// rounded differently everywhere.
#[test]
fn walls_do_not_shadow_themselves() {
    if !graphics::available("walls_do_not_shadow_themselves") {
        return;
    }
    let mut first = None;
    for (size, place) in
        [(1.0, [0.0; 3]), (3.608, [1.3, -2.1, 4.4]), (0.108, [-4.1, 0.3, 2.7]), (22.82, [3.9, -4.6, -0.2])]
    {
        let at = |x: f32, y: f32, z: f32| size * (Vec3::from(place) + Vec3::new(x, y, z));
        let mut glb = Glb::new();
        let grey = glb.material(&Material::matte("grey", [0.5; 3]));
        let mut walls = Shape::default();
        walls.grid(at(-2.0, 0.0, 2.0), Vec3::X * (4.0 * size), Vec3::Z * (-4.0 * size), 1, 1);
        walls.grid(at(-2.0, 0.0, -2.0), Vec3::X * (4.0 * size), Vec3::Y * (2.5 * size), 1, 1);
        let mesh = glb.mesh("walls", &[(&walls, grey)]);
        glb.node(Node::new("walls").mesh(mesh));
        let lit = Node::new("lamp").at(at(0.3, 1.4, -0.4)).extras(json!({ "mode": "dynamic" }));
        lamp(&mut glb, Kind::Point, [1.0; 3], 40.0 * size * size, lit);
        glb.scene_extra("sky", json!(0.001));
        Eye { at: at(-0.3, 1.9, 2.6), to: at(0.1, 0.7, -0.8), yfov: 1.2 }.add(&mut glb);
        let scene = changed(&glb.finish(), |j| {
            j["extensions"]["KHR_lights_punctual"]["lights"][0]["range"] = json!(3.5 * size);
        });
        let shown = bake(&scene, &["--samples", "4", "--max-size", "64", "--probes", "off"]);
        let got = shown.picture(&["--no-balls"]);
        let sum: f64 =
            (0..SIZE[0] * SIZE[1]).map(|i| f64::from(got.rgb("", i % SIZE[0], i / SIZE[0]).y)).sum();
        let first = *first.get_or_insert(sum);
        println!("size {size}: {sum:.2}");
        assert!((sum / first - 1.0).abs() < 1e-3, "size {size}: {sum} of {first}");
    }
}

/// A floor with a tilted normal map under a low sun: light turns as the directional lightmap says.
#[test]
fn normal_maps_act_as_directions_say() {
    if !graphics::available("normal_maps_act_as_directions_say") {
        return;
    }
    let eye = Eye { at: Vec3::new(0.3, 2.0, 1.5), to: Vec3::new(0.1, 0.0, -0.2), yfov: 0.8 };
    let mut glb = Glb::new();
    // One normal everywhere: 0.36 along u, 0.48 towards the top of the picture, 0.8 out.
    let code = |v: f32| [0u8, 173, 189, 230][[0.0, 0.36, 0.48, 0.8].iter().position(|x| *x == v).unwrap()];
    let texel = [code(0.36), code(0.48), code(0.8), 255];
    let map = glb.texture(&suite::gltf::png(4, false, |_, _| texel));
    let bumpy = Material { normal_texture: Some(map), ..Material::matte("bumpy", [0.5; 3]) };
    let bumpy = glb.material(&bumpy);
    let mut floor = Shape::default();
    floor.grid(Vec3::new(-3.0, 0.0, 3.0), Vec3::X * 6.0, Vec3::Z * -6.0, 1, 1);
    let mesh = glb.mesh("floor", &[(&floor.planar_uvs(1.0), bumpy)]);
    glb.node(Node::new("floor").mesh(mesh));
    lamp(&mut glb, Kind::Point, [1.0, 0.9, 0.8], 50.0, Node::new("lamp").at([-1.5, 1.0, 0.5]));
    glb.scene_extra("sky", json!({ "zenith": [1, 2, 3], "horizon": 0.5, "ground": 0 }));
    eye.add(&mut glb);
    let shown = bake(&glb.finish(), &["--samples", "64", "--texels-per-metre", "8", "--directional"]);
    let n = Vec3::Y;
    // u runs along +X and v along +Z, so that the top of the picture is towards -Z.
    let m = texel.map(|v| f32::from(v) / 255.0 * 2.0 - 1.0);
    let m = (Vec3::X * m[0] + Vec3::NEG_Z * m[1] + n * m[2]).normalize();
    let page = &shown.baked.pages[0];
    let of = |prefix: &str, uv: Vec2| page.bilinear_of(prefix, uv);
    let got = shown.picture(&["--no-balls"]);
    let flat = shown.picture(&["--no-balls", "--no-normals"]);
    let (mut worst, mut turned) = (0.0f32, 0.0f32);
    for y in 0..SIZE[1] {
        for x in 0..SIZE[0] {
            let Some((_, uv)) = seen(&shown.baked, eye, x, y) else { continue };
            let e = of("", uv);
            let more = ["sh1.x.", "sh1.y.", "sh1.z."]
                .iter()
                .zip((m - n).to_array())
                .map(|(c, t)| of(c, uv) * t)
                .sum::<Vec3>();
            let want = 0.5 * (e + more).max(Vec3::ZERO);
            worst = worst.max((got.rgb("", x, y) - want).abs().max_element() / (0.5 * e.max_element()));
            turned = turned.max(((got.rgb("", x, y) - flat.rgb("", x, y)) / (0.5 * e)).abs().max_element());
            assert!((flat.rgb("", x, y) / (0.5 * e) - 1.0).abs().max_element() < 1e-3, "without the map");
        }
    }
    println!(
        "at most {:.2} % beside what the directions say; the map changes up to {:.0} %",
        100.0 * worst,
        100.0 * turned
    );
    assert!(worst < 5e-3 && 0.2 < turned, "{worst} and {turned}");
}

/// A folder of bakes: each by its label, and the wiper has one on each side.
#[test]
fn several_bakes_lie_side_by_side() {
    if !graphics::available("several_bakes_lie_side_by_side") {
        return;
    }
    let dir = tool::folder_with(&room("baked", 1.0, Vec3::ZERO));
    for (label, samples) in [("few", "8"), ("many", "64")] {
        let out = format!("bakes/{label}");
        let args = [
            "run",
            "scene.glb",
            "-o",
            &out,
            "--samples",
            samples,
            "--texels-per-metre",
            "6",
            "--progress",
            "none",
        ];
        let _ = tool::bake(&args, dir.path()).expect(0);
    }
    let of = |args: &[&str]| picture(dir.path(), "bakes", &[&["--exposure", "1"], args].concat());
    let (few, many) = (of(&["--bake", "few"]), of(&["--bake", "many"]));
    let both = of(&["--bake", "few", "--against", "many", "--wipe", "0.25"]);
    let mut different = 0;
    for y in 0..SIZE[1] {
        for x in 0..SIZE[0] {
            let [a, b, c] = [&few, &many, &both].map(|p| p.rgb("", x, y));
            assert_eq!(c, if x < SIZE[0] / 4 { a } else { b }, "{x}, {y}");
            different += usize::from(a != b);
        }
    }
    assert!(SIZE[0] * SIZE[1] / 2 < different, "{different} pixels differ");
    let done = graphics::show(&["bakes", "--bake", "none", "--screenshot", "a.png"], dir.path()).expect(2);
    assert!(done.stderr.contains("there is no bake `none`") && done.stderr.contains("few, many"), "{done}");
}

/// A GLB whose document was changed.
fn changed(glb: &[u8], change: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
    let file = gltf::Glb::from_slice(glb).unwrap();
    let mut json: serde_json::Value = serde_json::from_slice(&file.json).unwrap();
    change(&mut json);
    let json = serde_json::to_vec(&json).unwrap();
    gltf::Glb { json: json.into(), ..file }.to_vec().unwrap()
}

/// Height fog far below, and a sky behind it, stay finite; so does fog of which the eye is deep inside.
#[test]
fn fog_by_height_is_finite_far_away() {
    if !graphics::available("fog_by_height_is_finite_far_away") {
        return;
    }
    for (base, falloff) in [(-300.0, 0.5), (300.0, 0.5), (0.0, 1e-3), (0.0, 1e4)] {
        let mut glb = Glb::new();
        let grey = glb.material(&Material::matte("grey", [0.5; 3]));
        let mut floor = Shape::default();
        floor.grid(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0, 1, 1);
        let mesh = glb.mesh("floor", &[(&floor, grey)]);
        glb.node(Node::new("floor").mesh(mesh));
        glb.scene_extra("sky", json!(1.0));
        let fog = json!({ "sigma_s": 0.5, "density": { "height": { "base": base, "falloff": falloff } } });
        glb.scene_extra("media", json!([fog]));
        let eye = Eye { at: Vec3::new(0.0, 1.0, 3.0), to: Vec3::new(0.0, 0.8, 0.0), yfov: 1.0 };
        eye.add(&mut glb);
        let shown = bake(&glb.finish(), &["--samples", "4", "--texels-per-metre", "2"]);
        let got = shown.picture(&["--no-balls"]);
        let clear = shown.picture(&["--no-balls", "--no-fog"]);
        for y in 0..SIZE[1] {
            for x in 0..SIZE[0] {
                let (v, bare) = (got.rgb("", x, y), clear.rgb("", x, y));
                assert!(v.is_finite() && 0.0 <= v.min_element(), "{base}, {falloff}: {v} at {x}, {y}");
                // Above the horizon by more than a froxel.
                if base == -300.0 && 0.06 < eye.ray(x, y).y {
                    assert!(
                        (v - bare).abs().max_element() < 1e-3,
                        "{v} is not {bare}: there is no fog up here"
                    );
                }
            }
        }
    }
}

/// What stands in a sun shadows fog farther away than anything else of the scene.
#[test]
fn shadows_in_fog_go_on_behind_the_scene() {
    if !graphics::available("shadows_in_fog_go_on_behind_the_scene") {
        return;
    }
    let mut glb = Glb::new();
    let black = glb.material(&Material::matte("black", [0.0; 3]));
    let mut plate = Shape::default();
    plate.cuboid([-1.0, -0.01, -1.0], [1.0, 0.0, 1.0], ALL);
    let mesh = glb.mesh("plate", &[(&plate, black)]);
    glb.node(Node::new("plate").mesh(mesh));
    let turned = suite::gltf::looking(Vec3::new(0.0, -1.0, 1e-3).normalize());
    lamp(&mut glb, Kind::Directional, [1.0; 3], 10.0, Node::new("sun").turned(turned));
    let fog = json!({ "sigma_s": 0.01, "box": { "min": [-10, -10, -10], "max": [10, 10, 10] } });
    glb.scene_extra("media", json!([fog]));
    let eye = Eye { at: Vec3::new(0.0, -4.0, 9.0), to: Vec3::new(0.0, -4.0, 0.0), yfov: 0.9 };
    eye.add(&mut glb);
    let shown = bake(&glb.finish(), &["--samples", "16", "--texels-per-metre", "4"]);
    let got = shown.picture(&["--no-balls", "--antialias", "16"]);
    // Along the middle row: 19 m of fog, 2 m of which are in the shadow.
    let (middle, side) = (got.rgb("", SIZE[0] / 2, SIZE[1] / 2).y, got.rgb("", SIZE[0] / 8, SIZE[1] / 2).y);
    for y in [SIZE[1] / 3, SIZE[1] / 2, SIZE[1] * 4 / 5] {
        let part = got.rgb("", SIZE[0] / 2, y).y / got.rgb("", SIZE[0] / 8, y).y;
        assert!((part - 17.0 / 19.0).abs() < 0.04, "{part} of {side} in row {y}; in the middle {middle}");
    }
}

/// What the baker reads is shown: no scene, no bounds of positions, a picture that is none, a texture of metal, a node that is flat.
#[test]
fn what_is_baked_is_shown() {
    if !graphics::available("what_is_baked_is_shown") {
        return;
    }
    let eye = Eye { at: Vec3::new(0.0, 0.0, 2.0), to: Vec3::ZERO, yfov: 0.9 };
    let scene = |node: Node, transmission: f32| {
        let mut glb = Glb::new();
        let texture = glb.texture(&suite::gltf::png(4, false, |_, _| [255; 4]));
        let grey = Material { transmission, ..Material::matte("grey", [0.5; 3]).textured(texture) };
        let grey = glb.material(&grey);
        let mut wall = Shape::default();
        wall.grid(Vec3::new(-2.0, -2.0, 0.0), Vec3::X * 4.0, Vec3::Y * 4.0, 2, 2);
        let mesh = glb.mesh("wall", &[(&wall.planar_uvs(1.0), grey)]);
        glb.node(node.mesh(mesh));
        glb.scene_extra("sky", json!(1.0));
        eye.add(&mut glb);
        glb.finish()
    };
    let plain = scene(Node::new("wall"), 0.0);
    let middle = |what: &str, glb: &[u8], more: &[&str]| {
        let dir = tool::folder_with(glb);
        let args = ["run", "scene.glb", "-o", "out", "--samples", "64", "--texels-per-metre", "4"];
        let _ = tool::bake(&[&args[..], more].concat(), dir.path()).expect(0);
        let v = picture(dir.path(), "out", &["--no-balls"]).rgb("", SIZE[0] / 2, SIZE[1] / 2).x;
        println!("{what}: {v}");
        v
    };
    let want = 0.5;
    let near = |v: f32, want: f32, what: &str| assert!((v - want).abs() < 0.01, "{what}: {v} is not {want}");
    near(middle("as it is", &plain, &[]), want, "as it is");
    let bounds = changed(&plain, |j| {
        for a in j["accessors"].as_array_mut().unwrap() {
            a.as_object_mut().unwrap().remove("min");
            a.as_object_mut().unwrap().remove("max");
        }
    });
    near(middle("without bounds", &bounds, &[]), want, "without bounds");
    let broken = changed(&plain, |j| {
        j["images"][0] = json!({ "uri": "data:image/png;base64,AAAA", "mimeType": "image/png" })
    });
    near(middle("a picture that is none", &broken, &[]), want, "a picture that is none");
    let lost = changed(&plain, |j| {
        let _ = j.as_object_mut().unwrap().remove("scenes");
        let _ = j.as_object_mut().unwrap().remove("scene");
    });
    // The sky was said by the scene: without it a sky of 1 nit is taken.
    near(middle("without a scene", &lost, &[]), want, "without a scene");
    let flat = Node::new("wall").scaled([1.0, 1.0, 0.0]);
    near(middle("a flat node", &scene(flat, 0.0), &[]), want, "a flat node");
    let metal = changed(&plain, |j| {
        let pbr = &mut j["materials"][0]["pbrMetallicRoughness"];
        pbr["metallicFactor"] = json!(0.5);
        pbr["metallicRoughnessTexture"] = json!({ "index": 0 });
    });
    near(middle("metal", &metal, &[]), want, "metal is lit by its base colour");
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("black.toml");
    std::fs::write(&config, "metals_black = true\n").unwrap();
    let black = ["--config", config.to_str().unwrap()];
    near(middle("half metal, black", &metal, &black), 0.5 * want, "half of it is metal");
    let glass = scene(Node::new("wall"), 0.5);
    // Half of the sky behind it, half tinted: 0.5 of its own light and 0.5 of the sky's, both times 0.5.
    near(middle("glass", &glass, &[]), 0.5 * want + 0.5 * want, "glass");
}

/// Sponza in fog under a sun: more than the default scene of everything, textures and cut leaves included.
#[test]
fn sponza_is_shown_in_fog() {
    let test = "sponza_is_shown_in_fog";
    if !graphics::available(test) {
        return;
    }
    let Some(shared) = suite::shared(test) else { return };
    let scene = shared.join("scenes/sponza-crytek-amd/Sponza.gltf");
    let dir = tempfile::tempdir().unwrap();
    let words = r#"
        sky = { zenith = [2000, 3500, 7000], horizon = [5000, 5500, 6000], ground = 500 }
        lamps = [{ name = "sun", type = "directional", direction = [0.25, -1, 0.18], illuminance = [60000, 54000, 45000] }]
        media = [{ sigma_s = 0.01, sigma_a = 0.001, g = 0.5, box = { min = [-27, 2, -17], max = [25, 24, 15] } }]
    "#;
    std::fs::write(dir.path().join("sponza.toml"), words).unwrap();
    let args = ["run", scene.to_str().unwrap(), "-o", "out", "--config", "sponza.toml", "--quality", "draft"];
    let _ = tool::bake(&[&args[..], &["--samples", "8", "--max-size", "512"]].concat(), dir.path()).expect(0);
    let views = [&[][..], &["--camera", "1"], &["--camera", "1", "--no-fog"]];
    let pictures = views.map(|more| picture(dir.path(), "out", more));
    for (p, view) in pictures.iter().zip(views) {
        let pixels = || (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| p.rgb("", x, y)));
        assert!(pixels().all(|v| v.is_finite() && 0.0 <= v.min_element()), "{view:?}");
        let black = pixels().filter(|v| v.max_element() <= 0.0).count();
        let mean = pixels().map(|v| v.as_dvec3()).sum::<DVec3>() / (SIZE[0] * SIZE[1]) as f64;
        println!("{view:?}: {mean:.0} nits on average, {black} black pixels");
        assert!(
            black < SIZE[0] * SIZE[1] / 200 && 100.0 < mean.min_element(),
            "{view:?}: {black} black, {mean}"
        );
    }
    let told = graphics::show(&["out", "--timings", "3", "--size", "320x180"], dir.path()).expect(0);
    println!("{}", told.stdout);
}
