"""Our match: static points of a scan onto the lines of the local map, robust, started at the prediction."""

import math
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import (
    Checked,
    Count,
    NotNegative,
    Positive,
    PositiveShare,
    Range,
)
from slammot_graph.core.linalg import covariance_of, invert
from slammot_graph.core.match_result import MatchResult, MatchStatus
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.mapping.local_map import LocalMap
from slammot_graph.registration import _judge_kernels, _solve_kernels
from slammot_graph.registration.base import Match, MatchPrior


@dataclass(frozen=True, kw_only=True)
class PointToLineConfig(Checked):
    """Noise, robustness and stopping of the point-to-line match.

    Attributes
    ----------
    residual_std_m : float
        Standard deviation of one residual as weighed against the prediction: cautious, since a residual may be wrong
        altogether.
    floor_std_m : float
        What no match counts better than in the pose graph, which takes the errors of its factors for independent;
        added per direction, a rotation counted at the mean distance of the points.
    noise_ratio : float
        Standard deviation of the part of a residual that is its own, the beam's noise and its map point's, over the
        scan's `residual_m`; scans with larger residuals have worse poses, in proportion.
    line_ratio : float
        The same of the part that all residuals on one line of the local map share, and with them the next scans.
    least_residual_m : float
        A smaller `residual_m` counts as this.
    line_gap_m : float
        Pairs that follow each other are on one line if the later one's map point is this near to it.
    correlated_std_m, correlated_std_rad : float
        Of what all residuals share, in the pose.
    kernel_scale_m : float
        Geman-McClure: a residual of this size gets a quarter of the weight.
    point_weight : float
        Weight of a point without a normal (foliage, a table leg) against one on a line.
    max_iterations : int
    min_step_m, min_step_rad : float
        Stop when a step is smaller than both.
    min_pairs : int
    min_inlier_ratio : float
        Sum of weights over points used, below which the match has failed.
    weak_ratio : float
        A direction is weak if its share of the information (scaled to metres, per pair) is below this; it
        carries none into the graph.
    fragile_pairs : float
        A direction that so many pairs determine is known to `kernel_scale_m` only, since they may all be on something
        that moves; one that twice as many do, to a quarter of that.
    search_m, search_rad : float
        A failed match is tried again from starts this far around the prediction.
    """

    residual_std_m: Positive = 0.03
    floor_std_m: NotNegative = 0.004
    noise_ratio: Positive = 1.25
    line_ratio: NotNegative = 0.2
    least_residual_m: Positive = 0.008
    line_gap_m: NotNegative = 0.1
    correlated_std_m: NotNegative = 0.001
    correlated_std_rad: NotNegative = 0.0004
    kernel_scale_m: Positive = 0.1
    point_weight: PositiveShare = 0.2
    max_iterations: Count = 20
    min_step_m: Positive = 1e-4
    min_step_rad: Positive = 1e-5
    min_pairs: Annotated[int, Range(low=3)] = 15
    min_inlier_ratio: Annotated[float, Range(low=0.0, high=1.0, is_high_open=True)] = 0.3
    weak_ratio: Annotated[float, Range(low=0.0, high=0.3, is_high_open=True)] = 0.01
    fragile_pairs: NotNegative = 2.0
    search_m: NotNegative = 0.25
    search_rad: NotNegative = 0.15


class _Solution(NamedTuple):
    T: FloatArray
    H: FloatArray
    g: FloatArray
    stats: FloatArray
    iterations: int

    @property
    def inlier_ratio(self) -> float:
        return float(self.stats[2] / max(self.stats[0], 1.0))


class PointToLineMatcher:
    """A `Matcher` onto local maps; see `match_to_local_map`."""

    def __init__(self, config: PointToLineConfig) -> None:
        self.config = config

    def match(
        self,
        reference: LocalMap,
        points_base: FloatArray,
        is_static: BoolArray,
        laser_base: FloatArray,
        prior: MatchPrior,
        *,
        kernel_factor: float = 1.0,
    ) -> Match:
        """See `Matcher`."""
        config = self.config
        if kernel_factor != 1.0:
            config = replace(config, kernel_scale_m=kernel_factor * config.kernel_scale_m)
        return Match(
            *match_to_local_map(
                points_base,
                is_static,
                laser_base,
                reference,
                prior.T_a_base,
                prior.cov,
                config,
                prior.cov_independent,
            )
        )


def match_to_local_map(
    points_base: FloatArray,
    is_static: BoolArray,
    laser_base: FloatArray,
    local_map: LocalMap,
    T_local_base: FloatArray,
    cov_predicted: FloatArray,
    config: PointToLineConfig,
    cov_independent: FloatArray | None = None,
) -> tuple[MatchResult, FloatArray, FloatArray]:
    """Match a scan onto the local map.

    Parameters
    ----------
    points_base : (n, 2) array [m]
    is_static : (n,) bool array
        Points to use.
    laser_base : (2,), (1, 2) or (n, 2) array
        Where all or each were seen from, base frame [m]: a wall's other side is no partner. NaN: from anywhere.
    local_map : LocalMap
    T_local_base : (3,) array
        Predicted base in the local frame: the start, and the mean of the prior.
    cov_predicted : (3, 3) array
        Its covariance (body frame), as the prior counts: cautious. It decides where the match is weak, and only there.
    cov_independent : (3, 3) array, optional
        Its covariance relative to the anchor (body frame), without what scans have in common; by default the same.

    Returns
    -------
    MatchResult
        `T_ref_base` is relative to the local map's anchor and free of the prior where the match is well determined.
    (3,) array
        The estimate with the prior, base in the local frame; the prediction itself if the match failed.
    (3, 3) array
        Its covariance relative to the anchor (body frame), without `MatchResult.cov_correlated`.
    """
    laser_base = laser_base.reshape(-1, 2)
    prior = invert(cov_predicted)
    best = _solve(points_base, is_static, laser_base, local_map, T_local_base, T_local_base, prior, config)
    if best.inlier_ratio < config.min_inlier_ratio or best.stats[1] < config.min_pairs:
        for start in _starts_around(T_local_base, config):
            other = _solve(points_base, is_static, laser_base, local_map, start, T_local_base, prior, config)
            if other.stats[2] > best.stats[2]:
                best = other
    if cov_independent is None:
        cov_independent = cov_predicted
    return _judge(
        best,
        local_map,
        T_local_base,
        cov_predicted,
        cov_independent,
        points_base,
        is_static,
        laser_base,
        config,
    )


def _solve(
    points_base: FloatArray,
    is_static: BoolArray,
    laser_base: FloatArray,
    local_map: LocalMap,
    T_start: FloatArray,
    T_prior: FloatArray,
    prior: FloatArray,
    config: PointToLineConfig,
) -> _Solution:
    T, H, g, stats = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(4)
    iterations = _solve_kernels.match_point_to_line(
        local_map.points,
        local_map.normals,
        local_map.nearest,
        local_map.inv_cell,
        local_map.first,
        points_base,
        is_static,
        laser_base,
        T_start,
        T_prior,
        prior,
        config.residual_std_m,
        local_map.config.reach_m,
        config.kernel_scale_m,
        config.point_weight,
        config.max_iterations,
        config.min_step_m,
        config.min_step_rad,
        T,
        H,
        g,
        stats,
    )
    return _Solution(T, H, g, stats, iterations)


def _starts_around(T: FloatArray, config: PointToLineConfig) -> list[FloatArray]:
    steps = [
        np.array([x * config.search_m, y * config.search_m, a * config.search_rad])
        for a in (0.0, -0.5, 0.5, -1.0, 1.0)
        for x in (0.0, -1.0, 1.0)
        for y in (0.0, -1.0, 1.0)
        if x or y or a
    ]
    return [se2.compose(T, step) for step in steps]


def _judge(
    solution: _Solution,
    local_map: LocalMap,
    T_predicted: FloatArray,
    cov_predicted: FloatArray,
    cov_independent_predicted: FloatArray,
    points_base: FloatArray,
    is_static: BoolArray,
    laser_base: FloatArray,
    config: PointToLineConfig,
) -> tuple[MatchResult, FloatArray, FloatArray]:
    """Tell converged, degenerate and failed apart, and give the match its covariance."""
    n_used, n_pairs, sum_weights, sum_squares = solution.stats.tolist()
    inlier_ratio = sum_weights / max(n_used, 1.0)
    residual_m = math.sqrt(sum_squares / max(sum_weights, 1e-9))
    reason = ""
    if n_pairs < config.min_pairs:
        reason = f"only {n_pairs:.0f} points found a partner"
    elif inlier_ratio < config.min_inlier_ratio:
        reason = f"only {100 * inlier_ratio:.0f}% of the points agree with the local map"
    if reason:
        status, T, T_free, cov, nis = "failed", T_predicted, T_predicted, cov_independent_predicted, np.nan
        information, graph_information, gain_information, cov_correlated = np.zeros((4, 3, 3))
        innovation, cov_match = np.zeros(3), covariance_of(information)
        cov_map, map_scatter = np.zeros((3, 3)), None
    else:
        T, T_free, innovation, matrices = solution.T, np.empty(3), np.empty(3), np.empty((7, 3, 3))
        map_scatter = np.empty((len(local_map.T_local_keyframes), 3, 3))
        least_m = max(residual_m, config.least_residual_m)
        n_weak, nis = _judge_kernels.judge_match(
            local_map.points,
            local_map.normals,
            local_map.nearest,
            local_map.inv_cell,
            local_map.first,
            points_base,
            is_static,
            laser_base,
            T_predicted,
            cov_predicted,
            cov_independent_predicted,
            solution.H,
            solution.g,
            n_pairs,
            local_map.config.reach_m**2,
            config.kernel_scale_m**2,
            config.point_weight,
            config.line_gap_m,
            local_map.owner,
            local_map.T_local_keyframes,
            local_map.keyframe_roots,
            config.residual_std_m,
            config.floor_std_m,
            config.noise_ratio * least_m,
            config.line_ratio * least_m,
            config.correlated_std_m,
            config.correlated_std_rad,
            config.kernel_scale_m,
            config.weak_ratio,
            config.fragile_pairs,
            T,
            T_free,
            innovation,
            map_scatter,
            matrices,
        )
        information, graph_information, gain_information, cov_correlated, cov_match, cov, cov_map = matrices
        status = ("converged", "degenerate", "degenerate", "failed")[n_weak]
        if n_weak:
            reason = (
                "no direction is determined"
                if n_weak == 3
                else f"{n_weak} of 3 directions are not determined"
            )
    match_status: MatchStatus = status  # type: ignore[assignment]
    result = MatchResult(
        status=match_status,
        T_ref_base=se2.between(local_map.anchor.T_local_base, T_free),
        innovation=innovation,
        cov=cov_match,
        information=information,
        graph_information=graph_information,
        hessian_information=gain_information,
        cov_correlated=cov_correlated,
        cov_map=cov_map,
        map_scatter=map_scatter,
        nis=nis,
        n_iterations=solution.iterations,
        n_correspondences=int(n_pairs),
        inlier_ratio=inlier_ratio,
        residual_m=residual_m,
        reason=reason,
    )
    return result, T, cov
