//! What a long computation and the one who waits for it say to each other.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Shared by the workers (which count) and the front end (which shows and stops).
#[derive(Debug, Default)]
pub struct Monitor {
    /// Paths finished.
    paths: AtomicU64,
    /// Rays traced by them.
    rays: AtomicU64,
    stop: AtomicBool,
}

impl Monitor {
    /// Workers report finished work in batches.
    pub fn add(&self, paths: u64, rays: u64) {
        self.paths.fetch_add(paths, Ordering::Relaxed);
        self.rays.fetch_add(rays, Ordering::Relaxed);
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
