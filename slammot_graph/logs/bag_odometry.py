"""Odometry of a bag, from a topic or from tf, and whether it shares a clock with the scans."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray
from slammot_graph.logs.bag_messages import Bag, frame_name, header_stamp, planar_pose, transforms
from slammot_graph.logs.bag_topics import ODOMETRY_TYPES, TF_TYPES, Topic, choose_odometry_topic
from slammot_graph.logs.scan_odometry import are_sane_poses

ODOM_FRAMES = ("odom", "odom_combined", "odom_frame")
BASE_FRAMES = ("base_link", "base_footprint", "base")
"""The usual names of the frames between which tf holds odometry; a robot's name may stand before both."""

MAX_CLOCK_DIFFERENCE_S = 0.5
"""Scans and odometry whose header stamps lag recording by amounts further apart than this have two clocks."""

N_SCANS_SAMPLED = 20
"""Scans whose stamps are compared with the odometry's."""


@dataclass(frozen=True, kw_only=True)
class FrameNames:
    """Names of the frames as given; None: the usual ones."""

    odom: str | None = None
    base: str | None = None


class OdometrySample(NamedTuple):
    """One pose: recorded when [s], stamped when [s], base in odom, name of the base frame or empty."""

    bag_stamp: float
    header_stamp: float
    T_odom_base: tuple[float, float, float]
    base_frame: str


@dataclass(frozen=True, kw_only=True)
class BagOdometry:
    """The odometry of a bag.

    Attributes
    ----------
    samples : tuple of OdometrySample
        Empty where there is none.
    topic : str
        Where it comes from; empty where there is none.
    why_none : str
        Why there is none, for a warning.
    """

    samples: tuple[OdometrySample, ...] = ()
    topic: str = ""
    why_none: str = ""


def read_odometry(bag: Bag, requested: str | None, frames: FrameNames, *, n_scans: int) -> BagOdometry:
    """All poses of the odometry topic, or of tf.

    Raises
    ------
    InputError
        Several topics or frames would do; the requested one is not there, cannot be decoded or has no odometry.
    """
    topic, why_none = choose_odometry_topic(bag.path, bag.topics, requested, n_scans=n_scans)
    if topic is None:
        return BagOdometry(why_none=why_none)
    if topic.msgtype not in TF_TYPES:
        return BagOdometry(samples=tuple(_odometry_from_topic(bag, topic)), topic=topic.name)
    samples = _odometry_from_tf(bag, frames)
    if not samples:
        names = f"{frames.base or ' or '.join(BASE_FRAMES)} in {frames.odom or ODOM_FRAMES[0]}"
        if requested is not None or frames.odom is not None:
            raise InputError(
                f"{bag.path}: no {names} in tf; record odometry, name a pose topic with --odom-topic or the frames"
                " with --odom-frame and --base-frame"
            )
        return BagOdometry(why_none=f"no odometry topic, and no {names} in tf")
    if requested is None and _never_moves(samples):
        why_none = f"odometry in tf is a static transform of {samples[0].base_frame}, which never moves"
        return BagOdometry(why_none=why_none)
    return BagOdometry(samples=tuple(samples), topic=topic.name)


def _odometry_from_topic(bag: Bag, topic: Topic) -> list[OdometrySample]:
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


def _odometry_from_tf(bag: Bag, frames: FrameNames) -> list[OdometrySample]:
    """Poses of the base in odom as broadcast to tf; of several base frames the usual one."""
    samples: dict[tuple[str, str], list[OdometrySample]] = {}
    for message in bag.messages([x for x in bag.topics if x.msgtype in TF_TYPES]):
        for transform in transforms(message):
            parent, child = frame_name(transform.header.frame_id), frame_name(transform.child_frame_id)
            if _is_odometry(parent, child, frames):
                T_odom_base = planar_pose(transform.transform.translation, transform.transform.rotation)
                sample = OdometrySample(message.bag_stamp, header_stamp(transform), T_odom_base, child)
                samples.setdefault((parent, child), []).append(sample)
    by_robot: dict[str, list[tuple[str, str]]] = {}
    for parent, child in samples:
        by_robot.setdefault(child.rpartition("/")[0], []).append((parent, child))
    if "" in by_robot:  # names without a robot's are preferred
        by_robot = {"": by_robot[""]}
    if len(by_robot) > 1:
        found = ", ".join(f"{child} in {parent}" for parent, child in samples)
        raise InputError(
            f"{bag.path}: tf has the odometry of several robots ({found}); name one with --odom-frame and --base-frame"
        )
    of_robot = next(iter(by_robot.values()), [])
    chosen = min(of_robot, key=lambda x: (_never_moves(samples[x]), _rank(x[1])), default=None)
    return samples[chosen] if chosen else []


def _never_moves(samples: Sequence[OdometrySample]) -> bool:
    return len({x.T_odom_base for x in samples}) == 1


def _is_odometry(parent: str, child: str, frames: FrameNames) -> bool:
    """Tell whether tf's transform from a child to a parent is odometry, by the frames' names."""
    prefix, _, name = child.rpartition("/")
    if frames.base is not None:
        is_base = child == frame_name(frames.base)
    else:
        is_base = frames.odom is not None or name in BASE_FRAMES
    if frames.odom is not None:
        return is_base and parent == frame_name(frames.odom)
    return is_base and any(parent in (x, f"{prefix}/{x}") for x in ODOM_FRAMES)


def _rank(base_frame: str) -> int:
    """How usual a base frame is, 0 the most."""
    name = base_frame.rpartition("/")[2]
    return BASE_FRAMES.index(name) if name in BASE_FRAMES else len(BASE_FRAMES)


def base_frames(samples: Sequence[OdometrySample], given: str | None = None) -> list[str]:
    """Names that the base frame may have, the given one or that of the odometry first."""
    if given is not None:
        return [frame_name(given)]
    named = samples[0].base_frame if samples else ""
    robot = named.rpartition("/")[0]
    usual = [*(f"{robot}/{x}" for x in BASE_FRAMES if robot), *BASE_FRAMES]
    return [named, *(x for x in usual if x != named)] if named else usual


def sample_arrays(samples: Sequence[OdometrySample], *, uses_headers: bool) -> tuple[FloatArray, FloatArray]:
    """Stamps (m,) by headers or recording times [s], and poses (m, 3) of base in odom."""
    stamps = np.array([x.header_stamp if uses_headers else x.bag_stamp for x in samples], dtype=np.float64)
    return stamps, np.array([x.T_odom_base for x in samples], dtype=np.float64).reshape(-1, 3)


def why_left_out(poses: FloatArray) -> str:
    """A warning of odometry poses (m, 3) that are left out; empty if there are none."""
    n_dropped = len(poses) - int(np.count_nonzero(are_sane_poses(poses)))
    what = "not finite" if not np.isfinite(poses).all() else "out of any sense"
    return f"{n_dropped} of {len(poses)} odometry poses are {what}; the others are used" if n_dropped else ""


def share_a_clock(
    scan_stamps: FloatArray, scan_bag_stamps: FloatArray, samples: Sequence[OdometrySample]
) -> bool:
    """Whether the header stamps (n,) of scans and of odometry advance, and lag recording by about the same."""
    scan_headers = scan_stamps[np.isfinite(scan_stamps)][:N_SCANS_SAMPLED]
    if not len(scan_headers) or (len(scan_headers) > 1 and np.ptp(scan_headers) == 0.0):
        return False
    if not samples:
        return True
    odometry_headers = np.array([x.header_stamp for x in samples])
    if len(odometry_headers) > 1 and np.ptp(odometry_headers) == 0.0:
        return False
    scan_lags = scan_bag_stamps[np.isfinite(scan_stamps)][:N_SCANS_SAMPLED] - scan_headers
    odometry_lags = np.array([x.bag_stamp for x in samples]) - odometry_headers
    return abs(float(np.median(scan_lags) - np.median(odometry_lags))) <= MAX_CLOCK_DIFFERENCE_S
