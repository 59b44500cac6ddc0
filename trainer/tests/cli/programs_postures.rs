//! `trainer correct` of robot programs: `cfx` of RAPID and `S` of KRL choose between the sides of shoulder, elbow and wrist.

use std::f64::consts::FRAC_PI_2;

use poegp_calibration::blob::commander::{Commander, Joints, joint_distance, pose_distance};
use poegp_trainer::robot_programs::correction::posture::Arm;
use poegp_trainer::robot_programs::correction::program::{Convention, Posture};
use poegp_trainer::robot_programs::dialect::Orientation;

use crate::program::Folder;
use crate::programs::commander;
use crate::texts::texts;

/// Ranges of the joints in degrees, within the limits of the IRB 120.
const RANGES: [(f64, f64); 6] = [
    (-157.0, 157.0),
    (-102.0, 102.0),
    (-102.0, 62.0),
    (-152.0, 152.0),
    (-112.0, 112.0),
    (-167.0, 167.0),
];
/// Lengths of the IRB 120 in mm: lower arm, upper arm, and how far axis 4 is above axis 3.
const LENGTHS: [f64; 3] = [270.0, 302.0, 70.0];
const POSES: usize = 150;
/// Fewest of them that are near the training data.
const TRUSTED: usize = 130;
const NO_AXES: &str = "[9E9,9E9,9E9,9E9,9E9,9E9]";

fn folder() -> Folder {
    Folder::prepared("postures", |folder| {
        folder
            .run("simulate --robot abb-irb120 --poses 120 --test-sets 1 --payloads 0,2 --seed 7 --out cell")
            .ok();
        let line = "calibrate --robot abb-irb120 cell/train.csv --method elastic --inducing-points 60 --out arm.blob";
        folder.run(line).ok();
    })
}

/// Distances in mm by which the wrist centre is in front of axis 1 and of the lower arm, from the lengths of the arm.
fn in_front(joints: &Joints) -> [f64; 2] {
    let [lower, upper, above] = LENGTHS;
    let (two, three) = (joints[1], joints[2]);
    let from_one = lower * two.sin() + upper * (two + three).cos() + above * (two + three).sin();
    [from_one, upper * three.cos() + above * three.sin()]
}

/// Joints all over their ranges, beside no singularity.
fn scattered() -> Vec<Joints> {
    let mut state = 20_u64;
    let mut random = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut out = Vec::new();
    while out.len() < POSES {
        let mut joints = [0.0; 8];
        for (slot, (lower, upper)) in joints.iter_mut().zip(RANGES) {
            *slot = (lower + (upper - lower) * random()).to_radians();
        }
        let is_clear = in_front(&joints).iter().all(|mm| mm.abs() > 20.0);
        if is_clear && joints[4].abs() > 0.1 {
            out.push(joints);
        }
    }
    out
}

/// Corrects a program of moves to poses. Demands that each corrected target has the joints that were meant.
fn meant(folder: &Folder, commander: &Commander, name: &str, text: &str) {
    folder.write(name, text);
    let code = folder
        .run(&format!(
            "correct arm.blob {name} --payload-kg 1 --out out_{name}"
        ))
        .code;
    assert!(matches!(code, Some(0 | 1)), "{code:?}");
    let all = scattered();
    let record = folder.json(&format!("out_{name}.poegp.json"));
    let mut found = 0;
    for target in record["targets"].as_array().unwrap().iter().skip(1) {
        let mut joints = [0.0; 8];
        for (slot, q) in joints.iter_mut().zip(target["joints"].as_array().unwrap()) {
            *slot = q.as_f64().unwrap();
        }
        let flange = commander.nominal_flange(&joints);
        let there = all.iter().filter(|meant| {
            let (moved, turned) = pose_distance(&commander.nominal_flange(meant), &flange);
            moved < 1e-5 && turned < 1e-4
        });
        let apart = there
            .map(|meant| joint_distance(meant, &joints))
            .fold(f64::INFINITY, f64::min);
        assert!(apart < 0.01, "{joints:?} is {apart} from what was meant");
        found += 1;
    }
    assert!(found >= TRUSTED, "{found}");
}

fn numbers(commander: &Commander, joints: &Joints, orientation: Orientation) -> Vec<String> {
    let pose = commander.nominal_flange(joints);
    let position = pose.translation.iter().map(|x| format!("{:.4}", 1e3 * x));
    let turned = orientation.numbers(&pose.rotation).into_iter();
    position.chain(turned.map(|n| format!("{n:.7}"))).collect()
}

fn robtarget(commander: &Commander, joints: &Joints, cfx: u32) -> String {
    let n = numbers(commander, joints, Orientation::Quaternion);
    let [one, four, six] = [0, 3, 5].map(|i| (joints[i] / FRAC_PI_2).floor() as i32);
    let (position, turned) = (n[..3].join(","), n[3..].join(","));
    format!("[[{position}],[{turned}],[{one},{four},{six},{cfx}],{NO_AXES}]")
}

fn cfx(joints: &Joints) -> u32 {
    let [shoulder, elbow] = in_front(joints).map(|mm| u32::from(mm < 0.0));
    4 * shoulder + 2 * elbow + u32::from(joints[4] < 0.0)
}

fn rapid(moves: &[String]) -> String {
    let moves: Vec<String> = moves
        .iter()
        .map(|to| format!("MoveJ {to},v1,fine,tool0;\n"))
        .collect();
    let home = format!("MoveAbsJ [[0,0,0,0,30,0],{NO_AXES}],v1,fine,tool0;");
    format!(
        "MODULE M\nPROC main()\n{home}\n{}ENDPROC\nENDMODULE\n",
        moves.concat()
    )
}

#[test]
fn cfx_chooses_shoulder_elbow_and_wrist() {
    let folder = folder();
    let commander = commander(&folder, "arm.blob");
    let target = |joints: &Joints| robtarget(&commander, joints, cfx(joints));
    let moves: Vec<String> = scattered().iter().map(target).collect();
    meant(&folder, &commander, "a.mod", &rapid(&moves));
}

fn status(joints: &Joints) -> u32 {
    let [shoulder, elbow] = in_front(joints);
    u32::from(shoulder < 0.0) + 2 * u32::from(elbow > 0.0) + 4 * u32::from(joints[4] < 0.0)
}

/// KRL of motions to poses, each with what `configuration` says of its joints.
fn krl(
    commander: &Commander,
    joints: &[Joints],
    configuration: impl Fn(&Joints) -> String,
) -> String {
    let mut text =
        "DEF A( )\n$TOOL=$NULLFRAME\n$BASE=$WORLD\nPTP {A1 0,A2 0,A3 0,A4 0,A5 30,A6 0}\n"
            .to_owned();
    for joints in joints {
        let n = numbers(commander, joints, Orientation::TurnedZyx);
        let named = ["X", "Y", "Z", "A", "B", "C"].iter().zip(&n);
        let named: Vec<String> = named.map(|(name, n)| format!("{name} {n}")).collect();
        text += &format!("PTP {{{}{}}}\n", named.join(","), configuration(joints));
    }
    text + "END\n"
}

fn turn(joints: &Joints) -> u32 {
    (0..6).fold(0, |bits, i| bits | u32::from(joints[i] < 0.0) << i)
}

#[test]
fn the_status_of_a_krl_point_chooses_shoulder_elbow_and_wrist() {
    let folder = folder();
    let commander = commander(&folder, "arm.blob");
    // Bit 4 is set where the robot is absolutely accurate.
    for extra in [0, 16] {
        let stated = |joints: &Joints| format!(",S {},T {}", status(joints) + extra, turn(joints));
        let text = krl(&commander, &scattered(), stated);
        meant(&folder, &commander, "a.src", &text);
    }
    let binary =
        |joints: &Joints| format!(",S 'B{:03b}',T 'B{:06b}'", status(joints), turn(joints));
    let text = krl(&commander, &scattered(), binary);
    meant(&folder, &commander, "a.src", &text);
}

/// A point without `S`: nothing decides between two elbows, and their corrections differ.
#[test]
fn a_side_that_nothing_states_is_said() {
    let folder = folder();
    let commander = commander(&folder, "arm.blob");
    let remark = |configuration: &dyn Fn(&Joints) -> String| {
        folder.write("b.src", krl(&commander, &scattered(), configuration));
        folder.run("correct arm.blob b.src --payload-kg 1 --json b.json --dry-run --out c.src");
        folder.json("b.json")["remarks"].to_string()
    };
    let open = "nothing states on which side the target has the wrist, the elbow or the shoulder";
    let without = remark(&|joints| format!(",T {}", turn(joints)));
    assert!(without.contains(open), "{without}");
    let with = remark(&|joints| format!(",S {},T {}", status(joints), turn(joints)));
    assert!(!with.contains(open), "{with}");
}

/// A robot that does not use `cfx` has 0 there: it is no reason to refuse a target, but another number is.
#[test]
fn a_cfx_that_no_solution_has_is_refused_unless_it_is_zero() {
    let _texts = texts();
    let folder = folder();
    let commander = commander(&folder, "arm.blob");
    let mut joints = [0.0; 8];
    for (q, degrees) in joints
        .iter_mut()
        .zip([10.0, 20.0, -10.0, 15.0, -45.0, 30.0_f64])
    {
        *q = degrees.to_radians();
    }
    assert_eq!(cfx(&joints), 1);
    folder.write("zero.mod", rapid(&[robtarget(&commander, &joints, 0)]));
    folder
        .run("correct arm.blob zero.mod --payload-kg 1 --out zero_out.mod")
        .ok();
    folder.write("other.mod", rapid(&[robtarget(&commander, &joints, 5)]));
    let said = folder.refuses("correct arm.blob other.mod --payload-kg 1 --out other_out.mod");
    assert!(
        said.stderr.contains("in its stated configuration ["),
        "{}",
        said.stderr
    );
}

/// Rods keep the wrist of the IRB 4400 from turning with axis 2, and its controller does not use `cfx`.
#[test]
fn cfx_says_nothing_of_an_arm_with_rods() {
    let folder = Folder::prepared("postures_rods", |folder| {
        for robot in ["abb-irb4400", "abb-irb4400-serial", "ur10"] {
            folder.run(&format!("simulate --robot {robot} --poses 40 --test-sets 1 --payloads 0,2 --seed 7 --out {robot}")).ok();
            folder.run(&format!("calibrate --robot {robot} {robot}/train.csv --method base-tool --out {robot}.blob")).ok();
        }
    });
    let posture = |convention| Posture {
        convention,
        bits: 3,
        is_certain: true,
    };
    for (robot, cfx, status) in [
        (
            "abb-irb4400",
            [None; 3],
            [Some(false), Some(false), Some(true)],
        ),
        (
            "abb-irb4400-serial",
            [Some(true), Some(true), Some(false)],
            [Some(false), Some(false), Some(true)],
        ),
        ("ur10", [None; 3], [None; 3]),
    ] {
        let arm = Arm::of(&commander(&folder, &format!("{robot}.blob")));
        assert_eq!(arm.stated(&posture(Convention::Cfx)), cfx, "{robot}");
        assert_eq!(arm.stated(&posture(Convention::Status)), status, "{robot}");
    }
}
