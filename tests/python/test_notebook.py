"""The notebook runs as it stands."""

from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]


def test_the_notebook_runs(trainer, tmp_path):
    trainer("simulate", "--robot", "abb-irb120", "--out", tmp_path / "cell")
    notebook = nbformat.read(ROOT / "python" / "notebook.ipynb", as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "commit it without outputs"
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    texts = [o.get("text", "") for cell in notebook.cells for o in cell.get("outputs", [])]
    print("\n" + "".join(texts))
    assert "calibrated" in "".join(texts)
