//! Fits the arm and its surroundings, most probable given all rows, by Levenberg–Marquardt, with noise and priors chosen
//! by the evidence.
//!
//! A component of a row has the variance σ² + τ²: σ is stated, and τ is what this kind of row misses by beyond σ, because
//! of seats and gears that no parameter describes. Rows that all others fail to predict are left out and listed.

use poegp_runtime::math::se3::Pose;

use crate::identification::touch::arm::{Group, StateJet, TouchArm};
use crate::identification::touch::equations::{Equations, Solved, VisitSums};
use crate::identification::touch::jet::RowJet;
use crate::identification::touch::scene::Scene;
use crate::identification::touch::shared_errors::{SharedErrors, USUAL_JOINT};
use crate::identification::touch::sisters::SisterPrior;
use crate::identification::touch::start;
use crate::numeric::matrix::Mat;

pub use crate::identification::touch::noise::{Noise, Scales};
pub use crate::identification::touch::problem::TouchProblem;

/// Rows that belong to one group and to one state of the arm.
#[derive(Clone, Debug)]
struct Visit {
    state: usize,
    group: usize,
    rows: Vec<usize>,
}

/// A fit of the arm and its surroundings to touches.
#[derive(Clone, Debug)]
pub struct TouchFit {
    /// The arm at its fitted parameters.
    pub arm: TouchArm,
    /// Features, camera and instrument at their fitted unknowns.
    pub scene: Scene,
    /// Scales of the priors, chosen by the evidence.
    pub scales: Scales,
    /// Whether the arm is fitted, in addition to features and tips.
    pub moves: bool,
    /// τ of every kind of noise, in the order of [`Noise::ALL`].
    pub tau: [f64; Noise::ALL.len()],
    /// Standard deviation of the errors of the joints that the readings of one image share, rad or m.
    pub joint_scatter: f64,
    /// Weight of every row; zero for rows that do not belong.
    pub weights: Vec<f64>,
    /// Number of equations minus the parameters that they determine, for each kind of noise.
    pub freedom: [f64; Noise::ALL.len()],
    /// Factor by which the priors of the class are wider than `scales`, or than the sisters' spread.
    pub(super) width: f64,
    visits: Vec<Visit>,
}

/// Standard deviation of the size of an arm of any size, relative to its nominal model.
pub(super) const ANY_SIZE: f64 = 0.1;
/// Standard deviation of a joint zero of which nothing is known, rad or m.
pub(super) const ANY_ZERO: f64 = 0.1;
/// Most rounds over noise, priors and parameters.
const ROUNDS: usize = 25;
/// Most steps in a round.
const STEPS: usize = 12;
/// Limit of Huber's weights, in standard deviations.
const HUBER: f64 = 3.0;
/// Most passes of leaving rows out.
const PASSES: usize = 4;

/// Returns the rows of `problem` by group and state.
fn visits(problem: &TouchProblem, scene: &Scene) -> Vec<Visit> {
    let mut visits: Vec<Visit> = Vec::new();
    let mut index = std::collections::HashMap::new();
    for (row, state) in problem.state_of.iter().enumerate() {
        let group = scene.group_of(&problem.set.rows[row].reading);
        let visit = *index.entry((*state, group)).or_insert_with(|| {
            visits.push(Visit {
                state: *state,
                group,
                rows: Vec::new(),
            });
            visits.len() - 1
        });
        visits[visit].rows.push(row);
    }
    visits
}

impl TouchFit {
    /// Fits features and tips on the nominal arm.
    pub fn on_nominal(problem: &TouchProblem, orders: usize) -> Self {
        let mut out = Self::on_arm(problem, problem.arm(orders));
        out.settle(problem, false);
        out
    }

    /// Fits features and tips on the nominal arm, without the rows of weight zero.
    pub fn on_nominal_without(problem: &TouchProblem, weights: &[f64]) -> Self {
        Self::on_arm(problem, problem.arm(0)).weighted(problem, weights)
    }

    /// Fits features and tips on a known arm: `flanges` are base_from_flange in the states of the problem. Rows that do
    /// not belong are left out.
    pub fn on_known(problem: &TouchProblem, flanges: &[Pose<f64>]) -> Self {
        let arm = TouchArm::known(&problem.nominal, &problem.tips, flanges);
        let mut out = Self::on_arm(problem, arm);
        out.settle(problem, false);
        out.settle_robustly(problem);
        out
    }

    /// Refits with exactly the rows of weight zero left out.
    #[must_use]
    pub fn weighted(mut self, problem: &TouchProblem, weights: &[f64]) -> Self {
        self.weights = weights.to_vec();
        self.settle(problem, false);
        self
    }

    /// Returns this fit beside further rows, which have no part in it: the first rows of `problem` are those of this fit.
    #[must_use]
    pub fn beside(&self, problem: &TouchProblem) -> Self {
        let mut out = self.clone();
        out.weights.resize(problem.set.rows.len(), 0.0);
        out.visits = visits(problem, &out.scene);
        out
    }

    /// Creates the initial state on `arm`: features at rough estimates, nominal tips.
    fn on_arm(problem: &TouchProblem, arm: TouchArm) -> Self {
        let set = problem.set;
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
        let visits = visits(problem, &scene);
        Self {
            arm,
            scene,
            scales: Scales::new(&problem.class),
            moves: false,
            tau: Noise::ALL.map(|kind| 10.0 * kind.usual()),
            joint_scatter: USUAL_JOINT,
            weights: vec![1.0; set.rows.len()],
            freedom: [0.0; Noise::ALL.len()],
            width: 1.0,
            visits,
        }
    }

    /// Fits the arm and everything else, starting from features fitted on the nominal model.
    pub fn new(problem: &TouchProblem, nominal_arm: &Self) -> Self {
        let mut out = nominal_arm.clone();
        out.moves = true;
        out.settle_robustly(problem);
        out
    }

    /// Iterates to convergence and leaves out the rows that do not belong.
    pub(super) fn settle_robustly(&mut self, problem: &TouchProblem) {
        self.settle(problem, true);
        for pass in 0..PASSES {
            let Some(left_out) = self.left_out(problem) else {
                break;
            };
            if !self.reject(&left_out, pass) {
                break;
            }
            self.settle(problem, false);
        }
        self.settle(problem, false);
    }

    /// Returns the prior standard deviation of a parameter of the arm; zero where it is not fitted.
    fn prior_of(&self, column: usize, problem: &TouchProblem) -> f64 {
        let column = &self.arm.columns[column];
        match column.group {
            Group::Tip => problem.set.tips.get(column.index).map_or(0.0, |t| t.sigma),
            Group::Turn => 1.0,
            Group::Size if self.moves => ANY_SIZE,
            Group::Zero if self.moves && problem.is_lost(column) => ANY_ZERO,
            group if self.moves && group.is_of_class() && problem.sisters.is_none() => {
                self.width * self.scales.of(group).unwrap_or(0.0)
            }
            group if self.moves => self.scales.of(group).unwrap_or(0.0),
            _ => 0.0,
        }
    }

    /// Returns the columns of the class parameters.
    pub(super) fn class_columns(&self) -> Vec<usize> {
        let columns = self.arm.columns.iter().enumerate();
        let of_class = columns.filter(|(_, column)| column.group.is_of_class());
        of_class.map(|(j, _)| j).collect()
    }

    /// Returns the sisters' prior and the arm's parameters in units of the class, if the arm is fitted and has sisters.
    fn by_sisters<'a>(&self, problem: &'a TouchProblem) -> Option<(&'a SisterPrior, Vec<f64>)> {
        let sisters = problem.sisters.as_ref().filter(|_| self.moves)?;
        let priors = self.priors(problem);
        let columns = self.class_columns().into_iter();
        let theta = columns.map(|j| self.arm.theta[j] / priors[j]).collect();
        Some((sisters, theta))
    }

    /// Returns the prior standard deviations of all parameters of the arm.
    pub fn priors(&self, problem: &TouchProblem) -> Vec<f64> {
        (0..self.arm.columns.len())
            .map(|j| self.prior_of(j, problem))
            .collect()
    }

    /// Returns the variance σ² + τ² of a component of a row.
    pub fn variance(&self, problem: &TouchProblem, row: usize, component: usize) -> f64 {
        let kind = Noise::of(&problem.set.rows[row].reading, component);
        problem.stated_variance(row, component) + self.tau[kind as usize].powi(2)
    }

    pub(super) fn jet(&self, problem: &TouchProblem, row: usize, tip: &Pose<f64>) -> RowJet {
        self.scene
            .row(problem.set, &problem.set.rows[row].reading, tip)
    }

    /// Returns the linearised rows, with their residuals.
    pub fn residuals(&self, problem: &TouchProblem) -> Vec<RowJet> {
        let poses = self.arm.poses(&problem.states);
        let rows = problem.state_of.iter().enumerate();
        rows.map(|(row, state)| self.jet(problem, row, &poses[*state]))
            .collect()
    }

    /// Returns −2 log of the posterior density, up to terms that do not depend on the parameters.
    pub(super) fn cost(&self, problem: &TouchProblem) -> f64 {
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
        let shared = self.shared_errors(problem, &poses);
        sum -= shared.map(|shared| shared.explained()).sum::<f64>();
        let squared = |(x, sd): (&f64, f64)| if sd > 0.0 { (x / sd).powi(2) } else { 0.0 };
        let arm = self.arm.theta.iter().zip(self.priors(problem));
        let scene = self
            .scene
            .deviation
            .iter()
            .zip(self.scene.prior.iter().copied());
        sum += arm.map(squared).sum::<f64>() + scene.map(squared).sum::<f64>();
        if let Some((by_sisters, theta)) = self.by_sisters(problem) {
            let (more, _) = by_sisters.beyond_identity(&theta, self.width);
            sum += more;
        }
        for distance in &problem.set.distances {
            if let Some((missed, _)) = self.distance(distance.between, distance.distance) {
                sum += (missed / distance.sigma).powi(2);
            }
        }
        sum
    }

    /// Returns the shared errors of all visits that have some.
    pub(super) fn shared_errors(
        &self,
        problem: &TouchProblem,
        poses: &[Pose<f64>],
    ) -> impl Iterator<Item = SharedErrors> {
        self.visits.iter().filter_map(|visit| {
            let motions = problem.joint_motions[visit.state].as_ref()?;
            let sums = self.visit_sums(problem, visit, &poses[visit.state]);
            SharedErrors::new(&sums, motions, self.joint_scatter)
        })
    }

    /// Returns the normal equations at the current parameters.
    pub(super) fn equations(&self, problem: &TouchProblem, jets: &[StateJet]) -> Equations {
        let mut out = self.equations_of_rows(problem, jets);
        for known in &problem.set.distances {
            self.add_distance(known, &mut out);
        }
        out
    }

    /// Returns the normal equations of the prior and the rows, without known distances.
    pub(super) fn equations_of_rows(&self, problem: &TouchProblem, jets: &[StateJet]) -> Equations {
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
        if let Some((by_sisters, theta)) = self.by_sisters(problem) {
            by_sisters.add(&theta, self.width, &self.class_columns(), &mut out);
        }
        let mut scaled: Option<(usize, Mat<f64>)> = None;
        for visit in &self.visits {
            let jet = &jets[visit.state];
            let mut sums = self.visit_sums(problem, visit, &jet.pose);
            if let Some(motions) = &problem.joint_motions[visit.state] {
                // Where they cannot be factored, the errors have no effect.
                if let Some(shared) = SharedErrors::new(&sums, motions, self.joint_scatter) {
                    shared.eliminate(&mut sums, motions);
                }
            }
            if scaled
                .as_ref()
                .is_none_or(|(state, _)| *state != visit.state)
            {
                let columns = |i: usize, j: usize| jet.jacobian[(i, j)] * priors[j];
                scaled = Some((visit.state, Mat::from_fn(6, priors.len(), columns)));
            }
            if let Some((_, jacobian)) = &scaled {
                out.add(visit.group, &sums, jacobian);
            }
        }
        out
    }

    /// Returns the sums of a visit, as if its rows shared no error.
    fn visit_sums(&self, problem: &TouchProblem, visit: &Visit, tip: &Pose<f64>) -> VisitSums {
        let range = &self.scene.groups[visit.group];
        let mut sums = VisitSums::new(range.len());
        for row in visit.rows.iter().filter(|row| self.weights[**row] > 0.0) {
            let jet = self.jet(problem, *row, tip);
            let weights: Vec<f64> = (0..jet.count)
                .map(|i| self.weights[*row] / self.variance(problem, *row, i))
                .collect();
            sums.add(&jet, &weights, range.start, &self.scene.prior);
        }
        sums
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

    /// Returns the factored normal equations at the current parameters; `None` when they cannot be factored.
    pub fn solved(&self, problem: &TouchProblem) -> Option<Solved> {
        let jets = self.arm.linearise(&problem.states);
        self.equations(problem, &jets).factor(0.0)
    }

    /// Iterates parameters, noise and priors until they settle; `huber` also weights the rows.
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
}
