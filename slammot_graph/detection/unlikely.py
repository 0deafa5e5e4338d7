"""Clusters beside vacated places that are more probably something that comes into view than somebody who moves.

Who leaves a place uncovers what stands behind it, and a door that closes leaves a place empty: on unknown cells, what
lies beside such a place is worth a label only if it looks like a person as well, or stands free before what is behind
it, as who walks ahead of the robot does. In a crowd most of it does.
"""

import numpy as np

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection.base import Detection
from slammot_graph.detection.reasons import FREE, UNKNOWN, VACATED


def is_crowded(detection: Detection, is_valid: BoolArray, crowd_share: float) -> bool:
    """Tell whether more than this share of a scan's returns (n,) seems to move."""
    return bool(np.count_nonzero(detection.is_moving) > crowd_share * np.count_nonzero(is_valid))


FREE_STANDING_M = 0.3
"""Both beams beside what stands free reach farther by at least so much."""


def without_unlikely(
    detection: Detection, ranges: FloatArray, p_moving: FloatArray, min_p: float
) -> Detection:
    """Call the clusters static that have no beam on free cells, one beside a vacated place, and a low probability.

    Those that stand free before what is behind them stay as they are.

    Parameters
    ----------
    detection : Detection
        of n beams.
    ranges : (n,) array [m]
        Infinite where nothing came back.
    p_moving : (n,) array
        By `probability.probability_of_moving`.
    min_p : float
        Clusters that are less probable become UNKNOWN.
    """
    cluster, n = detection.cluster, detection.n_clusters
    is_vacated = detection.reason == VACATED
    in_cluster = cluster >= 0
    has_vacated = np.bincount(cluster[is_vacated], minlength=n) > 0
    has_free = np.bincount(cluster[in_cluster & (detection.reason == FREE)], minlength=n) > 0
    p = np.zeros(n)
    p[cluster[in_cluster]] = p_moving[in_cluster]
    is_dropped = np.append(has_vacated & ~has_free & (p < min_p), False)  # -1: of no cluster
    for k in np.flatnonzero(is_dropped):
        is_dropped[k] = not _stands_free(np.flatnonzero(cluster == k), ranges)
    if not is_dropped.any():
        return detection
    is_static = is_dropped[cluster]
    number = np.append(np.cumsum(~is_dropped[:-1]) - 1, -1)
    return detection._replace(
        is_moving=detection.is_moving & ~is_static,
        reason=np.where(is_static, UNKNOWN, detection.reason),
        cluster=np.where(is_static, -1, number[cluster]),
        n_clusters=int(np.count_nonzero(~is_dropped[:-1])),
    )


def _stands_free(beams: IntArray, ranges: FloatArray) -> bool:
    """Tell whether the beams on both sides of some reach farther, as far as there are any."""
    first, last = int(beams[0]), int(beams[-1])
    is_before = first == 0 or ranges[first - 1] > ranges[first] + FREE_STANDING_M
    return bool(is_before and (last + 1 == len(ranges) or ranges[last + 1] > ranges[last] + FREE_STANDING_M))
