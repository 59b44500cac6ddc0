"""Project files, notes, days and folders: what a caller does not state stays as it was."""

import errno
import os
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import poegp


@pytest.fixture
def project(arm, trainer, tmp_path):
    """A project of method `poe` with all its outputs, none of which exists."""
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "train.csv").write_bytes(arm.train.read_bytes())
    trainer(
        "calibrate", "--robot", "abb-irb120", "train.csv", "--method", "poe", "--out", "a.blob", "--json", "a.json",
        "--write-project", "p.toml", "--date", "2026-01-02", cwd=folder,
    )  # fmt: skip
    text = (folder / "p.toml").read_text()
    (folder / "p.toml").write_text(text.replace('json = "a.json"', 'json = "a.json"\nreport = "a.html"'))
    blob = (folder / "a.blob").read_bytes()
    for name in ["a.blob", "a.json"]:
        (folder / name).unlink()
    return folder / "p.toml", blob


def test_a_project_is_repeated(project):
    path, blob = project
    for found in [poegp.calibrate(path), poegp.calibrate(None, path), poegp.calibrate(data=str(path))]:
        assert found.blob == blob
        assert found.summary["repeats"] is True
        assert found.summary["notes"] == []
    assert sorted(p.name for p in path.parent.iterdir()) == ["p.toml", "train.csv"]


def test_what_is_stated_overrides_a_project_and_is_noted(project):
    path, blob = project
    found = poegp.calibrate("abb-irb120", path, method="base-tool")
    assert found.summary["method"] == "base-tool" and found.blob != blob
    noted = f"the caller overrides calibration.method, robot.description of {path}"
    assert found.summary["notes"] == [noted]
    found = poegp.calibrate(path, method="auto")
    assert found.summary["chosen"]
    assert found.summary["notes"][0] == f"the caller overrides calibration.method of {path}"
    with pytest.raises(ValueError, match="robot: found none"):
        poegp.calibrate(None, path.parent / "train.csv")
    with pytest.raises(TypeError, match="data: found none"):
        poegp.calibrate("abb-irb120")


def test_no_output_of_a_project_is_written(project):
    path, _ = project
    mine = {path.parent / name: b"mine" for name in ["a.blob", "a.json", "a.html"]}
    for file, text in mine.items():
        file.write_bytes(text)
    with pytest.raises(poegp.DataRefused):
        poegp.calibrate("ur10", path)
    found = poegp.calibrate(path)
    found.report(path.parent / "page.html")
    assert all(file.read_bytes() == text for file, text in mine.items())
    assert "</html>" in (path.parent / "page.html").read_text()


def test_notes_are_in_the_summary(arm):
    table = pd.read_csv(arm.train, comment="#").assign(remark=1.0)
    table = pd.concat([table, table.iloc[:3]])
    turn = ["qw", "qx", "qy", "qz"]
    table[turn] *= 1.0005
    found = poegp.calibrate("abb-irb120", table, method="base-tool", inducing_points=50)
    notes = "\n".join(found.summary["notes"])
    said = ["--inducing-points has no effect", '"remark" is not known', "kept, although identical", "were normalised"]
    assert all(words in notes for words in said)
    assert poegp.calibrate("abb-irb120", arm.train, method="base-tool").summary["notes"] == []


def test_a_warm_up_is_noted_whatever_the_type_of_its_times(arm):
    table = pd.read_csv(arm.train, comment="#")
    seconds = 20.0 * np.arange(len(table))
    for name, mm in [("x_mm", 0.3), ("z_mm", 0.4)]:
        table[name] += mm * np.exp(-seconds / 1000)
    expected = poegp.calibrate("abb-irb120", table.assign(time_s=seconds), method="elastic")
    assert expected.summary["elastic"]["warm_up"]
    assert any("warm" in note for note in expected.summary["notes"])
    start = pd.Timestamp("2026-03-01")
    elapsed = pd.to_timedelta(seconds, unit="s")
    times = {
        "m8[ns]": elapsed.to_numpy("m8[ns]"),
        "m8[ms]": elapsed.to_numpy("m8[ms]"),
        "M8[ns]": (start + elapsed).to_numpy("M8[ns]"),
        "zone": start.tz_localize("Europe/Oslo") + elapsed,
        "python": [time.to_pytimedelta() for time in elapsed],
        "dates": [time.to_pydatetime() for time in start + elapsed],
    }
    for name, column in times.items():
        found = poegp.calibrate("abb-irb120", table.assign(time_s=column), method="elastic")
        warm_up = found.summary["elastic"]["warm_up"]
        assert warm_up["time_constant"] == pytest.approx(expected.summary["elastic"]["warm_up"]["time_constant"], rel=1e-6), name


def test_a_report_keeps_its_day_and_its_folder(arm, tmp_path, monkeypatch):
    """After midnight, and after a change of the working folder; new files are an error."""
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    (first / "train.csv").write_bytes(arm.train.read_bytes())
    monkeypatch.chdir(first)
    found = poegp.calibrate("abb-irb120", "train.csv", method="base-tool")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(int(os.environ["SOURCE_DATE_EPOCH"]) + 86400))
    monkeypatch.chdir(second)
    found.report("page.html")
    assert "2026-01-01" in (second / "page.html").read_text()
    rows = arm.train.read_text().splitlines()
    (first / "train.csv").write_text("\n".join(rows[:-1]) + "\n")
    with pytest.raises(RuntimeError, match="files of this calibration have changed"):
        found.report("page.html")


def test_what_cannot_be_written_is_an_error_at_once(arm, tmp_path):
    found = poegp.calibrate("abb-irb120", arm.train, method="base-tool")
    for write in [found.save, found.report]:
        begin = time.perf_counter()
        with pytest.raises(FileNotFoundError) as raised:
            write(tmp_path / "none" / "file")
        assert raised.value.errno == errno.ENOENT
        assert Path(raised.value.filename) == tmp_path / "none" / "file"
        assert time.perf_counter() - begin < 0.05
    with pytest.raises(IsADirectoryError):
        found.report(tmp_path)


def test_a_path_that_begins_with_a_dash_is_a_path(arm, monkeypatch, tmp_path):
    (tmp_path / "-x.csv").write_bytes(arm.train.read_bytes())
    monkeypatch.chdir(tmp_path)
    assert poegp.calibrate("abb-irb120", "-x.csv", method="poe").blob == arm.poe.read_bytes()
    (tmp_path / "-y.csv").write_bytes(arm.test.read_bytes())
    assert len(poegp.Model.load(arm.poe).residuals("-y.csv").line) == 300
    with pytest.raises(poegp.InputError, match="-r"):
        poegp.calibrate("-r", "-x.csv")
