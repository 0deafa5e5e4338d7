"""Final labels: every scan tested again, at its best pose, with what was seen after it.

The moving-point test runs once more from the last scan to the first. Who stood there when the laser first looked
and displaced away later is found, since the cells were free afterwards; what was called moving online but was hit by
static points later is a wall after all, unless it belongs to an object that has displaced.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection import reasons
from slammot_graph.detection.base import NO_CLUSTERS, Detection
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
    windows = history.windows if isinstance(history, ScanHistory) else [item.window for item in history]
    last_in_window = _last_in_window(windows)
    labels: list[BoolArray] = [np.empty(0, dtype=np.bool_)] * n
    for k in range(n - 1, -1, -1):
        now = n - 1 - k
        item, T = history[k], T_map_base[k]
        memory.oldest = n - 1 - last_in_window[k]
        expected = tracker.predicted_positions(-item.scan.stamp)
        later = detect_moving(
            item.scan, item.is_valid, T, item.cov_relative, memory, ellipse_test, clusters, expected
        )
        origins, points = se2.transform(T, item.scan.origins_base), item.scan.points(T)
        labels[k] = _combine(item, later, _follow(tracker, item, later, points))
        is_static = item.is_valid & ~labels[k]
        memory.update(now, origins, points, item.is_valid, is_static, labels[k])
    return labels


def sightings_of_views(
    views: "FinalViews", stamps: FloatArray, T_map_base: FloatArray, tracker: Tracker
) -> FloatArray:
    """Track once more, forward, what the final labels call moving: who was seen too late at the time is seen at once.

    Who came while nobody looked and stood for good is furniture to the labels, but still an object that was followed.

    Parameters
    ----------
    views : FinalViews
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
        view = views(k) if tracker.n_tracks else views.where_something_moves(k)
        tracker.update(stamp, *NO_CLUSTERS, view)
        sightings = None if view is None else tracker.sightings
        if sightings is not None:
            found.add(k, sightings, T_map_base[k])
    return found.table()


class FinalViews:
    """The view of a scan by its number, at its final pose and with what its final labels call moving.

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

    def __init__(
        self,
        history: ScanHistory,
        T_map_base: FloatArray,
        labels: Sequence[BoolArray],
        *,
        ellipse_test: EllipseTestConfig,
        range_fraction: float,
    ) -> None:
        self._history, self._T_map_base, self._labels = history, T_map_base, labels
        self._ellipse_test, self._range_fraction = ellipse_test, range_fraction
        self._has_several = history.n_lasers > 1
        n_beams = max((len(one) for one in labels), default=0)
        self._view = lru_cache(max(VIEWS_BYTES // (BYTES_OF_BEAM * n_beams + 1000), 64))(self._view_of)

    def __call__(self, k: int) -> ScanView:
        """Give the view of scan k."""
        return self._view(k)

    def where_something_moves(self, k: int) -> ScanView | None:
        """Give the view of scan k if some of it moves."""
        return self._view(k) if self._labels[k].any() or self._history[k].is_lasting.any() else None

    def _view_of(self, k: int) -> ScanView:
        item, T = self._history[k], self._T_map_base[k]
        is_moving = self._labels[k] | item.is_lasting
        view = ScanView.of_scan(
            item.scan,
            T,
            item.scan.points(T),
            packed_cov=packed_covariances(item.scan, T, item.cov_relative, self._ellipse_test),
            cluster=np.where(is_moving, 0, -1),
            is_proven=is_moving,
            is_valid=item.is_valid,
            range_fraction=self._range_fraction,
        )
        return view.by_one_of_several() if self._has_several else view


def _combine(item: ScanRecord, later: Detection, walks_later: BoolArray) -> BoolArray:
    """Moving if called so then or now; a wall there later overrules what has not moved.

    At a pose that no match supports, what was decided at the time stays.
    """
    if item.is_doubtful:
        return item.is_moving
    before = item.is_moving & ((later.reason != reasons.OCCUPIED) | item.is_displaced)
    after = later.is_moving & (~item.is_wall | walks_later)
    return np.asarray(before | after)


def _last_in_window(windows: Sequence[int]) -> list[int]:
    """For each scan the last one whose own memory still holds it, by the scans with which their memories began."""
    last = list(range(len(windows)))
    reached = 0
    for k, window in enumerate(windows):
        while reached < window:
            last[reached] = max(k - 1, reached)
            reached += 1
    for k in range(reached, len(windows)):
        last[k] = len(windows) - 1
    return last


def _follow(tracker: Tracker, item: ScanRecord, later: Detection, points: FloatArray) -> BoolArray:
    """Track backward in time; returns the beams on objects that have moved.

    Of those that were mostly wall only the beams on cells that were free later: who stood there until he went.
    """
    tracker.update(-item.scan.stamp, *(later.clusters(points) if later.n_clusters else NO_CLUSTERS))
    is_displaced = np.zeros(len(points), dtype=np.bool_)
    if not tracker.n_tracks:
        return is_displaced
    for track in tracker.displaced():
        is_free = later.reason[track.beams] == reasons.FREE
        mostly_wall = 2 * np.count_nonzero(item.is_wall[track.beams]) > len(track.beams)
        is_displaced[track.beams] = is_free if mostly_wall else True
    return is_displaced
