//! What the readers refuse, and the words they use.

use std::path::Path;

use crate::input_error::InputError;
use crate::robot::tests::ROBOTS;
use crate::robot::{LoadOptions, Robot, toml_description as description};

#[track_caller]
pub(super) fn says(error: &InputError, parts: &[&str]) {
    let text = error.to_string();
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text:?}");
    }
}

#[track_caller]
fn load_refused(spec: &str, options: &LoadOptions, parts: &[&str]) {
    says(&Robot::load(spec, options).unwrap_err(), parts);
}

pub(super) fn link_names(base: Option<&str>, tip: Option<&str>) -> LoadOptions {
    LoadOptions {
        base: base.map(Into::into),
        tip: tip.map(Into::into),
    }
}

#[test]
fn files_are_refused_by_name() {
    let none = LoadOptions::default();
    load_refused(
        "ur15",
        &none,
        &[
            "ur15: found no such file",
            "built-in robots are abb-irb120,",
            "ur5",
        ],
    );
    load_refused("no/such.urdf", &none, &["no/such.urdf", "no such file"]);
    load_refused(ROBOTS, &none, &["a directory"]);
    load_refused(
        &format!("{ROBOTS}/README.md"),
        &none,
        &["extension \"md\"", ".urdf"],
    );
    load_refused(
        "ur5",
        &link_names(Some("base_link"), None),
        &["base link \"base_link\"", "only a URDF"],
    );
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    load_refused(&write("a.urdf", b"\xff\xfe\x00"), &none, &["not UTF-8"]);
    load_refused(
        &write("a.xacro", b"<robot/>"),
        &none,
        &["xacro", "expand it first"],
    );
    load_refused(
        &write("a.toml", b"name = 3"),
        &none,
        &["a.toml:1: column 8", "found", "expected"],
    );
    // Millimetres in a file of metres.
    let text = include_str!("../../../robots/ur5.toml");
    let long = text.replace("a_m = -0.425", "a_m = -425");
    assert_ne!(long, text);
    load_refused(
        &write("long.toml", long.as_bytes()),
        &none,
        &[
            "long.toml: found a link of 425 m after joint",
            "at most 100 m",
            "millimetres?",
        ],
    );
    // A byte order mark is no error.
    let text = [
        b"\xef\xbb\xbf",
        include_bytes!("../../../robots/ur5.toml").as_slice(),
    ]
    .concat();
    assert!(Robot::load(&write("bom.toml", &text), &none).is_ok());
}

#[track_caller]
fn toml_refused(text: &str, parts: &[&str]) {
    says(
        &description::parse(Path::new("arm.toml"), text).unwrap_err(),
        parts,
    );
}

const DH: &str = "name = \"arm\"\nconvention = \"dh\"\n[[joint]]\nname = \"j1\"\nkind = \"revolute\"\n\
                  a_m = 0.1\nd_m = 0.2\nalpha_deg = 90\n";
const POE: &str = "name = \"arm\"\nconvention = \"poe\"\n[[joint]]\nname = \"j1\"\nkind = \"revolute\"\n\
                   origin = {}\naxis = [0, 0, 1]\n";

#[test]
fn toml_is_refused_by_name() {
    assert!(description::parse(Path::new("arm.toml"), DH).is_ok());
    assert!(description::parse(Path::new("arm.toml"), POE).is_ok());
    toml_refused("name = ", &["arm.toml:1:", "expected"]);
    toml_refused("", &["no `name`", "the key `name`"]);
    toml_refused(
        &DH.replace("\"dh\"", "\"denavit\""),
        &[
            "arm.toml:2: column 14",
            "found `denavit`",
            "`poe`, `dh`",
            "`modified-dh`",
        ],
    );
    toml_refused(
        &DH.replace("\"revolute\"", "\"spherical\""),
        &["arm.toml:5:", "`spherical`", "`prismatic`"],
    );
    toml_refused(
        &DH.replace("a_m", "a"),
        &["arm.toml:6:", "unknown key `a`", "help", "a_m or a_mm"],
    );
    toml_refused(
        &DH.replace("alpha_deg", "alpha"),
        &["arm.toml:8:", "alpha_deg or alpha_rad"],
    );
    toml_refused(
        &DH.replace("a_m = 0.1", ""),
        &["arm.toml:3:", "no a_m or a_mm of joint \"j1\""],
    );
    toml_refused(
        &DH.replace("a_m = 0.1", "a_m = 0.1\na_mm = 100"),
        &["arm.toml:7:", "(a_mm)", "a_mm beside a_m", "one unit"],
    );
    toml_refused(
        &DH.replace("0.1", "nan"),
        &["arm.toml:6: column 7 (a_m): found NaN", "finite"],
    );
    toml_refused(
        &DH.replace("0.1", "\"0.1\""),
        &["arm.toml:6:", "the text \"0.1\""],
    );
    toml_refused(
        &(DH.to_owned() + "axis = [0, 0, 1]"),
        &["arm.toml:9:", "(axis)", "convention \"poe\""],
    );
    toml_refused(
        &(POE.to_owned() + "d_m = 1"),
        &["arm.toml:8:", "(d_m)", "origin and axis"],
    );
    toml_refused(
        &POE.replace("axis = [0, 0, 1]", ""),
        &["arm.toml:3:", "no axis of joint \"j1\""],
    );
    toml_refused(
        &POE.replace("origin = {}", ""),
        &["arm.toml:3:", "no origin", "origin = {}"],
    );
    toml_refused(
        &POE.replace("[0, 0, 1]", "[0, 0, 0]"),
        &["arm.toml:7:", "(axis)", "not all zero"],
    );
    toml_refused(
        &POE.replace("[0, 0, 1]", "[0, 1]"),
        &["arm.toml:7:", "expected"],
    );
    toml_refused(
        &POE.replace("{}", "{ xyz = [0, 0, 1] }"),
        &["arm.toml:6:", "`xyz`", "xyz_m or xyz_mm"],
    );
    let both = "{ rpy_deg = [0, 0, 1], rpy_rad = [0, 0, 1] }";
    toml_refused(
        &POE.replace("{}", both),
        &["arm.toml:6:", "rpy_deg beside rpy_rad"],
    );
    toml_refused(
        "name = \"x\"\nconvention = \"dh\"",
        &["no moving joint", "1 to 8", "[[joint]]"],
    );
    let joint = &DH[DH.find("[[joint]]").unwrap()..];
    toml_refused(
        &(DH.to_owned() + joint),
        &["arm.toml:10:", "(name)", "second joint named \"j1\""],
    );
    let nine = (0..9)
        .map(|i| joint.replace("j1", &format!("k{i}")))
        .collect::<String>();
    toml_refused(
        &format!("name = \"x\"\nconvention = \"dh\"\n{nine}"),
        &["9 moving joints"],
    );
}

#[test]
fn toml_limits_and_coupling_are_refused_by_name() {
    let limits = |line: &str| DH.to_owned() + line;
    toml_refused(
        &limits("limits_deg = [10, -10]"),
        &["arm.toml:9: column 14 (limits_deg)", "limits 10 to -10"],
    );
    toml_refused(
        &limits("limits = [-10, 10]"),
        &["`limits`", "limits_deg or limits_rad"],
    );
    toml_refused(
        &limits("limits_mm = [-10, 10]"),
        &["limits_mm", "for a revolute joint"],
    );
    toml_refused(
        &limits("limits_rad = [-1, 1]\nlimits_deg = [-1, 1]"),
        &["limits_deg beside limits_rad"],
    );
    toml_refused(
        &limits("limits_rad = [-1, inf]"),
        &["(limits_rad)", "found inf"],
    );
    let prismatic = DH.replace("revolute", "prismatic") + "limits_deg = [-10, 10]";
    toml_refused(&prismatic, &["limits_deg", "for a prismatic joint"]);
    let slide = |line: &str| DH.replace("revolute", "prismatic") + line;
    let asked = [
        "arm.toml:9: column 12 (limits_m)",
        "0 to 200",
        "within 100 m: are these millimetres?",
    ];
    toml_refused(&slide("limits_m = [0, 200]"), &asked);
    toml_refused(
        &slide("limits_m = [-3000, 0.0]"),
        &["-3000 to 0", "are these millimetres?"],
    );
    toml_refused(
        &slide("limits_mm = [0, 200000]"),
        &["(limits_mm)", "within 100 m"],
    );
    for rail in ["limits_m = [0, 100]", "limits_mm = [-1500, 60000]"] {
        assert!(description::parse(Path::new("arm.toml"), &slide(rail)).is_ok());
    }
    toml_refused(
        &limits("gear_ratio = 0.2"),
        &[
            "arm.toml:9: column 14 (gear_ratio)",
            "0.2 cycles",
            "1 to 1000",
        ],
    );
    toml_refused(&limits("gear_ratio = 1e300"), &["found 1e300 cycles"]);
    toml_refused(&limits("link_radius_mm = 1e300"), &["found 1e300,"]);
    let huge = limits("limits_deg = [1e300, -1e300]");
    toml_refused(&huge, &["the limits 1e300 to -1e300"]);
    toml_refused(
        &limits("gear_lines = [200, nan]"),
        &["(gear_lines)", "NaN cycles"],
    );
    toml_refused(
        &limits(
            "gear_lines = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]\ngear_ratio = 50",
        ),
        &["arm.toml:4: column 8 (name)", "17 lines", "at most 16"],
    );
    let prismatic = DH.replace("revolute", "prismatic") + "gear_ratio = 50";
    toml_refused(&prismatic, &["gear_ratio", "gears of revolute joints only"]);
    let geared = limits("gear_ratio = 50\ngear_lines = [201, 100]");
    let geared = description::parse(Path::new("arm.toml"), &geared).unwrap();
    assert_eq!(geared.joints[0].gear_lines, [50.0, 100.0, 201.0]);

    let two = DH.to_owned() + &DH[DH.find("[[joint]]").unwrap()..].replace("j1", "j2");
    let coupled = |matrix: &str| two.replacen('\n', &format!("\ncoupling = {matrix}\n"), 1);
    toml_refused(
        &coupled("[[1, 0]]"),
        &["arm.toml:2:", "(coupling)", "1 row", "2 rows of 2 numbers"],
    );
    toml_refused(&coupled("[[1, 0], [1]]"), &["a row of 1 number"]);
    toml_refused(&coupled("[[1, 2], [1, 2]]"), &["singular", "invertible"]);
    toml_refused(&coupled("[[1, nan], [2, 4]]"), &["NaN", "within ±2"]);
    let place = "arm.toml:2: column 21 (coupling)";
    let beyond = coupled("[[1, 0], [1e300, 1]]");
    toml_refused(&beyond, &[place, "found 1e300", "within ±2"]);
    toml_refused(&coupled("[[1, 0], [0, -2.1]]"), &[place, "found -2.1"]);
    assert!(description::parse(Path::new("arm.toml"), &coupled("[[1, 0], [-2, 2]]")).is_ok());
    let named = DH.replacen("name = \"arm\"", "name = \"arm\\u0007\"", 1);
    toml_refused(&named, &["arm.toml:1: column 8 (name)", "control"]);
    let load = |matrix| {
        description::parse(Path::new("arm.toml"), &coupled(matrix))
            .unwrap()
            .coupling
    };
    assert_eq!(load("[[1, 0], [0, 1.0]]"), None);
    assert_eq!(
        load("[[0, 1], [1, 0]]"),
        Some(vec![vec![0.0, 1.0], vec![1.0, 0.0]])
    );
    // The controller has no axis for the second joint.
    let passive = description::parse(Path::new("arm.toml"), &coupled("[[1, 0], [-1, 0]]")).unwrap();
    assert!(passive.is_passive(1) && !passive.is_passive(0));
    assert_eq!(passive.joints[1].limits, Some((0.0, 0.0)));
    assert_eq!(passive.serial_joints(&[0.5, 0.0]), [0.5, -0.5]);
}
