//! Writes the room and frames of the explosion: `cargo run --release -p suite --example explosion -- FOLDER SIZE TIME`.

#![expect(clippy::expect_used, reason = "a tool of the tests")]
#![expect(clippy::print_stdout, reason = "figures that are reported")]

use std::path::Path;
use suite::scenes::fire;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let folder = Path::new(&args[1]);
    std::fs::create_dir_all(folder).expect("a folder");
    let frame = fire::explosion(args[2].parse().expect("a size"), args[3].parse().expect("a time"));
    std::fs::write(folder.join("room.glb"), fire::dark_room()).expect("a file");
    std::fs::write(folder.join("fire.toml"), frame.write(folder, (20_000.0, 4.0))).expect("a file");
    let lit = frame.heat.iter().filter(|h| 0.0 < **h).count();
    let smoky = frame.smoke.iter().filter(|h| 0.0 < **h).count();
    println!("{lit} voxels glow, {smoky} have smoke");
}
