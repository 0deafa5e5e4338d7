"""A scan matched onto the local map: without the odometry where that has jumped, and refused where improbable."""

from dataclasses import replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import MatchResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization.base import fuse, refuse
from slammot_graph.localization.config import ScanToMapConfig
from slammot_graph.localization.innovation_gate import InnovationGate
from slammot_graph.mapping.local_map import LocalMap
from slammot_graph.odometry.propagation import MotionState
from slammot_graph.registration.base import Match, MatchPrior
from slammot_graph.registration.factory import make_matcher


class MapMatching:
    """Point-to-line matching of one scan after the other onto the local map.

    Attributes
    ----------
    config : ScanToMapConfig
    local_map : LocalMap
        Must hold a keyframe.
    matcher : Matcher
    gate : InnovationGate
    """

    def __init__(self, config: ScanToMapConfig, local_map: LocalMap) -> None:
        self.config = config
        self.local_map = local_map
        self.matcher = make_matcher(config.point_to_line)
        self.gate = InnovationGate(config.point_to_line.max_nis, config.max_counted_nis, config.nis_gain)
        self._laser_base: FloatArray = np.zeros(2)
        self._T_local_before: FloatArray = se2.IDENTITY

    def start_scan(self, laser_base: FloatArray, T_local_before: FloatArray) -> None:
        """Move on to the next scan.

        Parameters
        ----------
        laser_base : (2,) array
            The laser's place in the base frame [m].
        T_local_before : (3,) array
            The pose at the scan before.
        """
        self._laser_base, self._T_local_before = laser_base, T_local_before
        self.gate.start_scan()

    def match(
        self, points_base: FloatArray, is_static: BoolArray, start: MotionState, kernel_factor: float = 1.0
    ) -> tuple[MatchResult, MotionState]:
        """Match the static points (n, 2) of the scan from a predicted state; that comes back where it fails.

        A match with a narrower kernel that fails is made again with the usual one.
        """
        state = start
        prior = MatchPrior(
            T_a_base=state.T_local_base, cov=state.cov_prior, cov_independent=state.cov_independent
        )
        match, T_local_base, cov_independent = self._match_from(prior, points_base, is_static, kernel_factor)
        nis = 0.0 if match.status == "failed" else match.nis
        if self._looks_like_jump(match, nis):
            second = self._match_without_odometry(points_base, is_static, match, kernel_factor)
            if second is not None:
                match, T_local_base, cov_independent = second
                wide = self.config.lost_cov
                state = replace(state, cov_odometry=state.cov_odometry + wide, cov_prior=wide)
        if match.status == "failed" and kernel_factor < 1.0:
            return self.match(points_base, is_static, start)
        if self.gate.is_improbable(nis):
            match = refuse(match, f"improbable, innovation squared {nis:.0f}")
            T_local_base, cov_independent = state.T_local_base, state.cov_independent
        state = replace(state, T_local_base=T_local_base, cov_independent=cov_independent)
        if match.status != "failed":
            cov_prior = fuse(state.cov_prior, match)
            state = replace(state, cov_correlated=match.cov_correlated, cov_prior=cov_prior)
        return match, state

    def _match_from(
        self, prior: MatchPrior, points_base: FloatArray, is_static: BoolArray, kernel_factor: float
    ) -> Match:
        return self.matcher.match(
            self.local_map, points_base, is_static, self._laser_base, prior, kernel_factor=kernel_factor
        )

    def _looks_like_jump(self, match: MatchResult, nis: float) -> bool:
        """Tell whether it may be the odometry that is wrong."""
        if match.status == "failed":
            return True
        return match.inlier_ratio < self.config.jump_inlier_ratio and nis > self.config.jump_nis

    def _match_without_odometry(
        self, points_base: FloatArray, is_static: BoolArray, doubtful: MatchResult, kernel_factor: float
    ) -> Match | None:
        """Match again from where the robot was before; None where that is not clearly better."""
        prior = MatchPrior(T_a_base=self._T_local_before, cov=self.config.lost_cov)
        second = self._match_from(prior, points_base, is_static, kernel_factor)
        needed = self.config.jump_inlier_ratio
        if doubtful.status != "failed":
            needed = max(needed, doubtful.inlier_ratio + self.config.jump_inlier_gain)
        is_better = second.result.status != "failed" and second.result.inlier_ratio > needed
        return second if is_better else None
