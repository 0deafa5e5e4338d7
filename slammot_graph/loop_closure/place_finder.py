"""Where in a whole saved map a local map lies, with no guess: branch and bound over all of its local maps at once."""

import math
from collections.abc import Generator

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

N_AT_ONCE = 6
"""Local maps that are looked at in a step."""

GUESS_M, GUESS_RAD = 5.0, 1.0
"""How far off a pose may be that somebody gives."""

_Search = Generator[None, None, list[Closure]]


class PlaceFinder:
    """Searches the local maps of a saved map, and those that a run which goes on with it has added.

    A search goes over many steps, each of which looks at a few of the local maps, so that none takes long.

    Attributes
    ----------
    verifier : Verifier
    targets : list of Submap
        Those that are looked at; together they cover the map. Those that agreed best in the last search come first, as
        a search is the quicker the better a place is known.
    initial_pose : (3,) array or None
        About where the component that is looked for begins, map frame.
    n_at_once : int
        So many of them are looked at in a step.
    """

    def __init__(
        self,
        verifier: Verifier,
        submaps: list[Submap],
        nodes: FloatArray,
        initial_pose: FloatArray | None = None,
        n_at_once: int = N_AT_ONCE,
    ) -> None:
        self.verifier = verifier
        self.targets = covering(submaps, nodes)
        self.initial_pose = initial_pose
        self.n_at_once = n_at_once
        self._search: _Search | None = None
        self._next: tuple[Submap, FloatArray] | None = None
        verifier.n_prepared = max(verifier.n_prepared, min(len(self.targets) + 2, 512))

    def request(self, source: Submap, nodes: FloatArray) -> None:
        """Let a local map be looked for, after the one that is; of several that wait the last one counts."""
        if self._search is None:
            self._search = self._searching(source, nodes)
        else:
            self._next = source, nodes

    def forget(self) -> None:
        """Look for nothing any more."""
        self._search = self._next = None

    def go_on(self) -> list[Closure]:
        """Take the search a step further; gives what `find` does once it is through, nothing before."""
        if self._search is None:
            return []
        try:
            next(self._search)
        except StopIteration as end:
            self._search = None if self._next is None else self._searching(*self._next)
            self._next = None
            found: list[Closure] = end.value
            return found
        return []

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
        search = self._searching(source, nodes)
        while True:
            try:
                next(search)
            except StopIteration as end:
                found: list[Closure] = end.value
                return found

    def _searching(self, source: Submap, nodes: FloatArray) -> _Search:
        """Search step by step."""
        config = self.verifier.config
        window = SearchWindow(math.inf, REACH_M, math.pi, is_full_circle=True)
        best = 0.0
        found: list[tuple[float, Submap, FloatArray]] = []
        for k, target in enumerate(self.targets, start=1):
            centre = np.array([*target.centre, 0.0])
            needed = max(config.min_score, config.max_ambiguity * best)
            score, pose = self.verifier.best_pose(target, source, centre, window, needed)
            if score > 0.0:
                best = max(best, score)
                found.append((score, target, pose))
            if k % self.n_at_once == 0:
                yield
        found.sort(key=lambda one: -one[0])
        first = {target.number: rank for rank, (_, target, _) in enumerate(found)}
        self.targets = sorted(self.targets, key=lambda target: first.get(target.number, len(first)))
        places = np.empty((0, 3))
        closures: list[Closure] = []
        for score, target, pose in found:
            place = se2.compose(nodes[target.anchor], pose)
            near_m, near_rad = config.relocalization.same_place_m, config.relocalization.same_place_rad
            if score < config.max_ambiguity * best or _is_near(places, place, near_m, near_rad).any():
                continue
            if len(places) == MOST_PLACES:
                return []
            yield
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
