//! A table of all messages of the link. A test compares its rows with the types and with `docs/reference/link.md`.

/// One kind of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message {
    /// Name of the enum variant. The number on the wire is the position of the message in its table.
    pub name: &'static str,
    /// Fields in the order in which postcard writes them.
    pub fields: &'static str,
    /// Maximum number of bytes of the message, with its number and without the frame.
    pub max_bytes: usize,
    /// For a request, the response unless it is refused; empty for a response.
    pub answer: &'static str,
    /// Whether the cycle answers the message.
    pub cyclic: bool,
}

const fn request(
    name: &'static str,
    fields: &'static str,
    max_bytes: usize,
    answer: &'static str,
    cyclic: bool,
) -> Message {
    Message {
        name,
        fields,
        max_bytes,
        answer,
        cyclic,
    }
}

const fn response(name: &'static str, fields: &'static str, max_bytes: usize) -> Message {
    request(name, fields, max_bytes, "", false)
}

/// All requests, in the order of their numbers on the wire.
#[rustfmt::skip] // a table
pub const REQUESTS: [Message; 19] = [
    request("Identify", "", 1, "Identity", false),
    request("Evaluate", "joints: list of at most 8 f32, payload_kg: f32", 38, "Evaluation", true),
    request("Correct", "joints: list of at most 8 f32, payload_kg: f32", 38, "Corrected", true),
    request("Trace", "joints: list of at most 8 f32, payload_kg: f32", 38, "Trace", true),
    request("StopCyclic", "", 1, "CyclicStopped", false),
    request("BeginUpload", "length: u32, crc: u32, replaces_robot: bool", 12, "Uploading", false),
    request("UploadChunk", "offset: u32, bytes: list of at most 256 u8", 264, "Uploading", false),
    request("VerifyUpload", "", 1, "Verified", false),
    request("CommitUpload", "", 1, "Committed", false),
    request("Activate", "blob_crc: u32", 6, "Identity", false),
    request("RollBack", "from_crc: u32", 6, "Identity", false),
    request("SetBypass", "on: bool", 2, "Identity", false),
    request("Provision", "public_key: 32 u8", 33, "Identity", false),
    request("ReadStatistics", "", 1, "Statistics", false),
    request("Restart", "", 1, "Restarting", false),
    request("Command", "joints: list of at most 8 f32, payload_kg: f32", 38, "Commanded", true),
    request("ProvisionCycle", "period_us: u32, rate: f32, acceleration: f32, blend_s: f32, max_instructions: u32", 23, "Identity", false),
    request("Challenge", "", 1, "Challenge", false),
    request("Signed", "signature: list of 64 u8, request: list of at most 32 u8", 99, "that of the request", false),
];

/// All responses, in the order of their numbers on the wire.
#[rustfmt::skip] // a table
pub const RESPONSES: [Message; 13] = [
    response("Identity", "protocol_version: u8, firmware_version: text, image_crc: u32, board: text, capacity_words: u32, capacity_bytes: u32, tick_hz: u32, deadline_ticks: u32, key: a key, bypass: bool, cycle: cycle settings, model: option of a model, pending: bool, slots: 2 options of a stored model, slot_writes: u32, start: a start", 256),
    response("Evaluation", "blob_crc: u32, pose: 12 f32, correction: 6 f32, trust: f32, position_sigma: option of f32, status: u8, ticks: u32", 93),
    response("Corrected", "blob_crc: u32, joints: list of at most 8 f32, applied: f32, position_error: f32, rotation_error: f32, status: u8, ticks: u32", 57),
    response("Trace", "sin_cos: list of at most 16 f32, mean: 6 f32, chain: 12 f32, evaluation: an evaluation", 230),
    response("CyclicStopped", "", 1),
    response("Uploading", "received: u32", 6),
    response("Verified", "robot: text, serial_number: text, blob_crc: u32, joints: u8, inducing_points: u32, instructions: u32, revision: option of u32, warnings: 4 u8", 93),
    response("Committed", "slot: u8, first: bool, length: u32, crc: u32", 13),
    response("Statistics", "frames: u32, bad_frames: u32, lost_bytes: u32, refused: u32, cycles: u32, flagged: u32, limited: u32, uncorrected: u32, missed_deadlines: u32, max_ticks: u32, max_latency_ticks: u32, activations: u32, restarts: u32, lost_logs: u32, stack_bytes: u32, jumps: u32, gaps: u32, repeats: u32, bad_commands: u32, model_steps: u32", 101),
    response("Restarting", "", 1),
    response("Refused", "a refusal", 13),
    response("Commanded", "blob_crc: u32, joints: list of at most 8 f32, applied: f32, position_error: f32, rotation_error: f32, weight: f32, status: u8, ticks: u32", 61),
    response("Challenge", "nonce: 16 u8", 17),
];
