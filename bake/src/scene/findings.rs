//! Collects findings and keeps repeated ones short.

use std::collections::BTreeMap;

use crate::error::{Finding, Severity};

/// How many findings of one kind are shown in full.
const SHOWN: usize = 3;

/// A list of findings in which many of one kind take a few lines.
#[derive(Debug, Default)]
pub(crate) struct Findings {
    list: Vec<Finding>,
    kinds: BTreeMap<(Severity, String, String), Kind>,
}

#[derive(Debug, Default)]
struct Kind {
    shown: usize,
    more: usize,
    last: usize,
}

impl Findings {
    /// Adds a finding; the same one a second time, or many that differ in numbers only, are counted.
    pub(crate) fn push(&mut self, finding: Finding) {
        if self.list.last() == Some(&finding) {
            return;
        }
        let key = (finding.severity, pattern(&finding.path), pattern(&finding.what));
        let kind = self.kinds.entry(key).or_default();
        if kind.shown < SHOWN {
            // The list of one kind is short, so looking for a twin is cheap.
            if self.list.contains(&finding) {
                return;
            }
            kind.shown += 1;
            kind.last = self.list.len();
            self.list.push(finding);
        } else {
            kind.more += 1;
        }
    }

    /// Adds all.
    pub(crate) fn extend(&mut self, findings: impl IntoIterator<Item = Finding>) {
        findings.into_iter().for_each(|f| self.push(f));
    }

    /// Adds the error, if it is one, and gives the value.
    pub(crate) fn keep<T>(&mut self, result: Result<T, Finding>) -> Option<T> {
        result.map_err(|f| self.push(f)).ok()
    }

    /// Whether any finding stops the bake.
    pub(crate) fn any_error(&self) -> bool {
        self.list.iter().any(|f| f.severity == Severity::Error)
    }

    /// The list, gravest first, otherwise in the order of discovery.
    pub(crate) fn finish(mut self) -> Vec<Finding> {
        for kind in self.kinds.values().filter(|k| 0 < k.more) {
            let text = &mut self.list[kind.last].what;
            text.push_str(&format!(" (and {} more like this)", kind.more));
        }
        self.list.sort_by_key(|f| std::cmp::Reverse(f.severity));
        self.list
    }
}

/// The text with every run of digits replaced, and without what is quoted.
fn pattern(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut quoted = false;
    for c in text.chars() {
        if c == '`' {
            quoted = !quoted;
        } else if !quoted && (!c.is_ascii_digit() || !out.ends_with('#')) {
            out.push(if c.is_ascii_digit() { '#' } else { c });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_ones_are_counted() {
        let mut all = Findings::default();
        for i in 0..60 {
            all.push(Finding::warning(format!("nodes[{i}]"), format!("value {i} of `n{i}`"), "fix"));
        }
        all.push(Finding::error("x", "y", "z"));
        all.push(Finding::error("x", "y", "z"));
        let list = all.finish();
        assert_eq!(list.len(), 4);
        assert_eq!(list[0].severity, Severity::Error);
        assert!(list[3].what.ends_with("(and 57 more like this)"), "{}", list[3].what);
    }
}
