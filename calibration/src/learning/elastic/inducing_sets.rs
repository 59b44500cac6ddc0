//! Selection of each joint's inducing points: a few kernels that represent the whole posterior.
//!
//! The processes of the joints have lengthscales of their own, so each needs its own few points. The posterior mean with
//! all poses as points is known. For each joint, kernels at some of the poses approximate it greedily (orthogonal least
//! squares): over all joints, the next kernel is the one that reduces the squared difference most for its instructions,
//! where a difference is weighted by how much the joint moves the tool. The two functions are compared at the poses and
//! between pairs of them. The weights of the chosen points and all parameters are then solved again from the
//! measurements. Where the whole posterior over-fits few poses, that is better (Motoman, five folds: the whole posterior
//! 0.041 mm, the points fitted to it 0.042, solved again 0.036).
//!
//! A joint's kernel ignores joints that hardly matter to it: those whose rate leaves less than `NEGLIGIBLE` of the
//! noise's variance unexplained. The features of ignored joints are not stored.

use poegp_protocol::limits::MAX_GROUPS;
use poegp_runtime::gp::joint_kernel::JointKernel;
use poegp_runtime::kinematics::poe::JointTrig;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::device_cost::{block_instructions, row_instructions};
use crate::identification::parametric::state::Linearised;
use crate::learning::elastic::hyperparameters::DEFLECTION_UNIT;
use crate::learning::elastic::inputs::{ClusteredInput, kernel};
use crate::learning::elastic::options::InducingLimits;
use crate::learning::elastic::reduced_solution::solve;
use crate::learning::elastic::solution::ElasticFit;
use crate::measurement::sample::BaseSample;
use crate::numeric::statistics::distinct;
use crate::numeric::vectors::dot;

/// Unexplained variance below which a joint is ignored, as a share of the noise of all components of a pose. Wild arms 1
/// to 3, 150 functions: 0.0631 mm and 10 400 instructions with 0, 0.0631 and 8 800 with this, 0.0637 and 7 400 with ten
/// times as much.
const NEGLIGIBLE: f64 = 0.01;
/// Ridge that devalues a kernel that the chosen ones nearly span: it is added to the squared length of what they leave of
/// the kernel, as a share of the mean squared length of a column. 1e-6 is 0.3 % worse on ten paper-like and ten wild
/// arms, 1e-4 3 %.
const RIDGE: f64 = 1e-7;
/// Least share of a kernel's squared length that must lie outside the span of the chosen ones.
const LEAST_LEFT: f64 = 1e-5;
/// Largest number of payloads of the centres: each costs an exponential for each joint. Two instead of five are 10 %
/// worse on wild arms.
pub const MAX_PAYLOADS: usize = 6;
const _: () = assert!(MAX_PAYLOADS <= MAX_GROUPS);
/// Largest number of poses whose kernels may be chosen, and of poses at which functions are compared; as many positions
/// between poses are compared as well.
const MAX_CANDIDATES: usize = 400;
const MAX_QUERY_POINTS: usize = 600;

/// One inducing point.
#[derive(Clone, Copy, Debug)]
pub struct InducingPoint {
    /// Joints at the point, in the form that the kernel compares.
    pub features: JointTrig<f64>,
    /// Payload in kg, one of at most [`MAX_GROUPS`].
    pub payload_kg: f64,
    /// Weight of the point's kernel.
    pub weight: f64,
}

/// The inducing points of all joints.
#[derive(Clone, Debug)]
pub struct InducingSets {
    /// Kernel of each joint; the rates of ignored joints are zero.
    pub kernels: Vec<JointKernel<f64>>,
    /// Inducing points of each joint, sorted by payload.
    pub points: Vec<Vec<InducingPoint>>,
    /// RMS displacement of the target over the measurements, in m, caused by the smaller weights that single precision
    /// needs; `None` where single precision holds the weights as they are.
    pub single_precision_cost: Option<f64>,
}

/// A point at which kernels are evaluated: joints and payload.
type QueryPoint = (JointTrig<f64>, f64);

/// Chooses inducing points for a fit to `samples`, and solves for their weights and all parameters from the samples
/// `all`; the parameters of `fit` change. Returns `None` when there are no processes or the system cannot be solved.
pub fn select_greedy(
    fit: &mut ElasticFit,
    samples: &[BaseSample],
    all: &[BaseSample],
    limits: InducingLimits,
) -> Option<InducingSets> {
    let weights = &fit.solved.as_ref()?.weights;
    let (kinds, payloads) = (&fit.inputs.kinds, &fit.inputs.payloads);
    let whole = fit.layout.kernels(&fit.hyperparameters);
    let linear = fit.state.linearise(samples, fit.scales);
    let shares: Vec<f64> = (0..whole.len())
        .map(|c| share(&linear, c, samples.len()))
        .collect();
    let kernels: Vec<JointKernel<f64>> = whole
        .iter()
        .zip(&shares)
        .map(|(kernel, share)| without_negligible(kernel, *share, fit))
        .collect();
    let centre_payloads = clustered_payloads(payloads);
    let mut generator = ChaCha8Rng::seed_from_u64(1);
    let mut order: Vec<usize> = (0..samples.len()).collect();
    if order.len() > MAX_CANDIDATES {
        order.shuffle(&mut generator);
    }
    let query_points = query_points(fit, samples, &order, &mut generator);
    order.truncate(MAX_CANDIDATES);
    let centres: Vec<QueryPoint> = order
        .iter()
        .map(|i| (fit.inputs.features[*i], centre_payloads[*i]))
        .collect();
    let mut joints = Vec::new();
    for (c, share) in shares.iter().enumerate() {
        let posterior = |(features, payload): &QueryPoint| {
            let at = |j: usize| (&fit.inputs.features[j], payloads[j]);
            let each = (0..samples.len())
                .map(|j| kernel(&whole[c], kinds, (features, *payload), at(j)) * weights[(j, c)]);
            each.sum::<f64>() / DEFLECTION_UNIT
        };
        let target: Vec<f64> = query_points.iter().map(posterior).collect();
        let unit = DEFLECTION_UNIT * DEFLECTION_UNIT;
        let column = |(features, payload): &QueryPoint| -> Vec<f64> {
            let at = |(f, m): &QueryPoint| {
                kernel(&kernels[c], kinds, (f, *m), (features, *payload)) / unit
            };
            query_points.iter().map(at).collect()
        };
        let columns = centres.iter().map(column).collect();
        let looked_at = kernels[c].rates().iter().filter(|rate| **rate > 0.0);
        let row = row_instructions(2 * looked_at.count() + 1);
        let block = block_instructions();
        joints.push(Approach::new(columns, target, *share, (row, block)));
    }
    spend(&mut joints, &centres, limits);
    let chosen = joints.iter().enumerate();
    let chosen = chosen.flat_map(|(c, joint)| joint.chosen.iter().map(move |j| (c, *j)));
    let functions: Vec<ClusteredInput> = chosen.map(|(c, j)| (c, centres[j])).collect();
    let solution = solve(fit, all, &kernels, &functions)?;
    let mut sets = vec![Vec::new(); kernels.len()];
    for ((c, (features, payload_kg)), weight) in functions.into_iter().zip(solution.weights) {
        sets[c].push(InducingPoint {
            features,
            payload_kg,
            weight,
        });
    }
    for set in &mut sets {
        set.sort_by(|a: &InducingPoint, b| a.payload_kg.total_cmp(&b.payload_kg));
    }
    Some(InducingSets {
        kernels,
        points: sets,
        single_precision_cost: solution.single_precision_cost,
    })
}

/// Replaces each payload by the nearest of at most [`MAX_PAYLOADS`] quantiles.
pub fn clustered_payloads(payloads: &[f64]) -> Vec<f64> {
    let mut sorted = distinct(payloads.iter().copied());
    if sorted.len() > MAX_PAYLOADS {
        let last = sorted.len() - 1;
        sorted = (0..MAX_PAYLOADS)
            .map(|i| sorted[i * last / (MAX_PAYLOADS - 1)])
            .collect();
    }
    let nearest = |m: f64| {
        let distance = |a: &f64| (a - m).abs();
        let nearer = |a: &f64, b: &f64| distance(a).total_cmp(&distance(b));
        sorted.iter().copied().min_by(nearer).unwrap_or(0.0)
    };
    payloads.iter().map(|m| nearest(*m)).collect()
}

/// Returns the squared effect of a joint on all components of a pose, averaged over the poses, in units of their noise
/// before the processes.
fn share(linear: &Linearised, joint: usize, poses: usize) -> f64 {
    let squares = (0..linear.jacobian.nrows()).map(|row| linear.jacobian[(row, joint)].powi(2));
    squares.sum::<f64>() / poses as f64
}

/// Returns the kernel with the rates of joints that hardly matter set to zero.
fn without_negligible(kernel: &JointKernel<f64>, share: f64, fit: &ElasticFit) -> JointKernel<f64> {
    let (features, payloads) = (&fit.inputs.features, &fit.inputs.payloads);
    let n = payloads.len() as f64;
    let square = payloads.iter().map(|m| m * m).sum::<f64>() / n;
    let variance = kernel.amplitude + kernel.payload_amplitude * square;
    let noise = libm::exp(fit.hyperparameters[0]);
    let matters = |(d, rate): (usize, &f64)| {
        // Half the mean squared distance of two poses; for a revolute joint the mean of 1 − cos.
        let mean = |i: usize| features.iter().map(|f| f[d][i]).sum::<f64>() / n;
        let squares = features.iter().map(|f| f[d][0].powi(2) + f[d][1].powi(2));
        let spread = squares.sum::<f64>() / n - mean(0).powi(2) - mean(1).powi(2);
        let unexplained = share * variance * spread * rate * std::f64::consts::LN_2;
        if unexplained < NEGLIGIBLE * noise {
            0.0
        } else {
            *rate
        }
    };
    let rates: Vec<f64> = kernel.rates()[..fit.inputs.kinds.len()]
        .iter()
        .enumerate()
        .map(matters)
        .collect();
    let mut out = *kernel;
    out.set_rates(rates.into_iter());
    out
}

/// Returns poses, and as many points between two of them.
fn query_points(
    fit: &ElasticFit,
    samples: &[BaseSample],
    order: &[usize],
    generator: &mut ChaCha8Rng,
) -> Vec<QueryPoint> {
    let payloads = &fit.inputs.payloads;
    let taken = &order[..order.len().min(MAX_QUERY_POINTS)];
    let mut out: Vec<QueryPoint> = taken
        .iter()
        .map(|i| (fit.inputs.features[*i], payloads[*i]))
        .collect();
    for _ in taken {
        let (i, j) = (
            generator.random_range(0..samples.len()),
            generator.random_range(0..samples.len()),
        );
        let part: f64 = generator.random_range(0.0..1.0);
        let mut between = samples[i].clone();
        for (q, other) in between.joints.iter_mut().zip(&samples[j].joints) {
            *q += part * (other - *q);
        }
        out.push((fit.state.features(&between), payloads[i]));
    }
    out
}

/// Takes the candidates that are worth most for their instructions until a limit is reached.
fn spend(joints: &mut [Approach], centres: &[QueryPoint], limits: InducingLimits) {
    let limit = limits
        .instructions
        .map_or(f64::INFINITY, |most| most as f64);
    let (mut taken, mut spent) = (0, 0.0);
    let mut best: Vec<Option<Candidate>> = joints.iter().map(|j| j.best(centres)).collect();
    while taken < limits.points {
        let affordable = |c: &Candidate| spent + c.instructions <= limit;
        let Some((c, candidate)) = best
            .iter()
            .enumerate()
            .filter_map(|(c, b)| b.filter(affordable).map(|b| (c, b)))
            .max_by(|a, b| a.1.worth.total_cmp(&b.1.worth))
        else {
            break;
        };
        joints[c].take(candidate.index);
        spent += candidate.instructions;
        taken += 1;
        best[c] = joints[c].best(centres);
    }
}

/// A kernel function that may be taken next.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    index: usize,
    /// Reduction of the squared difference for each instruction.
    worth: f64,
    instructions: f64,
}

/// The greedy approximation of one joint's posterior mean.
struct Approach {
    /// Values of every candidate at every query point.
    columns: Vec<Vec<f64>>,
    /// Weight of a squared difference of this joint.
    share: f64,
    /// Instructions for a row, and for a payload group.
    row: f64,
    block: f64,
    ridge: f64,
    chosen: Vec<usize>,
    /// Orthonormal basis of the chosen columns.
    basis: Vec<Vec<f64>>,
    /// Part of the target outside the basis.
    residual: Vec<f64>,
    /// Squared length of every column, and that of its part outside the basis.
    whole: Vec<f64>,
    left: Vec<f64>,
    /// Inner product of every column with the residual.
    along: Vec<f64>,
}

impl Approach {
    fn new(columns: Vec<Vec<f64>>, target: Vec<f64>, share: f64, (row, block): (f64, f64)) -> Self {
        let whole: Vec<f64> = columns.iter().map(|c| dot(c, c)).collect();
        Self {
            ridge: RIDGE * whole.iter().sum::<f64>() / whole.len().max(1) as f64,
            along: columns.iter().map(|c| dot(c, &target)).collect(),
            left: whole.clone(),
            whole,
            residual: target,
            basis: Vec::new(),
            chosen: Vec::new(),
            columns,
            share,
            row,
            block,
        }
    }

    fn best(&self, centres: &[QueryPoint]) -> Option<Candidate> {
        let candidate = |index: usize| {
            let group = |j: &usize| centres[*j].1 == centres[index].1;
            let block = if self.chosen.iter().any(group) {
                0.0
            } else {
                self.block
            };
            let instructions = self.row + block;
            let gain = self.along[index].powi(2) / (self.left[index] + self.ridge);
            Candidate {
                index,
                worth: self.share * gain / instructions,
                instructions,
            }
        };
        (0..self.columns.len())
            .filter(|j| self.left[*j] > LEAST_LEFT * self.whole[*j])
            .map(candidate)
            .filter(|c| c.worth > 0.0)
            .max_by(|a, b| a.worth.total_cmp(&b.worth))
    }

    fn take(&mut self, index: usize) {
        let mut direction = self.columns[index].clone();
        // Orthogonalising twice is enough.
        for _ in 0..2 {
            for known in &self.basis {
                let part = dot(known, &direction);
                subtract(&mut direction, known, part);
            }
        }
        let length = dot(&direction, &direction).sqrt();
        for value in &mut direction {
            *value /= length;
        }
        let step = dot(&direction, &self.residual);
        subtract(&mut self.residual, &direction, step);
        for (j, column) in self.columns.iter().enumerate() {
            let part = dot(&direction, column);
            self.left[j] -= part * part;
            self.along[j] -= part * step;
        }
        // Set to zero whatever rounding leaves.
        self.left[index] = 0.0;
        self.basis.push(direction);
        self.chosen.push(index);
    }
}

fn subtract(a: &mut [f64], b: &[f64], factor: f64) {
    for (a, b) in a.iter_mut().zip(b) {
        *a -= factor * b;
    }
}
