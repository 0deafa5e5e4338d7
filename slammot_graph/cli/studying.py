"""The commands for many runs: `study` and `report`."""

import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.live import Live
from rich.table import Table

from slammot_graph.cli.console import EXIT_OK, stderr, stdout
from slammot_graph.core.errors import ConfigError

if TYPE_CHECKING:
    from slammot_graph.study.cells import Outcome
    from slammot_graph.study.runner import Workers
    from slammot_graph.study.study_run import Progress

EXIT_SOME_FAILED = 1
MOST_LINES = 30
"""Of the progress table."""
_TELL_EVERY_S = 60.0


def study_command(
    study: Annotated[Path, tyro.conf.arg(metavar="STUDY.toml|paper")],
    /,
    *,
    output: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    quick: bool = False,
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None,
    part: Annotated[str | None, tyro.conf.arg(metavar="I/N")] = None,
) -> int:
    """Run logs and scenarios x methods x overrides x seeds; what is finished is not computed again.

    Writes results.csv and results.parquet, and a report. Exit code 1 if some runs failed (failed.csv).

    Parameters
    ----------
    study
        The file that says what to run, or a study of the package: paper.
    output
        Folder of the results; by default runs/ and the study's name.
    quick
        Few seeds and worlds, as the study says.
    jobs
        Processes; by default one for each core.
    scheduler
        Compute on the workers of this Dask scheduler, as tcp://host:8786.
    part
        Compute the I-th of N parts, as a job of a Slurm array; all write into one folder.
    """
    from slammot_graph.study.plan import plan
    from slammot_graph.study.report_page import write_report
    from slammot_graph.study.results import origin_of
    from slammot_graph.study.study_file import quick as quick_of
    from slammot_graph.study.study_file import read_study, study_path
    from slammot_graph.study.study_run import Progress, run_study

    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs must be at least 1, not {jobs}")
    if jobs is not None and scheduler is not None:
        raise ConfigError("--jobs and --scheduler exclude each other: the workers of a scheduler are its own")
    which = None if part is None else _part(part)
    file = study_path(study)
    chosen = read_study(study)
    chosen = quick_of(chosen) if quick else chosen
    folder = output or Path("runs") / file.stem
    rows = plan(chosen, file.parent, source=str(file))
    origin = origin_of(chosen.title or file.stem) | {
        "reference": chosen.reference or chosen.methods[0],
        "measures": list(chosen.measures),
        "quick": quick,
    }
    progress = Progress()
    with _shown(file.stem, progress) as told:
        errors = run_study(
            rows,
            folder,
            origin,
            lambda: _workers(jobs or os.cpu_count() or 1, scheduler),
            part=which,
            progress=progress,
            told=told,
        )
    if chosen.pictures and which is None:
        from slammot_graph.study.pictures import draw_pictures

        draw_pictures(rows, chosen.pictures, folder)
    for key, error in list(errors.items())[:5]:
        stderr().print(f"failed: {key}: {error}", soft_wrap=True)
    if errors:
        stderr().print(
            f"{len(errors)} of {progress.n_cells} cells failed; all are in {folder / 'failed.csv'}; the same command"
            " tries them again",
            soft_wrap=True,
        )
    if which is not None:
        stdout().print(
            f"part {part}: {folder / 'cells'}; all parts together: the same command without --part",
            soft_wrap=True,
        )
    elif sum(progress.done.values()):
        page = write_report(folder)
        stdout().print(f"results: {folder / 'results.csv'}\nreport: {page}", soft_wrap=True)
    return EXIT_SOME_FAILED if errors else EXIT_OK


def report_command(directory: Annotated[Path, tyro.conf.arg(metavar="DIR")], /) -> int:
    """Make tables (Markdown, LaTeX), figures and a page of a study's results.

    Parameters
    ----------
    directory
        The --output of a study.
    """
    from slammot_graph.study.report_page import write_report

    stdout().print(f"report: {write_report(directory)}", soft_wrap=True)
    return EXIT_OK


def _part(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)/(\d+)", text)
    if match is None or not 1 <= int(match[1]) <= int(match[2]):
        raise ConfigError(f"--part must be I/N with I from 1 to N, as 3/10, not {text}")
    return int(match[1]), int(match[2])


def _workers(jobs: int, scheduler: str | None) -> "Workers":
    if scheduler is None:
        from slammot_graph.study.processes import local_workers

        return local_workers(jobs)
    from slammot_graph.study.dask_workers import DaskWorkers

    return DaskWorkers(scheduler)


@contextmanager
def _shown(name: str, progress: "Progress") -> Iterator[Callable[["Outcome | None"], None]]:
    """Show a table that is kept up to date; where nobody watches, a line now and then."""
    console, start = stderr(), time.monotonic()
    if console.is_terminal:
        with Live(_table(name, progress), console=console, refresh_per_second=4, transient=True) as live:
            yield lambda _: live.update(_table(name, progress))
        console.print(_line(name, progress), soft_wrap=True)
        return
    last = -_TELL_EVERY_S

    def told(outcome: "Outcome | None") -> None:
        nonlocal last
        if outcome is None or time.monotonic() - last > _TELL_EVERY_S:
            last = time.monotonic()
            console.print(_line(name, progress), soft_wrap=True)

    yield told
    console.print(f"{_line(name, progress)}, {time.monotonic() - start:.1f} s", soft_wrap=True)


def _line(name: str, progress: "Progress") -> str:
    done, failed = sum(progress.done.values()), sum(progress.failed.values())
    left = _time(progress.seconds_left) if sum(progress.left.values()) else ""
    return f"{name}: {done} of {progress.n_cells} cells done, {failed} failed{left and f', {left} left'}"


def _table(name: str, progress: "Progress") -> Table:
    """A line for each kind of cell, those that are not finished first."""
    table = Table(title=_line(name, progress))
    table.add_column("world, method, override")
    for heading in ("done", "failed", "left", "each"):
        table.add_column(heading, justify="right")
    kinds = list(dict.fromkeys([*progress.left, *progress.done, *progress.failed]))
    kinds.sort(key=lambda kind: not progress.left[kind])
    for kind in kinds[:MOST_LINES]:
        each = progress.times.expected(kind) if kind in progress.times.count else None
        counts = (progress.done[kind], progress.failed[kind], progress.left[kind])
        table.add_row(kind.strip(), *map(str, counts), "" if each is None else f"{each:.2f} s")
    if len(kinds) > MOST_LINES:
        table.add_row(f"and {len(kinds) - MOST_LINES} more", "", "", "", "")
    return table


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "unknown time"
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
