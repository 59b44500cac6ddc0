//! Tables of a chain as CSV, for spreadsheets and controllers' tools: comments that begin with `#`, a header, a row for each
//! frame.

use csv::{Writer, WriterBuilder};
use poegp_protocol::JointKind;
use poegp_runtime::math::se3::Pose;

use crate::export::CalibratedChain;
use crate::export::format::{decimals, rpy, xyz};
use crate::export::tables::{Row, Table};
use crate::export::universal_robots::{LINKS, UrKinematics};

/// Columns of a frame.
const FRAME: [&str; 6] = ["x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"];
/// Columns of a Denavit-Hartenberg row.
const DH: [&str; 5] = ["a_m", "d_m", "alpha_rad", "theta_offset_rad", "beta_rad"];

/// Returns the table: from the base over the joints to the flange, then the two frames beside the arm.
pub fn table(chain: &CalibratedChain, table: &Table) -> String {
    let has_rows = table.rows.iter().any(|row| matches!(row, Row::Dh(_)));
    let dh: &[&str] = if has_rows { &DH } else { &[] };
    let couplings = chain.coupling.as_ref().map_or(0, Vec::len);
    let coupling = (1..=couplings).map(|j| format!("coupling_q{j}"));
    let coupling: Vec<String> = coupling.collect();
    let comments = table.comments(chain);
    let header = ["name", "kind"].into_iter().chain(dh.iter().copied());
    let header = header
        .chain(FRAME)
        .chain(coupling.iter().map(String::as_str));
    let mut file = File::new(&comments, header);
    let fixed = |name: &str, pose: &Pose<f64>| {
        let mut row = vec![name.to_owned(), "fixed".to_owned()];
        row.resize(row.len() + dh.len(), String::new());
        row.extend(frame(pose));
        row.resize(row.len() + couplings, String::new());
        row
    };
    if let Some(base) = &table.base {
        file.row(fixed("base", base));
    }
    for (i, (joint, row)) in chain.joints.iter().zip(&table.rows).enumerate() {
        let kind = match joint.kind {
            JointKind::Revolute => "revolute",
            JointKind::Prismatic => "prismatic",
        };
        let mut fields = vec![joint.name.clone(), kind.to_owned()];
        match row {
            Row::Dh(row) => {
                let beta = row.beta.unwrap_or(0.0);
                fields.extend([row.a, row.d, row.alpha, row.theta, beta].map(decimals));
                fields.resize(fields.len() + FRAME.len(), String::new());
            }
            Row::Frame(pose) => {
                fields.resize(fields.len() + dh.len(), String::new());
                fields.extend(frame(pose));
            }
        }
        let own = chain.coupling.as_ref().map(|rows| &rows[i]);
        fields.extend(own.into_iter().flatten().map(|c| decimals(*c)));
        file.row(fields);
    }
    file.row(fixed("flange", &table.flange));
    file.row(fixed("flange_from_target", &chain.flange_from_target));
    file.row(fixed("instrument_from_base", &chain.instrument_from_base));
    file.text
}

/// Returns the six frames of a Universal Robots driver, and the TCP that belongs to them.
pub fn universal_robots(chain: &CalibratedChain, kinematics: &UrKinematics) -> String {
    let comments = kinematics.comments(chain);
    let mut file = File::new(&comments, ["name"].into_iter().chain(FRAME));
    let links = LINKS.iter().zip(&kinematics.frames);
    for (name, pose) in links.chain([(&"tool0_from_target", &kinematics.tool0_from_target)]) {
        let name = std::iter::once((*name).to_owned());
        file.row(name.chain(frame(pose)));
    }
    file.text
}

fn frame(pose: &Pose<f64>) -> impl Iterator<Item = String> {
    xyz(pose).into_iter().chain(rpy(pose)).map(decimals)
}

/// A file as it is being written.
pub(crate) struct File {
    pub text: String,
}

impl File {
    /// Begins a file with comments and a header.
    pub fn new<'a>(comments: &[String], header: impl Iterator<Item = &'a str>) -> Self {
        let mut text = String::new();
        for line in comments {
            text += &format!("# {line}\n");
        }
        let mut file = Self { text };
        file.row(header.map(str::to_owned));
        file
    }

    /// Adds a row.
    pub fn row(&mut self, fields: impl IntoIterator<Item = String>) {
        let mut writer: Writer<Vec<u8>> = WriterBuilder::new().from_writer(Vec::new());
        // Writing to memory cannot fail, and all fields are text.
        let written = writer.write_record(fields).ok();
        let bytes = written.and_then(|()| writer.into_inner().ok());
        self.text += &String::from_utf8_lossy(&bytes.unwrap_or_default());
    }
}
