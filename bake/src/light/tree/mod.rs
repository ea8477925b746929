//! A tree over many lights, and how one or a few of them are chosen for a place.
//!
//! \[SLC20\] Yuksel, "Stochastic Lightcuts for Sampling Many Lights", 2020, is implemented as published (and corrected) in
//! [`published`]; what bakes use is [`LightTree`], with a tree and weights of its own:
//!
//! - The tree ([`build`]) is built from the top and deterministic, and has eight children a node, whose weights are computed
//!   together: fewer and better weights on the way to a light than with two.
//! - Weights ([`wide`]) estimate what a node brings on average instead of bounding it, and know where lights shine.
//! - A choice starts from a cut ([`LightTree::cut`]) through nodes that are small as seen from the place, whatever it draws
//!   later: a lamp next to it is never hidden in a large node whose weight says little. From the cut several lights are drawn by
//!   systematic sampling with probabilities proportional to size (\[Mad49\] Madow, "On the Theory of Systematic Sampling, II",
//!   Annals of Mathematical Statistics 20, 1949): at most once each, and lights that deserve a sample of their own get it for certain.
//!
//! Weights are zero only where a node brings nothing, whatever is in between, so every light that contributes has a chance. A choice that
//! ends where nothing shines is a null light: it counts as a sample and brings nothing (\[SLC20\] section 3.2.2).

pub mod agglomerative;
pub mod build;
#[cfg(feature = "comparison")]
pub mod comparison;
pub mod published;
mod sample;
pub mod wide;

pub use sample::{Cut, Effort, FEW, MOST, Pick};
pub use wide::LightTree;

use glam::Vec3A;
use std::f32::consts::{FRAC_PI_2, PI};

/// A light as trees see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TreeLight {
    /// Least corner of its bounds, metres.
    pub min: Vec3A,
    /// Greatest corner, metres.
    pub max: Vec3A,
    /// Greatest intensity in any direction, candela; only ratios count.
    pub intensity: f32,
    /// Where it shines.
    pub shine: Shine,
}

/// The directions in which a light shines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shine {
    /// All of them.
    Everywhere,
    /// Those within an angle around an axis: a spot light.
    Cone {
        /// Unit vector.
        axis: Vec3A,
        /// Half angle, radians, 0 to pi.
        angle: f32,
    },
    /// Those on one side of a plane, with the cosine: a patch.
    Cosine {
        /// Unit normal.
        normal: Vec3A,
    },
}

/// A place that lights shine on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// Metres, relative to the world's origin.
    pub position: Vec3A,
    /// Unit normal; zero where light counts from all directions alike.
    pub normal: Vec3A,
    /// Lights that nowhere rise above this over the plane do not light it, metres.
    pub below: f32,
}

impl Receiver {
    /// A place in the air.
    #[must_use]
    pub fn in_air(position: Vec3A) -> Self {
        Self { position, normal: Vec3A::ZERO, below: f32::NEG_INFINITY }
    }
}

/// What a light means by its intensity falls with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FallOff {
    /// The square of the distance: what arrives at a place.
    #[default]
    Square,
    /// The distance: what arrives after it was scattered once on the way.
    Linear,
}

impl TreeLight {
    /// Middle of its bounds, metres.
    #[must_use]
    pub fn centre(&self) -> Vec3A {
        0.5 * (self.min + self.max)
    }

    /// Whether it shines at all.
    #[must_use]
    pub fn shines(&self) -> bool {
        0.0 < self.intensity && self.intensity.is_finite() && self.min.is_finite() && self.max.is_finite()
    }
}

/// Bounds of normals and of the angle from them at which lights still shine (\[CK18\] Conty Estevez & Kulla, "Importance
/// Sampling of Many Lights with Adaptive Tree Splitting", 2018, section 4.1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// Unit vector.
    pub axis: Vec3A,
    /// No normal is farther from the axis, radians; pi where there is no axis.
    pub normals: f32,
    /// No light shines farther from its normal, radians.
    pub shine: f32,
}

impl Cone {
    /// Of one light.
    #[must_use]
    pub fn of(shine: Shine) -> Self {
        match shine {
            Shine::Everywhere => Self { axis: Vec3A::Z, normals: PI, shine: FRAC_PI_2 },
            Shine::Cone { axis, angle } => Self { axis, normals: 0.0, shine: angle },
            Shine::Cosine { normal } => Self { axis: normal, normals: 0.0, shine: FRAC_PI_2 },
        }
    }

    /// The least cone around two (\[CK18\] algorithm 1).
    #[must_use]
    pub fn union(self, o: Self) -> Self {
        let (a, b) = if self.normals < o.normals { (o, self) } else { (self, o) };
        let shine = a.shine.max(b.shine);
        let between = a.axis.dot(b.axis).clamp(-1.0, 1.0).acos();
        if PI <= a.normals || between + b.normals <= a.normals {
            return Self { shine, ..a };
        }
        let normals = 0.5 * (a.normals + between + b.normals);
        let side = (b.axis - a.axis * a.axis.dot(b.axis)).normalize_or_zero();
        if PI <= normals || side == Vec3A::ZERO {
            return Self { axis: a.axis, normals: PI, shine };
        }
        let (sin, cos) = (normals - a.normals).sin_cos();
        Self { axis: (a.axis * cos + side * sin).normalize(), normals, shine }
    }
}

#[cfg(test)]
mod tests;
