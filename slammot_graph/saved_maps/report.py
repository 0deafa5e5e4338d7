"""What is told of maps of several runs: the closures between them, and trajectories moved with their nodes."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.linalg import covariance_of
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.core.saved_map_parts import runs_of_nodes
from slammot_graph.core.types import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RunClosure:
    """A closure between two runs of a map.

    Attributes
    ----------
    from_run, to_run : int
        Numbers in `SavedMap.runs`.
    from_node, to_node : int
    from_scan, to_scan : int
        Scans of the nodes, each of its run.
    T_from_to : (3,) array
    std : (3,) array
        Standard deviations that the closure claims [m, m, rad].
    residual2 : float
        Squared residual in the solved graph, in the closure's own covariance (3 degrees of freedom).
    """

    from_run: int
    to_run: int
    from_node: int
    to_node: int
    from_scan: int
    to_scan: int
    T_from_to: FloatArray
    std: FloatArray
    residual2: float


def closures_between_runs(saved: SavedMap) -> list[RunClosure]:
    """Give the closures that tie nodes of different runs."""
    run_of = runs_of_nodes(saved)
    found = []
    for edge in saved.edges:
        a, b = edge.from_node, edge.to_node
        if edge.kind != "closure" or run_of[a] == run_of[b]:
            continue
        offset = se2.log(se2.between(edge.T_from_to, se2.between(saved.nodes[a], saved.nodes[b])))
        found.append(
            RunClosure(
                from_run=int(run_of[a]),
                to_run=int(run_of[b]),
                from_node=a,
                to_node=b,
                from_scan=int(saved.node_scans[a]),
                to_scan=int(saved.node_scans[b]),
                T_from_to=edge.T_from_to,
                std=np.sqrt(np.diag(covariance_of(edge.information))),
                residual2=float(offset @ edge.information @ offset),
            )
        )
    return found


def moved_trajectory(T_map_base: FloatArray, before: SavedMap, nodes: FloatArray, name: str) -> FloatArray:
    """Move the poses of a run folder's trajectory with the nodes of its map.

    Parameters
    ----------
    T_map_base : (n, 3) array
    before : SavedMap
        The folder's map.
    nodes : (m, 3) array
        Where its nodes lie now.
    name : str
        Of the folder, for messages.

    Raises
    ------
    InputError
        The trajectory has fewer scans than the map has nodes of.
    """
    moved = T_map_base.copy()
    ends = [run.first_node for run in before.runs[1:]] + [len(before.nodes)]
    shown = sorted(
        (run.first_scan, run.first_node, end)
        for run, end in zip(before.runs, ends, strict=True)
        if run.first_scan >= 0
    )
    for k, (first_scan, first, end) in enumerate(shown):
        last_scan = shown[k + 1][0] if k + 1 < len(shown) else len(moved)
        scans = first_scan + before.node_scans[first:end]
        if not len(scans):
            continue
        if scans.max() >= last_scan:
            raise InputError(
                f"{name}: its trajectory.tum has fewer scans than map.slam has seen; were files of two runs mixed?"
            )
        rows = np.arange(first_scan, last_scan)
        at = first + np.clip(np.searchsorted(scans, rows, side="right") - 1, 0, None)
        moved[rows] = se2.compose(nodes[at], se2.between(before.nodes[at], T_map_base[rows]))
    return moved
