//! Simulates a loaded arm measured by a laser tracker, as in section IV-A of the paper.
//!
//! The simulated arm has imperfect frames, joints that deflect under gravity (links and payload), arbitrary base and tool
//! frames, and a tracker with 30 µm and 50 µrad of noise per axis. The error sizes reproduce the paper's Table I (base-tool
//! 1.9 mm, POE 0.84 mm) on an IRB 4400; other robots get the same sizes. [`Scenario`]s add effects for which no model of the
//! trainer has a formula. The *true* arm uses the runtime's kinematics; it shares nothing else with the fitted models.

pub mod touches;
mod true_arm;

use std::fmt::Write as _;

use poegp_runtime::math::se3::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::measurement::noise::NoiseScales;
use crate::numeric::rotation::turn;
use crate::robot::{Robot, in_file_units};
use crate::simulation::true_arm::normal_vector;
pub use crate::simulation::true_arm::{Disturbance, Scenario, TrueArm};

/// Standard deviation of one position component of the tracker, in m.
pub const POSITION_NOISE_M: f64 = NoiseScales::TRACKER.position;
/// Standard deviation of one rotation component of the tracker, in rad.
pub const ORIENTATION_NOISE_RAD: f64 = NoiseScales::TRACKER.orientation;

/// Joint ranges in degrees of a robot cell in which the target stays visible: of the first six joints, and of any further
/// joint.
const JOINT_RANGES_DEG: [(f64, f64); 7] = [
    (-60.0, 60.0),
    (-40.0, 60.0),
    (-40.0, 45.0),
    (-60.0, 60.0),
    (-75.0, 75.0),
    (-90.0, 90.0),
    (-90.0, 90.0),
];
/// Half the range of a joint without limits in [`Scenario::PaperFullRange`], in rad.
const UNLIMITED_RAD: f64 = std::f64::consts::PI;

/// One simulated measurement.
#[derive(Clone, Debug)]
pub struct SimulatedPose {
    /// The controller's joint values, in rad or m.
    pub joints: Vec<f64>,
    /// Payload as the operator knows it, in kg.
    pub payload_kg: f64,
    /// `instrument_from_target` as measured.
    pub measured: Pose<f64>,
    /// Noiseless `instrument_from_target`.
    pub truth: Pose<f64>,
}

/// A simulated arm in its robot cell.
#[derive(Clone, Debug)]
pub struct Simulator {
    arm: TrueArm,
    ranges: Vec<(f64, f64)>,
    payloads: Vec<f64>,
    random: ChaCha8Rng,
}

impl Simulator {
    /// Creates an arm like `robot` with errors drawn from `seed`, loaded with `payloads` (kg) at random.
    pub fn new(robot: &Robot, scenario: Scenario, payloads: &[f64], seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let arm = TrueArm::draw(robot, scenario, payloads, &mut random);
        let range = |(i, joint): (usize, &crate::robot::Joint)| {
            let limits = joint.limits.unwrap_or((-UNLIMITED_RAD, UNLIMITED_RAD));
            if joint.kind == poegp_protocol::JointKind::Prismatic {
                return limits;
            }
            if scenario == Scenario::PaperFullRange {
                return (limits.0.max(-UNLIMITED_RAD), limits.1.min(UNLIMITED_RAD));
            }
            let (lower, upper) = JOINT_RANGES_DEG[i.min(JOINT_RANGES_DEG.len() - 1)];
            (
                limits.0.max(lower.to_radians()),
                limits.1.min(upper.to_radians()),
            )
        };
        let ranges = robot.joints.iter().enumerate().map(range).collect();
        Self {
            arm,
            ranges,
            payloads: payloads.to_vec(),
            random,
        }
    }

    /// Applies a permanent disturbance to the arm.
    pub fn disturb(&mut self, disturbance: Disturbance) {
        self.arm.disturb(disturbance);
    }

    /// Returns the ranges from which joints are drawn, in rad or m.
    pub fn ranges(&self) -> &[(f64, f64)] {
        &self.ranges
    }

    /// Measures `count` random poses.
    pub fn measure(&mut self, count: usize) -> Vec<SimulatedPose> {
        (0..count).map(|_| self.measure_one()).collect()
    }

    /// Returns `instrument_from_target` of the arm at the controller's joints (rad or m), without the tracker's noise.
    pub fn stands_at(&mut self, joints: &[f64], payload_kg: f64) -> Pose<f64> {
        self.arm
            .instrument_from_target(joints, payload_kg, &mut self.random)
    }

    fn measure_one(&mut self) -> SimulatedPose {
        let random = &mut self.random;
        let joints: Vec<f64> = self
            .ranges
            .iter()
            .map(|(lower, upper)| lower + (upper - lower) * random.random::<f64>())
            .collect();
        let payload_kg = if self.payloads.is_empty() {
            0.0
        } else {
            self.payloads[random.random_range(0..self.payloads.len())]
        };
        self.measure_at(&joints, payload_kg)
    }

    /// Measures at the controller's joints (rad or m) with one of the payloads or any other.
    pub fn measure_at(&mut self, joints: &[f64], payload_kg: f64) -> SimulatedPose {
        let random = &mut self.random;
        let truth = self.arm.instrument_from_target(joints, payload_kg, random);
        let turn = turn(normal_vector(ORIENTATION_NOISE_RAD, random));
        let mut measured = truth;
        measured.rotation = turn.rotation * truth.rotation;
        measured.translation += normal_vector(POSITION_NOISE_M, random);
        SimulatedPose {
            joints: joints.to_vec(),
            payload_kg,
            measured,
            truth,
        }
    }
}

/// Writes a measurement file of `poses`; with the truth in `true_*` columns if `with_truth`.
pub fn to_csv(robot: &Robot, poses: &[SimulatedPose], with_truth: bool, comment: &str) -> String {
    let mut out = format!("# {comment}\npayload_kg");
    out += &format!(",{}", robot.file_columns().join(","));
    out += ",x_mm,y_mm,z_mm,qw,qx,qy,qz";
    if with_truth {
        out += ",true_x_mm,true_y_mm,true_z_mm,true_qw,true_qx,true_qy,true_qz";
    }
    out.push('\n');
    for pose in poses {
        let _ = write!(out, "{}", pose.payload_kg);
        for (joint, q) in robot.joints.iter().zip(&pose.joints) {
            let _ = write!(out, ",{:.10}", in_file_units(joint.kind, *q));
        }
        write_pose(&mut out, &pose.measured);
        if with_truth {
            write_pose(&mut out, &pose.truth);
        }
        out.push('\n');
    }
    out
}

fn write_pose(out: &mut String, pose: &Pose<f64>) {
    for t in pose.translation.iter() {
        let _ = write!(out, ",{:.6}", 1e3 * t);
    }
    let (w, v) = pose.quaternion();
    let _ = write!(out, ",{w:.12},{:.12},{:.12},{:.12}", v[0], v[1], v[2]);
}
