//! Every argument of every command.

use crate::response::moments::ORDERS;
use crate::table::Orders;
use crate::table::file::Emitter;
use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Impulse responses of fog: the light that a medium sends to a receiver, as zonal harmonics over distance.
#[derive(Debug, Parser)]
#[command(name = "tables", version, propagate_version = true, max_term_width = 100)]
pub(super) struct Args {
    #[command(subcommand)]
    pub(super) command: Command,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Compute a file of tables
    Build(BuildArgs),
    /// Print what a file holds
    Inspect(InspectArgs),
    /// Draw coefficients against distance
    Plot(PlotArgs),
    /// Ask for the light of one emitter at one distance
    Query(QueryArgs),
    /// Compute entries and look-ups again without the file and report the differences
    Verify(VerifyArgs),
}

#[derive(Debug, ClapArgs)]
pub(super) struct BuildArgs {
    /// Where to
    #[arg(short, long, value_name = "FILE", default_value = "responses.zht")]
    pub(super) output: PathBuf,
    /// What to tabulate
    #[arg(long, value_enum, default_value = "default")]
    pub(super) preset: PresetArg,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum PresetArg {
    /// The embedded file: every g from -0.9 to 0.9, infinitely many orders at any albedo
    Default,
    /// About half as many nodes along every axis
    Half,
    /// About a quarter as many
    Quarter,
    /// The default with three columns of g, linear between them
    Columns,
    /// 256 distances, 8 angles, three columns of g, 10 orders, linear interpolation, as published in 2019
    Paper,
}

#[derive(Debug, ClapArgs)]
pub(super) struct FileArg {
    /// File of tables [default: the embedded one]
    #[arg(long, value_name = "FILE")]
    pub(super) file: Option<PathBuf>,
}

#[derive(Debug, ClapArgs)]
pub(super) struct InspectArgs {
    #[command(flatten)]
    pub(super) file: FileArg,
    /// As JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Debug, ClapArgs)]
pub(super) struct PlotArgs {
    #[command(flatten)]
    pub(super) file: FileArg,
    /// Picture, .svg or .png
    #[arg(short, long, value_name = "FILE", default_value = "responses.svg")]
    pub(super) output: PathBuf,
    /// Mean cosine of scattering
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) g: f64,
    /// Albedo of single scattering
    #[arg(long, default_value_t = 0.99, allow_negative_numbers = true)]
    pub(super) albedo: f64,
}

#[derive(Debug, ClapArgs)]
pub(super) struct QueryArgs {
    #[command(flatten)]
    pub(super) file: FileArg,
    /// Where light comes from: a point of 1 candela, a sun of 1 lux on the boundary plane, a Lambertian patch of
    /// radiance x area 1
    #[arg(long, value_enum)]
    pub(super) emitter: EmitterArg,
    /// Distance to the emitter, or depth below the plane, in mean free paths
    #[arg(long, value_name = "D", allow_negative_numbers = true)]
    pub(super) depth: f64,
    /// Angle between the patch's normal and the way to the receiver, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) theta: f64,
    /// Mean cosine of scattering
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) g: f64,
    /// Albedo of single scattering
    #[arg(long, value_name = "A", default_value_t = 1.0, allow_negative_numbers = true)]
    pub(super) albedo: f64,
    /// Orders of scattering: one, a span such as 2..10, infinitely many from 2 on (2..), or all
    #[arg(long, default_value = "all", value_parser = orders)]
    pub(super) orders: Orders,
    /// As one JSON object
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum EmitterArg {
    Point,
    Directional,
    Area,
}

impl From<EmitterArg> for Emitter {
    fn from(e: EmitterArg) -> Self {
        match e {
            EmitterArg::Point => Self::Point,
            EmitterArg::Directional => Self::Directional,
            EmitterArg::Area => Self::Area,
        }
    }
}

#[derive(Debug, ClapArgs)]
pub(super) struct VerifyArgs {
    #[command(flatten)]
    pub(super) file: FileArg,
    /// Random look-ups, spread over all tables
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(super) queries: u32,
    /// Which random look-ups
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// As JSON
    #[arg(long)]
    pub(super) json: bool,
}

/// Orders of scattering as they are written.
fn orders(text: &str) -> Result<Orders, String> {
    let number = |t: &str| {
        t.parse::<u32>()
            .ok()
            .filter(|n| (1..=ORDERS).contains(&(*n as usize)))
            .ok_or_else(|| format!("`{t}` is no order from 1 to {ORDERS}; write 1, 2..10, 2.. or all"))
    };
    match text.split_once("..") {
        _ if text == "all" => Ok(Orders::All),
        None => number(text).map(|n| Orders::Span(n, n)),
        Some(("1", "")) => Ok(Orders::All),
        Some(("2", "")) => Ok(Orders::Rest),
        Some((_, "")) => Err("infinitely many orders begin at 1 or 2".to_owned()),
        Some((a, b)) => {
            let (a, b) = (number(a)?, number(b)?);
            if b < a {
                return Err("a span of orders ascends".to_owned());
            }
            Ok(Orders::Span(a, b))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_read_as_they_are_written() {
        assert_eq!(orders("1"), Ok(Orders::Span(1, 1)));
        assert_eq!(orders("2..10"), Ok(Orders::Span(2, 10)));
        assert_eq!(orders("2.."), Ok(Orders::Rest));
        assert_eq!(orders("all"), Ok(Orders::All));
        for bad in ["0", "11", "3..", "5..2", "", "..", "x"] {
            assert!(orders(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn arguments_are_sound() {
        use clap::CommandFactory;
        Args::command().debug_assert();
    }
}
