//! Files of joint targets: what is kept, what is refused, and the borders of chunks.

use std::path::Path;

use crate::input_error::InputError;
use crate::measurement::JointChecks;
use crate::measurement::chunks::CHUNK_LINES;
use crate::measurement::joint_targets::{NewFields, Target, TargetReader};
use crate::numeric::parallel::in_order;
use crate::robot::{LoadOptions, Robot};

/// Joint 1 in the unit of its column, rounded; joint 2 where it is not zero; and the line.
struct New(Vec<f64>, usize);

impl NewFields for New {
    fn joint(&self, joint: usize, out: &mut String) -> bool {
        let is_new = joint == 0 || self.0[joint] != 0.0;
        if is_new {
            *out += &format!("{:.3}", self.0[joint] + 1.0);
        }
        is_new
    }

    fn added(&self, out: &mut String) {
        *out += &format!("{}", self.1);
    }
}

fn robot(joints: usize) -> Robot {
    let mut robot = Robot::load("ur5", &LoadOptions::default()).unwrap();
    robot.joints.truncate(joints);
    robot
}

/// The rewritten file and the notes, with so many threads.
fn rewritten(
    text: &str,
    joints: usize,
    threads: usize,
) -> Result<(String, Vec<String>), InputError> {
    let robot = robot(joints);
    let path = Path::new("t.csv");
    let (columns, start, mut chunks) = TargetReader::new(path, text.as_bytes())?.into_parts();
    let limits = columns.limits(&robot)?;
    let (mut out, mut all) = (String::new(), JointChecks::default());
    columns.rewrite_start(&start, &["line"], &mut out)?;
    in_order(
        threads,
        || chunks.next(),
        |chunk| {
            let (mut text, mut checks) = (String::new(), JointChecks::default());
            let answer = |t: &Target<'_>| New(t.joints.to_vec(), t.line);
            columns.rewrite(&chunk, (&limits, &mut checks), answer, &mut text)?;
            Ok::<_, InputError>((text, checks))
        },
        |done| {
            let (text, checks) = done?;
            out += &text;
            all.extend(checks);
            Ok(())
        },
    )?;
    Ok((out, limits.notes(&all)))
}

#[test]
fn all_else_stays_where_it_was() {
    let file = "\u{feff}# program 7\nname,q1_rad,note,q2_rad\r\n\n\"a, b\",1,x,0.5\n# turn\nc,-2,\"say \"\"on\"\"\",0\n";
    let (out, _) = rewritten(file, 2, 1).unwrap();
    assert_eq!(
        out,
        "# program 7\nname,q1_rad,note,q2_rad,line\n\n\"a, b\",2.000,x,1.500,4\n# turn\nc,-1.000,\"say \"\"on\"\"\",0,6\n"
    );
    let columns = |added: &str| {
        let reader = TargetReader::new(Path::new("t.csv"), file.as_bytes()).unwrap();
        reader.columns().refuse_columns(&[added], "help")
    };
    assert!(columns("status").is_ok());
    let error = columns("note").unwrap_err();
    assert_eq!(
        (error.line, error.column),
        (Some(2), Some((3, "note".to_owned())))
    );
}

#[test]
fn bad_targets_are_named() {
    let refused = |text: &str, joints: usize| match rewritten(text, joints, 1) {
        Ok(_) => panic!("{text}"),
        Err(error) => error.to_string(),
    };
    assert!(refused("a,b\n1,2\n", 1).contains("no column q1_deg"));
    assert!(refused("q1_deg,q3_deg\n1,2\n", 2).contains("q3_deg without q2"));
    assert!(refused("q1_deg\nabc\n", 1).contains("t.csv:2: column 1 (q1_deg): found \"abc\""));
    assert!(refused("q1_deg,payload_kg\n1,-2\n", 1).contains("0 kg or more"));
    assert!(refused("q1_deg,q1_deg\n1,2\n", 2).contains("a second time"));
    assert!(refused("q1_deg\n1\n1,2\n", 1).contains("t.csv:3: found a long row of 2 fields"));
    assert!(refused("q1_deg\n9999\n", 1).contains("t.csv:2: column 1 (q1_deg)"));
    assert!(refused("q1_deg\rq1\n", 1).contains("carriage return"));
    assert!(refused("# nothing\n", 1).contains("an empty file"));
    let zero = format!("q1_deg\n{}\0\n", "1\n".repeat(2 * CHUNK_LINES));
    let line = 2 + 2 * CHUNK_LINES;
    assert!(refused(&zero, 1).contains(&format!("t.csv:{line}: found a binary file")));
}

/// What chunks make of a file is what it is row by row, wherever their borders are and however many threads there are: also
/// where a record goes on behind a border, where remarks are, and with an error or a note behind one.
#[test]
fn borders_of_chunks_are_not_seen() {
    // One row at a time, as files of their own.
    let alone = |header: &str, row: &str, line: usize| -> String {
        let (out, _) = rewritten(&format!("{header}{row}"), 2, 1).unwrap();
        let own = out.strip_prefix(&header.replace('\n', ",line\n")).unwrap();
        own.replace(",2\n", &format!(",{line}\n"))
    };
    let header = "q1_rad,q2_rad,name\n";
    let row = |k: usize| match k % 7 {
        3 => format!("{}e-4,0,\"a\nb, {k}\"\n", k % 1000),
        5 => format!(" {}e-4 , 1e-3,{k}\n", k % 1000),
        _ => format!("{}e-4,0.1,plain\n", k % 1000),
    };
    for plain in [true, false] {
        for count in [
            1,
            CHUNK_LINES - 1,
            CHUNK_LINES,
            CHUNK_LINES + 1,
            3 * CHUNK_LINES + 5,
        ] {
            let (mut text, mut expected) = (header.to_owned(), header.replace('\n', ",line\n"));
            let mut line = 2;
            for k in 0..count {
                let row = row(if plain { 7 * k } else { k });
                text += &row;
                expected += &alone(header, &row, line);
                line += row.lines().count();
                if k % 11 == 2 {
                    text += "# a remark, \"open\n";
                    expected += "# a remark, \"open\n";
                    line += 1;
                }
            }
            let one = rewritten(&text, 2, 1).unwrap();
            assert!(one.0 == expected, "{count}");
            for threads in [2, 16] {
                assert!(
                    rewritten(&text, 2, threads).unwrap() == one,
                    "{count} {threads}"
                );
            }
            // A little beyond the limit in the last row, and then far beyond it.
            let near = format!("{text}6.3,0,x\n");
            let notes = rewritten(&near, 2, 2).unwrap().1;
            assert!(
                notes[0].contains(&format!("in 1 row (line {line})")),
                "{notes:?}"
            );
            let far = format!("{near}70,0,x\n");
            for threads in [1, 2] {
                let error = rewritten(&far, 2, threads).unwrap_err();
                assert_eq!(error.line, Some(line + 1));
            }
        }
    }
}
