//! `trainer correct` of robot programs: only numbers of targets change, the real arm reaches what the program wants, and what
//! cannot be corrected is named.

use std::path::Path;

use nalgebra::Vector3;
use poegp_calibration::blob::commander::{Commander, pose_distance};
use poegp_calibration::blob::predict::BlobModel;
use poegp_runtime::math::se3::Pose;

use crate::program::{Folder, SERIAL, data, simulated};
use crate::texts::texts;

/// Small programs with everything that a reader must understand: line ends of both kinds, Latin-1 letters, tabs, comments and
/// strings that look like targets, and no line end at the end.
const PROGRAMS: [&str; 7] = [
    "part.mod",
    "part.script",
    "part.ls",
    "part.src",
    "part.dtx",
    "part.jbi",
    "part.csv",
];
/// Other files that the programs need.
const OTHERS: [&str; 3] = ["part.dat", "part.pgx", "frames.toml"];

/// Returns the option for the payload: the table states one for each row.
pub fn payload(name: &str) -> &'static str {
    match name.ends_with("csv") {
        true => "--payload-from-program",
        false => "--payload-kg 2.5",
    }
}

/// Returns the exit code: the job has pulses, which are left uncorrected.
pub fn code(name: &str) -> Option<i32> {
    Some(i32::from(name.ends_with("jbi")))
}

pub fn file(name: &str) -> Vec<u8> {
    std::fs::read(data(&format!("programs/{name}"))).unwrap()
}

/// Returns a folder with an elastic model and one that corrects nothing.
pub fn folder() -> Folder {
    Folder::prepared("programs", |folder| {
        for name in PROGRAMS.iter().chain(&OTHERS) {
            folder.write(name, file(name));
        }
        folder.write("train.csv", simulated("train", 80));
        for method in ["elastic --inducing-points 60", "base-tool"] {
            let name = &method[..4];
            folder
                .run(&format!(
                    "calibrate --robot {SERIAL} train.csv --method {method} --out {name}.blob"
                ))
                .ok();
        }
    })
}

/// Returns the numbers of a text that are not part of a name, and the text with a mark in place of each.
pub fn skeleton(bytes: &[u8]) -> (Vec<f64>, Vec<u8>) {
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

/// Returns a pose from millimetres and a quaternion.
pub fn pose(n: &[f64]) -> Pose<f64> {
    let position = Vector3::new(n[0], n[1], n[2]) / 1000.0;
    Pose::from_quaternion(n[3], &Vector3::new(n[4], n[5], n[6]), position)
}

/// Returns the numbers of the first target after `start`.
pub fn numbers_after(bytes: &[u8], start: &str, count: usize) -> Vec<f64> {
    let at = bytes
        .windows(start.len())
        .position(|w| w == start.as_bytes())
        .unwrap();
    skeleton(&bytes[at + start.len()..]).0[..count].to_vec()
}

pub fn commander(folder: &Folder, name: &str) -> Commander {
    Commander::new(&BlobModel::read(&folder.path(name)).unwrap()).unwrap()
}

#[test]
fn a_model_that_corrects_nothing_gives_every_byte_back() {
    let folder = folder();
    std::fs::create_dir(folder.path("same")).unwrap();
    for name in PROGRAMS {
        let bytes = file(name);
        let stem = name.split_once('.').unwrap().1;
        // With a byte order mark, with mixed line ends, and cut off.
        let marked = [b"\xef\xbb\xbf", bytes.as_slice()].concat();
        let mut mixed = Vec::new();
        for (line, text) in bytes.split_inclusive(|b| *b == b'\n').enumerate() {
            let plain = text
                .strip_suffix(b"\r\n")
                .or(text.strip_suffix(b"\n"))
                .unwrap_or(text);
            mixed.extend_from_slice(plain);
            mixed.extend_from_slice([b"\n".as_slice(), b"\r\n"][line % 2]);
        }
        for (change, bytes) in [("plain", &bytes), ("marked", &marked), ("mixed", &mixed)] {
            let name = format!("{change}.{stem}");
            folder.write(&name, bytes);
            folder.write(&format!("{change}.dat"), file("part.dat"));
            let line = format!(
                "correct base.blob {name} {} --frames frames.toml --out same/{name}",
                payload(&name)
            );
            assert_eq!(folder.run(&line).code, code(&name));
            assert!(folder.read(&format!("same/{name}")) == *bytes, "{name}");
            if stem == "src" {
                assert!(folder.read(&format!("same/{change}.dat")) == file("part.dat"));
            }
        }
    }
}

/// In every language the same arm has the same targets. The correction changes only numbers and leaves at most 5 µm, and
/// `--inverse` gives the numbers back.
#[test]
fn every_language_changes_numbers_alone_and_comes_back() {
    let folder = folder();
    for name in ["out", "back"] {
        std::fs::create_dir(folder.path(name)).unwrap();
    }
    folder.write("out/part.pgx", file("part.pgx"));
    for name in PROGRAMS {
        let rest = format!("{} --frames frames.toml --json -", payload(name));
        let outcome = folder.run(&format!("correct elas.blob {name} {rest} --out out/{name}"));
        assert_eq!(outcome.code, code(name));
        let document = outcome.json();
        let of = |what: &str, key: &str| document[what][key].as_f64().unwrap();
        assert!(
            of("before_mm", "mean") > 0.2 && of("after_um", "max") < 5.0,
            "{document}"
        );
        assert!(of("moved_mm", "mean") > 0.2, "{document}");
        let line = format!("correct elas.blob out/{name} {rest} --inverse --out back/{name}");
        assert_eq!(folder.run(&line).code, code(name));
        let names = if name == "part.src" {
            vec![name, "part.dat"]
        } else {
            vec![name]
        };
        for name in names {
            let original = skeleton(&file(name));
            let (out, back) = (format!("out/{name}"), format!("back/{name}"));
            let (out, back) = (skeleton(&folder.read(&out)), skeleton(&folder.read(&back)));
            assert!(original.1 == out.1 && original.1 == back.1, "{name}");
            assert_ne!(original.0, out.0, "{name}");
            let changed = original
                .0
                .iter()
                .zip(&out.0)
                .filter(|(a, b)| a != b)
                .count();
            assert!(changed > 6 && changed < 60, "{name}: {changed}");
            for (a, b) in original.0.iter().zip(&back.0) {
                assert!(
                    (a - b).abs() <= 2.1e-3 && (a.abs() > 2.0 || (a - b).abs() < 2e-3),
                    "{name}: {a} {b}"
                );
            }
        }
    }
    // One point in all languages, each with its own angles, gives the same position.
    let position = |name: &str, start: &str, skip: usize| -> Vector3<f64> {
        let n = numbers_after(&folder.read(&format!("out/{name}")), start, skip + 3);
        Vector3::new(n[skip], n[skip + 1], n[skip + 2])
    };
    let expected = position("part.mod", "p10:=", 0);
    let original = numbers_after(&file("part.mod"), "p10:=", 3);
    assert!((expected - Vector3::new(original[0], original[1], original[2])).norm() > 0.1);
    let base = pose(&numbers_after(&file("part.mod"), "TRUE,\"\",", 7));
    let script = position("part.script", "movel(p", 0);
    for (name, found) in [
        (
            "part.script",
            1000.0 * base.inverse().transform_point(&script),
        ),
        ("part.ls", position("part.ls", "P[2]{", 5)),
        ("part.dat", position("part.dat", "XP1=", 0)),
        ("part.dtx", position("part.dtx", "pointRx\" size=\"3\">", 1)),
        ("part.jbi", position("part.jbi", "C00001=", 0)),
        ("part.csv", position("part.csv", "\"p,10\"", 0)),
    ] {
        let off = (found - expected).norm();
        assert!(off < 3e-3, "{name}: {off} mm, {found} {expected}");
    }
}

/// The seed of each row determines the branch, and each row has its payload.
#[test]
fn rows_of_a_table_have_seeds_and_payloads() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.csv")).into_owned();
    let run = |name: &str, text: &str, rest: &str| {
        folder.write(name, text);
        folder.run(&format!(
            "correct elas.blob {name} --frames frames.toml {rest} --json - --out out_{name}"
        ))
    };
    let moved = |document: &serde_json::Value| document["moved_mm"]["mean"].as_f64().unwrap();
    let one = run("one.csv", &text, "--payload-from-program").ok().json();
    assert_eq!(one["pose_targets"], 3);
    // With the wrist turned the other way, other joints reach the same poses.
    let other = text.replace("-18.5,48,31.75", "161.5,-48,-148.25");
    let two = run("two.csv", &other, "--payload-from-program").ok().json();
    assert!((moved(&one) - moved(&two)).abs() > 1e-6, "{one} {two}");
    let heavy = text.replace(",2.5,", ",7.5,");
    let heavy = run("heavy.csv", &heavy, "--payload-from-program")
        .ok()
        .json();
    let without = text.replace("payload_kg", "load");
    let stated = run("stated.csv", &without, "--payload-kg 7.5").ok().json();
    assert!(moved(&heavy) == moved(&stated) && moved(&heavy) != moved(&one));
    // The same pose in metres and as a rotation vector.
    let vector = Pose::from_quaternion(
        0.11853448,
        &Vector3::new(0.27874994, 0.90953634, -0.28459039),
        Vector3::zeros(),
    );
    let v = vector.log().angular;
    let metres = format!(
        "x_m,y_m,z_m,rx_rad,ry_rad,rz_rad,tool,base\n0.712804,0.226655,0.475801,{},{},{},3,2\n",
        v[0], v[1], v[2]
    );
    run("metres.csv", &metres, "--payload-kg 2.5").ok();
    let expected = numbers_after(&folder.read("out_one.csv"), "\"p,10\"", 3);
    let found = numbers_after(&folder.read("out_metres.csv"), "base\n", 3);
    for (a, b) in expected.iter().zip(&found) {
        assert!((a - 1e3 * b).abs() < 3e-3, "{expected:?} {found:?}");
    }
    let [x, y, z] = [0, 1, 2].map(|i| 57.3 * v[i]);
    let degrees = metres.replace(
        &format!("{},{},{}", v[0], v[1], v[2]),
        &format!("{x},{y},{z}"),
    );
    let refused = run("degrees.csv", &degrees, "--payload-kg 2.5");
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    assert!(refused.stderr.contains("a full turn"), "{refused:#?}");
    // A model that does not depend on the payload says so.
    let line = "correct base.blob one.csv --frames frames.toml --payload-from-program --json - --out unknown.csv";
    let told = folder.run(line).ok().json();
    let remarks = told["remarks"].to_string();
    assert!(remarks.contains("2.5 kg changes nothing"), "{remarks}");
}

#[test]
fn a_table_that_says_too_little_is_refused() {
    let _texts = texts();
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.csv")).into_owned();
    for (name, text) in [
        ("number.csv", text.replace("226.655", "226,655")),
        ("word.csv", text.replace("226.655", "here")),
        ("tool.csv", text.replace(",3,2,", ",4,2,")),
        ("column.csv", text.replace("z_mm", "z_inch")),
        ("seed.csv", text.replace("seed_q6_deg", "other")),
        ("quaternion.csv", text.replace("qz", "other")),
    ] {
        folder.write(name, text);
        folder.refuses(format!(
            "correct elas.blob {name} --frames frames.toml --payload-from-program --out out.csv"
        ));
    }
}

#[test]
fn the_real_arm_comes_to_where_the_program_wants_it() {
    let folder = folder();
    let rapid = file("part.mod");
    let line = "correct elas.blob part.mod --payload-from-program --out out.mod --json -";
    let document = folder.run(line).ok().json();
    assert_eq!(document["joint_targets"], 2);
    assert_eq!(document["pose_targets"], 5);
    assert!(
        document["before_mm"]["mean"].as_f64().unwrap() > 0.2,
        "{document}"
    );
    let out = folder.read("out.mod");
    let (before, after) = (skeleton(&rapid), skeleton(&out));
    assert!(before.1 == after.1, "{}", String::from_utf8_lossy(&out));
    assert_eq!(before.0.len(), after.0.len());
    assert_ne!(before.0, after.0);

    // Recomputed without the program: the controller's joints from the nominal model, then the real arm.
    let commander = commander(&folder, "elas.blob");
    let tool = pose(&numbers_after(&rapid, "gun:=[TRUE,", 7));
    let base = pose(&numbers_after(&rapid, "TRUE,\"\",", 7));
    let near = {
        let mut joints = [0.0; 8];
        for (q, degrees) in joints.iter_mut().zip(numbers_after(&rapid, "home:=", 6)) {
            *q = degrees.to_radians();
        }
        joints
    };
    for start in ["p10:=", "MoveC ", "row{2}:=", "\t\t"] {
        let wanted = base * pose(&numbers_after(&rapid, start, 7));
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
        assert!((q - degrees.to_radians()).abs() < 1e-7, "{q} {degrees}");
    }
}

#[test]
fn a_corrected_program_is_refused() {
    let _texts = texts();
    let folder = folder();
    folder
        .run("correct elas.blob part.mod --payload-kg 2.5 --out out.mod")
        .ok()
        .said();
    folder.refuses("correct elas.blob out.mod --payload-kg 2.5 --out twice.mod");
    folder.refuses("correct base.blob out.mod --payload-kg 2.5 --inverse --out back.mod");
    folder.refuses("correct elas.blob out.mod --payload-kg 5 --inverse --out back.mod");
    // A signature does not make another model.
    folder.run("keys new --out k").ok();
    folder
        .run("sign elas.blob --key k.key --out signed.blob")
        .ok();
    folder
        .run("correct signed.blob out.mod --payload-kg 2.5 --inverse --out back.mod")
        .ok();
    // Its targets show that what was edited since is still the corrected program, under any name.
    let mut edited = folder.read("out.mod");
    let speed = edited.windows(4).position(|w| w == b"v200").unwrap();
    edited[speed + 1] = b'1';
    folder.write("copy.mod", &edited);
    folder.refuses("correct elas.blob copy.mod --payload-kg 2.5 --out twice.mod");
    folder.write("out.mod", edited);
    folder.refuses("correct elas.blob out.mod --payload-kg 2.5 --out twice.mod");
    let back = "correct elas.blob out.mod --payload-kg 2.5 --inverse --out edited.mod";
    let back = folder.run(back).ok().stderr;
    assert!(
        back.contains("is not checked") && !back.contains("twice"),
        "{back}"
    );
    folder.write("out.mod.poegp.json", "{");
    folder.refuses("correct elas.blob out.mod --payload-kg 2.5 --out thrice.mod");
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let _texts = texts();
    let folder = folder();
    let text = |from: &str, to: &str| String::from_utf8_lossy(&file("part.mod")).replace(from, to);
    folder.write("tool.mod", text("z1,gun", "z1,brush"));
    folder.write(
        "configuration.mod",
        text("[0,-1,0,0],[9E9", "[1,1,1,0],[9E9"),
    );
    folder.write(
        "far.mod",
        text("[900,-300,420]", "[9000,-300,420]").replace("MoveAbsJ", "!"),
    );
    folder.write("empty.mod", "MODULE Empty\nENDMODULE\n");
    folder.write("frames_of_parts.toml", file("frames.toml"));
    folder.write("frames.toml", "[tool.gun]\nxyz_mm = [1, 2]\n");
    for line in [
        "part.mod --out out.mod",
        "part.mod --payload-kg 2.5 --out part.mod",
        "part.src --payload-kg 2.5 --frames frames_of_parts.toml --out part.krl",
        "part.ls --payload-kg 2.5 --out out.ls",
        "part.script part.mod --payload-kg 2.5 --out out.mod",
        "tool.mod --payload-kg 2.5 --out out.mod",
        "configuration.mod --payload-kg 2.5 --out out.mod",
        "far.mod --payload-kg 2.5 --out out.mod",
        "empty.mod --payload-kg 2.5 --out out.mod",
        "none.mod --payload-kg 2.5 --out out.mod",
        "part.mod train.csv --payload-kg 2.5 --out out.mod",
        "part.mod tool.mod --payload-kg 2.5 --out out.mod",
        "part.mod --payload-kg 2.5 --frames frames.toml --out out.mod",
        "train.csv --payload-kg 2.5 --inverse --out out.csv",
        "part.mod --payload-kg 2.5 --split 0 --out out.mod",
        "part.mod --payload-kg 2.5 --split 0.1 --inverse --out out.mod",
    ] {
        folder.refuses(format!("correct elas.blob {line}"));
    }
}

/// Everything that stays uncorrected is named, and the rest is corrected.
#[test]
fn what_is_left_is_named() {
    let _texts = texts();
    let folder = folder();
    let more = "  MoveL Offs(p10,0,0,50),v200,z1,gun\\WObj:=table;\n\
        \x20 MoveL RelTool(p10,0,0,-10),v200,z1,gun\\WObj:=table;\n\
        \x20 MoveL p10,v200,z1,gun\\WObj:=table\\Corr;\n\
        \x20 MoveAbsJ [[0,10,10,0,30,0],[0,9E9,9E9,9E9,9E9,9E9]],v200,z1,gun;\n\
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
    let text = String::from_utf8_lossy(&file("part.mod")).into_owned();
    let text = text.replace("    ENDPROC", &format!("{more}    ENDPROC"));
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

/// A load besides the tool's own is not guessed.
#[test]
fn loads_beside_the_tool_are_named() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.mod"))
        .replace("v100,z1,gun", "v100,z1,gun\\TLoad:=heavy")
        .replace("FOR i", "GripLoad piece;\r\n FOR i");
    folder.write("part.mod", &text);
    let from_program = "correct elas.blob part.mod --payload-from-program --out out.mod";
    let outcome = folder.run(from_program);
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert!(outcome.stdout.contains("GripLoad"), "{outcome:#?}");
    // Parts that are left for one reason are named together.
    let left = "part.mod: 5 parts in lines 10, 11, 17, 18, 23: the payload at this move cannot be determined from the program";
    assert!(outcome.stderr.contains(left), "{outcome:#?}");
    // A load that the program states is added to the tool's, up to the end of the grip.
    let load = "MODULE Part\r\nPERS loaddata piece:=[1.5,[0,0,1],[1,0,0,0],0,0,0];";
    let text = text
        .replace("MODULE Part", load)
        .replace("ENDFOR", "ENDFOR\r\n GripLoad load0;")
        .replace("\\TLoad:=heavy", "");
    folder.write("part.mod", &text);
    folder.run(from_program).ok();
    let out = |kg: &str| {
        let line = format!("correct elas.blob part.mod --payload-kg {kg} --out out_{kg}.mod");
        folder.run(&line).ok();
        folder.read(&format!("out_{kg}.mod"))
    };
    let (light, heavy, found) = (out("2.5"), out("4"), folder.read("out.mod"));
    let of = |bytes: &[u8]| {
        ["p10:=", "row{2}:=", "MoveAbsJ [["].map(|name| numbers_after(bytes, name, 6))
    };
    let ([l1, l2, l3], [_, h2, _]) = (of(&light), of(&heavy));
    assert!(l2 != h2 && of(&found) == [l1, h2, l3]);
}
