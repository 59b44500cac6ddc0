//! A model: many configurations at once, on all cores, while other threads of Python run.

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

use poegp_trainer::cli::embedded;

use crate::arrays::{column, each, one, rows, shaped};
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
    fn from_bytes(py: Python<'_>, bytes: &[u8], precision: &str) -> PyResult<Self> {
        let precision = precision_of(precision)?;
        let blob = BlobModel::from_bytes(bytes.to_vec()).map_err(|error| {
            let expected = "a model blob written by `trainer calibrate`";
            input_error(py, &InputError::new("<bytes>", error.to_string(), expected))
        })?;
        Self::of(py, blob, precision)
    }

    /// From a file.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf, precision: &str) -> PyResult<Self> {
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
        frame: &str,
    ) -> PyResult<(Numbers<'py>, Bits<'py>, Column<'py>, Column<'py>)> {
        let (n, joints, payloads) = self.configurations(q, payload_kg)?;
        let frame = frame_of(frame)?;
        let mut matrices = Vec::with_capacity(MATRIX * n);
        let mut statuses = Vec::with_capacity(n);
        let (mut trusts, mut sigmas) = (Vec::with_capacity(n), Vec::with_capacity(n));
        let answer = |q: &[f64], kg| self.arm.predict(q, kg, frame);
        py.detach(|| {
            self.each_row(&joints, &payloads, answer, |found| {
                push(&mut matrices, &found.pose);
                statuses.push(found.status.bits());
                trusts.push(found.trust);
                sigmas.push(found.position_sigma.unwrap_or(f64::NAN));
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
        frame: &str,
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
        let (n, joints, payloads) = self.configurations(q, payload_kg)?;
        let dof = self.joints();
        let (mut commands, mut statuses) = (Vec::with_capacity(dof * n), Vec::with_capacity(n));
        let mut numbers = [(); 3].map(|()| Vec::with_capacity(n));
        let answer = |q: &[f64], kg| self.arm.correct(q, kg);
        py.detach(|| {
            self.each_row(&joints, &payloads, answer, |found| {
                commands.extend(found.joints.iter().take(dof));
                statuses.push(found.status.bits());
                push_each(
                    &mut numbers,
                    [found.applied, found.position_error, found.rotation_error],
                );
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
        frame: &str,
        tool: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Numbers<'py>, Bits<'py>, Column<'py>, Column<'py>)> {
        let (n, joints, payloads) = self.configurations(seed, payload_kg)?;
        let target_from_tool = match tool {
            Some(tool) => self.flange().inverse() * pose_of(&one(tool, "tool", &[4, 4])?),
            None => Pose::identity(),
        };
        let (given, matrices) = rows(poses, "T_wanted", &[4, 4])?;
        if given != n {
            return Err(PyValueError::new_err(format!(
                "T_wanted: found {given} poses, expected {n}, one for each row of seed"
            )));
        }
        let frame = frame_of(frame)?;
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
                answers.extend(found.joints.iter().take(dof));
                statuses.push(found.status.bits());
                push_each(&mut numbers, [found.position_error, found.rotation_error]);
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
        let (n, joints, payloads) = self.configurations(q, payload_kg)?;
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

    /// Residuals of measurements: metres (n, 3), radians (n, 3) and lines (n,).
    #[pyo3(signature = (data, **options))]
    #[allow(clippy::type_complexity)] // what Python unpacks
    fn residuals<'py>(
        &self,
        py: Python<'py>,
        data: &Bound<'py, PyAny>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<(Numbers<'py>, Numbers<'py>, Bound<'py, PyArray1<u64>>)> {
        let (name, table) = match data.extract::<PathBuf>() {
            Ok(path) => (path, None),
            Err(_) => (PathBuf::from(table::NAME), Some(table::csv(data)?)),
        };
        let mut line = given("evaluate", options, &["predictions", "trust", "json"])?;
        line.extend(["--".into(), "(in memory)".into(), name.into_os_string()]);
        let model = self.arm.blob();
        let found =
            py.detach(|| embedded::residuals(model, &line, table.as_deref()).map_err(Box::new));
        let found = found.map_err(|error| failure(py, *error))?;
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
}

impl NativeModel {
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
        q: &Bound<'_, PyAny>,
        payload_kg: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<(usize, Vec<f64>, Vec<f64>)> {
        let (n, joints) = rows(q, "q", &[self.joints()])?;
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

fn precision_of(name: &str) -> PyResult<Precision> {
    match name {
        "f32" => Ok(Precision::Single),
        "f64" => Ok(Precision::Double),
        _ => Err(PyValueError::new_err(format!(
            "precision: found {name:?}, expected \"f32\", the device's numbers, or \"f64\""
        ))),
    }
}

fn frame_of(name: &str) -> PyResult<Frame> {
    match name {
        "instrument" => Ok(Frame::Instrument),
        "base" => Ok(Frame::Base),
        _ => Err(PyValueError::new_err(format!(
            "frame: found {name:?}, expected \"instrument\", in which poses were measured, or \"base\""
        ))),
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

/// The pose of a homogeneous matrix, whose last row is not looked at.
fn pose_of(matrix: &[f64]) -> Pose<f64> {
    let mut rows = [0.0; 12];
    rows.copy_from_slice(&matrix[..12]);
    Pose::from_rows(&rows)
}
