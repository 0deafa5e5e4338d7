"""Final labels: every scan tested again, at its best pose, with what was seen after it.

The moving-point test runs once more from the last scan to the first. Who stood there when the laser first looked
and displaced away later is found, since the cells were free afterwards; what was called moving online but was hit by
static points later is a wall after all, unless it belongs to an object that has displaced.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection import reasons
from slammot_graph.detection.base import Detection
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.ellipse_test import EllipseTestConfig, detect_moving, packed_covariances
from slammot_graph.detection.scan_history import ScanHistory, ScanRecord
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid
from slammot_graph.tracking.base import ScanView, Tracker
from slammot_graph.tracking.smoothing import SightingHistory

VIEWS_BYTES, BYTES_OF_BEAM = 32 << 20, 70
"""Memory of the views of scans that are kept, and of a beam of one."""


def retrospective_labels(
    history: Sequence[ScanRecord],
    T_map_base: FloatArray,
    *,
    grid: GridConfig,
    window_m: float | None,
    ellipse_test: EllipseTestConfig,
    clusters: ClusterConfig,
    tracker: Tracker,
) -> list[BoolArray]:
    """Give the final labels of a run.

    Parameters
    ----------
    history : sequence of n `ScanRecord`
        In the order of the log.
    T_map_base : (n, 3) array
        Optimised poses.
    grid, window_m, ellipse_test, clusters
        As of the test at the time.
    tracker : Tracker
        A new one.

    Returns
    -------
    n bool arrays, one entry a beam.
    """
    n = len(history)
    memory = OccupancyGrid(grid, window_m=window_m)
    last_in_window = _last_in_window(history)
    labels: list[BoolArray] = [np.empty(0, dtype=np.bool_)] * n
    for k in range(n - 1, -1, -1):
        now = n - 1 - k
        item, T = history[k], T_map_base[k]
        memory.oldest = n - 1 - last_in_window[k]
        expected = tracker.predicted_positions(-item.scan.stamp)
        later = detect_moving(
            item.scan, item.is_valid, T, item.cov_relative, memory, ellipse_test, clusters, expected
        )
        origins = item.scan.origins_base
        ends = se2.transform(T, np.vstack([origins, item.scan.points_base()]))
        origins, points = ends[: len(origins)], ends[len(origins) :]
        labels[k] = _combine(item, later, _follow(tracker, item, later, points))
        is_static = item.is_valid & ~labels[k]
        memory.update(now, origins, points, item.is_valid, is_static, labels[k])
    return labels


def sightings_of_views(
    view_of: Callable[[int], ScanView], stamps: FloatArray, T_map_base: FloatArray, tracker: Tracker
) -> FloatArray:
    """Track once more, forward, what the final labels call moving: who was seen too late at the time is seen at once.

    Who came while nobody looked and stood for good is furniture to the labels, but still an object that was followed.

    Parameters
    ----------
    view_of : callable
        As of `final_views`.
    stamps : (n,) array [s]
        Of the scans.
    T_map_base : (n, 3) array
        Optimised poses.
    tracker : Tracker
        A new one.

    Returns
    -------
    (m, 9) array
        As of `SightingHistory.table`.
    """
    found = SightingHistory()
    for k, stamp in enumerate(stamps.tolist()):
        tracker.update(stamp, _NO_CENTRES, _NO_COVS, (), None, view_of(k))
        if tracker.sightings is not None:
            found.add(k, tracker.sightings, T_map_base[k])
    return found.table()


def final_views(
    history: ScanHistory,
    T_map_base: FloatArray,
    labels: Sequence[BoolArray],
    *,
    ellipse_test: EllipseTestConfig,
    range_fraction: float,
) -> Callable[[int], ScanView]:
    """Give the view of a scan by its number, at its final pose and with what its final labels call moving.

    The latest `VIEWS_BYTES` of them are kept: who tracks and who then asks about the tracks see the same scans.

    Parameters
    ----------
    history, T_map_base
        As of `retrospective_labels`.
    labels : n bool arrays
    ellipse_test : EllipseTestConfig
        The beams' noise.
    range_fraction : float
        From this share of the laser's `range_max` on, a range is no return.
    """
    has_several = history.n_lasers > 1

    def view_of(k: int) -> ScanView:
        item, T = history[k], T_map_base[k]
        is_moving = labels[k] | item.is_lasting
        view = ScanView.of_scan(
            item.scan,
            T,
            item.scan.points(T),
            packed_cov=packed_covariances(item.scan, T, item.cov_relative, ellipse_test),
            cluster=np.where(is_moving, 0, -1),
            is_proven=is_moving,
            is_valid=item.is_valid,
            range_fraction=range_fraction,
        )
        return view.by_one_of_several() if has_several else view

    n_beams = max((len(one) for one in labels), default=0)
    return lru_cache(max(VIEWS_BYTES // (BYTES_OF_BEAM * n_beams + 1000), 64))(view_of)


_NO_CENTRES: FloatArray = np.empty((0, 2))
_NO_COVS: FloatArray = np.empty((0, 2, 2))


def _combine(item: ScanRecord, later: Detection, walks_later: BoolArray) -> BoolArray:
    """Moving if called so then or now; a wall there later overrules what has not moved.

    At a pose that no match supports, what was decided at the time stays.
    """
    if item.is_doubtful:
        return item.is_moving
    before = item.is_moving & ((later.reason != reasons.OCCUPIED) | item.is_displaced)
    after = later.is_moving & (~item.is_wall | walks_later)
    return np.asarray(before | after)


def _last_in_window(history: Sequence[ScanRecord]) -> list[int]:
    """For each scan the last one whose own memory still holds it."""
    last = list(range(len(history)))
    reached = 0
    for k, item in enumerate(history):
        while reached < item.window:
            last[reached] = max(k - 1, reached)
            reached += 1
    for k in range(reached, len(history)):
        last[k] = len(history) - 1
    return last


def _follow(tracker: Tracker, item: ScanRecord, later: Detection, points: FloatArray) -> BoolArray:
    """Track backward in time; returns the beams on objects that have moved.

    Of those that were mostly wall only the beams on cells that were free later: who stood there until he went.
    """
    tracker.update(-item.scan.stamp, *later.clusters(points))
    is_displaced = np.zeros(len(points), dtype=np.bool_)
    for track in tracker.displaced():
        is_free = later.reason[track.beams] == reasons.FREE
        mostly_wall = 2 * np.count_nonzero(item.is_wall[track.beams]) > len(track.beams)
        is_displaced[track.beams] = is_free if mostly_wall else True
    return is_displaced
