//! glTF materials: what diffuse light transport needs of them.

use std::collections::BTreeSet;

use glam::{Vec3, Vec4};
use serde_json::Value;

use super::{
    document::Document,
    findings::Findings,
    images::{self, Images},
    model::{AlphaMode, Material, TextureRef, Wrap},
    read::{float, floats, index_of, shown},
};
use crate::error::Finding;

/// Texture coordinate sets beyond this are not read.
pub(crate) const UV_SETS: usize = 8;
const FIX: &str = "correct the material and export again";

/// A material before its images are decoded: texture fields still hold glTF image indices.
struct Draft {
    material: Material,
    /// `metallicFactor` where metals turn black, else 0.
    metallic: f32,
    /// `metallicRoughnessTexture` where metals turn black.
    metal: Option<TextureRef>,
}

impl Draft {
    fn plain(material: Material) -> Self {
        Self { material, metallic: 0.0, metal: None }
    }

    fn textures(&mut self) -> [&mut Option<TextureRef>; 4] {
        let m = &mut self.material;
        [&mut m.base_color_texture, &mut m.emission_texture, &mut m.transmission_texture, &mut self.metal]
    }
}

/// Materials by glTF index with the default material last, and the images of the `used` ones.
pub(crate) fn load(
    doc: &Document,
    used: &BTreeSet<usize>,
    metals_black: bool,
    out: &mut Findings,
) -> (Vec<Material>, Vec<super::model::Image>) {
    let list = doc.json.get("materials").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let mut drafts: Vec<Draft> = Vec::with_capacity(list.len() + 1);
    for (i, json) in list.iter().enumerate() {
        drafts.push(Reader { doc, path: format!("materials[{i}]"), out }.material(
            json,
            used.contains(&i),
            metals_black,
        ));
    }
    drafts.push(Draft::plain(Material { name: "default".to_owned(), ..Material::default() }));
    let mut wanted = BTreeSet::new();
    for draft in &mut drafts {
        wanted.extend(draft.textures().into_iter().flatten().map(|t| t.image));
    }
    let mut images = Images::decode(doc, wanted, out);
    let mut materials = Vec::with_capacity(drafts.len());
    for (i, mut draft) in drafts.into_iter().enumerate() {
        for slot in draft.textures() {
            let place = slot.as_ref().and_then(|t| images.place(t.image));
            match (slot.as_mut(), place) {
                (Some(texture), Some(place)) => texture.image = place,
                _ => *slot = None,
            }
        }
        if 0.0 < draft.metallic {
            blacken(&mut draft, &mut images, &format!("materials[{i}]"), out);
        }
        materials.push(draft.material);
    }
    (materials, images.into_list())
}

/// Multiplies base colour by (1 - metallic).
fn blacken(draft: &mut Draft, images: &mut Images, path: &str, out: &mut Findings) {
    let Draft { material, metallic, metal } = draft;
    let mut constant = *metallic;
    if let Some(metal) = metal.take() {
        let alike = |a: &TextureRef| {
            a.uv_set == metal.uv_set
                && a.transform == metal.transform
                && a.wrap == metal.wrap
                && a.nearest == metal.nearest
        };
        if material.base_color_texture.as_ref().is_none_or(alike)
            && let Some(image) = images.blacken(material.base_color_texture.as_ref(), &metal, *metallic)
        {
            material.base_color_texture = Some(TextureRef { image, ..metal });
            return;
        }
        constant *= images.mean_blue(&metal);
        out.push(Finding::warning(
            path,
            format!("base colour and metallic textures lie differently; {constant} is taken as metallic everywhere"),
            "give both textures the same coordinates",
        ));
    }
    let rest = 1.0 - constant.clamp(0.0, 1.0);
    material.base_color = (material.base_color.truncate() * rest).extend(material.base_color.w);
}

struct Reader<'a> {
    doc: &'a Document,
    path: String,
    out: &'a mut Findings,
}

impl Reader<'_> {
    fn material(&mut self, json: &Value, used: bool, metals_black: bool) -> Draft {
        let fallback = || self.path.clone();
        let name = json["name"].as_str().map_or_else(fallback, |n| n.chars().take(64).collect());
        if !json.is_object() {
            self.warn("", "not an object; the default material is used".to_owned());
            return Draft::plain(Material { name, ..Material::default() });
        }
        let extension =
            |name: &str| json.get("extensions").and_then(|e| e.get(name)).filter(|v| v.is_object());
        let pbr = &json["pbrMetallicRoughness"];
        let glossy = extension("KHR_materials_pbrSpecularGlossiness");
        let (base, base_path, factor, texture) = match glossy {
            Some(g) => {
                (g, "extensions.KHR_materials_pbrSpecularGlossiness", "diffuseFactor", "diffuseTexture")
            }
            None => (pbr, "pbrMetallicRoughness", "baseColorFactor", "baseColorTexture"),
        };
        let mut material = Material { name, ..Material::default() };
        material.base_color = self.color4(base, base_path, factor);
        material.unlit = extension("KHR_materials_unlit").is_some();
        material.double_sided = match &json["doubleSided"] {
            Value::Null => false,
            Value::Bool(b) => *b,
            other => {
                self.warn("doubleSided", format!("{} is neither true nor false", shown(other)));
                false
            }
        };
        material.alpha_mode = self.alpha(json);
        let strength = match extension("KHR_materials_emissive_strength") {
            Some(e) => self.number(
                e,
                "extensions.KHR_materials_emissive_strength",
                "emissiveStrength",
                1.0,
                f32::MAX,
            ),
            None => 1.0,
        };
        material.emission = self.color3(json, "emissiveFactor") * strength;
        if !material.emission.is_finite() {
            self.warn("emissiveFactor", "the emission overflows; it is ignored".to_owned());
            material.emission = Vec3::ZERO;
        }
        let transmission = extension("KHR_materials_transmission");
        if let Some(t) = transmission {
            material.transmission =
                self.number(t, "extensions.KHR_materials_transmission", "transmissionFactor", 0.0, 1.0);
        }
        let (mut metallic, mut metal) = (0.0, None);
        if used {
            material.base_color_texture = self.texture(base, base_path, texture);
            if material.emission != Vec3::ZERO {
                material.emission_texture = self.texture(json, "", "emissiveTexture");
            }
            if let Some(t) = transmission.filter(|_| 0.0 < material.transmission) {
                material.transmission_texture =
                    self.texture(t, "extensions.KHR_materials_transmission", "transmissionTexture");
            }
            if metals_black && glossy.is_none() {
                metallic = self.number(pbr, "pbrMetallicRoughness", "metallicFactor", 1.0, 1.0);
                metal = self.texture(pbr, "pbrMetallicRoughness", "metallicRoughnessTexture");
            }
        }
        Draft { material, metallic, metal }
    }

    fn warn(&mut self, place: &str, what: String) {
        let path = if place.is_empty() { self.path.clone() } else { format!("{}.{place}", self.path) };
        self.out.push(Finding::warning(path, what, FIX));
    }

    /// A number from 0 to `most`; others are clamped with a warning.
    fn number(&mut self, json: &Value, place: &str, key: &str, default: f32, most: f32) -> f32 {
        let Some(value) = json.get(key) else { return default };
        match float(value) {
            Some(f) if (0.0..=most).contains(&f) => f,
            Some(f) => {
                self.warn(&format!("{place}.{key}"), format!("{f} is out of range; it is clamped"));
                f.clamp(0.0, most)
            }
            None => {
                self.warn(
                    &format!("{place}.{key}"),
                    format!("`{}` is not a number; {default} is used", shown(value)),
                );
                default
            }
        }
    }

    fn color4(&mut self, json: &Value, place: &str, key: &str) -> Vec4 {
        let Some(value) = json.get(key) else { return Vec4::ONE };
        let Some(color) = floats::<4>(value).map(Vec4::from) else {
            self.warn(
                &format!("{place}.{key}"),
                format!("`{}` is not four numbers; white is used", shown(value)),
            );
            return Vec4::ONE;
        };
        let clamped = color.clamp(Vec4::ZERO, Vec4::ONE);
        if clamped != color {
            self.warn(&format!("{place}.{key}"), format!("{color} is not from 0 to 1; it is clamped"));
        }
        clamped
    }

    fn color3(&mut self, json: &Value, key: &str) -> Vec3 {
        let Some(value) = json.get(key) else { return Vec3::ZERO };
        let Some(color) = floats::<3>(value).map(Vec3::from) else {
            self.warn(key, format!("`{}` is not three numbers; it is ignored", shown(value)));
            return Vec3::ZERO;
        };
        if color.min_element() < 0.0 {
            self.warn(key, format!("{color} is negative; it is clamped"));
        } else if 1.0 < color.max_element() {
            // Common in older exports; the wish is clear.
            self.warn(key, format!("{color} is above 1; it is taken as written, though KHR_materials_emissive_strength is meant for that"));
        }
        color.max(Vec3::ZERO)
    }

    fn alpha(&mut self, json: &Value) -> AlphaMode {
        let mode = &json["alphaMode"];
        match mode.as_str() {
            Some("MASK") => AlphaMode::Mask(self.number(json, "", "alphaCutoff", 0.5, f32::MAX)),
            Some("BLEND") => AlphaMode::Blend,
            Some("OPAQUE") => AlphaMode::Opaque,
            _ if mode.is_null() => AlphaMode::Opaque,
            _ => {
                self.warn("alphaMode", format!("`{}` is not a mode; OPAQUE is used", shown(mode)));
                AlphaMode::Opaque
            }
        }
    }

    /// A texture slot; the result holds the glTF image index.
    fn texture(&mut self, json: &Value, place: &str, key: &str) -> Option<TextureRef> {
        let info = json.get(key)?;
        let place = if place.is_empty() { key.to_owned() } else { format!("{place}.{key}") };
        let textures = &self.doc.json["textures"];
        let found = info.get("index").and_then(index_of).and_then(|i| Some((i, textures.get(i)?)));
        let Some((index, texture)) = found else {
            self.warn(
                &format!("{place}.index"),
                "there is no such texture; the factor alone is used".to_owned(),
            );
            return None;
        };
        let Some(image) = images::source(texture) else {
            let path = format!("textures[{index}]");
            let what = "the texture has no image that can be read; the factor alone is used";
            self.out.push(Finding::warning(path, what, "export with PNG, JPEG or WebP textures"));
            return None;
        };
        let mut uv_set = info.get("texCoord").map_or(Some(0), index_of).unwrap_or(usize::MAX);
        let mut transform = [Vec3::X, Vec3::Y];
        if let Some(t) = info.get("extensions").and_then(|e| e.get("KHR_texture_transform")) {
            if let Some(set) = t.get("texCoord") {
                uv_set = index_of(set).unwrap_or(usize::MAX);
            }
            match texture_transform(t) {
                Some(rows) => transform = rows,
                None => self.warn(
                    &format!("{place}.extensions.KHR_texture_transform"),
                    "offset, rotation or scale is not made of numbers; the transform is ignored".to_owned(),
                ),
            }
        }
        if UV_SETS <= uv_set {
            self.warn(
                &format!("{place}.texCoord"),
                format!("only sets 0 to {} are read; the factor alone is used", UV_SETS - 1),
            );
            return None;
        }
        let (wrap, nearest) = self.sampler(texture, index);
        Some(TextureRef { image, uv_set, transform, wrap, nearest })
    }

    fn sampler(&mut self, texture: &Value, index: usize) -> ([Wrap; 2], bool) {
        let Some(value) = texture.get("sampler") else { return Default::default() };
        let Some(sampler) = index_of(value).and_then(|i| self.doc.json["samplers"].get(i)) else {
            let path = format!("textures[{index}].sampler");
            self.out.push(Finding::warning(path, "there is no such sampler; the default is used", FIX));
            return Default::default();
        };
        let mut wrap = |key: &str| match sampler.get(key).map(index_of) {
            None | Some(Some(10497)) => Wrap::Repeat,
            Some(Some(33071)) => Wrap::Clamp,
            Some(Some(33648)) => Wrap::Mirror,
            Some(_) => {
                let path = format!("samplers[{value}].{key}");
                self.out.push(Finding::warning(path, "not a wrapping mode; repetition is used", FIX));
                Wrap::Repeat
            }
        };
        let wrap = [wrap("wrapS"), wrap("wrapT")];
        (wrap, sampler.get("magFilter").and_then(index_of) == Some(9728))
    }
}

/// Rows of translation * rotation * scale.
fn texture_transform(json: &Value) -> Option<[Vec3; 2]> {
    let pair = |key: &str, default: [f32; 2]| json.get(key).map_or(Some(default), floats::<2>);
    let [tu, tv] = pair("offset", [0.0, 0.0])?;
    let [su, sv] = pair("scale", [1.0, 1.0])?;
    let (sin, cos) = json.get("rotation").map_or(Some(0.0), float)?.sin_cos();
    Some([Vec3::new(cos * su, sin * sv, tu), Vec3::new(-sin * su, cos * sv, tv)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn load_one(materials: Value, metals_black: bool) -> (Vec<Material>, Vec<Finding>) {
        let json = json!({"asset": {"version": "2.0"}, "materials": materials});
        let doc = Document::from_bytes("x.gltf", json.to_string().as_bytes(), None).expect("opens");
        let mut out = Findings::default();
        let (materials, _) = load(&doc, &BTreeSet::from([0]), metals_black, &mut out);
        (materials, out.finish())
    }

    #[test]
    fn the_transform_turns_counter_clockwise_in_uv() {
        // A quarter turn takes (1, 0) to (0, -1) with v down the image, as the extension defines.
        let t = texture_transform(
            &json!({"rotation": std::f32::consts::FRAC_PI_2, "offset": [0.5, 0.25], "scale": [2, 3]}),
        );
        let [x, y] = t.expect("rows");
        let uv = Vec3::new(1.0, 0.0, 1.0);
        assert!((x.dot(uv) - 0.5).abs() < 1e-6 && (y.dot(uv) + 1.75).abs() < 1e-6, "{x} {y}");
        assert!(texture_transform(&json!({"scale": [1]})).is_none());
    }

    #[test]
    fn extensions_and_metals() {
        let (m, findings) = load_one(
            json!([{
                "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1], "metallicFactor": 0.5},
                "emissiveFactor": [1, 0.5, 0],
                "alphaMode": "MASK",
                "extensions": {
                    "KHR_materials_emissive_strength": {"emissiveStrength": 10},
                    "KHR_materials_transmission": {"transmissionFactor": 0.25},
                    "KHR_materials_unlit": {}
                }
            }]),
            true,
        );
        assert_eq!(findings, []);
        assert_eq!(m.len(), 2);
        assert_eq!(m[0].base_color, Vec4::new(0.25, 0.25, 0.25, 1.0));
        assert_eq!(m[0].emission, Vec3::new(10.0, 5.0, 0.0));
        assert_eq!(m[0].alpha_mode, AlphaMode::Mask(0.5));
        assert!(m[0].unlit && m[0].transmission == 0.25);
        assert_eq!(m[1].base_color, Vec4::ONE);
    }

    #[test]
    fn specular_glossiness_wins() {
        let glossy = json!({"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.1, 0.2, 0.3, 1]}});
        let (m, _) = load_one(json!([{"pbrMetallicRoughness": {}, "extensions": glossy}]), true);
        assert_eq!(m[0].base_color, Vec4::new(0.1, 0.2, 0.3, 1.0));
    }

    #[test]
    fn a_missing_image_leaves_the_factor() {
        let json = json!({
            "asset": {"version": "2.0"},
            "images": [{"uri": "data:image/png;base64,aGk="}],
            "textures": [{"source": 0, "sampler": 3}],
            "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1], "baseColorTexture": {"index": 0}}}]
        });
        let doc = Document::from_bytes("x.gltf", json.to_string().as_bytes(), None).expect("opens");
        let mut out = Findings::default();
        let (m, images) = load(&doc, &BTreeSet::from([0]), false, &mut out);
        assert!(m[0].base_color_texture.is_none() && images.is_empty());
        let paths: Vec<String> = out.finish().into_iter().map(|f| f.path).collect();
        assert_eq!(paths, ["textures[0].sampler", "images[0]"]);
    }
}
