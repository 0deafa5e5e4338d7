"""Which node of the pose graph each scan of a run is attached to."""

from array import array

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray


class ScanPoses:
    """Each scan is attached to a node, and has its covariance relative to an anchor; 136 bytes a scan."""

    _N = 15

    def __init__(self) -> None:
        self._nodes = array("q")
        self._anchors = array("q")
        self._numbers = array("d")

    def __len__(self) -> int:
        return len(self._nodes)

    def append(
        self,
        node: int,
        T_node_base: FloatArray,
        anchor: int,
        T_anchor_base: FloatArray,
        cov_relative: FloatArray,
    ) -> None:
        """Add the next scan: its pose (3,) on a node, and on an anchor with its covariance (3, 3), body frame."""
        self._nodes.append(node)
        self._anchors.append(anchor)
        self._numbers.extend(T_node_base.tolist() + T_anchor_base.tolist() + cov_relative.ravel().tolist())

    def trajectory(self, nodes: FloatArray, marginals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses (n, 3) and covariances (n, 3, 3) of all scans in the map, right perturbation (body frame).

        Parameters
        ----------
        nodes : (m, 3) array
            Optimised poses.
        marginals : (m, 3, 3) array
            Their covariances, body frame.
        """
        numbers = np.array(self._numbers).reshape(-1, self._N)
        A = se2.adjoint(se2.inverse(numbers[:, 3:6]))
        on_anchor = marginals[np.array(self._anchors, dtype=np.int64)]
        cov_map = A @ on_anchor @ np.swapaxes(A, -1, -2) + numbers[:, 6:].reshape(-1, 3, 3)
        return se2.compose(nodes[np.array(self._nodes, dtype=np.int64)], numbers[:, :3]), cov_map
