"""Small bags for the tests, written in every format from one list of messages."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
FORMATS = ("bag", "sqlite3", "mcap")


class Sent(NamedTuple):
    """A message to write: topic, recording time [s], and how to build it from a function that makes messages."""

    topic: str
    bag_stamp: float
    msgtype: str
    fields: dict[str, Any]


class Part(NamedTuple):
    """A message within a message."""

    msgtype: str
    fields: dict[str, Any]


def header(stamp: float, frame: str) -> Part:
    sec = math.floor(stamp)
    time = Part("builtin_interfaces/msg/Time", {"sec": sec, "nanosec": round((stamp - sec) * 1e9)})
    return Part("std_msgs/msg/Header", {"seq": 0, "stamp": time, "frame_id": frame})


def quaternion(yaw: float, roll: float = 0.0) -> Part:
    """Rotation about x by roll, then about z by yaw."""
    cy, sy, cr, sr = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(roll / 2), math.sin(roll / 2)
    return Part("geometry_msgs/msg/Quaternion", {"x": cy * sr, "y": sy * sr, "z": sy * cr, "w": cy * cr})


def pose_part(x: float, y: float, theta: float) -> Part:
    position = Part("geometry_msgs/msg/Point", {"x": x, "y": y, "z": 0.3})
    return Part("geometry_msgs/msg/Pose", {"position": position, "orientation": quaternion(theta)})


def with_covariance(pose: Part) -> Part:
    return Part("geometry_msgs/msg/PoseWithCovariance", {"pose": pose, "covariance": np.zeros(36)})


def scan(
    stamp: float,
    ranges: Sequence[float] = (1.0, 2.0, 3.0),
    *,
    lag: float = 0.05,
    topic: str = "/scan",
    **changes: Any,
) -> Sent:
    n = len(ranges)
    fields: dict[str, Any] = {
        "header": header(stamp, changes.pop("frame", "laser")),
        "angle_min": -0.5,
        "angle_max": -0.5 + 0.25 * (n - 1),
        "angle_increment": 0.25,
        "time_increment": 0.0,
        "scan_time": 0.1,
        "range_min": 0.125,
        "range_max": 16.0,
        "ranges": np.array(ranges, dtype=np.float32),
        "intensities": np.array([], dtype=np.float32),
    }
    return Sent(topic, stamp + lag, "sensor_msgs/msg/LaserScan", {**fields, **changes})


def odometry(
    stamp: float, pose: Sequence[float], *, lag: float = 0.002, topic: str = "/odom", child: str = "base_link"
) -> Sent:
    zero = Part("geometry_msgs/msg/Vector3", {"x": 0.0, "y": 0.0, "z": 0.0})
    twist = Part("geometry_msgs/msg/Twist", {"linear": zero, "angular": zero})
    fields = {
        "header": header(stamp, "odom"),
        "child_frame_id": child,
        "pose": with_covariance(pose_part(*pose)),
        "twist": Part("geometry_msgs/msg/TwistWithCovariance", {"twist": twist, "covariance": np.zeros(36)}),
    }
    return Sent(topic, stamp + lag, "nav_msgs/msg/Odometry", fields)


def pose_stamped(stamp: float, pose: Sequence[float], *, topic: str = "/pose") -> Sent:
    fields = {"header": header(stamp, "map"), "pose": pose_part(*pose)}
    return Sent(topic, stamp + 0.002, "geometry_msgs/msg/PoseStamped", fields)


def pose_with_covariance(stamp: float, pose: Sequence[float], *, topic: str = "/pose") -> Sent:
    fields = {"header": header(stamp, "map"), "pose": with_covariance(pose_part(*pose))}
    return Sent(topic, stamp + 0.002, "geometry_msgs/msg/PoseWithCovarianceStamped", fields)


def transform(
    stamp: float,
    parent: str,
    child: str,
    pose: Sequence[float],
    *,
    roll: float = 0.0,
    topic: str = "/tf_static",
) -> Sent:
    x, y, theta = pose
    translation = Part("geometry_msgs/msg/Vector3", {"x": x, "y": y, "z": 0.2})
    rigid = Part(
        "geometry_msgs/msg/Transform", {"translation": translation, "rotation": quaternion(theta, roll)}
    )
    fields = {"header": header(stamp, parent), "child_frame_id": child, "transform": rigid}
    stamped = Part("geometry_msgs/msg/TransformStamped", fields)
    return Sent(topic, stamp + 0.001, "tf2_msgs/msg/TFMessage", {"transforms": [stamped]})


def write_bag(folder: Path, messages: Sequence[Sent], kind: str = "bag", *, is_sorted: bool = False) -> Path:
    """Write messages in the order of their recording times, or as given; the path is what `open_log` takes."""
    messages = messages if is_sorted else sorted(messages, key=lambda x: x.bag_stamp)
    if kind == "bag":
        path, store = folder / "log.bag", ROS1
        writer: Any = Writer1(path)
    else:
        path, store = folder / f"log_{kind}", ROS2
        plugin = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
        writer = Writer2(path, version=9, storage_plugin=plugin)
    serialize = store.serialize_ros1 if kind == "bag" else store.serialize_cdr
    with writer:
        connections: dict[str, Any] = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(
                    message.topic, message.msgtype, typestore=store
                )
            built = _build(store, Part(message.msgtype, message.fields))
            data = serialize(built, message.msgtype)
            writer.write(connections[message.topic], round(message.bag_stamp * 1e9), data)
    return path


def _build(store: Any, part: Any) -> Any:
    if isinstance(part, list):
        return [_build(store, x) for x in part]
    if not isinstance(part, Part):
        return part
    fields = dict(part.fields)
    if part.msgtype == "std_msgs/msg/Header" and store is ROS2:
        del fields["seq"]
    return store.types[part.msgtype](**{key: _build(store, value) for key, value in fields.items()})
