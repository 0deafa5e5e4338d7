"""The paper's localization: the scan of each cycle matched onto the static points of the cycle before."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization.base import CommitResult, Estimate
from slammot_graph.localization.config import ScanToScanConfig, StepConfig
from slammot_graph.localization.dead_reckoning import DeadReckoning
from slammot_graph.odometry.propagation import MotionModel
from slammot_graph.registration.base import MatchPrior, ReferenceScan
from slammot_graph.registration.factory import make_matcher

STAMP_TOLERANCE_S = 1e-6
"""Stamps are rounded: a scan this much early is on time."""


@dataclass(kw_only=True, eq=False)
class _SinceCycle:
    """The motion since the scan of the last cycle, as predicted.

    Attributes
    ----------
    stamp : float
        Of that scan.
    cov : (3, 3) array
        Of the motion, right perturbation (body frame).
    distance_m, turn_rad : float
        Length of the path, and the turns added up.
    """

    stamp: float
    cov: FloatArray
    distance_m: float = 0.0
    turn_rad: float = 0.0

    def add(self, increment: FloatArray, cov: FloatArray) -> None:
        """Go on by an increment (3,) with its covariance (3, 3)."""
        self.cov = se2.compound_covariance(self.cov, increment, cov)
        self.distance_m += float(np.hypot(increment[0], increment[1]))
        self.turn_rad += abs(float(increment[2]))

    def reaches(self, step: StepConfig, stamp: float) -> bool:
        """Whether the next cycle is due; a clock that jumps backwards counts as time as well."""
        return (
            self.distance_m >= step.distance_m
            or self.turn_rad >= step.turn_rad
            or abs(stamp - self.stamp) >= step.time_s - STAMP_TOLERANCE_S
        )


class ScanToScan(DeadReckoning):
    """Dead reckoning, corrected once a cycle by point-to-point ICP that starts at what the motion model predicts."""

    def __init__(self, model: MotionModel, config: ScanToScanConfig) -> None:
        super().__init__(model)
        self.step = config.step
        self.matcher = make_matcher(config.point_to_point)
        self._at_cycle: Estimate = self.estimate
        self._since: _SinceCycle | None = None
        self._is_cycle = True
        self._laser_base: FloatArray = np.zeros(2)
        self._reference: ReferenceScan | None = None
        self._match: MatchResult | None = None

    def predict(self, scan: Scan) -> Estimate:
        """See `Localizer`."""
        T_before = self.estimate.T_local_base
        self._laser_base = scan.origins_base
        predicted = super().predict(scan)
        if self._since is None:
            return predicted
        self._since.add(se2.between(T_before, predicted.T_local_base), predicted.cov_relative)
        self._is_cycle = (
            self.step is None or scan.T_odom_base is None or self._since.reaches(self.step, scan.stamp)
        )
        self.estimate = Estimate(
            T_local_base=predicted.T_local_base,
            cov_relative=self._since.cov,
            cov_absolute=predicted.cov_absolute,
        )
        return self.estimate

    def match(
        self,
        points_base: FloatArray,
        is_static: BoolArray,
        kernel_factor: float = 1.0,
        is_valid: BoolArray | None = None,
    ) -> tuple[Estimate, MatchResult | None]:
        """See `Localizer`; between the cycles there is none."""
        self._match = None
        if self._reference is None or not self._is_cycle:
            return self.estimate, None
        start = se2.between(self._at_cycle.T_local_base, self.estimate.T_local_base)
        prior = MatchPrior(T_a_base=start, cov=self.estimate.cov_relative)
        self._match = match = self.matcher.match(
            self._reference, points_base, is_static, self._laser_base, prior
        ).result
        if match.status != "failed":
            cov_before = self._at_cycle.cov_absolute
            self.estimate = Estimate(
                T_local_base=se2.compose(self._at_cycle.T_local_base, match.T_ref_base),
                cov_relative=match.cov,
                cov_absolute=se2.compound_covariance(cov_before, match.T_ref_base, match.cov),
            )
        return self.estimate, match

    def join_sweep(self, scan: Scan) -> tuple[Scan, Estimate, MatchResult | None]:
        """See `Localizer`; nothing is joined."""
        return scan, self.estimate, self._match

    def commit(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """See `Localizer`."""
        super().commit(scan, points_base, is_static)
        if self._is_cycle:
            self._reference = ReferenceScan(points_base=points_base, is_used=is_static)
            self._at_cycle = self.estimate
            self._since = _SinceCycle(stamp=scan.stamp, cov=np.zeros((3, 3)))
        is_mapped = self._is_cycle or (self.step is not None and self.step.maps_between)
        return CommitResult(expects_match=self._is_cycle, is_mapped=is_mapped)
