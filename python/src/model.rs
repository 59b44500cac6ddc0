//! A model: many configurations at once, on all cores, while other threads of Python run.

use std::ffi::OsString;
use std::path::PathBuf;

use numpy::{PyArray1, PyArrayDyn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use poegp_calibration::blob::evaluator::{Evaluator, Frame, Precision};
use poegp_calibration::blob::predict::BlobModel;
use poegp_calibration::input_error::InputError;
use poegp_calibration::numeric::parallel::for_numbers;
use poegp_calibration::progress::threads;
use poegp_runtime::guard::status::Status;
use poegp_runtime::math::se3::Pose;

use poegp_trainer::cli::embedded::{self, Failure};

use crate::arrays::{check_pose, column, each, one, rows, shaped};
use crate::commands::dictionary;
use crate::errors::{failure, input_error};
use crate::options::given;
use crate::table;

/// Numbers of a homogeneous matrix.
const MATRIX: usize = 16;

type Numbers<'py> = Bound<'py, PyArrayDyn<f64>>;
type Bits<'py> = Bound<'py, PyArray1<u8>>;
type Column<'py> = Bound<'py, PyArray1<f64>>;

/// Name and bit of each remark.
#[pyfunction]
pub fn status_flags() -> Vec<(String, u8)> {
    let bits = (0..8).map(|bit| 1_u8 << bit);
    bits.map(|bits| (Status::from_bits(bits).to_string(), bits))
        .collect()
}

/// The native part of `poegp.Model`.
#[pyclass(frozen, module = "poegp._native")]
pub struct NativeModel {
    arm: Evaluator,
}

#[pymethods]
impl NativeModel {
    /// From the bytes of a blob.
    #[staticmethod]
    fn from_bytes(py: Python<'_>, bytes: &[u8], precision: &Bound<'_, PyAny>) -> PyResult<Self> {
        let precision = precision_of(precision)?;
        let blob = BlobModel::from_bytes(bytes.to_vec()).map_err(|error| {
            let expected = "a model blob written by `trainer calibrate`";
            input_error(py, &InputError::new("<bytes>", error.to_string(), expected))
        })?;
        Self::of(py, blob, precision)
    }

    /// From a file.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf, precision: &Bound<'_, PyAny>) -> PyResult<Self> {
        let precision = precision_of(precision)?;
        let blob = BlobModel::read(&path).map_err(|error| input_error(py, &error))?;
        Self::of(py, blob, precision)
    }

    #[getter]
    fn blob<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, self.arm.blob().bytes())
    }

    #[getter]
    fn joints(&self) -> usize {
        self.arm.blob().model().joints()
    }

    #[getter]
    fn precision(&self) -> &'static str {
        match self.arm.precision() {
            Precision::Single => "f32",
            Precision::Double => "f64",
        }
    }

    #[getter]
    fn method(&self) -> &str {
        self.arm.blob().host().provenance.method
    }

    #[getter]
    fn robot(&self) -> &str {
        self.arm.blob().blob().robot.name
    }

    /// The trained payloads in kg; None of a model that does not depend on the payload.
    #[getter]
    fn payload_range_kg(&self) -> Option<(f32, f32)> {
        self.arm.blob().blob().ranges.payload_kg
    }

    #[pyo3(signature = (q, payload_kg, frame))]
    #[allow(clippy::type_complexity)] // what Python unpacks
    fn predict<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        payload_kg: Option<&Bound<'py, PyAny>>,
        frame: &Bound<'py, PyAny>,
    ) -> PyResult<(Numbers<'py>, Bits<'py>, Column<'py>, Column<'py>)> {
        let (n, joints, payloads) = self.configurations("q", q, payload_kg)?;
        let frame = frame_of(frame)?;
        let mut matrices = Vec::with_capacity(MATRIX * n);
        let mut statuses = Vec::with_capacity(n);
        let (mut trusts, mut sigmas) = (Vec::with_capacity(n), Vec::with_capacity(n));
        let answer = |q: &[f64], kg| self.arm.predict(q, kg, frame);
        py.detach(|| {
            self.each_row(&joints, &payloads, answer, |found| {
                let sigma = found.position_sigma.unwrap_or(f64::NAN);
                match is_refused(found.status) {
                    true => matrices.extend([f64::NAN; MATRIX]),
                    false => push(&mut matrices, &found.pose),
                }
                statuses.push(found.status.bits());
                trusts.push(found.trust);
                sigmas.push(number(found.status, sigma));
            });
        });
        Ok((
            shaped(py, matrices, &[n, 4, 4])?,
            column(py, statuses),
            column(py, trusts),
            column(py, sigmas),
        ))
    }

    fn nominal<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        frame: &Bound<'py, PyAny>,
    ) -> PyResult<Numbers<'py>> {
        let (n, joints) = rows(q, "q", &[self.joints()])?;
        let frame = frame_of(frame)?;
        let payloads = vec![0.0; n];
        let mut matrices = Vec::with_capacity(MATRIX * n);
        let answer = |q: &[f64], _| self.arm.nominal(q, frame);
        py.detach(|| {
            self.each_row(&joints, &payloads, answer, |pose| match pose {
                Some(pose) => push(&mut matrices, &pose),
                None => matrices.extend([f64::NAN; MATRIX]),
            });
        });
        shaped(py, matrices, &[n, 4, 4])
    }

    #[pyo3(signature = (q, payload_kg))]
    #[allow(clippy::type_complexity)] // what Python unpacks
    fn correct<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        payload_kg: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(
        Numbers<'py>,
        Bits<'py>,
        Column<'py>,
        Column<'py>,
        Column<'py>,
    )> {
        let (n, joints, payloads) = self.configurations("q", q, payload_kg)?;
        let dof = self.joints();
        let (mut commands, mut statuses) = (Vec::with_capacity(dof * n), Vec::with_capacity(n));
        let mut numbers = [(); 3].map(|()| Vec::with_capacity(n));
        let answer = |q: &[f64], kg| self.arm.correct(q, kg);
        py.detach(|| {
            self.each_row(&joints, &payloads, answer, |found| {
                let joints = found.joints.iter().take(dof);
                commands.extend(joints.map(|joint| number(found.status, *joint)));
                statuses.push(found.status.bits());
                let errors = [found.position_error, found.rotation_error];
                let [position, rotation] = errors.map(|error| number(found.status, error));
                push_each(&mut numbers, [found.applied, position, rotation]);
            });
        });
        let [applied, position_error, rotation_error] = numbers.map(|numbers| column(py, numbers));
        Ok((
            shaped(py, commands, &[n, dof])?,
            column(py, statuses),
            applied,
            position_error,
            rotation_error,
        ))
    }

    /// `flange_from_target` of the model's gauge, a matrix.
    #[getter]
    fn flange_from_target<'py>(&self, py: Python<'py>) -> PyResult<Numbers<'py>> {
        let mut matrix = Vec::with_capacity(MATRIX);
        push(&mut matrix, &self.flange());
        shaped(py, matrix, &[4, 4])
    }

    #[pyo3(signature = (poses, seed, payload_kg, frame, tool))]
    #[allow(clippy::type_complexity)] // what Python unpacks
    fn inverse<'py>(
        &self,
        py: Python<'py>,
        poses: &Bound<'py, PyAny>,
        seed: &Bound<'py, PyAny>,
        payload_kg: Option<&Bound<'py, PyAny>>,
        frame: &Bound<'py, PyAny>,
        tool: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Numbers<'py>, Bits<'py>, Column<'py>, Column<'py>)> {
        let (n, joints, payloads) = self.configurations("seed", seed, payload_kg)?;
        let target_from_tool = match tool {
            Some(tool) => {
                let matrix = one(tool, "tool", &[4, 4])?;
                if !matrix.iter().all(|x| x.is_finite()) {
                    return Err(PyValueError::new_err(
                        "tool: found a number that is not finite, expected a pose",
                    ));
                }
                check_pose(&matrix, "tool")?;
                self.flange().inverse() * pose_of(&matrix)
            }
            None => Pose::identity(),
        };
        let (given, matrices) = rows(poses, "T_wanted", &[4, 4])?;
        if given != n {
            return Err(PyValueError::new_err(format!(
                "T_wanted: found {given} poses, expected {n}, one for each row of seed"
            )));
        }
        let frame = frame_of(frame)?;
        for (i, matrix) in matrices.chunks(MATRIX).enumerate() {
            check_pose(matrix, &format!("T_wanted[{i}]"))?;
        }
        let wanted: Vec<Pose<f64>> = matrices.chunks(MATRIX).map(pose_of).collect();
        let dof = self.joints();
        let (mut answers, mut statuses) = (Vec::with_capacity(dof * n), Vec::with_capacity(n));
        let mut numbers = [(); 2].map(|()| Vec::with_capacity(n));
        let answer = |i: usize| {
            let seed = &joints[i * dof..(i + 1) * dof];
            let wanted = (&wanted[i], frame);
            self.arm
                .inverse(wanted, &target_from_tool, seed, payloads[i])
        };
        py.detach(|| {
            for_numbers(threads(), n, answer, |found| {
                let joints = found.joints.iter().take(dof);
                answers.extend(joints.map(|joint| number(found.status, *joint)));
                statuses.push(found.status.bits());
                let errors = [found.position_error, found.rotation_error];
                push_each(
                    &mut numbers,
                    errors.map(|error| number(found.status, error)),
                );
            });
        });
        let [position_error, rotation_error] = numbers.map(|numbers| column(py, numbers));
        Ok((
            shaped(py, answers, &[n, dof])?,
            column(py, statuses),
            position_error,
            rotation_error,
        ))
    }

    #[pyo3(signature = (q, payload_kg))]
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        payload_kg: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Numbers<'py>> {
        let (n, joints, payloads) = self.configurations("q", q, payload_kg)?;
        let dof = self.joints();
        let mut numbers = Vec::with_capacity(6 * dof * n);
        let answer = |q: &[f64], kg| self.arm.jacobian(q, kg);
        py.detach(|| {
            self.each_row(&joints, &payloads, answer, |columns| {
                for row in 0..6 {
                    numbers.extend(columns.iter().take(dof).map(|column| column[row]));
                }
            });
        });
        shaped(py, numbers, &[n, 6, dof])
    }

    /// The rows of a region of joints, rad.
    fn region(&self, joints: &Bound<'_, PyAny>) -> PyResult<Vec<Vec<f64>>> {
        let dof = self.joints();
        let (n, joints) = rows(joints, "region", &[dof])?;
        match joints.iter().position(|joint| !joint.is_finite()) {
            _ if n == 0 => Err(PyValueError::new_err(
                "region: found no rows, expected one or more",
            )),
            Some(i) => Err(PyValueError::new_err(format!(
                "region[{}]: found a number that is not finite, expected joints",
                i / dof
            ))),
            None => Ok(joints.chunks(dof).map(<[f64]>::to_vec).collect()),
        }
    }

    /// Residuals of measurements: metres (n, 3), radians (n, 3) and lines (n,).
    #[pyo3(signature = (data, **options))]
    #[allow(clippy::type_complexity)] // what Python unpacks
    fn residuals<'py>(
        &self,
        py: Python<'py>,
        data: &Bound<'py, PyAny>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<(Numbers<'py>, Numbers<'py>, Bound<'py, PyArray1<u64>>)> {
        let found = self.judged(py, "evaluate", data, options, embedded::residuals)?;
        let none = [f64::NAN; 3];
        let positions = found.iter().flat_map(|r| r.position).collect();
        let rotations = found.iter().flat_map(|r| r.rotation.unwrap_or(none));
        let rotations = rotations.collect();
        let lines: Vec<u64> = found.iter().map(|r| r.line as u64).collect();
        Ok((
            shaped(py, positions, &[found.len(), 3])?,
            shaped(py, rotations, &[found.len(), 3])?,
            column(py, lines),
        ))
    }

    /// What `trainer check --json` writes; see `poegp.Model.check` in the stubs.
    #[pyo3(signature = (data, **options))]
    fn check<'py>(
        &self,
        py: Python<'py>,
        data: &Bound<'py, PyAny>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        dictionary(
            py,
            &self.judged(py, "check", data, options, embedded::check)?,
        )
    }

    /// What `trainer evaluate --json` writes; see `poegp.Model.evaluate` in the stubs.
    #[pyo3(signature = (data, **options))]
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        data: &Bound<'py, PyAny>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        dictionary(
            py,
            &self.judged(py, "evaluate", data, options, embedded::evaluate)?,
        )
    }
}

/// Options of the command line that name outputs of the commands that judge a model.
const OUTPUTS: &[&str] = &["predictions", "trust", "json", "report"];

impl NativeModel {
    /// What `work` finds with this model and these measurements, while other threads of Python run.
    fn judged<R: Send>(
        &self,
        py: Python<'_>,
        command: &str,
        data: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
        work: impl FnOnce(&BlobModel, &[OsString], Option<&[u8]>) -> Result<R, Failure> + Send,
    ) -> PyResult<R> {
        let (name, table) = table::measurements(data)?;
        let mut line = given(command, options, OUTPUTS)?;
        line.extend(["--".into(), "(in memory)".into(), name.into_os_string()]);
        let model = self.arm.blob();
        let found = py.detach(|| work(model, &line, table.as_deref()).map_err(Box::new));
        found.map_err(|error| failure(py, *error))
    }

    /// `flange_from_target`.
    fn flange(&self) -> Pose<f64> {
        Pose::from_rows(&self.arm.blob().host().gauge.flange_from_target)
    }

    fn of(py: Python<'_>, blob: BlobModel, precision: Precision) -> PyResult<Self> {
        let arm = py.detach(|| Evaluator::new(blob, precision));
        let arm = arm.map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok(Self { arm })
    }

    /// The number of rows, their joints row by row, and the payload of each.
    fn configurations(
        &self,
        name: &str,
        q: &Bound<'_, PyAny>,
        payload_kg: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<(usize, Vec<f64>, Vec<f64>)> {
        let (n, joints) = rows(q, name, &[self.joints()])?;
        let payloads = match (payload_kg, self.payload_range_kg()) {
            (Some(kg), _) => each(kg, "payload_kg", n)?,
            (None, None) => vec![0.0; n],
            (None, Some((light, heavy))) => {
                return Err(PyValueError::new_err(format!(
                    "payload_kg: found none, expected kilograms: the model depends on the payload ({light} to {heavy} kg were \
                     trained)"
                )));
            }
        };
        Ok((n, joints, payloads))
    }

    /// Gives the answers to all rows to `take`, in order, computed on all cores.
    fn each_row<O: Send>(
        &self,
        joints: &[f64],
        payloads: &[f64],
        answer: impl Fn(&[f64], f64) -> O + Sync,
        take: impl FnMut(O) + Send,
    ) {
        let dof = self.joints();
        let of_row = |i: usize| answer(&joints[i * dof..(i + 1) * dof], payloads[i]);
        for_numbers(threads(), payloads.len(), of_row, take);
    }
}

fn precision_of(name: &Bound<'_, PyAny>) -> PyResult<Precision> {
    match name.extract::<String>().as_deref() {
        Ok("f32") => Ok(Precision::Single),
        Ok("f64") => Ok(Precision::Double),
        _ => Err(PyValueError::new_err(format!(
            "precision: found {}, expected \"f32\", the device's precision, or \"f64\"",
            shown(name)
        ))),
    }
}

fn frame_of(name: &Bound<'_, PyAny>) -> PyResult<Frame> {
    match name.extract::<String>().as_deref() {
        Ok("instrument") => Ok(Frame::Instrument),
        Ok("base") => Ok(Frame::Base),
        _ => Err(PyValueError::new_err(format!(
            "frame: found {}, expected \"instrument\", in which poses were measured, or \"base\"",
            shown(name)
        ))),
    }
}

/// A value for a message: a text in quotation marks.
fn shown(value: &Bound<'_, PyAny>) -> String {
    match value.extract::<String>() {
        Ok(text) => format!("{text:?}"),
        Err(_) => value.get_type().to_string(),
    }
}

/// Whether there is no answer, because numbers that were given are not finite or not possible.
fn is_refused(status: Status) -> bool {
    status.contains(Status::BAD_INPUT)
}

/// A number of an answer; NaN if there is none.
fn number(status: Status, number: f64) -> f64 {
    match is_refused(status) {
        true => f64::NAN,
        false => number,
    }
}

/// A pose as a homogeneous matrix, row by row.
fn push(out: &mut Vec<f64>, pose: &Pose<f64>) {
    out.extend(pose.to_rows());
    out.extend([0.0, 0.0, 0.0, 1.0]);
}

/// One number more for each column.
fn push_each<const N: usize>(columns: &mut [Vec<f64>; N], numbers: [f64; N]) {
    for (column, number) in columns.iter_mut().zip(numbers) {
        column.push(number);
    }
}

/// The pose of a homogeneous matrix, which [`check_pose`] has looked at.
fn pose_of(matrix: &[f64]) -> Pose<f64> {
    let mut rows = [0.0; 12];
    rows.copy_from_slice(&matrix[..12]);
    Pose::from_rows(&rows)
}
