//! Moves to named targets besides those that are corrected: in modules that are only read, to parameters of routines, and
//! in instructions such as `SearchL` or `SpotL`. A target that such a move reaches with other frames is left as it is.

use std::collections::{BTreeSet, HashMap};

use crate::robot_programs::correction::program::{Frame, Goal};
use crate::robot_programs::correction::rapid::data::Setting;
use crate::robot_programs::correction::rapid::statements::{Routine, Statement, is_instruction};
use crate::robot_programs::correction::rapid::states::{DISPLACED, Goes, LOADED, Other, States};
use crate::robot_programs::correction::rapid::syntax::{arguments, shape};
use crate::robot_programs::correction::rapid::{Reader, State};
use crate::robot_programs::correction::tokens::Kind;

/// Instructions and functions that go to their target with their tool, and are not corrected.
pub(super) const PROCESSES: [&str; 18] = [
    "calcjointt",
    "capc",
    "capl",
    "egmmovec",
    "egmmovel",
    "fcpress1lstart",
    "fcpressc",
    "fcpressend",
    "fcpressl",
    "paintc",
    "paintl",
    "searchc",
    "searchj",
    "searchl",
    "spotj",
    "spotl",
    "spotmj",
    "spotml",
];

impl Reader<'_> {
    /// Notes the moves of a statement that [`Reader::motion`] does not note.
    pub(super) fn note_others(&mut self, s: &Statement, states: &States, step: usize) {
        let text = self.texts[s.file];
        let word = text.name(s.from);
        let is_own = self.routine(&word, s.file).is_some();
        if !is_own && (is_instruction(&word) || is_process(&word)) {
            self.note_other(s, &word, (s.from + 1, s.end), (states, step));
        }
        let is_call = |at: &usize| {
            let is_name = text.at(*at).is_some_and(|t| t.kind == Kind::Name);
            is_name && text.is(at + 1, b'(') && is_process(&text.name(*at))
        };
        for at in (s.from + 1..s.end).filter(is_call) {
            let close = text.find(at + 2, s.end, b")");
            self.note_other(s, &text.name(at), (at + 2, close), (states, step));
        }
    }

    fn note_other(
        &mut self,
        s: &Statement,
        name: &str,
        (from, end): (usize, usize),
        (states, step): (&States, usize),
    ) {
        let text = self.texts[s.file];
        let shape = shape(name).filter(|_| is_instruction(name));
        let (positional, switches) = arguments(&text, from, end);
        let goals = shape.map_or(positional.len(), |(_, points, _)| points);
        let mut to = Vec::new();
        for (from, end) in positional.iter().take(goals) {
            let is_datum = *end == from + 1 || text.is(from + 1, b'{');
            if is_datum {
                to.extend(self.goes(&text.name(*from), s));
            }
        }
        // Moves that are corrected note their targets themselves.
        let is_corrected = text.source.is_corrected && shape.is_some();
        to.retain(|goes| !(is_corrected && matches!(goes, Goes::Target(_))));
        if to.is_empty() {
            return;
        }
        let is_tool = |(from, end): &&(usize, usize)| {
            let name = text.name(*from);
            let declared = self.frames.find(&name, s.file, s.routine);
            *end == from + 1 && (name == "tool0" || declared.is_some_and(|data| data.is_tool()))
        };
        let mut tools = positional.iter().filter(is_tool);
        let tool = match shape {
            Some((.., tool_at)) => positional.get(tool_at),
            None => tools.next().filter(|_| tools.next().is_none()),
        };
        let state = State {
            states,
            step,
            before: None,
        };
        let switch = |wanted: &str| switches.iter().find(|(name, _)| name == wanted);
        let is_sensed = switch("corr").is_some() || switch("track").is_some();
        let value = |key: usize| states.certain.value(step, key, &self.program);
        let is_placed = !is_sensed && value(DISPLACED) == Ok(Setting::Is(false));
        let frames = tool.filter(|_| is_placed).and_then(|tool| {
            let mut tool = self.tool(s, *tool, &state, false).ok()?.ok()?;
            let object = match switch("wobj") {
                Some((_, value)) => self.object(s, *value, &state).ok()?.ok()?,
                None => Frame::own("wobj0", false),
            };
            let (total, added) = (switch("tload").map(|(_, value)| *value), value(LOADED).ok());
            tool.payload_kg = self.payload(s, tool.payload_kg, total, added);
            Some((tool, object))
        });
        let location = self.location(s, s.from);
        self.others.extend(to.into_iter().map(|to| Other {
            to,
            frames: frames.clone(),
            location,
        }));
    }

    /// Returns what a name in a statement stands for, if it is a target or a parameter.
    fn goes(&self, name: &str, s: &Statement) -> Vec<Goes> {
        match self.named.find(name, s.file, s.routine) {
            Some(Ok(all)) => all.iter().flatten().map(|t| Goes::Target(*t)).collect(),
            Some(Err(_)) => {
                let is_own = |r: &Routine| (r.file, r.number) == (s.file, s.routine);
                let index = self.routines.iter().position(is_own);
                let parameter = index.and_then(|index| {
                    let mut all = self.routines[index].parameters.iter();
                    Some((index, all.position(|p| p.name == name)?))
                });
                parameter.map(Goes::Parameter).into_iter().collect()
            }
            None => Vec::new(),
        }
    }

    /// Leaves the targets to which other moves go with other frames than those for which they would be corrected.
    pub(super) fn leave_shared(&mut self, all: &[Statement]) {
        let mut given: HashMap<(usize, usize), BTreeSet<usize>> = HashMap::new();
        let mut links = Vec::new();
        for s in all {
            for (parameter, name) in self.given_by_value_too(s) {
                for goes in self.goes(&name, s) {
                    match goes {
                        Goes::Target(target) => {
                            given.entry(parameter).or_default().insert(target);
                        }
                        Goes::Parameter(giver) => links.push((giver, parameter)),
                    }
                }
            }
        }
        let count = |given: &HashMap<_, BTreeSet<usize>>| given.values().map(BTreeSet::len).sum();
        let mut before: usize = usize::MAX;
        while before != count(&given) {
            before = count(&given);
            for (giver, parameter) in &links {
                let more = given.get(giver).cloned().unwrap_or_default();
                given.entry(*parameter).or_default().extend(more);
            }
        }
        for other in std::mem::take(&mut self.others) {
            let targets = match other.to {
                Goes::Target(target) => BTreeSet::from([target]),
                Goes::Parameter(parameter) => given.get(&parameter).cloned().unwrap_or_default(),
            };
            for target in targets {
                self.compare(target, &other);
            }
        }
    }

    fn compare(&mut self, target: usize, other: &Other) {
        let found = &self.program.targets[target];
        let (Some(tool), Some(base)) = (found.tool, found.base) else {
            return;
        };
        let (tool, base) = (&self.program.frames[tool], &self.program.frames[base]);
        let is_joints = matches!(found.goal, Goal::Joints(_));
        let line = self.program.line_of(other.location);
        let reason = match &other.frames {
            _ if is_joints => None,
            None => Some(format!(
                "the move at {line} goes to it, too, with a tool or frame that is not certain"
            )),
            Some((t, b)) => (t.pose != tool.pose || b.pose != base.pose).then(|| {
                format!(
                    "its moves use different frames: {} in {}, and at {line} {} in {}",
                    tool.name, base.name, t.name, b.name
                )
            }),
        };
        let payload_kg = other.frames.as_ref().and_then(|(tool, _)| tool.payload_kg);
        let is_loaded_otherwise = payload_kg != tool.payload_kg;
        if let Some(reason) = reason {
            self.program.leave(found.location, reason);
        } else if is_loaded_otherwise {
            self.program.loaded_differently.insert(target);
        }
    }
}

fn is_process(name: &str) -> bool {
    PROCESSES.contains(&name)
}
