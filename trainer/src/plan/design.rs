//! Which poses tell most about the parameters: exchange of poses under the prior of the elastic model.
//!
//! Before anything is measured the parameters of the elastic model (frames, gravity terms of links and payload) are a
//! Gaussian prior (`elastic/state.rs`). A pose with the whitened Jacobian B (rows by the noise, columns by the prior)
//! turns the information M into M + BᵀB, whatever will be read there, so that plans can be compared before anyone
//! measures: by log|M| (D-optimal), or by the variance of the position that M leaves, on average over the candidates
//! (I-optimal). From a plan to begin with, every pose in turn is exchanged for the candidate of the same payload that
//! is best with all the others, until a round changes nothing (Fedorov, "Theory of Optimal Experiments", 1972).

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::{DenseSolveCore, Llt};
use faer::{Accum, Mat, Par, Side};
use nalgebra::{SMatrix, Vector3};
use poegp_runtime::poe::Poe;

use crate::calibration::frames::Sample;
use crate::calibration::noise::Scales;
use crate::elastic::state::{Layout, ROWS, State};

type Block = SMatrix<f64, ROWS, ROWS>;
/// Rows of a pose that are its position.
const POSITION: usize = 3;

/// What a plan is good at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Criterion {
    /// Largest log|M|.
    Parameters,
    /// Smallest mean variance of the position.
    Prediction,
}

/// Candidates as the exchange sees them.
pub struct Design {
    /// Whitened Jacobians, ROWS a candidate.
    rows: Mat<f64>,
    /// Σ of the position rows' outer products, divided by their number.
    weight: Mat<f64>,
    /// First candidate of each payload, and the number of all.
    payload_starts: Vec<usize>,
}

impl Design {
    /// Of candidates, ordered by payload; `chain` leads to the target.
    pub fn new(
        chain: &Poe<f64>,
        coupling: Option<&Vec<Vec<f64>>>,
        gravity: Vector3<f64>,
        candidates: &[Sample],
        noise: Scales,
    ) -> Self {
        let payload = |s: &Sample| s.payload_kg.unwrap_or(0.0);
        let mut payload_starts: Vec<usize> = (0..candidates.len())
            .filter(|i| *i == 0 || payload(&candidates[*i]) != payload(&candidates[i - 1]))
            .collect();
        payload_starts.push(candidates.len());
        let n = chain.kinds().len();
        let layout = Layout {
            joints: n,
            tools: 1,
            gravity: true,
            payload: payload_starts.len() > 2,
            ripple: Vec::new(),
        };
        let sd: Vec<f64> = layout.groups().iter().map(|g| g.prior_sd()).collect();
        let tool = vec![chain.frames()[n]];
        let state = State::new(chain, tool, coupling.cloned(), layout, gravity);
        let mut rows = state.linearise(candidates, noise).a;
        for (j, sd) in sd.iter().enumerate() {
            for i in 0..rows.nrows() {
                rows[(i, j)] *= sd;
            }
        }
        let p = rows.ncols();
        let positions = Mat::from_fn(POSITION * candidates.len(), p, |i, j| {
            rows[(ROWS * (i / POSITION) + i % POSITION, j)]
        });
        let mut weight = Mat::zeros(p, p);
        let share = 1.0 / candidates.len() as f64;
        matmul(
            weight.as_mut(),
            Accum::Replace,
            positions.as_ref().transpose(),
            positions.as_ref(),
            share,
            Par::Seq,
        );
        Self {
            rows,
            weight,
            payload_starts,
        }
    }

    fn block(&self, i: usize) -> faer::MatRef<'_, f64> {
        self.rows.as_ref().subrows(ROWS * i, ROWS)
    }

    /// M⁻¹ of some poses.
    fn covariance(&self, chosen: &[usize]) -> Option<Mat<f64>> {
        let p = self.rows.ncols();
        let mut information = Mat::<f64>::identity(p, p);
        for i in chosen {
            let b = self.block(*i);
            matmul(information.as_mut(), Accum::Add, b.transpose(), b, 1.0, Par::Seq);
        }
        Some(Llt::new(information.as_ref(), Side::Lower).ok()?.inverse())
    }

    /// Mean variance of the position, in units of the noise.
    pub fn variance(&self, chosen: &[usize]) -> f64 {
        let Some(c) = self.covariance(chosen) else { return f64::NAN };
        let p = c.nrows();
        (0..p).map(|i| (0..p).map(|j| c[(i, j)] * self.weight[(j, i)]).sum::<f64>()).sum()
    }

    /// Adds (`sign` 1) or takes away (−1) the information of a pose.
    fn update(&self, c: &mut Mat<f64>, i: usize, sign: f64) {
        let b = self.block(i);
        let cb = &*c * b.transpose();
        let bcb = b * &cb;
        let s = Block::from_fn(|a, k| bcb[(a, k)] * sign + if a == k { 1.0 } else { 0.0 });
        let Some(inverse) = s.try_inverse() else { return };
        let inverse = Mat::from_fn(ROWS, ROWS, |a, k| inverse[(a, k)]);
        let left = &cb * &inverse;
        matmul(c.as_mut(), Accum::Add, left.as_ref(), cb.as_ref().transpose(), -sign, Par::Seq);
    }

    /// x
    pub fn exchange(&self, start: &[usize], criterion: Criterion, rounds: usize) -> Vec<usize> {
        let mut chosen = start.to_vec();
        let Some(mut c) = self.covariance(&chosen) else { return chosen };
        for _ in 0..rounds {
            let mut changed = false;
            for slot in 0..chosen.len() {
                let old = chosen[slot];
                self.update(&mut c, old, -1.0);
                let group = self.payload_starts.partition_point(|s| *s <= old) - 1;
                let (first, end) = (self.payload_starts[group], self.payload_starts[group + 1]);
                let b = self.rows.as_ref().subrows(ROWS * first, ROWS * (end - first));
                let u = b * &c;
                let uw = (criterion == Criterion::Prediction).then(|| &u * &self.weight);
                let dot = |x: faer::MatRef<'_, f64>, i: usize, y: faer::MatRef<'_, f64>, j: usize| {
                    (0..x.ncols()).map(|k| x[(i, k)] * y[(j, k)]).sum::<f64>()
                };
                let score = |i: usize| {
                    let r = ROWS * (i - first);
                    let s = Block::from_fn(|a, k| dot(u.as_ref(), r + a, b, r + k) + if a == k { 1.0 } else { 0.0 });
                    match &uw {
                        None => s.determinant(),
                        Some(uw) => {
                            let t = Block::from_fn(|a, k| dot(uw.as_ref(), r + a, u.as_ref(), r + k));
                            s.try_inverse().map_or(0.0, |inv| (inv * t).trace())
                        }
                    }
                };
                let best = (first..end)
                    .filter(|i| *i == old || !chosen.contains(i))
                    .map(|i| (i, score(i)))
                    .max_by(|a, b| a.1.total_cmp(&b.1));
                let best = best.map_or(old, |b| b.0);
                changed |= best != old;
                chosen[slot] = best;
                self.update(&mut c, best, 1.0);
            }
            if !changed { break; }
        }
        chosen
    }
}
