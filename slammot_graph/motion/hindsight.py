"""Final labels: every scan judged again, at its best pose, with what was seen after it.

The moving-point test runs once more from the last scan to the first. Who stood there when the laser first looked
and walked away later is found, since the cells were free afterwards; what was called moving online but was hit by
static points later is a wall after all, unless it belongs to an object that has walked.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

from slammot_graph import se2
from slammot_graph.grid import GridConfig, OccupancyGrid
from slammot_graph.motion import reasons
from slammot_graph.motion.clusters import ClusterConfig
from slammot_graph.motion.ellipse import Detection, MotionConfig, detect_moving
from slammot_graph.motion.tracks import TrackConfig, Tracker
from slammot_graph.scan import LaserModel, Scan
from slammot_graph.types import BoolArray, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """What was decided about a scan at its time.

    Attributes
    ----------
    scan : Scan
    is_valid, is_moving : (n,) bool arrays
    is_wall : (n,) bool array
        Beams that hit an occupied cell.
    has_walked : (n,) bool array
        Beams on tracked objects that have walked.
    cov_relative : (3, 3) array
        Covariance of the matched pose in the test.
    window : int
        Number of the scan in the log with which the test's memory began.
    is_doubtful : bool
        The scan could not be matched.
    """

    scan: Scan
    is_valid: BoolArray
    is_moving: BoolArray
    is_wall: BoolArray
    has_walked: BoolArray
    cov_relative: FloatArray
    window: int
    is_doubtful: bool


class Judgements(Sequence[Judged]):
    """What was decided about all scans of a run, packed: about 1 kB for a scan of 181 beams."""

    def __init__(self) -> None:
        self._packed: list[_Packed] = []

    def append(self, item: Judged) -> None:
        """Add the next scan's."""
        masks = 8 * item.has_walked.view(np.uint8) + 4 * item.is_wall.view(np.uint8)
        masks += 2 * item.is_moving.view(np.uint8) + item.is_valid.view(np.uint8)
        self._packed.append(
            _Packed(
                index=item.scan.index,
                stamp=item.scan.stamp,
                laser=item.scan.laser,
                ranges=item.scan.ranges.astype(np.float32),
                masks=masks,
                cov_relative=item.cov_relative.astype(np.float32),
                window=item.window,
                is_doubtful=item.is_doubtful,
            )
        )

    @overload
    def __getitem__(self, k: int) -> Judged: ...

    @overload
    def __getitem__(self, k: slice) -> list[Judged]: ...

    def __getitem__(self, k: int | slice) -> Judged | list[Judged]:
        """Unpack one or several."""
        if isinstance(k, slice):
            return [item.unpack() for item in self._packed[k]]
        return self._packed[k].unpack()

    def __len__(self) -> int:
        return len(self._packed)


@dataclass(frozen=True, kw_only=True, eq=False, slots=True)
class _Packed:
    """A `Judged` with ranges of half the bits, its masks as bits, and nothing that a scan can work out."""

    index: int
    stamp: float
    laser: LaserModel
    ranges: npt.NDArray[np.float32]
    masks: npt.NDArray[np.uint8]
    cov_relative: npt.NDArray[np.float32]
    window: int
    is_doubtful: bool

    def unpack(self) -> Judged:
        valid, moving, wall, walked = ((self.masks & bit).astype(np.bool_) for bit in (1, 2, 4, 8))
        ranges = self.ranges.astype(np.float64)
        return Judged(
            scan=Scan(
                index=self.index, stamp=self.stamp, ranges=ranges, laser=self.laser, T_odom_base=se2.IDENTITY
            ),
            is_valid=valid,
            is_moving=moving,
            is_wall=wall,
            has_walked=walked,
            cov_relative=self.cov_relative.astype(np.float64),
            window=self.window,
            is_doubtful=self.is_doubtful,
        )


def judge_in_hindsight(
    judged: Sequence[Judged],
    T_map_base: FloatArray,
    *,
    grid: GridConfig,
    window_m: float,
    motion: MotionConfig,
    clusters: ClusterConfig,
    tracks: TrackConfig,
) -> list[BoolArray]:
    """Give the final labels of a run.

    Parameters
    ----------
    judged : sequence of n `Judged`
        In the order of the log.
    T_map_base : (n, 3) array
        Optimised poses.
    grid, window_m, motion, clusters, tracks
        As of the test at the time.

    Returns
    -------
    n bool arrays, one entry a beam.
    """
    n = len(judged)
    memory = OccupancyGrid(grid, window_m=window_m)
    tracker = Tracker(tracks)
    last_in_window = _last_in_window(judged)
    labels: list[BoolArray] = [np.empty(0, dtype=np.bool_)] * n
    for k in range(n - 1, -1, -1):
        now = n - 1 - k
        item, T = judged[k], T_map_base[k]
        memory.oldest = n - 1 - last_in_window[k]
        expected = tracker.expected(-item.scan.stamp)
        later = detect_moving(
            item.scan, item.is_valid, T, item.cov_relative, memory, motion, clusters, expected
        )
        ends = se2.transform(T, np.vstack([item.scan.laser.origin_base, item.scan.points_base()]))
        labels[k] = _combine(item, later, _follow(tracker, item, later, ends[1:]))
        is_static = item.is_valid & ~labels[k]
        memory.update(now, ends[0], ends[1:], item.is_valid, is_static, labels[k])
    return labels


def _combine(item: Judged, later: Detection, walks_later: BoolArray) -> BoolArray:
    """Moving if called so then or now; a wall on the other side of time takes back what has not walked.

    At a pose that no match supports, what was decided at the time stays.
    """
    if item.is_doubtful:
        return item.is_moving
    before = item.is_moving & ((later.reason != reasons.OCCUPIED) | item.has_walked)
    after = later.is_moving & (~item.is_wall | walks_later)
    return np.asarray(before | after)


def _last_in_window(judged: Sequence[Judged]) -> list[int]:
    """For each scan the last one whose own memory still holds it."""
    last = list(range(len(judged)))
    reached = 0
    for k, item in enumerate(judged):
        while reached < item.window:
            last[reached] = max(k - 1, reached)
            reached += 1
    for k in range(reached, len(judged)):
        last[k] = len(judged) - 1
    return last


def _follow(tracker: Tracker, item: Judged, later: Detection, points: FloatArray) -> BoolArray:
    """Track backward in time; returns the beams on objects that have walked, less those that were mostly wall."""
    tracker.update(-item.scan.stamp, *later.clusters(points))
    has_walked = np.zeros(len(points), dtype=np.bool_)
    for track in tracker.walked():
        has_walked[track.beams] = 2 * np.count_nonzero(item.is_wall[track.beams]) <= len(track.beams)
    return has_walked
