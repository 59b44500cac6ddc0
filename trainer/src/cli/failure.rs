//! The errors that end a command early, and the exit codes.

use std::path::Path;
use std::process::ExitCode;

use poegp_runtime::model::load_error::LoadError;

use crate::device::error::ClientError;
use poegp_calibration::blob::predict::BlobError;
use poegp_calibration::blob::write::{DeviceError, ExportError};
use poegp_calibration::input_error::InputError;
use poegp_calibration::model::CalibrationError;
use poegp_calibration::model::gauge::GaugeTooFar;
use poegp_calibration::progress::Cancelled;

/// Exit code that a shell reports for a program that SIGINT has ended.
pub const CANCELLED_CODE: u8 = 130;

/// An error that ends a command early.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// An error in the user's data or arguments.
    #[error(transparent)]
    Input(#[from] InputError),
    /// An error in the command line itself.
    #[error("{0}")]
    Usage(String),
    /// An error of a device, or of the link to it.
    #[error(transparent)]
    Device(#[from] ClientError),
    /// A quality bound that was not met, so that nothing was written; or parts of a program that stay uncorrected.
    #[error("{0}")]
    Quality(String),
    /// A signature that does not fit.
    #[error("{0}")]
    Refused(String),
    /// An output that could not be written; no file was changed.
    #[error("{output}: not written: {error}")]
    LostOutput {
        /// Path of the output, or `standard output`.
        output: String,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// Measurements that are unfit to make or judge a model; nothing was written.
    #[error(
        "data refused: {0}\nhelp: nothing was written; --accept CAUSE, with the word in brackets, lowers the refusal \
         to a warning"
    )]
    Data(String),
    /// A calibration that Ctrl-C has cancelled.
    #[error("stopped: the calibration was cancelled, nothing was written")]
    Cancelled(#[from] Cancelled),
}

impl Failure {
    /// Creates the failure for a file or pipe that could not be written.
    pub fn lost(path: &Path, error: std::io::Error) -> Self {
        let output = path.display().to_string();
        Self::LostOutput { output, error }
    }

    /// Returns the exit code of a command that ends with this failure.
    pub fn exit_code(&self) -> ExitCode {
        match self {
            Self::Quality(_) | Self::Refused(_) | Self::LostOutput { .. } => ExitCode::from(1),
            Self::Data(_) => ExitCode::from(3),
            Self::Cancelled(_) => ExitCode::from(CANCELLED_CODE),
            _ => ExitCode::from(2),
        }
    }
}

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        match error {
            ExportError::SinglePrecisionLossTooLarge(_) => {
                Self::Quality(format!("{error}\nhelp: nothing was written"))
            }
            ExportError::Unusable(BlobError::Load(LoadError::CorrectionLimit)) => {
                Self::Usage(format!(
                    "{error}\nhelp: the poses are more than a metre or half a radian from those of the robot description: check the robot, the joint \
                 coupling and the order of the columns"
                ))
            }
            _ => Self::Usage(error.to_string()),
        }
    }
}

/// Converts a calibration error to an error about the measurement file.
pub fn calibration_failure(path: &Path, error: &CalibrationError) -> Failure {
    match error {
        CalibrationError::PositionsAlone { method } => InputError::new(
            path,
            "positions alone",
            format!("whole poses for `{method}`"),
        )
        .with_help("use --method elastic, poe or base-tool for such data")
        .into(),
        CalibrationError::TooManyPoses {
            found,
            most,
            method,
        } => InputError::new(
            path,
            format!("{found} poses"),
            format!("at most {most} for `{method}`: every pose is a point of its Gaussian process"),
        )
        .with_help("use --method elastic, which takes any number of poses")
        .into(),
        CalibrationError::TooLittleMemory {
            found,
            needed_mb,
            available_mb,
            method,
        } => InputError::new(
            path,
            format!("{found} poses, which take `{method}` about {needed_mb} MB of memory"),
            format!("at most the {available_mb} MB that are free"),
        )
        .with_help("use fewer rows, or close other programs")
        .into(),
        CalibrationError::NoPayload => InputError::new(
            path,
            "no payload_kg column",
            "a payload_kg column: `poe-gp-load` learns the effect of the payload",
        )
        .with_help("use --method poe-gp for data without payloads")
        .into(),
        CalibrationError::NothingHeldOut => InputError::new(
            path,
            "too few different poses to hold one out",
            "at least four poses of each session and target that agree with each other",
        )
        .with_help("measure more poses; a row that repeats an earlier one, or contradicts the others, does not count")
        .into(),
        _ => InputError::new(path, error.to_string(), "data that can be fitted").into(),
    }
}

/// Converts the error of a calibration or an export to an error about the measurement file.
pub fn device_failure(path: &Path, error: DeviceError) -> Failure {
    match error {
        DeviceError::Calibration(CalibrationError::Gauge(error)) => {
            InputError::new(path, error.to_string(), GaugeTooFar::EXPECTED)
                .with_help(error.remedy())
                .into()
        }
        DeviceError::Calibration(error) => calibration_failure(path, &error),
        DeviceError::Export(error) => error.into(),
    }
}
