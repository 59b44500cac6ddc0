//! The uncertainty of a chain alone, or of joint zeros alone, that are fitted to the predictions of a model.
//!
//! Both fits are linear for small changes: x = (CᵀC)⁻¹ Cᵀ y, with C the Jacobian of the fitted parameters and y the
//! predictions over a region. If K is the covariance of y, x has the covariance G K Gᵀ, with G = (CᵀC)⁻¹ Cᵀ. The part of the
//! model that a chain cannot represent is not uncertainty: it is the distance from the model, which the export states.

use poegp_runtime::kinematics::poe::Poe;

use crate::identification::frame_fit::{METRES_PER_RADIAN, ResidualFrame, linearise};
use crate::identification::prediction_covariance::PredictionCovariance;
use crate::measurement::sample::InstrumentSample;
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::robot::own_motion;

/// Share of the largest diagonal element that is added to every diagonal element, so that redundant directions stay
/// unchanged.
const RIDGE: f64 = 1e-10;
/// Least number of poses of the first target: they give twice the equations that the frames of eight joints need.
const LEAST_POSES: usize = 12;
/// Number of parameters of a frame.
const SIX: usize = 6;

/// The uncertainty of the nearest chain and of the joint zeros of a model.
#[derive(Clone, Debug)]
pub struct ChainDeviation {
    /// Covariance of the frames of the chain to the first target, each as a twist (six numbers) that multiplies the frame
    /// from the left, in m and rad.
    pub frames: Mat<f64>,
    /// Standard deviations of the zeros of the controller's joints, in rad or m; 0 for the first and the last joint, which
    /// are not fitted.
    pub zeros: Vec<f64>,
}

impl ChainDeviation {
    /// Computes the uncertainty of a `chain` from the base to the first target, from the covariance `known` of predictions;
    /// the whole `poses` are the first ones that `known` covers, and `coupling` is C of q_serial = C q by rows. Returns
    /// `None` if too few of the poses are of the first target or the equations cannot be solved.
    pub fn new(
        known: &PredictionCovariance,
        poses: &[InstrumentSample],
        chain: &Poe<f64>,
        coupling: Option<&[Vec<f64>]>,
    ) -> Option<Self> {
        let (kinds, n) = (chain.kinds(), chain.kinds().len());
        let own: Vec<usize> = (0..poses.len()).filter(|k| poses[*k].tool == 0).collect();
        if own.len() < LEAST_POSES {
            return None;
        }
        let rows: Vec<usize> = own.iter().flat_map(|k| known.rows(*k)).collect();
        let covariance = Mat::from_fn(rows.len(), rows.len(), |i, j| {
            known.covariance[(rows[i], rows[j])]
        });
        let samples: Vec<InstrumentSample> = own.iter().map(|k| poses[*k].clone()).collect();
        let all: Vec<usize> = (0..=n).collect();
        let kind = ResidualFrame::TOOL_POINT_UNIT_WEIGHTS;
        let (_, all) = linearise(chain, &samples, &all, kind);
        let frames = fitted(&all, &covariance)?;
        // Columns of base and tool, then one column for each joint between the first and the last.
        let share = |i: usize, j: usize| match coupling {
            Some(rows) => rows[i][j],
            None => f64::from(u8::from(i == j)),
        };
        let free = 1..n.saturating_sub(1).max(1);
        // The fit of the zeros weighs 0.3 m as a radian.
        let weight = |row: usize| match row % SIX {
            0..3 => METRES_PER_RADIAN.recip(),
            _ => 1.0,
        };
        let columns = Mat::from_fn(rows.len(), 2 * SIX + free.len(), |row, column| {
            if column < SIX {
                return weight(row) * all[(row, column)];
            }
            if column < 2 * SIX {
                return weight(row) * all[(row, SIX * n + column - SIX)];
            }
            let joint = free.start + column - 2 * SIX;
            let of = |i: usize| share(i, joint) * all[(row, SIX * (i + 1) + own_motion(kinds[i]))];
            weight(row) * (0..n - 1).map(of).sum::<f64>()
        });
        let weighed = Mat::from_fn(rows.len(), rows.len(), |i, j| {
            weight(i) * covariance[(i, j)] * weight(j)
        });
        let zeros = fitted(&columns, &weighed)?;
        let of = |joint: usize| {
            if !free.contains(&joint) {
                return 0.0;
            }
            let at = 2 * SIX + joint - free.start;
            zeros[(at, at)].max(0.0).sqrt()
        };
        Some(Self {
            frames,
            zeros: (0..n).map(of).collect(),
        })
    }
}

/// Returns G K Gᵀ, with G = (CᵀC)⁻¹ Cᵀ for the Jacobian C = `columns` and K = `covariance`.
fn fitted(columns: &Mat<f64>, covariance: &Mat<f64>) -> Option<Mat<f64>> {
    let mut normal = product(Transposed(columns), columns);
    let diagonal = (0..normal.nrows()).map(|i| normal[(i, i)]);
    let ridge = RIDGE * diagonal.fold(0.0, f64::max);
    for i in 0..normal.nrows() {
        normal[(i, i)] += ridge;
    }
    let g = Factor::new(normal, 1).ok()?.solve(&columns.transpose());
    Some(product(&product(&g, covariance), Transposed(&g)))
}
