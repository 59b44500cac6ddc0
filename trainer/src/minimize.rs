//! Minimisation of a smooth function in a box, behind a trait of our own.
//!
//! The method is L-BFGS-B, taken from `basin` (a port of Nocedal's v3.0 that is tested against it iteration by
//! iteration). The trait keeps that young library out of every signature of this crate.

use std::convert::Infallible;

use basin::{
    BoxBounds, ConstraintSet, Constraints, CostFunction, Executor, FirstOrderState, Gradient, Lbfgs,
};

/// A function with its gradient.
pub trait Objective {
    /// Value and gradient at `x`; an infinite value rejects the point.
    fn value_and_gradient(&self, x: &[f64]) -> (f64, Vec<f64>);
}

/// Where [`minimize`] ended.
#[derive(Clone, Debug)]
pub struct Minimum {
    /// The best point.
    pub x: Vec<f64>,
    /// Its value.
    pub value: f64,
}

struct Boxed<'a, O> {
    objective: &'a O,
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl<O> Constraints for Boxed<'_, O> {
    type Set = ConstraintSet<BoxBounds<Vec<f64>>>;

    fn constraints(&self) -> <Self::Set as basin::ConstraintDescription>::Borrowed<'_> {
        ConstraintSet::new().with_bounds(BoxBounds::new(Some(&self.lower), Some(&self.upper)))
    }
}

impl<O: Objective> CostFunction for Boxed<'_, O> {
    type Param = Vec<f64>;
    type Output = f64;
    type Error = Infallible;

    fn cost(&self, x: &Vec<f64>) -> Result<f64, Infallible> {
        Ok(self.objective.value_and_gradient(x).0)
    }
}

impl<O: Objective> Gradient for Boxed<'_, O> {
    type Gradient = Vec<f64>;

    fn gradient(&self, x: &Vec<f64>) -> Result<Vec<f64>, Infallible> {
        Ok(self.objective.value_and_gradient(x).1)
    }

    fn cost_and_gradient(&self, x: &Vec<f64>) -> Result<(f64, Vec<f64>), Infallible> {
        Ok(self.objective.value_and_gradient(x))
    }
}

/// The lowest point found from `start` within `bounds` (lower, upper), in at most `iterations` iterations.
///
/// Deterministic. Falls back to `start` when the search cannot begin there.
pub fn minimize<O: Objective>(
    objective: &O,
    start: &[f64],
    bounds: &[(f64, f64)],
    iterations: u64,
) -> Minimum {
    let clamped: Vec<f64> = start
        .iter()
        .zip(bounds)
        .map(|(x, (lower, upper))| x.clamp(*lower, *upper))
        .collect();
    let problem = Boxed {
        objective,
        lower: bounds.iter().map(|b| b.0).collect(),
        upper: bounds.iter().map(|b| b.1).collect(),
    };
    let solver = Lbfgs::new()
        .with_absolute_projected_gradient_tolerance(1e-4)
        .with_relative_cost_reduction_tolerance(1e-10);
    let run = Executor::new(problem, solver, FirstOrderState::new(clamped.clone()))
        .max_iter(iterations)
        .run();
    match run {
        Ok(result) if result.cost().is_finite() => Minimum {
            x: result.param().clone(),
            value: result.cost(),
        },
        _ => Minimum {
            value: objective.value_and_gradient(&clamped).0,
            x: clamped,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Rosenbrock;

    impl Objective for Rosenbrock {
        fn value_and_gradient(&self, x: &[f64]) -> (f64, Vec<f64>) {
            let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
            (
                a * a + 100.0 * b * b,
                vec![-2.0 * a - 400.0 * x[0] * b, 200.0 * b],
            )
        }
    }

    #[test]
    fn finds_the_minimum_inside_and_on_the_edge_of_the_box() {
        let inside = minimize(&Rosenbrock, &[-1.2, 1.0], &[(-2.0, 2.0); 2], 200);
        assert!(
            (inside.x[0] - 1.0).abs() < 1e-3 && inside.value < 1e-6,
            "{inside:?}"
        );
        let edge = minimize(&Rosenbrock, &[-1.2, 1.0], &[(-2.0, 0.5), (-2.0, 2.0)], 200);
        assert!(
            (edge.x[0] - 0.5).abs() < 1e-6 && (edge.x[1] - 0.25).abs() < 1e-3,
            "{edge:?}"
        );
    }
}
