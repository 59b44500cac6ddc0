//! Which poses tell most: the prior of the elastic model, and the poses that leave least of it.
//!
//! Before anything is measured the elastic model is a Gaussian prior over frames, gravity terms and joint-space processes
//! (`elastic/state.rs`, `elastic/likelihood.rs`; kernels are the runtime's). A measurement of a candidate pose takes a part
//! of that prior away, whatever it will read: which poses are best can be computed beforehand. Poses are taken one after
//! the other, each the one that leaves least: of the parameters' entropy (D-optimal, log-determinant), or of the variance
//! of the position at reference poses all over the planned region (what held-out errors are made of).

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use nalgebra::{SMatrix, SVector};
use poegp_runtime::deflection::similarity;
use poegp_runtime::poe::Poe;

use crate::calibration::frames::Sample;
use crate::calibration::noise::Scales;
use crate::elastic::likelihood::{HyperLayout, prior_variance};
use crate::elastic::state::{Layout, ROWS, State};

/// The prior over candidates and reference poses, as far as the chosen poses have left it.
pub struct Belief {
    /// Covariance of the rows of candidates, then of reference positions, with the rows of candidates.
    covariance: Mat<f64>,
    candidates: usize,
}

/// Rows of a reference pose: its position.
const POSITION: usize = 3;

impl Belief {
    /// Before the first measurement.
    pub fn new(
        chain: &Poe<f64>,
        coupling: Option<&Vec<Vec<f64>>>,
        gravity: nalgebra::Vector3<f64>,
        candidates: &[Sample],
        reference: &[Sample],
        noise: Scales,
        processes: bool,
    ) -> Self {
        let n = chain.kinds().len();
        let payloads: Vec<f64> = candidates.iter().map(|s| s.payload_kg.unwrap_or(0.0)).collect();
        let varies = payloads.iter().any(|m| *m != payloads[0]);
        let layout = Layout {
            joints: n,
            tools: 1,
            gravity: true,
            payload: varies,
            ripple: Vec::new(),
        };
        let groups = layout.groups();
        let hyper = HyperLayout {
            joints: n,
            payload: varies,
            tied: false,
        };
        let mean_payload = (payloads.iter().sum::<f64>() / payloads.len() as f64).max(1e-3);
        let h = hyper.start_and_bounds(mean_payload).0;
        let kernels = hyper.kernels(&h);
        let state = State::new(chain, vec![chain.frames()[n]], coupling.cloned(), layout, gravity);
        let all: Vec<Sample> = candidates.iter().chain(reference).cloned().collect();
        let linear = state.linearise(&all, noise);
        let columns = ROWS * candidates.len();
        let rows = columns + POSITION * reference.len();
        // The row of the linear model that a row here is.
        let source = |row: usize| {
            if row < columns {
                row
            } else {
                let k = row - columns;
                columns + ROWS * (k / POSITION) + k % POSITION
            }
        };
        let sd: Vec<f64> = groups.iter().map(|g| prior_variance(*g, &h).sqrt()).collect();
        let whitened = Mat::from_fn(rows, groups.len(), |i, j| linear.a[(source(i), j)] * sd[j]);
        let mut covariance = Mat::zeros(rows, columns);
        matmul(
            covariance.as_mut(),
            Accum::Replace,
            whitened.as_ref(),
            whitened.as_ref().subrows(0, columns).transpose(),
            1.0,
            Par::Seq,
        );
        if processes {
            let features: Vec<_> = all.iter().map(|s| state.features(s)).collect();
            let kinds = chain.kinds();
            for j in 0..candidates.len() {
                for i in 0..all.len() {
                    let mut s = [0.0; poegp_protocol::limits::MAX_JOINTS];
                    for d in 0..n {
                        s[d] = similarity(kinds[d], &features[i][d], &features[j][d]);
                    }
                    let (mi, mj) = (
                        all[i].payload_kg.unwrap_or(0.0),
                        all[j].payload_kg.unwrap_or(0.0),
                    );
                    let (first, count) = if i < candidates.len() {
                        (ROWS * i, ROWS)
                    } else {
                        (columns + POSITION * (i - candidates.len()), POSITION)
                    };
                    for (c, kernel) in kernels.iter().enumerate() {
                        let k = kernel.joint_factor(&s) * kernel.payload_factor(mi, mj);
                        for b in 0..ROWS {
                            let right = k * linear.jacobian[(ROWS * j + b, c)];
                            for a in 0..count {
                                covariance[(first + a, ROWS * j + b)] +=
                                    linear.jacobian[(ROWS * i + a, c)] * right;
                            }
                        }
                    }
                }
            }
        }
        Self {
            covariance,
            candidates: candidates.len(),
        }
    }

    /// Covariance of a measurement of candidate `i`, noise included, factored.
    fn factor(&self, i: usize) -> SMatrix<f64, ROWS, ROWS> {
        let mut s = SMatrix::<f64, ROWS, ROWS>::from_fn(|a, b| {
            self.covariance[(ROWS * i + a, ROWS * i + b)]
        });
        for a in 0..ROWS {
            s[(a, a)] += 1.0;
        }
        s.cholesky().map_or_else(SMatrix::identity, |c| c.l())
    }

    /// log det of it: what is learnt, in nats, twice.
    pub fn information(&self, i: usize) -> f64 {
        let l = self.factor(i);
        (0..ROWS).map(|a| 2.0 * l[(a, a)].ln()).sum()
    }

    /// By how much candidate `i` lowers the variance of the reference positions, summed.
    pub fn reduction(&self, i: usize) -> f64 {
        let l = self.factor(i);
        let first = ROWS * self.candidates;
        let mut sum = 0.0;
        for row in first..self.covariance.nrows() {
            let mut x = SVector::<f64, ROWS>::from_fn(|b, _| self.covariance[(row, ROWS * i + b)]);
            l.solve_lower_triangular_mut(&mut x);
            sum += x.norm_squared();
        }
        sum
    }

    /// x
    pub fn variance(&self, row: usize) -> f64 { self.covariance[(row, row)] }

    /// Measures candidate `i`.
    pub fn measure(&mut self, i: usize) {
        let l = self.factor(i);
        let mut u = Mat::<f64>::zeros(self.covariance.nrows(), ROWS);
        for row in 0..u.nrows() {
            let mut x = SVector::<f64, ROWS>::from_fn(|b, _| self.covariance[(row, ROWS * i + b)]);
            l.solve_lower_triangular_mut(&mut x);
            for b in 0..ROWS {
                u[(row, b)] = x[b];
            }
        }
        let columns = ROWS * self.candidates;
        matmul(
            self.covariance.as_mut(),
            Accum::Add,
            u.as_ref(),
            u.as_ref().subrows(0, columns).transpose(),
            -1.0,
            Par::Seq,
        );
    }
}
