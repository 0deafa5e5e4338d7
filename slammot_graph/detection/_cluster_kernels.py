"""Kernels that group moving beams: clusters by distance, what is no person, and what the scans before add."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection.reasons import (
    ABSTAINED,
    ALONG,
    DISCARDED,
    FREE,
    OCCUPIED,
    TRACKED,
    UNKNOWN,
    VACATED,
)


@kernel
def cluster_beams(
    points: FloatArray, is_member: BoolArray, max_gap: float, max_skipped_beams: int, out: IntArray
) -> int:
    """Label member beams with cluster numbers from 0 (-1 for others): subsets by distance, along the scan.

    A beam joins the cluster of any member among the `max_skipped_beams` + 1 beams before it that is nearer than
    `max_gap` [m]; two clusters that a beam ties together become one. Returns the number of clusters.
    """
    n = points.shape[0]
    gap2 = max_gap * max_gap
    parent = np.empty(n, dtype=np.int64)
    for k in range(n):
        parent[k] = k
        if not is_member[k]:
            continue
        for m in range(max(0, k - max_skipped_beams - 1), k):
            if not is_member[m]:
                continue
            dx = points[k, 0] - points[m, 0]
            dy = points[k, 1] - points[m, 1]
            if dx * dx + dy * dy <= gap2:
                a = m
                while parent[a] != a:
                    a = parent[a]
                b = k
                while parent[b] != b:
                    b = parent[b]
                parent[max(a, b)] = min(a, b)
    n_clusters = 0
    for k in range(n):
        out[k] = -1
        if not is_member[k]:
            continue
        if parent[k] == k:
            out[k] = n_clusters
            n_clusters += 1
        else:
            a = parent[k]
            while parent[a] != a:
                a = parent[a]
            out[k] = out[a]
    return n_clusters


@kernel
def cluster_boxes(points: FloatArray, labels: IntArray, box: FloatArray) -> None:
    """Fill `box` (n_clusters, 4) with each cluster's least and largest x, least and largest y."""
    for c in range(box.shape[0]):
        box[c, 0] = box[c, 2] = np.inf
        box[c, 1] = box[c, 3] = -np.inf
    for k in range(labels.shape[0]):
        c = labels[k]
        if c >= 0:
            box[c, 0] = min(box[c, 0], points[k, 0])
            box[c, 1] = max(box[c, 1], points[k, 0])
            box[c, 2] = min(box[c, 2], points[k, 1])
            box[c, 3] = max(box[c, 3], points[k, 1])


@kernel
def discard_clusters(
    points: FloatArray,
    labels: IntArray,
    n_clusters: int,
    min_points: int,
    max_x_range: float,
    max_y_range: float,
    is_kept: BoolArray,
) -> None:
    """Mark in `is_kept` (n_clusters,) the clusters with enough points and within MAX X RANGE and MAX Y RANGE."""
    counts = np.zeros(n_clusters, dtype=np.int64)
    box = np.empty((n_clusters, 4))
    cluster_boxes(points, labels, box)
    for k in range(labels.shape[0]):
        if labels[k] >= 0:
            counts[labels[k]] += 1
    for c in range(n_clusters):
        is_kept[c] = (
            counts[c] >= min_points
            and box[c, 1] - box[c, 0] <= max_x_range
            and box[c, 3] - box[c, 2] <= max_y_range
        )


@kernel
def _number_kept(is_kept: BoolArray, first: int, number: IntArray) -> int:
    """Number the kept clusters from `first`, -1 for others; returns the next number."""
    for c in range(is_kept.shape[0]):
        number[c] = first if is_kept[c] else -1
        first += 1 if is_kept[c] else 0
    return first


@kernel
def find_clusters(
    points: FloatArray,
    is_member: BoolArray,
    max_gap: float,
    max_skipped_beams: int,
    min_points: int,
    max_x_range: float,
    max_y_range: float,
    split_gap: float,
    split_min_points: int,
    labels: IntArray,
) -> int:
    """Fill `labels` (n,) with the clusters that may be people, from 0; -1 for others. Returns their number.

    What is too wide or too few is split at gaps of `split_gap`, unless that is 0.
    """
    n = cluster_beams(points, is_member, max_gap, max_skipped_beams, labels)
    if n == 0:
        return 0
    is_kept = np.empty(n, dtype=np.bool_)
    discard_clusters(points, labels, n, min_points, max_x_range, max_y_range, is_kept)
    if is_kept.all():
        return n
    is_wide = np.zeros(points.shape[0], dtype=np.bool_)
    number = np.empty(n, dtype=np.int64)
    n_kept = _number_kept(is_kept, 0, number)
    for k in range(points.shape[0]):
        if labels[k] >= 0:
            is_wide[k] = not is_kept[labels[k]]
            labels[k] = number[labels[k]]
    if split_gap <= 0.0:
        return n_kept
    parts = np.empty(points.shape[0], dtype=np.int64)
    n = cluster_beams(points, is_wide, split_gap, max_skipped_beams, parts)
    is_kept = np.empty(n, dtype=np.bool_)
    discard_clusters(points, parts, n, split_min_points, max_x_range, max_y_range, is_kept)
    number = np.empty(n, dtype=np.int64)
    n_kept = _number_kept(is_kept, n_kept, number)
    for k in range(points.shape[0]):
        if is_wide[k]:
            labels[k] = number[parts[k]]
    return n_kept


@kernel
def near_places(
    points: FloatArray, reason: IntArray, places: FloatArray, reach: float, leave_parts: bool, out: BoolArray
) -> bool:
    """Mark in `out` the UNKNOWN or DISCARDED points within `reach` [m] of a place (k, 2); tell whether there is one.

    With `leave_parts` runs of such points that go on in what does not move are left out: where a tracked object is
    expected stands a wall that it uncovers, or a part of the furniture.
    """
    is_any = False
    for k in range(points.shape[0]):
        out[k] = False
        if reason[k] != UNKNOWN and reason[k] != DISCARDED:
            continue
        for m in range(places.shape[0]):
            if math.hypot(points[k, 0] - places[m, 0], points[k, 1] - places[m, 1]) < reach:
                out[k] = True
                is_any = True
                break
    if not (is_any and leave_parts):
        return is_any
    is_any = False
    first = -1
    n = points.shape[0]
    for k in range(n + 1):
        if k < n and out[k]:
            first = k if first < 0 else first
            continue
        if first < 0:
            continue
        is_part = _goes_on(points, reason, first, first - 1) or _goes_on(points, reason, k - 1, k)
        for m in range(first, k):
            out[m] = not is_part
        is_any = is_any or not is_part
        first = -1
    return is_any


ATTACHED_M = 0.15
"""A neighbouring beam that ends this near belongs to the same thing."""


@kernel
def _goes_on(points: FloatArray, reason: IntArray, k: int, other: int) -> bool:
    """Whether the thing that beam `k` hit goes on at the beam beside it, which does not move."""
    if not 0 <= other < points.shape[0] or (reason[other] != UNKNOWN and reason[other] != OCCUPIED):
        return False
    dx = points[k, 0] - points[other, 0]
    dy = points[k, 1] - points[other, 1]
    return bool(dx * dx + dy * dy < ATTACHED_M * ATTACHED_M)


@kernel
def group_moving(
    points: FloatArray,
    is_valid: BoolArray,
    vacated: FloatArray,
    vacated_reach: float,
    expected: FloatArray,
    expected_reach: float,
    abstain_share: float,
    max_gap: float,
    max_skipped_beams: int,
    min_points: int,
    max_x_range: float,
    max_y_range: float,
    split_gap: float,
    split_min_points: int,
    reason: IntArray,
    cluster: IntArray,
    is_moving: BoolArray,
) -> int:
    """Group the beams FREE or ALONG, then those on unknown cells near places (k, 2) that are empty now or expected.

    Takes `reason` (n,) from the test and completes it, fills `cluster` and `is_moving` (n,); returns the number of
    clusters. If more than `abstain_share` of the valid beams would move, none does.
    """
    n = points.shape[0]
    is_near = np.empty(n, dtype=np.bool_)
    for k in range(n):
        is_moving[k] = reason[k] in (FREE, ALONG)
    n_clusters = find_clusters(
        points, is_moving, max_gap, max_skipped_beams, min_points, max_x_range, max_y_range,
        split_gap, split_min_points, cluster,
    )  # fmt: skip
    for k in range(n):
        is_moving[k] = cluster[k] >= 0
        if reason[k] in (FREE, ALONG) and not is_moving[k]:
            reason[k] = DISCARDED
    for hint in range(2):
        places, reach = (vacated, vacated_reach) if hint == 0 else (expected, expected_reach)
        why, least = (VACATED, min_points) if hint == 0 else (TRACKED, 1)
        if (
            places.shape[0] == 0
            or reach <= 0.0
            or not near_places(points, reason, places, reach, hint == 1, is_near)
        ):
            continue
        for k in range(n):
            is_moving[k] = is_moving[k] or is_near[k]
        n_clusters = find_clusters(
            points, is_moving, max_gap, max_skipped_beams, least, max_x_range, max_y_range,
            split_gap, split_min_points, cluster,
        )  # fmt: skip
        for k in range(n):
            is_moving[k] = cluster[k] >= 0
            if is_near[k]:
                reason[k] = why if is_moving[k] else DISCARDED
    n_valid = n_moving = 0
    for k in range(n):
        n_valid += is_valid[k]
        n_moving += is_moving[k]
        if not is_moving[k] and reason[k] in (FREE, VACATED, TRACKED, ALONG):
            reason[k] = DISCARDED  # as when a wider group took it in
    if n_clusters > 0 and n_moving > abstain_share * n_valid:
        for k in range(n):
            reason[k] = ABSTAINED if is_moving[k] else reason[k]
            is_moving[k] = False
            cluster[k] = -1
        return 0
    return n_clusters


@kernel
def cluster_moments(
    points: FloatArray,
    packed_cov: FloatArray,
    cluster: IntArray,
    reason: IntArray,
    centres: FloatArray,
    covs: FloatArray,
    is_proven: BoolArray,
    starts: IntArray,
    beams: IntArray,
) -> None:
    """Means of the k clusters: `centres` (k, 2), `covs` (k, 2, 2); `is_proven` (k,) by a beam on free cells.

    `beams` gets the beams of cluster 0, of cluster 1 and so on, those of cluster c from ``starts[c]`` to
    ``starts[c + 1]``.
    """
    n_clusters = centres.shape[0]
    centres[:] = 0.0
    covs[:] = 0.0
    is_proven[:] = False
    starts[:] = 0
    for k in range(cluster.shape[0]):
        c = cluster[k]
        if c >= 0:
            starts[c + 1] += 1
            centres[c, 0] += points[k, 0]
            centres[c, 1] += points[k, 1]
            covs[c, 0, 0] += packed_cov[k, 0]
            covs[c, 0, 1] += packed_cov[k, 1]
            covs[c, 1, 1] += packed_cov[k, 2]
            is_proven[c] = is_proven[c] or reason[k] == FREE
    for c in range(n_clusters):
        n = starts[c + 1]
        centres[c, 0] /= n
        centres[c, 1] /= n
        covs[c, 0, 0] /= n
        covs[c, 0, 1] /= n
        covs[c, 1, 1] /= n
        covs[c, 1, 0] = covs[c, 0, 1]
        starts[c + 1] += starts[c]
    filled = starts[:-1].copy()
    for k in range(cluster.shape[0]):
        c = cluster[k]
        if c >= 0:
            beams[filled[c]] = k
            filled[c] += 1


@kernel
def cluster_evidence(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    inv_resolution: float,
    oldest: int,
    l_min: float,
    points: FloatArray,
    ranges: FloatArray,
    cluster: IntArray,
    reason: IntArray,
    expected: FloatArray,
    max_range: float,
    out: FloatArray,
) -> None:
    """Fill `out` (n_clusters, 8) with what speaks for each cluster; see `probability.NAMES`."""
    n_clusters = out.shape[0]
    sums = np.zeros((n_clusters, 6))  # points, ranges, on free cells, log odds, x, y
    box = np.empty((n_clusters, 4))
    cluster_boxes(points, cluster, box)
    for k in range(cluster.shape[0]):
        c = cluster[k]
        if c < 0:
            continue
        x = points[k, 0]
        y = points[k, 1]
        i = (math.floor(y * inv_resolution) - row0) & (log_odds.shape[0] - 1)
        j = (math.floor(x * inv_resolution) - col0) & (log_odds.shape[1] - 1)
        sums[c, 0] += 1.0
        sums[c, 1] += ranges[k]
        sums[c, 2] += 1.0 if reason[k] == FREE else 0.0
        sums[c, 3] += log_odds[i, j] if stamp[i, j] >= oldest else 0.0
        sums[c, 4] += x
        sums[c, 5] += y
    for c in range(n_clusters):
        n = sums[c, 0]
        width = math.sqrt((box[c, 1] - box[c, 0]) ** 2 + (box[c, 3] - box[c, 2]) ** 2)
        nearest2 = np.inf
        for m in range(expected.shape[0]):
            dx = expected[m, 0] - sums[c, 4] / n
            dy = expected[m, 1] - sums[c, 5] / n
            nearest2 = min(nearest2, dx * dx + dy * dy)
        out[c, 0] = 1.0
        out[c, 1] = math.log(n)
        out[c, 2] = min(sums[c, 1] / n, max_range)
        out[c, 3] = 1.0 - sums[c, 2] / n
        out[c, 4] = 1.0 if sums[c, 2] == 0.0 else 0.0
        out[c, 5] = max(sums[c, 3] / n - l_min, 0.0)
        out[c, 6] = math.log(1.0 + width)
        out[c, 7] = 1.0 if nearest2 < 0.36 else 0.0


@kernel
def logistic_of_clusters(
    evidence: FloatArray, weights: FloatArray, cluster: IntArray, out: FloatArray
) -> None:
    """Set the beams of clusters in `out` (n,) to ``1 / (1 + exp(-evidence @ weights))`` of theirs."""
    p = np.empty(evidence.shape[0])
    for c in range(evidence.shape[0]):
        total = 0.0
        for i in range(weights.shape[0]):
            total += evidence[c, i] * weights[i]
        p[c] = 1.0 / (1.0 + math.exp(-total))
    for k in range(cluster.shape[0]):
        if cluster[k] >= 0:
            out[k] = p[cluster[k]]
