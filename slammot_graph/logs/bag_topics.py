"""Which topics of a bag are the scans and the odometry."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from slammot_graph.core.errors import InputError

IMU_TYPES = ("sensor_msgs/msg/Imu",)
CLOUD_TYPES = ("sensor_msgs/msg/PointCloud2",)
SCAN_TYPES = ("sensor_msgs/msg/LaserScan",)
ODOMETRY_TYPES = ("nav_msgs/msg/Odometry",)
POSE_TYPES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

MIN_POSES_PER_SCAN = 0.1
"""Pose topics with fewer messages hold goals or initial poses; they are not taken for odometry unasked."""


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A topic of a bag with its message type (``package/msg/Name``) and message count."""

    name: str
    msgtype: str
    n_messages: int


def choose_scan_topics(path: Path, topics: Sequence[Topic], requested: Sequence[str]) -> list[Topic]:
    """The topics of the laser scans: the requested ones, else the only one.

    Raises
    ------
    InputError
        None fits, several do, or the requested one is not there or of another type.
    """
    fitting = _filled(topics, SCAN_TYPES)
    if requested:
        chosen = [_requested(path, topics, fitting, x, "--scan-topic", "LaserScan") for x in requested]
        return list(dict.fromkeys(chosen))
    if not fitting:
        clouds = _filled(topics, CLOUD_TYPES)
        hint = f"; make scans of {_listed(clouds)} with --cloud-topic T --slice Z_MIN Z_MAX" if clouds else ""
        raise InputError(f"{path}: no LaserScan messages; its topics are {_listed(topics)}{hint}")
    if len(fitting) > 1:
        raise InputError(
            f"{path}: several LaserScan topics ({_listed(fitting)}); name one with --scan-topic, or all that are"
            " the robot's lasers"
        )
    return fitting


def choose_cloud_topic(path: Path, topics: Sequence[Topic], requested: str) -> Topic:
    """The topic of the clouds.

    Raises
    ------
    InputError
        The requested one is not there or of another type.
    """
    return _requested(path, topics, _filled(topics, CLOUD_TYPES), requested, "--cloud-topic", "PointCloud2")


def choose_odometry_topic(
    path: Path, topics: Sequence[Topic], requested: str | None, *, n_scans: int
) -> tuple[Topic | None, str]:
    """The topic of the odometry: Odometry, else poses if there are enough, else tf; or None, and why.

    Raises
    ------
    InputError
        Several fit, or the requested one is not there or of another type.
    """
    transforms = _filled(topics, TF_TYPES)
    if requested is not None:
        fitting = _filled(topics, ODOMETRY_TYPES) + _filled(topics, POSE_TYPES) + transforms
        return _requested(path, topics, fitting, requested, "--odom-topic", "odometry"), ""
    poses = _filled(topics, POSE_TYPES)
    frequent_poses = [x for x in poses if x.n_messages >= MIN_POSES_PER_SCAN * n_scans]
    for fitting in (_filled(topics, ODOMETRY_TYPES), frequent_poses):
        if fitting:
            return _only(path, fitting, "--odom-topic", "odometry"), ""
    if transforms:
        return min(transforms, key=lambda x: x.name.endswith("tf_static")), ""
    hint = f"; name one of {_listed(poses)} with --odom-topic if it is" if poses else ""
    return None, f"no odometry among its topics ({_listed(topics)}){hint}"


def choose_imu_topic(path: Path, topics: Sequence[Topic], requested: str | None) -> tuple[Topic | None, str]:
    """The topic of the IMU, if there is one; None and a warning where there are several.

    Raises
    ------
    InputError
        The requested one is not there or of another type.
    """
    fitting = _filled(topics, IMU_TYPES)
    if requested is not None:
        return _requested(path, topics, fitting, requested, "--imu-topic", "Imu"), ""
    if len(fitting) > 1:
        return None, f"several Imu topics ({_listed(fitting)}), none is used; name one with --imu-topic"
    return (fitting[0] if fitting else None), ""


def _filled(topics: Sequence[Topic], msgtypes: Sequence[str]) -> list[Topic]:
    return [x for x in topics if x.msgtype in msgtypes and x.n_messages > 0]


def _only(path: Path, fitting: Sequence[Topic], option: str, what: str) -> Topic:
    if len(fitting) > 1:
        raise InputError(f"{path}: several {what} topics ({_listed(fitting)}); name one with {option}")
    return fitting[0]


def _requested(
    path: Path, topics: Sequence[Topic], fitting: Sequence[Topic], name: str, option: str, what: str
) -> Topic:
    by_name: Mapping[str, Topic] = {x.name.strip("/"): x for x in topics}
    topic = by_name.get(name.strip("/"))
    choice = f"{option} can be {_listed(fitting)}" if fitting else f"its topics are {_listed(topics)}"
    if topic is None:
        raise InputError(f"{path}: no topic {name}; {choice}")
    if topic not in fitting:
        why = "has no messages" if topic.n_messages == 0 else f"holds {topic.msgtype}, not {what}"
        raise InputError(f"{path}: topic {name} {why}; {choice}")
    return topic


def _listed(topics: Sequence[Topic]) -> str:
    return ", ".join(x.name for x in topics) or "none"
