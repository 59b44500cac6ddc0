//! The self-test: a device passes if it computes as the workstation does. A device that fails, or whose clock is too slow,
//! corrects nothing.

use std::path::Path;
use std::{env, fs};

use poegp_protocol::blob;
use poegp_protocol::link::{Refusal, Request, Response};
use poegp_runtime::guard::status::Status;
use poegp_runtime::service::{BoardInfo, ModelSlot, self_test};

use super::desk::{BOARD, BYTES, Desk, flash};
use super::known::{Known, query, refused};
use crate::arm::{Arm, WORDS};

/// `POEGP_BLESS=1` rewrites the blob after the format has changed.
#[test]
fn the_workstation_passes() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/service/self_test.blob");
    let mut buffer = vec![0; BYTES];
    let bytes = blob::encode(&Arm::elastic(3, 4, false).blob(), &mut buffer)
        .expect("fits")
        .to_vec();
    if env::var_os("POEGP_BLESS").is_some() {
        fs::write(&path, &bytes).unwrap();
    }
    assert_eq!(fs::read(&path).unwrap(), bytes, "POEGP_BLESS=1 writes it");
    let mut slot = Box::<ModelSlot<WORDS>>::default();
    let other = Known::new(Arm::sound(2, 2));
    slot.load_unverified(&other.bytes).unwrap();
    assert!(self_test(&mut slot));
    assert_eq!(slot.identity(), None);
}

#[test]
fn a_device_that_fails_corrects_nothing() {
    let failing = BoardInfo {
        self_test: false,
        ..BOARD
    };
    corrects_nothing(failing, Refusal::SelfTest);
}

/// A slow clock is refused whatever number of instructions is provisioned, since that number assumes the right clock.
#[test]
fn a_clock_that_is_too_slow_corrects_nothing() {
    let slow = BoardInfo {
        clock_hz: 16_000_000,
        needed_clock_hz: 168_000_000,
        ..BOARD
    };
    let refusal = Refusal::SlowClock {
        hz: 16_000_000,
        needed: 168_000_000,
    };
    corrects_nothing(slow, refusal);
    let just = BoardInfo {
        clock_hz: BOARD.needed_clock_hz + 1,
        ..BOARD
    };
    let mut desk = Desk::start_on(flash(), false, just);
    Known::three()[0].install(&mut desk);
}

fn corrects_nothing(failing: BoardInfo, why: Refusal) {
    let [old, new, third] = Known::three();
    let mut desk = Desk::default();
    old.install(&mut desk);
    new.install(&mut desk);
    let flash_before = desk.flash.borrow().operations;
    let mut desk = Desk::start_on(desk.flash, false, failing);
    assert_eq!(desk.not_started, [Some(why); 2]);
    assert_eq!(desk.active(), None);
    assert_eq!(third.upload(&mut desk), refused(why));
    assert_eq!(
        desk.ask(&Request::CommitUpload),
        refused(Refusal::NotVerified)
    );
    let crc = third.blob_crc;
    assert_eq!(
        desk.ask(&third.activate()),
        refused(Refusal::UnknownModel { blob_crc: crc })
    );
    let asked = query(&[0.1, 0.2], 1.0);
    let Response::Commanded(commanded) = desk.ask(&Request::Command(asked.clone())) else {
        panic!()
    };
    assert_eq!(commanded.joints, asked.joints);
    assert!(Status::from_bits(commanded.status).contains(Status::NO_MODEL));
    // Nothing is lost: after a start that passes, the stored model runs.
    assert_eq!(desk.flash.borrow().operations, flash_before);
    let mut desk = Desk::start(flash_of(desk), false);
    assert_eq!(desk.active(), Some(new.blob_crc));
    assert_eq!(
        Desk::start_on(flash(), false, failing).not_started,
        [None; 2]
    );
}

fn flash_of(desk: Desk) -> std::rc::Rc<std::cell::RefCell<super::desk::Flash>> {
    desk.flash
}
