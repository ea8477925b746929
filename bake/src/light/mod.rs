//! Everything that emits: punctual lights, suns, emissive triangles and the sky, each with sampling
//! and density.

pub mod beams;
pub mod emitters;
pub mod fires;
pub mod hierarchy;
pub mod lamp_grid;
pub mod many;
pub mod punctual;
pub mod sky;
pub mod sky_guide;
pub mod tree;

use crate::geom::World;
use crate::scene::model::{LightKind, LightMode, Scene, Surface};
pub use beams::Beams;
pub use emitters::Emitters;
use glam::{Vec3, Vec3A};
pub use lamp_grid::LampGrid;
pub use many::{Direct, ManyLights, Selection, selection};
use many::{FEW_EMITTERS, FEW_LAMPS};
pub use punctual::{Punctual, Sun};
pub use sky::SkyLight;
pub use sky_guide::SkyGuide;
use tree::Receiver;

/// The lights of a scene, ready to be sampled. Dynamic lights are left out.
#[derive(Clone, Debug)]
pub struct Lights {
    /// Point and spot lights.
    pub punctual: Vec<Punctual>,
    /// Directional lights.
    pub suns: Vec<Sun>,
    /// Emissive triangles.
    pub emitters: Emitters,
    /// What rays see that leave the scene.
    pub sky: SkyLight,
    /// How one of the lamps is chosen.
    pub lamps_by: Selection,
    /// How one of the emissive triangles is chosen.
    pub emitters_by: Selection,
    /// The tree of those that are many.
    pub many: Option<ManyLights>,
    /// The lamps that receivers ask all at once.
    pub lamp_grid: Option<LampGrid>,
    /// How many of many texels ask at once.
    pub asked_at_once: usize,
    /// Which of the small kernels run.
    pub small: SmallLights,
}

/// Which of the small kernels run for lights: those that leave out what is not there, unless a larger one is forced, which gives the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SmallLights {
    /// Nobody asks for suns.
    pub no_suns: bool,
    /// Nobody asks for lamps.
    pub no_lamps: bool,
    /// There is one lamp, which need not be chosen.
    pub one_lamp: bool,
    /// Nobody asks for emissive triangles, and surfaces that are hit are not asked whether they shine.
    pub no_emission: bool,
    /// Rays that leave the scene bring nothing.
    pub black_sky: bool,
    /// The sky is no image, which would be asked for its bright parts.
    pub no_image: bool,
}

/// How lights are chosen in place of what [`Direct`] would do; `None` leaves it to that.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Choosing {
    /// Lamps.
    pub lamps: Option<Selection>,
    /// Emissive triangles.
    pub emitters: Option<Selection>,
}

impl Lights {
    /// Whether there are lights that no direction hits by chance.
    #[must_use]
    pub fn has_small(&self) -> bool {
        !(self.suns.is_empty() && self.punctual.is_empty())
    }

    /// The same with so many of many lights asked at once, from a tree whose nodes are opened beyond this
    /// [`many::THRESHOLD`].
    #[must_use]
    pub fn tuned(self, asked_at_once: u32, threshold: f32) -> Self {
        let many = self.many.map(|m| m.with_threshold(threshold));
        Self { many, asked_at_once: asked_at_once as usize, ..self }
    }

    /// The same with the lamps that suit in a lighting grid hierarchy of this alpha.
    #[must_use]
    pub fn in_grid(self, alpha: f32) -> Self {
        Self { lamp_grid: LampGrid::new(&self.punctual, alpha), ..self }
    }

    /// Bytes that lamps, emissive triangles and their tree take, about.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let tree = self.many.as_ref().map_or(0, ManyLights::bytes);
        let grid = self.lamp_grid.as_ref().map_or(0, LampGrid::bytes);
        (self.punctual.len() * size_of::<Punctual>() + self.emitters.bytes() + tree) as u64 + grid
    }

    /// The tree, if lamps are in it.
    #[must_use]
    pub fn many_lamps(&self) -> Option<&ManyLights> {
        self.many.as_ref().filter(|_| self.lamps_by == Selection::Tree)
    }

    /// The tree, if emissive triangles are in it.
    #[must_use]
    pub fn many_emitters(&self) -> Option<&ManyLights> {
        self.many.as_ref().filter(|_| self.emitters_by == Selection::Tree)
    }

    /// Density per steradian with which next-event estimation at `at` chooses a point of a world triangle seen in direction `wi` at
    /// `distance`. 0 if it does not emit.
    #[must_use]
    pub fn emitter_pdf(&self, at: &Receiver, triangle: u32, wi: Vec3A, distance: f32) -> f32 {
        self.emitters.pdf(at, triangle, wi, distance, |k| match (self.emitters_by, &self.many) {
            (Selection::Tree, Some(many)) => many.probability(at, k),
            (Selection::All, _) => 1.0,
            _ => self.emitters.probability(at, k),
        })
    }

    /// Gathers the lights of a scene.
    #[must_use]
    pub fn new(scene: &Scene, world: &World, direct: Direct) -> Self {
        Self::chosen(scene, world, direct, Choosing::default())
    }

    /// The same with another way to choose among them.
    #[must_use]
    pub fn chosen(scene: &Scene, world: &World, direct: Direct, choosing: Choosing) -> Self {
        let (mut punctual, mut suns) = (Vec::new(), Vec::new());
        for light in scene.lights.iter().filter(|l| l.mode != LightMode::Dynamic) {
            match light.kind {
                LightKind::Directional { direction, illuminance, angular_diameter } => {
                    suns.push(Sun::new(direction, illuminance, angular_diameter, light.mode));
                }
                kind => punctual.extend(Punctual::new(kind, light.mode, world.origin)),
            }
        }
        let emitters = Emitters::new(scene, world);
        let forced = |wish: Option<Selection>, n: usize| wish.filter(|_| 0 < n);
        let lamps_by = forced(choosing.lamps, punctual.len())
            .unwrap_or_else(|| selection(direct, punctual.len(), FEW_LAMPS));
        let emitters_by = forced(choosing.emitters, emitters.len())
            .unwrap_or_else(|| selection(direct, emitters.len(), FEW_EMITTERS));
        let many = ManyLights::new(
            direct,
            (lamps_by == Selection::Tree).then_some(punctual.as_slice()),
            (emitters_by == Selection::Tree).then_some(&emitters),
        );
        let sky = SkyLight::new(&scene.sky);
        let shines = |s: &Surface| {
            let m = &scene.materials[s.material];
            m.emission != Vec3::ZERO && !m.unlit
        };
        let small = SmallLights {
            no_suns: suns.is_empty(),
            no_lamps: punctual.is_empty(),
            one_lamp: punctual.len() == 1 && lamps_by == Selection::Weighed,
            // What shines beyond all numbers is no emitter and found by chance.
            no_emission: emitters.is_empty() && !scene.surfaces.iter().any(shines),
            black_sky: sky.is_black(),
            no_image: !sky.is_sampled(),
        };
        let asked_at_once = many::SEVERAL as usize;
        Self {
            punctual,
            suns,
            emitters,
            sky,
            lamps_by,
            emitters_by,
            many,
            lamp_grid: None,
            asked_at_once,
            small,
        }
    }
}
