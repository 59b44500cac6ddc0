//! The device starts, identifies itself, and runs a model.

use std::io::{Read, Write};
use std::time::Duration;

use poegp_protocol::blob::envelope::TRAILER_LENGTH;
use poegp_protocol::blob::{self, HEADER_LENGTH, MAX_LENGTH_WITHOUT_ROWS};
use poegp_protocol::link::{Key, ModelIdentity, PROTOCOL_VERSION, Request};
use poegp_runtime::guard::status::Status;
use poegp_runtime::model::words_for;
use poegp_tests::emulator::{Clock, Emulator, Machine};
use poegp_tests::firmware_build::{Board, firmware};
use poegp_tests::image::Image;
use poegp_tests::log;
use poegp_tests::sample::{JOINTS, Sample, SampleCorrection, warnings};

use crate::device;

/// Number of the longest rows that fit.
const POINTS: usize = 400;

#[test]
fn identifies_itself_and_its_capacity() {
    let identity = device().identify().unwrap();
    assert_eq!(identity.protocol_version, PROTOCOL_VERSION);
    assert_eq!(identity.firmware_version, env!("CARGO_PKG_VERSION"));
    assert_eq!(identity.board, "mps2-an386");
    assert_eq!(identity.tick_hz, 25_000_000);
    assert_eq!(identity.capacity_words as usize, words_for(POINTS));
    let needed = HEADER_LENGTH + MAX_LENGTH_WITHOUT_ROWS + 4 * words_for(POINTS) + TRAILER_LENGTH;
    assert!(identity.capacity_bytes as usize >= needed);
    assert_eq!(identity.model, None);
    assert_eq!(identity.slots, [None; 2]);
    assert_eq!(
        identity.key,
        Key::None,
        "the device must report that no key is provisioned"
    );
    assert!(!identity.bypass);
    let image = Image::read(&firmware().unwrap().elf).unwrap();
    assert_eq!(
        identity.image_crc, image.crc,
        "the CRC of the flashed image"
    );
}

#[test]
fn without_a_model_says_so() {
    let sample = Sample::plain(1, SampleCorrection::None);
    let evaluation = device().evaluate(&sample.queries(1)[0]).unwrap();
    assert_eq!(evaluation.status, Status::NO_MODEL.bits());
    assert_eq!(evaluation.blob_crc, 0);
}

#[test]
fn names_the_model_it_runs_and_counts() {
    let sample = Sample::plain(2, SampleCorrection::Shared(50));
    let bytes = sample.blob();
    let mut device = device();
    let identity = device.load(&bytes).unwrap();
    let expected = ModelIdentity {
        robot: "Sample IRB 4400".try_into().unwrap(),
        serial_number: "4400-0001".try_into().unwrap(),
        blob_crc: blob::stored_crc(&bytes).unwrap(),
        joints: JOINTS as u8,
        inducing_points: 50,
        instructions: sample.size().command_bound(),
        revision: None,
        warnings: warnings(),
    };
    assert_eq!(identity.model, Some(expected));
    // The fourth query is outside the trained ranges.
    for query in sample.queries(4) {
        device.evaluate(&query).unwrap();
    }
    let statistics = device.statistics().unwrap();
    assert_eq!(statistics.activations, 1);
    assert_eq!(statistics.cycles, 4);
    assert!(statistics.flagged >= 1);
    assert_eq!(statistics.bad_frames, 0);
    assert_eq!(statistics.refused, 0);
}

#[test]
fn logs_its_start_what_it_loads_and_what_it_refuses() {
    let bytes = Sample::plain(4, SampleCorrection::Shared(7)).blob();
    let crc = blob::stored_crc(&bytes).unwrap();
    let mut device = device();
    device.load(&bytes).unwrap();
    // A repeated request is not logged again.
    device.identify().unwrap();
    let mut damaged = bytes.clone();
    damaged[100] ^= 1;
    device.load(&damaged).unwrap_err();
    device.load(&bytes[..50]).unwrap_err();
    let expected = [
        format!("info: firmware {} on mps2-an386", env!("CARGO_PKG_VERSION")),
        "warn: no model: commands are not corrected".to_owned(),
        format!("info: model {crc:08x} verified"),
        format!("info: slot 0 holds {} bytes", bytes.len()),
        format!("info: model {crc:08x} runs: 6 joints, 7 inducing points"),
        "warn: refused: blob is damaged".to_owned(),
        "warn: refused: blob is truncated".to_owned(),
    ];
    // The device sends its log when it has nothing else to do.
    let elf = &firmware().unwrap().elf;
    for _ in 0..100 {
        let lines = log::lines(elf, &device.emulator().log()).unwrap();
        if lines == expected {
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let lines = log::lines(elf, &device.emulator().log()).unwrap();
    assert_eq!(lines, expected);
    assert_eq!(device.statistics().unwrap().lost_logs, 0);
}

#[test]
fn holds_the_largest_model_and_no_larger() {
    let mut device = device();
    // A row of seven inputs is shorter than the longest row, so more points fit.
    let points = words_for(POINTS) / 13;
    let identity = device
        .load(&Sample::plain(3, SampleCorrection::Shared(points)).blob())
        .unwrap();
    assert_eq!(
        identity.model.map(|model| model.inducing_points),
        Some(points as u32)
    );
    let refused = device.load(&Sample::plain(3, SampleCorrection::Shared(points + 1)).blob());
    let message = refused.unwrap_err().to_string();
    assert!(message.contains("Model { code: 10 }"), "{message}");
}

/// A restart may cut an answer. The first byte after a restart is a zero, so that the cut answer does not spoil the next
/// one.
#[test]
fn a_zero_ends_what_a_restart_has_cut() {
    let mut device = device();
    let (_, request) = device.frame(&Request::Identify);
    let machine = Machine {
        board: Board::default(),
        elf: &firmware().unwrap().elf,
        clock: Clock::Real,
        flash_image: None,
    };
    let (_emulator, mut link) = Emulator::start(&machine, Duration::from_secs(60)).unwrap();
    link.write_all(&request).unwrap();
    let mut first = [1; 2];
    link.read_exact(&mut first).unwrap();
    assert_eq!(first[0], 0);
    assert_ne!(first[1], 0, "more than one zero");
}

#[test]
fn the_machine_is_switched_off_when_its_time_is_up() {
    let elf = &firmware().unwrap().elf;
    let limit = Duration::from_millis(100);
    let machine = Machine {
        board: Board::default(),
        elf,
        clock: Clock::Real,
        flash_image: None,
    };
    let (_emulator, mut link) = Emulator::start(&machine, limit).unwrap();
    // No request is sent, so at most the zero of the start arrives before the machine ends.
    let mut bytes = Vec::new();
    link.read_to_end(&mut bytes).unwrap();
    assert!(bytes.is_empty() || bytes == [0], "{bytes:?}");
}
