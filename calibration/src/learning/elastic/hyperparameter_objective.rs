//! The objective −log p of the marginal likelihood with its gradient by the hyperparameters, in memory that one search
//! keeps.

use std::cell::RefCell;
use std::ops::Range;

use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::gp::joint_kernel::JointKernel;

use crate::identification::parametric::state::{PriorGroup, ROWS, prior_variance};
use crate::learning::elastic::likelihood::{Covariances, MarginalLikelihood, POSES_TOGETHER};
use crate::learning::elastic::own_joint_curve::gradient_by_order;
use crate::numeric::cholesky::CholeskyWorkspace;
use crate::numeric::lbfgs::Objective;
use crate::numeric::matrix::{ColumnsMut, Mat, column, columns_mut, parts};
use crate::numeric::parallel::for_each;
use crate::numeric::product::{Transposed, product};
use crate::numeric::vectors::vectorised;

impl Objective for MarginalLikelihood<'_> {
    fn value_and_gradient(&self, h: &[f64]) -> (f64, Vec<f64>) {
        HyperparameterObjective::new(self).value_and_gradient(h)
    }
}

/// The objective of a [`MarginalLikelihood`], in memory that is kept from one evaluation to the next.
#[derive(Debug)]
pub struct HyperparameterObjective<'a> {
    evidence: &'a MarginalLikelihood<'a>,
    workspace: RefCell<(CholeskyWorkspace, Covariances)>,
}

impl<'a> HyperparameterObjective<'a> {
    /// Creates the objective and allocates its memory.
    pub fn new(evidence: &'a MarginalLikelihood<'a>) -> Self {
        let factor = CholeskyWorkspace::new(evidence.linear.y.nrows(), evidence.threads);
        Self {
            evidence,
            workspace: RefCell::new((factor, evidence.no_kernels())),
        }
    }
}

impl Objective for HyperparameterObjective<'_> {
    fn value_and_gradient(&self, h: &[f64]) -> (f64, Vec<f64>) {
        let evidence = self.evidence;
        let (factor, kernels) = &mut *self.workspace.borrow_mut();
        evidence.covariance(h, &mut factor.matrix, kernels);
        let rejected = (f64::INFINITY, vec![0.0; h.len()]);
        if factor.factor().is_err() {
            return rejected;
        }
        let y = &evidence.linear.y;
        let rows = y.nrows();
        let mut alpha = y.clone();
        factor.solve_in_place(&mut columns_mut(&mut alpha));
        let fit: f64 = (0..rows).map(|r| y[(r, 0)] * alpha[(r, 0)]).sum();
        let value = 0.5 * fit + factor.half_log_determinant();
        if !value.is_finite() {
            return rejected;
        }
        let mut gradient = vec![0.0; h.len()];
        evidence.prior_gradient(h, factor, &alpha, &mut gradient);
        let inverse = factor.lower_inverse();
        for r in 0..rows {
            let w = inverse[(r, r)] - alpha[(r, 0)] * alpha[(r, 0)];
            let i = usize::from(r % ROWS >= 3);
            gradient[i] += 0.5 * w * libm::exp(h[i]) * evidence.linear.common_share[r];
        }
        evidence.kernel_gradients(h, &kernels.kernels, inverse, &alpha, &mut gradient);
        (value, gradient)
    }
}

impl MarginalLikelihood<'_> {
    /// Adds the gradient by the variances of the parameter groups.
    fn prior_gradient(
        &self,
        h: &[f64],
        factor: &CholeskyWorkspace,
        alpha: &Mat<f64>,
        gradient: &mut [f64],
    ) {
        // The squares of L⁻¹A_g add up to the trace of A_gᵀ S⁻¹ A_g.
        let mut half = self.linear.a.clone();
        for_each(self.threads, parts(&mut half, 32), |(_, mut columns)| {
            factor.half_solve_in_place(&mut columns);
        });
        let projected = product(Transposed(&self.linear.a), alpha);
        for (i, of) in [
            (2, PriorGroup::Frames),
            (3, PriorGroup::Links),
            (4, PriorGroup::Payload),
        ] {
            let mut trace = 0.0;
            for (j, _) in self.groups.iter().enumerate().filter(|(_, g)| **g == of) {
                trace += column(&half, j).iter().map(|x| x * x).sum::<f64>();
                trace -= projected[(j, 0)] * projected[(j, 0)];
            }
            gradient[i] += 0.5 * prior_variance(of, h) * trace;
        }
    }

    /// Adds the gradient ½ Σ W ∘ ∂S by the hyperparameters of the kernels, all outputs in one pass over S⁻¹.
    fn kernel_gradients(
        &self,
        h: &[f64],
        kernels: &[Mat<f64>],
        inverse: &Mat<f64>,
        alpha: &Mat<f64>,
        gradient: &mut [f64],
    ) {
        let natural = self.layout.kernels(h);
        let columns = self.columns();
        let project = |(k, part): (usize, &[f64; ROWS])| {
            let mut sum = 0.0;
            for (b, value) in part.iter().enumerate() {
                sum += value * alpha[(ROWS * k + b, 0)];
            }
            sum
        };
        let curve = self.layout.curve_prior(h);
        let outputs: Vec<Output<'_>> = columns
            .iter()
            .enumerate()
            .map(|(c, column)| Output {
                kernel: kernels.get(c).map(|kernel| (&natural[c], kernel)),
                column,
                projected: column.iter().enumerate().map(project).collect(),
            })
            .collect();
        let mut pairs: Vec<Mat<f64>> = match curve {
            Some(_) => (0..outputs.len())
                .map(|_| Mat::zeros(self.poses(), self.poses()))
                .collect(),
            None => Vec::new(),
        };
        let mut tasks: Vec<Part<'_>> = (0..self.poses())
            .step_by(POSES_TOGETHER)
            .map(|first| Part {
                poses: first..self.poses().min(first + POSES_TOGETHER),
                pairs: Vec::new(),
                sums: vec![KernelSums::default(); outputs.len()],
            })
            .collect();
        for pairs in &mut pairs {
            let columns = parts(pairs, POSES_TOGETHER);
            for (part, (_, columns)) in tasks.iter_mut().zip(columns) {
                part.pairs.push(columns);
            }
        }
        for_each(self.threads, tasks.iter_mut().collect(), |part| {
            vectorised(
                #[inline(always)]
                || self.add_pairs(&outputs, inverse, part),
            );
        });
        let mut totals = vec![KernelSums::default(); outputs.len()];
        for part in &tasks {
            for (total, sums) in totals.iter_mut().zip(&part.sums) {
                total.add_all(sums);
            }
        }
        drop(tasks);
        for (c, sums) in totals.iter().enumerate() {
            for (d, sum) in sums.scales.iter().take(self.layout.joints).enumerate() {
                let i = self.layout.scale(c, d);
                gradient[i] += sum * libm::exp(h[i]);
            }
            if let (Some(prior), Some(pairs), Some(waves)) = (
                &curve,
                pairs.get(c),
                self.waves.get(c).and_then(Option::as_ref),
            ) {
                for (k, by_variance) in gradient_by_order(pairs, waves).iter().enumerate() {
                    let (amplitude, spectrum) = (prior.amplitude * by_variance, &prior.spectrum);
                    gradient[self.layout.curve_amplitude()] += amplitude * spectrum.variance[k / 2];
                    gradient[self.layout.curve_scale()] += amplitude * spectrum.slope[k / 2];
                }
            }
            gradient[self.layout.amplitude(c, 0)] += sums.constant;
            if self.layout.payload {
                let i = self.layout.scale(c, self.layout.joints);
                gradient[i] += 0.5 * sums.payload_scale * libm::exp(h[i]);
                gradient[self.layout.amplitude(c, 1)] += sums.slope;
            }
        }
    }
}

/// The data of one joint that the gradient needs.
struct Output<'a> {
    /// Kernel of the joint's process, and its K_c; `None` without processes.
    kernel: Option<(&'a JointKernel<f64>, &'a Mat<f64>)>,
    /// J_c of each pose, in units of the processes.
    column: &'a [[f64; ROWS]],
    /// J_cᵀ α of each pose.
    projected: Vec<f64>,
}

/// A task of one thread: some columns of the matrix of all pairs of poses.
struct Part<'a> {
    poses: Range<usize>,
    /// G_c(i, j) of each output for the own-joint curve, halved on the diagonal; empty when there is no curve.
    pairs: Vec<ColumnsMut<'a>>,
    /// Sums of each output.
    sums: Vec<KernelSums>,
}

/// Sums of one output over pairs of poses.
#[derive(Clone, Debug, Default)]
struct KernelSums {
    scales: [f64; MAX_JOINTS],
    payload_scale: f64,
    constant: f64,
    slope: f64,
}

impl KernelSums {
    fn add_all(&mut self, other: &Self) {
        for (sum, part) in self.scales.iter_mut().zip(&other.scales) {
            *sum += part;
        }
        self.payload_scale += other.payload_scale;
        self.constant += other.constant;
        self.slope += other.slope;
    }
}

impl MarginalLikelihood<'_> {
    /// Adds the pairs of a part, all outputs in one pass over S⁻¹.
    #[inline(always)]
    fn add_pairs(&self, outputs: &[Output<'_>], inverse: &Mat<f64>, part: &mut Part<'_>) {
        for j in part.poses.clone() {
            let blocks: [&[[f64; ROWS]]; ROWS] =
                std::array::from_fn(|b| column(inverse, ROWS * j + b).as_chunks::<ROWS>().0);
            let similarities: Vec<&[f64]> =
                self.similarities.iter().map(|m| column(m, j)).collect();
            let other = self.inputs.payloads[j];
            for (i, payload) in self.inputs.payloads.iter().enumerate().skip(j) {
                let block: [[f64; ROWS]; ROWS] = blocks.map(|column| column[i]);
                let payloads = (*payload, other);
                for (c, output) in outputs.iter().enumerate() {
                    let half = output.contracted((i, j), &block);
                    if let Some(pairs) = part.pairs.get_mut(c) {
                        pairs[j - part.poses.start][i] = half;
                    }
                    output.add((i, j), half, &similarities, payloads, &mut part.sums[c]);
                }
            }
        }
    }
}

impl Output<'_> {
    /// Returns G_c(i, j), halved on the diagonal; `block` is its part of S⁻¹ by columns.
    #[inline(always)]
    fn contracted(&self, (i, j): (usize, usize), block: &[[f64; ROWS]; ROWS]) -> f64 {
        let mut g = -self.projected[i] * self.projected[j];
        for (part, jb) in block.iter().zip(&self.column[j]) {
            let mut sum = 0.0;
            for (entry, moved) in part.iter().zip(&self.column[i]) {
                sum += moved * entry;
            }
            g += sum * jb;
        }
        if i == j { 0.5 * g } else { g }
    }

    /// Adds the pair (i, j) to `sums`; `half` is its G_c, halved on the diagonal.
    #[inline(always)]
    fn add(
        &self,
        (i, j): (usize, usize),
        half: f64,
        similarities: &[&[f64]],
        (m, other): (f64, f64),
        sums: &mut KernelSums,
    ) {
        let Some((natural, kernel)) = self.kernel else {
            return;
        };
        let weight = half * kernel[(i, j)];
        for (sum, s) in sums.scales.iter_mut().zip(similarities) {
            *sum += weight * (s[i] - 1.0);
        }
        sums.payload_scale -= weight * (m - other) * (m - other);
        let amplitude = natural.amplitude + natural.payload_amplitude * m * other;
        sums.constant += weight * natural.amplitude / amplitude;
        sums.slope += weight * natural.payload_amplitude * m * other / amplitude;
    }
}
