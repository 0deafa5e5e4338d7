"""What errors that the odometry's factors have in common do to the solution of a pose graph.

A wheel that is 0.5% smaller than the calibration says errs by 0.5% of the way, not of its square root: over n equal
steps the variance grows with n^2, where that of independent errors grows with n, as a pose graph takes its factors. So
the parameters are "considered" (Schmidt 1966): estimated elsewhere, their errors propagated through the weighted least
squares, whose solution stays what it is.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray

N_PARAMETERS = 4
"""Scale of the distance, direction, heading bias and heading scale."""

_HELD = 1e8


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
    i = np.array([edge.from_node for edge in edges])
    j = np.array([edge.to_node for edge in edges])
    W = np.array([edge.information for edge in edges])
    A = -se2.adjoint(se2.between(nodes[j], nodes[i]))
    AW = np.swapaxes(A, 1, 2) @ W
    by_runs = np.zeros((len(edges), 3, len(first_nodes), N_PARAMETERS))
    runs = np.searchsorted(first_nodes, j, side="right") - 1
    for k, edge in enumerate(edges):
        if edge.kind == "odometry" and edge.to_node in errors:
            by_runs[k, :, runs[k]] = errors[edge.to_node]
    b = by_runs.reshape(len(edges), 3, n_columns)
    held = np.zeros(1, dtype=np.int64)
    rows = np.concatenate([i, i, j, j, held])
    columns = np.concatenate([i, j, i, j, held])
    blocks = np.concatenate([AW @ A, AW, W @ A, W, _HELD * np.eye(3)[None]])
    index = np.arange(3)
    H = sparse.coo_matrix(
        (
            blocks.ravel(),
            (
                np.broadcast_to(3 * rows[:, None, None] + index[None, :, None], blocks.shape).ravel(),
                np.broadcast_to(3 * columns[:, None, None] + index[None, None, :], blocks.shape).ravel(),
            ),
        ),
        shape=(3 * n, 3 * n),
    ).tocsc()
    H = H + 1e-6 * sparse.identity(3 * n, format="csc")
    g = np.zeros((n, 3, n_columns))
    np.add.at(g, i, AW @ b)
    np.add.at(g, j, W @ b)
    return np.asarray(splu(H).solve(g.reshape(3 * n, n_columns)).reshape(n, 3, n_columns))
