//! The program as it is called.

use serde_json::Value;
use std::process::{Command, Output};

fn tables(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tables")).args(args).output().expect("the program starts")
}

fn json(args: &[&str]) -> Value {
    let out = tables(args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_slice(&out.stdout).expect("JSON")
}

#[test]
fn queries_are_answered_as_json() {
    let out =
        json(&["query", "--emitter", "point", "--depth", "4", "--g", "-0.7", "--orders", "1", "--json"]);
    assert_eq!(out["zh"].as_array().expect("coefficients").len(), 11);
    assert!(out.get("axis").is_none());
    let out = json(&["query", "--emitter", "area", "--depth", "0.3", "--theta", "70", "--json"]);
    let axis: Vec<f64> = out["axis"].as_array().expect("an axis").iter().filter_map(Value::as_f64).collect();
    assert!((axis.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-9 && 0.0 < axis[0], "{axis:?}");
    // Orders add up.
    let first = |orders: &str| {
        let args =
            ["query", "--emitter", "directional", "--depth", "1", "--albedo", "0.6", "--orders", orders];
        json(&[&args[..], &["--json"]].concat())["zh"][0].as_f64().expect("a number")
    };
    assert!((first("1") + first("2..") - first("all")).abs() < 1e-12);
    assert!((first("1") + first("2..10") - first("1..10")).abs() < 1e-12);
    assert!(first("1..10") < first("all"));
    let out = tables(&["query", "--emitter", "point", "--depth", "1", "--g", "0.99", "--json"]);
    assert!(String::from_utf8_lossy(&out.stderr).contains("g is outside"));
    assert_eq!(serde_json::from_slice::<Value>(&out.stdout).expect("JSON")["clamped"][0], "g");
}

#[test]
fn bad_usage_ends_with_2_and_a_remedy() {
    for (args, says) in [
        (vec!["query", "--emitter", "point", "--depth", "-1"], "positive"),
        (vec!["query", "--emitter", "point", "--depth", "1", "--albedo", "1.1"], "albedo"),
        (vec!["query", "--emitter", "point", "--depth", "1", "--g", "-1"], "g lies"),
        (vec!["query", "--emitter", "point", "--depth", "1", "--orders", "3.."], "1 or 2"),
        (vec!["inspect", "--file", "nowhere.zht"], "tables build"),
        (vec!["inspect", "--file", "Cargo.toml"], "ZHTABLE"),
        (vec!["plot", "-o", "picture.gif"], ".svg or .png"),
        (vec!["build", "-o", "no/such/folder/file.zht"], "no such folder"),
    ] {
        let out = tables(&args);
        let error = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(2), "{args:?}: {error}");
        assert!(error.contains(says), "{args:?}: {error}");
        assert!(out.stdout.is_empty());
    }
}

#[test]
fn files_are_inspected_and_drawn() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = tables(&["inspect"]);
    let text = String::from_utf8_lossy(&out.stdout);
    assert!(text.contains("preset default") && text.contains("area         order 1"), "{text}");
    assert!(json(&["inspect", "--json"])["blocks"].as_array().expect("blocks").len() == 33);
    for (name, magic) in [("a.svg", &b"<svg"[..]), ("a.png", &b"\x89PNG"[..])] {
        let path = folder.path().join(name);
        let out = tables(&["plot", "-o", &path.to_string_lossy(), "--g", "0.5"]);
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        assert!(std::fs::read(&path).expect("a picture").starts_with(magic), "{name}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("the folder").count(), 2, "nothing else is left");
}

/// A small part of what `tables verify` does.
#[test]
fn the_embedded_file_holds() {
    let out = tables(&["verify", "--queries", "300"]);
    let text = String::from_utf8_lossy(&out.stdout);
    assert_eq!(out.status.code(), Some(0), "{text}");
    assert!(text.contains("all within bounds") && text.contains("area orders 2.."), "{text}");
}
