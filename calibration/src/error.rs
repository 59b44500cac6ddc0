//! The error type that all verbs of the library share.

use crate::blob::predict::BlobError;
use crate::blob::write::{DeviceError, ExportError};
use crate::input_error::InputError;
use crate::model::CalibrationError;
use crate::model::config::ConfigError;
use crate::validation::cross_validation::CompareError;
use crate::verification::CheckError;

/// Any error that a verb of [`crate::prelude`] returns.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An input file that cannot be read or has invalid contents.
    #[error(transparent)]
    Input(#[from] InputError),
    /// A setting that is out of its range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A fit that failed or was cancelled.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// A model that cannot be stored in a blob.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// Bytes that are not a valid blob.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// Measurements that cannot verify a model.
    #[error(transparent)]
    Verification(#[from] CheckError),
    /// A file that cannot be written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

impl From<DeviceError> for Error {
    fn from(error: DeviceError) -> Self {
        match error {
            DeviceError::Calibration(error) => Self::Calibration(error),
            DeviceError::Export(error) => Self::Export(error),
        }
    }
}

impl From<CompareError> for Error {
    fn from(error: CompareError) -> Self {
        error.error.into()
    }
}
