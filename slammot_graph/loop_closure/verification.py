"""Verification of a loop closure, local map against local map: search, match, checks."""

import math
from collections import OrderedDict
from typing import NamedTuple

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.linalg import covariance_of
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure import _kernels
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.config import LoopClosureConfig
from slammot_graph.loop_closure.submap import PreparedSubmap, Submap
from slammot_graph.mapping.local_map import LocalMap, LocalMapConfig
from slammot_graph.registration.base import MatchPrior
from slammot_graph.registration.factory import make_matcher


class SearchWindow(NamedTuple):
    """What the search covers around a predicted relative pose.

    Attributes
    ----------
    reach_m : float
        How far off the prediction may be, without bounds [m].
    distance_m, rotation_rad : float
        How far the search goes in x and y, and in angle, to either side.
    is_full_circle : bool
        Nothing is known of the motion between: all angles are searched, with fewer points.
    """

    reach_m: float
    distance_m: float
    rotation_rad: float
    is_full_circle: bool = False


def search_window(config: LoopClosureConfig, cov: FloatArray, *, is_apart: bool) -> SearchWindow:
    """Give the window for a relative pose of covariance (3, 3), body frame; `is_apart` if that means nothing."""
    reach_m = config.sigma_scale * math.sqrt(np.linalg.eigvalsh(cov[:2, :2])[-1])
    if is_apart:
        return SearchWindow(reach_m, config.max_search_m, math.pi, is_full_circle=True)
    reach_rad = config.sigma_scale * math.sqrt(cov[2, 2])
    return SearchWindow(
        reach_m,
        float(np.clip(reach_m, config.min_search_m, config.max_search_m)),
        float(np.clip(reach_rad, config.min_search_rad, config.max_search_rad)),
    )


class Verifier:
    """Tells whether two local maps show the same place, and how they lie to each other.

    Attributes
    ----------
    config : LoopClosureConfig
    n_prepared : int
        Score grids of so many local maps are kept.
    """

    def __init__(self, config: LoopClosureConfig, local_map: LocalMapConfig) -> None:
        self.config = config
        self.n_prepared = config.n_prepared
        self._field = LocalMap(local_map)
        self._matcher = make_matcher(config.point_to_line)
        self._prepared: OrderedDict[int, PreparedSubmap] = OrderedDict()

    def verify(
        self, target: Submap, source: Submap, T_predicted: FloatArray, window: SearchWindow
    ) -> Closure | str:
        """Search, match and check one local map against another; the reason if they do not agree.

        Parameters
        ----------
        target, source : Submap
        T_predicted : (3,) array
            Anchor of the source in the frame of the target's anchor.
        window : SearchWindow
        """
        start = self._find_start(self.prepare(target), source, T_predicted, window)
        return start if isinstance(start, str) else self.check(target, source, start)

    def best_pose(
        self,
        target: Submap,
        source: Submap,
        centre: FloatArray,
        window: SearchWindow,
        min_score: float,
        excluded: FloatArray | None = None,
    ) -> tuple[float, FloatArray]:
        """Give the best pose (3,) of a local map around one (3,) of another, with its share of the best possible score.

        The share is 0 where that is not above `min_score`; the search is the quicker the higher that is. Poses about
        one (3,) that is `excluded` do not count.
        """
        prepared, points, pose = self.prepare(target), self._search_points(source, window), np.empty(3)
        most = prepared.config.occupied_score * len(points)
        return self._search(prepared, points, centre, window, excluded, min_score * most, pose) / most, pose

    def prepare(self, submap: Submap) -> PreparedSubmap:
        """Give a submap's grids, from a small store of the latest ones used."""
        prepared = self._prepared.pop(submap.number, None) or PreparedSubmap(submap)
        self._prepared[submap.number] = prepared
        if len(self._prepared) > self.n_prepared:
            self._prepared.popitem(last=False)
        return prepared

    def check(self, target: Submap, source: Submap, start: FloatArray) -> Closure | str:
        """Match from a pose (3,) and check; the reason if they do not agree."""
        prepared = self.prepare(target)
        match = self._match(target, source, start)
        if match.status == "failed":
            return match.reason
        min_overlap = self.config.min_overlap
        points, _ = source.points_and_normals
        overlap = match.n_correspondences / len(points)
        if overlap < min_overlap or match.inlier_ratio < self.config.min_inlier_share * min_overlap:
            return f"overlap of {100 * overlap:.0f}% only"
        violation = max(
            _free_space_violation(prepared, points, match.T_ref_base),
            _free_space_violation(
                self.prepare(source), target.points_and_normals[0], se2.inverse(match.T_ref_base)
            ),
        )
        if violation > self.config.max_free_space_violation:
            return f"{100 * violation:.0f}% of the points lie where the other saw free space"
        return Closure(
            target=target.place,
            source=source.place,
            T_target_source=match.T_ref_base,
            cov=covariance_of(match.graph_information),
            information=match.graph_information,
            overlap=overlap,
            cov_own=match.cov,
        )

    def _search_points(self, source: Submap, window: SearchWindow) -> FloatArray:
        """(m, 2) points to search with: fewer where all angles are."""
        points = source.search_points
        return (
            points[:: 1 + len(points) // self.config.n_search_points_lost]
            if window.is_full_circle
            else points
        )

    def _find_start(
        self, prepared: PreparedSubmap, source: Submap, T_predicted: FloatArray, window: SearchWindow
    ) -> FloatArray | str:
        """Search for the pose (3,) of the source that agrees best, if it is clearly better than any other."""
        config = self.config
        points = self._search_points(source, window)
        most = prepared.config.occupied_score * len(points)
        start, second = np.empty(3), np.empty(3)
        score = self._search(prepared, points, T_predicted, window, None, config.min_score * most, start)
        if score == 0:
            return "no pose agrees"
        rival = self._search(
            prepared, points, T_predicted, window, start, config.max_ambiguity * score, second
        )
        if rival:
            return f"ambiguous: another pose scores {100 * rival / score:.0f}% of the best"
        return start

    def _search(
        self,
        prepared: PreparedSubmap,
        points: FloatArray,
        centre: FloatArray,
        window: SearchWindow,
        excluded: FloatArray | None,
        min_score: float,
        out: FloatArray,
    ) -> int:
        config, cell_m = self.config, prepared.config.cell_m
        lever_m = float(np.quantile(np.hypot(*points.T), config.turn_lever_quantile))
        turn_step = cell_m / max(lever_m, config.min_turn_lever_m)
        return _kernels.branch_and_bound(
            prepared.pyramid,
            float(prepared.origin[0]),
            float(prepared.origin[1]),
            1.0 / cell_m,
            points,
            centre,
            math.ceil(window.distance_m / cell_m),
            math.ceil(window.rotation_rad / turn_step),
            turn_step,
            np.full(3, 1e9) if excluded is None else excluded,
            config.same_pose_m,
            config.same_pose_rad,
            int(min_score),
            out,
        )

    def _match(self, target: Submap, source: Submap, start: FloatArray) -> MatchResult:
        """Match the points of the source onto those of the target, from a pose (3,)."""
        config = self.config
        self._field.start([target.as_keyframe()])
        points, _ = source.points_and_normals
        used = np.ones(len(points), dtype=np.bool_)
        weak_prior = np.diag(
            np.square((config.match_prior_std_m, config.match_prior_std_m, config.match_prior_std_rad))
        )
        from_anywhere = np.full(2, np.nan)
        prior = MatchPrior(T_a_base=start, cov=weak_prior)
        return self._matcher.match(self._field, points, used, from_anywhere, prior).result


def _free_space_violation(prepared: PreparedSubmap, points: FloatArray, T: FloatArray) -> float:
    """Share of points (m, 2), moved by T (3,), in free space, of those in seen space."""
    n_free, n_agree = prepared.free_share(se2.transform(T, points))
    return n_free / max(n_free + n_agree, 1)
