//! A plan of touches as the files that the operator fills in.

use nalgebra::Vector3;

use crate::planning::candidates::decimals;
use crate::planning::touches::{Goal, TouchPlan};
use crate::robot::{Robot, in_file_units};

/// Returns the names of the features: socket/0, socket/1, plane/0 ….
pub fn feature_names(goals: &[Goal]) -> Vec<String> {
    let number = |k: usize| {
        goals[..k]
            .iter()
            .filter(|g| g.word() == goals[k].word())
            .count()
    };
    let name = |k: usize| format!("{}/{}", goals[k].word(), number(k));
    (0..goals.len()).map(name).collect()
}

/// Formats the plan as a touch file, whose rows say where to touch. The operator adds the reading of a wire.
pub fn to_csv(robot: &Robot, goals: &[Goal], plan: &TouchPlan) -> String {
    let names = feature_names(goals);
    let has_wire = goals.iter().any(|goal| matches!(goal, Goal::Wire(_)));
    let value = if has_wire { ",value_mm" } else { "" };
    let mut out = format!(
        "# {}: planned touches, in this order; move the tip there and record the joints that the controller then \
         shows\nfeature{value}",
        robot.name
    );
    out += &format!(",{}\n", robot.file_columns().join(","));
    for touch in &plan.touches {
        out += &names[touch.goal];
        out += if has_wire { "," } else { "" };
        for (joint, q) in robot.joints.iter().zip(&touch.joints) {
            out += &format!(",{}", decimals(in_file_units(joint.kind, *q)));
        }
        out.push('\n');
    }
    out
}

/// Formats the description of a plan's features; the operator adds what the plan does not know.
pub fn to_toml(goals: &[Goal], tip: &Vector3<f64>) -> String {
    let names = feature_names(goals);
    let mm =
        |at: &Vector3<f64>| format!("[{:.1}, {:.1}, {:.1}]", 1e3 * at.x, 1e3 * at.y, 1e3 * at.z);
    let mut out = format!(
        "version = 1\n\n[noise]\ntouch_mm = 0.05\n\n[[target]]\nname = \"tip\"\ntip_mm = {}\nsigma_mm = 5\n",
        mm(tip)
    );
    for (goal, name) in goals.iter().zip(&names) {
        out += &format!(
            "\n[[feature]]\nname = \"{name}\"\nkind = \"{}\"\n",
            goal.kind()
        );
        if let Goal::Wire(anchor) = goal {
            out += &format!(
                "position_mm = {}\nposition_sigma_mm = 20\nzero_sigma_mm = 20\nscale_sigma_ppm = 500\n",
                mm(anchor)
            );
        }
    }
    let sockets: Vec<&String> = goals
        .iter()
        .zip(&names)
        .filter(|(goal, _)| matches!(goal, Goal::Socket(_)))
        .map(|(_, name)| name)
        .collect();
    if let [a, b, ..] = sockets.as_slice() {
        out += &format!(
            "\n# The distance between two sockets, where it is measured:\n# [[distance]]\n# between = [\"{a}\", \"{b}\"]\n# mm = 300.0\n# sigma_mm = 0.02\n"
        );
    }
    out
}
