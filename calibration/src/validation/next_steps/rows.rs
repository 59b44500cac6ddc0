//! What is wrong with rows of the file, and what to do about it.

use poegp_protocol::cause::Cause;

use crate::measurement::sample::InstrumentSample;
use crate::trust::{Finding, Tier};
use crate::validation::next_steps::step::{Kind, Step};
use crate::validation::next_steps::task::Task;

/// Share of the largest displacement: while the arm is farther from its warm state than this, a row belongs to the warm-up.
const WARMING: f64 = 0.25;

/// Returns what to do about rows, beginning with the rows that have warnings. The gain of these steps is unknown beforehand.
pub fn steps(task: &Task) -> Vec<Step> {
    let step = |text: String| Step {
        kind: Kind::Rows,
        text,
        poses: None,
        range: None,
        before_mm: None,
        after_mm: None,
    };
    let instrument = task.instrument_moved_mm;
    let warned = task.warnings.iter().filter(|w| w.tier == Tier::Warning);
    // A drift is the instrument's, where its reference points show one.
    let warned = warned.filter(|w| instrument.is_none() || w.cause != Cause::Drift);
    let remedies = warned.filter_map(|w| Some(step(format!("{}: {}", remedy(w)?, w.text))));
    let mut out: Vec<Step> = remedies.collect();
    let drift = match instrument {
        Some(mm) => Some(format!(
            "Calibrate again with --correct-drift: the reference points show that the instrument moved by up to {mm:.2} mm"
        )),
        None => warm_up(task),
    };
    out.extend(drift.map(step));
    out
}

/// Returns what to do about the rows of a warning; `None` if it is not about rows.
fn remedy(warning: &Finding) -> Option<&'static str> {
    Some(match warning.cause {
        // An axis that is not straight is no fault of the rows.
        Cause::Mixed if warning.rows.is_empty() => return None,
        Cause::Step | Cause::Drift | Cause::Mixed => {
            "Measure again what was measured before something moved; if only the target was remounted, give each mounting a \
             session of its own"
        }
        Cause::Outlier => "Measure these rows again",
        Cause::Rows => "Measure these rows again, or remove them",
        Cause::Lag => "Measure these rows again with the robot at rest, or remove them",
        Cause::Stuck | Cause::Placeholder | Cause::Clip | Cause::Copies => "Remove these rows",
        Cause::Time => "Give the file a column with the time of each row",
        Cause::Payload => "Measure the same poses with and without the payload",
        _ => return None,
    })
}

/// Returns steps for what these rows cannot show, whatever the error within the measured ranges is.
pub fn undetermined(task: &Task) -> Vec<Step> {
    let findings = task
        .identifiability
        .into_iter()
        .flat_map(|found| &found.findings);
    let asked = findings.filter_map(|finding| Some((finding.remedy?, &finding.text)));
    asked
        .map(|(remedy, text)| Step {
            kind: Kind::Poses,
            text: format!("{remedy}: {text}"),
            poses: None,
            range: None,
            before_mm: None,
            after_mm: None,
        })
        .collect()
}

fn warm_up(task: &Task) -> Option<String> {
    let report = &task.calibration.warm_up.as_ref()?.report;
    let expected = task.expected.map_or(0.0, |expected| expected.mean_mm);
    let rows = report
        .time_constant
        .map(|time| warming_rows(task.samples, time));
    let which = match rows {
        Some(rows) if rows < task.samples.len() => {
            format!("The first {rows} rows are of a colder arm")
        }
        _ => "The arm warmed up in all rows".to_owned(),
    };
    let moved = format!(
        "targets moved by up to {:.3} mm until the end",
        report.largest_mm
    );
    match report.removed {
        false => Some(format!(
            "{which}, {moved}: warm the arm up before you measure, or omit `--warm-up keep`"
        )),
        // A warm-up that was removed does no harm to a warm arm. A cold arm is off by as much.
        true if report.largest_mm > expected => Some(format!(
            "{which}, {moved}; the model excludes this and describes the warm arm: warm the arm up before it works, \
             and before you measure again"
        )),
        true => None,
    }
}

/// Returns the number of rows at the beginning of their sessions in which the arm is not warm yet; `time_constant` is in the
/// unit of the rows' times.
fn warming_rows(samples: &[InstrumentSample], time_constant: f64) -> usize {
    let until = -time_constant * libm::log(WARMING);
    let times = samples.iter().filter_map(|s| s.elapsed);
    times.filter(|time| time.value < until).count()
}
