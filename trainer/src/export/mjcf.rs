//! A calibrated arm as an MJCF model for MuJoCo: one body for each joint, the flange and the target as sites.
//!
//! A calibration knows no masses, but MuJoCo accepts no moving body without one: each body gets a small mass and inertia,
//! and the file says so. Numbers have all their digits; MuJoCo itself saves six.

use std::fmt::Write;

use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;

use crate::export::CalibratedChain;
use crate::export::describe::comments;
use crate::export::format::{decimals, three, xyz};
use crate::export::poe;
use crate::export::tables::Row;
use crate::export::xml::{comment_lines, escaped};

/// Returns the model. Joints keep their names; bodies are `base_link`, `link_1` …, sites `tool0` (the flange) and `target`.
pub fn text(chain: &CalibratedChain) -> String {
    let mut about = comments(chain, &chain.not_in_new_links());
    about.push(
        "masses and inertias are small placeholders, because MuJoCo requires them: the calibration determines none"
            .to_owned(),
    );
    let mut out = format!(
        "<mujoco model=\"{}\">\n{}  <compiler angle=\"radian\" autolimits=\"true\"/>\n  <worldbody>\n    \
         <body name=\"base_link\">\n",
        escaped(&chain.name),
        comment_lines(&about)
    );
    let table = poe::table(chain);
    let mut indent = "      ".to_owned();
    for (i, (joint, row)) in chain.joints.iter().zip(&table.rows).enumerate() {
        let Row::Frame(frame) = row else { continue };
        let kind = match joint.kind {
            JointKind::Revolute => "hinge",
            JointKind::Prismatic => "slide",
        };
        let range = chain.limits(i).map_or(String::new(), |(lower, upper)| {
            format!(" range=\"{} {}\"", decimals(lower), decimals(upper))
        });
        let _ = writeln!(
            out,
            "{indent}<body name=\"link_{}\" {}>\n\
             {indent}  <inertial pos=\"0 0 0\" mass=\"0.001\" diaginertia=\"0.000001 0.000001 0.000001\"/>\n\
             {indent}  <joint name=\"{}\" type=\"{kind}\" axis=\"0 0 1\"{range}/>",
            i + 1,
            at(frame),
            escaped(&joint.name)
        );
        indent += "  ";
    }
    for (site, pose) in [
        ("tool0", table.flange),
        ("target", table.flange * chain.flange_from_target),
    ] {
        let _ = writeln!(out, "{indent}<site name=\"{site}\" {}/>", at(&pose));
    }
    while indent.len() >= 6 {
        indent.truncate(indent.len() - 2);
        let _ = writeln!(out, "{indent}</body>");
    }
    out += "  </worldbody>\n</mujoco>\n";
    out
}

/// Returns position and quaternion as attributes, the quaternion with its scalar first.
fn at(pose: &Pose<f64>) -> String {
    let (w, v) = pose.quaternion();
    format!(
        "pos=\"{}\" quat=\"{} {}\"",
        three(xyz(pose), " "),
        decimals(w),
        three([v[0], v[1], v[2]], " ")
    )
}
