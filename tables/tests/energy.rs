//! Closed forms and balances of energy that responses have to obey.

use std::f64::consts::PI;
use tables::harmonics::zonal::{CLAMPED_COSINE, legendre};
use tables::response::directional::HalfSpace;
use tables::response::interpolation::LogAxis;
use tables::response::quadrature::tanh_sinh;
use tables::response::{directional, moments, patch, point};

/// sqrt(4 pi): the first coefficient times this is the fluence.
fn to_fluence() -> f64 {
    (4.0 * PI).sqrt()
}

/// Without absorption every photon scatters again: the fluence of each order integrates to 4 pi over space.
#[test]
fn every_order_carries_all_energy() {
    for g in [-0.7, 0.0, 0.5, 0.8] {
        let mut sums = [0.0; moments::ORDERS];
        let rule = tanh_sinh(96);
        // Trapezoids in ln D, for an integrand that vanishes at both ends. The higher orders reach far for g > 0.
        let n = 160;
        let axis = LogAxis { first: 1e-3, last: 200.0, n };
        let step = (axis.last / axis.first).ln() / (n - 1) as f64;
        for d in axis.nodes() {
            let shell = 4.0 * PI * d * d * (-d).exp() * to_fluence() * step;
            sums[0] += shell * point::single_scaled(&rule, d, g)[0];
            for (sum, order) in sums[1..].iter_mut().zip(moments::orders_scaled(d, g)) {
                *sum += shell * order[0];
            }
        }
        for (k, sum) in sums.iter().enumerate() {
            let off = sum / (4.0 * PI) - 1.0;
            assert!(off.abs() < 2e-4, "g {g} order {}: {off:e}", k + 1);
        }
    }
}

/// All orders of an albedo near 1, unscattered light included, tend to the diffusion of 3 (1 - g) / D.
#[test]
fn all_orders_tend_to_diffusion() {
    let rule = tanh_sinh(96);
    let total = |d: f64, g: f64| {
        let alpha: f64 = 1.0 - 1e-10;
        let nu = moments::decay(alpha, g);
        let rest = moments::rest_scaled(d, g, &[alpha])[0][0] * (-nu * d).exp() / d;
        let direct = (-d).exp() / (d * d);
        direct + to_fluence() * (point::single(&rule, d, g)[0] + rest)
    };
    assert!((total(4.0, 0.0) * 4.0 - 3.0025).abs() < 1e-3, "{}", total(4.0, 0.0) * 4.0);
    for (d, g) in [(30.0, 0.0), (30.0, 0.5), (30.0, -0.5), (200.0, 0.8)] {
        let limit = 3.0 * (1.0 - g) / d;
        assert!((total(d, g) / limit - 1.0).abs() < 2e-3, "{d} {g}: {} {limit}", total(d, g));
    }
}

/// The sum of single orders is the sum of all of them where few count.
#[test]
fn orders_sum_to_the_rest() {
    for (d, g) in [(0.01, 0.4), (1.0, -0.6), (1.0, 0.0), (12.0, 0.3)] {
        let alpha: f64 = 0.15;
        let rest = moments::rest_scaled(d, g, &[alpha])[0].map(|v| v * (-moments::decay(alpha, g) * d).exp());
        let orders = moments::orders_scaled(d, g);
        for l in 0..rest.len() {
            let sum: f64 =
                orders.iter().enumerate().map(|(n, o)| alpha.powf(n as f64) * o[l] * (-d).exp()).sum();
            assert!((sum - rest[l]).abs() < 2e-5 * rest[0], "{d} {g} {l}: {sum} {}", rest[l]);
        }
    }
}

/// Patches that face every way in turn shine like a point of a quarter of a candela.
#[test]
fn patches_of_all_directions_are_a_point() {
    let rule = tanh_sinh(48);
    let axis = LogAxis { first: 1e-4, last: 60.0, n: 56 };
    let once = patch::Orders::once(axis);
    let orders = patch::Orders::new(axis, 1.0, &once);
    let cosines: Vec<(f64, f64)> = tanh_sinh(20).iter().flat_map(|n| [(n.x, n.w), (-n.x, n.w)]).collect();
    let angles: Vec<f64> = cosines.iter().map(|c| c.0.acos()).collect();
    let more = orders.orders(4, &angles);
    for i in [10, 24, 34, 44, 50] {
        let d = axis.node(i);
        let mean = |f: &dyn Fn(usize) -> f64| -> f64 {
            cosines.iter().enumerate().map(|(k, c)| 0.5 * c.1 * f(k)).sum()
        };
        let single = mean(&|k| patch::single_scaled(&rule, d, angles[k], &[0.0])[0][0]);
        let want = 0.25 * point::single_scaled(&tanh_sinh(96), d, 0.0)[0];
        assert!((single / want - 1.0).abs() < 1e-6, "{d}: {single} {want}");
        let wanted = moments::orders_scaled(d, 0.0);
        for (n, order) in more.iter().enumerate() {
            // All bands that are symmetric about the way to the patch.
            for l in 0..5 {
                let got = mean(&|k| order[i][k][l * (l + 1) / 2]);
                let want = 0.25 * wanted[n][l];
                assert!(
                    (got - want).abs() < 3e-3 * 0.25 * wanted[n][0],
                    "D {d} order {} l {l}: {got} {want}",
                    n + 2
                );
            }
        }
    }
}

/// Under a sun without absorption the fluence deep in a half space tends to sqrt(3) H(1) = 5.0364 (\[Cha50\] Chandrasekhar,
/// "Radiative Transfer", H function of isotropic scattering), and every order is right at the plane, where it is a moment of
/// the exponential integral: order 1 has half of 2 ln 2 of fluence there.
#[test]
fn half_space_under_a_sun() {
    let axis = LogAxis { first: 1e-5, last: 200.0, n: 96 };
    let rest = HalfSpace::new(axis, 0.0).rest(1.0);
    let rule = tanh_sinh(96);
    let i = 84;
    let d = axis.node(i);
    let fluence = to_fluence() * (rest[i][0] + directional::single(&rule, d, 0.0)[0]) + (-d).exp();
    assert!((fluence / 5.0364 - 1.0).abs() < 5e-3, "{d}: {fluence}");
    let top = to_fluence() * directional::single(&rule, 1e-9, 0.0)[0];
    assert!((top - 0.5 * 2f64.ln()).abs() < 1e-6, "{top}");
}

#[test]
fn fits_keep_most_of_the_irradiance() {
    let rule = tanh_sinh(48);
    let mut worst = 0.0f64;
    for d in [0.01, 0.3, 3.0] {
        for degrees in [0.0f64, 40.0, 90.0, 130.0, 180.0] {
            let response = patch::single(&rule, d, degrees.to_radians(), 0.0);
            let fit = patch::Fit::new(&response);
            let [x, y, z] = fit.axis();
            assert!((x * x + y * y + z * z - 1.0).abs() < 1e-12);
            let sh = patch::expand(&response);
            for k in 0..200 {
                // Normals all over the sphere, by the golden angle.
                let c = 1.0 - (2.0 * f64::from(k) + 1.0) / 200.0;
                let phi = 2.399_963 * f64::from(k);
                let s = (1.0 - c * c).sqrt();
                let n = [s * phi.cos(), s * phi.sin(), c];
                let full = {
                    let lobe = tables::harmonics::real::lobe(&sh, n);
                    lobe.iter().zip(CLAMPED_COSINE).map(|(a, b)| a * b).sum::<f64>()
                };
                let p = legendre(x * n[0] + y * n[1] + z * n[2]);
                let lobe: f64 = (0..p.len()).map(|l| fit.zh[l] * CLAMPED_COSINE[l] * p[l]).sum();
                worst = worst.max((full - lobe).abs() / patch::fluence(&response));
            }
        }
    }
    // What the lobe costs at worst, as a part of the fluence; measured 5.5 %.
    assert!(worst < 0.06, "{worst}");
}
