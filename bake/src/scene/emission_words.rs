//! The words of media that glow.

use glam::Vec3;
use serde_json::Value;

use super::black_body;
use super::density::{Files, Source, density};
use super::findings::Findings;
use super::model::Rgb;
use super::read::{Table, shown, triple};
use super::voxels::Voxels;
use crate::error::Finding;

/// Emission that may still need to know where it is.
pub(super) struct Glow {
    /// Where its density is 1, nits per metre.
    pub(super) color: Rgb,
    /// `None` where it follows the medium's own density.
    pub(super) source: Option<Source>,
    /// Where it stands in the file.
    pub(super) path: String,
}

/// Words beside those of a density.
const OWN: [&str; 3] = ["color", "strength", "kelvin"];

/// Reads `emission`: a number or colour, a table, or a list of these.
pub(super) fn emission(t: &mut Table<'_>, files: &mut Files<'_>, out: &mut Findings) -> Vec<Glow> {
    let path = t.at("emission");
    match t.get("emission") {
        None => Vec::new(),
        Some(Value::Array(list)) if list.iter().any(|v| !v.is_number()) => {
            let each = |(i, v)| one(v, &format!("{path}[{i}]"), files, out);
            list.iter().enumerate().flat_map(each).collect()
        }
        Some(value) => one(value, &path, files, out),
    }
}

fn one(value: &Value, path: &str, files: &mut Files<'_>, out: &mut Findings) -> Vec<Glow> {
    let plain = |color| vec![Glow { color, source: None, path: path.to_owned() }];
    let Value::Object(words) = value else {
        let color = triple(value).filter(|c| 0.0 <= c.min_element() && c.is_finite());
        if color.is_none() {
            let what = format!("`{}` is no emission", shown(value));
            let fix = "write nits per metre, or a table such as {\"vdb\": \"fire.vdb\", \"grid\": \"flame\", \"strength\": 100}";
            out.push(Finding::error(path, what, fix));
        }
        return color.map_or_else(Vec::new, plain);
    };
    let own = Value::Object(words.iter().filter(|w| OWN.contains(&w.0.as_str())).map(clone).collect());
    let rest = Value::Object(words.iter().filter(|w| !OWN.contains(&w.0.as_str())).map(clone).collect());
    let Some(mut t) = Table::new(&own, path, out) else { return Vec::new() };
    let color = t.colour("color", out).unwrap_or(Vec3::ONE);
    let strength = t.number("strength", "a number that is not negative", out, |v| 0.0 <= v).unwrap_or(1.0);
    let kelvin = t.number("kelvin", "a number above 0", out, |v| 0.0 < v);
    let color = color * strength;
    if !color.is_finite() {
        let what = "color times strength is beyond what single precision holds";
        out.push(Finding::error(path, what, "give nits per metre"));
        return Vec::new();
    }
    if rest.as_object().is_none_or(serde_json::Map::is_empty) {
        if kelvin.is_some() {
            let what = "kelvin is for a grid of temperatures";
            out.push(Finding::error(
                t.at("kelvin"),
                what,
                "name the grid, such as {\"vdb\": \"fire.vdb\", ...}",
            ));
            return Vec::new();
        }
        return plain(color);
    }
    let Some(source) = density(&rest, path, files, out) else { return Vec::new() };
    let Some(kelvin) = kelvin else {
        return vec![Glow { color, source: Some(source), path: path.to_owned() }];
    };
    let Source::Grid(grid) = source else {
        out.push(Finding::error(
            path,
            "kelvin is for a grid of temperatures",
            "name a vdb, raw, ktx2 or stencil",
        ));
        return Vec::new();
    };
    let most = black_body::radiance(grid.most() * kelvin) * color;
    if !most.is_finite() {
        let what = format!(
            "the light of {} K times strength is beyond what single precision holds",
            grid.most() * kelvin
        );
        out.push(Finding::error(path, what, "lower kelvin or strength"));
        return Vec::new();
    }
    let list = channels(&grid, kelvin, color, path);
    if list.is_empty() {
        let most = grid.most() * kelvin;
        let what = format!("nothing glows: the hottest voxel has {most} K");
        out.push(Finding::warning(
            path,
            what,
            "write in `kelvin` how many kelvins a value of 1 in the grid is",
        ));
    }
    list
}

fn clone((key, value): (&String, &Value)) -> (String, Value) {
    (key.clone(), value.clone())
}

/// A grid for each channel of the light of black bodies. `color` is what of it is emitted per metre.
fn channels(temperatures: &Voxels, kelvin: f32, color: Rgb, path: &str) -> Vec<Glow> {
    let most = black_body::radiance(temperatures.most() * kelvin);
    // Planck's law again and again would take longer than the bake.
    let table: Vec<Rgb> = (0..=STEPS)
        .map(|i| black_body::radiance(temperatures.most() * kelvin * i as f32 / STEPS as f32))
        .collect();
    let at = |value: f32, channel: usize| {
        let x = (value / temperatures.most()).clamp(0.0, 1.0) * STEPS as f32;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
        let i = (x as usize).min(STEPS - 1);
        let [a, b] = [table[i][channel], table[i + 1][channel]];
        (a + (b - a) * (x - i as f32)) / most[channel]
    };
    (0..3)
        .filter(|&k| 0.0 < most[k] && 0.0 < color[k])
        .filter_map(|k| {
            let grid = temperatures.map(|v| at(v, k)).ok()?;
            let color = Vec3::AXES[k] * (color[k] * most[k]);
            Some(Glow { color, source: Some(Source::Grid(grid)), path: path.to_owned() })
        })
        .collect()
}

/// Steps from 0 K to the hottest voxel.
const STEPS: usize = 1024;
