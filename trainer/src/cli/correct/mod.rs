//! `trainer correct`: reads targets and writes the commands that bring the real arm to them.
//!
//! A robot program is corrected in [`program`], in `f64`. A file of joint targets is corrected here by the device's own
//! function. That file is read in chunks; all cores correct chunks at the same time, and the chunks are written in their
//! order. Memory holds a few chunks, and 17 bytes of each row for the summary.

mod args;
mod document;
mod page;
mod paths;
mod program;
pub mod record;
mod remarks;
mod row;
mod sources;
mod summary;

use std::path::Path;

use poegp_runtime::model::MAX_PAYLOAD_KG;

pub use crate::cli::correct::args::Correct;
use crate::cli::correct::args::two_payloads;
use crate::cli::correct::row::{Fields, correct};
use crate::cli::correct::summary::{Summed, Summing};
use crate::cli::failure::Failure;
use crate::cli::inputs::{self, file_name};
use crate::cli::output::kind::Kind;
use crate::cli::output::long::LongOutput;
use crate::cli::output::{check_outputs, document_text, write_with_long};
use crate::cli::terminal::print::{Printer, note};
use crate::cli::terminal::warnings;
use crate::robot_programs::correction::Format;
use crate::robot_programs::correction::engine::NO_PAYLOAD_TERMS;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::JointChecks;
use poegp_calibration::measurement::joint_targets::{Target, TargetColumns, TargetReader};
use poegp_calibration::numeric::parallel::in_order;
use poegp_calibration::progress::threads;

/// Columns that are added to a file of joint targets.
const ADDED: [&str; 5] = [
    "position_error_um",
    "rotation_error_urad",
    "applied",
    "status",
    "trust",
];

/// A corrected chunk of the file, with its part of the summary.
struct Rewritten {
    text: String,
    summed: Summed,
    checks: JointChecks,
}

pub fn run(a: &Correct) -> Result<(), Failure> {
    match format(a)? {
        Some(format) => program::run(a, format),
        None => joint_targets(a, &a.programs[0]),
    }
}

/// Corrects a robot program, and returns the JSON document that `--json` writes.
///
/// # Errors
/// [`Failure`]; parts of the program that stay uncorrected are not an error.
pub fn program_document(a: &Correct) -> Result<String, Failure> {
    let Some(format) = format(a)? else {
        let found = "no program of a known language";
        let expected = "a robot program or a table of poses";
        return Err(InputError::new(&a.programs[0], found, expected).into());
    };
    let (_, _, document) = program::corrected(a, format)?;
    document_text(&document)
}

/// Returns the format of the programs; `None` if the input is one file of joint targets.
fn format(a: &Correct) -> Result<Option<Format>, Failure> {
    let formats: Vec<Option<Format>> = a.programs.iter().map(|path| Format::of(path)).collect();
    match formats.as_slice() {
        [Some(first), rest @ ..] if rest.iter().all(|format| *format == Some(*first)) => {
            Ok(Some(*first))
        }
        [None] => Ok(None),
        _ => Err(Failure::Usage(
            "files of several formats: give those of one program, or one CSV file".to_owned(),
        )),
    }
}

/// Returns the paths of the outputs for a table of joint targets, after [`check_outputs`].
fn outputs<'a>(a: &'a Correct, targets: &Path) -> Result<Vec<Option<&'a Path>>, Failure> {
    let outputs = [
        (Some(a.out.as_path()), Kind::Targets),
        (a.json.as_deref(), Kind::Json),
    ];
    check_outputs(&outputs, &[&a.blob, targets])
}

fn joint_targets(a: &Correct, targets: &Path) -> Result<(), Failure> {
    let of_programs = [
        a.inverse,
        a.taught,
        a.payload_from_program,
        a.frames.is_some(),
        !a.with.is_empty(),
        a.report.is_some(),
        a.split.is_some(),
        a.dry_run,
    ];
    let is_table = |path: &Path| {
        let ending = path.extension();
        ending.is_some_and(|ending| ending.eq_ignore_ascii_case("csv"))
    };
    if !is_table(targets) && targets.as_os_str() != "-" && of_programs.contains(&true) {
        return Err(InputError::new(
            targets,
            "a file whose ending is that of no known program",
            "one of .mod .prg .sys (RAPID), .src .dat (KRL), .ls (Fanuc), .script (URScript), .jbi (INFORM), .dtx (VAL3) \
             or .csv",
        )
        .with_help("save a program of PolyScope (.urp) as a script (.script)")
        .into());
    }
    if of_programs.contains(&true) {
        return Err(Failure::Usage(format!(
            "{}: --inverse, --taught, --payload-from-program, --frames, --with, --split, --dry-run and --report are for robot programs",
            targets.display()
        )));
    }
    let outputs = outputs(a, targets)?;
    let loaded = BlobModel::read(&a.blob)?;
    let robot = inputs::robot_of(&loaded);
    let (columns, start, mut chunks) = TargetReader::open(targets)?.into_parts();
    let columns = &columns;
    let limits = columns.limits(&robot)?;
    columns.refuse_columns(
        &ADDED,
        "this file was corrected already: correct the original, or remove these columns",
    )?;
    let payload_kg = payload(a, &loaded, columns)?;
    note_unused_payload(&loaded, columns, payload_kg);
    let poses = columns.pose_columns().join(", ");
    if !poses.is_empty() {
        note(format_args!(
            "{}: only the joints are corrected, and {poses} stay as they are: remove the joint columns to correct the poses",
            targets.display()
        ));
    }
    let summing = Summing::new(loaded.blob(), columns.joint_columns());
    let mut out = LongOutput::new(&a.out)?;
    let mut text = String::new();
    columns.rewrite_start(&start, &ADDED, &mut text)?;
    out.write(text.as_bytes())?;
    let (mut all, mut checks) = (Summed::default(), JointChecks::default());
    let rewrite = |chunk| -> Result<Rewritten, InputError> {
        let (mut text, mut summed) = (String::new(), Summed::default());
        let mut checks = JointChecks::default();
        let answer = |target: &Target<'_>| {
            let row = correct(&loaded, target, payload_kg);
            summing.add(&mut summed, &row);
            Fields(row, columns.joint_columns())
        };
        columns.rewrite(&chunk, (&limits, &mut checks), answer, &mut text)?;
        Ok(Rewritten {
            text,
            summed,
            checks,
        })
    };
    in_order(
        threads(),
        || Ok(chunks.next()?),
        rewrite,
        |rewritten: Result<Rewritten, InputError>| -> Result<(), Failure> {
            let rewritten = rewritten?;
            all.extend(rewritten.summed);
            checks.extend(rewritten.checks);
            out.write(rewritten.text.as_bytes())
        },
    )?;
    if all.is_empty() {
        return Err(columns.no_rows().into());
    }
    for text in limits.notes(&checks) {
        note(format_args!("{}: {text}", targets.display()));
    }
    let document = summing.document(file_name(targets), loaded.host().provenance.method, all);
    summary::beyond_limits(&document)
        .iter()
        .for_each(warnings::add);
    let json = match &a.json {
        Some(path) => Some((path.as_path(), document_text(&document)?)),
        None => None,
    };
    let json = json.as_ref().map(|(path, text)| (*path, text.as_bytes()));
    write_with_long(out, json.as_slice())?;
    summary::print(Printer::for_outputs(&outputs), &a.out, &document);
    Ok(())
}

/// Notes that payloads change nothing, if the model does not depend on them.
fn note_unused_payload(loaded: &BlobModel, columns: &TargetColumns, payload_kg: f64) {
    if loaded.blob().ranges.payload_kg.is_none() && (payload_kg > 0.0 || columns.has_payload()) {
        note(format_args!(
            "{}: the payload changes nothing: {NO_PAYLOAD_TERMS}",
            columns.path().display()
        ));
    }
}

/// Returns the payload of the command line, for a file without payloads. Refuses payloads from both, or from neither if
/// the model needs one.
fn payload(a: &Correct, loaded: &BlobModel, columns: &TargetColumns) -> Result<f64, Failure> {
    let needed = loaded.blob().ranges.payload_kg;
    match (a.payload_kg, columns.has_payload()) {
        (Some(_), true) => Err(two_payloads(columns.path())),
        (Some(kg), _) if !(0.0..=f64::from(MAX_PAYLOAD_KG)).contains(&kg) => Err(Failure::Usage(
            format!("--payload-kg {kg}: expected kilograms, 0 or more"),
        )),
        (None, false) if needed.is_some() => {
            let (light, heavy) = needed.unwrap_or_default();
            Err(InputError::new(
                columns.path(),
                "no payload_kg column",
                format!(
                    "one: the model depends on the payload ({light} to {heavy} kg were trained)"
                ),
            )
            .with_help("give --payload-kg KG when all rows have the same payload")
            .into())
        }
        (given, _) => Ok(given.unwrap_or(0.0)),
    }
}
