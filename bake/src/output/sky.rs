//! An image of the sky as games draw it.
//!
//! `sky.exr` holds the radiance of a sky that is an image, nits as half floats, in the image's own space: the rotation that leads
//! to the world is in the manifest. Texels are means over those of the image that they cover.

use crate::error::Result;
use crate::output::exr;
use crate::output::folder::Staging;
use crate::output::ktx::Half;
use crate::plan::memory::MOST_SKY;
use crate::scene::model::{Rgb, Sky};
use glam::DVec3;
use half::f16;
use rayon::prelude::*;

/// Name of the file.
pub const FILE: &str = "sky.exr";

/// Writes the sky if it is an image; how many values were too great for half floats.
///
/// # Errors
/// [`crate::error::Error::Io`] if it cannot be written.
pub fn write(staging: &Staging, sky: &Sky) -> Result<u64> {
    let Sky::Image { width, height, pixels, scale, .. } = sky else { return Ok(0) };
    let (size, pixels) = smaller(*width, *height, pixels, MOST_SKY);
    let mut half = Half::default();
    let pixels: Vec<[f16; 3]> =
        pixels.into_iter().map(|p| (p * *scale).to_array().map(|v| half.of(v))).collect();
    exr::write_half(&staging.path(FILE), size[0], size[1], &pixels)?;
    Ok(half.clamped)
}

/// An image of at most `most` columns and half as many rows, and its size: each texel is the mean over the box that it covers.
fn smaller(width: usize, height: usize, pixels: &[Rgb], most: usize) -> ([usize; 2], Vec<Rgb>) {
    let rows = (most / 2).max(1);
    if width <= most && height <= rows {
        return ([width, height], pixels.to_vec());
    }
    let size = if width <= most {
        [width, rows.min(height)]
    } else {
        [most, (height * most).div_ceil(width).min(rows)]
    };
    let columns: Vec<Vec<(usize, f64)>> = (0..size[0]).map(|i| covered(i, size[0], width)).collect();
    let row = |y: usize| {
        let rows = covered(y, size[1], height);
        let mean = |columns: &Vec<(usize, f64)>| {
            let mut sum = DVec3::ZERO;
            for (v, part) in &rows {
                for (u, across) in columns {
                    sum += pixels[v * width + u].as_dvec3() * (part * across);
                }
            }
            sum.as_vec3()
        };
        columns.iter().map(mean).collect::<Vec<Rgb>>()
    };
    (size, (0..size[1]).into_par_iter().flat_map_iter(row).collect())
}

/// What part `i` of `n` covers of `of` things in a row: each with its share, all shares together 1.
pub(super) fn covered(i: usize, n: usize, of: usize) -> Vec<(usize, f64)> {
    let (from, to) = (i * of, (i + 1) * of);
    // In units of which each thing has `n` and each part `of`, everything is a whole number.
    let share = |k: usize| {
        let length = to.min((k + 1) * n) - from.max(k * n);
        (k, length as f64 / of as f64)
    };
    (from / n..to.div_ceil(n)).map(share).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};

    #[test]
    fn smaller_images_keep_their_mean() {
        for (width, height, most) in
            [(7, 3, 7), (7, 3, 4), (100, 50, 33), (64, 32, 16), (9, 1, 2), (4, 90, 16), (40, 90, 16)]
        {
            let value = |i: usize| (i * 2_654_435_761 % 1009) as f32;
            let pixels: Vec<Rgb> =
                (0..width * height).map(|i| Vec3::new(value(i), 1.0, 0.5 * value(i + 7))).collect();
            let (size, small) = smaller(width, height, &pixels, most);
            assert!(
                size[0] <= most && size[1] <= (most / 2).max(1) && small.len() == size[0] * size[1],
                "{size:?}"
            );
            let mean = |list: &[Rgb]| list.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / list.len() as f64;
            let (a, b) = (mean(&pixels), mean(&small));
            assert!((a - b).abs().max_element() < 1e-3, "{width} {most}: {a} {b}");
        }
        let all = |n: usize, of: usize| (0..n).flat_map(|i| covered(i, n, of)).collect::<Vec<_>>();
        assert_eq!(all(2, 3), [(0, 2.0 / 3.0), (1, 1.0 / 3.0), (1, 1.0 / 3.0), (2, 2.0 / 3.0)]);
        assert_eq!(all(3, 3), [(0, 1.0), (1, 1.0), (2, 1.0)]);
    }

    #[test]
    fn skies_are_written_as_the_manifest_says() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let staging = Staging::begin(&dir.path().join("out"))?;
        assert_eq!(write(&staging, &Sky::Uniform(Vec3::ONE))?, 0);
        assert!(!staging.path(FILE).exists());
        let mut pixels: Vec<Rgb> = (0..8u8).map(|i| Vec3::splat(f32::from(i))).collect();
        pixels[6].y = 1e6;
        let sky =
            Sky::Image { width: 4, height: 2, pixels, rotation: Quat::from_rotation_y(1.0), scale: 2.0 };
        assert_eq!(write(&staging, &sky)?, 1);
        let back = exr::read(&staging.path(FILE))?;
        let [r, g, _] = back.rgb("").expect("colours");
        assert!(r.half && back.unit.is_none() && back.channels.len() == 3);
        assert_eq!(r.values, [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0]);
        assert_eq!(g.values[6], 65504.0);
        Ok(())
    }
}
