"""The trajectory that the motion model alone tells."""

from dataclasses import replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.scan import Scan
from slammot_graph.core.spool import Spool
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization.base import FIRST_COV, CommitResult, Estimate, FinalEstimate
from slammot_graph.odometry.propagation import MotionModel


class DeadReckoning:
    """Odometry alone; the local frame is the map, and starts at the first scan."""

    T_map_local = se2.IDENTITY
    spools: tuple[Spool, ...] = ()

    def __init__(self, model: MotionModel) -> None:
        self.model = model
        self.estimate = Estimate(T_local_base=se2.IDENTITY, cov_relative=FIRST_COV, cov_absolute=FIRST_COV)
        self._history: list[Estimate] = []

    def predict(self, scan: Scan) -> Estimate:
        """See `Localizer`."""
        motion = self.model.advance(scan)
        if motion is not None:
            self.estimate = Estimate(
                T_local_base=se2.compose(self.estimate.T_local_base, motion.increment),
                cov_relative=motion.cov,
                cov_absolute=se2.compound_covariance(
                    self.estimate.cov_absolute, motion.increment, motion.cov
                ),
            )
        return self.estimate

    def deskew(self, scan: Scan) -> Scan:
        """See `Localizer`: by the motion model."""
        if scan.beam_times is None:
            return scan
        return replace(scan, sweep=self.model.during_sweep(scan))

    def deskew_again(self, scan: Scan, is_static: BoolArray) -> Scan | None:
        """See `Localizer`; nothing new is told."""
        return None

    def join_sweep(self, scan: Scan) -> tuple[Scan, Estimate, MatchResult | None]:
        """See `Localizer`; nothing is joined."""
        return scan, self.estimate, None

    def match(
        self,
        points_base: FloatArray,
        is_static: BoolArray,
        kernel_factor: float = 1.0,
        is_valid: BoolArray | None = None,
    ) -> tuple[Estimate, MatchResult | None]:
        """See `Localizer`; there is none."""
        return self.estimate, None

    def commit(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """See `Localizer`."""
        self.model.correct(self.estimate.T_local_base, None)
        self._history.append(self.estimate)
        return CommitResult()

    def odometry_report(self) -> OdometryReport:
        """See `Localizer`; nothing is estimated."""
        return OdometryReport()

    def nodes_and_edges(self) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
        """See `Localizer`; there is no graph."""
        return np.empty((0, 3)), ()

    def final(self) -> FinalEstimate:
        """See `Localizer`."""
        return FinalEstimate(
            T_map_base=np.array([e.T_local_base for e in self._history]).reshape(-1, 3),
            cov_map=np.array([e.cov_absolute for e in self._history]).reshape(-1, 3, 3),
            node_scans=np.empty(0, dtype=np.int64),
            nodes=np.empty((0, 3)),
            edges=(),
        )

    def close(self) -> None:
        """See `Localizer`."""
