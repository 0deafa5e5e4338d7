"""Where in a whole saved map a local map lies, with no guess: branch and bound over all of its local maps at once."""

import math
from dataclasses import dataclass, field

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

_WINDOW = SearchWindow(math.inf, REACH_M, math.pi, is_full_circle=True)


@dataclass(eq=False)
class _Search:
    """How far the search for a local map has come: plain state, which a checkpoint of the run can hold.

    Attributes
    ----------
    n_looked_at : int
        Targets that were looked at.
    best : float
        Share of the best possible score that the best of them reaches.
    found : list of (score, Submap, (3,) array)
        Those that agree, and with which pose; once all were looked at the best first, less those dealt with.
    places : (k, 3) array
        Different places among them so far.
    candidate : (Submap, (3,) array) or None
        The one to be verified next.
    is_of_map : bool
        The local map is one of those that are looked at: it is looked for where it does not lie.
    """

    source: Submap
    nodes: FloatArray
    is_of_map: bool = False
    n_looked_at: int = 0
    best: float = 0.0
    found: list[tuple[float, Submap, FloatArray]] = field(default_factory=list)
    places: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    candidate: tuple[Submap, FloatArray] | None = None
    closures: list[Closure] = field(default_factory=list)


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
    repeats : dict of int to (k, 3) array
        Number of a local map of the map, and the transforms that move it onto other places which look like its own.
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
        self.repeats: dict[int, FloatArray] = {}
        self._search: _Search | None = None
        self._next: _Search | None = None
        verifier.n_prepared = max(verifier.n_prepared, min(len(self.targets) + 2, 512))

    @property
    def is_searching(self) -> bool:
        """Whether a search is under way."""
        return self._search is not None

    def request(self, source: Submap, nodes: FloatArray) -> None:
        """Let a local map be looked for, after the one that is; of several that wait the last one counts."""
        search = _Search(source, nodes)
        if self._search is None:
            self._search = search
        else:
            self._next = search

    def request_repeats(self, source: Submap, nodes: FloatArray) -> None:
        """Let a local map of the map be looked for elsewhere in it, before all else, for `repeats`."""
        if self._search is not None:
            self._next = self._search
        self._search = _Search(source, nodes, is_of_map=True)

    def forget(self) -> None:
        """Look for nothing any more."""
        self._search = self._next = None

    def go_on(self) -> list[Closure]:
        """Take the search a step further; gives what `find` does once it is through, nothing before."""
        search = self._search
        if search is None or not self._advance(search):
            return []
        self._search, self._next = self._next, None
        if search.is_of_map:
            self.repeats[search.source.number] = self._moves(search)
            return []
        return search.closures

    def _moves(self, search: _Search) -> FloatArray:
        """(k, 3) transforms that move a local map of the map onto the places that were found, less its own."""
        config = self.verifier.config.relocalization
        T = np.array([hypothesis_of(closure, search.nodes).T_map_new for closure in search.closures])
        lies = search.nodes[search.source.anchor]
        moved = se2.compose(T.reshape(-1, 3), lies[None, :])
        return T.reshape(-1, 3)[~_is_near(moved, lies, config.same_place_m, config.same_place_rad)]

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
        search = _Search(source, nodes)
        while not self._advance(search):
            pass
        return search.closures

    def _advance(self, search: _Search) -> bool:
        """Look at a few targets, or verify a candidate; tells whether the search is through."""
        if search.candidate is not None:
            self._verify(search, *search.candidate)
        elif self._look(search):
            return False
        else:
            self._rank(search)
        return not self._choose(search)

    def _look(self, search: _Search) -> bool:
        """Look at the next targets; tells whether these were as many as are looked at in a step."""
        config = self.verifier.config
        for target in self.targets[search.n_looked_at :]:
            centre = np.array([*target.centre, 0.0])
            needed = max(config.min_score, config.max_ambiguity * search.best)
            lies = se2.between(search.nodes[target.anchor], search.nodes[search.source.anchor])
            excluded = lies if search.is_of_map else None
            score, pose = self.verifier.best_pose(target, search.source, centre, _WINDOW, needed, excluded)
            if score > 0.0:
                search.best = max(search.best, score)
                search.found.append((score, target, pose))
            search.n_looked_at += 1
            if search.n_looked_at % N_AT_ONCE == 0:
                return True
        return False

    def _rank(self, search: _Search) -> None:
        """Put what agrees best first, here and for the next search."""
        search.found.sort(key=lambda one: -one[0])
        first = {target.number: rank for rank, (_, target, _) in enumerate(search.found)}
        self.targets = sorted(self.targets, key=lambda target: first.get(target.number, len(first)))

    def _choose(self, search: _Search) -> bool:
        """Choose the next candidate to verify; tells whether there is one."""
        config = self.verifier.config
        near_m, near_rad = config.relocalization.same_place_m, config.relocalization.same_place_rad
        while search.found:
            score, target, pose = search.found.pop(0)
            place = se2.compose(search.nodes[target.anchor], pose)
            if (
                score < config.max_ambiguity * search.best
                or _is_near(search.places, place, near_m, near_rad).any()
            ):
                continue
            if len(search.places) == MOST_PLACES:
                search.closures = []
                return False
            search.places = np.vstack([search.places, place])
            search.candidate = target, pose
            return True
        return False

    def _verify(self, search: _Search, target: Submap, pose: FloatArray) -> None:
        search.candidate = None
        if search.is_of_map:
            closure = self.verifier.check(target, search.source, pose)
        else:
            closure = self.verifier.verify(target, search.source, pose, _WINDOW)
        if isinstance(closure, Closure) and (search.is_of_map or self._is_expected(closure, search.nodes)):
            search.closures.append(closure)

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
