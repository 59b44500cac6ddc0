//! The blobs (including signed and broken ones) and keys that a script may name.

use ed25519_dalek::{Signer, SigningKey};
use poegp_protocol::blob::envelope::{Trailer, key_id, set_signed};

use super::device::BYTES;
use crate::sample::{Elastic, Sample, SampleCorrection};

/// The blobs and keys that a script may name.
pub struct Sources {
    pub blobs: [Vec<u8>; 6],
    pub keys: [[u8; 32]; 2],
    pub secret_keys: [SigningKey; 2],
}

impl Sources {
    pub fn new() -> Self {
        let keys = [1, 2].map(|seed| SigningKey::from_bytes(&[seed; 32]));
        let [a, b, c] = [
            Sample {
                joints: 3,
                ..Sample::plain(1, SampleCorrection::None)
            },
            Sample {
                joints: 3,
                ..Sample::plain(2, SampleCorrection::Elastic(SMALL))
            },
            Sample::plain(3, SampleCorrection::Shared(3)),
        ]
        .map(|sample| sample.blob());
        let (first, second) = (signed(&b, 1, &keys[0]), signed(&a, 2, &keys[0]));
        let mut broken = c.clone();
        broken[100] ^= 8;
        let blobs = [a, b, c, first, second, broken];
        assert!(blobs.iter().all(|blob| blob.len() <= BYTES));
        Self {
            blobs,
            keys: keys.each_ref().map(|key| key.verifying_key().to_bytes()),
            secret_keys: keys,
        }
    }
}

/// A small elastic correction.
pub const SMALL: Elastic = Elastic {
    points: 4,
    groups: 2,
    ripple: 2,
    ..Elastic::PLAIN
};

/// Returns `blob` signed by `key` with the given revision.
pub fn signed(blob: &[u8], revision: u32, key: &SigningKey) -> Vec<u8> {
    let mut bytes = blob.to_vec();
    set_signed(&mut bytes, true);
    let mut trailer = Trailer {
        key_id: key_id(&key.verifying_key().to_bytes()),
        revision,
        signature: [0; 64],
    };
    let message = [&bytes[..], &trailer.signed_part()].concat();
    trailer.signature = key.sign(&message).to_bytes();
    bytes.extend(trailer.to_bytes());
    bytes
}
