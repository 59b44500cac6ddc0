//! The marginal likelihood of the elastic model: y = A x + Σ_c J_c δ_c + noise with x and δ integrated out.
//!
//! S = Σ_g λ_g A_g A_gᵀ + Σ_c (J_c J_cᵀ) ∘ K_c + noise, and with α = S⁻¹y, W = S⁻¹ − ααᵀ the derivative of
//! −log p = ½ yᵀS⁻¹y + ½ log|S| by anything is ½ Σ W ∘ ∂S. For a kernel that contracts to an N×N matrix,
//! G_c(i,j) = J_icᵀ W_ij J_jc, against ∂K_c. Kernels are the runtime's.

use faer::linalg::solvers::{DenseSolveCore, Llt, Solve};
use faer::{Mat, Side};
use poegp_runtime::deflection::{Features, JointKernel, similarity};

use super::state::{Group, Linearised, ROWS};
use crate::minimize::Objective;
use poegp_protocol::JointKind;

/// One radian or metre of deflection in units of the processes: amplitudes are of order one.
pub const DEFLECTION_UNIT: f64 = 1e-4;

/// Hyperparameters as natural logarithms, one flat vector:
/// noise (position, orientation), priors (frames, links, payload), then for each output w_d…, w_m, a₀, a₁.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HyperLayout {
    /// Outputs: the joints.
    pub joints: usize,
    /// Whether the payload is an input.
    pub payload: bool,
    /// Whether all outputs have the length scales of the first.
    pub tied: bool,
}

/// Noise and prior hyperparameters before those of the kernels.
pub const COMMON: usize = 5;

impl HyperLayout {
    /// Number of hyperparameters.
    pub fn len(&self) -> usize {
        COMMON
            + self.scales_len() * if self.tied { 1 } else { self.joints }
            + self.amplitudes_len() * self.joints
    }

    /// Never empty.
    pub fn is_empty(&self) -> bool {
        false
    }

    fn scales_len(&self) -> usize {
        self.joints + usize::from(self.payload)
    }

    fn amplitudes_len(&self) -> usize {
        1 + usize::from(self.payload)
    }

    /// Index of w_d of output c (`d == joints`: w_m).
    pub fn scale(&self, c: usize, d: usize) -> usize {
        COMMON
            + if self.tied {
                d
            } else {
                c * self.scales_len() + d
            }
    }

    /// Index of a₀ (`i == 0`) or a₁ of output c.
    pub fn amplitude(&self, c: usize, i: usize) -> usize {
        let scales = self.scales_len() * if self.tied { 1 } else { self.joints };
        COMMON + scales + c * self.amplitudes_len() + i
    }

    /// Where the search begins, and within which bounds.
    pub fn start_and_bounds(&self, payload_unit: f64) -> (Vec<f64>, Vec<(f64, f64)>) {
        let mut start = vec![0.0; self.len()];
        let mut bounds = vec![(0.0, 0.0); self.len()];
        let mut set = |i: usize, value: f64, lower: f64, upper: f64| {
            start[i] = value.ln();
            bounds[i] = (lower.ln(), upper.ln());
        };
        for i in 0..2 {
            set(i, 0.5, 1e-4, 1e2);
        }
        for i in 2..COMMON {
            // Variances relative to the prior's.
            set(i, 1.0, 1e-4, 1e2);
        }
        let unit = payload_unit * payload_unit;
        for c in 0..self.joints {
            for d in 0..self.joints {
                set(self.scale(c, d), 0.3, 1e-3, 1e2);
            }
            set(self.amplitude(c, 0), 0.3, 1e-6, 1e4);
            if self.payload {
                set(
                    self.scale(c, self.joints),
                    0.3 / unit,
                    1e-3 / unit,
                    1e2 / unit,
                );
                set(self.amplitude(c, 1), 0.3 / unit, 1e-6 / unit, 1e4 / unit);
            }
        }
        (start, bounds)
    }

    /// The kernels, with amplitudes in rad² (m²).
    pub fn kernels(&self, h: &[f64]) -> Vec<JointKernel<f64>> {
        let unit = DEFLECTION_UNIT * DEFLECTION_UNIT;
        (0..self.joints)
            .map(|c| {
                let weights: Vec<f64> = (0..self.joints)
                    .map(|d| h[self.scale(c, d)].exp())
                    .collect();
                let (wm, a1) = if self.payload {
                    (
                        h[self.scale(c, self.joints)].exp(),
                        h[self.amplitude(c, 1)].exp(),
                    )
                } else {
                    (0.0, 0.0)
                };
                JointKernel::from_natural(
                    &weights,
                    wm,
                    unit * h[self.amplitude(c, 0)].exp(),
                    unit * a1,
                )
            })
            .collect()
    }
}

/// The inputs of the processes.
#[derive(Clone, Debug)]
pub struct Inputs {
    /// The joints of each pose.
    pub features: Vec<Features<f64>>,
    /// Payload of each pose in kg; 0 where there is none.
    pub payloads: Vec<f64>,
    /// Kinds of the joints.
    pub kinds: Vec<JointKind>,
}

impl Inputs {
    /// s_d of every pair, joint by joint: n matrices N×N, lower triangles.
    pub fn similarities(&self) -> Vec<Mat<f64>> {
        let n = self.features.len();
        (0..self.kinds.len())
            .map(|d| {
                Mat::from_fn(n, n, |i, j| {
                    if i >= j {
                        similarity(self.kinds[d], &self.features[i][d], &self.features[j][d])
                    } else {
                        0.0
                    }
                })
            })
            .collect()
    }
}

/// The data of the likelihood.
#[derive(Debug)]
pub struct Evidence<'a> {
    /// The linear model.
    pub linear: &'a Linearised,
    /// Group of each parameter.
    pub groups: &'a [Group],
    /// Inputs of the processes.
    pub inputs: &'a Inputs,
    /// s_d of every pair.
    pub similarities: &'a [Mat<f64>],
    /// What the hyperparameters mean.
    pub layout: HyperLayout,
    /// Whether there are processes at all.
    pub processes: bool,
}

/// A factored S with what the solution needs.
pub struct Solved {
    /// S⁻¹ y.
    pub alpha: Mat<f64>,
    /// The factor of S.
    pub factor: Llt<f64>,
    /// x̂.
    pub parameters: Vec<f64>,
    /// J_cᵀ α for each pose: weights of the processes in deflection units, N × n.
    pub weights: Mat<f64>,
}

/// Variance of the prior of a group, with what the evidence says.
pub fn prior_variance(group: Group, h: &[f64]) -> f64 {
    let base = group.prior_sd().powi(2);
    match group {
        Group::Frames => base * h[2].exp(),
        Group::Links => base * h[3].exp(),
        Group::Payload => base * h[4].exp(),
        Group::Ends | Group::Ripple => base,
    }
}

impl Evidence<'_> {
    fn poses(&self) -> usize {
        self.inputs.payloads.len()
    }

    /// K_c, lower triangle, in units of the processes.
    fn kernel_matrix(&self, kernel: &JointKernel<f64>) -> Mat<f64> {
        let n = self.poses();
        let unit = 1.0 / (DEFLECTION_UNIT * DEFLECTION_UNIT);
        let mut s = vec![0.0; self.inputs.kinds.len()];
        let mut out = Mat::zeros(n, n);
        for j in 0..n {
            for i in j..n {
                for (slot, matrix) in s.iter_mut().zip(self.similarities) {
                    *slot = matrix[(i, j)];
                }
                let factor =
                    kernel.payload_factor(self.inputs.payloads[i], self.inputs.payloads[j]);
                out[(i, j)] = unit * factor * kernel.joint_factor(&s);
            }
        }
        out
    }

    /// S, lower triangle, and K_c.
    fn covariance(&self, h: &[f64]) -> (Mat<f64>, Vec<Mat<f64>>) {
        let rows = self.linear.y.nrows();
        let scaled = Mat::from_fn(rows, self.groups.len(), |i, j| {
            self.linear.a[(i, j)] * prior_variance(self.groups[j], h).sqrt()
        });
        let mut s = Mat::zeros(rows, rows);
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
        let kernels: Vec<Mat<f64>> = if self.processes {
            self.layout
                .kernels(h)
                .iter()
                .map(|k| self.kernel_matrix(k))
                .collect()
        } else {
            Vec::new()
        };
        let jac = &self.linear.jacobian;
        for (c, kernel) in kernels.iter().enumerate() {
            let column: Vec<f64> = (0..rows).map(|r| DEFLECTION_UNIT * jac[(r, c)]).collect();
            for j in 0..self.poses() {
                for b in 0..ROWS {
                    let jb = column[ROWS * j + b];
                    for i in j..self.poses() {
                        let factor = kernel[(i, j)] * jb;
                        for a in 0..ROWS {
                            s[(ROWS * i + a, ROWS * j + b)] += column[ROWS * i + a] * factor;
                        }
                    }
                }
            }
        }
        for r in 0..rows {
            let h = h[usize::from(r % ROWS >= 3)];
            s[(r, r)] += h.exp() * self.linear.relative_noise(r, h).powi(2);
        }
        (s, kernels)
    }

    /// Solves for everything at fixed hyperparameters; `None` when S cannot be factored.
    pub fn solve(&self, h: &[f64]) -> Option<Solved> {
        let (s, _) = self.covariance(h);
        let factor = s.llt(Side::Lower).ok()?;
        let alpha = factor.solve(&self.linear.y);
        let rows = self.linear.y.nrows();
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
        Some(Solved {
            alpha,
            factor,
            parameters,
            weights,
        })
    }
}

impl Objective for Evidence<'_> {
    fn value_and_gradient(&self, h: &[f64]) -> (f64, Vec<f64>) {
        let (s, kernels) = self.covariance(h);
        let rows = s.nrows();
        let rejected = (f64::INFINITY, vec![0.0; h.len()]);
        let Ok(factor) = s.llt(Side::Lower) else {
            return rejected;
        };
        let y = &self.linear.y;
        let alpha = factor.solve(y);
        let fit: f64 = (0..rows).map(|r| y[(r, 0)] * alpha[(r, 0)]).sum();
        let half_log_determinant: f64 = (0..rows).map(|r| factor.L()[(r, r)].ln()).sum();
        let value = 0.5 * fit + half_log_determinant;
        if !value.is_finite() {
            return rejected;
        }
        let mut gradient = vec![0.0; h.len()];
        let inverse = factor.inverse();
        for r in 0..rows {
            let w = inverse[(r, r)] - alpha[(r, 0)] * alpha[(r, 0)];
            let i = usize::from(r % ROWS >= 3);
            gradient[i] += 0.5 * w * h[i].exp() * self.linear.common_share[r];
        }
        self.prior_gradient(h, &inverse, &alpha, &mut gradient);
        let natural = self.layout.kernels(h);
        for (c, kernel) in kernels.iter().enumerate() {
            self.kernel_gradient(h, c, &natural[c], kernel, &inverse, &alpha, &mut gradient);
        }
        (value, gradient)
    }
}

impl Evidence<'_> {
    fn prior_gradient(
        &self,
        h: &[f64],
        inverse: &Mat<f64>,
        alpha: &Mat<f64>,
        gradient: &mut [f64],
    ) {
        for (i, group) in [(2, Group::Frames), (3, Group::Links), (4, Group::Payload)] {
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

    #[allow(clippy::too_many_arguments)]
    fn kernel_gradient(
        &self,
        h: &[f64],
        c: usize,
        natural: &JointKernel<f64>,
        kernel: &Mat<f64>,
        inverse: &Mat<f64>,
        alpha: &Mat<f64>,
        gradient: &mut [f64],
    ) {
        let n = self.inputs.kinds.len();
        let rows = alpha.nrows();
        let column: Vec<f64> = (0..rows)
            .map(|r| DEFLECTION_UNIT * self.linear.jacobian[(r, c)])
            .collect();
        let projected: Vec<f64> = (0..self.poses())
            .map(|k| {
                (0..ROWS)
                    .map(|b| column[ROWS * k + b] * alpha[(ROWS * k + b, 0)])
                    .sum()
            })
            .collect();
        let mut scales = vec![0.0; n];
        let (mut payload_scale, mut constant, mut slope) = (0.0, 0.0, 0.0);
        for j in 0..self.poses() {
            for i in j..self.poses() {
                let mut g = -projected[i] * projected[j];
                for b in 0..ROWS {
                    let jb = column[ROWS * j + b];
                    let mut sum = 0.0;
                    for a in 0..ROWS {
                        sum += column[ROWS * i + a] * inverse[(ROWS * i + a, ROWS * j + b)];
                    }
                    g += sum * jb;
                }
                let weight = if i == j { 0.5 } else { 1.0 } * g * kernel[(i, j)];
                for (sum, s) in scales.iter_mut().zip(self.similarities) {
                    *sum += weight * (s[(i, j)] - 1.0);
                }
                let (m, other) = (self.inputs.payloads[i], self.inputs.payloads[j]);
                payload_scale -= weight * (m - other) * (m - other);
                let amplitude = natural.amplitude + natural.payload_amplitude * m * other;
                constant += weight * natural.amplitude / amplitude;
                slope += weight * natural.payload_amplitude * m * other / amplitude;
            }
        }
        for (d, sum) in scales.iter().enumerate() {
            let i = self.layout.scale(c, d);
            gradient[i] += sum * h[i].exp();
        }
        gradient[self.layout.amplitude(c, 0)] += constant;
        if self.layout.payload {
            let i = self.layout.scale(c, n);
            gradient[i] += 0.5 * payload_scale * h[i].exp();
            gradient[self.layout.amplitude(c, 1)] += slope;
        }
    }
}
