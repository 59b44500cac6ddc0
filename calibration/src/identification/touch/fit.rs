//! The arm and its surroundings, most probable for all rows: Levenberg–Marquardt with noise and priors by the evidence.
//!
//! A row's component has the variance σ² + τ²: σ is stated, τ is what this kind of row misses by beyond it, seats and gears
//! that no parameter describes. Rows that all others do not predict are left out, and listed.

use nalgebra::Vector3;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::identification::base_tools::fit_base_and_tools;
use crate::identification::touch::arm::{Group, StateJet, Terms, TipStart, TouchArm};
use crate::identification::touch::equations::{CellSums, Equations, Solved};
use crate::identification::touch::jet::RowJet;
use crate::identification::touch::scene::Scene;
use crate::identification::touch::start;
use crate::measurement::observation::Observation;
use crate::measurement::sample::{Base, BaseSample, Instrument, InstrumentSample, Sample};
use crate::measurement::touch::{ClassPrior, Reading, TouchSet};
use crate::numeric::cholesky::Factor;
use crate::numeric::matrix::Mat;

/// Kinds of noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// Of a touched point, m.
    Point,
    /// Of a touched plane, m.
    Plane,
    /// Of a sphere, m.
    Sphere,
    /// Of a wire, m.
    Anchor,
    /// Of a level, rad.
    Level,
    /// Of a corner in an image, pixels.
    Board,
    /// Of a tracker's position, m.
    Position,
    /// Of a tracker's rotation, rad.
    Rotation,
}

impl Noise {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Point,
        Self::Plane,
        Self::Sphere,
        Self::Anchor,
        Self::Level,
        Self::Board,
        Self::Position,
        Self::Rotation,
    ];

    /// Of a component of a reading.
    pub fn of(reading: &Reading, component: usize) -> Self {
        match reading {
            Reading::Tracker(_) if component >= 3 => Self::Rotation,
            Reading::Tracker(_) => Self::Position,
            Reading::Point { .. } => Self::Point,
            Reading::Plane { .. } => Self::Plane,
            Reading::Sphere { .. } => Self::Sphere,
            Reading::Anchor { .. } => Self::Anchor,
            Reading::Level { .. } => Self::Level,
            Reading::Board { .. } => Self::Board,
        }
    }

    /// What gears and joints leave that no parameter describes, of an arm of which nothing is known yet.
    pub fn usual(self) -> f64 {
        match self {
            Self::Board => 0.2,
            Self::Level | Self::Rotation => 1e-4,
            _ => 1e-4,
        }
    }

    /// Whether it is a length.
    pub fn is_length(self) -> bool {
        !matches!(self, Self::Level | Self::Board | Self::Rotation)
    }
}

/// As many rows as this are believed to have shown the usual τ before the first is read.
const USUAL_ROWS: f64 = 6.0;
/// A tracker that states nothing: m and rad.
const TRACKER_NOISE: (f64, f64) = (20e-6, 50e-6);

/// Standard deviations of the arm's priors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales {
    /// Of a link's offset, m.
    pub length: f64,
    /// Of the direction of an axis, rad.
    pub tilt: f64,
    /// Of the zero of a joint, rad.
    pub zero: f64,
    /// Of a gravity coefficient of a link, rad/(m/s²).
    pub links: f64,
    /// Of a gravity coefficient of the payload.
    pub payload: f64,
    /// Of an amplitude of an own-joint error, rad.
    pub curve: f64,
}

/// How far the evidence may move a scale of the class, and how many parameters' worth of belief it has to outweigh.
const CLASS_FACTOR: f64 = 2.0;
const CLASS_COUNTS: f64 = 15.0;
/// The same of what all scales of the class have in common.
const COMMON_COUNTS: f64 = 5.0;
/// The same for compliances and gear errors, which differ more from arm to arm.
const OTHER_FACTOR: f64 = 10.0;
const OTHER_COUNTS: f64 = 4.0;

impl Scales {
    /// Before the evidence.
    pub fn new(class: &ClassPrior) -> Self {
        Self {
            length: class.length,
            tilt: class.tilt,
            zero: class.joint_zero,
            links: 5e-5,
            payload: 1.5e-5,
            curve: 1e-4,
        }
    }

    /// Of a group of parameters.
    pub fn of(&self, group: Group) -> Option<f64> {
        match group {
            Group::Length => Some(self.length),
            Group::Tilt => Some(self.tilt),
            Group::Zero => Some(self.zero),
            Group::Links => Some(self.links),
            Group::Payload => Some(self.payload),
            Group::Curve => Some(self.curve),
            Group::Tip | Group::Turn => None,
        }
    }

    fn set(&mut self, group: Group, value: f64) {
        match group {
            Group::Length => self.length = value,
            Group::Tilt => self.tilt = value,
            Group::Zero => self.zero = value,
            Group::Links => self.links = value,
            Group::Payload => self.payload = value,
            Group::Curve => self.curve = value,
            Group::Tip | Group::Turn => {}
        }
    }
}

/// Rows of one group in one state of the arm.
#[derive(Clone, Debug)]
struct Cell {
    state: usize,
    group: usize,
    rows: Vec<usize>,
}

/// What is fitted.
#[derive(Clone, Debug)]
pub struct TouchProblem<'a> {
    /// The rows.
    pub set: &'a TouchSet,
    /// The drawing from base to flange.
    pub nominal: Poe<f64>,
    /// C of q_serial = C q.
    pub coupling: Option<Vec<Vec<f64>>>,
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// How far an arm of the class is from its drawing.
    pub class: ClassPrior,
    /// Standing still with one tip: joints and payload.
    pub states: Vec<BaseSample>,
    /// The state of every row.
    pub state_of: Vec<usize>,
    /// Tips before the fit, and behind them the flange.
    pub tips: Vec<TipStart>,
    /// instrument_from_base before the fit, where there are rows of a tracker.
    pub instrument: Option<Pose<f64>>,
}

impl<'a> TouchProblem<'a> {
    /// From the rows of `set` that `keep` names.
    pub fn new(
        set: &'a TouchSet,
        nominal: &Poe<f64>,
        coupling: Option<Vec<Vec<f64>>>,
        gravity: Vector3<f64>,
        class: ClassPrior,
    ) -> Self {
        let flange = set.tips.len();
        let mut states: Vec<BaseSample> = Vec::new();
        let mut seen: std::collections::HashMap<(Vec<u64>, Option<u64>, usize), usize> =
            std::collections::HashMap::new();
        let mut state_of = Vec::with_capacity(set.rows.len());
        for row in &set.rows {
            let tool = match row.reading {
                Reading::Level { .. } | Reading::Board { .. } => flange,
                _ => row.tip,
            };
            let bits = |x: f64| (x + 0.0).to_bits();
            let key = (
                row.joints.iter().map(|q| bits(*q)).collect(),
                row.payload_kg.map(bits),
                tool,
            );
            let state = *seen.entry(key).or_insert_with(|| {
                let unseen = Observation::Pose(Pose::identity());
                let mut sample =
                    Sample::new(row.joints.clone(), row.serial_joints.clone(), unseen, Base);
                (sample.payload_kg, sample.tool) = (row.payload_kg, tool);
                states.push(sample);
                states.len() - 1
            });
            state_of.push(state);
        }
        let mut tips: Vec<TipStart> = set
            .tips
            .iter()
            .map(|tip| TipStart {
                pose: Pose {
                    translation: tip.position,
                    ..Pose::identity()
                },
                is_free: true,
                turns: false,
            })
            .collect();
        let seen = set.rows.iter().filter_map(|row| match row.reading {
            Reading::Tracker(observation) => {
                let (joints, serial) = (row.joints.clone(), row.serial_joints.clone());
                let mut sample = Sample::new(joints, serial, observation, Instrument);
                sample.tool = row.tip;
                Some(sample)
            }
            _ => None,
        });
        let seen: Vec<InstrumentSample> = seen.collect();
        let instrument = (!seen.is_empty()).then(|| from_tracker(nominal, &seen, &mut tips));
        tips.push(TipStart {
            pose: Pose::identity(),
            is_free: false,
            turns: false,
        });
        Self {
            set,
            nominal: *nominal,
            coupling,
            gravity,
            class,
            states,
            state_of,
            tips,
            instrument,
        }
    }

    /// Scalar equations.
    pub fn equations(&self) -> usize {
        self.set.rows.iter().map(|r| r.reading.equations()).sum()
    }

    fn payload_varies(&self) -> bool {
        let mut payloads = self.states.iter().map(|s| s.payload_kg);
        let first = payloads.next().flatten();
        first.is_some() && payloads.any(|p| p != first)
    }

    /// σ² of a component of a row.
    fn stated_variance(&self, row: usize, component: usize) -> f64 {
        let row = &self.set.rows[row];
        let sigma = match self.set.sigma(row) {
            Some(sigma) => sigma,
            None if component < 3 => row.declared_noise.position.unwrap_or(TRACKER_NOISE.0),
            None => row.declared_noise.orientation.unwrap_or(TRACKER_NOISE.1),
        };
        sigma * sigma
    }

    fn arm(&self, orders: usize) -> TouchArm {
        let terms = Terms {
            gravity: true,
            payload: self.payload_varies(),
            orders,
        };
        TouchArm::new(
            &self.nominal,
            &self.tips,
            self.coupling.clone(),
            self.gravity,
            terms,
        )
    }
}

/// instrument_from_base by the rows of a tracker, and the tips that it saw: fitted to the drawing.
fn from_tracker(
    nominal: &Poe<f64>,
    seen: &[InstrumentSample],
    tips: &mut [TipStart],
) -> Pose<f64> {
    let mut tools: Vec<usize> = seen.iter().map(|s| s.tool).collect();
    tools.sort_unstable();
    tools.dedup();
    let mut samples = seen.to_vec();
    for sample in &mut samples {
        sample.tool = tools.iter().position(|t| *t == sample.tool).unwrap_or(0);
    }
    let found = fit_base_and_tools(nominal, &samples);
    for (tool, target) in tools.iter().zip(&found.flange_from_targets) {
        let whole = seen
            .iter()
            .any(|s| s.tool == *tool && s.observation.has_orientation());
        let tip = &mut tips[*tool];
        tip.pose.translation = target.translation;
        if whole {
            (tip.pose, tip.turns) = (*target, true);
        }
    }
    found.instrument_from_base
}

/// The fit.
#[derive(Clone, Debug)]
pub struct TouchFit {
    /// The arm.
    pub arm: TouchArm,
    /// What was touched.
    pub scene: Scene,
    /// Priors by the evidence.
    pub scales: Scales,
    /// Whether the arm is fitted, not features and tips alone.
    pub moves: bool,
    /// τ of every kind, in the order of [`Noise::ALL`].
    pub tau: [f64; Noise::ALL.len()],
    /// Weight of every row; zero of those that do not belong.
    pub weights: Vec<f64>,
    /// Equations less parameters that they determine, by kind of noise.
    pub freedom: [f64; Noise::ALL.len()],
    cells: Vec<Cell>,
}

/// What leaving out one state of the arm says.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// The rows of that state.
    pub rows: Vec<usize>,
    /// For each of them: the error of its components as the others predict it, in units of the reading.
    pub errors: Vec<Vec<f64>>,
    /// For each of them: √(χ²/components) of that error by its predicted covariance.
    pub sigmas: Vec<f64>,
    /// 1 − h of every component, summed by kind of noise.
    freedom: [f64; Noise::ALL.len()],
}

/// Rounds of noise, priors and parameters.
const ROUNDS: usize = 25;
/// Steps of a round.
const STEPS: usize = 12;
/// Huber's limit, in standard deviations.
const HUBER: f64 = 3.0;
/// Robust standard deviations from which a row does not belong.
const GROSS: f64 = 5.0;
/// Passes of leaving out.
const PASSES: usize = 4;

impl TouchFit {
    /// Features and tips on the arm as drawn.
    pub fn on_drawing(problem: &TouchProblem, orders: usize) -> Self {
        let set = problem.set;
        let arm = problem.arm(orders);
        let poses = arm.poses(&problem.states);
        let figures = (0..set.features.len())
            .map(|feature| {
                let rows = set.rows.iter().zip(&problem.state_of);
                let own = rows.filter(|(row, _)| row.reading.feature() == Some(feature));
                let own: Vec<_> = own.map(|(row, state)| (row, poses[*state])).collect();
                start::figure(set, feature, &own, &problem.gravity)
            })
            .collect();
        let scene = Scene::new(set, figures, set.camera, problem.instrument);
        let mut cells: Vec<Cell> = Vec::new();
        let mut index = std::collections::HashMap::new();
        for (row, state) in problem.state_of.iter().enumerate() {
            let group = scene.group_of(&set.rows[row].reading);
            let cell = *index.entry((*state, group)).or_insert_with(|| {
                cells.push(Cell {
                    state: *state,
                    group,
                    rows: Vec::new(),
                });
                cells.len() - 1
            });
            cells[cell].rows.push(row);
        }
        let mut out = Self {
            arm,
            scene,
            scales: Scales::new(&problem.class),
            moves: false,
            tau: Noise::ALL.map(|kind| 10.0 * kind.usual()),
            weights: vec![1.0; set.rows.len()],
            freedom: [0.0; Noise::ALL.len()],
            cells,
        };
        out.settle(problem, false);
        out
    }

    /// The arm and everything, from features on the drawing.
    pub fn new(problem: &TouchProblem, drawing: &Self) -> Self {
        let mut out = drawing.clone();
        out.moves = true;
        out.settle(problem, true);
        for pass in 0..PASSES {
            let Some(left_out) = out.left_out(problem) else {
                break;
            };
            if !out.reject(&left_out, pass) {
                break;
            }
            out.settle(problem, false);
        }
        out.settle(problem, false);
        out
    }

    /// Standard deviation of the prior of an arm's parameter; zero where it is not fitted.
    fn prior_of(&self, column: usize, problem: &TouchProblem) -> f64 {
        let column = &self.arm.columns[column];
        match column.group {
            Group::Tip => problem.set.tips.get(column.index).map_or(0.0, |t| t.sigma),
            Group::Turn => 1.0,
            group if self.moves => self.scales.of(group).unwrap_or(0.0),
            _ => 0.0,
        }
    }

    /// The priors of all parameters of the arm.
    pub fn priors(&self, problem: &TouchProblem) -> Vec<f64> {
        (0..self.arm.columns.len())
            .map(|j| self.prior_of(j, problem))
            .collect()
    }

    /// σ² + τ² of a component of a row.
    pub fn variance(&self, problem: &TouchProblem, row: usize, component: usize) -> f64 {
        let kind = Noise::of(&problem.set.rows[row].reading, component);
        problem.stated_variance(row, component) + self.tau[kind as usize].powi(2)
    }

    fn jet(&self, problem: &TouchProblem, row: usize, tip: &Pose<f64>) -> RowJet {
        self.scene
            .row(problem.set, &problem.set.rows[row].reading, tip)
    }

    /// Residuals of all rows.
    pub fn residuals(&self, problem: &TouchProblem) -> Vec<RowJet> {
        let poses = self.arm.poses(&problem.states);
        let rows = problem.state_of.iter().enumerate();
        rows.map(|(row, state)| self.jet(problem, row, &poses[*state]))
            .collect()
    }

    /// −2 log of the posterior density, up to what does not depend on the parameters.
    fn cost(&self, problem: &TouchProblem) -> f64 {
        let poses = self.arm.poses(&problem.states);
        let mut sum = 0.0;
        for (row, state) in problem.state_of.iter().enumerate() {
            let weight = self.weights[row];
            if weight > 0.0 {
                let jet = self.jet(problem, row, &poses[*state]);
                for i in 0..jet.count {
                    sum += weight * jet.residual[i].powi(2) / self.variance(problem, row, i);
                }
            }
        }
        let squared = |(x, sd): (&f64, f64)| if sd > 0.0 { (x / sd).powi(2) } else { 0.0 };
        let arm = self.arm.theta.iter().zip(self.priors(problem));
        let scene = self
            .scene
            .deviation
            .iter()
            .zip(self.scene.prior.iter().copied());
        sum += arm.map(squared).sum::<f64>() + scene.map(squared).sum::<f64>();
        for distance in &problem.set.distances {
            if let Some((missed, _)) = self.distance(distance.between, distance.distance) {
                sum += (missed / distance.sigma).powi(2);
            }
        }
        sum
    }

    /// By how much two features are farther apart than said, and the direction from the second to the first.
    pub fn distance(&self, between: [usize; 2], said: f64) -> Option<(f64, Vector3<f64>)> {
        let from = self.scene.centre(between[0])? - self.scene.centre(between[1])?;
        let length = from.norm();
        Some((length - said, from / length.max(1e-9)))
    }

    /// The normal equations at this point.
    fn equations(&self, problem: &TouchProblem, jets: &[StateJet]) -> Equations {
        let priors = self.priors(problem);
        let scene = &self.scene;
        let by_prior = |x: f64, sd: f64| if sd > 0.0 { x / sd } else { 0.0 };
        let theta = self.arm.theta.iter().zip(&priors);
        let arm: Vec<f64> = theta.map(|(x, sd)| by_prior(*x, *sd)).collect();
        let groups: Vec<Vec<f64>> = scene
            .groups
            .iter()
            .map(|group| {
                group
                    .clone()
                    .map(|i| by_prior(scene.deviation[i], scene.prior[i]))
                    .collect()
            })
            .collect();
        let mut out = Equations::new(&arm, &groups);
        let mut scaled: Option<(usize, Mat<f64>)> = None;
        for cell in &self.cells {
            let range = &scene.groups[cell.group];
            let mut sums = CellSums::new(range.len());
            let jet = &jets[cell.state];
            for row in &cell.rows {
                let weight = self.weights[*row];
                if weight == 0.0 {
                    continue;
                }
                let row_jet = self.jet(problem, *row, &jet.pose);
                let weights: Vec<f64> = (0..row_jet.count)
                    .map(|i| weight / self.variance(problem, *row, i))
                    .collect();
                sums.add(&row_jet, &weights, range.start, &scene.prior);
            }
            if scaled
                .as_ref()
                .is_none_or(|(state, _)| *state != cell.state)
            {
                let columns = |i: usize, j: usize| jet.jacobian[(i, j)] * priors[j];
                scaled = Some((cell.state, Mat::from_fn(6, priors.len(), columns)));
            }
            if let Some((_, jacobian)) = &scaled {
                out.add(cell.group, &sums, jacobian);
            }
        }
        for distance in &problem.set.distances {
            let Some((missed, direction)) = self.distance(distance.between, distance.distance)
            else {
                continue;
            };
            let firsts = distance.between.map(|feature| scene.first[feature]);
            let group = scene.group_of(&Reading::Point {
                feature: distance.between[0],
            });
            let range = &scene.groups[group];
            let sums = &mut out.groups[group];
            let mut row = Vec::with_capacity(6);
            for i in 0..3 {
                for (sign, first) in [(1.0, firsts[0]), (-1.0, firsts[1])] {
                    let at = first + i;
                    row.push((at - range.start, sign * direction[i] * scene.prior[at]));
                }
            }
            let weight = 1.0 / distance.sigma.powi(2);
            for (a, x) in &row {
                sums.right[(*a, 0)] -= weight * x * missed;
                for (b, y) in &row {
                    sums.own[(*a, *b)] += weight * x * y;
                }
            }
        }
        out
    }

    /// Moves to the most probable parameters at fixed noise, priors and weights.
    fn solve(&mut self, problem: &TouchProblem) {
        let mut damping = 1e-6;
        let mut before = self.cost(problem);
        for _ in 0..STEPS {
            let jets = self.arm.linearise(&problem.states);
            let equations = self.equations(problem, &jets);
            let priors = self.priors(problem);
            let mut gained = None;
            for _ in 0..10 {
                if let Some(solved) = equations.factor(damping) {
                    let candidate = self.moved(&solved, &priors);
                    let cost = candidate.cost(problem);
                    if cost.is_finite() && cost <= before {
                        gained = Some(before - cost);
                        (self.arm, self.scene) = (candidate.arm, candidate.scene);
                        before = cost;
                        damping = (damping * 0.1).max(1e-9);
                        break;
                    }
                }
                damping *= 10.0;
            }
            if gained.is_none_or(|g| g < 1e-6 * (1.0 + before)) {
                break;
            }
        }
    }

    fn moved(&self, solved: &Solved, priors: &[f64]) -> Self {
        let (arm, groups) = solved.step();
        let mut out = self.clone();
        let theta = self.arm.theta.iter().zip(priors).zip(&arm);
        let theta: Vec<f64> = theta.map(|((x, sd), step)| x + sd * step).collect();
        out.arm.update(&theta);
        let mut step = vec![0.0; self.scene.prior.len()];
        for (range, own) in self.scene.groups.iter().zip(&groups) {
            for (i, value) in range.clone().zip(own) {
                step[i] = value * self.scene.prior[i];
            }
        }
        out.scene.update(&step);
        out
    }

    /// The factored equations at this point.
    pub fn solved(&self, problem: &TouchProblem) -> Option<Solved> {
        let jets = self.arm.linearise(&problem.states);
        self.equations(problem, &jets).factor(0.0)
    }

    /// Parameters, noise and priors until they settle.
    fn settle(&mut self, problem: &TouchProblem, huber: bool) {
        for _ in 0..ROUNDS {
            self.solve(problem);
            let Some(left_out) = self.left_out(problem) else {
                return;
            };
            if huber {
                for left in &left_out {
                    for (row, sigma) in left.rows.iter().zip(&left.sigmas) {
                        if self.weights[*row] > 0.0 {
                            self.weights[*row] = (HUBER / sigma).min(1.0);
                        }
                    }
                }
            }
            let change = self.learn(problem, &left_out);
            if change < 0.01 {
                break;
            }
        }
    }

    /// Noise and priors that the evidence prefers: MacKay's fixed point with hyperpriors. Returns the largest relative change.
    fn learn(&mut self, problem: &TouchProblem, left_out: &[LeftOut]) -> f64 {
        let mut change = 0.0_f64;
        let residuals = self.residuals(problem);
        for kind in Noise::ALL {
            let (mut sum, mut stated, mut count) = (0.0, 0.0, 0.0);
            for (row, jet) in residuals.iter().enumerate() {
                let weight = self.weights[row];
                for i in 0..jet.count {
                    if weight > 0.0 && Noise::of(&problem.set.rows[row].reading, i) == kind {
                        sum += weight * jet.residual[i].powi(2);
                        stated += problem.stated_variance(row, i);
                        count += 1.0;
                    }
                }
            }
            if count == 0.0 {
                continue;
            }
            stated /= count;
            let freedom: f64 = left_out.iter().map(|l| l.freedom[kind as usize]).sum();
            self.freedom[kind as usize] = freedom;
            let usual = kind.usual().powi(2) + stated;
            let total = (sum + USUAL_ROWS * usual) / (freedom.max(0.0) + USUAL_ROWS);
            let before = stated + self.tau[kind as usize].powi(2);
            let after = total.max(stated);
            change = change.max((after / before - 1.0).abs());
            self.tau[kind as usize] = (after - stated).max(0.0).sqrt();
        }
        if !self.moves {
            return change;
        }
        let Some(solved) = self.solved(problem) else {
            return change;
        };
        let covariance = solved.covariance();
        let class = Scales::new(&problem.class);
        // What all scales of the class have in common, then each by itself.
        let (mut sum, mut known) = (COMMON_COUNTS, COMMON_COUNTS);
        for (j, column) in self.arm.columns.iter().enumerate() {
            if let (true, Some(sd)) = (column.group.is_of_class(), class.of(column.group)) {
                sum += (self.arm.theta[j] / sd).powi(2);
                known += (1.0 - covariance[(j, j)]).max(0.0);
            }
        }
        let common = (sum / known).sqrt().clamp(1.0 / CLASS_FACTOR, CLASS_FACTOR);
        for group in Group::LEARNT {
            let (Some(first), Some(before)) = (class.of(group), self.scales.of(group)) else {
                continue;
            };
            let (counts, factor, start) = match group.is_of_class() {
                true => (CLASS_COUNTS, CLASS_FACTOR, common * first),
                false => (OTHER_COUNTS, OTHER_FACTOR, first),
            };
            let (mut sum, mut known) = (counts * start * start, counts);
            for (j, column) in self.arm.columns.iter().enumerate() {
                if column.group == group {
                    sum += self.arm.theta[j].powi(2);
                    known += (1.0 - covariance[(j, j)]).max(0.0);
                }
            }
            let after = (sum / known).sqrt().clamp(first / factor, first * factor);
            change = change.max((after / before - 1.0).abs());
            self.scales.set(group, after);
        }
        change
    }

    /// Leaves out every state of the arm in turn, by the equations of all.
    pub fn left_out(&self, problem: &TouchProblem) -> Option<Vec<LeftOut>> {
        let jets = self.arm.linearise(&problem.states);
        let solved = self.equations(problem, &jets).factor(0.0)?;
        let priors = self.priors(problem);
        let mut rows_of = vec![Vec::new(); problem.states.len()];
        for (row, state) in problem.state_of.iter().enumerate() {
            rows_of[*state].push(row);
        }
        let of = |(state, rows): (usize, &Vec<usize>)| {
            self.left_out_state(problem, &jets[state], rows, &solved, &priors)
        };
        rows_of.iter().enumerate().map(of).collect()
    }

    fn left_out_state(
        &self,
        problem: &TouchProblem,
        jet: &StateJet,
        rows: &[usize],
        solved: &Solved,
        priors: &[f64],
    ) -> Option<LeftOut> {
        let jets: Vec<RowJet> = rows
            .iter()
            .map(|row| self.jet(problem, *row, &jet.pose))
            .collect();
        let count: usize = jets.iter().map(|j| j.count).sum();
        let scaled = Mat::from_fn(6, priors.len(), |i, j| jet.jacobian[(i, j)] * priors[j]);
        let mut tip = Mat::zeros(count, 6);
        let mut own: Vec<(usize, Mat<f64>)> = Vec::new();
        let mut noise = Vec::with_capacity(count);
        let mut residual = Vec::with_capacity(count);
        let mut weight = Vec::with_capacity(count);
        let mut kinds = Vec::with_capacity(count);
        for (row, row_jet) in rows.iter().zip(&jets) {
            let group = self.scene.group_of(&problem.set.rows[*row].reading);
            let range = self.scene.groups[group].clone();
            let at = match own.iter().position(|(g, _)| *g == group) {
                Some(at) => at,
                None => {
                    own.push((group, Mat::zeros(count, range.len())));
                    own.len() - 1
                }
            };
            for i in 0..row_jet.count {
                let r = noise.len();
                for a in 0..6 {
                    tip[(r, a)] = row_jet.tip[i][a];
                }
                for (index, column) in &row_jet.own {
                    own[at].1[(r, index - range.start)] += column[i] * self.scene.prior[*index];
                }
                noise.push(self.variance(problem, *row, i));
                residual.push(row_jet.residual[i]);
                weight.push(self.weights[*row]);
                kinds.push(Noise::of(&problem.set.rows[*row].reading, i));
            }
        }
        let arm = &tip * scaled;
        let covariance = solved.predictive(&arm, &own);
        // With e = (I − H W)⁻¹ r the error of what is left out, H its predicted covariance, W the weights that it had.
        let mut matrix = Mat::<f64>::identity(count, count);
        for i in 0..count {
            for j in 0..count {
                matrix[(i, j)] -= covariance[(i, j)] * weight[j] / noise[j];
            }
        }
        let mut freedom = [0.0; Noise::ALL.len()];
        for i in 0..count {
            if weight[i] > 0.0 {
                freedom[kinds[i] as usize] += matrix[(i, i)].clamp(0.0, 1.0);
            }
        }
        let right = Mat::from_column_slice(count, 1, &residual);
        let lu = matrix.lu();
        let error = lu.solve(&right)?;
        // Its covariance: (I − H W)⁻¹ H, and its own noise.
        let spread = lu.solve(&covariance)?;
        let mut errors = Vec::with_capacity(rows.len());
        let mut sigmas = Vec::with_capacity(rows.len());
        let mut first = 0;
        for row_jet in &jets {
            let c = row_jet.count;
            let block = Mat::from_fn(c, c, |i, j| {
                let (i, j) = (first + i, first + j);
                let own = if i == j { noise[i] } else { 0.0 };
                0.5 * (spread[(i, j)] + spread[(j, i)]) + own
            });
            let part = Mat::from_fn(c, 1, |i, _| error[(first + i, 0)]);
            let chi = Factor::new(block, 1).ok()?.solve(&part);
            let chi_squared: f64 = (0..c).map(|i| chi[(i, 0)] * part[(i, 0)]).sum();
            sigmas.push((chi_squared.max(0.0) / c as f64).sqrt());
            errors.push(part.as_slice().to_vec());
            first += c;
        }
        Some(LeftOut {
            rows: rows.to_vec(),
            errors,
            sigmas,
            freedom,
        })
    }

    /// Gives every row that all others do not predict the weight zero, and the others one. Returns whether that changes which.
    fn reject(&mut self, left_out: &[LeftOut], pass: usize) -> bool {
        let mut all: Vec<f64> = left_out
            .iter()
            .flat_map(|l| l.sigmas.iter().copied())
            .collect();
        all.sort_by(f64::total_cmp);
        // The median of √(χ²/c) is 0.67 for one component and 0.89 for three.
        let robust = (all.get(all.len() / 2).copied().unwrap_or(0.0) / 0.8).max(0.5);
        let mut changed = pass == 0;
        for left in left_out {
            for (row, sigma) in left.rows.iter().zip(&left.sigmas) {
                let belongs = *sigma <= GROSS * robust;
                changed |= belongs != (self.weights[*row] > 0.0);
                self.weights[*row] = if belongs { 1.0 } else { 0.0 };
            }
        }
        changed
    }
}
