//! The section of a blob for the host: provenance, gauge and tools.
//!
//! The device skips it by its length, so that a change here changes nothing that the device computes.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::envelope::{BufferTooSmall, DecodeError};
use crate::Transform;
use crate::cause::Causes;
use crate::limits::{MAX_JOINTS, MAX_TOOLS};

/// Everything about a model that the host shows or uses and the device does not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Host<'a> {
    /// Where the model comes from.
    #[serde(borrow)]
    pub provenance: Provenance<'a>,
    /// The base and tool frames that the model is stated in.
    pub gauge: Gauge,
    /// The tools that were measured with (sessions, targets). The chain ends at the first. Empty for one tool without a
    /// name.
    #[serde(borrow)]
    pub tools: Vec<Tool<'a>, MAX_TOOLS>,
    /// Causes of refusals and warnings that the user of the trainer accepted.
    pub accepted: Causes,
}

/// Where a model comes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance<'a> {
    /// Name of the calibration method, as given to `--method`.
    pub method: &'a str,
    /// Version of the trainer.
    pub trainer_version: &'a str,
    /// Day of the calibration, ISO 8601 (`2026-11-20`), UTC.
    pub date: &'a str,
    /// SHA-256 of the measurement file.
    pub data_sha256: [u8; 32],
    /// Poses that were trained on.
    pub training_poses: u32,
}

/// Where the calibrated chain begins and ends. A model says the same in every gauge; the commands that it corrects move with
/// it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gauge {
    /// `instrument_from_base`.
    pub instrument_from_base: Transform<f64>,
    /// `flange_from_target` of the first tool.
    pub flange_from_target: Transform<f64>,
    /// Where the base comes from.
    pub base: FrameSource,
    /// Where the tool comes from.
    pub tool: FrameSource,
    /// Joint ranges of the grid of poses, rad or m.
    pub ranges: Vec<(f32, f32), MAX_JOINTS>,
    /// Payload at the grid in kg, where the model knows payloads.
    pub payload_kg: Option<f32>,
}

/// Where a frame of the gauge comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FrameSource {
    /// The drawing fitted to the measured poses.
    Poses,
    /// The drawing fitted to the model over the grid.
    Grid,
    /// The model before this one.
    Previous,
    /// The user stated it.
    Stated,
}

/// A tool: where its target sits seen from the target of the first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tool<'a> {
    /// The session in which it was mounted; empty when the data have none.
    pub session: &'a str,
    /// The name of the target; empty when the data have none.
    pub target: &'a str,
    /// `first_target_from_target`.
    pub first_from_target: Transform<f32>,
}

impl<'a> Host<'a> {
    /// Writes the section to the front of `buffer`, for [`Blob::host`](super::Blob::host), and returns the bytes used.
    ///
    /// # Errors
    /// [`BufferTooSmall`].
    pub fn encode<'b>(&self, buffer: &'b mut [u8]) -> Result<&'b [u8], BufferTooSmall> {
        postcard::to_slice(self, buffer)
            .map(|used| &*used)
            .map_err(|_| BufferTooSmall)
    }

    /// The section in `bytes`, which must hold it exactly.
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
