//! Light probes: what arrives from all directions at places in the air, and how it is looked up.
//!
//! A [`ProbeVolume`] is a lattice in bricks of 4 x 4 x 4 cells, small bricks near geometry and large ones in free air. Where
//! surfaces pass through a cell, up to four planes part it into regions, and for each region it is known which of the eight
//! probes around see it, so that nothing leaks through walls of any thickness where four planes are enough: more of them in one cell, and curved
//! surfaces, are told apart as far as they go. [`Light`] is what a probe
//! holds: radiance in nits as real spherical harmonics of the basis of [`crate::harmonics`].

mod file;
mod light;
mod volume;
mod window;

pub use file::{FILE_NAME, FORMAT_VERSION, ProbeFileError};
pub use light::{Basis, Light, MOST_COEFFICIENTS};
pub use volume::{
    Brick, CELLS, CORNERS, Lattice, NODES, NONE, Occlusion, PLANES, Probe, ProbeVolume, REGIONS, Weights,
};
pub use window::least_window;
