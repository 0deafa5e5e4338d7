"""Places where something stood a moment ago and the laser now sees through: whoever stood there has moved.

Free cells cannot tell of a person who walks in the robot's own direction, since he always stands where nobody has
looked before. But where he stood a moment ago is empty now. (Visibility-based change detection, as Pomerleau et
al. 2014 do it for maps.)
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slammot_graph.core.checks import Checked, Count, NotNegative, Positive, Share
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection import _kernels


@dataclass(frozen=True, kw_only=True)
class VisibilityCheckConfig(Checked):
    """With which earlier scan the present one is compared, and what follows.

    Attributes
    ----------
    reach_m : float
        A beam on unknown cells moves if it ends this near to a place that is empty now.
    distance_m, age_s : float
        The earlier scan was taken at least this distance or this time before, whichever is reached first.
    margin_m : float
        The laser must see past the place by this much.
    min_run : int
        Neighbouring points that must all be gone.
    min_p : float
        What is called moving by this alone must be so probably moving by all evidence ...
    crowd_share : float
        ... unless more than this share of the scan moves.
    """

    reach_m: Positive = 0.5
    distance_m: Positive = 0.3
    age_s: Positive = 1.0
    margin_m: NotNegative = 0.15
    min_run: Count = 3
    min_p: Share = 0.2
    crowd_share: Share = 0.15


class _Seen(NamedTuple):
    """A scan of the last moments: when and where it was taken, and its points, in the local frame."""

    stamp_s: float
    x: float
    y: float
    points: FloatArray
    is_valid: BoolArray


class VisibilityCheck:
    """Remembers the scans of the last moments."""

    def __init__(self, config: VisibilityCheckConfig) -> None:
        self.config = config
        self._seen: dict[int, deque[_Seen]] = {}

    def remember(
        self,
        stamp_s: float,
        T_local_base: FloatArray,
        points: FloatArray,
        is_valid: BoolArray,
        laser: int = 0,
    ) -> None:
        """Take in a scan at its matched pose (3,): its points (n, 2) [m], local frame, and which are returns (n,).

        Scans are compared with earlier ones of the same laser, by its number.
        """
        x, y, _ = T_local_base.tolist()
        self._seen.setdefault(laser, deque()).append(_Seen(stamp_s, x, y, points, is_valid))

    def vacated(self, scan: Scan, T_local_base: FloatArray, is_valid: BoolArray) -> FloatArray:
        """(k, 2) points [m] of an earlier scan that this one, at its pose (3,), sees through; local frame."""
        x, y, _ = T_local_base.tolist()
        laser = scan.laser
        seen = self._seen.get(laser.number)
        if seen is None:
            return np.empty((0, 2))
        while len(seen) > 1 and self._is_old(seen[1], scan.stamp, x, y):
            seen.popleft()
        if not self._is_old(seen[0], scan.stamp, x, y):
            return np.empty((0, 2))
        earlier = seen[0]
        gone = np.empty(earlier.points.shape)
        n_gone = _kernels.seen_through(
            earlier.points,
            earlier.is_valid,
            T_local_base,
            scan.origins_base,
            scan.directions_base,
            laser.angle_min + laser.T_base_laser[2],
            laser.angle_increment,
            scan.ranges,
            is_valid,
            self.config.margin_m,
            self.config.min_run,
            gone,
        )
        return gone[:n_gone]

    def _is_old(self, seen: _Seen, stamp_s: float, x: float, y: float) -> bool:
        return (
            math.hypot(x - seen.x, y - seen.y) >= self.config.distance_m
            or stamp_s - seen.stamp_s >= self.config.age_s
        )
