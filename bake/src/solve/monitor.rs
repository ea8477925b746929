//! What a long computation and the one who waits for it say to each other.

use crate::solve::accumulate::{Gate, Rejected};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Shared by the workers (which count) and the front end (which shows and stops).
#[derive(Debug, Default)]
pub struct Monitor {
    /// Paths finished.
    paths: AtomicU64,
    /// Rays traced by them.
    rays: AtomicU64,
    /// Sums over finished texels, for showing only: their order depends on the threads.
    error: Mutex<ErrorSums>,
    /// Paths that the stage at work will have; 0 if it did not say.
    expected: AtomicU64,
    stop: AtomicBool,
    /// Whether a rejected sample ends the work.
    strict: bool,
    /// The first of those that workers reported.
    rejected: Mutex<Option<Rejected>>,
}

/// Sums of squared standard errors and of luminance, and how many texels they hold.
#[derive(Clone, Copy, Debug, Default)]
pub struct ErrorSums {
    /// Sum of squared standard errors, nits squared.
    pub squared_error: f64,
    /// Sum of luminance, nits.
    pub luminance: f64,
    /// Texels.
    pub n: f64,
}

impl Monitor {
    /// If `strict`, the first sample that a gate rejects stops the workers.
    #[must_use]
    pub fn new(strict: bool) -> Self {
        Self { strict, ..Self::default() }
    }

    /// Workers show their gate after each texel, probe or batch.
    pub fn report(&self, gate: &Gate) {
        let Some(first) = gate.first.filter(|_| self.strict) else { return };
        let mut rejected = self.rejected.lock().unwrap_or_else(PoisonError::into_inner);
        *rejected = Some(rejected.map_or(first, |r| r.min(first)));
        self.stop();
    }

    /// The sample that stopped the workers: the first in order of those that were found until all had stopped.
    #[must_use]
    pub fn rejected(&self) -> Option<Rejected> {
        *self.rejected.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Workers report finished work in batches.
    pub fn add(&self, paths: u64, rays: u64) {
        self.paths.fetch_add(paths, Ordering::Relaxed);
        self.rays.fetch_add(rays, Ordering::Relaxed);
    }

    /// Workers report the error of finished texels.
    pub fn add_error(&self, sums: ErrorSums) {
        let mut e = self.error.lock().unwrap_or_else(PoisonError::into_inner);
        e.squared_error += sums.squared_error;
        e.luminance += sums.luminance;
        e.n += sums.n;
    }

    /// Workers replace the error by that of all texels of a page.
    pub fn show_error(&self, sums: ErrorSums) {
        *self.error.lock().unwrap_or_else(PoisonError::into_inner) = sums;
    }

    /// Workers say how many paths the stage at work will have.
    pub fn expect(&self, paths: u64) {
        self.expected.store(paths, Ordering::Relaxed);
    }

    /// What they said last; 0 if nothing.
    #[must_use]
    pub fn expected(&self) -> u64 {
        self.expected.load(Ordering::Relaxed)
    }

    /// Root mean squared standard error of finished texels over their mean luminance.
    #[must_use]
    pub fn relative_error(&self) -> Option<f64> {
        let e = *self.error.lock().unwrap_or_else(PoisonError::into_inner);
        (0.0 < e.luminance).then(|| (e.squared_error / e.n).sqrt() / (e.luminance / e.n))
    }

    /// Paths finished so far.
    #[must_use]
    pub fn paths(&self) -> u64 {
        self.paths.load(Ordering::Relaxed)
    }

    /// Rays traced so far.
    #[must_use]
    pub fn rays(&self) -> u64 {
        self.rays.load(Ordering::Relaxed)
    }

    /// Asks the workers to stop.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Whether they were asked to.
    #[must_use]
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}
