//! Laws of planned touches.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};

use super::{Goal, TouchPlanner, TouchTask, USUAL_CLASS, to_csv, to_toml};
use crate::measurement::touch::TouchSet;
use crate::planning::constraints::Constraints;
use crate::robot::{LoadOptions, Robot};

struct Arm {
    robot: Robot,
    nominal: Poe<f64>,
    constraints: Constraints,
}

impl Arm {
    fn new() -> Self {
        let robot = Robot::load("ur10", &LoadOptions::default()).unwrap();
        Self {
            nominal: robot.chain().unwrap(),
            constraints: Constraints::none(&robot).unwrap(),
            robot,
        }
    }

    fn task(&self, seed: u64) -> TouchTask<'_> {
        TouchTask {
            robot: &self.robot,
            nominal: &self.nominal,
            constraints: &self.constraints,
            class: USUAL_CLASS,
            seed,
        }
    }
}

fn goals() -> Vec<Goal> {
    vec![
        Goal::Socket(Vector3::new(0.6, 0.1, 0.5)),
        Goal::Socket(Vector3::new(0.4, -0.3, 0.5)),
        Goal::Plate(Vector3::new(0.6, 0.0, 0.4), Vector3::z()),
        Goal::Wire(Vector3::new(1.2, -0.8, 0.1)),
    ]
}

/// What is proposed is worth more than random rows of the same features, for every kind and any seed; where it touches, the
/// tip is.
#[test]
fn planned_touches_are_worth_more_than_random_ones() {
    let arm = Arm::new();
    let chain = arm.constraints.chain(&arm.nominal);
    for (seed, goals) in (1..).zip(goals().chunks(1).chain([goals().as_slice()])) {
        let count = 6 * goals.len();
        let planner = TouchPlanner::new(arm.task(seed), goals, count).unwrap();
        let plan = planner.plan(count);
        println!(
            "{} goals, first a {}: nominal {:.3} mm, {count} planned {:.3} mm, random {:.3} mm",
            goals.len(),
            goals[0].word(),
            1e3 * plan.before,
            1e3 * plan.expected,
            1e3 * plan.random
        );
        assert_eq!(plan.touches.len(), count);
        assert!(
            plan.expected < 0.9 * plan.random && plan.random < plan.before,
            "{goals:?}"
        );
        for touch in &plan.touches {
            let serial = arm.robot.serial_joints(&touch.joints);
            assert!(arm.constraints.forbidden_by(&chain, &serial).is_empty());
            let at = chain.forward(&serial).translation;
            let miss = match goals[touch.goal] {
                Goal::Socket(point) => (at - point).norm(),
                Goal::Plate(point, normal) => normal.dot(&(at - point)).abs(),
                Goal::Wire(_) => 0.0,
            };
            assert!(miss < 0.1e-3, "{miss} m from {:?}", goals[touch.goal]);
        }
    }
}

/// The derivatives of the tip are those of the chain with a frame moved by a little.
#[test]
fn unknowns_move_the_tip_as_the_chain_says() {
    let arm = Arm::new();
    let goals = [Goal::Wire(Vector3::new(1.2, -0.8, 0.1))];
    let planner = TouchPlanner::new(arm.task(1), &goals, 4).unwrap();
    let q = [0.4, -1.1, 1.3, -0.7, 0.9, 0.2];
    let columns = planner.positions(&q);
    let tip_at = |joint: usize, component: usize, by: f64| {
        let mut twist = [0.0; 6];
        twist[component] = by;
        let mut chain = arm.nominal;
        let frame = chain.frames()[joint];
        chain.frames_mut()[joint] = Pose::exp(&Twist::from_array(&twist)) * frame;
        let tip = arm.constraints.flange_from_target.translation;
        chain.forward(&q).transform_point(&tip)
    };
    let class = USUAL_CLASS;
    let [length, tilt, zero] = [class.length, class.tilt, class.joint_zero];
    for joint in 1..=6 {
        for (component, sigma) in [length, length, length, tilt, tilt, zero]
            .into_iter()
            .enumerate()
        {
            let known = if component == 5 {
                joint == 1
            } else {
                joint == 6
            };
            let step = 1e-6;
            let moved = (tip_at(joint, component, step) - tip_at(joint, component, -step))
                / (2.0 * step)
                * if known { 0.0 } else { sigma };
            for axis in 0..3 {
                let column = columns[axis][6 * (joint - 1) + component];
                assert!(
                    (column - moved[axis]).abs() < 1e-9,
                    "joint {joint}, {component}"
                );
            }
        }
    }
}

/// Both files of a plan are read as they are, but for the readings of a wire.
#[test]
fn the_files_of_a_plan_are_read_again() {
    let arm = Arm::new();
    let goals = &goals()[..3];
    let planner = TouchPlanner::new(arm.task(4), goals, 15).unwrap();
    let plan = planner.plan(15);
    let csv = to_csv(&arm.robot, goals, &plan);
    let tip = arm.constraints.flange_from_target.translation;
    let toml = to_toml(goals, &tip);
    let touches = (std::path::Path::new("plan.csv"), csv.as_bytes());
    let features = (std::path::Path::new("plan.toml"), toml.as_bytes());
    let set = TouchSet::parse(touches, features, &arm.robot).unwrap();
    assert_eq!((set.rows.len(), set.features.len()), (15, 3));
    assert_eq!(set.tips[0].position, tip);
}

/// A socket out of reach is no plan.
#[test]
fn a_goal_out_of_reach_is_refused() {
    let arm = Arm::new();
    let goals = [Goal::Plate(Vector3::new(0.6, 0.0, -0.4), Vector3::z())];
    let refused = TouchPlanner::new(arm.task(1), &goals, 8).err().unwrap();
    assert_eq!((refused.goal, refused.allowed, refused.needed), (0, 0, 8));
}
