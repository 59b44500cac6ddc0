//! RAPID: tools, work objects, loads and data that a module changes on some path.

use super::{check, run};
use crate::programs::{file, folder, numbers_after};

/// Returns a module with two points, two tools and a work object; `part` has the statements and routines that follow
/// `main`.
pub(super) fn module(part: &str) -> String {
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
            "not on every path",
        ),
        (
            format!("IF a THEN\ntable.uframe:={same};\nELSE\ntable.uframe:={same};\nENDIF\n{go}"),
            2,
            "",
        ),
        (
            format!("WHILE TRUE DO\n{go}\ntable.uframe:=[[1,2,3],[1,0,0,0]];\nENDWHILE"),
            1,
            "not on every path",
        ),
        (
            format!("WHILE TRUE DO\n{go}\ntable.uframe:={same};\nENDWHILE"),
            2,
            "",
        ),
        (
            format!("again:\n{go}\ntable.uframe:=[[1,2,3],[1,0,0,0]];\nGOTO again;"),
            1,
            "not on every path",
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
            "not on every path",
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
                POINT_OF_ABB.replacen("[9E9,", "[0,", 1)
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

/// Data that routines and instructions change by their arguments, through further routines too.
#[test]
fn arguments_that_something_changes_are_left() {
    let folder = folder();
    let go = "MoveL p10,v200,fine,gun\\WObj:=table;";
    let lift = "PROC Lift(INOUT robtarget r)\nr.trans.z:=0;\nENDPROC";
    let (point, frame) = ("the program changes it", "it is changed at");
    let doubtful = "it may be changed at a.mod:8";
    let fix = |main: &str, kind: &str, part: &str| {
        format!(
            "{main}\nPROC Nothing()\nENDPROC\nFUNC bool Fix(INOUT {kind} x)\nx.{part}:=1;\nRETURN TRUE;\nENDFUNC"
        )
    };
    let object = |main: &str| fix(main, "wobjdata", "oframe.trans.x");
    let all = "MoveAbsJ [[8,22,1,-14,46,24],[9E9,9E9,9E9,9E9,9E9,9E9]],v200,fine,tool0;";
    let cases = [
        // A function on the right side of an assignment, in a condition and in another argument.
        (object(&format!("ok:=Fix(table);\n{go}")), 1, frame),
        (
            fix(
                &format!("ok:=Fix(gun);\n{go}"),
                "tooldata",
                "tframe.trans.x",
            ),
            1,
            frame,
        ),
        (
            fix(&format!("ok:=Fix(p10);\n{go}"), "robtarget", "trans.x"),
            1,
            point,
        ),
        (
            object(&format!("SetDO do1,ToNum(Fix(table));\n{go}")),
            1,
            frame,
        ),
        (
            object(&format!("IF Fix(table) THEN\nStop;\nELSE\n{go}\nENDIF")),
            1,
            frame,
        ),
        (
            object(&format!(
                "IF a THEN\nStop;\nELSEIF Fix(table) THEN\nStop;\nELSE\n{go}\nENDIF"
            )),
            1,
            frame,
        ),
        (object(&format!("IF a ok:=Fix(table);\n{go}")), 1, frame),
        // Routines that give the parameter on.
        (
            format!("Outer p10;\n{go}\nPROC Outer(INOUT robtarget w)\nLift w;\nENDPROC\n{lift}"),
            1,
            point,
        ),
        (
            format!(
                "Outer 5,table;\n{go}\nPROC Outer(num n,INOUT wobjdata w)\nInner\\Far:=w;\nENDPROC\n\
                 PROC Inner(\\num m|INOUT wobjdata Far)\nFar.oframe.trans.x:=1;\nENDPROC"
            ),
            1,
            frame,
        ),
        // Only what the routine changes, and not its copy of a value.
        (
            format!(
                "Count n,p10;\n{go}\nPROC Count(INOUT num i,INOUT robtarget r)\ni:=i+1;\nSee r;\nENDPROC\n\
                 PROC See(robtarget r)\nr.trans.z:=0;\nENDPROC"
            ),
            2,
            "",
        ),
        // The routine uses what it changes by its other name.
        (
            format!("Put table;\nPROC Put(INOUT wobjdata w)\nw.uframe:=Calc();\n{go}\nENDPROC"),
            1,
            frame,
        ),
        // Instructions of the controller that change their arguments, and those that are in none of the files.
        (
            format!("Add p10.trans.x,10;\n{go}"),
            1,
            "the program may change it",
        ),
        (format!("Incr table.oframe.trans.x;\n{go}"), 1, doubtful),
        (format!("Decr gun.tframe.trans.z;\n{go}"), 1, doubtful),
        (
            format!("ok:=StrToVal(\"[[1,2,3]]\",p10);\n{go}"),
            1,
            "may change it",
        ),
        (
            format!("GetDataVal \"p\"+ValToStr(i),p10;\n{go}"),
            1,
            "may change it",
        ),
        (
            format!("UnpackRawBytes raw,1,p10.trans.x\\Float4;\n{go}"),
            1,
            "may change it",
        ),
        (format!("Teach\\Object:=table;\n{go}"), 1, doubtful),
        (format!("%\"Teach\"+n% p10;\n{go}"), 1, "may change it"),
        // Data that are named in a string.
        (format!("SetDataVal \"p10\",other;\n{go}"), 1, point),
        (format!("SetDataVal \"p11\",other;\n{go}"), 2, ""),
        (format!("SetDataVal \"p1\"+n,other;\n{go}\n{all}"), 1, point),
        (
            format!("SetAllDataVal \"wobjdata\",other;\n{go}\n{all}"),
            1,
            frame,
        ),
        // Instructions and functions that read.
        (
            format!(
                "TPWrite \"x\"\\Num:=p10.trans.x;\nd:=Distance(p10.trans,CPos(\\Tool:=gun\\WObj:=table));\n\
                 WaitUntil Abs(p10.trans.x)>1;\njoints:=CalcJointT(p10,gun\\WObj:=table);\n\
                 MoveL Offs(p10,0,0,50),v200,fine,gun\\WObj:=table;\n{go}"
            ),
            2,
            "its target is computed",
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

/// A point to which something else goes, too: it is corrected only for the frames of all.
#[test]
fn points_of_other_instructions_are_shared() {
    let folder = folder();
    let go = "MoveL p10,v200,fine,gun\\WObj:=table;";
    let long = "PERS tooldata long:=[TRUE,[[0,0,300],[1,0,0,0]],[2.5,[0,0,1],[1,0,0,0],0,0,0]];";
    let whole = |part: &str| module(part).replace("MODULE M\n", &format!("MODULE M\n{long}\n"));
    let differ = "its moves use different frames: gun in table, and at";
    let (apart, pass) = (
        "PROC mvx(robtarget p)\nMoveL p,v200,fine,",
        "PROC on(robtarget p)\nmvx p;\nENDPROC",
    );
    let cases = [
        (
            format!("{go}\nSearchL di1,sp,p10,v100,long\\WObj:=table;"),
            1,
            differ,
        ),
        (
            format!("{go}\nSearchL\\Stop,di1,sp,p10,v100,gun;"),
            1,
            differ,
        ),
        (
            format!("SearchL di1,sp,p10,v100,gun\\WObj:=table;\n{go}"),
            2,
            "",
        ),
        (
            format!("SpotL p10,gun1,spot1,long\\WObj:=table;\n{go}"),
            1,
            differ,
        ),
        (format!("{go}\nPaintL p10,v100,z1,long;"), 1, differ),
        (format!("{go}\nTriggLIOs p10,v100,z1,long;"), 1, differ),
        (format!("{go}\nj:=CalcJointT(p10,long);"), 1, differ),
        (format!("{go}\nj:=CalcJointT(p10,gun\\WObj:=table);"), 2, ""),
        (
            format!("{go}\nSpotL p10,gun1,spot1,unseen;"),
            1,
            "goes to it, too, with a tool or frame that is not certain",
        ),
        // A point that a routine gets, in further calls too.
        (format!("{go}\nmvx p10;\n{apart}long;\nENDPROC"), 1, differ),
        (
            format!("{go}\non p10;\n{pass}\n{apart}long;\nENDPROC"),
            1,
            differ,
        ),
        (
            format!("{go}\nmvx p10;\n{apart}gun\\WObj:=table;\nENDPROC"),
            2,
            "its target p is a parameter",
        ),
        (
            format!(
                "{go}\nmvt p10,long;\nPROC mvt(robtarget p,PERS tooldata t)\nMoveL p,v200,fine,t;\nENDPROC"
            ),
            1,
            "goes to it, too, with a tool or frame that is not certain",
        ),
        (
            format!(
                "{go}\ntell p10;\nPROC tell(robtarget p)\nx:=Distance(p.trans,p.trans);\nENDPROC"
            ),
            2,
            "",
        ),
    ];
    check(&folder, &cases, "a.mod", "", whole);
    // Of a module that is only read.
    folder.write(
        "other.mod",
        format!("MODULE O\n{long}\nPROC far()\nMoveL p10,v200,fine,long;\nENDPROC\nENDMODULE\n"),
    );
    let cases = [(go.to_owned(), 1, "its moves use different frames")];
    check(
        &folder,
        &cases,
        "b.mod",
        "--payload-kg 2.5 --with other.mod",
        module,
    );
}

/// Loads that the program writes or names are known.
#[test]
fn loads_of_moves_and_tools_are_followed() {
    let folder = folder();
    let go = "MoveL p10,v200,fine,gun\\WObj:=table";
    let piece = "PERS loaddata piece:=[1.5,[0,0,1],[1,0,0,0],0,0,0];";
    let whole = |part: &str| module(part).replace("MODULE M\n", &format!("MODULE M\n{piece}\n"));
    let point = || numbers_after(&folder.read("out_a.mod"), "p10:=", 7);
    let with = |kg: &str| {
        run(&folder, "a.mod", &whole(&format!("{go};")), kg);
        point()
    };
    let [light, own, heavy] = ["--payload-kg 1.5", "--payload-kg 2.5", "--payload-kg 4"].map(with);
    assert!(light != own && own != heavy);
    let none = "the payload at this move cannot be determined";
    for (part, corrected, reason, expected) in [
        (format!("{go}\\TLoad:=piece;"), 2, "", Some(&light)),
        (format!("{go}\\TLoad:=load0;"), 2, "", Some(&own)),
        (format!("{go}\\TLoad:=unseen;"), 1, none, None),
        (
            format!("GripLoad piece;\n{go}\\TLoad:=piece;\nGripLoad load0;"),
            1,
            none,
            None,
        ),
        // The next run begins with what this one sets.
        (
            format!("gun.tload:=[4,[0,0,1],[1,0,0,0],0,0,0];\n{go};"),
            1,
            none,
            Some(&heavy),
        ),
        (format!("gun.tload:=piece;\n{go};"), 1, none, Some(&light)),
        (format!("gun.tload.mass:=4;\n{go};"), 1, none, Some(&heavy)),
        (format!("gun.tload.cog:=[0,0,2];\n{go};"), 2, "", Some(&own)),
    ] {
        let text = whole(&part);
        let (targets, left) = run(&folder, "a.mod", &text, "--payload-from-program");
        assert_eq!(targets, corrected, "{part}\n{left}");
        assert!(
            left.contains(reason) && reason.is_empty() == left.is_empty(),
            "{part}\n{left}"
        );
        if let Some(expected) = expected {
            assert_eq!(&point(), expected, "{part}");
        }
    }
}
