"""The detector of moving points: the ellipse test on a grid that it keeps, with what earlier scans tell."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Count, Positive, PositiveOrInfinite, PositiveShare, Share
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection.backward_pass import retrospective_labels
from slammot_graph.detection.base import Detection, PoseEstimate
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.ellipse_test import EllipseTestConfig, detect_moving
from slammot_graph.detection.furniture import without_furniture
from slammot_graph.detection.hit_memory import HitMemory, HitMemoryConfig
from slammot_graph.detection.probability import probability_of_moving
from slammot_graph.detection.reasons import VACATED
from slammot_graph.detection.scan_history import ScanRecord
from slammot_graph.detection.unlikely import is_crowded, without_unlikely
from slammot_graph.detection.visibility_check import VisibilityCheck, VisibilityCheckConfig
from slammot_graph.mapping.occupancy_grid import GridConfig, NoReturnConfig, OccupancyGrid
from slammot_graph.odometry.noise import ConstantNoise
from slammot_graph.tracking.base import Tracker


@dataclass(frozen=True, kw_only=True)
class LocalGridConfig(GridConfig):
    """The test's own grid: it rolls along with the robot and forgets.

    Attributes
    ----------
    resolution_m, p_hit, p_free, no_return and others
        See `GridConfig`.
    n_keyframes : int
        Cells that no scan touched since this many keyframes are forgotten.
    window_margin_m : float
        Side of the grid beyond twice the range of the points.
    """

    resolution_m: Positive = 0.1
    p_hit: float = 0.75
    p_free: float = 0.12
    no_return: NoReturnConfig | None = field(default_factory=NoReturnConfig)
    n_keyframes: Count = 60
    window_margin_m: Positive = 20.0


@dataclass(frozen=True, kw_only=True)
class RetestConfig(Checked):
    """The test repeated at the matched pose before the map is updated.

    Attributes
    ----------
    same_cells : float
        A match that moves the farthest points by less than this share of a cell leaves the test as it is.
    abstain_nis : float
        None is called moving after a match that failed, or whose normalised innovation squared is above this.
    crowd_share : float
        Where more than this share of a scan moves, it is matched once more with a narrower kernel, without
        what the test at the matched pose calls moving; 1: never.
    min_kernel_factor : float
        The kernel gets narrower down to this share of its scale.
    mapped_share : float
        Where more than this share of the valid beams ends on free cells, what is too wide for a person stays out of the
        map as long as its cells are known to be free: walls do not come, and what covers the laser, or the floor before
        a robot that tilts, rides along and would take the map with it. So does, where there is odometry, what lies on
        free cells though too much of the scan seems to move, or the match failed. 1: never.
    off_wall_m : float
        However few beams they are, what is too wide for a person stays out of match and map where most of its points
        are farther than this from all occupied cells: a wall that an error of the pose puts onto free cells is nearer.
        Not where it goes on straight from a metre of wall.
    """

    same_cells: Share = 0.2
    abstain_nis: PositiveOrInfinite = 50.0
    crowd_share: Share = 0.15
    min_kernel_factor: PositiveShare = 0.4
    mapped_share: PositiveShare = 0.2
    off_wall_m: Positive = 0.3


@dataclass(frozen=True, kw_only=True)
class EllipseDetectorConfig(Checked):
    """How moving points are found.

    Attributes
    ----------
    test_covariance : "relative", "absolute" or ConstantNoise
        Pose covariance in the test: the graph's marginal relative to the local map's anchor, its absolute marginal,
        or the paper's R_r.
    ellipse_test : EllipseTestConfig
    clusters : ClusterConfig
    visibility_check : VisibilityCheckConfig or None
        None: free cells alone tell what moves.
    retest : RetestConfig or None
        None: the test at the predicted pose is the last.
    hit_memory : HitMemoryConfig or None
        None: what was hit before is known by the grid alone. Without a local grid there is no such memory.
    backward_pass : bool
        Test every scan again after the run, with what was seen later.
    local_grid : LocalGridConfig or None
        None: the map itself is tested, as in the paper.
    """

    test_covariance: Literal["relative", "absolute"] | ConstantNoise = "relative"
    ellipse_test: EllipseTestConfig = field(default_factory=EllipseTestConfig)
    clusters: ClusterConfig = field(default_factory=ClusterConfig)
    visibility_check: VisibilityCheckConfig | None = field(default_factory=VisibilityCheckConfig)
    retest: RetestConfig | None = field(default_factory=RetestConfig)
    hit_memory: HitMemoryConfig | None = field(default_factory=HitMemoryConfig)
    backward_pass: bool = True
    local_grid: LocalGridConfig | None = field(default_factory=LocalGridConfig)

    def __post_init__(self) -> None:
        """See `Checked`."""
        super().__post_init__()
        self.require(
            isinstance(self.test_covariance, ConstantNoise)
            or self.test_covariance in ("relative", "absolute"),
            f'must be "relative", "absolute" or constant noise, not {self.test_covariance!r}',
            key="test_covariance",
        )


class EllipseDetector:
    """A `Detector`: the ellipse test at the predicted pose and again at the matched one.

    Parameters
    ----------
    config : EllipseDetectorConfig
    max_range_m : float
        Range of the farthest points.
    map_grid : OccupancyGrid, optional
        The map as it grows: tested where the configuration has no local grid.
    """

    def __init__(
        self,
        config: EllipseDetectorConfig,
        *,
        max_range_m: float,
        map_grid: OccupancyGrid | None = None,
    ) -> None:
        self.config = config
        self.max_range_m = max_range_m
        local = config.local_grid
        if local is not None:
            map_grid = OccupancyGrid(local, window_m=2.0 * max_range_m + local.window_margin_m)
        if map_grid is None:
            raise ValueError("without a local grid the detector needs the map's")
        self.grid = map_grid
        self._hits = (
            None
            if local is None or config.hit_memory is None
            else HitMemory(
                config.hit_memory,
                resolution_m=local.resolution_m,
                window_m=2.0 * max_range_m + local.window_margin_m,
            )
        )
        self._keyframes = deque[int](maxlen=None if local is None else local.n_keyframes)
        self._first_remembered = 0
        self._visibility_check = self._new_visibility_check()
        self._T_tested: FloatArray = se2.IDENTITY
        self._expected: FloatArray = np.empty((0, 2))

    @property
    def window_start(self) -> int:
        """See `Detector`."""
        return self.grid.oldest

    @property
    def has_backward_pass(self) -> bool:
        """See `Detector`."""
        return self.config.backward_pass

    def pose_covariance(self, estimate: PoseEstimate) -> FloatArray:
        """See `Detector`."""
        if isinstance(self.config.test_covariance, ConstantNoise):
            return self.config.test_covariance.covariance(se2.IDENTITY)
        if self.config.test_covariance == "absolute":
            return estimate.cov_absolute
        return estimate.cov_relative

    def detect(
        self, scan: Scan, is_valid: BoolArray, predicted: PoseEstimate, predicted_positions: FloatArray
    ) -> Detection:
        """See `Detector`."""
        return self._detect(scan, is_valid, predicted, predicted_positions)

    def _detect(
        self,
        scan: Scan,
        is_valid: BoolArray,
        predicted: PoseEstimate,
        predicted_positions: FloatArray,
        walks_along: BoolArray | None = None,
    ) -> Detection:
        self._T_tested = predicted.T_local_base
        self._expected = predicted_positions
        vacated, reach_m = None, 0.0
        if self._visibility_check is not None:
            vacated = self._visibility_check.vacated(scan, predicted.T_local_base, is_valid)
            reach_m = self._visibility_check.config.reach_m
        detection = detect_moving(
            scan,
            is_valid,
            predicted.T_local_base,
            self.pose_covariance(predicted),
            self.grid,
            self.config.ellipse_test,
            self.config.clusters,
            predicted_positions,
            vacated,
            reach_m,
            self._hits,
            walks_along,
            *self._kept_apart(),
        )
        return self._kept_out(detection, scan)

    def _kept_apart(self) -> tuple[float, float]:
        """What tells what is too wide for a person and stays out of match and map, as `detect_moving` takes it."""
        retest = self.config.retest
        return (1.0, math.inf) if retest is None else (retest.mapped_share, retest.off_wall_m)

    def _kept_out(self, detection: Detection, scan: Scan) -> Detection:
        """Keep out of the map what lies on free cells though the test abstained; the odometry says where it lies."""
        retest = self.config.retest
        if retest is None or retest.mapped_share == 1.0 or scan.T_odom_base is None:
            return detection
        return detection.kept_out()

    def retest(
        self,
        scan: Scan,
        is_valid: BoolArray,
        detection: Detection,
        matched: PoseEstimate,
        match: MatchResult,
        predicted_positions: FloatArray,
    ) -> Detection:
        """See `Detector`: repeat the test at the matched pose, or abstain where the match does not deserve it.

        A match that moves no point by more than a share of a cell leaves the test already made as it is.
        """
        retest = self.config.retest
        if retest is None:
            return detection
        if match.status == "failed" or match.nis > retest.abstain_nis:
            return self._kept_out(detection.abstain(), scan)
        if match.walks_along is not None:
            return self._detect(scan, is_valid, matched, predicted_positions, match.walks_along)
        distance_m, turn_rad = se2.distance(self._T_tested, matched.T_local_base)
        if distance_m + turn_rad * self.max_range_m < retest.same_cells * self.grid.config.resolution_m:
            return detection
        return self.detect(scan, is_valid, matched, predicted_positions)

    def kernel_factor(self, detection: Detection, is_valid: BoolArray) -> float:
        """See `Detector`: in a crowd what is left may still be people."""
        retest = self.config.retest
        if retest is None:
            return 1.0
        share = np.count_nonzero(detection.is_moving) / max(int(np.count_nonzero(is_valid)), 1)
        return max((1.0 - share) ** 2, retest.min_kernel_factor) if share > retest.crowd_share else 1.0

    def p_moving(
        self, scan: Scan, detection: Detection, points: FloatArray, predicted_positions: FloatArray
    ) -> FloatArray:
        """See `Detector`."""
        return probability_of_moving(detection, points, scan.ranges, self.grid, predicted_positions)

    def settle(
        self, detection: Detection, ranges: FloatArray, is_valid: BoolArray, p_moving: FloatArray
    ) -> Detection:
        """See `Detector`: what lies beside vacated places must be probable, unless much of the scan moves."""
        check = self.config.visibility_check
        if check is None or not np.count_nonzero(detection.reason == VACATED):
            return detection
        if is_crowded(detection, is_valid, check.crowd_share):
            return detection
        return without_unlikely(detection, np.where(is_valid, ranges, np.inf), p_moving, check.min_p)

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
        """See `Detector`; the map's own grid is updated by whoever owns it."""
        if is_lost:
            self._first_remembered = scan.index
            self._visibility_check = self._new_visibility_check()
        if self.config.local_grid is not None:
            if is_keyframe:
                self._keyframes.append(scan.index)
                self.grid.oldest = max(self._keyframes[0], self._first_remembered)
            is_hit = is_static
            if self._hits is not None:
                is_hit = self._hits.hits(points, is_static, self._expected)
                self._hits.oldest = self.grid.oldest
                self._hits.add(scan.index, scan.stamp, points, is_valid, is_hit, scan.laser.number)
            self.grid.add_scan(scan.index, scan, T_local_base, points, is_valid, is_hit)
        if self._visibility_check is not None:
            self._visibility_check.remember(scan.stamp, T_local_base, points, is_valid, scan.laser.number)

    def retrospective_labels(
        self, history: Sequence[ScanRecord], T_map_base: FloatArray, tracker: Tracker
    ) -> list[BoolArray] | None:
        """See `Detector`."""
        if not self.config.backward_pass:
            return None
        local = self.config.local_grid
        labels = retrospective_labels(
            history,
            T_map_base,
            grid=self.grid.config,
            window_m=None if local is None else 2.0 * self.max_range_m + local.window_margin_m,
            ellipse_test=self.config.ellipse_test,
            clusters=self.config.clusters,
            tracker=tracker,
        )
        if self._hits is None:
            return labels
        return without_furniture(
            labels,
            history,
            T_map_base,
            config=self._hits.config,
            clusters=self.config.clusters,
            resolution_m=self.grid.config.resolution_m,
        )

    def _new_visibility_check(self) -> VisibilityCheck | None:
        config = self.config.visibility_check
        return None if config is None else VisibilityCheck(config)
