//! Contents of the values that a program sets, and what is certain of them where several ways meet.

use std::rc::Rc;

use crate::robot_programs::correction::program::{Location, Program};

/// Contents of a key at a step.
#[derive(Clone, Debug, PartialEq)]
pub enum Held<V> {
    /// The same value on every way, and the last step that sets it.
    Known(V, Option<usize>),
    /// No value that is certain.
    Unknown {
        /// The last step that may have set it.
        set_at: Option<usize>,
        /// Whether the controller computes it there; otherwise it differs by the way.
        is_computed: bool,
    },
}

impl<V: Clone + PartialEq> Held<V> {
    /// Returns the contents that a step gives; no value is one that the controller computes.
    pub fn new(value: Option<V>, set_at: Option<usize>) -> Self {
        let is_computed = true;
        value.map_or(
            Self::Unknown {
                set_at,
                is_computed,
            },
            |value| Self::Known(value, set_at),
        )
    }

    /// Returns what is certain if either may hold.
    pub fn or(&self, other: &Self) -> Self {
        let last = |held: &Self| match held {
            Self::Known(_, set_at) => (*set_at, false),
            Self::Unknown {
                set_at,
                is_computed,
            } => (*set_at, *is_computed),
        };
        let (set_at, is_computed) = last(self).max(last(other));
        match (self, other) {
            (Self::Known(a, _), Self::Known(b, _)) if a == b => Self::Known(a.clone(), set_at),
            _ => Self::Unknown {
                set_at,
                is_computed,
            },
        }
    }
}

/// Returns what is certain if either may hold, as far as there are two.
pub fn either<V: Clone + PartialEq>(a: Option<Held<V>>, b: Option<Held<V>>) -> Option<Held<V>> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.or(&b)),
        (a, b) => a.or(b),
    }
}

/// Contents of all keys; shared until a step changes them.
pub type State<V> = Rc<Vec<Held<V>>>;

/// Returns what is certain if either state may hold; `None` is the state of a step to which no way leads.
pub fn joined<V: Clone + PartialEq>(a: Option<State<V>>, b: Option<&State<V>>) -> Option<State<V>> {
    match (a, b) {
        (Some(a), Some(b)) if !Rc::ptr_eq(&a, b) && a != *b => {
            let both = a.iter().zip(b.iter()).map(|(a, b)| a.or(b));
            Some(Rc::new(both.collect()))
        }
        (None, b) => b.cloned(),
        (a, _) => a,
    }
}

/// Adds a state to the ways that lead to a slot, and returns whether that changed what is certain there.
pub fn lead<V: Clone + PartialEq>(slot: &mut Option<State<V>>, state: Option<&State<V>>) -> bool {
    let both = joined(slot.clone(), state);
    let is_same = match (&both, &*slot) {
        (Some(both), Some(old)) => Rc::ptr_eq(both, old) || both == old,
        (both, old) => both.is_none() && old.is_none(),
    };
    if !is_same {
        *slot = both;
    }
    !is_same
}

/// What is certain at each step.
#[derive(Clone, Debug)]
pub struct Certain<V> {
    /// State before each step; `None` where no way leads.
    pub states: Vec<Option<State<V>>>,
    /// Place of each step.
    pub locations: Vec<Location>,
    /// Contents that are certain whatever has run before.
    pub anywhere: State<V>,
    /// What interrupts set.
    pub interrupting: Vec<Option<Held<V>>>,
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
