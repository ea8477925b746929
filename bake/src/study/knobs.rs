//! What trades accuracy for time, and the settings that are tried of it.

use crate::light::Selection;
use crate::light::fires::FireOptions;
use crate::light::many::{SEVERAL, THRESHOLD};
use crate::media::Media;
use crate::plan::settings::{Denoise, MediaMode};
use crate::plan::{Plan, Quality};

/// How the error of a knob's settings is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// By the texels of a lightmap of the study's density.
    Texels,
    /// The same, against the last of the settings instead of the truth.
    AgainstFinest,
    /// By bilinear fetches from lightmaps of other densities, at points on surfaces.
    Fetches,
    /// By look-ups of irradiance from light probes, at points in the air.
    Probes,
}

impl Measure {
    /// What errors are of, in a sentence.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Texels => "Errors of texels against unbiased paths.",
            Self::AgainstFinest => {
                "Errors of texels against the last setting with 512 paths, not against the truth."
            }
            Self::Fetches => {
                "Errors of bilinear fetches at points on surfaces against unbiased paths from there."
            }
            Self::Probes => {
                "Errors of irradiance on planes of any direction at points in the air, against unbiased paths from there, as parts of the sum of the place's own light and the mean; seconds of probes alone."
            }
        }
    }

    /// The same as a word.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Texels => "texels",
            Self::AgainstFinest => "texels against the finest setting",
            Self::Fetches => "fetches at points",
            Self::Probes => "probes at points",
        }
    }
}

/// One way to set a knob.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    /// What it is called.
    pub label: String,
    /// Options of `bake run`, beside those of the base.
    pub args: Vec<String>,
    /// Whether the base has it anyway.
    pub usual: bool,
}

/// Something that trades accuracy for time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Knob {
    /// Its name.
    pub name: &'static str,
    /// The option that turns it.
    pub option: &'static str,
    /// What it is, in a sentence's beginning.
    pub about: &'static str,
    /// How its error is measured.
    pub measure: Measure,
    /// What the knob is turned on: its name and options of `bake run`.
    pub base: (String, Vec<String>),
    /// The settings, from coarse to fine where there is an order.
    pub settings: Vec<Setting>,
    /// Why there is nothing to turn on this scene.
    pub idle: Option<String>,
}

/// Options that leave everything out that a knob does not change. Seams are not stitched: what that changes would count as error, most of all where charts have
/// few texels.
#[must_use]
pub fn plain(quality: Quality) -> Vec<String> {
    words(&["--quality", quality.name(), "--probes", "off", "--seams", "off"])
}

fn words(list: &[&str]) -> Vec<String> {
    list.iter().map(|w| (*w).to_owned()).collect()
}

fn setting(label: impl ToString, args: &[&str], usual: bool) -> Setting {
    Setting { label: label.to_string(), args: words(args), usual }
}

/// Settings of an option that takes numbers.
fn numbers(option: &str, list: &[u32], usual: u32) -> Vec<Setting> {
    list.iter().map(|n| setting(n, &[option, &n.to_string()], *n == usual)).collect()
}

/// Settings of an option that takes words.
fn choices(option: &str, list: &[&str], usual: &str) -> Vec<Setting> {
    list.iter().map(|w| setting(w, &[option, w], *w == usual)).collect()
}

/// Paths per texel as presets spread them: a half evenly, then where the variance is.
#[must_use]
pub fn rounds(paths: u32) -> String {
    let n = f64::from(paths);
    format!("{},{},{paths}", 0.5 * n, 0.75 * n)
}

/// Whether bakes with these options, in pairs, are denoised.
#[must_use]
pub fn is_denoised(args: &[String]) -> bool {
    let value = |of: &str| args.chunks(2).rfind(|p| p[0] == of).map(|p| p[1].as_str());
    match value("--denoise") {
        Some(word) => word != Denoise::Off.name(),
        None => value("--samples").or(value("--rounds")).is_none(),
    }
}

/// Numbers from `from` to `to`, each `factor` times the one before.
fn series(from: u32, to: u32, factor: u32) -> Vec<u32> {
    std::iter::successors(Some(from), |n| n.checked_mul(factor)).take_while(|n| *n <= to).collect()
}

/// Everything that can be turned on a scene. `plan` is a plan of it at medium quality.
#[must_use]
pub fn all(plan: &Plan) -> Vec<Knob> {
    let scatters = plan.tracing().media.as_ref().is_some_and(Media::scatters);
    let medium = (Quality::Medium.name().to_owned(), plain(Quality::Medium));
    // How many samples are worth their time is seen before a denoiser takes their noise away.
    let raw = {
        let args = [plain(Quality::Medium), words(&["--denoise", Denoise::Off.name()])].concat();
        ("medium, not denoised".to_owned(), args)
    };
    let on = |quality: Quality| (quality.name().to_owned(), plain(quality));
    let knob = |name, option, about, settings| Knob {
        name,
        option,
        about,
        measure: Measure::Texels,
        base: medium.clone(),
        settings,
        idle: None,
    };
    let without_media = || (!scatters).then(|| "no medium of the scene scatters".to_owned());
    let mut knobs = vec![
        Knob {
            base: raw.clone(),
            settings: samples(&series(8, 1024, 2), 64),
            ..knob(
                "samples",
                "--rounds",
                "Paths per texel, half of them spread evenly, as presets do",
                Vec::new(),
            )
        },
        Knob {
            base: raw.clone(),
            ..knob(
                "adaptive sampling",
                "--samples",
                "The same number of paths in every texel, instead of more where the variance is",
                vec![
                    setting("even", &["--samples", "64"], false),
                    setting("where the variance is", &[], true),
                ],
            )
        },
        knob("bounces", "--bounces", "Reflections until a path ends", {
            let mut list = numbers("--bounces", &[0, 1, 2, 4, 8, 16], u32::MAX);
            list.push(setting("unlimited, without cache", &["--irradiance-cache", "off"], false));
            list.push(setting("unlimited", &[], true));
            list
        }),
        knob(
            "irradiance cache",
            "--irradiance-cache",
            "Paths that end at irradiance gathered beforehand",
            choices("--irradiance-cache", &["off", "on"], "on"),
        ),
        Knob {
            idle: without_media(),
            ..knob(
                "media rung",
                "--media",
                "What becomes of media",
                choices("--media", &["off", "attenuate", "table", "bounded", "reference"], "bounded"),
            )
        },
    ];
    for quality in Quality::ALL {
        let fine = quality.light_grid();
        let name = |text: &'static str| text;
        knobs.push(Knob {
            base: on(quality),
            idle: without_media(),
            ..knob(
                name("volume resolution"),
                "--grid-nodes",
                "Nodes of the light grid",
                numbers("--grid-nodes", &nearby(fine.nodes, quality, 8), fine.nodes),
            )
        });
        knobs.push(Knob {
            base: on(quality),
            idle: without_media(),
            ..knob(
                name("volume paths"),
                "--grid-paths",
                "Paths from each node of the light grid",
                numbers("--grid-paths", &nearby(fine.paths, quality, 4), fine.paths),
            )
        });
        knobs.push(Knob {
            base: on(quality),
            ..knob(
                name("denoising"),
                "--denoise",
                "What is taken out of the noise afterwards",
                choices("--denoise", &["off", "draft", "final"], quality.denoise().name()),
            )
        });
    }
    knobs.push(Knob {
        idle: without_media(),
        ..knob("scattering orders", "--grid-orders", "Times that light is scattered from node to node", {
            let mut list = numbers("--grid-orders", &[0, 1, 2, 4, 8, 16], u32::MAX);
            list.push(setting("all that count", &[], true));
            list
        })
    });
    knobs.extend(of_tables(plan, &medium));
    knobs.extend(of_lights(plan, &raw));
    knobs.push(Knob {
        measure: Measure::Fetches,
        ..knob(
            "texel density",
            "--texels-per-metre",
            "Texels per metre, by bilinear fetches at points on surfaces",
            densities(plan),
        )
    });
    let boxes = plan.scene().probe_boxes.is_some();
    let placed = || boxes.then(|| "the scene says where its probes are".to_owned());
    let probes = |args: &[&str]| {
        ("medium".to_owned(), words(&[&["--quality", "medium", "--samples", "8"], args].concat()))
    };
    knobs.push(Knob {
        measure: Measure::Probes,
        base: probes(&[]),
        idle: placed(),
        ..knob(
            "probe order",
            "--probes",
            "What each light probe keeps, by irradiance at points in the air",
            choices("--probes", &["l1", "zh3", "l2", "l3"], "l2"),
        )
    });
    knobs.push(Knob {
        measure: Measure::Probes,
        base: probes(&[]),
        idle: placed(),
        ..knob(
            "probes",
            "--probe-count",
            "Number of light probes",
            numbers("--probe-count", &[256, 1024, 4096, 16384], Quality::Medium.probes().0),
        )
    });
    knobs
}

fn samples(list: &[u32], usual: u32) -> Vec<Setting> {
    list.iter().map(|&n| setting(n, &["--rounds", &rounds(n)], n == usual)).collect()
}

/// A preset's own number with some below and above; more of them around the medium one.
fn nearby(usual: u32, quality: Quality, factor: u32) -> Vec<u32> {
    let all: &[f64] = if quality == Quality::Medium {
        &[1.0 / 64.0, 0.125, 0.5, 1.0, 2.0, 8.0]
    } else {
        &[0.25, 0.5, 1.0, 2.0]
    };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small numbers")]
    let number = |part: &f64| (f64::from(usual) * part) as u32;
    let mut list: Vec<u32> = all.iter().map(number).map(|n| n.max(factor)).collect();
    list.dedup();
    list
}

/// Half the study's density, and so on.
fn densities(plan: &Plan) -> Vec<Setting> {
    let own = plan.atlas().texels_per_metre;
    [0.125f32, 0.25, 0.5, 1.0, 2.0]
        .iter()
        .map(|part| {
            let density = own * part;
            setting(format!("{density:.3}"), &["--texels-per-metre", &density.to_string()], *part == 1.0)
        })
        .collect()
}

/// Tables of impulse responses, whose errors are those against the finest ones: against the truth `table` is wrong between walls for other
/// reasons, which the media rung shows.
fn of_tables(plan: &Plan, medium: &(String, Vec<String>)) -> Vec<Knob> {
    let media = plan.tracing().media.as_ref();
    let scatters = media.is_some_and(Media::scatters);
    let turns = media.is_some_and(|m| m.most_forward() != 0.0);
    let mut base = medium.clone();
    base.0 = "table".to_owned();
    base.1.extend(words(&["--media", MediaMode::Table.name()]));
    let idle = (!scatters).then(|| "nothing scatters in the scene".to_owned());
    let knob = |name, option, about, settings| Knob {
        name,
        option,
        about,
        measure: Measure::AgainstFinest,
        base: base.clone(),
        settings,
        idle: idle.clone(),
    };
    let tables = |label: &str, usual| Setting {
        label: label.to_owned(),
        args: if usual { Vec::new() } else { words(&["--tables", label]) },
        usual,
    };
    vec![
        knob(
            "ZH order",
            "--zh-order",
            "Bands of zonal harmonics that responses are cut to",
            numbers("--zh-order", &[1, 2, 3, 4, 6, 8, 11], 11),
        ),
        knob(
            "table resolution",
            "--tables",
            "Nodes of the tables over distance, angle, albedo and g",
            vec![tables("quarter", false), tables("half", false), tables("default", true)],
        ),
        Knob {
            idle: idle
                .clone()
                .or_else(|| (!turns).then(|| "g is 0 in every medium, and both have that column".to_owned())),
            ..knob(
                "g axis",
                "--tables",
                "g in the three columns of [IR19], -0.5, 0 and 0.5, against the whole axis",
                vec![tables("columns", false), tables("default", true)],
            )
        },
    ]
}

/// How many lights are asked, and how.
fn of_lights(plan: &Plan, medium: &(String, Vec<String>)) -> Vec<Knob> {
    let lights = &plan.tracing().lights;
    let many = [(lights.lamps_by, lights.punctual.len()), (lights.emitters_by, lights.emitters.len())];
    let tree = many.iter().any(|(by, n)| *by == Selection::Tree && 0 < *n);
    let idle = (!tree)
        .then(|| format!("{} lamps and {} emissive triangles are too few for a tree", many[0].1, many[1].1));
    let knob = |name, option, about, settings| Knob {
        name,
        option,
        about,
        measure: Measure::Texels,
        base: medium.clone(),
        settings,
        idle: idle.clone(),
    };
    vec![
        knob(
            "light samples",
            "--light-samples",
            "Lights that a texel asks of many at once",
            numbers("--light-samples", &[1, 2, 4, 8, 16], SEVERAL),
        ),
        knob(
            "light threshold",
            "--light-threshold",
            "Size over distance, squared, beyond which a node of lights is opened",
            [4.0f32, 2.0, 1.0, 0.5, 0.25, 0.125]
                .iter()
                .map(|x| setting(x, &["--light-threshold", &x.to_string()], *x == THRESHOLD))
                .collect(),
        ),
        Knob {
            idle: idle.clone(),
            ..knob(
                "light choice",
                "--direct",
                "How lamps and emissive triangles are chosen",
                choices("--direct", &["published", "lightcuts", "auto"], "auto"),
            )
        },
        Knob {
            base: {
                let (name, args) = medium.clone();
                (format!("{name}, fire by a grid"), [args, words(&["--fire", "grid"])].concat())
            },
            idle: (!plan.tracing().media.as_ref().is_some_and(Media::emits))
                .then(|| "no medium of the scene emits".to_owned()),
            ..knob(
                "grid hierarchy alpha",
                "--fire-alpha",
                "Radius of influence of the levels of fire's lighting grid hierarchy, over their spacing",
                [1.0f32, 2.0, 4.0, 8.0]
                    .iter()
                    .map(|x| {
                        setting(x, &["--fire-alpha", &x.to_string()], *x == FireOptions::default().alpha)
                    })
                    .collect(),
            )
        },
    ]
}
