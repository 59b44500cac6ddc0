//! Files that replace their targets together: staged beside them, renamed one after another, and restored if a rename
//! fails.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tempfile::{Builder, NamedTempFile};

use crate::cli::failure::Failure;

/// Lock that is held while temporary files exist.
static WRITING: Mutex<()> = Mutex::new(());

/// Acquires the lock that must be held while temporary files are created.
pub fn writing() -> MutexGuard<'static, ()> {
    WRITING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Paths of all temporary files that this process has created, including those that no longer exist.
static TEMPORARY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn temporary_files() -> MutexGuard<'static, Vec<PathBuf>> {
    TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Prepares the end of the process: waits until outputs in progress are complete, prevents new ones, and removes the
/// remaining temporary files. Returns whether the wait ended within `patience`; a write into a pipe may never end, and
/// then it is given up.
pub fn hold(patience: Duration) -> bool {
    let begin = Instant::now();
    let mut is_over = false;
    while !is_over && begin.elapsed() < patience {
        match WRITING.try_lock() {
            Ok(guard) => {
                std::mem::forget(guard);
                is_over = true;
            }
            Err(_) => std::thread::sleep(Duration::from_millis(5)),
        }
    }
    // This lock is never released, so that no temporary file is created any more.
    let files = temporary_files();
    for file in files.iter() {
        let _ = std::fs::remove_file(file);
    }
    std::mem::forget(files);
    is_over
}

/// Checks that a temporary file can be created in `folder`.
pub fn check_temporary(folder: &Path) -> std::io::Result<()> {
    created(folder, Readers::Owner).map(drop)
}

/// Who may read a new file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Readers {
    /// All users that the system's settings allow, as for a file of any other program.
    All,
    /// Only its owner, from the moment when the file exists.
    Owner,
}

/// A complete file that has not yet replaced its target.
pub struct Staged {
    file: NamedTempFile,
    target: PathBuf,
    overwrites: bool,
}

impl Staged {
    /// Stages `bytes` to replace the file at `path`, or at the end of a link there.
    pub fn replacing(path: &Path, bytes: &[u8]) -> Result<Self, Failure> {
        let target = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        let file = temporary(folder_of(&target), bytes, Readers::All)
            .map_err(|error| Failure::lost(path, error))?;
        // Users who could read and write the old file can read and write the new one.
        if let Ok(there) = std::fs::metadata(&target)
            && there.is_file()
        {
            let kept = file.as_file().set_permissions(there.permissions());
            kept.map_err(|error| Failure::lost(path, error))?;
        }
        Ok(Self {
            file,
            target,
            overwrites: true,
        })
    }

    /// Stages an empty file to replace the file at `path`, or at the end of a link there. The contents are then written to
    /// [`Staged::file`].
    pub fn begin(path: &Path) -> Result<Self, Failure> {
        Self::replacing(path, &[])
    }

    /// Returns the temporary file that will replace the target.
    pub fn file(&self) -> &File {
        self.file.as_file()
    }

    /// Stages a file that must not overwrite anything.
    pub fn new_file(path: &Path, bytes: &[u8], readers: Readers) -> Result<Self, Failure> {
        let file = temporary(folder_of(path), bytes, readers);
        Ok(Self {
            file: file.map_err(|error| Failure::lost(path, error))?,
            target: path.to_path_buf(),
            overwrites: false,
        })
    }

    /// Renames the staged file to its target.
    fn commit(self) -> Result<Committed, Failure> {
        let target = self.target;
        let lost = |error| Failure::lost(&target, error);
        let before = match self.overwrites && target.exists() {
            true => Some(backup(&target).map_err(lost)?),
            false => None,
        };
        let renamed = match self.overwrites {
            true => self.file.persist(&target),
            // A file may have appeared at the target since the check.
            false => self.file.persist_noclobber(&target),
        };
        renamed.map_err(|failed| lost(failed.error))?;
        Ok(Committed { target, before })
    }
}

/// A file that has replaced its target, and the file that was there before.
struct Committed {
    target: PathBuf,
    before: Option<NamedTempFile<()>>,
}

impl Committed {
    /// Restores the file that was there before.
    fn undo(self) {
        let _ = match self.before {
            Some(before) => before.persist(&self.target).map_err(|failed| failed.error),
            None => std::fs::remove_file(&self.target),
        };
    }
}

/// Renames all files to their targets and has the folders written to disk, or restores all old files.
///
/// # Errors
/// [`Failure::LostOutput`] with the path that could not be written.
pub fn commit(staged: Vec<Staged>) -> Result<(), Failure> {
    let folder = |file: &Staged| folder_of(&file.target).to_path_buf();
    let folders: BTreeSet<PathBuf> = staged.iter().map(folder).collect();
    let mut done: Vec<Committed> = Vec::new();
    let renamed = staged.into_iter().try_for_each(|file| {
        done.push(file.commit()?);
        Ok(())
    });
    let synced = renamed.and_then(|()| {
        let sync = |folder: &PathBuf| sync(folder).map_err(|error| Failure::lost(folder, error));
        folders.iter().try_for_each(sync)
    });
    if synced.is_err() {
        done.into_iter().rev().for_each(Committed::undo);
    }
    synced
}

/// Writes the names in a folder to disk, if the system supports that.
pub fn sync(folder: &Path) -> std::io::Result<()> {
    use std::io::ErrorKind::{InvalidInput, PermissionDenied, Unsupported};
    if cfg!(not(unix)) {
        return Ok(());
    }
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(error) if [InvalidInput, PermissionDenied, Unsupported].contains(&error.kind()) => {
            Ok(())
        }
        synced => synced,
    }
}

/// Returns the folder of a file.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Creates a complete temporary file in the folder of its target.
fn temporary(folder: &Path, bytes: &[u8], readers: Readers) -> std::io::Result<NamedTempFile> {
    let mut file = {
        let mut known = temporary_files();
        let file = created(folder, readers)?;
        known.push(file.path().to_path_buf());
        file
    };
    // Errors of the plain file, because those of the temporary file would name its path.
    file.as_file_mut().write_all(bytes)?;
    file.as_file().sync_all()?;
    Ok(file)
}

/// Creates a second name for the file at `target`, beside it; a copy if the file system has no hard links.
fn backup(target: &Path) -> std::io::Result<NamedTempFile<()>> {
    let mut known = temporary_files();
    let link = |path: &Path| match std::fs::hard_link(target, path) {
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => Err(error),
        Err(_) => std::fs::copy(target, path).map(drop),
        linked => linked,
    };
    let file = hidden().make_in(folder_of(target), link)?;
    known.push(file.path().to_path_buf());
    Ok(file)
}

/// Creates an empty temporary file. Its errors are those of the system, because a user knows nothing of its path.
fn created(folder: &Path, readers: Readers) -> std::io::Result<NamedTempFile> {
    hidden().make_in(folder, |path| {
        let mut options = File::options();
        options.read(true).write(true).create_new(true);
        #[cfg(unix)]
        {
            use std::os::unix::fs::OpenOptionsExt;
            options.mode(match readers {
                Readers::All => 0o666,
                Readers::Owner => 0o600,
            });
        }
        #[cfg(not(unix))]
        let _ = readers;
        options.open(path)
    })
}

fn hidden() -> Builder<'static, 'static> {
    let mut builder = Builder::new();
    builder.prefix(".poegp-");
    builder
}
