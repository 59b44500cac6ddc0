//! URScript: tools, features, joints and targets that a script changes on some path.

use super::{check, run};
use crate::programs::{folder, numbers_after};

const TCP: &str = "set_tcp(p[0.03, -0.045, 0.21, 0.436332, 0, 0])\n";
const POINT: &str = "p[1.492296, 0.156780, 0.895801, 0.331928, 2.688217, -0.739401]";

/// Returns a script with a tool, joints, and a feature.
fn script(part: &str) -> String {
    format!(
        "def A():\n{TCP}set_payload(1)\nmovej([0.218166, 0.353429, -0.071995, -0.322886, 0.837758, 0.554142])\n\
         q = {POINT}\n{part}\nend\n"
    )
}

#[test]
fn scripts_are_followed_on_every_way() {
    let folder = folder();
    let long = "set_tcp(p[0, 0, 0.6, 0, 0, 0])";
    let (go, own) = ("movel(q)", format!("def f():\n{long}\nend"));
    let cases = [
        (go.to_owned(), 2, ""),
        // A feature that is also a target moves its offsets, whichever comes first.
        (
            format!("movel(pose_trans(q, p[0,0,-0.05,0,0,0]))\n{go}"),
            2,
            "its feature q is a target",
        ),
        (
            format!("{go}\nmovel(pose_trans(q, p[0,0,-0.05,0,0,0]))"),
            2,
            "its feature q is a target",
        ),
        (format!("q[1] = q[1] - 0.3\n{go}"), 1, "computed"),
        (format!("if a: q[i] = 0\n{go}"), 1, "computed"),
        (format!("if a:\n{long}\nend\n{go}"), 1, "not on every path"),
        (format!("if a:\n{TCP}end\n{go}"), 2, ""),
        (
            format!("while a:\n{go}\n{long}\nend"),
            1,
            "not on every path",
        ),
        (format!("{own}\nf()\n{go}"), 2, ""),
        (format!("{own}\nif f():\nend\n{go}"), 2, ""),
        (
            format!("def f():\nif a:\n{long}\nend\nend\nf()\n{go}"),
            1,
            "not on every path",
        ),
        (
            format!("thread f():\n{long}\nend\nrun f()\n{go}"),
            1,
            "not on every path",
        ),
        (
            format!("track_conveyor_linear(p[1,0,0,0,0,0], 100)\n{go}\nstop_conveyor_tracking()"),
            1,
            "the controller moves it",
        ),
        // With and without an end for each case.
        (
            format!("switch a:\ncase 1:\n{long}\ncase 2:\n{TCP}default:\n{go}\nend\n{go}"),
            1,
            "not on every path",
        ),
        (
            format!("switch a:\ncase 1:\n{long}\nend\ncase 2:\n{TCP}end\ndefault:\n{go}\nend\nend"),
            2,
            "",
        ),
        (
            format!("switch a:\ncase 1:\n{long}\nend\nend\n{go}"),
            1,
            "not on every path",
        ),
        (
            format!("switch a:\ncase 1:\n{long}\nend\ndefault:\n{long}\nend\nend\n{TCP}{go}"),
            2,
            "",
        ),
        // A computed tool, and features within features.
        (
            format!("set_tcp(f(q))\n{go}"),
            1,
            "tool tcp: it is computed at a.script:6",
        ),
        (
            format!("movel(pose_trans(pose_trans(p[0.1,0,0,0,0,0], p[-0.1,0,0,0,0,0]), {POINT}))"),
            2,
            "",
        ),
        (
            format!("movel(pose_trans(pose_trans(p[0,0,0,0,0,0], g), {POINT}))"),
            1,
            "its feature g is computed",
        ),
        // A feature that is set again has the value that holds at the move.
        (
            format!("f = p[0,0,0,0,0,0]\nf = p[0.1,0,0,0,0,0]\nmovel(pose_trans(f, {POINT}))"),
            2,
            "",
        ),
        (
            format!(
                "f = p[0,0,0,0,0,0]\nif a:\nf = p[0.1,0,0,0,0,0]\nend\nmovel(pose_trans(f, {POINT}))"
            ),
            1,
            "its feature f: it is set at a.script:8, but not on every path",
        ),
        // The joints of `qnear` are computed at run time.
        (
            "movej(get_inverse_kin(q, qnear=get_target_joint_positions()))".to_owned(),
            1,
            "its qnear is computed",
        ),
        (
            "movej(get_inverse_kin(q, [0,0,0,0,0,0], 0.1, 0.1, p[0,0,0,0,0,0]))".to_owned(),
            1,
            "a tool of their own",
        ),
        (
            "movej(get_inverse_kin(q, [0,0,0,0,0,0]))\nmovej(get_inverse_kin(q, [1,0,0,0,0,0]))"
                .to_owned(),
            1,
            "different joints",
        ),
    ];
    check(&folder, &cases, "a.script", "", script);
    let heavy = format!("if a:\nset_payload(5)\nend\n{go}");
    check(
        &folder,
        &[(&heavy, 1, "the payload at this move cannot be determined")],
        "a.script",
        "--payload-from-program",
        script,
    );
}

/// A product of features or tools is what it is worth; a script whose switch does not end is refused.
#[test]
fn products_of_poses_are_computed() {
    let folder = folder();
    let numbers = |part: &str| {
        let left = run(&folder, "a.script", &script(part), "");
        assert_eq!(left, (2, String::new()), "{part}");
        numbers_after(&folder.read("out_a.script"), ", p[1.", 6)
    };
    let turned = "p[0, 0, 0.1, 0, 0, 0.3]";
    let of = |feature: &str| format!("movel(pose_trans({feature}, {POINT}))");
    let plain = numbers(&of(turned));
    let product = "pose_trans(p[0, 0, 0.1, 0, 0, 0], p[0, 0, 0, 0, 0, 0.3])";
    assert_eq!(numbers(&of(product)), plain);
    let inner = of("pose_trans(f, p[0, 0, 0, 0, 0, 0.3])");
    let two = format!("f = p[1, 0, 0, 0, 0, 0]\nf = p[0, 0, 0.1, 0, 0, 0]\n{inner}");
    assert_eq!(numbers(&two), plain);
    let tool = |tool: &str| numbers(&format!("set_tcp({tool})\n{}", of("p[0, 0, 0, 0, 0, 0]")));
    let short = "pose_trans(p[0.03, -0.045, 0, 0, 0, 0], p[0, 0, 0.2, 0, 0, 0])";
    assert_eq!(tool(short), tool("p[0.03, -0.045, 0.2, 0, 0, 0]"));
    let refused = |text: String, found: &str| {
        folder.write("a.script", text);
        let outcome = folder.run("correct elas.blob a.script --payload-kg 1 --out out.script");
        assert_eq!(outcome.code, Some(2), "{outcome:#?}");
        assert!(outcome.stderr.contains(found), "{outcome:#?}");
    };
    for cut in [
        "switch a:\ncase 1:\nend\ndefault:\nx=1\nend",
        "switch a:\ncase 1:\nx=1",
    ] {
        let text = script(&format!("{cut}\nmovel(q)"));
        refused(text, "a switch in a script whose blocks do not end");
    }
    refused(
        script("movel(q)").replace(TCP, ""),
        "found a move without a tool",
    );
}

/// Joints need no tool.
#[test]
fn a_script_of_joints_needs_no_tool() {
    let folder = folder();
    let text = script("movej(q=[0.2, 0.3, -0.1, -0.3, 0.8, 0.5], a=1)").replace(TCP, "");
    assert_eq!(run(&folder, "a.script", &text, ""), (2, String::new()));
    let pose = script(&format!("movel(pose={POINT}, a=1)"));
    assert_eq!(run(&folder, "a.script", &pose, ""), (2, String::new()));
}

/// Where no joints are known, the branch is a guess, and the command says so.
#[test]
fn a_guess_of_the_branch_is_said() {
    let folder = folder();
    for (joints, is_said) in [
        ("", true),
        ("movej([0.2, 0.35, -0.07, -0.3, 0.8, 0.5])\n", false),
    ] {
        folder.write(
            "a.script",
            format!("def A():\n{TCP}{joints}movel({POINT})\nend\n"),
        );
        let outcome = folder
            .run("correct elas.blob a.script --payload-kg 1 --out out.script")
            .ok();
        let said = outcome
            .stdout
            .contains("no joints are known before this first pose");
        assert_eq!(said, is_said, "{outcome:#?}");
    }
}

/// The joints of `qnear` determine the branch: with the wrist turned the other way, the joints and the correction differ.
#[test]
fn qnear_chooses_the_branch() {
    let folder = folder();
    let moved = |near: &str| {
        let part = format!("n = {near}\nmovej(get_inverse_kin(q, qnear=n))");
        assert_eq!(
            run(&folder, "a.script", &script(&part), ""),
            (2, String::new())
        );
        numbers_after(&folder.read("out_a.script"), "q = p[", 6)
    };
    let near = moved("[0.218166, 0.353429, -0.071995, -0.322886, 0.837758, 0.554142]");
    let flipped = moved("[0.218166, 0.353429, -0.071995, 2.818707, -0.837758, -2.587451]");
    assert_ne!(near, flipped);
}

/// A pose in a feature that is in another feature is transformed by both.
#[test]
fn features_stand_in_features() {
    let folder = folder();
    let pose = "p[1.292296, 0.056780, 0.795801, 0.331928, 2.688217, -0.739401]";
    let numbers = |part: &str| {
        assert_eq!(run(&folder, "a.script", &script(part), "").0, 2);
        numbers_after(&folder.read("out_a.script"), "pose_trans(b, p[", 6)
    };
    let nested = numbers(&format!(
        "b = p[0.15,0.1,0,0,0,0]\na = p[0.05,0,0.1,0,0,0]\nmovel(pose_trans(a, pose_trans(b, {pose})))"
    ));
    let one = numbers(&format!(
        "b = p[0.2,0.1,0.1,0,0,0]\nmovel(pose_trans(b, {pose}))"
    ));
    let again = numbers(&format!(
        "b = p[0.9,0,0,0,0,0]\nb = p[0.2,0.1,0.1,0,0,0]\nmovel(pose_trans(b, {pose}))"
    ));
    assert_eq!(again, one);
    for (a, b) in nested.iter().zip(&one) {
        assert!((a - b).abs() < 2e-6, "{nested:?} {one:?}");
    }
}

/// Statements on one line are those of several lines: moves are corrected, and what a line sets holds behind it.
#[test]
fn statements_of_one_line_are_all_read() {
    let folder = folder();
    let other = "p[1.45, 0.2, 0.85, 0.33, 2.69, -0.74]";
    let long = "set_tcp(p[0, 0, 0.26, 0, 0, 0])";
    let numbers = |part: &str, separator: &str| {
        let part = part.replace('|', separator);
        let (targets, left) = run(&folder, "a.script", &script(&part), "");
        assert_eq!(left, "", "{part}");
        let after = folder.read("out_a.script");
        (targets, numbers_after(&after, "movel(p[", 6))
    };
    for part in [
        format!("movej(q)|movel({other})"),
        format!("movej(q, a=1.2)|{long}|movel({other}, a=1.2)"),
        format!("movel({other})|movej(q)|sleep(0.5)"),
    ] {
        let expected = numbers(&part, "\n");
        assert_eq!(expected.0, 3);
        for separator in [" ", "; ", ";"] {
            assert_eq!(numbers(&part, separator), expected, "{part}");
        }
    }
    // What stands under a condition or in a function on the same line is named.
    for (part, reason) in [
        ("if a: movel(q) end", "a move within a line"),
        ("def f(): movel(q)\nend", "a move within a line"),
        ("if a: servoj(q) end", "a move within a line"),
        ("movej(q) servoj(q)", "servoj is not corrected"),
    ] {
        let (_, left) = run(&folder, "a.script", &script(part), "");
        assert!(left.contains(reason), "{part}\n{left}");
    }
}

/// Moves of newer controllers, and calls that get a pose and may go there.
#[test]
fn no_call_that_gets_a_target_is_silent() {
    let folder = folder();
    let long = "set_tcp(p[0, 0, 0.6, 0, 0, 0])";
    let cases = [
        (format!("optimovel({POINT})"), 2, ""),
        (format!("optimovej({POINT}, a=0.3, v=0.3)"), 2, ""),
        (
            format!("movel(q)\n{long}\noptimovel(q)"),
            1,
            "its moves use different frames",
        ),
        (
            format!("movel(q)\n{long}\nmc_add_linear(q, 0.1, 0.5, 0.01)"),
            1,
            "mc_add_linear at a.script:8 also receives it",
        ),
        (
            format!("mc_add_linear({POINT}, 0.1, 0.5, 0.01)"),
            1,
            "mc_add_linear is not corrected",
        ),
        (
            format!("mc_add_circular({POINT}, {POINT}, 0.1, 0.5, 0.01)"),
            1,
            "mc_add_circular is not corrected",
        ),
        (
            format!("weld_to({POINT})"),
            1,
            "weld_to receives a pose, and is not corrected",
        ),
        (
            format!("a = weld_to(pose_trans(p[0,0,0,0,0,0], {POINT}))"),
            1,
            "weld_to receives a pose",
        ),
        (
            "movel(q)\nweld_to(q)".to_owned(),
            1,
            "weld_to at a.script:7 also receives it",
        ),
        (
            "movel(q)\nservoc(q, 1, 1)".to_owned(),
            1,
            "servoc at a.script:7 also receives it",
        ),
        (
            "def go(t):\nmovel(t)\nend\nmovel(q)\ngo(q)".to_owned(),
            1,
            "go at a.script:10 also receives it",
        ),
        (
            "def go(t):\non(t)\nend\ndef on(t):\nmovel(t)\nend\nmovel(q)\ngo(q)".to_owned(),
            1,
            "go at a.script:13 also receives it",
        ),
        // What only computes or tells something.
        (
            "def far(t):\nreturn pose_dist(t, get_actual_tcp_pose())\nend\nmovel(q)\nif far(q) > 0.1:\nhalt\nend"
                .to_owned(),
            2,
            "",
        ),
        (
            "textmsg(\"at \", q)\nmovel(q)\nx = pose_dist(q, q)\nweld(q[0], 3)".to_owned(),
            2,
            "",
        ),
        ("rpc = 1\nrpc.report(q)\nmovel(q)".to_owned(), 2, ""),
        // A named argument.
        (
            "set_tcp(pose=p[0.03, -0.045, 0.21, 0.436332, 0, 0])\nmovel(q)".to_owned(),
            2,
            "",
        ),
    ];
    check(&folder, &cases, "a.script", "", script);
}
