//! Values that a program sets on its way, such as its tool: which of them are certain at a step, whatever way leads to it.
//!
//! A reader lists the steps of all routines. A value is known at a step if all ways to the step set the same one: both
//! branches of a condition, each pass of a loop, every jump to a label, every call of a routine. Interrupts and threads run
//! at any time, so that what they set is known only where it changes nothing.

use std::collections::{BTreeSet, HashMap};
use std::rc::Rc;

use crate::robot_programs::correction::held::{Certain, Held, State, either, joined, lead};
use crate::robot_programs::correction::program::Location;

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
        let state = arrivals.entries[routine].clone();
        let mut walk = Walk {
            flow: self,
            routine,
            settings,
            arrivals,
            state,
            open: Vec::new(),
        };
        for at in self.routines[routine].iter().copied() {
            states[at].clone_from(&walk.state);
            walk.step(at);
        }
        walk.arrive_at_exit();
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

/// A pass through a routine, which goes from step to step.
struct Walk<'a, V> {
    flow: &'a Flow<V>,
    routine: usize,
    /// Steps that set values in each routine, in further calls too.
    settings: &'a [BTreeSet<usize>],
    arrivals: &'a mut Arrivals<V>,
    /// What is certain here; `None` where no way leads.
    state: Option<State<V>>,
    /// Loops and conditions around the step, outermost first.
    open: Vec<Block<V>>,
}

impl<V: Clone + PartialEq> Walk<'_, V> {
    /// Goes through a step.
    fn step(&mut self, at: usize) {
        let flow = self.flow;
        match &flow.steps[at] {
            Step::Set(key, value) => {
                if let Some(state) = &mut self.state {
                    Rc::make_mut(state)[*key] = Held::new(value.clone(), Some(at));
                }
            }
            Step::Copy(key, from) => {
                if let Some(state) = &mut self.state {
                    let held = state[*from].clone();
                    Rc::make_mut(state)[*key] = held;
                }
            }
            Step::Call(callees) => self.call(callees),
            Step::Loop => {
                let head = self.arrivals.heads.entry(at).or_default();
                self.arrivals.is_changed |= lead(head, self.state.as_ref());
                self.state.clone_from(head);
                self.begin_block(Some(at));
            }
            Step::Branch => self.begin_block(None),
            Step::Cases => {
                self.begin_block(None);
                self.state = None;
            }
            Step::Next(is_rest) => self.next_branch(*is_rest),
            Step::Evaluated => {
                if let Some(block) = self.open.last_mut().filter(|block| block.head.is_none()) {
                    block.before.clone_from(&self.state);
                }
            }
            end @ (Step::End | Step::Until) => self.end_block(matches!(end, Step::Until)),
            end @ (Step::Break | Step::Continue) => self.end_pass(matches!(end, Step::Break)),
            Step::Jump(label) => {
                self.arrive_at(label);
                self.state = None;
            }
            Step::Label(label) => {
                self.arrive_at(label);
                let key = (self.routine, label.clone());
                self.state.clone_from(&self.arrivals.labels[&key]);
            }
            Step::Return => {
                self.arrive_at_exit();
                self.state = None;
            }
            Step::Other => {}
        }
    }

    /// Goes through one of the routines, and on behind it.
    fn call(&mut self, callees: &[usize]) {
        let mut behind = None;
        for callee in callees {
            let entry = &mut self.arrivals.entries[*callee];
            self.arrivals.is_changed |= lead(entry, self.state.as_ref());
            let exit = self.arrivals.exits[*callee].as_ref();
            let settings = &self.settings[*callee];
            let after = (self.flow).behind_call(settings, self.state.as_ref(), exit);
            behind = joined(behind, after.as_ref());
        }
        self.state = behind;
    }

    /// Begins a loop whose first step is `head`, or a condition.
    fn begin_block(&mut self, head: Option<usize>) {
        self.open.push(Block {
            head,
            before: self.state.clone().filter(|_| head.is_none()),
            behind: None,
            is_complete: head.is_some(),
        });
    }

    /// Ends a branch of a condition and begins the next one.
    fn next_branch(&mut self, is_rest: bool) {
        if let Some(block) = self.open.last_mut().filter(|block| block.head.is_none()) {
            block.behind = joined(block.behind.take(), self.state.as_ref());
            block.is_complete |= is_rest;
            self.state.clone_from(&block.before);
        }
    }

    /// Ends a loop or a condition; the condition of a loop stands at its end if `is_until`.
    fn end_block(&mut self, is_until: bool) {
        let Some(block) = self.open.pop() else {
            return;
        };
        self.state = match block.head {
            Some(head) => {
                let head = self.arrivals.heads.entry(head).or_default();
                self.arrivals.is_changed |= lead(head, self.state.as_ref());
                let last = if is_until { &self.state } else { &*head };
                joined(block.behind, last.as_ref())
            }
            None if block.is_complete => joined(block.behind, self.state.as_ref()),
            None => {
                let behind = joined(block.behind, self.state.as_ref());
                joined(behind, block.before.as_ref())
            }
        };
    }

    /// Ends this pass of the innermost loop: the next one begins, or the loop ends if `is_break`.
    fn end_pass(&mut self, is_break: bool) {
        let inner = self.open.iter_mut().rfind(|block| block.head.is_some());
        let Some(block) = inner else {
            return;
        };
        match block.head.filter(|_| !is_break) {
            Some(head) => {
                let head = self.arrivals.heads.entry(head).or_default();
                self.arrivals.is_changed |= lead(head, self.state.as_ref());
            }
            None => block.behind = joined(block.behind.take(), self.state.as_ref()),
        }
        self.state = None;
    }

    /// Notes that a way leads from here to a label.
    fn arrive_at(&mut self, label: &str) {
        let key = (self.routine, label.to_owned());
        let label = self.arrivals.labels.entry(key).or_default();
        self.arrivals.is_changed |= lead(label, self.state.as_ref());
    }

    /// Notes that a way leads from here to the end of the routine.
    fn arrive_at_exit(&mut self) {
        let exit = &mut self.arrivals.exits[self.routine];
        self.arrivals.is_changed |= lead(exit, self.state.as_ref());
    }
}
