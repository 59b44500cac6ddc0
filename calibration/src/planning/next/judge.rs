//! Which of the rows measured so far are wrong.
//!
//! A wrong row among the first predicts the others wrongly, so that the right ones contradict it. As few rows as possible are
//! wrong: where leaving out one earlier row reconciles all that contradict, that row is.

use std::ops::Range;

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;

use crate::measurement::touch::{ClassPrior, TouchSet};
use crate::planning::next::doubt::{Judged, judged};
use crate::planning::next::outlook::outlook;
use crate::robot::Robot;

/// Numbers of rows that are few, but show which of them is wrong.
const FIRST: Range<usize> = 8..16;
/// Most of the first rows that may be wrong: more of them are the rule.
const MOST_WRONG: usize = 2;
/// Share of the expected error that is left without a wrong row, at most; a right one that is unusual is worth less.
const WORTH: f64 = 0.5;
/// Fewest rows that contradict one earlier row and show that it is the wrong one.
const RECONCILED: usize = 2;

/// Judges the rows of a file that follows a plan.
#[derive(Clone, Copy, Debug)]
pub struct Judge<'a> {
    /// The robot, and its chain.
    pub arm: (&'a Robot, &'a Poe<f64>),
    /// The plan, over whose work volume an error is expected.
    pub plan: &'a TouchSet,
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// How far arms of this class are from their description.
    pub class: ClassPrior,
}

impl Judge<'_> {
    /// Compares `new` rows of `set` and those of `doubted` with their prediction by the rows before them, and returns the
    /// rows that contradict the others, each with its error in mm if that is a length.
    pub fn doubted(
        &self,
        set: &TouchSet,
        mut doubted: Vec<(usize, Option<f64>)>,
        new: Range<usize>,
    ) -> Vec<(usize, Option<f64>)> {
        let is_doubted = |row: &usize| doubted.iter().any(|(other, _)| other == row);
        let start = new.start;
        let (before, mut known): (Vec<usize>, Vec<usize>) = (0..start).partition(is_doubted);
        let mut asked: Vec<usize> = before.iter().copied().chain(new).collect();
        if known.len() < FIRST.start {
            return doubted;
        }
        if FIRST.contains(&known.len()) {
            let wrong = self.wrong_among_first(set, (&known, &before), start);
            known.retain(|row| !wrong.contains(row));
            asked.extend(wrong);
        }
        let mut found = self.judged(set, &known, &asked);
        if FIRST.contains(&known.len()) {
            found = self.reconciled(set, &known, &found).unwrap_or(found);
        }
        // A row that cannot be judged now stays what it was.
        doubted.retain(|(row, _)| found.iter().all(|judged| judged.row != *row));
        let wrong = found.iter().filter(|judged| judged.contradicts);
        doubted.extend(wrong.map(|judged| (judged.row, judged.missed_mm)));
        doubted
    }

    /// Returns the rows among the first that the others contradict. A wrong one widens what they predict, so that nothing
    /// contradicts it: each is left out in turn.
    fn wrong_among_first(
        &self,
        set: &TouchSet,
        (known, doubted): (&[usize], &[usize]),
        start: usize,
    ) -> Vec<usize> {
        let is_wrong = |row: &usize| {
            let found = self.judged(set, &without(known, *row), &[*row]);
            found.iter().any(|judged| judged.contradicts)
        };
        let mut wrong: Vec<usize> = known.iter().copied().filter(is_wrong).collect();
        let mut before = set.clone();
        before.rows.truncate(start);
        let is_less = || {
            let expected = |without: &[usize]| self.expected_mm(&before, without);
            let both = expected(&[doubted, &wrong].concat()).zip(expected(doubted));
            both.is_some_and(|(without, with)| without < WORTH * with)
        };
        if wrong.is_empty() || wrong.len() > MOST_WRONG || !is_less() {
            wrong.clear();
        }
        wrong
    }

    /// Returns the judgement with one of the first rows as the wrong one, if all rows that contradict `known` agree without
    /// it; `None` if no row is such.
    fn reconciled(&self, set: &TouchSet, known: &[usize], found: &[Judged]) -> Option<Vec<Judged>> {
        let all: Vec<usize> = found.iter().map(|judged| judged.row).collect();
        if found.iter().filter(|judged| judged.contradicts).count() < RECONCILED {
            return None;
        }
        let by = |row: &usize| {
            let asked = [all.as_slice(), &[*row]].concat();
            let judged = self.judged(set, &without(known, *row), &asked);
            let reconciles = judged.len() == asked.len()
                && judged.iter().all(|j| j.contradicts == (j.row == *row));
            reconciles.then_some(judged)
        };
        let missed = |judged: &[Judged]| judged.last().and_then(|own| own.missed_mm);
        let reconciled = known.iter().filter_map(by);
        reconciled.max_by(|a, b| {
            missed(a)
                .unwrap_or(0.0)
                .total_cmp(&missed(b).unwrap_or(0.0))
        })
    }

    /// Returns the error that is expected over the work volume without some rows, mm.
    fn expected_mm(&self, set: &TouchSet, without: &[usize]) -> Option<f64> {
        let (robot, nominal) = self.arm;
        let sets = (set, self.plan);
        let found = outlook(robot, nominal, sets, without, self.gravity, self.class)?;
        Some(found.expected.mean_mm)
    }

    fn judged(&self, set: &TouchSet, known: &[usize], asked: &[usize]) -> Vec<Judged> {
        let (robot, nominal) = self.arm;
        judged(
            robot,
            nominal,
            set,
            (known, asked),
            self.gravity,
            self.class,
        )
    }
}

fn without(rows: &[usize], row: usize) -> Vec<usize> {
    rows.iter().copied().filter(|other| *other != row).collect()
}
