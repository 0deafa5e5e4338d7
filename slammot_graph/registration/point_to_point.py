"""The paper's match: scan onto scan, point to point, closed form, until d_k - d_(k+1) < tau (eq. 3 to 5)."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Count, Positive, PositiveShare
from slammot_graph.core.linalg import covariance_of
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.registration import _point_to_point_kernels
from slammot_graph.registration.base import Match, MatchPrior, ReferenceScan


@dataclass(frozen=True, kw_only=True)
class PointToPointConfig(Checked):
    """Stopping and pairing of the paper's ICP; the paper leaves all of it open but tau's meaning.

    Attributes
    ----------
    tau_m : float
        Stop when the mean distance of the pairs falls by less than this.
    max_distance_m : float
        Pairs farther apart are left out; without a bound, what only one scan sees pulls the pose away.
    kept_share : float
        Of the pairs that are left, this share is kept: those least far apart.
    max_gap_m : float or None
        Neighbouring points of the earlier scan up to this far apart are joined by a line, whose nearest place is the
        partner (Lu and Milios 1997); None: the points alone.
    max_iterations : int
    pair_std_m : float
        Standard deviation of a pair's distance per axis, for the covariance.
    """

    tau_m: Positive = 1e-5
    max_distance_m: Positive = 0.5
    kept_share: PositiveShare = 1.0
    max_gap_m: Positive | None = None
    max_iterations: Count = 100
    pair_std_m: Positive = 0.05


class PointToPointMatcher:
    """A `Matcher` onto another scan; see `match_scans`. Of the prior it takes the pose alone."""

    def __init__(self, config: PointToPointConfig) -> None:
        self.config = config

    def match(
        self,
        reference: ReferenceScan,
        points_base: FloatArray,
        is_static: BoolArray,
        laser_base: FloatArray,
        prior: MatchPrior,
        *,
        kernel_factor: float = 1.0,
    ) -> Match:
        """See `Matcher`; there is no robust kernel."""
        result = match_scans(
            reference.points_base, reference.is_used, points_base, is_static, prior.T_a_base, self.config
        )
        if result.status == "failed":
            return Match(result, prior.T_a_base, prior.cov)
        return Match(result, result.T_ref_base, result.cov)


def match_scans(
    reference: FloatArray,
    is_reference: BoolArray,
    points: FloatArray,
    is_used: BoolArray,
    T_start: FloatArray,
    config: PointToPointConfig,
) -> MatchResult:
    """Match the points of a scan onto those of another.

    Parameters
    ----------
    reference : (m, 2) array [m]
        Points of scan t in its base frame; `is_reference` (m,) tells which to use.
    points : (n, 2) array [m]
        Points of scan t+1 in its base frame; `is_used` (n,) tells which to use.
    T_start : (3,) array
        Base at t+1 in base at t, predicted.

    Returns
    -------
    MatchResult
        `T_ref_base` is base at t+1 in base at t; "failed" with fewer than 3 pairs.
    """
    T, partner, stats = np.empty(3), np.empty(len(points), dtype=np.int64), np.empty(4)
    iterations = _point_to_point_kernels.match_point_to_point(
        reference,
        is_reference,
        points,
        is_used,
        T_start,
        config.max_distance_m,
        config.max_gap_m or 0.0,
        config.kept_share,
        config.tau_m,
        config.max_iterations,
        T,
        partner,
        stats,
    )
    n_pairs = int(stats[1])
    if n_pairs < 3:
        return MatchResult(
            status="failed",
            T_ref_base=T_start,
            innovation=np.zeros(3),
            cov=1e6 * np.eye(3),
            information=np.zeros((3, 3)),
            graph_information=np.zeros((3, 3)),
            hessian_information=np.zeros((3, 3)),
            cov_correlated=np.zeros((3, 3)),
            n_iterations=iterations,
            n_correspondences=n_pairs,
            inlier_ratio=n_pairs / max(stats[0], 1.0),
            residual_m=float("nan"),
            reason=f"only {n_pairs} points found a partner within {config.max_distance_m} m",
        )
    paired = points[partner >= 0]
    sx, sy = paired.sum(axis=0)
    H = np.array([[n_pairs, 0.0, -sy], [0.0, n_pairs, sx], [-sy, sx, np.sum(paired**2)]])
    information = H / config.pair_std_m**2
    return MatchResult(
        status="converged",
        T_ref_base=T,
        innovation=se2.log(se2.between(T_start, T)),
        cov=covariance_of(information),
        information=information,
        graph_information=information,
        hessian_information=information,
        cov_correlated=np.zeros((3, 3)),
        n_iterations=iterations,
        n_correspondences=n_pairs,
        inlier_ratio=n_pairs / max(stats[0], 1.0),
        residual_m=float(stats[2]),
    )
