"""The pose graph of a recording: nodes and edges as they are, and what each loop closure did to them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import TYPE_CHECKING, get_args

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import ClosureStatus, EdgeKind, GraphEdge, StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.viz.colors import COLOR_CLOSURE, COLOR_ESTIMATE
from slammot_graph.viz.rerun.budget import Budget
from slammot_graph.viz.rerun.columns import Columns, times_of
from slammot_graph.viz.rerun.layout import GRAPH_VIEW_SCALE, closure_path
from slammot_graph.viz.rerun.primitives import at_height

if TYPE_CHECKING:
    import rerun as rr

MAX_PATH_NODES = 1000
"""Longer graphs are thinned to about so many nodes where they are drawn as a line."""
MAX_VIEW_NODES = 300
"""The graph view shows the shape of the graph, thinned to about so many nodes."""
GRAPH_SHARE, GRAPH_HEAD_START = 0.10, 1 << 18
"""What graphs may add to the bytes of the scans, and how many bytes more."""


class GraphPanel:
    """The graph, and the closures that were tried since the last batch was sent."""

    def __init__(self, out: Columns) -> None:
        self._out = out
        self._tried: list[_Tried] = []
        self._nodes: list[FloatArray] = []  # as they were last told, or else as each was when it was added
        self._nodes_before: FloatArray | None = None
        self._closures: dict[tuple[int, int], None] = {}  # between which nodes, as far as was told
        self._last_step: StepResult | None = None
        self._budget = Budget(GRAPH_SHARE, 20, head_start=GRAPH_HEAD_START)

    def wants_graph(self, n_scans: int) -> bool:
        """Tell whether the graph is due after so many scans."""
        return self._budget.is_due(n_scans, self._out.n_bytes)

    @property
    def wants_nodes(self) -> bool:
        """Whether a closure has moved the nodes and nobody has said where to."""
        return self._nodes_before is not None

    def follow(self, step: StepResult) -> None:
        """Keep the nodes' poses, and between which of them a closure was tried.

        The pose of a step that closes a loop is the corrected one already; its node is put where it was before.
        """
        has_closed = any(attempt.status == "accepted" for attempt in step.closures)
        if step.node is not None:
            last = self._last_step
            self._nodes.append(_uncorrected(last, step) if has_closed and last else step.T_map_base)
        for attempt in step.closures:
            if attempt.status == "accepted":
                self._closures[attempt.target_node, attempt.source_node] = None
            elif attempt.status == "outlier":
                self._closures.pop((attempt.target_node, attempt.source_node), None)
        if step.closures:
            ends = [
                (self._nodes[attempt.target_node], self._nodes[attempt.source_node])
                for attempt in step.closures
            ]
            self._tried.append(_Tried(step, np.array(ends)[..., :2]))
        if has_closed and self._nodes_before is None:
            self._nodes_before = np.array(self._nodes)
        self._last_step = step

    def log_graph(self, nodes: FloatArray, edges: Sequence[GraphEdge], n_scans: int) -> None:
        """Log the graph as it is after so many scans: node poses (m, 3), map frame, and edges."""
        import rerun as rr

        ends = {
            kind: [(e.from_node, e.to_node) for e in edges if e.kind == kind] for kind in get_args(EdgeKind)
        }
        self._closures = dict.fromkeys(ends.pop("closure"))
        self._out.rec.log("/world/graph/nodes", rr.Points3D(at_height(nodes[:, :2], 0.01)))
        for kind, pairs in ends.items():
            self._out.rec.log(f"/world/graph/{kind}", _edges(nodes, pairs))
        self._log_graph_view(nodes, edges)
        self._budget.spend(n_scans, 12.0 * len(nodes) + 24.0 * len(edges))
        self.log_nodes(nodes)

    def log_nodes(self, nodes: FloatArray) -> None:
        """Log the path through the nodes and the closures between them, and what the last closure did to them."""
        import rerun as rr

        self._nodes = list(nodes)
        before, self._nodes_before = self._nodes_before, None
        paths = [("/world/estimate/graph_path", nodes, 0.024)]
        if before is not None:
            # below the path, so that it shows where that has moved
            paths.append(("/world/closures/graph_before", before, 0.017))
        for entity, poses, z in paths:
            if len(poses) > 1:
                path = at_height(poses[None, _thinned(len(poses), MAX_PATH_NODES), :2], z)
                self._out.rec.log(entity, rr.LineStrips3D(path))
        self._out.rec.log("/world/graph/closure", _edges(nodes, list(self._closures)))

    def send(self, steps: list[StepResult]) -> None:
        """Send one batch per status and step that tried any; an empty one clears those tried before."""
        import rerun as rr

        tried, self._tried = self._tried, []
        if not tried:
            return
        times = times_of([of_step.step for of_step in tried])
        attempts = [attempt for of_step in tried for attempt in of_step.step.closures]
        segments = np.concatenate([of_step.segments for of_step in tried])
        row = np.repeat(np.arange(len(tried)), [len(of_step.segments) for of_step in tried])
        for status in get_args(ClosureStatus):
            rows = [k for k, attempt in enumerate(attempts) if attempt.status == status]
            lines = rr.LineStrips3D.columns(
                strips=at_height(segments[rows], 0.036), labels=[attempts[k].text for k in rows]
            )
            self._out.send_batches(
                closure_path(status), times, lines, np.bincount(row[rows], minlength=len(tried))
            )

    def _log_graph_view(self, nodes: FloatArray, edges: Sequence[GraphEdge]) -> None:
        """Log the shape of the graph: a thinned chain, and the closures with their ends."""
        import rerun as rr

        closures = [(edge.from_node, edge.to_node) for edge in edges if edge.kind == "closure"]
        ends = set(chain.from_iterable(closures))
        kept = sorted(ends | set(_thinned(len(nodes), MAX_VIEW_NODES)))
        names = [str(node) for node in kept]
        self._out.rec.log(
            "/graph/chain",
            rr.GraphNodes(
                node_ids=names,
                positions=(nodes[kept, :2] * [GRAPH_VIEW_SCALE, -GRAPH_VIEW_SCALE]).astype(
                    np.float32
                ),  # the view's y points down
                colors=np.array(
                    [COLOR_CLOSURE if node in ends else COLOR_ESTIMATE for node in kept], np.uint32
                ),
                radii=np.full(len(kept), 4.0, dtype=np.float32),
                show_labels=False,
            ),
            rr.GraphEdges(
                # of this entity, since an edge finds no nodes of another one
                [*pairwise(names), *((str(a), str(b)) for a, b in closures)],
                graph_type="undirected",
            ),
        )


@dataclass(frozen=True, eq=False)
class _Tried:
    """A step that tried closures, and the places (k, 2, 2) of their nodes just before."""

    step: StepResult
    segments: FloatArray


def _edges(nodes: FloatArray, pairs: Sequence[tuple[int, int]]) -> "rr.LineStrips3D":
    """Make lines between nodes (m, 3)."""
    import rerun as rr

    ends = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return rr.LineStrips3D(at_height(nodes[ends][..., :2], 0.015))


def _thinned(n: int, n_most: int) -> range:
    """Evenly spaced indices below n, about so many at most."""
    return range(0, n, max(1, math.ceil(n / n_most)))


def _uncorrected(last: StepResult, step: StepResult) -> FloatArray:
    """(3,) pose of a step that closed a loop, as it would have been without."""
    before, now = last.scan.T_odom_base, step.scan.T_odom_base
    increment = se2.IDENTITY if before is None or now is None else se2.between(before, now)
    innovation = se2.between(step.T_map_base_predicted, step.T_map_base)
    return se2.compose(se2.compose(last.T_map_base, increment), innovation)
