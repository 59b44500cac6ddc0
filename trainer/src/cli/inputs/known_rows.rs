//! Rows of measurement files that were read before: a model is not judged by them.

use std::collections::HashMap;
use std::path::PathBuf;

use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::{Measurement, MeasurementSet};

/// Measured rows, each with the file that it was read from.
pub struct KnownRows(HashMap<Vec<u64>, PathBuf>);

impl KnownRows {
    /// Collects the rows of the training data.
    pub fn new(train: &MeasurementSet) -> Self {
        let mut known = Self(HashMap::new());
        known.extend(train);
        known
    }

    /// Adds the rows of a test file, whatever their order, the file's name and its line ends are.
    ///
    /// # Errors
    /// [`InputError`] if another file has some of them, too.
    pub fn add(&mut self, test: &MeasurementSet) -> Result<(), InputError> {
        let rows = &test.measurements;
        let known = |m: &Measurement| self.0.get(&key(m)).map(|file| (m.line, file));
        let mut found = rows.iter().filter_map(known);
        if let Some((line, file)) = found.next() {
            let of_file = 1 + found.filter(|(_, other)| *other == file).count();
            return Err(InputError::new(
                &test.path,
                format!("{of_file} of {} rows of {}", rows.len(), file.display()),
                "held-out poses, each in one file",
            )
            .at_line(line)
            .with_help("leave these rows out of one of the files"));
        }
        self.extend(test);
        Ok(())
    }

    fn extend(&mut self, set: &MeasurementSet) {
        let rows = set.measurements.iter();
        self.0.extend(rows.map(|m| (key(m), set.path.clone())));
    }
}

/// Returns joints, payload and measured position of a row.
fn key(m: &Measurement) -> Vec<u64> {
    let numbers = m.joints.iter().chain(&m.position).chain(&m.payload_kg);
    // 0.0 and −0.0 are the same value.
    numbers.map(|x| (x + 0.0).to_bits()).collect()
}
