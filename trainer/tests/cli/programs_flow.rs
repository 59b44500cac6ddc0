//! `trainer correct` of robot programs: a target is corrected only if tool, frame, payload, displacement and the target itself
//! are certain on every path through the program.

use serde_json::Value;

use crate::program::Folder;
use crate::programs::{file, folder, numbers_after};

/// Corrects a program. Returns the number of corrected targets, and the reasons for those that are left.
fn run(folder: &Folder, name: &str, text: &str, rest: &str) -> (u64, String) {
    folder.write(name, text);
    let rest = if rest.is_empty() {
        "--payload-kg 2.5"
    } else {
        rest
    };
    let line =
        format!("correct elas.blob {name} --frames frames.toml {rest} --json - --out out_{name}");
    let outcome = folder.run(&line);
    assert!(matches!(outcome.code, Some(0 | 1)), "{text}\n{outcome:#?}");
    let document = outcome.json();
    let reason = |left: &Value| left.to_string();
    let left: Vec<String> = document["left"]
        .as_array()
        .unwrap()
        .iter()
        .map(reason)
        .collect();
    (document["targets"].as_u64().unwrap(), left.join("\n"))
}

fn check(
    folder: &Folder,
    cases: &[(impl AsRef<str>, u64, &str)],
    name: &str,
    rest: &str,
    whole: impl Fn(&str) -> String,
) {
    for (part, corrected, reason) in cases {
        let part = part.as_ref();
        let (targets, left) = run(folder, name, &whole(part), rest);
        assert_eq!(targets, *corrected, "{part}\n{left}");
        match reason.is_empty() {
            true => assert_eq!(left, "", "{part}"),
            false => assert!(left.contains(reason), "{part}\n{left}"),
        }
    }
}

/// Returns a module with two points, two tools and a work object; `part` has the statements and routines that follow
/// `main`.
fn module(part: &str) -> String {
    let text = String::from_utf8_lossy(&file("part.mod")).replace("\r\n", "\n");
    let line = |start: &str| text.lines().find(|line| line.contains(start)).unwrap();
    let data = [
        "tooldata gun",
        "wobjdata table",
        "jointtarget home",
        "robtarget p10",
    ]
    .map(line)
    .join("\n");
    let data = data.replace("CONST robtarget", "PERS robtarget");
    let (main, rest) = part.split_once("PROC").unwrap_or((part, ""));
    let routines = if rest.is_empty() {
        String::new()
    } else {
        format!("PROC{rest}")
    };
    format!(
        "MODULE M\n{data}\nPROC main()\nMoveAbsJ home,v200,fine,gun;\n{main}\nENDPROC\n{routines}\nENDMODULE\n"
    )
}

/// The point `row{1}` of `part.mod`.
const POINT_OF_ABB: &str = "[[701.088,449.848,513.922],[0.19635102,0.04915473,0.96244594,-0.18090853],[0,0,-1,0],\
    [9E9,9E9,9E9,9E9,9E9,9E9]]";

#[test]
fn modules_are_followed_on_every_way() {
    let folder = folder();
    let (go, same) = (
        "MoveL p10,v200,fine,gun\\WObj:=table;",
        "[[900,-300,420],[0.98480775,0,0,0.17364818]]",
    );
    let weld = format!("PROC Weld()\n{go}\nENDPROC");
    let set = |value: &str| format!("PROC MoveB()\ntable.uframe:={value};\nENDPROC");
    let cases = [
        (go.to_owned(), 2, ""),
        // Displacements also apply in called routines, and end with PDispOff.
        (
            format!("PDispSet [[0,9,0],[1,0,0,0]];\nWeld;\nPDispOff;\n{weld}"),
            1,
            "a program displacement is active",
        ),
        (
            format!("PDispSet [[0,9,0],[1,0,0,0]];\nPDispOff;\nWeld;\n{weld}"),
            2,
            "",
        ),
        (
            format!("IF a PDispSet [[0,9,0],[1,0,0,0]];\n{go}"),
            1,
            "may be active",
        ),
        (
            format!("IF a AND b(1) p10:=Offs(p10,0,0,5);\n{go}"),
            1,
            "the program changes it",
        ),
        // Conditions, loops, jumps and calls.
        (
            format!("IF a=1 table.uframe:=[[1,2,3],[1,0,0,0]];\n{go}"),
            1,
            "not on every way",
        ),
        (
            format!("IF a THEN\ntable.uframe:={same};\nELSE\ntable.uframe:={same};\nENDIF\n{go}"),
            2,
            "",
        ),
        (
            format!("WHILE TRUE DO\n{go}\ntable.uframe:=[[1,2,3],[1,0,0,0]];\nENDWHILE"),
            1,
            "not on every way",
        ),
        (
            format!("WHILE TRUE DO\n{go}\ntable.uframe:={same};\nENDWHILE"),
            2,
            "",
        ),
        (
            format!("again:\n{go}\ntable.uframe:=[[1,2,3],[1,0,0,0]];\nGOTO again;"),
            1,
            "not on every way",
        ),
        (format!("MoveB;\n{go}\n{}", set(same)), 2, ""),
        (
            format!("table.uframe:={same};\nMoveB;\n{go}\n{}", set("Calc()")),
            1,
            "it is changed at",
        ),
        (
            format!("{go}\nERROR\ntable.uframe:=[[1,2,3],[1,0,0,0]];\nRETRY;"),
            1,
            "not on every way",
        ),
        (
            format!(
                "Put table;\n{go}\nPROC Put(PERS wobjdata w)\nw.uframe:=[[1,2,3],[1,0,0,0]];\nENDPROC"
            ),
            1,
            "it is changed at",
        ),
        (
            "Go p10;\nPROC Go(robtarget p10)\nMoveL p10,v200,fine,gun\\WObj:=table;\nENDPROC"
                .to_owned(),
            1,
            "p10",
        ),
        // A point that both a certain move and a move with an uncertain frame use.
        (
            format!("{go}\nPDispOn p10,gun;\n{go}\nPDispOff;"),
            1,
            "and is left as it is",
        ),
        // The same with an optional argument, whose mark is that of an assignment.
        (
            format!(
                "Put table\\Far:=5;\n{go}\nPROC Put(PERS wobjdata w\\num Far)\nw.uframe:=[[1,2,3],[1,0,0,0]];\nENDPROC"
            ),
            1,
            "it is changed at",
        ),
        (
            format!(
                "VAR robtarget sp;\n{go}\nSearchL \\Stop,di1,sp,p10,v5,gun\\WObj:=table;\nMoveL sp,v5,fine,gun;"
            ),
            2,
            "its target sp is computed",
        ),
        (
            format!("{go}\nSearchL \\Stop,di1,sp,{POINT_OF_ABB},v5,gun\\WObj:=table;"),
            2,
            "an instruction that is not corrected",
        ),
        // Joints need no frame; and welding moves like any other.
        (format!("{go}\nMoveAbsJ home,v200,fine,tool0;"), 2, ""),
        (
            "ArcLStart p10,v200,seam1,weld1\\Weave:=weave1,fine,gun\\WObj:=table;".to_owned(),
            2,
            "",
        ),
        (
            "ArcLEnd p10,v200,seam1,weld1,fine,gun\\WObj:=table\\Track:=track1;".to_owned(),
            1,
            "a sensor corrects its path",
        ),
        // An element of a list that is left has its place in the list.
        (
            format!(
                "VAR robtarget row{{3}}:=[{POINT_OF_ABB},{},{POINT_OF_ABB}];\nMoveL row{{3}},v5,fine,gun\\WObj:=table;\n\
                 MoveL row{{2}},v5,fine,gun;",
                POINT_OF_ABB.replacen("[9E9,", "[100,", 1)
            ),
            2,
            "it has external axes",
        ),
        // A call of the program's own routine and an instruction that defines a trigger are no motions.
        (
            format!("TriggEquip on,10,0.1\\DOp:=do1,1;\nMoveHome;\n{go}\nPROC MoveHome()\nENDPROC"),
            2,
            "",
        ),
    ];
    check(&folder, &cases, "a.mod", "", module);
}

/// The program changes a tool of the frame file like one of its own.
#[test]
fn the_values_of_the_frame_file_do_not_outlast_those_of_the_program() {
    let folder = folder();
    let gun = "[tool.gun]\nxyz_mm = [30, -45, 210]\nquaternion = [0.97629601, 0.21643961, 0, 0]\n";
    folder.write("gun.toml", gun);
    let go = "MoveL p10,v200,fine,gun\\WObj:=table;";
    let text = module(&format!("{go}\ngun:=Measured();"));
    let line = text.lines().find(|line| line.contains("tooldata")).unwrap();
    folder.write("a.mod", text.replace(line, ""));
    let line = "correct elas.blob a.mod --payload-kg 2.5 --frames gun.toml --json - --out out.mod";
    let outcome = folder.run(line);
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert_eq!(outcome.json()["targets"].as_u64(), Some(1));
    assert!(outcome.stdout.contains("it is changed at"), "{outcome:#?}");
}

/// Data that a module declares as local belong to that module only.
#[test]
fn local_data_are_of_their_module() {
    let folder = folder();
    let text = module("MoveL p10,v200,fine,gun\\WObj:=table;");
    let gun = text.lines().find(|line| line.contains("tooldata")).unwrap();
    folder.write("a.mod", text.replace(gun, ""));
    folder.write("b.mod", format!("MODULE B\n{gun}\nENDMODULE\n"));
    folder.write(
        "c.mod",
        format!(
            "MODULE C\nLOCAL {}\nENDMODULE\n",
            gun.trim().replace("210", "610")
        ),
    );
    let run = |with: &str| {
        let line = format!(
            "correct elas.blob a.mod --payload-kg 2.5 {with} --out out{}.mod",
            with.len()
        );
        folder.run(&line).ok();
        folder.read(&format!("out{}.mod", with.len()))
    };
    assert!(run("--with c.mod --with b.mod") == run("--with b.mod"));
}

/// Returns a source of two routines, with the tools and bases of `part.src`.
fn source(part: &str) -> String {
    let (main, rest) = part.split_once("DEF ").unwrap_or((part, "OTHER( )"));
    format!(
        "DEF A( )\nTOOL_DATA[3]={{X 30,Y -45,Z 210,A 0,B 0,C 25}}\nBASE_DATA[2]={{X 900,Y -300,Z 420,A 20,B 0,C 0}}\n\
         BASE_DATA[5]={{X 905,Y -300,Z 420,A 20,B 0,C 0}}\n$TOOL=TOOL_DATA[3]\n$BASE=BASE_DATA[2]\n\
         PTP {{A1 8,A2 22,A3 1,A4 -14,A5 46,A6 24}}\n{main}\nEND\nDEF {rest}\nEND\n"
    )
}

#[test]
fn sources_are_followed_on_every_way() {
    let folder = folder();
    let go = "LIN {X 701.088,Y 449.848,Z 513.922,A 178.5291,B 23.3121,C -159.0124}";
    let cases = [
        (go.to_owned(), 2, ""),
        (format!("BAS(#BASE,i)\n{go}"), 1, "computed"),
        (format!("BAS(#TOOL,i+3)\n{go}"), 1, "computed"),
        (
            format!("IF i==1 THEN\n$BASE=BASE_DATA[5]\nELSE\n$BASE=BASE_DATA[2]\nENDIF\n{go}"),
            1,
            "not on every way",
        ),
        (
            format!("IF i==1 THEN\n$BASE=BASE_DATA[5]\nELSE\n$BASE=BASE_DATA[5]\nENDIF\n{go}"),
            2,
            "",
        ),
        (
            format!("SWITCH i\nCASE 1\n$BASE=BASE_DATA[5]\nENDSWITCH\n{go}"),
            1,
            "not on every way",
        ),
        (
            format!("LOOP\n{go}\n$BASE=BASE_DATA[5]\nENDLOOP"),
            1,
            "not on every way",
        ),
        (
            format!("PUT( )\n{go}\nDEF PUT( )\n$BASE=BASE_DATA[5]"),
            2,
            "",
        ),
        (
            format!("PUT(5)\n{go}\nDEF PUT(i:IN)\nIF i==5 THEN\n$BASE=BASE_DATA[5]\nENDIF"),
            1,
            "not on every way",
        ),
        (
            format!("INTERRUPT DECL 3 WHEN $IN[1] DO PUT( )\n{go}\nDEF PUT( )\n$BASE=BASE_DATA[5]"),
            1,
            "not on every way",
        ),
        (
            format!("IF i==1 THEN\nBASE_DATA[2]={{X 1,Y 0,Z 0,A 0,B 0,C 0}}\nENDIF\n{go}"),
            1,
            "not on every way",
        ),
        (format!("{go} WITH $BASE=BASE_DATA[i]"), 1, "computed"),
        (format!("PTP $AXIS_ACT\n{go}:{{Z 5}}"), 1, "computed"),
        (format!("LIN $POS_ACT:{{Z 5}}\n{go}"), 2, "computed"),
        (
            format!("BAS(#INITMOV,0)\n{go}"),
            1,
            "BAS(#INITMOV) may reset $",
        ),
        (
            format!("BAS(#INITMOV,0)\n$BASE=BASE_DATA[2]\n$TOOL=TOOL_DATA[3]\n{go}"),
            2,
            "",
        ),
        (
            format!("FDAT_ACT={{TOOL_NO -1,BASE_NO 2,IPO_FRAME #BASE}}\n{go}"),
            1,
            "there is no tool or base -1",
        ),
        // A base by its name.
        (
            format!("DECL FRAME own={{X 900,Y -300,Z 420,A 20,B 0,C 0}}\n$BASE=own\n{go}"),
            2,
            "",
        ),
        (
            format!("DECL FRAME own={{X 900,Y -300,Z 420,A 20,B 0,C 0}}\nown.Z=5\n$BASE=own\n{go}"),
            1,
            "computed",
        ),
        (
            "$BASE=$WORLD\nLIN {X 1404.950,Y 362.505,Z 933.922,A -161.4709,B 23.3121,C -159.0124}"
                .to_owned(),
            2,
            "",
        ),
        // A point that a routine of the program changes for its caller, and points of a spline.
        (
            format!(
                "DECL E6POS XP1={{{}\nLIN XP1\nLIFT(XP1)\nDEF LIFT(P:OUT)\nP.Z=5",
                &go[5..]
            ),
            1,
            "the program changes it",
        ),
        (
            format!("SPLINE\nS{}\nENDSPLINE", go.replace("LIN", "PL")),
            2,
            "",
        ),
    ];
    check(&folder, &cases, "a.src", "", source);
    // The base of one motion does not apply to another.
    let x = |part: &str| {
        run(&folder, "b.src", &source(part), "");
        numbers_after(&folder.read("out_b.src"), "LIN {X ", 1)[0]
    };
    let own = x(&format!("S{go} WITH $BASE=BASE_DATA[5]\n"));
    assert_eq!(own, x(&format!("$BASE=BASE_DATA[5]\n{go}")));
    assert_ne!(own, x(go));
    assert_eq!(
        x(&format!("PTP $AXIS_ACT WITH $BASE=BASE_DATA[5]\n{go}")),
        x(go)
    );
}

/// Each module uses the points and frames of its own data list.
#[test]
fn modules_of_krl_have_their_own_points() {
    let folder = folder();
    let list = String::from_utf8_lossy(&file("part.dat")).into_owned();
    let other = list
        .replace("X 712.804", "X 702.804")
        .replace("BASE_NO 2", "BASE_NO 5");
    let bases = "BASE_DATA[5]={X 890,Y -300,Z 420,A 20,B 0,C 0}\nBASE_DATA[2]";
    let text = String::from_utf8_lossy(&file("part.src")).replace("BASE_DATA[2]", bases);
    folder.write("one.src", &text);
    folder.write("one.dat", &list);
    folder.write("two.src", text.replace("PART", "TWO"));
    folder.write("two.dat", other);
    for out in ["both", "one", "two"] {
        std::fs::create_dir(folder.path(out)).unwrap();
    }
    let run = |files: &str, out: &str| {
        folder
            .run(&format!(
                "correct elas.blob {files} --payload-kg 2.5 --out {out}"
            ))
            .ok()
    };
    run("one.src two.src", "both");
    run("one.src", "one/one.src");
    run("two.src", "two/two.src");
    for name in ["one", "two"] {
        let alone = folder.read(&format!("{name}/{name}.dat"));
        assert!(folder.read(&format!("both/{name}.dat")) == alone, "{name}");
        assert!(alone != folder.read(&format!("{name}.dat")));
    }
}

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
        (format!("if a:\n{long}\nend\n{go}"), 1, "not on every way"),
        (format!("if a:\n{TCP}end\n{go}"), 2, ""),
        (
            format!("while a:\n{go}\n{long}\nend"),
            1,
            "not on every way",
        ),
        (format!("{own}\nf()\n{go}"), 2, ""),
        (format!("{own}\nif f():\nend\n{go}"), 2, ""),
        (
            format!("def f():\nif a:\n{long}\nend\nend\nf()\n{go}"),
            1,
            "not on every way",
        ),
        (
            format!("thread f():\n{long}\nend\nrun f()\n{go}"),
            1,
            "not on every way",
        ),
        (
            format!("track_conveyor_linear(p[1,0,0,0,0,0], 100)\n{go}\nstop_conveyor_tracking()"),
            1,
            "the controller moves it",
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
            "its feature f: it is set at a.script:8, but not on every way",
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
        &[(&heavy, 1, "that is certain")],
        "a.script",
        "--payload-from-program",
        script,
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

/// Apostrophes and brackets in remarks and names do not begin a string or an argument.
#[test]
fn remarks_of_a_listing_hide_no_instruction() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.ls")).into_owned();
    let plain = run(&folder, "a.ls", &text, "");
    assert_eq!(plain.1, "");
    for remark in [
        "! spindle (see sheet ;",
        "! don't stop ;",
        "MESSAGE[it's (on] ;",
        "R[1:don't (]=1 ;",
        "//L P[2:it's] 5mm/sec FINE ;",
    ] {
        let text = text.replace("   4:J", &format!("   4:  {remark}\n   4:J"));
        assert_eq!(run(&folder, "b.ls", &text, ""), plain, "{remark}");
    }
    for (line, corrected, reason) in [
        ("UFRAME[2]=PR[1]", 2, "its frame or tool is set at b.ls:"),
        ("P[2]=LPOS", 4, "the program changes it"),
        ("P[R[1]]=PR[3]", 0, "the program changes it"),
        // In whatever language of the controller.
        ("L P[2] 5mm/sec FINE VERSATZ,PR[1]", 5, "changes its end"),
        ("L P[2] 5mm/sec FINE Skip,LBL[1],PR[3]=LPOS", 5, ""),
    ] {
        let text = text.replace("   4:J", &format!("   4:  {line} ;\n   4:J"));
        folder.write("b.ls", text);
        let line =
            "correct elas.blob b.ls --payload-kg 2.5 --frames frames.toml --json - --out out";
        let outcome = folder.run(&format!("{line}.ls"));
        let said = outcome.stdout.clone() + &outcome.stderr;
        assert!(said.contains(reason), "{line} {outcome:#?}");
        if corrected > 0 {
            assert_eq!(
                outcome.json()["targets"].as_u64(),
                Some(corrected),
                "{outcome:#?}"
            );
        }
    }
}

/// The first instruction of a listing, with and without a remark before it.
#[test]
fn the_first_instruction_of_a_listing_counts() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.ls")).replace("\r\n", "\n");
    let (from, to) = (text.find("   1:").unwrap(), text.find("   4:J").unwrap());
    for remark in ["", "   1:  !first ;\n"] {
        let text = format!("{}{remark}{}", &text[..from], &text[to..]);
        assert_eq!(run(&folder, "b.ls", &text, ""), (5, String::new()));
    }
}

/// External axes, frames that the job sets, and shifts on some way to a position.
#[test]
fn positions_of_a_job_that_something_moves_are_left() {
    let folder = folder();
    let text = String::from_utf8_lossy(&file("part.jbi")).replace("\r\n", "\n");
    let all = run(&folder, "a.jbi", &text, "").0;
    for (line, corrected, reason) in [
        (
            "MOVL C00001 BC00001 V=200.0",
            all - 1,
            "it has external axes",
        ),
        (
            "MFRAME UF#(2) P001 P002 P003",
            all - 3,
            "its frame or tool is set",
        ),
        ("SETTOOL TL#(1) P001", all, ""),
        ("SFTON P001\nSFTOF", all, ""),
        (
            "JUMP *A IF IN#(1)=ON\nSFTON P001\n*A",
            0,
            "a shift may be active",
        ),
        ("IFTHENEXP IN#(1)=ON\nSFTON P001\nSFTOF\nENDIF", all, ""),
    ] {
        let text = text.replace("NOP\n", &format!("NOP\n{line}\n"));
        folder.write("b.jbi", text);
        let command =
            "correct elas.blob b.jbi --payload-kg 2.5 --frames frames.toml --json - --out out.jbi";
        let outcome = folder.run(command);
        let said = outcome.stdout.clone() + &outcome.stderr;
        assert!(said.contains(reason), "{line} {outcome:#?}");
        if corrected > 0 {
            assert_eq!(
                outcome.json()["targets"].as_u64(),
                Some(corrected),
                "{line} {outcome:#?}"
            );
        }
    }
    let end = text.replace("MOVJ C00004", "SFTON P001\nJUMP *A\nMOVJ C00004");
    let end = end.replace("NOP\n", "NOP\n*A\n");
    folder.write("b.jbi", end);
    let command = "correct elas.blob b.jbi --payload-kg 2.5 --frames frames.toml --out out.jbi";
    assert!(folder.run(command).stderr.contains("a shift may be active"));
}
