"""The laser's mounting from the transforms (tf) of a bag."""

import math
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

from slammot_graph.core.scan import MAX_MOUNTING_M
from slammot_graph.logs.bag_messages import Bag, BagMessage, frame_name, transforms
from slammot_graph.logs.bag_topics import TF_TYPES
from slammot_graph.logs.mounting import (
    FrameTree,
    GivenPose,
    Mounting,
    mounting_from_transform,
    transform_matrix,
)

MOUNTING_SEARCH_S = 60.0
"""How much of a bag's start is searched for transforms that are not static."""


@dataclass(frozen=True, kw_only=True)
class FoundMounting:
    """A mounting, its origin ("given", "tf", "assumed") and warnings about it."""

    mounting: Mounting
    told_by: str
    warnings: tuple[str, ...] = ()


def find_mounting(
    bag: Bag,
    base_frames: Sequence[str],
    laser_frame: str,
    given: GivenPose | None = None,
) -> FoundMounting:
    """The laser in the base by tf; the identity, and a warning, where tf does not connect them.

    A `given` pose takes the place of the one in tf, which then says only whether the laser is tilted, and whether it is
    upside down unless that is given too.
    """
    tree = frame_tree(bag, base_frames[0], laser_frame)
    told = "tf does not tell where"
    for base_frame in base_frames:
        T_base_laser = tree.between(base_frame, laser_frame)
        if T_base_laser is None:
            continue
        if (away_m := abs(T_base_laser[:2, 3]).max()) > MAX_MOUNTING_M:
            told = f"tf tells out of any sense ({away_m:.4g} m away) where"
        else:
            mounting = mounting_from_transform(T_base_laser)
            warnings = _tilt_warnings(mounting, laser_frame)
            if given is None:
                return FoundMounting(mounting=mounting, told_by="tf", warnings=warnings)
            is_upside_down = mounting.is_upside_down if given.is_upside_down is None else given.is_upside_down
            mounting = replace(mounting, T_base_laser=given.T_base_laser, is_upside_down=is_upside_down)
            return FoundMounting(mounting=mounting, told_by="given", warnings=warnings)
    if given is not None:
        mounting = Mounting(T_base_laser=given.T_base_laser, is_upside_down=bool(given.is_upside_down))
        return FoundMounting(mounting=mounting, told_by="given")
    warning = (
        f"{told} frame {laser_frame or '(unnamed)'} sits on {base_frames[0]};"
        " the laser is taken to sit on the base, unless --laser-pose says where"
    )
    nowhere = Mounting(T_base_laser=(0.0, 0.0, 0.0))
    return FoundMounting(mounting=nowhere, told_by="assumed", warnings=(warning,))


def frame_tree(bag: Bag, base_frame: str, sensor_frame: str) -> FrameTree:
    """The frames in a bag's tf, read until they connect a sensor with the base."""
    tree = FrameTree()
    with closing(_mounting_messages(bag)) as messages:
        for message in messages:
            _add_transforms(tree, message)
            if tree.between(base_frame, sensor_frame) is not None:
                break
    return tree


def _add_transforms(tree: FrameTree, message: BagMessage) -> None:
    for transform in transforms(message):
        rotation, translation = transform.transform.rotation, transform.transform.translation
        quaternion = (rotation.x, rotation.y, rotation.z, rotation.w)
        place = (translation.x, translation.y, translation.z)
        if math.isfinite(norm := math.hypot(*quaternion)) and norm > 0.0 and all(map(math.isfinite, place)):
            matrix = transform_matrix(place, quaternion)
            tree.add(frame_name(transform.header.frame_id), frame_name(transform.child_frame_id), matrix)


def _mounting_messages(bag: Bag) -> Generator[BagMessage, None, None]:
    """All static transforms, then the others of the bag's start."""
    topics = [x for x in bag.topics if x.msgtype in TF_TYPES]
    static = [x for x in topics if x.name.endswith("tf_static")]
    yield from bag.messages(static)
    yield from bag.messages([x for x in topics if x not in static], first_seconds=MOUNTING_SEARCH_S)


def _tilt_warnings(mounting: Mounting, laser_frame: str) -> tuple[str, ...]:
    if mounting.is_level:
        return ()
    return (
        f"laser frame {laser_frame} is tilted by {math.degrees(mounting.tilt):.0f} degrees;"
        " it is treated as if it lay in the robot's plane",
    )
