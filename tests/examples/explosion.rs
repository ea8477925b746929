//! Writes the room and the explosion at a time from 0 to 1, or so many frames until then:
//! `cargo run --release -p suite --example explosion -- FOLDER SIZE TIME [FRAMES]`.

#![expect(clippy::expect_used, reason = "a tool of the tests")]
#![expect(clippy::print_stdout, reason = "figures that are reported")]

use std::path::Path;
use suite::scenes::fire;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let folder = Path::new(&args[1]);
    std::fs::create_dir_all(folder).expect("a folder");
    let size = args[2].parse().expect("a size");
    let last: f32 = args[3].parse().expect("a time");
    std::fs::write(folder.join("room.glb"), fire::dark_room()).expect("a file");
    let frames: u16 = args.get(4).map_or(1, |n| n.parse().expect("a number of frames"));
    for k in 1..=frames {
        let frame = fire::explosion(size, last * f32::from(k) / f32::from(frames));
        let number = args.get(4).map(|_| u32::from(k));
        let config = frame.write(folder, (20_000.0, 4.0), number);
        std::fs::write(folder.join("fire.toml"), config).expect("a file");
        let lit = frame.heat.iter().filter(|h| 0.0 < **h).count();
        let smoky = frame.smoke.iter().filter(|h| 0.0 < **h).count();
        println!("{lit} voxels glow, {smoky} have smoke");
    }
}
