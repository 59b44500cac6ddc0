"""CPU seconds of calibrations as the number of poses grows, with the exponent of the growth."""

import numpy as np

from programs import print_table

SIZES = [100, 200, 300, 500, 1000, 2000]
# Largest N that is tried: what lies beyond takes more minutes, or gigabytes, than a table is worth.
METHODS = [
    ("`poe-gp-load`", ["--method", "poe-gp-load"], 2000),
    ("`poe-gp-load --per-output`", ["--method", "poe-gp-load", "--per-output"], 1000),
    ("`elastic`", [], 2000),
]


def table(programs):
    rows = []
    for name, options, largest in METHODS:
        sizes = [n for n in SIZES if n <= largest]
        found = [programs.calibrate(programs.simulated("paper", n), *options) for n in sizes]
        late = [(n, seconds) for n, (seconds, _) in zip(sizes, found) if n >= 300]
        exponent = np.polyfit(*np.log(np.array(late)).T, 1)[0]
        cells = [f"{seconds:.2f} ({memory:.0f})" for seconds, memory in found]
        rows.append([name, *cells, *["–"] * (len(SIZES) - len(sizes)), f"{exponent:.2f}"])
    print_table(
        "Growth: CPU seconds of `trainer calibrate` (peak memory in MB) for N poses; exponent fitted from N = 300 on.",
        ["", *[f"N = {n}" for n in SIZES], "exponent"],
        rows,
    )
