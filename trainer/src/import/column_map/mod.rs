//! The map of columns: the meaning and the unit of each column of a raw file.

pub mod drivers;
mod joined;
mod tables;
mod units;

use std::ops::Range;
use std::path::{Path, PathBuf};

use toml::Spanned;

use crate::import::column_map::drivers::Driver;
use crate::import::column_map::tables::{JointTable, OrientationKind, OrientationTable, Tables};
use poegp_calibration::input_error::InputError;
use poegp_calibration::robot::toml_source::TomlSource;

pub use crate::import::column_map::tables::{
    ColumnName, Decimal, Encoding, EulerAxes, FileJoin, Incomplete, Join, JoinBy, JointSource,
    Joints, Label, Layout, MatrixLayout, Orientation, Payload, Points, PoseMatrix, Position,
    QuaternionOrder, Reflectors, Separator, SigmaOrientation, SigmaPosition, Time,
};
pub use crate::import::column_map::units::{
    AngleUnit, JointUnit, JointUnits, LengthUnit, MassUnit, TimeUnit,
};

/// A map as read; which tables go together has been checked.
#[derive(Debug)]
pub struct Map {
    /// Path of the map, for messages.
    pub path: PathBuf,
    text: String,
    /// Layout of the first file.
    pub file: Layout,
    /// Layout of the file of joints; `None` where `file` applies to it, too.
    pub joints_file: Option<Layout>,
    /// What happens to incomplete rows.
    pub incomplete: Incomplete,
    /// Columns of the joints.
    pub joints: Joints,
    /// Columns of the position. A map has exactly one of this, `pose`, `points` and `reflectors`.
    pub position: Option<Position>,
    /// Columns of the orientation that belongs to `position`.
    pub orientation: Option<Orientation>,
    /// Columns of the whole pose as a matrix.
    pub pose: Option<PoseMatrix>,
    /// Columns of a list of points.
    pub points: Option<Points>,
    /// Columns of the reflectors in a row.
    pub reflectors: Option<Reflectors>,
    /// How a file of joints is joined to the file of poses; `None` where one file has both.
    pub join: Option<FileJoin>,
    /// Payload at the flange.
    pub payload: Option<Payload>,
    /// When a row was measured. Files that are joined by time state it in `join`.
    pub time: Option<Time>,
    /// Session of a row.
    pub session: Option<Label>,
    /// Target of a row.
    pub target: Option<Label>,
    /// Standard uncertainty of the position.
    pub sigma_position: Option<SigmaPosition>,
    /// Standard uncertainty of the orientation.
    pub sigma_orientation: Option<SigmaOrientation>,
    /// Columns of the reference points beside the robot.
    pub references: Vec<Position>,
}

impl Map {
    /// Reads a map from its file.
    ///
    /// # Errors
    /// [`InputError`] with the line and the key.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| InputError::unreadable(path, &error, "a map of columns (TOML)"))?;
        Self::parse(path, &text)
    }

    /// Reads the text of a map; `path` is for messages.
    ///
    /// # Errors
    /// See [`Map::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, InputError> {
        let tables: Tables = toml::from_str(text).map_err(|error| {
            TomlSource { file: path, text }
                .refused(&error, "a map of columns (TOML)")
                .with_help(
                    "docs/reference/column-map.md has every key, docs/guide/import.md has examples",
                )
        })?;
        let orientation = tables.orientation;
        let joints = joints(tables.joints).map_err(|(span, key, found, expected)| {
            TomlSource { file: path, text }.error(span, key, found, expected)
        })?;
        let mut map = Self {
            path: path.to_path_buf(),
            text: text.to_owned(),
            file: tables.file,
            joints_file: tables.joints_file,
            incomplete: tables.incomplete,
            joints,
            position: tables.position,
            orientation: None,
            pose: tables.pose,
            points: tables.points,
            reflectors: tables.reflectors,
            join: tables.join,
            payload: tables.payload,
            time: tables.time,
            session: tables.session,
            target: tables.target,
            sigma_position: tables.sigma_position,
            sigma_orientation: tables.sigma_orientation,
            references: tables.reference,
        };
        map.orientation = orientation
            .map(|table| map.orientation(table))
            .transpose()?;
        map.check()?;
        Ok(map)
    }

    /// Returns an error at a position of the map.
    pub fn error(
        &self,
        span: Range<usize>,
        key: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> InputError {
        TomlSource {
            file: &self.path,
            text: &self.text,
        }
        .error(span, key, found, expected)
    }

    /// Returns the orientation that a table describes, and refuses keys of another kind.
    fn orientation(&self, table: Spanned<OrientationTable>) -> Result<Orientation, InputError> {
        use OrientationKind::{Euler, Matrix, Quaternion, RotationVector};
        let span = table.span();
        let t = table.into_inner();
        let (name, keys): (_, &[&str]) = match t.kind {
            Quaternion => ("quaternion", &["order"]),
            Euler => ("euler", &["order", "axes", "unit"]),
            RotationVector => ("rotation-vector", &["unit"]),
            Matrix => ("matrix", &["layout"]),
        };
        let given = [
            ("order", t.order.as_ref().map(Spanned::span)),
            ("axes", t.axes.as_ref().map(Spanned::span)),
            ("unit", t.unit.as_ref().map(Spanned::span)),
            ("layout", t.layout.as_ref().map(Spanned::span)),
        ];
        for (key, location) in given {
            match location {
                Some(location) if !keys.contains(&key) => {
                    let expected = format!(
                        "only kind, columns and {} for the kind \"{name}\"",
                        keys.join(", ")
                    );
                    return Err(self.error(location, &format!("orientation.{key}"), key, expected));
                }
                None if ["order", "axes"].contains(&key) && keys.contains(&key) => {
                    let what = match key {
                        "order" if t.kind == Quaternion => "order = \"wxyz\" or \"xyzw\"",
                        "order" => "order, the three axes in the order of the columns, as \"ZYX\"",
                        _ => {
                            "axes = \"intrinsic\" (they turn with the body) or \"extrinsic\" (they stay)"
                        }
                    };
                    return Err(self.error(span, "orientation", format!("no {key}"), what));
                }
                _ => {}
            }
        }
        let columns = t.columns;
        let unit = t.unit.map(Spanned::into_inner);
        match (t.kind, t.order, t.axes) {
            (Quaternion, Some(order), ..) => {
                let order = match order.get_ref().as_str() {
                    "wxyz" => QuaternionOrder::Wxyz,
                    "xyzw" => QuaternionOrder::Xyzw,
                    other => {
                        let found = format!("{other:?}");
                        let expected = "\"wxyz\" or \"xyzw\", the order of the columns";
                        return Err(self.error(order.span(), "orientation.order", found, expected));
                    }
                };
                Ok(Orientation::Quaternion { columns, order })
            }
            (Euler, Some(order), Some(axes)) => Ok(Orientation::Euler {
                columns,
                order,
                axes: *axes.get_ref(),
                unit,
            }),
            (RotationVector, ..) => Ok(Orientation::RotationVector { columns, unit }),
            _ => Ok(Orientation::Matrix {
                columns,
                layout: t.layout.map_or(MatrixLayout::Rows, Spanned::into_inner),
            }),
        }
    }

    /// Refuses tables that do not go together, and numbers of columns that do not fit.
    fn check(&self) -> Result<(), InputError> {
        self.check_marks()?;
        self.check_way()?;
        self.check_joints()?;
        self.check_columns()?;
        self.check_values()?;
        if let Some(reflectors) = &self.reflectors {
            self.check_reflectors(reflectors)?;
        }
        match (&self.points, &self.join) {
            (Some(_), Some(_)) => Err(InputError::new(
                &self.path,
                "[join] beside [points]",
                "points.join, which joins a list of points",
            )),
            (Some(points), None) => self.check_points(points),
            (None, Some(join)) if self.joints.name.is_none() => self.check_join(join),
            (None, _) if self.joints_file.is_some() || self.joints.name.is_some() => {
                Err(InputError::new(
                    &self.path,
                    "[joints_file] or joints.name without a file of joints",
                    "[joints_file] beside [join] or [points], joints.name beside [points]",
                ))
            }
            (None, _) => Ok(()),
        }
    }

    /// Refuses a mark of thousands that a number has for something else.
    fn check_marks(&self) -> Result<(), InputError> {
        for layout in [Some(&self.file), self.joints_file.as_ref()]
            .into_iter()
            .flatten()
        {
            let decimal = layout.decimal.mark();
            let is_mark = |mark: char| {
                mark != decimal && !mark.is_ascii_alphanumeric() && !"+-".contains(mark)
            };
            if let Some(mark) = layout.thousands.filter(|mark| !is_mark(*mark)) {
                let found = format!("thousands = \"{mark}\" with decimal = \"{decimal}\"");
                let expected = "a mark that has no other use in a number, or no thousands";
                return Err(InputError::new(&self.path, found, expected));
            }
        }
        Ok(())
    }

    /// Refuses a map without the place of the pose, or with several.
    fn check_way(&self) -> Result<(), InputError> {
        let ways = [
            self.position.is_some(),
            self.pose.is_some(),
            self.points.is_some(),
            self.reflectors.is_some(),
        ];
        if ways.iter().filter(|way| **way).count() != 1 {
            let found = match ways.iter().any(|way| *way) {
                true => "more than one of [position], [pose], [reflectors] and [points]",
                false => "none of [position], [pose], [reflectors] and [points]",
            };
            return Err(InputError::new(
                &self.path,
                found,
                "one of them: where the pose is in the file",
            ));
        }
        if self.orientation.is_some() && self.position.is_none() {
            return Err(InputError::new(
                &self.path,
                "[orientation] without [position]",
                "[orientation] beside [position]; [pose], [reflectors] and [points] have theirs",
            ));
        }
        Ok(())
    }

    /// Refuses too many joints, and units for another number of them.
    fn check_joints(&self) -> Result<(), InputError> {
        let joints = &self.joints;
        let count = match &joints.source {
            JointSource::Columns(columns) => columns.get_ref().len(),
            JointSource::Driver(_) => 1,
        };
        if let JointSource::Columns(columns) = &joints.source
            && !(1..=poegp_protocol::limits::MAX_JOINTS).contains(&count)
        {
            let expected = format!("1 to {} columns", poegp_protocol::limits::MAX_JOINTS);
            return Err(self.error(
                columns.span(),
                "joints.columns",
                format!("{count} columns"),
                expected,
            ));
        }
        if let Some(unit) = &joints.unit
            && let JointUnits::Each(units) = unit.get_ref()
            && units.len() != count
        {
            let found = format!("{} units", units.len());
            return Err(self.error(
                unit.span(),
                "joints.unit",
                found,
                format!("one unit, or {count}"),
            ));
        }
        Ok(())
    }

    /// Refuses another number of columns than the quantity has.
    fn check_columns(&self) -> Result<(), InputError> {
        let three = |position: &Position, key: &str| self.count(&position.columns, key, &[3]);
        if let Some(position) = &self.position {
            three(position, "position.columns")?;
        }
        for reference in &self.references {
            three(reference, "reference.columns")?;
        }
        if let Some(pose) = &self.pose {
            self.count(&pose.columns, "pose.columns", &[12, 16])?;
        }
        match &self.orientation {
            Some(Orientation::Quaternion { columns, .. }) => {
                self.count(columns, "orientation.columns", &[4])?;
            }
            Some(Orientation::Matrix { columns, .. }) => {
                self.count(columns, "orientation.columns", &[9])?;
            }
            Some(Orientation::RotationVector { columns, .. }) => {
                self.count(columns, "orientation.columns", &[3])?;
            }
            Some(Orientation::Euler { columns, order, .. }) => {
                self.count(columns, "orientation.columns", &[3])?;
                if crate::import::orientation::axes(order.get_ref()).is_none() {
                    let found = format!("{:?}", order.get_ref());
                    let expected = "three axes, no two neighbours equal: ZYX, XYZ, ZYZ, ZXZ, … (in the order of the \
                                    columns)";
                    return Err(self.error(order.span(), "orientation.order", found, expected));
                }
            }
            None => {}
        }
        Ok(())
    }

    /// Refuses a label or a payload that has both a column and a value, or neither, and a payload without its unit.
    fn check_values(&self) -> Result<(), InputError> {
        for (key, label) in [("session", &self.session), ("target", &self.target)] {
            if let Some(label) = label
                && label.column.is_some() == label.value.is_some()
            {
                let found = format!("[{key}] with both or neither of column and value");
                return Err(InputError::new(&self.path, found, "one of them"));
            }
        }
        if let Some(payload) = &self.payload
            && payload.column.is_some() == payload.value.is_some()
        {
            let found = "[payload] with both or neither of column and value";
            return Err(InputError::new(&self.path, found, "one of them"));
        }
        if let Some(payload) = &self.payload
            && let (Some(value), None) = (&payload.value, payload.unit)
        {
            let found = "no payload.unit";
            return Err(self.error(
                value.span(),
                "payload.value",
                found,
                "unit = \"kg\" or \"g\"",
            ));
        }
        Ok(())
    }
}

/// Returns the joints that a table describes; where the table is wrong, the key, what was found and what was expected.
fn joints(
    table: Spanned<JointTable>,
) -> Result<Joints, (Range<usize>, &'static str, String, String)> {
    let span = table.span();
    let table = table.into_inner();
    let source = match (table.columns, table.driver) {
        (Some(columns), None) => JointSource::Columns(columns),
        (None, Some(driver)) => {
            if Driver::named(driver.get_ref()).is_none() {
                let found = format!("{:?}", driver.get_ref());
                let expected = format!("one of {}", Driver::all());
                return Err((driver.span(), "joints.driver", found, expected));
            }
            if let Some(unit) = &table.unit {
                let found = "a unit beside joints.driver".to_owned();
                let expected = "no unit: that of the driver is known".to_owned();
                return Err((unit.span(), "joints.unit", found, expected));
            }
            JointSource::Driver(driver)
        }
        (columns, _) => {
            let found = if columns.is_some() {
                "both columns and driver"
            } else {
                "neither columns nor driver"
            };
            let expected =
                "columns, the names of the columns, or driver, whose names are known".to_owned();
            return Err((span, "joints", found.to_owned(), expected));
        }
    };
    Ok(Joints {
        source,
        unit: table.unit,
        name: table.name,
    })
}
