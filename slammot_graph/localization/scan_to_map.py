"""Our localization: scans matched onto the local map, keyframes joined in the pose graph."""

from dataclasses import replace
from functools import partial

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import Event, make_event
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.results import ClosureAttempt, GraphEdge
from slammot_graph.core.saved_map import MapStart
from slammot_graph.core.scan import Scan
from slammot_graph.core.spool import Spool
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.graph import PoseGraph
from slammot_graph.localization.base import FIRST_COV, CommitResult, Estimate, FinalEstimate
from slammot_graph.localization.chance_agreement import stands_out
from slammot_graph.localization.config import ScanToMapConfig
from slammot_graph.localization.graph_insertion import GraphInsertion
from slammot_graph.localization.lost_detector import Loss, LostDetector
from slammot_graph.localization.map_matching import MapMatching
from slammot_graph.localization.scan_poses import ScanPoses
from slammot_graph.localization.sweep_estimate import SweepEnd, SweepEstimate
from slammot_graph.loop_closure import LoopCloser
from slammot_graph.mapping.local_map import NO_NODE, LocalMap, make_keyframe
from slammot_graph.odometry.motion import MatchedPose
from slammot_graph.odometry.propagation import MotionModel, Propagation


class ScanToMap:
    """Point-to-line matching on a local map in front, a pose graph behind.

    The local frame is that of the matching alone; the graph says where it lies in the map.

    Attributes
    ----------
    config : ScanToMapConfig
    local_map : LocalMap
    propagation : Propagation
        The pose in the local frame.
    matching : MapMatching
    lost : LostDetector
    insertion : GraphInsertion
        The graph, its loop closing, and what is known since the latest keyframe.
    """

    def __init__(self, model: MotionModel, config: ScanToMapConfig, start: MapStart | None = None) -> None:
        self.config = config
        self.local_map = LocalMap(config.local_map)
        self.propagation = Propagation(model, FIRST_COV)
        self.matching = MapMatching(config, self.local_map)
        self.lost = LostDetector(config.n_lost, config.kidnapped_distance_m)
        self.insertion = GraphInsertion(config, self.local_map)
        self._match: MatchResult | None = None
        self._sweep: SweepEstimate | None = None
        self._sweep_before: SweepEnd | None = None
        self._sweep_end: SweepEnd | None = None
        self._T_local_anchor: FloatArray = se2.IDENTITY
        self._scan_poses = ScanPoses()
        if start is not None:
            self.insertion.start_from(start)

    @property
    def graph(self) -> PoseGraph:
        """The pose graph."""
        return self.insertion.graph

    @property
    def closer(self) -> LoopCloser | None:
        """The loop closing, if there is any."""
        return self.insertion.closer

    @property
    def T_map_local(self) -> FloatArray:
        """See `Localizer`."""
        return self.insertion.keyframes.T_map_local

    @property
    def spools(self) -> tuple[Spool, ...]:
        """See `Localizer`."""
        return self._scan_poses.spool, *self.graph.spools

    def predict(self, scan: Scan) -> Estimate:
        """See `Localizer`."""
        self.propagation.predict(scan)
        self.matching.start_scan(
            scan.origins_base,
            self.propagation.T_local_before,
            has_odometry=scan.T_odom_base is not None,
            most_change_m=self.propagation.model.most_change_m,
        )
        self._sweep, self._sweep_before, self._sweep_end = None, self._sweep_end, None
        self.matching.scale_noise(self.propagation.model.match_noise_scale)
        return self._estimate()

    def deskew(self, scan: Scan) -> Scan:
        """See `Localizer`: by the motion model."""
        if scan.beam_times is None:
            return scan
        sweep = self.propagation.model.during_sweep(scan)
        self._sweep = SweepEstimate(sweep, self.config.point_to_line)
        return self._seen_from(replace(scan, sweep=sweep))

    def deskew_again(self, scan: Scan, is_static: BoolArray) -> Scan | None:
        """See `Localizer`: the velocity that brings all parts of the sweep onto the local map."""
        match = self._match
        if self._sweep is None or match is None or match.status == "failed":
            return None
        state = self.propagation.state
        sweep = self._sweep.improved(
            scan, is_static, self.local_map, state.T_local_base, self.propagation.predicted.cov_prior
        )
        return None if sweep is None else self._seen_from(replace(scan, sweep=sweep))

    def match(
        self,
        points_base: FloatArray,
        is_static: BoolArray,
        kernel_factor: float = 1.0,
        is_valid: BoolArray | None = None,
    ) -> tuple[Estimate, MatchResult | None]:
        """See `Localizer`."""
        self._match = None
        start = self.propagation.restart()
        if self.local_map.keyframes:
            self._T_local_anchor = self.local_map.anchor.T_local_base
            self._match, self.propagation.state = self.matching.match(
                points_base, is_static, start, kernel_factor, is_valid
            )
            if self._sweep is not None:
                self._match, self.propagation.state = self._sweep.widened(self._match, self.propagation.state)
            if self.propagation.model.is_contradicted:
                self._match = replace(self._match, contradicts_odometry=True)
        return self._estimate(), self._match

    def commit(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """See `Localizer`."""
        propagation, insertion = self.propagation, self.insertion
        has_points = bool(np.count_nonzero(is_static) >= self.config.point_to_line.min_pairs)
        events, loss = self._look_for_loss(scan, points_base, is_static, has_points)
        is_lost = loss is not None
        if loss is not None:
            self._sweep_end = None
            lost_cov, lost_m = self.config.lost_cov, self.config.lost_distance_m
            propagation.lose_track(*((0.0 * lost_cov, 0.0) if loss.is_known else (lost_cov, lost_m)))
            insertion.start_component(propagation.path_m, is_known=loss.is_known)
        state, T_odom_base = propagation.state, propagation.T_odom_base
        node, closures = None, tuple[ClosureAttempt, ...]()
        wants = self.local_map.wants(state.T_local_base, scan.laser.number)
        is_keyframe = not insertion.has_node or (has_points and wants)
        if is_keyframe:
            insertion.advance(state, T_odom_base, self._match)
            propagation.start_keyframe()
            if insertion.needs_node():
                node = insertion.add_node(
                    scan.index,
                    state.T_local_base,
                    T_odom_base,
                    self._match,
                    propagation.model.common_stds,
                )
            if has_points:
                closures = self._add_keyframe(node, scan, points_base, is_static)
        closures += insertion.search_on()
        self._attach()
        propagation.commit(None if is_lost else self._matched_pose())
        return CommitResult(
            node=node,
            is_keyframe=is_keyframe,
            is_lost=is_lost,
            is_place_known=loss is not None and loss.is_known and scan.T_odom_base is not None,
            closures=closures,
            events=(
                *events,
                *[attempt.event(scan.index) for attempt in closures],
                *(self._dropped(scan.index) if self.graph.dropped else ()),
            ),
            health=None if insertion.is_placed else "lost",
        )

    def _dropped(self, scan: int) -> list[Event]:
        """Tell of what the graph could not take in."""
        dropped, self.graph.dropped = self.graph.dropped, []
        return [
            make_event(
                "factor dropped",
                scan,
                factor=edge.kind,
                from_node=edge.from_node,
                to_node=edge.to_node,
                reason=reason,
            )
            for edge, reason in dropped
        ]

    def odometry_report(self) -> OdometryReport:
        """See `Localizer`."""
        return self.propagation.model.report()

    def nodes_and_edges(self) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
        """See `Localizer`."""
        return self.graph.snapshot().poses(), self.graph.all_edges

    def final(self) -> FinalEstimate:
        """See `Localizer`."""
        if not len(self._scan_poses):
            nothing = np.empty((0, 3))
            no_nodes = np.empty(0, dtype=np.int64)
            return FinalEstimate(
                T_map_base=nothing, cov_map=np.empty((0, 3, 3)), node_scans=no_nodes, nodes=nothing, edges=()
            )
        nodes, covs = self.insertion.solved()
        T_map_base, cov_map = self._scan_poses.trajectory(nodes, covs)
        return FinalEstimate(
            T_map_base=T_map_base,
            cov_map=cov_map,
            node_scans=np.array(self.insertion.node_scans),
            nodes=nodes,
            edges=self.graph.all_edges,
            saved_map=self.insertion.saved_map(nodes, self.propagation.path_m, self.odometry_report()),
            n_spare=self.insertion.n_spare,
            earlier=self.insertion.earlier_map(nodes),
        )

    def close(self) -> None:
        """See `Localizer`."""
        self.graph.close()

    def join_sweep(self, scan: Scan) -> tuple[Scan, Estimate, MatchResult | None]:
        """See `Localizer`: by a Kalman update of pose and velocity."""
        if self._sweep is None or self._match is None:
            return scan, self._estimate(), self._match
        scan, joined, self.propagation.state, self._sweep_end = self._sweep.joined(scan, self._sweep_before)
        self._match = replace(joined, contradicts_odometry=self._match.contradicts_odometry)
        return self._seen_from(scan), self._estimate(), self._match

    def _seen_from(self, scan: Scan) -> Scan:
        """Let the next match know where the beams of a deskewed scan start."""
        self.matching.laser_base = scan.origins_base
        return scan

    def _estimate(self) -> Estimate:
        state = self.propagation.state
        anchor, T_anchor_base = self.insertion.anchor(state.T_local_base)
        cov_relative = state.cov_relative
        node_scans = self.insertion.node_scans
        cov_anchor = self.insertion.cov_anchor + self.insertion.keyframes.common_errors.cov(anchor)
        return Estimate(
            T_local_base=state.T_local_base,
            cov_relative=cov_relative,
            cov_absolute=se2.compound_covariance(cov_anchor, T_anchor_base, cov_relative),
            T_anchor_base=T_anchor_base,
            anchor_scan=node_scans[anchor] if node_scans else -1,
        )

    def _matched_pose(self) -> MatchedPose | None:
        """Where the match alone found the base, for the motion model to learn from."""
        match = self._match
        if match is None or match.status == "failed":
            return None
        return MatchedPose(
            T_local_base=se2.compose(self._T_local_anchor, match.T_ref_base),
            cov=match.cov,
            cov_independent=match.cov - match.cov_correlated,
            agreement=self.matching.agreement(match),
            is_reliable=(
                match.status == "converged"
                and self.matching.is_agreed(match)
                and self.matching.is_supported(match)
            ),
            is_elsewhere=self.matching.is_elsewhere,
            is_told=not self.matching.is_unsure(match, self.propagation.predicted.doubt),
        )

    def _look_for_loss(
        self, scan: Scan, points_base: FloatArray, is_static: BoolArray, has_points: bool
    ) -> tuple[list[Event], Loss | None]:
        """Tell of a match that failed, and of a robot that is lost."""
        events = list[Event]()
        is_predicted = False
        if self._match is not None and self._match.status == "failed":
            events.append(make_event("match failed", scan.index, reason=self._match.reason))
            agreement_at = partial(self.matching.agreement_at, points_base, is_static)
            is_predicted = has_points and stands_out(agreement_at, self.propagation.state.T_local_base)
        loss = self.lost.update(
            self._match,
            self.propagation.T_odom_base,
            has_points=has_points,
            has_local_map=bool(self.local_map.keyframes),
            has_odometry=scan.T_odom_base is not None,
            is_adrift=self.matching.is_adrift,
            stands_out=is_predicted,
        )
        if loss is not None:
            events.append(make_event("lost", scan.index, cause=loss.cause, n_scans=loss.n_scans))
        return events, loss

    def _add_keyframe(
        self, node: int | None, scan: Scan, points_base: FloatArray, is_static: BoolArray
    ) -> tuple[ClosureAttempt, ...]:
        """Add the scan to the local map; gives the closures tried."""
        propagation = self.propagation
        keyframe = make_keyframe(
            NO_NODE if node is None else node,
            propagation.state.T_local_base,
            points_base,
            is_static,
            scan.laser,
            self.local_map.config,
            scan.origins_base,
        )
        propagation.state, closures = self.insertion.add_keyframe(
            keyframe, node, propagation.state, propagation.path_m
        )
        return closures

    def _attach(self) -> None:
        """Attach the scan to the last node, and to the anchor of its local map."""
        state = self.propagation.state
        anchor, T_anchor_base = self.insertion.anchor(state.T_local_base)
        T_node_base = self.insertion.keyframes.on_node(state.T_local_base)
        self._scan_poses.append(len(self.graph) - 1, T_node_base, anchor, T_anchor_base, state.cov_relative)
