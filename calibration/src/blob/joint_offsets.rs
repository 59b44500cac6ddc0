//! Joint zeros, base and tool that bring the nominal model as near as possible to a blob's predictions.
//!
//! Every controller accepts joint zeros, a base and a tool, and many accept nothing else. The first and the last joint keep
//! their zeros, because base and tool have the same effect. The remaining error is mostly larger than that of a whole chain,
//! so it is returned together with the error of base and tool alone.

use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::blob::predicted_poses::PredictedPoses;
use crate::identification::frame_fit::{ResidualFrame, cost, linearise};
use crate::measurement::sample::BaseSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::statistics::ErrorSummary;
use crate::robot::own_motion;

/// Largest number of Gauss–Newton steps.
const STEPS: usize = 30;
/// Convergence threshold: a step that lowers the cost by less than this share is the last.
const SETTLED: f64 = 1e-9;
/// Share of the largest diagonal element that is added to every diagonal element: an offset that base and tool could
/// replace stays 0.
const RIDGE: f64 = 1e-12;
/// Number of parameters of a frame.
const SIX: usize = 6;

/// Joint zeros, base and tool.
#[derive(Clone, Debug)]
pub struct JointOffsets {
    /// Offset of each joint of the controller, in rad or m: at the controller's joint q, the nominal model is at q + offset.
    /// The offset is 0 for the first and the last joint.
    pub offsets: Vec<f64>,
    /// The nominal model's base, seen from the model's base.
    pub base_from_nominal: Pose<f64>,
    /// `flange_from_target` of the first tool.
    pub flange_from_target: Pose<f64>,
    /// Distances from the predictions, at poses that were not used in the fit.
    pub error: ErrorSummary,
    /// Distances with base and tool alone, fitted to the same poses.
    pub base_and_tool: ErrorSummary,
}

impl JointOffsets {
    /// Fits joint zeros, base and tool of a `nominal` that leads from the model's base to the target at
    /// `flange_from_target`. `coupling` is C of q_serial = C q by rows.
    pub fn new(
        predicted: &PredictedPoses,
        nominal: &Poe<f64>,
        flange_from_target: &Pose<f64>,
        coupling: Option<&[Vec<f64>]>,
    ) -> Self {
        let n = nominal.kinds().len();
        let with = |joints: std::ops::Range<usize>| {
            let mut zeros = Zeros::new(nominal, coupling, joints.collect());
            zeros.fit(&predicted.fitted);
            zeros
        };
        let alone = with(0..0);
        let zeros = with(1..n.saturating_sub(1).max(1));
        let flange = nominal.frames()[n] * flange_from_target.inverse();
        // The tool contains the zero of the chain's last joint; a coupling may shift that zero with another joint's offset.
        let last = motion(nominal.kinds()[n - 1], -zeros.of_chain(n - 1));
        Self {
            base_from_nominal: zeros.base,
            flange_from_target: flange.inverse() * last * zeros.tool * nominal.frames()[n],
            error: predicted.distances(&zeros.chain()),
            base_and_tool: predicted.distances(&alone.chain()),
            offsets: zeros.offsets,
        }
    }
}

/// The fitted parameters: [base | tool | an offset of each free joint].
#[derive(Clone)]
struct Zeros<'a> {
    nominal: &'a Poe<f64>,
    coupling: Option<&'a [Vec<f64>]>,
    free: Vec<usize>,
    /// Transform that multiplies the first frame of the nominal model from the left.
    base: Pose<f64>,
    /// Transform that multiplies the last frame of the nominal model from the left.
    tool: Pose<f64>,
    /// Offsets of the controller's joints, in rad or m.
    offsets: Vec<f64>,
}

impl<'a> Zeros<'a> {
    fn new(nominal: &'a Poe<f64>, coupling: Option<&'a [Vec<f64>]>, free: Vec<usize>) -> Self {
        Self {
            nominal,
            coupling,
            free,
            base: Pose::identity(),
            tool: Pose::identity(),
            offsets: vec![0.0; nominal.kinds().len()],
        }
    }

    /// Returns the coupling factor: by how much joint `j` of the controller moves joint `i` of the chain.
    fn share(&self, i: usize, j: usize) -> f64 {
        self.coupling
            .map_or(f64::from(u8::from(i == j)), |rows| rows[i][j])
    }

    /// Returns the offset of joint `i` of the chain, in rad or m.
    fn of_chain(&self, i: usize) -> f64 {
        let all = self.offsets.iter().enumerate();
        all.map(|(j, offset)| self.share(i, j) * offset).sum()
    }

    fn chain(&self) -> Poe<f64> {
        let mut chain = *self.nominal;
        let n = self.offsets.len();
        let frames = chain.frames_mut();
        frames[0] = self.base * frames[0];
        for i in 0..n - 1 {
            frames[i + 1] = motion(self.nominal.kinds()[i], self.of_chain(i)) * frames[i + 1];
        }
        frames[n] = self.tool * frames[n];
        chain
    }

    /// Computes the Jacobian of [base | tool | offsets] from the Jacobian `a` of all frames, each with six columns for a
    /// twist that multiplies the frame from the left.
    fn columns(&self, a: &Mat<f64>) -> Mat<f64> {
        let n = self.offsets.len();
        let mut out = Mat::zeros(a.nrows(), 2 * SIX + self.free.len());
        for row in 0..a.nrows() {
            for k in 0..SIX {
                out[(row, k)] = a[(row, k)];
                out[(row, SIX + k)] = a[(row, SIX * n + k)];
            }
            for (at, j) in self.free.iter().enumerate() {
                let of = |i: usize| {
                    self.share(i, *j)
                        * a[(row, SIX * (i + 1) + own_motion(self.nominal.kinds()[i]))]
                };
                out[(row, 2 * SIX + at)] = (0..n - 1).map(of).sum();
            }
        }
        out
    }

    fn moved(&self, step: &Mat<f64>, share: f64) -> Self {
        let twist = |first: usize| {
            Twist::from_array(&std::array::from_fn(|k| share * step[(first + k, 0)]))
        };
        let mut out = self.clone();
        out.base = Pose::exp(&twist(0)) * out.base;
        out.tool = Pose::exp(&twist(SIX)) * out.tool;
        for (at, j) in self.free.iter().enumerate() {
            out.offsets[*j] += share * step[(2 * SIX + at, 0)];
        }
        out
    }

    /// Fits the parameters by Gauss–Newton, with the weights of the default gauge.
    fn fit(&mut self, samples: &[BaseSample]) {
        let frames: Vec<usize> = (0..=self.offsets.len()).collect();
        for _ in 0..STEPS {
            let chain = self.chain();
            let kind = ResidualFrame::TOOL_POINT_TOOL_LENGTH;
            let before = cost(&chain, samples, kind);
            let (y, all) = linearise(&chain, samples, &frames, kind);
            let a = self.columns(&all);
            let mut normal = product(Transposed(&a), &a);
            let largest = (0..normal.nrows())
                .map(|i| normal[(i, i)])
                .fold(0.0, f64::max);
            for i in 0..normal.nrows() {
                normal[(i, i)] += RIDGE * largest;
            }
            let Ok(factor) = Factor::new(normal, 1) else {
                return;
            };
            let step = factor.solve(&product(Transposed(&a), &y));
            let candidates = (0..8).map(|halvings| self.moved(&step, 0.5_f64.powi(halvings)));
            let better = candidates
                .map(|candidate| (cost(&candidate.chain(), samples, kind), candidate))
                .find(|(after, _)| *after < before);
            let Some((after, candidate)) = better else {
                return;
            };
            *self = candidate;
            if before - after < SETTLED * before {
                return;
            }
        }
    }
}

/// Returns a rotation about z by `value` in rad or a translation along z by `value` in m.
fn motion(kind: JointKind, value: f64) -> Pose<f64> {
    let mut twist = [0.0; SIX];
    twist[own_motion(kind)] = value;
    Pose::exp(&Twist::from_array(&twist))
}
