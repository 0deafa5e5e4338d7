"""Finished cells on disk: lines of JSON in a folder, one file for each process that writes.

A line is written as soon as its cell is finished; whatever ends the process, the finished cells are there. Several
processes (the parts of a Slurm array) write files of their own into one folder and read all.
"""

import fcntl
import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from slammot_graph.core.errors import InputError
from slammot_graph.core.strict_json import strict_json
from slammot_graph.study.cells import Cell, Outcome, Scores

_SYNC_S = 1.0
"""A power failure costs the cells of this time at most."""


class CellStore:
    """The finished cells of a folder.

    Parameters
    ----------
    folder : Path
        Is made when something is written.
    shard : str
        Name of the file of this process, without ending.
    everybody : bool
        Read the files of other processes too.
    """

    def __init__(self, folder: Path, shard: str = "cells", *, everybody: bool = True) -> None:
        self.folder = folder
        self.path = folder / f"{shard}.jsonl"
        self._pattern = "*.jsonl" if everybody else self.path.name
        self.remarks: list[str] = []
        self._file: IO[str] | None = None
        self._failed: IO[str] | None = None
        self._synced = 0.0

    def records(self) -> dict[str, dict[str, Any]]:
        """Finished cells by their digests, of all files; what is no such line is told of in `remarks`."""
        found: dict[str, dict[str, Any]] = {}
        bad: list[str] = []
        for path in sorted(self.folder.glob(self._pattern)):
            for number, line in enumerate(path.read_bytes().split(b"\n"), start=1):
                if not line:
                    continue
                try:
                    record = json.loads(line)
                    record["scores"] = _with_nan(record["scores"])
                    found[record["cell"]] = record
                except (ValueError, KeyError, TypeError, AttributeError):
                    bad.append(f"{path}, line {number}: not a finished cell; it is computed again")
        self.remarks += bad[:3]
        if len(bad) > 3:
            self.remarks.append(
                f"{self.folder}: and {len(bad) - 3} more such lines, perhaps of an earlier release"
            )
        return found

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Lock this process's file and hold it open.

        Raises
        ------
        InputError
            Another process writes it, or it cannot be written.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = self.path.with_suffix(".lock").open("w")
        except OSError as error:
            raise InputError(
                f"{self.folder}: cannot be written ({error.strerror}); name another --output"
            ) from None
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(
                    f"{self.path}: another process is writing these results; wait for it"
                ) from None
            self._cut_half_line()
            failed = self.path.with_suffix(".failed")
            with (
                self.path.open("a", encoding="utf-8") as self._file,
                failed.open("w", encoding="utf-8") as self._failed,
            ):
                try:
                    yield
                finally:
                    os.fsync(self._file.fileno())
            self._file = self._failed = None
            if not failed.stat().st_size:
                failed.unlink()

    def write(self, outcome: Outcome) -> Scores:
        """Keep a finished cell; returns its scores as a later reading gives them."""
        assert self._file is not None
        line = {
            "cell": outcome.cell.digest,
            "key": outcome.cell.key,
            "code": outcome.cell.code,
            "scores": strict_json(outcome.scores),
            "seconds": round(outcome.seconds, 4),
            "host": outcome.host,
        }
        text = json.dumps(line, allow_nan=False)
        self._file.write(text + "\n")
        self._file.flush()
        if time.monotonic() - self._synced > _SYNC_S:
            os.fsync(self._file.fileno())
            self._synced = time.monotonic()
        scores: Scores = _with_nan(json.loads(text)["scores"])
        return scores

    def write_error(self, outcome: Outcome) -> None:
        """Keep why a cell failed, until this file is written the next time."""
        assert self._failed is not None
        self._failed.write(json.dumps({"cell": outcome.cell.digest, "error": outcome.error}) + "\n")
        self._failed.flush()

    def errors(self) -> dict[str, str]:
        """Errors of the cells that failed when each file was written last, by digest."""
        found = {}
        for path in sorted(self.folder.glob(Path(self._pattern).with_suffix(".failed").name)):
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    record = json.loads(line)
                    found[str(record["cell"])] = str(record["error"])
                except (ValueError, KeyError, TypeError):
                    continue  # half a line of another process
        return found

    def forget(self, cells: Iterable[Cell]) -> None:
        """Leave cells out of all files of the folder, to compute them anew; only while it is being written."""
        assert self._file is not None
        digests = {cell.digest for cell in cells}
        for path in sorted(self.folder.glob(self._pattern)):
            kept = [
                line for line in path.read_bytes().splitlines(keepends=True) if _digest(line) not in digests
            ]
            with path.open("r+b") as file:
                file.writelines(kept)
                file.truncate()

    def _cut_half_line(self) -> None:
        if not self.path.exists():
            return
        content = self.path.read_bytes()
        end = content.rfind(b"\n") + 1
        if end < len(content):
            self.remarks.append(f"{self.path}: the last line is half written; its cell is computed again")
            with self.path.open("r+b") as file:
                file.truncate(end)


def split(
    cells: Sequence[Cell], records: dict[str, dict[str, Any]]
) -> tuple[dict[str, dict[str, Any]], list[Cell]]:
    """Records of the cells that are finished, by digest, and the cells that are not, each once."""
    done = {cell.digest: records[cell.digest] for cell in cells if cell.digest in records}
    todo = {cell.digest: cell for cell in cells if cell.digest not in records}
    return done, list(todo.values())


def _digest(line: bytes) -> str | None:
    try:
        return str(json.loads(line)["cell"])
    except (ValueError, KeyError, TypeError):
        return None


def _with_nan(value: Any) -> Any:
    """Turn null back into NaN."""
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    return math.nan if value is None else value
