//! Changes of the scene with a known effect.

use suite::{
    baked::{Baked, NO_LIGHT},
    scenes::closed::{Room, room},
    tool,
};

fn bake(r: Room, texels_per_metre: f32) -> Baked {
    let density = texels_per_metre.to_string();
    tool::baked(&room(r), &["--samples", "16", "--texels-per-metre", &density])
}

fn values(baked: &Baked) -> impl Iterator<Item = (&String, usize, f32)> {
    let shown =
        baked.pages.iter().flat_map(|p| &p.channels).filter(|(name, _)| !NO_LIGHT.contains(&name.as_str()));
    shown.flat_map(|(name, values)| values.iter().enumerate().map(move |(i, &v)| (name, i, v)))
}

#[test]
fn twice_the_light_is_twice_every_texel_to_the_bit() {
    let one = bake(Room::default(), 6.0);
    let two = bake(Room { radiance: 2.0, candela: 2.0, lux: 2.0, ..Room::default() }, 6.0);
    let mut lit = 0;
    for ((name, i, a), (_, _, b)) in values(&one).zip(values(&two)) {
        assert_eq!((2.0 * a).to_bits(), b.to_bits(), "{name} at {i}: {a} became {b}");
        lit += usize::from(0.0 < a);
    }
    assert!(5000 < lit, "{lit} values are not black");
}

#[test]
fn another_unit_of_length_changes_no_bit() {
    let one = bake(Room::default(), 6.0);
    for k in [-10, 7] {
        let s = 2f32.powi(k);
        let other = bake(Room { length: s, candela: s * s, ..Room::default() }, 6.0 / s);
        assert_eq!(one.pages.len(), other.pages.len());
        for (a, b) in one.pages.iter().zip(&other.pages) {
            assert_eq!((a.width, a.height), (b.width, b.height), "lengths times 2^{k}");
        }
        for ((name, i, a), (_, _, b)) in values(&one).zip(values(&other)) {
            assert_eq!(a.to_bits(), b.to_bits(), "lengths times 2^{k}: {name} at {i}: {a} became {b}");
        }
    }
}

#[test]
fn a_mirrored_scene_gives_mirrored_light() {
    let bake = |mirrored: bool| {
        let args = ["--samples", "256", "--texels-per-metre", "6"];
        tool::baked(&room(Room { mirrored, ..Room::default() }), &args).node_means()
    };
    let (one, other) = (bake(false), bake(true));
    assert!(one.keys().eq(other.keys()));
    for (node, [mean, error]) in &one {
        let [mean_2, error_2] = other[node];
        for c in 0..3 {
            // Texel borders fall on other places, so that partly covered texels weigh differently.
            let allowed = 5e-3 * mean[c] + 5.0 * error[c].hypot(error_2[c]);
            assert!((mean[c] - mean_2[c]).abs() <= allowed, "{node} channel {c}: {mean} and {mean_2}");
        }
    }
}

/// The irradiance cache changes the noise, and the light by no more than its cells blur.
#[test]
fn cached_light_is_the_light_of_paths() {
    let bake = |cache: &str| {
        let args = ["--samples", "256", "--texels-per-metre", "6", "--irradiance-cache", cache];
        tool::baked(&room(Room::default()), &args).node_means()
    };
    let (cached, paths) = (bake("on"), bake("off"));
    assert!(cached.keys().eq(paths.keys()));
    for (node, [mean, error]) in &cached {
        let [want, want_error] = paths[node];
        for c in 0..3 {
            let allowed = 0.02 * want[c] + 5.0 * error[c].hypot(want_error[c]);
            assert!((mean[c] - want[c]).abs() <= allowed, "{node} channel {c}: {mean} and {want}");
        }
    }
}
