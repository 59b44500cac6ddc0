"""Plots of corrections along paths through singularities, before and after they became continuous.

    git worktree add ../old 7dd6392
    git show 38e55d37:trainer/examples/singular_paths.rs > ../old/trainer/examples/singular_paths.rs
    (cd ../old && cargo run --release -p poegp-trainer --example singular_paths > before.csv)
    cargo run --release -p poegp-calibration --example singular_paths > after.csv
    python tests/peers/smooth.py ../old/before.csv after.csv docs/evidence

writes one SVG per arm and prints, for each path, the largest step between rows of a milliradian and what stays.
"""

import csv
import io
import pathlib
import re
import sys

import matplotlib
import numpy as np

matplotlib.use("svg")
matplotlib.rcParams["path.simplify_threshold"] = 0.35
matplotlib.rcParams["svg.fonttype"] = "none"
matplotlib.rcParams["svg.hashsalt"] = "smooth"
from matplotlib import pyplot  # noqa: E402


def read(path):
    """{(arm, kind): (rad, position in mm, rotation in mrad, changes in mrad)}"""
    found = {}
    with open(path) as file:
        for row in csv.DictReader(file):
            changes = [float(c) for c in row["change_mrad"].split()]
            line = [float(row["rad"]), float(row["position_mm"]), float(row["rotation_mrad"]), *changes]
            found.setdefault((row["arm"], row["kind"]), []).append(line)
    parts = {key: np.array(lines) for key, lines in found.items()}
    return {key: (a[:, 0], a[:, 1], a[:, 2], a[:, 3:]) for key, a in parts.items()}


def draw(arm, kinds, before, after, folder):
    figure, axes = pyplot.subplots(3, len(kinds), figsize=(3.2 * len(kinds), 5.6), sharex=True, squeeze=False)
    for column, kind in enumerate(kinds):
        for row, (title, data) in enumerate((("before", before), ("after", after))):
            rad, _, _, changes = data[arm, kind]
            axis = axes[row][column]
            for i in range(changes.shape[1]):
                axis.plot(rad, changes[:, i], linewidth=0.9, label=str(i + 1))
            axis.set_title(f"{kind}, {title}", fontsize=8)
        axis = axes[2][column]
        for title, data, color in (("before", before, "0.65"), ("after", after, "black")):
            rad, position, _, _ = data[arm, kind]
            axis.plot(rad, position, linewidth=0.9, color=color, label=title)
        axis.set_title(f"{kind}, position error that stays", fontsize=8)
        axis.set_ylim(bottom=0)
        axis.set_xlabel("rad from the singularity", fontsize=8)
    for axis in axes.flat:
        axis.tick_params(labelsize=7)
        axis.locator_params(axis="x", nbins=4)
        axis.locator_params(axis="y", nbins=5)
        axis.grid(linewidth=0.3)
    axes[0][0].legend(fontsize=6, ncols=2, title="joint", title_fontsize=6)
    axes[2][0].legend(fontsize=6)
    for row, label in enumerate(("correction, mrad", "correction, mrad", "mm")):
        axes[row][0].set_ylabel(label, fontsize=8)
    figure.suptitle(arm, fontsize=9)
    figure.tight_layout()
    drawing = io.StringIO()
    figure.savefig(drawing, format="svg", metadata={"Date": None})
    pyplot.close(figure)
    # A tenth of a point is enough for the eye, but not for the labels of the axes; indentation and lists of fonts are a
    # quarter of the bytes.
    short = re.sub(r"(>[^<]*<)|(\d+\.\d)\d+", lambda found: found[1] or found[2], drawing.getvalue())
    short = re.sub(r"font-family: [^;]*", "font-family: sans-serif", short)
    short = re.sub(r"\s*\n\s*L ", "L", short).replace("; stroke-linecap: square", "")
    (folder / f"smooth-{arm}.svg").write_text(re.sub(r"\s*\n\s*", "\n", short))


def main():
    before, after, folder = read(sys.argv[1]), read(sys.argv[2]), pathlib.Path(sys.argv[3])
    arms = {}
    for arm, kind in before:
        arms.setdefault(arm, []).append(kind)
    columns = ["arm", "singularity", "largest step, mrad: before", "after", "largest correction, mrad: before", "after"]
    columns += ["stays, mm: before", "after", "stays, mrad: before", "after"]
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    for arm, kinds in arms.items():
        draw(arm, kinds, before, after, folder)
        for kind in kinds:
            old, new = before[arm, kind], after[arm, kind]
            pairs = [
                ([np.abs(np.diff(part[3], axis=0)).max() for part in (old, new)], 2),
                ([np.abs(part[3]).max() for part in (old, new)], 0),
                ([part[1].max() for part in (old, new)], 2),
                ([part[2].max() for part in (old, new)], 2),
            ]
            numbers = [f"{value:.{digits}f}" for pair, digits in pairs for value in pair]
            print(f"| {arm} | {kind} | {' | '.join(numbers)} |")


if __name__ == "__main__":
    main()
