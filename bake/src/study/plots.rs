//! Error over seconds as SVG.

use crate::error::{Error, Result};
use crate::study::figures::Row;
use crate::study::sentences::{percent, seconds};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;
use std::ops::Range;

const SIZE: (u32, u32) = (640, 400);
const LARGE: (u32, u32) = (900, 560);

/// Settings beyond so many on one curve have no labels.
const LABELLED: usize = 12;

/// What is drawn.
#[derive(Debug)]
pub struct Curve<'a> {
    /// Its name in the legend.
    pub name: String,
    /// Its points.
    pub rows: Vec<&'a Row>,
    /// Those of them that a line joins, in its order.
    pub line: Vec<&'a Row>,
}

/// Error over processor seconds, both in logarithms; beside each point its setting, below it its bias as a hollow point.
///
/// # Errors
///
/// [`Error::Usage`] where drawing fails.
pub fn knob(title: &str, curves: &[Curve<'_>]) -> Result<String> {
    draw(title, curves, SIZE, true)
}

/// Everything in one picture, with the front.
///
/// # Errors
///
/// As [`knob`].
pub fn pareto(title: &str, curves: &[Curve<'_>]) -> Result<String> {
    draw(title, curves, LARGE, false)
}

fn failed(e: impl std::fmt::Display) -> Error {
    Error::Usage(format!("a plot cannot be drawn: {e}"))
}

fn draw(title: &str, curves: &[Curve<'_>], size: (u32, u32), bias: bool) -> Result<String> {
    // Letters of our own: no font of the machine is needed to find out how wide they are.
    register_font("sans-serif", FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
        .map_err(|_| failed("the font is damaged"))?;
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        panel(&area, title, curves, bias)?;
        area.present().map_err(failed)?;
    }
    Ok(text)
}

/// A range with some room on both sides.
fn range(values: impl Iterator<Item = f64>, room: f64) -> Range<f64> {
    let (low, high) = values
        .filter(|v| 0.0 < *v && v.is_finite())
        .fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
    if low <= high { low / room..high * room } else { 0.1..1.0 }
}

/// 1, 2 and 5 times powers of ten within a range.
fn ticks(range: &Range<f64>) -> Vec<f64> {
    #[expect(clippy::cast_possible_truncation, reason = "decades are few")]
    let decades = range.start.log10().floor() as i32..=range.end.log10().ceil() as i32;
    let all = decades.flat_map(|d| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(d)));
    all.filter(|t| range.contains(t)).collect()
}

fn panel<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    curves: &[Curve<'_>],
    bias: bool,
) -> Result<()> {
    let rows = || curves.iter().flat_map(|c| &c.rows);
    let shows_bias = |r: &Row| bias && r.errors.is_biased() && 0.2 * r.errors.error < r.errors.bias;
    let errors =
        rows().flat_map(|r| [r.errors.error, if shows_bias(r) { r.errors.bias } else { r.errors.error }]);
    let (across, up) = (range(rows().map(|r| r.cost.seconds()), 1.3), range(errors, 1.4));
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 17))
        .margin(10)
        .x_label_area_size(40)
        .y_label_area_size(62)
        .build_cartesian_2d(
            across.clone().log_scale().with_key_points(ticks(&across)),
            up.clone().log_scale().with_key_points(ticks(&up)),
        )
        .map_err(failed)?;
    chart
        .configure_mesh()
        .x_desc("processor seconds")
        .y_desc("error")
        .x_label_formatter(&|x| seconds(*x))
        .y_label_formatter(&|y| percent(*y))
        .light_line_style(WHITE)
        .label_style(("sans-serif", 13))
        .draw()
        .map_err(failed)?;
    for (k, curve) in curves.iter().enumerate() {
        let colour = Palette99::pick(k).to_rgba();
        let points = |rows: &[&Row]| -> Vec<(f64, f64)> {
            rows.iter().map(|r| (r.cost.seconds(), r.errors.error)).filter(|(_, e)| 0.0 < *e).collect()
        };
        chart.draw_series(LineSeries::new(points(&curve.line), colour.stroke_width(2))).map_err(failed)?;
        chart
            .draw_series(points(&curve.rows).into_iter().map(|p| Circle::new(p, 4, colour.filled())))
            .map_err(failed)?
            .label(curve.name.as_str())
            .legend(move |(x, y)| Circle::new((x + 8, y), 4, colour.filled()));
        let hollow = curve.rows.iter().filter(|r| shows_bias(r)).map(|r| (r.cost.seconds(), r.errors.bias));
        chart.draw_series(hollow.map(|p| Circle::new(p, 4, colour.stroke_width(1)))).map_err(failed)?;
        if curve.rows.len() <= LABELLED {
            let label = |r: &&&Row| {
                let font = ("sans-serif", 13).into_font().color(&BLACK.mix(0.8));
                let name = if r.usual { format!("{} *", r.setting) } else { r.setting.clone() };
                EmptyElement::at((r.cost.seconds(), r.errors.error)) + Text::new(name, (6, -14), font)
            };
            let seen = curve.rows.iter().filter(|r| 0.0 < r.errors.error);
            chart.draw_series(seen.map(|r| label(&r))).map_err(failed)?;
        }
    }
    if 1 < curves.len() {
        chart
            .configure_series_labels()
            .background_style(WHITE.mix(0.85))
            .border_style(BLACK.mix(0.3))
            .label_font(("sans-serif", 13))
            .draw()
            .map_err(failed)?;
    }
    Ok(())
}
