//! Bakes made as a user makes them, by the program's own command line, and what they took.

use crate::error::{Error, Result};
use crate::output::{exr, folder};
use std::ffi::OsString;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use tables::format::manifest::{Manifest, Timings};
use tempfile::TempDir;

/// Stages whose time a knob can change; loading, unwrapping and writing are left out.
const WORK: [&str; 10] =
    ["pilot", "fire", "light grid", "cache", "probes", "facing", "sample", "directions", "denoise", "stitch"];

/// Stages that take longer the more texels there are.
const OF_TEXELS: [&str; 5] = ["facing", "sample", "directions", "denoise", "stitch"];

/// How often a running bake is looked at.
const POLL: Duration = Duration::from_millis(10);

/// What a bake took, processor seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Of what texels do not change: pilot, light grid, cache, probes.
    pub fixed: f64,
    /// Of texels: sampling, denoising, seams.
    pub sampling: f64,
    /// Of light probes alone; part of `fixed`.
    pub probes: f64,
    /// The whole command by the clock.
    pub wall: f64,
}

impl Cost {
    /// All that is counted.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.fixed + self.sampling
    }

    fn of(timings: &Timings) -> Self {
        let mut cost = Self { wall: timings.wall_seconds, ..Self::default() };
        for stage in timings.stages.iter().filter(|s| WORK.contains(&s.name.as_str())) {
            match stage.name.as_str() {
                name if OF_TEXELS.contains(&name) => cost.sampling += stage.cpu_seconds,
                name => {
                    cost.fixed += stage.cpu_seconds;
                    cost.probes += if name == "probes" { stage.cpu_seconds } else { 0.0 };
                }
            }
        }
        cost
    }

    /// With so many times the texels.
    #[must_use]
    pub fn with_texels(self, times: f64) -> Self {
        Self { sampling: self.sampling * times, ..self }
    }

    /// The mean of several.
    #[must_use]
    pub fn mean(list: &[Self]) -> Self {
        let of = |f: fn(&Self) -> f64| list.iter().map(f).sum::<f64>() / list.len().max(1) as f64;
        Self {
            fixed: of(|c| c.fixed),
            sampling: of(|c| c.sampling),
            probes: of(|c| c.probes),
            wall: of(|c| c.wall),
        }
    }
}

/// Luminance somewhere.
#[derive(Clone, Debug, Default)]
pub struct Values {
    /// Luminance, nits: of covered texels of all pages, or at points.
    pub luminance: Vec<f64>,
    /// Its stated standard error, nits.
    pub std_err: Vec<f64>,
}

/// A finished bake.
#[derive(Debug)]
pub struct Shot {
    /// Its texels.
    pub values: Values,
    /// What it took.
    pub cost: Cost,
    /// Relative error that the manifest states; after denoising where that was done.
    pub stated: Option<f64>,
}

/// Makes bakes of one scene, one after the other, in a temporary folder.
pub struct Studio<'a> {
    /// The program that bakes.
    pub program: PathBuf,
    /// Scene and what decides how it is read, as on the command line.
    pub scene: Vec<OsString>,
    /// Threads, if they are to be fewer than all.
    pub threads: Option<u32>,
    /// Whether somebody asked to stop.
    pub stopped: &'a (dyn Fn() -> bool + Sync),
    place: TempDir,
}

impl std::fmt::Debug for Studio<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Studio").field("program", &self.program).field("scene", &self.scene).finish()
    }
}

impl<'a> Studio<'a> {
    /// # Errors
    ///
    /// [`Error::Io`] where no temporary folder can be made.
    pub fn new(
        program: PathBuf,
        scene: Vec<OsString>,
        threads: Option<u32>,
        stopped: &'a (dyn Fn() -> bool + Sync),
    ) -> Result<Self> {
        let place = tempfile::tempdir()
            .map_err(Error::io(std::env::temp_dir(), "cannot make a temporary folder in"))?;
        Ok(Self { program, scene, threads, stopped, place })
    }

    /// A place for a file that bakes read.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.place.path().join(name)
    }

    /// Bakes, and gives what `read` finds in the folder.
    ///
    /// # Errors
    ///
    /// [`Error::Usage`] with the last words of a bake that failed, [`Error::Interrupted`], or what `read` says.
    pub fn bake<T>(
        &self,
        args: &[String],
        seed: u64,
        read: impl FnOnce(&Path, &Manifest) -> Result<T>,
    ) -> Result<(T, Cost)> {
        let out = self.place.path().join("bake");
        let mut all: Vec<OsString> = vec!["-o".into(), out.clone().into()];
        all.extend(["--progress", "none", "--texture", "none", "--seed"].map(OsString::from));
        all.push(seed.to_string().into());
        all.extend(args.iter().map(OsString::from));
        self.call("run", &all, None)?;
        let manifest = folder::read_manifest(&out)?;
        let path = out.join("timings.json");
        let text = fs::read_to_string(&path).map_err(Error::io(&path, "cannot read"))?;
        let timings: Timings =
            serde_json::from_str(&text).map_err(|e| Error::Usage(format!("{}: {e}", path.display())))?;
        Ok((read(&out, &manifest)?, Cost::of(&timings)))
    }

    /// Irradiance at points, lux, as `bake points` gives it: the text of its answer.
    ///
    /// # Errors
    ///
    /// As [`Studio::bake`].
    pub fn points(&self, points: &str, args: &[String], seed: u64) -> Result<String> {
        let (asked, answer) = (self.place.path().join("points.json"), self.place.path().join("answer.json"));
        fs::write(&asked, points).map_err(Error::io(&asked, "cannot write"))?;
        let mut all: Vec<OsString> = vec![asked.into(), "--progress".into(), "none".into(), "--seed".into()];
        all.push(seed.to_string().into());
        all.extend(args.iter().map(OsString::from));
        self.call("points", &all, Some(&answer))?;
        fs::read_to_string(&answer).map_err(Error::io(&answer, "cannot read"))
    }

    fn call(&self, command: &str, args: &[OsString], answer: Option<&Path>) -> Result<()> {
        let said = self.place.path().join("said.txt");
        let create = |path: &Path| File::create(path).map_err(Error::io(path, "cannot write"));
        let mut child = Command::new(&self.program);
        child.arg(command).args(&self.scene).args(args).stdin(Stdio::null()).stderr(create(&said)?);
        match answer {
            Some(path) => child.stdout(create(path)?),
            None => child.stdout(Stdio::null()),
        };
        if let Some(n) = self.threads {
            child.args(["--threads", &n.to_string()]);
        }
        let mut running = child.spawn().map_err(Error::io(&self.program, "cannot start"))?;
        let status = loop {
            if (self.stopped)() {
                // It may have heard of the interrupt itself; either way nothing of it is wanted any more.
                let _ = running.kill();
                let _ = running.wait();
                return Err(Error::Interrupted);
            }
            match running.try_wait().map_err(Error::io(&self.program, "cannot wait for"))? {
                Some(status) => break status,
                None => std::thread::sleep(POLL),
            }
        };
        match status.code() {
            // 1: a target that was missed is a result as well.
            Some(0 | 1) => return Ok(()),
            // The terminal interrupts both of us.
            Some(130) => return Err(Error::Interrupted),
            _ => {}
        }
        let text = fs::read_to_string(&said).unwrap_or_default();
        let words: Vec<String> = args.iter().map(|a| a.to_string_lossy().into_owned()).collect();
        let words = words.join(" ");
        Err(Error::Usage(format!("bake {command} ... {words} ended with {status}: {}", text.trim_end())))
    }
}

/// Luminance and standard error of all covered texels, page by page, nits.
///
/// # Errors
///
/// Where a page cannot be read.
pub fn texels(dir: &Path, manifest: &Manifest) -> Result<Values> {
    let mut values = Values::default();
    for page in &manifest.pages {
        let path = folder::resolve(dir, &page.file);
        let file = exr::read(&path)?;
        let missing = || Error::Usage(format!("{}: lacks a channel", path.display()));
        let light = file.rgb("").ok_or_else(missing)?;
        let std_err = file.rgb("stderr").ok_or_else(missing)?;
        let coverage = file.channel("A").ok_or_else(missing)?;
        for i in (0..coverage.values.len()).filter(|&i| 0.0 < coverage.values[i]) {
            values.luminance.push(luminance(light.map(|c| c.values[i])));
            values.std_err.push(luminance(std_err.map(|c| c.values[i])));
        }
    }
    Ok(values)
}

/// Rec. 709 luminance.
pub(super) fn luminance([r, g, b]: [f32; 3]) -> f64 {
    0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
}

impl Studio<'_> {
    /// Bakes, and reads the texels.
    ///
    /// # Errors
    ///
    /// As [`Studio::bake`].
    pub fn shoot(&self, args: &[String], seed: u64) -> Result<Shot> {
        let read = |dir: &Path, manifest: &Manifest| {
            let stated = manifest.denoised.map_or(manifest.error.relative, |d| d.relative);
            Ok((texels(dir, manifest)?, stated))
        };
        let ((values, stated), cost) = self.bake(args, seed, read)?;
        Ok(Shot { values, cost, stated })
    }
}
