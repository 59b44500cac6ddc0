//! `trainer correct --split`: targets inserted on lines keep the real tool on the line, and removing them gives back the
//! program. Nothing is inserted where it is not certain how the arm reaches the start of a line.

use poegp_runtime::math::se3::{Pose, Twist};

use crate::program::Folder;
use crate::programs::{commander, file, folder, numbers_after, pose, skeleton};

/// Returns the program with three consecutive lines in place of the arc and the loop.
fn lines() -> String {
    let text = String::from_utf8_lossy(&file("part.mod")).into_owned();
    let (start, end) = (
        text.find("      MoveC").unwrap(),
        text.find("ENDFOR").unwrap() + 8,
    );
    let lines = "      MoveL row{1},v200,z1,gun\\WObj:=table;\r\n\t SetDO do1,1; MoveL row{2},v200,fine,gun\\WObj:=table;\r\n";
    format!("{}{lines}{}", &text[..start], &text[end..])
}

/// Returns the places in a file where instructions were inserted, according to its record.
fn inserted(folder: &Folder, name: &str) -> Vec<(usize, usize)> {
    let record = folder.json(&format!("{name}.poegp.json"));
    let all = record["inserted"].as_array().cloned().unwrap_or_default();
    let number = |n: &serde_json::Value| n.as_u64().unwrap() as usize;
    all.iter().map(|s| (number(&s[0]), number(&s[1]))).collect()
}

/// Returns the pose at a share of the way between two poses.
fn on_line(a: &Pose<f64>, b: &Pose<f64>, share: f64) -> Pose<f64> {
    let turned = (a.inverse() * *b).log().angular * share;
    let turn = Pose::exp(&Twist {
        linear: turned * 0.0,
        angular: turned,
    });
    Pose {
        rotation: a.rotation * turn.rotation,
        translation: a.translation + (b.translation - a.translation) * share,
    }
}

/// Returns the largest distance of the real tool from the wanted line while the controller moves straight between the
/// written poses.
fn largest(folder: &Folder, wanted: [&Pose<f64>; 2], written: &[Pose<f64>]) -> f64 {
    let commander = commander(folder, "elas.blob");
    let tool = pose(&numbers_after(&file("part.mod"), "gun:=[TRUE,", 7));
    let mut near = [0.0; 8];
    for (q, degrees) in near
        .iter_mut()
        .zip(numbers_after(&file("part.mod"), "home:=", 6))
    {
        *q = degrees.to_radians();
    }
    let (mut largest, pieces) = (0.0_f64, written.len() - 1);
    for (piece, pair) in written.windows(2).enumerate() {
        for k in 0..=40 {
            let share = f64::from(k) / 40.0;
            let flange = on_line(&pair[0], &pair[1], share) * tool.inverse();
            near = commander.nominal_joints(&flange, &near).joints;
            let real = commander.real_flange(&near, 2.5) * tool;
            let along = (piece as f64 + share) / pieces as f64;
            let off = real.translation - on_line(wanted[0], wanted[1], along).translation;
            largest = largest.max(off.norm());
        }
    }
    largest
}

#[test]
fn inserted_targets_keep_the_real_tool_on_its_line() {
    let folder = folder();
    folder.write("lines.mod", lines());
    let run = |rest: &str, out: &str| {
        folder
            .run(&format!(
                "correct elas.blob lines.mod --payload-kg 2.5 --json - {rest} --out {out}"
            ))
            .ok()
            .json()
    };
    let plain = run("", "plain.mod");
    let document = run("--split 0.02 --report split.html", "split.mod");
    assert_eq!(document["numbers"], plain["numbers"]);
    let worst = |d: &serde_json::Value| d["between"]["largest_mm"].as_f64().unwrap();
    assert!(
        worst(&plain) > 0.04 && worst(&document) <= 0.02,
        "{plain} {document}"
    );
    let spans = inserted(&folder, "split.mod");
    assert_eq!(
        spans.len(),
        document["split"]["lines"].as_u64().unwrap() as usize
    );
    let (split, plain) = (folder.read("split.mod"), folder.read("plain.mod"));
    let text = |span: &(usize, usize)| String::from_utf8_lossy(&split[span.0..span.1]).into_owned();
    let count: usize = spans
        .iter()
        .map(|s| text(s).matches("MoveL [[").count())
        .sum();
    assert_eq!(
        count,
        document["split"]["targets"].as_u64().unwrap() as usize
    );
    assert!(count >= 2, "{document}");
    // An inserted target has its own line and indentation, or a blank if it is within a line.
    assert!(text(&spans[0]).ends_with(",v200,z1,gun\\WObj:=table;\r\n      "));
    assert!(text(spans.last().unwrap()).ends_with(",v200,z1,gun\\WObj:=table; "));

    // Recomputed without the program: the arm on the lines between the written targets.
    let of = |bytes: &[u8], start: &str| {
        let base = pose(&numbers_after(&file("part.mod"), "TRUE,\"\",", 7));
        base * pose(&numbers_after(bytes, start, 7))
    };
    let original = file("part.mod");
    for (from, to, span) in [("p10:=", "row{2}:=", 0), ("row{2}:=", "\t\t", 1)] {
        let wanted = [of(&original, from), of(&original, to)];
        let ends = [of(&split, from), of(&split, to)];
        let inner = text(&spans[spans.len() - 2 + span]);
        let starts = inner.match_indices("MoveL [[");
        let mut written = vec![ends[0]];
        written.extend(starts.map(|(at, _)| of(&inner.as_bytes()[at..], "MoveL ")));
        written.push(ends[1]);
        let before = largest(&folder, [&wanted[0], &wanted[1]], &ends);
        let after = largest(&folder, [&wanted[0], &wanted[1]], &written);
        assert!(
            before > 3e-5 && after < 2.2e-5,
            "{from}: {before:e} {after:e}"
        );
    }

    // Without the insertions it is the program that was not split. With a tolerance that all lines meet, none is split.
    let mut rest = split.clone();
    for (start, end) in spans.iter().rev() {
        rest.drain(*start..*end);
    }
    assert!(rest == plain);
    assert_eq!(run("--split 0.5", "wide.mod")["split"]["lines"], 0);
    assert!(folder.read("wide.mod") == plain);
    assert!(inserted(&folder, "wide.mod").is_empty());
}

/// A time of 0 counts as no time; any other time belongs to the whole line, which is not split.
#[test]
fn a_line_with_a_time_of_its_own_is_not_split() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.script")).into_owned();
    let own = ", a=1.2, v=0.25, r=0.001)";
    assert_eq!(text.matches(own).count(), 1);
    for (arguments, targets) in [
        (",1.2,0.25,0,0.001)", 1),
        (",1.2,0.25,5)", 0),
        (", t=5)", 0),
    ] {
        folder.write("a.script", text.replace(own, arguments));
        let line =
            "correct elas.blob a.script --payload-kg 2.5 --split 0.01 --json - --out b.script";
        let document = folder.run(line).json();
        assert_eq!(
            document["split"]["targets"], targets,
            "{arguments}: {document}"
        );
    }
}

/// Where the line ends in a stop, the copies pass.
#[test]
fn inserted_targets_of_a_script_do_not_stop() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.script")).into_owned();
    let own = ", a=1.2, v=0.25, r=0.001)";
    for (arguments, of_copy) in [
        (", a=1.2, v=0.25)", ", a=1.2, v=0.25, r=0.001)"),
        (", a=1.2, v=0.25, r=0)", ", a=1.2, v=0.25, r=0.001)"),
        (",1.2,0.25)", ",1.2,0.25, r=0.001)"),
        (",1.2,0.25,0,0)", ",1.2,0.25,0,0.001)"),
        (", a=1.2, v=0.25, r=0.02)", ", a=1.2, v=0.25, r=0.02)"),
    ] {
        folder.write("a.script", text.replace(own, arguments));
        let line = "correct elas.blob a.script --payload-kg 2.5 --split 0.01 --out b.script";
        assert_eq!(folder.run(line).code, Some(1), "the arc is left");
        let split = folder.text("b.script");
        let spans = inserted(&folder, "b.script");
        assert_eq!(spans.len(), 1);
        let (start, end) = spans[0];
        let copy = split[start..end].trim_end();
        assert!(copy.ends_with(of_copy), "{arguments}: {copy}");
        assert!(split[end..].contains(arguments), "{arguments}: {split}");
    }
}

/// In three languages, `--inverse` gives the program back; a model that corrects nothing inserts nothing.
#[test]
fn a_split_program_comes_back() {
    let folder = folder();
    for name in ["same", "out", "back"] {
        std::fs::create_dir(folder.path(name)).unwrap();
    }
    folder.write("lines.mod", lines());
    for name in ["lines.mod", "part.src", "part.script"] {
        let original = folder.read(name);
        let outcome = folder.run(&format!(
            "correct elas.blob {name} --payload-kg 2.5 --split 0.01 --json - --out out/{name}"
        ));
        // The arcs are left.
        assert_eq!(
            outcome.code,
            Some(i32::from(name != "lines.mod")),
            "{outcome:#?}"
        );
        let document = outcome.json();
        assert!(
            document["split"]["targets"].as_u64().unwrap() >= 1,
            "{document}"
        );
        let left = document["left"].as_array().unwrap();
        assert_eq!(left.len(), usize::from(name != "lines.mod"), "{document}");
        let rest = "--payload-kg 2.5 --inverse";
        let line = format!("correct elas.blob out/{name} {rest} --out back/{name}");
        folder.run(&line).ok();
        let back = folder.read(&format!("back/{name}"));
        assert!(skeleton(&original).1 == skeleton(&back).1, "{name}");
        for (a, b) in skeleton(&original).0.iter().zip(&skeleton(&back).0) {
            assert!((a - b).abs() < 2.1e-3, "{name}: {a} {b}");
        }
        let line =
            format!("correct base.blob {name} --payload-kg 2.5 --split 0.01 --out same/{name}");
        folder.run(&line).ok();
        assert!(folder.read(&format!("same/{name}")) == original, "{name}");
    }
}

/// Lines after a condition, a call, a label or an unknown instruction, with a time of their own, with a trigger, or to a
/// computed or missing element of an array: each is named, and none gets inserted targets.
#[test]
fn lines_whose_start_is_not_certain_are_named() {
    let folder = folder();
    let go = |rest: &str| lines().replace("      MoveL row{1},v200,z1,gun\\WObj:=table;", rest);
    let to = "MoveL row{1},v200,z1,gun\\WObj:=table;";
    for (number, middle) in [
        format!("IF di1=1 THEN\n MoveL p10,v200,z1,gun\\WObj:=table;\n ENDIF\n {to}"),
        format!("WHILE TRUE DO\n {to}\n ENDWHILE"),
        format!("pick;\n {to}"),
        format!("again:\n {to}"),
        "MoveL row{1},v200\\T:=5,z1,gun\\WObj:=table;".to_owned(),
        "TriggL row{1},v200,trigger,z1,gun\\WObj:=table;".to_owned(),
        "MoveLDO row{1},v200,z1,gun\\WObj:=table,do1,1;".to_owned(),
        "MoveL row{reg1},v200,z1,gun\\WObj:=table;".to_owned(),
        "MoveL row{0},v200,z1,gun\\WObj:=table;".to_owned(),
        "MoveL row{1.9},v200,z1,gun\\WObj:=table;".to_owned(),
        format!("MoveL Offs(p10,0,0,9),v200,z1,gun\\WObj:=table;\n {to}"),
    ]
    .iter()
    .enumerate()
    {
        let name = format!("case{number}.mod");
        folder.write(&name, go(middle));
        let outcome = folder.run(&format!(
            "correct elas.blob {name} --payload-kg 2.5 --split 0.02 --json - --out out_{name}"
        ));
        assert_eq!(outcome.code, Some(1), "{middle}: {outcome:#?}");
        let written = folder.read(&format!("out_{name}"));
        for (start, end) in inserted(&folder, &format!("out_{name}")) {
            let text = String::from_utf8_lossy(&written[start..end]).into_owned();
            // Only the lines before and after it are split.
            assert!(
                text.ends_with("table; ") || text.contains("[0,-1,0,0]"),
                "{middle}: {text}"
            );
            assert!(
                !written[end..].starts_with(b"MoveL row{1}"),
                "{middle}: {text}"
            );
        }
        let reasons = outcome.json()["left"].to_string();
        let known = ["no target can be inserted", "computed", "does not exist"];
        let is_named = known.iter().any(|reason| reasons.contains(reason));
        assert!(is_named, "{middle}: {reasons}");
    }
}

/// Where a line of KRL ends in a stop, the inserted ones pass. They stand before the inline form, with what prepares them.
#[test]
fn inserted_lines_of_krl_pass_outside_the_inline_form() {
    let folder = folder();
    let to = "{X 712.804,Y 226.655,Z 475.801,A 151.7021,B 21.9799,C -150.8560}";
    let preparing = "$BWDSTART=FALSE\n LDAT_ACT=LCPDAT2\n BAS(#VEL_CP,2)\n ";
    let form =
        |motion: &str| format!(";FOLD LIN P2 Vel=2 m/s;%{{PE}}\n {preparing}{motion}\n;ENDFOLD");
    for (seam, before, ending, behind) in [
        (
            form(&format!("LIN {to}")),
            "$BWDSTART=FALSE\nLDAT_ACT=LCPDAT2\nBAS(#VEL_CP,2)\nLIN {",
            "} C_DIS\n",
            ";FOLD LIN P2",
        ),
        (
            form(&format!("LIN {to} C_DIS")),
            "$BWDSTART=FALSE\nLDAT_ACT=LCPDAT2\nBAS(#VEL_CP,2)\nLIN {",
            "} C_DIS\n",
            ";FOLD LIN P2",
        ),
        (
            format!(
                ";FOLD SLIN P2;%{{PE}}\n;FOLD Parameters;%{{h}}\n;x\n;ENDFOLD\nSLIN {to} WITH $APO=SAPO(A)\n;ENDFOLD"
            ),
            "SLIN {",
            "} WITH $APO=SAPO(A) C_SPL\n",
            ";FOLD SLIN P2",
        ),
        (
            format!(";FOLD seam\n$VEL.CP=1\n  LIN {to}\n;ENDFOLD"),
            "LIN {",
            "} C_DIS\n  ",
            "LIN {",
        ),
    ] {
        let text = format!(
            "DEF A( )\n$TOOL={{X 30,Y -45,Z 210,A 0,B 0,C 25}}\n$BASE={{X 900,Y -300,Z 420,A 20,B 0,C 0}}\n\
             PTP {{A1 12.5,A2 20.25,A3 -4.125,A4 -18.5,A5 48,A6 31.75}}\n\
             LIN {{X 701.088,Y 449.848,Z 513.922,A 178.5291,B 23.3121,C -159.0124}}\n{seam}\nEND\n"
        );
        folder.write("a.src", &text);
        let line = "correct elas.blob a.src --payload-kg 2.5 --split 0.02 --out b.src";
        folder.run(line).ok();
        let split = folder.read("b.src");
        let (start, end) = *inserted(&folder, "b.src").last().unwrap();
        let text = String::from_utf8_lossy(&split[start..end]).into_owned();
        assert!(
            text.starts_with(before) && text.ends_with(ending),
            "{seam}\n{text}"
        );
        assert_eq!(
            text.matches(ending.trim()).count(),
            text.matches("LIN {").count(),
            "{text}"
        );
        assert!(
            split[end..].starts_with(behind.as_bytes()),
            "{seam}\n{text}"
        );
        let line = "correct elas.blob b.src --payload-kg 2.5 --inverse --out c.src";
        folder.run(line).ok();
        let back = folder.read("c.src");
        assert!(
            skeleton(&back).1 == skeleton(&folder.read("a.src")).1,
            "{seam}"
        );
    }
}
