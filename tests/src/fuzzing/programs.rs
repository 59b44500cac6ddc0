//! Fuzzes the readers of robot programs with arbitrary bytes.

use std::path::Path;

use poegp_trainer::robot_programs::correction::Format;
use poegp_trainer::robot_programs::correction::frames::FrameFile;
use poegp_trainer::robot_programs::correction::program::{Goal, Program, Way};
use poegp_trainer::robot_programs::correction::replacement::{Replacement, rewrite};
use poegp_trainer::robot_programs::correction::source::{Number, Source};

use super::readers::{assert_refusal, parts};

const FRAMES: &str = "[tool.3]\nxyz_mm=[1,2,3]\nquaternion=[1,0,0,0]\n[tool.tcp]\nxyz_mm=[1,2,3]\nquaternion=[1,0,0,0]\n\
    [base.2]\nxyz_mm=[1,2,3]\nquaternion=[0,1,0,0]\n";

/// Returns all numbers of all targets, in the order of the files.
fn numbers(program: &Program) -> Vec<Number> {
    let mut out: Vec<Number> = Vec::new();
    for target in &program.targets {
        match &target.goal {
            Goal::Joints(numbers) => out.extend(numbers.iter()),
            Goal::Pose {
                position,
                orientation,
            } => {
                out.extend(position);
                out.extend(orientation);
            }
        }
    }
    out.sort_by_key(|number| (number.file, number.start));
    out
}

/// Reads the files of one program, separated by zeros. Every number of a target must be a number, and no two overlap. If they
/// are replaced, all other bytes stay. The place of everything that is left uncorrected is within its file.
fn read(format: Format, names: &[&str], bytes: &[u8]) {
    let parts = parts(bytes, names.len());
    let files: Vec<(&str, &[u8])> = names
        .iter()
        .copied()
        .zip(parts.iter().map(Vec::as_slice))
        .collect();
    let source = |(name, bytes): &(&str, &[u8])| {
        let is_corrected = !name.ends_with("CND") && !name.ends_with("VA");
        Source::new(Path::new(name), bytes.to_vec(), is_corrected)
    };
    let frames = FrameFile::parse(Path::new("frames.toml"), FRAMES).expect("frames");
    let program = match format.read(files.iter().map(source).collect(), &frames) {
        Ok(program) => program,
        Err(error) => return assert_refusal(&error, &files),
    };
    for left in &program.left {
        assert!(left.location.at <= program.sources[left.location.file].bytes.len());
        assert!(!left.reason.is_empty());
        let _ = program.line_of(left.location);
    }
    for step in &program.moves {
        let target = &program.targets[step.target];
        assert!(target.tool.is_some_and(|tool| program.frames[tool].is_tool));
        assert!(
            target
                .base
                .is_some_and(|base| !program.frames[base].is_tool)
        );
    }
    // A line that others can be inserted before has its target within its instruction, and a move before it.
    for line in &program.lines {
        let ((start, end), target) = (line.instruction, line.target);
        assert!(start < target.0 && target.0 < target.1 && target.1 <= end);
        assert!(end <= program.sources[line.file].bytes.len());
        assert!(line.step > 0 && program.moves[line.step].way == Way::Line);
    }
    let mut numbers = numbers(&program);
    // A target that two moves use occurs once in its file.
    numbers.dedup();
    let mut replacements = Vec::new();
    let mut before = (0, 0);
    for number in &numbers {
        let source = &program.sources[number.file as usize];
        let text = std::str::from_utf8(source.slice(&number.span())).expect("digits");
        assert_eq!(text.parse::<f64>().ok(), Some(number.value), "{text:?}");
        assert!(before <= (number.file, number.start), "numbers overlap");
        before = (number.file, number.end);
        let span = (number.start as usize, number.end as usize);
        replacements.push(Replacement {
            file: number.file as usize,
            span,
            text: b"<>".to_vec(),
        });
    }
    for ((_, bytes), (written, inserted)) in files.iter().zip(rewrite(&program, &replacements)) {
        assert!(inserted.is_empty());
        // Replaces each mark by its number again: every other byte must be unchanged.
        let mut rest = written.as_slice();
        let mut back = Vec::new();
        let file = files
            .iter()
            .position(|f| f.1.as_ptr() == bytes.as_ptr())
            .expect("a file");
        let mut from = 0;
        for r in replacements.iter().filter(|r| r.file == file) {
            let gap = r.span.0 - from;
            back.extend_from_slice(&rest[..gap]);
            back.extend_from_slice(&bytes[r.span.0..r.span.1]);
            rest = &rest[gap + 2..];
            from = r.span.1;
        }
        back.extend_from_slice(rest);
        assert!(back == *bytes, "bytes outside of the numbers changed");
    }
}

/// Reads an ABB module.
///
/// # Panics
/// When a law is broken.
pub fn rapid(bytes: &[u8]) {
    read(Format::Rapid, &["part.mod"], bytes);
}

/// Reads a script of Universal Robots.
///
/// # Panics
/// When a law is broken.
pub fn urscript(bytes: &[u8]) {
    read(Format::UrScript, &["part.script"], bytes);
}

/// Reads a Fanuc listing and, after a zero byte, variables of the controller.
///
/// # Panics
/// When a law is broken.
pub fn fanuc(bytes: &[u8]) {
    let names: &[&str] = if bytes.contains(&0) {
        &["part.ls", "SYSFRAME.VA"]
    } else {
        &["part.ls"]
    };
    read(Format::Fanuc, names, bytes);
}

/// Reads a KUKA source and, after a zero byte, its data list.
///
/// # Panics
/// When a law is broken.
pub fn krl(bytes: &[u8]) {
    let names: &[&str] = if bytes.contains(&0) {
        &["part.src", "part.dat"]
    } else {
        &["part.src"]
    };
    read(Format::Krl, names, bytes);
}

/// Reads a Yaskawa job and, after a zero byte, a condition file.
///
/// # Panics
/// When a law is broken.
pub fn inform(bytes: &[u8]) {
    let names: &[&str] = if bytes.contains(&0) {
        &["part.jbi", "TOOL.CND"]
    } else {
        &["part.jbi"]
    };
    read(Format::Inform, names, bytes);
}

/// Reads a table of poses.
///
/// # Panics
/// When a law is broken.
pub fn table(bytes: &[u8]) {
    read(Format::Table, &["part.csv"], bytes);
}

/// Reads data of a Stäubli controller and, after a zero byte, the program that uses them.
///
/// # Panics
/// When a law is broken.
pub fn val3(bytes: &[u8]) {
    let names: &[&str] = if bytes.contains(&0) {
        &["part.dtx", "part.pgx"]
    } else {
        &["part.dtx"]
    };
    read(Format::Val3, names, bytes);
}
