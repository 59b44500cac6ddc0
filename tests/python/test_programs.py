"""Corrected programs are those of the command line."""

import json

import pytest

import poegp

PROGRAM = """def weld():
  set_tcp(p[0, 0, 0.1, 0, 0, 0])
  movej([0.1, -0.4, 0.3, 0.2, 0.9, 0.1], a=1.0, v=0.5)  # first
  movej([0.2, -0.3, 0.2, 0.1, 0.8, 0.2], a=1.0, v=0.5)
  movej(there, a=1.0, v=0.5)
end
"""


def test_the_program_has_the_bytes_of_the_command_line(arm, trainer, tmp_path):
    for folder in ["given", "found"]:
        (tmp_path / folder).mkdir()
    program = tmp_path / "weld.script"
    program.write_text(PROGRAM.replace("  movej(there, a=1.0, v=0.5)\n", ""))
    expected, found = tmp_path / "given" / "weld.script", tmp_path / "found" / "weld.script"
    trainer("correct", arm.elastic, program, "--payload-kg", 2.5, "--out", expected, "--json", tmp_path / "a.json")
    for model in [poegp.Model.load(arm.elastic), arm.elastic]:
        document = poegp.correct_program(program, found, model, payload_kg=2.5)
        assert found.read_bytes() == expected.read_bytes() != program.read_bytes()
        assert document == json.loads((tmp_path / "a.json").read_text())
        assert document["joint_targets"] == 2 and document["left"] == []
    back = tmp_path / "found" / "back.script"
    poegp.correct_program(found, back, arm.elastic, payload_kg=2.5, inverse=True)
    assert back.exists()


def test_what_is_left_is_named(arm, tmp_path, capfd):
    program = tmp_path / "weld.script"
    program.write_text(PROGRAM)
    document = poegp.correct_program(program, tmp_path / "out.script", arm.elastic, payload_kg=2.5)
    assert document["joint_targets"] == 2
    assert [(left["file"], left["line"]) for left in document["left"]] == [(str(program), 5)]
    assert capfd.readouterr() == ("", "")


def test_what_cannot_be_corrected_is_an_error(arm, tmp_path):
    program = tmp_path / "weld.script"
    program.write_text(PROGRAM)
    with pytest.raises(ValueError, match="no payload"):
        poegp.correct_program(program, tmp_path / "out.script", arm.elastic)
    with pytest.raises(poegp.InputError, match="no such file"):
        poegp.correct_program(tmp_path / "none.script", tmp_path / "out.script", arm.elastic, payload_kg=1)
    program = tmp_path / "weld.txt"
    program.write_text(PROGRAM)
    with pytest.raises(poegp.InputError, match="a robot program"):
        poegp.correct_program(program, tmp_path / "out.txt", arm.elastic, payload_kg=1)
    assert not (tmp_path / "out.script").exists()
