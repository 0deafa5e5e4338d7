"""The step: predict, detect, match, graph, map, objects. One scan in, one `StepResult` out."""

import math
from array import array
from collections.abc import Sequence
from types import TracebackType

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.results import GraphEdge, GridMap, StepResult, TrackState
from slammot_graph.core.saved_map import MapStart
from slammot_graph.core.scan import Scan
from slammot_graph.core.spool import Spool
from slammot_graph.core.stopwatch import Stopwatch
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection.backward_pass import FinalViews, sightings_of_views
from slammot_graph.detection.base import NO_CLUSTERS, Detection
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.detection.factory import make_detector
from slammot_graph.detection.reasons import FREE
from slammot_graph.detection.scan_history import SURE_P, ScanHistory
from slammot_graph.detection.untracked import without_untracked
from slammot_graph.localization.base import Estimate, FinalEstimate
from slammot_graph.localization.blind_scans import BlindScans
from slammot_graph.localization.factory import make_localizer
from slammot_graph.localization.health import HealthMonitor
from slammot_graph.mapping.changes import Changes
from slammot_graph.mapping.final_map import MapScan, render_final_map
from slammot_graph.mapping.occupancy_grid import OccupancyGrid
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.tracking.base import ScanView
from slammot_graph.tracking.clock import rising_times
from slammot_graph.tracking.factory import make_tracker
from slammot_graph.tracking.segment_config import SegmentTrackerConfig
from slammot_graph.tracking.smoothing import SightingHistory, SmoothedTracks, smooth_tracks
from slammot_graph.tracking.track_extension import TrackExtension

__all__ = ["Pipeline", "PipelineConfig"]


FEW_BYTES = 2 << 20
"""So much of its scans a run keeps in memory that only localizes, and may go on for days."""


class Pipeline:
    """Localizes, maps and detects moving objects, one scan at a time; a context manager that closes itself.

    Parameters
    ----------
    config : PipelineConfig
        As of a method of the registry, or your own.
    start : MapStart, optional
        A saved map to start from; the configuration must have a graph with loop closure.

    Attributes
    ----------
    localizer : Localizer
    detector : Detector
    tracker : Tracker
    health : HealthMonitor
    grid : OccupancyGrid or None
        The map as it grows; None where it is made from all scans at the end.

    Examples
    --------
    >>> with Pipeline(get_method("graph").config) as pipeline:     # doctest: +SKIP
    ...     for scan in open_log("intel.clf.bz2"):
    ...         result = pipeline.step(scan)
    """

    def __init__(self, config: PipelineConfig, start: MapStart | None = None) -> None:
        self.config = config
        self.localizer = make_localizer(config.localizer, config.odometry_noise, start)
        self.grid = None if config.has_graph else OccupancyGrid(config.grid)
        self.detector = make_detector(config.detector, max_range_m=config.max_range_m, map_grid=self.grid)
        self.tracker = make_tracker(config.tracker)
        self.health = HealthMonitor()
        self._blind_scans = BlindScans()
        is_kept_flat = start is not None and start.localize
        self._history = ScanHistory(FEW_BYTES) if is_kept_flat else ScanHistory()
        self._sightings = SightingHistory()
        self._stamps = array("d")
        self._stopwatch = Stopwatch()
        self._lasers: set[int] = set()

    def __enter__(self) -> "Pipeline":
        """Give the pipeline itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the pipeline."""
        self.close()

    @property
    def spools(self) -> tuple[Spool, ...]:
        """What grows with the scans."""
        return *self._history.spools, *self.localizer.spools

    def step(self, scan: Scan) -> StepResult:
        """Take in the next scan."""
        watch = self._stopwatch
        watch.restart()
        scan, blind_events = self._blind_scans.emptied(scan)
        is_valid = scan.is_valid(self.config.max_range_m, self.config.range_fraction)
        predicted = self.localizer.predict(scan)
        scan = self.localizer.deskew(scan)
        watch.lap("predict")
        predicted_positions = self.tracker.predicted_positions(scan.stamp)
        detection = self.detector.detect(scan, is_valid, predicted, predicted_positions)
        watch.lap("detect")
        scan, matched, match, detection = self._match(scan, is_valid, detection, predicted_positions)
        self._blind_scans.found_at(matched.T_local_base)
        points = scan.points(matched.T_local_base)
        p_moving = self.detector.p_moving(scan, detection, points, predicted_positions)
        detection = self.detector.settle(detection, scan.ranges, is_valid, p_moving)
        is_static = detection.is_mapped(is_valid)
        watch.lap("detect")
        committed = self.localizer.commit(scan, scan.points_base(), is_static)
        watch.lap("graph")
        if self.grid is not None and committed.is_mapped:
            self.grid.add_scan(scan.index, scan, matched.T_local_base, points, is_valid, is_static)
        self.detector.update(
            scan,
            points,
            is_valid,
            is_static,
            matched.T_local_base,
            is_keyframe=committed.is_keyframe,
            is_lost=committed.is_lost and not committed.is_place_known,
        )
        watch.lap("map")
        tracks = self._track(scan, is_valid, detection, points, matched.T_local_base)
        self._remember(scan, is_valid, detection, p_moving, matched, match)
        health = self.health.update(
            scan.index,
            match,
            is_lost=committed.is_lost,
            expects_match=self.config.has_matches and committed.expects_match,
        )
        watch.lap("objects")
        T_map_local = self.localizer.T_map_local
        return StepResult(
            scan=scan,
            T_map_base=se2.compose(T_map_local, matched.T_local_base),
            cov_map=matched.cov_absolute,
            T_map_base_predicted=se2.compose(T_map_local, predicted.T_local_base),
            cov_relative=self.detector.pose_covariance(predicted),
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
            node=committed.node,
            events=(*blind_events, *committed.events, *health.events),
            stage_ms=watch.read(),
            closures=committed.closures,
            health=committed.health or health.state,
        )

    def final_labels(self, T_map_base: FloatArray) -> list[BoolArray] | None:
        """Test every scan again at its optimised pose (n, 3); None for a method without a backward pass."""
        tracker = make_tracker(self.config.tracker)
        return self.detector.retrospective_labels(self._history, T_map_base, tracker)

    def final_tracks(self, T_map_base: FloatArray, labels: list[BoolArray] | None) -> SmoothedTracks | None:
        """Link and smooth the tracks at the optimised poses (n, 3); None for a tracker that keeps no sightings.

        What the final labels call moving is tracked, or the labels of the time where those could not be computed; for a
        method without a backward pass what was tracked at the time.
        """
        config = self.config.tracker
        if not isinstance(config, SegmentTrackerConfig) or config.smoothing is None:
            return None
        stamps = rising_times(np.array(self._stamps[: len(T_map_base)]), config.max_missed_s)
        sightings, extension = self._sightings.table(), None
        detector = self.config.detector
        if isinstance(detector, EllipseDetectorConfig) and self.detector.has_backward_pass:
            known = [seen.is_moving for seen in self._history] if labels is None else labels
            view = FinalViews(
                self._history,
                T_map_base,
                known,
                ellipse_test=detector.ellipse_test,
                range_fraction=self.config.range_fraction,
            )
            sightings = sightings_of_views(view, stamps, T_map_base, make_tracker(config))
            extension = TrackExtension(view, stamps, config.limits())
        return smooth_tracks(sightings, stamps, T_map_base, config.smoothing, extension)

    def labels_with_tracks(
        self, T_map_base: FloatArray, labels: list[BoolArray], tracks: SmoothedTracks
    ) -> list[BoolArray]:
        """Take back final labels that no final track supports, at the optimised poses (n, 3)."""
        if not isinstance(self.config.detector, EllipseDetectorConfig):
            return labels
        return without_untracked(
            labels,
            self._history,
            T_map_base,
            clusters=self.config.detector.clusters,
            track_scans=tracks.scans,
            track_places=tracks.states[:, :2],
        )

    def moving_points(self, T_map_base: FloatArray, labels: list[BoolArray]) -> FloatArray:
        """(m, 2) points [m] of all scans that the final labels call moving, with their poses (n, 3), map frame."""
        found = [
            self._history[k].scan.points(T_map_base[k])[is_moving]
            for k, is_moving in enumerate(labels)
            if is_moving.any()
        ]
        return np.concatenate([np.empty((0, 2)), *found])

    def changed_points(
        self, T_map_base: FloatArray, changes: Changes, labels: Sequence[BoolArray] | None = None
    ) -> list[BoolArray]:
        """Tell which static points of all scans are of what is new; poses (n, 3) and labels as of `render_map`."""
        n = min(len(self._history), len(T_map_base))
        found = []
        for k in range(n):
            seen = self._history[k]
            is_static = seen.is_valid & ~(seen.is_moving if labels is None else labels[k])
            found.append(is_static & changes.are_new(seen.scan.points(T_map_base[k])))
        return found

    def nodes_and_edges(self) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
        """Give the pose graph as it is now: optimised poses (m, 3) in the map frame, and edges; cheap."""
        return self.localizer.nodes_and_edges()

    def odometry_report(self) -> OdometryReport:
        """Give what the matches so far tell of the odometry."""
        return self.localizer.odometry_report()

    def final(self) -> FinalEstimate:
        """Give the trajectory and the graph of all scans so far, optimised."""
        return self.localizer.final()

    def render_map(
        self, T_map_base: FloatArray | None = None, labels: Sequence[BoolArray] | None = None
    ) -> GridMap:
        """Render the map: where there is a graph from all scans, weighted by viewpoint (`mapping.final_map`).

        Parameters
        ----------
        T_map_base : (n, 3) array, optional
            Optimised poses of the scans so far; computed if not given.
        labels : sequence of n bool arrays, optional
            Which points move; by default as decided at the time.

        Raises
        ------
        PartialMapError
            Not all that was seen fits into one map.
        """
        if self.grid is not None:
            return self.grid.to_map()
        poses = self.final().T_map_base if T_map_base is None else T_map_base
        n = min(len(self._history), len(poses))  # a run may have been cut short within a scan

        def scan_at(k: int) -> MapScan:
            seen = self._history[k]
            is_moving = seen.is_moving if labels is None else labels[k]
            return MapScan(scan=seen.scan, is_valid=seen.is_valid, is_static=seen.is_valid & ~is_moving)

        stamps = np.array(self._history.stamps[:n])
        return render_final_map(
            scan_at,
            stamps,
            poses[:n],
            grid=self.config.grid,
            config=self.config.final_map,
            lasers=np.array(self._history.laser_numbers[:n]),
        )

    def crop_test_grid(self, centre_map: FloatArray, half_side_m: float) -> tuple[GridMap, FloatArray]:
        """Give the test's grid as it is now around a place (2,) of the map [m]: as the next scan's test sees it.

        Its origin is in the local frame; the second is that frame's pose (3,) in the map. A method that makes no test
        has no such grid: `detector.grid` is None.
        """
        if self.detector.grid is None:
            raise ValueError("this method makes no test: there is no grid to crop")
        T_map_local = self.localizer.T_map_local
        centre = se2.transform(se2.inverse(T_map_local), centre_map[None])[0]
        return self.detector.grid.crop(centre, half_side_m), T_map_local

    def close(self) -> None:
        """Release the pose graph's thread and the temporary file of the scans."""
        self.localizer.close()
        self._history.close()

    def _match(
        self, scan: Scan, is_valid: BoolArray, detection: Detection, predicted_positions: FloatArray
    ) -> tuple[Scan, Estimate, MatchResult | None, Detection]:
        """Match what does not move and test again at the matched pose; in a crowd, once more with a narrower kernel."""
        scan, matched, match = self._match_sweep(scan, is_valid, detection)
        self._stopwatch.lap("match")
        if match is None:
            return scan, matched, match, detection
        detection = self.detector.retest(scan, is_valid, detection, matched, match, predicted_positions)
        factor = self.detector.kernel_factor(detection, is_valid)
        if factor < 1.0:
            self._stopwatch.lap("detect")
            scan, matched, match = self._match_sweep(scan, is_valid, detection, factor)
            self._stopwatch.lap("match")
            if match is not None:
                detection = self.detector.retest(
                    scan, is_valid, detection, matched, match, predicted_positions
                )
        return scan, matched, match, detection

    def _match_sweep(
        self, scan: Scan, is_valid: BoolArray, detection: Detection, kernel_factor: float = 1.0
    ) -> tuple[Scan, Estimate, MatchResult | None]:
        """Match a scan; a sweep again and again, as each match tells how to deskew it better."""
        localizer, is_static = self.localizer, detection.is_matched(is_valid)
        matched, match = localizer.match(
            scan.points_base(), is_static, kernel_factor=kernel_factor, is_valid=is_valid
        )
        if scan.sweep is None:
            return scan, matched, match
        while (deskewed := localizer.deskew_again(scan, is_static)) is not None:
            scan = deskewed
            localizer.match(scan.points_base(), is_static, kernel_factor=kernel_factor, is_valid=is_valid)
        return localizer.join_sweep(scan)

    def _track(
        self,
        scan: Scan,
        is_valid: BoolArray,
        detection: Detection,
        points: FloatArray,
        T_local_base: FloatArray,
    ) -> tuple[TrackState, ...]:
        """Feed the clusters of moving points to the tracker; report the tracks in the map frame."""
        self._stamps.append(scan.stamp)
        self._lasers.add(scan.laser.number)
        if not detection.n_clusters and not self.tracker.n_tracks:
            return ()
        view = ScanView.of_scan(
            scan,
            T_local_base,
            points,
            packed_cov=detection.packed_cov,
            cluster=detection.cluster,
            is_proven=detection.reason == FREE,
            is_valid=is_valid,
            range_fraction=self.config.range_fraction,
        )
        if len(self._lasers) > 1:
            view = view.by_one_of_several()
        clusters = detection.clusters(points) if self.tracker.needs_clusters else NO_CLUSTERS
        self.tracker.update(scan.stamp, *clusters, view)
        sightings = None if self.detector.has_backward_pass else self.tracker.sightings
        if sightings is not None:
            self._sightings.add(len(self._stamps) - 1, sightings, T_local_base)
        return self.tracker.shown_in(self.localizer.T_map_local)

    def _remember(
        self,
        scan: Scan,
        is_valid: BoolArray,
        detection: Detection,
        p_moving: FloatArray,
        matched: Estimate,
        match: MatchResult | None,
    ) -> None:
        """Keep what the final labels and the map need."""
        if not (self.detector.has_backward_pass or self.grid is None):
            return
        self._history.append(
            scan,
            is_valid=is_valid,
            is_moving=detection.is_moving,
            reason=detection.reason,
            marks=np.vstack([self.tracker.on_objects(len(is_valid)), p_moving >= SURE_P]),
            cov_relative=self.detector.pose_covariance(matched),
            window=self.detector.window_start,
            is_doubtful=match is not None and match.status == "failed",
        )
