//! What of a bake is shown, and how.

/// What surfaces show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Mode {
    /// The scene as a game shows it.
    #[default]
    Lit,
    /// The light of lightmaps on white surfaces.
    Lightmap,
    /// Texels in squares of two shades, to see how dense they are.
    Texels,
    /// Standard errors as parts of the light: blue 1 %, green a tenth, red all of it.
    Error,
    /// Texels that were filled from others because they lay inside of something (red), and the gutter (blue).
    Filled,
    /// The light of probes on white surfaces.
    Probes,
}

impl Mode {
    /// All, in the order of their keys.
    pub(crate) const ALL: [Self; 6] =
        [Self::Lit, Self::Lightmap, Self::Texels, Self::Error, Self::Filled, Self::Probes];

    /// As shaders know it.
    pub(crate) fn number(self) -> u32 {
        Self::ALL.iter().zip(0..).find(|(m, _)| **m == self).map_or(0, |(_, n)| n)
    }

    /// For people.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Lit => "lit",
            Self::Lightmap => "lightmap only",
            Self::Texels => "texels",
            Self::Error => "standard error",
            Self::Filled => "filled texels",
            Self::Probes => "light of probes",
        }
    }
}

/// What is shown.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    /// What surfaces show.
    pub(crate) mode: Mode,
    /// Whether there is fog between them and the eye.
    pub(crate) fog: bool,
    /// Whether normal maps act, where lightmaps know directions.
    pub(crate) normals: bool,
    /// Whether spheres move about.
    pub(crate) balls: bool,
    /// Whether probes are shown as spheres.
    pub(crate) probes: bool,
    /// What radiance is multiplied by before tone mapping, 1/nit; that of one bake for all, so that they can be compared.
    pub(crate) exposure: f32,
    /// Beside that, stops.
    pub(crate) stops: f32,
}
