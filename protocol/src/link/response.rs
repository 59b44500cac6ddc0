//! What the device answers.

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

use super::{CycleSettings, MAX_NAME, NONCE_LENGTH, Refusal};
use crate::Transform;
use crate::blob::envelope::KEY_ID_LENGTH;
use crate::cause::Causes;
use crate::limits::{MAX_JOINTS, OUTPUTS};

/// First bytes of a public key: enough to distinguish keys.
pub type KeyId = [u8; KEY_ID_LENGTH];

/// Answered by the device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // nothing can be boxed
pub enum Response {
    /// Who the device is.
    Identity(Identity),
    /// The compensated pose.
    Evaluation(Evaluation),
    /// The corrected joint command.
    Corrected(Corrected),
    /// The compensated pose and how it came about.
    Trace(Trace),
    /// The absence of cyclic requests is no fault from now on.
    CyclicStopped,
    /// So many bytes of the announced blob are there.
    Uploading {
        /// Bytes received so far.
        received: u32,
    },
    /// The uploaded blob is a model that this device may run.
    Verified(ModelIdentity),
    /// The verified blob is in a slot and will run after the next start.
    Committed(StoredModel),
    /// What was counted.
    Statistics(Statistics),
    /// The device restarts once this answer is on the line.
    Restarting,
    /// The request was not carried out; nothing has changed.
    Refused(Refusal),
    /// The command to send on.
    Commanded(Commanded),
    /// The nonce to sign the next request with.
    Challenge {
        /// Never the same twice.
        nonce: [u8; NONCE_LENGTH],
    },
}

/// What the cycle answers: encoded by itself, so that the other responses cost the cycle nothing.
pub trait CyclicResponse: Serialize {
    /// The number of its [`Response`] on the wire.
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

/// Who the device is and which model it runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// [`super::PROTOCOL_VERSION`] of the firmware.
    pub protocol_version: u8,
    /// Version of the firmware.
    pub firmware_version: String<MAX_NAME>,
    /// CRC-32C of the image in flash: which build it is.
    pub image_crc: u32,
    /// Name of the board.
    pub board: String<MAX_NAME>,
    /// Words (`f32`) of rows of inducing points that fit.
    pub capacity_words: u32,
    /// Bytes of a blob that fit.
    pub capacity_bytes: u32,
    /// Frequency of the tick counter in hertz.
    pub tick_hz: u32,
    /// Ticks in which a cyclic request is to be answered.
    pub deadline_ticks: u32,
    /// Whose models are taken.
    pub key: Key,
    /// Whether corrections are bypassed.
    pub bypass: bool,
    /// Settings of the cycle that are in force.
    pub cycle: CycleSettings,
    /// The active model, or the one that was ordered and is about to be.
    pub model: Option<ModelIdentity>,
    /// Whether it still waits: the correction by the model before it is being taken back.
    pub pending: bool,
    /// What the two slots hold, by their headers.
    pub slots: [Option<StoredModel>; 2],
    /// How often something was written to the slots since their flash was first used, to its end.
    pub slot_writes: u32,
    /// Why the device started the last time.
    pub start: StartReason,
}

/// Why the device started. All but the first keep the memory, in which the firmware notes the reason before it restarts or
/// while its watchdog waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StartReason {
    /// The power came, or was away for so long that the memory lost the note.
    PowerOn,
    /// By `Restart`.
    Requested,
    /// By the watchdog: cyclic requests were expected and none was answered.
    Cycles,
    /// By the watchdog: the background made no progress.
    Background,
    /// The firmware found itself wrong and gave up.
    Panic {
        /// The line of the source that did.
        line: u32,
    },
    /// The processor could not execute an instruction.
    Fault {
        /// The address of the instruction.
        address: u32,
    },
    /// Nothing was noted: the watchdog, because a cycle did not end or interrupts stayed off; or the reset line.
    Unexplained,
}

/// Whose models a device takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Key {
    /// No public key is provisioned: everybody's.
    None,
    /// Those that are signed by this key.
    Provisioned(KeyId),
    /// Nobody's: the page of the key is damaged, or was not written to its end. Provisioning may be repeated.
    Unusable,
}

/// A model that runs or may run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelIdentity {
    /// Name of the robot.
    pub robot: String<MAX_NAME>,
    /// Serial number of the arm.
    pub serial_number: String<MAX_NAME>,
    /// CRC in the header of its blob.
    pub blob_crc: u32,
    /// Joints of the arm.
    pub joints: u8,
    /// Inducing points of its correction.
    pub inducing_points: u32,
    /// Upper bound for one command, frames included.
    pub instructions: u32,
    /// The revision under its signature, if the device has verified that. It takes no lower one.
    pub revision: Option<u32>,
    /// Causes of the warnings about the measurements that it was calibrated with.
    pub warnings: Causes,
}

/// What the header of a slot says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredModel {
    /// 0 or 1.
    pub slot: u8,
    /// Whether it is the one that runs after the next start.
    pub first: bool,
    /// Bytes of its blob.
    pub length: u32,
    /// CRC-32C of all of them.
    pub crc: u32,
}

/// T_gp(q, m)·f(q) as the device computed it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// CRC in the header of the blob that answered; 0 without a model.
    pub blob_crc: u32,
    /// `base_from_target`.
    pub pose: Transform<f32>,
    /// The correction twist g (v, ω) in the base frame, after bounding; m and rad.
    pub correction: [f32; OUTPUTS],
    /// How much of the prior the training data explain here, 0 to 1.
    pub trust: f32,
    /// Standard deviation of the position in m, per axis; `None` when the model has none.
    pub position_sigma: Option<f32>,
    /// Bits of the runtime's `Status`.
    pub status: u8,
    /// Ticks that the evaluation took.
    pub ticks: u32,
}

/// The corrected joint command: the answer to a question.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Corrected {
    /// CRC in the header of the blob that answered; 0 without a model.
    pub blob_crc: u32,
    /// The command for the controller's joints, rad or m; those of the request when nothing is corrected.
    pub joints: Vec<f32, MAX_JOINTS>,
    /// How much of the arm's error is corrected, 0 to 1; 0 when nothing is.
    pub applied: f32,
    /// What remains between the calibrated arm at this command and the nominal one, in m.
    pub position_error: f32,
    /// The rotation error that remains, in rad.
    pub rotation_error: f32,
    /// Bits of the runtime's `Status`.
    pub status: u8,
    /// Ticks that the correction took.
    pub ticks: u32,
}

/// The command to send on: the answer to the command of a cycle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Commanded {
    /// CRC in the header of the blob that answered; 0 without a model.
    pub blob_crc: u32,
    /// The command for the controller's joints, rad or m. Never steps against that of the request.
    pub joints: Vec<f32, MAX_JOINTS>,
    /// How much of the arm's error the model corrects here at weight 1, 0 to 1.
    pub applied: f32,
    /// What the model leaves of it at weight 1, in m.
    pub position_error: f32,
    /// The rotation error that remains, in rad.
    pub rotation_error: f32,
    /// Weight of the model in `joints`: 0 on start and with the bypass, 1 when it is wholly applied.
    pub weight: f32,
    /// Bits of the runtime's `Status`.
    pub status: u8,
    /// Ticks that correction and filter took.
    pub ticks: u32,
}

/// Intermediate results of one evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    /// Sine and cosine of each revolute joint of the serial chain, in turn; (0, 1) for a prismatic one.
    pub sin_cos: Vec<f32, { 2 * MAX_JOINTS }>,
    /// Posterior mean before bounding.
    pub mean: [f32; OUTPUTS],
    /// f(q), the calibrated chain alone.
    pub chain: Transform<f32>,
    /// The result.
    pub evaluation: Evaluation,
}

/// What was counted since the start. Counters saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Statistics {
    /// Frames that arrived whole.
    pub frames: u32,
    /// Frames that were damaged, too long or unreadable.
    pub bad_frames: u32,
    /// Bytes that were lost because nobody took them in time.
    pub lost_bytes: u32,
    /// Requests that were refused.
    pub refused: u32,
    /// Cyclic requests answered, `StopCyclic` aside.
    pub cycles: u32,
    /// Cycles whose status was not `ok`.
    pub flagged: u32,
    /// Cycles whose correction was scaled back to its bound.
    pub limited: u32,
    /// Corrections that answered the command as it came.
    pub uncorrected: u32,
    /// Cycles that took longer than the deadline.
    pub missed_deadlines: u32,
    /// Most ticks that the computation of one cycle took.
    pub max_ticks: u32,
    /// Most ticks from the last byte of a cyclic request to its answer being ready to send.
    pub max_latency_ticks: u32,
    /// Models that became active.
    pub activations: u32,
    /// Starts without a power failure in between, whatever their reason.
    pub restarts: u32,
    /// Log messages that were dropped.
    pub lost_logs: u32,
    /// Deepest use of the stack in bytes.
    pub stack_bytes: u32,
    /// Commands of the cycle that jumped instead of moving.
    pub jumps: u32,
    /// Commands of the cycle that came after a gap.
    pub gaps: u32,
    /// Commands of the cycle that came again, or less than half a period after the one before.
    pub repeats: u32,
    /// Commands of the cycle that were none: the last answer was given again.
    pub bad_commands: u32,
    /// Steps of the model that the path does not explain and the filter has taken up.
    pub model_steps: u32,
}
