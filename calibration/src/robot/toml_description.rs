//! The TOML description of an arm, in one of three conventions.
//!
//! ```toml
//! name = "my-arm"
//! convention = "poe"                # or "dh", "modified-dh"
//! coupling = [[1, 0], [-1, 1]]      # optional: q_serial = coupling · q, n rows of n
//! link_radius_mm = 60               # optional: half the thickness of the links, for plans; or link_radius_m
//!
//! [base]                            # optional frame before the chain
//! origin = { xyz_m = [0, 0, 0.5] }
//!
//! [[joint]]
//! name = "j1"
//! kind = "revolute"                 # or "prismatic"
//! limits_deg = [-165, 165]          # or limits_rad; limits_mm, limits_m; none: unlimited
//! gear_ratio = 100                  # optional: turns of the gear's input in one turn of the joint
//! gear_lines = [200, 240]           # optional: errors that repeat so many times in one turn of the joint
//! link_radius_mm = 45               # optional: of the link after this joint, where it differs
//! origin = { xyz_mm = [0, 0, 290], rpy_deg = [0, 0, 0] }  # poe: frame in the one before, as in a URDF
//! axis = [0, 0, 1]                  # poe: in the joint's own frame
//! # dh, modified-dh instead: a_m | a_mm, d_m | d_mm, alpha_deg | alpha_rad, and where it is not 0
//! # theta_offset_deg | theta_offset_rad and beta_deg | beta_rad
//!
//! [flange]                          # optional frame after the last joint
//! origin = { xyz_m = [0, 0, 0.1] }
//!
//! [prior]                           # optional: how far an arm of this class is from its nominal model, standard deviations
//! of one component, length_mm = 0.3                   # for calibrations by touches: of link offsets, tilt_mrad = 0.5
//! # of axis directions, joint_zero_mrad = 1.0             # of joint zeros
//!
//! [calibration]                     # optional: what `trainer export` knows beside the arm; not read here
//! ```
//!
//! `dh` is the distal convention, R_z(q + θ) T_z(d) T_x(a) R_x(α) R_y(β), with β for axes that are parallel except for an
//! error (Hayati). `modified-dh` is Craig's, T_x(a) R_x(α) R_y(β) R_z(q + θ) T_z(d), where a row's a, α and β are those
//! *before* its joint. For a prismatic joint, q adds to d. Every number with a unit carries the unit in its key, and unknown
//! keys are refused.

use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::JointKind;
use poegp_protocol::limits::MAX_RIPPLE;
use serde::Deserialize;
use toml::Spanned;

use crate::input_error::{InputError, is_printable, number};
use crate::robot::description::{ClassPrior, Joint, Robot, WITHIN, is_too_long};
use crate::robot::normal_form as chain;
use crate::robot::normal_form::Chain;
use crate::robot::toml_source::{DEGREE, METRE, MILLIMETRE, Numbers, Origin, RADIAN, TomlSource};

/// Permitted cycles per turn of the joint of a gear line.
const GEAR_LINES: std::ops::RangeInclusive<f64> = 1.0..=1000.0;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    name: Spanned<String>,
    convention: Convention,
    base: Option<Fixed>,
    flange: Option<Fixed>,
    /// What `trainer export` states about a calibration, for other programs; nothing in it describes the arm.
    #[serde(rename = "calibration")]
    _calibration: Option<toml::Table>,
    prior: Option<PriorTable>,
    coupling: Option<Spanned<Vec<Spanned<Vec<f64>>>>>,
    link_radius_m: Option<Spanned<f64>>,
    link_radius_mm: Option<Spanned<f64>>,
    #[serde(default)]
    joint: Vec<Spanned<JointTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PriorTable {
    length_mm: Spanned<f64>,
    tilt_mrad: Spanned<f64>,
    joint_zero_mrad: Spanned<f64>,
}

#[derive(Deserialize, Clone, Copy, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
enum Convention {
    Poe,
    Dh,
    ModifiedDh,
}

#[derive(Deserialize, Clone, Copy, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Revolute,
    Prismatic,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Fixed {
    origin: Origin,
}

/// The keys of all conventions. Which of them a convention has is checked later, so that the message can name the
/// convention.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointTable {
    name: Spanned<String>,
    kind: Kind,
    limits_deg: Option<Spanned<Numbers<2>>>,
    limits_rad: Option<Spanned<Numbers<2>>>,
    limits_mm: Option<Spanned<Numbers<2>>>,
    limits_m: Option<Spanned<Numbers<2>>>,
    gear_ratio: Option<Spanned<f64>>,
    gear_lines: Option<Spanned<Vec<f64>>>,
    link_radius_m: Option<Spanned<f64>>,
    link_radius_mm: Option<Spanned<f64>>,
    origin: Option<Spanned<Origin>>,
    axis: Option<Spanned<Numbers<3>>>,
    a_m: Option<Spanned<f64>>,
    a_mm: Option<Spanned<f64>>,
    d_m: Option<Spanned<f64>>,
    d_mm: Option<Spanned<f64>>,
    alpha_deg: Option<Spanned<f64>>,
    alpha_rad: Option<Spanned<f64>>,
    theta_offset_deg: Option<Spanned<f64>>,
    theta_offset_rad: Option<Spanned<f64>>,
    beta_deg: Option<Spanned<f64>>,
    beta_rad: Option<Spanned<f64>>,
}

/// Parses the robot of a TOML text; `file` is for messages.
pub(super) fn parse(file: &Path, text: &str) -> Result<Robot, InputError> {
    let reader = TomlSource { file, text };
    let table: Description =
        toml::from_str(text).map_err(|error| reader.not_a_description(&error))?;
    let robot_name = table.name.get_ref();
    if !is_printable(robot_name) {
        let found = format!("{robot_name:?}");
        let expected = "a name without control characters";
        return Err(reader.error(table.name.span(), "name", found, expected));
    }
    let mut chain = Chain::new();
    if let Some(base) = &table.base {
        chain.push_fixed(reader.origin(&base.origin)?);
    }
    let mut lines = 0;
    for (i, joint) in table.joint.iter().enumerate() {
        let name = &joint.get_ref().name;
        if table.joint[..i]
            .iter()
            .any(|other| other.get_ref().name.get_ref() == name.get_ref())
        {
            let found = format!("a second joint named \"{}\"", name.get_ref());
            return Err(reader.error(
                name.span(),
                "name",
                found,
                "a name of its own for every joint",
            ));
        }
        lines += reader.gear_lines(joint.get_ref())?.len();
        if lines > MAX_RIPPLE {
            let found = format!("{lines} lines by gear_ratio and gear_lines up to this joint");
            let expected = format!("at most {MAX_RIPPLE} in the whole arm; a gear_ratio makes two");
            return Err(reader.error(name.span(), "name", found, expected));
        }
        reader.push(&mut chain, table.convention, joint)?;
    }
    if let Some(flange) = &table.flange {
        chain.push_fixed(reader.origin(&flange.origin)?);
    }
    let coupling = match &table.coupling {
        Some(rows) => reader.coupling(rows, table.joint.len())?,
        None => None,
    };
    let link_radius = reader.radius(&table.link_radius_m, &table.link_radius_mm)?;
    let robot = chain
        .finish(table.name.into_inner(), coupling)
        .map_err(|error| {
            let (found, expected) = error.describe();
            InputError::new(
                file,
                found,
                format!("{expected}, each in a [[joint]] table"),
            )
        })?;
    let prior = match &table.prior {
        Some(prior) => Some(reader.prior(prior)?),
        None => None,
    };
    Ok(Robot {
        link_radius,
        prior,
        ..robot
    })
}

impl TomlSource<'_> {
    /// Reads how far an arm of the class is from its nominal model.
    fn prior(&self, table: &PriorTable) -> Result<ClassPrior, InputError> {
        let above_zero = |key: &str, value: &Spanned<f64>| {
            let given = *value.get_ref();
            if given > 0.0 && given.is_finite() {
                return Ok(1e-3 * given);
            }
            let expected = "a number above 0";
            Err(self.error(value.span(), key, number(given), expected))
        };
        Ok(ClassPrior {
            length: above_zero("length_mm", &table.length_mm)?,
            tilt: above_zero("tilt_mrad", &table.tilt_mrad)?,
            joint_zero: above_zero("joint_zero_mrad", &table.joint_zero_mrad)?,
        })
    }

    /// Creates an error from a message of toml or serde, with help if a unit is missing.
    fn not_a_description(&self, error: &toml::de::Error) -> InputError {
        let mut refused = self.refused(error, "a robot description in TOML");
        let key = refused
            .found
            .strip_prefix("the unknown key `")
            .and_then(|rest| rest.strip_suffix('`'));
        let without_unit = [
            "limits",
            "xyz",
            "rpy",
            "a",
            "d",
            "alpha",
            "theta_offset",
            "beta",
            "link_radius",
        ];
        let help = key.filter(|key| without_unit.contains(key)).map(|key| {
            let (length, angle) = (
                format!("{key}_m or {key}_mm"),
                format!("{key}_deg or {key}_rad"),
            );
            let keys = match key {
                "limits" => format!("{angle}, or {length}"),
                "rpy" | "alpha" | "theta_offset" | "beta" => angle,
                _ => length,
            };
            format!("the unit is part of the key: {keys}")
        });
        refused.help = help;
        refused
    }

    fn limits(&self, joint: &JointTable) -> Result<Option<(f64, f64)>, InputError> {
        let units = [
            ("limits_rad", RADIAN, &joint.limits_rad),
            ("limits_deg", DEGREE, &joint.limits_deg),
            ("limits_m", METRE, &joint.limits_m),
            ("limits_mm", MILLIMETRE, &joint.limits_mm),
        ];
        let Some((key, _, value)) = self.at_most_one_unit(&units)? else {
            return Ok(None);
        };
        let is_angle = key == "limits_rad" || key == "limits_deg";
        if is_angle != (joint.kind == Kind::Revolute) {
            let expected = match joint.kind {
                Kind::Revolute => "limits_deg or limits_rad for a revolute joint",
                Kind::Prismatic => "limits_mm or limits_m for a prismatic joint",
            };
            return Err(self.error(value.span(), key, key, expected));
        }
        let [lower, upper] = value.get_ref().0;
        let found = format!("the limits {} to {}", number(lower), number(upper));
        if lower > upper {
            return Err(self.error(value.span(), key, found, "the lower limit first"));
        }
        let limits = self.vector(&units)?.map(|[lower, upper]| (lower, upper));
        if !is_angle && limits.is_some_and(is_too_long) {
            let expected = if key == "limits_m" {
                WITHIN
            } else {
                "limits of a slide within 100 m"
            };
            return Err(self.error(value.span(), key, found, expected));
        }
        Ok(limits)
    }

    /// Returns the stated gear lines, and those once and twice per turn of the gear's input.
    fn gear_lines(&self, joint: &JointTable) -> Result<Vec<f64>, InputError> {
        let mut out = Vec::new();
        let ratio = joint.gear_ratio.as_ref();
        let stated = joint.gear_lines.as_ref();
        for (key, span, lines) in [
            ratio.map(|r| {
                (
                    "gear_ratio",
                    r.span(),
                    vec![*r.get_ref(), 2.0 * r.get_ref()],
                )
            }),
            stated.map(|l| ("gear_lines", l.span(), l.get_ref().clone())),
        ]
        .into_iter()
        .flatten()
        {
            if joint.kind == Kind::Prismatic {
                let expected = "gears of revolute joints only";
                return Err(self.error(span, key, key, expected));
            }
            if let Some(bad) = lines.iter().find(|k| !GEAR_LINES.contains(k)) {
                let (least, most) = (GEAR_LINES.start(), GEAR_LINES.end());
                let expected = format!("{least} to {most} cycles in a turn of the joint");
                return Err(self.error(span, key, format!("{} cycles", number(*bad)), expected));
            }
            out.extend(lines);
        }
        out.sort_by(f64::total_cmp);
        out.dedup();
        Ok(out)
    }

    fn push(
        &self,
        chain: &mut Chain,
        convention: Convention,
        table: &Spanned<JointTable>,
    ) -> Result<(), InputError> {
        let joint = table.get_ref();
        let kind = match joint.kind {
            Kind::Revolute => JointKind::Revolute,
            Kind::Prismatic => JointKind::Prismatic,
        };
        let limits = self.limits(joint)?;
        let element = Joint {
            name: joint.name.get_ref().clone(),
            kind,
            limits,
            gear_lines: self.gear_lines(joint)?,
            link_radius: self.radius(&joint.link_radius_m, &joint.link_radius_mm)?,
        };
        if convention == Convention::Poe {
            let axis = self.poe_axis(table)?;
            if let Some(origin) = &joint.origin {
                chain.push_fixed(self.origin(origin.get_ref())?);
            }
            chain.push_joint(element, &axis);
            return Ok(());
        }
        let [a, d, alpha, theta, beta] = self.dh_row(table)?;
        let z = Vector3::new(0.0, 0.0, 1.0);
        let along_x = chain::translation(a, 0.0, 0.0)
            * chain::rotation_about(0, alpha)
            * chain::rotation_about(1, beta);
        let along_z = chain::rotation_about(2, theta) * chain::translation(0.0, 0.0, d);
        if convention == Convention::Dh {
            chain.push_joint(element, &z);
            chain.push_fixed(along_z);
            chain.push_fixed(along_x);
        } else {
            chain.push_fixed(along_x);
            chain.push_fixed(along_z);
            chain.push_joint(element, &z);
        }
        Ok(())
    }

    /// Returns the axis of a joint in the "poe" convention, and checks the keys of that convention.
    fn poe_axis(&self, table: &Spanned<JointTable>) -> Result<Vector3<f64>, InputError> {
        let joint = table.get_ref();
        let keys = [
            ("a_m", &joint.a_m),
            ("a_mm", &joint.a_mm),
            ("d_m", &joint.d_m),
            ("d_mm", &joint.d_mm),
            ("alpha_deg", &joint.alpha_deg),
            ("alpha_rad", &joint.alpha_rad),
            ("theta_offset_deg", &joint.theta_offset_deg),
            ("theta_offset_rad", &joint.theta_offset_rad),
            ("beta_deg", &joint.beta_deg),
            ("beta_rad", &joint.beta_rad),
        ];
        for (key, value) in keys {
            if let Some(value) = value {
                let expected = "origin and axis, as the convention is \"poe\"";
                return Err(self.error(value.span(), key, key, expected));
            }
        }
        let missing = |key: &str| {
            let found = format!("no {key} of joint \"{}\"", joint.name.get_ref());
            self.error(
                table.span(),
                "",
                found,
                format!("the key {key} in every joint of convention \"poe\""),
            )
        };
        if joint.origin.is_none() {
            return Err(
                missing("origin").with_help("origin = {} is the frame of the previous joint")
            );
        }
        let axis = joint.axis.as_ref().ok_or_else(|| missing("axis"))?;
        let vector = Vector3::from(axis.get_ref().0);
        let length = chain::norm(&vector);
        if !(length > 1e-9 && length.is_finite()) {
            let found = format!("the axis {:?}", axis.get_ref());
            return Err(self.error(
                axis.span(),
                "axis",
                found,
                "finite numbers that are not all zero",
            ));
        }
        Ok(vector)
    }

    /// Returns (a, d, α, θ offset, β) of a joint in m and rad; keys of the "poe" convention are refused.
    fn dh_row(&self, table: &Spanned<JointTable>) -> Result<[f64; 5], InputError> {
        let joint = table.get_ref();
        let poe_key = match (&joint.origin, &joint.axis) {
            (Some(origin), _) => Some(("origin", origin.span())),
            (None, Some(axis)) => Some(("axis", axis.span())),
            (None, None) => None,
        };
        if let Some((key, span)) = poe_key {
            return Err(self.error(
                span,
                key,
                key,
                "a, d and alpha with their units, or the convention \"poe\"",
            ));
        }
        let required = |value: Option<f64>, keys: &str| {
            value.ok_or_else(|| {
                let found = format!("no {keys} of joint \"{}\"", joint.name.get_ref());
                self.error(
                    table.span(),
                    "",
                    found,
                    "a, d and alpha, with their units, in every joint",
                )
            })
        };
        let a = self.number(&[
            ("a_m", METRE, &joint.a_m),
            ("a_mm", MILLIMETRE, &joint.a_mm),
        ])?;
        let d = self.number(&[
            ("d_m", METRE, &joint.d_m),
            ("d_mm", MILLIMETRE, &joint.d_mm),
        ])?;
        let alpha = self.number(&[
            ("alpha_rad", RADIAN, &joint.alpha_rad),
            ("alpha_deg", DEGREE, &joint.alpha_deg),
        ])?;
        let theta = self.number(&[
            ("theta_offset_rad", RADIAN, &joint.theta_offset_rad),
            ("theta_offset_deg", DEGREE, &joint.theta_offset_deg),
        ])?;
        let beta = self.number(&[
            ("beta_rad", RADIAN, &joint.beta_rad),
            ("beta_deg", DEGREE, &joint.beta_deg),
        ])?;
        Ok([
            required(a, "a_m or a_mm")?,
            required(d, "d_m or d_mm")?,
            required(alpha, "alpha_deg or alpha_rad")?,
            theta.unwrap_or(0.0),
            beta.unwrap_or(0.0),
        ])
    }
}
