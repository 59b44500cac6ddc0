//! Keyword arguments of Python as options of the command line.

use std::ffi::OsString;

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyList, PyTuple};

/// Options of the command line from keyword arguments: `inducing_points=150` is `--inducing-points 150`, `True` is an option
/// without a value, a list repeats it or, of numbers, is one value.
pub fn given(options: Option<&Bound<'_, PyDict>>, refused: &[&str]) -> PyResult<Vec<OsString>> {
    let mut line = Vec::new();
    for (key, value) in options.into_iter().flatten() {
        let key: String = key.extract()?;
        if refused.contains(&key.as_str()) {
            return Err(PyTypeError::new_err(format!(
                "{key}: found an output of the command line, expected an option that names none"
            )));
        }
        let flag = format!("--{}", key.replace('_', "-"));
        // Arrays and numbers of NumPy as lists and numbers of Python.
        let value = match value.hasattr("tolist")? {
            true => value.call_method0("tolist")?,
            false => value,
        };
        if value.is_none() {
            continue;
        }
        if let Ok(is_set) = value.cast::<PyBool>() {
            if is_set.is_true() {
                line.push(flag.into());
            }
            continue;
        }
        let many = value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>();
        let numbers = value.extract::<Vec<f64>>();
        let values = match (many, numbers) {
            (true, Ok(numbers)) if !numbers.is_empty() => {
                let texts: Vec<String> = numbers.iter().map(ToString::to_string).collect();
                vec![texts.join(",")]
            }
            (true, _) => {
                let texts = value.try_iter()?;
                texts
                    .map(|item| Ok(item?.str()?.to_string()))
                    .collect::<PyResult<Vec<_>>>()?
            }
            _ => vec![value.str()?.to_string()],
        };
        line.extend(
            values
                .into_iter()
                .map(|text| format!("{flag}={text}").into()),
        );
    }
    Ok(line)
}
