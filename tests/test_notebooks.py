"""The notebooks run from top to bottom, in a fresh kernel, and draw something."""

import ast
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import jupytext
import pytest
from nbclient import NotebookClient
from traitlets.config import Config

import slammot_graph

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.py"))


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) == 5


PARTS = {"core", "detection", "localization", "mapping", "registration"}
"""Shown one by one in the first notebook, which looks inside a step."""


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_uses_the_public_names(path: Path) -> None:
    packages = {"evaluation", "simulation"} | (PARTS if path.stem.startswith("01_") else set())
    n_imports = 0
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("slammot_graph"):
            continue
        n_imports += 1
        _, *below = (node.module or "").split(".")
        if below:
            assert below[0] in packages, node.module
        else:
            assert {name.name for name in node.names} <= set(slammot_graph.__all__)
    assert n_imports


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
