"""Where the lidars of a bag's clouds sit, and how finely their clouds are cut into beams."""

import math
from collections.abc import Mapping, Sequence
from contextlib import closing

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray
from slammot_graph.logs.bag_clouds import (
    CloudSlice,
    CloudSlicer,
    cloud_points,
    fitting_bin_count,
    slice_polar,
)
from slammot_graph.logs.bag_messages import Bag, frame_name
from slammot_graph.logs.bag_mounting import FoundMounting, frame_tree
from slammot_graph.logs.bag_topics import Topic

N_CLOUDS = 20
"""Clouds looked at for points in the slice."""


def cloud_place(bag: Bag, base_frames: Sequence[str], frame: str, found: FoundMounting) -> FloatArray:
    """Transform ``T_base_cloud`` (4, 4) by tf; of a given or assumed mounting that in the plane, at height 0."""
    if found.told_by == "tf":
        tree = frame_tree(bag, base_frames[0], frame)
        for base_frame in base_frames:
            T_base_cloud = tree.between(base_frame, frame)
            if T_base_cloud is not None:
                return T_base_cloud
    mounting = found.mounting
    x, y, yaw = mounting.T_base_laser
    c, s = math.cos(yaw), math.sin(yaw)
    flip = -1.0 if mounting.is_upside_down else 1.0
    T = np.eye(4)
    T[:3, :3] = [[c, -s * flip, 0.0], [s, c * flip, 0.0], [0.0, 0.0, flip]]
    T[:2, 3] = x, y
    return T


def find_slicers(
    bag: Bag, topics: Sequence[Topic], places: Mapping[str, FloatArray], heights: CloudSlice
) -> dict[str, CloudSlicer]:
    """For each frame, at ``T_base_cloud`` (4, 4), what makes scans of its clouds.

    Raises
    ------
    InputError
        No point of the first clouds lies in the slice, or the clouds cannot be used.
    """
    angles: dict[str, list[FloatArray]] = {frame: [] for frame in places}
    lowest, highest, fault = math.inf, -math.inf, ""
    with closing(bag.messages(topics)) as messages:
        for message in messages:
            if message.number > N_CLOUDS:
                break
            frame = "" if message.content is None else frame_name(message.content.header.frame_id)
            if message.content is None or frame not in places:
                continue
            try:
                points, _ = cloud_points(message.content)
            except ValueError as error:
                fault = str(error)
                continue
            T = places[frame]
            z = points @ T[2, :3] + T[2, 3]
            if len(z):
                lowest, highest = min(lowest, float(z.min())), max(highest, float(z.max()))
            angles[frame].append(slice_polar(points, T, heights)[1])
    slicers = {
        frame: CloudSlicer(places[frame], heights, n_beams=_bin_count(found), number=number)
        for number, (frame, found) in enumerate(angles.items())
    }
    if not any(len(x) for found in angles.values() for x in found):
        name = ", ".join(topic.name for topic in topics)
        if lowest > highest:
            raise InputError(f"{bag.path}: the clouds of {name} hold no points ({fault or 'all are empty'})")
        raise InputError(
            f"{bag.path}: no point of {name} lies between {heights.z_min_m:g} and {heights.z_max_m:g} m above the"
            f" base, but between {lowest:.2f} and {highest:.2f} m; give another --slice"
        )
    return slicers


def _bin_count(angles: Sequence[FloatArray]) -> int:
    """Beams of a full turn that the fullest of some clouds fills."""
    fullest = max(angles, key=len, default=np.empty(0))
    return fitting_bin_count(fullest)
