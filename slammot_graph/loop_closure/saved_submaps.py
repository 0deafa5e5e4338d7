"""Local maps and graph as a `SavedMap`, and back."""

import math
from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from slammot_graph.core.odometry_report import Estimated, OdometryReport
from slammot_graph.core.results import GraphEdge
from slammot_graph.core.saved_map import SavedMap, SavedRun
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.loop_closure.submap import Submap, SubmapConfig
from slammot_graph.mapping.local_map import Keyframe


def save_submaps(
    submaps: Sequence[Submap],
    *,
    nodes: FloatArray,
    node_scans: IntArray,
    edges: tuple[GraphEdge, ...],
    joined: Sequence[int],
    runs: tuple[SavedRun, ...],
    odometry_errors: FloatArray,
    edits: tuple[str, ...] = (),
) -> SavedMap:
    """Make a `SavedMap` of local maps and the graph that their anchors are nodes of; see there for the arguments.

    Of the points of a keyframe one is kept for each square of the local maps' `point_spacing_m`.
    """
    keyframes = {id(keyframe): keyframe for submap in submaps for keyframe in submap.keyframes}
    number = {key: k for k, key in enumerate(keyframes)}
    spacing_m = submaps[0].config.point_spacing_m if submaps else 1.0
    kept = [_thinned(keyframe.points_base, spacing_m) for keyframe in keyframes.values()]
    nothing = np.empty((0, 2))
    pairs = list(zip(keyframes.values(), kept, strict=True))
    return SavedMap(
        nodes=nodes,
        node_scans=node_scans,
        edges=edges,
        keyframe_nodes=np.array([keyframe.node for keyframe in keyframes.values()], dtype=np.int64),
        keyframe_poses=np.array([keyframe.T_local_base for keyframe in keyframes.values()]).reshape(-1, 3),
        keyframe_lasers=np.array([keyframe.laser for keyframe in keyframes.values()], dtype=np.int64),
        keyframe_origins=np.array([keyframe.laser_base for keyframe in keyframes.values()]).reshape(-1, 2),
        keyframe_sizes=np.array([len(rows) for rows in kept], dtype=np.int64),
        points=np.concatenate([nothing, *(keyframe.points_base[rows] for keyframe, rows in pairs)]),
        normals=np.concatenate([nothing, *(keyframe.normals_base[rows] for keyframe, rows in pairs)]),
        submaps=tuple(
            np.array([number[id(keyframe)] for keyframe in submap.keyframes], dtype=np.int64)
            for submap in submaps
        ),
        submap_paths=np.array([submap.path_m for submap in submaps], dtype=np.float64),
        submap_components=np.array([submap.component for submap in submaps], dtype=np.int64),
        joined=tuple(sorted(joined)),
        runs=runs,
        odometry_errors=odometry_errors,
        edits=edits,
    )


def load_submaps(saved: SavedMap, config: SubmapConfig) -> list[Submap]:
    """Give the local maps of a `SavedMap`, numbered from 0."""
    ends = np.cumsum(saved.keyframe_sizes)
    keyframes = [
        Keyframe(
            node=int(saved.keyframe_nodes[k]),
            T_local_base=saved.keyframe_poses[k],
            points_base=saved.points[ends[k] - saved.keyframe_sizes[k] : ends[k]],
            normals_base=saved.normals[ends[k] - saved.keyframe_sizes[k] : ends[k]],
            laser_base=saved.keyframe_origins[k],
            laser=int(saved.keyframe_lasers[k]),
        )
        for k in range(len(ends))
    ]
    return [
        Submap(
            number,
            tuple(keyframes[k] for k in rows),
            float(saved.submap_paths[number]),
            int(saved.submap_components[number]),
            config,
        )
        for number, rows in enumerate(saved.submaps)
    ]


def calibration_of(report: OdometryReport) -> dict[str, tuple[float, float]]:
    """Give the numbers of a report that the drive tells, each with its standard deviation."""
    numbers = ((item.name, getattr(report, item.name)) for item in fields(report))
    return {
        name: (number.value, number.std)
        for name, number in numbers
        if isinstance(number, Estimated) and math.isfinite(number.std) and math.isfinite(number.value)
    }


def _thinned(points: FloatArray, spacing_m: float) -> IntArray:
    """Rows of the points (m, 2) that are the first ones of their squares, in their order."""
    key = np.floor(points / spacing_m).astype(np.int64) @ np.array([1 << 24, 1])
    _, first = np.unique(key, return_index=True)
    return np.sort(first)
