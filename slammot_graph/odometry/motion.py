"""What a motion model gives and what it is told."""

from typing import NamedTuple

from slammot_graph.core.types import FloatArray


class Motion(NamedTuple):
    """Motion of the base between two scans.

    Attributes
    ----------
    increment : (3,) array
        The base in its own frame at the scan before [m, m, rad].
    cov : (3, 3) array
        Its covariance, right perturbation (body frame).
    """

    increment: FloatArray
    cov: FloatArray


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
    """

    T_local_base: FloatArray
    cov: FloatArray
    cov_independent: FloatArray
    agreement: float
    is_reliable: bool
    is_elsewhere: bool = False
