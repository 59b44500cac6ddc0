//! `trainer correct` for controllers' programs: targets are corrected in place, and every other byte stays as it was.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::cli::correct::args::{Correct, two_payloads};
use crate::cli::correct::document::{LeftJson, ProgramJson, SplitJson, document};
use crate::cli::correct::page::page;
use crate::cli::correct::paths::{Files, Paths, Texts};
use crate::cli::correct::record::{Corrector, Record, record_path, sha256};
use crate::cli::correct::remarks::remarks;
use crate::cli::correct::sources::Sources;
use crate::cli::correct::summary::short_length;
use crate::cli::failure::Failure;
use crate::cli::inputs::{now, robot_of};
use crate::cli::output::{check_outputs, document_text, json_text, write_outputs};
use crate::cli::terminal::print::{Printer, is_stdout};
use crate::report::{FileSummary, Provenance};
use crate::robot_programs::correction::Format;
use crate::robot_programs::correction::between::{Between, between, stretches};
use crate::robot_programs::correction::engine::{self, Direction, Outcome};
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::planning::Payload;
use crate::robot_programs::correction::program::{Goal, Program};
use crate::robot_programs::correction::replacement::rewrite;
use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::correction::split::split;
use crate::signing::unsigned;
use poegp_calibration::blob::commander::Commander;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::some_of;
use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::robot::Robot;
use poegp_protocol::JointKind;
use poegp_runtime::model::MAX_PAYLOAD_KG;

/// Largest number of uncorrected parts that one message lists; the JSON document lists all.
const NAMED: usize = 200;

/// Number of parts with the same reason from which one line of the message names them together.
const MANY: usize = 5;

/// Smallest tolerance of `--split`, mm: the decimals of a program cannot express less.
const LEAST_SPLIT_MM: f64 = 0.005;

pub fn run(a: &Correct, format: Format) -> Result<(), Failure> {
    let (outputs, files, document) = corrected(a, format)?;
    let outputs: Vec<Option<&Path>> = outputs.iter().map(Option::as_deref).collect();
    print(Printer::for_outputs(&outputs), a, &files, &document);
    named(&document, a)
}

/// Corrects the programs and writes the outputs; returns all output paths, the files, and the JSON document.
pub fn corrected(
    a: &Correct,
    format: Format,
) -> Result<(Vec<Option<PathBuf>>, Files, ProgramJson), Failure> {
    let paths = Paths::new(a, format)?;
    let outputs = check_outputs(&paths.outputs(a), &paths.inputs(a))?;
    let loaded = BlobModel::read(&a.blob)?;
    let commander = commander(a, &loaded)?;
    let payload = payload(a, &loaded)?;
    refuse_options(a, format)?;
    let frames = a
        .frames
        .as_deref()
        .map(FrameFile::read)
        .transpose()?
        .unwrap_or_default();
    let model = sha256(&unsigned(loaded.bytes()));
    let robot = &loaded.blob().robot;
    let corrector = Corrector {
        robot: robot.name,
        joints: robot.joints.len(),
        sha256: &model,
        direction: a.direction().0,
    };
    let Sources {
        all,
        hashes,
        corrections,
        records: mut earlier,
    } = Sources::read(a, &paths, &corrector)?;
    let mut program = read_program(a, format, all, &frames)?;
    if matches!(format, Format::Rapid | Format::Krl) {
        leave_out_unused_axes(&mut program, robot.joints.len());
    }
    if format != Format::Table {
        refuse_tables_only(a, &program, &robot_of(&loaded))?;
    }
    let mut outcome = engine::solve(&program, &commander, payload, corrector.direction)?;
    for (index, record) in &corrections {
        if !record.is_undone(&commander, (&program, &outcome.solved, *index)) {
            return Err(other_settings(&paths.files[*index].0, record).into());
        }
    }
    if corrector.direction == Direction::Correct {
        for (index, (path, _)) in paths.files.iter().enumerate() {
            let solved = (&program, outcome.solved.as_slice(), index);
            earlier.refuse_copy(path, &commander, solved)?;
        }
    }
    outcome
        .remarks
        .extend(remarks(a, format, &program, loaded.host().gauge.tool));
    let (ends, split) = ends(a, &program, &commander, &mut outcome);
    let results = rewrite(&program, &outcome.replacements);
    let method = loaded.host().provenance.method;
    let document = document(&program, &outcome, &ends, split, (method, payload));
    let page = a.report.as_deref().map(|_| {
        let origin = provenance(a, &loaded, &program);
        page(&document, &program, &outcome, &ends, &origin)
    });
    let json = a
        .json
        .as_deref()
        .map(|_| document_text(&document))
        .transpose()?;
    let mut records = Vec::new();
    let results_of_files = paths.files.iter().zip(hashes.iter().zip(&results));
    for (index, ((path, _), (hash, result))) in results_of_files.enumerate() {
        let solved = (&program, outcome.solved.as_slice(), index);
        let record = Record::new(path, &corrector, hash, result, solved);
        records.push(json_text(&record)?);
    }
    let texts = Texts {
        results: &results,
        records: &records,
        json: json.as_deref(),
        report: page.as_deref(),
    };
    write_outputs(&paths.written(a, &texts))?;
    let outputs = outputs.iter().map(|path| path.map(Path::to_path_buf));
    Ok((outputs.collect(), paths.files, document))
}

/// Returns what corrects commands with the model.
fn commander(a: &Correct, loaded: &BlobModel) -> Result<Commander, InputError> {
    Commander::new(loaded).map_err(|error| {
        let expected = "a model blob written by `trainer calibrate`";
        InputError::new(&a.blob, error.to_string(), expected)
    })
}

/// Refuses a second payload of a table, and a tolerance of `--split` out of range.
fn refuse_options(a: &Correct, format: Format) -> Result<(), Failure> {
    if a.payload_kg.is_some()
        && let Some(table) = a.programs.iter().find(|path| format.has_payloads(path))
    {
        return Err(two_payloads(table));
    }
    match a.split.filter(|mm| !(LEAST_SPLIT_MM..=1e3).contains(mm)) {
        Some(mm) => Err(Failure::Usage(format!(
            "--split {mm}: expected millimetres, {LEAST_SPLIT_MM} to 1000"
        ))),
        None => Ok(()),
    }
}

/// Reads the program from its sources; refuses one without targets.
fn read_program(
    a: &Correct,
    format: Format,
    sources: Vec<Source>,
    frames: &FrameFile,
) -> Result<Program, Failure> {
    let program = format.read(sources, frames)?;
    if program.targets.is_empty() && program.left.is_empty() {
        return Err(InputError::new(
            &a.programs[0],
            "no targets",
            format!("a program in {} with targets", program.language),
        )
        .into());
    }
    Ok(program)
}

/// Shortens all joint targets to the arm's `joints` if each has 0 or 9E9 for the axes after them: RAPID and KRL have six axes
/// even for an arm with fewer.
fn leave_out_unused_axes(program: &mut Program, joints: usize) {
    let goals = program.targets.iter_mut().map(|target| &mut target.goal);
    let mut axes: Vec<_> = goals
        .filter_map(|goal| match goal {
            Goal::Joints(numbers) => Some(numbers),
            Goal::Pose { .. } => None,
        })
        .collect();
    let is_unused = |number: &Number| number.value == 0.0 || number.value == 9e9;
    let mut beyond = axes.iter().flat_map(|numbers| numbers.iter().skip(joints));
    if beyond.all(is_unused) {
        axes.iter_mut().for_each(|numbers| numbers.truncate(joints));
    }
}

/// Returns the error for a program that does not come back to the targets that its record lists.
fn other_settings(path: &Path, record: &Record) -> InputError {
    let found = "a program that was corrected with another payload, or with other tools or frames";
    let expected = format!("those with which {} was corrected", record.source);
    InputError::new(path, found, expected)
}

/// Refuses a controller's program for an arm with a slide or a passive joint. These languages have slides as external axes,
/// whose targets stay as they are, and the numbers of their targets are angles. Controllers number the axes of an arm with a
/// passive joint differently.
fn refuse_tables_only(a: &Correct, program: &Program, robot: &Robot) -> Result<(), InputError> {
    let slide = |joint: &usize| robot.joints[*joint].kind == JointKind::Prismatic;
    let passive = |joint: &usize| robot.is_passive(*joint);
    let joints = 0..robot.joints.len();
    let (joint, is, expected) = match (joints.clone().find(slide), joints.clone().find(passive)) {
        (Some(joint), _) => (
            joint,
            "slides",
            "a model of an arm whose joints all turn: the joints of such a target are angles",
        ),
        (None, Some(joint)) => (
            joint,
            "is passive",
            "a model of an arm whose joints all have an axis: controllers number the axes of other arms differently",
        ),
        (None, None) => return Ok(()),
    };
    let found = format!(
        "a program in {} for a model whose joint {} {is}",
        program.language,
        joint + 1
    );
    let help = "correct a table of poses or of joints (CSV), which has a column for every joint";
    Err(InputError::new(&a.programs[0], found, expected).with_help(help))
}

/// Computes the errors between the ends of lines and arcs, and splits lines if `--split` asks for it.
fn ends(
    a: &Correct,
    program: &Program,
    commander: &Commander,
    outcome: &mut Outcome,
) -> (Vec<Between>, Option<SplitJson>) {
    if a.direction().0 == Direction::Inverse {
        return (Vec::new(), None);
    }
    let stretches = stretches(program, &outcome.solved);
    let mut ends = between(program, commander, &stretches);
    let Some(tolerance_mm) = a.split else {
        return (ends, None);
    };
    let division = split(
        program,
        commander,
        &stretches,
        &mut ends,
        1e-3 * tolerance_mm,
    );
    outcome.replacements.extend(division.insertions);
    outcome.replacements.sort_by_key(|r| (r.file, r.span));
    outcome.left.extend(division.left);
    outcome.left.sort_by_key(|left| left.location);
    let (lines, targets) = (division.lines, division.targets);
    let split = SplitJson {
        tolerance_mm,
        lines,
        targets,
    };
    (ends, Some(split))
}

/// Returns the provenance of the report: the model and the files of the program.
fn provenance(a: &Correct, loaded: &BlobModel, program: &Program) -> Provenance {
    let robot = &loaded.blob().robot;
    let mut files = vec![FileSummary::of_bytes(
        "model",
        a.blob.display().to_string(),
        loaded.bytes(),
    )];
    files.extend(program.sources.iter().map(|source| {
        let role = if source.is_corrected {
            "program"
        } else {
            "read with it"
        };
        FileSummary::of_bytes(role, source.path.display().to_string(), &source.bytes)
    }));
    let date = now().date().to_string();
    Provenance::new(robot.name, robot.serial_number, date, files)
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
             --payload-from-program to use the payloads that the program declares"
        ))),
        (None, false, None) => Ok(Payload::Fixed(0.0)),
    }
}

fn print(report: Printer, a: &Correct, files: &[(PathBuf, PathBuf)], d: &ProgramJson) {
    let wrote = if a.dry_run { "Would write" } else { "Wrote" };
    for (_, out) in files.iter().filter(|(_, out)| !is_stdout(out)) {
        report.line(format_args!(
            "{wrote} {} ({}) and the record {}.",
            out.display(),
            d.language,
            record_path(out).display()
        ));
    }
    let left = match d.left.len() {
        0 => "no part of the program is left out".to_owned(),
        1 => "one part of the program is not, or only partially".to_owned(),
        count => format!("{count} parts of the program are not, or only partially"),
    };
    let (direction, done) = a.direction();
    let done = match direction {
        Direction::Inverse => format!("{done} to the nominal arm"),
        Direction::Correct => done.to_owned(),
    };
    report.line(format_args!(
        "Model `{}`: {} {done}, {} of joints and {} of poses; {left}.",
        d.method,
        counted(d.targets, "target"),
        d.joint_targets,
        d.pose_targets,
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
            "The targets move by {:.3} mm and {:.4}° on average, by {:.3} mm and {:.4}° at most.",
            mm.mean, deg.mean, mm.max, deg.max
        ));
    }
    if let (Some(before), Some(after), Direction::Correct) = (&d.before_mm, &d.after_um, direction)
    {
        report.line(format_args!(
            "According to the model, the tool error at the corrected targets is {:.3} mm on average and {:.3} mm at \
             most without the correction, {} on average and {} at most with it, and up to {} more \
             from the decimals of the file.",
            before.mean,
            before.max,
            short_length(after.mean),
            short_length(after.max),
            short_length(d.rounding_um)
        ));
    }
    if let (Some(sigma), Direction::Correct) = (&d.predictive_std_mm, direction) {
        report.line(format_args!(
            "The model itself is uncertain: predictive standard deviation {:.4} mm on average, {:.4} mm at most.",
            sigma.mean, sigma.max
        ));
    }
    if let Some(s) = &d.split {
        report.line(format_args!(
            "Split {}: {} inserted, to keep the tool within {} mm of each line.",
            counted(s.lines, "line"),
            match s.targets {
                1 => "one target is".to_owned(),
                count => format!("{count} targets are"),
            },
            s.tolerance_mm
        ));
    }
    if let Some(b) = &d.between {
        report.line(format_args!(
            "Between the ends of {}, according to the model, the tool is off by {:.3} mm at most, computed at {} \
             points of each ({}:{}).",
            match b.moves {
                1 => "one line or arc".to_owned(),
                count => format!("{count} lines and arcs"),
            },
            b.largest_mm,
            b.points,
            b.file,
            b.line
        ));
    }
    for remark in &d.remarks {
        report.line(format_args!("note: {remark}"));
    }
}

/// Reports all uncorrected parts, if there are any, as a failure.
fn named(d: &ProgramJson, a: &Correct) -> Result<(), Failure> {
    if d.left.is_empty() {
        return Ok(());
    }
    let (direction, done) = a.direction();
    let partially = match direction {
        Direction::Inverse => "",
        Direction::Correct => ", or only partially",
    };
    let what = format!("{done}{partially}");
    let mut text = match d.left.len() {
        1 => format!("one part of the program is not {what}:"),
        count => format!("{count} parts of the program are not {what}:"),
    };
    let groups = by_reason(&d.left);
    for group in groups.iter().take(NAMED) {
        text += &format!("\n  {}", listed(group));
    }
    if groups.len() > NAMED {
        text += &format!("\n  and {} more, which --json names", groups.len() - NAMED);
    }
    text += &match (d.targets, a.dry_run) {
        (0, true) => format!("\nhelp: nothing would be {done}"),
        (0, false) => format!("\nhelp: nothing was {done}: the output equals the input"),
        (_, true) => format!("\nhelp: everything else would be {done}"),
        (_, false) => format!("\nhelp: everything else was {done} and written"),
    };
    Err(Failure::Quality(text))
}

/// Groups parts of one file that are left for the same reason, if they are many; keeps their order.
fn by_reason(all: &[LeftJson]) -> Vec<Vec<&LeftJson>> {
    let mut groups: Vec<Vec<&LeftJson>> = Vec::new();
    let mut same_reason: HashMap<(&str, &str), Vec<usize>> = HashMap::new();
    for (i, left) in all.iter().enumerate() {
        let key = (left.file.as_str(), left.reason.as_str());
        same_reason.entry(key).or_default().push(i);
    }
    for (i, left) in all.iter().enumerate() {
        let same = &same_reason[&(left.file.as_str(), left.reason.as_str())];
        if same.len() < MANY {
            groups.push(vec![left]);
        } else if same[0] == i {
            groups.push(same.iter().map(|i| &all[*i]).collect());
        }
    }
    groups
}

/// Formats parts that are left for one reason.
fn listed(group: &[&LeftJson]) -> String {
    let first = group[0];
    if let [left] = group {
        return format!(
            "{}:{}:{}: {}",
            left.file, left.line, left.column, left.reason
        );
    }
    let lines: Vec<_> = group.iter().map(|left| left.line).collect();
    format!(
        "{}: {} parts in lines {}: {}",
        first.file,
        group.len(),
        some_of(&lines, MANY),
        first.reason
    )
}
