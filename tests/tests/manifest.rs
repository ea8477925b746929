//! Manifests are what their schema says.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use serde_json::{Value, json};
use std::fs;
use suite::baked::Baked;
use suite::scenes::closed::{Room, room};
use suite::{root, tool};

fn schema() -> Value {
    let text = fs::read_to_string(root().join("data/manifest.schema.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn manifest(baked: &Baked) -> Value {
    serde_json::from_slice(&baked.files["manifest.json"]).unwrap()
}

/// Bakes with everything that has words in the manifest, and with as little as possible.
#[test]
fn manifests_fit_their_schema() {
    let validator = jsonschema::validator_for(&schema()).unwrap();
    let scene = room(Room::default());
    let few = ["--samples", "4", "--texels-per-metre", "4", "--probe-count", "60", "--probe-samples", "16"];
    let all = ["--directional", "--split-direct", "--denoise", "final", "--texture", "rgba16f"];
    let none = ["--probes", "off", "--texture", "none", "--media", "off"];
    for more in [&all[..], &none] {
        let media = "{ sigma_s = 0.3 }, { sigma_a = 0.1, density = { height = { falloff = 2 } } }, { sigma_a = 0.1, \
                     density = { stencil = { size = [1, 1, 2], values = [1, 2] } }, box = { min = [0, 0, 0], max = [1, 1, 1] } }";
        let baked = tool::baked_in(&scene, media, &[&few[..], more].concat());
        let text = manifest(&baked);
        assert_eq!(baked.manifest.media.len(), if more == none { 0 } else { 3 });
        let errors: Vec<String> =
            validator.iter_errors(&text).map(|e| format!("{}: {e}", e.instance_path())).collect();
        assert!(errors.is_empty(), "{errors:#?}");
    }
}

/// The schema is no mere formality: what is missing or of another kind is found.
#[test]
fn other_things_do_not_fit() {
    let validator = jsonschema::validator_for(&schema()).unwrap();
    let baked = tool::baked(&room(Room::default()), &["--samples", "1", "--texels-per-metre", "2"]);
    let good = manifest(&baked);
    assert!(validator.is_valid(&good));
    for (pointer, value) in [
        ("/pages/0/width", json!("wide")),
        ("/surfaces/0/rect", Value::Null),
        ("/probes/0/origin", json!([1, 2])),
        ("/error", json!(0.5)),
        ("/sky/kind", json!("cloudy")),
    ] {
        let mut bad = good.clone();
        *bad.pointer_mut(pointer).unwrap_or_else(|| panic!("no {pointer}")) = value;
        assert!(!validator.is_valid(&bad), "{pointer}");
    }
    let mut bad = good;
    bad.as_object_mut().unwrap().remove("unit");
    assert!(!validator.is_valid(&bad), "without unit");
}
