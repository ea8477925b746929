//! Numeric guards and running moments.

pub mod guards;
pub mod moments;
