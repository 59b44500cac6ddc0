//! Wrong measurement files and maps: the message names what is wrong and where.

use crate::import::{folder, rows};
use crate::program::Folder;
use crate::texts::texts;

const MAP: &str = "[joints]\ncolumns = [\"a\", \"b\"]\nunit = \"deg\"\n\n[position]\ncolumns = [\"x\", \"y\", \"z\"]\nunit = \"mm\"\n";
const RAW: &str = "a,b,x,y,z\n1,2,100,200,300\n3,4,110,210,310\n";

/// Imports `raw` with `map`.
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
    let _texts = texts();
    import(RAW, MAP).ok();
    for (from, to) in [
        ("4,110", "four,110"),
        ("4,110", ",110"),
        ("4,110", "NaN,110"),
        ("4,110", "inf,110"),
        ("4,110", "1e999,110"),
        ("4,110", "\"4,5\",110"),
        ("4,110", "4°,110"),
        ("110,210,310", "0,0,0"),
        ("310\n", "310,5\n"),
        (",310\n", "\n"),
        ("3,4", "\"3,4"),
        ("3,4", "#N/A,4"),
        ("3,4", "#WERT!,4"),
        ("3,4", "######,4"),
        ("a,b,", "a,a,"),
        ("x,y,z\n", "x,y,\n"),
        ("1,2,100,200,300\n3,4,110,210,310\n", ""),
    ] {
        let raw = RAW.replace(from, to);
        assert_ne!(raw, RAW, "{from}");
        import(raw, MAP).refused();
    }
    import(b"a,b,x,y,z\n1,2,100,200,\xe4\n", MAP).refused();
    import(b"\xff\xfea\0,\0b\0", MAP).refused();
    import(b"PK\x03\x04....", MAP).refused();
    import(b"a,b\0", MAP).refused();
}

/// One cell, one row.
#[test]
fn one_is_no_plural() {
    let _texts = texts();
    let short = import("a,b,x,y,z\n1,2,100,200,300\n3\n", MAP).refused();
    assert!(
        short.stderr.contains("found 1 cell, expected 5"),
        "{short:#?}"
    );
    let folder = Folder::new();
    folder.write("poses.csv", "x,y,z\n1,2,3\n2,3,4\n");
    folder.write("joints.csv", "a,b\n1,2\n");
    folder.write("map.toml", format!("join = {{ by = \"order\" }}\n\n{MAP}"));
    let said = folder.refuses("import poses.csv joints.csv --map map.toml --out data.csv");
    let found = "found 1 row of joints for 2 rows of poses in poses.csv";
    assert!(said.stderr.contains(found), "{said:#?}");
}

/// What the imported rows show is said of the lines and columns of the raw file.
#[test]
fn imported_rows_are_cited_where_they_come_from() {
    let _texts = texts();
    let raw = |rows: &str| format!("a report\n\nz,y,x,b,a\n300,200,100,2,1\n{rows}\n");
    let map = format!("[file]\nskip_lines = 2\n\n{MAP}");
    let kept = import(raw("1,2,3,4,5\n300,200,100,2,1"), &map).ok().said();
    let note = "note: raw.csv: kept, although identical to an earlier row: 1 row (line 6 as 4)";
    assert!(kept.stderr.contains(note), "{kept:#?}");
    import(raw("300,200,1e9,2,1"), &map).refused();
    let folder = Folder::new();
    let points = "# points\npose,x,y,z\np1,100,200,300\np2,101,200,300\n";
    let joints = "pose,a,b,rx,ry,rz\np2,1,2,5,5,5\np1,3,4,5,5,5\n";
    let map = "[joints]\ncolumns = [\"a\", \"b\"]\nunit = \"deg\"\nname = \"pose\"\n\n\
        [points]\nname = \"pose\"\ncolumns = [\"x\", \"y\", \"z\"]\nunit = \"mm\"\njoin = \"name\"\n\n\
        [[reference]]\ncolumns = [\"rx\", \"ry\", \"rz\"]\nunit = \"mm\"\n";
    folder.write("map.toml", map);
    for (points, joints) in [
        (points.replace("101", "1e9"), joints.to_owned()),
        (points.to_owned(), joints.replace("4,5,5", "4,5,1e9")),
    ] {
        folder.write("points.csv", points);
        folder.write("joints.csv", joints);
        folder.refuses("import points.csv joints.csv --map map.toml --out data.csv");
    }
}

/// A measurement in the place of a header would be lost.
#[test]
fn a_header_is_no_measurement() {
    let _texts = texts();
    let numbers = MAP
        .replace("\"a\", \"b\"", "1, 2")
        .replace("\"x\", \"y\", \"z\"", "3, 4, 5");
    let file = |keys: &str, map: &str| format!("[file]\n{keys}\n\n{map}");
    let measured = RAW.replace("100,", "100.5,");
    import(&measured, &file("header_lines = 2", MAP)).refused();
    let headless = measured.replace("a,b,x,y,z\n", "# a b x y z\n");
    import(&headless, &numbers).refused();
    import(&headless, &file("header_lines = 0", &numbers)).ok();
    // Programs that have no names number the columns.
    import(measured.replace("a,b,x,y,z", "0,1,2,3,4"), &numbers).ok();
    // Nothing but comments; and lines that end as on an old Mac.
    import(measured.replace('\n', "\n#"), MAP).refused();
    import(measured.replace('\n', "\r"), MAP).ok();
}

/// A thousands separator is accepted only before exactly three digits of the integer part.
#[test]
fn numbers_that_contradict_their_marks_are_refused() {
    let _texts = texts();
    let map = |decimal: &str, thousands: &str| {
        format!(
            "[file]\nseparator = \"semicolon\"\ndecimal = \"{decimal}\"\nthousands = \"{thousands}\"\n\n{MAP}"
        )
    };
    let raw = |cell: &str| RAW.replace(',', ";").replace("310", cell);
    for cell in ["1.310", "-1.310,5", "310,25", "0.001.310,5"] {
        import(raw(cell), &map(",", ".")).ok();
    }
    for cell in ["12.5", "46.25", "1234.567", "1.23.456", "1,5.000", ".310"] {
        import(raw(cell), &map(",", ".")).refused();
    }
    for cell in ["12,5", "1,2345", "1.5,000"] {
        import(raw(cell), &map(".", ",")).refused();
    }
    // One mark cannot be both, and no mark is part of a number.
    for (decimal, thousands) in [(".", "."), (",", ","), (".", "0"), (".", "-")] {
        import(raw("310"), &map(decimal, thousands)).refused();
    }
}

#[test]
fn bad_maps_are_named_where_they_are_wrong() {
    let _texts = texts();
    for (from, to) in [
        ("unit = \"deg\"", "unit = \"degrees\""),
        ("unit = \"deg\"", "unit = [\"deg\"]"),
        ("\"z\"]", "\"z\", \"a\"]"),
        ("\"z\"]", "\"a\"]"),
        ("\"z\"]", "9]"),
        ("[position]", "[positions]"),
        ("[position]", "[points]"),
        ("[joints]", "[file]\nseparator = \"|\"\n[joints]"),
        ("[joints]", "[file]\nheader_lines = 0\n[joints]"),
        ("[joints]", "[session]\n[joints]"),
    ] {
        let map = MAP.replace(from, to);
        assert_ne!(map, MAP, "{from}");
        import(RAW, &map).refused();
    }
    import(RAW, &format!("[file]\ndecimal = \",\"\n\n{MAP}")).ok();
    let euler = |keys: &str| {
        format!("{MAP}\n[orientation]\nkind = \"euler\"\ncolumns = [\"a\", \"b\", \"x\"]\n{keys}")
    };
    for keys in [
        "axes = \"intrinsic\"\nunit = \"deg\"",
        "order = \"ZYX\"\nunit = \"deg\"",
        "order = \"ZYX\"\naxes = \"fixed\"\nunit = \"deg\"",
        "order = \"ZZX\"\naxes = \"intrinsic\"\nunit = \"deg\"",
        "order = \"ABC\"\naxes = \"intrinsic\"\nunit = \"deg\"",
        "order = \"ZYX\"\naxes = \"intrinsic\"\nunit = \"deg\"\nlayout = \"rows\"",
    ] {
        import(RAW, &euler(keys)).refused();
    }
    let folder = Folder::new();
    folder.write("raw.csv", RAW);
    folder.write("map.toml", MAP);
    for line in [
        "raw.csv --map no.toml --out data.csv",
        "no.csv --map map.toml --out data.csv",
        "raw.csv raw.csv --map map.toml --out data.csv",
        "raw.csv --map map.toml --out raw.csv",
        "raw.csv --out data.csv",
    ] {
        folder.refuses(format!("import {line}"));
    }
}

#[test]
fn rotations_that_are_none_are_refused() {
    let _texts = texts();
    let raw = |numbers: &str| {
        format!("a,b,x,y,z,r1,r2,r3,r4,r5,r6,r7,r8,r9\n1,2,100,200,300,{numbers}\n")
    };
    let quaternion = format!(
        "{MAP}\n[orientation]\nkind = \"quaternion\"\ncolumns = [\"r1\", \"r2\", \"r3\", \"r4\"]\norder = \"xyzw\"\n"
    );
    import(raw("0,0,0,0.9,0,0,0,0,0"), &quaternion).refused();
    import(raw("0,0,0.0001,1.0002,0,0,0,0,0"), &quaternion)
        .ok()
        .said();
    let matrix = format!(
        "{MAP}\n[orientation]\nkind = \"matrix\"\ncolumns = [\"r1\", \"r2\", \"r3\", \"r4\", \"r5\", \"r6\", \"r7\", \"r8\", \"r9\"]\n"
    );
    import(raw("1,0,0,0,1,0,0,0,1"), &matrix).ok();
    import(raw("1,0,0,0,1,0,0,0,-1"), &matrix).refused();
    import(raw("1,0,0,0,1,0,0,0.1,1"), &matrix).refused();
}

#[test]
fn what_is_left_out_is_listed() {
    let _texts = texts();
    let map = format!("incomplete = \"leave-out\"\n{MAP}");
    let raw = "a,b,x,y,z\n1,2,100,200,300\n1,2,0,0,0\n3,4,,,\n3,4,NaN,nan,NaN\n3,nan,1,2,3\n3,4,110,210,310\n";
    import(raw, &map).ok().said();
    import("a,b,x,y,z\n1,2,0,0,0\n", &map).refused();
    // A bad field is still refused.
    import("a,b,x,y,z\n1,2,one,200,300\n", &map).refused();
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
    let _texts = texts();
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
    run(&replace("points.txt", "Pose 01, T2", "Pose 01, T9")).refused();
    run(&replace("points.txt", "Pose 01, T2", "Pose 01, T1")).refused();
    run(&replace("points_joints.csv", "Pose 04", "Pose 44")).refused();
    run(&replace("points_joints.csv", "Pose 04", "Pose 05")).refused();
    // The exchanged names do not fit the tool.
    run(&|folder| {
        replace("points.txt", "Pose 01, T2", "Pose 01, TX")(folder);
        replace("points.txt", "Pose 01, T3", "Pose 01, T2")(folder);
        replace("points.txt", "Pose 01, TX", "Pose 01, T3")(folder);
    })
    .refused();
    // Pose 4 has three points; without one of them it is not a pose.
    let gone = |folder: &Folder| {
        let text = folder.text("points.txt");
        let kept = text.lines().filter(|line| !line.contains("Pose 04, T3"));
        folder.write(
            "points.txt",
            kept.map(|line| format!("{line}\n")).collect::<String>(),
        );
    };
    run(&gone).refused();
    run(&|folder| {
        gone(folder);
        leave_out(folder);
    })
    .ok()
    .said();
    run(&replace(
        "points.toml",
        "T3 = [0, 80, 0]",
        "T3 = [60, 0, 0]",
    ))
    .refused();
    run(&replace(
        "points.toml",
        ", T3 = [0, 80, 0], T4 = [15.5, 20, -60]",
        "",
    ))
    .refused();
    run(&replace(
        "points.toml",
        "join = \"name\"",
        "join = \"order\"",
    ))
    .refused();
    run(&replace("points.toml", "name = \"name\"\n", "")).refused();
}
