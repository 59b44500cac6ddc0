//! The marginal likelihood of the elastic model: y = A x + Σ_c J_c δ_c + noise with x and δ integrated out.
//!
//! S = Σ_g λ_g A_g A_gᵀ + Σ_c (J_c J_cᵀ) ∘ K_c + noise, and with α = S⁻¹y, W = S⁻¹ − ααᵀ the derivative of
//! −log p = ½ yᵀS⁻¹y + ½ log|S| by anything is ½ Σ W ∘ ∂S. For a kernel that contracts to an N×N matrix,
//! G_c(i,j) = J_icᵀ W_ij J_jc, against ∂K_c (`hyperparameter_objective.rs`). Kernels are the runtime's.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, Par};
use poegp_runtime::gp::joint_kernel::JointKernel;

use crate::identification::parametric::state::{Linearised, PriorGroup, ROWS, prior_variance};
use crate::learning::elastic::hyperparameters::{DEFLECTION_UNIT, HyperLayout};
use crate::learning::elastic::inputs::{DistinctPayloads, Inputs};
use crate::learning::elastic::own_joint_curve::Waves;
use crate::numeric::cholesky::{Factor, columns_of};
use crate::numeric::parallel::for_each;
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
    /// Threads that work on it; no result depends on it.
    pub threads: usize,
}

/// Poses whose columns of a matrix one thread works on at a time.
pub(super) const POSES_TOGETHER: usize = 16;

/// Covariances of the joints' deflections, lower triangles, one matrix for each output.
#[derive(Debug)]
pub(super) struct Covariances {
    /// K_c of the processes of all joints; empty when there are none.
    pub(super) kernels: Vec<Mat<f64>>,
    /// The same with the own-joint curve; empty when there is none.
    with_curve: Vec<Mat<f64>>,
}

/// A factored S with what the solution needs.
pub struct Posterior {
    /// S⁻¹ y.
    pub alpha: Mat<f64>,
    /// The factor of S.
    pub factor: Factor,
    /// x̂.
    pub parameters: Vec<f64>,
    /// J_cᵀ α for each pose: weights of the processes in deflection units, N × n.
    pub weights: Mat<f64>,
}

impl MarginalLikelihood<'_> {
    pub(super) fn poses(&self) -> usize {
        self.inputs.payloads.len()
    }

    /// Some columns of K_c from `first` on, lower triangle, in units of the processes.
    fn kernel_columns(
        &self,
        kernel: &JointKernel<f64>,
        payloads: &DistinctPayloads,
        first: usize,
        mut out: MatMut<'_, f64>,
    ) {
        let unit = 1.0 / (DEFLECTION_UNIT * DEFLECTION_UNIT);
        let factors = payloads.factors(kernel);
        let mut s = [0.0; MAX_JOINTS];
        let s = &mut s[..self.inputs.kinds.len()];
        for (j, out) in (first..).zip(columns(&mut out)) {
            let columns: Vec<&[f64]> = self
                .similarities
                .iter()
                .map(|matrix| matrix.col_as_slice(j))
                .collect();
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
    pub(super) fn covariance(&self, h: &[f64], s: &mut Mat<f64>, out: &mut Covariances) {
        let sd: Vec<f64> = self
            .groups
            .iter()
            .map(|group| prior_variance(*group, h).sqrt())
            .collect();
        let rows = self.linear.y.nrows();
        let scaled = Mat::from_fn(rows, sd.len(), |i, j| self.linear.a[(i, j)] * sd[j]);
        let payloads = DistinctPayloads::new(&self.inputs.payloads);
        let natural = self.layout.kernels(h);
        let mut tasks = Vec::new();
        for (c, matrix) in out.kernels.iter_mut().enumerate() {
            let columns = columns_of(matrix.as_mut(), POSES_TOGETHER).into_iter();
            tasks.extend(columns.map(|(first, part)| (c, first, part)));
        }
        for_each(self.threads, tasks, |(c, first, part)| {
            self.kernel_columns(&natural[c], &payloads, first, part);
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
        let tasks = columns_of(s.as_mut(), ROWS * POSES_TOGETHER);
        for_each(self.threads, tasks, |(first, mut part)| {
            let (left, right) = (
                scaled.subrows(first, rows - first),
                scaled.subrows(first, part.ncols()),
            );
            let below = part.as_mut().subrows_mut(first, rows - first);
            matmul(
                below,
                Accum::Replace,
                left,
                right.transpose(),
                1.0,
                Par::Seq,
            );
            self.add_processes(kernels, &moved, first, part.as_mut());
            for column in 0..part.ncols() {
                let r = first + column;
                let h = h[usize::from(r % ROWS >= 3)];
                part[(r, column)] += h.exp() * self.linear.relative_noise(r, h).powi(2);
            }
        });
    }

    /// Adds Σ_c (J_c J_cᵀ) ∘ K_c to some columns of S from `first` on, all outputs in one pass.
    fn add_processes(
        &self,
        kernels: &[Mat<f64>],
        moved: &[Vec<[f64; ROWS]>],
        first: usize,
        mut s: MatMut<'_, f64>,
    ) {
        for (r, column) in (first..).zip(columns(&mut s)) {
            let j = r / ROWS;
            let blocks = column.as_chunks_mut::<ROWS>().0;
            for (i, block) in blocks.iter_mut().enumerate().skip(j) {
                for (kernel, moved) in kernels.iter().zip(moved) {
                    let factor = kernel.col_as_slice(j)[i] * moved[j][r % ROWS];
                    for (slot, moved) in block.iter_mut().zip(&moved[i]) {
                        *slot += moved * factor;
                    }
                }
            }
        }
    }

    /// J_c in units of the processes, pose by pose; none when there are no processes.
    pub(super) fn columns(&self) -> Vec<Vec<[f64; ROWS]>> {
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

    /// Solves for everything at fixed hyperparameters; `None` when S cannot be factored.
    pub fn solve(&self, h: &[f64]) -> Option<Posterior> {
        let rows = self.linear.y.nrows();
        let mut s = Mat::zeros(rows, rows);
        self.covariance(h, &mut s, &mut self.no_kernels());
        let factor = Factor::new(s, self.threads).ok()?;
        let alpha = factor.solve(self.linear.y.as_ref());
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

/// The columns of a part of a matrix, each as a slice.
fn columns<'a>(part: &'a mut MatMut<'_, f64>) -> impl Iterator<Item = &'a mut [f64]> {
    part.as_mut().col_iter_mut().map(|column| {
        let column = column.try_as_col_major_mut();
        column.map_or(&mut [][..], |column| column.as_slice_mut())
    })
}
