//! The output of `trainer measure`: lines for a person, and one JSON document per line for a program.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::planning::next::Next;
use poegp_calibration::planning::next::outlook::Outlook;
use poegp_calibration::validation::model_selection::FEW_FACTOR;
use poegp_protocol::JointKind;

use crate::cli::failure::Failure;
use crate::cli::inputs::Arm;
use crate::cli::measure::journal::OnDisk;
use crate::cli::measure::plan::Asked;
use crate::cli::terminal::print::{Printer, is_stdout, note, to_stdout};
use crate::cli::terminal::snippet;

/// Share of the error from which on a row's forecast is shown before the rows are enough for a fit.
const LEAST: f64 = 0.01;

/// The reason why a measurement ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The expected error is small enough.
    Within,
    /// Every row of the plan was measured or left out.
    UsedUp,
    /// No more rows come.
    NoMore,
}

/// Returns which rows are kept, with the verb.
pub fn kept(rows: usize) -> String {
    match rows {
        1 => "the row is".to_owned(),
        _ => format!("all {rows} rows are"),
    }
}

/// Returns what the answer `undo` may be after some rows.
pub fn undone(rows: usize) -> String {
    match rows {
        0 => "a row first: there is none to take back".to_owned(),
        1 => "\"undo\" or \"undo 1\"".to_owned(),
        _ => format!("\"undo\" for the last row, or \"undo\" with a number from 1 to {rows}"),
    }
}

/// The outputs of the dialogue.
pub struct Show {
    report: Printer,
    json: Option<(PathBuf, Option<File>)>,
    /// Number of rows below which an expected error may be far from the true one.
    uncertain_below: usize,
}

impl Show {
    /// Creates the outputs; `json` is the path of the JSON output. With fewer rows than `uncertain_below`, an expected error may
    /// be far from the true one.
    ///
    /// # Errors
    /// [`Failure::LostOutput`].
    pub fn new(json: Option<&Path>, uncertain_below: usize) -> Result<Self, Failure> {
        let open = |path: &Path| {
            let file = match is_stdout(path) {
                true => None,
                false => Some(File::create(path).map_err(|error| Failure::lost(path, error))?),
            };
            Ok::<_, Failure>((path.to_path_buf(), file))
        };
        Ok(Self {
            report: Printer::for_outputs(&[json]),
            json: json.map(open).transpose()?,
            uncertain_below,
        })
    }

    /// Writes a document without its null members.
    fn document(&mut self, mut document: Value) -> Result<(), Failure> {
        if let Value::Object(members) = &mut document {
            members.retain(|_, value| !value.is_null());
        }
        let line = format!("{document}\n");
        match &mut self.json {
            None => Ok(()),
            Some((_, None)) => to_stdout(line.as_bytes()),
            Some((path, Some(file))) => file
                .write_all(line.as_bytes())
                .map_err(|error| Failure::lost(path, error)),
        }
    }

    /// Reports that the rows of an earlier session are continued.
    pub fn resumed(&mut self, out: &Path, rows: usize, found: Option<&Outlook>) {
        let expected = found.map_or_else(String::new, |found| {
            format!(", expected error {:.3} mm", found.expected.mean_mm)
        });
        self.report.line(format_args!(
            "Continuing with {} of {}{expected}.",
            counted(rows, "row"),
            out.display()
        ));
    }

    /// Shows what an answer may be.
    pub fn columns(&mut self, columns: &str) -> Result<(), Failure> {
        self.report.line(format_args!(
            "answer with a row: {columns}\n  or with a word: skip (leave out what cannot be measured), undo (take \
            back the last row), undo 5 (row 5), end, help"
        ));
        let columns: Vec<&str> = columns.split(',').map(str::trim).collect();
        self.document(json!({"event": "columns", "columns": columns}))
    }

    /// Shows which row to measure next; `is_fitted` states whether the rows so far are enough for a fit.
    pub fn next(
        &mut self,
        asked: &Asked,
        next: &Next,
        arm: &Arm,
        (left, is_fitted): (usize, bool),
    ) -> Result<(), Failure> {
        let joints: Vec<String> = (1..)
            .zip(&arm.robot.joints)
            .zip(&asked.joints)
            .map(|((i, joint), value): ((usize, _), _)| match joint.kind {
                JointKind::Revolute => format!("q{i} {value}°"),
                JointKind::Prismatic => format!("q{i} {value} mm"),
            })
            .collect();
        let feature = asked.feature.as_deref().unwrap_or("pose");
        let payload = asked
            .payload_kg
            .map_or_else(String::new, |kg| format!(", payload {kg} kg"));
        // Without a fit, most rows seem worth nothing.
        let less = 1.0 - next.share;
        let forecast = match is_fitted || less >= LEAST {
            true => format!("forecast: {:.1} % less error", 100.0 * less),
            false => "no forecast yet".to_owned(),
        };
        self.report.line(format_args!(
            "next: {feature} at {}{payload} (line {} of the plan, one of {left}; {forecast})",
            joints.join(", "),
            asked.line
        ));
        let values: Vec<f64> = asked.joints.iter().filter_map(|q| q.parse().ok()).collect();
        self.document(json!({
            "event": "next", "line": asked.line, "feature": asked.feature, "joints": values,
            "payload_kg": asked.payload_kg, "left": left, "foreseen_share": next.share
        }))
    }

    /// Reports a row that cannot be used.
    pub fn refused(&mut self, error: &InputError) -> Result<(), Failure> {
        note(format_args!(
            "row refused, nothing was changed: {}",
            snippet::render(error)
        ));
        self.document(json!({
            "event": "refused", "line": error.line, "column": error.column.as_ref().map(|(n, _)| n),
            "found": error.found, "expected": error.expected
        }))
    }

    /// Confirms that a row is on disk.
    pub fn taken(&mut self, row: usize, _: &OnDisk) -> Result<(), Failure> {
        self.report.line(format_args!("row {row} is on disk"));
        self.document(json!({"event": "accepted", "row": row}))
    }

    /// Shows the expected error with all rows so far.
    pub fn known(
        &mut self,
        row: usize,
        found: Option<&Outlook>,
        outliers: &[usize],
        before: Option<f64>,
        until: Option<f64>,
        seconds: f64,
    ) -> Result<(), Failure> {
        match found {
            None => self
                .report
                .line("  no expected error yet: the rows are too few to fit"),
            Some(found) => {
                let expected = found.expected;
                let change = before.map_or_else(String::new, |before| {
                    format!(", {:+.3} mm due to this row", expected.mean_mm - before)
                });
                let few = match row < self.uncertain_below {
                    true => format!(
                        "; with fewer than {} rows, it may be wrong by a factor of {FEW_FACTOR}",
                        self.uncertain_below
                    ),
                    false => String::new(),
                };
                let go_on = match until {
                    Some(until) if expected.mean_mm > until => {
                        format!("; continue: still above {until} mm")
                    }
                    _ => String::new(),
                };
                self.report.line(format_args!(
                    "  expected error {:.3} mm, 95 % within {:.3} mm (nominal {:.3} mm){change}{few}{go_on}",
                    expected.mean_mm, expected.p95_mm, found.nominal.mean_mm
                ));
            }
        }
        let beyond = found.map(|found| {
            let of = found.beyond.iter();
            of.map(|(kind, value)| json!({"kind": kind, "noise_beyond": value}))
                .collect::<Vec<_>>()
        });
        self.document(json!({
            "event": "estimate", "row": row, "seconds": seconds,
            "expected_mm": found.map(|f| f.expected.mean_mm), "p95_mm": found.map(|f| f.expected.p95_mm),
            "nominal_mm": found.map(|f| f.nominal.mean_mm), "noise": beyond,
            "outlier_rows": found.map(|_| outliers)
        }))
    }

    /// Reports that the expected error is small enough, but that `calibrate` needs more rows.
    pub fn incomplete(&mut self, until: Option<f64>, error: &InputError) -> Result<(), Failure> {
        let until = until.map_or_else(String::new, |until| format!("{until} mm is reached, but "));
        note(format_args!(
            "{until}`calibrate` needs more rows: {}",
            snippet::render(error)
        ));
        self.document(json!({
            "event": "incomplete", "line": error.line, "column": error.column.as_ref().map(|(n, _)| n),
            "found": error.found, "expected": error.expected
        }))
    }

    /// Reports that a row was taken back.
    pub fn taken_back(&mut self, row: usize, text: &str) -> Result<(), Failure> {
        self.report.line(format_args!(
            "row {row} is taken back and is now a comment: {text}"
        ));
        self.document(json!({"event": "withdrawn", "row": row}))
    }

    /// Reports that a row contradicts the others.
    pub fn outlier(
        &mut self,
        row: usize,
        missed_mm: Option<f64>,
        is_touch: bool,
    ) -> Result<(), Failure> {
        let by = missed_mm.map_or_else(
            || "is far from what the other rows predict".to_owned(),
            |mm| format!("is {mm:.1} mm from what the other rows predict"),
        );
        let question = match is_touch {
            true => "was it this feature?",
            false => "was the arm at these joints, and do the units match the columns?",
        };
        note(format_args!(
            "row {row} {by} and does not count: {question} enter \"undo {row}\" and measure it again"
        ));
        self.document(json!({"event": "outlier", "row": row, "missed_mm": missed_mm}))
    }

    /// Reports that rows no longer contradict the others.
    pub fn agree(&mut self, rows: &[usize]) -> Result<(), Failure> {
        if rows.is_empty() {
            return Ok(());
        }
        let all: Vec<String> = rows.iter().map(ToString::to_string).collect();
        let (noun, verb, counts) = match rows {
            [_] => ("row", "agrees", "counts"),
            _ => ("rows", "agree", "count"),
        };
        note(format_args!(
            "{noun} {} now {verb} with the others and {counts}",
            all.join(", ")
        ));
        self.document(json!({"event": "agree", "rows": rows}))
    }

    /// Reports that something moved, because rows in succession contradict the others.
    pub fn moved(&mut self, rows: &[usize], found: Option<&str>) -> Result<(), Failure> {
        let Some(first) = rows.first() else {
            return Ok(());
        };
        let all: Vec<String> = rows.iter().map(ToString::to_string).collect();
        let what = found.unwrap_or("what changed is not clear yet");
        note(format_args!(
            "rows {} contradict those before: something moved since row {first}: {what}; put it back and take these rows back \
             with \"undo\", or continue in another file",
            all.join(", ")
        ));
        self.document(json!({"event": "moved", "since": first, "rows": rows, "found": found}))
    }

    /// Reports rows that do not count here, but that `calibrate` uses.
    pub fn used(&mut self, rows: &[usize], is_refused: bool) {
        if rows.is_empty() || is_refused {
            return;
        }
        let rows: Vec<String> = rows.iter().map(ToString::to_string).collect();
        note(format_args!(
            "`calibrate` uses rows {}, although they contradict the others: take them back with \"undo\" first",
            rows.join(", ")
        ));
    }

    /// Reports why the measurement ends, and which command comes next.
    pub fn end(
        &mut self,
        end: End,
        rows: usize,
        found: Option<&Outlook>,
        until: Option<f64>,
        calibrate: Option<&str>,
    ) -> Result<(), Failure> {
        let why = match end {
            End::Within => "The expected error is small enough".to_owned(),
            End::UsedUp => "The plan has no more rows".to_owned(),
            End::NoMore => "The source has no more rows".to_owned(),
        };
        let expected = found.map_or_else(String::new, |found| {
            format!(
                ", expected error {:.3} mm (mean over the work volume, of a model without processes)",
                found.expected.mean_mm
            )
        });
        self.report
            .line(format_args!("{why}: {}{expected}.", counted(rows, "row")));
        if let Some(calibrate) = calibrate.filter(|_| rows > 0) {
            self.report
                .line(format_args!("Then: {calibrate} --out model.blob"));
        }
        let reason = match end {
            End::Within => "reached",
            End::UsedUp => "used-up",
            End::NoMore => "no-more-rows",
        };
        self.document(json!({
            "event": "end", "reason": reason, "rows": rows, "until_mm": until,
            "expected_mm": found.map(|f| f.expected.mean_mm), "version": env!("CARGO_PKG_VERSION")
        }))
    }
}
