"""What comes before and beside a calibration: which poses to measure, and which method to choose."""

from __future__ import annotations

from typing import NamedTuple

from poegp._native import compare as _compare
from poegp._native import plan as _plan


class Plan(NamedTuple):
    """Poses to measure, in the order in which they are to be measured."""

    #: The controller's joints (n, dof), rad, m for sliding joints.
    q: object
    #: Payload of each pose (n,), kg; None if no payloads are stated.
    payload_kg: object
    #: Joints of the poses to test with (k, dof), which are not for the calibration.
    test_q: object
    #: Payload of each of these (k,), kg; None if no payloads are stated.
    test_payload_kg: object
    #: The text of a CSV file with the poses for the calibration, to which the measurements are added.
    table: str
    #: What ``trainer plan --json`` writes, with ``notes``.
    summary: dict


def plan(robot, count=None, *, payloads=None, **options):
    """Choose the poses to measure.

    In every pose the links stay clear of each other and of the base, and above the plane on which the robot is mounted. Cables,
    the load and the motion between poses are not checked: try every motion slowly first.

    Parameters
    ----------
    robot : str or path
        A built-in robot, a URDF file or a TOML description, as for :func:`poegp.calibrate`.
    count : int, optional
        Number of poses for the calibration; 100 if it is left out.
    payloads : list of float, optional
        Payloads in kg; there is one block of poses for each.
    **options
        Other options of ``trainer plan`` with underscores: ``constraints="cell.toml"``, ``test_poses=15``, ``v_optimal=True``,
        ``prior="sister.blob"``, ``seed=2``. ``no_forecast=True`` leaves out the forecast of the error, which takes about three
        minutes of processor time, shared by all cores.

    Returns
    -------
    Plan
        The same options give the same poses as on the command line. Ctrl-C ends it.

    Raises
    ------
    InputError
        Something in a file is wrong, or the constraints leave too few poses.
    ValueError
        An option that does not exist, or a value that it does not take.
    """
    (q, kg), (test_q, test_kg), table, summary = _plan(robot, count=count, payloads=payloads, **options)
    return Plan(q, kg, test_q, test_kg, table, summary)


def compare(robot, data, *, methods=None, test=None, folds=None, **options):
    """Compare calibration methods by their errors on held-out poses.

    Parameters
    ----------
    robot : str or path
        A built-in robot, a URDF file or a TOML description, as for :func:`poegp.calibrate`.
    data : path, DataFrame or dict of arrays
        Measured poses for training and cross-validation, as for :func:`poegp.calibrate`. With a file of touches, the models
        ``blob=["before.blob", "after.blob"]`` are compared by these, without training.
    methods : str or list of str, optional
        Methods as for :func:`poegp.calibrate`; all that the data allow if it is left out.
    test : path or list of paths, optional
        Files of held-out measurements.
    folds : int, optional
        Number of folds of the cross-validation, 0 for none; 10 if it is left out.
    **options
        Other options of ``trainer compare`` with underscores: ``seed=2``, ``accept=["drift"]``, ``tolerance_mm=0.3``.

    Returns
    -------
    dict
        What ``trainer compare --json`` writes, with ``notes``: ``methods`` has the errors of each. With a tolerance, the verdict on
        the best is in ``certificate``; that it is not met is no exception. Ctrl-C ends the comparison.

    Raises
    ------
    InputError
        Something in a file or table is wrong.
    DataRefused
        The measurements are not fit for a calibration.
    ValueError
        An option that does not exist, or a value that it does not take.
    """
    return _compare(robot, data, methods=methods, test=test, folds=folds, **options)
