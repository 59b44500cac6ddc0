//! RAPID: external axes, whole tools and work objects that the code assigns, unknown instructions, data of several modules.

use super::rapid::module;
use super::{check, run};
use crate::programs::{file, folder, numbers_after};

const GO: &str = "MoveL p10,v200,fine,gun\\WObj:=table;";
const NONE: &str = "9E9,9E9,9E9,9E9,9E9,9E9";

/// A pose with 9E9 for an axis that something moves is somewhere else; joints are not.
#[test]
fn a_rail_that_is_not_at_zero_leaves_poses_without_it() {
    let folder = folder();
    let joints = |axes: &str| format!("[[8,22,1,-14,46,24],[{axes}]]");
    let rail = NONE.replacen("9E9", "500", 1);
    let reason = "its external axes are 9E9, so the controller leaves them where a.mod:8 puts them";
    let cases = [
        (
            format!("MoveAbsJ {},v200,fine,gun;\n{GO}", joints(&rail)),
            1,
            reason,
        ),
        (
            format!("MoveExtJ {},vrot10,fine;\n{GO}", joints(&rail)),
            1,
            reason,
        ),
        (format!("MoveExtJ there,vrot10,fine;\n{GO}"), 1, reason),
        (format!("p20.extax.eax_a:=500;\n{GO}"), 1, reason),
        (format!("p20.extax.eax_a:=n;\n{GO}"), 1, reason),
        (format!("p20.extax.eax_a:=0;\n{GO}"), 2, ""),
        (format!("EOffsSet [500,0,0,0,0,0];\n{GO}"), 1, reason),
        (
            format!("IndAMove STN1,1\\ToAbsNum:=90,20;\n{GO}"),
            1,
            reason,
        ),
        (
            format!(
                "MoveExtJ {},vrot10,fine;\n{GO}",
                joints(&rail.replace("500", "0"))
            ),
            2,
            "MoveExtJ is not corrected",
        ),
        (
            format!("MoveAbsJ {},v200,fine,gun;\n{GO}", joints(NONE)),
            3,
            "",
        ),
    ];
    check(&folder, &cases, "a.mod", "", module);
}

/// A tool that is assigned as a whole is the other one, if that one never changes.
#[test]
fn whole_tools_and_work_objects_are_followed() {
    let folder = folder();
    let x = |part: &str, rest: &str| {
        let data = "PERS tooldata cur:=[TRUE,[[30,-45,250],[0.97629601,0.21643961,0,0]],[4,[0,0,15],[1,0,0,0],0,0,0]];\n\
            PERS wobjdata w:=[FALSE,TRUE,\"\",[[905,-300,420],[0.98480775,0,0,0.17364818]],[[0,0,0],[1,0,0,0]]];";
        let text = module(part).replacen("MODULE M", &format!("MODULE M\n{data}"), 1);
        let (_, left) = run(&folder, "a.mod", &text, rest);
        match left.is_empty() {
            true => numbers_after(&folder.read("out_a.mod"), "p10:=", 7),
            false => panic!("{part}\n{left}"),
        }
    };
    let go = |tool: &str, object: &str| format!("MoveL p10,v200,fine,{tool}\\WObj:={object};");
    let of_program = "--payload-from-program";
    let plain = x(&go("gun", "table"), of_program);
    let (cur, other) = (
        x(&go("cur", "table"), of_program),
        x(&go("gun", "w"), of_program),
    );
    assert!(cur != plain && other != plain);
    let written =
        "[TRUE,[[30,-45,210],[0.97629601,0.21643961,0,0]],[2.5,[0,0,15],[1,0,0,0],0,0,0]]";
    for (part, expected) in [
        (format!("cur:=gun;\n{}", go("cur", "table")), &plain),
        (format!("cur:={written};\n{}", go("cur", "table")), &plain),
        (format!("w:=table;\n{}", go("gun", "w")), &plain),
        (format!("table:=w;\n{}", go("gun", "table")), &other),
    ] {
        assert_eq!(x(&part, of_program), *expected, "{part}");
    }
    let cases = [
        (
            "gun:=other;\nMoveL p10,v200,fine,gun\\WObj:=table;",
            1,
            "tool gun: it is changed at a.mod:8",
        ),
        (
            "table:=wobj0;\ntable:=table;\nMoveL p10,v200,fine,gun\\WObj:=table;",
            1,
            "it is changed at a.mod:9",
        ),
    ];
    check(&folder, &cases[..], "a.mod", "", module);
}

/// An instruction in none of the files leaves the targets behind it, and no others; force control changes no tool.
#[test]
fn unknown_instructions_are_named() {
    let folder = folder();
    let at = |line: &str| format!("MoveJ p10,v200,fine,gun\\WObj:=table;\n{line}\n");
    for rest in ["--payload-kg 2.5", "--payload-from-program"] {
        let cases = [
            (at("FCPressL p10,v10,50,fine,gun\\WObj:=table;"), 2, ""),
            (at("EGMMoveL egm1,p10,v10,fine,gun\\WObj:=table;"), 2, ""),
        ];
        check(&folder, &cases, "a.mod", rest, module);
    }
    let go = "MyWeld 5,gun;\nMoveL p10,v200,fine,gun\\WObj:=table;";
    check(
        &folder,
        &[(go, 1, "tool gun: it may be changed at a.mod:8")],
        "a.mod",
        "",
        module,
    );
    folder.write("a.mod", module(&at("MyWeld p10,gun;")));
    let command = "correct elas.blob a.mod --json - --out out.mod";
    let outcome = folder.run(&format!("{command} --payload-from-program"));
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let said = outcome.stdout;
    let path = "it is set at a.mod:9, but not on every path to this move";
    assert!(said.contains(&format!("tool gun: {path}")), "{said}");
    let payload = format!("cannot be determined from the program: {path}");
    assert!(said.contains(&payload), "{said}");
    let note =
        "a.mod:9: routines in none of the files: MyWeld: it is assumed that they set no tool";
    assert!(said.contains(note), "{said}");
    assert!(folder.read("out.mod") == folder.read("a.mod"));
}

/// Tools that two modules of the controller declare differently are none.
#[test]
fn modules_that_contradict_each_other_are_refused() {
    let folder = folder();
    let text = module(GO);
    let line = text
        .lines()
        .find(|line| line.contains("tooldata gun"))
        .unwrap()
        .trim();
    let task = |name: &str, line: &str| {
        let text = format!("MODULE X(SYSMODULE)\n{line}\nENDMODULE\n");
        folder.write(name, text);
    };
    folder.write("a.mod", text.replace(line, ""));
    task("one.sys", line);
    task("same.sys", line);
    task("two.sys", &line.replace("30,-45,210", "30,-45,260"));
    let command = "correct elas.blob a.mod --payload-kg 2.5 --out out.mod --with one.sys --with";
    let outcome = folder.run(&format!("{command} two.sys"));
    assert_eq!(outcome.code, Some(2), "{outcome:#?}");
    assert!(
        outcome
            .stderr
            .contains("two.sys:2: column 1: found another gun than at one.sys:2"),
        "{outcome:#?}"
    );
    let outcome = folder.run(&format!("{command} same.sys")).ok();
    assert!(
        outcome.stdout.contains("Tool gun: from one.sys"),
        "{outcome:#?}"
    );
    // The values of the program take precedence.
    folder.write("a.mod", file("part.mod"));
    let outcome = folder.run(&format!("{command} two.sys"));
    assert!(
        outcome.stdout.contains("Tool gun: from the program"),
        "{outcome:#?}"
    );
}
