//! Draws error over time of `--media bounded` and `reference` in the rooms of `oracles/rooms` and in Sponza with haze:
//! `cargo run --release -p suite --example efficiency -- data/media-efficiency.png`.
//!
//! Noise is the difference of two seeds. The error of `bounded` also has what its best bakes and those of `reference` differ by beyond their noise.
//! The worst hundredth of the texels is left out of both: next to a lamp the noise of unbiased paths has no bound, and of some sheets two bakes show different
//! sides. Time is that of processors for all that a
//! bake learns and samples: pilot, grid, cache and texels.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use image::{ImageFormat, RgbImage};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;
use std::error::Error;
use std::path::{Path, PathBuf};
use suite::baked::Page;
use suite::{rooms, tool};

const SIZE: (u32, u32) = (1500, 760);

/// Mean paths of a texel.
const ROOM: [&[u32]; 2] = [&[8, 32, 128], &[32, 128, 512]];

const SPONZA: [&[u32]; 2] = [&[16, 64], &[16, 64]];

const MODES: [&str; 2] = ["bounded", "reference"];

/// A scene and how it is baked.
struct Case {
    name: String,
    scene: PathBuf,
    args: Vec<String>,
    paths: [&'static [u32]; 2],
}

/// Bakes of one mode and number of paths.
struct Run {
    /// Luminance of each covered texel, seed by seed.
    seeds: Vec<Vec<f64>>,
    /// Processor seconds of one bake.
    seconds: f64,
}

/// Error, as a part of the mean, over seconds.
type Curve = Vec<(f64, f64)>;

fn main() -> Result<(), Box<dyn Error>> {
    let Some(shared) = suite::shared("efficiency") else { return Ok(()) };
    let file = std::env::args().nth(1).ok_or("name a PNG")?;
    let folder = tempfile::tempdir()?;
    let haze = folder.path().join("haze.toml");
    std::fs::write(&haze, suite::scenes::SPONZA_IN_HAZE)?;
    let words = |list: &[&str]| list.iter().map(|w| (*w).to_owned()).collect::<Vec<_>>();
    let mut cases: Vec<Case> = rooms::NAMES
        .iter()
        .map(|name| Case {
            name: (*name).to_owned(),
            scene: shared.join(format!("oracles/rooms/fog_{name}.glb")),
            args: words(&["--texels-per-metre", "4"]),
            paths: ROOM,
        })
        .collect();
    cases.push(Case {
        name: "Sponza".to_owned(),
        scene: shared.join("scenes/sponza-crytek-amd/Sponza.gltf"),
        args: words(&["--max-size", "512", "--config", haze.to_str().ok_or("a path")?]),
        paths: SPONZA,
    });
    let mut curves = Vec::new();
    for case in &cases {
        let all = measure(case, folder.path())?;
        for (mode, curve) in MODES.iter().zip(&all) {
            for (seconds, error) in curve {
                println!("{} {mode}: {:.3} % in {seconds:.2} s", case.name, 100.0 * error);
            }
        }
        for (seconds, error) in &all[0] {
            println!(
                "{}: {:.1} times as fast at {:.3} %",
                case.name,
                at(&all[1], *error) / seconds,
                100.0 * error
            );
        }
        curves.push(all);
    }
    register_font("sans-serif", FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
        .map_err(|_| "the font is damaged")?;
    let mut rgb = vec![0; (SIZE.0 * SIZE.1 * 3) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut rgb, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        for ((case, curves), place) in cases.iter().zip(&curves).zip(area.split_evenly((2, 4))) {
            draw(&place, &case.name, curves)?;
        }
        area.present()?;
    }
    RgbImage::from_raw(SIZE.0, SIZE.1, rgb).ok_or("no picture")?.save_with_format(file, ImageFormat::Png)?;
    Ok(())
}

/// Seconds that a curve takes to an error, which falls with their root between and beside the points.
fn at(curve: &Curve, error: f64) -> f64 {
    let near = curve.iter().min_by(|a, b| (a.1 / error).ln().abs().total_cmp(&(b.1 / error).ln().abs()));
    near.map_or(f64::NAN, |(seconds, e)| seconds * (e / error).powi(2))
}

fn measure(case: &Case, folder: &Path) -> Result<[Curve; 2], Box<dyn Error>> {
    let mut runs: [Vec<Run>; 2] = [Vec::new(), Vec::new()];
    for ((mode, counts), runs) in MODES.iter().zip(case.paths).zip(&mut runs) {
        for n in counts {
            runs.push(bake(case, mode, *n, folder)?);
        }
    }
    let best = |runs: &[Run]| runs.last().map(|r| r.seeds.clone()).ok_or("no bakes");
    let (a, b) = (best(&runs[0])?, best(&runs[1])?);
    let n = a[0].len();
    let mean = b.iter().flatten().sum::<f64>() / (2 * n) as f64;
    // Noise of one seed is independent of that of the other, so the product has the mean of the squared difference.
    let mut beyond: Vec<f64> = (0..n).map(|i| (a[0][i] - b[0][i]) * (a[1][i] - b[1][i])).collect();
    beyond.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let kept = &beyond[..n * 99 / 100];
    let bias = (kept.iter().sum::<f64>() / kept.len() as f64).max(0.0);
    println!("{}: {n} texels, {:.2} % beyond noise", case.name, 100.0 * bias.sqrt() / mean);
    let curve = |runs: &[Run], bias: f64| -> Curve {
        let error = |run: &Run| {
            let pairs = run.seeds[0].iter().zip(&run.seeds[1]);
            let mut squares: Vec<f64> = pairs.map(|(a, b)| 0.5 * (a - b).powi(2)).collect();
            squares.sort_by(f64::total_cmp);
            let kept = &squares[..n * 99 / 100];
            (kept.iter().sum::<f64>() / kept.len() as f64 + bias).sqrt() / mean
        };
        runs.iter().map(|run| (run.seconds, error(run))).collect()
    };
    Ok([curve(&runs[0], bias), curve(&runs[1], 0.0)])
}

fn bake(case: &Case, mode: &str, paths: u32, folder: &Path) -> Result<Run, Box<dyn Error>> {
    let mut run = Run { seeds: Vec::new(), seconds: 0.0 };
    let scene = case.scene.to_str().ok_or("a path")?;
    // As presets do.
    let rounds = format!("{},{},{paths}", 0.5 * f64::from(paths), 0.75 * f64::from(paths));
    let seeds = ["1", "2"];
    for seed in seeds {
        let first = ["run", scene, "-o", "out", "--progress", "none", "--media", mode, "--rounds", &rounds];
        let rest: Vec<&str> = case.args.iter().map(String::as_str).collect();
        let all = [&first[..], &["--seed", seed], &rest].concat();
        let _ = tool::bake(&all, folder).expect(0);
        let out = folder.join("out");
        let times: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(out.join("timings.json"))?)?;
        let counts = ["pilot", "light grid", "cache", "sample"];
        let stages = times["stages"].as_array().ok_or("no stages")?;
        let of = |s: &serde_json::Value| counts.contains(&s["name"].as_str().unwrap_or_default());
        let seconds = stages.iter().filter(|s| of(s)).filter_map(|s| s["cpu_seconds"].as_f64()).sum::<f64>();
        run.seconds += seconds / seeds.len() as f64;
        let page = Page::read(&out.join("lightmap-0.exr"))?;
        let luminance = |i: usize| -> f64 {
            let weights = [("R", 0.2126), ("G", 0.7152), ("B", 0.0722)];
            weights.iter().map(|(c, w)| w * f64::from(page.channels[*c][i])).sum()
        };
        let covered = (0..page.channels["A"].len()).filter(|i| 0.0 < page.channels["A"][*i]);
        run.seeds.push(covered.map(luminance).collect());
    }
    Ok(run)
}

fn draw(
    area: &DrawingArea<BitMapBackend<'_>, Shift>,
    name: &str,
    curves: &[Curve; 2],
) -> Result<(), Box<dyn Error>> {
    let ends = |of: &dyn Fn(&(f64, f64)) -> f64| {
        let all = || curves.iter().flatten().map(of);
        all().fold(f64::INFINITY, f64::min) * 0.8..all().fold(0.0, f64::max) * 1.25
    };
    let mut chart = ChartBuilder::on(area)
        .caption(name, ("sans-serif", 20))
        .margin(8)
        .x_label_area_size(40)
        .y_label_area_size(48)
        .build_cartesian_2d(ends(&|p| p.0).log_scale(), ends(&|p| 100.0 * p.1).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("processor seconds")
        .y_desc("error, %")
        .x_label_formatter(&|x| format!("{x}"))
        .y_label_formatter(&|y| format!("{y}"))
        .light_line_style(WHITE)
        .label_style(("sans-serif", 14))
        .draw()?;
    for (k, (mode, curve)) in MODES.iter().zip(curves).enumerate() {
        let colour = Palette99::pick(k).to_rgba();
        let points = curve.iter().map(|(s, e)| (*s, 100.0 * e));
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(2)).point_size(3))?
            .label(*mode)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    chart.configure_series_labels().background_style(WHITE.mix(0.8)).label_font(("sans-serif", 14)).draw()?;
    Ok(())
}
