//! Writes the rows of an import as a measurement file.

use std::fmt::Write;

use nalgebra::{Matrix3, Vector3};
use poegp_runtime::math::se3::Pose;

use crate::import::column_map::JointUnit;
use poegp_calibration::numeric::rotation::rotated;

/// One measurement in the units of the measurement file.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// Line of the poses' or points' file that the row is from.
    pub line: usize,
    /// Line of the joints' file, if the joints have a file of their own.
    pub joints_line: Option<usize>,
    /// Joint values in degrees, or in millimetres for a prismatic joint, each with the unit of the raw file.
    pub joints: Vec<(f64, JointUnit)>,
    /// When it was measured, in seconds.
    pub time_s: Option<f64>,
    /// Mass at the flange, in kg.
    pub payload_kg: Option<f64>,
    /// Name of the mounting of the tool.
    pub session: Option<String>,
    /// Name of the target.
    pub target: Option<String>,
    /// Position of `instrument_from_target`, in millimetres.
    pub position_mm: Vector3<f64>,
    /// Rotation of `instrument_from_target`.
    pub orientation: Option<Matrix3<f64>>,
    /// Standard uncertainty of a position component, in millimetres.
    pub sigma_mm: Option<f64>,
    /// Standard uncertainty of a rotation component, in milliradians.
    pub sigma_mrad: Option<f64>,
    /// Fixed points beside the robot, in millimetres; `None` where the instrument missed one.
    pub references_mm: Vec<Option<Vector3<f64>>>,
}

/// Names of the columns of the position.
pub const XYZ: [&str; 3] = ["x_mm", "y_mm", "z_mm"];

/// Line of the first row, after a comment and the header.
pub const FIRST_LINE: usize = 3;

/// Number of decimals of millimetres and milliradians.
const LENGTH: usize = 6;
/// Number of decimals of seconds.
const TIME: usize = 6;
/// Number of decimals of degrees and of quaternion components.
const ANGLE: usize = 10;

impl Row {
    /// Returns name and text of each column, in order.
    pub fn fields(&self) -> Vec<(String, String)> {
        let mut out = Vec::new();
        let mut push = |name: String, text: String| out.push((name, text));
        if let Some(session) = &self.session {
            push("session".to_owned(), quoted(session));
        }
        if let Some(target) = &self.target {
            push("target".to_owned(), quoted(target));
        }
        if let Some(time) = self.time_s {
            push("time_s".to_owned(), decimal(time, TIME));
        }
        if let Some(payload) = self.payload_kg {
            push("payload_kg".to_owned(), decimal(payload, LENGTH));
        }
        for (i, (value, unit)) in self.joints.iter().enumerate() {
            let decimals = match unit {
                JointUnit::Deg | JointUnit::Rad => ANGLE,
                JointUnit::Mm | JointUnit::M => LENGTH,
            };
            push(joint_column(i, *unit), decimal(*value, decimals));
        }
        for (name, value) in XYZ.iter().zip(self.position_mm.iter()) {
            push((*name).to_owned(), decimal(*value, LENGTH));
        }
        if let Some(rotation) = &self.orientation {
            let pose = rotated(*rotation);
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

/// Returns the name of the column of joint `index`, counted from 0.
pub fn joint_column(index: usize, unit: JointUnit) -> String {
    let written = match unit {
        JointUnit::Deg | JointUnit::Rad => "deg",
        JointUnit::Mm | JointUnit::M => "mm",
    };
    format!("q{}_{written}", index + 1)
}

/// Returns the text of the measurement file; a comment in it names `sources`.
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

/// Rounds a number to `decimals` decimals, without trailing zeros and never −0.
fn decimal(x: f64, decimals: usize) -> String {
    let text = format!("{x:.decimals$}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}

/// Returns w, x, y, z with the sign that makes the first component positive that is not 0 once rounded. Half a turn has two
/// quaternions, and the last bit of w must not decide between them.
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

/// Returns a text quoted for a CSV file where it needs quotes.
pub fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '#']) {
        return format!("\"{}\"", text.replace('"', "\"\""));
    }
    text.to_owned()
}
