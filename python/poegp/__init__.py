"""Calibrates industrial robots from measured poses, and predicts and corrects with the calibrated model.

Arrays go in and arrays come out. Angles are radians, lengths metres, masses kilograms. Matrices are homogeneous, and
``a_from_b`` carries coordinates of frame b to frame a. Functions print nothing, and compute on all cores while other threads
of Python run.

>>> import poegp
>>> arm = poegp.calibrate("abb-irb120", "measured.csv")        # doctest: +SKIP
>>> model = arm.model()                                        # doctest: +SKIP
>>> poses, answer = model.predict(q, payload_kg=2.5)           # doctest: +SKIP
"""

from poegp._native import Calibration as _Calibration
from poegp._native import __version__
from poegp._native import calibrate as _calibrate
from poegp.errors import DataRefused, Error, InputError
from poegp.model import Answer, Correction, Model, Residuals, Solution, Status
from poegp.programs import correct_program

__all__ = [
    "Answer",
    "Calibration",
    "Correction",
    "DataRefused",
    "Error",
    "InputError",
    "Model",
    "Residuals",
    "Solution",
    "Status",
    "__version__",
    "calibrate",
    "correct_program",
]


class Calibration:
    """A calibration that :func:`calibrate` has made."""

    def __init__(self, native: _Calibration) -> None:
        self._native = native
        self._summary = None

    @property
    def blob(self) -> bytes:
        """The model file: the bytes that ``trainer calibrate --out`` writes."""
        return self._native.blob

    @property
    def summary(self) -> dict:
        """Results: the document that ``trainer calibrate --json`` writes. Warnings are in ``summary["warnings"]``."""
        if self._summary is None:
            self._summary = self._native.summary
        return self._summary

    def model(self, precision="f32"):
        """The calibrated model; see :meth:`Model.load` for the precision."""
        return Model.load(self.blob, precision=precision)

    def save(self, path) -> None:
        """Write the blob to a file."""
        self._native.save(path)

    def report(self, path) -> None:
        """Write an HTML page with held-out errors, plots and parameters.

        It calibrates again, and five times more for the cross-validation.
        """
        self._native.report(path)

    def __repr__(self) -> str:
        return f"<poegp.Calibration of {self.summary['robot']}: {len(self.blob)} bytes>"


def calibrate(robot, data, *, method="auto", **options):
    """Calibrate a robot from measured poses.

    Parameters
    ----------
    robot : str or path
        A built-in robot (``abb-irb4400``, ``abb-irb4400-serial``, ``abb-irb120``, ``kuka-iiwa7``, ``ur5``, ``ur10``), a URDF
        file or a TOML description.
    data : path, DataFrame or dict of arrays
        Measured poses: a file, or a table with the names of its columns (``q1_deg`` … or ``q1_rad`` …, ``x_mm`` or ``x_m`` …,
        optionally ``qw`` … ``qz``, ``payload_kg`` and others). A project file (``.toml``) is taken, too, and so is a file of
        touches with ``NAME.toml`` beside it or ``features="NAME.toml"``.
    method : str
        ``auto``, or ``elastic``, ``parametric``, ``poe``, ``base-tool``, ``poe-gp``, ``poe-gp-load``.
    **options
        The options of ``trainer calibrate`` with underscores: ``inducing_points=150``, ``position_sigma_mm=0.02``,
        ``gravity=[0, 0, -9.81]``, ``test=["a.csv", "b.csv"]``, ``keep_gauge="old.blob"``, ``accept=["drift"]``,
        ``no_variance=True``, ``date="2026-11-23"``. With ``tolerance_mm=0.3`` the verdict is in
        ``summary["certificate"]``; the controller's offsets are in ``summary["controller"]``.

    Returns
    -------
    Calibration
        The same data and options give the same bytes as on the command line; there is no seed.

    Raises
    ------
    InputError
        Something in a file or table is wrong: the error has ``file``, ``line`` and ``column``.
    DataRefused
        No model should be made of these measurements.
    ValueError
        An option that does not exist, or a value that it does not take.
    """
    return Calibration(_calibrate(robot, data, method=method, **options))
