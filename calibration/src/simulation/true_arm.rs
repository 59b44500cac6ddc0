//! The true arm of a simulation: frames with errors, and joints and links that deflect.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::numeric::rotation::turn;
use crate::robot::{Robot, coupled};

/// Standard deviation of the error of each fixed frame, in m and rad per component.
const FRAME_ERROR: f64 = 0.78e-3;
/// Joint compliance in rad/(N m), before the spread of ±25 %.
const COMPLIANCE: [f64; 6] = [6.7e-6, 12.5e-6, 14.3e-6, 12.5e-6, 16.7e-6, 20e-6];
/// Share of the links' gravity that acts on the joints; the controller compensates the rest.
const LINK_GRAVITY_SHARE: f64 = 0.06;
/// Masses of the links after the column (upper arm, elbow, forearm, wrist), in kg.
const LINK_MASSES: [f64; 5] = [31.0, 20.0, 17.0, 1.2, 0.42];
/// Centre of mass of the payload relative to the flange, in m, and its spread.
const PAYLOAD_CENTRE: [f64; 3] = [0.020, -0.010, 0.120];
const PAYLOAD_CENTRE_SPREAD: f64 = 0.010;
const GRAVITY: f64 = 9.81;

/// Error sources of the simulated arm beyond its frames and compliance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scenario {
    /// No further errors; joints within the ranges of the robot cell.
    Paper,
    /// Link bending, transmission error, backlash, repeatability.
    WithBacklash,
    /// As `WithBacklash`, with gears that stiffen under load, a centre of mass for each payload, and wrong payload masses.
    Nonlinear,
    /// As `Paper`, over the full joint limits.
    PaperFullRange,
}

/// A change of the arm after its calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disturbance {
    /// The base moves, in m along its axes.
    Base(Vector3<f64>),
    /// The target moves on the flange, in m along its own axes.
    Tool(Vector3<f64>),
    /// A joint of the controller (from 0) is offset from the value that it shows.
    Joint {
        /// Index of the joint, from 0.
        joint: usize,
        /// Offset, in rad or m.
        offset: f64,
    },
}

/// The true arm, with all its errors.
#[derive(Clone, Debug)]
pub struct TrueArm {
    coupling: Option<Vec<Vec<f64>>>,
    /// Chain from base to flange.
    chain: Poe<f64>,
    instrument_from_base: Pose<f64>,
    flange_from_target: Pose<f64>,
    joints: Vec<TrueJoint>,
    link_masses: Vec<f64>,
    payload_centre: Vector3<f64>,
    payloads: Vec<TruePayload>,
    scenario: Scenario,
    /// Disturbances so far.
    happened: Vec<Disturbance>,
}

#[derive(Clone, Debug)]
struct TrueJoint {
    /// Compliance, in rad/(N m).
    compliance: f64,
    /// Phases of the transmission error.
    phases: [f64; 3],
}

#[derive(Clone, Debug)]
struct TruePayload {
    nominal_kg: f64,
    true_kg: f64,
    centre: Vector3<f64>,
}

impl TrueArm {
    /// Draws an arm like `robot` with random errors.
    pub fn draw(
        robot: &Robot,
        scenario: Scenario,
        payloads: &[f64],
        random: &mut ChaCha8Rng,
    ) -> Self {
        let scale = if scenario == Scenario::Nonlinear {
            1.1
        } else {
            0.9
        };
        let kinds = robot.kinds();
        let mut chain =
            Poe::new(&kinds, &robot.parent_from_joint).expect("a loaded robot is a chain");
        for frame in chain.frames_mut() {
            let error = Twist {
                linear: normal_vector(FRAME_ERROR, random),
                angular: normal_vector(FRAME_ERROR, random),
            };
            *frame = *frame * Pose::exp(&error);
        }
        let joints = (0..kinds.len())
            .map(|i| TrueJoint {
                compliance: scale
                    * COMPLIANCE[i.min(COMPLIANCE.len() - 1)]
                    * (1.0 + 0.25 * (2.0 * random.random::<f64>() - 1.0)),
                phases: std::array::from_fn(|_| std::f64::consts::TAU * random.random::<f64>()),
            })
            .collect();
        let payload_centre =
            Vector3::from(PAYLOAD_CENTRE) + normal_vector(PAYLOAD_CENTRE_SPREAD, random);
        let payloads = payloads
            .iter()
            .map(|kg| {
                let wild = scenario == Scenario::Nonlinear;
                let error: f64 = StandardNormal.sample(random);
                let offset = normal_vector(0.03, random);
                TruePayload {
                    nominal_kg: *kg,
                    true_kg: if wild { kg * (1.0 + 0.02 * error) } else { *kg },
                    centre: payload_centre + if wild { offset } else { Vector3::zeros() },
                }
            })
            .collect();
        // The column turns about the vertical, so its mass deflects nothing.
        let mut masses = vec![0.0];
        masses.extend(LINK_MASSES);
        masses.resize(kinds.len(), 0.42);
        Self {
            coupling: robot.coupling.clone(),
            chain,
            instrument_from_base: arbitrary_pose(2.5, random),
            flange_from_target: arbitrary_pose(0.12, random),
            joints,
            link_masses: masses,
            payload_centre,
            payloads,
            scenario,
            happened: Vec::new(),
        }
    }

    /// Applies a permanent disturbance to the arm.
    pub fn disturb(&mut self, disturbance: Disturbance) {
        let shift = |translation: Vector3<f64>| Pose {
            translation,
            ..Pose::identity()
        };
        match disturbance {
            Disturbance::Base(d) => {
                self.instrument_from_base = self.instrument_from_base * shift(d)
            }
            Disturbance::Tool(d) => self.flange_from_target = self.flange_from_target * shift(d),
            Disturbance::Joint { .. } => {}
        }
        self.happened.push(disturbance);
    }

    /// Returns the pose of the target for the controller's joints and the payload as the operator knows it.
    pub fn instrument_from_target(
        &self,
        joints: &[f64],
        payload_kg: f64,
        random: &mut ChaCha8Rng,
    ) -> Pose<f64> {
        let base_from_flange = self.base_from_flange(joints, payload_kg, random);
        self.instrument_from_base * base_from_flange * self.flange_from_target
    }

    /// Returns the pose of the flange in the base frame.
    pub fn base_from_flange(
        &self,
        joints: &[f64],
        payload_kg: f64,
        random: &mut ChaCha8Rng,
    ) -> Pose<f64> {
        let mut joints = joints.to_vec();
        for disturbance in &self.happened {
            if let Disturbance::Joint { joint, offset } = disturbance {
                joints[*joint] += offset;
            }
        }
        let joints = joints.as_slice();
        let mut serial = coupled(self.coupling.as_deref(), joints);
        let (mass, centre) = self
            .payloads
            .iter()
            .find(|p| p.nominal_kg == payload_kg)
            .map_or((payload_kg, self.payload_centre), |p| (p.true_kg, p.centre));
        if self.scenario == Scenario::WithBacklash || self.scenario == Scenario::Nonlinear {
            self.add_transmission_errors(joints, &mut serial, random);
        }
        // Two passes, because the torque changes the angles, which change the torque.
        let mut deflected = serial.clone();
        let mut bending = vec![Vector3::zeros(); serial.len()];
        for _ in 0..2 {
            let torques = self.torques(&deflected, mass, &centre);
            for (i, joint) in self.joints.iter().enumerate() {
                let torque = torques[i];
                let mut compliance = joint.compliance;
                if self.scenario == Scenario::Nonlinear {
                    compliance /= 1.0 + torque.z.abs() / 150.0;
                }
                deflected[i] = serial[i];
                if self.chain.kinds()[i] == JointKind::Revolute {
                    deflected[i] += compliance * torque.z + self.backlash(torque.z);
                }
                if i < 3 {
                    bending[i] = joint.compliance
                        * self.bending_share()
                        * Vector3::new(torque.x, torque.y, 0.0);
                }
            }
        }
        let mut chain = self.chain;
        for (frame, angular) in chain.frames_mut().iter_mut().zip(bending) {
            *frame = *frame * turn(angular);
        }
        chain.forward(&deflected)
    }

    /// Returns the gravity torque (N m) about the origin of each joint's frame, in the frame's axes before the joint moves.
    fn torques(
        &self,
        serial: &[f64],
        payload_kg: f64,
        payload_centre: &Vector3<f64>,
    ) -> Vec<Vector3<f64>> {
        let (frames, flange) = self.chain.joint_frames(serial);
        let origins: Vec<Vector3<f64>> = frames[..serial.len()]
            .iter()
            .map(|f| f.translation)
            .chain([flange.translation])
            .collect();
        let down = Vector3::new(0.0, 0.0, -GRAVITY);
        let payload = flange.transform_point(payload_centre);
        (0..serial.len())
            .map(|i| {
                let mut torque = (payload - origins[i]).cross(&(payload_kg * down));
                for link in i..serial.len() {
                    let centre = 0.5 * (origins[link] + origins[link + 1]);
                    torque += LINK_GRAVITY_SHARE
                        * (centre - origins[i]).cross(&(self.link_masses[link] * down));
                }
                frames[i].rotation.transpose() * torque
            })
            .collect()
    }

    fn bending_share(&self) -> f64 {
        match self.scenario {
            Scenario::Paper | Scenario::PaperFullRange => 0.0,
            Scenario::WithBacklash => 0.15,
            Scenario::Nonlinear => 0.25,
        }
    }

    fn backlash(&self, torque: f64) -> f64 {
        match self.scenario {
            Scenario::Paper | Scenario::PaperFullRange => 0.0,
            Scenario::WithBacklash | Scenario::Nonlinear => 15e-6 * torque.signum(),
        }
    }

    fn add_transmission_errors(&self, joints: &[f64], serial: &mut [f64], random: &mut ChaCha8Rng) {
        for (i, joint) in self.joints.iter().enumerate() {
            let [a, b, c] = joint.phases;
            let repeat: f64 = StandardNormal.sample(random);
            let q = joints[i];
            serial[i] += 60e-6 * libm::sin(q + a)
                + 30e-6 * libm::sin(2.0 * q + b)
                + 8e-6 * libm::sin(60.0 * q + c)
                + 5e-6 * repeat;
        }
        if self.scenario == Scenario::Nonlinear && serial.len() > 2 {
            serial[2] += 100e-6 * libm::sin(joints[2] - joints[1] + self.joints[2].phases[0]);
        }
    }
}

/// Draws a pose with any orientation at `distance` metres.
fn arbitrary_pose(distance: f64, random: &mut ChaCha8Rng) -> Pose<f64> {
    let mut normal = || -> f64 { StandardNormal.sample(random) };
    let quaternion = (normal(), Vector3::new(normal(), normal(), normal()));
    let direction = Vector3::new(normal(), normal(), normal());
    Pose::from_quaternion(
        quaternion.0,
        &quaternion.1,
        direction.normalize() * distance,
    )
}

/// Draws three independent normal numbers with the standard deviation `sigma`.
pub(super) fn normal_vector(sigma: f64, random: &mut ChaCha8Rng) -> Vector3<f64> {
    let mut normal = || -> f64 { StandardNormal.sample(random) };
    Vector3::new(sigma * normal(), sigma * normal(), sigma * normal())
}
