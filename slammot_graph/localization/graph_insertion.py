"""Graph insertion: which keyframes become nodes, by which factors they are tied, and when loops are looked for."""

from dataclasses import replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.linalg import invert
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.results import ClosureAttempt
from slammot_graph.core.saved_map import MapStart, SavedMap, SavedRun
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import LocalFactors, PoseGraph
from slammot_graph.graph.common_errors import N_PARAMETERS, solution_errors
from slammot_graph.localization.base import FIRST_COV
from slammot_graph.localization.config import ScanToMapConfig
from slammot_graph.localization.keyframe_state import KeyframeState
from slammot_graph.localization.match_factors import match_factors
from slammot_graph.loop_closure import LoopCloser, Submap
from slammot_graph.loop_closure.saved_submaps import calibration_of, load_submaps, save_submaps
from slammot_graph.mapping.local_map import Keyframe, LocalMap
from slammot_graph.odometry.noise import NOTHING_COMMON
from slammot_graph.odometry.propagation import MotionState

ANYWHERE: FloatArray = np.diag(np.square([1e3, 1e3, 10.0]))
"""Covariance of where a run begins in the map that it starts from [m^2, rad^2]."""

NOT_OF_THIS_RUN = -1
"""In place of the scan of a node of the map that the run started from."""

FIRST_SEARCH, SEARCH_STEP = 4, 3
"""The first local map is looked for in the saved map from so many keyframes on, and again after so many more."""


def first_component(saved: SavedMap) -> int:
    """Give the number of the component that a run begins beside a saved map."""
    components = [*saved.submap_components.tolist(), *(run.component for run in saved.runs), *saved.joined]
    return 1 + max(int(component) for component in (0, *components))


class GraphInsertion:
    """Puts keyframes into the pose graph and the local map, and tells the loop closing of finished local maps.

    Attributes
    ----------
    graph : PoseGraph
    local_factors : LocalFactors
        Those around the local map.
    local_map : LocalMap
    closer : LoopCloser or None
    keyframes : KeyframeState
    cov_anchor : (3, 3) array
        Of the local map's anchor in the map, right perturbation (body frame).
    node_scans : list of int
        Scan index of each node.
    n_times_lost : int
        Components of the graph so far, less one: of the motion between two of them nothing is known.
    """

    def __init__(self, config: ScanToMapConfig, local_map: LocalMap) -> None:
        self.graph = PoseGraph(config.graph)
        self.local_factors = LocalFactors()
        self.local_map = local_map
        self.closer = LoopCloser(config.closure, config.local_map, self.graph) if config.close_loops else None
        self.keyframes = KeyframeState()
        self.cov_anchor: FloatArray = FIRST_COV
        self.node_scans: list[int] = []
        self.n_times_lost = 0
        self._n_submaps = 0
        self._was_blind = False
        self._config = config
        self._saved: SavedMap | None = None

    @property
    def has_node(self) -> bool:
        """Whether the run has a node in the graph."""
        return len(self.graph) > self._n_saved

    @property
    def is_placed(self) -> bool:
        """Whether the place of the latest component in the map that the run started from is known."""
        sought = (
            self._saved is not None and self.closer is not None and self.closer.is_sought(self.n_times_lost)
        )
        return not sought

    @property
    def _saved_origin(self) -> FloatArray:
        return se2.IDENTITY if self._saved is None else self._saved.nodes[0]

    @property
    def _n_saved(self) -> int:
        return 0 if self._saved is None else len(self._saved.nodes)

    def start_from(self, start: MapStart) -> None:
        """Begin with a saved map: the run is a component beside it, until its place there is found."""
        assert self.closer is not None
        self._saved = saved = start.saved
        self.graph.load(saved.nodes, saved.edges)
        self.node_scans = [NOT_OF_THIS_RUN] * len(saved.nodes)
        is_known = saved.odometry_errors.any(axis=(1, 2))
        self.keyframes.common_errors.of_factors = {
            node: saved.odometry_errors[node] for node in np.flatnonzero(is_known).tolist()
        }
        submaps = load_submaps(saved, self._config.closure.submap)
        self._n_submaps = len(submaps)
        self.n_times_lost = first_component(saved)
        self.closer.start_from(submaps, saved.joined, start.initial_pose)
        self.cov_anchor = ANYWHERE

    def anchor(self, T_local_base: FloatArray) -> tuple[int, FloatArray]:
        """Node of the anchor, and a pose (3,) in its frame; without a local map, of the last node."""
        if self.local_map.keyframes:
            anchor = self.local_map.anchor
            return anchor.node, se2.between(anchor.T_local_base, T_local_base)
        return max(len(self.graph) - 1, 0), self.keyframes.on_node(T_local_base)

    def advance(self, state: MotionState, T_odom_base: FloatArray, match: MatchResult | None) -> None:
        """Carry what is known since the last node, and since the anchor, on to a new keyframe."""
        if not self.has_node:
            self.keyframes.start(T_odom_base)
            return
        T_last_this = self.keyframes.advance(T_odom_base, state.cov_odometry, match)
        information = np.zeros((3, 3)) if match is None else match.information
        self.local_factors.add(T_last_this, invert(state.cov_odometry), state.T_local_base, information)

    def needs_node(self) -> bool:
        """Tell whether a new keyframe goes into the graph: in a known place only where a local map is attached to it.

        That is the keyframe that finishes the local map, and those at which a later one begins.
        """
        n, local_map = len(self.local_map.keyframes), self.local_map
        if n == 0 or self.closer is None or not self.closer.is_known:
            return True
        full = local_map.max_keyframes
        return n == full - 1 or n % (full - local_map.n_overlap) == 0

    def add_node(
        self,
        scan: int,
        T_local_base: FloatArray,
        T_odom_base: FloatArray,
        match: MatchResult | None,
        common_stds: FloatArray = NOTHING_COMMON,
    ) -> int:
        """Add a node, tied by odometry to the last one and by the match to the anchor.

        Parameters
        ----------
        scan : int
            Index of its scan.
        T_local_base, T_odom_base : (3,) arrays
            By the matches, and dead-reckoned.
        match : MatchResult or None
        common_stds : (4,) array
            Of what the odometry's errors have in common, see `MotionModel`.

        Returns
        -------
        The node's number.
        """
        keyframes = self.keyframes
        if len(self.graph) == 0:
            T_map_node = T_local_base
            node = self.graph.start(T_map_node)
        elif not self.has_node:
            T_map_node = T_local_base
            node = self.graph.add_node(T_map_node)
            T_first_node = se2.between(self._saved_origin, T_map_node)
            self.graph.add_edge("odometry", 0, node, T_first_node, invert(ANYWHERE))
        else:
            last = len(self.graph) - 1
            T_map_node = se2.compose(keyframes.T_map_local, T_local_base)
            node = self.graph.add_node(T_map_node)
            T_last_node = keyframes.since_node(T_odom_base)
            information = invert(keyframes.cov_since_node)
            self.keyframes.common_errors.move(node, T_last_node, keyframes.cov_since_node, common_stds)
            if self.graph.try_edge("odometry", last, node, T_last_node, information) is None:
                # a node needs an edge: by the matches, as weak as what is known of a lost robot
                T_by_matches = se2.between(self.graph.pose(last), T_map_node)
                self.graph.add_edge("odometry", last, node, T_by_matches, invert(self._config.lost_cov))
            keyframes.node_errors.add(
                node,
                match,
                self.local_map.keyframes,
                T_local_base,
                T_last_node,
                keyframes.cov_since_node,
                keyframes.on_node(T_local_base),
            )
            if self._was_blind and self.closer is not None:
                self.closer.blind_drives.append((node, keyframes.cov_since_node.copy()))
            self._was_blind = False
            if match is not None and match.status != "failed" and self.local_map.keyframes:
                factors = match_factors(match, self.local_map.keyframes)
                for factor in factors:
                    self.graph.try_edge("match", factor.node, node, factor.T_node_base, factor.information)
                self.keyframes.common_errors.match(node, *factors[0])
        keyframes.start_node(T_odom_base, T_local_base, T_map_node)
        self.node_scans.append(scan)
        return node

    def add_keyframe(
        self, keyframe: Keyframe, node: int | None, state: MotionState, path_m: float
    ) -> tuple[MotionState, tuple[ClosureAttempt, ...]]:
        """Add a keyframe to the local map; look for loops where that finished it.

        Parameters
        ----------
        keyframe : Keyframe
        node : int or None
            The node just added for it.
        state : MotionState
            At the keyframe.
        path_m : float
            Length of the path so far [m].

        Returns
        -------
        The state relative to the local map's anchor, which may be another one now, and the closures tried.
        """
        keyframes = self.keyframes
        is_first = not self.local_map.keyframes
        finished = self.local_map.add(keyframe, None if is_first else state.cov_independent)
        closures: tuple[ClosureAttempt, ...] = ()
        if finished and self.closer is not None:
            submap = self._submap(finished, path_m)
            closures = self.closer.consider(submap)
            if any(closure.status == "accepted" for closure in closures):
                self.keyframes.common_errors.close_loop(self.common_solution(self.graph.poses()))
            if self.closer.is_sought(self.n_times_lost):
                self.closer.request(submap)
        elif self.closer is not None and self._seeks_early():
            self.closer.request(self._submap(tuple(self.local_map.keyframes), path_m))
        anchor = self.local_map.anchor.node
        if node is not None and (is_first or finished):
            keyframes.place_node(self.graph.pose(node))
            self.cov_anchor = self.graph.marginal(anchor)
            keyframes.cov_keyframe = FIRST_COV if is_first else self.graph.relative_covariance(anchor, node)
            self.keyframes.common_errors.start_local_map(anchor, node, keyframes.cov_keyframe)
        if is_first:
            self.local_factors.start(state.T_local_base)
            state = state._replace(cov_independent=FIRST_COV, cov_correlated=np.zeros((3, 3)))
        elif finished:
            covs = self.local_factors.of_latest(len(self.local_map.keyframes))
            self.local_map.set_covariances(covs)
            state = state._replace(cov_independent=covs[-1])
        return state._replace(cov_prior=keyframes.cov_keyframe), closures

    def common_solution(self, nodes: FloatArray) -> FloatArray:
        """Errors (n, 3, 4 r) of the graph's nodes (n, 3) by what each of r runs' odometry errors have in common."""
        runs = () if self._saved is None else self._saved.runs
        first_nodes = [*(run.first_node for run in runs), self._n_saved]
        return solution_errors(nodes, self.graph.edges, self.keyframes.common_errors.of_factors, first_nodes)

    def solved(self) -> tuple[FloatArray, FloatArray]:
        """Optimised poses (n, 3) of all nodes and their covariances (n, 3, 3) in the map, body frames; by a copy.

        By the sources of the errors, where they are known: of a saved map they are not.
        """
        graph = self.graph.snapshot()
        nodes = graph.poses()
        covs = self._covariances_by_sources(graph, nodes) if self._saved is None else None
        if covs is None:
            common = self.common_solution(nodes)
            covs = np.asarray(graph.marginals() + common @ np.swapaxes(common, 1, 2))
        return nodes, covs

    def _covariances_by_sources(self, graph: PoseGraph, nodes: FloatArray) -> FloatArray | None:
        keyframes = self.keyframes
        accepted = () if self.closer is None else self.closer.accepted
        own = {edge: closure.cov_own for closure, edge in accepted if closure.cov_own is not None}
        common_errors = keyframes.common_errors.of_factors
        return keyframes.node_errors.covariances(nodes, graph.edges, common_errors, own)

    def search_on(self) -> tuple[ClosureAttempt, ...]:
        """Take the search for the latest component a step further; gives the closures tried."""
        if self.closer is None or not self.closer.is_sought(self.n_times_lost) or not self.has_node:
            return ()
        closures = self.closer.search_on()
        if not self.closer.is_sought(self.n_times_lost):
            self.keyframes.place_node(self.graph.pose(len(self.graph) - 1))
            self.cov_anchor = self.graph.marginal(self.anchor(se2.IDENTITY)[0])
            self.keyframes.common_errors.close_loop(self.common_solution(self.graph.poses()))
        return closures

    def saved_map(self, nodes: FloatArray, path_m: float, report: OdometryReport) -> SavedMap:
        """Give all local maps, the unfinished one too, and the graph with its optimised poses (n, 3).

        The last `n_spare` of them show known places, in a run that started from a saved map.
        """
        submaps = [] if self.closer is None else list(self.closer.submaps)
        if len(self.local_map.keyframes) > 1:
            unfinished = tuple(self.local_map.keyframes)
            submaps.append(
                Submap(self._n_submaps, unfinished, path_m, self.n_times_lost, self._config.closure.submap)
            )
        submaps += [] if self.closer is None else self.closer.places.submaps or []
        component, old_scans, old_runs, edits = 0, list[int](), tuple[SavedRun, ...](), tuple[str, ...]()
        if self._saved is not None:
            component, edits = first_component(self._saved), self._saved.edits
            old_runs = tuple(replace(run, first_scan=NOT_OF_THIS_RUN) for run in self._saved.runs)
            old_scans = self._saved.node_scans.tolist()
        odometry_errors = np.zeros((len(nodes), 3, N_PARAMETERS))
        for node, error in self.keyframes.common_errors.of_factors.items():
            odometry_errors[node] = error
        run = SavedRun(first_node=self._n_saved, component=component, odometry=calibration_of(report))
        return save_submaps(
            submaps,
            nodes=nodes,
            node_scans=np.array([*old_scans, *self.node_scans[self._n_saved :]], dtype=np.int64),
            edges=self.graph.all_edges,
            joined=tuple({0} if self.closer is None else self.closer.relocalization.joined),
            runs=(*old_runs, run),
            odometry_errors=odometry_errors,
            edits=edits,
        )

    @property
    def n_spare(self) -> int:
        """How many local maps at the end of the saved ones show known places."""
        return 0 if self.closer is None else len(self.closer.places.submaps or [])

    def earlier_map(self, nodes: FloatArray) -> SavedMap | None:
        """Give the map that the run started from, its nodes corrected; None unless all of the run lies in it."""
        if self._saved is None or self.closer is None:
            return None
        own = set(range(first_component(self._saved), self.n_times_lost + 1))
        is_placed = own <= self.closer.relocalization.joined
        return replace(self._saved, nodes=nodes[: len(self._saved.nodes)]) if is_placed else None

    def start_component(self, path_m: float, *, is_known: bool = False) -> None:
        """Begin a new component of the graph, with no local map: until there is one, the last node is the anchor.

        What the local map held so far goes to the loop closing. Where the motion between is known (`is_known`), it is
        no component of its own: its loops are looked for as far as the odometry's covariance reaches.
        """
        self.cov_anchor = self.graph.marginal(len(self.graph) - 1)
        if self.closer is not None and len(self.local_map.keyframes) > 1:
            self.closer.submaps.append(self._submap(tuple(self.local_map.keyframes), path_m))
        self.n_times_lost += not is_known
        self._was_blind = is_known
        self.local_map.start([])
        if self.closer is not None and not is_known:
            self.closer.look_all_over()

    def _seeks_early(self) -> bool:
        """Tell whether to look for the first local map of a component before it is finished."""
        n, closer = len(self.local_map.keyframes), self.closer
        if closer is None or not closer.is_sought(self.n_times_lost):
            return False
        if n < FIRST_SEARCH or (n - FIRST_SEARCH) % SEARCH_STEP:
            return False
        return all(submap.component != self.n_times_lost for submap in closer.submaps)

    def _submap(self, keyframes: tuple[Keyframe, ...], path_m: float) -> Submap:
        self._n_submaps += 1
        return Submap(self._n_submaps - 1, keyframes, path_m, self.n_times_lost, self._config.closure.submap)
