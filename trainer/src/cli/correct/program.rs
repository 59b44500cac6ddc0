//! `trainer correct` for programs of controllers: targets corrected where they stand, every other byte as it was.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::cli::correct::args::Correct;
use crate::cli::correct::record::{Record, refuse_corrected, sha256};
use crate::cli::failure::Failure;
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::{Printer, is_stdout};
use crate::robot_programs::correction::Format;
use crate::robot_programs::correction::between::{Between, between};
use crate::robot_programs::correction::engine::{self, Direction, Outcome};
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::planning::Payload;
use crate::robot_programs::correction::program::{Goal, Program};
use crate::robot_programs::correction::replacement::{Solved, rewrite};
use crate::robot_programs::correction::source::Source;
use poegp_calibration::blob::commander::Commander;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::numeric::statistics::Summary;
use poegp_runtime::model::MAX_PAYLOAD_KG;

/// Most lines of what is left in one message; the JSON document has all.
const NAMED: usize = 200;

/// What `--json` writes.
#[derive(Serialize)]
pub struct ProgramJson {
    version: &'static str,
    method: String,
    language: &'static str,
    files: Vec<String>,
    targets: usize,
    joint_targets: usize,
    pose_targets: usize,
    /// Numbers that were replaced.
    numbers: usize,
    left: Vec<LeftJson>,
    frames: Vec<FrameJson>,
    remarks: Vec<String>,
    /// How far the written targets move.
    #[serde(skip_serializing_if = "Option::is_none")]
    moved_mm: Option<Summary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    moved_deg: Option<Summary>,
    /// How far the tool is from its targets without correction, by the model.
    #[serde(skip_serializing_if = "Option::is_none")]
    before_mm: Option<Summary>,
    /// The same with it.
    #[serde(skip_serializing_if = "Option::is_none")]
    after_um: Option<Summary>,
    /// What the decimals of the format leave.
    rounding_um: f64,
    /// The largest error between the ends of lines and arcs.
    #[serde(skip_serializing_if = "Option::is_none")]
    between: Option<BetweenJson>,
}

#[derive(Serialize)]
struct BetweenJson {
    moves: usize,
    /// Of each move.
    points: usize,
    largest_mm: f64,
    file: String,
    line: usize,
}

#[derive(Serialize)]
struct LeftJson {
    file: String,
    line: usize,
    column: usize,
    reason: String,
}

#[derive(Serialize)]
struct FrameJson {
    name: String,
    kind: &'static str,
    from: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    payload_kg: Option<f64>,
}

pub fn run(a: &Correct, format: Format) -> Result<(), Failure> {
    let (outputs, files, document) = corrected(a, format)?;
    let outputs: Vec<Option<&Path>> = outputs.iter().map(Option::as_deref).collect();
    print(Printer::for_outputs(&outputs), &files, &document);
    named(&document)
}

/// What is read and written for each file.
type Files = Vec<(PathBuf, PathBuf)>;

/// Corrects and writes; returns all outputs, the files, and what there is to say.
pub fn corrected(
    a: &Correct,
    format: Format,
) -> Result<(Vec<Option<PathBuf>>, Files, ProgramJson), Failure> {
    let is_folder = a.programs.len() > 1 || a.out.is_dir();
    // Of each file, what is read and what is written.
    let mut files: Files = Vec::new();
    for path in &a.programs {
        let out = if is_folder {
            a.out.join(path.file_name().unwrap_or_default())
        } else {
            a.out.clone()
        };
        let companion = format
            .companion(path)
            .filter(|path| !a.programs.contains(path));
        if let Some(companion) = companion {
            let ending = companion.extension().unwrap_or_default().to_owned();
            files.push((companion, out.with_extension(ending)));
        }
        files.push((path.clone(), out));
    }
    if a.programs.len() > 1 && !a.out.is_dir() {
        return Err(InputError::new(
            &a.out,
            "no folder",
            "a folder for the corrected files of several programs",
        )
        .into());
    }
    if is_stdout(&a.out) && files.len() > 1 {
        return Err(InputError::new(
            &a.out,
            "standard output",
            "a file, beside which the data list is written",
        )
        .into());
    }
    let records: Vec<PathBuf> = files.iter().map(|(_, out)| record_path(out)).collect();
    let mut outputs: Vec<Option<&Path>> =
        files.iter().map(|(_, out)| Some(out.as_path())).collect();
    let is_stream = outputs.iter().flatten().any(|out| is_stdout(out));
    if !is_stream {
        outputs.extend(records.iter().map(|path| Some(path.as_path())));
    }
    outputs.push(a.json.as_deref());
    let mut inputs: Vec<&Path> = vec![&a.blob];
    inputs.extend(
        a.programs
            .iter()
            .chain(&a.with)
            .chain(&a.frames)
            .map(PathBuf::as_path),
    );
    check_outputs(&outputs, &inputs)?;
    let loaded = BlobModel::read(&a.blob)?;
    let commander = Commander::new(&loaded).map_err(|error| {
        InputError::new(
            &a.blob,
            error.to_string(),
            "a model blob written by `trainer calibrate`",
        )
    })?;
    let payload = payload(a, &loaded)?;
    let frames = a
        .frames
        .as_deref()
        .map(FrameFile::read)
        .transpose()?
        .unwrap_or_default();
    let direction = if a.inverse {
        Direction::Inverse
    } else {
        Direction::Correct
    };
    let model = sha256(loaded.bytes());
    let mut sources = Vec::new();
    for (path, _) in &files {
        let source = Source::read(path, true)?;
        refuse_corrected(path, &source.bytes, &model, direction)?;
        sources.push(source);
    }
    let beside = a.programs.iter().flat_map(|path| format.beside(path));
    let mut beside: Vec<PathBuf> = beside.collect();
    beside.sort();
    beside.dedup();
    for path in a.with.iter().chain(&beside) {
        sources.push(Source::read(path, false)?);
    }
    let program = format.read(sources, &frames)?;
    if program.targets.is_empty() && program.left.is_empty() {
        return Err(InputError::new(
            &a.programs[0],
            "no targets",
            format!("a program in {} with targets", program.language),
        )
        .into());
    }
    let outcome = engine::solve(&program, &commander, payload, direction)?;
    let results = rewrite(&program, &outcome.replacements);
    let ends = match direction {
        Direction::Correct => between(&program, &commander, &outcome.solved),
        Direction::Inverse => None,
    };
    let document = document(&program, &outcome, ends, loaded.host().provenance.method);
    let json = a
        .json
        .as_deref()
        .map(|_| json_text(&document))
        .transpose()?;
    let mut record_texts = Vec::new();
    for ((path, _), (source, result)) in files.iter().zip(program.sources.iter().zip(&results)) {
        let record = Record::new(path, &model, &source.bytes, result, direction);
        record_texts.push(json_text(&record)?);
    }
    let mut written: Vec<(&Path, &[u8])> = Vec::new();
    for ((_, out), result) in files.iter().zip(&results) {
        written.push((out, result));
    }
    if !is_stream {
        written.extend(
            records
                .iter()
                .zip(&record_texts)
                .map(|(p, t)| (p.as_path(), t.as_bytes())),
        );
    }
    if let (Some(path), Some(text)) = (&a.json, &json) {
        written.push((path, text.as_bytes()));
    }
    write_outputs(&written)?;
    let outputs = outputs.iter().map(|path| path.map(Path::to_path_buf));
    Ok((outputs.collect(), files, document))
}

/// `OUT.poegp.json`.
fn record_path(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".poegp.json");
    PathBuf::from(name)
}

fn payload(a: &Correct, loaded: &BlobModel) -> Result<Payload, Failure> {
    match (
        a.payload_kg,
        a.payload_from_program,
        loaded.blob().ranges.payload_kg,
    ) {
        (Some(kg), ..) if !(0.0..=f64::from(MAX_PAYLOAD_KG)).contains(&kg) => Err(Failure::Usage(
            format!("--payload-kg {kg}: expected kilograms, 0 or more"),
        )),
        (Some(kg), ..) => Ok(Payload::Fixed(kg)),
        (None, true, _) => Ok(Payload::FromProgram),
        (None, false, Some((light, heavy))) => Err(Failure::Usage(format!(
            "no payload: the model depends on it ({light} to {heavy} kg were trained)\nhelp: give --payload-kg KG, or \
             --payload-from-program for what the program says of its tools"
        ))),
        (None, false, None) => Ok(Payload::Fixed(0.0)),
    }
}

fn between_json(program: &Program, b: &Between) -> BetweenJson {
    let source = &program.sources[b.location.file];
    BetweenJson {
        moves: b.moves,
        points: b.points,
        largest_mm: 1e3 * b.largest,
        file: source.path.display().to_string(),
        line: source.line_and_column(b.location.at).0,
    }
}

fn document(
    program: &Program,
    outcome: &Outcome,
    ends: Option<Between>,
    method: &str,
) -> ProgramJson {
    let is_joints = |index: usize| matches!(program.targets[index].goal, Goal::Joints(_));
    let joint_targets = outcome
        .solved
        .iter()
        .filter(|s| is_joints(s.target))
        .count();
    let of = |value: fn(&Solved) -> f64| {
        let values: Vec<f64> = outcome.solved.iter().map(value).collect();
        (!values.is_empty()).then(|| Summary::new(&values))
    };
    let left = outcome.left.iter().map(|left| {
        let source = &program.sources[left.location.file];
        let (line, column) = source.line_and_column(left.location.at);
        LeftJson {
            file: source.path.display().to_string(),
            line,
            column,
            reason: left.reason.clone(),
        }
    });
    // The base of joint targets is none.
    let is_used = |index: usize| {
        let mut targets = program
            .targets
            .iter()
            .filter(|t| matches!(t.goal, Goal::Pose { .. }) || t.tool == Some(index));
        targets.any(|t| t.base == Some(index) || t.tool == Some(index))
    };
    let used = program
        .frames
        .iter()
        .enumerate()
        .filter(|(index, _)| is_used(*index));
    let frames = used.map(|(_, frame)| FrameJson {
        name: frame.name.clone(),
        kind: if frame.is_tool { "tool" } else { "base" },
        from: frame.origin.clone(),
        payload_kg: frame.payload_kg.filter(|_| frame.is_tool),
    });
    ProgramJson {
        version: env!("CARGO_PKG_VERSION"),
        method: method.to_owned(),
        language: program.language,
        files: program
            .sources
            .iter()
            .filter(|s| s.is_corrected)
            .map(|s| s.path.display().to_string())
            .collect(),
        targets: outcome.solved.len(),
        joint_targets,
        pose_targets: outcome.solved.len() - joint_targets,
        numbers: outcome.replacements.len(),
        left: left.collect(),
        frames: frames.collect(),
        remarks: program.remarks.clone(),
        moved_mm: of(|s| 1e3 * s.moved.0),
        moved_deg: of(|s| s.moved.1.to_degrees()),
        before_mm: of(|s| 1e3 * s.before),
        after_um: of(|s| 1e6 * s.after),
        rounding_um: 1e6 * outcome.rounding,
        between: ends.map(|b| between_json(program, &b)),
    }
}

fn print(report: Printer, files: &[(PathBuf, PathBuf)], d: &ProgramJson) {
    for (_, out) in files.iter().filter(|(_, out)| !is_stdout(out)) {
        report.line(format_args!(
            "Wrote {} ({}) and the record {}.",
            out.display(),
            d.language,
            record_path(out).display()
        ));
    }
    report.line(format_args!(
        "Model `{}`: {} targets corrected, {} of joints and {} of poses; {} left as they are.",
        d.method,
        d.targets,
        d.joint_targets,
        d.pose_targets,
        d.left.len()
    ));
    for frame in &d.frames {
        let kg = frame
            .payload_kg
            .map_or_else(String::new, |kg| format!(", {kg} kg"));
        report.line(format_args!(
            "{} {}: from {}{kg}.",
            if frame.kind == "tool" { "Tool" } else { "Base" },
            frame.name,
            frame.from
        ));
    }
    if let (Some(mm), Some(deg)) = (&d.moved_mm, &d.moved_deg) {
        report.line(format_args!(
            "The targets move by {:.3} mm and {:.4}° in the mean, by {:.3} mm and {:.4}° at most.",
            mm.mean, deg.mean, mm.max, deg.max
        ));
    }
    if let (Some(before), Some(after)) = (&d.before_mm, &d.after_um) {
        report.line(format_args!(
            "Uncorrected, the tool would be off by {:.3} mm in the mean and {:.3} mm at most; corrected, by the model, by {:.2} µm \
             at most, and by {:.2} µm more for the decimals of the file.",
            before.mean, before.max, after.max, d.rounding_um
        ));
    }
    if let Some(b) = &d.between {
        report.line(format_args!(
            "Between the ends of {} lines and arcs the tool is off by {:.3} mm at most, by the model at {} points of each ({}:{}).",
            b.moves, b.largest_mm, b.points, b.file, b.line
        ));
    }
    for remark in &d.remarks {
        report.line(format_args!("note: {remark}"));
    }
}

/// All that is left, as a failure.
fn named(d: &ProgramJson) -> Result<(), Failure> {
    if d.left.is_empty() {
        return Ok(());
    }
    let mut text = match d.left.len() {
        1 => "one part of the program is left as it is:".to_owned(),
        count => format!("{count} parts of the program are left as they are:"),
    };
    for left in d.left.iter().take(NAMED) {
        text += &format!(
            "\n  {}:{}:{}: {}",
            left.file, left.line, left.column, left.reason
        );
    }
    if d.left.len() > NAMED {
        text += &format!("\n  and {} more, which --json names", d.left.len() - NAMED);
    }
    text += "\nhelp: everything else was corrected and written";
    Err(Failure::Quality(text))
}
