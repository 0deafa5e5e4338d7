"""The folder itself: which files belong to a run, and how a new run gets an empty one."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slammot_graph.core.errors import InputError
from slammot_graph.run_folder.atomic import temporary_path, write_errors
from slammot_graph.run_folder.checkpoint import CHECKPOINT_FILE, SCANS_FILE
from slammot_graph.run_folder.lock import LOCK_FILE, folder_lock
from slammot_graph.run_folder.recording import cut_to_whole_messages

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
no ``run.rrd``. Of a run that went on there may be earlier parts of the recording, ``run.1.rrd`` and so on."""

ALL_FILES = (*RUN_FILES, "closures.csv")
"""With those of a merged map."""

PARTIAL_FILES = ("trajectory.tum", "summary.json", "graph.g2o")
"""What a checkpoint writes of the results."""

_OWN_FILES = (*ALL_FILES, CHECKPOINT_FILE, SCANS_FILE)
"""And what a run leaves there that has not ended."""

_FIRST_FILES = (
    "run.rrd",
    "trajectory.tum",
    "map.slam",
    CHECKPOINT_FILE,
)  # an interrupted run leaves one of them, or a file under its temporary name


@contextmanager
def claimed_output(output: str | Path, *, overwrite: bool, resume: bool = False) -> Iterator[None]:
    """Make an empty run folder as `prepare_output` does, which no other run may write into meanwhile.

    With `resume` the files of a run that is already there stay.

    Raises
    ------
    InputError
        As of `prepare_output`; or another run writes into it.
    """
    output = Path(output)
    _check_output(output, overwrite=overwrite or resume)
    with folder_lock(output):
        if not resume:
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
        for name in _OWN_FILES:
            (output / name).unlink(missing_ok=True)
            temporary_path(output / name).unlink(missing_ok=True)
        for path in recording_parts(output):
            path.unlink()


def clear_later_results(output: Path) -> None:
    """Remove what a partial run does not have: of more scans, as an interrupted run leaves it whose end was written.

    Raises
    ------
    InputError
        A file cannot be removed.
    """
    with write_errors(output, "remove it yourself, or name another --output"):
        for name in RUN_FILES:
            if name not in PARTIAL_FILES and name != "run.rrd":
                (output / name).unlink(missing_ok=True)


def recording_parts(output: Path) -> list[Path]:
    """Give the earlier parts of the recording of a run that went on, in their order."""
    numbered = [
        (int(path.name[4:-4]), path) for path in output.glob("run.*.rrd") if path.name[4:-4].isdecimal()
    ]
    return [path for _, path in sorted(numbered)]


def keep_recording(output: Path) -> None:
    """Let what is recorded so far, up to its last whole message, be a part beside which the rest is recorded.

    Raises
    ------
    InputError
        It cannot be cut or renamed.
    """
    path = output / "run.rrd"
    with write_errors(path, "remove it yourself, or name another --output"):
        if path.exists():
            cut_to_whole_messages(path)
        if path.exists():
            path.rename(output / f"run.{len(recording_parts(output)) + 1}.rrd")


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
        begun = {temporary_path(output / name).name for name in _OWN_FILES}
        begun.update(path.name for path in recording_parts(output))
        return begun.union(_OWN_FILES).issuperset(names) and bool(
            begun.union(_FIRST_FILES).intersection(names)
        )
    return isinstance(summary, dict) and {"method", "n_scans"} <= summary.keys()
