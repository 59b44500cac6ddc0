//! What moves while the rows of a check are measured is no change since the calibration.

use nalgebra::Vector3;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::simulation::{Disturbance, Scenario};
use poegp_calibration::verification::Options;
use poegp_calibration::verification::hypotheses::Part;

use crate::study::Cell;

/// Poses of a check.
const CHECK: usize = 20;

/// Shifts the measured position of a row.
fn shift(row: &mut InstrumentSample, by: Vector3<f64>, positions_alone: bool) {
    let mut pose = row.observation.pose().unwrap();
    pose.translation += by;
    row.observation = match positions_alone {
        true => Observation::Position(pose.translation),
        false => Observation::Pose(pose),
    };
}

/// A step of the instrument and its creep are named with their line, and neither is called a base that has moved since the
/// calibration. A joint that had moved before is found beside them. An arm of which nothing moves has no step.
#[test]
fn a_step_or_creep_of_the_rows_is_no_moved_base() {
    let (name, scenario) = ("abb-irb4400-serial", Scenario::Paper);
    let mut arm = Cell::trained(120, name, scenario, 5, &Config::new(Method::Elastic));
    let joint = Disturbance::Joint {
        joint: 1,
        offset: 0.05_f64.to_radians(),
    };
    for positions_alone in [false, true] {
        for (mm, before) in [
            (5.0, None),
            (1.0, None),
            (0.4, Some(joint)),
            (0.0, Some(joint)),
        ] {
            let along = Vector3::new(0.48, 0.6, -0.64) * (1e-3 * mm);
            let fresh = arm.disturbed(before, CHECK);
            for (from, is_step) in [(10, true), (6, true), (0, false)] {
                let mut rows = fresh.clone();
                for (k, row) in rows.iter_mut().enumerate() {
                    let share = match is_step {
                        true => f64::from(u8::from(k >= from)),
                        false => k as f64 / (CHECK - 1) as f64,
                    };
                    shift(row, share * along, positions_alone);
                }
                let report = arm.checked(&rows, &Options::default());
                let what = format!(
                    "{mm} mm, {from}, {is_step}, {positions_alone}: {:?}",
                    report.during
                );
                let named: Vec<Part> = report.changes.iter().map(|c| c.part).collect();
                let expected = before.map_or(Vec::new(), |_| vec![Part::Joint(2)]);
                assert_eq!(named, expected, "{what}");
                let Some(moved) = report.during else {
                    assert_eq!(mm, 0.0, "{what}");
                    continue;
                };
                assert_eq!(moved.part, Part::Base, "{what}");
                assert_eq!(moved.from_line, is_step.then_some(from + 2), "{what}");
                assert!((moved.moves_mm - mm).abs() < 0.15, "{what}");
                assert!(report.without_mm.mean < 0.15, "{what}");
            }
        }
    }
}
