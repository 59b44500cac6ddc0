//! Arrays of Python as rows of numbers, with their shapes checked, and back.

use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyString};

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
    let value = numpy.call_method1("asarray", (value,))?;
    refuse_others(&value)?;
    numpy.call_method1("ascontiguousarray", (value, "float64"))
}

/// Refuses what NumPy would make a number of without asking: truth values, texts, complex numbers, times.
fn refuse_others(array: &Bound<'_, PyAny>) -> PyResult<()> {
    let dtype = array.getattr("dtype")?;
    let kind: String = dtype.getattr("kind")?.extract()?;
    match kind.as_str() {
        "f" | "i" | "u" => Ok(()),
        "O" => {
            for item in array.getattr("flat")?.try_iter()? {
                let item = item?;
                if item.is_instance_of::<PyBool>() || item.is_instance_of::<PyString>() {
                    let found = item.repr()?;
                    return Err(PyTypeError::new_err(format!("found {found}")));
                }
            }
            Ok(())
        }
        _ => Err(PyTypeError::new_err(format!("found the type {dtype}"))),
    }
}

/// Refuses a DataFrame whose columns are named in other units. `np.deg2rad` of a DataFrame keeps their names, so that these do
/// not tell what the numbers are.
fn refuse_units(value: &Bound<'_, PyAny>, name: &str) -> PyResult<()> {
    if !value.hasattr("columns")? {
        return Ok(());
    }
    for column in value.getattr("columns")?.try_iter()? {
        let column = column?.str()?.to_string();
        if column.ends_with("_deg") || column.ends_with("_mm") {
            return Err(PyValueError::new_err(format!(
                "{name}: found a column {column:?}, expected rad and m; for joints in degrees give \
                 np.deg2rad({name}.to_numpy()), for joints in rad {name}.to_numpy()"
            )));
        }
    }
    Ok(())
}

/// Refuses a matrix that is no pose: another last row, or a rotation that is not orthonormal and right-handed. A matrix with
/// numbers that are not finite is none of them; its row gets the status of a bad input.
pub fn check_pose(matrix: &[f64], name: &str) -> PyResult<()> {
    if !matrix.iter().all(|x| x.is_finite()) {
        return Ok(());
    }
    let refused = |found: String, expected: &str| {
        Err(PyValueError::new_err(format!(
            "{name}: found {found}, expected {expected}"
        )))
    };
    let last = &matrix[12..];
    if last
        .iter()
        .zip([0.0, 0.0, 0.0, 1.0])
        .any(|(a, b)| (a - b).abs() > ORTHONORMAL)
    {
        let expected =
            "[0, 0, 0, 1]: the translation stands in the last column; is the matrix transposed?";
        return refused(format!("the last row {last:?}"), expected);
    }
    let column = |j: usize| [matrix[j], matrix[4 + j], matrix[8 + j]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let mut off = 0.0_f64;
    for i in 0..3 {
        for j in 0..3 {
            let expected = f64::from(u8::from(i == j));
            off = off.max((dot(column(i), column(j)) - expected).abs());
        }
    }
    let [x, y, z] = [column(0), column(1), column(2)];
    let cross = [
        x[1] * y[2] - x[2] * y[1],
        x[2] * y[0] - x[0] * y[2],
        x[0] * y[1] - x[1] * y[0],
    ];
    if off > ORTHONORMAL {
        let expected = format!("an orthonormal rotation, to {ORTHONORMAL:e}");
        return refused(format!("a rotation that is off by {off:.1e}"), &expected);
    }
    if dot(cross, z) < 0.0 {
        return refused("a left-handed rotation".to_owned(), "a right-handed one");
    }
    Ok(())
}

/// How far a rotation may be from orthonormal. Poses that a model predicts in single precision are off by up to 1e-6.
const ORTHONORMAL: f64 = 5e-6;

/// `(n, …)` with the numbers after the first dimension as `shape`: n, and all numbers row by row. They are copied, so that
/// other threads of Python may change their array meanwhile.
pub fn rows(value: &Bound<'_, PyAny>, name: &str, shape: &[usize]) -> PyResult<(usize, Vec<f64>)> {
    refuse_units(value, name)?;
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
