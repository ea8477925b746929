//! Wall and processor time of stages, and peak memory.

use nix::sys::resource::{UsageWho, getrusage};
use std::time::Instant;
use tables::format::manifest::{Stage, Timings};

/// Measures one stage after the other.
pub(crate) struct Stopwatch {
    begin: Instant,
    lap: (Instant, f64),
    stages: Vec<Stage>,
}

impl Stopwatch {
    pub(crate) fn start() -> Self {
        let now = Instant::now();
        Self { begin: now, lap: (now, cpu_seconds()), stages: Vec::new() }
    }

    /// When the command started.
    pub(crate) fn begin(&self) -> Instant {
        self.begin
    }

    /// Ends a stage and says what it took by the clock, seconds; further laps of the same name add up.
    pub(crate) fn lap(&mut self, name: &str) -> f64 {
        let now = (Instant::now(), cpu_seconds());
        let (wall, cpu) = ((now.0 - self.lap.0).as_secs_f64(), now.1 - self.lap.1);
        self.lap = now;
        match self.stages.iter_mut().find(|s| s.name == name) {
            Some(s) => {
                s.wall_seconds += wall;
                s.cpu_seconds += cpu;
            }
            None => {
                self.stages.push(Stage { name: name.to_owned(), wall_seconds: wall, cpu_seconds: cpu });
            }
        }
        wall
    }

    /// Everything measured so far.
    pub(crate) fn timings(&self, rays: u64, paths: u64, threads: usize) -> Timings {
        Timings {
            stages: self.stages.clone(),
            wall_seconds: self.begin.elapsed().as_secs_f64(),
            cpu_seconds: cpu_seconds(),
            rays,
            paths,
            peak_memory_bytes: peak_memory(),
            threads,
            cpu: cpu_model(),
            ..Timings::new()
        }
    }
}

/// User and system seconds of all threads so far.
fn cpu_seconds() -> f64 {
    getrusage(UsageWho::RUSAGE_SELF).map_or(0.0, |u| {
        let seconds = |t: nix::sys::time::TimeVal| t.tv_sec() as f64 + t.tv_usec() as f64 * 1e-6;
        seconds(u.user_time()) + seconds(u.system_time())
    })
}

/// Largest resident set so far, bytes.
fn peak_memory() -> u64 {
    // `getrusage` would also count what the process that started this one held before it became
    // `bake`: Linux carries that maximum over. The high-water mark belongs to this program alone.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    high_water_mark(&status).unwrap_or_else(|| {
        // The system counts in units of 1024 bytes.
        getrusage(UsageWho::RUSAGE_SELF).map_or(0, |u| u64::try_from(u.max_rss()).unwrap_or(0) * 1024)
    })
}

/// `VmHWM` of a process status, bytes.
fn high_water_mark(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kibibytes.checked_mul(1024)
}

/// Model of the processor; empty where that is unknown.
pub(crate) fn cpu_model() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let line = info.lines().find(|l| l.starts_with("model name"));
    line.and_then(|l| l.split(':').nth(1)).map_or_else(String::new, |m| m.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_high_water_mark_is_read() {
        let status = "Name:\tbake\nVmPeak:\t  999 kB\nVmHWM:\t  395776 kB\nVmRSS:\t  1 kB\n";
        assert_eq!(high_water_mark(status), Some(395_776 * 1024));
        assert_eq!(high_water_mark("VmHWM: many kB"), None);
        assert_eq!(high_water_mark(""), None);
    }

    #[test]
    fn memory_that_was_used_counts() {
        let before = peak_memory();
        let block = vec![1_u8; 256 << 20];
        assert!(before + (200 << 20) < peak_memory(), "{before} {}", block.len());
    }
}
