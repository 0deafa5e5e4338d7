"""Kernels of the local map: normals, and the nearest-point field."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray

LINE_FIRST_M2 = 0.04
"""A point without a normal takes a cell from one with a normal only if it is so much nearer [m^2]."""

NOISE_REACH_M, LEAST_TOLD = 0.2, 0.25
"""Lines up to this far on either side tell the noise of the ranges, at no smaller squared cosine to their normal."""

N_SIGMA = 3.0
"""A line takes in a neighbour unless the squared residuals are more than their noise explains (chi-square)."""


@kernel
def estimate_normals(
    points: FloatArray,
    is_member: BoolArray,
    laser: FloatArray,
    half_window: int,
    max_gap: float,
    max_gap_slope: float,
    max_thickness: float,
    max_std: float,
    out: FloatArray,
) -> None:
    """Fill `out` (n, 2) with unit normals from neighbouring beams, towards the laser; (0, 0) on no line.

    The neighbours of a beam are up to `half_window` member beams on either side, as long as each is within
    `max_gap` [m] + `max_gap_slope` times the range of the one before; the points must lie within `max_thickness`
    [m] of their line. Of a wall close by so many beams see a few centimetres, and their noise turns the line: where its
    direction is not known to `max_std` [rad] there are more neighbours, as long as they lie on the line as well.
    """
    n = points.shape[0]
    ends = np.empty((n, 2), dtype=np.int64)
    sums = np.zeros((n, 5))
    variances, whole = np.empty(n), np.empty(5)
    n_told = 0
    for k in range(n):
        out[k, 0] = 0.0
        out[k, 1] = 0.0
        if not is_member[k]:
            continue
        gap2 = _gap2(points, k, max_gap, max_gap_slope)
        lo = k
        while k - lo < half_window and _is_next(points, is_member, lo, lo - 1, gap2):
            lo -= 1
            _add_point(points, k, lo, 1.0, sums[k])
        hi = k
        while hi - k < half_window and _is_next(points, is_member, hi, hi + 1, gap2):
            hi += 1
            _add_point(points, k, hi, 1.0, sums[k])
        ends[k, 0] = lo
        ends[k, 1] = hi
        count = hi - lo + 1
        variance = _range_variance(points, is_member, k, lo, hi, gap2, sums[k], whole)
        if variance >= 0.0:
            variances[n_told] = variance
            n_told += 1
    noise2 = min(np.median(variances[:n_told]), max_thickness * max_thickness) if n_told > 0 else 0.0
    for k in range(n):
        if not is_member[k]:
            continue
        lo = ends[k, 0]
        hi = ends[k, 1]
        count = hi - lo + 1
        if count < 3:
            _grazed_normal(points, is_member, k, max_thickness, out)
            _turn_to(laser, points, k, out)
            continue
        smallest, largest, cos2, sin2 = _line(sums[k], count)
        if smallest > count * max_thickness * max_thickness or largest - smallest < 2e-9:
            continue
        gap2 = _gap2(points, k, max_gap, max_gap_slope)
        own2 = max(noise2, smallest / (count - 2))
        grows_down = grows_up = True
        while (grows_down or grows_up) and max(noise2, smallest / (count - 2)) > max_std * max_std * largest:
            for side in range(2):
                if not (grows_up if side else grows_down):
                    continue
                end, new = (hi, hi + 1) if side else (lo, lo - 1)
                fits = _is_next(points, is_member, end, new, gap2)
                if fits:
                    _add_point(points, k, new, 1.0, sums[k])
                    grown = _line(sums[k], count + 1)
                    fits = grown[0] <= own2 * (count - 1 + N_SIGMA * math.sqrt(2.0 * (count - 1)))
                    fits = fits and grown[0] <= (count + 1) * max_thickness * max_thickness
                    if fits:
                        smallest, largest, cos2, sin2 = grown
                        count += 1
                    else:
                        _add_point(points, k, new, -1.0, sums[k])
                if side:
                    grows_up = fits
                    hi += fits
                else:
                    grows_down = fits
                    lo -= fits
        angle = 0.5 * math.atan2(sin2, cos2)
        out[k, 0] = -math.sin(angle)
        out[k, 1] = math.cos(angle)
        _turn_to(laser, points, k, out)


@kernel
def _range_variance(
    points: FloatArray,
    is_member: BoolArray,
    k: int,
    lo: int,
    hi: int,
    gap2: float,
    sums: FloatArray,
    whole: FloatArray,
) -> float:
    """Variance of the ranges about the line through the neighbours of point `k`, and all within `NOISE_REACH_M`.

    A few ranges that were rounded to the same value show no noise, and walls at grazing angles little: -1 there.
    `whole` (5,) is working memory.
    """
    whole[:] = sums
    for side in range(2):
        step = 1 if side else -1
        end = hi if side else lo
        while _is_next(points, is_member, end, end + step, gap2):
            end += step
            dx = points[end, 0] - points[k, 0]
            dy = points[end, 1] - points[k, 1]
            if dx * dx + dy * dy > NOISE_REACH_M * NOISE_REACH_M:
                end -= step
                break
            _add_point(points, k, end, 1.0, whole)
        if side:
            hi = end
        else:
            lo = end
    count = hi - lo + 1
    if count < 4:
        return -1.0
    smallest, _, cos2, sin2 = _line(whole, count)
    angle = 0.5 * math.atan2(sin2, cos2)
    across = points[k, 1] * math.cos(angle) - points[k, 0] * math.sin(angle)
    told = across * across / (points[k, 0] ** 2 + points[k, 1] ** 2)
    return float(smallest / ((count - 2) * told)) if told > LEAST_TOLD else -1.0


@kernel
def _gap2(points: FloatArray, k: int, max_gap: float, max_gap_slope: float) -> float:
    """Squared largest step from one neighbour of point `k` to the next."""
    gap = max_gap + max_gap_slope * math.sqrt(points[k, 0] ** 2 + points[k, 1] ** 2)
    return float(gap * gap)


@kernel
def _is_next(points: FloatArray, is_member: BoolArray, end: int, new: int, gap2: float) -> bool:
    """Tell whether the line goes on from point `end` to `new`."""
    if new < 0 or new >= points.shape[0] or not is_member[new]:
        return False
    dx = points[new, 0] - points[end, 0]
    dy = points[new, 1] - points[end, 1]
    return bool(dx * dx + dy * dy <= gap2)


@kernel
def _add_point(points: FloatArray, k: int, new: int, sign: float, sums: FloatArray) -> None:
    """Add point `new` to the sums (5,) x, y, xx, xy, yy about point `k`, or take it away."""
    x = points[new, 0] - points[k, 0]
    y = points[new, 1] - points[k, 1]
    sums[0] += sign * x
    sums[1] += sign * y
    sums[2] += sign * x * x
    sums[3] += sign * x * y
    sums[4] += sign * y * y


@kernel
def _line(sums: FloatArray, count: int) -> tuple[float, float, float, float]:
    """Give the smaller and the larger eigenvalue of the scatter of `count` points, and the larger one's direction.

    That is half the angle of (cos, sin) as they stand at the end: most lines are not asked for it.
    """
    xx = sums[2] - sums[0] * sums[0] / count
    xy = sums[3] - sums[0] * sums[1] / count
    yy = sums[4] - sums[1] * sums[1] / count
    half_trace = 0.5 * (xx + yy)
    root = math.sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 0.0))
    return max(half_trace - root, 0.0), half_trace + root, xx - yy, 2.0 * xy


@kernel
def _turn_to(laser: FloatArray, points: FloatArray, k: int, out: FloatArray) -> None:
    """Let normal `k` look towards the laser."""
    if out[k, 0] * (laser[0] - points[k, 0]) + out[k, 1] * (laser[1] - points[k, 1]) < 0.0:
        out[k, 0] = -out[k, 0]
        out[k, 1] = -out[k, 1]


@kernel
def _grazed_normal(
    points: FloatArray, is_member: BoolArray, k: int, max_thickness: float, out: FloatArray
) -> None:
    """Give point `k` the normal of the line through the points before and after it, if it lies on that line.

    Beams that graze a wall hit it far apart; such points must not pass for landmarks, since they move along the
    wall with the robot.
    """
    if k == 0 or k == points.shape[0] - 1 or not (is_member[k - 1] and is_member[k + 1]):
        return
    ax = points[k, 0] - points[k - 1, 0]
    ay = points[k, 1] - points[k - 1, 1]
    bx = points[k + 1, 0] - points[k, 0]
    by = points[k + 1, 1] - points[k, 1]
    a = math.sqrt(ax * ax + ay * ay)
    b = math.sqrt(bx * bx + by * by)
    if ax * bx + ay * by <= 0.0 or max(a, b) > 4.0 * min(a, b):
        return
    dx = points[k + 1, 0] - points[k - 1, 0]
    dy = points[k + 1, 1] - points[k - 1, 1]
    length = math.sqrt(dx * dx + dy * dy)
    if abs(ax * dy - ay * dx) / length > 2.0 * max_thickness:
        return
    out[k, 0] = -dy / length
    out[k, 1] = dx / length


@kernel
def insert_points(
    map_points: FloatArray,
    map_normals: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    n_points: int,
    new_points: FloatArray,
    new_normals: FloatArray,
    is_new: BoolArray,
    min_spacing: float,
    reach_cells: int,
) -> int:
    """Add points to the nearest-point field; returns the new number of points.

    `nearest` (side, side), side a power of two, wraps around: cell (i & mask, j & mask) holds the number of the map
    point nearest to the cell's centre, among points numbered `first` and up. A point nearer than `min_spacing` to
    the one already there is left out, unless the two lie on different lines. Numbers are stored modulo the capacity,
    a power of two.
    """
    mask = nearest.shape[0] - 1
    capacity = map_points.shape[0]
    wrap = capacity - 1
    cell = 1.0 / inv_cell
    for k in range(new_points.shape[0]):
        if not is_new[k]:
            continue
        if n_points - first >= capacity:
            break
        x = new_points[k, 0]
        y = new_points[k, 1]
        ic = math.floor(y * inv_cell)
        jc = math.floor(x * inv_cell)
        old = nearest[ic & mask, jc & mask]
        if old >= first:
            dx = map_points[old & wrap, 0] - x
            dy = map_points[old & wrap, 1] - y
            ox = map_normals[old & wrap, 0]
            oy = map_normals[old & wrap, 1]
            alike = ox * new_normals[k, 0] + oy * new_normals[k, 1] > 0.7
            has_no_line = new_normals[k, 0] == 0.0 and new_normals[k, 1] == 0.0
            if dx * dx + dy * dy < min_spacing * min_spacing and (alike or has_no_line):
                continue
        slot = n_points & wrap
        map_points[slot, 0] = x
        map_points[slot, 1] = y
        map_normals[slot, 0] = new_normals[k, 0]
        map_normals[slot, 1] = new_normals[k, 1]
        handicap = LINE_FIRST_M2 if new_normals[k, 0] == 0.0 and new_normals[k, 1] == 0.0 else 0.0
        for i in range(ic - reach_cells, ic + reach_cells + 1):
            cy = (i + 0.5) * cell
            for j in range(jc - reach_cells, jc + reach_cells + 1):
                cx = (j + 0.5) * cell
                other = nearest[i & mask, j & mask]
                if other >= first:
                    ox = map_points[other & wrap, 0] - cx
                    oy = map_points[other & wrap, 1] - cy
                    other2 = ox * ox + oy * oy
                    if map_normals[other & wrap, 0] == 0.0 and map_normals[other & wrap, 1] == 0.0:
                        other2 += LINE_FIRST_M2
                    if other2 <= (x - cx) * (x - cx) + (y - cy) * (y - cy) + handicap:
                        continue
                nearest[i & mask, j & mask] = n_points
        n_points += 1
    return n_points
