"""Uses of the documentation, for the types of the stubs."""

import datetime
from pathlib import Path

import numpy as np
import pandas as pd
import poegp

table = pd.read_csv("cell/train.csv", comment="#")
one = poegp.calibrate("abb-irb120", table)
two = poegp.calibrate("abb-irb120", {"q1_deg": [1.0, 2.0]}, gravity=np.array([0, 0, -9.81]), accept="drift", threads=1)
three = poegp.calibrate("project.toml", date=datetime.date(2026, 1, 2), accept=["drift"], test="a.csv")
four = poegp.calibrate("abb-irb120", {"q1_deg": np.zeros(3)}, method="poe", test=["a.csv", Path("b.csv")])
model = poegp.Model.load(Path("arm.blob"), "f64")
same: bool = model == poegp.Model.load(bytearray(b"x"))
q = np.deg2rad(table[[f"q{i}_deg" for i in range(1, 7)]].to_numpy())
poses, answer = model.predict(q, payload_kg=table["payload_kg"])
bits: np.ndarray = answer.status & poegp.Status.OUTSIDE_JOINT_RANGE
left = model.residuals(table, fit_tool=True, threads=1, accept="frames")
model.export_urdf("arm.urdf", region=pd.DataFrame(q), payload_kg=2.5)
one.report(Path("page.html"))
holds: bool = model.check(table, 0.15, statistic="p95", fit_base=True, programs=["corrected"])["holds"]
errors = model.evaluate("test.csv", fit_tool=10, features=Path("a.toml"))["sets"][0]["position_mm"]["mean"]
both = poegp.compare("ur10", table, methods=["elastic", "poe"], test=["a.csv", Path("b.csv")], folds=0, seed=2)
planned = poegp.plan("ur10", 50, payloads=[0, 5, 10], test_poses=15, no_forecast=True)
rows, poses_to_measure, csv = len(planned.q), planned.q[0], planned.table.splitlines()
