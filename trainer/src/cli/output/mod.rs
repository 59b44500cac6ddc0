//! Output files: each is written completely or not at all, and so is the set of all outputs of a command.
//!
//! Every output is checked before the work begins: its folder must exist, and it must be neither a folder nor protected.
//! All are written to temporary files beside their targets ([`transaction`]), then to standard output and pipes, which
//! cannot be undone, and then renamed: a failure leaves the old files unchanged. No folder is created. A link is
//! followed. A target that is not a regular file (`/dev/null`, a pipe) is written to, never replaced. A file that is no
//! earlier output of the same [`kind`] is not replaced.

pub mod kind;
pub mod long;
mod paths;
pub mod transaction;

use std::io::Read;
use std::path::{Path, PathBuf};

use poegp_calibration::input_error::InputError;
use poegp_protocol::blob::envelope;

use crate::cli::failure::Failure;
use crate::cli::output::kind::{Kind, check_kind};
use crate::cli::output::long::{Complete, LongOutput};
use crate::cli::output::paths::{could_be_written, is_stream};
use crate::cli::output::transaction::{Readers, Staged, commit, folder_of, writing};
use crate::cli::terminal::print::{is_stdout, to_stdout_all};
use crate::cli::terminal::warnings::{self, Warning};
use crate::signing::id_text;

/// Refuses a path that cannot be written, before any work that would be lost.
///
/// # Errors
/// [`InputError`] names the path and what is wrong with it.
pub fn check(path: &Path) -> Result<(), Failure> {
    let _writing = writing();
    could_be_written(path)
}

/// Refuses a path that cannot be written, or at which something exists already.
///
/// # Errors
/// [`InputError`] names the path and what is wrong with it.
pub fn check_new(path: &Path) -> Result<(), Failure> {
    let _writing = writing();
    could_be_new(path)
}

/// Refuses a path as [`check_new`] does; the caller holds the lock on writing.
fn could_be_new(path: &Path) -> Result<(), Failure> {
    if std::fs::symlink_metadata(path).is_ok_and(|there| !there.is_dir()) {
        return Err(exists(path));
    }
    could_be_written(path)
}

/// Refuses outputs that exist already with other contents and are not empty: these files are made to be filled in by hand.
///
/// # Errors
/// [`InputError`] names the path.
pub fn check_not_filled_in(outputs: &[(&Path, &[u8])]) -> Result<(), Failure> {
    let is_other = |(path, bytes): &&(&Path, &[u8])| {
        !is_stream(path)
            && std::fs::read(path).is_ok_and(|there| !there.is_empty() && there != *bytes)
    };
    match outputs.iter().find(is_other) {
        None => Ok(()),
        Some((path, _)) => {
            let expected = "a new file, or one with the contents that this command writes";
            Err(InputError::new(path, "a file with other contents", expected)
                .with_help(
                    "something may have been entered there by hand: name another file, or remove this one",
                )
                .into())
        }
    }
}

/// Refuses to replace a signed model: the new one would have no signature.
///
/// # Errors
/// [`InputError`] names the path.
pub fn check_not_signed(out: &Path) -> Result<(), Failure> {
    if !out.is_file() {
        return Ok(());
    }
    let bytes = std::fs::read(out).unwrap_or_default();
    match envelope::open(&bytes).ok().and_then(|e| e.trailer) {
        None => Ok(()),
        Some(trailer) => Err(InputError::new(
            out,
            format!(
                "a model signed by key {} as revision {}",
                id_text(&trailer.key_id),
                trailer.revision
            ),
            "another file for a model without a signature",
        )
        .with_help("give another file with --out, and sign that, or remove this one first")
        .into()),
    }
}

fn exists(path: &Path) -> Failure {
    InputError::new(path, "a file that exists", "the name of a new file").into()
}

/// A file that must not exist yet: path, contents, and who may read it.
pub type NewFile<'a> = (&'a Path, &'a [u8], Readers);

/// Writes all outputs of a command or none of them; `-` is standard output.
///
/// # Errors
/// [`InputError`] as from [`check`], [`Failure::LostOutput`] if writing fails: then nothing is changed.
pub fn write_outputs(outputs: &[(&Path, &[u8])]) -> Result<(), Failure> {
    write_with_new(&[], outputs)
}

/// A text and the path to write it to. If either is missing, nothing is written.
pub type Text<'a> = (Option<&'a Path>, Option<&'a str>);

/// Writes texts as [`write_outputs`] does.
pub fn write_texts(texts: &[Text<'_>]) -> Result<(), Failure> {
    write_outputs(&given(texts).collect::<Vec<_>>())
}

/// Writes the bytes of a blob and texts as [`write_outputs`] does.
pub fn write_with_blob(blob: (&Path, &[u8]), texts: &[Text<'_>]) -> Result<(), Failure> {
    write_outputs(
        &std::iter::once(blob)
            .chain(given(texts))
            .collect::<Vec<_>>(),
    )
}

fn given<'a>(texts: &'a [Text<'a>]) -> impl Iterator<Item = (&'a Path, &'a [u8])> {
    let given = texts.iter().filter_map(|(path, text)| path.zip(*text));
    given.map(|(path, text)| (path, text.as_bytes()))
}

/// Writes outputs as [`write_outputs`] does, together with new files that must not overwrite anything.
///
/// # Errors
/// As [`write_outputs`].
pub fn write_with_new(new: &[NewFile<'_>], outputs: &[(&Path, &[u8])]) -> Result<(), Failure> {
    write_all(None, new, outputs)
}

/// Writes outputs as [`write_outputs`] does, together with a long output that is completely written.
///
/// # Errors
/// As [`write_outputs`].
pub fn write_with_long(long: LongOutput, outputs: &[(&Path, &[u8])]) -> Result<(), Failure> {
    write_all(Some(long), &[], outputs)
}

fn write_all(
    long: Option<LongOutput>,
    new: &[NewFile<'_>],
    outputs: &[(&Path, &[u8])],
) -> Result<(), Failure> {
    let _writing = writing();
    let (streams, files): (Vec<_>, Vec<_>) = outputs.iter().partition(|(path, _)| is_stream(path));
    let mut staged = Vec::new();
    for (path, bytes, readers) in new {
        could_be_new(path)?;
        staged.push(Staged::new_file(path, bytes, *readers)?);
    }
    for (path, bytes) in files {
        could_be_written(path)?;
        staged.push(Staged::replacing(path, bytes)?);
    }
    let mut long_stream = None;
    match long.map(LongOutput::complete).transpose()? {
        Some(Complete::File(file)) => staged.push(file),
        Some(Complete::Stream(path, file)) => long_stream = Some((path, file)),
        None => {}
    }
    if let Some((path, mut bytes)) = long_stream {
        write_stream(&path, &mut bytes)?;
    }
    for (path, bytes) in streams {
        let mut bytes: &[u8] = bytes;
        write_stream(path, &mut bytes)?;
    }
    commit(staged)
}

/// Writes to standard output, a device or a pipe.
fn write_stream(path: &Path, bytes: &mut dyn Read) -> Result<(), Failure> {
    if is_stdout(path) {
        return to_stdout_all(bytes);
    }
    could_be_written(path)?;
    let stream = std::fs::OpenOptions::new().write(true).open(path);
    stream
        .and_then(|mut stream| std::io::copy(bytes, &mut stream).map(drop))
        .map_err(|error| Failure::lost(path, error))
}

pub fn json_text(document: &impl serde::Serialize) -> Result<String, Failure> {
    let text = serde_json::to_string_pretty(document).map_err(|e| Failure::Usage(e.to_string()))?;
    Ok(text + "\n")
}

/// Formats the results of a command as a JSON document, with the warnings of the command.
pub fn document_text(document: &impl serde::Serialize) -> Result<String, Failure> {
    #[derive(serde::Serialize)]
    struct WithWarnings<'a, T> {
        #[serde(flatten)]
        document: &'a T,
        warnings: Vec<Warning>,
    }
    json_text(&WithWarnings {
        document,
        warnings: warnings::documented(),
    })
}

/// Writes the results of a command as JSON, with the version of the program, if `path` is given.
pub fn write_summary(path: Option<&Path>, summary: serde_json::Value) -> Result<(), Failure> {
    match path {
        Some(path) => write_outputs(&[(path, summary_text(summary)?.as_bytes())]),
        None => Ok(()),
    }
}

/// Formats the results of a command as a JSON document, with the version of the program, and its warnings if there are any.
pub fn summary_text(mut summary: serde_json::Value) -> Result<String, Failure> {
    summary["version"] = env!("CARGO_PKG_VERSION").into();
    let warnings = warnings::documented();
    if !warnings.is_empty() {
        summary["warnings"] = serde_json::json!(warnings);
    }
    json_text(&summary)
}

/// Returns one path for all spellings of the path of a file, which may not exist yet.
fn identity(path: &Path) -> PathBuf {
    if is_stdout(path) {
        return PathBuf::from("-");
    }
    let name = path.file_name().unwrap_or_default();
    let folder = || std::fs::canonicalize(folder_of(path)).map(|folder| folder.join(name));
    let found = std::fs::canonicalize(path).or_else(|_| folder());
    found.unwrap_or_else(|_| path.to_path_buf())
}

/// Whether two paths are of one file, which may not exist yet.
pub fn is_same_file(a: &Path, b: &Path) -> bool {
    identity(a) == identity(b)
}

/// The path of an output, if it is asked for, and what is written there.
pub type Output<'a> = (Option<&'a Path>, Kind);

/// Refuses, before the work, outputs that cannot be written, that are the same file, or that would overwrite an input or a
/// file of another kind. Returns the paths.
///
/// # Errors
/// [`InputError`] names the path and what is wrong with it.
pub fn check_outputs<'a>(
    outputs: &[Output<'a>],
    inputs: &[&Path],
) -> Result<Vec<Option<&'a Path>>, Failure> {
    let paths = outputs.iter().map(|(path, _)| *path).collect();
    let outputs = outputs
        .iter()
        .filter_map(|(path, kind)| Some(((*path)?, *kind)));
    let outputs: Vec<(&Path, Kind)> = outputs.collect();
    for (i, (path, kind)) in outputs.iter().enumerate() {
        let is_same = |(other, _): &(&Path, Kind)| identity(other) == identity(path);
        if outputs[..i].iter().any(is_same) {
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
        check_kind(path, *kind)?;
    }
    Ok(paths)
}

/// A folder for outputs; it is removed at the end if it was created and is still empty.
pub struct OutputFolder<'a> {
    path: &'a Path,
    is_new: bool,
}

impl Drop for OutputFolder<'_> {
    fn drop(&mut self) {
        if self.is_new {
            let _ = std::fs::remove_dir(self.path);
        }
    }
}

/// Creates a folder if it does not exist; its parent must exist.
pub fn make_folder(path: &Path) -> Result<OutputFolder<'_>, Failure> {
    if path.is_dir() {
        let is_new = false;
        return Ok(OutputFolder { path, is_new });
    }
    std::fs::create_dir(path).map_err(|error| {
        InputError::new(
            path,
            format!("a folder that cannot be created ({error})"),
            "a folder, or a new one in a folder that exists",
        )
    })?;
    let is_new = true;
    Ok(OutputFolder { path, is_new })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
        write_outputs(&[(path, bytes)])
    }

    fn write_new(files: &[NewFile<'_>]) -> Result<(), Failure> {
        write_with_new(files, &[])
    }

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
        assert!(write_outputs(&[(&path, b"new"), (&other, b"x")]).is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        let other = folder.path().join("b.txt");
        write_outputs(&[(&path, b"new"), (&other, b"x")]).unwrap();
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
