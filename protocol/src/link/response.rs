//! The responses of the device.

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

use super::{CycleSettings, MAX_NAME, NONCE_LENGTH, Refusal};
use crate::Transform;
use crate::blob::envelope::KEY_ID_LENGTH;
use crate::cause::Causes;
use crate::limits::{MAX_JOINTS, OUTPUTS};

/// Key id: the first bytes of a public key, enough to distinguish keys.
pub type KeyId = [u8; KEY_ID_LENGTH];

/// A response of the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // nothing can be boxed
pub enum Response {
    /// The identity and state of the device.
    Identity(Identity),
    /// The compensated pose.
    Evaluation(Evaluation),
    /// The corrected joint command.
    Corrected(Corrected),
    /// The compensated pose with its intermediate results.
    Trace(Trace),
    /// From now on the absence of cyclic requests is no fault.
    CyclicStopped,
    /// The upload of a blob is in progress.
    Uploading {
        /// Number of bytes received so far.
        received: u32,
    },
    /// The uploaded blob is a model that this device may run.
    Verified(ModelIdentity),
    /// The verified blob is stored in a slot and will run after the next start.
    Committed(StoredModel),
    /// The counters since the start.
    Statistics(Statistics),
    /// The device restarts as soon as this answer has been sent.
    Restarting,
    /// The request was not carried out; nothing has changed.
    Refused(Refusal),
    /// The command to send on.
    Commanded(Commanded),
    /// The nonce with which to sign the next request.
    Challenge {
        /// The nonce, which does not repeat on a board with random numbers.
        nonce: [u8; NONCE_LENGTH],
    },
}

/// A response of the cycle. It is encoded on its own, so that the other responses cost the cycle nothing.
pub trait CyclicResponse: Serialize {
    /// Number of the corresponding [`Response`] variant on the wire.
    const NUMBER: u8;
}

impl CyclicResponse for Evaluation {
    const NUMBER: u8 = 1;
}

impl CyclicResponse for Corrected {
    const NUMBER: u8 = 2;
}

impl CyclicResponse for Trace {
    const NUMBER: u8 = 3;
}

impl CyclicResponse for Refusal {
    const NUMBER: u8 = 10;
}

impl CyclicResponse for Commanded {
    const NUMBER: u8 = 11;
}

/// The identity of the device, its settings and its models.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// Protocol version of the firmware, [`super::PROTOCOL_VERSION`].
    pub protocol_version: u8,
    /// Version of the firmware.
    pub firmware_version: String<MAX_NAME>,
    /// CRC-32C of the image in flash, which identifies the build.
    pub image_crc: u32,
    /// Name of the board.
    pub board: String<MAX_NAME>,
    /// Capacity for rows of inducing points, in words (`f32`).
    pub capacity_words: u32,
    /// Capacity for a blob, in bytes.
    pub capacity_bytes: u32,
    /// Frequency of the tick counter, in Hz.
    pub tick_hz: u32,
    /// Deadline for the answer to a cyclic request, in ticks.
    pub deadline_ticks: u32,
    /// The key whose models the device accepts.
    pub key: Key,
    /// Whether corrections are bypassed.
    pub bypass: bool,
    /// Current settings of the cycle.
    pub cycle: CycleSettings,
    /// The active model, or a model that was ordered and is about to become active.
    pub model: Option<ModelIdentity>,
    /// Whether `model` still waits, because the correction of the previous model is being removed.
    pub pending: bool,
    /// Contents of the two slots, according to their headers.
    pub slots: [Option<StoredModel>; 2],
    /// Number of completed writes to the slots since their flash was first used.
    pub slot_writes: u32,
    /// Reason of the device's last start.
    pub start: StartReason,
}

/// The reason why the device started. All starts but a power-on preserve the memory in which the firmware notes the reason
/// before it restarts, or while its watchdog waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StartReason {
    /// The power was switched on, or was off for so long that the memory lost the note.
    PowerOn,
    /// A `Restart` request.
    Requested,
    /// The watchdog: cyclic requests were expected and none was answered.
    Cycles,
    /// The watchdog: the background made no progress.
    Background,
    /// A panic of the firmware.
    Panic {
        /// Source line of the panic.
        line: u32,
    },
    /// A fault: the processor could not execute an instruction.
    Fault {
        /// Address of the instruction.
        address: u32,
    },
    /// No noted reason: the watchdog, because a cycle did not end or interrupts stayed off; or the reset line.
    Unexplained,
}

/// The public key that decides which models a device accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Key {
    /// No public key is provisioned: the device accepts every intact model.
    None,
    /// The device accepts only models signed by this key.
    Provisioned(KeyId),
    /// The page of the key is damaged or incompletely written: the device accepts no model. Provisioning may be repeated.
    Unusable,
}

/// The identity of a model that runs or may run on the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelIdentity {
    /// Name of the robot.
    pub robot: String<MAX_NAME>,
    /// Serial number of the arm.
    pub serial_number: String<MAX_NAME>,
    /// CRC in the header of the model's blob.
    pub blob_crc: u32,
    /// Number of joints of the arm.
    pub joints: u8,
    /// Number of inducing points of the correction.
    pub inducing_points: u32,
    /// Upper bound on the instructions of one command, with its frames.
    pub instructions: u32,
    /// Revision under the model's signature, if the device has verified that signature. The device accepts no lower one.
    pub revision: Option<u32>,
    /// Causes of warnings about the measurements from which the model was calibrated.
    pub warnings: Causes,
}

/// The contents of a slot, according to its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredModel {
    /// Number of the slot, 0 or 1.
    pub slot: u8,
    /// Whether this model runs after the next start.
    pub first: bool,
    /// Length of the blob in bytes.
    pub length: u32,
    /// CRC-32C of all bytes of the blob.
    pub crc: u32,
}

/// The compensated pose T_gp(q, m)·f(q) as computed by the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// CRC in the header of the blob of the model that answered; 0 without a model.
    pub blob_crc: u32,
    /// Compensated pose `base_from_target`.
    pub pose: Transform<f32>,
    /// Correction twist g (v, ω) in the base frame after bounding, in m and rad.
    pub correction: [f32; OUTPUTS],
    /// Share of the prior that the training data explain at this input, 0 to 1.
    pub trust: f32,
    /// Predictive standard deviation of the position per axis, in m; `None` if the model has none.
    pub position_sigma: Option<f32>,
    /// Status bits, those of the runtime's `Status`.
    pub status: u8,
    /// Duration of the evaluation, in ticks.
    pub ticks: u32,
}

/// The corrected joint command, in answer to a stateless [`Correct`](super::Request::Correct).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Corrected {
    /// CRC in the header of the blob of the model that answered; 0 without a model.
    pub blob_crc: u32,
    /// Command for the controller's joints, in rad or m; the requested joints if nothing is corrected.
    pub joints: Vec<f32, MAX_JOINTS>,
    /// Share of the arm's error that is corrected, 0 to 1; 0 if nothing is corrected.
    pub applied: f32,
    /// Distance that remains between the calibrated arm at this command and the nominal arm at the requested one, in m.
    pub position_error: f32,
    /// Rotation that remains between the two, in rad.
    pub rotation_error: f32,
    /// Status bits, those of the runtime's `Status`.
    pub status: u8,
    /// Duration of the correction, in ticks.
    pub ticks: u32,
}

/// The corrected command to pass on, in answer to the command of a cycle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Commanded {
    /// CRC in the header of the blob of the model that answered; 0 without a model.
    pub blob_crc: u32,
    /// Command for the controller's joints, in rad or m. Its difference from the requested command never steps.
    pub joints: Vec<f32, MAX_JOINTS>,
    /// Share of the arm's error that the model corrects at this command with weight 1, 0 to 1.
    pub applied: f32,
    /// Position error that remains with weight 1, as predicted by the model, in m.
    pub position_error: f32,
    /// Rotation error that remains with weight 1, as predicted by the model, in rad.
    pub rotation_error: f32,
    /// Weight of the model's correction in `joints`: 0 at the start and with the bypass, 1 when it is fully applied.
    pub weight: f32,
    /// Status bits, those of the runtime's `Status`.
    pub status: u8,
    /// Duration of correction and filter, in ticks.
    pub ticks: u32,
}

/// Intermediate results of one evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    /// Sine and cosine of each revolute joint of the serial chain, one joint after the other; (q, 0) of a prismatic joint.
    pub sin_cos: Vec<f32, { 2 * MAX_JOINTS }>,
    /// Posterior mean of the correction before bounding.
    pub mean: [f32; OUTPUTS],
    /// Pose f(q) of the calibrated chain alone.
    pub chain: Transform<f32>,
    /// The result of the evaluation.
    pub evaluation: Evaluation,
}

/// Counters since the start of the device. They saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Statistics {
    /// Frames that arrived complete.
    pub frames: u32,
    /// Frames that were damaged, too long or unreadable.
    pub bad_frames: u32,
    /// Bytes that were lost because they were not read in time.
    pub lost_bytes: u32,
    /// Requests that were refused.
    pub refused: u32,
    /// Cyclic requests that were answered, without `StopCyclic`.
    pub cycles: u32,
    /// Cycles whose status was not `ok`.
    pub flagged: u32,
    /// Cycles whose correction was scaled back to its bound.
    pub limited: u32,
    /// Corrections that returned the command unchanged.
    pub uncorrected: u32,
    /// Cycles that took longer than the deadline.
    pub missed_deadlines: u32,
    /// Longest computation of one cycle, in ticks.
    pub max_ticks: u32,
    /// Longest time from the last byte of a cyclic request until its answer was ready to send, in ticks.
    pub max_latency_ticks: u32,
    /// Models that became active.
    pub activations: u32,
    /// Restarts since the power was switched on, whatever their reason.
    pub restarts: u32,
    /// Log messages that were dropped.
    pub lost_logs: u32,
    /// Maximum stack usage, in bytes.
    pub stack_bytes: u32,
    /// Commands of the cycle that jumped instead of moving.
    pub jumps: u32,
    /// Commands of the cycle that came after a gap.
    pub gaps: u32,
    /// Commands of the cycle that were repeated, or came less than half a period after the previous one.
    pub repeats: u32,
    /// Commands of the cycle that were invalid, so that the last answer was sent again.
    pub bad_commands: u32,
    /// Steps of the model that the path does not explain and that the filter has absorbed.
    pub model_steps: u32,
}
