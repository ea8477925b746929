//! The shader functions that the documentation gives to readers of files are WGSL that compiles.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::fs;

/// The one block of WGSL in a file's documentation.
fn documented(file: &str) -> String {
    let text = fs::read_to_string(suite::root().join(file)).unwrap();
    let lines = text.lines().skip_while(|l| !l.ends_with("```wgsl")).skip(1);
    let block: Vec<&str> = lines.take_while(|l| !l.ends_with("```")).collect();
    assert!(10 < block.len(), "{file}: {} lines", block.len());
    block.iter().map(|l| l.strip_prefix("//!").unwrap().to_owned() + "\n").collect()
}

/// Parses and validates a block behind the declarations that its documentation asks for.
fn compiles(file: &str, declarations: &str) {
    let source = format!("{declarations}\n{}", documented(file));
    let module =
        naga::front::wgsl::parse_str(&source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&source)));
    let mut validator =
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty());
    validator.validate(&module).unwrap_or_else(|e| panic!("{file}: {}", e.emit_to_string(&source)));
}

#[test]
fn probes_are_looked_up_as_documented() {
    let declarations = "
        const origin = vec3f(0.0); const spacing = 1.0; const size = vec3u(2u);
        @group(0) @binding(0) var<storage, read> index: array<u32>;
        @group(0) @binding(1) var<storage, read> bricks: array<u32>;
        @group(0) @binding(2) var<storage, read> occlusions: array<u32>;
        @group(0) @binding(3) var<storage, read> light: array<f32>;
    ";
    compiles("tables/src/probes/file.rs", declarations);
}

#[test]
fn light_of_fog_is_looked_up_as_documented() {
    let declarations = "
        const first = vec3f(0.0); const cell = vec3f(1.0); const size = vec3u(2u, 3u, 4u);
        const slices = 6u; const depth = 42.0;
        @group(0) @binding(0) var grid: texture_3d<f32>;
        @group(0) @binding(1) var linear: sampler;
    ";
    compiles("bake/src/output/light_grid.rs", declarations);
}
