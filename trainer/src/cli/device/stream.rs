//! `trainer device evaluate` and `correct`: send the requests of a controller, from a measurement file.
//!
//! Both end with `StopCyclic`, even after an error: otherwise the device's watchdog would wait for more cycles.

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::blob::stored_crc;
use poegp_protocol::link::{Evaluation, Identity, Query, Refusal};
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;
use serde::Serialize;

use crate::cli::device::args::{Correct, Evaluate, Link};
use crate::cli::device::show;
use crate::cli::failure::Failure;
use crate::cli::input::Input;
use crate::cli::inputs as host;
use crate::cli::inputs::file_name;
use crate::cli::output::kind::Kind;
use crate::cli::output::{check_outputs, json_text, summary_text, write_texts};
use crate::cli::terminal::print::{Printer, error_row, is_stdout};
use crate::cli::terminal::progress;
use crate::device::client::Client;
use crate::device::error::ClientError;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::input_error::some_of;
use poegp_calibration::measurement as measurements;
use poegp_calibration::measurement::MeasurementSet;
use poegp_calibration::measurement::reader::DriftCorrection;
use poegp_calibration::measurement::sample::{InstrumentSample, different_poses};
use poegp_calibration::numeric::rotation::aligned;
use poegp_calibration::numeric::statistics::{ErrorSummary, PoseError};
use poegp_calibration::robot::Robot;

/// The JSON document that `evaluate --json` writes.
#[derive(Serialize)]
struct StreamJson {
    version: &'static str,
    model: serde_json::Value,
    name: String,
    #[serde(flatten)]
    errors: ErrorSummary,
    flagged: usize,
    max_ticks: u32,
    tick_hz: u32,
    /// Number of answers that were compared with the host's; all were equal bit for bit.
    #[serde(skip_serializing_if = "Option::is_none")]
    same_bits: Option<usize>,
}

/// A measurement file for the arm of a device, with the blob of the device's model if the user gives it.
struct Commands {
    set: MeasurementSet,
    samples: Vec<InstrumentSample>,
    loaded: Option<BlobModel>,
    identity: Identity,
    client: Client,
}

impl Commands {
    /// Reads the file and connects. With a blob, the file is checked against it before the port is opened.
    fn read(link: &Link, test: &Path, blob: Option<&Path>) -> Result<Self, Failure> {
        let loaded = blob.map(BlobModel::read).transpose()?;
        let with_blob = match &loaded {
            None => None,
            Some(loaded) => {
                let known = loaded.tools().len().max(1);
                let data = host::read(loaded, &Input::file(test), DriftCorrection::None)?;
                if data.names.len() > known {
                    return Err(InputError::new(
                        test,
                        format!(
                            "{}, which was mounted after the calibration",
                            data.names[known]
                        ),
                        "a tool of the blob",
                    )
                    .with_help("`trainer evaluate --fit-tool` fits its frame first")
                    .into());
                }
                Some((data.set, data.samples))
            }
        };
        let (set, samples) = match with_blob {
            Some(data) => data,
            None => read_without_blob(test)?,
        };
        let (client, identity) = link.connect()?;
        let Some(model) = &identity.model else {
            return Err(Failure::Usage(
                "the device runs no model\nhelp: upload one with `trainer device flash`".to_owned(),
            ));
        };
        if let (Some(loaded), Some(path)) = (&loaded, blob) {
            let crc = stored_crc(loaded.bytes()).unwrap_or(0);
            if crc != model.blob_crc {
                return Err(InputError::new(
                    path,
                    format!("model {crc:08x}"),
                    format!("the model that the device runs, {}", show::model(model)),
                )
                .with_help("`trainer device flash` uploads this one")
                .into());
            }
        }
        if set.joint_count() != usize::from(model.joints) {
            return Err(InputError::new(
                test,
                format!("{} joint columns", set.joint_count()),
                format!("{}, the joints of the model on the device", model.joints),
            )
            .into());
        }
        Ok(Self {
            set,
            samples,
            loaded,
            identity,
            client,
        })
    }

    /// Queries the device for every row, then states that no more commands will come.
    fn ask<T>(
        &mut self,
        label: &str,
        ask: impl Fn(&mut Client, &Query) -> Result<T, ClientError>,
    ) -> Result<Vec<T>, Failure> {
        let bar = progress::bar(self.samples.len(), label);
        let mut answers = Ok(Vec::new());
        for query in self.samples.iter().map(query) {
            let answer = ask(&mut self.client, &query);
            match (&mut answers, answer) {
                (Ok(answers), Ok(answer)) => answers.push(answer),
                (_, Err(error)) => {
                    answers = Err(error);
                    break;
                }
                (Err(_), _) => break,
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        let stood_down = self.client.stand_down();
        let answers = answers?;
        match stood_down {
            // The refusal of an unsigned stop is no error: a controller sends commands, and its owner must stop them.
            Err(ClientError::Refused(Refusal::NotSigned)) => {}
            other => other?,
        }
        Ok(answers)
    }

    /// Fails if answers differ from the host's; `other` lists the lines of their rows.
    fn refuse_other_bits(&self, other: &[usize]) -> Result<(), Failure> {
        let Some(first) = other.first() else {
            return Ok(());
        };
        Err(Failure::Quality(format!(
            "{} of {} answers differ from the host's bits, the first for line {} of {}\nhelp: device and trainer are \
             of different versions, or the device is broken",
            other.len(),
            self.samples.len(),
            self.set.measurements[*first].line,
            self.set.path.display()
        )))
    }

    /// Prints the flagged rows of each remark, and the longest time for an answer.
    fn report_rows(&self, report: Printer, statuses: &[Status], max_ticks: u32) {
        let mut seen: Vec<Status> = Vec::new();
        for status in statuses.iter().filter(|status| !status.is_ok()) {
            if seen.contains(status) {
                continue;
            }
            seen.push(*status);
            let rows = statuses.iter().zip(&self.set.measurements);
            let lines: Vec<usize> = rows
                .filter(|(other, _)| *other == status)
                .map(|(_, m)| m.line)
                .collect();
            report.line(format_args!(
                "{} of {} are flagged `{status}`: lines {}.",
                lines.len(),
                statuses.len(),
                some_of(&lines, SHOWN)
            ));
        }
        report.line(format_args!(
            "The longest took {max_ticks} ticks, {:.3} ms; the deadline is {:.3} ms.",
            show::milliseconds(max_ticks, self.identity.tick_hz),
            show::milliseconds(self.identity.deadline_ticks, self.identity.tick_hz)
        ));
    }
}

/// Largest number of lines that one remark lists.
const SHOWN: usize = 10;

/// Creates the request that a controller would send for a sample.
pub fn query(sample: &InstrumentSample) -> Query {
    Query {
        // Fits: a measurement file has at most as many joints as the protocol.
        joints: sample.joints.iter().map(|q| *q as f32).collect(),
        payload_kg: sample.payload_kg.unwrap_or(0.0) as f32,
    }
}

/// Reads the file without a blob: the only arm to check it against is then the one on the device.
fn read_without_blob(test: &Path) -> Result<(MeasurementSet, Vec<InstrumentSample>), Failure> {
    let set = measurements::read(test)?;
    for note in &set.notes {
        crate::cli::terminal::print::note(format_args!("{}: {note}", test.display()));
    }
    let mut names = Vec::new();
    let robot = Robot {
        name: String::new(),
        joints: Vec::new(),
        parent_from_joint: Vec::new(),
        coupling: None,
        link_radius: None,
        prior: None,
    };
    let samples = poegp_calibration::measurement::sample::samples(&set, &robot, &mut names)?;
    if names.len() > 1 {
        return Err(InputError::new(
            test,
            format!("{} sessions and targets", names.len()),
            "one: the device has only one tool",
        )
        .with_help("give --blob, which has the others")
        .into());
    }
    Ok((set, samples))
}

pub fn evaluate(a: &Evaluate) -> Result<(), Failure> {
    let outputs = [(a.common.json.as_deref(), Kind::Json)];
    let mut inputs = vec![a.test.as_path()];
    inputs.extend(a.blob.as_deref());
    let outputs = check_outputs(&outputs, &inputs)?;
    let mut commands = Commands::read(&a.common.link, &a.test, a.blob.as_deref())?;
    if commands.loaded.is_none() {
        enough_for_a_base(&a.test, &commands.samples)?;
    }
    let answers = commands.ask("evaluating", Client::evaluate)?;
    let poses = placed(&commands, &answers);
    let errors: Vec<PoseError> = poses
        .iter()
        .zip(&commands.samples)
        .map(|(pose, sample)| sample.observation.error(pose))
        .collect();
    let other = other_poses(&commands, &answers);
    commands.refuse_other_bits(&other)?;
    let statuses = answers.iter().map(|a| Status::from_bits(a.status));
    let statuses: Vec<Status> = statuses.collect();
    let model = commands.identity.model.as_ref();
    let document = StreamJson {
        version: env!("CARGO_PKG_VERSION"),
        model: model.map(show::model_json).into(),
        name: file_name(&a.test),
        errors: ErrorSummary::new(&errors),
        flagged: statuses.iter().filter(|status| !status.is_ok()).count(),
        max_ticks: answers.iter().map(|a| a.ticks).max().unwrap_or(0),
        tick_hz: commands.identity.tick_hz,
        same_bits: commands.loaded.is_some().then_some(answers.len()),
    };
    let json = json_text(&document)?;
    write_texts(&[(a.common.json.as_deref(), Some(&json))])?;
    let report = Printer::for_outputs(&outputs);
    print(report, &document, &show::active(&commands.identity));
    commands.report_rows(report, &statuses, document.max_ticks);
    match document.same_bits {
        Some(count) => report.line(format_args!(
            "All {count} answers are the host's, bit for bit."
        )),
        None => report.line(
            "The device's base frame was fitted to the measurements, which makes the errors look slightly smaller; \
            --blob gives \
             the calibrated one.",
        ),
    }
    Ok(())
}

/// Least number of different poses to which a base frame is fitted: it has six unknowns, and as many numbers are to spare.
const POSES_FOR_A_BASE: usize = 4;
/// Distance from a line, in m, that some positions must have: on a line they do not determine the rotation of the base
/// frame about it.
const WIDTH: f64 = 0.01;

/// Refuses measurements that do not determine the base frame with some left to compare.
fn enough_for_a_base(test: &Path, samples: &[InstrumentSample]) -> Result<(), Failure> {
    let positions = samples.iter().map(|s| s.observation.position());
    let from_first: Vec<Vector3<f64>> = positions
        .map(|p| p - samples[0].observation.position())
        .collect();
    let farthest = from_first
        .iter()
        .max_by(|a, b| a.norm().total_cmp(&b.norm()));
    let along = farthest
        .and_then(|p| p.try_normalize(0.0))
        .unwrap_or_else(Vector3::x);
    let width = from_first.iter().map(|p| p.cross(&along).norm());
    let found = match different_poses(samples) {
        poses if poses < POSES_FOR_A_BASE => format!("{poses} different poses"),
        _ if width.fold(0.0, f64::max) < WIDTH => "positions on a line".to_owned(),
        _ => return Ok(()),
    };
    let expected = format!(
        "at least {POSES_FOR_A_BASE} different poses, not on a line: the device's base frame is fitted to them"
    );
    Err(InputError::new(test, found, expected)
        .with_help("give --blob, which has the base frame")
        .into())
}

fn print(report: Printer, document: &StreamJson, model: &str) {
    report.line(format_args!(
        "The device on {} poses, model {model}: position in mm, orientation in mrad.\n",
        document.errors.poses
    ));
    let mut rows = vec![error_row("position", &document.errors.position_mm)];
    let orientation = document.errors.orientation_mrad.as_ref();
    rows.extend(orientation.map(|s| error_row("orientation", s)));
    report.table(&["error", "mean", "p95", "max"], &rows);
}

/// Returns the device's poses in the frame of the instrument.
fn placed(commands: &Commands, answers: &[Evaluation]) -> Vec<Pose<f64>> {
    let in_base = answers.iter().map(|a| Pose::<f32>::from_rows(&a.pose));
    let Some(loaded) = &commands.loaded else {
        let poses: Vec<Pose<f64>> = in_base.map(|pose| pose.cast()).collect();
        let from: Vec<Vector3<f64>> = poses.iter().map(|p| p.translation).collect();
        let samples = commands.samples.iter();
        let to: Vec<Vector3<f64>> = samples.map(|s| s.observation.position()).collect();
        let instrument_from_base = aligned(&from, &to);
        return poses.iter().map(|p| instrument_from_base * *p).collect();
    };
    in_base
        .zip(&commands.samples)
        .map(|(pose, sample)| {
            let first = loaded.in_instrument(&pose);
            match loaded.tools().get(sample.tool) {
                Some((_, first_from_target)) if sample.tool > 0 => first * *first_from_target,
                _ => first,
            }
        })
        .collect()
}

/// Lists the rows whose pose, correction, status, trust or standard deviation differs from what the host computes.
fn other_poses(commands: &Commands, answers: &[Evaluation]) -> Vec<usize> {
    let Some(loaded) = &commands.loaded else {
        return Vec::new();
    };
    let differs = |i: &usize| {
        let (query, answer) = (query(&commands.samples[*i]), &answers[*i]);
        let here = loaded.model().evaluate(&query.joints, query.payload_kg);
        here.pose.to_rows().map(f32::to_bits) != answer.pose.map(f32::to_bits)
            || here.correction.to_array().map(f32::to_bits) != answer.correction.map(f32::to_bits)
            || here.status.bits() != answer.status
            || here.trust.to_bits() != answer.trust.to_bits()
            || here.position_sigma.map(f32::to_bits) != answer.position_sigma.map(f32::to_bits)
    };
    (0..answers.len()).filter(differs).collect()
}

pub fn correct(a: &Correct) -> Result<(), Failure> {
    let mut inputs = vec![a.test.as_path()];
    inputs.extend(a.blob.as_deref());
    let outputs = [
        (Some(a.out.as_path()), Kind::Targets),
        (a.json.as_deref(), Kind::Json),
    ];
    let outputs = check_outputs(&outputs, &inputs)?;
    let mut commands = Commands::read(&a.link, &a.test, a.blob.as_deref())?;
    let answers = commands.ask("correcting", Client::correct)?;
    let differs = |i: &usize| {
        let (query, answer) = (query(&commands.samples[*i]), &answers[*i]);
        let Some(loaded) = &commands.loaded else {
            return false;
        };
        // A bypassed command does not come from the model.
        if Status::from_bits(answer.status).contains(Status::BYPASSED) {
            return false;
        }
        let here = loaded.model().correct(&query.joints, query.payload_kg);
        let bits = |value: &f32| value.to_bits();
        let joints = here.joints.iter().take(query.joints.len());
        !joints.map(bits).eq(answer.joints.iter().map(bits)) || here.status.bits() != answer.status
    };
    let other: Vec<usize> = (0..answers.len()).filter(differs).collect();
    commands.refuse_other_bits(&other)?;

    let columns = &commands.set.joint_columns;
    let names: Vec<&str> = columns.iter().map(|c| c.name.as_str()).collect();
    let mut csv = names.join(",") + ",position_error_um,status\n";
    let mut change = 0.0_f64;
    for (answer, sample) in answers.iter().zip(&commands.samples) {
        let joints = answer.joints.iter().zip(columns);
        for ((q, column), commanded) in joints.zip(query(sample).joints) {
            change = change.max(f64::from((q - commanded).abs()));
            let _ = write!(csv, "{:.8},", column.unit.from_si(f64::from(*q)));
        }
        let status = Status::from_bits(answer.status);
        let _ = writeln!(csv, "{:.3},{status}", 1e6 * answer.position_error);
    }
    let statuses = answers.iter().map(|a| Status::from_bits(a.status));
    let statuses: Vec<Status> = statuses.collect();
    let max_ticks = answers.iter().map(|a| a.ticks).max().unwrap_or(0);
    let json = summary_text(serde_json::json!({
        "model": commands.identity.model.as_ref().map(show::model_json),
        "name": file_name(&a.test),
        "commands": answers.len(),
        "flagged": statuses.iter().filter(|status| !status.is_ok()).count(),
        "max_change": change,
        "max_ticks": max_ticks,
        "tick_hz": commands.identity.tick_hz,
        "same_bits": commands.loaded.is_some().then_some(answers.len()),
    }))?;
    write_texts(&[(Some(&a.out), Some(&csv)), (a.json.as_deref(), Some(&json))])?;
    let report = Printer::for_outputs(&outputs);
    if !is_stdout(&a.out) {
        report.line(format_args!(
            "Wrote {} ({} commands).",
            a.out.display(),
            answers.len()
        ));
    }
    report.line(format_args!(
        "Model {}; joints changed by at most {:.3} mrad or mm.",
        show::active(&commands.identity),
        1e3 * change
    ));
    commands.report_rows(report, &statuses, max_ticks);
    if commands.loaded.is_some() {
        report.line(format_args!(
            "All {} answers are the host's, bit for bit.",
            answers.len()
        ));
    }
    Ok(())
}
