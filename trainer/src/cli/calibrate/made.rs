//! The result of a calibration.

use std::path::PathBuf;

use crate::cli::calibrate::document::CalibrateJson;
use poegp_calibration::blob::write::CalibratedBlob;

/// A finished calibration with all its outputs, before anything is written.
pub struct Made {
    pub found: CalibratedBlob,
    pub document: CalibrateJson,
    /// The HTML report, if it is asked for.
    pub report: Option<String>,
    /// The text of the project file, if it is asked for.
    pub project: Option<String>,
    /// The earlier blob whose commands the new ones are compared with.
    pub previous: Option<PathBuf>,
}
