"""Where in a whole saved map a local map lies, with no guess: branch and bound over all of its local maps at once."""

import math

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.relocalization import hypothesis_of
from slammot_graph.loop_closure.submap import Submap
from slammot_graph.loop_closure.verification import SearchWindow, Verifier

COVER_M, COVER_RAD = 2.0, 0.8
"""A local map this near to another one, and seen in the same direction, needs no search of its own."""

REACH_M = 6.0
"""How far from the middle of a local map the robot is looked for."""

MOST_PLACES = 8
"""So many of the best places are verified."""

GUESS_M, GUESS_RAD = 5.0, 1.0
"""How far off a pose may be that somebody gives."""


class PlaceFinder:
    """Searches the local maps of a saved map.

    Attributes
    ----------
    verifier : Verifier
    targets : list of Submap
        Those that are looked at; together they cover the map.
    initial_pose : (3,) array or None
        About where the component that is looked for begins, map frame.
    """

    def __init__(
        self,
        verifier: Verifier,
        submaps: list[Submap],
        nodes: FloatArray,
        initial_pose: FloatArray | None = None,
    ) -> None:
        self.verifier = verifier
        self.targets = covering(submaps, nodes)
        self.initial_pose = initial_pose
        verifier.n_prepared = max(verifier.n_prepared, min(len(self.targets) + 2, 512))

    def find(self, source: Submap, nodes: FloatArray) -> list[Closure]:
        """Give the closures of a local map with all places of the map that agree with it about as well as the best.

        Places that show the same hypothesis are told once. Nothing is told while more places than can be verified
        agree, which repeat then.

        Parameters
        ----------
        source : Submap
        nodes : (n, 3) array
            Optimised poses of the graph.
        """
        config = self.verifier.config
        window = SearchWindow(math.inf, REACH_M, math.pi, is_full_circle=True)
        best = 0.0
        found: list[tuple[float, Submap, FloatArray]] = []
        for target in self.targets:
            centre = np.array([*target.centre, 0.0])
            needed = max(config.min_score, config.max_ambiguity * best)
            score, pose = self.verifier.best_pose(target, source, centre, window, needed)
            if score > 0.0:
                best = max(best, score)
                found.append((score, target, pose))
        found = [one for one in found if one[0] >= config.max_ambiguity * best]
        found.sort(key=lambda one: -one[0])
        places = np.empty((0, 3))
        closures: list[Closure] = []
        for _, target, pose in found:
            place = se2.compose(nodes[target.anchor], pose)
            if _is_near(
                places, place, config.relocalization.same_place_m, config.relocalization.same_place_rad
            ).any():
                continue
            if len(places) == MOST_PLACES:
                return []
            places = np.vstack([places, place])
            closure = self.verifier.verify(target, source, pose, window)
            if isinstance(closure, Closure) and self._is_expected(closure, nodes):
                closures.append(closure)
        return closures

    def _is_expected(self, closure: Closure, nodes: FloatArray) -> bool:
        """Tell whether a place agrees with the pose that was given, if one was."""
        if self.initial_pose is None:
            return True
        T_map_new = hypothesis_of(closure, nodes).T_map_new
        return bool(_is_near(self.initial_pose[None, :], T_map_new, GUESS_M, GUESS_RAD)[0])


def covering(submaps: list[Submap], nodes: FloatArray) -> list[Submap]:
    """Choose local maps so that each other one lies near a chosen one, seen in the same direction."""
    chosen: list[Submap] = []
    views = np.empty((0, 3))
    for submap in submaps:
        view = submap.T_anchor_keyframes[len(submap.keyframes) // 2].copy()
        view[:2] = submap.centre
        view = se2.compose(nodes[submap.anchor], view)
        if not _is_near(views, view, COVER_M, COVER_RAD).any():
            chosen.append(submap)
            views = np.vstack([views, view])
    return chosen


def _is_near(poses: FloatArray, pose: FloatArray, distance_m: float, angle_rad: float) -> BoolArray:
    """Tell which poses (k, 3) lie within both of a pose (3,)."""
    offset = se2.between(pose[None, :], poses)
    is_near = np.hypot(offset[:, 0], offset[:, 1]) < distance_m
    return np.asarray(is_near & (np.abs(offset[:, 2]) < angle_rad))
