//! `manifest.json`: what a bake wrote.
