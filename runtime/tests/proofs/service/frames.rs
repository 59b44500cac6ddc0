//! Frames on the line that are damaged, too long, of another version, unknown or too many, and noise.

use poegp_protocol::blob::CRC;
use poegp_protocol::link::cobs;
use poegp_protocol::link::frame::{CYCLIC, MAX_FRAME};
use poegp_protocol::link::{PROTOCOL_VERSION, REQUESTS, Refusal, Request, Response, Statistics};
use proptest::prelude::*;

use super::desk::{Desk, wire};
use super::known::{Known, query, refused};
use crate::seeded::config;

/// Returns a frame with this body and a right CRC.
fn sealed(body: &[u8]) -> Vec<u8> {
    let raw = [body, &CRC.checksum(body).to_le_bytes()].concat();
    let mut out = vec![0; cobs::max_encoded(raw.len()) + 1];
    let used = cobs::encode(&raw, &mut out).expect("room");
    out.truncate(used + 1);
    out
}

#[test]
fn damaged_frames_are_answered_and_counted() {
    let mut desk = Desk::default();
    let good = wire(300, &Request::VerifyUpload);
    assert_eq!(desk.answers(&good), [(300, refused(Refusal::NoUpload))]);
    let bad = [(0, refused(Refusal::BadFrame))];
    let mut bad_frames = 0;
    for bit in 0..8 * (good.len() - 1) {
        let mut damaged = good.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        // A byte that becomes zero cuts the frame in two, and each part is answered.
        let answers = desk.answers(&damaged);
        assert!(!answers.is_empty() && answers.iter().all(|answer| *answer == bad[0]));
        bad_frames += answers.len() as u32;
    }
    for length in 1..good.len() - 1 {
        let cut = [&good[..length], &[0]].concat();
        assert_eq!(desk.answers(&cut), bad);
        bad_frames += 1;
    }
    // Longer than any frame, a little and by far.
    for length in [MAX_FRAME + 1, 5_000] {
        let long = [vec![1; length], vec![0]].concat();
        assert_eq!(desk.answers(&long), bad);
        bad_frames += 1;
    }
    assert_eq!(desk.answers(&[0; 100]), [], "lone zeros mean nothing");
    assert_eq!(desk.statistics().bad_frames, bad_frames);
    assert_eq!(desk.answers(&good), [(300, refused(Refusal::NoUpload))]);
}

#[test]
fn another_version_gets_an_error_that_names_both() {
    let mut desk = Desk::default();
    let others = (0..=u8::MAX).filter(|version| ![PROTOCOL_VERSION, CYCLIC].contains(version));
    for found in others {
        // The content does not matter: in version 1 number 4 was `Evaluate`, and 200 was nothing.
        for message in [&[][..], &[0], &[4, 1, 0, 0, 0, 0], &[200]] {
            let frame = sealed(&[&[found, 4, 1], message].concat());
            let refusal = Refusal::ProtocolVersion {
                found,
                expected: PROTOCOL_VERSION,
            };
            assert_eq!(desk.answers(&frame), [(0x0104, refused(refusal))]);
        }
    }
    assert_eq!(desk.statistics().bad_frames, 4 * 254);
}

#[test]
fn unknown_messages_are_named() {
    let mut desk = Desk::default();
    let unknown = [
        vec![],
        vec![REQUESTS.len() as u8],
        vec![255, 255],
        // One byte too many, one too few, a list that is too long, an invalid bool.
        vec![0, 0],
        vec![5, 1],
        [vec![1, 9], vec![0; 40]].concat(),
        vec![11, 2],
        [vec![12], vec![7; 31]].concat(),
    ];
    for message in &unknown {
        let frame = sealed(&[&[PROTOCOL_VERSION, 9, 0], &message[..]].concat());
        let answer = (9, refused(Refusal::UnknownMessage));
        assert_eq!(desk.answers(&frame), [answer], "{message:?}");
    }
    assert_eq!(desk.statistics().bad_frames, unknown.len() as u32);
}

#[test]
fn a_second_service_is_busy_and_a_cycle_is_not() {
    let [known, ..] = Known::three();
    let mut desk = Desk::default();
    known.install(&mut desk);
    // All of the bytes arrive before the background runs.
    desk.set_burst(10_000);
    let question = query(&[0.1, 0.2], 1.0);
    let line = [
        wire(1, &Request::Identify),
        wire(2, &Request::ReadStatistics),
        wire(3, &Request::Correct(question.clone())),
        wire(1, &Request::Identify),
        wire(4, &Request::StopCyclic),
    ];
    let refusals = desk.statistics().refused;
    let answers = desk.answers(&line.concat());
    let busy = refused(Refusal::Busy);
    assert_eq!(answers[0], (2, busy.clone()));
    let (3, Response::Corrected(corrected)) = &answers[1] else {
        panic!("{answers:?}")
    };
    known.assert_corrected(&question, corrected);
    assert_eq!(answers[2], (1, busy.clone()));
    assert_eq!(answers[3], (4, busy.clone()));
    assert!(matches!(answers[4], (1, Response::Identity(_))));
    assert_eq!(answers.len(), 5);
    // Sent again, the request is carried out.
    assert!(matches!(
        desk.answers(&line[1])[..],
        [(2, Response::Statistics(statistics))] if statistics.refused == refusals + 3
    ));
}

#[test]
fn everything_is_counted() {
    let [known, ..] = Known::three();
    let mut desk = Desk::default();
    let counted = Statistics {
        frames: 1,
        lost_bytes: 71,
        restarts: 72,
        lost_logs: 73,
        stack_bytes: 74,
        ..Statistics::default()
    };
    assert_eq!(desk.statistics(), counted);
    let pieces = known.bytes.len().div_ceil(256) as u32;
    known.upload(&mut desk);
    desk.ask(&known.activate());
    desk.ask(&known.activate());
    desk.ask(&Request::Evaluate(query(&[0.1, 0.2], 1.0)));
    desk.ask(&Request::Correct(query(&[0.1, 0.2], 1.0)));
    desk.ask(&Request::Correct(query(&[0.1], 1.0)));
    desk.ask(&Request::Trace(query(&[9.0, 0.2], 11.0)));
    desk.ask(&Request::StopCyclic);
    desk.ask(&known.roll_back());
    desk.answers(&[1, 2, 3, 0]);
    let statistics = desk.statistics();
    assert!(
        statistics.flagged >= 2,
        "bad input and poses far outside must be flagged"
    );
    let expected = Statistics {
        frames: 1 + (2 + pieces) + 2 + 4 + 1 + 1 + 1,
        bad_frames: 1,
        refused: 1,
        cycles: 4,
        max_ticks: 100,
        max_latency_ticks: 300,
        activations: 1,
        // These counts depend on the models; the tests of the cycle check them.
        flagged: statistics.flagged,
        limited: statistics.limited,
        uncorrected: statistics.uncorrected,
        ..counted
    };
    assert_eq!(statistics, expected);
}

proptest! {
    #![proptest_config(config(52, 400))]

    #[test]
    fn any_bytes_on_the_line(
        noise in prop::collection::vec(prop_oneof![3 => any::<u8>(), 1 => Just(0_u8)], 0..600),
        burst in 1_usize..600,
    ) {
        let mut desk = Desk::default();
        desk.set_burst(burst);
        for answer in desk.answers(&noise) {
            prop_assert!(matches!(answer.1, Response::Refused(_)));
        }
        // A zero ends whatever was begun, so the device takes the next frame.
        desk.answers(&[0]);
        let answers = desk.answers(&wire(7, &Request::Identify));
        prop_assert!(matches!(answers[..], [(7, Response::Identity(_))]), "{:?}", answers);
    }

    /// Any message in an intact frame is answered once, with its sequence number.
    #[test]
    fn any_message_in_an_intact_frame(
        sequence: u16,
        number in 0..19_u8,
        rest in prop::collection::vec(prop_oneof![2 => 0..4_u8, 1 => any::<u8>()], 0..60),
    ) {
        let mut desk = Desk::default();
        let [low, high] = sequence.to_le_bytes();
        let body = [&[PROTOCOL_VERSION, low, high, number][..], &rest].concat();
        let answers = desk.answers(&sealed(&body));
        prop_assert_eq!(answers.len(), 1);
        prop_assert_eq!(answers[0].0, sequence);
    }
}
