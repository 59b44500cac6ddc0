"""A calibration from Python is the command line's: bytes, numbers, page and errors."""

import json
import re
import subprocess
import sys
import threading
import time

import numpy as np
import pandas as pd
import pytest

import poegp


@pytest.fixture(scope="module")
def elastic_calibration(arm):
    return poegp.calibrate("abb-irb120", arm.train, method="elastic")


def test_the_blob_has_the_bytes_of_the_command_line(arm, elastic_calibration, tmp_path):
    assert elastic_calibration.blob == arm.elastic.read_bytes()
    assert poegp.calibrate("abb-irb120", arm.train, method="poe").blob == arm.poe.read_bytes()
    elastic_calibration.save(tmp_path / "saved.blob")
    assert (tmp_path / "saved.blob").read_bytes() == arm.elastic.read_bytes()
    assert elastic_calibration.model().blob == arm.elastic.read_bytes()


def test_options_are_those_of_the_command_line(arm, trainer, tmp_path):
    out = tmp_path / "arm.blob"
    options = ["--inducing-points", 20, "--gravity", "0,0,-9.8", "--accept", "drift", "--no-variance"]
    given = {"inducing_points": 20, "gravity": [0, 0, -9.8], "accept": ["drift"], "no_variance": True}
    trainer(
        "calibrate", "--robot", "abb-irb120", arm.train, "--out", out, "--method", "elastic",
        "--serial-number", "7", "--date", "2026-01-31", *options,
    )  # fmt: skip
    found = poegp.calibrate(
        "abb-irb120", arm.train, method="elastic", serial_number=7, date="2026-01-31", **given
    )
    assert found.blob == out.read_bytes()
    assert found.blob != arm.elastic.read_bytes()


def test_the_summary_is_the_json_of_the_command_line(arm, elastic_calibration):
    expected = json.loads((arm.folder / "elastic.json").read_text())
    found = elastic_calibration.summary
    # Who asked, and where the blob went.
    for document in [expected, found]:
        document["provenance"].pop("command")
        document["provenance"]["files"] = [f["sha256"] for f in document["provenance"]["files"]]
        document["blob"].pop("file")
    assert found.pop("notes") == []
    assert found == expected
    assert found["warnings"] == expected["warnings"]


def test_tables_give_the_bytes_of_their_file(arm, tmp_path):
    table = pd.read_csv(arm.train, comment="#")
    path = tmp_path / "table.csv"
    table.to_csv(path, index=False)
    expected = poegp.calibrate("abb-irb120", path, method="poe").blob
    columns = {name: table[name].to_numpy() for name in table}
    lists = {name: table[name].tolist() for name in table}
    for data in [table, columns, lists]:
        assert poegp.calibrate("abb-irb120", data, method="poe").blob == expected
    turned = table.iloc[::-1]
    assert poegp.calibrate("abb-irb120", turned, method="poe").blob != expected


def test_texts_of_a_table_are_kept(arm):
    table = pd.read_csv(arm.train, comment="#")
    # A text may look like a comment at the beginning of a row.
    table.insert(0, "session", np.where(np.arange(len(table)) % 2, '# a "first", day', "another # day"))
    found = poegp.calibrate("abb-irb120", table, method="poe")
    assert found.summary["training_poses"] == len(table)
    for session in [None, "two\nlines"]:
        with pytest.raises(poegp.InputError, match="session"):
            poegp.calibrate("abb-irb120", table.assign(session=session), method="poe")


def test_numbers_of_numpy_are_options_and_masked_values_are_missing(arm):
    expected = poegp.calibrate("abb-irb120", arm.train, method="poe", gravity=[0, 0, -9.81], inducing_points=50)
    given = {"gravity": np.array([0, 0, -9.81]), "inducing_points": np.int64(50)}
    assert poegp.calibrate("abb-irb120", arm.train, method="poe", **given).blob == expected.blob
    table = dict(pd.read_csv(arm.train, comment="#"))
    table["x_mm"] = np.ma.masked_less(np.asarray(table["x_mm"]), 0)
    with pytest.raises(poegp.InputError, match="x_mm"):
        poegp.calibrate("abb-irb120", table, method="poe")


def test_the_report_is_the_page_of_the_command_line(arm, trainer, tmp_path):
    trainer(
        "calibrate", "--robot", "abb-irb120", arm.train, "--method", "poe", "--out", tmp_path / "a.blob",
        "--report", tmp_path / "expected.html",
    )  # fmt: skip
    poegp.calibrate("abb-irb120", arm.train, method="poe").report(tmp_path / "found.html")

    def numbers(name):
        page = (tmp_path / name).read_text()
        return re.findall(r'data-json="([^"]*)"[^>]*>([^<]*)<', page)

    expected = numbers("expected.html")
    assert len(expected) > 20
    assert numbers("found.html") == expected


def test_a_verdict_is_in_the_summary(arm):
    """Both verdicts, and no failure as the command line's exit code is."""
    for tolerance, verdict in [(50.0, "conforms"), (1e-3, "does-not-conform")]:
        found = poegp.calibrate(
            "abb-irb120", arm.train, method="poe", test=[arm.test], tolerance_mm=tolerance, coverage=0.95
        )
        certificate = found.summary["certificate"]
        assert certificate["conformity"]["position"]["verdict"] == verdict
        assert found.summary["controller"]


def test_touches_give_the_bytes_of_the_command_line(trainer, tmp_path):
    """Sockets and a wire in place of a tracker, with the page; a table has no features."""
    cell = tmp_path / "cell"
    trainer("simulate", "--robot", "ur10", "--touch", "socket2,wire1", "--touches", 40, "--out", cell)
    touches, out, page = cell / "touches.csv", tmp_path / "a.blob", tmp_path / "page.html"
    trainer("calibrate", "--robot", "ur10", touches, "--out", out)
    for options in [{}, {"features": cell / "touches.toml"}]:
        found = poegp.calibrate("ur10", touches, **options)
        assert found.blob == out.read_bytes()
    assert found.summary["touches"]["rows"] == 80
    found.report(page)
    assert "</html>" in page.read_text()
    with pytest.raises(ValueError, match="touches in a file"):
        poegp.calibrate("ur10", pd.read_csv(touches, comment="#"), features=cell / "touches.toml")


def test_errors_name_file_line_and_column(arm, tmp_path):
    lines = arm.train.read_text().splitlines()
    fields = lines[5].split(",")
    fields[3] = "zero"
    lines[5] = ",".join(fields)
    path = tmp_path / "wrong.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(poegp.InputError) as raised:
        poegp.calibrate("abb-irb120", path)
    error = raised.value
    assert isinstance(error, poegp.Error) and isinstance(error, ValueError)
    assert (error.file, error.line, error.column) == (str(path), 6, 4)
    assert (error.column_name, error.found) == ("q3_deg", '"zero"')
    assert str(error).startswith(f'{path}:6: column 4 (q3_deg): found "zero", expected')

    with pytest.raises(poegp.InputError) as raised:
        poegp.calibrate("abb-irb120", tmp_path / "none.csv")
    assert (raised.value.line, raised.value.column) == (None, None)
    assert raised.value.found == "no such file"
    with pytest.raises(poegp.InputError, match="robot"):
        poegp.calibrate("no-such-robot", arm.train)


def test_errors_name_row_and_column_of_a_table(arm):
    table = pd.read_csv(arm.train, comment="#")
    table.loc[3, "x_mm"] = np.nan
    with pytest.raises(poegp.InputError) as raised:
        poegp.calibrate("abb-irb120", table)
    # The header is line 1.
    assert (raised.value.file, raised.value.line) == ("<table>", 5)
    assert raised.value.column == list(table).index("x_mm") + 1
    columns = {name: table[name].to_numpy() for name in table}
    columns["y_mm"] = columns["y_mm"][:-1]
    with pytest.raises(poegp.InputError, match="149 values, expected 150") as raised:
        poegp.calibrate("abb-irb120", columns)
    assert raised.value.column_name == "y_mm"
    with pytest.raises(TypeError, match="a path, a DataFrame or a dictionary"):
        poegp.calibrate("abb-irb120", np.zeros((3, 13)))


def test_options_that_make_no_sense_are_refused(arm):
    with pytest.raises(ValueError, match="unknown option `seed`"):
        poegp.calibrate("abb-irb120", arm.train, seed=1)
    with pytest.raises(ValueError, match="possible values: .*elastic"):
        poegp.calibrate("abb-irb120", arm.train, method="best")
    with pytest.raises(TypeError, match="report"):
        poegp.calibrate("abb-irb120", arm.train, report="page.html")


def test_data_that_show_no_robot_are_refused(arm):
    table = pd.read_csv(arm.train, comment="#")
    xyz = ["x_mm", "y_mm", "z_mm"]
    table[xyz] = table[xyz].sample(frac=1, random_state=1).to_numpy()
    with pytest.raises(poegp.DataRefused, match=r"<table>: .*\[[a-z-]+\]"):
        poegp.calibrate("abb-irb120", table)


def test_nothing_is_printed(arm, capfd):
    table = pd.read_csv(arm.train, comment="#").assign(remark=1)
    poegp.calibrate("abb-irb120", table, method="poe")
    with pytest.raises(poegp.DataRefused):
        poegp.calibrate("abb-irb120", table.iloc[:3])
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


def test_other_threads_run_meanwhile(arm):
    """A thread of Python that counts hardly stands still; with the lock held it would not count at all."""
    turns, longest, stop = 0, 0.0, threading.Event()

    def count():
        nonlocal turns, longest
        last = time.perf_counter()
        while not stop.is_set():
            time.sleep(1e-3)
            now = time.perf_counter()
            turns, longest, last = turns + 1, max(longest, now - last), now

    thread = threading.Thread(target=count)
    thread.start()
    begin = time.perf_counter()
    poegp.calibrate("abb-irb120", arm.train, method="elastic")
    taken = time.perf_counter() - begin
    stop.set()
    thread.join()
    print(f"\nelastic calibration: {taken:.2f} s, {turns} turns of another thread, longest wait {longest:.3f} s")
    assert taken > 0.2 and turns > 20 and longest < 0.5 * taken


def test_two_calibrations_at_once_are_two(arm):
    found = {}

    def make(method):
        found[method] = poegp.calibrate("abb-irb120", arm.train, method=method).blob

    threads = [threading.Thread(target=make, args=(m,)) for m in ["elastic", "poe"]]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert found == {"elastic": arm.elastic.read_bytes(), "poe": arm.poe.read_bytes()}


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_a_calibration(arm):
    """After it the process can calibrate again."""
    text = f"""
import os, signal, threading, poegp
threading.Timer(0.15, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
try:
    poegp.calibrate("abb-irb120", {str(arm.train)!r}, method="elastic")
    print("finished")
except KeyboardInterrupt:
    print("stopped")
print(len(poegp.calibrate("abb-irb120", {str(arm.train)!r}, method="poe").blob))
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["stopped", str(len(arm.poe.read_bytes()))], done.stderr
