//! `trainer device` with the firmware on an emulated board. The tests need QEMU and a compiler for the board; without them they
//! fail and say what to install.

use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};

use poegp_protocol::link::{Request, Response, Statistics};

use crate::fake_device::{FakeDevice, identity};
use crate::firmware_build::firmware;
use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

/// A running `trainer device emulate`, ended when dropped.
struct Board(Child);

impl Board {
    /// Starts the emulator in `folder` with the arguments `options`, and waits until it listens.
    fn start(folder: &Folder, options: &str) -> Self {
        let image = firmware().unwrap_or_else(|error| panic!("{error}"));
        let line = format!("device emulate --listen unix:link --log unix:log {options}");
        let mut child = folder
            .command(&line)
            .arg("--elf")
            .arg(&image.elf)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut printed = String::new();
        for line in BufReader::new(child.stdout.take().unwrap()).lines() {
            printed += &line.unwrap();
            printed.push('\n');
        }
        assert!(printed.contains("runs until Ctrl-C"), "{printed}");
        Self(child)
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        // The program has replaced itself by QEMU, so nothing else has to be ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The port, with a timeout for a loaded machine.
const PORT: &str = "--port unix:link --timeout-ms 20000";

/// Returns two models and a test set.
fn folder() -> Folder {
    Folder::prepared("board", |folder| {
        folder.write("train.csv", simulated("train", 40));
        folder.write("test.csv", simulated("test1", 20));
        for (model, file) in [
            ("poe-gp-load", "paper.blob"),
            ("elastic --inducing-points 20", "arm.blob"),
        ] {
            let line =
                format!("calibrate --robot {SERIAL} train.csv --method {model} --out {file}");
            folder.run(&line).ok();
        }
    })
}

#[test]
fn a_model_comes_onto_the_device_is_used_and_left_again() {
    let _texts = texts();
    let folder = folder();
    let run = |line: &str| folder.run(&format!("device {line} {PORT}"));
    let _board = Board::start(&folder, "");

    let info = run("info --json -").ok().json();
    assert_eq!(info["board"], "mps2-an386");
    assert!(info["model"].is_null());

    run("flash paper.blob --json -").ok().said();
    let second = run("flash arm.blob --chunk-size 64 --json -").ok().json();
    let crc = |blob: &str| {
        let inspected = folder.run(&format!("inspect {blob} --json -")).ok().json();
        inspected["crc"].as_str().unwrap().to_owned()
    };
    assert_eq!(second["before"]["crc"], crc("paper.blob"));
    assert_eq!(second["now"]["crc"], crc("arm.blob"));
    assert_eq!(
        run("flash arm.blob --json -").ok().json()["uploaded"],
        false
    );

    // The device has the errors of the host, to the bit.
    let on_device = run("evaluate test.csv --blob arm.blob --json -")
        .ok()
        .said()
        .json();
    let on_host = folder
        .run("evaluate arm.blob test.csv --json -")
        .ok()
        .json();
    assert_eq!(on_device["same_bits"], 20);
    assert_eq!(on_device["position_mm"], on_host["sets"][0]["position_mm"]);
    assert_eq!(on_device["flagged"], on_host["sets"][0]["flagged"]);
    // With base and tool fitted to the measurements, the RMS error is not larger.
    let fitted = run("evaluate test.csv --json -").ok().json();
    let rms = |document: &serde_json::Value| document["position_mm"]["rms"].as_f64().unwrap();
    assert!(rms(&fitted) <= rms(&on_device), "{fitted} {on_device}");

    let line = "correct test.csv --blob arm.blob --out corrected.csv --json -";
    let facts = run(line).ok().json();
    assert_eq!(
        (&facts["commands"], &facts["same_bits"]),
        (&20.into(), &20.into())
    );
    assert_eq!(facts["model"]["crc"], crc("arm.blob"));
    let corrected = folder.text("corrected.csv");
    assert_eq!(corrected.lines().count(), 21);
    assert!(
        corrected
            .starts_with("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,position_error_um,status\n"),
        "{corrected}"
    );
    let to_stdout = run("correct test.csv").ok();
    assert_eq!(to_stdout.stdout, corrected);

    run("bypass on").ok().said();
    let bypassed = run("correct test.csv").ok().stdout;
    assert!(
        bypassed
            .lines()
            .skip(1)
            .all(|line| line.ends_with(",0.000,bypassed")),
        "{bypassed}"
    );
    run("bypass off").ok();

    let left = run("rollback").ok().stdout;
    assert!(
        left.contains(&format!("Left    {}", crc("arm.blob"))),
        "{left}"
    );
    assert!(
        left.contains(&format!("Runs    {}", crc("paper.blob"))),
        "{left}"
    );
    let restarted = run("restart").ok().stdout;
    assert!(restarted.contains(&crc("paper.blob")), "{restarted}");
    let info = run("info --json -").ok().json();
    assert_eq!(info["start"]["reason"], "requested");

    let statistics = run("statistics --json -").ok().json();
    assert_eq!(statistics["statistics"]["restarts"], 1);
    assert_eq!(statistics["statistics"]["cycles"], 0);
    run("monitor --once").ok().said();
    let once = run("monitor --once --json -").ok().json();
    assert_eq!(once["model"]["crc"], crc("paper.blob"));
    assert_eq!(once["statistics"]["restarts"], 1);
}

#[test]
fn models_outlive_the_machine_in_its_memory_file() {
    let folder = folder();
    let board = Board::start(&folder, "--flash-image flash.bin");
    folder.run(&format!("device flash arm.blob {PORT}")).ok();
    drop(board);
    let _board = Board::start(&folder, "--flash-image flash.bin");
    let info = folder
        .run(&format!("device info {PORT} --json -"))
        .ok()
        .json();
    assert_eq!(info["model"]["inducing_points"], 20);
    assert_eq!(info["slots"][0]["runs_after_start"], true);
}

#[test]
fn a_provisioned_device_takes_only_what_its_key_has_signed() {
    let _texts = texts();
    let folder = folder();
    let run = |line: &str| folder.run(&format!("device {line} {PORT}"));
    let _board = Board::start(&folder, "");
    for keys in ["own", "other"] {
        folder.run(&format!("keys new --out {keys}")).ok();
        let line = format!("sign arm.blob --key {keys}.key --revision 7 --out {keys}.blob");
        folder.run(&line).ok();
    }
    run("info").ok().said();
    run("provision own.key").refused();
    run("provision own.pub").ok();
    run("provision own.pub").ok();
    run("provision other.pub").refused();
    run("flash arm.blob").refused();
    run("flash other.blob").refused();
    run("flash arm.blob --force").refused();
    run("flash other.blob --force").refused();
    run("flash own.blob").ok().said();
    // Requests must be signed too, with the same key.
    run("restart").refused();
    run("restart --key other.key").refused();
    run("restart --key own.key").ok();
    run("bypass on").ok();
    run("bypass off").refused();
    run("bypass off --key own.key").ok().said();
    run("cycle --period-us 2000").refused();
    run("cycle --period-us 2000 --key own.key").ok().said();
    run("stop").ok().said();
    let info = run("info --json -").ok().json();
    assert_eq!(info["model"]["revision"], 7);
    assert_eq!(info["key"].as_str().unwrap().len(), 16);
    // An old model of the same key is refused.
    folder
        .run("sign paper.blob --key own.key --revision 5 --out old.blob")
        .ok()
        .said();
    run("flash old.blob").refused();
    folder
        .run("sign paper.blob --key own.key --out new.blob")
        .ok();
    run("flash new.blob").ok();
    run("rollback").refused();
    run("rollback --key own.key").ok();
}

#[test]
fn another_robots_model_has_to_be_asked_for() {
    let _texts = texts();
    let folder = folder();
    let line = format!(
        "calibrate --robot {SERIAL} train.csv --method poe --serial-number 4711 --out other.blob"
    );
    folder.run(&line).ok();
    let run = |line: &str| folder.run(&format!("device {line} {PORT}"));
    let _board = Board::start(&folder, "");
    run("flash arm.blob").ok();
    run("flash other.blob").refused();
    run("flash other.blob --force").refused();
    run("flash other.blob --replace-robot").ok().said();
    let info = run("info --json -").ok().json();
    assert_eq!(info["model"]["serial_number"], "4711");
}

/// The line has one user at a time, so the numbers come from another device than the log.
#[test]
fn the_monitor_shows_numbers_and_the_decoded_log() {
    let (folder, other) = (folder(), Folder::new());
    let _board = Board::start(&folder, "--json ports.json");
    let ports = folder.json("ports.json");
    let elf = ports["elf"].as_str().unwrap();
    let _fake = FakeDevice::start(&other, |request| match request {
        Request::Identify => Response::Identity(identity()).into(),
        _ => Response::Statistics(Statistics::default()).into(),
    });
    let line = format!(
        "device monitor --port unix:{} --log unix:log",
        other.path("link").display()
    );
    let mut monitor = folder
        .command(&line)
        .args(["--elf", elf])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(monitor.stdout.take().unwrap()).lines();
    let mut wait_for = |text: &str| {
        let mut read = lines.by_ref().map_while(Result::ok).take(100);
        assert!(
            read.any(|line| line.contains(text)),
            "{text:?} was not printed"
        );
    };
    wait_for("fake: firmware");
    wait_for("worst ms");
    folder.run(&format!("device flash arm.blob {PORT}")).ok();
    wait_for("log: info: model ");
    wait_for("log: info: slot ");
    monitor.kill().unwrap();
    monitor.wait().unwrap();
}
