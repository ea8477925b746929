//! Foggy rooms with independently computed irradiance, `oracles/rooms` beside the checkout.

use crate::tool;
use serde_json::Value;
use std::path::PathBuf;

/// Names of the rooms.
pub const NAMES: [&str; 7] = ["absorbing_hg", "black", "box", "gray", "lamp", "shadow", "sun"];

/// One room.
#[derive(Clone, Debug)]
pub struct Foggy {
    /// One of [`NAMES`].
    pub name: &'static str,
    scene: PathBuf,
    at: Vec<[[f64; 3]; 2]>,
    /// Irradiance and its standard error.
    truth: Vec<[[f64; 3]; 2]>,
}

/// How far a bake is from the truth, point by point and channel by channel.
#[derive(Clone, Copy, Debug)]
pub struct Deviation {
    /// As a part of the truth.
    pub off: f64,
    /// Standard error of the truth, likewise.
    pub truth: f64,
    /// That of the bake.
    pub bake: f64,
}

/// All rooms; `None`, and said, where they are not there.
///
/// # Panics
/// If a file is damaged.
#[must_use]
pub fn all(test: &str) -> Option<Vec<Foggy>> {
    let folder = crate::shared(test)?.join("oracles/rooms");
    let read = |name: &'static str| {
        let text = std::fs::read_to_string(folder.join(format!("fog_{name}.json"))).expect("an oracle");
        let file: Value = serde_json::from_str(&text).expect("JSON");
        let points = file["points"].as_array().expect("points");
        let pair = |p: &Value, a: &str, b: &str| [tool::numbers(&p[a]), tool::numbers(&p[b])];
        Foggy {
            name,
            scene: folder.join(format!("fog_{name}.glb")),
            at: points.iter().map(|p| pair(p, "position", "normal")).collect(),
            truth: points.iter().map(|p| pair(p, "irradiance", "std_err")).collect(),
        }
    };
    Some(NAMES.map(read).to_vec())
}

impl Foggy {
    /// Asks `bake points --media bounded`.
    #[must_use]
    pub fn deviations(&self, args: &[&str]) -> Vec<Deviation> {
        let got = tool::points(&self.scene, &self.at, &[&["--media", "bounded"], args].concat());
        let pairs = self.truth.iter().zip(&got);
        pairs
            .flat_map(|(t, g)| {
                (0..3).map(|c| Deviation {
                    off: g[0][c] / t[0][c] - 1.0,
                    truth: t[1][c] / t[0][c],
                    bake: g[1][c] / t[0][c],
                })
            })
            .collect()
    }

    /// Root of the mean square of what is not noise; 0 where it drowns.
    #[must_use]
    pub fn bias(&self, args: &[&str]) -> f64 {
        let all = self.deviations(args);
        let square = |d: &Deviation| d.off * d.off - d.truth * d.truth - d.bake * d.bake;
        (all.iter().map(square).sum::<f64>() / all.len() as f64).max(0.0).sqrt()
    }
}
