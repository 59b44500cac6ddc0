"""Writes the G-code of one place of the cell: path.py PLACE PROGRAM.ngc

Places 1 to 3: edges of an ISO 9283 cube of 250 mm, the poses P1 to P5 of its inclined plane, and the circle in that plane, at
250 mm/s. `singular`: a line that turns the wrist straight.
"""

import pathlib
import sys

import numpy as np

from arm import FLANGE_FROM_TOOL, NominalArm, rpy_of

# Joints in degrees of the nominal arm at the middle of each cube.
MIDDLES_DEG = {
    "1": (-25, 10, 5, 10, 55, 20),
    "2": (20, 25, -10, -15, 50, -30),
    "3": (35, -5, 15, 20, 50, 35),
}
EDGE_MM = 250.0
SPEED_MM_S = 250.0


def drawn(joints_deg):
    """Position in mm and A, B, C in degrees of the nominal arm's tool."""
    at = (NominalArm().base_from_flange(np.radians([joints_deg])) @ FLANGE_FROM_TOOL)[0]
    return 1e3 * at[:3, 3], np.degrees(rpy_of(at[:3, :3]))


def words(position, letters="XYZ"):
    return " ".join(f"{letter}{value:.4f}" for letter, value in zip(letters, position))


def cube(middle_mm, turned_deg):
    """The path about a middle, with one orientation."""
    feed = f"F{60 * SPEED_MM_S:.0f}"
    half = EDGE_MM / 2
    corner = lambda *signs: middle_mm + half * np.array(signs)
    ring = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    edges = [corner(*xy, z) for z in (-1, 1) for xy in ring]
    # ISO 9283: the plane through two opposite edges; P1 in the middle, P2 to P5 at 0.8 of its diagonals.
    plane = [0.8 * half * np.array(signs) for signs in ((1, 1, 1), (-1, 1, 1), (-1, -1, -1), (1, -1, -1))]
    poses = [middle_mm + p for p in plane]
    # The circle: 0.8 of the edge in diameter, in the same plane, which x and (y + z) span.
    radius = 0.8 * half
    along = radius * np.array([0, 1, 1]) / np.sqrt(2)
    across = np.array([radius, 0, 0])
    turn = np.radians(np.arange(1, 721))
    circle = [middle_mm + np.cos(t) * across + np.sin(t) * along for t in turn]
    lines = ["G21 G90 G94 G17 G64 P0.05", f"G1 {words(edges[0])} {words(turned_deg, 'ABC')} F6000", "G4 P0.2", "M62 P0"]
    lines += [f"G1 {words(p)} {feed}" for p in edges[1:]]
    lines += [f"G1 {words(p)} {feed}" for p in [*poses, middle_mm]]
    lines += [f"G1 {words(middle_mm + across)} {feed}"]
    lines += [f"G1 {words(p)} {feed}" for p in circle]
    lines += ["M63 P0", f"G1 {words(middle_mm)} {feed}", "G4 P0.1", "M2"]
    return lines


def singular():
    """From the home position until the wrist is straight and beyond."""
    position, turned = drawn((0, 15, 5, 0, -8, 0))
    return ["G21 G90 G94 G64 P0.05", "M62 P0", f"G1 {words(position)} {words(turned, 'ABC')} F3000", "M2"]


def main():
    place, file = sys.argv[1:]
    lines = singular() if place == "singular" else cube(*drawn(MIDDLES_DEG[place]))
    pathlib.Path(file).write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
