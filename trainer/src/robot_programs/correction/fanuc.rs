//! Reads Fanuc TP listings (`.ls`): the positions of `/POS` to which motions of `/MN` go.
//!
//! A listing names user frame and tool of each position only by number; their values come from variables of the controller
//! ([`fanuc_frames`](super::fanuc_frames)) or a frame file. Joint positions need neither. Only group 1 is the arm; other
//! groups stay as they are. (Lines and sections as in listings that controllers write.)

use std::collections::BTreeMap;

use poegp_calibration::input_error::InputError;
use poegp_runtime::math::se3::Pose;

use crate::robot_programs::Language;
use crate::robot_programs::correction::fanuc_frames;
use crate::robot_programs::correction::frames::{FrameFile, Numbered};
use crate::robot_programs::correction::program::{
    Configuration, Frame, Goal, Location, Program, Target, Way, of_turn,
};
use crate::robot_programs::correction::source::{Number, Source};
use crate::robot_programs::correction::tokens::{Kind, Lexicon, Text, Token, tokens};

const LEXICON: Lexicon = Lexicon {
    comment: 0,
    quotes: b"\"'",
    in_names: b"",
    has_pairs: false,
};

/// Options of a motion that make its end no target.
const MODIFIED: [&str; 9] = [
    "inc",
    "offset",
    "tool_offset",
    "voffset",
    "vroffset",
    "rtcp",
    "coord",
    "pspi",
    "path",
];

/// Reads a listing.
///
/// # Errors
/// [`InputError`] for a frame that is in none of the `others`, nor in the frame file.
pub fn read(source: Source, others: &[Source], frames: &FrameFile) -> Result<Program, InputError> {
    let mut all = tokens(&source.bytes, &LEXICON);
    let section = |name: &[u8]| {
        let is_start = |at: &usize| {
            let begins = *at == 0 || matches!(source.bytes.get(at - 1), Some(b'\n' | b'\r'));
            begins && source.bytes[*at..].starts_with(name)
        };
        (0..source.bytes.len())
            .find(is_start)
            .unwrap_or(source.bytes.len())
    };
    let (motions, positions) = (section(b"/MN"), section(b"/POS"));
    all.retain(|token| token.kind != Kind::LineEnd);
    let copy = source.clone();
    let mut program = Program::new("Fanuc TP", Language::Fanuc.dialect(), vec![source]);
    let within = |from: usize, to: usize| -> Vec<Token> {
        let is_inside = |token: &&Token| (from..to).contains(&(token.start as usize));
        all.iter().filter(is_inside).copied().collect()
    };
    let (code, data) = (
        within(motions, positions),
        within(positions, copy.bytes.len()),
    );
    let taught = find_positions(
        &Text {
            file: 0,
            source: &copy,
            tokens: &data,
        },
        &mut program,
    );
    find_motions(
        &Text {
            file: 0,
            source: &copy,
            tokens: &code,
        },
        &taught,
        &mut program,
        &Known {
            variables: fanuc_frames::frames(others),
            file: frames,
        },
    )?;
    Ok(program)
}

/// Sources of frames and tools.
struct Known<'a> {
    variables: Numbered,
    file: &'a FrameFile,
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
    let mut stated = None;
    for at in from..end {
        let name = text.name(at);
        if name == "config" && text.is(at + 1, b':') {
            stated = configuration(&text.spelling(at + 2));
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
        Some(n) => Some(Goal::Pose {
            position: [n[0], n[1], n[2]],
            orientation: n[3..].to_vec(),
        }),
        None if !joints.is_empty() => Some(Goal::Joints(joints)),
        None => None,
    };
    let target = match goal {
        Some(goal) if !has_more => {
            program.targets.push(Target {
                location,
                goal,
                tool: None,
                base: None,
                configuration: stated.filter(|_| is_pose),
            });
            Some(program.targets.len() - 1)
        }
        Some(_) => {
            program.leave(location, "it has external axes");
            None
        }
        None => {
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

/// Reads a configuration such as `'N U T, 0, 0, 0'`: wrist flipped (F or N), elbow, front or back, whole turns of joints
/// 1, 4 and 6.
fn configuration(text: &str) -> Option<Configuration> {
    let mut parts = text.trim_matches(['\'', '"']).split(',');
    let is_wrist_flipped = match parts.next()?.split_whitespace().next()? {
        "F" => Some(true),
        "N" => Some(false),
        _ => None,
    };
    let turns: Vec<f64> = parts.filter_map(|turn| turn.trim().parse().ok()).collect();
    let bounds = [0, 3, 5].into_iter().zip(turns);
    Some(Configuration {
        is_wrist_flipped,
        ..Configuration::monitored(bounds.map(|(joint, turn)| of_turn(joint, turn)).collect())
    })
}

fn find_motions(
    text: &Text<'_>,
    taught: &BTreeMap<u32, Taught>,
    program: &mut Program,
    given: &Known<'_>,
) -> Result<(), InputError> {
    let end = text.tokens.len();
    let mut from = 0;
    while from < end {
        let stop = text.find(from, end, b";");
        // A line begins with its number and a colon.
        let start =
            from + usize::from(text.number(from).is_some()) + usize::from(text.is(from + 1, b':'));
        motion(text, start, stop, taught, program, given)?;
        from = stop + 1;
    }
    Ok(())
}

fn motion(
    text: &Text<'_>,
    start: usize,
    stop: usize,
    taught: &BTreeMap<u32, Taught>,
    program: &mut Program,
    given: &Known<'_>,
) -> Result<(), InputError> {
    let way = match text.name(start).as_str() {
        "j" => Way::Joints,
        "l" => Way::Line,
        "c" | "a" => Way::Arc,
        _ => return Ok(()),
    };
    let is_position =
        |at: &usize| matches!(text.name(*at).as_str(), "p" | "pr") && text.is(at + 1, b'[');
    if !is_position(&(start + 1)) {
        return Ok(());
    }
    let location = Location {
        file: 0,
        at: text.byte(start),
    };
    let is_modified = |at: usize| {
        let name = text.name(at);
        MODIFIED.iter().any(|word| name == *word)
    };
    if let Some(at) = (start..stop).find(|at| is_modified(*at)) {
        program.leave(location, format!("{} changes its end", text.spelling(at)));
        return Ok(());
    }
    for at in (start + 1..stop).filter(is_position) {
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
        let tool = frame(text, taught_at, given, (tool, true), is_joints)?;
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
    let in_file = if is_tool {
        given.file.tool(number)
    } else {
        given.file.base(number)
    };
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
