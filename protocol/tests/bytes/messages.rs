//! One message of each kind, and the longest of each kind, in the order of their numbers on the wire.

use poegp_protocol::blob::DecodeError;
use poegp_protocol::cause::Cause;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_protocol::link::{
    Commanded, Corrected, CycleSettings, Evaluation, Identity, Key, MAX_CHUNK, MAX_NAME,
    MAX_SIGNED, ModelIdentity, Query, Refusal, Request, Response, StartReason, Statistics,
    StoredModel, Trace,
};

/// Returns two joints and a payload.
pub fn query() -> Query {
    Query {
        joints: [0.5, 0.25].into_iter().collect(),
        payload_kg: 2.0,
    }
}

/// Returns one request of each kind.
pub fn requests() -> Vec<Request<'static>> {
    vec![
        Request::Identify,
        Request::Evaluate(query()),
        Request::Correct(query()),
        Request::Trace(query()),
        Request::StopCyclic,
        Request::BeginUpload {
            length: 300,
            crc: 0xffff_ffff,
            replaces_robot: true,
        },
        Request::UploadChunk {
            offset: 128,
            bytes: &[0, 1, 0xff],
        },
        Request::VerifyUpload,
        Request::CommitUpload,
        Request::Activate { blob_crc: 300 },
        Request::RollBack { from_crc: 128 },
        Request::SetBypass { on: true },
        Request::Provision {
            public_key: core::array::from_fn(|index| index as u8),
        },
        Request::ReadStatistics,
        Request::Restart,
        Request::Command(query()),
        Request::ProvisionCycle(CYCLE),
        Request::Challenge,
        Request::Signed {
            signature: &[1; 64],
            request: &[14],
        },
    ]
}

const CYCLE: CycleSettings = CycleSettings {
    period_us: 1_000,
    rate: 0.5,
    acceleration: 2.0,
    blend_s: 0.25,
    max_instructions: 62_500,
};

/// Returns the longest request of each kind.
pub fn longest_requests() -> Vec<Request<'static>> {
    let query = || Query {
        joints: [-1.1; MAX_JOINTS].into_iter().collect(),
        payload_kg: -1.1,
    };
    vec![
        Request::Identify,
        Request::Evaluate(query()),
        Request::Correct(query()),
        Request::Trace(query()),
        Request::StopCyclic,
        Request::BeginUpload {
            length: u32::MAX,
            crc: u32::MAX,
            replaces_robot: true,
        },
        Request::UploadChunk {
            offset: u32::MAX,
            bytes: &[0xff; MAX_CHUNK],
        },
        Request::VerifyUpload,
        Request::CommitUpload,
        Request::Activate { blob_crc: u32::MAX },
        Request::RollBack { from_crc: u32::MAX },
        Request::SetBypass { on: true },
        Request::Provision {
            public_key: [0xff; 32],
        },
        Request::ReadStatistics,
        Request::Restart,
        Request::Command(query()),
        Request::ProvisionCycle(LONGEST_CYCLE),
        Request::Challenge,
        Request::Signed {
            signature: &[0xff; 64],
            request: &[0xff; MAX_SIGNED],
        },
    ]
}

const LONGEST_CYCLE: CycleSettings = CycleSettings {
    period_us: u32::MAX,
    rate: -1.1,
    acceleration: -1.1,
    blend_s: -1.1,
    max_instructions: u32::MAX,
};

/// Returns one decode error of each kind.
pub fn decode_errors() -> Vec<DecodeError> {
    vec![
        DecodeError::Truncated {
            expected: 20,
            found: 3,
        },
        DecodeError::WrongMagic,
        DecodeError::UnknownVersion {
            found: 258,
            supported: 1,
        },
        DecodeError::ReservedBitsSet,
        DecodeError::TrailingBytes {
            expected: 20,
            found: 21,
        },
        DecodeError::CrcMismatch {
            stored: 1,
            computed: 2,
        },
        DecodeError::MalformedPayload,
    ]
}

/// One start reason of each kind.
pub const STARTS: [StartReason; 7] = [
    StartReason::PowerOn,
    StartReason::Requested,
    StartReason::Cycles,
    StartReason::Background,
    StartReason::Panic { line: 198 },
    StartReason::Fault { address: 128 },
    StartReason::Unexplained,
];

/// Returns one refusal of each kind.
pub fn refusals() -> Vec<Refusal> {
    vec![
        Refusal::BadFrame,
        Refusal::ProtocolVersion {
            found: 1,
            expected: 2,
        },
        Refusal::UnknownMessage,
        Refusal::Busy,
        Refusal::BlobTooLong {
            length: 300,
            capacity: 200,
        },
        Refusal::NoUpload,
        Refusal::UnexpectedOffset {
            found: 5,
            expected: 4,
        },
        Refusal::ChunkTooLong { end: 9, length: 8 },
        Refusal::Incomplete {
            received: 7,
            length: 8,
        },
        Refusal::TransferCrc {
            stored: 1,
            computed: 2,
        },
        Refusal::Blob(DecodeError::WrongMagic),
        Refusal::Model { code: 11 },
        Refusal::Signature { code: 3 },
        Refusal::NotVerified,
        Refusal::UnknownModel { blob_crc: 300 },
        Refusal::NoOtherModel,
        Refusal::Store { code: 16 },
        Refusal::KeyIsFixed,
        Refusal::NotAKey,
        Refusal::CyclesRunning,
        Refusal::TooSlow {
            instructions: 70_000,
            allowed: 62_500,
        },
        Refusal::OldRevision {
            revision: 300,
            lowest: 70_000,
        },
        Refusal::AnotherRobot,
        Refusal::NotSigned,
        Refusal::WrongSignature,
        Refusal::CycleSetting { code: 4 },
        Refusal::TooManyWrites { allowed: 100 },
        Refusal::SelfTest,
        Refusal::SlowClock {
            hz: 16_000_000,
            needed: 168_000_000,
        },
    ]
}

fn evaluation() -> Evaluation {
    Evaluation {
        blob_crc: 0x0102_0304,
        pose: core::array::from_fn(|index| index as f32),
        correction: [0.5; 6],
        trust: 0.25,
        position_sigma: Some(2.0),
        status: 4,
        ticks: 200,
    }
}

fn model() -> ModelIdentity {
    ModelIdentity {
        robot: "ARM".try_into().expect("short"),
        serial_number: "7".try_into().expect("short"),
        blob_crc: 5,
        joints: 2,
        inducing_points: 300,
        instructions: 61_234,
        revision: Some(300),
        warnings: [Cause::Still, Cause::Step].into_iter().collect(),
    }
}

const STORED: StoredModel = StoredModel {
    slot: 1,
    first: true,
    length: 300,
    crc: 6,
};

/// Returns one response of each kind.
pub fn responses() -> Vec<Response> {
    vec![
        Response::Identity(Identity {
            protocol_version: 3,
            firmware_version: "0.1.0".try_into().expect("short"),
            image_crc: 128,
            board: "mps2".try_into().expect("short"),
            capacity_words: 1_000,
            capacity_bytes: 16_384,
            tick_hz: 25_000_000,
            deadline_ticks: 25_000,
            key: Key::Provisioned([1, 2, 3, 4, 5, 6, 7, 8]),
            bypass: true,
            cycle: CYCLE,
            model: Some(model()),
            pending: true,
            slots: [None, Some(STORED)],
            slot_writes: 200,
            start: StartReason::Panic { line: 198 },
        }),
        Response::Evaluation(evaluation()),
        Response::Corrected(Corrected {
            blob_crc: 128,
            joints: [0.5, 0.25].into_iter().collect(),
            applied: 0.5,
            position_error: 2.0,
            rotation_error: 0.25,
            status: 32,
            ticks: 200,
        }),
        Response::Trace(Trace {
            sin_cos: [0.5, 1.0].into_iter().collect(),
            mean: [0.25; 6],
            chain: [1.0; 12],
            evaluation: evaluation(),
        }),
        Response::CyclicStopped,
        Response::Uploading { received: 128 },
        Response::Verified(model()),
        Response::Committed(STORED),
        Response::Statistics(Statistics {
            frames: 1,
            bad_frames: 2,
            lost_bytes: 3,
            refused: 4,
            cycles: 5,
            flagged: 6,
            limited: 7,
            uncorrected: 8,
            missed_deadlines: 9,
            max_ticks: 10,
            max_latency_ticks: 11,
            activations: 12,
            restarts: 13,
            lost_logs: 127,
            stack_bytes: 128,
            jumps: 14,
            gaps: 15,
            repeats: 16,
            bad_commands: 17,
            model_steps: 18,
        }),
        Response::Restarting,
        Response::Refused(Refusal::NoUpload),
        Response::Commanded(Commanded {
            blob_crc: 128,
            joints: [0.5, 0.25].into_iter().collect(),
            applied: 0.5,
            position_error: 2.0,
            rotation_error: 0.25,
            weight: 1.0,
            status: 32,
            ticks: 200,
        }),
        Response::Challenge {
            nonce: core::array::from_fn(|index| index as u8),
        },
    ]
}

/// Returns the longest response of each kind.
pub fn longest_responses() -> Vec<Response> {
    let name: heapless::String<MAX_NAME> = "n".repeat(MAX_NAME).as_str().try_into().expect("fits");
    let evaluation = Evaluation {
        blob_crc: u32::MAX,
        pose: [-1.1; 12],
        correction: [-1.1; 6],
        trust: 1.1,
        position_sigma: Some(1.1),
        status: u8::MAX,
        ticks: u32::MAX,
    };
    let model = ModelIdentity {
        robot: name.clone(),
        serial_number: name.clone(),
        blob_crc: u32::MAX,
        joints: u8::MAX,
        inducing_points: u32::MAX,
        instructions: u32::MAX,
        revision: Some(u32::MAX),
        warnings: Cause::ALL.into_iter().collect(),
    };
    let stored = StoredModel {
        slot: u8::MAX,
        first: true,
        length: u32::MAX,
        crc: u32::MAX,
    };
    let m = u32::MAX;
    vec![
        Response::Identity(Identity {
            protocol_version: u8::MAX,
            firmware_version: name.clone(),
            image_crc: m,
            board: name.clone(),
            capacity_words: m,
            capacity_bytes: m,
            tick_hz: m,
            deadline_ticks: m,
            key: Key::Provisioned([0xff; 8]),
            bypass: true,
            cycle: LONGEST_CYCLE,
            model: Some(model.clone()),
            pending: true,
            slots: [Some(stored); 2],
            slot_writes: m,
            start: StartReason::Fault { address: m },
        }),
        Response::Evaluation(evaluation.clone()),
        Response::Corrected(Corrected {
            blob_crc: m,
            joints: [-1.1; MAX_JOINTS].into_iter().collect(),
            applied: 1.1,
            position_error: 1.1,
            rotation_error: 1.1,
            status: u8::MAX,
            ticks: m,
        }),
        Response::Trace(Trace {
            sin_cos: [-1.1; 2 * MAX_JOINTS].into_iter().collect(),
            mean: [-1.1; 6],
            chain: [-1.1; 12],
            evaluation,
        }),
        Response::CyclicStopped,
        Response::Uploading { received: m },
        Response::Verified(model),
        Response::Committed(stored),
        Response::Statistics(Statistics {
            frames: m,
            bad_frames: m,
            lost_bytes: m,
            refused: m,
            cycles: m,
            flagged: m,
            limited: m,
            uncorrected: m,
            missed_deadlines: m,
            max_ticks: m,
            max_latency_ticks: m,
            activations: m,
            restarts: m,
            lost_logs: m,
            stack_bytes: m,
            jumps: m,
            gaps: m,
            repeats: m,
            bad_commands: m,
            model_steps: m,
        }),
        Response::Restarting,
        Response::Refused(Refusal::Blob(DecodeError::CrcMismatch {
            stored: m,
            computed: m,
        })),
        Response::Commanded(Commanded {
            blob_crc: m,
            joints: [-1.1; MAX_JOINTS].into_iter().collect(),
            applied: 1.1,
            position_error: 1.1,
            rotation_error: 1.1,
            weight: 1.1,
            status: u8::MAX,
            ticks: m,
        }),
        Response::Challenge { nonce: [0xff; 16] },
    ]
}
