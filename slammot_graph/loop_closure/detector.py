"""Loop closure: candidates, verification map against map, and a joint decision before the graph is told."""

import math
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.linalg import covariance_of, mahalanobis2
from slammot_graph.core.results import ClosureAttempt, ClosureStatus, GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph
from slammot_graph.loop_closure import _kernels
from slammot_graph.loop_closure.relocalization import PlaceHypothesis, find_consensus
from slammot_graph.loop_closure.submap import CELL_M, OCCUPIED_SCORE, Place, PreparedSubmap, Submap
from slammot_graph.mapping.local_map import LocalMap, LocalMapConfig
from slammot_graph.registration.point_to_line import PointToLineConfig, match_to_local_map


@dataclass(frozen=True, kw_only=True)
class LoopClosureConfig:
    """When two local maps may be the same place, and what it takes to believe it.

    Attributes
    ----------
    min_path_m : float
        Way driven between two local maps before they can close a loop.
    max_distance_m : float
        Their centres lie nearer than this, the search radius included.
    drift_scale : float
        Factor on the standard deviations of the graph's relative pose: matches of neighbouring scans share
        errors (the same wall, the same beams), which the graph takes for independent.
    sigma_scale : float
        The search covers this many standard deviations of their relative pose ...
    min_search_m, max_search_m, min_search_rad, max_search_rad : float
        ... within these bounds.
    n_candidates, n_candidates_lost : int
        Local maps that are looked at per finished one, the nearest first; and while the robot is lost.
    known_overlap : float
        A local map of which this share lies on an earlier one shows a known place: it is not looked at again, and the
        graph gets no more nodes there than its local maps hang on.
    min_score : float
        Share of the best possible agreement that the search must reach.
    min_overlap : float
        Share of the points that find a partner after the match.
    max_free_space_violation : float
        Largest share of points in free space, of those in seen space.
    max_ambiguity : float
        Refused if a second pose scores more than this share of the first.
    gate : float
        Squared Mahalanobis distance to the graph's own belief below which a closure is taken at once (16.27: 99.9%).
    gate_scale : float
        Up to this many times the standard deviations a closure is taken once another one confirms it.
    max_residual2 : float
        A closure whose residual after the update is above this, in its own covariance, is taken out again.
    point_to_line : PointToLineConfig
    """

    min_path_m: float = 8.0
    max_distance_m: float = 12.0
    drift_scale: float = 5.0
    sigma_scale: float = 6.0
    min_search_m: float = 0.5
    max_search_m: float = 8.0
    min_search_rad: float = 0.15
    max_search_rad: float = 0.8
    n_candidates: int = 3
    n_candidates_lost: int = 7
    min_score: float = 0.38
    min_overlap: float = 0.55
    known_overlap: float = 0.8
    max_free_space_violation: float = 0.2
    max_ambiguity: float = 0.9
    gate: float = 16.27
    gate_scale: float = 4.0
    max_residual2: float = 150.0
    point_to_line: PointToLineConfig = field(
        default_factory=lambda: PointToLineConfig(floor_std_m=0.01, max_iterations=30)
    )

    def __post_init__(self) -> None:
        for name in (
            "min_path_m",
            "max_distance_m",
            "drift_scale",
            "sigma_scale",
            "gate",
            "gate_scale",
            "max_residual2",
        ):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"closure.{name} must be positive, not {getattr(self, name)}")
        if not (
            0.0 < self.min_search_m <= self.max_search_m and 0.0 < self.min_search_rad <= self.max_search_rad
        ):
            raise ConfigError("closure needs 0 < min_search <= max_search, in metres and in radians")
        for name in ("n_candidates", "n_candidates_lost"):
            if getattr(self, name) < 1:
                raise ConfigError(f"closure.{name} must be at least 1, not {getattr(self, name)}")
        for name in (
            "min_score",
            "min_overlap",
            "known_overlap",
            "max_free_space_violation",
            "max_ambiguity",
        ):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"closure.{name} must be in [0, 1], not {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Closure:
    """Two local maps found to be the same place: anchor of `source` in the frame of the anchor of `target`.

    Attributes
    ----------
    target, source : Place
    T_target_source : (3,) array
    cov, information : (3, 3) array
        Right perturbation; no information in directions that the match does not determine.
    overlap : float
        Share of the source's points that found a partner.
    """

    target: Place
    source: Place
    T_target_source: FloatArray
    cov: FloatArray
    information: FloatArray
    overlap: float

    def attempt(self, status: ClosureStatus, reason: str) -> ClosureAttempt:
        """What became of it."""
        return _attempt(self.target, self.source, status, reason, self.T_target_source)


def _attempt(
    target: Place, source: Place, status: ClosureStatus, reason: str, T_target_source: FloatArray
) -> ClosureAttempt:
    return ClosureAttempt(
        target_node=target.anchor,
        source_node=source.anchor,
        status=status,
        reason=reason,
        T_target_source=T_target_source,
    )


class LoopCloser:
    """Looks at each finished local map, and tells the graph when the robot has come back.

    Attributes
    ----------
    submaps : list of Submap
        Those that later ones are compared with.
    accepted : list of (Closure, GraphEdge)
    pending : list of Closure
        Those that wait for others to confirm them.
    is_known : bool
        The latest local map shows a known place.
    """

    N_PREPARED = 64

    def __init__(self, config: LoopClosureConfig, local_map: LocalMapConfig, graph: PoseGraph) -> None:
        self.config = config
        self.graph = graph
        self.submaps: list[Submap] = []
        self.accepted: list[tuple[Closure, GraphEdge]] = []
        self.pending: list[Closure] = []
        self.is_known = False
        self._joined = {0}
        self._hypotheses: dict[int, list[Closure]] = {}
        self._prepared: OrderedDict[int, PreparedSubmap] = OrderedDict()
        self._field = LocalMap(local_map)

    def consider(self, submap: Submap) -> tuple[bool, tuple[ClosureAttempt, ...]]:
        """Take in a finished local map; returns whether the graph has changed, and what was tried."""
        attempts: list[ClosureAttempt] = []
        verified = []
        nodes = self.graph.poses()
        for target, T_target_source, cov in self._candidates(submap, nodes):
            closure, reason = self._verify(target, submap, T_target_source, cov)
            if closure is None:
                attempts.append(_attempt(target.place, submap.place, "refused", reason, T_target_source))
            else:
                verified.append((closure, T_target_source, cov))
        self.submaps.append(submap)
        self.is_known = changed = False
        for closure, T_predicted, cov in verified:
            is_apart = self._is_apart(closure.target, closure.source)
            attempt = self.relocalize(closure) if is_apart else self.decide(closure, T_predicted, cov)
            attempts.append(attempt)
            if attempt.status == "accepted":
                changed = True
                self.is_known = self.is_known or closure.overlap >= self.config.known_overlap
        if self.is_known:
            self.submaps.remove(submap)
        if changed:
            attempts += self.reject_outliers()
        return changed, tuple(attempts)

    def decide(self, closure: Closure, T_predicted: FloatArray, cov: FloatArray) -> ClosureAttempt:
        """Accept a verified closure now, keep it until another one confirms it, or refuse it."""
        offset = se2.log(se2.between(closure.T_target_source, T_predicted))
        distance2 = mahalanobis2(offset, cov + closure.cov)
        how_far = f"squared Mahalanobis distance {distance2:.0f}"
        if distance2 <= self.config.gate:
            self._accept([closure])
            return closure.attempt("accepted", "")
        if distance2 > self.config.gate * self.config.gate_scale**2:
            return closure.attempt("refused", f"improbable, {how_far}")
        consistent = [other for other in self.pending if self._agree(closure, other)]
        if consistent:
            for other in consistent:
                self.pending.remove(other)
            self._accept([*consistent, closure])
            return closure.attempt("accepted", f"confirmed by {len(consistent)} others")
        self.pending.append(closure)
        return closure.attempt("waiting", how_far)

    def relocalize(self, closure: Closure) -> ClosureAttempt:
        """Let a closure between the old map and the component of a lost robot hypothesis on where the component lies.

        Once the hypotheses agree, the component is carried there and joined.
        """
        component = closure.source.component
        if component not in self._hypotheses:
            self._hypotheses = {component: []}
        self._hypotheses[component].append(closure)
        nodes = self.graph.poses()
        hypotheses = [self._hypothesis(hypothesis, nodes) for hypothesis in self._hypotheses[component]]
        agreed = find_consensus(hypotheses)
        if not agreed:
            return closure.attempt("waiting", f"where the lost robot is: {len(hypotheses)} hypotheses so far")
        agreeing = [self._hypotheses[component][k] for k in agreed]
        first = min(submap.anchor for submap in self.submaps if submap.component == component)
        nodes[first:] = se2.compose(hypotheses[agreed[-1]].T_map_new[None, :], nodes[first:])
        self._add_edges(agreeing)
        self.graph.rebuild(nodes)
        self._joined.add(component)
        self._hypotheses = {}
        return closure.attempt("accepted", f"found again, {len(agreeing)} closures agree")

    def _hypothesis(self, closure: Closure, nodes: FloatArray) -> PlaceHypothesis:
        place = se2.compose(nodes[closure.target.anchor], closure.T_target_source)
        T_map_new = se2.compose(place, se2.inverse(nodes[closure.source.anchor]))
        return PlaceHypothesis(source=closure.source.number, T_map_new=T_map_new, place=place)

    def _is_apart(self, a: Submap | Place, b: Submap | Place) -> bool:
        """Tell whether nothing is known of the way between two local maps."""
        if a.component == b.component:
            return False
        return not (a.component in self._joined and b.component in self._joined)

    def _candidates(self, source: Submap, nodes: FloatArray) -> list[tuple[Submap, FloatArray, FloatArray]]:
        """Earlier local maps that may show the same place, with the relative pose and its covariance."""
        is_lost = source.component not in self._joined
        old = [
            s
            for s in self.submaps
            if (s.component in self._joined and s.component != source.component)
            or (s.component == source.component and source.path_m - s.path_m > self.config.min_path_m)
        ]
        if not old:
            return []
        T_map_source = nodes[source.anchor]
        centre = se2.transform(T_map_source, source.centre[None, :])[0]
        T_map_old = nodes[[s.anchor for s in old]]
        centres = se2.transform(T_map_old, np.array([s.centre for s in old])[:, None, :])[:, 0]
        distance_m = np.hypot(*(centres - centre).T)
        found: list[tuple[Submap, FloatArray, FloatArray]] = []
        n_candidates = self.config.n_candidates_lost if is_lost else self.config.n_candidates
        spacing = 2 if is_lost else 4
        for k in np.argsort(distance_m, kind="stable"):
            if distance_m[k] > self.config.max_distance_m or len(found) == n_candidates:
                break
            if any(abs(old[k].number - other.number) < spacing for other, _, _ in found):
                continue
            cov = self.config.drift_scale**2 * self.graph.relative_covariance(old[k].anchor, source.anchor)
            reach_m = self.config.sigma_scale * math.sqrt(np.linalg.eigvalsh(cov[:2, :2])[-1]) + 4.0
            if distance_m[k] > reach_m and not self._is_apart(old[k], source):
                break
            found.append((old[k], se2.between(T_map_old[k], T_map_source), cov))
        return found

    def _verify(
        self, target: Submap, source: Submap, T_predicted: FloatArray, cov: FloatArray
    ) -> tuple[Closure | None, str]:
        """Search, match and check one local map against another; None with the reason if they do not agree."""
        config = self.config
        prepared = self._prepare(target)
        sigma_m = math.sqrt(np.linalg.eigvalsh(cov[:2, :2])[-1])
        search_m = float(np.clip(config.sigma_scale * sigma_m, config.min_search_m, config.max_search_m))
        sigma_rad = math.sqrt(cov[2, 2])
        search_rad = float(
            np.clip(config.sigma_scale * sigma_rad, config.min_search_rad, config.max_search_rad)
        )
        start = np.empty(3)
        points = source.search_points
        if self._is_apart(target, source):
            search_m, search_rad = config.max_search_m, math.pi
            points = points[:: 1 + len(points) // 200]  # a search of the full circle has to save time
        most = OCCUPIED_SCORE * len(points)
        score = self._search(
            prepared, points, T_predicted, search_m, search_rad, None, config.min_score * most, start
        )
        if score == 0:
            return None, "no pose agrees"
        second = np.empty(3)
        rival = self._search(
            prepared, points, T_predicted, search_m, search_rad, start, config.max_ambiguity * score, second
        )
        if rival:
            return None, f"ambiguous: another pose scores {100 * rival / score:.0f}% of the best"
        self._field.start([target.as_keyframe()])
        all_points, _ = source.points_and_normals
        used = np.ones(len(all_points), dtype=np.bool_)
        weak_prior = np.diag([1.0, 1.0, 0.25])
        from_anywhere = np.full(2, np.nan)
        match, _, _ = match_to_local_map(
            all_points, used, from_anywhere, self._field, start, weak_prior, config.point_to_line
        )
        if match.status == "failed":
            return None, match.reason
        overlap = match.n_correspondences / len(all_points)
        if overlap < config.min_overlap or match.inlier_ratio < 0.7 * config.min_overlap:
            return None, f"overlap of {100 * overlap:.0f}% only"
        contradiction = max(
            self._free_space_violation(prepared, all_points, match.T_ref_base),
            self._free_space_violation(
                self._prepare(source), target.points_and_normals[0], se2.inverse(match.T_ref_base)
            ),
        )
        if contradiction > config.max_free_space_violation:
            return None, f"{100 * contradiction:.0f}% of the points lie where the other saw free space"
        closure = Closure(
            target=target.place,
            source=source.place,
            T_target_source=match.T_ref_base,
            cov=covariance_of(match.graph_information),
            information=match.graph_information,
            overlap=overlap,
        )
        return closure, ""

    def _search(
        self,
        prepared: PreparedSubmap,
        points: FloatArray,
        centre: FloatArray,
        search_m: float,
        search_rad: float,
        excluded: FloatArray | None,
        min_score: float,
        out: FloatArray,
    ) -> int:
        lever_m = float(np.quantile(np.hypot(*points.T), 0.9))
        turn_step = CELL_M / max(lever_m, 1.0)
        return _kernels.branch_and_bound(
            prepared.pyramid,
            float(prepared.origin[0]),
            float(prepared.origin[1]),
            1.0 / CELL_M,
            points,
            centre,
            math.ceil(search_m / CELL_M),
            math.ceil(search_rad / turn_step),
            turn_step,
            np.full(3, 1e9) if excluded is None else excluded,
            0.5,
            0.1,
            int(min_score),
            out,
        )

    @staticmethod
    def _free_space_violation(prepared: PreparedSubmap, points: FloatArray, T: FloatArray) -> float:
        n_free, n_agree = prepared.free_share(se2.transform(T, points))
        return n_free / max(n_free + n_agree, 1)

    def _prepare(self, submap: Submap) -> PreparedSubmap:
        """Give a submap's grids, from a small store of the latest ones used."""
        prepared = self._prepared.pop(submap.number, None) or PreparedSubmap(submap)
        self._prepared[submap.number] = prepared
        if len(self._prepared) > self.N_PREPARED:
            self._prepared.popitem(last=False)
        return prepared

    def _agree(self, a: Closure, b: Closure) -> bool:
        """Tell whether two closures of different local maps say the same about the way between."""
        if abs(a.source.number - b.source.number) < 2:
            return False
        path_m = abs(a.source.path_m - b.source.path_m) + abs(a.target.path_m - b.target.path_m)
        if path_m > 40.0:
            return False
        nodes = self.graph.poses()
        T_at_bt = se2.between(nodes[a.target.anchor], nodes[b.target.anchor])
        T_bs_as = se2.between(nodes[b.source.anchor], nodes[a.source.anchor])
        predicted = se2.compose(se2.compose(T_at_bt, b.T_target_source), T_bs_as)
        offset = se2.log(se2.between(a.T_target_source, predicted))
        std = np.array([0.05 + 0.01 * path_m, 0.05 + 0.01 * path_m, 0.02 + 0.002 * path_m])
        return bool(np.sum((offset / std) ** 2) < self.config.gate)

    def _accept(self, closures: list[Closure]) -> None:
        self._add_edges(closures)
        self.graph.update()

    def _add_edges(self, closures: list[Closure]) -> None:
        for closure in closures:
            edge = self.graph.add_edge(
                "closure",
                closure.target.anchor,
                closure.source.anchor,
                closure.T_target_source,
                closure.information,
            )
            self.accepted.append((closure, edge))

    def reject_outliers(self) -> list[ClosureAttempt]:
        """Take out the closure that the rest of the graph contradicts most, until none is; tells which."""
        taken: list[ClosureAttempt] = []
        while self.accepted:
            residual2 = self._residuals2()
            worst = int(np.argmax(residual2))
            if residual2[worst] <= self.config.max_residual2:
                break
            closure, edge = self.accepted.pop(worst)
            self.graph.remove_edges([edge])
            reason = f"the rest of the graph contradicts it, squared residual {residual2[worst]:.0f}"
            taken.append(closure.attempt("outlier", reason))
        return taken

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
