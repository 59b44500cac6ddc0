"""Calibrates industrial robots from measured poses, and predicts and corrects with the calibrated model.

Arrays go in and arrays come out. Angles are radians, lengths metres, masses kilograms. Matrices are homogeneous, and
``a_from_b`` carries coordinates of frame b to frame a. Functions print nothing, and compute on all cores while other threads
of Python run.

>>> import poegp
>>> arm = poegp.calibrate("abb-irb120", "measured.csv")        # doctest: +SKIP
>>> model = arm.model()                                        # doctest: +SKIP
>>> poses, answer = model.predict(q, payload_kg=2.5)           # doctest: +SKIP
"""

from __future__ import annotations

import copy
import errno
import os
from pathlib import Path

from poegp._native import Calibration as _Calibration
from poegp._native import __version__
from poegp._native import calibrate as _calibrate
from poegp._outputs import check as _can_replace
from poegp.errors import DataRefused, Error, InputError
from poegp.model import Answer, Correction, Model, Residuals, Solution, Status
from poegp.planning import Plan, compare, plan
from poegp.programs import correct_program

__all__ = [
    "Answer",
    "Calibration",
    "Correction",
    "DataRefused",
    "Error",
    "InputError",
    "Model",
    "Plan",
    "Residuals",
    "Solution",
    "Status",
    "__version__",
    "calibrate",
    "compare",
    "correct_program",
    "plan",
]


class Calibration:
    """A calibration that :func:`calibrate` has made."""

    def __init__(self, native: _Calibration | None, blob: bytes | None = None, summary: dict | None = None) -> None:
        self._native = native
        self._blob = blob
        self._summary = summary

    @property
    def blob(self) -> bytes:
        """The model file: the bytes that ``trainer calibrate --out`` writes."""
        if self._blob is None:
            self._blob = self._native.blob
        return self._blob

    @property
    def summary(self) -> dict:
        """Results: the document that ``trainer calibrate --json`` writes.

        Warnings are in ``summary["warnings"]``. ``summary["notes"]`` lists the notes that the command line prints: columns that
        were not read, overridden settings of a project, a warm-up that was removed.
        """
        if self._summary is None:
            self._summary = self._native.summary
        return self._summary

    def model(self, precision="f32"):
        """The calibrated model; see :meth:`Model.load` for the precision."""
        return Model.load(self.blob, precision=precision)

    def save(self, path) -> None:
        """Write the blob to a file. It replaces a model without a signature, and no other file."""
        _can_replace(Path(path), "model", self.blob)
        Path(path).write_bytes(self.blob)

    def report(self, path) -> None:
        """Write an HTML page with held-out errors, plots and parameters.

        It calibrates again, and five times more for the cross-validation. The data must still be where they were. A calibration
        that was unpickled has no report. The page replaces a report, and no other file.
        """
        if self._native is None:
            raise Error("report: found an unpickled calibration, expected one that calibrate made in this process")
        _can_be_written(Path(path))
        _can_replace(Path(path), "report")
        Path(path).write_bytes(self._native.report().encode())

    def __copy__(self) -> Calibration:
        return self

    def __deepcopy__(self, memo: object) -> Calibration:
        return Calibration(self._native, self.blob, copy.deepcopy(self.summary))

    def __reduce__(self):
        return Calibration, (None, self.blob, self.summary)

    def __repr__(self) -> str:
        return f"<poegp.Calibration of {self.summary['robot']}: {len(self.blob)} bytes>"


def _can_be_written(path: Path) -> None:
    """Raise the error of a file that cannot be written before the time is spent that its contents take."""
    folder = path.parent
    if path.is_dir():
        code = errno.EISDIR
    elif not folder.exists():
        code = errno.ENOENT
    elif not folder.is_dir():
        code = errno.ENOTDIR
    elif not os.access(path if path.exists() else folder, os.W_OK):
        code = errno.EACCES
    else:
        return
    raise OSError(code, os.strerror(code), str(path))


def _is_project(data: object) -> bool:
    return isinstance(data, (str, os.PathLike)) and os.fspath(data).lower().endswith(".toml")


def calibrate(robot=None, data=None, *, method=None, **options):
    """Calibrate a robot from measured poses.

    ``calibrate("project.toml")`` repeats the calibration of a project file.

    Parameters
    ----------
    robot : str or path
        A built-in robot (``abb-irb4400``, ``abb-irb4400-serial``, ``abb-irb120``, ``kuka-iiwa7``, ``ur5``, ``ur10``), a URDF
        file or a TOML description. A project file names its own.
    data : path, DataFrame or dict of arrays
        Measured poses: a file, or a table with the names of its columns (``q1_deg`` … or ``q1_rad`` …, ``x_mm`` or ``x_m`` …,
        optionally ``qw`` … ``qz``, ``payload_kg`` and others). A file of touches is taken, too, with ``NAME.toml`` beside it
        or ``features="NAME.toml"``, and so is a project file (``.toml``). What you state overrides the project, and
        ``summary["notes"]`` says so. Outputs that the project names are not written. A column ``time_s`` of dates or time
        differences is converted to seconds.
    method : str
        ``auto``, or ``elastic``, ``parametric``, ``poe``, ``base-tool``, ``poe-gp``, ``poe-gp-load``. Without it, that of the
        project file, otherwise ``auto``.
    **options
        The options of ``trainer calibrate`` with underscores: ``inducing_points=150``, ``position_sigma_mm=0.02``,
        ``gravity=[0, 0, -9.81]``, ``test=["a.csv", "b.csv"]``, ``keep_gauge="old.blob"``, ``accept=["drift"]``,
        ``no_variance=True``, ``date="2026-11-23"``. With ``tolerance_mm=0.3`` the verdict is in
        ``summary["certificate"]``; the controller's offsets are in ``summary["controller"]``. ``threads=1`` computes on one
        core.

    Returns
    -------
    Calibration
        The same file and options give the same bytes as on the command line; there is no seed. A table gives the same numbers;
        only the checksum of the data in the blob differs from that of a file.

    Raises
    ------
    InputError
        Something in a file or table is wrong: the error has ``file``, ``line`` and ``column``.
    DataRefused
        The measurements are not fit for a calibration.
    ValueError
        An option that does not exist, or a value that it does not take.
    """
    if data is None and _is_project(robot):
        robot, data = None, robot
    if data is None:
        raise TypeError("data: found none, expected a path, a DataFrame or a dictionary of columns, or a project file (.toml)")
    if robot is None and not _is_project(data):
        raise ValueError("robot: found none, expected a built-in robot, a URDF file or a TOML description")
    return Calibration(_calibrate(robot, data, method=method, **options))
