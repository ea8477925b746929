//! Media that emit as many point lights, in a lighting grid hierarchy with the shadows of the smoke around them.

use crate::geom::world::luminance;
use crate::light::hierarchy::shadows::{Shadows, Size, sizes};
use crate::light::hierarchy::{
    Arriving, Blend, Build, Clamp, GridLight, GridLights, Hierarchy, Options, PointLight,
};
use crate::media::Media;
use crate::media::lattice::Lattice;
use crate::scene::model::Rgb;
use glam::Vec3A;
use std::sync::OnceLock;

/// Point lights of level 0 at most: of more, neighbours are shared among the vertices of a coarser grid.
const MOST_LIGHTS: usize = 100_000;

/// Part of each level's light that is kept.
const KEEP: f32 = 0.999;

/// How a hierarchy of fires is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FireOptions {
    /// Radius of influence over spacing.
    pub alpha: f32,
    /// Optical depths in each texel of a shadow.
    pub depths: usize,
    /// Where levels come from.
    pub build: Build,
    /// How levels take over from each other.
    pub blend: Blend,
}

impl Default for FireOptions {
    /// As published, but for the blending.
    fn default() -> Self {
        Self { alpha: 2.0, depths: 4, build: Build::FromLights, blend: Blend::Conserving }
    }
}

/// The light of all media that emit, and, in [`Fires::with_scattered`], of what smoke scatters.
#[derive(Debug)]
pub struct Fires {
    hierarchy: Hierarchy,
    smoke: Option<(Lattice, Media)>,
    /// Media that are no grids.
    rest: Option<Media>,
    shadows: OnceLock<Option<Shadows>>,
    options: FireOptions,
    waits: bool,
}

impl Fires {
    /// `None` where nothing emits, or something does without end.
    #[must_use]
    pub fn new(media: &Media, options: FireOptions) -> Option<Self> {
        Self::of(media, media.emitting_points()?, options)
    }

    /// As many lights as there will be with what smoke scatters, which is not known yet: they wait for [`Self::with_scattered`].
    #[must_use]
    pub fn planned(media: &Media, options: FireOptions) -> Option<Self> {
        let points = media.shining_points(&|_| Rgb::ONE)?;
        Self::of(media, points, options).map(|fires| Self { waits: true, ..fires })
    }

    /// The same with what smoke scatters of light whose mean radiance at a place is known, nits: \[LGH17\] section 5 in one step, with all orders of scattering from
    /// a light grid instead of lights that light voxels order by order.
    #[must_use]
    pub fn with_scattered(&self, media: &Media, around: &dyn Fn(Vec3A) -> Rgb) -> Option<Self> {
        Self::of(media, media.shining_points(around)?, self.options)
    }

    /// Whether its lights are not known yet.
    #[must_use]
    pub fn waits(&self) -> bool {
        self.waits
    }

    fn of(media: &Media, (points, side): (Vec<(Vec3A, Rgb)>, f32), options: FireOptions) -> Option<Self> {
        let mut lights: Vec<PointLight> =
            points.into_iter().map(|(position, intensity)| PointLight { position, intensity }).collect();
        let mut spacing = 2.0 * side;
        let build = |lights: &[PointLight], spacing, levels| {
            let anchor = Vec3A::ZERO;
            let FireOptions { alpha, build, blend, .. } = options;
            let clamp = Clamp::All;
            Hierarchy::new(
                lights,
                &Options { spacing, alpha, levels, anchor, build, blend, clamp, keep: 1.0 },
            )
        };
        while MOST_LIGHTS < lights.len() {
            let coarse = build(&lights, spacing, Some(1));
            let of = |l: &GridLight| PointLight { position: l.position, intensity: l.intensity };
            lights = coarse.levels()[1].lights.iter().map(of).collect();
            spacing *= 2.0;
        }
        let all = Options {
            spacing,
            alpha: options.alpha,
            levels: None,
            anchor: Vec3A::ZERO,
            build: options.build,
            blend: options.blend,
            clamp: Clamp::All,
            keep: KEEP,
        };
        let hierarchy = Hierarchy::new(&lights, &all);
        if hierarchy.levels().iter().all(|l| l.lights.is_empty()) {
            return None;
        }
        let (smoke, rest) = (Lattice::new(media).zip(media.grids()), media.beside_grids());
        Some(Self { hierarchy, smoke, rest, shadows: OnceLock::new(), options, waits: false })
    }

    /// The maps of shadows, filled when first asked for; `None` where there is no smoke.
    pub fn shadows(&self) -> Option<&Shadows> {
        self.fill(&|| false)
    }

    /// The same; once `stopped` says so, what there is of them is of no use.
    pub fn fill(&self, stopped: &(dyn Fn() -> bool + Sync)) -> Option<&Shadows> {
        let fill = || {
            self.smoke.clone().map(|smoke| Shadows::new(&self.hierarchy, smoke, self.options.depths, stopped))
        };
        self.shadows.get_or_init(fill).as_ref()
    }

    /// What the shadows of each level take.
    #[must_use]
    pub fn sizes(&self) -> Vec<Size> {
        let of = |l: &crate::light::hierarchy::Level| Size { lights: l.lights.len(), ..Size::default() };
        match &self.smoke {
            Some((smoke, _)) => sizes(&self.hierarchy, smoke, self.options.depths),
            None => self.hierarchy.levels().iter().map(of).collect(),
        }
    }

    /// Bytes of everything, with the shadows.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        // The smoke twice: once as it is, once as the shadows have it.
        let smoke = self.smoke.as_ref().map_or(0, |s| 2 * s.0.bytes());
        self.hierarchy.bytes() + smoke + self.sizes().iter().map(|s| s.bytes).sum::<u64>()
    }

    /// Luminance that all of them emit, candela.
    #[must_use]
    pub fn power(&self) -> f64 {
        let last = self.hierarchy.levels().last();
        last.map_or(0.0, |l| l.lights.iter().map(|l| f64::from(luminance(l.intensity))).sum())
    }
}

impl GridLights for Fires {
    fn hierarchy(&self) -> &Hierarchy {
        &self.hierarchy
    }

    /// Dimmed by media; by smoke only once [`Self::shadows`] was asked for, which works on all threads and so cannot be here.
    #[inline]
    fn visit(&self, place: Vec3A, mut visit: impl FnMut(&Arriving<'_>)) {
        let shadows = self.shadows.get().and_then(Option::as_ref);
        self.hierarchy.visit(place, |level, number, light, distance, weight| {
            let wi = (light.position - place).normalize_or(Vec3A::Y);
            let mut illuminance = light.intensity * (weight * self.hierarchy.falloff(level, distance));
            if let Some(shadows) = shadows {
                illuminance *= shadows.left(level, number, -wi, distance);
            }
            if let Some(rest) = &self.rest {
                illuminance *= rest.transmittance(place, wi, distance);
            }
            visit(&Arriving { level, number, light, wi, illuminance });
        });
    }
}
