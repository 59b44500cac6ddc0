//! Robots that are none: each is refused by every command that takes one, and nothing is written.

use crate::program::{Folder, simulated};

/// Every command refuses `robot`, says `parts`, and writes nothing.
#[track_caller]
fn refused(folder: &Folder, robot: &str, parts: &[&str]) {
    folder.write("train.csv", simulated("train", 12));
    folder.write("old.blob", "the old blob");
    let before = folder.names();
    for line in [
        format!("calibrate --robot {robot} train.csv --model poe --out old.blob --json new.json"),
        format!("compare --robot {robot} train.csv --json new.json"),
        format!("simulate --robot {robot} --poses 3 --out new"),
    ] {
        folder.run(&line).refused(parts);
        assert_eq!(folder.names(), before, "{line}");
        assert_eq!(folder.read("old.blob"), b"the old blob", "{line}");
    }
}

/// A URDF of four links with the joints given as (name, parent, child, more).
fn urdf(joints: &[(&str, &str, &str, &str)]) -> String {
    let mut text = "<robot name=\"arm\">\n".to_owned();
    for link in ["a", "b", "c", "d"] {
        text += &format!("<link name=\"{link}\"/>\n");
    }
    for (name, parent, child, more) in joints {
        text += &format!(
            "<joint name=\"{name}\" type=\"continuous\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
             <axis xyz=\"0 0 1\"/>{more}</joint>\n"
        );
    }
    text + "</robot>\n"
}

#[test]
fn unknown_robots() {
    let folder = Folder::new();
    refused(
        &folder,
        "irb9000",
        &[
            "irb9000: found no such file",
            "expected a URDF",
            "abb-irb4400-serial",
        ],
    );
    refused(&folder, "none.urdf", &["none.urdf: found no such file"]);
    folder.write("arm.txt", "x");
    refused(&folder, "arm.txt", &["extension \"txt\"", "expected"]);
    refused(
        &folder,
        "ur5 --tip flange",
        &["the tip link \"flange\"", "only a URDF"],
    );
}

#[test]
fn joints_counted_otherwise_than_by_the_robot() {
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 100));
    // Measured with serial joints; the controller of this one counts the third otherwise.
    let line = "calibrate --robot abb-irb4400 --model poe-gp-load train.csv --out arm.blob";
    let outcome = folder.run(line);
    assert_eq!(outcome.code, Some(2), "{outcome:?}");
    assert!(outcome.stderr.contains("is it this robot"), "{outcome:?}");
    assert!(!folder.path("arm.blob").exists());
}

#[test]
fn urdf_files() {
    let folder = Folder::new();
    let chain = [
        ("j1", "a", "b", ""),
        ("j2", "b", "c", ""),
        ("j3", "c", "d", ""),
    ];
    let with = |joints: &[(&str, &str, &str, &str)]| {
        folder.write("arm.urdf", urdf(joints));
        "arm.urdf"
    };
    let robot = with(&[chain[0], chain[1], chain[2], ("j4", "a", "d", "")]);
    refused(
        &folder,
        robot,
        &["arm.urdf:9: found a loop", "\"d\"", "expected a tree"],
    );
    let robot = with(&[chain[0], ("j2", "d", "c", ""), ("j3", "c", "d", "")]);
    refused(&folder, robot, &["a loop", "expected a tree"]);
    let mimic = "<mimic joint=\"j1\"/>";
    let robot = with(&[chain[0], ("j2", "b", "c", mimic), chain[2]]);
    refused(
        &folder,
        robot,
        &[
            "arm.urdf:7: found joint \"j2\", which mimics \"j1\"",
            "expected joints that move on their own",
        ],
    );
    let robot = with(&chain);
    refused(
        &folder,
        &format!("{robot} --base c --tip b"),
        &["no chain from \"c\" to \"b\"", "expected"],
    );
    refused(
        &folder,
        &format!("{robot} --tip tool7"),
        &["tip link \"tool7\"", "expected one of the links"],
    );
    // Three joints: the robot is good, the file is another's.
    folder.write("train.csv", simulated("train", 12));
    let line = "calibrate --robot arm.urdf train.csv --model poe --out new.blob";
    folder.run(line).refused(&[
        "train.csv:1: found 6 joint columns",
        "expected 3, the joints of robot \"arm\"",
    ]);
}

#[test]
fn toml_files() {
    let folder = Folder::new();
    folder.write(
        "arm.toml",
        "name = \"arm\"\nconvention = \"poe\"\n[[joint]]\nname = 3\n",
    );
    refused(
        &folder,
        "arm.toml",
        &["arm.toml:4: column 8", "found", "expected"],
    );
    folder.write("arm.toml", "name = \"arm\"\nconvention = \"poe\"\n");
    refused(
        &folder,
        "arm.toml",
        &["arm.toml: found no moving joint", "1 to 8"],
    );
}
