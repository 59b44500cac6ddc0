//! Mistakes of a whole touch file: each is tried by a refit, and named only if the touches scatter much less with it.

use poegp_protocol::JointKind;

use crate::identification::touch::arm::Group;
use crate::identification::touch::fit::{ANY_ZERO, TouchFit, TouchProblem};
use crate::identification::touch::noise::Noise;
use crate::measurement::touch::{ClassPrior, Reading, TouchSet};
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
    /// The column of one joint is in radians or metres where degrees or millimetres are stated.
    UnitOf(usize),
    /// The zero of a joint differs by so much, rad or m.
    Offset(usize, f64),
    /// The touches are of this other robot.
    Robot(String),
    /// The readings of each feature belong to its rows before (-1) or behind (1).
    Rows(isize),
    /// The columns of the corners' coordinates are exchanged.
    Pixels,
}

impl Mistake {
    /// Returns whether the mistake is one of this robot's joints.
    pub fn is_of_joints(&self) -> bool {
        match self {
            Self::Sign(_) | Self::Swap(..) | Self::Unit | Self::UnitOf(_) | Self::Offset(..) => {
                true
            }
            Self::Robot(_) | Self::Rows(_) | Self::Pixels => false,
        }
    }
}

/// A mistake with the scatter of the touches as given and without the mistake, in the unit of `kind`.
#[derive(Clone, Debug, PartialEq)]
pub struct Explained {
    /// The mistake.
    pub mistake: Mistake,
    /// The kind of which the mistake explains most.
    pub kind: Noise,
    /// Root mean square error of a component on the fitted arm, as given and without the mistake.
    pub scatter: [f64; 2],
    /// Other mistakes that explain the touches as well.
    pub others: Vec<Mistake>,
}

/// Scatter beyond the stated noise above which mistakes are tried, by kind: m, rad and pixels.
const LARGE: (f64, f64, f64) = (1e-3, 5e-3, 5.0);
/// Share of the scatter that a mistake may leave, on the nominal model and on the fitted arm.
const LEFT: (f64, f64) = (0.5, 0.25);
/// Factor within which another mistake explains the touches as well.
const AS_GOOD: f64 = 2.0;
/// Mistakes that are compared on the fitted arm.
const TRIED: usize = 4;
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

/// Root mean square residuals of each kind, with the number of equations.
type Residuals = Vec<(Noise, f64, f64)>;

/// Returns the root mean square residual of every kind.
fn residuals(problem: &TouchProblem, fit: &TouchFit) -> Residuals {
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

/// Returns the set with the reading of each row replaced by that of the row of the same feature `by` rows further on. Rows
/// beyond which there is none are left out.
fn with_readings_of(set: &TouchSet, by: isize) -> TouchSet {
    let mut of_feature = vec![Vec::new(); set.features.len()];
    for (i, row) in set.rows.iter().enumerate() {
        if let Reading::Anchor { feature, .. } | Reading::Level { feature, .. } = row.reading {
            of_feature[feature].push(i);
        }
    }
    let mut out = set.clone();
    let mut is_kept = vec![true; set.rows.len()];
    for rows in &of_feature {
        for (n, i) in rows.iter().enumerate() {
            match n.checked_add_signed(by).and_then(|n| rows.get(n)) {
                Some(other) => out.rows[*i].reading = set.rows[*other].reading,
                None => is_kept[*i] = false,
            }
        }
    }
    let mut is_kept = is_kept.into_iter();
    out.rows.retain(|_| is_kept.next() == Some(true));
    out
}

/// Returns the set with the coordinates of every corner exchanged.
fn with_pixels_exchanged(set: &TouchSet) -> TouchSet {
    let mut out = set.clone();
    for row in &mut out.rows {
        if let Reading::Board { u, v, .. } = &mut row.reading {
            std::mem::swap(u, v);
        }
    }
    out
}

/// Returns how many of the smaller unit of a joint, a degree or a millimetre, make one radian or metre.
fn smaller_units(robot: &Robot, joint: usize) -> f64 {
    match robot.joints[joint].kind {
        JointKind::Revolute => 1_f64.to_degrees(),
        JointKind::Prismatic => 1e3,
    }
}

/// Returns the set as it is without a mistake.
fn without(robot: &Robot, set: &TouchSet, mistake: &Mistake) -> TouchSet {
    match mistake {
        Mistake::Rows(by) => return with_readings_of(set, -by),
        Mistake::Pixels => return with_pixels_exchanged(set),
        _ => {}
    }
    with_joints(robot, set, |q| match mistake {
        Mistake::Sign(joint) => q[*joint] = -q[*joint],
        Mistake::Swap(a, b) => q.swap(*a, *b),
        Mistake::Unit => q.iter_mut().for_each(|q| *q = q.to_degrees()),
        Mistake::UnitOf(joint) => q[*joint] *= smaller_units(robot, *joint),
        Mistake::Offset(joint, by) => q[*joint] += by,
        Mistake::Robot(_) | Mistake::Rows(_) | Mistake::Pixels => {}
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
    let fit = TouchFit::new(&free, &TouchFit::on_nominal(&free, 0));
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

/// Returns the mistakes that the readings of these touches may have.
fn of_readings(set: &TouchSet) -> Vec<Mistake> {
    let has = |is: fn(&Reading) -> bool| set.rows.iter().any(|row| is(&row.reading));
    let mut out = Vec::new();
    if has(|reading| matches!(reading, Reading::Anchor { .. } | Reading::Level { .. })) {
        out.extend([Mistake::Rows(-1), Mistake::Rows(1)]);
    }
    if has(|reading| matches!(reading, Reading::Board { .. })) {
        out.push(Mistake::Pixels);
    }
    out
}

/// Returns the mistake that explains why touches scatter much, if there is one. `nominal_arm` and `fit` are those of the set
/// as given.
pub fn explained(
    robot: &Robot,
    problem: &TouchProblem,
    (nominal_arm, fit): (&TouchFit, &TouchFit),
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
        .chain((0..joints).map(Mistake::UnitOf))
        .chain(offsets(problem))
        .chain(robots.map(|name| Mistake::Robot((*name).to_owned())))
        .chain(of_readings(problem.set));
    let given = scatter(problem, nominal_arm);
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
        let left = scatter(&other, &TouchFit::on_nominal(&other, 0)) - given;
        if left < libm::log(LEFT.0) {
            tried.push((left, mistake, robot, set));
        }
    }
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut fitted: Vec<(f64, Mistake, Residuals)> = Vec::new();
    for (_, mistake, robot, set) in tried.into_iter().take(TRIED) {
        let Some(other) = of(&robot, problem, &set) else {
            continue;
        };
        let refit = TouchFit::new(&other, &TouchFit::on_nominal(&other, 0));
        let left = residuals(&other, &refit);
        fitted.push((scatter(&other, &refit), mistake, left));
    }
    fitted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = fitted.first()?;
    if best.0 - scatter(problem, fit) > libm::log(LEFT.1) {
        return None;
    }
    let as_good = fitted[1..].iter();
    let as_good = as_good.filter(|f| f.0 < best.0 + libm::log(AS_GOOD));
    // The kind of which the mistake explains most.
    let given = residuals(problem, fit);
    let pairs = given.iter().filter_map(|(kind, rms, _)| {
        let left = best.2.iter().find(|left| left.0 == *kind)?;
        Some((*kind, [*rms, left.1]))
    });
    let (kind, scatter) = pairs.max_by(|(_, a), (_, b)| {
        let share = |[given, left]: &[f64; 2]| given / left.max(1e-12);
        share(a).total_cmp(&share(b))
    })?;
    Some(Explained {
        mistake: best.1.clone(),
        kind,
        scatter,
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
