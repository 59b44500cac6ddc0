"""Predictions, corrections and inverse kinematics of a calibrated arm."""

from __future__ import annotations

import enum
import operator
import os
import tempfile
from pathlib import Path
from typing import NamedTuple

from poegp._native import NativeModel, status_flags
from poegp._native import export as _export
from poegp._tables import joints, payload
from poegp.errors import InputError


class _Bits(enum.IntFlag):
    """Flags that an integer of NumPy makes, too."""

    @classmethod
    def _missing_(cls, value: object) -> object:
        return super()._missing_(operator.index(value))


Status = _Bits(
    "Status", {name.upper().replace("-", "_"): bit for name, bit in status_flags()}, module=__name__
)
Status.__doc__ = "What an answer is worth: 0 is as trained, each bit is a remark."


class Answer(NamedTuple):
    """What predictions are worth; each array has one value for each row."""

    #: Bits of :class:`Status`, uint8; 0 is as trained.
    status: object
    #: Extrapolation score: 1 within the trained ranges, towards 0 far away.
    trust: object
    #: Standard deviation of one position component of a new measurement, m; NaN where the model does not know it.
    sigma_m: object


class Correction(NamedTuple):
    """What corrected commands are worth; each array has one value for each row."""

    #: Bits of :class:`Status`, uint8.
    status: object
    #: How much of the arm's error is corrected, 0 to 1.
    applied: object
    #: Position error that the model expects to remain, m.
    position_error_m: object
    #: Rotation error that the model expects to remain, rad.
    rotation_error_rad: object


class Solution(NamedTuple):
    """What answers of the inverse kinematics are worth; each array has one value for each row."""

    #: Bits of :class:`Status`, uint8; ``PARTLY_CORRECTED`` where the pose was not reached.
    status: object
    #: Distance from the wanted pose, m.
    position_error_m: object
    #: Rotation from the wanted pose, rad.
    rotation_error_rad: object


class Residuals(NamedTuple):
    """What a model leaves of measurements: measured less predicted, along the axes of the instrument; a row each."""

    #: Position (n, 3), m.
    position_m: object
    #: Rotation vector from the predicted to the measured orientation (n, 3), rad; NaN where none was measured.
    rotation_rad: object
    #: Line of the file (n,), from 1; the first row of a table is line 2.
    line: object


class Model:
    """A calibrated arm. Make one with :meth:`load`; it never changes, and any number of threads may use it.

    ``q`` are the controller's joints (n, dof) in rad (m for sliding joints), base first. ``payload_kg`` is a number or an
    array (n,), and may be left out of models that do not depend on it. The columns of a DataFrame are taken by their names,
    ``q1_rad`` … (``q1_m``), and a Series of payloads by the index of that DataFrame; other names are an error. Poses are
    ``frame_from_target``, and ``frame`` is ``"instrument"``, in which poses were measured, or ``"base"``, the base of the robot.
    """

    def __init__(self, native: NativeModel) -> None:
        if not isinstance(native, NativeModel):
            raise TypeError(f"Model: found {type(native)}, expected no call: use Model.load(path or bytes)")
        self._native = native

    @classmethod
    def load(cls, source, precision="f32"):
        """Load a model from a path or from the bytes of a blob.

        ``precision="f32"`` answers with the bits of the device, ``"f64"`` evaluates the same model in double precision.
        """
        if isinstance(source, (bytes, bytearray, memoryview)):
            return cls(NativeModel.from_bytes(bytes(source), precision))
        return cls(NativeModel.read(source, precision))

    @property
    def blob(self) -> bytes:
        """The bytes that the model was loaded from."""
        return self._native.blob

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self._native.joints

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return self._native.robot

    @property
    def method(self) -> str:
        """Calibration method."""
        return self._native.method

    @property
    def precision(self) -> str:
        """``"f32"`` or ``"f64"``."""
        return self._native.precision

    @property
    def payload_range_kg(self):
        """The trained payloads (lightest, heaviest); None of a model that does not depend on the payload."""
        return self._native.payload_range_kg

    def _asked(self, q, payload_kg, name="q"):
        """Joints and payloads, by the names of the columns and rows of tables."""
        return joints(q, name, self.dof), payload(payload_kg, q, name)

    def predict(self, q, payload_kg=None, frame="instrument"):
        """Where the real target is: poses (n, 4, 4) in m, and their :class:`Answer`.

        The numbers are those of ``trainer evaluate --predictions``. The target is the first one of the training file; for rows
        of another session or target, use :meth:`residuals`.
        A row with ``Status.BAD_INPUT`` has NaN as its pose and standard deviation.
        """
        poses, *answer = self._native.predict(*self._asked(q, payload_kg), frame)
        return poses, Answer(*answer)

    def nominal(self, q, frame="instrument"):
        """Where the target would be by the nominal model: poses (n, 4, 4) in m, NaN for joints that are not finite."""
        return self._native.nominal(joints(q, "q", self.dof), frame)

    def correct(self, q, payload_kg=None):
        """The joints (n, dof) to command so that the real arm stands at ``nominal(q)``, and their :class:`Correction`.

        A row with ``Status.BAD_INPUT`` has NaN as its joints and errors.
        """
        commands, *answer = self._native.correct(*self._asked(q, payload_kg))
        return commands, Correction(*answer)

    @property
    def flange_from_target(self):
        """The target on the flange (4, 4), m: part of the model's gauge."""
        return self._native.flange_from_target

    def inverse(self, T_wanted, seed, payload_kg=None, frame="instrument", tool=None):
        """The joints (n, dof) near ``seed`` at which the real target is at ``T_wanted`` (n, 4, 4), and their :class:`Solution`.

        Send these joints to the controller: the real target then stands at ``T_wanted``. With ``tool``, flange_from_tool
        (4, 4) in m, that tool in place of the target. A row with ``Status.BAD_INPUT`` has NaN as its joints and errors.

        Raises
        ------
        ValueError
            The last row of a matrix is not [0, 0, 0, 1], or its rotation is not orthonormal and right-handed.
        """
        commands, *answer = self._native.inverse(T_wanted, *self._asked(seed, payload_kg, "seed"), frame, tool)
        return commands, Solution(*answer)

    def jacobian(self, q, payload_kg=None):
        """How the real target moves: (n, 6, dof), zeros for joints that are not finite.

        Rows are the velocity of the target's origin x, y, z in m/s, then its angular velocity in rad/s, both along the axes of
        the base frame, for 1 rad/s (1 m/s) of each joint. Pinocchio calls this ``LOCAL_WORLD_ALIGNED``. How the correction
        itself changes with the joints is left out, some thousandths of an elastic model.
        """
        return self._native.jacobian(*self._asked(q, payload_kg))

    def residuals(self, data, **options):
        """What the model leaves of measurements: :class:`Residuals`, a row for each measured pose.

        ``data`` is a file or a table as for :func:`poegp.calibrate`; ``options`` are those of ``trainer evaluate`` with
        underscores: ``fit_base=True``, ``fit_tool=10``, ``correct_drift=True``, ``accept=["drift"]``. Rows used only
        to fit frames are left out. The predictions are those of the device, whatever the precision of this model.
        """
        return Residuals(*self._native.residuals(data, **options))

    def check(self, data, max_mm, **options):
        """Test with a few new measurements whether the calibration still holds.

        Parameters
        ----------
        data : path, DataFrame or dict of arrays
            Ten to twenty poses, spread over the joints as in training: a file or a table as for :func:`poegp.calibrate`. A file
            of touches is taken, too, with ``NAME.toml`` beside it or ``features="NAME.toml"``.
        max_mm : float
            Tolerance of the position error, including measurement noise.
        **options
            Other options of ``trainer check`` with underscores: ``statistic="p95"``, ``max_drift_mm=0.1``, ``fit_base=True``,
            ``accept=["drift"]``, ``previous="old.blob"``, ``programs=["corrected"]``, ``tolerance_mm=0.3``.

        Returns
        -------
        dict
            What ``trainer check --json`` writes, with ``notes``. ``holds`` says whether the calibration holds; that it does not
            is no exception. What moved is in ``changes``, what to do in ``advice``. With touches, findings are in ``touches``.

        Raises
        ------
        InputError
            Something in the measurements is wrong, or the model was calibrated with them.
        DataRefused
            The measurements are not of this robot.
        ValueError
            An option that does not exist, or a value that it does not take.
        """
        return self._native.check(data, max_mm=max_mm, **options)

    def evaluate(self, data, **options):
        """Errors of the model on measurements that it was not trained on.

        Parameters
        ----------
        data : path, DataFrame or dict of arrays
            A file or a table as for :func:`poegp.calibrate`. A file of touches is taken, too, with ``NAME.toml`` beside it or
            ``features="NAME.toml"``.
        **options
            The options of ``trainer evaluate`` with underscores: ``fit_base=True``, ``fit_tool=10``, ``correct_drift=True``,
            ``accept=["drift"]``.

        Returns
        -------
        dict
            What ``trainer evaluate --json`` writes, with ``notes``: the errors are in ``sets[0]``, or in ``touches``. A warning says
            whether the measurements are in other frames than those of the calibration.
            ``training_data`` is True if the model was calibrated with these rows: its errors elsewhere are larger.

        Raises
        ------
        InputError
            Something in the measurements is wrong.
        DataRefused
            The measurements are not of this robot.
        ValueError
            An option that does not exist, or a value that it does not take.
        """
        return self._native.evaluate(data, **options)

    def export_urdf(self, out, nominal=None, *, payload_kg=None, region=None, target_link=None, **options):
        """Write a URDF of the chain without correction that is nearest to the model, and return what it leaves.

        Parameters
        ----------
        out : path
            The URDF.
        nominal : path, optional
            The nominal URDF that the robot was calibrated with, whose links and shapes are kept.
        payload_kg : float, optional
            The payload that the chain is for; all that were trained if it is left out.
        region : str, path or array (n, dof), optional
            Where the chain has to be near to the model: ``"15@0,-20,30,0,45,0"`` (degrees about a pose in degrees), a file of poses,
            or joints in rad (turning joints only). The trained ranges if it is left out.
        target_link : str, optional
            Adds a link of this name at the measured target.
        **options
            Other options of ``trainer export`` with underscores: ``base="base_link"``, ``tip="tool0"``.

        Returns
        -------
        dict
            What ``trainer export --json`` writes: ``distance`` is that of the chain and of the nominal model from the model.

        Raises
        ------
        Error
            No chain is nearer to the model than the nominal model; nothing is written.
        """
        with tempfile.TemporaryDirectory() as folder:
            blob = Path(folder) / "model.blob"
            blob.write_bytes(self.blob)
            file = Path(folder) / "region.csv"
            if region is not None and not isinstance(region, (str, os.PathLike)):
                rows = [",".join(f"q{i + 1}_rad" for i in range(self.dof))]
                rows += [",".join(map(repr, row)) for row in self._native.region(joints(region, "region", self.dof))]
                file.write_text("\n".join(rows) + "\n")
                region = file
            given = {"payload_kg": payload_kg, "region": region, "target_link": target_link, "urdf": nominal}
            try:
                return _export(blob, out=out, **given, **options)
            except InputError as error:
                if error.file != str(file):
                    raise
                row = "" if error.line is None else f"[{error.line - 2}]"
                raise ValueError(f"region{row}: found {error.found}, expected {error.expected}") from None

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Model):
            return NotImplemented
        return (self.blob, self.precision) == (other.blob, other.precision)

    def __hash__(self) -> int:
        return hash((self.blob, self.precision))

    def __reduce__(self):
        return type(self).load, (self.blob, self.precision)

    def __repr__(self) -> str:
        return f"<poegp.Model {self.method} of {self.robot}, {self.precision}>"
