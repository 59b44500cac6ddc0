//! Known distances between features: their equations, and the distances that the touches alone give.

use nalgebra::Vector3;

use crate::identification::touch::equations::Equations;
use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::measurement::touch::{KnownDistance, Reading};
use crate::numeric::matrix::Mat;

/// A distance by everything except its own stated value, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Mean of the distance.
    pub distance: f64,
    /// Standard deviation of the distance, by the touches, τ and the arm's class.
    pub sigma: f64,
}

/// Derivative of a distance by the unknowns of the group that contains both features, in units of their priors.
struct Gradient {
    group: usize,
    /// Pairs of an index in the group and the derivative.
    columns: [(usize, f64); 6],
}

impl TouchFit {
    /// Returns how much farther apart two features are than stated, in m, and the direction from the second to the first;
    /// `None` if a feature has no centre.
    pub fn distance(&self, between: [usize; 2], said: f64) -> Option<(f64, Vector3<f64>)> {
        let from = self.scene.centre(between[0])? - self.scene.centre(between[1])?;
        let length = from.norm();
        Some((length - said, from / length.max(1e-9)))
    }

    fn gradient(&self, between: [usize; 2], direction: &Vector3<f64>) -> Gradient {
        let scene = &self.scene;
        let group = scene.group_of(&Reading::Point {
            feature: between[0],
        });
        let start = scene.groups[group].start;
        let columns = std::array::from_fn(|k| {
            let (end, i) = (k / 3, k % 3);
            let at = scene.first[between[end]] + i;
            let sign = if end == 0 { 1.0 } else { -1.0 };
            (at - start, sign * direction[i] * scene.prior[at])
        });
        Gradient { group, columns }
    }

    pub(super) fn add_distance(&self, known: &KnownDistance, out: &mut Equations) {
        let Some((missed, direction)) = self.distance(known.between, known.distance) else {
            return;
        };
        let gradient = self.gradient(known.between, &direction);
        let sums = &mut out.groups[gradient.group];
        let weight = 1.0 / known.sigma.powi(2);
        for (a, x) in &gradient.columns {
            sums.right[(*a, 0)] -= weight * x * missed;
            for (b, y) in &gradient.columns {
                sums.own[(*a, *b)] += weight * x * y;
            }
        }
    }

    /// Computes every known distance from the touches and the other distances, to first order about the fit; `None` for
    /// features without a centre, and when the equations cannot be solved.
    pub fn measured_distances(&self, problem: &TouchProblem) -> Vec<Option<Measured>> {
        let known = &problem.set.distances;
        if known.is_empty() {
            return Vec::new();
        }
        let jets = self.arm.linearise(&problem.states);
        let rows = self.equations_of_rows(problem, &jets);
        let without = |index: usize| {
            let (missed, direction) = self.distance(known[index].between, known[index].distance)?;
            let mut equations = rows.clone();
            for (other, known) in known.iter().enumerate() {
                if other != index {
                    self.add_distance(known, &mut equations);
                }
            }
            let solved = equations.factor(0.0)?;
            let (arm, groups) = solved.step();
            let Gradient { group, columns } = self.gradient(known[index].between, &direction);
            let moved: f64 = columns.iter().map(|(at, x)| x * groups[group][*at]).sum();
            let mut own = Mat::zeros(1, groups[group].len());
            for (at, x) in columns {
                own[(0, at)] += x;
            }
            let variance = solved.predictive(&Mat::zeros(1, arm.len()), &[(group, own)]);
            Some(Measured {
                distance: known[index].distance + missed + moved,
                sigma: variance[(0, 0)].max(0.0).sqrt(),
            })
        };
        (0..known.len()).map(without).collect()
    }

    /// Computes the distance between two features from the touches alone, in a set without known distances.
    pub fn distance_by_touches(
        &self,
        problem: &TouchProblem,
        between: [usize; 2],
    ) -> Option<Measured> {
        let (distance, direction) = self.distance(between, 0.0)?;
        let scene = &self.scene;
        let own = [(between[0], 1.0), (between[1], -1.0)].map(|(feature, sign)| {
            let group = scene.group_of(&Reading::Point { feature });
            let range = &scene.groups[group];
            let mut columns = Mat::zeros(1, range.len());
            for i in 0..3 {
                let at = scene.first[feature] + i;
                columns[(0, at - range.start)] = sign * direction[i] * scene.prior[at];
            }
            (group, columns)
        });
        let arm = Mat::zeros(1, self.arm.columns.len());
        let variance = self.solved(problem)?.predictive(&arm, &own);
        Some(Measured {
            distance,
            sigma: variance[(0, 0)].max(0.0).sqrt(),
        })
    }
}
