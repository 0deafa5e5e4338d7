"""The commands that show a run: `view` and `animate`."""

import math
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from slammot_graph.cli.console import EXIT_OK, command, progress, stderr
from slammot_graph.cli.files import prepare_file
from slammot_graph.cli.reading import ScanTopics, Topic, open_log_of_run
from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.core.saved_run import RunFolder
    from slammot_graph.viz.animation import Kind

MAX_FRAMES = {".gif": 100, ".mp4": 1000}
"""So many frames are made of a run unless --every says otherwise."""
MAX_GIF_FPS = 50.0
"""Browsers show faster ones slowly."""


def view_command(directory: Annotated[Path, tyro.conf.arg(metavar="DIR")], /) -> int:
    """Open the recording of a run in the rerun viewer.

    Parameters
    ----------
    directory
        The run folder, or a recording that `slammot-graph compare` wrote.
    """
    path = directory if directory.suffix == ".rrd" else directory / "run.rrd"
    if not path.is_file():
        if path != directory and directory.is_dir():
            raise InputError(f"{path}: no such recording; run it again without --rerun off")
        raise InputError(f"{directory}: no such run folder or recording; check the path")

    from slammot_graph.run_folder.directory import recording_parts
    from slammot_graph.viz.rerun.primitives import viewer_executable

    viewer = viewer_executable()
    if viewer is None:
        raise InputError("no rerun viewer in this environment; pip install rerun-sdk")
    nowhere = subprocess.DEVNULL  # the viewer talks a lot
    parts = recording_parts(directory) if path != directory else []
    code = subprocess.run([viewer, *parts, path], check=False, stdout=nowhere, stderr=nowhere).returncode
    if code != 0:
        advice = f"copy {path.name} to a machine with a display"
        if path != directory:
            advice += f", or make a moving picture: {command('animate', directory, '--output', 'run.gif')}"
        raise InputError(f"{path}: the rerun viewer ended with code {code}; {advice}")
    return EXIT_OK


def animate_command(
    directory: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(metavar="FILE.gif|mp4")],
    log: Annotated[Path | None, tyro.conf.arg(metavar="LOG")] = None,
    fps: Annotated[float, tyro.conf.arg(metavar="N")] = 10.0,
    every: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    first: Annotated[int, tyro.conf.arg(metavar="N")] = 1,
    last: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    scan_topic: ScanTopics = None,
    odom_topic: Topic = None,
) -> int:
    """Make a moving picture of a run.

    Parameters
    ----------
    directory
        The run folder.
    output
        The .gif or .mp4 to write; an .mp4 needs ffmpeg.
    log
        The log that was run, where it is no longer where the run folder says.
    fps
        Frames per second.
    every
        Show one scan in so many; by default as makes at most 100 frames of a .gif, 1000 of an .mp4.
    first
        The first scan that is shown, counted from 1.
    last
        The last scan that is shown.
    scan_topic
        As for `slammot-graph run`; by default that of the run.
    odom_topic
        As for `slammot-graph run`; by default that of the run.
    """
    kind = _kind(output)
    if not 0.0 < fps < math.inf:
        raise InputError(f"--fps must be a positive number, not {fps:g}")
    if kind == "gif" and fps > MAX_GIF_FPS:
        raise InputError(f"--fps must be at most {MAX_GIF_FPS:g} for a .gif, not {fps:g}")

    from slammot_graph.run_folder.atomic import atomic_path
    from slammot_graph.run_folder.reader import read_run_folder
    from slammot_graph.viz.animation import find_ffmpeg, write_animation

    if kind == "mp4":
        find_ffmpeg()
    folder = read_run_folder(directory)
    rows = _rows(len(folder.stamps), first, last, every, max_frames=MAX_FRAMES[output.suffix])
    path = _log_of(folder, log)
    opened = open_log_of_run(folder, path, scan_topic=scan_topic, odom_topic=odom_topic)
    prepare_file(output)
    with (
        atomic_path(output) as unfinished,
        progress(f"{output.name} of {directory}", len(rows), "frames") as tell,
    ):
        write_animation(folder, opened, unfinished, kind=kind, rows=rows, fps=fps, tell=tell)
    size_mb = output.stat().st_size / 2**20
    stderr().print(f"{output}: {len(rows)} frames, {size_mb:.1f} MB", soft_wrap=True)
    return EXIT_OK


def _kind(output: Path) -> "Kind":
    if output.suffix == ".gif":
        return "gif"
    if output.suffix == ".mp4":
        return "mp4"
    raise InputError(f"{output}: the name of --output must end in .gif or .mp4")


def _rows(n_scans: int, first: int, last: int | None, every: int | None, *, max_frames: int) -> range:
    """Scans to show, from 0; the command line counts from 1."""
    end = n_scans if last is None else min(last, n_scans)
    if not 1 <= first <= n_scans:
        raise InputError(f"--first must be a scan of the run, 1 to {n_scans}, not {first}")
    if end < first:
        raise InputError(f"--last must not be before --first, which is {first}; it is {last}")
    if every is not None and every < 1:
        raise InputError(f"--every must be at least 1, not {every}")
    return range(first - 1, end, every or math.ceil((end - first + 1) / max_frames))


def _log_of(folder: "RunFolder", given: Path | None) -> Path:
    if given is not None:
        return given
    if folder.log is None:
        raise InputError(f"{folder.path}: does not say which log was run; name it as --log")
    if not folder.log.exists():
        raise InputError(f"{folder.log}: the log of {folder.path} is no longer there; name it as --log")
    return folder.log
