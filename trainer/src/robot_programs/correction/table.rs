//! Reads CSV files with poses, from which a post processor for any other controller can be fed.
//!
//! ```text
//! x_mm y_mm z_mm         the wanted position of the tool in its base; also _m
//! qw qx qy qz            the wanted orientation, or rx_rad ry_rad rz_rad, axis times angle
//! tool, base             optional: names in the file of --frames; without a name the flange, and the base of the robot
//! payload_kg             optional, for --payload-from-program
//! seed_q1_deg … _qn_deg  optional: joints near the wanted ones, also _rad, and _mm or _m for a slide; where they are empty,
//!                        those of the row before
//! ```
//!
//! Without seed columns the rows are no path: each stands alone, and nothing states its branch.
//!
//! Upper and lower case are equal in these names. A file with joint columns (`q1_deg` …) has joint targets, whatever its other
//! columns are. Columns of other names stay as they are; those that seem to name tools or bases are refused or noted
//! ([`table_columns`](super::table_columns)).

use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::Path;

use poegp_calibration::input_error::{InputError, counted};
use poegp_calibration::measurement::JointUnit;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::correction::frames::FrameFile;
use crate::robot_programs::correction::program::{
    Configuration, Frame, Goal, Location, Program, Target, Way,
};
use crate::robot_programs::correction::seeds::Seeds;
use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::correction::table_columns::Check;
use crate::robot_programs::dialect::{Dialect, MILLIMETRES, Orientation};

/// Largest number of bytes in which a header is looked for.
const LONGEST_HEADER: u64 = 1 << 20;
/// Name of the column of payloads.
const PAYLOAD: &str = "payload_kg";

/// Returns whether the header of a file has poses and no joints.
pub fn has_poses(path: &Path) -> bool {
    let names = header(path);
    let has = |name: &str| names.iter().any(|found| found == name);
    let has_joints = names.iter().any(|name| is_joint(name));
    !has_joints && (has("x_mm") || has("x_m")) && (has("qw") || has("rx_rad"))
}

/// Returns whether the header of a file has payloads.
pub fn has_payloads(path: &Path) -> bool {
    header(path).iter().any(|name| name == PAYLOAD)
}

/// Returns the names of the columns of a file in lower case; none where it cannot be read.
fn header(path: &Path) -> Vec<String> {
    let mut bytes = Vec::new();
    let start = File::open(path).and_then(|file| file.take(LONGEST_HEADER).read_to_end(&mut bytes));
    if start.is_err() {
        return Vec::new();
    }
    let source = Source::new(path, bytes, false);
    let header = records(&source.bytes).next().unwrap_or_default();
    lower(&names(&source, &header))
}

/// Returns whether a column is a joint, such as `q1_deg`.
fn is_joint(name: &str) -> bool {
    let number = name.strip_prefix('q').and_then(|rest| rest.split_once('_'));
    number.is_some_and(|(number, _)| number.parse::<u8>().is_ok())
}

/// Largest angle of a rotation vector in a table: a full turn, and what it loses by rounding.
const MAX_TURN: f64 = std::f64::consts::TAU + 1e-3;

/// Reads a table of poses.
///
/// # Errors
/// [`InputError`] for a column that is missing, a field that is no number, and a frame that is not in the frame file.
pub fn read(source: Source, frames: &FrameFile) -> Result<Program, InputError> {
    let copy = source.clone();
    let mut rows = records(&copy.bytes);
    let header = rows.next().unwrap_or_default();
    let columns = Columns::of(&copy, &header)?;
    let mut program = Program::new("CSV with poses", columns.dialect, vec![source]);
    let titles = names(&copy, &header);
    let (line, _) = copy.line_and_column(header.first().map_or(0, |field| field.start));
    let mut check = Check::new(&lower(&titles), frames);
    for fields in rows {
        // The location of a row is the beginning of its line.
        let first = fields.first().map_or(0, |field| field.start);
        let (line, column) = copy.line_and_column(first);
        let at = first + 1 - column;
        let refused = |column: usize, found: String, expected: &str| {
            InputError::new(&copy.path, found, expected)
                .at_line(line)
                .at_column(column + 1, &titles[column])
        };
        if fields.len() != header.len() {
            let expected = format!("{}, as many as the header has", header.len());
            let found = counted(fields.len(), "field");
            return Err(InputError::new(&copy.path, found, expected).at_line(line));
        }
        for (column, span) in fields.iter().enumerate() {
            check.note(column, &text(&copy, span));
        }
        let number = |column: usize| -> Result<Number, InputError> {
            let span = &fields[column];
            Number::parse(0, &copy, span)
                .ok_or_else(|| refused(column, copy.quoted(span), "a number"))
        };
        let all = |columns: &[usize]| -> Result<Vec<Number>, InputError> {
            columns.iter().map(|column| number(*column)).collect()
        };
        let [x, y, z] = columns.position;
        let is_first = program.targets.is_empty();
        let near = |seeds: &Seeds| -> Result<Option<Vec<f64>>, InputError> {
            let is_empty = |(column, _): (usize, JointUnit)| fields[column].is_empty();
            if !is_first && seeds.fields().all(is_empty) {
                return Ok(None);
            }
            let value = |(column, unit): (usize, JointUnit)| Ok(unit.to_si(number(column)?.value));
            seeds
                .fields()
                .map(value)
                .collect::<Result<_, _>>()
                .map(Some)
        };
        let seed = columns.seeds.as_ref().map(near).transpose()?.flatten();
        let orientation = all(&columns.orientation)?;
        let turn: f64 = orientation
            .iter()
            .map(|n| n.value * n.value)
            .sum::<f64>()
            .sqrt();
        if columns.dialect.orientation == Orientation::RotationVector && turn > MAX_TURN {
            let found = format!("a rotation vector of {turn:.4} rad");
            return Err(
                refused(columns.orientation[0], found, "at most a full turn, 2π rad")
                    .with_help("if it is in degrees, convert it to radians"),
            );
        }
        let goal = Goal::Pose {
            position: [number(x)?, number(y)?, number(z)?],
            orientation,
        };
        let configuration = seed.map(|near| Configuration {
            near: Some(near),
            ..Configuration::default()
        });
        let location = Location { file: 0, at };
        program
            .targets
            .push(Target::new(location, goal, configuration));
        let named = |column: Option<usize>, is_tool, payload_kg| -> Result<Frame, InputError> {
            let name = column.map_or(String::new(), |column| text(&copy, &fields[column]));
            frame(frames, is_tool, &name, payload_kg).ok_or_else(|| {
                let kind = if is_tool { "tool" } else { "base" };
                let found = format!("the {kind} \"{name}\", which no file defines");
                let expected = format!("[{kind}.\"{name}\"] in a file of --frames");
                refused(column.unwrap_or(0), found, &expected)
                    .with_help("give its numbers with --frames FILE.toml")
            })
        };
        let payload_kg = match columns.payload {
            Some(column) => Some(number(column)?.value),
            None => None,
        };
        let tool = program.frame(named(columns.tool, true, payload_kg)?);
        let base = program.frame(named(columns.base, false, None)?);
        let target = program.targets.len() - 1;
        program.move_to(target, Way::Joints, tool, base);
    }
    program.is_path = columns.seeds.is_some();
    program.seeds = columns.seeds;
    program.remarks = check.finish(&copy.path, line, &titles)?;
    Ok(program)
}

/// Returns a tool or a base by its name; an empty name is the flange or the robot's base.
fn frame(given: &FrameFile, is_tool: bool, name: &str, payload_kg: Option<f64>) -> Option<Frame> {
    if name.is_empty() {
        let (own, kind) = if is_tool {
            ("flange", "tool")
        } else {
            ("robot", "base")
        };
        return Some(Frame {
            name: own.to_owned(),
            is_tool,
            pose: Pose::identity(),
            payload_kg,
            origin: format!("rows that name no {kind}"),
        });
    }
    let key = name.to_lowercase();
    let found = given.named(&key, is_tool)?;
    Some(Frame {
        name: name.to_owned(),
        is_tool,
        pose: found.pose,
        payload_kg: payload_kg.or(found.payload_kg),
        origin: given.origin(),
    })
}

/// Indices of the columns with a meaning.
struct Columns {
    position: [usize; 3],
    orientation: Vec<usize>,
    tool: Option<usize>,
    base: Option<usize>,
    payload: Option<usize>,
    seeds: Option<Seeds>,
    dialect: Dialect,
}

impl Columns {
    fn of(source: &Source, header: &[Range<usize>]) -> Result<Self, InputError> {
        let titles = names(source, header);
        let names = lower(&titles);
        let find = |name: &str| names.iter().position(|found| found == name);
        let first = header.first().map_or(0, |field| field.start);
        let (line, _) = source.line_and_column(first);
        for (index, name) in names.iter().enumerate() {
            if is_known(name)
                && let Some(other) = find(name).filter(|other| *other < index)
            {
                let found = format!("a second column {}", titles[index]);
                let expected = format!("one, which is column {} ({})", other + 1, titles[other]);
                return Err(InputError::new(&source.path, found, expected)
                    .at_line(line)
                    .at_column(index + 1, &titles[index]));
            }
        }
        let needed = |name: &str| {
            find(name).ok_or_else(|| {
                let found = format!("the columns {}", names.join(", "));
                InputError::new(&source.path, found, format!("a column {name}")).at_line(line)
            })
        };
        let (unit, metre, decimals) = match find("x_mm") {
            Some(_) => ("mm", 1e-3, 3),
            None => ("m", 1.0, 6),
        };
        let (orientation, columns) = match find("qw") {
            Some(_) => (Orientation::Quaternion, ["qw", "qx", "qy", "qz"].as_slice()),
            None => (
                Orientation::RotationVector,
                ["rx_rad", "ry_rad", "rz_rad"].as_slice(),
            ),
        };
        let position = |axis: &str| needed(&format!("{axis}_{unit}"));
        Ok(Self {
            position: [position("x")?, position("y")?, position("z")?],
            orientation: columns
                .iter()
                .map(|name| needed(name))
                .collect::<Result<_, _>>()?,
            tool: find("tool"),
            base: find("base"),
            payload: find(PAYLOAD),
            seeds: Seeds::of(source, line, &names)?,
            dialect: Dialect {
                metre,
                length_decimals: decimals,
                orientation,
                ..MILLIMETRES
            },
        })
    }
}

/// Returns whether a column has a meaning by its name in lower case.
fn is_known(name: &str) -> bool {
    const KNOWN: [&str; 16] = [
        "x_mm", "y_mm", "z_mm", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "rx_rad", "ry_rad",
        "rz_rad", "tool", "base", PAYLOAD,
    ];
    KNOWN.contains(&name) || name.starts_with("seed_q")
}

fn lower(names: &[String]) -> Vec<String> {
    names.iter().map(|name| name.to_lowercase()).collect()
}

fn names(source: &Source, header: &[Range<usize>]) -> Vec<String> {
    header.iter().map(|span| text(source, span)).collect()
}

fn text(source: &Source, span: &Range<usize>) -> String {
    String::from_utf8_lossy(source.slice(span)).into_owned()
}

/// Returns the fields of every record, without the spaces and quotation marks around them. Skips lines that are empty or
/// begin with #.
fn records(bytes: &[u8]) -> impl Iterator<Item = Vec<Range<usize>>> {
    // Skips a byte order mark.
    let mut at = if bytes.starts_with(&[0xef, 0xbb, 0xbf]) {
        3
    } else {
        0
    };
    std::iter::from_fn(move || {
        while at < bytes.len() {
            let line = bytes[at..].iter().position(|b| matches!(b, b'\n' | b'\r'));
            let line = at..line.map_or(bytes.len(), |end| at + end);
            // A quotation in a comment ends with its line.
            let span = trimmed(bytes, line.clone());
            if span.is_empty() || bytes[span.start] == b'#' {
                at = line.end + 1;
                continue;
            }
            let (fields, end) = record(bytes, at);
            at = end;
            return Some(fields);
        }
        None
    })
}

/// Returns one record from `at`, and the beginning of the next.
fn record(bytes: &[u8], mut at: usize) -> (Vec<Range<usize>>, usize) {
    let mut fields = Vec::new();
    let (mut start, mut is_quoted) = (at, false);
    while let Some(byte) = bytes.get(at) {
        match byte {
            b'"' => is_quoted = !is_quoted,
            b',' if !is_quoted => {
                fields.push(trimmed(bytes, start..at));
                start = at + 1;
            }
            b'\n' | b'\r' if !is_quoted => break,
            _ => {}
        }
        at += 1;
    }
    fields.push(trimmed(bytes, start..at));
    (fields, at + 1)
}

/// Removes the spaces around a span, and then one pair of quotation marks.
fn trimmed(bytes: &[u8], span: Range<usize>) -> Range<usize> {
    let (mut start, mut end) = (span.start, span.end);
    while start < end && matches!(bytes[start], b' ' | b'\t') {
        start += 1;
    }
    while start < end && matches!(bytes[end - 1], b' ' | b'\t') {
        end -= 1;
    }
    match end - start >= 2 && bytes[start] == b'"' && bytes[end - 1] == b'"' {
        true => start + 1..end - 1,
        false => start..end,
    }
}
