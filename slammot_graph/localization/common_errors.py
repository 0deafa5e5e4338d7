"""Errors that the odometry's increments have in common, propagated with the robot; see `graph.common_errors`."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.linalg import fused, invert
from slammot_graph.core.types import FloatArray
from slammot_graph.graph.common_errors import N_PARAMETERS, common_error


class CommonErrors:
    """What they have done to the poses of the local map's nodes in the map, as known at the time.

    All are right perturbations (body frame), order (x, y, theta), by one standard deviation of each parameter. In a run
    that goes on with a saved map the last four columns are its own parameters, the others those of the runs before.

    Attributes
    ----------
    of_factors : dict of int to (3, 4) array
        By the node that the odometry's factor leads to.
    """

    def __init__(self) -> None:
        self.of_factors = dict[int, FloatArray]()
        self._of_nodes = dict[int, FloatArray]()
        self._latest: FloatArray = np.zeros((3, N_PARAMETERS))
        self._cov: FloatArray = np.zeros((3, 3))

    def cov(self, node: int) -> FloatArray:
        """(3, 3) covariance of a node of the local map by them."""
        error = self._of_nodes.get(node)
        return np.zeros((3, 3)) if error is None else error @ error.T

    def move(self, node: int, T_last_node: FloatArray, cov: FloatArray, stds: FloatArray) -> None:
        """Go on to a new node by the odometry.

        Parameters
        ----------
        node : int
        T_last_node : (3,) array
            The odometry's motion.
        cov : (3, 3) array
            Its covariance, the errors of increments taken for independent.
        stds : (4,) array
            Of the parameters.
        """
        error = common_error(T_last_node, stds)
        self.of_factors[node] = error
        self._latest = se2.adjoint(se2.inverse(T_last_node)) @ self._latest
        self._latest[:, -N_PARAMETERS:] += error
        self._of_nodes[node] = self._latest
        self._cov = se2.compound_covariance(self._cov, T_last_node, cov)

    def match(self, node: int, anchor: int, T_anchor_node: FloatArray, information: FloatArray) -> None:
        """Let a match, of this information (3, 3) about the anchor, hold the new node."""
        of_anchor = self._of_nodes.get(anchor)
        if of_anchor is None:
            return
        after = fused(self._cov, information)
        from_anchor = se2.adjoint(se2.inverse(T_anchor_node)) @ of_anchor
        self._latest = from_anchor + after @ invert(self._cov) @ (self._latest - from_anchor)
        self._of_nodes[node] = self._latest
        self._cov = after

    def start_local_map(self, anchor: int, node: int, cov: FloatArray) -> None:
        """Go over to another anchor, relative to which the latest node has a covariance (3, 3)."""
        self._of_nodes = {number: error for number, error in self._of_nodes.items() if number >= anchor}
        self._of_nodes[node] = self._latest
        self._cov = cov

    def close_loop(self, solution: FloatArray) -> None:
        """Take over the errors (n, 3, 4 r) of all nodes as of the graph's new solution."""
        self._of_nodes = {node: solution[node] for node in self._of_nodes}
        self._latest = solution[-1]
