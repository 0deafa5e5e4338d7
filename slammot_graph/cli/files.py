"""Files that commands write: whole or not there, and refused before anything is computed."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.logs import LaserLog
    from slammot_graph.run_folder.reader import RunFolder

LaserPose = Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y YAW")]
"""Option of the commands that run a log."""


def prepare_file(output: Path) -> None:
    """Find out that a file cannot be written before it is computed."""
    if output.exists() and not output.is_file():
        raise InputError(f"{output}: is no plain file; name another --output")
    output.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise InputError(f"{output}: cannot be written (Permission denied); name another --output")


@contextlib.contextmanager
def whole_file(output: Path) -> Iterator[Path]:
    """Give a temporary name that becomes `output` when all went well, and goes away when not."""
    unfinished = output.with_name(f".{output.name}.tmp")
    try:
        yield unfinished
        unfinished.replace(output)
    finally:
        unfinished.unlink(missing_ok=True)


def open_log_of_run(
    folder: "RunFolder", path: Path, *, scan_topic: str | None = None, odom_topic: str | None = None
) -> "LaserLog":
    """Open the log of a run as the run did: with its topics and its laser pose, as its summary tells them."""
    from slammot_graph.logs import open_log

    source, laser_pose = folder.summary.get("source"), None
    if not isinstance(source, dict) or folder.log is None or folder.log.suffix != path.suffix:
        source = {}  # of another program, or a log of another kind in its place
    if source.get("laser_pose_from") == "given":
        try:
            x, y, yaw = map(float, source["laser_pose"].split())
        except (KeyError, ValueError, AttributeError):
            raise InputError(
                f"{folder.path / 'summary.json'}: its laser_pose is not three numbers; run it again"
            ) from None
        laser_pose = (x, y, yaw)
    return open_log(
        path,
        scan_topic=scan_topic or source.get("scan_topic"),
        odom_topic=odom_topic or source.get("odom_topic"),
        laser_pose=laser_pose,
    )
