"""Finds the constants of the bound on instructions, `POSE` and `COMMAND` of runtime/src/model/cost.rs.

Reads the lines of `cost_bound::counts` (see docs/evidence/performance.md) and solves a linear program: the bound is nowhere
below what was measured, with 0.9 % and 4 instructions to spare, and its largest ratio to that is as small as it can be.
"""

import re
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import linprog

SPARE_SHARE, SPARE_INSTRUCTIONS = 1.009, 4.0
UNIT = 256
# Terms of the arm, of the three forms of a correction in task space and its standard deviation, of an elastic one: a line of
# the table each.
ENDS_OF_LINES = (7, 11, 15, 19, 24)
SOURCE = Path(__file__).parents[2] / "runtime/src/model/cost.rs"
JOINTS = 1  # the column of their number


def read(paths):
    """Counts of the terms, and instructions of pose, command and command with frames: one row for each model."""
    lines = (line[5:].split(" # ")[0] for path in paths for line in open(path) if line.startswith("DATA "))
    rows = np.array([[float(value) for value in line.split(",")] for line in lines])
    return rows[:, :-3], rows[:, -3], rows[:, -2], rows[:, -1]


def parts(counts, measured):
    """Parts of an instruction for each term, rounded up."""
    models, terms = counts.shape
    above = np.hstack([-counts, np.zeros((models, 1))])
    below = np.hstack([counts, -measured[:, None]])
    used = counts.any(axis=0)
    solution = linprog(
        np.r_[np.zeros(terms), 1.0],
        A_ub=np.vstack([above, below]),
        b_ub=np.r_[-SPARE_SHARE * measured - SPARE_INSTRUCTIONS, np.zeros(models)],
        bounds=[(None, None) if is_used else (0.0, 0.0) for is_used in used] + [(0.0, None)],
        method="highs",
    )
    if not solution.success:
        sys.exit(f"the linear program has no solution: {solution.message}")
    rounded = np.ceil(UNIT * solution.x[:terms]).astype(int)
    rounded[~used] = 0
    return rounded


def frames():
    """Instructions of the frames of an arm with one joint, two, …"""
    found = re.search(r"^const FRAME: \[u32; MAX_JOINTS\] = \[([0-9_, ]+)\];", SOURCE.read_text(), re.MULTILINE)
    if not found:
        sys.exit(f"{SOURCE}: no FRAME")
    return np.array([int(number) for number in found[1].split(",")])


def main():
    counts, pose, command, framed = read(sys.argv[1:])
    print(f"{len(counts)} models")
    for name, measured in (("POSE", pose), ("COMMAND", command)):
        each = parts(counts, measured)
        bound = np.floor(counts @ each / UNIT)
        share = measured / bound
        print(f"{name}: measured is {share.min():.4f} to {share.max():.4f} of the bound")
        for begin, end in zip((0, *ENDS_OF_LINES), (*ENDS_OF_LINES, len(each))):
            print("    " + ", ".join(map(str, each[begin:end])) + ",")
    share = framed / (bound + frames()[counts[:, JOINTS].astype(int) - 1])
    print(f"command with its frames: measured is {share.min():.4f} to {share.max():.4f} of the bound")


if __name__ == "__main__":
    main()
