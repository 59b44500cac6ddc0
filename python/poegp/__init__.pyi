"""Types of poegp. Angles are rad, lengths m, masses kg; ``q`` has the controller's joints, base first, rad or m."""

import datetime
import enum
import os
from collections.abc import Iterable
from typing import Any, Literal, NamedTuple, Protocol, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str
__all__: list[str]

_Path = str | os.PathLike[str]
_Frame = Literal["instrument", "base"]
_Precision = Literal["f32", "f64"]
_Method = Literal["auto", "base-tool", "poe", "poe-gp", "poe-gp-load", "parametric", "elastic"]

class _Table(Protocol):
    """Columns by their names: a DataFrame, a dictionary of arrays."""

    def keys(self) -> Iterable[Any]: ...
    def __getitem__(self, key: Any, /) -> Any: ...

class Error(Exception):
    """A calibration or a correction that is not possible."""

class InputError(Error, ValueError):
    """Something in a file or a table that its author can repair."""

    file: str
    line: int | None
    column: int | None
    column_name: str | None
    found: str
    expected: str
    help: str | None

class DataRefused(Error):
    """The measurements are not fit for a calibration."""

class Status(enum.IntFlag):
    """What an answer is worth: 0 is as trained, each bit is a remark."""

    OUTSIDE_JOINT_RANGE = 1
    OUTSIDE_PAYLOAD_RANGE = 2
    CORRECTION_LIMITED = 4
    NO_MODEL = 8
    BAD_INPUT = 16
    PARTLY_CORRECTED = 32
    BYPASSED = 64
    BLENDING = 128

class Answer(NamedTuple):
    """What predictions are worth; arrays (n,)."""

    status: NDArray[np.uint8]
    trust: NDArray[np.float64]
    sigma_m: NDArray[np.float64]

class Correction(NamedTuple):
    """What corrected commands are worth; arrays (n,)."""

    status: NDArray[np.uint8]
    applied: NDArray[np.float64]
    position_error_m: NDArray[np.float64]
    rotation_error_rad: NDArray[np.float64]

class Solution(NamedTuple):
    """What answers of the inverse kinematics are worth; arrays (n,)."""

    status: NDArray[np.uint8]
    position_error_m: NDArray[np.float64]
    rotation_error_rad: NDArray[np.float64]

class Residuals(NamedTuple):
    """What a model leaves of measurements, along the axes of the instrument: arrays (n, 3), (n, 3) and (n,)."""

    position_m: NDArray[np.float64]
    rotation_rad: NDArray[np.float64]
    line: NDArray[np.uint64]

class Plan(NamedTuple):
    """Poses to measure: joints (n, dof) and payloads (n,), the same to test with, the CSV table, the document."""

    q: NDArray[np.float64]
    payload_kg: NDArray[np.float64] | None
    test_q: NDArray[np.float64]
    test_payload_kg: NDArray[np.float64] | None
    table: str
    summary: dict[str, Any]

class Model:
    """A calibrated arm. It never changes, and any number of threads may use it."""

    @classmethod
    def load(cls, source: _Path | bytes | bytearray | memoryview, precision: _Precision = "f32") -> Model: ...
    @property
    def blob(self) -> bytes: ...
    @property
    def dof(self) -> int: ...
    @property
    def robot(self) -> str: ...
    @property
    def method(self) -> str: ...
    @property
    def precision(self) -> _Precision: ...
    @property
    def payload_range_kg(self) -> tuple[float, float] | None: ...
    @property
    def flange_from_target(self) -> NDArray[np.float64]: ...
    def predict(
        self, q: ArrayLike, payload_kg: ArrayLike | None = None, frame: _Frame = "instrument"
    ) -> tuple[NDArray[np.float64], Answer]: ...
    def nominal(self, q: ArrayLike, frame: _Frame = "instrument") -> NDArray[np.float64]: ...
    def correct(
        self, q: ArrayLike, payload_kg: ArrayLike | None = None
    ) -> tuple[NDArray[np.float64], Correction]: ...
    def inverse(
        self,
        T_wanted: ArrayLike,
        seed: ArrayLike,
        payload_kg: ArrayLike | None = None,
        frame: _Frame = "instrument",
        tool: ArrayLike | None = None,
    ) -> tuple[NDArray[np.float64], Solution]: ...
    def jacobian(
        self, q: ArrayLike, payload_kg: ArrayLike | None = None
    ) -> NDArray[np.float64]: ...

    def residuals(
        self, data: _Path | _Table, **options: Unpack[_ResidualOptions]
    ) -> Residuals: ...
    def check(
        self, data: _Path | _Table, max_mm: float, **options: Unpack[_CheckOptions]
    ) -> dict[str, Any]: ...
    def evaluate(
        self, data: _Path | _Table, **options: Unpack[_EvaluateOptions]
    ) -> dict[str, Any]: ...
    def export_urdf(
        self,
        out: _Path,
        nominal: _Path | None = None,
        *,
        payload_kg: float | None = None,
        region: _Path | ArrayLike | None = None,
        target_link: str | None = None,
        **options: Unpack[_ExportOptions],
    ) -> dict[str, Any]: ...

class Calibration:
    """A calibration that `calibrate` has made."""

    @property
    def blob(self) -> bytes: ...
    @property
    def summary(self) -> dict[str, Any]: ...
    def model(self, precision: _Precision = "f32") -> Model: ...
    def save(self, path: _Path) -> None: ...
    def report(self, path: _Path) -> None: ...

class _CalibrateOptions(TypedDict, total=False):
    base: str
    tip: str
    date: str | datetime.date
    per_output: bool
    no_variance: bool
    inducing_points: int
    gravity: str | Iterable[float]
    position_sigma_mm: float
    orientation_sigma_mrad: float
    outliers: Literal["keep", "reject"]
    warm_up: Literal["keep", "remove"]
    weighting: Literal["none", "noise"]
    max_instructions: int
    max_blob_bytes: int
    serial_number: str | int
    max_correction_mm: float
    max_correction_mrad: float
    correct_drift: bool
    gauge: Literal["poses", "grid"]
    keep_gauge: _Path
    references: _Path
    base_from: _Path | Iterable[float]
    tool_from: str | Iterable[float]
    previous: _Path
    accept: str | Iterable[str]
    test: _Path | Iterable[_Path]
    tolerance_mm: float
    tolerance_mrad: float
    coverage: float
    features: _Path
    prior: _Path | Iterable[_Path]
    threads: int

class _CorrectOptions(TypedDict, total=False):
    payload_kg: float
    payload_from_program: bool
    frames: _Path
    split: float
    dry_run: bool
    inverse: bool
    threads: int

class _ResidualOptions(TypedDict, total=False):
    fit_base: bool
    fit_tool: bool | int
    correct_drift: bool
    accept: str | Iterable[str]
    threads: int

class _EvaluateOptions(_ResidualOptions, total=False):
    features: _Path

class _CheckOptions(_EvaluateOptions, total=False):
    statistic: Literal["mean", "p95", "max"]
    max_drift_mm: float
    false_alarms: float
    previous: _Path
    programs: _Path | Iterable[_Path]
    position_sigma_mm: float
    orientation_sigma_mrad: float
    tolerance_mm: float
    tolerance_mrad: float
    coverage: float

class _CompareOptions(TypedDict, total=False):
    base: str
    tip: str
    blob: _Path | Iterable[_Path]
    seed: int
    features: _Path
    correct_drift: bool
    accept: str | Iterable[str]
    position_sigma_mm: float
    orientation_sigma_mrad: float
    outliers: Literal["keep", "reject"]
    warm_up: Literal["keep", "remove"]
    weighting: Literal["none", "noise"]
    per_output: bool
    no_variance: bool
    gravity: str | Iterable[float]
    inducing_points: int
    tolerance_mm: float
    tolerance_mrad: float
    coverage: float
    threads: int

class _PlanOptions(TypedDict, total=False):
    base: str
    tip: str
    test_poses: int
    constraints: _Path
    v_optimal: bool
    space_filling: bool
    prior: _Path
    gravity: str | Iterable[float]
    seed: int
    forecast: int | Iterable[int]
    no_forecast: bool
    threads: int

class _ExportOptions(TypedDict, total=False):
    base: str
    tip: str
    threads: int

def calibrate(
    robot: _Path | None = None,
    data: _Path | _Table | None = None,
    *,
    method: _Method | None = None,
    **options: Unpack[_CalibrateOptions],
) -> Calibration: ...
def compare(
    robot: _Path,
    data: _Path | _Table,
    *,
    methods: str | Iterable[str] | None = None,
    test: _Path | Iterable[_Path] | None = None,
    folds: int | None = None,
    **options: Unpack[_CompareOptions],
) -> dict[str, Any]: ...
def plan(
    robot: _Path,
    count: int | None = None,
    *,
    payloads: float | Iterable[float] | None = None,
    **options: Unpack[_PlanOptions],
) -> Plan: ...
def correct_program(
    program: _Path | Iterable[_Path],
    out: _Path,
    model: Model | _Path,
    **options: Unpack[_CorrectOptions],
) -> dict[str, Any]: ...
