//! Typed errors and findings.

use std::{fmt, io, path::PathBuf};

/// How grave a [`Finding`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Worth knowing; the result is what the file asks for.
    Info,
    /// The result may not be what the author meant.
    Warning,
    /// The scene cannot be baked.
    Error,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Info => "note",
            Self::Warning => "warning",
            Self::Error => "error",
        })
    }
}

/// Something noticed about the input: where, what, and what to do about it.
///
/// `Display` gives `severity: path: what` and, on a second line, `  fix: remedy`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// How grave.
    pub severity: Severity,
    /// Place in the input, such as `meshes[3].primitives[0].attributes.POSITION`.
    pub path: String,
    /// What is wrong, with the offending value and its unit.
    pub what: String,
    /// What the author can do.
    pub fix: String,
}

impl Finding {
    /// A finding that stops the bake.
    pub fn error(path: impl Into<String>, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { severity: Severity::Error, path: path.into(), what: what.into(), fix: fix.into() }
    }

    /// A finding that lets the bake go on.
    pub fn warning(path: impl Into<String>, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { severity: Severity::Warning, ..Self::error(path, what, fix) }
    }

    /// A note.
    pub fn info(path: impl Into<String>, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { severity: Severity::Info, ..Self::error(path, what, fix) }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: {}\n  fix: {}", self.severity, self.path, self.what, self.fix)
    }
}

/// Everything that can end a command early.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The input has findings of [`Severity::Error`].
    #[error("{}", join(.0))]
    Input(Vec<Finding>),
    /// A file could not be read or written.
    #[error("{}: {doing}: {source}{}", path.display(), remedy(source))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was being done, such as `cannot read`.
        doing: &'static str,
        /// The system's answer.
        source: io::Error,
    },
    /// The command line or configuration asks for something that cannot be done.
    #[error("{0}")]
    Usage(String),
    /// Ctrl-C or SIGTERM.
    #[error("interrupted: nothing was written")]
    Interrupted,
}

/// Short name for results of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Wraps a system error with the path and action it belongs to; for `map_err`.
    pub fn io(path: impl Into<PathBuf>, doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, doing, source }
    }
}

impl From<Finding> for Error {
    fn from(f: Finding) -> Self {
        Self::Input(vec![f])
    }
}

/// What helps against the system errors that users meet.
fn remedy(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::NotFound => "\n  fix: check the path; relative ones start at the current folder",
        io::ErrorKind::PermissionDenied => "\n  fix: check the owner and rights of the file and its folder",
        io::ErrorKind::IsADirectory | io::ErrorKind::NotADirectory => {
            "\n  fix: check which part of the path is a file and which a folder"
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "\n  fix: make room or write elsewhere with -o"
        }
        _ => "",
    }
}

fn join(findings: &[Finding]) -> String {
    findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}
