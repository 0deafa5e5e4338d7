"""What the cells of these tests compute."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from slammot_graph.core.types import FloatArray
from slammot_graph.study.cells import Cell
from slammot_graph.study.data_files import DataFile

FACTOR = 2.0
KEPT: list[FloatArray] = []


def double(x: float, folder: str, seconds: float = 0.0) -> dict[str, Any]:
    """Write down that it was called, in which process."""
    with (Path(folder) / "calls").open("a", encoding="utf-8") as file:
        file.write(f"{x:g} {os.getpid()}\n")
    time.sleep(seconds)
    if x < 0.0:
        raise ValueError(f"{x:g} is negative")
    return {"double": FACTOR * x, "none": float("nan")}


def die(x: float, folder: str, times: int) -> dict[str, Any]:
    """Kill the own process so many times, then be good."""
    marks = Path(folder)
    n = len(list(marks.glob(f"died-{x:g}-*")))
    if n < times:
        (marks / f"died-{x:g}-{n}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {"double": 2.0 * x}


def grow(x: float) -> dict[str, Any]:
    """Keep 100 MB for good; tell the process, and the number of threads that libraries take."""
    KEPT.append(np.ones(12_500_000))
    time.sleep(0.3)
    return {"pid": os.getpid(), "n_threads": os.environ.get("OMP_NUM_THREADS"), "x": x}


def content(log: str) -> dict[str, Any]:
    """Read a file."""
    return {"text": Path(log).read_text(encoding="utf-8")}


def cell(
    function: str = "double", code: str = "1", files: dict[str, DataFile] | None = None, **arguments: Any
) -> Cell:
    """Make a cell of a function of this module."""
    return Cell(
        key=f"{function} {arguments.get('x', 0.0):g}",
        function=f"{__name__}:{function}",
        code=code,
        arguments=arguments,
        files=files or {},
        kind=function,
    )


def calls(folder: Path) -> list[str]:
    """Numbers that `double` was called with."""
    path = folder / "calls"
    return (
        [line.split()[0] for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    )
