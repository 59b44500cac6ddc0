//! Identifies the columns of a touch file.

use std::path::Path;

use crate::input_error::InputError;
use crate::measurement::column_names::{AXES, FEATURE, QUATERNION, Quantity};
use crate::measurement::columns::{Column, Header};
use crate::measurement::table::Table;

/// The columns of a touch file. A field may be empty if the kind of its row has no such reading.
pub(super) struct TouchColumns {
    pub joints: Vec<Column>,
    pub feature: Column,
    pub payload: Option<Column>,
    pub session: Option<Column>,
    pub target: Option<Column>,
    pub value: Option<Column>,
    pub gravity: Option<[Column; 3]>,
    pub corner: Option<Column>,
    pub pixel: Option<[Column; 2]>,
    pub position: Option<[Column; 3]>,
    pub orientation: Option<[Column; 4]>,
    pub sigma_position: Option<Column>,
    pub sigma_orientation: Option<Column>,
    /// Names of unknown columns.
    pub unknown: Vec<String>,
}

impl TouchColumns {
    /// Identifies the columns of a table; `file` is for messages.
    pub(super) fn parse(file: &Path, table: &Table) -> Result<Self, InputError> {
        let mut header = Header::new(file, table)?;
        let Some(feature) = header.known.remove(&Quantity::Feature) else {
            return Err(header.error(
                format!("no column {FEATURE}"),
                "touches: the joints q1_deg … and the column feature",
            ));
        };
        if !header.known.contains_key(&Quantity::Joint(1)) {
            return Err(header.error(
                "no column q1_deg".to_owned(),
                "touches: the joints q1_deg … and the column feature",
            ));
        }
        let joints = header.joints()?;
        let position = header.group("x, y, z", &AXES, Quantity::Position)?;
        let orientation = header.group("qw, qx, qy, qz", &QUATERNION, Quantity::Orientation)?;
        if let (None, Some([first, ..])) = (&position, &orientation) {
            return Err(header
                .error(
                    "an orientation without a position".to_owned(),
                    "x_mm, y_mm, z_mm beside qw, qx, qy, qz",
                )
                .at_column(first.index + 1, first.name.clone()));
        }
        let gravity = header.group("gx, gy, gz", &["gx", "gy", "gz"], Quantity::Gravity)?;
        let pixel = header.group("u_px, v_px", &["u_px", "v_px"], Quantity::Pixel)?;
        let mut out = Self {
            joints,
            feature,
            payload: header.known.remove(&Quantity::Payload),
            session: header.known.remove(&Quantity::Session),
            target: header.known.remove(&Quantity::Target),
            value: header.known.remove(&Quantity::Value),
            gravity,
            corner: header.known.remove(&Quantity::Corner),
            pixel,
            position,
            orientation,
            sigma_position: header.known.remove(&Quantity::SigmaPosition),
            sigma_orientation: header.known.remove(&Quantity::SigmaOrientation),
            unknown: Vec::new(),
        };
        // Times, reference points and the truth of a simulation are only for trackers.
        let unused = header.known.into_values().map(|column| column.name);
        out.unknown = header.unknown.into_iter().chain(unused).collect();
        Ok(out)
    }
}
