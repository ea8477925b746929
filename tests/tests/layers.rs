//! Modules use only modules before them, and the runtime sample knows nothing of the baker.

use std::{
    fs,
    path::{Path, PathBuf},
};

/// The modules of `bake`, each of which may use those before it.
const ORDER: [&str; 13] = [
    "error",
    "sample",
    "scene",
    "geom",
    "media",
    "light",
    "plan",
    "transport",
    "solve",
    "output",
    "compare",
    "study",
    "cli",
];

fn sources(dir: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// First path segments after `crate::`, also inside `crate::{...}`.
fn used(code: &str) -> Vec<String> {
    let word = |s: &str| s.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let mut out = Vec::new();
    for rest in code.split("crate::").skip(1) {
        let Some(group) = rest.strip_prefix('{') else {
            out.push(word(rest));
            continue;
        };
        let mut depth = 1;
        let mut start = true;
        for (i, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 1 => start = true,
                _ if start && depth == 1 && !c.is_whitespace() => {
                    out.push(word(&group[i..]));
                    start = false;
                }
                _ => {}
            }
            if depth == 0 {
                break;
            }
        }
    }
    out
}

#[test]
fn groups_are_understood() {
    assert_eq!(used("use crate::{a::{b, c}, d::e}; crate::f::g()"), ["a", "d", "f"]);
}

#[test]
fn modules_use_only_what_comes_before_them() {
    let src = suite::root().join("bake/src");
    let mut files = Vec::new();
    sources(&src, &mut files);
    files.sort();
    let rank = |name: &str| ORDER.iter().position(|o| *o == name);
    let mut faults = Vec::new();
    let mut links = 0;
    for file in &files {
        let relative = file.strip_prefix(&src).unwrap();
        let first = relative.components().next().unwrap().as_os_str().to_str().unwrap();
        let module = first.trim_end_matches(".rs");
        if ["lib", "main", "bin"].contains(&module) {
            continue;
        }
        let Some(own) = rank(module) else {
            faults.push(format!("{}: module {module} has no place in the order", relative.display()));
            continue;
        };
        let text = fs::read_to_string(file).unwrap();
        // Comments may point anywhere.
        let code: Vec<&str> = text.lines().filter(|l| !l.trim_start().starts_with("//")).collect();
        for name in used(&code.join("\n")) {
            match rank(&name) {
                Some(other) if own < other => {
                    faults.push(format!("{}: {module} uses {name}, which comes later", relative.display()));
                }
                Some(_) => links += 1,
                None => faults.push(format!("{}: crate::{name} is not a module", relative.display())),
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(20 < links, "only {links} uses were found");
}

/// Names of this workspace's packages among the dependencies of `package`.
fn own_dependencies(package: &str) -> Vec<String> {
    let text = fs::read_to_string(suite::root().join(package).join("Cargo.toml")).unwrap();
    let manifest: toml::Table = text.parse().unwrap();
    let members = ["bake", "tables", "runtime-sample", "suite"];
    let names =
        manifest.get("dependencies").and_then(toml::Value::as_table).into_iter().flat_map(toml::Table::keys);
    names.filter(|name| members.contains(&name.as_str())).cloned().collect()
}

#[test]
fn packages_depend_downwards() {
    assert_eq!(own_dependencies("tables"), Vec::<String>::new());
    assert_eq!(own_dependencies("runtime-sample"), ["tables"]);
    assert_eq!(own_dependencies("bake"), ["tables"]);
}
