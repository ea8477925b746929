//! What is looked at, from where, and what moves.

pub(crate) mod balls;
pub(crate) mod camera;
pub(crate) mod controls;
pub(crate) mod look;
