"""Kernels of the memory of hits: how often static points lay in each cell of a grid that rolls along."""

import math

import numpy as np
import numpy.typing as npt

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection._cluster_kernels import find_clusters
from slammot_graph.detection.reasons import FREE, FURNITURE, NOT_VALID


@kernel
def count_hits(
    counts: "npt.NDArray[np.int32]",
    stamp: "npt.NDArray[np.int32]",
    inv_resolution: float,
    now: int,
    oldest: int,
    points: FloatArray,
    is_valid: BoolArray,
    is_static: BoolArray,
    most_moving: float,
) -> None:
    """Count one more for each cell with a static point of scan `now`, one less for each with another valid one.

    Nothing where more than the share `most_moving` of the valid points is not static. The first point of a scan in a
    cell decides; none counts less than 0. A cell that was not hit since `oldest` starts anew.
    """
    row_mask = counts.shape[0] - 1
    col_mask = counts.shape[1] - 1
    n_valid = n_static = 0
    for k in range(points.shape[0]):
        n_valid += is_valid[k]
        n_static += is_static[k]
    if n_valid - n_static > most_moving * n_valid:
        return
    for k in range(points.shape[0]):
        if not is_valid[k]:
            continue
        i = math.floor(points[k, 1] * inv_resolution) & row_mask
        j = math.floor(points[k, 0] * inv_resolution) & col_mask
        if stamp[i, j] == now:
            continue
        before = counts[i, j] if stamp[i, j] >= oldest else 0
        counts[i, j] = before + 1 if is_static[k] else max(before - 1, 0)
        stamp[i, j] = now


@kernel
def was_hit(
    counts: "npt.NDArray[np.int32]",
    stamp: "npt.NDArray[np.int32]",
    inv_resolution: float,
    oldest: int,
    points: FloatArray,
    reason: IntArray,
    min_hits: int,
    most_moving: float,
    out: BoolArray,
) -> bool:
    """Mark in `out` the FREE points in cells that count at least so many hits; tell whether there is one.

    False where more than the share `most_moving` of the valid points is FREE.
    """
    row_mask = counts.shape[0] - 1
    col_mask = counts.shape[1] - 1
    is_any = False
    n_valid = n_free = 0
    for k in range(points.shape[0]):
        out[k] = False
        n_valid += 1 if reason[k] != NOT_VALID else 0
        if reason[k] != FREE:
            continue
        n_free += 1
        i = math.floor(points[k, 1] * inv_resolution) & row_mask
        j = math.floor(points[k, 0] * inv_resolution) & col_mask
        out[k] = stamp[i, j] >= oldest and counts[i, j] >= min_hits
        is_any = is_any or out[k]
    return is_any and n_free <= most_moving * n_valid


@kernel
def call_furniture(
    points: FloatArray,
    cluster: IntArray,
    n_clusters: int,
    was_hit: BoolArray,
    min_share: float,
    expected: FloatArray,
    reach: float,
    reason: IntArray,
) -> None:
    """Set `reason` to FURNITURE on clusters with that share of points hit before, none within reach of `expected`."""
    n = np.zeros(n_clusters, dtype=np.int64)
    n_before = np.zeros(n_clusters, dtype=np.int64)
    is_expected = np.zeros(n_clusters, dtype=np.bool_)
    for k in range(points.shape[0]):
        c = cluster[k]
        if c < 0:
            continue
        n[c] += 1
        n_before[c] += 1 if was_hit[k] else 0
        for m in range(expected.shape[0]):
            if math.hypot(points[k, 0] - expected[m, 0], points[k, 1] - expected[m, 1]) < reach:
                is_expected[c] = True
    for k in range(points.shape[0]):
        c = cluster[k]
        if c >= 0 and not is_expected[c] and n_before[c] >= min_share * n[c]:
            reason[k] = FURNITURE


@kernel
def find_furniture(
    counts: "npt.NDArray[np.int32]",
    stamp: "npt.NDArray[np.int32]",
    inv_resolution: float,
    oldest: int,
    points: FloatArray,
    reason: IntArray,
    min_hits: int,
    most_moving: float,
    min_share: float,
    expected: FloatArray,
    reach: float,
    max_gap: float,
    max_skipped_beams: int,
    min_points: int,
    max_x_range: float,
    max_y_range: float,
    split_gap: float,
    split_min_points: int,
) -> None:
    """Set `reason` to FURNITURE on the clusters of FREE points that were hit before: `was_hit`, `call_furniture`."""
    n = points.shape[0]
    k = 0
    while k < n and reason[k] != FREE:
        k += 1
    if k == n:
        return
    is_hit_before = np.empty(n, dtype=np.bool_)
    if not was_hit(
        counts, stamp, inv_resolution, oldest, points, reason, min_hits, most_moving, is_hit_before
    ):
        return
    is_free = np.empty(n, dtype=np.bool_)
    for k in range(n):
        is_free[k] = reason[k] == FREE
    cluster = np.empty(n, dtype=np.int64)
    n_clusters = find_clusters(
        points, is_free, max_gap, max_skipped_beams, min_points, max_x_range, max_y_range,
        split_gap, split_min_points, cluster,
    )  # fmt: skip
    call_furniture(points, cluster, n_clusters, is_hit_before, min_share, expected, reach, reason)


@kernel
def leave_near(
    points: FloatArray, is_static: BoolArray, places: FloatArray, reach: float, out: BoolArray
) -> None:
    """Fill `out` with the static points that are farther than `reach` [m] from all places (k, 2)."""
    for k in range(points.shape[0]):
        out[k] = is_static[k]
        if not is_static[k]:
            continue
        for m in range(places.shape[0]):
            if math.hypot(points[k, 0] - places[m, 0], points[k, 1] - places[m, 1]) < reach:
                out[k] = False
                break
