"""Robot programs, corrected where their targets stand."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from poegp._native import correct_program as _correct_program
from poegp.model import Model


def correct_program(program, out, model, **options):
    """Correct a robot program; only numbers of targets change.

    Parameters
    ----------
    program : path or list of paths
        Files that belong together: ABB RAPID, URScript, Fanuc, KUKA, INFORM, VAL3, or a table of poses (CSV).
    out : path
        The corrected file; of several programs, a folder. A record ``OUT.poegp.json`` is written beside it.
    model : Model or path
        The calibrated arm.
    **options
        The options of ``trainer correct`` with underscores: ``payload_kg=2.5``, ``payload_from_program=True``,
        ``frames="frames.toml"``, ``inverse=True``; ``with`` is given as ``**{"with": ["tools.mod"]}``.

    Returns
    -------
    dict
        What ``trainer correct --json`` writes. Targets that could not be corrected are in ``left`` with file, line, column
        and reason; they stand in ``out`` as they were.
    """
    programs = [program] if isinstance(program, (str, os.PathLike)) else list(program)
    if not isinstance(model, Model):
        return _correct_program(programs, out, model, **options)
    with tempfile.TemporaryDirectory() as folder:
        blob = Path(folder) / "model.blob"
        blob.write_bytes(model.blob)
        return _correct_program(programs, out, blob, **options)
