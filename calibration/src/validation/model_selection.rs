//! Chooses the right model for the data by cross-validation within the training data only.
//!
//! Every candidate predicts every training pose with a model that did not see it. The candidate with the least mean error is
//! the best. The one that is shipped is the *simplest* whose errors are not larger by more than one standard error of the
//! pose-by-pose difference, or two from few poses: thirty poses do not get a process that they cannot support. A method that
//! the user named is kept, with a warning when a simpler one is better. In either case the mean error must be well below
//! that of the nominal model.

use std::collections::BTreeMap;

use poegp_protocol::cause::Cause;
use serde::Serialize;

use crate::measurement::folds::held_out_together;
use crate::measurement::noise::InstrumentNoise;
use crate::measurement::sample::InstrumentSample;
use crate::measurement::shared_range::SharedRange;
use crate::model::config::Config;
use crate::model::{Method, rejected_gross_outliers};
use crate::numeric::statistics::{MEAN_LENGTH, Summary};
use crate::trust::{Finding, Tier, wording};
use crate::validation::cross_validation::{CompareError, Task};
use crate::validation::worst_payload::WorstPayload;

pub use crate::validation::candidates::{Candidate, FOLDS, candidates, folds, named_and_simpler};

/// Number of different poses below which a richer model must be better by two standard errors. With one standard error, one of nine
/// sets of thirty poses got a process that costs 5 %.
const CAREFUL: usize = 40;
/// Number of different poses below which the folds may choose the wrong model.
pub const UNCERTAIN: usize = 25;
/// Factor by which the error differed from what the folds of fewer poses expected, over nine sets.
pub const FEW_FACTOR: u32 = 3;
/// Most poses that a fold learns hyperparameters from.
const HYPERPARAMETER_POSES: usize = 40;
/// Ratio to a simpler model's mean held-out error above which a model that is kept gets a warning.
const WORSE: f64 = 1.03;
/// Largest share of the nominal model's mean held-out error that a calibration may have; otherwise it is refused.
pub const GAIN: f64 = 0.9;
/// Number of poses from which on more of them do not lower an error above [`CONTRADICTORY_MM`] in the mean.
const MANY: usize = 100;
const CONTRADICTORY_MM: f64 = 1.0;
/// Number of poses from which on a mean held-out error above the second number, in mm, and above the third times that of the
/// stated noise, is more than good rows show. Public sets of six arms have at most 0.29 mm.
const SCATTERED: (usize, f64, f64) = (60, 0.5, 2.0);
/// Share of the rows that may be left out without a warning.
const UNEXPLAINED: f64 = 0.05;

/// Returns how many standard errors a simpler model may be behind the best.
fn standard_errors(poses: usize) -> f64 {
    if poses < CAREFUL { 2.0 } else { 1.0 }
}

/// One row of the table that the choice was made from.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the candidate.
    pub candidate: &'static str,
    /// Held-out position errors in mm.
    pub position_mm: Summary,
    /// Mean of the pose-by-pose difference to the best candidate, in mm.
    pub behind_best_mm: f64,
    /// Standard error of `behind_best_mm`; the rows of one configuration count once.
    pub standard_error_mm: f64,
    /// Whether this candidate was chosen.
    pub chosen: bool,
}

/// A candidate that cannot be used on these data.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// Name of the candidate.
    pub candidate: &'static str,
    /// Why the candidate could not be calibrated on some of the folds.
    pub reason: String,
}

/// The chosen model, with the reasons for the choice.
#[derive(Clone, Debug)]
pub struct Choice {
    /// Whether the user named the method beforehand.
    pub is_named: bool,
    /// Number of different configurations, or of stations.
    pub poses: usize,
    /// Number of held-out rows.
    pub held_out: usize,
    /// Configuration of the chosen model.
    pub config: Config,
    /// Candidates that were compared, simplest first.
    pub table: Vec<Row>,
    /// Candidates that are not in the table.
    pub left_out: Vec<LeftOut>,
    /// The payload whose rows are worst predicted, if the others are predicted far better.
    pub worst_payload: Option<WorstPayload>,
    /// Indices of the rows that no geometry explains, and that were neither learnt from nor held out.
    pub unexplained: Vec<usize>,
    /// Stated standard uncertainty of a measured position component, in mm, if every row has one.
    pub stated_mm: Option<f64>,
}

/// Cross-validates the candidates on `task.train` and chooses one.
///
/// `progress` is called after every calibration. A candidate that cannot be calibrated on some of the folds, or not for a
/// device, would not be a safe choice and is left out. Poses that no geometry explains
/// are used neither for training nor for testing, unless they share a range of a joint.
///
/// # Errors
/// [`CompareError`] of the first candidate when no candidate can be calibrated.
pub fn select_model(
    task: &Task<'_>,
    candidates: &[Candidate],
    progress: &mut dyn FnMut(),
) -> Result<Choice, CompareError> {
    select(task, candidates, false, progress)
}

/// Does what [`select_model`] does, but keeps the last candidate whatever the others' errors are.
///
/// # Errors
/// [`CompareError`] when the last candidate cannot be calibrated.
pub fn keep_named(
    task: &Task<'_>,
    candidates: &[Candidate],
    progress: &mut dyn FnMut(),
) -> Result<Choice, CompareError> {
    select(task, candidates, true, progress)
}

fn select(
    task: &Task<'_>,
    candidates: &[Candidate],
    is_named: bool,
    progress: &mut dyn FnMut(),
) -> Result<Choice, CompareError> {
    let unexplained = candidates.first();
    let unexplained = unexplained.map(|first| unexplained_rows(task, &first.config));
    let unexplained = unexplained.unwrap_or_default();
    let rows = task.train.iter().enumerate();
    let train: Vec<InstrumentSample> = rows
        .filter(|(row, _)| !unexplained.contains(row))
        .map(|(_, sample)| sample.clone())
        .collect();
    let groups = held_out_together(&train, &task.robot.kinds());
    let poses = groups.len();
    let task = &Task {
        train: &train,
        folds: folds(poses),
        ..*task
    };
    let mut pose = vec![0; train.len()];
    for (group, rows) in groups.iter().enumerate() {
        rows.iter().for_each(|row| pose[*row] = group);
    }
    let rows = task.folds().held_out();
    let compared = compare(task, candidates, is_named, progress)?;
    let Compared {
        candidates, errors, ..
    } = &compared;
    let mean = |e: &Vec<f64>| e.iter().sum::<f64>() / e.len().max(1) as f64;
    let best = (0..errors.len())
        .min_by(|a, b| mean(&errors[*a]).total_cmp(&mean(&errors[*b])))
        .unwrap_or(0);
    let pose_of_row: Vec<usize> = rows.iter().map(|row| pose[*row]).collect();
    let behind = |i: usize| behind(&errors[i], &errors[best], &pose_of_row);
    let simplest = (0..errors.len())
        .find(|i| {
            let (m, standard_error) = behind(*i);
            m <= standard_errors(poses) * standard_error
        })
        .unwrap_or(best);
    let chosen = match is_named {
        true => errors.len() - 1,
        false => simplest,
    };
    let table = candidates.iter().enumerate().map(|(i, c)| {
        let (behind_best_mm, standard_error_mm) = behind(i);
        Row {
            candidate: c.name,
            position_mm: Summary::new(&errors[i]),
            behind_best_mm,
            standard_error_mm,
            chosen: i == chosen,
        }
    });
    Ok(Choice {
        is_named,
        poses,
        held_out: rows.len(),
        unexplained,
        worst_payload: WorstPayload::find(
            rows.iter()
                .map(|row| &train[*row])
                .zip(errors[chosen].iter().copied()),
        ),
        stated_mm: stated_mm(&train, &candidates[chosen].config),
        table: table.collect(),
        config: candidates[chosen].config,
        left_out: compared.left_out,
    })
}

/// Returns the rows on which no candidate is judged: the gross outliers. If these share a range of a joint, they are the arm's,
/// and a model that does not describe them is off by as much there.
fn unexplained_rows(task: &Task<'_>, config: &Config) -> Vec<usize> {
    let outliers = rejected_gross_outliers(task.robot, task.train, config);
    let joints: Vec<&[f64]> = task.train.iter().map(|s| s.joints.as_slice()).collect();
    if SharedRange::find(&joints, &outliers).is_some() {
        return Vec::new();
    }
    outliers
}

/// Candidates that could be cross-validated, and those that could not.
struct Compared<'a> {
    candidates: Vec<&'a Candidate>,
    /// Position errors of each of `candidates` on the held-out rows, mm.
    errors: Vec<Vec<f64>>,
    left_out: Vec<LeftOut>,
}

/// Cross-validates the candidates, of which at least one must succeed, and the last if it `is_named`.
fn compare<'a>(
    task: &Task<'_>,
    candidates: &'a [Candidate],
    is_named: bool,
    progress: &mut dyn FnMut(),
) -> Result<Compared<'a>, CompareError> {
    let mut out = Compared {
        candidates: Vec::new(),
        errors: Vec::new(),
        left_out: Vec::new(),
    };
    let mut first = None;
    for candidate in candidates {
        let config = Config {
            hyperparameter_poses: HYPERPARAMETER_POSES,
            ..candidate.config
        };
        match task.held_out(&config, progress) {
            Ok(held_out) => {
                let errors = held_out.iter().map(|e| e.position_mm);
                out.errors.push(errors.collect());
                out.candidates.push(candidate);
            }
            Err(error)
                if is_named && std::ptr::eq(candidate, &candidates[candidates.len() - 1]) =>
            {
                return Err(error);
            }
            Err(error) => {
                out.left_out.push(LeftOut {
                    candidate: candidate.name,
                    reason: error.error.to_string(),
                });
                first.get_or_insert(error);
            }
        }
    }
    match (out.candidates.is_empty(), first) {
        (true, Some(error)) => Err(error),
        _ => Ok(out),
    }
}

/// Returns by how much `errors` are above those of the `best` on average, with the standard error of this mean. `pose` is the
/// configuration of each error: repeats of one have one model error and count together.
fn behind(errors: &[f64], best: &[f64], pose: &[usize]) -> (f64, f64) {
    let d: Vec<f64> = errors.iter().zip(best).map(|(a, b)| a - b).collect();
    let (n, m) = (
        d.len() as f64,
        d.iter().sum::<f64>() / d.len().max(1) as f64,
    );
    let mut sums = BTreeMap::new();
    for (pose, x) in pose.iter().zip(&d) {
        *sums.entry(*pose).or_insert(0.0) += x - m;
    }
    let count = sums.len() as f64;
    let variance = sums.values().map(|s: &f64| s * s).sum::<f64>() / (count - 1.0).max(1.0);
    (m, (variance * count).sqrt() / n)
}

/// Returns the standard uncertainty of a position component that the samples or the settings state, in mm.
fn stated_mm(samples: &[InstrumentSample], config: &Config) -> Option<f64> {
    let noise = config.instrument_noise();
    let samples: Vec<InstrumentSample> = (samples.iter())
        .map(|s| s.clone().with_noise(noise))
        .collect();
    Some(1e3 * InstrumentNoise::rms_over(&samples).position?)
}

impl Choice {
    /// Returns the chosen row of the table, with its index.
    fn chosen(&self) -> Option<(usize, &Row)> {
        self.table.iter().enumerate().find(|(_, row)| row.chosen)
    }

    /// Returns one sentence on what was chosen and why.
    pub fn reason(&self) -> String {
        let Some((rank, chosen)) = self.chosen() else {
            return String::new();
        };
        let mean = |row: &Row| format!("`{}` {:.4} mm", row.candidate, row.position_mm.mean);
        let others: Vec<String> = self.table.iter().filter(|r| !r.chosen).map(mean).collect();
        let why = match (self.is_named, chosen.behind_best_mm > 0.0) {
            (true, _) => "as requested",
            (false, true) if standard_errors(self.poses) > 1.0 => {
                "the simplest within two standard errors of the best"
            }
            (false, true) => "the simplest within one standard error of the best",
            (false, false) if rank + 1 < self.table.len() => "the best",
            (false, false) => "the best, and no simpler one is close enough",
        };
        let against = match others.is_empty() {
            true => String::new(),
            false => format!("; {}", others.join(", ")),
        };
        format!(
            "`{}`, {why}: {:.4} mm mean on {} rows held out by {} folds{against}",
            chosen.candidate,
            chosen.position_mm.mean,
            self.held_out,
            folds(self.poses)
        )
    }

    /// Returns the finding that no geometry explains many of the rows.
    fn many_unexplained(&self, lines: &[usize]) -> Option<Finding> {
        let rows: Vec<usize> = self.unexplained.iter().map(|row| lines[*row]).collect();
        let share = rows.len() as f64 / lines.len() as f64;
        let text = format!(
            "no geometry explains {} of {} rows ({}), which are left out",
            rows.len(),
            lines.len(),
            wording::lines(&rows)
        );
        let finding = Finding::new(Cause::Outlier, Tier::Warning, text, share, UNEXPLAINED);
        (share > UNEXPLAINED).then(|| finding.of_rows(rows))
    }

    /// Returns what is wrong with the choice: a simpler model is better on rows that were not trained on, many rows were left
    /// out, or the nominal model is hardly worse. `lines` are those of the training rows.
    pub fn findings(&self, lines: &[usize]) -> Vec<Finding> {
        let of_payload = self.worst_payload.iter().map(WorstPayload::finding);
        let mut findings: Vec<Finding> = of_payload.chain(self.many_unexplained(lines)).collect();
        let Some((rank, chosen)) = self.chosen() else {
            return findings;
        };
        let mut add = |cause, tier, text, value, threshold| {
            findings.push(Finding::new(cause, tier, text, value, threshold));
        };
        let after = chosen.position_mm.mean;
        let simpler = self.table[..rank].iter();
        let best = simpler.min_by(|a, b| a.position_mm.mean.total_cmp(&b.position_mm.mean));
        if let Some(best) = best.filter(|best| after > WORSE * best.position_mm.mean) {
            let text = format!(
                "`{}` is simpler and better on held-out rows: {:.4} mm mean, `{}` {after:.4} mm",
                best.candidate, best.position_mm.mean, chosen.candidate
            );
            let ratio = after / best.position_mm.mean;
            add(Cause::Model, Tier::Warning, text, ratio, WORSE);
        }
        let poses = self.poses;
        if rank > 0 && poses < UNCERTAIN {
            let text = format!(
                "{poses} poses are too few to choose `{}` reliably: a simpler model may be better, and the expected \
                 error may be wrong by a factor of {FEW_FACTOR}; measure at least {UNCERTAIN}",
                chosen.candidate
            );
            add(
                Cause::Model,
                Tier::Warning,
                text,
                poses as f64,
                UNCERTAIN as f64,
            );
        }
        let nominal_arm = self
            .table
            .iter()
            .find(|r| r.candidate == Method::BaseTool.name());
        let asks_for_gain = !self.is_named || self.config.method != Method::BaseTool;
        if let Some(nominal_arm) = nominal_arm.filter(|_| asks_for_gain) {
            let before = nominal_arm.position_mm.mean;
            let text = format!(
                "these rows do not show that a calibration helps: the expected error on other rows is {before:.4} mm \
                for the nominal robot with base and tool fitted, and {after:.4} mm with `{}`; {}",
                chosen.candidate,
                match poses >= MANY && after > CONTRADICTORY_MM {
                    true =>
                        "more poses do not help: the rows contradict each other (two targets, payloads or robots?), \
                        or the arm needs a richer method",
                    false => "measure more poses",
                }
            );
            if after >= GAIN * before {
                add(Cause::Gain, Tier::Refused, text, after / before, GAIN);
                return findings;
            }
        }
        // A simpler model that was asked for may miss what it cannot describe.
        let has_richest = (self.table.iter()).any(|row| row.candidate == Method::Elastic.name());
        let all = self.table.iter().map(|row| row.position_mm.mean);
        let after = all.fold(f64::INFINITY, f64::min);
        let (many, least, times) = SCATTERED;
        let of_noise = self.stated_mm.map_or(0.0, |sigma| MEAN_LENGTH * sigma);
        let most = least.max(times * of_noise);
        if has_richest && poses >= many && after > most {
            let text = format!(
                "the best model misses held-out rows by {after:.3} mm on average, more than the scatter of an intact \
                arm and instrument: check that base and target were firmly mounted, that every row was read with the \
                arm standing still, and that no \
                 joint has play; if the instrument is that noisy, state its noise with --position-sigma-mm"
            );
            add(Cause::Noise, Tier::Warning, text, after, most);
        }
        findings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choice(poses: usize, unexplained: usize, drawn_mm: f64, chosen_mm: f64) -> Choice {
        let row = |candidate, mean: f64, chosen| Row {
            candidate,
            position_mm: Summary::new(&[mean]),
            behind_best_mm: 0.0,
            standard_error_mm: 0.0,
            chosen,
        };
        Choice {
            is_named: false,
            poses,
            held_out: poses,
            unexplained: (0..unexplained).collect(),
            worst_payload: None,
            stated_mm: None,
            config: Config::default(),
            table: vec![
                row(Method::BaseTool.name(), drawn_mm, false),
                row(Method::Poe.name(), chosen_mm, true),
            ],
            left_out: Vec::new(),
        }
    }

    /// Lines of a file with a header.
    fn lines(rows: usize) -> Vec<usize> {
        (2..2 + rows).collect()
    }

    #[test]
    fn a_lack_of_gain_is_due_to_few_rows_or_to_rows_that_contradict_each_other() {
        for (poses, says) in [(30, "measure more poses"), (300, "contradict each other")] {
            let findings = choice(poses, 0, 6.0, 5.9).findings(&lines(poses));
            let [finding] = findings.as_slice() else {
                panic!("{findings:?}");
            };
            assert_eq!((finding.cause, finding.tier), (Cause::Gain, Tier::Refused));
            assert!(finding.text.contains(says), "{finding:?}");
        }
    }

    #[test]
    fn many_rows_that_are_left_out_are_a_warning() {
        assert!(choice(285, 15, 6.0, 0.1).findings(&lines(300)).is_empty());
        let findings = choice(240, 60, 6.0, 0.1).findings(&lines(300));
        assert_eq!(findings[0].cause, Cause::Outlier);
        assert!(findings[0].text.contains("60 of 300"), "{findings:?}");
        assert_eq!(findings[0].rows, (2..62).collect::<Vec<usize>>());
    }
}
