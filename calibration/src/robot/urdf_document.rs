//! The links and joints of a URDF text, each with its place, before anything is made of them.
//!
//! Numbers and attributes are read only of the joints of the arm: grippers, meshes and inertias may be as they are.

use std::path::Path;

use roxmltree::{Document as Xml, Node, ParsingOptions};

use crate::input_error::InputError;

/// Attributes that an element of a joint may have. Others would change the arm, and are not understood.
const KNOWN: [(&str, &[&str]); 2] = [("origin", &["xyz", "rpy"]), ("axis", &["xyz"])];
const WHOLE: &str = "a URDF, XML with the root element <robot>";

/// A URDF as XML.
pub(super) struct Document<'a> {
    file: &'a Path,
    xml: Xml<'a>,
}

/// A joint whose links are known.
pub(super) struct Joint<'a> {
    node: Node<'a, 'a>,
    pub(super) name: &'a str,
    pub(super) parent: &'a str,
    pub(super) child: &'a str,
}

/// Kind of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UrdfKind {
    /// Turns about its axis within limits.
    Revolute,
    /// Turns about its axis without limits.
    Continuous,
    /// Moves along its axis.
    Prismatic,
    /// Does not move.
    Fixed,
}

/// All that an arm needs of a joint, as the file states it.
#[derive(Clone, Debug)]
pub struct UrdfJoint {
    /// Its name.
    pub name: String,
    /// Its kind.
    pub kind: UrdfKind,
    /// Name of the link that it moves.
    pub child: String,
    /// Position of its origin in the parent link, in m.
    pub xyz: [f64; 3],
    /// Roll, pitch and yaw of its origin, in rad.
    pub rpy: [f64; 3],
    /// Its axis, which need not be a unit vector.
    pub axis: [f64; 3],
    /// Lower and upper limit in rad or m; 0 where the file has none.
    pub limits: (f64, f64),
}

impl UrdfJoint {
    /// Returns whether it moves.
    pub fn moves(&self) -> bool {
        self.kind != UrdfKind::Fixed
    }
}

impl<'a> Document<'a> {
    /// Parses a text; `file` is for messages.
    pub(super) fn parse(file: &'a Path, text: &'a str) -> Result<Self, InputError> {
        let start = text.trim_start();
        if start.is_empty() {
            return Err(InputError::new(file, "an empty file", "a URDF"));
        }
        if !start.starts_with('<') {
            return Err(InputError::new(file, "text that is not XML", WHOLE));
        }
        let options = ParsingOptions {
            allow_dtd: true,
            ..ParsingOptions::default()
        };
        let unreadable = |error: roxmltree::Error| {
            let at = error.pos();
            let message = error.to_string();
            let found = message
                .rsplit_once(" at ")
                .map_or(message.as_str(), |(what, _)| what);
            let error = InputError::new(file, format!("XML with an error: {found}"), WHOLE)
                .at_line(at.row as usize)
                .at_column(at.col as usize, "");
            with_xacro_help(error, text)
        };
        let xml = Xml::parse_with_options(text, options).map_err(unreadable)?;
        let document = Self { file, xml };
        let root = document.xml.root_element();
        if !root.has_tag_name("robot") {
            let found = format!("the root element <{}>", root.tag_name().name());
            return Err(document.error(root, found, WHOLE));
        }
        Ok(document)
    }

    /// Returns the robot's name, "" if it has none.
    pub(super) fn name(&self) -> &str {
        self.xml.root_element().attribute("name").unwrap_or("")
    }

    /// Returns the names of all links.
    pub(super) fn links(&self) -> Result<Vec<&str>, InputError> {
        self.all("link")
            .map(|node| self.attribute(node, "name"))
            .collect()
    }

    /// Returns all joints.
    pub(super) fn joints(&self) -> Result<Vec<Joint<'_>>, InputError> {
        let joint = |node| {
            let link = |role| self.attribute(self.one(node, role)?, "link");
            Ok(Joint {
                node,
                name: self.attribute(node, "name")?,
                parent: link("parent")?,
                child: link("child")?,
            })
        };
        self.all("joint").map(joint).collect()
    }

    fn all(&self, element: &'static str) -> impl Iterator<Item = Node<'_, '_>> {
        let root = self.xml.root_element();
        root.children().filter(move |c| c.has_tag_name(element))
    }

    /// Creates an error at an element.
    fn error(
        &self,
        node: Node<'_, '_>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        let at = self.xml.text_pos_at(node.range().start);
        InputError::new(self.file, found, expected)
            .at_line(at.row as usize)
            .at_column(at.col as usize, "")
    }

    /// Creates an error at a joint.
    pub(super) fn joint_error(
        &self,
        joint: &Joint<'_>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        self.error(joint.node, found, expected)
    }

    fn attribute<'n>(&self, node: Node<'n, 'n>, name: &str) -> Result<&'n str, InputError> {
        node.attribute(name).ok_or_else(|| {
            let found = format!("<{}> without {name}", node.tag_name().name());
            self.error(node, found, format!("the attribute {name}"))
        })
    }

    /// Returns the only element of this name in `node`.
    fn one<'n>(&self, node: Node<'n, 'n>, element: &str) -> Result<Node<'n, 'n>, InputError> {
        let found = || format!("<{}> without <{element}>", node.tag_name().name());
        self.at_most_one(node, element)?
            .ok_or_else(|| self.error(node, found(), format!("<{element}> once")))
    }

    fn at_most_one<'n>(
        &self,
        node: Node<'n, 'n>,
        element: &str,
    ) -> Result<Option<Node<'n, 'n>>, InputError> {
        let mut all = node.children().filter(|c| c.has_tag_name(element));
        let first = all.next();
        match all.next() {
            Some(second) => {
                let found = format!("a second <{element}>");
                Err(self.error(second, found, format!("<{element}> once")))
            }
            None => Ok(first),
        }
    }
}

impl Joint<'_> {
    /// Reads what an arm needs of the joint.
    pub(super) fn read(&self, of: &Document<'_>) -> Result<UrdfJoint, InputError> {
        let name = self.name;
        let kind = match of.attribute(self.node, "type")? {
            "revolute" => UrdfKind::Revolute,
            "continuous" => UrdfKind::Continuous,
            "prismatic" => UrdfKind::Prismatic,
            "fixed" => UrdfKind::Fixed,
            other => {
                let found = format!("joint \"{name}\" of type {other}");
                let expected =
                    "revolute, continuous, prismatic or fixed joints between base and tip";
                return Err(self.error(of, found, expected));
            }
        };
        if let Some(mimic) = of.at_most_one(self.node, "mimic")? {
            let other = mimic.attribute("joint").unwrap_or("");
            let found = format!("joint \"{name}\", which mimics \"{other}\"");
            let expected = "joints that move on their own between base and tip";
            let help =
                "a linear coupling of joints is described by `coupling` in a TOML description";
            return Err(self.error(of, found, expected).with_help(help));
        }
        for (element, known) in KNOWN {
            let Some(node) = of.at_most_one(self.node, element)? else {
                continue;
            };
            if let Some(other) = node.attributes().find(|a| !known.contains(&a.name())) {
                let found = format!("{} in the {element} of joint \"{name}\"", other.name());
                return Err(of.error(node, found, known.join(" and ")));
            }
        }
        let limit = of.at_most_one(self.node, "limit")?;
        let limit = |key| match limit.and_then(|node| Some((node, node.attribute(key)?))) {
            Some((node, text)) => text.trim().parse().map_err(|_| {
                let found = format!("\"{text}\" as the {key} limit of joint \"{name}\"");
                of.error(node, found, "a number")
            }),
            None => Ok(0.0),
        };
        Ok(UrdfJoint {
            name: name.to_owned(),
            kind,
            child: self.child.to_owned(),
            xyz: self.vector(of, "origin", "xyz", [0.0; 3])?,
            rpy: self.vector(of, "origin", "rpy", [0.0; 3])?,
            axis: self.vector(of, "axis", "xyz", [1.0, 0.0, 0.0])?,
            limits: (limit("lower")?, limit("upper")?),
        })
    }

    fn error(
        &self,
        of: &Document<'_>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        of.joint_error(self, found, expected)
    }

    /// Reads three finite numbers: the attribute `key` of `element`, or the `default` where there is none.
    fn vector(
        &self,
        of: &Document<'_>,
        element: &str,
        key: &str,
        default: [f64; 3],
    ) -> Result<[f64; 3], InputError> {
        let node = of.at_most_one(self.node, element)?;
        let Some((node, text)) = node.and_then(|node| Some((node, node.attribute(key)?))) else {
            return Ok(default);
        };
        let numbers: Option<Vec<f64>> = text
            .split_whitespace()
            .map(|part| part.parse().ok().filter(|x: &f64| x.is_finite()))
            .collect();
        numbers.and_then(|all| all.try_into().ok()).ok_or_else(|| {
            let found = format!(
                "{key}=\"{text}\" in the {element} of joint \"{}\"",
                self.name
            );
            with_xacro_help(of.error(node, found, "three finite numbers"), text)
        })
    }
}

/// Adds how to expand a xacro, if the text is one.
fn with_xacro_help(error: InputError, text: &str) -> InputError {
    match ["xacro:", "${"].iter().any(|sign| text.contains(sign)) {
        true => error
            .with_help("expand the xacro first, for example `xacro robot.urdf.xacro > robot.urdf`"),
        false => error,
    }
}
