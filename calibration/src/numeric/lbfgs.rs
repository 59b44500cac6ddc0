//! Minimisation of a smooth function in a box, behind a trait of our own.
//!
//! The method is L-BFGS-B, taken from `basin` (a port of Nocedal's v3.0 that is tested against it iteration by
//! iteration). The trait keeps that young library out of every signature of this crate.

use std::cell::RefCell;

use basin::{
    ApplicationStop, BoxBounds, ConstraintSet, Constraints, CostFunction, Executor,
    FirstOrderState, Gradient, Lbfgs, State, Termination,
};

use crate::progress::{Cancelled, FitContext};

/// A function with its gradient.
pub trait Objective {
    /// Value and gradient at `x`; an infinite value rejects the point.
    fn value_and_gradient(&self, x: &[f64]) -> (f64, Vec<f64>);
}

/// How a search ended; the later, the worse.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SearchEnd {
    /// At a minimum, by gradient or reduction.
    Converged,
    /// After the most iterations that it may have.
    IterationLimit,
    /// No step lowered the value any more, though the gradient is not small.
    NoProgress,
}

/// Where [`minimize`] ended.
#[derive(Clone, Debug)]
pub struct Minimum {
    /// The best point of all that were looked at, the first among them.
    pub x: Vec<f64>,
    /// Its value.
    pub value: f64,
    /// How the search ended.
    pub end: SearchEnd,
    /// Iterations that it took.
    pub iterations: u64,
}

struct BoundedProblem<'a, O> {
    objective: &'a O,
    context: &'a FitContext<'a>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    best: &'a RefCell<(f64, Vec<f64>)>,
}

impl<O: Objective> BoundedProblem<'_, O> {
    fn evaluated(&self, x: &[f64]) -> (f64, Vec<f64>) {
        let found = self.objective.value_and_gradient(x);
        let mut best = self.best.borrow_mut();
        if found.0 < best.0 {
            *best = (found.0, x.to_vec());
        }
        found
    }
}

impl<O> Constraints for BoundedProblem<'_, O> {
    type Set = ConstraintSet<BoxBounds<Vec<f64>>>;

    fn constraints(&self) -> <Self::Set as basin::ConstraintDescription>::Borrowed<'_> {
        ConstraintSet::new().with_bounds(BoxBounds::new(Some(&self.lower), Some(&self.upper)))
    }
}

impl<O: Objective> CostFunction for BoundedProblem<'_, O> {
    type Param = Vec<f64>;
    type Output = f64;
    type Error = Cancelled;

    fn cost(&self, x: &Vec<f64>) -> Result<f64, Cancelled> {
        Ok(self.evaluated(x).0)
    }
}

impl<O: Objective> Gradient for BoundedProblem<'_, O> {
    type Gradient = Vec<f64>;

    fn gradient(&self, x: &Vec<f64>) -> Result<Vec<f64>, Cancelled> {
        Ok(self.evaluated(x).1)
    }

    fn cost_and_gradient(&self, x: &Vec<f64>) -> Result<(f64, Vec<f64>), Cancelled> {
        self.context.step()?;
        Ok(self.evaluated(x))
    }
}

/// When a search ends.
#[derive(Clone, Copy, Debug)]
pub struct StopCriteria {
    /// Most iterations.
    pub iterations: u64,
    /// A step that lowers the value by no more than this part of it is the last.
    pub reduction: f64,
    /// A value that is known already: a search that has come within `distance` of it from above, by a step that was no
    /// longer than that, goes where somebody has been, and ends.
    pub known: f64,
    /// In units of the value.
    pub distance: f64,
    /// Five iterations that together lower the value by less than this, in its units, are the last.
    pub least_fall: f64,
}

/// Iterations whose fall is looked at together: one of them alone may be small.
const WINDOW: usize = 5;

impl StopCriteria {
    /// Nothing is known yet.
    pub const fn after(iterations: u64, reduction: f64) -> Self {
        Self {
            iterations,
            reduction,
            known: f64::NEG_INFINITY,
            distance: 0.0,
            least_fall: 0.0,
        }
    }

    /// The same, but the value may stop falling before.
    pub const fn falling_by(self, least_fall: f64) -> Self {
        Self { least_fall, ..self }
    }
}

/// The lowest point found from `start` within `bounds` (lower, upper): never one above the start.
///
/// Deterministic.
///
/// # Errors
/// [`Cancelled`].
pub fn minimize<O: Objective>(
    objective: &O,
    start: &[f64],
    bounds: &[(f64, f64)],
    ending: &StopCriteria,
    context: &FitContext,
) -> Result<Minimum, Cancelled> {
    let clamped: Vec<f64> = start
        .iter()
        .zip(bounds)
        .map(|(x, (lower, upper))| x.clamp(*lower, *upper))
        .collect();
    let best = RefCell::new((f64::INFINITY, clamped.clone()));
    let problem = BoundedProblem {
        objective,
        context,
        best: &best,
        lower: bounds.iter().map(|b| b.0).collect(),
        upper: bounds.iter().map(|b| b.1).collect(),
    };
    let solver = Lbfgs::new()
        .with_absolute_projected_gradient_tolerance(1e-4)
        .with_relative_cost_reduction_tolerance(ending.reduction);
    let StopCriteria {
        known,
        distance,
        least_fall,
        ..
    } = *ending;
    let mut before = [f64::INFINITY; WINDOW];
    let enough = move |state: &FirstOrderState<Vec<f64>>| {
        let value = state.cost();
        let within = |gap: f64| (0.0..=distance).contains(&gap);
        let (last, first) = (before[WINDOW - 1], before[0]);
        let repeats = within(value - known) && within(last - value);
        before.rotate_left(1);
        before[WINDOW - 1] = value;
        (repeats || first - value < least_fall).then(|| ApplicationStop::new("enough"))
    };
    let run = Executor::new(problem, solver, FirstOrderState::new(clamped))
        .max_iter(ending.iterations)
        .stop_when(enough)
        .run();
    context.check()?;
    let (end, iterations) = match &run {
        Ok(result) => (end_of(&result.report.termination), result.iter()),
        Err(_) => (SearchEnd::NoProgress, 0),
    };
    let (value, x) = best.into_inner();
    Ok(Minimum {
        x,
        value,
        end,
        iterations,
    })
}

fn end_of(termination: &Termination) -> SearchEnd {
    match termination {
        Termination::Converged(_) | Termination::Target { .. } | Termination::Application(_) => {
            SearchEnd::Converged
        }
        Termination::Limit(_) => SearchEnd::IterationLimit,
        _ => SearchEnd::NoProgress,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STOP: StopCriteria = StopCriteria::after(200, 1e-10);

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

    fn minimum(bounds: &[(f64, f64)], ending: &StopCriteria) -> Minimum {
        let context = FitContext::default();
        minimize(&Rosenbrock, &[-1.2, 1.0], bounds, ending, &context).unwrap()
    }

    #[test]
    fn finds_the_minimum_inside_and_on_the_edge_of_the_box() {
        let inside = minimum(&[(-2.0, 2.0); 2], &STOP);
        assert!(
            (inside.x[0] - 1.0).abs() < 1e-3 && inside.value < 1e-6,
            "{inside:?}"
        );
        let edge = minimum(&[(-2.0, 0.5), (-2.0, 2.0)], &STOP);
        assert!(
            (edge.x[0] - 0.5).abs() < 1e-6 && (edge.x[1] - 0.25).abs() < 1e-3,
            "{edge:?}"
        );
    }

    /// A search that is cut short says so, and one with no step to go stays where it is: none ends above its start.
    #[test]
    fn says_how_it_ended_and_never_ends_above_its_start() {
        let within = [(-2.0, 2.0); 2];
        let begin = Rosenbrock.value_and_gradient(&[-1.2, 1.0]).0;
        let whole = minimum(&within, &STOP);
        assert_eq!(whole.end, SearchEnd::Converged);
        let short = minimum(&within, &StopCriteria::after(3, 1e-10));
        assert_eq!(
            (short.end, short.iterations),
            (SearchEnd::IterationLimit, 3)
        );
        assert!(whole.value < short.value && short.value <= begin);
        let context = FitContext::default();
        let stuck = minimize(&Plateau, &[0.5], &[(-2.0, 2.0)], &STOP, &context).unwrap();
        assert_eq!(stuck.end, SearchEnd::NoProgress);
        assert_eq!((stuck.x, stuck.value), (vec![0.5], 0.0));
    }

    /// Higher everywhere than at 0.5, where the gradient promises a way down.
    struct Plateau;

    impl Objective for Plateau {
        fn value_and_gradient(&self, x: &[f64]) -> (f64, Vec<f64>) {
            (if x[0] == 0.5 { 0.0 } else { 1.0 }, vec![-1.0])
        }
    }

    #[test]
    fn ends_where_somebody_has_been_and_not_far_above_or_below() {
        let from = |known: f64| {
            let ending = StopCriteria {
                known,
                distance: 0.01,
                ..STOP
            };
            minimum(&[(-2.0, 2.0); 2], &ending).value
        };
        let known = from(0.0);
        assert!((1e-6..0.01).contains(&known), "{known}");
        for other in [0.5, -0.5] {
            let value = from(other);
            assert!(value < 1e-6, "{other}: {value}");
        }
    }
}
