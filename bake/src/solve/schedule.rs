//! Solves a page in rounds until what was asked for is reached.

use crate::error::Error;
use crate::geom::atlas::Atlas;
use crate::geom::texel::TexelMap;
use crate::plan::settings::Sampling;
use crate::solve::adaptive::{self, Goal};
use crate::solve::audit;
use crate::solve::facing::Facing;
use crate::solve::lightmap::{self, Effort, Solution};
use crate::solve::monitor::{ErrorSums, Monitor};
use crate::transport::Kernel;
use std::time::Instant;

/// Paths in the first round, from which variances are first known.
const FIRST: u32 = 8;

/// Fewest, where a time budget has no room for more: a single path has no variance.
const FEWEST: u32 = 2;

/// Texels that tell how long a first round will take; pages of fewer than eight times as many are not asked.
const TRIAL: usize = 1024;

/// Part of the remaining time that a first round may take.
const FIRST_PART: f64 = 0.8;

/// Fewest samples of suns and lamps in the first round where lamps light the air as well.
const FIRST_IN_AIR: u32 = 4;

/// Paths in the first round where their number is not given.
const LEARN: u32 = 16;

/// Samples of suns and lamps in the first round towards an error: a texel of which a tenth is lit shows nothing of it to 16 of
/// them in one case of five, to 32 in one of thirty.
const LEARN_SMALL: u32 = 32;

/// Rounds towards an error at most. Each may double the paths, so the limit on paths ends it before.
const ROUNDS: u32 = 64;

/// A round towards an error leaves at most this many times the paths before it: what is known of the
/// variance, and of how far stated errors hold, is not trusted further.
const GROWTH: f64 = 2.0;

/// An audit is too old when a page has so many times the samples of then.
const LATE: f64 = 1.5;

/// Rounds towards an error aim below it: what would then be measured scatters by a sixth where twenty texels make up most of it, and the figure that
/// ends sampling by a twelfth; what approximations of media are off by comes on top.
const AIM: f64 = 0.8;

/// Each of them lowers the error that is predicted to this part at most.
const STEP: f64 = 0.95;

/// Where noise is a smaller part of the error that was found, the rest is the irradiance cache's, which more paths do not lower.
const NOISE: f64 = 0.5;

/// Texels of each page from which the mean luminance of all is estimated.
const LOOKED_AT: usize = 4096;

/// Rounds of more seconds tell how many paths a second takes.
const LONG: f64 = 0.2;

/// Parts of the remaining time that the rounds of a time budget take.
const PARTS: [f64; 3] = [0.3, 0.6, 1.0];

/// A page and what is known before it is solved.
#[expect(missing_debug_implementations, reason = "a function has no text")]
pub struct Task<'a> {
    /// Everything a path needs.
    pub kernel: &'a Kernel<'a>,
    /// The same without its cache.
    pub unbiased: &'a Kernel<'a>,
    /// The layout.
    pub atlas: &'a Atlas,
    /// The texels.
    pub map: &'a TexelMap,
    /// Number of the page.
    pub page: usize,
    /// Seed and texel size; the number of samples is the schedule's.
    pub effort: Effort,
    /// Which sides of charts count.
    pub facing: &'a Facing,
    /// Mean luminance of all pages, nits, where there are several.
    pub luminance: Option<f64>,
    /// When sampling has to end, for [`Sampling::Budget`].
    pub deadline: Instant,
    /// The page's root mean squared standard error and mean luminance, nits, as the manifest will state them:
    /// what [`Sampling::Target`] is measured by.
    pub figure: &'a (dyn Fn(&TexelMap, &Solution) -> (f64, f64) + Sync),
}

impl Task<'_> {
    /// Solves the page.
    ///
    /// # Errors
    ///
    /// [`Error::Interrupted`] when the monitor asks to stop.
    pub fn solve(&self, sampling: &Sampling, monitor: &Monitor) -> Result<Solution, Error> {
        let mut solution = match sampling {
            Sampling::Target(relative) => return self.target(f64::from(*relative), monitor),
            Sampling::Exact(n) => self.first(*n, *n, monitor),
            Sampling::Mean(n) => {
                let n = *n as f32;
                // Half of the paths are spread evenly: the error figure weighs nits, eyes weigh ratios.
                self.rounds(&[(0.5 * n).max(FIRST as f32), 0.75 * n, n], monitor)
            }
            Sampling::Rounds(pages) => {
                let list = pages.get(self.page).or(pages.last());
                self.rounds(list.map_or(&[], Vec::as_slice), monitor)
            }
            Sampling::Budget(_) => self.budget(monitor),
        }?;
        self.audit(&mut solution, monitor)?;
        Ok(solution)
    }

    /// Finds out how far the stated errors can be trusted.
    fn audit(&self, solution: &mut Solution, monitor: &Monitor) -> Result<(), Error> {
        solution.audit =
            audit::audit(self.unbiased, self.map, self.page, self.effort.seed, &solution.texels, monitor)?;
        Ok(())
    }

    /// The same for an end that the error decides: squares are measured as well, and what was found before counts for half, because the first
    /// that is low by chance would end it.
    fn audit_whole(&self, solution: &mut Solution, monitor: &Monitor) -> Result<(), Error> {
        let before = solution.audit.as_ref().and_then(|a| a.squares);
        self.audit(solution, monitor)?;
        let which = (self.page, self.effort.seed, solution.curve.len() as u64);
        let stated = (&solution.texels[..], solution.audit.as_ref());
        let found = audit::squares(self.unbiased, self.map, which, stated, monitor)?;
        let squares = found.map(|f| before.map_or(f, |b| 0.5 * (b + f)));
        solution.audit.get_or_insert_default().squares = squares;
        Ok(())
    }

    fn first(&self, samples: u32, small: u32, monitor: &Monitor) -> Result<Solution, Error> {
        let effort = Effort { samples, small, ..self.effort };
        let (atlas, map) = (self.atlas, self.map);
        let mut solution =
            lightmap::bake_page(self.kernel, atlas, map, self.page, effort, self.facing, monitor)?;
        solution.curve.push((solution.spent(), adaptive::own_error(&solution)));
        Ok(solution)
    }

    fn rounds(&self, means: &[f32], monitor: &Monitor) -> Result<Solution, Error> {
        let n = self.map.texels.len() as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "paths are few")]
        let first = (means.first().copied().unwrap_or(0.0).round() as u32).max(FEWEST);
        let last = f64::from(means.last().copied().unwrap_or(0.0)).max(f64::from(first));
        expect(monitor, last * n);
        let mut solution = self.first(first, small(first, self.kernel.has_lamps_in_air()), monitor)?;
        solution.rounds = vec![first as f32];
        for &mean in means.iter().skip(1) {
            self.round(Goal::Mean(f64::from(mean)), &mut solution, monitor)?;
            solution.rounds.push(mean);
        }
        Ok(solution)
    }

    fn round(&self, goal: Goal, solution: &mut Solution, monitor: &Monitor) -> Result<f64, Error> {
        let round = adaptive::plan(self.map, solution, goal);
        if 0.0 < round.total {
            lightmap::refine_page(
                self.kernel,
                self.map,
                self.page,
                self.effort.seed,
                &round.more,
                solution,
                monitor,
            )?;
        }
        let (error, luminance) = adaptive::error(solution);
        solution.curve.push((solution.spent(), adaptive::own_error(solution)));
        let n = solution.texels.len() as f64;
        monitor.show_error(ErrorSums { squared_error: error * error * n, luminance: luminance * n, n });
        Ok(round.total)
    }

    /// Rounds until the page's figure is low enough; the last thing done is an audit.
    fn target(&self, relative: f64, monitor: &Monitor) -> Result<Solution, Error> {
        let n = self.map.texels.len() as f64;
        expect(monitor, n * f64::from(LEARN));
        let mut solution = self.first(LEARN, LEARN_SMALL, monitor)?;
        self.audit_whole(&mut solution, monitor)?;
        let mut audited = solution.spent();
        for _ in 0..ROUNDS {
            let (mut error, mean) = (self.figure)(self.map, &solution);
            let goal = AIM * relative * self.luminance.unwrap_or(mean);
            if LATE * audited < solution.spent() || (error <= goal && audited < solution.spent()) {
                // More samples may be better stratified, or the cache's part in the error greater.
                self.audit_whole(&mut solution, monitor)?;
                audited = solution.spent();
                (error, _) = (self.figure)(self.map, &solution);
            }
            if error <= goal {
                break;
            }
            if self.kernel.cache.is_some() && adaptive::own_error(&solution) < NOISE * error {
                let plain = Task { kernel: self.unbiased, ..*self };
                return Ok(Solution { uncached: true, ..plain.target(relative, monitor)? });
            }
            let spent = solution.spent();
            // Errors of well stratified samples fall faster than the root of their number, up to as its inverse: half of the
            // way, in proportions, does not overshoot even then.
            let way = (goal / error).sqrt().min(STEP);
            let aim = way * adaptive::predicted(self.map, &solution.texels);
            let wanted = adaptive::plan(self.map, &solution, Goal::Error(aim)).total;
            expect(monitor, spent + wanted);
            let growth = GROWTH * spent;
            let goal = if growth < spent + wanted { Goal::Mean(growth / n) } else { Goal::Error(aim) };
            if self.round(goal, &mut solution, monitor)? <= 0.0 {
                break;
            }
        }
        if audited < solution.spent() {
            self.audit_whole(&mut solution, monitor)?;
        }
        Ok(solution)
    }

    /// Paths of a first round that leaves something of the time: [`FIRST`] or fewer.
    fn affordable(&self, monitor: &Monitor) -> Result<u32, Error> {
        let n = self.map.texels.len();
        if n < 8 * TRIAL {
            return Ok(FIRST);
        }
        if monitor.stopped() {
            return Err(Error::Interrupted);
        }
        let few = Task { map: &self.map.thinned(TRIAL), ..*self };
        let seconds = |paths| {
            let begin = Instant::now();
            // Of its own: nothing of it is in the map.
            few.first(paths, small(paths, self.kernel.has_lamps_in_air()), &Monitor::default())?;
            Ok::<f64, Error>(begin.elapsed().as_secs_f64() * n as f64 / few.map.texels.len() as f64)
        };
        // The first to touch the scene waits for memory.
        seconds(FEWEST)?;
        let (least, most) = (seconds(FEWEST)?, seconds(FIRST)?);
        let left = self.deadline.saturating_duration_since(Instant::now()).as_secs_f64();
        let room = (FIRST_PART * left - least) / (most - least).max(1e-9);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and 6")]
        let more = (room.clamp(0.0, 1.0) * f64::from(FIRST - FEWEST)) as u32;
        Ok(FEWEST + more)
    }

    fn budget(&self, monitor: &Monitor) -> Result<Solution, Error> {
        let n = self.map.texels.len().max(1) as f64;
        let first = self.affordable(monitor)?;
        let begin = Instant::now();
        let mut solution = self.first(first, small(first, self.kernel.has_lamps_in_air()), monitor)?;
        solution.rounds = vec![first as f32];
        let mut sampling = begin.elapsed().as_secs_f64();
        let mut rate = solution.spent() / sampling.max(1e-6);
        for part in PARTS {
            let left = self.deadline.saturating_duration_since(Instant::now()).as_secs_f64();
            let spent = solution.spent();
            // The audit at the end repeats a part of all that was sampled.
            let again = audit::share(self.map.texels.len());
            let left = ((left - again * sampling) / (1.0 + again)).max(0.0);
            expect(monitor, spent + rate * left);
            // Quarters of a path keep the number short in the manifest, from which it can be replayed.
            #[expect(clippy::cast_possible_truncation, reason = "a number of paths")]
            let mean = (((spent + part * rate * left) / n * 4.0).floor() * 0.25) as f32;
            let mean = mean.max(solution.rounds.last().copied().unwrap_or(0.0));
            let start = Instant::now();
            let new = self.round(Goal::Mean(f64::from(mean)), &mut solution, monitor)?;
            let seconds = start.elapsed().as_secs_f64();
            if LONG < seconds && 0.0 < new {
                // The first round also looks around from every texel, which no other does.
                rate = new / seconds;
            }
            sampling += seconds;
            solution.rounds.push(mean);
        }
        Ok(solution)
    }
}

/// Mean luminance over all pages, nits, from a few texels of each: what an error of several pages together
/// is measured by. A single page knows its own better and needs none.
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn mean_luminance(
    kernel: &Kernel<'_>,
    atlas: &Atlas,
    effort: Effort,
    monitor: &Monitor,
) -> Result<Option<f64>, Error> {
    if atlas.pages.len() < 2 {
        return Ok(None);
    }
    let effort = Effort { samples: LEARN, small: LEARN, ..effort };
    let (mut sum, mut n) = (0.0, 0.0);
    for page in 0..atlas.pages.len() {
        let map = TexelMap::build(kernel.scene, atlas, page);
        let few = map.thinned(LOOKED_AT);
        let solution = lightmap::bake_page(kernel, atlas, &few, page, effort, &Facing::default(), monitor)?;
        let weight = map.texels.len() as f64;
        sum += adaptive::error(&solution).1 * weight;
        n += weight;
    }
    Ok(Some(sum / f64::max(n, 1.0)))
}

/// Samples of suns and lamps in a first round beside so many paths. Most texels see all of a light or nothing of it, and
/// what the others need is known from few. Where lamps light the air as well, a sample takes twice the time, and fewer count as a path's share of it.
fn small(paths: u32, in_air: bool) -> u32 {
    if in_air { (paths / 6).max(FIRST_IN_AIR) } else { (paths / 2).max(FIRST) }
}

/// Tells whoever waits how many paths the page will have.
fn expect(monitor: &Monitor, paths: f64) {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of paths")]
    monitor.expect(paths.max(0.0) as u64);
}
