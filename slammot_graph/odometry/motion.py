"""What a motion model gives and what it is told."""

from typing import NamedTuple

import numpy as np

from slammot_graph.core.types import FloatArray

NO_DOUBT: FloatArray = np.zeros(2)
NO_DOUBT.setflags(write=False)
"""The motion is not in doubt in any direction."""


class Motion(NamedTuple):
    """Motion of the base between two scans.

    Attributes
    ----------
    increment : (3,) array
        The base in its own frame at the scan before [m, m, rad].
    cov : (3, 3) array
        Its covariance, right perturbation (body frame).
    doubt : (2,) array
        Direction in which the way is in doubt, body frame; zero: in none.
    """

    increment: FloatArray
    cov: FloatArray
    doubt: FloatArray = NO_DOUBT

    def turned(self, turn_rad: float, std_rad: float) -> "Motion":
        """Take the turn from elsewhere, as an IMU."""
        increment, cov = self.increment.copy(), self.cov.copy()
        increment[2] = turn_rad
        cov[2, :] = cov[:, 2] = 0.0
        cov[2, 2] = std_rad * std_rad
        return self._replace(increment=increment, cov=cov)


class MatchedPose(NamedTuple):
    """Where a match alone, free of the prediction, found the base.

    Attributes
    ----------
    T_local_base : (3,) array
        Local frame.
    cov : (3, 3) array
        Its covariance relative to the local map (body frame).
    cov_independent : (3, 3) array
        Without what the matches of neighbouring scans share.
    agreement : float
        Share of the scan's returns that agree with it.
    is_reliable : bool
        All directions are determined and most points agree: fit to calibrate with.
    is_elsewhere : bool
        It was found from another start than the prediction, and most of the returns agree with it alone.
    is_told : bool
        Where the way is in doubt enough of the returns tell of it: one person ahead is less.
    """

    T_local_base: FloatArray
    cov: FloatArray
    cov_independent: FloatArray
    agreement: float
    is_reliable: bool
    is_elsewhere: bool = False
    is_told: bool = True
