//! Writes KUKA KRL as one `.src` file, whose lines contain what would be in a `.dat` file.
//!
//! `PTP {A1 …, A6 …}` moves to axis values in degrees, `E1 …` are external axes in degrees or millimetres; components that
//! are left out keep their value, and axes that an arm does not have are 0. Without `C_PTP` it is an exact stop.
//! `BAS (#INITMOV,0 )` sets the defaults of motion, `BAS (#VEL_PTP,p)` the speed in percent, `HALT` stops until the start
//! key, `WAIT SEC s` waits and stops the advance run. A comment begins with `;`. Subprograms of a module follow its main
//! program. ("Operating and Programming Instructions for System Integrators", KSS 8.)

use std::fmt::Write as _;

use crate::robot_programs::script::{ARM_AXES, Script, decimals};

/// Speed in percent of the largest axis velocities.
const SPEED_PERCENT: u32 = 20;

pub(super) fn write(script: &Script) -> String {
    let mut out = format!("&ACCESS RVP\n&REL 1\nDEF {} ( )\n", script.name);
    for line in script.header() {
        let _ = writeln!(out, "; {line}");
    }
    out += ";FOLD INI\n  ;FOLD BASISTECH INI\n";
    out += "    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )\n";
    out += "    INTERRUPT ON 3\n    BAS (#INITMOV,0 )\n";
    out += "  ;ENDFOLD (BASISTECH INI)\n;ENDFOLD (INI)\n";
    let _ = writeln!(
        out,
        "BAS (#VEL_PTP,{SPEED_PERCENT} )\nBAS (#ACC_PTP,{SPEED_PERCENT} )"
    );
    for stop in script.stops() {
        if let Some(kg) = stop.mount_kg {
            let _ = writeln!(
                out,
                "; Mount {kg} kg and set its load, then press start.\nHALT"
            );
        }
        let axes = |letter: char, values: Vec<String>| -> Vec<String> {
            let numbered = (1..).zip(values);
            numbered
                .map(|(i, v): (usize, String)| format!("{letter}{i} {v}"))
                .collect()
        };
        let mut arm = decimals(&stop.arm);
        arm.resize(ARM_AXES, "0".to_owned());
        let all = [axes('A', arm), axes('E', decimals(&stop.slides))].concat();
        let _ = writeln!(
            out,
            "PTP {{{}}}\nMEASURE_POSE ({})",
            all.join(","),
            stop.number
        );
    }
    out += "END\n\n";
    out += "; Trigger the measurement here, for example by an output.\n";
    out += "DEF MEASURE_POSE (NUMBER :IN )\nINT NUMBER\nWAIT SEC 2.0\nEND\n";
    out
}
