//! Scenes that nobody here made, at very low density.

use crate::whole::{covered, sanity};
use crate::{Group, Seen};
use suite::tool;

/// Files beside the checkout, texels per metre, and further arguments.
const SCENES: [(&str, &str, &[&str]); 8] = [
    ("cornell-fazil/cornell-box.glb", "1.5", &[]),
    ("bevy-cornell-box/CornellBox.glb", "0.02", &[]),
    ("lights-bevy-cubes/Cubes.glb", "1", &[]),
    ("lights-pc/Lights.glb", "2", &[]),
    ("lights-wicked/gltf_KHR_lights_punctual_test.glb", "0.1", &[]),
    ("bevy-irradiance-volume/IrradianceVolumeExample.glb", "0.2", &["--sky", "1"]),
    ("godot-living-room/living_room.glb", "0.5", &["--sky", "1"]),
    ("gazebo/gazebo.glb", "8", &["--sky", "1"]),
];

pub(crate) fn group() -> Group {
    let mut group = Group::new("scenes");
    for (file, density, more) in SCENES {
        group.add(format!("{file}, values that are not finite or negative"), 0.0, move || {
            let Some(folder) = suite::shared(file) else { return Seen::Skipped };
            let path = folder.join("scenes").join(file);
            let dir = tempfile::tempdir().expect("a folder");
            let path = path.to_str().expect("a readable path");
            let args = ["run", path, "-o", "out", "--samples", "4", "--texels-per-metre", density];
            let quick = ["--threads", "1", "--progress", "none", "--texture", "none", "--probe-count", "64"];
            let done = tool::bake(&[&args, &quick, more].concat(), dir.path()).expect(0);
            let baked =
                suite::baked::Baked::read(&dir.path().join("out")).unwrap_or_else(|e| panic!("{e}\n{done}"));
            let any = covered(&baked).next().is_some();
            Seen::Worst(if any { sanity(&baked) } else { f64::INFINITY })
        });
    }
    group
}
