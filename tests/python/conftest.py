"""One simulated arm, and what the command line makes of it."""

import os
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import poegp

TRAINER = os.environ["POEGP_TRAINER"]
QUIET = {**os.environ, "SOURCE_DATE_EPOCH": "1767225600"}
os.environ["SOURCE_DATE_EPOCH"] = QUIET["SOURCE_DATE_EPOCH"]
JOINTS = [f"q{i}_rad" for i in range(1, 7)]


def run_trainer(*arguments, cwd=None):
    """The trainer's standard output."""
    done = subprocess.run(
        [TRAINER, *map(str, arguments)], cwd=cwd, env=QUIET, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def trainer():
    return run_trainer


@pytest.fixture(scope="session")
def arm(tmp_path_factory):
    """Measurements of a simulated arm, and blobs that the command line made of them."""
    folder = tmp_path_factory.mktemp("arm")
    run_trainer(
        "simulate", "--robot", "abb-irb120", "--poses", 150, "--payloads", "1,2.5,5",
        "--scenario", "wild", "--test-sets", 1, "--test-poses", 300, "--out", folder / "cell",
    )  # fmt: skip
    train = folder / "cell" / "train.csv"
    found = SimpleNamespace(folder=folder, train=train, test=folder / "cell" / "test1.csv")
    for method in ["elastic", "poe"]:
        blob = folder / f"{method}.blob"
        run_trainer(
            "calibrate", "--robot", "abb-irb120", train, "--method", method, "--out", blob,
            "--json", folder / f"{method}.json",
        )  # fmt: skip
        setattr(found, method, blob)
    return found


@pytest.fixture(scope="session")
def rows(arm):
    """Joints (n, 6) in rad, payloads (n,) and the table of the test set, whose joints are in rad."""
    table = pd.read_csv(arm.test, comment="#")
    for i, name in enumerate(JOINTS, 1):
        table[name] = np.deg2rad(table.pop(f"q{i}_deg"))
    return SimpleNamespace(
        q=table[JOINTS].to_numpy(), kg=table["payload_kg"].to_numpy(), table=table
    )


@pytest.fixture(scope="session")
def elastic(arm):
    return poegp.Model.load(arm.elastic)


@pytest.fixture(scope="session")
def wide(arm):
    return poegp.Model.load(arm.elastic, precision="f64")
