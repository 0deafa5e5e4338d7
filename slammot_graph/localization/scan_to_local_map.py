"""Between the paper's localization and ours: scans matched onto the local map, without a pose graph."""

from collections.abc import Callable

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization.base import CommitResult, Estimate
from slammot_graph.localization.config import ScanToLocalMapConfig, ScanToScanConfig
from slammot_graph.localization.scan_to_scan import ScanToScan
from slammot_graph.mapping.local_map import NO_NODE, LocalMap, make_keyframe
from slammot_graph.odometry.propagation import MotionModel
from slammot_graph.registration.base import Match, MatchPrior, ReferenceScan
from slammot_graph.registration.factory import make_matcher
from slammot_graph.registration.point_to_line import PointToLineConfig
from slammot_graph.registration.point_to_point import PointToPointConfig

MIN_POINTS = 15
"""Scans with fewer static points make no keyframe."""


class ScanToLocalMap(ScanToScan):
    """Scan to scan, but for the reference: the static points of the latest keyframes, where the matches placed them.

    Attributes
    ----------
    local_map : LocalMap
        In the local frame, which is the map's.
    """

    def __init__(self, model: MotionModel, config: ScanToLocalMapConfig) -> None:
        super().__init__(model, ScanToScanConfig(step=config.step))
        self.local_map = LocalMap(config.local_map)
        self._match_onto = _matching_onto(self.local_map, config.matcher)

    def match(
        self,
        points_base: FloatArray,
        is_static: BoolArray,
        kernel_factor: float = 1.0,
        is_valid: BoolArray | None = None,
    ) -> tuple[Estimate, MatchResult | None]:
        """See `Localizer`; between the cycles there is none."""
        self._match = None
        if not self.local_map.keyframes or not self._is_cycle:
            return self.estimate, None
        prior = MatchPrior(T_a_base=self.estimate.T_local_base, cov=self.estimate.cov_relative)
        match = self._match_onto(points_base, is_static, self._laser_base, prior, kernel_factor)
        self._match = match.result
        if match.result.status != "failed":
            moved = se2.between(self._at_cycle.T_local_base, match.T_a_base)
            self.estimate = Estimate(
                T_local_base=match.T_a_base,
                cov_relative=match.cov + match.result.cov_correlated,
                cov_absolute=se2.compound_covariance(self._at_cycle.cov_absolute, moved, match.cov),
            )
        return self.estimate, match.result

    def commit(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """See `Localizer`."""
        committed = super().commit(scan, points_base, is_static)
        T_local_base = self.estimate.T_local_base
        if not self._is_cycle:
            return committed
        assert self._since is not None
        self._since.cov = self.estimate.cov_relative
        is_keyframe = self.local_map.wants(T_local_base) and np.count_nonzero(is_static) >= MIN_POINTS
        if is_keyframe:
            self.local_map.add(
                make_keyframe(
                    NO_NODE,
                    T_local_base,
                    points_base,
                    is_static,
                    scan.laser,
                    self.local_map.config,
                ),
                self.estimate.cov_relative,
            )
        return committed


Matching = Callable[[FloatArray, BoolArray, FloatArray, MatchPrior, float], Match]


def _matching_onto(local_map: LocalMap, config: PointToPointConfig | PointToLineConfig) -> Matching:
    """Give the match of a scan onto the local map, with whichever matcher is configured."""
    if isinstance(config, PointToLineConfig):
        to_lines = make_matcher(config)
        return lambda points, is_static, laser, prior, factor: to_lines.match(
            local_map, points, is_static, laser, prior, kernel_factor=factor
        )
    to_points = make_matcher(config)

    def match_points(
        points: FloatArray, is_static: BoolArray, laser: FloatArray, prior: MatchPrior, factor: float
    ) -> Match:
        current = local_map.current_points()
        reference = ReferenceScan(points_base=current, is_used=np.ones(len(current), dtype=np.bool_))
        return to_points.match(reference, points, is_static, laser, prior, kernel_factor=factor)

    return match_points
