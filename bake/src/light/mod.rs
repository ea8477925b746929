//! Everything that emits: punctual lights, suns, emissive triangles and the sky, each with sampling
//! and density.

pub mod beams;
pub mod emitters;
pub mod punctual;
pub mod sky;
pub mod sky_guide;

use crate::geom::World;
use crate::scene::model::{LightKind, LightMode, Scene};
pub use beams::Beams;
pub use emitters::Emitters;
pub use punctual::{Punctual, Sun};
pub use sky::SkyLight;
pub use sky_guide::SkyGuide;

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
}

impl Lights {
    /// Whether there are lights that no direction hits by chance.
    #[must_use]
    pub fn has_small(&self) -> bool {
        !(self.suns.is_empty() && self.punctual.is_empty())
    }

    /// Gathers the lights of a scene.
    #[must_use]
    pub fn new(scene: &Scene, world: &World) -> Self {
        let (mut punctual, mut suns) = (Vec::new(), Vec::new());
        for light in scene.lights.iter().filter(|l| l.mode != LightMode::Dynamic) {
            match light.kind {
                LightKind::Directional { direction, illuminance, angular_diameter } => {
                    suns.push(Sun::new(direction, illuminance, angular_diameter, light.mode));
                }
                kind => punctual.extend(Punctual::new(kind, light.mode, world.origin)),
            }
        }
        Self { punctual, suns, emitters: Emitters::new(scene, world), sky: SkyLight::new(&scene.sky) }
    }
}
