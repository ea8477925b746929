//! The same bytes at any thread count, and every time.

use suite::{
    scenes::closed::{Room, room},
    tool,
};

#[test]
fn bytes_do_not_depend_on_threads_or_repetition() {
    let bake = |threads: &str| {
        let args = ["--samples", "16", "--texels-per-metre", "6", "--seed", "7", "--threads", threads];
        tool::baked(&room(Room::default()), &args).files
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
fn another_seed_gives_other_noise() {
    let bake = |seed: &str| {
        let args = ["--samples", "4", "--texels-per-metre", "4", "--seed", seed];
        tool::baked(&room(Room::default()), &args).pages[0].channels["R"].clone()
    };
    assert_ne!(bake("1"), bake("2"));
}
