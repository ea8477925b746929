//! Decoding of images that materials use, and what is made of them.

use std::{collections::BTreeMap, io::Cursor};

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use rayon::prelude::*;
use serde_json::Value;

use super::{
    document::Document,
    findings::Findings,
    model::{Image, TextureRef},
    read::{linear_to_srgb, srgb_to_linear},
};
use crate::error::Finding;

/// Largest image, texels per side.
const MAX_SIDE: u32 = 16384;
/// Decoded texels of all images together, plus a multiple of the encoded bytes.
const FREE_TEXELS: u64 = 256 << 20;
const FIX: &str = "export the image again as PNG, JPEG or WebP; the material goes on with its factor alone";

/// Images by glTF index, decoded on demand and in parallel.
#[derive(Default)]
pub(crate) struct Images {
    /// Where a glTF image went in `list`; `None` where it could not be read.
    place: BTreeMap<usize, Option<usize>>,
    list: Vec<Image>,
}

impl Images {
    /// Decodes the glTF images `wanted`. Those that fail are warnings.
    pub(crate) fn decode(
        doc: &Document,
        wanted: impl IntoIterator<Item = usize>,
        out: &mut Findings,
    ) -> Self {
        let wanted: Vec<usize> = wanted.into_iter().collect();
        let mut texels = 0;
        let mut jobs = Vec::new();
        for index in wanted {
            let encoded = doc.image_bytes(index).and_then(|(bytes, _)| {
                let (w, h) = size(&bytes).map_err(|what| warning(index, what))?;
                texels += u64::from(w) * u64::from(h);
                if FREE_TEXELS + 256 * doc.total_bytes() < texels {
                    return Err(warning(index, "the images are too large together".to_owned()));
                }
                Ok(bytes)
            });
            jobs.push((index, encoded));
        }
        let decoded: Vec<(usize, Result<Image, Finding>)> = jobs
            .into_par_iter()
            .map(|(index, bytes)| {
                let image =
                    bytes.and_then(|b| decode(&b, &name(doc, index)).map_err(|what| warning(index, what)));
                (index, image)
            })
            .collect();
        let mut images = Self::default();
        for (index, image) in decoded {
            let place = match image {
                Ok(image) => {
                    images.list.push(Image { source: Some(index), ..image });
                    Some(images.list.len() - 1)
                }
                Err(finding) => {
                    // Whatever is wrong with an image, the bake can go on without it.
                    out.push(Finding::warning(finding.path, finding.what, FIX));
                    None
                }
            };
            images.place.insert(index, place);
        }
        images
    }

    /// Index into the scene's images of a glTF image.
    pub(crate) fn place(&self, index: usize) -> Option<usize> {
        self.place.get(&index).copied().flatten()
    }

    /// Gives up the decoded images.
    pub(crate) fn into_list(self) -> Vec<Image> {
        self.list
    }

    /// Makes a base colour image that is darkened where the blue channel of `metal` says metal.
    /// Gives its index. Both are addressed alike; without `base` the result is grey.
    pub(crate) fn blacken(
        &mut self,
        base: Option<&TextureRef>,
        metal: &TextureRef,
        factor: f32,
    ) -> Option<usize> {
        let metal = self.list.get(metal.image)?;
        let base = match base {
            Some(base) => Some(self.list.get(base.image)?),
            None => None,
        };
        let width = base.map_or(0, |b| b.width).max(metal.width);
        let height = base.map_or(0, |b| b.height).max(metal.height);
        let texel = |image: &Image, x: u32, y: u32| {
            // The nearest texel of the smaller image.
            let u = u64::from(x) * u64::from(image.width) / u64::from(width);
            let v = u64::from(y) * u64::from(image.height) / u64::from(height);
            usize::try_from(v * u64::from(image.width) + u).ok().and_then(|i| image.pixels.get(i)).copied()
        };
        let mut pixels = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            for x in 0..width {
                let rest = 1.0 - (f32::from(texel(metal, x, y)?[2]) / 255.0 * factor).clamp(0.0, 1.0);
                let [r, g, b, a] = match base {
                    Some(base) => texel(base, x, y)?,
                    None => [255; 4],
                };
                pixels.push([darken(r, rest), darken(g, rest), darken(b, rest), a]);
            }
        }
        let name = format!("{} without metals", base.map_or(&metal.name, |b| &b.name));
        self.list.push(Image { name, width, height, pixels, source: None });
        Some(self.list.len() - 1)
    }

    /// Mean of the blue channel, 0 to 1: how metallic a texture is on average.
    pub(crate) fn mean_blue(&self, texture: &TextureRef) -> f32 {
        let Some(image) = self.list.get(texture.image) else { return 1.0 };
        let sum: u64 = image.pixels.iter().map(|p| u64::from(p[2])).sum();
        #[expect(clippy::cast_possible_truncation, reason = "rounding a mean is meant")]
        let mean = (sum as f64 / (255.0 * image.pixels.len().max(1) as f64)) as f32;
        mean
    }
}

fn darken(v: u8, rest: f32) -> u8 {
    let out = linear_to_srgb(srgb_to_linear(f32::from(v) / 255.0) * rest) * 255.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the value is in 0 to 255")]
    let out = out.round() as u8;
    out
}

fn warning(index: usize, what: String) -> Finding {
    Finding::warning(format!("images[{index}]"), what, FIX)
}

fn name(doc: &Document, index: usize) -> String {
    let json = &doc.json["images"][index];
    let uri = json["uri"].as_str().filter(|u| !u.starts_with("data:"));
    let text = json["name"].as_str().or(uri).map(|s| s.chars().take(64).collect::<String>());
    text.unwrap_or_else(|| format!("images[{index}]"))
}

fn reader(bytes: &[u8]) -> Result<ImageReader<Cursor<&[u8]>>, String> {
    if bytes.is_empty() {
        return Err("the image is empty".to_owned());
    }
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    match reader.format() {
        Some(ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP) => {}
        _ => return Err("the content is neither PNG, JPEG nor WebP".to_owned()),
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(u64::from(MAX_SIDE) * u64::from(MAX_SIDE) * 8);
    reader.limits(limits);
    Ok(reader)
}

fn size(bytes: &[u8]) -> Result<(u32, u32), String> {
    let decoder = reader(bytes)?.into_decoder().map_err(|e| e.to_string())?;
    Ok(decoder.dimensions())
}

fn decode(bytes: &[u8], name: &str) -> Result<Image, String> {
    let image = reader(bytes)?.decode().map_err(|e| e.to_string())?;
    let image = match image {
        DynamicImage::ImageRgba8(image) => image,
        other => other.into_rgba8(),
    };
    let (width, height) = image.dimensions();
    if width == 0 || height == 0 {
        return Err("the image has no texels".to_owned());
    }
    let pixels = bytemuck::cast_slice::<u8, [u8; 4]>(image.as_raw()).to_vec();
    Ok(Image { name: name.to_owned(), width, height, pixels, source: None })
}

/// The glTF image that a texture shows: WebP where given, else its plain source.
pub(crate) fn source(texture: &Value) -> Option<usize> {
    let webp =
        texture.get("extensions").and_then(|e| e.get("EXT_texture_webp")).and_then(|w| w.get("source"));
    webp.or_else(|| texture.get("source")).and_then(super::read::index_of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn texture(image: usize) -> TextureRef {
        TextureRef {
            image,
            uv_set: 0,
            transform: [Vec3::X, Vec3::Y],
            wrap: Default::default(),
            nearest: false,
        }
    }

    #[test]
    fn metal_is_black_and_the_rest_unchanged() {
        let image = |w: u32, px: Vec<[u8; 4]>| Image {
            name: "i".into(),
            width: w,
            height: 1,
            pixels: px,
            source: None,
        };
        let base = image(1, vec![[200, 100, 50, 77]]);
        let metal = image(2, vec![[0, 0, 255, 0], [0, 0, 0, 0]]);
        let mut images = Images { place: BTreeMap::new(), list: vec![base, metal] };
        let at = images.blacken(Some(&texture(0)), &texture(1), 1.0).expect("combined");
        assert_eq!(images.list[at].pixels, [[0, 0, 0, 77], [200, 100, 50, 77]]);
        assert!((images.mean_blue(&texture(1)) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn a_huge_claim_is_refused_before_decoding() {
        // A PNG header that claims 2^31 - 1 texels a side.
        let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\x7f\xff\xff\xff\x7f\xff\xff\xff\x08\x06\0\0\0".to_vec();
        png.extend([0; 8]);
        assert!(decode(&png, "bomb").is_err());
        assert!(decode(b"", "empty").is_err());
        assert!(decode(b"GIF89a", "gif").is_err());
    }
}
