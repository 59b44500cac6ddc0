//! Follows the statements of RAPID: tools and work objects as the code assigns them, program displacements, and
//! whether configurations are monitored.

use std::collections::{HashMap, HashSet};

use crate::robot_programs::correction::flow::{Flow, Step};
use crate::robot_programs::correction::rapid::data::{FrameData, Part, Setting};
use crate::robot_programs::correction::rapid::names::Change;
use crate::robot_programs::correction::rapid::statements::Statement;
use crate::robot_programs::correction::rapid::states::{
    DISPLACED, LOADED, MONITORED, Slot, States,
};
use crate::robot_programs::correction::rapid::{Reader, State};
use crate::robot_programs::correction::tokens::{Kind, Value};

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
            let push = |flow: &mut Flow<Setting>, step| flow.push(routine, step, location);
            let mut set = |flow: &mut Flow<Setting>, parts: Vec<(Slot, Option<Setting>)>| {
                let step = |((name, index, part), value): (Slot, Option<Setting>)| {
                    let declared = self.frames.at(&name, index);
                    let key = *keys.entry((name, index, part)).or_insert_with(|| {
                        flow.key(declared.and_then(|data| data.declared(part)), true)
                    });
                    Step::Set(key, value)
                };
                parts.into_iter().map(step).collect::<Vec<_>>()
            };
            let mut evaluated = set(&mut flow, self.changed_parts(s));
            let called = self.called(s);
            if !called.is_empty() {
                // A routine may change its arguments before it uses them by another name.
                let calls = Step::Call(called.iter().map(|index| routines[*index]).collect());
                let changes = evaluated.clone();
                evaluated.push(calls);
                evaluated.extend(changes);
            }
            let evaluate = |flow: &mut Flow<Setting>| {
                for step in &evaluated {
                    push(flow, step.clone());
                }
            };
            let is_next = matches!(s.step, Step::Next(_));
            if !is_next {
                evaluate(&mut flow);
            }
            steps.push(push(&mut flow, s.step.clone()));
            // The condition of a loop is evaluated before each pass, and that of a branch once the ones before are not taken.
            if is_next || matches!(s.step, Step::Loop) {
                evaluate(&mut flow);
            }
            if is_next {
                push(&mut flow, Step::Evaluated);
            }
            for step in set(&mut flow, self.assigned_parts(s)) {
                push(&mut flow, step);
            }
            if let Some((key, value)) = self.set_switch(s) {
                push(&mut flow, Step::Set(key, Some(Setting::Is(value))));
            }
            if let Some(load) = self.grip_load(s) {
                push(&mut flow, Step::Set(LOADED, load.map(Setting::Load)));
            }
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

    /// Returns the parts of tools and work objects that the left side of an assignment sets.
    fn assigned_parts(&self, s: &Statement) -> Vec<(Slot, Option<Setting>)> {
        let text = self.texts[s.file];
        let Some((name, component, from)) = self.assignment(s) else {
            return Vec::new();
        };
        let Some((index, data)) = self.frames.find_with_index(&name, s.file, s.routine) else {
            return Vec::new();
        };
        let value = text.value(from, s.end);
        let mass = self.mass(s, (from, s.end)).or(value.number());
        let parts = match value.name().filter(|_| component.is_empty()) {
            Some(other) => data.replaced(self.constant(other, s).as_ref()),
            None => data.assigned(&component, &value, mass),
        };
        let slot = |(part, value)| ((name.clone(), index, part), value);
        parts.into_iter().map(slot).collect()
    }

    /// Returns a tool or work object by its name, if no statement changes it.
    fn constant(&self, name: &str, s: &Statement) -> Option<FrameData> {
        match self.frames.find_with_index(name, s.file, s.routine) {
            Some((index, data)) => {
                let is_changed = self.changed_frames.contains(&(name.to_owned(), index));
                Some(data.clone()).filter(|_| !is_changed)
            }
            None => FrameData::own(name),
        }
    }

    /// Returns the tools and work objects that any statement changes, by name and index.
    pub(super) fn all_changed_frames(&self, all: &[Statement]) -> HashSet<(String, usize)> {
        let mut out = HashSet::new();
        for s in all {
            let assigned = self.assignment(s).map(|(name, ..)| Change::of(name, true));
            for change in self.changes(s).into_iter().chain(assigned) {
                out.extend(self.frames.changed(&change, s.file, s.routine));
            }
        }
        out
    }

    /// Returns the parts of tools and work objects that a statement changes by what it calls.
    fn changed_parts(&self, s: &Statement) -> Vec<(Slot, Option<Setting>)> {
        let mut out = Vec::new();
        for change in self.changes(s) {
            let value = (!change.is_certain).then(|| {
                let line = self.program.line_of(self.location(s, s.from));
                Setting::Unknown(format!("it may be changed at {line}"))
            });
            for (name, index) in self.frames.changed(&change, s.file, s.routine) {
                let part = |part| ((name.clone(), index, part), value.clone());
                out.extend(Part::ALL.map(part));
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
        Some(self.mass(s, (s.from + 1, s.end)))
    }

    /// Returns the mass in kg of a load, which is written or a name; `None` where it is not known.
    fn mass(&self, s: &Statement, (from, end): (usize, usize)) -> Option<f64> {
        let text = self.texts[s.file];
        let found = match text.value(from, end) {
            Value::Name(name) if name == "load0" => Some(0.0),
            Value::Name(name) => self.loads.find(&name, s.file, s.routine).copied().flatten(),
            value => value.list(6)?.first().and_then(Value::number),
        };
        found.filter(|mass| *mass >= 0.0)
    }

    /// Returns the payload in kg of a motion whose tool has this mass, under a load that GripLoad has added.
    pub(super) fn payload(
        &self,
        s: &Statement,
        mass: Option<f64>,
        total: Option<(usize, usize)>,
        added: Option<Setting>,
    ) -> Option<f64> {
        let added = match added {
            Some(Setting::Load(kg)) => kg,
            _ => return None,
        };
        // \TLoad states tool and part together, load0 none; GripLoad cannot be used with it.
        match total.map(|total| self.mass(s, total)) {
            None | Some(Some(0.0)) => mass.map(|mass| mass + added),
            Some(total) => total.filter(|_| added == 0.0),
        }
    }

    /// Returns the reason why the mass of a tool is not known at a step, if that is what the program does before.
    pub(super) fn unknown_mass(
        &self,
        s: &Statement,
        tool: &str,
        state: &State<'_>,
    ) -> Option<String> {
        let (index, _) = self.frames.find_with_index(tool, s.file, s.routine)?;
        let key = *state
            .states
            .keys
            .get(&(tool.to_owned(), index, Part::Mass))?;
        match state.states.certain.value(state.step, key, &self.program) {
            Ok(Setting::Unknown(reason)) | Err(reason) => Some(reason),
            Ok(_) => None,
        }
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
