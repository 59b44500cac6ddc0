//! Which parts a check names, and which not.

use poegp_calibration::measurement::sample::InstrumentSample;
use poegp_calibration::model::Method;
use poegp_calibration::model::config::Config;
use poegp_calibration::simulation::{Disturbance, Scenario};
use poegp_calibration::verification::Options;
use poegp_calibration::verification::hypotheses::Part;

use crate::study::Cell;

/// Two joints that have moved by opposite angles look most like a tool that has moved. They are named alone, with their
/// angles.
#[test]
fn two_opposite_joints_are_named_alone() {
    for (name, scenario, seed) in [
        ("abb-irb120", Scenario::Paper, 6),
        ("abb-irb120", Scenario::WithBacklash, 7),
        ("abb-irb4400-serial", Scenario::Paper, 8),
    ] {
        let mut arm = Cell::trained(120, name, scenario, seed, &Config::new(Method::Elastic));
        for size in [0.05_f64, 0.1, -0.07] {
            arm.simulator.disturb(Disturbance::Joint {
                joint: 1,
                offset: size.to_radians(),
            });
            arm.simulator.disturb(Disturbance::Joint {
                joint: 2,
                offset: -size.to_radians(),
            });
            let report = arm.trial(None, 20, false, &Options::default());
            for (joint, back) in [(1, -size), (2, size)] {
                let offset = back.to_radians();
                arm.simulator.disturb(Disturbance::Joint { joint, offset });
            }
            let named: Vec<(Part, f64)> = (report.changes.iter())
                .map(|c| (c.part, c.offset_deg.map_or(0.0, |e| e.value)))
                .collect();
            println!("{name} {scenario:?} {size}: {named:?}");
            let mut parts: Vec<Part> = named.iter().map(|(part, _)| *part).collect();
            parts.sort_by_key(|part| *part != Part::Joint(2));
            assert_eq!(parts, [Part::Joint(2), Part::Joint(3)], "{named:?}");
            assert!(
                named
                    .iter()
                    .all(|(_, deg)| (deg.abs() / size.abs() - 1.0).abs() < 0.3),
                "{named:?}"
            );
        }
    }
}

/// A row with the joints of its neighbour hides every change. It is left out and named, and the check goes on.
#[test]
fn a_row_with_other_joints_is_named_and_the_check_goes_on() {
    for (name, scenario, seed) in [
        ("abb-irb120", Scenario::Paper, 11),
        ("abb-irb4400-serial", Scenario::Paper, 12),
        ("ur10", Scenario::WithBacklash, 13),
    ] {
        let mut arm = Cell::trained(60, name, scenario, seed, &Config::new(Method::Elastic));
        for wrong in [1, 6, 10, 15] {
            let mut rows = arm.disturbed(None, 20);
            let (before, rest) = rows.split_at_mut(wrong);
            rest[0].joints.clone_from(&before[wrong - 1].joints);
            rest[0].serial_joints = before[wrong - 1].serial_joints.clone();
            let report = arm.checked(&rows, &Options::default());
            assert_eq!(report.outlier_lines, [wrong + 2], "{name}");
            assert!(report.is_searched, "{name}");
            assert!(report.sensitivity.iter().any(|s| s.smallest.is_some()));
        }
    }
}

/// Under a payload that the model was not trained with an arm sags by an amount that it does not know: no joint is blamed for
/// it. Rows with other payloads are searched.
#[test]
fn no_joint_is_blamed_for_a_payload_that_was_never_trained() {
    let (name, scenario) = ("abb-irb4400-serial", Scenario::Paper);
    let options = Options::default();
    let mut arm = Cell::trained(60, name, scenario, 9, &Config::new(Method::Elastic));
    let joint = Disturbance::Joint {
        joint: 2,
        offset: 0.1_f64.to_radians(),
    };
    let rows = arm.disturbed(Some(joint), 32);
    let heavy = |from: usize| -> Vec<InstrumentSample> {
        let with = |(k, s): (usize, &InstrumentSample)| InstrumentSample {
            payload_kg: if k >= from { Some(30.0) } else { s.payload_kg },
            ..s.clone()
        };
        rows.iter().enumerate().map(with).collect()
    };
    let all = arm.checked(&heavy(0), &options);
    assert_eq!((all.untrained_payload.len(), all.is_searched), (32, false));
    assert!(all.changes.is_empty() && all.sensitivity.is_empty());
    let some = arm.checked(&heavy(20), &options);
    assert_eq!(some.untrained_payload, (22..34).collect::<Vec<_>>());
    assert_eq!((some.rows.len(), some.is_searched), (32, true));
    let named: Vec<Part> = some.changes.iter().map(|c| c.part).collect();
    assert_eq!(named, [Part::Joint(3)]);
    let none = arm.checked(&heavy(32), &options);
    assert!(none.untrained_payload.is_empty() && none.is_searched);
}
