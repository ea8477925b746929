//! Mutated scenes and configurations: whatever they hold, loading, planning and a few paths end without a panic and soon.
//!
//! Every case follows from one number. `FUZZ_SECONDS` sets for how long new ones are tried (5 by default), `FUZZ_FROM` the
//! first of them. Numbers that once failed are kept in [`KEPT`] and tried every time, at every length.

#![expect(clippy::print_stdout, reason = "what was tried belongs in the log")]

use bake::geom::atlas::{Engine, Unwrap};
use bake::geom::texel::TexelMap;
use bake::output::scene_glb::{self, PageFile};
use bake::output::{assemble, denoise};
use bake::plan::settings::{Denoise, Sampling};
use bake::plan::{self, Force, MediaMode, Plan, Quality, Settings, Tuning};
use bake::sample::sequence::mix64;
use bake::scene::config::Config;
use bake::scene::document::Document;
use bake::scene::gltf::{self, LightUnits, LoadOptions};
use bake::solve::facing::Facing;
use bake::solve::lightmap::{self, Effort};
use bake::solve::probes::{Probing, Wanted, Where};
use bake::solve::{Monitor, directional};
use bake::transport::Kernel;
use serde_json::{Map, Number, Value};
use std::collections::BTreeMap;
use std::panic::{self, AssertUnwindSafe};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{env, fs};
use suite::scenes::{closed, hard, open};
use tables::probes::{Basis, ProbeVolume};

/// Cases that found a fault, which was mended.
const KEPT: &[u64] = &[1_009_087, 1_049_345];

/// No case may take longer; the machine may be busy with other tests.
const LIMIT: Duration = Duration::from_secs(60);

/// Larger files make cases slow without making them more different.
const LARGEST: u64 = 300_000;

/// The same numbers for the same case.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix64(self.0)
    }

    fn below(&mut self, n: usize) -> usize {
        usize::try_from(self.next() % n.max(1) as u64).expect("below a length")
    }

    fn pick<'a, T>(&mut self, list: &'a [T]) -> &'a T {
        &list[self.below(list.len())]
    }
}

/// A file that cases are made from.
struct Source {
    name: String,
    folder: Option<PathBuf>,
    bytes: Vec<u8>,
}

fn sources() -> Vec<Source> {
    let made = |name: &str, bytes: Vec<u8>| Source { name: name.to_owned(), folder: None, bytes };
    let mut list = vec![
        made("hall", fs::read(suite::root().join("data/hall.glb")).expect("the hall")),
        made("furnace", closed::furnace(0.5, 1.0)),
        made("lamp", open::under_point(1.0, [3.0, 2.0, 1.0])),
        made("spot", open::under_spot(1.0, 10.0, 0.2, 0.5)),
        made("instances", hard::instances()),
        made("degenerate", hard::degenerate()),
        made("pane", open::masked_pane(4)),
        made("glass", open::glass_pane(0.5, [0.5; 3])),
        made("sun", open::under_sun(10.0, glam::Vec3::new(0.1, -1.0, 0.2), 0.5)),
    ];
    if let Some(shared) = suite::shared("fuzzing real and broken files") {
        let mut found = Vec::new();
        walk(&shared.join("scenes"), &mut found);
        found.sort();
        for path in found {
            let folder = path.parent().map(Path::to_path_buf);
            list.push(Source {
                name: path.display().to_string(),
                folder,
                bytes: fs::read(&path).expect("a file"),
            });
        }
    }
    list
}

/// Scene files below a folder that are small enough.
fn walk(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder").flatten() {
        let (path, meta) = (entry.path(), entry.metadata().expect("an entry"));
        if meta.is_dir() {
            walk(&path, found);
        } else if meta.len() <= LARGEST
            && path.extension().is_some_and(|e| e == "glb" || e == "gltf")
            && !path.to_string_lossy().contains("glTF1")
            && !path.to_string_lossy().contains("sponza")
        {
            found.push(path);
        }
    }
}

/// Numbers and other values that break what is not looked at.
fn odd(dice: &mut Dice) -> Value {
    let numbers = [
        0.0,
        -1.0,
        1.0,
        0.5,
        -0.0,
        1e-45,
        1e-9,
        1e9,
        3.4e38,
        1e308,
        -1e308,
        2_147_483_648.0,
        4_294_967_295.0,
        4_294_967_296.0,
        9_007_199_254_740_993.0,
        255.0,
        5126.0,
        5121.0,
        65_535.0,
    ];
    match dice.below(9) {
        0 => Value::Null,
        1 => Value::Bool(dice.below(2) == 0),
        2 => Value::String(
            ["", "VEC3", "data:,", "data:application/octet-stream;base64,AAAA", "../x", "\u{0}"]
                [dice.below(6)]
            .into(),
        ),
        3 => Value::Array(vec![]),
        4 => Value::Object(Map::new()),
        5 => Value::Array((0..dice.below(20)).map(|_| Value::from(dice.below(9) as u64)).collect()),
        6 => Value::from(dice.next() % 40),
        _ => Number::from_f64(*dice.pick(&numbers)).map_or(Value::Null, Value::Number),
    }
}

/// Changes one place below `value`.
fn change(value: &mut Value, dice: &mut Dice) {
    match value {
        Value::Array(list) if !list.is_empty() && dice.below(8) != 0 => match dice.below(12) {
            0 => {
                list.remove(dice.below(list.len()));
            }
            1 => list.push(list[dice.below(list.len())].clone()),
            _ => {
                let i = dice.below(list.len());
                change(&mut list[i], dice);
            }
        },
        Value::Object(map) if !map.is_empty() && dice.below(8) != 0 => {
            let keys: Vec<String> = map.keys().cloned().collect();
            let key = dice.pick(&keys).clone();
            match dice.below(12) {
                0 => {
                    map.remove(&key);
                }
                1 => {
                    let other = map[dice.pick(&keys)].clone();
                    map.insert(key, other);
                }
                _ => change(map.get_mut(&key).expect("one of its keys"), dice),
            }
        }
        Value::Number(n) if dice.below(2) == 0 => {
            let x = n.as_f64().unwrap_or(0.0);
            let x = [x + 1.0, x - 1.0, -x, x * 2.0, x * 1e6, x * 1e-6][dice.below(6)];
            let whole = x.fract() == 0.0 && x.abs() < 9e15;
            #[expect(clippy::cast_possible_truncation, reason = "whole and in range")]
            let n = if whole { Some(Number::from(x as i64)) } else { Number::from_f64(x) };
            *value = n.map_or(Value::Null, Value::Number);
        }
        _ => *value = odd(dice),
    }
}

/// Changes bytes: flips, cuts, repeats.
fn scramble(bytes: &mut Vec<u8>, dice: &mut Dice) {
    for _ in 0..=dice.below(4) {
        if bytes.is_empty() {
            return;
        }
        let at = dice.below(bytes.len());
        match dice.below(8) {
            0 => bytes.truncate(at),
            1 => {
                let end = (at + 1 + dice.below(64)).min(bytes.len());
                bytes.drain(at..end);
            }
            2 => {
                let end = (at + 1 + dice.below(64)).min(bytes.len());
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            3 | 4 => {
                let word =
                    *dice.pick(&[0u32, 1, 0xffff_ffff, 0x7f80_0000, 0x7fc0_0000, 0x8000_0000, 0x7f7f_ffff]);
                for (k, b) in word.to_le_bytes().into_iter().enumerate() {
                    if let Some(to) = bytes.get_mut(at / 4 * 4 + k) {
                        *to = b;
                    }
                }
            }
            _ => bytes[at] ^= 1 << dice.below(8),
        }
    }
}

/// The JSON of a scene file and what stands behind it in a binary one.
fn parts(bytes: &[u8]) -> Option<(Value, Option<Vec<u8>>)> {
    if !bytes.starts_with(b"glTF") {
        return Some((serde_json::from_slice(bytes).ok()?, None));
    }
    let n = u32::from_le_bytes(bytes.get(12..16)?.try_into().ok()?) as usize;
    let json = serde_json::from_slice(bytes.get(20..20usize.checked_add(n)?)?).ok()?;
    Some((json, Some(bytes[20 + n..].to_vec())))
}

fn join(json: &Value, rest: Option<&[u8]>) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    let Some(rest) = rest else { return text };
    text.resize(text.len().next_multiple_of(4), b' ');
    let word = |n: usize| u32::try_from(n).expect("a small file").to_le_bytes();
    let mut out = b"glTF".to_vec();
    out.extend(word(2));
    out.extend(word(20 + text.len() + rest.len()));
    out.extend(word(text.len()));
    out.extend(b"JSON");
    out.extend(text);
    out.extend(rest);
    out
}

/// Every word of the configuration once.
const CONFIG: &str = r#"
texels_per_metre = 16
metals_black = false
sky = { zenith = [0.4, 0.6, 1.0], horizon = 0.8, ground = 0.1 }
[[lamps]]
name = "bulb"
type = "point"
position = [0, 2.5, 0]
intensity = 40
color = [1, 0.8, 0.6]
range = 20
mode = "mixed"
[[lamps]]
name = "downlight"
type = "spot"
position = [2, 3, 0]
direction = [0, -1, 0]
intensity = [90, 80, 60]
inner_cone = 15
outer_cone = 30
[[lamps]]
type = "directional"
direction = [-0.4, -1, -0.3]
illuminance = 0.25
angular_diameter = 0.52
[nodes."floor"]
lightmap = "on"
casts_shadow = true
texels_per_metre = 8
[run]
quality = "draft"
samples = 64
bounces = 8
max_size = 2048
seed = 7
"#;

fn config(dice: &mut Dice) -> String {
    if dice.below(4) == 0 {
        let mut bytes = CONFIG.as_bytes().to_vec();
        scramble(&mut bytes, dice);
        return String::from_utf8_lossy(&bytes).into_owned();
    }
    let mut value: toml::Value = toml::from_str(CONFIG).expect("the configuration is right");
    let mut json = serde_json::to_value(&value).expect("JSON knows more");
    for _ in 0..=dice.below(3) {
        change(&mut json, dice);
    }
    if let Ok(v) = serde_json::from_value(json) {
        value = v;
    }
    toml::to_string(&value).unwrap_or_default()
}

/// Loads, plans and gathers a few paths; says how far it got.
fn attempt(name: &str, bytes: &[u8], folder: Option<&Path>, config: Option<&str>) -> &'static str {
    let (config, mut findings) = match config.map(|text| Config::parse("bake.toml", text, None, None)) {
        None => (Config::default(), Vec::new()),
        Some(Ok(parsed)) => parsed,
        Some(Err(_)) => return "configuration refused",
    };
    let Ok(document) = Document::from_bytes(name, bytes, folder) else { return "file refused" };
    let options = LoadOptions { light_units: LightUnits::Gltf, ..LoadOptions::default() };
    let (scene, more) = gltf::load(&document, &config, &options);
    findings.extend(more);
    if plan::admit(&findings).is_err() {
        return "scene refused";
    }
    let settings = Settings {
        force: Force::default(),
        tuning: Tuning::default(),
        quality: Quality::Draft,
        samples: 2,
        sampling: Sampling::Exact(2),
        media: MediaMode::Reference,
        bounces: Some(2),
        texels_per_metre: None,
        max_size: 32,
        padding: 2,
        unwrap: Unwrap::Auto,
        engine: Engine::Uvunwrap,
        light_grid: Quality::Draft.light_grid(),
        direct: bake::light::Direct::Auto,
        seed: 1,
        irradiance_cache: false,
        split_direct: false,
        directional: Some(2),
        probes: None,
        texture: None,
        denoise: Denoise::Draft,
        seams: true,
    };
    let Ok(plan) = plan::make(scene, findings, settings, &|_, _| true) else { return "plan refused" };
    assert!(plan.memory(&document).peak() < 1 << 36, "a plan of a small file that states absurd memory");
    bake_a_little(&plan, &document);
    "baked"
}

/// Two paths in every texel, and the scene with its new coordinates.
fn bake_a_little(plan: &Plan, document: &Document) {
    let kernel = Kernel::new(plan.scene(), plan.tracing(), plan.settings().bounces, plan.settings().media);
    let map = TexelMap::build(plan.scene(), plan.atlas(), 0);
    let effort = Effort { samples: 2, small: 2, seed: 1, texel_size: plan.atlas().texels_per_metre.recip() };
    let monitor = Monitor::default();
    let solution = lightmap::bake_page(&kernel, plan.atlas(), &map, 0, effort, &Facing::default(), &monitor)
        .expect("nobody stops it");
    let mut solution = solution;
    let directions =
        directional::gather(&kernel, &map, 0, (2, 1), &mut solution, &monitor).expect("nobody stops it");
    let clean = denoise::denoise(plan, &map, &solution, &monitor).expect("nobody stops it");
    let (sheet, _) = assemble::page(plan, map, solution, clean, Some(directions));
    let page = sheet.page;
    let bad = page.sh1.iter().flatten().flatten().flatten().find(|v| !v.is_finite());
    assert_eq!(bad, None, "a direction that is none");
    let place = Where::Scene { about: 130 };
    let wanted = Wanted { place, basis: Basis::L2, samples: 16, seed: 1, number: 0 };
    if let Some(probing) = Probing::new(&kernel, wanted, &monitor).expect("nobody stops it") {
        let (volume, _) = probing.finish(&kernel, &monitor).expect("nobody stops it");
        assert!(
            ProbeVolume::from_bytes(&volume.to_bytes()).as_ref() == Ok(&volume),
            "probes that cannot be read"
        );
    }
    let wrong = page.radiance.iter().flatten().find(|v| !(v.is_finite() && 0.0 <= **v));
    assert_eq!(wrong, None, "a texel that is no light");
    let folder = tempfile::tempdir().expect("a folder");
    let _: Result<_, _> = scene_glb::write(
        &folder.path().join("scene.glb"),
        document,
        plan.scene(),
        plan.atlas(),
        &[PageFile { exr: "lightmap-0.exr".to_owned(), texture: None }],
    );
}

/// The sources that can be baked as they are.
fn sound(sources: &[Source]) -> Vec<usize> {
    let is_sound = |s: &Source| {
        let Ok(document) = Document::from_bytes("case.glb", &s.bytes, s.folder.as_deref()) else {
            return false;
        };
        let options = LoadOptions { light_units: LightUnits::Gltf, ..LoadOptions::default() };
        // With all its buffers it may be much larger than the file that names them.
        document.total_bytes() <= LARGEST
            && plan::admit(&gltf::load(&document, &Config::default(), &options).1).is_ok()
    };
    (0..sources.len()).filter(|&i| is_sound(&sources[i])).collect()
}

fn run(case: u64, sources: &[Source], sound: &[usize]) -> Result<&'static str, String> {
    let mut dice = Dice(case);
    // Most files of the broken kind end early, so most cases start from those that do not.
    let source = if dice.below(4) == 0 { dice.pick(sources) } else { &sources[*dice.pick(sound)] };
    let mut bytes = source.bytes.clone();
    match (dice.below(4), parts(&bytes)) {
        (1.., Some((mut json, mut rest))) => {
            for _ in 0..=[0, 0, 1, 2][dice.below(4)] {
                change(&mut json, &mut dice);
            }
            if let Some(rest) = &mut rest
                && dice.below(4) == 0
            {
                scramble(rest, &mut dice);
            }
            bytes = join(&json, rest.as_deref());
        }
        _ => scramble(&mut bytes, &mut dice),
    }
    let config = (dice.below(4) == 0).then(|| config(&mut dice));
    let start = Instant::now();
    let end = panic::catch_unwind(AssertUnwindSafe(|| {
        attempt("case.glb", &bytes, source.folder.as_deref(), config.as_deref())
    }));
    let seconds = start.elapsed();
    let place = || format!("case {case}, made from {}", source.name);
    if LIMIT < seconds {
        return Err(format!("{}: took {:.1} s", place(), seconds.as_secs_f64()));
    }
    end.map_err(|_| format!("{}: panicked", place()))
}

#[test]
fn mutated_files_end_without_a_panic() {
    let number = |name: &str, default: u64| env::var(name).map_or(default, |v| v.parse().expect("a number"));
    let (seconds, from) = (number("FUZZ_SECONDS", 5), number("FUZZ_FROM", 0));
    let sources = sources();
    let sound = sound(&sources);
    let mut faults = Vec::new();
    let mut ends = BTreeMap::new();
    let begin = Instant::now();
    let mut fresh = from;
    let mut kept = KEPT.iter();
    loop {
        let case = match kept.next() {
            Some(&case) => case,
            None if seconds <= begin.elapsed().as_secs() || 20 <= faults.len() => break,
            None => {
                fresh += 1;
                fresh - 1
            }
        };
        match run(case, &sources, &sound) {
            Ok(end) => *ends.entry(end).or_insert(0u64) += 1,
            Err(fault) => {
                println!("{fault}");
                faults.push(fault);
            }
        }
    }
    println!("cases {from}..{fresh} from {} files: {ends:?}", sources.len());
    assert!(0 < ends.values().sum::<u64>(), "nothing was tried");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
