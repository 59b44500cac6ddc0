//! Mistakes that nobody can see in a file, because of the file's own numbers.

use poegp_calibration::identification::base_tools::fit_base_and_tools;
use poegp_calibration::measurement::sample::samples;
use poegp_calibration::numeric::statistics::percentile;
use poegp_calibration::robot::Robot;

use crate::mistakes::{HiddenBy, Mistake};
use crate::sets::{Good, read};
use crate::table::Table;

/// A radian counts as so many millimetres.
const LEVER_MM: f64 = 333.0;
/// Base and tool absorb a mistake that leaves less than so many times what the right file leaves.
const ABSORBED: f64 = 2.0;
/// The sag of wrong payloads is visible from so many scatters of one component on.
const VISIBLE_SAG: f64 = 4.0;
/// Sag of a simulated arm in mm for each kilogram and square metre of its lever.
const SAG: f64 = 0.137;
/// The lever of an arm in the middle of its range, as part of its length.
const LEVER: f64 = 0.45;

/// Median of what base and tool leave of a file, in mm; the reader's error hides nothing.
pub fn left_mm(robot: &Robot, text: &str) -> Option<f64> {
    let set = read(robot, text).ok()?;
    let samples = samples(&set, robot, &mut Vec::new()).ok()?;
    let chain = robot.chain().ok()?;
    let found = fit_base_and_tools(&chain, &samples);
    let mut errors: Vec<f64> = samples
        .iter()
        .map(|s| {
            let flange = chain.forward(&s.serial_joints);
            let pose = found.instrument_from_base * flange * found.flange_from_targets[s.tool];
            let error = s.observation.error(&pose);
            error.position_mm + 1e-3 * LEVER_MM * error.orientation_mrad.unwrap_or(0.0)
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    Some(percentile(&errors, 0.5))
}

/// Why a mistake does not count.
pub fn reason(
    good: &Good,
    good_left_mm: f64,
    mistake: &Mistake,
    wrong: &Table,
) -> Option<&'static str> {
    if mistake.unseen.is_some() {
        return mistake.unseen;
    }
    match mistake.hidden_by? {
        HiddenBy::BaseAndTool => {
            let robot = mistake.robot.as_ref().unwrap_or(&good.robot);
            let left = left_mm(robot, &good.text(wrong))?;
            (left < ABSORBED * good_left_mm).then_some("base and tool absorb it")
        }
        HiddenBy::Scatter => {
            let is_small = payload_change_mm(good, wrong) < VISIBLE_SAG * good.scatter_mm;
            (good.is_simulated() && is_small).then_some("the arm sags by less than the scatter")
        }
    }
}

/// Root mean square of what the change of the payloads means at the target of a simulated arm, in mm.
fn payload_change_mm(good: &Good, wrong: &Table) -> f64 {
    let column = good.table.column("payload_kg").expect("payloads");
    let (old, new) = (good.table.numbers(column), wrong.numbers(column));
    let change: f64 = old.iter().zip(&new).map(|(a, b)| (a - b).powi(2)).sum();
    let lever = LEVER * good.reach();
    SAG * lever * lever * (change / old.len() as f64).sqrt()
}
