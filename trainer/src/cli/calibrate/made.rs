//! What a calibration comes to.

use std::path::PathBuf;

use crate::cli::calibrate::document::CalibrateJson;
use poegp_calibration::blob::write::CalibratedBlob;

/// A calibration with everything that can be said of it; nothing is written.
pub struct Made {
    pub found: CalibratedBlob,
    pub document: CalibrateJson,
    /// The HTML page, where one is asked for.
    pub report: Option<String>,
    /// The project file, where one is asked for.
    pub project: Option<String>,
    /// The blob whose commands the new ones are compared with.
    pub previous: Option<PathBuf>,
}
