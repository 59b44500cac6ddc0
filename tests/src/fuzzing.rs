//! Readers under arbitrary bytes: for each a function that panics when a law is broken.
//!
//! | target | law |
//! |---|---|
//! | [`blob`] | a blob that is refused leaves the model that was there; one that is taken corrects no joint by more than [`MAX_JOINT_CHANGE`] and gives nothing that is not finite |
//! | [`frame`] | what is read is written to the same message again |
//! | [`measurements`] | refused by file name and what was expected; what is taken is finite, with unit quaternions |
//! | [`urdf`], [`toml`] | the same; what is taken has 1 to 8 joints and rigid frames |
//! | [`report`] | whatever is in a name, the page has as many tags as with an ordinary one |
//!
//! [`mutated`] makes bytes from seeds, reproducibly. The service of the device has a test against a model of its own in
//! the runtime (`proofs/service/sequences.rs`).

use std::path::Path;

use maud::html;
use poegp_protocol::frame::{self, MAX_FRAME, Received, Receiver};
use poegp_protocol::limits::MAX_JOINTS;
use poegp_protocol::link::{Request, Response};
use poegp_runtime::model::MAX_JOINT_CHANGE;
use poegp_runtime::se3::Pose;
use poegp_runtime::service::Resident;
use poegp_trainer::error::InputError;
use poegp_trainer::measurements as measurement_files;
use poegp_trainer::report::{Page, Section};
use poegp_trainer::robot::{LoadOptions, Robot};
use rand::{Rng, RngExt};
use serde::Serialize;

use crate::sample::{Sample, Support};

/// Words of support that a model may have here.
const WORDS: usize = 2_048;

/// Loads `bytes` as a blob, as they are and with the length and the checksum that they should have.
///
/// # Panics
/// When a law is broken.
pub fn blob(bytes: &[u8]) {
    load(bytes);
    let mut sealed = bytes.to_vec();
    if sealed.len() >= 20 {
        let length = sealed.len() as u32 - 20;
        sealed[..8].copy_from_slice(b"POEGPARM");
        sealed[8] = sealed[8] % 4;
        sealed[9..12].fill(0);
        sealed[12..16].copy_from_slice(&length.to_le_bytes());
        let crc = poegp_protocol::blob::blob_crc(&sealed[..16], &sealed[20..]);
        sealed[16..20].copy_from_slice(&crc.to_le_bytes());
        load(&sealed);
    }
}

fn load(bytes: &[u8]) {
    thread_local! {
        static ACTIVE: Vec<u8> = Sample::plain(1, Support::Shared(2)).blob();
    }
    let mut resident = Box::<Resident<WORDS>>::default();
    ACTIVE
        .with(|active| resident.load_unverified(active))
        .expect("the sample is a model");
    let before = resident.identity();
    if resident.load_unverified(bytes).is_err() {
        assert_eq!(
            resident.identity(),
            before,
            "a refusal has changed the model"
        );
    }
    let model = resident.model();
    for place in [0.0, 0.7, -2.5] {
        let joints = vec![place; model.joints()];
        let evaluation = model.evaluate(&joints, 1.0);
        let pose = evaluation.pose.to_rows();
        assert!(pose.iter().all(|value| value.is_finite()), "{pose:?}");
        let corrected = model.correct(&joints, 1.0);
        for (to, from) in corrected.joints.iter().zip(&joints) {
            let change = f64::from((to - from).abs());
            // Two roundings of a sum of single precision.
            assert!(change <= MAX_JOINT_CHANGE + 1e-6, "{change}");
        }
    }
}

/// Takes `bytes` from a line.
///
/// # Panics
/// When a law is broken.
pub fn frame(bytes: &[u8]) {
    let mut receiver = Receiver::new();
    for byte in bytes.iter().chain(&[0]) {
        if receiver.push(*byte) != Received::Frame {
            continue;
        }
        if receiver.open().is_ok() {
            if let Ok((sequence, request)) = receiver.message::<Request<'_>>() {
                let written = wire(sequence, &request);
                assert_eq!(frame::decode(&mut written.clone()), Ok((sequence, request)));
            }
            if let Ok((sequence, response)) = receiver.message::<Response>() {
                // By their bytes: a number that is not one is not equal to itself.
                let written = wire(sequence, &response);
                let again = frame::decode::<Response>(&mut written.clone());
                let (sequence, again) = again.expect("what was written");
                assert_eq!(wire(sequence, &again), written);
            }
        }
        receiver.clear();
    }
}

fn wire(sequence: u16, message: &impl Serialize) -> Vec<u8> {
    let (mut scratch, mut out) = ([0; 2 * MAX_FRAME], [0; 2 * MAX_FRAME]);
    let frame =
        frame::encode(sequence, message, &mut scratch, &mut out).expect("it came in a frame");
    frame[..frame.len() - 1].to_vec()
}

/// The message of a refusal names the file and does not run on for ever.
fn assert_refusal(error: &InputError, file: &str) {
    let text = error.to_string();
    assert!(text.contains(file), "{text}");
    assert!(text.len() < 20_000, "{} bytes", text.len());
}

/// Reads a measurement file.
///
/// # Panics
/// When a law is broken.
pub fn measurements(bytes: &[u8]) {
    match measurement_files::parse("measured.csv", bytes) {
        Err(error) => assert_refusal(&error, "measured.csv"),
        Ok(set) => {
            assert!(!set.measurements.is_empty());
            for row in &set.measurements {
                assert_eq!(row.joints.len(), set.joint_count());
                assert!(row.joints.iter().all(|value| value.is_finite()));
                assert!(row.position.iter().all(|value| value.is_finite()));
                assert!(row.payload_kg.is_none_or(|kg| kg.is_finite() && kg >= 0.0));
                if let Some((w, v)) = row.orientation {
                    let norm = (w * w + v.norm_squared()).sqrt();
                    assert!((norm - 1.0).abs() < 1e-12, "{norm}");
                }
            }
        }
    }
}

/// Reads a URDF.
///
/// # Panics
/// When a law is broken.
pub fn urdf(bytes: &[u8]) {
    robot("arm.urdf", bytes);
}

/// Reads a robot description in TOML.
///
/// # Panics
/// When a law is broken.
pub fn toml(bytes: &[u8]) {
    robot("arm.toml", bytes);
}

fn robot(file: &str, bytes: &[u8]) {
    match Robot::parse(Path::new(file), bytes, &LoadOptions::default()) {
        Err(error) => assert_refusal(&error, file),
        Ok(robot) => {
            let joints = robot.joints.len();
            assert!((1..=MAX_JOINTS).contains(&joints));
            assert_eq!(robot.parent_from_joint.len(), joints + 1);
            for frame in &robot.parent_from_joint {
                assert!(is_rigid(frame), "{frame:?}");
            }
        }
    }
}

fn is_rigid(frame: &Pose<f64>) -> bool {
    let unit = frame.rotation * frame.rotation.transpose();
    let identity = Pose::<f64>::identity().rotation;
    frame.translation.iter().all(|value| value.is_finite())
        && (unit - identity).iter().all(|value| value.abs() < 1e-9)
}

/// Renders a page whose every name is `bytes`.
///
/// # Panics
/// When a law is broken.
pub fn report(bytes: &[u8]) {
    let name = String::from_utf8_lossy(bytes);
    let tags = |text: &str| page(text).matches('<').count();
    assert_eq!(tags(&name), tags("ordinary"), "{name:?}");
}

fn page(name: &str) -> String {
    let section = Section::new("one", name)
        .text(html! { (name) })
        .missing(name)
        .figure(html! { (name) }, html! { svg {} }, "a note")
        .table(&[name], vec![vec![html! { (name) }]]);
    Page::new(name, name).with(section).render()
}

/// Bytes made from one of `seeds` by a few changes, as a fuzzer makes them: bits flipped, bytes replaced by telling ones,
/// parts taken out, doubled, or brought in from another seed.
pub fn mutated(seeds: &[Vec<u8>], random: &mut impl Rng) -> Vec<u8> {
    const TELLING: [&[u8]; 16] = [
        b"\0",
        b"\xff",
        b"\x80",
        b"\x7f",
        b",",
        b"\n",
        b"\"",
        b"<",
        b">",
        b"nan",
        b"inf",
        b"-1e309",
        b"1e-320",
        b"[[",
        b"=",
        b"\xef\xbb\xbf",
    ];
    let mut bytes = seeds[random.random_range(0..seeds.len())].clone();
    for _ in 0..random.random_range(1..6) {
        let at = random.random_range(0..=bytes.len());
        let to = bytes.len().min(at + random.random_range(1..40));
        match random.random_range(0..6) {
            0 | 1 if at < bytes.len() => bytes[at] ^= 1 << random.random_range(0..8),
            2 => drop(bytes.splice(
                at..to.min(at + 1),
                TELLING[random.random_range(0..16)].iter().copied(),
            )),
            3 => drop(bytes.drain(at..to)),
            4 => {
                let part = bytes[at..to].to_vec();
                drop(bytes.splice(at..at, part));
            }
            _ => {
                let other = &seeds[random.random_range(0..seeds.len())];
                let from = random.random_range(0..=other.len());
                let end = other.len().min(from + 60);
                drop(bytes.splice(at..to, other[from..end].iter().copied()));
            }
        }
    }
    bytes
}
