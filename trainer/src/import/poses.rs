//! A file with one pose a row.

use nalgebra::{Matrix3, Vector3};
use toml::Spanned;

use crate::import::column_map::{
    AngleUnit, ColumnName, Incomplete, JointUnit, JointUnits, Label, LengthUnit, Map, MassUnit,
    MatrixLayout, Orientation, Position,
};
use crate::import::orientation;
use crate::import::orientation::Reader;
use crate::import::text::Table;
use crate::import::units::{shared_unit, unit_of};
use crate::import::value::RowValues;
use crate::import::write::Row;
use poegp_calibration::input_error::InputError;

/// What is off a rotation by more is noted when it is made one.
const NOTED: f64 = 1e-6;

/// Where x, y and z are.
struct Triple([usize; 3], LengthUnit);

impl Triple {
    fn find(map: &Map, table: &Table, position: &Position, key: &str) -> Result<Self, InputError> {
        let xyz = columns(map, table, &position.columns, &format!("{key}.columns"))?;
        let unit = shared_unit(map, table, &xyz, position.unit, &format!("{key}.unit"))?;
        Ok(Self(xyz, unit))
    }

    fn read(&self, fields: &RowValues<'_>) -> Result<Vector3<f64>, InputError> {
        let mut out = Vector3::zeros();
        for (x, column) in out.iter_mut().zip(self.0) {
            *x = fields.millimetres(column, self.1)?;
        }
        Ok(out)
    }
}

/// What every row has beside the pose.
pub struct Beside<'a> {
    map: &'a Map,
    payload: Option<(usize, MassUnit)>,
    session: Option<usize>,
    target: Option<usize>,
    sigma_position: Option<(usize, LengthUnit)>,
    sigma_orientation: Option<(usize, AngleUnit)>,
    references: Vec<Triple>,
}

impl<'a> Beside<'a> {
    /// Finds the columns.
    pub fn find(map: &'a Map, table: &Table) -> Result<Self, InputError> {
        let of = |label: &Option<Label>, key: &str| {
            let column = label.as_ref().and_then(|label| label.column.as_ref());
            column
                .map(|column| one(map, table, column, key))
                .transpose()
        };
        let payload = map.payload.as_ref().and_then(|payload| {
            let column = payload.column.as_ref()?;
            Some(
                one(map, table, column, "payload.column").and_then(|column| {
                    let unit = unit_of(map, table, column, payload.unit, "payload.unit")?;
                    Ok((column, unit))
                }),
            )
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
            session: of(&map.session, "session.column")?,
            target: of(&map.target, "target.column")?,
            sigma_position: sigma_position.transpose()?,
            sigma_orientation: sigma_orientation.transpose()?,
            references: references.collect::<Result<_, _>>()?,
        })
    }

    /// The columns that it reads.
    pub fn columns(&self) -> Vec<usize> {
        let mut out: Vec<usize> = [self.session, self.target].into_iter().flatten().collect();
        out.extend(self.payload.map(|p| p.0));
        out.extend(self.sigma_position.map(|s| s.0));
        out.extend(self.sigma_orientation.map(|s| s.0));
        out.extend(self.references.iter().flat_map(|r| r.0));
        out
    }

    /// Fills in a row.
    pub fn read(&self, fields: &RowValues<'_>, row: &mut Row) -> Result<(), InputError> {
        if let Some(payload) = &self.map.payload {
            let factor = |unit| if unit == MassUnit::G { 1e-3 } else { 1.0 };
            let value = match (self.payload, &payload.value) {
                (Some((column, unit)), _) => {
                    let kg = factor(unit) * fields.number(column, "a mass of 0 or more")?;
                    if kg < 0.0 {
                        let found = format!("{:?}", fields.text(column));
                        return Err(fields.error(column, found, "a mass of 0 or more"));
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
            let missed = reference
                .0
                .iter()
                .all(|column| fields.text(*column).is_empty());
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

/// How the pose is read.
enum PoseReader {
    Apart(Triple, Option<Reader>),
    Matrix(Vec<usize>, LengthUnit, MatrixLayout),
}

/// The rows of a file, and what its user should see.
pub fn rows(table: &Table, map: &Map) -> Result<(Vec<Row>, Vec<String>), InputError> {
    let joints = joint_columns(map, table)?;
    let beside = Beside::find(map, table)?;
    let pose = pose_reader(map, table)?;
    let mut used: Vec<usize> = joints.iter().map(|joint| joint.0).collect();
    used.extend(beside.columns());
    match &pose {
        PoseReader::Apart(position, orientation) => {
            used.extend(position.0);
            used.extend(orientation.iter().flat_map(|o| o.columns()));
        }
        PoseReader::Matrix(columns, ..) => used.extend(columns),
    }
    let mut notes = twice_or_unused(map, table, &used)?;

    let (mut out, mut left_out) = (Vec::new(), Vec::new());
    let mut worst = (0.0_f64, 0);
    for line in &table.rows {
        let fields = RowValues { table, line };
        if map.incomplete == Incomplete::LeaveOut && is_miss(&fields, &used, &pose) {
            left_out.push(line.number.to_string());
            continue;
        }
        let mut row = Row {
            joints: joint_values(&fields, &joints)?,
            ..Row::default()
        };
        let (position, found, first) = match &pose {
            PoseReader::Apart(position, orientation) => {
                let found = orientation.as_ref().map(|o| o.read(&fields)).transpose()?;
                (position.read(&fields)?, found, position.0[0])
            }
            PoseReader::Matrix(columns, unit, layout) => {
                let (position, found) = whole(&fields, columns, *unit, *layout)?;
                (position, Some(found), columns[0])
            }
        };
        if position == Vector3::zeros() {
            return Err(fields
                .error(first, "the position 0 0 0", "a measured position")
                .with_help(
                    "an instrument writes 0 0 0 where it missed the target; incomplete = \"leave-out\" in the map leaves \
                     such rows out and lists them",
                ));
        }
        row.position_mm = position;
        if let Some(found) = found {
            if found.off > worst.0 {
                worst = (found.off, line.number);
            }
            row.orientation = Some(found.rotation);
        }
        beside.read(&fields, &mut row)?;
        out.push(row);
    }
    if worst.0 > NOTED {
        notes.push(format!(
            "the orientations were made rotations: they are off by up to {:.1e} (line {})",
            worst.0, worst.1
        ));
    }
    notes.extend(left_out_note(&left_out));
    if out.is_empty() {
        return Err(InputError::new(
            &table.path,
            "no row with a measurement",
            "one at least",
        ));
    }
    Ok((out, notes))
}

/// Whether a cell that is read is empty, or the position is 0 0 0.
fn is_miss(fields: &RowValues<'_>, used: &[usize], pose: &PoseReader) -> bool {
    let zero = |columns: &[usize], unit| {
        columns
            .iter()
            .all(|c| fields.millimetres(*c, unit).is_ok_and(|x| x == 0.0))
    };
    let missed = match pose {
        PoseReader::Apart(position, _) => zero(&position.0, position.1),
        PoseReader::Matrix(columns, unit, layout) => zero(&translation(columns, *layout), *unit),
    };
    missed || used.iter().any(|column| fields.text(*column).is_empty())
}

/// The note on what was left out, which the map asked for.
pub fn left_out_note(what: &[String]) -> Option<String> {
    (!what.is_empty()).then(|| {
        let rows = if what.len() == 1 {
            "1 row"
        } else {
            &format!("{} rows", what.len())
        };
        format!(
            "left out, as the map asks: {rows} without a whole measurement (lines {})",
            what.join(", ")
        )
    })
}

fn pose_reader(map: &Map, table: &Table) -> Result<PoseReader, InputError> {
    if let Some(pose) = &map.pose {
        let columns = all(map, table, &pose.columns, "pose.columns")?;
        let xyz = translation(&columns, pose.layout);
        let unit = shared_unit(map, table, &xyz, pose.unit, "pose.unit")?;
        return Ok(PoseReader::Matrix(columns, unit, pose.layout));
    }
    let Some(position) = &map.position else {
        return Err(InputError::new(
            &map.path,
            "no [position]",
            "it, in a map without [points] or [pose]",
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
            // The map was checked.
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

/// Where element (row, column) of a 3×4 or 4×4 matrix is.
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

/// Position in mm and rotation of a whole matrix.
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

/// Where the joints are, and their units.
pub fn joint_columns(map: &Map, table: &Table) -> Result<Vec<(usize, JointUnit)>, InputError> {
    let columns = all(map, table, &map.joints.columns, "joints.columns")?;
    let stated = |joint: usize| match map.joints.unit.as_ref()?.get_ref() {
        JointUnits::All(unit) => Some(*unit),
        JointUnits::Each(units) => units.get(joint).copied(),
    };
    let joints = columns.into_iter().enumerate();
    joints
        .map(|(joint, column)| {
            let unit = unit_of(map, table, column, stated(joint), "joints.unit")?;
            Ok((column, unit))
        })
        .collect()
}

/// The joints of a row, in degrees or millimetres.
pub fn joint_values(
    fields: &RowValues<'_>,
    columns: &[(usize, JointUnit)],
) -> Result<Vec<(f64, JointUnit)>, InputError> {
    let joints = columns.iter();
    joints
        .map(|(column, unit)| Ok((fields.joint(*column, *unit)?, *unit)))
        .collect()
}

/// Refuses a column that is two things, and notes those that are nothing.
pub fn twice_or_unused(
    map: &Map,
    table: &Table,
    used: &[usize],
) -> Result<Vec<String>, InputError> {
    let name = |index: usize| match table.name(index) {
        "" => format!("column {}", index + 1),
        name => format!("{name:?}"),
    };
    if let Some((_, twice)) = used
        .iter()
        .enumerate()
        .find(|(i, column)| used[..*i].contains(column))
    {
        let found = format!(
            "{} of {} for two things",
            name(*twice),
            table.path.display()
        );
        return Err(InputError::new(&map.path, found, "every column once"));
    }
    let unused: Vec<String> = (0..table.width())
        .filter(|i| !used.contains(i))
        .map(name)
        .collect();
    Ok(match unused.len() {
        0 => Vec::new(),
        _ => vec![format!(
            "{}: not in the map and not imported: {}",
            table.path.display(),
            unused.join(", ")
        )],
    })
}

/// The place of one column.
pub fn one(
    map: &Map,
    table: &Table,
    column: &Spanned<ColumnName>,
    key: &str,
) -> Result<usize, InputError> {
    table
        .find(column.get_ref())
        .map_err(|(found, expected)| map.error(column.span(), key, found, expected))
}

fn all(
    map: &Map,
    table: &Table,
    columns: &Spanned<Vec<ColumnName>>,
    key: &str,
) -> Result<Vec<usize>, InputError> {
    let find = |column: &ColumnName| {
        table
            .find(column)
            .map_err(|(found, expected)| map.error(columns.span(), key, found, expected))
    };
    columns.get_ref().iter().map(find).collect()
}

/// The places of N columns, whose number the map's reader has checked.
pub fn columns<const N: usize>(
    map: &Map,
    table: &Table,
    names: &Spanned<Vec<ColumnName>>,
    key: &str,
) -> Result<[usize; N], InputError> {
    let locations = all(map, table, names, key)?;
    <[usize; N]>::try_from(locations).map_err(|locations| {
        map.error(
            names.span(),
            key,
            format!("{} columns", locations.len()),
            format!("{N} columns"),
        )
    })
}
