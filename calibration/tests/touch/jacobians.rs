//! The derivatives of every kind of row and of the arm, against central differences.

use nalgebra::Vector3;
use poegp_calibration::identification::touch::arm::{Terms, TipStart, TouchArm};
use poegp_calibration::identification::touch::form::Form;
use poegp_calibration::identification::touch::scene::{Figure, Scene};
use poegp_calibration::measurement::observation::{InstrumentNoise, Observation};
use poegp_calibration::measurement::sample::{Base, Sample, ToolName};
use poegp_calibration::measurement::touch::{
    Board, Camera, Feature, FeatureKind, Mount, Reading, Tip, TouchRow, TouchSet,
};
use poegp_calibration::robot::{LoadOptions, Robot};
use poegp_runtime::math::se3::{Pose, Twist};

fn pose(linear: [f64; 3], angular: [f64; 3]) -> Pose<f64> {
    let turn = Twist {
        linear: Vector3::zeros(),
        angular: Vector3::from(angular),
    };
    Pose {
        translation: Vector3::from(linear),
        ..Pose::exp(&turn)
    }
}

/// Returns every kind of feature, with a reading at which its row is linear enough.
fn features() -> Vec<(FeatureKind, Figure, Reading)> {
    let directions = |count: usize| Some((Form::directions(), vec![1e-4; 12 * count]));
    let corner = Vector3::new(0.05, -0.03, 0.0);
    let board = Board {
        corners: vec![corner],
        scale_sigma: 1e-3,
    };
    let axes = pose([0.0; 3], [0.3, -0.4, 0.2]).rotation;
    let grid = Form::grid(&[
        nalgebra::Vector2::new(-0.1, -0.2),
        nalgebra::Vector2::new(0.2, 0.3),
    ]);
    let gravity = Vector3::new(0.1, -0.2, -0.97).normalize();
    vec![
        (
            FeatureKind::Point { seat: 1e-4 },
            Figure::Point {
                centre: Vector3::new(0.3, 0.1, 0.2),
                seat: directions(3),
            },
            Reading::Point { feature: 0 },
        ),
        (
            FeatureKind::Plane { flatness: 1e-4 },
            Figure::Plane {
                origin: Vector3::new(0.3, 0.1, 0.2),
                axes,
                offset: 0.01,
                flatness: Some((grid, vec![0.0; 25])),
            },
            Reading::Plane {
                feature: 1,
                value: 0.002,
            },
        ),
        (
            FeatureKind::Sphere {
                radius: Some(0.05),
                radius_sigma: 1e-5,
                roundness: 0.0,
            },
            Figure::Sphere {
                centre: Vector3::new(0.3, 0.1, 0.2),
                radius: 0.05,
                roundness: None,
            },
            Reading::Sphere {
                feature: 2,
                value: 0.001,
            },
        ),
        (
            FeatureKind::Anchor {
                position: None,
                position_sigma: 0.02,
                zero_sigma: 1e-3,
                scale_sigma: 1e-4,
            },
            Figure::Anchor {
                position: Vector3::new(1.0, -0.4, 0.0),
                zero: 1e-3,
                scale: 1e-4,
            },
            Reading::Anchor {
                feature: 3,
                value: 1.1,
            },
        ),
        (
            FeatureKind::Level {
                rotation: Vector3::zeros(),
                rotation_sigma: 0.05,
            },
            Figure::Level {
                sensor_from_flange: pose([0.0; 3], [0.2, 0.1, -0.3]).rotation,
                gravity: Vector3::new(0.0, 0.0, -1.0),
            },
            Reading::Level {
                feature: 4,
                gravity,
            },
        ),
        (
            FeatureKind::Board(board),
            Figure::Board {
                pose: pose([0.4, 0.1, 0.9], [0.2, 0.3, -0.1]),
                scale: 1e-3,
            },
            Reading::Board {
                feature: 5,
                corner: 0,
                u: 900.0,
                v: 500.0,
            },
        ),
    ]
}

fn tip() -> Pose<f64> {
    pose([0.32, 0.15, 0.25], [0.4, -0.2, 0.6])
}

fn set(mount: Mount) -> (TouchSet, Scene, Vec<Reading>) {
    let (mut kinds, mut figures, mut readings) = (Vec::new(), Vec::new(), Vec::new());
    for (kind, figure, reading) in features() {
        kinds.push(Feature {
            name: kind.name().to_owned(),
            line: 1,
            sigma: 5e-5,
            kind,
        });
        figures.push(figure);
        readings.push(reading);
    }
    let seen = pose([2.0, 0.3, -0.1], [0.5, 0.2, 0.1]);
    // At the prediction, because a rotation error is linear only about zero.
    let target = seen * tip();
    readings.push(Reading::Tracker(Observation::Pose(target)));
    readings.push(Reading::Tracker(Observation::Position(target.translation)));
    let camera = Camera {
        focal: [1500.0, 1490.0],
        centre: [960.0, 600.0],
        intrinsics_sigma: 1.0,
        mount,
        camera_from_mount: pose([0.02, -0.05, 0.1], [0.03, 0.02, 0.1]),
        position_sigma: 0.02,
        rotation_sigma: 0.05,
    };
    let row = TouchRow {
        line: 2,
        joints: Vec::new(),
        serial_joints: Vec::new(),
        payload_kg: None,
        tip: 0,
        reading: readings[0],
        declared_noise: InstrumentNoise::UNKNOWN,
    };
    let set = TouchSet {
        path: "touches.csv".into(),
        features_path: "touches.toml".into(),
        joint_columns: Vec::new(),
        feature_column: 1,
        rows: vec![row],
        features: kinds,
        tips: vec![Tip {
            name: ToolName::default(),
            position: Vector3::zeros(),
            sigma: 5e-3,
        }],
        distances: Vec::new(),
        prior: None,
        camera: Some(camera),
        notes: Vec::new(),
        sha256: [[0; 32]; 2],
    };
    let scene = Scene::new(&set, figures, Some(camera), Some(seen));
    (set, scene, readings)
}

/// Asserts that two numbers agree within 1e-5, relative to their size or to `scale`.
fn close(found: f64, expected: f64, scale: f64, what: &str) {
    let off = (found - expected).abs();
    assert!(
        off < 1e-5 * (expected.abs() + scale),
        "{what}: {found} instead of {expected}"
    );
}

#[test]
fn rows_change_as_their_derivatives_say() {
    for mount in [Mount::Flange, Mount::Fixed] {
        let (set, scene, readings) = set(mount);
        let tip = tip();
        for reading in &readings {
            let jet = scene.row(&set, reading, &tip);
            let scale = match reading {
                Reading::Board { .. } => 1e3,
                _ => 1.0,
            };
            // The form of a surface is not moved with the tip, which leaves out slopes of some 1e-3.
            let slope = match reading {
                Reading::Point { .. } | Reading::Plane { .. } => 300.0,
                Reading::Tracker(_) => 10.0,
                _ => 1.0,
            };
            let step = 1e-6;
            for i in 0..6 {
                let moved = |sign: f64| {
                    let mut twist = [0.0; 6];
                    twist[i] = sign * step;
                    let turn = Pose::exp(&Twist {
                        linear: Vector3::zeros(),
                        angular: Vector3::new(twist[3], twist[4], twist[5]),
                    });
                    let moved = Pose {
                        rotation: turn.rotation * tip.rotation,
                        translation: tip.translation + Vector3::new(twist[0], twist[1], twist[2]),
                    };
                    scene.row(&set, reading, &moved).residual
                };
                let (ahead, behind) = (moved(1.0), moved(-1.0));
                for row in 0..jet.count {
                    let by_difference = (ahead[row] - behind[row]) / (2.0 * step);
                    close(
                        jet.tip[row][i],
                        by_difference,
                        scale * slope,
                        &format!("{reading:?} by tip {i}"),
                    );
                }
            }
            for (index, column) in &jet.own {
                let moved = |sign: f64| {
                    let mut scene = scene.clone();
                    let mut change = vec![0.0; scene.prior.len()];
                    change[*index] = sign * step;
                    scene.update(&change);
                    scene.row(&set, reading, &tip).residual
                };
                let (ahead, behind) = (moved(1.0), moved(-1.0));
                for row in 0..jet.count {
                    let by_difference = (ahead[row] - behind[row]) / (2.0 * step);
                    close(
                        column[row],
                        by_difference,
                        scale * slope,
                        &format!("{reading:?} by {index}"),
                    );
                }
            }
        }
    }
}

#[test]
fn the_tip_moves_as_the_derivatives_of_the_arm_say() {
    let robot = Robot::load("abb-irb120", &LoadOptions::default()).unwrap();
    let tips = [TipStart {
        pose: pose([0.03, 0.01, 0.18], [0.0; 3]),
        is_free: true,
        turns: true,
    }];
    let terms = Terms {
        gravity: true,
        payload: false,
        orders: 2,
        size: true,
    };
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let mut arm = TouchArm::new(&robot.chain().unwrap(), &tips, None, gravity, terms);
    let start: Vec<f64> = (0..arm.columns.len())
        .map(|j| 1e-5 * ((j * 7) % 5) as f64)
        .collect();
    arm.update(&start);
    let joints = vec![0.3, -0.4, 0.5, 0.6, -0.7, 0.8];
    let unseen = Observation::Pose(Pose::identity());
    let state = [Sample::new(joints.clone(), joints, unseen, Base)];
    let jet = &arm.linearise(&state)[0];
    let step = 1e-6;
    for j in 0..start.len() {
        let moved = |sign: f64| {
            let mut arm = arm.clone();
            let mut theta = start.clone();
            theta[j] += sign * step;
            arm.update(&theta);
            arm.poses(&state)[0]
        };
        let (ahead, behind) = (moved(1.0), moved(-1.0));
        let shift = (ahead.translation - behind.translation) / (2.0 * step);
        let turn = (ahead * behind.inverse()).log().angular / (2.0 * step);
        for i in 0..3 {
            // The derivative takes gravity at the commanded joints, which leaves out some 1e-4 of it.
            let off = |a: f64, b: f64| (a - b).abs() < 2e-3 * (1.0 + b.abs());
            assert!(
                off(jet.jacobian[(i, j)], shift[i]),
                "parameter {j}: {:?}",
                arm.columns[j]
            );
            assert!(
                off(jet.jacobian[(3 + i, j)], turn[i]),
                "parameter {j}: {:?}",
                arm.columns[j]
            );
        }
    }
}
