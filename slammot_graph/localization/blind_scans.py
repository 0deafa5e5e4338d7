"""Scans that tell nothing of where the robot is: a laser that repeats itself, or that something covers.

Both look like a robot that stands, and the matches on them would hold it there for as long as they last.
"""

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import Event, make_event
from slammot_graph.core.scan import NO_RETURN_FRACTION, Scan
from slammot_graph.core.types import FloatArray

Blindness = Literal["repeated", "covered"]

MOVED_M, MOVED_RAD = 0.02, 0.01
"""By so much the odometry has moved while a laser that has seen it move cannot give the same numbers again."""
SHRUNK_M, SHRUNK_M_S = 0.3, 3.0
"""Beams that shorten by more, at once and with time, are cut off by something that comes: robots do not drive so."""
NEARER = 1.0 / 3.0
"""... and to less than this share: a robot that was kidnapped into a smaller room sees walls, not a cover."""
COVERED_SHARE = 0.9
"""Of the beams, at least, so that it is the laser that is covered and not the robot that is approached."""
LEAST_SEEN_SHARE = 0.3
"""Of the beams that had a return before: of others it is not known how far they saw."""
LATELY_S = 0.5
"""Within such a time a laser is covered: it is compared with how far it saw before."""
LONGEST_GAP_S = 1.0
"""Between scans; beyond, nothing is known of how the view changed."""
_LOOKED_AT = (0.1, 0.3, 0.5, 0.7, 0.9)  # beams that tell at no cost that most have not shortened


class _View(NamedTuple):
    """What a laser saw at a time."""

    stamp: float
    ranges: FloatArray


class BlindScans:
    """Tells scans that a laser repeats while the odometry moves, and those of a laser that is covered.

    A scan that is the same to the last bit is no measurement: real lasers have noise, and a scan of a place that the
    robot has left is an old one. A laser is covered from when nearly all its beams have become shorter than any motion
    explains, until most of them reach farther than that again. Each of several lasers is judged by itself.
    """

    def __init__(self) -> None:
        self._of_laser: dict[int, _OneLaser] = {}
        self._latest: dict[int, Blindness | None] = {}

    def emptied(self, scan: Scan) -> tuple[Scan, tuple[Event, ...]]:
        """Give the next scan, without a range where it tells nothing; and the event where that begins."""
        number = scan.laser.number
        before, now = self._latest.get(number), self.look_at(scan)
        self._latest[number] = now
        if now is None:
            return scan, ()
        nothing = replace(scan, ranges=np.full(len(scan.ranges), np.nan))
        return nothing, () if now == before else (make_event("laser blind", scan.index, cause=now),)

    def look_at(self, scan: Scan) -> Blindness | None:
        """Say what is wrong with the next scan; None for one that can be used."""
        one = self._of_laser.get(scan.laser.number)
        if one is None:
            one = self._of_laser[scan.laser.number] = _OneLaser()
        return one.look_at(scan)


class _OneLaser:
    def __init__(self) -> None:
        self._last = b""
        self._T_odom_fresh: FloatArray | None = None
        self._older: _View | None = None
        self._newer: _View | None = None
        self._cover: FloatArray | None = None

    def look_at(self, scan: Scan) -> Blindness | None:
        if self._is_covered(scan):
            return "covered"
        data = scan.ranges.tobytes()
        if data != self._last:
            self._last, self._T_odom_fresh = data, scan.T_odom_base
            return None
        if scan.T_odom_base is None or self._T_odom_fresh is None or not _has_returns(scan):
            return None
        x, y, theta = se2.between(self._T_odom_fresh, scan.T_odom_base)
        return "repeated" if np.hypot(x, y) > MOVED_M or abs(theta) > MOVED_RAD else None

    def _is_covered(self, scan: Scan) -> bool:
        ranges, stamp = scan.ranges, scan.stamp
        if self._cover is not None:
            is_longer = ~(ranges <= 2.0 * self._cover + SHRUNK_M) & ~np.isnan(ranges) & (ranges > 0.0)
            if len(ranges) == len(self._cover) and np.mean(is_longer) < 0.5:
                return True
            self._cover = self._older = self._newer = None
        before = self._older
        if (
            self._newer is None
            or not 0.0 <= stamp - self._newer.stamp < LONGEST_GAP_S
            or len(self._newer.ranges) != len(ranges)
        ):
            self._older = self._newer = _View(stamp, ranges)
            return False
        if stamp - self._newer.stamp >= 0.5 * LATELY_S:
            self._older, self._newer = self._newer, _View(stamp, ranges)
        if before is None:
            return False
        limit = SHRUNK_M + SHRUNK_M_S * (stamp - before.stamp)
        n, was = len(ranges), before.ranges
        n_longer = 0
        for share in _LOOKED_AT:
            k = int(share * n)
            n_longer += not ranges.item(k) < was.item(k) - limit
            if n_longer == 3:
                return False
        is_seen = scan.is_valid()
        was_seen = np.isfinite(was) & (was > 0.0) & (was < NO_RETURN_FRACTION * scan.laser.range_max)
        is_shorter = is_seen & was_seen & (ranges < was - limit) & (ranges < NEARER * was)
        if (
            np.count_nonzero(is_seen) < COVERED_SHARE * n
            or np.count_nonzero(was_seen) < LEAST_SEEN_SHARE * n
            or np.count_nonzero(is_shorter) < COVERED_SHARE * np.count_nonzero(was_seen)
        ):
            return False
        self._cover = ranges
        return True


def _has_returns(scan: Scan) -> bool:
    """Whether there is anything that noise would change; where nothing is in reach, scans are the same."""
    ranges = scan.ranges[scan.is_valid()]
    return len(ranges) > 1 and bool(np.ptp(ranges) > 0.0)
