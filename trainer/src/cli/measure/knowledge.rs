//! What the rows measured so far say: the expected error, and which of them contradict the others.

use std::ops::Range;

use crate::cli::failure::Failure;
use crate::cli::measure::Session;
use poegp_calibration::measurement::touch::TouchSet;
use poegp_calibration::model::config::Config;
use poegp_calibration::model::gauge::GaugeChoice;
use poegp_calibration::model::touches::calibrate_touches;
use poegp_calibration::model::touches::stepped::described;
use poegp_calibration::planning::next::doubt::{Judged, judged};
use poegp_calibration::planning::next::moved::moved_since;
use poegp_calibration::planning::next::outlook::outlook;
use poegp_calibration::planning::next::waiting::waiting;
use poegp_calibration::trust::Tier;
use poegp_protocol::cause::Cause;

/// Rows that are judged one by one when a measurement is continued.
const FEW: usize = 30;

/// Numbers of rows that are few, but show which of them is wrong.
const FIRST: Range<usize> = 8..16;
/// Most of the first rows that may be wrong: more of them are the rule.
const MOST_WRONG: usize = 2;
/// Share of the expected error that is left without a wrong row, at most; a right one that is unusual is worth less.
const WORTH: f64 = 0.5;

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
        let is_doubted = |row: &usize| self.doubted.iter().any(|(other, _)| other == row);
        let start = new.start;
        let (doubted, mut known): (Vec<usize>, Vec<usize>) = (0..start).partition(is_doubted);
        let mut asked: Vec<usize> = doubted.iter().copied().chain(new).collect();
        let arm = self.arm;
        let (gravity, class) = (self.gravity, self.class);
        let by = |known: &[usize], asked: &[usize]| {
            judged(
                &arm.robot,
                &arm.nominal,
                set,
                (known, asked),
                gravity,
                class,
            )
        };
        if known.len() < FIRST.start {
            return;
        }
        // A wrong one of the first rows widens what they predict, so that nothing contradicts it: each is left out in turn.
        if FIRST.contains(&known.len()) {
            let is_wrong = |row: &usize| {
                let others: Vec<usize> = known.iter().copied().filter(|k| k != row).collect();
                by(&others, &[*row]).iter().any(|judged| judged.contradicts)
            };
            let wrong: Vec<usize> = known.iter().copied().filter(is_wrong).collect();
            let mut before = set.clone();
            before.rows.truncate(start);
            let expected = |without: &[usize]| {
                let sets = (&before, &self.planned.set);
                outlook(&arm.robot, &arm.nominal, sets, without, gravity, class)
                    .map(|found| found.expected.mean_mm)
            };
            let is_less = |without: &[usize]| {
                let pair = expected(without).zip(expected(&doubted));
                pair.is_some_and(|(without, with)| without < WORTH * with)
            };
            let without = [doubted.as_slice(), &wrong].concat();
            if !wrong.is_empty() && wrong.len() <= MOST_WRONG && is_less(&without) {
                known.retain(|row| !wrong.contains(row));
                asked.extend(wrong);
            }
        }
        let found = by(&known, &asked);
        // A row that cannot be judged now stays what it was.
        self.doubted
            .retain(|(row, _)| found.iter().all(|judged| judged.row != *row));
        let wrong = found.iter().filter(|judged| judged.contradicts);
        let of = |judged: &Judged| (judged.row, judged.missed_mm);
        self.doubted.extend(wrong.map(of));
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

    /// Reports once that something moved, if so many rows in succession contradict the others.
    pub(super) fn report_moved(&mut self, set: &TouchSet) -> Result<(), Failure> {
        let Some(rows) = self.in_succession(set) else {
            self.moved = None;
            return Ok(());
        };
        if self.moved.replace(rows[0]) == Some(rows[0]) {
            return Ok(());
        }
        let arm = self.arm;
        let (gravity, class) = (self.gravity, self.class);
        let found = moved_since(&arm.robot, &arm.nominal, set, rows[0], gravity, class);
        let text = found.map(|(set, step)| described(&set, &step));
        let rows: Vec<usize> = rows.iter().map(|row| row + 1).collect();
        self.show.moved(&rows, text.as_deref())
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
