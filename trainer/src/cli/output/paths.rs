//! Checks whether paths can be written.

use std::path::Path;

use poegp_calibration::input_error::InputError;

use crate::cli::failure::Failure;
use crate::cli::output::transaction::{check_temporary, folder_of};
use crate::cli::terminal::print::is_stdout;

/// Whether writing to a path cannot be undone, as for standard output or a pipe.
pub fn is_stream(path: &Path) -> bool {
    is_stdout(path) || std::fs::metadata(path).is_ok_and(|there| !there.is_file())
}

/// Refuses a path that cannot be written; it creates a temporary file, so the caller holds the lock on writing.
pub fn could_be_written(path: &Path) -> Result<(), Failure> {
    if path.as_os_str().is_empty() || path.is_dir() {
        let expected = "the path of a file to write";
        return Err(InputError::new(path, "a folder", expected).into());
    }
    match std::fs::metadata(path) {
        Ok(there) if !there.is_file() => return Ok(()),
        // Renaming would replace even a read-only file, against the wish of its owner.
        Ok(there) if there.permissions().readonly() => {
            let found = "a file that is read-only";
            return Err(InputError::new(path, found, "a file that can be written").into());
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
        .with_help("create the folder first; none is created here")
        .into());
    }
    check_temporary(folder).map_err(|error| match error.kind() {
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            Failure::lost(path, error)
        }
        _ => {
            let found = format!("an error while writing ({error})");
            InputError::new(path, found, "a file that can be written").into()
        }
    })
}
