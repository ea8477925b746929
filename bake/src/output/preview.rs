//! Pictures for people: tone-mapped light and maps of errors, as 8-bit PNG.

use std::{io, path::Path};

use rayon::prelude::*;

use super::page::{Page, PageStats, luminance};
use crate::error::{Error, Result};

/// Luminance after exposure that an average place gets: the reflectance of a photographer's grey card.
const MIDDLE_GREY: f64 = 0.18;
/// Value after exposure that becomes pure white.
const WHITE: f32 = 12.0;
/// Side of the squares of the checker that stands for nothing, texels.
const CHECKER: usize = 8;

/// Exposure for linear colours: 0.18, a photographer's middle grey, over the log-average luminance.
///
/// The darkest and the brightest twentieth are left out of the average, so that neither a lamp nor
/// an all but black corner decides; nor does what is a thousand times darker than the brightest that is
/// left, such as the far sides of bodies in space. Black and non-finite colours do not count. 1 where none
/// is left.
#[must_use]
pub fn auto_exposure(colors: impl Iterator<Item = [f32; 3]>) -> f32 {
    let mut values: Vec<f64> = colors.map(luminance).filter(|l| 0.0 < *l && l.is_finite()).collect();
    values.par_sort_unstable_by(f64::total_cmp);
    let margin = values.len() / 20;
    let middle = &values[margin..values.len() - margin];
    let Some(brightest) = middle.last() else { return 1.0 };
    let middle = &middle[middle.partition_point(|l| *l < 1e-3 * brightest)..];
    #[expect(clippy::cast_precision_loss, reason = "a picture has far fewer than 2^53 pixels")]
    let mean = middle.iter().map(|l| l.ln()).sum::<f64>() / middle.len() as f64;
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
    let exposure = (MIDDLE_GREY / mean.exp()) as f32;
    exposure
}

/// Linear light to sRGB bytes: `x = exposure * colour`, `y = x (1 + x / w^2) / (1 + x)` in each
/// channel with `w = 12`, then the sRGB curve.
///
/// This is \[Rei02\] Reinhard et al., "Photographic tone reproduction for digital images", eq. 4, on
/// channels instead of luminance, so that bright lights go towards white. NaN becomes black.
#[must_use]
pub fn tone_map(color: [f32; 3], exposure: f32) -> [u8; 3] {
    color.map(|c| {
        let x = (c * exposure).max(0.0);
        let y = if x < WHITE { x * (1.0 + x / (WHITE * WHITE)) / (1.0 + x) } else { 1.0 };
        byte(srgb(y))
    })
}

/// Writes linear colours tone-mapped.
///
/// # Errors
/// [`Error::Usage`] if there are not `width * height` colours, [`Error::Io`] if writing fails.
pub fn write_image(
    path: &Path,
    width: usize,
    height: usize,
    pixels: &[[f32; 3]],
    exposure: f32,
) -> Result<()> {
    let bytes: Vec<[u8; 3]> = pixels.par_iter().map(|&c| tone_map(c, exposure)).collect();
    write_png(path, width, height, &bytes)
}

/// Writes a page tone-mapped, exposed as said or for its covered texels, with a checker where nothing covers it.
///
/// # Errors
/// As [`write_image`].
pub fn write_page(path: &Path, page: &Page, exposure: Option<f32>) -> Result<()> {
    let covered = page.radiance.iter().zip(&page.coverage).filter(|(_, a)| 0.0 < **a);
    let exposure = exposure.unwrap_or_else(|| auto_exposure(covered.map(|(c, _)| *c)));
    write_covered(path, page, |i| tone_map(page.radiance[i], exposure))
}

/// Writes the standard error of each covered texel relative to its luminance (at least a hundredth
/// of the page's mean): black at 0.1 % or less, violet, red at 3 %, orange, white at 100 % or more.
///
/// # Errors
/// As [`write_image`].
pub fn write_error(path: &Path, page: &Page) -> Result<()> {
    let floor = 0.01 * PageStats::of(page).mean_luminance();
    write_covered(path, page, |i| {
        let base = luminance(page.radiance[i]).max(floor);
        let error = luminance(page.std_err[i]);
        // Three decades from 1e-3 to 1; an error of 0 is -inf and so black.
        heat(if 0.0 < error { ((error / base).log10() + 3.0) / 3.0 } else { 0.0 })
    })
}

/// Writes sRGB bytes as they are.
///
/// # Errors
/// As [`write_image`].
pub fn write_png(path: &Path, width: usize, height: usize, pixels: &[[u8; 3]]) -> Result<()> {
    let (Ok(w), Ok(h)) = (u32::try_from(width), u32::try_from(height)) else {
        return Err(Error::Usage(format!("{}: {width} x {height} pixels", path.display())));
    };
    if pixels.len() != width * height || pixels.is_empty() {
        let got = pixels.len();
        return Err(Error::Usage(format!("{}: {got} pixels are not {width} x {height}", path.display())));
    }
    let color = image::ExtendedColorType::Rgb8;
    image::save_buffer_with_format(path, pixels.as_flattened(), w, h, color, image::ImageFormat::Png)
        .map_err(|e| match e {
            image::ImageError::IoError(source) => source,
            other => io::Error::other(other.to_string()),
        })
        .map_err(Error::io(path, "cannot write"))
}

fn write_covered(path: &Path, page: &Page, color: impl Fn(usize) -> [u8; 3] + Sync) -> Result<()> {
    if let Some(layer) = page.misshapen_layer() {
        return Err(Error::Usage(format!("{}: layer {layer} has the wrong length", path.display())));
    }
    let pixel =
        |i: usize| if 0.0 < page.coverage[i] { color(i) } else { checker(i % page.width, i / page.width) };
    let pixels: Vec<[u8; 3]> = (0..page.n_texels()).into_par_iter().map(pixel).collect();
    write_png(path, page.width, page.height, &pixels)
}

/// Colour of a texel that shows nothing.
#[must_use]
pub fn checker(x: usize, y: usize) -> [u8; 3] {
    if (x / CHECKER + y / CHECKER).is_multiple_of(2) { [40; 3] } else { [56; 3] }
}

/// Colour for a number in [0, 1]; lighter is more. NaN is green, which is on no scale.
#[must_use]
pub fn heat(t: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] = [
        [0.0, 0.0, 0.0],
        [72.0, 16.0, 120.0],
        [200.0, 40.0, 60.0],
        [250.0, 160.0, 30.0],
        [255.0, 255.0, 240.0],
    ];
    ramp(&STOPS, t)
}

/// Colour for a number in [-1, 1]: blue, white at 0, red. NaN is green.
#[must_use]
pub fn signed_heat(t: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] = [
        [10.0, 20.0, 100.0],
        [90.0, 150.0, 220.0],
        [250.0, 250.0, 250.0],
        [230.0, 130.0, 80.0],
        [110.0, 10.0, 20.0],
    ];
    ramp(&STOPS, 0.5 + 0.5 * t)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the operands are within [0, stops - 1] and [0, 255]"
)]
fn ramp(stops: &[[f64; 3]], t: f64) -> [u8; 3] {
    if t.is_nan() {
        return [0, 255, 0];
    }
    let last = stops.len() - 1;
    let x = t.clamp(0.0, 1.0) * last as f64;
    let i = (x as usize).min(last - 1);
    let f = x - i as f64;
    [0, 1, 2].map(|c| (stops[i][c] * (1.0 - f) + stops[i + 1][c] * f).round() as u8)
}

/// The sRGB curve of IEC 61966-2-1 for values in [0, 1].
fn srgb(x: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to [0, 255]")]
fn byte(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_follows_the_scene_and_not_its_outliers() {
        let grey = |l: f32| [l; 3];
        let scene = || (0..1000).map(|i| grey(2.0 + f32::from(u8::try_from(i % 3).expect("small"))));
        let plain = auto_exposure(scene());
        let with_lamp = auto_exposure(scene().chain(std::iter::repeat_n(grey(1e9), 20)));
        assert!((with_lamp / plain - 1.0).abs() < 0.02, "{plain} {with_lamp}");
        let with_dark = auto_exposure(scene().chain(std::iter::repeat_n(grey(1e-5), 3000)));
        assert!((with_dark / plain - 1.0).abs() < 0.1, "{plain} {with_dark}");
        let doubled = auto_exposure(scene().map(|c| c.map(|v| 2.0 * v)));
        assert!((2.0 * doubled / plain - 1.0).abs() < 1e-6, "{plain} {doubled}");
        assert_eq!(auto_exposure([grey(0.0), grey(f32::NAN), grey(f32::INFINITY)].into_iter()), 1.0);
        assert!((auto_exposure(std::iter::once(grey(0.36))) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn tone_curve_is_monotonic_and_ends_at_white() {
        let mut before = 0;
        for i in 0..2000_u16 {
            let [r, g, b] = tone_map([f32::from(i) * 0.01; 3], 1.0);
            assert!(before <= r && r == g && g == b, "at {i}");
            before = r;
        }
        assert_eq!(tone_map([WHITE, f32::INFINITY, f32::NAN], 1.0), [255, 255, 0]);
        assert_eq!(tone_map([0.0, -1.0, 0.0], 1.0), [0; 3]);
        // Middle grey: 0.18 (1 + 0.18/144) / 1.18 = 0.1527, in sRGB 0.428.
        assert_eq!(tone_map([0.18; 3], 1.0)[0], 109);
    }

    #[test]
    fn uncovered_texels_are_a_checker_and_errors_are_heat() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let mut page = Page::new(16, 16);
        for i in 0..128 {
            page.coverage[i] = 1.0;
            page.radiance[i] = [1.0; 3];
            page.std_err[i] = [if i < 64 { 0.0 } else { 1.0 }; 3];
        }
        let path = dir.path().join("x.png");
        write_page(&path, &page, None)?;
        let png = image::open(&path)?.to_rgb8();
        assert_eq!(png.get_pixel(3, 3).0, tone_map([0.18; 3], 1.0));
        assert_eq!(png.get_pixel(3, 12).0, checker(3, 12));
        assert_ne!(checker(3, 12), checker(12, 12));
        write_error(&path, &page)?;
        let png = image::open(&path)?.to_rgb8();
        assert_eq!(png.get_pixel(0, 0).0, heat(0.0));
        assert_eq!(png.get_pixel(15, 7).0, heat(1.0));
        Ok(())
    }

    #[test]
    fn scales_are_ordered_and_mark_nan() {
        let light = |c: [u8; 3]| c.iter().map(|&v| u32::from(v)).sum::<u32>();
        assert!((0..100).all(|i| light(heat(f64::from(i) / 100.0)) <= light(heat(f64::from(i + 1) / 100.0))));
        assert_eq!(signed_heat(0.0), [250; 3]);
        assert_eq!(signed_heat(-9.0), signed_heat(-1.0));
        assert_eq!(heat(f64::NAN), [0, 255, 0]);
    }

    #[test]
    fn wrong_sizes_are_errors() {
        let path = Path::new("never-written.png");
        assert!(write_image(path, 2, 2, &[[0.0; 3]; 3], 1.0).is_err());
        assert!(write_image(path, 0, 0, &[], 1.0).is_err());
        assert!(!path.exists());
    }
}
