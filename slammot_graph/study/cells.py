"""Cells: what is computed once, addressed by everything that its scores depend on."""

import hashlib
import importlib
import json
import platform
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from slammot_graph.core.strict_json import strict_json
from slammot_graph.study.code_version import version_of
from slammot_graph.study.data_files import DataFile, MissingDataError, find

Scores = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One computation of a study.

    Attributes
    ----------
    key : str
        For people: unique within its study.
    function : str
        "module:name" of what computes it; takes the arguments by name, returns scores that JSON can hold.
    arguments : mapping
        Plain values that JSON can hold.
    files : mapping
        Arguments that are files; the function gets the path on its machine.
    code : str
        Version of the code, see `code_version.version_of`.
    group : str
        Cells of one group share their input: they are computed one after the other in one process.
    kind : str
        Cells of one kind take about as long.
    digest : str
        Address: of function, arguments, contents of the files and version of the code.
    """

    key: str
    function: str
    arguments: Mapping[str, Any]
    files: Mapping[str, DataFile] = field(default_factory=dict)
    code: str
    group: str = ""
    kind: str = ""
    digest: str = ""

    def __post_init__(self) -> None:
        if not self.digest:
            object.__setattr__(self, "digest", self._address())

    def _address(self) -> str:
        content = {
            "function": self.function,
            "arguments": strict_json(self.arguments),
            "files": {name: file.digest for name, file in self.files.items()},
            "code": self.code,
        }
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:32]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a cell.

    Attributes
    ----------
    cell : Cell
    scores : dict or None
        None: it failed.
    error : str
        Why, in one line.
    missing : DataFile or None
        A file that its machine did not have.
    seconds : float
        Wall time of the computation.
    host : str
        The machine that computed it.
    """

    cell: Cell
    scores: Scores | None = None
    error: str = ""
    missing: DataFile | None = None
    seconds: float = 0.0
    host: str = ""


Task = Sequence[Cell]
"""Cells that one process computes one after the other."""


def run_task(task: Task, *, check_code: bool = True) -> list[Outcome]:
    """Compute cells, on whatever machine this is; what goes wrong with one does not touch the others."""
    return [_outcome(cell, check_code) for cell in task]


def _outcome(cell: Cell, check_code: bool) -> Outcome:
    start, host = time.perf_counter(), platform.node()
    scores, error, missing = None, "", None
    try:
        if check_code and version_of(cell.function) != cell.code:
            raise RuntimeError(
                f"the worker {host} has other code than the study was planned with; install the same version there"
            )
        module, _, name = cell.function.partition(":")
        function = getattr(importlib.import_module(module), name)
        paths = {argument: str(find(file)) for argument, file in cell.files.items()}
        scores = function(**{**cell.arguments, **paths})
    except MissingDataError as err:
        error, missing = str(err), err.file
    except Exception as err:  # the other cells go on; the study reports it
        error = f"{type(err).__name__}: {_one_line(err)}{_place(err)}"
    return Outcome(
        cell=cell,
        scores=scores,
        error=error,
        missing=missing,
        seconds=time.perf_counter() - start,
        host=host,
    )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:500]


def _place(error: Exception) -> str:
    """Where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    return f" ({frames[-1].filename.rsplit('/', 1)[-1]}, line {frames[-1].lineno})" if len(frames) > 1 else ""
