//! The command line.

use std::path::PathBuf;

use clap::Parser;

use crate::{
    files::page::Source,
    view::{balls::Still, look::Mode},
};

/// Shows a bake as a game would, from the files of its folder alone.
///
/// DIR is a folder that `bake run` wrote, or holds such folders side by side, bakes of one scene whose names are labels. Without --screenshot,
/// --turntable and --timings a window opens; H lists its keys.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 120)]
pub(crate) struct Args {
    /// A bake, or a folder of bakes
    pub(crate) dir: PathBuf,
    /// Draw without a window into this file: .png, or .exr with the radiance in nits
    #[arg(long, value_name = "FILE")]
    pub(crate) screenshot: Option<PathBuf>,
    /// Draw a way around what is ahead into this folder, 000.png and so on
    #[arg(long, value_name = "FOLDER", conflicts_with = "screenshot")]
    pub(crate) turntable: Option<PathBuf>,
    /// Pictures of a turntable
    #[arg(long, value_name = "N", default_value_t = 36, value_parser = clap::value_parser!(u32).range(1..=3600))]
    pub(crate) frames: u32,
    /// Name or number, from 0 on, of a camera of the scene [default: that of preview.png]
    #[arg(long, value_name = "CAMERA")]
    pub(crate) camera: Option<String>,
    /// Pixels of the picture or the window
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    pub(crate) size: [u32; 2],
    /// What radiance is multiplied by before tone mapping, 1/nit [default: as preview.png, from the manifest]
    #[arg(long, value_name = "X", value_parser = positive)]
    pub(crate) exposure: Option<f32>,
    /// Which of several bakes, by label [default: the first]
    #[arg(long, value_name = "LABEL")]
    pub(crate) bake: Option<String>,
    /// A second bake, right of the wiper
    #[arg(long, value_name = "LABEL")]
    pub(crate) against: Option<String>,
    /// Where the wiper is, 0 to 1
    #[arg(long, value_name = "X", default_value_t = 0.5)]
    pub(crate) wipe: f32,
    /// What surfaces show
    #[arg(long, value_name = "MODE", value_enum, default_value_t = Mode::Lit)]
    pub(crate) show: Mode,
    /// Leave the fog between surfaces and the eye out
    #[arg(long)]
    pub(crate) no_fog: bool,
    /// Leave normal maps out (they act where lightmaps are directional)
    #[arg(long)]
    pub(crate) no_normals: bool,
    /// Leave the moving spheres out
    #[arg(long)]
    pub(crate) no_balls: bool,
    /// A sphere in place of the moving ones: X,Y,Z,RADIUS or X,Y,Z,RADIUS,ALBEDO in metres; may be given again
    #[arg(long, value_name = "SPHERE", allow_hyphen_values = true)]
    pub(crate) ball: Vec<Still>,
    /// Show probes as spheres; those in walls, which hold the light of others, are red
    #[arg(long)]
    pub(crate) probes: bool,
    /// How long spheres have moved when a picture is taken, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0, allow_hyphen_values = true)]
    pub(crate) time: f32,
    /// Pictures that are averaged for smooth edges, without a window
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub(crate) antialias: u32,
    /// Which file lightmaps are read from
    #[arg(long, value_enum, default_value_t = Source::Ktx2)]
    pub(crate) pages: Source,
    /// Print what the stages of a frame take, the median of N frames
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "20", value_parser = clap::value_parser!(u32).range(1..=10000))]
    pub(crate) timings: Option<u32>,
    /// Take an adapter that is software
    #[arg(long)]
    pub(crate) software: bool,
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    let wrong = || "a size is WIDTHxHEIGHT, from 16x16 to 8192x8192".to_owned();
    sides.filter(|s: &[u32; 2]| s.iter().all(|n| (16..=8192).contains(n))).ok_or_else(wrong)
}

fn positive(text: &str) -> Result<f32, String> {
    let number = text.parse::<f32>().ok().filter(|x| x.is_normal() && 0.0 < *x);
    number.ok_or_else(|| "an exposure is a number above 0".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definition_holds() {
        Args::command().debug_assert();
    }

    #[test]
    fn sizes_and_exposures() {
        assert_eq!(size("1280x720"), Ok([1280, 720]));
        for wrong in ["", "12", "0x10", "1280x", "9999x16", "-1x20", "12 x 20"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
        assert!(
            positive("0.5").is_ok() && ["0", "-1", "nan", "inf", "x"].iter().all(|t| positive(t).is_err())
        );
    }
}
