//! The columns of a row other than its joints and its pose: payload, time, session, target, uncertainties and references.

use nalgebra::Vector3;

use crate::import::column_map::{AngleUnit, JoinBy, Label, LengthUnit, Map, MassUnit, TimeUnit};
use crate::import::columns::{Triple, one, optional};
use crate::import::origin::{Origin, Origins};
use crate::import::text::Table;
use crate::import::units::unit_of;
use crate::import::value::{Moment, RowValues};
use crate::import::write::Row;
use poegp_calibration::input_error::InputError;

/// The column with the time of a row.
struct TimeColumn {
    index: usize,
    unit: TimeUnit,
    /// Whether the files were joined by it, so that the join has read it already.
    is_joined: bool,
    /// Time of the row before.
    last: Option<Moment>,
}

/// Columns of a map other than joints and pose, located in a file.
pub struct Beside<'a> {
    map: &'a Map,
    payload: Option<(usize, MassUnit)>,
    time: Option<TimeColumn>,
    session: Option<usize>,
    target: Option<usize>,
    sigma_position: Option<(usize, LengthUnit)>,
    sigma_orientation: Option<(usize, AngleUnit)>,
    references: Vec<Triple>,
}

impl<'a> Beside<'a> {
    /// Locates the columns. The payload's column is in `joints`, the file of the joints; all others are in `table`.
    pub fn find(map: &'a Map, table: &Table, joints: &Table) -> Result<Self, InputError> {
        let of = |label: &Option<Label>, key: &str| {
            let column = label.as_ref().and_then(|label| label.column.as_ref());
            optional(map, table, column, key)
        };
        let payload = map.payload.as_ref().and_then(|payload| {
            let column = payload.column.as_ref()?;
            Some(
                one(map, joints, column, "payload.column").and_then(|column| {
                    let unit = unit_of(map, joints, column, payload.unit, "payload.unit")?;
                    Ok((column, unit))
                }),
            )
        });
        let joined = map.join.as_ref().filter(|join| join.by == JoinBy::Time);
        let time = match (joined, &map.time) {
            (Some(join), _) => join
                .poses
                .as_ref()
                .map(|poses| (poses, join.poses_unit, "join.poses")),
            (None, time) => time
                .as_ref()
                .map(|time| (&time.column, time.unit, "time.column")),
        };
        let time = time.map(|(column, unit, key)| {
            let index = one(map, table, column, key)?;
            let unit_key = if joined.is_some() {
                "join.poses_unit"
            } else {
                "time.unit"
            };
            Ok(TimeColumn {
                index,
                unit: unit_of(map, table, index, unit, unit_key)?,
                is_joined: joined.is_some(),
                last: None,
            })
        });
        let sigma_position = map.sigma_position.as_ref().map(|sigma| {
            let column = one(map, table, &sigma.column, "sigma_position.column")?;
            let unit = unit_of(map, table, column, sigma.unit, "sigma_position.unit")?;
            Ok((column, unit))
        });
        let sigma_orientation = map.sigma_orientation.as_ref().map(|sigma| {
            let column = one(map, table, &sigma.column, "sigma_orientation.column")?;
            let unit = unit_of(map, table, column, sigma.unit, "sigma_orientation.unit")?;
            Ok((column, unit))
        });
        let references = map
            .references
            .iter()
            .map(|r| Triple::find(map, table, r, "reference"));
        Ok(Self {
            map,
            payload: payload.transpose()?,
            time: time.transpose()?,
            session: of(&map.session, "session.column")?,
            target: of(&map.target, "target.column")?,
            sigma_position: sigma_position.transpose()?,
            sigma_orientation: sigma_orientation.transpose()?,
            references: references.collect::<Result<_, _>>()?,
        })
    }

    /// Returns the index of the payload's column, which is in the file of the joints.
    pub fn payload_column(&self) -> Option<usize> {
        self.payload.map(|p| p.0)
    }

    /// Returns the indices of all columns except the payload's and one by which files were joined.
    pub fn columns(&self) -> Vec<usize> {
        let mut out: Vec<usize> = [self.session, self.target].into_iter().flatten().collect();
        out.extend(self.time.iter().filter(|t| !t.is_joined).map(|t| t.index));
        out.extend(self.sigma_position.map(|s| s.0));
        out.extend(self.sigma_orientation.map(|s| s.0));
        out.extend(self.references.iter().flat_map(|r| r.0));
        out
    }

    /// Returns the columns of the measurement file that are read here, each with its origin by `of_poses`; that of the payload
    /// by `of_joints`.
    pub fn origins(
        &self,
        of_poses: impl Fn(usize) -> Origin,
        of_joints: impl Fn(usize) -> Origin,
    ) -> Origins {
        let named = [
            ("session", self.session),
            ("target", self.target),
            ("time_s", self.time.as_ref().map(|t| t.index)),
            ("sigma_mm", self.sigma_position.map(|s| s.0)),
            ("sigma_mrad", self.sigma_orientation.map(|s| s.0)),
        ];
        let named = named.into_iter();
        let mut out: Origins = named
            .filter_map(|(name, column)| Some((name.to_owned(), of_poses(column?))))
            .collect();
        for (k, reference) in (1..).zip(&self.references) {
            let axes = ["x", "y", "z"].into_iter().zip(reference.0);
            out.extend(axes.map(|(axis, column)| (format!("ref{k}_{axis}_mm"), of_poses(column))));
        }
        let payload = self.payload_column().map(of_joints);
        out.extend(payload.map(|origin| ("payload_kg".to_owned(), origin)));
        out
    }

    /// Returns whether a row lacks a value that it needs. A reference point without any coordinate was missed, and is no
    /// gap.
    pub fn is_incomplete(&self, fields: &RowValues<'_>) -> bool {
        let is_point = |column: &usize| self.references.iter().any(|r| r.0.contains(column));
        let is_partial = |reference: &Triple| {
            let missing = reference.0.iter().filter(|c| fields.is_missing(**c));
            (1..3).contains(&missing.count())
        };
        let mut needed = self.columns().into_iter().filter(|c| !is_point(c));
        needed.any(|column| fields.is_missing(column)) || self.references.iter().any(is_partial)
    }

    /// Reads the time of the next row, in seconds.
    fn read_time(&mut self, fields: &RowValues<'_>) -> Result<Option<f64>, InputError> {
        let Some(time) = &mut self.time else {
            return Ok(None);
        };
        let moment = fields.moment(time.index, time.unit)?;
        let last = time.last.replace(moment).unwrap_or(moment);
        let found = format!("{:?}", fields.text(time.index));
        if moment.is_local != last.is_local {
            let expected = "a time zone with every time, or with none";
            return Err(fields.error(time.index, found, expected));
        }
        if time.unit == TimeUnit::Clock && moment.seconds < last.seconds {
            let found = format!("{found}, which is before the time of the row above");
            let expected = "times of one day, in their order";
            return Err(fields
                .error(time.index, found, expected)
                .with_help("a column with date and time has unit = \"iso8601\""));
        }
        Ok(Some(moment.seconds))
    }

    /// Fills in time, session, target, payload, uncertainties and reference points of a row.
    pub fn read(
        &mut self,
        fields: &RowValues<'_>,
        joints: &RowValues<'_>,
        row: &mut Row,
    ) -> Result<(), InputError> {
        if let Some(payload) = &self.map.payload {
            let factor = |unit| if unit == MassUnit::G { 1e-3 } else { 1.0 };
            let value = match (self.payload, &payload.value) {
                (Some((column, unit)), _) => {
                    let kg = factor(unit) * joints.number(column, "a mass of 0 or more")?;
                    if kg < 0.0 {
                        let found = format!("{:?}", joints.text(column));
                        return Err(joints.error(column, found, "a mass of 0 or more"));
                    }
                    kg
                }
                (None, value) => {
                    let value = value.as_ref().map_or(0.0, |v| *v.get_ref());
                    factor(payload.unit.unwrap_or(MassUnit::Kg)) * value
                }
            };
            row.payload_kg = Some(value);
        }
        row.time_s = self.read_time(fields)?;
        let label = |column: Option<usize>, label: &Option<Label>| match column {
            Some(column) => fields.label(column).map(Some),
            None => Ok(label
                .as_ref()
                .and_then(|l| l.value.as_ref())
                .map(|v| v.get_ref().clone())),
        };
        row.session = label(self.session, &self.map.session)?;
        if self.map.target.is_some() {
            row.target = label(self.target, &self.map.target)?;
        }
        let above_zero = |column: usize, value: f64| {
            if value > 0.0 {
                return Ok(Some(value));
            }
            let found = format!("{:?}", fields.text(column));
            Err(fields.error(column, found, "a standard uncertainty above 0"))
        };
        if let Some((column, unit)) = self.sigma_position {
            row.sigma_mm = above_zero(column, fields.millimetres(column, unit)?)?;
        }
        if let Some((column, unit)) = self.sigma_orientation {
            row.sigma_mrad = above_zero(column, 1e3 * fields.radians(column, unit)?)?;
        }
        for reference in &self.references {
            let missed = reference.0.iter().all(|column| fields.is_missing(*column));
            let point = if missed {
                Vector3::zeros()
            } else {
                reference.read(fields)?
            };
            row.references_mm
                .push((point != Vector3::zeros()).then_some(point));
        }
        Ok(())
    }
}
