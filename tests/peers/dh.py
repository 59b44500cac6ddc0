"""Calibration of Denavit and Hartenberg's parameters by pybotics, as its documentation does it.

pybotics has modified DH parameters and minimises the distances of positions. Beside all 24 parameters base and tool
position are free. The nominal arm is turned into that form first, and compared with the trainer's chain. Between
parallel axes the form cannot express a small tilt: that is what the paper says suffers."""

import numpy as np
from pybotics.optimization import OptimizationHandler, compute_absolute_errors, optimize_accuracy
from pybotics.robot import Robot
from pybotics.tool import Tool
from scipy.optimize import least_squares

# Evaluations of a fit, each with its 33 differences. It creeps: 12 leave 0.954 mm where 30 leave 0.925, 60 0.891, and 120
# 0.876 (simulated `wild`, 100 poses).
EVALUATIONS = 30
MILLIMETRES = 1e3


def square(rows):
    return np.vstack([np.array(rows).reshape(3, 4), [0, 0, 0, 1]])


def modified_dh(frames):
    """(parameters n×4, base_from_zero, last_from_target) of a chain whose joints turn about z; metres."""
    axes, pose = [], np.eye(4)
    for frame in frames[:-1]:
        pose = pose @ square(frame)
        axes.append(pose)
    target = pose @ square(frames[-1])
    links = []
    for i, axis in enumerate(axes):
        z, point = axis[:3, 2], axis[:3, 3]
        if i + 1 < len(axes):
            other, there = axes[i + 1][:3, 2], axes[i + 1][:3, 3]
            x = np.cross(z, other)
            if np.linalg.norm(x) > 1e-9:
                x /= np.linalg.norm(x)
                # The foot of the common normal on this axis.
                along = np.linalg.solve(np.array([z, -other, x]).T, there - point)[0]
                origin = point + along * z
            else:
                # Parallel: through where the link before ends.
                origin = point + z * np.dot(links[-1][:3, 3] - point, z) if links else point
                x = there - origin
                x -= np.dot(x, z) * z
                x /= np.linalg.norm(x)
        else:
            origin, x = point, links[-1][:3, 0] - np.dot(links[-1][:3, 0], z) * z
            x /= np.linalg.norm(x)
        link = np.eye(4)
        link[:3, :3] = np.array([x, np.cross(z, x), z]).T
        link[:3, 3] = origin
        links.append(link)
    parameters, before = [], links[0]
    for link in links:
        t = np.linalg.inv(before) @ link
        alpha, theta = np.arctan2(-t[1, 2], t[2, 2]), np.arctan2(-t[0, 1], t[0, 0])
        d = -np.sin(alpha) * t[1, 3] + np.cos(alpha) * t[2, 3]
        parameters.append([alpha, t[0, 3], theta, d])
        before = link
    return np.array(parameters), links[0], np.linalg.inv(links[-1]) @ target


def robot(frames):
    parameters, base, last = modified_dh(frames)
    parameters[:, [1, 3]] *= MILLIMETRES
    base[:3, 3] *= MILLIMETRES
    last[:3, 3] *= MILLIMETRES
    arm = Robot.from_parameters(parameters.ravel())
    arm.world_frame = base
    arm.tool = Tool(matrix=last)
    return arm


def error_mm(fold):
    """Mean position error on the fold's test poses after calibration on its training poses."""
    arm = robot(fold["frames"])
    part = {
        name: (
            np.array(fold[name]["serial"]),
            MILLIMETRES * np.array(fold[name]["measured"]).reshape(-1, 3, 4)[:, :, 3],
        )
        for name in ("train", "test")
    }
    # The two programs must mean the same arm.
    joints = part["test"][0]
    ours = MILLIMETRES * np.array(fold["test"]["nominal"]).reshape(-1, 3, 4)[:, :, 3]
    apart = np.max(compute_absolute_errors(joints, ours, arm))
    assert apart < 1e-6, f"the DH form of the arm is {apart} mm off"
    handler = OptimizationHandler(
        arm, kinematic_chain_mask=True, tool_mask=[True] * 3 + [False] * 3, world_mask=True
    )
    start = handler.generate_optimization_vector()
    # Angles move by milliradians, lengths by millimetres.
    found = least_squares(
        optimize_accuracy, start, args=(handler, *part["train"]), x_scale="jac", max_nfev=EVALUATIONS
    )
    handler.apply_optimization_vector(found.x)
    return float(np.mean(compute_absolute_errors(*part["test"], handler.robot)))
