"""What all commands say and how: exit codes, consoles, progress, warnings, cells of tables."""

import contextlib
import math
import os
import shlex
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.core.findings import Finding
    from slammot_graph.core.odometry_report import Estimated, OdometryReport
    from slammot_graph.evaluation import ErrorStats
    from slammot_graph.logs import LaserLog

EXIT_OK, EXIT_FOUND, EXIT_USER_ERROR, EXIT_INTERRUPTED = 0, 1, 2, 130
PROGRAM = "slammot-graph"
N_REASONS = 3
"""So many skipped scans and warnings are shown; the rest is counted."""


def stdout() -> Console:
    """Give the console for what was asked for."""
    return _console(sys.stdout)


def stderr() -> Console:
    """Give the console for progress, warnings and errors."""
    return _console(sys.stderr)


def _console(file: TextIO) -> Console:
    console = Console(file=file, markup=False, highlight=False, emoji=False)
    if not console.is_terminal:  # a file has no width: long paths stay on their line
        console.width = 200
    return console


def complain(text: str) -> int:
    """Say in one line what a user should mend, and give the exit code for it."""
    stderr().print(f"{PROGRAM}: {' '.join(text.split())}", soft_wrap=True)
    return EXIT_USER_ERROR


def check_max_scans(max_scans: int | None) -> None:
    """Refuse a number of scans that is no number of scans."""
    if max_scans is not None and max_scans < 1:
        raise InputError(f"--max-scans must be at least 1, not {max_scans}")


def command(*words: object) -> str:
    """Write a command of this program as a person here can give it.

    Where ``slammot-graph`` is not on the path, it is named as it was started, relative to the current folder if
    it lies below it.
    """
    return shlex.join([*_program(), *map(str, words)])


def _program() -> list[str]:
    started = Path(sys.argv[0])
    if shutil.which(PROGRAM):
        return [PROGRAM]
    if started.name == "__main__.py" and started.parent.name == "slammot_graph":
        return [_from_here(Path(sys.executable)), "-m", "slammot_graph"]
    return [_from_here(started)] if started.stem == PROGRAM else [PROGRAM]


def _from_here(path: Path) -> str:
    """A program's path, relative to the current folder if it lies below it."""
    path, here = path.absolute(), Path.cwd()
    if not path.is_relative_to(here):
        return str(path)
    relative = path.relative_to(here)
    return str(relative) if len(relative.parts) > 1 else os.path.join(".", relative)  # noqa: PTH118 - keeps "./"


def warn(log: "LaserLog", warnings: Sequence[str] | None = None) -> None:
    """Show what the last iteration over a log brought to light; `warnings` in place of the log's."""
    console = stderr()
    skipped = [f"{scan.place} skipped: {scan.reason}" for scan in log.skipped]
    told = log.warnings if warnings is None else warnings
    for texts, what in ((told, "warnings"), (skipped, "skipped scans")):
        for text in texts[:N_REASONS]:
            console.print(f"warning: {log.path}: {text}", soft_wrap=True)
        if len(texts) > N_REASONS:
            console.print(f"warning: {log.path}: and {len(texts) - N_REASONS} more {what}", soft_wrap=True)


def warn_of(log: "LaserLog", findings: "Iterable[Finding]") -> None:
    """Show what is wrong, a line each; what is but worth knowing stands in the table alone."""
    for finding in findings:
        if finding.severity != "info":
            stderr().print(f"{finding.severity}: {log.path}: {finding.text}", soft_wrap=True)


def odometry_rows(report: "OdometryReport") -> dict[str, str]:
    """Rows of a table that say what is known of the odometry; what the drive does not tell is left out."""
    if not report.has_odometry:
        return {"odometry": "none, predicted by the previous motion"}
    figures = (
        ("clock offset", report.clock_offset_s, "s"),
        ("distance scale", report.distance_scale, ""),
        ("heading scale", report.heading_scale, ""),
        ("heading bias", report.heading_bias_rad_per_m, "rad/m"),
        ("direction", report.direction_rad, "rad"),
        ("laser shift, x", report.laser_shift_x_m, "m"),
        ("laser shift, y", report.laser_shift_y_m, "m"),
        ("noise scale", report.noise_scale_m, "of the translation"),
        ("noise scale", report.noise_scale_rad, "of the rotation"),
    )
    known = [
        f"{name} {_with_std(value)} {unit}".rstrip()
        for name, value, unit in figures
        if math.isfinite(value.std)
    ]
    return {"odometry": "\n".join(known)} if known else {}


def source_rows(source: "Mapping[str, Any]") -> dict[str, str]:
    """Rows of a table that say what of the log is used."""
    rows = {key.replace("_", " "): str(source[key]) for key in ("scan_topic", "odom_topic") if key in source}
    if "laser_pose" in source:
        pose = " ".join(f"{value:.6g}" for value in source["laser_pose"])
        rows["laser pose"] = f"{pose} (x y yaw [m, m, rad]; {source['laser_pose_from']})"
    return rows


def _with_std(estimated: "Estimated") -> str:
    """Write a number with as many decimals as its standard deviation has a say in."""
    n_decimals = 3 if estimated.std <= 0.0 else min(max(1 - math.floor(math.log10(estimated.std)), 0), 6)
    return f"{estimated.value:.{n_decimals}f} +- {estimated.std:.{n_decimals}f}"


@contextlib.contextmanager
def printed_deprecations() -> Iterator[None]:
    """Print what is deprecated within the block, a line each."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DeprecationWarning)
        try:
            yield
        finally:
            for warning in caught:
                stderr().print(f"warning: {warning.message}", soft_wrap=True)


def scan_progress(
    log: "LaserLog", method: str, max_scans: int | None = None
) -> contextlib.AbstractContextManager[Callable[[int], None]]:
    """Show how many scans of a log a method has done; skipped ones count as done. The log's length may be unknown."""
    limits = [n for n in (log.n_scans, max_scans) if n is not None]
    total = min(limits) if limits else None
    return progress(f"{method} on {log.path.name}", total, "scans", passed_over=log.skipped)


@contextlib.contextmanager
def progress(
    label: str, total: int | None, what: str, *, passed_over: Sized = ()
) -> Iterator[Callable[[int], None]]:
    """Show how many are done: a bar, or where nobody watches a line at the start and one at the end.

    Parameters
    ----------
    label : str
    total : int or None
        None where nobody knows.
    what : str
        What is counted, in the plural.
    passed_over : sized
        What needs no work and may grow meanwhile.

    Yields
    ------
    callable
        To be told how many are done.
    """
    console = stderr()
    if console.is_terminal:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn(what),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(label, total=total)
            yield lambda n: bar.update(task, completed=n + len(passed_over))
        return
    n_done, start = 0, time.monotonic()

    def count(n: int) -> None:
        nonlocal n_done
        n_done = n

    console.print(f"{label}: {what if total is None else f'{total} {what}'}", soft_wrap=True)
    yield count
    console.print(f"{label}: {n_done} {what} in {time.monotonic() - start:.1f} s", soft_wrap=True)


def figure_table(title: str, first: str, *others: str, no_wrap: bool = False) -> Table:
    """Make an empty table with names on the left and figures on the right."""
    table = Table(title=title)
    table.add_column(first, no_wrap=no_wrap)
    for heading in others:
        table.add_column(heading, justify="right", no_wrap=no_wrap)
    return table


def print_table(table: Table) -> None:
    """Print a table of many columns, closer together where the terminal is narrow."""
    console = stdout()
    needed = Measurement.get(console, console.options.update(width=1000), table).minimum
    if needed > console.width:
        table.padding = 0
    console.print(table)


def mean_and_std(stats: "ErrorStats") -> str:
    """Write both, with four decimals."""
    return f"{number(stats.mean, 4)} +- {number(stats.std, 4)}"


def number(value: float, n_decimals: int) -> str:
    """Write a number; a dash where it is not known."""
    return "-" if math.isnan(value) else f"{value:.{n_decimals}f}"
