//! The arm as it is fitted to touches: the parametric model of the elastic method, with parameters of its own.
//!
//! ```text
//! θ = [ 6 an arm frame | 3 or 6 a tip | 3 for each (joint, link) | 4 payload terms a joint | 2 an order of a joint ]
//! T(q) = P_0 Z_1 · P_1 exp(δ_1) · Z_2 · … · P_n exp(δ_tip),   δ = (v, ω) in the axes of the frame behind it
//! ```
//!
//! The last angle of δ_i is thus the zero of joint i + 1. A zero is farther from nominal than the direction of an
//! axis, so it has a prior of its own. No touch can see the base frame, nor with it the zero of the first joint: both
//! stay nominal. Poses, gravity and own-joint errors are those of [`ParametricModel`], and hence of the runtime.

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};
use serde::{Deserialize, Serialize};

use crate::identification::parametric::gear_line::GearLine;
use crate::identification::parametric::state::{Layout, ParametricModel, ROWS};
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::BaseSample;
use crate::numeric::matrix::Mat;
use crate::robot::own_motion;

/// A group of parameters that share a prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Group {
    /// Offsets of links, in m.
    Length,
    /// Directions of axes, in rad.
    Tilt,
    /// Zeros of joints, in rad, or in m for a slide.
    Zero,
    /// Position of a tip at the flange, in m.
    Tip,
    /// Rotation of a target at the flange, in rad.
    Turn,
    /// Gravity coefficients of the links, in rad/(m/s²).
    Links,
    /// Gravity coefficients of the payload, in rad/(m/s²)/kg and similar units.
    Payload,
    /// Own-joint errors that repeat once and twice in a turn of the joint, in rad.
    Curve,
    /// Relative change of all link offsets in proportion.
    Size,
}

impl Group {
    /// Groups whose prior the evidence may change.
    pub const LEARNT: [Self; 6] = [
        Self::Length,
        Self::Tilt,
        Self::Zero,
        Self::Links,
        Self::Payload,
        Self::Curve,
    ];

    /// Returns whether the group's prior is that of the arm's class.
    pub fn is_of_class(self) -> bool {
        matches!(self, Self::Length | Self::Tilt | Self::Zero)
    }
}

/// One parameter of the arm.
#[derive(Clone, Debug)]
pub struct Column {
    /// Group whose prior the parameter has.
    pub group: Group,
    /// Index of the frame or tip that the parameter belongs to; for a gravity or curve term, index of the joint.
    pub index: usize,
    /// One unit of the parameter expressed in the parameters of [`ParametricModel`]: pairs of index and factor.
    to: Vec<(usize, f64)>,
}

/// Terms that are fitted besides the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Terms {
    /// Whether gravity terms of the links are fitted.
    pub gravity: bool,
    /// Whether gravity terms of a varying payload are fitted.
    pub payload: bool,
    /// Number of orders of the own-joint errors.
    pub orders: usize,
    /// Whether a common scale of all links is fitted.
    pub size: bool,
}

/// A tip before the fit.
#[derive(Clone, Copy, Debug)]
pub struct TipStart {
    /// Initial flange_from_tip.
    pub pose: Pose<f64>,
    /// Whether its position is fitted.
    pub is_free: bool,
    /// Whether its rotation is fitted.
    pub turns: bool,
}

/// The arm with the current values of its parameters.
#[derive(Clone, Debug)]
pub struct TouchArm {
    /// Parametric model that gives poses and derivatives.
    pub model: ParametricModel,
    /// The parameters.
    pub columns: Vec<Column>,
    /// Parameter values θ.
    pub theta: Vec<f64>,
    /// For a known arm, base_from_joint of the last joint in every state of the problem.
    known: Option<Vec<Pose<f64>>>,
}

/// Pose of the tip in one state of the arm, with its derivatives by θ.
#[derive(Clone, Debug)]
pub struct StateJet {
    /// base_from_tip.
    pub pose: Pose<f64>,
    /// Jacobian with six rows: displacement (m) and rotation (rad) of the tip in the axes of the base, one column for
    /// each parameter.
    pub jacobian: Mat<f64>,
}

/// Returns the parameter that moves a frame along or about its axis `i`, with the frame's group and index; `first` is that
/// of the frame's twist in the parametric model.
fn twist((group, index): (Group, usize), frame: &Pose<f64>, first: usize, i: usize) -> Column {
    let adjoint = frame.adjoint();
    let to = (0..6).map(|row| (first + row, adjoint[row][i]));
    Column {
        group,
        index,
        to: to.filter(|(_, value)| *value != 0.0).collect(),
    }
}

/// Returns the parameters of the frames between the joints.
fn frame_columns(nominal: &Poe<f64>) -> Vec<Column> {
    let mut columns = Vec::new();
    for frame in 1..nominal.kinds().len() {
        // Component along or about which the joint behind the frame moves.
        let zero = own_motion(nominal.kinds()[frame]);
        for i in 0..6 {
            let group = match i {
                _ if i == zero => Group::Zero,
                0..3 => Group::Length,
                _ => Group::Tilt,
            };
            columns.push(twist(
                (group, frame),
                &nominal.frames()[frame],
                6 * frame,
                i,
            ));
        }
    }
    columns
}

/// Returns the parameters of tip `t` that are fitted; `tool` leads from the last joint to it.
fn tip_columns(t: usize, tip: &TipStart, tool: &Pose<f64>, first: usize) -> Vec<Column> {
    let is_fitted = |i: &usize| *i < 3 && tip.is_free || *i >= 3 && tip.turns;
    let group = |i: usize| if i < 3 { Group::Tip } else { Group::Turn };
    let fitted = (0..6).filter(is_fitted);
    fitted
        .map(|i| twist((group(i), t), tool, first, i))
        .collect()
}

/// Returns the gravity parameters of the links; `first` is the first of the parametric model. One parameter stands for the
/// mass at the far end of each link that a joint carries.
fn link_columns(nominal: &Poe<f64>, first: usize) -> Vec<Column> {
    let n = nominal.kinds().len();
    let at = |joint: usize, link: usize| {
        let before: usize = (0..joint).map(|c| n - c).sum();
        first + 3 * (before + link - joint)
    };
    let mut columns = Vec::new();
    for joint in 0..n {
        for end in joint..n {
            let mut to = Vec::new();
            for link in joint..=end {
                let frame = nominal.frames()[link + 1];
                let lever = frame.rotation.transpose() * frame.translation;
                let weight = match nominal.kinds()[joint] {
                    JointKind::Revolute => lever,
                    JointKind::Prismatic => Vector3::x(),
                };
                to.extend((0..3).map(|i| (at(joint, link) + i, weight[i])));
            }
            columns.push(Column {
                group: Group::Links,
                index: joint,
                to,
            });
        }
    }
    columns
}

/// Returns the common scale of all links.
fn size_column(nominal: &Poe<f64>) -> Column {
    let mut to = Vec::new();
    for frame in 1..nominal.kinds().len() {
        let nominal = &nominal.frames()[frame];
        let (adjoint, lever) = (
            nominal.adjoint(),
            nominal.rotation.transpose() * nominal.translation,
        );
        let along = |row: usize| (0..3).map(|i| adjoint[row][i] * lever[i]).sum::<f64>();
        to.extend((0..6).map(|row| (6 * frame + row, along(row))));
    }
    Column {
        group: Group::Size,
        index: 0,
        to,
    }
}

impl TouchArm {
    /// Creates the nominal arm. `nominal` leads from the base to the flange.
    pub fn new(
        nominal: &Poe<f64>,
        tips: &[TipStart],
        coupling: Option<Vec<Vec<f64>>>,
        gravity: Vector3<f64>,
        terms: Terms,
    ) -> Self {
        let n = nominal.kinds().len();
        let flange = nominal.frames()[n];
        let ripple = (0..n)
            .filter(|joint| nominal.kinds()[*joint] == JointKind::Revolute)
            .flat_map(|joint| (1..=terms.orders).map(move |k| GearLine::found(joint, k as f64)));
        let layout = Layout {
            joints: n,
            tools: tips.len(),
            gravity: terms.gravity,
            payload: terms.gravity && terms.payload,
            ripple: ripple.collect(),
        };
        let tools: Vec<Pose<f64>> = tips.iter().map(|tip| flange * tip.pose).collect();
        let mut columns = frame_columns(nominal);
        for (t, (tip, tool)) in tips.iter().zip(&tools).enumerate() {
            columns.extend(tip_columns(t, tip, tool, 6 * (n + t)));
        }
        let mut next = 6 * (n + tips.len());
        if layout.gravity {
            columns.extend(link_columns(nominal, next));
            next += 3 * n * (n + 1) / 2;
        }
        let payloads = (0..n).filter(|_| layout.payload);
        let payloads = payloads.flat_map(|joint| [(Group::Payload, joint); 4]);
        let curves = layout.ripple.iter();
        let curves = curves.flat_map(|line| [(Group::Curve, line.joint); 2]);
        for (to, (group, index)) in (next..).zip(payloads.chain(curves)) {
            columns.push(Column {
                group,
                index,
                to: vec![(to, 1.0)],
            });
        }
        columns.extend(terms.size.then(|| size_column(nominal)));
        let mut chain = *nominal;
        if let (Some(last), Some(tool)) = (chain.frames_mut().last_mut(), tools.first()) {
            *last = *tool;
        }
        Self {
            theta: vec![0.0; columns.len()],
            model: ParametricModel::new(&chain, tools, coupling, layout, gravity),
            columns,
            known: None,
        }
    }

    /// Creates a known arm, of which only the tips are fitted. `flanges` are base_from_flange in the states of the
    /// problem, in order. `nominal` leads from the base to the flange.
    pub fn known(nominal: &Poe<f64>, tips: &[TipStart], flanges: &[Pose<f64>]) -> Self {
        let terms = Terms {
            gravity: false,
            payload: false,
            orders: 0,
            size: false,
        };
        let mut out = Self::new(nominal, tips, None, Vector3::zeros(), terms);
        out.columns
            .retain(|column| matches!(column.group, Group::Tip | Group::Turn));
        out.theta = vec![0.0; out.columns.len()];
        let flange_from_joint = nominal.frames()[nominal.kinds().len()].inverse();
        out.known = Some(flanges.iter().map(|f| *f * flange_from_joint).collect());
        out
    }

    /// Moves to the parameters `theta`.
    pub fn update(&mut self, theta: &[f64]) {
        let mut x = vec![0.0; self.model.deviation.len()];
        for (column, value) in self.columns.iter().zip(theta) {
            for (row, factor) in &column.to {
                x[*row] += factor * value;
            }
        }
        self.model.update(&x);
        self.theta = theta.to_vec();
    }

    /// Returns base_from_tip in every state; for a known arm, the states must be those of the problem.
    pub fn poses(&self, states: &[BaseSample]) -> Vec<Pose<f64>> {
        if let Some(known) = &self.known {
            let pairs = known.iter().zip(states);
            return pairs
                .map(|(joint, state)| *joint * self.model.tools[state.tool])
                .collect();
        }
        let chains: Vec<Poe<f64>> = (0..self.model.tools.len())
            .map(|tool| self.model.chain(tool))
            .collect();
        let of = |state: &BaseSample| {
            let chain = &chains[state.tool];
            let deflection = self.model.parametric_deflection(chain, state);
            self.model.pose(chain, state, &deflection)
        };
        states.iter().map(of).collect()
    }

    /// Returns the poses of all states with their derivatives.
    pub fn linearise(&self, states: &[BaseSample]) -> Vec<StateJet> {
        let poses = self.poses(states);
        if let Some(known) = &self.known {
            let all = poses.iter().zip(known).zip(states);
            return all
                .map(|((pose, joint), state)| StateJet {
                    pose: *pose,
                    jacobian: self.by_tip(joint, state.tool),
                })
                .collect();
        }
        let mut out = Vec::with_capacity(states.len());
        // Linearise in blocks: all parameters of all states at once would need much memory.
        for (states, poses) in states.chunks(TOGETHER).zip(poses.chunks(TOGETHER)) {
            let linear = self.model.linearise(states, NoiseScales::ONE);
            for (k, pose) in poses.iter().enumerate() {
                let mut jacobian = Mat::zeros(ROWS, self.columns.len());
                for (j, column) in self.columns.iter().enumerate() {
                    for (from, factor) in &column.to {
                        for row in 0..ROWS {
                            jacobian[(row, j)] += factor * linear.a[(ROWS * k + row, *from)];
                        }
                    }
                }
                out.push(StateJet {
                    pose: *pose,
                    jacobian,
                });
            }
        }
        out
    }
}

impl TouchArm {
    /// Returns the Jacobian of a known arm by the parameters of tip `tool`; `joint` is base_from_joint of the last joint.
    fn by_tip(&self, joint: &Pose<f64>, tool: usize) -> Mat<f64> {
        let tip = self.model.tools[tool].translation;
        let first = 6 * (self.model.layout.joints + tool);
        let mut out = Mat::zeros(ROWS, self.columns.len());
        for (j, column) in self.columns.iter().enumerate() {
            if column.index != tool {
                continue;
            }
            let mut twist = [0.0; 6];
            for (row, factor) in &column.to {
                twist[row - first] = *factor;
            }
            let twist = Twist::from_array(&twist);
            let moved = joint.rotation * (twist.linear + twist.angular.cross(&tip));
            let turned = joint.rotation * twist.angular;
            for i in 0..3 {
                (out[(i, j)], out[(3 + i, j)]) = (moved[i], turned[i]);
            }
        }
        out
    }
}

/// Number of states that are linearised together.
const TOGETHER: usize = 64;
