//! The other boards: a Cortex-M7, a Cortex-M55, and an STM32F405 as far as QEMU's `netduinoplus2` emulates it.
//!
//! QEMU does not model the STM32's clock tree, so the product refuses models as too slow; a variant that assumes the right
//! clock tests the rest. QEMU does not model DMA either, so the link takes an interrupt for each byte. Nor does it model
//! the flash controller: writes do not arrive, and the store reports that.

use poegp_protocol::link::{Key, PROTOCOL_VERSION, Refusal, Request, Response, StartReason};
use poegp_runtime::guard::status::Status;
use poegp_runtime::store::StoreError;
use poegp_tests::device::{Device, DeviceError};
use poegp_tests::emulator::{Clock, EmulatorError, Machine};
use poegp_tests::firmware_build::{Board, Variant, firmware_of, firmware_with};
use poegp_tests::image::Image;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection, odd_queries};
use poegp_tests::stages::{CommandBits, Host};
use poegp_trainer::device::error::ClientError;
use poegp_trainer::signing::SecretKey;

use crate::golden::compare_with_committed;

fn start(board: Board) -> Device {
    start_variant(board, Variant::Product)
}

fn start_variant(board: Board, variant: Variant) -> Device {
    let machine = Machine {
        board,
        elf: &firmware_with(board, variant)
            .unwrap_or_else(|error| panic!("{error}"))
            .elf,
        clock: Clock::Real,
        flash_image: None,
    };
    Device::on(&machine).unwrap()
}

fn identifies_itself(device: &mut Device, board: Board) {
    let identity = device.identify().unwrap();
    assert_eq!(identity.board, board.name());
    assert_eq!(identity.protocol_version, PROTOCOL_VERSION);
    assert_eq!(identity.key, Key::None);
    assert_eq!((identity.model, identity.slots), (None, [None; 2]));
    assert_eq!(identity.start, StartReason::PowerOn);
    let restarted = device.client().restart().unwrap();
    assert_eq!(restarted.start, StartReason::Requested);
    assert_eq!(device.statistics().unwrap().restarts, 1);
    let image = Image::read(&firmware_of(board).unwrap().elf).unwrap();
    assert_eq!(identity.image_crc, image.crc);
    println!(
        "{}: flash {} bytes, static RAM {} bytes",
        board.name(),
        image.flash,
        image.static_ram
    );
    assert!(image.flash <= 144 * 1_024, "{}", image.flash);
}

fn corrects(device: &mut Device, load: &mut dyn FnMut(&mut Device, &[u8])) {
    for (seed, kind) in [(100, Elastic::PLAIN), (101, Elastic::WITH_STD)] {
        let sample = Sample::plain(seed, SampleCorrection::Elastic(kind));
        let bytes = sample.blob();
        load(device, &bytes);
        let host = Host::load(&bytes).unwrap();
        for query in sample.queries(60).into_iter().chain(odd_queries()) {
            let answer = device.correct(&query).unwrap();
            assert_eq!(
                CommandBits::from(&answer),
                host.command(&query),
                "{query:?}"
            );
        }
    }
}

#[test]
fn cortex_m7_gives_the_committed_bits() {
    gives_the_committed_bits(Board::Mps2An500);
}

#[test]
fn cortex_m55_gives_the_committed_bits() {
    gives_the_committed_bits(Board::Mps3An547);
}

fn gives_the_committed_bits(board: Board) {
    let mut device = start(board);
    identifies_itself(&mut device, board);
    let mut load = |device: &mut Device, blob: &[u8]| {
        device.load(blob).unwrap();
    };
    compare_with_committed(&mut device, &mut load);
    corrects(&mut device, &mut load);
}

/// Uploads and activates a model without writing flash; it is active until the next restart.
fn activate(device: &mut Device, blob: &[u8]) {
    let model = device.client().upload(blob, &mut |_| ()).unwrap();
    device.client().activate(model.blob_crc).unwrap();
}

fn commit_refused(device: &mut Device) -> Refusal {
    match device.client().commit_upload() {
        Err(ClientError::Refused(refusal)) => refusal,
        other => panic!("{other:?}"),
    }
}

/// If the crystal does not start, the device refuses models with both frequencies, whatever time is provisioned, and
/// commands come back unchanged.
#[test]
fn stm32f405_without_its_crystal_refuses_to_be_in_time() {
    let board = Board::Stm32F405;
    let mut device = start(board);
    identifies_itself(&mut device, board);
    let sample = Sample::plain(103, SampleCorrection::Elastic(Elastic::PLAIN));
    let refused = device.client().upload(&sample.blob(), &mut |_| ());
    let slow = Refusal::SlowClock {
        hz: 16_000_000,
        needed: 168_000_000,
    };
    println!("{refused:?}");
    assert!(
        matches!(&refused, Err(ClientError::Refused(why)) if *why == slow),
        "{refused:?}"
    );
    let query = &sample.queries(1)[0];
    let answer = device.command(query).unwrap();
    assert_eq!(answer.joints, query.joints);
    assert!(Status::from_bits(answer.status).contains(Status::NO_MODEL));
    assert_eq!(device.identify().unwrap().model, None);
}

/// QEMU has no SPI link, so the test only checks that the image fits.
#[test]
fn the_image_with_spi_fits() {
    let elf = &firmware_with(Board::Stm32F405, Variant::SpiLink)
        .unwrap()
        .elf;
    let image = Image::read(elf).unwrap();
    println!("flash {}, static RAM {}", image.flash, image.static_ram);
    assert!(image.flash <= 144 * 1_024, "{}", image.flash);
    assert!(image.static_ram + 22 * 1_024 <= 128 * 1_024);
}

#[test]
fn stm32f405_gives_the_committed_bits() {
    let board = Board::Stm32F405;
    let mut device = start_variant(board, Variant::StatedClock);
    compare_with_committed(&mut device, &mut activate);
    corrects(&mut device, &mut activate);
}

/// The processor of this board stops while its flash is written, so the device does not write while cycles run. In QEMU
/// nothing is written, which the store notices; in both cases the active model continues.
#[test]
fn stm32f405_leaves_its_flash_alone_while_cycles_run() {
    let mut device = start_variant(Board::Stm32F405, Variant::StatedClock);
    let sample = Sample::plain(102, SampleCorrection::Elastic(Elastic::PLAIN));
    let (bytes, query) = (sample.blob(), &sample.queries(1)[0]);
    let expected = Host::load(&bytes).unwrap().command(query);
    let answers = |device: &mut Device| {
        let answer = device.correct(query).unwrap();
        assert_eq!(CommandBits::from(&answer), expected);
    };
    activate(&mut device, &bytes);
    let not_written = Refusal::Store {
        code: StoreError::ReadBack { at: 0 }.code(),
    };
    assert_eq!(commit_refused(&mut device), not_written);
    answers(&mut device);
    assert_eq!(commit_refused(&mut device), Refusal::CyclesRunning);
    let public_key = *SecretKey::generate().unwrap().public().bytes();
    let refused = device.request(&Request::Provision { public_key }).unwrap();
    assert_eq!(refused, Response::Refused(Refusal::CyclesRunning));
    answers(&mut device);
    device.client().stand_down().unwrap();
    assert_eq!(commit_refused(&mut device), not_written);
    answers(&mut device);
    assert_eq!(device.identify().unwrap().slots, [None; 2]);
}

#[test]
fn stm32f405_has_no_flash_that_outlives_qemu() {
    let board = Board::Stm32F405;
    let folder = tempfile::tempdir().unwrap();
    let machine = Machine {
        board,
        elf: &firmware_of(board).unwrap().elf,
        clock: Clock::Real,
        flash_image: Some(&folder.path().join("flash.bin")),
    };
    let refused = Device::on(&machine).unwrap_err();
    assert!(
        matches!(
            refused,
            DeviceError::Emulator(EmulatorError::NoMemory("stm32f405"))
        ),
        "{refused}"
    );
}
