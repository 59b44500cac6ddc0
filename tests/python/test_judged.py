"""What the command line's check, evaluate, compare and plan write: the same documents, from files and from tables."""

import io
import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import poegp
from conftest import QUIET, TRAINER
from test_model import CELLS

ROBOT = "abb-irb120"


def written(folder, *arguments, code=0):
    """What `--json` writes, of a command that ends with this exit code."""
    path = folder / "document.json"
    path.unlink(missing_ok=True)
    done = subprocess.run(
        [TRAINER, *map(str, arguments), "--json", path], env=QUIET, capture_output=True, text=True
    )
    assert done.returncode == code, done.stderr
    return json.loads(path.read_text())


def same(found, expected):
    """Whether a document is the command line's: all but the notes, who asked which program, and the path of the model."""
    assert isinstance(found.pop("notes"), list)
    for document in [found, expected]:
        document.get("certificate", {}).pop("program_sha256", None)
        if "provenance" in document:
            document["provenance"].pop("command")
            document["provenance"]["files"] = [f["sha256"] for f in document["provenance"]["files"]]
    return found == expected


@pytest.fixture(scope="module")
def fresh(arm):
    """Fifteen rows of the test set, as a file and as a table."""
    path = arm.folder / "fresh.csv"
    table = pd.read_csv(arm.test, comment="#").iloc[::20]
    table.to_csv(path, index=False)
    return path, table


@pytest.fixture(scope="module")
def touched(trainer, tmp_path_factory):
    """Touches of two features, one half to calibrate with and the other to judge with."""
    cell = tmp_path_factory.mktemp("touched") / "cell"
    trainer("simulate", "--robot", "ur10", "--touch", "socket2", "--touches", 60, "--out", cell)
    lines = [line for line in (cell / "touches.csv").read_text().splitlines() if not line.startswith("#")]
    for name, rows in [("train", lines[1::2]), ("test", lines[2::2])]:
        (cell / f"{name}.csv").write_text("\n".join([lines[0], *rows]) + "\n")
        (cell / f"{name}.toml").write_text((cell / "touches.toml").read_text())
    trainer("calibrate", "--robot", "ur10", cell / "train.csv", "--out", cell / "a.blob")
    return cell


def test_a_check_is_that_of_the_command_line(arm, elastic, fresh, tmp_path):
    path, table = fresh
    expected = written(tmp_path, "check", arm.elastic, path, "--max-mm", 0.5)
    assert expected["holds"] and expected["tolerance_met"]
    assert same(elastic.check(path, max_mm=0.5), expected)
    found = elastic.check(table.assign(remark=1), 0.5)
    assert any("remark" in note for note in found["notes"])
    assert found["rows"] == expected["rows"] and found["position_mm"] == expected["position_mm"]
    columns = elastic.check({name: table[name].to_numpy() for name in table}, 0.5)
    assert columns["position_mm"] == expected["position_mm"] and columns["notes"] == []
    other = poegp.Model.load(arm.elastic.read_bytes(), precision="f64")
    assert other.check(path, 0.5)["position_mm"] == expected["position_mm"]


def test_a_calibration_that_does_not_hold_is_no_exception(arm, elastic, fresh, tmp_path):
    path, table = fresh
    options = ["--max-mm", 0.01, "--statistic", "p95", "--previous", arm.poe, "--tolerance-mm", 0.01]
    expected = written(tmp_path, "check", arm.elastic, path, *options, code=1)
    found = elastic.check(path, 0.01, statistic="p95", previous=arm.poe, tolerance_mm=0.01)
    assert found["holds"] is False and found["advice"]
    assert found["certificate"]["conformity"]["position"]["verdict"] == "does-not-conform"
    assert same(found, expected)
    turned = table.copy()
    turned["q3_deg"] += 0.1
    found = elastic.check(turned, 0.15)
    assert not found["holds"] and found["drift_matters"] and found["changes"]


def test_an_evaluation_is_that_of_the_command_line(arm, elastic, tmp_path):
    expected = written(tmp_path, "evaluate", arm.elastic, arm.test)
    assert same(elastic.evaluate(arm.test), expected)
    table = pd.read_csv(arm.test, comment="#")
    found = elastic.evaluate(table)
    assert found["sets"][0].pop("name") == "<table>"
    expected["sets"][0].pop("name")
    assert found["sets"] == expected["sets"]
    table[CELLS] += [3.0, -2.0, 5.0]
    table.to_csv(tmp_path / "moved.csv", index=False)
    expected = written(tmp_path, "evaluate", arm.elastic, tmp_path / "moved.csv", "--fit-base", "--fit-tool", 20)
    found = elastic.evaluate(tmp_path / "moved.csv", fit_base=True, fit_tool=20)
    assert found["base_fitted"] and found["notes"] == [] and same(found, expected)
    # A warning is in the document.
    table[CELLS] += 50.0
    assert any("not in the frames of the calibration" in warning["text"] for warning in elastic.evaluate(table)["warnings"])
    assert elastic.evaluate(arm.train)["training_data"] is True


def test_touches_are_judged_as_by_the_command_line(touched, tmp_path):
    blob, path = touched / "a.blob", touched / "test.csv"
    model = poegp.Model.load(blob)
    assert same(model.evaluate(path), written(tmp_path, "evaluate", blob, path))
    for limit, code in [(9, 0), (1e-3, 1)]:
        expected = written(tmp_path, "check", blob, path, "--max-mm", limit, code=code)
        found = model.check(path, limit, features=touched / "test.toml")
        assert found["holds"] is (code == 0) and same(found, expected)
    expected = written(tmp_path, "compare", "--robot", "ur10", path, "--blob", blob)
    assert same(poegp.compare("ur10", path, blob=blob), expected)
    table = pd.read_csv(path, comment="#")
    for ask in [lambda **o: model.check(table, 1, **o), lambda **o: model.evaluate(table, **o), lambda **o: poegp.compare("ur10", table, **o)]:
        with pytest.raises(ValueError, match="touches in a file"):
            ask(features=touched / "test.toml")
    with pytest.raises(ValueError, match="found --fit-base with touches"):
        model.check(path, 1, fit_base=True)


def test_a_comparison_is_that_of_the_command_line(arm, tmp_path):
    options = ["--methods", "base-tool,poe", "--test", arm.test, "--folds", 3]
    given = {"methods": ["base-tool", "poe"], "test": arm.test, "folds": 3}
    expected = written(tmp_path, "compare", "--robot", ROBOT, arm.train, *options)
    found = poegp.compare(ROBOT, arm.train, **given)
    assert [m["method"] for m in found["methods"]] == ["base-tool", "poe"]
    assert same(found, expected)
    table = pd.read_csv(arm.train, comment="#").assign(remark=1)
    found = poegp.compare(ROBOT, table, **given, no_variance=True)
    assert found["methods"] == expected["methods"]
    assert any("remark" in note for note in found["notes"]) and any("no effect" in note for note in found["notes"])


def test_a_tolerance_that_is_not_met_is_no_exception(arm, tmp_path):
    options = ["--methods", "poe", "--test", arm.test, "--folds", 0, "--tolerance-mm", 0.001]
    expected = written(tmp_path, "compare", "--robot", ROBOT, arm.train, *options, code=1)
    found = poegp.compare(ROBOT, arm.train, methods="poe", test=[arm.test], folds=0, tolerance_mm=0.001)
    assert found["certificate"]["conformity"]["position"]["verdict"] == "does-not-conform"
    assert same(found, expected)


def test_a_plan_is_that_of_the_command_line(arm, tmp_path):
    out, checks = tmp_path / "plan.csv", tmp_path / "check.csv"
    options = ["--payloads", "0,2", "--test-poses", 5, "--test-out", checks, "--seed", 3, "--out", out, "--no-forecast"]
    expected = written(tmp_path, "plan", "--robot", ROBOT, "--count", 20, *options)
    found = poegp.plan(ROBOT, 20, payloads=[0, 2], test_poses=5, seed=3, no_forecast=True)
    assert same(found.summary, expected)
    assert found.table == out.read_text()
    for joints, kg, path in [(found.q, found.payload_kg, out), (found.test_q, found.test_payload_kg, checks)]:
        table = pd.read_csv(path, comment="#")
        degrees = table[[f"q{i}_deg" for i in range(1, 7)]].to_numpy()
        assert joints.shape == degrees.shape and np.abs(np.rad2deg(joints) - degrees).max() < 1e-9
        assert kg.tolist() == table["payload_kg"].tolist()
    assert len(pd.read_csv(io.StringIO(found.table), comment="#")) == 20
    alone = poegp.plan(ROBOT, count=20, forecast=[15], prior=arm.elastic)
    assert alone.payload_kg is None and alone.test_q.shape == (0, 6) and alone.test_payload_kg is None
    assert [row["poses"] for row in alone.summary["forecast"]["rows"]] == [15, 20] and alone.summary["prior"]["elastic"]
    assert any("one payload" in note for note in alone.summary["notes"])


def test_what_cannot_be_judged_is_an_exception(arm, elastic, fresh, tmp_path, capfd):
    _, table = fresh
    bad = table.reset_index(drop=True)
    bad.loc[3, "y_mm"] = np.nan
    for ask in [lambda data: elastic.check(data, 0.5), elastic.evaluate, lambda data: poegp.compare(ROBOT, data)]:
        with pytest.raises(poegp.InputError) as raised:
            ask(bad)
        assert (raised.value.file, raised.value.line, raised.value.column_name) == ("<table>", 5, "y_mm")
        with pytest.raises(poegp.InputError, match="no such file"):
            ask(tmp_path / "none.csv")
        with pytest.raises(TypeError, match="a path, a DataFrame or a dictionary"):
            ask(np.zeros((3, 13)))
    with pytest.raises(poegp.InputError, match="the training data"):
        elastic.check(arm.train, 0.5)
    with pytest.raises(poegp.InputError, match="payload_kg"):
        elastic.check(table.drop(columns="payload_kg"), 0.5)
    with pytest.raises(poegp.InputError, match="poses"):
        elastic.check(table.iloc[:3], 0.5)
    with pytest.raises(poegp.InputError, match="no-such-robot"):
        poegp.plan("no-such-robot")
    with pytest.raises(poegp.InputError, match="no such file"):
        poegp.plan(ROBOT, constraints=tmp_path / "none.toml")
    assert capfd.readouterr() == ("", "")


def test_options_of_these_are_refused_by_their_names(arm, elastic, fresh):
    path, _ = fresh
    for ask, error, said in [
        (lambda: elastic.check(path), TypeError, "max_mm"),
        (lambda: elastic.check(path, -1), ValueError, "--max-mm -1: expected a number above 0"),
        (lambda: elastic.check(path, "wide"), ValueError, "invalid value 'wide' for '--max-mm"),
        (lambda: elastic.check(path, 1, max_drift=1), ValueError, "unknown option `max_drift`; did you mean `max_drift_mm`"),
        (lambda: elastic.check(path, 1, statistic="median"), ValueError, "possible values: mean, p95, max"),
        (lambda: elastic.check(path, 1, report="page.html"), TypeError, "^report: found an output"),
        (lambda: elastic.evaluate(path, predictions="p.csv"), TypeError, "^predictions: found an output"),
        (lambda: elastic.evaluate(path, max_mm=1), ValueError, "unknown option `max_mm`"),
        (lambda: poegp.compare(ROBOT, arm.train, methods="best"), ValueError, "possible values: .*elastic"),
        (lambda: poegp.compare(ROBOT, arm.train, folds=1), ValueError, "leaves nothing to train on"),
        (lambda: poegp.compare(ROBOT, arm.train, blob=arm.elastic), ValueError, "found --blob with .*expected touches"),
        (lambda: poegp.compare(ROBOT, arm.train, json="a.json"), TypeError, "^json: found an output"),
        (lambda: poegp.plan(ROBOT, 5), ValueError, "--count 5: expected at least"),
        (lambda: poegp.plan(ROBOT, out="a.csv"), TypeError, "^out: found an output"),
        (lambda: poegp.plan(ROBOT, touch="socket=1,2,3"), ValueError, "found --touch, expected a plan of measured poses"),
    ]:
        with pytest.raises(error, match=said):
            ask()


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_a_comparison_and_a_plan(arm):
    """Each is ended soon, and the process can compare again."""
    text = f"""
import os, signal, threading, time, poegp
def stopped(work):
    threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    begin = time.perf_counter()
    try:
        work()
        print("finished")
    except KeyboardInterrupt:
        print("stopped" if time.perf_counter() - begin < 20 else "late")
stopped(lambda: poegp.compare("{ROBOT}", {str(arm.train)!r}, methods="elastic", folds=50))
stopped(lambda: poegp.plan("{ROBOT}", payloads=[0, 1, 2]))
stopped(lambda: poegp.plan("{ROBOT}", 400, v_optimal=True, no_forecast=True))
print(len(poegp.compare("{ROBOT}", {str(arm.train)!r}, methods="poe", test={str(arm.test)!r}, folds=0)["methods"]))
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=300)
    assert done.stdout.split() == ["stopped"] * 3 + ["1"], done.stdout + done.stderr
