//! A calibrated arm as a URDF: the nominal file with corrected transforms, or a file of links and joints alone.
//!
//! Every link between base and tip stays where the nominal file has it, as near as the calibrated axes allow, and joint
//! axes stay unchanged in their links; so what is attached to the links (meshes, inertias, cameras) stays valid. Only
//! the `<origin>` of each moving joint changes, and that of the first fixed joint behind the last moving one, which brings
//! the tip to the calibrated flange. Where there is no such fixed joint, a link and a fixed joint are added.

use std::fmt::Write;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;

use crate::export::calibrated_chain::at_zero;
use crate::export::describe::comments;
use crate::export::format::{decimals, rpy, three, xyz};
use crate::export::xml::{comment_lines, escaped};
use crate::export::{CalibratedChain, gauge};
use poegp_calibration::input_error::is_printable;
use poegp_calibration::robot::normal_form::{origin, rotation_to_axis};
use poegp_calibration::robot::urdf_document::UrdfJoint;

/// Name of the link that is added where the tip cannot be the calibrated flange.
pub const FLANGE_LINK: &str = "calibrated_flange";

/// A new origin of a joint.
#[derive(Clone, Debug)]
pub struct Corrected {
    /// Name of the joint.
    pub joint: String,
    /// Origin in the nominal file, `parent_from_child`.
    pub before: Pose<f64>,
    /// Calibrated origin, `parent_from_child`.
    pub after: Pose<f64>,
}

/// An added link, held by a fixed joint.
#[derive(Clone, Debug)]
pub struct Added {
    /// Link that it is fixed to.
    pub parent: String,
    /// Name of the link; the name of its joint is this with `_joint`.
    pub link: String,
    /// Pose of the link, `parent_from_link`.
    pub pose: Pose<f64>,
}

impl Added {
    /// Returns the name of the fixed joint that holds the link.
    pub fn joint(&self) -> String {
        format!("{}_joint", self.link)
    }
}

/// A name for the link of the target that a URDF cannot have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BadLink {
    /// What was found, for a message.
    pub found: String,
}

/// What is expected instead of a [`BadLink`].
pub const NEW_LINK: &str = "a new name for the link that is added";

/// Refuses to add a link whose name, or whose joint's name, is taken or shows nothing.
pub fn check_added(
    added: &Added,
    links: &[impl AsRef<str>],
    joints: &[impl AsRef<str>],
) -> Result<(), BadLink> {
    let bad = |found| Err(BadLink { found });
    let joint = added.joint();
    if added.link.trim().is_empty() {
        return bad(format!("a link without a name, {:?}", added.link));
    }
    if !is_printable(&added.link) {
        return bad(format!("{:?}, with a control character", added.link));
    }
    if links.iter().any(|link| link.as_ref() == added.link) {
        return bad(format!("a link \"{}\" already", added.link));
    }
    if joints.iter().any(|other| other.as_ref() == joint) {
        return bad(format!("a joint \"{joint}\" already"));
    }
    Ok(())
}

/// Changes to a nominal file.
#[derive(Clone, Debug)]
pub struct Changes {
    /// New origins, base first.
    pub corrected: Vec<Corrected>,
    /// Added links.
    pub added: Vec<Added>,
}

/// Returns the changes that turn the chain of `joints` (base to tip, fixed ones too) into the calibrated one. `target_link`
/// names a link to be added at the target.
pub fn changes(
    chain: &CalibratedChain,
    joints: &[UrdfJoint],
    target_link: Option<&str>,
) -> Changes {
    let calibrated = at_zero(&chain.to_flange());
    let flange = calibrated[calibrated.len() - 1];
    let nominal_origin = |joint: &UrdfJoint| origin(joint.xyz, joint.rpy);
    let last_moving = joints.iter().rposition(UrdfJoint::moves).unwrap_or(0);
    let mut corrected = Vec::new();
    // Poses of the links at joint values zero, in the nominal file and in the new one.
    let (mut nominal, mut new) = (Pose::identity(), Pose::identity());
    let mut moving = 0;
    for (i, joint) in joints.iter().enumerate() {
        let before = nominal_origin(joint);
        nominal = nominal * before;
        let mut after = before;
        if joint.moves() {
            // A frame with the calibrated axis as its z, and from that frame the pose of the link.
            let link_from_normal = rotation_to_axis(&Vector3::from(joint.axis));
            let normal = gauge::nearest_on_axis(&calibrated[moving], &(nominal * link_from_normal));
            after = new.inverse() * (normal * link_from_normal.inverse());
            moving += 1;
        } else if i == last_moving + 1 {
            let behind = joints[i + 1..]
                .iter()
                .fold(Pose::identity(), |pose, joint| pose * nominal_origin(joint));
            after = new.inverse() * flange * behind.inverse();
        }
        new = new * after;
        let changes = joint.moves() || i == last_moving + 1;
        if changes {
            corrected.push(Corrected {
                joint: joint.name.clone(),
                before,
                after,
            });
        }
    }
    let mut tip = joints
        .last()
        .map_or_else(String::new, |joint| joint.child.clone());
    let mut added = Vec::new();
    if last_moving + 1 == joints.len() {
        added.push(Added {
            parent: tip,
            link: FLANGE_LINK.to_owned(),
            pose: new.inverse() * flange,
        });
        tip = FLANGE_LINK.to_owned();
    }
    if let Some(link) = target_link {
        added.push(Added {
            parent: tip,
            link: link.to_owned(),
            pose: chain.flange_from_target,
        });
    }
    Changes { corrected, added }
}

/// Returns a URDF of links without shapes, for arms without a URDF: base_link, a link behind every joint, tool0 (the
/// flange).
///
/// # Errors
/// [`BadLink`] where `target_link` is taken.
pub fn minimal(chain: &CalibratedChain, target_link: Option<&str>) -> Result<String, BadLink> {
    let nominal = at_zero(&chain.nominal_to_flange());
    let calibrated = at_zero(&chain.to_flange());
    let n = chain.joints.len();
    let mut out = String::from("<?xml version=\"1.0\"?>\n");
    out += &comment(chain, &chain.not_in_new_links());
    let _ = writeln!(out, "<robot name=\"{}\">", escaped(&chain.name));
    let link = |i: usize| match i {
        0 => "base_link".to_owned(),
        i if i > n => "tool0".to_owned(),
        i => format!("link_{i}"),
    };
    let links: Vec<String> = (0..=n + 1).map(link).collect();
    for name in &links {
        let _ = writeln!(out, "  <link name=\"{name}\"/>");
    }
    let mut before = Pose::identity();
    for (i, joint) in chain.joints.iter().enumerate() {
        let frame = gauge::nearest_on_axis(&calibrated[i], &nominal[i]);
        let limits = chain.limits(i);
        let kind = match (joint.kind, limits) {
            (JointKind::Prismatic, _) => "prismatic",
            (JointKind::Revolute, Some(_)) => "revolute",
            (JointKind::Revolute, None) => "continuous",
        };
        let _ = writeln!(
            out,
            "  <joint name=\"{}\" type=\"{kind}\">\n    <parent link=\"{}\"/>\n    <child link=\"{}\"/>\n    {}\n    \
             <axis xyz=\"0 0 1\"/>",
            escaped(&joint.name),
            link(i),
            link(i + 1),
            origin_tag(&(before.inverse() * frame), "/")
        );
        // Most readers refuse a URDF without effort and velocity; 0 stands for "not stated".
        match (limits, kind) {
            (Some((lower, upper)), _) => {
                let _ = writeln!(
                    out,
                    "    <limit lower=\"{}\" upper=\"{}\" effort=\"0\" velocity=\"0\"/>",
                    decimals(lower),
                    decimals(upper)
                );
            }
            (None, "prismatic") => {
                out += "    <limit lower=\"-100\" upper=\"100\" effort=\"0\" velocity=\"0\"/>\n";
            }
            (None, _) => {}
        }
        out += "  </joint>\n";
        before = frame;
    }
    let held = |parent: String, link: &str, pose: Pose<f64>| Added {
        parent,
        link: link.to_owned(),
        pose,
    };
    let flange = held(link(n), "tool0", before.inverse() * calibrated[n]);
    out += &added_joint("  ", &flange);
    if let Some(target) = target_link {
        let target = held(flange.link.clone(), target, chain.flange_from_target);
        let mut joints: Vec<&str> = chain.joints.iter().map(|j| j.name.as_str()).collect();
        let of_flange = flange.joint();
        joints.push(&of_flange);
        check_added(&target, &links, &joints)?;
        let _ = writeln!(out, "  <link name=\"{}\"/>", escaped(&target.link));
        out += &added_joint("  ", &target);
    }
    out += "</robot>\n";
    Ok(out)
}

/// Returns an XML comment on the calibration, for a file that leaves these parts of the model out.
pub(super) fn comment(chain: &CalibratedChain, left_out: &[String]) -> String {
    let mut lines = comments(chain, left_out);
    lines.push(format!(
        "the target in the flange (the tip): xyz {} m, rpy {} rad",
        three(xyz(&chain.flange_from_target), " "),
        three(rpy(&chain.flange_from_target), " ")
    ));
    comment_lines(&lines)
}

/// Returns an `<origin …/>` tag, closed by `end`.
pub(super) fn origin_tag(pose: &Pose<f64>, end: &str) -> String {
    format!(
        "<origin xyz=\"{}\" rpy=\"{}\"{end}>",
        three(xyz(pose), " "),
        three(rpy(pose), " ")
    )
}

/// Returns the fixed joint that holds an added link.
pub(super) fn added_joint(indent: &str, added: &Added) -> String {
    let (parent, link) = (escaped(&added.parent), escaped(&added.link));
    let name = escaped(&added.joint());
    format!(
        "{indent}<joint name=\"{name}\" type=\"fixed\">\n{indent}{indent}<parent link=\"{parent}\"/>\n\
         {indent}{indent}<child link=\"{link}\"/>\n{indent}{indent}{}\n{indent}</joint>\n",
        origin_tag(&added.pose, "/")
    )
}
