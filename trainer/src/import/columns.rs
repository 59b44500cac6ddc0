//! Locates the columns of a map in a file.

use nalgebra::Vector3;
use toml::Spanned;

use crate::import::column_map::drivers::Driver;
use crate::import::column_map::{
    ColumnName, JointSource, JointUnit, JointUnits, LengthUnit, Map, Position,
};
use crate::import::text::Table;
use crate::import::units::{shared_unit, unit_of};
use crate::import::value::RowValues;
use poegp_calibration::input_error::{InputError, counted};

/// Column indices of x, y and z, and their unit of length.
pub struct Triple(pub [usize; 3], pub LengthUnit);

impl Triple {
    pub fn find(
        map: &Map,
        table: &Table,
        position: &Position,
        key: &str,
    ) -> Result<Self, InputError> {
        let xyz = columns(map, table, &position.columns, &format!("{key}.columns"))?;
        let unit = shared_unit(map, table, &xyz, position.unit, &format!("{key}.unit"))?;
        Ok(Self(xyz, unit))
    }

    pub fn read(&self, fields: &RowValues<'_>) -> Result<Vector3<f64>, InputError> {
        let mut out = Vector3::zeros();
        for (x, column) in out.iter_mut().zip(self.0) {
            *x = fields.millimetres(column, self.1)?;
        }
        Ok(out)
    }
}

/// Returns the column index and the unit of each joint, base first.
pub fn joint_columns(map: &Map, table: &Table) -> Result<Vec<(usize, JointUnit)>, InputError> {
    let (columns, driver) = match &map.joints.source {
        JointSource::Columns(columns) => (all(map, table, columns, "joints.columns")?, None),
        JointSource::Driver(name) => {
            // The map was checked: a driver with this name exists.
            let driver = Driver::named(name.get_ref());
            let has = |name: &str| table.find(&ColumnName::Name(name.to_owned())).is_ok();
            let names = driver.map_or_else(Vec::new, |driver| driver.columns(has));
            let find = |column: String| {
                table
                    .find(&ColumnName::Name(column))
                    .map_err(|(found, expected)| {
                        map.error(name.span(), "joints.driver", found, expected)
                    })
            };
            let columns = names.into_iter().map(find).collect::<Result<_, _>>()?;
            (columns, driver)
        }
    };
    let stated = |joint: usize| match (driver, map.joints.unit.as_ref().map(Spanned::get_ref)) {
        (Some(driver), _) => Some(driver.unit),
        (None, Some(JointUnits::All(unit))) => Some(*unit),
        (None, Some(JointUnits::Each(units))) => units.get(joint).copied(),
        (None, None) => None,
    };
    let joints = columns.into_iter().enumerate();
    joints
        .map(|(joint, column)| {
            let key = if driver.is_some() {
                "joints.driver"
            } else {
                "joints.unit"
            };
            let unit = unit_of(map, table, column, stated(joint), key)?;
            Ok((column, unit))
        })
        .collect()
}

/// Returns the joint values of a row with the units of their columns: degrees for revolute joints, millimetres for
/// prismatic ones.
pub fn joint_values(
    fields: &RowValues<'_>,
    columns: &[(usize, JointUnit)],
) -> Result<Vec<(f64, JointUnit)>, InputError> {
    let joints = columns.iter();
    joints
        .map(|(column, unit)| Ok((fields.joint(*column, *unit)?, *unit)))
        .collect()
}

/// Refuses a column that the map uses twice, and returns a note that lists the columns that it does not use.
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

/// Returns the index of one column.
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

/// Returns the index of a column that the map may lack.
pub fn optional(
    map: &Map,
    table: &Table,
    column: Option<&Spanned<ColumnName>>,
    key: &str,
) -> Result<Option<usize>, InputError> {
    column
        .map(|column| one(map, table, column, key))
        .transpose()
}

pub fn all(
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

/// Returns the indices of N columns. The reader of the map has checked their number.
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
            counted(locations.len(), "column"),
            counted(N, "column"),
        )
    })
}
