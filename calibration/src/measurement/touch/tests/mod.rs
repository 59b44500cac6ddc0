//! What is read of touches, and what is refused.

mod rejected;
mod rejected_numbers;

use std::path::Path;

use nalgebra::Vector3;

use crate::input_error::InputError;
use crate::measurement::touch::{FeatureKind, Reading, TouchSet};
use crate::robot::{LoadOptions, Robot};
use crate::simulation::touches::{TOUCH_KINDS, TouchKind, TouchTask};
use crate::simulation::{Scenario, Simulator};

fn robot() -> Robot {
    Robot::load("ur10", &LoadOptions::default()).unwrap()
}

/// Touches and their description, of simulated features of a kind.
fn simulated(kind: TouchKind, features: usize, count: usize) -> (String, String) {
    let robot = robot();
    let mut simulator = Simulator::new(&robot, Scenario::Paper, &[1.0], 3);
    let tasks = [TouchTask { kind, features }];
    let (touches, _) = simulator
        .touch(&robot, &tasks, count, 0, "simulated")
        .unwrap();
    (touches.csv, touches.toml)
}

fn parse(csv: &str, toml: &str) -> Result<TouchSet, InputError> {
    let touches = (Path::new("touches.csv"), csv.as_bytes());
    let features = (Path::new("features.toml"), toml.as_bytes());
    TouchSet::parse(touches, features, &robot())
}

/// Every kind comes through: all rows with what belongs to their kind, in SI units.
#[test]
fn every_kind_is_read() {
    for (name, kind) in TOUCH_KINDS {
        let (csv, toml) = simulated(kind, 2, 24);
        let set = parse(&csv, &toml).unwrap_or_else(|error| panic!("{name}: {error}\n{toml}"));
        assert_eq!(set.features.len(), 2, "{name}");
        assert_eq!(set.rows.len(), csv.lines().count() - 2, "{name}");
        assert!(set.notes.is_empty(), "{name}: {:?}", set.notes);
        assert_eq!(set.tips.len(), 1, "{name}");
        assert_eq!(set.tips[0].position, Vector3::new(0.02, 0.01, 0.15));
        assert_eq!(set.prior.unwrap().length, 0.8e-3, "{name}");
        assert_eq!(set.distances.len(), usize::from(kind == TouchKind::Socket));
        assert_eq!(set.camera.is_some(), kind == TouchKind::Camera, "{name}");
        for row in &set.rows {
            let feature = &set.features[row.reading.feature().unwrap()];
            assert!(set.sigma(row).is_some_and(|sigma| sigma > 0.0), "{name}");
            assert_eq!(row.payload_kg, Some(1.0));
            let of_kind = match row.reading {
                Reading::Point { .. } => "point",
                Reading::Plane { .. } => "plane",
                Reading::Sphere { .. } => "sphere",
                Reading::Anchor { value, .. } => {
                    assert!((0.1..5.0).contains(&value), "{value} m");
                    "anchor"
                }
                Reading::Level { gravity, .. } => {
                    assert!((gravity.norm() - 1.0).abs() < 1e-12);
                    "level"
                }
                Reading::Board { u, .. } => {
                    assert!((0.0..1920.0).contains(&u));
                    "board"
                }
                Reading::Tracker(_) => "tracker",
            };
            assert_eq!(feature.kind.name(), of_kind);
        }
    }
}

/// By the arm that was simulated, the rows of a socket are one point but for what is wrong with the arm: a few millimetres.
#[test]
fn sockets_are_points() {
    let (csv, toml) = simulated(TouchKind::Socket, 1, 12);
    let set = parse(&csv, &toml).unwrap();
    let chain = robot().chain().unwrap();
    let tips: Vec<Vector3<f64>> = set
        .rows
        .iter()
        .map(|row| {
            let flange = chain.forward(&row.serial_joints);
            flange.transform_point(&set.tips[row.tip].position)
        })
        .collect();
    let mean = tips.iter().sum::<Vector3<f64>>() / tips.len() as f64;
    for tip in tips {
        assert!((tip - mean).norm() < 15e-3, "{tip} is far from {mean}");
    }
}

/// Rows of a tracker among touches; an empty field of σ is the feature's.
#[test]
fn trackers_and_touches_mix() {
    let (csv, toml) = simulated(TouchKind::Socket, 1, 6);
    let mut mixed = String::new();
    for (number, line) in csv.lines().enumerate() {
        mixed += &match number {
            0 => line.to_owned(),
            1 => format!("{line},x_mm,y_mm,z_mm,qw,qx,qy,qz,sigma_mm"),
            2 => format!("{line},,,,,,,,0.2"),
            _ => format!("{line},,,,,,,,"),
        };
        mixed.push('\n');
    }
    mixed += ",1,10,-90,90,-90,10,10,100,200,300,1,0,0,0,\n";
    mixed += ",1,10,-80,80,-90,10,10,100,200,350,,,,,0.03\n";
    let set = parse(&mixed, &toml).unwrap();
    assert_eq!(set.sigma(&set.rows[0]), Some(0.2e-3));
    assert_eq!(set.sigma(&set.rows[1]), Some(0.05e-3));
    let [.., pose, position] = set.rows.as_slice() else {
        panic!()
    };
    let (Reading::Tracker(pose), Reading::Tracker(at)) = (&pose.reading, &position.reading) else {
        panic!("two rows of a tracker")
    };
    assert!(pose.has_orientation());
    assert_eq!(at.position(), Vector3::new(0.1, 0.2, 0.35));
    assert_eq!(position.declared_noise.position, Some(0.03e-3));
    assert_eq!(set.sigma(position), None);
}

/// What the file leaves out is as the reference says.
#[test]
fn what_is_left_out_has_its_usual_value() {
    let (csv, toml) = simulated(TouchKind::Wire, 1, 6);
    let short: String = toml
        .lines()
        .filter(|line| !line.contains("sigma") && !line.contains("touch_mm"))
        .filter(|line| !line.contains("_mrad") && !line.contains("length_mm"))
        .filter(|line| *line != "[prior]" && *line != "[noise]")
        .map(|line| format!("{line}\n"))
        .collect();
    let set = parse(&csv, &short).unwrap_or_else(|error| panic!("{error}\n{short}"));
    assert_eq!(set.prior, None);
    assert_eq!(set.tips[0].sigma, 5e-3);
    assert_eq!(set.features[0].sigma, 0.05e-3);
    let FeatureKind::Anchor {
        position_sigma,
        zero_sigma,
        scale_sigma,
        ..
    } = set.features[0].kind
    else {
        panic!("an anchor")
    };
    assert_eq!(
        (position_sigma, zero_sigma, scale_sigma),
        (20e-3, 1e-3, 0.0)
    );
}

/// Each session of a file has a tip of its own.
#[test]
fn sessions_are_tips() {
    let (csv, toml) = simulated(TouchKind::Socket, 1, 6);
    let mut rows = String::new();
    for (number, line) in csv.lines().enumerate() {
        rows += &match number {
            0 => format!("{line}\n"),
            1 => format!("{line},session,target\n"),
            _ => format!("{line},{},tip\n", ["a", "b"][number % 2]),
        };
    }
    let set = parse(&rows, &toml).unwrap();
    let names: Vec<String> = set.tips.iter().map(|tip| tip.name.to_string()).collect();
    assert_eq!(
        names,
        [
            "target \"tip\" of session \"a\"",
            "target \"tip\" of session \"b\""
        ]
    );
}
