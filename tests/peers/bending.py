"""What an axis that bends would still explain: errors of poses that a model was not trained on, regressed on it.

A bearing gives way to the moment of the weight about the two directions across its axis, too. The elastic model has no such
term. Each joint's bending is linear in three numbers for each link behind it; a ridge regression of all of them on the
errors of held-out poses is tried on other held-out poses. The best of six ridges is printed: no model can do better by much.
"""

import csv
import pathlib
import random
import tomllib

import numpy as np
from scipy.spatial.transform import Rotation

from programs import measured_files, print_table

GRAVITY = np.array([0.0, 0.0, -9.81])
RIDGES = [30.0, 100.0, 300.0, 1e3, 1e4, 1e5]
FOLDS = 10
SIMULATED = ["rich", "wild"]
# File in POEGP_MEASURED_DATA, its arm, and poses to train on.
MEASURED = [
    ("abb_irb120_faro_700.csv", "abb-irb120", 350),
    ("kuka_iiwa7_304.csv", "kuka-iiwa7", 152),
    ("kuka_iiwa7_payload_0_and_2500g.csv", "kuka-iiwa7", 250),
    ("ur10_tmac_b.csv", "ur10", 350),
]


def table(programs):
    check()
    rows = []
    data = pathlib.Path(__file__).parents[1] / "data" / "simulated"
    for scenario in SIMULATED:
        train, *tests = [data / f"irb4400_{scenario}_s0_{part}.csv" for part in ("train", "test1", "test2", "test3")]
        head, test = "", []
        for path in tests:
            head, found = read(path)
            test += found
        rows.append(row(programs, f"simulated `{scenario}`", "abb-irb4400-serial", train, head, test))
    for path, (file, robot, poses) in zip(measured_files([file for file, _, _ in MEASURED]), MEASURED):
        head, measured = read(path)
        random.Random(1).shuffle(measured)
        train = write(programs.folder / "train.csv", head, measured[:poses])
        rows.append(row(programs, f"measured `{file}`", robot, train, head, measured[poses:]))
    print_table(
        "Mean position error in mm of held-out poses, and what bending axes leave of it.",
        ["set", "elastic", "with bending", "change"],
        rows,
    )


def check():
    """Stops unless the regression finds what was planted, and nothing in noise."""
    random_numbers = np.random.default_rng(1)
    columns = random_numbers.standard_normal((300, 3, 20))
    noise = 0.03 * random_numbers.standard_normal((300, 3))
    planted = 0.05 * columns[:, :, 3]
    for errors, name in ((noise, "noise"), (noise + planted, "planted bending")):
        left, floor = min(map(mean_length, regress(columns, errors))), mean_length(noise)
        if not 0.98 * floor < left < 1.02 * floor:
            raise SystemExit(f"{name}: {left:.4f} is left where the noise is {floor:.4f}")


def read(path):
    """Header and rows of a CSV file."""
    head, *rows = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    return head, rows


def write(path, head, rows):
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def row(programs, name, robot, train, head, test):
    test = write(programs.folder / "test.csv", head, test)
    blob, chain = programs.folder / "bending.blob", programs.folder / "bending.toml"
    predictions = programs.folder / "predictions.csv"
    programs.run("calibrate", "--robot", robot, train, "--method", "elastic", "--out", blob, "--quiet")
    programs.run("export", blob, "--poe", chain, "--quiet")
    programs.run("evaluate", blob, test, "--predictions", predictions, "--quiet")
    arm = tomllib.loads(chain.read_text())
    instrument = pose(arm["calibration"]["instrument_from_base"])
    columns, errors = [], []
    with open(test) as measured, open(predictions) as predicted:
        for found, expected in zip(csv.DictReader(measured), csv.DictReader(predicted)):
            joints = np.radians([float(found[f"q{i + 1}_deg"]) for i in range(len(arm["joint"]))])
            columns.append(regressors(arm, joints))
            error = [float(found[f"{axis}_mm"]) - float(expected[f"{axis}_mm"]) for axis in "xyz"]
            errors.append(instrument[:3, :3].T @ error)
    left = regress(np.array(columns), np.array(errors))
    before, after = mean_length(np.array(errors)), min(map(mean_length, left))
    return name, f"{before:.4f}", f"{after:.4f}", f"{100 * (after / before - 1):+.1f} %"


def pose(origin):
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("xyz", origin["rpy_rad"]).as_matrix()
    out[:3, 3] = origin["xyz_m"]
    return out


def regressors(arm, joints):
    """Displacement of the target for each number of each joint and link behind it: 3 × n."""
    here, origins, axes, links = np.eye(4), [], [], []
    for joint, angle in zip(arm["joint"], joints):
        here = here @ pose(joint["origin"])
        origins.append(here[:3, 3])
        axes.append(here[:3, :3] @ joint["axis"])
        here[:3, :3] = here[:3, :3] @ Rotation.from_rotvec(angle * np.array(joint["axis"])).as_matrix()
        links.append(here[:3, :3].copy())
    target = (here @ pose(arm["flange"]["origin"]) @ pose(arm["calibration"]["flange_from_target"]))[:3, 3]
    out = []
    for joint, (origin, axis) in enumerate(zip(origins, axes)):
        across = np.eye(3) - np.outer(axis, axis)
        for link in links[joint:]:
            out += [np.cross(across @ np.cross(arm_of_mass, GRAVITY), target - origin) for arm_of_mass in link.T]
    return np.array(out).T


def regress(columns, errors):
    """What each ridge leaves of the errors, each tenth by the other nine."""
    scale = np.sqrt(np.mean(columns**2, axis=(0, 1)))
    columns = columns[:, :, scale > 1e-6] / scale[scale > 1e-6]
    fold = np.random.default_rng(0).permutation(len(errors)) % FOLDS
    for ridge in RIDGES:
        left = errors.copy()
        for k in range(FOLDS):
            x, y = columns[fold != k].reshape(-1, columns.shape[2]), errors[fold != k].ravel()
            left[fold == k] -= columns[fold == k] @ np.linalg.solve(x.T @ x + ridge * np.eye(x.shape[1]), x.T @ y)
        yield left


def mean_length(errors):
    return float(np.mean(np.linalg.norm(errors, axis=1)))
