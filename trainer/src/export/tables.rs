//! Tables of a chain as TOML, which the trainer itself reads as a robot, and as JSON for other programs.

use std::fmt::Write;

use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;
use serde_json::{Value, json};

use crate::export::CalibratedChain;
use crate::export::describe::{comments, distance_json};
use crate::export::format::{decimals, rounded, rpy, three, xyz};
use poegp_calibration::robot::normal_form::{rotation_about, translation};

/// A Denavit-Hartenberg row in metres and radians; one of d and β is 0. The distal convention is R_z(q + θ) T_z(d) T_x(a)
/// R_x(α) R_y(β). The proximal one is T_x(a) R_x(α) R_y(β) R_z(q + θ) T_z(d), with a, α and β before the joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DhRow {
    /// Angle about z at joint value 0.
    pub theta: f64,
    /// Translation along z.
    pub d: f64,
    /// Translation along the new x.
    pub a: f64,
    /// Rotation about the new x.
    pub alpha: f64,
    /// Rotation about the new y, between parallel axes.
    pub beta: Option<f64>,
}

impl DhRow {
    /// Returns the frame behind the joint of this row, at joint value 0.
    pub fn frame(&self) -> Pose<f64> {
        rotation_about(2, self.theta)
            * translation(0.0, 0.0, self.d)
            * translation(self.a, 0.0, 0.0)
            * rotation_about(0, self.alpha)
            * rotation_about(1, self.beta.unwrap_or(0.0))
    }
}

/// Row of a table that stands for a joint.
#[derive(Clone, Copy, Debug)]
pub enum Row {
    /// Frame of the joint in the one before it; the joint acts on its z.
    Frame(Pose<f64>),
    /// Denavit-Hartenberg row of the joint. The joint acts on the z axis before the row, or, where a and α come first, on
    /// the z axis of the row.
    Dh(DhRow),
}

/// A chain in one convention.
#[derive(Clone, Debug)]
pub struct Table {
    /// Name of the convention in a robot description.
    pub convention: &'static str,
    /// Frame before the first row.
    pub base: Option<Pose<f64>>,
    /// Rows, one for each joint.
    pub rows: Vec<Row>,
    /// Frame from the last row to the flange.
    pub flange: Pose<f64>,
}

impl Table {
    /// Returns the lines before the numbers of a file.
    pub(super) fn comments(&self, chain: &CalibratedChain) -> Vec<String> {
        let meaning = match self.convention {
            "dh" => "Rows: R_z(q + theta_offset) T_z(d) T_x(a) R_x(alpha) R_y(beta).",
            "modified-dh" => {
                "Rows: T_x(a) R_x(alpha) R_y(beta) R_z(q + theta_offset) T_z(d), after Craig."
            }
            _ => "A joint's origin is in the frame before; it acts about (or along) its axis.",
        };
        let mut out = comments(chain, &chain.not_carried);
        out.push(format!("Metres and radians. {meaning}"));
        out
    }

    /// Returns the table as a robot description that `--robot` reads.
    pub fn to_toml(&self, chain: &CalibratedChain) -> String {
        let mut out = String::new();
        for line in self.comments(chain) {
            let _ = writeln!(out, "# {line}");
        }
        out += "\n";
        let _ = writeln!(
            out,
            "name = {}\nconvention = \"{}\"",
            quoted(&chain.name),
            self.convention
        );
        if let Some(coupling) = &chain.coupling {
            out += "# q_serial = coupling · q\ncoupling = [\n";
            for row in coupling {
                let row: Vec<String> = row.iter().map(|c| decimals(*c)).collect();
                let _ = writeln!(out, "    [{}],", row.join(", "));
            }
            out += "]\n";
        }
        if let Some(base) = &self.base {
            let _ = writeln!(out, "\n[base]\norigin = {}", origin(base));
        }
        for (joint, row) in chain.joints.iter().zip(&self.rows) {
            let (kind, unit) = match joint.kind {
                JointKind::Revolute => ("revolute", "rad"),
                JointKind::Prismatic => ("prismatic", "m"),
            };
            let _ = writeln!(
                out,
                "\n[[joint]]\nname = {}\nkind = \"{kind}\"",
                quoted(&joint.name)
            );
            if let Some((lower, upper)) = joint.limits {
                let limits = format!("[{}, {}]", decimals(lower), decimals(upper));
                let _ = writeln!(out, "limits_{unit} = {limits}");
            }
            match row {
                Row::Frame(frame) => {
                    let _ = writeln!(out, "origin = {}\naxis = [0, 0, 1]", origin(frame));
                }
                Row::Dh(row) => {
                    for (key, value) in keys(row) {
                        let _ = writeln!(out, "{key} = {}", decimals(value));
                    }
                }
            }
        }
        let _ = writeln!(out, "\n[flange]\norigin = {}", origin(&self.flange));
        let _ = writeln!(
            out,
            "\n# Beside the arm: the target on the flange, and the base as the instrument sees it.\n[calibration]\n\
             flange_from_target = {}\ninstrument_from_base = {}",
            origin(&chain.flange_from_target),
            origin(&chain.instrument_from_base)
        );
        let left_out: Vec<String> = chain.not_carried.iter().map(|s| quoted(s)).collect();
        let _ = writeln!(out, "not_carried = [{}]", left_out.join(", "));
        out
    }

    /// Returns the table as JSON, with lengths in metres and angles in radians.
    pub fn to_json(&self, chain: &CalibratedChain) -> Value {
        let joints = chain.joints.iter().zip(&self.rows).map(|(joint, row)| {
            let (kind, unit) = match joint.kind {
                JointKind::Revolute => ("revolute", "limits_rad"),
                JointKind::Prismatic => ("prismatic", "limits_m"),
            };
            let mut out = json!({"name": joint.name, "kind": kind});
            if let Some((lower, upper)) = joint.limits {
                out[unit] = json!([rounded(lower), rounded(upper)]);
            }
            match row {
                Row::Frame(frame) => {
                    out["origin"] = pose(frame);
                    out["axis"] = json!([0, 0, 1]);
                }
                Row::Dh(row) => {
                    for (key, value) in keys(row) {
                        out[key] = json!(rounded(value));
                    }
                }
            }
            out
        });
        let mut out = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "name": chain.name,
            "convention": self.convention,
            "provenance": chain.provenance,
            "distance": distance_json(chain),
            "coupling": chain.coupling,
            "joints": joints.collect::<Vec<_>>(),
            "flange": {"origin": pose(&self.flange)},
            "flange_from_target": pose(&chain.flange_from_target),
            "instrument_from_base": pose(&chain.instrument_from_base),
            "not_carried": chain.not_carried,
        });
        if let Some(base) = &self.base {
            out["base"] = json!({"origin": pose(base)});
        }
        out
    }
}

fn keys(row: &DhRow) -> Vec<(&'static str, f64)> {
    let mut out = vec![
        ("a_m", row.a),
        ("d_m", row.d),
        ("alpha_rad", row.alpha),
        ("theta_offset_rad", row.theta),
    ];
    out.extend(row.beta.map(|beta| ("beta_rad", beta)));
    out
}

pub(super) fn origin(pose: &Pose<f64>) -> String {
    format!(
        "{{ xyz_m = [{}], rpy_rad = [{}] }}",
        three(xyz(pose), ", "),
        three(rpy(pose), ", ")
    )
}

pub(super) fn pose(pose: &Pose<f64>) -> Value {
    json!({"xyz_m": xyz(pose).map(rounded), "rpy_rad": rpy(pose).map(rounded)})
}

pub(super) fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
