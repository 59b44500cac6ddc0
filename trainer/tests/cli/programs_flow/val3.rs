//! VAL3: data that a program changes.

use super::run;
use crate::programs::{file, folder};

/// Points, tools and frames that a program changes are left uncorrected; a comparison is not a change.
#[test]
fn data_that_a_val3_program_changes_are_left() {
    let folder = folder();
    let code = String::from_utf8_lossy(&file("part.pgx")).into_owned();
    let data = String::from_utf8_lossy(&file("part.dtx")).into_owned();
    let all = run(&folder, "part.dtx", &data, "").0;
    for (line, corrected, reason) in [
        ("if pPoint[0]==pPoint[1]", all, ""),
        (
            "pPoint[1].trsf.z=pPoint[1].trsf.z+50",
            all - 1,
            "the program changes it",
        ),
        ("pPoint[nIndex]=pPoint[0]", all - 3, "changes one of pPoint"),
        ("jPoint[1].j1=10", all - 1, "the program changes it"),
        (
            "pPoint=appro(pPoint[1],tOff)",
            all - 1,
            "the program changes it",
        ),
        ("tGun[0]=tOther", 2, "the program changes tGun"),
        // A computed key stands for every element.
        ("movel(pPoint[nIndex],tGun,mSpeed)", all, ""),
        (
            "movel(pPoint[nIndex],tOwn,mSpeed)",
            2,
            "its tool is computed",
        ),
    ] {
        folder.write(
            "part.pgx",
            code.replace("begin\n", &format!("begin\n  {line}\n"))
                .replace(
                    "    <Code>",
                    "    <Locals><Local name=\"tOwn\" type=\"tool\"/></Locals>\n    <Code>",
                ),
        );
        let command = "correct elas.blob part.dtx --payload-kg 2.5 --frames frames.toml";
        let outcome = folder.run(&format!("{command} --json - --out out.dtx"));
        let document = outcome.json();
        assert_eq!(
            document["targets"].as_u64(),
            Some(corrected),
            "{line} {document}"
        );
        assert!(
            document["left"].to_string().contains(reason),
            "{line} {document}"
        );
    }
}

/// What a program gives to another one by reference changes with the parameter, in further programs too; and instructions
/// change their arguments.
#[test]
fn parameters_of_val3_programs_change_what_they_stand_for() {
    let folder = folder();
    let code = String::from_utf8_lossy(&file("part.pgx")).into_owned();
    let data = String::from_utf8_lossy(&file("part.dtx")).into_owned();
    let all = run(&folder, "part.dtx", &data, "").0;
    let program = |name: &str, parameter: &str, line: &str| {
        let text = code.replace("\"start\"", &format!("\"{name}\"")).replace(
            "    <Code>",
            &format!("    <Parameters>{parameter}</Parameters>\n    <Code>"),
        );
        let (from, to) = (
            text.find("begin\n").unwrap() + 6,
            text.find("end\n").unwrap(),
        );
        folder.write(
            &format!("{name}.pgx"),
            format!("{}  {line}\n{}", &text[..from], &text[to..]),
        );
    };
    let by = |kind: &str, rest: &str| format!("<Parameter name=\"x_p\" type=\"{kind}\" {rest} />");
    let reference = "xsi:type=\"element\" use=\"reference\"";
    let (point, tool) = (by("pointRx", reference), by("tool", reference));
    let array = by("frame", "xsi:type=\"array\" dimensionCount=\"1\"");
    let raise = "x_p.trsf.z=x_p.trsf.z+100";
    for (line, parameter, inner, corrected, reason) in [
        (
            "call sub(pPoint[1])",
            &point,
            raise,
            all - 1,
            "the program changes it",
        ),
        (
            "call outer(pPoint[1])",
            &point,
            raise,
            all - 1,
            "the program changes it",
        ),
        (
            "call sub(tGun)",
            &tool,
            raise,
            2,
            "the program changes tGun",
        ),
        (
            "call sub(fTable)",
            &array,
            "x_p[0].trsf.z=5",
            2,
            "the program changes fTable",
        ),
        (
            "call library:sub(tGun)",
            &tool,
            "nIndex=0",
            2,
            "the program changes tGun",
        ),
        (
            "insert(pPoint,2)",
            &point,
            raise,
            all - 3,
            "changes one of pPoint",
        ),
        // Values, and what the program only reads.
        (
            "call sub(pPoint[1])",
            &by("pointRx", "xsi:type=\"element\""),
            raise,
            all,
            "",
        ),
        ("call sub(pPoint[1])", &point, "nIndex=x_p.trsf.z", all, ""),
        (
            "nIndex=distance(pPoint[0],pPoint[1])",
            &point,
            raise,
            all,
            "",
        ),
    ] {
        program("sub", parameter, inner);
        program("outer", parameter, "call sub(x_p)");
        folder.write(
            "part.pgx",
            code.replace("begin\n", &format!("begin\n  {line}\n")),
        );
        let command = "correct elas.blob part.dtx --payload-kg 2.5 --frames frames.toml";
        let document = folder
            .run(&format!("{command} --json - --out out.dtx"))
            .json();
        let targets = document["targets"].as_u64();
        assert_eq!(targets, Some(corrected), "{line} {document}");
        let left = document["left"].to_string();
        assert!(left.contains(reason), "{line} {document}");
    }
}

/// A tool of VAL3 has no weight: the file of frames states it, for a tool that the program defines, too. Joint targets without a
/// tool have none.
#[test]
fn the_weight_of_a_val3_tool_is_in_the_file_of_frames() {
    let folder = folder();
    let command = "correct elas.blob part.dtx --payload-from-program --out out.dtx --json -";
    for (name, has_weight) in [("tGun[0]", true), ("tGun", true), ("tGun[1]", false)] {
        let frames = format!(
            "[tool.\"{name}\"]\nxyz_mm = [1, 2, 3]\nquaternion = [1, 0, 0, 0]\npayload_kg = 2.5\n"
        );
        folder.write("weights.toml", frames);
        let outcome = folder.run(&format!("{command} --frames weights.toml"));
        assert_eq!(
            outcome.stdout.contains("\"payload_kg\": 2.5"),
            has_weight,
            "{name}: {outcome:#?}"
        );
    }
}
