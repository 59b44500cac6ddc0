//! The arm as it is fitted to touches: the parametric model of the elastic method with columns of its own.
//!
//! ```text
//! θ = [ 6 for each arm frame | 3 or 6 for each tip | 3 for each (joint, link) | 4 payload terms a joint | 2 an order of a joint ]
//! T(q) = P_0 Z_1 · P_1 exp(δ_1) · Z_2 · … · P_n exp(δ_tip),   δ = (v, ω) in the axes of the frame behind it
//! ```
//!
//! So the last angle of δ_i is the zero of joint i + 1, which is farther from its drawing than the direction of an axis is:
//! it has a prior of its own. The base frame, and with it the zero of the first joint, no touch can see: both stay as drawn.
//! Poses, gravity and own-joint errors are those of [`ParametricModel`], and so of the runtime.

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

/// Parameters that share a prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Group {
    /// Offsets of links, m.
    Length,
    /// Directions of axes, rad.
    Tilt,
    /// Zeros of joints, rad; of a slide m.
    Zero,
    /// Where a tip is at the flange, m.
    Tip,
    /// How a target is turned at the flange, rad.
    Turn,
    /// Gravity of the links, rad/(m/s²).
    Links,
    /// Gravity of the payload, rad/(m/s²)/kg and the like.
    Payload,
    /// Errors of a joint that repeat once and twice in its turn, rad.
    Curve,
}

impl Group {
    /// Those whose prior the evidence moves.
    pub const LEARNT: [Self; 6] = [
        Self::Length,
        Self::Tilt,
        Self::Zero,
        Self::Links,
        Self::Payload,
        Self::Curve,
    ];

    /// Whether its prior is that of the arm's class.
    pub fn is_of_class(self) -> bool {
        matches!(self, Self::Length | Self::Tilt | Self::Zero)
    }
}

/// One parameter.
#[derive(Clone, Debug)]
pub struct Column {
    /// Whose prior it has.
    pub group: Group,
    /// Frame or tip that it belongs to; the joint of a gravity or curve term.
    pub index: usize,
    /// What one unit of it is in the parameters of [`ParametricModel`].
    to: Vec<(usize, f64)>,
}

/// What is fitted beyond the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Terms {
    /// Gravity of the links.
    pub gravity: bool,
    /// Gravity of a payload that varies.
    pub payload: bool,
    /// Orders of the own-joint errors.
    pub orders: usize,
}

/// A tip before the fit.
#[derive(Clone, Copy, Debug)]
pub struct TipStart {
    /// flange_from_tip.
    pub pose: Pose<f64>,
    /// Whether its position is fitted.
    pub is_free: bool,
    /// Whether its rotation is fitted.
    pub turns: bool,
}

/// The arm at its parameters.
#[derive(Clone, Debug)]
pub struct TouchArm {
    /// Poses and their derivatives.
    pub model: ParametricModel,
    /// The parameters.
    pub columns: Vec<Column>,
    /// θ.
    pub theta: Vec<f64>,
    /// base_from_joint of the last joint in every state of the problem, of an arm that is known.
    known: Option<Vec<Pose<f64>>>,
}

/// Where the tip is in one state of the arm, and how that depends on θ.
#[derive(Clone, Debug)]
pub struct StateJet {
    /// base_from_tip.
    pub pose: Pose<f64>,
    /// Six rows: displacement of the tip (m) and rotation (rad) in the axes of the base, per parameter.
    pub jacobian: Mat<f64>,
}

impl TouchArm {
    /// The arm as drawn. `nominal` leads to the flange.
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
        let mut columns = Vec::new();
        let mut twist = |group: Group, index: usize, frame: &Pose<f64>, first: usize, i: usize| {
            let adjoint = frame.adjoint();
            let to = (0..6).map(|row| (first + row, adjoint[row][i]));
            columns.push(Column {
                group,
                index,
                to: to.filter(|(_, value)| *value != 0.0).collect(),
            });
        };
        for frame in 1..n {
            // Along or about which component the joint behind the frame moves.
            let zero = match nominal.kinds()[frame] {
                JointKind::Revolute => 5,
                JointKind::Prismatic => 2,
            };
            for i in 0..6 {
                let group = match i {
                    _ if i == zero => Group::Zero,
                    0..3 => Group::Length,
                    _ => Group::Tilt,
                };
                twist(group, frame, &nominal.frames()[frame], 6 * frame, i);
            }
        }
        for (t, (tip, tool)) in tips.iter().zip(&tools).enumerate() {
            for i in 0..6 {
                let group = if i < 3 { Group::Tip } else { Group::Turn };
                if i < 3 && tip.is_free || i >= 3 && tip.turns {
                    twist(group, t, tool, 6 * (n + t), i);
                }
            }
        }
        let mut next = 6 * (n + tips.len());
        if layout.gravity {
            let first = next;
            let at = |joint: usize, link: usize| {
                let before: usize = (0..joint).map(|c| n - c).sum();
                first + 3 * (before + link - joint)
            };
            for joint in 0..n {
                // The mass at the far end of each link that the joint carries.
                for end in joint..n {
                    let mut to = Vec::new();
                    for link in joint..=end {
                        let frame = match link + 1 {
                            next if next < n => nominal.frames()[next],
                            _ => flange,
                        };
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
            next += 3 * n * (n + 1) / 2;
        }
        let mut single = |group: Group, index: usize| {
            columns.push(Column {
                group,
                index,
                to: vec![(next, 1.0)],
            });
            next += 1;
        };
        if layout.payload {
            for joint in 0..n {
                for _ in 0..4 {
                    single(Group::Payload, joint);
                }
            }
        }
        for line in &layout.ripple {
            for _ in 0..2 {
                single(Group::Curve, line.joint);
            }
        }
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

    /// An arm that is known: `flanges` are base_from_flange in the states that it is asked for, in their order. Its tips alone
    /// are fitted. `nominal` leads to the flange.
    pub fn known(nominal: &Poe<f64>, tips: &[TipStart], flanges: &[Pose<f64>]) -> Self {
        let terms = Terms {
            gravity: false,
            payload: false,
            orders: 0,
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

    /// base_from_tip in every state; of an arm that is known the states are those of the problem.
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

    /// The poses with their derivatives.
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
        // Some at a time: all parameters of all states would take much memory.
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
    /// The derivatives of an arm that is known: by the tip `tool` alone, at base_from_joint of the last joint.
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

/// States that are linearised together.
const TOGETHER: usize = 64;
