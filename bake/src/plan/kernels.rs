//! Which kernel runs for each effect: the smallest that is right for the scene, unless another one is forced.
//!
//! A larger kernel finds the same as a smaller one that is right, to the bit, but where it chooses lights or places in media another way; there it
//! is the same in the mean. Kernels are types where that saves time in a loop (whether rays ask about what they hit, [`crate::geom::Bvh`]), else
//! branches outside of loops, and what is the same for a whole scene is worked out once.

use crate::error::{Error, Finding};
use crate::geom::Bvh;
use crate::geom::bvh::Opacity;
use crate::geom::shade::{is_constant, opacity};
use crate::light::many::{FEW_EMITTERS, FEW_LAMPS};
use crate::light::{Choosing, Direct, Lights, Selection, SmallLights, selection};
use crate::media::{Media, Small};
use crate::plan::MediaMode;
use crate::scene::model::{Density, LightKind, LightMode, Medium, Region, Rgb, Scene};
use glam::Vec3;

/// An effect that has kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "words say what they are")]
pub enum Effect {
    Media,
    MediaColour,
    MediaAlbedo,
    Absorption,
    Phase,
    Density,
    Suns,
    Lamps,
    Emission,
    Sky,
    Opacity,
    Textures,
    Traversal,
    Lightmaps,
    Cache,
    Probes,
    Denoise,
    Seams,
}

impl Effect {
    /// All of them.
    pub const ALL: [Self; 18] = [
        Self::Media,
        Self::MediaColour,
        Self::MediaAlbedo,
        Self::Absorption,
        Self::Phase,
        Self::Density,
        Self::Suns,
        Self::Lamps,
        Self::Emission,
        Self::Sky,
        Self::Opacity,
        Self::Textures,
        Self::Traversal,
        Self::Lightmaps,
        Self::Cache,
        Self::Probes,
        Self::Denoise,
        Self::Seams,
    ];

    /// Its name in `--force`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Media => "media",
            Self::MediaColour => "media-colour",
            Self::MediaAlbedo => "media-albedo",
            Self::Absorption => "absorption",
            Self::Phase => "phase",
            Self::Density => "density",
            Self::Suns => "suns",
            Self::Lamps => "lamps",
            Self::Emission => "emission",
            Self::Sky => "sky",
            Self::Opacity => "opacity",
            Self::Textures => "textures",
            Self::Traversal => "traversal",
            Self::Lightmaps => "lightmaps",
            Self::Cache => "cache",
            Self::Probes => "probes",
            Self::Denoise => "denoise",
            Self::Seams => "seams",
        }
    }

    /// Its kernels, from the smallest to the general one.
    #[must_use]
    pub const fn kernels(self) -> &'static [&'static str] {
        match self {
            Self::Media | Self::Absorption | Self::Suns => &["none", "there"],
            Self::MediaColour => &["grey", "coloured"],
            Self::MediaAlbedo => &["one", "several"],
            Self::Phase => &["isotropic", "henyey-greenstein"],
            Self::Density => &["constant", "uneven"],
            Self::Lamps => &["none", "one", "all", "weighed", "tree"],
            Self::Emission => &["none", "all", "weighed", "tree"],
            Self::Sky => &["black", "smooth", "image"],
            Self::Opacity => &["opaque", "passing"],
            Self::Textures => &["constant", "textured"],
            Self::Traversal => &["avx2", "portable"],
            Self::Lightmaps => &["flat", "directional"],
            Self::Cache | Self::Probes | Self::Seams => &["off", "on"],
            Self::Denoise => &["off", "draft", "final"],
        }
    }

    /// The number of its general kernel.
    #[must_use]
    pub const fn general(self) -> usize {
        self.kernels().len() - 1
    }

    /// Whether its smallest kernel may be forced although the scene has the effect, which then is left out.
    const fn may_be_left_out(self) -> bool {
        matches!(self, Self::Media | Self::Suns | Self::Lamps | Self::Emission | Self::Sky)
    }

    /// Whether settings and not the scene ask for it: a stage of the bake.
    #[must_use]
    pub const fn is_stage(self) -> bool {
        matches!(self, Self::Lightmaps | Self::Cache | Self::Probes | Self::Denoise | Self::Seams)
    }

    /// What makes a larger kernel run.
    #[must_use]
    pub const fn grows_with(self) -> &'static str {
        match self {
            Self::Media => "any medium in the scene with --media other than off",
            Self::MediaColour => "a medium whose sigma_s or sigma_a differs between channels",
            Self::MediaAlbedo => "a second albedo, of another medium or channel (--media table)",
            Self::Absorption => "a medium with sigma_a above 0 (--media table)",
            Self::Phase => "a medium that scatters with g other than 0",
            Self::Density => "a second medium, a closed mesh, or a density that varies",
            Self::Suns => "a directional light that is baked or mixed",
            Self::Lamps => "more lamps (all of up to 16 are weighed, more are in a tree), or --direct",
            Self::Emission => "emissive triangles (up to 32 are weighed, more are in a tree), or --direct",
            Self::Sky => "a sky that shines, and one that is an image",
            Self::Opacity => "a material with an alpha mode other than OPAQUE, or with transmission",
            Self::Textures => "a texture of colour, emission or transmission, or colours of vertices",
            Self::Traversal => "a processor without AVX2, FMA or BMI1",
            Self::Lightmaps => "--directional",
            Self::Cache => "--irradiance-cache on without --bounces",
            Self::Probes => "--probes",
            Self::Denoise => "--denoise",
            Self::Seams => "--seams on",
        }
    }
}

/// Kernels that were asked for by name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Force(Vec<(Effect, usize)>);

impl Force {
    /// Reads `EFFECT=KERNEL` each; of several for one effect the last one counts.
    ///
    /// # Errors
    ///
    /// [`Error::Usage`] for unknown words, with the nearest known one.
    pub fn parse<'a>(texts: impl IntoIterator<Item = &'a str>) -> Result<Self, Error> {
        let mut force = Self::default();
        for text in texts {
            let wrong = |what: String| Error::Usage(format!("--force {text}: {what}"));
            let Some((effect, kernel)) = text.split_once('=') else {
                return Err(wrong("write EFFECT=KERNEL, such as lamps=tree".to_owned()));
            };
            let (effect, kernel) = (effect.trim(), kernel.trim());
            let words = Effect::ALL.map(Effect::word);
            let Some(effect) = Effect::ALL.into_iter().find(|e| e.word() == effect) else {
                return Err(wrong(unknown("effect", effect, &words)));
            };
            let known = effect.kernels();
            let Some(kernel) = known.iter().position(|k| *k == kernel) else {
                return Err(wrong(unknown(&format!("kernel of {}", effect.word()), kernel, known)));
            };
            force.0.retain(|f| f.0 != effect);
            force.0.push((effect, kernel));
        }
        Ok(force)
    }

    /// The number of the kernel that an effect is to have.
    #[must_use]
    pub fn get(&self, effect: Effect) -> Option<usize> {
        self.0.iter().find(|f| f.0 == effect).map(|f| f.1)
    }

    /// Its name.
    #[must_use]
    pub fn word(&self, effect: Effect) -> Option<&'static str> {
        self.get(effect).map(|k| effect.kernels()[k])
    }

    /// What was asked for, as it is written.
    #[must_use]
    pub fn texts(&self) -> Vec<String> {
        self.0.iter().map(|(e, k)| format!("{}={}", e.word(), e.kernels()[*k])).collect()
    }

    /// The effects that are forced.
    pub fn effects(&self) -> impl Iterator<Item = Effect> + '_ {
        self.0.iter().map(|f| f.0)
    }

    /// How lights are to be chosen.
    #[must_use]
    pub fn choosing(&self) -> Choosing {
        let by = |effect| match self.word(effect) {
            Some("all") => Some(Selection::All),
            Some("weighed") => Some(Selection::Weighed),
            Some("tree") => Some(Selection::Tree),
            _ => None,
        };
        Choosing { lamps: by(Effect::Lamps), emitters: by(Effect::Emission) }
    }

    fn is_smallest(&self, effect: Effect) -> bool {
        self.get(effect) == Some(0)
    }

    /// Takes out of the scene what is to be left out, and says so.
    #[must_use]
    pub fn leave_out(&self, scene: &mut Scene) -> Vec<Finding> {
        let mut findings = Vec::new();
        let mut say = |effect: Effect, n: usize, what: &str| {
            if 0 < n {
                let text = format!("--force {}={}", effect.word(), effect.kernels()[0]);
                let says = format!("{n} {what} left out of the result: {text}");
                findings.push(Finding::warning("force", says, "remove it to bake what the scene has"));
            }
        };
        if self.is_smallest(Effect::Media) {
            say(Effect::Media, scene.media.len(), "media are");
        }
        for (effect, suns) in [(Effect::Suns, true), (Effect::Lamps, false)] {
            if self.is_smallest(effect) {
                let is = |kind: &LightKind| matches!(kind, LightKind::Directional { .. }) == suns;
                let n = scene.lights.iter().filter(|l| l.mode != LightMode::Dynamic && is(&l.kind)).count();
                scene.lights.retain(|l| l.mode == LightMode::Dynamic || !is(&l.kind));
                say(effect, n, if suns { "suns are" } else { "lamps are" });
            }
        }
        if self.is_smallest(Effect::Emission) {
            let shines = scene.materials.iter_mut().filter(|m| m.emission != Vec3::ZERO && !m.unlit);
            let n = shines.map(|m| m.emission = Vec3::ZERO).count();
            say(Effect::Emission, n, "emissive materials are");
        }
        if self.is_smallest(Effect::Sky) {
            let shines = !crate::light::SkyLight::new(&scene.sky).is_black();
            scene.sky = crate::scene::model::Sky::Black;
            say(Effect::Sky, usize::from(shines), "sky is");
        }
        findings
    }
}

fn unknown(what: &str, word: &str, known: &[&str]) -> String {
    let near =
        known.iter().max_by(|a, b| strsim::jaro_winkler(a, word).total_cmp(&strsim::jaro_winkler(b, word)));
    let near = near.filter(|k| 0.7 < strsim::jaro_winkler(k, word));
    let near = near.map_or_else(String::new, |k| format!("; did you mean `{k}`?"));
    format!("unknown {what} `{word}`{near}; known: {}", known.join(", "))
}

/// The kernel of one effect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// The effect.
    pub effect: Effect,
    /// Number of the kernel that runs.
    pub kernel: usize,
    /// Number of the smallest one that is right.
    pub needed: usize,
    /// What of the scene decides that.
    pub because: String,
    /// It was asked for by name.
    pub forced: bool,
}

impl Choice {
    /// The choice where `needed` is the smallest kernel that is right.
    pub(crate) fn new(effect: Effect, (needed, because): (usize, String), force: &Force) -> Self {
        let forced = force.get(effect);
        Self { effect, kernel: forced.unwrap_or(needed), needed, because, forced: forced.is_some() }
    }

    /// Name of the kernel that runs.
    #[must_use]
    pub fn word(&self) -> &'static str {
        self.effect.kernels()[self.kernel]
    }

    /// Why it runs, what would make it smaller or larger, and what undoes it.
    #[must_use]
    pub fn explain(&self) -> String {
        let (word, kernels) = (self.effect.word(), self.effect.kernels());
        let mut text = if self.forced {
            format!(
                "--force asks for `{}`, where `{}` is enough: {}.",
                self.word(),
                kernels[self.needed],
                self.because
            )
        } else {
            format!("`{}` runs: {}.", self.word(), self.because)
        };
        if 0 < self.needed && !self.effect.is_stage() {
            text += &format!(" Without that `{}` would do.", kernels[self.needed - 1]);
        }
        if self.kernel < self.effect.general() {
            text += &format!(" A larger one runs with {}.", self.effect.grows_with());
        }
        let undo = match (self.forced, self.needed) {
            (true, _) => "Leave out --force to undo it.".to_owned(),
            (false, n) if n < self.effect.general() => {
                format!("--force {word}={} runs the general one.", kernels[self.effect.general()])
            }
            (false, _) if self.effect.may_be_left_out() => {
                format!("--force {word}={} leaves it out.", kernels[0])
            }
            (false, _) if self.effect.is_stage() => format!("--force {word}={} undoes it.", kernels[0]),
            (false, _) => "Nothing smaller is right.".to_owned(),
        };
        text + " " + &undo
    }
}

/// The kernels of all effects that the scene decides.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Kernels(Vec<Choice>);

impl Kernels {
    /// The smallest kernels that are right for a scene and its lights, or those that are forced.
    ///
    /// # Errors
    ///
    /// [`Error::Usage`] if a smaller one is forced than is right.
    pub fn choose(
        scene: &Scene,
        lights: &Lights,
        (mode, direct): (MediaMode, Direct),
        force: &Force,
    ) -> Result<Self, Error> {
        let media: &[Medium] = if mode == MediaMode::Off { &[] } else { &scene.media };
        let acting: Vec<&Medium> = media.iter().filter(|m| m.acts()).collect();
        let needs = Effect::ALL.into_iter().filter(|e| !e.is_stage()).map(|effect| {
            let need = need(effect, scene, lights, (&acting, direct));
            (effect, need)
        });
        let mut list = Vec::new();
        for (effect, need) in needs {
            let choice = Choice::new(effect, need, force);
            let few = effect == Effect::Emission && choice.word() == "weighed";
            if choice.kernel < choice.needed || (few && FEW_EMITTERS < lights.emitters.len()) {
                return Err(Error::Usage(format!(
                    "--force {}={} is not right here: {}; the smallest kernel that is right is `{}`",
                    effect.word(),
                    choice.word(),
                    choice.because,
                    effect.kernels()[choice.needed]
                )));
            }
            list.push(choice);
        }
        Ok(Self(list))
    }

    /// The choice for each effect.
    #[must_use]
    pub fn list(&self) -> &[Choice] {
        &self.0
    }

    /// Whether the kernel of an effect is one of the first `n + 1`.
    #[must_use]
    pub fn is_at_most(&self, effect: Effect, n: usize) -> bool {
        self.0.iter().any(|c| c.effect == effect && c.kernel <= n)
    }

    /// Has the media's kernels run.
    pub(crate) fn set_media(&self, media: &mut Media) {
        media.allow(Small {
            grey: self.is_at_most(Effect::MediaColour, 0),
            isotropic: self.is_at_most(Effect::Phase, 0),
            constant: self.is_at_most(Effect::Density, 0),
            lossless: self.is_at_most(Effect::Absorption, 0),
        });
    }

    /// Has the lights' kernels run.
    pub(crate) fn set_lights(&self, lights: &mut Lights) {
        let small = lights.small;
        lights.small = SmallLights {
            no_suns: small.no_suns && self.is_at_most(Effect::Suns, 0),
            no_lamps: small.no_lamps && self.is_at_most(Effect::Lamps, 0),
            one_lamp: small.one_lamp && self.is_at_most(Effect::Lamps, 1),
            no_emission: small.no_emission && self.is_at_most(Effect::Emission, 0),
            black_sky: small.black_sky && self.is_at_most(Effect::Sky, 0),
            no_image: small.no_image && self.is_at_most(Effect::Sky, 1),
        };
    }

    /// Has the tree's kernels run.
    pub(crate) fn set_tree(&self, bvh: &mut Bvh) {
        if !self.is_at_most(Effect::Opacity, 0) {
            bvh.ask_always();
        }
        if !self.is_at_most(Effect::Traversal, 0) {
            bvh.use_plain_loops();
        }
    }
}

/// The smallest kernel that is right for an effect, and what decides that.
fn need(
    effect: Effect,
    scene: &Scene,
    lights: &Lights,
    (media, direct): (&[&Medium], Direct),
) -> (usize, String) {
    let n = |n: usize, what: &str, first: Option<&str>| match (n, first) {
        (0, _) => format!("there is no {what}"),
        (1, first) => format!("there is 1 {what}, {}", first.unwrap_or("unnamed")),
        (n, first) => format!("there are {n} {what}s, the first of them {}", first.unwrap_or("unnamed")),
    };
    let lamp = |suns: bool| {
        let is = |kind: &LightKind| matches!(kind, LightKind::Directional { .. }) == suns;
        let found = scene.lights.iter().find(|l| l.mode != LightMode::Dynamic && is(&l.kind));
        found.map(|l| l.path.as_str())
    };
    let shines = || {
        let found = scene.surfaces.iter().find(|s| scene.materials[s.material].emission != Vec3::ZERO);
        found.map(|s| s.path.as_str())
    };
    match effect {
        Effect::Suns => {
            (usize::from(!lights.suns.is_empty()), n(lights.suns.len(), "directional light", lamp(true)))
        }
        Effect::Lamps => {
            let count = lights.punctual.len();
            let k = match (count, selection(direct, count, FEW_LAMPS)) {
                (0, _) => 0,
                (1, Selection::Weighed) => 1,
                (_, Selection::All) => 2,
                (_, Selection::Weighed) => 3,
                (_, Selection::Tree) => 4,
            };
            (k, n(count, "lamp", lamp(false)))
        }
        Effect::Emission => {
            let count = lights.emitters.len();
            let k = match (count, selection(direct, count, FEW_EMITTERS)) {
                (0, _) if lights.small.no_emission => 0,
                (_, Selection::All) => 1,
                (_, Selection::Weighed) => 2,
                (_, Selection::Tree) => 3,
            };
            (k, n(count, "emissive triangle", shines()))
        }
        Effect::Sky if lights.sky.is_black() => (0, "the sky is black".to_owned()),
        Effect::Sky if lights.sky.is_sampled() => (2, "the sky is an image".to_owned()),
        Effect::Sky => (1, "the sky shines evenly or smoothly".to_owned()),
        Effect::Traversal if Bvh::default().uses_avx2() => {
            (0, "the processor has AVX2, FMA and BMI1".to_owned())
        }
        Effect::Traversal => (1, "the processor lacks AVX2, FMA or BMI1".to_owned()),
        Effect::Opacity => of_surfaces(
            scene,
            |s| opacity(scene, s) == Opacity::Ask,
            "lets light pass",
            "all surfaces are opaque",
        ),
        Effect::Textures => of_surfaces(
            scene,
            |s| !is_constant(scene, s),
            "has a texture or colours of vertices",
            "all materials are constant",
        ),
        _ => need_of_media(effect, media),
    }
}

/// The first surface of which something holds asks for the larger kernel.
fn of_surfaces(scene: &Scene, holds: impl Fn(usize) -> bool, what: &str, none: &str) -> (usize, String) {
    match (0..scene.surfaces.len()).find(|s| holds(*s)) {
        None => (0, none.to_owned()),
        Some(s) => {
            let (surface, name) = (&scene.surfaces[s], &scene.materials[scene.surfaces[s].material].name);
            (1, format!("{}, material `{name}`, {what}", surface.path))
        }
    }
}

fn is_grey(v: Rgb) -> bool {
    v.x == v.y && v.y == v.z
}

fn need_of_media(effect: Effect, media: &[&Medium]) -> (usize, String) {
    let Some(first) = media.first() else { return (0, "no medium is simulated".to_owned()) };
    let found = |medium: Option<&&Medium>, what: &str, none: &str| match medium {
        Some(m) => (1, format!("{} {what}", m.path)),
        None => (0, none.to_owned()),
    };
    let find = |holds: &dyn Fn(&Medium) -> bool| media.iter().find(|m| holds(m));
    match effect {
        Effect::MediaColour => {
            let coloured = |m: &Medium| !(is_grey(m.sigma_s) && is_grey(m.sigma_a));
            found(
                find(&coloured),
                "differs between channels",
                "sigma_s and sigma_a are equal in all channels",
            )
        }
        Effect::Absorption => found(find(&|m| m.sigma_a != Vec3::ZERO), "absorbs", "nothing absorbs"),
        Effect::Phase => {
            found(find(&|m| m.g != 0.0 && m.sigma_s != Vec3::ZERO), "has g other than 0", "g is 0 everywhere")
        }
        Effect::MediaAlbedo => {
            let albedos = |m: &Medium| {
                (m.sigma_s / (m.sigma_s + m.sigma_a))
                    .to_array()
                    .into_iter()
                    .filter(|a| a.is_finite())
                    .collect::<Vec<_>>()
            };
            let one = media.iter().flat_map(|m| albedos(m)).next();
            let other = find(&|m| albedos(m).iter().any(|a| Some(*a) != one));
            found(other, "has another albedo", "there is one albedo")
        }
        Effect::Density if 1 < media.len() => (1, format!("{} is a second medium", media[1].path)),
        Effect::Density => {
            let uneven =
                |m: &Medium| !matches!(m.density, Density::Constant) || matches!(m.region, Region::Mesh(_));
            found(
                find(&uneven),
                "has a density that varies, or a closed mesh around it",
                "one medium of constant density",
            )
        }
        _ => (1, format!("{} is simulated", first.path)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_word_is_named() {
        let said = |text: &str| Force::parse([text]).expect_err(text).to_string();
        assert!(said("lamp=tree").contains("did you mean `lamps`?"));
        assert!(said("lamps=trees").contains("did you mean `tree`?"));
        assert!(said("lamps").contains("EFFECT=KERNEL"));
        let last = Force::parse(["lamps=one", "suns=none", "lamps=tree"]).expect("known words");
        assert_eq!(last.texts(), ["suns=none", "lamps=tree"]);
    }

    #[test]
    fn every_effect_has_a_word_of_its_own_and_several_kernels() {
        for (i, effect) in Effect::ALL.into_iter().enumerate() {
            assert!(1 < effect.kernels().len());
            assert!(Effect::ALL[..i].iter().all(|e| e.word() != effect.word()));
        }
    }
}
