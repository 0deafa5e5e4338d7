"""What errors that the odometry's factors have in common do to the solution of a pose graph.

A wheel that is 0.5% smaller than the calibration says errs by 0.5% of the way, not of its square root: over n equal
steps the variance grows with n^2, where that of independent errors grows with n, as a pose graph takes its factors. So
the parameters are "considered" (Schmidt 1966): estimated elsewhere, their errors propagated through the weighted least
squares, whose solution stays what it is.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph.normal_equations import NormalEquations

N_PARAMETERS = 4
"""Scale of the distance, direction, heading bias and heading scale."""


def common_error(increment: FloatArray, stds: FloatArray) -> FloatArray:
    """(3, 4) errors of the odometry's motion (3,) by one standard deviation (4,) of each parameter.

    Right perturbations, body frame at its end.
    """
    x, y, turn = increment.tolist()
    c, s = math.cos(turn), math.sin(turn)
    x, y = c * x + s * y, c * y - s * x
    jacobian = np.array([[x, -y, 0.0, 0.0], [y, x, 0.0, 0.0], [0.0, 0.0, math.hypot(x, y), turn]])
    return np.asarray(jacobian * stds)


def solution_errors(
    nodes: FloatArray,
    edges: Sequence[GraphEdge],
    errors: Mapping[int, FloatArray],
    first_nodes: Sequence[int] = (0,),
) -> FloatArray:
    """Errors (n, 3, 4 r) of the solution by one standard deviation of each parameter of r runs, right perturbation.

    Parameters
    ----------
    nodes : (n, 3) array
        Optimised poses; the first one is held.
    edges : sequence of GraphEdge
    errors : mapping of int to (3, 4) array
        Of the odometry's factor that leads to a node, see `common_error`.
    first_nodes : sequence of int
        Where each run begins: its parameters are its own, and make the next four columns.
    """
    n, n_columns = len(nodes), N_PARAMETERS * len(first_nodes)
    if n == 0 or not errors:
        return np.zeros((n, 3, n_columns))
    by_runs = np.zeros((len(edges), 3, len(first_nodes), N_PARAMETERS))
    runs = np.searchsorted(first_nodes, [edge.to_node for edge in edges], side="right") - 1
    for k, edge in enumerate(edges):
        if edge.kind == "odometry" and edge.to_node in errors:
            by_runs[k, :, runs[k]] = errors[edge.to_node]
    return NormalEquations(nodes, edges).node_errors(by_runs.reshape(len(edges), 3, n_columns))
