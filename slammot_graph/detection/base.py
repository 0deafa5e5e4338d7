"""What the pipeline asks of a moving-object detector, and what it gets."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _cluster_kernels, reasons
from slammot_graph.detection.scan_history import ScanRecord
from slammot_graph.mapping.occupancy_grid import OccupancyGrid
from slammot_graph.tracking.base import Tracker


class Detection(NamedTuple):
    """Labels of one scan; every array has one entry a beam.

    Attributes
    ----------
    is_moving : (n,) bool array
    reason : (n,) int array
        Index into `reasons.REASONS`.
    cluster : (n,) int array
        Number of the cluster of a moving beam, -1 for others.
    n_clusters : int
    packed_cov : (n, 3) array [m^2]
        Covariance of the end points in the frame of the pose: xx, xy, yy.
    """

    is_moving: BoolArray
    reason: IntArray
    cluster: IntArray
    n_clusters: int
    packed_cov: FloatArray

    def is_mapped(self, is_valid: BoolArray) -> BoolArray:
        """(n,) returns that enter the map: static, and not kept out of it because they lie on free cells."""
        is_mapped: BoolArray = is_valid & ~self.is_moving
        for reason in reasons.NOT_MAPPED:
            is_mapped &= self.reason != reason
        return is_mapped

    def is_matched(self, is_valid: BoolArray) -> BoolArray:
        """(n,) returns that are matched onto the map, see `matched_returns`."""
        return matched_returns(is_valid, self.is_moving, self.reason)

    def clusters(self, points: FloatArray) -> tuple[FloatArray, FloatArray, list[IntArray], BoolArray]:
        """Give what a tracker needs of the k clusters, with the scan's points (n, 2) in the frame of the pose.

        Returns centres (k, 2), their covariances (k, 2, 2), the beams of each, and whether free cells prove it (k,).
        """
        k = self.n_clusters
        centres, covs, is_proven = np.empty((k, 2)), np.empty((k, 2, 2)), np.empty(k, dtype=np.bool_)
        starts, beams = np.empty(k + 1, dtype=np.int64), np.empty(len(points), dtype=np.int64)
        if k:
            _cluster_kernels.cluster_moments(
                points, self.packed_cov, self.cluster, self.reason, centres, covs, is_proven, starts, beams
            )
        return centres, covs, [beams[starts[c] : starts[c + 1]] for c in range(k)], is_proven

    @classmethod
    def nothing(cls, is_valid: BoolArray) -> "Detection":
        """Call every beam of a scan static, as a method without a moving-point test does."""
        n = len(is_valid)
        return cls(
            is_moving=np.zeros(n, dtype=np.bool_),
            reason=np.where(is_valid, reasons.NOT_TESTED, reasons.NOT_VALID),
            cluster=np.full(n, -1),
            n_clusters=0,
            packed_cov=np.zeros((n, 3)),
        )

    def kept_out(self) -> "Detection":
        """Keep out of the map what the test abstained from."""
        is_abstained = self.reason == reasons.ABSTAINED
        if not np.count_nonzero(is_abstained):
            return self
        return self._replace(reason=np.where(is_abstained, reasons.UNSUPPORTED, self.reason))

    def abstain(self) -> "Detection":
        """Reject what was called moving, and what was kept out of the map: nothing is."""
        is_rejected = self.is_moving | (self.reason == reasons.TOO_WIDE) | (self.reason == reasons.COME_UP)
        return self._replace(
            is_moving=np.zeros_like(self.is_moving),
            reason=np.where(is_rejected, reasons.ABSTAINED, self.reason),
            cluster=np.full_like(self.cluster, -1),
            n_clusters=0,
        )


def matched_returns(is_valid: BoolArray, is_moving: BoolArray, reason: IntArray) -> BoolArray:
    """(n,) returns that are matched onto the map: static, and not on what has come up and may ride along."""
    return np.asarray(is_valid & ~is_moving & (reason != reasons.COME_UP))


NO_CLUSTERS: tuple[FloatArray, FloatArray, list[IntArray], BoolArray] = (
    np.empty((0, 2)),
    np.empty((0, 2, 2)),
    [],
    np.empty(0, dtype=np.bool_),
)
"""As of `Detection.clusters` where there is none."""


class PoseEstimate(Protocol):
    """The pose at which a scan is tested; covariances are right perturbations (body frame)."""

    @property
    def T_local_base(self) -> FloatArray:
        """(3,) base in the local frame."""

    @property
    def cov_relative(self) -> FloatArray:
        """(3, 3) covariance relative to the local map's anchor."""

    @property
    def cov_absolute(self) -> FloatArray:
        """(3, 3) covariance in the map."""


class Detector(Protocol):
    """Labels what moves; once a scan: detect, retest after each match, p_moving, update, in this order."""

    @property
    def grid(self) -> OccupancyGrid | None:
        """The cells that are tested; None where no test is made."""

    @property
    def window_start(self) -> int:
        """Index of the scan with which the detector's memory begins now."""

    @property
    def has_backward_pass(self) -> bool:
        """Whether `retrospective_labels` judges every scan again."""

    def pose_covariance(self, estimate: PoseEstimate) -> FloatArray:
        """(3, 3) covariance of a pose, as the test takes it (body frame)."""

    def detect(
        self, scan: Scan, is_valid: BoolArray, predicted: PoseEstimate, predicted_positions: FloatArray
    ) -> Detection:
        """Label a scan of n beams at its predicted pose.

        `is_valid` (n,) are its returns, `predicted_positions` (k, 2) [m] where tracked objects should be, local frame.
        """

    def retest(
        self,
        scan: Scan,
        is_valid: BoolArray,
        detection: Detection,
        matched: PoseEstimate,
        match: MatchResult,
        predicted_positions: FloatArray,
    ) -> Detection:
        """Label the scan again at its matched pose, where the match deserves it; `detection` is the latest."""

    def kernel_factor(self, detection: Detection, is_valid: BoolArray) -> float:
        """How much narrower the match's robust kernel should be for what the detector leaves; 1: as it is."""

    def p_moving(
        self, scan: Scan, detection: Detection, points: FloatArray, predicted_positions: FloatArray
    ) -> FloatArray:
        """(n,) probability that each beam hit something that moves, with its points (n, 2) in the local frame [m]."""

    def settle(
        self, detection: Detection, ranges: FloatArray, is_valid: BoolArray, p_moving: FloatArray
    ) -> Detection:
        """Take back what is more probably static, by the probabilities (n,) of `p_moving`."""

    def update(
        self,
        scan: Scan,
        points: FloatArray,
        is_valid: BoolArray,
        is_static: BoolArray,
        T_local_base: FloatArray,
        *,
        is_keyframe: bool,
        is_lost: bool,
    ) -> None:
        """Remember the scan for the tests of later ones.

        Parameters
        ----------
        scan : Scan
            of n beams.
        points : (n, 2) array [m]
            Its end points at the matched pose, local frame.
        is_valid, is_static : (n,) bool arrays
            Returns, and those of them that do not move.
        T_local_base : (3,) array
            The matched pose.
        is_keyframe : bool
            It went into the local map.
        is_lost : bool
            Nothing is known of the pose relative to what was remembered before.
        """

    def retrospective_labels(
        self, history: Sequence[ScanRecord], T_map_base: FloatArray, tracker: Tracker
    ) -> list[BoolArray] | None:
        """Judge each scan of a run again at its optimised pose (n, 3), with a fresh tracker; None: no backward pass."""
