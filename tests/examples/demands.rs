//! Measures what README says of accuracy over time, hard cases and effects, and writes it there:
//! `cargo run --release -p suite --example demands`, about an hour and a half on two cores. With the words `study`, `target`, `stability` and `effects` it
//! does these alone; with `readme` it only puts together what lies in `data`.

#![expect(clippy::print_stdout, reason = "progress is reported")]

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use suite::scenes::lamps::lamps;
use suite::{root, tool};

/// A study that README shows.
struct Study {
    /// Folder below `data`.
    folder: &'static str,
    /// What it is of, in README.
    what: &'static str,
    /// Arguments beside the scene.
    args: &'static [&'static str],
    /// Plots that README shows.
    plots: &'static [&'static str],
}

const STUDIES: [Study; 2] = [
    Study {
        folder: "study-hall",
        what: "the embedded hall with its haze",
        args: &["--texels", "6000", "--reference-samples", "512"],
        plots: &["pareto", "samples", "media-rung", "volume-resolution", "denoising", "texel-density"],
    },
    Study {
        folder: "study-lamps",
        what: "a generated hall with 5,000 lamps and 50,000 emissive triangles",
        args: &[
            "--texels",
            "6000",
            "--reference-samples",
            "512",
            "--knobs",
            "samples,light samples,light threshold,light choice",
        ],
        plots: &["light-samples", "light-choice"],
    },
];

/// What the whole-tool tests write.
const TESTS: [&str; 3] = ["target", "stability", "effects"];

/// What can be asked for.
const WORDS: [&str; 5] = ["study", "target", "stability", "effects", "readme"];

fn main() -> Result<(), Box<dyn Error>> {
    let asked: Vec<String> = std::env::args().skip(1).collect();
    if let Some(odd) = asked.iter().find(|a| !WORDS.contains(&a.as_str())) {
        return Err(format!("{odd}: write some of {}", WORDS.join(", ")).into());
    }
    let wanted = |word: &str| asked.is_empty() || asked.iter().any(|a| a == word);
    if wanted("study") {
        for study in &STUDIES {
            measure(study)?;
        }
    }
    for test in TESTS {
        if wanted(test) {
            println!("{test}");
            let status = Command::new(env!("CARGO"))
                .args([
                    "test",
                    "--release",
                    "-p",
                    "suite",
                    "--test",
                    test,
                    "--",
                    "--nocapture",
                    "--test-threads",
                    "1",
                ])
                .current_dir(root())
                .env("UPDATE_EXPECT", "1")
                .env("RUN_SLOW_TESTS", "1")
                .status()?;
            if !status.success() {
                return Err(format!("{test} failed").into());
            }
        }
    }
    readme()
}

/// Studies a scene and keeps its files in `data`.
fn measure(study: &Study) -> Result<(), Box<dyn Error>> {
    let dir = tempfile::tempdir()?;
    let scene = dir.path().join(format!("{}.glb", study.folder.trim_start_matches("study-")));
    let bytes = if study.folder == "study-lamps" {
        lamps(5_000, 50_000)
    } else {
        fs::read(root().join("data/hall.glb"))?
    };
    fs::write(&scene, bytes)?;
    let name = scene.to_str().ok_or("a path")?;
    let first = ["study", name, "-o", "out", "--progress", "plain"];
    // Progress goes to the terminal.
    let done = Command::new(tool::bake_path())
        .args([&first[..], study.args].concat())
        .current_dir(dir.path())
        .stderr(std::process::Stdio::inherit())
        .output()?;
    if !matches!(done.status.code(), Some(0 | 1)) {
        return Err("the study failed".into());
    }
    let to = root().join("data").join(study.folder);
    if to.is_dir() {
        fs::remove_dir_all(&to)?;
    }
    fs::create_dir_all(&to)?;
    for file in fs::read_dir(dir.path().join("out"))? {
        let file = file?;
        // The page has all plots once more; whoever wants it makes it in their own folder.
        if file.file_name() != "study.html" {
            fs::copy(file.path(), to.join(file.file_name()))?;
        }
    }
    let said = String::from_utf8(done.stdout)?;
    fs::write(to.join("said.md"), sentences(study, &said))?;
    Ok(())
}

/// What a study said, as Markdown.
fn sentences(study: &Study, said: &str) -> String {
    let mut text = format!("Of {}, {}:\n\n", study.what, tool::machine());
    for line in said.lines() {
        text += &format!("- {line}\n");
    }
    text
}

/// Puts what lies in `data` into README, between the comments that name it.
fn readme() -> Result<(), Box<dyn Error>> {
    let path = root().join("README.md");
    let mut text = fs::read_to_string(&path)?;
    for study in &STUDIES {
        let folder = PathBuf::from("data").join(study.folder);
        let mut block = fs::read_to_string(root().join(&folder).join("said.md"))?;
        block += "\n";
        for plot in study.plots {
            block += &format!("![{}]({}/{plot}.svg)\n", plot.replace('-', " "), folder.display());
        }
        text = put(&text, study.folder, &block)?;
    }
    for name in ["targets", "effects"] {
        text = put(&text, name, &fs::read_to_string(root().join(format!("data/{name}.md")))?)?;
    }
    write(&path, &text)
}

fn write(path: &Path, text: &str) -> Result<(), Box<dyn Error>> {
    fs::write(path, text)?;
    println!("wrote {}", path.display());
    Ok(())
}

/// The text with a block between the comments of its name.
fn put(text: &str, name: &str, block: &str) -> Result<String, Box<dyn Error>> {
    let (begin, end) = (format!("<!-- {name} -->\n"), format!("<!-- end of {name} -->"));
    let (before, rest) = text.split_once(&begin).ok_or_else(|| format!("README has no {begin}"))?;
    let (_, after) = rest.split_once(&end).ok_or_else(|| format!("README has no {end}"))?;
    Ok(format!("{before}{begin}{}\n{end}{after}", block.trim_end()))
}
