use crate::identification::base_tools::with_base_and_tool;
use crate::identification::identifiability::*;
use crate::robot::{Joint, LoadOptions, Robot};
use poegp_protocol::JointKind;

fn robot(name: &str) -> Robot {
    Robot::load(name, &LoadOptions::default()).unwrap()
}

fn noise() -> NoiseScales {
    NoiseScales::uniform(50e-6, 100e-6)
}

/// `count` random poses of `robot` whose joints `change` may alter.
fn poses(robot: &Robot, count: usize, change: impl Fn(usize, &mut Vec<f64>)) -> Vec<BaseSample> {
    let chain = robot.chain().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    (0..count)
        .map(|k| {
            let mut joints: Vec<f64> = robot
                .joints
                .iter()
                .map(|j| {
                    let widest = (-1.5, 1.5);
                    let (lower, upper) = j.limits.unwrap_or(widest);
                    let (lower, upper) = (lower.max(-1.5), upper.min(1.5));
                    lower + (upper - lower) * random.random::<f64>()
                })
                .collect();
            change(k, &mut joints);
            let serial_joints = robot.serial_joints(&joints);
            let observation = Observation::Pose(chain.forward(&serial_joints));
            Sample::new(joints, serial_joints, observation, Base)
        })
        .collect()
}

#[track_caller]
fn report(robot: &Robot, samples: &[BaseSample]) -> IdentifyReport {
    // The target is off the last joint's axis: on it, its position would not show that joint.
    let tool = Pose::exp(&poegp_runtime::math::se3::Twist::from_array(&[
        0.08, -0.05, 0.12, 0.3, 0.2, -0.4,
    ]));
    let chain = with_base_and_tool(&robot.chain().unwrap(), &Pose::identity(), &tool);
    let task = Task {
        robot,
        chain: &chain,
        tools: &vec![Pose::identity(); 1 + samples.iter().map(|s| s.tool).max().unwrap()],
        samples,
        noise: noise(),
        base_and_tools_only: false,
    };
    let report = identify(&task).unwrap();
    println!("{:#?}\n{}", report.findings, report.lines().join("\n"));
    assert_eq!(
        report.rank + report.redundant + report.unidentified,
        report.parameters
    );
    let counted: usize = report.findings.iter().map(|f| f.directions).sum();
    assert_eq!(
        counted, report.unidentified,
        "every direction is spoken of once"
    );
    assert!(report.lines().len() <= 8);
    for frame in &report.standard_deviations {
        assert!(frame.mm.iter().chain(&frame.mrad).all(|x| x.is_finite()));
    }
    assert!(report.expected.rms_mm > 0.0 && report.expected.worst_mm.is_finite());
    assert!(serde_json::to_string(&report).is_ok());
    report
}

#[test]
fn random_poses_leave_only_what_is_redundant() {
    for (name, rank, parameters) in [
        ("abb-irb4400-serial", 30, 42),
        ("abb-irb4400", 30, 42),
        ("ur5", 30, 42),
        ("kuka-iiwa7", 34, 48),
    ] {
        let robot = robot(name);
        let r = report(&robot, &poses(&robot, 100, |_, _| {}));
        assert_eq!(
            (r.rank, r.parameters, r.unidentified),
            (rank, parameters, 0),
            "{name}"
        );
        assert!(r.findings.is_empty());
        assert!(r.condition.unwrap() < 1e3, "{:?}", r.condition);
        assert!(r.expected.rms_mm < 0.05, "{:?}", r.expected);
    }
}

#[test]
fn a_joint_that_never_moves() {
    let robot = robot("abb-irb4400-serial");
    for joint in 1..=6 {
        let samples = poses(&robot, 80, |k, q| {
            q[joint - 1] = 0.2 + 1e-5 * libm::sin(k as f64);
        });
        let r = report(&robot, &samples);
        assert_eq!(r.unidentified, 4, "joint {joint}");
        assert_eq!(r.findings.len(), 1);
        let expected = format!("joint {joint} never moves");
        assert!(r.findings[0].text.starts_with(&expected));
    }
}

#[test]
fn only_two_joints_move() {
    let robot = robot("kuka-iiwa7");
    let mut samples = poses(&robot, 60, |_, q| q[2..].fill(0.0));
    for (k, sample) in samples.iter_mut().enumerate() {
        sample.payload_kg = Some(if k % 2 == 0 { 0.0 } else { 2.5 });
        sample.tool = k % 2;
    }
    let r = report(&robot, &samples);
    assert!(
        r.findings[0]
            .text
            .starts_with("joints 3, 4, 5, 6 and 7 never move")
    );
    assert!(r.findings[0].directions >= 18, "{:?}", r.findings);
    let all = serde_json::to_string(&r.findings).unwrap();
    assert!(all.contains("only joints 1 and 2 move"), "{all}");
    assert!(all.contains("was remounted"), "{all}");
}

#[test]
fn one_orientation() {
    // Joints 1, 4 and 6 swing and nothing tilts: a planar arm whose last joint keeps the tool.
    let robot = robot("abb-irb4400-serial");
    let samples = poses(&robot, 80, |_, q| {
        (q[3], q[5]) = (0.0, 0.0);
        q[0] = 0.3;
        q[4] = 0.4 - q[1] - q[2];
    });
    let r = report(&robot, &samples);
    let all = serde_json::to_string(&r.findings).unwrap();
    assert!(all.contains("same tool orientation"), "{all}");
    assert!(all.contains("joints 1, 4 and 6 never move"), "{all}");
}

#[test]
fn offsets_that_poses_mix_are_told_in_words() {
    // With joint 5 straight, joints 4 and 6 turn about one line.
    let robot = robot("abb-irb4400-serial");
    let r = report(
        &robot,
        &poses(&robot, 80, |k, q| q[4] = 5e-3 * libm::sin(k as f64)),
    );
    let all = serde_json::to_string(&r.findings).unwrap();
    assert!(all.contains("joint 4's offset"), "{all}");
    assert!(
        all.contains("cannot be distinguished by these poses"),
        "{all}"
    );
}

#[test]
fn a_payload_that_goes_with_a_joint() {
    let robot = robot("ur5");
    let mut samples = poses(&robot, 60, |_, _| {});
    for sample in &mut samples {
        sample.payload_kg = Some(2.0 + sample.joints[1]);
    }
    let r = report(&robot, &samples);
    assert_eq!(r.unidentified, 0);
    assert!(r.findings[0].text.contains("only together with joint 2"));
}

#[test]
fn positions_only() {
    let robot = robot("ur5");
    let mut samples = poses(&robot, 60, |_, _| {});
    for s in &mut samples {
        s.observation = Observation::Position(s.observation.position());
    }
    let r = report(&robot, &samples);
    assert_eq!(r.unidentified, 3);
    assert!(r.findings[0].text.starts_with("only positions"));
}

#[test]
fn slides_and_short_arms() {
    let mut robot = robot("ur5");
    robot.joints.truncate(5);
    robot.parent_from_joint.remove(6);
    robot.joints[2] = Joint {
        name: "slide".into(),
        kind: JointKind::Prismatic,
        limits: Some((0.0, 0.4)),
        gear_lines: Vec::new(),
        link_radius: None,
    };
    let r = report(&robot, &poses(&robot, 60, |_, _| {}));
    assert_eq!((r.parameters, r.redundant, r.unidentified), (36, 12, 0));
    let r = report(&robot, &poses(&robot, 60, |_, q| q[2] = 0.1));
    assert_eq!(r.unidentified, 2);
    assert!(r.findings[0].text.starts_with("joint 3 never moves"));
}

#[test]
fn hardly_any_poses() {
    let robot = robot("kuka-iiwa7");
    for count in [1, 2, 5] {
        let r = report(&robot, &poses(&robot, count, |_, _| {}));
        assert!(r.rank <= 6 * count);
    }
    assert!(
        identify(&Task {
            robot: &robot,
            chain: &robot.chain().unwrap(),
            tools: &[Pose::identity()],
            samples: &[],
            noise: noise(),
            base_and_tools_only: false,
        })
        .is_none()
    );
}

#[test]
fn base_and_tool_only() {
    let robot = robot("ur5");
    let chain = robot.chain().unwrap();
    let samples = poses(&robot, 60, |_, q| q[2] = 0.3);
    let r = identify(&Task {
        robot: &robot,
        chain: &chain,
        tools: &[Pose::identity()],
        samples: &samples,
        noise: noise(),
        base_and_tools_only: true,
    })
    .unwrap();
    assert_eq!((r.rank, r.parameters, r.unidentified), (12, 12, 0));
}

#[test]
fn any_number_of_joints_of_any_kind() {
    for count in 1..=7 {
        for slides in [0, 1, count] {
            let mut robot = robot("kuka-iiwa7");
            robot.joints.truncate(count);
            robot.parent_from_joint.truncate(count + 1);
            for joint in &mut robot.joints[..slides] {
                joint.kind = JointKind::Prismatic;
                joint.limits = None;
            }
            let r = report(&robot, &poses(&robot, 50, |_, _| {}));
            assert_eq!(r.unidentified, 0, "{count} joints, {slides} slides");
            assert!(r.redundant >= 2 * count + 2 * slides);
        }
    }
}
