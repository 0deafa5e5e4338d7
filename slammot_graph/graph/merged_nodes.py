"""Nodes of the pose graph that are merged into others: each lies to another one as it did when it was merged."""

from array import array

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.linalg import invert
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.types import FloatArray, IntArray

_UPPER = np.triu_indices(3)


class MergedNodes:
    """About 100 bytes a node, in place of its share of the smoother."""

    def __init__(self) -> None:
        self._nodes = array("q")
        self._onto = array("q")
        self._is_closure = array("b")
        self._numbers = array("d")
        self._row: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self._nodes)

    def __contains__(self, node: int) -> bool:
        return node in self._row

    @property
    def nodes(self) -> IntArray:
        """(m,) numbers of the merged nodes."""
        return np.array(self._nodes, dtype=np.int64)

    def add(
        self, node: int, onto: int, T_onto_node: FloatArray, cov: FloatArray, *, is_closure: bool
    ) -> None:
        """Add one that lies at a pose (3,) to the node `onto`, covariance (3, 3) of its body frame.

        `is_closure` if a loop closure told so.
        """
        self._row[node] = len(self._nodes)
        self._nodes.append(node)
        self._onto.append(onto)
        self._is_closure.append(is_closure)
        self._numbers.extend(T_onto_node.tolist() + cov[_UPPER].tolist())

    def place_of(self, node: int) -> tuple[int, FloatArray]:
        """Node that one is merged into, and its pose (3,) there."""
        row = self._row[node]
        return self._onto[row], np.array(self._numbers[9 * row : 9 * row + 3])

    def place(self, poses: FloatArray) -> None:
        """Fill in the rows of all merged nodes among the poses (n, 3) of all nodes."""
        T_onto_node, _ = self._relative()
        poses[self.nodes] = se2.compose(poses[np.array(self._onto, dtype=np.int64)], T_onto_node)

    def spread(self, covs: FloatArray) -> None:
        """Fill in the rows of all merged nodes among the covariances (n, 3, 3) of all nodes, body frames."""
        T_onto_node, relative = self._relative()
        A = se2.adjoint(se2.inverse(T_onto_node))
        onto = covs[np.array(self._onto, dtype=np.int64)]
        covs[self.nodes] = A @ onto @ np.swapaxes(A, -1, -2) + relative

    def edges(self) -> list[GraphEdge]:
        """All that ties them, as edges; of those that a closure told of the kind "closure"."""
        poses, covs = self._relative()
        return [
            GraphEdge(
                kind="closure" if is_closure else "match",
                from_node=onto,
                to_node=node,
                T_from_to=T,
                information=invert(cov),
            )
            for node, onto, is_closure, T, cov in zip(
                self._nodes, self._onto, self._is_closure, poses, covs, strict=True
            )
        ]

    def _relative(self) -> tuple[FloatArray, FloatArray]:
        numbers = np.array(self._numbers).reshape(-1, 9)
        covs = np.empty((len(numbers), 3, 3))
        covs[:, _UPPER[0], _UPPER[1]] = covs[:, _UPPER[1], _UPPER[0]] = numbers[:, 3:]
        return numbers[:, :3], covs
