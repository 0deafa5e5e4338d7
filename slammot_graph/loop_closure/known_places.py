"""Places that the robot has been to many times: what it drives there again is merged into them.

A lap in known places is tied to them by a closure for each local map, and to itself by the odometry and the matches
from node to node. Solved for, these ties make the poses of all places of a lap depend on each other directly: with each
lap the graph takes more memory and each update more time, without end. What the ties tell of a place is soon no news.
So where a place has been seen often enough, and once a local map that shows it lies a while back, the nodes of this
local map are merged into it, as they lie to it by all that was known until then: they are solved for no more. What is
known of the place gets less by what they told, which errs on the safe side.
"""

import math
from collections import Counter, deque
from collections.abc import Collection

from slammot_graph.core.results import GraphEdge
from slammot_graph.graph import PoseGraph
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.submap import Submap

MIN_VISITS = 6
"""So often the robot has come back to a place before anything is merged there (by its path intel at most 5
times, aces 2)."""

AWAY_M = 20.0
"""It has come back if it has driven this far since the place was last seen: that it stays there is no news."""

N_RECENT = 4
"""The latest so many local maps are not merged: closures are judged by them."""

Accepted = list[tuple[Closure, GraphEdge]]


class KnownPlaces:
    """Counts how often places are seen again, and merges.

    Attributes
    ----------
    visits : counter
        How often the robot has come back to each anchor of an earlier local map.
    submaps : list of Submap or None
        Those that showed a known place, of a run that started from a saved map.
    """

    def __init__(self, graph: PoseGraph) -> None:
        self.visits: Counter[int] = Counter()
        self._seen_at_m: dict[int, float] = {}
        self.submaps: list[Submap] | None = None
        self._graph = graph
        self._recent: deque[int] = deque()
        self._cut: tuple[int, int] | None = None

    def see(self, closure: Closure) -> None:
        """Take in an accepted closure."""
        anchor, path_m = closure.target.anchor, closure.source.path_m
        self.visits[anchor] += path_m - self._seen_at_m.get(anchor, -math.inf) > AWAY_M
        self._seen_at_m[anchor] = path_m

    def settle(self, anchor: int, accepted: Accepted, targets: Collection[int] = ()) -> None:
        """Take in the anchor of a local map that has just been found in a known place; merge at an earlier one.

        There the graph is cut: what lies between two cuts is tied by closures alone, which leave `accepted` as they are
        final, and is merged where no local map begins that others are compared with (anchors `targets`). The node at
        the latest cut is tied by its own closure.
        """
        self._recent.append(anchor)
        while len(self._recent) > N_RECENT:
            at = self._recent.popleft()
            own = [closure for closure, _ in accepted if closure.source.anchor == at]
            known = [closure for closure in own if self.visits[closure.target.anchor] > MIN_VISITS]
            if not known:
                continue
            merged = range(0)
            if self._cut is not None and not any(self._cut[0] <= target < at for target in targets):
                merged = range(self._cut[0], at)
            onto = known[0].target.anchor if self._cut is None else self._cut[1]
            if not self._graph.merge(merged, onto, at):
                continue
            accepted[:] = [
                pair
                for pair in accepted
                if pair[0].source.anchor != at and pair[0].source.anchor not in merged
            ]
            self._cut = at, known[0].target.anchor
