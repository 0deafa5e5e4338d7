"""How the errors of the graph's nodes come about: by their matches, on the points of earlier nodes; see `NodeError`."""

import math
from collections.abc import Sequence

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray
from slammot_graph.graph.error_sources import N_NEIGHBOURS, NodeError, solution_covariances
from slammot_graph.mapping.local_map import Keyframe

MOST_NODES = 5000
"""Of a longer run (about 2 kB a node) the sources are forgotten; its covariances are the graph's own, cautious."""

MOST_ASKED = 500
"""Of more nodes the covariances are solved for at every second, third, ... one."""

FEW = 10.0
"""The odometry's covariance counts as so many residuals that are as large as it says."""

_SCALE = np.diag([1.0, 1.0, 0.2])
"""Turns count by what they move at 5 m, where directions are compared."""


class NodeErrors:
    """Where the error of each node comes from."""

    def __init__(self) -> None:
        self.of_nodes: dict[int, NodeError] | None = {}
        self._sum_squares = self._n = FEW

    @property
    def odometry_scale(self) -> float:
        """Variance of the odometry's noise against the matches, over what it is said to be."""
        return self._sum_squares / self._n

    def add(
        self,
        node: int,
        match: MatchResult | None,
        keyframes: Sequence[Keyframe],
        T_local_node: FloatArray,
        T_last_node: FloatArray,
        cov_odometry: FloatArray,
        T_by_matches: FloatArray,
    ) -> None:
        """Add a node, see `node_error`; `T_by_matches` (3,) is its motion from the one before by the matches."""
        if self.of_nodes is None or not keyframes:
            return
        self.of_nodes[node] = error = node_error(match, keyframes, T_local_node, T_last_node, cov_odometry)
        # where the matches tell of the motion the odometry's noise shows; where they do not, both agree
        told = np.eye(3) - error.propagated
        residual = se2.log(se2.between(T_last_node, T_by_matches))
        self._sum_squares += float(residual @ np.linalg.solve(cov_odometry, residual))
        self._n += float(np.trace(told @ told))
        if len(self.of_nodes) > MOST_NODES:
            self.of_nodes = None

    def covariances(
        self,
        nodes: FloatArray,
        edges: Sequence[GraphEdge],
        common: dict[int, FloatArray],
        closure_covs: dict[GraphEdge, FloatArray],
    ) -> FloatArray | None:
        """Covariances (n, 3, 3) of all nodes (n, 3) as optimised, body frames; None where their sources are forgotten.

        `common` are the errors (3, 4) of the odometry's factors by what all have in common, `closure_covs` (3, 3) those
        of closures between rigid local maps.
        """
        if self.of_nodes is None:
            return None
        step = -(-len(nodes) // MOST_ASKED)
        asked = np.arange(0, len(nodes), step)
        scale = self.odometry_scale
        covs = solution_covariances(nodes, edges, self.of_nodes, common, asked, scale, closure_covs)
        latest = np.arange(len(nodes)) // step
        A = se2.adjoint(se2.inverse(se2.between(nodes[asked[latest]], nodes)))
        return np.asarray(A @ covs[latest] @ np.swapaxes(A, 1, 2))


def node_error(
    match: MatchResult | None,
    keyframes: Sequence[Keyframe],
    T_local_node: FloatArray,
    T_last_node: FloatArray,
    cov_odometry: FloatArray,
) -> NodeError:
    """Tell how the error of a node comes about.

    The match gives each keyframe's error the weight of the points that it brought in. Against the odometry it counts
    as its normal equations say.

    Parameters
    ----------
    match : MatchResult or None
    keyframes : sequence of Keyframe
        Of the local map that it was made on. One that is no node has the error of the latest one before it.
    T_local_node : (3,) array
    T_last_node : (3,) array
        The odometry's motion from the node before.
    cov_odometry : (3, 3) array
        Of that, body frame.
    """
    odometry_root = _root(cov_odometry)
    nothing = np.zeros((3, 3))
    unmatched = NodeError(
        np.empty(0, dtype=np.int64),
        np.zeros((0, 3, 3)),
        nothing,
        nothing,
        nothing,
        np.eye(3),
        T_last_node,
        odometry_root,
    )
    if match is None or match.status == "failed" or match.map_scatter is None:
        return unmatched
    values, vectors = np.linalg.eigh(_SCALE @ match.information @ _SCALE)
    is_told = values > max(1e-9 * values[-1], 0.0)
    told = _SCALE @ vectors[:, is_told]
    normal = match.map_scatter.sum(axis=0)
    try:
        solved = told @ np.linalg.solve(told.T @ normal @ told, told.T)
    except np.linalg.LinAlgError:
        return unmatched
    gain = cov_odometry @ match.hessian_information
    share = np.asarray(np.linalg.solve(np.eye(3) + gain, gain))
    owners, latest = [], keyframes[0]
    for keyframe in keyframes:
        latest = keyframe if keyframe.node >= 0 else latest
        owners.append(latest)
    T_owners = np.array([owner.T_local_base for owner in owners])
    onto_node = se2.adjoint(se2.inverse(se2.between(T_owners, T_local_node)))
    cov = (told / values[is_told]) @ told.T
    onto_told = told @ np.linalg.pinv(told)
    cov_common = onto_told @ match.cov_correlated @ onto_told.T
    # in the local frame's axes what neighbours share is the same, however each is turned
    turned = np.eye(3)
    turned[:2, :2] = se2.rotation(T_local_node[2]).T
    return NodeError(
        nodes=np.array([owner.node for owner in owners]),
        gains=solved @ match.map_scatter @ onto_node,
        root=_root(cov - cov_common),
        common_root=_root(cov_common) @ turned / math.sqrt(N_NEIGHBOURS),
        share=share,
        propagated=np.eye(3) - share @ solved @ normal,
        T_last_node=T_last_node,
        odometry_root=odometry_root,
    )


def _root(cov: FloatArray) -> FloatArray:
    """Symmetric square root of a covariance (3, 3)."""
    values, vectors = np.linalg.eigh(0.5 * (cov + cov.T))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
