//! Calibrations, exports and corrected programs: commands of the trainer without its terminal.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use poegp_trainer::cli::embedded::{self, Calibrated};

use crate::errors::failure;
use crate::options::given;
use crate::table;

/// How often a calibration looks for Ctrl-C.
const SIGNALS: Duration = Duration::from_millis(20);

/// A calibration; see `poegp.Calibration` in the stubs.
#[pyclass(frozen, module = "poegp")]
pub struct Calibration {
    made: Calibrated,
    /// What it was made with, for the report.
    options: Vec<OsString>,
    data: Option<Vec<u8>>,
}

#[pymethods]
impl Calibration {
    /// The bytes of the blob.
    #[getter]
    fn blob<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.made.blob)
    }

    /// What `trainer calibrate --json` writes, as a dictionary.
    #[getter]
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        loads(py, &self.made.json)
    }

    /// Writes the blob.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        Ok(std::fs::write(path, &self.made.blob)?)
    }

    /// Writes an HTML page with held-out errors: calibrates again, and five times more for cross-validation.
    fn report(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let mut options = self.options.clone();
        options.extend([OsString::from("--report"), path.clone().into()]);
        let again = calibrated(py, options, self.data.clone())?;
        if again.blob != self.made.blob {
            return Err(PyRuntimeError::new_err(
                "report: the files of this calibration have changed: calibrate again",
            ));
        }
        let page = again.report.unwrap_or_default();
        Ok(std::fs::write(path, page)?)
    }

    fn __repr__(&self) -> String {
        format!(
            "<poegp.Calibration: blob of {} bytes>",
            self.made.blob.len()
        )
    }
}

/// Calibrates; see `poegp.calibrate` in the stubs.
#[pyfunction]
#[pyo3(signature = (robot, data, **options))]
pub fn calibrate(
    py: Python<'_>,
    robot: PathBuf,
    data: &Bound<'_, PyAny>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Calibration> {
    let (name, data) = match data.extract::<PathBuf>() {
        Ok(path) => (path, None),
        Err(_) => (PathBuf::from(table::NAME), Some(table::csv(data)?)),
    };
    let mut line = vec![OsString::from("--robot"), robot.into()];
    line.extend(given(
        options,
        &["out", "json", "report", "write_project", "controller_csv"],
    )?);
    line.extend(["--out", "(in memory)"].map(OsString::from));
    line.push(name.into());
    let made = calibrated(py, line.clone(), data.clone())?;
    Ok(Calibration {
        made,
        options: line,
        data,
    })
}

/// Corrects a robot program; see `poegp.correct_program` in the stubs.
#[pyfunction]
#[pyo3(signature = (programs, out, blob, **options))]
pub fn correct_program<'py>(
    py: Python<'py>,
    programs: Vec<PathBuf>,
    out: PathBuf,
    blob: PathBuf,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let mut line = given(options, &["out", "json"])?;
    line.extend([OsString::from("--out"), out.into(), blob.into()]);
    line.extend(programs.into_iter().map(OsString::from));
    let done = py.detach(|| embedded::correct_program(&line).map_err(Box::new));
    loads(py, &done.map_err(|error| failure(py, *error))?)
}

/// Writes a model as a file of another program; see `poegp.Model.export_urdf` in the stubs.
#[pyfunction]
#[pyo3(signature = (blob, **options))]
pub fn export<'py>(
    py: Python<'py>,
    blob: PathBuf,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let mut line = given(options, &["json"])?;
    line.push(blob.into());
    let done = py.detach(|| embedded::export(&line).map_err(Box::new));
    loads(py, &done.map_err(|error| failure(py, *error))?)
}

fn loads<'py>(py: Python<'py>, json: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (json,))
}

/// Calibrates on a thread of its own, while this one looks for Ctrl-C.
fn calibrated(
    py: Python<'_>,
    options: Vec<OsString>,
    data: Option<Vec<u8>>,
) -> PyResult<Calibrated> {
    let cancel = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&cancel);
    let work =
        std::thread::spawn(move || embedded::calibrate(&options, data, flag).map_err(Box::new));
    let mut stopped = Ok(());
    while !work.is_finished() {
        py.detach(|| std::thread::sleep(SIGNALS));
        if stopped.is_ok() {
            stopped = py.check_signals();
            cancel.store(stopped.is_err(), Ordering::Relaxed);
        }
    }
    let made = py.detach(|| work.join());
    stopped?;
    match made {
        Ok(made) => made.map_err(|error| failure(py, *error)),
        Err(_) => Err(PyRuntimeError::new_err(
            "the calibration stopped by an error of the program: please report it",
        )),
    }
}
