//! Runs the built command-line tools.

use serde_json::{Value, json};
use std::{
    env,
    ffi::OsStr,
    io::Read,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::OnceLock,
    thread,
    time::{Duration, Instant},
};

/// What a finished command left.
#[derive(Clone, Debug)]
pub struct Finished {
    /// Arguments, for messages.
    pub command: String,
    /// Exit code; `None` where a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl Finished {
    /// Panics with everything the command said unless it ended with `code`.
    #[must_use]
    #[track_caller]
    pub fn expect(self, code: i32) -> Self {
        assert!(self.code == Some(code), "expected exit code {code}\n{self}");
        self
    }
}

impl std::fmt::Display for Finished {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { command, code, stdout, stderr } = self;
        write!(f, "$ {command}\nexit code {code:?}\n-- stdout\n{stdout}\n-- stderr\n{stderr}")
    }
}

/// The folder `target/<profile>` that holds this test or example.
fn profile_dir() -> PathBuf {
    let exe = env::current_exe().expect("a test knows where it is");
    let dir = exe.parent().expect("a file is in a folder");
    if dir.ends_with("deps") || dir.ends_with("examples") {
        dir.parent().unwrap_or(dir).into()
    } else {
        dir.into()
    }
}

/// Path of a tool of this workspace, built with this test's profile: a test of one package does not build the others'.
fn binary(package: &str, features: &[&str]) -> PathBuf {
    let profile_dir = profile_dir();
    let profile = match profile_dir.file_name().and_then(OsStr::to_str) {
        Some("debug") | None => "dev",
        Some(other) => other,
    };
    let target = profile_dir.parent().unwrap_or(&profile_dir);
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let built = Command::new(cargo)
        .args([
            "build",
            "--quiet",
            "--package",
            package,
            "--bin",
            package,
            "--profile",
            profile,
            "--target-dir",
        ])
        .arg(target)
        .args(features)
        .current_dir(crate::root())
        .output()
        .expect("cargo can be started");
    assert!(built.status.success(), "cannot build {package}:\n{}", String::from_utf8_lossy(&built.stderr));
    profile_dir.join(format!("{package}{}", env::consts::EXE_SUFFIX))
}

/// Path of `bake`, built on the first call, with other ways to choose lights to compare with: those that the library has in tests.
#[must_use]
pub fn bake_path() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| binary("bake", &["--features", "comparison"]))
}

/// Path of `runtime-sample`, built on the first call.
#[must_use]
pub fn runtime_sample_path() -> &'static Path {
    static PATH: OnceLock<PathBuf> = OnceLock::new();
    PATH.get_or_init(|| binary("runtime-sample", &[]))
}

/// A command on its way.
#[derive(Debug)]
pub struct Running {
    command: String,
    child: Child,
    out: thread::JoinHandle<String>,
    err: thread::JoinHandle<String>,
}

fn drain(pipe: Option<impl Read + Send + 'static>) -> thread::JoinHandle<String> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(mut pipe) = pipe {
            // What was read before an error is still worth showing.
            let _ = pipe.read_to_end(&mut bytes);
        }
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

/// Starts `program` in `dir`.
#[must_use]
pub fn start(program: &Path, args: &[&str], dir: &Path) -> Running {
    start_with(program, args, dir, &[])
}

/// [`start`] with environment variables, names and values, beside those of this process.
#[must_use]
pub fn start_with(program: &Path, args: &[&str], dir: &Path, variables: &[(&str, &str)]) -> Running {
    let name = program.file_stem().map(OsStr::to_string_lossy).unwrap_or_default().into_owned();
    let mut child = Command::new(program)
        .args(args)
        .current_dir(dir)
        .envs(variables.iter().copied())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap_or_else(|e| panic!("cannot start {}: {e}", program.display()));
    let (out, err) = (drain(child.stdout.take()), drain(child.stderr.take()));
    Running { command: format!("{name} {}", args.join(" ")), child, out, err }
}

impl Running {
    /// Process number, for signals.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Whether it has ended.
    pub fn ended(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(Some(_)))
    }

    /// Waits for the end. Panics, after killing the command, when `limit` has passed.
    #[must_use]
    pub fn wait(mut self, limit: Duration) -> Finished {
        let begun = Instant::now();
        let (code, late) = loop {
            match self.child.try_wait().expect("a child can be waited for") {
                Some(status) => break (status.code(), false),
                None if limit < begun.elapsed() => {
                    // It may have ended in between, which is as good.
                    let _ = self.child.kill();
                    let _ = self.child.wait();
                    break (None, true);
                }
                None => thread::sleep(Duration::from_millis(5)),
            }
        };
        let text = |t: thread::JoinHandle<String>| t.join().expect("reading a pipe does not panic");
        let done = Finished { command: self.command, code, stdout: text(self.out), stderr: text(self.err) };
        assert!(!late, "not done after {limit:?}\n{done}");
        done
    }
}

/// Runs `bake` in `dir`, for at most five minutes.
#[must_use]
pub fn bake(args: &[&str], dir: &Path) -> Finished {
    start(bake_path(), args, dir).wait(Duration::from_secs(300))
}

/// Sends a signal, such as `INT`, to a command.
pub fn signal(running: &Running, name: &str) {
    let status = Command::new("kill").args([&format!("-{name}"), &running.id().to_string()]).status();
    assert!(status.is_ok_and(|s| s.success()), "cannot send SIG{name}");
}

/// A temporary folder that holds `scene.glb`.
///
/// # Panics
/// Where no temporary file can be written.
#[must_use]
pub fn folder_with(scene: &[u8]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(dir.path().join("scene.glb"), scene).expect("a writable temporary folder");
    dir
}

/// Bakes `scene` with extra arguments and reads what was written; the command must succeed.
#[must_use]
#[track_caller]
pub fn baked(scene: &[u8], args: &[&str]) -> crate::baked::Baked {
    let dir = folder_with(scene);
    let mut all = vec!["run", "scene.glb", "-o", "out", "--progress", "none"];
    all.extend_from_slice(args);
    let done = bake(&all, dir.path()).expect(0);
    let out = dir.path().join("out");
    crate::baked::Baked::read(&out).unwrap_or_else(|e| panic!("{e}\n{done}"))
}

/// [`baked`] with one medium, in the words of a configuration file.
///
/// # Panics
/// If there is no bake.
#[must_use]
pub fn baked_in(scene: &[u8], medium: &str, args: &[&str]) -> crate::baked::Baked {
    let dir = tempfile::tempdir().expect("a folder");
    let config = dir.path().join("fog.toml");
    std::fs::write(&config, format!("media = [{medium}]\n")).expect("a file");
    baked(scene, &[args, &["--config", config.to_str().expect("a path")]].concat())
}

/// Irradiance and its standard error at points with normals, by `bake points` with the given arguments; lux.
///
/// # Panics
///
/// If the tool fails.
#[must_use]
pub fn points(scene: &Path, at: &[[[f64; 3]; 2]], args: &[&str]) -> Vec<[[f64; 3]; 2]> {
    let dir = tempfile::tempdir().expect("a folder");
    let asked: Vec<Value> = at.iter().map(|[p, n]| json!({ "position": p, "normal": n })).collect();
    std::fs::write(dir.path().join("points.json"), json!({ "points": asked }).to_string()).expect("a file");
    let scene = scene.to_str().expect("a readable path");
    let first = ["points", scene, "points.json", "--progress", "none"];
    let done = bake(&[&first[..], args].concat(), dir.path()).expect(0);
    let answer: Value = serde_json::from_str(&done.stdout).unwrap_or_else(|e| panic!("{e}\n{done}"));
    let got = answer["points"].as_array().expect("a list");
    assert_eq!(got.len(), at.len());
    got.iter()
        .zip(&asked)
        .map(|(g, a)| {
            assert_eq!(g["position"], a["position"], "order and places are kept");
            [numbers(&g["irradiance"]), numbers(&g["std_err"])]
        })
        .collect()
}

/// Three numbers of a JSON list.
#[must_use]
pub fn numbers(v: &Value) -> [f64; 3] {
    std::array::from_fn(|i| v[i].as_f64().unwrap_or(f64::NAN))
}

/// What figures were measured on: the processor, its cores, and the day, in words.
#[must_use]
pub fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find(|l| l.starts_with("model name")).and_then(|l| l.split(':').nth(1));
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let day = humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string();
    format!("{}, {cores} cores, {}", model.unwrap_or("an unknown processor").trim(), &day[..10])
}
