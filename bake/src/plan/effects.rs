//! What a scene contains, and what runs because of it.

use crate::light::many::EVERY_LAMP;
use crate::light::{Direct, Lights, Selection};
use crate::plan::settings::{MediaMode, Settings};
use crate::scene::model::{AlphaMode, LightMode, LightmapMode, Scene};
use serde::Serialize;

/// One effect that the baker knows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Effect {
    /// Name.
    pub name: &'static str,
    /// Whether something runs for it.
    pub runs: bool,
    /// What the scene has of it, and what follows.
    pub why: String,
}

/// All effects, those that run and those that do not.
#[must_use]
pub fn list(scene: &Scene, lights: &Lights, settings: &Settings) -> Vec<Effect> {
    let used = |f: &dyn Fn(&crate::scene::model::Material) -> bool| {
        scene.surfaces.iter().filter(|s| f(&scene.materials[s.material])).count()
    };
    let dynamic = scene.lights.iter().filter(|l| l.mode == LightMode::Dynamic).count();
    let mixed = scene.lights.iter().filter(|l| l.mode == LightMode::Mixed).count();
    let emitters = lights.emitters.len();
    let off = scene.surfaces.iter().filter(|s| s.lightmap != LightmapMode::On).count();
    let masked = used(&|m| matches!(m.alpha_mode, AlphaMode::Mask(_)));
    let see_through = used(&|m| m.alpha_mode == AlphaMode::Blend || 0.0 < m.transmission);
    let unlit = used(&|m| m.unlit);
    let count = |n: usize, what: &str| match n {
        0 => format!("no {what}"),
        1 => format!("1 {what}"),
        n => format!("{n} {what}s"),
    };
    let effect = |name, runs, why| Effect { name, runs, why };
    let from_tree = match settings.direct {
        Direct::Auto => ": many, chosen from a tree (stochastic lightcuts)",
        Direct::Lightcuts => ", chosen from a tree (stochastic lightcuts)",
        _ => ", chosen as --direct says, to compare with",
    };
    vec![
        effect(
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
                },
        ),
        effect("suns", !lights.suns.is_empty(), count(lights.suns.len(), "directional light")),
        effect(
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
        effect("alpha masks", 0 < masked, count(masked, "surface") + " tested at every hit"),
        effect(
            "blending and transmission",
            0 < see_through,
            count(see_through, "surface") + " letting light straight through",
        ),
        effect("unlit surfaces", 0 < unlit, count(unlit, "surface") + " without texels"),
        effect("surfaces without lightmap", 0 < off, count(off, "surface") + " lit at run time"),
        effect("mixed lights", 0 < mixed, count(mixed, "light") + " of which only indirect light is baked"),
        effect("dynamic lights", false, count(dynamic, "light") + " left to the game"),
        effect(
            "irradiance cache",
            settings.caches(),
            match (settings.irradiance_cache, settings.bounces) {
                (true, None) => "paths end at irradiance gathered beforehand".to_owned(),
                (true, Some(n)) => format!("ruled out by the limit of {n} reflections"),
                (false, _) => "switched off: paths go on to their last reflection".to_owned(),
            },
        ),
        effect(
            "directional lightmaps",
            settings.directional.is_some(),
            match settings.directional {
                Some(n) => format!("{n} paths per texel for the direction of light"),
                None => "not asked for (--directional)".to_owned(),
            },
        ),
        effect(
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
    ]
}
