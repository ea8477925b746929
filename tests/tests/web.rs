//! What a browser shows of a bake: our own page, and three.js with `scene.glb`.

#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test may panic, and says what it measured")]

use std::{fs, path::Path, process::Command};

use glam::{Mat4, Vec2, Vec3, Vec4};
use image::RgbImage;
use serde_json::{Value, json};
use suite::{
    baked::{Baked, Triangle},
    browser::{self, Page},
    gltf::{Glb, Kind, Material, Node, looking, png},
    shape::Shape,
    tool,
};
use tables::probes::ProbeVolume;

const WIDTH: u32 = 640;
const HEIGHT: u32 = 360;
/// Of pixel values, which are rounded to a byte, filtered in a few bits of fraction, and come from 9-bit mantissas or half floats.
const TOLERANCE: u8 = 2;
const EYE: Vec3 = Vec3::new(0.4, 2.4, 3.6);
const TARGET: Vec3 = Vec3::new(0.0, 0.2, -0.1);
const YFOV: f32 = 0.8;

/// What a pixel shows.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seen {
    /// Which triangle; none is the sky.
    triangle: Option<usize>,
    /// What must not change in the neighbourhood for the pixel to be judged, such as the part of a texture.
    part: u32,
    radiance: Vec3,
}

/// Albedo at a point of a node, with the part of its texture.
type Albedo = fn(&str, Vec3) -> (Vec3, u32);

/// A bake in a folder of its own, with what it takes to say how it looks.
struct Scene {
    dir: tempfile::TempDir,
    baked: Baked,
    albedo: Albedo,
    sky: Vec3,
}

impl Scene {
    fn new(glb: Glb, args: &[&str], albedo: Albedo, sky: Vec3) -> Self {
        let dir = tool::folder_with(&glb.finish());
        let all = [&["run", "scene.glb", "-o", "out", "--exposure", "0.7"][..], args].concat();
        let _ = tool::bake(&all, dir.path()).expect(0);
        let baked = Baked::read(&dir.path().join("out")).unwrap();
        Self { dir, baked, albedo, sky }
    }

    /// What is seen through a place of the picture in pixels.
    fn look(&self, x: f32, y: f32) -> Seen {
        let world_from_camera = camera();
        let half = Vec2::new(WIDTH as f32 / HEIGHT as f32, 1.0) * (0.5 * YFOV).tan();
        let at = (Vec2::new(x / WIDTH as f32, 1.0 - y / HEIGHT as f32) * 2.0 - 1.0) * half;
        let direction = world_from_camera.transform_vector3(at.extend(-1.0));
        let mut best = f32::INFINITY;
        let mut seen = Seen { triangle: None, part: 0, radiance: self.sky };
        for (i, t) in self.baked.triangles.iter().enumerate() {
            let Some((distance, bary)) = hit(t, direction).filter(|(d, _)| *d < best) else { continue };
            best = distance;
            let uv = t.uvs[0] * bary[0] + t.uvs[1] * bary[1] + t.uvs[2] * bary[2];
            let (albedo, part) = (self.albedo)(&t.node, EYE + direction * distance);
            let light = self.baked.pages[self.page(&t.node)].bilinear(uv);
            seen = Seen { triangle: Some(i), part, radiance: albedo * light };
        }
        seen
    }

    /// The page of a node.
    fn page(&self, node: &str) -> usize {
        self.baked.manifest.surfaces.iter().find(|s| s.path == node).unwrap().page
    }

    /// Compares pixels of a picture with what they have to show, after `tone`.
    #[track_caller]
    fn check(
        &self,
        picture: &RgbImage,
        tone: impl Fn(f32) -> f32,
        sky: bool,
        hidden: impl Fn(u32, u32) -> bool,
    ) {
        assert_eq!(picture.dimensions(), (WIDTH, HEIGHT));
        let mut judged: Vec<(Option<usize>, u32)> = Vec::new();
        let mut worst = 0;
        for y in (4..HEIGHT - 4).step_by(7) {
            for x in (4..WIDTH - 4).step_by(7) {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let seen = self.look(px, py);
                // Edges are smoothed, and colours of a texture mix within a texel.
                let near = [(-6.0, 0.0), (6.0, 0.0), (0.0, -6.0), (0.0, 6.0)];
                let kind = |s: Seen| (s.triangle.map(|t| &self.baked.triangles[t].node), s.part);
                let alike = |(dx, dy)| kind(self.look(px + dx, py + dy)) == kind(seen);
                if hidden(x, y) || (seen.triangle.is_none() && !sky) || !near.into_iter().all(alike) {
                    continue;
                }
                let want = seen.radiance.to_array().map(|c| byte(tone(c)));
                let got = picture.get_pixel(x, y).0;
                for (g, w) in got.into_iter().zip(want) {
                    worst = worst.max(g.abs_diff(w));
                    assert!(
                        g.abs_diff(w) <= TOLERANCE,
                        "{got:?} where {want:?} is due, at {x}, {y}: {seen:?}"
                    );
                }
                judged.push((seen.triangle, seen.part));
            }
        }
        let n = judged.len();
        judged.sort_unstable();
        judged.dedup();
        println!("{n} pixels, {} kinds, the worst is {worst} off", judged.len());
        assert!(200 < n && 1 < judged.len(), "too little is seen: {n}, {judged:?}");
    }
}

/// Distance and barycentric coordinates of a triangle along a direction from the eye.
fn hit(t: &Triangle, direction: Vec3) -> Option<(f32, [f32; 3])> {
    let [a, b, c] = t.positions.map(|p| p - EYE);
    let volumes = [b.cross(c), c.cross(a), a.cross(b)].map(|n| n.dot(direction));
    let sum: f32 = volumes.iter().sum();
    let bary = volumes.map(|v| v / sum);
    let distance = (a * bary[0] + b * bary[1] + c * bary[2]).dot(direction) / direction.length_squared();
    (bary.iter().all(|v| 0.0 <= *v) && 0.0 < distance).then_some((distance, bary))
}

fn camera() -> Mat4 {
    Mat4::from_rotation_translation(looking(TARGET - EYE), EYE)
}

/// The curve of `preview.png`.
fn ours(c: f32, exposure: f32) -> f32 {
    let x = c * exposure;
    if x < 12.0 { x * (1.0 + x / 144.0) / (1.0 + x) } else { 1.0 }
}

/// Reinhard's curve in three.js.
fn reinhard(c: f32, exposure: f32) -> f32 {
    c * exposure / (1.0 + c * exposure)
}

/// Linear to an sRGB byte.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
fn byte(y: f32) -> u8 {
    let curve = if y <= 0.003_130_8 { 12.92 * y } else { 1.055 * y.powf(1.0 / 2.4) - 0.055 };
    (curve.clamp(0.0, 1.0) * 255.0).round() as u8
}

fn look_here(glb: &mut Glb) {
    glb.camera("here", EYE, TARGET, YFOV);
}

/// A floor of known albedo under a uniform sky: E / pi is the sky's radiance.
fn floor() -> Scene {
    let mut glb = Glb::new();
    let mut quad = Shape::default();
    quad.grid(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0, 1, 1);
    let brown = glb.material(&Material::matte("brown", [0.5, 0.25, 0.125]));
    let mesh = glb.mesh("floor", &[(&quad, brown)]);
    glb.node(Node::new("floor").mesh(mesh));
    look_here(&mut glb);
    glb.scene_extra("sky", json!([1.5, 1.5, 1.5]));
    let albedo: Albedo = |_, _| (Vec3::new(0.5, 0.25, 0.125), 0);
    let args = ["--samples", "16", "--texels-per-metre", "8", "--irradiance-cache", "off"];
    let scene = Scene::new(glb, &args, albedo, Vec3::splat(1.5));
    let corner = scene.baked.bilinear(scene.baked.triangles[0].uvs[0]);
    assert!((corner - 1.5).abs().max_element() < 1e-3, "an open floor sees the sky alone: {corner}");
    scene
}

/// Colours of the quarters of the room's floor, sRGB, from the corner at -x, -z.
const QUARTERS: [[u8; 3]; 4] = [[230, 230, 230], [230, 90, 60], [70, 200, 90], [80, 110, 230]];

/// A floor with a colour in each quarter and two walls, under a red and a blue lamp: whatever is turned round
/// or mixed up changes colours. Surfaces are on several pages.
fn room() -> Scene {
    let mut glb = Glb::new();
    let mut floor = Shape::default();
    floor.polygon(&[(-2, 2), (2, 2), (2, -2), (-2, -2)].map(|(x, z)| Vec3::new(x as f32, 0.0, z as f32)));
    floor.uvs = floor.positions.iter().map(|p| Vec2::new(0.25 * p.x + 0.5, 0.25 * p.z + 0.5)).collect();
    let quarters = png(64, false, |x, y| {
        let [r, g, b] = QUARTERS[usize::from(32 <= x) + 2 * usize::from(32 <= y)];
        [r, g, b, 255]
    });
    let texture = glb.texture(&quarters);
    let tiles = glb.material(&Material::matte("tiles", [0.9, 0.8, 0.7]).textured(texture));
    let plaster = glb.material(&Material::matte("plaster", [0.6, 0.6, 0.5]));
    let mut wall = Shape::default();
    wall.grid(Vec3::new(-2.0, 0.0, 0.0), Vec3::X * 4.0, Vec3::Y * 1.5, 1, 1);
    let floor = glb.mesh("floor", &[(&floor, tiles)]);
    let wall = glb.mesh("wall", &[(&wall, plaster)]);
    glb.node(Node::new("floor").mesh(floor));
    // One mesh twice, the second time mirrored and turned.
    glb.node(Node::new("back").mesh(wall).at([0.0, 0.0, -2.0]));
    let turned = glam::Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
    glb.node(Node::new("side").mesh(wall).at([-2.0, 0.0, 0.0]).turned(turned).scaled([-1.0, 1.0, 1.0]));
    let red = glb.light("red", Kind::Point, [1.0, 0.3, 0.2], 12.0);
    let blue = glb.light("blue", Kind::Point, [0.2, 0.4, 1.0], 20.0);
    glb.node(Node { light: Some(red), ..Node::new("red lamp") }.at([-1.1, 0.9, -0.8]));
    glb.node(Node { light: Some(blue), ..Node::new("blue lamp") }.at([1.4, 1.2, 0.6]));
    look_here(&mut glb);
    let albedo: Albedo = |node, at| {
        if node != "floor" {
            return (Vec3::new(0.6, 0.6, 0.5), 4 + u32::from(node == "back"));
        }
        let part = usize::from(0.0 < at.x) + 2 * usize::from(0.0 < at.z);
        let linear = |c: u8| {
            let c = f32::from(c) / 255.0;
            if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
        };
        let color = Vec3::from(QUARTERS[part].map(linear)) * Vec3::new(0.9, 0.8, 0.7);
        (color, u32::try_from(part).unwrap())
    };
    let args = ["--samples", "64", "--texels-per-metre", "16", "--max-size", "72"];
    let scene = Scene::new(glb, &args, albedo, Vec3::ZERO);
    assert_ne!(scene.page("floor"), scene.page("side"), "the scene is to be on several pages");
    scene
}

fn html(dir: &Path) -> String {
    let done = tool::bake(&["html", "out", "-o", "page.html"], dir).expect(0);
    assert!(done.stderr.contains("page.html"), "{done}");
    let page = dir.join("page.html");
    let text = fs::read_to_string(&page).unwrap();
    assert!(!text.contains("http:") && !text.contains("https:") && !text.contains("src="), "it stands alone");
    format!("file://{}", page.display())
}

/// Where the panel hides the scene.
fn panel(page: &mut Page) -> impl Fn(u32, u32) -> bool + use<> {
    let script = "(() => { const b = document.querySelector('#panel').getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom]; })()";
    let bounds = list(&page.evaluate(script));
    let outline = 2.0;
    move |x, y| {
        let (x, y) = (f64::from(x), f64::from(y));
        bounds[0] - outline < x
            && x < bounds[2] + outline
            && bounds[1] - outline < y
            && y < bounds[3] + outline
    }
}

fn list(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn our_page_shows_albedo_times_lightmap() {
    let Some(mut page) = Page::open("our_page_shows_albedo_times_lightmap", WIDTH, HEIGHT) else { return };
    for (scene, name) in [(floor(), "floor"), (room(), "room")] {
        let exposure = scene.baked.manifest.exposure.unwrap();
        assert!((exposure - 0.7).abs() < 1e-6);
        page.visit(&html(scene.dir.path()));
        let hidden = panel(&mut page);
        scene.check(&page.picture(), |c| ours(c, exposure), true, &hidden);
        // Two stops brighter, by the keyboard.
        for _ in 0..8 {
            page.press("Equal", "+");
        }
        scene.check(&page.picture(), |c| ours(c, 4.0 * exposure), true, &hidden);
        for _ in 0..8 {
            page.press("Minus", "-");
        }
        // The lightmap alone: as if everything were white.
        page.press("Digit2", "2");
        let white = Scene { albedo: |_, _| (Vec3::ONE, 0), ..scene };
        white.check(&page.picture(), |c| ours(c, exposure), false, &hidden);
        assert!(page.said().is_empty(), "{name}: {:?}", page.said());
    }
}

/// A floor below panes of glass, clear and red, with holes, half there, and with a texture that lets nothing pass; one glows.
fn panes() -> (tempfile::TempDir, Baked) {
    let mut glb = Glb::new();
    let mut floor = Shape::default();
    floor.grid(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0, 1, 1);
    let gray = glb.material(&Material::matte("gray", [0.6, 0.6, 0.6]));
    let floor = glb.mesh("floor", &[(&floor, gray)]);
    glb.node(Node::new("floor").mesh(floor));
    let black = glb.texture(&png(8, false, |_, _| [0, 0, 0, 255]));
    let dots = glb.texture(&png(8, true, |x, _| [255, 255, 255, if x < 4 { 255 } else { 0 }]));
    let glass =
        |name: &str| Material { transmission: 1.0, ..Material::matte(name, [1.0, 0.1, 0.1]) }.double_sided();
    let materials = [
        glass("red"),
        Material { transmission_texture: Some(black), ..glass("shut") },
        Material { mask: Some(0.5), ..Material::matte("holes", [0.3, 0.6, 0.3]) }
            .textured(dots)
            .double_sided(),
        Material { blend: true, base_color: [0.2, 0.3, 0.9, 0.5], ..Material::matte("half", [1.0; 3]) }
            .double_sided(),
        Material::matte("lamp", [0.2; 3]).emitting([0.4, 0.9, 0.2]).double_sided(),
    ];
    let mut pane = Shape::default();
    pane.grid(Vec3::new(-0.3, 0.0, 0.0), Vec3::X * 0.6, Vec3::Y * 0.6, 1, 1);
    pane.uvs = pane.positions.iter().map(|p| Vec2::new(p.x / 0.6 + 0.5, 1.0 - p.y / 0.6)).collect();
    for (i, material) in materials.iter().enumerate() {
        let material = glb.material(material);
        let mesh = glb.mesh(&format!("pane {i}"), &[(&pane, material)]);
        glb.node(Node::new(&format!("pane {i}")).mesh(mesh).at([0.75 * (i as f32 - 2.0), 0.2, 0.0]));
    }
    look_here(&mut glb);
    glb.scene_extra("sky", json!([1.5, 1.5, 1.5]));
    let dir = tool::folder_with(&glb.finish());
    let args =
        ["run", "scene.glb", "-o", "out", "--exposure", "0.7", "--texels-per-metre", "12", "--probes", "off"];
    let _ = tool::bake(&args, dir.path()).expect(0);
    let baked = Baked::read(&dir.path().join("out")).unwrap();
    (dir, baked)
}

/// Glass, holes and glowing surfaces look as in `preview.png`, which is drawn by rays.
#[test]
fn our_page_looks_as_the_preview_does() {
    let Some(mut page) = Page::open("our_page_looks_as_the_preview_does", WIDTH, HEIGHT) else { return };
    let (dir, baked) = panes();
    let preview = image::load_from_memory(&baked.files["preview.png"]).unwrap();
    let preview = preview.resize_exact(WIDTH, HEIGHT, image::imageops::FilterType::Triangle).to_rgb8();
    page.visit(&html(dir.path()));
    let hidden = panel(&mut page);
    let picture = page.picture();
    let mut seen = 0;
    for pane in 0..5usize {
        for (dx, dy) in [(-0.15f32, 0.3f32), (0.15, 0.3), (-0.15, 0.5), (0.15, 0.15)] {
            let at = Vec3::new(0.75 * (pane as f32 - 2.0) + dx, 0.2 + dy, 0.0);
            let seen_from_eye = camera().inverse().transform_point3(at);
            let half = Vec2::new(WIDTH as f32 / HEIGHT as f32, 1.0) * (0.5 * YFOV).tan();
            let clip = seen_from_eye.truncate() / -seen_from_eye.z / half;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the picture")]
            let (x, y) =
                (((0.5 + 0.5 * clip.x) * WIDTH as f32) as u32, ((0.5 - 0.5 * clip.y) * HEIGHT as f32) as u32);
            if hidden(x, y) {
                continue;
            }
            let (got, want) = (picture.get_pixel(x, y).0, preview.get_pixel(x, y).0);
            println!("pane {pane} at {x}, {y}: {got:?}, preview {want:?}");
            // What light passes in part is mixed after the tone curve on the page, and before it in the preview.
            let allowed = [24, 4, 4, 12, 4][pane];
            assert!(
                got.iter().zip(want).all(|(g, w)| g.abs_diff(w) <= allowed),
                "pane {pane}: {got:?}, {want:?}"
            );
            seen += 1;
        }
    }
    assert!(15 < seen, "{seen}");
    assert!(page.said().is_empty(), "{:?}", page.said());
}

/// What the scene's words name beside it is not in the bake's folder, and not needed for the page.
#[test]
fn our_page_needs_no_file_of_the_scene() {
    let mut glb = Glb::new();
    let mut quad = Shape::default();
    quad.grid(Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::NEG_Z * 2.0, 1, 1);
    let gray = glb.material(&Material::matte("gray", [0.5; 3]));
    let mut cube = Shape::default();
    cube.cuboid([-0.5, 0.1, -0.5], [0.5, 1.1, 0.5], suite::shape::ALL);
    let floor = glb.mesh("floor", &[(&quad, gray)]);
    let smoke = glb.mesh("smoke", &[(&cube, gray)]);
    glb.node(Node::new("floor").mesh(floor));
    let density = json!({"raw": "fog.raw", "size": [1, 1, 2], "format": "u8"});
    let medium = json!({"shape": "box", "sigma_s": 0.5, "density": density});
    glb.node(Node::new("smoke").mesh(smoke).extras(json!({"medium": medium})));
    glb.scene_extra("sky", json!("sky.hdr"));
    glb.scene_extra(
        "media",
        json!([{"sigma_s": 0.1, "box": {"min": [-1, 0, -1], "max": [1, 1, 1]}, "density": density}]),
    );
    let dir = tool::folder_with(&glb.finish());
    let sky =
        [&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n"[..], &[128, 128, 128, 129, 64, 64, 64, 129]]
            .concat();
    fs::write(dir.path().join("sky.hdr"), sky).unwrap();
    fs::write(dir.path().join("fog.raw"), [50, 255]).unwrap();
    let args =
        ["run", "scene.glb", "-o", "out", "--quality", "draft", "--samples", "8", "--texels-per-metre", "4"];
    let _ = tool::bake(&args, dir.path()).expect(0);
    let apart = tempfile::tempdir().unwrap();
    copy(&dir.path().join("out"), &apart.path().join("out"));
    let text = fs::read_to_string(html(apart.path()).strip_prefix("file://").unwrap()).unwrap();
    assert_eq!(text.matches("\"world_from_mesh\"").count(), 1, "the smoke is no surface");
}

#[test]
fn our_page_obeys_keys_and_pointers() {
    let Some(mut page) = Page::open("our_page_obeys_keys_and_pointers", WIDTH, HEIGHT) else { return };
    let scene = floor();
    page.visit(&html(scene.dir.path()));
    let first = page.picture();
    page.press("Digit3", "3");
    let texels = page.picture();
    assert_ne!(first, texels);
    page.press("Digit1", "1");
    assert_eq!(page.picture(), first);
    let _ = page.evaluate("dispatchEvent(new KeyboardEvent('keydown', { code: 'KeyW', key: 'w' }))");
    for _ in 0..3 {
        let _ = page.picture();
    }
    let _ = page.evaluate("dispatchEvent(new KeyboardEvent('keyup', { code: 'KeyW', key: 'w' }))");
    assert_ne!(page.picture(), first, "W moves");
    page.press("Home", "Home");
    assert_eq!(page.picture(), first, "Home leads back");
    let drag = "for (const [type, x] of [['pointerdown', 300], ['pointermove', 340], ['pointerup', 340]]) \
        document.querySelector('canvas').dispatchEvent(new PointerEvent(type, { pointerId: 1, clientX: x, clientY: 200 }))";
    // A pointer that is made up cannot be captured.
    let _ = page.evaluate(&format!("Element.prototype.setPointerCapture = () => {{}}; {drag}"));
    assert_ne!(page.picture(), first, "dragging turns");
    let _ = page.evaluate("document.querySelector('#reset').click()");
    assert_eq!(page.picture(), first);
    // On a phone the panel is below and leaves most of the picture free.
    page.resize(360, 640);
    let picture = page.picture();
    assert_eq!(picture.dimensions(), (360, 640));
    let hidden = panel(&mut page);
    assert!(!hidden(180, 100) && !hidden(180, 330) && hidden(180, 630));
    assert!(page.said().is_empty(), "{:?}", page.said());
}

#[test]
fn a_folder_without_a_bake_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    for folder in [".", "absent"] {
        let done = tool::bake(&["html", folder], dir.path()).expect(2);
        assert!(done.stderr.contains("is no bake"), "{done}");
        assert_eq!(done.stderr.trim_end().lines().count(), 1, "{done}");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

/// A temporary folder with packages of npm; `None`, which says so, where they cannot be had.
fn packages(test: &str, names: &[&str]) -> Option<tempfile::TempDir> {
    let npm = browser::npm(test)?;
    let dir = tempfile::tempdir().unwrap();
    let install = ["install", "--no-audit", "--no-fund", "--ignore-scripts", "--prefix", "."];
    let done = Command::new(npm).args(install).args(names).current_dir(dir.path()).output().unwrap();
    if !done.status.success() {
        // Registries may be out of reach where browsers are not.
        println!("skipped: {test}: npm cannot install {}", names.join(" "));
        return None;
    }
    Some(dir)
}

/// The script of the page for users of three.js that exports a name.
fn documented(name: &str) -> String {
    let text = fs::read_to_string(suite::root().join("bake/engines/three.md")).unwrap();
    let mut scripts = text.split("```js\n").skip(1).map(|s| s.split_once("```").unwrap().0);
    scripts.find(|s| s.contains(&format!("export async function {name}"))).unwrap().to_owned()
}

/// How a page of a test finds three.js.
const HEAD: &str = r#"<!doctype html>
<style>body { margin: 0 } canvas { display: block }</style>
<script type="importmap">
{ "imports": { "three": "/node_modules/three/build/three.module.js", "three/addons/": "/node_modules/three/examples/jsm/" } }
</script>
"#;

/// Draws a bake as the page for users of three.js says; `keep` leaves standard materials.
const THREE: &str = r#"<script type="module">
import * as THREE from 'three';
import { loadBake } from './bake.js';
try {
  const { manifest, scene, cameras } = await loadBake('/out');
  const renderer = new THREE.WebGLRenderer({ antialias: true });
  renderer.setSize(innerWidth, innerHeight);
  renderer.toneMapping = THREE.ReinhardToneMapping;
  renderer.toneMappingExposure = manifest.exposure;
  document.body.append(renderer.domElement);
  const camera = cameras[0];
  camera.aspect = innerWidth / innerHeight;
  camera.updateProjectionMatrix();
  if (location.search) {
    scene.traverse((mesh) => {
      if (!mesh.isMesh) return;
      const { color, map, lightMap, lightMapIntensity } = mesh.material;
      mesh.material = new THREE.MeshStandardMaterial({ color, map, lightMap, lightMapIntensity, roughness: 0.9, metalness: 0 });
    });
  }
  renderer.render(scene, camera);
  document.documentElement.dataset.ready = 'true';
} catch (e) {
  document.body.textContent = e.stack;
  document.documentElement.dataset.failed = 'true';
}
</script>
"#;

/// Draws white balls that probes light, seen from above, with nothing else.
const BALL: &str = r#"<script type="module">
import * as THREE from 'three';
import { loadProbes } from './probes.js';
try {
  const manifest = await (await fetch('/out/manifest.json')).json();
  const renderer = new THREE.WebGLRenderer();
  renderer.setSize(innerWidth, innerHeight);
  renderer.toneMapping = THREE.ReinhardToneMapping;
  renderer.toneMappingExposure = manifest.exposure;
  document.body.append(renderer.domElement);
  const scene = new THREE.Scene();
  scene.add(await loadProbes('/out', manifest, renderer));
  const place = new URLSearchParams(location.search).get('at').split(',').map(Number);
  const ball = new THREE.Mesh(new THREE.SphereGeometry(0.2, 64, 32), new THREE.MeshLambertMaterial({ color: 'white' }));
  ball.position.fromArray(place);
  scene.add(ball);
  const camera = new THREE.OrthographicCamera(-0.4, 0.4, 0.225, -0.225, 0.1, 10);
  camera.position.set(place[0], place[1] + 2, place[2]);
  camera.up.set(0, 0, -1);
  camera.lookAt(ball.position);
  renderer.render(scene, camera);
  document.documentElement.dataset.ready = 'true';
} catch (e) {
  document.body.textContent = e.stack;
  document.documentElement.dataset.failed = 'true';
}
</script>
"#;

/// Balls between the lamps of the room are lit on their sides as our own look-up says, as far as an even grid goes.
fn lit_by_probes(page: &mut Page, address: &str, site: &Path) {
    let scene = room();
    copy(&scene.dir.path().join("out"), &site.join("out"));
    let m = &scene.baked.manifest;
    let volume = ProbeVolume::from_bytes(&scene.baked.files[&m.probes[0].file]).unwrap();
    let voxel = m.probes[0].grid.extent[0] / m.probes[0].grid.size[0] as f32;
    let mut off: Vec<i32> = Vec::new();
    for place in [[0.2f32, 0.7, 0.3], [0.9, 0.8, -0.6], [-0.4, 0.6, 1.0]] {
        let [x, y, z] = place;
        page.visit(&format!("{address}/ball.html?at={x},{y},{z}"));
        let picture = page.picture();
        for (dx, dz) in [(0.0f32, 0.0f32), (0.6, 0.0), (-0.6, 0.0), (0.0, 0.6), (0.0, -0.6), (0.4, 0.4)] {
            let n = Vec3::new(dx, (1.0 - dx * dx - dz * dz).sqrt(), dz);
            let p = Vec3::from(place) + n * (0.2 + 0.5 * voxel);
            let light = volume.light(p.to_array()).unwrap().irradiance(n.to_array());
            let want = light.map(|e| byte(reinhard(e.max(0.0), m.exposure.unwrap())));
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the picture")]
            let pixel = |at: f32, of: u32| (0.5 * of as f32 + 0.25 * at * WIDTH as f32) as u32;
            let got = picture.get_pixel(pixel(dx, WIDTH), pixel(dz, HEIGHT)).0;
            off.extend(got.iter().zip(want).map(|(g, w)| i32::from(*g) - i32::from(w)));
        }
    }
    let mean = off.iter().map(|d| f64::from(d.abs())).sum::<f64>() / off.len() as f64;
    let worst = off.iter().map(|d| d.abs()).max().unwrap();
    println!(
        "balls by probes: {} values, off by {mean:.1} on average, at worst by {worst} of 255",
        off.len()
    );
    assert!(mean < 6.0 && worst < 30, "{off:?}");
}

#[test]
fn three_js_shows_albedo_times_lightmap() {
    let test = "three_js_shows_albedo_times_lightmap";
    let Some(mut page) = Page::open(test, WIDTH, HEIGHT) else { return };
    let Some(site) = packages(test, &["three@0.187.0"]) else { return };
    fs::write(site.path().join("bake.js"), documented("loadBake")).unwrap();
    fs::write(site.path().join("probes.js"), documented("loadProbes")).unwrap();
    fs::write(site.path().join("index.html"), [HEAD, THREE].concat()).unwrap();
    fs::write(site.path().join("ball.html"), [HEAD, BALL].concat()).unwrap();
    let address = browser::serve(site.path());
    lit_by_probes(&mut page, &address, site.path());
    for scene in [floor(), room()] {
        copy(&scene.dir.path().join("out"), &site.path().join("out"));
        page.visit(&format!("{address}/index.html"));
        let exposure = scene.baked.manifest.exposure.unwrap();
        let picture = page.picture();
        scene.check(&picture, |c| reinhard(c, exposure), false, |_, _| false);
        // Standard materials lose a little of the diffuse light to their specular lobe, and never gain.
        page.visit(&format!("{address}/index.html?standard"));
        let standard = page.picture();
        let mut ratios: Vec<f32> = Vec::new();
        for (s, l) in standard.pixels().zip(picture.pixels()) {
            for (s, l) in s.0.into_iter().zip(l.0) {
                assert!(s <= l.saturating_add(1), "{s} and {l}");
                if (40..200).contains(&l) {
                    ratios.push(radiance(s) / radiance(l));
                }
            }
        }
        ratios.sort_by(f32::total_cmp);
        let at = |part: usize| ratios[part * (ratios.len() - 1) / 100];
        println!("standard over Lambert: {:.3} to {:.3}, median {:.3}", at(1), at(99), at(50));
        assert!(0.8 < at(1) && at(99) < 1.01, "{} {}", at(1), at(99));
        assert!(page.said().is_empty(), "{:?}", page.said());
    }
}

/// Exposed light of a pixel under Reinhard's curve.
fn radiance(byte: u8) -> f32 {
    let c = f32::from(byte) / 255.0;
    let y = if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    y / (1.0 - y)
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
}

/// Prints what the validator says of `out/scene.glb` and the files that it names.
const VALIDATE: &str = r"
const validator = require('gltf-validator');
const fs = require('fs');
const beside = async (name) => new Uint8Array(fs.readFileSync(`out/${name}`));
validator.validateBytes(new Uint8Array(fs.readFileSync('out/scene.glb')), { externalResourceFunction: beside })
  .then((report) => console.log(JSON.stringify(report.issues)), (e) => { console.error(e); process.exit(1); });
";

#[test]
fn scene_glb_is_valid() {
    let test = "scene_glb_is_valid";
    let Some(site) = packages(test, &["gltf-validator@2.0.0-dev.3.10"]) else { return };
    for scene in [floor(), room()] {
        copy(&scene.dir.path().join("out"), &site.path().join("out"));
        let done = Command::new("node").args(["-e", VALIDATE]).current_dir(site.path()).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let issues: Value = serde_json::from_slice(&done.stdout).unwrap();
        let grave = |m: &&Value| m["severity"].as_u64().unwrap() < 2;
        let grave: Vec<&Value> = issues["messages"].as_array().unwrap().iter().filter(grave).collect();
        // That glTF itself knows PNG and JPEG alone is a warning for each page.
        let known = |m: &&Value| m["severity"] == 1 && m["code"] == "IMAGE_UNRECOGNIZED_FORMAT";
        assert!(grave.iter().all(known), "{issues:#}");
        assert_eq!(grave.len(), scene.baked.pages.len(), "{issues:#}");
        let glb = gltf::Gltf::from_slice(&scene.baked.files["scene.glb"]).unwrap();
        assert!(glb.extensions_required().next().is_none());
        assert!(glb.extensions_used().any(|e| e == "MOZ_lightmap"));
    }
}

#[test]
fn the_camera_of_the_manifest_is_that_of_the_preview() {
    let scene = floor();
    let camera = scene.baked.manifest.camera.as_ref().unwrap();
    assert_eq!(camera.name, "here");
    let eye = Vec4::from(camera.world_from_camera[3]);
    assert!((eye - EYE.extend(1.0)).abs().max_element() < 1e-5, "{eye}");
}
