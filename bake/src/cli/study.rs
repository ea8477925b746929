//! `bake study`.

#![expect(clippy::print_stdout, reason = "the verdict is the command's result")]

use crate::cli::args::StudyArgs;
use crate::cli::input;
use crate::cli::say::{self, Interrupt, Style};
use crate::cli::stopwatch;
use crate::error::{Error, Finding};
use crate::geom::texel::TexelMap;
use crate::plan::{self, Plan};
use crate::scene::config::RunConfig;
use crate::study::report::{self, Made};
use crate::study::shots::Studio;
use crate::study::{self, Options, Subject, sentences};
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

pub(crate) fn run(args: &StudyArgs, interrupt: &Interrupt) -> Result<ExitCode, Error> {
    let begin = Instant::now();
    let input = input::load(&args.scene)?;
    say::findings(&input.findings, false);
    plan::admit(&input.findings)?;
    let name = input.document.name().to_owned();
    let folder = args.output.clone().unwrap_or_else(|| PathBuf::from(format!("{name}.study")));
    admit(&input.run)?;
    report::prepare(&folder)?;
    let style = Style::new(args.work.progress);
    let stopped = || interrupt.raised();
    let program = std::env::current_exe().map_err(Error::io("bake", "cannot find this program"))?;
    let mut studio = Studio::new(program, Vec::new(), args.work.threads, &stopped)?;
    studio.scene = scene_words(args, &studio)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.work.threads.unwrap_or(0) as usize)
        .build()
        .map_err(|e| Error::Usage(format!("cannot start the threads: {e}")))?;
    let done = pool.install(|| {
        let at_density = |density: Option<f32>| plan_at(args, density, interrupt);
        let plan = at_density(None)?;
        let covered = |plan: &Plan| -> usize {
            let pages = 0..plan.atlas().pages.len();
            pages.map(|page| TexelMap::build(plan.scene(), plan.atlas(), page).texels.len()).sum()
        };
        let own = covered(&plan).max(1) as f64;
        #[expect(clippy::cast_possible_truncation, reason = "a density")]
        let density =
            (f64::from(plan.atlas().texels_per_metre) * (f64::from(args.texels) / own).sqrt()) as f32;
        let plan = at_density(Some(density))?;
        let times = own / covered(&plan).max(1) as f64;
        let options = Options {
            reference_samples: args.reference_samples,
            seeds: args.seeds,
            only: args.knobs.clone(),
        };
        let say = |what: &str, part: f64| {
            let spent = begin.elapsed().as_secs_f64();
            let left = if 0.0 < part {
                format!(", about {} left", say::duration(spent * (1.0 / part - 1.0)))
            } else {
                String::new()
            };
            style.stage("study", &format!("{:.0} %{left}: {what}", 100.0 * part.min(1.0)));
        };
        let at_density = |density| at_density(Some(density));
        let subject =
            Subject { name, plan: &plan, at_density: &at_density, times, studio: &studio, say: &say };
        let found = study::run(&subject, &options)?;
        let made = Made {
            cpu: stopwatch::cpu_model(),
            threads: rayon::current_num_threads(),
            date: today(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        report::write(&found, &made, &folder)?;
        for standing in &found.standings {
            println!("{}", sentences::standing(standing));
        }
        for turned in &found.knobs {
            println!("{} ({}): {}", turned.knob.name, turned.knob.base.0, sentences::about(turned));
        }
        style.stage(
            "done",
            &format!(
                "{} ({})",
                folder.join("study.html").display(),
                say::duration(begin.elapsed().as_secs_f64())
            ),
        );
        Ok(ExitCode::from(u8::from(!found.standings.iter().all(study::figures::Standing::holds))))
    });
    if done.is_err() {
        report::abandon(&folder);
    }
    done
}

/// What a configuration says about runs would turn the knobs of every bake, references included.
fn admit(run: &RunConfig) -> Result<(), Error> {
    let allowed = RunConfig {
        sky: run.sky.clone(),
        light_units: run.light_units.clone(),
        texels_per_metre: run.texels_per_metre,
        ..RunConfig::default()
    };
    if *run == allowed {
        return Ok(());
    }
    let what = "says how to bake, which a study turns by itself";
    Err(Finding::error("run", what, "leave nothing in `[run]` but sky, light_units and texels_per_metre")
        .into())
}

/// A plan at a density, of medium quality.
fn plan_at(args: &StudyArgs, density: Option<f32>, interrupt: &Interrupt) -> Result<Plan, Error> {
    let input = input::load(&args.scene)?;
    let mut settings = input::settings(&args.settings(), &input.run, (&input.scene, &input.document))?;
    settings.texels_per_metre = density.or(settings.texels_per_metre);
    plan::make(input.scene, input.findings, settings, &|_, _| !interrupt.raised())
}

/// The scene and what decides how it is read, as words of a command line. The embedded scene becomes a file.
fn scene_words(args: &StudyArgs, studio: &Studio<'_>) -> Result<Vec<OsString>, Error> {
    let scene = match &args.scene.scene {
        Some(path) => path.clone(),
        None => {
            let path = studio.path("hall.glb");
            std::fs::write(&path, input::HALL).map_err(Error::io(&path, "cannot write"))?;
            path
        }
    };
    let mut words = vec![scene.into_os_string()];
    if let Some(config) = &args.scene.config {
        words.extend(["--config".into(), config.clone().into_os_string()]);
    }
    if let Some(sky) = &args.scene.sky {
        words.extend(["--sky".into(), sky.into()]);
    }
    if let Some(units) = args.scene.light_units.and_then(|u| clap::ValueEnum::to_possible_value(&u)) {
        words.extend(["--light-units".into(), units.get_name().to_owned().into()]);
    }
    Ok(words)
}

/// The day by the clock, UTC.
fn today() -> String {
    humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string()[..10].to_owned()
}
