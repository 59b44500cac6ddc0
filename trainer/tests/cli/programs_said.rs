//! `trainer correct` of robot programs: what it says where it would do the wrong thing, or did nothing.

use crate::program::Folder;
use crate::programs::{commander, folder, numbers_after};
use crate::texts::texts;

const NO_AXES: &str = "[9E9,9E9,9E9,9E9,9E9,9E9]";
const NO_RECORD: &str = "no record shows that this program was corrected";

fn rapid(moves: &str) -> String {
    format!("MODULE M\nPROC main()\n{moves}ENDPROC\nENDMODULE\n")
}

fn joints() -> String {
    rapid(&format!(
        "MoveAbsJ [[8,22,1,-14,46,24],{NO_AXES}],v1,fine,tool0;\n"
    ))
}

fn krl(motion: &str) -> String {
    format!("DEF A( )\n$BASE=$WORLD\n{motion}\nEND\n")
}

/// Without the record, a program that was never corrected would be moved the wrong way in silence.
#[test]
fn the_inverse_of_a_program_without_a_record_is_warned_of() {
    let folder = folder();
    folder.write("a.mod", joints());
    let correct = |line: &str| {
        let line = format!("correct elas.blob {line} --payload-kg 2.5");
        folder.run(&line).ok().stderr
    };
    let said = correct("a.mod --inverse --out wrong.mod");
    assert!(
        said.contains("warning: a.mod: ") && said.contains(NO_RECORD),
        "{said}"
    );
    correct("a.mod --out o.mod");
    assert!(!correct("o.mod --inverse --out back.mod").contains(NO_RECORD));
    // It was brought back already.
    assert!(correct("back.mod --inverse --out twice.mod").contains(NO_RECORD));
    // A data list without targets has no correction of its own.
    folder.write(
        "b.src",
        krl("$TOOL=$NULLFRAME\nPTP {A1 8,A2 22,A3 1,A4 -14,A5 46,A6 24}"),
    );
    folder.write("b.dat", "DEFDAT B\nENDDAT\n");
    correct("b.src --out c.src");
    assert!(!correct("c.src --inverse --out d.src").contains(NO_RECORD));
}

/// The arm stood at joints that were taught: the converted program says where its real tool was, and correcting that gives the
/// taught joints.
#[test]
fn taught_targets_are_converted_without_a_record() {
    let folder = folder();
    folder.write("taught.mod", joints());
    let correct = |line: &str| {
        let line = format!("correct elas.blob {line} --payload-kg 2.5");
        folder.run(&line).ok()
    };
    let said = correct("taught.mod --taught --out offline.mod");
    assert!(!said.stderr.contains(NO_RECORD), "{}", said.stderr);
    assert!(
        said.stdout.contains("1 target converted"),
        "{}",
        said.stdout
    );
    let [taught, offline] = ["taught.mod", "offline.mod"].map(|name| {
        let all = numbers_after(&folder.read(name), "MoveAbsJ [", 6);
        <[f64; 6]>::try_from(all).unwrap().map(f64::to_radians)
    });
    let commander = commander(&folder, "elas.blob");
    let padded = |q: [f64; 6]| {
        let mut joints = [0.0; 8];
        joints[..6].copy_from_slice(&q);
        joints
    };
    let stood = commander.real_flange(&padded(taught), 2.5).translation;
    let found = commander.nominal_flange(&padded(offline)).translation;
    let nominal = commander.nominal_flange(&padded(taught)).translation;
    assert!((stood - found).norm() < 5e-6, "{stood} {found}");
    assert!((stood - nominal).norm() > 1e-4, "{stood} {nominal}");
    correct("offline.mod --out again.mod");
    let again = numbers_after(&folder.read("again.mod"), "MoveAbsJ [", 6);
    for (q, taught) in again.iter().zip(taught) {
        assert!((q.to_radians() - taught).abs() < 2e-6, "{again:?}");
    }
}

/// A payload or a frame that is not the one in use moves targets by tenths of a millimetre.
#[test]
fn what_a_program_states_and_nothing_uses_is_said() {
    let folder = folder();
    folder.write(
        "f.toml",
        "[tool.gun]\nxyz_mm = [30, -45, 210]\nquaternion = [1, 0, 0, 0]\n",
    );
    folder.write("t.csv", "x_mm,y_mm,z_mm,qw,qx,qy,qz,tool,seed_q1_deg,seed_q2_deg,seed_q3_deg,seed_q4_deg,seed_q5_deg,seed_q6_deg\n1250,-180,1320,0.1830127,0.6830127,-0.1830127,0.6830127,gun,8,22,1,-14,46,24\n");
    let said = folder
        .run("correct elas.blob t.csv --payload-kg 2.5 --frames f.toml --out o.csv")
        .ok()
        .stdout;
    for text in [
        "taught on the uncorrected arm",
        "the target's mounting was not stated",
    ] {
        assert!(said.contains(text), "{said}");
    }
    folder.write("a.mod", joints());
    let said = folder
        .run("correct elas.blob a.mod --payload-kg 2.5 --out o.mod")
        .ok()
        .stdout;
    assert!(!said.contains("note: "), "{said}");
    let gun =
        "PERS tooldata gun:=[TRUE,[[30,-45,210],[1,0,0,0]],[4.5,[0,0,15],[1,0,0,0],0,0,0]];\n";
    let text = joints()
        .replace("tool0", "gun")
        .replace("PROC main", &format!("{gun}PROC main"));
    folder.write("b.mod", text);
    let said = folder
        .run("correct elas.blob b.mod --payload-kg 2.5 --out o.mod")
        .ok()
        .stdout;
    assert!(
        said.contains("payloads of 4.5 kg, which are not used"),
        "{said}"
    );
    folder
        .run("correct elas.blob b.mod --payload-kg 4.5 --out o.mod")
        .ok();
}

/// Five joints, for controllers' languages with six axes.
const FIVE: &str = r#"name = "five"
convention = "dh"
joint = [
    { name = "a", kind = "revolute", limits_deg = [-40, 40], a_mm = 25, d_mm = 400, alpha_deg = -90 },
    { name = "b", kind = "revolute", limits_deg = [-60, 0], a_mm = 315, d_mm = 0, alpha_deg = 0 },
    { name = "c", kind = "revolute", limits_deg = [0, 60], a_mm = 35, d_mm = 0, alpha_deg = -90 },
    { name = "d", kind = "revolute", limits_deg = [-60, 60], a_mm = 0, d_mm = 365, alpha_deg = 90 },
    { name = "e", kind = "revolute", limits_deg = [20, 80], a_mm = 60, d_mm = 0, alpha_deg = 0 },
]
"#;

/// A program of `plan` for an arm with five joints is corrected and comes back. With a value for a sixth axis it is not one
/// of this arm.
#[test]
fn planned_programs_of_five_joints_are_read() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("five.toml", FIVE);
    for line in [
        "simulate --robot five.toml --poses 60 --test-sets 0 --seed 5 --out cell",
        "calibrate --robot five.toml cell/train.csv --method poe --out arm.blob",
        "plan --robot five.toml --count 12 --space-filling --no-forecast --out p.csv --rapid p.mod --krl p.src",
    ] {
        folder.run(line).ok();
    }
    for (name, zero, other) in [("p.mod", ",0],", ",5],"), ("p.src", ",A6 0}", ",A6 5}")] {
        let planned = folder.text(name);
        assert_eq!(planned.matches(zero).count(), 12, "{planned}");
        let line = format!("correct arm.blob {name} --out new_{name} --json a.json");
        folder.run(&line);
        let document = folder.json("a.json");
        assert!(document["targets"].as_u64().unwrap() > 6, "{document:#}");
        let corrected = folder.text(&format!("new_{name}"));
        assert_eq!(corrected.matches(zero).count(), 12, "{corrected}");
        assert_ne!(corrected, planned);
        folder.write(name, planned.replacen(zero, other, 1));
        folder.refuses(&line);
    }
}

/// A record lists at most a thousand targets, which are fewer than half of those of this program.
#[test]
fn an_edited_copy_of_a_long_program_is_refused() {
    let folder = folder();
    let line = |k: i32| {
        let q1 = 0.01 * f64::from(k);
        format!("MoveAbsJ [[{q1:.2},22,1,-14,46,24],{NO_AXES}],v1,fine,tool0;\n")
    };
    let moves: String = (0..2_500).map(line).collect();
    folder.write("a.mod", rapid(&moves));
    let correct = |line: &str| folder.run(&format!("correct elas.blob {line} --payload-kg 2.5"));
    correct("a.mod --out o.mod").ok();
    let edited = String::from_utf8(folder.read("o.mod")).unwrap();
    folder.write("b.mod", edited.replace("v1,", "v2,"));
    let refused = correct("b.mod --out c.mod");
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    let again = "found a program with targets that were corrected already (o.mod.poegp.json)";
    assert!(refused.stderr.contains(again), "{refused:#?}");
}

/// Names may have letters beyond ASCII, in UTF-8 or Latin-1, in any case.
#[test]
fn names_have_letters_of_every_alphabet() {
    let folder = folder();
    let data = |name: &str, q1: i32| {
        format!("CONST jointtarget {name}:=[[{q1},22,1,-14,46,24],{NO_AXES}];\n")
    };
    let motion = |name: &str| format!("MoveAbsJ {name},v1,fine,tool0;\n");
    let text = format!(
        "MODULE M\n{}{}PROC main()\n{}{}ENDPROC\nENDMODULE\n",
        data("größe", 8),
        data("grüße", -8),
        motion("GRÖßE"),
        motion("Grüße"),
    );
    let latin: Vec<u8> = text.chars().map(|c| u8::try_from(c).unwrap()).collect();
    for (name, bytes) in [("u.mod", text.as_bytes()), ("l.mod", latin.as_slice())] {
        folder.write(name, bytes);
        let line = format!("correct elas.blob {name} --payload-kg 2.5 --out {name}.out");
        let said = folder.run(&line).ok().stdout;
        assert!(said.contains("2 targets corrected, 2 of joints"), "{said}");
        let lines = |bytes: &[u8]| bytes.split(|b| *b == b'\n').map(<[u8]>::to_vec).collect();
        let (before, after): (Vec<_>, Vec<_>) =
            (lines(bytes), lines(&folder.read(&format!("{name}.out"))));
        for (row, (before, after)) in before.iter().zip(&after).enumerate() {
            assert_eq!(before != after, row == 1 || row == 2, "{name}: {row}");
        }
    }
}

/// A no-break space, as in text copied from a document, hides an instruction from the controller and from us: it is named.
#[test]
fn an_instruction_behind_a_no_break_space_is_named() {
    let folder = folder();
    let motion = format!("MoveAbsJ\u{a0}[[8,22,1,-14,46,24],{NO_AXES}],v1,fine,tool0;\n");
    folder.write("a.mod", rapid(&motion));
    let said = folder.run("correct elas.blob a.mod --payload-kg 2.5 --out b.mod");
    assert_eq!(said.code, Some(1), "{said:#?}");
    let unread = "a.mod:3:1: MoveAbsJ\u{a0} is not read";
    assert!(said.stderr.contains(unread), "{said:#?}");
}

/// A target that is copied from a corrected program would be corrected twice in silence.
#[test]
fn targets_of_a_corrected_program_are_warned_of() {
    let folder = folder();
    let line = |q1: i32| format!("MoveAbsJ [[{q1},22,1,-14,46,24],{NO_AXES}],v1,fine,tool0;\n");
    folder.write("a.mod", rapid(&line(8)));
    let correct = |line: &str| folder.run(&format!("correct elas.blob {line} --payload-kg 2.5"));
    correct("a.mod --out o.mod").ok();
    let corrected = String::from_utf8(folder.read("o.mod")).unwrap();
    let copied = corrected.lines().nth(2).unwrap().to_owned() + "\n";
    let new = |copied: &str| rapid(&(line(-8) + &line(12) + copied));
    folder.write("b.mod", new(&copied));
    let said = correct("b.mod --out c.mod").ok().stderr;
    let twice = "warning: b.mod: one of its targets was corrected already (o.mod.poegp.json)";
    assert!(said.contains(twice), "{said}");
    // The target of the original is none.
    folder.write("d.mod", new(&line(8)));
    let said = correct("d.mod --out e.mod").ok().stderr;
    assert!(!said.contains("warning"), "{said}");
}

/// Returns what `correct` says of a KRL program that it does not correct completely.
fn left(folder: &Folder, motion: &str) -> String {
    folder.write("k.src", krl(motion));
    let line = "correct elas.blob k.src --payload-kg 2.5 --out l.src";
    folder.run(line).stderr
}

#[test]
fn components_of_a_krl_point_are_said_by_name() {
    let folder = folder();
    let motion = |point: &str| format!("$TOOL=$NULLFRAME\nPTP {{{point}}}");
    for (point, reason) in [
        (
            "X 1,Y 2,Z 3",
            "A, B, C are missing, so the controller keeps the previous values",
        ),
        (
            "A1 1,A2 2,A3 3,A4 4,A5 5",
            "A6 is missing, so the controller keeps the previous value",
        ),
        ("X 1,Y 1.2.3,Z 3,A 0,B 0,C 0", "Y is not a plain number"),
        ("X 1,Y 1,Z NaN,A 0,B 0,C 0", "Z is not a plain number"),
    ] {
        let said = left(&folder, &motion(point));
        assert!(said.contains(&format!("k.src:4:5: {reason}")), "{said}");
        let nothing = "help: nothing was corrected: the output equals the input";
        assert!(said.contains(nothing), "{said}");
    }
    let point = "X 1250,Y -180,Z 1320,A 0,B 90,C 0";
    let said = left(&folder, &format!("$TOOL=Other(1)\nPTP {{{point}}}"));
    assert!(said.contains("$TOOL is computed"), "{said}");
}

#[test]
fn a_payload_beyond_the_trained_ones_is_said() {
    let _texts = texts();
    let folder = folder();
    folder.write("a.mod", joints());
    let said = folder
        .refuses("correct elas.blob a.mod --payload-kg 500 --out o.mod")
        .stderr;
    let text = "500 kg is outside the trained payloads ";
    assert!(
        said.contains(text) && said.contains("expected a payload that"),
        "{said}"
    );
    assert!(!said.contains("tool or frame"), "{said}");
}

#[test]
fn a_program_in_utf16_is_refused() {
    let _texts = texts();
    let folder = folder();
    let little = |text: &str| {
        text.encode_utf16()
            .flat_map(u16::to_le_bytes)
            .collect::<Vec<_>>()
    };
    let big = |text: &str| {
        text.encode_utf16()
            .flat_map(u16::to_be_bytes)
            .collect::<Vec<_>>()
    };
    let marked = format!("\u{feff}{}", joints());
    for bytes in [
        little(&joints()),
        big(&joints()),
        little(&marked),
        big(&marked),
    ] {
        folder.write("u.mod", bytes);
        let said = folder
            .refuses("correct elas.blob u.mod --payload-kg 2.5 --out o.mod")
            .stderr;
        for text in [
            "u.mod: found UTF-16 text, expected UTF-8 or ANSI",
            "help: save the file as",
        ] {
            assert!(said.contains(text), "{said}");
        }
    }
}

/// Both files have one name: which is to be corrected is not clear from the name alone.
#[test]
fn the_original_of_a_corrected_program_is_said_with_its_folder() {
    let _texts = texts();
    let folder = folder();
    std::fs::create_dir(folder.path("f")).unwrap();
    folder.write("a.mod", joints());
    folder
        .run("correct elas.blob a.mod --payload-kg 2.5 --out f/a.mod")
        .ok();
    let said = folder
        .refuses("correct elas.blob f/a.mod --payload-kg 2.5 --out g.mod")
        .stderr;
    assert!(
        said.contains("correct the original a.mod (not the one in f) instead"),
        "{said}"
    );
}

#[test]
fn one_is_no_plural() {
    let folder = folder();
    folder.write("a.mod", joints());
    let said = folder
        .run("correct elas.blob a.mod --payload-kg 2.5 --out o.mod")
        .ok()
        .stdout;
    assert!(said.contains(": 1 target corrected"), "{said}");
    folder.write("b.src", krl(
        "$TOOL=$NULLFRAME\nPTP {A1 8,A2 22,A3 1,A4 -14,A5 46,A6 24}\nLIN {X 1250,Y -180,Z 1320,A 0,B 90,C 0}",
    ));
    let said = folder
        .run("correct elas.blob b.src --payload-kg 2.5 --out c.src")
        .stdout;
    assert!(
        said.contains("Between the ends of one line or arc, according to the model"),
        "{said}"
    );
}
