//! The two sides of a comparison, read from files.

use std::path::{Path, PathBuf};

use crate::{
    error::{Error, Result},
    output::{exr, folder},
};

/// Rounding that a sum of 32-bit floats may carry, relative: a few bits above half a unit in the
/// last place.
const ROUNDING_FLOAT: f64 = 1.0 / 1_048_576.0;
/// The same for 16-bit floats: half a unit in the last place.
const ROUNDING_HALF: f64 = 1.0 / 2048.0;

/// Pages of one side.
pub(super) struct Side {
    /// EXR files in page order.
    pub(super) pages: Vec<PathBuf>,
    /// Fewest samples in a texel, where a manifest states it.
    pub(super) samples: Option<u64>,
    /// Whether this is a bake's folder.
    pub(super) is_bake: bool,
}

/// Layers of one page.
#[derive(Debug, PartialEq)]
pub(super) struct Layers {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Red, green, blue, nits.
    pub(super) light: [Vec<f32>; 3],
    pub(super) coverage: Option<Vec<f32>>,
    pub(super) std_err: Option<[Vec<f32>; 3]>,
    /// Relative rounding error of a value.
    pub(super) rounding: f64,
}

impl Layers {
    /// Whether texel `i` counts.
    pub(super) fn covers(&self, i: usize) -> bool {
        self.coverage.as_ref().is_none_or(|c| 0.0 < c[i])
    }

    /// Colour of texel `i`.
    pub(super) fn color(&self, i: usize) -> [f64; 3] {
        [0, 1, 2].map(|c| f64::from(self.light[c][i]))
    }

    /// Whether colour and coverage are the same to the bit.
    pub(super) fn same_bits(&self, o: &Self) -> bool {
        let same = |a: &[f32], b: &[f32]| {
            a.len() == b.len() && a.iter().zip(b).all(|(x, y)| x.to_bits() == y.to_bits())
        };
        let coverage = match (&self.coverage, &o.coverage) {
            (Some(a), Some(b)) => same(a, b),
            (None, None) => true,
            _ => false,
        };
        coverage && (0..3).all(|c| same(&self.light[c], &o.light[c]))
    }
}

/// A bake's folder, or a single EXR.
pub(super) fn open(path: &Path) -> Result<Side> {
    if !path.is_dir() {
        return Ok(Side { pages: vec![path.to_owned()], samples: None, is_bake: false });
    }
    let manifest = folder::read_manifest(path)?;
    Ok(Side {
        pages: manifest.pages.iter().map(|p| folder::resolve(path, &p.file)).collect(),
        samples: Some(manifest.samples.min).filter(|n| 0 < *n),
        is_bake: true,
    })
}

/// Reads what a comparison needs of an EXR: ours, or another program's with `R G B`, a layer's
/// `x.R x.G x.B`, or `Y` alone.
pub(super) fn read(path: &Path) -> Result<Layers> {
    let mut file = exr::read(path)?;
    let (width, height) = (file.width, file.height);
    let prefix = prefix(&file);
    let std_err = take_rgb(&mut file, "stderr.").map(|(values, _)| values);
    let light = match &prefix {
        Some(prefix) => take_rgb(&mut file, prefix),
        None => take(&mut file, "Y").map(|(y, half)| ([y.clone(), y.clone(), y], half)),
    };
    let Some((light, half)) = light else {
        let names: Vec<&str> = file.channels.iter().map(|c| c.name.as_str()).collect();
        let names = names.join(", ");
        return Err(Error::Usage(format!("{}: no colour among the channels {names}", path.display())));
    };
    let coverage = take(&mut file, &format!("{}A", prefix.unwrap_or_default())).map(|(values, _)| values);
    let rounding = if half { ROUNDING_HALF } else { ROUNDING_FLOAT };
    Ok(Layers { width, height, light, coverage, std_err, rounding })
}

/// What stands before `R`, `G` and `B`: nothing if possible, else a layer that looks like the picture.
fn prefix(file: &exr::Exr) -> Option<String> {
    if file.rgb("").is_some() {
        return Some(String::new());
    }
    let layers = file.channels.iter().filter_map(|c| c.name.strip_suffix("R")).filter(|p| p.ends_with('.'));
    let mut layers: Vec<&str> =
        layers.filter(|p| file.rgb(&p[..p.len() - 1]).is_some() && *p != "stderr.").collect();
    // Renderers call the finished picture `Combined`; the names are sorted, so the choice is stable.
    layers.sort_by_key(|p| !p.ends_with("Combined."));
    layers.first().map(|p| (*p).to_owned())
}

fn take_rgb(file: &mut exr::Exr, prefix: &str) -> Option<([Vec<f32>; 3], bool)> {
    let [r, g, b] = ["R", "G", "B"].map(|c| take(file, &format!("{prefix}{c}")));
    let ((r, half_r), (g, half_g), (b, half_b)) = (r?, g?, b?);
    Some(([r, g, b], half_r || half_g || half_b))
}

/// Moves a channel's values out, so that a page is in memory once.
fn take(file: &mut exr::Exr, name: &str) -> Option<(Vec<f32>, bool)> {
    let at = file.channels.iter().position(|c| c.name == name)?;
    let channel = file.channels.remove(at);
    Some((channel.values, channel.half))
}

pub(super) fn file_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}
