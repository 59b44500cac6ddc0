"""What makes no sense as an argument is refused in words, or answered with NaN; models as values."""

import copy
import datetime
import pickle

import numpy as np
import pandas as pd
import pytest

import poegp


def test_a_matrix_that_is_no_pose_is_refused(elastic, rows):
    q, kg = rows.q[:2], rows.kg[:2]
    poses = elastic.predict(q, payload_kg=kg)[0]
    turned = np.swapaxes(poses, 1, 2)
    with pytest.raises(ValueError, match=r"T_wanted\[0\]: found the last row \[.*expected \[0, 0, 0, 1\].*transposed"):
        elastic.inverse(turned, seed=q, payload_kg=kg)
    tool = np.eye(4)
    tool[:3, 3] = [0, 0, 0.2]
    with pytest.raises(ValueError, match=r"tool: found the last row \[0.0, 0.0, 0.2, 1.0\]"):
        elastic.inverse(poses, seed=q, payload_kg=kg, tool=tool.T)
    long, mirrored = poses.copy(), poses.copy()
    long[1, :3, :3] *= 1 + 1e-5
    mirrored[1, :3, 0] *= -1
    with pytest.raises(ValueError, match=r"T_wanted\[1\]: found a rotation that is off by 2.0e-5, expected an orthonormal"):
        elastic.inverse(long, seed=q, payload_kg=kg)
    with pytest.raises(ValueError, match=r"T_wanted\[1\]: found a left-handed rotation"):
        elastic.inverse(mirrored, seed=q, payload_kg=kg)
    with pytest.raises(ValueError, match="tool: found a number that is not finite"):
        elastic.inverse(poses, seed=q, payload_kg=kg, tool=np.full((4, 4), np.nan))


def test_poses_of_single_precision_are_taken(elastic, rows):
    """All that a model predicts in the base frame is rounded."""
    rng = np.random.default_rng(3)
    q = rng.uniform(rows.q.min(axis=0), rows.q.max(axis=0), (3000, 6))
    for model in [elastic]:
        poses = model.predict(q, payload_kg=2, frame="base")[0]
        turns = poses[:, :3, :3]
        print(f"\noff by {np.abs(np.swapaxes(turns, 1, 2) @ turns - np.eye(3)).max():.1e}")
        assert np.isfinite(model.inverse(poses, seed=q, payload_kg=2, frame="base")[0]).all()


def test_what_has_no_answer_is_nan(elastic, wide, rows):
    q = rows.q[:4].copy()
    q[1, 2] = np.nan
    kg = np.array([1.0, 1.0, np.nan, 1.0])
    bad = [False, True, True, False]
    for model in [elastic, wide]:
        poses, answer = model.predict(q, payload_kg=kg)
        assert (answer.status & poegp.Status.BAD_INPUT != 0).tolist() == bad
        for numbers in [poses, answer.sigma_m]:
            numbers = numbers.reshape(4, -1)
            assert np.isnan(numbers).all(axis=1).tolist() == np.isnan(numbers).any(axis=1).tolist() == bad
        joints, answer = model.correct(q, payload_kg=kg)
        for numbers in [joints, answer.position_error_m, answer.rotation_error_rad]:
            numbers = numbers.reshape(4, -1)
            assert np.isnan(numbers).all(axis=1).tolist() == np.isnan(numbers).any(axis=1).tolist() == bad
        wanted = model.predict(rows.q[:4], payload_kg=1.0)[0]
        wanted[3, 0, 3] = np.nan
        joints, answer = model.inverse(wanted, seed=q, payload_kg=kg)
        assert (answer.status & poegp.Status.BAD_INPUT != 0).tolist() == [False, True, True, True]
        for numbers in [joints, answer.position_error_m, answer.rotation_error_rad]:
            numbers = numbers.reshape(4, -1)
            assert np.isnan(numbers).all(axis=1).tolist() == np.isnan(numbers).any(axis=1).tolist() == [False, True, True, True]


def test_models_are_values(arm, elastic, wide, rows):
    for model in [elastic, wide]:
        for other in [pickle.loads(pickle.dumps(model)), copy.deepcopy(model), copy.copy(model)]:
            assert other == model and hash(other) == hash(model) and other.precision == model.precision
            found, expected = (m.predict(rows.q, payload_kg=rows.kg)[0] for m in (other, model))
            assert np.array_equal(found, expected)
    assert elastic != wide and elastic != poegp.Model.load(arm.poe) and elastic != elastic.blob
    assert len({elastic, wide, poegp.Model.load(arm.elastic)}) == 2


def test_calibrations_are_pickled_without_their_report(arm, tmp_path):
    found = poegp.calibrate("abb-irb120", arm.train, method="base-tool")
    other = pickle.loads(pickle.dumps(found))
    assert other.blob == found.blob and other.summary == found.summary and other.model() == found.model()
    with pytest.raises(poegp.Error, match="unpickled"):
        other.report(tmp_path / "page.html")
    again = copy.deepcopy(found)
    again.summary["notes"].append("mine")
    assert again.blob == found.blob and found.summary["notes"] == []
    again.report(tmp_path / "page.html")


def test_a_table_of_degrees_is_no_array_of_radians(elastic, rows):
    names = [f"q{i}_deg" for i in range(1, 7)]
    degrees = pd.DataFrame(np.rad2deg(rows.q), columns=names)
    for ask in [
        lambda q: elastic.predict(q, payload_kg=1),
        lambda q: elastic.correct(q, payload_kg=1),
        lambda q: elastic.jacobian(q, payload_kg=1),
        lambda q: elastic.nominal(q),
    ]:
        for table in [degrees, np.deg2rad(degrees)]:
            with pytest.raises(ValueError, match=r'q: found a column "q1_deg", expected rad .* np.deg2rad\(q.to_numpy\(\)\)'):
                ask(table)
    with pytest.raises(ValueError, match='seed: found a column "q1_deg"'):
        elastic.inverse(elastic.predict(rows.q, payload_kg=1)[0], seed=degrees, payload_kg=1)
    radians = pd.DataFrame(rows.q, columns=[f"q{i}_rad" for i in range(1, 7)])
    expected = elastic.predict(rows.q, payload_kg=1)[0]
    assert np.array_equal(elastic.predict(radians, payload_kg=1)[0], expected)
    assert np.array_equal(elastic.predict(pd.DataFrame(rows.q), payload_kg=1)[0], expected)


def test_a_region_is_an_array_or_a_table_of_joints(elastic, rows, tmp_path):
    out = tmp_path / "arm.urdf"

    def export(region):
        return elastic.export_urdf(out, payload_kg=2.5, region=region)["distance"]

    q = rows.q[:20]
    expected = export(q)
    table = pd.DataFrame(q, columns=[f"q{i}_rad" for i in range(1, 7)])
    for region in [table, pd.DataFrame(q), q.tolist()]:
        assert export(region) == expected
    for region, said in [
        (q[0], r"region: found an array of shape \(6,\), expected \(n, 6\); for one row give region\[None\]"),
        (q[:, :5], r"region: found an array of shape \(20, 5\), expected \(n, 6\)"),
        (table.rename(columns={"q1_rad": "q1_deg"}), 'region: found a column "q1_deg"'),
        (np.where(np.arange(20)[:, None] == 7, np.nan, q), r"region\[7\]: found a number that is not finite"),
        (q[:0], "region: found no rows"),
        (np.where(np.arange(20)[:, None] == 3, 9.0, q), r"region\[3\]: found "),
    ]:
        with pytest.raises(ValueError, match=said) as raised:
            export(region)
        assert "tmp" not in str(raised.value)


def test_what_is_no_number_is_refused(elastic, rows):
    q = rows.q[:2]
    for bad in [True, "2.5", 2.5 + 1j, [True, False], ["1", "2"], np.array(["1", 2.0], object)]:
        with pytest.raises(TypeError, match="payload_kg: expected an array of numbers"):
            elastic.predict(q, payload_kg=bad)
    for bad in [q + 1j, q > 0, q.astype(str)]:
        with pytest.raises(TypeError, match="q: expected an array of numbers"):
            elastic.predict(bad, payload_kg=1)
    for good in [2, np.float32(2), np.array([2, 2], object), pd.Series([2.0, 2.0])]:
        assert (elastic.predict(q, payload_kg=good)[1].status == 0).all()
    for frame in [None, 3, "world"]:
        with pytest.raises(ValueError, match='frame: found .*expected "instrument"'):
            elastic.predict(q, payload_kg=1, frame=frame)
    with pytest.raises(TypeError, match=r"use Model.load\(path or bytes\)"):
        poegp.Model("arm.blob")


def test_options_are_refused_by_their_names(arm):
    def calibrate(**options):
        return poegp.calibrate("abb-irb120", arm.train, method="poe", **options)

    table = pd.read_csv(arm.test, comment="#")
    for options, error, said in [
        ({"help": True}, ValueError, "^unknown option `help`$"),
        ({"inducing_point": 5}, ValueError, "^unknown option `inducing_point`; did you mean `inducing_points`"),
        ({"write-project": "a.toml"}, TypeError, "^write-project: found an output of the command line"),
        ({"no_variance": 1}, ValueError, "^no_variance: found 1, expected True or False"),
        ({"inducing_points": True}, ValueError, "^inducing_points: found True, expected a value"),
        ({"test": table}, TypeError, "^test: found .*DataFrame.*, expected text, a number or a path"),
        ({"test": [table]}, TypeError, "^test: found .*DataFrame"),
        ({"inducing_points": 150.5}, ValueError, "inducing-points"),
    ]:
        with pytest.raises(error, match=said):
            calibrate(**options)
    expected = calibrate(inducing_points=150, date="2026-02-03").blob
    found = calibrate(inducing_points=150.0, date=datetime.date(2026, 2, 3), threads=1, no_variance=np.False_)
    assert found.blob == expected
    assert calibrate(accept="drift").blob == calibrate(accept=["drift"]).blob


def test_frames_are_fitted_by_rows_or_by_all(elastic, arm):
    for given, count in [(True, 300), (10, 290), (np.int64(10), 290), (False, 300)]:
        assert len(elastic.residuals(arm.test, fit_tool=given).line) == count
    for options in [{"fit_base": True, "fit_tool": True}, {"fit_tool": True, "accept": "drift", "threads": 1}]:
        assert len(elastic.residuals(arm.test, **options).line) == 300


def test_files_of_another_kind_are_not_replaced(arm, trainer, tmp_path):
    """Neither measurements nor a signed model."""
    found = poegp.calibrate("abb-irb120", arm.train, method="base-tool")
    mine = tmp_path / "mine.csv"
    mine.write_text("a,b\n1,2\n")
    for write in [found.save, found.report]:
        with pytest.raises(poegp.Error, match="mine.csv: found a file with other contents, expected a new file"):
            write(mine)
    assert mine.read_text() == "a,b\n1,2\n"
    blob = tmp_path / "arm.blob"
    found.save(blob)
    poegp.calibrate("abb-irb120", arm.train, method="poe").save(blob)
    trainer("keys", "new", "--out", tmp_path / "cell")
    trainer("sign", blob, "--key", tmp_path / "cell.key")
    signed = blob.read_bytes()
    with pytest.raises(poegp.Error, match="arm.blob: found a signed model, expected a new file, or a model without a signature"):
        found.save(blob)
    assert blob.read_bytes() == signed
