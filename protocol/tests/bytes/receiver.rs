//! The receiver finds the next whole frame, whatever came before it.

use poegp_protocol::blob::CRC;
use poegp_protocol::link::frame::{FrameError, MAX_FRAME, Received, Receiver, decode, encode};
use poegp_protocol::link::{PROTOCOL_VERSION, Request};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::messages::requests;

fn wire(sequence: u16, request: &Request<'_>) -> Vec<u8> {
    let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    encode(sequence, request, &mut scratch, &mut out)
        .unwrap()
        .to_vec()
}

/// Returns what is received from `bytes`: the content of every complete frame, or `None` for one that was too long.
fn arrivals(receiver: &mut Receiver, bytes: &[u8]) -> Vec<Option<Vec<u8>>> {
    let mut out = Vec::new();
    for byte in bytes {
        match receiver.push(*byte) {
            Received::More => {}
            Received::Frame => {
                out.push(Some(receiver.frame().to_vec()));
                receiver.clear();
            }
            Received::TooLong => out.push(None),
        }
    }
    out
}

#[test]
fn frames_in_a_row() {
    let mut receiver = Receiver::new();
    for (sequence, request) in (0..).zip(requests()) {
        let bytes = wire(sequence, &request);
        let mut found = arrivals(&mut receiver, &bytes);
        let mut frame = found.pop().flatten().expect("a frame");
        assert!(found.is_empty());
        assert_eq!(decode(&mut frame), Ok((sequence, request)));
    }
}

#[test]
fn lone_zeros_mean_nothing() {
    assert!(arrivals(&mut Receiver::default(), &[0; 100]).is_empty());
}

#[test]
fn the_longest_content_arrives_and_one_byte_more_is_dropped() {
    let mut receiver = Receiver::new();
    for (length, fits) in [
        (MAX_FRAME - 1, true),
        (MAX_FRAME, true),
        (MAX_FRAME + 1, false),
        (3 * MAX_FRAME, false),
        (1, true),
    ] {
        let mut bytes = vec![0x11; length];
        let expected = fits.then(|| bytes.clone());
        bytes.push(0);
        assert_eq!(arrivals(&mut receiver, &bytes), [expected], "{length}");
    }
}

#[test]
fn half_a_frame_spoils_only_the_one_it_runs_into() {
    let whole = wire(5, &Request::ReadStatistics);
    for cut in 0..whole.len() {
        let mut receiver = Receiver::new();
        let line = [&whole[..cut], &whole, &whole].concat();
        let mut found = arrivals(&mut receiver, &line);
        let mut last = found.pop().flatten().expect("the last frame");
        assert_eq!(decode(&mut last), Ok((5, Request::ReadStatistics)));
        // With a zero in front, nothing is lost.
        let line = [&whole[..cut], &[0], &whole].concat();
        let mut last = arrivals(&mut receiver, &line).pop().flatten().unwrap();
        assert_eq!(decode(&mut last), Ok((5, Request::ReadStatistics)));
    }
}

/// The device opens a frame once for the sequence number, reads the message as often as it wants, and clears the frame.
#[test]
fn an_opened_frame_is_read_in_place() {
    let mut receiver = Receiver::new();
    let unopened = receiver.message::<Request<'_>>();
    assert_eq!(unopened, Err(FrameError::Damaged), "nothing was opened");
    for (sequence, request) in (250..).zip(requests()) {
        for byte in wire(sequence, &request) {
            receiver.push(byte);
        }
        let unopened = receiver.message::<Request<'_>>();
        assert_eq!(unopened, Err(FrameError::Damaged), "not opened yet");
        assert_eq!(receiver.open(), Ok(sequence));
        for _ in 0..2 {
            assert_eq!(receiver.message(), Ok((sequence, request.clone())));
        }
        receiver.clear();
        let cleared = receiver.message::<Request<'_>>();
        assert_eq!(cleared, Err(FrameError::Damaged), "cleared");
    }
}

#[test]
fn a_frame_that_cannot_be_opened_or_read_is_named() {
    let cases = [
        (vec![PROTOCOL_VERSION, 3, 4, 200], None, true),
        (vec![7, 3, 4, 200], Some((7, 0x0403)), false),
        // Including a frame without a message.
        (vec![2, 3, 4], Some((2, 0x0403)), false),
    ];
    for (body, version, opens) in cases {
        let raw = [&body[..], &CRC.checksum(&body).to_le_bytes()].concat();
        let mut receiver = Receiver::new();
        let mut stuffed = [0; 32];
        let used = poegp_protocol::link::cobs::encode(&raw, &mut stuffed).unwrap();
        for byte in &stuffed[..used] {
            receiver.push(*byte);
        }
        assert_eq!(receiver.push(0), Received::Frame);
        let expected = match version {
            None => Ok(0x0403),
            Some((found, sequence)) => Err(FrameError::Version { found, sequence }),
        };
        assert_eq!(receiver.open(), expected);
        let error = if opens {
            FrameError::UnknownMessage { sequence: 0x0403 }
        } else {
            FrameError::Damaged
        };
        assert_eq!(receiver.message::<Request<'_>>(), Err(error));
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 500,
        rng_seed: RngSeed::Fixed(3),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn after_any_noise_and_a_zero_the_next_frame_arrives(
        noise in prop::collection::vec(any::<u8>(), 0..2_500),
    ) {
        let mut receiver = Receiver::new();
        arrivals(&mut receiver, &noise);
        receiver.push(0);
        receiver.clear();
        let found = arrivals(&mut receiver, &wire(9, &Request::Identify));
        prop_assert_eq!(found.len(), 1);
        let mut frame = found[0].clone().unwrap();
        prop_assert_eq!(decode(&mut frame), Ok((9, Request::Identify)));
    }
}
