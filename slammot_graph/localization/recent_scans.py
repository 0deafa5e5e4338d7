"""Where the robot was at the latest scans, and where it can have come to since: what a match is held against."""

import math

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray

N_LEAPS, LEAP_M = 3, 0.1
"""So many scans in a row matched that far from their predictions, to within so much: the one before them was wrong."""

REACH = 2.0
"""A robot may have driven and turned so many times as far as it is told, or did lately."""


class RecentScans:
    """The poses at the two scans before, what the odometry tells since, and matches that leapt away from it.

    Attributes
    ----------
    T_local_before, T_local_earlier : (3,) arrays
    has_odometry : bool
        Between the scan before and this one.
    most_change_m : float
        How far the robot can have come off the motion that the odometry tells.
    """

    def __init__(self) -> None:
        self.T_local_before: FloatArray = se2.IDENTITY
        self.T_local_earlier: FloatArray = se2.IDENTITY
        self.has_odometry = False
        self.most_change_m = math.inf
        self._leap: FloatArray | None = None
        self._leaps: list[FloatArray] = []

    def start_scan(self, T_local_before: FloatArray, *, has_odometry: bool, most_change_m: float) -> None:
        """Move on to the next scan."""
        self.T_local_earlier, self.T_local_before = self.T_local_before, T_local_before
        self.has_odometry, self.most_change_m = has_odometry, most_change_m
        self._leaps = [] if self._leap is None else [*self._leaps[2 - N_LEAPS :], self._leap]
        self._leap = None

    def starts(self) -> list[FloatArray]:
        """Where the robot was before, and where its last motion leads."""
        last = se2.between(self.T_local_earlier, self.T_local_before)
        return [self.T_local_before, se2.compose(self.T_local_before, last)]

    def farthest(self, T_predicted: FloatArray) -> tuple[float, float]:
        """How far [m, rad] the robot may have moved since the scan before, by the prediction (3,) or as lately."""
        told_m, told_rad = se2.distance(self.T_local_before, T_predicted)
        lately_m, lately_rad = se2.distance(self.T_local_earlier, self.T_local_before)
        return REACH * max(told_m, lately_m), REACH * max(told_rad, lately_rad)

    def is_out_of_reach(self, T_predicted: FloatArray, T_matched: FloatArray) -> bool:
        """Tell whether a match (3,) lies where no robot can have come to, if the odometry is right.

        If it is the scan before that was matched wrongly, the next ones are matched as far away: then it is believed.
        What is out of reach is remembered for that.
        """
        offset = se2.between(T_predicted, T_matched)
        if not np.hypot(offset[0], offset[1]) > self.most_change_m:
            return False
        self._leap = offset
        is_confirmed = len(self._leaps) == N_LEAPS - 1 and all(
            np.hypot(*(offset - leap)[:2]) < LEAP_M for leap in self._leaps
        )
        return not is_confirmed
