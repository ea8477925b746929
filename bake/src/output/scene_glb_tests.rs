//! What `scene.glb` holds, read back through the loader.

use std::path::PathBuf;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use glam::{Vec2, Vec3};

use super::*;
use crate::{
    error::Severity,
    geom::atlas::{self, AtlasOptions, Density, Unwrap},
    scene::{
        config::Config,
        gltf::{self, LoadOptions},
    },
};

/// A document in the making: accessors with their data inline.
struct Maker {
    json: Value,
    bin: Vec<u8>,
}

impl Maker {
    fn new(json: Value) -> Self {
        let mut json = json;
        json["asset"] = json!({ "version": "2.0" });
        json["scene"] = json!(0);
        for key in ["accessors", "bufferViews"] {
            json[key] = json!([]);
        }
        Self { json, bin: Vec::new() }
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let view = json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() });
        self.bin.extend_from_slice(bytes);
        let views = self.json["bufferViews"].as_array_mut().expect("array");
        views.push(view);
        views.len() - 1
    }

    fn accessor(&mut self, kind: &str, component_type: u32, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        let accessors = self.json["accessors"].as_array_mut().expect("array");
        let accessor =
            json!({ "bufferView": view, "componentType": component_type, "count": count, "type": kind });
        accessors.push(accessor);
        accessors.len() - 1
    }

    fn floats(&mut self, kind: &str, count: usize, values: &[f32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(kind, 5126, count, &bytes)
    }

    fn finish(mut self) -> Document {
        let uri = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&self.bin));
        self.json["buffers"] = json!([{ "byteLength": self.bin.len(), "uri": uri }]);
        let text = serde_json::to_vec(&self.json).expect("JSON");
        Document::from_bytes("made.gltf", &text, None).expect("a document")
    }
}

/// What an earlier bake seems to have attached stays where something else uses it.
#[test]
fn textures_that_others_use_stay() {
    let mut json = json!({
        "images": [{ "uri": "a.webp" }, { "uri": "lightmap-0.ktx2" }],
        "textures": [
            { "extensions": { "EXT_texture_webp": { "source": 0 } } },
            { "source": 0 },
            { "source": 1 }
        ],
        "materials": [
            { "extensions": { "MOZ_lightmap": { "index": 1 } } },
            { "extensions": { "MOZ_lightmap": { "index": 2 } } }
        ],
        "nodes": [{ "extensions": { "MX_lightmap": { "index": 1 } } }]
    });
    attach::strip(&mut json);
    assert_eq!(json["images"], json!([{ "uri": "a.webp" }]), "{json:#}");
    assert_eq!(json["textures"].as_array().map(Vec::len), Some(2), "{json:#}");
}

/// A mesh that only bounds something is hidden, also where a surface shows it too, and found again by the next bake.
#[test]
fn meshes_that_bound_are_not_shown() {
    let mut maker = Maker::new(json!({
        "scenes": [{ "nodes": [0, 1, 2] }],
        "nodes": [
            { "mesh": 0, "extras": { "medium": { "shape": "box", "sigma_s": 0.1 } } },
            { "mesh": 0, "translation": [3, 0, 0] },
            { "mesh": 0, "translation": [6, 0, 0], "extras": { "probes": 0.5, "mine": 1 } }
        ],
        "meshes": [{}]
    }));
    let primitive = cube(&mut maker);
    maker.json["meshes"][0] = json!({ "primitives": [primitive] });
    let baked = bake(maker.finish(), Unwrap::Always);
    check(&baked);
    let shown = |d: &Document| [0, 1, 2].map(|n| d.json["nodes"][n].get("mesh").is_some());
    assert_eq!(shown(&baked.again), [false, true, false]);
    assert_eq!(baked.again.json["nodes"][2]["extras"], json!({ "probes": 0.5, "mine": 1, "bounds_mesh": 0 }));
    let about = |s: &Scene| (s.media.clone(), s.probe_boxes.clone(), s.bounds.clone());
    assert_eq!(about(&baked.scene_again), about(&baked.scene));
    assert_eq!(baked.scene.bounds, [(0, 0), (2, 0)]);
    let twice = bake(baked.again, Unwrap::Keep);
    check(&twice);
    assert_eq!(about(&twice.scene_again), about(&baked.scene));
}

/// The faces of a cube on eight shared vertices: every layout has to cut it.
const CUBE: [u16; 36] = [
    0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7,
    5,
];

fn corner(i: u16) -> [f32; 3] {
    [0, 1, 2].map(|axis| f32::from(i >> axis & 1))
}

/// Adds a cube with every kind of attribute and a morph target; its primitive without material.
fn cube(maker: &mut Maker) -> Value {
    let positions: Vec<f32> = (0..8).flat_map(corner).collect();
    let numbered: Vec<f32> = (0..16_u8).map(f32::from).collect();
    let bytes: Vec<u8> = CUBE.iter().flat_map(|c| c.to_le_bytes()).collect();
    // Three bytes an element at a stride of four, as glTF has it.
    let colors: Vec<u8> = (0..8_u8).flat_map(|i| [10 * i, 20 * i, 255 - i, 0]).collect();
    let position = maker.floats("VEC3", 8, &positions);
    maker.json["accessors"][position]["min"] = json!([0.0, 0.0, 0.0]);
    maker.json["accessors"][position]["max"] = json!([1.0, 1.0, 1.0]);
    let color = maker.accessor("VEC3", 5121, 8, &colors);
    let view = maker.json["accessors"][color]["bufferView"].as_u64().expect("view");
    maker.json["bufferViews"][usize::try_from(view).expect("small")]["byteStride"] = json!(4);
    maker.json["accessors"][color]["normalized"] = json!(true);
    let uv = maker.floats("VEC2", 8, &numbered);
    let custom = maker.floats("SCALAR", 8, &numbered[..8]);
    let morph = maker.floats("VEC3", 8, &positions);
    maker.json["accessors"][morph]["min"] = json!([0.0, 0.0, 0.0]);
    maker.json["accessors"][morph]["max"] = json!([1.0, 1.0, 1.0]);
    let indices = maker.accessor("SCALAR", 5123, 36, &bytes);
    json!({
        "attributes": { "POSITION": position, "COLOR_0": color, "TEXCOORD_0": uv, "_NUMBER": custom },
        "indices": indices,
        "targets": [{ "POSITION": morph }],
        "extras": { "mine": 1 }
    })
}

struct Baked {
    document: Document,
    scene: Scene,
    atlas: Atlas,
    bytes: Vec<u8>,
    again: Document,
    scene_again: Scene,
}

fn load(document: &Document) -> Scene {
    let (scene, findings) = gltf::load(document, &Config::default(), &LoadOptions::default());
    let errors: Vec<_> = findings.iter().filter(|f| f.severity == Severity::Error).collect();
    assert!(errors.is_empty(), "{errors:?}");
    scene
}

fn bake(document: Document, unwrap: Unwrap) -> Baked {
    let fit = Density::Fit { page_size: 256 };
    bake_with(document, &AtlasOptions { density: fit, unwrap, ..AtlasOptions::default() })
}

fn bake_with(document: Document, options: &AtlasOptions) -> Baked {
    let scene = load(&document);
    let (atlas, _) = atlas::build(&scene, options, &|_, _| true).expect("an atlas");
    let files: Vec<PageFile> = (0..atlas.pages.len()).map(page_file).collect();
    let (bytes, findings) = build(&document, &scene, &atlas, &files).expect("a file");
    assert!(findings.is_empty(), "{findings:?}");
    let again = Document::from_bytes("scene.glb", &bytes, None).expect("readable");
    let scene_again = load(&again);
    Baked { document, scene, atlas, bytes, again, scene_again }
}

fn page_file(page: usize) -> PageFile {
    PageFile { exr: format!("lightmap-{page}.exr"), texture: Some(format!("lightmap-{page}.ktx2")) }
}

/// Every surface is there again, in its place, with the same triangles, and the placed ones have
/// the atlas' coordinates. Instances may have become nodes.
fn check(baked: &Baked) {
    let Baked { scene, atlas, scene_again, .. } = baked;
    assert_eq!(scene.surfaces.len(), scene_again.surfaces.len());
    let corners = |scene: &Scene, surface: usize| -> Vec<Vec3> {
        let surface = &scene.surfaces[surface];
        let mesh = &scene.meshes[surface.mesh];
        let world = |&i: &u32| surface.world_from_mesh.transform_point3(mesh.positions[i as usize]);
        mesh.triangles.as_flattened().iter().map(world).collect()
    };
    let mut left: Vec<usize> = (0..scene.surfaces.len()).collect();
    for (s, placement) in atlas.placements.iter().enumerate() {
        let expected = corners(scene, s);
        let expected_uvs: Option<Vec<Vec2>> = placement.as_ref().map(|p| {
            atlas.layouts[p.layout].triangles.as_flattened().iter().map(|&v| atlas.page_uv(p, v)).collect()
        });
        let primitive = scene.meshes[scene.surfaces[s].mesh].source.1;
        let close = |a: Vec3, b: Vec3| a.distance(b) <= 1e-5 * (1.0 + a.length());
        let found = left.iter().position(|&t| {
            let surface = &scene_again.surfaces[t];
            let mesh = &scene_again.meshes[surface.mesh];
            let uvs = || -> Vec<Vec2> {
                mesh.triangles.as_flattened().iter().map(|&i| mesh.uvs[1][i as usize]).collect()
            };
            let there = corners(scene_again, t);
            mesh.source.1 == primitive
                && there.len() == expected.len()
                && there.iter().zip(&expected).all(|(a, b)| close(*a, *b))
                && expected_uvs.as_ref().is_none_or(|e| mesh.uvs.get(1).is_some_and(|_| *e == uvs()))
        });
        let path = &scene.surfaces[s].path;
        left.swap_remove(found.unwrap_or_else(|| panic!("{path} is not there again with its coordinates")));
    }
}

#[test]
fn vertices_are_cut_and_all_attributes_go_with_them() {
    let mut maker = Maker::new(json!({
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "name": "a", "mesh": 0 }],
        "meshes": [{}],
        "cameras": [{ "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 1, "znear": 0, "zfar": 9 } }],
        "extras": { "kept": true }
    }));
    let primitive = cube(&mut maker);
    maker.json["meshes"][0] = json!({ "name": "cube", "primitives": [primitive], "weights": [0.5] });
    let baked = bake(maker.finish(), Unwrap::Always);
    check(&baked);
    let primitive = &baked.again.json["meshes"][0]["primitives"][0];
    let get = |name: &str| {
        let i = index(&primitive["attributes"][name]).expect(name);
        baked.again.accessor(i).expect(name)
    };
    let layout = &baked.atlas.layouts[0];
    assert!(8 < layout.vertices.len());
    let numbers = get("_NUMBER").floats();
    assert_eq!(numbers, layout.vertices.iter().map(|&v| v as f32).collect::<Vec<_>>());
    let color = get("COLOR_0");
    assert_eq!((color.component_type, color.normalized, color.count), (5121, true, numbers.len()));
    for (&v, c) in layout.vertices.iter().zip(color.bytes.chunks_exact(3)) {
        let v = u8::try_from(v).expect("small");
        assert_eq!(c, [10 * v, 20 * v, 255 - v]);
    }
    let uv = get("TEXCOORD_0").floats();
    assert!(layout.vertices.iter().zip(uv.chunks_exact(2)).all(|(&v, uv)| uv[0] == 2.0 * v as f32));
    let morph = index(&primitive["targets"][0]["POSITION"]).expect("target");
    assert_eq!(baked.again.accessor(morph).expect("target").bytes, get("POSITION").bytes);
    let position = index(&primitive["attributes"]["POSITION"]).expect("position");
    assert_eq!(baked.again.json["accessors"][position]["max"], json!([1.0, 1.0, 1.0]));
    assert_eq!(primitive["extras"]["mine"], 1);
    let page = json!({ "page": 0, "file": "lightmap-0.exr", "texture": "lightmap-0.ktx2" });
    assert_eq!(primitive["extras"]["lightmap"], page);
    assert_eq!(baked.again.json["cameras"], baked.document.json["cameras"]);
    assert_eq!(baked.again.json["extras"], baked.document.json["extras"]);
    assert_eq!(baked.again.json["meshes"][0]["weights"], json!([0.5]));
}

#[test]
fn a_mesh_shown_twice_shares_all_but_the_coordinates() {
    let mut maker = Maker::new(json!({
        "scenes": [{ "nodes": [0, 1, 2] }],
        "nodes": [
            { "name": "a", "mesh": 0 },
            { "name": "b", "mesh": 0, "translation": [3, 0, 0] },
            { "name": "off", "mesh": 0, "translation": [6, 0, 0], "extras": { "lightmap": "off" } }
        ],
        "meshes": [{}]
    }));
    let primitive = cube(&mut maker);
    maker.json["meshes"][0] = json!({ "primitives": [primitive] });
    let baked = bake(maker.finish(), Unwrap::Always);
    check(&baked);
    let json = &baked.again.json;
    let mesh = |node: usize| index(&json["nodes"][node]["mesh"]).expect("mesh");
    assert_eq!((mesh(0), mesh(1), mesh(2)), (1, 2, 0));
    // The one without a place is as it was.
    let attributes = |mesh: usize| json["meshes"][mesh]["primitives"][0]["attributes"].clone();
    assert!(attributes(0).get("TEXCOORD_1").is_none());
    let (mut a, mut b) = (attributes(1), attributes(2));
    assert_ne!(a["TEXCOORD_1"], b["TEXCOORD_1"]);
    a["TEXCOORD_1"].take();
    b["TEXCOORD_1"].take();
    assert_eq!(a, b);
    assert_eq!(json["meshes"][1]["primitives"][0]["indices"], json["meshes"][2]["primitives"][0]["indices"]);
}

#[test]
fn gpu_instances_become_nodes() {
    let mut maker = Maker::new(json!({
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "name": "grass", "mesh": 0, "translation": [0, 5, 0] }],
        "meshes": [{}],
        "extensionsUsed": ["EXT_mesh_gpu_instancing"],
        "extensionsRequired": ["EXT_mesh_gpu_instancing"]
    }));
    let primitive = cube(&mut maker);
    maker.json["meshes"][0] = json!({ "primitives": [primitive] });
    let translation = maker.floats("VEC3", 3, &[0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 4.0]);
    // Quarter turns about x as normalised bytes, whose length is not exactly 1.
    let rotation = maker.accessor("VEC4", 5120, 3, &[0, 0, 0, 127, 90, 0, 0, 90, 0, 90, 0, 90]);
    maker.json["accessors"][rotation]["normalized"] = json!(true);
    maker.json["nodes"][0]["extensions"] =
        json!({ INSTANCING: { "attributes": { "TRANSLATION": translation, "ROTATION": rotation } } });
    let baked = bake(maker.finish(), Unwrap::Always);
    check(&baked);
    let json = &baked.again.json;
    assert_eq!(json["nodes"][0]["children"], json!([1, 2, 3]));
    assert!(json["nodes"][0].get("mesh").is_none() && json["nodes"][0].get("extensions").is_none());
    assert_eq!(json["nodes"][2]["name"], "grass.1");
    assert_eq!(json["extensionsUsed"], json!(["MOZ_lightmap"]));
    assert!(json.get("extensionsRequired").is_none());
    let rects: BTreeSet<String> =
        (1..4).map(|n| json["nodes"][n]["extras"]["lightmap"][0]["rect"].to_string()).collect();
    assert_eq!(rects.len(), 3, "each instance has a place of its own");
    assert_eq!(json["meshes"].as_array().map(Vec::len), Some(3));
}

#[test]
fn a_second_set_that_textures_use_moves() {
    let texture = json!({ "index": 0, "texCoord": 1 });
    let mut maker = Maker::new(json!({
        "scenes": [{ "nodes": [0, 1] }],
        "nodes": [
            { "name": "on", "mesh": 0 },
            { "name": "off", "mesh": 0, "translation": [4, 0, 0], "extras": { "lightmap": "off" } }
        ],
        "meshes": [{}],
        "images": [{ "mimeType": "image/png" }],
        "textures": [{ "source": 0 }],
        "materials": [
            { "occlusionTexture": texture, "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } },
            { "emissiveTexture": { "index": 0, "extensions": { "KHR_texture_transform": { "texCoord": 1 } } } },
            { "pbrMetallicRoughness": {} }
        ],
        "extensionsUsed": ["KHR_texture_transform"]
    }));
    let mut primitive = cube(&mut maker);
    let second: Vec<f32> = (0..16_u8).map(|i| f32::from(i) / 16.0).collect();
    primitive["attributes"]["TEXCOORD_1"] = json!(maker.floats("VEC2", 8, &second));
    let mut primitives = vec![primitive.clone(), primitive.clone(), primitive];
    primitives.iter_mut().zip(0..).for_each(|(p, i)| p["material"] = json!(i));
    maker.json["meshes"][0] = json!({ "primitives": primitives });
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(1, 1).write_to(&mut png, image::ImageFormat::Png).expect("PNG");
    let view = maker.view(png.get_ref());
    maker.json["images"][0]["bufferView"] = json!(view);
    let baked = bake(maker.finish(), Unwrap::Always);
    check(&baked);
    let json = &baked.again.json;
    let placed = &json["meshes"][1]["primitives"];
    for p in [0, 1] {
        let i = index(&placed[p]["attributes"]["TEXCOORD_2"]).expect("moved");
        let uvs = baked.again.accessor(i).expect("moved").floats();
        let layout = baked.atlas.placements[p].map(|p| &baked.atlas.layouts[p.layout]).expect("placed");
        assert!(layout.vertices.iter().zip(uvs.chunks_exact(2)).all(|(&v, uv)| uv[0] == v as f32 / 8.0));
    }
    assert!(placed[2]["attributes"].get("TEXCOORD_2").is_none(), "nobody uses the third one's set");
    let material = |primitives: &Value, p: usize| {
        json["materials"][index(&primitives[p]["material"]).expect("m")].clone()
    };
    assert_eq!(material(placed, 0)["occlusionTexture"]["texCoord"], 2);
    assert_eq!(material(placed, 0)["pbrMetallicRoughness"]["baseColorTexture"], json!({ "index": 0 }));
    let transform =
        |m: Value| m["emissiveTexture"]["extensions"]["KHR_texture_transform"]["texCoord"].clone();
    assert_eq!(transform(material(placed, 1)), 2);
    let unplaced = &json["meshes"][0]["primitives"];
    assert_eq!(material(unplaced, 0), baked.document.json["materials"][0]);
    assert_eq!(transform(material(unplaced, 1)), 1);
    assert_eq!(baked.again.image_bytes(0).expect("image"), (png.into_inner(), "image/png".to_owned()));
}

#[test]
fn the_same_input_gives_the_same_bytes_and_a_valid_layout() {
    let make = || {
        let mut maker = Maker::new(json!({
            "scenes": [{ "nodes": [0, 1] }], "nodes": [{ "mesh": 0 }, { "mesh": 0, "scale": [2, 2, 2] }], "meshes": [{}]
        }));
        let primitive = cube(&mut maker);
        maker.json["meshes"][0] = json!({ "primitives": [primitive] });
        bake(maker.finish(), Unwrap::Always)
    };
    let (a, b) = (make(), make());
    assert_eq!(a.bytes, b.bytes);
    assert_eq!(a.bytes.len() % 4, 0);
    let json = &a.again.json;
    let mut end = 0;
    for view in json["bufferViews"].as_array().expect("views") {
        let start = view["byteOffset"].as_u64().expect("offset");
        assert!(end <= start && start % 4 == 0, "{view} after {end}");
        end = start + view["byteLength"].as_u64().expect("length");
    }
    assert_eq!(json["buffers"][0]["byteLength"].as_u64(), Some(end));
    // Nothing of the accessors that the cut replaced is left.
    let mut used = BTreeSet::new();
    glb::visit_accessors(&mut json.clone(), &mut |i, _| {
        used.insert(index(i));
    });
    assert_eq!(used.len(), json["accessors"].as_array().map_or(0, Vec::len));
}

#[test]
fn extensions_with_views_of_their_own_are_named() {
    let mut maker = Maker::new(json!({
        "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }], "meshes": [{}],
        "extensionsUsed": ["KHR_audio"]
    }));
    let mut primitive = cube(&mut maker);
    primitive["extensions"] =
        json!({ "EXT_mesh_manifold": { "manifoldPrimitive": { "indices": 2, "mode": 4 } } });
    maker.json["meshes"][0] = json!({ "primitives": [primitive] });
    maker.json["extensions"] = json!({
        "KHR_audio": { "audio": [{ "bufferView": 0 }] },
        "EXT_structural_metadata": { "propertyTables": [{ "count": 1, "properties": { "a": { "values": 3 } } }] }
    });
    let document = maker.finish();
    let (bytes, findings) = build(&document, &Scene::default(), &Atlas::default(), &[]).expect("a file");
    let places: BTreeSet<&str> = findings.iter().map(|f| f.path.as_str()).collect();
    let due = [
        "extensions.EXT_structural_metadata",
        "extensions.KHR_audio",
        "meshes[0].primitives[0].extensions.EXT_mesh_manifold",
    ];
    assert_eq!(places, BTreeSet::from(due), "{findings:?}");
    let again = Document::from_bytes("scene.glb", &bytes, None).expect("readable");
    assert!(again.json.get("extensions").is_none() && again.json.get("extensionsUsed").is_none());
    assert!(again.json["meshes"][0]["primitives"][0].get("extensions").is_none());
}

/// A document with a material of its own kind on each of three cubes: two that share one and lie on
/// different pages, one without any, one that gets no texels.
fn on_two_pages() -> Baked {
    let mut maker = Maker::new(json!({
        "scenes": [{ "nodes": [0, 1, 2, 3] }],
        "nodes": [
            { "name": "a", "mesh": 0 },
            { "name": "b", "mesh": 0, "translation": [3, 0, 0], "extras": { "lightmap": "on", "mine": 1 } },
            { "name": "bare", "mesh": 1, "translation": [6, 0, 0] },
            { "name": "off", "mesh": 0, "translation": [9, 0, 0], "extras": { "lightmap": "off" } }
        ],
        "meshes": [{}, {}],
        "materials": [{ "name": "red", "pbrMetallicRoughness": { "baseColorFactor": [1, 0, 0, 1] } }]
    }));
    let mut primitive = cube(&mut maker);
    maker.json["meshes"][1] = json!({ "primitives": [primitive.clone()] });
    primitive["material"] = json!(0);
    maker.json["meshes"][0] = json!({ "primitives": [primitive] });
    let options = AtlasOptions {
        density: Density::Fixed(16.0),
        max_size: 64,
        unwrap: Unwrap::Always,
        ..AtlasOptions::default()
    };
    let baked = bake_with(maker.finish(), &options);
    assert!(1 < baked.atlas.pages.len(), "the test wants several pages");
    baked
}

#[test]
fn materials_and_nodes_name_their_lightmap() {
    let baked = on_two_pages();
    check(&baked);
    let json = &baked.again.json;
    assert_eq!(json["extensionsUsed"], json!(["MOZ_lightmap"]));
    assert!(json.get("extensionsRequired").is_none());
    let mut materials = BTreeSet::new();
    for (node, placement) in baked.atlas.placements.iter().enumerate().take(3) {
        let placement = placement.expect("it has texels");
        let primitive = &json["meshes"][index(&json["nodes"][node]["mesh"]).expect("mesh")]["primitives"][0];
        let m = index(&primitive["material"]).expect("a material");
        materials.insert(m);
        let material = &json["materials"][m];
        let colour = (node < 2).then_some(json!([1, 0, 0, 1]));
        assert_eq!(material.pointer("/pbrMetallicRoughness/baseColorFactor"), colour.as_ref());
        let lightmap = &material["extensions"]["MOZ_lightmap"];
        assert_eq!((&lightmap["texCoord"], &lightmap["intensity"]), (&json!(1), &json!(1)));
        let texture = &json["textures"][index(&lightmap["index"]).expect("texture")];
        let image = &json["images"][index(&texture["source"]).expect("image")];
        let file = format!("lightmap-{}", placement.page);
        assert_eq!(image, &json!({ "name": file, "uri": format!("{file}.ktx2") }));
        let sampler = &json["samplers"][index(&texture["sampler"]).expect("sampler")];
        assert_eq!((&sampler["minFilter"], &sampler["wrapS"]), (&json!(9729), &json!(33071)));
        let ([x, y], [width, height]) = (placement.min, placement.size);
        let page = baked.atlas.pages[placement.page];
        let place = &json["nodes"][node]["extras"]["lightmap"][0];
        assert_eq!(place["rect"], json!({ "x": x, "y": y, "width": width, "height": height }));
        let right = place["uv_rect"]["max"][0].as_f64().expect("a number");
        assert!((right * f64::from(page.width) - f64::from(x + width)).abs() < 1e-3, "{place}");
        assert_eq!((&place["page"], &place["primitive"]), (&json!(placement.page), &json!(0)));
        assert_eq!(place["file"], format!("{file}.exr"));
        assert_eq!(place["unit"], "radiance_white_lambert_nits");
    }
    assert_eq!(json["nodes"][1]["extras"]["mine"], 1);
    let off = &json["meshes"][index(&json["nodes"][3]["mesh"]).expect("mesh")]["primitives"][0];
    assert!(!materials.contains(&index(&off["material"]).expect("material")));
    assert_eq!(json["nodes"][3]["extras"], json!({ "lightmap": "off" }));
    assert_eq!(baked.document.json["materials"][0], json["materials"][index(&off["material"]).expect("m")]);
}

/// Whether numbers are others stretched, moved, or turned round.
fn follows(got: impl Iterator<Item = f32>, want: impl Iterator<Item = f32>) -> bool {
    let unit = |values: Vec<f32>| -> Vec<f32> {
        let low = values.iter().copied().fold(f32::INFINITY, f32::min);
        let high = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        values.iter().map(|v| (v - low) / (high - low)).collect()
    };
    let (got, want) = (unit(got.collect()), unit(want.collect()));
    let near = |turn: fn(f32) -> f32| got.iter().zip(&want).all(|(g, w)| (turn(*g) - w).abs() < 1e-4);
    near(|v| v) || near(|v| 1.0 - v)
}

#[test]
fn what_was_baked_keeps_its_coordinates_and_does_not_grow() {
    for unwrap in [Unwrap::Keep, Unwrap::Auto] {
        let first = bake(on_two_pages().document, Unwrap::Always);
        let coordinates = |baked: &Baked| -> Vec<Vec<f32>> {
            let node = |n: usize| index(&baked.again.json["nodes"][n]["mesh"]).expect("mesh");
            let accessor = |mesh: usize| {
                let attributes = &baked.again.json["meshes"][mesh]["primitives"][0]["attributes"];
                index(&attributes["TEXCOORD_1"]).expect("coordinates")
            };
            (0..3).map(|n| baked.again.accessor(accessor(node(n))).expect("accessor").floats()).collect()
        };
        let wanted = coordinates(&first);
        let counts = |baked: &Baked| {
            ["materials", "textures", "images", "samplers", "meshes"]
                .map(|key| baked.again.json[key].as_array().map_or(0, Vec::len))
        };
        let n_wanted = counts(&first);
        let second = bake(first.again, unwrap);
        check(&second);
        assert!(second.atlas.layouts.iter().all(|l| l.kept));
        for (got, want) in coordinates(&second).iter().zip(&wanted) {
            assert_eq!(got.len(), want.len());
            if unwrap == Unwrap::Keep {
                // The whole atlas is kept; a thousandth of a texel of a page of 256 for rounding.
                let worst = got.iter().zip(want).map(|(g, w)| (g - w).abs()).fold(0.0, f32::max);
                assert!(worst < 4e-6, "{worst}");
            } else {
                // Each layout is kept, in a rectangle of its own.
                let axis =
                    |list: &'_ [f32], k: usize| list.iter().skip(k).step_by(2).copied().collect::<Vec<_>>();
                let same = |g: usize, w: usize| follows(axis(got, g).into_iter(), axis(want, w).into_iter());
                assert!(same(0, 0) && same(1, 1) || same(0, 1) && same(1, 0));
            }
        }
        if unwrap == Unwrap::Keep {
            assert_eq!(second.atlas.pages, first.atlas.pages);
        }
        assert_eq!(counts(&second), n_wanted);
        assert_eq!(second.again.json["extensionsUsed"], json!(["MOZ_lightmap"]));
    }
}

/// Scenes of every exporter we have.
#[test]
fn real_scenes_survive() {
    let shared = std::env::var_os("BAKE_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    for name in [
        "scenes/bevy-cornell-box/CornellBox.glb",
        "scenes/bevy-mixed-lighting/MixedLightingExample.gltf",
        "scenes/cornell-fazil/cornell-box.glb",
        "scenes/lights-bevy-cubes/Cubes.glb",
        "scenes/lights-pc/Lights.glb",
    ] {
        let path = shared.join(name);
        if !path.is_file() {
            #[expect(clippy::print_stdout, reason = "a test without its input says so")]
            {
                println!("skipped: {} is absent", path.display());
            }
            continue;
        }
        check(&bake(Document::open(&path).expect("a document"), Unwrap::Auto));
    }
}
