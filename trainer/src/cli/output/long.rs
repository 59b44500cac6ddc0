//! An output that is written piece by piece, of any length: it takes its place whole, together with the other outputs.

use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use crate::cli::failure::Failure;
use crate::cli::output::paths::{could_be_written, is_stream};
use crate::cli::output::transaction::{Staged, writing};

/// Bytes that are written at once.
const BUFFER: usize = 1 << 18;

/// A long output. What is written goes to a temporary file, beside its place, or for standard output and pipes where the
/// system keeps such files. Dropped, it leaves nothing.
pub struct LongOutput {
    path: PathBuf,
    destination: Destination,
}

enum Destination {
    /// A file that is to take its place, and a writer to the same file.
    File(Staged, BufWriter<File>),
    Stream(BufWriter<File>),
}

/// A long output that is complete.
pub(super) enum Complete {
    File(Staged),
    /// Where it goes, and the file with it, at its beginning.
    Stream(PathBuf, File),
}

impl LongOutput {
    /// For `path`; `-` is standard output.
    ///
    /// # Errors
    /// As [`super::check`].
    pub fn new(path: &Path) -> Result<Self, Failure> {
        let _writing = writing();
        let lost = |error| Failure::lost(path, error);
        let buffered = |file| BufWriter::with_capacity(BUFFER, file);
        let destination = if is_stream(path) {
            Destination::Stream(buffered(tempfile::tempfile().map_err(lost)?))
        } else {
            could_be_written(path)?;
            let staged = Staged::begin(path)?;
            let file = staged.file().try_clone().map_err(lost)?;
            Destination::File(staged, buffered(file))
        };
        Ok(Self {
            path: path.to_path_buf(),
            destination,
        })
    }

    /// Writes more.
    ///
    /// # Errors
    /// [`Failure::LostOutput`].
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        let (Destination::File(_, writer) | Destination::Stream(writer)) = &mut self.destination;
        let written = writer.write_all(bytes);
        written.map_err(|error| Failure::lost(&self.path, error))
    }

    /// All that was written, on disk where it is a file.
    pub(super) fn complete(self) -> Result<Complete, Failure> {
        let path = self.path;
        let complete = match self.destination {
            Destination::File(staged, writer) => writer
                .into_inner()
                .map_err(|error| error.into_error())
                .and_then(|file| file.sync_all())
                .map(|()| Complete::File(staged)),
            Destination::Stream(writer) => writer
                .into_inner()
                .map_err(|error| error.into_error())
                .and_then(|mut file| file.rewind().map(|()| file))
                .map(|file| Complete::Stream(path.clone(), file)),
        };
        complete.map_err(|error| Failure::lost(&path, error))
    }
}
