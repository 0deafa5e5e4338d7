"""The paper's localization: each scan matched onto the static points of the one before."""

from slammot_graph.core import se2
from slammot_graph.core.results import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization.base import CommitResult, Estimate
from slammot_graph.localization.dead_reckoning import DeadReckoning
from slammot_graph.odometry.propagation import MotionModel
from slammot_graph.registration.point_to_point import PointToPointConfig, match_scans


class ScanToScan(DeadReckoning):
    """Dead reckoning whose increments come from point-to-point ICP, started at those of the motion model."""

    def __init__(self, model: MotionModel, config: PointToPointConfig) -> None:
        super().__init__(model)
        self.config = config
        self._before: Estimate = self.estimate
        self._reference: tuple[FloatArray, BoolArray] | None = None

    def predict(self, scan: Scan) -> Estimate:
        """See `Localizer`."""
        self._before = self.estimate
        return super().predict(scan)

    def match(
        self, points_base: FloatArray, is_static: BoolArray, kernel_factor: float = 1.0
    ) -> tuple[Estimate, MatchResult | None]:
        """See `Localizer`."""
        if self._reference is None:
            return self.estimate, None
        start = se2.between(self._before.T_local_base, self.estimate.T_local_base)
        match = match_scans(*self._reference, points_base, is_static, start, self.config)
        if match.status != "failed":
            self.estimate = Estimate(
                T_local_base=se2.compose(self._before.T_local_base, match.T_ref_base),
                cov_relative=match.cov,
                cov_absolute=se2.compound_covariance(self._before.cov_absolute, match.T_ref_base, match.cov),
            )
        return self.estimate, match

    def commit(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """See `Localizer`."""
        self._reference = points_base, is_static
        return super().commit(scan, points_base, is_static)
