//! Damaged blobs: every single-bit flip and every truncation is refused with its reason, and the last good model answers.

use poegp_protocol::blob::{self, DecodeError, HEADER_LENGTH};
use poegp_protocol::link::Refusal;
use poegp_tests::device::{Device, DeviceError};
use poegp_tests::sample::{Sample, SampleCorrection};
use poegp_tests::stages::Stages;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::device;

const SMALL: Sample = Sample::plain(50, SampleCorrection::Shared(3));

/// Returns whether `error` is the one that flipping this bit of an unsigned blob must give.
fn names_flip(bit: usize, length: u32, error: &DecodeError) -> bool {
    match bit / 8 {
        // The flag of a signed blob is set, but the trailer is missing.
        10 if bit == 80 => matches!(error, DecodeError::Truncated { .. }),
        0..8 => *error == DecodeError::WrongMagic,
        8..10 => matches!(error, DecodeError::UnknownVersion { .. }),
        10..12 => *error == DecodeError::ReservedBitsSet,
        12..16 => match error {
            DecodeError::Truncated { expected, found } => *found == length && *expected > length,
            DecodeError::TrailingBytes { expected, found } => {
                *found == length && *expected < length
            }
            _ => false,
        },
        _ => matches!(error, DecodeError::CrcMismatch { .. }),
    }
}

fn names_truncation(kept: u32, length: u32, error: &DecodeError) -> bool {
    let expected = if (kept as usize) < HEADER_LENGTH {
        HEADER_LENGTH as u32
    } else {
        length
    };
    *error
        == DecodeError::Truncated {
            expected,
            found: kept,
        }
}

#[test]
fn host_refuses_every_flip_and_every_truncation_by_name() {
    let good = SMALL.blob();
    let length = good.len() as u32;
    blob::decode(&good).unwrap();
    let mut bytes = good.clone();
    for bit in 0..8 * bytes.len() {
        bytes[bit / 8] ^= 1 << (bit % 8);
        let error = blob::decode(&bytes).expect_err("a flipped bit was accepted");
        assert!(names_flip(bit, length, &error), "bit {bit}: {error:?}");
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
    for kept in 0..length {
        let error = blob::decode(&good[..kept as usize]).expect_err("a cut blob was accepted");
        assert!(
            names_truncation(kept, length, &error),
            "{kept} bytes: {error:?}"
        );
    }
    bytes.push(0);
    assert!(matches!(
        blob::decode(&bytes),
        Err(DecodeError::TrailingBytes { .. })
    ));
}

fn refusal(device: &mut Device, bytes: &[u8]) -> DecodeError {
    match device.load(bytes) {
        Err(DeviceError::Refused(Refusal::Blob(error))) => error,
        other => panic!("{other:?}"),
    }
}

#[test]
fn device_refuses_them_too_and_keeps_its_model() {
    let active = Sample::plain(51, SampleCorrection::Shared(20));
    let mut device = device();
    device.load(&active.blob()).unwrap();
    let queries = active.queries(5);
    let answers = |device: &mut Device| -> Vec<Stages> {
        let traces = queries.iter().map(|query| device.trace(query).unwrap());
        traces.map(|trace| Stages::from(&trace)).collect()
    };
    let before = answers(&mut device);
    // The following tests take longer than the watchdog waits for the next cycle.
    device.client().stand_down().unwrap();
    let good = SMALL.blob();
    let length = good.len() as u32;
    let mut generator = ChaCha8Rng::seed_from_u64(52);
    for index in 0..300 {
        // All bits of the header, then some bits of the payload.
        let bit = if index < 8 * HEADER_LENGTH {
            index
        } else {
            generator.random_range(8 * HEADER_LENGTH..8 * good.len())
        };
        let mut bytes = good.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let error = refusal(&mut device, &bytes);
        assert!(names_flip(bit, length, &error), "bit {bit}: {error:?}");
    }
    for index in 0..50 {
        let kept = if index < 25 {
            index
        } else {
            generator.random_range(25..length)
        };
        let error = refusal(&mut device, &good[..kept as usize]);
        assert!(
            names_truncation(kept, length, &error),
            "{kept} bytes: {error:?}"
        );
    }
    assert_eq!(before, answers(&mut device));
    let statistics = device.statistics().unwrap();
    assert_eq!((statistics.activations, statistics.refused), (1, 350));
}
