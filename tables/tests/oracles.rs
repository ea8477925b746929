//! The builder against numbers that were computed independently, where they lie beside the checkout.

#![expect(clippy::print_stdout, reason = "what was compared belongs in the log")]

use serde_json::Value;
use std::fs;
use std::path::Path;
use tables::response::{directional, moments, patch, point, quadrature::tanh_sinh};

fn rows(file: &str, list: &str) -> Option<Vec<Value>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/oracles").join(file);
    let Ok(text) = fs::read_to_string(&path) else {
        println!("skipped: there is no {file} beside the checkout");
        return None;
    };
    let json: Value = serde_json::from_str(&text).expect("JSON");
    Some(json[list].as_array().expect("a list").clone())
}

fn number(row: &Value, key: &str) -> f64 {
    row[key].as_f64().unwrap_or_else(|| panic!("{key} in {row}"))
}

fn list(row: &Value, key: &str) -> Vec<f64> {
    row[key].as_array().expect("a list").iter().map(|v| v.as_f64().expect("a number")).collect()
}

/// Largest difference as a part of the first entry.
fn off(got: &[f64], want: &[f64]) -> f64 {
    assert!(got.iter().all(|v| v.is_finite()), "{got:?}");
    got.iter().zip(want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / want[0].abs()
}

#[test]
fn point_once_scattered() {
    let Some(rows) = rows("zh_point.json", "single") else { return };
    let rule = tanh_sinh(96);
    let mut worst = 0.0f64;
    for row in &rows {
        let zh = point::single(&rule, number(row, "D"), number(row, "g"));
        let d = off(&zh, &list(row, "zh"));
        worst = worst.max(d);
        assert!(d <= 1e-5 + number(row, "rel_err"), "{d:e} at {row}");
    }
    println!("{} rows, worst {worst:.1e} of l = 0", rows.len());
}

#[test]
fn sun_once_scattered() {
    let Some(rows) = rows("zh_directional.json", "rows") else { return };
    let rule = tanh_sinh(96);
    let mut worst = 0.0f64;
    for row in &rows {
        let zh = directional::single(&rule, number(row, "d"), number(row, "g"));
        let d = off(&zh, &list(row, "zh"));
        worst = worst.max(d);
        assert!(d <= 1e-5 + number(row, "rel_err"), "{d:e} at {row}");
    }
    println!("{} rows, worst {worst:.1e} of l = 0", rows.len());
}

#[test]
fn patch_once_scattered() {
    let Some(rows) = rows("area_single.json", "rows") else { return };
    let rule = tanh_sinh(48);
    let mut worst = 0.0f64;
    for row in &rows {
        let response = patch::single(&rule, number(row, "D"), number(row, "theta_e").to_radians(), 0.0);
        let fluence = number(row, "fluence");
        let vector = list(row, "vector");
        let mut d = (patch::fluence(&response) / fluence - 1.0).abs();
        for (a, b) in patch::vector(&response).into_iter().zip(vector) {
            d = d.max((a - b).abs() / fluence);
        }
        worst = worst.max(d);
        // Rules of 64 to 160 nodes agree to ten digits here; the rows' own error is the difference of two resolutions, and at
        // one row (D = 0.05, 180 degrees) the finer one is 1.66 times that away.
        assert!(d <= 1e-5 + 2.0 * number(row, "rel_err"), "{d:e} at {row}");
    }
    println!("{} rows, worst {worst:.1e} of the fluence", rows.len());
}

#[test]
fn point_scattered_more_often() {
    let Some(rows) = rows("zh_point.json", "multiple") else { return };
    let mut worst = 0.0f64;
    for row in &rows {
        let (d, g, c) = (number(row, "D"), number(row, "g"), number(row, "c"));
        let c = f64::min(c, 1.0 - 1e-9);
        let factor = (-moments::decay(c, g) * d).exp() / d * c * c;
        let zh = moments::rest_scaled(d, g, &[c])[0].map(|v| v * factor);
        let off = off(&zh, &list(row, "zh"));
        worst = worst.max(off);
        assert!(off <= 1e-3 + number(row, "rel_err"), "{off:e} {zh:?} at {row}");
    }
    println!("{} rows, worst {worst:.1e} of l = 0", rows.len());
}
