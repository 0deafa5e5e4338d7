"""What all experiments share: options, and sweeps that run in parallel and can be resumed."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from slammot_graph.core.errors import InputError, SlammotError
from slammot_graph.study.cells import Cell, Outcome, Scores
from slammot_graph.study.code_version import package_version, version_of
from slammot_graph.study.data_files import data_file
from slammot_graph.study.processes import local_workers
from slammot_graph.study.store import CellStore
from slammot_graph.study.study_run import Progress, finish_cells

ROOT = Path(__file__).resolve().parents[1]
Arguments = Mapping[str, Any]
__all__ = [
    "ROOT",
    "Arguments",
    "Options",
    "Scores",
    "code_state",
    "data_folder",
    "environment_of_checkout",
    "main",
    "run_cells",
    "say",
    "version_of",
]


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


def environment_of_checkout() -> dict[str, str]:
    """Environment in which a program started by an experiment imports this checkout."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, "PYTHONPATH": path}


def say(text: str) -> None:
    """One line on stderr."""
    print(" ".join(text.split()), file=sys.stderr, flush=True)


def run_cells(
    name: str, function: Callable[..., Scores], cells: Mapping[str, Arguments], options: Options
) -> dict[str, Scores]:
    """Compute the cells of a sweep that are not in its results yet, and return the scores of all.

    The loop, its processes and its store are those of `slammot-graph study`: a cell is addressed by its function, its
    arguments, the content of the files among them, and the version of the code that it runs.

    Parameters
    ----------
    name : str
        Of the file ``results/<name>.jsonl``: one line for each finished cell, written as soon as it is.
    function : module-level function
        Takes a cell's arguments by name, returns scores that JSON can hold (NaN included).
    cells : mapping of key to arguments
        The key is for people.
    options : Options

    Raises
    ------
    InputError
        Another process writes the same results, or a cell failed; the others are kept.
    """
    place = f"{_module_of(function)}:{function.__qualname__}"
    code = version_of(place)
    planned = {key: _cell(key, place, code, arguments) for key, arguments in cells.items()}
    store = CellStore(options.folder("results"), name, everybody=False)
    progress = Progress()
    with _bar(name, progress) as told:
        records, errors = finish_cells(
            list(planned.values()),
            store,
            lambda: local_workers(options.jobs if len(cells) > 1 else 1),
            progress=progress,
            told=told,
            fresh=options.fresh,
        )
    for remark in store.remarks:
        say(remark)
    for key, cell in planned.items():
        if cell.digest in errors:
            say(f"{name}: cell {key} failed: {errors[cell.digest]}")
    if errors:
        raise InputError(
            f"{name}: {len(errors)} of {len(cells)} cells failed, the others are kept in {store.path}"
        )
    return {key: records[cell.digest]["scores"] for key, cell in planned.items()}


def _module_of(function: Callable[..., Scores]) -> str:
    """Name by which other processes import a function's module: of the program that runs it is not `__main__`."""
    spec = sys.modules[function.__module__].__spec__
    return function.__module__ if spec is None else spec.name


def _cell(key: str, function: str, code: str, arguments: Arguments) -> Cell:
    """Arguments that are paths of files count by the content of these."""
    files = {
        name: data_file(Path(value))
        for name, value in arguments.items()
        if isinstance(value, str) and os.sep in value and Path(value).is_file()
    }
    plain = {name: value for name, value in arguments.items() if name not in files}
    return Cell(
        key=key,
        function=function,
        code=code,
        arguments=plain,
        files=files,
        kind=key.rsplit(" ", maxsplit=1)[-1],
    )


def code_state() -> str:
    """Version of the package's code: results of one table should have one."""
    return package_version()[:16]


@contextmanager
def _bar(name: str, progress: Progress) -> Iterator[Callable[[Outcome | None], None]]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("cells"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(name, total=None)

        def told(_: Outcome | None) -> None:
            n_done = sum(progress.done.values()) + sum(progress.failed.values())
            bar.update(task, total=progress.n_cells, completed=n_done)

        yield told
