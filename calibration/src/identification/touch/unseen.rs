//! What touches cannot determine: named directions of the arm's parameters that are known no better than before the
//! touches.
//!
//! Along a direction d of parameters with the prior covariance Λ, the unknown share is √(uᵀ Σ u / uᵀ u) with u = Λ^(−1/2)
//! d and Σ the posterior covariance in units of the prior. From [`UNSEEN`] on, the direction is named, with its effect at
//! the tip.

use nalgebra::Vector3;
use serde::Serialize;

use crate::identification::touch::arm::Group;
use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::identification::touch::volume::Knowledge;
use crate::measurement::touch::{FeatureKind, Reading};
use crate::numeric::matrix::Mat;
use crate::numeric::product::product;

/// Ratio of posterior to prior standard deviation from which a direction is unseen.
pub const UNSEEN: f64 = 0.9;
/// Replaces [`UNSEEN`] for the size: between the two limits there is noise, which more touches overcome.
pub const SIZE_UNSEEN: f64 = 0.95;
/// Share of the expected error below which a direction is not worth reporting.
const WORTH_SAYING: f64 = 0.1;
/// Length in m below which a link has no length direction of its own.
const SHORTEST: f64 = 0.03;
/// Mean absolute value of a standard normal variable.
const MEAN_MODULUS: f64 = 0.797_884_560_802_865_4;

/// The quantity that changes along a direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// All lengths in proportion: the size of the arm.
    Size,
    /// The size of the arm, where a board determines it weakly.
    SizeByBoard,
    /// Everything beside heights: one plane shows heights only.
    HeightsOnly,
    /// Everything beside directions: a level shows directions only.
    DirectionsOnly,
    /// Length of the link behind a joint, numbered from 1.
    Length(usize),
    /// Zero of a joint, numbered from 1.
    Zero(usize),
}

/// A direction that the touches do not determine.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unseen {
    /// The direction.
    pub direction: Direction,
    /// Ratio of posterior to prior standard deviation.
    pub share: f64,
    /// Remaining position error, averaged over the work volume, in mm.
    pub mm: f64,
    /// Description in one sentence.
    pub text: String,
}

/// Returns all unseen directions, largest effect first.
pub fn unseen(problem: &TouchProblem, fit: &TouchFit, known: &Knowledge) -> Vec<Unseen> {
    let stays = known.after.mean_mm;
    if readings(problem, fit).all(|r| matches!(r, Reading::Level { .. })) {
        return vec![Unseen {
            direction: Direction::DirectionsOnly,
            share: 1.0,
            mm: stays,
            text: format!(
                "A level shows directions only, no length: an error of {stays:.2} mm remains on average. Also touch a \
                 point in many orientations."
            ),
        }];
    }
    let mut out = Vec::new();
    if one_plane(problem, fit) {
        out.push(Unseen {
            direction: Direction::HeightsOnly,
            share: 1.0,
            mm: stays,
            text: format!(
                "One plane shows heights only: an error of {stays:.2} mm remains on average. Touch two more planes \
                 that are perpendicular to it."
            ),
        });
    }
    let joints = problem.nominal.kinds().len();
    match unseen_size(problem, fit, known) {
        Some(size) => out.push(size),
        None => out.extend((1..joints).filter_map(|f| unseen_length(problem, fit, known, f))),
    }
    // The zero of the first joint belongs to the base, that of the last to the tip.
    let inner = 1..joints.saturating_sub(1);
    out.extend(inner.filter_map(|joint| unseen_zero(fit, known, joint)));
    out.sort_by(|a, b| b.mm.total_cmp(&a.mm));
    out
}

/// Returns the readings that the fit uses.
fn readings<'a>(problem: &'a TouchProblem, fit: &'a TouchFit) -> impl Iterator<Item = &'a Reading> {
    let rows = problem.set.rows.iter().zip(&fit.weights);
    rows.filter(|(_, w)| **w > 0.0).map(|(row, _)| &row.reading)
}

/// Returns the frame's translation in its own axes, m.
fn lever(problem: &TouchProblem, frame: usize) -> Vector3<f64> {
    let frame = &problem.nominal.frames()[frame];
    frame.rotation.transpose() * frame.translation
}

/// Adds the direction in which the link of a frame becomes longer.
fn add_length(u: &mut [f64], problem: &TouchProblem, fit: &TouchFit, priors: &[f64], frame: usize) {
    let lever = lever(problem, frame);
    let mut axis = 0;
    for (j, column) in fit.arm.columns.iter().enumerate() {
        if column.group == Group::Length && column.index == frame {
            u[j] = lever[axis] / priors[j];
            axis += 1;
        }
    }
}

/// Returns the size of the arm if it is unseen.
fn unseen_size(problem: &TouchProblem, fit: &TouchFit, known: &Knowledge) -> Option<Unseen> {
    let mut u = vec![0.0; known.priors.len()];
    for frame in 1..problem.nominal.kinds().len() {
        add_length(&mut u, problem, fit, &known.priors, frame);
    }
    let (share, mm) = measure(&u, known).filter(|(share, _)| *share > SIZE_UNSEEN)?;
    let percent = 100.0 * share * spread(&u);
    let stays = format!("±{percent:.2} % remains, {mm:.2} mm on average");
    let has_board = readings(problem, fit).any(|r| matches!(r, Reading::Board { .. }));
    let has_length = || {
        !problem.set.distances.is_empty()
            || readings(problem, fit).any(|r| measures_length(problem, r))
    };
    let text = if has_board {
        format!(
            "Only the board shows the arm's size, and these images hardly do: {stays}. Take images from farther \
             apart."
        )
    } else if has_length() {
        format!(
            "The lengths in these touches hardly show the arm's size: {stays}. State a longer or more accurate \
             distance, or touch more often."
        )
    } else if readings(problem, fit).all(|r| matches!(r, Reading::Plane { .. })) {
        format!(
            "Planes cannot show the arm's size: {stays}. State one known distance of 200 mm or more between \
             touched points."
        )
    } else {
        format!(
            "Touches at unknown points cannot show the arm's size: {stays}. State one known distance of 200 mm or \
             more."
        )
    };
    let direction = match has_board {
        true => Direction::SizeByBoard,
        false => Direction::Size,
    };
    Some(Unseen {
        direction,
        share,
        mm,
        text,
    })
}

/// Returns whether a reading is of something whose length is known.
fn measures_length(problem: &TouchProblem, reading: &Reading) -> bool {
    match *reading {
        Reading::Anchor { .. } => true,
        Reading::Sphere { feature, .. } => {
            let kind = &problem.set.features[feature].kind;
            matches!(
                kind,
                FeatureKind::Sphere {
                    radius: Some(_),
                    ..
                }
            )
        }
        _ => false,
    }
}

/// Returns the length of the link behind a joint if it is unseen.
fn unseen_length(
    problem: &TouchProblem,
    fit: &TouchFit,
    known: &Knowledge,
    frame: usize,
) -> Option<Unseen> {
    if lever(problem, frame).norm() <= SHORTEST {
        return None;
    }
    let mut u = vec![0.0; known.priors.len()];
    add_length(&mut u, problem, fit, &known.priors, frame);
    let (share, mm) = measure(&u, known).filter(|found| is_unseen(*found, known))?;
    Some(Unseen {
        direction: Direction::Length(frame),
        share,
        mm,
        text: format!(
            "The length of the link after joint {frame} is known no better than from the nominal model: {mm:.2} mm \
             on average. Touch with joint {frame} turned further."
        ),
    })
}

/// Returns the zero of a joint, counted from 0, if it is unseen.
fn unseen_zero(fit: &TouchFit, known: &Knowledge, joint: usize) -> Option<Unseen> {
    let mut u = vec![0.0; known.priors.len()];
    for (u, column) in u.iter_mut().zip(&fit.arm.columns) {
        if column.group == Group::Zero && column.index == joint {
            *u = 1.0;
        }
    }
    let (share, mm) = measure(&u, known).filter(|found| is_unseen(*found, known))?;
    let name = joint + 1;
    Some(Unseen {
        direction: Direction::Zero(name),
        share,
        mm,
        text: format!(
            "The zero of joint {name} is known no better than before: {mm:.2} mm on average. Touch with joint {name} at very \
             different angles."
        ),
    })
}

/// Returns whether a direction is unseen and worth reporting, by the ratio of posterior to prior along it and its effect in
/// mm.
fn is_unseen((share, mm): (f64, f64), known: &Knowledge) -> bool {
    share > UNSEEN && mm > WORTH_SAYING * known.after.mean_mm
}

/// Returns the relative change of size that one prior standard deviation along `u` stands for: the weighted mean of
/// independent links.
fn spread(u: &[f64]) -> f64 {
    let squared: f64 = u.iter().map(|x| x * x).sum();
    if squared > 0.0 {
        1.0 / squared.sqrt()
    } else {
        0.0
    }
}

/// Returns the ratio of posterior to prior along `u`, and its effect in mm; `None` if `u` is zero.
fn measure(u: &[f64], known: &Knowledge) -> Option<(f64, f64)> {
    let squared: f64 = u.iter().map(|x| x * x).sum();
    if squared <= 0.0 {
        return None;
    }
    let u = Mat::from_column_slice(u.len(), 1, u) / squared.sqrt();
    let posterior = product(&known.covariance, &u);
    let variance: f64 = (0..u.nrows()).map(|i| u[(i, 0)] * posterior[(i, 0)]).sum();
    let share = variance.max(0.0).sqrt();
    let moved = product(&known.field, &u);
    let poses = moved.nrows() / 3;
    let length = |k: usize| {
        (0..3)
            .map(|i| moved[(3 * k + i, 0)].powi(2))
            .sum::<f64>()
            .sqrt()
    };
    let mean = (0..poses).map(length).sum::<f64>() / poses.max(1) as f64;
    Some((share, 1e3 * MEAN_MODULUS * share * mean))
}

/// Returns whether one plane is all that determines lengths.
fn one_plane(problem: &TouchProblem, fit: &TouchFit) -> bool {
    let mut planes = Vec::new();
    for (row, weight) in problem.set.rows.iter().zip(&fit.weights) {
        match row.reading {
            _ if *weight == 0.0 => {}
            Reading::Plane { feature, .. } => planes.push(feature),
            Reading::Level { .. } => {}
            _ => return false,
        }
    }
    planes.sort_unstable();
    planes.dedup();
    planes.len() == 1
}
