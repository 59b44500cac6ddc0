//! The device's Ed25519 against RFC 8032 and against `ed25519-dalek` in its strictest mode.

use curve25519_dalek::constants::{ED25519_BASEPOINT_POINT, EIGHT_TORSION};
use curve25519_dalek::edwards::EdwardsPoint;
use curve25519_dalek::scalar::Scalar;
use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use poegp_runtime::model::signature::{SignatureError, is_public_key, verify_message};
use proptest::prelude::*;
use sha2::{Digest, Sha512};

use crate::seeded::config;

fn ours(message: &[u8], signature: &[u8; 64], key: &[u8; 32]) -> bool {
    match verify_message(message, signature, key) {
        Ok(()) => true,
        Err(error) => {
            assert_eq!(error, SignatureError::Invalid);
            false
        }
    }
}

fn strict(message: &[u8], signature: &[u8; 64], key: &[u8; 32]) -> bool {
    let signature = Signature::from_bytes(signature);
    VerifyingKey::from_bytes(key).is_ok_and(|key| key.verify_strict(message, &signature).is_ok())
}

/// Returns the verdict of both implementations, which must agree.
#[track_caller]
fn verdict(message: &[u8], signature: &[u8; 64], key: &[u8; 32]) -> bool {
    let verdict = strict(message, signature, key);
    assert_eq!(
        ours(message, signature, key),
        verdict,
        "key {key:02x?}, signature {signature:02x?}"
    );
    verdict
}

fn bytes(hex: &str) -> Vec<u8> {
    let digits = hex.as_bytes().chunks(2);
    digits
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}

/// RFC 8032, 7.1: secret key, public key, message, signature of tests 1, 2, 3 and SHA(abc).
const RFC_8032: [[&str; 4]; 4] = [
    [
        "9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60",
        "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a",
        "",
        "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555fb8821590a33bacc61e39701cf9b46bd25bf5f0595bbe24655141438e7a100b",
    ],
    [
        "4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb",
        "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c",
        "72",
        "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00",
    ],
    [
        "c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7",
        "fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025",
        "af82",
        "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac18ff9b538d16f290ae67f760984dc6594a7c15e9716ed28dc027beceea1ec40a",
    ],
    [
        "833fe62409237b9d62ec77587520911e9a759cec1d19755b7da901b96dca3d42",
        "ec172b93ad5e563bf4932c70e1245034c35467ef2efd4d64ebf819683467e2bf",
        "ddaf35a193617abacc417349ae20413112e6fa4e89a97ea20a9eeee64b55d39a2192992a274fc1a836ba3c23a3feebbd454d4423643ce80e2a9ac94fa54ca49f",
        "dc2a4459e7369633a52b1bf277839a00201009a3efbf3ecb69bea2186c26b58909351fc9ac90b3ecfdfbc7c66431e0303dca179c138ac17ad9bef1177331a704",
    ],
];

#[test]
fn rfc_8032() {
    for [secret, public, message, signature] in RFC_8032 {
        let (secret, public) = (bytes(secret), bytes(public));
        let (message, signature) = (bytes(message), bytes(signature));
        let key = SigningKey::from_bytes(&secret.try_into().unwrap());
        assert_eq!(key.verifying_key().as_bytes(), &public[..]);
        assert_eq!(key.sign(&message).to_bytes(), signature[..]);
        let (public, signature) = (public.try_into().unwrap(), signature.try_into().unwrap());
        assert!(verdict(&message, &signature, &public));
        assert!(is_public_key(&public));
        let longer = [&message[..], &[0]].concat();
        assert!(!verdict(&longer, &signature, &public));
    }
}

proptest! {
    #![proptest_config(config(80, 200))]

    #[test]
    fn signed_and_tampered_with(
        secret in any::<[u8; 32]>(),
        message in prop::collection::vec(any::<u8>(), 1..300),
        bit in any::<prop::sample::Index>(),
    ) {
        let key = SigningKey::from_bytes(&secret);
        let (public, signature) = (key.verifying_key().to_bytes(), key.sign(&message).to_bytes());
        prop_assert!(verdict(&message, &signature, &public));
        let mut changed = message.clone();
        let at = bit.index(8 * message.len());
        changed[at / 8] ^= 1 << (at % 8);
        prop_assert!(!verdict(&changed, &signature, &public));
    }

    #[test]
    fn arbitrary_bytes_are_no_signature(
        key in any::<[u8; 32]>(),
        halves in any::<[[u8; 32]; 2]>(),
    ) {
        let signature = halves.concat().try_into().unwrap();
        prop_assert!(!verdict(b"message", &signature, &key));
    }
}

#[test]
fn every_bit_of_signature_and_key() {
    let key = SigningKey::from_bytes(&[7; 32]);
    let (public, signature) = (
        key.verifying_key().to_bytes(),
        key.sign(b"message").to_bytes(),
    );
    for bit in 0..512 {
        let mut changed = signature;
        changed[bit / 8] ^= 1 << (bit % 8);
        assert!(!verdict(b"message", &changed, &public), "bit {bit}");
    }
    for bit in 0..256 {
        let mut changed = public;
        changed[bit / 8] ^= 1 << (bit % 8);
        assert!(!verdict(b"message", &signature, &changed), "bit {bit}");
    }
}

/// The order of the base point, little endian.
const ORDER: [u8; 32] = [
    0xed, 0xd3, 0xf5, 0x5c, 0x1a, 0x63, 0x12, 0x58, 0xd6, 0x9c, 0xf7, 0xa2, 0xde, 0xf9, 0xde, 0x14,
    0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x10,
];

/// The same signature with the order added to its scalar. If that were accepted, signatures would be malleable.
#[test]
fn scalars_that_are_not_reduced() {
    let key = SigningKey::from_bytes(&[8; 32]);
    let public = key.verifying_key().to_bytes();
    let mut signature = key.sign(b"message").to_bytes();
    for times in 1..8 {
        let mut carry = 0;
        for (byte, order) in signature[32..].iter_mut().zip(ORDER) {
            let sum = u16::from(*byte) + u16::from(order) + carry;
            *byte = sum as u8;
            carry = sum >> 8;
        }
        assert_eq!(carry, 0);
        assert!(!verdict(b"message", &signature, &public), "S + {times} L");
    }
}

/// Returns all encodings of points of small order, canonical or not: y is 0, ±1 or one of ±y₈, plain or with p added where
/// that fits, with either sign.
fn small_order_encodings() -> Vec<[u8; 32]> {
    let mut all: Vec<[u8; 32]> = EIGHT_TORSION
        .iter()
        .map(|point| point.compress().to_bytes())
        .collect();
    // p, p + 1 and p − 1 encode 0, 1 and −1 again.
    for low in [0xed, 0xee, 0xec] {
        let mut bytes = [0xff; 32];
        bytes[0] = low;
        bytes[31] = 0x7f;
        all.push(bytes);
    }
    let other_signs: Vec<[u8; 32]> = all
        .iter()
        .map(|bytes| {
            let mut other = *bytes;
            other[31] ^= 0x80;
            other
        })
        .collect();
    all.extend(other_signs);
    all
}

#[test]
fn points_of_small_order_and_odd_encodings() {
    let key = SigningKey::from_bytes(&[9; 32]);
    let (public, signature) = (
        key.verifying_key().to_bytes(),
        key.sign(b"message").to_bytes(),
    );
    for point in small_order_encodings() {
        assert!(!is_public_key(&point), "{point:02x?}");
        let mut of_small_order = [0; 64];
        for other in small_order_encodings() {
            // S = 0 would be valid for every message for which R + h A is zero.
            of_small_order[..32].copy_from_slice(&other);
            for message in 0..8_u8 {
                assert!(!verdict(&[message], &of_small_order, &point));
            }
        }
        assert!(!verdict(b"message", &signature, &point));
        let mut changed = signature;
        changed[..32].copy_from_slice(&point);
        assert!(!verdict(b"message", &changed, &public));
    }
    for not_a_point in [[2; 32], [0xff; 32]] {
        assert!(!is_public_key(&not_a_point));
    }
}

/// Keys and commitments with a part of small order, which only the holder of the secret key can make. The device multiplies by
/// the cofactor and accepts them all. Without the cofactor, those whose small parts do not cancel are refused. This is the only
/// difference between the two implementations, and the device is never the stricter one.
#[test]
fn parts_of_small_order_pass_up_to_the_cofactor() {
    let (secret, nonce) = (Scalar::from(123_456_789_u64), Scalar::from(987_654_321_u64));
    let (mut taken, mut taken_by_both) = (0, 0);
    for key_part in EIGHT_TORSION {
        for commitment_part in EIGHT_TORSION {
            let key: EdwardsPoint = ED25519_BASEPOINT_POINT * secret + key_part;
            let commitment = ED25519_BASEPOINT_POINT * nonce + commitment_part;
            let (key, commitment) = (key.compress().to_bytes(), commitment.compress().to_bytes());
            let hash = Sha512::new()
                .chain_update(commitment)
                .chain_update(key)
                .chain_update(b"message")
                .finalize();
            let hash = Scalar::from_bytes_mod_order_wide(&hash.into());
            let response = (nonce + hash * secret).to_bytes();
            let signature = [commitment, response].concat().try_into().unwrap();
            assert!(ours(b"message", &signature, &key));
            taken += 1;
            taken_by_both += u32::from(strict(b"message", &signature, &key));
            assert!(!ours(b"another message", &signature, &key));
        }
    }
    println!("of {taken} taken by the device {taken_by_both} are by dalek");
    assert!((1..64).contains(&taken_by_both));
}
