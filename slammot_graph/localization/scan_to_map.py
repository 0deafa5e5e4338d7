"""Our localization: scans matched onto the local map, keyframes joined in the pose graph."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import Event, EventKind
from slammot_graph.core.linalg import invert
from slammot_graph.core.results import ClosureAttempt, GraphEdge, MatchResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.graph import LocalFactors, PoseGraph, PoseGraphConfig
from slammot_graph.localization.base import FIRST_COV, CommitResult, Estimate, FinalEstimate, fuse, refuse
from slammot_graph.localization.scan_poses import ScanPoses
from slammot_graph.loop_closure.detector import LoopCloser, LoopClosureConfig
from slammot_graph.loop_closure.submap import Submap
from slammot_graph.mapping.local_map import NO_NODE, Keyframe, LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise
from slammot_graph.registration.point_to_line import PointToLineConfig, match_to_local_map

LOST_STD = (3.0, 3.0, 0.8)
"""Standard deviations [m, m, rad] of the way since the last node when the robot is lost."""

JUMP_INLIERS, JUMP_NIS = 0.6, 45.0
"""A match with fewer inliers and a larger normalised innovation squared is tried again without the odometry."""

MOST_NIS = 50.0
"""A single innovation counts for no more than this in the running mean of its normalised square."""

KIDNAPPED_DISTANCE_M = 0.2
"""A robot whose wheels turned less than this while it saw nothing may have been carried."""

LOST_DISTANCE_M = 20.0
"""Way that a lost robot may have been carried, when it comes to recognising places."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Prediction:
    """What a match starts from, so that a scan can be matched again."""

    T_local_base: FloatArray
    cov_prior: FloatArray
    cov_independent: FloatArray
    cov_odometry: FloatArray
    doubt: float


@dataclass(frozen=True, kw_only=True)
class ScanToMapConfig:
    """Ours: point-to-line matching on a local map, keyframes in a pose graph.

    Attributes
    ----------
    n_lost : int
        After this many failed matches in a row a new local map is started.
    close_loops : bool
    local_map, point_to_line, graph, closure
        Configuration of the parts.
    """

    n_lost: int = 5
    close_loops: bool = True
    local_map: LocalMapConfig = field(default_factory=LocalMapConfig)
    point_to_line: PointToLineConfig = field(default_factory=PointToLineConfig)
    graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    closure: LoopClosureConfig = field(default_factory=LoopClosureConfig)


class ScanToMap:
    """Point-to-line matching on a local map in front, a pose graph behind.

    The local frame is that of the matching alone; the graph says where it lies in the map.
    """

    def __init__(
        self,
        noise: OdometryNoise | ConstantNoise,
        config: ScanToMapConfig,
    ) -> None:
        self.noise = noise
        self.config = config.point_to_line
        self.matching = config.point_to_line
        self.n_lost = config.n_lost
        self.local_map = LocalMap(config.local_map)
        self.graph = PoseGraph(config.graph)
        self.local_factors = LocalFactors()
        self.closer = LoopCloser(config.closure, config.local_map, self.graph) if config.close_loops else None
        self._n_submaps = 0
        self.n_times_lost = 0
        self._path_m = 0.0
        self._closures: tuple[ClosureAttempt, ...] = ()
        self._T_local_base: FloatArray = se2.IDENTITY
        self._T_local_before: FloatArray = se2.IDENTITY
        self._cov_prior: FloatArray = FIRST_COV
        self._cov_independent: FloatArray = FIRST_COV
        self._cov_correlated: FloatArray = np.zeros((3, 3))
        self._cov_anchor: FloatArray = FIRST_COV
        self._T_odom_base: FloatArray | None = None
        self._laser_base: FloatArray = np.zeros(2)
        self._match: MatchResult | None = None
        self._prediction = _Prediction(
            T_local_base=se2.IDENTITY,
            cov_prior=FIRST_COV,
            cov_independent=FIRST_COV,
            cov_odometry=np.zeros((3, 3)),
            doubt=0.0,
        )
        # since the last keyframe, and since the last node
        self._T_odom_keyframe: FloatArray = se2.IDENTITY
        self._cov_since_node: FloatArray = np.zeros((3, 3))
        self._T_odom_node: FloatArray = se2.IDENTITY
        self._T_local_node: FloatArray = se2.IDENTITY
        self._T_map_local: FloatArray = se2.IDENTITY
        self._cov_odometry: FloatArray = np.zeros((3, 3))
        self._cov_keyframe: FloatArray = FIRST_COV
        self._n_failed = 0
        self._n_blind = 0
        self._T_odom_seen: FloatArray = se2.IDENTITY
        self._doubt = 0.0
        self._node_scans: list[int] = []
        self._scan_poses = ScanPoses()

    @property
    def T_map_local(self) -> FloatArray:
        """See `Localizer`."""
        return self._T_map_local

    def predict(self, scan: Scan) -> Estimate:
        """See `Localizer`."""
        self._T_local_before = self._T_local_base
        if self._T_odom_base is not None:
            increment = se2.between(self._T_odom_base, scan.T_odom_base)
            cov = self.noise.covariance(increment)
            self._T_local_base = se2.compose(self._T_local_base, increment)
            self._path_m += math.hypot(increment[0], increment[1])
            before = np.array([self._cov_prior, self._cov_independent, self._cov_odometry])
            self._cov_prior, self._cov_independent, self._cov_odometry = se2.compound_covariance(
                before, increment, cov
            )
        self._T_odom_base = scan.T_odom_base
        self._laser_base = scan.laser.origin_base
        self._prediction = _Prediction(
            T_local_base=self._T_local_base,
            cov_prior=self._cov_prior,
            cov_independent=self._cov_independent,
            cov_odometry=self._cov_odometry,
            doubt=self._doubt,
        )
        return self._estimate()

    def match(
        self, points_base: FloatArray, is_static: BoolArray, kernel_factor: float = 1.0
    ) -> tuple[Estimate, MatchResult | None]:
        """See `Localizer`."""
        self._match = None
        before = self._prediction
        self._T_local_base, self._cov_prior, self._cov_independent = (
            before.T_local_base,
            before.cov_prior,
            before.cov_independent,
        )
        self._cov_odometry = before.cov_odometry
        self.matching = self.config
        if kernel_factor != 1.0:
            self.matching = replace(self.config, kernel_scale_m=kernel_factor * self.config.kernel_scale_m)
        if self.local_map.keyframes:
            match, T_local_base, cov_independent = self._match_from(
                points_base, is_static, self._T_local_base, self._cov_prior, self._cov_independent
            )
            nis = 0.0 if match.status == "failed" else match.nis
            if match.status == "failed" or (match.inlier_ratio < JUMP_INLIERS and nis > JUMP_NIS):
                second = self._match_without_odometry(points_base, is_static, match)
                match, T_local_base, cov_independent = second or (match, T_local_base, cov_independent)
            if match.status == "failed" and kernel_factor < 1.0:
                return self.match(points_base, is_static)
            self._doubt = before.doubt + 0.1 * (min(nis, MOST_NIS) - before.doubt)
            if nis > self.matching.max_nis and self._doubt > self.matching.max_nis:
                match = refuse(match, self._T_local_base, f"improbable, innovation squared {nis:.0f}")
                T_local_base, cov_independent = self._T_local_base, self._cov_independent
            self._match, self._T_local_base, self._cov_independent = match, T_local_base, cov_independent
            if match.status != "failed":
                self._cov_correlated = match.cov_correlated
                self._cov_prior = fuse(self._cov_prior, match)
        return self._estimate(), self._match

    def _match_from(
        self,
        points_base: FloatArray,
        is_static: BoolArray,
        T_local_base: FloatArray,
        cov: FloatArray,
        cov_independent: FloatArray,
    ) -> tuple[MatchResult, FloatArray, FloatArray]:
        return match_to_local_map(
            points_base,
            is_static,
            self._laser_base,
            self.local_map,
            T_local_base,
            cov,
            self.matching,
            cov_independent,
        )

    def _match_without_odometry(
        self, points_base: FloatArray, is_static: BoolArray, doubtful: MatchResult
    ) -> tuple[MatchResult, FloatArray, FloatArray] | None:
        """Match again from where the robot was before, in case it is the odometry that jumped.

        Where that is clearly better, the increment's covariance grows to `LOST_STD`; where not, None.
        """
        wide = np.diag(np.square(LOST_STD))
        match, T_local_base, cov = self._match_from(points_base, is_static, self._T_local_before, wide, wide)
        needed = (
            JUMP_INLIERS if doubtful.status == "failed" else max(JUMP_INLIERS, doubtful.inlier_ratio + 0.15)
        )
        if match.status != "failed" and match.inlier_ratio > needed:
            self._cov_odometry = self._cov_odometry + wide
            self._cov_prior = wide
            return match, T_local_base, cov
        return None

    def commit(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """See `Localizer`."""
        events: list[Event] = []
        self._closures = ()
        has_points = bool(np.count_nonzero(is_static) >= self.matching.min_pairs)
        if self._match is not None and self._match.status == "failed":
            events.append(
                Event(
                    kind="match failed",
                    severity="warning",
                    scan=scan.index,
                    data={"reason": self._match.reason},
                )
            )
            self._n_failed += has_points and not self._match.is_refused
        else:
            self._n_failed = 0
        why = self._why_lost(scan, has_points)
        if why:
            events.append(Event(kind="lost", severity="error", scan=scan.index, data={"reason": why}))
            self._leave_local_map()
        if has_points:
            self._n_blind, self._T_odom_seen = 0, scan.T_odom_base
        else:
            self._n_blind += 1
        node = None
        is_keyframe = len(self.graph) == 0 or (has_points and self.local_map.wants(self._T_local_base))
        if is_keyframe:
            self._follow_keyframes(scan)
            if self._needs_node():
                node = self._add_node(scan)
            if has_points:
                events += self._add_keyframe(node, scan, points_base, is_static)
        anchor, T_anchor_base = self._from_anchor()
        T_node_base = se2.between(self._T_local_node, self._T_local_base)
        self._scan_poses.append(
            len(self.graph) - 1,
            T_node_base,
            anchor,
            T_anchor_base,
            self._cov_independent + self._cov_correlated,
        )
        return CommitResult(
            node=node,
            is_keyframe=is_keyframe,
            is_lost=bool(why),
            closures=self._closures,
            events=tuple(events),
        )

    def nodes_and_edges(self) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
        """See `Localizer`."""
        return self.graph.poses(), tuple(self.graph.edges)

    def final(self) -> FinalEstimate:
        """See `Localizer`."""
        if not len(self._scan_poses):
            nothing = np.empty((0, 3))
            no_nodes = np.empty(0, dtype=np.int64)
            return FinalEstimate(
                T_map_base=nothing, cov_map=np.empty((0, 3, 3)), node_scans=no_nodes, nodes=nothing, edges=()
            )
        nodes, marginals = self.graph.poses(), self.graph.marginals()
        T_map_base, cov_map = self._scan_poses.trajectory(nodes, marginals)
        return FinalEstimate(
            T_map_base=T_map_base,
            cov_map=cov_map,
            node_scans=np.array(self._node_scans),
            nodes=nodes,
            edges=tuple(self.graph.edges),
        )

    def close(self) -> None:
        """See `Localizer`."""
        self.graph.close()

    def _from_anchor(self) -> tuple[int, FloatArray]:
        """Node of the anchor and the base in its frame; without a local map, of the last node."""
        if self.local_map.keyframes:
            anchor = self.local_map.anchor
            return anchor.node, se2.between(anchor.T_local_base, self._T_local_base)
        return max(len(self.graph) - 1, 0), se2.between(self._T_local_node, self._T_local_base)

    def _estimate(self) -> Estimate:
        anchor, T_anchor_base = self._from_anchor()
        cov_relative = self._cov_independent + self._cov_correlated
        cov_absolute = se2.compound_covariance(self._cov_anchor, T_anchor_base, cov_relative)
        return Estimate(
            T_local_base=self._T_local_base,
            cov_relative=cov_relative,
            cov_absolute=cov_absolute,
            T_anchor_base=T_anchor_base,
            anchor_scan=self._node_scans[anchor] if self._node_scans else -1,
        )

    def _why_lost(self, scan: Scan, has_points: bool) -> str:
        """Say why the robot is lost; empty if it is not.

        Whoever carries a robot covers its laser, and the wheels stand still: then even a good match proves nothing.
        """
        if has_points and self._n_blind >= self.n_lost and self.local_map.keyframes:
            distance_m = float(np.hypot(*se2.between(self._T_odom_seen, scan.T_odom_base)[:2]))
            if distance_m < KIDNAPPED_DISTANCE_M or (
                self._match is not None and self._match.status == "failed"
            ):
                return f"{self._n_blind} scans with nothing in sight, the robot may have been carried"
        return f"{self.n_lost} matches failed in a row" if self._n_failed >= self.n_lost else ""

    def _leave_local_map(self) -> None:
        """Begin anew: until the next keyframe the last node stands in for the anchor.

        The robot may have been carried: the way since the last node is as good as unknown.
        """
        last = len(self.graph) - 1
        self._cov_odometry = self._cov_odometry + np.diag(np.square(LOST_STD))
        self._cov_anchor = self.graph.marginal(last)
        self._cov_prior = self._cov_independent = self._cov_odometry
        self._cov_correlated = np.zeros((3, 3))
        self._path_m += LOST_DISTANCE_M
        if self.closer is not None and len(self.local_map.keyframes) > 1:
            self.closer.submaps.append(self._submap(tuple(self.local_map.keyframes)))
        self.n_times_lost += 1
        self.local_map.start([])
        self._n_failed = 0

    def _submap(self, keyframes: tuple[Keyframe, ...]) -> Submap:
        self._n_submaps += 1
        return Submap(self._n_submaps - 1, keyframes, self._path_m, self.n_times_lost)

    def _follow_keyframes(self, scan: Scan) -> None:
        """Carry what is known since the last node on to a new keyframe, and since the anchor."""
        if len(self.graph):
            way = se2.between(self._T_odom_keyframe, scan.T_odom_base)
            information = np.zeros((3, 3)) if self._match is None else self._match.information
            self.local_factors.add(way, invert(self._cov_odometry), self._T_local_base, information)
            self._cov_since_node = se2.compound_covariance(self._cov_since_node, way, self._cov_odometry)
            self._cov_keyframe = se2.compound_covariance(self._cov_keyframe, way, self._cov_odometry)
            if self._match is not None and self._match.status != "failed":
                self._cov_keyframe = fuse(self._cov_keyframe, self._match)
        self._T_odom_keyframe = scan.T_odom_base
        self._cov_odometry = np.zeros((3, 3))

    def _needs_node(self) -> bool:
        """Tell whether a new keyframe goes into the graph: in a known place only where a local map hangs on it.

        That is the keyframe that finishes the local map, and those at which a later one begins.
        """
        n, config = len(self.local_map.keyframes), self.local_map.config
        if n == 0 or self.closer is None or not self.closer.is_known:
            return True
        return n == config.max_keyframes - 1 or n % (config.max_keyframes - config.n_overlap) == 0

    def _add_node(self, scan: Scan) -> int:
        """Add the scan to the graph, tied by odometry to the last node and by the match to the anchor."""
        if len(self.graph) == 0:
            T_map_node = self._T_local_base
            node = self.graph.start(T_map_node)
        else:
            last = len(self.graph) - 1
            T_map_node = se2.compose(self._T_map_local, self._T_local_base)
            node = self.graph.add_node(T_map_node)
            way = se2.between(self._T_odom_node, scan.T_odom_base)
            self.graph.add_edge("odometry", last, node, way, invert(self._cov_since_node))
            if self._match is not None and self._match.status != "failed" and self.local_map.keyframes:
                anchor, T_anchor_node = self.local_map.anchor.node, self._match.T_ref_base
                self.graph.add_edge("match", anchor, node, T_anchor_node, self._match.graph_information)
        self._T_local_node = self._T_local_base
        self._T_map_local = se2.compose(T_map_node, se2.inverse(self._T_local_node))
        self._T_odom_node = scan.T_odom_base
        self._cov_since_node = np.zeros((3, 3))
        self._node_scans.append(scan.index)
        return node

    def _add_keyframe(
        self, node: int | None, scan: Scan, points_base: FloatArray, is_static: BoolArray
    ) -> list[Event]:
        """Add the keyframe's scan to the local map; look for loops where that finished it."""
        keyframe = make_keyframe(
            NO_NODE if node is None else node,
            self._T_local_base,
            points_base,
            is_static,
            scan.laser,
            self.local_map.config,
        )
        is_first = not self.local_map.keyframes
        finished = self.local_map.add(keyframe, None if is_first else self._cov_independent)
        events = list[Event]()
        if finished and self.closer is not None:
            _, self._closures = self.closer.consider(self._submap(finished))
            events = [_closure_event(scan, attempt) for attempt in self._closures]
        anchor = self.local_map.anchor.node
        if node is not None and (is_first or finished):
            self._T_map_local = se2.compose(self.graph.pose(node), se2.inverse(self._T_local_node))
            self._cov_anchor = self.graph.marginal(anchor)
            self._cov_keyframe = FIRST_COV if is_first else self.graph.relative_covariance(anchor, node)
        if is_first:
            self.local_factors.start(self._T_local_base)
            self._cov_independent, self._cov_correlated = FIRST_COV, np.zeros((3, 3))
        elif finished:
            covs = self.local_factors.of_latest(len(self.local_map.keyframes))
            self.local_map.set_covariances(covs)
            self._cov_independent = covs[-1]
        self._cov_prior = self._cov_keyframe
        return events


_CLOSURE_EVENTS: dict[str, EventKind] = {
    "accepted": "closure accepted",
    "waiting": "closure waiting",
    "refused": "closure refused",
    "outlier": "closure rejected",
}


def _closure_event(scan: Scan, attempt: ClosureAttempt) -> Event:
    return Event(
        kind=_CLOSURE_EVENTS[attempt.status],
        severity="warning" if attempt.status == "outlier" else "info",
        scan=scan.index,
        data={
            "target_node": attempt.target_node,
            "source_node": attempt.source_node,
            "reason": attempt.reason,
        },
    )
