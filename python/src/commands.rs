//! Calibrations, comparisons, plans, exports and corrected programs: commands of the trainer without its terminal.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use numpy::{PyArray1, PyArrayDyn};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use poegp_trainer::cli::embedded::{self, Calibrated, Document, Failure};

use crate::arrays::{column, shaped};
use crate::errors::failure;
use crate::options::given;
use crate::table;

/// How often a fit looks for Ctrl-C.
const SIGNALS: Duration = Duration::from_millis(20);

/// A calibration; see `poegp.Calibration` in the stubs.
#[pyclass(frozen, module = "poegp._native")]
pub struct Calibration {
    made: Arc<Calibrated>,
}

#[pymethods]
impl Calibration {
    /// The bytes of the blob.
    #[getter]
    fn blob<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.made.blob)
    }

    /// What `trainer calibrate --json` writes, as a dictionary, with the notes.
    #[getter]
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        with_notes(py, &self.made.json, &self.made.notes)
    }

    /// An HTML page with held-out errors: calibrates again, and five times more for cross-validation.
    fn report(&self, py: Python<'_>) -> PyResult<String> {
        let made = Arc::clone(&self.made);
        let page = cancellable(py, move |cancel| {
            embedded::report(&made, cancel).map_err(Box::new)
        })?;
        page.ok_or_else(|| {
            PyRuntimeError::new_err(
                "report: the files of this calibration have changed: calibrate again",
            )
        })
    }
}

/// Calibrates; see `poegp.calibrate` in the stubs.
#[pyfunction]
#[pyo3(signature = (robot, data, **options))]
pub fn calibrate(
    py: Python<'_>,
    robot: Option<PathBuf>,
    data: &Bound<'_, PyAny>,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<Calibration> {
    let (name, data) = table::measurements(data)?;
    let mut line = given("calibrate", options, OUTPUTS)?;
    line.extend(robot.map(|robot| joined("--robot=", robot)));
    line.extend(["--".into(), name.into_os_string()]);
    let made = cancellable(py, move |cancel| {
        embedded::calibrate(&line, data, cancel).map_err(Box::new)
    })?;
    Ok(Calibration {
        made: Arc::new(made),
    })
}

/// Options of `calibrate` that name outputs.
const OUTPUTS: &[&str] = &["out", "json", "report", "write_project", "controller_csv"];

/// An option with its value.
fn joined(option: &str, value: PathBuf) -> OsString {
    let mut text = OsString::from(option);
    text.push(value);
    text
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
    let mut line = given("correct", options, &["out", "json"])?;
    line.extend([joined("--out=", out), "--".into(), blob.into()]);
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
    let mut line = given("export", options, &["json"])?;
    line.extend(["--".into(), blob.into_os_string()]);
    let done = py.detach(|| embedded::export(&line).map_err(Box::new));
    loads(py, &done.map_err(|error| failure(py, *error))?)
}

/// Compares methods; see `poegp.compare` in the stubs.
#[pyfunction]
#[pyo3(signature = (robot, data, **options))]
pub fn compare<'py>(
    py: Python<'py>,
    robot: PathBuf,
    data: &Bound<'py, PyAny>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (name, table) = table::measurements(data)?;
    let mut line = given("compare", options, &["json", "report"])?;
    line.extend([joined("--robot=", robot), "--".into(), name.into()]);
    let found = cancellable(py, move |cancel| {
        embedded::compare(&line, table.as_deref(), cancel).map_err(Box::new)
    })?;
    dictionary(py, &found)
}

/// Joints row by row, and the payload of each row; none if payloads are not stated.
type Poses<'py> = (
    Bound<'py, PyArrayDyn<f64>>,
    Option<Bound<'py, PyArray1<f64>>>,
);

/// Plans poses; see `poegp.plan` in the stubs. Returns the poses for the calibration, those to test it, the table and the
/// document.
#[pyfunction]
#[pyo3(signature = (robot, **options))]
pub fn plan<'py>(
    py: Python<'py>,
    robot: PathBuf,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<(Poses<'py>, Poses<'py>, String, Bound<'py, PyAny>)> {
    let mut line = given("plan", options, PLAN_OUTPUTS)?;
    line.push(joined("--robot=", robot));
    let made = cancellable(py, move |cancel| {
        embedded::plan(&line, cancel).map_err(Box::new)
    })?;
    let dof = made.poses.first().map_or(0, |pose| pose.joints.len());
    let poses = |check: bool| -> PyResult<Poses<'py>> {
        let of = || made.poses.iter().filter(|pose| pose.check == check);
        let joints: Vec<f64> = of().flat_map(|pose| pose.joints.clone()).collect();
        let payloads: Option<Vec<f64>> = of().map(|pose| pose.payload_kg).collect();
        let is_stated = made.poses.iter().all(|pose| pose.payload_kg.is_some());
        let payloads = payloads.filter(|_| is_stated);
        Ok((
            shaped(py, joints, &[of().count(), dof])?,
            payloads.map(|payloads| column(py, payloads)),
        ))
    };
    Ok((
        poses(false)?,
        poses(true)?,
        made.table.clone(),
        dictionary(py, &made.document)?,
    ))
}

/// Options of `plan` that name outputs.
const PLAN_OUTPUTS: &[&str] = &[
    "out",
    "test_out",
    "json",
    "features_out",
    "rapid",
    "krl",
    "urscript",
    "fanuc",
];

/// A document as a dictionary, with the notes.
pub fn dictionary<'py>(py: Python<'py>, document: &Document) -> PyResult<Bound<'py, PyAny>> {
    with_notes(py, &document.json, &document.notes)
}

fn with_notes<'py>(py: Python<'py>, json: &str, notes: &[String]) -> PyResult<Bound<'py, PyAny>> {
    let out = loads(py, json)?;
    out.set_item("notes", notes)?;
    Ok(out)
}

fn loads<'py>(py: Python<'py>, json: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (json,))
}

/// Runs a fit on a thread of its own, while this one looks for Ctrl-C.
fn cancellable<R: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(Arc<AtomicBool>) -> Result<R, Box<Failure>> + Send + 'static,
) -> PyResult<R> {
    let cancel = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&cancel);
    let work = std::thread::spawn(move || work(flag));
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
            "an internal error stopped the calculation: please report it",
        )),
    }
}
