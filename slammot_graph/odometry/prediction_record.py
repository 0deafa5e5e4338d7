"""What was predicted for a scan and found, and how well the predictions did so far."""

from typing import NamedTuple

import numpy as np

from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.doubt import DoubtConfig, OdometryDoubt
from slammot_graph.odometry.motion import MatchedPose, Motion

N_BEFORE = 2
"""The first comparisons of both predictions count as if so many without any error stood before them."""


class Located(NamedTuple):
    """The latest scan of a laser: its time [s], where the base was found (3,), whether it had odometry, its match."""

    time_s: float
    T_local_base: FloatArray
    has_odometry: bool
    match: MatchedPose | None


class PredictionRecord:
    """What was predicted for the latest scan, and how well both predictions did so far."""

    def __init__(self, doubt: DoubtConfig) -> None:
        self.doubt = OdometryDoubt(doubt)
        self.n_by_odometry = 0
        self.n_by_previous = 0
        self.n_impossible = 0
        self.has_odometry = False
        self.is_odometry_used = True
        self.is_possible = True
        self.told: Motion | None = None
        self.told_possible: FloatArray | None = None
        self.previous: FloatArray = np.zeros(3)
        # share of returns that agree with the matches
        self.agreement = RunningMeans(1)
        # squared error of the odometry and of the previous motion, excess of the odometry
        self.errors = RunningMeans(3, n_before=N_BEFORE)

    def start_scan(self, told: Motion | None, previous: FloatArray) -> None:
        """Take in both predictions of the next motion, the previous one as its increment (3,)."""
        self.told, self.previous = told, previous
        self.has_odometry |= told is not None

    def count(self, *, use_odometry: bool, is_possible: bool) -> None:
        """Count what was used."""
        self.is_possible = is_possible
        if is_possible:
            self.told_possible = None if self.told is None else self.told.increment
        self.is_odometry_used = use_odometry
        self.n_by_odometry += use_odometry
        self.n_by_previous += not use_odometry
        self.n_impossible += not is_possible


class RunningMeans:
    """Means of which the latest value has a fixed weight, and at first that of an equal share.

    Attributes
    ----------
    values : (n,) array
    """

    def __init__(self, n: int, n_before: int = 0) -> None:
        self.values = np.zeros(n)
        self._n = n_before

    def gain(self, gain: float) -> float:
        """Weight of the next value."""
        self._n += 1
        return max(gain, 1.0 / self._n)

    def add(self, value: float, gain: float) -> None:
        """Take in the next value."""
        gain = self.gain(gain)
        for k, mean in enumerate(self.values.tolist()):
            self.values[k] = mean + gain * (value - mean)
