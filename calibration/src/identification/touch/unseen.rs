//! What touches cannot determine: named directions of the arm's parameters that are known no better than before the
//! touches.
//!
//! Along a direction d of parameters with the prior covariance Λ, the unknown share is √(uᵀ Σ u / uᵀ u) with u = Λ^(−1/2)
//! d and Σ the posterior covariance in units of the prior. From [`UNSEEN`] on, the direction is named, with its effect at
//! the tip.

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
    let mut out = Vec::new();
    let readings = || {
        let rows = problem.set.rows.iter().zip(&fit.weights);
        rows.filter(|(_, w)| **w > 0.0).map(|(row, _)| &row.reading)
    };
    let stays = known.after.mean_mm;
    if readings().all(|r| matches!(r, Reading::Level { .. })) {
        out.push(Unseen {
            direction: Direction::DirectionsOnly,
            share: 1.0,
            mm: stays,
            text: format!(
                "A level shows directions only, no length: an error of {stays:.2} mm remains on average. Also touch a \
                 point in many orientations."
            ),
        });
        return out;
    }
    let n = problem.nominal.kinds().len();
    let frames = problem.nominal.frames();
    let lever = |frame: usize| frames[frame].rotation.transpose() * frames[frame].translation;
    let along = |frame: usize, u: &mut [f64], priors: &[f64]| {
        let mut axis = 0;
        for (j, column) in fit.arm.columns.iter().enumerate() {
            if column.group == Group::Length && column.index == frame {
                u[j] = lever(frame)[axis] / priors[j];
                axis += 1;
            }
        }
    };
    let priors = &known.priors;
    let p = priors.len();
    let mut size = vec![0.0; p];
    for frame in 1..n {
        along(frame, &mut size, priors);
    }
    let measured = |u: &[f64]| measure(u, known);
    let plane = one_plane(problem, fit);
    if plane {
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
    let mut sees_size = true;
    if let Some((share, mm)) = measured(&size)
        && share > SIZE_UNSEEN
    {
        sees_size = false;
        let percent = 100.0 * share * spread(&size);
        let stays = format!("±{percent:.2} % remains, {mm:.2} mm on average");
        let has_board = readings().any(|r| matches!(r, Reading::Board { .. }));
        let measures_length = |reading: &Reading| match *reading {
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
        };
        let text = if has_board {
            format!(
                "Only the board shows the arm's size, and these images hardly do: {stays}. Take images from farther \
                 apart."
            )
        } else if !problem.set.distances.is_empty() || readings().any(measures_length) {
            format!(
                "The lengths in these touches hardly show the arm's size: {stays}. State a longer or more accurate \
                 distance, or touch more often."
            )
        } else if readings().all(|r| matches!(r, Reading::Plane { .. })) {
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
        out.push(Unseen {
            direction,
            share,
            mm,
            text,
        });
    }
    for frame in (1..n).filter(|f| sees_size && lever(*f).norm() > SHORTEST) {
        let mut u = vec![0.0; p];
        along(frame, &mut u, priors);
        if let Some((share, mm)) = measured(&u)
            && share > UNSEEN
            && mm > WORTH_SAYING * stays
        {
            out.push(Unseen {
                direction: Direction::Length(frame),
                share,
                mm,
                text: format!(
                    "The length of the link after joint {frame} is known no better than from the nominal model: {mm:.2} mm \
                     on average. Touch with joint {frame} turned further."
                ),
            });
        }
    }
    // The zero of the first joint belongs to the base, that of the last to the tip.
    for joint in 1..n.saturating_sub(1) {
        let mut u = vec![0.0; p];
        for (j, column) in fit.arm.columns.iter().enumerate() {
            if column.group == Group::Zero && column.index == joint {
                u[j] = 1.0;
            }
        }
        if let Some((share, mm)) = measured(&u)
            && share > UNSEEN
            && mm > WORTH_SAYING * stays
        {
            let name = joint + 1;
            out.push(Unseen {
                direction: Direction::Zero(name),
                share,
                mm,
                text: format!(
                    "The zero of joint {name} is known no better than before: {mm:.2} mm on average. Touch with joint {name} at very \
                     different angles."
                ),
            });
        }
    }
    out.sort_by(|a, b| b.mm.total_cmp(&a.mm));
    out
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
