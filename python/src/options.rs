//! Keyword arguments of Python as options of the command line.

use std::ffi::OsString;
use std::path::PathBuf;

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyInt, PyString};

use poegp_trainer::cli::embedded::{self, Takes};

/// Options of `trainer COMMAND` from keyword arguments: `inducing_points=150` is `--inducing-points 150`, `True` is an option
/// without a value, a list repeats it or, of numbers, is one value. `refused` are outputs.
pub fn given(
    command: &str,
    options: Option<&Bound<'_, PyDict>>,
    refused: &[&str],
) -> PyResult<Vec<OsString>> {
    let mut line = Vec::new();
    let Some(options) = options else {
        return Ok(line);
    };
    let known = embedded::options(command);
    for (key, value) in options {
        let key: String = key.extract()?;
        let name = key.replace('_', "-");
        if refused
            .iter()
            .any(|output| output.replace('_', "-") == name)
        {
            return Err(PyTypeError::new_err(format!(
                "{key}: found an output of the command line, expected an option that names none"
            )));
        }
        let Some((_, takes)) = known.iter().find(|(option, _)| *option == name) else {
            return Err(unknown(options.py(), &key, &known));
        };
        // Arrays and numbers of NumPy as lists and numbers of Python.
        let value = match value.hasattr("tolist")? {
            true => value.call_method0("tolist")?,
            false => value,
        };
        if value.is_none() {
            continue;
        }
        let flag = OsString::from(format!("--{name}"));
        let expected = match (value.cast::<PyBool>(), takes) {
            (Ok(is_set), Takes::Nothing | Takes::Maybe) => {
                line.extend(is_set.is_true().then_some(flag));
                continue;
            }
            (Err(_), Takes::Nothing) => "True or False",
            (Ok(_), Takes::Value) => "a value",
            (Err(_), _) => {
                for text in texts(&key, &value)? {
                    let mut option = flag.clone();
                    option.push("=");
                    option.push(text);
                    line.push(option);
                }
                continue;
            }
        };
        return Err(PyValueError::new_err(format!(
            "{key}: found {}, expected {expected}",
            value.repr()?
        )));
    }
    Ok(line)
}

/// The error about an option that does not exist, with the nearest one that does.
fn unknown(py: Python<'_>, key: &str, known: &[(String, Takes)]) -> PyErr {
    let names: Vec<String> = known
        .iter()
        .map(|(name, _)| name.replace('-', "_"))
        .collect();
    let nearest = py
        .import("difflib")
        .and_then(|m| m.call_method1("get_close_matches", (key, names, 1)))
        .and_then(|found| found.extract::<Vec<String>>());
    let help = match nearest.unwrap_or_default().first() {
        Some(name) => format!("; did you mean `{name}`?"),
        None => String::new(),
    };
    PyValueError::new_err(format!("unknown option `{key}`{help}"))
}

/// The values of an option: several for a list, but one for a list of numbers.
fn texts(key: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<OsString>> {
    let is_one = value.is_instance_of::<PyString>() || value.is_instance_of::<PyBytes>();
    if is_one || value.hasattr("keys")? {
        return Ok(vec![text(key, value)?]);
    }
    let Ok(items) = value.try_iter() else {
        return Ok(vec![text(key, value)?]);
    };
    let items: Vec<Bound<'_, PyAny>> = items.collect::<PyResult<_>>()?;
    let numbers: PyResult<Vec<f64>> = items.iter().map(|item| item.extract()).collect();
    match numbers {
        Ok(numbers) if !numbers.is_empty() => {
            let texts: Vec<String> = numbers.iter().map(ToString::to_string).collect();
            Ok(vec![texts.join(",").into()])
        }
        _ => items.iter().map(|item| text(key, item)).collect(),
    }
}

/// One value: text, a number, a path or a day.
fn text(key: &str, value: &Bound<'_, PyAny>) -> PyResult<OsString> {
    if value.is_instance_of::<PyFloat>() {
        // 150.0 is 150 for an option that counts.
        return Ok(value.extract::<f64>()?.to_string().into());
    }
    if let Ok(path) = value.extract::<PathBuf>() {
        return Ok(path.into_os_string());
    }
    let is_number = value.is_instance_of::<PyInt>() && !value.is_instance_of::<PyBool>();
    if is_number || value.hasattr("isoformat")? {
        return Ok(value.str()?.to_string().into());
    }
    let found = value.get_type();
    Err(PyTypeError::new_err(format!(
        "{key}: found {found}, expected text, a number or a path"
    )))
}
