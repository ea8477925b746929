//! What the curve of a knob shows, in a sentence.

use crate::study::Turned;
use crate::study::figures::{Row, Standing, WITHIN, slope};

/// Settings whose errors and times differ by less than this are alike.
const ALIKE: f64 = 1.1;

/// A part as per cent, with two or three digits.
#[must_use]
pub fn percent(x: f64) -> String {
    let p = 100.0 * x;
    match p {
        p if p < 5e-3 => "under 0.01 %".to_owned(),
        p if p < 1.0 => format!("{p:.2} %"),
        p if p < 100.0 => format!("{p:.1} %"),
        p => format!("{p:.0} %"),
    }
}

/// Seconds with two or three digits.
#[must_use]
pub fn seconds(s: f64) -> String {
    match s {
        s if s < 0.1 => format!("{:.0} ms", 1e3 * s),
        s if s < 10.0 => format!("{s:.2} s"),
        s if s < 100.0 => format!("{s:.1} s"),
        s => format!("{s:.0} s"),
    }
}

fn most(rows: &[Row], of: impl Fn(&Row) -> f64) -> f64 {
    rows.iter().map(of).fold(0.0, f64::max)
}

fn least(rows: &[Row], of: impl Fn(&Row) -> f64) -> f64 {
    rows.iter().map(of).fold(f64::INFINITY, f64::min)
}

/// 1 / (squared error x time): what a setting brings for its time.
fn efficiency(row: &Row) -> f64 {
    (row.errors.error.powi(2) * row.cost.seconds()).recip()
}

/// One to three sentences about a knob.
#[must_use]
pub fn about(turned: &Turned) -> String {
    let Turned { knob, rows } = turned;
    if let Some(why) = &knob.idle {
        return format!("Nothing to turn here: {why}.");
    }
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return String::new() };
    let error = |r: &Row| r.errors.error;
    let time = |r: &Row| r.cost.seconds();
    let (worst, best) = (most(rows, error), least(rows, error));
    let (slow, fast) = (most(rows, time), least(rows, time));
    if worst < ALIKE * best && slow < ALIKE * fast {
        return format!(
            "It makes no difference on this scene: errors from {} to {}, times from {} to {}.",
            percent(best),
            percent(worst),
            seconds(fast),
            seconds(slow)
        );
    }
    let mut text = format!(
        "From {} to {} the error goes from {} to {} and the time from {} to {}",
        first.setting,
        last.setting,
        percent(error(first)),
        percent(error(last)),
        seconds(time(first)),
        seconds(time(last)),
    );
    let points: Vec<(f64, f64)> = rows.iter().map(|r| (time(r), error(r))).collect();
    let falls = rows.windows(2).all(|w| error(&w[1]) < error(&w[0]) && time(&w[0]) < time(&w[1]));
    if let Some(s) = slope(&points).filter(|_| falls && 3 <= rows.len()) {
        text += &format!(", like the power {s:.2} of the time");
    }
    text += ".";
    let by = |a: &&Row, b: &&Row| efficiency(a).total_cmp(&efficiency(b));
    // Errors that cannot be told from none would bring more than anything.
    let known = || rows.iter().filter(|r| 2.0 * r.errors.uncertainty < r.errors.error);
    if let (Some(choice), Some(usual)) = (known().max_by(by), known().find(|r| r.usual)) {
        let gain = efficiency(choice) / efficiency(usual);
        text += &if choice.setting == usual.setting || gain < ALIKE {
            format!(" The usual {} brings the most for its time, or within a tenth of it.", usual.setting)
        } else {
            format!(
                " {} brings {gain:.1} times as much for its time as the usual {}.",
                choice.setting, usual.setting
            )
        };
    }
    let biased = |r: &&Row| r.errors.noise < r.errors.bias && r.errors.is_biased();
    let list: Vec<String> =
        rows.iter().filter(biased).map(|r| format!("{} by {}", r.setting, percent(r.errors.bias))).collect();
    if !list.is_empty() {
        text += &format!(" More samples do not help where bias rules: {}.", list.join(", "));
    }
    text
}

/// How a preset stands.
#[must_use]
pub fn standing(s: &Standing) -> String {
    match &s.rival {
        None => format!(
            "{}: {} in {}; nothing that was measured gets there sooner.",
            s.preset,
            percent(s.error),
            seconds(s.seconds)
        ),
        Some(rival) => format!(
            "{}: {} in {}; {rival} gets there in {:.2} of the time, which is {} the tenth that is allowed.",
            s.preset,
            percent(s.error),
            seconds(s.seconds),
            s.ratio,
            if WITHIN <= s.ratio { "within" } else { "beyond" }
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(
            [percent(0.0), percent(0.00123), percent(0.0456), percent(3.7)],
            ["under 0.01 %", "0.12 %", "4.6 %", "370 %"]
        );
        assert_eq!(
            [seconds(0.0123), seconds(1.234), seconds(45.6), seconds(321.0)],
            ["12 ms", "1.23 s", "45.6 s", "321 s"]
        );
    }
}
