//! How surfaces look beside the light on them.

use anyhow::{Context, Result};
use glam::{Mat3, Vec2, Vec3, Vec4};

use super::accessor;

/// A material of `scene.glb`.
#[derive(Debug, Default)]
pub(crate) struct Material {
    /// Linear, with alpha.
    pub(crate) base: Vec4,
    /// Nits.
    pub(crate) emission: Vec3,
    /// Part of the light that passes straight through.
    pub(crate) transmission: f32,
    /// Part of the surface that is metal.
    pub(crate) metal: f32,
    /// Strength of the normal map.
    pub(crate) bumps: f32,
    /// What alpha means.
    pub(crate) alpha: Alpha,
    /// Drawn from behind, too.
    pub(crate) double_sided: bool,
    /// Shows its base colour, which light leaves as it is.
    pub(crate) unlit: bool,
    /// Base colour, emission, transmission, metal, normals.
    pub(crate) maps: [Option<Map>; MAPS],
}

/// Textures of a material.
pub(crate) const MAPS: usize = 5;

/// What alpha means.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Alpha {
    /// Nothing.
    #[default]
    Opaque,
    /// Where it is below this nothing is there.
    Mask(f32),
    /// Which part of the surface is there.
    Blend,
}

/// A texture and how it lies on the surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Map {
    /// glTF's number of the image.
    pub(crate) image: usize,
    /// Which `TEXCOORD_n`.
    pub(crate) set: u32,
    /// Texture coordinates to those that are looked up.
    pub(crate) transform: Mat3,
    /// What is beyond 0 to 1, along u and v.
    pub(crate) wrap: [Wrap; 2],
    /// Looked up without a filter.
    pub(crate) nearest: bool,
}

/// What is beyond the edge of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Wrap {
    /// The same again.
    Repeat,
    /// The same turned around.
    Mirror,
    /// The texels of the edge.
    Clamp,
}

impl Map {
    /// Where a coordinate is looked up.
    pub(super) fn at(&self, uv: Vec2) -> Vec2 {
        self.transform.transform_point2(uv)
    }
}

impl Material {
    /// What primitives without a material have.
    pub(super) fn standard() -> Self {
        Self { base: Vec4::ONE, bumps: 1.0, metal: 1.0, ..Self::default() }
    }

    /// Whether what is behind it shows.
    pub(crate) fn passes(&self) -> bool {
        self.alpha == Alpha::Blend || 0.0 < self.transmission
    }

    pub(super) fn read(m: &gltf::Material<'_>) -> Self {
        let pbr = m.pbr_metallic_roughness();
        let mut out = Self {
            base: Vec4::from(pbr.base_color_factor()).clamp(Vec4::ZERO, Vec4::ONE),
            emission: Vec3::from(m.emissive_factor()) * m.emissive_strength().unwrap_or(1.0),
            metal: pbr.metallic_factor().clamp(0.0, 1.0),
            double_sided: m.double_sided(),
            unlit: m.unlit(),
            alpha: match m.alpha_mode() {
                gltf::material::AlphaMode::Opaque => Alpha::Opaque,
                gltf::material::AlphaMode::Mask => Alpha::Mask(m.alpha_cutoff().unwrap_or(0.5)),
                gltf::material::AlphaMode::Blend => Alpha::Blend,
            },
            ..Self::standard()
        };
        out.maps[0] = pbr.base_color_texture().and_then(|t| map(&t));
        out.maps[1] = m.emissive_texture().and_then(|t| map(&t));
        out.maps[3] = pbr.metallic_roughness_texture().and_then(|t| map(&t));
        if let Some(gloss) = m.pbr_specular_glossiness() {
            (out.base, out.metal) = (gloss.diffuse_factor().into(), 0.0);
            (out.maps[0], out.maps[3]) = (gloss.diffuse_texture().and_then(|t| map(&t)), None);
        }
        if let Some(t) = m.transmission() {
            out.transmission = t.transmission_factor().clamp(0.0, 1.0);
            out.maps[2] = t.transmission_texture().and_then(|t| map(&t));
        }
        if let Some(n) = m.normal_texture() {
            out.bumps = n.scale();
            // The crate knows no transform of normal textures by itself.
            let extension = n.extension_value("KHR_texture_transform");
            let set = extension.and_then(|e| u32::try_from(e.get("texCoord")?.as_u64()?).ok());
            let transform = extension.map_or(Mat3::IDENTITY, placement);
            out.maps[4] = texture(&n.texture(), set.unwrap_or(n.tex_coord()), transform);
        }
        out
    }
}

/// The matrix of a `KHR_texture_transform`: scaled, turned, shifted.
fn placement(value: &gltf::json::Value) -> Mat3 {
    let number = |v: &gltf::json::Value, i: usize| v.get(i).and_then(gltf::json::Value::as_f64);
    let pair = |key: &str, or: f64| {
        let v = value.get(key);
        [0, 1].map(|i| v.and_then(|v| number(v, i)).unwrap_or(or))
    };
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
    let single = |v: [f64; 2]| Vec2::new(v[0] as f32, v[1] as f32);
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
    let turn = value.get("rotation").and_then(gltf::json::Value::as_f64).unwrap_or(0.0) as f32;
    transform(single(pair("offset", 0.0)), turn, single(pair("scale", 1.0)))
}

fn transform(offset: Vec2, turn: f32, scale: Vec2) -> Mat3 {
    // glTF turns counter-clockwise with v downwards: clockwise in these axes.
    Mat3::from_translation(offset) * Mat3::from_angle(-turn) * Mat3::from_scale(scale)
}

fn map(info: &gltf::texture::Info<'_>) -> Option<Map> {
    let t = info.texture_transform();
    let set = t.as_ref().and_then(gltf::texture::TextureTransform::tex_coord).unwrap_or(info.tex_coord());
    let matrix = t.map_or(Mat3::IDENTITY, |t| transform(t.offset().into(), t.rotation(), t.scale().into()));
    texture(&info.texture(), set, matrix)
}

fn texture(t: &gltf::Texture<'_>, set: u32, transform: Mat3) -> Option<Map> {
    // WebP has a source of its own.
    let webp = t.extension_value("EXT_texture_webp").and_then(|v| v.get("source")?.as_u64());
    let image = match webp {
        Some(n) => usize::try_from(n).ok()?,
        None => t.source()?.index(),
    };
    let wrap = |mode| match mode {
        gltf::texture::WrappingMode::Repeat => Wrap::Repeat,
        gltf::texture::WrappingMode::MirroredRepeat => Wrap::Mirror,
        gltf::texture::WrappingMode::ClampToEdge => Wrap::Clamp,
    };
    let sampler = t.sampler();
    let nearest = sampler.mag_filter() == Some(gltf::texture::MagFilter::Nearest);
    Some(Map { image, set, transform, wrap: [wrap(sampler.wrap_s()), wrap(sampler.wrap_t())], nearest })
}

/// A picture of the scene, 8 bits a channel as they are stored.
#[derive(Debug)]
pub(crate) struct Picture {
    /// Texels per row.
    pub(crate) width: u32,
    /// Rows.
    pub(crate) height: u32,
    /// Red, green, blue, alpha.
    pub(crate) texels: Vec<u8>,
}

impl Picture {
    /// Decodes an image of the file; one that lies beside it is not part of a bake.
    pub(super) fn read(image: &gltf::Image<'_>, blob: &[u8]) -> Result<Option<Self>> {
        let gltf::image::Source::View { view, .. } = image.source() else { return Ok(None) };
        let decoded = image::load_from_memory(accessor::bytes(&view, blob)?)
            .with_context(|| format!("image {} is damaged", image.index()))?;
        let rgba = decoded.to_rgba8();
        Ok(Some(Self { width: rgba.width(), height: rgba.height(), texels: rgba.into_raw() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The order of `KHR_texture_transform`: scale, then rotation, then offset, with v downwards.
    #[test]
    fn textures_are_scaled_turned_and_shifted() {
        let m = transform(Vec2::new(0.5, 0.25), std::f32::consts::FRAC_PI_2, Vec2::new(2.0, 3.0));
        let at = m.transform_point2(Vec2::new(1.0, 1.0));
        assert!((at - Vec2::new(0.5 + 3.0, 0.25 - 2.0)).length() < 1e-5, "{at}");
        let json = serde_json::json!({ "offset": [0.5, 0.25], "rotation": std::f32::consts::FRAC_PI_2, "scale": [2, 3] });
        assert!(placement(&json).abs_diff_eq(m, 1e-6));
        assert_eq!(placement(&serde_json::json!({})), Mat3::IDENTITY);
    }
}
