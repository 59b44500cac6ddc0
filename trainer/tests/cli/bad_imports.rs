//! Measurement files and maps that are wrong: what is wrong is named where it stands.

use crate::import::{folder, rows};
use crate::program::Folder;

const MAP: &str = "[joints]\ncolumns = [\"a\", \"b\"]\nunit = \"deg\"\n\n[position]\ncolumns = [\"x\", \"y\", \"z\"]\nunit = \"mm\"\n";
const RAW: &str = "a,b,x,y,z\n1,2,100,200,300\n3,4,110,210,310\n";

/// Imports `raw` by `map`.
fn import(raw: impl AsRef<[u8]>, map: &str) -> crate::program::Outcome {
    let folder = Folder::new();
    folder.write("raw.csv", raw);
    folder.write("map.toml", map);
    let outcome = folder.run("import raw.csv --map map.toml --out data.csv");
    assert_eq!(folder.path("data.csv").exists(), outcome.code == Some(0));
    outcome
}

#[test]
fn bad_cells_are_named_where_they_stand() {
    import(RAW, MAP).ok();
    for (from, to, parts) in [
        (
            "4,110",
            "four,110",
            &["raw.csv:3: column 2 (b): found \"four\", expected a number in degrees"][..],
        ),
        (
            "4,110",
            ",110",
            &[
                "raw.csv:3: column 2 (b): found an empty cell",
                "incomplete = \"leave-out\"",
            ],
        ),
        (
            "4,110",
            "NaN,110",
            &["raw.csv:3: column 2 (b): found \"NaN\""],
        ),
        ("4,110", "inf,110", &["column 2 (b): found \"inf\""]),
        ("4,110", "1e999,110", &["column 2 (b): found \"1e999\""]),
        (
            "4,110",
            "\"4,5\",110",
            &["column 2 (b): found \"4,5\"", "decimal = \",\""],
        ),
        ("4,110", "4°,110", &["column 2 (b): found \"4°\""]),
        (
            "110,210,310",
            "0,0,0",
            &[
                "raw.csv:3: column 3 (x): found the position 0 0 0",
                "leave-out",
            ],
        ),
        (
            "310\n",
            "310,5\n",
            &[
                "raw.csv:3: found 6 cells, expected 5, as the header has",
                "decimal point",
            ],
        ),
        (",310\n", "\n", &["raw.csv:3: found 4 cells", "cut off"]),
        (
            "3,4",
            "\"3,4",
            &["raw.csv:3: found a quotation mark that is not closed"],
        ),
        (
            "a,b,",
            "a,a,",
            &[
                "map.toml:2: column 11 (joints.columns): found the column \"a\", which is twice in the header, as 1 and 2",
            ],
        ),
        (
            "1,2,100,200,300\n3,4,110,210,310\n",
            "",
            &["raw.csv: found no rows"],
        ),
    ] {
        let raw = RAW.replace(from, to);
        assert_ne!(raw, RAW, "{from}");
        import(raw, MAP).refused(parts);
    }
    import(b"a,b,x,y,z\n1,2,100,200,\xe4\n", MAP)
        .refused(&["raw.csv:2: found bytes that are not UTF-8", "latin-1"]);
    import(b"\xff\xfea\0,\0b\0", MAP).refused(&["UTF-16 text", "encoding = \"utf-16\""]);
    import(b"PK\x03\x04....", MAP).refused(&["a spreadsheet or zip file"]);
    import(b"a,b\0", MAP).refused(&["a binary file"]);
}

#[test]
fn bad_maps_are_named_where_they_are_wrong() {
    for (from, to, parts) in [
        (
            "unit = \"deg\"",
            "unit = \"degrees\"",
            &["map.toml:3:", "found another unit, expected \"deg\""][..],
        ),
        (
            "unit = \"deg\"",
            "unit = [\"deg\"]",
            &[
                "map.toml:3:",
                "(joints.unit): found 1 units, expected one, or 2",
            ],
        ),
        (
            "\"z\"]",
            "\"z\", \"a\"]",
            &[
                "map.toml:6:",
                "(position.columns): found 4 columns, expected 3 columns",
            ],
        ),
        (
            "\"z\"]",
            "\"a\"]",
            &["found \"a\" of raw.csv for two things"],
        ),
        (
            "\"z\"]",
            "9]",
            &["(position.columns): found column 9, expected a column from 1 to 5"],
        ),
        (
            "[position]",
            "[positions]",
            &["map.toml:5:", "unknown field `positions`", "docs/import.md"],
        ),
        (
            "[position]",
            "[points]",
            &["map.toml:5:", "missing", "name"],
        ),
        (
            "[joints]",
            "[file]\nseparator = \"|\"\n[joints]",
            &["map.toml:2:"],
        ),
        (
            "[joints]",
            "[file]\nheader_lines = 0\n[joints]",
            &["found the column \"a\", expected numbers of columns"],
        ),
        ("[joints]", "[file]\ndecimal = \",\"\n\n[joints]", &[]),
        (
            "[joints]",
            "[session]\n[joints]",
            &["[session] with both or neither of column and value"],
        ),
    ] {
        let map = MAP.replace(from, to);
        assert_ne!(map, MAP, "{from}");
        match parts {
            [] => drop(import(RAW, &map).ok()),
            parts => drop(
                import(RAW, &map).refused(
                    &parts
                        .iter()
                        .copied()
                        .filter(|p| *p != "missing")
                        .collect::<Vec<_>>(),
                ),
            ),
        }
    }
    let euler = |keys: &str| {
        format!("{MAP}\n[orientation]\nkind = \"euler\"\ncolumns = [\"a\", \"b\", \"x\"]\n{keys}")
    };
    for (keys, parts) in [
        (
            "axes = \"intrinsic\"\nunit = \"deg\"",
            &["found no order, expected order, the three axes"][..],
        ),
        (
            "order = \"ZYX\"\nunit = \"deg\"",
            &["found no axes, expected axes = \"intrinsic\""],
        ),
        (
            "order = \"ZYX\"\naxes = \"fixed\"\nunit = \"deg\"",
            &["map.toml:13:"],
        ),
        (
            "order = \"ZZX\"\naxes = \"intrinsic\"\nunit = \"deg\"",
            &[
                "map.toml:12:",
                "found \"ZZX\", expected three axes, none twice in a row",
            ],
        ),
        (
            "order = \"ABC\"\naxes = \"intrinsic\"\nunit = \"deg\"",
            &["found \"ABC\""],
        ),
        (
            "order = \"ZYX\"\naxes = \"intrinsic\"\nunit = \"deg\"\nlayout = \"rows\"",
            &["found layout, expected kind, columns and order, axes, unit"],
        ),
    ] {
        import(RAW, &euler(keys)).refused(parts);
    }
    let folder = Folder::new();
    folder.write("raw.csv", RAW);
    folder.write("map.toml", MAP);
    folder
        .run("import raw.csv --map no.toml --out data.csv")
        .refused(&["no.toml: found no such file"]);
    folder
        .run("import no.csv --map map.toml --out data.csv")
        .refused(&["no.csv: found no such file"]);
    folder
        .run("import raw.csv raw.csv --map map.toml --out data.csv")
        .refused(&["found 2 files to import, expected one"]);
    folder
        .run("import raw.csv --map map.toml --out raw.csv")
        .refused(&["raw.csv: found an input of this command"]);
    folder
        .run("import raw.csv --out data.csv")
        .refused(&["--map"]);
    assert_eq!(folder.names(), ["map.toml", "raw.csv"]);
}

#[test]
fn rotations_that_are_none_are_refused() {
    let raw = |numbers: &str| {
        format!("a,b,x,y,z,r1,r2,r3,r4,r5,r6,r7,r8,r9\n1,2,100,200,300,{numbers}\n")
    };
    let quaternion = format!(
        "{MAP}\n[orientation]\nkind = \"quaternion\"\ncolumns = [\"r1\", \"r2\", \"r3\", \"r4\"]\norder = \"xyzw\"\n"
    );
    import(raw("0,0,0,0.9,0,0,0,0,0"), &quaternion)
        .refused(&["raw.csv:2: column 6 (r1): found a quaternion of norm 0.900000"]);
    let noted = import(raw("0,0,0.0001,1.0002,0,0,0,0,0"), &quaternion).ok();
    assert!(
        noted.stderr.contains(
            "the orientations were made rotations: they are off by up to 2.0e-4 (line 2)"
        ),
        "{noted:#?}"
    );
    let matrix = format!(
        "{MAP}\n[orientation]\nkind = \"matrix\"\ncolumns = [\"r1\", \"r2\", \"r3\", \"r4\", \"r5\", \"r6\", \"r7\", \"r8\", \"r9\"]\n"
    );
    import(raw("1,0,0,0,1,0,0,0,1"), &matrix).ok();
    import(raw("1,0,0,0,1,0,0,0,-1"), &matrix).refused(&["a matrix that mirrors"]);
    import(raw("1,0,0,0,1,0,0,0.1,1"), &matrix).refused(&[
        "raw.csv:2: column 6 (r1): found a matrix whose rows are off orthonormal by 1.0e-1",
    ]);
}

#[test]
fn what_is_left_out_is_listed() {
    let map = format!("incomplete = \"leave-out\"\n{MAP}");
    let raw = "a,b,x,y,z\n1,2,100,200,300\n1,2,0,0,0\n3,4,,,\n3,4,110,210,310\n";
    let outcome = import(raw, &map).ok();
    assert!(
        outcome.stdout.contains("Imported 2 measurements"),
        "{outcome:#?}"
    );
    assert!(
        outcome
            .stderr
            .contains("left out, as the map asks: 2 rows without a whole measurement (lines 3, 4)"),
        "{outcome:#?}"
    );
    import("a,b,x,y,z\n1,2,0,0,0\n", &map).refused(&["no row with a measurement"]);
    // What is wrong is wrong all the same.
    import("a,b,x,y,z\n1,2,one,200,300\n", &map)
        .refused(&["raw.csv:2: column 3 (x): found \"one\""]);
}

#[test]
fn labels_payloads_and_uncertainties_come_along() {
    let map = format!(
        "{}\n[payload]\nvalue = 2.5\nunit = \"kg\"\n[session]\nvalue = \"monday, early\"\n[target]\ncolumn = \"t\"\n\
         [sigma_position]\ncolumn = \"s\"\nunit = \"um\"\n[[reference]]\ncolumns = [\"u\", \"v\", \"w\"]\nunit = \"m\"\n",
        MAP.replace("unit = \"deg\"", "unit = [\"mm\", \"rad\"]")
    );
    let folder = Folder::new();
    folder.write(
        "raw.csv",
        "a,b,x,y,z,t,s,u,v,w\n10.5,0.5,1,2,3,T1,30,1.5,0,-1\n11,-0.25,4,5,6,T2,45,,,\n",
    );
    folder.write("map.toml", map);
    folder
        .run("import raw.csv --map map.toml --out data.csv")
        .ok();
    assert_eq!(
        rows(&folder.text("data.csv")),
        "session,target,payload_kg,q1_mm,q2_deg,x_mm,y_mm,z_mm,sigma_mm,ref1_x_mm,ref1_y_mm,ref1_z_mm\n\
         \"monday, early\",T1,2.5,10.5,28.6478897565,1,2,3,0.03,1500,0,-1000\n\
         \"monday, early\",T2,2.5,11,-14.3239448783,4,5,6,0.045,,,\n"
    );
}

#[test]
fn points_that_do_not_belong_together_are_named() {
    let files = ["points.txt", "points_joints.csv", "points.toml"];
    let run = |change: &dyn Fn(&Folder)| {
        let folder = folder(&files);
        change(&folder);
        folder.run("import points.txt points_joints.csv --map points.toml --out data.csv")
    };
    let replace = |file: &'static str, from: &'static str, to: &'static str| {
        move |folder: &Folder| {
            let text = folder.text(file);
            let new = text.replacen(from, to, 1);
            assert_ne!(text, new, "{file}: {from}");
            folder.write(file, new);
        }
    };
    let leave_out = |folder: &Folder| {
        let map = folder.text("points.toml");
        folder.write("points.toml", format!("incomplete = \"leave-out\"\n{map}"));
    };
    run(&replace("points.txt", "Pose 01, T2", "Pose 01, T9"))
        .refused(&["points.txt:4: column 2: found the target \"T9\", expected one of points.targets of the map: \"T1\""]);
    run(&replace("points.txt", "Pose 01, T2", "Pose 01, T1")).refused(&[
        "points.txt:4:",
        "target \"T1\" of pose \"Pose 01\" again, first on line 3",
    ]);
    run(&replace("points_joints.csv", "Pose 04", "Pose 44")).refused(&[
        "points.txt:15: found pose \"Pose 04\", which has no joints in points_joints.csv",
    ]);
    run(&replace("points_joints.csv", "Pose 04", "Pose 05")).refused(&[
        "points_joints.csv:6: column 1 (name): found pose \"Pose 05\" again, first on line 5",
    ]);
    // Exchanged names do not fit the tool.
    run(&|folder| {
        replace("points.txt", "Pose 01, T2", "Pose 01, TX")(folder);
        replace("points.txt", "Pose 01, T3", "Pose 01, T2")(folder);
        replace("points.txt", "Pose 01, TX", "Pose 01, T3")(folder);
    })
    .refused(&[
        "of pose \"Pose 01\" that fit the targets to",
        "are names of points exchanged",
    ]);
    // Pose 4 has three points; without one of them it is no pose.
    let gone = |folder: &Folder| {
        let text = folder.text("points.txt");
        let kept = text.lines().filter(|line| !line.contains("Pose 04, T3"));
        folder.write(
            "points.txt",
            kept.map(|line| format!("{line}\n")).collect::<String>(),
        );
    };
    run(&gone).refused(&[
        "points.txt:15: found pose \"Pose 04\" with the targets T1, T4, expected three targets",
    ]);
    let outcome = run(&|folder| {
        gone(folder);
        leave_out(folder);
    })
    .ok();
    assert!(
        outcome.stdout.contains("Imported 7 measurements"),
        "{outcome:#?}"
    );
    assert!(
        outcome.stderr.contains(
            "left out, as the map asks: 2 rows without a whole measurement (lines 15, 16)"
        ),
        "{outcome:#?}"
    );
    run(&replace(
        "points.toml",
        "T3 = [0, 80, 0]",
        "T3 = [60, 0, 0]",
    ))
    .refused(&[
        "points.txt:5: found points of pose \"Pose 01\" that fit the targets to 68.855 mm only",
    ]);
    run(&replace(
        "points.toml",
        ", T3 = [0, 80, 0], T4 = [15.5, 20, -60]",
        "",
    ))
    .refused(&["points.toml:", "2 targets on one line"]);
    run(&replace(
        "points.toml",
        "join = \"name\"",
        "join = \"order\"",
    ))
    .refused(&[
        "points.toml:11:",
        "(joints.name): found joints.name, and points.join = \"order\"",
    ]);
    run(&replace("points.toml", "name = \"name\"\n", ""))
        .refused(&["points.join = \"name\" without joints.name"]);
}
