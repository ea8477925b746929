//! White furnaces: emission 1 and albedo rho everywhere give 1 / (1 - rho), whatever scatters in between.

use crate::Group;
use crate::whole::{bake, bake_in, mean, mean_is, sanity};
use suite::scenes::closed::{furnace, round_furnace};

pub(crate) fn group() -> Group {
    let mut group = Group::new("furnaces");
    // Emitters are found in two ways, each weighed, which leaves noise even where nothing varies.
    group.add("rho 0", 5e-3, || {
        mean_is(&bake(&furnace(0.0, 1.0), &["--samples", "64", "--texels-per-metre", "4"]), 1.0)
    });
    for (rho, tolerance) in [(0.5f32, 5e-3), (0.9, 5e-3), (0.99, 0.02)] {
        group.add(format!("rho {rho}, any number of bounces"), tolerance, move || {
            let args = ["--samples", "128", "--texels-per-metre", "4"];
            mean_is(&bake(&furnace(rho, 1.0), &args), 1.0 / (1.0 - f64::from(rho)))
        });
    }
    // Cells of the cache are a few texels wide: here some fit into the room.
    group.add("rho 0.9, paths that end in the cache", 0.02, || {
        mean_is(
            &bake(&furnace(0.9, 1.0), &["--samples", "16", "--texels-per-metre", "24"]),
            1.0 / (1.0 - f64::from(0.9f32)),
        )
    });
    group.add("rho 0.9 within flat faces of an icosphere", 0.01, || {
        mean_is(
            &bake(&round_furnace(0.9, 1.0), &["--samples", "64", "--texels-per-metre", "2"]),
            1.0 / (1.0 - f64::from(0.9f32)),
        )
    });
    for (rho, bounces, tolerance) in [
        (0.5f32, 0, 5e-3),
        (0.5, 1, 5e-3),
        (0.5, 2, 5e-3),
        (0.9, 1, 5e-3),
        (0.9, 5, 5e-3),
        (0.9, 12, 5e-3),
        (0.5, 9, 0.01),
    ] {
        group.add(format!("rho {rho}, {bounces} bounces"), tolerance, move || {
            let text = bounces.to_string();
            let args = ["--samples", "64", "--texels-per-metre", "4", "--bounces", &text];
            let rho64 = f64::from(rho);
            mean_is(&bake(&furnace(rho, 1.0), &args), (1.0 - rho64.powi(bounces + 1)) / (1.0 - rho64))
        });
    }
    for emission in [1e-30f32, 1e30] {
        group.add(format!("rho 0.5, emission {emission:e} nits"), 5e-3, move || {
            let baked = bake(&furnace(0.5, emission), &["--samples", "64", "--texels-per-metre", "4"]);
            mean_is(&baked, 2.0 * f64::from(emission))
        });
    }
    media(&mut group);
    group
}

fn foggy(rung: &str, sigma: &str, g: &str, samples: &str) -> f64 {
    let args = ["--samples", samples, "--texels-per-metre", "4", "--media", rung];
    let baked = bake_in(&furnace(0.5, 1.0), &format!("{{ sigma_s = {sigma}, g = {g} }}"), &args);
    mean_is(&baked, 2.0)
}

fn media(group: &mut Group) {
    for sigma in ["0.01", "1", "10"] {
        for g in ["-0.9", "0", "0.9"] {
            let tolerance = if g == "0.9" && sigma == "10" { 0.08 } else { 0.03 };
            group.add(format!("sigma {sigma}, g {g}, bounded"), tolerance, move || {
                foggy("bounded", sigma, g, "64")
            });
            let name = format!("sigma {sigma}, g {g}, reference");
            let run = move || foggy("reference", sigma, g, "256");
            if sigma == "10" { group.slow(name, 0.03, run) } else { group.add(name, 0.01, run) }
        }
    }
    group.add("sigma 0.1, 1 and 4 by channel, reference", 0.01, || {
        foggy("reference", "[0.1, 1, 4]", "0.5", "256")
    });
    group.add("sigma 100, bounded", 0.01, || foggy("bounded", "100", "0", "64"));
    group.slow("sigma 100, reference", 0.05, || foggy("reference", "100", "0", "256"));
    for sigma in ["1", "10"] {
        // What is allowed is that it is off: 5 % less how far it is.
        group.add(format!("sigma {sigma}, table is off by more than 5 %"), 0.0, move || {
            let args = ["--samples", "16", "--texels-per-metre", "4", "--media", "table"];
            let baked = bake_in(&furnace(0.5, 1.0), &format!("{{ sigma_s = {sigma} }}"), &args);
            (0.05 - (mean(&baked) / 2.0 - 1.0).abs()).max(0.0).max(sanity(&baked))
        });
    }
}
