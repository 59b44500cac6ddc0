//! A table of Python, a DataFrame or a dictionary of columns, as the text of a measurement file.

use std::path::PathBuf;

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use poegp_calibration::input_error::InputError;

use crate::errors::input_error;

/// What messages call it.
const NAME: &str = "<table>";

/// The path of measurements; of a table its name, and the text of a file with its columns.
pub fn measurements(data: &Bound<'_, PyAny>) -> PyResult<(PathBuf, Option<Vec<u8>>)> {
    match data.extract::<PathBuf>() {
        Ok(path) => Ok((path, None)),
        Err(_) => Ok((PathBuf::from(NAME), Some(csv(data)?))),
    }
}

/// The text of a CSV file with these columns. Numbers are written as `repr` writes them, so that nothing of them is lost; what
/// is missing (None, NaN) is an empty field. The first row is line 2, as after the header of a file.
fn csv(data: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
    let py = data.py();
    let keys = data.call_method0("keys").map_err(|_| {
        let found = data.get_type();
        PyTypeError::new_err(format!(
            "data: found {found}, expected a path, a DataFrame or a dictionary of columns"
        ))
    })?;
    let mut names = Vec::new();
    let mut columns = Vec::new();
    for key in keys.try_iter()? {
        let key = key?;
        let name = key.str()?.to_string();
        let column = values(&name, &data.get_item(&key)?)?;
        if let Some(count) = columns.first().map(Vec::len)
            && column.len() != count
        {
            let error = InputError::new(
                NAME,
                format!("{} values", column.len()),
                format!("{count}, as the first column has"),
            );
            return Err(input_error(py, &error.at_column(columns.len() + 1, name)));
        }
        names.push(quoted(&name));
        columns.push(column);
    }
    let mut text = names.join(",");
    text.push('\n');
    for row in 0..columns.first().map_or(0, Vec::len) {
        let fields: Vec<&str> = columns.iter().map(|column| column[row].as_str()).collect();
        text += &fields.join(",");
        text.push('\n');
    }
    Ok(text.into_bytes())
}

/// The fields of a column.
fn values(name: &str, column: &Bound<'_, PyAny>) -> PyResult<Vec<String>> {
    if name == TIME {
        return seconds(column);
    }
    // An array knows which of its values are masked; they become None.
    let list = match column.hasattr("mask")? && column.hasattr("filled")? {
        true => column.call_method0("tolist")?,
        false => (column.py().import("numpy")?)
            .call_method1("asarray", (column,))?
            .call_method0("tolist")?,
    };
    let list = list.cast_into::<PyList>().map_err(|_| {
        PyTypeError::new_err("data: found a single value, expected a column of values")
    })?;
    list.iter().map(|value| field(&value)).collect()
}

/// The column that counts seconds from any moment.
const TIME: &str = "time_s";

/// The fields of a column of times: dates, times of NumPy and pandas, and numbers, in seconds. The unit of `datetime64[ns]` is
/// known, so that no number of nanoseconds is read as one of seconds.
fn seconds(column: &Bound<'_, PyAny>) -> PyResult<Vec<String>> {
    let numpy = column.py().import("numpy")?;
    let array = match column.hasattr("mask")? && column.hasattr("filled")? {
        true => column.clone(),
        false => numpy.call_method1("asarray", (column,))?,
    };
    let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
    let start = match kind.as_str() {
        "M" => numpy.call_method1("datetime64", (0, "s"))?,
        "m" => numpy.call_method1("timedelta64", (0, "s"))?,
        "O" => {
            let list = array.call_method0("tolist")?.cast_into::<PyList>()?;
            return list.iter().map(|value| moment(&value)).collect();
        }
        _ => return values("", column),
    };
    let elapsed = array.sub(start)?;
    let second = numpy.call_method1("timedelta64", (1, "s"))?;
    values("", &elapsed.div(second)?)
}

/// The field of one time, in seconds.
fn moment(value: &Bound<'_, PyAny>) -> PyResult<String> {
    // A time that is missing differs from itself.
    if value.ne(value).unwrap_or(true) {
        return Ok(String::new());
    }
    if value.hasattr("total_seconds")? {
        return field(&value.call_method0("total_seconds")?);
    }
    if value.hasattr("timestamp")? {
        let zone = value
            .py()
            .import("datetime")?
            .getattr("timezone")?
            .getattr("utc")?;
        let value = match value.getattr("tzinfo")?.is_none() {
            true => {
                let zoned = PyDict::new(value.py());
                zoned.set_item("tzinfo", zone)?;
                value.call_method("replace", (), Some(&zoned))?
            }
            false => value.clone(),
        };
        return field(&value.call_method0("timestamp")?);
    }
    field(value)
}

fn field(value: &Bound<'_, PyAny>) -> PyResult<String> {
    if value.is_none() || value.extract::<f64>().is_ok_and(f64::is_nan) {
        return Ok(String::new());
    }
    Ok(quoted(&value.str()?.to_string()))
}

/// With quotation marks where a text needs them: a line that begins with # would be a comment.
fn quoted(text: &str) -> String {
    match text.contains([',', '"', '\n', '\r']) || text.trim_start().starts_with('#') {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    }
}
