//! The words of densities that vary: height, noise, grids from files and 3-D stencils.

use glam::{Affine3A, UVec3, Vec3};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

use super::document::InputFile;
use super::findings::Findings;
use super::media_words::Unplaced;
use super::model::{Density, Medium, Region};
use super::read::Table;
use super::voxels::{Unusable, Voxels, ktx, noise::Noise, raw, vdb};
use crate::error::Finding;

/// Where files are found, and which were read.
pub(super) struct Files<'a> {
    pub(super) dir: Option<&'a Path>,
    pub(super) inputs: &'a mut Vec<InputFile>,
    /// The number that stands for `#` in names.
    pub(super) frame: Option<u32>,
}

/// The name of a frame's file: the last run of `#` is the frame's number, with at least as many digits.
fn of_frame(name: &str, frame: u32) -> String {
    let Some(end) = name.rfind('#').map(|at| at + 1) else { return name.to_owned() };
    let begin = name[..end].trim_end_matches('#').len();
    format!("{}{frame:0width$}{}", &name[..begin], &name[end..], width = end - begin)
}

/// A density that may still need to know where it is.
pub(super) enum Source {
    /// Known.
    Known(Density),
    /// A grid that is to be placed.
    Grid(Voxels),
    /// A noise that is to be drawn on a grid.
    Noise(Noise),
}

/// Words of which one names the kind of a density.
const KINDS: [&str; 6] = ["height", "noise", "vdb", "raw", "ktx2", "stencil"];

/// Reads a density that is not a number.
pub(super) fn density(
    value: &Value,
    path: &str,
    files: &mut Files<'_>,
    out: &mut Findings,
) -> Option<Source> {
    let mut t = Table::new(value, path, out)?;
    let given: Vec<&str> = KINDS.into_iter().filter(|kind| t.get(kind).is_some()).collect();
    let source = match given.as_slice() {
        ["height"] => height(&mut t, out).map(Source::Known),
        ["noise"] => noise(&mut t, out).map(Source::Noise),
        ["stencil"] => stencil(&mut t, out),
        ["vdb"] => file(&mut t, "vdb", files, out, |bytes, t, out| {
            let grid = t.text("grid", out);
            Some(vdb::read(bytes, grid.as_deref(), most_bytes()))
        }),
        ["ktx2"] => file(&mut t, "ktx2", files, out, |bytes, _, _| Some(ktx::read(bytes, most_bytes()))),
        ["raw"] => file(&mut t, "raw", files, out, |bytes, t, out| {
            let size = size(t, out);
            let format = match t.word("format", &["u8", "u16", "f16", "f32"], out) {
                Some("u8") => raw::Format::U8,
                Some("u16") => raw::Format::U16,
                Some("f16") => raw::Format::F16,
                _ => raw::Format::F32,
            };
            Some(raw::read(bytes, size?, format, most_bytes()))
        }),
        _ => {
            let what = format!("a density has one of {}", KINDS.join(", "));
            out.push(Finding::error(path, what, "write a number, or for example {\"vdb\": \"smoke.vdb\"}"));
            None
        }
    };
    t.finish(false, "", out);
    source
}

fn height(t: &mut Table<'_>, out: &mut Findings) -> Option<Density> {
    let at = t.at("height");
    let mut t = Table::new(t.get("height")?, at, out)?;
    let base = t.number("base", "a number of metres", out, |_| true).unwrap_or(0.0);
    let falloff = t.number("falloff", "a number of metres above 0", out, |v| 0.0 < v);
    let (at, given) = (t.at("falloff"), t.get("falloff").is_some());
    t.finish(false, "", out);
    if falloff.is_none() && !given {
        let fix = "give the metres over which the density falls by a factor of e";
        out.push(Finding::error(at, "is missing", fix));
    }
    Some(Density::Height { base, falloff: falloff? })
}

fn noise(t: &mut Table<'_>, out: &mut Findings) -> Option<Noise> {
    let at = t.at("noise");
    let mut t = Table::new(t.get("noise")?, at.clone(), out)?;
    let usual = Noise::cloud();
    let whole = |t: &mut Table<'_>, key, usual: u32, out: &mut Findings| {
        let value = t.number(key, "a whole number", out, |v| 0.0 <= v && v.fract() == 0.0 && v < 1e9);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked above")]
        value.map_or(usual, |v| v as u32)
    };
    let octaves = whole(&mut t, "octaves", usual.octaves, out);
    let seed = whole(&mut t, "seed", usual.seed, out);
    let resolution = whole(&mut t, "resolution", usual.resolution, out);
    let number = |t: &mut Table<'_>, key, usual: f32, out: &mut Findings| {
        t.number(key, "a number", out, |_| true).unwrap_or(usual)
    };
    let noise = Noise {
        scale: number(&mut t, "scale", usual.scale, out),
        octaves,
        gain: number(&mut t, "gain", usual.gain, out),
        lacunarity: number(&mut t, "lacunarity", usual.lacunarity, out),
        seed,
        coverage: number(&mut t, "coverage", usual.coverage, out),
        resolution,
    };
    t.finish(false, "", out);
    keep(noise.field(), &at, out).map(|_| noise)
}

fn stencil(t: &mut Table<'_>, out: &mut Findings) -> Option<Source> {
    let at = t.at("stencil");
    let mut t = Table::new(t.get("stencil")?, at.clone(), out)?;
    let size = size(&mut t, out);
    let values = t.read("values", "a list of numbers", out, |v| {
        #[expect(clippy::cast_possible_truncation, reason = "densities are single precision")]
        v.as_array()?.iter().map(|v| v.as_f64().map(|v| v as f32)).collect::<Option<Vec<f32>>>()
    });
    t.finish(false, "", out);
    let (size, values) = (size?, values?);
    let expected = size.as_u64vec3().element_product();
    if expected != values.len() as u64 {
        let what = format!("has {} values, and its size asks for {expected}", values.len());
        out.push(Finding::error(at, what, "give a value for each voxel, x fastest, then y, then z"));
        return None;
    }
    keep(Voxels::dense(size, &values, most_bytes()), &at, out).map(Source::Grid)
}

/// Voxels along x, y and z.
fn size(t: &mut Table<'_>, out: &mut Findings) -> Option<UVec3> {
    let (at, given) = (t.at("size"), t.get("size").is_some());
    let size = t.read("size", "three whole numbers above 0", out, |v| {
        let list = v.as_array().filter(|l| l.len() == 3)?;
        let number = |i: usize| list[i].as_u64().and_then(|n| u32::try_from(n).ok()).filter(|n| 0 < *n);
        Some(UVec3::new(number(0)?, number(1)?, number(2)?))
    });
    if !given {
        out.push(Finding::error(at, "is missing", "give the numbers of voxels along x, y and z"));
    }
    size
}

/// Reads the file that a word names; `read` may ask for more words.
fn file<'a>(
    t: &mut Table<'a>,
    key: &'static str,
    files: &mut Files<'_>,
    out: &mut Findings,
    read: impl FnOnce(&[u8], &mut Table<'a>, &mut Findings) -> Option<Result<Voxels, Unusable>>,
) -> Option<Source> {
    let at = t.at(key);
    let name = t.text(key, out)?;
    let name = match files.frame {
        None if name.contains('#') => {
            let what = format!("`{name}` is a file for each frame");
            out.push(Finding::error(at, what, "say which by --frame, or --frames for several"));
            return None;
        }
        None => name,
        Some(frame) => of_frame(&name, frame),
    };
    let path = files.dir.unwrap_or(Path::new("")).join(&name);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(e) => {
            let what = format!("{}: {e}", path.display());
            out.push(Finding::error(at, what, "correct the name; it is relative to the file that has it"));
            return None;
        }
    };
    files.inputs.push(InputFile::new(&name, &bytes));
    keep(read(&bytes, t, out)?, &at, out).map(Source::Grid)
}

fn keep<T>(result: Result<T, Unusable>, path: &str, out: &mut Findings) -> Option<T> {
    result.map_err(|e| out.push(Finding::error(path, e.what, e.fix))).ok()
}

/// Where the densities of a medium go.
#[derive(Clone, Copy)]
pub(super) struct Place {
    /// Leads out of the space that a file's own place is in.
    pub(super) world_from_space: Affine3A,
    /// The medium's box where it has one.
    pub(super) world_from_unit: Option<Affine3A>,
}

/// Puts the densities of a medium and of what it emits into its region; without a region both are where their grids are.
pub(super) fn settle(
    Unplaced { medium, source, path, glows }: Unplaced,
    place: Place,
    out: &mut Findings,
) -> Vec<Medium> {
    let within_mesh = matches!(medium.region, Region::Mesh(_));
    let absorbs = medium.sigma_a;
    let settled = |medium: Medium, source, place, path: &str, out: &mut Findings| {
        let (density, unit_from_world) = placed(source, within_mesh, place, path, out)?;
        let region = match (medium.region, unit_from_world) {
            (Region::Everywhere, Some(unit_from_world)) => Region::Turned { unit_from_world },
            (region, _) => region,
        };
        let medium = Medium { density, region, ..medium };
        let endless = medium.region == Region::Everywhere;
        // What is only scattered is never gone.
        if endless && (absorbs.cmpeq(Vec3::ZERO) & medium.emission.cmpgt(Vec3::ZERO)).any() {
            let what = "the medium emits without end, and absorbs nothing of it";
            out.push(Finding::error(
                path,
                what,
                "give the medium a `box`, or sigma_a in the channels that it emits",
            ));
            return None;
        }
        Some(medium)
    };
    // Grids of one file are in one space: in a box, what emits is where it is in the grid of the medium's own density, which fills the box.
    let beside = match (&source, place.world_from_unit) {
        (Source::Grid(own), Some(unit)) => {
            own.place().map(|space| unit * per_voxel(own) * space.inverse()).filter(Affine3A::is_finite)
        }
        _ => None,
    };
    let mut parts = Vec::new();
    for (i, glow) in glows.into_iter().enumerate() {
        let Some(source) = glow.source else { continue };
        let part = Medium {
            path: format!("{} emission {}", medium.path, i + 1),
            sigma_s: Vec3::ZERO,
            sigma_a: Vec3::ZERO,
            emission: glow.color,
            g: 0.0,
            density: Density::Constant,
            region: medium.region.clone(),
        };
        let place = match (&source, beside) {
            (Source::Grid(grid), Some(world_from_space)) if grid.place().is_some() => {
                Place { world_from_space, world_from_unit: None }
            }
            _ => place,
        };
        parts.extend(settled(part, source, place, &glow.path, out));
    }
    // What has nothing but grids that emit is these.
    let own =
        if medium.acts() || parts.is_empty() { settled(medium, source, place, &path, out) } else { None };
    own.into_iter().chain(parts).collect()
}

/// A density in its place, and where this leads into the unit cube that a grid fills. A file's own place counts where the medium is in
/// a mesh, or has no box.
fn placed(
    source: Source,
    within_mesh: bool,
    Place { world_from_space, world_from_unit }: Place,
    path: &str,
    out: &mut Findings,
) -> Option<(Density, Option<Affine3A>)> {
    let homeless = |what: &str, out: &mut Findings| {
        out.push(Finding::error(path, what, "give the medium a `box`, or the node a mesh"));
    };
    let (values, world_from_voxels) = match source {
        Source::Known(density) => return Some((density, None)),
        Source::Noise(noise) => {
            let Some(unit) = world_from_unit else {
                homeless("noise needs a place to be in", out);
                return None;
            };
            let values = keep(noise.voxels(unit, most_bytes()), path, out)?;
            let place = unit * per_voxel(&values);
            (values, place)
        }
        Source::Grid(values) => {
            let place = match (values.place(), world_from_unit) {
                (Some(place), unit) if within_mesh || unit.is_none() => world_from_space * place,
                (_, Some(unit)) => unit * per_voxel(&values),
                _ => {
                    homeless("the grid has no place of its own", out);
                    return None;
                }
            };
            (values, place)
        }
    };
    let voxels_from_world = world_from_voxels.inverse();
    let whole = Affine3A::from_scale(values.size().as_vec3());
    let unit_from_world = (world_from_voxels * whole).inverse();
    if !(world_from_voxels.is_finite() && voxels_from_world.is_finite() && unit_from_world.is_finite()) {
        out.push(Finding::error(path, "the grid has no volume where it is", "remove scales of 0"));
        return None;
    }
    let density = Density::Voxels { values: Arc::new(values), voxels_from_world };
    Some((density, Some(unit_from_world)))
}

/// The unit cube from the space of voxels.
fn per_voxel(values: &Voxels) -> Affine3A {
    Affine3A::from_scale(Vec3::ONE / values.size().as_vec3())
}

/// Most that one grid may hold: half of the machine's memory, or 4 GiB where that is not known.
pub(crate) fn most_bytes() -> usize {
    let meminfo = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let kibibytes = meminfo
        .lines()
        .find_map(|line| line.strip_prefix("MemTotal:")?.trim().strip_suffix("kB")?.trim().parse().ok())
        .unwrap_or(8usize << 20);
    kibibytes.saturating_mul(512)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_hashes_are_the_frame() {
        for (name, frame, want) in [
            ("smoke.####.vdb", 12, "smoke.0012.vdb"),
            ("#/s#.raw", 7, "#/s7.raw"),
            ("s_##.raw", 1234, "s_1234.raw"),
            ("still.vdb", 3, "still.vdb"),
        ] {
            assert_eq!(of_frame(name, frame), want);
        }
    }
}
