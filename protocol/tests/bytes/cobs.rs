//! Our byte stuffing against the `cobs` crate: the same bytes and the same refusals.

use poegp_protocol::blob::BufferTooSmall;
use poegp_protocol::link::cobs::{decode_in_place, encode, max_encoded};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Returns the encoding, which must be the same with both encoders. Ours must not need more space than it states.
fn encoded(data: &[u8]) -> Vec<u8> {
    let mut ours = vec![0xaa; max_encoded(data.len())];
    let used = encode(data, &mut ours).expect("room for the longest");
    ours.truncate(used);
    let mut theirs = vec![0; ::cobs::max_encoding_length(data.len()) + 1];
    let used = ::cobs::try_encode(data, &mut theirs).expect("room");
    assert_eq!(ours, theirs[..used], "{data:02x?}");
    ours
}

fn assert_round_trip(data: &[u8]) {
    let mut frame = encoded(data);
    assert!(!frame.contains(&0));
    let used = decode_in_place(&mut frame).expect("an encoding");
    assert_eq!(&frame[..used], data);
}

/// Asserts that both decoders treat `frame` alike, except that ours refuses a zero within it.
fn assert_same_verdict(frame: &[u8]) -> bool {
    let (mut ours, mut theirs) = (frame.to_vec(), frame.to_vec());
    let found = decode_in_place(&mut ours);
    if frame.contains(&0) {
        assert_eq!(found, None, "{frame:02x?}");
        return false;
    }
    let expected = ::cobs::decode_in_place(&mut theirs).ok();
    assert_eq!(found, expected, "{frame:02x?}");
    if let Some(used) = found {
        assert_eq!(ours[..used], theirs[..used], "{frame:02x?}");
    }
    found.is_some()
}

#[test]
fn patterns_of_every_length() {
    let mut state = 1_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    for length in 0..=600 {
        let index = 0..length;
        assert_round_trip(&vec![0; length]);
        assert_round_trip(&vec![0xff; length]);
        assert_round_trip(&index.clone().map(|i| i as u8).collect::<Vec<_>>());
        assert_round_trip(&index.clone().map(|i| (i % 2) as u8).collect::<Vec<_>>());
        assert_round_trip(&index.clone().map(|_| random()).collect::<Vec<_>>());
        // Runs around a full block, and a zero at every place near the end.
        for run in 252..=256 {
            let zero_after_run = |i: usize| u8::from(i % (run + 1) != run);
            assert_round_trip(&index.clone().map(zero_after_run).collect::<Vec<_>>());
        }
        for place in length.saturating_sub(3)..length {
            let mut data = vec![7; length];
            data[place] = 0;
            assert_round_trip(&data);
        }
    }
}

#[test]
fn encoding_without_room_says_so() {
    for length in [0, 1, 5, 253, 254, 255, 300, 508, 509] {
        for byte in [0, 9] {
            let data = vec![byte; length];
            let whole = encoded(&data).len();
            for room in 0..whole {
                assert_eq!(encode(&data, &mut vec![0; room]), Err(BufferTooSmall));
            }
            assert_eq!(encode(&data, &mut vec![0; whole]), Ok(whole));
        }
    }
}

#[test]
fn every_truncation_and_every_changed_byte_has_the_same_verdict() {
    for length in [0, 1, 2, 20, 254, 255, 300] {
        let data: Vec<u8> = (0..length).map(|i| (i % 30) as u8).collect();
        let frame = encoded(&data);
        for end in 0..=frame.len() {
            assert_same_verdict(&frame[..end]);
        }
        for place in 0..frame.len() {
            for byte in [0, 1, 2, 3, 0x7f, 0xfe, 0xff] {
                let mut frame = frame.clone();
                frame[place] = byte;
                assert_same_verdict(&frame);
            }
        }
    }
}

/// Both decoders give the same verdict on frames of up to three bytes: any last byte after values around the block lengths.
#[test]
fn all_short_frames() {
    let interesting = [0, 1, 2, 3, 4, 5, 254, 255];
    let mut intact = 0;
    for a in interesting {
        intact += u32::from(assert_same_verdict(&[a]));
        for b in interesting {
            intact += u32::from(assert_same_verdict(&[a, b]));
            for c in 0..=u8::MAX {
                intact += u32::from(assert_same_verdict(&[a, b, c]));
            }
        }
    }
    assert!(intact > 200, "{intact}");
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 5_000,
        rng_seed: RngSeed::Fixed(4),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn any_data(data in prop::collection::vec(prop_oneof![Just(0_u8), 1..=255_u8, 1..=255_u8], 0..=700)) {
        assert_round_trip(&data);
    }

    #[test]
    fn any_frame(frame in prop::collection::vec(any::<u8>(), 0..=300)) {
        assert_same_verdict(&frame);
    }

    /// Small byte values, so that frames contain many whole blocks.
    #[test]
    fn any_frame_of_short_blocks(frame in prop::collection::vec(0..6_u8, 0..=40)) {
        assert_same_verdict(&frame);
    }

    #[test]
    fn any_frame_without_zeros(frame in prop::collection::vec(1..=8_u8, 0..=600)) {
        assert_same_verdict(&frame);
    }
}
