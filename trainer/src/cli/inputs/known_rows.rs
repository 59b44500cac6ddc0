//! Rows of measurement files that were read before: a model is not judged by them.

use std::path::PathBuf;

use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::{Measurement, MeasurementSet};

/// Largest distance of a joint, in rad or m, and of a coordinate, in m, between a row and its copy in another file: what
/// fewer digits leave. Repeats of an industrial arm are farther apart.
const SAME: (f64, f64) = (1e-4, 6e-6);

/// Measured rows in the order of their first coordinate, each with the file that it was read from.
pub struct KnownRows(Vec<(Measurement, PathBuf)>);

impl KnownRows {
    /// Collects the rows of the training data.
    pub fn new(train: &MeasurementSet) -> Self {
        let mut known = Self(Vec::new());
        known.extend(train);
        known
    }

    /// Adds the rows of a test file, whatever their order, their digits, the file's name and its line ends are.
    ///
    /// # Errors
    /// [`InputError`] if another file has some of them, too.
    pub fn add(&mut self, test: &MeasurementSet) -> Result<(), InputError> {
        let rows = &test.measurements;
        let known = |m: &Measurement| self.file_of(m).map(|file| (m.line, file));
        let mut found = rows.iter().filter_map(known);
        if let Some((line, file)) = found.next() {
            let of_file = 1 + found.filter(|(_, other)| *other == file).count();
            return Err(InputError::new(
                &test.path,
                format!(
                    "{of_file} of {} rows that are also in {}",
                    rows.len(),
                    file.display()
                ),
                "held-out poses, each in one file only",
            )
            .at_line(line)
            .with_help("remove these rows from one of the files"));
        }
        self.extend(test);
        Ok(())
    }

    /// Returns the file that has a row.
    fn file_of(&self, row: &Measurement) -> Option<&PathBuf> {
        let x = row.position[0];
        let from = (self.0).partition_point(|(known, _)| known.position[0] < x - SAME.1);
        let near = self.0[from..].iter();
        near.take_while(|(known, _)| known.position[0] <= x + SAME.1)
            .find(|(known, _)| is_same(known, row))
            .map(|(_, file)| file)
    }

    fn extend(&mut self, set: &MeasurementSet) {
        let rows = set.measurements.iter();
        self.0.extend(rows.map(|m| (m.clone(), set.path.clone())));
        (self.0).sort_by(|a, b| a.0.position[0].total_cmp(&b.0.position[0]));
    }
}

/// Returns whether two rows have the same joints, payload and measured position.
fn is_same(a: &Measurement, b: &Measurement) -> bool {
    let near = |a: &[f64], b: &[f64], most: f64| {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= most)
    };
    near(&a.joints, &b.joints, SAME.0)
        && near(a.position.as_slice(), b.position.as_slice(), SAME.1)
        && a.payload_kg == b.payload_kg
}
