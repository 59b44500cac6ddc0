//! A variant of the image plants hangs, panics and faults. Each ends in a restart whose reason can be read afterwards. Work
//! that only takes long does not end in a restart.

use std::time::{Duration, Instant};

use poegp_protocol::link::{Refusal, Request, Response, StartReason};
use poegp_runtime::guard::status::Status;
use poegp_tests::device::Device;
use poegp_tests::emulator::{Clock, Machine, instructions};
use poegp_tests::firmware_build::{Board, Firmware, Variant, firmware, firmware_with};
use poegp_tests::image::Image;
use poegp_tests::sample::{Elastic, Sample, SampleCorrection};
use poegp_tests::stages::{CommandBits, Host};
use poegp_trainer::signing::SecretKey;

use crate::device;
use crate::watchdog::{SAMPLE, corrects, load_and_correct, restarts};

/// The faults that `Activate` requests: see `firmware/src/planted_faults.rs`.
const PANIC: u32 = 0xfa17_0001;
const HANG: u32 = 0xfa17_0002;
const FLASH_STAYS_BUSY: u32 = 0xfa17_0003;
const HANG_WITHOUT_INTERRUPTS: u32 = 0xfa17_0004;
const FAULT: u32 = 0xfa17_0005;
const CYCLE_HANGS: u32 = 0xfa17_0006;
const FLASH_IS_SLOW: u32 = 0xfa17_0007;
const FLASH_STOPS_THE_PROCESSOR: u32 = 0xfa17_0008;

/// Time until a panic or a fault has restarted the board: no time, plus an allowance for a busy machine.
const AT_ONCE: Duration = Duration::from_secs(5);
/// Time of the board's watchdog: two times four seconds.
const WATCHDOG: Duration = Duration::from_secs(8);
/// Ten seconds without a beat of the background, then the watchdog.
const BACKGROUND: Duration = Duration::from_secs(18);
/// Allowance for an answer that the restart swallows (the client waits 10 s) and for a busy machine.
const MORE: Duration = Duration::from_secs(25);

fn with_planted_faults() -> &'static Firmware {
    firmware_with(Board::default(), Variant::PlantedFaults)
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Returns a freshly started device with a stored model and no running cycles.
fn prepared() -> Device {
    prepared_with(Clock::Real)
}

/// Returns [`prepared`] with this clock. With [`Clock::Counting`] the time of a hang passes several times as fast.
fn prepared_with(clock: Clock) -> Device {
    let machine = Machine {
        board: Board::default(),
        elf: &with_planted_faults().elf,
        clock,
        flash_image: None,
    };
    let mut device = Device::on(&machine).unwrap();
    assert_eq!(device.identify().unwrap().start, StartReason::PowerOn);
    load_and_correct(&mut device);
    device.client().stand_down().unwrap();
    device
}

/// Requests a fault without waiting for an answer.
fn plant(device: &mut Device, fault: u32) -> Instant {
    let (_, frame) = device.frame(&Request::Activate { blob_crc: fault });
    device.send_bytes(&frame).unwrap();
    Instant::now()
}

/// Requests a fault that happens later.
fn arm(device: &mut Device, fault: u32) {
    let answer = device.request(&Request::Activate { blob_crc: fault });
    let unknown = Refusal::UnknownModel { blob_crc: fault };
    assert_eq!(answer.unwrap(), Response::Refused(unknown));
}

/// Waits for the only restart and returns its reason. Then the stored model answers, and a requested restart has its own
/// reason.
fn restarted(device: &mut Device, since: Instant, within: Duration) -> StartReason {
    while restarts(device) == 0 {
        assert!(since.elapsed() < within + MORE, "not restarted");
        std::thread::sleep(Duration::from_millis(50));
    }
    let reason = device.identify().unwrap().start;
    println!("{:.1} s: {reason:?}", since.elapsed().as_secs_f64());
    assert!(since.elapsed() < within + MORE);
    corrects(device);
    device.client().stand_down().unwrap();
    assert_eq!(restarts(device), 1);
    // Reading the reason does not change it.
    assert_eq!(device.identify().unwrap().start, reason);
    let identity = device.client().restart().unwrap();
    assert_eq!(identity.start, StartReason::Requested);
    assert_eq!(restarts(device), 2);
    corrects(device);
    reason
}

/// Returns the source line of the planted panic.
fn line_of_the_panic() -> u32 {
    let source = include_str!("../../../firmware/src/planted_faults.rs");
    let line = source.lines().position(|line| line.contains("panic!()"));
    line.unwrap() as u32 + 1
}

#[test]
fn a_panic_restarts_the_board_and_is_named() {
    let mut device = prepared();
    let since = plant(&mut device, PANIC);
    let line = line_of_the_panic();
    let reason = restarted(&mut device, since, AT_ONCE);
    assert_eq!(reason, StartReason::Panic { line });
}

#[test]
fn a_fault_restarts_the_board_and_is_named() {
    let mut device = prepared();
    let since = plant(&mut device, FAULT);
    let reason = restarted(&mut device, since, AT_ONCE);
    let StartReason::Fault { address } = reason else {
        panic!("{reason:?}");
    };
    let functions = Image::read(&with_planted_faults().elf).unwrap().functions;
    let function = functions.iter().find(|function| {
        let start = function.address & !1;
        (start..start + function.size).contains(&u64::from(address))
    });
    println!("{:?}", function.map(|function| &function.name));
    assert!(function.is_some(), "{address:08x} is in no function");
}

#[test]
fn a_background_that_hangs_restarts_the_board() {
    let mut device = prepared();
    let since = plant(&mut device, HANG);
    let reason = restarted(&mut device, since, BACKGROUND);
    assert!(since.elapsed() > WATCHDOG);
    assert_eq!(reason, StartReason::Background);
}

/// Running cycles do not keep the device alive when the background hangs; they are answered until the restart.
#[test]
fn a_background_that_hangs_under_cycles_restarts_the_board() {
    let mut device = prepared();
    let since = plant(&mut device, HANG);
    let (query, mut answers) = (&SAMPLE.queries(1)[0], 0);
    let expected = Host::load(&SAMPLE.blob()).unwrap().command(query);
    let busy = Response::Refused(Refusal::Busy);
    // A request is not repeated: a cyclic request after the restart would start cycles, whose end would cause another
    // restart.
    loop {
        assert!(since.elapsed() < BACKGROUND + MORE, "not restarted");
        let (number, frame) = device.frame(&Request::Correct(query.clone()));
        device.send_bytes(&frame).unwrap();
        let answer = match device.receive() {
            Ok(Some((answered, Response::Corrected(answer)))) if answered == number => answer,
            // The restart swallowed the answer.
            _ => break,
        };
        if answer.status == Status::NO_MODEL.bits() {
            break;
        }
        assert_eq!(CommandBits::from(&answer), expected);
        answers += 1;
        if answers % 50 == 0 {
            let (number, frame) = device.frame(&Request::ReadStatistics);
            device.send_bytes(&frame).unwrap();
            if !matches!(device.receive(), Ok(Some((n, answer))) if n == number && answer == busy) {
                break;
            }
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    device.client().stand_down().unwrap();
    println!("{answers} answers");
    assert!(answers > 200, "{answers}");
    let reason = restarted(&mut device, since, BACKGROUND);
    assert_eq!(reason, StartReason::Background);
}

/// The commit never returns; after the restart the model that was stored before is there.
#[test]
fn a_flash_that_stays_busy_restarts_the_board() {
    let mut device = prepared_with(Clock::Counting);
    arm(&mut device, FLASH_STAYS_BUSY);
    let other = Sample::plain(121, SampleCorrection::Elastic(Elastic::PLAIN)).blob();
    device.client().upload(&other, &mut |_| ()).unwrap();
    let (_, frame) = device.frame(&Request::CommitUpload);
    device.send_bytes(&frame).unwrap();
    let reason = restarted(&mut device, Instant::now(), BACKGROUND);
    assert_eq!(reason, StartReason::Background);
}

/// A hang that also stops SysTick cannot be noted, so the watchdog restarts the board and the reason is unknown.
#[test]
fn a_hang_that_stops_everything_restarts_the_board() {
    for fault in [HANG_WITHOUT_INTERRUPTS, CYCLE_HANGS] {
        let mut device = prepared_with(Clock::Counting);
        let since = plant(&mut device, fault);
        let reason = restarted(&mut device, since, WATCHDOG);
        assert_eq!(reason, StartReason::Unexplained);
    }
}

/// Returns a large signed model, with its key.
fn large() -> (SecretKey, Vec<u8>) {
    let key = SecretKey::generate().unwrap();
    let sample = Sample {
        joints: 7,
        ..Sample::plain(122, SampleCorrection::PerOutput(300))
    };
    let signed = key.sign(&sample.blob(), 1).unwrap();
    assert!(signed.len() > 16_000, "{} bytes", signed.len());
    (key, signed)
}

/// Sends `CommitUpload` and waits for its answer, with or without cycles meanwhile. Returns the time.
fn commit(device: &mut Device, cycles: bool) -> Duration {
    let query = &SAMPLE.queries(1)[0];
    let start = Instant::now();
    let (commit, frame) = device.frame(&Request::CommitUpload);
    device.send_bytes(&frame).unwrap();
    while start.elapsed() < Duration::from_secs(120) {
        if cycles {
            let (_, frame) = device.frame(&Request::Correct(query.clone()));
            device.send_bytes(&frame).unwrap();
        }
        if let Some((number, answer)) = device.receive().unwrap()
            && number == commit
        {
            assert!(matches!(answer, Response::Committed(_)), "{answer:?}");
            return start.elapsed();
        }
    }
    panic!("not committed");
}

/// With erases as slow as the data sheet allows, the commit of a large signed model takes longer than the watchdog and the
/// limit of a beat together. It is no hang, with cycles and without.
#[test]
fn a_commit_that_takes_long_is_no_hang() {
    let (key, signed) = large();
    for (fault, cycles) in [(FLASH_IS_SLOW, true), (FLASH_STOPS_THE_PROCESSOR, false)] {
        let mut device = prepared();
        device.allow_any_time().unwrap();
        device.client().provision(key.public().bytes()).unwrap();
        device.client().set_signer(key.signer());
        let model = device.client().upload(&signed, &mut |_| ()).unwrap();
        arm(&mut device, fault);
        let took = commit(&mut device, cycles);
        println!("{} bytes in {:.1} s", signed.len(), took.as_secs_f64());
        assert!(took > BACKGROUND, "{took:?} is not long");
        assert_eq!(restarts(&mut device), 0);
        assert_eq!(device.identify().unwrap().start, StartReason::PowerOn);
        device.client().activate(model.blob_crc).unwrap();
        assert_eq!(restarts(&mut device), 0);
    }
}

/// When the line becomes empty, that wakes the cycle once, and only if an answer waits for it. Otherwise the cycle would
/// read the first bytes of the next frame early, and the cost of a command would depend on when its bytes arrive.
#[test]
fn an_empty_line_wakes_the_cycle_only_when_an_answer_waits_for_it() {
    let mut device = Device::on(&Machine {
        board: Board::default(),
        elf: &with_planted_faults().elf,
        clock: Clock::Real,
        flash_image: None,
    })
    .unwrap();
    let request = Request::Activate {
        blob_crc: 0xfa17_0105,
    };
    assert_eq!(
        device.request(&request).unwrap(),
        Response::Uploading { received: 0b0010 }
    );
}

/// The cost of the bytes of a command and its answer of six joints, 32 times each: with DMA at most 0.6 of the cost with an
/// interrupt for each byte, in which entry and exit are not even counted.
#[test]
fn instructions_of_a_byte_on_its_way() {
    let machine = Machine {
        board: Board::default(),
        elf: &with_planted_faults().elf,
        clock: Clock::Counting,
        flash_image: None,
    };
    let mut device = Device::on(&machine).unwrap();
    let tick_hz = device.identify().unwrap().tick_hz;
    let mut per_byte = |question, bytes: u32| {
        let request = Request::Activate { blob_crc: question };
        let Response::Uploading { received } = device.request(&request).unwrap() else {
            panic!()
        };
        instructions(received, tick_hz) / f64::from(32 * bytes)
    };
    let received = [0xfa17_0101, 0xfa17_0102].map(|question| per_byte(question, 37));
    let sent = [0xfa17_0103, 0xfa17_0104].map(|question| per_byte(question, 46));
    println!("instructions per byte    by DMA    an interrupt each");
    println!(
        "received               {:8.1}  {:8.1}",
        received[0], received[1]
    );
    println!("sent                   {:8.1}  {:8.1}", sent[0], sent[1]);
    assert!(received[0] <= 0.6 * received[1], "{received:?}");
    assert!(sent[0] <= 0.6 * sent[1], "{sent:?}");
    assert!(received[0] + sent[0] <= 200.0);
}

/// The product contains none of the planted faults.
#[test]
fn a_product_plants_nothing() {
    let mut device = device();
    for fault in PANIC..=FLASH_STOPS_THE_PROCESSOR {
        arm(&mut device, fault);
    }
    load_and_correct(&mut device);
    assert_eq!(restarts(&mut device), 0);
    let product = Image::read(&firmware().unwrap().elf).unwrap();
    assert!(product.named(&["14planted_faults", "8measured"]).is_empty());
    let planted = Image::read(&with_planted_faults().elf).unwrap();
    assert!(
        !planted.named(&["14planted_faults"]).is_empty(),
        "the search finds nothing"
    );
}
