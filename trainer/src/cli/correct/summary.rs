//! The summary of all corrected commands.

use std::path::Path;

use poegp_protocol::blob::{Blob, Joint};
use poegp_runtime::guard::status::Status;
use serde::Serialize;

use crate::cli::correct::row::Row;
use crate::cli::terminal::print::{Printer, is_stdout};
use crate::cli::terminal::warnings::WARNING;
use crate::robot_programs::correction::engine::TRUSTED;
use poegp_calibration::input_error::some_of;
use poegp_calibration::measurement::{JointColumn, JointUnit};
use poegp_calibration::numeric::statistics::Summary;

/// Largest number of lines that one remark lists.
const SHOWN: usize = 10;

/// The JSON document that `--json` writes.
#[derive(Serialize)]
pub struct CorrectJson<'a> {
    version: &'static str,
    method: &'a str,
    name: String,
    commands: usize,
    /// Number of commands that bring the arm to where the nominal arm would stand.
    corrected: usize,
    /// Number of commands that were changed, but not corrected completely.
    partly_corrected: usize,
    /// Number of commands that were not changed at all.
    uncorrected: usize,
    /// Remarks, each with the lines of the rows that it applies to.
    flagged: Vec<Flagged>,
    /// Largest change of a revolute joint.
    #[serde(skip_serializing_if = "Option::is_none")]
    largest_change_deg: Option<Change>,
    /// Largest change of a prismatic joint.
    #[serde(skip_serializing_if = "Option::is_none")]
    largest_change_mm: Option<Change>,
    /// Distance of the arm from its targets when the commands are not corrected, predicted by the model.
    shift_mm: Summary,
    /// Rotation between the arm and its targets when the commands are not corrected, predicted by the model.
    shift_mrad: Summary,
    /// Distance of the arm from its targets with the corrected commands, predicted by the model.
    remaining_um: Summary,
    /// Rotation between the arm and its targets with the corrected commands, predicted by the model.
    remaining_mrad: Summary,
    trust: TrustSummary,
    /// Lines of rows whose corrected joints exceed a limit that the original command kept.
    beyond_limits: Vec<u32>,
}

#[derive(Serialize)]
struct Flagged {
    status: String,
    lines: Vec<u32>,
}

#[derive(Serialize)]
struct Change {
    value: f64,
    column: String,
    line: u32,
}

#[derive(Serialize)]
struct TrustSummary {
    mean: f32,
    least: f32,
    /// Lines of rows that are far from the training data.
    far_lines: Vec<u32>,
}

/// Remarks that are counted; the index of each is its bit in [`Summed::flags`].
const REMARKS: [Status; 5] = [
    Status::PARTLY_CORRECTED,
    Status::CORRECTION_LIMITED,
    Status::OUTSIDE_JOINT_RANGE,
    Status::OUTSIDE_PAYLOAD_RANGE,
    Status::BAD_INPUT,
];
const FAR: u8 = 1 << 5;
const BEYOND_LIMITS: u8 = 1 << 6;
const LEFT_ALONE: u8 = 1 << 7;

/// Running sums of the rows so far; they keep 21 bytes of each row.
#[derive(Default)]
pub struct Summed {
    lines: Vec<u32>,
    flags: Vec<u8>,
    /// Errors of the uncorrected commands: position in m and rotation in rad.
    shifts: [Vec<f32>; 2],
    /// Remaining errors of the corrected commands: position in m and rotation in rad.
    remaining: [Vec<f32>; 2],
    trust_sum: f64,
    least_trust: Option<f32>,
    /// Largest change of a revolute joint in degrees and of a prismatic joint in mm, each with the joint's index
    /// and the line.
    largest: [Option<(f64, usize, u32)>; 2],
}

impl Summed {
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    /// Appends the sums of later rows.
    pub fn extend(&mut self, later: Self) {
        self.lines.extend(later.lines);
        self.flags.extend(later.flags);
        for (all, later) in self.shifts.iter_mut().zip(later.shifts) {
            all.extend(later);
        }
        for (all, later) in self.remaining.iter_mut().zip(later.remaining) {
            all.extend(later);
        }
        self.trust_sum += later.trust_sum;
        let least = [self.least_trust, later.least_trust];
        self.least_trust = least.into_iter().flatten().reduce(f32::min);
        for (largest, later) in self.largest.iter_mut().zip(later.largest) {
            *largest = larger(*largest, later);
        }
    }

    fn count(&self, wanted: impl Fn(u8) -> bool) -> usize {
        self.flags.iter().filter(|flags| wanted(**flags)).count()
    }

    /// Returns the lines of the rows that have a flag.
    fn lines_with(&self, flag: u8) -> Vec<u32> {
        let rows = self.lines.iter().zip(&self.flags);
        rows.filter(|(_, flags)| **flags & flag != 0)
            .map(|(line, _)| *line)
            .collect()
    }
}

/// Returns the larger change; of equal changes the later one.
fn larger(a: Option<(f64, usize, u32)>, b: Option<(f64, usize, u32)>) -> Option<(f64, usize, u32)> {
    match (a, b) {
        (Some(a), Some(b)) if a.0.total_cmp(&b.0).is_gt() => Some(a),
        (a, b) => b.or(a),
    }
}

/// The joints and columns that are needed to sum rows up.
pub struct Summing<'a> {
    joints: &'a [Joint],
    columns: &'a [JointColumn],
}

impl<'a> Summing<'a> {
    /// Creates a summing for the robot of a blob and the columns of a file.
    pub fn new(blob: &'a Blob<'_>, columns: &'a [JointColumn]) -> Self {
        Self {
            joints: &blob.robot.joints,
            columns,
        }
    }

    pub fn add(&self, sum: &mut Summed, row: &Row) {
        let (query, answer) = (&row.query.joints, &row.answer);
        let line = u32::try_from(row.line).unwrap_or(u32::MAX);
        let mut flags = 0;
        for (bit, remark) in REMARKS.iter().enumerate() {
            flags |= u8::from(answer.status.contains(*remark)) << bit;
        }
        let beyond = |joints: &[f32]| {
            self.joints.iter().zip(joints).any(|(joint, q)| {
                let (lower, upper) = joint.limits.unwrap_or((f32::MIN, f32::MAX));
                *q < lower || *q > upper
            })
        };
        let mut flag = |bit: u8, is_set: bool| flags |= if is_set { bit } else { 0 };
        flag(FAR, f64::from(row.trust) < TRUSTED);
        flag(
            BEYOND_LIMITS,
            beyond(&answer.joints[..query.len()]) && !beyond(query),
        );
        flag(
            LEFT_ALONE,
            !(0..query.len()).any(|joint| row.is_changed(joint)),
        );
        sum.lines.push(line);
        sum.flags.push(flags);
        for (all, shift) in sum.shifts.iter_mut().zip(row.shift) {
            all.push(shift);
        }
        sum.remaining[0].push(answer.position_error);
        sum.remaining[1].push(answer.rotation_error);
        sum.trust_sum += f64::from(row.trust);
        sum.least_trust = Some(sum.least_trust.map_or(row.trust, |t| t.min(row.trust)));
        for (joint, column) in self.columns.iter().enumerate() {
            let (kind, unit) = match column.unit {
                JointUnit::Degree | JointUnit::Radian => (0, JointUnit::Degree),
                JointUnit::Millimetre | JointUnit::Metre => (1, JointUnit::Millimetre),
            };
            let (to, from) = (answer.joints[joint], query[joint]);
            let value = unit.from_si(f64::from(to) - f64::from(from)).abs();
            sum.largest[kind] = larger(sum.largest[kind], Some((value, joint, line)));
        }
    }

    /// Creates the summary of all rows.
    pub fn document<'m>(&self, name: String, method: &'m str, all: Summed) -> CorrectJson<'m> {
        let not_arrived = [Status::PARTLY_CORRECTED, Status::BAD_INPUT];
        let bits = (0..REMARKS.len()).filter(|bit| not_arrived.contains(&REMARKS[*bit]));
        let not_arrived = bits.fold(0, |bits, bit| bits | 1 << bit);
        let arrived = |flags: u8| flags & not_arrived == 0;
        let flagged = REMARKS.iter().enumerate().map(|(bit, status)| Flagged {
            status: status.to_string(),
            lines: all.lines_with(1 << bit),
        });
        let change = |kind: usize| {
            all.largest[kind].map(|(value, joint, line)| Change {
                value,
                column: self.columns[joint].name.clone(),
                line,
            })
        };
        let summary = |errors: &[f32], factor: f64| {
            let scaled = errors.iter().map(|e| factor * f64::from(*e));
            Summary::new(&scaled.collect::<Vec<_>>())
        };
        CorrectJson {
            version: env!("CARGO_PKG_VERSION"),
            method,
            name,
            commands: all.lines.len(),
            corrected: all.count(arrived),
            partly_corrected: all.count(|f| !arrived(f) && f & LEFT_ALONE == 0),
            uncorrected: all.count(|f| !arrived(f) && f & LEFT_ALONE != 0),
            flagged: flagged.filter(|f| !f.lines.is_empty()).collect(),
            largest_change_deg: change(0),
            largest_change_mm: change(1),
            shift_mm: summary(&all.shifts[0], 1e3),
            shift_mrad: summary(&all.shifts[1], 1e3),
            remaining_um: summary(&all.remaining[0], 1e6),
            remaining_mrad: summary(&all.remaining[1], 1e3),
            trust: TrustSummary {
                mean: (all.trust_sum / all.lines.len().max(1) as f64) as f32,
                least: all.least_trust.unwrap_or(1.0),
                far_lines: all.lines_with(FAR),
            },
            beyond_limits: all.lines_with(BEYOND_LIMITS),
        }
    }
}

/// Explains what a remark means for the commands that have it.
fn meaning(status: &str) -> &'static str {
    match status {
        "partly-corrected" => {
            "corrected in part: near a singularity, where a full correction would move joints too quickly"
        }
        "correction-limited" => "corrected by no more than the bound of the blob",
        "outside-joint-range" => "corrected by extrapolation: joints outside the trained ranges",
        "outside-payload-range" => {
            "corrected by extrapolation: a payload outside the trained range"
        }
        _ => "left as they are: implausible joints or payload",
    }
}

pub fn print(report: Printer, out: &Path, d: &CorrectJson) {
    if !is_stdout(out) {
        report.line(format_args!(
            "Wrote {} ({} commands).",
            out.display(),
            d.commands
        ));
    }
    report.line(format_args!(
        "Model `{}`: {} corrected, {} in part, {} left as they are.",
        d.method, d.corrected, d.partly_corrected, d.uncorrected
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
        "According to the model, the target is off by {:.3} mm on average, {:.3} mm for 95 % and {:.3} mm at most if \
         uncorrected; by {} on average and {} at most if corrected.",
        s.mean,
        s.p95,
        s.max,
        short_length(d.remaining_um.mean),
        short_length(d.remaining_um.max)
    ));
    let (s, left) = (&d.shift_mrad, &d.remaining_mrad);
    report.line(format_args!(
        "Its orientation is off by {:.3} mrad on average, {:.3} mrad for 95 % and {:.3} mrad at most if uncorrected; by \
         {:.3} mrad on average and {:.3} mrad at most if corrected.",
        s.mean, s.p95, s.max, left.mean, left.max
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
    if let Some(text) = beyond_limits(d) {
        report.line(format_args!("{WARNING}{text}"));
    }
}

/// Formats a length in micrometres, or in millimetres from 0.1 mm on.
pub fn short_length(um: f64) -> String {
    if um < 100.0 {
        format!("{um:.2} µm")
    } else {
        format!("{:.3} mm", 1e-3 * um)
    }
}

/// Warns of joints that the correction moves beyond a limit.
pub fn beyond_limits(d: &CorrectJson) -> Option<String> {
    let commands = (!d.beyond_limits.is_empty()).then_some(&d.beyond_limits)?;
    Some(format!(
        "the correction moves joints beyond a limit in {} of the commands: {}.",
        commands.len(),
        listed(commands)
    ))
}

/// Formats line numbers: "line 4", "lines 4, 7, …".
fn listed(lines: &[u32]) -> String {
    let word = if lines.len() == 1 { "line" } else { "lines" };
    format!("{word} {}", some_of(lines, SHOWN))
}
