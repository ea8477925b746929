//! The gate: input becomes a [`Plan`], which is valid, complete and the only thing that the solver
//! takes.
//!
//! Whatever can be wrong with the input is found before; nothing behind this point reports errors
//! of the input.

pub mod effects;
pub mod kernels;
pub mod memory;
pub mod settings;

use crate::error::{Error, Finding, Severity};
use crate::geom::atlas::{self, Atlas};
use crate::geom::seams::Seams;
use crate::geom::shade::opacity;
use crate::geom::{Bvh, World};
use crate::light::fires::Fires;
use crate::light::{Direct, Lights};
use crate::media::{Media, Responses};
use crate::scene::density::most_bytes;
use crate::scene::document::Document;
use crate::scene::model::{Rgb, Scene};
pub use effects::Decision;
pub use kernels::{Effect, Force, Kernels};
pub use memory::Memory;
pub use settings::{FireBy, MediaMode, Quality, Settings, Tuning};

/// A scene that is ready to be solved.
#[derive(Debug)]
pub struct Plan {
    scene: Scene,
    tracing: Tracing,
    atlas: Atlas,
    seams: Seams,
    settings: Settings,
    findings: Vec<Finding>,
}

/// What rays need: the placed triangles, the tree over them and the lights.
#[derive(Debug)]
pub struct Tracing {
    /// Placed triangles.
    pub world: World,
    /// The tree.
    pub bvh: Bvh,
    /// What emits.
    pub lights: Lights,
    /// What fills the air, if it does anything.
    pub media: Option<Media>,
    /// What it scatters, by the tables, if they are asked.
    pub responses: Option<Responses>,
    /// What media emit as many lights, if it is found that way.
    pub fires: Option<Fires>,
    /// Which kernel runs for each effect.
    pub kernels: Kernels,
}

impl Tracing {
    /// Places the triangles of a checked scene, builds the tree, gathers the lights and adds up the tables.
    ///
    /// # Errors
    ///
    /// If the tree cannot be built.
    pub fn new(scene: &Scene, mode: MediaMode, direct: Direct) -> Result<Self, Error> {
        Self::tuned(scene, mode, direct, &Tuning::default(), &Force::default())
    }

    /// The same with other look-ups than the usual ones, and other kernels than the smallest that are right.
    ///
    /// # Errors
    ///
    /// If the tree cannot be built, a file of tables does not suit, or a kernel is forced that is not right for the scene.
    pub fn tuned(
        scene: &Scene,
        mode: MediaMode,
        direct: Direct,
        tuning: &Tuning,
        force: &Force,
    ) -> Result<Self, Error> {
        let mut world = World::new(scene);
        let lights = Lights::chosen(scene, &world, direct, force.choosing());
        let mut lights = lights.tuned(tuning.light_samples, tuning.light_threshold);
        if direct == Direct::Grid {
            lights = lights.in_grid(tuning.direct_alpha);
        }
        let kernels = Kernels::choose(scene, &lights, (mode, direct), force)?;
        kernels.set_lights(&mut lights);
        let mut bvh = Bvh::build(&world, |t| {
            let surface = world.surface(t);
            scene.surfaces[surface].casts_shadow.then(|| opacity(scene, surface))
        })?;
        kernels.set_tree(&mut bvh);
        if kernels.is_at_most(Effect::Textures, 0) {
            world.keep_constant(scene);
        }
        let mut media = Media::new(scene, world.origin);
        // The general kernel with nothing to do: forced where there are no media, or none are to count.
        if !kernels.is_at_most(Effect::Media, 0) && (media.is_none() || mode == MediaMode::Off) {
            media = Some(Media::default());
        }
        media.iter_mut().for_each(|m| kernels.set_media(m));
        if tuning.fire == FireBy::March {
            media.iter_mut().for_each(Media::hide_fire);
        }
        let any_albedo =
            kernels.list().iter().any(|c| c.effect == Effect::MediaAlbedo && c.needed < c.kernel);
        let responses = match &media {
            Some(media) if mode == MediaMode::Table => {
                let from = (tuning.tables.as_deref(), tuning.zh_order);
                Responses::new(media, world.radius, any_albedo, from)?
            }
            _ => None,
        };
        let many = matches!(mode, MediaMode::Attenuate | MediaMode::Bounded);
        // What smoke scatters becomes lights as well where nodes of the light grid know all of it: what lamps bring straight away they do not.
        let nodes_know =
            lights.punctual.is_empty() && lights.suns.is_empty() && lights.emitters.groups().is_empty();
        let scattered =
            |m: &Media| mode == MediaMode::Bounded && nodes_know && m.scatters_in_even_smoke_alone();
        let fires = media.as_ref().filter(|_| many).zip(tuning.fire.grid());
        let fires =
            fires.and_then(|(m, f)| if scattered(m) { Fires::planned(m, f) } else { Fires::new(m, f) });
        let (need, most) = (fires.as_ref().map_or(0, Fires::bytes), most_bytes() as u64);
        if most < need {
            return Err(Error::Usage(format!(
                "--fire grid: the shadows of its lights take {:.1} GiB, and half of the machine's memory is {:.1} GiB; take a smaller --fire-alpha or --fire-depths, or --fire paths",
                need as f64 / f64::from(1 << 30),
                most as f64 / f64::from(1 << 30)
            )));
        }
        Ok(Self { world, bvh, lights, media, responses, fires, kernels })
    }
}

/// Refuses a scene with findings of [`Severity::Error`].
///
/// # Errors
///
/// [`Error::Input`] with those findings.
pub fn admit(findings: &[Finding]) -> Result<(), Error> {
    let errors: Vec<Finding> = findings.iter().filter(|f| f.severity == Severity::Error).cloned().collect();
    if errors.is_empty() { Ok(()) } else { Err(Error::Input(errors)) }
}

/// Makes a plan of a loaded scene: lays out the atlas and builds what rays need. `progress` hears of
/// the layout's share done and stops it by returning false.
///
/// # Errors
///
/// [`Error::Input`] if `findings` hold an error or the layout finds one, [`Error::Usage`] for
/// settings out of range, [`Error::Interrupted`] if `progress` said so.
pub fn make(
    mut scene: Scene,
    mut findings: Vec<Finding>,
    settings: Settings,
    progress: &(dyn Fn(usize, usize) -> bool + Sync),
) -> Result<Plan, Error> {
    admit(&findings)?;
    findings.extend(settings.force.leave_out(&mut scene));
    let (atlas, more) = atlas::build(&scene, &settings.atlas(), progress)?;
    findings.extend(more);
    if atlas.pages.is_empty() {
        return Err(Finding::error(
            "scene",
            "no surface gets texels",
            "set `lightmap` to `on` for at least one node that is not unlit",
        )
        .into());
    }
    let tracing = Tracing::tuned(&scene, settings.media, settings.direct, &settings.tuning, &settings.force)?;
    if settings.fire().is_some()
        && tracing.fires.is_none()
        && scene.media.iter().any(|m| m.emission != Rgb::ZERO)
    {
        let what = "the light of media that emit is found by paths: one of them has no end, or none shines";
        findings.push(Finding::warning(
            "--fire grid",
            what,
            "give every medium that emits a `box` or a grid",
        ));
    }
    let seams = if settings.seams { Seams::find(&scene, &tracing.world, &atlas) } else { Seams::default() };
    Ok(Plan { scene, tracing, atlas, seams, settings, findings })
}

impl Plan {
    /// The scene.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// What rays need.
    #[must_use]
    pub fn tracing(&self) -> &Tracing {
        &self.tracing
    }

    /// Where every surface's texels are.
    #[must_use]
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }

    /// Where surfaces go on at another place of the atlas; none if seams are not to be stitched.
    #[must_use]
    pub fn seams(&self) -> &Seams {
        &self.seams
    }

    /// Every setting with its resolved value.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What was noticed about the input; no errors.
    #[must_use]
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// What the scene contains and what will run because of it.
    #[must_use]
    pub fn effects(&self) -> Vec<Decision> {
        effects::list(&self.scene, &self.tracing, &self.settings)
    }

    /// Bytes that the bake will need at its peak; `document` is what the scene came from.
    #[must_use]
    pub fn memory(&self, document: &Document) -> Memory {
        Memory::estimate(self, document)
    }
}
