//! The demonstration with a device: an emulated co-processor runs models, and the simulated arm executes its commands.
//!
//! ```text
//!  q, m ──> nominal chain ──────────────────────────────────────────> where the target should be
//!    ├──────────────────────────────> the simulated arm ────────────> where it is           nominal error
//!    └──> device: corrected joints ─> the simulated arm ────────────> where it is then      calibrated error
//! ```
//!
//! The simulated arm is the ground truth, without the tracker's noise; the model is fitted to noisy measurements of it. The
//! nominal chain is that of the robot's description, with base and target from the base-tool calibration.

use std::error::Error;
use std::io::Write;
use std::time::Duration;

use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::{Provenance, calibrate_to_blob};
use poegp_calibration::measurement::parse;
use poegp_calibration::measurement::sample::{InstrumentSample, samples};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::numeric::statistics::{PoseError, Summary};
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::{Scenario, Simulator, to_csv};
use poegp_protocol::JointKind;
use poegp_protocol::link::Query;
use poegp_runtime::guard::status::Status;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;
use poegp_trainer::device::emulator::{Clock, Machine};

use crate::device::Device;
use crate::firmware_build::{Board, firmware_of};

/// Time limit of the demonstration, which takes a minute, or several minutes on a busy machine.
const TIME_LIMIT: Duration = Duration::from_secs(3_600);

/// Robot and payloads in kg, the same as in `trainer demo`.
const ROBOT: &str = "abb-irb4400-serial";
const PAYLOADS: [f64; 5] = [1.0, 2.5, 3.5, 5.0, 7.5];

/// Errors of the arm's pose over all commands, in mm and mrad.
#[derive(Debug)]
pub struct ArmErrors {
    /// Name of the source of the commands.
    pub name: &'static str,
    /// Position errors in mm.
    pub position_mm: Summary,
    /// Orientation errors in mrad.
    pub orientation_mrad: Summary,
}

impl ArmErrors {
    fn new(name: &'static str, errors: &[PoseError]) -> Self {
        let positions: Vec<f64> = errors.iter().map(|e| e.position_mm).collect();
        let angles: Vec<f64> = errors.iter().filter_map(|e| e.orientation_mrad).collect();
        Self {
            name,
            position_mm: Summary::new(&positions),
            orientation_mrad: Summary::new(&angles),
        }
    }
}

/// Runs the demonstration and writes its text to `out`. Returns the errors without a device, then those with each model.
///
/// # Errors
/// Anything that ends it early.
pub fn run(seed: u64, out: &mut dyn Write) -> Result<Vec<ArmErrors>, Box<dyn Error>> {
    let board = Board::default();
    writeln!(
        out,
        "1. Build the firmware, and switch on a co-processor in QEMU."
    )?;
    let mut device = Device::on_for(
        &Machine {
            board,
            elf: &firmware_of(board)?.elf,
            clock: Clock::Real,
            flash_image: None,
        },
        TIME_LIMIT,
    )?;
    let identity = device.identify()?;
    writeln!(
        out,
        "   {}, firmware {}",
        identity.board, identity.firmware_version
    )?;

    writeln!(
        out,
        "2. Simulate: an ABB IRB 4400 with imperfect frames and joints that yield under gravity and five payloads,\n   \
         measured by a tracker with 30 µm of noise. 300 poses to train on, 300 to test."
    )?;
    let robot = Robot::load(ROBOT, &LoadOptions::default())?;
    let mut arm = Simulator::new(&robot, Scenario::Paper, &PAYLOADS, seed);
    let mut tools = Vec::new();
    let mut measure = |name: &str| -> Result<_, Box<dyn Error>> {
        let csv = to_csv(&robot, &arm.measure(300), false, name);
        Ok(samples(&parse(name, csv.as_bytes())?, &robot, &mut tools)?)
    };
    let (train, tests) = (measure("train")?, measure("test")?);

    writeln!(
        out,
        "3. Calibrate with the paper's method and with elastic joints."
    )?;
    let origin = Provenance {
        serial_number: "demo".to_owned(),
        date: "2026-01-01".to_owned(),
        tools,
        ..Provenance::default()
    };
    let mut results = Vec::new();
    let mut notes = Vec::new();
    for (name, method) in [
        ("corrected, POE + GP with loading", Method::PoeGpLoad),
        ("corrected, elastic joints", Method::Elastic),
    ] {
        let options = Config::new(method);
        let calibrated =
            calibrate_to_blob(&robot, &train, &options, &origin, &FitContext::default())?;
        device.load(calibrated.blob.bytes())?;
        let run = run_one(&mut device, &calibrated.blob, &tests, &mut arm)?;
        if results.is_empty() {
            results.push(ArmErrors::new("as commanded", &run.before));
        }
        results.push(ArmErrors::new(name, &run.after));
        notes.push(format!(
            "  {name}: the pose that the device predicts is {:.3} mm off on average, {:.3} mm at most; a correction takes \
             up to {:.2} ms on the emulator; {} of {} commands are flagged, {} of them because they are next to a singularity \
             and corrected in part",
            run.predicted.mean,
            run.predicted.max,
            1e3 * f64::from(run.max_ticks) / f64::from(identity.tick_hz.max(1)),
            run.flagged,
            tests.len(),
            run.partly
        ));
    }
    writeln!(
        out,
        "4. Upload each model, and have the simulated arm execute {} commands that were not trained on: as they are,\n   \
         and as the device corrects them. Error of the pose against the nominal robot.\n",
        tests.len()
    )?;
    writeln!(
        out,
        "  {:34} mean mm    p95    max  mean mrad    p95    max",
        "commands"
    )?;
    for row in &results {
        let (mm, mrad) = (&row.position_mm, &row.orientation_mrad);
        writeln!(
            out,
            "  {:34} {:7.3} {:6.3} {:6.3}  {:9.3} {:6.3} {:6.3}",
            row.name, mm.mean, mm.p95, mm.max, mrad.mean, mrad.p95, mrad.max
        )?;
    }
    writeln!(out)?;
    for note in notes {
        writeln!(out, "{note}")?;
    }
    Ok(results)
}

/// Results of the commands with one model.
struct Run {
    before: Vec<PoseError>,
    after: Vec<PoseError>,
    /// Position errors of the device's predicted poses in mm.
    predicted: Summary,
    max_ticks: u32,
    flagged: usize,
    /// Number of commands that the device corrected only in part.
    partly: usize,
}

fn run_one(
    device: &mut Device,
    blob: &BlobModel,
    commands: &[InstrumentSample],
    arm: &mut Simulator,
) -> Result<Run, Box<dyn Error>> {
    let nominal = nominal(blob)?;
    let (mut before, mut after, mut predicted) = (Vec::new(), Vec::new(), Vec::new());
    let (mut max_ticks, mut flagged, mut partly) = (0, 0, 0);
    for sample in commands {
        let payload_kg = sample.payload_kg.unwrap_or(0.0);
        let wanted = blob.instrument_from_base() * nominal.forward(&sample.serial_joints);
        let stands = arm.stands_at(&sample.joints, payload_kg);
        before.push(PoseError::between(&wanted, &stands));

        let query = Query {
            joints: sample.joints.iter().map(|q| *q as f32).collect(),
            payload_kg: payload_kg as f32,
        };
        let pose = blob.in_instrument(&Pose::from_rows(&device.evaluate(&query)?.pose));
        predicted.push(PoseError::between(&stands, &pose).position_mm);

        let corrected = device.correct(&query)?;
        let joints: Vec<f64> = corrected.joints.iter().map(|q| f64::from(*q)).collect();
        let stands = arm.stands_at(&joints, payload_kg);
        after.push(PoseError::between(&wanted, &stands));
        max_ticks = max_ticks.max(corrected.ticks);
        let status = Status::from_bits(corrected.status);
        flagged += usize::from(!status.is_ok());
        partly += usize::from(status.contains(Status::PARTLY_CORRECTED));
    }
    Ok(Run {
        before,
        after,
        predicted: Summary::new(&predicted),
        max_ticks,
        flagged,
        partly,
    })
}

/// Returns the nominal chain of a blob, from base to target.
fn nominal(loaded: &BlobModel) -> Result<Poe<f64>, Box<dyn Error>> {
    let blob = loaded.blob();
    let kinds: Vec<JointKind> = blob.robot.joints.iter().map(|j| j.kind).collect();
    let frames: Vec<Pose<f64>> = blob
        .geometry
        .nominal
        .iter()
        .map(|frame| Pose::<f32>::from_rows(frame).cast())
        .collect();
    Ok(Poe::new(&kinds, &frames)?)
}
