//! Scene builders and helpers for whole-tool tests.
