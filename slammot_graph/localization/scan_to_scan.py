"""The paper's localization: each scan matched onto the static points of the one before."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization.base import CommitResult, Estimate
from slammot_graph.localization.dead_reckoning import DeadReckoning
from slammot_graph.odometry.propagation import MotionModel
from slammot_graph.registration.base import MatchPrior, ReferenceScan
from slammot_graph.registration.factory import make_matcher
from slammot_graph.registration.point_to_point import PointToPointConfig


class ScanToScan(DeadReckoning):
    """Dead reckoning whose increments come from point-to-point ICP, started at those of the motion model."""

    def __init__(self, model: MotionModel, config: PointToPointConfig) -> None:
        super().__init__(model)
        self.matcher = make_matcher(config)
        self._before: Estimate = self.estimate
        self._laser_base: FloatArray = np.zeros(2)
        self._reference: ReferenceScan | None = None
        self._match: MatchResult | None = None

    def predict(self, scan: Scan) -> Estimate:
        """See `Localizer`."""
        self._before = self.estimate
        self._laser_base = scan.origins_base
        return super().predict(scan)

    def match(
        self,
        points_base: FloatArray,
        is_static: BoolArray,
        kernel_factor: float = 1.0,
        is_valid: BoolArray | None = None,
    ) -> tuple[Estimate, MatchResult | None]:
        """See `Localizer`."""
        self._match = None
        if self._reference is None:
            return self.estimate, None
        start = se2.between(self._before.T_local_base, self.estimate.T_local_base)
        prior = MatchPrior(T_a_base=start, cov=self.estimate.cov_relative)
        self._match = match = self.matcher.match(
            self._reference, points_base, is_static, self._laser_base, prior
        ).result
        if match.status != "failed":
            self.estimate = Estimate(
                T_local_base=se2.compose(self._before.T_local_base, match.T_ref_base),
                cov_relative=match.cov,
                cov_absolute=se2.compound_covariance(self._before.cov_absolute, match.T_ref_base, match.cov),
            )
        return self.estimate, match

    def join_sweep(self, scan: Scan) -> tuple[Scan, Estimate, MatchResult | None]:
        """See `Localizer`; nothing is joined."""
        return scan, self.estimate, self._match

    def commit(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """See `Localizer`."""
        self._reference = ReferenceScan(points_base=points_base, is_used=is_static)
        return super().commit(scan, points_base, is_static)
