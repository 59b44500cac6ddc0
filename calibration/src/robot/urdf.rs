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
use urdf_rs::JointType;

use crate::input_error::InputError;
use crate::robot::description::{Joint, LoadOptions, Robot, WITHIN, is_too_long};
use crate::robot::normal_form as chain;
use crate::robot::normal_form::Chain;

/// Names of leaf links that are taken for the flange if there are several leaves, best first.
const FLANGE_NAMES: [&str; 3] = ["tool0", "flange", "ee_link"];

/// Parses the robot of a URDF text; `file` is for messages.
pub(super) fn parse(file: &Path, text: &str, options: &LoadOptions) -> Result<Robot, InputError> {
    let document = document(file, text)?;
    let reader = Reader {
        file,
        text,
        joints: &document.joints,
    };
    let (base, tip, path) = reader.chosen(&document.links, options)?;

    let mut chain = Chain::new();
    for joint in path {
        reader.push(&mut chain, joint)?;
    }
    let name = match document.name.trim() {
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
) -> Result<Vec<urdf_rs::Joint>, InputError> {
    let document = document(file, text)?;
    let reader = Reader {
        file,
        text,
        joints: &document.joints,
    };
    let (_, _, path) = reader.chosen(&document.links, options)?;
    Ok(path.into_iter().cloned().collect())
}

/// Number of elements that may be within each other; a URDF has four.
const DEEPEST: usize = 64;

fn document(file: &Path, text: &str) -> Result<urdf_rs::Robot, InputError> {
    if let Some(line) = too_deep(text) {
        let found = format!("an element within more than {DEEPEST} others");
        let expected = "a URDF, XML with the root element <robot>";
        return Err(InputError::new(file, found, expected).at_line(line));
    }
    urdf_rs::read_from_string(text).map_err(|error| not_urdf(file, text, &error))
}

/// Returns the line at which elements are nested more than [`DEEPEST`] deep: readers of XML call themselves for each.
fn too_deep(text: &str) -> Option<usize> {
    let mut depth = 0_usize;
    let mut rest = text;
    while let Some(start) = rest.find('<') {
        let tag = &rest[start..];
        let end = match tag.starts_with("<!--") {
            true => tag.find("-->"),
            false => tag.find('>'),
        };
        let end = end.unwrap_or(tag.len() - 1);
        let is_inner = tag[..end].ends_with('/') || tag.starts_with("<!") || tag.starts_with("<?");
        if tag.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !is_inner {
            depth += 1;
        }
        if depth > DEEPEST {
            let before = text.len() - tag.len();
            return Some(1 + text[..before].matches('\n').count());
        }
        rest = &tag[end..];
        rest = rest.strip_prefix(['>', '-']).unwrap_or(rest);
        if rest.len() == tag.len() {
            break;
        }
    }
    None
}

fn not_urdf(file: &Path, text: &str, error: &urdf_rs::UrdfError) -> InputError {
    let start = text.trim_start();
    if start.is_empty() {
        return InputError::new(file, "an empty file", "a URDF");
    }
    if !start.starts_with('<') {
        return InputError::new(
            file,
            "text that is not XML",
            "a URDF, XML with the root element <robot>",
        );
    }
    let reason = error.to_string();
    let reason = reason.split_whitespace().collect::<Vec<_>>().join(" ");
    let reason = reason.strip_prefix("custom: ").unwrap_or(&reason);
    let error = match reason.split_once(", expected ") {
        Some((found, expected)) => InputError::new(file, found, expected),
        None => InputError::new(file, reason, "a URDF, XML with the root element <robot>"),
    };
    if ["xacro:", "${"].iter().any(|sign| text.contains(sign)) {
        return error.with_help(
            "expand the xacro first, for example `xacro robot.urdf.xacro > robot.urdf`",
        );
    }
    error
}

/// The links of a file that is a forest: each link has at most one parent.
struct Tree<'a> {
    links: Vec<&'a str>,
    /// For each link, the joint whose child it is.
    parent_joint: HashMap<&'a str, &'a urdf_rs::Joint>,
}

impl<'a> Tree<'a> {
    fn is_leaf(&self, link: &str) -> bool {
        !self
            .parent_joint
            .values()
            .any(|joint| joint.parent.link == link)
    }

    /// Returns whether `base` is `link` itself or one of its ancestors.
    fn is_below(&self, base: &str, link: &str) -> bool {
        let mut at = link;
        while at != base {
            match self.parent_joint.get(at) {
                Some(joint) => at = &joint.parent.link,
                None => return false,
            }
        }
        true
    }
}

struct Reader<'a> {
    file: &'a Path,
    text: &'a str,
    joints: &'a [urdf_rs::Joint],
}

impl<'a> Reader<'a> {
    /// Returns base, tip and the joints between them, of a file that is a tree.
    fn chosen(
        &self,
        links: &'a [urdf_rs::Link],
        options: &LoadOptions,
    ) -> Result<(&'a str, &'a str, Vec<&'a urdf_rs::Joint>), InputError> {
        self.check_names(links)?;
        let tree = self.tree(links)?;
        let base = self.base(&tree, options)?;
        let tip = self.tip(&tree, base, options)?;
        Ok((base, tip, self.path(&tree, base, tip)?))
    }

    fn error(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::new(self.file, found, expected)
    }

    fn joint_error(
        &self,
        joint: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        let error = self.error(found, expected);
        match line_of_joint(self.text, joint) {
            Some(line) => error.at_line(line),
            None => error,
        }
    }

    /// Checks names: each link and joint name occurs once, and every link that a joint names exists.
    fn check_names(&self, links: &'a [urdf_rs::Link]) -> Result<(), InputError> {
        for (i, link) in links.iter().enumerate() {
            if links[..i].iter().any(|other| other.name == link.name) {
                return Err(self.error(
                    format!("two links named \"{}\"", link.name),
                    "every link once, by a name of its own",
                ));
            }
        }
        for (i, joint) in self.joints.iter().enumerate() {
            if self.joints[..i]
                .iter()
                .any(|other| other.name == joint.name)
            {
                return Err(self.joint_error(
                    &joint.name,
                    format!("two joints named \"{}\"", joint.name),
                    "every joint once, by a name of its own",
                ));
            }
            for (role, name) in [("parent", &joint.parent.link), ("child", &joint.child.link)] {
                if !links.iter().any(|link| link.name == *name) {
                    return Err(self.joint_error(
                        &joint.name,
                        format!("the {role} link \"{name}\" of joint \"{}\"", joint.name),
                        format!(
                            "one of the links {}",
                            list(links.iter().map(|l| l.name.as_str()))
                        ),
                    ));
                }
            }
        }
        Ok(())
    }

    /// Connects every link to its parent and refuses loops.
    fn tree(&self, links: &'a [urdf_rs::Link]) -> Result<Tree<'a>, InputError> {
        let mut parent_joint: HashMap<&str, &urdf_rs::Joint> = HashMap::new();
        for joint in self.joints {
            if let Some(other) = parent_joint.insert(&joint.child.link, joint) {
                return Err(self.joint_error(
                    &joint.name,
                    format!(
                        "a loop: link \"{}\" is the child of the joints \"{}\" and \"{}\"",
                        joint.child.link, other.name, joint.name
                    ),
                    "a tree, where every link has at most one parent",
                ));
            }
        }
        for link in links {
            let mut at = link.name.as_str();
            for _ in 0..=links.len() {
                match parent_joint.get(at) {
                    Some(joint) => at = &joint.parent.link,
                    None => break,
                }
            }
            if let Some(joint) = parent_joint.get(at) {
                return Err(self.joint_error(
                    &joint.name,
                    format!("a loop through link \"{at}\" and joint \"{}\"", joint.name),
                    "a tree, where no link is above itself",
                ));
            }
        }
        Ok(Tree {
            links: links.iter().map(|link| link.name.as_str()).collect(),
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
    ) -> Result<Vec<&'a urdf_rs::Joint>, InputError> {
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
            at = &joint.parent.link;
        }
        path.reverse();
        Ok(path)
    }

    fn push(&self, chain: &mut Chain, joint: &urdf_rs::Joint) -> Result<(), InputError> {
        let name = &joint.name;
        let (xyz, rpy, axis) = (*joint.origin.xyz, *joint.origin.rpy, *joint.axis.xyz);
        for (what, values) in [("origin xyz", &xyz), ("origin rpy", &rpy), ("axis", &axis)] {
            if let Some(value) = values.iter().find(|value| !value.is_finite()) {
                let found = format!("{value} in the {what} of joint \"{name}\"");
                return Err(self.joint_error(name, found, "finite numbers"));
            }
        }
        chain.push_fixed(chain::origin(xyz, rpy));
        let kind = match joint.joint_type {
            JointType::Fixed => return Ok(()),
            JointType::Revolute | JointType::Continuous => JointKind::Revolute,
            JointType::Prismatic => JointKind::Prismatic,
            ref other => {
                return Err(self.joint_error(
                    name,
                    format!(
                        "joint \"{name}\" of type {}",
                        format!("{other:?}").to_lowercase()
                    ),
                    "revolute, continuous, prismatic or fixed joints between base and tip",
                ));
            }
        };
        if let Some(mimic) = &joint.mimic {
            return Err(self
                .joint_error(
                    name,
                    format!("joint \"{name}\", which mimics \"{}\"", mimic.joint),
                    "joints that move on their own between base and tip",
                )
                .with_help(
                    "a linear coupling of joints is described by `coupling` in a TOML description",
                ));
        }
        let axis = Vector3::from(axis);
        let length = chain::norm(&axis);
        if !(length > 1e-9 && length.is_finite()) {
            let found = format!(
                "the axis {} {} {} of joint \"{name}\"",
                axis[0], axis[1], axis[2]
            );
            return Err(self.joint_error(name, found, "an axis that is not zero"));
        }
        let limits = self.limits(joint)?;
        chain.push_joint(
            Joint {
                name: name.clone(),
                kind,
                limits,
                gear_lines: Vec::new(),
                link_radius: None,
            },
            &axis,
        );
        Ok(())
    }

    fn limits(&self, joint: &urdf_rs::Joint) -> Result<Option<(f64, f64)>, InputError> {
        let (lower, upper) = (joint.limit.lower, joint.limit.upper);
        if joint.joint_type == JointType::Continuous || (lower == 0.0 && upper == 0.0) {
            return Ok(None);
        }
        if lower.is_nan() || upper.is_nan() || lower > upper {
            return Err(self.joint_error(
                &joint.name,
                format!("the limits {lower} to {upper} of joint \"{}\"", joint.name),
                "a lower limit that is not above the upper one",
            ));
        }
        let limits = (lower.is_finite() && upper.is_finite()).then_some((lower, upper));
        if joint.joint_type == JointType::Prismatic && limits.is_some_and(is_too_long) {
            let found = format!(
                "the limits {lower} to {upper} m of joint \"{}\"",
                joint.name
            );
            return Err(self.joint_error(&joint.name, found, WITHIN));
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

/// Returns the line of the (last) start tag of joint `name`. The XML reader keeps no positions, so the text is searched.
fn line_of_joint(text: &str, name: &str) -> Option<usize> {
    let quoted = [format!("name=\"{name}\""), format!("name='{name}'")];
    let starts = text.match_indices("<joint").map(|(start, _)| start);
    let found = starts.filter(|start| {
        let tag = text[*start..].split('>').next().unwrap_or("");
        quoted.iter().any(|name| tag.contains(name.as_str()))
    });
    found
        .last()
        .map(|start| 1 + text[..start].matches('\n').count())
}
