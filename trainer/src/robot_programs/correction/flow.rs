//! Values that a program sets on its way, such as its tool: which of them are certain at a step, whatever way leads to it.
//!
//! A reader lists the steps of all routines. A value is known at a step if all ways to the step set the same one: both
//! branches of a condition, each pass of a loop, every jump to a label, every call of a routine. Interrupts and threads run
//! at any time, so that what they set is known only where it changes nothing.

use std::collections::{BTreeSet, HashMap};
use std::rc::Rc;

use crate::robot_programs::correction::held::{Held, State, either, joined, lead};
use crate::robot_programs::correction::program::{Location, Program};

/// One step of a routine.
#[derive(Clone, Debug)]
pub enum Step<V> {
    /// Gives a key a value; `None` stands for a value that the controller computes.
    Set(usize, Option<V>),
    /// Gives the first key what the second one holds.
    Copy(usize, usize),
    /// Calls one of these routines.
    Call(Vec<usize>),
    /// Begins a loop.
    Loop,
    /// Begins the first branch of a condition.
    Branch,
    /// Begins a list of cases, before the first of them.
    Cases,
    /// Begins the next branch; `true` for the one that is taken if no other is.
    Next(bool),
    /// Ends the condition of a branch: the branches behind it begin with what holds here.
    Evaluated,
    /// Ends a loop or a condition.
    End,
    /// Ends a loop whose condition stands here, so that its body runs at least once.
    Until,
    /// Leaves the innermost loop.
    Break,
    /// Begins the next pass of the innermost loop.
    Continue,
    /// Goes to a label.
    Jump(String),
    Label(String),
    /// Leaves the routine.
    Return,
    /// Changes nothing.
    Other,
}

/// The steps of a program by routine. Routine 0 always exists.
#[derive(Clone, Debug)]
pub struct Flow<V> {
    initial: Vec<Held<V>>,
    /// Whether the value of each key outlasts a run of the program.
    lasts: Vec<bool>,
    steps: Vec<Step<V>>,
    locations: Vec<Location>,
    routines: Vec<Vec<usize>>,
    interrupts: BTreeSet<usize>,
}

/// What is certain at each step.
#[derive(Clone, Debug)]
pub struct Certain<V> {
    states: Vec<Option<State<V>>>,
    locations: Vec<Location>,
    /// Contents that are certain whatever has run before.
    anywhere: State<V>,
    /// What interrupts set.
    interrupting: Vec<Option<Held<V>>>,
}

impl<V: Clone + PartialEq> Certain<V> {
    /// Returns the contents of a key before a step.
    pub fn at(&self, step: usize, key: usize) -> Held<V> {
        let state = self.states.get(step).and_then(Option::as_ref);
        let held = &state.unwrap_or(&self.anywhere)[key];
        match &self.interrupting[key] {
            Some(other) => held.or(other),
            None => held.clone(),
        }
    }

    /// Returns whether a step may have set a key before this one.
    pub fn is_set(&self, step: usize, key: usize) -> bool {
        match self.at(step, key) {
            Held::Known(_, set_at) | Held::Unknown { set_at, .. } => set_at.is_some(),
        }
    }

    /// Returns the value of a key before a step, or the reason why it is not certain.
    pub fn value(&self, step: usize, key: usize, program: &Program) -> Result<V, String> {
        match self.at(step, key) {
            Held::Known(value, _) => Ok(value),
            Held::Unknown {
                set_at,
                is_computed,
            } => Err(match set_at.and_then(|at| self.locations.get(at)) {
                Some(location) => {
                    let line = program.line_of(*location);
                    match is_computed {
                        true => format!("it is changed at {line}"),
                        false => {
                            format!("it is set at {line}, but not on every path to this move")
                        }
                    }
                }
                None => "it is computed".to_owned(),
            }),
        }
    }
}

/// A loop or condition in which a step is.
struct Block<V> {
    /// First step of a loop; `None` for a condition.
    head: Option<usize>,
    /// State before the first branch of a condition.
    before: Option<State<V>>,
    /// State behind the block, as far as ways lead there.
    behind: Option<State<V>>,
    is_complete: bool,
}

/// States that ways from several arrivals lead to.
struct Arrivals<V> {
    /// At the first step of each routine, and behind its last.
    entries: Vec<Option<State<V>>>,
    exits: Vec<Option<State<V>>>,
    heads: HashMap<usize, Option<State<V>>>,
    labels: HashMap<(usize, String), Option<State<V>>>,
    is_changed: bool,
}

impl<V: Clone + PartialEq> Flow<V> {
    /// Creates a program without steps.
    pub fn new() -> Self {
        Self {
            initial: Vec::new(),
            lasts: Vec::new(),
            steps: Vec::new(),
            locations: Vec::new(),
            routines: vec![Vec::new()],
            interrupts: BTreeSet::new(),
        }
    }

    /// Adds a key and returns it; `initial` is its value before the program runs, `None` if that is not known. If it `lasts`,
    /// the next run begins with what this one leaves.
    pub fn key(&mut self, initial: Option<V>, lasts: bool) -> usize {
        self.lasts.push(lasts);
        self.initial.push(Held::new(initial, None));
        self.initial.len() - 1
    }

    /// Adds a routine and returns it.
    pub fn routine(&mut self) -> usize {
        self.routines.push(Vec::new());
        self.routines.len() - 1
    }

    /// Notes that a routine runs at any time, beside the others.
    pub fn interrupts(&mut self, routine: usize) {
        self.interrupts.insert(routine);
    }

    /// Adds a step to a routine and returns its index.
    pub fn push(&mut self, routine: usize, step: Step<V>, location: Location) -> usize {
        self.steps.push(step);
        self.locations.push(location);
        self.routines[routine].push(self.steps.len() - 1);
        self.steps.len() - 1
    }

    /// Returns the values that a routine sets, with their steps, in further calls too.
    fn settings(&self) -> Vec<BTreeSet<usize>> {
        let sets = |step: &&usize| matches!(self.steps[**step], Step::Set(..) | Step::Copy(..));
        let own = |steps: &Vec<usize>| steps.iter().filter(sets).copied().collect();
        let mut all: Vec<BTreeSet<usize>> = self.routines.iter().map(own).collect();
        loop {
            let before: usize = all.iter().map(BTreeSet::len).sum();
            for (routine, steps) in self.routines.iter().enumerate() {
                for callee in self.callees(steps) {
                    let more = all[callee].clone();
                    all[routine].extend(more);
                }
            }
            if before == all.iter().map(BTreeSet::len).sum::<usize>() {
                return all;
            }
        }
    }

    fn callees<'a>(&'a self, steps: &'a [usize]) -> impl Iterator<Item = usize> + 'a {
        let callees = steps.iter().filter_map(|step| match &self.steps[*step] {
            Step::Call(callees) => Some(callees),
            _ => None,
        });
        callees.flatten().copied()
    }

    /// Returns the routines that the program begins with: those that it calls nowhere, and of those that only call each other
    /// the first.
    fn first_routines(&self) -> Vec<usize> {
        let all = || 0..self.routines.len();
        let called: BTreeSet<usize> = self.routines.iter().flat_map(|r| self.callees(r)).collect();
        let mut first: Vec<usize> = all().filter(|r| !called.contains(r)).collect();
        first.retain(|routine| !self.interrupts.contains(routine));
        let (mut reached, mut open) = (BTreeSet::new(), first.clone());
        open.extend(&self.interrupts);
        loop {
            while let Some(routine) = open.pop() {
                if reached.insert(routine) {
                    open.extend(self.callees(&self.routines[routine]));
                }
            }
            match all().find(|routine| !reached.contains(routine)) {
                Some(routine) => {
                    first.push(routine);
                    open.push(routine);
                }
                None => return first,
            }
        }
    }

    /// Returns what is certain at each step.
    pub fn certain(&self) -> Certain<V> {
        let settings = self.settings();
        let initial = Rc::new(self.initial.clone());
        let set = |step: usize| match &self.steps[step] {
            Step::Set(key, value) => Some((*key, Held::new(value.clone(), Some(step)))),
            _ => None,
        };
        let mut anywhere = self.initial.clone();
        for (key, held) in (0..self.steps.len()).filter_map(set) {
            anywhere[key] = anywhere[key].or(&held);
        }
        let copy = |step: usize| match &self.steps[step] {
            Step::Copy(key, from) => Some((*key, *from)),
            _ => None,
        };
        // Copies of copies take several passes.
        let mut before = None;
        while before.as_ref() != Some(&anywhere) {
            before = Some(anywhere.clone());
            for (key, from) in (0..self.steps.len()).filter_map(copy) {
                anywhere[key] = anywhere[key].or(&anywhere[from]);
            }
        }
        let anywhere = Rc::new(anywhere);
        let set = |step: usize| {
            let copied = || copy(step).map(|(key, from)| (key, anywhere[from].clone()));
            set(step).or_else(copied)
        };
        let mut interrupting = vec![None; self.initial.len()];
        let by_interrupt = self.interrupts.iter().flat_map(|r| &settings[*r]);
        for (key, held) in by_interrupt.filter_map(|step| set(*step)) {
            interrupting[key] = either(interrupting[key].take(), Some(held));
        }
        // What interrupts do to a value, they do to its copies.
        let mut before = None;
        while before.as_ref() != Some(&interrupting) {
            before = Some(interrupting.clone());
            for (key, from) in (0..self.steps.len()).filter_map(copy) {
                interrupting[key] = either(interrupting[key].take(), interrupting[from].clone());
            }
        }
        let none = || vec![None; self.routines.len()];
        let mut arrivals = Arrivals {
            entries: none(),
            exits: none(),
            heads: HashMap::new(),
            labels: HashMap::new(),
            is_changed: true,
        };
        let first = self.first_routines();
        let mut states = vec![None; self.steps.len()];
        while std::mem::take(&mut arrivals.is_changed) {
            for routine in &self.interrupts {
                arrivals.is_changed |= lead(&mut arrivals.entries[*routine], Some(&anywhere));
            }
            for routine in &first {
                arrivals.is_changed |= lead(&mut arrivals.entries[*routine], Some(&initial));
                // What one run of the program leaves is there when the next one begins.
                for other in &first {
                    let left = arrivals.exits[*other]
                        .as_ref()
                        .map(|exit| self.lasting(exit));
                    arrivals.is_changed |= lead(&mut arrivals.entries[*routine], left.as_ref());
                }
            }
            for routine in 0..self.routines.len() {
                self.walk(routine, &settings, &mut arrivals, &mut states);
            }
        }
        Certain {
            states,
            locations: self.locations.clone(),
            anywhere,
            interrupting,
        }
    }

    /// Returns the state in which a run begins after one that ends in this state.
    fn lasting(&self, exit: &State<V>) -> State<V> {
        let all = self.initial.iter().zip(exit.iter()).zip(&self.lasts);
        let left = all.map(|((initial, left), lasts)| if *lasts { left } else { initial });
        Rc::new(left.cloned().collect())
    }

    /// Goes once through a routine.
    fn walk(
        &self,
        routine: usize,
        settings: &[BTreeSet<usize>],
        arrivals: &mut Arrivals<V>,
        states: &mut [Option<State<V>>],
    ) {
        let mut state = arrivals.entries[routine].clone();
        let mut open: Vec<Block<V>> = Vec::new();
        for at in self.routines[routine].iter().copied() {
            states[at].clone_from(&state);
            match &self.steps[at] {
                Step::Set(key, value) => {
                    if let Some(state) = &mut state {
                        Rc::make_mut(state)[*key] = Held::new(value.clone(), Some(at));
                    }
                }
                Step::Copy(key, from) => {
                    if let Some(state) = &mut state {
                        let held = state[*from].clone();
                        Rc::make_mut(state)[*key] = held;
                    }
                }
                Step::Call(callees) => {
                    let mut behind = None;
                    for callee in callees {
                        arrivals.is_changed |= lead(&mut arrivals.entries[*callee], state.as_ref());
                        let exit = arrivals.exits[*callee].as_ref();
                        let after = self.behind_call(&settings[*callee], state.as_ref(), exit);
                        behind = joined(behind, after.as_ref());
                    }
                    state = behind;
                }
                Step::Loop => {
                    let head = arrivals.heads.entry(at).or_default();
                    arrivals.is_changed |= lead(head, state.as_ref());
                    state.clone_from(head);
                    open.push(Block {
                        head: Some(at),
                        before: None,
                        behind: None,
                        is_complete: true,
                    });
                }
                step @ (Step::Branch | Step::Cases) => {
                    open.push(Block {
                        head: None,
                        before: state.clone(),
                        behind: None,
                        is_complete: false,
                    });
                    if matches!(step, Step::Cases) {
                        state = None;
                    }
                }
                Step::Next(is_rest) => {
                    if let Some(block) = open.last_mut().filter(|block| block.head.is_none()) {
                        block.behind = joined(block.behind.take(), state.as_ref());
                        block.is_complete |= is_rest;
                        state.clone_from(&block.before);
                    }
                }
                Step::Evaluated => {
                    if let Some(block) = open.last_mut().filter(|block| block.head.is_none()) {
                        block.before.clone_from(&state);
                    }
                }
                end @ (Step::End | Step::Until) => {
                    if let Some(block) = open.pop() {
                        state = match block.head {
                            Some(head) => {
                                let head = arrivals.heads.entry(head).or_default();
                                arrivals.is_changed |= lead(head, state.as_ref());
                                let is_until = matches!(end, Step::Until);
                                let last = if is_until { &state } else { &*head };
                                joined(block.behind, last.as_ref())
                            }
                            None if block.is_complete => joined(block.behind, state.as_ref()),
                            None => {
                                let behind = joined(block.behind, state.as_ref());
                                joined(behind, block.before.as_ref())
                            }
                        };
                    }
                }
                Step::Break | Step::Continue => {
                    let inner = open.iter_mut().rfind(|block| block.head.is_some());
                    if let Some(block) = inner {
                        let is_break = matches!(self.steps[at], Step::Break);
                        match block.head.filter(|_| !is_break) {
                            Some(head) => {
                                let head = arrivals.heads.entry(head).or_default();
                                arrivals.is_changed |= lead(head, state.as_ref());
                            }
                            None => block.behind = joined(block.behind.take(), state.as_ref()),
                        }
                        state = None;
                    }
                }
                Step::Jump(label) => {
                    let label = arrivals.labels.entry((routine, label.clone())).or_default();
                    arrivals.is_changed |= lead(label, state.as_ref());
                    state = None;
                }
                Step::Label(label) => {
                    let label = arrivals.labels.entry((routine, label.clone())).or_default();
                    arrivals.is_changed |= lead(label, state.as_ref());
                    state.clone_from(label);
                }
                Step::Return => {
                    arrivals.is_changed |= lead(&mut arrivals.exits[routine], state.as_ref());
                    state = None;
                }
                Step::Other => {}
            }
        }
        arrivals.is_changed |= lead(&mut arrivals.exits[routine], state.as_ref());
    }

    /// Returns the state behind a call: what the routine sets is as at its end, and everything else as before.
    fn behind_call(
        &self,
        settings: &BTreeSet<usize>,
        before: Option<&State<V>>,
        exit: Option<&State<V>>,
    ) -> Option<State<V>> {
        let (before, exit) = (before?, exit?);
        let mut behind = before.clone();
        for step in settings {
            if let Step::Set(key, _) | Step::Copy(key, _) = &self.steps[*step]
                && behind[*key] != exit[*key]
            {
                Rc::make_mut(&mut behind)[*key] = exit[*key].clone();
            }
        }
        Some(behind)
    }
}
