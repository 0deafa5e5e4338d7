"""The folder itself: which files belong to a run, and how a new run gets an empty one."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slammot_graph.core.errors import InputError
from slammot_graph.run_folder.atomic import temporary_path, write_errors
from slammot_graph.run_folder.lock import LOCK_FILE, folder_lock

RUN_FILES = (
    "trajectory.tum",
    "points.npz",
    "tracks.csv",
    "tracks_online.csv",
    "map.pgm",
    "map.yaml",
    "graph.g2o",
    "map.slam",
    "covariances.npz",
    "run.rrd",
    "overview.png",
    "summary.json",
)
"""All that a run folder may hold; without a graph there is no ``graph.g2o`` and no ``map.slam``, without a recording
no ``run.rrd``."""

ALL_FILES = (*RUN_FILES, "closures.csv")
"""With those of a merged map."""

_FIRST_FILES = (
    "run.rrd",
    "trajectory.tum",
    "map.slam",
)  # an interrupted run leaves one of them, or a file under its temporary name


@contextmanager
def claimed_output(output: str | Path, *, overwrite: bool) -> Iterator[None]:
    """Make an empty run folder as `prepare_output` does, which no other run may write into meanwhile.

    Raises
    ------
    InputError
        As of `prepare_output`; or another run writes into it.
    """
    output = Path(output)
    _check_output(output, overwrite=overwrite)
    with folder_lock(output):
        prepare_output(output, overwrite=overwrite)
        yield


def prepare_output(output: str | Path, *, overwrite: bool) -> None:
    """Make an empty run folder, with the folders above it.

    Parameters
    ----------
    output : str or Path
    overwrite : bool
        Remove the files of a run that is already there; other files in the folder stay.

    Raises
    ------
    InputError
        `output` is a file, holds a run and `overwrite` is not set, holds something that is no run, or cannot be
        written.
    """
    output = Path(output)
    _check_output(output, overwrite=overwrite)
    with write_errors(output, "remove it yourself, or name another --output"):
        for name in ALL_FILES:
            (output / name).unlink(missing_ok=True)
            temporary_path(output / name).unlink(missing_ok=True)


def _check_output(output: Path, *, overwrite: bool) -> None:
    """Make a folder where there is none, and refuse one that must not be written into."""
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file, not a folder; name another --output")
    with write_errors(output, "name another --output"):
        output.mkdir(parents=True, exist_ok=True)
        names = sorted(path.name for path in output.iterdir() if path.name != LOCK_FILE)
    if names and not _is_run_folder(output, names):
        raise InputError(
            f"{output}: holds {names[0]!r} and is no run folder; name a new or an empty folder as --output"
        )
    if names and not overwrite:
        raise InputError(
            f"{output}: holds a run already; pass --overwrite (overwrite=True) to replace it,"
            " or name another --output"
        )
    if not os.access(output, os.W_OK | os.X_OK):
        raise InputError(f"{output}: cannot be written (Permission denied); name another --output")


def _is_run_folder(output: Path, names: list[str]) -> bool:
    """Whether a run was written here, or interrupted before its summary."""
    try:
        summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        begun = {temporary_path(output / name).name for name in ALL_FILES}
        return begun.union(ALL_FILES).issuperset(names) and bool(
            begun.union(_FIRST_FILES).intersection(names)
        )
    return isinstance(summary, dict) and {"method", "n_scans"} <= summary.keys()
