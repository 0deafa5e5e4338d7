"""Kernels of the paper's match: nearest points, closed-form pose."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray


@kernel
def pair_points(
    reference: FloatArray,
    is_reference: BoolArray,
    points: FloatArray,
    is_used: BoolArray,
    T: FloatArray,
    max_distance: float,
    max_gap: float,
    partner: IntArray,
    targets: FloatArray,
    distances: FloatArray,
) -> int:
    """Nearest point of the reference for each point at pose `T`; returns how many points are used.

    Neighbours of the reference up to `max_gap` apart are joined by a line, and the nearest place of the line counts
    (Lu and Milios 1997); 0: the points alone. Fills `partner` (index into reference, of the line its first end; -1
    for none nearer than `max_distance`), `targets` (n, 2) and `distances` (n,).
    """
    c = math.cos(T[2])
    s = math.sin(T[2])
    n_used = 0
    for k in range(points.shape[0]):
        partner[k] = -1
        if not is_used[k]:
            continue
        n_used += 1
        x = T[0] + c * points[k, 0] - s * points[k, 1]
        y = T[1] + s * points[k, 0] + c * points[k, 1]
        best = max_distance * max_distance
        near = max_distance + max_gap  # farther from a line's first end, no place of the line is better
        near2 = near * near
        for m in range(reference.shape[0]):
            if not is_reference[m]:
                continue
            dx = reference[m, 0] - x
            dy = reference[m, 1] - y
            d2 = dx * dx + dy * dy
            if d2 < best:
                best = d2
                partner[k] = m
                targets[k, 0] = reference[m, 0]
                targets[k, 1] = reference[m, 1]
                near = math.sqrt(best) + max_gap
                near2 = near * near
            if max_gap == 0.0 or d2 > near2 or m + 1 == reference.shape[0] or not is_reference[m + 1]:
                continue
            lx = reference[m + 1, 0] - reference[m, 0]
            ly = reference[m + 1, 1] - reference[m, 1]
            length2 = lx * lx + ly * ly
            if length2 == 0.0 or length2 > max_gap * max_gap:
                continue
            share = -(lx * dx + ly * dy) / length2
            if share <= 0.0 or share >= 1.0:
                continue
            ex = dx + share * lx
            ey = dy + share * ly
            d2 = ex * ex + ey * ey
            if d2 < best:
                best = d2
                partner[k] = m
                targets[k, 0] = x + ex
                targets[k, 1] = y + ey
                near = math.sqrt(best) + max_gap
                near2 = near * near
        if partner[k] >= 0:
            distances[k] = math.sqrt(best)
    return n_used


@kernel
def match_point_to_point(
    reference: FloatArray,
    is_reference: BoolArray,
    points: FloatArray,
    is_used: BoolArray,
    T_start: FloatArray,
    max_distance: float,
    max_gap: float,
    kept_share: float,
    tau: float,
    max_iterations: int,
    T: FloatArray,
    partner: IntArray,
    stats: FloatArray,
) -> int:
    """Classical ICP (eq. 3 to 5): nearest points, closed-form pose, until d_k - d_(k+1) < tau; returns the iterations.

    `d` is the mean distance of the pairs [m]; pairs beyond `max_distance` are left out, and so are the widest ones but
    for `kept_share`. See `pair_points` for `max_gap`. Fills `T`, `partner` (index into reference, -1 for none) and
    `stats`: points used, pairs, final d, d of the start.
    """
    T[:] = T_start
    n = points.shape[0]
    targets = np.empty((n, 2))
    distances = np.empty(n)
    d_before = np.inf
    iterations = 0
    stats[3] = np.nan
    for iteration in range(max_iterations):
        n_used = pair_points(
            reference, is_reference, points, is_used, T, max_distance, max_gap, partner, targets, distances
        )
        widest = np.inf
        if kept_share < 1.0:
            n_found = 0
            for k in range(n):
                n_found += partner[k] >= 0
            found = np.empty(n_found)
            n_found = 0
            for k in range(n):
                if partner[k] >= 0:
                    found[n_found] = distances[k]
                    n_found += 1
            if n_found > 0:
                widest = np.sort(found)[math.ceil(kept_share * n_found) - 1]
        n_pairs = 0
        total = 0.0
        mx = my = qx = qy = 0.0
        for k in range(n):
            if partner[k] < 0:
                continue
            if distances[k] > widest:
                partner[k] = -1
                continue
            n_pairs += 1
            total += distances[k]
            mx += points[k, 0]
            my += points[k, 1]
            qx += targets[k, 0]
            qy += targets[k, 1]
        iterations = iteration + 1
        stats[0] = n_used
        stats[1] = n_pairs
        if n_pairs < 3:
            stats[2] = np.nan
            break
        d = total / n_pairs
        stats[2] = d
        if iteration == 0:
            stats[3] = d
        if d_before - d < tau:
            break
        d_before = d
        mx /= n_pairs
        my /= n_pairs
        qx /= n_pairs
        qy /= n_pairs
        sin_sum = cos_sum = 0.0
        for k in range(n):
            if partner[k] < 0:
                continue
            ax = points[k, 0] - mx
            ay = points[k, 1] - my
            bx = targets[k, 0] - qx
            by = targets[k, 1] - qy
            sin_sum += ax * by - ay * bx
            cos_sum += ax * bx + ay * by
        theta = math.atan2(sin_sum, cos_sum)
        c = math.cos(theta)
        s = math.sin(theta)
        T[0] = qx - c * mx + s * my
        T[1] = qy - s * mx - c * my
        T[2] = theta
    return iterations
