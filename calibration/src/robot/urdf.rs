//! The URDF reader: extracts one serial chain, from base to tip, of a tree of links.
//!
//! Only the joints between base and tip matter, whatever else the file describes (grippers, mimic joints, cameras). But a
//! link with two parents or a cycle anywhere is refused: such a file is not a tree, and its chain would be a guess. Axes
//! need not be unit vectors; their length is not used. A joint is unlimited if it has no `<limit>` (or the limits 0, 0 that
//! stand for none), an infinite limit, or the type `continuous`.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::JointKind;

use crate::input_error::InputError;
use crate::robot::description::{self, LoadOptions, Robot, WITHIN, is_too_long};
use crate::robot::normal_form as chain;
use crate::robot::normal_form::Chain;
use crate::robot::urdf_document::{Document, Joint, UrdfJoint, UrdfKind};

/// Names of leaf links that are taken for the flange if there are several leaves, best first.
const FLANGE_NAMES: [&str; 3] = ["tool0", "flange", "ee_link"];

/// Parses the robot of a URDF text; `file` is for messages.
pub(super) fn parse(file: &Path, text: &str, options: &LoadOptions) -> Result<Robot, InputError> {
    let document = Document::parse(file, text)?;
    let (links, joints) = (document.links()?, document.joints()?);
    let reader = Reader {
        file,
        document: &document,
        joints: &joints,
    };
    let (base, tip, path) = reader.chosen(&links, options)?;

    let mut chain = Chain::new();
    for joint in path {
        reader.push(&mut chain, joint)?;
    }
    let name = match document.name().trim() {
        "" => file
            .file_stem()
            .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned()),
        name => name.to_owned(),
    };
    chain.finish(name, None).map_err(|error| {
        let (found, expected) = error.describe();
        InputError::new(
            file,
            format!("{found} between \"{base}\" and \"{tip}\""),
            expected,
        )
        .with_help("another base or tip link chooses another part of the arm")
    })
}

/// Returns the joints between base and tip of a URDF text, fixed ones included, base first; `file` is for messages. It
/// serves to write the file again; `parse` interprets the joints.
pub fn joints_of_chain(
    file: &Path,
    text: &str,
    options: &LoadOptions,
) -> Result<Vec<UrdfJoint>, InputError> {
    let document = Document::parse(file, text)?;
    let (links, joints) = (document.links()?, document.joints()?);
    let reader = Reader {
        file,
        document: &document,
        joints: &joints,
    };
    let (_, _, path) = reader.chosen(&links, options)?;
    path.into_iter()
        .map(|joint| joint.read(&document))
        .collect()
}

/// The links of a file that is a forest: each link has at most one parent.
struct Tree<'a> {
    links: Vec<&'a str>,
    /// For each link, the joint whose child it is.
    parent_joint: HashMap<&'a str, &'a Joint<'a>>,
}

impl<'a> Tree<'a> {
    fn is_leaf(&self, link: &str) -> bool {
        !self.parent_joint.values().any(|joint| joint.parent == link)
    }

    /// Returns whether `base` is `link` itself or one of its ancestors.
    fn is_below(&self, base: &str, link: &str) -> bool {
        let mut at = link;
        while at != base {
            match self.parent_joint.get(at) {
                Some(joint) => at = joint.parent,
                None => return false,
            }
        }
        true
    }
}

struct Reader<'a> {
    file: &'a Path,
    document: &'a Document<'a>,
    joints: &'a [Joint<'a>],
}

impl<'a> Reader<'a> {
    /// Returns base, tip and the joints between them, of a file that is a tree.
    fn chosen(
        &self,
        links: &[&'a str],
        options: &LoadOptions,
    ) -> Result<(&'a str, &'a str, Vec<&'a Joint<'a>>), InputError> {
        self.check_names(links)?;
        let tree = self.tree(links)?;
        let base = self.base(&tree, options)?;
        let tip = self.tip(&tree, base, options)?;
        Ok((base, tip, self.path(&tree, base, tip)?))
    }

    fn error(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::new(self.file, found, expected)
    }

    /// Checks names: each link and joint name occurs once, and every link that a joint names exists.
    fn check_names(&self, links: &[&'a str]) -> Result<(), InputError> {
        for (i, link) in links.iter().enumerate() {
            if links[..i].contains(link) {
                return Err(self.error(
                    format!("two links named \"{link}\""),
                    "every link once, by a name of its own",
                ));
            }
        }
        for (i, joint) in self.joints.iter().enumerate() {
            if self.joints[..i]
                .iter()
                .any(|other| other.name == joint.name)
            {
                return Err(self.document.joint_error(
                    joint,
                    format!("two joints named \"{}\"", joint.name),
                    "every joint once, by a name of its own",
                ));
            }
            for (role, name) in [("parent", joint.parent), ("child", joint.child)] {
                if !links.contains(&name) {
                    return Err(self.document.joint_error(
                        joint,
                        format!("the {role} link \"{name}\" of joint \"{}\"", joint.name),
                        format!("one of the links {}", list(links.iter().copied())),
                    ));
                }
            }
        }
        Ok(())
    }

    /// Connects every link to its parent and refuses loops.
    fn tree(&self, links: &[&'a str]) -> Result<Tree<'a>, InputError> {
        let mut parent_joint: HashMap<&'a str, &'a Joint<'a>> = HashMap::new();
        for joint in self.joints {
            if let Some(other) = parent_joint.insert(joint.child, joint) {
                return Err(self.document.joint_error(
                    joint,
                    format!(
                        "a loop: link \"{}\" is the child of the joints \"{}\" and \"{}\"",
                        joint.child, other.name, joint.name
                    ),
                    "a tree, where every link has at most one parent",
                ));
            }
        }
        for link in links {
            let mut at = *link;
            for _ in 0..=links.len() {
                match parent_joint.get(at) {
                    Some(joint) => at = joint.parent,
                    None => break,
                }
            }
            if let Some(joint) = parent_joint.get(at) {
                return Err(self.document.joint_error(
                    joint,
                    format!("a loop through link \"{at}\" and joint \"{}\"", joint.name),
                    "a tree, where no link is above itself",
                ));
            }
        }
        Ok(Tree {
            links: links.to_vec(),
            parent_joint,
        })
    }

    fn known(&self, tree: &Tree<'a>, role: &str, name: &str) -> Result<&'a str, InputError> {
        tree.links
            .iter()
            .copied()
            .find(|link| *link == name)
            .ok_or_else(|| {
                self.error(
                    format!("the {role} link \"{name}\", which is not in the file"),
                    format!("one of the links {}", list(tree.links.iter().copied())),
                )
            })
    }

    fn base(&self, tree: &Tree<'a>, options: &LoadOptions) -> Result<&'a str, InputError> {
        if let Some(name) = &options.base {
            return self.known(tree, "base", name);
        }
        let is_root = |link: &&&str| !tree.parent_joint.contains_key(**link);
        let roots: Vec<&'a str> = tree.links.iter().filter(is_root).copied().collect();
        match roots[..] {
            [root] => Ok(root),
            [] => Err(self
                .error("no link", "a tree of links and joints")
                .with_help("a URDF has the root element <robot>")),
            _ => Err(self
                .error(
                    format!("several root links: {}", list(roots.iter().copied())),
                    "one root link",
                )
                .with_help("say which link is the base")),
        }
    }

    fn tip(
        &self,
        tree: &Tree<'a>,
        base: &str,
        options: &LoadOptions,
    ) -> Result<&'a str, InputError> {
        if let Some(name) = &options.tip {
            return self.known(tree, "tip", name);
        }
        let is_below = |link: &&str| tree.is_leaf(link) && tree.is_below(base, link);
        let leaves: Vec<&'a str> = tree.links.iter().copied().filter(is_below).collect();
        if let [leaf] = leaves[..] {
            return Ok(leaf);
        }
        let flange = FLANGE_NAMES
            .iter()
            .find_map(|name| leaves.iter().find(|leaf| *leaf == name));
        flange.copied().ok_or_else(|| {
            self.error(
                format!("several leaf links: {}", list(leaves.iter().copied())),
                format!("one leaf link, or one named {}", FLANGE_NAMES.join(", ")),
            )
            .with_help("say which link is the tip (the flange)")
        })
    }

    /// Returns the joints from base to tip.
    fn path(
        &self,
        tree: &Tree<'a>,
        base: &str,
        tip: &str,
    ) -> Result<Vec<&'a Joint<'a>>, InputError> {
        let mut path = Vec::new();
        let mut at = tip;
        while at != base {
            let Some(joint) = tree.parent_joint.get(at) else {
                return Err(self.error(
                    format!("no chain from \"{base}\" to \"{tip}\""),
                    format!(
                        "a tip that is below the base; the links are {}",
                        list(tree.links.iter().copied())
                    ),
                ));
            };
            path.push(*joint);
            at = joint.parent;
        }
        path.reverse();
        Ok(path)
    }

    fn push(&self, chain: &mut Chain, joint: &Joint<'_>) -> Result<(), InputError> {
        let read = joint.read(self.document)?;
        chain.push_fixed(chain::origin(read.xyz, read.rpy));
        let kind = match read.kind {
            UrdfKind::Fixed => return Ok(()),
            UrdfKind::Revolute | UrdfKind::Continuous => JointKind::Revolute,
            UrdfKind::Prismatic => JointKind::Prismatic,
        };
        let axis = Vector3::from(read.axis);
        let length = chain::norm(&axis);
        if !(length > 1e-9 && length.is_finite()) {
            let [x, y, z] = read.axis;
            let found = format!("the axis {x} {y} {z} of joint \"{}\"", read.name);
            let expected = "an axis that is not zero";
            return Err(self.document.joint_error(joint, found, expected));
        }
        let limits = self.limits(joint, &read)?;
        chain.push_joint(
            description::Joint {
                name: read.name,
                kind,
                limits,
                gear_lines: Vec::new(),
                link_radius: None,
            },
            &axis,
        );
        Ok(())
    }

    fn limits(
        &self,
        joint: &Joint<'_>,
        read: &UrdfJoint,
    ) -> Result<Option<(f64, f64)>, InputError> {
        let (lower, upper) = read.limits;
        if read.kind == UrdfKind::Continuous || (lower == 0.0 && upper == 0.0) {
            return Ok(None);
        }
        let of = format!("of joint \"{}\"", read.name);
        if lower.is_nan() || upper.is_nan() || lower > upper {
            let found = format!("the limits {lower} to {upper} {of}");
            let expected = "a lower limit that is not above the upper one";
            return Err(self.document.joint_error(joint, found, expected));
        }
        let limits = (lower.is_finite() && upper.is_finite()).then_some((lower, upper));
        if read.kind == UrdfKind::Prismatic && limits.is_some_and(is_too_long) {
            let found = format!("the limits {lower} to {upper} m {of}");
            return Err(self.document.joint_error(joint, found, WITHIN));
        }
        Ok(limits)
    }
}

fn list<'b>(names: impl Iterator<Item = &'b str>) -> String {
    names
        .map(|name| format!("\"{name}\""))
        .collect::<Vec<_>>()
        .join(", ")
}
