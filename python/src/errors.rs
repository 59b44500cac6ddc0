//! Errors of the workspace as the exceptions of `poegp.errors`.

use pyo3::exceptions::{PyKeyboardInterrupt, PyOSError, PyValueError};
use pyo3::prelude::*;

use poegp_calibration::input_error::InputError;
use poegp_trainer::cli::embedded::Failure;

/// An exception of `poegp.errors` by its name.
fn raised<'py>(py: Python<'py>, name: &str, text: String) -> PyResult<Bound<'py, PyAny>> {
    py.import("poegp.errors")?.getattr(name)?.call1((text,))
}

fn built(error: PyResult<Bound<'_, PyAny>>) -> PyErr {
    match error {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => error,
    }
}

/// `poegp.InputError` with its file, line and column.
pub fn input_error(py: Python<'_>, error: &InputError) -> PyErr {
    let exception = || {
        let exception = raised(py, "InputError", error.to_string())?;
        exception.setattr("file", error.file.display().to_string())?;
        exception.setattr("line", error.line)?;
        exception.setattr("column", error.column.as_ref().map(|(number, _)| *number))?;
        let name = error.column.as_ref().map(|(_, name)| name.as_str());
        exception.setattr("column_name", name.filter(|name| !name.is_empty()))?;
        exception.setattr("found", &error.found)?;
        exception.setattr("expected", &error.expected)?;
        exception.setattr("help", &error.help)?;
        Ok(exception)
    };
    built(exception())
}

/// The text of an error of the operating system without its number, which Python writes itself.
fn said(error: &std::io::Error) -> String {
    let text = error.to_string();
    let end = text.find(" (os error").unwrap_or(text.len());
    text[..end].to_owned()
}

/// The exception of a command that failed.
pub fn failure(py: Python<'_>, failure: Failure) -> PyErr {
    match failure {
        Failure::Input(error) => input_error(py, &error),
        Failure::Usage(text) => PyValueError::new_err(text),
        Failure::Data(_) => built(raised(py, "DataRefused", failure.to_string())),
        Failure::Cancelled(_) => PyKeyboardInterrupt::new_err(failure.to_string()),
        Failure::LostOutput { output, error } => match error.raw_os_error() {
            Some(code) => PyOSError::new_err((code, said(&error), output)),
            None => PyOSError::new_err(format!("{output}: not written: {error}")),
        },
        _ => built(raised(py, "Error", failure.to_string())),
    }
}
