//! The chain as Denavit-Hartenberg rows, with Hayati's rows between axes that are nominally parallel.
//!
//! The common normal of two nearly parallel axes is ill-conditioned: an error of a milliradian moves its foot by metres,
//! and d with it. The row between such axes has d = 0 and a second rotation instead, R_z(θ) T_x(a) R_x(α) R_y(β) (Hayati
//! and Mirmirani, "Improving the absolute positioning accuracy of robot manipulators", 1985): the next frame's origin is
//! where the next axis pierces the plane z = 0. Both kinds of rows are exact. A frame before the rows and one behind them
//! take what four numbers cannot express.

use nalgebra::Vector3;
use poegp_runtime::math::se3::{Pose, Twist};

use crate::export::calibrated_chain::at_zero;
use crate::export::tables::{DhRow, Row, Table};
use crate::export::{CalibratedChain, gauge};
use poegp_calibration::numeric::matrix::Mat;
use poegp_calibration::robot::normal_form::rotation_about;

/// Sine of the angle below which axes count as parallel. Errors of arms are a few milliradians; above this angle the common
/// normal multiplies them by no more than the inverse of this sine.
pub const PARALLEL: f64 = 0.02;
/// Distance in metres below which two axes count as meeting: so short a common normal has no defined direction.
const MEET_M: f64 = 1e-6;

/// Returns the table of a calibrated chain. The convention leaves the sign of every x axis open: each is chosen as for the
/// nominal arm, whose θ are within ±90° where possible.
pub fn table(chain: &CalibratedChain) -> Table {
    let (_, (base, rows, flange)) = beside_nominal(chain, &chain.to_flange());
    Table {
        convention: "dh",
        base: Some(base),
        rows: rows.into_iter().map(Row::Dh).collect(),
        flange,
    }
}

/// First frame, rows and last frame of a table.
type RowsBetween = (Pose<f64>, Vec<DhRow>, Pose<f64>);

/// Returns the rows of the nominal model; and first frame, rows and last frame of an arm with the frames `to_flange`.
fn beside_nominal(chain: &CalibratedChain, to_flange: &[Pose<f64>]) -> (Vec<DhRow>, RowsBetween) {
    let nominal = at_zero(&chain.nominal_to_flange());
    // The nominal rows come first: they determine which way the axes of the calibrated arm point.
    let (_, nominal_rows, _) = rows(&nominal, &nominal[0], None);
    let calibrated = rows(&at_zero(to_flange), &nominal[0], Some(&nominal_rows));
    (nominal_rows, calibrated)
}

/// Returns the rows of the nominal model and those of the calibrated arm, joint by joint.
pub fn rows_beside_nominal(chain: &CalibratedChain) -> (Vec<DhRow>, Vec<DhRow>) {
    let (nominal, (_, calibrated, _)) = beside_nominal(chain, &chain.to_flange());
    (nominal, calibrated)
}

/// Step of a frame in the numerical derivative of the rows, in m and rad.
const STEP: f64 = 1e-6;

/// Returns the standard deviations of a, d, α, θ and β for each row of the calibrated arm. `covariance` is the covariance of
/// the frames: six numbers for each frame, a twist whose Exp multiplies the frame from the left.
pub fn deviations(chain: &CalibratedChain, covariance: &Mat<f64>) -> Vec<[f64; 5]> {
    let frames = chain.to_flange();
    let with = |k: usize, step: f64| {
        let mut moved = frames.clone();
        let twist = std::array::from_fn(|i| if i == k % 6 { step } else { 0.0 });
        moved[k / 6] = Pose::exp(&Twist::from_array(&twist)) * moved[k / 6];
        beside_nominal(chain, &moved).1.1
    };
    let columns = covariance.ncols();
    let rows = frames.len() - 1;
    let mut derivative = Mat::zeros(5 * rows, columns);
    for k in 0..columns {
        for (row, (more, less)) in with(k, STEP).iter().zip(&with(k, -STEP)).enumerate() {
            for (i, (more, less)) in numbers(more).iter().zip(numbers(less)).enumerate() {
                let change = if i < 2 {
                    more - less
                } else {
                    wrapped(more - less)
                };
                derivative[(5 * row + i, k)] = change / (2.0 * STEP);
            }
        }
    }
    let spread = &derivative * covariance;
    let deviation = |at: usize| {
        let variance: f64 = (0..columns)
            .map(|k| spread[(at, k)] * derivative[(at, k)])
            .sum();
        variance.max(0.0).sqrt()
    };
    let of = |row: usize| std::array::from_fn(|i| deviation(5 * row + i));
    (0..rows).map(of).collect()
}

/// Returns a, d, α, θ and β of a row; β is 0 where the row has none.
pub fn numbers(row: &DhRow) -> [f64; 5] {
    [row.a, row.d, row.alpha, row.theta, row.beta.unwrap_or(0.0)]
}

/// Wraps an angle to ±π.
pub fn wrapped(angle: f64) -> f64 {
    let turn = 2.0 * std::f64::consts::PI;
    angle - turn * (angle / turn).round()
}

/// Returns the arm in Craig's convention, in which a, α and β of a row come before its joint.
pub fn modified_table(chain: &CalibratedChain) -> Table {
    let distal = table(chain);
    let mut before = DhRow::default();
    let rows = distal.rows.into_iter().map(|row| {
        let Row::Dh(own) = row else { return row };
        let shifted = DhRow {
            theta: own.theta,
            d: own.d,
            ..before
        };
        before = own;
        Row::Dh(shifted)
    });
    let rows = rows.collect();
    Table {
        convention: "modified-dh",
        rows,
        // The last distal row has neither a nor α, so the frame behind it is the same in both conventions.
        ..distal
    }
}

/// Returns first frame, rows and last frame of a chain whose joints are at `at_zero` (the last pose is the chain's end).
/// `first` is the wanted frame of joint 1; θ of every row is chosen as near as possible to that of the row in `like`.
fn rows(
    at_zero: &[Pose<f64>],
    first: &Pose<f64>,
    like: Option<&[DhRow]>,
) -> (Pose<f64>, Vec<DhRow>, Pose<f64>) {
    let n = at_zero.len() - 1;
    let base = gauge::nearest_on_axis(&at_zero[0], first);
    let mut frame = base;
    let mut out: Vec<DhRow> = Vec::new();
    for (i, next) in at_zero[1..n].iter().enumerate() {
        let seen = frame.inverse() * *next;
        let direction = Vector3::new(
            seen.rotation[(0, 2)],
            seen.rotation[(1, 2)],
            seen.rotation[(2, 2)],
        );
        let row = row(
            &direction,
            &seen.translation,
            like.map(|rows| rows[i].theta),
        );
        frame = frame * row.frame();
        out.push(row);
    }
    // The end has no axis: θ and d of the last row come as near to it as they can, and the last frame takes the rest.
    let end = at_zero[n];
    let turned = gauge::nearest_on_axis(&frame, &end);
    let apart = frame.inverse() * turned;
    let last = DhRow {
        theta: apart.rotation[(1, 0)].atan2(apart.rotation[(0, 0)]),
        d: apart.translation[2],
        ..DhRow::default()
    };
    out.push(last);
    (base, out, (frame * last.frame()).inverse() * end)
}

/// Returns the row from the z axis of the current frame to the axis along `direction` (a unit vector) through `point`.
fn row(direction: &Vector3<f64>, point: &Vector3<f64>, theta_like: Option<f64>) -> DhRow {
    let across = direction[0].hypot(direction[1]);
    if across < PARALLEL {
        let pierced = point - direction * (point[2] / direction[2]);
        // Where the axes coincide, θ is arbitrary, but the row is exact all the same.
        let theta = pierced[1].atan2(pierced[0]);
        let (theta, sign) = nearest_theta(theta, theta_like, true);
        let turned = rotation_about(2, -theta).rotation * direction;
        return DhRow {
            theta,
            d: 0.0,
            a: sign * pierced[0].hypot(pierced[1]),
            alpha: (-turned[1]).atan2(turned[2]),
            beta: Some(turned[0].atan2(turned[1].hypot(turned[2]))),
        };
    }
    // x is along z × direction, or against it; the common normal is the line along x that meets both axes.
    let normal = Vector3::new(-direction[1], direction[0], 0.0) / across;
    let a = normal.dot(point);
    // Foot on the current z axis: p + s u − a x has x = y = 0; s comes from the component across the normal.
    let s = -(point[0] * direction[0] + point[1] * direction[1]) / (across * across);
    let d = point[2] + s * direction[2];
    let theta = normal[1].atan2(normal[0]);
    // Start with a > 0 where the axes do not meet.
    let (theta, a) = if a < -MEET_M {
        (theta + std::f64::consts::PI, -a)
    } else {
        (theta, a)
    };
    let (theta, sign) = nearest_theta(theta, theta_like, a > MEET_M);
    let turned = rotation_about(2, -theta).rotation * direction;
    DhRow {
        theta,
        d,
        a: sign * a,
        alpha: (-turned[1]).atan2(turned[2]),
        beta: None,
    }
}

/// Returns θ or θ + π within ±π, whichever is nearer to `like` (without `like`: nearer to 0, and θ itself at ±90°), and the
/// sign that a takes: −1 for θ + π.
fn nearest_theta(theta: f64, like: Option<f64>, apart: bool) -> (f64, f64) {
    let pi = std::f64::consts::PI;
    let near = |x: f64| wrapped(x - like.unwrap_or(0.0)).abs();
    let (kept, turned) = (wrapped(theta), wrapped(theta + pi));
    // θ of the nominal arm is about ±90°: keep a > 0 where the axes are apart.
    let tie = like.is_none() && (near(kept) - near(turned)).abs() < 2e-3 && apart;
    if tie || near(kept) <= near(turned) {
        (kept, 1.0)
    } else {
        (turned, -1.0)
    }
}
