//! What touches cannot tell: named directions of the arm's parameters along which they are known no better than before.
//!
//! Along a direction d of parameters with the prior covariance Λ the share that is unknown is √(uᵀ Σ u / uᵀ u) with u = Λ^(−1/2) d and
//! Σ the posterior in units of the prior. From [`UNSEEN`] on it is named, with what it is worth at the tip.

use serde::Serialize;

use crate::identification::touch::arm::Group;
use crate::identification::touch::fit::{TouchFit, TouchProblem};
use crate::identification::touch::volume::Knowledge;
use crate::measurement::touch::Reading;
use crate::numeric::matrix::Mat;
use crate::numeric::product::product;

/// Posterior over prior from which a direction is unseen.
pub const UNSEEN: f64 = 0.9;
/// That limit for the size: what is between is noise, which more touches overcome.
pub const SIZE_UNSEEN: f64 = 0.95;
/// Share of the expected error below which nobody need know.
const WORTH_SAYING: f64 = 0.1;
/// Shorter links have no length of their own, m.
const SHORTEST: f64 = 0.03;
/// Mean of the modulus of a standard normal number.
const MEAN_MODULUS: f64 = 0.797_884_560_802_865_4;

/// What a direction is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// All lengths in proportion.
    Size,
    /// The same, where a board tells it weakly.
    SizeByBoard,
    /// One plane tells heights alone.
    HeightsOnly,
    /// A level tells directions alone.
    DirectionsOnly,
    /// The length of the link behind a joint, from 1.
    Length(usize),
    /// The zero of a joint, from 1.
    Zero(usize),
}

/// Something that the touches do not tell.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unseen {
    /// What it is.
    pub direction: Direction,
    /// Posterior over prior standard deviation.
    pub share: f64,
    /// What stays of it, a mean over the work volume, mm.
    pub mm: f64,
    /// One sentence.
    pub text: String,
}

/// All that is unseen, largest first.
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
                "A level shows directions only, no length: {stays:.2} mm stays on average. Touch a point in many orientations, too."
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
                "One plane shows heights only: {stays:.2} mm stays on average. Touch two more planes that are square to it."
            ),
        });
    }
    let mut sees_size = true;
    if let Some((share, mm)) = measured(&size)
        && share > SIZE_UNSEEN
    {
        sees_size = false;
        let percent = 100.0 * share * spread(&size);
        let stays = format!("±{percent:.2} % stays, {mm:.2} mm on average");
        let has_board = readings().any(|r| matches!(r, Reading::Board { .. }));
        let text = if has_board {
            format!(
                "The arm's size comes from the board alone, and these images hardly show it: {stays}. Take images from farther apart."
            )
        } else if readings().all(|r| matches!(r, Reading::Plane { .. })) {
            format!(
                "Planes cannot show the arm's size: {stays}. Give one known distance of 200 mm or more between points that are touched."
            )
        } else {
            format!(
                "Touches at unknown points cannot show the arm's size: {stays}. Give one known distance of 200 mm or more."
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
                    "The length of the link behind joint {frame} is known no better than from the drawing: {mm:.2} mm on average. \
                     Touch with joint {frame} turned further."
                ),
            });
        }
    }
    // The zero of the first joint is the base's, that of the last the tip's.
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

/// The relative size that one standard deviation of the prior along `u` is: the weighted mean of independent links.
fn spread(u: &[f64]) -> f64 {
    let squared: f64 = u.iter().map(|x| x * x).sum();
    if squared > 0.0 {
        1.0 / squared.sqrt()
    } else {
        0.0
    }
}

/// Posterior over prior along `u` and what that is worth in mm; `None` for no direction at all.
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

/// Whether all that tells lengths is one plane.
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
