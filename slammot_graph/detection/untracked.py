"""False alarms among the final labels: what no track of the whole run goes through, and was not sure at the time."""

from collections.abc import Sequence

import numpy as np

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection.clustering import ClusterConfig, find_clusters
from slammot_graph.detection.scan_history import ScanRecord

REACH_M = 0.5
"""A cluster belongs to a track if one of its points is this near to it."""


def without_untracked(
    labels: Sequence[BoolArray],
    history: Sequence[ScanRecord],
    T_map_base: FloatArray,
    *,
    clusters: ClusterConfig,
    track_scans: IntArray,
    track_places: FloatArray,
) -> list[BoolArray]:
    """Take back the labels of clusters that lie on no final track, but for those that were sure at the time.

    Somebody who moves and is seen more than a moment has a track once the run is over; of the false alarms every other
    one has none. So what has none must have been very probably moving (`scan_history.SURE_P`) to be believed.

    Parameters
    ----------
    labels : n bool arrays
        Final labels so far.
    history, T_map_base
        As of `backward_pass.retrospective_labels`.
    clusters : ClusterConfig
    track_scans : (m,) int array
        Numbers of the scans of the places.
    track_places : (m, 2) array [m]
        Where the final tracks are at them, map frame.

    Returns
    -------
    n bool arrays
    """
    order = np.argsort(track_scans, kind="stable")
    places = track_places[order]
    starts = np.searchsorted(track_scans[order], np.arange(len(labels) + 1))
    kept = list(labels)
    for k, is_moving in enumerate(labels):
        if not is_moving.any():
            continue
        item = history[k]
        points = item.scan.points(T_map_base[k])
        offset = points[is_moving, None] - places[starts[k] : starts[k + 1]]
        is_tracked = np.zeros_like(is_moving)
        is_tracked[is_moving] = (np.hypot(offset[..., 0], offset[..., 1]) < REACH_M).any(axis=1)
        cluster, n_clusters = find_clusters(points, is_moving, clusters)
        n_tracked = np.bincount(cluster[is_tracked] + 1, minlength=n_clusters + 1)
        n_sure = np.bincount(cluster[is_moving & item.is_sure] + 1, minlength=n_clusters + 1)
        size = np.bincount(cluster[is_moving] + 1, minlength=n_clusters + 1)
        is_kept = (n_tracked > 0) | (2 * n_sure > size)
        in_cluster = is_moving & (cluster >= 0)
        kept[k] = np.where(in_cluster, is_kept[cluster + 1], is_moving & (is_tracked | item.is_sure))
    return kept
