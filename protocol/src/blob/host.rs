//! The host section of a blob: provenance, gauge and tools.
//!
//! The device skips this section by its length, so its content does not affect what the device computes.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::envelope::{BufferTooSmall, DecodeError};
use crate::Transform;
use crate::cause::Causes;
use crate::limits::{MAX_JOINTS, MAX_TOOLS};

/// Information about a model that only the host shows or uses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Host<'a> {
    /// Provenance of the model.
    #[serde(borrow)]
    pub provenance: Provenance<'a>,
    /// Base and tool frames in which the model is stated.
    pub gauge: Gauge,
    /// Tools of the measurements, one for each session and target. The chain ends at the first one. Empty for a single tool
    /// without a name.
    #[serde(borrow)]
    pub tools: Vec<Tool<'a>, MAX_TOOLS>,
    /// Causes of refusals and warnings that the trainer's user accepted.
    pub accepted: Causes,
}

/// Provenance of a model: method, software, date and data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance<'a> {
    /// Name of the calibration method, as given to `--method`.
    pub method: &'a str,
    /// Version of the trainer.
    pub trainer_version: &'a str,
    /// Date of the calibration in UTC, as ISO 8601 (`2026-11-20`).
    pub date: &'a str,
    /// SHA-256 of the measurement file.
    pub data_sha256: [u8; 32],
    /// Number of different poses in the training set: repeats of one count once.
    pub training_poses: u32,
}

/// The base and tool frames at which the calibrated chain begins and ends. A model predicts the same measurements in every
/// gauge, but the commands that it corrects move with the gauge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gauge {
    /// Transform `instrument_from_base`.
    pub instrument_from_base: Transform<f64>,
    /// Transform `flange_from_target` of the first tool.
    pub flange_from_target: Transform<f64>,
    /// Source of the base frame.
    pub base: FrameSource,
    /// Source of the tool frame.
    pub tool: FrameSource,
    /// Joint ranges of the grid of poses, in rad or m.
    pub ranges: Vec<(f32, f32), MAX_JOINTS>,
    /// Payload at the grid poses in kg, if the model depends on the payload.
    pub payload_kg: Option<f32>,
}

/// Source of a frame of the gauge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FrameSource {
    /// Fit of the nominal robot to the measured poses.
    Poses,
    /// Fit of the nominal robot to the model over the grid.
    Grid,
    /// The previous model.
    Previous,
    /// The user's statement.
    Stated,
    /// Only of a tool: fit of the nominal robot to positions alone, which do not show the tool's orientation.
    Positions,
}

/// A tool, described by the pose of its target relative to the target of the first tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tool<'a> {
    /// Session in which the tool was mounted; empty if the data have none.
    pub session: &'a str,
    /// Name of the target; empty if the data have none.
    pub target: &'a str,
    /// Transform `first_target_from_target`.
    pub first_from_target: Transform<f32>,
}

impl<'a> Host<'a> {
    /// Writes the section, the content of [`Blob::host`](super::Blob::host), to the front of `buffer` and returns the bytes
    /// used.
    ///
    /// # Errors
    /// [`BufferTooSmall`].
    pub fn encode<'b>(&self, buffer: &'b mut [u8]) -> Result<&'b [u8], BufferTooSmall> {
        postcard::to_slice(self, buffer)
            .map(|used| &*used)
            .map_err(|_| BufferTooSmall)
    }

    /// Decodes the section from `bytes`, which must contain nothing else.
    ///
    /// # Errors
    /// [`DecodeError::MalformedPayload`].
    pub fn decode(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        match postcard::take_from_bytes(bytes) {
            Ok((host, [])) => Ok(host),
            _ => Err(DecodeError::MalformedPayload),
        }
    }
}
