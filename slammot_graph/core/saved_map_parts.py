"""Parts of a `SavedMap`: where its keyframes lie, the map without some of its points or local maps, two maps as one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.core.types import BoolArray, FloatArray, IntArray

LEAST_POINTS = 20
"""A local map with fewer points shows no place."""


def keyframe_places(saved: SavedMap) -> FloatArray:
    """(k, 3) poses of the keyframes in the map, by the local map in whose middle each is; NaN for those in none."""
    places = np.full((len(saved.keyframe_nodes), 3), np.nan)
    nearest = np.full(len(places), np.inf)
    for rows in saved.submaps:
        from_middle = np.abs(2.0 * np.arange(len(rows)) - len(rows))
        T_anchor = se2.between(saved.keyframe_poses[rows[:1]], saved.keyframe_poses[rows])
        T_map = se2.compose(saved.nodes[saved.keyframe_nodes[rows[0]]][None, :], T_anchor)
        is_nearer = from_middle < nearest[rows]
        places[rows[is_nearer]] = T_map[is_nearer]
        nearest[rows[is_nearer]] = from_middle[is_nearer]
    return places


def joined_keyframes(saved: SavedMap) -> BoolArray:
    """(k,) whether a keyframe belongs to a local map whose place in the map is known."""
    is_joined = np.zeros(len(saved.keyframe_nodes), dtype=np.bool_)
    for rows, component in zip(saved.submaps, saved.submap_components.tolist(), strict=True):
        is_joined[rows] |= component in saved.joined
    return is_joined


def points_in_map(saved: SavedMap) -> FloatArray:
    """(p, 2) points [m, map frame], in the order of the saved ones; NaN for those of keyframes in no local map."""
    places = np.repeat(keyframe_places(saved), saved.keyframe_sizes, axis=0)
    c, s = np.cos(places[:, 2]), np.sin(places[:, 2])
    x, y = saved.points.T
    return np.column_stack([places[:, 0] + c * x - s * y, places[:, 1] + s * x + c * y])


def runs_of_nodes(saved: SavedMap) -> IntArray:
    """(m,) number of the run that each node is of."""
    first = np.array([run.first_node for run in saved.runs] or [0])
    return np.asarray(np.searchsorted(first, np.arange(len(saved.nodes)), side="right") - 1)


def without_points(saved: SavedMap, is_gone: BoolArray, is_kept: BoolArray | None = None) -> SavedMap:
    """Leave out points (p,), the local maps that have hardly any left, and others that are not to be kept (s,)."""
    if is_kept is None:
        is_kept = np.ones(len(saved.submaps), dtype=np.bool_)
    if not is_gone.any():
        return with_submaps(saved, is_kept)
    owner = np.repeat(np.arange(len(saved.keyframe_sizes)), saved.keyframe_sizes)
    sizes = np.bincount(owner[~is_gone], minlength=len(saved.keyframe_sizes)).astype(np.int64)
    thinner = replace(
        saved, points=saved.points[~is_gone], normals=saved.normals[~is_gone], keyframe_sizes=sizes
    )
    has_points = np.array([sizes[rows].sum() >= LEAST_POINTS for rows in saved.submaps], dtype=np.bool_)
    return with_submaps(thinner, is_kept & has_points)


def with_submaps(saved: SavedMap, is_kept: BoolArray) -> SavedMap:
    """Keep some of the local maps (s,), and the keyframes that belong to one of them."""
    if is_kept.all():
        return saved
    kept = np.flatnonzero(is_kept)
    is_used = np.zeros(len(saved.keyframe_nodes), dtype=np.bool_)
    for k in kept.tolist():
        is_used[saved.submaps[k]] = True
    number = np.cumsum(is_used) - 1
    of_used = np.repeat(is_used, saved.keyframe_sizes)
    return replace(
        saved,
        keyframe_nodes=saved.keyframe_nodes[is_used],
        keyframe_poses=saved.keyframe_poses[is_used],
        keyframe_lasers=saved.keyframe_lasers[is_used],
        keyframe_origins=saved.keyframe_origins[is_used],
        keyframe_sizes=saved.keyframe_sizes[is_used],
        points=saved.points[of_used],
        normals=saved.normals[of_used],
        submaps=tuple(number[saved.submaps[k]] for k in kept.tolist()),
        submap_paths=saved.submap_paths[kept],
        submap_components=saved.submap_components[kept],
    )


def side_by_side(
    first: SavedMap, second: SavedMap, components: Mapping[int, int], between: Sequence[GraphEdge] = ()
) -> SavedMap:
    """Put two maps into one, each where it was; the nodes of the second one come after those of the first.

    Parameters
    ----------
    first, second : SavedMap
    components : mapping of int to int
        New numbers of the components of the second.
    between : sequence of GraphEdge
        Edges between both, in the new numbers of nodes.
    """
    m, k = len(first.nodes), len(first.keyframe_nodes)
    edges = tuple(
        replace(edge, from_node=edge.from_node + m, to_node=edge.to_node + m) for edge in second.edges
    )
    is_none = second.keyframe_nodes < 0
    joined = {*first.joined, *(components[c] for c in second.joined)}
    return SavedMap(
        nodes=np.vstack([first.nodes, second.nodes]),
        node_scans=np.concatenate([first.node_scans, second.node_scans]),
        edges=(*first.edges, *between, *edges),
        keyframe_nodes=np.concatenate(
            [first.keyframe_nodes, np.where(is_none, second.keyframe_nodes, second.keyframe_nodes + m)]
        ),
        keyframe_poses=np.vstack([first.keyframe_poses, second.keyframe_poses]),
        keyframe_lasers=np.concatenate([first.keyframe_lasers, second.keyframe_lasers]),
        keyframe_origins=np.vstack([first.keyframe_origins, second.keyframe_origins]),
        keyframe_sizes=np.concatenate([first.keyframe_sizes, second.keyframe_sizes]),
        points=np.vstack([first.points, second.points]),
        normals=np.vstack([first.normals, second.normals]),
        submaps=(*first.submaps, *(rows + k for rows in second.submaps)),
        submap_paths=np.concatenate([first.submap_paths, second.submap_paths]),
        submap_components=np.concatenate(
            [
                first.submap_components,
                np.array([components[c] for c in second.submap_components.tolist()], dtype=np.int64),
            ]
        ),
        joined=tuple(sorted(joined)),
        runs=(
            *first.runs,
            *(
                replace(run, first_node=run.first_node + m, component=components[run.component])
                for run in second.runs
            ),
        ),
        odometry_errors=np.concatenate([first.odometry_errors, second.odometry_errors]),
        edits=(*first.edits, *second.edits),
    )
