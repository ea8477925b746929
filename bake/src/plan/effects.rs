//! What a scene contains, and what runs because of it.

use crate::light::hierarchy::GridLights;
use crate::light::many::EVERY_LAMP;
use crate::light::{Direct, Selection};
use crate::plan::Tracing;
use crate::plan::kernels::{Choice, Effect};
use crate::plan::settings::{Denoise, MediaMode, Settings};
use crate::scene::model::{AlphaMode, LightMode, LightmapMode, Rgb, Scene};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// One effect that the baker knows, and what was decided about it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Decision {
    /// Name.
    pub name: &'static str,
    /// Its name in `--force`; `None` where nothing but a branch depends on it.
    pub effect: Option<&'static str>,
    /// Whether something runs for it.
    pub runs: bool,
    /// What the scene has of it, and what follows.
    pub why: String,
    /// Name of the kernel that runs.
    pub kernel: &'static str,
    /// All its kernels, from the smallest to the general one.
    pub kernels: &'static [&'static str],
    /// The kernel was asked for by name.
    pub forced: bool,
    /// Why it runs, what would change that, and what undoes it.
    pub explanation: String,
    /// What not running the general kernel saves of the instructions of a bake, measured on a small scene without the effect; `None` where the general
    /// kernel runs or nothing was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub saves: Option<Saving>,
}

/// A row of the table that `tests/tests/effects.rs` measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Saving {
    /// Instructions of a bake with the small kernel.
    pub chosen: u64,
    /// With the general one.
    pub general: u64,
}

impl Saving {
    /// The part of the instructions that is saved, in %.
    #[must_use]
    pub fn percent(&self) -> f64 {
        100.0 * (1.0 - self.chosen as f64 / self.general as f64)
    }
}

/// What a kernel saves against the general one, if that was measured.
#[must_use]
pub fn saving(effect: Effect, kernel: usize) -> Option<Saving> {
    static TABLE: LazyLock<BTreeMap<String, Saving>> =
        LazyLock::new(|| serde_json::from_str(include_str!("savings.json")).unwrap_or_default());
    TABLE.get(&format!("{}={}", effect.word(), effect.kernels()[kernel])).copied()
}

/// What settings and not the scene decide: the number of the smallest kernel that does, and why.
fn stage(effect: Effect, settings: &Settings) -> (usize, String) {
    let asked = |on: bool| if on { "settings ask for it" } else { "settings do not ask for it" };
    let (kernel, because) = match effect {
        Effect::Lightmaps => {
            (usize::from(settings.directional.is_some()), asked(settings.directional.is_some()))
        }
        Effect::Cache if settings.irradiance_cache && !settings.caches() => {
            (0, "a limit of reflections or media as `reference` follows them rules it out")
        }
        Effect::Cache => (usize::from(settings.caches()), asked(settings.caches())),
        Effect::Probes => (usize::from(settings.probes.is_some()), asked(settings.probes.is_some())),
        Effect::Denoise => {
            let k = match settings.denoise {
                Denoise::Off => 0,
                Denoise::Draft => 1,
                Denoise::Final => 2,
            };
            (k, asked(0 < k))
        }
        _ => (usize::from(settings.seams), asked(settings.seams)),
    };
    (kernel, because.to_owned())
}

/// Rows without kernels: whether something runs says it all.
const PLAIN: &[&str] = &["none", "there"];

/// All effects, those that run and those that do not.
#[must_use]
pub fn list(scene: &Scene, tracing: &Tracing, settings: &Settings) -> Vec<Decision> {
    let lights = &tracing.lights;
    let used = |f: &dyn Fn(&crate::scene::model::Material) -> bool| {
        scene.surfaces.iter().filter(|s| f(&scene.materials[s.material])).count()
    };
    let dynamic = scene.lights.iter().filter(|l| l.mode == LightMode::Dynamic).count();
    let mixed = scene.lights.iter().filter(|l| l.mode == LightMode::Mixed).count();
    let emitters = lights.emitters.len();
    let glowing = scene.media.iter().filter(|m| m.emission != Rgb::ZERO).count();
    let off = scene.surfaces.iter().filter(|s| s.lightmap != LightmapMode::On).count();
    let masked = used(&|m| matches!(m.alpha_mode, AlphaMode::Mask(_)));
    let see_through = used(&|m| m.alpha_mode == AlphaMode::Blend || 0.0 < m.transmission);
    let unlit = used(&|m| m.unlit);
    let count = |n: usize, what: &str| match n {
        0 => format!("no {what}"),
        1 => format!("1 {what}"),
        n => format!("{n} {what}s"),
    };
    let plain = |name, runs: bool, why: String| Decision {
        name,
        effect: None,
        runs,
        explanation: format!("{}.", why.trim_end_matches('.')),
        why,
        kernel: PLAIN[usize::from(runs)],
        kernels: PLAIN,
        forced: false,
        saves: None,
    };
    let effect = |effect: Effect, name, runs, why| {
        let stage = || Choice::new(effect, stage(effect, settings), &settings.force);
        let choice =
            tracing.kernels.list().iter().find(|c| c.effect == effect).cloned().unwrap_or_else(stage);
        Decision {
            name,
            effect: Some(effect.word()),
            runs,
            why,
            kernel: choice.word(),
            kernels: effect.kernels(),
            forced: choice.forced,
            explanation: choice.explain(),
            saves: saving(effect, choice.kernel),
        }
    };
    // What of the kernels that the scene decides has no more to say than what decided.
    let told = |effect_, name| {
        let choice = tracing.kernels.list().iter().find(|c| c.effect == effect_);
        let (needed, because) = choice.map_or((0, String::new()), |c| (c.needed, c.because.clone()));
        effect(effect_, name, 0 < needed, because)
    };
    let from_tree = match settings.direct {
        Direct::Auto | Direct::Grid => ": many, chosen from a tree (stochastic lightcuts)",
        Direct::Lightcuts => ", chosen from a tree (stochastic lightcuts)",
        _ => ", chosen as --direct says, to compare with",
    };
    let by_grid = lights.lamp_grid.as_ref().map_or_else(String::new, |grid| {
        let levels = grid.hierarchy().levels();
        let n = levels[0].lights.len();
        format!("; texels ask {n} of them at once, in a lighting grid hierarchy of {} levels", levels.len())
    });
    vec![
        effect(
            Effect::Lamps,
            "point and spot lights",
            !lights.punctual.is_empty(),
            count(lights.punctual.len(), "light")
                + match (lights.punctual.len(), lights.lamps_by) {
                    (_, Selection::All) => ", a ray to each from every surface",
                    (0..=EVERY_LAMP, Selection::Weighed) => {
                        ": few, all sampled at every texel, one where paths turn"
                    }
                    (_, Selection::Weighed) => ": few, each weighed by what it brings unshadowed, one chosen",
                    (_, Selection::Tree) => from_tree,
                }
                + &by_grid,
        ),
        effect(Effect::Suns, "suns", !lights.suns.is_empty(), count(lights.suns.len(), "directional light")),
        effect(
            Effect::Emission,
            "emissive surfaces",
            0 < emitters,
            count(emitters, "emissive triangle")
                + match lights.emitters_by {
                    Selection::All => ", a ray to each from every surface; found by chance as well",
                    Selection::Weighed => ": few, each weighed, one chosen; found by chance as well",
                    Selection::Tree => from_tree,
                },
        ),
        effect(
            Effect::Sky,
            "sky",
            !lights.sky.is_black(),
            if lights.sky.is_sampled() {
                "an image, sampled by luminance".to_owned()
            } else if lights.sky.is_black() {
                "black".to_owned()
            } else {
                "smooth, found by the directions that surfaces sample".to_owned()
            },
        ),
        plain("alpha masks", 0 < masked, count(masked, "surface") + " tested at every hit"),
        plain(
            "blending and transmission",
            0 < see_through,
            count(see_through, "surface") + " letting light straight through",
        ),
        plain("unlit surfaces", 0 < unlit, count(unlit, "surface") + " without texels"),
        plain("surfaces without lightmap", 0 < off, count(off, "surface") + " lit at run time"),
        plain("mixed lights", 0 < mixed, count(mixed, "light") + " of which only indirect light is baked"),
        plain("dynamic lights", false, count(dynamic, "light") + " left to the game"),
        effect(
            Effect::Cache,
            "irradiance cache",
            settings.caches(),
            match (settings.irradiance_cache, settings.bounces) {
                (true, None) => "paths end at irradiance gathered beforehand".to_owned(),
                (true, Some(n)) => format!("ruled out by the limit of {n} reflections"),
                (false, _) => "switched off: paths go on to their last reflection".to_owned(),
            },
        ),
        effect(
            Effect::Lightmaps,
            "directional lightmaps",
            settings.directional.is_some(),
            match settings.directional {
                Some(n) => format!("{n} paths per texel for the direction of light"),
                None => "not asked for (--directional)".to_owned(),
            },
        ),
        effect(
            Effect::Probes,
            "light probes",
            settings.probes.is_some(),
            match (settings.probes, &scene.probe_boxes) {
                (None, _) => "switched off".to_owned(),
                (Some(p), Some(boxes)) => {
                    let name = p.basis.name();
                    format!(
                        "{} of {name} probes",
                        if boxes.len() == 1 { "1 box".into() } else { format!("{} boxes", boxes.len()) }
                    )
                }
                (Some(p), None) => match p.spacing {
                    Some(s) => format!("{}, {s} m apart where surfaces are", p.basis.name()),
                    None => format!("{}, up to {}, denser where surfaces are", p.basis.name(), p.about),
                },
            },
        ),
        effect(
            Effect::Media,
            "media",
            !scene.media.is_empty() && settings.media != MediaMode::Off,
            match (scene.media.len(), settings.media) {
                (0, _) => "no medium".to_owned(),
                (1, MediaMode::Off) => {
                    "1 medium, ignored: --media bounded, attenuate, table or reference simulates it"
                        .to_owned()
                }
                (n, MediaMode::Off) => {
                    format!(
                        "{n} media, ignored: --media bounded, attenuate, table or reference simulates them"
                    )
                }
                (n, MediaMode::Attenuate) => format!("{n}, weakening light"),
                (n, MediaMode::Table) => {
                    format!("{n}, weakening light and scattering it as if without bounds")
                }
                (n, MediaMode::Bounded) => {
                    format!(
                        "{n}, weakening light and scattering it: a grid of light, walls and shadows included"
                    )
                }
                (n, MediaMode::Reference) => format!("{n}, scattering paths"),
            },
        ),
        plain(
            "emission of media",
            0 < glowing && settings.media != MediaMode::Off,
            match (glowing, settings.media) {
                (0, _) => "no medium emits".to_owned(),
                (n, MediaMode::Off) => format!("{n} of the media emit, ignored as they are"),
                (n, MediaMode::Table) => {
                    format!("{n} of the media emit; what media scatter of that is not simulated by `table`")
                }
                (n, _) => match &tracing.fires {
                    Some(fires) => {
                        let lights = fires.hierarchy().levels().iter().map(|l| l.lights.len().to_string());
                        let lights = lights.collect::<Vec<_>>().join(", ");
                        format!("{n} of the media emit: a hierarchy of {lights} lights")
                    }
                    None => format!("{n} of the media emit: found by directions and by places chosen for it"),
                },
            },
        ),
        told(Effect::MediaColour, "colour of media"),
        told(Effect::MediaAlbedo, "albedo of media"),
        told(Effect::Absorption, "absorption"),
        told(Effect::Phase, "phase function"),
        told(Effect::Density, "density of media"),
        told(Effect::Opacity, "opacity"),
        told(Effect::Textures, "textures"),
        told(Effect::Traversal, "plain loops for rays"),
        effect(
            Effect::Denoise,
            "denoising",
            settings.denoise != Denoise::Off,
            match settings.denoise {
                Denoise::Off => "not asked for (--denoise)".to_owned(),
                other => format!("{}: each texel a mean of those that continue it", other.name()),
            },
        ),
        effect(
            Effect::Seams,
            "seams",
            settings.seams,
            if settings.seams { "both sides made to look the same" } else { "switched off" }.to_owned(),
        ),
    ]
}
