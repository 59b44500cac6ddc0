//! Files that are written whole or not at all.
//!
//! Every output is checked before the work begins (does its folder exist, is it not a folder itself, is it not
//! protected), written to a temporary file beside its place and renamed: a failure leaves what was there before. Several
//! outputs of one command are all written before the first is renamed. No folder is created. A link is followed, and
//! what is no regular file (`/dev/null`, a pipe) is written to, never replaced.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tempfile::NamedTempFile;

use crate::cli::failure::Failure;
use crate::cli::terminal::print::is_stdout;
use poegp_calibration::input_error::InputError;

/// Held while there are temporary files.
static WRITING: Mutex<()> = Mutex::new(());

fn writing() -> MutexGuard<'static, ()> {
    WRITING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Temporary files of this process, those that are gone included.
static TEMPORARY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn temporary_files() -> MutexGuard<'static, Vec<PathBuf>> {
    TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Before the end of the process: waits until nothing is half-written and lets nothing begin any more. Whether that came
/// to be within `patience`; a write into a pipe may take for ever, and then the temporary files beside it are removed.
pub fn hold(patience: Duration) -> bool {
    let begin = Instant::now();
    while begin.elapsed() < patience {
        if let Ok(guard) = WRITING.try_lock() {
            std::mem::forget(guard);
            return true;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    // Kept locked: nothing new is made.
    let files = temporary_files();
    for file in files.iter() {
        let _ = std::fs::remove_file(file);
    }
    std::mem::forget(files);
    false
}

/// Refuses a path that could not be written, before the work that would be lost.
///
/// # Errors
/// [`InputError`] names the path and what is wrong with it.
pub fn check(path: &Path) -> Result<(), InputError> {
    let _writing = writing();
    could_be_written(path)
}

/// The same while `WRITING` is held: a temporary file is made.
fn could_be_written(path: &Path) -> Result<(), InputError> {
    if path.as_os_str().is_empty() || path.is_dir() {
        return Err(InputError::new(
            path,
            "a folder",
            "the path of a file to write",
        ));
    }
    match std::fs::metadata(path) {
        Ok(there) if !there.is_file() => return Ok(()),
        // Renaming would replace it all the same: its owner has said not to.
        Ok(there) if there.permissions().readonly() => {
            return Err(InputError::new(
                path,
                "a file that is read-only",
                "a file that can be written",
            ));
        }
        _ => {}
    }
    let folder = folder_of(path);
    if !folder.is_dir() {
        return Err(InputError::new(
            path,
            format!("no folder \"{}\"", folder.display()),
            "a file in a folder that exists",
        )
        .with_help("create the folder first; none is created here"));
    }
    NamedTempFile::new_in(folder)
        .map(drop)
        .map_err(|error| refused(path, &error))
}

/// Writes `bytes` to `path`, or leaves what is there.
///
/// # Errors
/// As [`check`].
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), InputError> {
    write_all(&[(path, bytes)])
}

/// Writes every file, or leaves what is there: all are complete before the first takes its place.
///
/// # Errors
/// As [`check`].
pub fn write_all(files: &[(&Path, &[u8])]) -> Result<(), InputError> {
    let _writing = writing();
    let staged = files
        .iter()
        .map(|(path, bytes)| Staged::new(path, bytes))
        .collect::<Result<Vec<_>, _>>()?;
    staged.into_iter().try_for_each(Staged::commit)
}

/// Refuses a path that could not be written, or where there is something already.
///
/// # Errors
/// [`InputError`] names the path and what is wrong with it.
pub fn check_new(path: &Path) -> Result<(), InputError> {
    let _writing = writing();
    could_be_new(path)
}

/// The same while `WRITING` is held.
fn could_be_new(path: &Path) -> Result<(), InputError> {
    if std::fs::symlink_metadata(path).is_ok_and(|there| !there.is_dir()) {
        return Err(exists(path));
    }
    could_be_written(path)
}

/// Who may read a new file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Readers {
    /// As any file made by any other program.
    All,
    /// Its owner only, from the moment that it exists.
    Owner,
}

/// Writes every file or none, and overwrites nothing.
///
/// # Errors
/// As [`check_new`].
pub fn write_new(files: &[(&Path, &[u8], Readers)]) -> Result<(), InputError> {
    let _writing = writing();
    let staged = files
        .iter()
        .map(|(path, bytes, readers)| {
            could_be_new(path)?;
            temporary(folder_of(path), bytes, *readers)
                .map(|file| (file, *path))
                .map_err(|error| refused(path, &error))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut written: Vec<&Path> = Vec::new();
    for (file, path) in staged {
        if let Err(failed) = file.persist_noclobber(path) {
            // Between the check and now. What was written is ours, and of no use alone.
            for path in written {
                let _ = std::fs::remove_file(path);
            }
            return Err(match failed.error.kind() {
                std::io::ErrorKind::AlreadyExists => exists(path),
                _ => refused(path, &failed.error),
            });
        }
        written.push(path);
    }
    Ok(())
}

fn exists(path: &Path) -> InputError {
    InputError::new(path, "a file that exists", "the name of a new file")
}

/// A complete file beside its place.
fn temporary(folder: &Path, bytes: &[u8], readers: Readers) -> std::io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".poegp-");
    if readers == Readers::All {
        builder.permissions_of_a_plain_file();
    }
    let mut file = {
        let mut known = temporary_files();
        let file = builder.tempfile_in(folder)?;
        known.push(file.path().to_path_buf());
        file
    };
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    Ok(file)
}

/// A file that is complete and not yet in its place; `None` for a device or a pipe, which has no second place.
struct Staged(Option<(NamedTempFile, PathBuf)>);

impl Staged {
    fn new(path: &Path, bytes: &[u8]) -> Result<Self, InputError> {
        could_be_written(path)?;
        let stage = || -> std::io::Result<Self> {
            if std::fs::metadata(path).is_ok_and(|there| !there.is_file()) {
                let mut device = std::fs::OpenOptions::new().write(true).open(path)?;
                device.write_all(bytes)?;
                return Ok(Self(None));
            }
            let target = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
            let file = temporary(folder_of(&target), bytes, Readers::All)?;
            Ok(Self(Some((file, target))))
        };
        stage().map_err(|error| refused(path, &error))
    }

    fn commit(self) -> Result<(), InputError> {
        let Some((file, target)) = self.0 else {
            return Ok(());
        };
        file.persist(&target)
            .map(drop)
            .map_err(|failed| refused(&target, &failed.error))
    }
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

fn refused(path: &Path, error: &std::io::Error) -> InputError {
    InputError::new(
        path,
        format!("an error while writing ({error})"),
        "a file that can be written",
    )
}

/// Readable by all as the umask allows, as a file made by any other program.
trait PlainFile {
    fn permissions_of_a_plain_file(&mut self) -> &mut Self;
}

impl PlainFile for tempfile::Builder<'_, '_> {
    fn permissions_of_a_plain_file(&mut self) -> &mut Self {
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            self.permissions(std::fs::Permissions::from_mode(0o666))
        }
        #[cfg(not(unix))]
        self
    }
}

/// A JSON document as text.
pub fn json_text(document: &impl serde::Serialize) -> Result<String, Failure> {
    let text = serde_json::to_string_pretty(document).map_err(|e| Failure::Usage(e.to_string()))?;
    Ok(text + "\n")
}

/// Writes the results of a command as JSON where they were asked for, with the version of the program.
pub fn write_summary(path: Option<&Path>, summary: serde_json::Value) -> Result<(), Failure> {
    match path {
        Some(path) => write_outputs(&[(path, summary_text(summary)?.as_bytes())]),
        None => Ok(()),
    }
}

/// The results of a command as a JSON document, with the version of the program.
pub fn summary_text(mut summary: serde_json::Value) -> Result<String, Failure> {
    summary["version"] = env!("CARGO_PKG_VERSION").into();
    json_text(&summary)
}

/// Writes all outputs of a command or none; `-` is standard output.
pub fn write_outputs(outputs: &[(&Path, &[u8])]) -> Result<(), Failure> {
    let (stdout, files): (Vec<_>, Vec<_>) = outputs.iter().partition(|(path, _)| is_stdout(path));
    write_all(&files)?;
    for (_, bytes) in stdout {
        let mut out = std::io::stdout();
        out.write_all(bytes)
            .and_then(|()| out.flush())
            .map_err(|error| {
                InputError::new(
                    "<standard output>",
                    format!("an error while writing ({error})"),
                    "a reader of the JSON document",
                )
            })?;
    }
    Ok(())
}

/// Refuses outputs that cannot be written, that are one file, or that would overwrite an input, before the work.
pub fn check_outputs(outputs: &[Option<&Path>], inputs: &[&Path]) -> Result<(), Failure> {
    let outputs: Vec<&Path> = outputs.iter().flatten().copied().collect();
    for (i, path) in outputs.iter().enumerate() {
        if outputs[..i].contains(path) {
            let found = "two outputs in one file";
            return Err(InputError::new(path, found, "a file for each output").into());
        }
        if is_stdout(path) {
            continue;
        }
        check(path)?;
        let target = std::fs::canonicalize(path);
        if target.is_ok_and(|target| {
            inputs
                .iter()
                .any(|input| std::fs::canonicalize(input).is_ok_and(|input| input == target))
        }) {
            let found = "an input of this command";
            return Err(InputError::new(path, found, "another file for the output").into());
        }
    }
    Ok(())
}

/// Makes a folder if it is not there; its parent must be.
pub fn make_folder(path: &Path) -> Result<(), Failure> {
    if path.is_dir() {
        return Ok(());
    }
    std::fs::create_dir(path).map_err(|error| {
        InputError::new(
            path,
            format!("a folder that cannot be made ({error})"),
            "a folder, or a new one in a folder that exists",
        )
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replaces_whole_files_and_creates_no_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write(&path, b"one").unwrap();
        write(&path, b"two").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        let missing = folder.path().join("no/such/a.txt");
        assert!(
            write(&missing, b"x")
                .unwrap_err()
                .to_string()
                .contains("no folder")
        );
        assert!(!folder.path().join("no").exists());
        assert!(
            write(folder.path(), b"x")
                .unwrap_err()
                .to_string()
                .contains("a folder")
        );
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            1,
            "no temporary file is left"
        );
    }

    #[test]
    fn all_outputs_or_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write(&path, b"old").unwrap();
        let other = folder.path().join("no/b.txt");
        assert!(write_all(&[(&path, b"new"), (&other, b"x")]).is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        let other = folder.path().join("b.txt");
        write_all(&[(&path, b"new"), (&other, b"x")]).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(std::fs::read(&other).unwrap(), b"x");
    }

    #[test]
    fn read_only_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write(&path, b"old").unwrap();
        let mut permissions = std::fs::metadata(&path).unwrap().permissions();
        permissions.set_readonly(true);
        std::fs::set_permissions(&path, permissions).unwrap();
        let error = write(&path, b"new").unwrap_err().to_string();
        assert!(error.contains("read-only"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
    }

    #[cfg(unix)]
    #[test]
    fn new_files_overwrite_nothing_and_have_their_readers() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (one, two) = (folder.path().join("one"), folder.path().join("two"));
        let files: [(&Path, &[u8], Readers); 2] =
            [(&one, b"1", Readers::Owner), (&two, b"2", Readers::All)];
        write(&two, b"old").unwrap();
        let error = write_new(&files).unwrap_err().to_string();
        assert!(error.contains("a file that exists"), "{error}");
        assert!(!one.exists());
        std::fs::remove_file(&two).unwrap();
        std::os::unix::fs::symlink("nowhere", &two).unwrap();
        assert!(write_new(&files).is_err(), "a link to nothing is something");
        std::fs::remove_file(&two).unwrap();
        write_new(&files).unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode(&one), 0o600);
        assert_ne!(mode(&two) & 0o400, 0);
        assert!(write_new(&files).is_err());
        assert_eq!(std::fs::read(&one).unwrap(), b"1");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_and_devices_are_not_replaced() {
        use std::os::unix::fs::FileTypeExt;
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a.txt"), folder.path().join("link"));
        write(&path, b"old").unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        write(&link, b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());

        // Through links, so that a mistake replaces the link and not the device.
        for (device, works) in [("/dev/null", true), ("/dev/full", false)] {
            let link = folder.path().join(device.replace('/', "_"));
            std::os::unix::fs::symlink(device, &link).unwrap();
            assert_eq!(write(&link, b"x").is_ok(), works, "{device}");
            let there = std::fs::metadata(&link).unwrap();
            assert!(there.file_type().is_char_device(), "{device}");
        }
    }
}
