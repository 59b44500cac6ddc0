//! An output of any length that is written piece by piece: its target is replaced at once, together with the other
//! outputs.

use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use crate::cli::failure::Failure;
use crate::cli::output::paths::{could_be_written, is_stream};
use crate::cli::output::transaction::{Staged, writing};

/// Bytes that are buffered before a write.
const BUFFER: usize = 1 << 18;

/// A long output. Its bytes go to a temporary file: beside the target, or, for standard output and pipes, in the system's
/// folder for temporary files. Dropping it leaves no file behind.
pub struct LongOutput {
    path: PathBuf,
    destination: Destination,
}

enum Destination {
    /// A staged file that will replace the target, and a writer to that file.
    File(Staged, BufWriter<File>),
    Stream(BufWriter<File>),
}

/// A long output that is completely written.
pub(super) enum Complete {
    File(Staged),
    /// Path of the stream, and the temporary file with its contents, rewound to the start.
    Stream(PathBuf, File),
}

impl LongOutput {
    /// Creates a long output to `path`; `-` is standard output.
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

    /// Appends bytes.
    ///
    /// # Errors
    /// [`Failure::LostOutput`].
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        let (Destination::File(_, writer) | Destination::Stream(writer)) = &mut self.destination;
        let written = writer.write_all(bytes);
        written.map_err(|error| Failure::lost(&self.path, error))
    }

    /// Completes the output; a file is then on disk.
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
