"""The notebook runs from the first cell to the last, in a kernel of its own."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="nbclient is not installed")
nbclient = pytest.importorskip("nbclient")
ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "examples" / "first_campaign.ipynb"
pytestmark = [
    pytest.mark.slow,
    # the client of the kernel leaves sockets to the collector
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
]


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    notebook.cells[1].source = "EPISODES, COUNT = 1, 2"
    client = nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}})
    done = client.execute()
    told = {i: str(cell.outputs) for i, cell in enumerate(done.cells) if cell.cell_type == "code" and cell.outputs}
    assert "'successes': 2" in told[4]
    assert "carry.speed_scale" in told[9] and "no evidence" in told[9]


def test_it_is_committed_without_outputs() -> None:
    cells = nbformat.read(NOTEBOOK, as_version=4).cells
    assert all(not cell.outputs and cell.execution_count is None for cell in cells if cell.cell_type == "code")
    assert cells[1].source.startswith("EPISODES, COUNT = ")
