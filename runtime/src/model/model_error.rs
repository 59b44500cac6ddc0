//! Reasons why bytes are not a model.

use core::fmt;

use poegp_protocol::blob::DecodeError;

use super::load_error::LoadError;

/// Why bytes are not a model. The previous model is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelError {
    /// The bytes are not a blob, or were damaged.
    Decode(DecodeError),
    /// The blob is intact, but a robot must not be moved by a number in it.
    Load(LoadError),
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Decode(error) => error.fmt(f),
            Self::Load(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for ModelError {}

impl From<LoadError> for ModelError {
    fn from(error: LoadError) -> Self {
        Self::Load(error)
    }
}
