//! What the reader of URDF refuses, and the words it uses.

use std::path::Path;

use crate::robot::tests::rejected::{link_names, says};
use crate::robot::{LoadOptions, urdf};

#[track_caller]
fn urdf_refused(text: &str, options: &LoadOptions, parts: &[&str]) {
    says(
        &urdf::parse(Path::new("arm.urdf"), text, options).unwrap_err(),
        parts,
    );
}

/// A URDF of links a, b, c, … with these joints, one a line: (name, type, parent, child, further elements).
fn arm(links: &str, joints: &[(&str, &str, char, char, &str)]) -> String {
    let mut text = "<robot name=\"arm\">".to_owned();
    for link in links.chars() {
        text += &format!("<link name=\"{link}\"/>");
    }
    for (name, kind, parent, child, more) in joints {
        text += &format!(
            "\n<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>{more}</joint>"
        );
    }
    text + "\n</robot>\n"
}

#[test]
fn urdf_is_refused_by_name() {
    let none = LoadOptions::default();
    urdf_refused("", &none, &["empty file"]);
    urdf_refused("name = \"x\"", &none, &["not XML"]);
    urdf_refused(
        "<robot name=\"x\"><link name=\"a\"/><link name=\"b\"/><joint name=\"j\" type=\"fixed\"><parent link=\"a\"/>\
         <child link=\"b\"/><origin xyz=\"0 0 ${height}\"/></joint></robot>",
        &none,
        &["${height}", "expand the xacro first"],
    );
    urdf_refused("<sdf><model/></sdf>", &none, &["element <sdf>", "<robot>"]);
    urdf_refused(
        "<robot name=\"x\">\n<link name=\"a\">",
        &none,
        &["arm.urdf:", "XML with an error", "URDF"],
    );
    urdf_refused(
        "<robot><xacro:arm/><link></robot>",
        &none,
        &["expand the xacro"],
    );
    urdf_refused("<robot name=\"x\"></robot>", &none, &["no link"]);

    let ok = ("j1", "continuous", 'a', 'b', "<axis xyz=\"0 0 1\"/>");
    assert!(urdf::parse(Path::new("arm.urdf"), &arm("ab", &[ok]), &none).is_ok());
    let one = |kind, more| arm("ab", &[("j1", kind, 'a', 'b', more)]);
    urdf_refused(
        &one("floating", ""),
        &none,
        &["arm.urdf:2:", "\"j1\" of type floating", "revolute"],
    );
    urdf_refused(&one("planar", ""), &none, &["of type planar"]);
    urdf_refused(
        &one(
            "prismatic",
            "<axis xyz=\"0 0 1\"/><limit lower=\"0\" upper=\"3000\" effort=\"1\" velocity=\"1\"/>",
        ),
        &none,
        &[
            "arm.urdf:2:",
            "0 to 3000 m of joint \"j1\"",
            "within 100 m: are these millimetres?",
        ],
    );
    urdf_refused(
        &one("wobbly", ""),
        &none,
        &["\"j1\" of type wobbly", "expected revolute"],
    );
    urdf_refused(
        &one("revolute", "<axis xyz=\"0 0 0\"/>"),
        &none,
        &["arm.urdf:2:", "axis 0 0 0", "\"j1\""],
    );
    // A token that is no number must not be passed over: "0 - 1 0" would become the axis 0 1 0.
    for (element, key, numbers) in [
        ("axis", "xyz", "0 0 nan"),
        ("axis", "xyz", "0 - 1 0"),
        ("origin", "xyz", "0 inf 0"),
        ("origin", "xyz", "0 a 0"),
        ("origin", "xyz", "0,5 0 0.3 0.1"),
        ("origin", "xyz", "0 0"),
        ("origin", "rpy", "0 0 0 1"),
        ("origin", "rpy", ""),
    ] {
        let more = format!("<{element} {key}=\"{numbers}\"/>");
        let found = format!("{key}=\"{numbers}\" in the {element} of joint \"j1\"");
        urdf_refused(
            &arm("ab", &[("j1", "revolute", 'a', 'b', &more)]),
            &none,
            &["arm.urdf:2: column", &found, "three finite numbers"],
        );
    }
    for (more, found) in [
        ("<origin quat_xyzw=\"0 0 0 1\"/>", "quat_xyzw in the origin"),
        ("<origin xyz=\"1 0 0\" ryp=\"0 0 1\"/>", "ryp in the origin"),
        ("<axis xzy=\"0 0 1\"/>", "xzy in the axis"),
        ("<origin/><origin/>", "a second <origin>"),
        ("<limit upper=\"1,5\"/>", "\"1,5\" as the upper limit"),
        ("<parent link=\"b\"/>", "a second <parent>"),
    ] {
        urdf_refused(&one("revolute", more), &none, &["arm.urdf:2:", found]);
    }
    let without = "<robot><joint name=\"j\" type=\"fixed\"><parent/></joint></robot>";
    urdf_refused(without, &none, &["<parent> without link"]);
    // What is beside the arm may be as it is.
    let beside = "<inertial/><visual><origin xyz=\"a\"/></visual>";
    let gripper = "<origin xyz=\"a\" quat_xyzw=\"\"/>";
    let text = arm("abc", &[ok, ("g", "wobbly", 'b', 'c', gripper)]).replace(
        "<link name=\"b\"/>",
        &format!("<link name=\"b\">{beside}</link>"),
    );
    assert!(urdf::parse(Path::new("arm.urdf"), &text, &link_names(None, Some("b"))).is_ok());
    let limit = "<limit lower=\"1\" upper=\"-1\" velocity=\"1\"/>";
    urdf_refused(
        &one("revolute", limit),
        &none,
        &["limits 1 to -1", "\"j1\""],
    );
    urdf_refused(
        &one("fixed", ""),
        &none,
        &["no moving joint between \"a\" and \"b\"", "1 to 8"],
    );
    let mimic = "<mimic joint=\"j0\"/>";
    urdf_refused(
        &one("revolute", mimic),
        &none,
        &["arm.urdf:2:", "mimics \"j0\"", "coupling"],
    );

    let nine: Vec<_> = "abcdefghij".chars().collect();
    let names: Vec<String> = (1..10).map(|i| format!("j{i}")).collect();
    let joints: Vec<_> = (0..9)
        .map(|i| (names[i].as_str(), "continuous", nine[i], nine[i + 1], ""))
        .collect();
    urdf_refused(
        &arm("abcdefghij", &joints),
        &none,
        &["9 moving joints", "1 to 8"],
    );
    assert!(urdf::parse(Path::new("a"), &arm("abcdefghi", &joints[..8]), &none).is_ok());
}

#[test]
fn urdf_trees_are_refused_by_name() {
    let none = LoadOptions::default();
    let deep = format!("<robot>{}</robot>", "<link name=\"a\">".repeat(12_000));
    urdf_refused(&deep, &none, &["arm.urdf:1: column", "XML with an error"]);
    let flat = format!(
        "<robot><!-- > --> {}</robot>",
        "<link name=\"a\"/>\n<a></a>".repeat(100)
    );
    urdf_refused(&flat, &none, &["arm.urdf"]);
    let joint = |name, parent, child| (name, "continuous", parent, child, "");
    let two_parents = arm(
        "abc",
        &[
            joint("j1", 'a', 'c'),
            joint("j2", 'a', 'b'),
            joint("j3", 'b', 'c'),
        ],
    );
    urdf_refused(
        &two_parents,
        &none,
        &["arm.urdf:4:", "a loop", "\"c\"", "\"j1\" and \"j3\""],
    );
    let cycle = arm(
        "abcd",
        &[
            joint("j1", 'a', 'b'),
            joint("j2", 'c', 'd'),
            joint("j3", 'd', 'c'),
        ],
    );
    urdf_refused(
        &cycle,
        &link_names(Some("a"), Some("b")),
        &["a loop through link", "tree"],
    );
    urdf_refused(&arm("a", &[joint("j1", 'a', 'a')]), &none, &["a loop"]);
    urdf_refused(
        &arm("ab", &[joint("j1", 'a', 'z')]),
        &none,
        &["arm.urdf:2:", "child link \"z\"", "\"a\", \"b\""],
    );
    urdf_refused(
        &arm("aab", &[joint("j1", 'a', 'b')]),
        &none,
        &["two links named \"a\""],
    );
    let twice = arm("abc", &[joint("j1", 'a', 'b'), joint("j1", 'b', 'c')]);
    urdf_refused(&twice, &none, &["arm.urdf:3:", "two joints named \"j1\""]);

    let fork = arm("abc", &[joint("j1", 'a', 'b'), joint("j2", 'a', 'c')]);
    urdf_refused(
        &fork,
        &none,
        &[
            "several leaf links: \"b\", \"c\"",
            "tool0, flange, ee_link",
            "tip",
        ],
    );
    urdf_refused(
        &fork,
        &link_names(Some("b"), Some("c")),
        &["no chain from \"b\" to \"c\"", "\"a\", \"b\", \"c\""],
    );
    urdf_refused(
        &fork,
        &link_names(Some("x"), None),
        &["base link \"x\"", "\"a\", \"b\", \"c\""],
    );
    urdf_refused(
        &fork,
        &link_names(None, Some("y")),
        &["tip link \"y\"", "\"a\", \"b\", \"c\""],
    );
    urdf_refused(
        &arm("abx", &[joint("j1", 'a', 'b')]),
        &none,
        &["several root links: \"a\", \"x\"", "base"],
    );
}
