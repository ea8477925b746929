//! The same bytes at any thread count, and every time.

use suite::{
    scenes::{
        closed::{Room, room},
        hall::hall,
        open::all_media,
    },
    tool,
};

#[test]
fn bytes_do_not_depend_on_threads_or_repetition() {
    same_at_any_thread_count(&room(Room::default()), &["--samples", "16", "--texels-per-metre", "6"]);
}

#[test]
fn nor_do_they_in_haze() {
    for media in ["table", "bounded", "reference"] {
        same_at_any_thread_count(&hall(), &["--samples", "2", "--texels-per-metre", "1", "--media", media]);
    }
}

fn same_at_any_thread_count(scene: &[u8], args: &[&str]) {
    let bake = |threads: &str| {
        let args = [args, &["--seed", "7", "--threads", threads]].concat();
        tool::baked(scene, &args).files
    };
    let first = bake("1");
    for name in ["manifest.json", "scene.glb", "lightmap-0.exr"] {
        assert!(first.contains_key(name), "{name} is missing: {:?}", first.keys());
    }
    for threads in ["1", "2", "5"] {
        let other = bake(threads);
        assert!(first.keys().eq(other.keys()), "{:?} and {:?}", first.keys(), other.keys());
        for (name, bytes) in &first {
            assert!(bytes == &other[name], "{name} differs between 1 and {threads} thread(s)");
        }
    }
}

#[test]
fn nor_do_densities_of_media() {
    same_at_any_thread_count(&all_media(), &["--samples", "1", "--texels-per-metre", "2", "--probes", "off"]);
}

#[test]
fn another_seed_gives_other_noise() {
    let bake = |seed: &str| {
        let args = ["--samples", "4", "--texels-per-metre", "4", "--seed", seed];
        tool::baked(&room(Room::default()), &args).pages[0].channels["R"].clone()
    };
    assert_ne!(bake("1"), bake("2"));
}
