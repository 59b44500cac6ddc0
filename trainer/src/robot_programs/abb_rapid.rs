//! Writes ABB RAPID.
//!
//! `MoveAbsJ target\NoEOffs, speed, zone, tool;` moves to axis values; `fine` is an exact stop. A `jointtarget` is
//! `[robax, extax]`: six robot axes in degrees and six external ones in degrees or millimetres, 9E9 where there is none.
//! `WaitTime \InPos, s` waits until robot and external axes stand still, then s seconds. A comment begins with `!`.
//! ("RAPID Instructions, Functions and Data types", 3HAC050917.)

use std::fmt::Write as _;

use crate::robot_programs::script::{ARM_AXES, Script, decimals};

/// Number of external axes of a jointtarget.
const EXTERNAL_AXES: usize = 6;

pub(super) fn write(script: &Script) -> String {
    let mut out = format!("MODULE {}\n", script.name);
    for line in script.header() {
        let _ = writeln!(out, "    ! {line}");
    }
    out.push('\n');
    let _ = writeln!(
        out,
        "    PROC {}_run()",
        &script.name[..script.name.len().min(28)]
    );
    for stop in script.stops() {
        if let Some(kg) = stop.mount_kg {
            let _ = writeln!(
                out,
                "        TPWrite \"Mount {kg} kg, set its load, then continue.\";"
            );
            let _ = writeln!(out, "        Stop;");
        }
        let mut robax = decimals(&stop.arm);
        robax.resize(ARM_AXES, "0".to_owned());
        let mut extax = decimals(&stop.slides);
        extax.resize(EXTERNAL_AXES, "9E9".to_owned());
        let (robax, extax) = (robax.join(","), extax.join(","));
        let _ = writeln!(
            out,
            "        MoveAbsJ [[{robax}],[{extax}]]\\NoEOffs, v200, fine, tool0;"
        );
        let _ = writeln!(out, "        measure_pose {};", stop.number);
    }
    out += "        TPWrite \"All poses measured.\";\n    ENDPROC\n\n";
    out += "    ! Trigger the measurement here, for example by a digital output.\n";
    out += "    PROC measure_pose(num pose)\n";
    out += "        WaitTime \\InPos, 2;\n";
    out += "        TPWrite \"Pose \" \\Num:=pose;\n";
    out += "    ENDPROC\nENDMODULE\n";
    out
}
