//! `trainer correct`: the corrected joints have the device's bits, everything else in the file stays, and the summary is right.

use poegp_protocol::link::frame::{self, MAX_FRAME, Receiver};
use poegp_protocol::link::{Corrected, Query, Request, Response, StartReason};
use poegp_runtime::model::words_for;
use poegp_runtime::service::{BoardInfo, Clock, Cycle, ModelSlot};

use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

const TARGETS: &str = "# welding program 7\nname,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,speed\n\
    a,10,20,-30,5,30,70,fast\n\n# all joints at zero: beside the wrist's singularity\nb,0,0,0,0,0,0,slow\n\
    \"c, d\",-31.25,-10.5,22,8.25,-40,12,\"fast\n# not slow\"\n";

/// Returns a folder with an elastic model of 60 poses.
fn folder() -> Folder {
    Folder::prepared("correct", |folder| {
        folder.write("train.csv", simulated("train", 60));
        folder.write("targets.csv", TARGETS);
        folder
            .run(&format!(
                "calibrate --robot {SERIAL} train.csv --inducing-points 60 --out arm.blob"
            ))
            .ok();
    })
}

struct Stopped;

impl Clock for Stopped {
    fn ticks(&mut self) -> u32 {
        0
    }
}

/// Returns the device's answer to a controller's frame.
fn device(resident: &mut ModelSlot<{ words_for(512) }>, query: Query) -> Corrected {
    let facts = BoardInfo {
        board: "",
        image_crc: 0,
        tick_hz: 1_000,
        deadline_ticks: 1_000,
        max_instructions: 100_000,
        flash_blocks: false,
        slot_writes: u32::MAX,
        clock_hz: 25_000_000,
        needed_clock_hz: 25_000_000,
        self_test: true,
        start: StartReason::PowerOn,
    };
    let mut cycle = Cycle::new(resident, &facts, false);
    let (mut scratch, mut out) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    let request = frame::encode(7, &Request::Correct(query), &mut scratch, &mut out).unwrap();
    let mut receiver = Receiver::new();
    for byte in request {
        receiver.push(*byte);
    }
    let mut answer = [0; MAX_FRAME];
    let mut scratch = [0; MAX_FRAME];
    cycle.handle_frame(&mut receiver, 0, &mut Stopped, &mut scratch, &mut answer);
    let mut receiver = Receiver::new();
    for byte in answer {
        if receiver.push(byte) == frame::Received::Frame {
            break;
        }
    }
    receiver.open().unwrap();
    match receiver.message::<Response>().unwrap() {
        (7, Response::Corrected(corrected)) => corrected,
        other => panic!("{other:?}"),
    }
}

/// The file has ten decimals of a degree, 1.7e-12 rad, so reading it back gives the same single-precision numbers.
#[test]
fn the_file_has_the_bits_of_the_device() {
    let folder = folder();
    folder.write("test.csv", simulated("test1", 50));
    folder
        .run("correct arm.blob test.csv --out corrected.csv")
        .ok();
    let mut resident = Box::new(ModelSlot::new());
    resident.load(&folder.read("arm.blob"), None).unwrap();
    let (before, after) = (folder.text("test.csv"), folder.text("corrected.csv"));
    let names: Vec<&str> = before.lines().next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|n| *n == name).unwrap();
    let mut rows = 0;
    for (before, after) in before.lines().zip(after.lines()).skip(1) {
        let (before, after): (Vec<&str>, Vec<&str>) =
            (before.split(',').collect(), after.split(',').collect());
        let joints = |fields: &[&str]| -> Vec<f32> {
            let of = |i: usize| fields[column(&format!("q{i}_deg"))].parse::<f64>().unwrap();
            (1..=6).map(|i| of(i).to_radians() as f32).collect()
        };
        let query = Query {
            joints: joints(&before).into_iter().collect(),
            payload_kg: before[column("payload_kg")].parse::<f64>().unwrap() as f32,
        };
        let answer = device(&mut resident, query);
        let bits = |q: &f32| q.to_bits();
        assert!(
            answer
                .joints
                .iter()
                .map(bits)
                .eq(joints(&after).iter().map(bits)),
            "{answer:?} {after:?}"
        );
        let error: f32 = after[names.len()].parse().unwrap();
        assert!((error - 1e6 * answer.position_error).abs() < 6e-4);
        assert_ne!(joints(&before), joints(&after));
        for i in (0..names.len()).filter(|i| !names[*i].starts_with('q') || names[*i].len() == 2) {
            assert_eq!(before[i], after[i]);
        }
        rows += 1;
    }
    assert_eq!(rows, 50);
}

#[test]
fn all_else_stays_and_the_summary_is_of_the_file() {
    let folder = folder();
    let line = "correct arm.blob targets.csv --payload-kg 2.5 --out out.csv --json -";
    let document = folder.run(line).ok().json();
    let text = folder.text("out.csv");
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 8);
    assert_eq!(lines[0], "# welding program 7");
    assert!(
        lines[1]
            .ends_with(",q6_deg,speed,position_error_um,rotation_error_urad,applied,status,trust")
    );
    assert_eq!(lines[3], "");
    assert!(lines[2].starts_with("a,") && lines[2].contains(",fast,"));
    assert!(lines[6].starts_with("\"c, d\",-3"), "{}", lines[6]);
    assert!(lines[7].starts_with("# not slow\","), "{}", lines[7]);
    assert_eq!(document["commands"], 3);
    let count = |name: &str| document[name].as_u64().unwrap();
    assert_eq!(
        count("corrected") + count("partly_corrected") + count("uncorrected"),
        3
    );
    // At the singularity the text of the command stays as it was.
    if lines[5].contains("not-corrected") {
        assert!(lines[5].starts_with("b,0,0,0,0,0,0,slow,"), "{}", lines[5]);
        assert_eq!(count("uncorrected"), 1);
    }
    let largest = &document["largest_change_deg"];
    assert!(largest["value"].as_f64().unwrap() > 0.001, "{document}");
    assert!(document["shift_mm"]["mean"].as_f64().unwrap() > 0.1);
    let printed = folder
        .run("correct arm.blob targets.csv --payload-kg 90 --out -")
        .ok();
    assert_eq!(printed.stdout.lines().count(), 8);
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let _texts = texts();
    let folder = folder();
    folder
        .run("correct arm.blob targets.csv --payload-kg 2.5 --out out.csv")
        .ok();
    folder.write("bad.csv", TARGETS.replace("-31.25", "x"));
    folder.write("far.csv", TARGETS.replace("-31.25", "400"));
    folder.write("five.csv", "q1_deg,q2_deg\n1,2\n");
    for line in [
        "targets.csv --out new.csv",
        "out.csv --payload-kg 2.5 --out new.csv",
        "targets.csv --payload-kg -1 --out new.csv",
        "train.csv --payload-kg 1 --out new.csv",
        "targets.csv --payload-kg 1 --out targets.csv",
        "bad.csv --payload-kg 1 --out new.csv",
        "far.csv --payload-kg 1 --out new.csv",
        "five.csv --payload-kg 1 --out new.csv",
    ] {
        folder.refuses(format!("correct arm.blob {line}"));
    }
}
