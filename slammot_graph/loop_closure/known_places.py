"""Places that the robot has been to many times: what it drives there again is tied to them alone.

A lap in known places is tied to them by a closure for each local map, and to itself by the odometry and the matches
from node to node. Solved for, these ties make the poses of all places of a lap depend on each other directly: with each
lap the graph takes more memory and each update more time, without end. What the ties tell of a place is soon no news.
So where a place has been seen often enough they are cut, one local map after the other, once that local map lies a
while back: what is known gets less by what they told, which errs on the safe side.
"""

from collections import Counter, deque

from slammot_graph.core.results import GraphEdge
from slammot_graph.graph import PoseGraph
from slammot_graph.loop_closure.closure import Closure
from slammot_graph.loop_closure.submap import Submap

MIN_VISITS = 40
"""So often a place has been seen again before anything is cut there."""

N_RECENT = 4
"""The latest so many local maps stay tied: closures are judged by them."""


class KnownPlaces:
    """Counts how often places are seen again, and cuts.

    Attributes
    ----------
    visits : counter
        Accepted closures with each anchor of an earlier local map.
    submaps : list of Submap or None
        Those that showed a known place, of a run that started from a saved map.
    """

    def __init__(self, graph: PoseGraph) -> None:
        self.visits: Counter[int] = Counter()
        self.submaps: list[Submap] | None = None
        self._graph = graph
        self._recent: deque[int] = deque()

    def settle(self, anchor: int, accepted: list[tuple[Closure, GraphEdge]]) -> None:
        """Take in the anchor of a local map that has just been found in a known place; cut at an earlier one.

        Each node stays tied to an earlier one: that at the cut by its closure, which is final from then on and leaves
        `accepted`; the later ones by the odometry from it.
        """
        self._recent.append(anchor)
        while len(self._recent) > N_RECENT:
            at = self._recent.popleft()
            own = [closure for closure, _ in accepted if closure.source.anchor == at]
            if not any(self.visits[closure.target.anchor] > MIN_VISITS for closure in own):
                continue
            self._graph.remove_edges(
                [
                    edge
                    for edge in self._graph.edges
                    if edge.kind != "closure" and edge.from_node < at <= edge.to_node
                ]
            )
            accepted[:] = [pair for pair in accepted if pair[0].source.anchor != at]
