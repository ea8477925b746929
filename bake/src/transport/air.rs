//! Media along a ray: what is left of light, and places in them.

use crate::media::{Coefficients, Media, Segment, is_grey};
use crate::sample::warp::Frame;
use crate::scene::model::Rgb;
use glam::{Vec3, Vec3A};
use std::f32::consts::{FRAC_PI_2, PI};

/// Rays that pass a lamp by less than this part of its distance do not see its airlight.
const THROUGH_A_LAMP: f32 = 1e-5;

/// The media along a ray.
pub(crate) struct Air<'a> {
    pub(crate) media: &'a Media,
    pub(crate) segments: &'a [Segment],
    pub(crate) origin: Vec3A,
    pub(crate) direction: Vec3A,
}

impl Air<'_> {
    pub(crate) fn depth(&self, segment: Segment, to: f32) -> Rgb {
        self.media.depth_within(segment, self.origin, self.direction, to)
    }

    /// What is left of light along the first `t` metres.
    pub(crate) fn transmittance(&self, t: f32) -> Rgb {
        let before = self.segments.iter().filter(|s| s.from < t);
        (-before.map(|s| self.depth(*s, t.min(s.to))).sum::<Vec3>()).exp()
    }

    /// The place in a segment up to which one channel's optical depth is `wanted`: Newton's method, kept between ends by
    /// bisection. In a homogeneous segment the first step is exact.
    pub(crate) fn place(&self, segment: Segment, channel: usize, wanted: f32) -> f32 {
        if let Some(t) = self.media.place_in_grid(segment, self.origin, self.direction, channel, wanted) {
            return t.clamp(segment.from, segment.to);
        }
        let (mut low, mut high) = (segment.from, segment.to);
        let sigma = |t| self.media.coefficients(segment, self.origin, self.direction, t).sigma_t[channel];
        let mut t = low + wanted / sigma(low);
        for _ in 0..60 {
            if !(low < t && t < high) {
                // Where there is no end yet, twice as far.
                t = if high.is_finite() {
                    0.5 * (low + high)
                } else {
                    2.0 * low + 1.0 / sigma(low).max(1e-30)
                };
            }
            let off = wanted - self.depth(segment, t)[channel];
            if off.abs() <= 1e-6 * wanted {
                break;
            }
            if 0.0 < off {
                low = t
            } else {
                high = t
            }
            if high - low <= 1e-6 * high {
                break;
            }
            t += off / sigma(t);
        }
        t.clamp(segment.from, segment.to)
    }
}

/// Parts of [`Way::places`], a power of two so that roots do for exponentials.
pub(crate) const PARTS: usize = 4;

/// What the media on a part of a ray do to light.
pub(crate) struct Crossed {
    /// [`Media::plain`].
    plain: Option<(f32, f32, Coefficients)>,
    depth: Rgb,
    /// What is left of it.
    pub(crate) left: Rgb,
    /// The part of it that does not get through, in the channel that loses most.
    pub(crate) gone: f32,
}

/// Below this optical depth 1 - e^-x cancels.
const THIN: f32 = 0.1;

impl Crossed {
    #[inline]
    pub(crate) fn new(media: &Media, (origin, direction, length): (Vec3A, Vec3A, f32)) -> Self {
        let plain = media.plain(origin, direction, length);
        let depth = match &plain {
            Some((from, to, c)) => media.along(c.sigma_t, to - from),
            None => media.optical_depth(origin, direction, length),
        };
        if media.small().grey {
            // The same with one channel for three.
            let (left, gone) = if THIN <= depth.x {
                let left = (-depth.x).exp();
                (left, 1.0 - left)
            } else {
                let gone = -(-depth.x).exp_m1();
                (1.0 - gone, gone)
            };
            return Self { plain, depth, left: Vec3::splat(left), gone };
        }
        let most = depth.max_element();
        let (left, gone) = if THIN <= most {
            let left = media.attenuated(depth);
            (left, 1.0 - left.min_element())
        } else {
            let gone = -(-most).exp_m1();
            (if is_grey(depth) { Vec3::splat(1.0 - gone) } else { media.attenuated(depth) }, gone)
        };
        Self { plain, depth, left, gone }
    }

    /// What does not get through in a channel.
    fn lost(&self, channel: usize) -> f32 {
        let depth = self.depth[channel];
        if depth == self.depth.max_element() {
            self.gone
        } else if depth < THIN {
            -(-depth).exp_m1()
        } else {
            1.0 - self.left[channel]
        }
    }
}

/// -ln(1 - x), which free flight asks for.
#[inline]
fn depth_of(x: f32) -> f32 {
    if x < 0.125 {
        // The first term left out is x^8 / 8: half a unit in the last place.
        const TERMS: [f32; 6] = [1.0 / 7.0, 1.0 / 6.0, 1.0 / 5.0, 1.0 / 4.0, 1.0 / 3.0, 1.0 / 2.0];
        x * (1.0 + x * TERMS.iter().fold(0.0, |sum, term| sum * x + term))
    } else {
        -(-x).ln_1p()
    }
}

/// The channel whose value is neither the least nor the greatest.
fn middle(v: Rgb) -> usize {
    let [x, y, z] = v.to_array();
    if (y <= x) == (x <= z) {
        0
    } else if (x <= y) == (y <= z) {
        1
    } else {
        2
    }
}

/// The media along a ray, of which there may be one and no more, and then everything is in closed form.
pub(crate) struct Way<'a> {
    media: &'a Media,
    origin: Vec3A,
    direction: Vec3A,
    plain: Option<(f32, f32, Coefficients)>,
    segments: Vec<Segment>,
}

/// Places along a way, equally far apart; see [`Way::places`].
pub(crate) struct Places {
    /// Metres along the ray to the first of them.
    pub(crate) first: f32,
    /// Metres from one to the next.
    pub(crate) step: f32,
    /// Mean cosine.
    pub(crate) g: f32,
    /// What of their light arrives.
    pub(crate) weights: [Rgb; PARTS],
}

/// A place that free flight found.
pub(crate) struct Landing {
    /// Metres along the ray.
    pub(crate) at: f32,
    /// sigma_s and what is left of light up to there, over the density of finding it.
    pub(crate) weight: Rgb,
    /// Mean cosine there.
    pub(crate) g: f32,
}

impl<'a> Way<'a> {
    /// What a ray's first `length` metres cross; `None` if there is nothing.
    pub(crate) fn new(media: &'a Media, origin: Vec3A, direction: Vec3A, length: f32) -> Option<Self> {
        Self::of(media, (origin, direction, length), media.plain(origin, direction, length))
    }

    /// The same where it is known already what the media do to light.
    #[inline]
    pub(crate) fn across(media: &'a Media, ray: (Vec3A, Vec3A, f32), crossed: &Crossed) -> Option<Self> {
        Self::of(media, ray, crossed.plain)
    }

    #[inline]
    fn of(
        media: &'a Media,
        (origin, direction, length): (Vec3A, Vec3A, f32),
        plain: Option<(f32, f32, Coefficients)>,
    ) -> Option<Self> {
        let mut segments = Vec::new();
        match &plain {
            Some((from, to, _)) if to <= from => return None,
            Some(_) => {}
            None => {
                media.segments(origin, direction, length, &mut segments);
                if segments.is_empty() {
                    return None;
                }
            }
        }
        Some(Self { media, origin, direction, plain, segments })
    }

    /// Places along the way, one in each of [`PARTS`] parts of equal length, where it is in closed form: as far along its part as `u` says, with what of
    /// light that is scattered in the part arrives at the origin, per unit of radiance; `crossed` is what the whole way does to light.
    /// In the channel in the middle the weights are exact. `None` for other ways.
    #[inline]
    pub(crate) fn places(&self, crossed: &Crossed, u: f32) -> Option<Places> {
        let (from, to, c) = self.plain?;
        if to == f32::INFINITY {
            return None;
        }
        let step = (to - from) / PARTS as f32;
        let grey = self.media.small().grey || is_grey(c.sigma_t);
        let half = if grey { Vec3::splat(crossed.left.x.sqrt()) } else { crossed.left.map(f32::sqrt) };
        let left = if grey { Vec3::splat(half.x.sqrt()) } else { half.map(f32::sqrt) };
        // The channel in the middle chooses the place. 1 - left^4 = (1 - left) (1 + left) (1 + left^2), and what does not get through is
        // known without cancellation.
        let k = if grey { 0 } else { middle(c.sigma_t) };
        let sigma = c.sigma_t[k];
        let lost = crossed.lost(k) / ((left[k] + 1.0) * (half[k] + 1.0));
        let at = (depth_of(u * lost) / sigma).min(step);
        let mut weight = c.sigma_s * (lost / sigma);
        if !grey {
            weight *= ((sigma - c.sigma_t) * at).exp();
        }
        if !weight.is_finite() {
            return None;
        }
        let weights = std::array::from_fn(|_| {
            let here = weight;
            weight *= left;
            here
        });
        Some(Places { first: from + at, step, g: c.g, weights })
    }

    fn air(&self) -> Air<'_> {
        Air { media: self.media, segments: &self.segments, origin: self.origin, direction: self.direction }
    }

    /// From where to where there may be a medium.
    pub(crate) fn span(&self) -> (f32, f32) {
        match self.plain {
            Some((from, to, _)) => (from, to),
            None => (self.segments[0].from, self.segments[self.segments.len() - 1].to),
        }
    }

    /// Coefficients at a place; `None` where there is no medium.
    pub(crate) fn coefficients(&self, t: f32) -> Option<Coefficients> {
        match self.plain {
            Some((from, to, c)) => (from <= t && t <= to).then_some(c),
            None => {
                let segment = self.segments.iter().find(|s| s.from <= t && t <= s.to)?;
                Some(self.media.coefficients(*segment, self.origin, self.direction, t))
            }
        }
    }

    /// What is left of light along the first `t` metres.
    pub(crate) fn transmittance(&self, t: f32) -> Rgb {
        match self.plain {
            Some((from, _, c)) => self.media.attenuated(c.sigma_t * (t - from)),
            None => self.air().transmittance(t),
        }
    }

    /// A place where light may be scattered towards the ray's origin, by free flight in one of the channels that scatter, none of
    /// which leaves the media; the weights are those of all of them together (\[Vea97\] eq. 9.8).
    pub(crate) fn land(&self, u: f32) -> Option<Landing> {
        match self.plain {
            Some((from, to, c)) => {
                let length = to - from;
                let gone = |k: usize| -(-c.sigma_t[k] * length).exp_m1();
                let place = |gone: f32, u: f32, sigma: f32| (depth_of(u * gone) / sigma).min(length);
                if self.media.small().grey || (is_grey(c.sigma_s) && is_grey(c.sigma_t)) {
                    let gone = gone(0);
                    let weight = c.sigma_s * (gone / c.sigma_t.x);
                    let at = from + place(gone, u, c.sigma_t.x);
                    return Some(Landing { at, weight, g: c.g })
                        .filter(|l| 0.0 < c.sigma_s.x && l.weight.is_finite());
                }
                let scatters = |k: usize| 0.0 < c.sigma_s[k];
                let (channel, u) = choose(scatters, u)?;
                let at = place(gone(channel), u, c.sigma_t[channel]);
                let left = self.media.attenuated(c.sigma_t * at);
                let density = |k: usize| if scatters(k) { c.sigma_t[k] * left[k] / gone(k) } else { 0.0 };
                let n = (0..3).filter(|&k| scatters(k)).count() as f32;
                let weight = c.sigma_s * left * (n / (0..3).map(density).sum::<f32>());
                Some(Landing { at: from + at, weight, g: c.g }).filter(|l| l.weight.is_finite())
            }
            None => self.land_somewhere(u),
        }
    }

    /// A place by free flight in one channel, whose weight is that channel's alone and exact: of what scatters into the ray, where that is the same
    /// part of what is lost all along it.
    pub(crate) fn land_in(&self, channel: usize, u: f32) -> Option<Landing> {
        match self.plain {
            Some((from, to, c)) => {
                if c.sigma_s[channel] <= 0.0 {
                    return None;
                }
                let sigma = c.sigma_t[channel];
                let gone = -(-sigma * (to - from)).exp_m1();
                let at = (-(-u * gone).ln_1p() / sigma).min(to - from);
                let weight = c.sigma_s[channel] / sigma * gone;
                Some(Landing { at: from + at, weight: Vec3::AXES[channel] * weight, g: c.g })
                    .filter(|l| l.weight.is_finite())
            }
            None => {
                let all: f32 = self.segments.iter().map(|s| self.air().depth(*s, s.to)[channel]).sum();
                if all <= 0.0 {
                    return None;
                }
                let gone = -(-all).exp_m1();
                let (at, _, c) = self.reach(channel, -(-u * gone).ln_1p())?;
                let weight = c.sigma_s[channel] / c.sigma_t[channel] * gone;
                Some(Landing { at, weight: Vec3::AXES[channel] * weight, g: c.g })
                    .filter(|l| l.weight.is_finite() && at.is_finite())
            }
        }
    }

    fn land_somewhere(&self, u: f32) -> Option<Landing> {
        let air = self.air();
        let all: Vec3 = self.segments.iter().map(|s| air.depth(*s, s.to)).sum();
        let gone = |k: usize| -(-all[k]).exp_m1();
        let (channel, u) = choose(|k| 0.0 < all[k], u)?;
        let (at, depth, c) = self.reach(channel, -(-u * gone(channel)).ln_1p())?;
        let left = (-depth).exp();
        let density = |k: usize| if 0.0 < all[k] { c.sigma_t[k] * left[k] / gone(k) } else { 0.0 };
        let n = (0..3).filter(|&k| 0.0 < all[k]).count() as f32;
        let weight = c.sigma_s * left * (n / (0..3).map(density).sum::<f32>());
        Some(Landing { at, weight, g: c.g }).filter(|l| l.weight.is_finite() && at.is_finite())
    }

    /// The place up to which one channel's optical depth is `wanted`, the depth of all channels there, and the coefficients.
    fn reach(&self, channel: usize, mut wanted: f32) -> Option<(f32, Rgb, Coefficients)> {
        let air = self.air();
        let mut before = Vec3::ZERO;
        for (i, &s) in self.segments.iter().enumerate() {
            let here = air.depth(s, s.to);
            if wanted < here[channel] || i + 1 == self.segments.len() {
                let at = air.place(s, channel, wanted.min(here[channel]));
                let c = self.media.coefficients(s, self.origin, self.direction, at);
                return Some((at, before + air.depth(s, at), c));
            }
            wanted -= here[channel];
            before += here;
        }
        None
    }
}

/// One of the channels of which something holds, and what is left of the number that chose it.
fn choose(holds: impl Fn(usize) -> bool, u: f32) -> Option<(usize, f32)> {
    let n = (0..3).filter(|&k| holds(k)).count();
    let x = u * n as f32;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    let i = (x as usize).min(n.checked_sub(1)?);
    (0..3).filter(|&k| holds(k)).nth(i).map(|k| (k, (x - i as f32).min(1.0 - f32::EPSILON)))
}

/// A place between `from` and `to` along a ray, by the angle that it is seen under from a lamp, and its density per metre.
pub(crate) fn equi_angular(
    to_lamp: Vec3A,
    direction: Vec3A,
    from: f32,
    to: f32,
    u: f32,
) -> Option<(f32, f32)> {
    let nearest = to_lamp.dot(direction);
    let aside = (to_lamp - direction * nearest).length();
    // Where a ray passes a lamp within the rounding of places, its light is anything; what is left out is this part of the lamp's
    // airlight, which falls with the sine of the angle.
    if !(THROUGH_A_LAMP * to_lamp.length() < aside && from < to) {
        return None;
    }
    let begin = ((from - nearest) / aside).atan();
    let end = if to.is_finite() { ((to - nearest) / aside).atan() } else { FRAC_PI_2 };
    let x = aside * (begin + (end - begin) * u).tan();
    let pdf = aside / ((end - begin) * (aside * aside + x * x));
    let t = (nearest + x).clamp(from, to);
    (0.0 < pdf && pdf.is_finite() && t.is_finite()).then_some((t, pdf))
}

/// A direction of travel after scattering, by the phase function; seen from the receiver backwards, which is the same.
pub(crate) fn henyey_greenstein_direction(direction: Vec3A, g: f32, u: [f32; 2]) -> Vec3A {
    let cos = if g.abs() < 1e-3 {
        // To first order in g, where the closed form cancels.
        let x = 2.0 * u[0] - 1.0;
        x + 1.5 * g * (1.0 - x * x)
    } else {
        let q = (1.0 - g * g) / (1.0 - g + 2.0 * g * u[0]);
        (1.0 + g * g - q * q) / (2.0 * g)
    }
    .clamp(-1.0, 1.0);
    let sin = (1.0 - cos * cos).sqrt();
    let (y, x) = (2.0 * PI * u[1]).sin_cos();
    Frame::new(direction).to_world(Vec3A::new(sin * x, sin * y, cos))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::model::{Density, Medium, Region, Scene};

    /// Free flight in one channel has the weight of the whole way in that channel, and places whose mean is that of the truncated exponential; so has
    /// free flight in all channels together, on average.
    #[test]
    fn landings_weigh_what_is_scattered() {
        let (sigma_s, sigma_a) = (Vec3::new(0.3, 3.0, 0.0), Vec3::new(0.2, 0.0, 1.0));
        let medium = |density| Medium {
            path: String::new(),
            sigma_s,
            sigma_a,
            emission: Vec3::ZERO,
            density,
            g: 0.5,
            region: Region::Box { min: Vec3::ZERO, max: Vec3::splat(2.0) },
        };
        for density in [Density::Constant, Density::Height { base: 0.0, falloff: 1e6 }] {
            let scene = Scene { media: vec![medium(density)], ..Scene::default() };
            let media = Media::new(&scene, Vec3::ZERO).expect("media");
            let way = Way::new(&media, Vec3A::new(1.0, 0.5, -1.0), Vec3A::Z, 10.0).expect("a way");
            let n = 4096;
            let (mut together, mut alone, mut places) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
            for i in 0..n {
                let u = (i as f32 + 0.5) / n as f32;
                together += way.land(u).map_or(Vec3::ZERO, |l| l.weight) / n as f32;
                for k in 0..3 {
                    let Some(l) = way.land_in(k, u).filter(|l| l.weight != Vec3::ZERO) else { continue };
                    alone[k] += l.weight[k] / n as f32;
                    places[k] += (l.at - 1.0) / n as f32;
                    assert!((l.weight / l.weight[k] - Vec3::AXES[k]).length() < 1e-6);
                }
            }
            for k in 0..3 {
                let (s, t) = (f64::from(sigma_s[k]), f64::from(sigma_s[k] + sigma_a[k]));
                let gone = -(-2.0 * t).exp_m1();
                let want = s / t * gone;
                assert!((f64::from(alone[k]) - want).abs() < 1e-4, "{k}: {alone} {want}");
                assert!(
                    (f64::from(together[k]) - want).abs() < 2e-3 * want.max(1e-3),
                    "{k}: {together} {want}"
                );
                if 0.0 < s {
                    let mean = 1.0 / t - 2.0 * (-2.0 * t).exp() / gone;
                    assert!((f64::from(places[k]) - mean).abs() < 1e-3, "{k}: {places} {mean}");
                }
            }
        }
    }

    /// The mean of what places weigh is what is scattered on the way, channel by channel, and in the channel in the middle it is always that.
    #[test]
    fn places_weigh_what_is_scattered() {
        for (sigma_s, sigma_a) in [
            (Vec3::new(0.3, 3.0, 1.0), Vec3::new(0.2, 0.0, 0.1)),
            (Vec3::splat(0.7), Vec3::splat(0.1)),
            (Vec3::new(1e-6, 2e-6, 5e-6), Vec3::ZERO),
            (Vec3::splat(40.0), Vec3::ZERO),
        ] {
            let medium = Medium {
                path: String::new(),
                sigma_s,
                sigma_a,
                emission: Vec3::ZERO,
                density: Density::Constant,
                g: 0.0,
                region: Region::Box { min: Vec3::ZERO, max: Vec3::splat(2.0) },
            };
            let media =
                Media::new(&Scene { media: vec![medium], ..Scene::default() }, Vec3::ZERO).expect("media");
            let ray = (Vec3A::new(1.0, 0.5, -1.0), Vec3A::Z, 10.0);
            let crossed = Crossed::new(&media, ray);
            let way = Way::across(&media, ray, &crossed).expect("a way");
            let n = 1000;
            let mut mean = Vec3::ZERO;
            for i in 0..n {
                let p = way.places(&crossed, (i as f32 + 0.5) / n as f32).expect("places");
                mean += p.weights.iter().sum::<Vec3>() / n as f32;
                let last = p.first + p.step * (PARTS - 1) as f32;
                assert!(1.0 <= p.first && last <= 3.0, "{} {last}", p.first);
            }
            for k in 0..3 {
                let (s, t) = (f64::from(sigma_s[k]), f64::from(sigma_s[k] + sigma_a[k]));
                let want = s / t * -(-2.0 * t).exp_m1();
                assert!((f64::from(mean[k]) / want - 1.0).abs() < 1e-4, "{sigma_s} {k}: {mean} {want}");
            }
        }
    }

    #[test]
    fn depths_are_logarithms() {
        for i in 0..1000u16 {
            let x = f32::from(i) / 1000.0;
            let want = -(-f64::from(x)).ln_1p();
            assert!((f64::from(depth_of(x)) - want).abs() <= 2.0 * f64::from(f32::EPSILON) * want, "{x}");
        }
    }
}
