//! Least squares over the fixed frames of a chain. Base-tool calibration and step 1 use the same solver with different
//! free frames.
//!
//! Every free frame i has six parameters δ_i that multiply it from the left, e^p̂_i ← e^δ̂_i e^p̂_i. (The paper's
//! additive update p ← p + δp is not Gauss–Newton and still creeps after eleven steps; this one is done in two.) Of the
//! 42 parameters of a six-axis arm, 30 are identifiable. Steps are of minimum norm, and damped whenever a step would not
//! lower the cost, so that the solver cannot diverge.

use nalgebra::{Matrix3, Vector3};
use poegp_protocol::limits::MAX_FRAMES;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Matrix6, Pose, Twist, residual};

use crate::measurement::noise::{FOLLOWED, NoiseScales};
use crate::measurement::observation::Observation;
use crate::measurement::sample::Sample;
use crate::numeric::matrix::Mat;
use crate::numeric::product::{Transposed, product};
use crate::numeric::svd::Svd;

/// The residual that is minimised, and the frame that it is expressed in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ResidualFrame {
    /// The paper's residual: Log(T′T⁻¹) at the origin of the space frame, in metres and radians, unweighted.
    Space,
    /// Displacement and rotation at the tool point along the axes of the space frame, each divided by its noise.
    ToolPoint(NoiseScales),
}

impl ResidualFrame {
    /// Residual at the tool point, with metres and radians weighted alike.
    pub const TOOL_POINT_UNIT_WEIGHTS: Self = Self::ToolPoint(NoiseScales::ONE);
    /// Residual at the tool point, with 0.3 m weighted as a radian: a rotation counts as what it moves at the end of a tool.
    pub const TOOL_POINT_TOOL_LENGTH: Self =
        Self::ToolPoint(NoiseScales::uniform(METRES_PER_RADIAN, 1.0));

    /// Returns the residual with the noise scales of one row.
    fn of<F>(self, sample: &Sample<F>) -> Self {
        match self {
            Self::Space => Self::Space,
            Self::ToolPoint(scales) => Self::ToolPoint(scales.of(sample)),
        }
    }
}

/// Position error in m that weighs as much as a rotation error of 1 rad where a nominal model is brought nearest to a model.
pub const METRES_PER_RADIAN: f64 = 0.3;

/// Report of a fit.
#[derive(Clone, Copy, Debug)]
pub struct FrameFit {
    /// Number of steps taken.
    pub iterations: usize,
    /// Root mean square of the weighted residual components.
    pub rms: f64,
    /// Number of identifiable directions among the free parameters.
    pub rank: usize,
    /// Number of free parameters.
    pub parameters: usize,
}

/// Share of the largest singular value below which a singular value counts as zero.
const RELATIVE_RANK_TOLERANCE: f64 = 1e-10;
/// Largest number of steps.
const MAX_ITERATIONS: usize = 60;
/// Relative decrease of the cost below which the fit has converged.
const CONVERGED: f64 = 1e-12;

/// Weight of a part of the tool that is held, as a multiple of that of all samples.
const HELD: f64 = 10.0;
/// Share of a shift of the tool that moves the target, once the base makes up for the rest, below which base and tool
/// cannot be distinguished.
const INDISTINCT: f64 = 2e-3;

/// Returns the mean of base_from_flange rotations, and the unit vectors in the flange frame along which a shift of the tool
/// cannot be distinguished from one of the base.
///
/// With rotations R_i and their mean M, a shift v of the tool leaves (I − Mᵀ M)^½ v, root mean square, once the base is
/// shifted by −M v.
pub fn indistinct_shifts(
    rotations: impl Iterator<Item = Matrix3<f64>>,
) -> (Matrix3<f64>, Vec<Vector3<f64>>) {
    let (sum, count) = rotations.fold((Matrix3::zeros(), 0), |(sum, count), rotation| {
        (sum + rotation, count + 1)
    });
    let mean = sum / f64::from(count.max(1));
    let left = (Matrix3::identity() - mean.transpose() * mean).symmetric_eigen();
    let indistinct = (0..3).filter(|i| left.eigenvalues[*i] < INDISTINCT * INDISTINCT);
    let directions = indistinct.map(|i| left.eigenvectors.column(i).into_owned());
    (mean, directions.collect())
}

/// Parts of the tool's translation that are held at zero, because a shift of the base does the same: where all axes are
/// parallel, as those of a SCARA or a palletizer, the tool's length along them.
pub struct HeldTool {
    /// Flange in the frame of the last joint.
    flange: Pose<f64>,
    /// Mean rotation base_from_flange.
    mean: Matrix3<f64>,
    /// Orthogonal unit vectors in the flange frame.
    directions: Vec<Vector3<f64>>,
}

impl HeldTool {
    /// Holds nothing.
    pub fn none() -> Self {
        Self {
            flange: Pose::identity(),
            mean: Matrix3::identity(),
            directions: Vec::new(),
        }
    }

    /// Holds what these samples cannot show if base and tool are both free. `nominal` is the chain from base to flange.
    pub fn new<F>(nominal: &Poe<f64>, samples: &[Sample<F>]) -> Self {
        let rotations = samples.iter();
        let rotations = rotations.map(|s| nominal.forward(&s.serial_joints).rotation);
        let (mean, directions) = indistinct_shifts(rotations);
        Self {
            flange: nominal.frames()[nominal.kinds().len()],
            mean,
            directions,
        }
    }

    /// Returns the part of a shift of the tool, in the flange frame, that a shift of the base does not undo.
    pub fn shown_of_tool(&self, shift: &Vector3<f64>) -> Vector3<f64> {
        let held = self.directions.iter().map(|v| v * v.dot(shift));
        shift - held.sum::<Vector3<f64>>()
    }

    /// Returns the part of a shift of the base, in its own frame, that a shift of the tool does not undo.
    pub fn shown_of_base(&self, shift: &Vector3<f64>) -> Vector3<f64> {
        self.mean * self.shown_of_tool(&(self.mean.transpose() * shift))
            + (shift - self.mean * (self.mean.transpose() * shift))
    }

    /// Returns the held components of the tool, in m.
    fn values(&self, poe: &Poe<f64>) -> impl Iterator<Item = f64> {
        let tool = self.flange.inverse() * poe.frames()[poe.kinds().len()];
        self.directions
            .iter()
            .map(move |v| v.dot(&tool.translation))
    }

    /// Adds a row for each held component.
    fn add_rows(
        &self,
        poe: &Poe<f64>,
        weight: f64,
        free: &[usize],
        (y, a): (&mut Mat<f64>, &mut Mat<f64>),
    ) {
        let last = poe.kinds().len();
        let Some(position) = free.iter().position(|frame| *frame == last) else {
            return;
        };
        let first = y.nrows();
        let rows = first + self.directions.len();
        *y = std::mem::replace(y, Mat::zeros(0, 0)).resize_vertically(rows, 0.0);
        *a = std::mem::replace(a, Mat::zeros(0, 0)).resize_vertically(rows, 0.0);
        let at = poe.frames()[last].translation;
        for (k, (v, value)) in self.directions.iter().zip(self.values(poe)).enumerate() {
            let along = self.flange.rotation * v;
            let turned = at.cross(&along);
            y[(first + k, 0)] = -weight * value;
            for i in 0..3 {
                a[(first + k, 6 * position + i)] = weight * along[i];
                a[(first + k, 6 * position + 3 + i)] = weight * turned[i];
            }
        }
    }
}

/// Returns the six residual components of one observation, zero where nothing was measured. They are in units of the
/// scales of `kind` as given, whatever the row's own noise.
pub fn residual_components(
    kind: ResidualFrame,
    measured: &Observation,
    predicted: &Pose<f64>,
) -> [f64; 6] {
    let scales = match kind {
        ResidualFrame::Space => NoiseScales::ONE,
        ResidualFrame::ToolPoint(scales) => scales,
    };
    let p = (measured.position() - predicted.translation) / scales.position;
    let r = match measured {
        Observation::Position(_) => Vector3::zeros(),
        Observation::Pose(pose) if kind == ResidualFrame::Space => {
            return residual(pose, predicted).to_array();
        }
        Observation::Pose(pose) => {
            let turned = Pose {
                translation: Vector3::zeros(),
                ..*pose * predicted.inverse()
            };
            turned.log().angular / scales.orientation
        }
    };
    [p[0], p[1], p[2], r[0], r[1], r[2]]
}

/// Converts one block of the identification Jacobian to the rows of [`residual_components`].
fn block_rows(kind: ResidualFrame, block: &Matrix6<f64>, predicted: &Pose<f64>) -> Matrix6<f64> {
    let ResidualFrame::ToolPoint(scales) = kind else {
        return *block;
    };
    let mut out = [[0.0; 6]; 6];
    for column in 0..6 {
        let twist = Twist::from_array(&std::array::from_fn(|row| block[row][column]));
        let at_tool = twist.at_point(&predicted.translation).to_array();
        for row in 0..6 {
            out[row][column] = at_tool[row]
                / if row < 3 {
                    scales.position
                } else {
                    scales.orientation
                };
        }
    }
    out
}

/// Returns the residuals (6k) and the identification Jacobian (6k × 6·free) at the current chain.
pub fn linearise<F>(
    poe: &Poe<f64>,
    samples: &[Sample<F>],
    free: &[usize],
    kind: ResidualFrame,
) -> (Mat<f64>, Mat<f64>) {
    let mut y = Mat::zeros(6 * samples.len(), 1);
    let mut a = Mat::zeros(6 * samples.len(), 6 * free.len());
    for (k, sample) in samples.iter().enumerate() {
        let (blocks, predicted): ([Matrix6<f64>; MAX_FRAMES], _) =
            poe.identification_jacobian(&sample.serial_joints);
        let kind = kind.of(sample);
        let components = residual_components(kind, &sample.observation, &predicted);
        for (row, component) in components.into_iter().enumerate() {
            y[(6 * k + row, 0)] = component;
        }
        for (position, frame) in free.iter().enumerate() {
            let rows = block_rows(kind, &blocks[*frame], &predicted);
            for (row, values) in rows.iter().enumerate() {
                for (column, value) in values.iter().enumerate() {
                    a[(6 * k + row, 6 * position + column)] = *value;
                }
            }
        }
    }
    (y, a)
}

/// Returns the sum of squares of all residual components.
pub fn cost<F>(poe: &Poe<f64>, samples: &[Sample<F>], kind: ResidualFrame) -> f64 {
    let of = |sample: &Sample<F>| {
        let predicted = poe.forward(&sample.serial_joints);
        residual_components(kind.of(sample), &sample.observation, &predicted)
    };
    samples.iter().flat_map(of).map(|r| r * r).sum()
}

/// Returns the chain with each free frame multiplied from the left by Exp of its six parameters.
fn updated(poe: &Poe<f64>, free: &[usize], step: &Mat<f64>) -> Poe<f64> {
    let mut out = *poe;
    for (position, frame) in free.iter().enumerate() {
        let twist = Twist::from_array(&std::array::from_fn(|i| step[(6 * position + i, 0)]));
        let frame = &mut out.frames_mut()[*frame];
        *frame = Pose::exp(&twist) * *frame;
    }
    out
}

/// Returns the shares of the equations of positions and of rotations that the `free` frames follow in a fit of whole poses.
/// `None` where the equations are so many that [`FOLLOWED`] is out of reach.
pub fn followed_share<F>(
    poe: &Poe<f64>,
    samples: &[Sample<F>],
    free: &[usize],
    kind: ResidualFrame,
) -> Option<[f64; 2]> {
    let equations = (3 * samples.len()) as f64;
    if (6 * free.len()) as f64 <= FOLLOWED * equations {
        return None;
    }
    let (_, a) = linearise(poe, samples, free, kind);
    let Svd { u, values, .. } = Svd::new(&a)?;
    let mut share = [0.0; 2];
    for (value, column) in values.iter().zip(u.column_iter()) {
        if *value > RELATIVE_RANK_TOLERANCE * values[0] {
            for (row, x) in column.iter().enumerate() {
                share[row % 6 / 3] += x * x / equations;
            }
        }
    }
    Some(share)
}

/// Moves the `free` frames of `poe` to the least-squares fit of `samples`.
pub fn fit_frames<F>(
    poe: &mut Poe<f64>,
    samples: &[Sample<F>],
    free: &[usize],
    kind: ResidualFrame,
) -> FrameFit {
    fit_frames_holding(poe, samples, free, kind, &HeldTool::none())
}

/// Moves the `free` frames of `poe` to the least-squares fit of `samples`, with parts of the tool's translation held at zero.
pub fn fit_frames_holding<F>(
    poe: &mut Poe<f64>,
    samples: &[Sample<F>],
    free: &[usize],
    kind: ResidualFrame,
    held: &HeldTool,
) -> FrameFit {
    let weight = HELD * ((6 * samples.len()) as f64).sqrt();
    let cost = |poe: &Poe<f64>| {
        let held = held.values(poe).map(|value| (weight * value).powi(2));
        cost(poe, samples, kind) + held.sum::<f64>()
    };
    let mut current = cost(poe);
    let mut report = FrameFit {
        iterations: 0,
        rms: 0.0,
        rank: 0,
        parameters: 6 * free.len(),
    };
    let mut damping = 0.0;
    while report.iterations < MAX_ITERATIONS {
        let (mut y, mut a) = linearise(poe, samples, free, kind);
        held.add_rows(poe, weight, free, (&mut y, &mut a));
        let Some(Svd { u, values, v }) = Svd::new(&a) else {
            break;
        };
        let largest = values.first().copied().unwrap_or(0.0);
        let kept = values
            .iter()
            .filter(|s| **s > RELATIVE_RANK_TOLERANCE * largest)
            .count();
        report.rank = kept;
        let projected = product(Transposed(&u), &y);
        let mut accepted = None;
        for _ in 0..30 {
            let damped = |i: usize| {
                let s = values[i];
                if i < kept {
                    s / (s * s + damping) * projected[(i, 0)]
                } else {
                    0.0
                }
            };
            let step = &v * Mat::from_fn(values.len(), 1, |i, _| damped(i));
            let candidate = updated(poe, free, &step);
            let value = cost(&candidate);
            if value <= current {
                accepted = Some((candidate, value));
                break;
            }
            damping = (damping * 10.0).max(1e-12 * largest * largest);
        }
        let Some((candidate, value)) = accepted else {
            break;
        };
        report.iterations += 1;
        *poe = candidate;
        damping = if damping < 1e-11 * largest * largest {
            0.0
        } else {
            damping * 0.1
        };
        let decrease = current - value;
        current = value;
        if decrease <= CONVERGED * current {
            break;
        }
    }
    report.rms = (current / (6 * samples.len()).max(1) as f64).sqrt();
    report
}
