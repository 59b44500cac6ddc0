//! What the rows measured so far say: the expected error, and which of them contradict the others.

use std::ops::Range;

use crate::cli::failure::Failure;
use crate::cli::measure::Session;
use crate::cli::measure::journal::SKIP;
use poegp_calibration::measurement::touch::{TouchRow, TouchSet};
use poegp_calibration::model::config::Config;
use poegp_calibration::model::gauge::GaugeChoice;
use poegp_calibration::model::touches::calibrate_touches;
use poegp_calibration::model::touches::stepped::described;
use poegp_calibration::planning::next::doubt::copy_of;
use poegp_calibration::planning::next::judge::Judge;
use poegp_calibration::planning::next::moved::moved_since;
use poegp_calibration::planning::next::outlook::outlook;
use poegp_calibration::planning::next::waiting::waiting;
use poegp_calibration::trust::Tier;
use poegp_protocol::cause::Cause;

/// Rows that are judged one by one when a measurement is continued.
const FEW: usize = 30;

/// Rows in succession that contradict the others and show that something moved.
const IN_SUCCESSION: usize = 3;

/// What `calibrate` makes of the rows.
#[derive(Default)]
pub(super) struct Foreseen {
    /// Why it refuses them, if something moved while they were measured.
    pub refused: Option<String>,
    /// Rows that contradict the others, but that it uses.
    pub used: Vec<usize>,
}

impl Session<'_> {
    /// Judges the rows of a file. Few are judged one after the other, as they came; many show by themselves which of them
    /// are wrong.
    pub(super) fn doubt_all(&mut self, set: &TouchSet) {
        self.doubted.clear();
        let first = set.rows.len().min(FEW);
        for row in 0..first {
            self.doubt(set, row..row + 1);
        }
        self.doubt(set, first..set.rows.len());
    }

    /// Compares new rows, and those in doubt, with their prediction by the rows before them.
    pub(super) fn doubt(&mut self, set: &TouchSet, new: Range<usize>) {
        let judge = Judge {
            arm: (&self.arm.robot, &self.arm.nominal),
            plan: &self.planned.set,
            gravity: self.gravity,
            class: self.class,
        };
        self.doubted = judge.doubted(set, std::mem::take(&mut self.doubted), new);
    }

    /// Returns the rows that contradict the others, with how far they are from their prediction in mm.
    pub(super) fn contradicting(&self) -> Vec<(usize, Option<f64>)> {
        let by_others = self.found.iter().flat_map(|found| &found.outliers);
        let mut out: Vec<_> = self.doubted.iter().chain(by_others).copied().collect();
        out.sort_by_key(|(row, _)| *row);
        out
    }

    /// Reports the rows that have become outliers.
    pub(super) fn report_outliers(&mut self) -> Result<(), Failure> {
        let outliers = self.contradicting();
        let is_outlier = |row: &usize| outliers.iter().any(|(other, _)| other == row);
        let agree = self.outliers.iter().filter(|row| !is_outlier(row));
        let agree: Vec<usize> = agree.map(|row| row + 1).collect();
        self.show.agree(&agree)?;
        let is_touch = self.planned.features().is_some();
        for (row, missed) in outliers
            .iter()
            .filter(|(row, _)| !self.outliers.contains(row))
        {
            self.show.outlier(row + 1, *missed, is_touch)?;
        }
        self.outliers = outliers.into_iter().map(|(row, _)| row).collect();
        Ok(())
    }

    /// Computes what the rows are worth.
    pub(super) fn look(&mut self, set: &TouchSet) {
        self.missing = waiting(set);
        let plan = &self.planned.set;
        let arm = self.arm;
        let doubted: Vec<usize> = self.doubted.iter().map(|(row, _)| *row).collect();
        let found = outlook(
            &arm.robot,
            &arm.nominal,
            (set, plan),
            &doubted,
            self.gravity,
            self.class,
        );
        self.found = found;
    }

    /// Returns whether a row contradicts the others.
    pub(super) fn is_outlier(&self, row: usize) -> bool {
        self.contradicting().iter().any(|(index, _)| *index == row)
    }

    /// Returns the last rows if they contradict all others: the last of all, or the last of one feature.
    fn in_succession(&self, set: &TouchSet) -> Option<Vec<usize>> {
        let feature = set.rows.last()?.reading.feature();
        let of_feature = |row: &usize| set.rows[*row].reading.feature() == feature;
        let outliers = |rows: &mut dyn Iterator<Item = usize>| {
            let mut out: Vec<usize> = rows.take_while(|row| self.outliers.contains(row)).collect();
            out.reverse();
            (out.len() >= IN_SUCCESSION).then_some(out)
        };
        let all = outliers(&mut (0..set.rows.len()).rev());
        all.or_else(|| outliers(&mut (0..set.rows.len()).rev().filter(of_feature)))
    }

    /// Reports that something moved, if so many rows in succession contradict the others, and again whenever they show that it
    /// was something else.
    pub(super) fn report_moved(&mut self, set: &TouchSet) -> Result<(), Failure> {
        let Some(rows) = self.in_succession(set) else {
            self.moved = None;
            return Ok(());
        };
        let arm = self.arm;
        let (gravity, class) = (self.gravity, self.class);
        let found = moved_since(&arm.robot, &arm.nominal, set, rows[0], gravity, class);
        let parts = found.as_ref().map(|(_, step)| {
            let others = step.others.iter().copied();
            std::iter::once(step.part).chain(others).collect()
        });
        let moved = (rows[0], parts.unwrap_or_default());
        if self.moved.as_ref() == Some(&moved) {
            return Ok(());
        }
        self.moved = Some(moved);
        let text = found.map(|(set, step)| described(&set, &step));
        let rows: Vec<usize> = rows.iter().map(|row| row + 1).collect();
        self.show.moved(&rows, text.as_deref())
    }

    /// Computes what is left of the plan, from the rows of the file and from what was left out.
    pub(super) fn learn_all(&mut self, set: Option<&TouchSet>) {
        self.chooser = self.planned.chooser(self.arm, self.gravity, self.class);
        for (said, about) in self.journal.said() {
            let is_it = |row: &TouchRow| self.planned.asked(row, self.arm).name() == about;
            let row = self.planned.set.rows.iter().position(is_it);
            if let Some(row) = row.filter(|_| said == SKIP) {
                self.chooser.skip(row);
            }
        }
        if let Some(set) = set {
            (0..set.rows.len()).for_each(|row| self.learn(set, row));
        }
    }

    /// Takes a row off the plan. One that contradicts the others is measured once more, unless the row before does, too: then
    /// another pose says more of what is wrong.
    pub(super) fn learn(&mut self, set: &TouchSet, row: usize) {
        if copy_of(set, row).is_some() {
            return;
        }
        let own = &set.rows[row];
        let feature = own.reading.feature();
        let mut before = (0..row).rev();
        let before = before.find(|other| set.rows[*other].reading.feature() == feature);
        if !self.is_outlier(row) {
            self.chooser.measured(set, own);
        } else if before.is_some_and(|other| self.is_outlier(other)) {
            self.chooser.use_up(own);
        }
    }

    /// Returns what `calibrate` makes of the touches so far.
    pub(super) fn foreseen(&self) -> Foreseen {
        let found = self
            .planned
            .complete((&self.options.out, self.journal.bytes()), self.arm);
        let config = Config {
            gravity_m_s2: self.options.gravity.0,
            ..Config::default()
        };
        let gauge = GaugeChoice::default();
        let found =
            found.and_then(|set| calibrate_touches(&self.arm.robot, &set, &config, &gauge).ok());
        let Some(found) = found else {
            return Foreseen::default();
        };
        let mut refused = found.findings.of(Tier::Refused);
        let counts = |row: &&usize| found.fit.weights.get(**row).is_some_and(|w| *w > 0.0);
        Foreseen {
            refused: refused
                .find(|f| f.cause == Cause::Step)
                .map(|f| f.text.clone()),
            used: self
                .outliers
                .iter()
                .filter(counts)
                .map(|row| row + 1)
                .collect(),
        }
    }
}
