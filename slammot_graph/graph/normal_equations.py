"""The weighted least squares of a pose graph, linearised at its solution: what errors of its edges do to its nodes."""

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray

_HELD, _BARELY = 1e8, 1e-6
"""Information on the first node, which does not move, and on all others, that no direction be free."""


class NormalEquations:
    """``J' W J x = J' W z`` for errors z of the edges, right perturbations (body frames of the later nodes).

    Parameters
    ----------
    nodes : (n, 3) array
        Optimised poses; the first one is held.
    edges : sequence of GraphEdge
    """

    def __init__(self, nodes: FloatArray, edges: Sequence[GraphEdge]) -> None:
        n = len(nodes)
        self._n = n
        self._i = i = np.array([edge.from_node for edge in edges], dtype=np.int64)
        self._j = j = np.array([edge.to_node for edge in edges], dtype=np.int64)
        self._W = W = np.array([edge.information for edge in edges]).reshape(-1, 3, 3)
        self._A = A = -se2.adjoint(se2.between(nodes[j], nodes[i]))
        self._AW = AW = np.swapaxes(A, 1, 2) @ W
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
        self._factor = splu(H + _BARELY * sparse.identity(3 * n, format="csc"))

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for several right sides (n, 3, m) at once."""
        return np.asarray(self._factor.solve(right.reshape(3 * self._n, -1)).reshape(right.shape))

    def node_errors(self, edge_errors: FloatArray) -> FloatArray:
        """Errors (n, 3, m) of the nodes by errors (e, 3, m) of the edges."""
        right = np.zeros((self._n, 3, edge_errors.shape[2]))
        np.add.at(right, self._i, self._AW @ edge_errors)
        np.add.at(right, self._j, self._W @ edge_errors)
        return self.solve(right)

    def weights(self, asked: FloatArray) -> FloatArray:
        """How much each edge's error (e, 3, m) counts in combinations (n, 3, m) of the nodes' errors."""
        x = self.solve(asked)
        return np.asarray(self._W @ (self._A @ x[self._i] + x[self._j]))

    def covariance_of_edge(self, k: int) -> FloatArray:
        """Covariance (3, 3) of the relative pose of edge k as solved, all edges erring as their information says."""
        i, j = self._i[k], self._j[k]
        right = np.zeros((self._n, 3, 3))
        right[i] = self._A[k].T
        right[j] = np.eye(3)
        x = self.solve(right)
        return np.asarray(self._A[k] @ x[i] + x[j])
