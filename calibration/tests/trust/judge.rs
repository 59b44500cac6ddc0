//! What the examination says of one file, and whether that is right.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use poegp_calibration::input_error::InputError;
use poegp_calibration::measurement::sample::samples;
use poegp_calibration::robot::Robot;
use poegp_calibration::trust::{Cause, Finding, Tier, examine};

use crate::sets::read;

/// What happened to a file.
pub enum Answer {
    /// The reader refused the file.
    Unread(Box<InputError>),
    /// The findings of the examination, and its time.
    Examined(Vec<Finding>, Duration),
    /// The examination panicked.
    Panicked,
}

/// Gives a file to the reader and then to the examination.
pub fn ask(robot: &Robot, text: &str, gravity: Vector3<f64>) -> Answer {
    let set = match read(robot, text) {
        Ok(set) => set,
        Err(error) => return Answer::Unread(error),
    };
    let samples = match samples(&set, robot, &mut Vec::new()) {
        Ok(samples) => samples,
        Err(error) => return Answer::Unread(Box::new(error)),
    };
    let start = Instant::now();
    match catch_unwind(AssertUnwindSafe(|| {
        examine(robot, &set, &samples, gravity, true)
    })) {
        Ok(findings) => Answer::Examined(findings.0, start.elapsed()),
        Err(_) => Answer::Panicked,
    }
}

impl Answer {
    /// Returns the findings that a user sees: warnings and refusals.
    pub fn alarms(&self) -> impl Iterator<Item = &Finding> {
        let all: &[Finding] = match self {
            Self::Examined(findings, _) => findings,
            Self::Unread(_) | Self::Panicked => &[],
        };
        all.iter().filter(|f| f.tier >= Tier::Warning)
    }

    /// Returns whether there is an alarm besides those that are `true_anyway` of the set.
    pub fn is_caught(&self, true_anyway: &[Cause]) -> bool {
        matches!(self, Self::Unread(_)) || self.alarms().any(|f| !true_anyway.contains(&f.cause))
    }

    pub fn is_refused(&self) -> bool {
        matches!(self, Self::Unread(_)) || self.alarms().any(|f| f.tier == Tier::Refused)
    }

    /// Returns whether one of the `right` causes is among the gravest findings, or the reader's error names what was
    /// `changed`.
    pub fn is_right(&self, right: &[Cause], changed: &Changed) -> bool {
        if let Self::Unread(error) = self {
            let column = error.column.as_ref().map(|(_, name)| name.as_str());
            return changed.robot
                || column.is_some_and(|c| changed.columns.contains(c))
                || error
                    .line
                    .is_some_and(|l| l > 1 && changed.lines.contains(&l));
        }
        let gravest = self.alarms().map(|f| f.tier).max();
        self.alarms()
            .any(|f| Some(f.tier) == gravest && right.contains(&f.cause))
    }

    /// Returns whether an alarm names one of these joints.
    pub fn names(&self, joints: &[usize]) -> bool {
        let patterns = joints.iter().flat_map(|j| {
            let after = [
                format!("joint {j} "),
                format!("joints {j} "),
                format!("joints {j},"),
            ];
            let within = [
                format!(", {j} and "),
                format!(" and {j} look"),
                format!(", {j},"),
            ];
            after.into_iter().chain(within)
        });
        let patterns: Vec<String> = patterns.collect();
        let is_named = |f: &Finding| patterns.iter().any(|p| f.text.contains(p));
        joints.is_empty() || matches!(self, Self::Unread(_)) || self.alarms().any(is_named)
    }

    /// Returns the causes with value and threshold, or the reader's error.
    pub fn summary(&self) -> String {
        match self {
            Self::Panicked => "PANICKED".to_owned(),
            Self::Unread(error) => format!("reader: {}", error.to_string().replace('\n', "; ")),
            Self::Examined(all, _) if all.is_empty() => "silent".to_owned(),
            Self::Examined(all, _) => {
                let one = |f: &Finding| {
                    let tier = match f.tier {
                        Tier::Refused => "!",
                        Tier::Warning => "",
                        Tier::Note => "~",
                    };
                    format!("{tier}{} {:.3e}/{:.3e}", f.cause, f.value, f.threshold)
                };
                all.iter().map(one).collect::<Vec<_>>().join(", ")
            }
        }
    }

    /// Returns the sentences of the findings.
    pub fn texts(&self) -> Vec<String> {
        match self {
            Self::Examined(all, _) => all
                .iter()
                .map(|f| format!("{}: {}", f.cause, f.text))
                .collect(),
            Self::Unread(_) | Self::Panicked => Vec::new(),
        }
    }

    pub fn time(&self) -> Option<Duration> {
        match self {
            Self::Examined(_, time) => Some(*time),
            Self::Unread(_) | Self::Panicked => None,
        }
    }
}

/// What a mistake changed in a file.
pub struct Changed {
    /// The file is declared to be of another robot.
    robot: bool,
    /// Columns by their new names.
    columns: BTreeSet<String>,
    /// Line numbers, from 1, of changed and of new rows.
    lines: BTreeSet<usize>,
}

impl Changed {
    /// Compares two files with the same columns in the same order.
    pub fn between(good: &str, wrong: &str, robot: bool) -> Self {
        let (old, new) = (
            crate::table::Table::parse(good),
            crate::table::Table::parse(wrong),
        );
        let (mut columns, mut lines) = (BTreeSet::new(), BTreeSet::new());
        for (column, name) in new.header.iter().enumerate() {
            if old.header.get(column) != Some(name) {
                columns.insert(name.clone());
            }
        }
        for (row, fields) in new.rows.iter().enumerate() {
            let before = old.rows.get(row);
            if before.is_none_or(|b| b.len() != fields.len()) {
                lines.insert(row + 2);
            }
            for (column, field) in fields.iter().enumerate() {
                if before.and_then(|b| b.get(column)) != Some(field) {
                    columns.extend(new.header.get(column).cloned());
                    lines.insert(row + 2);
                }
            }
        }
        Self {
            robot,
            columns,
            lines,
        }
    }
}
