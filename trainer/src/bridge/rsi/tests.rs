use std::fmt::Write as _;
use std::path::Path;

use poegp_calibration::blob::commander::Commander;
use poegp_calibration::blob::predict::BlobModel;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::bridge::corrector::Settings;
use crate::bridge::sequence::CONFIRMED;

const CYCLE_MS: u64 = 4;
const RAMP: u64 = 20_000;
const LIMIT: u64 = 150_000;

fn rsi(ramp_deg: f64, limit_deg: f64) -> Rsi {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../runtime/capi/examples/arm.blob");
    let commander = Commander::new(&BlobModel::read(&path).unwrap()).unwrap();
    let settings = Settings {
        payload_kg: 2.0,
        setpoint: Setpoint::Commanded,
        limit_deg,
        ramp_deg,
    };
    Rsi::new(Corrector::new(commander, settings), settings.setpoint)
}

fn small() -> Rsi {
    rsi(1e-6 * RAMP as f64, 1e-6 * LIMIT as f64)
}

fn packet(ipoc: u64, degrees: &[f64; 6]) -> String {
    let mut text = "<Rob><ASPos".to_owned();
    for (axis, q) in degrees.iter().enumerate() {
        write!(text, " A{}=\"{q:.4}\"", axis + 1).unwrap();
    }
    write!(text, "/><IPOC>{ipoc}</IPOC></Rob>").unwrap();
    text
}

/// The time stamp and the correction of an answer, in millionths of a degree.
fn parsed(answer: &[u8]) -> (u64, [i64; 6]) {
    let text = std::str::from_utf8(answer).unwrap();
    let numbers: Vec<&str> = text.split('"').skip(3).step_by(2).collect();
    let ipoc = text.split("<IPOC>").nth(1).unwrap().split('<').next();
    let correction = std::array::from_fn(|axis| numbers[axis].replace('.', "").parse().unwrap());
    (ipoc.unwrap().parse().unwrap(), correction)
}

fn step(one: &[i64; 6], other: &[i64; 6]) -> u64 {
    let steps = one.iter().zip(other).map(|(a, b)| a.abs_diff(*b));
    steps.max().unwrap()
}

#[test]
fn every_answer_has_the_time_stamp_of_its_packet() {
    let mut rsi = small();
    let q = [0.0, 10.0, 10.0, 0.0, 40.0, 0.0];
    for cycle in 0..200 {
        let ipoc = 7_000_000_000 + CYCLE_MS * cycle;
        let bytes = packet(ipoc, &q);
        let first = rsi.answer(bytes.as_bytes()).unwrap().to_vec();
        assert_eq!(parsed(&first).0, ipoc);
        // The same again, whatever its axes are by now.
        let again = packet(ipoc, &[5.0; 6]);
        assert_eq!(rsi.answer(again.as_bytes()).unwrap(), first);
        // What came before is late, and what cannot be read has no time stamp.
        let before = packet(ipoc - 5 * CYCLE_MS, &q);
        assert_eq!(rsi.answer(before.as_bytes()), None);
        assert_eq!(rsi.answer(b"<Rob><IPOC>1</IPOC>"), None);
    }
    let counts = rsi.counts();
    assert_eq!((counts.cycles, counts.lost), (200, 0));
    assert_eq!(
        (counts.duplicates, counts.late, counts.garbage),
        (395, 5, 200)
    );
}

/// Fast and slow paths through singularities, jumps, axes that are none, gaps, stops of packets, payloads: whatever comes, an
/// answer is near the one before.
#[test]
fn no_answer_steps_more_than_the_ramp() {
    let mut random = ChaCha8Rng::seed_from_u64(22);
    let (mut largest, mut size) = (0, 0);
    for _ in 0..12 {
        let mut rsi = small();
        let mut q = [0.0; 6];
        let mut speed = [0.0; 6];
        let mut ipoc = random.random::<u64>() / 2;
        let mut last = [0; 6];
        for _ in 0..600 {
            for (q, speed) in q.iter_mut().zip(&mut speed) {
                *speed = 0.9 * *speed + 0.4 * (2.0 * random.random::<f64>() - 1.0);
                *q += *speed;
            }
            match random.random_range(0..100) {
                0 => q[random.random_range(0..6)] += 20.0,
                1 => q = [0.0; 6],
                2 => ipoc += CYCLE_MS * random.random_range(1..90),
                _ => {}
            }
            ipoc += CYCLE_MS;
            let mut bytes = packet(ipoc, &q);
            if random.random_range(0..50) == 0 {
                bytes = bytes.replace("A3", "B3");
            }
            let (stamp, correction) = parsed(rsi.answer(bytes.as_bytes()).unwrap());
            assert_eq!(stamp, ipoc);
            let now = step(&correction, &last);
            assert!(now <= RAMP, "{correction:?} after {last:?}");
            largest = largest.max(now);
            size = size.max(step(&correction, &[0; 6]));
            last = correction;
        }
        rsi.stop();
        for _ in 0..10_000 {
            ipoc += CYCLE_MS;
            let (_, correction) = parsed(rsi.answer(packet(ipoc, &q).as_bytes()).unwrap());
            assert!(step(&correction, &last) <= RAMP);
            last = correction;
            if rsi.is_at_zero() {
                break;
            }
        }
        assert_eq!((last, rsi.is_at_zero()), ([0; 6], true));
    }
    // The path asks for more than the ramp and the limit: they act, and are reached.
    assert!(largest >= RAMP - 2, "{largest}");
    assert!((LIMIT - 2..=LIMIT).contains(&size), "{size}");
}

/// An arm that stands still explains no change: the filter of the device keeps the rate of 20 mrad/s, whatever the ramp is.
#[test]
fn the_filter_bounds_what_no_motion_explains() {
    let mut rsi = rsi(0.5, 5.0);
    let q = [0.0, 10.0, 10.0, 0.0, 40.0, 0.0];
    let rate = (1e6 * (0.02 * 1e-3 * CYCLE_MS as f64).to_degrees()) as u64;
    let (mut largest, mut last) = (0, [0; 6]);
    for cycle in 0..1_000 {
        if cycle == 500 {
            assert!(step(&last, &[0; 6]) > 10_000, "{last:?}");
            rsi.stop();
        }
        let answer = rsi.answer(packet(CYCLE_MS * cycle, &q).as_bytes());
        let (_, correction) = parsed(answer.unwrap());
        largest = largest.max(step(&correction, &last));
        last = correction;
    }
    // Rounding of two answers to a millionth.
    assert!(largest <= rate + 1 && largest > rate / 10, "{largest}");
    assert_eq!(last, [0; 6]);
}

/// The controller has forgotten the correction: another session begins at zero, also right after one that had some.
#[test]
fn a_session_begins_at_zero() {
    let mut rsi = small();
    let q = [0.0, 10.0, 10.0, 0.0, 40.0, 0.0];
    let mut answer = |ipoc: u64| rsi.answer(packet(ipoc, &q).as_bytes()).map(parsed);
    for start in [1_000_000, 500, 80_000_000_000] {
        let mut last = [0; 6];
        let mut answered = 0;
        for cycle in 0..400 {
            let Some((_, correction)) = answer(start + CYCLE_MS * cycle) else {
                continue;
            };
            assert!(answered > 0 || correction == [0; 6], "{correction:?}");
            assert!(step(&correction, &last) <= RAMP);
            (answered, last) = (answered + 1, correction);
        }
        assert!(step(&last, &[0; 6]) > 10_000, "{last:?}");
        let unconfirmed = if start == 1_000_000 {
            0
        } else {
            u64::from(CONFIRMED) - 1
        };
        assert_eq!(answered, 400 - unconfirmed);
    }
    assert_eq!(rsi.counts().sessions, 3);
}

/// While most packets are lost the correction is withdrawn with those that come, and it returns.
#[test]
fn a_bad_connection_withdraws_the_correction() {
    let mut rsi = small();
    let q = [0.0, 10.0, 10.0, 0.0, 40.0, 0.0];
    let mut ipoc = 4_000;
    let mut size_after = |rsi: &mut Rsi, packets: usize, step_ms: u64| {
        let mut size = 0;
        for _ in 0..packets {
            ipoc += step_ms;
            let (_, correction) = parsed(rsi.answer(packet(ipoc, &q).as_bytes()).unwrap());
            size = step(&correction, &[0; 6]);
        }
        size
    };
    let whole = size_after(&mut rsi, 1_000, CYCLE_MS);
    assert!(whole > 10_000);
    assert_eq!(size_after(&mut rsi, 1_000, 3 * CYCLE_MS), 0);
    assert!(rsi.counts().withdrawn > 900);
    assert_eq!(size_after(&mut rsi, 1_000, CYCLE_MS), whole);
}
