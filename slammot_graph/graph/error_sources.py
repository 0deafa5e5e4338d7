"""Covariances of a pose graph's solution by where the errors of its factors come from.

The graph weighs its factors as if their errors were independent, each with a cautious covariance. They are not: a
match is made on points of earlier keyframes and inherits their errors, so that factors about one anchor share the
anchor's error, and the next anchor's error takes part of it back. A local map drifts far less than a chain of
independent factors would, and a pose and its anchor do not err independently. The solution stays what it is; here the
errors' sources (the noise of each match and each odometry step, and what all odometry steps have in common) are
propagated through the matching and then through the weighted least squares, to first order.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.graph.common_errors import N_PARAMETERS

_HELD = 1e8
_BARELY = 1e-6
N_NEIGHBOURS = 4
"""Matches of so many nodes in a row see the same lines, the first and the last of them hardly any."""

_AT_ONCE = 100
"""Nodes whose covariances are solved for at once."""


class NodeError(NamedTuple):
    """How the error of a node in the local frame comes about; all are right perturbations (body frames).

    The match errs by ``sum(gains[m] error(nodes[m])) + root noise + common_root common``, the node by ``share`` of that
    and by what is left of the odometry's motion from the node before. `noise` is the node's own, `common` a mean over
    the latest nodes' (times the root of their number): neighbours see the same lines.

    Attributes
    ----------
    nodes : (k,) int array
        Whose points the match was made on.
    gains : (k, 3, 3) array
        What an error of each does to the match.
    root : (3, 3) array
        Square root of the covariance of the match's own noise.
    common_root : (3, 3) array
        The same of what it shares with its neighbours.
    share : (3, 3) array
        How much of the match's error the node takes on; the rest of it is the odometry's.
    carried : (3, 3) array
        How much it takes on of the motion from the node before.
    T_last_node : (3,) array
        That motion.
    odometry_root : (3, 3) array
        Square root of its covariance.
    """

    nodes: IntArray
    gains: FloatArray
    root: FloatArray
    common_root: FloatArray
    share: FloatArray
    carried: FloatArray
    T_last_node: FloatArray
    odometry_root: FloatArray


class _Blocks:
    """A sparse matrix, put together of dense blocks."""

    def __init__(self) -> None:
        self._rows = list[IntArray]()
        self._columns = list[IntArray]()
        self._values = list[FloatArray]()

    def add(self, row: int, column: int, block: FloatArray) -> None:
        rows, columns = np.indices(block.shape)
        self._rows.append((row + rows).ravel())
        self._columns.append((column + columns).ravel())
        self._values.append(block.ravel())

    def matrix(self, n_rows: int, n_columns: int) -> sparse.csc_matrix:
        if not self._rows:
            return sparse.csc_matrix((n_rows, n_columns))
        where = np.concatenate(self._rows), np.concatenate(self._columns)
        return sparse.csc_matrix((np.concatenate(self._values), where), shape=(n_rows, n_columns))


def solution_covariances(
    nodes: FloatArray,
    edges: Sequence[GraphEdge],
    of_nodes: Mapping[int, NodeError],
    common: Mapping[int, FloatArray],
    asked: IntArray,
    odometry_scale: float = 1.0,
    closure_covs: Mapping[GraphEdge, FloatArray] = MappingProxyType({}),
) -> FloatArray:
    """Covariances (m, 3, 3) of nodes that are asked for (m,), right perturbation (body frames).

    Parameters
    ----------
    nodes : (n, 3) array
        Optimised poses; the first one is held.
    edges : sequence of GraphEdge
        Those whose errors' sources are not known err independently of each other, as their information says.
    of_nodes : mapping of int to NodeError
        A node that has none, as the first one of a local map, has no error in the local frame.
    common : mapping of int to (3, 4) array
        See `graph.common_errors.solution_errors`.
    asked : (m,) int array
    odometry_scale : float
        The odometry's own noise has this variance, as a share of what `NodeError` and information say.
    closure_covs : mapping of GraphEdge to (3, 3) array
        Of the noise of closures whose local maps are rigid; how far these are deformed is added.
    """
    n, odometry = len(nodes), np.sqrt(odometry_scale)
    # columns of the sources: noise of each match, what neighbours share, each odometry step, each other edge, common
    at_neighbours, at_steps, at_others = 3 * n, 6 * n, 9 * n
    at_common = at_others + 3 * len(edges)
    drift, local = _Blocks(), _Blocks()
    for node, error in of_nodes.items():
        for other, gain in zip(error.nodes.tolist(), error.gains, strict=True):
            drift.add(3 * node, 3 * other, error.share @ gain)
        local.add(3 * node, 3 * node, error.share @ error.root)
        for neighbour in _neighbours(node):
            local.add(3 * node, at_neighbours + 3 * neighbour, error.share @ error.common_root)
        if error.carried.any():
            drift.add(3 * node, 3 * (node - 1), error.carried @ _onto(error.T_last_node))
            local.add(3 * node, at_steps + 3 * node, odometry * error.carried @ error.odometry_root)
            if node in common:
                local.add(3 * node, at_common, error.carried @ common[node])
    members = {
        int(error.nodes[0]): [*error.nodes.tolist(), k] for k, error in of_nodes.items() if len(error.nodes)
    }
    jacobian, weights, of_local, direct = _Blocks(), _Blocks(), _Blocks(), _Blocks()
    for k, edge in enumerate(edges):
        i, j, row = edge.from_node, edge.to_node, 3 * k
        backward = -se2.adjoint(se2.between(nodes[j], nodes[i]))
        jacobian.add(row, 3 * i, backward)
        jacobian.add(row, 3 * j, np.eye(3))
        weights.add(row, row, edge.information)
        known = of_nodes.get(j)
        if edge.kind == "odometry" and j in common:
            direct.add(row, at_common, common[j])
        if edge.kind == "match" and known is not None and i in known.nodes:
            for other, gain in zip(known.nodes.tolist(), known.gains, strict=True):
                of_local.add(row, 3 * other, gain)
            of_local.add(row, 3 * i, backward)
            direct.add(row, 3 * j, known.root)
            for neighbour in _neighbours(j):
                direct.add(row, at_neighbours + 3 * neighbour, known.common_root)
        elif edge.kind == "odometry" and known is not None and i == j - 1:
            direct.add(row, at_steps + 3 * j, odometry * known.odometry_root)
        else:
            cov = closure_covs.get(edge)
            if cov is None:
                root = _root_of_inverse(edge.information)
            else:
                residual = se2.log(se2.between(edge.T_from_to, se2.between(nodes[i], nodes[j])))
                root = np.linalg.cholesky(_widened(cov, residual, edge.information))
            direct.add(row, at_others + row, root)
            if cov is not None:
                for anchor, sign in ((i, 1.0), (j, -1.0)):
                    _add_deformation(of_local, row, nodes, members.get(anchor), anchor, j, sign)
    n_rows, n_sources = 3 * len(edges), at_common + N_PARAMETERS
    J, W = jacobian.matrix(n_rows, 3 * n), weights.matrix(n_rows, n_rows)
    Z, D, U = of_local.matrix(n_rows, 3 * n), direct.matrix(n_rows, n_sources), local.matrix(3 * n, n_sources)
    WJ = W @ J
    hold = sparse.diags(np.where(np.arange(3 * n) < 3, _HELD, _BARELY))
    solution = splu((J.T @ WJ + hold).tocsc())
    drift_of = splu(
        (sparse.identity(3 * n) - drift.matrix(3 * n, 3 * n)).tocsc(),
        permc_spec="NATURAL",
        diag_pivot_thresh=0.0,
    )
    covs = np.empty((len(asked), 3, 3))
    for first in range(0, len(asked), _AT_ONCE):
        some = asked[first : first + _AT_ONCE]
        columns = (3 * some[:, None] + np.arange(3)).ravel()
        unit = np.zeros((3 * n, len(columns)))
        unit[columns, np.arange(len(columns))] = 1.0
        of_edges = WJ @ solution.solve(unit)
        of_sources = U.T @ drift_of.solve(np.ascontiguousarray(Z.T @ of_edges), trans="T") + D.T @ of_edges
        parts = of_sources.reshape(n_sources, len(some), 3)
        covs[first : first + len(some)] = np.einsum("smi,smj->mij", parts, parts)
    return covs


def _widened(cov: FloatArray, residual: FloatArray, information: FloatArray) -> FloatArray:
    """Covariance (3, 3) of a closure by what its residual (3,) shows, too, where that is larger than expected.

    The residual stands for the error, as in the heteroscedasticity-consistent covariance of White (1980): the match of
    two local maps that hardly overlap may be wrong by far more than its noise.
    """
    squared = float(residual @ information @ residual)
    excess = 1.0 - 3.0 / max(squared, 3.0)
    return np.asarray(cov + excess * np.outer(residual, residual))


def _neighbours(node: int) -> range:
    return range(max(node - N_NEIGHBOURS + 1, 0), node + 1)


def _add_deformation(
    of_local: _Blocks,
    row: int,
    nodes: FloatArray,
    members: Sequence[int] | None,
    anchor: int,
    node: int,
    sign: float,
) -> None:
    """Add how a local map of these nodes lies to its anchor, in the body frame of a node: the mean of their errors."""
    if members is None:
        return
    for other in members:
        onto = se2.adjoint(se2.between(nodes[node], nodes[other]))
        of_local.add(row, 3 * other, sign / len(members) * onto)
    of_local.add(row, 3 * anchor, -sign * se2.adjoint(se2.between(nodes[node], nodes[anchor])))


def _onto(T_last_node: FloatArray) -> FloatArray:
    """(3, 3) what an error of the node before is in the body frame of the next one."""
    return se2.adjoint(se2.inverse(T_last_node))


def _root_of_inverse(information: FloatArray) -> FloatArray:
    """(3, 3) square root of the covariance, zero in directions without information."""
    values, vectors = np.linalg.eigh(information)
    is_known = values > 1e-12 * values[-1]
    root: FloatArray = vectors * np.where(is_known, 1.0 / np.sqrt(np.where(is_known, values, 1.0)), 0.0)
    return root
