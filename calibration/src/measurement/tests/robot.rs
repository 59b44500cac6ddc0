//! A set against its robot.

use crate::measurement::tests::{notes_say, ok, says};
use crate::robot::{LoadOptions, Robot};

fn irb120() -> Robot {
    Robot::load("abb-irb120", &LoadOptions::default()).unwrap()
}

/// A rail along x with one revolute joint.
fn rail() -> Robot {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rail.toml");
    let text = "name = \"rail\"\nconvention = \"poe\"\n\
                [[joint]]\nname = \"slide\"\nkind = \"prismatic\"\nlimits_mm = [0, 2000]\norigin = {}\naxis = [1, 0, 0]\n\
                [[joint]]\nname = \"turn\"\nkind = \"revolute\"\norigin = {}\naxis = [0, 0, 1]\n";
    std::fs::write(&path, text).unwrap();
    Robot::load(path.to_str().unwrap(), &LoadOptions::default()).unwrap()
}

const SIX: &str = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n";

#[test]
fn a_set_of_the_robot_passes_without_a_note() {
    let set = ok(&format!(
        "{SIX}1,2,3,4,5,6,100,2,3\n-40,50,-60,70,-80,90,300,2,3\n"
    ));
    assert!(set.check(&irb120()).unwrap().is_empty());
    let set = ok("q1_mm,q2_deg,x_mm,y_mm,z_mm\n1,2,100,2,3\n1900,700,100,2,3\n");
    assert!(set.check(&rail()).unwrap().is_empty());
}

#[test]
fn payloads_that_no_arm_of_this_size_carries_are_refused() {
    let head = SIX.replacen("q1", "payload_kg,q1", 1);
    let set = ok(&format!(
        "{head}3,1,2,3,4,5,6,100,2,3\n3000,-40,50,-60,70,-80,90,300,2,3\n"
    ));
    says(
        &set.check(&irb120()).unwrap_err(),
        &[
            "set.csv:3:",
            "a payload of 3000 kg",
            "as long as \"abb-irb120\"",
            "grams",
        ],
    );
}

#[test]
fn joints_of_another_robot_are_refused() {
    let seven = ok("# c\nq1_deg,q2_deg,x_mm,y_mm,z_mm\n1,2,3,4,5\n");
    says(
        &seven.check(&irb120()).unwrap_err(),
        &[
            "set.csv:2:",
            "2 joint columns: q1_deg, q2_deg",
            "6, the joints of robot \"abb-irb120\"",
        ],
    );
    let lengths =
        ok("q1_deg,q2_deg,q3_mm,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n1,2,3,4,5,6,7,8,9\n");
    says(
        &lengths.check(&irb120()).unwrap_err(),
        &[
            "set.csv:1: column 3 (q3_mm): found q3_mm",
            "degrees or radians",
            "revolute joint \"joint_3\"",
        ],
    );
    let angles = ok("q1_deg,q2_deg,x_mm,y_mm,z_mm\n1,2,3,4,5\n");
    says(
        &angles.check(&rail()).unwrap_err(),
        &["column 1 (q1_deg)", "prismatic joint \"slide\""],
    );
}

#[test]
fn values_far_beyond_the_limits_are_refused() {
    // Joint 3 goes from −110 to 70 degrees; a tenth of that and one degree are 19.
    let refused =
        |text: String, parts: &[&str]| says(&ok(&text).check(&irb120()).unwrap_err(), parts);
    let other_robot = [
        "set.csv:3: column 3 (q3_deg): found 89.1 deg",
        "joint \"joint_3\"",
        "-110 to 70 deg",
        "its controller",
    ];
    refused(
        format!("{SIX}1,2,3,4,5,6,7,8,9\n1,2,89.1,4,5,6,7,8,9\n"),
        &other_robot,
    );
    let radians = SIX.replace("deg", "rad");
    refused(
        format!("{radians}0,0,45,0,0,0,7,8,9\n"),
        &[
            "set.csv:2: column 3 (q3_rad): found 45 rad",
            "-1.9199 to 1.2217 rad",
            "is the column's unit _deg?",
        ],
    );
    let metres = ok("q1_m,q2_deg,x_mm,y_mm,z_mm\n150,2,3,4,5\n");
    says(
        &metres.check(&rail()).unwrap_err(),
        &["(q1_m): found 150 m", "0 to 2 m", "unit _mm?"],
    );

    let just_beyond = ok(&format!(
        "{SIX}1,2,-40,4,5,6,70,8,9\n9,9,88.9,9,9,9,7,8,9\n"
    ));
    notes_say(
        &just_beyond.check(&irb120()).unwrap(),
        &["\"joint_3\" is a little beyond its limits in 1 row (line 3)"],
    );
}

#[test]
fn odd_sets_are_noted() {
    let notes = |text: String| ok(&text).check(&irb120()).unwrap();
    let radians = format!("{SIX}0.1,-1.2,0.3,0.4,0.5,3.1,100,8,9\n1,1,1,1,1,1,7,8,9\n");
    notes_say(
        &notes(radians),
        &["all joint values are within ±3.1°", "are they radians?"][..1],
    );
    let still = format!("{SIX}1,20,3,4,5,6,100,8,9\n-40,20.4,-60,70,-80,90,300,2,3\n");
    notes_say(
        &notes(still),
        &["joint \"joint_2\" (q2_deg) does not move: its values span 0.4 deg"],
    );
    let repeated =
        format!("{SIX}1,2,3,4,5,6,100,8,9\n-40,50,-60,70,-80,90,300,2,3\n1.0,2,3,4,5,6,101,8,9\n");
    notes_say(
        &notes(repeated),
        &["joints equal to those of an earlier row: 1 row (line 4 as 2)"],
    );
    let metres = format!("{SIX}1,2,3,4,5,6,1.2,0.3,-2\n-40,50,-60,70,-80,90,1,2,-2.5\n");
    notes_say(
        &notes(metres),
        &["all positions are within 2.5 mm of the instrument: are they metres?"],
    );
    let head = SIX.replace("z_mm", "z_mm,qw,qx,qy,qz");
    let upright = format!(
        "{head}1,2,3,4,5,6,100,8,9,0.6,0.8,0,0\n-40,50,-60,70,-80,90,300,2,3,-0.6,-0.8,0,0\n"
    );
    notes_say(&notes(upright), &["every pose has the same orientation"]);
}
