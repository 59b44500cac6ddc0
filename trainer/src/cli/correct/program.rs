//! `trainer correct` for controllers' programs: targets are corrected in place, and every other byte stays as it was.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::cli::correct::args::{Correct, two_payloads};
use crate::cli::correct::document::{LeftJson, ProgramJson, SplitJson, document};
use crate::cli::correct::page::page;
use crate::cli::correct::record::{
    Corrector, Record, Records, record_path, sha256, warn_of_uncorrected,
};
use crate::cli::failure::Failure;
use crate::cli::inputs::now;
use crate::cli::output::{check_outputs, json_text, write_outputs};
use crate::cli::terminal::print::{Printer, is_stdout};
use crate::report::{FileSummary, Provenance};
use crate::robot_programs::correction::Format;
use crate::robot_programs::correction::between::{Between, between, stretches};
use crate::robot_programs::correction::engine::{self, Direction, Outcome};
use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::planning::Payload;
use crate::robot_programs::correction::program::Program;
use crate::robot_programs::correction::replacement::rewrite;
use crate::robot_programs::correction::source::Source;
use crate::robot_programs::correction::split::split;
use crate::signing::unsigned;
use poegp_calibration::blob::commander::Commander;
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::some_of;
use poegp_calibration::input_error::{InputError, counted};
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

/// The path that is read and the path that is written, for each file.
type Files = Vec<(PathBuf, PathBuf)>;

/// Corrects the programs and writes the outputs; returns all output paths, the files, and the JSON document.
pub fn corrected(
    a: &Correct,
    format: Format,
) -> Result<(Vec<Option<PathBuf>>, Files, ProgramJson), Failure> {
    let is_folder = a.programs.len() > 1 || a.out.is_dir();
    // For each file, the path that is read and the path that is written.
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
            "one for the corrected files of several programs",
        )
        .with_help("create this folder first")
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
    outputs.extend([a.json.as_deref(), a.report.as_deref()]);
    let mut beside: Vec<PathBuf> = a.programs.iter().flat_map(|p| format.beside(p)).collect();
    beside.sort();
    beside.dedup();
    let mut inputs: Vec<&Path> = vec![&a.blob];
    let others = a.with.iter().chain(&beside).chain(&a.frames);
    inputs.extend(
        files
            .iter()
            .map(|(path, _)| path)
            .chain(others)
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
    if a.payload_kg.is_some()
        && let Some(table) = a.programs.iter().find(|path| format.has_payloads(path))
    {
        return Err(two_payloads(table));
    }
    if let Some(mm) = a.split.filter(|mm| !(LEAST_SPLIT_MM..=1e3).contains(mm)) {
        return Err(Failure::Usage(format!(
            "--split {mm}: expected millimetres, {LEAST_SPLIT_MM} to 1000"
        )));
    }
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
    let model = sha256(&unsigned(loaded.bytes()));
    let (mut sources, mut hashes) = (Vec::new(), Vec::new());
    let mut records_there = Records::default();
    let mut corrections = Vec::new();
    for (index, (path, _)) in files.iter().enumerate() {
        let mut source = Source::read(path, true)?;
        hashes.push(sha256(&source.bytes));
        if let Some(record) = records_there.of_corrected(path, &source.bytes, &model, direction)? {
            // The insertions of the earlier correction are removed.
            source = source.without(&record.inserted).ok_or_else(|| {
                let found = "a record whose insertions are beyond the program";
                InputError::new(record_path(path), found, "the record that `correct` wrote")
            })?;
            corrections.push((index, record));
        }
        sources.push(source);
    }
    if direction == Direction::Inverse {
        let all = files.iter().zip(&hashes).enumerate();
        warn_of_uncorrected(all.map(|(index, ((path, _), hash))| {
            let is_found = corrections.iter().any(|(corrected, _)| *corrected == index);
            (path.as_path(), hash.as_str(), is_found)
        }));
    }
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
    if format != Format::Table {
        refuse_slides(a, &program, &commander)?;
    }
    let mut outcome = engine::solve(&program, &commander, payload, direction)?;
    for (index, record) in &corrections {
        if !record.is_undone(&commander, (&program, &outcome.solved, *index)) {
            let found =
                "a program that was corrected with another payload, or with other tools or frames";
            let expected = format!("those with which {} was corrected", record.source);
            return Err(InputError::new(&files[*index].0, found, expected).into());
        }
    }
    let has_payloads = program
        .frames
        .iter()
        .any(|frame| frame.payload_kg.is_some());
    if let (Format::Table, Some(kg), true) = (format, a.payload_kg, has_payloads) {
        outcome.remarks.push(format!(
            "payload_kg of the file of --frames is not used: all rows have the {kg} kg of --payload-kg"
        ));
    }
    let (ends, split) = ends(a, &program, &commander, &mut outcome);
    let results = rewrite(&program, &outcome.replacements);
    let method = loaded.host().provenance.method;
    let document = document(&program, &outcome, &ends, split, (method, payload));
    let page = a.report.as_deref().map(|path| {
        let origin = provenance(a, &loaded, &program);
        (path, page(&document, &program, &outcome, &ends, &origin))
    });
    let json = a
        .json
        .as_deref()
        .map(|_| json_text(&document))
        .transpose()?;
    let mut record_texts = Vec::new();
    let robot = &loaded.blob().robot;
    let corrector = Corrector {
        robot: robot.name,
        joints: robot.joints.len(),
        sha256: &model,
        direction,
    };
    let results_of_files = files.iter().zip(hashes.iter().zip(&results));
    for (index, ((path, _), (hash, result))) in results_of_files.enumerate() {
        let solved = (&program, outcome.solved.as_slice(), index);
        let record = Record::new(path, &corrector, hash, result, solved);
        record_texts.push(json_text(&record)?);
    }
    let mut written: Vec<(&Path, &[u8])> = Vec::new();
    if !a.dry_run {
        let results = files.iter().zip(&results);
        written.extend(results.map(|((_, out), (result, _))| (out.as_path(), result.as_slice())));
    }
    if !is_stream && !a.dry_run {
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
    written.extend(page.iter().map(|(path, html)| (*path, html.as_bytes())));
    write_outputs(&written)?;
    let outputs = outputs.iter().map(|path| path.map(Path::to_path_buf));
    Ok((outputs.collect(), files, document))
}

/// Refuses a controller's program for an arm with a slide. These languages have slides as external axes, whose targets stay
/// as they are, and the numbers of their targets are angles.
fn refuse_slides(a: &Correct, program: &Program, commander: &Commander) -> Result<(), InputError> {
    let mut kinds = commander.kinds().iter();
    let Some(slide) = kinds.position(|kind| *kind == JointKind::Prismatic) else {
        return Ok(());
    };
    let found = format!(
        "a program in {} for a model whose joint {} slides",
        program.language,
        slide + 1
    );
    let expected =
        "a model of an arm whose joints all turn: the joints of such a target are angles";
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
    if a.inverse {
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
             --payload-from-program for what the program says of its tools"
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
    let done = match a.inverse {
        true => "restored to the nominal arm",
        false => "corrected",
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
    if let (Some(before), Some(after), false) = (&d.before_mm, &d.after_um, a.inverse) {
        report.line(format_args!(
            "According to the model, the tool error at the corrected targets is {:.3} mm on average and {:.3} mm at \
             most without the correction, {:.2} µm on average and {:.2} µm at most with it, and up to {:.2} µm more \
             from the decimals of the file.",
            before.mean, before.max, after.mean, after.max, d.rounding_um
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
    let what = match a.inverse {
        true => "restored",
        false => "corrected, or only partially",
    };
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
    text += match (a.dry_run, a.inverse) {
        _ if d.targets == 0 => match a.inverse {
            true => "\nhelp: nothing was restored",
            false => "\nhelp: nothing was corrected: the output equals the input",
        },
        (true, false) => "\nhelp: everything else would be corrected",
        (true, true) => "\nhelp: everything else would be restored",
        (false, false) => "\nhelp: everything else was corrected and written",
        (false, true) => "\nhelp: everything else was restored and written",
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
