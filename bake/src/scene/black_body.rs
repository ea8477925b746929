//! Light of black bodies: Planck's law seen by the CIE 1931 observer.
//!
//! The observer is the fit of \[WSS13\] Wyman, Sloan and Shirley, "Simple Analytic Approximations to the CIE XYZ Color Matching
//! Functions" (JCGT 2013), equation 4: within 1 % of luminance for black bodies of 1000 to 10,000 K.

use super::model::Rgb;
use glam::{DMat3, DVec3, dvec3};

/// First and second radiation constants of spectral radiance, W m^2 / sr and m K (CODATA 2018).
const C1: f64 = 1.191_042_972e-16;
/// See [`C1`].
const C2: f64 = 1.438_776_877e-2;

/// Luminous efficacy of radiation at 555 nm, lm / W.
const EFFICACY: f64 = 683.002;

/// Wavelengths that are summed, nm: from, to, and their distance.
const WAVELENGTHS: [f64; 3] = [360.0, 830.0, 1.0];

/// XYZ to linear Rec. 709, columns (IEC 61966-2-1).
const RGB_FROM_XYZ: DMat3 = DMat3::from_cols(
    dvec3(3.240_454_2, -0.969_266, 0.055_643_4),
    dvec3(-1.537_138_5, 1.876_010_8, -0.204_025_9),
    dvec3(-0.498_531_4, 0.041_556, 1.057_225_2),
);

/// A Gaussian whose width differs on its two sides, nm.
fn lobe(x: f64, [height, middle, below, above]: [f64; 4]) -> f64 {
    let t = (x - middle) / if x < middle { below } else { above };
    height * (-0.5 * t * t).exp()
}

fn observer(x: f64) -> DVec3 {
    dvec3(
        lobe(x, [1.056, 599.8, 37.9, 31.0])
            + lobe(x, [0.362, 442.0, 16.0, 26.7])
            + lobe(x, [-0.065, 501.1, 20.4, 26.2]),
        lobe(x, [0.821, 568.8, 46.9, 40.5]) + lobe(x, [0.286, 530.9, 16.3, 31.1]),
        lobe(x, [1.217, 437.0, 11.8, 36.0]) + lobe(x, [0.681, 459.0, 26.0, 13.8]),
    )
}

/// Radiance of a black body, nits in each channel; black at 0 K and below. Colours outside of Rec. 709, which those below 1900 K
/// have, lose what would be negative.
#[must_use]
pub fn radiance(kelvin: f32) -> Rgb {
    let t = f64::from(kelvin);
    if t <= 0.0 || t.is_nan() {
        return Rgb::ZERO;
    }
    let [from, to, step] = WAVELENGTHS;
    let mut xyz = DVec3::ZERO;
    let mut nm = from;
    while nm <= to {
        let metres = nm * 1e-9;
        // exp(x) - 1 of which only its inverse counts, so that overflow is darkness.
        let spectral = C1 / metres.powi(5) / (C2 / (metres * t)).exp_m1();
        xyz += observer(nm) * (spectral * step * 1e-9);
        nm += step;
    }
    (RGB_FROM_XYZ * xyz * EFFICACY).max(DVec3::ZERO).as_vec3()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The candela was once a sixtieth of the light of a square centimetre of a black body at the freezing point of platinum, 2041.4 K on
    /// the scale of today.
    #[test]
    fn platinum_freezes_at_six_hundred_thousand_nits() {
        let nits = radiance(2041.4).dot(Rgb::new(0.2126, 0.7152, 0.0722));
        assert!((nits / 6e5 - 1.0).abs() < 0.02, "{nits}");
    }

    /// A black body of 6500 K is near the white point, D65 of 6504 K, and cooler ones are redder.
    #[test]
    fn hot_bodies_are_white_and_cool_ones_red() {
        let white = radiance(6500.0);
        assert!((white / white.y - 1.0).abs().max_element() < 0.08, "{white}");
        let ember = radiance(1200.0);
        assert!(ember.y < 0.5 * ember.x && ember.z == 0.0, "{ember}");
        assert_eq!(radiance(0.0), Rgb::ZERO);
        assert_eq!(radiance(-5.0), Rgb::ZERO);
        assert_eq!(radiance(20.0), Rgb::ZERO);
    }
}
