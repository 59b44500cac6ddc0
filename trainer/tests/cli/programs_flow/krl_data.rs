//! KRL: frame data that `BAS` copies, loads, kinematics that move bases, and data of several files.

use super::{check, run};
use crate::program::Folder;
use crate::programs::{folder, numbers_after};

const HOME: &str = "PTP {A1 8,A2 22,A3 1,A4 -14,A5 46,A6 24}";
const GO: &str = "LIN {X 701.088,Y 449.848,Z 513.922,A 178.5291,B 23.3121,C -159.0124}";
const LISTS: &str = "TOOL_DATA[3]={X 30,Y -45,Z 210,A 0,B 0,C 25}\nTOOL_DATA[4]={X 0,Y 60,Z 300,A 0,B 0,C -10}\n\
    BASE_DATA[2]={X 900,Y -300,Z 420,A 20,B 0,C 0}\nBASE_DATA[5]={X 905,Y -300,Z 420,A 20,B 0,C 0}\n";

/// Returns a folder with the data list of a source that begins with tool 3 and base 2.
fn with_list(more: &str) -> Folder {
    let folder = folder();
    folder.write("a.dat", format!("DEFDAT A\n{LISTS}{more}\nENDDAT\n"));
    folder
}

fn source(part: &str) -> String {
    format!("DEF A( )\n$TOOL=TOOL_DATA[3]\n$BASE=BASE_DATA[2]\n{HOME}\n{part}\nEND\n")
}

/// Returns the corrected numbers of the line in the program.
fn line_of(folder: &Folder, part: &str, rest: &str) -> Vec<f64> {
    run(folder, "a.src", &source(part), rest);
    numbers_after(&folder.read("out_a.src"), "LIN {", 6)
}

/// `FDAT_ACT` alone changes nothing; with `BAS` it does, also where `$BASE` was set in between.
#[test]
fn frame_data_hold_once_bas_has_copied_them() {
    let folder = with_list("FDAT FP5={TOOL_NO 3,BASE_NO 5,IPO_FRAME #BASE}");
    let line = |part: &str| line_of(&folder, &format!("{part}\n{GO}"), "");
    let (two, five) = (line(""), line("$BASE=BASE_DATA[5]"));
    assert_ne!(two, five);
    assert_eq!(line("FDAT_ACT=FP5"), two);
    for command in ["#PTP_PARAMS,50", "#CP_PARAMS,0.2", "#FRAMES"] {
        let copied = format!("FDAT_ACT=FP5\nBAS({command})");
        assert_eq!(line(&copied), five, "{command}");
        let again = format!("{copied}\n$BASE=BASE_DATA[2]");
        assert_eq!(line(&again), two, "{command}");
        assert_eq!(line(&format!("{again}\nBAS({command})")), five, "{command}");
    }
    assert_eq!(line("FDAT_ACT=FP5\nBAS(#PTP_DAT)\nBAS(#VEL_PTP,50)"), two);
    let cases = [
        (
            format!("BAS(#FRAMES)\n{GO}"),
            1,
            "no FDAT_ACT is set before it",
        ),
        (
            format!("FDAT_ACT=FP5\nFDAT_ACT.BASE_NO=i\nBAS(#FRAMES)\n{GO}"),
            1,
            "fdat_act is changed in part",
        ),
        (
            format!("FDAT_ACT=FP5\nBASE_DATA[5]={{X 1,Y 0,Z 0,A 0,B 0,C 0}}\nBAS(#FRAMES)\n{GO}"),
            1,
            "BASE_DATA[5]: it is changed at a.src:6",
        ),
        (
            format!(
                "BASE_DATA[5]={{X 905,Y -300,Z 420,A 20,B 0,C 0}}\nFDAT_ACT=FP5\nBAS(#FRAMES)\n{GO}"
            ),
            2,
            "",
        ),
        (
            format!("BAS(#EX_BASE,2)\n{GO}"),
            1,
            "BAS(#EX_BASE) may reset $",
        ),
        (format!("BAS(i,2)\n{GO}"), 1, "BAS gets a computed command"),
    ];
    check(&folder, &cases, "a.src", "", source);
}

/// The payload is that of `$LOAD` once the program sets it, and unknown where that is.
#[test]
fn loads_are_those_that_the_program_states() {
    let folder =
        with_list("LOAD_DATA[5]={M 4.0,CM {X 0,Y 0,Z 90},J {X 0,Y 0,Z 0}}\nLOAD_DATA[4]={M -1}");
    let line = |part: &str, rest: &str| line_of(&folder, &format!("{part}\n{GO}"), rest);
    let from_program = "--payload-from-program";
    let (light, heavy) = (line("", "--payload-kg 2.5"), line("", "--payload-kg 4"));
    assert_ne!(light, heavy);
    for (part, expected) in [
        ("", &light),
        ("$LOAD=LOAD_DATA[3]", &light),
        ("$LOAD=LOAD_DATA[5]", &heavy),
        ("BAS(#LOAD,5)", &heavy),
        ("$LOAD.M=4", &heavy),
        ("$LOAD.M=4\n$LOAD.CM.X=4", &heavy),
        ("$LOAD={M 4,CM {X 0,Y 0,Z 90},J {X 0,Y 0,Z 0}}", &heavy),
        ("$LOAD=LOAD_DATA[5]\n$LOAD=LOAD_DATA[3]", &light),
    ] {
        assert_eq!(line(part, from_program), *expected, "{part}");
    }
    let reason = "the payload at this move cannot be determined from the program";
    let with = |load: &str| format!("{load}\n{GO}");
    let cases = [
        (with("$LOAD=LOAD_DATA[4]"), 1, reason),
        (with("$LOAD=LOAD_DATA[7]"), 1, reason),
        (with("$LOAD=LOAD_DATA[i]"), 1, reason),
        (with("$LOAD.M=i"), 1, reason),
        (with("IF i==1 THEN\n$LOAD=LOAD_DATA[5]\nENDIF"), 1, reason),
        (with("$LOAD=LOAD_DATA[3]\nBAS(#TOOL,3)"), 1, reason),
        (with("LOAD_DATA[5].M=9\n$LOAD=LOAD_DATA[5]"), 1, reason),
        (with("LOAD_DATA[5].CM.X=9\n$LOAD=LOAD_DATA[5]"), 2, ""),
    ];
    // A run begins with the load that the run before has left.
    let loaded = |part: &str| source(part).replace("PTP", "$LOAD=LOAD_DATA[3]\nPTP");
    check(&folder, &cases, "a.src", from_program, loaded);
    // Tool 3 and its load, from the data list alone.
    folder.write(
        "b.dat",
        format!("DEFDAT B\n{LISTS}LOAD_DATA[3]={{M 4}}\nENDDAT\n"),
    );
    folder.write("b.src", source(GO).replace("A( )", "B( )"));
    folder
        .run("correct elas.blob b.src --payload-from-program --out c.src")
        .ok();
    assert_eq!(numbers_after(&folder.read("c.src"), "LIN {", 6), heavy);
}

/// A base that an external kinematic moves is left; `$ROBROOT` is the robot's base, wherever the world is.
#[test]
fn bases_that_something_moves_are_left() {
    for (number, kind, corrected, reason) in [
        (
            2,
            "MACH_DEF_INDEX 2,PARENT[] \"WORLD\"",
            1,
            "an external kinematic moves BASE_DATA[2] (a.dat:6)",
        ),
        (
            2,
            "MACH_DEF_INDEX 0,PARENT[] \"DKP400\"",
            1,
            "an external kinematic moves BASE_DATA[2] (a.dat:6)",
        ),
        (
            2,
            "MACH_DEF_INDEX 0,PARENT[] \"WORLD\",GEOMETRY[] \" \"",
            2,
            "",
        ),
        (5, "MACH_DEF_INDEX 2,PARENT[] \"WORLD\"", 2, ""),
    ] {
        let folder = with_list(&format!("MACHINE_FRAME_DAT[{number}]={{{kind}}}"));
        check(&folder, &[(GO, corrected, reason)], "a.src", "", source);
    }
    let folder = with_list("");
    let to = "LIN {X 1404.950,Y 362.505,Z 933.922,A -161.4709,B 23.3121,C -159.0124}";
    let line = |base: &str, rest: &str| line_of(&folder, &format!("$BASE={base}\n{to}"), rest);
    let plain = line("$ROBROOT", "");
    assert_eq!(line("$WORLD", ""), plain);
    let frames = String::from_utf8(folder.read("frames.toml")).unwrap();
    let world = "[base.\"0\"]\nxyz_mm = [0, 0, -80]\nquaternion = [1, 0, 0, 0]\n";
    folder.write("frames.toml", format!("{frames}\n{world}"));
    assert_eq!(line("$ROBROOT", ""), plain);
    assert_ne!(line("$WORLD", ""), plain);
}

/// Points in an array of the data list are those of their number.
#[test]
fn points_of_an_array_are_corrected() {
    let to = &GO[4..];
    let plain = line_of(&with_list(""), GO, "");
    let folder = with_list(&format!("DECL E6POS P[2]\nP[1]={to}\nP[2]={to}"));
    for (part, corrected, reason) in [
        ("LIN P[1]\nLIN P[2] C_DIS", 3, ""),
        ("LIN P[1]", 2, "no move in these files"),
        ("LIN P[3]", 1, "its point P[3] is in none of the files"),
        (
            "LIN P[1]\nLIN P[2]\nP[2].Z=5",
            2,
            "the program changes it at a.src:7",
        ),
        (
            "LIN P[1]\nLIN P[2]\nP[i].Z=5",
            1,
            "the program changes it at a.src:7",
        ),
        (
            "LIN P[1]\nGO(P[1])\nLIN P[2]",
            2,
            "GO at a.src:6 also receives it",
        ),
    ] {
        check(&folder, &[(part, corrected, reason)], "a.src", "", source);
    }
    run(&folder, "a.src", &source("LIN P[1]\nLIN P[2]"), "");
    assert_eq!(numbers_after(&folder.read("out_a.dat"), "P[1]={", 6), plain);
}

/// Values that differ between files of the controller are no values; a routine in none of the files is named.
#[test]
fn files_that_contradict_each_other_are_refused() {
    let folder = folder();
    folder.write("a.src", source(&format!("SETBASE(5)\n{GO}")));
    let list = |name: &str, lists: &str| {
        folder.write(name, format!("DEFDAT X\n{lists}\nENDDAT\n"));
    };
    list("one.dat", LISTS);
    list("two.dat", &LISTS.replace("Z 210", "Z 260"));
    list("other.dat", &LISTS.replace("Z 300", "Z 350"));
    let command = "correct elas.blob a.src --payload-kg 2.5 --out out.src --with one.dat --with";
    let outcome = folder.run(&format!("{command} two.dat"));
    assert_eq!(outcome.code, Some(2), "{outcome:#?}");
    let said = outcome.stderr;
    assert!(
        said.contains("two.dat:2: column 1: found another TOOL_DATA[3] than at one.dat:2"),
        "{said}"
    );
    // What no move uses may differ.
    let outcome = folder.run(&format!("{command} other.dat")).ok();
    assert!(
        outcome.stdout.contains("Tool TOOL_DATA[3]: from one.dat"),
        "{outcome:#?}"
    );
    let note = "a.src:5: routines in none of the files: SETBASE: it is assumed that they set no tool, frame or payload";
    assert!(outcome.stdout.contains(note), "{outcome:#?}");
}
