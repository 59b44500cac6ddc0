"""The nearest chain of seven fixed frames, found by numpy alone: what no exported chain can go below."""

import numpy as np
from scipy.spatial.transform import Rotation

FRAMES = 7
STEPS = 12
# Steps towards the smallest mean, by weights of one over the distance, which is never taken as less than 10 µm.
STEPS_OF_MEAN = 40
NEAREST_MM = 0.01
# Metres and radians by which one unknown moves the tool about as far.
SCALE = np.tile([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3], FRAMES)


def turns(angles):
    return Rotation.from_rotvec(angles[:, None] * [0, 0, 1]).as_matrix()


def forward(frames, joints):
    """Positions in mm, and their derivatives by a shift and a turn of each frame in itself."""
    rotation = np.broadcast_to(np.eye(3), (len(joints), 3, 3))
    position = np.zeros((len(joints), 3))
    seen = []
    for i, (shift, turn) in enumerate(frames):
        position = position + rotation @ shift
        rotation = rotation @ turn
        seen.append((rotation, position))
        if i < len(frames) - 1:
            rotation = rotation @ turns(joints[:, i])
    columns = []
    for rotation, at in seen:
        axes = [rotation[:, :, k] for k in range(3)]
        columns += axes + [np.cross(axis, position - at) for axis in axes]
    return position, np.stack(columns, axis=2)


def nearest(frames, joints, wanted, steps, smallest_mean=False):
    """By Gauss and Newton, with the least norm where frames are redundant."""
    for _ in range(steps):
        position, columns = forward(frames, joints)
        apart = wanted - position
        distance = np.linalg.norm(apart, axis=1)
        weight = 1 / np.sqrt(np.maximum(distance, NEAREST_MM)) if smallest_mean else np.ones(len(joints))
        rows = (weight[:, None, None] * columns).reshape(-1, 6 * FRAMES) * SCALE
        step = np.linalg.lstsq(rows, (weight[:, None] * apart).ravel(), rcond=1e-10)[0] * SCALE
        moved = step.reshape(FRAMES, 6)
        frames = [
            (shift + turn @ own[:3], turn @ Rotation.from_rotvec(own[3:]).as_matrix())
            for (shift, turn), own in zip(frames, moved)
        ]
    return frames


def distances(frames, joints, wanted):
    return np.linalg.norm(wanted - forward(frames, joints)[0], axis=1)


def floors(start, fitted, compared):
    """Of each (joints, positions in mm): the distances left by least squares, and by the smallest mean."""
    squares = nearest(start, *fitted, STEPS)
    mean = nearest(squares, *fitted, STEPS_OF_MEAN, smallest_mean=True)
    return distances(squares, *compared), distances(mean, *compared)
