//! Writes small `.glb` files, the same bytes every time.
//!
//! Numbers in the JSON part are the shortest decimal that reads back as the same `f32`.

use glam::{Quat, Vec2, Vec3};
use serde_json::{Map, Value, json};

use crate::shape::Shape;

const FLOAT: u32 = 5126;
const U16: u32 = 5123;
const U32: u32 = 5125;

/// An index handed out by [`Glb`].
pub type Id = usize;

/// A material as glTF spells it.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name.
    pub name: String,
    /// Linear albedo and alpha.
    pub base_color: [f32; 4],
    /// Texture that multiplies `base_color`.
    pub base_color_texture: Option<Id>,
    /// Emitted radiance, nits.
    pub emission: Vec3,
    /// Texture that multiplies `emission`.
    pub emission_texture: Option<Id>,
    /// Cutoff of `alphaMode: MASK`.
    pub mask: Option<f32>,
    /// Whether both sides are there.
    pub double_sided: bool,
    /// Fraction that passes straight through.
    pub transmission: f32,
    /// Red is a factor of that.
    pub transmission_texture: Option<Id>,
    /// Whether the alpha of the base colour is coverage (`alphaMode: BLEND`).
    pub blend: bool,
    /// Normal map.
    pub normal_texture: Option<Id>,
}

impl Material {
    /// One-sided, opaque, without emission. `albedo` is linear.
    #[must_use]
    pub fn matte(name: &str, albedo: impl Into<Vec3>) -> Self {
        Self {
            name: name.into(),
            base_color: albedo.into().extend(1.0).to_array(),
            base_color_texture: None,
            emission: Vec3::ZERO,
            emission_texture: None,
            mask: None,
            double_sided: false,
            transmission: 0.0,
            transmission_texture: None,
            blend: false,
            normal_texture: None,
        }
    }

    /// The same with `emission` in nits.
    #[must_use]
    pub fn emitting(self, emission: impl Into<Vec3>) -> Self {
        Self { emission: emission.into(), ..self }
    }

    /// The same, seen from both sides.
    #[must_use]
    pub fn double_sided(self) -> Self {
        Self { double_sided: true, ..self }
    }

    /// The same with a base colour texture.
    #[must_use]
    pub fn textured(self, texture: Id) -> Self {
        Self { base_color_texture: Some(texture), ..self }
    }
}

/// A light of `KHR_lights_punctual`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Intensity in candela.
    Point,
    /// Intensity in candela; half angles in radians.
    Spot {
        /// Where fall-off starts.
        inner: f32,
        /// Where it ends.
        outer: f32,
    },
    /// Intensity in lux.
    Directional,
}

/// One node of the scene; all of them are roots.
#[derive(Clone, Debug)]
pub struct Node {
    /// Name.
    pub name: String,
    /// Index of a mesh.
    pub mesh: Option<Id>,
    /// Index of a light.
    pub light: Option<Id>,
    /// Index of a camera.
    pub camera: Option<Id>,
    /// Metres.
    pub translation: Vec3,
    /// Unit quaternion.
    pub rotation: Quat,
    /// Per axis.
    pub scale: Vec3,
    /// `extras`, or null.
    pub extras: Value,
    /// `EXT_mesh_gpu_instancing`: translation, rotation, scale of each.
    pub instances: Vec<(Vec3, Quat, Vec3)>,
}

impl Node {
    /// At the origin, with nothing attached.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self {
            name: name.into(),
            mesh: None,
            light: None,
            camera: None,
            translation: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            scale: Vec3::ONE,
            extras: Value::Null,
            instances: Vec::new(),
        }
    }

    /// With a mesh.
    #[must_use]
    pub fn mesh(self, mesh: Id) -> Self {
        Self { mesh: Some(mesh), ..self }
    }

    /// Moved, metres.
    #[must_use]
    pub fn at(self, translation: impl Into<Vec3>) -> Self {
        Self { translation: translation.into(), ..self }
    }

    /// Turned.
    #[must_use]
    pub fn turned(self, rotation: Quat) -> Self {
        Self { rotation, ..self }
    }

    /// Scaled per axis.
    #[must_use]
    pub fn scaled(self, scale: impl Into<Vec3>) -> Self {
        Self { scale: scale.into(), ..self }
    }

    /// With `extras`.
    #[must_use]
    pub fn extras(self, extras: Value) -> Self {
        Self { extras, ..self }
    }
}

/// A file in the making.
#[derive(Debug, Default)]
pub struct Glb {
    bin: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    textures: Vec<Value>,
    images: Vec<Value>,
    cameras: Vec<Value>,
    lights: Vec<Value>,
    nodes: Vec<Value>,
    used: Vec<&'static str>,
    extras: Map<String, Value>,
}

/// An `f32` as the shortest decimal that reads back as itself.
fn num(x: f32) -> Value {
    let shortest: f64 = x.to_string().parse().expect("an f32's own text is a number");
    json!(shortest)
}

fn nums<const N: usize>(xs: [f32; N]) -> Value {
    Value::Array(xs.into_iter().map(num).collect())
}

impl Glb {
    /// An empty file.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets one key of `scenes[0].extras`.
    pub fn scene_extra(&mut self, key: &str, value: Value) {
        self.extras.insert(key.into(), value);
    }

    fn uses(&mut self, extension: &'static str) {
        if !self.used.contains(&extension) {
            self.used.push(extension);
        }
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        while !self.bin.len().is_multiple_of(4) {
            self.bin.push(0);
        }
        let start = self.bin.len();
        self.views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": bytes.len()}));
        self.bin.extend_from_slice(bytes);
        self.views.len() - 1
    }

    fn accessor<const N: usize>(&mut self, rows: &[[f32; N]], bounds: bool) -> usize {
        let bytes: Vec<u8> = rows.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        let mut accessor =
            json!({"bufferView": view, "componentType": FLOAT, "count": rows.len(), "type": kind});
        if bounds && !rows.is_empty() {
            let fold = |f: fn(f32, f32) -> f32| {
                rows.iter().skip(1).fold(rows[0], |a, b| std::array::from_fn(|i| f(a[i], b[i])))
            };
            accessor["min"] = nums(fold(f32::min));
            accessor["max"] = nums(fold(f32::max));
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn indices(&mut self, triangles: &[[u32; 3]]) -> usize {
        let flat: Vec<u32> = triangles.iter().flatten().copied().collect();
        let short: Option<Vec<u16>> =
            flat.iter().map(|&i| u16::try_from(i).ok().filter(|&i| i != u16::MAX)).collect();
        let (kind, bytes): (u32, Vec<u8>) = match short {
            Some(short) => (U16, short.iter().flat_map(|i| i.to_le_bytes()).collect()),
            None => (U32, flat.iter().flat_map(|i| i.to_le_bytes()).collect()),
        };
        let view = self.view(&bytes);
        self.accessors
            .push(json!({"bufferView": view, "componentType": kind, "count": flat.len(), "type": "SCALAR"}));
        self.accessors.len() - 1
    }

    /// Adds a texture from the bytes of a PNG; it repeats and is filtered.
    pub fn texture(&mut self, png: &[u8]) -> Id {
        let view = self.view(png);
        self.images.push(json!({"bufferView": view, "mimeType": "image/png"}));
        self.textures.push(json!({"source": self.images.len() - 1, "sampler": 0}));
        self.textures.len() - 1
    }

    /// Adds a material.
    pub fn material(&mut self, m: &Material) -> Id {
        let mut pbr = json!({
            "baseColorFactor": nums(m.base_color),
            "metallicFactor": 0,
            "roughnessFactor": 0.9,
        });
        if let Some(index) = m.base_color_texture {
            pbr["baseColorTexture"] = json!({"index": index});
        }
        let mut out = json!({"name": m.name, "pbrMetallicRoughness": pbr});
        let strength = m.emission.max_element();
        if 0.0 < strength {
            self.uses("KHR_materials_emissive_strength");
            out["emissiveFactor"] = nums((m.emission / strength).to_array());
            out["extensions"]["KHR_materials_emissive_strength"] = json!({"emissiveStrength": num(strength)});
        }
        if let Some(index) = m.emission_texture {
            out["emissiveTexture"] = json!({"index": index});
        }
        if let Some(index) = m.normal_texture {
            out["normalTexture"] = json!({"index": index});
        }
        if let Some(cutoff) = m.mask {
            out["alphaMode"] = json!("MASK");
            out["alphaCutoff"] = num(cutoff);
        }
        if m.blend {
            out["alphaMode"] = json!("BLEND");
        }
        if m.double_sided {
            out["doubleSided"] = json!(true);
        }
        if 0.0 < m.transmission {
            self.uses("KHR_materials_transmission");
            out["extensions"]["KHR_materials_transmission"] =
                json!({"transmissionFactor": num(m.transmission)});
            if let Some(index) = m.transmission_texture {
                out["extensions"]["KHR_materials_transmission"]["transmissionTexture"] =
                    json!({"index": index});
            }
        }
        self.materials.push(out);
        self.materials.len() - 1
    }

    /// Adds a mesh of one primitive per part. Normals and texture coordinates are left out where the shape has none.
    pub fn mesh(&mut self, name: &str, parts: &[(&Shape, Id)]) -> Id {
        let mut primitives = Vec::with_capacity(parts.len());
        for &(shape, material) in parts {
            let rows: Vec<[f32; 3]> = shape.positions.iter().map(Vec3::to_array).collect();
            let mut attributes = json!({"POSITION": self.accessor(&rows, true)});
            if !shape.normals.is_empty() {
                let rows: Vec<[f32; 3]> = shape.normals.iter().map(Vec3::to_array).collect();
                attributes["NORMAL"] = json!(self.accessor(&rows, false));
            }
            if !shape.uvs.is_empty() {
                let rows: Vec<[f32; 2]> = shape.uvs.iter().map(Vec2::to_array).collect();
                attributes["TEXCOORD_0"] = json!(self.accessor(&rows, false));
            }
            let indices = self.indices(&shape.triangles);
            primitives.push(json!({"attributes": attributes, "indices": indices, "material": material}));
        }
        self.meshes.push(json!({"name": name, "primitives": primitives}));
        self.meshes.len() - 1
    }

    /// Adds a light. `color` is linear and at most 1, `intensity` in the unit of the kind.
    pub fn light(&mut self, name: &str, kind: Kind, color: impl Into<Vec3>, intensity: f32) -> Id {
        self.uses("KHR_lights_punctual");
        let mut light = json!({
            "name": name,
            "type": "point",
            "color": nums(color.into().to_array()),
            "intensity": num(intensity),
        });
        match kind {
            Kind::Point => {}
            Kind::Directional => light["type"] = json!("directional"),
            Kind::Spot { inner, outer } => {
                light["type"] = json!("spot");
                light["spot"] = json!({"innerConeAngle": num(inner), "outerConeAngle": num(outer)});
            }
        }
        self.lights.push(light);
        self.lights.len() - 1
    }

    /// Adds a node with a perspective camera at `eye` that looks at `target`; `yfov` in radians.
    pub fn camera(&mut self, name: &str, eye: Vec3, target: Vec3, yfov: f32) {
        self.cameras.push(json!({
            "name": name,
            "type": "perspective",
            "perspective": {"yfov": num(yfov), "znear": 0.05, "zfar": 200, "aspectRatio": num(16.0 / 9.0)},
        }));
        let node = Node { camera: Some(self.cameras.len() - 1), ..Node::new(name) };
        self.node(node.at(eye).turned(looking(target - eye)));
    }

    /// Adds a node.
    pub fn node(&mut self, n: Node) -> Id {
        let mut out = json!({"name": n.name});
        if let Some(mesh) = n.mesh {
            out["mesh"] = json!(mesh);
        }
        if let Some(camera) = n.camera {
            out["camera"] = json!(camera);
        }
        if n.translation != Vec3::ZERO {
            out["translation"] = nums(n.translation.to_array());
        }
        if n.rotation != Quat::IDENTITY {
            out["rotation"] = nums(n.rotation.to_array());
        }
        if n.scale != Vec3::ONE {
            out["scale"] = nums(n.scale.to_array());
        }
        if let Some(light) = n.light {
            out["extensions"]["KHR_lights_punctual"] = json!({"light": light});
        }
        if !n.instances.is_empty() {
            self.uses("EXT_mesh_gpu_instancing");
            let t: Vec<_> = n.instances.iter().map(|i| i.0.to_array()).collect();
            let r: Vec<_> = n.instances.iter().map(|i| i.1.to_array()).collect();
            let s: Vec<_> = n.instances.iter().map(|i| i.2.to_array()).collect();
            let (t, r, s) = (self.accessor(&t, false), self.accessor(&r, false), self.accessor(&s, false));
            out["extensions"]["EXT_mesh_gpu_instancing"] =
                json!({"attributes": {"TRANSLATION": t, "ROTATION": r, "SCALE": s}});
        }
        if !n.extras.is_null() {
            out["extras"] = n.extras;
        }
        self.nodes.push(out);
        self.nodes.len() - 1
    }

    /// The file's bytes.
    #[must_use]
    pub fn finish(mut self) -> Vec<u8> {
        while !self.bin.len().is_multiple_of(4) {
            self.bin.push(0);
        }
        let roots: Vec<usize> = (0..self.nodes.len()).collect();
        let mut scene = json!({"nodes": roots});
        if !self.extras.is_empty() {
            scene["extras"] = Value::Object(self.extras);
        }
        let mut root = json!({"asset": {"version": "2.0"}});
        if !self.used.is_empty() {
            root["extensionsUsed"] = json!(self.used);
        }
        if self.used.contains(&"EXT_mesh_gpu_instancing") {
            root["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
        }
        root["scene"] = json!(0);
        root["scenes"] = json!([scene]);
        if !self.lights.is_empty() {
            root["extensions"] = json!({"KHR_lights_punctual": {"lights": self.lights}});
        }
        if !self.textures.is_empty() {
            root["samplers"] = json!([{"magFilter": 9729, "minFilter": 9987}]);
        }
        let lists = [
            ("nodes", self.nodes),
            ("meshes", self.meshes),
            ("materials", self.materials),
            ("textures", self.textures),
            ("images", self.images),
            ("cameras", self.cameras),
            ("accessors", self.accessors),
            ("bufferViews", self.views),
        ];
        // glTF forbids empty lists.
        for (key, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            root[key] = Value::Array(list);
        }
        if !self.bin.is_empty() {
            root["buffers"] = json!([{"byteLength": self.bin.len()}]);
        }
        container(&root, &self.bin)
    }
}

/// Wraps JSON and binary chunk in a GLB container.
fn container(root: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = root.to_string().into_bytes();
    while !text.len().is_multiple_of(4) {
        text.push(b' ');
    }
    let word = |n: usize| u32::try_from(n).expect("test scenes are below 4 GB").to_le_bytes();
    let bin_len = if bin.is_empty() { 0 } else { 8 + bin.len() };
    let mut out = Vec::with_capacity(20 + text.len() + bin_len);
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&word(20 + text.len() + bin_len));
    out.extend_from_slice(&word(text.len()));
    out.extend_from_slice(b"JSON");
    out.extend_from_slice(&text);
    if !bin.is_empty() {
        out.extend_from_slice(&word(bin.len()));
        out.extend_from_slice(b"BIN\0");
        out.extend_from_slice(bin);
    }
    out
}

/// The rotation that turns -Z, along which cameras and lights look, to `direction`.
#[must_use]
pub fn looking(direction: Vec3) -> Quat {
    let back = -direction.normalize();
    let up = if back.y.abs() < 0.999 { Vec3::Y } else { Vec3::Z };
    let right = up.cross(back).normalize();
    Quat::from_mat3(&glam::Mat3::from_cols(right, back.cross(right), back)).normalize()
}

/// A PNG of `size` x `size` sRGB texels from a function of column and row (row 0 is the top).
#[must_use]
pub fn png(size: u32, alpha: bool, texel: impl Fn(u32, u32) -> [u8; 4]) -> Vec<u8> {
    use image::{ExtendedColorType, ImageEncoder, codecs::png};
    let color = if alpha { ExtendedColorType::Rgba8 } else { ExtendedColorType::Rgb8 };
    let pixels: Vec<u8> = (0..size)
        .flat_map(|y| (0..size).map(move |x| (x, y)))
        .flat_map(|(x, y)| texel(x, y).into_iter().take(if alpha { 4 } else { 3 }))
        .collect();
    let mut out = Vec::new();
    png::PngEncoder::new_with_quality(&mut out, png::CompressionType::Best, png::FilterType::Adaptive)
        .write_image(&pixels, size, size, color)
        .expect("writing to memory cannot fail");
    out
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    fn scene() -> Vec<u8> {
        let mut glb = Glb::new();
        let white = glb.material(&Material::matte("white", [0.1, 0.5, 0.7]).emitting([2.0, 4.0, 1.0]));
        let mut quad = Shape::default();
        quad.quad([Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y]);
        let mesh = glb.mesh("quad", &[(&quad, white)]);
        glb.node(Node::new("quad").mesh(mesh));
        glb.finish()
    }

    #[test]
    fn the_container_adds_up() {
        let bytes = scene();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(word(8), bytes.len());
        let json: Value = serde_json::from_slice(&bytes[20..20 + word(12)]).unwrap();
        assert_eq!(json["buffers"][0]["byteLength"], word(20 + word(12)));
        let material = &json["materials"][0];
        assert_eq!(material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"], 4.0);
        assert_eq!(material["emissiveFactor"], json!([0.5, 1.0, 0.25]));
        assert_eq!(bytes, scene());
    }

    #[test]
    fn looking_turns_minus_z() {
        for d in [Vec3::new(1.0, 2.0, -3.0), Vec3::NEG_Y, Vec3::Y, Vec3::NEG_Z] {
            let got = looking(d) * Vec3::NEG_Z;
            assert!(got.distance(d.normalize()) < 1e-6, "{d} -> {got}");
        }
    }
}
