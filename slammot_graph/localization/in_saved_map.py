"""Localization in a saved map, which stays as it is: place recognition, then scans matched onto its keyframes."""

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import make_event
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.saved_map import MapStart
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization._keyframe_kernels import pick_unlike
from slammot_graph.localization.base import CommitResult, Estimate, FinalEstimate
from slammot_graph.localization.config import ScanToMapConfig
from slammot_graph.localization.graph_insertion import NOT_OF_THIS_RUN, GraphInsertion
from slammot_graph.localization.placed_parts import PlacedParts
from slammot_graph.localization.scan_poses import ScanPoses
from slammot_graph.localization.scan_to_map import ScanToMap
from slammot_graph.loop_closure.submap import Submap
from slammot_graph.mapping.local_map import NO_NODE, Keyframe, make_keyframe
from slammot_graph.odometry.propagation import MotionModel

N_KEYFRAMES, N_OWN = 20, 8
"""Keyframes of the saved map that make the local map, and those of the robot's own where the map knows nothing."""

APART_M, APART_RAD = 0.3, 0.4
"""Keyframes of the saved map nearer to each other than both are taken once."""

TURN_M_PER_RAD = 1.5
"""A keyframe turned by an angle counts as so much farther away."""

MIN_AGREEMENT = 0.7
"""Where fewer of the points agree with the saved map, the robot's own keyframes are added."""

RENEWED_AFTER = 2.0
"""So many times the motion between two keyframes, and the local map is made anew: its keyframes reach some metres."""

OWN_REACH_M = 4.0
"""The robot's own keyframes are forgotten farther away."""

MOST_UNSURE_M = 8.0
"""After so long a way on which the saved map has not shown what the robot sees, the robot is lost."""

FOUND_STD = (0.1, 0.1, 0.02)
"""Standard deviation of the place that was found, before the first match there [m, m, rad]."""


class KeyframesOfMap:
    """The keyframes of a saved map by their places there.

    Attributes
    ----------
    keyframes : list of Keyframe
    T_map_keyframes : (k, 3) array
    cov_map : (k, 3, 3) array
        How well the map knows where they are, right perturbation (body frame).
    """

    def __init__(self, submaps: list[Submap], nodes: FloatArray, covs: FloatArray) -> None:
        placed: dict[int, tuple[int, Keyframe, FloatArray, FloatArray]] = {}
        for submap in submaps:
            n = len(submap.keyframes)
            T_map_keyframes = se2.compose(nodes[submap.anchor][None, :], submap.T_anchor_keyframes)
            A = se2.adjoint(se2.inverse(submap.T_anchor_keyframes))
            cov_map = A @ covs[submap.anchor] @ np.swapaxes(A, 1, 2)
            for k, keyframe in enumerate(submap.keyframes):
                from_middle = abs(2 * k - n)
                if id(keyframe) not in placed or from_middle < placed[id(keyframe)][0]:
                    placed[id(keyframe)] = from_middle, keyframe, T_map_keyframes[k], cov_map[k]
        self.keyframes = [keyframe for _, keyframe, _, _ in placed.values()]
        self.T_map_keyframes = np.array([T for _, _, T, _ in placed.values()]).reshape(-1, 3)
        self.cov_map = np.array([cov for _, _, _, cov in placed.values()]).reshape(-1, 3, 3)

    def around(self, T_map_base: FloatArray, n: int = N_KEYFRAMES) -> list[int]:
        """Numbers of the n keyframes that best show what is seen from a pose (3,), the nearest first."""
        offset = se2.between(T_map_base[None, :], self.T_map_keyframes)
        far = np.hypot(offset[:, 0], offset[:, 1]) + TURN_M_PER_RAD * np.abs(offset[:, 2])
        picked = np.empty(n, dtype=np.int64)
        order = np.argsort(far, kind="stable")
        n_picked = pick_unlike(self.T_map_keyframes, order, APART_M, APART_RAD, picked)
        return [int(k) for k in picked[:n_picked]]


@dataclass(eq=False)
class _Since:
    """Where the latest keyframe was taken and the local map renewed, and of which saved keyframes alone it is made.

    By the nearest of these `cov_local` (3, 3) tells how well the map knows where the local frame is (its body frame).
    """

    T_local_keyframe: FloatArray = field(default_factory=lambda: se2.IDENTITY)
    T_local_renewed: FloatArray = field(default_factory=lambda: se2.IDENTITY)
    in_local_map: list[int] = field(default_factory=list)
    cov_local: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))


class InSavedMap(ScanToMap):
    """Looks for the robot in a saved map as a run that goes on with it does, then follows it there.

    From then on the local map is made of the saved keyframes around the robot, and no node is added. Where those do not
    show what the robot sees, its latest keyframes are added to the local map, and to nothing else. A robot that is lost
    is looked for again.

    An estimate's `cov_relative` is that of the pose relative to the saved keyframes around the robot, taken as exact:
    by it scans are tested and matched. `cov_absolute` has the saved map's own error there besides.

    Attributes
    ----------
    is_found : bool
        The robot's place in the saved map is known.
    """

    def __init__(self, model: MotionModel, config: ScanToMapConfig, start: MapStart) -> None:
        super().__init__(model, config, start)
        self.is_found = False
        self._start = start
        assert self.closer is not None
        joined = [submap for submap in self.closer.submaps if submap.component in start.saved.joined]
        _, covs = self.insertion.solved()
        self._known = KeyframesOfMap(joined, start.saved.nodes, covs)
        self._own: deque[tuple[Keyframe, FloatArray]] = deque(maxlen=N_OWN)
        self._before: list[Keyframe] = []  # with which the robot was found, until the next match
        self._since = _Since()
        self._sure_at: tuple[float, int] = (0.0, 0)
        self._told = PlacedParts()

    def commit(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """See `Localizer`."""
        if self.is_found:
            committed = self._follow(scan, points_base, is_static)
        else:
            committed = super().commit(scan, points_base, is_static)
            if self.insertion.is_placed:
                self._enter(scan.index)
            elif committed.is_lost:
                self._told.begin()
        estimate = self._estimate()
        self._told.append(estimate.T_local_base, estimate.cov_absolute)
        return committed

    def nodes_and_edges(self) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
        """See `Localizer`: those of the saved map."""
        return self._start.saved.nodes, self._start.saved.edges

    def final(self) -> FinalEstimate:
        """See `Localizer`: poses as they were at the time, those before the place was found moved there."""
        T_map_base, cov_map = self._told.trajectory()
        saved = self._start.saved
        return FinalEstimate(
            T_map_base=T_map_base,
            cov_map=cov_map,
            node_scans=np.full(len(saved.nodes), NOT_OF_THIS_RUN),
            nodes=saved.nodes,
            edges=saved.edges,
            earlier=saved if self._told.is_placed else None,
        )

    def _estimate(self) -> Estimate:
        if not self.is_found:
            return super()._estimate()
        state = self.propagation.state
        T_local_base, cov = state.T_local_base, state.cov_relative
        cov_map = se2.compound_covariance(self._since.cov_local, T_local_base, cov)
        return Estimate(T_local_base, cov, cov_map, T_local_base)

    def _enter(self, scan: int) -> None:
        """Go over to the saved keyframes."""
        self.is_found = True
        self._since.in_local_map = []
        self._own.clear()
        self._before = self.local_map.keyframes[-N_OWN:]
        self._sure_at = self.propagation.path_m, scan
        T_map_base, cov_map = self._scan_poses.trajectory(*self.insertion.solved())
        self._told.place(self.T_map_local, T_map_base[:-1], cov_map[:-1])
        cov = np.diag(np.square(FOUND_STD))
        self.propagation.state = self.propagation.state._replace(
            cov_prior=cov, cov_independent=cov, cov_correlated=np.zeros((3, 3))
        )
        self._renew_local_map()

    def _follow(self, scan: Scan, points_base: FloatArray, is_static: BoolArray) -> CommitResult:
        """Keep the scan's pose; renew the local map where the robot has moved on."""
        has_points = bool(np.count_nonzero(is_static) >= self.config.point_to_line.min_pairs)
        events, _ = self._look_for_loss(scan, points_base, is_static, has_points)
        unsure_m, unsure_scans = self._unsure_for(scan.index)
        if not events and unsure_m > MOST_UNSURE_M:
            events.append(make_event("lost", scan.index, cause="saved map", n_scans=unsure_scans))
        if any(event.kind == "lost" for event in events):
            self._leave()
            self.propagation.commit(None)
            return CommitResult(is_lost=True, health="lost", events=tuple(events))
        T_local_base, match = self.propagation.state.T_local_base, self._match
        if self._before and match is not None:
            if (
                match.status == "failed"
            ):  # found by what lies behind; of what is seen here the map knows nothing
                cov = self.propagation.state.cov_relative
                self._own.extend((keyframe, cov) for keyframe in self._before)
                self._renew_local_map()
            self._before = []
        distance_m, turn_rad = se2.distance(self._since.T_local_keyframe, T_local_base)
        config = self.local_map.config
        is_keyframe = distance_m > config.keyframe_distance_m or turn_rad > config.keyframe_rotation_rad
        if is_keyframe:
            self.propagation.start_keyframe()
            self._since.T_local_keyframe = T_local_base
            n_own = len(self._own)
            if match is not None and match.status != "failed" and match.inlier_ratio < MIN_AGREEMENT:
                own = make_keyframe(
                    NO_NODE, T_local_base, points_base, is_static, scan.laser, config, scan.origins_base
                )
                self._own.append((own, self.propagation.state.cov_relative))
            if len(self._own) > n_own or self._has_left():
                self._renew_local_map()
        self.propagation.commit(self._matched_pose())
        is_known = not self._own
        return CommitResult(
            is_keyframe=is_keyframe, health=None if is_known else "degenerate", events=tuple(events)
        )

    def _has_left(self) -> bool:
        """Tell whether the robot has gone on since the local map was made."""
        distance_m, turn_rad = se2.distance(self._since.T_local_renewed, self.propagation.state.T_local_base)
        config = self.local_map.config
        return (
            distance_m > RENEWED_AFTER * config.keyframe_distance_m
            or turn_rad > RENEWED_AFTER * config.keyframe_rotation_rad
        )

    def _unsure_for(self, scan: int) -> tuple[float, int]:
        """How far the robot has gone, and for how many scans, since the saved map alone showed what it saw."""
        match, path_m = self._match, self.propagation.path_m
        if (
            match is not None
            and not self._own
            and match.status != "failed"
            and not match.contradicts_odometry
        ):
            self._sure_at = path_m, scan
        return path_m - self._sure_at[0], scan - self._sure_at[1]

    def _renew_local_map(self) -> None:
        T_local_base = self._since.T_local_keyframe = self.propagation.state.T_local_base
        self._since.T_local_renewed = T_local_base
        numbers = self._known.around(se2.compose(self.T_map_local, T_local_base))
        T_nearest_local = se2.between(self._known.T_map_keyframes[numbers[0]], self.T_map_local)
        cov_nearest = self._known.cov_map[numbers[0]]
        self._since.cov_local = se2.compound_covariance(cov_nearest, T_nearest_local, np.zeros((3, 3)))
        near = [one for one in self._own if se2.distance(one[0].T_local_base, T_local_base)[0] < OWN_REACH_M]
        self._own = deque(near, maxlen=N_OWN)
        new = [k for k in numbers if k not in self._since.in_local_map]
        if (
            not near
            and self._since.in_local_map
            and len(self._since.in_local_map) + len(new) <= N_KEYFRAMES + N_OWN
        ):
            self.local_map.extend(self._of_map(new))
            self._since.in_local_map += new
            return
        self.local_map.start([*self._of_map(numbers), *(keyframe for keyframe, _ in near)])
        of_map = np.zeros((len(numbers), 3, 3))
        self.local_map.set_covariances(np.concatenate([of_map, *(cov[None] for _, cov in near)]))
        self._since.in_local_map = [] if near else numbers

    def _of_map(self, numbers: list[int]) -> list[Keyframe]:
        """Keyframes of the saved map in the local frame."""
        known, T_local_map = self._known, se2.inverse(self.T_map_local)
        return [
            replace(known.keyframes[k], T_local_base=se2.compose(T_local_map, known.T_map_keyframes[k]))
            for k in numbers
        ]

    def _leave(self) -> None:
        """Look for the robot again, with nothing known of the motion since."""
        self.is_found = False
        self._told.begin()
        self._sweep_end = None
        self.propagation.lose_track(self.config.lost_cov, self.config.lost_distance_m)
        self.local_map.start([])
        self.insertion.graph.close()
        self.insertion, self._scan_poses = GraphInsertion(self.config, self.local_map), ScanPoses()
        self.insertion.start_from(replace(self._start, initial_pose=None))
