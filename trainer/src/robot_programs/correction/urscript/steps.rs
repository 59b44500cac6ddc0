//! Follows the lines of a script: tool, payload, and whether something moves the targets.

use std::collections::HashMap;

use crate::robot_programs::correction::flow::{Flow, Step};
use crate::robot_programs::correction::urscript::lines::Line;
use crate::robot_programs::correction::urscript::states::{
    DISPLACED, PAYLOAD, Setting, States, TOOL,
};
use crate::robot_programs::correction::urscript::{Reader, Variable};

impl Reader<'_> {
    /// Follows the lines of all functions.
    pub(super) fn states(&self) -> States {
        let mut flow = Flow::new();
        let given = self.given.named("tcp", true);
        let tool = given.map_or(Setting::Nothing, |given| Setting::Pose(given.pose));
        flow.key(Some(tool), true);
        flow.key(Some(Setting::Nothing), true);
        // The controller ends it with the program.
        flow.key(Some(Setting::Is(false)), false);
        let text = self.text;
        let mut names: Vec<&String> = self.set.keys().collect();
        names.retain(|name| matches!(self.set[*name], Variable::Several));
        names.sort();
        let keys = names
            .into_iter()
            .map(|name| (name.clone(), flow.key(Some(Setting::Nothing), true)));
        let variables: HashMap<String, usize> = keys.collect();
        // Routine of each function, by its number and its name.
        let mut routines = HashMap::from([(0, 0)]);
        let mut named = HashMap::new();
        for line in self.lines.iter().filter(|line| line.is_definition) {
            let routine = flow.routine();
            routines.insert(line.function, routine);
            named.entry(text.spelling(line.from + 1)).or_insert(routine);
            // Threads run beside the program.
            if text.name(line.from) != "def" {
                flow.interrupts(routine);
            }
        }
        let threads = self
            .lines
            .iter()
            .filter(|line| line.is_definition && text.name(line.from) != "def");
        let threads: Vec<String> = threads.map(|line| text.spelling(line.from + 1)).collect();
        let mut steps = Vec::with_capacity(self.lines.len());
        for line in &self.lines {
            let routine = routines[&line.function];
            let location = self.location(line.from);
            let mut first = None;
            let mut push = |flow: &mut Flow<Setting>, step| {
                let index = flow.push(routine, step, location);
                first.get_or_insert(index);
            };
            let is_call = |at: &usize| !line.is_definition && text.is(at + 1, b'(');
            let calls = (line.from..line.end).filter(is_call);
            let called = calls
                .map(|at| text.spelling(at))
                .filter(|name| !threads.contains(name));
            let called: Vec<usize> = called
                .filter_map(|name| named.get(&name).copied())
                .collect();
            for routine in &called {
                push(&mut flow, Step::Call(vec![*routine]));
            }
            push(&mut flow, line.step.clone());
            // The condition of a loop is evaluated before each pass.
            for routine in called.iter().filter(|_| matches!(line.step, Step::Loop)) {
                push(&mut flow, Step::Call(vec![*routine]));
            }
            for (key, value) in self.set(line) {
                push(&mut flow, Step::Set(key, value));
            }
            let name_at = line.from + usize::from(text.name(line.from) == "global");
            if let Some(key) = variables.get(&text.spelling(name_at))
                && text.is(name_at + 1, b'=')
                && !text.is(name_at + 2, b'=')
            {
                let pose = self.pose_of(name_at + 2, line.end).ok();
                let at = self.program.line_of(location);
                let unknown = Setting::Unknown(format!("it is computed at {at}"));
                let value = pose.map_or(unknown, Setting::Pose);
                push(&mut flow, Step::Set(*key, Some(value)));
            }
            steps.push(first.unwrap_or(0));
        }
        States {
            certain: flow.certain(),
            variables,
            steps,
        }
    }

    /// Returns the keys that a line sets, with their values unless they are computed.
    fn set(&self, line: &Line) -> Vec<(usize, Option<Setting>)> {
        let text = self.text;
        let mut out = Vec::new();
        for at in line.from..line.end {
            if line.is_definition || !text.is(at + 1, b'(') {
                continue;
            }
            // Within a line of something else it may be under a condition.
            let is_alone = at == line.from;
            let first = self.first(line).first().copied().filter(|_| is_alone);
            // An argument may be named: set_tcp(pose=p[…]).
            let first = first.and_then(|(from, end)| {
                let is_named = text.is(from + 1, b'=');
                let is_first = matches!(text.name(from).as_str(), "pose" | "m" | "mass");
                let value = from + 2 * usize::from(is_named);
                (!is_named || is_first).then_some((value, end))
            });
            match text.name(at).as_str() {
                "set_tcp" => {
                    let pose = first.and_then(|(from, end)| self.pose_of(from, end).ok());
                    let line = self.program.line_of(self.location(at));
                    let unknown = Setting::Unknown(format!("it is computed at {line}"));
                    out.push((TOOL, Some(pose.map_or(unknown, Setting::Pose))));
                }
                "set_payload" | "set_target_payload" | "set_payload_mass" => {
                    let kg = first
                        .filter(|(from, end)| *end == from + 1)
                        .and_then(|(from, _)| text.number(from));
                    out.push((PAYLOAD, kg.map(|kg| Setting::Payload(kg.value))));
                }
                "track_conveyor_linear"
                | "track_conveyor_circular"
                | "path_offset_enable"
                | "force_mode" => out.push((DISPLACED, Some(Setting::Is(true)))),
                "stop_conveyor_tracking" | "path_offset_disable" | "end_force_mode" => {
                    out.push((DISPLACED, Some(Setting::Is(false)).filter(|_| is_alone)));
                }
                _ => {}
            }
        }
        out
    }
}
