//! What a robot cell allows: the file of `trainer plan --constraints`.
//!
//! ```toml
//! floor_mm = -700                        # z of the floor in the base frame; floor_m too; floor = false: none
//! link_radius_mm = 60                    # half the thickness of the links, link_radius_m too
//!
//! [[joint]]                              # narrower than the limits of the description, or wider than a turn
//! name = "joint_1"
//! range_deg = [-60, 60]                  # or range_rad; range_mm, range_m for a slide
//!
//! [target]                               # where the target sits on the flange; default: 100 mm in front of it
//! origin = { xyz_mm = [0, 0, 150] }      # flange_from_target; rpy_deg or rpy_rad too
//!
//! [workspace]                            # box that the target stays in
//! min_mm = [-2500, -2500, 100]           # corners in the base frame; min_m, max_m too
//! max_mm = [2500, 2500, 3000]
//!
//! [[keep_out]]                           # box that the links stay out of, from the second joint to the target
//! name = "table"
//! min_mm = [600, -800, -100]
//! max_mm = [1800, 800, 700]
//!
//! [line_of_sight]
//! instrument_mm = [3500, 1000, 1200]     # the instrument in the base frame; instrument_m too
//! normal = [0, 0, 1]                     # axis of the target's frame that looks at it
//! max_angle_deg = 40                     # or max_angle_rad
//! ```
//!
//! Everything may be left out. Lengths and angles have their unit in the key, and unknown keys are refused. If the file
//! states no floor, it is the plane that the robot is mounted on ([`mounting_plane`]).

use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;
use serde::Deserialize;
use toml::Spanned;

use crate::input_error::{InputError, number};
use crate::planning::constraints::{Constraints, to_target};
use crate::planning::links::{Links, mounting_plane};
use crate::planning::rules::{Constraint, LineOfSight, Rule};
use crate::planning::segment::Zone;
use crate::robot::toml_source::{
    DEGREE, METRE, MILLIMETRE, Numbers, Origin, RADIAN, TomlSource, Unit,
};
use crate::robot::{Joint, Robot};

/// Description of the file in error messages.
const WHOLE: &str = "the constraints of a plan in TOML";
/// Position of the target on the flange if none is stated, m: in front of the flange, and off the axis of the last joint,
/// where that joint's turns would move nothing.
const USUAL_TARGET: [f64; 3] = [0.05, 0.0, 0.1];
/// Largest turn either way that a joint is asked to make if its range is not stated, rad; it spares the cables.
const WIDEST: f64 = std::f64::consts::PI;

impl Constraints {
    /// Creates the constraints of a robot cell that allows what the arm itself can do: within the joint limits and at most
    /// half a turn either way, above the plane that it is mounted on and out of its own links.
    ///
    /// # Errors
    /// [`InputError`] for a slide without limits.
    pub fn none(robot: &Robot) -> Result<Self, InputError> {
        Self::of(robot, None, &File::default(), "")
    }

    /// Reads a constraints file for a robot.
    ///
    /// # Errors
    /// [`InputError`] with line and key.
    pub fn read(path: &Path, robot: &Robot) -> Result<Self, InputError> {
        let text =
            std::fs::read_to_string(path).map_err(|e| InputError::unreadable(path, &e, WHOLE))?;
        Self::parse(path, &text, robot)
    }

    /// Parses the text of a constraints file for a robot; `path` is for messages.
    ///
    /// # Errors
    /// As [`Constraints::read`].
    pub fn parse(path: &Path, text: &str, robot: &Robot) -> Result<Self, InputError> {
        let reader = TomlSource { file: path, text };
        let file: File = toml::from_str(text).map_err(|error| reader.refused(&error, WHOLE))?;
        Self::of(robot, Some(path), &file, text)
    }

    fn of(robot: &Robot, path: Option<&Path>, file: &File, text: &str) -> Result<Self, InputError> {
        let reader = TomlSource {
            file: path.unwrap_or(Path::new("<no constraints>")),
            text,
        };
        let flange_from_target = match &file.target {
            Some(target) => reader.origin(&target.origin)?,
            None => Pose {
                translation: Vector3::from(USUAL_TARGET),
                ..Pose::identity()
            },
        };
        let mut rules: Vec<Constraint> = reader.floor(robot, file)?.into_iter().collect();
        rules.extend([Rule::Base, Rule::Links].map(|rule| Constraint { rule, line: None }));
        if let Some(zone) = &file.workspace {
            let line = reader.line_and_column(zone.span().start).0;
            let rule = Rule::Workspace(reader.zone(zone)?);
            rules.push(Constraint {
                rule,
                line: Some(line),
            });
        }
        for (number, table) in (1..).zip(&file.keep_out) {
            let line = reader.line_and_column(table.span().start).0;
            let name = table
                .get_ref()
                .name
                .clone()
                .unwrap_or_else(|| number.to_string());
            let rule = Rule::KeepOut(name, reader.zone(table)?);
            rules.push(Constraint {
                rule,
                line: Some(line),
            });
        }
        if let Some(sight) = &file.line_of_sight {
            let line = reader.line_and_column(sight.span().start).0;
            let rule = Rule::LineOfSight(reader.sight(sight)?);
            rules.push(Constraint {
                rule,
                line: Some(line),
            });
        }
        let radius = reader.radius(&file.link_radius_m, &file.link_radius_mm)?;
        let nominal = robot.chain().map_err(|e| {
            InputError::new(reader.file, e.to_string(), "a robot with 1 to 8 joints")
        })?;
        let chain = to_target(&nominal, &flange_from_target);
        let usual_ranges: Vec<Option<(f64, f64)>> = robot.joints.iter().map(usual_range).collect();
        Ok(Self {
            file: path.map(Path::to_path_buf),
            ranges: reader.ranges(robot, &usual_ranges, &file.joint)?,
            usual_ranges,
            links: Links::new(robot, &chain, flange_from_target, radius),
            flange_from_target,
            rules,
        })
    }
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    floor: Option<Spanned<bool>>,
    floor_mm: Option<Spanned<f64>>,
    floor_m: Option<Spanned<f64>>,
    link_radius_mm: Option<Spanned<f64>>,
    link_radius_m: Option<Spanned<f64>>,
    #[serde(default)]
    joint: Vec<Spanned<JointTable>>,
    target: Option<TargetTable>,
    workspace: Option<Spanned<ZoneTable>>,
    #[serde(default)]
    keep_out: Vec<Spanned<ZoneTable>>,
    line_of_sight: Option<Spanned<SightTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointTable {
    name: Spanned<String>,
    range_deg: Option<Spanned<Numbers<2>>>,
    range_rad: Option<Spanned<Numbers<2>>>,
    range_mm: Option<Spanned<Numbers<2>>>,
    range_m: Option<Spanned<Numbers<2>>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetTable {
    origin: Origin,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ZoneTable {
    name: Option<String>,
    min_mm: Option<Spanned<Numbers<3>>>,
    min_m: Option<Spanned<Numbers<3>>>,
    max_mm: Option<Spanned<Numbers<3>>>,
    max_m: Option<Spanned<Numbers<3>>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SightTable {
    instrument_mm: Option<Spanned<Numbers<3>>>,
    instrument_m: Option<Spanned<Numbers<3>>>,
    normal: Spanned<Numbers<3>>,
    max_angle_deg: Option<Spanned<f64>>,
    max_angle_rad: Option<Spanned<f64>>,
}

/// Returns the joint's limits, at most half a turn either way; `None` for a slide without limits.
fn usual_range(joint: &Joint) -> Option<(f64, f64)> {
    match (joint.limits, joint.kind) {
        (Some((a, b)), JointKind::Revolute) if a < WIDEST && b > -WIDEST => {
            Some((a.max(-WIDEST), b.min(WIDEST)))
        }
        (Some(limits), _) => Some(limits),
        (None, JointKind::Revolute) => Some((-WIDEST, WIDEST)),
        (None, JointKind::Prismatic) => None,
    }
}

impl TomlSource<'_> {
    /// Returns the floor that the file states, else the plane that the robot is mounted on.
    fn floor(&self, robot: &Robot, file: &File) -> Result<Option<Constraint>, InputError> {
        let units = [
            ("floor_mm", MILLIMETRE, &file.floor_mm),
            ("floor_m", METRE, &file.floor_m),
        ];
        let height = self.number(&units)?;
        let key = self.at_most_one_unit(&units)?;
        if let (Some(wanted), Some((name, _, _))) = (&file.floor, &key) {
            let found = format!("floor beside {name}");
            return Err(self.error(wanted.span(), "floor", found, "one of them"));
        }
        let wanted = file.floor.as_ref().is_none_or(|wanted| *wanted.get_ref());
        let span = key.map(|(_, _, value)| value.span());
        let height = height.or_else(|| mounting_plane(robot));
        if let (Some(asked), true, None) = (&file.floor, wanted, height) {
            let expected = "floor_mm, because the mounting plane of this robot is not known";
            return Err(self.error(asked.span(), "floor", "true", expected));
        }
        Ok(height.filter(|_| wanted).map(|height| Constraint {
            rule: Rule::Floor(height),
            line: span.map(|span| self.line_and_column(span.start).0),
        }))
    }

    fn zone(&self, table: &Spanned<ZoneTable>) -> Result<Zone, InputError> {
        let zone = table.get_ref();
        let corner = |units: [Unit<'_, Numbers<3>>; 2], keys: &str| {
            self.vector(&units)?.ok_or_else(|| {
                self.error(
                    table.span(),
                    "",
                    format!("no {keys}"),
                    "both corners of the box",
                )
            })
        };
        let lower = corner(
            [
                ("min_mm", MILLIMETRE, &zone.min_mm),
                ("min_m", METRE, &zone.min_m),
            ],
            "min_mm",
        )?;
        let upper = corner(
            [
                ("max_mm", MILLIMETRE, &zone.max_mm),
                ("max_m", METRE, &zone.max_m),
            ],
            "max_mm",
        )?;
        if let Some(axis) = (0..3).find(|i| lower[*i] >= upper[*i]) {
            let found = format!("a box without room along {}", ["x", "y", "z"][axis]);
            return Err(self.error(table.span(), "", found, "min below max along every axis"));
        }
        Ok(Zone {
            lower: Vector3::from(lower),
            upper: Vector3::from(upper),
        })
    }

    fn sight(&self, table: &Spanned<SightTable>) -> Result<LineOfSight, InputError> {
        let sight = table.get_ref();
        let instrument = self.vector(&[
            ("instrument_mm", MILLIMETRE, &sight.instrument_mm),
            ("instrument_m", METRE, &sight.instrument_m),
        ])?;
        let instrument = instrument.ok_or_else(|| {
            let expected = "instrument_mm, the position of the instrument in the base frame";
            self.error(table.span(), "", "no instrument_mm", expected)
        })?;
        let angle = self.at_most_one_unit(&[
            ("max_angle_deg", DEGREE, &sight.max_angle_deg),
            ("max_angle_rad", RADIAN, &sight.max_angle_rad),
        ])?;
        let Some((key, factor, angle)) = angle else {
            let expected = "max_angle_deg, the largest angle between the target's normal and the line of sight";
            return Err(self.error(table.span(), "", "no max_angle_deg", expected));
        };
        let max_angle = angle.get_ref() * factor;
        if !(max_angle > 0.0 && max_angle <= std::f64::consts::PI) {
            let found = number(*angle.get_ref());
            return Err(self.error(
                angle.span(),
                key,
                found,
                "an angle above 0, at most half a turn",
            ));
        }
        let normal = Vector3::from(sight.normal.get_ref().0);
        let length = normal.norm();
        if !(length > 1e-9 && length.is_finite()) {
            let found = format!("{:?}", sight.normal.get_ref());
            let expected = "a direction in the target's frame, as [0, 0, 1]";
            return Err(self.error(sight.normal.span(), "normal", found, expected));
        }
        Ok(LineOfSight {
            instrument: Vector3::from(instrument),
            normal: normal / length,
            max_angle,
        })
    }

    fn ranges(
        &self,
        robot: &Robot,
        usual: &[Option<(f64, f64)>],
        tables: &[Spanned<JointTable>],
    ) -> Result<Vec<(f64, f64)>, InputError> {
        let mut given: Vec<Option<(f64, f64)>> = vec![None; robot.joints.len()];
        for table in tables {
            let name = &table.get_ref().name;
            let index = robot.joints.iter().position(|j| j.name == *name.get_ref());
            let Some(index) = index else {
                let names: Vec<&str> = robot.joints.iter().map(|j| j.name.as_str()).collect();
                let found = format!("\"{}\"", name.get_ref());
                let expected = format!("a joint of {}: {}", robot.name, names.join(", "));
                return Err(self.error(name.span(), "name", found, expected));
            };
            if given[index].is_some() {
                let found = format!("joint \"{}\" a second time", name.get_ref());
                return Err(self.error(name.span(), "name", found, "one range for every joint"));
            }
            given[index] = Some(self.range(&robot.joints[index], table)?);
        }
        robot
            .joints
            .iter()
            .zip(given)
            .zip(usual)
            .map(|((joint, given), usual)| {
                given.or(*usual).ok_or_else(|| {
                    InputError::new(
                        self.file,
                        format!(
                            "no range of the slide \"{}\", which has no limits",
                            joint.name
                        ),
                        "a [[joint]] table with its name and range_mm",
                    )
                    .with_help("write one into a file for --constraints")
                })
            })
            .collect()
    }

    fn range(&self, joint: &Joint, table: &Spanned<JointTable>) -> Result<(f64, f64), InputError> {
        let t = table.get_ref();
        let units = match joint.kind {
            JointKind::Revolute => [
                ("range_deg", DEGREE, &t.range_deg),
                ("range_rad", RADIAN, &t.range_rad),
            ],
            JointKind::Prismatic => [
                ("range_mm", MILLIMETRE, &t.range_mm),
                ("range_m", METRE, &t.range_m),
            ],
        };
        let Some((key, factor, value)) = self.at_most_one_unit(&units)? else {
            let found = format!("no {} of joint \"{}\"", units[0].0, joint.name);
            let expected = format!("{} or {}", units[0].0, units[1].0);
            return Err(self.error(table.span(), "", found, expected));
        };
        let [a, b] = value.get_ref().0;
        let found = format!("[{a}, {b}]");
        if !(a.is_finite() && b.is_finite() && a < b) {
            let expected = "a smaller and a larger number";
            return Err(self.error(value.span(), key, found, expected));
        }
        let (a, b) = (a * factor, b * factor);
        if let Some((lower, upper)) = joint.limits
            && (a < lower - 1e-9 || b > upper + 1e-9)
        {
            let expected = format!(
                "a range within the limits of joint \"{}\", [{}, {}]",
                joint.name,
                lower / factor,
                upper / factor
            );
            return Err(self.error(value.span(), key, found, expected));
        }
        Ok((a, b))
    }
}
