//! Chooses which row of a plan to measure next: `trainer measure`.
//!
//! The unknowns are those of the fit of touches ([`TouchFit`]): the arm, its tips and what is touched, each with its prior.
//! For a tracker's rows there is also a smooth deflection of every joint, a Gaussian process of all joints, which stands for
//! what the elastic method learns by its processes. All readings and all wanted positions are linear in the unknowns about
//! the nominal arm, so their joint covariance K is known before anything is measured. A measured reading r with noise of
//! one unit changes it to
//!
//! ```text
//! K(x, y) − K(x, r) (I + K(r, r))⁻¹ K(r, y)
//! ```
//!
//! whatever value was read. The next row is the one that lowers the mean variance of the wanted positions most. Each further
//! equation costs the product of a triangular factor and a vector; nothing is computed again.

pub mod doubt;
#[cfg(test)]
mod doubt_tests;
pub mod judge;
pub mod moved;
pub mod outlook;
#[cfg(test)]
mod tests;
pub mod waiting;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::identification::touch::volume::{WorkVolume, registered};
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample, Sample};
use crate::measurement::touch::{ClassPrior, Reading, TouchRow, TouchSet};
use crate::numeric::matrix::{Mat, column};
use crate::numeric::product::{Transposed, product};
use crate::numeric::statistics::evenly_spaced;
use crate::robot::Robot;

/// Most positions over the work volume whose variance is to be lowered.
const WANTED: usize = 600;
/// Standard deviation of a touch beyond its stated noise, m or rad: gear errors that no parameter describes.
const UNDESCRIBED: f64 = 0.1e-3;
/// Standard deviation of a tracker's row, m and rad: its noise, the arm's repeatability and its gear errors.
const TRACKED: (f64, f64) = (80e-6, 200e-6);
/// Standard deviation of the smooth deflection of a joint, rad or m.
const DEFLECTION: f64 = 0.2e-3;
/// Rate of the smooth deflection's correlation, which is exp(−RATE d²) for two states that differ by a vector d of sines and
/// cosines.
const RATE: f64 = 0.7;
/// Least variance of an equation that is already known, in units of its noise; it keeps rounding from making the variance
/// negative.
const NOTHING: f64 = 1e-12;

/// Equations of one reading, in units of their noise. They are linear in the unknowns (each in units of its prior) and in
/// the deflections of the joints.
struct Seen {
    unknowns: Mat<f64>,
    joints: Mat<f64>,
    /// Sines and cosines of the joints at which the reading is taken.
    at: Vec<f64>,
}

/// The row to measure next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Next {
    /// Index of the row in the plan.
    pub row: usize,
    /// Standard deviation of the wanted positions after the row is measured, as a share of that before.
    pub share: f64,
}

/// The rows of a plan, with what is known after those that were measured.
pub struct Chooser<'a> {
    problem: TouchProblem<'a>,
    /// The nominal arm, with the features where the plan touches them.
    nominal_arm: TouchFit,
    priors: Vec<f64>,
    deflection: f64,
    taken: Vec<bool>,
    candidates: Vec<Seen>,
    wanted: Vec<Seen>,
    /// Orthonormal columns of what is registered over the wanted positions: base and tip, which no touch sees.
    gauge: Option<Mat<f64>>,
    /// Covariance of the wanted positions (rows) with the candidates' equations (columns).
    shared: Mat<f64>,
    /// Covariance of the equations of each candidate.
    own: Vec<Mat<f64>>,
    /// Sum of the variances of the wanted positions, m².
    variance: f64,
    measured: Vec<Seen>,
    /// Rows of the triangular factor of I + K of the measured equations.
    factor: Vec<Vec<f64>>,
    /// For each row of the inverse factor, its product with the covariance of the candidates and of the wanted positions.
    gains: Vec<(Vec<f64>, Vec<f64>)>,
}

impl<'a> Chooser<'a> {
    /// Creates the chooser for the rows of `plan`, each of which is a candidate.
    pub fn new(
        robot: &Robot,
        nominal: &Poe<f64>,
        plan: &'a TouchSet,
        gravity: Vector3<f64>,
        class: ClassPrior,
    ) -> Self {
        let problem = TouchProblem::new(plan, nominal, robot.coupling.clone(), gravity, class);
        let mut nominal_arm = TouchFit::on_nominal(&problem, 0);
        nominal_arm.moves = true;
        let is_tracked = problem.instrument.is_some();
        let mut out = Self {
            priors: nominal_arm.priors(&problem),
            deflection: if is_tracked { DEFLECTION } else { 0.0 },
            taken: vec![false; plan.rows.len()],
            candidates: Vec::new(),
            wanted: Vec::new(),
            gauge: None,
            shared: Mat::zeros(0, 0),
            own: Vec::new(),
            variance: 0.0,
            measured: Vec::new(),
            factor: Vec::new(),
            gains: Vec::new(),
            problem,
            nominal_arm,
        };
        let rows = plan.rows.iter().zip(&out.problem.state_of);
        out.candidates = rows
            .map(|(row, state)| out.seen(&out.problem.states[*state], Some(row)))
            .collect();
        let states = match is_tracked {
            true => out.problem.states.clone(),
            false => WorkVolume::new(robot, &out.problem).states,
        };
        let states = evenly_spaced(&states, WANTED);
        out.wanted = states.iter().map(|state| out.seen(state, None)).collect();
        if !is_tracked {
            out.gauge = Some(registered(&out.nominal_arm.arm.poses(&states)));
        }
        out.begin();
        out
    }

    /// Computes the covariances before anything is measured.
    fn begin(&mut self) {
        let wanted = self.covariance(&self.wanted, &self.wanted);
        let wanted = self.without_gauge(wanted);
        let wanted = self.without_gauge(wanted.transpose());
        self.variance = wanted.trace();
        let shared = self.covariance(&self.wanted, &self.candidates);
        self.shared = self.without_gauge(shared);
        let own = self.candidates.iter();
        self.own = own
            .map(|seen| self.covariance(std::slice::from_ref(seen), std::slice::from_ref(seen)))
            .collect();
    }

    /// Removes from columns of the wanted positions what a registration of base and tip takes up.
    fn without_gauge(&self, mut columns: Mat<f64>) -> Mat<f64> {
        if let Some(basis) = &self.gauge {
            let taken = product(Transposed(basis), &columns);
            columns -= product(basis, &taken);
        }
        columns
    }

    /// Returns the equations of a row in a state; without a row, those of the position.
    fn seen(&self, state: &BaseSample, row: Option<&TouchRow>) -> Seen {
        let arm = &self.nominal_arm.arm;
        let jet = &arm.linearise(std::slice::from_ref(state))[0];
        let by_joints = arm
            .model
            .linearise(
                std::slice::from_ref(state),
                crate::measurement::noise::NoiseScales::ONE,
            )
            .jacobian;
        let scene = &self.nominal_arm.scene;
        let anywhere = Reading::Tracker(Observation::Position(Vector3::zeros()));
        let reading = row.map_or(&anywhere, |row| &row.reading);
        let mut row_jet = scene.row(self.problem.set, reading, &jet.pose);
        if row.is_none() && scene.instrument.is_none() {
            // Nobody sees the base from elsewhere, so the position is that in the base frame.
            for axis in 0..3 {
                row_jet.tip[axis][axis] = 1.0;
            }
        }
        let count = row_jet.count;
        let sigma = |i: usize| match row {
            Some(row) => self.sigma(row, i),
            None => 1.0,
        };
        let p = self.priors.len();
        let mut unknowns = Mat::zeros(count, p + scene.prior.len());
        let mut joints = Mat::zeros(count, by_joints.ncols());
        for i in 0..count {
            let tip = &row_jet.tip[i];
            let along = |of: &Mat<f64>, j: usize| -> f64 {
                (0..6).map(|a| tip[a] * of[(a, j)]).sum::<f64>() / sigma(i)
            };
            for j in 0..p {
                unknowns[(i, j)] = along(&jet.jacobian, j) * self.priors[j];
            }
            for (index, column) in &row_jet.own {
                unknowns[(i, p + index)] += column[i] * scene.prior[*index] / sigma(i);
            }
            for j in 0..joints.ncols() {
                joints[(i, j)] = along(&by_joints, j) * self.deflection;
            }
        }
        let kinds = self.problem.nominal.kinds();
        let trig = |(q, kind): (&f64, &JointKind)| match kind {
            JointKind::Revolute => [libm::sin(*q), libm::cos(*q)],
            JointKind::Prismatic => [*q, 0.0],
        };
        Seen {
            unknowns,
            joints,
            at: state.joints.iter().zip(kinds).flat_map(trig).collect(),
        }
    }

    /// Returns the standard deviation of a component of a row.
    fn sigma(&self, row: &TouchRow, component: usize) -> f64 {
        match self.problem.set.sigma(row) {
            Some(_) if matches!(row.reading, Reading::Board { .. }) => 1.0,
            Some(stated) => (stated * stated + UNDESCRIBED * UNDESCRIBED).sqrt(),
            None if component < 3 => TRACKED.0,
            None => TRACKED.1,
        }
    }

    /// Returns K, the covariance before anything is measured.
    fn covariance(&self, rows: &[Seen], columns: &[Seen]) -> Mat<f64> {
        let stacked = |all: &[Seen]| {
            let count: usize = all.iter().map(|seen| seen.unknowns.nrows()).sum();
            let mut out = Mat::zeros(
                count,
                self.priors.len() + self.nominal_arm.scene.prior.len(),
            );
            let mut first = 0;
            for seen in all {
                let own = seen.unknowns.nrows();
                out.rows_mut(first, own).copy_from(&seen.unknowns);
                first += own;
            }
            out
        };
        let (a, b) = (stacked(rows), stacked(columns));
        let mut out = product(&a, Transposed(&b));
        if self.deflection == 0.0 {
            return out;
        }
        let mut first = 0;
        for y in columns {
            let mut top = 0;
            for x in rows {
                let apart: f64 = x.at.iter().zip(&y.at).map(|(a, b)| (a - b).powi(2)).sum();
                let correlation = libm::exp(-RATE * apart);
                for i in 0..x.joints.nrows() {
                    for j in 0..y.joints.nrows() {
                        let both =
                            (0..x.joints.ncols()).map(|c| x.joints[(i, c)] * y.joints[(j, c)]);
                        out[(top + i, first + j)] += correlation * both.sum::<f64>();
                    }
                }
                top += x.joints.nrows();
            }
            first += y.joints.nrows();
        }
        out
    }

    /// Takes a row of `set`, a file with the features of the plan, as measured. The row uses up the candidate that is
    /// nearest to it.
    pub fn measured(&mut self, set: &TouchSet, row: &TouchRow) {
        let tips = &self.problem.set.tips;
        let name = &set.tips[row.tip].name;
        let tip = tips.iter().position(|tip| tip.name == *name).unwrap_or(0);
        let mut state = Sample::new(
            row.joints.clone(),
            row.serial_joints.clone(),
            Observation::Pose(Pose::identity()),
            Base,
        );
        state.payload_kg = row.payload_kg;
        state.tool = match row.reading {
            Reading::Level { .. } | Reading::Board { .. } => tips.len(),
            _ => tip,
        };
        self.use_up(row);
        let seen = self.seen(&state, Some(row));
        self.learn(seen);
    }

    /// Uses up the candidate that is nearest to a row, although the row says nothing.
    pub fn use_up(&mut self, row: &TouchRow) {
        if let Some(nearest) = self.nearest(row) {
            self.taken[nearest] = true;
        }
    }

    /// Returns the free candidate of the same feature whose joints and payload are nearest.
    fn nearest(&self, row: &TouchRow) -> Option<usize> {
        let candidates = self.problem.set.rows.iter().enumerate();
        let apart = |other: &TouchRow| -> f64 {
            let joints = row.joints.iter().zip(&other.joints);
            let payload = row.payload_kg.unwrap_or(0.0) - other.payload_kg.unwrap_or(0.0);
            joints.map(|(a, b)| (a - b).powi(2)).sum::<f64>() + payload * payload
        };
        candidates
            .filter(|(i, other)| {
                !self.taken[*i] && other.reading.feature() == row.reading.feature()
            })
            .map(|(i, other)| (i, apart(other)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(i, _)| i)
    }

    /// Removes a candidate that cannot be measured.
    pub fn skip(&mut self, row: usize) {
        self.taken[row] = true;
    }

    fn learn(&mut self, seen: Seen) {
        let one = std::slice::from_ref(&seen);
        let before = self.covariance(&self.measured, one);
        let own = self.covariance(one, one);
        let candidates = self.covariance(&self.candidates, one);
        let wanted = self.covariance(&self.wanted, one);
        let wanted = self.without_gauge(wanted);
        let first = self.factor.len();
        for i in 0..seen.unknowns.nrows() {
            // The earlier equations of this row count as measured, too.
            let mut row: Vec<f64> = Vec::with_capacity(first + i + 1);
            let covariance = |k: usize| match k < first {
                true => before[(k, i)],
                false => own[(k - first, i)],
            };
            for k in 0..first + i {
                let known: f64 = self.factor[k].iter().zip(&row).map(|(a, b)| a * b).sum();
                row.push((covariance(k) - known) / self.factor[k][k]);
            }
            let known: f64 = row.iter().map(|x| x * x).sum();
            let deviation = (own[(i, i)] + 1.0 - known).max(NOTHING).sqrt();
            let mut by_candidates = column(&candidates, i).to_vec();
            let mut by_wanted = column(&wanted, i).to_vec();
            for (factor, (of_candidates, of_wanted)) in row.iter().zip(&self.gains) {
                subtract(&mut by_candidates, *factor, of_candidates);
                subtract(&mut by_wanted, *factor, of_wanted);
            }
            by_candidates.iter_mut().for_each(|x| *x /= deviation);
            by_wanted.iter_mut().for_each(|x| *x /= deviation);
            row.push(deviation);
            self.factor.push(row);
            self.lower(&by_candidates, &by_wanted);
            self.gains.push((by_candidates, by_wanted));
        }
        self.measured.push(seen);
    }

    /// Subtracts from the covariances what one equation explains.
    fn lower(&mut self, by_candidates: &[f64], by_wanted: &[f64]) {
        let height = by_wanted.len();
        let columns = self.shared.as_mut_slice().chunks_exact_mut(height);
        for (column, factor) in columns.zip(by_candidates) {
            subtract(column, *factor, by_wanted);
        }
        let mut first = 0;
        for own in &mut self.own {
            let count = own.nrows();
            let gain = &by_candidates[first..first + count];
            for i in 0..count {
                for j in 0..count {
                    own[(i, j)] -= gain[i] * gain[j];
                }
            }
            first += count;
        }
        self.variance -= by_wanted.iter().map(|x| x * x).sum::<f64>();
    }

    /// Returns by how much each candidate lowers the sum of the variances of the wanted positions, m².
    fn gains(&self) -> Vec<f64> {
        let mut first = 0;
        let mut out = Vec::with_capacity(self.own.len());
        for own in &self.own {
            let count = own.nrows();
            let columns: Vec<&[f64]> = (first..first + count)
                .map(|j| column(&self.shared, j))
                .collect();
            let dot = |i: usize, j: usize| -> f64 {
                columns[i].iter().zip(columns[j]).map(|(a, b)| a * b).sum()
            };
            let gram = Mat::from_fn(count, count, dot);
            let noisy = own + Mat::identity(count, count);
            let inverse = noisy.try_inverse();
            out.push(inverse.map_or(0.0, |inverse| product(&inverse, &gram).trace()));
            first += count;
        }
        out
    }

    /// Returns the root mean square error of the wanted positions as far as the plan foresees it, m.
    pub fn foreseen(&self) -> f64 {
        (self.variance.max(0.0) / self.wanted.len().max(1) as f64).sqrt()
    }

    /// Returns the best free candidate of the features for which `of` is true (`None` stands for a tracker); `None` if all
    /// are used up.
    pub fn best(&self, of: impl Fn(Option<usize>) -> bool) -> Option<Next> {
        let gains = self.gains();
        let rows = &self.problem.set.rows;
        let free = (0..gains.len()).filter(|i| !self.taken[*i] && of(rows[*i].reading.feature()));
        let row = free.max_by(|a, b| gains[*a].total_cmp(&gains[*b]))?;
        let left = 1.0 - gains[row] / self.variance.max(f64::MIN_POSITIVE);
        Some(Next {
            row,
            share: left.clamp(0.0, 1.0).sqrt(),
        })
    }

    /// Returns the number of candidates that are neither measured nor removed.
    pub fn left(&self) -> usize {
        self.taken.iter().filter(|taken| !**taken).count()
    }
}

fn subtract(from: &mut [f64], factor: f64, values: &[f64]) {
    for (x, value) in from.iter_mut().zip(values) {
        *x -= factor * value;
    }
}
