//! Files that are written whole or not at all.
//!
//! Every output is checked before the work begins (does its folder exist, is it not a folder itself), written to a
//! temporary file beside its place and renamed: a failure leaves what was there before. No folder is created.

use std::io::Write;
use std::path::Path;

use crate::error::InputError;

/// Refuses a path that could not be written, before the work that would be lost.
///
/// # Errors
/// [`InputError`] names the path and what is wrong with it.
pub fn check(path: &Path) -> Result<(), InputError> {
    if path.as_os_str().is_empty() || path.is_dir() {
        return Err(InputError::new(
            path,
            "a folder",
            "the path of a file to write",
        ));
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
    tempfile::NamedTempFile::new_in(folder)
        .map(drop)
        .map_err(|error| refused(path, &error))
}

/// Writes `bytes` to `path`, or leaves what is there.
///
/// # Errors
/// As [`check`].
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), InputError> {
    check(path)?;
    let save = || -> std::io::Result<()> {
        let mut file = tempfile::Builder::new()
            .prefix(".poegp-")
            .permissions_of_a_plain_file()
            .tempfile_in(folder_of(path))?;
        file.write_all(bytes)?;
        file.as_file().sync_all()?;
        file.persist(path).map_err(|e| e.error)?;
        Ok(())
    };
    save().map_err(|error| refused(path, &error))
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
        format!("a place that cannot be written ({error})"),
        "a file that can be written",
    )
}

/// Readable by all, as a file made by any other program.
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
}
