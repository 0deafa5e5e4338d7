"""Odometry of a bag, from a topic or from tf, and whether it shares a clock with the scans."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.logs.bag_messages import Bag, BagMessage, frame_name, header_stamp, planar_pose, transforms
from slammot_graph.logs.bag_topics import ODOMETRY_TYPES, TF_TYPES, Topic
from slammot_graph.logs.odometry import OdometryTrack

ODOM_FRAMES = ("odom", "odom_combined", "odom_frame")
BASE_FRAMES = ("base_link", "base_footprint", "base")
"""The usual names of the frames between which tf holds odometry."""

MAX_CLOCK_DIFFERENCE_S = 0.5
"""Scans and odometry whose header stamps lag recording by amounts further apart than this have two clocks."""


class OdometrySample(NamedTuple):
    """One pose: recorded when [s], stamped when [s], base in odom, name of the base frame or empty."""

    bag_stamp: float
    header_stamp: float
    T_odom_base: tuple[float, float, float]
    base_frame: str


def read_odometry(bag: Bag, topic: Topic | None) -> list[OdometrySample]:
    """All poses of the odometry topic, or of tf where that is None.

    Raises
    ------
    InputError
        The topic cannot be decoded, or tf has no odometry.
    """
    if topic is None:
        samples = _odometry_from_tf(bag)
        if not samples:
            raise InputError(
                f"{bag.path}: no odometry topic, and no {' or '.join(BASE_FRAMES)} in {ODOM_FRAMES[0]} in tf;"
                " record odometry, or name a pose topic with --odom-topic"
            )
        return samples
    samples = []
    for message in bag.messages([topic]):
        content = message.content
        if content is None:
            continue
        pose = content.pose if topic.msgtype == "geometry_msgs/msg/PoseStamped" else content.pose.pose
        base_frame = frame_name(content.child_frame_id) if topic.msgtype in ODOMETRY_TYPES else ""
        T_odom_base = planar_pose(pose.position, pose.orientation)
        samples.append(OdometrySample(message.bag_stamp, header_stamp(content), T_odom_base, base_frame))
    if not samples:
        raise InputError(
            f"{bag.path}: the messages of {topic.name} cannot be decoded; choose another --odom-topic"
        )
    return samples


def _odometry_from_tf(bag: Bag) -> list[OdometrySample]:
    """Poses of the base in odom as broadcast to tf; of several base frames the usual one."""
    samples: dict[str, list[OdometrySample]] = {}
    for message in bag.messages([x for x in bag.topics if x.msgtype in TF_TYPES]):
        for transform in transforms(message):
            parent, child = frame_name(transform.header.frame_id), frame_name(transform.child_frame_id)
            if parent in ODOM_FRAMES and child in BASE_FRAMES:
                T_odom_base = planar_pose(transform.transform.translation, transform.transform.rotation)
                sample = OdometrySample(message.bag_stamp, header_stamp(transform), T_odom_base, child)
                samples.setdefault(child, []).append(sample)
    return next((samples[x] for x in BASE_FRAMES if x in samples), [])


def base_frames(samples: Sequence[OdometrySample]) -> list[str]:
    """Names that the base frame may have, that of the odometry first."""
    named = samples[0].base_frame
    return [named, *(x for x in BASE_FRAMES if x != named)] if named else list(BASE_FRAMES)


def odometry_track(
    path: Path, samples: Sequence[OdometrySample], *, uses_headers: bool
) -> tuple[OdometryTrack, list[str]]:
    """The finite samples as a track by header stamps or recording times, with warnings.

    Raises
    ------
    InputError
        There is no finite sample.
    """
    finite = [x for x in samples if all(map(math.isfinite, x.T_odom_base))]
    if not finite:
        raise InputError(
            f"{path}: none of the {len(samples)} odometry poses is finite; choose another --odom-topic"
        )
    track = OdometryTrack.from_samples(
        np.array([x.header_stamp if uses_headers else x.bag_stamp for x in finite]),
        np.array([x.T_odom_base for x in finite]),
    )
    n_dropped = len(samples) - len(finite)
    if n_dropped:
        return track, [f"{n_dropped} of {len(samples)} odometry poses are not finite; the others are used"]
    return track, []


def share_a_clock(scans: Sequence[BagMessage], samples: Sequence[OdometrySample]) -> bool:
    """Whether the header stamps of scans and odometry advance, and lag recording by about the same."""
    scan_headers = np.array([header_stamp(x.content) for x in scans])
    scan_lags = np.array([x.bag_stamp for x in scans]) - scan_headers
    odometry_headers = np.array([x.header_stamp for x in samples])
    odometry_lags = np.array([x.bag_stamp for x in samples]) - odometry_headers
    for headers in (scan_headers, odometry_headers):
        if len(headers) > 1 and np.ptp(headers) == 0.0:
            return False
    return abs(float(np.median(scan_lags) - np.median(odometry_lags))) <= MAX_CLOCK_DIFFERENCE_S
