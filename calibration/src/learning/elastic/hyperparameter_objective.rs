//! −log p of the marginal likelihood and its gradient by the hyperparameters, in memory that one search keeps.

use std::cell::RefCell;

use poegp_protocol::limits::MAX_JOINTS;
use poegp_runtime::gp::joint_kernel::JointKernel;

use crate::identification::parametric::state::{PriorGroup, ROWS, prior_variance};
use crate::learning::elastic::likelihood::{Covariances, MarginalLikelihood};
use crate::learning::elastic::own_joint_curve::gradient_by_order;
use crate::numeric::cholesky::{CholeskyWorkspace, gram};
use crate::numeric::lbfgs::Objective;
use crate::numeric::matrix::{Mat, column, column_mut, columns, columns_mut, parts};
use crate::numeric::parallel::for_each;
use crate::numeric::product::{Transposed, product};
use crate::numeric::vectors::{inner, vectorised};

impl Objective for MarginalLikelihood<'_> {
    fn value_and_gradient(&self, h: &[f64]) -> (f64, Vec<f64>) {
        HyperparameterObjective::new(self).value_and_gradient(h)
    }
}

/// The same as the [`MarginalLikelihood`], in memory that is kept from one evaluation to the next.
#[derive(Debug)]
pub struct HyperparameterObjective<'a> {
    evidence: &'a MarginalLikelihood<'a>,
    workspace: RefCell<Workspace>,
}

/// Room for one evaluation.
#[derive(Debug)]
struct Workspace {
    factor: CholeskyWorkspace,
    covariances: Covariances,
    outputs: Vec<OutputWorkspace>,
}

/// Room for the gradient of one output's covariance.
#[derive(Debug)]
struct OutputWorkspace {
    /// L⁻¹ J_c, a column for each pose, with zeros above the pose's own rows.
    half: Mat<f64>,
    /// G_c(i, j) = J_icᵀ W_ij J_jc, half of it on the diagonal; lower triangle with zeros above it.
    pairs: Mat<f64>,
    /// What G_c adds to the gradient.
    sums: KernelSums,
}

impl<'a> HyperparameterObjective<'a> {
    /// Of this evidence.
    pub fn new(evidence: &'a MarginalLikelihood<'a>) -> Self {
        let (rows, poses) = (evidence.linear.y.nrows(), evidence.poses());
        let output = |_| OutputWorkspace {
            half: Mat::zeros(rows, poses),
            pairs: Mat::zeros(poses, poses),
            sums: KernelSums::default(),
        };
        Self {
            evidence,
            workspace: RefCell::new(Workspace {
                factor: CholeskyWorkspace::new(rows, evidence.threads),
                covariances: evidence.no_kernels(),
                outputs: (0..evidence.outputs()).map(output).collect(),
            }),
        }
    }
}

impl HyperparameterObjective<'_> {
    /// The value alone.
    pub fn value(&self, h: &[f64]) -> f64 {
        let workspace = &mut *self.workspace.borrow_mut();
        self.value_and_alpha(h, workspace)
            .map_or(f64::INFINITY, |(value, _)| value)
    }

    /// The value and S⁻¹ y, with the factor of S and the kernels in the workspace; `None` rejects `h`.
    fn value_and_alpha(&self, h: &[f64], workspace: &mut Workspace) -> Option<(f64, Mat<f64>)> {
        let Workspace {
            factor,
            covariances,
            ..
        } = workspace;
        self.evidence.covariance(h, &mut factor.matrix, covariances);
        factor.factor().ok()?;
        let y = &self.evidence.linear.y;
        let mut alpha = y.clone();
        factor.solve_in_place(&mut columns_mut(&mut alpha));
        let fit: f64 = (0..y.nrows()).map(|r| y[(r, 0)] * alpha[(r, 0)]).sum();
        let value = 0.5 * fit + factor.half_log_determinant();
        value.is_finite().then_some((value, alpha))
    }
}

impl Objective for HyperparameterObjective<'_> {
    fn value_and_gradient(&self, h: &[f64]) -> (f64, Vec<f64>) {
        let evidence = self.evidence;
        let workspace = &mut *self.workspace.borrow_mut();
        let mut gradient = vec![0.0; h.len()];
        let Some((value, alpha)) = self.value_and_alpha(h, workspace) else {
            return (f64::INFINITY, gradient);
        };
        let Workspace {
            factor,
            covariances,
            outputs,
        } = workspace;
        evidence.prior_gradient(h, factor, &alpha, &mut gradient);
        let half = factor.inverse_of_factor();
        evidence.noise_gradient(h, half, &alpha, &mut gradient);
        let kernels = &covariances.kernels;
        evidence.kernel_gradients(h, (half, &alpha), kernels, outputs, &mut gradient);
        (value, gradient)
    }
}

impl MarginalLikelihood<'_> {
    /// Adds what the variances of the groups of parameters do.
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

    /// Adds what the two variances of the noise do; `half` is L⁻¹.
    fn noise_gradient(&self, h: &[f64], half: &Mat<f64>, alpha: &Mat<f64>, gradient: &mut [f64]) {
        for r in 0..half.nrows() {
            let own = &column(half, r)[r..];
            let w = inner(own, own) - alpha[(r, 0)] * alpha[(r, 0)];
            let i = usize::from(r % ROWS >= 3);
            gradient[i] += 0.5 * w * libm::exp(h[i]) * self.linear.common_share[r];
        }
    }

    /// Adds ½ Σ W ∘ ∂S by what the kernels are made of; `half` is L⁻¹.
    fn kernel_gradients(
        &self,
        h: &[f64],
        (half, alpha): (&Mat<f64>, &Mat<f64>),
        kernels: &[Mat<f64>],
        outputs: &mut [OutputWorkspace],
        gradient: &mut [f64],
    ) {
        let (moved, natural) = (self.columns(), self.layout.kernels(h));
        let curve = self.layout.curve_prior(h);
        for_each(
            self.threads,
            outputs.iter_mut().enumerate().collect(),
            |(c, output)| {
                output.set_pairs(half, column(alpha, 0), &moved[c]);
                output.sums = KernelSums::default();
                if let Some((natural, kernel)) = natural.get(c).zip(kernels.get(c)) {
                    vectorised(
                        #[inline(always)]
                        || self.add_pairs(natural, kernel, output),
                    );
                }
                let waves = self.waves.get(c).and_then(Option::as_ref);
                if let Some((prior, waves)) = curve.as_ref().zip(waves) {
                    let by_order = gradient_by_order(&output.pairs, waves);
                    for (k, by_variance) in by_order.iter().enumerate() {
                        let (amplitude, spectrum) =
                            (prior.amplitude * by_variance, &prior.spectrum);
                        output.sums.curve[0] += amplitude * spectrum.variance[k / 2];
                        output.sums.curve[1] += amplitude * spectrum.slope[k / 2];
                    }
                }
            },
        );
        for (c, OutputWorkspace { sums, .. }) in outputs.iter().enumerate() {
            if self.processes {
                for (d, sum) in sums.scales.iter().take(self.layout.joints).enumerate() {
                    let i = self.layout.scale(c, d);
                    gradient[i] += sum * libm::exp(h[i]);
                }
                gradient[self.layout.amplitude(c, 0)] += sums.constant;
                if self.layout.payload {
                    let i = self.layout.scale(c, self.layout.joints);
                    gradient[i] += 0.5 * sums.payload_scale * libm::exp(h[i]);
                    gradient[self.layout.amplitude(c, 1)] += sums.slope;
                }
            }
            if curve.is_some() {
                gradient[self.layout.curve_amplitude()] += sums.curve[0];
                gradient[self.layout.curve_scale()] += sums.curve[1];
            }
        }
    }

    /// Adds all pairs of poses to the sums of an output with a process.
    #[inline(always)]
    fn add_pairs(
        &self,
        natural: &JointKernel<f64>,
        kernel: &Mat<f64>,
        output: &mut OutputWorkspace,
    ) {
        let (payloads, sums) = (&self.inputs.payloads, &mut output.sums);
        let mut weights = vec![0.0; self.poses()];
        for (j, other) in payloads.iter().enumerate() {
            let weights = &mut weights[j..];
            let (pairs, kernel) = (&column(&output.pairs, j)[j..], &column(kernel, j)[j..]);
            let mut total = 0.0;
            for ((weight, pair), kernel) in weights.iter_mut().zip(pairs).zip(kernel) {
                *weight = pair * kernel;
                total += *weight;
            }
            for (sum, similarities) in sums.scales.iter_mut().zip(self.similarities) {
                *sum += inner(weights, &column(similarities, j)[j..]) - total;
            }
            for (weight, m) in weights.iter().zip(&payloads[j..]) {
                sums.payload_scale -= weight * (m - other) * (m - other);
                let amplitude = natural.amplitude + natural.payload_amplitude * m * other;
                sums.constant += weight * natural.amplitude / amplitude;
                sums.slope += weight * natural.payload_amplitude * m * other / amplitude;
            }
        }
    }
}

impl OutputWorkspace {
    /// Sets the pairs: the product of L⁻¹ J_c with itself less that of J_cᵀ α, which takes a sixth of the time of S⁻¹. `half`
    /// is L⁻¹ and `moved` J_c of each pose.
    fn set_pairs(&mut self, half: &Mat<f64>, alpha: &[f64], moved: &[[f64; ROWS]]) {
        for (pose, moved) in moved.iter().enumerate() {
            let row = ROWS * pose;
            let own = &mut column_mut(&mut self.half, pose)[row..];
            let columns = std::array::from_fn(|b| &column(half, row + b)[row..]);
            vectorised(
                #[inline(always)]
                || add_up(&columns, moved, own),
            );
        }
        gram(&columns(&self.half), ROWS, &mut self.pairs, 1);
        let project = |(alpha, moved): (&[f64; ROWS], &[f64; ROWS])| -> f64 {
            alpha.iter().zip(moved).map(|(alpha, j)| alpha * j).sum()
        };
        let projected: Vec<f64> = alpha.as_chunks().0.iter().zip(moved).map(project).collect();
        for (j, own) in projected.iter().enumerate() {
            let (above, pairs) = column_mut(&mut self.pairs, j).split_at_mut(j);
            above.fill(0.0);
            for (pair, other) in pairs.iter_mut().zip(&projected[j..]) {
                *pair -= other * own;
            }
            pairs[0] *= 0.5;
        }
    }
}

/// to = Σ_b factor_b column_b.
#[inline(always)]
fn add_up(columns: &[&[f64]; ROWS], factors: &[f64; ROWS], to: &mut [f64]) {
    let n = to.len();
    let [a, b, c, d, e, f] = columns.map(|column| &column[..n]);
    for i in 0..n {
        to[i] = factors[0] * a[i]
            + factors[1] * b[i]
            + factors[2] * c[i]
            + factors[3] * d[i]
            + factors[4] * e[i]
            + factors[5] * f[i];
    }
}

/// What one output gathers over pairs of poses.
#[derive(Clone, Debug, Default)]
struct KernelSums {
    scales: [f64; MAX_JOINTS],
    payload_scale: f64,
    constant: f64,
    slope: f64,
    /// Amplitude and length scale of the own-joint curve.
    curve: [f64; 2],
}
