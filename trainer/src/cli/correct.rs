//! `trainer correct`: a file of joint targets in, the joints to command instead out, by the device's own function.

use std::path::{Path, PathBuf};

use clap::Args;
use poegp_protocol::JointKind;
use poegp_protocol::link::Query;
use poegp_runtime::correct::Corrected;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;
use poegp_runtime::model::MAX_PAYLOAD_KG;
use serde::Serialize;

use crate::cli::failure::Failure;
use crate::cli::inputs;
use crate::cli::inputs::file_name;
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::{Printer, is_stdout};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::joint_targets::{RewrittenRow, TargetFile};
use poegp_calibration::measurement::{JointUnit, MeasurementSet};
use poegp_calibration::numeric::statistics::Summary;

/// The columns that are added.
const ADDED: [&str; 5] = [
    "position_error_um",
    "rotation_error_urad",
    "applied",
    "status",
    "trust",
];
/// Trust below this is far from the training data: less than half of the correction's prior is explained there.
const TRUSTED: f32 = 0.5;
/// Line numbers in one remark.
const SHOWN: usize = 10;

/// `trainer correct`.
#[derive(Debug, Args)]
#[command(
    after_help = "Only the joint columns change. Five columns are added: position_error_um \
    and rotation_error_urad (what stays by the model), applied (how much of the arm's error is corrected, 0 to 1), status (ok, \
    or why not), trust (1 within the trained ranges, towards 0 far from them). Each row is corrected on its own, as the device \
    does before its filter: beside a singularity only in part, so that neighbouring rows stay neighbours.\n\n\
    Example: trainer correct arm.blob program.csv --payload-kg 2.5 --out corrected.csv"
)]
pub struct Correct {
    /// Model (`.blob`).
    pub blob: PathBuf,
    /// Joint targets (CSV): q1_deg … (or _rad, _mm, _m), optionally payload_kg; other columns are kept.
    pub targets: PathBuf,
    /// Payload of all rows in kg, for a file without payload_kg.
    #[arg(long, value_name = "KG", allow_negative_numbers = true)]
    pub payload_kg: Option<f64>,
    /// Write the corrected targets (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Write the summary as JSON (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Serialize)]
struct CorrectJson<'a> {
    version: &'static str,
    method: &'a str,
    name: String,
    commands: usize,
    /// Brought to where the nominal arm would stand.
    corrected: usize,
    /// Changed, but not all the way.
    partly_corrected: usize,
    /// Exactly as they came.
    left_alone: usize,
    /// Of each note, the lines of the rows that have it.
    flagged: Vec<Flagged>,
    /// The largest change of a revolute joint.
    #[serde(skip_serializing_if = "Option::is_none")]
    largest_change_deg: Option<Change>,
    /// The largest change of a prismatic joint.
    #[serde(skip_serializing_if = "Option::is_none")]
    largest_change_mm: Option<Change>,
    /// How far the arm stands from its target when the commands are not corrected, by the model.
    shift_mm: Summary,
    /// The same with the corrected commands, by the model.
    remaining_um: Summary,
    trust: TrustSummary,
    /// Lines of rows whose corrected joints are beyond a limit that the commanded ones kept.
    beyond_limits: Vec<usize>,
}

#[derive(Serialize)]
struct Flagged {
    status: String,
    lines: Vec<usize>,
}

#[derive(Serialize)]
struct Change {
    value: f64,
    column: String,
    line: usize,
}

#[derive(Serialize)]
struct TrustSummary {
    mean: f32,
    least: f32,
    /// Lines of rows that are far from the training data.
    far_lines: Vec<usize>,
}

/// One command and its answer.
struct Row {
    line: usize,
    query: Query,
    answer: Corrected<f32>,
    /// Distance of the uncorrected arm from the target, m.
    shift: f64,
    trust: f32,
}

impl Row {
    fn is_changed(&self, joint: usize) -> bool {
        self.answer.joints[joint].to_bits() != self.query.joints[joint].to_bits()
    }

    fn left_alone(&self) -> bool {
        (0..self.query.joints.len()).all(|joint| !self.is_changed(joint))
    }

    fn arrived(&self) -> bool {
        let not = [Status::PARTLY_CORRECTED, Status::BAD_INPUT];
        !not.iter().any(|s| self.answer.status.contains(*s))
    }
}

pub fn run(a: &Correct) -> Result<(), Failure> {
    let outputs = [Some(a.out.as_path()), a.json.as_deref()];
    check_outputs(&outputs, &[&a.blob, &a.targets])?;
    let loaded = BlobModel::read(&a.blob)?;
    let file = TargetFile::read(&a.targets)?;
    let robot = inputs::robot_of(loaded.blob());
    for note in file.check(&robot)? {
        crate::cli::terminal::print::note(format_args!("{}: {note}", a.targets.display()));
    }
    file.refuse_columns(
        &ADDED,
        "this file was corrected already: correct the original, or take these columns out",
    )?;
    let set = file.set();
    let payloads = payloads(a, &loaded, set)?;
    let rows: Vec<Row> = set
        .measurements
        .iter()
        .zip(payloads)
        .map(|(m, payload_kg)| correct(&loaded, m.line, &m.joints, payload_kg))
        .collect();
    let document = document(a, &loaded, set, &rows);
    let csv = file.rewritten(
        &ADDED,
        &rows.iter().map(|r| rewritten(set, r)).collect::<Vec<_>>(),
    );
    let json = json_text(&document)?;
    let mut files: Vec<(&Path, &[u8])> = vec![(&a.out, csv.as_bytes())];
    files.extend(a.json.as_deref().map(|path| (path, json.as_bytes())));
    write_outputs(&files)?;
    print(Printer::for_outputs(&outputs), a, &document);
    Ok(())
}

/// The payload of every row, from the file or the command line, never from both.
fn payloads(a: &Correct, loaded: &BlobModel, set: &MeasurementSet) -> Result<Vec<f64>, Failure> {
    let needed = loaded.blob().ranges.payload_kg;
    match (a.payload_kg, set.has_payload()) {
        (Some(_), true) => Err(Failure::Usage(format!(
            "--payload-kg beside the column payload_kg of {}\nhelp: give one of them",
            set.path.display()
        ))),
        (Some(kg), _) if !(0.0..=f64::from(MAX_PAYLOAD_KG)).contains(&kg) => Err(Failure::Usage(
            format!("--payload-kg {kg}: expected kilograms, 0 or more"),
        )),
        (None, false) if needed.is_some() => {
            let (light, heavy) = needed.unwrap_or_default();
            Err(InputError::new(
                &set.path,
                "no payload_kg column",
                format!(
                    "one: the model depends on the payload ({light} to {heavy} kg were trained)"
                ),
            )
            .with_help("give --payload-kg KG when all rows have the same payload")
            .into())
        }
        (given, _) => Ok(set
            .measurements
            .iter()
            .map(|m| m.payload_kg.or(given).unwrap_or(0.0))
            .collect()),
    }
}

/// One command through the runtime, as the device does it.
fn correct(loaded: &BlobModel, line: usize, joints: &[f64], payload_kg: f64) -> Row {
    let query = Query {
        // The robot of the blob has at most as many joints as the protocol.
        joints: joints.iter().map(|q| *q as f32).collect(),
        payload_kg: payload_kg as f32,
    };
    let model = loaded.model();
    let answer = model.correct(&query.joints, query.payload_kg);
    let now = model.evaluate(&query.joints, query.payload_kg);
    let apart = |target: Pose<f32>| {
        let (a, b) = (target.translation, now.pose.translation);
        (a.map(f64::from) - b.map(f64::from)).norm()
    };
    Row {
        line,
        answer,
        shift: model.nominal(&query.joints).map_or(0.0, apart),
        trust: now.trust,
        query,
    }
}

/// The new fields of a row. A joint that was not changed keeps its text.
fn rewritten(set: &MeasurementSet, row: &Row) -> RewrittenRow {
    let joints = set.joint_columns.iter().enumerate();
    let field = |(joint, column): (usize, &poegp_calibration::measurement::JointColumn)| {
        let value = column.unit.from_si(f64::from(row.answer.joints[joint]));
        row.is_changed(joint).then(|| format!("{value:.10}"))
    };
    RewrittenRow {
        joints: joints.map(field).collect(),
        added: vec![
            format!("{:.3}", 1e6 * row.answer.position_error),
            format!("{:.3}", 1e6 * row.answer.rotation_error),
            format!("{:.4}", row.answer.applied),
            row.answer.status.to_string(),
            format!("{:.6}", row.trust),
        ],
    }
}

fn document<'a>(
    a: &Correct,
    loaded: &'a BlobModel,
    set: &MeasurementSet,
    rows: &[Row],
) -> CorrectJson<'a> {
    let blob = loaded.blob();
    let count = |wanted: &dyn Fn(&Row) -> bool| rows.iter().filter(|r| wanted(r)).count();
    let lines = |wanted: &dyn Fn(&Row) -> bool| -> Vec<usize> {
        rows.iter().filter(|r| wanted(r)).map(|r| r.line).collect()
    };
    let remarks = [
        Status::PARTLY_CORRECTED,
        Status::CORRECTION_LIMITED,
        Status::OUTSIDE_JOINT_RANGE,
        Status::OUTSIDE_PAYLOAD_RANGE,
        Status::BAD_INPUT,
    ];
    let flagged = remarks.iter().map(|status| Flagged {
        status: status.to_string(),
        lines: lines(&|r| r.answer.status.contains(*status)),
    });
    let beyond = |joints: &[f32]| {
        blob.robot.joints.iter().zip(joints).any(|(joint, q)| {
            let (lower, upper) = joint.limits.unwrap_or((f32::MIN, f32::MAX));
            *q < lower || *q > upper
        })
    };
    CorrectJson {
        version: env!("CARGO_PKG_VERSION"),
        method: loaded.host().provenance.method,
        name: file_name(&a.targets),
        commands: rows.len(),
        corrected: count(&Row::arrived),
        partly_corrected: count(&|r| !r.arrived() && !r.left_alone()),
        left_alone: count(&|r| !r.arrived() && r.left_alone()),
        flagged: flagged.filter(|f| !f.lines.is_empty()).collect(),
        largest_change_deg: largest_change(set, rows, JointKind::Revolute),
        largest_change_mm: largest_change(set, rows, JointKind::Prismatic),
        shift_mm: summary(rows, |r| 1e3 * r.shift),
        remaining_um: summary(rows, |r| 1e6 * f64::from(r.answer.position_error)),
        trust: TrustSummary {
            mean: rows.iter().map(|r| r.trust).sum::<f32>() / rows.len().max(1) as f32,
            least: rows.iter().map(|r| r.trust).fold(1.0, f32::min),
            far_lines: lines(&|r| r.trust < TRUSTED),
        },
        beyond_limits: lines(&|r| {
            let answer = &r.answer.joints[..r.query.joints.len()];
            beyond(answer) && !beyond(&r.query.joints)
        }),
    }
}

fn summary(rows: &[Row], of: impl Fn(&Row) -> f64) -> Summary {
    Summary::new(&rows.iter().map(of).collect::<Vec<_>>())
}

/// In degrees or millimetres; `None` without joints of this kind.
fn largest_change(set: &MeasurementSet, rows: &[Row], kind: JointKind) -> Option<Change> {
    let unit = match kind {
        JointKind::Revolute => JointUnit::Degree,
        JointKind::Prismatic => JointUnit::Millimetre,
    };
    let of_kind = |joint: &usize| {
        let turns = matches!(
            set.joint_columns[*joint].unit,
            JointUnit::Degree | JointUnit::Radian
        );
        turns == (kind == JointKind::Revolute)
    };
    let changes = rows.iter().flat_map(|row| {
        let joints = (0..set.joint_columns.len()).filter(of_kind);
        joints.map(move |joint| {
            let (to, from) = (row.answer.joints[joint], row.query.joints[joint]);
            Change {
                value: unit.from_si(f64::from(to) - f64::from(from)).abs(),
                column: set.joint_columns[joint].name.clone(),
                line: row.line,
            }
        })
    });
    changes.max_by(|a, b| a.value.total_cmp(&b.value))
}

/// What a remark means for the commands that have it.
fn meaning(status: &str) -> &'static str {
    match status {
        "partly-corrected" => {
            "corrected in part: beside a singularity, where a full correction would move joints too quickly"
        }
        "correction-limited" => "corrected by no more than the bound of the blob",
        "outside-joint-range" => "corrected by an extrapolation: joints beyond what was trained",
        "outside-payload-range" => {
            "corrected by an extrapolation: a payload beyond what was trained"
        }
        _ => "left as they are: numbers beyond all reason",
    }
}

fn print(report: Printer, a: &Correct, d: &CorrectJson) {
    if !is_stdout(&a.out) {
        report.line(format_args!(
            "Wrote {} ({} commands).",
            a.out.display(),
            d.commands
        ));
    }
    report.line(format_args!(
        "Model `{}`: {} corrected, {} in part, {} left as they are.",
        d.method, d.corrected, d.partly_corrected, d.left_alone
    ));
    for change in [(&d.largest_change_deg, "°"), (&d.largest_change_mm, " mm")] {
        if let (Some(c), unit) = change {
            report.line(format_args!(
                "Joints changed by at most {:.4}{unit} ({}, line {}).",
                c.value, c.column, c.line
            ));
        }
    }
    let s = &d.shift_mm;
    report.line(format_args!(
        "Uncorrected, the target would be off by {:.3} mm in the mean, {:.3} mm for 95 % and {:.3} mm at most; corrected, by \
         the model, by {:.2} µm in the mean and {:.2} µm at most.",
        s.mean, s.p95, s.max, d.remaining_um.mean, d.remaining_um.max
    ));
    for flagged in &d.flagged {
        report.line(format_args!(
            "{} of {} are flagged `{}`, {}: {}.",
            flagged.lines.len(),
            d.commands,
            flagged.status,
            meaning(&flagged.status),
            listed(&flagged.lines)
        ));
    }
    if !d.trust.far_lines.is_empty() {
        report.line(format_args!(
            "{} are far from the training data (trust below {TRUSTED}, {:.3} at least): {}.",
            d.trust.far_lines.len(),
            d.trust.least,
            listed(&d.trust.far_lines)
        ));
    }
    if !d.beyond_limits.is_empty() {
        report.line(format_args!(
            "warning: {} are beyond a joint limit only once corrected: {}.",
            d.beyond_limits.len(),
            listed(&d.beyond_limits)
        ));
    }
}

/// "line 4", "lines 4, 7, …".
fn listed(lines: &[usize]) -> String {
    let shown: Vec<String> = lines.iter().take(SHOWN).map(ToString::to_string).collect();
    let more = if lines.len() > SHOWN { ", …" } else { "" };
    let word = if lines.len() == 1 { "line" } else { "lines" };
    format!("{word} {}{more}", shown.join(", "))
}
