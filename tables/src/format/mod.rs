//! File formats that one tool writes and another reads.

pub mod manifest;
