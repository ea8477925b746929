//! A bake's folder, replaced as a whole.
//!
//! New files are collected in `.bake-staging` inside the folder. [`Staging::commit`] flushes them to
//! the disk and renames that folder to `.bake-commit`: from this moment on the new bake is the one
//! that counts, and [`Staging::begin`] finishes what a crash leaves undone from there. Before it,
//! the previous bake is untouched. Files of the previous bake that the new one lacks disappear;
//! files that no bake wrote stay.

use std::{
    fs::{self, File},
    io,
    path::{Component, Path, PathBuf},
};

use serde_json::Value;
use tables::format::manifest::{self, Manifest, Timings};

use crate::error::{Error, Result};

const STAGING: &str = ".bake-staging";
const COMMIT: &str = ".bake-commit";

/// New files on their way into a bake's folder. Dropping it discards them.
#[derive(Debug)]
pub struct Staging {
    folder: PathBuf,
    /// The folder did not exist before; it goes again if nothing is committed.
    created: bool,
    committed: bool,
    /// Holds the lock that keeps a second bake out of the folder.
    _lock: Option<File>,
}

impl Staging {
    /// Prepares `folder` for a new bake, making it where it is absent.
    ///
    /// Left-overs of runs that crashed are removed, or completed where they had reached the commit.
    ///
    /// # Errors
    /// [`Error::Usage`] if `folder` is a file, holds files but no bake, or another bake is writing
    /// into it; [`Error::Io`] if it cannot be read or written.
    pub fn begin(folder: &Path) -> Result<Self> {
        let created = prepare(folder)?;
        let lock = lock(folder)?;
        let staging = Self { folder: folder.to_owned(), created, committed: false, _lock: lock };
        complete(folder)?;
        let inside = staging.root();
        remove_tree(&inside)?;
        fs::create_dir(&inside).map_err(Error::io(inside, "cannot create"))?;
        Ok(staging)
    }

    /// Where to write the new file `name`, a plain file name.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        debug_assert!(is_plain(name), "{name} is not a plain file name");
        self.root().join(name)
    }

    /// Writes `bytes` to the new file `name`.
    ///
    /// # Errors
    /// [`Error::Io`], as when the disk is full.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
        let path = self.path(name);
        fs::write(&path, bytes).map_err(Error::io(path, "cannot write"))
    }

    /// Makes the new files the folder's bake: lists them in `manifest`, writes `manifest` and
    /// `timings`, flushes everything to the disk and replaces the previous bake.
    ///
    /// # Errors
    /// [`Error::Io`] if something cannot be written. The previous bake is intact then, unless the
    /// message says that the new one cannot be moved into place; the next bake into the folder
    /// completes that.
    pub fn commit(mut self, mut manifest: Manifest, timings: &Timings) -> Result<()> {
        let root = self.root();
        // The manifest lists what a later bake may remove, so it comes from what is really there.
        manifest.files = list(&root)?
            .into_iter()
            .filter(|f| f.name != manifest::FILE_NAME && f.name != manifest::TIMINGS_FILE_NAME)
            .collect();
        let not_json = |e: manifest::ManifestError| io::Error::new(io::ErrorKind::InvalidData, e.to_string());
        let timings = timings
            .to_json()
            .map_err(not_json)
            .map_err(Error::io(self.path(manifest::TIMINGS_FILE_NAME), "cannot write"))?;
        let text = manifest
            .to_json()
            .map_err(not_json)
            .map_err(Error::io(self.path(manifest::FILE_NAME), "cannot write"))?;
        self.write(manifest::TIMINGS_FILE_NAME, timings)?;
        self.write(manifest::FILE_NAME, text)?;
        for file in list(&root)? {
            let path = root.join(&file.name);
            sync(&path)?;
        }
        sync(&root)?;
        let commit = self.folder.join(COMMIT);
        fs::rename(&root, &commit).map_err(Error::io(&self.folder, "cannot replace the previous bake"))?;
        self.committed = true;
        sync(&self.folder)?;
        complete(&self.folder)
    }

    fn root(&self) -> PathBuf {
        self.folder.join(STAGING)
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if self.committed {
            return;
        }
        // Nothing can be reported from here; what cannot be removed now, the next bake removes.
        let _ = fs::remove_dir_all(self.root());
        if self.created {
            // Fails where somebody put something into the folder meanwhile, which is right.
            let _ = fs::remove_dir(&self.folder);
        }
    }
}

/// Writes a file beside bakes: the old one, if there is one, stays until the new one is complete.
///
/// # Errors
/// [`Error::Io`], as when the disk is full.
pub fn replace(path: &Path, bytes: &[u8]) -> Result<()> {
    let new = path.with_extension("new");
    fs::write(&new, bytes).and_then(|()| fs::rename(&new, path)).map_err(Error::io(path, "cannot write"))
}

/// Path of the file `name` of the bake in `folder`, also where a crash kept it from its final place.
#[must_use]
pub fn resolve(folder: &Path, name: &str) -> PathBuf {
    let waiting = folder.join(COMMIT).join(name);
    if waiting.exists() { waiting } else { folder.join(name) }
}

/// Reads the manifest of the bake in `folder`.
///
/// # Errors
/// [`Error::Io`] if there is none or it is not readable by this release.
pub fn read_manifest(folder: &Path) -> Result<Manifest> {
    let path = resolve(folder, manifest::FILE_NAME);
    let text = fs::read_to_string(&path).map_err(Error::io(&path, "cannot read"))?;
    Manifest::from_json(&text)
        .map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e.to_string()))
        .map_err(Error::io(path, "cannot read"))
}

/// Makes sure `folder` exists and may be written into; whether it had to be made.
fn prepare(folder: &Path) -> Result<bool> {
    match fs::metadata(folder) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            fs::create_dir_all(folder).map_err(Error::io(folder, "cannot create"))?;
            return Ok(true);
        }
        Err(e) => return Err(Error::io(folder, "cannot open")(e)),
        Ok(meta) if !meta.is_dir() => {
            return Err(Error::Usage(format!(
                "{}: is a file; name a folder for the results with -o",
                folder.display()
            )));
        }
        Ok(_) => {}
    }
    let mut foreign = None;
    for entry in fs::read_dir(folder).map_err(Error::io(folder, "cannot list"))? {
        let name = entry.map_err(Error::io(folder, "cannot list"))?.file_name();
        if name == COMMIT || is_bake(folder) {
            return Ok(false);
        }
        if name != STAGING {
            foreign.get_or_insert(name);
        }
    }
    match foreign {
        None => Ok(false),
        Some(name) => Err(Error::Usage(format!(
            "{}: holds files (such as {}) but no bake, so nothing was written; name an empty or new folder with -o",
            folder.display(),
            name.display()
        ))),
    }
}

/// Whether `folder` holds a manifest of ours, of whatever version.
fn is_bake(folder: &Path) -> bool {
    lenient_manifest(&folder.join(manifest::FILE_NAME)).is_some()
}

/// A manifest as plain JSON: one of a newer release still names its files.
fn lenient_manifest(path: &Path) -> Option<Value> {
    let value: Value = serde_json::from_slice(&fs::read(path).ok()?).ok()?;
    (value.get("format")?.as_str()? == manifest::FORMAT).then_some(value)
}

/// Moves a committed bake to its place. May be cut short and called again any number of times: the
/// old manifest goes last, so that the list of stale files outlives them.
fn complete(folder: &Path) -> Result<()> {
    let commit = folder.join(COMMIT);
    if !commit.exists() {
        return Ok(());
    }
    let names = |manifest: Option<Value>| -> Vec<String> {
        let files = manifest.as_ref().and_then(|m| m.get("files")).and_then(Value::as_array);
        let name = |f: &Value| f.get("name").and_then(Value::as_str).map(str::to_owned);
        files.map(|f| f.iter().filter_map(name).collect()).unwrap_or_default()
    };
    let new_manifest = commit.join(manifest::FILE_NAME);
    if new_manifest.exists() {
        let new = names(lenient_manifest(&new_manifest));
        for old in names(lenient_manifest(&folder.join(manifest::FILE_NAME))) {
            // A manifest comes from outside, so its names are not trusted to stay in the folder.
            if !new.contains(&old) && is_plain(&old) {
                let path = folder.join(&old);
                match fs::remove_file(&path) {
                    Err(e) if e.kind() != io::ErrorKind::NotFound => {
                        return Err(Error::io(path, "cannot remove the previous bake's file")(e));
                    }
                    _ => {}
                }
            }
        }
        let mut files = list(&commit)?;
        files.sort_by_key(|f| f.name == manifest::FILE_NAME);
        for file in files {
            let (from, to) = (commit.join(&file.name), folder.join(&file.name));
            fs::rename(&from, &to).map_err(Error::io(to, "cannot move the finished file into place"))?;
        }
        sync(folder)?;
    }
    remove_tree(&commit)
}

/// The files of a folder by name, with their lengths.
fn list(folder: &Path) -> Result<Vec<manifest::File>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io(folder, "cannot list"))? {
        let entry = entry.map_err(Error::io(folder, "cannot list"))?;
        let meta = entry.metadata().map_err(Error::io(entry.path(), "cannot inspect"))?;
        let Ok(name) = entry.file_name().into_string() else { continue };
        if meta.is_file() {
            files.push(manifest::File { name, bytes: meta.len() });
        }
    }
    files.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(files)
}

fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    matches!((parts.next(), parts.next()), (Some(Component::Normal(only)), None) if only == name)
}

fn remove_tree(path: &Path) -> Result<()> {
    match fs::remove_dir_all(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(Error::io(path, "cannot remove")(e)),
        _ => Ok(()),
    }
}

/// Flushes a file's contents, or a folder's entries, to the disk.
fn sync(path: &Path) -> Result<()> {
    if cfg!(not(unix)) && path.is_dir() {
        return Ok(());
    }
    let flushed = File::open(path).and_then(|f| f.sync_all());
    match flushed {
        // Some file systems cannot flush folders and say so.
        Err(e) if path.is_dir() && e.kind() == io::ErrorKind::InvalidInput => Ok(()),
        other => other.map_err(Error::io(path, "cannot flush")),
    }
}

/// Locks the folder itself, which leaves no lock file behind. Where the system cannot do that
/// there is no lock.
fn lock(folder: &Path) -> Result<Option<File>> {
    if cfg!(not(unix)) {
        return Ok(None);
    }
    let file = File::open(folder).map_err(Error::io(folder, "cannot open"))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(fs::TryLockError::WouldBlock) => {
            Err(Error::Usage(format!("{}: another bake is writing into it", folder.display())))
        }
        Err(fs::TryLockError::Error(_)) => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bake(folder: &Path, files: &[&str]) -> Result<()> {
        let staging = Staging::begin(folder)?;
        for name in files {
            staging.write(name, name)?;
        }
        staging.commit(Manifest::new("bake", "0"), &Timings::new())
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(folder)
            .expect("folder")
            .map(|e| e.expect("entry").file_name().into_string().expect("unicode"))
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_later_bake_replaces_an_earlier_one_and_leaves_other_files() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let folder = dir.path().join("a/b.bake");
        bake(&folder, &["lightmap-0.exr", "lightmap-1.exr", "scene.glb"])?;
        fs::write(folder.join("notes.txt"), "mine")?;
        let manifest = read_manifest(&folder)?;
        assert_eq!(manifest.files.len(), 3);
        assert_eq!(manifest.files[2], manifest::File { name: "scene.glb".into(), bytes: 9 });

        bake(&folder, &["lightmap-0.exr"])?;
        assert_eq!(names(&folder), ["lightmap-0.exr", "manifest.json", "notes.txt", "timings.json"]);
        Ok(())
    }

    #[test]
    fn a_dropped_bake_leaves_the_previous_one() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        bake(dir.path(), &["lightmap-0.exr"])?;
        let before = names(dir.path());
        let staging = Staging::begin(dir.path())?;
        staging.write("lightmap-0.exr", "half")?;
        drop(staging);
        assert_eq!(names(dir.path()), before);
        assert_eq!(fs::read_to_string(dir.path().join("lightmap-0.exr"))?, "lightmap-0.exr");

        let fresh = dir.path().join("fresh");
        drop(Staging::begin(&fresh)?);
        assert!(!fresh.exists());
        Ok(())
    }

    #[test]
    fn a_failed_commit_leaves_the_previous_bake() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        bake(dir.path(), &["lightmap-0.exr"])?;
        let staging = Staging::begin(dir.path())?;
        staging.write("lightmap-0.exr", "new")?;
        let mut manifest = Manifest::new("bake", "0");
        manifest.error.rms_std_err = f64::INFINITY;
        assert!(staging.commit(manifest, &Timings::new()).is_err());
        assert_eq!(fs::read_to_string(dir.path().join("lightmap-0.exr"))?, "lightmap-0.exr");
        assert_eq!(names(dir.path()), ["lightmap-0.exr", "manifest.json", "timings.json"]);
        Ok(())
    }

    #[test]
    fn leftovers_of_a_crash_before_the_commit_disappear() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        fs::create_dir(dir.path().join(STAGING))?;
        fs::write(dir.path().join(STAGING).join("lightmap-7.exr"), "half")?;
        bake(dir.path(), &["lightmap-0.exr"])?;
        assert_eq!(names(dir.path()), ["lightmap-0.exr", "manifest.json", "timings.json"]);
        Ok(())
    }

    #[test]
    fn a_crash_after_the_commit_is_completed() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        bake(dir.path(), &["old.exr", "both.exr"])?;
        // The state after the commit's rename and one of its moves.
        let other = tempfile::tempdir()?;
        bake(other.path(), &["both.exr", "new.exr"])?;
        let commit = dir.path().join(COMMIT);
        fs::create_dir(&commit)?;
        for name in ["new.exr", "manifest.json", "timings.json"] {
            fs::copy(other.path().join(name), commit.join(name))?;
        }
        assert_eq!(read_manifest(dir.path())?.files, read_manifest(other.path())?.files);
        assert_eq!(resolve(dir.path(), "both.exr"), dir.path().join("both.exr"));
        assert_eq!(resolve(dir.path(), "new.exr"), commit.join("new.exr"));

        drop(Staging::begin(dir.path())?);
        assert_eq!(names(dir.path()), ["both.exr", "manifest.json", "new.exr", "timings.json"]);
        assert_eq!(read_manifest(dir.path())?, read_manifest(other.path())?);
        Ok(())
    }

    #[test]
    fn folders_that_are_no_bake_are_refused() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let said = |path: &Path| Staging::begin(path).map(|_| ()).expect_err("refused").to_string();
        let file = dir.path().join("file");
        fs::write(&file, "x")?;
        assert!(said(&file).contains("is a file"));
        assert!(said(dir.path()).contains("such as file"));
        fs::write(dir.path().join(manifest::FILE_NAME), "{\"format\": \"other\"}")?;
        assert!(said(dir.path()).contains("no bake"));
        assert_eq!(names(dir.path()), ["file", "manifest.json"]);
        // A newer release's manifest is still a bake.
        let newer = format!("{{\"format\": {:?}, \"version\": 99, \"files\": []}}", manifest::FORMAT);
        fs::write(dir.path().join(manifest::FILE_NAME), newer)?;
        drop(Staging::begin(dir.path())?);
        Ok(())
    }

    #[test]
    fn names_in_a_manifest_cannot_leave_the_folder() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let folder = dir.path().join("bake");
        bake(&folder, &["a"])?;
        let outside = dir.path().join("outside");
        fs::write(&outside, "mine")?;
        let mut manifest = read_manifest(&folder)?;
        for name in ["../outside", outside.to_str().expect("unicode"), ".", "..", ""] {
            manifest.files.push(manifest::File { name: name.into(), bytes: 0 });
        }
        fs::write(folder.join(manifest::FILE_NAME), manifest.to_json()?)?;
        bake(&folder, &["b"])?;
        assert!(outside.exists());
        assert_eq!(names(&folder), ["b", "manifest.json", "timings.json"]);
        Ok(())
    }

    #[cfg(unix)]
    #[test]
    fn two_bakes_do_not_share_a_folder() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let first = Staging::begin(dir.path())?;
        first.write("a", "a")?;
        let message = Staging::begin(dir.path()).map(|_| ()).expect_err("locked").to_string();
        assert!(message.contains("another bake"), "{message}");
        first.commit(Manifest::new("bake", "0"), &Timings::new())?;
        drop(Staging::begin(dir.path())?);
        Ok(())
    }
}
