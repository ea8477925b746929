//! The window of the runtime sample, on a display that nobody looks at: it opens, takes keys and closes.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::{
    fs,
    io::{BufRead, BufReader, Read},
    path::Path,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use glam::Vec3;
use image::RgbImage;
use suite::{
    gltf::{Glb, Kind, Material, Node},
    graphics,
    shape::{ALL, Shape},
    tool,
};

/// Ends a command that is left behind.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A display of 800 x 600 pixels whose contents are in a file.
struct Display {
    _server: Ended,
    name: String,
    screen: tempfile::TempDir,
}

impl Display {
    fn open() -> Self {
        let screen = tempfile::tempdir().unwrap();
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "800x600x24", "-fbdir"])
            .arg(screen.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
        Self { _server: Ended(server), name: format!(":{}", line.trim()), screen }
    }

    fn xdotool(&self, args: &[&str]) {
        let done = Command::new("xdotool").args(args).env("DISPLAY", &self.name).output().unwrap();
        assert!(done.status.success(), "xdotool {args:?}: {}", String::from_utf8_lossy(&done.stderr));
    }

    /// What is to be seen: an X window dump, whose header has 32-bit numbers, the highest byte first.
    fn picture(&self) -> RgbImage {
        let dump = fs::read(self.screen.path().join("Xvfb_screen0")).unwrap();
        let number = |i: usize| u32::from_be_bytes(dump[4 * i..4 * i + 4].try_into().unwrap()) as usize;
        let (width, height, line, colors) = (number(4), number(5), number(12), number(19));
        let start = number(0) + 12 * colors;
        RgbImage::from_fn(u32::try_from(width).unwrap(), u32::try_from(height).unwrap(), |x, y| {
            let at = start + y as usize * line + 4 * x as usize;
            image::Rgb([dump[at + 2], dump[at + 1], dump[at]])
        })
    }
}

/// Waits for something to be true.
#[track_caller]
fn wait(what: &str, mut is: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is() {
        assert!(start.elapsed() < Duration::from_secs(60), "waited for {what}");
        thread::sleep(Duration::from_millis(50));
    }
}

/// Two bakes of a room, side by side.
fn bakes() -> tempfile::TempDir {
    let mut glb = Glb::new();
    let grey = glb.material(&Material::matte("grey", [0.6, 0.5, 0.4]));
    let mut room = Shape::default();
    room.cuboid([-2.0, 0.0, -2.0], [2.0, 2.5, 2.0], ALL);
    let mesh = glb.mesh("room", &[(&room.inside_out(), grey)]);
    glb.node(Node::new("room").mesh(mesh));
    let light = glb.light("lamp", Kind::Point, [1.0, 0.8, 0.6], 100.0);
    glb.node(Node { light: Some(light), ..Node::new("lamp").at([0.5, 2.0, 0.5]) });
    glb.camera("eye", Vec3::new(-1.5, 1.2, 1.5), Vec3::new(0.0, 1.0, 0.0), 1.0);
    let fog = serde_json::json!({ "sigma_s": 0.2, "box": { "min": [-2, 0, -2], "max": [2, 2.5, 2] } });
    glb.scene_extra("media", serde_json::json!([fog]));
    let dir = tool::folder_with(&glb.finish());
    for media in ["bounded", "off"] {
        let out = format!("bakes/{media}");
        let few = ["--samples", "16", "--texels-per-metre", "6", "--progress", "none"];
        let _ =
            tool::bake(&[&["run", "scene.glb", "-o", &out, "--media", media], &few[..]].concat(), dir.path())
                .expect(0);
    }
    dir
}

/// Presses F12 and returns the picture that is written then.
fn snap(display: &Display, dir: &Path, name: &str) -> RgbImage {
    let path = dir.join(name);
    display.xdotool(&["key", "F12"]);
    let mut picture = None;
    wait(name, || {
        picture = image::open(&path).ok();
        picture.is_some()
    });
    picture.unwrap().to_rgb8()
}

fn mean_difference(a: &RgbImage, b: &RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let sum: u64 = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.as_raw().len() as f64
}

#[test]
fn a_window_takes_keys_and_closes() {
    let test = "a_window_takes_keys_and_closes";
    if !graphics::available(test) || !graphics::display(test) {
        return;
    }
    let dir = bakes();
    let display = Display::open();
    let mut app = Command::new(tool::runtime_sample_path())
        .args(["bakes", "--size", "640x400", "--no-balls"])
        .current_dir(dir.path())
        .env("DISPLAY", &display.name)
        .env_remove("WAYLAND_DISPLAY")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut errors = app.stderr.take().unwrap();
    let errors = thread::spawn(move || {
        let mut text = String::new();
        let _ = errors.read_to_string(&mut text);
        text
    });
    let mut app = Ended(app);
    display.xdotool(&["search", "--sync", "--name", "runtime-sample", "windowfocus", "--sync"]);

    let first = snap(&display, dir.path(), "bounded-000.png");
    assert_eq!(first.dimensions(), (640, 400));
    let dark = || {
        let screen = display.picture();
        let left = screen.enumerate_pixels().filter(|(x, y, _)| *x < 200 && *y < 200);
        left.filter(|(.., p)| p.0.iter().all(|v| *v < 60)).count()
    };
    // The first frame has no panel yet.
    wait("the panel", || 20_000 < dark());
    // What is on the screen is this picture, beside the panel on the left; the keys on the right go away.
    display.xdotool(&["key", "h"]);
    wait("the picture on the screen", || {
        let screen = display.picture();
        let strip = |p: &RgbImage| image::imageops::crop_imm(p, 300, 20, 320, 360).to_image();
        mean_difference(&strip(&screen), &strip(&first)) < 1.0
    });
    assert!(20_000 < dark(), "{} dark pixels where the panel should be", dark());

    let snaps: Vec<RgbImage> = [
        // The lightmap alone, then lit again but without fog, nearer, brighter.
        (&["key", "2"][..], "bounded-001.png"),
        (&["key", "1", "key", "f"], "bounded-002.png"),
        (&["keydown", "w", "sleep", "0.7", "keyup", "w"], "bounded-003.png"),
        (&["key", "plus", "key", "plus"], "bounded-004.png"),
        // The wiper: half of the picture is the other bake, which is brighter. Then that alone.
        (&["key", "f", "key", "x"], "bounded-005.png"),
        (&["key", "x", "key", "Next"], "off-000.png"),
    ]
    .into_iter()
    .map(|(keys, name)| {
        display.xdotool(keys);
        snap(&display, dir.path(), name)
    })
    .collect();
    let mut before = &first;
    for (i, picture) in snaps.iter().enumerate() {
        let changed = mean_difference(before, picture);
        assert!(1.0 < changed, "picture {i} differs by {changed} from the one before");
        before = picture;
    }
    let half = |p: &RgbImage, x: u32| image::imageops::crop_imm(p, x, 0, 318, 400).to_image();
    assert!(
        mean_difference(&half(&snaps[4], 322), &half(&snaps[5], 322)) < 0.5,
        "right of the wiper is the other bake"
    );
    assert!(1.0 < mean_difference(&half(&snaps[4], 0), &half(&snaps[5], 0)), "left of it is not");

    // A window of another size is drawn in that size, and one of a single pixel is no reason to fail.
    let window = ["search", "--name", "runtime-sample"];
    for size in [["1", "1"], ["500", "300"]] {
        display.xdotool(&[&window[..], &["windowsize", "--sync"], &size[..]].concat());
        thread::sleep(Duration::from_millis(300));
    }
    assert_eq!(snap(&display, dir.path(), "off-001.png").dimensions(), (500, 300));

    display.xdotool(&["key", "Escape"]);
    let mut code = None;
    wait("the end", || {
        code = app.0.try_wait().unwrap();
        code.is_some()
    });
    let said = errors.join().unwrap();
    assert!(code.unwrap().success() && !said.contains("panicked"), "{code:?}\n{said}");
}

#[test]
fn without_a_display_it_says_so() {
    if !graphics::available("without_a_display_it_says_so") {
        return;
    }
    let dir = bakes();
    let done = Command::new(tool::runtime_sample_path())
        .arg("bakes")
        .current_dir(dir.path())
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("WAYLAND_SOCKET")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(
        done.status.code() == Some(2)
            && said.contains("there is no display")
            && said.contains("--screenshot"),
        "{said}"
    );
}
