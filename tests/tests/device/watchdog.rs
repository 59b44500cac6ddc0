//! What causes a restart, what does not, and what survives one.

use std::time::{Duration, Instant};

use poegp_protocol::blob;
use poegp_protocol::link::StartReason;
use poegp_runtime::guard::status::Status;
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, Machine};
use poegp_tests::firmware_build::{Board, firmware};
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};
use poegp_tests::stages::{CommandBits, Host};

use crate::device;

pub const SAMPLE: Sample = Sample::plain(120, SampleCorrection::Elastic(Elastic::PLAIN));
/// Time limit for a restart; the watchdog of the board waits for two times four seconds.
const LIMIT: Duration = Duration::from_secs(40);

/// Returns the number of restarts since power-on. Asking for it does not count as a cycle.
pub fn restarts(device: &mut Device) -> u32 {
    device.statistics().unwrap().restarts
}

pub fn load_and_correct(device: &mut Device) {
    device.load(&SAMPLE.blob()).unwrap();
    corrects(device);
}

/// Asserts that the stored model answers correctly.
pub fn corrects(device: &mut Device) {
    let bytes = SAMPLE.blob();
    let host = Host::load(&bytes).unwrap();
    for query in SAMPLE.queries(3) {
        let answer = device.correct(&query).unwrap();
        assert_eq!(CommandBits::from(&answer), host.command(&query));
        assert_eq!(answer.blob_crc, blob::stored_crc(&bytes).unwrap());
    }
}

#[test]
fn a_controller_that_goes_silent_has_the_device_restarted() {
    let (mut silent, mut stood_down) = (device(), device());
    load_and_correct(&mut stood_down);
    stood_down.client().stand_down().unwrap();
    // A third device never gets a cyclic request.
    let mut idle = device();
    load_and_correct(&mut silent);
    let start = Instant::now();
    while restarts(&mut silent) == 0 {
        assert!(start.elapsed() < LIMIT, "not restarted in {LIMIT:?}");
        std::thread::sleep(Duration::from_millis(100));
    }
    println!(
        "restarted {:.1} s after the last cycle",
        start.elapsed().as_secs_f64()
    );
    assert_eq!(
        restarts(&mut stood_down),
        0,
        "a stopped cycle is no silence"
    );
    assert_eq!(
        restarts(&mut idle),
        0,
        "a device without cycles must not restart"
    );
    // It runs the stored model, and after this answer silence is no fault any more.
    let identity = silent.identify().unwrap();
    assert_eq!(identity.start, StartReason::Cycles);
    assert_eq!(idle.identify().unwrap().start, StartReason::PowerOn);
    let points = Elastic::PLAIN.points;
    assert!(
        identity
            .model
            .is_some_and(|model| model.inducing_points as usize == points)
    );
    assert_eq!(restarts(&mut silent), 1);
    corrects(&mut silent);
    corrects(&mut stood_down);
    assert_eq!(silent.statistics().unwrap().activations, 1);
}

/// Running cycles feed the watchdog, for longer than it waits.
#[test]
fn cycles_keep_the_watchdog_fed() {
    let mut device = device();
    load_and_correct(&mut device);
    let query = &SAMPLE.queries(1)[0];
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(12) {
        device.correct(query).unwrap();
    }
    assert_eq!(restarts(&mut device), 0);
}

#[test]
fn the_bypass_outlives_a_restart_and_no_power_failure() {
    let folder = tempfile::tempdir().unwrap();
    let memory = folder.path().join("flash.bin");
    let machine = Machine {
        board: Board::default(),
        elf: &firmware().unwrap_or_else(|error| panic!("{error}")).elf,
        clock: Clock::Real,
        flash_image: Some(&memory),
    };
    let query = &SAMPLE.queries(1)[0];
    let mut device = Device::on(&machine).unwrap();
    load_and_correct(&mut device);
    assert!(device.client().set_bypass(true).unwrap().bypass);
    for count in 1..=2 {
        let identity = device.client().restart().unwrap();
        assert!(identity.bypass, "restart {count}");
        assert_eq!(identity.start, StartReason::Requested);
        assert_eq!(restarts(&mut device), count);
        let answer = device.correct(query).unwrap();
        assert_eq!(answer.joints, query.joints);
        assert_eq!(answer.status, Status::BYPASSED.bits());
    }
    drop(device);
    let mut device = Device::on(&machine).unwrap();
    let identity = device.identify().unwrap();
    assert!(!identity.bypass && identity.model.is_some());
    assert_eq!(identity.start, StartReason::PowerOn);
    assert_eq!(restarts(&mut device), 0);
    corrects(&mut device);
}
