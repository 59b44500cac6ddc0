//! What the reader refuses, and the words it uses.

use crate::measurement::parse;
use crate::measurement::tests::{notes_say, ok, says};

#[track_caller]
fn refused(bytes: impl AsRef<[u8]>, parts: &[&str]) {
    says(&parse("set.csv", bytes.as_ref()).unwrap_err(), parts);
}

#[test]
fn files_that_are_no_table() {
    refused("", &["set.csv: found an empty file", "header row"]);
    refused("\u{feff}\r\n# only a comment\n\n", &["an empty file"]);
    refused(
        "# c\nq1_deg,x_mm,y_mm,z_mm\n\n",
        &["set.csv:2:", "a header without rows"],
    );
    refused(
        b"q1_deg,x_mm\n1,\0",
        &["set.csv:2:", "binary", "CSV text file in UTF-8"],
    );
    refused(b"q1_deg,x_mm\n1,2\n\xff\xff", &["set.csv:3:", "not UTF-8"]);
    refused(b"\xff\xfeq\x001\x00", &["UTF-16", "save the file as UTF-8"]);
    refused(
        b"PK\x03\x04\0\0",
        &["spreadsheet", "export the table as CSV"],
    );
    refused(
        "q1_deg;x_mm;y_mm;z_mm\n1;2;3;4\n",
        &["set.csv:1:", "a single column", "semicolons"],
    );
    refused(
        "# q1_deg,x_mm\n1,2\n3,4\n",
        &[
            "set.csv:2:",
            "\"1\" in the first row",
            "header row",
            "remove the #",
        ],
    );
}

#[test]
fn rows_of_another_width() {
    let head = "q1_deg,x_mm,y_mm,z_mm\n# c\n1,2,3,4\n";
    refused(
        format!("{head}\n1,2,3\n"),
        &[
            "set.csv:5:",
            "a short row of 3 fields",
            "4 fields",
            "cut off",
        ],
    );
    refused(
        format!("{head}1,2,3,4,5\n"),
        &[
            "set.csv:4:",
            "a long row of 5 fields",
            "4 fields",
            "decimal",
        ],
    );
    refused(
        format!("{head}1,\"2,3,4\n5,6,7,8\n"),
        &["set.csv:4:", "a quotation mark that is not closed"],
    );
    refused(
        format!("{head}1,\"2\n# a\",3,4,5\n6,7,8,9\n"),
        &["set.csv:4:", "a long row of 5", "quotation mark"],
    );
}

#[test]
fn columns_that_resemble_known_ones_are_not_ignored() {
    for (name, meant) in [
        ("payload_lb", "payload_kg"),
        ("payload", "payload_kg"),
        ("Payload_kg", "payload_kg"),
        ("sigma_um", "sigma_mm"),
        ("sigma_urad", "sigma_mrad"),
        ("sigma_arcsec", "sigma_mrad"),
        ("time_ms", "time_s"),
        ("time_us", "time_s"),
        ("q2_turns", "q2_deg"),
        ("q_w", "qw"),
        ("QW", "qw"),
        ("Target", "target"),
    ] {
        let head = format!("q1_deg,x_mm,y_mm,z_mm,{name}");
        let expected = format!("expected the column {meant}");
        let column = format!("set.csv:1: column 5 ({name})");
        refused(format!("{head}\n1,2,3,4,1\n"), &[&column, &expected]);
    }
    // Not where the quantity is there already.
    let set = ok("q1_deg,x_mm,y_mm,z_mm,payload_kg,payload_lb\n1,2,3,4,1,2.2\n");
    notes_say(
        &set.notes,
        &["the column \"payload_lb\" is not known and was ignored"],
    );
}

#[test]
fn columns_that_are_missing_or_twice() {
    let one_row = |head: &str| format!("{head}\n{}1\n", "1,".repeat(head.matches(',').count()));
    let columns = |head: &str, parts: &[&str]| refused(one_row(head), parts);
    columns("x_mm,y_mm,z_mm", &["set.csv:1:", "no column q1_deg"]);
    columns(
        "q1,x_mm,y_mm,z_mm",
        &[
            "no column q1_deg",
            "unknown here: \"q1\"",
            "states its unit",
        ],
    );
    columns("q1_deg,q2_deg", &["no column x_mm, y_mm, z_mm"]);
    columns(
        "q1_deg,x_mm,z_mm",
        &[
            "set.csv:1: column 2 (x_mm)",
            "x_mm, z_mm without y",
            "all of x, y, z",
        ],
    );
    columns(
        "q1_deg,x_mm,y_mm,z_mm,x_mm",
        &["column 5 (x_mm)", "x_mm a second time, first as column 2"],
    );
    columns(
        "q1_deg,x_mm,y_mm,z_mm,x_m",
        &[
            "column 5 (x_m)",
            "x_m beside x_mm in column 2",
            "in one unit",
        ],
    );
    columns(
        "q1_deg,q1_rad,x_mm,y_mm,z_mm",
        &["column 2 (q1_rad)", "q1_rad beside q1_deg"],
    );
    columns(
        "payload_kg,q1_deg,payload_kg,x_mm,y_mm,z_mm",
        &["column 3 (payload_kg)", "a second time"],
    );
    columns(
        "q1_deg,q3_deg,x_mm,y_mm,z_mm",
        &["column 2 (q3_deg)", "q3_deg without q2", "without a gap"],
    );
    columns(
        "q0_deg,q1_deg,x_mm,y_mm,z_mm",
        &["column 1 (q0_deg)", "numbered from 1"],
    );
    columns(
        "q1_deg,x_mm,y_mm,z_mm,qx,qy,qz",
        &[
            "column 5 (qx)",
            "qx, qy, qz without qw",
            "all of qw, qx, qy, qz, or none",
        ],
    );
    columns(
        "q1_deg,x_mm,y_mm,z_mm,ref1_x_mm",
        &["ref1_x_mm without ref1_y, ref1_z"],
    );
    let points = "q1_deg,x_mm,y_mm,z_mm,ref2_x_mm,ref2_y_mm,ref2_z_mm";
    columns(points, &["column 5 (ref2_x_mm)", "ref2_x_mm without ref1"]);
    columns(
        "q1_deg,x_mm,y_mm,z_mm,true_x_mm",
        &["true_x_mm without true_y, true_z"],
    );
    let truth = "q1_deg,x_mm,y_mm,z_mm,true_x_mm,true_y_mm,true_z_mm";
    columns(truth, &["the true position without the true orientation"]);
    columns(
        "q1_deg,x_mm,y_mm,z_mm,true_qw,true_qx,true_qy,true_qz",
        &["orientation without the true position"],
    );
}

#[test]
fn fields_that_are_no_value() {
    let head = "payload_kg,q1_deg,x_mm,y_mm,z_mm,sigma_mm,session\n";
    let row = |row: &str, parts: &[&str]| refused(format!("{head}{row}\n"), parts);
    row(
        "1,abc,1,1,1,1,a",
        &["set.csv:2: column 2 (q1_deg): found \"abc\", expected a number in degrees"],
    );
    row(
        "1,1,,1,1,1,a",
        &[
            "column 3 (x_mm): found an empty field",
            "number in millimetres",
            "remove the row",
        ],
    );
    row(
        "1,nan,1,1,1,1,a",
        &["column 2 (q1_deg): found \"nan\"", "not measured"],
    );
    row("1,1,1,-inf,1,1,a", &["column 4 (y_mm): found \"-inf\""]);
    row("1,1,1,1,1e999,1,a", &["column 5 (z_mm): found \"1e999\""]);
    row(
        "1,1,1,1,\"1,5\",1,a",
        &["column 5 (z_mm): found \"1,5\"", "decimal mark"],
    );
    row(
        "-0.5,1,1,1,1,1,a",
        &["column 1 (payload_kg): found \"-0.5\"", "0 kg or more"],
    );
    row(
        ",1,1,1,1,1,a",
        &["column 1 (payload_kg): found an empty field", "write 0"],
    );
    row(
        "heavy,1,1,1,1,1,a",
        &["found \"heavy\"", "a number in kilograms"],
    );
    row(
        "1,1,1,1,1,-0.1,a",
        &["column 6 (sigma_mm): found \"-0.1\"", "above 0"],
    );
    row("1,1,1,1,1,0,a", &["column 6 (sigma_mm)", "above 0"]);
    row(
        "1,1,1,1,1,1,",
        &[
            "column 7 (session): found an empty field",
            "a name in every row",
        ],
    );
    row(
        "1,1,1,1,1,1,\"two\nlines\"",
        &[
            "column 7 (session): found \"two\\nlines\"",
            "a name without line breaks",
        ],
    );
    row(
        "1,1,0,0.0,-0,1,a",
        &[
            "column 3 (x_mm): found the position 0 0 0",
            "missed the target",
        ],
    );
    row(
        "1,1,1,123456.7,1,1,a",
        &[
            "column 4 (y_mm): found \"123456.7\" (123 m)",
            "within 100 m",
        ],
    );
    refused(
        "q1_deg,x_m,y_m,z_m\n1,2637.6,1,1\n",
        &["column 2 (x_m)", "within 100 m", "are these millimetres?"],
    );
    let long = "9".repeat(200) + "x";
    row(
        &format!("1,{long},1,1,1,1,a"),
        &["\"9999999999999999999999999999999999999999\"…"],
    );
}

#[test]
fn quaternions_that_are_none() {
    let row = |quaternion: &str, parts: &[&str]| {
        refused(
            format!("q1_deg,x_mm,y_mm,z_mm,qw,qx,qy,qz\n1,1,1,1,{quaternion}\n"),
            parts,
        );
    };
    row(
        "0.7,0.7,0.7,0",
        &[
            "set.csv:2: column 5 (qw)",
            "norm 1.212436",
            "within 0.001 of 1",
            "w where the header says w",
        ],
    );
    row("0,0,0,0", &["norm 0.000000"]);
    row("1.0011,0,0,0", &["norm 1.001100"]);
    row("1e200,0,0,1e200", &["a quaternion of norm inf"]);
    row(
        "1,0,,0",
        &[
            "column 7 (qy): found an empty field",
            "all four numbers",
            "rows without an orientation",
        ],
    );
    row(",,,", &["column 5 (qw): found an empty field"]);
    row(
        "1,0,a,0",
        &["column 7 (qy): found \"a\", expected a number"],
    );
}

/// A row that begins with an error of a spreadsheet is no comment: it would be lost.
#[test]
fn rows_that_begin_with_an_error_of_a_spreadsheet_are_no_comments() {
    let text = |cell: &str| format!("q1_deg,x_mm,y_mm,z_mm\n1,2,3,4\n{cell},2,3,4\n\"5\",6,7,8\n");
    for cell in [
        "#N/A", "#NV", "#N/D", "#DIV/0!", "#WERT!", "#NAME?", "#####",
    ] {
        let said = [format!("set.csv:3: column 1 (q1_deg): found \"{cell}\"")];
        for text in [text(cell), text(cell).replace('"', "")] {
            refused(&text, &said.each_ref().map(String::as_str));
        }
    }
    for comment in ["#", "#2", "# N/A", "##", "#Note!", "#1/2", "#P1", "#a/b c"] {
        let set = parse("set.csv", text(comment).as_bytes()).unwrap();
        assert_eq!(set.measurements.len(), 2, "{comment}");
    }
}

/// No text makes the reader panic: every prefix of a file, and every file with one byte changed.
#[test]
fn truncated_and_corrupted_files_do_not_panic() {
    let text = "\u{feff}# c\r\nsession,q1_deg,x_mm,y_mm,z_mm,qw,qx,qy,qz,ref1_x_mm,ref1_y_mm,ref1_z_mm\r\n\
                a,1e1,2.5,3,4,1,0,0,0,,,\r\n\"b\",2,2,3,4,0.6,0,-0.8,0,1,2,3\n";
    for end in 0..text.len() {
        let _ = parse("set.csv", &text.as_bytes()[..end]);
        for byte in [0, b'\n', b'"', b',', b'e', b'#', b'-', 0xff] {
            let mut bytes = text.as_bytes().to_vec();
            bytes[end] = byte;
            let _ = parse("set.csv", &bytes);
        }
    }
}
