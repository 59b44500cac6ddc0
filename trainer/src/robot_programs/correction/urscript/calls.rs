//! Calls that get targets besides the moves that are corrected: functions of the script, and functions that are in none of
//! the files, such as those of a URCap. What they do with a pose is not known, unless they only compute or tell something.

use std::collections::{BTreeSet, HashMap};

use crate::robot_programs::correction::tokens::Kind;
use crate::robot_programs::correction::urscript::lines::Line;
use crate::robot_programs::correction::urscript::states::Other;
use crate::robot_programs::correction::urscript::{MOTIONS, OTHER_MOTIONS, Reader, Variable};

/// Functions whose result is a pose or joints: what they get, gets the call around them.
const TRANSPARENT: [&str; 7] = [
    "convert_pose",
    "get_inverse_kin",
    "interpolate_pose",
    "pose_add",
    "pose_inv",
    "pose_sub",
    "pose_trans",
];

/// Functions that move nothing to the poses that they get. So do those that begin as one of [`HARMLESS_STARTS`].
const HARMLESS: [&str; 28] = [
    "abs",
    "add_frame",
    "assert",
    "attach_frame",
    "conveyor_pulse_decode",
    "end_force_mode",
    "estimate_payload",
    "freedrive_mode",
    "length",
    "list",
    "make_list",
    "mc_initialize",
    "move_frame",
    "norm",
    "path_offset_enable",
    "point_dist",
    "popup",
    "pose_dist",
    "rotvec2rpy",
    "rpy2rotvec",
    "screw_driving",
    "size",
    "textmsg",
    "to_str",
    "tool_contact",
    "track_conveyor_circular",
    "track_conveyor_linear",
    "wrench_trans",
];
const HARMLESS_STARTS: [&str; 9] = [
    "get_", "is_", "set_", "socket_", "rtde_", "write_", "read_", "str_", "ft_",
];

/// Words before a bracket that call nothing.
const KEYWORDS: [&str; 15] = [
    "if", "elif", "elsif", "while", "for", "switch", "case", "return", "and", "or", "xor", "not",
    "run", "join", "kill",
];

impl Reader<'_> {
    /// Returns which parameters each function of the script may use as targets.
    pub(super) fn moving_parameters(&self) -> HashMap<String, Vec<bool>> {
        let text = self.text;
        let mut out = HashMap::new();
        let headers = || self.lines.iter().filter(|line| line.is_definition);
        let own: Vec<String> = headers().map(|line| text.spelling(line.from + 1)).collect();
        for header in headers() {
            let open = text.find(header.from, header.end, b"(");
            let close = text.find(open + 1, header.end, b")");
            let parameters = text.arguments(open + 1, close);
            let mut used = BTreeSet::new();
            let is_inside = |line: &&Line| !line.is_definition && line.function == header.function;
            for line in self.lines.iter().filter(is_inside) {
                let word = text.name(line.from);
                if MOTIONS.contains(&word.as_str()) {
                    let points = self.points(line, &word).into_iter();
                    used.extend(points.filter_map(|point| self.variable(point)));
                }
                for at in self.calls(line) {
                    if own.contains(&text.spelling(at)) || !is_harmless(&text.name(at)) {
                        let names = self.poses(at, line.end).into_iter();
                        used.extend(names.filter_map(|at| self.name_of(at)));
                    }
                }
            }
            let is_used = |(from, _): &(usize, usize)| used.contains(&text.spelling(*from));
            let all = parameters.iter().map(is_used).collect();
            out.insert(text.spelling(open.max(1) - 1), all);
        }
        out
    }

    /// Names the calls of a line that get a pose and are not corrected.
    pub(super) fn note_calls(&mut self, line: &Line, own: &HashMap<String, Vec<bool>>) {
        let text = self.text;
        if line.is_definition {
            return;
        }
        for at in self.calls(line) {
            let name = text.name(at);
            if let Some(moving) = own.get(&text.spelling(at)) {
                let close = text.find(at + 2, line.end, b")");
                let given = text.arguments(at + 2, close).into_iter().zip(moving);
                for ((from, end), _) in given.filter(|(_, is_moving)| **is_moving) {
                    let names = self.poses_within(from, end).into_iter();
                    let names = names.filter_map(|at| self.name_of(at));
                    let others: Vec<Other> = names.map(|name| Other { name, at }).collect();
                    self.others.extend(others);
                }
                continue;
            }
            if is_harmless(&name) {
                continue;
            }
            let poses = self.poses(at, line.end);
            let names = poses.iter().filter_map(|at| self.name_of(*at));
            let others: Vec<Other> = names.map(|name| Other { name, at }).collect();
            self.others.extend(others);
            let is_pose = |at: &usize| self.name_of(*at).is_none_or(|name| self.is_pose(&name));
            if !OTHER_MOTIONS.contains(&name.as_str()) && poses.iter().any(is_pose) {
                let location = self.location(at);
                let reason = format!(
                    "{} receives a pose, and is not corrected",
                    text.spelling(at)
                );
                self.program.leave(location, reason);
            }
        }
    }

    /// Leaves the targets that are given to other calls than the moves for which they would be corrected.
    pub(super) fn leave_shared(&mut self) {
        for Other { name, at } in std::mem::take(&mut self.others) {
            let Some(Variable::Written {
                target: Some(target),
                ..
            }) = self.set.get(&name)
            else {
                continue;
            };
            let location = self.program.targets[*target].location;
            let line = self.program.line_of(self.location(at));
            let call = self.text.spelling(at);
            let reason = format!("{call} at {line} also receives it, and is not corrected");
            self.program.leave(location, reason);
        }
    }

    /// Returns the tokens of the calls in a line, besides those of moves that are corrected. Methods of other objects are none.
    fn calls(&self, line: &Line) -> Vec<usize> {
        let text = self.text;
        let is_call = |at: &usize| {
            let name = text.name(*at);
            let is_method = *at > line.from && text.is(at - 1, b'.');
            // A move within a line of something else is not corrected.
            let is_move = MOTIONS.contains(&name.as_str()) && *at == line.from;
            let is_other = !is_move && !KEYWORDS.contains(&name.as_str());
            !name.is_empty() && text.is(at + 1, b'(') && is_other && !is_method
        };
        (line.from..line.end).filter(is_call).collect()
    }

    fn poses(&self, call: usize, end: usize) -> Vec<usize> {
        let close = self.text.find(call + 2, end, b")");
        self.poses_within(call + 2, close)
    }

    /// Returns the tokens of written poses and of names between two tokens, without those in calls of their own.
    fn poses_within(&self, from: usize, end: usize) -> Vec<usize> {
        let text = self.text;
        let mut out = Vec::new();
        let mut at = from;
        while at < end {
            let name = text.name(at);
            if text.is(at + 1, b'(') && !name.is_empty() {
                at += 2;
                if !TRANSPARENT.contains(&name.as_str()) {
                    at = text.find(at, end, b")") + 1;
                }
                continue;
            }
            let is_argument_name = text.is(at + 1, b'=') && !text.is(at + 2, b'=');
            let is_name = text.at(at).is_some_and(|token| token.kind == Kind::Name);
            // An element of a pose is a number.
            let is_element = name != "p" && text.is(at + 1, b'[');
            if is_name && !is_argument_name && !is_element {
                out.push(at);
            }
            at += 1;
        }
        out
    }

    /// Returns the variable at a token; `None` for a written pose.
    fn name_of(&self, at: usize) -> Option<String> {
        let is_written = self.text.name(at) == "p" && self.text.is(at + 1, b'[') && {
            let close = self.text.find(at + 2, self.text.tokens.len(), b"]");
            self.text.arguments(at + 2, close).len() == 6
        };
        (!is_written).then(|| self.text.spelling(at))
    }

    /// Returns whether a variable is a pose: a move goes to it, or it is written as one.
    fn is_pose(&self, name: &str) -> bool {
        let is_written = match self.set.get(name) {
            Some(Variable::Written { from, .. }) => {
                self.text.name(*from) == "p" && self.text.is(from + 1, b'[')
            }
            _ => false,
        };
        is_written || self.reached.contains(name)
    }
}

fn is_harmless(name: &str) -> bool {
    HARMLESS.contains(&name)
        || TRANSPARENT.contains(&name)
        || HARMLESS_STARTS.iter().any(|start| name.starts_with(start))
}
