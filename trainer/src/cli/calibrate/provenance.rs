//! The files from which a calibration or a comparison was made, for its document and its report.

use crate::cli::calibrate::calibrated::Calibrated;
use crate::cli::inputs::Arm;
use crate::report::{FileSummary, Provenance};
use poegp_calibration::blob;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::touch::TouchSet;

/// Returns the provenance of a calibration: the files that were read.
pub fn provenance(c: &Calibrated<'_>, seed: Option<u64>) -> Provenance {
    let read = files_of_sets(&c.measured.set, &c.tests.files);
    provenance_of_files(&c.job.robot, &c.measured.arm, c.origin, seed, read)
}

/// Summarises the files of measurements that were read.
pub fn files_of_sets(train: &MeasurementSet, tests: &[MeasurementSet]) -> Vec<FileSummary> {
    let mut files = vec![FileSummary::of_set("training", train)];
    files.extend(tests.iter().map(|set| FileSummary::of_set("test", set)));
    files
}

/// Returns the provenance of a result: `files` that were read, and the robot's file if it has one.
pub fn provenance_of_files(
    robot: &str,
    arm: &Arm,
    origin: &blob::write::Provenance,
    seed: Option<u64>,
    mut files: Vec<FileSummary>,
) -> Provenance {
    // A built-in robot has no file; its name and the trainer's version identify it.
    if let Ok(bytes) = std::fs::read(robot) {
        files.push(FileSummary::of_bytes("robot", robot, &bytes));
    }
    let date = origin.date.clone();
    Provenance {
        seed,
        ..Provenance::new(&arm.robot.name, &origin.serial_number, date, files)
    }
}

/// Returns the provenance of a calibration by touches, including the blob that it made.
pub fn provenance_of_touches(
    robot: &str,
    arm: &Arm,
    origin: &blob::write::Provenance,
    set: &TouchSet,
) -> Provenance {
    let files = FileSummary::of_touches(set).to_vec();
    provenance_of_files(robot, arm, origin, None, files)
}
