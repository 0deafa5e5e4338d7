"""Kernels that find who may walk along: small things that no keyframe from elsewhere has seen where they are."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.registration._pair_kernels import partner


@kernel
def small_things(
    points: FloatArray, is_used: BoolArray, gap: float, gap_ratio: float, width: float, out: IntArray
) -> int:
    """Number in `out` (n,) the small things that the used points (n, 2) make up, -1 for other points; gives how many.

    A thing ends where the next used point is farther than ``gap + gap_ratio * range`` [m]; it is small if its bounding
    box is no longer than `width` [m] across.
    """
    n = points.shape[0]
    n_things = 0
    first = last = -1
    x = y = x0 = x1 = y0 = y1 = 0.0
    for k in range(n + 1):
        if k < n:
            out[k] = -1
            if not is_used[k]:
                continue
            x = points[k, 0]
            y = points[k, 1]
            if first >= 0 and math.hypot(
                x - points[last, 0], y - points[last, 1]
            ) <= gap + gap_ratio * math.hypot(x, y):
                x0 = min(x0, x)
                x1 = max(x1, x)
                y0 = min(y0, y)
                y1 = max(y1, y)
                last = k
                continue
        if first >= 0 and math.hypot(x1 - x0, y1 - y0) <= width:
            for m in range(first, last + 1):
                if is_used[m]:
                    out[m] = n_things
            n_things += 1
        first = last = k
        x0 = x1 = x
        y0 = y1 = y
    return n_things


@kernel
def _is_seen_from_elsewhere(T_keyframe: FloatArray, x: float, y: float, parallax: float) -> bool:
    """Tell whether a keyframe at a pose (3,) is farther than `parallax` [m] from the robot (x, y)."""
    return math.hypot(T_keyframe[0] - x, T_keyframe[1] - y) > parallax


@kernel
def may_walk_along(
    thing: IntArray,
    n_things: int,
    points: FloatArray,
    map_points: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    owner: "np.ndarray",
    T_keyframes: FloatArray,
    reach: float,
    x: float,
    y: float,
    parallax: float,
    out: BoolArray,
) -> int:
    """Mark in `out` (n,) the points of small things that are not known to stay; gives their number.

    A thing is known to stay if half of its points, put at the matched pose, lie within `reach` [m] of points of the
    local map that keyframes farther than `parallax` [m] from the robot (x, y) saw: what walks along is left behind
    by none of them. Arguments of the map as of `partner`; `owner` (capacity,) rows of `T_keyframes` (k, 3).
    """
    size = np.zeros(n_things, dtype=np.int64)
    n_known = np.zeros(n_things, dtype=np.int64)
    for k in range(points.shape[0]):
        t = thing[k]
        if t < 0:
            continue
        size[t] += 1
        m = partner(points[k, 0], points[k, 1], map_points, nearest, inv_cell, first, reach * reach)
        if m < 0:
            continue
        n_known[t] += _is_seen_from_elsewhere(T_keyframes[owner[m]], x, y, parallax)
    n_marked = 0
    for k in range(points.shape[0]):
        t = thing[k]
        out[k] = t >= 0 and 2 * n_known[t] < size[t]
        n_marked += out[k]
    return n_marked


@kernel
def keep_pulling(
    thing: IntArray,
    n_things: int,
    points_with: FloatArray,
    points_without: FloatArray,
    map_points: FloatArray,
    map_normals: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    reach: float,
    is_suspect: BoolArray,
) -> int:
    """Leave of the suspects (n,) those on things nearer to the map at the pose to which they pull; gives their number.

    `points_with` and `points_without` (n, 2) are the scan at the matches with all and without the suspects. Distances
    are those to the lines of the local map, or to its points where these have no normal, and at most `reach` [m].
    """
    gain = np.zeros(n_things)
    for k in range(thing.shape[0]):
        if not is_suspect[k]:
            continue
        for points, sign in ((points_without, 1.0), (points_with, -1.0)):
            m = partner(points[k, 0], points[k, 1], map_points, nearest, inv_cell, first, reach * reach)
            d2 = reach * reach
            if m >= 0:
                dx = points[k, 0] - map_points[m, 0]
                dy = points[k, 1] - map_points[m, 1]
                if map_normals[m, 0] == 0.0 and map_normals[m, 1] == 0.0:
                    d2 = dx * dx + dy * dy
                else:
                    d2 = (dx * map_normals[m, 0] + dy * map_normals[m, 1]) ** 2
            gain[thing[k]] += sign * d2
    n_kept = 0
    for k in range(thing.shape[0]):
        is_suspect[k] = is_suspect[k] and gain[thing[k]] > 0.0
        n_kept += is_suspect[k]
    return n_kept


@kernel
def count_supported(
    points_at: FloatArray,
    points_before: FloatArray,
    is_used: BoolArray,
    map_points: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    owner: "np.ndarray",
    T_keyframes: FloatArray,
    reach: float,
    x: float,
    y: float,
    parallax: float,
    out: IntArray,
) -> None:
    """Count in `out` (3, 2) the used points near the map: [at the first pose, at the second, at both], [near, far].

    Near: the local map's point is of a keyframe within `parallax` [m] of the robot (x, y); at both poses that of the
    first counts.
    """
    out[:] = 0
    reach2 = reach * reach
    for k in range(points_at.shape[0]):
        if not is_used[k]:
            continue
        m = partner(points_at[k, 0], points_at[k, 1], map_points, nearest, inv_cell, first, reach2)
        before = partner(
            points_before[k, 0], points_before[k, 1], map_points, nearest, inv_cell, first, reach2
        )
        if m < 0 and before < 0:
            continue
        if before < 0:
            row = 0
        elif m < 0:
            row = 1
        else:
            row = 2
        T_keyframe = T_keyframes[owner[before if m < 0 else m]]
        out[row, 1 if _is_seen_from_elsewhere(T_keyframe, x, y, parallax) else 0] += 1
