"""What all experiments share: options, and sweeps that run in parallel and can be resumed."""

import fcntl
import hashlib
import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from slammot_graph.core.errors import InputError, SlammotError

ROOT = Path(__file__).resolve().parents[1]
Cell = Mapping[str, Any]
Scores = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of every experiment.

    Attributes
    ----------
    quick : bool
        A few small cells, to see that everything works; its figures say nothing.
    seeds : int, optional
        How many paired seeds, in place of the experiment's own number.
    jobs : int
        Processes.
    data : Path, optional
        Folder of the recorded logs; by default $SLAMMOT_DATA, else ../shared/data.
    output : Path
        Where the folders results, tables and figures are.
    fresh : bool
        Forget the finished cells and compute them anew.
    """

    quick: bool = False
    seeds: int | None = None
    jobs: int = 2
    data: Path | None = None
    output: Path = ROOT / "experiments"
    fresh: bool = False

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise InputError(f"--jobs must be at least 1, not {self.jobs}")
        if self.seeds is not None and self.seeds < 1:
            raise InputError(f"--seeds must be at least 1, not {self.seeds}")

    @property
    def more_words(self) -> tuple[str, ...]:
        """Words of the command for the options that an experiment has besides these."""
        return ()

    def seed_range(self, full: int, quick: int = 2) -> range:
        """Seeds to run: `full` of them, or `quick`, or as asked for."""
        return range(self.seeds or (quick if self.quick else full))

    def recorded(self, name: str, collection: str = "freiburg") -> Path:
        """Path of a recorded log's file in one of the folders of them; InputError if it is not there."""
        path = data_folder(self.data) / collection / name
        if not path.is_file():
            raise InputError(
                f"{path}: no such recorded log; set SLAMMOT_DATA or --data to the folder of them"
            )
        return path

    def folder(self, name: str) -> Path:
        """Make and return one of the output folders."""
        path = self.output / name
        path.mkdir(parents=True, exist_ok=True)
        return path


def data_folder(data: Path | None) -> Path:
    """Folder of the recorded logs: as asked for, else $SLAMMOT_DATA, else ../shared/data."""
    named = os.environ.get("SLAMMOT_DATA")
    return data or (Path(named) if named else ROOT.parent / "shared" / "data")


def main(experiment: Callable[[Options], None], argv: list[str] | None = None) -> int:
    """Run an experiment from the command line; mistakes become one line and exit code 2."""
    try:
        options = tyro.cli(
            Options, args=argv, description=experiment.__doc__, config=(tyro.conf.FlagCreatePairsOff,)
        )
        experiment(options)
    except SlammotError as error:
        say(str(error))
        return 2
    except KeyboardInterrupt:
        say("interrupted; finished cells are kept, run the same command to go on")
        return 130
    return 0


def say(text: str) -> None:
    """One line on stderr."""
    print(" ".join(text.split()), file=sys.stderr, flush=True)


def run_cells(
    name: str, function: Callable[..., Scores], cells: Mapping[str, Cell], options: Options
) -> dict[str, Scores]:
    """Compute the cells of a sweep that are not in its results yet, and return the scores of all.

    Parameters
    ----------
    name : str
        Of the file ``results/<name>.jsonl``: one line for each finished cell, written as soon as it is.
    function : module-level function
        Takes a cell's arguments by name, returns scores that JSON can hold (NaN included).
    cells : mapping of key to arguments
        The key names everything that the scores depend on, but for the code.
    options : Options

    Raises
    ------
    InputError
        Another process writes the same results, or a cell failed; the others are kept.
    """
    path = options.folder("results") / f"{name}.jsonl"
    code = code_state()
    failed: list[str] = []
    with _locked(path), _progress(name, len(cells)) as advance:
        if options.fresh:
            path.unlink(missing_ok=True)
        finished = _read(path)
        done = {key: finished[key]["scores"] for key in cells if key in finished}
        strangers = sum(finished[key].get("code") != code for key in done)
        if strangers:
            say(
                f"{name}: {strangers} of {len(done)} finished cells are of other code; --fresh computes them anew"
            )
        advance(len(done))
        todo = {key: cell for key, cell in cells.items() if key not in done}
        with path.open("a", encoding="utf-8") as file:
            for key, outcome in _computed(function, todo, options.jobs):
                advance(1)
                if isinstance(outcome, Exception):
                    say(f"{name}: cell {key} failed: {type(outcome).__name__}: {outcome}")
                    failed.append(key)
                    continue
                done[key] = outcome
                line = {"key": key, "code": code, "scores": _strict(outcome)}
                file.write(json.dumps(line, allow_nan=False) + "\n")
                file.flush()
                os.fsync(file.fileno())
    if failed:
        raise InputError(f"{name}: {len(failed)} of {len(cells)} cells failed, the others are kept in {path}")
    return {key: done[key] for key in cells}


def code_state() -> str:
    """A fingerprint of the package's source: results of one table should have one."""
    digest = hashlib.sha1(usedforsecurity=False)
    for path in sorted((ROOT / "slammot_graph").rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


def _computed(
    function: Callable[..., Scores], cells: Mapping[str, Cell], jobs: int
) -> Iterator[tuple[str, Scores | Exception]]:
    """Scores of the cells, or what went wrong, in the order in which they finish."""
    if jobs == 1 or len(cells) < 2:
        for key, cell in cells.items():
            try:
                yield key, function(**cell)
            except Exception as err:  # the other cells go on; run_cells reports it
                yield key, err
        return
    executor = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
    futures: dict[Future[Scores], str] = {}
    try:
        for key, cell in cells.items():
            futures[executor.submit(function, **cell)] = key
        for future in as_completed(futures):
            error = future.exception()
            if error is not None and not isinstance(error, Exception):
                raise error
            yield futures[future], error or future.result()
    finally:
        executor.shutdown(cancel_futures=True)


def _read(path: Path) -> dict[str, Any]:
    """Finished cells; a half-written last line is cut off and reported."""
    if not path.exists():
        return {}
    content = path.read_bytes()
    end = content.rfind(b"\n") + 1
    if end < len(content):
        say(f"{path}: the last line is half written; its cell is computed again")
        with path.open("r+b") as file:
            file.truncate(end)
    finished: dict[str, Any] = {}
    for number, line in enumerate(content[:end].splitlines(), start=1):
        try:
            record = json.loads(line)
            record["scores"] = _with_nan(record["scores"])
            finished[record["key"]] = record
        except (ValueError, KeyError, TypeError, AttributeError):
            say(f"{path}, line {number}: not a finished cell; it is computed again")
    return finished


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Keep other processes from writing the same results."""
    with path.with_suffix(".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{path}: another process is writing these results; wait for it") from None
        yield


@contextmanager
def _progress(name: str, n_cells: int) -> Iterator[Callable[[int], None]]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("cells"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(name, total=n_cells)
        yield lambda n: bar.advance(task, n)


def _strict(value: Any) -> Any:
    """Scores for strict JSON: what is not finite becomes null."""
    if isinstance(value, dict):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _with_nan(scores: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _with_nan(value) if isinstance(value, dict) else math.nan if value is None else value
        for key, value in scores.items()
    }
