"""Kernels of the local map: normals, and the nearest-point field."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray

LINE_FIRST_M2 = 0.04
"""A point without a normal takes a cell from one with a normal only if it is so much nearer [m^2]."""


@kernel
def estimate_normals(
    points: FloatArray,
    is_member: BoolArray,
    laser: FloatArray,
    half_window: int,
    max_gap: float,
    max_gap_slope: float,
    max_thickness: float,
    out: FloatArray,
) -> None:
    """Fill `out` (n, 2) with unit normals from neighbouring beams, towards the laser; (0, 0) on no line.

    The neighbours of a beam are up to `half_window` member beams on either side, as long as each is within
    `max_gap` [m] + `max_gap_slope` times the range of the one before; the points must lie within `max_thickness`
    [m] of their line.
    """
    n = points.shape[0]
    for k in range(n):
        out[k, 0] = 0.0
        out[k, 1] = 0.0
        if not is_member[k]:
            continue
        gap = max_gap + max_gap_slope * math.sqrt(points[k, 0] ** 2 + points[k, 1] ** 2)
        gap2 = gap * gap
        sx = points[k, 0]
        sy = points[k, 1]
        lo = k
        while lo > 0 and k - lo < half_window and is_member[lo - 1]:
            dx = points[lo - 1, 0] - points[lo, 0]
            dy = points[lo - 1, 1] - points[lo, 1]
            if dx * dx + dy * dy > gap2:
                break
            lo -= 1
            sx += points[lo, 0]
            sy += points[lo, 1]
        hi = k
        while hi < n - 1 and hi - k < half_window and is_member[hi + 1]:
            dx = points[hi + 1, 0] - points[hi, 0]
            dy = points[hi + 1, 1] - points[hi, 1]
            if dx * dx + dy * dy > gap2:
                break
            hi += 1
            sx += points[hi, 0]
            sy += points[hi, 1]
        count = hi - lo + 1
        if count < 3:
            _grazed_normal(points, is_member, k, max_thickness, out)
            _turn_to(laser, points, k, out)
            continue
        mx = sx / count
        my = sy / count
        xx = 0.0
        xy = 0.0
        yy = 0.0
        for m in range(lo, hi + 1):
            dx = points[m, 0] - mx
            dy = points[m, 1] - my
            xx += dx * dx
            xy += dx * dy
            yy += dy * dy
        half_trace = 0.5 * (xx + yy)
        root = math.sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 0.0))
        smallest = half_trace - root
        if smallest / count > max_thickness * max_thickness or root < 1e-9:
            continue
        # direction of the line: eigenvector of the larger eigenvalue
        angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
        out[k, 0] = -math.sin(angle)
        out[k, 1] = math.cos(angle)
        _turn_to(laser, points, k, out)


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
