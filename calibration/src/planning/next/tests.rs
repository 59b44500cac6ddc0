use nalgebra::Vector3;

use super::*;
use crate::identification::touch::volume::WorkVolume;
use crate::measurement::observation::InstrumentNoise;
use crate::model::touches::USUAL_CLASS;
use crate::numeric::cholesky::Factor;
use crate::planning::candidates::draw;
use crate::planning::constraints::Constraints;
use crate::planning::next::waiting::waiting;
use crate::planning::touches::{Goal, TouchPlanner, TouchTask, to_csv, to_toml};
use crate::robot::LoadOptions;

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// Touches of two sockets and a wire.
fn touches(robot: &Robot) -> TouchSet {
    let constraints = Constraints::none(robot).unwrap();
    let nominal = robot.chain().unwrap();
    let task = TouchTask {
        robot,
        nominal: &nominal,
        constraints: &constraints,
        class: USUAL_CLASS,
        seed: 3,
    };
    let goals = [
        Goal::Socket(Vector3::new(0.6, 0.1, 0.5)),
        Goal::Socket(Vector3::new(0.4, -0.3, 0.5)),
        Goal::Wire(Vector3::new(0.9, -0.6, 0.03)),
    ];
    let plan = TouchPlanner::new(task, &goals, 24).unwrap().plan(24);
    let csv = to_csv(robot, &goals, &plan);
    let toml = to_toml(&goals, &constraints.flange_from_target.translation);
    let (csv, toml) = (csv.as_bytes(), toml.as_bytes());
    TouchSet::parse_plan(
        ("plan.csv".as_ref(), csv),
        ("plan.toml".as_ref(), toml),
        robot,
    )
    .unwrap()
}

/// A tracker's poses.
fn poses(robot: &Robot) -> TouchSet {
    let constraints = Constraints::none(robot).unwrap();
    let nominal = robot.chain().unwrap();
    let target = constraints.flange_from_target;
    let joints = draw(robot, &constraints.chain(&nominal), &constraints, 30, 5).joints;
    let targets = joints.into_iter().map(|q| (1, q, None)).collect();
    TouchSet::of_targets("plan.csv".as_ref(), targets, robot, &nominal, &target)
}

fn chooser<'a>(robot: &Robot, plan: &'a TouchSet) -> Chooser<'a> {
    Chooser::new(robot, &robot.chain().unwrap(), plan, GRAVITY, USUAL_CLASS)
}

/// The variance of the wanted positions after some rows, by one factor of all their equations.
fn variance_at_once(chooser: &Chooser, rows: &[usize]) -> f64 {
    let seen = |i: &usize| {
        let state = &chooser.problem.states[chooser.problem.state_of[*i]];
        chooser.seen(state, Some(&chooser.problem.set.rows[*i]))
    };
    let rows: Vec<Seen> = rows.iter().map(seen).collect();
    let prior = chooser.covariance(&chooser.wanted, &chooser.wanted);
    let prior = chooser.without_gauge(prior);
    let prior = chooser.without_gauge(prior.transpose());
    let mut noisy = chooser.covariance(&rows, &rows);
    for i in 0..noisy.nrows() {
        noisy[(i, i)] += 1.0;
    }
    let cross = chooser.without_gauge(chooser.covariance(&chooser.wanted, &rows));
    let half = Factor::new(noisy, 1)
        .unwrap()
        .half_solve(&cross.transpose());
    prior.trace() - half.norm_squared()
}

/// Row by row what is known is what all rows together say, and every gain is what it takes from the variance.
#[test]
fn one_row_after_the_other_is_all_at_once() {
    let robot = Robot::load("ur10", &LoadOptions::default()).unwrap();
    for plan in [touches(&robot), poses(&robot)] {
        let mut chooser = chooser(&robot, &plan);
        let mut measured = Vec::new();
        for _ in 0..12 {
            let next = chooser.best(|_| true).unwrap();
            let (gains, before) = (chooser.gains(), chooser.variance);
            let row = plan.rows[next.row].clone();
            chooser.measured(&plan, &row);
            measured.push(next.row);
            let after = variance_at_once(&chooser, &measured);
            assert!((chooser.variance - after).abs() < 1e-6 * before, "{after}");
            assert!((before - gains[next.row] - after).abs() < 1e-6 * before);
            assert!((next.share - (after / before).sqrt()).abs() < 1e-3);
            // No other was worth more.
            let others = (0..gains.len()).filter(|i| !measured.contains(i));
            assert!(others.into_iter().all(|i| gains[i] <= gains[next.row]));
        }
        let mut sorted = measured.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert_eq!((sorted.len(), chooser.left()), (12, plan.rows.len() - 12));
    }
}

/// Without the deflections, the variance that is foreseen of touches is that of the arm's class over the work volume, as the
/// simulated arms of the class would have it: the field of the fit times its priors.
#[test]
fn what_is_foreseen_before_any_touch_is_the_class() {
    let robot = Robot::load("ur10", &LoadOptions::default()).unwrap();
    let plan = touches(&robot);
    let chooser = chooser(&robot, &plan);
    let states = WorkVolume::new(&robot, &chooser.problem).states;
    let poses = chooser.nominal_arm.arm.poses(&states);
    let mut sum = 0.0;
    for (column, sd) in chooser.priors.iter().enumerate() {
        let mut arm = chooser.nominal_arm.arm.clone();
        let mut theta = arm.theta.clone();
        theta[column] += 1e-3 * sd;
        arm.update(&theta);
        let moved = arm.poses(&states);
        let shift = |(a, b): (&Pose<f64>, &Pose<f64>)| (b.translation - a.translation) / 1e-3;
        let shift: Vec<f64> = poses
            .iter()
            .zip(&moved)
            .flat_map(|pair| shift(pair).iter().copied().collect::<Vec<_>>())
            .collect();
        let shift = Mat::from_vec(shift.len(), 1, shift);
        let basis = registered(&poses);
        let left = &shift - product(&basis, &product(Transposed(&basis), &shift));
        sum += left.norm_squared();
    }
    let expected = (sum / states.len() as f64).sqrt();
    let foreseen = chooser.foreseen();
    assert!(
        (foreseen / expected - 1.0).abs() < 0.05,
        "{foreseen} {expected}"
    );
}

/// A row elsewhere counts as it is: it uses up the nearest row of its feature, and lowers what it lowers.
#[test]
fn what_was_measured_counts_not_what_was_planned() {
    let robot = Robot::load("ur10", &LoadOptions::default()).unwrap();
    let plan = poses(&robot);
    let mut chooser = chooser(&robot, &plan);
    let mut row = plan.rows[7].clone();
    row.joints[0] += 0.05;
    row.serial_joints = robot.serial_joints(&row.joints);
    let before = chooser.variance;
    chooser.measured(&plan, &row);
    assert!(chooser.taken[7] && chooser.left() == plan.rows.len() - 1);
    assert!(chooser.variance < before);
    // Noise of its own, none of it: the same row again tells little.
    row.declared_noise = InstrumentNoise::UNKNOWN;
    let once = chooser.variance;
    chooser.measured(&plan, &row);
    assert!(once - chooser.variance < 0.5 * (before - once));
    chooser.skip(3);
    assert_eq!(chooser.left(), plan.rows.len() - 3);
}

/// A feature waits for as many joint states as `calibrate` asks for: touches at joints that were there before are not more.
#[test]
fn repeated_joints_are_one_state() {
    let robot = Robot::load("ur10", &LoadOptions::default()).unwrap();
    let mut set = touches(&robot);
    let (socket, rows) = (Some(0), set.rows.clone());
    set.rows.retain(|row| row.reading.feature() == socket);
    set.rows.truncate(3);
    let lacking = |set: &TouchSet| waiting(set).first().copied();
    assert_ne!(lacking(&set).map(|(feature, _)| feature), socket);
    let first = set.rows[0].clone();
    for row in &mut set.rows {
        row.joints.clone_from(&first.joints);
    }
    assert_eq!(lacking(&set), Some((0, 2)));
    set.rows = rows;
    assert_eq!(lacking(&set), None);
}
