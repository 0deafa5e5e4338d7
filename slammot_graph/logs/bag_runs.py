"""Runs of a ROS 1 bag whose recording times begin again.

rosbag takes the simulation's clock for them where that is used; after a restart both runs lie at the same times, and a
reader that sorts by these mixes them. The order of the file still tells them apart.
"""

from typing import Any, NamedTuple

import numpy as np
from rosbags.rosbag1 import Reader

from slammot_graph.core.odometry_track import MAX_GAP_S
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.logs.bag_restarts import restarts

APART_S = 2.0 * MAX_GAP_S
"""The next run is laid so long after the one before: odometry is not interpolated from one to the other."""


class BagRun(NamedTuple):
    """A run among several of one bag.

    Attributes
    ----------
    indexes : dict of int to list
        Where its messages lie, by the numbers of their connections, as `rosbags` keeps them.
    start_ns : int
        Its first recording time.
    shift_s : float
        To be added to its recording times, that it follows the run before.
    """

    indexes: dict[int, list[Any]]
    start_ns: int
    shift_s: float


def runs_of(reader: Reader) -> list[BagRun]:
    """Give the runs of an open bag in the order of recording; none where its recording times do not begin again."""
    numbers = list(reader.indexes)
    entries = [entry for number in numbers for entry in reader.indexes[number]]
    if not entries:
        return []
    connection = np.repeat(numbers, [len(reader.indexes[number]) for number in numbers])
    at = np.array([(entry.chunk_pos, entry.offset, entry.time) for entry in entries], dtype=np.int64)
    order = np.lexsort((at[:, 1], at[:, 0]))
    times_ns, connection = at[order, 2], connection[order]
    times_s = 1e-9 * (times_ns - times_ns.min())
    topics = {one.id: one.topic for one in reader.connections}
    names = sorted(set(topics.values()))
    topic = np.array([names.index(topics[number]) for number in connection.tolist()])
    starts = [k for k in restarts(times_s).tolist() if _goes_back(times_s, topic, k)]
    if not starts:
        return []
    runs, end_s = list[BagRun](), 0.0
    for first, last in zip([0, *starts], [*starts, len(order)], strict=True):
        own = order[first:last]
        indexes: dict[int, list[Any]] = {number: [] for number in numbers}
        for k, number in zip(own.tolist(), connection[first:last].tolist(), strict=True):
            indexes[number].append(entries[k])
        start_ns = int(times_ns[first:last].min())
        shift_s = end_s + APART_S - 1e-9 * start_ns if runs else 0.0
        end_s = 1e-9 * int(times_ns[first:last].max()) + shift_s
        runs.append(BagRun({number: sorted(found) for number, found in indexes.items()}, start_ns, shift_s))
    return runs


def _goes_back(times_s: FloatArray, topic: IntArray, k: int) -> bool:
    """Whether the times of any topic go back at the message k of the file.

    They do not where two recordings of different topics were put together, one after the other.
    """
    for one in np.unique(topic[k:]).tolist():
        before, after = times_s[:k][topic[:k] == one], times_s[k:][topic[k:] == one]
        if len(before) and after[0] < before[-1] - MAX_GAP_S:
            return True
    return False
