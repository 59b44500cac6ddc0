//! Forward kinematics and Jacobians in `f64` against an independent implementation in numpy (`poe_fk.json`).

use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::{Pose, Twist};
use serde_json::Value;

use crate::json::{array, largest_difference, list, numbers, parse, pose_rows};

/// A few ulp of numbers of order one, accumulated over fourteen factors.
const TOLERANCE: f64 = 2e-14;

fn chain(frames: &Value) -> Poe<f64> {
    let frames: Vec<Pose<f64>> = list(frames)
        .iter()
        .map(|frame| Pose::from_rows(&pose_rows(frame)))
        .collect();
    Poe::new(&[JointKind::Revolute; 6], &frames).unwrap()
}

/// Returns the columns as a 6 × n matrix, row by row, as in the reference.
fn by_rows(columns: &[Twist<f64>]) -> Vec<f64> {
    let columns: Vec<[f64; 6]> = columns.iter().map(Twist::to_array).collect();
    (0..6)
        .flat_map(|row| columns.iter().map(move |column| column[row]))
        .collect()
}

#[test]
fn the_nominal_frames_are_the_exponentials_of_their_twists() {
    let file = parse(include_str!("../../../tests/data/vectors/poe_fk.json"));
    for (twist, frame) in list(&file["p_nominal"])
        .iter()
        .zip(list(&file["P_nominal"]))
    {
        let pose = Pose::exp(&Twist::from_array(&array::<6>(twist)));
        assert!(largest_difference(&pose.to_rows(), &pose_rows(frame)) <= TOLERANCE);
    }
}

/// The Jacobians of the reference are those of the perturbed chain.
#[test]
fn forward_and_jacobians_agree() {
    let file = parse(include_str!("../../../tests/data/vectors/poe_fk.json"));
    let (nominal, perturbed) = (chain(&file["P_nominal"]), chain(&file["P_perturbed"]));
    let mut worst = [0.0_f64; 5];
    for index in 0..list(&file["q"]).len() {
        let q = array::<6>(&file["q"][index]);
        let (blocks, target) = perturbed.identification_jacobian(&q);
        assert_eq!(blocks[7..], [[[0.0; 6]; 6]; 2], "blocks beyond the chain");
        let columns: Vec<Twist<f64>> = blocks[..7]
            .iter()
            .flat_map(|block| (0..6).map(|column| Twist::from_array(&block.map(|row| row[column]))))
            .collect();
        let hybrid: Vec<Twist<f64>> = columns
            .iter()
            .map(|column| column.at_point(&target.translation))
            .collect();
        let (joints, _) = perturbed.space_jacobian(&q);
        let differences = [
            largest_difference(
                &nominal.forward(&q).to_rows(),
                &pose_rows(&file["T_nominal"][index]),
            ),
            largest_difference(
                &perturbed.forward(&q).to_rows(),
                &pose_rows(&file["T_perturbed"][index]),
            ),
            largest_difference(&by_rows(&columns), &numbers(&file["A_space"][index])),
            largest_difference(&by_rows(&hybrid), &numbers(&file["A_hybrid"][index])),
            largest_difference(&by_rows(&joints[..6]), &numbers(&file["J_space"][index])),
        ];
        for (worst, difference) in worst.iter_mut().zip(differences) {
            *worst = worst.max(difference);
        }
    }
    println!("f(q) nominal, perturbed, A space, A at the tool, J: {worst:?}");
    assert!(
        worst.iter().all(|difference| *difference <= TOLERANCE),
        "{worst:?}"
    );
}
