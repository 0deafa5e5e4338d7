"""No moving-point test: every point is static."""

from collections.abc import Sequence
from dataclasses import dataclass

from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection.base import Detection, PoseEstimate
from slammot_graph.detection.probability import probability_without_clusters
from slammot_graph.detection.scan_history import ScanRecord
from slammot_graph.tracking.base import Tracker


@dataclass(frozen=True, kw_only=True)
class NoDetectionConfig:
    """No moving-point test."""


class NoDetection:
    """A `Detector` that calls nothing moving and remembers nothing."""

    grid = None
    window_start = 0
    has_backward_pass = False

    def pose_covariance(self, estimate: PoseEstimate) -> FloatArray:
        """See `Detector`; what a test would take."""
        return estimate.cov_relative

    def detect(
        self, scan: Scan, is_valid: BoolArray, predicted: PoseEstimate, predicted_positions: FloatArray
    ) -> Detection:
        """See `Detector`."""
        return Detection.nothing(is_valid)

    def retest(
        self,
        scan: Scan,
        is_valid: BoolArray,
        detection: Detection,
        matched: PoseEstimate,
        match: MatchResult,
        predicted_positions: FloatArray,
    ) -> Detection:
        """See `Detector`."""
        return detection

    def kernel_factor(self, detection: Detection, is_valid: BoolArray) -> float:
        """See `Detector`."""
        return 1.0

    def p_moving(
        self, scan: Scan, detection: Detection, points: FloatArray, predicted_positions: FloatArray
    ) -> FloatArray:
        """See `Detector`; 0 for all returns."""
        return probability_without_clusters(detection)

    def settle(
        self, detection: Detection, ranges: FloatArray, is_valid: BoolArray, p_moving: FloatArray
    ) -> Detection:
        """See `Detector`."""
        return detection

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
        """See `Detector`."""

    def retrospective_labels(
        self, history: Sequence[ScanRecord], T_map_base: FloatArray, tracker: Tracker
    ) -> list[BoolArray] | None:
        """See `Detector`; there are none."""
        return None
