"""Scans that tell nothing of where the robot is: a laser that repeats itself, or that something covers.

Both look like a robot that stands, and the matches on them would hold it there for as long as they last.
"""

import zlib
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import Event, make_event
from slammot_graph.core.scan import NO_RETURN_FRACTION, Scan
from slammot_graph.core.types import BoolArray, FloatArray

Blindness = Literal["repeated", "covered", "partly covered"]

MOVED_M, MOVED_RAD = 0.02, 0.01
"""By so much the odometry has moved while a laser that has seen it move cannot give the same numbers again."""
N_REMEMBERED = 100
"""Scans: a driver that repeats itself may send several old ones in turn."""
STEP_M, STEP_RAD = 0.02, 0.02
"""Without odometry: a robot that made such a step just before does not stand still, dead, at the next scan."""
NEAR_M = 1.5
"""A cover is nearer: it touches the robot, or rides on it."""
NEAR_SHARE = 0.8
"""Of the beams, at least, so that it is the laser that is covered and not the robot that is approached."""
PART_SHARE = 0.55
"""Of the beams, at least, so that what is before them at once rides on the robot: a person would have to touch it."""
SHRUNK_M, SHRUNK_M_S = 0.3, 3.0
"""Beams that shorten by more, at once and with time, are cut off by something that comes: robots do not drive so."""
SHRUNK_SHARE = 0.5
"""Of the beams that had a return before: the others saw something near already."""
SHRUNK_PART_SHARE = 0.25
"""Of all beams, where some are free: between walls close by a cover shortens few."""
CUT_M = 0.05
"""Then beams that have become shorter by more are surely covered, others that end close by may be."""
LEAST_SEEN_SHARE = 0.3
"""Of the beams that had a return before: of others it is not known how far they saw."""
LATELY_S = 0.5
"""Within such a time a laser is covered: it is compared with how far it saw before."""
APART_M, APART_RAD = 0.22, 0.2
"""On such a way the view changes by itself, however short a time the stamps tell of."""
LONGEST_GAP_S = 1.0
"""Between scans; beyond, nothing is known of how the view changed."""
SAME_M, SAME_SHARE_OF_RANGE = 0.05, 0.1
"""By so much a cover moves before the laser."""
DRIVEN_M, DRIVEN_RAD = 0.3, 0.3
"""On such a way what is near and stands on the floor has changed its place before the laser, and a cover has not."""
_LOOKED_AT = (0.1, 0.3, 0.5, 0.7, 0.9)  # beams that tell at no cost that most are not near


class _View(NamedTuple):
    """What a laser saw at a time; of a cover, which beams (n_beams,) it may cut off, and which it surely does.

    `T_base` is where the odometry has the robot; without odometry where it was found at the scan before.
    """

    stamp: float
    ranges: FloatArray
    T_base: FloatArray | None
    is_cut: BoolArray | None = None
    has_come: BoolArray | None = None


class BlindScans:
    """Tells scans that a laser repeats while the robot moves, and beams of a laser that is covered.

    A scan that is the same to the last bit as one before is no measurement: real lasers have noise, and a scan of a
    place that the robot has left is an old one. Without odometry the steps before tell that it moves. A laser is
    covered once most of its beams have become shorter at once than any motion explains and end close by; until they
    reach farther, or the robot drives and what is close changes its place as walls do: then it was kidnapped into a
    small room. Where some beams are free, these are used. Each of several lasers is judged by itself.
    """

    def __init__(self) -> None:
        self._of_laser: dict[int, _OneLaser] = {}
        self._latest: dict[int, Blindness | None] = {}
        self._T_local_base: FloatArray | None = None
        self._is_moving = False

    def found_at(self, T_local_base: FloatArray) -> None:
        """Take in where the robot (3,) was found to be at the latest scan."""
        if self._T_local_base is not None:
            way_m, turn_rad = se2.distance(self._T_local_base, T_local_base)
            self._is_moving = way_m > STEP_M or turn_rad > STEP_RAD
        self._T_local_base = T_local_base

    def emptied(self, scan: Scan) -> tuple[Scan, tuple[Event, ...]]:
        """Give the next scan, without the ranges that tell nothing; and the event where that begins."""
        number = scan.laser.number
        before, now = self._latest.get(number), self.look_at(scan)
        self._latest[number] = now
        if now is None:
            return scan, ()
        is_cut = self._of_laser[number].is_cut(now)
        free = replace(scan, ranges=np.where(is_cut, np.nan, scan.ranges))
        return free, () if now == before else (make_event("laser blind", scan.index, cause=now),)

    def look_at(self, scan: Scan) -> Blindness | None:
        """Say what is wrong with the next scan; None for one that can be used."""
        one = self._of_laser.get(scan.laser.number)
        if one is None:
            one = self._of_laser[scan.laser.number] = _OneLaser()
        T_base = self._T_local_base if scan.T_odom_base is None else scan.T_odom_base
        return one.look_at(scan, T_base, is_moving=self._is_moving)


class _OneLaser:
    def __init__(self) -> None:
        self._fresh: dict[
            tuple[int, int], FloatArray | None
        ] = {}  # where the odometry was when they came first
        self._is_stale = False
        self._lately: list[_View] = []
        self._cover: _View | None = None

    def look_at(self, scan: Scan, T_base: FloatArray | None, *, is_moving: bool) -> Blindness | None:
        if self._is_covered(scan, T_base):
            return "partly covered" if self.is_cut("covered") is not True else "covered"
        self._is_stale = self._is_repeated(scan, is_moving=is_moving)
        return "repeated" if self._is_stale else None

    def is_cut(self, cause: Blindness) -> BoolArray | Literal[True]:
        """(n_beams,) mask of the beams of the latest scan that tell nothing for this cause; True: none does."""
        is_cut = None if cause == "repeated" or self._cover is None else self._cover.is_cut
        return True if is_cut is None else is_cut

    def _is_repeated(self, scan: Scan, *, is_moving: bool) -> bool:
        data = scan.ranges.tobytes()
        key = zlib.crc32(data), zlib.adler32(data)
        if key not in self._fresh:
            if len(self._fresh) == N_REMEMBERED:
                del self._fresh[next(iter(self._fresh))]
            self._fresh[key] = scan.T_odom_base
            return False
        if not _has_returns(scan):
            return False
        T_odom_fresh = self._fresh[key]
        if scan.T_odom_base is None or T_odom_fresh is None:
            return self._is_stale or is_moving
        way_m, turn_rad = se2.distance(T_odom_fresh, scan.T_odom_base)
        return way_m > MOVED_M or turn_rad > MOVED_RAD

    def _is_covered(self, scan: Scan, T_base: FloatArray | None) -> bool:
        view = _View(scan.stamp, scan.ranges, T_base)
        if self._cover is not None:
            if len(view.ranges) == len(self._cover.ranges) and self._still_covers(self._cover, view):
                self._spread(view)
                return True
            self._cover, self._lately = None, []
        if self._lately:
            last = self._lately[-1]
            if not 0.0 <= view.stamp - last.stamp < LONGEST_GAP_S or len(last.ranges) != len(view.ranges):
                self._lately = []
        self._cover = self._what_has_come(scan, view)
        if self._cover is not None:
            return True
        while self._lately and view.stamp - self._lately[0].stamp > LATELY_S:
            del self._lately[0]
        self._lately.append(view)
        return False

    def _spread(self, view: _View) -> None:
        """Let a cover that has just come grow over more beams."""
        cover = self._cover
        if cover is None or cover.is_cut is None or view.stamp - cover.stamp > LATELY_S:
            return
        is_cut = cover.is_cut | ((view.ranges <= NEAR_M) & ~(view.ranges >= cover.ranges - SHRUNK_M))
        is_whole = np.count_nonzero(is_cut) >= NEAR_SHARE * len(is_cut)
        self._cover = cover._replace(is_cut=None) if is_whole else cover._replace(is_cut=is_cut)

    def _what_has_come(self, scan: Scan, view: _View) -> _View | None:
        """Give what covers the laser: most beams end close by that reached farther lately."""
        ranges, n = scan.ranges, len(scan.ranges)
        if not self._lately:
            return None
        n_far = 0
        for share in _LOOKED_AT:
            n_far += not ranges.item(int(share * n)) <= NEAR_M
            if n_far == 3:
                return None
        is_near: BoolArray = scan.is_valid() & (ranges <= NEAR_M)
        n_near = np.count_nonzero(is_near)
        is_whole = n_near >= NEAR_SHARE * n
        if n_near < PART_SHARE * n:
            return None
        from_here = [before for before in self._lately if not _is_apart(before, view)]
        for before in (*from_here[:1], *from_here[-1:]):
            was = before.ranges
            was_seen = np.isfinite(was) & (was > 0.0) & (was < NO_RETURN_FRACTION * scan.laser.range_max)
            n_seen = np.count_nonzero(was_seen)
            if n_seen < LEAST_SEEN_SHARE * n:
                continue
            limit = SHRUNK_M + SHRUNK_M_S * (scan.stamp - before.stamp)
            n_shorter = np.count_nonzero(was_seen & is_near & (ranges < was - limit))
            if is_whole and n_shorter >= SHRUNK_SHARE * n_seen:
                return view
            # that a part rides on the robot, and does not stand on the floor, is known by driving alone
            if view.T_base is not None and n_shorter >= SHRUNK_PART_SHARE * n:
                has_come = is_near & ~(ranges >= was - CUT_M)
                return view._replace(is_cut=None if is_whole else is_near, has_come=has_come)
        return None

    def _still_covers(self, cover: _View, view: _View) -> bool:
        """Whether most of its beams still end close by, and at the same places however the robot drives."""
        now, then = view.ranges, cover.ranges
        if cover.has_come is not None:
            now, then = now[cover.has_come], then[cover.has_come]
        if np.count_nonzero(now <= NEAR_M) < 0.5 * len(now):
            return False
        if cover.T_base is None or view.T_base is None:
            return True
        way_m, turn_rad = se2.distance(cover.T_base, view.T_base)
        if way_m < DRIVEN_M and turn_rad < DRIVEN_RAD:
            return True
        is_same = np.abs(now - then) <= SAME_M + SAME_SHARE_OF_RANGE * then
        self._cover = view._replace(is_cut=cover.is_cut, has_come=cover.has_come)
        return bool(np.count_nonzero(is_same) >= 0.5 * len(now))


def _is_apart(before: _View, view: _View) -> bool:
    """Whether the robot has driven or turned far between two views, as far as that is known."""
    if before.T_base is None or view.T_base is None:
        return False
    way_m, turn_rad = se2.distance(before.T_base, view.T_base)
    return way_m > APART_M or turn_rad > APART_RAD


def _has_returns(scan: Scan) -> bool:
    """Whether there is anything that noise would change; where nothing is in reach, scans are the same."""
    return bool(np.count_nonzero(scan.is_valid()) > 1)
