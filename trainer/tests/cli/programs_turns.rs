//! `trainer correct` of robot programs: numbers of a configuration that follow from the joints, where the correction takes a
//! joint over a boundary. With the old number the controller would go a whole turn round, or stop.

use poegp_calibration::blob::commander::{Commander, Joints};
use poegp_trainer::robot_programs::dialect::Orientation;

use crate::program::Folder;
use crate::programs::{commander, folder};

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
        for turn in [plain, binary].map(|of| [of(old), of(new)]) {
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
