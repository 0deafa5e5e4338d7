"""The step: predict, detect, match, graph, map, objects. One scan in, one `StepResult` out."""

import math
from array import array
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.events import Event, EventKind, Severity
from slammot_graph.core.results import (
    ClosureAttempt,
    ClosureStatus,
    GraphEdge,
    GridMap,
    MatchResult,
    StepResult,
    TrackState,
)
from slammot_graph.core.scan import Scan
from slammot_graph.core.stopwatch import Stopwatch
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection.backward_pass import retrospective_labels
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.ellipse_test import Detection, EllipseTestConfig, detect_moving
from slammot_graph.detection.probability import probability_of_moving
from slammot_graph.detection.scan_history import ScanHistory
from slammot_graph.detection.visibility_check import VisibilityCheck, VisibilityCheckConfig
from slammot_graph.graph.pose_graph import PoseGraphConfig
from slammot_graph.localization import (
    DeadReckoning,
    Estimate,
    FinalEstimate,
    Localizer,
    ScanToMap,
    ScanToMapConfig,
    ScanToScan,
)
from slammot_graph.loop_closure.detector import LoopClosureConfig
from slammot_graph.mapping.local_map import LocalMapConfig
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise
from slammot_graph.registration.point_to_line import PointToLineConfig
from slammot_graph.registration.point_to_point import PointToPointConfig
from slammot_graph.tracking.tracker import Tracker, TrackerConfig

LEAST_KERNEL_FACTOR = 0.4
"""In a crowd the match's kernel gets narrower, down to this share of its scale."""

SAME_CELLS = 0.2
"""A match that moves the farthest points by less than this share of a cell leaves the test as it is."""

MIN_NO_RETURN_RUN = 25
"""Neighbouring beams without a return that are taken for open space."""

Matcher = Literal["none", "scan-to-scan", "scan-to-map"]
TestCovariance = Literal["constant", "relative", "absolute"]


@dataclass(frozen=True, kw_only=True)
class PipelineConfig:
    """What a method does; the methods of the ladder differ from each other in these fields only.

    Attributes
    ----------
    matcher : "none", "scan-to-scan" (the paper's) or "scan-to-map" (point to line, with the pose graph)
    filter_moving : bool
        Run the moving-point test and leave moving points out of the match.
    test_covariance : "constant", "relative" or "absolute"
        Pose covariance in the test: the paper's R_r, the graph's marginal relative to the local map's anchor,
        or its absolute marginal.
    retest_after_match : bool
        Repeat the test at the matched pose before the map is updated.
    crowd_share : float
        Where more than this share of a scan moves, it is matched once more with a narrower kernel, without
        what the test at the matched pose calls moving; 1: never.
    hindsight : bool
        Judge every scan again after the run, with what was seen later.
    occupy_with_moving : bool
        Moving points occupy cells too (the paper's map takes ALL points).
    max_range_m : float
        Farther returns are left aside.
    free_no_return_m : float
        A beam without a return frees the cells up to this distance in the test's map; 0: none.
    n_window_keyframes : int
        The test's map forgets cells that no scan touched since this many keyframes ("scan-to-map" only).
    n_lost : int
        After this many failed matches in a row a new local map is started.
    constant_noise : ConstantNoise
        The paper's R_r, for `test_covariance` "constant".
    odometry_noise : OdometryNoise or ConstantNoise
        R_r of the odometry factors and of the prediction: growing with the motion, or constant as in the paper.
    close_loops : bool
        Look for loops ("scan-to-map" only).
    grid : GridConfig
        Of the map, and of the test where there is no local map.
    local_grid : GridConfig
        Of the test ("scan-to-map" only).
    motion, clusters, tracks, visibility_check, local_map, point_to_line, point_to_point, graph, closure
        Configuration of the stages.
    """

    matcher: Matcher = "scan-to-map"
    filter_moving: bool = True
    test_covariance: TestCovariance = "relative"
    retest_after_match: bool = True
    crowd_share: float = 0.15
    hindsight: bool = True
    occupy_with_moving: bool = False
    max_range_m: float = 40.0
    free_no_return_m: float = 5.0
    n_window_keyframes: int = 60
    n_lost: int = 5
    constant_noise: ConstantNoise = field(default_factory=ConstantNoise)
    odometry_noise: OdometryNoise | ConstantNoise = field(default_factory=OdometryNoise)
    grid: GridConfig = field(default_factory=GridConfig)
    local_grid: GridConfig = field(
        default_factory=lambda: GridConfig(resolution_m=0.1, p_hit=0.75, p_free=0.12)
    )
    motion: EllipseTestConfig = field(default_factory=EllipseTestConfig)
    clusters: ClusterConfig = field(default_factory=ClusterConfig)
    tracks: TrackerConfig = field(default_factory=TrackerConfig)
    visibility_check: VisibilityCheckConfig = field(default_factory=VisibilityCheckConfig)
    local_map: LocalMapConfig = field(default_factory=LocalMapConfig)
    point_to_line: PointToLineConfig = field(default_factory=PointToLineConfig)
    point_to_point: PointToPointConfig = field(default_factory=PointToPointConfig)
    graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    close_loops: bool = True
    closure: LoopClosureConfig = field(default_factory=LoopClosureConfig)

    def __post_init__(self) -> None:
        for name, kind in (("matcher", Matcher), ("test_covariance", TestCovariance)):
            if getattr(self, name) not in get_args(kind):
                raise ConfigError(f'{name} must be one of {get_args(kind)}, not "{getattr(self, name)}"')
        if not self.max_range_m > 0.0:
            raise ConfigError(f"max_range_m must be positive, not {self.max_range_m}")
        if not 0.0 <= self.crowd_share <= 1.0:
            raise ConfigError(f"crowd_share must be in [0, 1], not {self.crowd_share}")
        if not self.free_no_return_m >= 0.0:
            raise ConfigError(f"free_no_return_m must not be negative, not {self.free_no_return_m}")
        if self.n_window_keyframes < 1 or self.n_lost < 1:
            raise ConfigError("n_window_keyframes and n_lost must be at least 1")
        if self.matcher != "scan-to-map" and self.filter_moving and self.test_covariance != "constant":
            raise ConfigError(
                f'matcher "{self.matcher}" has no pose graph: set test_covariance to "constant"'
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Hints:
    """What the scans before tell the test: places (k, 2) of tracked objects and of what is empty now, local frame."""

    predicted_positions: FloatArray
    vacated: FloatArray


class Pipeline:
    """Localizes, maps and detects moving objects, one scan at a time.

    Parameters
    ----------
    config : PipelineConfig
        As of a method of the ladder, or your own.

    Examples
    --------
    >>> pipeline = Pipeline(get_method("graph").config)            # doctest: +SKIP
    >>> for scan in open_log("intel.clf.bz2"):                     # doctest: +SKIP
    ...     result = pipeline.step(scan)
    """

    def __init__(self, config: PipelineConfig) -> None:
        self.config = config
        self.localizer = _make_localizer(config)
        self.tracker = Tracker(config.tracks)
        window_m = 2.0 * config.max_range_m + 20.0 if config.matcher == "scan-to-map" else None
        grid = config.grid if window_m is None else config.local_grid
        self.grid = OccupancyGrid(grid, window_m=window_m)
        self._node_scans = array("q")
        self._in_window = deque[int](maxlen=config.n_window_keyframes)
        self.visibility_check = VisibilityCheck(config.visibility_check)
        self._has_backward_pass = config.hindsight and config.filter_moving
        self._history = ScanHistory()
        self._n_times_lost = 0
        self._first_remembered = 0
        self._stopwatch = Stopwatch()

    def step(self, scan: Scan) -> StepResult:
        """Take in the next scan."""
        watch = self._stopwatch
        watch.restart()
        is_valid = scan.is_valid(self.config.max_range_m)
        points_base = scan.points_base()
        predicted = self.localizer.predict(scan)
        watch.lap("predict")
        hints = self._hints(scan, is_valid, predicted)
        detection = self._detect(scan, is_valid, predicted, hints)
        watch.lap("detect")
        matched, match = self.localizer.match(points_base, is_valid & ~detection.is_moving)
        watch.lap("match")
        if self.config.retest_after_match and self.config.filter_moving and match is not None:
            first, T_tested = detection, predicted.T_local_base
            detection = self._judge(scan, is_valid, first, T_tested, matched, match, hints)
            factor = self._kernel_factor(detection, is_valid)
            if factor < 1.0:
                watch.lap("detect")
                T_tested = T_tested if detection is first else matched.T_local_base
                matched, match = self.localizer.match(points_base, is_valid & ~detection.is_moving, factor)
                watch.lap("match")
                detection = self._judge(scan, is_valid, detection, T_tested, matched, match, hints)
        points = scan.points(matched.T_local_base)
        p_moving = probability_of_moving(detection, points, scan.ranges, self.grid, hints.predicted_positions)
        is_static = is_valid & ~detection.is_moving
        watch.lap("detect")
        node, is_keyframe, events = self.localizer.commit(scan, points_base, is_static)
        if self.localizer.n_times_lost > self._n_times_lost:
            self._forget(scan)
        watch.lap("graph")
        if node is not None:
            self._node_scans.append(len(self._history))
        if is_keyframe:
            self._in_window.append(scan.index)
            self.grid.oldest = max(self._in_window[0], self._first_remembered)
        self._update_map(scan, points, is_valid, is_static, matched)
        watch.lap("map")
        tracks = self._track(scan, detection, points)
        is_doubtful = match is not None and match.status == "failed"
        self._remember(scan, is_valid, detection, matched, is_doubtful)
        if self.config.filter_moving:
            self.visibility_check.remember(scan.stamp, matched.T_local_base, points, is_valid)
        watch.lap("objects")
        T_map_local = self.localizer.T_map_local
        return StepResult(
            scan=scan,
            T_map_base=se2.compose(T_map_local, matched.T_local_base),
            cov_map=matched.cov_absolute,
            T_map_base_predicted=se2.compose(T_map_local, predicted.T_local_base),
            cov_relative=self._test_covariance(predicted),
            anchor_scan=matched.anchor_scan,
            T_anchor_base=matched.T_anchor_base,
            cov_anchor_base=matched.cov_relative,
            is_valid=is_valid,
            is_moving=detection.is_moving,
            p_moving=p_moving,
            reason=detection.reason,
            packed_cov=detection.packed_cov,
            local_yaw=float(T_map_local[2]),
            match=match,
            innovation_nis=math.nan if match is None else match.nis,
            tracks=tracks,
            node=node,
            events=_typed(events, scan.index, self.localizer.closures),
            stage_ms=watch.read(),
            closures=self.localizer.closures,
        )

    def final_labels(self, T_map_base: FloatArray) -> list[BoolArray] | None:
        """Judge every scan again at its optimised pose (n, 3); None for a method that does not look back."""
        if not self._has_backward_pass:
            return None
        return retrospective_labels(
            self._history,
            T_map_base,
            grid=self.grid.config,
            window_m=2.0 * self.config.max_range_m + 20.0,
            motion=self.config.motion,
            clusters=self.config.clusters,
            tracks=self.config.tracks,
        )

    def moving_points(self, T_map_base: FloatArray, labels: list[BoolArray]) -> FloatArray:
        """(m, 2) points [m] of all scans that the final labels call moving, with their poses (n, 3), map frame."""
        found = [
            self._history[k].scan.points(T_map_base[k])[is_moving]
            for k, is_moving in enumerate(labels)
            if is_moving.any()
        ]
        return np.concatenate([_NOWHERE, *found])

    def nodes_and_edges(self) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
        """Give the pose graph as it is now: optimised poses (m, 3) in the map frame, and edges; cheap."""
        return self.localizer.nodes_and_edges()

    def final(self) -> FinalEstimate:
        """Give the trajectory and the graph of all scans so far, optimised."""
        return self.localizer.final()

    def render_map(self) -> GridMap:
        """Render the map: from the nodes' scans at their optimised poses where there is a graph."""
        if not self.grid.is_rolling:
            return self.grid.to_map()
        grid = OccupancyGrid(self.config.grid)
        for number, T_map_base in zip(self._node_scans, self.nodes_and_edges()[0], strict=False):
            if number == len(self._history):  # the scan at which a run was cut short
                break
            seen = self._history[number]
            origin = se2.transform(T_map_base, seen.scan.laser.origin_base[None])[0]
            is_static = seen.is_valid & ~seen.is_moving
            is_hit = seen.is_valid if self.config.occupy_with_moving else is_static
            grid.update(
                number, origin, seen.scan.points(T_map_base), seen.is_valid, is_hit, seen.is_valid & ~is_hit
            )
        return grid.to_map()

    def crop_test_grid(self, centre_map: FloatArray, half_side_m: float) -> tuple[GridMap, FloatArray]:
        """Give the test's grid as it is now around a place (2,) of the map [m]: as the next scan's test sees it.

        Its origin is in the local frame; the second is that frame's pose (3,) in the map.
        """
        T_map_local = self.localizer.T_map_local
        centre = se2.transform(se2.inverse(T_map_local), centre_map[None])[0]
        return self.grid.crop(centre, half_side_m), T_map_local

    def close(self) -> None:
        """Release the pose graph's thread and the temporary file of the scans."""
        self.localizer.close()
        self._history.close()

    def _test_covariance(self, estimate: Estimate) -> FloatArray:
        """Pose covariance that the moving-point test uses."""
        if self.config.test_covariance == "constant":
            return self.config.constant_noise.covariance(se2.IDENTITY)
        if self.config.test_covariance == "absolute":
            return estimate.cov_absolute
        return estimate.cov_relative

    def _kernel_factor(self, detection: Detection, is_valid: BoolArray) -> float:
        """How much narrower the match's kernel should be: in a crowd what is left may still be people; else 1."""
        share = np.count_nonzero(detection.is_moving) / max(int(np.count_nonzero(is_valid)), 1)
        return max((1.0 - share) ** 2, LEAST_KERNEL_FACTOR) if share > self.config.crowd_share else 1.0

    def _judge(
        self,
        scan: Scan,
        is_valid: BoolArray,
        detection: Detection,
        T_tested: FloatArray,
        matched: Estimate,
        match: MatchResult | None,
        hints: _Hints,
    ) -> Detection:
        """Repeat the test at the matched pose, or stand back where the match does not deserve it.

        A match refused as improbable leaves the prediction, and with it the test already made there, at `T_tested`;
        so does one that moves no point by more than `SAME_CELLS` of a cell.
        """
        if match is not None and match.status == "failed":
            return detection if match.is_refused else detection.abstain()
        if match is not None and match.nis > self.config.motion.abstain_nis:
            return detection.abstain()
        distance_m, turn_rad = se2.distance(T_tested, matched.T_local_base)
        if distance_m + turn_rad * self.config.max_range_m < SAME_CELLS * self.grid.config.resolution_m:
            return detection
        vacated = self.visibility_check.vacated(scan, matched.T_local_base, is_valid)
        return self._detect(scan, is_valid, matched, replace(hints, vacated=vacated))

    def _hints(self, scan: Scan, is_valid: BoolArray, predicted: Estimate) -> _Hints:
        """What the scans before tell about this one, where it is predicted."""
        if not self.config.filter_moving:
            return _Hints(predicted_positions=_NOWHERE, vacated=_NOWHERE)
        return _Hints(
            predicted_positions=self.tracker.predicted_positions(scan.stamp),
            vacated=self.visibility_check.vacated(scan, predicted.T_local_base, is_valid),
        )

    def _detect(self, scan: Scan, is_valid: BoolArray, estimate: Estimate, hints: _Hints) -> Detection:
        if not self.config.filter_moving:
            return Detection.nothing(is_valid)
        return detect_moving(
            scan,
            is_valid,
            estimate.T_local_base,
            self._test_covariance(estimate),
            self.grid,
            self.config.motion,
            self.config.clusters,
            hints.predicted_positions,
            hints.vacated,
            self.config.visibility_check.reach_m,
        )

    def _remember(
        self, scan: Scan, is_valid: BoolArray, detection: Detection, matched: Estimate, is_doubtful: bool
    ) -> None:
        """Keep what the final labels and the map of the nodes' scans need."""
        if not (self._has_backward_pass or self.grid.is_rolling):
            return
        self._history.append(
            scan,
            is_valid=is_valid,
            is_moving=detection.is_moving,
            reason=detection.reason,
            displaced=[track.beams for track in self.tracker.displaced()],
            cov_relative=self._test_covariance(matched),
            window=self.grid.oldest,
            is_doubtful=is_doubtful,
        )

    def _forget(self, scan: Scan) -> None:
        """The robot is lost: what the test remembers lies elsewhere."""
        self._n_times_lost = self.localizer.n_times_lost
        self._first_remembered = scan.index
        self.visibility_check = VisibilityCheck(self.config.visibility_check)

    def _update_map(
        self,
        scan: Scan,
        points: FloatArray,
        is_valid: BoolArray,
        is_static: BoolArray,
        matched: Estimate,
    ) -> None:
        """Static points occupy, all beams free the cells they cross."""
        T = matched.T_local_base
        ends, is_beam = points, is_valid
        if self.config.free_no_return_m > 0.0:
            is_missing = scan.is_no_return(MIN_NO_RETURN_RUN)
            if is_missing.any():
                reach_m = min(self.config.free_no_return_m, scan.laser.range_max)
                far = scan.laser.origin_base + reach_m * scan.laser.directions_base
                ends = np.where(is_missing[:, None], se2.transform(T, far), points)
                is_beam = is_valid | is_missing
        origin = se2.transform(T, scan.laser.origin_base[None])[0]
        is_hit = is_valid if self.config.occupy_with_moving else is_static
        self.grid.update(scan.index, origin, ends, is_beam, is_hit, is_valid & ~is_hit)

    def _track(self, scan: Scan, detection: Detection, points: FloatArray) -> tuple[TrackState, ...]:
        """Feed the clusters of moving points to the tracker; report the tracks in the map frame."""
        if not detection.n_clusters and not self.tracker.tracks:
            return ()
        tracks = self.tracker.update(scan.stamp, *detection.clusters(points))
        if not tracks:
            return ()
        T_map_local = self.localizer.T_map_local
        R = se2.rotation(T_map_local[2])
        turned = np.array([track.state for track in tracks]).reshape(-1, 2, 2) @ R.T  # rows: place, velocity
        places = turned[:, 0] + T_map_local[:2]
        covs = R @ np.array([track.cov for track in tracks])[:, :2, :2] @ R.T
        return tuple(
            TrackState(
                track_id=track.track_id,
                position=place,
                velocity=velocity,
                position_cov=cov,
                beams=track.beams,
            )
            for track, place, velocity, cov in zip(tracks, places, turned[:, 1], covs, strict=True)
        )


def _make_localizer(config: PipelineConfig) -> Localizer:
    if config.matcher == "none":
        return DeadReckoning(config.odometry_noise)
    if config.matcher == "scan-to-scan":
        return ScanToScan(config.odometry_noise, config.point_to_point)
    return ScanToMap(
        config.odometry_noise,
        ScanToMapConfig(
            n_lost=config.n_lost,
            close_loops=config.close_loops,
            local_map=config.local_map,
            point_to_line=config.point_to_line,
            graph=config.graph,
            closure=config.closure,
        ),
    )


def _typed(texts: list[str], scan: int, closures: tuple[ClosureAttempt, ...]) -> tuple[Event, ...]:
    """Events of a commit; the last ones are those of its closures."""
    events = []
    for text in texts[: len(texts) - len(closures)]:
        kind, reason = text.split(": ", 1)
        if kind == "match failed":
            events.append(Event(kind="match failed", severity="warning", scan=scan, data={"reason": reason}))
        else:
            reason = reason.removesuffix(", a new local map begins here")
            events.append(Event(kind="lost", severity="error", scan=scan, data={"reason": reason}))
    for attempt in closures:
        data = {
            "target_node": attempt.target_node,
            "source_node": attempt.source_node,
            "reason": attempt.reason,
        }
        kinds: dict[ClosureStatus, tuple[EventKind, Severity]] = {
            "accepted": ("closure accepted", "info"),
            "waiting": ("closure waiting", "info"),
            "refused": ("closure refused", "info"),
            "outlier": ("closure rejected", "warning"),
        }
        closure_kind, severity = kinds[attempt.status]
        events.append(Event(kind=closure_kind, severity=severity, scan=scan, data=data))
    return tuple(events)


_NOWHERE: FloatArray = np.empty((0, 2))
