//! Shows a bake.
fn main() {}
