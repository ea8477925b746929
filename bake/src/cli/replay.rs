//! One sample of a bake again, alone: what to look at where a sample was not finite.

#![expect(clippy::print_stdout, reason = "what the sample brought is the result")]

use crate::cli::prepare::{Merged, Stages, cells, effort, kernel, learn, wanted_probes};
use crate::cli::say;
use crate::error::{Error, Finding};
use crate::geom::texel::TexelMap;
use crate::solve::accumulate::{Kind, Rejected};
use crate::solve::facing::facing;
use crate::solve::probes::Probing;
use crate::solve::replay::{self, Replayed};
use crate::transport::Kernel;
use glam::Vec3;
use std::process::ExitCode;

/// Does everything that a bake does before sampling, takes this sample alone, and prints it.
///
/// # Errors
///
/// [`Error::Usage`] if the bake has no such sample.
pub(crate) fn run(stages: Stages<'_>, at: Rejected) -> Result<ExitCode, Error> {
    let Stages { plan, monitor, .. } = stages;
    let settings = plan.settings();
    let learnt = learn(plan);
    let kernel = learnt.guide(kernel(plan));
    let nothing = |what: String| Err(Error::Usage(format!("--replay {at}: {what}")));
    if at.kind == Kind::Node {
        let kernel = learnt.guide_texels(kernel);
        let found = stages.gathering(&kernel).and_then(|g| g.replay(&kernel, at.texel, at.sample));
        return match found {
            Some(found) => Ok(print(at, Some(&found), None)),
            None => nothing("the light grid has no such path".to_owned()),
        };
    }
    let (grid, _) = stages.light_grid(&learnt.guide_texels(kernel))?;
    let in_air = Kernel { grid: grid.as_ref(), ..kernel };
    let merged = stages.merge(&in_air)?;
    let kernel = Merged::kernel(merged.as_ref(), in_air);
    if at.kind == Kind::Cell {
        let cells = settings.caches().then(|| cells(plan, &kernel));
        let found = match cells {
            Some(cells) => cells.replay(&kernel, (at.page, at.texel, at.sample), monitor)?,
            None => None,
        };
        return match found {
            Some(found) => Ok(print(at, Some(&found), None)),
            None => nothing("the irradiance cache has no such path".to_owned()),
        };
    }
    let (cache, _) = stages.cache(&kernel)?;
    let unbiased = kernel;
    let kernel = Kernel { cache: cache.as_ref(), emitters_apart: true, ..learnt.guide_texels(kernel) };
    let found = match at.kind {
        Kind::Point => return nothing("samples of points belong to `bake points`".to_owned()),
        Kind::Probe => {
            let mut volumes = settings.probes.into_iter().flat_map(|p| wanted_probes(plan, p));
            let Some(wanted) = volumes.nth(at.page) else {
                return nothing(format!("there is no volume {} of probes", at.page));
            };
            let probing = Probing::new(&kernel, wanted, monitor)?;
            match probing.and_then(|p| p.replay(&kernel, at.texel, at.sample)) {
                Some(found) => Some(found),
                None => return nothing(format!("nothing is gathered at a probe {}", at.texel)),
            }
        }
        _ => {
            let atlas = plan.atlas();
            if atlas.pages.len() <= at.page {
                return nothing(format!("there are {} pages", atlas.pages.len()));
            }
            let directions = match (at.kind, settings.directional) {
                (Kind::Direction, None) => return nothing("--directional is not asked for".to_owned()),
                (_, n) => n.unwrap_or(0),
            };
            let map = TexelMap::build(plan.scene(), atlas, at.page);
            let effort = effort(plan, settings.samples, settings.seed);
            let facing = facing(&unbiased, atlas, &map, at.page, effort, monitor);
            replay::of_texel(&kernel, atlas, &map, effort, &facing, directions, at)?
        }
    };
    stages.interrupt.check()?;
    let surface = found.as_ref().and_then(|f| f.surface).map(|s| plan.scene().surfaces[s].path.as_str());
    Ok(print(at, found.as_ref(), surface))
}

/// Prints a sample as lines of a word and its value; numbers can be read back to the bit.
pub(crate) fn print(at: Rejected, found: Option<&Replayed>, surface: Option<&str>) -> ExitCode {
    println!("sample: {at}");
    let Some(found) = found else {
        println!("start: on a hidden part of the texel, where no sample is taken");
        return ExitCode::SUCCESS;
    };
    if let Some(surface) = surface {
        println!("node: {surface}");
    }
    println!("position: {} m", vector(found.position));
    if found.normal != Vec3::ZERO {
        println!("normal: {}", vector(found.normal));
    }
    if matches!(at.kind, Kind::Probe | Kind::Direction | Kind::Node) {
        for (direction, light) in &found.around {
            println!("from {}: {}", vector(*direction), vector(*light));
        }
    } else {
        println!("direct: {} nits", vector(found.direct));
        println!("indirect: {} nits", vector(found.indirect));
    }
    println!("rays: {}", found.rays);
    let finite = found.is_admissible();
    println!("finite: {}", if finite { "yes" } else { "no" });
    if finite {
        return ExitCode::SUCCESS;
    }
    say::line(&format!("error: sample {at} is not finite or beyond 1e35"));
    ExitCode::from(2)
}

/// Three numbers with as many digits as it takes to tell them from all others.
fn vector(v: Vec3) -> String {
    format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z)
}

/// Says that a sample was rejected, and how to see it again.
pub(crate) fn rejection(first: Rejected, what: &str, fix: &str) -> Finding {
    let Rejected { page, texel, sample, .. } = first;
    let (path, kind) = match first.kind {
        Kind::Small => (format!("page {page} texel {texel}"), "of suns and lamps"),
        Kind::Path => (format!("page {page} texel {texel}"), "of paths"),
        Kind::Direction => (format!("page {page} texel {texel}"), "of directions"),
        Kind::Node => (format!("light grid node {texel}"), "of paths"),
        Kind::Cell => (format!("irradiance cache pass {page} cell {texel}"), "of paths"),
        Kind::Probe => (format!("probes {page} probe {texel}"), "of paths"),
        Kind::Point => (format!("points[{texel}]"), "of paths"),
    };
    let fix = format!("{fix}; this shows the sample again:\n  {}", command(first));
    Finding::error(path, format!("sample {sample} {kind} {what}"), fix)
}

/// This command, with what makes it replay one sample.
fn command(at: Rejected) -> String {
    let given = std::env::args_os().map(|a| a.to_string_lossy().into_owned());
    let words: Vec<String> = given.chain(["--replay".to_owned(), at.to_string()]).collect();
    // Arguments hold no zero bytes, the only thing that cannot be quoted.
    shlex::try_join(words.iter().map(String::as_str)).unwrap_or_else(|_| words.join(" "))
}
