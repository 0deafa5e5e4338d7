"""Which node of the pose graph each scan of a run is attached to."""

import struct

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.spool import Spool
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.base import FIRST_COV

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

    def trajectory(self, nodes: FloatArray, covs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses (n, 3) and covariances (n, 3, 3) of all scans in the map, right perturbation (body frame).

        A scan is known as well as the node that it is attached to, as far as it is relative to the anchor of both; its
        anchor's covariance and its own relative to the anchor do not add up, since the anchor's noise is in both.

        Parameters
        ----------
        nodes : (m, 3) array
            Optimised poses.
        covs : (m, 3, 3) array
            Their covariances, body frame.
        """
        rows = np.frombuffer(self.spool.since(0), dtype=_ROW)
        node, anchor, numbers = rows["node"], rows["anchor"], rows["numbers"]
        T_node_base, relative = numbers[:, :3], numbers[:, 6:].reshape(-1, 3, 3)
        A = se2.adjoint(se2.inverse(T_node_base))
        At = np.swapaxes(A, 1, 2)
        first = np.zeros(len(rows), dtype=np.int64)  # scan that the node was made of
        first[1:] = np.maximum.accumulate(np.where(node[1:] != node[:-1], np.arange(1, len(rows)), 0))
        has_same_anchor = (anchor == anchor[first]) & (anchor != node)
        then = np.where(has_same_anchor[:, None, None], relative[first], 0.0)
        growth = relative - A @ then @ At
        values, vectors = np.linalg.eigh(0.5 * (growth + np.swapaxes(growth, 1, 2)))
        growth = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        return se2.compose(nodes[node], T_node_base), A @ covs[node] @ At + growth + FIRST_COV
