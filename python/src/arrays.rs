//! Arrays of Python as rows of numbers, with their shapes checked, and back.

use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// Anything that NumPy makes an array of numbers of, as one in C order.
fn array<'py>(value: &Bound<'py, PyAny>, name: &str) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let made = contiguous(value).map_err(|error| {
        PyTypeError::new_err(format!("{name}: expected an array of numbers ({error})"))
    })?;
    Ok(made.cast_into::<PyArrayDyn<f64>>()?)
}

fn contiguous<'py>(value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let mut value = value.clone();
    if value.hasattr("mask")? && value.hasattr("filled")? {
        // What is masked is no number.
        value = value.call_method1("astype", ("float64",))?;
        value = value.call_method1("filled", (f64::NAN,))?;
    }
    let numpy = value.py().import("numpy")?;
    numpy.call_method1("ascontiguousarray", (value, "float64"))
}

/// `(n, …)` with the numbers after the first dimension as `shape`: n, and all numbers row by row. They are copied, so that
/// other threads of Python may change their array meanwhile.
pub fn rows(value: &Bound<'_, PyAny>, name: &str, shape: &[usize]) -> PyResult<(usize, Vec<f64>)> {
    let array = array(value, name)?;
    let found = array.shape();
    if found.len() != shape.len() + 1 || &found[1..] != shape {
        let help = match found == shape {
            true => format!("; for one row give {name}[None]"),
            false => String::new(),
        };
        return Err(PyValueError::new_err(format!(
            "{name}: found an array of shape {}, expected (n, {}){help}",
            tuple(found),
            tuple(shape)
                .trim_start_matches('(')
                .trim_end_matches([',', ')'])
        )));
    }
    Ok((found[0], array.to_vec()?))
}

/// The numbers of an array with this shape, row by row.
pub fn one(value: &Bound<'_, PyAny>, name: &str, shape: &[usize]) -> PyResult<Vec<f64>> {
    let array = array(value, name)?;
    match array.shape() == shape {
        true => Ok(array.to_vec()?),
        false => Err(PyValueError::new_err(format!(
            "{name}: found an array of shape {}, expected {}",
            tuple(array.shape()),
            tuple(shape)
        ))),
    }
}

/// A shape as Python writes it.
fn tuple(shape: &[usize]) -> String {
    let numbers: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let ending = if shape.len() == 1 { "," } else { "" };
    format!("({}{ending})", numbers.join(", "))
}

/// One number for each of `n` rows, from one number or an array `(n,)`.
pub fn each(value: &Bound<'_, PyAny>, name: &str, n: usize) -> PyResult<Vec<f64>> {
    let array = array(value, name)?;
    let numbers = array.to_vec()?;
    // `ascontiguousarray` makes one dimension of none.
    match numbers.as_slice() {
        [one] if n != 1 => Ok(vec![*one; n]),
        _ if array.ndim() == 1 && numbers.len() == n => Ok(numbers),
        _ => Err(PyValueError::new_err(format!(
            "{name}: found an array of shape {}, expected one number or shape {}",
            tuple(array.shape()),
            tuple(&[n])
        ))),
    }
}

/// `numbers` as an array of this shape.
pub fn shaped<'py>(
    py: Python<'py>,
    numbers: Vec<f64>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    PyArray1::from_vec(py, numbers).reshape(shape.to_vec())
}

/// `numbers` as an array of one dimension.
pub fn column<'py, T: numpy::Element>(py: Python<'py>, numbers: Vec<T>) -> Bound<'py, PyArray1<T>> {
    PyArray1::from_vec(py, numbers)
}
