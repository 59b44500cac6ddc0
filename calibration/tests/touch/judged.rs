//! Models judged by touches: laws of the table, and what the check finds.

use nalgebra::{DMatrix, DVector, Vector3};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::blob::write::Provenance;
use poegp_calibration::identification::touch::fit::{TouchFit, TouchProblem};
use poegp_calibration::identification::touch::volume::WorkVolume;
use poegp_calibration::measurement::sample::BaseSample;
use poegp_calibration::measurement::touch::{FeatureKind, TouchSet};
use poegp_calibration::model::touches::USUAL_CLASS;
use poegp_calibration::model::touches::summary::tips_mm;
use poegp_calibration::progress::FitContext;
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_calibration::simulation::touches::TouchTask;
use poegp_calibration::simulation::{Scenario, Simulator};
use poegp_calibration::validation::touches::{TouchEvaluation, evaluate_touches, flanges};
use poegp_calibration::verification::CheckError;
use poegp_calibration::verification::hypotheses::Part;
use poegp_calibration::verification::touches::{TouchReport, check_touches};
use poegp_runtime::math::se3::Pose;

use crate::measured::calibrated;
use crate::trial::task;

pub fn robot() -> Robot {
    Robot::load("abb-irb120", &LoadOptions::default()).unwrap()
}

/// Returns touches of a simulator's arm.
pub fn touched(
    robot: &Robot,
    simulator: &mut Simulator,
    kinds: &[(&str, usize)],
    rows: usize,
) -> TouchSet {
    let tasks: Vec<TouchTask> = kinds.iter().map(task).collect();
    let (touches, _) = simulator
        .touch(robot, &tasks, rows, 3, "simulated")
        .unwrap();
    let csv = ("touches.csv".as_ref(), touches.csv.as_bytes());
    let toml = ("touches.toml".as_ref(), touches.toml.as_bytes());
    TouchSet::parse(csv, toml, robot).unwrap()
}

pub fn model(robot: &Robot, set: &TouchSet) -> BlobModel {
    let found = calibrated(robot, set);
    let origin = Provenance::default();
    let context = FitContext::default();
    let blob = found
        .calibration
        .into_blob(robot, &found.samples, &origin, &context);
    blob.unwrap().blob
}

fn evaluated(robot: &Robot, set: &TouchSet, blob: &BlobModel) -> TouchEvaluation {
    let chain = robot.chain().unwrap();
    evaluate_touches(set, &chain, robot.coupling.as_ref(), &[blob]).remove(0)
}

pub fn simulator(robot: &Robot, seed: u64) -> Simulator {
    Simulator::new(robot, Scenario::Paper, &[1.0], seed)
}

/// A model whose poses are the nominal model's gets the same judgement as the nominal model, from every kind of touch.
#[test]
fn a_known_arm_with_the_poses_of_the_nominal_model_is_judged_as_it() {
    let robot = robot();
    let kinds = [
        ("socket", 2),
        ("plane", 1),
        ("sphere", 1),
        ("wire", 2),
        ("level", 1),
        ("camera", 1),
    ];
    let set = touched(&robot, &mut simulator(&robot, 3), &kinds, 16);
    let chain = robot.chain().unwrap();
    let down = Vector3::new(0.0, 0.0, -9.81);
    let problem = TouchProblem::new(&set, &chain, robot.coupling.clone(), down, USUAL_CLASS);
    let states = problem.states.iter();
    let poses: Vec<Pose<f64>> = states.map(|s| chain.forward(&s.serial_joints)).collect();
    let known = TouchFit::on_known(&problem, &poses);
    let drawn = TouchFit::on_nominal_without(&problem, &known.weights);
    let [a, b] = [&known, &drawn].map(|fit| fit.residuals(&problem));
    for (k, (a, b)) in a.iter().zip(&b).enumerate() {
        for i in 0..a.count {
            let sd = drawn.variance(&problem, k, i).sqrt();
            let apart = (a.residual[i] - b.residual[i]).abs() / sd;
            assert!(apart < 0.05, "row {k}: {apart} standard deviations apart");
        }
    }
    // Tips and features are fitted, so none of them stays at its start.
    assert!(
        known.arm.theta.iter().any(|x| x.abs() > 1e-5),
        "{:?}",
        known.arm.theta
    );
}

/// The RMS at sockets and their distance equal those of equations in this test: R t + p = c with the runtime's flange poses.
#[test]
fn the_table_is_that_of_the_runtime() {
    let robot = robot();
    let mut simulator = simulator(&robot, 5);
    let trained = touched(&robot, &mut simulator, &[("socket", 4)], 60);
    let blob = model(&robot, &trained);
    let set = touched(&robot, &mut simulator, &[("socket", 2)], 24);
    let found = evaluated(&robot, &set, &blob);
    let chain = robot.chain().unwrap();
    let down = Vector3::new(0.0, 0.0, -9.81);
    let problem = TouchProblem::new(&set, &chain, None, down, USUAL_CLASS);
    let states = flanges(&blob, &problem.states);
    // Unknowns: the tip, then the centre of each socket.
    let rows = set.rows.len();
    let (mut a, mut b) = (DMatrix::zeros(3 * rows, 9), DVector::zeros(3 * rows));
    for (k, row) in set.rows.iter().enumerate() {
        let pose = &states[problem.state_of[k]].0;
        let socket = row.reading.feature().unwrap();
        for i in 0..3 {
            for j in 0..3 {
                a[(3 * k + i, j)] = pose.rotation[(i, j)];
            }
            a[(3 * k + i, 3 + 3 * socket + i)] = -1.0;
            b[3 * k + i] = -pose.translation[i];
        }
    }
    let normal = a.transpose() * &a + DMatrix::identity(9, 9) * 1e-12;
    let x = normal.cholesky().unwrap().solve(&(a.transpose() * &b));
    let missed = &a * &x - &b;
    for (socket, feature) in found.features.iter().enumerate() {
        let own = (0..rows).filter(|k| set.rows[*k].reading.feature() == Some(socket));
        let squares: Vec<f64> = own
            .flat_map(|k| (0..3).map(move |i| (k, i)))
            .map(|(k, i)| missed[3 * k + i].powi(2))
            .collect();
        let rms = 1e3 * (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert_eq!(
            (feature.rows, feature.rejected, feature.unit),
            (12, 0, "mm")
        );
        assert!(
            (feature.rms[1] / rms - 1.0).abs() < 0.02,
            "{rms}: {feature:?}"
        );
        assert!(feature.rms[1] < 0.5 * feature.rms[0], "{feature:?}");
    }
    let centre =
        |socket: usize| Vector3::new(x[3 + 3 * socket], x[4 + 3 * socket], x[5 + 3 * socket]);
    let apart = 1e3 * (centre(0) - centre(1)).norm();
    let distance = &found.distances[0];
    let [measured, sigma] = distance.measured_mm.unwrap();
    assert!(
        (measured - apart).abs() < 0.2 * sigma,
        "{apart}: {distance:?}"
    );
    let error = distance.error_mm[1];
    assert!(
        (distance.stated_mm + error - measured).abs() < 1e-9,
        "{distance:?}"
    );
    // A distance has 0.05 mm of noise, averaged over twelve touches at each end.
    assert!((0.005..0.06).contains(&sigma), "{sigma}");
    assert!(found.ratio < 0.5, "{}", found.ratio);
    assert_eq!(found.residuals.len(), rows);
}

/// Several models are compared on the rows that no model rejects. If no row is rejected, each is judged as it is alone.
#[test]
fn several_models_are_judged_by_the_same_rows() {
    let robot = robot();
    let mut simulator = simulator(&robot, 6);
    let few = model(
        &robot,
        &touched(&robot, &mut simulator, &[("socket", 2)], 16),
    );
    let many = model(
        &robot,
        &touched(&robot, &mut simulator, &[("socket", 4)], 80),
    );
    let set = touched(&robot, &mut simulator, &[("socket", 2), ("wire", 1)], 24);
    let chain = robot.chain().unwrap();
    let both = evaluate_touches(&set, &chain, None, &[&few, &many]);
    let left_out = |e: &TouchEvaluation| e.features.iter().map(|f| f.rejected).sum::<usize>();
    assert_eq!(left_out(&both[0]), left_out(&both[1]));
    for (together, blob) in both.iter().zip([&few, &many]) {
        let alone = evaluated(&robot, &set, blob);
        if left_out(together) == 0 {
            assert_eq!(*together, alone);
        }
    }
    assert!(
        both[1].ratio < both[0].ratio,
        "{} {}",
        both[1].ratio,
        both[0].ratio
    );
}

pub fn checked(robot: &Robot, set: &TouchSet, blob: &BlobModel) -> TouchReport {
    let chain = robot.chain().unwrap();
    check_touches(blob, set, robot, &chain, 0.01).unwrap()
}

/// Returns the same touches by an arm whose joint zero is off by `by` rad: the controller reports a smaller angle.
pub fn shifted(set: &TouchSet, joint: usize, by: f64) -> TouchSet {
    let mut out = set.clone();
    for row in &mut out.rows {
        row.joints[joint] -= by;
        row.serial_joints[joint] -= by;
    }
    out
}

/// `calibrate` and `evaluate` report the same nominal error of a known distance: the nominal model is not fitted to the
/// distance.
#[test]
fn a_known_distance_as_drawn_is_by_the_touches_alone() {
    let robot = robot();
    let set = touched(&robot, &mut simulator(&robot, 5), &[("socket", 4)], 40);
    let summary = calibrated(&robot, &set).summary;
    let evaluated = evaluated(&robot, &set, &model(&robot, &set));
    for (a, b) in summary.distances.iter().zip(&evaluated.distances) {
        let [a, b] = [a.error_mm[0], b.error_mm[0]];
        assert!((a - b).abs() < 0.01 && b.abs() > 0.1, "{a} and {b} mm");
    }
}

/// A zero that joint 3 lost by 5 mrad is found, with its size. The zeros of the first and the last joint cannot be seen.
#[test]
fn a_lost_zero_is_found() {
    let robot = robot();
    let mut simulator = simulator(&robot, 7);
    let blob = model(
        &robot,
        &touched(&robot, &mut simulator, &[("socket", 4)], 80),
    );
    let set = touched(&robot, &mut simulator, &[("socket", 2)], 20);
    let still = checked(&robot, &set, &blob);
    assert!(still.changes.is_empty(), "{:?}", still.changes);
    assert!(still.miss_mm.mean < 0.25, "{:?}", still.miss_mm);
    assert!(
        still.size_ppm.is_some(),
        "the size is checked, because a distance is known"
    );
    let unseen: Vec<Part> = still
        .sensitivity
        .iter()
        .filter(|s| s.smallest.is_none())
        .map(|s| s.part)
        .collect();
    // A zero of the first joint turns the base, and one of the last joint turns the tip.
    assert_eq!(unseen, [Part::Joint(1), Part::Joint(6)]);
    let moved = checked(&robot, &shifted(&set, 2, 5e-3), &blob);
    let parts: Vec<Part> = moved.changes.iter().map(|c| c.part).collect();
    assert!(parts.contains(&Part::Joint(3)), "{:?}", moved.changes);
    let change = moved
        .changes
        .iter()
        .find(|c| c.part == Part::Joint(3))
        .unwrap();
    let offset = change.offset_deg.unwrap();
    let expected = 5e-3_f64.to_degrees();
    assert!(
        (offset.value - expected).abs() < 2.0 * offset.plus_minus,
        "{offset:?}"
    );
    assert!(offset.plus_minus < 0.5 * expected, "{offset:?}");
    assert!(moved.effect_mm.mean > 0.2, "{:?}", moved.effect_mm);
    assert!(moved.without_mm.mean < moved.miss_mm.mean, "{moved:?}");
    let first = checked(&robot, &shifted(&set, 0, 5e-3), &blob);
    assert!(first.changes.is_empty(), "{:?}", first.changes);
    // Without a known distance the size of the arm cannot be checked.
    let mut unknown = set.clone();
    unknown.distances.clear();
    assert_eq!(checked(&robot, &unknown, &blob).size_ppm, None);
}

/// What a check states that a joint's smallest visible change moves the tip by is the mean distance of the blob's own tips
/// before and after it, once base and tip are fitted to them. A zero of the first joint turns the base, and one of the last
/// joint the tip.
#[test]
fn a_hidden_zero_moves_the_tip_by_as_much_as_is_stated() {
    let robot = robot();
    let mut simulator = simulator(&robot, 7);
    let trained = touched(&robot, &mut simulator, &[("socket", 4)], 80);
    let blob = model(&robot, &trained);
    let set = touched(&robot, &mut simulator, &[("socket", 2)], 20);
    let found = checked(&robot, &set, &blob);
    let chain = robot.chain().unwrap();
    let down = Vector3::new(0.0, 0.0, -9.81);
    let problem = TouchProblem::new(&set, &chain, None, down, USUAL_CLASS);
    let fit = TouchFit::on_known(&problem, &flanges_of(&blob, &problem.states));
    let tip = 1e-3 * Vector3::from(tips_mm(&problem, &fit)[0]);
    let volume = WorkVolume::new(&robot, &problem).states;
    for s in found.sensitivity.iter() {
        let Part::Joint(joint) = s.part else { continue };
        let by = s.smallest.map_or(0.1, f64::to_radians);
        let mut moved = volume.clone();
        for state in &mut moved {
            state.joints[joint - 1] += by;
        }
        let [before, after] = [&volume, &moved].map(|states| flanges_of(&blob, states));
        let mut a = DMatrix::zeros(3 * volume.len(), 9);
        let mut b = DVector::zeros(3 * volume.len());
        for (k, (before, after)) in before.iter().zip(&after).enumerate() {
            let at = before.rotation * tip + before.translation;
            let left = after.rotation * tip + after.translation - at;
            for i in 0..3 {
                b[3 * k + i] = left[i];
                a[(3 * k + i, i)] = 1.0;
                for c in 0..3 {
                    a[(3 * k + i, 3 + c)] = Vector3::ith(c, 1.0).cross(&at)[i];
                    a[(3 * k + i, 6 + c)] = before.rotation[(i, c)];
                }
            }
        }
        let x = a.clone().svd(true, true).solve(&b, 1e-12).unwrap();
        let left = &b - &a * x;
        let length = |k: usize| left.rows(3 * k, 3).norm();
        let mean = 1e3 * (0..volume.len()).map(length).sum::<f64>() / volume.len() as f64;
        let stated = s.moves_mm.unwrap();
        if [1, 6].contains(&joint) {
            assert!(stated < 1e-3, "joint {joint}: {stated} mm");
        } else {
            assert!(
                (stated / mean - 1.0).abs() < 0.02,
                "joint {joint}: {stated} mm, not {mean}"
            );
        }
    }
}

fn flanges_of(blob: &BlobModel, states: &[BaseSample]) -> Vec<Pose<f64>> {
    flanges(blob, states)
        .into_iter()
        .map(|(pose, _)| pose)
        .collect()
}

/// Touches that contain no length say nothing of the arm's size: an arm that has not changed raises no alarm, and a lost zero
/// is found.
#[test]
fn touches_without_a_length_raise_no_alarm() {
    let robot = robot();
    let (mut alarms, mut all) = (0, 0);
    for seed in 0..4 {
        let mut simulator = simulator(&robot, 40 + seed);
        let blob = model(
            &robot,
            &touched(&robot, &mut simulator, &[("socket", 4)], 80),
        );
        for (kinds, rows) in [(("socket", 3), 24), (("sphere", 2), 40), (("plane", 3), 40)] {
            let mut set = touched(&robot, &mut simulator, &[kinds], rows);
            set.distances.clear();
            for feature in &mut set.features {
                if let FeatureKind::Sphere { radius, .. } = &mut feature.kind {
                    *radius = None;
                }
            }
            let found = checked(&robot, &set, &blob);
            assert_eq!(found.size_ppm, None, "{kinds:?}");
            (alarms, all) = (alarms + usize::from(!found.changes.is_empty()), all + 1);
            if kinds.0 == "socket" {
                let moved = checked(&robot, &shifted(&set, 2, 5e-3), &blob);
                let parts: Vec<Part> = moved.changes.iter().map(|c| c.part).collect();
                assert!(parts.contains(&Part::Joint(3)), "{:?}", moved.changes);
                assert!(!parts.contains(&Part::Size), "{:?}", moved.changes);
            }
        }
    }
    assert!(alarms <= 1, "{alarms} of {all}");
}

/// Images alone judge a model: a corner's error is that of its image at the corner's depth. Angles alone do not.
#[test]
fn images_alone_judge_a_model_and_angles_do_not() {
    let robot = robot();
    let mut simulator = simulator(&robot, 7);
    let blob = model(
        &robot,
        &touched(&robot, &mut simulator, &[("camera", 1)], 40),
    );
    let set = touched(&robot, &mut simulator, &[("camera", 1)], 20);
    let found = checked(&robot, &set, &blob);
    assert!(found.changes.is_empty(), "{:?}", found.changes);
    assert!(found.misses.iter().all(|miss| miss.mm.is_some()));
    let evaluated = evaluated(&robot, &set, &blob);
    // A millimetre at a depth of some hundred millimetres is some pixels.
    let per_mm = evaluated.features[0].rms[1] / found.miss_mm.mean;
    assert!((0.5..10.0).contains(&per_mm), "{per_mm} pixels for each mm");
    let moved = checked(&robot, &shifted(&set, 2, 5e-3), &blob);
    let parts: Vec<Part> = moved.changes.iter().map(|c| c.part).collect();
    assert!(parts.contains(&Part::Joint(3)), "{:?}", moved.changes);
    assert!(moved.miss_mm.mean > found.miss_mm.mean);
    let level = touched(&robot, &mut simulator, &[("level", 1)], 20);
    let chain = robot.chain().unwrap();
    let refused = check_touches(&blob, &level, &robot, &chain, 0.01);
    assert!(
        matches!(refused, Err(CheckError::NoPosition)),
        "{refused:?}"
    );
}

/// A mistyped distance is reported as the size, not as a joint that has lost its zero.
#[test]
fn a_wrong_distance_is_named_as_the_size() {
    let robot = robot();
    let mut simulator = simulator(&robot, 7);
    let trained = touched(&robot, &mut simulator, &[("socket", 4)], 80);
    let blob = model(&robot, &trained);
    let mut set = touched(&robot, &mut simulator, &[("socket", 2)], 20);
    set.distances[0].distance *= 1.02;
    let found = checked(&robot, &set, &blob);
    let parts: Vec<Part> = found.changes.iter().map(|c| c.part).collect();
    assert_eq!(parts, [Part::Size], "{:?}", found.changes);
    let size = found.changes[0].size_ppm.unwrap();
    assert!(
        (size.value - 20_000.0).abs() < 2.0 * size.plus_minus,
        "{size:?}"
    );
}
