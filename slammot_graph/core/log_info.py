"""What a result says about the log that it was computed from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypedDict


class SourceInfo(TypedDict, total=False):
    """What of its file a log uses; a log that does not know a key leaves it out.

    Attributes
    ----------
    scan_topic, odom_topic, imu_topic : str
        Of a bag.
    odom_frame, base_frame : str
        Of a bag; where the user named them.
    odometry : str
        "off" where the user left it aside, "none" where the log has none.
    laser_pose : (x, y, theta)
        Laser in base [m, m, rad].
    laser_pose_from : str
        Where that comes from; "given" where the user gave it.
    given_laser_pose : sequence of str
        As the user gave it, where that is more than three numbers.
    cloud_topic, slice : str, (z_min, z_max)
        Of scans made of clouds, and of which heights above the base [m].
    lasers : sequence of mappings
        Of several lasers: topic, frame, n_scans, laser_pose, is_upside_down, laser_pose_from; or is_used, false.
    poses : str
        "estimates" where the log's true poses are those of a run.
    """

    scan_topic: str
    odom_topic: str
    imu_topic: str
    odom_frame: str
    base_frame: str
    odometry: str
    laser_pose: tuple[float, float, float]
    laser_pose_from: str
    given_laser_pose: list[str]
    cloud_topic: str
    slice: tuple[float, float]
    lasers: list[dict[str, object]]
    poses: str


@dataclass(frozen=True, kw_only=True)
class LogInfo:
    """A log without its scans.

    Attributes
    ----------
    path : Path or None
        None for a source without a file.
    source : mapping
        See `SourceInfo`.
    warnings : tuple of str
    n_scans : int or None
        Scan records in the file; None where that is not known.
    """

    path: Path | None = None
    source: Mapping[str, object] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    n_scans: int | None = None
