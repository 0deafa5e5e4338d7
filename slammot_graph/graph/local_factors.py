"""The pose graph's factors around the local map, and the marginal covariances of its keyframes from them alone."""

import numpy as np

from slammot_graph.errors import SlammotError
from slammot_graph.graph import _kernels
from slammot_graph.result_types import GraphEdge
from slammot_graph.types import FloatArray

MAP = -1
"""Number of the local map itself among the nodes."""

_BARELY = 1e-4 * np.eye(3)
"""Information that ties each node to the local map, so that the system can be solved [1/m^2, 1/rad^2]."""

_FIRMLY = 1e8 * np.eye(3)


class LocalFactors:
    """Odometry from keyframe to keyframe, and each keyframe's match on the local map.

    In the whole graph a match hangs on the anchor. But it was made on the points of all keyframes of the local map,
    and these go over into the next one: here the local map is a node of its own that all matches hang on. The
    errors relative to an anchor thus do not grow from one local map to the next as long as matches hold it in place,
    and where they do not, as along a corridor, they grow with the odometry.
    """

    def __init__(self) -> None:
        self._edges: list[GraphEdge] = []

    def start(self, node: int, T_local_base: FloatArray) -> None:
        """Begin with a first keyframe, which defines where the local map lies."""
        self._edges = [_on_map(node, T_local_base, _FIRMLY)]

    def add(self, odometry: GraphEdge, T_local_base: FloatArray, match_information: FloatArray) -> None:
        """Add a keyframe: its odometry factor, its pose in the local map and what its match tells of that.

        The information (3, 3) is zero where there was no match.
        """
        self._edges += [odometry, _on_map(odometry.to_node, T_local_base, match_information + _BARELY)]

    def relative_to(self, anchor: int) -> FloatArray:
        """Move on to a new anchor and forget what lies before it.

        Returns
        -------
        (k, 3, 3) array
            Marginal covariances of the anchor and all later keyframes relative to the anchor, right perturbation (body
            frames): of the linearised graph of these factors, with the anchor held.

        Raises
        ------
        SlammotError
            The information of a factor is not positive semi-definite.
        """
        self._edges = [
            e for e in self._edges if e.to_node >= anchor and (e.from_node == MAP or e.from_node >= anchor)
        ]
        keyframes = sorted({edge.to_node for edge in self._edges})
        place = {
            MAP: len(keyframes) - 1,
            **{node: k - 1 for k, node in enumerate(keyframes)},
        }  # the anchor is held
        covs = np.zeros((len(keyframes) + 1, 3, 3))
        if not _kernels.block_covariances(
            np.array([place[edge.from_node] for edge in self._edges]),
            np.array([place[edge.to_node] for edge in self._edges]),
            np.array([edge.T_from_to for edge in self._edges]),
            np.array([edge.information for edge in self._edges]),
            covs[1:],
        ):
            raise SlammotError(f"the covariances of the local map at node {anchor} cannot be solved for")
        return covs[:-1]


def _on_map(node: int, T_local_base: FloatArray, information: FloatArray) -> GraphEdge:
    return GraphEdge(
        kind="match", from_node=MAP, to_node=node, T_from_to=T_local_base, information=information
    )
