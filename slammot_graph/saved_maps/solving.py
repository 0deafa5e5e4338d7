"""The graph of a saved map, solved until its nodes rest."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph

MOST_STEPS = 10
REST_M, REST_RAD = 1e-4, 1e-4


def settle(graph: PoseGraph) -> FloatArray:
    """Linearise anew at the solution until no node moves any more; gives the poses (n, 3)."""
    nodes = graph.poses()
    for _ in range(MOST_STEPS):
        graph.rebuild(nodes)
        before, nodes = nodes, graph.poses()
        moved = se2.between(before, nodes)
        if np.hypot(moved[:, 0], moved[:, 1]).max() < REST_M and np.abs(moved[:, 2]).max() < REST_RAD:
            break
    return nodes
