//! What is checked in under `data/` is what its generators write.
//!
//! `UPDATE_EXPECT=1 cargo test -p suite --test data` rewrites them.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::{env, fs, path::Path};

use suite::scenes;
use tables::format::manifest::Manifest;

fn check(name: &str, bytes: &[u8]) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../data").join(name);
    if env::var_os("UPDATE_EXPECT").is_some_and(|v| v == "1") {
        fs::write(&path, bytes).unwrap();
    }
    let stored = fs::read(&path).unwrap();
    assert!(
        stored == bytes,
        "{name}: {} bytes are checked in, the generator writes {}; UPDATE_EXPECT=1 rewrites the file",
        stored.len(),
        bytes.len()
    );
}

#[test]
fn hall_is_what_the_generator_writes() {
    let bytes = scenes::hall::hall();
    assert!(bytes.len() < 300_000, "{} bytes", bytes.len());
    check("hall.glb", &bytes);
}

#[test]
fn schema_is_that_of_the_manifest() {
    check("manifest.schema.json", Manifest::schema().as_bytes());
}
