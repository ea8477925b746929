//! Pictures of where two images differ.

use std::path::Path;

use super::{
    equality,
    figures::{Sums, compared},
    input::Layers,
};
use crate::{
    error::Result,
    output::{exr, preview},
};

/// |z| shown in full colour.
const Z_SCALE: f64 = 4.0;

/// What [`write`] wrote.
pub(super) struct Written {
    /// File names.
    pub(super) files: Vec<String>,
    /// Difference shown in full colour, nits.
    pub(super) scale: f64,
}

/// Writes the pictures of one page into `out`; those of z where it was `tested`.
pub(super) fn write(
    out: &Path,
    page: usize,
    a: &Layers,
    b: &Layers,
    sums: &Sums,
    tested: bool,
) -> Result<Written> {
    let (width, height) = (a.width, a.height);
    // Three times the root mean square leaves few texels beyond the scale, whatever its size.
    let scale = 3.0 * sums.rmse();
    let name = |what: &str| format!("{what}-{page}");
    let mut files = vec![name("difference") + ".png", name("difference") + ".exr"];
    let paint = |value: &dyn Fn(usize) -> f64| -> Vec<[u8; 3]> {
        let pixel = |i: usize| {
            if compared(a, b, i) {
                preview::signed_heat(value(i))
            } else {
                preview::checker(i % width, i / width)
            }
        };
        (0..width * height).map(pixel).collect()
    };
    let difference = |i: usize| {
        let (a, b) = (a.color(i), b.color(i));
        [0, 1, 2].map(|c| a[c] - b[c])
    };
    let strongest =
        |values: [f64; 3]| values.into_iter().fold(0.0, |m: f64, v| if m.abs() < v.abs() { v } else { m });
    let picture = paint(&|i| if 0.0 < scale { strongest(difference(i)) / scale } else { 0.0 });
    preview::write_png(&out.join(&files[0]), width, height, &picture)?;
    #[expect(clippy::cast_possible_truncation, reason = "the difference of two 32-bit floats, for a picture")]
    let raw: Vec<[f32; 3]> = (0..width * height)
        .map(|i| if compared(a, b, i) { difference(i).map(|d| d as f32) } else { [0.0; 3] })
        .collect();
    exr::write_rgb(&out.join(&files[1]), width, height, &raw)?;
    if tested {
        let z = |i: usize, channel: usize| equality::z(a, b, i, channel).unwrap_or(0.0);
        let picture = paint(&|i| strongest([0, 1, 2].map(|c| z(i, c))) / Z_SCALE);
        let file = name("z") + ".png";
        preview::write_png(&out.join(&file), width, height, &picture)?;
        files.push(file);
    }
    Ok(Written { files, scale })
}
