//! Converts fields to touches in SI units.

use std::path::Path;

use nalgebra::Vector3;
use poegp_protocol::limits::MAX_TOOLS;
use poegp_runtime::math::se3::{Pose, dot};

use crate::input_error::InputError;
use crate::measurement::columns::Column;
use crate::measurement::observation::{InstrumentNoise, Observation};
use crate::measurement::rows::Row;
use crate::measurement::sample::ToolName;
use crate::measurement::table::{Table, quoted};
use crate::measurement::touch::columns::TouchColumns;
use crate::measurement::touch::features::{Description, NominalTip};
use crate::measurement::touch::set::{Feature, FeatureKind, Reading, Tip, TouchRow};
use crate::robot::Robot;

/// Largest deviation from 1 of the length of a direction of gravity.
const GRAVITY_TOLERANCE: f64 = 0.01;
/// Standard deviation of a tip that no `[[target]]` describes, in m: it may be anywhere about the flange.
pub(super) const TIP_ANYWHERE: f64 = 0.5;

/// Reader of the rows of a file.
pub(super) struct Rows<'a> {
    pub file: &'a Path,
    pub columns: &'a TouchColumns,
    pub described: &'a Description,
    pub robot: &'a Robot,
    /// Whether readings that only the touch itself can supply may be empty; they are then zero.
    pub is_plan: bool,
    pub tips: Vec<Tip>,
}

impl Rows<'_> {
    pub(super) fn read(&mut self, table: &Table) -> Result<Vec<TouchRow>, InputError> {
        let mut rows = Vec::with_capacity(table.rows.len());
        for (line, fields) in &table.rows {
            let row = Row {
                file: self.file,
                line: *line,
                fields,
            };
            rows.push(self.row(&row)?);
        }
        Ok(rows)
    }

    fn row(&mut self, row: &Row<'_>) -> Result<TouchRow, InputError> {
        let columns = self.columns;
        let joints = columns
            .joints
            .iter()
            .map(|column| row.number(column))
            .collect::<Result<Vec<_>, _>>()?;
        let reading = match row.field(&columns.feature) {
            "" => self.tracker(row)?,
            name => self.touch(row, name)?,
        };
        let filled = |column: &Option<Column>| {
            let column = column.as_ref().filter(|c| !row.field(c).is_empty());
            column.map(|column| row.sigma(column)).transpose()
        };
        Ok(TouchRow {
            line: row.line,
            serial_joints: self.robot.serial_joints(&joints),
            joints,
            payload_kg: row.optional(&columns.payload, |column| row.payload(column))?,
            tip: self.tip(row, reading.feature())?,
            reading,
            declared_noise: InstrumentNoise {
                position: filled(&columns.sigma_position)?,
                orientation: filled(&columns.sigma_orientation)?,
            },
        })
    }

    /// Reads a row without a feature.
    fn tracker(&self, row: &Row<'_>) -> Result<Reading, InputError> {
        let columns = self.columns;
        let touch_columns = columns.value.iter().chain(&columns.corner);
        let touch_columns = touch_columns
            .chain(columns.gravity.iter().flatten())
            .chain(columns.pixel.iter().flatten());
        refuse_filled(
            row,
            touch_columns,
            "an empty field: a row without a feature is a tracker measurement",
        )?;
        let Some(position) = &columns.position else {
            return Err(row
                .error(
                    &columns.feature,
                    "an empty field",
                    "the feature that was touched",
                )
                .with_help(
                    "a row without a feature is a tracker measurement, with x_mm, y_mm and z_mm",
                ));
        };
        let at = row.position(position)?;
        if at == Vector3::zeros() {
            return Err(row
                .error(&position[0], "the position 0 0 0", "a measured position")
                .with_help("a tracker writes 0 0 0 where it missed the target: remove the row"));
        }
        let orientation = columns.orientation.as_ref();
        let orientation =
            orientation.filter(|columns| columns.iter().any(|c| !row.field(c).is_empty()));
        Ok(Reading::Tracker(match orientation {
            Some(orientation) => {
                let (w, v, _) = row.quaternion(orientation)?;
                Observation::Pose(Pose::from_quaternion(w, &v, at))
            }
            None => Observation::Position(at),
        }))
    }

    fn touch(&self, row: &Row<'_>, name: &str) -> Result<Reading, InputError> {
        let columns = self.columns;
        let features = &self.described.features;
        let Some(feature) = features.iter().position(|f| f.name == name) else {
            let names: Vec<String> = features.iter().take(8).map(|f| quoted(&f.name)).collect();
            let more = if features.len() > names.len() {
                " …"
            } else {
                ""
            };
            let expected = format!(
                "a [[feature]] of {}: {}{more}",
                self.described.path.display(),
                names.join(", ")
            );
            return Err(row.error(&columns.feature, quoted(name), &expected));
        };
        let described = &features[feature];
        let kind = &described.kind;
        let position = columns.position.iter().flatten();
        let position = position.chain(columns.orientation.iter().flatten());
        refuse_filled(
            row,
            position,
            "an empty field: a row with a feature has no tracker measurement",
        )?;
        let has_value = matches!(
            kind,
            FeatureKind::Plane { .. } | FeatureKind::Sphere { .. } | FeatureKind::Anchor { .. }
        );
        let is_level = matches!(kind, FeatureKind::Level { .. });
        let is_board = matches!(kind, FeatureKind::Board(_));
        let mut idle: Vec<&Column> = Vec::new();
        idle.extend(columns.value.iter().filter(|_| !has_value));
        idle.extend(columns.gravity.iter().flatten().filter(|_| !is_level));
        idle.extend(columns.corner.iter().filter(|_| !is_board));
        idle.extend(columns.pixel.iter().flatten().filter(|_| !is_board));
        let of_kind = format!("an empty field for a feature of kind \"{}\"", kind.name());
        refuse_filled(row, idle.into_iter(), &of_kind)?;
        Ok(match kind {
            FeatureKind::Point { .. } => Reading::Point { feature },
            FeatureKind::Plane { .. } => Reading::Plane {
                feature,
                value: self.value(row, described)?.unwrap_or(0.0),
            },
            FeatureKind::Sphere { .. } => Reading::Sphere {
                feature,
                value: self.value(row, described)?.unwrap_or(0.0),
            },
            FeatureKind::Anchor { .. } => Reading::Anchor {
                feature,
                value: self.distance(row, described)?,
            },
            FeatureKind::Level { .. } => Reading::Level {
                feature,
                gravity: self.gravity(row, described)?,
            },
            FeatureKind::Board(board) => {
                let (corner, [u, v]) = self.corner(row, described, board.corners.len())?;
                Reading::Board {
                    feature,
                    corner,
                    u,
                    v,
                }
            }
        })
    }

    /// Returns the column that the kind of a feature requires.
    fn needed<'c, T>(
        &self,
        row: &Row<'_>,
        column: &'c Option<T>,
        names: &str,
        feature: &Feature,
    ) -> Result<&'c T, InputError> {
        column.as_ref().ok_or_else(|| {
            let expected = format!(
                "{names} beside a feature of kind \"{}\"",
                feature.kind.name()
            );
            row.error(
                &self.columns.feature,
                format!("{} without a column {names}", quoted(&feature.name)),
                &expected,
            )
        })
    }

    /// Reads a reading that may be empty.
    fn value(&self, row: &Row<'_>, _: &Feature) -> Result<Option<f64>, InputError> {
        match &self.columns.value {
            Some(column) if !row.field(column).is_empty() => row.number(column).map(Some),
            _ => Ok(None),
        }
    }

    fn distance(&self, row: &Row<'_>, feature: &Feature) -> Result<f64, InputError> {
        let is_empty = |column: &Column| row.field(column).is_empty();
        if self.is_plan && self.columns.value.as_ref().is_none_or(is_empty) {
            return Ok(0.0);
        }
        let column = self.needed(row, &self.columns.value, "value_mm", feature)?;
        let expected = "the reading of the draw-wire or ballbar, as its kind is \"anchor\"";
        if row.field(column).is_empty() {
            return Err(row.error(column, "an empty field", expected));
        }
        match row.number(column)? {
            value if value > 0.0 => Ok(value),
            _ => Err(row.error(
                column,
                quoted(row.field(column)),
                "a distance above 0, as the kind of its feature is \"anchor\"",
            )),
        }
    }

    fn gravity(&self, row: &Row<'_>, feature: &Feature) -> Result<Vector3<f64>, InputError> {
        let mut columns = self.columns.gravity.iter().flatten();
        if self.is_plan && columns.all(|column| row.field(column).is_empty()) {
            return Ok(Vector3::zeros());
        }
        let columns = self.needed(row, &self.columns.gravity, "gx, gy, gz", feature)?;
        let mut gravity = Vector3::zeros();
        for (axis, column) in columns.iter().enumerate() {
            gravity[axis] = row.number(column)?;
        }
        let length = dot(&gravity, &gravity).sqrt();
        // Written so that a length that is not a number is refused, too.
        if (length - 1.0).abs() <= GRAVITY_TOLERANCE {
            return Ok(gravity / length);
        }
        let error = row.error(
            &columns[0],
            format!("a direction of gravity of length {length:.4}"),
            &format!("a unit vector (length within {GRAVITY_TOLERANCE} of 1)"),
        );
        Err(match length {
            9.0..=10.5 => error.with_help("in m/s²? Divide all three by their length"),
            _ => error,
        })
    }

    fn corner(
        &self,
        row: &Row<'_>,
        feature: &Feature,
        corners: usize,
    ) -> Result<(usize, [f64; 2]), InputError> {
        let column = self.needed(row, &self.columns.corner, "corner", feature)?;
        let text = row.field(column);
        let corner = text.parse::<usize>().ok().filter(|n| *n < corners);
        let Some(corner) = corner else {
            let expected = format!(
                "the number of a corner of {}, 0 to {}",
                quoted(&feature.name),
                corners - 1
            );
            return Err(row.error(column, quoted(text), &expected));
        };
        let [u, v] = self.needed(row, &self.columns.pixel, "u_px, v_px", feature)?;
        Ok((corner, [row.number(u)?, row.number(v)?]))
    }

    /// Returns the index of the tip of a row; a new tip is added. A tracker's target need not be in the description.
    fn tip(&mut self, row: &Row<'_>, feature: Option<usize>) -> Result<usize, InputError> {
        let columns = self.columns;
        let text = |column: &Option<Column>| row.optional(column, |column| row.text(column));
        let name = ToolName {
            session: text(&columns.session)?.unwrap_or_default(),
            target: text(&columns.target)?.unwrap_or_default(),
        };
        if let Some(tip) = self.tips.iter().position(|tip| tip.name == name) {
            if feature.is_some() {
                self.nominal(row, &name.target)?;
            }
            return Ok(tip);
        }
        let nominal = match self.nominal(row, &name.target) {
            Ok(nominal) => nominal,
            Err(_) if feature.is_none() => None,
            Err(error) => return Err(error),
        };
        self.tips.push(Tip {
            name,
            position: nominal.map_or_else(Vector3::zeros, |tip| tip.position),
            sigma: nominal.map_or(TIP_ANYWHERE, |tip| tip.sigma),
        });
        if self.tips.len() > MAX_TOOLS {
            return Err(InputError::new(
                self.file,
                format!("more than {MAX_TOOLS} sessions and targets"),
                format!("at most {MAX_TOOLS} tools in one calibration"),
            ));
        }
        Ok(self.tips.len() - 1)
    }

    /// Finds the `[[target]]` of a name; `None` if the description has no targets.
    fn nominal(&self, row: &Row<'_>, name: &str) -> Result<Option<&NominalTip>, InputError> {
        let targets = &self.described.targets;
        let Some(column) = &self.columns.target else {
            return match targets.as_slice() {
                [] => Ok(None),
                [only] => Ok(Some(only)),
                several => Err(row.error(
                    &self.columns.feature,
                    "a touch without a column target",
                    &format!(
                        "the target of each row, as {} has {} of them",
                        self.described.path.display(),
                        several.len()
                    ),
                )),
            };
        };
        if targets.is_empty() {
            return Ok(None);
        }
        let found = targets.iter().find(|tip| tip.name == name);
        found.map(Some).ok_or_else(|| {
            let names: Vec<String> = targets.iter().map(|tip| quoted(&tip.name)).collect();
            let expected = format!(
                "a [[target]] of {}: {}",
                self.described.path.display(),
                names.join(", ")
            );
            row.error(column, quoted(name), &expected)
        })
    }
}

/// Refuses the first of the columns that is not empty: its reading would be ignored.
fn refuse_filled<'c>(
    row: &Row<'_>,
    mut columns: impl Iterator<Item = &'c Column>,
    expected: &str,
) -> Result<(), InputError> {
    let filled = columns.find(|column| !row.field(column).is_empty());
    filled.map_or(Ok(()), |column| {
        Err(row.error(column, quoted(row.field(column)), expected))
    })
}
