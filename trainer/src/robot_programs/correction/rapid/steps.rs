//! Follows the statements of RAPID: tools and work objects as the code assigns them, program displacements, and
//! whether configurations are monitored.

use std::collections::HashMap;

use crate::robot_programs::correction::flow::{Flow, Step};
use crate::robot_programs::correction::rapid::Reader;
use crate::robot_programs::correction::rapid::data::{FrameData, Part, Setting};
use crate::robot_programs::correction::rapid::statements::Statement;
use crate::robot_programs::correction::rapid::states::{
    DISPLACED, LOADED, MONITORED, Slot, States,
};
use crate::robot_programs::correction::tokens::Kind;

impl Reader<'_> {
    /// Follows the statements of all routines.
    pub(super) fn states(&self, all: &[Statement]) -> States {
        let mut flow = Flow::new();
        let mut keys: HashMap<Slot, usize> = HashMap::new();
        for initial in [false, true, true] {
            // The controller resets them at the beginning of a program.
            flow.key(Some(Setting::Is(initial)), false);
        }
        flow.key(Some(Setting::Load(0.0)), false);
        let routines: Vec<usize> = self.routines.iter().map(|_| flow.routine()).collect();
        let handlers = flow.routine();
        flow.interrupts(handlers);
        let mut by_number = HashMap::new();
        for (routine, index) in self.routines.iter().zip(&routines) {
            by_number.insert((routine.file, routine.number), *index);
            if routine.is_trap {
                flow.interrupts(*index);
            }
        }
        let mut steps = Vec::with_capacity(all.len());
        for s in all {
            let own = by_number.get(&(s.file, s.routine)).copied().unwrap_or(0);
            let routine = if s.is_handler { handlers } else { own };
            let location = self.location(s, s.from);
            let mut first = None;
            let mut push = |flow: &mut Flow<Setting>, step| {
                let index = flow.push(routine, step, location);
                first.get_or_insert(index);
            };
            let called = self.called(s);
            let call = || Step::Call(called.iter().map(|index| routines[*index]).collect());
            if !called.is_empty() {
                push(&mut flow, call());
            }
            push(&mut flow, s.step.clone());
            // The condition of a loop is evaluated before each pass.
            if !called.is_empty() && matches!(s.step, Step::Loop) {
                push(&mut flow, call());
            }
            for ((name, index, part), value) in self.set_parts(s) {
                let key = *keys.entry((name.clone(), index, part)).or_insert_with(|| {
                    let found = self.frames.find(&name, s.file, s.routine);
                    flow.key(found.and_then(|data| data.declared(part)), true)
                });
                push(&mut flow, Step::Set(key, value));
            }
            if let Some((key, value)) = self.set_switch(s) {
                push(&mut flow, Step::Set(key, Some(Setting::Is(value))));
            }
            if let Some(load) = self.grip_load(s) {
                push(&mut flow, Step::Set(LOADED, load.map(Setting::Load)));
            }
            steps.push(first.unwrap_or(0));
        }
        States {
            certain: flow.certain(),
            keys,
            steps,
        }
    }

    /// Returns the routines of the files that a statement may call.
    fn called(&self, s: &Statement) -> Vec<usize> {
        let text = self.texts[s.file];
        // A name that the program computes stands for any routine.
        if text.is(s.from, b'%') || text.name(s.from) == "callbyvar" {
            return (0..self.routines.len()).collect();
        }
        let is_call = |at: &usize| {
            let is_name = text.at(*at).is_some_and(|t| t.kind == Kind::Name);
            is_name && (*at == s.from || text.is(at + 1, b'('))
        };
        let names = (s.from..s.end).filter(is_call);
        names
            .filter_map(|at| self.routine(&text.name(at), s.file))
            .collect()
    }

    /// Returns the data that a statement gives to parameters of a routine that changes them.
    pub(super) fn changed_arguments(&self, s: &Statement) -> Vec<String> {
        let called = self.called(s);
        if !called.iter().any(|index| self.routines[*index].has_changes) {
            return Vec::new();
        }
        let text = self.texts[s.file];
        (s.from + 1..s.end).map(|at| text.name(at)).collect()
    }

    /// Returns the parts of tools and work objects that a statement sets.
    fn set_parts(&self, s: &Statement) -> Vec<(Slot, Option<Setting>)> {
        let text = self.texts[s.file];
        let find = |name: &str| self.frames.find_with_index(name, s.file, s.routine);
        if let Some((name, component, from)) = self.assignment(s) {
            let Some((index, data)) = find(&name) else {
                return Vec::new();
            };
            let parts = data.assigned(&component, &text.value(from, s.end));
            let slot = |(part, value)| ((name.clone(), index, part), value);
            return parts.into_iter().map(slot).collect();
        }
        let mut out = Vec::new();
        for name in self.changed_arguments(s) {
            if let Some((index, _)) = find(&name) {
                out.extend(Part::ALL.map(|part| ((name.clone(), index, part), None)));
            }
        }
        out
    }

    /// Returns the mass in kg that GripLoad adds, `None` where it is not known.
    pub(super) fn grip_load(&self, s: &Statement) -> Option<Option<f64>> {
        let text = self.texts[s.file];
        if text.name(s.from) != "gripload" {
            return None;
        }
        let name = text.name(s.from + 1);
        let found = self.loads.find(&name, s.file, s.routine).copied().flatten();
        let is_name = s.end == s.from + 2;
        Some(match name.as_str() {
            "load0" => Some(0.0),
            _ => found.filter(|mass| is_name && *mass >= 0.0),
        })
    }

    /// Returns the switch that an instruction sets.
    fn set_switch(&self, s: &Statement) -> Option<(usize, bool)> {
        let text = self.texts[s.file];
        let is_on = || (s.from..s.end).any(|at| text.name(at) == "on");
        match text.name(s.from).as_str() {
            "confj" => Some((MONITORED[0], is_on())),
            "confl" => Some((MONITORED[1], is_on())),
            "pdispon" | "pdispset" => Some((DISPLACED, true)),
            "pdispoff" => Some((DISPLACED, false)),
            _ => None,
        }
    }

    /// Returns a tool or work object as it is at a step.
    pub(super) fn frame_at(
        &self,
        name: &str,
        s: &Statement,
        states: &States,
        step: usize,
    ) -> Option<FrameData> {
        let (index, declared) = self.frames.find_with_index(name, s.file, s.routine)?;
        let mut data = declared.clone();
        for part in Part::ALL {
            if let Some(key) = states.keys.get(&(name.to_owned(), index, part))
                && states.certain.is_set(step, *key)
            {
                data.put(part, states.certain.value(step, *key, &self.program));
            }
        }
        Some(data)
    }
}
