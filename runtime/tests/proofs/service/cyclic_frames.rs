//! Cyclic frames give the bits of `Command`, and a dropped frame changes nothing but its own counter.

use poegp_protocol::link::cyclic::{
    CyclicAnswer, MAX_CYCLIC, decode_answer, encode_answer, encode_command,
};
use poegp_protocol::link::{Query, Refusal, Request, Response};

use super::commands::{command, desk_with, models};
use super::desk::{Desk, TICK_HZ, decoded, wire};
use super::known::{bits, key, public, query, refused};

fn frame(sequence: u16, query: &Query) -> Vec<u8> {
    let mut out = [0; MAX_CYCLIC];
    encode_command(sequence, query, &mut out).unwrap().to_vec()
}

/// Returns what the device sends in answer to `bytes`.
fn sent(desk: &mut Desk, bytes: &[u8]) -> Vec<u8> {
    desk.send(bytes);
    desk.run();
    desk.sent()
}

fn cyclic(desk: &mut Desk, sequence: u16, query: &Query) -> CyclicAnswer {
    let mut bytes = sent(desk, &frame(sequence, query));
    assert_eq!(bytes.pop(), Some(0));
    let (answered, answer) = decode_answer(&mut bytes).expect("one cyclic answer");
    assert_eq!(answered, sequence);
    answer
}

fn path(place: u32) -> Query {
    // There and back again.
    let moved = 3e-4 * (place % 2_000).abs_diff(1_000) as f32;
    let joints = [0.3, -0.4, 0.2, 0.1, 0.5, -0.2].map(|start| start + moved);
    query(&joints, 2.0)
}

/// Two devices follow one path with the same switches: one gets every command as a message, the other as a cyclic frame.
#[test]
fn the_bits_of_command() {
    let models = models();
    let [mut messages, mut frames] = [(); 2].map(|()| desk_with(&models));
    let mut applied = 0;
    for place in 0..4_000_u32 {
        let sequence = place as u16;
        let mut asked = path(place);
        match place {
            900..903 => asked.payload_kg = f32::NAN,
            1_000 => asked.joints[2] = f32::INFINITY,
            1_100 => {
                asked.joints.pop();
            }
            _ => {}
        }
        for desk in [&mut messages, &mut frames] {
            match place {
                1_500 => drop(desk.ask(&models[0].activate())),
                2_500 => drop(desk.ask(&Request::SetBypass { on: true })),
                3_300 => drop(desk.ask(&Request::SetBypass { on: false })),
                _ => {}
            }
            // One in a hundred is late.
            desk.wait(if place % 100 == 99 { 3 } else { 1 });
        }
        let one = command(&mut messages, sequence, &asked);
        let other = cyclic(&mut frames, sequence, &asked);
        assert_eq!(bits(&one.joints), bits(&other.joints), "{place}");
        let numbers = [one.applied, one.position_error, one.rotation_error];
        let others = [other.applied, other.position_error, other.rotation_error];
        assert_eq!(bits(&numbers), bits(&others), "{place}");
        assert_eq!(one.status, other.status, "{place}");
        applied += u32::from(bits(&one.joints) != bits(&asked.joints));
    }
    assert!(applied > 2_000, "{applied}");
    assert_eq!(messages.statistics(), frames.statistics());
    assert!(frames.is_running());
}

/// A device that gets additional frames to drop answers the commands like one that does not, and counts the dropped frames.
#[test]
fn what_is_dropped_is_counted_and_changes_nothing() {
    let models = models();
    let [mut alone, mut disturbed] = [(); 2].map(|()| desk_with(&models));
    let (mut repeats, mut bad) = (0, 0);
    for place in 0..2_000_u32 {
        let (sequence, asked) = (place as u16, path(place));
        let good = frame(sequence, &asked);
        for desk in [&mut alone, &mut disturbed] {
            desk.wait(1);
        }
        let one = cyclic(&mut alone, sequence, &asked);
        let other = cyclic(&mut disturbed, sequence, &asked);
        assert_eq!(one, other, "{place}");
        let dropped = match place % 5 {
            0 => {
                repeats += 1;
                good
            }
            // The same number with another command.
            1 => {
                repeats += 1;
                frame(sequence, &path(place + 1))
            }
            2 => {
                bad += 1;
                let mut damaged = good;
                damaged[5 + place as usize % 20] ^= 0x11;
                damaged.retain(|byte| *byte != 0);
                damaged.push(0);
                damaged
            }
            3 => {
                bad += 1;
                // An answer is longer than a command with the same number of joints.
                let mut out = [0; MAX_CYCLIC];
                let next = sequence.wrapping_add(1);
                encode_answer(next, &one, &mut out).unwrap().to_vec()
            }
            _ => {
                bad += 1;
                // Longer than any frame.
                [vec![1; 400], vec![0]].concat()
            }
        };
        assert!(sent(&mut disturbed, &dropped).is_empty(), "{place}");
    }
    let statistics = disturbed.statistics();
    assert_eq!((statistics.repeats, statistics.bad_frames), (repeats, bad));
    assert_eq!((statistics.cycles, statistics.gaps), (2_000, 0));
    let quiet = alone.statistics();
    assert_eq!((quiet.repeats, quiet.bad_frames), (0, 0));
}

/// While only invalid frames come, the filter holds the correction. Then it continues, as after any gap.
#[test]
fn the_filter_holds() {
    let models = models();
    let [mut alone, mut disturbed] = [(); 2].map(|()| desk_with(&models));
    for place in 0..1_000_u32 {
        let (sequence, asked) = (place as u16, path(place));
        for desk in [&mut alone, &mut disturbed] {
            desk.wait(1);
        }
        if (400..430).contains(&place) {
            assert!(sent(&mut disturbed, &frame(399, &asked)).is_empty());
            continue;
        }
        let one = cyclic(&mut alone, sequence, &asked);
        assert_eq!(one, cyclic(&mut disturbed, sequence, &asked), "{place}");
    }
    let [one, other] = [alone, disturbed].map(|mut desk| desk.statistics());
    assert_eq!((one.gaps, other.gaps), (1, 1));
    assert_eq!((one.repeats, other.repeats), (0, 30));
}

/// After cyclic frames, a damaged frame is not answered. Half a second later it is, and the last number may be used again.
#[test]
fn damage_is_answered_again_when_commands_have_stopped() {
    let models = models();
    let mut desk = desk_with(&models);
    let mut damaged = wire(7, &Request::Identify);
    damaged[1] ^= 0x55;
    let bad = [(0, refused(Refusal::BadFrame))];
    assert_eq!(desk.answers(&damaged), bad);
    cyclic(&mut desk, 5, &path(0));
    assert!(sent(&mut desk, &damaged).is_empty());
    assert!(sent(&mut desk, &frame(5, &path(1))).is_empty());
    // Services continue.
    let answers = desk.answers(&wire(7, &Request::Identify));
    assert!(matches!(answers[..], [(7, Response::Identity(_))]));
    desk.wait(TICK_HZ / 2 + 1);
    desk.look();
    assert_eq!(desk.answers(&damaged), bad);
    cyclic(&mut desk, 5, &path(1));
    assert!(sent(&mut desk, &damaged).is_empty());
    // A message shows that its sender waits for answers.
    command(&mut desk, 6, &path(2));
    assert_eq!(desk.answers(&damaged), bad);
    cyclic(&mut desk, 6, &path(3));
    assert_eq!(desk.ask(&Request::StopCyclic), Response::CyclicStopped);
    assert_eq!(desk.answers(&damaged), bad);
    assert!(!desk.is_running());
    let answer = decoded(&sent(&mut desk, &wire(9, &Request::ReadStatistics)));
    assert!(matches!(answer[..], [(9, Response::Statistics(_))]));
}

/// While commands come and are corrected, a restart would step: the correction must be taken back first, or the cycle stopped.
#[test]
fn a_restart_ends_no_correction() {
    let models = models();
    for how in ["bypass", "stop", "silence"] {
        let mut desk = desk_with(&models);
        let mut sequence = 0;
        let mut next = |desk: &mut Desk| {
            desk.wait(1);
            sequence += 1;
            let asked = path(u32::from(sequence));
            let answer = cyclic(desk, sequence, &asked);
            bits(&answer.joints) == bits(&asked.joints)
        };
        assert!(next(&mut desk));
        for _ in 0..600 {
            next(&mut desk);
            let answer = desk.ask(&Request::Restart);
            assert_eq!(answer, refused(Refusal::CyclesRunning));
        }
        match how {
            "bypass" => {
                desk.ask(&Request::SetBypass { on: true });
                while !next(&mut desk) {
                    let answer = desk.ask(&Request::Restart);
                    assert_eq!(answer, refused(Refusal::CyclesRunning));
                }
                // What is left of the correction is below the rounding of the joints.
                for _ in 0..20 {
                    assert!(next(&mut desk));
                }
            }
            "stop" => drop(desk.ask(&Request::StopCyclic)),
            _ => desk.wait(TICK_HZ / 2 + 1),
        }
        assert_eq!(desk.ask(&Request::Restart), Response::Restarting, "{how}");
    }
}

/// As after any command, only the owner of the key may stop the cycle.
#[test]
fn a_cyclic_frame_is_a_command() {
    let models = models();
    let mut desk = desk_with(&models);
    let public_key = public(&key(1));
    desk.ask(&Request::Provision { public_key });
    assert_eq!(desk.ask(&Request::StopCyclic), Response::CyclicStopped);
    cyclic(&mut desk, 5, &path(0));
    assert_eq!(desk.ask(&Request::StopCyclic), refused(Refusal::NotSigned));
    let signed = desk.ask_signed(&Request::StopCyclic, &key(1));
    assert_eq!(signed, Response::CyclicStopped);
}
