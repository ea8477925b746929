//! Lightmaps. A texel is `E / pi` in nits, linear Rec. 709; row 0 is the top.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use exr::prelude as exr;
use glam::Vec3;
use half::f16;
use ktx2::Format;
use tables::format::manifest;

use super::{LUMINANCE, ktx};

/// One page.
#[derive(Debug)]
pub(crate) struct Page {
    /// Texels per row.
    pub(crate) width: u32,
    /// Rows.
    pub(crate) height: u32,
    /// Light, as the file that was asked for holds it.
    pub(crate) light: Texels,
    /// Three layers of half floats, x, y and z: a normal m beside the surface's own n has `light + x (m - n).x + y (m - n).y + z (m - n).z`.
    pub(crate) directions: Option<ktx::Image>,
    /// Of each texel the standard error as a part of its luminance, coverage, and 1 where it lay inside of something and was filled from others.
    pub(crate) figures: Vec<[f16; 4]>,
    /// Luminance over covered texels, nits.
    pub(crate) mean_luminance: f32,
    /// Light over covered texels, nits.
    pub(crate) mean: Vec3,
}

/// How light is stored.
#[derive(Debug)]
pub(crate) enum Texels {
    /// `lightmap-N.ktx2`, as a game takes it.
    Texture(ktx::Image),
    /// `lightmap-N.exr`, red, green, blue, 1.
    Floats(Vec<[f32; 4]>),
}

/// Which file the light of pages is read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Source {
    /// The texture, as a game takes it; the EXR where there is none.
    Ktx2,
    /// The EXR, 32-bit floats.
    Exr,
}

/// Standard errors are parts of at least this part of the page's mean.
const DARK: f32 = 1e-2;

impl Page {
    /// Reads what the manifest says of a page. `blocks` says whether textures in blocks can be drawn; else they are unpacked.
    ///
    /// # Errors
    ///
    /// Where a file is missing, damaged, or not of the size that the manifest states.
    pub(crate) fn open(dir: &Path, entry: &manifest::Page, source: Source, blocks: bool) -> Result<Self> {
        let path = dir.join(&entry.file);
        let name = path.display();
        let image = exr::read_first_flat_layer_from_file(&path)
            .with_context(|| format!("{name}: the page is missing or damaged; bake again"))?;
        let (size, channels) = (image.layer_data.size, &image.layer_data.channel_data.list);
        let said = (entry.width as usize, entry.height as usize);
        ensure!(
            said == (size.x(), size.y()),
            "{name}: {} x {} texels, the manifest says {} x {}; bake again",
            size.x(),
            size.y(),
            said.0,
            said.1
        );
        let find = |wanted: &str| {
            let found = channels.iter().find(|c| c.name.eq(wanted))?;
            let values: Vec<f32> = found.sample_data.values_as_f32().collect();
            // A channel may have fewer samples than the page has texels.
            Some(values).filter(|v| v.len() == size.area())
        };
        let channel = |wanted: &str| {
            find(wanted).with_context(|| format!("{name}: there is no channel {wanted}; bake again"))
        };
        let three = |r: &str, g: &str, b: &str| -> Result<Vec<Vec3>> {
            let (r, g, b) = (channel(r)?, channel(g)?, channel(b)?);
            Ok(r.iter().zip(&g).zip(&b).map(|((&r, &g), &b)| Vec3::new(r, g, b)).collect())
        };
        let (light, coverage) = (three("R", "G", "B")?, channel("A")?);
        let errors = three("stderr.R", "stderr.G", "stderr.B")?;
        let filled = find("filled").unwrap_or_default();
        let (mut sum, mut n) = (glam::DVec3::ZERO, 0u32);
        for (l, _) in light.iter().zip(&coverage).filter(|(l, a)| 0.0 < **a && l.is_finite()) {
            (sum, n) = (sum + l.as_dvec3(), n + 1);
        }
        let mean = (sum / f64::from(n.max(1))).as_vec3();
        let mean_luminance = mean.dot(LUMINANCE);
        let figure = |i: usize| {
            let least = (DARK * mean_luminance).max(f32::MIN_POSITIVE);
            let relative = errors[i].dot(LUMINANCE) / light[i].dot(LUMINANCE).max(least);
            let filled = filled.get(i).copied().unwrap_or(0.0);
            [relative.min(1e4), coverage[i], filled, 0.0].map(f16::from_f32)
        };
        let figures = (0..light.len()).map(figure).collect();
        let texture = entry.texture.as_ref().filter(|_| source == Source::Ktx2);
        let texture = texture.map(|file| sized(dir, file, entry)).transpose()?;
        if let (Some(t), Some(file)) = (&texture, &entry.texture) {
            let known = matches!(t.format, Format::BC6H_UFLOAT_BLOCK | Format::R16G16B16A16_SFLOAT);
            ensure!(known && t.layers == 1, "{}: not a lightmap; bake again", dir.join(file).display());
        }
        let light = match texture {
            Some(texture) => Texels::Texture(if blocks { texture } else { texture.unpacked() }),
            None => Texels::Floats(light.iter().map(|l| l.extend(1.0).to_array()).collect()),
        };
        let directions = entry.directions.as_ref().map(|file| sized(dir, file, entry)).transpose()?;
        if let Some(d) = &directions {
            let right = d.layers == 3 && d.format == Format::R16G16B16A16_SFLOAT;
            ensure!(
                right,
                "{}: not three layers of half floats; bake again",
                dir.join(file(entry)).display()
            );
        }
        Ok(Self {
            width: entry.width,
            height: entry.height,
            light,
            directions,
            figures,
            mean_luminance,
            mean,
        })
    }
}

fn file(entry: &manifest::Page) -> &str {
    entry.directions.as_deref().unwrap_or_default()
}

/// A texture that is as large as its page.
fn sized(dir: &Path, file: &str, entry: &manifest::Page) -> Result<ktx::Image> {
    let path = dir.join(file);
    let image = ktx::read(&path)?;
    let name = path.display();
    ensure!(image.size == [entry.width, entry.height, 1], "{name}: not of the size of its page; bake again");
    Ok(image)
}
