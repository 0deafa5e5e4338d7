"""Kernels of the moving-point test: end-point covariances, ellipses on the grid, clusters of beams."""

import math

import numpy as np

from slammot_graph._numba import kernel
from slammot_graph.motion.reasons import DISCARDED, FREE, NOT_VALID, OCCUPIED, TOO_UNCERTAIN, UNKNOWN
from slammot_graph.types import BoolArray, FloatArray, IntArray


@kernel
def end_point_covariances(
    ranges: FloatArray,
    directions_base: FloatArray,
    origin_base: FloatArray,
    theta: float,
    cov_pose: FloatArray,
    range_std: float,
    angle_std: float,
    out: FloatArray,
) -> None:
    """Fill `out` (n, 3) with (xx, xy, yy) of each end point's covariance in the frame of the pose (eq. 9).

    ``H_r R_r H_r' + H_l R_l H_l'`` with the pose perturbed in the body frame: ``H_r = R [I | (-py, px)']`` and
    ``H_l = R [u | r u_perp]``.
    """
    c = math.cos(theta)
    s = math.sin(theta)
    for k in range(ranges.shape[0]):
        r = ranges[k]
        ux = directions_base[k, 0]
        uy = directions_base[k, 1]
        px = origin_base[0] + r * ux
        py = origin_base[1] + r * uy
        # H_r R_r H_r' in the base frame, J = [I | (-py, px)']
        xx = cov_pose[0, 0] - 2.0 * py * cov_pose[0, 2] + py * py * cov_pose[2, 2]
        xy = cov_pose[0, 1] + px * cov_pose[0, 2] - py * cov_pose[1, 2] - px * py * cov_pose[2, 2]
        yy = cov_pose[1, 1] + 2.0 * px * cov_pose[1, 2] + px * px * cov_pose[2, 2]
        # H_l R_l H_l'
        var_r = range_std * range_std
        var_t = r * r * angle_std * angle_std
        xx += var_r * ux * ux + var_t * uy * uy
        xy += (var_r - var_t) * ux * uy
        yy += var_r * uy * uy + var_t * ux * ux
        # into the frame of the pose
        out[k, 0] = c * c * xx - 2.0 * c * s * xy + s * s * yy
        out[k, 1] = c * s * (xx - yy) + (c * c - s * s) * xy
        out[k, 2] = s * s * xx + 2.0 * c * s * xy + c * c * yy


@kernel
def _edge_distance2(ax: float, ay: float, bx: float, by: float, p: float, q: float, r: float) -> float:
    """Least of ``v' [[p, q], [q, r]] v`` over v on the segment from a to b."""
    ex = bx - ax
    ey = by - ay
    ee = p * ex * ex + 2.0 * q * ex * ey + r * ey * ey
    ae = p * ax * ex + q * (ax * ey + ay * ex) + r * ay * ey
    t = min(max(-ae / ee, 0.0), 1.0)
    vx = ax + t * ex
    vy = ay + t * ey
    return p * vx * vx + 2.0 * q * vx * vy + r * vy * vy


@kernel
def _touches(dx: float, dy: float, size: float, p: float, q: float, r: float, limit2: float) -> bool:
    """Tell whether the ellipse ``v' [[p, q], [q, r]] v <= limit2`` at 0 touches the cell with lower corner (dx, dy)."""
    if dx <= 0.0 and dy <= 0.0 and dx + size >= 0.0 and dy + size >= 0.0:
        return True
    x1 = dx + size
    y1 = dy + size
    return (
        _edge_distance2(dx, dy, x1, dy, p, q, r) <= limit2
        or _edge_distance2(dx, y1, x1, y1, p, q, r) <= limit2
        or _edge_distance2(dx, dy, dx, y1, p, q, r) <= limit2
        or _edge_distance2(x1, dy, x1, y1, p, q, r) <= limit2
    )


@kernel
def ellipse_test(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    resolution: float,
    oldest: int,
    is_fixed: bool,
    l_free: float,
    l_occupied: float,
    points: FloatArray,
    cov: FloatArray,
    is_valid: BoolArray,
    n_sigma: float,
    max_cells: int,
    margin_cells: int,
    out: IntArray,
) -> None:
    """Fill `out` with what the cells under each end point's ellipse say: FREE only if every one of them is free.

    `cov` is (n, 3): xx, xy, yy. The first cell that is not free decides; an ellipse that spans more than
    `max_cells` cells is TOO_UNCERTAIN. With a margin, the cells around the end point's own count too.
    """
    rows, cols = log_odds.shape
    inv_resolution = 1.0 / resolution
    for k in range(points.shape[0]):
        if not is_valid[k]:
            out[k] = NOT_VALID
            continue
        x = points[k, 0]
        y = points[k, 1]
        half_x = n_sigma * math.sqrt(cov[k, 0])
        half_y = n_sigma * math.sqrt(cov[k, 2])
        i_c = math.floor(y * inv_resolution)
        j_c = math.floor(x * inv_resolution)
        i_lo = min(math.floor((y - half_y) * inv_resolution), i_c - margin_cells)
        i_hi = max(math.floor((y + half_y) * inv_resolution), i_c + margin_cells)
        j_lo = min(math.floor((x - half_x) * inv_resolution), j_c - margin_cells)
        j_hi = max(math.floor((x + half_x) * inv_resolution), j_c + margin_cells)
        det = cov[k, 0] * cov[k, 2] - cov[k, 1] * cov[k, 1]
        p = cov[k, 2] / det
        q = -cov[k, 1] / det
        r = cov[k, 0] / det
        verdict = FREE
        # the cell of the end point itself first: it decides nearly always
        for m in range(-1, (i_hi - i_lo + 1) * (j_hi - j_lo + 1)):
            if m < 0:
                i = i_c
                j = j_c
            else:
                i = i_lo + m // (j_hi - j_lo + 1)
                j = j_lo + m % (j_hi - j_lo + 1)
            i_s = i - row0
            j_s = j - col0
            if is_fixed and (i_s < 0 or i_s >= rows or j_s < 0 or j_s >= cols):
                value = 0.0
            else:
                i_s &= rows - 1
                j_s &= cols - 1
                value = log_odds[i_s, j_s] if stamp[i_s, j_s] >= oldest else 0.0
            if value < l_free:
                if m < 0 and (i_hi - i_lo + 1) * (j_hi - j_lo + 1) > max_cells:
                    verdict = TOO_UNCERTAIN
                    break
                continue
            if max(abs(i - i_c), abs(j - j_c)) > margin_cells and not _touches(
                j * resolution - x, i * resolution - y, resolution, p, q, r, n_sigma * n_sigma
            ):
                continue
            verdict = OCCUPIED if value > l_occupied else UNKNOWN
            break
        out[k] = verdict


@kernel
def near_places(
    points: FloatArray, reason: IntArray, places: FloatArray, reach: float, out: BoolArray
) -> bool:
    """Mark in `out` the UNKNOWN or DISCARDED points within `reach` [m] of a place (k, 2); tell whether there is one."""
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
    return is_any


@kernel
def seen_through(
    points: FloatArray,
    is_used: BoolArray,
    T_laser: FloatArray,
    angle_min: float,
    angle_increment: float,
    ranges: FloatArray,
    is_valid: BoolArray,
    margin: float,
    min_run: int,
    out: BoolArray,
) -> None:
    """Mark in `out` the used points, in beam order, that the beams of a later scan pass by at least `margin` [m].

    The beam towards a point and both its neighbours must be valid and reach beyond it; runs of fewer than `min_run`
    such points, with no other used one in between, do not count. `T_laser` is in the frame of the points.
    """
    c = math.cos(T_laser[2])
    s = math.sin(T_laser[2])
    turn = math.copysign(2.0 * math.pi, angle_increment)
    first = -1
    run = 0
    for k in range(points.shape[0]):
        out[k] = False
        if not is_used[k]:
            continue
        dx = points[k, 0] - T_laser[0]
        dy = points[k, 1] - T_laser[1]
        angle = math.atan2(-s * dx + c * dy, c * dx + s * dy) - angle_min
        angle -= turn * math.floor(angle / turn)
        m = math.floor(angle / angle_increment + 0.5)
        passes = m >= 1 and m < ranges.shape[0] - 1
        if passes:
            past = math.sqrt(dx * dx + dy * dy) + margin
            for i in range(m - 1, m + 2):
                passes = passes and is_valid[i] and ranges[i] > past
        if not passes:
            run = 0
            continue
        run += 1
        first = k if run == 1 else first
        if run == min_run:
            for i in range(first, k):
                out[i] = is_used[i]
        out[k] = run >= min_run


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
    for k in range(labels.shape[0]):
        c = labels[k]
        if c < 0:
            continue
        x = points[k, 0]
        y = points[k, 1]
        if counts[c] == 0:
            box[c, 0] = x
            box[c, 1] = x
            box[c, 2] = y
            box[c, 3] = y
        else:
            box[c, 0] = min(box[c, 0], x)
            box[c, 1] = max(box[c, 1], x)
            box[c, 2] = min(box[c, 2], y)
            box[c, 3] = max(box[c, 3], y)
        counts[c] += 1
    for c in range(n_clusters):
        is_kept[c] = (
            counts[c] >= min_points
            and box[c, 1] - box[c, 0] <= max_x_range
            and box[c, 3] - box[c, 2] <= max_y_range
        )


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
    for k in range(cluster.shape[0]):
        c = cluster[k]
        if c < 0:
            continue
        x = points[k, 0]
        y = points[k, 1]
        i = (math.floor(y * inv_resolution) - row0) & (log_odds.shape[0] - 1)
        j = (math.floor(x * inv_resolution) - col0) & (log_odds.shape[1] - 1)
        if sums[c, 0] == 0.0:
            box[c, 0] = box[c, 1] = x
            box[c, 2] = box[c, 3] = y
        box[c, 0] = min(box[c, 0], x)
        box[c, 1] = max(box[c, 1], x)
        box[c, 2] = min(box[c, 2], y)
        box[c, 3] = max(box[c, 3], y)
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
