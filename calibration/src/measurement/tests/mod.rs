//! What a file says, to the last bit; what is refused is in [`refused`], the check against a robot in [`robot`].

mod rejected;
mod robot;
mod targets;

use nalgebra::Vector3;
use sha2::{Digest, Sha256};

use crate::input_error::InputError;
use crate::measurement::{JointColumn, JointUnit, MeasurementSet, parse, read};

fn ok(text: &str) -> MeasurementSet {
    parse("set.csv", text.as_bytes()).unwrap()
}

#[track_caller]
pub(in crate::measurement) fn says(error: &InputError, parts: &[&str]) {
    let text = error.to_string();
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text:?}");
    }
}

#[track_caller]
fn notes_say(notes: &[String], parts: &[&str]) {
    assert_eq!(notes.len(), parts.len(), "{notes:?}");
    for (note, part) in notes.iter().zip(parts) {
        assert!(note.contains(part), "{part:?} is not in {note:?}");
    }
}

#[test]
fn everything_is_read() {
    let set = ok(
        "session,target,payload_kg,q1_deg,q2_mm,x_mm,y_mm,z_mm,qw,qx,qy,qz,sigma_mm,sigma_mrad,\
                  ref1_x_mm,ref1_y_mm,ref1_z_mm,ref2_x_m,ref2_y_m,ref2_z_m,\
                  true_x_mm,true_y_mm,true_z_mm,true_qw,true_qx,true_qy,true_qz\n\
                  run1,left,2.5,30,250.5,1000.25,-200,3,0,0.6,0,-0.8,0.03,0.05,\
                  1,2,3,0.001,0.002,0.003,1000,-200,3,0,0,0,1\n\
                  run2,right,0,-30,0,1,2,3,1,0,0,0,0.01,0.02,\
                  0,0,0,,,,1,2,3,1,0,0,0\n",
    );
    assert_eq!(set.joint_count(), 2);
    assert!(set.has_payload() && set.has_orientation() && set.measurements[0].session.is_some());
    assert!(set.measurements[0].target.is_some() && set.has_truth());
    let column = |column, name: &str, unit| JointColumn {
        column,
        name: name.into(),
        unit,
    };
    assert_eq!(
        set.joint_columns,
        [
            column(4, "q1_deg", JointUnit::Degree),
            column(5, "q2_mm", JointUnit::Millimetre)
        ]
    );
    let first = &set.measurements[0];
    assert_eq!(first.line, 2);
    assert_eq!(first.joints, [30.0_f64.to_radians(), 0.2505]);
    assert_eq!(first.payload_kg, Some(2.5));
    assert_eq!(first.session.as_deref(), Some("run1"));
    assert_eq!(first.target.as_deref(), Some("left"));
    assert_eq!(first.position, Vector3::new(1.00025, -0.2, 0.003));
    assert_eq!(first.orientation, Some((0.0, Vector3::new(0.6, 0.0, -0.8))));
    assert_eq!(first.sigma_position, Some(3e-5));
    assert_eq!(first.sigma_orientation, Some(5e-5));
    let reference = Some(Vector3::new(0.001, 0.002, 0.003));
    assert_eq!(first.references, [reference, reference]);
    let truth = first.truth.unwrap();
    assert_eq!(truth.translation, Vector3::new(1.0, -0.2, 0.003));
    assert_eq!(truth.rotation[(0, 0)], -1.0);
    let pose = first.instrument_from_target().unwrap();
    assert_eq!(pose.translation, first.position);
    // Half a turn about (0.6, 0, −0.8): R = 2 a aᵀ − I.
    assert!((pose.rotation[(0, 0)] - (2.0 * 0.36 - 1.0)).abs() < 1e-15);
    assert!((pose.rotation[(0, 2)] + 2.0 * 0.48).abs() < 1e-15);
    assert_eq!(set.measurements[1].references, [None, None]);
    notes_say(
        &set.notes,
        &[
            "reference point 1 was missed in 1 row (line 3)",
            "reference point 2",
        ],
    );
}

#[test]
fn optional_columns_are_optional() {
    let set = ok("q1_deg,x_mm,y_mm,z_mm\n1,2,3,4\n");
    assert!(!set.has_payload() && !set.has_orientation() && set.measurements[0].session.is_none());
    assert!(set.measurements[0].target.is_none() && !set.has_truth());
    let first = &set.measurements[0];
    assert_eq!(first.instrument_from_target(), None);
    assert!(first.references.is_empty() && first.sigma_position.is_none());
    assert!(set.notes.is_empty());
}

/// The same lengths in millimetres and metres are the same bits, and radians are taken as they are.
#[test]
fn units_agree_in_bits() {
    let numbers = [
        "1234.567",
        "-0.1",
        "2637.60786",
        "1e-5",
        "+33.3E2",
        "7.0000001",
        ".3",
        "5.",
    ];
    let metres = [
        "1.234567",
        "-0.0001",
        "2.63760786",
        "1e-8",
        "3.33",
        "0.0070000001",
        ".0003",
        "0.005",
    ];
    for (mm, m) in numbers.iter().zip(metres) {
        let a = ok(&format!(
            "q1_mm,x_mm,y_mm,z_mm,sigma_mm,sigma_mrad\n{mm},{mm},{mm},1,1,0.3\n"
        ));
        let b = ok(&format!(
            "q1_m,x_m,y_m,z_m,sigma_m,sigma_rad\n{m},{m},{m},0.001,1e-3,0.0003\n"
        ));
        let (a, b) = (&a.measurements[0], &b.measurements[0]);
        assert_eq!(a.joints[0].to_bits(), b.joints[0].to_bits(), "{mm}");
        assert_eq!(
            a.position.map(f64::to_bits),
            b.position.map(f64::to_bits),
            "{mm}"
        );
        assert_eq!(a, b);
        assert_eq!(b.joints[0].to_bits(), m.parse::<f64>().unwrap().to_bits());
    }
    let a = ok("q1_deg,x_mm,y_mm,z_mm\n123.456,1,1,1\n").measurements[0].joints[0];
    assert_eq!(a.to_bits(), 123.456_f64.to_radians().to_bits());
    let b = ok(&format!("q1_rad,x_mm,y_mm,z_mm\n{a},1,1,1\n")).measurements[0].joints[0];
    assert_eq!(a.to_bits(), b.to_bits());
}

#[test]
fn comments_blank_lines_and_line_ends() {
    let plain = "q1_deg,q2_deg,x_mm,y_mm,z_mm\n1,2,3,4,5\n6,7,8,9,10\n";
    let set = ok(plain);
    let hash: [u8; 32] = Sha256::digest(plain).into();
    assert_eq!((set.sha256, set.header_line), (hash, 1));

    let decorated = "\u{feff}# a comment, with a comma\r\n\r\n  q1_deg , q2_deg,\tx_mm,y_mm,z_mm\r\n  # another\r\n\
                     1, 2 ,3,4,5  \r\n   \r\n\"6\",7,8,9,10";
    let other = ok(decorated);
    assert_eq!(other.header_line, 3);
    let lines = |set: &MeasurementSet| set.measurements.iter().map(|m| m.line).collect::<Vec<_>>();
    assert_eq!((lines(&set), lines(&other)), (vec![2, 3], vec![5, 7]));
    for (a, b) in set.measurements.iter().zip(&other.measurements) {
        assert_eq!((&a.joints, a.position), (&b.joints, b.position));
    }
    assert_ne!(set.sha256, other.sha256);
}

/// A text in quotation marks may contain anything, also lines that look like a comment.
#[test]
fn no_line_of_a_quoted_text_is_a_comment() {
    let set = ok(
        "q1_deg,x_mm,y_mm,z_mm,note\n1,1,1,1,\"ticket\n#12\"\n2,1,1,1,x\n# one\n3,1,1,1,\"\n\n # y\"\n4,1,1,1,z\n",
    );
    let rows: Vec<_> = set
        .measurements
        .iter()
        .map(|m| (m.line, libm::round(m.joints[0].to_degrees())))
        .collect();
    assert_eq!(rows, [(2, 1.0), (4, 2.0), (6, 3.0), (9, 4.0)]);
}

#[test]
fn columns_come_in_any_order_and_unknown_ones_are_noted() {
    let set = ok("z_mm,comment,q2_deg,x_mm,temperature,q1_deg,y_mm\n3,warm,20,1,21.5,10,2\n");
    let first = &set.measurements[0];
    assert_eq!(first.position, Vector3::new(0.001, 0.002, 0.003));
    assert_eq!(first.joints, [10.0_f64.to_radians(), 20.0_f64.to_radians()]);
    notes_say(
        &set.notes,
        &["the columns \"comment\", \"temperature\" are not known and were ignored"],
    );
}

#[test]
fn quaternions_are_normalised_with_a_note() {
    let set = ok("q1_deg,x_mm,y_mm,z_mm,qw,qx,qy,qz\n1,1,1,1,1,0,0,0\n1,1,1,1,0,-1.0009,0,0\n");
    assert_eq!(
        set.measurements[1].orientation,
        Some((0.0, Vector3::new(-1.0, 0.0, 0.0)))
    );
    notes_say(&set.notes, &["differs from 1 by up to 9.0e-4 (line 3)"]);
    let set = ok("q1_deg,x_mm,y_mm,z_mm,qw,qx,qy,qz\n1,1,1,1,0.6000000001,0.8,0,0\n");
    let (w, v) = set.measurements[0].orientation.unwrap();
    assert!((w * w + v.dot(&v) - 1.0).abs() < 1e-15);
    assert!(set.notes.is_empty());
}

#[test]
fn repeated_rows_are_kept_with_a_note() {
    let mut text = "q1_deg,x_mm,y_mm,z_mm\n1,2,3,4\n2,2,3,4\n1,2,3,4\n".to_owned();
    notes_say(
        &ok(&text).notes,
        &["identical to an earlier row: 1 row (line 4 as 2)"],
    );
    assert_eq!(ok(&text).measurements.len(), 3);
    // 1.0 is another text: not identical.
    assert!(
        ok("q1_deg,x_mm,y_mm,z_mm\n1,2,3,4\n1.0,2,3,4\n")
            .notes
            .is_empty()
    );
    text += &"2,2,3,4\n".repeat(6);
    notes_say(
        &ok(&text).notes,
        &["identical to an earlier row: 7 rows (lines 4 as 2, "],
    );
    assert!(
        ok(&text).notes[0].ends_with("7 as 3, 8 as 3, …)"),
        "{:?}",
        ok(&text).notes
    );
}

#[test]
fn files_are_read_by_path() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set.csv");
    std::fs::write(&path, "q1_deg,x_mm,y_mm,z_mm\n1,2,3,4\n").unwrap();
    assert_eq!(read(&path).unwrap().path, path);
    says(
        &read(folder.path().join("none.csv")).unwrap_err(),
        &["none.csv", "no such file", "CSV"],
    );
    says(&read(folder.path()).unwrap_err(), &["a directory"]);
}
