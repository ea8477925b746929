//! What comes before sampling, the same for a bake and for a single sample that is replayed.

use crate::cli::input;
use crate::cli::say::{self, Interrupt, Style};
use crate::error::Error;
use crate::light::fires::Fires;
use crate::media::Media;
use crate::plan::Plan;
use crate::plan::settings::Probes;
use crate::solve::accumulate::Gate;
use crate::solve::cache::Cells;
use crate::solve::light_grid::Gathering;
use crate::solve::pilot::{self, Learnt};
use crate::solve::probes::{Wanted, Where};
use crate::solve::{Monitor, lightmap};
use crate::transport::cache::IrradianceCache;
use crate::transport::light_grid::LightGrid;
use crate::transport::{Kernel, Vertex};

/// A plan that is carried out, and who watches.
#[derive(Clone, Copy)]
pub(crate) struct Stages<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) style: Style,
    pub(crate) interrupt: &'a Interrupt,
    pub(crate) monitor: &'a Monitor,
}

impl Stages<'_> {
    /// The light grid of media before it is filled, if the plan wants one.
    pub(crate) fn gathering(&self, kernel: &Kernel<'_>) -> Option<Gathering> {
        let settings = self.plan.settings();
        let fineness = settings.light_grid().filter(|_| kernel.media.is_some())?;
        Gathering::new(kernel, fineness, settings.seed)
    }

    /// Fills the light grid of media if the plan wants one, and says which samples were not finite.
    pub(crate) fn light_grid(&self, kernel: &Kernel<'_>) -> Result<(Option<LightGrid>, Gate), Error> {
        let Some(gathering) = self.gathering(kernel) else { return Ok((None, Gate::default())) };
        let paths = gathering.paths();
        let (grid, gate) =
            say::watch(self.style, "light in media", paths, self.monitor, self.interrupt, || {
                gathering.fill(kernel, self.monitor)
            })?;
        input::say_light_grid(&grid);
        Ok((Some(grid), gate))
    }

    /// What smoke scatters as lights beside those of fires, if the plan has it so, with the shadows of all.
    pub(crate) fn merge(&self, kernel: &Kernel<'_>) -> Result<Option<Merged>, Error> {
        let tracing = self.plan.tracing();
        let (Some(fires), Some(media), Some(grid)) = (&tracing.fires, &tracing.media, kernel.grid) else {
            return Ok(None);
        };
        if !fires.waits() {
            return Ok(None);
        }
        let Some(fires) = fires.with_scattered(media, &|p| kernel.mean_around(grid, p)) else {
            return Ok(None);
        };
        self.fill(&fires)?;
        Ok(Some(Merged { fires, media: media.without_scattering() }))
    }

    /// Fills the shadows of fires.
    pub(crate) fn fill(&self, fires: &Fires) -> Result<(), Error> {
        say::watch(self.style, "shadows of fire", 0, self.monitor, self.interrupt, || {
            fires.fill(&|| self.monitor.stopped());
            if self.monitor.stopped() { Err(Error::Interrupted) } else { Ok(()) }
        })
    }

    /// Gathers the irradiance cache if the plan wants it, and says which samples were not finite.
    pub(crate) fn cache(&self, kernel: &Kernel<'_>) -> Result<(Option<IrradianceCache>, Gate), Error> {
        if !self.plan.settings().caches() {
            return Ok((None, Gate::default()));
        }
        let cells = cells(self.plan, kernel);
        say::watch(self.style, "irradiance cache", cells.paths(), self.monitor, self.interrupt, || {
            cells.fill(kernel, self.monitor).map(|(cache, gate)| (Some(cache), gate))
        })
    }
}

/// Fires with what smoke scatters, and media that scatter nothing any more.
pub(crate) struct Merged {
    pub(crate) fires: Fires,
    media: Media,
}

impl Merged {
    /// A kernel for which light that smoke scatters comes from these lights, for surfaces and probes.
    pub(crate) fn kernel<'a>(merged: Option<&'a Self>, kernel: Kernel<'a>) -> Kernel<'a> {
        match merged {
            Some(m) => Kernel { media: Some(&m.media), fires: Some(&m.fires), grid: None, ..kernel },
            None => kernel,
        }
    }
}

/// How much a plan gathers in each texel.
pub(crate) fn effort(plan: &Plan, samples: u32, seed: u64) -> lightmap::Effort {
    lightmap::Effort { samples, small: samples, seed, texel_size: plan.atlas().texels_per_metre.recip() }
}

/// The places of the irradiance cache.
pub(crate) fn cells(plan: &Plan, kernel: &Kernel<'_>) -> Cells {
    let settings = plan.settings();
    let texel_size = plan.atlas().texels_per_metre.recip();
    Cells::find(kernel, &receivers(plan), texel_size, settings.samples, settings.seed)
}

/// The volumes of probes that a plan calls for.
pub(crate) fn wanted_probes(plan: &Plan, settings: Probes) -> Vec<Wanted> {
    let Probes { basis, about, spacing, samples } = settings;
    let places = match &plan.scene().probe_boxes {
        Some(boxes) => {
            boxes.iter().map(|b| Where::Box { min: b.min, max: b.max, spacing: b.spacing }).collect()
        }
        None => vec![spacing.map_or(Where::Scene { about }, Where::Spaced)],
    };
    let seed = plan.settings().seed;
    (0..).zip(places).map(|(number, place)| Wanted { place, basis, samples, seed, number }).collect()
}

fn receivers(plan: &Plan) -> Vec<Vertex> {
    let placed = |s: usize| plan.atlas().placements[s].is_some();
    pilot::receivers(&kernel(plan), placed, plan.settings().seed)
}

/// What a pilot learns of a plan's lights.
pub(crate) fn learn(plan: &Plan) -> Learnt {
    Learnt::new(&kernel(plan), &receivers(plan), plan.settings().seed)
}

/// The kernel that a plan calls for, before anything is learnt.
pub(crate) fn kernel(plan: &Plan) -> Kernel<'_> {
    Kernel::new(plan.scene(), plan.tracing(), plan.settings().bounces, plan.settings().media)
}
