"""Closures of a saved map rejected and added by hand, places in it erased; the graph is solved anew."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.core.saved_map_parts import points_in_map, without_points
from slammot_graph.core.types import FloatArray
from slammot_graph.graph import PoseGraph
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.loop_closure.saved_submaps import load_submaps
from slammot_graph.loop_closure.submap import Submap
from slammot_graph.loop_closure.verification import SearchWindow, Verifier
from slammot_graph.saved_maps.solving import settle

Pair = tuple[int, int]
Rectangle = tuple[float, float, float, float]

MOST_TOLD = 8
"""So many closures of a node are named in a message."""


def edit_map(
    saved: SavedMap,
    *,
    reject_closures: Sequence[Pair] = (),
    add_closures: Sequence[Pair] = (),
    erase: Sequence[Rectangle] = (),
    config: ScanToMapConfig | None = None,
) -> SavedMap:
    """Take closures out of a map, put others in, solve it anew, and then erase what stands in rectangles.

    Parameters
    ----------
    saved : SavedMap
    reject_closures : sequence of (int, int)
        Closures by the two nodes that they tie.
    add_closures : sequence of (int, int)
        Pairs of nodes whose local maps show one place: how they lie to each other is searched for and matched.
    erase : sequence of (x0, y0, x1, y1)
        Corners of rectangles [m, frame of the new map].
    config : ScanToMapConfig, optional

    Raises
    ------
    InputError
        There is no such closure or node, two local maps do not agree, or a rectangle has no area.
    """
    config = config or ScanToMapConfig()
    for x0, y0, x1, y1 in erase:
        if not (all(map(math.isfinite, (x0, y0, x1, y1))) and x0 != x1 and y0 != y1):
            raise InputError(f"erase: {x0:g} {y0:g} {x1:g} {y1:g} is no rectangle; give two opposite corners")
    edges = saved.edges
    for a, b in reject_closures:
        edges = _without(edges, a, b, len(saved.nodes))
    edges = (*edges, *_found(saved, add_closures, config))
    edits = [f"reject-closure {a}-{b}" for a, b in reject_closures]
    edits += [f"add-closure {a}-{b}" for a, b in add_closures]
    edits += [f"erase {' '.join(f'{value:g}' for value in rectangle)}" for rectangle in erase]
    edited = replace(saved, edges=edges, edits=(*saved.edits, *edits))
    if reject_closures or add_closures:
        graph = PoseGraph(config.graph)
        try:
            graph.load(saved.nodes, edges)
            edited = replace(edited, nodes=settle(graph))
        finally:
            graph.close()
    return _erased(edited, erase)


def _without(edges: tuple[GraphEdge, ...], a: int, b: int, n_nodes: int) -> tuple[GraphEdge, ...]:
    """Leave out the closures between two nodes."""
    _check_node(a, n_nodes)
    _check_node(b, n_nodes)
    kept = tuple(edge for edge in edges if edge.kind != "closure" or {edge.from_node, edge.to_node} != {a, b})
    if len(kept) == len(edges):
        ends = sorted(
            {
                edge.from_node + edge.to_node - node
                for edge in edges
                for node in (a, b)
                if edge.kind == "closure" and node in (edge.from_node, edge.to_node)
            }
        )
        told = ", ".join(map(str, ends[:MOST_TOLD])) + (", ..." if len(ends) > MOST_TOLD else "")
        raise InputError(
            f"reject-closure {a}-{b}: no closure ties these nodes; "
            + (f"they are tied to {told}" if ends else "neither is tied to any by one")
        )
    return kept


def _check_node(node: int, n_nodes: int) -> None:
    if not 0 <= node < n_nodes:
        raise InputError(f"node {node}: the map has nodes 0 to {n_nodes - 1}")


def _found(saved: SavedMap, pairs: Sequence[Pair], config: ScanToMapConfig) -> list[GraphEdge]:
    """Search for the closures that are to be added."""
    if not pairs:
        return []
    submaps = load_submaps(saved, config.closure.submap)
    verifier = Verifier(config.closure, config.local_map)
    found = []
    for a, b in pairs:
        target, source = _submap_at(submaps, saved, a), _submap_at(submaps, saved, b)
        if target is source:
            raise InputError(f"add-closure {a}-{b}: both nodes are of one local map")
        window = SearchWindow(math.inf, config.closure.max_search_m, math.pi, is_full_circle=True)
        closure = verifier.verify(target, source, _on_each_other(saved.nodes, target, source), window)
        if isinstance(closure, str):
            raise InputError(f"add-closure {a}-{b}: their local maps do not show one place ({closure})")
        found.append(
            GraphEdge(
                kind="closure",
                from_node=target.anchor,
                to_node=source.anchor,
                T_from_to=closure.T_target_source,
                information=closure.information,
            )
        )
    return found


def _submap_at(submaps: list[Submap], saved: SavedMap, node: int) -> Submap:
    """Give the local map that a node anchors, or else the one in whose middle it lies."""
    _check_node(node, len(saved.nodes))
    best, nearest = None, math.inf
    for submap in submaps:
        if submap.anchor == node:
            return submap
        at = [k for k, keyframe in enumerate(submap.keyframes) if keyframe.node == node]
        if at and abs(2 * at[0] - len(submap.keyframes)) < nearest:
            best, nearest = submap, abs(2 * at[0] - len(submap.keyframes))
    if best is None:
        raise InputError(f"node {node}: no local map is attached to it; take a node nearby")
    return best


def _on_each_other(nodes: FloatArray, target: Submap, source: Submap) -> FloatArray:
    """(3,) anchor of the source in the frame of the target's, so that their middles lie on each other."""
    turn = float(se2.between(nodes[target.anchor], nodes[source.anchor])[2])
    x, y = target.centre - se2.rotation(turn) @ source.centre
    return np.array([x, y, turn])


def _erased(saved: SavedMap, rectangles: Sequence[Rectangle]) -> SavedMap:
    """Leave out the points that lie in rectangles."""
    points = points_in_map(saved)
    is_gone = np.zeros(len(points), dtype=np.bool_)
    for x0, y0, x1, y1 in rectangles:
        low, high = np.minimum((x0, y0), (x1, y1)), np.maximum((x0, y0), (x1, y1))
        is_gone |= ((points >= low) & (points <= high)).all(axis=1)
    return without_points(saved, is_gone)
