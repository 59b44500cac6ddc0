//! SE(3) in `f64` against an independent implementation in numpy (`se3.json`).

use poegp_runtime::math::se3::{Pose, Twist, residual};

use crate::json::{array, largest_difference, list, numbers, parse, pose_rows};

/// The reference is `f64` too: its own errors are a few ulp of the largest element, and a little more near π, where the
/// logarithm is ill-conditioned.
const TOLERANCE: f64 = 2e-14;

fn scaled_difference(computed: &[f64], reference: &[f64]) -> f64 {
    let largest = reference.iter().fold(1.0, |m: f64, r| m.max(r.abs()));
    largest_difference(computed, reference) / largest
}

#[test]
fn exp_log_and_adjoint_agree() {
    let file = parse(include_str!("../../../tests/data/vectors/se3.json"));
    let mut worst = [0.0_f64; 3];
    for index in 0..list(&file["x"]).len() {
        let twist = Twist::from_array(&array::<6>(&file["x"][index]));
        let rows = pose_rows(&file["T"][index]);
        let pose = Pose::from_rows(&rows);
        let log = array::<6>(&file["log"][index]);
        let differences = [
            scaled_difference(&Pose::exp(&twist).to_rows(), &rows),
            scaled_difference(&pose.log().to_array(), &log),
            scaled_difference(&pose.adjoint().concat(), &numbers(&file["Ad"][index])),
        ];
        for (worst, difference) in worst.iter_mut().zip(differences) {
            *worst = worst.max(difference);
            assert!(
                difference <= TOLERANCE,
                "case {index}: exp, log, Ad {differences:?}"
            );
        }
        // The residual between a pose and the identity is its logarithm.
        assert_eq!(residual(&pose, &Pose::identity()), pose.log());
    }
    println!("exp, log, Ad: {worst:?} of the largest element");
}
