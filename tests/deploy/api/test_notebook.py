"""The notebook that documents the Python interface runs as it stands."""

from pathlib import Path

import nbformat
from nbclient import NotebookClient

import deploy

NOTEBOOK = Path(deploy.__file__).parent / "docs" / "how-to" / "python.ipynb"


def outputs(cells, containing):
    """What the only cell with a text in it gave, as text."""
    (cell,) = (cell for cell in cells if cell.cell_type == "code" and containing in cell.source)
    shown = [out.get("text") or out["data"]["text/plain"] for out in cell.outputs]
    return "".join(shown)


def test_notebook_runs_and_shows_what_it_says(tmp_path):
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(notebook, resources={"metadata": {"path": str(tmp_path)}}, timeout=120).execute()
    assert outputs(notebook.cells, "run.kept").startswith("(True, 0.3")
    assert "did you mean duration_s?" in outputs(notebook.cells, '"duration": 1.0')
    assert "(1001, 3)" in outputs(notebook.cells, "run.errors_rad.shape")
    assert "__main__:ComputedTorque" in outputs(notebook.cells, "compared.frame()")
    assert "'fixed_time_neural'" in outputs(notebook.cells, "found.margins")
    assert outputs(notebook.cells, "load_run") == "True"
