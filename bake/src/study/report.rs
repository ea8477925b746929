//! A study as files: `study.csv`, an SVG for each knob, `pareto.svg`, and `study.html` with all of it.

use crate::error::{Error, Result};
use crate::study::figures::Row;
use crate::study::knobs::Measure;
use crate::study::plots::{self, Curve};
use crate::study::sentences::{self, percent, seconds};
use crate::study::{Report, Turned};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Where and when a study was made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Made {
    /// Model of the processor.
    pub cpu: String,
    /// Threads.
    pub threads: usize,
    /// The day, such as 2026-11-30.
    pub date: String,
    /// Version of the program.
    pub version: String,
}

/// The file that says that a folder is a study.
pub const CSV: &str = "study.csv";

const HEADER: &str = "knob,base,setting,usual,measure,options,processor_seconds,sampling_seconds,wall_seconds,error,error_std_err,noise,bias,error_all_texels,stated_error,competes,front\n";

/// All rows as comma-separated values.
#[must_use]
pub fn csv(report: &Report) -> String {
    let mut text = HEADER.to_owned();
    let measure = |r: &Row| {
        let knob = report.knobs.iter().find(|k| k.knob.name == r.knob);
        knob.map_or(Measure::Texels, |k| k.knob.measure).name()
    };
    for r in rows(report) {
        let e = &r.errors;
        let stated = r.stated.map_or_else(String::new, |s| format!("{s:.6}"));
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{:.4},{:.4},{:.4},{:.6},{:.6},{:.6},{:.6},{:.6},{stated},{},{}",
            quoted(&r.knob),
            quoted(&r.base),
            quoted(&r.setting),
            r.usual,
            measure(r),
            quoted(&r.args),
            r.cost.seconds(),
            r.cost.sampling,
            r.cost.wall,
            e.error,
            e.uncertainty,
            e.noise,
            e.bias,
            e.all,
            r.competes,
            r.front
        );
    }
    text
}

fn rows(report: &Report) -> impl Iterator<Item = &Row> {
    report.presets.iter().chain(report.knobs.iter().flat_map(|k| &k.rows))
}

/// A field with commas or quotes in it, as RFC 4180 says.
fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n']) {
        format!("\"{}\"", field.replace('"', "\"\""))
    } else {
        field.to_owned()
    }
}

/// Knobs of one name, each turned on another preset, belong together.
fn together(report: &Report) -> Vec<(&'static str, Vec<&Turned>)> {
    let mut out: Vec<(&'static str, Vec<&Turned>)> = Vec::new();
    for t in &report.knobs {
        match out.iter_mut().find(|(name, _)| *name == t.knob.name) {
            Some((_, list)) => list.push(t),
            None => out.push((t.knob.name, vec![t])),
        }
    }
    out
}

/// Name of a knob's plot.
fn file_name(knob: &str) -> String {
    format!("{}.svg", knob.replace(' ', "-").to_lowercase())
}

/// What a line joins: settings that are numbers, and the usual one after them where it is none because it sets no limit. Nothing where words alone are chosen from.
fn joined(rows: &[Row]) -> Vec<&Row> {
    let is_number = |r: &&Row| r.setting.parse::<f64>().is_ok();
    let any = rows.iter().any(|r| is_number(&r));
    rows.iter().filter(|r| any && (is_number(r) || r.usual)).collect()
}

/// The plots by file name.
fn plots(report: &Report) -> Result<BTreeMap<String, String>> {
    let mut out = BTreeMap::new();
    for (name, list) in together(report) {
        let curves: Vec<Curve<'_>> = list
            .iter()
            .filter(|t| !t.rows.is_empty())
            .map(|t| Curve {
                name: t.knob.base.0.clone(),
                line: joined(&t.rows),
                rows: t.rows.iter().collect(),
            })
            .collect();
        if !curves.is_empty() {
            out.insert(file_name(name), plots::knob(&format!("{name} ({})", report.scene), &curves)?);
        }
    }
    let competes: Vec<&Row> = rows(report).filter(|r| r.competes).collect();
    let mut front: Vec<&Row> = competes.iter().copied().filter(|r| r.front).collect();
    front.sort_by(|a, b| a.cost.seconds().total_cmp(&b.cost.seconds()));
    let curves = [
        Curve { name: "every bake".to_owned(), rows: competes, line: Vec::new() },
        Curve { name: "front".to_owned(), line: front.clone(), rows: front },
        Curve { name: "presets".to_owned(), rows: report.presets.iter().collect(), line: Vec::new() },
    ];
    out.insert("pareto.svg".to_owned(), plots::pareto(&format!("all knobs ({})", report.scene), &curves)?);
    Ok(out)
}

/// Writes a study into a folder that [`prepare`] has made.
///
/// # Errors
///
/// [`Error::Io`].
pub fn write(report: &Report, made: &Made, folder: &Path) -> Result<()> {
    let plots = plots(report)?;
    // Those of an older study of more knobs would not fit any more.
    for stale in report.names.iter().map(|n| file_name(n)).filter(|n| !plots.contains_key(n)) {
        let path = folder.join(stale);
        if path.is_file() {
            fs::remove_file(&path).map_err(Error::io(&path, "cannot remove"))?;
        }
    }
    let html = ("study.html".to_owned(), html(report, made, &plots));
    let files = std::iter::once((CSV.to_owned(), csv(report))).chain(plots).chain([html]);
    // Each file is there as a whole or not at all.
    for (name, text) in files {
        let (part, path) = (folder.join(format!(".{name}.part")), folder.join(&name));
        fs::write(&part, text).map_err(Error::io(&part, "cannot write"))?;
        fs::rename(&part, &path).map_err(Error::io(&path, "cannot write"))?;
    }
    Ok(())
}

/// Makes a folder for a study, or takes one that holds an older one, which stays until the new one is done.
///
/// # Errors
///
/// [`Error::Usage`] where it holds anything else, [`Error::Io`] where it cannot be made or written into.
pub fn prepare(folder: &Path) -> Result<()> {
    let others = fs::read_dir(folder).map(|mut entries| entries.next().is_some()).unwrap_or(false);
    if others && !folder.join(CSV).is_file() {
        return Err(Error::Usage(format!(
            "{}: is there and is no study; name another folder with -o",
            folder.display()
        )));
    }
    fs::create_dir_all(folder).map_err(Error::io(folder, "cannot create"))?;
    let csv = folder.join(CSV);
    if csv.is_file() { Ok(()) } else { fs::write(&csv, HEADER).map_err(Error::io(&csv, "cannot write")) }
}

/// Takes back what [`prepare`] made where no study came of it; a folder with an older study stays as it is.
pub fn abandon(folder: &Path) {
    let csv = folder.join(CSV);
    if fs::read(&csv).is_ok_and(|text| text == HEADER.as_bytes()) {
        // Nothing is lost if either fails: there is nothing in them.
        let _ = fs::remove_file(&csv);
        let _ = fs::remove_dir(folder);
    }
}

const STYLE: &str = "body{font:16px/1.5 sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222}\
    table{border-collapse:collapse;font-size:14px;margin:1rem 0}td,th{padding:.2rem .7rem;text-align:right;border-bottom:1px solid #ddd}\
    td:first-child,th:first-child{text-align:left}svg{max-width:100%;height:auto}.bad{color:#b00}tr.usual td{font-weight:bold}";

fn html(report: &Report, made: &Made, plots: &BTreeMap<String, String>) -> String {
    let mut t = String::new();
    let title = format!("What accuracy costs in time: {}", escaped(&report.scene));
    // Writing to a string cannot fail, here and below.
    let _ = write!(
        t,
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>{title}</title><style>{STYLE}</style>\n<h1>{title}</h1>\n\
         <p>{} texels, {:.3} a metre. Unless a knob says otherwise errors are root mean squares of luminance against two references of {} unbiased paths a texel, \
         whose own noise ({} of the mean) does not count, as parts of the mean; of texels the worst hundredth is left out, as the references' \
         stated errors say. Noise is what {} seeds differ by, bias is the rest; hollow points in the plots are bias. Seconds are those of processors for all \
         that a knob can change: pilot, light grid, cache, sampling, denoising; the last two count {:.2} times, for as many texels as the scene has at its own density. Measured on {} with {} threads, {}, version {}.</p>\n",
        report.texels,
        report.texels_per_metre,
        report.options.reference_samples,
        percent(report.reference_noise),
        report.options.seeds,
        report.times,
        escaped(&made.cpu),
        made.threads,
        made.date,
        made.version
    );
    let _ = write!(
        t,
        "<h2>Presets and the front</h2>\n{}\n<ul>\n",
        plots.get("pareto.svg").map_or("", String::as_str)
    );
    for s in &report.standings {
        let class = if s.holds() { "" } else { " class=\"bad\"" };
        let _ = writeln!(t, "<li{class}>{}</li>", escaped(&sentences::standing(s)));
    }
    t += "</ul>\n<p>Two bakes are compared at the same error by as many samples as give it, if noise falls with their root.</p>\n";
    t += &table(report.presets.iter());
    for (name, list) in together(report) {
        let _ = writeln!(t, "<h2>{}</h2>", escaped(name));
        if let Some(first) = list.first() {
            let _ = writeln!(
                t,
                "<p>{} (<code>{}</code>). {}</p>",
                escaped(first.knob.about),
                escaped(first.knob.option),
                first.knob.measure.words()
            );
        }
        for turned in &list {
            let on = if 1 < list.len() { format!("On {}: ", turned.knob.base.0) } else { String::new() };
            let _ = writeln!(t, "<p>{}{}</p>", escaped(&on), escaped(&sentences::about(turned)));
        }
        if let Some(plot) = plots.get(&file_name(name)) {
            let _ = write!(t, "{plot}\n{}", table(list.iter().flat_map(|l| &l.rows)));
        }
    }
    t += "</html>\n";
    t
}

fn table<'a>(rows: impl Iterator<Item = &'a Row>) -> String {
    let mut t = String::from(
        "<table><tr><th>setting</th><th>on</th><th>seconds</th><th>error</th><th>noise</th><th>bias</th><th>all texels</th><th>stated</th></tr>\n",
    );
    for r in rows {
        let e = &r.errors;
        let bias = if e.is_biased() { percent(e.bias) } else { "-".to_owned() };
        let _ = writeln!(
            t,
            "<tr{}><td>{}</td><td>{}</td><td>{}</td><td>{} ± {}</td><td>{}</td><td>{bias}</td><td>{}</td><td>{}</td></tr>",
            if r.usual { " class=\"usual\"" } else { "" },
            escaped(&r.setting),
            escaped(&r.base),
            seconds(r.cost.seconds()),
            percent(e.error),
            percent(e.uncertainty),
            percent(e.noise),
            percent(e.all),
            r.stated.map_or_else(|| "-".to_owned(), percent)
        );
    }
    t + "</table>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_quoted_where_they_have_to_be() {
        assert_eq!(quoted("a b"), "a b");
        assert_eq!(quoted("8,16"), "\"8,16\"");
        assert_eq!(quoted("say \"x\""), "\"say \"\"x\"\"\"");
    }

    #[test]
    fn a_folder_of_something_else_is_left_alone() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        assert!(prepare(&dir.path().join("none")).is_ok());
        assert!(prepare(&dir.path().join("none")).is_ok(), "its own");
        abandon(&dir.path().join("none"));
        assert!(!dir.path().join("none").exists());
        fs::write(dir.path().join("file"), "x").expect("written");
        assert!(prepare(&dir.path().join("file")).is_err(), "no folder");
        fs::write(dir.path().join("thesis.txt"), "x").expect("written");
        assert!(prepare(dir.path()).is_err());
    }
}
