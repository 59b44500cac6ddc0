//! The sources of a controller's program, with the records that say whether they were corrected before.

use crate::cli::correct::args::Correct;
use crate::cli::correct::paths::Paths;
use crate::cli::correct::record::{
    Corrector, Record, Records, record_path, sha256, warn_of_uncorrected,
};
use crate::cli::failure::Failure;
use crate::robot_programs::correction::engine::Direction;
use crate::robot_programs::correction::source::Source;
use poegp_calibration::input_error::InputError;

/// The files of a program as they are to be read.
pub struct Sources {
    /// The files that are corrected, and behind them those that are only read. One that is brought back has lost the
    /// insertions of its correction.
    pub all: Vec<Source>,
    /// SHA-256 of each file that is corrected, as it is on disk.
    pub hashes: Vec<String>,
    /// The records of the corrections that are taken back, each with the index of its file.
    pub corrections: Vec<(usize, Record)>,
    /// The records beside the files.
    pub records: Records,
}

impl Sources {
    /// Reads all files of a program.
    ///
    /// # Errors
    /// [`Failure`] about a file that cannot be read, was corrected already, or was corrected with another model.
    pub fn read(a: &Correct, paths: &Paths, corrector: &Corrector<'_>) -> Result<Self, Failure> {
        let (mut all, mut hashes) = (Vec::new(), Vec::new());
        let mut records = Records::default();
        let mut corrections = Vec::new();
        let (model, direction) = (corrector.sha256, corrector.direction);
        for (index, (path, _)) in paths.files.iter().enumerate() {
            let mut source = Source::read(path, true)?;
            hashes.push(sha256(&source.bytes));
            if let Some(record) = records.of_corrected(path, &source.bytes, model, direction)? {
                // The insertions of the earlier correction are removed.
                source = source.without(&record.inserted).ok_or_else(|| {
                    let found = "a record whose insertions are beyond the program";
                    InputError::new(record_path(path), found, "the record that `correct` wrote")
                })?;
                corrections.push((index, record));
            }
            all.push(source);
        }
        if direction == Direction::Inverse && !a.taught {
            let files = paths.files.iter().zip(&hashes).enumerate();
            warn_of_uncorrected(files.map(|(index, ((path, _), hash))| {
                let is_found = corrections.iter().any(|(corrected, _)| *corrected == index);
                (path.as_path(), hash.as_str(), is_found)
            }));
        }
        for path in a.with.iter().chain(&paths.beside) {
            all.push(Source::read(path, false)?);
        }
        Ok(Self {
            all,
            hashes,
            corrections,
            records,
        })
    }
}
