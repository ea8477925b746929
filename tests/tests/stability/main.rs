//! Hard cases: never a NaN, an infinity or a negative value, and what is right is right to the tolerance stated.
//!
//! One table of cases in groups. `--nocapture` prints it; `UPDATE_EXPECT=1 RUN_SLOW_TESTS=1` writes it to `data/stability.md`, which
//! a plain run compares its cases and tolerances with. `STABILITY=part` runs those whose group and name, as `group: name`, contain the part.

mod exact;
mod furnaces;
mod geometry;
mod lights;
mod numbers;
mod oracle;
mod responses;
mod scenes;
mod segments;
mod whole;

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use std::{env, fs, thread};

/// What a case saw.
enum Seen {
    /// The greatest deviation, in the unit of the tolerance; NaN fails.
    Worst(f64),
    /// What it needs is not there.
    Skipped,
}

impl From<f64> for Seen {
    fn from(worst: f64) -> Self {
        Self::Worst(worst)
    }
}

/// A hard case.
struct Case {
    group: &'static str,
    name: String,
    /// The worst value may be as large as this.
    tolerance: f64,
    /// Runs with `RUN_SLOW_TESTS=1` only.
    slow: bool,
    run: Box<dyn Fn() -> Seen + Send + Sync>,
}

/// Cases of one group.
struct Group {
    name: &'static str,
    cases: Vec<Case>,
}

impl Group {
    fn new(name: &'static str) -> Self {
        Self { name, cases: Vec::new() }
    }

    fn add<T: Into<Seen>>(
        &mut self,
        name: impl Into<String>,
        tolerance: f64,
        run: impl Fn() -> T + Send + Sync + 'static,
    ) {
        let run = Box::new(move || run().into());
        self.cases.push(Case { group: self.name, name: name.into(), tolerance, slow: false, run });
    }

    fn slow<T: Into<Seen>>(
        &mut self,
        name: impl Into<String>,
        tolerance: f64,
        run: impl Fn() -> T + Send + Sync + 'static,
    ) {
        self.add(name, tolerance, run);
        if let Some(last) = self.cases.last_mut() {
            last.slow = true;
        }
    }
}

fn cases() -> Vec<Case> {
    let groups = [
        responses::group(),
        segments::group(),
        geometry::group(),
        lights::group(),
        exact::group(),
        exact::rounding(),
        furnaces::group(),
        numbers::group(),
        scenes::group(),
    ];
    groups.into_iter().flat_map(|g| g.cases).collect()
}

/// What came of a case, and the text of the panic if there was one.
struct Outcome {
    worst: Option<f64>,
    fault: Option<String>,
    seconds: f64,
}

fn run(case: &Case) -> Outcome {
    let begun = Instant::now();
    let (worst, fault) = judge(case);
    Outcome { worst, fault, seconds: begun.elapsed().as_secs_f64() }
}

fn judge(case: &Case) -> (Option<f64>, Option<String>) {
    match catch_unwind(AssertUnwindSafe(|| (case.run)())) {
        Ok(Seen::Skipped) => (None, None),
        Ok(Seen::Worst(worst)) => {
            // Not a number is not below either.
            let fine = worst <= case.tolerance;
            (Some(worst), (!fine).then(|| format!("{worst:.3e}")))
        }
        Err(e) => {
            let text = e.downcast_ref::<String>().cloned();
            let text = text.or_else(|| e.downcast_ref::<&str>().map(|t| (*t).to_owned()));
            (None, Some(text.unwrap_or_else(|| "panicked".to_owned())))
        }
    }
}

/// All of them, as many at once as there are processors.
fn run_all(cases: &[&Case]) -> Vec<Outcome> {
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::new());
    let threads = thread::available_parallelism().map_or(1, usize::from).min(4);
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    let Some(case) = cases.get(k) else { return };
                    let outcome = run(case);
                    done.lock().expect("no case panics").push((k, outcome));
                }
            });
        }
    });
    let mut done = done.into_inner().expect("no case panics");
    done.sort_by_key(|d| d.0);
    done.into_iter().map(|d| d.1).collect()
}

fn number(x: f64) -> String {
    if x == 0.0 { "0".to_owned() } else { format!("{x:.1e}") }
}

/// The columns that a run has to reproduce.
fn head(case: &Case) -> String {
    let slow = if case.slow { " (slow)" } else { "" };
    format!("| {} | {}{slow} | {} |", case.group, case.name, number(case.tolerance))
}

fn table(cases: &[&Case], outcomes: &[Outcome]) -> String {
    let mut out = String::from("| group | case | tolerance | worst seen |\n|---|---|---|---|\n");
    for (case, outcome) in cases.iter().zip(outcomes) {
        let worst = outcome.worst.map_or_else(|| "skipped".to_owned(), number);
        let _ = writeln!(out, "{} {worst} |", head(case));
    }
    out
}

/// Cases that take longer are named, seconds.
const LONG: f64 = 2.0;

const FILE: &str = "data/stability.md";

const INTRODUCTION: &str = "\
# Hard cases

Every case of `tests/tests/stability`, its tolerance, and the worst value seen when this file was written. Values are relative deviations unless the case says
otherwise; a case whose tolerance is 0 is exact to the bit. Any value that is not a number, infinite or negative fails its case.
`UPDATE_EXPECT=1 RUN_SLOW_TESTS=1 cargo test -p suite --test stability` writes this file; a plain run without slow cases compares cases and
tolerances with it.

";

#[test]
#[expect(clippy::print_stdout, reason = "the table is what the test reports")]
fn hard_cases_are_stable() {
    let all = cases();
    let names: BTreeSet<String> = all.iter().map(|c| format!("{}: {}", c.group, c.name)).collect();
    assert_eq!(names.len(), all.len(), "two cases have the same name");
    let part = env::var("STABILITY").unwrap_or_default();
    let update = env::var_os("UPDATE_EXPECT").is_some_and(|v| v == "1");
    let wanted = |c: &&Case| format!("{}: {}", c.group, c.name).contains(&part) && (suite::slow() || !c.slow);
    let chosen: Vec<&Case> = all.iter().filter(wanted).collect();
    assert!(!chosen.is_empty(), "no case is called {part}");
    // Its building is no part of any case's time.
    let _ = suite::tool::bake_path();
    let outcomes = run_all(&chosen);
    let table = table(&chosen, &outcomes);
    println!("{table}\n{} cases", chosen.len());
    for (case, outcome) in chosen.iter().zip(&outcomes).filter(|(_, o)| LONG < o.seconds) {
        println!("{:.1} s: {}: {}", outcome.seconds, case.group, case.name);
    }
    let faults: Vec<String> = chosen
        .iter()
        .zip(&outcomes)
        .filter_map(|(c, o)| {
            let fault = o.fault.as_ref()?;
            Some(format!("{}: {}: {fault}, {:.1e} allowed", c.group, c.name, c.tolerance))
        })
        .collect();
    assert!(faults.is_empty(), "{} of {} cases:\n{}", faults.len(), chosen.len(), faults.join("\n"));
    if !part.is_empty() && !update {
        return;
    }
    let path = suite::root().join(FILE);
    if update {
        assert!(
            part.is_empty() && suite::slow(),
            "{FILE} holds all cases: RUN_SLOW_TESTS=1 without STABILITY"
        );
        assert!(outcomes.iter().all(|o| o.worst.is_some()), "{FILE} holds all cases: some were skipped");
        fs::write(&path, format!("{INTRODUCTION}{table}")).expect("a writable file");
        return;
    }
    let text = fs::read_to_string(&path).expect("a table");
    let written: Vec<&str> = text.lines().filter(|l| l.starts_with("| ")).skip(1).collect();
    let heads: Vec<String> = all.iter().map(head).collect();
    let same = written.len() == heads.len() && written.iter().zip(&heads).all(|(l, h)| l.starts_with(h));
    assert!(same, "{FILE} has other cases: write it again with UPDATE_EXPECT=1 RUN_SLOW_TESTS=1");
}

#[test]
fn there_are_more_than_a_hundred() {
    let all = cases();
    assert!(100 < all.iter().filter(|c| !c.slow).count());
}
