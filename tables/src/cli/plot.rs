//! `tables plot`: figure 10 of \[IR19\].

use super::args::PlotArgs;
use super::{Error, open, write};
use crate::harmonics::{BANDS, Zh64};
use crate::table::file::Emitter;
use crate::table::query::QueryError;
use crate::table::{Orders, Query, Tables};
use image::{ImageFormat, RgbImage};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;
use std::io::Cursor;
use std::process::ExitCode;

const SIZE: (u32, u32) = (1800, 860);

/// Distances that are drawn, mean free paths.
const FROM: f64 = 1e-2;
const TO: f64 = 30.0;

/// Points of a curve.
const POINTS: u32 = 240;

pub(super) fn run(args: &PlotArgs) -> Result<ExitCode, Error> {
    let tables = open(args.file.file.as_deref())?;
    // Letters of our own: no font of the machine is needed, and a picture is the same everywhere.
    register_font("sans-serif", FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
        .map_err(|_| Error::Draw("the font is damaged".to_owned()))?;
    let extension = args.output.extension().map(|e| e.to_string_lossy().to_lowercase());
    let bytes = match extension.as_deref() {
        Some("svg") => {
            let mut text = String::new();
            figure(&SVGBackend::with_string(&mut text, SIZE).into_drawing_area(), &tables, args)?;
            text.into_bytes()
        }
        Some("png") => {
            let mut rgb = vec![0; (SIZE.0 * SIZE.1 * 3) as usize];
            figure(&BitMapBackend::with_buffer(&mut rgb, SIZE).into_drawing_area(), &tables, args)?;
            let mut file = Cursor::new(Vec::new());
            RgbImage::from_raw(SIZE.0, SIZE.1, rgb)
                .ok_or_else(|| Error::Draw("no picture".to_owned()))?
                .write_to(&mut file, ImageFormat::Png)
                .map_err(|e| Error::Draw(e.to_string()))?;
            file.into_inner()
        }
        _ => return Err(Error::Usage(format!("{}: a picture ends in .svg or .png", args.output.display()))),
    };
    write(&args.output, &bytes)?;
    Ok(ExitCode::SUCCESS)
}

/// A row for each emitter, a column for each choice of orders.
fn figure<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    tables: &Tables,
    args: &PlotArgs,
) -> Result<(), Error> {
    let failed = |e: DrawingAreaErrorKind<B::ErrorType>| Error::Draw(e.to_string());
    area.fill(&WHITE).map_err(failed)?;
    let columns = [
        ("order 1", Orders::Span(1, 1)),
        ("orders 1 and 2", Orders::Span(1, 2)),
        ("orders 1 to 10", Orders::Span(1, 10)),
        ("all orders", Orders::All),
    ];
    let rows = [
        (Emitter::Point, "point of 1 cd", "coefficient x distance"),
        (Emitter::Directional, "sun of 1 lux", "coefficient"),
    ];
    let panels = area.margin(6, 6, 6, 6).split_evenly((rows.len(), columns.len()));
    for (row, (emitter, name, unit)) in rows.into_iter().enumerate() {
        for (column, (orders_name, orders)) in columns.into_iter().enumerate() {
            let title = format!("{name}, {orders_name}, albedo {}, g {}", args.albedo, args.g);
            let panel = &panels[row * columns.len() + column];
            match curve(tables, emitter, orders, args) {
                Ok(curve) => draw(panel, &title, unit, &curve, row + column == 0)?,
                Err(e @ QueryError::Missing(..)) => {
                    let style = ("sans-serif", 14).into_font().color(&BLACK);
                    panel.draw_text(&format!("{title}: {e}"), &style, (10, 40)).map_err(failed)?;
                }
                Err(e) => return Err(e.into()),
            }
        }
    }
    area.present().map_err(failed)
}

/// Coefficients over distance; those of a point times distance, which keeps them finite near it.
fn curve(
    tables: &Tables,
    emitter: Emitter,
    orders: Orders,
    args: &PlotArgs,
) -> Result<Vec<(f64, Zh64)>, QueryError> {
    (0..=POINTS)
        .map(|i| {
            let depth = FROM * (TO / FROM).powf(f64::from(i) / f64::from(POINTS));
            let q = Query { emitter, depth, theta: 0.0, g: args.g, albedo: args.albedo, orders };
            let factor = if emitter == Emitter::Directional { 1.0 } else { depth };
            Ok((depth, tables.query(&q)?.zh.map(|v| v * factor)))
        })
        .collect()
}

fn draw<B: DrawingBackend>(
    panel: &DrawingArea<B, Shift>,
    title: &str,
    unit: &str,
    curve: &[(f64, Zh64)],
    legend: bool,
) -> Result<(), Error> {
    let failed = |e: DrawingAreaErrorKind<B::ErrorType>| Error::Draw(e.to_string());
    let values = || curve.iter().flat_map(|c| c.1);
    let (low, high) = (values().fold(0.0, f64::min), values().fold(0.0, f64::max));
    let room = 0.05 * (high - low).max(1e-9);
    let mut chart = ChartBuilder::on(panel)
        .caption(title, ("sans-serif", 15))
        .margin(6)
        .x_label_area_size(36)
        .y_label_area_size(52)
        .build_cartesian_2d((FROM..TO).log_scale(), low - room..high + room)
        .map_err(failed)?;
    chart
        .configure_mesh()
        .x_desc("distance, mean free paths")
        .y_desc(unit)
        .x_label_formatter(&|x| format!("{x}"))
        // Not -0.
        .y_label_formatter(&|y| format!("{:.2}", if y.abs() < 5e-3 { 0.0 } else { *y }))
        .light_line_style(WHITE)
        .label_style(("sans-serif", 13))
        .draw()
        .map_err(failed)?;
    for l in 0..BANDS {
        let colour = colour(l);
        let series = LineSeries::new(curve.iter().map(|(d, zh)| (*d, zh[l])), colour.stroke_width(2));
        chart
            .draw_series(series)
            .map_err(failed)?
            .label(format!("l = {l}"))
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    if legend {
        chart
            .configure_series_labels()
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .label_font(("sans-serif", 12))
            .draw()
            .map_err(failed)?;
    }
    Ok(())
}

/// Dark red to blue.
fn colour(l: usize) -> RGBColor {
    let t = l as f64 / (BANDS - 1) as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within 0..=255")]
    let mix = |from: f64, middle: f64, to: f64| {
        (if t < 0.5 { from + (middle - from) * 2.0 * t } else { middle + (to - middle) * (2.0 * t - 1.0) })
            as u8
    };
    RGBColor(mix(130.0, 240.0, 20.0), mix(0.0, 150.0, 80.0), mix(10.0, 30.0, 210.0))
}
