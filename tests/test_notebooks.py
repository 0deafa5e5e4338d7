"""The notebooks run from top to bottom, in a fresh kernel, and draw something."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import jupytext
import pytest
from nbclient import NotebookClient
from traitlets.config import Config

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.py"))


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) == 4


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_draws(path: Path) -> None:
    notebook = jupytext.read(path)
    with TemporaryDirectory() as folder:  # pytest's own is too long a path for a socket
        sockets = {"transport": "ipc", "connection_file": f"{folder}/kernel.json"}  # no ports to run out of
        client = NotebookClient(
            notebook,
            kernel_name="python3",
            timeout=600,
            resources={"metadata": {"path": str(path.parent)}},
            config=Config(KernelManager=sockets),
        )
        inline = {"MPLBACKEND": "module://matplotlib_inline.backend_inline", "IPYTHONDIR": folder}
        client.execute(env=os.environ | inline)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    complaints = [output.text for output in outputs if output.get("name") == "stderr"]
    assert not complaints
