"""Loop closure: candidates, their verification, and a joint decision before the graph is told."""

from typing import NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.events import FOUND_AGAIN
from slammot_graph.core.linalg import mahalanobis2
from slammot_graph.core.results import ClosureAttempt, GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph
from slammot_graph.loop_closure.closure import Closure, make_attempt
from slammot_graph.loop_closure.config import LoopClosureConfig
from slammot_graph.loop_closure.known_places import KnownPlaces
from slammot_graph.loop_closure.place_finder import PlaceFinder
from slammot_graph.loop_closure.relocalization import Relocalization
from slammot_graph.loop_closure.submap import Submap
from slammot_graph.loop_closure.verification import SearchWindow, Verifier, search_window
from slammot_graph.mapping.local_map import LocalMapConfig


class _Candidate(NamedTuple):
    """An earlier local map that may show the same place: what the graph says of the relative pose, and the search."""

    target: Submap
    T_target_source: FloatArray
    cov: FloatArray
    window: SearchWindow
    is_strict: bool


class LoopCloser:
    """Looks at each finished local map, and tells the graph when the robot has come back.

    Attributes
    ----------
    config : LoopClosureConfig
    graph : PoseGraph
    verifier : Verifier
    relocalization : Relocalization
    submaps : list of Submap
        Those that later ones are compared with.
    accepted : list of (Closure, GraphEdge)
    pending : list of Closure
        Those that wait for others to confirm them.
    is_known : bool
        The latest local map shows a known place.
    blind_drives : list of (int, (3, 3) array)
        Nodes to which the odometry alone leads, with its covariance, right perturbation (body frame of the node).
    finder : PlaceFinder or None
        Looks all over the map: a saved one that the run started from, or the run's own while the robot is lost.
    places : KnownPlaces
    first_nodes : dict of int to int
        First node of a component, where it is not that of its first local map.
    """

    def __init__(self, config: LoopClosureConfig, local_map: LocalMapConfig, graph: PoseGraph) -> None:
        self.config = config
        self.graph = graph
        self.verifier = Verifier(config, local_map)
        self.relocalization = Relocalization(config.relocalization)
        self.submaps: list[Submap] = []
        self.accepted: list[tuple[Closure, GraphEdge]] = []
        self.pending: list[Closure] = []
        self.is_known = False
        self.blind_drives: list[tuple[int, FloatArray]] = []
        self.finder: PlaceFinder | None = None
        self.first_nodes: dict[int, int] = {}
        self.places = KnownPlaces(graph)

    def start_from(
        self, submaps: list[Submap], joined: tuple[int, ...], initial_pose: FloatArray | None
    ) -> None:
        """Begin with the local maps of a saved map, whose graph is in place, and the components that lie where they do.

        A component that is not joined is looked for all over the map from now on; the first one near a pose (3,) where
        one is given.
        """
        self.submaps, self.places.submaps = list(submaps), []
        self.relocalization.joined = set(joined)
        targets = [submap for submap in submaps if submap.component in joined]
        self.finder = PlaceFinder(self.verifier, targets, self.graph.poses(), initial_pose)

    def look_all_over(self) -> None:
        """Look for the component that begins now, of a lost robot, in all that is known."""
        targets = [submap for submap in self.submaps if submap.component in self.relocalization.joined]
        self.finder = PlaceFinder(self.verifier, targets, self.graph.poses())

    def is_sought(self, component: int) -> bool:
        """Tell whether a component's place is looked for all over the map and not found yet."""
        return self.finder is not None and component not in self.relocalization.joined

    def seek(self, source: Submap) -> tuple[ClosureAttempt, ...]:
        """Look all over the map for a local map, which may be unfinished; returns what was tried."""
        self.relocalization.unfinished = source
        if self.finder is None:
            return ()
        attempts = self._try(self.finder.find(source, self.graph.poses()))
        while self.finder.is_searching:
            attempts += self.search_on()
        return attempts

    def request(self, source: Submap) -> None:
        """Let a local map be looked for all over the map, by `search_on` step by step."""
        self.relocalization.unfinished = source
        if self.finder is not None:
            self.finder.request(source, self.graph.poses())

    def search_on(self) -> tuple[ClosureAttempt, ...]:
        """Take the search for a local map a step further; returns what was tried."""
        if self.finder is None:
            return ()
        n_before = len(self.finder.repeats)
        found = self.finder.go_on()
        return self._try(found, again=len(self.finder.repeats) > n_before)

    def _try(self, found: list[Closure], *, again: bool = False) -> tuple[ClosureAttempt, ...]:
        if self.finder is None or not (found or (again and self.relocalization.closures)):
            return ()
        attempts = [self.relocalize(found, self.graph.poses())]
        if attempts[0].status == "accepted":
            attempts += self.reject_outliers()
            self.finder.initial_pose = None
            self.finder.forget()
        return tuple(attempts)

    def consider(self, submap: Submap) -> tuple[ClosureAttempt, ...]:
        """Take in a finished local map; returns what was tried."""
        attempts: list[ClosureAttempt] = []
        self._forget_old(submap)
        verified = []
        for candidate in self._candidates(submap, self.graph.poses()):
            target, T_predicted, cov, window, is_strict = candidate
            found = self.verifier.verify(target, submap, T_predicted, window)
            if isinstance(found, str):
                attempts.append(make_attempt(target.place, submap.place, "refused", found, T_predicted))
            else:
                verified.append((found, T_predicted, cov, is_strict))
        self.submaps.append(submap)
        self.is_known = changed = False
        for closure, T_predicted, cov, is_strict in verified:
            is_apart = self.relocalization.is_apart(closure.target, closure.source)
            attempt = (
                self.relocalize([closure], self.graph.poses())
                if is_apart
                else self.decide(closure, T_predicted, cov, is_strict=is_strict)
            )
            attempts.append(attempt)
            if attempt.status == "accepted":
                changed = True
                self.is_known = self.is_known or closure.overlap >= self.config.known_overlap
        if self.is_known:
            self.submaps.remove(submap)
            if self.places.submaps is not None:
                self.places.submaps.append(submap)
        if changed:
            dropped = {id(edge) for edge, _ in self.graph.dropped}
            self.accepted = [pair for pair in self.accepted if id(pair[1]) not in dropped]
            attempts += self.reject_outliers()
        if self.is_known:
            self.places.settle(submap.anchor, self.accepted, [one.anchor for one in self.submaps])
        return tuple(attempts)

    def decide(
        self, closure: Closure, T_predicted: FloatArray, cov: FloatArray, *, is_strict: bool = False
    ) -> ClosureAttempt:
        """Accept a verified closure now, keep it until another one confirms it, or refuse it.

        A strict one is refused beyond the gate: rooms that look the same confirm each other.
        """
        offset = se2.log(se2.between(closure.T_target_source, T_predicted))
        distance2 = mahalanobis2(offset, cov + closure.cov)
        how_far = f"squared Mahalanobis distance {distance2:.0f}"
        if distance2 <= self.config.gate:
            self._accept([closure])
            return closure.attempt("accepted", "")
        if is_strict or distance2 > self.config.gate * self.config.gate_scale**2:
            return closure.attempt("refused", f"improbable, {how_far}")
        consistent = [other for other in self.pending if self._is_consistent(closure, other)]
        if consistent:
            for other in consistent:
                self.pending.remove(other)
            self._accept([*consistent, closure])
            return closure.attempt("accepted", f"confirmed by {len(consistent)} others")
        self.pending.append(closure)
        return closure.attempt("waiting", how_far)

    def relocalize(self, closures: list[Closure], nodes: FloatArray) -> ClosureAttempt:
        """Take closures between the old map and the component of a lost robot for hypotheses on where that lies.

        Once what was seen speaks for one place, and for no other that looks like it, the component is moved there and
        joined. `nodes` (n, 3) are the graph's poses.
        """
        relocalization = self.relocalization
        closure = closures[0] if closures else relocalization.closures[-1]
        places = relocalization.collect(closures, nodes)[: self.config.relocalization.n_weighed]
        place = relocalization.decide(places, self.submaps, nodes)
        if not isinstance(place, str) and self.finder is not None:
            seen = next((submap for submap in self.submaps if submap.number == place.target), None)
            repeats = self.finder.repeats.get(place.target, np.empty((0, 3)))
            if seen is not None and place.target not in self.finder.repeats:
                self.finder.request_repeats(seen, nodes)
                place = "whether the map repeats there is looked at first"
            elif len(repeats):
                others = [other for other in places if other is not place]
                place = relocalization.decide([place, *others, *place.repeated(repeats)], self.submaps, nodes)
        if isinstance(place, str):
            return closure.attempt("waiting", f"where the lost robot is: {place}")
        agreeing, T_map_new = place.closures, place.T_map_new
        component = closure.source.component
        anchors = [submap.anchor for submap in self.submaps if submap.component == component]
        first = min([*anchors, *(one.source.anchor for one in agreeing)])
        first = self.first_nodes.get(component, first)
        nodes[first:] = se2.compose(T_map_new[None, :], nodes[first:])
        # of local maps that went on growing the last one tells all
        self._add_edges(list({(one.source.anchor, one.target.anchor): one for one in agreeing}.values()))
        self.graph.rebuild(nodes)
        self.relocalization.join()
        return closure.attempt("accepted", f"{FOUND_AGAIN}, {len(agreeing)} closures agree")

    def reject_outliers(self) -> list[ClosureAttempt]:
        """Reject the closure that the rest of the graph contradicts most, until none is; tells which."""
        rejected: list[ClosureAttempt] = []
        while self.accepted:
            residual2 = self._residuals2()
            worst = int(np.argmax(residual2))
            if residual2[worst] <= self.config.max_residual2:
                break
            closure, edge = self.accepted.pop(worst)
            self.graph.remove_edges([edge])
            reason = f"the rest of the graph contradicts it, squared residual {residual2[worst]:.0f}"
            rejected.append(closure.attempt("outlier", reason))
        return rejected

    def _candidates(self, source: Submap, nodes: FloatArray) -> list[_Candidate]:
        """Earlier local maps that may show the same place, the nearest first."""
        config, joined = self.config, self.relocalization.joined
        is_lost = source.component not in joined
        others = set[int]() if self.is_sought(source.component) else joined
        old = [
            s
            for s in self.submaps
            if (s.component in others and s.component != source.component)
            or (s.component == source.component and source.path_m - s.path_m > config.min_path_m)
        ]
        if not old:
            return []
        T_map_source = nodes[source.anchor]
        centre = se2.transform(T_map_source, source.centre[None, :])[0]
        T_map_old = nodes[[s.anchor for s in old]]
        centres = se2.transform(T_map_old, np.array([s.centre for s in old])[:, None, :])[:, 0]
        distance_m = np.hypot(*(centres - centre).T)
        found: list[_Candidate] = []
        n_candidates = config.n_candidates_lost if is_lost else config.n_candidates
        spacing = config.candidate_spacing_lost if is_lost else config.candidate_spacing
        for k in np.argsort(distance_m, kind="stable"):
            if distance_m[k] > config.max_distance_m or len(found) == n_candidates:
                break
            if any(abs(old[k].number - other.target.number) < spacing for other in found):
                continue
            cov, is_strict = self._drift(old[k], source, nodes)
            is_apart = self.relocalization.is_apart(old[k], source)
            window = search_window(config, cov, is_apart=is_apart)
            if distance_m[k] > window.reach_m + config.candidate_margin_m and not is_apart:
                break
            T_predicted = se2.between(T_map_old[k], T_map_source)
            found.append(_Candidate(old[k], T_predicted, cov, window, is_strict))
        return found

    def _drift(self, old: Submap, source: Submap, nodes: FloatArray) -> tuple[FloatArray, bool]:
        """Covariance (3, 3) of how two local maps lie to each other, and whether most of it is of blind drives.

        What matches tell of each other's errors is not known, and is scaled; what the odometry says alone is not.
        """
        config = self.config
        cov = self.graph.relative_covariance(old.anchor, source.anchor)
        if not self.blind_drives:
            return config.drift_scale**2 * cov, False
        blind = np.zeros((3, 3))
        for node, cov_node in self.blind_drives:
            if old.anchor < node <= source.anchor:
                T_source_node = se2.between(nodes[source.anchor], nodes[node])
                ad = se2.adjoint(T_source_node)
                blind += ad @ cov_node @ ad.T
        is_blind = bool(np.trace(blind[:2, :2]) > 0.5 * np.trace(cov[:2, :2]) > 0.0)
        if not is_blind or np.trace(cov[:2, :2]) < 0.5 * np.trace(
            blind[:2, :2]
        ):  # or joined by another closure
            return config.drift_scale**2 * cov, False
        values, vectors = np.linalg.eigh(cov - blind)
        rest = (vectors * np.maximum(values, 0.0)) @ vectors.T
        return config.drift_scale**2 * rest + config.blind_scale**2 * blind, True

    def _is_consistent(self, a: Closure, b: Closure) -> bool:
        """Tell whether two closures of different local maps say the same about the motion between."""
        config = self.config.consistency
        if abs(a.source.number - b.source.number) < config.min_number_gap:
            return False
        path_m = abs(a.source.path_m - b.source.path_m) + abs(a.target.path_m - b.target.path_m)
        if path_m > config.max_path_m:
            return False
        nodes = self.graph.poses()
        T_at_bt = se2.between(nodes[a.target.anchor], nodes[b.target.anchor])
        T_bs_as = se2.between(nodes[b.source.anchor], nodes[a.source.anchor])
        predicted = se2.compose(se2.compose(T_at_bt, b.T_target_source), T_bs_as)
        offset = se2.log(se2.between(a.T_target_source, predicted))
        std_m = config.std_m + config.std_m_per_m * path_m
        std = np.array([std_m, std_m, config.std_rad + config.std_rad_per_m * path_m])
        return bool(np.sum((offset / std) ** 2) < self.config.gate)

    def _forget_old(self, submap: Submap) -> None:
        """Let go of closures that lie too far back for one of this local map to confirm them."""
        most_m = self.config.consistency.max_path_m
        self.pending = [one for one in self.pending if abs(submap.path_m - one.source.path_m) <= most_m]

    def _accept(self, closures: list[Closure]) -> None:
        self._add_edges(closures)
        self.graph.update()

    def _add_edges(self, closures: list[Closure]) -> None:
        for closure in closures:
            edge = self.graph.try_edge(
                "closure",
                closure.target.anchor,
                closure.source.anchor,
                closure.T_target_source,
                closure.information,
            )
            if edge is not None:
                self.accepted.append((closure, edge))
                self.places.see(closure)

    def _residuals2(self) -> FloatArray:
        """(k,) squared residuals of the accepted closures, each in its own covariance."""
        nodes = self.graph.poses()
        closures = [closure for closure, _ in self.accepted]
        T_map_target = nodes[[c.target.anchor for c in closures]]
        T_map_source = nodes[[c.source.anchor for c in closures]]
        T_found = np.array([c.T_target_source for c in closures])
        offset = se2.log(se2.between(T_found, se2.between(T_map_target, T_map_source)))
        information = np.array([c.information for c in closures])
        return np.asarray(np.einsum("ki,kij,kj->k", offset, information, offset))
