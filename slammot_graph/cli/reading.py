"""How a log is read: the options that all commands over a log share, and those of an earlier run."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from slammot_graph.core.errors import InputError

if TYPE_CHECKING:
    from slammot_graph.core.saved_run import RunFolder
    from slammot_graph.logs import LaserLog

ScanTopics = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="T")]
Topic = Annotated[str | None, tyro.conf.arg(metavar="T")]
Frame = Annotated[str | None, tyro.conf.arg(metavar="F")]


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """What of a log is read, and how."""

    scan_topic: ScanTopics = None
    """Which laser of a bag, or which lasers."""
    cloud_topic: Topic = None
    """Clouds (PointCloud2) of a bag, to make scans of."""
    heights: Annotated[tuple[float, float] | None, tyro.conf.arg(name="slice", metavar="Z_MIN Z_MAX")] = None
    """Heights above the base between which a cloud is cut into a scan [m]."""
    odom_topic: Topic = None
    """Which odometry of a bag."""
    imu_topic: Topic = None
    """Which IMU of a bag."""
    odom_frame: Frame = None
    """Frame of a bag's tf that odometry is told in, as robot1/odom."""
    base_frame: Frame = None
    """Frame of the robot in a bag's tf, as robot1/base_link."""
    odometry: Literal["on", "off"] = "on"
    """off: leave the log's odometry aside; the laser alone tells of the motion."""
    laser_pose: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[FRAME] X Y YAW [flip]")] = None
    """Where the laser sits on the robot [m, m, rad], in place of what the log says; flip: upside down. Of several
    lasers, the frame of each before its pose."""

    def open(self, log: Path) -> "LaserLog":
        """Open a log so.

        Raises
        ------
        InputError
            It cannot be read, or there is no such topic or frame in it.
        """
        from slammot_graph.logs import open_log

        return open_log(
            log,
            scan_topic=self.scan_topic,
            cloud_topic=self.cloud_topic,
            heights=self.heights,
            odom_topic=self.odom_topic,
            imu_topic=self.imu_topic,
            odom_frame=self.odom_frame,
            base_frame=self.base_frame,
            laser_pose=self.laser_pose,
            odometry=self.odometry == "on",
        )


Reading = Annotated[ReadingOptions, tyro.conf.arg(name="")]
"""The options of `ReadingOptions`, without a prefix."""
DEFAULT_READING = ReadingOptions()


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
