//! The marginal likelihood of the elastic model: y = A x + Σ_c J_c δ_c + noise with x and δ integrated out.
//!
//! S = Σ_g λ_g A_g A_gᵀ + Σ_c (J_c J_cᵀ) ∘ K_c + noise. With α = S⁻¹y and W = S⁻¹ − ααᵀ, the derivative of
//! −log p = ½ yᵀS⁻¹y + ½ log|S| by any hyperparameter is ½ Σ W ∘ ∂S. For a kernel, W contracts to the N×N matrix
//! G_c(i,j) = J_icᵀ W_ij J_jc, to be multiplied with ∂K_c (`hyperparameter_objective.rs`). The kernels are the runtime's.

use poegp_runtime::gp::joint_kernel::JointKernel;

use crate::identification::parametric::state::{Linearised, PriorGroup, ROWS, prior_variance};
use crate::learning::elastic::hyperparameters::{DEFLECTION_UNIT, HyperLayout};
use crate::learning::elastic::inputs::{DistinctPayloads, Inputs};
use crate::learning::elastic::own_joint_curve::Waves;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::{Mat, column, columns, parts, rows, split_rows};
use crate::numeric::parallel::for_each;
use crate::numeric::product::{Become, Operand, multiply};
use crate::numeric::vectors::vectorised;

/// The data from which the marginal likelihood is computed.
#[derive(Debug)]
pub struct MarginalLikelihood<'a> {
    /// Linearised model.
    pub linear: &'a Linearised,
    /// Prior group of each parameter.
    pub groups: &'a [PriorGroup],
    /// Inputs of the processes.
    pub inputs: &'a Inputs,
    /// Similarity s_d of every pair of poses, one matrix for each joint.
    pub similarities: &'a [Mat<f64>],
    /// sin kq and cos kq of every joint for the own-joint curve; empty when there is none.
    pub waves: &'a [Option<Waves>],
    /// Layout of the hyperparameters.
    pub layout: HyperLayout,
    /// Whether there are processes of all joints.
    pub processes: bool,
    /// Number of threads; no result depends on it.
    pub threads: usize,
}

/// Number of poses whose columns of a matrix one thread works on at a time.
pub(super) const POSES_TOGETHER: usize = 16;

/// Covariances of the joints' deflections, lower triangles, one matrix for each output.
#[derive(Debug)]
pub(super) struct Covariances {
    /// K_c of the processes of all joints; empty when there are none.
    pub(super) kernels: Vec<Mat<f64>>,
    /// K_c plus the covariance of the own-joint curve; empty when there is no curve.
    with_curve: Vec<Mat<f64>>,
}

/// The factored S and the solution at fixed hyperparameters.
pub struct Posterior {
    /// Solution α = S⁻¹ y.
    pub alpha: Mat<f64>,
    /// Cholesky factor of S.
    pub factor: Factor,
    /// Estimated parameters x̂.
    pub parameters: Vec<f64>,
    /// Weights of the processes J_cᵀ α for each pose and joint, in deflection units, N × n.
    pub weights: Mat<f64>,
}

impl MarginalLikelihood<'_> {
    pub(super) fn poses(&self) -> usize {
        self.inputs.payloads.len()
    }

    /// Computes some columns of K_c (lower triangle) from `first` on, in squared units of the processes.
    #[inline(always)]
    fn kernel_columns(
        &self,
        kernel: &JointKernel<f64>,
        payloads: &DistinctPayloads,
        first: usize,
        out: &mut [&mut [f64]],
    ) {
        let unit = 1.0 / (DEFLECTION_UNIT * DEFLECTION_UNIT);
        let factors = payloads.factors(kernel);
        for (j, out) in (first..).zip(out) {
            let similarities = self
                .similarities
                .iter()
                .map(|matrix| &column(matrix, j)[j..]);
            let out = &mut out[j..];
            kernel.joint_factors(similarities, out);
            let factors = &factors[payloads.index[j]];
            for (slot, payload) in out.iter_mut().zip(&payloads.index[j..]) {
                *slot *= unit * factors[*payload];
            }
        }
    }

    /// Computes the lower triangles of S and K_c; entries beyond them have no meaning.
    pub(super) fn covariance(&self, h: &[f64], s: &mut Mat<f64>, out: &mut Covariances) {
        let sd: Vec<f64> = self
            .groups
            .iter()
            .map(|group| prior_variance(*group, h).sqrt())
            .collect();
        let count = self.linear.y.nrows();
        let scaled = Mat::from_fn(count, sd.len(), |i, j| self.linear.a[(i, j)] * sd[j]);
        let payloads = DistinctPayloads::new(&self.inputs.payloads);
        let natural = self.layout.kernels(h);
        let mut tasks = Vec::new();
        for (c, matrix) in out.kernels.iter_mut().enumerate() {
            let columns = parts(matrix, POSES_TOGETHER).into_iter();
            tasks.extend(columns.map(|(first, part)| (c, first, part)));
        }
        for_each(self.threads, tasks, |(c, first, mut part)| {
            vectorised(
                #[inline(always)]
                || self.kernel_columns(&natural[c], &payloads, first, &mut part),
            );
        });
        if let Some(prior) = self.layout.curve_prior(h) {
            let kernels = &out.kernels;
            let tasks = out.with_curve.iter_mut().zip(self.waves).enumerate();
            for_each(self.threads, tasks.collect(), |(c, (total, waves))| {
                match waves {
                    Some(waves) => prior.gram(waves, total),
                    None => total.fill(0.0),
                }
                if let Some(kernel) = kernels.get(c) {
                    *total += kernel;
                }
            });
        }
        let kernels = match self.layout.curve {
            true => &out.with_curve,
            false => &out.kernels,
        };
        let moved = self.columns();
        let scaled = columns(&scaled);
        let noise = [libm::exp(h[0]), libm::exp(h[1])];
        for_each(
            self.threads,
            parts(s, ROWS * POSES_TOGETHER),
            |(first, part)| {
                let mut part = split_rows(part, first).1;
                let left = Operand::new(rows(&scaled, first..count));
                let right = Operand::new(rows(&scaled, first..first + part.len()));
                multiply(&mut part, Become::Product, &left, &right.transposed());
                vectorised(
                    #[inline(always)]
                    || self.add_processes(kernels, &moved, first, &mut part),
                );
                for (column, entries) in part.iter_mut().enumerate() {
                    let r = first + column;
                    let kind = usize::from(r % ROWS >= 3);
                    entries[column] += noise[kind] * self.linear.relative_noise(r, h[kind]).powi(2);
                }
            },
        );
    }

    /// Adds Σ_c (J_c J_cᵀ) ∘ K_c to some columns of S from `first` on, from that row downwards, all outputs in one pass.
    #[inline(always)]
    fn add_processes(
        &self,
        kernels: &[Mat<f64>],
        moved: &[Vec<[f64; ROWS]>],
        first: usize,
        s: &mut [&mut [f64]],
    ) {
        for (r, entries) in (first..).zip(s) {
            let j = r / ROWS;
            let blocks = &mut entries.as_chunks_mut::<ROWS>().0[j - first / ROWS..];
            for (kernel, moved) in kernels.iter().zip(moved) {
                let own = moved[j][r % ROWS];
                let kernel = &column(kernel, j)[j..];
                for ((block, kernel), moved) in blocks.iter_mut().zip(kernel).zip(&moved[j..]) {
                    let factor = kernel * own;
                    for (slot, moved) in block.iter_mut().zip(moved) {
                        *slot += moved * factor;
                    }
                }
            }
        }
    }

    /// Returns J_c in units of the processes for each joint and pose; empty when there are no processes.
    pub(super) fn columns(&self) -> Vec<Vec<[f64; ROWS]>> {
        let jacobian = &self.linear.jacobian;
        let at = |k: usize, c: usize| -> [f64; ROWS] {
            std::array::from_fn(|b| DEFLECTION_UNIT * jacobian[(ROWS * k + b, c)])
        };
        (0..self.outputs())
            .map(|c| (0..self.poses()).map(|k| at(k, c)).collect())
            .collect()
    }

    /// Returns the number of joints that deflect.
    fn outputs(&self) -> usize {
        if self.processes || self.layout.curve {
            self.layout.joints
        } else {
            0
        }
    }

    /// Allocates zero matrices for K_c.
    pub(super) fn no_kernels(&self) -> Covariances {
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

    /// Solves for parameters and processes at fixed hyperparameters; `None` when S cannot be factored.
    pub fn solve(&self, h: &[f64]) -> Option<Posterior> {
        let rows = self.linear.y.nrows();
        let mut s = Mat::zeros(rows, rows);
        self.covariance(h, &mut s, &mut self.no_kernels());
        let factor = Factor::new(s, self.threads).ok()?;
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
