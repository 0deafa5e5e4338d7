"""Which node of the pose graph each scan of a run is attached to."""

import struct

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.spool import Spool
from slammot_graph.core.types import FloatArray

_ROW = np.dtype([("node", "i8"), ("anchor", "i8"), ("numbers", "f8", 15)])
_PACKED = struct.Struct("=2q15d")
_MOST_IN_MEMORY = 2 << 20


class ScanPoses:
    """Each scan is attached to a node, and has its covariance relative to an anchor: 136 bytes, on the disk if many.

    Attributes
    ----------
    spool : Spool
    """

    def __init__(self) -> None:
        self.spool = Spool(_MOST_IN_MEMORY)

    def __len__(self) -> int:
        return self.spool.n_bytes // _PACKED.size

    def append(
        self,
        node: int,
        T_node_base: FloatArray,
        anchor: int,
        T_anchor_base: FloatArray,
        cov_relative: FloatArray,
    ) -> None:
        """Add the next scan: its pose (3,) on a node, and on an anchor with its covariance (3, 3), body frame."""
        numbers = (*T_node_base.tolist(), *T_anchor_base.tolist(), *cov_relative.ravel().tolist())
        self.spool.add(_PACKED.pack(node, anchor, *numbers))

    def trajectory(self, nodes: FloatArray, marginals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses (n, 3) and covariances (n, 3, 3) of all scans in the map, right perturbation (body frame).

        Parameters
        ----------
        nodes : (m, 3) array
            Optimised poses.
        marginals : (m, 3, 3) array
            Their covariances, body frame.
        """
        rows = np.frombuffer(self.spool.since(0), dtype=_ROW)
        numbers = rows["numbers"]
        A = se2.adjoint(se2.inverse(numbers[:, 3:6]))
        on_anchor = marginals[rows["anchor"]]
        cov_map = A @ on_anchor @ np.swapaxes(A, -1, -2) + numbers[:, 6:].reshape(-1, 3, 3)
        return se2.compose(nodes[rows["node"]], numbers[:, :3]), cov_map
