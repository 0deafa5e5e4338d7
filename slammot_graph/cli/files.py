"""Files that commands read and write; what cannot be written is refused before anything is computed."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.core.saved_run import RunFolder
    from slammot_graph.logs import LaserLog

LaserPose = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[FRAME] X Y YAW [flip]")]
CloudTopic = Annotated[str | None, tyro.conf.arg(metavar="T")]
Slice = Annotated[tuple[float, float] | None, tyro.conf.arg(name="slice", metavar="Z_MIN Z_MAX")]
ScanTopics = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="T")]
OdometrySwitch = Literal["on", "off"]
"""Options of the commands that run a log."""


def prepare_file(output: Path) -> None:
    """Check that a file can be written, before it is computed.

    Raises
    ------
    InputError
        It cannot.
    """
    if output.exists() and not output.is_file():
        raise InputError(f"{output}: is no plain file; name another --output")
    output.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise InputError(f"{output}: cannot be written (Permission denied); name another --output")


def open_log_of_run(
    folder: "RunFolder",
    path: Path,
    *,
    scan_topic: Sequence[str] | None = None,
    odom_topic: str | None = None,
) -> "LaserLog":
    """Open the log of a run as the run did: with the topics and the laser pose of its summary.

    Raises
    ------
    InputError
        The log cannot be opened, or the summary is damaged.
    """
    from slammot_graph.logs import open_log

    laser_pose: list[float | str] | None = None
    source = folder.summary.get("source")
    if not isinstance(source, dict) or folder.log is None or folder.log.suffix != path.suffix:
        source = {}  # of another program, or a log of another kind in its place
    if source.get("laser_pose_from") == "given":
        given: Any = source.get("laser_pose")
        try:
            x, y, yaw = map(
                float, given.split() if isinstance(given, str) else given
            )  # version 0.1 wrote text
        except (TypeError, ValueError):
            raise InputError(
                f"{folder.path / 'summary.json'}: its laser_pose is not three numbers; run it again"
            ) from None
        laser_pose = [x, y, yaw]
    words = source.get("given_laser_pose")
    if isinstance(words, list) and all(isinstance(word, str) for word in words):
        laser_pose = words
    topics = source.get("scan_topic")
    topics = topics.split(", ") if isinstance(topics, str) else topics
    return open_log(
        path,
        scan_topic=scan_topic or topics,
        odom_topic=odom_topic or source.get("odom_topic"),
        imu_topic=source.get("imu_topic"),
        odom_frame=source.get("odom_frame"),
        base_frame=source.get("base_frame"),
        laser_pose=laser_pose,
        odometry=source.get("odometry") != "off",
        cloud_topic=source.get("cloud_topic"),
        heights=_heights(source.get("slice")),
    )


def _heights(told: object) -> tuple[float, float] | None:
    """The slice of a summary; None where there is none."""
    match told:
        case [float() | int() as low, float() | int() as high]:
            return float(low), float(high)
    return None
