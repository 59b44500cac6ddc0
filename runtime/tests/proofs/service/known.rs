//! Models with known answers, and the requests that bring them to the device.

use ed25519_dalek::{Signer, SigningKey};
use poegp_protocol::blob::envelope::{Trailer, key_id, set_signed};
use poegp_protocol::blob::{self, CRC};
use poegp_protocol::link::{Corrected, Evaluation, MAX_CHUNK, Query, Refusal, Request, Response};
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::Model;

use super::desk::{BYTES, Desk};
use crate::arm::{Arm, WORDS};

/// A blob with the runtime's model of it.
pub struct Known {
    pub bytes: Vec<u8>,
    /// CRC in its header, by which the link names it.
    pub blob_crc: u32,
    pub joints: usize,
    pub model: Model<f32, WORDS>,
}

impl Known {
    pub fn new(mut arm: Arm) -> Self {
        let mut buffer = vec![0; BYTES];
        let bytes = blob::encode(&arm.blob(), &mut buffer)
            .expect("fits")
            .to_vec();
        Self {
            blob_crc: blob::stored_crc(&bytes).expect("a header"),
            bytes,
            joints: arm.joints.len(),
            model: arm.model(),
        }
    }

    /// Returns three models that differ in joints and kind of correction.
    pub fn three() -> [Self; 3] {
        [
            Self::new(Arm::sound(2, 5)),
            Self::new(Arm::elastic(2, 6, false)),
            Self::new(Arm::sound(3, 4)),
        ]
    }

    /// Returns the request that begins its upload.
    pub fn begin(&self) -> Request<'static> {
        begin(&self.bytes)
    }

    /// Uploads its blob and has it verified.
    pub fn upload(&self, desk: &mut Desk) -> Response {
        upload(desk, &self.bytes)
    }

    /// Uploads, commits and activates.
    pub fn install(&self, desk: &mut Desk) {
        let verified = self.upload(desk);
        assert!(matches!(verified, Response::Verified(_)), "{verified:?}");
        let committed = desk.ask(&Request::CommitUpload);
        assert!(matches!(committed, Response::Committed(_)), "{committed:?}");
        desk.ask(&self.activate());
        assert_eq!(desk.active(), Some(self.blob_crc));
    }

    pub fn activate(&self) -> Request<'static> {
        Request::Activate {
            blob_crc: self.blob_crc,
        }
    }

    pub fn roll_back(&self) -> Request<'static> {
        Request::RollBack {
            from_crc: self.blob_crc,
        }
    }

    /// Asserts that the device answered `query` with this model, to the bit.
    pub fn assert_evaluated(&self, query: &Query, answer: &Evaluation) {
        assert_eq!(answer.blob_crc, self.blob_crc);
        let expected = self.model.evaluate(&query.joints, query.payload_kg);
        assert_eq!(bits(&answer.pose), bits(&expected.pose.to_rows()));
        let correction = expected.correction.to_array();
        assert_eq!(bits(&answer.correction), bits(&correction));
        assert_eq!(answer.status, expected.status.bits());
    }

    /// Asserts the same for `Correct`.
    pub fn assert_corrected(&self, query: &Query, answer: &Corrected) {
        assert_eq!(answer.blob_crc, self.blob_crc);
        let expected = self.model.correct(&query.joints, query.payload_kg);
        let length = query.joints.len();
        assert_eq!(bits(&answer.joints), bits(&expected.joints[..length]));
        for (found, expected) in [
            (answer.applied, expected.applied),
            (answer.position_error, expected.position_error),
            (answer.rotation_error, expected.rotation_error),
        ] {
            assert_eq!(found.to_bits(), expected.to_bits());
        }
        assert_eq!(answer.status, expected.status.bits());
    }
}

/// Returns the bit patterns for comparison, which also works for NaN.
pub fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// Asserts that a command was not corrected: finite joints come back unchanged.
pub fn assert_as_it_came(query: &Query, answer: &Corrected, status: Status) {
    assert_eq!(answer.status, status.bits());
    assert_eq!(answer.joints.len(), query.joints.len());
    for (found, asked) in answer.joints.iter().zip(&query.joints) {
        if asked.is_finite() {
            assert_eq!(found.to_bits(), asked.to_bits());
        }
    }
    let numbers = [answer.applied, answer.position_error, answer.rotation_error];
    assert_eq!(bits(&numbers), [0; 3]);
}

pub fn query(joints: &[f32], payload_kg: f32) -> Query {
    Query {
        joints: joints.iter().copied().collect(),
        payload_kg,
    }
}

pub fn begin(bytes: &[u8]) -> Request<'static> {
    Request::BeginUpload {
        length: bytes.len() as u32,
        crc: CRC.checksum(bytes),
        replaces_robot: false,
    }
}

pub fn piece(bytes: &[u8], from: usize, to: usize) -> Request<'_> {
    Request::UploadChunk {
        offset: from as u32,
        bytes: &bytes[from..to],
    }
}

/// Uploads bytes and has them verified.
pub fn upload(desk: &mut Desk, bytes: &[u8]) -> Response {
    assert_eq!(desk.ask(&begin(bytes)), Response::Uploading { received: 0 });
    for from in (0..bytes.len()).step_by(MAX_CHUNK) {
        let to = bytes.len().min(from + MAX_CHUNK);
        let received = to as u32;
        let answer = desk.ask(&piece(bytes, from, to));
        assert_eq!(answer, Response::Uploading { received });
    }
    desk.ask(&Request::VerifyUpload)
}

pub fn refused(refusal: Refusal) -> Response {
    Response::Refused(refusal)
}

/// Returns a secret key made from a known seed.
pub fn key(seed: u8) -> SigningKey {
    SigningKey::from_bytes(&[seed; 32])
}

pub fn public(key: &SigningKey) -> [u8; 32] {
    key.verifying_key().to_bytes()
}

/// Returns `known` signed by `key`, as the first revision.
pub fn signed(known: &Known, key: &SigningKey) -> Known {
    signed_as(1, known, key)
}

/// Returns `known` signed by `key`, as this revision.
pub fn signed_as(revision: u32, known: &Known, key: &SigningKey) -> Known {
    let mut bytes = known.bytes.clone();
    set_signed(&mut bytes, true);
    let mut trailer = Trailer {
        key_id: key_id(&public(key)),
        revision,
        signature: [0; 64],
    };
    let message = [&bytes[..], &trailer.signed_part()].concat();
    trailer.signature = key.sign(&message).to_bytes();
    bytes.extend(trailer.to_bytes());
    let mut model = Model::new();
    let decoded = blob::decode(&bytes).expect("a blob");
    model.load_decoded(&decoded).expect("a model");
    Known {
        blob_crc: blob::stored_crc(&bytes).expect("a header"),
        joints: known.joints,
        model,
        bytes,
    }
}
