//! Imported tables: times, reference points, decimal marks, and what spreadsheets add to a table.

use crate::import::rows;
use crate::program::{Folder, Outcome};
use crate::texts::texts;

const MAP: &str = "joints = { columns = [\"a\", \"b\"], unit = \"deg\" }\nposition = { columns = [\"x\", \"y\", \"z\"], unit = \"mm\" }\n";

/// Imports `raw` with `map`; returns the rows.
fn imported(raw: impl AsRef<[u8]>, map: &str) -> String {
    let folder = Folder::new();
    folder.write("raw.csv", raw);
    folder.write("map.toml", map);
    let said = folder
        .run("import raw.csv --map map.toml --out data.csv")
        .ok();
    assert!(!said.stderr.contains("not imported"), "{said:#?}");
    rows(&folder.text("data.csv"))
}

fn refused(raw: impl AsRef<[u8]>, map: &str) -> Outcome {
    let folder = Folder::new();
    folder.write("raw.csv", raw);
    folder.write("map.toml", map);
    folder.refuses("import raw.csv --map map.toml --out data.csv")
}

/// Returns a column of a measurement file.
fn column(text: &str, name: &str) -> Vec<f64> {
    let mut lines = text.lines().map(|line| line.split(','));
    let mut header = lines.next().unwrap();
    let at = header.position(|column| column == name).unwrap();
    let fields = lines.map(|mut line| line.nth(at).unwrap());
    fields.map(|field| field.parse().unwrap()).collect()
}

/// Returns the notes of an import that leaves rows out.
fn left_out(files: &[(&str, &str)], map: &str) -> (Folder, String) {
    let folder = Folder::new();
    let names: Vec<&str> = files.iter().map(|(name, _)| *name).collect();
    for (name, text) in files {
        folder.write(name, text);
    }
    folder.write("map.toml", format!("incomplete = \"leave-out\"\n{map}"));
    let line = format!("import {} --map map.toml --out data.csv", names.join(" "));
    let said = folder.run(&line).ok();
    (folder, said.stderr)
}

/// A pose whose reference point was missed is a pose; one that lacks a part of a point is none.
#[test]
fn a_missed_reference_point_leaves_no_pose_out() {
    let raw = "a,b,x,y,z,rx,ry,rz\n1,2,3,4,5.5,,,\n2,3,4,5,6,1,,3\n3,4,5,6,7,1,2,3\n";
    let map =
        format!("{MAP}reference = [{{ columns = [\"rx\", \"ry\", \"rz\"], unit = \"mm\" }}]\n");
    let (folder, said) = left_out(&[("raw.csv", raw)], &map);
    assert!(
        said.contains("1 row without a complete measurement (lines 3)"),
        "{said}"
    );
    let expected = "q1_deg,q2_deg,x_mm,y_mm,z_mm,ref1_x_mm,ref1_y_mm,ref1_z_mm\n\
                    1,2,3,4,5.5,,,\n3,4,5,6,7,1,2,3\n";
    assert_eq!(rows(&folder.text("data.csv")), expected);
}

/// Rows without the index, the time, the name or the joints that a join needs are left out and listed.
#[test]
fn rows_that_cannot_be_joined_are_left_out() {
    let joined = |poses: &str, joints: &str, keys: &str| {
        let files = [("poses.csv", poses), ("joints.csv", joints)];
        left_out(&files, &format!("{MAP}{keys}"))
    };
    let expected = |folder: &Folder, said: &str, lines: &str| {
        assert!(said.contains(&format!("(lines {lines})")), "{said}");
        let q1 = column(&rows(&folder.text("data.csv")), "q1_deg");
        assert_eq!(q1, [1.0, 4.0], "{said}");
    };
    let by_index = "join = { by = \"index\", poses = \"n\", joints = \"n\" }\n";
    let (folder, said) = joined(
        "n,x,y,z\n1,1,2,3\n,4,5,6\n3,7,8,9\n4,1,1,1\n",
        "n,a,b\n1,1,1\n2,2,2\n,3,3\n4,4,4\n",
        by_index,
    );
    expected(&folder, &said, "4 of joints.csv, 3, 4");
    let by_time = "join = { by = \"time\", poses = \"t\", poses_unit = \"s\", joints = \"t\", joints_unit = \"s\", \
                   tolerance_s = 0.1 }\n";
    let (folder, said) = joined(
        "t,x,y,z\n1,1,2,3\n,4,5,6\n3,7,8,9\n4,1,1,1\n",
        "t,a,b\n1,1,1\n2,2,2\nNaN,3,3\n4,4,4\n",
        by_time,
    );
    expected(&folder, &said, "4 of joints.csv, 3, 4");
    let points = "joints = { columns = [\"a\", \"b\"], unit = \"deg\", name = \"n\" }\n\
                  points = { name = \"n\", columns = [\"x\", \"y\", \"z\"], unit = \"mm\", join = \"name\" }\n";
    let files = [
        ("points.csv", "n,x,y,z\nA,1,2,3\n,4,5,6\nC,7,8,9\nD,1,1,1\n"),
        ("joints.csv", "n,a,b\nA,1,1\n,2,2\nC,3,\nD,4,4\n"),
    ];
    let (folder, said) = left_out(&files, points);
    expected(&folder, &said, "3, 3 of joints.csv, 4, 4 of joints.csv");
}

/// An error of a spreadsheet begins a row, whatever separates the fields.
#[test]
fn an_error_of_a_spreadsheet_begins_no_comment() {
    for (separator, mark) in [
        ("comma", ","),
        ("semicolon", ";"),
        ("tab", "\t"),
        ("space", " "),
    ] {
        let raw = "a,b,x,y,z\n# a remark\n1,2,3,4,5.5\n#N/A,3,4,5,6\n".replace(',', mark);
        let folder = Folder::new();
        folder.write("raw.csv", raw);
        folder.write(
            "map.toml",
            format!("file = {{ separator = \"{separator}\" }}\n{MAP}"),
        );
        let outcome = folder.run("import raw.csv --map map.toml --out data.csv");
        assert_eq!(outcome.code, Some(2), "{outcome:#?}");
        assert!(
            outcome
                .stderr
                .contains("raw.csv:4: column 1 (a): found \"#N/A\""),
            "{outcome:#?}"
        );
    }
}

/// A measurement file comes back with every column: times, a missed reference point and all.
#[test]
fn the_own_format_comes_back_whole() {
    let folder = Folder::new();
    let raw = "session,target,time_s,payload_kg,q1_deg,q2_deg,x_mm,y_mm,z_mm,sigma_mm,ref1_x_mm,ref1_y_mm,ref1_z_mm,ref2_x_mm,\
               ref2_y_mm,ref2_z_mm\n\
               m,T,0,2.5,1.5,2,100,200,300,0.02,1000,2000,500.125,-7.5,8,9\n\
               m,T,1763899509.25,2.5,3,4.25,110,210,310,0.02,,,,-7.5,8,9.5\n";
    folder.write("raw.csv", raw);
    let said = folder.run("import raw.csv --out data.csv").ok();
    assert!(!said.stderr.contains("not imported"), "{said:#?}");
    assert_eq!(rows(&folder.text("data.csv")), raw);
    // A point without a z is none, and is listed.
    folder.write("raw.csv", raw.replace("ref2_z_mm", "other"));
    let said = folder.run("import raw.csv --out data.csv").ok();
    let listed = "not imported: \"ref2_x_mm\", \"ref2_y_mm\", \"other\"";
    assert!(said.stderr.contains(listed), "{said:#?}");
}

/// Returns a table with these times.
fn timed(times: &[&str]) -> String {
    let rows = times.iter().enumerate();
    let rows = rows.map(|(i, time)| format!("{i};{i};{}.5;200;300;{time}\n", 100 + i));
    format!("a;b;x;y;z;t\n{}", rows.collect::<String>())
}

fn timed_map(unit: &str) -> String {
    format!("file = {{ separator = \";\" }}\n{MAP}time = {{ column = \"t\", unit = \"{unit}\" }}\n")
}

/// Times 1.5 s and 3 600 s apart are so in every unit and on every clock.
#[test]
fn times_are_seconds_whatever_their_unit() {
    for (unit, times) in [
        ("s", ["7", "8.5", "3608.5"]),
        ("ms", ["7000", "8500", "3608500"]),
        ("us", ["7000000", "8500000", "3608500000"]),
        (
            "ns",
            [
                "1763899509000000000",
                "1763899510500000000",
                "1763903110500000000",
            ],
        ),
        (
            "iso8601",
            [
                "2026-02-28T23:59:58Z",
                "2026-02-28T23:59:59.5Z",
                "2026-03-01T01:59:59.500+01:00",
            ],
        ),
        (
            "iso8601",
            [
                "2026-02-28 23:59:58",
                "2026-02-28 23:59:59.5",
                "2026-03-01 00:59:59.500",
            ],
        ),
        ("clock", ["09:59:58", "9:59:59,5", "10:59:59.500"]),
        ("clock", ["11:59:58 AM", "11:59:59.5 am", "12:59:59.5 PM"]),
    ] {
        let found = column(&imported(timed(&times), &timed_map(unit)), "time_s");
        let apart = [found[1] - found[0], found[2] - found[1]];
        assert_eq!(apart, [1.5, 3600.0], "{unit} {found:?}");
    }
    // The header states the unit, too.
    let header = timed(&["1", "2"]).replace(";t\n", ";t [ms]\n");
    let map = timed_map("").replace(", unit = \"\"", "");
    assert_eq!(column(&imported(header, &map), "time_s"), [0.001, 0.002]);
}

#[test]
fn times_that_are_none_are_refused() {
    let _texts = texts();
    for (unit, times) in [
        ("s", ["1", ""]),
        ("s", ["1", "14:05:09"]),
        ("min", ["1", "2"]),
        ("iso8601", ["2026-02-28T23:59:58Z", "2026-02-28T23:59:59"]),
        ("iso8601", ["23:59:58", "23:59:59"]),
        ("clock", ["23:59:58", "00:00:01"]),
        ("clock", ["14:05:60", "14:06:00"]),
        ("clock", ["14:05", "14:06"]),
        ("clock", ["13:05:00 PM", "13:06:00 PM"]),
    ] {
        refused(timed(&times), &timed_map(unit));
    }
    let joined = "joints_file = { separator = \",\" }\njoin = { by = \"time\", poses = \"t\", joints = \"t\", tolerance_s = 1.0 }\n";
    refused(timed(&["1", "2"]), &format!("{}{joined}", timed_map("s")));
}

/// Poses that are joined to their joints by time have that time.
#[test]
fn a_join_by_time_keeps_the_time() {
    let folder = Folder::new();
    folder.write("poses.csv", "t [ms],x,y,z\n1000,1,2,3.5\n2500,4,5,6\n");
    folder.write("joints.csv", "t [s],a,b\n2.5,1,2\n1.0,3,4\n");
    let join = "join = { by = \"time\", poses = \"t\", joints = \"t\", tolerance_s = 0.1 }\n";
    folder.write("map.toml", format!("{MAP}{join}"));
    let line = "import poses.csv joints.csv --map map.toml --out data.csv";
    folder.run(line).ok();
    let expected = "time_s,q1_deg,q2_deg,x_mm,y_mm,z_mm\n1,3,4,1,2,3.5\n2.5,1,2,4,5,6\n";
    assert_eq!(rows(&folder.text("data.csv")), expected);
}

/// Two rows of a KUKA log as numbers, with the decimals of each column.
const KUKA: [[f64; 12]; 2] = [
    [
        10.5, 20.0, 30.0, 40.0, 5.0, 6.0, 1500.5, -200.0, 2900.0, 90.0, 0.0, -45.0,
    ],
    [
        11.0, -20.0, 35.0, 42.0, 7.0, 8.0, 1400.25, -1250.0, 910.0, 30.0, 10.0, 18.0,
    ],
];
const NAMES: &str = "A1,A2,A3,A4,A5,A6,X,Y,Z,A,B,C";

/// Returns a number with these marks.
fn written(number: f64, decimal: char, thousands: &str, decimals: Option<usize>) -> String {
    let text = decimals.map_or_else(|| number.to_string(), |n| format!("{number:.n$}"));
    let (whole, fraction) = text.split_once('.').unwrap_or((&text, ""));
    let (sign, digits) = whole.split_at(usize::from(whole.starts_with('-')));
    let (head, tail) = digits.split_at(digits.len().saturating_sub(3));
    let thousands = if head.is_empty() { "" } else { thousands };
    let mark = if fraction.is_empty() {
        ""
    } else {
        &decimal.to_string()
    };
    format!("{sign}{head}{thousands}{tail}{mark}{fraction}")
}

/// Returns a log with these marks. A field that contains the separator is quoted.
fn log(
    table: &[[f64; 12]],
    separator: char,
    decimal: char,
    thousands: &str,
    decimals: Option<usize>,
) -> String {
    let field = |number: &f64| {
        let text = written(*number, decimal, thousands, decimals);
        if text.contains(separator) {
            format!("\"{text}\"")
        } else {
            text
        }
    };
    let line = |row: &[f64; 12]| -> String {
        let fields: Vec<String> = row.iter().map(field).collect();
        fields.join(&separator.to_string()) + "\n"
    };
    let header = NAMES.replace(',', &separator.to_string());
    format!("{header}\n{}", table.iter().map(line).collect::<String>())
}

/// A number is read as it was written or refused, whatever its marks: never a thousandth of it.
#[test]
fn no_mark_of_thousands_becomes_a_decimal_mark() {
    let folder = Folder::new();
    let run = |text: &str| {
        folder.write("raw.csv", text);
        folder.run("import raw.csv --preset kuka --out data.csv")
    };
    run(&log(&KUKA, ';', '.', "", None)).ok();
    let expected = rows(&folder.text("data.csv"));
    // All but the last are whole numbers.
    let whole = KUKA.map(|row| row.map(f64::trunc));
    run(&log(&whole, ';', '.', "", None)).ok();
    let of_whole = rows(&folder.text("data.csv"));
    let mut read = 0;
    for separator in [';', '\t', ','] {
        for (decimal, group) in [('.', ","), (',', "."), ('.', ""), (',', "")] {
            for decimals in [None, Some(2), Some(3)] {
                for (table, expected) in [(&KUKA, &expected), (&whole, &of_whole)] {
                    let text = log(table, separator, decimal, group, decimals);
                    let outcome = run(&text);
                    // A whole number such as 1,250 has two readings; a fraction of any row decides.
                    let has_fraction = decimals.is_some() || table == &KUKA;
                    if outcome.code == Some(0) {
                        assert_eq!(&rows(&folder.text("data.csv")), expected, "{text}");
                        read += 1;
                    } else {
                        assert!(!has_fraction && !group.is_empty(), "{text}\n{outcome:#?}");
                    }
                }
            }
        }
    }
    assert!(read >= 66, "{read}");
}

#[test]
fn marks_that_no_number_decides_are_asked_for() {
    let _texts = texts();
    let folder = Folder::new();
    let whole = KUKA.map(|row| row.map(f64::trunc));
    for (decimal, group) in [('.', ","), (',', ".")] {
        folder.write("raw.csv", log(&whole, ';', decimal, group, None));
        folder.refuses("import raw.csv --preset kuka --out data.csv");
    }
    folder.write("raw.csv", log(&whole, ';', '.', ",", None));
    folder
        .run("import raw.csv --preset kuka --write-map map.toml --out data.csv")
        .refused();
    let map = folder.text("map.toml");
    // Either statement answers.
    for (key, value) in [("thousands = \",\"", 2900.0), ("decimal = \",\"", 2.9)] {
        let stated = match key.starts_with("decimal") {
            true => map.replace("decimal = \".\"", key),
            false => map.replace("decimal = \".\"", &format!("decimal = \".\"\n{key}")),
        };
        folder.write("stated.toml", stated);
        folder
            .run("import raw.csv --map stated.toml --out data.csv")
            .ok();
        assert_eq!(column(&rows(&folder.text("data.csv")), "z_mm")[0], value);
    }
    // Without a statement a map has a decimal point, and a column of its own contradicts it.
    folder.refuses("import raw.csv --map map.toml --out other.csv");
    let mixed = log(&KUKA, ';', '.', "", None).replace("1400.25", "1400,25");
    folder.write("raw.csv", mixed);
    folder.refuses("import raw.csv --preset kuka --out other.csv");
}

/// What spreadsheets add to a table changes no row.
#[test]
fn a_stated_separator_and_blank_rows_are_no_measurements() {
    let plain = "a;b;x;y;z\n1;2;100;200;300\n3;4;110;210;310\n";
    let map = format!("file = {{ separator = \";\" }}\n{MAP}");
    let expected = imported(plain, &map);
    let blank = |text: &str| text.replace("3;4", ";;;;\n3;4");
    for raw in [
        format!("sep=;\n{plain}"),
        format!("\u{feff}\"sep=;\"\r\n{}", plain.replace('\n', "\r\n")),
        format!("SEP=;\n;;;;\n{plain};;;;\n;;\n\"\";;;;;;\n"),
        format!("{plain} ; ;;;\n\n;;;;"),
        blank(plain),
    ] {
        assert_eq!(imported(&raw, &map), expected, "{raw}");
    }
    // A preset takes the stated separator.
    let folder = Folder::new();
    for (separator, start) in [
        (';', "sep=;\n"),
        ('\t', "sep=\t\n"),
        (',', "sep=,\n"),
        (';', ""),
    ] {
        let text = log(&KUKA, separator, '.', "", None) + &format!("{separator}").repeat(11) + "\n";
        folder.write("raw.csv", format!("{start}{text}"));
        let out = format!(
            "import raw.csv --preset kuka --out {}.csv",
            usize::from(start.is_empty())
        );
        folder.run(&out).ok();
    }
    assert_eq!(rows(&folder.text("0.csv")), rows(&folder.text("1.csv")));
}

#[test]
fn separators_that_contradict_and_blank_rows_in_an_order_are_refused() {
    let _texts = texts();
    let plain = "a;b;x;y;z\n1;2;100;200;300\n";
    refused(format!("sep=;\n{plain}"), MAP);
    refused(format!("sep=|\n{plain}"), MAP);
    let folder = Folder::new();
    folder.write("raw.csv", format!("sep=|\n{plain}"));
    folder.refuses("import raw.csv --preset kuka --out data.csv");
    // A pose that was missed has its place among the others.
    folder.write("poses.csv", "x;y;z\n1;2;3\n;;\n4;5;6\n;;\n");
    folder.write("joints.csv", "a,b\n1,2\n3,4\n5,6\n");
    let keys = "file = { separator = \";\" }\njoints_file = { separator = \",\" }\njoin = { by = \"order\" }\n";
    folder.write("map.toml", format!("{keys}{MAP}"));
    let line = "import poses.csv joints.csv --map map.toml --out data.csv";
    folder.refuses(line);
    folder.write(
        "map.toml",
        format!("incomplete = \"leave-out\"\n{keys}{MAP}"),
    );
    folder.run(line).ok().said();
    assert_eq!(
        column(&rows(&folder.text("data.csv")), "q1_deg"),
        [1.0, 5.0]
    );
}

/// A joint that a log left out is named: the joints behind it would be those of other axes.
#[test]
fn a_driver_leaves_out_no_joint() {
    let _texts = texts();
    let folder = Folder::new();
    let all = log(&KUKA, ',', '.', "", None);
    folder.write("raw.csv", all.replace("A3,", "E1,"));
    folder.refuses("import raw.csv --preset kuka --out data.csv");
    let map = MAP.replace(
        "columns = [\"a\", \"b\"], unit = \"deg\"",
        "driver = \"kuka\"",
    );
    folder.write("map.toml", map.replace("\"x\", \"y\", \"z\"", "7, 8, 9"));
    folder.refuses("import raw.csv --map map.toml --out data.csv");
    folder.write("raw.csv", all.replace("A6,", "E1,"));
    let said = folder
        .run("import raw.csv --preset kuka --out data.csv")
        .ok();
    assert!(said.stderr.contains("not imported: \"E1\""), "{said:#?}");
}
