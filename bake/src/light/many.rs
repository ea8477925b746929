//! How lights are chosen where there are many: all of them, one by its weight among all, or one from a tree.

use crate::light::emitters::Emitters;
use crate::light::punctual::Punctual;
#[cfg(feature = "comparison")]
use crate::light::tree::comparison::{Intensity, Splitting};
use crate::light::tree::published::Lightcuts;
use crate::light::tree::{Cut, Effort, FEW, FallOff, LightTree, Pick, Receiver, Shine, TreeLight};
use glam::Vec3A;

/// Up to so many lamps are all sampled at receivers; deeper along the path, or if there are more, one is chosen.
pub const EVERY_LAMP: usize = 4;

/// Up to so many lamps are weighed one by one.
pub const FEW_LAMPS: usize = 16;

/// Up to so many emissive triangles are.
pub const FEW_EMITTERS: usize = 32;

/// How direct light is sampled: `--direct`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Direct {
    /// Few lights are weighed one by one, many are in a tree.
    #[default]
    Auto,
    /// A ray to each light from every surface; in media one is chosen.
    All,
    /// All are in a tree.
    Lightcuts,
    /// Lamps in a lighting grid hierarchy where texels ask, the rest as in [`Self::Auto`].
    Grid,
    /// Stochastic lightcuts as published: another tree and other weights, to compare with.
    Published,
    /// By intensity alone, to compare with.
    #[cfg(feature = "comparison")]
    Intensity,
    /// Adaptive tree splitting, to compare with.
    #[cfg(feature = "comparison")]
    Splitting,
}

impl Direct {
    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::All => "all",
            Self::Lightcuts => "lightcuts",
            Self::Grid => "grid",
            Self::Published => "published",
            #[cfg(feature = "comparison")]
            Self::Intensity => "intensity",
            #[cfg(feature = "comparison")]
            Self::Splitting => "splitting",
        }
    }
}

/// What becomes of the lights of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Selection {
    /// A ray to each.
    All,
    /// Each is weighed, one chosen.
    Weighed,
    /// One is chosen by [`ManyLights`].
    Tree,
}

/// What becomes of `n` lights of a kind of which up to `few` are weighed one by one.
#[must_use]
pub fn selection(direct: Direct, n: usize, few: usize) -> Selection {
    match direct {
        _ if n == 0 => Selection::Weighed,
        Direct::All => Selection::All,
        Direct::Auto | Direct::Grid if n <= few => Selection::Weighed,
        _ => Selection::Tree,
    }
}

/// Lights of [`ManyLights`] that may be chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Among {
    /// Lamps whose direct light is baked.
    BakedLamps,
    /// The same but for those that a lighting grid hierarchy may hold.
    BesideGrid,
    /// All lamps.
    Lamps,
    /// Emissive triangles.
    Emitters,
    /// Those that count as lamps in media.
    EmittersInMedia,
    /// All lamps and the emissive triangles that count as lamps in media.
    InMedia,
}

/// Kinds of lights that may be left out: groups of the tree.
const BAKED: u32 = 1;
const MIXED: u32 = 2;
const GRIDDED: u32 = 4;
const NARROW: u32 = 8;
const WIDE: u32 = 16;

impl Among {
    fn groups(self) -> u32 {
        match self {
            Self::BakedLamps => BAKED | GRIDDED,
            Self::BesideGrid => BAKED,
            Self::Lamps => BAKED | MIXED | GRIDDED,
            Self::Emitters => NARROW | WIDE,
            Self::EmittersInMedia => NARROW,
            Self::InMedia => BAKED | MIXED | GRIDDED | NARROW,
        }
    }
}

/// A light that was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chosen {
    /// Index into [`crate::light::Lights::punctual`].
    Lamp(usize),
    /// Index of an emissive triangle among [`Emitters`].
    Emitter(usize),
}

/// How many of many lights texels ask at once. Measured on a hall with 5,000 lamps and 50,000 emissive triangles, direct light alone, noise in equal time against one: 2 gave 2 % more,
/// 4 gave 4 % less, 8 gave 5 % more; without the worst hundredth of the texels 6, 17 and 15 % less.
pub const SEVERAL: u32 = 4;

/// Squared half diagonal over squared distance beyond which a node is opened.
pub const THRESHOLD: f32 = Effort::ONE.near;

/// Lights in a tree.
#[derive(Clone, Debug)]
pub struct ManyLights {
    how: How,
    /// How far its nodes are opened.
    effort: Effort,
    /// The light of each number in the tree, kind by kind.
    lights: Vec<Chosen>,
    /// Number in the tree of each emissive triangle; empty if they are not in it.
    emitter: Vec<u32>,
}

#[derive(Clone, Debug)]
enum How {
    Tree(LightTree),
    /// Over lamps and over emissive triangles, with how many lamps there are.
    Published(Box<[Lightcuts; 2]>, u32),
    #[cfg(feature = "comparison")]
    Intensity(Box<[Intensity; 2]>, u32),
    #[cfg(feature = "comparison")]
    Splitting(Box<[Splitting; 2]>, u32),
}

impl ManyLights {
    /// A tree over what is not weighed one by one; `None` if nothing is in it.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^31 lights")]
    pub fn new(direct: Direct, lamps: Option<&[Punctual]>, emitters: Option<&Emitters>) -> Option<Self> {
        let lamps = lamps.unwrap_or_default();
        let n = emitters.map_or(0, Emitters::len);
        let mut kinds: [Vec<Chosen>; 5] = Default::default();
        for (i, lamp) in lamps.iter().enumerate() {
            let kind =
                if direct == Direct::Grid && lamp.suits_grid() { 2 } else { usize::from(lamp.indirect_only) };
            kinds[kind].push(Chosen::Lamp(i));
        }
        for k in 0..n {
            let grouped = emitters.is_some_and(|e| e.group_of(k).is_some());
            kinds[if grouped { 3 } else { 4 }].push(Chosen::Emitter(k));
        }
        let sizes = kinds.each_ref().map(Vec::len);
        let order: Vec<Chosen> = kinds.into_iter().flatten().collect();
        if order.is_empty() {
            return None;
        }
        let of = |c: &Chosen| match (*c, emitters) {
            (Chosen::Lamp(i), _) => lamps[i].in_tree(),
            (Chosen::Emitter(k), Some(e)) => e.in_tree(k),
            (Chosen::Emitter(_), None) => unreachable!("only known emitters are listed"),
        };
        let lights: Vec<TreeLight> = order.iter().map(of).collect();
        let mut emitter = vec![0; n];
        for (number, c) in order.iter().enumerate() {
            if let Chosen::Emitter(k) = *c {
                emitter[k] = number as u32;
            }
        }
        let parts = lights.split_at(lamps.len());
        let first = lamps.len() as u32;
        let how = match direct {
            Direct::Auto | Direct::All | Direct::Lightcuts | Direct::Grid => {
                How::Tree(LightTree::new(&lights, &sizes))
            }
            Direct::Published => {
                How::Published(Box::new([Lightcuts::new(parts.0), Lightcuts::new(parts.1)]), first)
            }
            #[cfg(feature = "comparison")]
            Direct::Intensity => {
                How::Intensity(Box::new([Intensity::new(parts.0), Intensity::new(parts.1)]), first)
            }
            #[cfg(feature = "comparison")]
            Direct::Splitting => {
                How::Splitting(Box::new([Splitting::new(parts.0), Splitting::new(parts.1)]), first)
            }
        };
        Some(Self { how, effort: Effort::ONE, lights: order, emitter })
    }

    /// The same with nodes opened beyond this [`THRESHOLD`].
    #[must_use]
    pub fn with_threshold(self, near: f32) -> Self {
        Self { effort: Effort { near, ..self.effort }, ..self }
    }

    /// One light for a place, with its probability; `None` is the null light.
    #[must_use]
    pub fn one(&self, at: &Receiver, among: Among, fall_off: FallOff, u: f64) -> Option<(Chosen, f32)> {
        let pick = match &self.how {
            How::Tree(tree) => self.cut(tree, at, among, fall_off).one(u),
            How::Published(both, first) => of_kind(among, u, *first, |kind, u| both[kind].one(at, u)),
            #[cfg(feature = "comparison")]
            #[expect(clippy::cast_possible_truncation, reason = "24 bits are enough")]
            How::Intensity(both, first) => {
                of_kind(among, u, *first, |kind, u| both[kind].one((u as f32).min(1.0 - f32::EPSILON)))
            }
            #[cfg(feature = "comparison")]
            How::Splitting(both, first) => of_kind(among, u, *first, |kind, u| both[kind].one(at, u)),
        }?;
        let chosen = self.lights[pick.light as usize];
        Some((chosen, pick.chance))
    }

    /// About `n` lights for a place, for what falls with the square of the distance. `visit` gets each with the probability that [`ManyLights::one`]
    /// chooses it with and how often it is chosen here on average, by which its light has to be divided.
    pub fn several(
        &self,
        at: &Receiver,
        among: Among,
        n: usize,
        u: f64,
        visit: &mut dyn FnMut(Chosen, f32, f32),
    ) {
        let How::Tree(tree) = &self.how else {
            for k in 0..n {
                let u = (u + k as f64 / n as f64).fract();
                if let Some((light, chance)) = self.one(at, among, FallOff::Square, u) {
                    visit(light, chance, chance * n as f32);
                }
            }
            return;
        };
        let cut = self.cut(tree, at, among, FallOff::Square);
        let mut visit = |pick: Pick| visit(self.lights[pick.light as usize], pick.alone, pick.chance);
        if n == 1 {
            cut.one(u).into_iter().for_each(visit);
        } else {
            cut.many(n, u, &mut visit);
        }
    }

    /// With which probability [`ManyLights::one`] chooses an emissive triangle among all of them, for what falls with the square of the distance.
    #[must_use]
    pub fn probability(&self, at: &Receiver, emitter: usize) -> f32 {
        let Some(&number) = self.emitter.get(emitter) else { return 0.0 };
        match &self.how {
            How::Tree(tree) => self.cut(tree, at, Among::Emitters, FallOff::Square).probability(number),
            How::Published(both, first) => both[1].probability(at, number - first),
            #[cfg(feature = "comparison")]
            How::Intensity(both, first) => both[1].probability(number - first),
            #[cfg(feature = "comparison")]
            How::Splitting(both, first) => both[1].probability(at, number - first),
        }
    }

    /// Whether it knows what falls with the distance: the published ways do not, and would leave out what shines past a place.
    #[must_use]
    pub fn knows_media(&self) -> bool {
        matches!(self.how, How::Tree(_))
    }

    /// The way to the nearest lamp or emissive triangle that counts as one in media, metres; `None` where trees do not know.
    #[must_use]
    pub fn nearest(&self, p: Vec3A) -> Option<Vec3A> {
        match &self.how {
            How::Tree(tree) => tree.nearest(p, Among::InMedia.groups()),
            _ => None,
        }
    }

    /// The cut for one light or a few.
    fn cut<'a>(&self, tree: &'a LightTree, at: &Receiver, among: Among, fall_off: FallOff) -> Cut<'a, FEW> {
        tree.cut(*at, among.groups(), fall_off, self.effort)
    }

    /// Bytes that it takes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let tree = match &self.how {
            How::Tree(tree) => tree.bytes(),
            _ => 0,
        };
        tree + self.lights.len() * size_of::<Chosen>() + self.emitter.len() * size_of::<u32>()
    }

    /// Number of lights in the tree.
    #[must_use]
    pub fn len(&self) -> usize {
        self.lights.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }
}

/// Chooses one kind by a coin, where both are asked, then by `one`. Numbers of emissive triangles start at `first`.
fn of_kind(among: Among, u: f64, first: u32, one: impl Fn(usize, f64) -> Option<Pick>) -> Option<Pick> {
    let (kind, u, half) = match among {
        Among::BakedLamps | Among::BesideGrid | Among::Lamps => (0, u, 1.0),
        Among::Emitters | Among::EmittersInMedia => (1, u, 1.0),
        Among::InMedia if u < 0.5 => (0, 2.0 * u, 0.5),
        Among::InMedia => (1, 2.0 * u - 1.0, 0.5),
    };
    let pick = one(kind, u)?;
    let light = pick.light + if kind == 1 { first } else { 0 };
    Some(Pick { light, chance: pick.chance * half, alone: pick.alone * half })
}

impl Punctual {
    /// As trees see it.
    #[must_use]
    pub fn in_tree(&self) -> TreeLight {
        let intensity = crate::geom::world::luminance(self.intensity());
        let shine = self.cone().map_or(Shine::Everywhere, |(axis, one_minus_cos)| Shine::Cone {
            axis,
            angle: (1.0 - one_minus_cos).clamp(-1.0, 1.0).acos(),
        });
        TreeLight { min: self.position(), max: self.position(), intensity, shine }
    }
}
