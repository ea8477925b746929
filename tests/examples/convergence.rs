//! Draws how `--media bounded` converges in the rooms of `oracles/rooms`: `cargo run --release -p suite --example convergence -- data/media-convergence.png`.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use image::{ImageFormat, RgbImage};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;
use std::error::Error;
use suite::rooms::{self, Deviation, Foggy};

const SIZE: (u32, u32) = (1500, 460);

/// Nodes and paths from each.
const FINENESS: [(u32, u32); 7] =
    [(8, 4), (64, 8), (512, 8), (1024, 32), (4096, 32), (16384, 64), (65536, 128)];

const SAMPLES: [u32; 6] = [16, 64, 256, 1024, 4096, 16384];

const ORDERS: [u32; 7] = [1, 2, 3, 4, 6, 10, 20];

/// A panel: what varies, its values, and for each room the error in per cent.
struct Panel {
    title: &'static str,
    axis: &'static str,
    x: Vec<f64>,
    rooms: Vec<Vec<f64>>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let Some(rooms) = rooms::all("convergence") else { return Ok(()) };
    let file = std::env::args().nth(1).ok_or("name a PNG")?;
    let quiet = "0.005";
    let bias = |room: &Foggy, nodes: u32, paths: u32, orders: u32| {
        let words = [nodes, paths, orders].map(|n| n.to_string());
        let [n, p, o] = words.each_ref().map(String::as_str);
        let args = ["--grid-nodes", n, "--grid-paths", p, "--grid-orders", o, "--target-error", quiet];
        let percent = 100.0 * room.bias(&args);
        println!("{}: {nodes} nodes, {paths} paths, {orders} orders: {percent:.3} %", room.name);
        percent
    };
    let noise = |room: &Foggy, samples: u32| {
        let n = samples.to_string();
        let args = ["--quality", "high", "--samples", n.as_str()];
        let all = room.deviations(&args);
        let square = |d: &Deviation| d.off * d.off - d.truth * d.truth;
        let percent = 100.0 * (all.iter().map(square).sum::<f64>() / all.len() as f64).max(0.0).sqrt();
        println!("{}: {samples} samples: {percent:.3} %", room.name);
        percent
    };
    let of = |f: &dyn Fn(&Foggy) -> Vec<f64>| rooms.iter().map(f).collect();
    let panels = [
        Panel {
            title: "finer volume",
            axis: "nodes x paths",
            x: FINENESS.iter().map(|(n, p)| f64::from(n * p)).collect(),
            rooms: of(&|r| FINENESS.iter().map(|(n, p)| bias(r, *n, *p, 400)).collect()),
        },
        Panel {
            title: "more samples, quality high",
            axis: "samples of a point",
            x: SAMPLES.map(f64::from).to_vec(),
            rooms: of(&|r| SAMPLES.iter().map(|n| noise(r, *n)).collect()),
        },
        Panel {
            title: "more orders, 16384 nodes x 64 paths",
            axis: "orders of scattering in the volume",
            x: ORDERS.map(f64::from).to_vec(),
            rooms: of(&|r| ORDERS.iter().map(|o| bias(r, 16384, 64, *o)).collect()),
        },
    ];
    register_font("sans-serif", FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
        .map_err(|_| "the font is damaged")?;
    let mut rgb = vec![0; (SIZE.0 * SIZE.1 * 3) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut rgb, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        for (i, (panel, place)) in panels.iter().zip(area.split_evenly((1, 3))).enumerate() {
            draw(&place, panel, i == 0)?;
        }
        area.present()?;
    }
    RgbImage::from_raw(SIZE.0, SIZE.1, rgb).ok_or("no picture")?.save_with_format(file, ImageFormat::Png)?;
    Ok(())
}

/// What is below the noise of the truth is drawn at the lower edge.
const LEAST: f64 = 0.1;

fn draw(
    area: &DrawingArea<BitMapBackend<'_>, Shift>,
    panel: &Panel,
    legend: bool,
) -> Result<(), Box<dyn Error>> {
    let most = panel.rooms.iter().flatten().fold(1.0, |a: f64, b| a.max(*b));
    let x = panel.x[0]..*panel.x.last().ok_or("no values")?;
    let mut chart = ChartBuilder::on(area)
        .caption(panel.title, ("sans-serif", 20))
        .margin(10)
        .x_label_area_size(42)
        .y_label_area_size(52)
        .build_cartesian_2d(x.log_scale(), (LEAST..1.3 * most).log_scale())?;
    chart
        .configure_mesh()
        .x_desc(panel.axis)
        .y_desc("root mean square of the error, %")
        .x_label_formatter(&|x| format!("{x}"))
        .y_label_formatter(&|y| format!("{y}"))
        .light_line_style(WHITE)
        .label_style(("sans-serif", 14))
        .draw()?;
    for (k, (name, values)) in rooms::NAMES.iter().zip(&panel.rooms).enumerate() {
        let colour = Palette99::pick(k).to_rgba();
        let points: Vec<(f64, f64)> = panel.x.iter().zip(values).map(|(x, v)| (*x, v.max(LEAST))).collect();
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(2)).point_size(3))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    if legend {
        chart
            .configure_series_labels()
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .label_font(("sans-serif", 14))
            .draw()?;
    }
    Ok(())
}
