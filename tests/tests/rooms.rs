//! Irradiance at points against independently computed values.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::fs;

use serde_json::Value;
use suite::tool::{self, numbers};

fn check(name: &str, more: &[&str]) {
    let Some(shared) = suite::shared(name) else { return };
    let rooms = shared.join("oracles/rooms");
    let oracle: Value =
        serde_json::from_slice(&fs::read(rooms.join(format!("{name}.json"))).unwrap()).unwrap();
    let wanted = oracle["points"].as_array().unwrap();
    let asked: Vec<_> = wanted.iter().map(|p| [numbers(&p["position"]), numbers(&p["normal"])]).collect();
    let got = tool::points(&rooms.join(format!("{name}.glb")), &asked, more);
    let mut faults = Vec::new();
    for (i, ([value, error], w)) in got.iter().zip(wanted).enumerate() {
        let (want, want_error) = (numbers(&w["irradiance"]), numbers(&w["std_err"]));
        for c in 0..3 {
            let allowed = 0.01 * want[c] + 3.0 * error[c].hypot(want_error[c]);
            let off = (value[c] - want[c]).abs();
            if allowed < off || off.is_nan() {
                faults.push(format!("point {i} channel {c}: {} wanted {} +- {allowed}", value[c], want[c]));
            }
            assert!(error[c] <= 0.02 * value[c].abs() + 1e-9, "point {i}: standard error {}", error[c]);
        }
    }
    assert!(faults.is_empty(), "{name}\n{}", faults.join("\n"));
}

#[test]
fn a_room_with_a_point_light() {
    check("surface_point", &[]);
}

#[test]
fn a_cornell_box() {
    check("surface_cornell", &[]);
}

/// Unbiased paths through fog: lamps in sight and hidden, coloured and absorbing media, forward scattering, a box of fog, a
/// sun through a slab.
#[test]
fn rooms_with_fog() {
    for name in ["fog_absorbing_hg", "fog_black", "fog_box", "fog_gray", "fog_lamp", "fog_shadow", "fog_sun"]
    {
        check(name, &["--media", "reference", "--target-error", "0.01"]);
    }
}
