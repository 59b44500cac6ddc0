//! The noise that a row declares determines its weight.

use std::path::Path;

use nalgebra::Vector3;
use poegp_calibration::learning::elastic::options::OutlierPolicy;
use poegp_calibration::measurement;
use poegp_calibration::measurement::noise::InstrumentNoise;
use poegp_calibration::measurement::observation::Observation;
use poegp_calibration::measurement::sample::{InstrumentSample, samples};
use poegp_calibration::model::Method;
use poegp_calibration::model::config::{Config, Weighting};

use crate::{calibrated, sets};

/// The declared noise of a row has the values of its columns, in metres and radians.
#[test]
fn rows_declare_the_noise_of_their_columns() {
    let (robot, _) = sets::arm();
    let header = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm,qw,qx,qy,qz,sigma_mm,sigma_mrad\n";
    let rows: String = (1..10)
        .map(|i| format!("{i},2,3,4,5,6,7,8,9,1,0,0,0,0.0{i},0.{i}\n"))
        .collect();
    let set = measurement::parse(
        Path::new("noise.csv"),
        (header.to_owned() + &rows).as_bytes(),
    )
    .unwrap();
    for (i, row) in (1..).zip(samples(&set, &robot, &mut Vec::new()).unwrap()) {
        let InstrumentNoise {
            position,
            orientation,
        } = row.declared_noise;
        assert!((position.unwrap() - 1e-5 * f64::from(i)).abs() < 1e-15);
        assert!((orientation.unwrap() - 1e-4 * f64::from(i)).abs() < 1e-15);
    }
}

/// A row that declares a noise of a metre and a radian does not influence the fit, wherever it was measured: the calibration
/// equals the one without the row.
#[test]
fn a_row_that_declares_a_metre_of_noise_does_not_count() {
    let (robot, _) = sets::arm();
    let mut rows = sets::simulated(&robot, "train");
    rows.truncate(60);
    for row in &mut rows {
        row.declared_noise = InstrumentNoise {
            position: Some(30e-6),
            orientation: Some(50e-6),
        };
    }
    let mut with = rows.clone();
    let mut pose = with[7].observation.pose().unwrap();
    pose.translation += Vector3::new(0.005, 0.0, 0.0);
    with[7].observation = Observation::Pose(pose);
    let config = Config {
        weighting: Weighting::Noise,
        outliers: OutlierPolicy::Keep,
        ..Config::new(Method::Poe)
    };
    let test = &sets::simulated(&robot, "test1")[..30];
    let predicted = |rows: &[InstrumentSample]| -> Vec<Vector3<f64>> {
        let found = calibrated(&robot, rows, &config).blob;
        test.iter()
            .map(|s| found.predict(&s.joints, s.payload_kg).pose.translation)
            .collect()
    };
    let apart = |a: &[Vector3<f64>], b: &[Vector3<f64>]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| (a - b).norm())
            .fold(0.0, f64::max)
    };
    let believed = predicted(&with);
    with[7].declared_noise = InstrumentNoise {
        position: Some(1.0),
        orientation: Some(1.0),
    };
    let doubted = predicted(&with);
    rows.remove(7);
    let without = predicted(&rows);
    println!(
        "{:e} {:e}",
        apart(&doubted, &without),
        apart(&believed, &without)
    );
    assert!(apart(&doubted, &without) < 0.02 * apart(&believed, &without));
}
