//! Finds rows of two kinds that alternate: two targets, two places of the instrument or two zeros of a joint that no column
//! tells apart.
//!
//! The geometry settles between both kinds, and the residuals form two clusters: along the target's axes if the targets
//! differ, along the instrument's if it stood in two places, along the motion of a joint if its zero changed.

use nalgebra::Vector3;
use poegp_protocol::cause::Cause;

use crate::identification::parametric::state::ROWS;
use crate::numeric::matrix::Mat;
use crate::numeric::svd::Svd;
use crate::trust::change_points::{Part, REFUSED, changes, needed};
use crate::trust::finding::{Finding, Tier};
use crate::trust::geometry::Geometry;
use crate::trust::readings::Data;
use crate::trust::wording::{length, lines};

/// Smallest number of rows, and the smallest share of them that is a kind of its own: fewer rows are outliers.
const LEAST: (usize, f64) = (16, 0.15);
/// Share of the variance that the distance of the clusters must explain: of one normal cluster that is cut in the middle it
/// is 0.64, of a sine wave 0.81.
const APART: f64 = 0.88;

/// Most changes of the kind along the rows of a file that was joined from two.
pub const BLOCK: usize = 3;
/// Standard deviations by which the kinds change less often along a joint's values than by chance, where they follow it.
const FOLLOWED: f64 = 5.0;

/// Returns a warning or a refusal if there are two kinds of rows.
pub fn examine(data: &Data<'_>, geometry: &Geometry) -> Option<Finding> {
    let count = geometry.samples.len();
    if count < LEAST.0 {
        return None;
    }
    let needed = needed(geometry);
    let halves = [Part::Tool, Part::Base].map(|part| [(part, 0), (part, 3)]);
    let joints = (0..geometry.state.layout.joints).map(|j| (Part::Joint(j), 0));
    let directions = halves.into_iter().flatten().chain(joints);
    let candidates = directions.filter_map(|(part, first)| {
        let rows = clusters(geometry, part, first)?;
        let changes = changes(geometry, &rows);
        let change = changes.into_iter().find(|c| c.part == part)?;
        (change.drop > needed).then_some((rows, change))
    });
    let (rows, change) = candidates.max_by(|a, b| a.1.drop.total_cmp(&b.1.drop))?;
    let mut kinds = vec![false; count];
    rows.iter().for_each(|k| kinds[*k] = true);
    // Which target or which zero a row has may follow a joint, too: only one of several targets may be in sight.
    if change.part == Part::Base
        && let Some(text) = not_straight(data, &kinds, change.displacement)
    {
        return Some(change.finding((Cause::Mixed, Tier::Warning), text, needed, count));
    }
    let rows: Vec<usize> = rows.iter().map(|k| data.line(*k)).collect();
    let what = match change.part {
        Part::Tool => {
            "another target or reflector; give these rows a session of their own".to_owned()
        }
        Part::Joint(j) => format!(
            "another zero of joint {}; calibrate from rows of one zero",
            j + 1
        ),
        _ => "another position of the instrument; calibrate from rows of one position".to_owned(),
    };
    let text = format!(
        "{} of {count} rows ({}) are {} from where the others would be: {what}",
        rows.len(),
        lines(&rows),
        length(change.displacement)
    );
    let mixed = (Cause::Mixed, change.tier());
    Some(change.finding(mixed, text, needed, count).of_rows(rows))
}

/// Says that an axis is not straight, if a joint's values decide the kinds of the rows and the kinds differ by no more than an
/// axis does: in the order of these values, the kind changes far less often than by chance (the test of Wald and Wolfowitz,
/// Annals of Mathematical Statistics 1940). Of a file that was joined from two nothing is said: the poses of both may differ, too.
pub fn not_straight(data: &Data<'_>, kinds: &[bool], displacement: f64) -> Option<String> {
    let turns = |order: &[usize]| {
        let turns = order.windows(2).filter(|w| kinds[w[0]] != kinds[w[1]]);
        turns.count()
    };
    let rows: Vec<usize> = (0..kinds.len()).collect();
    if turns(&rows) <= BLOCK || displacement > REFUSED {
        return None;
    }
    let n = kinds.len() as f64;
    let of_second = kinds.iter().filter(|kind| **kind).count() as f64;
    let expected = 2.0 * of_second * (n - of_second) / n;
    let deviation = (expected * (expected - 1.0) / (n - 1.0)).sqrt();
    let fewer = |joint: usize| {
        let mut order = rows.clone();
        let value = |k: usize| data.samples[k].joints[joint];
        order.sort_by(|a, b| value(*a).total_cmp(&value(*b)));
        (joint, (expected - turns(&order) as f64) / deviation)
    };
    let all = (0..data.robot.joints.len()).map(fewer);
    let (joint, fewer) = all.max_by(|a, b| a.1.total_cmp(&b.1))?;
    (fewer > FOLLOWED).then(|| {
        format!(
            "the errors of the rows are of two kinds, which differ by {} and follow joint {}: an axis or a rail that is not \
             straight does this; no geometry describes it, and the method `elastic` learns it where it was measured",
            length(displacement),
            joint + 1
        )
    })
}

/// Returns for each row the change of a joint's zero that explains most of its residual.
fn zeros(geometry: &Geometry, joint: usize) -> Mat<f64> {
    let of = |k: usize| {
        let moved = |i: usize| geometry.linear.jacobian[(ROWS * k + i, joint)];
        let square: f64 = (0..ROWS).map(|i| moved(i).powi(2)).sum();
        let seen: f64 = (0..ROWS).map(|i| moved(i) * geometry.residuals[k][i]).sum();
        seen / square.max(f64::MIN_POSITIVE)
    };
    Mat::from_fn(geometry.samples.len(), 1, |k, _| of(k))
}

/// Returns three components of the residuals of each row, in the axes of a part: positions from 0 on, rotations from 3 on.
fn turned(geometry: &Geometry, part: Part, first: usize) -> Mat<f64> {
    let mut turned = Mat::zeros(geometry.samples.len(), 3);
    for (k, residual) in geometry.residuals.iter().enumerate() {
        let mut seen = Vector3::from_fn(|i, _| geometry.weights[k].sqrt() * residual[first + i]);
        if part == Part::Tool {
            let sample = &geometry.samples[k];
            let chain = geometry.state.chain(sample.tool);
            seen = chain.forward(&sample.serial_joints).rotation.transpose() * seen;
        }
        turned.row_mut(k).copy_from(&seen.transpose());
    }
    turned
}

/// Cuts the rows in two along the principal axis of what their residuals show of a part. Returns the smaller part if both are
/// well apart.
fn clusters(geometry: &Geometry, part: Part, first: usize) -> Option<Vec<usize>> {
    let count = geometry.samples.len();
    let mut turned = match part {
        Part::Joint(joint) => zeros(geometry, joint),
        _ => turned(geometry, part, first),
    };
    for mut column in turned.column_iter_mut() {
        let mean = column.sum() / count as f64;
        column.add_scalar_mut(-mean);
    }
    let along = &turned * Svd::new(&turned)?.v.column(0);
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| along[*a].total_cmp(&along[*b]));
    let all: f64 = along.iter().map(|x| x * x).sum();
    // The sum of all is 0: a cut after `rows` of them, whose sum is s, explains s² (1/rows + 1/others).
    let least = (LEAST.1 * count as f64).ceil() as usize;
    let mut sum = 0.0;
    let mut best = (0, 0.0);
    for (i, k) in order.iter().enumerate() {
        sum += along[*k];
        let (rows, others) = (i + 1, count - i - 1);
        if rows.min(others) >= least {
            let explained = sum * sum * (1.0 / rows as f64 + 1.0 / others as f64);
            if explained > best.1 {
                best = (rows, explained);
            }
        }
    }
    let (low, high) = order.split_at(best.0);
    let mut rows = if low.len() < high.len() { low } else { high }.to_vec();
    rows.sort_unstable();
    (best.1 > APART * all).then_some(rows)
}
