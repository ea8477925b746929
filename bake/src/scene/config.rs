//! The words of `bake.toml`, `scene.extras` and `node.extras`.

use std::{fs, path::Path};

use glam::Vec3;
use serde_json::{Number, Value};

use super::{
    density::Files,
    document::InputFile,
    findings::Findings,
    media_words::{MEDIUM_PREFIX, has_medium, media},
    model::{BOUNDS, Light, LightKind, LightMode, LightmapMode, Medium, ProbeBox, Sky},
    probe_words::{probes, spacing},
    read::{Table, index_of, scalar},
    sky,
};
use crate::error::{Error, Finding};

/// A configuration file.
#[derive(Clone, Debug, Default)]
pub struct Config {
    /// `[run]`: options that the command line has too.
    pub run: RunConfig,
    /// Words about the scene as a whole.
    pub scene: SceneWords,
    /// `[nodes."name or path"]`, in file order.
    pub nodes: Vec<(String, NodeWords)>,
    /// The configuration file and the files it names.
    pub inputs: Vec<InputFile>,
}

/// Run options of a configuration file; the command line stands above them. Texts are checked
/// against the words that exist, numbers against their range.
#[derive(Clone, Debug, Default, PartialEq)]
#[expect(missing_docs, reason = "each field is the command line's option of the same name")]
pub struct RunConfig {
    pub quality: Option<String>,
    pub samples: Option<u32>,
    pub bounces: Option<u32>,
    pub target_error: Option<f32>,
    pub time_budget: Option<String>,
    pub texels_per_metre: Option<f32>,
    pub max_size: Option<u32>,
    pub unwrap: Option<String>,
    pub seams: Option<String>,
    pub media: Option<String>,
    pub direct: Option<String>,
    pub denoise: Option<String>,
    pub directional: Option<bool>,
    pub probes: Option<String>,
    pub probe_count: Option<u32>,
    pub probe_spacing: Option<f32>,
    pub probe_samples: Option<u32>,
    pub sky: Option<String>,
    pub light_units: Option<String>,
    pub audit: Option<u32>,
    pub strict: Option<bool>,
    pub force: Vec<String>,
    pub seed: Option<u64>,
    pub threads: Option<u32>,
    pub progress: Option<String>,
    pub output: Option<String>,
    pub texture: Option<String>,
}

/// Words about the scene as a whole.
#[derive(Clone, Debug, Default)]
pub struct SceneWords {
    /// `lamps`.
    pub lamps: Vec<Light>,
    /// `sky`; `Some(Sky::Black)` is a wish, `None` is not.
    pub sky: Option<Sky>,
    /// `texels_per_metre`.
    pub texels_per_metre: Option<f32>,
    /// `media`, in file order.
    pub media: Vec<Medium>,
    /// `probes`: boxes of light probes, which then find no places by themselves.
    pub probes: Option<Vec<ProbeBox>>,
    /// `metals_black`: albedo is base colour times (1 - metallic).
    pub metals_black: Option<bool>,
}

/// Words about one node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeWords {
    /// `lightmap`.
    pub lightmap: Option<LightmapMode>,
    /// `casts_shadow`.
    pub casts_shadow: Option<bool>,
    /// `texels_per_metre`.
    pub texels_per_metre: Option<f32>,
    /// `mode` of the node's light.
    pub mode: Option<LightMode>,
    /// `angular_diameter` of the node's directional light, radians (written in degrees).
    pub angular_diameter: Option<f32>,
    /// `probes`: the bounds of the node's mesh, which is no surface then, are filled with probes that far apart, metres.
    pub probes: Option<f32>,
}

impl NodeWords {
    /// These words, and those of `under` where these are silent.
    pub(crate) fn over(self, under: Self) -> Self {
        Self {
            lightmap: self.lightmap.or(under.lightmap),
            casts_shadow: self.casts_shadow.or(under.casts_shadow),
            texels_per_metre: self.texels_per_metre.or(under.texels_per_metre),
            mode: self.mode.or(under.mode),
            angular_diameter: self.angular_diameter.or(under.angular_diameter),
            probes: self.probes.or(under.probes),
        }
    }
}

impl Config {
    /// Reads a `bake.toml`. Files it names are relative to its folder.
    ///
    /// # Errors
    /// [`Error::Io`] where it cannot be read, [`Error::Input`] where it is not TOML. Wrong words
    /// and values are findings, errors among them.
    pub fn open(path: &Path, frame: Option<u32>) -> Result<(Self, Vec<Finding>), Error> {
        let bytes = fs::read(path).map_err(Error::io(path, "cannot read"))?;
        let name =
            path.file_name().map_or_else(|| "bake.toml".to_owned(), |n| n.to_string_lossy().into_owned());
        let text = std::str::from_utf8(&bytes)
            .map_err(|e| Finding::error(&name, format!("not UTF-8: {e}"), "save the file as UTF-8"))?;
        let (mut config, findings) = Self::parse(&name, text, path.parent(), frame)?;
        config.inputs.insert(0, InputFile::new(&name, &bytes));
        Ok((config, findings))
    }

    /// Reads the text of a configuration file; `name` is for messages.
    ///
    /// # Errors
    /// [`Error::Input`] where it is not TOML.
    pub fn parse(
        name: &str,
        text: &str,
        base_dir: Option<&Path>,
        frame: Option<u32>,
    ) -> Result<(Self, Vec<Finding>), Error> {
        let table: toml::Table = toml::from_str(text).map_err(|e| {
            let what = e.to_string().lines().collect::<Vec<_>>().join("\n    ");
            Finding::error(name, format!("not TOML: {what}"), "correct the syntax")
        })?;
        let value = json(toml::Value::Table(table));
        let mut out = Findings::default();
        let mut config = Self::default();
        if let Some(mut t) = Table::new(&value, "", &mut out) {
            config.scene = SceneWords::from_table(
                &mut t,
                &mut Files { dir: base_dir, inputs: &mut config.inputs, frame },
                &mut out,
            );
            if let Some(run) = t.get("run") {
                config.run = RunConfig::read(run, &mut out);
            }
            if let Some(nodes) = t.get("nodes") {
                match nodes.as_object() {
                    Some(map) => {
                        for (key, words) in map {
                            let words = NodeWords::read(words, &format!("nodes.\"{key}\""), false, &mut out);
                            config.nodes.push((key.clone(), words));
                        }
                    }
                    None => out.push(Finding::error(
                        "nodes",
                        "not a table",
                        "write [nodes.\"name\"] with words below",
                    )),
                }
            }
            t.finish(false, MEDIUM_PREFIX, &mut out);
        }
        Ok((config, out.finish()))
    }
}

/// TOML as JSON. Numbers that JSON lacks become text, which no reader of a number takes, so they are findings and not absent.
fn json(value: toml::Value) -> Value {
    match value {
        toml::Value::Float(f) => Number::from_f64(f).map_or_else(|| f.to_string().into(), Value::Number),
        toml::Value::Integer(i) => i.into(),
        toml::Value::Boolean(b) => b.into(),
        toml::Value::String(s) => s.into(),
        toml::Value::Datetime(d) => d.to_string().into(),
        toml::Value::Array(list) => list.into_iter().map(json).collect(),
        toml::Value::Table(table) => table.into_iter().map(|(k, v)| (k, json(v))).collect(),
    }
}

fn texels_per_metre(t: &mut Table<'_>, out: &mut Findings) -> Option<f32> {
    t.number("texels_per_metre", "a number above 0", out, |v| 0.0 < v)
}

impl SceneWords {
    fn from_table(t: &mut Table<'_>, files: &mut Files<'_>, out: &mut Findings) -> Self {
        let lamps = match t.get("lamps") {
            None => Vec::new(),
            Some(Value::Array(list)) => {
                let at = t.at("lamps");
                list.iter().enumerate().filter_map(|(i, v)| lamp(v, &format!("{at}[{i}]"), out)).collect()
            }
            Some(_) => {
                out.push(Finding::error(t.at("lamps"), "not a list", "write a list of lamps"));
                Vec::new()
            }
        };
        let sky = t.get("sky").and_then(|v| sky::word(v, &t.at("sky"), files.dir, files.inputs, out));
        Self {
            lamps,
            sky,
            texels_per_metre: texels_per_metre(t, out),
            metals_black: t.flag("metals_black", out),
            probes: probes(t, out),
            media: media(t, files, out),
        }
    }

    /// Reads `scene.extras`.
    pub(super) fn read(value: &Value, path: &str, files: &mut Files<'_>, out: &mut Findings) -> Self {
        // Extras may be anything; only objects hold words.
        if !value.is_object() {
            return Self::default();
        }
        let Some(mut t) = Table::new(value, path, out) else { return Self::default() };
        let words = Self::from_table(&mut t, files, out);
        t.finish(true, MEDIUM_PREFIX, out);
        words
    }
}

impl NodeWords {
    /// Reads `node.extras` (`foreign`) or a table of `bake.toml`.
    pub(crate) fn read(value: &Value, path: &str, foreign: bool, out: &mut Findings) -> Self {
        if foreign && !value.is_object() {
            return Self::default();
        }
        let Some(mut t) = Table::new(value, path, out) else { return Self::default() };
        let lightmap = t.read("lightmap", "on, off or probes", out, |v| match v {
            Value::Bool(true) => Some(Some(LightmapMode::On)),
            Value::Bool(false) => Some(Some(LightmapMode::Off)),
            // Places on the pages of an earlier bake, which are no wish.
            Value::Array(_) if foreign => Some(None),
            _ => match v.as_str()?.trim().to_ascii_lowercase().as_str() {
                "on" => Some(Some(LightmapMode::On)),
                "off" => Some(Some(LightmapMode::Off)),
                "probes" => Some(Some(LightmapMode::Probes)),
                _ => None,
            },
        });
        let words = Self {
            lightmap: lightmap.flatten(),
            casts_shadow: t.flag("casts_shadow", out),
            texels_per_metre: texels_per_metre(&mut t, out),
            mode: mode(&mut t, out),
            angular_diameter: angular_diameter(&mut t, out),
            probes: spacing(&mut t, out),
        };
        if let Some(at) = has_medium(&mut t).filter(|_| !foreign) {
            let what = "a medium in the place of a node is read from the node's extras alone; ignored";
            out.push(Finding::warning(at, what, "write `media` with a `box`, or set the extras"));
        }
        if foreign {
            // What an earlier bake wrote is known.
            t.get(BOUNDS);
        }
        t.finish(foreign, MEDIUM_PREFIX, out);
        words
    }
}

fn mode(t: &mut Table<'_>, out: &mut Findings) -> Option<LightMode> {
    Some(match t.word("mode", &["baked", "mixed", "dynamic"], out)? {
        "mixed" => LightMode::Mixed,
        "dynamic" => LightMode::Dynamic,
        _ => LightMode::Baked,
    })
}

fn angular_diameter(t: &mut Table<'_>, out: &mut Findings) -> Option<f32> {
    let ok = |v| (0.0..=180.0).contains(&v);
    t.number("angular_diameter", "a number of degrees from 0 to 180", out, ok).map(f32::to_radians)
}

/// Reads one entry of `lamps`.
fn lamp(value: &Value, path: &str, out: &mut Findings) -> Option<Light> {
    let mut t = Table::new(value, path, out)?;
    let name = t.text("name", out);
    let kind = t.word("type", &["point", "spot", "directional"], out);
    let position = t.vector("position", out);
    let direction = t.vector("direction", out);
    let intensity = t.colour("intensity", out);
    let illuminance = t.colour("illuminance", out);
    let colour = t.colour("color", out).or_else(|| t.colour("colour", out)).unwrap_or(Vec3::ONE);
    let range = t.number("range", "a number of metres above 0", out, |v| 0.0 < v);
    let cone = |v: f32| (0.0..=90.0).contains(&v);
    let inner = t.number("inner_cone", "a half angle of 0 to 90 degrees", out, cone).unwrap_or(0.0);
    let outer = t.number("outer_cone", "a half angle of 0 to 90 degrees", out, cone).unwrap_or(45.0);
    let angular_diameter = angular_diameter(&mut t, out);
    let mode = mode(&mut t, out).unwrap_or_default();
    let typed = t.get("type").is_some();
    t.finish(false, "", out);
    if typed && kind.is_none() {
        return None;
    }
    let kind = kind.unwrap_or("point");

    let mut needs = |what: String, fix: &str| out.push(Finding::error(path, what, fix));
    let strength = match (kind, intensity, illuminance) {
        ("directional", None, Some(v)) | ("point" | "spot", Some(v), None) => v,
        ("directional", ..) => {
            needs(
                "a directional lamp has `illuminance` in lux".to_owned(),
                "give illuminance, and no intensity",
            );
            return None;
        }
        _ => {
            needs(format!("a {kind} lamp has `intensity` in candela"), "give intensity, and no illuminance");
            return None;
        }
    } * colour;
    let unit = direction.and_then(|d| d.as_dvec3().try_normalize()).map(super::read::single);
    if direction.is_some() && unit.is_none() {
        needs("the direction has no length".to_owned(), "give a vector such as [0, -1, 0]");
        return None;
    }
    if kind != "directional" && position.is_none() {
        needs(format!("a {kind} lamp needs a `position`"), "add position = [x, y, z] in metres");
        return None;
    }
    if kind != "point" && unit.is_none() {
        needs(format!("a {kind} lamp needs a `direction`"), "add the direction its light travels along");
        return None;
    }
    if outer < inner {
        needs(
            format!("inner_cone {inner}° is wider than outer_cone {outer}°"),
            "make inner_cone the smaller one",
        );
        return None;
    }
    let position = position.unwrap_or_default();
    let direction = unit.unwrap_or(Vec3::NEG_Y);
    let kind = match kind {
        "directional" => LightKind::Directional {
            direction,
            illuminance: strength,
            angular_diameter: angular_diameter.unwrap_or(0.0),
        },
        "spot" => LightKind::Spot {
            position,
            direction,
            intensity: strength,
            range,
            inner_cone: inner.to_radians(),
            outer_cone: outer.to_radians(),
        },
        _ => LightKind::Point { position, intensity: strength, range },
    };
    Some(Light { path: name.unwrap_or_else(|| path.to_owned()), node: None, mode, kind })
}

impl RunConfig {
    fn read(value: &Value, out: &mut Findings) -> Self {
        let Some(mut t) = Table::new(value, "run", out) else { return Self::default() };
        let mut word = |key, list: &[&'static str]| t.word(key, list, out).map(str::to_owned);
        let quality = word("quality", &["draft", "medium", "high"]);
        let unwrap = word("unwrap", &["keep", "auto", "always"]);
        let seams = word("seams", &["on", "off"]);
        // The other words of `--media` come with the media themselves.
        let media = word("media", &["off"]);
        let direct = word("direct", &["auto", "all", "lightcuts", "grid", "published"]);
        let denoise = word("denoise", &["off", "draft", "final"]);
        let probes = word("probes", &["off", "l1", "l2", "l3", "zh3"]);
        let texture = word("texture", &["bc6h", "rgba16f", "none"]);
        let light_units = word("light_units", &["gltf", "blender-raw", "blender-unitless"]);
        let progress = word("progress", &["auto", "plain", "json", "none"]);
        let mut integer = |key, least: u64, most: u64| {
            let expected = format!("a whole number from {least} to {most}");
            t.read(key, &expected, out, |v| {
                let n = v.as_u64().or_else(|| index_of(v).map(|n| n as u64))?;
                (least..=most).contains(&n).then_some(n)
            })
        };
        let small = |n: Option<u64>| n.and_then(|n| u32::try_from(n).ok());
        let samples = small(integer("samples", 1, 1 << 24));
        let bounces = small(integer("bounces", 0, u64::from(u32::MAX)));
        let max_size = small(integer("max_size", 16, 16384));
        let audit = small(integer("audit", 0, 1 << 24));
        let threads = small(integer("threads", 1, 4096));
        let probe_count = small(integer("probe_count", 8, 1 << 22));
        let probe_samples = small(integer("probe_samples", 16, 1 << 20));
        let seed = integer("seed", 0, u64::MAX);
        let run = Self {
            quality,
            samples,
            bounces,
            target_error: t.number("target_error", "a fraction above 0", out, |v| 0.0 < v),
            time_budget: t.text("time_budget", out),
            texels_per_metre: texels_per_metre(&mut t, out),
            max_size,
            unwrap,
            seams,
            media,
            direct,
            denoise,
            directional: t.flag("directional", out),
            probes,
            probe_count,
            probe_spacing: t.number("probe_spacing", "a number of metres above 0", out, |v| 0.0 < v),
            probe_samples,
            // A number is a grey sky, and a list is a colour.
            sky: t.read("sky", "a colour or a file name", out, |v| match v {
                Value::String(s) => Some(s.clone()),
                Value::Array(_) => super::read::triple(v).map(|c| format!("{},{},{}", c.x, c.y, c.z)),
                _ => scalar(v).map(|f| f.to_string()),
            }),
            light_units,
            audit,
            strict: t.flag("strict", out),
            force: t
                .read("force", "EFFECT=KERNEL, or a list of them", out, |v| match v {
                    Value::String(s) => Some(vec![s.clone()]),
                    _ => v.as_array()?.iter().map(|e| e.as_str().map(str::to_owned)).collect(),
                })
                .unwrap_or_default(),
            seed,
            threads,
            progress,
            output: t.text("output", out),
            texture,
        };
        t.finish(false, "", out);
        run
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Severity;
    use crate::scene::model::Region;

    fn parse(text: &str) -> (Config, Vec<Finding>) {
        Config::parse("bake.toml", text, None, None).expect("TOML")
    }

    #[test]
    fn everything_is_read() {
        let (config, findings) = parse(
            r#"
            texels_per_metre = 16
            metals_black = true
            sky = { zenith = [0, 0, 1], horizon = 0.5, ground = "0.1,0.1,0.1" }
            [[lamps]]
            name = "bulb"
            position = [0, 2, 0]
            intensity = 100
            color = [1, 0.5, 0.25]
            range = 10
            mode = "mixed"
            [[lamps]]
            type = "spot"
            position = [0, 2, 0]
            direction = [0, -2, 0]
            intensity = [1, 2, 3]
            inner_cone = 10
            outer_cone = 20
            [[lamps]]
            type = "directional"
            direction = [0, -1, 0]
            illuminance = 1e5
            angular_diameter = 0.53
            [nodes."hall/column"]
            lightmap = "probes"
            casts_shadow = false
            texels_per_metre = 4
            [run]
            quality = "draft"
            samples = 64
            seed = 7
            sky = 1
            light_units = "blender-raw"
            "#,
        );
        assert_eq!(findings, []);
        assert_eq!(config.scene.texels_per_metre, Some(16.0));
        assert_eq!(config.scene.metals_black, Some(true));
        assert!(matches!(config.scene.sky, Some(Sky::Gradient { zenith: Vec3::Z, .. })));
        let kinds: Vec<_> = config.scene.lamps.iter().map(|l| l.kind).collect();
        let bulb = LightKind::Point {
            position: Vec3::new(0.0, 2.0, 0.0),
            intensity: Vec3::new(100.0, 50.0, 25.0),
            range: Some(10.0),
        };
        assert_eq!(kinds[0], bulb);
        assert_eq!(config.scene.lamps[0].mode, LightMode::Mixed);
        assert!(
            matches!(kinds[1], LightKind::Spot { direction: Vec3::NEG_Y, inner_cone, .. } if (inner_cone - 0.17453).abs() < 1e-4)
        );
        assert!(
            matches!(kinds[2], LightKind::Directional { illuminance, .. } if illuminance == Vec3::splat(1e5))
        );
        let words = NodeWords {
            lightmap: Some(LightmapMode::Probes),
            casts_shadow: Some(false),
            texels_per_metre: Some(4.0),
            ..NodeWords::default()
        };
        assert_eq!(config.nodes, [("hall/column".to_owned(), words)]);
        assert_eq!((config.run.samples, config.run.seed), (Some(64), Some(7)));
        assert_eq!(config.run.sky.as_deref(), Some("1"));
    }

    #[test]
    fn each_mistake_is_an_error_with_its_place() {
        for (text, place) in [
            ("texels_per_metre = 0", "texels_per_metre"),
            ("texels_per_metre = \"many\"", "texels_per_metre"),
            ("sky = [1, 2]", "sky"),
            ("sky = { zenith = 1 }", "sky"),
            ("sky = \"nowhere.hdr\"", "sky"),
            ("lamps = 3", "lamps"),
            ("lamps = [{ intensity = 1 }]", "lamps[0]"),
            ("lamps = [{ position = [0,0,0] }]", "lamps[0]"),
            ("lamps = [{ type = \"sun\" }]", "lamps[0].type"),
            ("lamps = [{ type = \"spot\", position = [0,0,0], intensity = 1 }]", "lamps[0]"),
            ("lamps = [{ position = [0,0,0], intensity = -1 }]", "lamps[0].intensity"),
            ("lamps = [{ type = \"directional\", direction = [0,0,0], illuminance = 1 }]", "lamps[0]"),
            ("[nodes.a]\nlightmap = \"maybe\"", "nodes.\"a\".lightmap"),
            ("nodes = 1", "nodes"),
            ("[run]\nquality = \"best\"", "run.quality"),
            ("[run]\nsamples = 0", "run.samples"),
            ("[run]\nsamples = 1.5", "run.samples"),
            ("run = 1", "run"),
        ] {
            let (_, findings) = parse(text);
            let errors: Vec<_> = findings.iter().filter(|f| f.severity == Severity::Error).collect();
            assert!(!errors.is_empty(), "{text}");
            assert_eq!(errors[0].path, place, "{text}");
        }
        assert!(Config::parse("bake.toml", "= 1", None, None).is_err());
    }

    #[test]
    fn unknown_words_and_media_of_nodes_are_warnings() {
        let (_, findings) = parse("texel_per_metre = 3\n[run]\nsample = 3\n[nodes.a]\nmedium_sigma_s = 1");
        let text: Vec<String> = findings.iter().map(ToString::to_string).collect();
        assert_eq!(findings.len(), 3, "{text:?}");
        assert!(findings.iter().all(|f| f.severity == Severity::Warning));
        assert!(text.iter().any(|t| t.contains("`texels_per_metre`")));
        assert!(text.iter().any(|t| t.contains("`samples`")));
        assert!(text.iter().any(|t| t.contains("medium_sigma_s")));
    }

    #[test]
    fn media_are_read_in_both_spellings() {
        let (config, findings) = parse(
            r#"
            medium_sigma_s = 0.5
            medium_g = -0.25
            [[media]]
            name = "mist"
            sigma_s = [0.1, 0.2, 0.3]
            sigma_a = 0.01
            density = 2
            box = { min = [0, 0, 0], max = [1, 2, 3] }
            "#,
        );
        assert!(findings.is_empty(), "{findings:?}");
        let [mist, flat] = &config.scene.media[..] else { panic!("{:?}", config.scene.media) };
        assert_eq!(mist.path, "mist");
        assert_eq!(mist.sigma_s, Vec3::new(0.2, 0.4, 0.6));
        assert_eq!(mist.sigma_a, Vec3::splat(0.02));
        assert_eq!(mist.region, Region::Box { min: Vec3::ZERO, max: Vec3::new(1.0, 2.0, 3.0) });
        assert_eq!(
            (flat.sigma_s, flat.g, flat.region.clone()),
            (Vec3::splat(0.5), -0.25, Region::Everywhere)
        );
    }

    #[test]
    fn what_is_wrong_with_a_medium_has_its_place() {
        for (text, place) in [
            ("media = 1", "media"),
            ("media = [{ g = 0.5 }]", "media[0]"),
            ("media = [{ sigma_s = -1 }]", "media[0].sigma_s"),
            ("media = [{ sigma_s = 1, g = 1 }]", "media[0].g"),
            ("media = [{ sigma_s = 1, g = nan }]", "media[0].g"),
            ("media = [{ sigma_s = inf }]", "media[0].sigma_s"),
            ("media = [{ sigma_a = 1, density = -2 }]", "media[0].density"),
            ("media = [{ sigma_a = 1, density = { vdb = \"nowhere.vdb\" } }]", "media[0].density.vdb"),
            ("media = [{ sigma_a = 1, density = { vbd = \"smoke.vdb\" } }]", "media[0].density"),
            ("media = [{ sigma_a = 1, density = { noise = { scale = 2 } } }]", "media[0].density"),
            ("media = [{ sigma_a = 1, density = { noise = { octaves = 99 } } }]", "media[0].density.noise"),
            (
                "media = [{ sigma_a = 1, density = { stencil = { size = [2, 1, 1], values = [1] } } }]",
                "media[0].density.stencil",
            ),
            (
                "media = [{ sigma_a = 1, density = { stencil = { size = [1, 1, 1], values = [1] } } }]",
                "media[0].density",
            ),
            (
                "media = [{ sigma_a = 1, density = { height = { base = 1 } } }]",
                "media[0].density.height.falloff",
            ),
            (
                "media = [{ sigma_a = 1, density = { height = { falloff = 0 } } }]",
                "media[0].density.height.falloff",
            ),
            ("media = [{ sigma_a = 1, box = 3 }]", "media[0].box"),
            ("media = [{ sigma_a = 1, box = { min = [0, 0, 0], max = [1, 0, 1] } }]", "media[0].box"),
        ] {
            let (config, findings) = parse(text);
            let error = findings.iter().find(|f| f.severity == Severity::Error);
            assert_eq!(error.map(|f| f.path.as_str()), Some(place), "{text}: {findings:?}");
            assert!(config.scene.media.len() <= 1);
        }
    }
}
