//! What accuracy costs in time: every knob of a bake turned on one scene, and its error against a converged reference measured.
//!
//! Bakes are made through the program's own command line, in processes of their own, so that what is measured is what a
//! user gets. [`run`] gives a [`Report`], which [`report`] writes as CSV, plots and one page.

pub mod figures;
pub mod knobs;
pub mod places;
pub mod plots;
pub mod report;
pub mod sentences;
pub mod shots;

use crate::error::{Error, Result};
use crate::plan::{Plan, Quality};
use crate::transport::Kernel;
use figures::{Errors, Reference, Row, Standing, mark_front};
use knobs::{Knob, Measure, Setting};
use places::Places;
use shots::{Cost, Studio};
use std::collections::BTreeMap;
use std::path::PathBuf;
use tables::table::build::{PRESETS, build};

/// How thorough a study is.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Paths per texel of each of the two references.
    pub reference_samples: u32,
    /// Bakes of each setting, each with another seed; at least 2, to tell noise from bias.
    pub seeds: u32,
    /// Names of the knobs to turn; all if empty.
    pub only: Vec<String>,
}

/// Seeds of the references, which no setting has.
const REFERENCES: [u64; 2] = [1_000_001, 1_000_002];

/// Paths per texel of the finest setting of a knob whose settings are compared with that.
const FINEST: u32 = 512;

/// Paths of each of the two references at a point.
const AT_POINTS: u32 = 2048;

/// A knob with what was measured of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Turned {
    /// The knob.
    pub knob: Knob,
    /// Its settings, in the knob's order; none if the knob has nothing to turn.
    pub rows: Vec<Row>,
}

/// Result of a study.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Name of the scene.
    pub scene: String,
    /// Texels that were compared.
    pub texels: usize,
    /// Texels per metre.
    pub texels_per_metre: f32,
    /// How many times as many texels the seconds are for.
    pub times: f64,
    /// How thorough it was.
    pub options: Options,
    /// What the references themselves are off by, as a part of the mean.
    pub reference_noise: f64,
    /// The presets at the study's density.
    pub presets: Vec<Row>,
    /// Each of them against everything else.
    pub standings: Vec<Standing>,
    /// Every knob that was to be turned.
    pub knobs: Vec<Turned>,
    /// Names of all knobs that there are.
    pub names: Vec<&'static str>,
}

/// What a study needs to know.
pub struct Subject<'a> {
    /// Name of the scene.
    pub name: String,
    /// A plan of the scene at the study's density and medium quality.
    pub plan: &'a Plan,
    /// A plan at another density, texels per metre, as a bake with it makes for itself.
    pub at_density: &'a dyn Fn(f32) -> Result<Plan>,
    /// How many times the study's texels the scene has at its own density: seconds are those of a bake there.
    pub times: f64,
    /// Makes the bakes.
    pub studio: &'a Studio<'a>,
    /// Hears what is done next, and which part of the study is done.
    pub say: &'a dyn Fn(&str, f64),
}

impl std::fmt::Debug for Subject<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Subject").field("name", &self.name).finish_non_exhaustive()
    }
}

/// What is known while a study goes on.
struct Study<'a> {
    subject: &'a Subject<'a>,
    options: &'a Options,
    /// Bakes of seeds by options, so that what several knobs share is made once.
    made: BTreeMap<Vec<String>, (Errors, Cost, Option<f64>)>,
    /// Files of tables by name.
    tables: BTreeMap<String, PathBuf>,
    done: f64,
    all: f64,
}

/// Turns every knob.
///
/// # Errors
///
/// [`Error::Usage`] where a bake fails or a knob is not known, [`Error::Interrupted`], [`Error::Io`].
pub fn run(subject: &Subject<'_>, options: &Options) -> Result<Report> {
    let all = knobs::all(subject.plan);
    let names: Vec<&'static str> = all.iter().map(|k| k.name).collect();
    let knobs = wanted(all, &options.only)?;
    let bakes: usize = knobs.iter().filter(|k| k.idle.is_none()).map(|k| k.settings.len()).sum();
    let mut study = Study {
        subject,
        options,
        made: BTreeMap::new(),
        tables: BTreeMap::new(),
        done: 0.0,
        // References take longer than anything else; a guess is enough for a progress line.
        all: (bakes + Quality::ALL.len()) as f64 + REFERENCE_SHARE,
    };
    let truth = study.reference(&study.truth())?;
    study.done += REFERENCE_SHARE;
    let presets = study.presets(&truth)?;
    let plain =
        Kernel::new(subject.plan.scene(), subject.plan.tracing(), None, crate::plan::MediaMode::Reference);
    let mut places = None;
    let mut turned = Vec::new();
    for knob in knobs {
        let rows = match (&knob.idle, knob.measure) {
            (Some(_), _) => Ok(Vec::new()),
            (None, Measure::Texels) => study.texels(&knob, &truth),
            (None, Measure::AgainstFinest) => study.against_finest(&knob),
            (None, Measure::Fetches | Measure::Probes) => {
                let places = places.get_or_insert_with(|| Places::new(subject.plan, &plain));
                study.at_places(&knob, places)
            }
        };
        // One knob that cannot be turned must not cost what is known of the others.
        turned.push(match rows {
            Ok(rows) => Turned { knob, rows },
            Err(Error::Interrupted) => return Err(Error::Interrupted),
            Err(e) => {
                Turned { knob: Knob { idle: Some(format!("it failed: {e}")), ..knob }, rows: Vec::new() }
            }
        });
    }
    let mut rows: Vec<Row> = presets.iter().chain(turned.iter().flat_map(|t| &t.rows)).cloned().collect();
    mark_front(&mut rows);
    let standings = presets.iter().map(|p| Standing::of(p, &rows)).collect();
    let mut marked = rows.into_iter();
    let presets = marked.by_ref().take(presets.len()).collect();
    for knob in &mut turned {
        knob.rows = marked.by_ref().take(knob.rows.len()).collect();
    }
    Ok(Report {
        scene: subject.name.clone(),
        texels: truth.len(),
        texels_per_metre: subject.plan.atlas().texels_per_metre,
        times: subject.times,
        options: options.clone(),
        reference_noise: truth.noise(),
        presets,
        standings,
        knobs: turned,
        names,
    })
}

/// What references count as, in bakes.
const REFERENCE_SHARE: f64 = 40.0;

fn wanted(knobs: Vec<Knob>, only: &[String]) -> Result<Vec<Knob>> {
    if only.is_empty() {
        return Ok(knobs);
    }
    let mut names: Vec<&str> = Vec::new();
    for knob in &knobs {
        if !names.contains(&knob.name) {
            names.push(knob.name);
        }
    }
    if let Some(odd) = only.iter().find(|o| !names.contains(&o.trim())) {
        return Err(Error::Usage(format!("--knobs {odd}: there are {}", names.join(", "))));
    }
    Ok(knobs.into_iter().filter(|k| only.iter().any(|o| o.trim() == k.name)).collect())
}

impl Study<'_> {
    /// Options of bakes that are as right as bakes can be: paths that scatter, and no cache.
    fn truth(&self) -> Vec<String> {
        let samples = self.options.reference_samples.to_string();
        let paths = ["--media", "reference", "--irradiance-cache", "off", "--samples", &samples];
        [&paths[..], &["--probes", "off", "--seams", "off"]].concat().into_iter().map(str::to_owned).collect()
    }

    fn density(&self) -> Vec<String> {
        vec!["--texels-per-metre".to_owned(), self.subject.plan.atlas().texels_per_metre.to_string()]
    }

    fn say(&self, what: &str) {
        (self.subject.say)(what, self.done / self.all);
    }

    fn reference(&self, args: &[String]) -> Result<Reference> {
        let args = [args, &self.density()].concat();
        self.say(&format!("reference: {}", args.join(" ")));
        let first = self.subject.studio.shoot(&args, REFERENCES[0])?;
        let second = self.subject.studio.shoot(&args, REFERENCES[1])?;
        let (first, second) = (first.values, second.values);
        if first.luminance.is_empty() || first.luminance.len() != second.luminance.len() {
            return Err(Error::Usage("the reference has no texels".to_owned()));
        }
        let found = Reference::new(first, second);
        if found.mean() <= 0.0 {
            return Err(Error::Usage(
                "the scene is black: there is no error to measure; add a light or --sky".to_owned(),
            ));
        }
        Ok(found)
    }

    fn presets(&mut self, truth: &Reference) -> Result<Vec<Row>> {
        let mut rows = Vec::new();
        for quality in Quality::ALL {
            let base = (quality.name().to_owned(), knobs::plain(quality));
            let setting = Setting { label: quality.name().to_owned(), args: Vec::new(), usual: true };
            rows.push(self.row("preset", &base, &setting, truth, true)?);
        }
        Ok(rows)
    }

    fn texels(&mut self, knob: &Knob, truth: &Reference) -> Result<Vec<Row>> {
        knob.settings.iter().map(|s| self.row(knob.name, &knob.base, s, truth, true)).collect()
    }

    fn against_finest(&mut self, knob: &Knob) -> Result<Vec<Row>> {
        let Some(finest) = knob.settings.last() else { return Ok(Vec::new()) };
        let rounds = ["--rounds".to_owned(), knobs::rounds(FINEST)];
        let args = [&knob.base.1[..], &self.args(finest)?, &rounds].concat();
        let best = self.reference(&args)?;
        // Bakes of this knob are made with the same options elsewhere, but judged by something else.
        let made = std::mem::take(&mut self.made);
        let rows = knob.settings.iter().map(|s| self.row(knob.name, &knob.base, s, &best, false)).collect();
        self.made = made;
        rows
    }

    /// Options of a setting, with files of tables in the place of their names.
    fn args(&mut self, setting: &Setting) -> Result<Vec<String>> {
        let mut args = setting.args.clone();
        if let [option, name] = &mut args[..]
            && option == "--tables"
        {
            *name = self.table(name)?.display().to_string();
        }
        Ok(args)
    }

    fn table(&mut self, name: &str) -> Result<PathBuf> {
        if let Some(path) = self.tables.get(name) {
            return Ok(path.clone());
        }
        let preset = PRESETS.iter().find(|p| p.name == name);
        let preset = preset.ok_or_else(|| Error::Usage(format!("no tables are called {name}")))?;
        self.say(&format!("building tables: {name}"));
        let path = self.subject.studio.path(&format!("{name}.zht"));
        let bytes = tables::table::file::write(preset.name, &build(preset, &|_| {}));
        std::fs::write(&path, bytes).map_err(Error::io(&path, "cannot write"))?;
        self.tables.insert(name.to_owned(), path.clone());
        Ok(path)
    }

    fn row(
        &mut self,
        knob: &str,
        base: &(String, Vec<String>),
        setting: &Setting,
        truth: &Reference,
        competes: bool,
    ) -> Result<Row> {
        // What a base has anyway is not said again, so that such bakes are made once.
        let own = if setting.usual { Vec::new() } else { self.args(setting)? };
        let args = [&base.1[..], &own, &self.density()].concat();
        let key = normal(&args);
        let known = self.made.get(&key).copied();
        let (errors, cost, stated) = match known {
            Some(known) => known,
            None => {
                self.say(&format!("{knob} {} ({})", setting.label, base.0));
                let seeds = 1..=u64::from(self.options.seeds.max(2));
                let shots: Vec<shots::Shot> =
                    seeds.map(|s| self.subject.studio.shoot(&args, s)).collect::<Result<_>>()?;
                if shots.iter().any(|s| s.values.luminance.len() != truth.len()) {
                    return Err(Error::Usage(format!(
                        "{knob} {}: other texels than the reference's",
                        setting.label
                    )));
                }
                let values: Vec<&[f64]> = shots.iter().map(|s| s.values.luminance.as_slice()).collect();
                let times = self.subject.times;
                let costs: Vec<Cost> = shots.iter().map(|s| s.cost.with_texels(times)).collect();
                let stated: Option<f64> = shots.iter().map(|s| s.stated).sum();
                let new = (truth.errors(&values), Cost::mean(&costs), stated.map(|s| s / shots.len() as f64));
                self.made.insert(key, new);
                new
            }
        };
        self.done += 1.0;
        Ok(self.row_of(knob, base, setting, (cost, errors, stated), competes))
    }

    /// Errors at points: fetches from lightmaps of other densities, or light probes.
    fn at_places(&mut self, knob: &Knob, places: &Places) -> Result<Vec<Row>> {
        let subject = self.subject;
        let studio = subject.studio;
        let probes = knob.measure == Measure::Probes;
        let samples = AT_POINTS.to_string();
        let truth: Vec<String> = ["--media", "reference", "--samples", &samples].map(str::to_owned).to_vec();
        self.say(&format!("{}: the truth at points", knob.name));
        let at = |seed| {
            if probes {
                places.in_the_air(studio, &truth, seed)
            } else {
                places.on_surfaces(studio, &truth, seed)
            }
        };
        let truth = Reference::new(at(REFERENCES[0])?, at(REFERENCES[1])?);
        let truth = if knob.measure == Measure::Probes { truth.in_proportion() } else { truth };
        if truth.is_empty() || truth.mean() <= 0.0 {
            return Err(Error::Usage("no place is lit at which bakes could be compared".to_owned()));
        }
        let mut rows = Vec::new();
        for setting in &knob.settings {
            self.say(&format!("{} {}", knob.name, setting.label));
            let mut args = [&knob.base.1[..], &setting.args].concat();
            let plan = match (&setting.args[..], probes) {
                ([_, density], false) => Some((subject.at_density)(density.parse().unwrap_or(1.0))?),
                _ => None,
            };
            if plan.is_none() {
                args.extend(self.density());
            }
            let (mut values, mut costs) = (Vec::new(), Vec::new());
            for seed in 1..=u64::from(self.options.seeds.max(2)) {
                let (found, cost) = studio.bake(&args, seed, |dir, manifest| match &plan {
                    Some(plan) => places.fetched(plan, dir, manifest),
                    None => places.from_probes(dir),
                })?;
                values.push(found);
                let cost = if probes { Cost { fixed: cost.probes, sampling: 0.0, ..cost } } else { cost };
                costs.push(cost);
            }
            let values: Vec<&[f64]> = values.iter().map(Vec::as_slice).collect();
            self.done += 1.0;
            // Beyond the lattice there is nothing to compare.
            let truth = truth.only(|i| values.iter().all(|v| v[i].is_finite()));
            let found = (Cost::mean(&costs), truth.errors(&values), None);
            rows.push(self.row_of(knob.name, &knob.base, setting, found, false));
        }
        Ok(rows)
    }
}

impl Study<'_> {
    fn row_of(
        &self,
        knob: &str,
        base: &(String, Vec<String>),
        setting: &Setting,
        (cost, errors, stated): (Cost, Errors, Option<f64>),
        competes: bool,
    ) -> Row {
        let mut args = [&base.1[..], &setting.args].concat();
        if !args.iter().any(|a| a == "--texels-per-metre") {
            args.extend(self.density());
        }
        let denoised = knobs::is_denoised(&args);
        Row {
            knob: knob.to_owned(),
            base: base.0.clone(),
            setting: setting.label.clone(),
            args: args.join(" "),
            usual: setting.usual,
            cost,
            errors,
            stated,
            denoised,
            competes,
            front: false,
        }
    }
}

/// Options without those that are named twice: the last one counts. So that equal bakes are known as such.
fn normal(args: &[String]) -> Vec<String> {
    let mut pairs = BTreeMap::new();
    for pair in args.chunks(2) {
        pairs.insert(pair[0].clone(), pair.get(1).cloned().unwrap_or_default());
    }
    pairs.into_iter().flat_map(|(a, b)| [a, b]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_bakes_are_known_by_their_options() {
        let args = |list: &[&str]| normal(&list.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>());
        assert_eq!(args(&["--a", "1", "--b", "2"]), args(&["--b", "2", "--a", "1"]));
        assert_ne!(args(&["--a", "1"]), args(&["--a", "2"]));
    }
}
