//! `trainer correct` of robot programs: numbers of a configuration that follow from the joints, where the correction takes a
//! joint over a boundary. With the old number the controller would go a whole turn round, or stop.

use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_runtime::math::se3::Pose;
use poegp_trainer::robot_programs::correction::posture::{Sides, sides};
use poegp_trainer::robot_programs::dialect::Orientation;

use crate::program::{Folder, changed};
use crate::programs::{commander, folder, numbers_after};

const HOME: [f64; 6] = [8.0, 22.0, 1.0, -14.0, 46.0, 24.0];

/// Joints of which the correction takes one over an angle in degrees; and the corrected ones.
fn over(commander: &Commander, joint: usize, at: f64) -> (Joints, Joints) {
    let mut joints = [0.0; 8];
    for (q, degrees) in joints.iter_mut().zip(HOME) {
        *q = degrees.to_radians();
    }
    joints[joint] = at.to_radians();
    let moved = commander.correct(&joints, 2.5).joints[joint] - joints[joint];
    joints[joint] -= 0.5 * moved;
    let command = commander.correct(&joints, 2.5).joints;
    let [before, after] = [joints, command].map(|q| q[joint] - at.to_radians());
    assert!(before * after < 0.0, "{joint} {before} {after}");
    (joints, command)
}

/// The flange at joints: millimetres, and the numbers of an orientation.
fn flange(commander: &Commander, joints: &Joints, orientation: Orientation) -> Vec<String> {
    let pose = commander.nominal_flange(joints);
    let position = pose.translation.iter().map(|x| format!("{:.3}", 1e3 * x));
    let turned = orientation.numbers(&pose.rotation).into_iter();
    position.chain(turned.map(|n| format!("{n:.7}"))).collect()
}

/// A corrected program, whose inverse states what the program has stated.
fn corrected(folder: &Folder, name: &str, text: &str, stated: &str) -> String {
    folder.write(name, text);
    let run = |from: &str, to: &str| {
        let line = format!("correct elas.blob {from} --payload-kg 2.5 --out {to}");
        folder.run(&line).ok();
        String::from_utf8(folder.read(to)).unwrap()
    };
    let out = format!("out_{name}");
    let after = run(name, &out);
    assert!(text.contains(stated), "{text}");
    let line = format!("correct elas.blob {out} --payload-kg 2.5 --inverse --out back_{name}");
    folder.run(&line).ok();
    let back = String::from_utf8(folder.read(&format!("back_{name}"))).unwrap();
    assert!(back.contains(stated), "{back}");
    after
}

#[test]
fn the_turn_of_a_krl_point_has_the_signs_of_the_corrected_joints() {
    let folder = folder();
    let commander = commander(&folder, "elas.blob");
    for joint in [0, 2, 3, 5] {
        let (joints, command) = over(&commander, joint, 0.0);
        let signs = |q: &Joints| (0..6).fold(0, |bits, i| bits | u32::from(q[i] < 0.0) << i);
        let (old, new) = (signs(&joints), signs(&command));
        assert_eq!(old ^ new, 1 << joint);
        let n = flange(&commander, &joints, Orientation::TurnedZyx);
        let program = |motion: &str, turn: &str| {
            format!(
                "DEF A( )\n$TOOL=$NULLFRAME\n$BASE=$WORLD\nPTP {{A1 8,A2 22,A3 1,A4 -14,A5 46,A6 24}}\n\
                 {motion} {{X {},Y {},Z {},A {},B {},C {},S 2,{turn}}}\nEND\n",
                n[0], n[1], n[2], n[3], n[4], n[5]
            )
        };
        let plain = |bits: u32| format!("T {bits}}}");
        let binary = |bits: u32| format!("T 'B{bits:06b}'}}");
        let hexadecimal = |bits: u32| format!("T 'H{bits:02X}'}}");
        for turn in [plain, binary, hexadecimal].map(|of| [of(old), of(new)]) {
            let [old, new] = turn.map(|turn| turn.trim_end_matches('}').to_owned());
            let after = corrected(&folder, "a.src", &program("PTP", &old), &old);
            assert!(after.contains(&format!("{new}}}")), "{new}\n{after}");
        }
        // A line does not look at the bits: one that was not true before stays.
        let other = format!("T {}", old ^ 2);
        let after = corrected(&folder, "a.src", &program("LIN", &other), &other);
        let other = format!("T {}}}", new ^ 2);
        assert!(after.contains(&other), "{other}\n{after}");
    }
}

#[test]
fn the_quarters_of_a_robtarget_are_those_of_the_corrected_joints() {
    let folder = folder();
    let commander = commander(&folder, "elas.blob");
    for (joint, at) in [(0, 0.0), (3, 0.0), (5, 0.0), (5, 90.0)] {
        let (joints, command) = over(&commander, joint, at);
        let quarters = |q: &Joints| {
            let [one, four, six] = [0, 3, 5].map(|i| (q[i].to_degrees() / 90.0).floor() as i32);
            format!("[{one},{four},{six},0]")
        };
        let n = flange(&commander, &joints, Orientation::Quaternion);
        let old = quarters(&joints);
        let text = format!(
            "MODULE M\nPROC main()\nMoveAbsJ [[8,22,1,-14,46,24],[9E9,9E9,9E9,9E9,9E9,9E9]],v1,fine,tool0;\n\
             MoveJ [[{}],[{}],{old},[9E9,9E9,9E9,9E9,9E9,9E9]],v1,fine,tool0;\nENDPROC\nENDMODULE\n",
            n[..3].join(","),
            n[3..].join(",")
        );
        let after = corrected(&folder, "a.mod", &text, &old);
        assert!(after.contains(&quarters(&command)), "{joint} {at}\n{after}");
    }
}

/// Joints beside the singularity of the wrist, which the correction takes to its other side.
fn flipped(commander: &Commander) -> Joints {
    let at = |q5: f64| {
        let mut joints = [0.0; 8];
        for (q, degrees) in joints.iter_mut().zip(HOME) {
            *q = degrees.to_radians();
        }
        joints[4] = q5;
        joints
    };
    let flips = |joints: &Joints| {
        let to = commander.correct_target(joints, 2.5, &Pose::identity());
        to.joints[4] * joints[4] < 0.0
    };
    let near = (1..200).flat_map(|k| [1e-5, -1e-5].map(|step| step * f64::from(k)));
    near.map(at).find(flips).unwrap()
}

/// The side of the wrist is stated, and no number of the target states it again: with the corrected pose the controller would
/// turn axes 4 and 6 by half a turn.
#[test]
fn a_target_that_would_flip_the_wrist_stays() {
    let folder = folder();
    let commander = commander(&folder, "elas.blob");
    let joints = flipped(&commander);
    let quarter = |i: usize| (joints[i].to_degrees() / 90.0).floor() as i32;
    let signs = (0..6).fold(0, |bits, i| bits | u32::from(joints[i] < 0.0) << i);
    let is_negative = u32::from(joints[4] < 0.0);
    let pose = |orientation| flange(&commander, &joints, orientation);
    let (quaternion, angles) = (pose(Orientation::Quaternion), pose(Orientation::TurnedZyx));
    let near = format!("8,22,1,-14,{},24", joints[4].to_degrees());
    let target = format!(
        "[[{}],[{}],[{},{},{},{is_negative}]",
        quaternion[..3].join(","),
        quaternion[3..].join(","),
        quarter(0),
        quarter(3),
        quarter(5)
    );
    let point = format!(
        "X {},Y {},Z {},A {},B {},C {},S 2,T {signs}",
        angles[0], angles[1], angles[2], angles[3], angles[4], angles[5]
    );
    let programs = [
        (
            "a.mod",
            &target,
            format!(
                "MODULE M\nPROC main()\nMoveAbsJ [[{near}],[9E9,9E9,9E9,9E9,9E9,9E9]],v1,fine,tool0;\n\
                 MoveJ {target},[9E9,9E9,9E9,9E9,9E9,9E9]],v1,fine,tool0;\nENDPROC\nENDMODULE\n"
            ),
        ),
        (
            "a.src",
            &point,
            format!(
                "DEF A( )\n$TOOL=$NULLFRAME\n$BASE=$WORLD\nPTP {{A1 8,A2 22,A3 1,A4 -14,A5 {},A6 24}}\n\
                 PTP {{{point}}}\nEND\n",
                joints[4].to_degrees()
            ),
        ),
    ];
    for (name, target, text) in programs {
        folder.write(name, &text);
        let line = format!("correct elas.blob {name} --payload-kg 2.5 --out out_{name}");
        let outcome = folder.run(&line);
        assert_eq!(outcome.code, Some(1), "{outcome:#?}");
        assert!(
            outcome.stderr.contains("joint 5 would leave"),
            "{outcome:#?}"
        );
        let after = folder.text(&format!("out_{name}"));
        assert!(after.contains(target) && after != text, "{after}");
    }
}

/// A listing states whole turns, which change with the joint; a job states for many positions that there are none, so that a
/// position that would leave them stays.
#[test]
fn whole_turns_change_or_the_target_stays() {
    let folder = folder();
    let commander = commander(&folder, "elas.blob");
    folder.write(
        "f.toml",
        "[tool.\"0\"]\nxyz_mm = [0, 0, 0]\nquaternion = [1, 0, 0, 0]\n",
    );
    for (joint, at) in [(5, 180.0), (5, -180.0), (5, 150.0)] {
        let (joints, command) = over(&commander, joint, at);
        let turns = |q: &Joints| {
            let [one, four, six] = [0, 3, 5].map(|i| (q[i].to_degrees() / 360.0).round() as i32);
            format!("'N U T, {one}, {four}, {six}'")
        };
        let n = flange(&commander, &joints, Orientation::FixedXyz);
        let old = turns(&joints);
        let text = format!(
            "/PROG A\n/MN\n   1:J P[1] 20% FINE ;\n   2:J P[2] 20% FINE ;\n/POS\nP[1]{{\n   GP1:\n\tUF : 0, UT : 0,\n\tJ1= 8.000 deg,\t\
             J2= 22.000 deg,\tJ3= 1.000 deg,\n\tJ4= -14.000 deg,\tJ5= 46.000 deg,\tJ6= {} deg\n}};\nP[2]{{\n   GP1:\n\tUF : 0, UT : 0,\t\
             CONFIG : {old},\n\tX = {} mm,\tY = {} mm,\tZ = {} mm,\n\tW = {} deg,\tP = {} deg,\tR = {} deg\n}};\n/END\n",
            0.8 * at,
            n[0],
            n[1],
            n[2],
            n[3],
            n[4],
            n[5]
        );
        let after = corrected(&folder, "a.ls", &text, &old);
        assert!(after.contains(&turns(&command)), "{joint} {at}\n{after}");
        let mut home = [0.0; 8];
        for (q, degrees) in home.iter_mut().zip(HOME) {
            *q = degrees.to_radians();
        }
        let home = flange(&commander, &home, Orientation::FixedXyz);
        // The job states half a turn at most: beyond 180° the joint is a whole turn back, and its command beyond -180°.
        let is_beyond = at.abs() == 180.0;
        let text = format!(
            "/JOB\n//NAME A\n//POS\n///NPOS 1,0,0,0,0,0\n///TOOL 0\n///POSTYPE BASE\n///RECTAN\n///RCONF 0,0,0,0,0,0,0,0\n\
             C00000={}\nC00001={}\n//INST\nNOP\nMOVJ C00000 VJ=1\nMOVL C00001 V=1\nEND\n",
            home.join(","),
            n.join(",")
        );
        folder.write("a.jbi", text);
        let line =
            "correct elas.blob a.jbi --frames f.toml --payload-kg 2.5 --json - --out out.jbi";
        let document = folder.run(line).json();
        let left = document["left"].to_string();
        assert_eq!(
            left.contains("would leave the range"),
            is_beyond,
            "{joint} {at} {left}"
        );
    }
}

/// On a line an arm keeps its configuration, however far its joints turn: the solution at its end is the one to which the line
/// leads, and not the one whose joints are nearest to those at its start.
#[test]
fn a_line_is_followed_to_its_end() {
    let folder = folder();
    let commander = commander(&folder, "elas.blob");
    let start = [8.0, 22.0, 1.0, -14.0, 46.0, 24.0];
    for (k, turned) in [120.0, 150.0, 165.0, 175.0, -150.0, -170.0]
        .into_iter()
        .enumerate()
    {
        let mut joints = [0.0; 8];
        let by = [
            3.0 * k as f64,
            2.0,
            -4.0,
            35.0,
            -6.0 * k as f64 / 5.0,
            turned,
        ];
        for ((q, from), by) in joints.iter_mut().zip(start).zip(by) {
            *q = f64::to_radians(from + by);
        }
        let n = flange(&commander, &joints, Orientation::TurnedZyx);
        let text = format!(
            "DEF A( )\n$TOOL=$NULLFRAME\n$BASE=$WORLD\nPTP {{A1 8,A2 22,A3 1,A4 -14,A5 46,A6 24}}\n\
             LIN {{X {},Y {},Z {},A {},B {},C {}}}\nEND\n",
            n[0], n[1], n[2], n[3], n[4], n[5]
        );
        folder.write("a.src", text);
        let outcome = folder
            .run("correct elas.blob a.src --payload-kg 2.5 --out out.src")
            .ok();
        assert!(!outcome.stdout.contains("does not keep"), "{outcome:#?}");
        let command = commander
            .correct_target(&joints, 2.5, &Pose::identity())
            .joints;
        let wanted = commander.nominal_flange(&command).translation;
        let written = numbers_after(&folder.read("out.src"), "LIN {X ", 3);
        let off = (wanted - nalgebra::Vector3::from_column_slice(&written) / 1000.0).norm();
        assert!(off < 5e-6, "{turned}: {off:e}");
    }
}

/// Returns a listing of positions, each with its frames, and of moves to them in their order.
fn listing(positions: &[String]) -> String {
    let numbered = || positions.iter().enumerate().map(|(i, text)| (i + 1, text));
    let moves: String = numbered()
        .map(|(i, _)| format!("   {i}:J P[{i}] 20% FINE ;\n"))
        .collect();
    let taught =
        numbered().map(|(i, text)| format!("P[{i}]{{\n   GP1:\n\tUF : 0, UT : 0,\t{text}\n}};\n"));
    format!(
        "/PROG A\n/MN\n{moves}/POS\n{}/END\n",
        taught.collect::<String>()
    )
}

/// The letters of a configuration determine the branch, however far the joints before are; and `--inverse` takes the same.
#[test]
fn a_listing_is_on_the_branch_of_its_letters() {
    let folder = folder();
    let commander = commander(&folder, "elas.blob");
    let joints_of = |degrees: [f64; 6]| {
        let mut joints = [0.0; 8];
        for (q, degrees) in joints.iter_mut().zip(degrees) {
            *q = degrees.to_radians();
        }
        joints
    };
    let stated = |degrees: [f64; 6]| {
        let all: Vec<String> = (1..)
            .zip(degrees)
            .map(|(i, q)| format!("J{i}= {q} deg"))
            .collect();
        all.join(",")
    };
    // A wrist that is turned the other way, and an arm that reaches over its back, have other letters.
    let posed = |degrees: [f64; 6]| {
        let n = flange(&commander, &joints_of(degrees), Orientation::FixedXyz);
        let turns = [0, 3, 5].map(|i| (degrees[i] / 360.0).round() as i32);
        let letter = if degrees[4] < 0.0 { "F" } else { "N" };
        format!(
            "CONFIG : '{letter} U T, {}, {}, {}',\n\tX = {} mm,\tY = {} mm,\tZ = {} mm,\n\tW = {} deg,\tP = {} deg,\tR = {} deg",
            turns[0], turns[1], turns[2], n[0], n[1], n[2], n[3], n[4], n[5]
        )
    };
    let numbers = |name: &str| -> Vec<Vec<f64>> {
        let text = folder.text(name);
        let (_, taught) = text.split_once("/POS").unwrap();
        let of = |text: &str| {
            let values = text.split('=').skip(1);
            let number = |value: &str| value.split_whitespace().next().unwrap().parse().unwrap();
            values.map(number).collect()
        };
        taught.split("P[").skip(1).map(of).collect()
    };
    let run = |text: &str| {
        folder.write("a.ls", text);
        folder.write("b.ls", "");
        let outcome = folder
            .run("correct elas.blob a.ls --payload-kg 2.5 --out b.ls")
            .ok();
        (outcome.stdout, numbers("a.ls"), numbers("b.ls"))
    };
    let poses = [
        [12.0, -15.0, 4.0, 79.0, 38.0, 67.0],
        [-23.0, 33.0, 11.0, -80.0, 34.0, 120.0],
        [4.0, 45.0, -3.0, -57.0, -39.0, 9.0],
    ];
    for first in [[-37.0, 37.0, 23.0, -49.0, 42.0, -100.0], HOME] {
        let mut positions = vec![stated(first)];
        positions.extend(poses.map(posed));
        let (said, before, after) = run(&listing(&positions));
        assert!(said.contains("nothing shows on which side"), "{said}");
        folder
            .run("correct elas.blob b.ls --payload-kg 2.5 --inverse --out c.ls")
            .ok();
        let back = numbers("c.ls");
        for (k, pose) in poses.into_iter().enumerate() {
            // Beside its own joints the branch of a pose is certain.
            let (said, _, alone) = run(&listing(&[stated(pose), posed(pose)]));
            assert!(!said.contains("nothing shows"), "{said}");
            // A few degrees beside them it still is; farther off, the wrist may flip on the way.
            for (by, is_noted) in [(5.0, false), (20.0, true)] {
                let mut beside = pose;
                beside[5] -= by;
                let (said, _, _) = run(&listing(&[stated(beside), posed(pose)]));
                assert_eq!(said.contains("nothing shows"), is_noted, "{said}");
            }
            let apart = |a: &[f64], b: &[f64]| {
                let all = a.iter().zip(b).take(3).map(|(a, b)| (a - b).abs());
                all.fold(0.0, f64::max)
            };
            assert!(apart(&before[k + 1], &alone[1]) > 0.1, "{pose:?}");
            assert!(
                apart(&after[k + 1], &alone[1]) < 2e-3,
                "{first:?} {pose:?} {after:?} {alone:?}"
            );
            assert!(
                apart(&back[k + 1], &before[k + 1]) < 2e-3,
                "{first:?} {pose:?}"
            );
        }
    }
}

/// The eight branches of a pose are on eight sides, and a coupling of joints 2 and 3 changes none.
#[test]
fn every_branch_has_sides_of_its_own() {
    let folder = folder();
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../calibration/robots/abb-irb4400-serial.toml"
    );
    let text = std::fs::read_to_string(path).unwrap();
    let wide = text
        .lines()
        .map(|line| match line.starts_with("limits_deg") {
            true => "limits_deg = [-179.9, 179.9]\n".to_owned(),
            false => format!("{line}\n"),
        });
    folder.write("wide.toml", wide.collect::<String>());
    let coupled = changed(&folder.text("train.csv"), |names, fields| {
        let of = |name| names.iter().position(|n| *n == name).unwrap();
        let q = ["q2_deg", "q3_deg"].map(|name| fields[of(name)].parse::<f64>().unwrap());
        fields[of("q3_deg")] = format!("{:.9}", q[0] + q[1]);
    });
    folder.write("coupled.csv", coupled);
    for (robot, data) in [("wide.toml", "train.csv"), ("abb-irb4400", "coupled.csv")] {
        let line = format!("calibrate --robot {robot} {data} --method base-tool --out {data}.blob");
        folder.run(&line).ok();
    }
    let [wide, coupled] =
        ["train.csv.blob", "coupled.csv.blob"].map(|name| commander(&folder, name));
    for degrees in [
        [12.0, -15.0, 34.0, 79.0, 38.0, 67.0],
        [-23.0, 33.0, 41.0, -80.0, -34.0, 120.0],
        [150.0, -40.0, 60.0, 30.0, 50.0, 9.0],
    ] {
        let mut joints = [0.0; 8];
        for (q, degrees) in joints.iter_mut().zip(degrees) {
            *q = f64::to_radians(degrees);
        }
        let branches = wide.branches(&wide.nominal_flange(&joints));
        let mut all: Vec<Sides> = branches.iter().map(|branch| sides(&wide, branch)).collect();
        assert!(all.iter().flatten().all(Option::is_some), "{all:?}");
        all.sort();
        all.dedup();
        assert_eq!((all.len(), branches.len()), (8, 8), "{degrees:?} {all:?}");
        for branch in branches {
            let mut turned = branch;
            turned[2] += turned[1];
            assert_eq!(sides(&coupled, &turned), sides(&wide, &branch));
        }
    }
}
