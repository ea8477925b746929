//! Exit codes and words of the command line.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::{collections::BTreeMap, fs, path::Path, thread, time::Duration};

use suite::{
    baked,
    scenes::{closed, open},
    tool::{self, Finished},
};

fn run(args: &[&str]) -> Finished {
    let dir = tool::folder_with(&open::under_sky(1.0, 1, [1.0; 3]));
    tool::bake(args, dir.path())
}

#[track_caller]
fn refused(args: &[&str], words: &[&str]) {
    let done = run(args).expect(2);
    for word in words {
        assert!(done.stderr.contains(word), "`{word}` is not said\n{done}");
    }
    assert_eq!(done.stdout, "", "{done}");
}

#[test]
fn help_fits_a_screen() {
    let help = run(&["--help"]).expect(0).stdout;
    assert!(help.lines().count() <= 60, "{help}");
    for line in help.lines() {
        assert!(line.chars().count() <= 100, "{line}");
    }
    for command in ["run", "plan", "check", "points", "compare", "html", "merge"] {
        assert!(help.lines().any(|l| l.trim_start().starts_with(command)), "{command}\n{help}");
    }
    let run_help = run(&["run", "--help"]).expect(0).stdout;
    for flag in
        ["--quality", "--samples", "--bounces", "--texels-per-metre", "--seed", "--threads", "--progress"]
    {
        assert!(run_help.contains(flag), "{flag}\n{run_help}");
    }
}

#[test]
fn bad_usage_is_2_and_names_the_remedy() {
    refused(&["run", "scene.glb", "--sampels", "3"], &["--sampels", "--samples"]);
    refused(&["comapre"], &["comapre", "compare"]);
    refused(&["run", "scene.glb", "--samples", "none"], &["none", "--samples"]);
    refused(&["run", "scene.glb", "--quality", "best"], &["best", "draft", "medium", "high"]);
    refused(&["run", "scene.glb", "--texels-per-metre", "-3"], &["-3"]);
    refused(&["run", "absent.glb"], &["absent.glb"]);
    refused(&["check", "absent.glb"], &["absent.glb"]);
    refused(&["compare", "absent", "scene.glb"], &["absent"]);
}

#[test]
fn reserved_words_exit_with_one_line() {
    for args in [
        &["merge", "out"][..],
        &["run", "scene.glb", "--resume"][..],
        &["run", "scene.glb", "--shard", "3-12", "--of", "16"][..],
    ] {
        let done = run(args).expect(2);
        assert_eq!(done.stderr.trim_end().lines().count(), 1, "{done}");
    }
}

#[test]
fn check_reports_all_findings_with_path_and_remedy() {
    let done = run(&["check", "scene.glb"]).expect(0);
    assert!(!done.stdout.contains("error:"), "{done}");
    // A file that is cut off cannot be read at all.
    let dir = tool::folder_with(&open::under_sky(1.0, 1, [1.0; 3])[..300]);
    let done = tool::bake(&["check", "scene.glb"], dir.path()).expect(2);
    let said = format!("{}{}", done.stdout, done.stderr);
    assert!(said.contains("error") && said.contains("fix:"), "{done}");
}

#[test]
fn unknown_words_in_extras_are_findings_with_the_nearest_one() {
    let mut glb = suite::gltf::Glb::new();
    let white = glb.material(&suite::gltf::Material::matte("white", [0.5; 3]));
    let mut quad = suite::shape::Shape::default();
    quad.grid(glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::NEG_Z, 1, 1);
    let mesh = glb.mesh("quad", &[(&quad, white)]);
    let node = suite::gltf::Node::new("quad").mesh(mesh);
    glb.node(node.extras(serde_json::json!({"texels_per_meter": 3})));
    let dir = tool::folder_with(&glb.finish());
    let done = tool::bake(&["check", "scene.glb"], dir.path()).expect(0);
    let said = format!("{}{}", done.stdout, done.stderr);
    assert!(said.contains("texels_per_meter") && said.contains("texels_per_metre"), "{done}");
}

#[test]
fn a_plan_is_printed_as_text_and_as_json() {
    let text = run(&["plan", "scene.glb", "--explain"]).expect(0);
    assert!(text.stdout.contains("sky"), "{text}");
    let done = run(&["plan", "scene.glb", "--json"]).expect(0);
    let plan: serde_json::Value =
        serde_json::from_str(&done.stdout).unwrap_or_else(|e| panic!("{e}\n{done}"));
    assert!(plan.is_object());
}

#[test]
fn a_bake_equals_itself_and_differs_from_another() {
    let dir = tool::folder_with(&closed::quad_lamp(1.0, 5.0, false));
    let bake = |out: &str, more: &[&str]| {
        let args =
            [&["run", "scene.glb", "-o", out, "--samples", "16", "--texels-per-metre", "5"], more].concat();
        let _ = tool::bake(&args, dir.path()).expect(0);
    };
    bake("a", &[]);
    bake("b", &["--bounces", "0"]);
    let _ = tool::bake(&["compare", "a", "a"], dir.path()).expect(0);
    let _ = tool::bake(&["compare", "a", "b"], dir.path()).expect(1);
}

#[test]
fn a_folder_that_is_no_bake_is_not_written_into() {
    let dir = tool::folder_with(&open::under_sky(1.0, 1, [1.0; 3]));
    let folder = dir.path().join("photos");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("cat.png"), "miaow").unwrap();
    let done = tool::bake(&["run", "scene.glb", "-o", "photos"], dir.path()).expect(2);
    assert!(done.stderr.contains("photos"), "{done}");
    let names: Vec<_> = fs::read_dir(&folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["cat.png"]);
}

#[test]
fn the_default_folder_is_named_after_the_scene() {
    let dir = tool::folder_with(&open::under_sky(1.0, 1, [1.0; 3]));
    let args = ["run", "scene.glb", "--samples", "4", "--texels-per-metre", "4"];
    let _ = tool::bake(&args, dir.path()).expect(0);
    assert!(dir.path().join("scene.bake/manifest.json").is_file());
}

#[test]
fn pictures_take_the_exposure_that_is_said() {
    let scene = open::under_sky(1.0, 1, [1.0; 3]);
    let bake = |more: &[&str]| {
        let args = [&["--samples", "4", "--texels-per-metre", "4"], more].concat();
        tool::baked(&scene, &args)
    };
    let said = bake(&["--exposure", "0.25"]);
    // White under a sky of 1 nit: 0.25 (1 + 0.25 / 144) / 1.25 = 0.20035, which the sRGB curve makes 124.
    let page = image::load_from_memory(&said.files["lightmap-0.png"]).unwrap().to_rgb8();
    assert!(page.pixels().any(|p| p.0 == [124; 3]), "no pixel of 124");
    let exposure = |baked: &baked::Baked| baked.manifest.exposure.unwrap();
    assert_eq!(exposure(&said), 0.25);
    assert!((exposure(&bake(&[])) - 0.18).abs() < 0.02, "the plane is 1 nit");
    for wrong in ["0", "-1", "nan", "dark"] {
        refused(&["run", "scene.glb", "--exposure", wrong], &["--exposure", "above 0"]);
    }
}

fn bytes(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    baked::files(dir).unwrap()
}

#[test]
fn an_interrupted_bake_leaves_the_earlier_one_as_it_was() {
    let dir = tool::folder_with(&closed::room(closed::Room::default()));
    let short =
        ["run", "scene.glb", "-o", "out", "--samples", "4", "--texels-per-metre", "4", "--progress", "none"];
    let _ = tool::bake(&short, dir.path()).expect(0);
    let before = bytes(&dir.path().join("out"));
    for (signal, folder) in [("INT", "out"), ("TERM", "out"), ("INT", "fresh")] {
        let long = [
            "run",
            "scene.glb",
            "-o",
            folder,
            "--samples",
            "20000",
            "--texels-per-metre",
            "16",
            "--progress",
            "none",
        ];
        let mut running = tool::start(tool::bake_path(), &long, dir.path());
        thread::sleep(Duration::from_millis(1500));
        assert!(!running.ended(), "the bake was done before it could be interrupted");
        tool::signal(&running, signal);
        let done = running.wait(Duration::from_secs(30)).expect(130);
        assert!(done.stderr.contains("interrupted"), "{done}");
    }
    assert!(bytes(&dir.path().join("out")) == before, "the earlier bake has changed");
    assert!(!dir.path().join("fresh").exists(), "nothing of the new bake may stay");
    let names = fs::read_dir(dir.path().join("out")).unwrap().count();
    assert_eq!(names, before.len() + 1, "only timings.json is there besides");
}

#[test]
fn the_version_names_the_tables() {
    let dir = tempfile::tempdir().unwrap();
    let done = tool::bake(&["--version"], dir.path()).expect(0);
    assert!(done.stdout.contains("response tables: default preset"), "{done}");
    assert_eq!(tool::bake(&["-V"], dir.path()).expect(0).stdout.lines().count(), 1);
}

/// Fog is simulated unless somebody leaves it out, which the plan says.
#[test]
fn media_are_simulated_unless_left_out() {
    let dir = tool::folder_with(&open::under_sun(10.0, glam::Vec3::NEG_Y, 0.0));
    fs::write(
        dir.path().join("fog.toml"),
        "[[media]]\nname = \"mist\"\nsigma_a = 1\nbox = [[-9, 1, -9], [9, 2, 9]]\n",
    )
    .unwrap();
    let plan = |more: &[&str]| {
        let args = ["plan", "scene.glb", "--config", "fog.toml", "--texels-per-metre", "2"];
        tool::bake(&[&args[..], more].concat(), dir.path()).expect(0)
    };
    assert!(plan(&[]).stdout.contains("a grid of light"));
    assert!(plan(&["--media", "off"]).stdout.contains("ignored"));
    let done = plan(&["--media", "attenuate"]);
    assert!(!done.stdout.contains("ignored") && done.stdout.contains("weakening light"), "{done}");
}
