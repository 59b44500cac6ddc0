//! `trainer device` without a device, and with a device that misbehaves.

use poegp_protocol::blob::stored_crc;
use poegp_protocol::link::{
    Corrected, Evaluation, Identity, PROTOCOL_VERSION, Refusal, Request, Response, StartReason,
};
use serde_json::json;

use crate::bad_blobs::folder;
use crate::fake_device::{
    Answer, FakeDevice, PORT, encoded, identity, model, on_a_serial_line, stored,
};
use crate::program::{Folder, simulated};
use crate::texts::texts;

/// Every command that talks to a device, with the files of [`folder`].
const COMMANDS: [&str; 11] = [
    "info",
    "flash arm.blob",
    "evaluate test1.csv",
    "correct test1.csv",
    "bypass on",
    "rollback",
    "statistics",
    "monitor --once",
    "restart",
    "stop",
    "cycle --period-us 2000",
];

#[test]
fn a_port_that_is_not_there() {
    let _texts = texts();
    let (folder, _) = folder();
    for command in COMMANDS {
        folder.refuses(format!("device {command} {PORT}"));
    }
    folder.refuses("device info --port /dev/no-such-line");
    folder.refuses("device info --port /dev/no-such-line --baud 9600");
    folder.refuses("device info --port tcp:127.0.0.1:1");
}

#[test]
fn ports_that_cannot_be_meant() {
    let _texts = texts();
    let folder = Folder::new();
    for port in ["unix:", "tcp:4000", "tcp:host:http", "/dev/ttyUSB0@fast"] {
        folder.refuses(format!("device info --port {port}"));
    }
    folder.refuses("device info");
    folder.refuses("device monitor --port unix:link --log unix:log");
    folder.refuses("device flash arm.blob --port unix:link --chunk-size 0");
}

#[test]
fn nobody_answers() {
    let _texts = texts();
    let (folder, _) = folder();
    let fake = FakeDevice::start(&folder, |_| Answer::Nothing);
    folder.refuses(format!("device info {PORT}"));
    assert_eq!(fake.heard(), ["Identify"; 3]);
}

#[test]
fn a_serial_line_that_somebody_else_uses() {
    use serialport::SerialPort;
    let (_device, line) = serialport::TTYPort::pair().unwrap();
    let name = line.name().unwrap();
    let locked = serialport::new(&name, 115_200).open_native();
    // Either the pair holds the lock, or this test does.
    let folder = Folder::new();
    let outcome = folder.run(&format!("device info --port {name}"));
    assert_eq!(outcome.code, Some(2), "{outcome:#?}");
    assert!(
        outcome.stderr.contains("is another program using it?"),
        "{outcome:#?}"
    );
    drop(locked);
}

/// The line is a pair of pseudo-terminals, which have no speed, so the test can only see that one was set.
#[test]
fn a_serial_line_is_opened_at_its_speed() {
    let line = on_a_serial_line(|_| Response::Identity(identity()).into());
    let folder = Folder::new();
    for port in [
        line.clone(),
        format!("{line}@1000000"),
        format!("{line} --baud 57600"),
    ] {
        let outcome = folder.run(&format!("device info --port {port}")).ok();
        assert!(
            outcome.stdout.contains("fake: firmware 0.1.0"),
            "{outcome:#?}"
        );
    }
}

#[test]
fn noise_is_told_from_silence() {
    let _texts = texts();
    let (folder, _) = folder();
    let noise: Vec<u8> = (0..=255).rev().collect();
    FakeDevice::start(&folder, move |_| Answer::Bytes(noise.clone()));
    folder.refuses(format!("device info {PORT}"));
}

#[test]
fn another_version_is_named_with_our_own() {
    let _texts = texts();
    let (folder, _) = folder();
    let newer = PROTOCOL_VERSION + 1;
    // A frame of the other version: same layout, its own version and CRC.
    let mut raw = vec![newer, 1, 0, 0xff];
    raw.extend(poegp_protocol::blob::CRC.checksum(&raw).to_le_bytes());
    let mut bytes = vec![3, newer, 1];
    bytes.extend([1 + raw[3..].len() as u8]);
    bytes.extend(&raw[3..]);
    bytes.push(0);
    assert!(!raw[3..].contains(&0), "the frame was made by hand");
    FakeDevice::start(&folder, move |_| Answer::Bytes(bytes.clone()));
    folder.refuses(format!("device info {PORT}"));
}

#[test]
fn frames_that_always_arrive_damaged() {
    let _texts = texts();
    let (folder, _) = folder();
    FakeDevice::start(&folder, |_| Answer::BadFrame);
    folder.refuses(format!("device info {PORT}"));
}

/// Each reason for the last start is shown, in text and JSON.
#[test]
fn why_a_device_started() {
    let _texts = texts();
    for start in [
        StartReason::PowerOn,
        StartReason::Requested,
        StartReason::Cycles,
        StartReason::Background,
        StartReason::Panic { line: 198 },
        StartReason::Fault {
            address: 0x801_0080,
        },
        StartReason::Unexplained,
    ] {
        let folder = Folder::new();
        FakeDevice::start(&folder, move |_| {
            Response::Identity(Identity {
                start,
                ..identity()
            })
            .into()
        });
        let info = format!("device info {PORT}");
        folder.run(&info).ok().said();
        let document = folder.run(&format!("{info} --json -")).ok().json();
        let (reason, detail) = match start {
            StartReason::PowerOn => ("power-on", json!({})),
            StartReason::Requested => ("requested", json!({})),
            StartReason::Cycles => ("cycles", json!({})),
            StartReason::Background => ("background", json!({})),
            StartReason::Panic { .. } => ("panic", json!({ "line": 198 })),
            StartReason::Fault { .. } => ("fault", json!({ "address": "08010080" })),
            StartReason::Unexplained => ("unexplained", json!({})),
        };
        let mut expected = detail;
        expected["reason"] = reason.into();
        assert_eq!(document["start"], expected);
    }
}

/// A clock that stands still and numbers that are not finite are reported as errors of the device, not as results.
#[test]
fn numbers_that_are_none_are_refused() {
    let _texts = texts();
    for tick_hz in [0, 1_000] {
        let (folder, _) = folder();
        FakeDevice::start(&folder, move |request| match request {
            Request::Identify => Response::Identity(Identity {
                tick_hz,
                model: Some(model(1)),
                ..identity()
            })
            .into(),
            Request::Evaluate(_) => Response::Evaluation(Evaluation {
                blob_crc: 1,
                pose: [f32::NAN; 12],
                correction: [0.0; 6],
                trust: 1.0,
                position_sigma: None,
                status: 0,
                ticks: 5,
            })
            .into(),
            Request::Correct(query) => Response::Corrected(Corrected {
                blob_crc: 1,
                joints: query.joints.clone(),
                applied: 1.0,
                position_error: f32::INFINITY,
                rotation_error: 0.0,
                status: 0,
                ticks: 5,
            })
            .into(),
            Request::StopCyclic => Response::CyclicStopped.into(),
            _ => Answer::Nothing,
        });
        if tick_hz == 0 {
            folder.refuses(format!("device info {PORT}"));
            continue;
        }
        folder.refuses(format!("device evaluate test1.csv {PORT}"));
        folder.refuses(format!("device correct test1.csv {PORT}"));
        // Three poses determine the six numbers of a base frame, and leave too little to compare.
        folder.write("three.csv", simulated("test1", 3));
        folder.refuses(format!("device evaluate three.csv {PORT}"));
    }
}

#[test]
fn a_device_that_falls_silent() {
    let _texts = texts();
    let (folder, _) = folder();
    FakeDevice::start(&folder, |request| match request {
        Request::Identify => Response::Identity(identity()).into(),
        _ => Answer::Nothing,
    });
    folder.refuses(format!("device statistics {PORT}"));
}

/// Returns a device that accepts every model until the request `at`, which it refuses.
fn flashed(folder: &Folder, at: &'static str, refusal: Refusal) -> FakeDevice {
    FakeDevice::start(folder, move |request| {
        let name = format!("{request:?}");
        if name.starts_with(at) {
            return refusal.into();
        }
        match request {
            Request::Identify => Response::Identity(identity()).into(),
            Request::BeginUpload { .. } | Request::UploadChunk { .. } => {
                Response::Uploading { received: 0 }.into()
            }
            Request::VerifyUpload => Response::Verified(model(1)).into(),
            _ => Answer::Nothing,
        }
    })
}

#[test]
fn refused_models_are_refused_in_words() {
    let _texts = texts();
    for (at, refusal) in [
        ("VerifyUpload", Refusal::Model { code: 13 }),
        ("VerifyUpload", Refusal::Model { code: 10 }),
        ("VerifyUpload", Refusal::Signature { code: 2 }),
        ("CommitUpload", Refusal::Store { code: 10 }),
        ("CommitUpload", Refusal::CyclesRunning),
        ("VerifyUpload", Refusal::Model { code: 99 }),
    ] {
        let (folder, _) = folder();
        let fake = flashed(&folder, at, refusal);
        folder.refuses(format!("device flash arm.blob {PORT}"));
        assert_eq!(fake.count("Activate"), 0, "{refusal:?}");
    }
}

#[test]
fn what_is_not_a_model_never_reaches_the_port() {
    let _texts = texts();
    let (folder, mut blob) = folder();
    blob[100] ^= 1;
    folder.write("bad.blob", &blob);
    // The port does not exist, which the command does not even notice.
    folder.refuses(format!("device flash bad.blob {PORT}"));
    folder.refuses(format!("device evaluate none.csv {PORT}"));
    folder.refuses(format!("device provision none.pub {PORT}"));
}

/// Settings that are not given stay as they are, and a refusal says what to do.
#[test]
fn settings_of_the_cycle() {
    let _texts = texts();
    let folder = Folder::new();
    let mut now = identity();
    let fake = FakeDevice::start(&folder, move |request| {
        if let Request::ProvisionCycle(settings) = request {
            if settings.period_us > 100_000 {
                return Refusal::CycleSetting { code: 1 }.into();
            }
            if settings.rate > 0.9 {
                return Refusal::CycleSetting { code: 5 }.into();
            }
            now.cycle = *settings;
        }
        Response::Identity(now.clone()).into()
    });
    let run = |line: &str| folder.run(&format!("device cycle {line} {PORT}"));
    let shown = run("--json -").ok().stdout;
    assert!(shown.contains("\"period_us\": 1000"), "{shown}");
    assert_eq!(fake.count("ProvisionCycle"), 0);
    run("--period-us 2000 --blend 0.25").ok().said();
    let shown = run("--rate 0.05 --json -").ok().stdout;
    for words in [
        "\"period_us\": 2000",
        "\"rate_rad_per_s\": 0.05",
        "\"blend_s\": 0.25",
    ] {
        assert!(shown.contains(words), "{shown}");
    }
    run("--period-us 200000").refused();
    run("--rate 1").refused();
    folder.run(&format!("device info {PORT}")).ok().said();
}

#[test]
fn models_without_room_are_refused_before_a_byte_is_sent() {
    let _texts = texts();
    for (bytes, words) in [(1_000, 10_000), (50_000, 10)] {
        let (folder, _) = folder();
        let fake = FakeDevice::start(&folder, move |_| {
            let mut identity = identity();
            (identity.capacity_bytes, identity.capacity_words) = (bytes, words);
            Response::Identity(identity).into()
        });
        folder.refuses(format!("device flash arm.blob {PORT}"));
        assert_eq!(fake.heard(), ["Identify"]);
    }
}

#[test]
fn a_model_that_runs_already_is_not_sent_again() {
    let _texts = texts();
    let (folder, blob) = folder();
    let crc = stored_crc(&blob).unwrap();
    let slot = stored(&blob);
    let fake = FakeDevice::start(&folder, move |_| {
        let mut identity = identity();
        identity.model = Some(model(crc));
        identity.slots[0] = Some(slot);
        Response::Identity(identity).into()
    });
    let outcome = folder.run(&format!("device flash arm.blob {PORT} --json -"));
    let outcome = outcome.ok().said();
    assert_eq!(outcome.json()["uploaded"], false);
    assert_eq!(fake.heard(), ["Identify"]);
}

/// The line loses, damages and delays frames, and the device restarts twice during the upload. It still gets the model.
#[test]
fn a_bad_line_and_a_restart_do_not_keep_a_model_from_the_device() {
    let _texts = texts();
    let (folder, blob) = folder();
    let crc = stored_crc(&blob).unwrap();
    let sent = blob.clone();
    let (mut asked, mut received) = (0, Vec::new());
    let (mut has_restarted, mut has_stored) = (false, false);
    let fake = FakeDevice::start(&folder, move |request| {
        asked += 1;
        match asked % 7 {
            2 => return Answer::Nothing,
            3 => return Answer::BadFrame,
            5 => return Refusal::Busy.into(),
            // An answer to another request, and then none.
            6 => return Answer::Bytes(encoded(0, &Response::Restarting)),
            _ => {}
        }
        match request {
            Request::Identify | Request::Activate { .. } => {
                let mut identity = identity();
                identity.model = matches!(request, Request::Activate { .. }).then(|| model(crc));
                Response::Identity(identity).into()
            }
            Request::BeginUpload { .. } => {
                received.clear();
                Response::Uploading { received: 0 }.into()
            }
            Request::UploadChunk { .. } if received.len() > 700 && !has_restarted => {
                has_restarted = true;
                Refusal::NoUpload.into()
            }
            Request::UploadChunk { offset, bytes } => {
                assert_eq!(*offset as usize, received.len());
                received.extend_from_slice(bytes);
                Response::Uploading {
                    received: received.len() as u32,
                }
                .into()
            }
            Request::VerifyUpload => {
                assert_eq!(received, sent);
                Response::Verified(model(crc)).into()
            }
            Request::CommitUpload if !has_stored => {
                has_stored = true;
                Refusal::NotVerified.into()
            }
            Request::CommitUpload => Response::Committed(stored(&sent)).into(),
            other => panic!("{other:?}"),
        }
    });
    let line = "device flash arm.blob --port unix:link --timeout-ms 50";
    folder.run(line).ok().said();
    assert!(fake.count("BeginUpload") >= 3, "{:?}", fake.heard());
}

#[test]
fn measurements_and_models_that_are_not_the_device_s() {
    let _texts = texts();
    let (folder, _) = folder();
    FakeDevice::start(&folder, |_| {
        let mut identity = identity();
        identity.model = Some(model(7));
        Response::Identity(identity).into()
    });
    folder.refuses(format!("device evaluate test1.csv --blob arm.blob {PORT}"));
    folder
        .run("simulate --robot kuka-iiwa7 --poses 2 --test-sets 0 --out iiwa")
        .ok();
    folder.refuses(format!("device correct iiwa/train.csv {PORT}"));
}

#[test]
fn a_device_without_a_model_has_nothing_to_evaluate_or_leave() {
    let _texts = texts();
    let (folder, _) = folder();
    FakeDevice::start(&folder, |_| Response::Identity(identity()).into());
    for command in ["evaluate test1.csv", "correct test1.csv", "rollback"] {
        folder.refuses(format!("device {command} {PORT}"));
    }
}

/// After any failure the evaluation stops the cycle, so that the watchdog does not wait for cycles that will not come.
#[test]
fn a_failed_evaluation_stands_down() {
    let _texts = texts();
    let (folder, _) = folder();
    let fake = FakeDevice::start(&folder, |request| match request {
        Request::Identify => {
            let mut identity = identity();
            identity.model = Some(model(7));
            Response::Identity(identity).into()
        }
        Request::StopCyclic => Response::CyclicStopped.into(),
        _ => Refusal::UnknownMessage.into(),
    });
    folder.refuses(format!("device evaluate test1.csv {PORT}"));
    assert_eq!(fake.heard(), ["Identify", "Evaluate", "StopCyclic"]);
}

#[test]
fn without_qemu_the_emulator_says_what_to_install() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("image.elf", b"");
    let mut command =
        folder.command("device emulate --elf image.elf --listen unix:link --log unix:log");
    folder
        .finish(command.env("PATH", ""))
        .refused_after_output();
    folder.refuses("device emulate --elf none.elf");
    folder.write("other.elf", b"\x7fELF ... stm32f405 ...");
    folder.refuses("device emulate --elf other.elf");
    folder.refuses("device emulate --elf image.elf --listen /dev/ttyUSB0");
}
