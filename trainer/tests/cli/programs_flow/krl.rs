//! KRL: tools, bases, frame data and points that a source changes on some path.

use super::{check, run};
use crate::programs::{file, folder, numbers_after};

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
    let see = "DEF SEE(F:OUT)\nFRAME F\nF.X=F.X+100";
    let with = |more: &str| go.replace('}', &format!(",{more}}}"));
    let cases = [
        (go.to_owned(), 2, ""),
        (format!("BAS(#BASE,i)\n{go}"), 1, "computed"),
        (format!("BAS(#TOOL,i+3)\n{go}"), 1, "computed"),
        (
            format!("IF i==1 THEN\n$BASE=BASE_DATA[5]\nELSE\n$BASE=BASE_DATA[2]\nENDIF\n{go}"),
            1,
            "not on every path",
        ),
        (
            format!("IF i==1 THEN\n$BASE=BASE_DATA[5]\nELSE\n$BASE=BASE_DATA[5]\nENDIF\n{go}"),
            2,
            "",
        ),
        (
            format!("SWITCH i\nCASE 1\n$BASE=BASE_DATA[5]\nENDSWITCH\n{go}"),
            1,
            "not on every path",
        ),
        (
            format!("LOOP\n{go}\n$BASE=BASE_DATA[5]\nENDLOOP"),
            1,
            "not on every path",
        ),
        (
            format!("PUT( )\n{go}\nDEF PUT( )\n$BASE=BASE_DATA[5]"),
            2,
            "",
        ),
        (
            format!("PUT(5)\n{go}\nDEF PUT(i:IN)\nIF i==5 THEN\n$BASE=BASE_DATA[5]\nENDIF"),
            1,
            "not on every path",
        ),
        (
            format!("INTERRUPT DECL 3 WHEN $IN[1] DO PUT( )\n{go}\nDEF PUT( )\n$BASE=BASE_DATA[5]"),
            1,
            "not on every path",
        ),
        (
            format!(
                "IF i==1 THEN\nBASE_DATA[2]={{X 1,Y 0,Z 0,A 0,B 0,C 0}}\nENDIF\n$BASE=BASE_DATA[2]\n{go}"
            ),
            1,
            "not on every path",
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
            format!("FDAT_ACT={{TOOL_NO -1,BASE_NO 2,IPO_FRAME #BASE}}\nBAS(#CP_PARAMS,1)\n{go}"),
            1,
            "there is no tool or base -1",
        ),
        // A configuration that is a variable, or no number of bits.
        (with("S N,T M"), 1, "its T is not a plain number"),
        (with("S N,T 40"), 1, "its S is not a plain number"),
        (with("S 2,T 'X28'"), 1, "its T is not a plain number"),
        (with("S 2,T -1"), 1, "its T is not a plain number"),
        // An external axis that something moves from zero.
        (
            format!("PTP {{E1 500}}\n{go}"),
            1,
            "E1 is missing, so the controller keeps",
        ),
        (
            format!("ASYPTP {{E1 800}}\n{go}"),
            1,
            "E1 is missing, so the controller keeps",
        ),
        (format!("{go}\nXP9.E1=X"), 1, "which a.src:9 sets"),
        (format!("{go}\nXP9.E1=0"), 2, ""),
        (format!("{}\nASYPTP {{E1 800}}", with("E1 0")), 2, "ASYPTP"),
        (
            format!("{}\nASYPTP {{E2 800}}", with("E1 0")),
            1,
            "E2 is missing",
        ),
        (format!("{}\n{go}", with("E1 0")), 3, ""),
        // An array of points.
        (
            format!("DECL E6POS P[2]\nLIN P[i]\n{go}"),
            2,
            "its point is computed: P[i]",
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
        // Bases and tools that a routine of the program changes for its caller, and those of a computed number.
        (
            format!("SEE(BASE_DATA[2])\n$BASE=BASE_DATA[2]\n{go}\n{see}"),
            1,
            "BASE_DATA[2]: it is changed at",
        ),
        (format!("SEE($BASE)\n{go}\n{see}"), 1, "it is changed at"),
        (format!("SEE($TOOL)\n{go}\n{see}"), 1, "it is changed at"),
        (
            format!(
                "IF SEE(TOOL_DATA[3]) THEN\nHALT\nELSE\n$TOOL=TOOL_DATA[3]\n{go}\nENDIF\nDEF X( )\nEND\nDEFFCT BOOL SEE(F:OUT)\nF.X=5\nENDFCT\nDEF Y( )"
            ),
            1,
            "TOOL_DATA[3]: it is changed at",
        ),
        (
            format!("INTERRUPT DECL 3 WHEN $IN[1] DO SEE(BASE_DATA[2])\n{go}\n{see}"),
            1,
            "BASE_DATA[2]: it is set at",
        ),
        (
            format!("SEE(BASE_DATA[i])\n$BASE=BASE_DATA[2]\n{go}\n{see}"),
            1,
            "it is changed at",
        ),
        (
            format!("BASE_DATA[i]={{X 1,Y 0,Z 0,A 0,B 0,C 0}}\n$BASE=BASE_DATA[2]\n{go}"),
            1,
            "it is changed at",
        ),
        (
            format!("SEE(BASE_DATA[2])\nDEF SEE(F:OUT)\nF.X=5\n$BASE=BASE_DATA[2]\n{go}"),
            1,
            "BASE_DATA[2]: it is changed at",
        ),
        (format!("SEE(BASE_DATA[5])\n{go}\n{see}"), 2, ""),
        // Without IN, a parameter is that of the caller.
        (
            format!("SEE($TOOL)\n{go}\n{}", see.replace(":OUT", "")),
            1,
            "it is changed at",
        ),
        (
            format!(
                "DECL E6POS XP1={{{}\nLIN XP1\nLIFT(5,XP1)\nDEF LIFT(I:IN,P)\nP.Z=5",
                &go[5..]
            ),
            1,
            "the program changes it",
        ),
        // A point that a routine gets, and goes to with its own frames.
        (
            format!(
                "DECL E6POS XP1={{{}\nLIN XP1\nGO(XP1)\nDEF GO(P:IN)\n$BASE=BASE_DATA[5]\nLIN P",
                &go[5..]
            ),
            1,
            "GO at a.src:10 also receives it",
        ),
        (
            format!(
                "DECL E6POS XP1={{{}\nLIN XP1\nGO(XP1.X)\nDEF GO(X:IN)\nY=X",
                &go[5..]
            ),
            2,
            "",
        ),
        // The body of REPEAT runs at least once.
        (
            format!("REPEAT\n$BASE=BASE_DATA[5]\nUNTIL i==1\n{go}"),
            2,
            "",
        ),
        (
            format!("REPEAT\n{go}\n$BASE=BASE_DATA[5]\nUNTIL i==1"),
            1,
            "not on every path",
        ),
        (
            format!("REPEAT\nIF i==1 THEN\nEXIT\nENDIF\n$BASE=BASE_DATA[5]\nUNTIL i==2\n{go}"),
            1,
            "not on every path",
        ),
        (
            format!("SEE(BASE_DATA[2])\n{go}\n{}", see.replace("OUT", "IN")),
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

/// Returns X behind `start` in the corrected program.
fn x_of(folder: &super::Folder, part: &str, start: &str) -> f64 {
    run(folder, "b.src", &source(part), "");
    numbers_after(&folder.read("out_b.src"), start, 1)[0]
}

/// What a spline sets holds for its points; behind the spline it is not certain.
#[test]
fn a_spline_sets_its_own_frames() {
    let folder = folder();
    let to = "{X 701.088,Y 449.848,Z 513.922,A 178.5291,B 23.3121,C -159.0124}";
    let data = "FDAT FP5={TOOL_NO 3,BASE_NO 5,IPO_FRAME #BASE}";
    for (head, point) in [("SPLINE", "SPL"), ("PTP_SPLINE", "SPTP")] {
        let x = |before: &str, with: &str| {
            let part = format!("{before}\n{head} {with}\n{point} {to}\nENDSPLINE\n");
            x_of(&folder, &part, &format!("{point} {{X "))
        };
        let expected = x("$BASE=BASE_DATA[5]", "");
        assert_ne!(x("", ""), expected, "{head}");
        assert_eq!(x("", "WITH $BASE=BASE_DATA[5]"), expected, "{head}");
        let of_data = "WITH $TOOL=STOOL2(FP5),$BASE=SBASE(FP5)";
        assert_eq!(x(data, of_data), expected, "{head}");
        let open = |with: &str| format!("{head} {with}\n{point} {to}");
        let cases = [
            (open("WITH $BASE=BASE_DATA[i]"), 1, "computed"),
            (
                format!("{}\nENDSPLINE\nLIN {to}", open("WITH $BASE=BASE_DATA[5]")),
                2,
                "$BASE is not certain after a spline that sets it, which ends at a.src:10",
            ),
            (
                format!(
                    "{}\nENDSPLINE\n$BASE=BASE_DATA[2]\nLIN {to}",
                    open("WITH $BASE=BASE_DATA[5]")
                ),
                3,
                "",
            ),
            (format!("{}\nENDSPLINE\nLIN {to}", open("")), 3, ""),
        ];
        check(&folder, &cases, "a.src", "", source);
    }
}

/// `$TOOL` and `$BASE` are copies: what the data are set to afterwards does not reach them.
#[test]
fn a_tool_in_use_keeps_its_value() {
    let folder = folder();
    let go = "LIN {X 701.088,Y 449.848,Z 513.922,A 178.5291,B 23.3121,C -159.0124}";
    let x = |part: &str| x_of(&folder, &format!("{part}\n{go}\n"), "LIN {X ");
    for (data, name, value) in [
        ("TOOL_DATA[3]", "$TOOL", "{X 30,Y -45,Z 250,A 0,B 0,C 25}"),
        ("BASE_DATA[2]", "$BASE", "{X 910,Y -300,Z 420,A 20,B 0,C 0}"),
    ] {
        let (new, again) = (format!("{data}={value}"), format!("{name}={data}"));
        assert_eq!(x(&new), x(""), "{data}");
        let other = x(&format!("{name}={value}"));
        assert_ne!(other, x(""), "{data}");
        assert_eq!(x(&format!("{new}\n{again}")), other, "{data}");
        let routine = format!("PUT( )\n{go}\nDEF PUT( )\n{new}\n{again}");
        assert_eq!(x_of(&folder, &routine, "LIN {X "), other, "{data}");
        let cases = [(
            format!("IF i==1 THEN\n{new}\n{again}\nENDIF\n{go}"),
            1,
            "not on every path",
        )];
        check(&folder, &cases, "a.src", "", source);
    }
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

/// Joints in a data list that is only read show where the arm is; they stay as they are.
#[test]
fn home_in_the_data_of_the_controller_is_known() {
    let folder = folder();
    let home = "PTP {A1 8,A2 22,A3 1,A4 -14,A5 46,A6 24}";
    let go = "LIN {X 701.088,Y 449.848,Z 513.922,A 178.5291,B 23.3121,C -159.0124}";
    let text = source(&format!("{go}\n"));
    let mut found = Vec::new();
    for (name, text) in [
        ("written", text.clone()),
        ("named", text.replace(home, "PTP XHOME")),
    ] {
        folder.write(&format!("{name}.src"), text);
        let list = home.replace("PTP ", "DEFDAT $CONFIG PUBLIC\nGLOBAL E6AXIS XHOME=");
        folder.write("$config.dat", format!("{list}\nENDDAT\n"));
        let outcome = folder.run(&format!(
            "correct elas.blob {name}.src --with $config.dat --payload-kg 2.5 --out out.src"
        ));
        assert_eq!(outcome.code, Some(0), "{outcome:#?}");
        let said = outcome.stdout + &outcome.stderr;
        assert_eq!(said.contains("joints XHOME are in a file"), name == "named");
        assert!(!said.contains("no joints are known"), "{said}");
        found.push(numbers_after(&folder.read("out.src"), "LIN {", 6));
    }
    assert_eq!(found[0], found[1]);
    // Joints that the program changes are not known.
    folder.write("named.src", text.replace(home, "XHOME.A1=5\nPTP XHOME"));
    let outcome =
        folder.run("correct elas.blob named.src --with $config.dat --payload-kg 2.5 --out o.src");
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let said = outcome.stdout + &outcome.stderr;
    assert!(said.contains("the program changes it"), "{said}");
}
