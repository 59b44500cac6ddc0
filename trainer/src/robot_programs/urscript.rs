//! Writes URScript of Universal Robots.
//!
//! `movej(q, a, v)` with a list of six joints in rad, rad/s² and rad/s; without a blend radius the arm stops at the pose.
//! `popup(s, title, warning, error, blocking)` with `blocking=True` waits for the operator, `sleep(s)` waits,
//! `textmsg` writes into the log. Blocks end with `end`, a comment begins with `#`. ("The URScript Programming
//! Language", module motion.)

use std::fmt::Write as _;

use crate::robot_programs::script::Script;

pub(super) fn write(script: &Script) -> String {
    let mut out = format!("def {}():\n", script.name);
    for line in script.header() {
        let _ = writeln!(out, "  # {line}");
    }
    out += "  # Trigger the measurement here, for example by a digital output.\n";
    out += "  def measure_pose(pose):\n    sleep(2.0)\n    textmsg(\"pose \", pose)\n  end\n";
    for stop in script.stops() {
        if let Some(kg) = stop.mount_kg {
            let _ = writeln!(
                out,
                "  popup(\"Mount {kg} kg, set it as payload, then continue.\", title=\"Calibration\", blocking=True)"
            );
        }
        let joints: Vec<String> = stop.radians.iter().map(|q| format!("{q:.9}")).collect();
        let _ = writeln!(out, "  movej([{}], a=0.5, v=0.5)", joints.join(", "));
        let _ = writeln!(out, "  measure_pose({})", stop.number);
    }
    out += "end\n";
    out
}
