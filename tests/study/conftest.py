"""A study that takes a second."""

import os
from pathlib import Path

import pytest

TINY = """
methods = ["odometry", "icp"]
seeds = 3
[[scenario]]
name = "one-walker"
rate_hz = 5.0
"""


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """The file of a study of six cells."""
    path = tmp_path / "tiny.toml"
    path.write_text(TINY, encoding="utf-8")
    return path


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Of processes that import this checkout and find a program slammot-graph."""
    import sys

    root = Path(__file__).parents[2]
    program = tmp_path / "bin" / "slammot-graph"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m slammot_graph "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    path = f"{program.parent}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PYTHONPATH": str(root), "PATH": path, "NUMBA_NUM_THREADS": "1"}
