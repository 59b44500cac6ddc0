//! A signed blob: any change after signing, and a signature by any other key, is refused.

use std::collections::BTreeMap;

use ed25519_dalek::{Signer, SigningKey};
use poegp_protocol::blob::envelope::{TRAILER_LENGTH, Trailer, key_id, set_signed};
use poegp_protocol::blob::{self, CRC, blob_crc};
use poegp_runtime::model::signature::{SignatureError, verify};

use crate::arm::Arm;

const REVISION: u32 = 0x0102_0304;

fn key(seed: u8) -> SigningKey {
    SigningKey::from_bytes(&[seed; 32])
}

fn public(key: &SigningKey) -> [u8; 32] {
    key.verifying_key().to_bytes()
}

fn unsigned() -> Vec<u8> {
    let mut buffer = vec![0; 4_096];
    let mut arm = Arm::sound(2, 2);
    blob::encode(&arm.blob(), &mut buffer).unwrap().to_vec()
}

/// Signs `unsigned` with `key`, and states the key name `id`.
fn signed(unsigned: &[u8], key: &SigningKey, id: [u8; 8]) -> Vec<u8> {
    let mut bytes = unsigned.to_vec();
    set_signed(&mut bytes, true);
    let mut trailer = Trailer {
        key_id: id,
        revision: REVISION,
        signature: [0; 64],
    };
    let message = [&bytes[..], &trailer.signed_part()].concat();
    trailer.signature = key.sign(&message).to_bytes();
    bytes.extend(trailer.to_bytes());
    bytes
}

fn good() -> (Vec<u8>, [u8; 32]) {
    let (key, unsigned) = (key(1), unsigned());
    let public = public(&key);
    (signed(&unsigned, &key, key_id(&public)), public)
}

#[test]
fn signed_by_the_key_and_by_nobody_else() {
    let (bytes, public_key) = good();
    assert_eq!(verify(&bytes, &public_key), Ok(REVISION));
    let plain = unsigned();
    assert_eq!(blob::decode(&bytes), blob::decode(&plain));
    assert_eq!(verify(&plain, &public_key), Err(SignatureError::Unsigned));
    let other = public(&key(2));
    let id = key_id(&public_key);
    assert_eq!(verify(&bytes, &other), Err(SignatureError::WrongKey { id }));
    // Signed by another key under the name of this one.
    let forged = signed(&plain, &key(2), id);
    assert_eq!(verify(&forged, &public_key), Err(SignatureError::Invalid));
    assert_eq!(verify(b"", &public_key), Err(SignatureError::Malformed));
}

/// Recomputes the checksums of `bytes`, as an attacker would after a change.
fn with_new_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    let trailer = bytes.len() - TRAILER_LENGTH;
    let crc = blob_crc(&bytes[..16], &bytes[20..trailer]);
    bytes[16..20].copy_from_slice(&crc.to_le_bytes());
    let checksum = bytes.len() - 4;
    let crc = CRC.checksum(&bytes[trailer..checksum]);
    bytes[checksum..].copy_from_slice(&crc.to_le_bytes());
    bytes
}

#[test]
fn every_single_bit_is_signed() {
    let (bytes, public_key) = good();
    let mut counts = BTreeMap::new();
    for bit in 0..8 * bytes.len() {
        let mut changed = bytes.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        assert!(blob::decode(&changed).is_err(), "bit {bit}");
        let error = verify(&changed, &public_key);
        assert_eq!(error, Err(SignatureError::Malformed), "bit {bit}");
        // A flipped bit of a checksum is repaired by that.
        let changed = with_new_checksums(changed);
        if changed != bytes {
            let error = verify(&changed, &public_key).expect_err("a bit that is not signed");
            *counts.entry(format!("{error:?}")).or_insert(0) += 1;
        }
    }
    let in_all: i32 = counts.values().sum();
    println!("{} bits refused; with new checksums:", 8 * bytes.len());
    let invalid = counts["Invalid"];
    let malformed = counts["Malformed"];
    println!(
        "{invalid} invalid, {malformed} malformed, {} of another key",
        in_all - invalid - malformed
    );
    assert_eq!(in_all as usize, 8 * (bytes.len() - 8));
    // Malformed: magic, length, and version and flags except for another version.
    assert!(malformed <= 8 * 16);
    assert_eq!(in_all - invalid - malformed, 64);
}
