//! Writes Fanuc TP as a listing (`.ls`), which a controller with ASCII upload takes, or which MakeTP compiles.
//!
//! Sections `/PROG`, `/ATTR`, `/MN` (numbered lines, each ended by `;`), `/POS`, `/END`. `J P[i] 20% FINE` moves joints to
//! a position by an exact stop. A position in joint representation has `J1=` … in deg and extended axes `E1=` in mm.
//! `!text` is a comment (at most 32 characters), `PAUSE` waits for the operator, `CALL NAME(i)` calls a program. Lines and
//! indentation are those that controllers write themselves. J3 is counted from the horizontal: the robot's description
//! must do so, too (coupling).

use std::fmt::Write as _;

use crate::robot_programs::script::{Script, Stop, ascii, decimals};

/// Largest number of characters of a comment.
const COMMENT: usize = 32;
/// Number of joints on one line of a position.
const JOINTS_A_LINE: usize = 3;

pub(super) fn write(script: &Script) -> String {
    let stops = script.stops();
    let mut lines: Vec<String> = [
        "  !Planned for calibration ;",
        "  !Try it slowly first ;",
        "  !Write program MEASURE(AR[1]): ;",
        "  !it triggers the measurement ;",
        "  UFRAME_NUM=0 ;",
        "  UTOOL_NUM=1 ;",
    ]
    .map(str::to_owned)
    .to_vec();
    for stop in &stops {
        if let Some(kg) = stop.mount_kg {
            lines.push(format!(
                "  !{} ;",
                comment(&format!("Mount {kg} kg, set its PAYLOAD"))
            ));
            lines.push("  PAUSE ;".to_owned());
        }
        lines.push(format!("J P[{}] 20% FINE    ;", stop.number));
        lines.push("  WAIT   2.00(sec) ;".to_owned());
        lines.push(format!("  CALL MEASURE({}) ;", stop.number));
    }
    let mut out = format!("/PROG  {}\n/ATTR\n", script.name.to_ascii_uppercase());
    out += "OWNER\t\t= MNEDITOR;\n";
    let _ = writeln!(out, "COMMENT\t\t= \"calibration\";");
    let _ = writeln!(out, "LINE_COUNT\t= {};", lines.len());
    out += "PROTECT\t\t= READ_WRITE;\n";
    out += "DEFAULT_GROUP\t= 1,*,*,*,*;\n";
    out += "CONTROL_CODE\t= 00000000 00000000;\n/MN\n";
    for (number, line) in (1..).zip(&lines) {
        let _ = writeln!(out, "{number:4}:{line}");
    }
    out += "/POS\n";
    for stop in &stops {
        position(&mut out, stop);
    }
    out += "/END\n";
    out
}

fn comment(text: &str) -> String {
    ascii(text).chars().take(COMMENT).collect()
}

fn position(out: &mut String, stop: &Stop) {
    let axes = |letter: char, values: &[f64], unit: &str| -> Vec<String> {
        let numbered = (1..).zip(decimals(values));
        numbered
            .map(|(i, v): (usize, String)| format!("{letter}{i}= {v:>9} {unit}"))
            .collect()
    };
    let all = [axes('J', &stop.arm, "deg"), axes('E', &stop.slides, " mm")].concat();
    let _ = write!(out, "P[{}]{{\n   GP1:\n\tUF : 0, UT : 1,\t\n", stop.number);
    let lines: Vec<String> = all
        .chunks(JOINTS_A_LINE)
        .map(|l| format!("\t{}", l.join(",\t")))
        .collect();
    let _ = write!(out, "{}\n}};\n", lines.join(",\n"));
}
