//! Step 1 on 40 poses against an independent Gauss–Newton solver in numpy. Only quantities that do not depend on the gauge are
//! compared.

use poegp_calibration::identification::frame_fit::{
    ResidualFrame, fit_frames, residual_components,
};
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{Base, BaseSample, Sample};
use poegp_protocol::JointKind;
use poegp_runtime::kinematics::poe::Poe;
use poegp_runtime::math::se3::Pose;

use crate::json::{largest_difference, list, numbers, parse, pose_rows};
use crate::say;

#[test]
fn step_1_is_numpys() {
    let file = parse(include_str!("../../../tests/data/vectors/step1_paper.json"));
    let poses = |name: &str| -> Vec<Pose<f64>> {
        let rows = list(&file[name]).iter().map(pose_rows);
        rows.map(|rows| Pose::from_rows(&rows)).collect()
    };
    let joints = |name: &str| -> Vec<Vec<f64>> { list(&file[name]).iter().map(numbers).collect() };
    let samples: Vec<BaseSample> = joints("q")
        .into_iter()
        .zip(poses("T_meas"))
        .map(|(q, measured)| Sample::new(q.clone(), q, Observation::Pose(measured), Base))
        .collect();
    let mut poe = Poe::new(&[JointKind::Revolute; 6], &poses("P_start")).unwrap();
    let all: Vec<usize> = (0..poe.frames().len()).collect();
    let fit = fit_frames(&mut poe, &samples, &all, ResidualFrame::Space);
    assert_eq!((fit.rank, fit.parameters), (30, 42));

    let rms = file["rms"].as_f64().unwrap();
    let ours: Vec<f64> = samples
        .iter()
        .flat_map(|s| {
            residual_components(
                ResidualFrame::Space,
                &s.observation,
                &poe.forward(&s.serial_joints),
            )
        })
        .collect();
    let residuals = largest_difference(&ours, &numbers(&file["residual"]));
    let rows = |pose: &Pose<f64>| pose.to_rows().to_vec();
    let ours: Vec<f64> = joints("q_test")
        .iter()
        .flat_map(|q| rows(&poe.forward(q)))
        .collect();
    let theirs: Vec<f64> = poses("T_test").iter().flat_map(rows).collect();
    let tests = largest_difference(&ours, &theirs);
    say(format_args!(
        "step 1 in {} iterations: rms {:.1e}, residuals {residuals:.1e}, test poses {tests:.1e} from numpy's",
        fit.iterations,
        (fit.rms - rms).abs()
    ));
    assert!((fit.rms - rms).abs() <= 1e-9 && residuals <= 1e-9 && tests <= 1e-9);
}
