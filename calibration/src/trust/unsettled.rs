//! Rows among others that were read before the robot stood still: each is off along the move from the row before, or towards
//! the row after, by a share of its own.
//!
//! [`readings`](crate::trust::readings) tries one share for all rows; this tries one for each row that does not belong.

use nalgebra::Vector3;

use crate::trust::readings::Data;
use crate::trust::wording::three_digits;

/// Smallest number of rows that show a direction which they share.
const LEAST_ROWS: usize = 3;
/// Share of the rows that must be off along their moves.
const MOST: f64 = 0.75;
/// Share of a row's error that may be left beside the move.
const BESIDE: f64 = 0.25;
/// Largest share of a move: beyond it, the row belongs to another pose.
const LARGEST: f64 = 0.5;
/// Share of a move by which the arm is moved to find the direction.
const SMALL: f64 = 1e-3;

/// Describes how the rows `off` are off along their moves, if most of them are. `predicted` returns the position of a tool at
/// the chain's joints, and `error` the observed minus the predicted position of a row, both in the base frame and in m.
pub fn describe(
    data: &Data<'_>,
    off: &[usize],
    predicted: impl Fn(usize, &[f64]) -> Vector3<f64>,
    error: impl Fn(usize) -> Vector3<f64>,
) -> Option<String> {
    // Positive towards the other row of the move.
    let share = |k: usize, other: Option<usize>| -> Option<f64> {
        let (sample, other) = (data.samples[k], data.samples.get(other?)?);
        let at = |share: f64| {
            let joints = sample.joints.iter().zip(&other.joints);
            let joints: Vec<f64> = joints.map(|(q, to)| q + share * (to - q)).collect();
            predicted(sample.tool, &data.robot.serial_joints(&joints))
        };
        let (along, error) = ((at(SMALL) - at(0.0)) / SMALL, error(k));
        let share = along.dot(&error) / along.norm_squared();
        let is_along = (error - share * along).norm() <= BESIDE * error.norm();
        (is_along && share.abs() <= LARGEST).then_some(share)
    };
    let before = |k: &usize| share(*k, k.checked_sub(1));
    let after = |k: &usize| share(*k, k.checked_add(1));
    let (back, on) = parted(off.iter().filter_map(before));
    let (on_after, back_after) = parted(off.iter().filter_map(after));
    let (shares, way) = [
        (back, "back along the move from the row before"),
        (on, "along the move from the row before"),
        (on_after, "along the move to the row after"),
        (back_after, "back along the move to the row after"),
    ]
    .into_iter()
    .rev()
    .max_by_key(|(shares, _)| shares.len())?;
    let is_enough = shares.len() >= LEAST_ROWS && shares.len() as f64 >= MOST * off.len() as f64;
    is_enough.then(|| {
        let percent = |share: f64| three_digits(100.0 * share);
        format!(
            "{} of them fit joints {} to {} % further {way}: joints or poses were read while the robot moved",
            shares.len(),
            percent(shares.iter().copied().fold(f64::INFINITY, f64::min)),
            percent(shares.iter().copied().fold(0.0, f64::max))
        )
    })
}

/// Parts shares into the sizes of the positive and the negative ones.
fn parted(shares: impl Iterator<Item = f64>) -> (Vec<f64>, Vec<f64>) {
    let (positive, negative): (Vec<f64>, Vec<f64>) = shares.partition(|share| *share > 0.0);
    (positive, negative.into_iter().map(f64::abs).collect())
}
