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
NEAR_M = 1.0
"""A cover is nearer: it touches the robot, or rides on it."""
NEAR_SHARE = 0.8
"""Of the beams, at least, so that it is the laser that is covered and not the robot that is approached."""
SHRUNK_M, SHRUNK_M_S = 0.3, 3.0
"""Beams that shorten by more, at once and with time, are cut off by something that comes: robots do not drive so."""
SHRUNK_SHARE = 0.5
"""Of the beams that had a return before: the others saw something near already."""
LEAST_SEEN_SHARE = 0.3
"""Of the beams that had a return before: of others it is not known how far they saw."""
LATELY_S = 0.5
"""Within such a time a laser is covered: it is compared with how far it saw before."""
LONGEST_GAP_S = 1.0
"""Between scans; beyond, nothing is known of how the view changed."""
SAME_M, SAME_SHARE_OF_RANGE = 0.05, 0.1
"""By so much a cover moves before the laser."""
DRIVEN_M, DRIVEN_RAD = 0.3, 0.3
"""On such a way what is near and stands on the floor has changed its place before the laser, and a cover has not."""
_LOOKED_AT = (0.1, 0.3, 0.5, 0.7, 0.9)  # beams that tell at no cost that most are not near


class _View(NamedTuple):
    """What a laser saw at a time."""

    stamp: float
    ranges: FloatArray
    T_odom_base: FloatArray | None


class BlindScans:
    """Tells scans that a laser repeats while the odometry moves, and those of a laser that is covered.

    A scan that is the same to the last bit is no measurement: real lasers have noise, and a scan of a place that the
    robot has left is an old one. A laser is covered once most of its beams have become shorter at once than any motion
    explains and nearly all end close by; until they reach farther, or the robot drives and what is close changes its
    place as walls do: then it was kidnapped into a small room. Each of several lasers is judged by itself.
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
        self._lately: list[_View] = []
        self._cover: _View | None = None

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
        view = _View(scan.stamp, scan.ranges, scan.T_odom_base)
        if self._cover is not None:
            if len(view.ranges) == len(self._cover.ranges) and self._still_covers(self._cover, view):
                return True
            self._cover, self._lately = None, []
        if self._lately:
            last = self._lately[-1]
            if not 0.0 <= view.stamp - last.stamp < LONGEST_GAP_S or len(last.ranges) != len(view.ranges):
                self._lately = []
        if self._has_come(scan):
            self._cover = view
            return True
        while self._lately and view.stamp - self._lately[0].stamp > LATELY_S:
            del self._lately[0]
        self._lately.append(view)
        return False

    def _has_come(self, scan: Scan) -> bool:
        """Whether nearly all beams end close by that reached farther lately."""
        ranges, n = scan.ranges, len(scan.ranges)
        if not self._lately:
            return False
        n_far = 0
        for share in _LOOKED_AT:
            n_far += not ranges.item(int(share * n)) <= NEAR_M
            if n_far == 3:
                return False
        if np.count_nonzero(scan.is_valid() & (ranges <= NEAR_M)) < NEAR_SHARE * n:
            return False
        for before in (self._lately[0], self._lately[-1]):
            was = before.ranges
            was_seen = np.isfinite(was) & (was > 0.0) & (was < NO_RETURN_FRACTION * scan.laser.range_max)
            n_seen = np.count_nonzero(was_seen)
            limit = SHRUNK_M + SHRUNK_M_S * (scan.stamp - before.stamp)
            n_shorter = np.count_nonzero(was_seen & (ranges < was - limit))
            if n_seen >= LEAST_SEEN_SHARE * n and n_shorter >= SHRUNK_SHARE * n_seen:
                return True
        return False

    def _still_covers(self, cover: _View, view: _View) -> bool:
        """Whether most beams still end close by, and at the same places however the robot drives."""
        is_near = view.ranges <= NEAR_M
        if np.count_nonzero(is_near) < 0.5 * len(view.ranges):
            return False
        if cover.T_odom_base is None or view.T_odom_base is None:
            return True
        x, y, theta = se2.between(cover.T_odom_base, view.T_odom_base)
        if np.hypot(x, y) < DRIVEN_M and abs(theta) < DRIVEN_RAD:
            return True
        is_same = np.abs(view.ranges - cover.ranges) <= SAME_M + SAME_SHARE_OF_RANGE * cover.ranges
        self._cover = view
        return bool(np.count_nonzero(is_same) >= 0.5 * len(view.ranges))


def _has_returns(scan: Scan) -> bool:
    """Whether there is anything that noise would change; where nothing is in reach, scans are the same."""
    ranges = scan.ranges[scan.is_valid()]
    return len(ranges) > 1 and bool(np.ptp(ranges) > 0.0)
