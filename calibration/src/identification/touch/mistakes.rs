//! Mistakes of a whole touch file: each is tried by a refit, and named only if the touches scatter much less with it.

use crate::identification::touch::arm::Group;
use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::identification::touch::noise::Noise;
use crate::measurement::touch::{ClassPrior, TouchSet};
use crate::robot::{BUILT_IN, LoadOptions, Robot};

/// A mistake of a whole file.
#[derive(Clone, Debug, PartialEq)]
pub enum Mistake {
    /// A joint is reversed.
    Sign(usize),
    /// The columns of two joints are exchanged.
    Swap(usize, usize),
    /// The joints are in radians where degrees are stated.
    Unit,
    /// The zero of a joint differs by so much, rad or m.
    Offset(usize, f64),
    /// The touches are of this other robot.
    Robot(String),
}

/// A mistake with the scatter of the touches as given and without the mistake, in the unit of `kind`.
#[derive(Clone, Debug, PartialEq)]
pub struct Explained {
    /// The mistake.
    pub mistake: Mistake,
    /// Kind of noise with most equations.
    pub kind: Noise,
    /// Root mean square error of a component on the fitted arm, as given and without the mistake.
    pub scatter: [f64; 2],
    /// Other mistakes that explain the touches as well.
    pub others: Vec<Mistake>,
}

/// Scatter beyond the stated noise above which mistakes are tried, by kind: m, rad and pixels.
const LARGE: (f64, f64, f64) = (1e-3, 5e-3, 5.0);
/// Share of the scatter that a mistake may leave, on the drawing and on the fitted arm.
const LEFT: (f64, f64) = (0.5, 0.25);
/// Factor within which another mistake explains the touches as well.
const AS_GOOD: f64 = 2.0;
/// Mistakes that are compared on the fitted arm.
const TRIED: usize = 4;
/// Standard deviation of a joint zero of which nothing is known, rad or m.
const ANY_ZERO: f64 = 0.1;
/// Smallest and largest zero that is named, rad or m.
const ZERO: std::ops::Range<f64> = 0.01..0.7;

/// Returns whether touches scatter so much that mistakes are tried.
fn is_large(problem: &TouchProblem, fit: &TouchFit) -> bool {
    problem.set.rows.iter().any(|row| {
        (0..row.reading.equations()).any(|i| {
            let kind = Noise::of(&row.reading, i);
            fit.tau[kind as usize]
                > match kind {
                    Noise::Board => LARGE.2,
                    kind if kind.is_length() => LARGE.0,
                    _ => LARGE.1,
                }
        })
    })
}

/// Returns the root mean square residual of every kind, with its number of equations.
fn residuals(problem: &TouchProblem, fit: &TouchFit) -> Vec<(Noise, f64, f64)> {
    let mut sums = [(0.0, 0.0); Noise::ALL.len()];
    for (row, jet) in fit.residuals(problem).iter().enumerate() {
        for i in 0..jet.count {
            let kind = Noise::of(&problem.set.rows[row].reading, i);
            let own = &mut sums[kind as usize];
            own.0 += jet.residual[i].powi(2);
            own.1 += 1.0;
        }
    }
    let all = Noise::ALL.into_iter().zip(sums);
    let occurs = all.filter(|(_, (_, count))| *count > 0.0);
    occurs
        .map(|(kind, (sum, count))| (kind, (sum / count).sqrt(), count))
        .collect()
}

/// Returns the mean logarithm of the residuals, all kinds together.
fn scatter(problem: &TouchProblem, fit: &TouchFit) -> f64 {
    let (mut sum, mut all) = (0.0, 0.0);
    for (kind, rms, count) in residuals(problem, fit) {
        sum += count * 0.5 * libm::log(rms * rms + kind.usual().powi(2));
        all += count;
    }
    sum / f64::max(all, 1.0)
}

/// Returns a set with other joints.
fn with_joints(robot: &Robot, set: &TouchSet, change: impl Fn(&mut Vec<f64>)) -> TouchSet {
    let mut out = set.clone();
    for row in &mut out.rows {
        change(&mut row.joints);
        row.serial_joints = robot.serial_joints(&row.joints);
    }
    out
}

/// Returns the set as it is without a mistake.
fn without(robot: &Robot, set: &TouchSet, mistake: &Mistake) -> TouchSet {
    with_joints(robot, set, |q| match mistake {
        Mistake::Sign(joint) => q[*joint] = -q[*joint],
        Mistake::Swap(a, b) => q.swap(*a, *b),
        Mistake::Unit => q.iter_mut().for_each(|q| *q = q.to_degrees()),
        Mistake::Offset(joint, by) => q[*joint] += by,
        Mistake::Robot(_) => {}
    })
}

/// Returns the zeros that may be wrong: that of the joint that a fit with free zeros moves most, by either sign.
fn offsets(problem: &TouchProblem) -> Vec<Mistake> {
    let free = TouchProblem {
        class: ClassPrior {
            joint_zero: ANY_ZERO,
            ..problem.class
        },
        ..problem.clone()
    };
    let fit = TouchFit::new(&free, &TouchFit::on_drawing(&free, 0));
    let zeros = fit.arm.columns.iter().zip(&fit.arm.theta);
    let zeros = zeros.filter(|(column, _)| column.group == Group::Zero);
    let most = zeros.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let most = most.filter(|(_, zero)| ZERO.contains(&zero.abs()));
    most.map_or(Vec::new(), |(column, zero)| {
        vec![
            Mistake::Offset(column.index, *zero),
            Mistake::Offset(column.index, -zero),
        ]
    })
}

/// Returns the mistake that explains why touches scatter much, if there is one. `drawing` and `fit` are those of the set as
/// given.
pub fn explained(
    robot: &Robot,
    problem: &TouchProblem,
    (drawing, fit): (&TouchFit, &TouchFit),
) -> Option<Explained> {
    if !is_large(problem, fit) {
        return None;
    }
    let joints = robot.joints.len();
    let signs = (0..joints).map(Mistake::Sign);
    let swaps = (0..joints).flat_map(|a| (a + 1..joints).map(move |b| Mistake::Swap(a, b)));
    let robots = BUILT_IN.iter().filter(|name| **name != robot.name);
    let all = signs
        .chain(swaps)
        .chain([Mistake::Unit])
        .chain(offsets(problem))
        .chain(robots.map(|name| Mistake::Robot((*name).to_owned())));
    let given = scatter(problem, drawing);
    let mut tried: Vec<(f64, Mistake, Robot, TouchSet)> = Vec::new();
    for mistake in all {
        let robot = match &mistake {
            Mistake::Robot(name) => Robot::load(name, &LoadOptions::default()).ok(),
            _ => Some(robot.clone()),
        };
        let Some(robot) = robot.filter(|other| other.joints.len() == joints) else {
            continue;
        };
        let set = without(&robot, problem.set, &mistake);
        let Some(other) = of(&robot, problem, &set) else {
            continue;
        };
        let left = scatter(&other, &TouchFit::on_drawing(&other, 0)) - given;
        if left < libm::log(LEFT.0) {
            tried.push((left, mistake, robot, set));
        }
    }
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut fitted: Vec<(f64, Mistake, f64)> = Vec::new();
    let (kind, rms, _) = residuals(problem, fit)
        .into_iter()
        .max_by(|a, b| a.2.total_cmp(&b.2))?;
    for (_, mistake, robot, set) in tried.into_iter().take(TRIED) {
        let Some(other) = of(&robot, problem, &set) else {
            continue;
        };
        let refit = TouchFit::new(&other, &TouchFit::on_drawing(&other, 0));
        let of_kind = residuals(&other, &refit).into_iter();
        let left = of_kind.filter(|r| r.0 == kind).map(|r| r.1).sum::<f64>();
        fitted.push((scatter(&other, &refit), mistake, left));
    }
    fitted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = fitted.first()?;
    if best.0 - scatter(problem, fit) > libm::log(LEFT.1) {
        return None;
    }
    let as_good = fitted[1..].iter();
    let as_good = as_good.filter(|f| f.0 < best.0 + libm::log(AS_GOOD));
    Some(Explained {
        mistake: best.1.clone(),
        kind,
        scatter: [rms, best.2],
        others: as_good.map(|f| f.1.clone()).collect(),
    })
}

/// Returns the problem of another set or robot.
fn of<'a>(robot: &Robot, problem: &TouchProblem, set: &'a TouchSet) -> Option<TouchProblem<'a>> {
    let nominal = robot.chain().ok()?;
    let coupling = robot.coupling.clone();
    Some(TouchProblem::new(
        set,
        &nominal,
        coupling,
        problem.gravity,
        problem.class,
    ))
}
