//! Every command that takes a robot refuses an invalid one and writes nothing.

use crate::program::{Folder, earlier, simulated};
use crate::texts::texts;

/// Asserts that every command refuses `robot`.
#[track_caller]
fn refused(folder: &Folder, robot: &str) {
    folder.write("train.csv", simulated("train", 12));
    folder.write("old.blob", earlier().0);
    for line in [
        format!("calibrate --robot {robot} train.csv --method poe --out old.blob --json new.json"),
        format!("compare --robot {robot} train.csv --json new.json"),
        format!("simulate --robot {robot} --poses 3 --out new"),
    ] {
        folder.refuses(line);
    }
}

/// Returns a URDF of four links with these joints: name, parent, child, and further elements.
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
    let _texts = texts();
    let folder = Folder::new();
    folder.write("arm.txt", "x");
    for robot in ["irb9000", "none.urdf", "arm.txt", "ur5 --tip flange"] {
        refused(&folder, robot);
    }
}

#[test]
fn joints_counted_otherwise_than_by_the_robot() {
    let _texts = texts();
    let folder = Folder::new();
    folder.write("train.csv", simulated("train", 100));
    // Measured with serial joints, but the controller of this robot counts the third joint differently.
    folder.refuses_data(
        "calibrate --robot abb-irb4400 --method poe-gp-load train.csv --out arm.blob",
    );
}

#[test]
fn urdf_files() {
    let _texts = texts();
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
    let mimic = "<mimic joint=\"j1\"/>";
    for joints in [
        &[chain[0], chain[1], chain[2], ("j4", "a", "d", "")][..],
        &[chain[0], ("j2", "d", "c", ""), ("j3", "c", "d", "")],
        &[chain[0], ("j2", "b", "c", mimic), chain[2]],
    ] {
        refused(&folder, with(joints));
    }
    let robot = with(&chain);
    refused(&folder, &format!("{robot} --base c --tip b"));
    refused(&folder, &format!("{robot} --tip tool7"));
    // The robot is valid but has three joints, and the measurements have six.
    folder.write("train.csv", simulated("train", 12));
    folder.refuses("calibrate --robot arm.urdf train.csv --method poe --out new.blob");
}

#[test]
fn toml_files() {
    let _texts = texts();
    let folder = Folder::new();
    let arm = "name = \"arm\"\nconvention = \"poe\"\n";
    for toml in [arm.to_owned() + "[[joint]]\nname = 3\n", arm.to_owned()] {
        folder.write("arm.toml", toml);
        refused(&folder, "arm.toml");
    }
}
