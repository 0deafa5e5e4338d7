"""What a smoother was asked that changes it, in order, as bytes: on the disk once it is much."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from slammot_graph.core.results import GraphEdge
from slammot_graph.core.spool import Spool
from slammot_graph.core.types import FloatArray

_ROW = np.dtype(
    [
        ("what", "u1"),
        ("from_node", "i8"),
        ("to_node", "i8"),
        ("pose", "f8", 3),
        ("information", "f8", (3, 3)),
    ]
)
_PRIOR, _NODE, _EDGE, _ADDED, _FACTOR, _REMOVED, _ITERATED, _ASKED_POSE, _ASKED_POSES = range(9)
_MOST_IN_MEMORY = 1 << 20
_ROWS_AT_ONCE = 10_000


class Asked:
    """Rows of all calls; those that take poses, edges or numbers are a row for each of these and one that ends them.

    Attributes
    ----------
    spool : Spool
        Only grows; what lies before the latest `begin_anew` counts no more.
    """

    def __init__(self) -> None:
        self.spool = Spool(_MOST_IN_MEMORY)
        self._start = 0

    def begin_anew(self) -> None:
        """Let nothing count that was noted so far."""
        self._start = self.spool.n_bytes

    def add(
        self, prior: FloatArray | None, nodes: Sequence[tuple[int, FloatArray]], edges: Sequence[GraphEdge]
    ) -> None:
        """Note that these were added; see `Smoother.add`."""
        if prior is not None:
            self._note(_PRIOR, pose=prior)
        for node, pose in nodes:
            self._note(_NODE, to_node=node, pose=pose)
        for edge in edges:
            self._note(_EDGE, edge.from_node, edge.to_node, edge.T_from_to, edge.information)
        self._note(_ADDED)

    def remove(self, numbers: Sequence[int]) -> None:
        """Note that these factors were removed."""
        for number in numbers:
            self._note(_FACTOR, to_node=number)
        self._note(_REMOVED)

    def iterate(self) -> None:
        """Note a step of Gauss and Newton."""
        self._note(_ITERATED)

    def pose(self, node: int) -> None:
        """Note the question for a node's pose."""
        self._note(_ASKED_POSE, to_node=node)

    def poses(self) -> None:
        """Note the question for all poses."""
        self._note(_ASKED_POSES)

    def repeat(self, smoother: Any) -> None:
        """Ask a new smoother all of it."""
        calls: dict[int, Callable[[npt.NDArray[Any]], object]] = {
            _ADDED: lambda rows: smoother.add(*_addition(rows)),
            _REMOVED: lambda rows: smoother.remove(rows["to_node"].tolist()),
            _ITERATED: lambda _: smoother.iterate(),
            _ASKED_POSE: lambda rows: smoother.pose(int(rows["to_node"][0])),
            _ASKED_POSES: lambda _: smoother.poses(),
        }
        for rows in self._calls():
            what = int(rows["what"][-1])
            calls[what](rows if what == _ASKED_POSE else rows[:-1])

    def _calls(self) -> Iterator[npt.NDArray[Any]]:
        """Rows of each call."""
        left = np.empty(0, dtype=_ROW)
        for place in range(self._start, self.spool.n_bytes, _ROWS_AT_ONCE * _ROW.itemsize):
            end = min(place + _ROWS_AT_ONCE * _ROW.itemsize, self.spool.n_bytes)
            rows = np.concatenate([left, self._rows(place, end)])
            first = 0
            for last in np.flatnonzero(~np.isin(rows["what"], (_PRIOR, _NODE, _EDGE, _FACTOR))).tolist():
                yield rows[first : last + 1]
                first = last + 1
            left = rows[first:]

    def _rows(self, place: int, end: int) -> npt.NDArray[Any]:
        data = b""
        while place + len(data) < end:
            data += self.spool.read_some(place + len(data), end - place - len(data))
        return np.frombuffer(data, dtype=_ROW)

    def _note(
        self,
        what: int,
        from_node: int = 0,
        to_node: int = 0,
        pose: FloatArray | float = 0.0,
        information: FloatArray | float = 0.0,
    ) -> None:
        row = np.zeros((), dtype=_ROW)
        row["what"], row["from_node"], row["to_node"] = what, from_node, to_node
        row["pose"], row["information"] = pose, information
        self.spool.add(row.tobytes())


def _addition(
    rows: npt.NDArray[Any],
) -> tuple[FloatArray | None, list[tuple[int, FloatArray]], list[GraphEdge]]:
    """Prior, nodes and edges of a call of `add`."""
    priors = rows["pose"][rows["what"] == _PRIOR]
    nodes = [(int(row["to_node"]), row["pose"].copy()) for row in rows[rows["what"] == _NODE]]
    edges = [
        GraphEdge(
            kind="match",
            from_node=int(row["from_node"]),
            to_node=int(row["to_node"]),
            T_from_to=row["pose"].copy(),
            information=row["information"].copy(),
        )
        for row in rows[rows["what"] == _EDGE]
    ]
    return (priors[0].copy() if len(priors) else None), nodes, edges
