//! A plan as CSV, in the columns of the measurement file; the user adds the instrument's columns.

use std::fmt::Write as _;

use crate::planning::Plan;
use crate::planning::candidates::decimals;
use crate::robot::{Robot, in_file_units};

/// Formats the poses of a plan that are for the calibration (`check` false) or to check it (`check` true). Comments in the
/// file say which poses of the program they are. Without payloads there is no payload column.
pub fn to_csv(robot: &Robot, plan: &Plan, check: bool) -> String {
    let purpose = if check {
        "to check the calibration"
    } else {
        "for the calibration"
    };
    let mut out = format!(
        "# {}: planned poses {purpose}, in the order of the program; add x_mm,y_mm,z_mm,qw,qx,qy,qz as measured\n",
        robot.name
    );
    let has_payload = plan.poses.iter().all(|p| p.payload_kg.is_some());
    if has_payload {
        out += "payload_kg,";
    }
    let _ = writeln!(out, "{}", robot.file_columns().join(","));
    let mut before = None;
    for (number, pose) in (1..).zip(&plan.poses).filter(|(_, p)| p.check == check) {
        let group = pose.payload_kg.map(f64::to_bits);
        if before != Some(group) {
            let last = (number..)
                .zip(&plan.poses[number - 1..])
                .take_while(|(_, p)| p.check == check && p.payload_kg == pose.payload_kg)
                .map(|(i, _)| i)
                .last()
                .unwrap_or(number);
            let _ = writeln!(out, "# poses {number} to {last}");
            before = Some(group);
        }
        if let (true, Some(kg)) = (has_payload, pose.payload_kg) {
            let _ = write!(out, "{kg},");
        }
        let values: Vec<String> = robot
            .joints
            .iter()
            .zip(&pose.joints)
            .map(|(joint, q)| decimals(in_file_units(joint.kind, *q)))
            .collect();
        let _ = writeln!(out, "{}", values.join(","));
    }
    out
}
