//! Bakes of Bevy's example scenes beside those that come with them, made by other tools: Cycles (Cornell box), a baker with the light units of
//! Unity (mixed lighting) and EEVEE (irradiance volume). Every bound names what keeps the two apart; README, "Where it is wrong", has the figures.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use std::{collections::BTreeMap, f64::consts::PI, fs, path::Path};

use glam::{DMat4, DVec2, DVec3, DVec4};
use serde_json::json;
use suite::{
    baked::{Baked, triangles},
    reference::{Agreement, Pair, Texels, Twin, from_srgb, glb, least_squares, parts, twins},
    tool,
};
use tables::probes::ProbeVolume;

/// Bakes a scene of one page with its own texture coordinates.
fn baked(scene: &[u8], files: &Path, config: &str, args: &[&str]) -> Baked {
    let dir = tempfile::tempdir().expect("a folder");
    for entry in fs::read_dir(files).expect("a folder of the scene").flatten() {
        if entry.path().extension().is_some_and(|e| e == "jpg" || e == "bin") {
            fs::copy(entry.path(), dir.path().join(entry.file_name())).expect("a copy");
        }
    }
    fs::write(dir.path().join("scene.glb"), scene).expect("a file");
    fs::write(dir.path().join("bake.toml"), config).expect("a file");
    let first = ["run", "scene.glb", "-o", "out", "--config", "bake.toml", "--progress", "none"];
    let done = tool::bake(&[&first[..], args].concat(), dir.path()).expect(0);
    Baked::read(&dir.path().join("out")).unwrap_or_else(|e| panic!("{e}\n{done}"))
}

/// Places on the Cornell box with the name of their face, the reference read with the transfer function of sRGB undone.
struct Place {
    face: String,
    at: DVec3,
    pair: Pair,
}

fn cornell_places(bake: &Baked, scene: &[u8], maps: &BTreeMap<&str, Texels>) -> (Vec<Place>, Vec<Twin>) {
    let twins = twins(&triangles(scene).expect("triangles"), &bake.triangles);
    let mut out = Vec::new();
    for twin in &twins {
        let Some(map) = maps.get(twin.file.node.as_str()) else { continue };
        for (at, n, theirs, ours, weight) in twin.points(32) {
            let face = n.to_array().map(|v| format!("{:+.0}", v * 10.0)).join(" ");
            let ours = bake.bilinear(ours).as_dvec3();
            let pair = Pair { ours, reference: map.bilinear(theirs), weight };
            out.push(Place { face: format!("{} {face}", twin.file.node), at, pair });
        }
    }
    (out, twins)
}

/// Metres from a place on the floor to the footprints of the boxes.
fn from_boxes(at: DVec3, twins: &[Twin]) -> f64 {
    let flat = |p: glam::Vec3| DVec2::new(f64::from(p.x), f64::from(p.z));
    let under = |t: &&Twin| {
        t.file.node.ends_with("box")
            && t.file.node != "cornell.box"
            && t.file.positions.iter().all(|p| p.y < 1.0)
    };
    let p = DVec2::new(at.x, at.z);
    let mut least = f64::INFINITY;
    for t in twins.iter().filter(under) {
        let q = t.file.positions.map(flat);
        let sides = [0, 1, 2].map(|i| (q[(i + 1) % 3] - q[i]).perp_dot(p - q[i]));
        if sides.iter().all(|s| 0.0 <= *s) || sides.iter().all(|s| *s <= 0.0) {
            return 0.0;
        }
        for i in 0..3 {
            let (a, d) = (q[i], q[(i + 1) % 3] - q[i]);
            let t = ((p - a).dot(d) / d.length_squared()).clamp(0.0, 1.0);
            least = least.min((a + d * t - p).length());
        }
    }
    least
}

/// The places that both tools mean the same by: not under boxes, whose light is that of the inside of closed boxes, and not the
/// lamp's place under the ceiling, where light goes to and fro over a millionth of the room.
fn comparable(places: &[Place], twins: &[Twin]) -> Vec<(String, Pair)> {
    let floor = |p: &Place| p.face.starts_with("cornell.box") && p.at.y < 1.0;
    let under = |p: &Place| p.face.ends_with("-10 +0") || p.face.ends_with("-10 -0");
    let box_under = |p: &Place| !p.face.starts_with("cornell.box") && under(p);
    let ceiling = |p: &Place| p.face.starts_with("cornell.box") && under(p);
    places
        .iter()
        .filter(|p| !(box_under(p) || ceiling(p) || (floor(p) && from_boxes(p.at, twins) < 12.0)))
        .map(|p| (p.face.clone(), p.pair))
        .collect()
}

#[test]
fn the_cornell_box_of_cycles() {
    let Some(shared) = suite::shared("the_cornell_box_of_cycles") else { return };
    let dir = shared.join("scenes/bevy-cornell-box");
    let scene = fs::read(dir.join("CornellBox.glb")).expect("the scene");
    let raw = |name: &str| Texels::read(&dir.join(format!("CornellBox-{name}.zstd.ktx2"))).expect("a map");
    let names = [("cornell.box", "Box"), ("large.box", "Large"), ("small.box", "Small")];
    let as_stored: BTreeMap<_, _> = names.iter().map(|(node, map)| (*node, raw(map))).collect();
    let linear: BTreeMap<_, _> =
        as_stored.iter().map(|(node, map)| (*node, map.clone().map(from_srgb))).collect();
    let args = ["--unwrap", "keep", "--max-size", "256", "--samples", "128"];

    let ours = baked(&scene, &dir, "", &args);
    let all = |maps, bake: &Baked, scene: &[u8]| {
        let (places, twins) = cornell_places(bake, scene, maps);
        comparable(&places, &twins)
    };
    let figures = |what: &str, pairs: &[(String, Pair)]| {
        let mut faces: BTreeMap<&str, Vec<Pair>> = BTreeMap::new();
        for (face, pair) in pairs {
            faces.entry(face).or_default().push(*pair);
        }
        let whole = Agreement::of(&pairs.iter().map(|p| p.1).collect::<Vec<_>>());
        println!("{what}: {whole}");
        let mut worst: f64 = 0.0;
        for (face, pairs) in faces {
            let a = Agreement::of(&pairs);
            println!("    {face}: {a}");
            worst = worst.max((a.scale / whole.scale - 1.0).abs());
        }
        println!("    faces' means are at most {:.1} % off the common scale", 100.0 * worst);
        (whole, worst)
    };
    let (stored, stored_faces) = figures("as stored", &all(&as_stored, &ours, &scene));
    let (plain, plain_faces) = figures("sRGB undone", &all(&linear, &ours, &scene));

    // Cycles' default is four diffuse bounces, and its Principled surfaces give part of the light to their specular lobe: what their
    // base colour reflects is a tenth less.
    let (mut document, bin) = parts(&scene).expect("a binary file");
    for material in document["materials"].as_array_mut().expect("materials") {
        let colour = &mut material["pbrMetallicRoughness"]["baseColorFactor"];
        let [r, g, b] = tool::numbers(colour).map(|c| 0.9 * c);
        *colour = json!([r, g, b, 1.0]);
    }
    let darker = glb(&document, &bin).expect("a file");
    let four = baked(&darker, &dir, "", &[&args[..], &["--bounces", "4"]].concat());
    let pairs = all(&linear, &four, &darker);
    let (matched, matched_faces) = figures("albedo x 0.9, four bounces", &pairs);
    let untint = |p: &Pair| Pair { reference: p.reference / matched.channels, ..*p };
    let untinted = Agreement::of(&pairs.iter().map(|p| untint(&p.1)).collect::<Vec<_>>());
    println!("the same without the maps' tint: {untinted}");

    // Where the two mean different things.
    let (places, twins) = cornell_places(&ours, &scene, &linear);
    let part = |f: &dyn Fn(&Place) -> bool| {
        Agreement::of(&places.iter().filter(|p| f(p)).map(|p| p.pair).collect::<Vec<_>>())
    };
    let floor = |p: &Place| p.face.starts_with("cornell.box") && p.at.y < 1.0;
    println!("floor under the boxes: {}", part(&|p| floor(p) && from_boxes(p.at, &twins) <= 0.0));
    println!(
        "floor up to 12 m from them: {}",
        part(&|p| {
            let d = from_boxes(p.at, &twins);
            floor(p) && 0.0 < d && d < 12.0
        })
    );
    println!("ceiling: {}", part(&|p| p.face.starts_with("cornell.box") && 548.0 < p.at.y));
    // The maps hold sRGB's values without saying so: read as light, faces are off by their brightness.
    assert!(4.0 * plain.rms < stored.rms && 1.0 < stored_faces, "{stored}");
    // As it is, faces that get their light by reflection alone are up to a sixth brighter here.
    assert!(
        0.93 < plain.scale && plain.scale < 0.98 && 0.99 < plain.correlation && plain.rms < 0.09,
        "{plain}"
    );
    assert!(plain_faces < 0.17, "{plain_faces}");
    // With the other tool's reflections no scale is left. What is: all maps have a tint, as if the lamp had 3 % less green; noise of ours, of 128
    // paths without a cache; and mantissas of 6 and 5 bits, whose steps are up to 3.7 and 7 % of the light after sRGB's power.
    assert!(0.98 < matched.scale && matched.scale < 1.02 && 0.99 < matched.correlation, "{matched}");
    assert!(matched_faces < 0.05 && matched.rms < 0.09, "{matched_faces} {matched}");
    assert!((matched.channels - 1.0).abs().max_element() < 0.035, "{matched}");
    assert!(untinted.beyond < matched.beyond, "{untinted}");
}

/// The mixed lighting scene as one binary file.
fn mixed_scene(dir: &Path) -> Vec<u8> {
    let text = fs::read(dir.join("MixedLightingExample.gltf")).expect("the scene");
    let document = serde_json::from_slice(&text).expect("JSON");
    glb(&document, &fs::read(dir.join("MixedLightingExample.bin")).expect("its buffer")).expect("a file")
}

/// Where Bevy's example puts a node's texture coordinates on the maps: least corner, counted from below, and size.
const RECTANGLES: [(&str, [f32; 4]); 4] = [
    ("Plane", [0.026, 0.026, 0.710, 0.710]),
    ("SheenChair_fabric", [0.7864, 0.02377, 0.1910, 0.1912]),
    ("SheenChair_wood", [0.787, 0.257, 0.179, 0.177]),
    ("Sphere", [0.788, 0.484, 0.062, 0.062]),
];

/// Places on the mixed lighting scene by node, the floor's apart.
fn mixed_pairs(bake: &Baked, scene: &[u8], map: &Texels) -> BTreeMap<&'static str, Vec<(DVec3, Pair)>> {
    let twins = twins(&triangles(scene).expect("triangles"), &bake.triangles);
    let mut out: BTreeMap<_, Vec<(DVec3, Pair)>> = BTreeMap::new();
    for twin in &twins {
        let Some((node, [x, y, w, h])) = RECTANGLES.into_iter().find(|(node, _)| *node == twin.file.node)
        else {
            continue;
        };
        for (at, _, uv, ours, weight) in twin.points(if node == "Plane" { 160 } else { 1 }) {
            let theirs = glam::Vec2::new(x + w * uv.x, 1.0 - y - h + h * uv.y);
            let pair = Pair { ours: bake.bilinear(ours).as_dvec3(), reference: map.bilinear(theirs), weight };
            out.entry(node).or_default().push((at, pair));
        }
    }
    out
}

/// Means over squares of the floor, which hold noise down.
fn squares(places: &[(DVec3, Pair)], side: f64) -> Vec<Pair> {
    let mut cells: BTreeMap<String, Vec<Pair>> = BTreeMap::new();
    for (at, pair) in places {
        let cell = format!("{:.0} {:.0}", at.x / side, at.z / side);
        cells.entry(cell).or_default().push(*pair);
    }
    let mean = |cell: Vec<Pair>| {
        let weight: f64 = cell.iter().map(|p| p.weight).sum();
        let of = |f: &dyn Fn(&Pair) -> DVec3| cell.iter().map(|p| f(p) * p.weight).sum::<DVec3>() / weight;
        Pair { ours: of(&|p| p.ours), reference: of(&|p| p.reference), weight }
    };
    cells.into_values().map(mean).collect()
}

#[test]
fn mixed_lighting_in_units_of_unity() {
    let Some(shared) = suite::shared("mixed_lighting_in_units_of_unity") else { return };
    let dir = shared.join("scenes/bevy-mixed-lighting");
    let scene = mixed_scene(&dir);
    let args = ["--unwrap", "keep", "--max-size", "512", "--samples", "32"];
    // The ball moves in the game: only the map with all light has it.
    let without_ball = "sky = 0\n[nodes.Sphere]\ncasts_shadow = false\nlightmap = \"off\"\n";
    let mixed = format!("{without_ball}[nodes.Sun]\nmode = \"mixed\"\n");
    // A sun of strength 1 gives a white surface that faces it the value 1, where ours is 2049 lux / pi.
    let unit = PI / 2049.0;
    for (map, config) in [("Baked", "sky = 0\n"), ("MixedDirect", without_ball), ("MixedIndirect", &mixed)] {
        let theirs = Texels::read(&dir.join(format!("MixedLightingExample-{map}.zstd.ktx2"))).expect("a map");
        let ours = baked(&scene, &dir, config, &args);
        for (node, places) in mixed_pairs(&ours, &scene, &theirs) {
            let pairs = if (map, node) == ("MixedIndirect", "Plane") {
                squares(&places, 0.2)
            } else {
                places.into_iter().map(|p| p.1).collect()
            };
            let a = Agreement::of(&pairs);
            let scale = a.scale / unit;
            println!("{map} {node}: {scale:.4} of pi / 2049; {a}");
            let [least, most, rms, correlation] = match (map, node) {
                // Mantissas of 8 bits, cut off, take 0.3 %; the other tool's filter rounds the edges of shadows.
                ("Baked" | "MixedDirect", "Plane") => [0.985, 1.005, 0.04, 0.99],
                // What the sun sends by way of the chair alone. Green and blue are a twentieth of red or less, and mantissas that share red's
                // exponent end there; noise of ours is what remains in squares.
                ("MixedIndirect", "Plane") => [0.94, 1.04, 0.3, 0.97],
                // A rectangle that is rounded by up to half a texel, of 63 texels for all of the ball.
                ("Baked", "Sphere") => [0.94, 1.02, 0.09, 0.99],
                // Places inside other bodies, filled here and mostly dark there, and edges of charts that both fill differently.
                (_, "SheenChair_fabric") => {
                    [0.9, 1.03, if map == "MixedIndirect" { 0.5 } else { 0.13 }, 0.75]
                }
                // The same on a sixth of the rods, and a rectangle that is rounded by half a texel.
                (_, "SheenChair_wood") => [0.85, 1.03, 0.4, 0.7],
                _ => continue,
            };
            assert!(least < scale && scale < most, "{map} {node}: {scale}");
            assert!(a.rms < rms && correlation < a.correlation, "{map} {node}: {a}");
            if map != "MixedIndirect" && node != "Sphere" {
                assert!((a.channels - 1.0).abs().max_element() < 0.02, "{map} {node}: {a}");
            }
        }
    }
}

/// `world_from_local` of Bevy's example: the volume is the cube [-0.5, 0.5]^3 before it.
fn volume_transform() -> DMat4 {
    DMat4::from_cols(
        DVec4::new(-42.317_566, 0.0, 0.0, 0.0),
        DVec4::new(0.0, 0.0, 44.601_563, 0.0),
        DVec4::new(0.0, 16.737_76, 0.0, 0.0),
        DVec4::new(0.0, 6.544_792, 0.0, 1.0),
    )
}

/// Light in one of the six directions at the centre of every voxel: the two bakes' light is divided by base colour and light source.
fn volume_rows(
    theirs: &Texels,
    ours: [&ProbeVolume; 2],
    axis: usize,
    half: usize,
    channel: usize,
    flip: [f64; 2],
) -> Vec<([f64; 3], f64)> {
    let [rx, ry, rz] = [theirs.size[0], theirs.size[1] / 2, theirs.size[2] / 3];
    let mut n = [0.0; 3];
    n[axis] = if half == 0 { 1.0 } else { -1.0 };
    let mut rows = Vec::new();
    for (z, y, x) in (0..rz).flat_map(|z| (0..ry).flat_map(move |y| (0..rx).map(move |x| (z, y, x)))) {
        let centre = |i: usize, n: usize| (i as f64 + 0.5) / n as f64 - 0.5;
        let local = DVec3::new(flip[0] * centre(x, rx), flip[1] * centre(y, ry), centre(z, rz));
        let at = volume_transform().transform_point3(local).as_vec3().to_array();
        let of = |v: &ProbeVolume| f64::from(v.light(at).expect("a probe").irradiance(n)[channel]);
        let texel = theirs.get(x, y + half * ry, z + axis * rz);
        rows.push(([of(ours[0]), of(ours[1]), 1.0], texel[channel]));
    }
    rows
}

/// Correlation of a fit with what it fits.
fn correlation(rows: &[([f64; 3], f64)], x: [f64; 3]) -> f64 {
    let fit = |a: &[f64; 3]| a.iter().zip(x).map(|(a, x)| a * x).sum::<f64>();
    let n = rows.len() as f64;
    let mean = rows.iter().fold((0.0, 0.0), |m, (a, b)| (m.0 + fit(a) / n, m.1 + b / n));
    let co =
        |f: &dyn Fn(f64, f64) -> f64| rows.iter().map(|(a, b)| f(fit(a) - mean.0, b - mean.1)).sum::<f64>();
    co(&|a, b| a * b) / (co(&|a, _| a * a) * co(&|_, b| b * b)).sqrt()
}

#[test]
fn the_irradiance_volume_of_eevee() {
    let Some(shared) = suite::shared("the_irradiance_volume_of_eevee") else { return };
    let dir = shared.join("scenes/bevy-irradiance-volume");
    let scene = fs::read(dir.join("IrradianceVolumeExample.glb")).expect("the scene");
    let theirs = Texels::read(&dir.join("Example.vxgi.ktx2")).expect("a volume");
    assert_eq!(theirs.size, [8, 16, 9]);
    let bake = |config: &str| {
        let work = tempfile::tempdir().expect("a folder");
        // Light from above the horizon alone.
        let half = |_: usize, y: usize| if y < 32 { (1.0f32, 1.0f32, 1.0f32) } else { (0.0, 0.0, 0.0) };
        exr::prelude::write_rgb_file(work.path().join("half.exr"), 128, 64, half).expect("a sky");
        fs::write(work.path().join("scene.glb"), &scene).expect("a file");
        let probes = "probes = [{ box = { min = [-22, 0.2, -23], max = [22, 13, 23] }, spacing = 1.0 }]";
        fs::write(work.path().join("bake.toml"), format!("{probes}\n{config}")).expect("a file");
        let args = [
            "run",
            "scene.glb",
            "-o",
            "out",
            "--config",
            "bake.toml",
            "--max-size",
            "64",
            "--samples",
            "4",
            "--progress",
            "none",
        ];
        let _ = tool::bake(&args, work.path()).expect(0);
        let bytes = fs::read(work.path().join("out/probes.bin")).expect("probes");
        ProbeVolume::from_bytes(&bytes).expect("a volume")
    };
    let sky = bake("sky = \"half.exr\"\n");
    // A lamp of 1000 W where Blender's new scenes have one: 1000 / 4 pi watts per steradian; only what surfaces send on is in the volume.
    let lamp = bake(
        "sky = 0\n[[lamps]]\nname = \"Light\"\nposition = [4.07625, 5.90386, -1.00545]\nintensity = 79.5775\nmode = \"mixed\"\n",
    );
    let right = [1.0, 1.0];
    let up: [f64; 3] = [0, 1, 2].map(|channel| {
        let rows = volume_rows(&theirs, [&sky, &lamp], 1, 0, channel, right);
        let n = rows.len() as f64;
        let mean = rows.iter().map(|r| r.1).sum::<f64>() / n;
        let ours = rows.iter().map(|r| r.0[0]).sum::<f64>() / n;
        println!("+y, channel {channel}: {mean:.4} everywhere, ours {ours:.4} under a sky of 1");
        // Nothing is above: one number everywhere, on both sides.
        assert!(rows.iter().all(|r| (r.1 / mean - 1.0).abs() < 0.01) && (ours - 1.0).abs() < 0.02);
        mean
    });
    for axis in 0..3 {
        for half in (0..2).filter(|half| (axis, *half) != (1, 0)) {
            for (channel, above) in up.into_iter().enumerate() {
                let rows = volume_rows(&theirs, [&sky, &lamp], axis, half, channel, right);
                let (x, rms) = least_squares(&rows);
                let mean = rows.iter().map(|r| r.1).sum::<f64>() / rows.len() as f64;
                println!(
                    "axis {axis} half {half} channel {channel}: sky {:.3} of +y's, lamp {:.3}, constant {:.3}; rms {:.1} % of {mean:.3}, correlation {:.3}",
                    x[0] / above,
                    x[1],
                    x[2],
                    100.0 * rms / mean,
                    correlation(&rows, x),
                );
                // Sides see a sky that is not even, of which only the mean over their half is fitted.
                let [rms_bound, least] = if axis == 1 { [0.14, 0.98] } else { [0.11, 0.92] };
                assert!(
                    rms < rms_bound * mean && least < correlation(&rows, x),
                    "{axis} {half} {channel}: {rms} {mean}"
                );
                if axis == 1 {
                    // The floor reflects a tenth less, as in the Cornell box: its specular lobe has it.
                    assert!((0.85..1.0).contains(&(x[0] / above)), "{x:?}");
                    // The lamp is Blender's own; red ground has little of its light.
                    assert!((0.6..1.2).contains(&x[1]), "{x:?}");
                }
                if (axis, channel) == (1, 0) {
                    // Turned or mirrored, red is elsewhere.
                    for flip in [[-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]] {
                        let wrong = volume_rows(&theirs, [&sky, &lamp], axis, half, channel, flip);
                        let (_, worse) = least_squares(&wrong);
                        assert!(2.0 * rms < worse, "{flip:?}: {worse} and {rms}");
                    }
                }
            }
        }
    }
}
