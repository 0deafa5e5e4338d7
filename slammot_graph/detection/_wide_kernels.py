"""Kernels that tell apart what lies on free cells and is too wide for a person: it may ride along with the robot."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection._cluster_kernels import cluster_beams, discard_clusters
from slammot_graph.detection._kernels import log_odds_at
from slammot_graph.detection.reasons import (
    ALONG,
    COME_UP,
    DISCARDED,
    FREE,
    OCCUPIED,
    TOO_WIDE,
    TRACKED,
    UNKNOWN,
    VACATED,
)

LEAST_OCCUPIED = 0.1
"""Share of the valid beams on occupied cells that tells that the robot is where it is thought to be."""

WALL_M, LEAST_WALL_M, OFF_LINE_M = 1.5, 1.0, 0.1
"""A wall goes on straight: the line through its last `WALL_M`, at least `LEAST_WALL_M`, and how far off it [m]."""


@kernel
def _stands_off(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    resolution: float,
    oldest: int,
    is_fixed: bool,
    l_occupied: float,
    x: float,
    y: float,
    reach: float,
) -> bool:
    """Tell whether no occupied cell is within `reach` [m], in whole cells, of the cell of a point (x, y)."""
    i_c = math.floor(y / resolution)
    j_c = math.floor(x / resolution)
    n = round(reach / resolution)
    for i in range(i_c - n, i_c + n + 1):
        for j in range(j_c - n, j_c + n + 1):
            is_near = (i - i_c) ** 2 + (j - j_c) ** 2 <= n * n
            if is_near and log_odds_at(log_odds, stamp, row0, col0, oldest, is_fixed, i, j) > l_occupied:
                return False
    return True


@kernel
def mark_wide(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    resolution: float,
    oldest: int,
    is_fixed: bool,
    l_occupied: float,
    points: FloatArray,
    is_valid: BoolArray,
    mapped_share: float,
    off_wall: float,
    max_gap: float,
    max_skipped_beams: int,
    max_x_range: float,
    max_y_range: float,
    reason: IntArray,
) -> None:
    """Change the `reason` (n,) of beams from DISCARDED where, with what moves beside, they are too wide for a person.

    To COME_UP where most of the group is farther than `off_wall` [m] from all occupied cells of the grid and not in
    line with a wall beside it, to TOO_WIDE where those and what moves are more than `mapped_share` of the valid beams.
    Then beams on unknown cells become COME_UP where most of the group that they belong to is on free ones: close to a
    wall no cell is known to be free. Where fewer than `LEAST_OCCUPIED` of the valid beams are on occupied cells, the
    pose may be wrong, and none has.
    """
    n = points.shape[0]
    is_member = np.empty(n, dtype=np.bool_)
    n_valid = n_members = n_discarded = n_occupied = 0
    for k in range(n):
        is_member[k] = reason[k] in (DISCARDED, FREE, VACATED, TRACKED, ALONG)
        n_valid += is_valid[k]
        n_members += is_member[k]
        n_discarded += reason[k] == DISCARDED
        n_occupied += reason[k] == OCCUPIED
    if n_members == 0:
        return
    is_placed = n_occupied >= LEAST_OCCUPIED * n_valid
    is_much = n_members > mapped_share * n_valid
    if n_discarded > 0:
        labels = np.empty(n, dtype=np.int64)
        is_wide = _wide_groups(
            points, is_member, max_gap, max_skipped_beams, max_x_range, max_y_range, labels
        )
        surplus = np.zeros(is_wide.shape[0], dtype=np.int64)
        for k in range(n):
            if is_placed and math.isfinite(off_wall) and labels[k] >= 0 and is_wide[labels[k]]:
                stands_off = _stands_off(
                    log_odds,
                    stamp,
                    row0,
                    col0,
                    resolution,
                    oldest,
                    is_fixed,
                    l_occupied,
                    points[k, 0],
                    points[k, 1],
                    off_wall,
                )
                surplus[labels[k]] += 1 if stands_off else -1
        _drop_walls(points, labels, max_gap, max_skipped_beams, reason, surplus)
        for k in range(n):
            if reason[k] == DISCARDED and labels[k] >= 0 and is_wide[labels[k]]:
                if surplus[labels[k]] > 0:
                    reason[k] = COME_UP
                elif is_much:
                    reason[k] = TOO_WIDE
    if is_placed:
        _go_on(points, max_gap, max_skipped_beams, reason)


@kernel
def _wide_groups(
    points: FloatArray,
    is_member: BoolArray,
    max_gap: float,
    max_skipped_beams: int,
    max_x_range: float,
    max_y_range: float,
    labels: IntArray,
) -> BoolArray:
    """Number in `labels` (n,) the groups of the members, -1 for others; gives which are too wide for a person."""
    n_clusters = cluster_beams(points, is_member, max_gap, max_skipped_beams, labels)
    is_kept = np.empty(n_clusters, dtype=np.bool_)
    discard_clusters(points, labels, n_clusters, 0, max_x_range, max_y_range, is_kept)
    return ~is_kept


@kernel
def _drop_walls(
    points: FloatArray,
    labels: IntArray,
    max_gap: float,
    max_skipped_beams: int,
    reason: IntArray,
    surplus: IntArray,
) -> None:
    """Set the `surplus` of the groups in `labels` (n,) to 0 that are in line with a wall from which they go on.

    Cells along a wall are free where beams pass it at a grazing angle before any hits it, or where it is of glass.
    """
    if not np.any(surplus > 0):
        return
    n = points.shape[0]
    is_joined = np.empty(n, dtype=np.bool_)
    for k in range(n):
        is_joined[k] = labels[k] >= 0 or reason[k] in (OCCUPIED, UNKNOWN)
    joined = np.empty(n, dtype=np.int64)
    cluster_beams(points, is_joined, max_gap, max_skipped_beams, joined)
    for c in range(surplus.shape[0]):
        if surplus[c] <= 0:
            continue
        first = last = -1
        for k in range(n):
            if labels[k] == c:
                first = k if first < 0 else first
                last = k
        for step in (-1, 1):
            k = first if step < 0 else last
            while 0 <= k < n and (joined[k] != joined[first] or reason[k] != OCCUPIED):
                k += step
            if 0 <= k < n and _is_in_line(points, labels, c, reason, joined, k, step):
                surplus[c] = 0


@kernel
def _is_in_line(
    points: FloatArray,
    labels: IntArray,
    c: int,
    reason: IntArray,
    joined: IntArray,
    begin: int,
    step: int,
) -> bool:
    """Tell whether most of group `c` lies on the line through the wall that begins at a beam, seen in steps."""
    n = sx = sy = sxx = sxy = syy = reach = 0.0
    k = begin
    while 0 <= k < points.shape[0]:
        if reason[k] == OCCUPIED and joined[k] == joined[begin]:
            x = points[k, 0] - points[begin, 0]
            y = points[k, 1] - points[begin, 1]
            if x * x + y * y > WALL_M * WALL_M:
                break
            reach = max(reach, x * x + y * y)
            n += 1.0
            sx += x
            sy += y
            sxx += x * x
            sxy += x * y
            syy += y * y
        k += step
    if reach < LEAST_WALL_M * LEAST_WALL_M:
        return False
    sx /= n
    sy /= n
    angle = 0.5 * math.atan2(2.0 * (sxy / n - sx * sy), sxx / n - sx * sx - (syy / n - sy * sy))
    n_on = n_off = 0
    for k in range(points.shape[0]):
        if labels[k] == c:
            x = points[k, 0] - points[begin, 0] - sx
            y = points[k, 1] - points[begin, 1] - sy
            if abs(y * math.cos(angle) - x * math.sin(angle)) <= OFF_LINE_M:
                n_on += 1
            else:
                n_off += 1
    return n_on > n_off


@kernel
def _go_on(points: FloatArray, max_gap: float, max_skipped_beams: int, reason: IntArray) -> None:
    """Call beams on unknown cells COME_UP where most of the group that they belong to is on free ones.

    Not where the group is in line with a wall beside it: walls come into sight bit by bit.
    """
    n = points.shape[0]
    is_member = np.empty(n, dtype=np.bool_)
    for k in range(n):
        is_member[k] = reason[k] in (UNKNOWN, COME_UP, TOO_WIDE, FREE, VACATED, TRACKED, ALONG)
    labels = np.empty(n, dtype=np.int64)
    n_clusters = cluster_beams(points, is_member, max_gap, max_skipped_beams, labels)
    surplus, has_unknown = np.zeros(n_clusters, dtype=np.int64), np.zeros(n_clusters, dtype=np.bool_)
    for k in range(n):
        if labels[k] >= 0:
            surplus[labels[k]] += -1 if reason[k] == UNKNOWN else 1
            has_unknown[labels[k]] |= reason[k] == UNKNOWN
    surplus[~has_unknown] = 0
    _drop_walls(points, labels, max_gap, max_skipped_beams, reason, surplus)
    for k in range(n):
        if labels[k] >= 0 and reason[k] == UNKNOWN and surplus[labels[k]] > 0:
            reason[k] = COME_UP
