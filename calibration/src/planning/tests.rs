//! Laws of the arm's own links: what is refused, by kinematics and sums that are not the program's.

use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::planning::links::{RADIUS_SHARE, RadiusSource};
use crate::planning::rules::Rule;
use crate::robot::normal_form::rotation_about;
use crate::robot::{BUILT_IN, LoadOptions};

fn load(name: &str) -> Robot {
    Robot::load(name, &LoadOptions::default()).unwrap()
}

fn none(robot: &Robot) -> Constraints {
    Constraints::none(robot).unwrap()
}

fn parse(robot: &Robot, text: &str) -> Constraints {
    Constraints::parse(Path::new("cell.toml"), text, robot).unwrap()
}

/// Names of the rules that forbid a configuration of the controller's joints, in degrees.
fn forbidden(robot: &Robot, constraints: &Constraints, degrees: &[f64]) -> Vec<String> {
    let joints: Vec<f64> = degrees.iter().map(|q| q.to_radians()).collect();
    let chain = constraints.chain(&robot.chain().unwrap());
    let rules = constraints.forbidden_by(&chain, &robot.serial_joints(&joints));
    let name = |i: usize| constraints.rules[i].name();
    rules.into_iter().map(name).collect()
}

/// Origins of base, joints, flange and target at the controller's joints, by matrices of this test.
fn origins(robot: &Robot, target: &Pose<f64>, joints: &[f64]) -> Vec<Vector3<f64>> {
    let serial = robot.serial_joints(joints);
    let mut pose = robot.parent_from_joint[0];
    let mut out = vec![Vector3::zeros(), pose.translation];
    for (i, joint) in robot.joints.iter().enumerate() {
        assert_eq!(joint.kind, JointKind::Revolute);
        pose = pose * rotation_about(2, serial[i]) * robot.parent_from_joint[i + 1];
        out.push(pose.translation);
    }
    out.push((pose * *target).translation);
    out
}

/// Radii of the links from base to target: as the description states them, else 8 % of what lies behind the second joint.
fn radii(robot: &Robot) -> Vec<f64> {
    let behind = robot.parent_from_joint[2..].iter();
    let reach: f64 = behind.map(|f| f.translation.norm()).sum();
    let usual = robot.link_radius.unwrap_or(0.08 * reach);
    let mut out = vec![usual];
    out.extend(robot.joints.iter().map(|j| j.link_radius.unwrap_or(usual)));
    out.push(out[out.len() - 1]);
    out
}

/// Whether points of two links that their four radii of arm connect are nearer to each other than both radii, by trying
/// points every few millimetres; both lengths are taken `margin` metres more strictly.
fn collides(points: &[Vector3<f64>], radii: &[f64], margin: f64) -> bool {
    let links: Vec<_> = points.windows(2).map(|w| (w[0], w[1])).collect();
    let length = |i: usize| (links[i].1 - links[i].0).norm();
    let samples = |i: usize| {
        let count = 1 + (length(i) / 0.01) as usize;
        (0..=count).map(move |k| k as f64 / count as f64)
    };
    for second in 2..links.len() {
        for first in 0..second {
            let between: f64 = (first + 1..second).map(length).sum();
            // Neighbours.
            if between < 1e-9 {
                continue;
            }
            let both = radii[first] + radii[second];
            let far = |a: f64| (1.0 - a) * length(first) + between >= 2.0 * both + margin;
            for a in samples(first).filter(|a| far(*a)) {
                for b in samples(second) {
                    let p = links[first].0 + a * (links[first].1 - links[first].0);
                    let q = links[second].0 + b * (links[second].1 - links[second].0);
                    if (p - q).norm() < both - margin {
                        return true;
                    }
                }
            }
        }
    }
    false
}

/// Every planned pose of every built-in arm: above the mounting plane, and out of its own links.
#[test]
fn planned_poses_of_built_in_arms_touch_neither_floor_nor_arm() {
    for name in BUILT_IN {
        let robot = load(name);
        let constraints = none(&robot);
        let nominal = robot.chain().unwrap();
        let planner = Planner::new(Task {
            robot: &robot,
            nominal: &nominal,
            constraints: &constraints,
            payloads: &[],
            gravity: Vector3::new(0.0, 0.0, -9.81),
            noise: (30e-6, 50e-6),
            sister: None,
            seed: 5,
            cancel: &crate::progress::NEVER,
        });
        let plan = planner.plan(70, 30, Strategy::SpaceFilling).unwrap();
        let radii = radii(&robot);
        for pose in &plan.poses {
            let points = origins(&robot, &constraints.flange_from_target, &pose.joints);
            assert!(!collides(&points, &radii, 1e-3), "{name}: {pose:?}");
            assert!(above(&points, &radii), "{name}: {pose:?}");
        }
        // The program agrees with this test on configurations as they are drawn, which do collide.
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let chain = constraints.chain(&nominal);
        let mut found = [0; 2];
        for _ in 0..300 {
            let range = |r: &(f64, f64)| r.0 + (r.1 - r.0) * random.random::<f64>();
            let joints: Vec<f64> = constraints.ranges.iter().map(range).collect();
            let points = origins(&robot, &constraints.flange_from_target, &joints);
            let serial = robot.serial_joints(&joints);
            let rules = constraints.forbidden_by(&chain, &serial);
            let refused = rules
                .iter()
                .any(|i| constraints.rules[*i].rule != Rule::Floor(0.0));
            // Points a centimetre apart miss the nearest ones by no more than this.
            assert!(
                refused || !collides(&points, &radii, 1e-3),
                "{name}: {joints:?}"
            );
            assert!(
                !refused || collides(&points, &radii, -0.03),
                "{name}: {joints:?}"
            );
            assert_eq!(
                rules.contains(&0),
                !above(&points, &radii),
                "{name}: {joints:?}"
            );
            found[0] += usize::from(refused);
            found[1] += usize::from(rules.contains(&0));
        }
        assert!(found[1] > 3, "{name}: {found:?}");
        if name.starts_with("ur") {
            assert!(found[0] > 60, "{name}: {found:?}");
        }
    }
}

/// Whether all links behind the second joint are above the mounting plane with their radius.
fn above(points: &[Vector3<f64>], radii: &[f64]) -> bool {
    (2..radii.len()).all(|i| {
        let from = if i == 2 { f64::INFINITY } else { points[i][2] };
        from.min(points[i + 1][2]) >= radii[i]
    })
}

/// Shares of random configurations that each rule refuses; `docs/decisions/calibration.md` quotes what is allowed.
#[test]
fn built_in_arms_keep_enough_configurations() {
    for name in BUILT_IN {
        let robot = load(name);
        let constraints = none(&robot);
        let chain = constraints.chain(&robot.chain().unwrap());
        let found = candidates::draw_within(
            &robot,
            &chain,
            &constraints,
            &constraints.ranges,
            (20_000, 20_000),
            9,
        );
        let percent = |count: usize| 100.0 * count as f64 / found.drawn as f64;
        let of = |i: usize| percent(found.refusals.forbidden_by(i));
        let allowed = percent(found.joints.len());
        println!(
            "{name}: floor {:.1} %, base {:.1} %, links {:.1} %, allowed {allowed:.1} %, radius {:.1} mm",
            of(0),
            of(1),
            of(2),
            1e3 * constraints.links.radii()[0]
        );
        assert!((15.0..90.0).contains(&allowed), "{name}: {allowed}");
        assert!(of(2) < 45.0, "{name}: {}", of(2));
    }
}

/// Ordinary poses of every built-in arm are allowed, and what no arm of its kind can do is not.
#[test]
fn ordinary_poses_are_allowed_and_impossible_ones_are_not() {
    let allowed: [(&str, &[&[f64]]); 5] = [
        (
            "abb-irb120",
            &[
                &[0.0; 6],
                &[30.0, 40.0, 20.0, 10.0, 60.0, 0.0],
                &[0.0, 0.0, 70.0, 0.0, -90.0, 0.0],
            ],
        ),
        (
            "abb-irb4400",
            &[&[0.0; 6], &[-60.0, 50.0, 30.0, 0.0, 45.0, 90.0]],
        ),
        (
            "kuka-iiwa7",
            &[&[0.0; 7], &[0.0, 40.0, 0.0, -80.0, 0.0, 60.0, 0.0]],
        ),
        (
            "ur10",
            &[
                &[0.0, -90.0, 0.0, -90.0, 0.0, 0.0],
                &[0.0, -90.0, -90.0, -90.0, 90.0, 0.0],
                &[10.0, -60.0, -120.0, -90.0, 90.0, 0.0],
            ],
        ),
        (
            "ur5",
            &[
                &[0.0, -90.0, 0.0, -90.0, 0.0, 0.0],
                &[0.0, -90.0, -90.0, -90.0, 90.0, 0.0],
                &[10.0, -60.0, -120.0, -90.0, 90.0, 0.0],
            ],
        ),
    ];
    for (name, poses) in allowed {
        let robot = load(name);
        for pose in poses {
            let found = forbidden(&robot, &none(&robot), pose);
            assert!(found.is_empty(), "{name} {pose:?}: {found:?}");
        }
    }
    let refused: [(&str, &[f64], &str); 6] = [
        // Stretched out, and the wrist hangs down to the table.
        ("ur10", &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "floor"),
        (
            "kuka-iiwa7",
            &[0.0, 115.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            "floor",
        ),
        // The forearm folded onto the upper arm: the wrist reaches the shoulder.
        ("ur5", &[0.0, -90.0, 175.0, -90.0, 90.0, 0.0], "base"),
        // The flange turned into the forearm.
        ("ur5", &[0.0, -90.0, -90.0, 180.0, 180.0, 0.0], "links"),
        ("ur10", &[0.0, -90.0, 178.0, 0.0, 90.0, 0.0], "base"),
        ("abb-irb4400", &[0.0, -70.0, 65.0, 0.0, 120.0, 0.0], "links"),
    ];
    for (name, pose, rule) in refused {
        let robot = load(name);
        let found = forbidden(&robot, &none(&robot), pose);
        println!("{name} {pose:?}: {found:?}");
        assert!(
            found.iter().any(|r| r == rule),
            "{name} {pose:?}: {found:?}"
        );
    }
}

/// The floor is where the file says, or nowhere; of an arm that does not stand on its base there is none.
#[test]
fn the_floor_is_the_mounting_plane_unless_the_file_says_otherwise() {
    let robot = load("kuka-iiwa7");
    let down = [0.0, 115.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(none(&robot).floor(), Some(0.0));
    assert_eq!(forbidden(&robot, &none(&robot), &down), ["floor"]);
    for text in ["floor = false", "floor_mm = -700", "floor_m = -0.7"] {
        let found = forbidden(&robot, &parse(&robot, text), &down);
        assert!(found.is_empty(), "{text}: {found:?}");
    }
    for text in ["floor_m = 1\nfloor_mm = 2", "floor = true\nfloor_mm = 2"] {
        assert!(Constraints::parse(Path::new("cell.toml"), text, &robot).is_err());
    }
    let raised = parse(&robot, "floor_mm = 1300");
    assert_eq!(forbidden(&robot, &raised, &[0.0; 7]), ["floor"]);
    let slide = r#"
        name = "slide"
        convention = "poe"
        [[joint]]
        name = "x"
        kind = "prismatic"
        limits_mm = [0, 2500]
        origin = {}
        axis = [1, 0, 0]
        [[joint]]
        name = "turn"
        kind = "revolute"
        origin = { xyz_mm = [0, 0, 500] }
        axis = [0, 0, 1]
        [flange]
        origin = { xyz_mm = [300, 0, -200] }
    "#;
    let path = Path::new("slide.toml");
    let robot = Robot::parse(path, slide.as_bytes(), &LoadOptions::default()).unwrap();
    assert_eq!(none(&robot).floor(), None);
    assert_eq!(parse(&robot, "floor_mm = -50").floor(), Some(-0.05));
    let error = Constraints::parse(Path::new("cell.toml"), "floor = true", &robot).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("the mounting plane of this robot is not known"),
        "{error}"
    );
}

/// The radius is the constraints', else the link's, else the robot's, else 8 % of the reach; 0 leaves thin links.
#[test]
fn the_radius_is_the_nearest_one_that_is_stated() {
    let robot = load("ur10");
    let links = none(&robot).links;
    assert_eq!(links.source(), RadiusSource::Description);
    assert_eq!(
        links.radii(),
        [0.08, 0.08, 0.065, 0.06, 0.05, 0.05, 0.05, 0.05]
    );
    let links = parse(&robot, "link_radius_mm = 33").links;
    assert_eq!(
        (links.source(), links.radii()),
        (RadiusSource::Constraints, &[0.033; 8][..])
    );
    let robot = load("abb-irb120");
    let links = none(&robot).links;
    assert_eq!(links.source(), RadiusSource::Reach);
    assert!((links.reach() - 0.714).abs() < 1e-12);
    assert!(
        links
            .radii()
            .iter()
            .all(|r| (r - RADIUS_SHARE * 0.714).abs() < 1e-12)
    );
    // Folded; thin links lie beside each other, thick ones do not.
    let (robot, folded) = (load("ur5"), [0.0, -90.0, 165.0, -90.0, 90.0, 0.0]);
    assert_eq!(
        forbidden(&robot, &parse(&robot, "link_radius_mm = 5"), &folded),
        [""; 0]
    );
    assert!(!forbidden(&robot, &none(&robot), &folded).is_empty());
}

/// A box that no joint is in, but a link: with its radius it is inside from further away.
#[test]
fn links_stay_out_of_boxes() {
    let robot = load("abb-irb4400-serial");
    // Between elbow and wrist, beside the forearm, which lies at y = 0 and z = 1.72 m.
    let beside = |mm: f64| {
        parse(
            &robot,
            &format!(
                "[[keep_out]]\nname = \"post\"\nmin_mm = [600, {mm}, 0]\nmax_mm = [650, 900, 3000]"
            ),
        )
    };
    let pose = [0.0; 6];
    assert_eq!(
        forbidden(&robot, &beside(-100.0), &pose),
        ["keep_out \"post\""]
    );
    assert_eq!(
        forbidden(&robot, &beside(160.0), &pose),
        ["keep_out \"post\""]
    );
    assert_eq!(forbidden(&robot, &beside(170.0), &pose), [""; 0]);
}
