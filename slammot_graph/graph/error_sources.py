"""Covariances of a pose graph's solution by where the errors of its factors come from.

The graph weighs its factors as if their errors were independent, each with a cautious covariance. They are not: a
match is made on points of earlier keyframes and inherits their errors, so that factors about one anchor share the
anchor's error, and the next anchor's error takes part of it back. A local map drifts far less than a chain of
independent factors would, and a pose and its anchor do not err independently. The solution stays what it is; here the
errors' sources (the noise of each match and each odometry step, and what all odometry steps have in common) are
propagated through the matching and then through the weighted least squares, to first order.
"""

import math
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
from slammot_graph.graph.normal_equations import NormalEquations

N_NEIGHBOURS = 2
"""Matches of so many nodes in a row see the same lines."""

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
    propagated : (3, 3) array
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
    propagated: FloatArray
    T_last_node: FloatArray
    odometry_root: FloatArray


class _Blocks:
    """A sparse matrix, put together of dense blocks of three rows."""

    def __init__(self) -> None:
        self._of_width: dict[int, list[tuple[int, int, FloatArray]]] = {}

    def add(self, row: int, column: int, block: FloatArray) -> None:
        self._of_width.setdefault(block.shape[1], []).append((row, column, block))

    def matrix(self, n_rows: int, n_columns: int) -> sparse.csc_matrix:
        whole = sparse.csc_matrix((n_rows, n_columns))
        for width, added in self._of_width.items():
            first_row, first_column, blocks = (np.array(part) for part in zip(*added, strict=True))
            rows = np.broadcast_to(first_row[:, None, None] + np.arange(3)[:, None], blocks.shape)
            columns = np.broadcast_to(first_column[:, None, None] + np.arange(width), blocks.shape)
            where = rows.ravel(), columns.ravel()
            whole = whole + sparse.csc_matrix((blocks.ravel(), where), shape=(n_rows, n_columns))
        return whole


class _Columns(NamedTuple):
    """Where the sources' columns begin: noise of each match, what neighbours share, odometry, other edges, common."""

    n: int
    n_edges: int

    @property
    def neighbours(self) -> int:
        return 3 * self.n

    @property
    def steps(self) -> int:
        return 6 * self.n

    @property
    def others(self) -> int:
        return 9 * self.n

    @property
    def common(self) -> int:
        return 9 * self.n + 3 * self.n_edges

    @property
    def total(self) -> int:
        return self.common + N_PARAMETERS


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
    n, columns = len(nodes), _Columns(len(nodes), len(edges))
    of_nodes = {
        k: e._replace(odometry_root=math.sqrt(odometry_scale) * e.odometry_root) for k, e in of_nodes.items()
    }
    equations = NormalEquations(nodes, edges)
    roots: dict[int, FloatArray] = {}
    for k, edge in enumerate(edges):
        cov = closure_covs.get(edge)
        if cov is not None:
            widened = _widened(cov, edge, nodes, equations.covariance_of_edge(k))
            roots[k] = np.asarray(np.linalg.cholesky(widened))
    drift, U = _local_errors(of_nodes, common, columns)
    drift_of = splu(drift.T.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0)
    Z, D = _edge_errors(nodes, edges, of_nodes, common, roots, columns)
    covs = np.empty((len(asked), 3, 3))
    for first in range(0, len(asked), _AT_ONCE):
        some = asked[first : first + _AT_ONCE]
        unit = np.zeros((n, 3, 3 * len(some)))
        unit[np.repeat(some, 3), np.tile(np.arange(3), len(some)), np.arange(3 * len(some))] = 1.0
        of_edges = equations.weights(unit).reshape(3 * len(edges), 3 * len(some))
        of_sources = U.T @ drift_of.solve(np.ascontiguousarray(Z.T @ of_edges)) + D.T @ of_edges
        parts = of_sources.reshape(columns.total, len(some), 3)
        covs[first : first + len(some)] = np.einsum("smi,smj->mij", parts, parts)
    return covs


def _local_errors(
    of_nodes: Mapping[int, NodeError], common: Mapping[int, FloatArray], columns: _Columns
) -> tuple[sparse.csc_matrix, sparse.csc_matrix]:
    """Matrices M and U of the nodes' errors e in the local frame by the sources u: ``M e = U u``."""
    inherited, sources = _Blocks(), _Blocks()
    for node, error in of_nodes.items():
        row = 3 * node
        for other, gain in zip(error.nodes.tolist(), error.gains, strict=True):
            inherited.add(row, 3 * other, error.share @ gain)
        _add_noise(sources, row, node, error, error.share, columns)
        if error.propagated.any():
            inherited.add(row, row - 3, error.propagated @ se2.adjoint(se2.inverse(error.T_last_node)))
            sources.add(row, columns.steps + row, error.propagated @ error.odometry_root)
            if node in common:
                sources.add(row, columns.common, error.propagated @ common[node])
    size = 3 * columns.n
    M = (sparse.identity(size) - inherited.matrix(size, size)).tocsc()
    return M, sources.matrix(size, columns.total)


def _edge_errors(
    nodes: FloatArray,
    edges: Sequence[GraphEdge],
    of_nodes: Mapping[int, NodeError],
    common: Mapping[int, FloatArray],
    closure_roots: Mapping[int, FloatArray],
    columns: _Columns,
) -> tuple[sparse.csc_matrix, sparse.csc_matrix]:
    """Matrices Z and D of the edges' errors z by the nodes' in the local frame and the sources: ``z = Z e + D u``."""
    of_local, direct = _Blocks(), _Blocks()
    members = {int(e.nodes[0]): [*e.nodes.tolist(), k] for k, e in of_nodes.items() if len(e.nodes)}
    for k, edge in enumerate(edges):
        i, j, row, known = edge.from_node, edge.to_node, 3 * k, of_nodes.get(edge.to_node)
        if edge.kind == "odometry" and j in common:
            direct.add(row, columns.common, common[j])
        if edge.kind == "match" and known is not None and i in known.nodes:
            for other, gain in zip(known.nodes.tolist(), known.gains, strict=True):
                of_local.add(row, 3 * other, gain)
            of_local.add(row, 3 * i, -se2.adjoint(se2.between(nodes[j], nodes[i])))
            _add_noise(direct, row, j, known, np.eye(3), columns)
        elif edge.kind == "odometry" and known is not None and i == j - 1:
            direct.add(row, columns.steps + 3 * j, known.odometry_root)
        elif k in closure_roots:
            direct.add(row, columns.others + row, closure_roots[k])
            _add_deformation(of_local, row, nodes, members.get(i), i, j, 1.0)
            _add_deformation(of_local, row, nodes, members.get(j), j, j, -1.0)
        else:
            direct.add(row, columns.others + row, _root_of_inverse(edge.information))
    n_rows = 3 * len(edges)
    return of_local.matrix(n_rows, 3 * columns.n), direct.matrix(n_rows, columns.total)


def _add_noise(
    sources: _Blocks, row: int, node: int, error: NodeError, share: FloatArray, columns: _Columns
) -> None:
    """Add a share (3, 3) of a match's own noise, and of what it shares with its neighbours."""
    sources.add(row, 3 * node, share @ error.root)
    for neighbour in range(max(node - N_NEIGHBOURS + 1, 0), node + 1):
        sources.add(row, columns.neighbours + 3 * neighbour, share @ error.common_root)


def _widened(cov: FloatArray, edge: GraphEdge, nodes: FloatArray, of_solution: FloatArray) -> FloatArray:
    """Covariance (3, 3) of a closure by what it is off the solution without it, too, where that is unexpected.

    That stands for its error, as in the heteroscedasticity-consistent covariance of MacKinnon and White (1985): the
    match of two local maps that hardly overlap may be wrong by far more than its noise. `of_solution` (3, 3) is the
    covariance of the solution's relative pose, as the graph has it.
    """
    residual = se2.log(se2.between(edge.T_from_to, se2.between(nodes[edge.from_node], nodes[edge.to_node])))
    left = np.eye(3) - of_solution @ edge.information
    try:
        error = np.linalg.solve(left, residual)  # of the solution without it
    except np.linalg.LinAlgError:
        return cov  # nothing else ties these nodes
    squared = float(residual @ edge.information @ error)
    return np.asarray(cov + (1.0 - 3.0 / max(squared, 3.0)) * np.outer(error, error))


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


def _root_of_inverse(information: FloatArray) -> FloatArray:
    """(3, 3) square root of the covariance, zero in directions without information."""
    values, vectors = np.linalg.eigh(information)
    is_known = values > 1e-12 * values[-1]
    root: FloatArray = vectors * np.where(is_known, 1.0 / np.sqrt(np.where(is_known, values, 1.0)), 0.0)
    return root
