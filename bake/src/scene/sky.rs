//! The sky: words, image files, and image-based lights of glTF.

use std::{f32::consts::PI, fs, io::Cursor, path::Path};

use glam::{Quat, Vec3};
use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use serde_json::Value;

use super::{
    document::{Document, InputFile},
    findings::Findings,
    model::{Rgb, Sky},
    read::{Table, floats, index_of, shown, triple, triple_from_text},
};
use crate::error::{Error, Finding};

/// Largest sky image, texels per side.
const MAX_SIDE: u32 = 32768;
/// Most memory that decoding a sky image may take, bytes.
const MAX_ALLOC: u64 = 2 << 30;

/// Reads `--sky COLOUR|FILE`: `1,0.9,0.8` (nits), one number (nits), `#rrggbb` (sRGB, white is
/// 1 nit), or the path of an equirectangular `.hdr` or `.exr` file, relative to `base_dir`.
///
/// # Errors
/// [`Error::Input`] where the text is neither, or the file cannot be read as a sky.
pub fn parse_sky(text: &str, base_dir: &Path) -> Result<Sky, Error> {
    Ok(parse_sky_with_input(text, base_dir)?.0)
}

/// [`parse_sky`] that also gives the file it read, for the manifest.
///
/// # Errors
/// As [`parse_sky`].
pub fn parse_sky_with_input(text: &str, base_dir: &Path) -> Result<(Sky, Option<InputFile>), Error> {
    Ok(read_text(text, base_dir, "sky")?)
}

fn read_text(text: &str, base_dir: &Path, path: &str) -> Result<(Sky, Option<InputFile>), Finding> {
    if let Some(colour) = triple_from_text(text) {
        return uniform(colour, path).map(|s| (s, None));
    }
    let text = text.trim();
    let extension = Path::new(text).extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    if !matches!(extension.as_deref(), Some("hdr" | "exr")) {
        let cut: String = text.chars().take(80).collect();
        let what = format!("`{cut}` is neither a colour nor a .hdr or .exr file");
        return Err(Finding::error(
            path,
            what,
            "write 1,0.9,0.8 or 0.5 or #rrggbb or name an HDR or EXR image",
        ));
    }
    read_file(&base_dir.join(text), text, path).map(|(sky, file)| (sky, Some(file)))
}

fn uniform(colour: Rgb, path: &str) -> Result<Sky, Finding> {
    if colour.min_element() < 0.0 {
        return Err(Finding::error(
            path,
            format!("the colour {colour} is negative"),
            "use values of at least 0 nit",
        ));
    }
    Ok(if colour == Vec3::ZERO { Sky::Black } else { Sky::Uniform(colour) })
}

/// Reads an equirectangular image; `name` is how it was asked for.
fn read_file(file: &Path, name: &str, path: &str) -> Result<(Sky, InputFile), Finding> {
    let bad = |what: String| {
        Finding::error(path, format!("`{name}`: {what}"), "name an equirectangular .hdr or .exr image")
    };
    if !file.is_file() {
        return Err(bad("there is no such file".to_owned()));
    }
    let bytes = fs::read(file).map_err(|e| bad(format!("cannot be read: {e}")))?;
    let sky = decode(&bytes).map_err(bad)?;
    Ok((sky, InputFile::new(name, &bytes)))
}

fn decode(bytes: &[u8]) -> Result<Sky, String> {
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    if !matches!(reader.format(), Some(ImageFormat::Hdr | ImageFormat::OpenExr)) {
        return Err("the content is neither Radiance HDR nor OpenEXR".to_owned());
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_ALLOC);
    reader.limits(limits);
    let image = reader.decode().map_err(|e| e.to_string())?;
    let image = match image {
        DynamicImage::ImageRgb32F(image) => image,
        other => other.into_rgb32f(),
    };
    let (width, height) = (image.width() as usize, image.height() as usize);
    if width == 0 || height == 0 {
        return Err("the image is empty".to_owned());
    }
    let most = image.as_raw().iter().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
    // Suns beyond half precision are stored as infinity; NaN and negative light mean nothing.
    let clean = |v: f32| if v == f32::INFINITY { most } else { v.max(0.0) };
    let pixels = image.pixels().map(|p| Vec3::from(p.0.map(clean))).collect();
    Ok(Sky::Image { width, height, pixels, rotation: Quat::IDENTITY, scale: 1.0 })
}

/// Reads the word `sky` of extras and `bake.toml`. Files read are added to `inputs`.
pub(crate) fn word(
    value: &Value,
    path: &str,
    base_dir: Option<&Path>,
    inputs: &mut Vec<InputFile>,
    out: &mut Findings,
) -> Option<Sky> {
    let here = base_dir.unwrap_or(Path::new(""));
    match value {
        Value::String(text) => {
            let (sky, input) = out.keep(read_text(text, here, path))?;
            inputs.extend(input);
            Some(sky)
        }
        Value::Object(_) => {
            let mut t = Table::new(value, path, out)?;
            let scale = t.number("scale", "a number of at least 0", out, |v| 0.0 <= v).unwrap_or(1.0);
            let degrees = t.number("rotation", "a number of degrees", out, |_| true).unwrap_or(0.0);
            let file = t.text("file", out);
            let colour = t.colour("colour", out).or_else(|| t.colour("color", out));
            let ends = [t.colour("zenith", out), t.colour("horizon", out), t.colour("ground", out)];
            t.finish(false, "", out);
            if let Some(name) = file {
                let (sky, input) = out.keep(read_file(&here.join(&name), &name, &format!("{path}.file")))?;
                inputs.push(input);
                return Some(turned(sky, Quat::from_rotation_y(degrees.to_radians()), scale));
            }
            if let Some(colour) = colour {
                return out.keep(uniform(colour * scale, path));
            }
            if let [Some(zenith), Some(horizon), Some(ground)] = ends {
                return Some(Sky::Gradient {
                    zenith: zenith * scale,
                    horizon: horizon * scale,
                    ground: ground * scale,
                });
            }
            let what = "a sky table needs `file`, or `colour`, or all of `zenith`, `horizon` and `ground`";
            out.push(Finding::error(path, what, "add the missing words"));
            None
        }
        _ => match triple(value) {
            Some(colour) => out.keep(uniform(colour, path)),
            None => {
                let what = format!("{} is not a sky", shown(value));
                out.push(Finding::error(path, what, "write a colour, a table or a file name"));
                None
            }
        },
    }
}

fn turned(sky: Sky, rotation: Quat, scale: f32) -> Sky {
    match sky {
        Sky::Image { width, height, pixels, .. } => Sky::Image { width, height, pixels, rotation, scale },
        other => other,
    }
}

/// The image-based light of a scene (`EXT_lights_image_based`), from its irradiance coefficients.
pub(crate) fn image_based(
    doc: &Document,
    scene: &Value,
    scene_path: &str,
    out: &mut Findings,
) -> Option<Sky> {
    let word = scene.get("extensions")?.get("EXT_lights_image_based")?;
    let fix = "export the image-based light again";
    let index = word.get("light").and_then(index_of);
    let light = index.and_then(|i| doc.json["extensions"]["EXT_lights_image_based"]["lights"].get(i));
    let (Some(index), Some(light)) = (index, light) else {
        let path = format!("{scene_path}.extensions.EXT_lights_image_based.light");
        out.push(Finding::error(path, "there is no such image-based light", fix));
        return None;
    };
    let path = format!("extensions.EXT_lights_image_based.lights[{index}]");
    let list = light["irradianceCoefficients"].as_array().filter(|l| l.len() == 9);
    let coefficients: Option<Vec<Vec3>> =
        list.and_then(|l| l.iter().map(|c| floats::<3>(c).map(Vec3::from)).collect());
    let Some(coefficients) = coefficients else {
        out.push(Finding::error(
            format!("{path}.irradianceCoefficients"),
            "not nine triples of numbers",
            fix,
        ));
        return None;
    };
    let scale = light.get("intensity").and_then(super::read::float).unwrap_or(1.0).max(0.0);
    let rotation = light.get("rotation").and_then(floats::<4>).map(Quat::from_array);
    let rotation = rotation.filter(|q| 0.0 < q.length_squared()).map_or(Quat::IDENTITY, Quat::normalize);
    out.push(Finding::info(
        &path,
        "the sky comes from the irradiance coefficients; the specular images are not used",
        "name the HDR file with --sky for a sharper sky",
    ));
    Some(from_irradiance(&coefficients, rotation, scale))
}

/// Radiance, as a small image, whose irradiance has the given spherical harmonics (orders 0 to 2,
/// lux). Clamped at 0, where a low-order expansion undershoots.
fn from_irradiance(coefficients: &[Vec3], rotation: Quat, scale: f32) -> Sky {
    let (width, height) = (64, 32);
    // Band l of irradiance is that of radiance times pi, 2 pi / 3, pi / 4.
    let bands = [PI, 2.0 * PI / 3.0, PI / 4.0];
    let band = |i: usize| {
        bands[if i == 0 {
            0
        } else if i < 4 {
            1
        } else {
            2
        }]
    };
    let mut pixels = Vec::with_capacity(width * height);
    for row in 0..height {
        for column in 0..width {
            let d = direction(column as f32 + 0.5, row as f32 + 0.5, width, height);
            let sum: Vec3 =
                harmonics(d).iter().zip(coefficients).enumerate().map(|(i, (y, c))| *c * (y / band(i))).sum();
            pixels.push(sum.max(Vec3::ZERO));
        }
    }
    Sky::Image { width, height, pixels, rotation, scale }
}

/// Direction of a place in an equirectangular image: see [`Sky::Image`].
fn direction(x: f32, y: f32, width: usize, height: usize) -> Vec3 {
    let azimuth = (x / width as f32 - 0.5) * 2.0 * PI;
    let polar = y / height as f32 * PI;
    Vec3::new(polar.sin() * azimuth.sin(), polar.cos(), -polar.sin() * azimuth.cos())
}

/// Real orthonormal spherical harmonics of orders 0 to 2, without the Condon-Shortley sign.
fn harmonics(d: Vec3) -> [f32; 9] {
    let Vec3 { x, y, z } = d;
    [
        0.282_094_8,
        0.488_602_5 * y,
        0.488_602_5 * z,
        0.488_602_5 * x,
        1.092_548_4 * x * y,
        1.092_548_4 * y * z,
        0.315_391_57 * (3.0 * z * z - 1.0),
        1.092_548_4 * x * z,
        0.546_274_2 * (x * x - y * y),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_and_files() {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        assert!(
            matches!(parse_sky("1,0.5,0.25", here), Ok(Sky::Uniform(c)) if c == Vec3::new(1.0, 0.5, 0.25))
        );
        assert!(matches!(parse_sky("2", here), Ok(Sky::Uniform(c)) if c == Vec3::splat(2.0)));
        assert!(matches!(parse_sky("0", here), Ok(Sky::Black)));
        assert!(
            matches!(parse_sky("#ffffff", here), Ok(Sky::Uniform(c)) if (c - Vec3::ONE).abs().max_element() < 1e-6)
        );
        for bad in ["-1", "blue", "missing.hdr", "1,2", "Cargo.toml"] {
            assert!(parse_sky(bad, here).is_err(), "{bad}");
        }
    }

    #[test]
    fn hdr_and_exr_round_trip() {
        let dir = tempfile::tempdir().expect("a folder");
        let image = image::Rgb32FImage::from_fn(4, 2, |x, y| image::Rgb([x as f32, y as f32, 0.5]));
        for name in ["a.hdr", "a.exr"] {
            image.save(dir.path().join(name)).expect("saved");
            let (sky, input) = parse_sky_with_input(name, dir.path()).expect("read");
            assert_eq!(input.map(|i| i.path), Some(name.to_owned()));
            let Sky::Image { width: 4, height: 2, pixels, .. } = sky else { panic!("{name}: wrong size") };
            assert!(
                (pixels[6] - Vec3::new(2.0, 1.0, 0.5)).abs().max_element() < 0.02,
                "{name}: {}",
                pixels[6]
            );
        }
    }

    #[test]
    fn irradiance_coefficients_give_back_their_irradiance() {
        // Irradiance pi from everywhere is radiance 1; a y term brightens the top.
        let mut c = vec![Vec3::ZERO; 9];
        c[0] = Vec3::splat(PI / 0.282_094_8);
        c[1] = Vec3::splat(0.5);
        let Sky::Image { width, height, pixels, .. } = from_irradiance(&c, Quat::IDENTITY, 1.0) else {
            panic!("image")
        };
        let mut up = 0.0;
        for (i, p) in pixels.iter().enumerate() {
            let d = direction((i % width) as f32 + 0.5, (i / width) as f32 + 0.5, width, height);
            let solid = (1.0 - d.y * d.y).sqrt() * 2.0 * PI * PI / (width * height) as f32;
            up += p.x * d.y.max(0.0) * solid;
        }
        let want = PI + 0.5 * 0.488_602_5;
        assert!((up - want).abs() < 0.01 * want, "{up} {want}");
    }
}
