//! Gathers estimates into results: texels of a lightmap, irradiance at points.

pub mod accumulate;
pub mod adaptive;
pub mod audit;
pub mod bias;
pub mod cache;
pub mod directional;
pub mod facing;
pub mod light_grid;
pub mod lightmap;
pub mod monitor;
pub mod pilot;
pub mod points;
pub mod probes;
pub mod replay;
pub mod schedule;
pub mod visible;

pub use monitor::Monitor;
