//! `trainer correct` of robot programs: arm configurations, controller files beside a job, pulses, and a dry run.

use crate::programs::{code, file, folder, numbers_after, skeleton};
use crate::texts::texts;
/// A configuration without a solution is refused and no file is written; one of another branch changes what is written.
#[test]
fn a_configuration_chooses_the_branch() {
    let _texts = texts();
    let folder = folder();
    let rest = "--payload-kg 2.5 --frames frames.toml";
    for (name, from, to) in [
        ("part.mod", "[0,-1,0,0],[9E9", "[0,-1,0,1],[9E9"),
        ("part.ls", "'N U T, 0, 0, 0'", "'N U T, 0, 1, 0'"),
    ] {
        let text = String::from_utf8_lossy(&file(name)).replacen(from, to, 1);
        let name = format!("none_{name}");
        folder.write(&name, text);
        folder.refuses(format!("correct elas.blob {name} {rest} --out out_{name}"));
        assert!(!folder.path(&format!("out_{name}")).exists());
    }
    // The third position is on the other side of the wrist. It is an arc, whose path is not examined.
    for (name, from, to) in [
        ("part.ls", "'N U T, 0, 0, 0'", "'F U T, 0, 0, 0'"),
        (
            "part.jbi",
            "///POSTYPE BASE\n///RECTAN\n",
            "///POSTYPE BASE\n///RECTAN\n///RCONF 1,0,0,0,0,0,0,0\n",
        ),
        ("part.dtx", "wpositive", "wnegative"),
    ] {
        let text = String::from_utf8_lossy(&file(name)).replace("\r\n", "\n");
        let at = text.rfind(from).unwrap();
        let other = format!("{}{to}{}", &text[..at], &text[at + from.len()..]);
        let mut documents = Vec::new();
        for (prefix, text) in [("plain", &text), ("other", &other)] {
            let ending = name.split_once('.').unwrap().1;
            let name = format!("{prefix}.{ending}");
            folder.write(&name, text);
            let line = format!("correct elas.blob {name} {rest} --json - --out out_{name}");
            let outcome = folder.run(&line);
            assert_eq!(outcome.code, code(&name), "{outcome:#?}");
            documents.push((outcome.json(), folder.read(&format!("out_{name}"))));
        }
        let [(plain, before), (other, after)] = &documents[..] else {
            unreachable!()
        };
        assert_eq!(plain["targets"], other["targets"]);
        let max = |d: &serde_json::Value| d["moved_mm"]["mean"].as_f64().unwrap();
        assert!(
            (max(plain) - max(other)).abs() > 1e-5,
            "{name}: {plain} {other}"
        );
        assert!(skeleton(before).0 != skeleton(after).0, "{name}");
    }
}

/// Condition files of the controller beside a job replace a frame file, including the weight of the tool.
#[test]
fn tools_and_frames_of_a_job_are_in_the_files_beside_it() {
    let folder = folder();
    let run = |rest: &str, out: &str| {
        let line = format!("correct elas.blob part.jbi {rest} --json - --out {out}");
        let outcome = folder.run(&line);
        assert_eq!(outcome.code, Some(1), "{outcome:#?}");
        outcome.json()
    };
    run("--payload-from-program --frames frames.toml", "one.jbi");
    folder.write(
        "tool.cnd",
        "//TOOL 3\r\n///NAME GUN\r\n30.000,-45.000,210.000,25.0000,0.0000,0.0000\r\n0,0,15\r\n2.500\r\n0,0,0\r\n",
    );
    folder.write(
        "UFRAME.CND",
        "//UFRAME 2\r\n///NAME TABLE\r\n////BUSER 900.000,-300.000,420.000,0.0000,0.0000,20.0000\r\n",
    );
    let document = run("--payload-from-program", "two.jbi");
    let (one, two) = (
        skeleton(&folder.read("one.jbi")),
        skeleton(&folder.read("two.jbi")),
    );
    assert!(one.1 == two.1);
    for (a, b) in one.0.iter().zip(&two.0) {
        assert!((a - b).abs() < 2e-3, "{a} {b}");
    }
    let from: Vec<&str> = document["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| f["from"].as_str().unwrap())
        .collect();
    assert_eq!(from, ["./tool.cnd", "./UFRAME.CND", "the controller"]);
    // Files that are named need not be beside the job.
    std::fs::create_dir(folder.path("cnd")).unwrap();
    for name in ["tool.cnd", "UFRAME.CND"] {
        std::fs::rename(folder.path(name), folder.path(&format!("cnd/{name}"))).unwrap();
    }
    run(
        "--payload-from-program --with cnd/tool.cnd --with cnd/UFRAME.CND",
        "three.jbi",
    );
    assert!(folder.read("three.jbi") == folder.read("two.jbi"));
}

/// Variables of a Fanuc controller beside a listing replace a frame file, except for weights, which only the frame file has.
#[test]
fn tools_and_frames_of_a_listing_are_in_the_variables_beside_it() {
    let folder = folder();
    let run = |rest: &str, out: &str| {
        let line = format!("correct elas.blob part.ls {rest} --json - --out {out}");
        folder.run(&line).ok().json()
    };
    run("--payload-from-program --frames frames.toml", "one.ls");
    folder.write(
        "sysframe.va",
        "[*SYSTEM*]$MNUFRAME  Storage: CMOS  Access: RW  : ARRAY[1,9] OF POSITION\r\n     [1,2] = \r\n  Group: 1   \
         Config: N D B, 0, 0, 0\r\n  X:   900.000   Y:  -300.000   Z:   420.000\r\n  W:     0.000   P:     0.000   R:    20.000\r\n\
         [*SYSTEM*]$MNUTOOL  Storage: CMOS  Access: RW  : ARRAY[1,10] OF POSITION\r\n     [1,3] = \r\n  Group: 1   \
         Config: N D B, 0, 0, 0\r\n  X:    30.000   Y:   -45.000   Z:   210.000\r\n  W:    25.000   P:     0.000   R:     0.000\r\n",
    );
    let document = run("--payload-kg 2.5", "two.ls");
    assert!(folder.read("one.ls") == folder.read("two.ls"));
    let frames = document["frames"].as_array().unwrap();
    let from: Vec<&str> = frames.iter().map(|f| f["from"].as_str().unwrap()).collect();
    assert_eq!(from, ["./sysframe.va"; 2]);
    run("--payload-from-program --frames frames.toml", "three.ls");
    assert!(folder.read("three.ls") == folder.read("two.ls"));
    std::fs::rename(folder.path("sysframe.va"), folder.path("old.va")).unwrap();
    run("--payload-kg 2.5 --with old.va", "four.ls");
    assert!(folder.read("four.ls") == folder.read("two.ls"));
}

/// A dry run prints everything and writes only what is asked for by name.
#[test]
fn a_dry_run_writes_no_program() {
    let folder = folder();
    let line = "correct elas.blob part.jbi --payload-kg 2.5 --frames frames.toml --split 0.01 --json a.json --out";
    let dry = folder.run(&format!("{line} out.jbi --dry-run"));
    let files = |suffix: &str| {
        let entries = std::fs::read_dir(folder.path(".")).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.filter(|name| name.ends_with(suffix)).count()
    };
    assert_eq!((files("out.jbi"), files(".poegp.json")), (0, 0));
    let document = folder.json("a.json");
    let wet = folder.run(&format!("{line} out.jbi"));
    assert_eq!((files("out.jbi"), files(".poegp.json")), (1, 1));
    assert_eq!(document, folder.json("a.json"));
    assert_eq!((dry.code, wet.code), (Some(1), Some(1)));
    assert_eq!(dry.stdout.replace("Would write", "Wrote"), wet.stdout);
    assert!(dry.stderr.contains("would be corrected"), "{dry:#?}");
}

/// With the pulses of a degree, the joints of a job equal those of other languages within a pulse. A position with a wrong
/// number of axes is left uncorrected.
#[test]
fn pulses_are_joints_once_a_degree_is_known() {
    let folder = folder();
    let scales = [9_000.0, -8_000.0, 7_500.5, 6_000.0, -5_000.0, 4_000.0];
    let home = numbers_after(&file("part.mod"), "home:=", 6);
    let pulses = |degrees: &[f64]| -> Vec<f64> {
        degrees
            .iter()
            .zip(scales)
            .map(|(q, n)| (q * n).round())
            .collect()
    };
    let listed: Vec<String> = pulses(&home).iter().map(ToString::to_string).collect();
    let job = format!(
        "/JOB\r\n//NAME A\r\n//POS\r\n///TOOL 7\r\n///POSTYPE PULSE\r\n///PULSE\r\nC00000={}\r\nC00001=1,2,3\r\n//INST\r\nNOP\r\n\
         MOVJ C00000 VJ=50.00\r\nEND\r\n",
        listed.join(",")
    );
    folder.write("a.jbi", &job);
    folder.write("pulses.toml", format!("pulses_per_degree = {scales:?}\n"));
    let run = |line: &str| folder.run(&format!("correct elas.blob {line} --payload-kg 2.5"));
    run("part.mod --out out.mod").ok();
    let outcome = run("a.jbi --frames pulses.toml --out out.jbi");
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert!(
        outcome.stderr.contains("a.jbi:8:1: it has external axes"),
        "{outcome:#?}"
    );
    let expected = pulses(&numbers_after(&folder.read("out.mod"), "home:=", 6));
    let text = String::from_utf8_lossy(&folder.read("out.jbi")).into_owned();
    let found = numbers_after(text.as_bytes(), "C00000=", 6);
    assert_ne!(found, pulses(&home));
    for (a, b) in expected.iter().zip(&found) {
        assert!(
            (a - b).abs() <= 1.0 && b.fract() == 0.0,
            "{expected:?} {found:?}"
        );
    }
    assert!(skeleton(text.as_bytes()).1 == skeleton(job.as_bytes()).1);
    assert_eq!(text.matches('.').count(), job.matches('.').count());
    // Without that number, pulses are left; the model that corrects nothing gives every byte back.
    let outcome = run("a.jbi --out b.jbi");
    assert!(outcome.stderr.contains("pulses_per_degree"), "{outcome:#?}");
    let line = "correct base.blob a.jbi --payload-kg 1 --frames pulses.toml --out c.jbi";
    assert_eq!(folder.run(line).code, Some(1));
    assert!(folder.text("c.jbi") == job);
    folder.write("pulses.toml", "pulses_per_degree = [1, 0, 1, 1, 1, 1]\n");
    assert_eq!(run("a.jbi --frames pulses.toml --out d.jbi").code, Some(2));
}
