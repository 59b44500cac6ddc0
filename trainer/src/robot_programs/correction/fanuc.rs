//! Reads Fanuc TP listings (`.ls`): the positions of `/POS` to which motions of `/MN` go.
//!
//! A listing names user frame and tool of each position only by number; their values come from variables of the controller
//! ([`fanuc_frames`](super::fanuc_frames)) or a frame file. Joint positions need neither. Only group 1 is the arm; other
//! groups stay as they are. (Lines and sections as in listings that controllers write.)

use std::collections::BTreeMap;

use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::fanuc_configuration::configuration;
use crate::robot_programs::correction::fanuc_frames;
use crate::robot_programs::correction::fanuc_numbers;
use crate::robot_programs::correction::fanuc_numbers::{InUse, instructions};
use crate::robot_programs::correction::fanuc_settings::{
    Sensors, changed_frames, conveyor, has_payloads, sets_payload,
};
use crate::robot_programs::correction::frames::{FrameFile, Numbered};
use crate::robot_programs::correction::program::{Frame, Goal, Location, Program, Target, Way};
use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, Token, tokens};
use crate::robot_programs::correction::unfound;

const LEXICON: Lexicon = Lexicon {
    comment: 0,
    quotes: b"\"'",
    in_names: b"",
    has_pairs: false,
};

/// Options of a motion that make its end no target.
const MODIFIED: [&str; 10] = [
    "inc",
    "offset",
    "tool_offset",
    "voffset",
    "vroffset",
    "rtcp",
    "coord",
    "pspi",
    "path",
    "search",
];

/// Reads a listing.
///
/// # Errors
/// [`InputError`] for a frame that is in none of the `others`, nor in the frame file.
pub fn read(source: Source, others: &[Source], frames: &FrameFile) -> Result<Program, InputError> {
    let mut sources = vec![source];
    // Listings that this one calls may set frames and payloads; other files have the variables of the controller.
    sources.extend(others.iter().filter(|other| is_listing(other)).cloned());
    let copies = sources.clone();
    let mut program = Program::new("Fanuc TP", Language::Fanuc.dialect(), sources);
    let copy = &copies[0];
    let (code, data): (Vec<_>, Vec<_>) = copies.iter().map(parts).unzip();
    let texts = Text::of_files(&copies, &code);
    let listing = texts[0];
    let taught = find_positions(
        &Text {
            file: 0,
            source: copy,
            tokens: &data[0],
        },
        &mut program,
    );
    let mut changed = BTreeMap::new();
    for text in &texts {
        let own = changed_frames(text, &program);
        changed = own.into_iter().chain(changed).collect();
    }
    leave_set_positions(&listing, &taught, &mut program);
    if let Some(reason) = conveyor(copy, section(copy, b"/MN")) {
        for target in taught.values().filter_map(|taught| taught.target) {
            program.leave(program.targets[target].location, reason.clone());
        }
    }
    let mut has_payloads = has_payloads(&listing, &mut program);
    let mut called = Sensors::default();
    for text in &texts[1..] {
        has_payloads |= sets_payload(text, &mut program);
        called.note_called(text, &program);
    }
    let names: Vec<String> = texts.iter().map(fanuc_numbers::name_of).collect();
    let unfound = texts.iter().flat_map(|text| {
        let calls = fanuc_numbers::calls(text).into_iter();
        let other = calls.filter(|at| !names.contains(&text.name(*at)));
        other.map(|at| {
            let (file, at_byte) = (text.file, text.byte(at));
            (text.spelling(at), Location { file, at: at_byte })
        })
    });
    unfound::note(&mut program, unfound.collect::<Vec<_>>());
    find_motions(
        &listing,
        &taught,
        &mut program,
        &Known {
            variables: fanuc_frames::frames(others),
            file: frames,
            changed,
            has_payloads,
            called,
            in_use: InUse::new(&texts),
        },
    )?;
    Ok(program)
}

/// Returns whether a file is a listing.
fn is_listing(source: &Source) -> bool {
    let ending = source.path.extension();
    ending.is_some_and(|ending| ending.eq_ignore_ascii_case("ls"))
}

/// Returns the first byte of a section of a listing, or the end of the file.
fn section(source: &Source, name: &[u8]) -> usize {
    let is_start = |at: &usize| {
        let begins = *at == 0 || matches!(source.bytes.get(at - 1), Some(b'\n' | b'\r'));
        begins && source.bytes[*at..].starts_with(name)
    };
    let end = source.bytes.len();
    (0..end).find(is_start).unwrap_or(end)
}

/// Returns the tokens of the instructions of a listing, and those of its positions.
fn parts(source: &Source) -> (Vec<Token>, Vec<Token>) {
    let (motions, positions) = (section(source, b"/MN"), section(source, b"/POS"));
    let bytes = without_remarks(&source.bytes, motions, positions);
    let mut all = tokens(&bytes, &LEXICON);
    all.retain(|token| token.kind != Kind::LineEnd);
    let within = |from: usize, to: usize| -> Vec<Token> {
        let is_inside = |token: &&Token| (from..to).contains(&(token.start as usize));
        all.iter().filter(is_inside).copied().collect()
    };
    // Behind the name of the section.
    let code = within(motions + 3, positions);
    (code, within(positions, source.bytes.len()))
}

/// Returns the bytes of a listing with blanks instead of the remarks, messages and names among the instructions: an apostrophe
/// or a bracket in these begins nothing.
fn without_remarks(bytes: &[u8], from: usize, to: usize) -> Vec<u8> {
    let mut out = bytes.to_vec();
    let mut start = from;
    while start < to {
        let length = bytes[start..to]
            .iter()
            .position(|b| matches!(b, b'\n' | b'\r'));
        let end = length.map_or(to, |length| start + length);
        let line = &bytes[start..end];
        let is_number = |b: &u8| b.is_ascii_digit() || b.is_ascii_whitespace() || *b == b':';
        let word = &line[line.iter().take_while(|b| is_number(b)).count()..];
        let is_remark = [b"!".as_slice(), b"//", b"--", b"MESSAGE["]
            .iter()
            .any(|start| word.starts_with(start));
        if is_remark {
            out[start..end].fill(b' ');
        } else {
            blank_names(&mut out[start..end]);
        }
        start = end + 1;
    }
    out
}

/// Puts blanks instead of the name in each `R[1:name]` of a line.
fn blank_names(line: &mut [u8]) {
    let mut at = 0;
    while at < line.len() {
        let digits = match line[at] {
            b'[' => line[at + 1..].iter().take_while(|b| b.is_ascii_digit()),
            _ => {
                at += 1;
                continue;
            }
        };
        let colon = at + 1 + digits.count();
        at += 1;
        if colon == at || line.get(colon) != Some(&b':') {
            continue;
        }
        let is_quoted = line.get(colon + 1) == Some(&b'"');
        let quote = line[colon + 1..].iter().skip(1).position(|b| *b == b'"');
        let name_end = match (is_quoted, quote) {
            (true, Some(quote)) => colon + 2 + quote,
            _ => colon,
        };
        let close = line[name_end..].iter().position(|b| *b == b']');
        if let Some(close) = close {
            line[colon..name_end + close].fill(b' ');
            at = name_end + close;
        }
    }
}

/// Sources of frames and tools.
struct Known<'a> {
    variables: Numbered,
    file: &'a FrameFile,
    /// Tools (true) and user frames that the listing sets, by number, each with the line; no number is any number.
    changed: BTreeMap<(bool, Option<String>), String>,
    /// Whether the listing sets payloads, so that those of the tools are not certain.
    has_payloads: bool,
    /// Sensors that a called listing leaves on.
    called: Sensors,
    /// User frame and tool in use at each motion.
    in_use: InUse,
}

/// Leaves the positions that the instructions set as they are: `P[2]=LPOS`, `P[R[1]]=PR[3]`.
fn leave_set_positions(text: &Text<'_>, taught: &BTreeMap<u32, Taught>, program: &mut Program) {
    for at in (0..text.tokens.len()).filter(|at| text.name(*at) == "p" && text.is(at + 1, b'[')) {
        let close = text.find(at + 2, text.tokens.len(), b"]");
        if !text.is(close + 1, b'=') {
            continue;
        }
        let number = text.number(at + 2).filter(|_| close == at + 3);
        let line = program.line_of(Location {
            file: 0,
            at: text.byte(at),
        });
        for (own, taught) in taught {
            let is_set = number.is_none_or(|number| number.value == f64::from(*own));
            if let (true, Some(target)) = (is_set, taught.target) {
                let location = program.targets[target].location;
                program.leave(location, format!("the program changes it at {line}"));
            }
        }
    }
}

/// A taught position of `/POS`.
struct Taught {
    target: Option<usize>,
    /// Names of user frame and tool, where they are numbers.
    frames: Option<(String, String)>,
}

fn find_positions(text: &Text<'_>, program: &mut Program) -> BTreeMap<u32, Taught> {
    let mut out = BTreeMap::new();
    let mut at = 0;
    while at < text.tokens.len() {
        if text.name(at) != "p" || !text.is(at + 1, b'[') {
            at += 1;
            continue;
        }
        let open = text.find(at + 2, text.tokens.len(), b"{");
        let close = text.find(open + 1, text.tokens.len(), b"}");
        let location = Location {
            file: 0,
            at: text.byte(at),
        };
        if let Some(number) = text.number(at + 2) {
            let taught = position(text, open + 1, close, location, program);
            out.insert(number.value as u32, taught);
        }
        at = close + 1;
    }
    out
}

/// Reads the position between two braces.
fn position(
    text: &Text<'_>,
    from: usize,
    close: usize,
    location: Location,
    program: &mut Program,
) -> Taught {
    // Only the first group is the arm.
    let is_next = |at: &usize| text.name(*at).starts_with("gp") && text.name(*at) != "gp1";
    let end = (from..close).find(is_next).unwrap_or(close);
    let mut named: BTreeMap<String, Number> = BTreeMap::new();
    let mut frames: BTreeMap<String, String> = BTreeMap::new();
    let (mut stated, mut unreadable) = (None, None);
    for at in from..end {
        let name = text.name(at);
        if name == "config" && text.is(at + 1, b':') {
            stated = configuration(text, at + 2);
            unreadable = stated.is_none().then(|| text.spelling(at + 2));
        }
        if text.is(at + 1, b'=')
            && let Some(number) = text.number(at + 2)
        {
            named.insert(name, number);
        } else if text.is(at + 1, b':') && matches!(name.as_str(), "uf" | "ut") {
            frames.insert(name, text.spelling(at + 2));
        }
    }
    let all = |names: &[&str]| -> Option<Vec<Number>> {
        names.iter().map(|name| named.get(*name).copied()).collect()
    };
    let pose = all(&["x", "y", "z", "w", "p", "r"]);
    let joints: Vec<Number> = (1..=9)
        .map_while(|i| named.get(&format!("j{i}")).copied())
        .collect();
    let has_more = named
        .keys()
        .any(|name| name.starts_with('e') && name[1..].parse::<u8>().is_ok());
    let is_pose = pose.is_some();
    let goal = match pose {
        Some(n) => Some(Goal::pose(&n)),
        None if !joints.is_empty() => Some(Goal::Joints(joints)),
        None => None,
    };
    let unreadable = unreadable.filter(|_| is_pose && !has_more);
    let target = match (goal, unreadable) {
        (Some(_), Some(found)) => {
            let reason = format!("its configuration {found} is not one such as 'N U T, 0, 0, 0'");
            program.leave(location, reason);
            None
        }
        (Some(goal), None) if !has_more => {
            let configuration = stated.filter(|_| is_pose);
            program
                .targets
                .push(Target::new(location, goal, configuration));
            Some(program.targets.len() - 1)
        }
        (Some(_), None) => {
            program.leave(location, "it has external axes");
            None
        }
        (None, _) => {
            program.leave(location, "it was never taught");
            None
        }
    };
    let number = |name: &str| {
        let value = frames.get(name)?;
        value
            .bytes()
            .all(|b| b.is_ascii_digit())
            .then(|| value.clone())
    };
    let frames = number("uf").zip(number("ut"));
    Taught { target, frames }
}

fn find_motions(
    text: &Text<'_>,
    taught: &BTreeMap<u32, Taught>,
    program: &mut Program,
    given: &Known<'_>,
) -> Result<(), InputError> {
    let mut sensors = Sensors::new(text, program);
    for (start, stop) in instructions(text) {
        sensors.note(text, start, program);
        let shift = sensors.reason().or(given.called.reason());
        motion(text, (start, stop), taught, program, (given, shift))?;
    }
    Ok(())
}

fn motion(
    text: &Text<'_>,
    (start, stop): (usize, usize),
    taught: &BTreeMap<u32, Taught>,
    program: &mut Program,
    (given, shift): (&Known<'_>, Option<String>),
) -> Result<(), InputError> {
    let way = match text.name(start).as_str() {
        "j" => Way::Joints,
        "l" => Way::Line,
        "c" | "a" | "s" => Way::Arc,
        _ => return Ok(()),
    };
    let is_position =
        |at: &usize| matches!(text.name(*at).as_str(), "p" | "pr") && text.is(at + 1, b'[');
    let location = Location {
        file: 0,
        at: text.byte(start),
    };
    if !is_position(&(start + 1)) {
        let end = text.spelling(start + 1);
        program.leave(location, format!("its end {end} is not P[n]"));
        return Ok(());
    }
    let points = 1 + usize::from(text.name(start) == "c");
    let (mut goals, mut others): (Vec<usize>, Vec<usize>) = (Vec::new(), Vec::new());
    for at in (start + 1..stop).filter(is_position) {
        let list = if goals.len() < points {
            &mut goals
        } else {
            &mut others
        };
        list.push(at);
    }
    let is_modified = |at: &usize| MODIFIED.contains(&text.name(*at).as_str());
    // A register behind the positions is an offset, in whatever language of the controller, unless it is set: PR[3]=LPOS.
    let is_offset = |at: &usize| !text.is(text.find(*at + 2, stop, b"]") + 1, b'=');
    let modified = (start..stop).find(is_modified);
    let modified = modified.or_else(|| others.into_iter().find(is_offset));
    let modified = modified.map(|at| format!("{} changes its end", text.spelling(at)));
    let is_spline = text.name(start) == "s";
    let modified = modified.or(is_spline.then(|| "a spline move is not corrected".to_owned()));
    if let Some(reason) = modified.or(shift) {
        program.leave(location, reason);
        let numbers = goals.iter().filter_map(|at| text.number(at + 2));
        let targets = numbers.filter_map(|number| taught.get(&(number.value as u32))?.target);
        program.reached_otherwise.extend(targets);
        return Ok(());
    }
    for at in goals {
        if text.name(at) == "pr" {
            program.leave(location, "it goes to a position register");
            continue;
        }
        let Some(number) = text.number(at + 2) else {
            program.leave(location, "its position is computed");
            continue;
        };
        let number = number.value as u32;
        let Some(found) = taught.get(&number) else {
            program.leave(location, format!("P[{number}] is not in /POS"));
            continue;
        };
        let Some(target) = found.target else {
            continue;
        };
        let is_joints = matches!(program.targets[target].goal, Goal::Joints(_));
        let taught_at = program.targets[target].location;
        let Some((user, tool)) = &found.frames else {
            program.leave(taught_at, "its frame or tool is the one in use (F)");
            continue;
        };
        let changed = [(true, tool), (false, user)]
            .into_iter()
            .find_map(|(is_tool, name)| {
                let of = |number| given.changed.get(&(is_tool, number));
                of(Some(name.clone())).or_else(|| of(None))
            });
        if let Some(line) = changed.filter(|_| !is_joints) {
            let reason = format!("its frame or tool is set at {line}");
            program.leave(taught_at, reason);
            continue;
        }
        let other = given.in_use.other(start, (user, tool), program);
        if let Some(reason) = other.filter(|_| !is_joints) {
            program.leave(taught_at, reason);
            continue;
        }
        let mut tool = frame(text, taught_at, given, (tool, true), is_joints)?;
        if given.has_payloads {
            tool.payload_kg = None;
        }
        let user = frame(text, taught_at, given, (user, false), is_joints)?;
        let (tool, user) = (program.frame(tool), program.frame(user));
        program.move_to(target, way, tool, user);
    }
    Ok(())
}

/// Returns a frame by its number. Number 0 is no frame, and joint positions need none.
fn frame(
    text: &Text<'_>,
    location: Location,
    given: &Known<'_>,
    (number, is_tool): (&str, bool),
    is_joints: bool,
) -> Result<Frame, InputError> {
    let in_file = given.file.named(number, is_tool);
    let own = number.parse().ok();
    let own = own.and_then(|n| given.variables.get(&(is_tool, n)));
    let weight = in_file.and_then(|found| found.payload_kg);
    let (pose, payload_kg, origin) = match (own, in_file) {
        // Variables of the controller have no weights.
        (Some((own, origin)), _) => (own.pose, weight, origin.clone()),
        (None, Some(found)) => (found.pose, weight, given.file.origin()),
        (None, None) if number == "0" || is_joints => {
            (Pose::identity(), None, "the controller".to_owned())
        }
        (None, None) => {
            let (kind, data) = if is_tool {
                ("tool", "UT of")
            } else {
                ("base", "UF of")
            };
            let error = given
                .file
                .unknown(text.source, location.at, kind, number, data);
            return Err(error);
        }
    };
    let name = format!("{} {number}", if is_tool { "UT" } else { "UF" });
    Ok(Frame {
        name,
        is_tool,
        pose,
        payload_kg,
        origin,
    })
}
