#!/usr/bin/env python3
"""Writes se3_f64.json and se3_f32.json: SE(3) truth from 60-digit arithmetic (mpmath), v first.

The inputs are exactly the numbers that are written: twists rounded to the type, rotation matrices rounded to the type.
A rounded rotation matrix is no rotation any more; its logarithm is meant as that of the nearest rotation (polar
projection). Truth is written as pairs (high, low) of f64 whose sum has 106 bits. The formulas are series and
closed forms at 60 digits, not those of the runtime: exp of the 4x4 matrix by scaling and squaring, the left Jacobian
as Phi_1(ad) = sum ad^k/(k+1)!, the logarithm from the rotation axis of R - R^T and R + R^T.

    python make_se3.py        # needs mpmath 1.3 and numpy; no randomness
"""

import json
import pathlib

import mpmath as mp
import numpy as np

mp.mp.dps = 60

ANGLES = [mp.mpf(0), mp.mpf("1e-12"), mp.mpf("1e-8"), mp.mpf("1e-4"), mp.mpf("1e-3"), mp.mpf("0.1"), mp.mpf(1),
          mp.mpf("1.9999"), mp.mpf("2.0001"), mp.mpf(3), mp.pi - mp.mpf("1e-3"), mp.pi - mp.mpf("1e-8")]
AXES = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (-1, 2, -3), (3, -1, 0.125), (0.01, 1, -0.02), (-2, -2, 1)]
LINEARS = [(0, 0, 0), (1, 0, 0), (0.25, -1.5, 0.75), (-2000, 3000, 1000), (1e-6, 2e-6, -3e-6)]


def rounded(number, kind):
    return mp.mpf(float(np.float32(float(number)))) if kind == "f32" else mp.mpf(float(number))


def pair(number):
    high = float(number)
    return [high, float(number - mp.mpf(high))]


def skew(w):
    return mp.matrix([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def series(matrix, first_factorial):
    """Sum of matrix^k / (k + first_factorial)!."""
    term = mp.eye(matrix.rows) / mp.factorial(first_factorial)
    total, k = term.copy(), 0
    while mp.mnorm(term, 1) > mp.mpf(10) ** -75 * (1 + mp.mnorm(total, 1)):
        k += 1
        term = term * matrix / (k + first_factorial)
        total += term
    return total


def exp4(twist):
    hat = mp.zeros(4)
    hat[:3, :3] = skew(twist[3:])
    for i in range(3):
        hat[i, 3] = twist[i]
    return series(hat, 0)


def left_jacobian(twist):
    ad = mp.zeros(6)
    w, v = skew(twist[3:]), skew(twist[:3])
    ad[:3, :3], ad[:3, 3:], ad[3:, 3:] = w, v, w
    return series(ad, 1)


def nearest_rotation(matrix):
    """Polar projection by Newton's iteration."""
    for _ in range(12):
        matrix = (matrix + (matrix ** -1).T) / 2
    return matrix


def log_rotation(r):
    """The rotation vector, from the axis of whichever of R - R^T and R + R^T does not cancel at 60 digits."""
    sine = mp.matrix([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
    cosine = (r[0, 0] + r[1, 1] + r[2, 2] - 1) / 2
    norm = mp.norm(sine)
    return sine * 0 if norm == 0 else sine / norm * mp.atan2(norm, cosine)


def log(rows, kind):
    r = nearest_rotation(mp.matrix([row[:3] for row in rows]))
    w = log_rotation(r)
    # Closer to a half turn than the rounding of the matrix can tell: the sign of the axis is open.
    if mp.pi - mp.norm(w) < (mp.mpf("1e-6") if kind == "f32" else mp.mpf("1e-15")):
        return None
    t = mp.matrix([row[3] for row in rows])
    v = series(skew(w), 1) ** -1 * t
    return [pair(x) for x in list(v) + list(w)]


def case(angle, axis, linear, kind):
    length = mp.sqrt(sum(mp.mpf(a) ** 2 for a in axis))
    twist = [rounded(mp.mpf(x), kind) for x in linear] + [rounded(angle * mp.mpf(a) / length, kind) for a in axis]
    pose, jacobian = exp4(twist), left_jacobian(twist)
    # The input of the logarithm: the pose, every element rounded to the type.
    rows = [[rounded(pose[i, j], kind) for j in range(4)] for i in range(3)]
    return {
        "angle": float(angle),
        "twist": [float(x) for x in twist],
        "exp": [[pair(pose[i, j]) for j in range(4)] for i in range(3)],
        "left_jacobian": [[pair(jacobian[i, j]) for j in range(6)] for i in range(6)],
        "pose": [[float(x) for x in row] for row in rows],
        "log": log(rows, kind),
    }


def main():
    here = pathlib.Path(__file__).parent
    for kind in ("f64", "f32"):
        cases = []
        for index, angle in enumerate(ANGLES):
            for shift, axis in enumerate(AXES):
                # Two of the five translations with every axis, another pair each time.
                for step in (0, 2):
                    linear = LINEARS[(index + shift + step) % len(LINEARS)]
                    cases.append(case(angle, axis, linear, kind))
        lines = ",\n".join(json.dumps(c, separators=(",", ":")) for c in cases)
        (here / f"se3_{kind}.json").write_text("[\n" + lines + "\n]\n")


main()
