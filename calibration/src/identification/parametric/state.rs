//! The parametric part of the elastic model during a fit, and its linearisation.
//!
//! ```text
//! x = [ 6 an arm frame | 6 a tool | 3 for each (joint, link) | 4 payload terms a joint | 2 a ripple term ]
//! ```
//!
//! Every parameter has a Gaussian prior around the nominal arm. The total change so far is kept in `deviation`, so that
//! the prior stays where it was when the model is linearised again (re-centring it would be an iterated Tikhonov
//! regularisation, not a maximum a posteriori estimate).

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::elastic::curve::add_curves;
use poegp_runtime::elastic::deflection::deflected;
use poegp_runtime::elastic::gravity::{GravityRegressors, GravityTerms};
use poegp_runtime::elastic::ripple::{RippleTerm, ripple_regressors};
use poegp_runtime::kinematics::coupling::PerJoint;
use poegp_runtime::kinematics::poe::{JointTrig, Poe};
use poegp_runtime::math::se3::{Pose, Twist};

use crate::identification::frame_fit::{ResidualFrame, residual_components};
use crate::identification::parametric::gear_line::GearLine;
use crate::measurement::noise::NoiseScales;
use crate::measurement::sample::Sample;
use crate::numeric::matrix::Mat;
use crate::robot::coupled;

/// Number of rows of one pose: displacement and rotation at the tool.
pub const ROWS: usize = 6;

/// Largest allowed linearisation error of the last step, in units of the noise. With positions alone, base and tool lie
/// in a long curved valley: after two steps, all predictions for a Motoman were 0.16 mm off.
pub const MAX_LINEARISATION_ERROR: f64 = 0.02;
/// Largest number of Gauss–Newton steps.
pub const MAX_STEPS: usize = 12;

/// Layout of the parameter vector x: which parameters there are.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Number of joints of the arm.
    pub joints: usize,
    /// Number of tools: one for each session and target.
    pub tools: usize,
    /// Whether gravity terms of the links are fitted.
    pub gravity: bool,
    /// Whether the payload varies and its terms are fitted.
    pub payload: bool,
    /// Frequencies of gear ripple.
    pub ripple: Vec<GearLine>,
}

/// A group of parameters that share a prior.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PriorGroup {
    /// Base frame and tools.
    BaseAndTools,
    /// Arm frames.
    Frames,
    /// Gravity of the links.
    Links,
    /// Gravity of the payload.
    Payload,
    /// Gear ripple that was found in the measurements.
    Ripple,
    /// Gear ripple that the robot's description states.
    StatedRipple,
}

impl PriorGroup {
    /// Returns the prior standard deviation before the evidence changes it: m and rad; rad/(m/s²) for gravity.
    pub fn prior_sd(self) -> f64 {
        match self {
            Self::BaseAndTools => 60e-3,
            Self::Frames => 2e-3,
            Self::Links | Self::Payload => 1e-4,
            Self::Ripple => 1e-3,
            // Strain-wave gears had 28 to 130 µrad, that is 54 for a sine or a cosine; half of the lines of a gear ratio
            // are absent.
            Self::StatedRipple => 4e-5,
        }
    }
}

/// Returns the prior variance of a group, scaled by the hyperparameters `h` that the evidence chose.
pub fn prior_variance(group: PriorGroup, h: &[f64]) -> f64 {
    let base = group.prior_sd().powi(2);
    match group {
        PriorGroup::Frames => base * libm::exp(h[2]),
        PriorGroup::Links => base * libm::exp(h[3]),
        PriorGroup::Payload => base * libm::exp(h[4]),
        PriorGroup::BaseAndTools | PriorGroup::Ripple | PriorGroup::StatedRipple => base,
    }
}

impl Layout {
    /// Returns the prior group of every parameter, in order.
    pub fn groups(&self) -> Vec<PriorGroup> {
        let n = self.joints;
        let mut out = Vec::new();
        out.extend(std::iter::repeat_n(PriorGroup::BaseAndTools, 6));
        out.extend(std::iter::repeat_n(PriorGroup::Frames, 6 * (n - 1)));
        out.extend(std::iter::repeat_n(
            PriorGroup::BaseAndTools,
            6 * self.tools,
        ));
        if self.gravity {
            out.extend(std::iter::repeat_n(PriorGroup::Links, 3 * n * (n + 1) / 2));
            if self.payload {
                out.extend(std::iter::repeat_n(PriorGroup::Payload, 4 * n));
            }
        }
        for line in &self.ripple {
            let group = match line.is_stated {
                true => PriorGroup::StatedRipple,
                false => PriorGroup::Ripple,
            };
            out.extend([group; 2]);
        }
        out
    }
}

/// The parametric model at its current parameters.
#[derive(Clone, Debug)]
pub struct ParametricModel {
    /// Layout of the parameters.
    pub layout: Layout,
    /// Base frame and arm frames, `parent_from_joint`, one for each of the n joints.
    pub frames: Vec<Pose<f64>>,
    /// `joint_n_from_target` of each tool.
    pub tools: Vec<Pose<f64>>,
    /// Gravity terms.
    pub gravity: GravityTerms<f64>,
    /// Ripple terms.
    pub ripple: Vec<RippleTerm<f64>>,
    /// Own-joint curves as the runtime evaluates them; empty when there are none. They are not among the parameters x.
    pub curves: Vec<f64>,
    /// Parameters x: the total change from the nominal arm.
    pub deviation: Vec<f64>,
    kinds: Vec<JointKind>,
    /// Joint coupling C as n rows; identity when absent.
    coupling: Option<Vec<Vec<f64>>>,
}

/// The linearised model at a state: y = A x + Σ_c J_c δ_c + noise, with every row in units of its own scale.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// Residual at the state plus A·deviation, with 6k rows.
    pub y: Mat<f64>,
    /// Jacobian A by the parameters, 6k × p.
    pub a: Mat<f64>,
    /// Jacobian by the controller's joints, 6k × n, per rad or m.
    pub jacobian: Mat<f64>,
    /// For each of the 6k rows, the share of its variance that all rows have in common: the fitted noise multiplies that
    /// share.
    pub common_share: Vec<f64>,
}

impl Linearised {
    /// Returns the standard deviation of a row's noise divided by e^(h/2), where e^(h/2) is that of the quietest row,
    /// both in units of their scales; 1 where all rows are alike.
    pub fn relative_noise(&self, row: usize, h: f64) -> f64 {
        let common = self.common_share[row];
        (common + (1.0 - common) * libm::exp(-h)).sqrt()
    }
}

impl ParametricModel {
    /// Creates the model of the nominal arm: `chain` leads from the base to the target of tool 0.
    pub fn new(
        chain: &Poe<f64>,
        tools: Vec<Pose<f64>>,
        coupling: Option<Vec<Vec<f64>>>,
        layout: Layout,
        gravity: Vector3<f64>,
    ) -> Self {
        let n = layout.joints;
        let ripple = layout.ripple.iter().map(|line| RippleTerm {
            joint: line.joint,
            cycles: line.cycles,
            sin: 0.0,
            cos: 0.0,
        });
        Self {
            frames: chain.frames()[..n].to_vec(),
            tools,
            gravity: GravityTerms {
                gravity,
                ..GravityTerms::zero()
            },
            ripple: ripple.collect(),
            curves: Vec::new(),
            deviation: vec![0.0; layout.groups().len()],
            kinds: chain.kinds().to_vec(),
            coupling,
            layout,
        }
    }

    /// Returns the kinds of the joints.
    pub fn kinds(&self) -> &[JointKind] {
        &self.kinds
    }

    /// Returns the chain from the base to the target of a tool.
    pub fn chain(&self, tool: usize) -> Poe<f64> {
        let mut frames = self.frames.clone();
        frames.push(self.tools[tool]);
        Poe::new(&self.kinds, &frames).expect("a chain stays a chain")
    }

    /// Returns the deflection of the controller's joints by gravity, ripple and own-joint curves.
    pub fn parametric_deflection<F>(&self, chain: &Poe<f64>, sample: &Sample<F>) -> PerJoint<f64> {
        let motions = chain.motions(&sample.serial_joints);
        let (frames, target) = chain.joint_frames_with(&motions);
        let at = GravityRegressors::new(&self.kinds, &frames, &target, &self.gravity.gravity);
        let mut out = self
            .gravity
            .deflection(&at, sample.payload_kg.unwrap_or(0.0));
        for term in &self.ripple {
            out[term.joint] += term.deflection(sample.joints[term.joint]);
        }
        if !self.curves.is_empty() {
            add_curves(&self.kinds, &self.curves, &self.features(sample), &mut out);
        }
        out
    }

    /// Returns C δ: a deflection of the controller's joints converted to the chain's joints.
    pub fn coupled(&self, deflection: &PerJoint<f64>) -> PerJoint<f64> {
        let mut out = [0.0; MAX_JOINTS];
        let serial = coupled(self.coupling.as_deref(), deflection);
        out[..serial.len()].copy_from_slice(&serial);
        out
    }

    /// Returns the pose POE(C (q + δ)), `base_from_target`.
    pub fn pose<F>(
        &self,
        chain: &Poe<f64>,
        sample: &Sample<F>,
        deflection: &PerJoint<f64>,
    ) -> Pose<f64> {
        let motions = chain.motions(&sample.serial_joints);
        chain.forward_with(&deflected(&motions, &self.kinds, &self.coupled(deflection)))
    }

    /// Returns the joints in the form that the kernel compares.
    pub fn features<F>(&self, sample: &Sample<F>) -> JointTrig<f64> {
        let mut joints = [0.0; MAX_JOINTS];
        joints[..sample.joints.len()].copy_from_slice(&sample.joints);
        self.chain(0).motions(&joints)
    }

    /// Returns the residuals of the parametric model, six for each pose, with each row in units of its own scale.
    pub fn residuals<F>(&self, samples: &[Sample<F>], scales: NoiseScales) -> Vec<[f64; ROWS]> {
        let chains: Vec<Poe<f64>> = (0..self.tools.len()).map(|t| self.chain(t)).collect();
        let of = |s: &Sample<F>| {
            let chain = &chains[s.tool];
            let predicted = self.pose(chain, s, &self.parametric_deflection(chain, s));
            let kind = ResidualFrame::ToolPoint(scales.of(s));
            residual_components(kind, &s.observation, &predicted)
        };
        samples.iter().map(of).collect()
    }

    /// Linearises the model at the current parameters.
    pub fn linearise<F>(&self, samples: &[Sample<F>], scales: NoiseScales) -> Linearised {
        let (n, p) = (self.layout.joints, self.deviation.len());
        let chains: Vec<Poe<f64>> = (0..self.tools.len()).map(|t| self.chain(t)).collect();
        let mut out = Linearised {
            y: Mat::zeros(ROWS * samples.len(), 1),
            a: Mat::zeros(ROWS * samples.len(), p),
            jacobian: Mat::zeros(ROWS * samples.len(), n),
            common_share: Vec::with_capacity(ROWS * samples.len()),
        };
        for (k, sample) in samples.iter().enumerate() {
            let [position, orientation] = scales.common_share(sample);
            out.common_share.extend([position; 3]);
            out.common_share.extend([orientation; 3]);
            self.linearise_one(&chains[sample.tool], sample, scales.of(sample), k, &mut out);
        }
        for (row, residual) in self
            .residuals(samples, scales)
            .into_iter()
            .flatten()
            .enumerate()
        {
            let past: f64 = (0..p).map(|i| out.a[(row, i)] * self.deviation[i]).sum();
            out.y[(row, 0)] = residual + past;
        }
        out
    }

    fn linearise_one<F>(
        &self,
        chain: &Poe<f64>,
        sample: &Sample<F>,
        scales: NoiseScales,
        k: usize,
        out: &mut Linearised,
    ) {
        let n = self.layout.joints;
        let plain = chain.motions(&sample.serial_joints);
        let (frames, target) = chain.joint_frames_with(&plain);
        let at = GravityRegressors::new(&self.kinds, &frames, &target, &self.gravity.gravity);
        // Jacobians are taken at the deflected joints, where the arm actually stands.
        let deflection = self.parametric_deflection(chain, sample);
        let shift = self.coupled(&deflection);
        let standing: Vec<f64> = sample
            .serial_joints
            .iter()
            .zip(&shift)
            .map(|(q, d)| q + d)
            .collect();
        let (blocks, pose) = chain.identification_jacobian(&standing);
        let (columns, _) = chain.space_jacobian(&standing);
        let rows = sample.observation.equations();
        let scale = |row: usize| {
            if row < 3 {
                scales.position
            } else {
                scales.orientation
            }
        };
        let at_tool = |twist: &Twist<f64>| twist.at_point(&pose.translation).to_array();
        for (frame, block) in blocks.iter().enumerate().take(n + 1) {
            let first = if frame < n {
                6 * frame
            } else {
                6 * n + 6 * sample.tool
            };
            for i in 0..6 {
                let twist = Twist::from_array(&block.map(|row| row[i]));
                for (row, value) in at_tool(&twist).into_iter().enumerate().take(rows) {
                    out.a[(ROWS * k + row, first + i)] = value / scale(row);
                }
            }
        }
        for c in 0..n {
            let mut unit = [0.0; MAX_JOINTS];
            unit[c] = 1.0;
            for (column, share) in columns.iter().zip(&self.coupled(&unit)) {
                for (row, value) in at_tool(column).into_iter().enumerate().take(rows) {
                    out.jacobian[(ROWS * k + row, c)] += share * value / scale(row);
                }
            }
        }
        let mut column = 6 * n + 6 * self.tools.len();
        let mut put = |out: &mut Linearised, joint: usize, value: f64| {
            for row in 0..rows {
                out.a[(ROWS * k + row, column)] = out.jacobian[(ROWS * k + row, joint)] * value;
            }
            column += 1;
        };
        if self.layout.gravity {
            for c in 0..n {
                for link in c..n {
                    for value in at.link(c, link).iter() {
                        put(out, c, *value);
                    }
                }
            }
            if self.layout.payload {
                let m = sample.payload_kg.unwrap_or(0.0);
                for c in 0..n {
                    let (lever, offset) = at.payload(c);
                    for value in [lever, offset[0], offset[1], offset[2]] {
                        put(out, c, m * value);
                    }
                }
            }
        }
        for term in &self.ripple {
            let (sin, cos) = ripple_regressors(term.cycles, sample.joints[term.joint]);
            put(out, term.joint, sin);
            put(out, term.joint, cos);
        }
    }

    /// Moves to the parameters `x`.
    pub fn update(&mut self, x: &[f64]) {
        let step: Vec<f64> = x
            .iter()
            .zip(&self.deviation)
            .map(|(new, old)| new - old)
            .collect();
        let n = self.layout.joints;
        let mut parts = step.chunks_exact(6);
        for frame in self.frames.iter_mut().chain(&mut self.tools) {
            let twist: [f64; 6] = parts
                .next()
                .and_then(|c| c.try_into().ok())
                .unwrap_or([0.0; 6]);
            *frame = Pose::exp(&Twist::from_array(&twist)) * *frame;
        }
        let mut rest = x[6 * (n + self.tools.len())..].iter().copied();
        let mut next = || rest.next().unwrap_or(0.0);
        if self.layout.gravity {
            for c in 0..n {
                for link in c..n {
                    self.gravity.links[c][link] = Vector3::new(next(), next(), next());
                }
            }
            if self.layout.payload {
                for c in 0..n {
                    self.gravity.payload_lever[c] = next();
                    self.gravity.payload_offset[c] = Vector3::new(next(), next(), next());
                }
            }
        }
        for term in &mut self.ripple {
            (term.sin, term.cos) = (next(), next());
        }
        self.deviation = x.to_vec();
    }

    /// Moves to the parameters `x` that solve the equations `linear` of the current state at `samples`. Returns the
    /// largest linearisation error in units of the rows' scales; above [`MAX_LINEARISATION_ERROR`], another step is
    /// needed.
    pub fn step<F>(
        &mut self,
        x: &[f64],
        linear: &Linearised,
        samples: &[Sample<F>],
        scales: NoiseScales,
    ) -> f64 {
        self.update(x);
        let residuals = self.residuals(samples, scales).into_iter().flatten();
        let error = |(row, residual): (usize, f64)| {
            let effect: f64 = (0..x.len()).map(|i| linear.a[(row, i)] * x[i]).sum();
            (residual - (linear.y[(row, 0)] - effect)).abs()
        };
        residuals.enumerate().map(error).fold(0.0, f64::max)
    }

    /// Removes the ripple terms that the robot's description does not state and for which `keeps` is false. The other
    /// parameters keep their values and must be solved again.
    pub fn retain_ripple(&mut self, mut keeps: impl FnMut(&GearLine) -> bool) {
        let first = self.deviation.len() - 2 * self.ripple.len();
        let lines = self.layout.ripple.iter();
        let kept: Vec<bool> = lines.map(|line| keeps(line) || line.is_stated).collect();
        let mut terms = kept.iter();
        self.ripple.retain(|_| terms.next() == Some(&true));
        let mut terms = kept.iter();
        self.layout.ripple.retain(|_| terms.next() == Some(&true));
        let mut index = 0;
        self.deviation.retain(|_| {
            index += 1;
            index <= first || kept[(index - 1 - first) / 2]
        });
    }

    /// Changes the frequency of a ripple term.
    pub fn set_cycles(&mut self, term: usize, cycles: f64) {
        self.layout.ripple[term].cycles = cycles;
        self.ripple[term].cycles = cycles;
    }

    /// Adds ripple terms with amplitude zero.
    pub fn add_ripple(&mut self, lines: &[GearLine]) {
        for line in lines {
            self.layout.ripple.push(*line);
            self.ripple.push(RippleTerm {
                joint: line.joint,
                cycles: line.cycles,
                sin: 0.0,
                cos: 0.0,
            });
            self.deviation.extend([0.0, 0.0]);
        }
    }
}
