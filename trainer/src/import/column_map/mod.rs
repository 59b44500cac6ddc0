//! The map of columns: which column of a raw file is what, and in what unit.

mod tables;

use std::ops::Range;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use toml::Spanned;

use crate::import::column_map::tables::{OrientationKind, OrientationTable, Tables};
use poegp_calibration::input_error::InputError;
use poegp_calibration::robot::toml_source::TomlSource;

pub use crate::import::column_map::tables::{
    AngleUnit, ColumnName, Decimal, Encoding, EulerAxes, Incomplete, Join, JointUnit, JointUnits,
    Joints, Label, Layout, LengthUnit, MassUnit, MatrixLayout, Orientation, Payload, Points,
    PoseMatrix, Position, QuaternionOrder, Separator, SigmaOrientation, SigmaPosition,
};

/// A map that was read; which tables go together has been checked.
#[derive(Debug)]
pub struct Map {
    /// The file, for messages.
    pub path: PathBuf,
    text: String,
    /// Of the first file.
    pub file: Layout,
    /// Of the file of joints beside a list of points; as `file` when it is absent.
    pub joints_file: Option<Layout>,
    /// What is done with rows that are not whole.
    pub incomplete: Incomplete,
    /// The joints.
    pub joints: Joints,
    /// The position; there is one of this, `pose` and `points`.
    pub position: Option<Position>,
    /// The orientation beside `position`.
    pub orientation: Option<Orientation>,
    /// The whole pose.
    pub pose: Option<PoseMatrix>,
    /// A list of points.
    pub points: Option<Points>,
    /// The payload.
    pub payload: Option<Payload>,
    /// The session.
    pub session: Option<Label>,
    /// The target.
    pub target: Option<Label>,
    /// Uncertainty of the position.
    pub sigma_position: Option<SigmaPosition>,
    /// Uncertainty of the orientation.
    pub sigma_orientation: Option<SigmaOrientation>,
    /// Fixed points beside the robot.
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
    /// As [`Map::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, InputError> {
        let tables: Tables = toml::from_str(text).map_err(|error| {
            TomlSource { file: path, text }
                .refused(&error, "a map of columns (TOML)")
                .with_help("docs/guide/import.md has every key and an example of every shape")
        })?;
        let orientation = tables.orientation;
        let mut map = Self {
            path: path.to_path_buf(),
            text: text.to_owned(),
            file: tables.file,
            joints_file: tables.joints_file,
            incomplete: tables.incomplete,
            joints: tables.joints,
            position: tables.position,
            orientation: None,
            pose: tables.pose,
            points: tables.points,
            payload: tables.payload,
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

    /// An error at a place of the map.
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

    /// Whether rows will have an orientation.
    pub fn has_orientation(&self) -> bool {
        self.orientation.is_some()
            || self.pose.is_some()
            || self
                .points
                .as_ref()
                .is_some_and(|points| points.targets.is_some())
    }

    /// The orientation that a table describes; keys of another kind are refused.
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
                        "kind, columns and {} for the kind \"{name}\"",
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

    fn check(&self) -> Result<(), InputError> {
        let ways = [
            self.position.is_some(),
            self.pose.is_some(),
            self.points.is_some(),
        ];
        if ways.iter().filter(|way| **way).count() != 1 {
            let found = match ways.iter().any(|way| *way) {
                true => "more than one of [position], [pose] and [points]",
                false => "none of [position], [pose] and [points]",
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
                "[orientation] beside [position]; [pose] and [points] have theirs",
            ));
        }
        let joints = &self.joints;
        let count = joints.columns.get_ref().len();
        if !(1..=poegp_protocol::limits::MAX_JOINTS).contains(&count) {
            let expected = format!("1 to {} columns", poegp_protocol::limits::MAX_JOINTS);
            return Err(self.error(
                joints.columns.span(),
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
                format!("one, or {count}"),
            ));
        }
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
                    let expected = "three axes, none twice in a row: ZYX, XYZ, ZYZ, ZXZ, … (in the order of the columns)";
                    return Err(self.error(order.span(), "orientation.order", found, expected));
                }
            }
            None => {}
        }
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
        match &self.points {
            Some(points) => self.check_points(points),
            None if self.joints_file.is_some() || joints.name.is_some() => Err(InputError::new(
                &self.path,
                "[joints_file] or joints.name without [points]",
                "them only where joints are in a file of their own, beside a list of points",
            )),
            None => Ok(()),
        }
    }

    fn check_points(&self, points: &Points) -> Result<(), InputError> {
        self.count(&points.columns, "points.columns", &[3])?;
        if let (Some(target), Some(_)) = (&points.target, &points.split) {
            let found = "points.target beside points.split";
            return Err(self.error(target.span(), "points.target", found, "one of them"));
        }
        if points.join == Join::Name && self.joints.name.is_none() {
            return Err(InputError::new(
                &self.path,
                "points.join = \"name\" without joints.name",
                "joints.name, the column of the joints' file that has the pose's name",
            ));
        }
        if let (Join::Order, Some(name)) = (points.join, &self.joints.name) {
            let found = "joints.name, and points.join = \"order\"";
            return Err(self.error(
                name.span(),
                "joints.name",
                found,
                "join = \"name\", or no name",
            ));
        }
        if self.target.is_some() {
            return Err(InputError::new(
                &self.path,
                "[target] beside [points]",
                "points.target or points.split for the names of targets",
            ));
        }
        if let Some(limit) = &points.max_residual_mm
            && (limit.get_ref().is_nan() || *limit.get_ref() <= 0.0)
        {
            let found = limit.get_ref().to_string();
            return Err(self.error(
                limit.span(),
                "points.max_residual_mm",
                found,
                "a number above 0",
            ));
        }
        let Some(targets) = &points.targets else {
            return Ok(());
        };
        let span = targets.span();
        if points.targets_unit.is_none() {
            return Err(self.error(
                span,
                "points.targets",
                "no points.targets_unit",
                "\"mm\" or \"m\"",
            ));
        }
        if points.target.is_none() && points.split.is_none() {
            let found = "targets, and no points.target or points.split";
            return Err(self.error(
                span,
                "points.targets",
                found,
                "where the name of the target is",
            ));
        }
        let locations: Vec<[f64; 3]> = targets.get_ref().values().copied().collect();
        if locations.iter().flatten().any(|x| !x.is_finite()) {
            return Err(self.error(
                span,
                "points.targets",
                "a number that is not finite",
                "finite numbers",
            ));
        }
        if !spans_a_plane(&locations) {
            let found = format!("{} targets on one line", locations.len());
            let expected = "three targets or more that are not on one line";
            return Err(self
                .error(span, "points.targets", found, expected)
                .with_help(
                    "leave targets out: every point is then a position without orientation",
                ));
        }
        Ok(())
    }

    fn count(
        &self,
        columns: &Spanned<Vec<ColumnName>>,
        key: &str,
        counts: &[usize],
    ) -> Result<(), InputError> {
        let found = columns.get_ref().len();
        if counts.contains(&found) {
            return Ok(());
        }
        let counts: Vec<String> = counts.iter().map(usize::to_string).collect();
        let expected = format!("{} columns", counts.join(" or "));
        Err(self.error(columns.span(), key, format!("{found} columns"), expected))
    }
}

/// Targets that lie within this share of their extent of a line do not span a plane.
const FLAT: f64 = 1e-3;

/// Whether points are three or more and not on one line.
pub fn spans_a_plane(points: &[[f64; 3]]) -> bool {
    let Some(first) = points.first() else {
        return false;
    };
    let from_first: Vec<Vector3<f64>> = points
        .iter()
        .map(|p| Vector3::from(*p) - Vector3::from(*first))
        .collect();
    let far = from_first
        .iter()
        .copied()
        .fold(Vector3::zeros(), |far: Vector3<f64>, v| {
            if v.norm() > far.norm() { v } else { far }
        });
    let length = far.norm();
    from_first
        .iter()
        .any(|v| v.cross(&far).norm() > FLAT * length * length)
}
