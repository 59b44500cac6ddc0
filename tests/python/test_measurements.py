"""What a model leaves of measurements, and the chain for other programs."""

import json

import numpy as np
import pandas as pd
import pytest

import poegp
from test_model import CELLS, TURN, rotation


@pytest.mark.parametrize("method", ["elastic", "poe"])
def test_residuals_are_those_of_evaluate(arm, rows, trainer, tmp_path, method):
    """By predictions that `evaluate` writes; as a file and as a table; their mean is the command's."""
    blob = getattr(arm, method)
    model = poegp.Model.load(blob)
    trainer("evaluate", blob, arm.test, "--predictions", tmp_path / "p.csv", "--json", tmp_path / "a.json")
    predicted = pd.read_csv(tmp_path / "p.csv")
    measured = pd.read_csv(arm.test, comment="#")
    left = model.residuals(arm.test)
    expected = 1e-3 * (measured[CELLS] - predicted[CELLS]).to_numpy()
    assert np.abs(left.position_m - expected).max() < 1e-9
    turned = rotation(measured[TURN]) @ np.swapaxes(rotation(predicted[TURN]), 1, 2)
    small = np.stack([turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0], turned[:, 1, 0] - turned[:, 0, 1]], 1) / 2
    assert np.abs(left.rotation_rad - small).max() < 1e-8
    [said] = json.loads((tmp_path / "a.json").read_text())["sets"]
    mean = 1e3 * np.linalg.norm(left.position_m, axis=1).mean()
    assert abs(mean / said["position_mm"]["mean"] - 1) < 1e-9
    table = model.residuals(measured)
    assert np.array_equal(table.position_m, left.position_m)
    assert table.line.tolist() == list(range(2, 302)) and len(left.line) == 300


def test_residuals_of_positions_alone_and_of_a_moved_instrument(elastic, arm):
    table = pd.read_csv(arm.test, comment="#")
    left = elastic.residuals(table.drop(columns=TURN))
    assert np.isnan(left.rotation_rad).all() and not np.isnan(left.position_m).any()
    table[CELLS] += [3.0, -2.0, 5.0]
    before = np.linalg.norm(elastic.residuals(table, accept=["frames", "no-fit"]).position_m, axis=1)
    after = np.linalg.norm(elastic.residuals(table, fit_base=True).position_m, axis=1)
    assert before.mean() > 5e-3 and after.mean() < 2e-4
    with pytest.raises(poegp.InputError, match="payload_kg"):
        elastic.residuals(table.drop(columns="payload_kg"))
    with pytest.raises(TypeError, match="found an output"):
        elastic.residuals(table, predictions="a.csv")


def test_an_exported_chain_is_that_of_the_command_line(elastic, arm, rows, trainer, tmp_path):
    """The same bytes, and an error that is true: Pinocchio reads the file."""
    expected, found = tmp_path / "expected.urdf", tmp_path / "found.urdf"
    rest = ["--payload-kg", 2.5, "--target-link", "probe"]
    trainer("export", arm.elastic, "--out", expected, *rest, "--json", tmp_path / "a.json")
    document = elastic.export_urdf(found, payload_kg=2.5, target_link="probe")
    assert found.read_bytes() == expected.read_bytes()
    said = json.loads((tmp_path / "a.json").read_text())
    assert document["distance"] == said["distance"]
    near = elastic.export_urdf(tmp_path / "near.urdf", payload_kg=2.5, region=rows.q[:20])
    means = [d["distance"]["chain"]["position_mm"]["mean"] for d in (near, document)]
    assert means[0] < means[1]
    with pytest.raises(ValueError, match="payload-kg 9: 1 to 5 kg were trained"):
        elastic.export_urdf(tmp_path / "heavy.urdf", payload_kg=9)
    with pytest.raises(poegp.InputError, match="no such file"):
        elastic.export_urdf(tmp_path / "a.urdf", nominal=tmp_path / "none.urdf")
    assert not (tmp_path / "heavy.urdf").exists()
    pin = pytest.importorskip("pinocchio")
    peer = pin.buildModelFromUrdf(str(found))
    data, probe = peer.createData(), peer.getFrameId("probe")
    rng = np.random.default_rng(5)
    q = rng.uniform(rows.q.min(axis=0), rows.q.max(axis=0), (4000, 6))
    poses, _ = elastic.predict(q, payload_kg=2.5, frame="base")
    apart = []
    for joints, pose in zip(q, poses):
        pin.framesForwardKinematics(peer, data, joints)
        apart.append(np.linalg.norm(data.oMf[probe].translation - pose[:3, 3]))
    seen, stated = 1e3 * np.mean(apart), document["distance"]["chain"]["position_mm"]["mean"]
    print(f"\nstated {stated:.4f} mm, seen {seen:.4f} mm over nearly the same ranges")
    assert abs(seen / stated - 1) < 0.05
