"""Maps of several runs as one: each is looked for in those before by its local maps, with no guess, and joined."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from slammot_graph.core.errors import InputError
from slammot_graph.core.linalg import invert
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.core.saved_map_parts import side_by_side
from slammot_graph.graph import PoseGraph
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.localization.graph_insertion import ANYWHERE, first_component
from slammot_graph.loop_closure import LoopCloser
from slammot_graph.loop_closure.saved_submaps import load_submaps
from slammot_graph.saved_maps.solving import settle

NO_LOOPS_M = 1e9
"""Loops within a map are closed already: none is looked for at less than this length of path."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MergedMaps:
    """Several maps in one.

    Attributes
    ----------
    saved : SavedMap
        In the frame of the first.
    first_nodes : tuple of int
        The first node of each of the maps, in the order in which they were given.
    """

    saved: SavedMap
    first_nodes: tuple[int, ...]


def merge_maps(
    maps: Sequence[SavedMap], *, names: Sequence[str] = (), config: ScanToMapConfig | None = None
) -> MergedMaps:
    """Merge the maps of runs over one building, of one robot or several, into the frame of the first.

    Each is looked for in those merged before; one that is not found waits for others that may lie between. Once
    it is found, closures between its local maps and the others are looked for, and the whole graph is solved.

    Parameters
    ----------
    maps : sequence of SavedMap
        At least two.
    names : sequence of str
        Of the maps, for messages.
    config : ScanToMapConfig, optional

    Raises
    ------
    InputError
        A map has no place in the others, or holds no local map.
    """
    names = names or [f"map {k + 1}" for k in range(len(maps))]
    if len(maps) < 2:
        raise InputError("two maps at least are merged; name the folders of two runs")
    for saved, name in zip(maps, names, strict=True):
        if not any(component in saved.joined for component in saved.submap_components.tolist()):
            raise InputError(f"{name}: its map holds no local map; run its log with the method graph")
    merged, first_nodes = maps[0], {0: 0}
    waiting = list(range(1, len(maps)))
    while waiting:
        for k in waiting:
            both = _join(merged, maps[k], config or ScanToMapConfig())
            if both is not None:
                first_nodes[k] = len(merged.nodes)
                merged = both
                waiting.remove(k)
                break
        else:
            others = ", ".join(names[k] for k in sorted(first_nodes))
            raise InputError(
                f"{names[waiting[0]]}: no place of it was found in {others}; merge runs that have seen the same places,"
                " or drive one that goes from the one to the other"
            )
    return MergedMaps(saved=merged, first_nodes=tuple(first_nodes[k] for k in range(len(maps))))


def _join(first: SavedMap, second: SavedMap, config: ScanToMapConfig) -> SavedMap | None:
    """Find the second map in the first and join them; None where it is not found."""
    m, s, component = len(first.nodes), len(first.submaps), first_component(first)
    tie = GraphEdge(
        kind="odometry",
        from_node=0,
        to_node=m,
        T_from_to=second.nodes[0],
        information=invert(ANYWHERE),
    )
    both = side_by_side(first, second, _components(second, component), [tie])
    graph = PoseGraph(config.graph)
    try:
        graph.load(both.nodes, both.edges)
        closer = LoopCloser(replace(config.closure, min_path_m=NO_LOOPS_M), config.local_map, graph)
        submaps = load_submaps(both, config.closure.submap)
        closer.start_from(submaps[:s], first.joined, None)
        closer.first_nodes[component] = m
        own = [submap for submap in submaps[s:] if submap.component == component]
        n_before = 0
        for submap in own:
            n_before += closer.is_sought(component)
            closer.consider(submap)
            if closer.is_sought(component):
                closer.seek(submap)
        if closer.is_sought(component):
            return None
        tied = {edge.to_node for _, edge in closer.accepted}
        for submap in own[:n_before]:  # those looked at before the place was known
            if submap.anchor not in tied:
                closer.submaps = [other for other in closer.submaps if other is not submap]
                closer.consider(submap)
        nodes = settle(graph)
        return replace(both, nodes=nodes, edges=tuple(graph.edges))
    finally:
        graph.close()


def _components(second: SavedMap, first_free: int) -> dict[int, int]:
    """New numbers of the components of a map: one for those that lie in one frame, its own for each other one."""
    all_components = {
        *second.submap_components.tolist(),
        *(run.component for run in second.runs),
        *second.joined,
    }
    apart = sorted(all_components - set(second.joined))
    numbers = dict.fromkeys(second.joined, first_free)
    return numbers | {component: first_free + 1 + k for k, component in enumerate(apart)}
