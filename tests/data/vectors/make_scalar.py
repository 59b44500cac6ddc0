#!/usr/bin/env python3
"""Writes scalar.json: the functions of one and two arguments of f32 that the runtime has, from 50-digit arithmetic (mpmath).

Arguments are exactly the f32 numbers that are written, as bits; truth is a pair (high, low) of f64 whose sum has 106 bits.

    python make_scalar.py        # needs mpmath 1.3 and numpy; no randomness
"""

import json
import pathlib

import mpmath as mp
import numpy as np

mp.mp.dps = 50


def f32(number):
    return np.float32(float(number))


def neighbours(number, count=2):
    """The f32 next to a number, on both sides."""
    middle = f32(number)
    found = [middle]
    for towards in (np.float32(-np.inf), np.float32(np.inf)):
        at = middle
        for _ in range(count):
            at = np.nextafter(at, towards)
            found.append(at)
    return found


def spread(lowest, highest, count):
    """Geometrically between two positive numbers."""
    ratio = mp.mpf(highest) / mp.mpf(lowest)
    return [f32(mp.mpf(lowest) * ratio ** (mp.mpf(i) / (count - 1))) for i in range(count)]


def pair(number):
    high = float(number)
    return [high, float(number - mp.mpf(high))]


def rows(arguments, function):
    unique = sorted({float(x) for x in arguments})
    return [[int(np.float32(x).view(np.uint32)), *pair(function(mp.mpf(x)))] for x in unique]


def main():
    powers = [x for k in (0, 1, 2, 3, 7, 31, 60, 124) for half in (0, 0.5) for x in neighbours(-k - half)]
    exponents = [x for x in powers + [-y for y in spread(1e-9, 125, 150)] if -125 <= x <= 0]
    angles = [x for k in (1, 2, 3, 4, 5, 7, 16, 101, 710, 1304, 2607) for x in neighbours(k * mp.pi / 4)]
    angles += spread(1e-12, 4096, 200)
    angles = [x for x in angles + [-y for y in angles] if abs(x) <= 4096] + [np.float32(0)]
    # The kernel: exp(-d^2/2), down to 2^-125.
    distances = [x for x in spread(1e-9, 173, 200) + [np.float32(0)]]
    points = [(s * y, x) for y in spread(1e-6, 1, 12) for s in (-1, 1) for x in (-1, -1e-3, 1e-3, 0.5, 1)]
    points = [(np.float32(y), np.float32(x)) for y, x in points]
    data = {
        "exp2": rows(exponents, lambda x: mp.mpf(2) ** x),
        "sin": rows(angles, mp.sin),
        "cos": rows(angles, mp.cos),
        "correlation": rows(distances, lambda d: mp.exp(-d / 2)),
        "sqrt": rows(spread(1e-37, 3e38, 100), mp.sqrt),
        "atan2": [
            [int(y.view(np.uint32)), int(x.view(np.uint32)), *pair(mp.atan2(mp.mpf(float(y)), mp.mpf(float(x))))]
            for y, x in points
        ],
    }
    lines = []
    for name, table in data.items():
        body = ",\n".join(json.dumps(row, separators=(",", ":")) for row in table)
        lines.append(f'"{name}": [\n{body}\n]')
    (pathlib.Path(__file__).parent / "scalar.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")


main()
