//! Laws of what a touch file shows of itself: a step along its rows, a single wrong row, a mistake in all of its rows.
//!
//! `POEGP_MEASURED_DATA=FOLDER cargo test --release -p poegp-calibration --test touch -- steps --include-ignored --nocapture`
//! also tries the sets of `touch` beside FOLDER and many simulated ones.

use nalgebra::{SMatrix, SVector, Vector3};
use poegp_calibration::measurement::touch::{Reading, TouchSet};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::Scenario;
use poegp_calibration::trust::{Finding, Tier};
use poegp_protocol::cause::Cause;
use poegp_runtime::math::se3::Pose;

use crate::measured::{SIMULATED, calibrated};
use crate::sets::{folder, robot, touches};
use crate::trial::simulated;

fn built_in(name: &str) -> Robot {
    Robot::load(name, &LoadOptions::default()).unwrap()
}

/// Returns joints at which the flange of the nominal arm stands beside where it stands at `q`, in the same orientation.
pub fn beside(robot: &Robot, q: &[f64], by: impl Fn(&Pose<f64>) -> Vector3<f64>) -> Vec<f64> {
    let chain = robot.chain().unwrap();
    let start = chain.forward(q);
    let goal = Pose {
        translation: start.translation + by(&start),
        ..start
    };
    let error = |q: &[f64]| {
        let at = chain.forward(q);
        let turn = Pose {
            rotation: goal.rotation * at.rotation.transpose(),
            translation: Vector3::zeros(),
        };
        let (apart, turn) = (goal.translation - at.translation, turn.log().angular);
        SVector::<f64, 6>::from_fn(|i, _| if i < 3 { apart[i] } else { turn[i - 3] })
    };
    let mut q = q.to_vec();
    for _ in 0..6 {
        let now = error(&q);
        let mut jacobian = SMatrix::<f64, 6, 6>::zeros();
        for joint in 0..6 {
            let mut next = q.clone();
            next[joint] += 1e-6;
            jacobian.set_column(joint, &((now - error(&next)) / 1e-6));
        }
        let squares = jacobian.transpose() * jacobian + SMatrix::identity() * 1e-7;
        let step = squares.try_inverse().unwrap() * jacobian.transpose() * now;
        q.iter_mut().zip(step.iter()).for_each(|(q, s)| *q += s);
    }
    q
}

/// Changes the joints of some rows.
pub fn with_joints(
    robot: &Robot,
    set: &TouchSet,
    rows: impl Fn(usize) -> bool,
    change: impl Fn(&[f64]) -> Vec<f64>,
) -> TouchSet {
    let mut out = set.clone();
    for (index, row) in out.rows.iter_mut().enumerate() {
        if rows(index) {
            row.joints = change(&row.joints);
            row.serial_joints = robot.serial_joints(&row.joints);
        }
    }
    out
}

/// Returns what the file shows of itself, without outliers and what follows from too few rows.
fn found(robot: &Robot, set: &TouchSet) -> Vec<Finding> {
    let causes = [
        Cause::Step,
        Cause::Sign,
        Cause::Swap,
        Cause::Unit,
        Cause::Offset,
        Cause::Robot,
        Cause::Rows,
    ];
    let findings = calibrated(robot, set).findings;
    let shown = findings.0.into_iter();
    shown.filter(|f| causes.contains(&f.cause)).collect()
}

fn set(robot: &Robot, task: (&str, usize), count: usize, seed: u64) -> TouchSet {
    let (set, _) = simulated(robot, Scenario::Paper, &[task], count, seed).unwrap();
    set
}

/// A feature that was moved, a tip that slipped and a joint with another zero are named with the first line and the size.
/// A grave step is refused.
#[test]
fn a_step_is_named_with_its_line() {
    let robot = built_in("abb-irb120");
    for (kind, features) in [("socket", 1), ("socket", 2), ("wire", 1), ("ballbar", 4)] {
        let clean = set(&robot, (kind, features), 80, 21);
        assert_eq!(found(&robot, &clean), [], "{kind}");
        let own = 80 / features;
        let (half, end) = (own / 2, own);
        let moved = |q: &[f64]| beside(&robot, q, |_| Vector3::new(0.0, 1e-3, 0.0));
        let slipped =
            |q: &[f64]| beside(&robot, q, |at| at.rotation * Vector3::new(-1e-3, 0.0, 0.0));
        let zero = |q: &[f64]| {
            let mut q = q.to_vec();
            q[2] -= 4e-3;
            q
        };
        let name = format!("\"{}\" was moved by", clean.features[0].name);
        let feature = with_joints(&robot, &clean, |row| (half..end).contains(&row), moved);
        let tip = with_joints(&robot, &clean, |row| row >= 40, slipped);
        let joint = with_joints(&robot, &clean, |row| row >= 42, zero);
        for (set, first, text) in [
            (feature, half, name.as_str()),
            (tip, 40, "slipped at the flange by"),
            (joint, 42, "the zero of joint 3"),
        ] {
            let found = found(&robot, &set);
            let [step] = found.as_slice() else {
                panic!("{kind} {text}: {found:#?}");
            };
            assert_eq!(
                (step.cause, step.tier),
                (Cause::Step, Tier::Refused),
                "{step:#?}"
            );
            assert!(step.text.contains(text), "{kind}: {}", step.text);
            let line = clean.rows[first].line;
            assert!(step.rows[0].abs_diff(line) <= 1, "{kind} {text}: {step:#?}");
        }
    }
}

/// A socket that was moved is named, and not the distances from it, which the touches then contradict: with four sockets, or
/// with two and a long step. It is the first finding.
#[test]
fn a_moved_socket_is_no_wrong_distance() {
    let robot = built_in("abb-irb120");
    for (features, count) in [(2, 40), (4, 80)] {
        for by in [1.5e-3, 6e-3] {
            let clean = set(&robot, ("socket", features), count, 33);
            let own = count / features;
            let moved = |q: &[f64]| beside(&robot, q, |_| Vector3::new(0.6 * by, 0.0, 0.8 * by));
            let set = with_joints(&robot, &clean, |row| (own / 2..own).contains(&row), moved);
            let found = calibrated(&robot, &set);
            let first = &found.findings.0[0];
            assert_eq!(
                (first.cause, first.tier),
                (Cause::Step, Tier::Refused),
                "{features} sockets, {by}: {:#?}",
                found.findings
            );
            let name = format!("\"{}\" was moved by", set.features[0].name);
            assert!(first.text.contains(&name), "{first:#?}");
            assert!(found.contradiction(&set).is_none());
        }
    }
    // Without a step, a wrong distance is one.
    let mut wrong = set(&robot, ("socket", 4), 80, 33);
    wrong.distances[0].distance += 5e-3;
    let found = calibrated(&robot, &wrong);
    assert!(
        found.contradiction(&wrong).is_some(),
        "{:#?}",
        found.findings
    );
}

/// In a file that is sorted by feature, what happened while the features were touched in turn is found, too.
#[test]
fn a_step_is_found_in_a_sorted_file() {
    let robot = built_in("ur10");
    let clean = set(&robot, ("socket", 2), 40, 5);
    let late = |row: usize| row % 20 >= 10;
    let lines = [clean.rows[10].line, clean.rows[30].line];
    let bar = with_joints(&robot, &clean, late, |q| {
        beside(&robot, q, |_| Vector3::new(1e-3, 0.0, 0.0))
    });
    let tip = with_joints(&robot, &clean, late, |q| {
        beside(&robot, q, |at| at.rotation * Vector3::new(1e-3, 0.0, 0.0))
    });
    for (set, text) in [(bar, "all features"), (tip, "slipped at the flange")] {
        let found = found(&robot, &set);
        assert_eq!(found.len(), 1, "{text}: {found:#?}");
        assert_eq!(found[0].rows, lines, "{found:#?}");
        assert!(found[0].text.contains(text), "{found:#?}");
    }
}

/// One wrong row among few is left out; what is then stated is that of the others.
#[test]
fn one_wrong_row_among_few_is_left_out() {
    let robot = built_in("ur10");
    for seed in [1, 3] {
        let mut clean = set(&robot, ("socket", 2), 16, seed);
        clean.rows.sort_by_key(|row| row.line % 8);
        let last = clean.rows.len() - 1;
        let wrong = with_joints(
            &robot,
            &clean,
            |row| row == last,
            |q| beside(&robot, q, |_| Vector3::new(2e-3, 0.0, 0.0)),
        );
        let [clean, wrong] = [&clean, &wrong].map(|set| calibrated(&robot, set));
        assert!(
            clean.summary.outliers.is_empty(),
            "{:#?}",
            clean.summary.outliers
        );
        let lines: Vec<usize> = wrong.summary.outliers.iter().map(|o| o.line).collect();
        assert_eq!(lines.len(), 1, "{:#?}", wrong.findings);
        let stated = |found: &poegp_calibration::model::touches::TouchCalibration| {
            found.summary.after.mean_mm
        };
        assert!(stated(&wrong) < 1.3 * stated(&clean), "seed {seed}");
    }
}

/// A reversed joint, a column in another unit, exchanged columns, a wrong zero, another robot and readings of other rows are named.
#[test]
fn mistakes_of_a_whole_file_are_named() {
    let robot = built_in("abb-irb120");
    let clean = set(&robot, ("wire", 1), 60, 3);
    let changed = |change: fn(&mut Vec<f64>)| {
        with_joints(
            &robot,
            &clean,
            |_| true,
            |q| {
                let mut q = q.to_vec();
                change(&mut q);
                q
            },
        )
    };
    let other = built_in("ur10");
    let of_other = set(&other, ("wire", 1), 60, 3);
    let mut late = clean.clone();
    for (row, before) in late.rows[1..].iter_mut().zip(&clean.rows) {
        row.reading = before.reading;
    }
    let mut transposed = set(&robot, ("camera", 1), 60, 3);
    for row in &mut transposed.rows {
        if let Reading::Board { u, v, .. } = &mut row.reading {
            std::mem::swap(u, v);
        }
    }
    for (set, cause, text) in [
        (
            changed(|q| q[3] = -q[3]),
            Cause::Sign,
            "joint 4 looks reversed",
        ),
        (
            changed(|q| q[5] = q[5].to_radians()),
            Cause::Unit,
            "the column of joint 6 looks like radians where the header says degrees",
        ),
        (
            changed(|q| q[1] = q[1].to_radians()),
            Cause::Unit,
            "the column of joint 2 looks like radians where the header says degrees",
        ),
        (
            changed(|q| q.swap(1, 2)),
            Cause::Swap,
            "joints 2 and 3 look exchanged",
        ),
        (
            changed(|q| q[2] += 0.0873),
            Cause::Offset,
            "the zero of joint 3 looks off by",
        ),
        (of_other, Cause::Robot, "those of ur10"),
        (
            late,
            Cause::Rows,
            "each reading looks like that of the row before it",
        ),
        (
            transposed,
            Cause::Swap,
            "the columns u_px and v_px look exchanged",
        ),
    ] {
        let found = found(&robot, &set);
        assert_eq!(found.len(), 1, "{text}: {found:#?}");
        assert_eq!(
            (found[0].cause, found[0].tier),
            (cause, Tier::Refused),
            "{found:#?}"
        );
        assert!(found[0].text.contains(text), "{found:#?}");
    }
}

/// Returns how many of simulated honest files raise an alarm, and how many there were.
fn alarms(seeds: std::ops::Range<u64>) -> (usize, usize) {
    let (mut raised, mut all) = (0, 0);
    let kinds = [
        ("socket", 2),
        ("wire", 1),
        ("plane", 3),
        ("sphere", 4),
        ("ballbar", 4),
    ];
    for name in ["abb-irb120", "ur10", "kuka-iiwa7"] {
        let robot = built_in(name);
        for scenario in [Scenario::Paper, Scenario::WithBacklash, Scenario::Nonlinear] {
            for (k, kind) in kinds.into_iter().enumerate() {
                for seed in seeds.clone() {
                    let count = [20, 40, 60, 80][(seed as usize + k) % 4];
                    let Some((set, _)) = simulated(&robot, scenario, &[kind], count, 700 + seed)
                    else {
                        continue;
                    };
                    let found = found(&robot, &set);
                    if !found.is_empty() {
                        println!("{name} {kind:?} {count} {seed}: {found:?}");
                    }
                    (raised, all) = (raised + usize::from(!found.is_empty()), all + 1);
                }
            }
        }
    }
    println!("{raised} of {all} honest files raise an alarm");
    (raised, all)
}

#[test]
fn honest_touches_raise_no_alarm() {
    let (raised, all) = alarms(0..2);
    assert!(all > 80);
    assert_eq!(raised, 0);
}

#[test]
#[ignore = "takes minutes"]
fn many_honest_touches_raise_no_alarm() {
    let (raised, all) = alarms(2..22);
    assert!(raised * 200 <= all, "{raised} of {all}");
}

#[test]
fn measured_touches_raise_no_alarm() {
    let Some(folder) = folder("touch") else {
        return;
    };
    let measured = [
        ("panda_2", "franka_panda.urdf"),
        ("panda_3", "franka_panda.urdf"),
        ("panda_3_bis", "franka_panda.urdf"),
        ("kuka_14", "kuka_lbr_iiwa14.urdf"),
    ];
    let own = SIMULATED
        .into_iter()
        .flat_map(|(arm, description, limits)| {
            let of = move |(kind, _): &(&str, f64)| (format!("{arm}_{kind}"), description);
            limits.iter().map(of)
        });
    let all = measured.map(|(name, description)| (name.to_owned(), description));
    for (name, description) in all.into_iter().chain(own) {
        let Some(robot) = robot(description) else {
            continue;
        };
        let set = touches(&folder, &name, &robot);
        assert_eq!(found(&robot, &set), [], "{name}");
    }
}
