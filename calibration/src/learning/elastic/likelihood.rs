//! The marginal likelihood of the elastic model: y = A x + Σ_c J_c δ_c + noise with x and δ integrated out.
//!
//! S = Σ_g λ_g A_g A_gᵀ + Σ_c (J_c J_cᵀ) ∘ K_c + noise, and with α = S⁻¹y, W = S⁻¹ − ααᵀ the derivative of
//! −log p = ½ yᵀS⁻¹y + ½ log|S| by anything is ½ Σ W ∘ ∂S. For a kernel that contracts to an N×N matrix,
//! G_c(i,j) = J_icᵀ W_ij J_jc, against ∂K_c. Kernels are the runtime's.

use std::cell::RefCell;

use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};
use poegp_runtime::gp::joint_kernel::JointKernel;

use crate::identification::parametric::state::{Linearised, PriorGroup, ROWS, prior_variance};
use crate::learning::elastic::hyperparameters::{DEFLECTION_UNIT, HyperLayout};
use crate::learning::elastic::inputs::{DistinctPayloads, Inputs};
use crate::learning::elastic::own_joint_curve::{Waves, gradient_by_order};
use crate::numeric::cholesky::CholeskyWorkspace;
use crate::numeric::lbfgs::Objective;
use poegp_protocol::limits::MAX_JOINTS;

/// The data of the likelihood.
#[derive(Debug)]
pub struct MarginalLikelihood<'a> {
    /// The linear model.
    pub linear: &'a Linearised,
    /// PriorGroup of each parameter.
    pub groups: &'a [PriorGroup],
    /// Inputs of the processes.
    pub inputs: &'a Inputs,
    /// s_d of every pair.
    pub similarities: &'a [Mat<f64>],
    /// sin kq and cos kq of every joint for the own-joint curve; empty when there is none.
    pub waves: &'a [Option<Waves>],
    /// What the hyperparameters mean.
    pub layout: HyperLayout,
    /// Whether there are processes of all joints.
    pub processes: bool,
}

/// Covariances of the joints' deflections, lower triangles, one matrix for each output.
#[derive(Debug)]
struct Covariances {
    /// K_c of the processes of all joints; empty when there are none.
    kernels: Vec<Mat<f64>>,
    /// The same with the own-joint curve; empty when there is none.
    with_curve: Vec<Mat<f64>>,
}

/// A factored S with what the solution needs.
pub struct Posterior {
    /// S⁻¹ y.
    pub alpha: Mat<f64>,
    /// The factor of S.
    pub factor: Llt<f64>,
    /// x̂.
    pub parameters: Vec<f64>,
    /// J_cᵀ α for each pose: weights of the processes in deflection units, N × n.
    pub weights: Mat<f64>,
}

impl MarginalLikelihood<'_> {
    fn poses(&self) -> usize {
        self.inputs.payloads.len()
    }

    /// K_c, lower triangle, in units of the processes.
    fn kernel_matrix(
        &self,
        kernel: &JointKernel<f64>,
        payloads: &DistinctPayloads,
        out: &mut Mat<f64>,
    ) {
        let unit = 1.0 / (DEFLECTION_UNIT * DEFLECTION_UNIT);
        let factors = payloads.factors(kernel);
        let mut s = [0.0; MAX_JOINTS];
        let s = &mut s[..self.inputs.kinds.len()];
        for j in 0..self.poses() {
            let columns: Vec<&[f64]> = self
                .similarities
                .iter()
                .map(|matrix| matrix.col_as_slice(j))
                .collect();
            let out = out.col_as_slice_mut(j);
            let factors = &factors[payloads.index[j]];
            for i in j..self.poses() {
                for (slot, column) in s.iter_mut().zip(&columns) {
                    *slot = column[i];
                }
                let factor = factors[payloads.index[i]];
                out[i] = unit * factor * kernel.joint_factor(s);
            }
        }
    }

    /// S, lower triangle, and K_c; beyond it nothing means anything.
    fn covariance(&self, h: &[f64], s: &mut Mat<f64>, out: &mut Covariances) {
        let rows = self.linear.y.nrows();
        let sd: Vec<f64> = self
            .groups
            .iter()
            .map(|group| prior_variance(*group, h).sqrt())
            .collect();
        let scaled = Mat::from_fn(rows, sd.len(), |i, j| self.linear.a[(i, j)] * sd[j]);
        faer::linalg::matmul::triangular::matmul(
            s.as_mut(),
            faer::linalg::matmul::triangular::BlockStructure::TriangularLower,
            faer::Accum::Replace,
            scaled.as_ref(),
            faer::linalg::matmul::triangular::BlockStructure::Rectangular,
            scaled.transpose(),
            faer::linalg::matmul::triangular::BlockStructure::Rectangular,
            1.0,
            faer::Par::Seq,
        );
        let payloads = DistinctPayloads::new(&self.inputs.payloads);
        for (kernel, matrix) in self.layout.kernels(h).iter().zip(&mut out.kernels) {
            self.kernel_matrix(kernel, &payloads, matrix);
        }
        if let Some(prior) = self.layout.curve_prior(h) {
            for (c, (total, waves)) in out.with_curve.iter_mut().zip(self.waves).enumerate() {
                match waves {
                    Some(waves) => prior.gram(waves, total),
                    None => total.fill(0.0),
                }
                if let Some(kernel) = out.kernels.get(c) {
                    *total += kernel;
                }
            }
            self.add_processes(&out.with_curve, s);
        } else {
            self.add_processes(&out.kernels, s);
        }
        for r in 0..rows {
            let h = h[usize::from(r % ROWS >= 3)];
            s[(r, r)] += h.exp() * self.linear.relative_noise(r, h).powi(2);
        }
    }

    /// Adds Σ_c (J_c J_cᵀ) ∘ K_c, all outputs in one pass over S.
    fn add_processes(&self, kernels: &[Mat<f64>], s: &mut Mat<f64>) {
        let columns = self.columns();
        for j in 0..self.poses() {
            let values: Vec<&[f64]> = kernels.iter().map(|k| k.col_as_slice(j)).collect();
            for r in ROWS * j..ROWS * (j + 1) {
                let blocks = s.col_as_slice_mut(r).as_chunks_mut::<ROWS>().0;
                for (i, block) in blocks.iter_mut().enumerate().skip(j) {
                    for (column, value) in columns.iter().zip(&values) {
                        let factor = value[i] * column[j][r % ROWS];
                        for (slot, moved) in block.iter_mut().zip(&column[i]) {
                            *slot += moved * factor;
                        }
                    }
                }
            }
        }
    }

    /// J_c in units of the processes, pose by pose; none when there are no processes.
    fn columns(&self) -> Vec<Vec<[f64; ROWS]>> {
        let jacobian = &self.linear.jacobian;
        let at = |k: usize, c: usize| -> [f64; ROWS] {
            std::array::from_fn(|b| DEFLECTION_UNIT * jacobian[(ROWS * k + b, c)])
        };
        (0..self.outputs())
            .map(|c| (0..self.poses()).map(|k| at(k, c)).collect())
            .collect()
    }

    /// Joints that deflect.
    fn outputs(&self) -> usize {
        if self.processes || self.layout.curve {
            self.layout.joints
        } else {
            0
        }
    }

    /// Room for K_c.
    fn no_kernels(&self) -> Covariances {
        let room = |is_needed: bool| {
            let outputs = if is_needed { self.layout.joints } else { 0 };
            let empty = |_| Mat::zeros(self.poses(), self.poses());
            (0..outputs).map(empty).collect()
        };
        Covariances {
            kernels: room(self.processes),
            with_curve: room(self.layout.curve),
        }
    }

    /// Solves for everything at fixed hyperparameters; `None` when S cannot be factored.
    pub fn solve(&self, h: &[f64]) -> Option<Posterior> {
        let rows = self.linear.y.nrows();
        let factor = {
            let mut s = Mat::zeros(rows, rows);
            self.covariance(h, &mut s, &mut self.no_kernels());
            s.llt(Side::Lower).ok()?
        };
        let alpha = factor.solve(&self.linear.y);
        let parameters = self.groups.iter().enumerate().map(|(i, group)| {
            let projected: f64 = (0..rows)
                .map(|r| self.linear.a[(r, i)] * alpha[(r, 0)])
                .sum();
            prior_variance(*group, h) * projected
        });
        let parameters = parameters.collect();
        let weights = Mat::from_fn(self.poses(), self.inputs.kinds.len(), |k, c| {
            let row = |b: usize| ROWS * k + b;
            (0..ROWS)
                .map(|b| self.linear.jacobian[(row(b), c)] * alpha[(row(b), 0)])
                .sum::<f64>()
        });
        Some(Posterior {
            alpha,
            factor,
            parameters,
            weights,
        })
    }
}

impl Objective for MarginalLikelihood<'_> {
    fn value_and_gradient(&self, h: &[f64]) -> (f64, Vec<f64>) {
        HyperparameterObjective::new(self).value_and_gradient(h)
    }
}

/// The same as the [`MarginalLikelihood`], in memory that is kept from one evaluation to the next.
#[derive(Debug)]
pub struct HyperparameterObjective<'a> {
    evidence: &'a MarginalLikelihood<'a>,
    workspace: RefCell<(CholeskyWorkspace, Covariances)>,
}

impl<'a> HyperparameterObjective<'a> {
    /// Of this evidence.
    pub fn new(evidence: &'a MarginalLikelihood<'a>) -> Self {
        let factor = CholeskyWorkspace::new(evidence.linear.y.nrows());
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
        factor.solve_in_place(alpha.as_mut());
        let fit: f64 = (0..rows).map(|r| y[(r, 0)] * alpha[(r, 0)]).sum();
        let value = 0.5 * fit + factor.half_log_determinant();
        if !value.is_finite() {
            return rejected;
        }
        let mut gradient = vec![0.0; h.len()];
        let inverse = factor.inverse();
        for r in 0..rows {
            let w = inverse[(r, r)] - alpha[(r, 0)] * alpha[(r, 0)];
            let i = usize::from(r % ROWS >= 3);
            gradient[i] += 0.5 * w * h[i].exp() * evidence.linear.common_share[r];
        }
        evidence.prior_gradient(h, inverse, &alpha, &mut gradient);
        evidence.kernel_gradients(h, &kernels.kernels, inverse, &alpha, &mut gradient);
        (value, gradient)
    }
}

impl MarginalLikelihood<'_> {
    fn prior_gradient(
        &self,
        h: &[f64],
        inverse: &Mat<f64>,
        alpha: &Mat<f64>,
        gradient: &mut [f64],
    ) {
        for (i, group) in [
            (2, PriorGroup::Frames),
            (3, PriorGroup::Links),
            (4, PriorGroup::Payload),
        ] {
            let columns: Vec<usize> = (0..self.groups.len())
                .filter(|j| self.groups[*j] == group)
                .collect();
            if columns.is_empty() {
                continue;
            }
            let part = Mat::from_fn(alpha.nrows(), columns.len(), |r, j| {
                self.linear.a[(r, columns[j])]
            });
            let solved = inverse * &part;
            let projected = part.transpose() * alpha;
            let mut trace = 0.0;
            for j in 0..columns.len() {
                trace += (0..part.nrows())
                    .map(|r| part[(r, j)] * solved[(r, j)])
                    .sum::<f64>();
                trace -= projected[(j, 0)] * projected[(j, 0)];
            }
            gradient[i] += 0.5 * prior_variance(group, h) * trace;
        }
    }

    /// ½ Σ W ∘ ∂S by what the kernels are made of, all outputs in one pass over S⁻¹.
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
        let mut outputs: Vec<KernelSums<'_>> = columns
            .iter()
            .enumerate()
            .map(|(c, column)| KernelSums {
                kernel: kernels.get(c).map(|kernel| (&natural[c], kernel)),
                pairs: curve
                    .as_ref()
                    .map(|_| Mat::zeros(self.poses(), self.poses())),
                column,
                projected: column.iter().enumerate().map(project).collect(),
                scales: [0.0; MAX_JOINTS],
                payload_scale: 0.0,
                constant: 0.0,
                slope: 0.0,
            })
            .collect();
        for j in 0..self.poses() {
            let blocks: [&[[f64; ROWS]]; ROWS] =
                std::array::from_fn(|b| inverse.col_as_slice(ROWS * j + b).as_chunks::<ROWS>().0);
            let similarities: Vec<&[f64]> = self
                .similarities
                .iter()
                .map(|m| m.col_as_slice(j))
                .collect();
            let other = self.inputs.payloads[j];
            for (i, payload) in self.inputs.payloads.iter().enumerate().skip(j) {
                let block: [[f64; ROWS]; ROWS] = blocks.map(|column| column[i]);
                let payloads = (*payload, other);
                for output in &mut outputs {
                    output.add((i, j), &block, &similarities, payloads);
                }
            }
        }
        for (c, sums) in outputs.iter().enumerate() {
            for (d, sum) in sums.scales.iter().take(self.layout.joints).enumerate() {
                let i = self.layout.scale(c, d);
                gradient[i] += sum * h[i].exp();
            }
            if let (Some(prior), Some(pairs), Some(waves)) = (
                &curve,
                &sums.pairs,
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
                gradient[i] += 0.5 * sums.payload_scale * h[i].exp();
                gradient[self.layout.amplitude(c, 1)] += sums.slope;
            }
        }
    }
}

/// What one output gathers over all pairs of poses.
struct KernelSums<'a> {
    /// Of the process of all joints.
    kernel: Option<(&'a JointKernel<f64>, &'a Mat<f64>)>,
    /// G_c(i, j), half of it on the diagonal, for the own-joint curve.
    pairs: Option<Mat<f64>>,
    /// J_c of each pose.
    column: &'a [[f64; ROWS]],
    /// J_cᵀ α of each pose.
    projected: Vec<f64>,
    scales: [f64; MAX_JOINTS],
    payload_scale: f64,
    constant: f64,
    slope: f64,
}

impl KernelSums<'_> {
    /// Adds the pair (i, j), `block` its part of S⁻¹ by columns.
    fn add(
        &mut self,
        (i, j): (usize, usize),
        block: &[[f64; ROWS]; ROWS],
        similarities: &[&[f64]],
        (m, other): (f64, f64),
    ) {
        let mut g = -self.projected[i] * self.projected[j];
        for (part, jb) in block.iter().zip(&self.column[j]) {
            let mut sum = 0.0;
            for (entry, moved) in part.iter().zip(&self.column[i]) {
                sum += moved * entry;
            }
            g += sum * jb;
        }
        let half = if i == j { 0.5 } else { 1.0 } * g;
        if let Some(pairs) = &mut self.pairs {
            pairs[(i, j)] = half;
        }
        let Some((natural, kernel)) = self.kernel else {
            return;
        };
        let weight = half * kernel[(i, j)];
        for (sum, s) in self.scales.iter_mut().zip(similarities) {
            *sum += weight * (s[i] - 1.0);
        }
        self.payload_scale -= weight * (m - other) * (m - other);
        let amplitude = natural.amplitude + natural.payload_amplitude * m * other;
        self.constant += weight * natural.amplitude / amplitude;
        self.slope += weight * natural.payload_amplitude * m * other / amplitude;
    }
}
