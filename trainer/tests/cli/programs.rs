//! `trainer correct` of robot programs: nothing but numbers of targets changes, the real arm comes to where the program
//! wants it, and what cannot be corrected is named.

use std::path::Path;

use nalgebra::Vector3;
use poegp_calibration::blob::commander::{Commander, pose_distance};
use poegp_calibration::blob::predict::BlobModel;
use poegp_runtime::math::se3::Pose;

use crate::program::{Folder, SERIAL, simulated};
use crate::texts::texts;

/// A module with all that a reader has to find its way through: line ends of both kinds, letters of Latin-1, tabs, comments
/// and strings that look like targets, and no line end at the end.
const RAPID: &[u8] = b"%%%\r\n  VERSION:1\r\n%%%\r\nMODULE Part\r\n\
    \tPERS tooldata gun:=[TRUE,[[0,80,310],[0.98480775,-0.17364818,0,0]],[2.5,[0,0,15],[1,0,0,0],0,0,0.005]];\n\
    PERS wobjdata table:=[FALSE,TRUE,\"\",[[1100,250,500],[0.95371695,0,0,-0.3007058]],[[0,0,0],[1,0,0,0]]];\r\n\
    CONST jointtarget home:=[[3.637488,34.012976,0.536026,19.725474,53.568589,14.068543],[9E+09,9E9,9E9,9E9,9E9,9E9]];\r\n\
    CONST robtarget p10:=[[175.68,325.663,100.807],[0.02767686,0.12039308,-0.9437514,-0.30671288],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\r\n\
    ! gr\xfcn: [[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\r\n\
    PROC main()\r\n\
    \x20 TPWrite \"[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\";\r\n\
    \x20 MoveAbsJ home\\NoEOffs,v200,fine,gun;\r\n\
    \x20 MoveL p10,v200,z1,gun\\WObj:=table;\r\n\
    \x20 MoveC [[348.463,365.114,296.156],[0.06593129,0.13288673,-0.94183047,-0.30157842],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],\r\n\
    \t\t[[571.073, 230.432,+314.052],[0.08545427,0.11357551,-0.94365241,-0.29886166],[-1,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,z1,gun\\WObj:=table;\r\n\
    \x20 MoveAbsJ [[0,32.5,4,20,51.5,14],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]],v200,fine,gun;\r\n\
    ENDPROC\r\nENDMODULE";

/// A folder with an elastic model and one that corrects nothing.
fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 80));
    for method in ["elastic --inducing-points 60", "base-tool"] {
        let name = &method[..4];
        folder
            .run(&format!(
                "calibrate --robot {SERIAL} train.csv --method {method} --out {name}.blob"
            ))
            .ok();
    }
    folder
}

/// The numbers of a text that are not part of a name, and the text with a mark in their stead.
fn skeleton(bytes: &[u8]) -> (Vec<f64>, Vec<u8>) {
    let (mut numbers, mut rest) = (Vec::new(), Vec::new());
    let mut at = 0;
    while at < bytes.len() {
        let is_in_name = at > 0 && (bytes[at - 1].is_ascii_alphanumeric() || bytes[at - 1] == b'_');
        let length = bytes[at..]
            .iter()
            .take_while(|b| b.is_ascii_digit() || b"+-.eE".contains(b))
            .count();
        let text = std::str::from_utf8(&bytes[at..at + length]).unwrap();
        match text.parse::<f64>() {
            Ok(number) if !is_in_name => {
                numbers.push(number);
                rest.push(0);
                at += length;
            }
            _ => {
                rest.push(bytes[at]);
                at += 1;
            }
        }
    }
    (numbers, rest)
}

/// A pose of millimetres and a quaternion.
fn pose(n: &[f64]) -> Pose<f64> {
    let position = Vector3::new(n[0], n[1], n[2]) / 1000.0;
    Pose::from_quaternion(n[3], &Vector3::new(n[4], n[5], n[6]), position)
}

/// Numbers of the first target after `start`.
fn numbers_after(bytes: &[u8], start: &str, count: usize) -> Vec<f64> {
    let at = bytes
        .windows(start.len())
        .position(|w| w == start.as_bytes())
        .unwrap();
    skeleton(&bytes[at + start.len()..]).0[..count].to_vec()
}

fn commander(folder: &Folder, name: &str) -> Commander {
    Commander::new(&BlobModel::read(&folder.path(name)).unwrap()).unwrap()
}

#[test]
fn a_model_that_corrects_nothing_gives_every_byte_back() {
    let folder = folder();
    let with_mark = [b"\xef\xbb\xbf", RAPID].concat();
    let cut = RAPID.strip_suffix(b"ENDMODULE").unwrap();
    for (name, bytes) in [
        ("part.mod", RAPID),
        ("mark.prg", &with_mark),
        ("cut.SYS", cut),
    ] {
        folder.write(name, bytes);
        folder
            .run(&format!(
                "correct base.blob {name} --payload-kg 2.5 --out same_{name}"
            ))
            .ok();
        assert!(folder.read(&format!("same_{name}")) == bytes, "{name}");
    }
}

#[test]
fn the_real_arm_comes_to_where_the_program_wants_it() {
    let folder = folder();
    folder.write("part.mod", RAPID);
    let line = "correct elas.blob part.mod --payload-from-program --out out.mod --json -";
    let document = folder.run(line).ok().json();
    assert_eq!(document["joint_targets"], 2);
    assert_eq!(document["pose_targets"], 3);
    assert!(
        document["before_mm"]["mean"].as_f64().unwrap() > 0.2,
        "{document}"
    );
    let out = folder.read("out.mod");
    let (before, after) = (skeleton(RAPID), skeleton(&out));
    assert!(before.1 == after.1, "{}", String::from_utf8_lossy(&out));
    assert_eq!(before.0.len(), after.0.len());
    assert_ne!(before.0, after.0);

    // By another way than the program's: the controller's joints by the drawing, then the real arm.
    let commander = commander(&folder, "elas.blob");
    let tool = pose(&numbers_after(RAPID, "gun:=[TRUE,", 7));
    let base = pose(&numbers_after(RAPID, "TRUE,\"\",", 7));
    let near = {
        let mut joints = [0.0; 8];
        for (q, degrees) in joints.iter_mut().zip(numbers_after(RAPID, "home:=", 6)) {
            *q = degrees.to_radians();
        }
        joints
    };
    for start in ["p10:=", "MoveC ", "\t\t"] {
        let wanted = base * pose(&numbers_after(RAPID, start, 7));
        let written = base * pose(&numbers_after(&out, start, 7));
        let command = commander.nominal_joints(&(written * tool.inverse()), &near);
        let real = commander.real_flange(&command.joints, 2.5) * tool;
        let (moved, turned) = pose_distance(&real, &wanted);
        assert!(
            moved < 3e-6 && turned < 3e-6,
            "{start}: {moved:e} {turned:e}"
        );
        let (moved, _) = pose_distance(&written, &wanted);
        assert!(moved > 1e-4, "{start}: {moved:e}");
    }
    for (q, degrees) in commander
        .correct(&near, 2.5)
        .joints
        .iter()
        .zip(numbers_after(&out, "home:=", 6))
    {
        assert!((q - degrees.to_radians()).abs() < 1e-8, "{q} {degrees}");
    }
}

#[test]
fn a_corrected_program_is_refused_and_comes_back() {
    let _texts = texts();
    let folder = folder();
    folder.write("part.mod", RAPID);
    folder
        .run("correct elas.blob part.mod --payload-kg 2.5 --out out.mod")
        .ok()
        .said();
    folder.refuses("correct elas.blob out.mod --payload-kg 2.5 --out twice.mod");
    folder.refuses("correct base.blob out.mod --payload-kg 2.5 --inverse --out back.mod");
    folder
        .run("correct elas.blob out.mod --payload-kg 2.5 --inverse --out back.mod")
        .ok();
    let (wanted, found) = (skeleton(RAPID), skeleton(&folder.read("back.mod")));
    assert!(wanted.1 == found.1);
    for (a, b) in wanted.0.iter().zip(&found.0) {
        assert!(
            (a - b).abs() <= 1.1e-3 && (a.abs() > 2.0 || (a - b).abs() < 2e-5),
            "{a} {b}"
        );
    }
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let _texts = texts();
    let folder = folder();
    let text = |from: &str, to: &str| String::from_utf8_lossy(RAPID).replace(from, to);
    folder.write("part.mod", RAPID);
    folder.write("tool.mod", text("z1,gun", "z1,brush"));
    folder.write(
        "configuration.mod",
        text("[0,0,0,0],[9E9", "[1,1,1,0],[9E9"),
    );
    folder.write(
        "far.mod",
        text("[1100,250,500]", "[9100,250,500]").replace("MoveAbsJ", "!"),
    );
    folder.write("empty.mod", "MODULE Empty\nENDMODULE\n");
    folder.write("frames.toml", "[tool.gun]\nxyz_mm = [1, 2]\n");
    for line in [
        "part.mod --out out.mod",
        "part.mod --payload-kg 2.5 --out part.mod",
        "tool.mod --payload-kg 2.5 --out out.mod",
        "configuration.mod --payload-kg 2.5 --out out.mod",
        "far.mod --payload-kg 2.5 --out out.mod",
        "empty.mod --payload-kg 2.5 --out out.mod",
        "none.mod --payload-kg 2.5 --out out.mod",
        "part.mod train.csv --payload-kg 2.5 --out out.mod",
        "part.mod tool.mod --payload-kg 2.5 --out out.mod",
        "part.mod --payload-kg 2.5 --frames frames.toml --out out.mod",
        "train.csv --payload-kg 2.5 --inverse --out out.csv",
    ] {
        folder.refuses(format!("correct elas.blob {line}"));
    }
}

/// Every part that is left is named, and the rest is corrected.
#[test]
fn what_is_left_is_named() {
    let _texts = texts();
    let folder = folder();
    let more = "  MoveL Offs(p10,0,0,50),v200,z1,gun\\WObj:=table;\n\
        \x20 MoveL RelTool(p10,0,0,-10),v200,z1,gun\\WObj:=table;\n\
        \x20 MoveL p10,v200,z1,gun\\WObj:=table\\Corr;\n\
        \x20 MoveAbsJ [[0,10,10,0,30,0],[100,9E9,9E9,9E9,9E9,9E9]],v200,z1,gun;\n\
        \x20 MoveAbsJ [[0,10,reg1,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v200,z1,gun;\n\
        \x20 MoveAbsJ [[0,10,200,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v200,z1,gun;\n\
        \x20 MoveAbsJ [[0,10,10,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v200,z1,gun;\n\
        \x20 MoveL elsewhere,v200,z1,gun\\WObj:=table;\n\
        \x20 MoveExtJ [[0,10,10,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v200,z1;\n\
        \x20 Weld [[0,10,10,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n\
        \x20 IF di1=1 THEN\n    bench.uframe:=[[1,2,3],[1,0,0,0]];\n  ENDIF\n\
        \x20 MoveL p10,v200,z1,gun\\WObj:=bench;\n\
        \x20 rack.uframe.trans.x:=5;\n\
        \x20 MoveL p10,v200,z1,gun\\WObj:=rack;\n\
        \x20 MoveL p10,v200,z1,gun\\WObj:=wobj0;\n\
        \x20 PDispOn p10,gun;\n\
        \x20 MoveL p10,v200,z1,gun;\n";
    let text = String::from_utf8_lossy(RAPID).replace("    ENDPROC", &format!("{more}ENDPROC"));
    let text = text.replace(
        "ENDPROC\r\nENDMODULE",
        &format!("{more}ENDPROC\r\nENDMODULE"),
    );
    let table = text
        .lines()
        .find(|line| line.contains("wobjdata table"))
        .unwrap();
    let others = ["bench", "rack"]
        .map(|name| table.replace("table", name))
        .join("\n");
    let text = text.replace(table, &format!("{table}\n{others}"));
    folder.write("part.mod", &text);
    let outcome = folder
        .run("correct elas.blob part.mod --payload-kg 2.5 --out out.mod")
        .said();
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let (before, after) = (skeleton(text.as_bytes()), skeleton(&folder.read("out.mod")));
    assert!(before.1 == after.1);
    assert_ne!(before.0, after.0);
    assert!(Path::new(&folder.path("out.mod.poegp.json")).exists());
}
