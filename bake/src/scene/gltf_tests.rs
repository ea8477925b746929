//! Loading small documents made here, and whole folders of real and hostile files.

use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use base64::{Engine, prelude::BASE64_STANDARD};
use glam::Vec3;
use serde_json::{Value, json};

use super::{
    config::Config,
    document::Document,
    gltf::{LightUnits, LoadOptions, load},
    model::{LightKind, LightMode, LightmapMode, Region, Scene, Sky},
};
use crate::error::{Error, Finding, Severity};

/// One triangle in the plane z = 0; `patch` changes the document.
fn triangle(patch: impl FnOnce(&mut Value)) -> Result<(Scene, Vec<Finding>), Error> {
    with_options(patch, &Config::default(), &LoadOptions::default())
}

fn with_options(
    patch: impl FnOnce(&mut Value),
    config: &Config,
    options: &LoadOptions,
) -> Result<(Scene, Vec<Finding>), Error> {
    let positions: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut json = json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "tri", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": data(bytemuck::cast_slice(&positions))}]
    });
    patch(&mut json);
    let doc = Document::from_bytes("tri.gltf", json.to_string().as_bytes(), None)?;
    Ok(load(&doc, config, options))
}

fn data(bytes: &[u8]) -> String {
    format!("data:application/octet-stream;base64,{}", BASE64_STANDARD.encode(bytes))
}

fn errors(findings: &[Finding]) -> Vec<&Finding> {
    findings.iter().filter(|f| f.severity == Severity::Error).collect()
}

#[test]
fn a_triangle_loads_under_the_sky_it_needs() {
    let (scene, findings) = triangle(|_| {}).expect("opens");
    assert!(errors(&findings).is_empty(), "{findings:?}");
    assert_eq!((scene.surfaces.len(), scene.meshes[0].triangles.len()), (1, 1));
    assert_eq!(scene.surfaces[0].path, "tri");
    assert_eq!(scene.name, "tri");
    assert!(matches!(scene.sky, Sky::Uniform(Vec3::ONE)));
    assert_eq!(findings.len(), 1, "the sky: {findings:?}");
}

#[test]
fn mistakes_are_errors_with_their_place() {
    type Patch = fn(&mut Value);
    let table: &[(Patch, &str)] = &[
        (|j| j["nodes"][0]["children"] = json!([0]), "nodes[0].children"),
        (
            |j| j["nodes"] = json!([{"children": [1]}, {"children": [2]}, {"children": [1]}]),
            "nodes[2].children",
        ),
        (|j| j["nodes"][0]["children"] = json!([7]), "nodes[0].children"),
        (|j| j["nodes"][0]["mesh"] = json!(7), "nodes[0].mesh"),
        (|j| j["nodes"][0]["mesh"] = json!(-1), "nodes[0].mesh"),
        (|j| j["nodes"][0]["matrix"] = json!([1, 2]), "nodes[0].matrix"),
        (|j| j["nodes"][0]["scale"] = json!([1e300, 1, 1]), "nodes[0]"),
        (|j| j["nodes"][0]["scale"] = json!("big"), "nodes[0].scale"),
        (|j| j["scene"] = json!(1), "scene"),
        (|j| j["scenes"][0]["nodes"] = json!([4]), "scenes[0].nodes"),
        (|j| j["scenes"][0]["nodes"] = json!([]), "scene"),
        (|j| j["meshes"] = json!(1), "meshes"),
        (|j| j["meshes"][0]["primitives"][0]["mode"] = json!(9), "meshes[0].primitives[0].mode"),
        (|j| j["meshes"][0]["primitives"][0]["material"] = json!(0), "meshes[0].primitives[0].material"),
        (|j| j["meshes"][0]["primitives"][0]["indices"] = json!(0), "meshes[0].primitives[0].indices"),
        (|j| j["accessors"][0]["count"] = json!(4), "accessors[0]"),
        (|j| j["accessors"][0]["count"] = json!(u64::MAX), "accessors[0].count"),
        (|j| j["accessors"][0]["componentType"] = json!(1), "accessors[0].componentType"),
        (|j| j["accessors"][0]["type"] = json!("VEC5"), "accessors[0].type"),
        (|j| j["accessors"][0]["byteOffset"] = json!(u64::MAX), "accessors[0]"),
        (
            |j| j["accessors"][0] = json!({"componentType": 5126, "count": 1_000_000_000, "type": "VEC3"}),
            "accessors[0].count",
        ),
        (|j| j["bufferViews"][0]["byteStride"] = json!(4), "accessors[0]"),
        (|j| j["bufferViews"][0]["byteOffset"] = json!(u64::MAX), "bufferViews[0]"),
        (|j| j["bufferViews"][0]["buffer"] = json!(3), "bufferViews[0].buffer"),
        (|j| j["buffers"][0]["byteLength"] = json!(1000), "buffers[0]"),
        (|j| j["buffers"][0]["uri"] = json!("/etc/hosts"), "buffers[0].uri"),
        (|j| j["buffers"][0]["uri"] = json!("http://x/y"), "buffers[0].uri"),
    ];
    for (i, (patch, path)) in table.iter().enumerate() {
        let (_, findings) = triangle(patch).expect("opens");
        let found = errors(&findings);
        assert!(found.iter().any(|f| f.path == *path), "row {i}: wanted {path}, got {findings:?}");
        assert!(found.iter().all(|f| !f.fix.is_empty()));
    }
}

#[test]
fn documents_are_refused_by_name() {
    type Patch = fn(&mut Value);
    let table: &[(Patch, &str)] = &[
        (|j| j["asset"]["version"] = json!("1.0"), "glTF 1.0"),
        (|j| j["asset"]["minVersion"] = json!("2.1"), "2.1"),
        (|j| j["asset"] = json!({}), "glTF 2"),
        (|j| j["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]), "Draco"),
        (|j| j["extensionsRequired"] = json!(["KHR_texture_basisu"]), "KHR_texture_basisu"),
        (|j| j["extensionsRequired"] = json!(["EXT_new"]), "EXT_new"),
    ];
    for (patch, word) in table {
        let error = triangle(patch).expect_err("refused").to_string();
        assert!(error.contains(word), "{word}: {error}");
    }
    let deep = format!("{}{}", "[".repeat(200_000), "]".repeat(200_000));
    for bytes in [&b""[..], b"glTF", b"{", b"[]", b"glTF\x02\0\0\0\x0c\0\0\0", deep.as_bytes()] {
        assert!(Document::from_bytes("x", bytes, None).is_err());
    }
}

#[test]
fn lights_have_units_and_directions() {
    let patch = |j: &mut Value| {
        let lights = json!([
            {"type": "point", "intensity": 10, "color": [1, 0.5, 0], "range": 3},
            {"type": "spot", "intensity": 2, "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.2}},
            {"type": "directional", "intensity": 3}
        ]);
        j["extensions"] = json!({"KHR_lights_punctual": {"lights": lights}});
        j["extensionsUsed"] = json!(["KHR_lights_punctual"]);
        let at = |i: usize, extra: Value| {
            let mut node = json!({"extensions": {"KHR_lights_punctual": {"light": i}}});
            extra.as_object().expect("an object").iter().for_each(|(k, v)| node[k] = v.clone());
            node
        };
        let nodes = j["nodes"].as_array_mut().expect("nodes");
        nodes.push(at(0, json!({"translation": [1, 2, 3], "scale": [5, 5, 5]})));
        nodes.push(at(1, json!({"rotation": [-0.5f64.sqrt(), 0, 0, 0.5f64.sqrt()]})));
        nodes.push(at(2, json!({"extras": {"mode": "mixed", "angular_diameter": 90}, "scale": [0, 0, 0]})));
        j["scenes"][0]["nodes"] = json!([0, 1, 2, 3]);
    };
    let (scene, findings) = triangle(patch).expect("opens");
    assert!(findings.is_empty(), "{findings:?}");
    let kinds: Vec<LightKind> = scene.lights.iter().map(|l| l.kind).collect();
    let position = Vec3::new(1.0, 2.0, 3.0);
    assert_eq!(
        kinds[0],
        LightKind::Point { position, intensity: Vec3::new(10.0, 5.0, 0.0), range: Some(3.0) }
    );
    let LightKind::Spot { direction, inner_cone: 0.1, outer_cone: 0.2, .. } = kinds[1] else {
        panic!("{:?}", kinds[1])
    };
    assert!((direction - Vec3::NEG_Y).length() < 1e-6, "{direction}");
    let want = LightKind::Directional {
        direction: Vec3::NEG_Z,
        illuminance: Vec3::splat(3.0),
        angular_diameter: std::f32::consts::FRAC_PI_2,
    };
    assert_eq!(kinds[2], want);
    assert_eq!(scene.lights[2].mode, LightMode::Mixed);
    assert!(matches!(scene.sky, Sky::Black));

    // A 100 W bulb is 683 lm/W * 100 W / (4 pi sr) = 5435 cd; its unitless export is 100 / (4 pi).
    for (units, candela, lux) in
        [(LightUnits::BlenderRaw, 543.512, 2049.0), (LightUnits::BlenderUnitless, 6830.0, 2049.0)]
    {
        let options = LoadOptions { light_units: units, ..LoadOptions::default() };
        let (scene, _) = with_options(patch, &Config::default(), &options).expect("opens");
        let LightKind::Point { intensity, .. } = scene.lights[0].kind else { panic!("point") };
        assert!((intensity.x - candela).abs() < 1e-3 * candela, "{units:?} {intensity}");
        assert!(
            matches!(scene.lights[2].kind, LightKind::Directional { illuminance, .. } if (illuminance.x - lux).abs() < 1.0)
        );
    }
}

#[test]
fn words_have_their_precedence() {
    let text = "texels_per_metre = 8\n[nodes.tri]\nlightmap = \"off\"\n[nodes.tree]\ncasts_shadow = false";
    let (config, none) = Config::parse("bake.toml", text, None, None).expect("TOML");
    assert!(none.is_empty());
    let (scene, findings) = with_options(
        |j| {
            j["scenes"][0]["extras"] =
                json!({"texels_per_metre": 4, "sky": "0.5,0.5,0.5", "medium_sigma_s": 1});
            j["nodes"][0]["extras"] = json!({"lightmap": "probes", "casts_shadow": 0, "texels_per_metre": 2});
        },
        &config,
        &LoadOptions::default(),
    )
    .expect("opens");
    assert_eq!(scene.texels_per_metre, Some(8.0));
    assert!(matches!(scene.sky, Sky::Uniform(c) if c == Vec3::splat(0.5)));
    let s = &scene.surfaces[0];
    assert_eq!((s.lightmap, s.casts_shadow, s.texels_per_metre), (LightmapMode::Off, false, Some(2.0)));
    let text: Vec<String> = findings.iter().map(ToString::to_string).collect();
    assert_eq!(text.len(), 2, "{text:?}");
    assert!(
        text.iter().any(|t| t.contains("medium_sigma_s"))
            && text.iter().any(|t| t.contains("nodes.\"tree\""))
    );
}

/// A node's medium takes the place of its mesh, wherever the node is put.
#[test]
fn media_of_nodes_fill_their_bounds() {
    let slanted: [f32; 9] = [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0, 1.0];
    let fog = |extras: Value| {
        triangle(|j| {
            j["buffers"]
                .as_array_mut()
                .expect("buffers")
                .push(json!({"byteLength": 36, "uri": data(bytemuck::cast_slice(&slanted))}));
            j["bufferViews"].as_array_mut().expect("views").push(json!({"buffer": 1, "byteLength": 36}));
            j["accessors"].as_array_mut().expect("accessors").push(
                json!({"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [2, 1, 1]}),
            );
            j["meshes"]
                .as_array_mut()
                .expect("meshes")
                .push(json!({"primitives": [{"attributes": {"POSITION": 1}}]}));
            j["nodes"].as_array_mut().expect("nodes").push(json!({
                "name": "fog", "mesh": 1, "translation": [10, 0, 0], "scale": [1, 3, 1],
                "rotation": [0, 0.707_106_77, 0, 0.707_106_77], "extras": extras
            }));
            j["scenes"][0]["nodes"] = json!([0, 1]);
        })
        .expect("opens")
    };
    for extras in [
        json!({"medium": {"shape": "box", "sigma_s": 0.5, "g": 0.25}}),
        json!({"medium_shape": "box", "medium_sigma_s": 0.5, "medium_g": 0.25}),
    ] {
        let (scene, findings) = fog(extras);
        assert!(errors(&findings).is_empty(), "{findings:?}");
        assert_eq!(scene.surfaces.len(), 1, "the fog is no surface");
        let [medium] = &scene.media[..] else { panic!("{:?}", scene.media) };
        assert_eq!((medium.path.as_str(), medium.sigma_s, medium.g), ("fog", Vec3::splat(0.5), 0.25));
        let Region::Turned { unit_from_world } = medium.region else { panic!("{medium:?}") };
        // The corner (2, 1, 1), scaled to (2, 3, 1), turned about y to (1, 3, -2), moved.
        let corner = unit_from_world.transform_point3(Vec3::new(11.0, 3.0, -2.0));
        assert!(corner.abs_diff_eq(Vec3::ONE, 1e-5), "{corner}");
    }
    for (extras, place) in [
        (json!({"medium": 3}), "nodes[1].extras.medium"),
        (json!({"medium": {"shape": "ball", "sigma_s": 1}}), "nodes[1].extras.medium.shape"),
        (json!({"medium": {"shape": "box", "g": 0.5}}), "nodes[1].extras.medium"),
        (json!({"medium": {"shape": "box", "sigma_s": 1, "box": {}}}), "nodes[1].extras.medium.box"),
    ] {
        let (_, findings) = fog(extras.clone());
        let first = errors(&findings).first().map(|f| f.path.clone());
        assert_eq!(first.as_deref(), Some(place), "{extras}");
    }
    let (scene, findings) = fog(json!({"medium": {"sigma_s": 1}}));
    assert!(errors(&findings).is_empty(), "{findings:?}");
    let Region::Mesh(shell) = &scene.media[0].region else { panic!("{:?}", scene.media) };
    assert_eq!((shell.positions.len(), shell.triangles.len()), (3, 1));
    assert!(shell.positions[1].distance(Vec3::new(11.0, 3.0, -2.0)) < 6.0, "placed: {:?}", shell.positions);
    let (_, findings) = triangle(|j| {
        j["nodes"][0]["extras"] = json!({"medium": {"shape": "box", "sigma_s": 1}});
    })
    .expect("opens");
    assert!(errors(&findings).iter().any(|f| f.what.contains("volume")), "flat: {findings:?}");
}

/// Probes fill the bounds of a node's mesh, which is no surface then.
#[test]
fn probes_of_nodes_fill_their_bounds() {
    let corners: [f32; 18] = std::array::from_fn(|i| [2.0, 1.0, 3.0][i % 3] * f32::from(i / 3 % 4 == i % 3));
    let filled = |extras: Value| {
        triangle(|j| {
            let uri = data(bytemuck::cast_slice(&corners));
            let more = [
                ("buffers", json!({"byteLength": 72, "uri": uri})),
                ("bufferViews", json!({"buffer": 1, "byteLength": 72})),
                ("accessors", json!({"bufferView": 1, "componentType": 5126, "count": 6, "type": "VEC3", "min": [0, 0, 0], "max": [2, 1, 3]})),
                ("meshes", json!({"primitives": [{"attributes": {"POSITION": 1}}]})),
                ("nodes", json!({
                    "mesh": 1, "translation": [10, 0, 0], "rotation": [0, 0.707_106_77, 0, 0.707_106_77], "extras": extras
                })),
            ];
            for (list, value) in more {
                j[list].as_array_mut().expect("a list").push(value);
            }
            j["scenes"][0]["nodes"] = json!([0, 1]);
        })
        .expect("opens")
    };
    for extras in [json!({"probes": 0.5}), json!({"probes": {"spacing": 0.5}}), json!({"probes": "0.5"})] {
        let (scene, findings) = filled(extras);
        assert!(errors(&findings).is_empty(), "{findings:?}");
        assert_eq!((scene.surfaces.len(), &scene.bounds[..]), (1, &[(1, 1)][..]));
        let [probes] = &scene.probe_boxes.expect("boxes")[..] else { panic!("one box") };
        // A quarter turn about y takes x to -z and z to x.
        assert!(probes.min.abs_diff_eq(Vec3::new(10.0, 0.0, -2.0), 1e-5), "{probes:?}");
        assert!(probes.max.abs_diff_eq(Vec3::new(13.0, 1.0, 0.0), 1e-5), "{probes:?}");
        assert_eq!((probes.spacing, probes.path.as_str()), (0.5, "nodes[1]"));
    }
    for (extras, place) in [
        (json!({"probes": 0}), "nodes[1].extras.probes"),
        (json!({"probes": true}), "nodes[1].extras.probes"),
        (json!({"probes": 1e-4}), "nodes[1]"),
    ] {
        let (_, findings) = filled(extras.clone());
        let first = errors(&findings).first().map(|f| f.path.clone());
        assert_eq!(first.as_deref(), Some(place), "{extras}");
    }
    let (_, findings) = triangle(|j| j["nodes"][0]["extras"] = json!({"probes": 1})).expect("opens");
    assert!(errors(&findings).iter().any(|f| f.what.contains("empty")), "flat: {findings:?}");
    let (_, findings) = triangle(|j| {
        j["nodes"].as_array_mut().expect("nodes").push(json!({"extras": {"probes": 1}}));
        j["scenes"][0]["nodes"] = json!([0, 1]);
    })
    .expect("opens");
    assert!(errors(&findings).iter().any(|f| f.fix.contains("cube")), "no mesh: {findings:?}");
}

#[test]
fn instances_sparse_parts_and_strips() {
    let moved: [f32; 6] = [0.0, 0.0, 0.0, 10.0, 0.0, 0.0];
    // Vertex 1 moves to x = 5.
    let mut sparse = vec![1u8, 0, 0, 0];
    sparse.extend(bytemuck::cast_slice::<f32, u8>(&[5.0, 0.0, 0.0]));
    let (scene, findings) = triangle(|j| {
        j["buffers"].as_array_mut().expect("buffers").extend([
            json!({"byteLength": 24, "uri": data(bytemuck::cast_slice(&moved))}),
            json!({"byteLength": 16, "uri": data(&sparse)}),
        ]);
        j["bufferViews"]
            .as_array_mut()
            .expect("views")
            .extend([json!({"buffer": 1, "byteLength": 24}), json!({"buffer": 2, "byteLength": 16})]);
        let accessors = j["accessors"].as_array_mut().expect("accessors");
        accessors.push(json!({"bufferView": 1, "componentType": 5126, "count": 2, "type": "VEC3"}));
        accessors[0]["sparse"] = json!({
            "count": 1,
            "indices": {"bufferView": 2, "componentType": 5121},
            "values": {"bufferView": 2, "byteOffset": 4}
        });
        j["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 1}}});
        j["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
        j["meshes"][0]["primitives"][0]["mode"] = json!(5);
    })
    .expect("opens");
    assert!(errors(&findings).is_empty(), "{findings:?}");
    assert_eq!(scene.surfaces.len(), 2);
    assert_eq!(scene.surfaces[1].gpu_instance, Some(1));
    assert_eq!(scene.surfaces[1].world_from_mesh.translation.x, 10.0);
    assert_eq!(scene.meshes[0].positions[1].x, 5.0);
}

#[test]
fn non_finite_positions_name_their_vertex() {
    let positions: [f32; 9] = [0.0, 0.0, 0.0, 1.0, f32::NAN, 0.0, 0.0, 1.0, 0.0];
    let (_, findings) =
        triangle(|j| j["buffers"][0]["uri"] = json!(data(bytemuck::cast_slice(&positions)))).expect("opens");
    let found = errors(&findings);
    assert!(
        found[0].path.ends_with("POSITION") && found[0].what.contains("accessor 0 vertex 1"),
        "{found:?}"
    );
}

#[test]
fn claims_beyond_the_file_cost_nothing() {
    type Patch = fn(&mut Value);
    let table: &[(&str, Patch)] = &[
        ("a billion instances", |j| {
            let accessors = j["accessors"].as_array_mut().expect("accessors");
            accessors.push(json!({"componentType": 5126, "count": 1_000_000_000, "type": "VEC3"}));
            j["nodes"][0]["extensions"] =
                json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 1}}});
        }),
        ("many large zero-filled meshes", |j| {
            j["accessors"][0] = json!({"componentType": 5126, "count": 5_000_000, "type": "VEC3"});
            let primitive = j["meshes"][0]["primitives"][0].clone();
            j["meshes"][0]["primitives"] = json!(vec![primitive; 10_000]);
        }),
        ("an attribute set far away", |j| {
            j["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_4000000000"] = json!(0);
            j["nodes"][0]["mesh"] = json!(4_000_000_000u32);
        }),
    ];
    for (name, patch) in table {
        let start = Instant::now();
        let (_, findings) = triangle(patch).expect("opens");
        assert!(!errors(&findings).is_empty(), "{name}: {findings:?}");
        assert!(start.elapsed() < Duration::from_secs(5), "{name}: {:?}", start.elapsed());
    }
    // A chain of nodes as deep as there are nodes is no error, only long.
    let start = Instant::now();
    let (scene, findings) = triangle(|j| {
        let chain = (0..50_000).map(|i| json!({"name": "a".repeat(40), "children": [i + 1]}));
        let tail = json!({"name": "tail", "mesh": 0});
        j["nodes"] = chain.chain([tail]).collect();
    })
    .expect("opens");
    assert!(errors(&findings).is_empty() && scene.surfaces.len() == 1);
    assert!(scene.surfaces[0].path.starts_with("…/") && scene.surfaces[0].path.ends_with("/tail"));
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
}

fn shared() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let named = std::env::var_os("BAKE_SHARED").map(PathBuf::from);
    let dir = named.into_iter().chain([beside]).find(|d| d.join("scenes").is_dir());
    if dir.is_none() {
        skipped("the folder of shared scenes is not here");
    }
    dir
}

#[expect(clippy::print_stderr, reason = "a test that did not run must say so")]
fn skipped(why: &str) {
    eprintln!("skipped: {why}");
}

#[expect(clippy::print_stderr, reason = "counts are what these tests show")]
fn say(text: &str) {
    eprintln!("{text}");
}

/// All glTF files below a folder, sorted.
fn documents(dir: &Path, list: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> =
        fs::read_dir(dir).expect("a folder").map(|e| e.expect("an entry").path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            documents(&path, list);
        } else if path.extension().is_some_and(|e| e == "gltf" || e == "glb") {
            list.push(path);
        }
    }
}

fn open(path: &Path) -> Result<(Scene, Vec<Finding>), Error> {
    let doc = Document::open(path)?;
    Ok(load(&doc, &Config::default(), &LoadOptions::default()))
}

/// Files with errors by the validator's rules that we load without a word, below
/// `khronos-validator`, and why that is right.
const LOADED_ANYWAY: &[(&str, &[&str])] = &[
    (
        "min and max are not used: bounds come from the vertices",
        &[
            "data/accessor_data/out_of_range_elements_float.gltf",
            "data/accessor_data/out_of_range_elements_sint16.gltf",
            "data/accessor_data/out_of_range_elements_sint8.gltf",
            "data/accessor_data/out_of_range_elements_uint16.gltf",
            "data/accessor_data/out_of_range_elements_uint8.gltf",
            "data/mesh/morph_position_accessor_no_bounds.gltf",
        ],
    ),
    (
        "animations take no part in a bake, beyond their references",
        &[
            "data/animation/channel_duplicate_targets.gltf",
            "data/animation/channel_node_no_morphs.gltf",
            "data/animation/sampler_input_no_bounds.gltf",
            "data/animation/sampler_output_count_invalid.gltf",
            "data/animation/sampler_too_few_cubic_frames.gltf",
            "data/animation_data/invalid_input_values.gltf",
            "data/animation_data/quaternion_cubic_non_unit_values.gltf",
            "data/animation_data/quaternion_non_unit_values.gltf",
            "ext/KHR_animation_pointer/data/animation/channel/target/invalid_channel_target_node.gltf",
            "ext/KHR_animation_pointer/data/animation/channel/target/invalid_channel_target_path.gltf",
            "ext/KHR_animation_pointer/data/animation/channel/target/missing_pointer.gltf",
            "ext/KHR_animation_pointer/data/animation/channel/target/unexpected_extension.gltf",
        ],
    ),
    (
        "skins and morph targets are baked in their base pose, so their data are not read",
        &[
            "data/mesh/morph_attribute_invalid_count.gltf",
            "data/mesh/morph_attribute_no_base.gltf",
            "data/mesh/morph_unequal_targets_count.gltf",
            "data/mesh/morph_weights_wrong_count.gltf",
            "data/mesh_data/joints_weights_complex.gltf",
            "data/node/node_skin_without_skinned_mesh.gltf",
            "data/node/weights_with_no_mesh.gltf",
            "data/skin/ibm_invalid_format.gltf",
            "data/skin/no_common_root.gltf",
            "data/skin/no_joints_in_scene.gltf",
            "data/skin/skeleton_invalid.gltf",
            "data/skin_data/invalid_ibm.gltf",
        ],
    ),
    (
        "clip planes, and a camera that no node shows, change no light",
        &["data/camera/extra_type.gltf", "data/camera/orthographic_z.gltf", "data/camera/perspective_z.gltf"],
    ),
    (
        "no material uses the image, so it is not decoded; where one does, the content decides, not the stated type",
        &[
            "data/image/invalid_data_uri_mime_type.gltf",
            "data/image/invalid_image_data.gltf",
            "data/image/png_eos.gltf",
            "ext/EXT_texture_webp/data/image/undeclared_extension.gltf",
            "ext/EXT_texture_webp/data/texture/invalid_image_mime_type.gltf",
        ],
    ),
    (
        "the extension or its values do not touch diffuse light, and tangents are not used",
        &[
            "ext/KHR_materials_anisotropy/data/material/no_tangent_space.gltf",
            "ext/KHR_materials_anisotropy/data/material/out_of_range.gltf",
            "ext/KHR_materials_clearcoat/data/material/no_tangent_space.gltf",
            "ext/KHR_materials_ior/data/material/out_of_range.gltf",
            "ext/KHR_materials_variants/data/primitive/dependency.gltf",
            "ext/KHR_materials_variants/data/primitive/empties.gltf",
            "ext/KHR_materials_variants/data/primitive/non_unique.gltf",
            "ext/KHR_materials_variants/data/variant/invalid_name.gltf",
            "ext/KHR_materials_volume/data/material/out_of_range.gltf",
        ],
    ),
    (
        "an extension in a place where it means nothing is ignored, as an unknown one would be",
        &[
            "ext/EXT_texture_webp/data/texture/unexpected_extension.gltf",
            "ext/KHR_materials_clearcoat/data/material/unexpected_extension.gltf",
            "ext/KHR_materials_dispersion/data/material/unexpected_extension.gltf",
            "ext/KHR_materials_emissive_strength/data/material/unexpected_extension.gltf",
            "ext/KHR_materials_iridescence/data/material/unexpected_extension.gltf",
            "ext/KHR_materials_sheen/data/material/unexpected_extension.gltf",
            "ext/KHR_materials_specular/data/material/unexpected_extension.gltf",
            "ext/KHR_materials_transmission/data/material/unexpected_extension.gltf",
            "ext/KHR_materials_volume/data/material/unexpected_extension.gltf",
            "ext/KHR_mesh_quantization/data/primitive/unexpected_extension.gltf",
            "ext/KHR_node_visibility/data/node/unexpected_extension.gltf",
            "ext/KHR_texture_transform/data/textureInfo/unexpected_extension.gltf",
        ],
    ),
];

#[test]
fn hostile_files_are_refused_or_loaded_in_a_moment() {
    let Some(shared) = shared() else { return };
    let mut files = Vec::new();
    let root = shared.join("scenes/hostile");
    documents(&root, &mut files);
    assert!(400 < files.len(), "{} files", files.len());
    let (mut refused, mut errors_found, mut warned, mut clean) = (0, 0, 0, 0);
    let (mut silent, mut stale, mut slow) = (Vec::new(), Vec::new(), Vec::new());
    for file in &files {
        let start = Instant::now();
        let result = open(file);
        if Duration::from_secs(2) < start.elapsed() {
            slow.push(file);
        }
        let name = file.strip_prefix(&root).expect("below the root").display().to_string();
        // Files without anything to bake get these whatever else is wrong.
        let general = |f: &Finding| {
            f.path == "scene" && (f.what.contains("no light") || f.what.contains("single triangle"))
        };
        let said = match &result {
            Err(_) => {
                refused += 1;
                true
            }
            Ok((_, list)) => {
                match list.first().map(|f| f.severity) {
                    Some(Severity::Error) => errors_found += 1,
                    Some(_) => warned += 1,
                    None => clean += 1,
                }
                list.iter().any(|f| !general(f) && f.severity != Severity::Info)
            }
        };
        let mut report = file.clone().into_os_string();
        report.push(".report.json");
        let Ok(report) = fs::read(&report) else { continue };
        let report: Value = serde_json::from_slice(&report).expect("a report");
        let messages = report["issues"]["messages"].as_array().expect("messages");
        let codes: Vec<&Value> = messages.iter().filter(|m| m["severity"] == 0).map(|m| &m["code"]).collect();
        let below = name.strip_prefix("khronos-validator/").unwrap_or(&name);
        let listed = LOADED_ANYWAY.iter().any(|(_, names)| names.contains(&below));
        if !codes.is_empty() && !said && !listed {
            silent.push(format!("{name} {codes:?}"));
        }
        if listed && (said || codes.is_empty()) {
            stale.push(name);
        }
    }
    say(&format!(
        "{} files: {refused} refused, {errors_found} with errors, {warned} loaded with findings, {clean} clean, {} listed",
        files.len(),
        LOADED_ANYWAY.iter().map(|(_, names)| names.len()).sum::<usize>()
    ));
    assert!(LOADED_ANYWAY.iter().all(|(reason, _)| !reason.is_empty()));
    assert!(slow.is_empty(), "slow: {slow:?}");
    assert!(stale.is_empty(), "no longer needed in the list: {stale:?}");
    assert!(silent.is_empty(), "{} loaded without a word:\n{}", silent.len(), silent.join("\n"));
}

#[test]
fn real_scenes_load() {
    let Some(shared) = shared() else { return };
    let mut files = Vec::new();
    for entry in fs::read_dir(shared.join("scenes")).expect("a folder") {
        let dir = entry.expect("an entry").path();
        if dir.is_dir() && !dir.ends_with("hostile") {
            documents(&dir, &mut files);
        }
    }
    files.sort();
    for file in &files {
        let name = file.file_name().expect("a name").to_string_lossy().into_owned();
        let start = Instant::now();
        if name == "Sponza.original.gltf" {
            // It requires an extension that nobody else supports either.
            let error = open(file).expect_err("refused").to_string();
            assert!(error.contains("AMD_split_roughnessMetallic"), "{error}");
            continue;
        }
        let (scene, findings) = open(file).unwrap_or_else(|e| panic!("{name}: {e}"));
        let triangles: usize = scene.surfaces.iter().map(|s| scene.meshes[s.mesh].triangles.len()).sum();
        say(&format!(
            "{name}: {triangles} triangles, {} surfaces, {} lights, {} images, {} findings, {:?}",
            scene.surfaces.len(),
            scene.lights.len(),
            scene.images.len(),
            findings.len(),
            start.elapsed()
        ));
        findings.iter().for_each(|f| say(&format!("    {f}")));
        assert!(errors(&findings).is_empty(), "{name}: {findings:?}");
        assert!(0 < triangles, "{name}");
    }
    assert!(20 < files.len());
}

#[test]
fn compressed_equals_plain() {
    let Some(shared) = shared() else { return };
    let dir = shared.join("scenes/japanese-bridge-garden");
    let (plain, _) = open(&dir.join("japanese-bridge-garden.glb")).expect("opens");
    let (packed, _) = open(&dir.join("japanese-bridge-garden.meshopt.glb")).expect("opens");
    let soup = |scene: &Scene| {
        let mut all: Vec<[Vec3; 3]> = Vec::new();
        for s in &scene.surfaces {
            let m = &scene.meshes[s.mesh];
            let at = |i: u32| s.world_from_mesh.transform_point3(m.positions[i as usize]);
            all.extend(m.triangles.iter().map(|t| t.map(at)));
        }
        all
    };
    let (a, b) = (soup(&plain), soup(&packed));
    let area = |soup: &[[Vec3; 3]]| -> f64 {
        soup.iter().map(|t| f64::from((t[1] - t[0]).cross(t[2] - t[0]).length()) / 2.0).sum()
    };
    let bounds = |soup: &[[Vec3; 3]]| {
        let all = soup.iter().flatten().copied();
        (all.clone().reduce(Vec3::min), all.reduce(Vec3::max))
    };
    say(&format!("{} and {} triangles, areas {} and {}", a.len(), b.len(), area(&a), area(&b)));
    assert!((area(&a) - area(&b)).abs() < 2e-3 * area(&a));
    let (((Some(a0), Some(a1)), (Some(b0), Some(b1))), size) = ((bounds(&a), bounds(&b)), 12.0) else {
        panic!("empty")
    };
    assert!((a0 - b0).length() < 1e-3 * size && (a1 - b1).length() < 1e-3 * size, "{a0} {b0} {a1} {b1}");
}
