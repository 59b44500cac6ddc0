//! Reads the pose of a row: a position with or without an orientation, one matrix, or reflectors.

use nalgebra::{Matrix3, Vector3};

use crate::import::column_map::{LengthUnit, Map, MatrixLayout, Orientation};
use crate::import::columns::{Triple, all, columns};
use crate::import::orientation;
use crate::import::orientation::Reader;
use crate::import::rigid::{MAX_RESIDUAL_MM, fitted};
use crate::import::text::Table;
use crate::import::units::shared_unit;
use crate::import::value::RowValues;
use poegp_calibration::input_error::{InputError, counted};

/// Notation of the pose, with the indices of its columns.
pub enum PoseReader {
    Apart(Triple, Option<Reader>),
    Matrix(Vec<usize>, LengthUnit, MatrixLayout),
    Reflectors(Reflected),
}

/// Pairs of a point as seen by the instrument and on the tool, and the indices of these reflectors.
type Seen = (Vec<(Vector3<f64>, Vector3<f64>)>, Vec<usize>);

/// Three or more reflectors in a row.
pub struct Reflected {
    /// Columns of each reflector, and its position on the tool in mm.
    reflectors: Vec<(Triple, Vector3<f64>)>,
    max_residual_mm: f64,
}

impl Reflected {
    /// Returns the reflectors that the instrument saw in this row, and their indices. The fields of a missed reflector are
    /// empty, `NaN` or `0 0 0`.
    fn seen(&self, fields: &RowValues<'_>) -> Result<Seen, InputError> {
        let mut pairs = (Vec::new(), Vec::new());
        for (i, (columns, location)) in self.reflectors.iter().enumerate() {
            if columns.0.iter().all(|column| fields.is_missing(*column)) {
                continue;
            }
            let point = columns.read(fields)?;
            if point != Vector3::zeros() {
                pairs.0.push((point, *location));
                pairs.1.push(i);
            }
        }
        Ok(pairs)
    }

    fn read(
        &self,
        fields: &RowValues<'_>,
    ) -> Result<(Vector3<f64>, orientation::ReadOrientation), InputError> {
        let (pairs, which) = self.seen(fields)?;
        let Some(fit) = fitted(&pairs) else {
            let found = format!(
                "{} of {}",
                counted(pairs.len(), "reflector"),
                self.reflectors.len()
            );
            return Err(fields
                .error(
                    self.reflectors[0].0.0[0],
                    found,
                    "three reflectors or more that are not on one line",
                )
                .with_help(
                    "incomplete = \"leave-out\" in the map leaves such rows out and lists them",
                ));
        };
        if fit.residual > self.max_residual_mm {
            let column = self.reflectors[which[fit.worst]].0.0[0];
            let found = format!(
                "reflectors that fit their positions on the tool only to {:.3} mm, this one worst",
                fit.residual
            );
            return Err(fields
                .error(
                    column,
                    found,
                    format!("reflectors within {} mm", self.max_residual_mm),
                )
                .with_help(
                    "are reflectors exchanged, or are their positions those of another tool? \
                            reflectors.max_residual_mm is the limit",
                ));
        }
        let orientation = orientation::ReadOrientation {
            rotation: fit.rotation,
            off: 0.0,
        };
        Ok((fit.translation, orientation))
    }
}

impl PoseReader {
    /// Returns the indices of the columns that this reader reads.
    pub fn columns(&self) -> Vec<usize> {
        match self {
            Self::Apart(position, orientation) => {
                let orientation = orientation.iter().flat_map(Reader::columns);
                position.0.iter().chain(orientation).copied().collect()
            }
            Self::Matrix(columns, ..) => columns.clone(),
            Self::Reflectors(how) => how
                .reflectors
                .iter()
                .flat_map(|(columns, _)| columns.0)
                .collect(),
        }
    }

    /// Returns the indices of the columns of x, y and z, if the position has columns of its own.
    pub fn position(&self) -> Option<[usize; 3]> {
        match self {
            Self::Apart(position, _) => Some(position.0),
            Self::Matrix(..) | Self::Reflectors(_) => None,
        }
    }

    /// Returns how many reflectors the instrument missed in a row with a measurement.
    pub fn missed(&self, fields: &RowValues<'_>) -> Result<usize, InputError> {
        match self {
            Self::Reflectors(how) => Ok(how.reflectors.len() - how.seen(fields)?.1.len()),
            Self::Apart(..) | Self::Matrix(..) => Ok(0),
        }
    }

    /// Returns position (mm) and orientation of a row, and the first column of the position.
    pub fn read(
        &self,
        fields: &RowValues<'_>,
    ) -> Result<(Vector3<f64>, Option<orientation::ReadOrientation>, usize), InputError> {
        match self {
            Self::Apart(position, orientation) => {
                let found = orientation.as_ref().map(|o| o.read(fields)).transpose()?;
                Ok((position.read(fields)?, found, position.0[0]))
            }
            Self::Matrix(columns, unit, layout) => {
                let (position, found) = whole(fields, columns, *unit, *layout)?;
                Ok((position, Some(found), columns[0]))
            }
            Self::Reflectors(how) => {
                let (position, found) = how.read(fields)?;
                Ok((position, Some(found), how.reflectors[0].0.0[0]))
            }
        }
    }
}

/// Returns whether the instrument missed the target: a field of the pose is missing, the position is 0 0 0, or the
/// reflectors that it saw do not span a plane.
pub fn is_miss(fields: &RowValues<'_>, pose: &PoseReader) -> bool {
    let zero = |columns: &[usize], unit| {
        columns
            .iter()
            .all(|c| fields.millimetres(*c, unit).is_ok_and(|x| x == 0.0))
    };
    let missed = match pose {
        PoseReader::Apart(position, _) => zero(&position.0, position.1),
        PoseReader::Matrix(columns, unit, layout) => zero(&translation(columns, *layout), *unit),
        PoseReader::Reflectors(how) => {
            return how
                .seen(fields)
                .is_ok_and(|(pairs, _)| fitted(&pairs).is_none());
        }
    };
    missed
        || pose
            .columns()
            .iter()
            .any(|column| fields.is_missing(*column))
}

pub fn pose_reader(map: &Map, table: &Table) -> Result<PoseReader, InputError> {
    if let Some(pose) = &map.pose {
        let columns = all(map, table, &pose.columns, "pose.columns")?;
        let xyz = translation(&columns, pose.layout);
        let unit = shared_unit(map, table, &xyz, pose.unit, "pose.unit")?;
        return Ok(PoseReader::Matrix(columns, unit, pose.layout));
    }
    if let Some(how) = &map.reflectors {
        let key = "reflectors.columns";
        let mut reflectors = Vec::new();
        for (names, location) in how.columns.get_ref().iter().zip(how.at.get_ref()) {
            let mut xyz = [0; 3];
            for (index, name) in xyz.iter_mut().zip(names) {
                *index = table.find(name).map_err(|(found, expected)| {
                    map.error(how.columns.span(), key, found, expected)
                })?;
            }
            let unit = shared_unit(map, table, &xyz, how.unit, "reflectors.unit")?;
            let location = how.at_unit.in_mm() * Vector3::from(location.0);
            reflectors.push((Triple(xyz, unit), location));
        }
        let limit = how.max_residual_mm.as_ref().map(|limit| *limit.get_ref());
        return Ok(PoseReader::Reflectors(Reflected {
            reflectors,
            max_residual_mm: limit.unwrap_or(MAX_RESIDUAL_MM),
        }));
    }
    let Some(position) = &map.position else {
        return Err(InputError::new(
            &map.path,
            "no [position]",
            "[position], as the map has neither [points] nor [pose]",
        ));
    };
    let position = Triple::find(map, table, position, "position")?;
    let key = "orientation.columns";
    let orientation = match &map.orientation {
        None => None,
        Some(Orientation::Quaternion { columns: c, order }) => {
            Some(Reader::Quaternion(columns(map, table, c, key)?, *order))
        }
        Some(Orientation::Euler {
            columns: c,
            order,
            axes,
            unit,
        }) => {
            // The map was checked: the order is valid.
            let order = orientation::axes(order.get_ref()).unwrap_or([2, 1, 0]);
            let columns = columns(map, table, c, key)?;
            let unit = shared_unit(map, table, &columns, *unit, "orientation.unit")?;
            Some(Reader::Euler(columns, order, *axes, unit))
        }
        Some(Orientation::RotationVector { columns: c, unit }) => {
            let columns = columns(map, table, c, key)?;
            let unit = shared_unit(map, table, &columns, *unit, "orientation.unit")?;
            Some(Reader::RotationVector(columns, unit))
        }
        Some(Orientation::Matrix { columns: c, layout }) => {
            Some(Reader::Matrix(columns(map, table, c, key)?, *layout))
        }
    };
    Ok(PoseReader::Apart(position, orientation))
}

/// Returns the column of element (row, column) of a 3×4 or 4×4 matrix.
fn element(columns: &[usize], layout: MatrixLayout, row: usize, column: usize) -> usize {
    let rows = columns.len() / 4;
    match layout {
        MatrixLayout::Rows => columns[4 * row + column],
        MatrixLayout::Columns => columns[rows * column + row],
    }
}

fn translation(columns: &[usize], layout: MatrixLayout) -> Vec<usize> {
    (0..3).map(|row| element(columns, layout, row, 3)).collect()
}

/// Reads a 3×4 or 4×4 matrix, and returns position (mm) and rotation.
fn whole(
    fields: &RowValues<'_>,
    columns: &[usize],
    unit: LengthUnit,
    layout: MatrixLayout,
) -> Result<(Vector3<f64>, orientation::ReadOrientation), InputError> {
    let mut rotation = Matrix3::zeros();
    let mut position = Vector3::zeros();
    for row in 0..3 {
        for column in 0..3 {
            let at = element(columns, layout, row, column);
            rotation[(row, column)] = fields.number(at, "an element of a rotation matrix")?;
        }
        position[row] = fields.millimetres(element(columns, layout, row, 3), unit)?;
    }
    if columns.len() == 16 {
        for column in 0..4 {
            let at = element(columns, layout, 3, column);
            let wanted = if column == 3 { 1.0 } else { 0.0 };
            if fields.number(at, "0 0 0 1, the last row of the matrix")? != wanted {
                let found = format!("{:?}", fields.text(at));
                return Err(fields
                    .error(at, found, format!("{wanted}, as the last row of the matrix is 0 0 0 1"))
                    .with_help("are the columns in the order of the map (layout = \"rows\" or \"columns\")?"));
            }
        }
    }
    Ok((
        position,
        orientation::matrix(fields, element(columns, layout, 0, 0), &rotation)?,
    ))
}
