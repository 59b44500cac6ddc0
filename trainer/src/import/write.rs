//! The rows of an import as a measurement file.

use std::fmt::Write;

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::math::se3::Pose;

use crate::import::column_map::JointUnit;

/// One measurement in the units of the measurement file.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// Degrees, or millimetres of a prismatic joint, with the unit of the raw file.
    pub joints: Vec<(f64, JointUnit)>,
    /// Mass at the flange.
    pub payload_kg: Option<f64>,
    /// Mounting of the tool.
    pub session: Option<String>,
    /// Which target.
    pub target: Option<String>,
    /// instrument_from_target, millimetres.
    pub position_mm: Vector3<f64>,
    /// instrument_from_target.
    pub orientation: Option<Matrix3<f64>>,
    /// Standard uncertainty, millimetres.
    pub sigma_mm: Option<f64>,
    /// Standard uncertainty, milliradians.
    pub sigma_mrad: Option<f64>,
    /// Fixed points, millimetres; `None` where one was missed.
    pub references_mm: Vec<Option<Vector3<f64>>>,
}

/// Decimals of millimetres and milliradians.
const LENGTH: usize = 6;
/// Decimals of degrees and of quaternions.
const ANGLE: usize = 10;

impl Row {
    /// Names and texts of the columns, in order.
    pub fn fields(&self) -> Vec<(String, String)> {
        let mut out = Vec::new();
        let mut push = |name: String, text: String| out.push((name, text));
        if let Some(session) = &self.session {
            push("session".to_owned(), quoted(session));
        }
        if let Some(target) = &self.target {
            push("target".to_owned(), quoted(target));
        }
        if let Some(payload) = self.payload_kg {
            push("payload_kg".to_owned(), decimal(payload, LENGTH));
        }
        for (i, (value, unit)) in self.joints.iter().enumerate() {
            let (unit, decimals) = match unit {
                JointUnit::Deg | JointUnit::Rad => ("deg", ANGLE),
                JointUnit::Mm | JointUnit::M => ("mm", LENGTH),
            };
            push(format!("q{}_{unit}", i + 1), decimal(*value, decimals));
        }
        for (axis, value) in ["x", "y", "z"].iter().zip(self.position_mm.iter()) {
            push(format!("{axis}_mm"), decimal(*value, LENGTH));
        }
        if let Some(rotation) = &self.orientation {
            let pose = Pose {
                rotation: *rotation,
                translation: Vector3::zeros(),
            };
            for (name, text) in ["qw", "qx", "qy", "qz"].iter().zip(quaternion(&pose)) {
                push((*name).to_owned(), text);
            }
        }
        if let Some(sigma) = self.sigma_mm {
            push("sigma_mm".to_owned(), decimal(sigma, LENGTH));
        }
        if let Some(sigma) = self.sigma_mrad {
            push("sigma_mrad".to_owned(), decimal(sigma, LENGTH));
        }
        for (k, point) in self.references_mm.iter().enumerate() {
            for (i, axis) in ["x", "y", "z"].iter().enumerate() {
                let text = point.map_or_else(String::new, |p| decimal(p[i], LENGTH));
                push(format!("ref{}_{axis}_mm", k + 1), text);
            }
        }
        out
    }
}

/// The measurement file; `sources` are said in a comment.
pub fn csv(rows: &[Row], sources: &[String]) -> String {
    let mut out = format!(
        "# imported by trainer {} from {}\n",
        env!("CARGO_PKG_VERSION"),
        sources.join(" and ")
    );
    for (i, row) in rows.iter().enumerate() {
        let fields = row.fields();
        if i == 0 {
            let names: Vec<&str> = fields.iter().map(|(name, _)| name.as_str()).collect();
            let _ = writeln!(out, "{}", names.join(","));
        }
        let texts: Vec<&str> = fields.iter().map(|(_, text)| text.as_str()).collect();
        let _ = writeln!(out, "{}", texts.join(","));
    }
    out
}

/// A number rounded to so many decimals, without trailing zeros and never −0.
fn decimal(x: f64, decimals: usize) -> String {
    let text = format!("{x:.decimals$}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}

/// w, x, y, z with the sign that makes the first of them that is not 0, once rounded, positive: half a turn has two
/// quaternions, and which one comes out must not depend on the last bit of w.
fn quaternion(pose: &Pose<f64>) -> [String; 4] {
    let (w, v) = pose.quaternion();
    let numbers = [w, v[0], v[1], v[2]];
    let texts = numbers.map(|x| decimal(x, ANGLE));
    let negative = texts
        .iter()
        .find(|text| *text != "0")
        .is_some_and(|text| text.starts_with('-'));
    if negative {
        numbers.map(|x| decimal(-x, ANGLE))
    } else {
        texts
    }
}

/// A text of a CSV file.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '#']) {
        return format!("\"{}\"", text.replace('"', "\"\""));
    }
    text.to_owned()
}
