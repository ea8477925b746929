//! Only the effects that a scene calls for: small kernels find what general ones find, and take fewer instructions.
//!
//! Instructions are counted by callgrind (valgrind) of `bake points`, on one thread: 16 points in a small room with 512 paths each, after the pilot and,
//! where there are media, a light grid of 200 nodes. Loading is 1 % of it, and nothing is unwrapped or written. Stages (probes, denoising and so on)
//! have no row: their cost is the seconds that `bake plan` gives. `UPDATE_EXPECT=1 RUN_SLOW_TESTS=1` writes what was counted to `data/effects.md` and to the file
//! that `bake plan` reads.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    env, fs,
    path::{Path, PathBuf},
    process::Command,
    sync::atomic::{AtomicUsize, Ordering},
    thread,
};
use suite::{baked, scenes::closed, tool};

/// How the results of two kernels compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Same {
    /// Every value of the lightmap has the same bits.
    Bits,
    /// They choose lights or places another way: equal within their noise.
    Mean,
    /// Tables are looked up over a range of albedos, and not at one: equal within what interpolation costs.
    Nearly,
}

/// A small kernel on a scene for which it is right, and the general one there.
#[derive(Clone, Copy, Debug)]
struct Row {
    effect: &'static str,
    /// What the scene lacks.
    without: &'static str,
    chosen: &'static str,
    general: &'static str,
    config: &'static str,
    args: &'static [&'static str],
    same: Same,
}

const SKY: &str = "sky = [0.5, 0.75, 1]\n";
const LAMP: &str = "sky = 0\n[[lamps]]\nposition = [1.5, 1, 0.75]\nintensity = 2\n";
const BOTH: &str = "sky = [0.5, 0.75, 1]\n[[lamps]]\nposition = [1.5, 1, 0.75]\nintensity = 2\n";
const FOG: &str = "sky = [0.5, 0.75, 1]\n[[lamps]]\nposition = [1.5, 1, 0.75]\nintensity = 2\n\
    [[media]]\nsigma_s = 0.1\nsigma_a = 0.02\nbox = [[-2, 0, -1.5], [2, 3, 1.5]]\n";
const PURE: &str = "sky = [0.5, 0.75, 1]\n[[lamps]]\nposition = [1.5, 1, 0.75]\nintensity = 2\n\
    [[media]]\nsigma_s = 0.1\nbox = [[-2, 0, -1.5], [2, 3, 1.5]]\n";
const TABLE: &[&str] = &["--media", "table"];
const ATTENUATE: &[&str] = &["--media", "attenuate"];

#[rustfmt::skip]
const ROWS: &[Row] = &[
    Row { effect: "media", without: "media", chosen: "none", general: "there", config: BOTH, args: &[], same: Same::Bits },
    Row { effect: "media-colour", without: "coloured media", chosen: "grey", general: "coloured", config: FOG, args: &[], same: Same::Bits },
    Row { effect: "media-albedo", without: "a second albedo (table)", chosen: "one", general: "several", config: FOG, args: TABLE, same: Same::Nearly },
    Row { effect: "absorption", without: "absorption (table)", chosen: "none", general: "there", config: PURE, args: TABLE, same: Same::Bits },
    Row { effect: "phase", without: "a g other than 0", chosen: "isotropic", general: "henyey-greenstein", config: FOG, args: &[], same: Same::Bits },
    Row { effect: "density", without: "varying density", chosen: "constant", general: "uneven", config: FOG, args: &[], same: Same::Mean },
    Row { effect: "suns", without: "suns", chosen: "none", general: "there", config: BOTH, args: &[], same: Same::Bits },
    Row { effect: "lamps", without: "lamps", chosen: "none", general: "tree", config: SKY, args: &[], same: Same::Bits },
    Row { effect: "lamps", without: "a second lamp", chosen: "one", general: "tree", config: LAMP, args: &[], same: Same::Bits },
    Row { effect: "emission", without: "emissive surfaces", chosen: "none", general: "tree", config: BOTH, args: &[], same: Same::Bits },
    Row { effect: "sky", without: "a sky", chosen: "black", general: "image", config: LAMP, args: &[], same: Same::Bits },
    Row { effect: "sky", without: "an image of a sky", chosen: "smooth", general: "image", config: BOTH, args: &[], same: Same::Bits },
    Row { effect: "opacity", without: "anything that lets light pass", chosen: "opaque", general: "passing", config: BOTH, args: &[], same: Same::Bits },
    Row { effect: "textures", without: "textures", chosen: "constant", general: "textured", config: BOTH, args: &[], same: Same::Bits },
    Row { effect: "traversal", without: "need of plain loops", chosen: "avx2", general: "portable", config: BOTH, args: &[], same: Same::Bits },
];

/// Further pairs that are the same to the bit, which take a while longer.
#[rustfmt::skip]
const MORE: &[Row] = &[
    Row { effect: "lamps", without: "a second lamp", chosen: "one", general: "weighed", config: LAMP, args: &[], same: Same::Bits },
    Row { effect: "lamps", without: "a second lamp", chosen: "one", general: "all", config: FOG, args: &[], same: Same::Bits },
    Row { effect: "density", without: "varying density", chosen: "constant", general: "uneven", config: FOG, args: ATTENUATE, same: Same::Bits },
    Row { effect: "media-colour", without: "coloured media", chosen: "grey", general: "coloured", config: FOG, args: ATTENUATE, same: Same::Bits },
    Row { effect: "media-colour", without: "coloured media", chosen: "grey", general: "coloured", config: FOG, args: TABLE, same: Same::Bits },
    Row { effect: "media", without: "media", chosen: "none", general: "there", config: BOTH, args: &["--media", "reference"], same: Same::Bits },
    Row { effect: "phase", without: "a g other than 0", chosen: "isotropic", general: "henyey-greenstein", config: FOG, args: &["--media", "reference"], same: Same::Bits },
    Row { effect: "opacity", without: "anything that lets light pass", chosen: "opaque", general: "passing", config: FOG, args: &[], same: Same::Bits },
];

const COMMON: &[&str] = &[
    "run",
    "scene.glb",
    "--config",
    "bake.toml",
    "--threads",
    "1",
    "--progress",
    "none",
    "--irradiance-cache",
    "off",
    "--probes",
    "off",
    "--texture",
    "none",
    "--seams",
    "off",
    "--grid-nodes",
    "200",
    "--probe-count",
    "64",
    "--probe-samples",
    "16",
];

#[rustfmt::skip]
const POINTS: &[&str] = &[
    "points", "scene.glb", "points.json", "--config", "bake.toml", "--threads", "1", "--progress", "none", "--samples", "512",
    "--grid-nodes", "200",
];

impl Row {
    /// A folder with the scene and its configuration.
    fn folder(&self) -> tempfile::TempDir {
        let dir = tool::folder_with(&closed::bare_room());
        fs::write(dir.path().join("bake.toml"), self.config).unwrap();
        let on_the_floor = |i: u32| {
            let [x, z] = [f64::from(i % 4) * 0.9 - 1.6, f64::from(i / 4) * 0.6 - 0.8];
            json!({"position": [x, 0.0, z], "normal": [0.0, 1.0, 0.0]})
        };
        let points = json!({"points": (0..16).map(on_the_floor).collect::<Vec<_>>()});
        fs::write(dir.path().join("points.json"), points.to_string()).unwrap();
        dir
    }

    fn command(&self, out: &str, force: Option<&str>) -> Vec<String> {
        let own = ["-o", out, "--samples", "8", "--texels-per-metre", "1.5"];
        let all = COMMON.iter().chain(self.args).chain(&own).map(|a| (*a).to_owned());
        all.chain(self.forced(force)).collect()
    }

    /// What instructions are counted of.
    fn counted(&self, force: Option<&str>) -> Vec<String> {
        let all = POINTS.iter().chain(self.args).map(|a| (*a).to_owned());
        all.chain(self.forced(force)).collect()
    }

    fn forced(&self, kernel: Option<&str>) -> Vec<String> {
        kernel.map_or_else(Vec::new, |k| vec!["--force".to_owned(), format!("{}={k}", self.effect)])
    }

    fn name(&self) -> String {
        format!("{}={}", self.effect, self.chosen)
    }
}

/// The kernel that the plan of a row's scene names, without anything forced.
fn planned(row: &Row, dir: &Path) -> String {
    let own = ["--json", "--samples", "8", "--texels-per-metre", "1"];
    let mut args: Vec<&str> = COMMON.iter().chain(row.args).chain(&own).copied().collect();
    args[0] = "plan";
    let plan: Value = serde_json::from_str(&tool::bake(&args, dir).expect(0).stdout).unwrap();
    let effects = plan["effects"].as_array().unwrap();
    let found = effects.iter().find(|e| e["effect"] == row.effect).unwrap_or_else(|| panic!("{row:?}"));
    found["kernel"].as_str().unwrap().to_owned()
}

#[test]
fn small_kernels_find_what_general_ones_find() {
    // Readying tables over all albedos takes its time.
    let quick = |r: &&Row| r.effect != "media-albedo" || suite::slow();
    let more = if suite::slow() { MORE } else { &[] };
    let rows: Vec<&Row> = ROWS.iter().chain(more).filter(quick).collect();
    let next = AtomicUsize::new(0);
    // Each bakes with one thread.
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                while let Some(row) = rows.get(next.fetch_add(1, Ordering::Relaxed)) {
                    row.finds_the_same();
                }
            });
        }
    });
}

impl Row {
    /// The small kernel is what the plan chooses, and finds what the general one finds.
    fn finds_the_same(&self) {
        let row = self;
        let dir = row.folder();
        if row.effect != "traversal" {
            assert_eq!(planned(row, dir.path()), row.chosen, "{row:?}");
        }
        let args = [row.command("small", None), row.command("general", Some(row.general))];
        for args in &args {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            let _ = tool::bake(&args, dir.path()).expect(0);
        }
        let file = |out: &str| fs::read(dir.path().join(out).join("lightmap-0.exr")).unwrap();
        assert_eq!(file("small") == file("general"), row.same == Same::Bits, "{row:?}");
        if row.same == Same::Mean {
            let _ = tool::bake(&["compare", "small", "general"], dir.path()).expect(0);
        }
        if row.same == Same::Nearly {
            let [a, b] = ["small", "general"].map(|out| mean(&dir.path().join(out)));
            assert!((a / b - 1.0).abs() < 2e-3, "{row:?}: {a} {b}");
        }
    }
}

/// Mean of all covered texels.
fn mean(bake: &Path) -> f64 {
    let bake = baked::Baked::read(bake).unwrap();
    let means: Vec<f64> = bake.node_means().values().map(|m| m[0].element_sum()).collect();
    means.iter().sum::<f64>() / means.len() as f64
}

#[test]
fn words_of_kernels_are_checked() {
    let row = &ROWS[0];
    let dir = row.folder();
    let fog = "[[media]]\nname = \"mist\"\nsigma_s = [0.1, 0.2, 0.1]\ng = 0.5\n";
    fs::write(dir.path().join("bake.toml"), format!("{BOTH}{fog}")).unwrap();
    let said = |force: &str, code: i32| {
        let args = [
            &["plan", "scene.glb", "--config", "bake.toml", "--texels-per-metre", "1"],
            &["--force", force][..],
        ]
        .concat();
        let done = tool::bake(&args, dir.path()).expect(code);
        format!("{}{}", done.stdout, done.stderr)
    };
    for (force, what) in [
        ("phase=isotropic", "mist"),
        ("media-colour=grey", "mist"),
        ("lamps=weighted", "did you mean `weighed`?"),
        ("lamp=tree", "did you mean `lamps`?"),
        ("lamps", "EFFECT=KERNEL"),
        ("sky=tree", "black, smooth, image"),
    ] {
        assert!(said(force, 2).contains(what), "{}", said(force, 2));
    }
    for (force, what) in [
        ("media=none", "1 media are left out"),
        ("lamps=none", "1 lamps are left out"),
        ("sky=black", "sky is left out"),
    ] {
        assert!(said(force, 0).contains(what), "{}", said(force, 0));
    }
    let tree = said("lamps=tree", 0);
    assert!(tree.lines().any(|l| l.contains("point and spot") && l.contains("tree!")), "{tree}");
}

/// What is left out is not in the result, and the manifest has it; the file's wish counts, and the command line stands above it.
#[test]
fn effects_are_left_out_on_request() {
    let row = &ROWS[6];
    let dir = row.folder();
    let bake = |config: &str, out: &str, more: &[&str]| {
        fs::write(dir.path().join("bake.toml"), config).unwrap();
        let args = row.command(out, None);
        let args: Vec<&str> = args.iter().map(String::as_str).chain(more.iter().copied()).collect();
        let _ = tool::bake(&args, dir.path()).expect(0);
        let manifest: Value =
            serde_json::from_slice(&fs::read(dir.path().join(out).join("manifest.json")).unwrap()).unwrap();
        (
            fs::read(dir.path().join(out).join("lightmap-0.exr")).unwrap(),
            manifest["settings"]["force"].clone(),
        )
    };
    let (sky, none) = bake(SKY, "sky", &[]);
    let forced = format!("{BOTH}[run]\nforce = \"lamps=none\"\n");
    let (left_out, words) = bake(&forced, "left-out", &[]);
    assert!(sky == left_out);
    assert_eq!((none, words), (Value::Null, json!(["lamps=none"])));
    let (lamp, words) = bake(&forced, "lamp", &["--force", "lamps=one"]);
    assert!(lamp != sky);
    assert_eq!(words, json!(["lamps=one"]));
}

/// Whether there is valgrind.
#[expect(clippy::print_stdout, reason = "a skipped test says so")]
fn valgrind() -> bool {
    let there = Command::new("valgrind").arg("--version").output().is_ok_and(|o| o.status.success());
    if !there {
        println!("skipped: counting instructions: there is no valgrind");
    }
    there
}

/// Instructions of a bake.
fn instructions(program: &Path, row: &Row, force: Option<&str>) -> u64 {
    let dir = row.folder();
    let mut command = Command::new("valgrind");
    command.args(["--tool=callgrind", "--callgrind-out-file=/dev/null"]).arg(program);
    let done = command.args(row.counted(force)).current_dir(dir.path()).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}");
    let line = said.lines().find_map(|l| l.split_once("Collected :"));
    line.and_then(|(_, n)| n.trim().parse().ok()).unwrap_or_else(|| panic!("no count in {said}"))
}

/// What `bake plan` knows.
fn recorded() -> (PathBuf, BTreeMap<String, BTreeMap<String, u64>>) {
    let path = suite::root().join("bake/src/plan/savings.json");
    let table = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    (path, table)
}

/// Choosing the small kernel never costs, and saves what the table says; three of its rows, all where slow tests are asked for.
#[test]
#[expect(clippy::print_stdout, reason = "the table is what the test is for")]
fn small_kernels_take_fewer_instructions() {
    if !valgrind() {
        return;
    }
    let (path, before) = recorded();
    let update = env::var_os("UPDATE_EXPECT").is_some();
    let fast = ["media=none", "phase=isotropic", "textures=constant"];
    let mut table = BTreeMap::new();
    let mut counts = BTreeMap::new();
    // Several rows share a bake.
    let mut count = |row: &Row, force: Option<&str>| {
        let key = (row.config, row.args, row.counted(force));
        *counts.entry(key).or_insert_with(|| instructions(tool::bake_path(), row, force))
    };
    let mut text = String::new();
    // Making tables ready for a range of albedos takes minutes in valgrind, and of whole bakes most is not sampling.
    let counted = ROWS.iter().filter(|r| r.same != Same::Nearly);
    for row in counted.filter(|r| suite::slow() || fast.contains(&r.name().as_str())) {
        let chosen = count(row, None);
        let general = count(row, Some(row.general));
        let saved = 100.0 * (1.0 - chosen as f64 / general as f64);
        let line = format!(
            "| {} | {} | {} | {:.1} | `{}` | {:.1} | {saved:.1} % |\n",
            row.effect,
            row.without,
            row.chosen,
            chosen as f64 / 1e6,
            row.general,
            general as f64 / 1e6
        );
        print!("{line}");
        text += &line;
        assert!(chosen as f64 <= general as f64 * 1.002, "{row:?}: {chosen} {general}");
        if !update {
            let old = &before[&row.name()];
            let ratio = chosen as f64 / general as f64 / (old["chosen"] as f64 / old["general"] as f64);
            assert!((ratio - 1.0).abs() < 0.02, "{row:?}: {chosen} of {general}, recorded {old:?}");
        }
        table.insert(row.name(), json!({"chosen": chosen, "general": general}));
    }
    let mut out = None;
    if suite::slow() {
        let (row, program) = (&ROWS[0], without_media());
        let [chosen, out_of_it] = [tool::bake_path(), &program].map(|p| instructions(p, row, None));
        let more = 100.0 * (chosen as f64 / out_of_it as f64 - 1.0);
        let line = format!(
            "\nWith media compiled out (`cargo build --no-default-features`) the bake without media takes {:.1} million instructions; with them \
             compiled in and not there {more:+.2} %.\n",
            out_of_it as f64 / 1e6
        );
        print!("{line}");
        assert!(more <= 1.0, "{chosen} {out_of_it}");
        out = Some(line);
    }
    if update && let Some(out) = out {
        fs::write(path, serde_json::to_string_pretty(&table).unwrap() + "\n").unwrap();
        let head = "| effect | scene without | chosen | million instructions | general | million instructions | saved |\n|---|---|---|---|---|---|---|\n";
        fs::write(suite::root().join("data/effects.md"), format!("{head}{text}{out}")).unwrap();
    }
}

/// The program without the feature `media`, in a folder of its own below that of builds.
fn without_media() -> PathBuf {
    let built = tool::bake_path();
    let profile = built.parent().unwrap();
    let target = profile.parent().unwrap().join("without-media");
    let name = if profile.ends_with("debug") { "dev" } else { "release" };
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let args = [
        "build",
        "--quiet",
        "-p",
        "bake",
        "--bin",
        "bake",
        "--no-default-features",
        "--features",
        "comparison",
        "--profile",
        name,
        "--target-dir",
    ];
    let done = Command::new(cargo).args(args).arg(&target).current_dir(suite::root()).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    target.join(profile.file_name().unwrap()).join(built.file_name().unwrap())
}

/// A program without media refuses a scene that has some, says why, and bakes it with `--media off`.
#[test]
fn a_program_without_media_says_so() {
    if !suite::slow() {
        return;
    }
    let row = ROWS.iter().find(|r| r.effect == "phase").unwrap();
    let dir = row.folder();
    let run = |more: &[&str]| {
        let mut args = row.command("out", None);
        args.extend(more.iter().map(|a| (*a).to_owned()));
        Command::new(without_media()).args(args).current_dir(dir.path()).output().unwrap()
    };
    let refused = run(&[]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("feature `media`"));
    assert_eq!(run(&["--media", "off"]).status.code(), Some(0));
}
