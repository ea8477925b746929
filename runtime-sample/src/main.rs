//! The place of the viewer that shows a bake as a game does; it does nothing yet.
fn main() {}
