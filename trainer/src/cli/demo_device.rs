//! `trainer demo --device`: the models on an emulated co-processor, and the simulated arm under its commands.
//!
//! ```text
//!  q, m ──> nominal chain ──────────────────────────────────────────> where the target should be
//!    ├──────────────────────────────> the simulated arm ────────────> where it is           error before
//!    └──> device: corrected joints ─> the simulated arm ────────────> where it is then      error after
//! ```
//!
//! The simulated arm is the truth, without the tracker's noise; the model knows it by its measurements only. What is
//! nominal is the robot as it was drawn, its base and target where the base-tool calibration has them.

use crate::cli::Failure;
use crate::cli::report::Report;
use poegp_calibration::measurement::sample::Sample;
use poegp_calibration::simulation::Simulator;

#[cfg(unix)]
pub use board::DemoDevice;

/// There is none here.
#[cfg(not(unix))]
pub struct DemoDevice;

#[cfg(not(unix))]
impl DemoDevice {
    pub fn start(_: Report) -> Result<Self, Failure> {
        Err(Failure::Usage(
            "--device needs a Unix system: QEMU inherits the link".to_owned(),
        ))
    }

    pub fn run(
        &mut self,
        _: Report,
        _: &[(&str, &[u8])],
        _: &[&Sample],
        _: &mut Simulator,
    ) -> Result<(), Failure> {
        Ok(())
    }
}

#[cfg(unix)]
mod board {
    use std::time::Duration;

    use poegp_protocol::JointKind;
    use poegp_runtime::poe::Poe;
    use poegp_runtime::se3::Pose;
    use poegp_runtime::status::Status;

    use super::{Failure, Report, Sample, Simulator};
    use crate::cli::device::{cyclic::query, flash, show};
    use crate::cli::progress;
    use crate::device::client::{Client, Options};
    use crate::device::emulator::{Clock, Emulator, Machine};
    use crate::device::firmware::{Board, firmware_of};
    use poegp_calibration::blob::predict::LoadedBlob;
    use poegp_calibration::numeric::statistics::{PoseError, Summary};

    /// The demonstration takes a minute, on a busy machine several.
    const TIME_LIMIT: Duration = Duration::from_secs(3_600);

    /// The emulated co-processor of the demonstration.
    pub struct DemoDevice {
        /// Switched off when this is dropped.
        _emulator: Emulator,
        client: Client,
    }

    impl DemoDevice {
        /// Builds the firmware and switches the board on.
        pub fn start(report: Report) -> Result<Self, Failure> {
            let board = Board::default();
            let spinner = progress::spinner("building the firmware");
            let built = firmware_of(board);
            spinner.finish_and_clear();
            let firmware = built.map_err(|error| Failure::Usage(error.to_string()))?;
            let machine = Machine {
                board,
                elf: &firmware.elf,
                clock: Clock::Real,
                memory: None,
            };
            let started = Emulator::start(&machine, TIME_LIMIT);
            let (emulator, link) = started.map_err(|error| Failure::Usage(error.to_string()))?;
            let options = Options {
                // A busy machine may take long to get to it.
                answer_limit: Duration::from_secs(10),
                ..Options::default()
            };
            let mut client = Client::over(Box::new(link), "the emulator".to_owned(), options);
            let identity = client.identify()?;
            report.line(format_args!(
                "0. Switch on an emulated co-processor: {}, firmware {}.",
                identity.board, identity.firmware_version
            ));
            Ok(Self {
                _emulator: emulator,
                client,
            })
        }

        /// Brings each model onto the board, has it correct every command, and the arm execute both.
        pub fn run(
            &mut self,
            report: Report,
            models: &[(&str, &[u8])],
            poses: &[&Sample],
            arm: &mut Simulator,
        ) -> Result<(), Failure> {
            report.line(format_args!(
                "\n5. Bring models onto the co-processor, and have the simulated arm execute {} commands that were not\n   \
                 trained on: as they are, and as the device corrects them. Error of the pose against the nominal robot.\n",
                poses.len()
            ));
            let mut rows = Vec::new();
            let mut notes = Vec::new();
            for (name, bytes) in models {
                let loaded = LoadedBlob::from_bytes(bytes.to_vec())
                    .map_err(|error| Failure::Usage(error.to_string()))?;
                let (_, identity) = flash::bring(&mut self.client, bytes)?;
                let run = self.run_one(&loaded, poses, arm);
                self.client.stand_down()?;
                let run = run?;
                if rows.is_empty() {
                    rows.push(row("as commanded", &run.before));
                }
                rows.push(row(&format!("corrected, {name}"), &run.after));
                notes.push(format!(
                    "  {name}: the device's own pose is {:.3} mm off in the mean, {:.3} at most; a correction takes up to \
                     {:.2} ms on the emulator; of {} commands {} are flagged, {} of them because they are beside a singularity \
                     and corrected in part",
                    run.predicted.mean,
                    run.predicted.max,
                    show::milliseconds(run.max_ticks, identity.tick_hz),
                    poses.len(),
                    run.flagged,
                    run.left
                ));
            }
            report.table(
                &[
                    "commands",
                    "mean mm",
                    "p95",
                    "max",
                    "mean mrad",
                    "p95",
                    "max",
                ],
                &rows,
            );
            report.line("");
            for note in notes {
                report.line(note);
            }
            Ok(())
        }

        fn run_one(
            &mut self,
            loaded: &LoadedBlob,
            poses: &[&Sample],
            arm: &mut Simulator,
        ) -> Result<Run, Failure> {
            let nominal = nominal(loaded)?;
            let (mut before, mut after, mut predicted) = (Vec::new(), Vec::new(), Vec::new());
            let (mut max_ticks, mut flagged, mut left) = (0, 0, 0);
            let bar = progress::bar(poses.len(), "correcting on the device");
            for sample in poses {
                let payload_kg = sample.payload_kg.unwrap_or(0.0);
                let wanted = loaded.instrument_from_base() * nominal.forward(&sample.serial);
                let stands = arm.stands_at(&sample.joints, payload_kg);
                before.push(PoseError::between(&wanted, &stands));

                let evaluation = self.client.evaluate(&query(sample))?;
                let pose = loaded.in_instrument(&Pose::from_rows(&evaluation.pose));
                predicted.push(PoseError::between(&stands, &pose).position_mm);

                let corrected = self.client.correct(&query(sample))?;
                let joints: Vec<f64> = corrected.joints.iter().map(|q| f64::from(*q)).collect();
                let stands = arm.stands_at(&joints, payload_kg);
                after.push(PoseError::between(&wanted, &stands));
                max_ticks = max_ticks.max(corrected.ticks);
                let status = Status::from_bits(corrected.status);
                flagged += usize::from(!status.is_ok());
                left += usize::from(status.contains(Status::PARTLY_CORRECTED));
                bar.inc(1);
            }
            bar.finish_and_clear();
            Ok(Run {
                before,
                after,
                predicted: Summary::new(&predicted),
                max_ticks,
                flagged,
                left,
            })
        }
    }

    /// What came of the commands under one model.
    struct Run {
        before: Vec<PoseError>,
        after: Vec<PoseError>,
        /// Position errors of the device's poses in mm.
        predicted: Summary,
        max_ticks: u32,
        flagged: usize,
        /// Commands that the device did not correct, because that would not have been better.
        left: usize,
    }

    /// The nominal chain of a blob, base to target.
    fn nominal(loaded: &LoadedBlob) -> Result<Poe<f64>, Failure> {
        let blob = loaded.blob();
        let kinds: Vec<JointKind> = blob.robot.joints.iter().map(|j| j.kind).collect();
        let frames: Vec<Pose<f64>> = blob
            .geometry
            .nominal
            .iter()
            .map(|frame| Pose::<f32>::from_rows(frame).cast())
            .collect();
        Poe::new(&kinds, &frames).map_err(|error| Failure::Usage(error.to_string()))
    }

    fn row(name: &str, errors: &[PoseError]) -> Vec<String> {
        let positions: Vec<f64> = errors.iter().map(|e| e.position_mm).collect();
        let angles: Vec<f64> = errors.iter().filter_map(|e| e.orientation_mrad).collect();
        let mut row = vec![name.to_owned()];
        for summary in [Summary::new(&positions), Summary::new(&angles)] {
            row.extend([summary.mean, summary.p95, summary.max].map(|x| format!("{x:.3}")));
        }
        row
    }
}
