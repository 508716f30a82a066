"""The notebook of the documents runs in a kernel of its own, and is stored with what it shows.

python tests/api/test_notebook.py    runs it and stores the outputs
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

NOTEBOOK = Path(__file__).parents[2] / "docs" / "notebook.ipynb"


def executed(directory: Path) -> Any:
    """Return the notebook with the outputs of this run."""
    notebook: Any = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(directory)}}).execute()
    return notebook


def shown(notebook: Any) -> list[list[str]]:
    """Return the forms of the output of each cell with code, such as ``image/png``."""
    return [
        sorted(form for output in cell.outputs for form in output.get("data", {output.output_type: None}))
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


@pytest.mark.slow
def test_the_notebook_shows_what_it_is_stored_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(NOTEBOOK.parents[1]))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    stored = nbformat.read(NOTEBOOK, as_version=4)
    forms = shown(stored)
    assert "image/png" in {form for cell in forms for form in cell}
    assert "error" not in {form for cell in forms for form in cell}
    assert shown(executed(tmp_path)) == forms


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        made = executed(Path(place))
    for cell in made.cells:
        cell.metadata = {}  # times of execution
    nbformat.write(made, NOTEBOOK)
    print(os.fspath(NOTEBOOK))
