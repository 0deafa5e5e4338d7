"""What one scan match found."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from slammot_graph.core.types import BoolArray, FloatArray

MatchStatus = Literal["converged", "degenerate", "failed"]

MEAN_NIS = 3.0
"""Of a match that is as far from its prediction as both err: its degrees of freedom."""

UNLIKELY_NIS = 16.27
"""Normalised innovation squared that a consistent match exceeds once in a thousand times (3 degrees of freedom)."""


@dataclass(kw_only=True, eq=False)
class MatchResult:
    """Outcome of one scan match. Over 12 attributes because it is a record; not frozen, for that is slow to make.

    Attributes
    ----------
    status : "converged", "degenerate" (some direction is not constrained) or "failed" (do not use it)
    T_ref_base : (3,) array
        Base in the frame of what was matched against (a local map's anchor, or the previous scan's base).
    innovation : (3,) array
        Tangent from the predicted pose to the matched one, body frame; zero where the match failed.
    cov : (3, 3) array
        Covariance of `T_ref_base`, right perturbation, order (x, y, theta); huge in unconstrained directions.
    information : (3, 3) array
        Its inverse, zero in the directions that the match says nothing about.
    graph_information : (3, 3) array
        The same for a pose graph, which takes the errors of its factors for independent: cautious.
    hessian_information : (3, 3) array
        What the match's normal equations alone claim, all residuals taken for independent: far too much.
    cov_correlated : (3, 3) array
        The part of `cov` that the matches of the next scans share (the same lines of the same local map).
    cov_map : (3, 3) array; map_scatter : (k, 3, 3) array or None
        What the local map's keyframes bring in beyond `cov`; the normal matrix by the points of each of them.
    n_iterations, n_correspondences : int
    inlier_ratio : float
        Share of the matched points that found a partner and agree with it.
    residual_m : float
        Robust root mean square of the residuals [m].
    nis : float
        Normalised square of the innovation against the prediction and this match (3 degrees of freedom if both are
        consistent); NaN where the match failed or was made without a prediction.
    reason : str
        Why it failed or is degenerate; empty when converged.
    contradicts_odometry : bool
        Match and odometry tell of different motions at this scan, whichever of them was believed.
    walks_along : (n,) bool array or None
        Beams on small things that were left out of the match, which they alone pull away from the odometry.
    """

    status: MatchStatus
    T_ref_base: FloatArray
    innovation: FloatArray
    cov: FloatArray
    information: FloatArray
    graph_information: FloatArray
    hessian_information: FloatArray
    cov_correlated: FloatArray
    n_iterations: int
    n_correspondences: int
    inlier_ratio: float
    residual_m: float
    nis: float = math.nan
    reason: str = ""
    contradicts_odometry: bool = False
    cov_map: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    map_scatter: FloatArray | None = None
    walks_along: BoolArray | None = None

    def told_share(self, residual_std_m: float) -> FloatArray:
        """Share of the agreeing returns that tell of a unit vector d of the body frame: ``d' told_share d``, (3, 3).

        `residual_std_m` is what the match was made with.
        """
        n_agreeing = max(self.n_correspondences * self.inlier_ratio, 1.0)
        return np.asarray(self.hessian_information * (residual_std_m * residual_std_m / n_agreeing))
