//! Sockets in the holes of a table: where a calibrated arm measures them, compared with where the holes are.

use nalgebra::{Matrix3, Vector3};
use poegp_calibration::robot::Robot;

use crate::measured::{calibrated, spread_rows};
use crate::sets::{folder, robot, state, touches};

/// Midpoints between the two sockets of each placement of `panda_3`, mm, from its README.
const HOLES: [(&str, [f64; 2]); 6] = [
    ("backcenter", [0.0, 0.0]),
    ("backleft", [0.0, -175.0]),
    ("backright", [0.0, 175.0]),
    ("frontcenter", [150.0, 0.0]),
    ("frontleft", [150.0, -200.0]),
    ("frontright", [150.0, 175.0]),
];
/// Largest mean error, mm.
const MOST: f64 = 0.27;

/// Returns the mean distance of points after the best rigid registration (Kabsch 1976).
fn registered(found: &[Vector3<f64>], truth: &[Vector3<f64>]) -> f64 {
    let mean = |all: &[Vector3<f64>]| all.iter().sum::<Vector3<f64>>() / all.len() as f64;
    let (a, b) = (mean(found), mean(truth));
    let pairs = || found.iter().zip(truth);
    let covariance: Matrix3<f64> = pairs().map(|(f, t)| (t - b) * (f - a).transpose()).sum();
    let svd = covariance.svd(true, true);
    let (u, v) = (svd.u.unwrap(), svd.v_t.unwrap());
    let mut sign = Matrix3::identity();
    // The table is flat: its normal has no extent, and its sign must not mirror the points.
    let least = svd.singular_values.imin();
    sign[(least, least)] = (u * v).determinant().signum();
    let rotation = u * sign * v;
    pairs()
        .map(|(f, t)| (rotation * (f - a) - (t - b)).norm())
        .sum::<f64>()
        / found.len() as f64
}

#[test]
fn the_holes_of_a_table_are_where_they_are() {
    let Some(folder) = folder("touch") else {
        return;
    };
    let robot: Robot = robot("franka_panda.urdf").unwrap();
    let all = touches(&folder, "panda_3", &robot);
    let truth = HOLES.map(|(_, [x, y])| Vector3::new(1e-3 * x, 1e-3 * y, 0.0));
    let mut each = Vec::new();
    for (placement, _) in HOLES {
        let (set, _) = spread_rows(&all, placement, 10);
        let found = calibrated(&robot, &set);
        let socket = |name: String| {
            let feature = all.features.iter().position(|f| f.name == name).unwrap();
            let rows = all
                .rows
                .iter()
                .filter(|r| r.reading.feature() == Some(feature));
            let at = rows.map(|r| {
                let state = state(&robot, &r.joints, r.payload_kg);
                found.calibration.predict(&state).translation
            });
            let at: Vec<Vector3<f64>> = at.collect();
            at.iter().sum::<Vector3<f64>>() / at.len() as f64
        };
        let middle = |(name, _): (&str, [f64; 2])| {
            0.5 * (socket(format!("{name}/0")) + socket(format!("{name}/1")))
        };
        let mm = 1e3 * registered(&HOLES.map(middle), &truth);
        let refused = found.findings.is_refused();
        println!(
            "20 touches of {placement}: {mm:.3} mm at the holes{}",
            if refused { ", refused" } else { "" }
        );
        each.push(mm);
    }
    let mean = each.iter().sum::<f64>() / each.len() as f64;
    println!("mean of {}: {mean:.3} mm (at most {MOST})", each.len());
    assert!(mean <= MOST);
}
