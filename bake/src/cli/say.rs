//! Messages: findings, errors, progress. All of it goes to standard error.

#![expect(clippy::print_stderr, reason = "this is the one place that talks to the user")]

use crate::cli::args::ProgressArg;
use crate::error::{Error, Finding, Severity};
use crate::solve::Monitor;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// A line for the user.
pub(crate) fn line(text: &str) {
    eprintln!("{text}");
}

/// An error as the user sees it.
pub(crate) fn error(e: &Error) {
    match e {
        // Findings say "error" themselves.
        Error::Input(_) => eprintln!("{e}"),
        _ => eprintln!("error: {e}"),
    }
}

/// Findings, gravest first; notes only if `all`.
pub(crate) fn findings(list: &[Finding], all: bool) {
    for f in list.iter().filter(|f| all || f.severity != Severity::Info) {
        eprintln!("{f}");
    }
}

/// Ctrl-C and SIGTERM, noticed. A second one ends the process at once: whatever was being written
/// is in a temporary place then.
#[derive(Clone)]
pub(crate) struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    pub(crate) fn install() -> Result<Self, Error> {
        let flag = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&flag);
        ctrlc::set_handler(move || {
            if seen.swap(true, Ordering::SeqCst) {
                std::process::exit(130);
            }
        })
        .map_err(|e| Error::Usage(format!("cannot listen for Ctrl-C: {e}")))?;
        Ok(Self(flag))
    }

    pub(crate) fn raised(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }

    /// Ends the command if the user asked for it.
    pub(crate) fn check(&self) -> Result<(), Error> {
        if self.raised() { Err(Error::Interrupted) } else { Ok(()) }
    }
}

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Style {
    Bar,
    Lines,
    Json,
    Silent,
}

impl Style {
    pub(crate) fn new(arg: Option<ProgressArg>) -> Self {
        match arg.unwrap_or(ProgressArg::Auto) {
            ProgressArg::Auto if std::io::stderr().is_terminal() => Self::Bar,
            ProgressArg::Auto | ProgressArg::Plain => Self::Lines,
            ProgressArg::Json => Self::Json,
            ProgressArg::None => Self::Silent,
        }
    }

    /// Announces a stage.
    pub(crate) fn stage(self, name: &str, detail: &str) {
        match self {
            Self::Silent => {}
            Self::Json => eprintln!("{}", json!({"event": "stage", "stage": name, "detail": detail})),
            Self::Bar | Self::Lines => eprintln!("{name}: {detail}"),
        }
    }
}

/// Runs `work` while showing how far `monitor` has come; passes an interrupt on to it.
pub(crate) fn watch<T: Send>(
    style: Style,
    stage: &str,
    total: u64,
    monitor: &Monitor,
    interrupt: &Interrupt,
    work: impl FnOnce() -> T + Send,
) -> T {
    let (finished, wait) = channel::<()>();
    let start = (Instant::now(), monitor.paths());
    std::thread::scope(|scope| {
        let watcher = scope.spawn(move || {
            let bar = (style == Style::Bar).then(|| bar(stage, total));
            let mut shown = Instant::now();
            let mut every = Duration::from_secs(2);
            while wait.recv_timeout(Duration::from_millis(100)) == Err(RecvTimeoutError::Timeout) {
                if interrupt.raised() {
                    monitor.stop();
                }
                let now = State::new(monitor, start, total);
                if let Some(bar) = &bar {
                    bar.set_length(now.total);
                    bar.set_position(now.done);
                    bar.set_message(now.message());
                } else if every <= shown.elapsed() && style != Style::Silent {
                    shown = Instant::now();
                    // Lines get rarer as the bake gets longer, so that logs stay readable.
                    every = (every * 5 / 4).min(Duration::from_secs(30));
                    match style {
                        Style::Json => eprintln!("{}", now.json(stage)),
                        _ => eprintln!("{stage}: {}", now.line()),
                    }
                }
            }
            if let Some(bar) = bar {
                bar.finish_and_clear();
            }
        });
        let result = work();
        drop(finished);
        // A watcher that panicked has shown its message; the work is done all the same.
        let _ = watcher.join();
        result
    })
}

fn bar(stage: &str, total: u64) -> ProgressBar {
    let style = ProgressStyle::with_template("{prefix} {wide_bar} {percent:>3} %  {msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(total).with_style(style).with_prefix(stage.to_owned())
}

/// How far a stage has come.
struct State {
    done: u64,
    total: u64,
    paths_per_second: f64,
    rays: u64,
    error: Option<f64>,
    seconds_left: Option<f64>,
}

impl State {
    fn new(monitor: &Monitor, start: (Instant, u64), total: u64) -> Self {
        let done = monitor.paths() - start.1;
        let total = if 0 < monitor.expected() { monitor.expected() } else { total };
        let seconds = start.0.elapsed().as_secs_f64();
        let rate = done as f64 / seconds.max(1e-9);
        let left = total.saturating_sub(done) as f64 / rate;
        Self {
            done,
            total,
            paths_per_second: rate,
            rays: monitor.rays(),
            error: monitor.relative_error(),
            seconds_left: (0 < done).then_some(left),
        }
    }

    fn percent(&self) -> f64 {
        100.0 * self.done as f64 / self.total.max(1) as f64
    }

    fn message(&self) -> String {
        let mut text = format!("{:.2} M paths/s", self.paths_per_second * 1e-6);
        if let Some(e) = self.error {
            text += &format!(", error {:.1} %", 100.0 * e);
        }
        if let Some(s) = self.seconds_left {
            text += &format!(", {} left", duration(s));
        }
        text
    }

    fn line(&self) -> String {
        format!("{:.0} %, {}", self.percent(), self.message())
    }

    fn json(&self, stage: &str) -> serde_json::Value {
        json!({
            "event": "progress", "stage": stage, "percent": self.percent(), "paths": self.done,
            "total_paths": self.total, "paths_per_second": self.paths_per_second, "rays": self.rays,
            "relative_error": self.error, "seconds_left": self.seconds_left,
        })
    }
}

/// Seconds as people read them.
pub(crate) fn duration(seconds: f64) -> String {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates, which is right")]
    let s = seconds.round() as u64;
    match s {
        0..60 if seconds < 10.0 => format!("{seconds:.1} s"),
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {} s", s / 60, s % 60),
        _ => format!("{} h {} min", s / 3600, s % 3600 / 60),
    }
}

/// Bytes as people read them.
pub(crate) fn bytes(n: u64) -> String {
    let mib = n as f64 / f64::from(1 << 20);
    if mib < 1024.0 { format!("{mib:.0} MiB") } else { format!("{:.2} GiB", mib / 1024.0) }
}
