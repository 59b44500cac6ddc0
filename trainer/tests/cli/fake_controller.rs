//! A simulated controller with RSI, which moves an arm whose errors no model contains, and the bridge that corrects it.

use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Read};
use std::net::{SocketAddr, UdpSocket};
use std::process::{Child, ChildStdout, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use nalgebra::Vector3;
use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_runtime::math::se3::Pose;
use serde_json::Value;

use crate::numbers::check_document;
use crate::program::{Folder, SERIAL};

pub const PAYLOAD_KG: f64 = 5.0;
const PAYLOADS: [f64; 2] = [2.5, PAYLOAD_KG];
const SEED: u64 = 3;
/// Speed of the target, m/s.
pub const SPEED: f64 = 0.7;

/// Returns a model calibrated from 300 measured poses of the simulated arm.
pub fn blob() -> &'static [u8] {
    static BLOB: OnceLock<Vec<u8>> = OnceLock::new();
    BLOB.get_or_init(|| {
        let folder = Folder::new();
        let payloads = PAYLOADS.map(|kg| kg.to_string()).join(",");
        folder
            .run(&format!(
                "simulate --robot {SERIAL} --scenario wild --payloads {payloads} --poses 300 --test-sets 0 --seed {SEED} --out arm"
            ))
            .ok();
        folder
            .run(&format!(
                "calibrate --robot {SERIAL} arm/train.csv --method elastic --no-variance --out arm.blob"
            ))
            .ok();
        folder.read("arm.blob")
    })
}

/// The arm: the pose that the program wants, and the real one.
pub struct Arm {
    commander: Commander,
    instrument_from_base: Pose<f64>,
    flange_from_target: Pose<f64>,
    truth: Simulator,
}

impl Arm {
    pub fn new() -> Self {
        let blob = BlobModel::from_bytes(blob().to_vec()).unwrap();
        let robot = Robot::load(SERIAL, &LoadOptions::default()).unwrap();
        Self {
            commander: Commander::new(&blob).unwrap(),
            instrument_from_base: blob.instrument_from_base(),
            flange_from_target: Pose::from_rows(&blob.host().gauge.flange_from_target),
            truth: Simulator::new(&robot, Scenario::Nonlinear, &PAYLOADS, SEED),
        }
    }

    pub fn wanted(&self, joints: &Joints) -> Vector3<f64> {
        let nominal = self.commander.nominal_flange(joints) * self.flange_from_target;
        (self.instrument_from_base * nominal).translation
    }

    /// Returns the distance in mm between the real target and the wanted one, with this correction in millionths of a
    /// degree.
    pub fn error_mm(&mut self, joints: &Joints, correction: &[i64; 6]) -> f64 {
        let mut there = *joints;
        for (q, micro_degrees) in there.iter_mut().zip(correction) {
            *q += (1e-6 * *micro_degrees as f64).to_radians();
        }
        let stands = self.truth.stands_at(&there[..6], PAYLOAD_KG).translation;
        1e3 * (stands - self.wanted(joints)).norm()
    }

    /// Returns joints on a path through the trained ranges, by its parameter.
    pub fn path(&self, s: f64) -> Joints {
        let mut joints = self.commander.middle();
        let waves = [0.31, 0.43, 0.37, 0.53, 0.29, 0.61];
        let reach = [40.0, 25.0, 25.0, 40.0, 30.0, 60.0_f64];
        for (axis, q) in joints.iter_mut().take(6).enumerate() {
            let wave = libm::sin(waves[axis] * s + axis as f64);
            *q += reach[axis].to_radians() * wave;
        }
        // Away from the singularity of the wrist.
        joints[4] += 40.0_f64.to_radians();
        joints
    }

    /// Returns the parameter one cycle later, at [`SPEED`].
    pub fn advance(&self, s: f64, cycle_s: f64) -> f64 {
        let here = self.wanted(&self.path(s));
        let slope = (self.wanted(&self.path(s + 1e-4)) - here).norm() / 1e-4;
        s + SPEED * cycle_s / slope
    }
}

/// A running bridge with the controller's socket.
pub struct Bridge {
    pub child: Child,
    pub controller: UdpSocket,
    lines: BufReader<ChildStdout>,
}

impl Bridge {
    pub fn start(folder: &Folder, flags: &str) -> Self {
        folder.write("arm.blob", blob());
        let line = format!(
            "bridge rsi arm.blob --listen 127.0.0.1:0 --payload-kg {PAYLOAD_KG} --json out.json {flags}"
        );
        let mut child = folder
            .command(&line)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap());
        let address: SocketAddr = loop {
            let mut line = String::new();
            assert!(lines.read_line(&mut line).unwrap() > 0, "no address");
            if let Some(rest) = line.strip_prefix("listens") {
                break rest.split(',').next().unwrap().trim().parse().unwrap();
            }
        };
        let controller = UdpSocket::bind("127.0.0.1:0").unwrap();
        controller.connect(address).unwrap();
        let patience = Some(Duration::from_secs(30));
        controller.set_read_timeout(patience).unwrap();
        Self {
            child,
            controller,
            lines,
        }
    }

    pub fn send(&self, bytes: &[u8]) {
        self.controller.send(bytes).unwrap();
    }

    /// Receives the next answer: its time stamp and correction.
    pub fn answer(&self) -> (u64, [i64; 6]) {
        let mut buffer = [0; 1500];
        let length = self.controller.recv(&mut buffer).expect("an answer");
        answer(std::str::from_utf8(&buffer[..length]).unwrap())
    }

    /// Waits for the end of the program and asserts that nothing more was answered. Returns its output and its JSON document.
    pub fn end(mut self, folder: &Folder) -> (String, Value) {
        let status = self.child.wait().unwrap();
        assert_eq!(status.code(), Some(0));
        self.controller.set_nonblocking(true).unwrap();
        let mut buffer = [0; 1500];
        assert!(
            self.controller.recv(&mut buffer).is_err(),
            "one more answer"
        );
        let mut said = String::new();
        self.lines.read_to_string(&mut said).unwrap();
        let document = folder.json("out.json");
        check_document("bridge rsi", &document);
        (said, document)
    }
}

/// Parses an answer as strictly as a controller may: `<Sen Type="…"><AK A1="…" … A6="…"/><IPOC>…</IPOC></Sen>`.
pub fn answer(text: &str) -> (u64, [i64; 6]) {
    let mut rest = text;
    let mut until = |mark: &str| {
        let (before, after) = rest.split_once(mark).unwrap_or_else(|| panic!("{text}"));
        rest = after;
        before.to_owned()
    };
    assert_eq!(until("Type=\"ImFree\"><AK"), "<Sen ");
    let correction = std::array::from_fn(|axis| {
        assert_eq!(until("=\""), format!(" A{}", axis + 1));
        let number = until("\"");
        let (whole, decimals) = number.split_once('.').unwrap();
        assert_eq!(decimals.len(), 6, "{number}");
        format!("{whole}{decimals}").parse().unwrap()
    });
    assert_eq!(until("/><IPOC>"), "");
    let ipoc = until("</IPOC></Sen>");
    assert_eq!(rest, "");
    (ipoc.parse().unwrap(), correction)
}

/// Returns a packet of the controller with its four decimals. Only the setpoints or only the actual values are right, and
/// the bridge must read those.
pub fn packet(ipoc: u64, joints: &Joints, correction: &[i64; 6], is_actual: bool) -> String {
    let mut text = "<Rob Type=\"KUKA\"><RIst X=\"0.0\" Y=\"0.0\"/>".to_owned();
    for (element, is_right) in [("AIPos", is_actual), ("ASPos", !is_actual)] {
        write!(text, "<{element}").unwrap();
        for axis in 0..6 {
            let applied = if is_actual { correction[axis] } else { 0 };
            let degrees = joints[axis].to_degrees() + 1e-6 * applied as f64;
            let degrees = if is_right { degrees } else { degrees + 20.0 };
            write!(text, " A{}=\"{degrees:.4}\"", axis + 1).unwrap();
        }
        text += "/>";
    }
    write!(text, "<Delay D=\"0\"/><IPOC>{ipoc}</IPOC></Rob>").unwrap();
    text
}
